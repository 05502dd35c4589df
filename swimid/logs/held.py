"""Samples that repeat the measurement before, in a log that is written faster than it is measured."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import special

from swimid.logs.log import runs
from swimid.logs.sampling import LONG_ENOUGH, has_levels, late_grid, quantum, step_of, usual_step

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

#: Ratios of a step to the next one below which it may be a repeat with jitter; 0 stands for exact repeats.
RATIOS = (0.0, 0.003, 0.01, 0.03, 0.1)
#: Probability that a log without repeats is said to have some.
FALSE_ALARM = 1e-3
#: A constant stretch longer than this many measurements is a rest or a frozen sensor. After a frozen sensor
#: the next sample is more than ``NEAR`` usual steps away.
LONG_HOLD, NEAR = 5.0, 3.0
#: Columns that are set or computed, not measured: commands, deviations and qualities.
SET = re.compile(r"cmd.*|.*_sd(_.*)?|.*likelihood|.*confidence")
#: A channel stops at once only where its rounding is less than this share of its mean step: a coarser one
#: stands between its steps.
NEAR_ROUNDED = 0.2
#: A smooth signal turns round at a step where the steps before and after cancel up to this share: twice the
#: largest of ``RATIOS``, because their mean is about the step between them.
TURN = 2.0 * RATIOS[-1]


@dataclass(frozen=True)
class Held:
    """Repeated samples of a log.

    Attributes
    ----------
    repeated : ndarray of bool, shape (n,)
        Samples that repeat the measurement before. The first sample of each measurement is not among them.
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
    """Find the samples that repeat the measurement before.

    A robot at rest is not a repeat. Neither is a counter that stands between its steps, nor a command of a
    few levels.

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


def find_frozen(time_s: Array, columns: Mapping[str, Array]) -> dict[str, tuple[float, float]]:
    """Return the longest stretch (start and end, s) over which each frozen channel holds one value.

    A channel is frozen where it holds one value for more than :data:`LONG_HOLD` times as long as it usually
    does, and either jumps there or from there, or stops at once amid its motion. A robot at rest comes to its
    rest and leaves it step by step. A command, a channel of a few levels and a value that recurs are not
    frozen.

    Parameters
    ----------
    time_s : ndarray, shape (n,)
        Strictly increasing, s.
    columns : mapping of str to ndarray, each shape (n,)
        NaN where missing.
    """
    found: dict[str, tuple[float, float]] = {}
    for name, values in columns.items():
        rows = np.flatnonzero(np.isfinite(values))
        x = values[rows]
        if SET.fullmatch(name) or len(x) < LONG_ENOUGH or has_levels(x):
            continue
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
    """Return the steps at which all channels turn round: samples on both sides of a peak are no repeats."""
    steps = np.diff(place, axis=0)
    before, after = steps[:-2], steps[2:]
    back = np.abs(before + after) <= TURN * (np.abs(before) + np.abs(after))
    turning = np.zeros(len(steps), dtype=bool)
    turning[1:-1] = (back | np.isnan(before + after)).all(axis=1) & (before != 0).any(axis=1)
    return turning


def _rounding_ratio(values: Array) -> float:
    """Return the quantum of a channel over its mean step."""
    known = values[np.isfinite(values)]
    mean = float(np.mean(np.abs(np.diff(known)))) if len(known) > 1 else 0.0
    return (step_of(known) or quantum(known)) / mean if mean > 0 else np.inf


def _small(sizes: Array, ratio: float) -> Flags:
    """Return the steps less than ``ratio`` times a neighbour, and all steps as small as those.

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
    """Return the small steps without those of long stretches from which the signal goes on where it was."""
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
    """Return repeated samples with the times of the measurements they show."""
    fresh = rows[~repeated[rows]]
    stamps, step = time_s[fresh], usual_step(time_s)
    gaps = np.diff(stamps)
    period = float(np.mean(gaps[gaps <= LONG_HOLD * np.median(gaps)]))
    # the log may begin amid a hold: the lateness of the first stamp has no limit of one step
    line = late_grid(stamps[1:], period, step)
    # uneven stamps fit an even sensor by chance, each with the probability step / period
    if line is None or (len(stamps) - 3) * np.log(line[0] / step) < -np.log(FALSE_ALARM):
        return Held(repeated, period, step, time_s, step / np.sqrt(12.0))
    period, measured, slack = line
    measured = np.append(measured[0] - period, measured)
    # a repeated sample shows the measurement of the fresh sample before it
    shown = np.clip(np.searchsorted(fresh, np.arange(len(time_s)), side="right") - 1, 0, None)
    # the last measurement moves evenly over the slack; each end has its half of the variance
    return Held(repeated, period, step, measured[shown], slack / np.sqrt(24.0), even=True)
