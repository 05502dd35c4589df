"""Sample times and samples of a record: its rate, gaps, repeats, rounding, noise and rates of change."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from swimid.logs.log import TIME, runs
from swimid.logs.units import measured

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
#: Minimum length of a gap, in sample times. A shorter pause is no gap.
PAUSE = 6.0
#: Maximum distance of a step from a whole number of sample times, as a share of one, for a step on the grid.
ON_GRID = 0.15
#: Minimum share of steps on the grid in a uniformly sampled record.
UNIFORM_SHARE = 0.8
#: Minimum root-mean-square jitter, in sample times, that deserves a warning.
NOTABLE_JITTER = 0.05
#: Minimum ratio of neighbouring steps in uneven sampling, and in bursts, if more than the share
#: ``FEW_CHANGES`` of the steps has that ratio. A single missing sample makes a ratio of 2.
UNEVEN, BURST, FEW_CHANGES = 2.0, 10.0, 0.1
#: Minimum number of steps of a record for a judgement of its sampling. In fewer steps a missing sample and a
#: coarse rounding look the same.
LONG_ENOUGH = 20
#: Maximum number of missing samples within one piece of a record. A longer jump starts a new piece.
LONGEST_FILL = 1000
#: Maximum relative difference of two sample times at the same rate.
SAME_RATE = 0.01
#: Minimum number of distinct values of a continuous signal, and its minimum share of the samples. A column
#: with fewer holds levels that were set.
LEVELS, LEVEL_SHARE = 100, 0.05
#: Maximum number of samples that are searched for a motion. Of a longer record the middle is searched.
LONGEST_SOUGHT = 1_000_000
#: Maximum last decimal place of a computed signal that repeats itself, as a share of its range. Such a signal
#: (a sine of 20 samples per period) has few distinct values, but set levels are coarser.
FINE = 1e-4


@dataclass(frozen=True)
class Rate:
    """The sampling of one record.

    Attributes
    ----------
    step_s : float
        Sample time, s.
    jitter : float
        Root-mean-square deviation of single steps from the sample time, in sample times. It is 0 if every
        stamp is a rounded point of a uniform grid.
    on_grid : float
        Share of the steps that are a whole number of sample times within :data:`ON_GRID`.
    """

    step_s: float
    jitter: float
    on_grid: float

    @property
    def uniform(self) -> bool:
        """Whether a constant rate describes the record."""
        return self.on_grid >= UNIFORM_SHARE


def usual_step(time_s: np.ndarray) -> float:
    """Return the median step of a record, s; NaN for one sample.

    Of a long record the first :data:`LONGEST_SOUGHT` samples are used.

    >>> usual_step(np.array([0.0, 0.1, 0.2, 0.7]))
    0.1
    """
    if len(time_s) < 2:
        return float("nan")
    return float(np.median(np.diff(time_s[:LONGEST_SOUGHT])))


def pauses(time_s: np.ndarray, step_s: float | None = None) -> np.ndarray:
    """Return the index of the last sample before each pause of more than :data:`PAUSE` sample times.

    By default the sample time is the usual step. A record of two samples has no pause.
    """
    if len(time_s) <= 2:
        return np.empty(0, dtype=np.intp)
    if step_s is None:
        step_s = usual_step(time_s)
    return np.flatnonzero(np.diff(time_s) > PAUSE * step_s)


def find_uneven(time_s: np.ndarray) -> tuple[str, bool]:
    """Return how a record departs from even sampling, in words, and whether its stamps come in bursts.

    The words are empty for even sampling. Missing samples, pauses and a slowly changing rate count as even.
    Stamps in bursts show when samples arrived, and not when they were taken.

    >>> find_uneven(np.cumsum(np.tile([137e-6, 19863e-6], 100)))[1], find_uneven(np.arange(50) / 7.0)
    (True, ('', False))
    """
    steps = np.diff(time_s)
    if len(steps) < LONG_ENOUGH:
        return "", False
    ratio = np.maximum(steps[1:] / steps[:-1], steps[:-1] / steps[1:])
    bursts = bool(np.mean(ratio > BURST) > FEW_CHANGES)
    if not bursts and (rate(time_s).uniform or np.mean(ratio > UNEVEN) <= FEW_CHANGES):
        return "", False
    low, middle, high = (f"{1e3 * step:.4g}" for step in np.percentile(steps, [5, 50, 95]))
    return f"the steps are {low} to {high} ms (5 to 95 %), {middle} ms in the median", bursts


@dataclass(frozen=True)
class Piece:
    """A part of a record on a grid of constant rate.

    Attributes
    ----------
    time_s : ndarray, shape (n,)
        Time of each grid point, s. It is the stamp of the sample if there is one.
    rows : ndarray of int, shape (n,)
        Row of the record for each grid point; -1 for a missing sample.
    """

    time_s: np.ndarray
    rows: np.ndarray

    def take(self, column: np.ndarray) -> np.ndarray:
        """Return a column of the record on this grid, shape (n,), with NaN for missing samples."""
        return np.where(self.rows >= 0, np.asarray(column, dtype=float)[self.rows], np.nan)


def rate(time_s: np.ndarray) -> Rate:
    """Return the sample time and the regularity of a record.

    Parameters
    ----------
    time_s : ndarray, shape (n,), n >= 2
        Strictly increasing, s.

    >>> rate(np.array([0.0, 0.1, 0.2, 0.4, 0.5])).step_s
    0.1
    """
    steps = np.diff(np.asarray(time_s, dtype=float))
    median = float(np.median(steps))
    if len(steps) >= LONG_ENOUGH:
        line = _rounded_grid(time_s, (float(np.mean(steps)), median))
        if line is not None:
            return Rate(float(f"{line[0]:.10g}"), 0.0, 1.0)
    # the median of stamps rounded to milliseconds is biased, the mean of the ordinary steps is not
    typical = float(f"{np.mean(steps[np.abs(steps - median) <= 0.5 * median]):.10g}")
    relative = steps / typical
    whole = np.maximum(np.round(relative), 1)
    off = np.abs(relative - whole)
    single = off[(whole == 1) & (off < 0.5)]
    jitter = float(np.sqrt(np.sum(single**2) / max(len(single), 1)))
    return Rate(typical, jitter, float(np.mean((off <= ON_GRID) & (whole <= 10))))


def late_grid(time_s: np.ndarray, step_s: float, lateness_s: float) -> tuple[float, np.ndarray, float] | None:
    """Return the step and the times of an even sensor whose samples are stamped late; None if no times fit.

    Parameters
    ----------
    time_s : ndarray, shape (n,)
        Strictly increasing stamps, s.
    step_s : float
        First guess of the sensor's step, s.
    lateness_s : float
        Maximum time from a measurement to its stamp, s.

    Returns
    -------
    step_s : float
    measured_s : ndarray, shape (n,)
        The latest even times that no stamp precedes, s.
    slack_s : float
        Time by which the last measurement can move against the first, s.
    """
    from scipy import optimize

    first = np.arange(-0.5, 0.6, 0.25) * lateness_s
    lines = (_rounded_grid(time_s + late, (step_s,), lateness_s, time_s[0]) for late in first)
    fits = [line for line in lines if line is not None]
    if not fits:
        return None
    # take the longest step that fits: it needs the fewest missing samples
    step, number = max(fits, key=lambda line: line[0])
    reach = 4.0 * lateness_s / number[-1]

    def excess(one: float) -> float:
        return float(np.ptp(time_s - one * number)) - lateness_s

    # the excess is convex in the step; even times fit where it is not positive
    bounds = step - reach, step + reach
    best = optimize.minimize_scalar(excess, bounds=bounds, method="bounded", options={"xatol": 1e-6 * reach})
    if best.fun >= 0.0 or min(excess(bound) for bound in bounds) <= 0.0:
        low = high = float(best.x)
    else:
        low, high = (float(optimize.brentq(excess, best.x, bound)) for bound in bounds)
    step = 0.5 * (low + high)
    return step, step * number + np.min(time_s - step * number), (high - low) * float(number[-1])


def _rounded_grid(
    time_s: np.ndarray, starts: Sequence[float], unit: float | None = None, first_s: float | None = None
) -> tuple[float, np.ndarray] | None:
    """Return step and sample numbers of a uniform grid whose rounded times are these stamps.

    ``starts`` are guesses of the step, ``unit`` is the rounding (default: the last decimal place) and
    ``first_s`` is a guess of the first grid point (default: the first stamp). The line through stamps and
    numbers is fitted to a growing part of the record, so that the guess must be good for a few samples only.
    The result is None if any stamp lies farther from the grid than its rounding.
    """
    time_s = np.asarray(time_s, dtype=float)
    n = len(time_s)
    if unit is None:
        unit = quantum(time_s)
    if n < 3 or unit <= 0:
        return None
    if first_s is None:
        first_s = time_s[0]
    for start in starts:
        step, origin = float(start), float(first_s)
        size = min(n, 8)
        while True:
            part = time_s[:size]
            for _ in range(3):
                number = np.round((part - origin) / step)
                if np.any(np.diff(number) < 1):
                    break
                centre = number.mean()
                step = float((number - centre) @ part / np.sum((number - centre) ** 2))
                origin = float(part.mean() - step * centre)
            if size == n or np.any(np.diff(number) < 1):
                break
            size = min(n, size + size // 2)
        if np.any(np.diff(number) < 1) or unit > step * (1 + 1e-6):
            continue
        if np.mean(np.diff(number) == 1) < UNIFORM_SHARE:
            continue  # on the grid of their unit all rounded stamps lie, with many samples missing
        off = time_s - origin - step * number
        # the error of the fitted line adds to the rounding
        if np.ptp(off) <= unit * (1 + 4 / np.sqrt(n)) + 1e-9 * step:
            return step, number.astype(int)
    return None


def pieces(time_s: np.ndarray, step_s: float) -> list[Piece]:
    """Return a record as pieces on a grid, cut where the time leaves that grid.

    Parameters
    ----------
    time_s : ndarray, shape (n,)
        Strictly increasing, s.
    step_s : float
        Sample time.

    Returns
    -------
    list of Piece
        A new piece begins where the time jumps by no whole number of samples, or by more than
        :data:`LONGEST_FILL` samples. Shorter jumps become missing samples within a piece.
    """
    time_s = np.asarray(time_s, dtype=float)
    line = _rounded_grid(time_s, (step_s,))
    if line is not None and abs(line[0] / step_s - 1) < SAME_RATE:
        # rounded stamps lie on the grid even if single steps are far from a whole number of samples
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
    """Return the steps that make two sample times with a neighbour: only the stamp between them is off."""
    pair = relative[:-1] + relative[1:]
    whole = (np.abs(pair - np.round(pair)) <= ON_GRID) & (np.round(pair) == 2)
    return np.append(whole, False) | np.append(False, whole)


def rounding(values: Sequence[float] | np.ndarray) -> float:
    """Return the step to which a continuous signal was rounded; 0 for an exact signal.

    A commanded input of a few levels (binary, steps, stairs) is exact, however few decimals it has. A column
    counts as rounded only if it has many distinct values or many decimals.

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
    """Return whether a channel is constant or returns repeatedly to a few levels.

    >>> has_levels(np.tile([0.0, 0.0, 1.0, 1.0, 2.0, 1.0], 50)), has_levels(np.sin(np.arange(300.0)))
    (True, False)
    """
    known = values[np.isfinite(values)]
    levels, visits = len(np.unique(known)), 1 + np.count_nonzero(np.diff(known))
    return bool(levels < 4 or levels < min(LEVELS, LEVEL_SHARE * len(known), 0.5 * visits))


def step_of(values: np.ndarray) -> float | None:
    """Return the step of which all values are multiples, to 2 % of a step; None if there is none.

    Fewer than four distinct values have no step.

    >>> step_of(np.array([0.0, 0.0, 0.5, 1.0, 1.0, 1.5, 3.0]))
    0.5
    """
    values = np.unique(values[np.isfinite(values)])
    if len(values) < 4:
        return None
    gaps = np.diff(values)
    step = float(np.median(gaps[gaps < 1.5 * gaps.min()]))
    count = np.round((values - values[0]) / step)
    if count[-1] > 0:
        # the whole range gives more digits
        step = float((values[-1] - values[0]) / count[-1])
    return step if np.max(np.abs((values - values[0]) / step - count)) < 0.02 else None


def quantum(values: Sequence[float] | np.ndarray) -> float:
    """Return the last decimal place of written values as a step; 0 if they are not rounded.

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
    """Return the longest part of a channel without a gap, on even steps, for a spectrum.

    Parameters
    ----------
    time_s, values : ndarray, shape (n,)
        Strictly increasing times; NaN where missing.
    fastest_hz : float
        Maximum rate, Hz. A faster channel is averaged. Of more samples than :data:`LONGEST_SOUGHT` the middle
        is used.
    most : int
        Maximum number of samples that are returned.

    Returns
    -------
    time_s, values : ndarray, shape (m,)
        Empty for fewer than two samples. Pauses up to :data:`PAUSE` sample times are bridged by straight
        lines, which suits a spectrum and nothing else.
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
        return t, x  # interpolation would smear a signal that jumps
    return even, np.interp(even, t, x)


def white_noise_sd(values: np.ndarray, least: float) -> float:
    """Return the standard deviation of the white noise of a channel, from its third differences (robust).

    The variance of a third difference of white noise is 20 times that of the noise.

    Parameters
    ----------
    values : ndarray, shape (n,)
        Evenly sampled, NaN where missing.
    least : float
        Minimum of the result, which is also returned for too few samples.
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

#: Maximum ratios of a step to the next one for a repeat with jitter; 0 stands for exact repeats.
RATIOS = (0.0, 0.003, 0.01, 0.03, 0.1)
#: Probability of finding repeats in a log without repeats.
FALSE_ALARM = 1e-3
#: Minimum length of a rest or of a frozen sensor, in measurements, and maximum distance, in usual steps, of
#: the next sample after a rest. After a frozen sensor it is larger.
LONG_HOLD, NEAR = 5.0, 3.0
#: Columns that are set or computed, and not measured: commands, deviations and qualities.
SET = re.compile(r"cmd.*|.*_sd(_.*)?|.*likelihood|.*confidence")
#: Maximum rounding of a channel, as a share of its mean step, for a stop to be seen. A coarser channel stands
#: still between its steps.
NEAR_ROUNDED = 0.2
#: Maximum relative sum of the steps before and after a turning point of a smooth signal. It is twice the
#: largest of ``RATIOS``, because the mean of both steps is about the step between them.
TURN = 2.0 * RATIOS[-1]


@dataclass(frozen=True)
class Held:
    """Repeated samples of a log.

    Attributes
    ----------
    repeated : ndarray of bool, shape (n,)
        Samples that repeat the previous measurement, without the first sample of each measurement.
    period_s : float
        Mean time between measurements, s. Without repeats it is the usual step of the log.
    lateness_s : float
        Maximum time from a measurement to the stamp of its first sample, s: one step of the log, and 0
        without repeats.
    measured_s : ndarray, shape (n,)
        Estimated time of the measurement that each sample shows, s, up to a constant offset. It equals the
        stamps where the measurements are not evenly spaced.
    measured_sd_s : float
        Standard deviation of ``measured_s`` about the true times and the constant offset, s.
    even : bool
        Whether measurements at an even rate explain all stamps.
    """

    repeated: Flags
    period_s: float
    lateness_s: float
    measured_s: Array
    measured_sd_s: float
    even: bool = False


def find_held(time_s: Array, channels: Sequence[Array]) -> Held:
    """Find the samples that repeat the previous measurement.

    A robot at rest is no repeat, nor a counter between its steps, nor a command of a few levels.

    Parameters
    ----------
    time_s : ndarray, shape (n,)
        Strictly increasing, s.
    channels : sequence of ndarray, each shape (n,)
        The channels of one sensor in any units: a repeat repeats all of them. NaN where missing.

    Notes
    -----
    The size of a step is the largest change of a channel over its 95th percentile. Let a signal without
    repeats have independent normal steps. Then a step is less than ``r`` times the next one with probability
    ``2/pi atan(r)`` in one channel, and less often in several. A smooth signal has fewer such steps: they
    occur at its turning points. Rounding to a quantum ``q`` adds equal samples as a ratio ``q / m`` does,
    where ``m`` is the mean step. More small steps than a binomial distribution allows are repeats. The
    measurements of an even sensor lie on a line over their number, at most one step of the log before their
    stamps.

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
    expected = min(_rounding_ratio(values) for values in continuous)
    turning = _turns(place[rows])
    best, chosen = np.log(FALSE_ALARM / len(RATIOS)), None
    for ratio in RATIOS:
        small = _small(sizes, ratio)
        small = _without_rests(time_s[rows], sizes, small)
        counted = small & ~turning
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
    return _timed(time_s, rows, repeated)


def may_freeze(name: str, values: Array) -> bool:
    """Return whether a channel is measured, continuous, and long enough to show that it is frozen."""
    known = values[np.isfinite(values)]
    return not SET.fullmatch(name) and len(known) >= LONG_ENOUGH and not has_levels(known)


def find_frozen(time_s: Array, columns: Mapping[str, Array]) -> dict[str, tuple[float, float]]:
    """Return the longest stretch (start and end, s) over which each frozen channel holds one value.

    A frozen channel holds one value for more than :data:`LONG_HOLD` times as long as it usually does. It also
    jumps to or from that value, or stops suddenly while it moves. A robot comes to rest and leaves its rest
    step by step. A command, a channel of a few levels and a value that recurs are not frozen.

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
        usual, fine = float(np.median(steps)), _rounding_ratio(x) < NEAR_ROUNDED
        for k in np.flatnonzero(length > LONG_HOLD * np.percentile(length, 95)):
            beside = [steps[j] for j in (k - 1, k) if 0 <= j < len(steps)]
            recurs = x[first[k]] == 0.0 or np.count_nonzero(x[first[length > 1]] == x[first[k]]) > 1
            stops = fine and len(beside) == 2 and min(beside) > usual and not recurs
            if max(beside) > 2.0 * NEAR * usual or stops:
                stretch = float(time_s[rows[first[k]]]), float(time_s[rows[end[k]]])
                if stretch[1] - stretch[0] > np.subtract(*found.get(name, (0.0, 0.0))[::-1]):
                    found[name] = stretch
    return found


def _step_sizes(place: Array) -> Array:
    """Return the size of each step: the largest change of a channel over the channel's large steps."""
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
    """Return the steps at which all channels turn round. Samples on both sides of a peak are no repeats."""
    steps = np.diff(place, axis=0)
    before, after = steps[:-2], steps[2:]
    back = np.abs(before + after) <= TURN * (np.abs(before) + np.abs(after))
    turning = np.zeros(len(steps), dtype=bool)
    turning[1:-1] = (back | np.isnan(before + after)).all(axis=1) & (before != 0).any(axis=1)
    return turning


def _rounding_ratio(values: Array) -> float:
    """Return the quantum of a channel over its mean step."""
    known = values[np.isfinite(values)]
    if len(known) == 0 or not np.ptp(known) > 0:
        return np.inf
    return (step_of(known) or quantum(known)) / float(np.mean(np.abs(np.diff(known))))


def _small(sizes: Array, ratio: float) -> Flags:
    """Return the steps below ``ratio`` times a neighbour, and all other steps of that size.

    The limit lies midway, on a logarithmic scale, between the small steps and the large steps beside them.
    """
    if ratio == 0.0:
        return sizes == 0.0
    edges = np.flatnonzero((sizes[:-1] < ratio * sizes[1:]) & np.isfinite(sizes[1:]))
    if not len(edges):
        return sizes == 0.0
    low, high = float(np.median(sizes[edges])), float(np.median(sizes[edges + 1]))
    return sizes <= np.sqrt(max(low, ratio**2 * high) * high)


def _without_rests(time_s: Array, sizes: Array, small: Flags) -> Flags:
    """Return the small steps without those of rests, after which the signal goes on where it was."""
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


def _timed(time_s: Array, rows: NDArray[np.intp], repeated: Flags) -> Held:
    """Return the repeated samples with the times of their measurements."""
    fresh = rows[~repeated[rows]]
    stamps, step = time_s[fresh], usual_step(time_s)
    gaps = np.diff(stamps)
    period = float(np.mean(gaps[gaps <= LONG_HOLD * np.median(gaps)]))
    # the log may begin within a hold: the first stamp can be late by more than one step
    line = late_grid(stamps[1:], period, step)
    # each uneven stamp fits an even sensor by chance with the probability step / period
    if line is None or (len(stamps) - 3) * np.log(line[0] / step) < -np.log(FALSE_ALARM):
        return Held(repeated, period, step, time_s, step / np.sqrt(12.0))
    period, measured, slack = line
    measured = np.append(measured[0] - period, measured)
    # a repeated sample shows the measurement of the fresh sample before it
    shown = np.clip(np.searchsorted(fresh, np.arange(len(time_s)), side="right") - 1, 0, None)
    # the last measurement is uniform over the slack; half of the variance belongs to each end
    return Held(repeated, period, step, measured[shown], slack / np.sqrt(24.0), even=True)


# ---------------------------------------------------------------- channels that are no measurement

#: Minimum distance of a mark of missing samples, or of an error, from all other values, in ranges of these.
FAR = 10.0
#: Minimum number of samples in a stretch at the largest or smallest value, and minimum number of such
#: stretches, of a channel that is cut off.
CUT_SAMPLES, CUT_TIMES = 3, 3
#: Relative tolerance of the steps of a column that counts the rows.
COUNT_RTOL = 1e-6
#: Two names of the turn rate about the vertical, whose columns may be equal.
SYNONYMS = {"wz_rad_s", "yaw_rate_rad_s"}


def find_unmeasured(columns: Mapping[str, Array], scales: Mapping[str, float]) -> dict[str, str]:
    """Return the channels with values that a working sensor does not give, each with what is wrong.

    Such a channel is constant, counts the rows, equals another column, is cut off at a value, or holds a
    value far from all others. Commands, deviations and qualities are not looked at, nor channels with fewer
    than :data:`LONG_ENOUGH` values.

    Parameters
    ----------
    columns : mapping of str to ndarray, each shape (n,)
        Columns of a log, ``t_s`` among them; NaN where missing.
    scales : mapping of str to float
        Factor from the values in the file to those of a column.

    Examples
    --------
    >>> t = np.arange(50) / 10
    >>> find_unmeasured({"t_s": t, "depth_m": 0 * t + 1.2}, {})
    {'depth_m': 'holds one value in every sample (1.2)'}
    """
    found: dict[str, str] = {}
    earlier: dict[str, Array] = {}
    for name, values in columns.items():
        known = values[np.isfinite(values)]
        if len(known) < LONG_ENOUGH or SET.fullmatch(name) or measured(name) is None:
            continue
        equal = [other for other, same in earlier.items() if np.array_equal(values, same, equal_nan=True)]
        copied = [other for other in equal if {name, other} != SYNONYMS]
        steps = np.diff(known) / scales.get(name, 1.0)
        if name == TIME:
            text = ""
        elif not steps.any():
            text = f"holds one value in every sample ({known[0]:.6g})"
        elif copied:
            text = f"equals {copied[0]} in every sample"
        elif np.allclose(steps, 1.0, rtol=COUNT_RTOL):
            text = "counts the rows"
        else:
            text = _find_far(known) or _find_cut(known)
        if text:
            found[name] = text
        if "_raw_" not in name:
            earlier[name] = values
    return found


def _find_far(known: Array) -> str:
    """Return how the largest or smallest value lies far from all others; empty if none does."""
    for extreme in (known.min(), known.max()):
        others = known[known != extreme]
        away = float(np.min(np.abs(others - extreme)))
        if away > FAR * np.ptp(others) > 0:
            count = len(known) - len(others)
            return f"holds {extreme:.6g} in {count} samples, far from all others: missing samples?"
    return ""


def _find_cut(known: Array) -> str:
    """Return the value at which a channel is cut off, in words; empty for a coarsely rounded channel."""
    if has_levels(known) or _rounding_ratio(known) > NEAR_ROUNDED:
        return ""
    for extreme in (known.min(), known.max()):
        held = np.diff(runs(known == extreme)).ravel()
        if np.count_nonzero(held >= CUT_SAMPLES) >= CUT_TIMES:
            return f"is cut off at {extreme:.6g}"
    return ""


# ---------------------------------------------------------------- rate of change

#: Minimum number of samples in the window of a cubic, which has 4 coefficients.
SLOPE_SAMPLES = 6


def slope(time_s: Array, values: Array, half_width_s: float) -> Array:
    """Return the derivative by a cubic fitted to the samples around each instant.

    Parameters
    ----------
    time_s, values : ndarray, shape (n,)
        Uneven steps and NaN are allowed.
    half_width_s : float
        Half width of the fitted window, s. It is enlarged if the window would hold fewer than
        :data:`SLOPE_SAMPLES` samples.

    Returns
    -------
    ndarray, shape (n,)
        NaN within half a window of the ends, and beside a gap that leaves no samples on one side.

    Notes
    -----
    This is the filter of Savitzky and Golay (1964) for any sampling. To leading order a sine of frequency f
    has the gain ``1 - (2 pi f h)^4 / 504``, with the half width h.

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
