"""Tracks: repeated samples, jumps, gaps, mean speed, and the result class of commands that write a log.

Gaps of a track are never filled.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from itertools import pairwise, product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from swimid.logs import log
from swimid.logs.beat import waves
from swimid.logs.log import Log, runs
from swimid.logs.sampling import FALSE_ALARM, PAUSE, Held, find_held, pauses, quantum, rate
from swimid.results import numbers
from swimid.results.evidence import Evidence, Table, Verdict, leaf_table
from swimid.results.result import Result

if TYPE_CHECKING:
    import pandas as pd
    import xarray

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

#: Window lengths, in steps, of two running medians over a track: that of the expected velocity, and that of
#: the usual deviation from this velocity.
WINDOW, WIDE = 11, 41
#: Minimum deviation of an outlying step of a track (displacement between two samples) from its expected
#: value, in median deviations. For Gaussian noise in a plane, six median deviations are seven standard
#: deviations.
OUTLYING = 6.0
#: Minimum speed of an outlying step of a track, divided by the speed of the fastest part of the track; and
#: number of steps in the running median that gives the latter speed. A robot can be fast for several steps,
#: but a tracking error with return has only two fast steps.
FASTER, ALIKE = 2.0, 5
#: Minimum number of samples, and minimum fraction of the samples of a track, in a segment that continues the
#: track at another place after a jump. A shorter segment is taken for a tracking error, after which the track
#: returns.
FEW, FEW_SHARE = 12, 0.05
#: Maximum number of successive samples in a spike of a quantity other than a pose, if spikes are rare; and
#: minimum expected number of longer runs of adjacent spikes, for runs of this length to count as spikes.
SPIKE, MIN_RUNS = 2, 0.1


@dataclass(frozen=True)
class Cleaning:
    """Repeated samples, jumps and gaps that were found in a track.

    Attributes
    ----------
    good : ndarray of bool, shape (n,)
        Whether each sample is a measured position of the robot.
    repeated : ndarray of bool, shape (n,)
        Whether each sample repeats all columns of the pose, except for jitter, because the camera had no new
        picture.
    jumped : ndarray of bool, shape (n,)
        Whether each sample lies away from the track, which continues before and after the sample.
    jumps : int
        Number of jumps: those with return, and those after which the track continues at another place.
    offset_rows : list of int
        Row numbers at which the track continues at another place.
    gaps : list of (float, float)
        Start and end of the gaps between good samples, s.
    held : Held or None
        Repeated samples, with the measurement times of the pictures; None if repeats were not searched.
    """

    good: Flags
    repeated: Flags
    jumped: Flags
    jumps: int
    offset_rows: list[int]
    gaps: list[tuple[float, float]]
    held: Held | None = None

    @property
    def counts(self) -> dict[str, int]:
        """Number of repeated samples, number of jumps, and number of samples in jumps of a track, by name."""
        repeats, lost = int(self.repeated.sum()), int(self.jumped.sum())
        return {"repeats": repeats, "jumps": self.jumps, "samples_jumped": lost}


def clean(time_s: Array, positions: list[Array], others: list[Array] | None = None) -> Cleaning:
    """Find the repeated samples, jumps and gaps of a track.

    Parameters
    ----------
    time_s : ndarray, shape (n,)
        Strictly increasing, s.
    positions : list of ndarray, each shape (n,)
        Coordinates, m; NaN where missing.
    others : list of ndarray, optional
        Other columns from the same camera picture (angles). In a repeated sample they repeat as well.

    Notes
    -----
    A step is outlying if it meets two conditions. First, it differs from the running median velocity by more
    than :data:`OUTLYING` times the larger of the local and the global median deviation (Hampel's identifier,
    applied to the steps with their durations). Second, it is more than :data:`FASTER` times as fast as the
    fastest part of the track (the 99th percentile of the running median over :data:`ALIKE` steps), and as the
    steps around it (their running median). Outlying steps cut the track into pieces. The accepted track is
    the sequence of pieces with the largest number of samples minus a cost for each piece that does not
    continue the previous piece.

    References
    ----------
    Pearson, R. K., Neuvo, Y., Astola, J., Gabbouj, M. (2016). Generalized Hampel filters. EURASIP
    Journal on Advances in Signal Processing 2016:87. doi:10.1186/s13634-016-0383-6
    """
    place = np.column_stack(positions)
    known: Flags = np.asarray(np.isfinite(place).all(axis=1))
    held = find_held(time_s, [*positions, *(others or [])])
    repeated = held.repeated & known
    rows = np.flatnonzero(known & ~repeated)
    jumped = np.zeros(len(time_s), dtype=bool)
    offsets: list[int] = []
    jumps = 0
    if len(rows) > WINDOW:
        stays, elsewhere = find_jumps(time_s[rows], place[rows])
        jumped[rows[~stays]] = True
        offsets = [int(rows[k]) for k in elsewhere]
        jumps = len(runs(~stays)) + len(offsets)
    good = known & ~repeated & ~jumped
    return Cleaning(good, repeated, jumped, jumps, offsets, gaps(time_s, good), held)


def gaps(time_s: Array, good: Flags) -> list[tuple[float, float]]:
    """Return start and end, s, of each gap between good samples of a track, as found by :func:`pauses`."""
    times = time_s[good]
    return [(float(times[k]), float(times[k + 1])) for k in pauses(times)]


def find_jumps(
    time: Array, place: Array, until: Array | None = None, *, brief: bool = False, least_rate: float = 0.0
) -> tuple[Flags, list[int]]:
    """Find the jumps of a channel by the rules given in :func:`clean`.

    Parameters
    ----------
    time : ndarray, shape (n,)
        Strictly increasing, s.
    place : ndarray, shape (n, d)
        Samples without NaN: positions, or any quantity whose differences have a meaning.
    until : ndarray, shape (n,), optional
        Time until which each sample was repeated, s. By default no sample is repeated.
    brief : bool
        Whether only excursions of about :data:`SPIKE` samples count, after which the channel continues as
        before. Any other quantity than a pose may change in one step.
    least_rate : float
        Minimum rate of an outlying step, in units of ``place`` per s.

    Returns
    -------
    stays : ndarray of bool, shape (n,)
        Whether each sample lies on the track.
    elsewhere : list of int
        Indices of the samples at which the track continues at another place.
    """
    from scipy import ndimage

    if until is None:
        until = time
    steps_s, steps = time[1:] - until[:-1], np.diff(place, axis=0)
    usual_s = float(np.median(steps_s))
    velocity = steps / steps_s[:, None]
    # Reflect the steps at the ends of the record, because copies of the last step would hide a jump there.
    expected = ndimage.median_filter(velocity, size=(WINDOW, 1), mode="reflect")
    off = np.linalg.norm(steps - expected * steps_s[:, None], axis=1)
    length = np.linalg.norm(steps, axis=1)
    units = [unit for column in place.T if (unit := quantum(column)) <= np.ptp(column)]
    least = max(*units, 0.05 * float(np.median(length)), 0.0)
    scale = max(float(np.median(off)), least)
    local = np.maximum(ndimage.median_filter(off, size=min(WIDE, len(off)), mode="reflect"), scale)
    alike = np.linalg.norm(expected, axis=1)
    if not brief:
        alike = np.linalg.norm(ndimage.median_filter(velocity, size=(ALIKE, 1), mode="reflect"), axis=1)
    fastest = max(float(np.percentile(alike, 99)), least_rate / FASTER)
    longer = np.maximum(steps_s / usual_s, 1.0)
    limit = OUTLYING * local * np.minimum(longer, PAUSE)
    outlying = (off > limit) & (length > FASTER * np.maximum(alike, fastest) * steps_s + OUTLYING * scale)
    if not outlying.any():
        return np.ones(len(time), dtype=bool), []
    starts = np.concatenate(([0], np.flatnonzero(outlying) + 1))
    ends = np.concatenate((starts[1:], [len(time)]))

    def goes_on(one: int, other: int) -> bool:
        a, b = ends[one] - 1, starts[other]
        away = float(np.linalg.norm(place[b] - place[a]))
        return away <= FASTER * fastest * (time[b] - until[a]) + OUTLYING * scale

    cost = max(FEW, FEW_SHARE * len(time))
    if brief:
        cost = SPIKE
    chain = _chain(ends - starts, goes_on, cost)
    stays = np.zeros(len(time), dtype=bool)
    for piece in chain:
        stays[starts[piece] : ends[piece]] = True
    elsewhere = [int(starts[b]) for a, b in pairwise(chain) if not goes_on(a, b)]
    if not brief:
        return stays, elsewhere
    back = [(ends[a], starts[b]) for a, b in pairwise(chain) if goes_on(a, b) and b > a + 1]
    stays[:] = True
    usual = max(float(np.percentile((off / local)[~outlying], 99)), OUTLYING)
    for first, end in _spikes(np.array(back, dtype=int).reshape(-1, 2), off / local, usual):
        stays[first:end] = False
    return stays, []


def _spikes(back: NDArray[np.int64], strength: Array, usual: float) -> NDArray[np.int64]:
    """Return those of the excursions of a channel that are spikes: short, and larger than noise explains.

    ``back`` holds the first index and the last index + 1 of each excursion. ``strength`` is the relative size
    of each step of the channel, shape (n - 1,), and ``usual`` that of a large step that is not outlying.

    Notes
    -----
    If the tail of a distribution is that of a Pareto distribution with the index 2, the logarithms of the
    ratios of ``k`` values above a threshold to this threshold have a sum of Gamma distribution with the shape
    ``k`` and the scale 1/2 (Hill 1975, Ann. Statist. 3, 1163). Noise with a heavier tail has no finite
    variance. The excursions are spikes if the probability of their sum is below :data:`FALSE_ALARM`.
    """
    from scipy.special import gammaincc

    lengths, n = np.diff(back)[:, 0], len(strength) + 1
    most, share = float(SPIKE), lengths[lengths <= SPIKE].sum() / n
    if share > 0.0:
        # Accept longer runs as far as spikes of this number are adjacent by chance: the expected number of
        # runs of L samples is n times the L-th power of the share of spikes.
        most = max(most, np.ceil(np.log(MIN_RUNS / n) / np.log(share)))
    excess = np.log(np.minimum(strength[back[:, 0] - 1], strength[back[:, 1] - 1]) / usual)
    # Leave out excursions beside longer ones, because they belong to one motion, such as that of an impact.
    long = np.zeros(n, dtype=bool)
    for first, end in back[lengths > most]:
        long[max(first - WINDOW, 0) : end + WINDOW] = True
    short = (lengths <= most) & (excess > 0.0) & ~long[back[:, 0]]
    if not short.any() or gammaincc(short.sum(), 2.0 * excess[short].sum()) >= FALSE_ALARM:
        return back[:0]
    return back[short]


def _chain(sizes: NDArray[np.int64], goes_on: Callable[[int, int], bool], cost: float) -> list[int]:
    """Return the sequence of track pieces with the most samples, minus ``cost`` for each interruption.

    ``sizes`` holds the number of samples of each piece. ``goes_on(one, other)`` says whether a piece
    continues another one without an interruption.
    """
    best = np.zeros(len(sizes))
    link = np.full(len(sizes), -1)
    for k, size in enumerate(sizes):
        best[k] = size
        for j in range(max(0, k - 100), k):
            gained = best[j] + size
            if gained > best[k] and not goes_on(j, k):
                gained -= cost
            if gained > best[k]:
                best[k], link[k] = gained, j
    chain = [int(np.argmax(best))]
    while link[chain[-1]] >= 0:
        chain.append(int(link[chain[-1]]))
    return chain[::-1]


# ---------------------------------------------------------------- mean speed

#: Minimum number of samples of a gap-free segment of a track from which the speed is estimated.
MIN_SAMPLES = 12
#: Maximum number of samples of a track to which one smoothing spline is fitted. A longer segment is divided.
MAX_STRETCH = 1500
#: Number of samples of a track above which it is thinned before smoothing: only every k-th sample is used.
MAX_SAMPLES = 60_000
#: Candidates for the smoothing weight of a spline (factor of the squared curvature), among which
#: cross-validation chooses. Their unit of time is the mean time step of the track.
STRENGTHS = np.logspace(-4, 6, 11)
#: Number of folds of the cross-validation that chooses the smoothing weight of a track.
FOLDS = 5
#: Length of each of the two segments, at the start and at the end of a track, whose fits give the
#: displacement: number of cycles of the periodic motion, or, without a periodic motion, fraction of the
#: duration. A track shorter than the two segments together is fitted as a whole.
END_CYCLES, END_SHARE = 4.0, 0.125
#: Polynomial orders in the fits that give the displacement of a track: maximum order for a whole track, and
#: order for the segments at its start and its end.
MAX_ORDER, END_ORDER = 3, 2
#: Number of blocks into which a track is divided. The variation of their mean speeds gives the uncertainty of
#: the mean speed of the track.
BLOCKS = 12
#: Maximum correlation of successive residuals, from which the error of their mean is computed.
MAX_CORRELATION = 0.8


@dataclass(frozen=True)
class Estimate:
    """Estimate of a quantity with its 95 % interval. The limits are NaN if the uncertainty is unknown."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class TrackSpeed:
    """Mean speed of a track, in units of its coordinates per second.

    Attributes
    ----------
    path : Estimate
        Mean of the speed along the path, including sway and turns, m/s.
    line : Estimate
        Displacement divided by duration, after the periodic motion is averaged out, m/s.
    noise_m : float
        Standard deviation of a coordinate about the smoothed path, m.
    covered_s : float
        Duration of the track without its gaps, s.
    """

    path: Estimate
    line: Estimate
    noise_m: float
    covered_s: float


def widening(residuals: Array) -> float:
    """Return the factor by which the correlation of successive residuals enlarges the error of a mean."""
    squares = max(float(residuals @ residuals), 1e-300)
    together = min(max(float(residuals[1:] @ residuals[:-1]) / squares, 0.0), MAX_CORRELATION)
    return float(np.sqrt((1.0 + together) / (1.0 - together)))


def mean_of_blocks(values: Array, weights: Array, shift: float = 0.0) -> Estimate:
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
    from scipy.special import stdtrit

    value = float(weights @ values / weights.sum())
    block = np.minimum((np.cumsum(weights) - 0.5 * weights) / weights.sum() * BLOCKS, BLOCKS - 1).astype(int)
    totals = np.bincount(block, weights, BLOCKS)
    held = totals > 0
    means = np.bincount(block, weights * values, BLOCKS)[held] / totals[held]
    half = 0.0
    if len(means) > 1:
        # Widen the interval, because the means of successive blocks are correlated.
        error = float(means.std(ddof=1)) / np.sqrt(len(means)) * widening(means - means.mean())
        half = float(stdtrit(len(means) - 1, 0.975)) * error
    half = float(np.hypot(half, shift))
    return Estimate(value + shift, value + shift - half, value + shift + half)


def net_speed(
    time_s: Array, place: Array, frequency_hz: float | None = None, stamp_sd_s: float = 0.0
) -> Estimate | None:
    """Return the net speed of a track: the displacement of its averaged path divided by its duration.

    The unit is that of the positions ``place`` per s.

    Parameters
    ----------
    time_s : ndarray, shape (n,)
        Strictly increasing, s.
    place : ndarray, shape (n, d)
        Positions, without NaN.
    frequency_hz : float, optional
        Frequency of the periodic motion, Hz, known to a tenth of a cycle over the record. This motion is
        fitted and left out of the displacement.
    stamp_sd_s : float
        Standard deviation of the errors of the time stamps, s.

    Returns
    -------
    Estimate or None
        Net speed; None for fewer than :data:`MIN_SAMPLES` samples.

    Notes
    -----
    A polynomial and two harmonics are fitted by least squares to both ends of the track, or to the whole of a
    short track. For a short track, the displacements of fits with several polynomial orders and frequencies
    are averaged with the weights of the Bayesian information criterion [1]_. In these fits an amplitude that
    changes linearly absorbs the error of the frequency. The interval is widened for correlated residuals by
    the factor of a first-order autoregressive process.

    References
    ----------
    .. [1] Hoeting, J. A., Madigan, D., Raftery, A. E., Volinsky, C. T. (1999). Bayesian model averaging: a
       tutorial. Statistical Science 14, 382-417. doi:10.1214/ss/1009212519
    """
    from scipy.special import stdtrit

    if len(time_s) < MIN_SAMPLES:
        return None
    first, last = float(time_s[0]), float(time_s[-1])
    duration = last - first
    end_s = END_SHARE * duration if frequency_hz is None else END_CYCLES / frequency_hz
    near_hz = [frequency_hz]
    if 2.0 * end_s > duration:
        if frequency_hz is not None:
            near_hz = [frequency_hz + part / duration for part in np.linspace(-0.1, 0.1, 9)]
        tried = product(range(1, MAX_ORDER + 1), near_hz)
        fits = [_fit_path(time_s, place, (first, last), *one, changes=True) for one in tried]
        criteria = np.array([criterion for criterion, *_ in fits])
        weights = np.exp(-0.5 * (criteria - criteria.min()))
        weights /= weights.sum()
        moves = np.array([ends[1] - ends[0] for _, ends, _, _ in fits])
        variances = np.array([cover[0, 0] + cover[1, 1] - 2.0 * cover[0, 1] for _, _, cover, _ in fits])
        away = weights @ moves
        variance = weights @ (variances + (moves - away) ** 2)
        freedom = min(freedom for *_, freedom in fits)
    else:
        counts = np.searchsorted(time_s, [first + end_s, last - end_s])
        head, tail = max(int(counts[0]), MIN_SAMPLES), min(int(counts[1]), len(time_s) - MIN_SAMPLES)
        start = _fit_path(time_s[:head], place[:head], (first,), END_ORDER, frequency_hz)
        stop = _fit_path(time_s[tail:], place[tail:], (last,), END_ORDER, frequency_hz)
        away, variance = stop[1][0] - start[1][0], start[2][0, 0] + stop[2][0, 0]
        freedom = start[3] + stop[3]
    size = float(np.linalg.norm(away))
    along = float(variance @ (away / max(size, 1e-300)) ** 2)
    late = np.sqrt(2.0) * stamp_sd_s * size / duration
    half = float(stdtrit(freedom, 0.975)) * float(np.hypot(np.sqrt(max(along, 0.0)), late))
    return Estimate(size / duration, (size - half) / duration, (size + half) / duration)


def _fit_path(
    t: Array,
    place: Array,
    at: tuple[float, ...],
    order: int,
    frequency_hz: float | None,
    changes: bool = False,
) -> tuple[float, Array, Array, int]:
    """Fit a polynomial and a periodic motion to the positions of a track.

    The result holds the Bayesian information criterion, the polynomial at the times ``at``, shape (m, d), the
    covariance of these values for each coordinate, shape (m, m, d), and the degrees of freedom.
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


def speed(
    time_s: Array, positions: list[Array], cleaning: Cleaning, frequency_hz: float | None = None
) -> TrackSpeed | None:
    """Return the mean speed of a track after cleaning; None if no segment is long enough.

    Parameters
    ----------
    time_s : ndarray, shape (n,)
        Time stamps, s. If samples are repeated, the measurement times of ``cleaning`` are used instead.
    positions : list of ndarray, each shape (n,)
        Coordinates as in the file, m.
    cleaning : Cleaning
        Good samples of the track.
    frequency_hz : float, optional
        Frequency of the periodic motion that is left out of the displacement, Hz.

    Notes
    -----
    Each segment between gaps is smoothed by a cubic spline. Its smoothing weight is chosen by
    cross-validation on the longest segment [1]_. Noise lengthens a path. To correct this bias, resampled
    residuals are added to the smoothed path, the sum is smoothed again, and the added length is subtracted
    (parametric bootstrap [2]_). The interval of the path speed includes noise and unsteady swimming
    (:func:`mean_of_blocks`). The speed ``line`` is computed by :func:`net_speed`.

    References
    ----------
    .. [1] Craven, P., Wahba, G. (1979). Smoothing noisy data with spline functions. Numerische
       Mathematik 31, 377-403. doi:10.1007/BF01404567
    .. [2] Efron, B., Tibshirani, R. J. (1993). An Introduction to the Bootstrap. Chapman & Hall.
    """
    place, stamp_sd_s = np.column_stack(positions), 0.0
    if cleaning.held is not None:
        time_s, stamp_sd_s = cleaning.held.measured_s, cleaning.held.measured_sd_s
    rng = np.random.default_rng(0)
    velocity, weights = np.full(place.shape, np.nan), np.zeros(len(time_s))
    squares, count, excess = 0.0, 0, 0.0
    stretches = _stretches(time_s, cleaning)
    if not stretches:
        return None
    longest = max(stretches, key=len)[:600]
    strength = _strength(time_s[longest], place[longest])
    for rows in stretches:
        t, x = time_s[rows], place[rows]
        smooth, slope = _smoothed(t, x, strength)
        left = x - smooth
        again = _smoothed(t, smooth + rng.choice(left, len(left)), strength)[1]
        part = np.convolve(np.diff(t), [0.5, 0.5])  # duration, s, that each sample represents
        weights[rows] = part
        velocity[rows] = slope
        excess += float(part @ (np.linalg.norm(again, axis=1) - np.linalg.norm(slope, axis=1)))
        squares, count = squares + float(np.sum(left**2)), count + left.size
    covered = float(weights.sum())
    used = weights > 0
    along = np.linalg.norm(velocity[used], axis=1)
    line = net_speed(time_s[cleaning.good], place[cleaning.good], frequency_hz, stamp_sd_s)
    assert line is not None  # each segment has at least MIN_SAMPLES samples
    path = mean_of_blocks(along, weights[used], -excess / covered)
    return TrackSpeed(path, line, float(np.sqrt(squares / max(count, 1))), covered)


def _stretches(time_s: Array, cleaning: Cleaning) -> list[NDArray[np.int64]]:
    """Return the rows of each segment of a track without gaps and jumps, if long enough for smoothing.

    Segments of more than :data:`MAX_STRETCH` samples are divided.
    """
    rows = np.flatnonzero(cleaning.good)
    rows = rows[:: max(len(rows) // MAX_SAMPLES, 1)]
    if len(rows) < MIN_SAMPLES:
        return []
    ends = {end for _, end in cleaning.gaps} | {float(time_s[row]) for row in cleaning.offset_rows}
    cuts = np.unique(np.searchsorted(time_s[rows], sorted(ends)))
    found = []
    for stretch in np.split(rows, cuts):
        pieces = max(int(np.ceil(len(stretch) / MAX_STRETCH)), 1)
        found += [part for part in np.array_split(stretch, pieces) if len(part) >= MIN_SAMPLES]
    return found


def _smoothed(t: Array, x: Array, strength: Array) -> tuple[Array, Array]:
    """Return the coordinates of a track after smoothing, and their time derivatives, each shape (n, d)."""
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
    """Return the smoothing weight of each coordinate of a track with the least held-out squared error.

    The result has the shape (d,).
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


# ---------------------------------------------------------------- result of commands that write a log


@dataclass(frozen=True, eq=False)
class Logged(Result):
    """Result of ``track_video``, ``track_imu`` and ``import_log``: a log and its evidence.

    Attributes
    ----------
    table : dict of str to array_like, each shape (n,)
        Columns as they are written to the file, with text and integers. Empty if the columns of ``log`` are
        written.
    log : Log
        The log, which any function that reads logs accepts.
    frame : DataFrame
        Columns of the log, one row per sample, in SI units and radians.

    Examples
    --------
    >>> import swimid
    >>> made = swimid.load_result("sample_logs/rig/w10.csv")
    >>> isinstance(made, Logged), list(made.frame)
    (True, ['t_s', 'x_m'])
    """

    table: Mapping[str, Any] = field(default_factory=dict, repr=False)

    kind = "Log"
    ending = ".csv"
    next_step = "swimid plot {file} -o {free[log.svg]}"

    @property
    def log(self) -> Log:
        """Log of the result, which any function that reads logs accepts."""
        assert isinstance(self.document, Log)
        return self.document

    @property
    def frame(self) -> pd.DataFrame:
        """Columns of the log, one row per sample, in SI units and radians."""
        import pandas as pd

        return pd.DataFrame(dict(self.table or self.log.columns))

    def to_xarray(self) -> xarray.Dataset:
        """Return the log as an ``xarray.Dataset`` over ``t_s``, each variable with its unit."""
        return self.log.to_xarray()

    def _write(self, path: Path) -> list[Path]:
        log.write(path, self.table or self.log.columns, self.log.metadata)
        return [path]

    @classmethod
    def _read(cls, path: str | Path) -> Log:
        return log.read(path)

    def _own_facts(self) -> dict[str, str]:
        span = float(self.log.time_s[-1] - self.log.time_s[0])
        return {
            "Samples": str(len(self.log)),
            "Duration": numbers.format_number(span, unit="s"),
            "Sampling rate": numbers.format_number(1.0 / rate(self.log.time_s).step_s, unit="Hz"),
        }

    def _own_tables(self) -> list[Table]:
        rows: list[list[Any]] = []
        for name, values in self.log.signals.items():
            lost = numbers.percent(float(np.isnan(values).mean()))
            known = values[np.isfinite(values)]
            ends = [float(end(known)) for end in (np.min, np.max) if len(known)]
            rows.append([name, *(ends or (None, None)), lost])
        columns = ["channel", "smallest", "largest", "missing"]
        folded = self.evidence is not None
        return [Table(id="channels", title="Channels", columns=columns, rows=rows, folded=folded)]

    def bare(self) -> Evidence:
        """Return evidence without checks, for a log whose evidence file is missing."""
        from swimid.logs import plot

        verdict = Verdict(level="caution", text="A log without evidence of how it was made.")
        if self.log.metadata.get("made_by") == "swimid simulate":
            verdict = Verdict(level="good", text="A simulated run.")
        return Evidence(
            command=self.command,
            title=f"Log {self.path.name}",
            verdict=verdict,
            figures=plot.figures_of([self.log]),
            tables=[leaf_table("metadata", "Metadata of the log", self.log.metadata)],
        )
