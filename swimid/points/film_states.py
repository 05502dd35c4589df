"""Ambiguous states of a linkage: two states that fit the points of a frame equally well."""

from __future__ import annotations

import numpy as np

from swimid.points import linkage as links
from swimid.points.film import FilmEstimate
from swimid.points.film_faults import MUCH_WORSE
from swimid.points.linkage import Array, Flags, State

#: N_SHAPES is the number of frames whose shapes, and their mirror images, are start values in the search for
#: other states that fit a frame. MAX_GAP is the maximum gap between frames with all points over which states
#: are interpolated, frames.
N_SHAPES, MAX_GAP = 8, 12
#: Minimum difference between a component of the state and its value in the neighbouring frames that counts as
#: a spike, in 95 % quantiles of this difference over the film. The limit is 7.8 standard deviations of normal
#: noise, or four times the maximum of a sine.
MAX_SPIKE = 4.0


def choose_states(estimate: FilmEstimate) -> Flags:
    """Choose between states that fit the points of a frame equally well, in frames that lack points.

    If the points of two successive links are missing, the joint between the links may be bent to either side.
    The states are searched from shapes that the linkage has in other frames, and from their mirror images.
    The state nearest to the one interpolated between frames with all points is taken.

    Returns
    -------
    ndarray of bool, shape (n, 2 + links)
        Flags of ambiguous components. A component is ambiguous if it differs in another state that
        neighbouring frames do not exclude, and whose sum of squares is not significantly larger. A state is
        excluded if it is farther from the interpolated state than any frame with all points is from an
        interpolation over a gap of the same length. Components of the chosen state are also flagged if they
        are that far away.
    """
    ambiguous = np.zeros((len(estimate.used), 2 + len(estimate.linkage.parent)), dtype=bool)
    seen: Flags = np.asarray(estimate.used.any(axis=1))
    whole: Flags = np.asarray(estimate.used.all(axis=1))
    # A stray point on the circle about its joint agrees with the other points. Such a point shows as a bend
    # of the joint in a single frame.
    at, values = np.flatnonzero(whole), estimate.state.components[whole]
    if len(at) > MAX_GAP:
        first, last = (links.differences(one, values[1:-1]) for one in (values[:-2], values[2:]))
        share = ((at[1:-1] - at[:-2]) / (at[2:] - at[:-2]))[:, None]
        off = np.abs(first + share * (last - first))
        excess = (off / np.maximum(MAX_SPIKE * np.quantile(off, 0.95, axis=0), 1e-300)).max(axis=1)
        peak = np.maximum(np.r_[0.0, excess[:-1]], np.r_[excess[1:], 0.0])
        whole[at[1:-1]] = (excess <= 1.0) | (excess < peak)
    # If a second state fits all points of each frame, the film does not show which state is correct.
    if (whole & estimate.sample).any() and _choose(estimate, whole & estimate.sample, ~seen)[0].any():
        whole[:] = False
    rows = seen & ~whole
    if rows.any():
        ambiguous[rows], state = _choose(estimate, rows, whole)
        estimate.state[rows] = state
    return ambiguous


def _choose(estimate: FilmEstimate, rows: Flags, whole: Flags) -> tuple[Flags, State]:
    """Return flags of the ambiguous components in frames ``rows``, and the chosen states of these frames."""
    weight, seen = estimate.weight[rows], estimate.film.seen[rows]
    shapes = estimate.state.angles[np.linspace(0, len(estimate.used) - 1, N_SHAPES).astype(int), 1:]
    starts = [estimate.state[rows]]
    bridged = starts[0]
    if whole.any():
        bridged = links.interpolate_frames(estimate.film.time_s, estimate.state, whole)[rows]
        starts.append(bridged)
    starts += [links.place_linkage(estimate.linkage, seen, weight, shape) for shape in (*shapes, *-shapes)]
    found = [links.solve_linkage(estimate.linkage, seen, weight, start) for start in starts]
    costs = np.array([links.cost(estimate.linkage, seen, weight, state) for state in found])
    same: Flags = np.asarray(costs <= costs.min(axis=0) + MUCH_WORSE)
    values, near = np.array([state.components for state in found]), bridged.components
    result = estimate.residuals()
    sd, unknown = np.sqrt(result.alone[rows]), ~result.known[rows]
    size = np.ones(values.shape[2])
    size[:2] = estimate.linkage.scale * estimate.linkage.size
    off = links.differences(values, near) / size
    best = np.argmin(np.where(same, np.sum(off**2, axis=2), np.inf), axis=0)
    chosen = values[best, np.arange(len(best))]
    # Two minima are distinct if they differ by more than the uncertainty of one minimum.
    other: Flags = np.asarray(np.abs(links.differences(values, chosen)) > 4.0 * sd + 1e-3 * size)
    other &= same[:, :, None]
    reach = _reach(estimate, rows, whole) + 4.0 * sd
    far = ~unknown & (np.abs(links.differences(values, near)) > reach)
    likely, astray = np.asarray(~far.any(axis=2)), far[best, np.arange(len(best))]
    rivals = (likely[:, :, None] & other).any(axis=(0, 2)) | astray.any(axis=1)
    flags: Flags = np.asarray(astray | (other.any(axis=0) & np.asarray(rivals)[:, None]))
    return flags, State(chosen[:, 0] + 1j * chosen[:, 1], chosen[:, 2:])


def _reach(estimate: FilmEstimate, rows: Flags, whole: Flags) -> Array:
    """Return twice the usual distance between a frame with all points and an interpolation over a like gap.

    The usual distance is the 95 % quantile over such frames. The result is infinite for gaps of more than
    :data:`MAX_GAP` frames, and before the first and after the last frame with all points.
    """
    at, frames = np.flatnonzero(whole), np.flatnonzero(rows)
    values = estimate.state.components
    reach = np.full((len(values), values.shape[1]), np.inf)
    if len(at) < 2:
        return reach[rows]
    after = np.clip(np.searchsorted(at, frames), 1, len(at) - 1)
    gaps = np.maximum(frames - at[after - 1], at[after] - frames)
    outside = (frames < at[0]) | (frames > at[-1])
    for gap in np.unique(gaps[~outside & (gaps <= MAX_GAP)]).tolist():
        middle = np.arange(gap, len(whole) - gap)
        middle = middle[whole[middle] & whole[middle - gap] & whole[middle + gap]]
        first, last = (links.differences(values[middle + k], values[middle]) for k in (-gap, gap))
        if len(middle):
            reach[frames[~outside & (gaps == gap)]] = np.quantile(np.abs(first + last), 0.95, axis=0)
    return reach[rows]
