"""Faults of a film of tracked points.

A fault is a point that does not belong where it was tracked: labels that were exchanged, two labels on one
place, or a stray label. A point is left out of a frame if its residual exceeds a quantile of the chi-square
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

#: Maximum number of times that the faults are searched again with the new noise.
MAX_SEARCHES = 5
#: Exchange of two labels in the whole film: minimum ratio of the largest to the smallest noise of a point
#: from which it is tried, number of points with the largest noise whose labels are exchanged, and minimum
#: ratio by which it must reduce the noise.
SUSPICIOUS, SUSPECTS, MIN_GAIN = 5.0, 4, 1.25
#: Maximum redundancy of a frame in which a third point may be left out in place of two exchanged labels. An
#: exchange contradicts the linkage along four axes, and a point that is left out explains two of them.
FEW = 4
#: Thresholds of the Geman-McClure weights in the search for the state of a frame with faults, in noise
#: standard deviations (graduated non-convexity, Yang et al. 2020, doi:10.1109/LRA.2020.2965893); number of
#: steps with each of them; and number of the last thresholds that are used if neighbouring frames give the
#: start values.
THRESHOLDS, STEPS, NEAR = (200.0, 80.0, 40.0, 20.0, 10.0, 6.0), 3, 2
#: Difference of the weighted sums of squares of two solutions for a frame, up to which the solution nearer to
#: neighbouring frames is taken: the quantile of the chi-square distribution with one degree of freedom at
#: 0.1 %.
MUCH_WORSE = 10.83


@dataclass
class Fault:
    """Points that were left out for one reason, or exchanged.

    Attributes
    ----------
    kind : str
        ``exchanged`` (and exchanged back), ``merged``, ``stray``, or ``lost`` if more than half of the points
        of a frame disagree.
    names : tuple of str
        Names of the points: one for a stray, two for the others.
    frames : ndarray of int
        Indices of the frames.
    """

    kind: str
    names: tuple[str, ...]
    frames: np.ndarray


def find_faults(estimate: FilmEstimate) -> None:
    """Search faults and refine the estimate in turn until the faults do not change."""
    for _ in range(MAX_SEARCHES):
        before = estimate.used.copy()
        _leave_out_outliers(estimate)
        estimate.refine()
        if (estimate.used == before).all():
            break


def exchange_labels(estimate: FilmEstimate, linkage: Linkage) -> bool:
    """Repeat the fit with two labels exchanged in the whole film, and keep it if it reduces the noise.

    Return whether this was done.

    If labels are wrong in most frames, their noise contains the errors, and no frame stands out. With the
    labels exchanged, the frames in which they were right stand out instead. The search that follows uses
    the labels as they were tracked. A chain has no stated distances that tell which labels are right.

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
    """Return whether some frames fit the stated places better if the picture is mirrored."""
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
    """Exchange two labels back in frames that then agree with the linkage; return whether any was.

    In such a frame points were left out, and all that can be used agree once two labels are exchanged.
    Their residuals must have two degrees of freedom or more, so that a stray label rarely agrees by
    chance. The frame stays as it is if several exchanges agree.
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
    """Return the states that agree with most points, and their costs, shape (n,)."""
    there, variance = estimate.film.there, estimate.variance
    for threshold in thresholds:
        for _ in range(STEPS):
            off = np.abs(estimate.film.seen - links.predict_points(estimate.linkage, state)) ** 2 / variance
            weight = np.where(there, (1.0 + off / threshold**2) ** -2 / variance, 0.0)
            state = links.solve_linkage(estimate.linkage, estimate.film.seen, weight, state, steps=2)
    off = np.abs(estimate.film.seen - links.predict_points(estimate.linkage, state)) ** 2 / variance
    return state, np.sum(np.where(there, np.minimum(off, THRESHOLDS[-1] ** 2), 0.0), axis=1)


def _remove_worst(estimate: FilmEstimate) -> None:
    """Leave out the worst point of each frame until no residual is too large."""
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
    """Return the points that were left out, by reason and names, with their frames."""
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
