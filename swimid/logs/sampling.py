"""Sampling of a record: rate and gaps of the time stamps, repeated samples, rounding, noise, derivatives."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from swimid.errors import UsageError
from swimid.logs.log import runs

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
#: Minimum time between successive samples of a record that counts as a gap, in sampling intervals.
PAUSE = 6.0
#: Maximum difference between a time step and a whole number of sampling intervals, as a fraction of one
#: interval. A time step within this tolerance is on the grid.
ON_GRID = 0.15
#: Minimum fraction of the time steps that are a whole number of sampling intervals, in a record that counts
#: as uniformly sampled.
UNIFORM_SHARE = 0.8
#: Root-mean-square jitter of the time steps above which a warning is given, in sampling intervals.
NOTABLE_JITTER = 0.05
#: Criteria for uneven sampling. UNEVEN is the minimum ratio of successive time steps that counts as uneven: a
#: single missing sample causes a ratio of 2. BURST is the minimum ratio that counts as a burst. FEW_CHANGES
#: is the minimum fraction of the time steps with such a ratio.
UNEVEN, BURST, FEW_CHANGES = 2.0, 10.0, 0.1
#: Minimum number of time steps of a record whose sampling is judged. With fewer time steps a missing sample
#: cannot be distinguished from coarse rounding of the time stamps.
LONG_ENOUGH = 20
#: Maximum difference between a time step and a whole number of units of the clock, in units.
GRID_TOL = 0.02
#: Maximum length of a gap within one evenly sampled piece of a record, in sampling intervals. The record is
#: divided at longer gaps.
LONGEST_FILL = 1000
#: Maximum relative difference between two sampling intervals that count as equal.
SAME_RATE = 0.01
#: Minimum number of distinct values of a continuous signal (LEVELS), and minimum ratio of this number to the
#: number of samples (LEVEL_SHARE). A column with fewer distinct values is taken for commanded levels.
LEVELS, LEVEL_SHARE = 100, 0.05
#: Maximum number of samples of a record in the search for a periodic motion. Only the middle of a longer
#: record is searched.
LONGEST_SOUGHT = 1_000_000
#: Maximum rounding step, as a fraction of the range, of a signal with few distinct values that still counts
#: as continuous. An example is a computed sine with 20 samples per period. Commanded levels are coarser.
FINE = 1e-4


@dataclass(frozen=True)
class Rate:
    """Sampling interval and regularity of the sampling of one record.

    Attributes
    ----------
    step_s : float
        Sampling interval, s.
    jitter : float
        Root-mean-square deviation of the time steps from the sampling interval, in sampling intervals. The
        jitter is 0 if all time stamps are the rounded times of a uniform grid.
    on_grid : float
        Fraction of the time steps that are a whole number of sampling intervals within :data:`ON_GRID`.
    unit_s : float
        Unit to which the time stamps were rounded, s, as found by :func:`clock_unit`.
    """

    step_s: float
    jitter: float
    on_grid: float
    unit_s: float

    @property
    def uniform(self) -> bool:
        """Whether the record is sampled at a constant rate, apart from missing samples."""
        return self.on_grid >= UNIFORM_SHARE


def usual_step(time_s: np.ndarray) -> float:
    """Return the median time step of a record, s; NaN for one sample.

    In a long record only the first :data:`LONGEST_SOUGHT` samples are used.

    >>> usual_step(np.array([0.0, 0.1, 0.2, 0.7]))
    0.1
    """
    if len(time_s) < 2:
        return float("nan")
    return float(np.median(np.diff(time_s[:LONGEST_SOUGHT])))


def pauses(time_s: np.ndarray, step_s: float | None = None) -> np.ndarray:
    """Return the index of the last sample before each pause longer than :data:`PAUSE` sampling intervals.

    By default the sampling interval is the median time step. A record of two samples has no pause.
    """
    if len(time_s) <= 2:
        return np.empty(0, dtype=np.intp)
    if step_s is None:
        step_s = usual_step(time_s)
    return np.flatnonzero(np.diff(time_s) > PAUSE * step_s)


def find_uneven(time_s: np.ndarray) -> tuple[str, bool]:
    """Return a message on the range of uneven time steps, and whether the time stamps come in bursts.

    The message is empty for even sampling. Missing samples, pauses and a slowly changing rate count as even.
    Time stamps in bursts show when samples were received, not when they were measured.

    >>> find_uneven(np.cumsum(np.tile([137e-6, 19863e-6], 100)))[1], find_uneven(np.arange(50) / 7.0)
    (True, ('', False))
    """
    steps = np.diff(time_s)
    if len(steps) < LONG_ENOUGH:
        return "", False
    ratio = np.maximum(steps[1:] / steps[:-1], steps[:-1] / steps[1:])
    bursts = bool(np.mean(ratio > BURST) > FEW_CHANGES)
    usual = rate(time_s)
    if not bursts and usual.unit_s / np.sqrt(6.0) > NOTABLE_JITTER * usual.step_s:
        return (
            f"the clock counts in {1e3 * usual.unit_s:.4g} ms, the steps are {1e3 * usual.step_s:.4g} ms",
            False,
        )
    if not bursts and (usual.uniform or np.mean(ratio > UNEVEN) <= FEW_CHANGES):
        return "", False
    low, middle, high = (f"{1e3 * step:.4g}" for step in np.percentile(steps, [5, 50, 95]))
    return f"the steps are {low} to {high} ms (5 to 95 %), {middle} ms in the median", bursts


def clock_unit(steps_s: np.ndarray) -> float:
    """Return the unit, s, to which time stamps were rounded; 0 if the time steps show none.

    The time stamps are rounded if all time steps are multiples of a unit and their mean is not. ``steps_s``
    holds the time steps, s.

    >>> round(clock_unit(np.diff(np.round(np.arange(100) / 240, 3))), 6), clock_unit(np.full(9, 0.02))
    (0.001, 0.0)
    """
    mean = float(np.mean(steps_s[steps_s < PAUSE * np.median(steps_s)]))
    # Steps that differ by less than a millionth of a step are equal apart from rounding errors. These errors
    # must be less than the tolerance of the unit.
    unit = mean * (step_of(np.append(np.round(steps_s / mean, 6), 0.0), 3) or 0.0)
    if unit < 1e-6 / GRID_TOL * mean or abs(mean / unit - round(mean / unit)) < GRID_TOL:
        return 0.0
    is_even = unit > 0.99 * np.min(steps_s) and np.mean(steps_s < 1.5 * unit) >= UNIFORM_SHARE
    return 0.0 if is_even else unit  # an even record may have missing samples


@dataclass(frozen=True)
class Piece:
    """Piece of a record whose samples are assigned to a time grid of constant rate.

    Attributes
    ----------
    time_s : ndarray, shape (n,)
        Time of each grid point, s: the time stamp of the sample, or an interpolated time for a missing
        sample.
    rows : ndarray of int, shape (n,)
        Row number in the record for each grid point; -1 for a missing sample.
    """

    time_s: np.ndarray
    rows: np.ndarray

    def take(self, column: np.ndarray) -> np.ndarray:
        """Return a column of the record at the grid times of this piece, with NaN for missing samples."""
        return np.where(self.rows >= 0, np.asarray(column, dtype=float)[self.rows], np.nan)


def rate(time_s: np.ndarray) -> Rate:
    """Return the sampling interval of a record and the regularity of its time stamps.

    Parameters
    ----------
    time_s : ndarray, shape (n,), n >= 2
        Strictly increasing, s.

    >>> rate(np.array([0.0, 0.1, 0.2, 0.4, 0.5])).step_s
    0.1
    """
    steps = np.diff(np.asarray(time_s, dtype=float))
    median, unit = float(np.median(steps)), clock_unit(steps)
    if len(steps) >= LONG_ENOUGH:
        line = find_grid(time_s, (float(np.mean(steps)), median))
        if line is not None:
            return Rate(float(f"{line[0]:.10g}"), 0.0, 1.0, unit)
    # Compute the sampling interval as the mean of the time steps near their median. The median itself is
    # biased if the stamps are rounded to milliseconds.
    typical = float(f"{np.mean(steps[np.abs(steps - median) <= 0.5 * median]):.10g}")
    if unit > 0.0:
        typical = float(np.ptp(time_s) / np.sum(np.maximum(np.round(steps / typical), 1)))
    relative = steps / typical
    whole = np.maximum(np.round(relative), 1)
    off = np.abs(relative - whole)
    single = off[(whole == 1) & (off < 0.5)]
    jitter = float(np.sqrt(np.sum(single**2) / max(len(single), 1)))
    return Rate(typical, jitter, float(np.mean((off <= ON_GRID) & (whole <= 10))), unit)


def late_grid(time_s: np.ndarray, step_s: float, lateness_s: float) -> tuple[float, np.ndarray, float] | None:
    """Return the measurement times of an evenly sampling sensor whose samples are stamped late.

    Return None if no evenly spaced times agree with the stamps.

    Parameters
    ----------
    time_s : ndarray, shape (n,)
        Strictly increasing stamps, s.
    step_s : float
        Initial guess of the sensor's sampling interval, s.
    lateness_s : float
        Maximum time from a measurement to its stamp, s.

    Returns
    -------
    step_s : float
    measured_s : ndarray, shape (n,)
        Evenly spaced times of the measurements, s: the latest ones that are not after any time stamp.
    slack_s : float
        Uncertainty of the time between the first and the last measurement, s: width of the interval of
        possible values.
    """
    from scipy import optimize

    first = np.arange(-0.5, 0.6, 0.25) * lateness_s
    lines = (find_grid(time_s + late, (step_s,), lateness_s, time_s[0]) for late in first)
    fits = [line for line in lines if line is not None]
    if not fits:
        return None
    # Of the sampling intervals that agree with the stamps, choose the longest, because it implies the
    # smallest number of missing samples.
    step, number = max(fits, key=lambda line: line[0])
    reach = 4.0 * lateness_s / number[-1]

    def excess(one: float) -> float:
        return float(np.ptp(time_s - one * number)) - lateness_s

    # Find the range of sampling intervals for which evenly spaced times agree with the stamps. In this range
    # the excess, a convex function of the interval, is not positive.
    bounds = step - reach, step + reach
    best = optimize.minimize_scalar(excess, bounds=bounds, method="bounded", options={"xatol": 1e-6 * reach})
    if best.fun >= 0.0 or min(excess(bound) for bound in bounds) <= 0.0:
        low = high = float(best.x)
    else:
        low, high = (float(optimize.brentq(excess, best.x, bound)) for bound in bounds)
    step = 0.5 * (low + high)
    return step, step * number + np.min(time_s - step * number), (high - low) * float(number[-1])


def find_grid(
    time_s: np.ndarray,
    starts: Sequence[float],
    unit: float | None = None,
    first_s: float | None = None,
    min_share: float = UNIFORM_SHARE,
) -> tuple[float, np.ndarray] | None:
    """Return step and sample numbers of the uniform time grid whose rounded times equal the time stamps.

    A straight line of time over sample number is fitted to a growing part of the record. Therefore the guess
    of the step need be good only for the first few samples.

    Parameters
    ----------
    time_s : ndarray, shape (n,)
        Time stamps, s.
    starts : sequence of float
        Guesses of the step, s.
    unit : float, optional
        Rounding unit of the stamps, s. By default it is their last decimal place.
    first_s : float, optional
        Guess of the time of the first grid point, s. The default is the first stamp.
    min_share : float, optional
        Minimum fraction of the time steps that are one grid step long. It rejects a grid with many missing
        samples, such as a grid whose step is the rounding unit.

    Returns
    -------
    tuple of float and ndarray of int, shape (n,), or None
        None if any stamp differs from the grid by more than the rounding.
    """
    time_s = np.asarray(time_s, dtype=float)
    n = len(time_s)
    if unit is None:
        unit = quantum(time_s)
    if n < 2 or unit <= 0:
        return None
    if first_s is None:
        first_s = time_s[0]
    sizes = np.unique(np.minimum(8 * 1.5 ** np.arange(60), n).astype(int))
    for start in starts:
        step, origin = float(start), float(first_s)
        for size in np.repeat(sizes, 3):
            part = time_s[:size]
            number = np.round((part - origin) / step)
            if np.any(np.diff(number) < 1):
                break
            centred = number - number.mean()
            step = float(centred @ part / (centred @ centred))
            origin = float(part.mean() - step * number.mean())
        else:
            off = time_s - origin - step * number
            # Allow for the error of the fitted line in addition to the rounding error of the stamps.
            is_near = np.ptp(off) <= unit * (1 + 4 / np.sqrt(n)) + 1e-9 * step
            if is_near and unit <= step * (1 + 1e-6) and np.mean(np.diff(number) == 1) >= min_share:
                return step, number.astype(int)
    return None


def pieces(time_s: np.ndarray, step_s: float) -> list[Piece]:
    """Divide a record into pieces whose samples lie on time grids of the same constant rate.

    The record is divided where the time stamps leave the grid.

    Parameters
    ----------
    time_s : ndarray, shape (n,)
        Strictly increasing, s.
    step_s : float
        Sampling interval, s.

    Returns
    -------
    list of Piece
        A new piece begins where the time step is not a whole number of sampling intervals, or is longer than
        :data:`LONGEST_FILL` intervals. Shorter gaps become missing samples within a piece.
    """
    time_s = np.asarray(time_s, dtype=float)
    line = find_grid(time_s, (step_s,))
    if line is not None and abs(line[0] / step_s - 1) < SAME_RATE:
        # All stamps agree with one grid within their rounding. Do not divide the record at single time steps,
        # although rounding may shift them far from a whole number of sampling intervals.
        whole = np.diff(line[1]).astype(float)
        cut = np.zeros(len(whole), dtype=bool)
    else:
        relative = np.diff(time_s) / step_s
        whole = np.maximum(np.round(relative), 1)
        cut = (np.abs(relative - whole) > 2 * ON_GRID) & ~_one_late_stamp(relative)
    cut |= whole > LONGEST_FILL
    result = []
    for rows in np.split(np.arange(len(time_s)), np.flatnonzero(cut) + 1):
        index = np.concatenate(([0], np.cumsum(whole[rows[:-1]]))).astype(int)
        source = np.full(index[-1] + 1, -1)
        source[index] = rows
        grid = np.interp(np.arange(len(source)), index, time_s[rows])
        result.append(Piece(grid, source))
    return result


def _one_late_stamp(relative: np.ndarray) -> np.ndarray:
    """Flag each pair of successive time steps that add up to two sampling intervals.

    In such a pair only the time stamp between the two steps is off the grid. ``relative`` holds the time
    steps in sampling intervals.
    """
    pair = relative[:-1] + relative[1:]
    whole = (np.abs(pair - np.round(pair)) <= ON_GRID) & (np.round(pair) == 2)
    return np.append(whole, False) | np.append(False, whole)


def rounding(values: Sequence[float] | np.ndarray) -> float:
    """Return the step to which a continuous signal was rounded; 0 for a signal that is not rounded.

    A commanded input of a few levels (binary, steps, stairs) counts as not rounded, however few decimals it
    has. A column counts as rounded only if it has many distinct values or many decimals.

    Parameters
    ----------
    values : array, shape (n,)
        NaN where missing.

    >>> rounding(np.tile([0.0, 1.0], 500))
    0.0
    >>> rounding(np.round(np.sin(np.arange(500.0)), 3))
    0.001
    """
    x = np.asarray(values, dtype=float)
    x = x[np.isfinite(x)]
    if len(x) == 0:
        return 0.0
    step = quantum(x)
    many = len(np.unique(x)) >= max(LEVELS, LEVEL_SHARE * len(x))
    return step if many or step <= FINE * np.ptp(x) else 0.0


def has_levels(values: np.ndarray) -> bool:
    """Return whether a channel holds commanded levels: it is constant, or returns repeatedly to a few values.

    >>> has_levels(np.tile([0.0, 0.0, 1.0, 1.0, 2.0, 1.0], 50)), has_levels(np.sin(np.arange(300.0)))
    (True, False)
    """
    known = values[np.isfinite(values)]
    levels, visits = len(np.unique(known)), 1 + np.count_nonzero(np.diff(known))
    return bool(levels < 4 or levels < min(LEVELS, LEVEL_SHARE * len(known), 0.5 * visits))


def step_of(values: np.ndarray, least: int = 4) -> float | None:
    """Return the rounding step of a signal: all differences between its values are multiples of this step.

    The tolerance is 2 % of the step. The result is None if there is no such step, or for fewer than ``least``
    distinct values.

    >>> step_of(np.array([0.0, 0.0, 0.5, 1.0, 1.0, 1.5, 3.0]))
    0.5
    """
    values = np.unique(values[np.isfinite(values)])
    if len(values) < least:
        return None
    gaps = np.diff(values)
    step = float(np.median(gaps[gaps < 1.5 * gaps.min()]))
    count = np.round((values - values[0]) / step)
    if count[-1] > 0:
        # Compute the rounding step again from the range of all values, because this is more precise.
        step = float((values[-1] - values[0]) / count[-1])
    return step if np.max(np.abs((values - values[0]) / step - count)) < 0.02 else None


def quantum(values: Sequence[float] | np.ndarray) -> float:
    """Return the unit of the last decimal place of values (0.01 for two decimals); 0 if not rounded.

    >>> quantum(np.array([0.25, 1.5, -0.75]))
    0.01
    """
    x = np.asarray(values, dtype=float)
    x = x[np.isfinite(x) & (x != 0)]
    if len(x) == 0:
        return 0.0
    x = x[:: max(len(x) // 5000, 1)]
    for decimals in range(13):
        scaled = x * 10.0**decimals
        exact = np.abs(scaled - np.round(scaled)) <= 1e-14 * np.abs(scaled) + 1e-9
        if np.mean(exact) >= 0.9 and np.max(np.abs(scaled)) < 1e14:
            return float(10.0**-decimals)
    return 0.0


def longest_even(
    time_s: np.ndarray, values: np.ndarray, fastest_hz: float, most: int = 20_000
) -> tuple[np.ndarray, np.ndarray]:
    """Return the longest gap-free segment of a channel, resampled to even time steps for a spectrum.

    Parameters
    ----------
    time_s, values : ndarray, shape (n,)
        Strictly increasing times; NaN where missing.
    fastest_hz : float
        Maximum rate, Hz. Channels with a higher rate are averaged over blocks of samples. If a channel has
        more than :data:`LONGEST_SOUGHT` samples, only the middle is used.
    most : int
        Maximum number of returned samples.

    Returns
    -------
    time_s, values : ndarray, shape (m,)
        Times and values; empty for fewer than two samples. Pauses up to :data:`PAUSE` sampling intervals are
        interpolated linearly, so that the values are suitable only for a spectrum.
    """
    if len(values) > LONGEST_SOUGHT:
        first = (len(values) - LONGEST_SOUGHT) // 2
        middle = slice(first, first + LONGEST_SOUGHT)
        time_s, values = time_s[middle], values[middle]
    known = np.flatnonzero(np.isfinite(values))
    t, x = time_s[known], values[known]
    if len(t) > 1:
        step = usual_step(t)
        block = max(int(1 / (fastest_hz * step)), 1)
        cuts = pauses(t, step) + 1
        t, x = max(zip(np.split(t, cuts), np.split(x, cuts), strict=True), key=lambda part: len(part[0]))
        if block > 1 and len(t) > 1:
            count = min(len(t) // block, most)
            t, x = (part[: count * block].reshape(count, block).mean(axis=1) for part in (t, x))
        t, x = t[:most], x[:most]
    if len(t) < 2:
        return np.empty(0), np.empty(0)
    even = np.linspace(t[0], t[-1], max(round((t[-1] - t[0]) / float(np.median(np.diff(t)))) + 1, 2))
    if len(even) == len(t) and np.allclose(even, t, rtol=0.0, atol=1e-6 * (even[1] - even[0])):
        return t, x  # do not interpolate even samples, because this would distort jumps
    return even, np.interp(even, t, x)


def white_noise_sd(values: np.ndarray, least: float) -> float:
    """Return the standard deviation of the white noise in a channel, robust against outliers.

    The estimate is computed from third differences. Their variance is 20 times the variance of white noise.

    Parameters
    ----------
    values : ndarray, shape (n,)
        Evenly sampled, NaN where missing.
    least : float
        Minimum of the returned value, in the unit of the channel. This minimum is also returned for too few
        samples.
    """
    if len(values) < 4:
        return least
    there = np.isfinite(values)
    runs = np.convolve(there, np.ones(4), "valid") == 4
    third = np.diff(np.nan_to_num(values), n=3)[runs]
    if len(third) < 8:
        return least
    return max(float(np.median(np.abs(third))) / 0.6745 / np.sqrt(20), least)


# ---------------------------------------------------------------- repeated samples

#: Maximum ratio of the step of a signal to a repeated sample to the step after it, in the search for repeated
#: samples with jitter. Each of these values is tried. The value 0 finds exact repeats only.
RATIOS = (0.0, 0.003, 0.01, 0.03, 0.1)
#: Probability that repeated samples are found in a log that has none.
FALSE_ALARM_REPEATS = 1e-3
#: LONG_HOLD is the minimum time, in measurement intervals, for which a signal at rest or of a frozen sensor
#: keeps one value. NEAR is the maximum step of the signal after a rest of the robot, in median steps. After a
#: frozen value the step is larger.
LONG_HOLD, NEAR = 5.0, 3.0
#: Pattern of the columns that are commanded or computed, not measured: commands, standard deviations,
#: likelihoods and counters.
SET = re.compile(
    r"(cmd|desired|command|thrust|throttle|pwm|duty|set_?point|target|goal|servo|motor|rudder|esc|status|mode|"
    r"frame|count)(?!\w*measured).*|.*_(cmd|command|setpoint|sd(_.*)?)|.*(likelihood|confidence|score|prob\w*)"
)
#: Pattern of the columns that show the motion of the body. If such a column stays constant for long, the
#: sensor may be frozen even if the value recurs. In any other column a recurring value means rest, such as
#: the force in the dead band of a thruster.
OF_MOTION = re.compile(r"([xyz]|roll|pitch|yaw|[uvw]|v[xyz]|[aw][xyz]|joint\w*|\w*rate)_\w+|q[wxyz]")
#: Maximum rounding step of a channel that is searched for a sudden stop, as a fraction of its mean change per
#: sample. A channel with coarser rounding repeats values even while it moves.
NEAR_ROUNDED = 0.2
#: Maximum magnitude of the sum of the steps before and after a turning point of a smooth signal, relative to
#: the sum of their magnitudes. At a turning point the mean of these two steps is about equal to the step
#: between them. Therefore the limit is twice the largest of ``RATIOS``.
TURN = 2.0 * RATIOS[-1]


@dataclass(frozen=True)
class Held:
    """Result of a search for samples of a log that repeat the previous measurement.

    Attributes
    ----------
    repeated : ndarray of bool, shape (n,)
        Whether each sample repeats the previous measurement. The first sample of each measurement is not
        flagged.
    period_s : float
        Mean time between measurements, s. Without repeats it is the median time step of the log.
    lateness_s : float
        Maximum time from a measurement to the stamp of its first sample, s: one time step of the log, or 0
        without repeats.
    measured_s : ndarray, shape (n,)
        Estimated time of the measurement that each sample holds, s, up to a constant offset. If the
        measurements are not evenly spaced, these times are the time stamps.
    measured_sd_s : float
        Standard deviation of the errors of ``measured_s``, apart from the constant offset, s.
    even : bool
        Whether all time stamps agree with measurements at a constant rate.
    """

    repeated: Flags
    period_s: float
    lateness_s: float
    measured_s: Array
    measured_sd_s: float
    even: bool = False


def find_held(time_s: Array, channels: Sequence[Array]) -> Held:
    """Find repeats of a sensor's previous measurement, in a log with a higher rate than the sensor.

    Equal samples of a robot at rest, of a counter between its increments, and of a command with a few levels
    are not taken for repeats.

    Parameters
    ----------
    time_s : ndarray, shape (n,)
        Strictly increasing, s.
    channels : sequence of ndarray, each shape (n,)
        Channels of one sensor, in any units; NaN where missing. In a repeated sample all channels repeat.

    Notes
    -----
    The size of a step between samples is the largest change of a channel divided by the 95th
    percentile of the changes of that channel. If the steps of a signal without repeats are independent and
    normally distributed, a step is less than ``r`` times the next step with probability ``2/pi atan(r)`` in
    one channel, and with a smaller probability in several channels. A smooth signal has fewer such steps;
    they occur at its turning points. Rounding to a unit ``q`` adds as many equal samples as a ratio ``r = q /
    m``, where ``m`` is the mean step. If there are more small steps than a binomial distribution allows, the
    small steps are repeats. Equal samples at either end of the log are not counted, because the robot may be
    at rest there. If the sensor samples evenly, the measurement times are a linear function of the
    measurement number. They precede the stamps by at most one time step of the log.

    Examples
    --------
    >>> t = np.arange(80) / 100
    >>> found = find_held(t, [np.repeat(np.sin(0.37 * np.arange(40.0)), 2)])
    >>> int(found.repeated.sum()), round(found.period_s, 6), round(found.lateness_s, 6)
    (40, 0.02, 0.01)
    """
    from scipy import special

    none = Held(np.zeros(len(time_s), dtype=bool), usual_step(time_s), 0.0, time_s, 0.0)
    place = np.array(channels, dtype=float).reshape(len(channels), len(time_s)).T
    rows = np.flatnonzero(np.isfinite(place).any(axis=1))
    continuous = [values for values in place[rows].T if not has_levels(values)]
    if len(rows) < 4 or not continuous:
        return none
    sizes = _step_sizes(place[rows])
    expected = min(rounding_ratio(values) for values in continuous)
    turning = _turns(place[rows])
    # Before the first change of a log and after the last one the robot may be at rest.
    changes = np.flatnonzero(sizes > 0.0)
    inner = np.zeros(len(sizes), dtype=bool)
    inner[changes[0] : changes[-1]] = True
    best, chosen = np.log(FALSE_ALARM_REPEATS / len(RATIOS)), None
    for ratio in RATIOS:
        small = _small(sizes, ratio)
        small = _remove_rests(time_s[rows], sizes, small)
        counted = small & ~turning & inner
        if ratio > 0.0:
            counted &= sizes < ratio * np.append(sizes[1:], 0.0)
        count = int(counted.sum())
        chance = 2.0 / np.pi * np.arctan(max(ratio, expected))
        by_chance = float(special.bdtrc(count - 1, len(sizes), chance)) if count else 1.0
        surprise = np.log(max(by_chance, 1e-300))
        if surprise < best:
            best, chosen = surprise, small
    if chosen is None or len(rows) - chosen.sum() < LONG_ENOUGH:
        return none
    repeated = none.repeated.copy()
    repeated[rows[1:]] = chosen
    return _time_repeats(time_s, rows, repeated)


def may_freeze(name: str, values: Array) -> bool:
    """Return whether a channel can be checked for a frozen sensor: measured, continuous and long enough."""
    known = values[np.isfinite(values)]
    return not SET.fullmatch(name) and len(known) >= LONG_ENOUGH and not has_levels(known)


def find_frozen(time_s: Array, columns: Mapping[str, Array]) -> dict[str, tuple[float, float]]:
    """Find frozen channels; return start and end, s, of the longest period in which each holds one value.

    A channel is frozen under two conditions. First, it holds one value more than :data:`LONG_HOLD` times as
    long as it usually holds a value. Second, it jumps to or from that value, or stops suddenly while it
    moves. A robot that comes to rest, or starts from rest, changes gradually. Commands, channels with a few
    levels, and values that recur do not count as frozen.

    Parameters
    ----------
    time_s : ndarray, shape (n,)
        Strictly increasing, s.
    columns : mapping of str to ndarray, each shape (n,)
        NaN where missing.
    """
    found: dict[str, tuple[float, float]] = {}
    for name, values in columns.items():
        if not may_freeze(name, values):
            continue
        rows = np.flatnonzero(np.isfinite(values))
        x = values[rows]
        changes = np.flatnonzero(np.diff(x) != 0)
        first, end = np.append(0, changes + 1), np.append(changes, len(x) - 1)
        length = end - first + 1
        steps = np.abs(np.diff(x)[changes])
        usual, fine = float(np.median(steps)), rounding_ratio(x) < NEAR_ROUNDED
        for k in np.flatnonzero(length > LONG_HOLD * np.percentile(length, 95)):
            beside = [steps[j] for j in (k - 1, k) if 0 <= j < len(steps)]
            recurs = x[first[k]] == 0.0 or np.count_nonzero(x[first[length > 1]] == x[first[k]]) > 1
            stops = fine and len(beside) == 2 and min(beside) > usual and not recurs
            leaps = max(beside) > 2.0 * NEAR * usual and not (recurs and not OF_MOTION.fullmatch(name))
            if leaps or stops:
                stretch = float(time_s[rows[first[k]]]), float(time_s[rows[end[k]]])
                if stretch[1] - stretch[0] > np.subtract(*found.get(name, (0.0, 0.0))[::-1]):
                    found[name] = stretch
    return found


def _step_sizes(place: Array) -> Array:
    """Return a dimensionless size of each step between successive samples of a sensor, shape (n - 1,).

    The change of each channel is divided by the 95th percentile of the changes of that channel. The size of a
    step is the largest of these quotients over all channels.
    """
    steps = np.abs(np.diff(place, axis=0))
    missing = np.isnan(place)
    steps[missing[1:] & missing[:-1]] = 0.0
    steps[missing[1:] != missing[:-1]] = np.inf
    sizes = np.zeros(len(steps))
    for change in steps.T:
        moving = change[np.isfinite(change) & (change > 0)]
        if len(moving):
            sizes = np.maximum(sizes, change / np.percentile(moving, 95))
    return sizes


def _turns(place: Array) -> Flags:
    """Flag the steps at a turning point of all channels. They are small although no sample is repeated."""
    steps = np.diff(place, axis=0)
    before, after = steps[:-2], steps[2:]
    back = np.abs(before + after) <= TURN * (np.abs(before) + np.abs(after))
    turning = np.zeros(len(steps), dtype=bool)
    turning[1:-1] = (back | np.isnan(before + after)).all(axis=1) & (before != 0).any(axis=1)
    return turning


def rounding_ratio(values: Array) -> float:
    """Return the rounding step of a channel divided by its mean change per sample; inf if it is constant."""
    known = values[np.isfinite(values)]
    if len(known) == 0 or not np.ptp(known) > 0:
        return np.inf
    return (step_of(known) or quantum(known)) / float(np.mean(np.abs(np.diff(known))))


def _small(sizes: Array, ratio: float) -> Flags:
    """Flag the steps that are smaller than ``ratio`` times the step after them, and all steps of their size.

    A step is of their size if it is below the geometric mean of two medians: the median of the small steps,
    and the median of the large steps that follow them.
    """
    if ratio == 0.0:
        return sizes == 0.0
    edges = np.flatnonzero((sizes[:-1] < ratio * sizes[1:]) & np.isfinite(sizes[1:]))
    if not len(edges):
        return sizes == 0.0
    low, high = float(np.median(sizes[edges])), float(np.median(sizes[edges + 1]))
    return sizes <= np.sqrt(max(low, ratio**2 * high) * high)


def _remove_rests(time_s: Array, sizes: Array, small: Flags) -> Flags:
    """Return the flags of small steps without the steps during a rest of the robot.

    A rest is a long sequence of small steps that no large step follows.
    """
    fresh = np.concatenate(([True], ~small))
    if fresh.sum() < 3 or not small.any():
        return np.zeros_like(small)
    usual_s = float(np.median(np.diff(time_s[fresh])))
    usual = float(np.median(sizes[~small]))
    kept = small.copy()
    for first, end in runs(small):
        long = time_s[end] - time_s[first] > LONG_HOLD * usual_s
        if long and (end == len(sizes) or sizes[end] <= NEAR * usual):
            kept[first:end] = False
    return kept


def _time_repeats(time_s: Array, rows: NDArray[np.intp], repeated: Flags) -> Held:
    """Return the repeated samples of a log, with an estimate of the time at which each was measured."""
    fresh = rows[~repeated[rows]]
    stamps, step = time_s[fresh], usual_step(time_s)
    gaps = np.diff(stamps)
    period = float(np.mean(gaps[gaps <= LONG_HOLD * np.median(gaps)]))
    # Leave out the first stamp. If the log begins during repeats of a measurement, this stamp is late by more
    # than one time step.
    line = late_grid(stamps[1:], period, step)
    # Unevenly spaced stamps may agree with an evenly sampling sensor by chance, each with the probability
    # step / period. Accept an evenly sampling sensor only if chance agreement of all stamps together is
    # improbable.
    if line is None or (len(stamps) - 3) * np.log(line[0] / step) < -np.log(FALSE_ALARM_REPEATS):
        return Held(repeated, period, step, time_s, step / np.sqrt(12.0))
    period, measured, slack = line
    measured = np.append(measured[0] - period, measured)
    # Give each repeated sample the measurement time of the last new sample before it.
    shown = np.clip(np.searchsorted(fresh, np.arange(len(time_s)), side="right") - 1, 0, None)
    # The time of the last measurement, relative to the first, is uniformly distributed over an interval of
    # length ``slack``. Half of the variance of this time is assigned to each end of the record.
    return Held(repeated, period, step, measured[shown], slack / np.sqrt(24.0), even=True)


# ---------------------------------------------------------------- rate of change

#: Minimum number of samples in the window to which a cubic polynomial is fitted for a derivative. The
#: polynomial has 4 coefficients.
SLOPE_SAMPLES = 6


def slope(time_s: Array, values: Array, half_width_s: float) -> Array:
    """Return the time derivative of a channel from cubic polynomials fitted around each sample.

    Parameters
    ----------
    time_s, values : ndarray, shape (n,)
        Times, s, and samples. Uneven steps and NaN are allowed.
    half_width_s : float
        Half width of the fitted window, s. The window is enlarged if it would hold fewer than
        :data:`SLOPE_SAMPLES` samples.

    Returns
    -------
    ndarray, shape (n,)
        Derivative; NaN within half a window of the ends, and near a gap that leaves no samples on one side.

    Notes
    -----
    This is the filter of Savitzky and Golay (1964, doi:10.1021/ac60214a047), generalised to
    uneven sampling. To leading order the derivative of a sine of frequency f is multiplied by ``1 - (2 pi f
    h)^4 / 504``, with the half width h.

    >>> t = np.linspace(0.0, 1.0, 101)
    >>> float(np.round(slope(t, t**3, 0.05)[50], 9))
    0.75
    """
    there = np.flatnonzero(np.isfinite(values))
    t, x = time_s[there], values[there]
    rates = np.full(len(time_s), np.nan)
    if len(t) < SLOPE_SAMPLES:
        return rates
    half = max(half_width_s, 0.5 * SLOPE_SAMPLES * float(np.median(np.diff(t))))
    first = np.searchsorted(t, time_s - half * (1 + 1e-9))
    last = np.searchsorted(t, time_s + half * (1 + 1e-9), side="right")
    inside = (time_s >= t[0] + half * (1 - 1e-9)) & (time_s <= t[-1] - half * (1 - 1e-9))
    for i in np.flatnonzero(inside & (last - first >= SLOPE_SAMPLES)):
        near = (t[first[i] : last[i]] - time_s[i]) / half
        if near[0] > -0.3 or near[-1] < 0.3:
            continue
        weights = np.linalg.lstsq(np.vander(near, 4, increasing=True), x[first[i] : last[i]], rcond=None)[0]
        rates[i] = weights[1] / half
    return rates


# ---------------------------------------------------------------- times of a simulation

#: Default duration of a simulation, s.
DURATION_S = 15.0
#: Maximum number of samples or integration steps of a simulation.
MAX_SIMULATED_SAMPLES = 20_000_000


def even_times(duration_s: float, rate_hz: float, step_s: float = math.inf) -> Array:
    """Return the sample times of a simulation, s, from 0 to the last sample within its duration.

    Raises
    ------
    UsageError
        If there is no second sample, or if there are too many samples or integration steps.
    """
    if duration_s * rate_hz < 1.0:
        text = f"{duration_s:g} s at {rate_hz:g} samples a second are less than one sampling interval"
        raise UsageError(text, hint=f"take --sample-rate-hz {1.0 / duration_s:.3g} or more")
    if (count := duration_s * max(rate_hz, 1.0 / step_s)) > MAX_SIMULATED_SAMPLES:
        text = f"{duration_s:g} s at this rate and step are {count:.3g} samples; "
        text += f"{MAX_SIMULATED_SAMPLES:,} are allowed"
        raise UsageError(text, hint="shorten --duration-s, lower --sample-rate-hz, or raise --dt")
    return np.arange(math.floor(duration_s * rate_hz + 1e-9) + 1) / rate_hz
