"""From time stamps to a constant rate: the sample time, missing samples and jumps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

#: A pause longer than this many sample times is a gap.
PAUSE = 6.0
#: A step within this share of a whole number of sample times lies on the grid.
ON_GRID = 0.15
#: Fewer steps on the grid than this share: the record is not uniformly sampled.
UNIFORM_SHARE = 0.8
#: Root-mean-square jitter, in sample times, from which on it is worth a warning.
NOTABLE_JITTER = 0.05
#: Ratio of neighbouring steps from which on stamps are uneven, and come in bursts, if more than a share
#: ``FEW_CHANGES`` of the steps have it. A single missing sample makes a ratio of 2.
UNEVEN, BURST, FEW_CHANGES = 2.0, 10.0, 0.1
#: Steps a record needs before its stamps may be explained by rounding.
LONG_ENOUGH = 20
#: A jump over more samples than this starts a new piece instead of being filled with NaN.
LONGEST_FILL = 1000
#: Steps that differ by less than this share are the same rate.
SAME_RATE = 0.01
#: A column with fewer distinct values than this, or than this share of its samples, holds
#: levels that were set, not a rounded continuous signal.
LEVELS, LEVEL_SHARE = 100, 0.05
#: Of a longer record the middle is enough to see how it swings.
LONGEST_SOUGHT = 1_000_000
#: Unless their last decimal is finer than this share of their range: nobody sets such levels, but
#: a computed signal that repeats itself (a sine of 20 samples a period) has them.
FINE = 1e-4


@dataclass(frozen=True)
class Rate:
    """The sampling of one record.

    Attributes
    ----------
    step_s : float
        Sample time, s.
    jitter : float
        Root-mean-square deviation of single steps from it, in sample times; 0 where every stamp
        is that of a uniform grid, rounded.
    on_grid : float
        Share of the steps that are a whole number of sample times within :data:`ON_GRID`.
    """

    step_s: float
    jitter: float
    on_grid: float

    @property
    def uniform(self) -> bool:
        """Whether a constant rate describes the record at all."""
        return self.on_grid >= UNIFORM_SHARE


def usual_step(time_s: np.ndarray) -> float:
    """Median step of a record, s, of its first samples where there are very many; NaN for one sample.

    >>> usual_step(np.array([0.0, 0.1, 0.2, 0.7]))
    0.1
    """
    steps = np.diff(time_s[:LONGEST_SOUGHT])
    return float(np.median(steps)) if len(steps) else float("nan")


def pauses(time_s: np.ndarray, step_s: float | None = None) -> np.ndarray:
    """Samples after which there is none for longer than :data:`PAUSE` sample times."""
    steps = np.diff(time_s) if len(time_s) > 2 else np.empty(0)
    return np.flatnonzero(steps > PAUSE * (usual_step(time_s) if step_s is None else step_s))


def find_uneven(time_s: np.ndarray) -> tuple[str, bool]:
    """Return how a record departs from even sampling, in words, and whether its stamps come in bursts.

    Missing samples, pauses and a rate that changes slowly are no departure. Stamps in bursts tell when
    samples arrived, not when they were taken.

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
    """An unbroken stretch on a grid of constant rate.

    Attributes
    ----------
    time_s : ndarray, shape (n,)
        Time of every grid point; the measured stamp where there is a sample.
    rows : ndarray of int, shape (n,)
        Row of the record each grid point came from, -1 for a sample that is missing.
    """

    time_s: np.ndarray
    rows: np.ndarray

    def take(self, column: np.ndarray) -> np.ndarray:
        """A column of the record on this grid, NaN where the sample is missing."""
        return np.where(self.rows >= 0, np.asarray(column, dtype=float)[self.rows], np.nan)


def rate(time_s: np.ndarray) -> Rate:
    """Sample time and regularity of a record.

    Parameters
    ----------
    time_s : ndarray, shape (n,), n >= 2
        Strictly increasing, s.

    >>> rate(np.array([0.0, 0.1, 0.2, 0.4, 0.5])).step_s
    0.1
    """
    steps = np.diff(np.asarray(time_s, dtype=float))
    typical = float(np.median(steps))
    plain = _plain_rate(steps, typical)
    if len(steps) < LONG_ENOUGH:
        return plain  # a missing sample and a coarse rounding look the same
    line = _rounded_grid(time_s, (float(np.mean(steps)), typical))
    return plain if line is None else Rate(float(f"{line[0]:.10g}"), 0.0, 1.0)


def _plain_rate(steps: np.ndarray, typical: float) -> Rate:
    # The mean of the ordinary steps: stamps rounded to milliseconds have a biased median.
    typical = float(np.mean(steps[np.abs(steps - typical) <= 0.5 * typical]))
    typical = float(f"{typical:.10g}")
    relative = steps / typical
    whole = np.maximum(np.round(relative), 1)
    off = np.abs(relative - whole)
    single = off[(whole == 1) & (off < 0.5)]
    jitter = float(np.sqrt(np.mean(single**2))) if len(single) else 0.0
    return Rate(typical, jitter, float(np.mean((off <= ON_GRID) & (whole <= 10))))


def late_grid(time_s: np.ndarray, step_s: float, lateness_s: float) -> tuple[float, np.ndarray, float] | None:
    """Return the step and the times of an even sensor whose samples are stamped late.

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
        Time by which the last could move against the first, s. None in place of all where no even times fit.
    """
    from scipy import optimize

    first = np.arange(-0.5, 0.6, 0.25) * lateness_s
    lines = (_rounded_grid(time_s + late, (step_s,), lateness_s, time_s[0]) for late in first)
    fits = [line for line in lines if line is not None]
    if not fits:
        return None
    # of the steps that fit the longest: it needs the fewest missing samples
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
    numbers is fitted on a growing part of the record, so that the guess must be good for a few samples only.
    The result is None where some stamp lies farther from the grid than its rounding.
    """
    time_s = np.asarray(time_s, dtype=float)
    n, unit = len(time_s), quantum(time_s) if unit is None else unit
    for start in starts if n >= 3 and unit > 0 else ():
        step, origin = float(start), float(time_s[0] if first_s is None else first_s)
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
            continue  # any rounded stamps lie on the grid of their unit, with many samples missing
        off = time_s - origin - step * number
        # The line is fitted: its own error comes on top of half a unit.
        if np.ptp(off) <= unit * (1 + 4 / np.sqrt(n)) + 1e-9 * step:
            return step, number.astype(int)
    return None


def pieces(time_s: np.ndarray, step_s: float) -> list[Piece]:
    """Lay a record on a grid, and cut it where the time jumps off that grid.

    Parameters
    ----------
    time_s : ndarray, shape (n,)
        Strictly increasing, s.
    step_s : float
        Sample time.

    Returns
    -------
    list of Piece
        More than one where the time jumps by no whole number of samples, or by more than
        :data:`LONGEST_FILL`. Shorter jumps become missing samples within a piece.
    """
    time_s = np.asarray(time_s, dtype=float)
    line = _rounded_grid(time_s, (step_s,))
    if line is not None and abs(line[0] / step_s - 1) < SAME_RATE:
        # Single steps may be far off a whole number of samples; the stamps are not.
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
    """Steps that with a neighbour make a whole number: one stamp is off, the samples are not."""
    pair = relative[:-1] + relative[1:]
    whole = (np.abs(pair - np.round(pair)) <= ON_GRID) & (np.round(pair) == 2)
    return np.append(whole, False) | np.append(False, whole)


def rounding(values: Sequence[float] | np.ndarray) -> float:
    """Step to which a continuous signal was rounded, 0 for a signal that is exact.

    A commanded input of a few levels (binary, steps, stairs) means exactly what is written,
    however few decimals it has; only a column of many distinct values, or of many decimals, is
    taken as rounded.

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
    """Return whether a channel comes back again and again to a few levels, or is constant.

    >>> has_levels(np.tile([0.0, 0.0, 1.0, 1.0, 2.0, 1.0], 50)), has_levels(np.sin(np.arange(300.0)))
    (True, False)
    """
    known = values[np.isfinite(values)]
    levels, visits = len(np.unique(known)), 1 + np.count_nonzero(np.diff(known))
    return bool(levels < 4 or levels < min(LEVELS, LEVEL_SHARE * len(known), 0.5 * visits))


def step_of(values: np.ndarray) -> float | None:
    """The step all values are multiples of (up to 0.1 % of it), or None.

    >>> step_of(np.array([0.0, 0.0, 0.5, 1.0, 1.0, 1.5, 3.0]))
    0.5
    """
    values = np.unique(values[np.isfinite(values)])
    if len(values) < 4:
        return None
    gaps = np.diff(values)
    step = float(np.median(gaps[gaps < 1.5 * gaps.min()]))
    count = np.round((values - values[0]) / step)
    # the step itself to more digits, from the whole range
    step = float((values[-1] - values[0]) / count[-1]) if count[-1] > 0 else step
    return step if np.max(np.abs((values - values[0]) / step - count)) < 0.02 else None


def quantum(values: Sequence[float] | np.ndarray) -> float:
    """Step of the last decimal place the values were written with, 0 when there is none.

    Logs hold rounded decimals; below their last place the data say nothing.

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
    """The longest stretch of a channel without a gap, on even steps.

    Parameters
    ----------
    time_s, values : ndarray, shape (n,)
        Strictly increasing times; NaN where missing.
    fastest_hz : float
        A faster channel is averaged down to this rate. Of more samples than :data:`LONGEST_SOUGHT` those
        in the middle are looked at.
    most : int
        Samples that are enough; a longer stretch is cut.

    Returns
    -------
    time_s, values : ndarray, shape (m,)
        Empty where no two samples are there. Pauses up to six sample times are bridged by straight
        lines, so that a spectrum can be taken; nothing else should be read off them.
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
        return t, x  # as they are: between the samples of a signal that jumps there is nothing
    return even, np.interp(even, t, x)


def white_noise_sd(values: np.ndarray, least: float) -> float:
    """Standard deviation of a channel's white noise, from its third differences (robust).

    The variance of a third difference of white noise is 20 times its own.

    Parameters
    ----------
    values : ndarray, shape (n,)
        Evenly sampled, NaN where missing.
    least : float
        What it is at least, and where the samples are too few to tell.
    """
    if len(values) < 4:
        return least
    there = np.isfinite(values)
    runs = np.convolve(there, np.ones(4), "valid") == 4
    third = np.diff(np.nan_to_num(values), n=3)[runs]
    if len(third) < 8:
        return least
    return max(float(np.median(np.abs(third))) / 0.6745 / np.sqrt(20), least)
