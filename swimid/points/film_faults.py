"""Faults of a film of tracked points.

A fault is a point that was tracked at a wrong place: labels that were exchanged, two labels on one place, or
a stray label. A point is left out of a frame if its residual exceeds a quantile of the chi-square
distribution. The quantile belongs to the probability :data:`swimid.points.film.FALSE_ALARM_POINTS` that any
point of a film without faults is left out (Bonferroni's bound; data snooping, Baarda 1968).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from scipy import special

from swimid.points import linkage as links
from swimid.points.film import PLACE_SD_M, Film, FilmEstimate
from swimid.points.linkage import Array, Flags, Linkage, Residuals, State

#: Maximum number of fault searches. Each search uses the noise that was estimated after the search before.
MAX_SEARCHES = 5
#: Limits for the exchange of two labels in the whole film. Exchanges are tried if the ratio of the largest to
#: the smallest noise of a point is at least SUSPICIOUS. The SUSPECTS points with the largest noise exchange
#: their labels. An exchange is kept if it divides the noise by MIN_GAIN or more.
SUSPICIOUS, SUSPECTS, MIN_GAIN = 5.0, 4, 1.25
#: Maximum redundancy of a frame in which a third point may be left out in place of two exchanged labels. Two
#: exchanged labels give four wrong coordinates, and a point that is left out removes two coordinates.
FEW = 4
#: Thresholds of the Geman-McClure weights in the search for the state of a frame with faults, in noise
#: standard deviations (graduated non-convexity, Yang et al. 2020, doi:10.1109/LRA.2020.2965893). STEPS is the
#: number of solver steps with each threshold. If neighbouring frames give the start values, only the last
#: NEAR thresholds are used.
THRESHOLDS, STEPS, NEAR = (200.0, 80.0, 40.0, 20.0, 10.0, 6.0), 3, 2
#: Maximum difference between the weighted sums of squares of two solutions for a frame that counts as
#: insignificant. Up to this limit the solution nearer to the neighbouring frames is taken. The limit is the
#: quantile of the chi-square distribution with one degree of freedom at 0.1 %.
MUCH_WORSE = 10.83


@dataclass
class Fault:
    """Points that were left out for one reason, or exchanged.

    Attributes
    ----------
    kind : str
        ``exchanged`` (two labels, since corrected), ``merged`` (two labels at one place), ``stray`` (one
        label at a wrong place), or ``lost`` (half of the points of a frame or more disagree with the
        linkage).
    names : tuple of str
        Names of the points: one for a stray, two for the others.
    frames : ndarray of int
        Indices of the frames.
    """

    kind: str
    names: tuple[str, ...]
    frames: np.ndarray


def find_faults(estimate: FilmEstimate) -> None:
    """Alternate between the search for faults and the estimate, until the faults do not change."""
    for _ in range(MAX_SEARCHES):
        before = estimate.used.copy()
        _leave_out_outliers(estimate)
        estimate.refine()
        if (estimate.used == before).all():
            break


def exchange_labels(estimate: FilmEstimate, linkage: Linkage) -> bool:
    """Repeat the fit with two labels exchanged in the whole film, and keep it if it reduces the noise.

    Return whether the exchange was kept.

    If two labels are wrong in most frames, the errors enlarge the estimated noise of their points, and no
    frame is an outlier. After the exchange, the frames with right labels are outliers instead. The search for
    faults that follows uses the labels as they were tracked. A chain has no stated distances that show which
    labels are right.

    Parameters
    ----------
    linkage : Linkage
        Linkage with start values of its global quantities.
    """
    if "lengths" in linkage.free or estimate.noise.max() < SUSPICIOUS * estimate.noise.min():
        return False
    stated, some = replace(linkage, free=linkage.free - {"places"}), estimate.film.part(estimate.sample)
    points = range(len(estimate.noise))
    suspects = np.argsort(-estimate.noise)[:SUSPECTS].tolist()
    orders = [list(points)]
    for i, j in combinations(suspects, 2):
        order = list(points)
        order[i], order[j] = j, i
        orders.append(order)
    best, found = _find_least_noise([some.reorder(order) for order in orders], stated)
    if best == 0:
        return False
    whole = FilmEstimate.of(estimate.film.reorder(orders[best]), found.linkage)
    whole.noise = estimate.noise = found.noise
    whole.solve()
    estimate.place_sd_m = min(estimate.place_sd_m, PLACE_SD_M)
    estimate.state = whole.state
    estimate.linkage = replace(found.linkage, free=linkage.free, covariance=linkage.covariance)
    return True


def is_mirrored(estimate: FilmEstimate) -> bool:
    """Return whether the stated places of the points fit the film better if the picture is mirrored."""
    if "lengths" in estimate.linkage.free or len(estimate.noise) < 3:
        return False
    free, unknown = estimate.linkage.free - {"places"}, np.zeros((0, 0))
    stated = replace(estimate.linkage, place=estimate.stated, free=free, covariance=unknown)
    some = estimate.film.part(estimate.sample)
    return _find_least_noise([some, replace(some, seen=some.seen.conj())], stated)[0] == 1


def _find_least_noise(films: list[Film], linkage: Linkage) -> tuple[int, FilmEstimate]:
    """Fit variants of a film robustly; return index and estimate of the variant with the least noise.

    The result is the first variant, unless another one reduces the noise by the factor :data:`MIN_GAIN`.
    """
    tried = [FilmEstimate.of(film, linkage) for film in films]
    for trial in tried:
        trial.begin()
    levels = [float(np.log(trial.noise).mean()) for trial in tried]
    best = int(np.argmin(levels))
    if levels[0] - levels[best] < np.log(MIN_GAIN):
        best = 0
    return best, tried[best]


def exchange_back(estimate: FilmEstimate) -> bool:
    """Undo exchanges of two labels in frames that then agree with the linkage; return whether any was undone.

    A frame qualifies if points were left out of it and all its usable points agree with the linkage once two
    labels are exchanged. The residuals of the two points must have two degrees of freedom or more, so that a
    stray label rarely agrees by chance. A frame is not changed if several exchanges agree.
    """
    rows = np.flatnonzero((estimate.film.there & ~estimate.used).any(axis=1))
    if "lengths" in estimate.linkage.free or not len(rows):
        return False
    agreed, found = np.zeros(len(estimate.used), dtype=int), []
    # With few points, a third one may be left out in place of two that are exchanged.
    few = estimate.linkage.redundancy <= FEW
    for i, j in combinations(range(len(estimate.noise)), 2):
        order = np.arange(len(estimate.noise))
        order[[i, j]] = j, i
        tried = rows[few | (estimate.film.there & ~estimate.used)[rows][:, [i, j]].any(axis=1)]
        if not len(tried):
            continue
        film, used = estimate.film.part(tried), estimate.used[tried]
        out = film.there & ~used
        trial = FilmEstimate.of(film.reorder(order.tolist()), estimate.linkage)
        trial.noise, trial.exponent, trial.level = estimate.noise, estimate.exponent, estimate.level
        both = out[:, i] & out[:, j] & used.any(axis=1)
        trial.used[both] = used[both]
        trial.used[both, i] = trial.used[both, j] = True
        trial.solve()
        result = trial.residuals()
        agree = ~(trial.is_far(result) & trial.used).any(axis=1) & trial.used[:, i] & trial.used[:, j]
        agree &= np.sum(result.share.sum(axis=2) * trial.used, axis=1) > 2.0 - links.MIN_SHARE
        agreed[tried[agree]] += 1
        found.append((tried, agree, order, trial))
    for tried, agree, order, trial in found:
        mine = agree & (agreed[tried] == 1)
        at = tried[mine]
        estimate.film.put(at, trial.film.part(mine))
        estimate.order[at], estimate.used[at], estimate.state[at] = order, trial.used[mine], trial.state[mine]
        estimate.log_likelihood[at] = trial.log_likelihood[mine]
    return bool((agreed == 1).any())


def _leave_out_outliers(estimate: FilmEstimate) -> None:
    """Find the faults of all frames that have outliers or points that were left out."""
    found = estimate.residuals()
    there = estimate.film.there
    rows: Flags = np.asarray(((estimate.is_far(found) | ~estimate.used) & there).any(axis=1))
    if not rows.any():
        return
    clean: Flags = np.asarray(~rows & there.any(axis=1))
    starts = [estimate.state[rows]]
    if clean.any():
        starts.append(links.interpolate_frames(estimate.film.time_s, estimate.state, clean)[rows])
    inner = FilmEstimate(estimate.film.part(rows), estimate.linkage, starts[0])
    inner.noise, inner.exponent, inner.level = estimate.noise, estimate.exponent, estimate.level
    inner.log_likelihood = estimate.log_likelihood[rows]
    _find_inliers(inner, starts)
    estimate.used[rows], estimate.state[rows] = inner.used, inner.state


def _find_inliers(estimate: FilmEstimate, starts: list[State]) -> None:
    """Choose the points of each frame that agree with one state of the linkage."""
    there = estimate.film.there
    found = [_anneal(estimate, starts[0], THRESHOLDS)]
    found += [_anneal(estimate, begin, THRESHOLDS[-NEAR:]) for begin in starts[1:]]
    costs = np.array([cost for _, cost in found])
    costs[1:] -= MUCH_WORSE
    best = np.argmin(costs, axis=0)
    for k, (state, _) in enumerate(found):
        estimate.state[best == k] = state[best == k]
    off = (
        np.abs(estimate.film.seen - links.predict_points(estimate.linkage, estimate.state)) ** 2
        / estimate.variance
    )
    estimate.used = there & (off < THRESHOLDS[-1] ** 2)
    _remove_worst(estimate)
    result = estimate.residuals()
    estimate.used |= there & ~estimate.is_far(result) & (result.freedom > 0)
    _remove_worst(estimate)
    # If no more than half of the points agree, the frame does not show which half is right.
    lost = 2 * estimate.used.sum(axis=1) <= there.sum(axis=1)
    estimate.used[lost & (estimate.used != there).any(axis=1)] = False


def _anneal(estimate: FilmEstimate, state: State, thresholds: tuple[float, ...]) -> tuple[State, Array]:
    """Return the state of each frame that agrees with most points, and its weighted cost, shape (n,)."""
    there, variance = estimate.film.there, estimate.variance
    for threshold in thresholds:
        for _ in range(STEPS):
            off = np.abs(estimate.film.seen - links.predict_points(estimate.linkage, state)) ** 2 / variance
            weight = np.where(there, (1.0 + off / threshold**2) ** -2 / variance, 0.0)
            state = links.solve_linkage(estimate.linkage, estimate.film.seen, weight, state, steps=2)
    off = np.abs(estimate.film.seen - links.predict_points(estimate.linkage, state)) ** 2 / variance
    return state, np.sum(np.where(there, np.minimum(off, THRESHOLDS[-1] ** 2), 0.0), axis=1)


def _remove_worst(estimate: FilmEstimate) -> None:
    """Leave out the point with the largest residual of each frame, until no residual is an outlier."""
    for _ in range(estimate.used.shape[1]):
        estimate.solve()
        found = estimate.residuals()
        far = estimate.is_far(found) & estimate.used
        if not far.any():
            break
        size = np.where(far, found.squares / np.maximum(found.freedom, 1), -1.0)
        rows = np.flatnonzero(far.any(axis=1))
        estimate.used[rows, np.argmax(size[rows], axis=1)] = False


def list_faults(estimate: FilmEstimate, found: Residuals) -> list[Fault]:
    """Return the faults: points that were left out or exchanged, with reason and frames."""
    film, names, out = estimate.film, estimate.linkage.names, estimate.film.there & ~estimate.used
    places, variance = links.predict_points(estimate.linkage, estimate.state), estimate.variance
    doubt = np.abs(found.share - 1.0).max(axis=2) * variance
    limit = float(special.chdtri(2.0, estimate.level))
    reach = (estimate.linkage.scale * estimate.linkage.size) ** 2
    kinds: dict[tuple[str, tuple[str, ...]], list[int]] = {}
    moved = estimate.order != np.arange(len(names))
    for row in np.flatnonzero(moved.any(axis=1)).tolist():
        kinds.setdefault(("exchanged", tuple(np.array(names)[moved[row]].tolist())), []).append(row)
    for row in np.flatnonzero(out.any(axis=1)).tolist():
        left = set(np.flatnonzero(out[row]).tolist())
        if not estimate.used[row].any():
            kinds.setdefault(("lost", ()), []).append(row)
            continue
        for i in left:
            away = np.abs(film.seen[row, i] - places[row]) ** 2
            near = (away < limit * (variance[row, i] + doubt[row])) & (doubt[row] < reach)
            near[i] = False
            key: tuple[str, tuple[str, ...]] = ("stray", (names[i],))
            if near.any():
                key = ("merged", (names[i], names[int(np.argmin(np.where(near, away, np.inf)))]))
            kinds.setdefault(key, []).append(row)
    return [Fault(kind, of, np.array(rows)) for (kind, of), rows in kinds.items()]
