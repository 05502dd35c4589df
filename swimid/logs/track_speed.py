"""The mean speed of a track, with its interval, whatever the noise and the gaps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import interpolate, stats

from swimid.logs.track_cleaning import Cleaning

Array = NDArray[np.float64]
#: Samples of a stretch without a gap that a speed needs.
MIN_SAMPLES = 12
#: Samples smoothed at once; a longer stretch is cut.
MAX_STRETCH = 1500
#: Samples in all that are smoothed; of more only every so many are taken.
MAX_SAMPLES = 60_000
#: Smoothness tried, the weight of the squared curvature at one sample a unit of time.
STRENGTHS = np.logspace(-4, 6, 11)
#: Parts of the samples that are left out in turn to choose it.
FOLDS = 5
#: Samples that suffice to choose it.
TUNING_SAMPLES = 600


#: Blocks whose means tell how sure the mean of all is.
BLOCKS = 12


@dataclass(frozen=True)
class Estimate:
    """A value with its 95 % interval, in one unit; NaN ends where nothing tells how sure it is."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class TrackSpeed:
    """How fast a track is.

    Attributes
    ----------
    path : Estimate
        Mean of the speed along the path, sway and turns included; m/s.
    line : Estimate
        Mean of the velocity along the straight line from start to end; m/s.
    naive_m_s : float
        Mean of ``|dx/dt|`` over all samples as they stand in the file.
    noise_m : float
        Standard deviation of a coordinate about the smoothed path.
    covered_s : float
        Time without the gaps.
    """

    path: Estimate
    line: Estimate
    naive_m_s: float
    noise_m: float
    covered_s: float


def mean_of_blocks(values: Array, weights: Array, shift: float = 0.0) -> Estimate:
    """Weighted mean with Student's interval over the means of :data:`BLOCKS` blocks of equal weight.

    Parameters
    ----------
    values, weights : ndarray, shape (n,)
        In the order of time; ``weights`` the time each value stands for, not all 0.
    shift : float
        A correction of the mean, as uncertain as it is large.
    """
    value = float(weights @ values / weights.sum())
    block = np.minimum((np.cumsum(weights) - 0.5 * weights) / weights.sum() * BLOCKS, BLOCKS - 1).astype(int)
    totals = np.bincount(block, weights, BLOCKS)
    held = totals > 0
    means = np.bincount(block, weights * values, BLOCKS)[held] / totals[held]
    half = 0.0  # of the block means; what noise adds is as uncertain as it is large
    if len(means) > 1:
        # neighbouring blocks are not independent: their correlation widens the interval
        off = means - means.mean()
        together = float(off[1:] @ off[:-1] / max(float(off @ off), 1e-300))
        widen = np.sqrt((1 + max(together, 0.0)) / (1 - min(max(together, 0.0), 0.8)))
        half = float(stats.t.ppf(0.975, len(means) - 1) * means.std(ddof=1) / np.sqrt(len(means)) * widen)
    half = float(np.hypot(half, shift))
    return Estimate(value + shift, value + shift - half, value + shift + half)


def naive(time_s: Array, positions: list[Array]) -> float:
    """Mean of ``|dx/dt|`` over the samples that are there, m/s; NaN for fewer than two."""
    place = np.column_stack(positions)
    there = np.isfinite(place).all(axis=1)
    if there.sum() < 2:
        return float("nan")
    steps = np.linalg.norm(np.diff(place[there], axis=0), axis=1)
    return float(np.mean(steps / np.diff(time_s[there])))


def speed(time_s: Array, positions: list[Array], cleaning: Cleaning) -> TrackSpeed | None:
    """Mean speed of a cleaned track; None where no stretch is long enough.

    Parameters
    ----------
    time_s : ndarray, shape (n,)
    positions : list of ndarray, each shape (n,)
        As in the file, m.
    cleaning : Cleaning
        What of them is good.

    Notes
    -----
    Every stretch between gaps is smoothed by a cubic spline; how smooth, cross-validation on the
    longest tells [1]_. Noise lengthens a path: the smoothed path with its own noise put
    on is smoothed again, and what that adds is taken off (parametric bootstrap [2]_). The interval is
    that of :func:`mean_of_blocks`: it holds noise and the
    unsteadiness of the swimming.

    References
    ----------
    .. [1] Craven, P., Wahba, G. (1979). Smoothing noisy data with spline functions. Numerische
       Mathematik 31, 377-403. doi:10.1007/BF01404567
    .. [2] Efron, B., Tibshirani, R. J. (1993). An Introduction to the Bootstrap. Chapman & Hall.
    """
    place = np.column_stack(positions)
    rng = np.random.default_rng(0)
    velocity, weights = np.full(place.shape, np.nan), np.zeros(len(time_s))
    squares, count, excess = 0.0, 0, 0.0
    stretches = _stretches(time_s, cleaning)
    if not stretches:
        return None
    longest = max(stretches, key=len)[:TUNING_SAMPLES]
    strength = _strength(time_s[longest], place[longest])
    for rows in stretches:
        t, x = time_s[rows], place[rows]
        smooth, slope = _smoothed(t, x, strength)
        left = x - smooth
        again = _smoothed(t, smooth + rng.choice(left, len(left)), strength)[1]
        part = np.convolve(np.diff(t), [0.5, 0.5])  # the time that each sample stands for
        weights[rows] = part
        velocity[rows] = slope
        excess += float(part @ (np.linalg.norm(again, axis=1) - np.linalg.norm(slope, axis=1)))
        squares, count = squares + float(np.sum(left**2)), count + left.size
    covered = float(weights.sum())
    used = weights > 0
    along = np.linalg.norm(velocity[used], axis=1)
    mean = weights[used] @ velocity[used] / covered
    direction = mean / max(float(np.linalg.norm(mean)), 1e-300)
    return TrackSpeed(
        mean_of_blocks(along, weights[used], -excess / covered),
        mean_of_blocks(velocity[used] @ direction, weights[used]),
        naive(time_s, positions),
        float(np.sqrt(squares / max(count, 1))),
        covered,
    )


def _stretches(time_s: Array, cleaning: Cleaning) -> list[NDArray[np.int64]]:
    """Rows of the stretches without a gap or a jump, each long enough and not too long."""
    rows = np.flatnonzero(cleaning.good)
    rows = rows[:: max(len(rows) // MAX_SAMPLES, 1)]
    if len(rows) < MIN_SAMPLES:
        return []
    ends = {end for _, end in cleaning.gaps} | {float(time_s[row]) for row in cleaning.offset_rows}
    cuts = [
        k for k in range(1, len(rows)) if any(time_s[rows[k - 1]] < end <= time_s[rows[k]] for end in ends)
    ]
    found = []
    for stretch in np.split(rows, cuts):
        pieces = max(int(np.ceil(len(stretch) / MAX_STRETCH)), 1)
        found += [part for part in np.array_split(stretch, pieces) if len(part) >= MIN_SAMPLES]
    return found


def _smoothed(t: Array, x: Array, strength: Array) -> tuple[Array, Array]:
    """Smoothed coordinates and their rates."""
    step = float(np.mean(np.diff(t)))
    unit = (t - t[0]) / step  # the spline's equations are ill-conditioned in other units
    smooth, slope = np.empty_like(x), np.empty_like(x)
    for axis, lam in enumerate(strength):
        size = max(float(np.ptp(x[:, axis])), 1e-300)
        spline = interpolate.make_smoothing_spline(unit, (x[:, axis] - x[0, axis]) / size, lam=lam)
        smooth[:, axis] = spline(unit) * size + x[0, axis]
        slope[:, axis] = spline.derivative()(unit) * size / step
    return smooth, slope


def _strength(t: Array, x: Array) -> Array:
    """Smoothness of each coordinate with which samples left out are foretold best."""
    unit = (t - t[0]) / float(np.mean(np.diff(t)))
    errors = np.zeros((len(STRENGTHS), x.shape[1]))
    for fold in range(FOLDS):
        out = np.arange(len(t)) % FOLDS == fold
        out[[0, -1]] = False
        for k, lam in enumerate(STRENGTHS):
            spline = interpolate.make_smoothing_spline(unit[~out], x[~out], lam=lam)
            errors[k] += np.sum((spline(unit[out]) - x[out]) ** 2, axis=0)
    return STRENGTHS[np.argmin(errors, axis=0)]
