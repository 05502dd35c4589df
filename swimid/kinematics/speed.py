"""Mean speed of a track, with its error."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from swimid.kinematics.frequency import waves
from swimid.logs.sampling import pauses

Array = NDArray[np.float64]


#: Minimum number of samples of a gap-free segment of a track from which the speed is estimated.
MIN_SAMPLES_SPEED = 12
#: Maximum number of samples of a track to which one smoothing spline is fitted. A longer segment is divided.
MAX_STRETCH = 1500
#: Number of samples of a track above which it is thinned before smoothing: only every k-th sample is used.
MAX_SAMPLES_SPEED = 60_000
#: Candidates for the smoothing weight of a spline (factor of the squared curvature), among which
#: cross-validation chooses. Their unit of time is the mean time step of the track.
STRENGTHS = np.logspace(-4, 6, 11)
#: Number of folds of the cross-validation that chooses the smoothing weight of a track.
FOLDS = 5
#: Length of each of the two segments, at the start and at the end of a track, whose fits give the
#: displacement: number of cycles of the periodic motion (END_CYCLES), or, without a periodic motion, fraction
#: of the duration (END_SHARE). A track shorter than the two segments together is fitted as a whole.
END_CYCLES, END_SHARE = 4.0, 0.125
#: Polynomial orders in the fits that give the displacement of a track: maximum order for a whole track
#: (MAX_ORDER), and order for the segments at its start and its end (END_ORDER).
MAX_ORDER, END_ORDER = 3, 2
#: Number of blocks into which a track is divided. The variation of their mean speeds gives the uncertainty of
#: the mean speed of the track.
BLOCKS = 12
#: Maximum correlation of successive residuals that is used for the error of their mean.
MAX_CORRELATION = 0.8


@dataclass(frozen=True)
class TrackEstimate:
    """Estimate of a quantity with its 95 % interval. The limits are NaN if the uncertainty is unknown."""

    value: float
    low: float
    high: float

    @classmethod
    def from_stderr(cls, value: float, stderr: float, freedom: int) -> TrackEstimate:
        """Return an estimate with Student's t interval, from its standard error and degrees of freedom."""
        from scipy.special import stdtrit

        half = float(stdtrit(freedom, 0.975)) * stderr
        return cls(value, value - half, value + half)

    def cut_at_zero(self) -> TrackEstimate:
        """Return this estimate with the interval cut off at zero, for a quantity that is never negative."""
        return TrackEstimate(self.value, max(self.low, 0.0), self.high)


@dataclass(frozen=True)
class TrackSpeed:
    """Mean speed of a track, in units of its coordinates per second. The intervals are cut off at zero.

    Attributes
    ----------
    path : TrackEstimate
        Mean of the speed along the path, including sway and turns.
    line : TrackEstimate
        Net speed: displacement divided by duration, after the periodic motion is averaged out.
    noise : float
        Standard deviation of a coordinate about the smoothed path, in the unit of the coordinates.
    covered_s : float
        Duration of the track without its gaps, s.
    """

    path: TrackEstimate
    line: TrackEstimate
    noise: float
    covered_s: float


def error_factor(residuals: Array) -> float:
    """Return the factor by which the correlation of successive residuals enlarges the error of a mean."""
    squares = max(float(residuals @ residuals), 1e-300)
    together = min(max(float(residuals[1:] @ residuals[:-1]) / squares, 0.0), MAX_CORRELATION)
    return float(np.sqrt((1.0 + together) / (1.0 - together)))


def mean_of_blocks(values: Array, weights: Array, shift: float = 0.0) -> TrackEstimate:
    """Return the weighted mean of values with its 95 % interval from the means of :data:`BLOCKS` blocks.

    The values are divided into blocks of equal weight. The interval is Student's t interval of the block
    means.

    Parameters
    ----------
    values, weights : ndarray, shape (n,)
        Values in the order of time, and the weight of each value, which is the duration that it represents.
        At least one weight must not be 0.
    shift : float
        Correction that is added to the mean. Its standard uncertainty is taken to be as large as the
        correction.
    """
    value = float(weights @ values / weights.sum())
    block = np.minimum((np.cumsum(weights) - 0.5 * weights) / weights.sum() * BLOCKS, BLOCKS - 1).astype(int)
    totals = np.bincount(block, weights, BLOCKS)
    held = totals > 0
    means = np.bincount(block, weights * values, BLOCKS)[held] / totals[held]
    half = abs(shift)
    if len(means) > 1:
        # Widen the interval, because the means of successive blocks are correlated.
        error = float(means.std(ddof=1)) / np.sqrt(len(means)) * error_factor(means - means.mean())
        half = float(np.hypot(TrackEstimate.from_stderr(0.0, error, len(means) - 1).high, shift))
    return TrackEstimate(value + shift, value + shift - half, value + shift + half)


def _net_speed(time_s: Array, place: Array, frequency_hz: float | None, stamp_sd_s: float) -> TrackEstimate:
    """Return the net speed of a track without NaN, by the method given in :func:`measure_speed`."""
    first, last = float(time_s[0]), float(time_s[-1])
    duration = last - first
    end_s = END_SHARE * duration if frequency_hz is None else END_CYCLES / frequency_hz
    if 2.0 * end_s > duration:
        away, variance, freedom = _average_displacement(time_s, place, frequency_hz)
    else:
        counts = np.searchsorted(time_s, [first + end_s, last - end_s])
        head = max(int(counts[0]), MIN_SAMPLES_SPEED)
        tail = min(int(counts[1]), len(time_s) - MIN_SAMPLES_SPEED)
        start = _fit_path(time_s[:head], place[:head], (first,), END_ORDER, frequency_hz)
        stop = _fit_path(time_s[tail:], place[tail:], (last,), END_ORDER, frequency_hz)
        away, variance = stop[1][0] - start[1][0], start[2][0, 0] + stop[2][0, 0]
        freedom = start[3] + stop[3]
    size = float(np.linalg.norm(away))
    along = float(variance @ (away / max(size, 1e-300)) ** 2)
    late = np.sqrt(2.0) * stamp_sd_s * size / duration
    stderr = float(np.hypot(np.sqrt(max(along, 0.0)), late))
    return TrackEstimate.from_stderr(size / duration, stderr / duration, freedom).cut_at_zero()


def _average_displacement(
    time_s: Array, place: Array, frequency_hz: float | None
) -> tuple[Array, Array, int]:
    """Return the mean displacement of fits to a short track, its variances and its degrees of freedom."""
    first, last = float(time_s[0]), float(time_s[-1])
    near_hz: list[float | None] = [frequency_hz]
    if frequency_hz is not None:
        near_hz = [frequency_hz + part / (last - first) for part in np.linspace(-0.1, 0.1, 9)]
    tried = product(range(1, MAX_ORDER + 1), near_hz)
    fits = [_fit_path(time_s, place, (first, last), *one, changes=True) for one in tried]
    criteria = np.array([criterion for criterion, *_ in fits])
    weights = np.exp(-0.5 * (criteria - criteria.min()))
    weights /= weights.sum()
    moves = np.array([ends[1] - ends[0] for _, ends, _, _ in fits])
    variances = np.array([cover[0, 0] + cover[1, 1] - 2.0 * cover[0, 1] for _, _, cover, _ in fits])
    away = weights @ moves
    return away, weights @ (variances + (moves - away) ** 2), min(freedom for *_, freedom in fits)


def _fit_path(
    t: Array,
    place: Array,
    at: tuple[float, ...],
    order: int,
    frequency_hz: float | None,
    changes: bool = False,
) -> tuple[float, Array, Array, int]:
    """Fit a polynomial and a periodic motion to the positions of a track.

    The result holds the Bayesian information criterion, the polynomial at the m times ``at`` for the d
    coordinates, shape (m, d), the covariance of these values for each coordinate, shape (m, m, d), and the
    degrees of freedom.
    """
    u = (t - t[0]) / float(np.ptp(t))
    design = np.vander(u, order + 1, increasing=True)
    if frequency_hz is not None:
        swing = waves(t - t[0], frequency_hz, (1, 2))
        design = np.column_stack((design, swing))
        if changes:
            design = np.column_stack((design, (u - 0.5)[:, None] * swing[:, :2]))
    weights = np.linalg.lstsq(design, place, rcond=None)[0]
    left = place - design @ weights
    squares = np.maximum(np.sum(left**2, axis=0), 1e-300)
    freedom = max(len(t) - design.shape[1], 1)
    together = np.clip(np.sum(left[1:] * left[:-1], axis=0) / squares, 0.0, 0.98)
    variance = squares / freedom * (1.0 + together) / (1.0 - together)
    criterion = float(len(t) * np.sum(np.log(squares))) + design.shape[1] * place.shape[1] * np.log(len(t))
    look = np.zeros((len(at), design.shape[1]))
    look[:, : order + 1] = np.vander((np.array(at) - t[0]) / float(np.ptp(t)), order + 1, increasing=True)
    cover = look @ np.linalg.pinv(design.T @ design) @ look.T
    return criterion, look @ weights, cover[:, :, None] * variance, freedom


def measure_speed(
    time_s: Array,
    place: Array,
    frequency_hz: float | None = None,
    *,
    offset_rows: Sequence[int] = (),
    stamp_sd_s: float = 0.0,
) -> TrackSpeed | None:
    """Return the mean speed of a track; None if no segment has :data:`MIN_SAMPLES_SPEED` samples.

    Parameters
    ----------
    time_s : ndarray, shape (n,)
        Strictly increasing times of measurement, s.
    place : ndarray, shape (n, d)
            Positions with d coordinates, in any unit; NaN where missing.
    frequency_hz : float, optional
        Frequency of the periodic motion, Hz, known to a tenth of a cycle over the record. This motion is
        fitted and left out of the displacement.
    offset_rows : sequence of int
        Row numbers at which the track continues at another place.
    stamp_sd_s : float
        Standard deviation of the errors of the time stamps, s.

    Notes
    -----
    Each segment between gaps is smoothed by a cubic spline. Its smoothing weight is chosen by
    cross-validation on the longest segment [1]_. Noise lengthens a path. To correct this bias, resampled
    residuals are added to the smoothed path, the sum is smoothed again, and the added length is subtracted
    (parametric bootstrap [2]_). The interval of the path speed includes noise and unsteady swimming
    (:func:`mean_of_blocks`).

    For the net speed, a polynomial and two harmonics are fitted by least squares to both ends of the track,
    or to the whole of a short track. For a short track, the displacements of fits with several polynomial
    orders and frequencies are averaged with the weights of the Bayesian information criterion [3]_. In these
    fits an amplitude that changes linearly absorbs the error of the frequency. The interval is widened for
    correlated residuals by the factor of a first-order autoregressive process.

    References
    ----------
    .. [1] Craven, P., Wahba, G. (1979). Smoothing noisy data with spline functions. Numerische
       Mathematik 31, 377-403. doi:10.1007/BF01404567
    .. [2] Efron, B., Tibshirani, R. J. (1993). An Introduction to the Bootstrap. Chapman & Hall.
    .. [3] Hoeting, J. A., Madigan, D., Raftery, A. E., Volinsky, C. T. (1999). Bayesian model averaging: a
       tutorial. Statistical Science 14, 382-417. doi:10.1214/ss/1009212519
    """
    known = np.flatnonzero(np.isfinite(place).all(axis=1))
    segments = _segments(time_s, known, offset_rows)
    if not segments:
        return None
    rng = np.random.default_rng(0)
    longest = max(segments, key=len)[:600]
    strength = _strength(time_s[longest], place[longest])
    speeds, weights, residuals, excess = [], [], [], 0.0
    for rows in segments:
        t, x = time_s[rows], place[rows]
        smooth, slope = _smooth_path(t, x, strength)
        left = x - smooth
        again = _smooth_path(t, smooth + rng.choice(left, len(left)), strength)[1]
        weights.append(np.convolve(np.diff(t), [0.5, 0.5]))  # duration, s, that each sample represents
        speeds.append(np.linalg.norm(slope, axis=1))
        excess += float(weights[-1] @ (np.linalg.norm(again, axis=1) - speeds[-1]))
        residuals.append(left)
    covered = float(np.concatenate(weights).sum())
    path = mean_of_blocks(np.concatenate(speeds), np.concatenate(weights), -excess / covered).cut_at_zero()
    line = _net_speed(time_s[known], place[known], frequency_hz, stamp_sd_s)
    return TrackSpeed(path, line, float(np.sqrt(np.mean(np.concatenate(residuals) ** 2))), covered)


def _segments(time_s: Array, known: NDArray[np.intp], offset_rows: Sequence[int]) -> list[NDArray[np.intp]]:
    """Return the rows of each segment of a track without gaps and jumps, if long enough for smoothing.

    ``known`` are the rows with a position. Segments of more than :data:`MAX_STRETCH` samples are divided.
    """
    starts = [*known[pauses(time_s[known]) + 1], *offset_rows]
    rows = known[:: max(len(known) // MAX_SAMPLES_SPEED, 1)]
    parts = []
    for segment in np.split(rows, np.unique(np.searchsorted(rows, starts))):
        parts += np.array_split(segment, max(int(np.ceil(len(segment) / MAX_STRETCH)), 1))
    return [part for part in parts if len(part) >= MIN_SAMPLES_SPEED]


def _smooth_path(t: Array, x: Array, strength: Array) -> tuple[Array, Array]:
    """Return the d coordinates of a track after smoothing, and their time derivatives, each shape (n, d)."""
    from scipy.interpolate import make_smoothing_spline

    step = float(np.mean(np.diff(t)))
    unit = (t - t[0]) / step  # the spline is ill-conditioned in other units of time
    smooth, slope = np.empty_like(x), np.empty_like(x)
    for axis, lam in enumerate(strength):
        size = max(float(np.ptp(x[:, axis])), 1e-300)
        spline = make_smoothing_spline(unit, (x[:, axis] - x[0, axis]) / size, lam=lam)
        smooth[:, axis] = spline(unit) * size + x[0, axis]
        slope[:, axis] = spline.derivative()(unit) * size / step
    return smooth, slope


def _strength(t: Array, x: Array) -> Array:
    """Return the smoothing weight of each of the d coordinates of a track, shape (d,).

    The chosen weight has the smallest held-out squared error.
    """
    from scipy.interpolate import make_smoothing_spline

    unit = (t - t[0]) / float(np.mean(np.diff(t)))
    errors = np.zeros((len(STRENGTHS), x.shape[1]))
    for fold in range(FOLDS):
        out = np.arange(len(t)) % FOLDS == fold
        out[[0, -1]] = False
        for k, lam in enumerate(STRENGTHS):
            spline = make_smoothing_spline(unit[~out], x[~out], lam=lam)
            errors[k] += np.sum((spline(unit[out]) - x[out]) ** 2, axis=0)
    return STRENGTHS[np.argmin(errors, axis=0)]
