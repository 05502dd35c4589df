"""Logs that are written faster than their input or output is measured, at the rate of the measurements."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from swimid.fitting import residual_tests as rt
from swimid.logs.log import TIME, Log
from swimid.logs.sampling import SAME_RATE, Held, find_held, quantum, step_of, usual_step
from swimid.notices import warn

Array = np.ndarray
#: Share of the measurements that must last for the same number of samples: a logger slips now and then.
REGULAR_SHARE = 0.9
#: Median change of a signal, in rounding steps, below which rounding alone repeats many samples.
COARSE_STEPS = 5.0


@dataclass(frozen=True)
class _Even:
    """Rows of a column's measurements, their times (s), and the time between them."""

    rows: Array
    times_s: Array
    period_s: float


def at_own_rate(log: Log, source: str | None, output: str) -> tuple[Log, list[str]]:
    """Return a log at the rate at which its input and output are measured.

    With it comes a sentence for each column that repeated its samples.

    A discrete-time model of a log in which each measurement is written several times describes the logger:
    its poles are wrong. Cells that are filled in every n-th row only are brought to their own rate, too. An
    input of a few levels, or of independent levels, is a command that is constant by design, and stays.

    Parameters
    ----------
    log : Log
        Columns ``source`` (None for a computed input) and ``output``.

    Notes
    -----
    The slower of two columns sets the rate. The output keeps the first sample of each measurement. The input
    of each row is its mean until the next row, which is the input of a zero-order hold. Where measurements
    come at no even rate, the repeated samples are emptied instead.
    """
    repeats, slowest, emptied = [], None, {}
    for column in (output, source):
        if column is None:
            continue
        values = log[column]
        held = find_held(log.time_s, [values])
        empty = np.isnan(values)
        if column == source and _is_designed(values[~held.repeated & ~empty]):
            continue
        even = _even_times(log.time_s, values, held)
        if even is None and (column == source or not _is_lossy(values[~empty], held.repeated[~empty])):
            continue
        what = "repeat the measurement before" if held.repeated.any() else "are empty"
        text = f"{int(np.sum(held.repeated | empty))} of {len(log)} samples of {column} {what}"
        if even is None:
            emptied[column] = np.where(held.repeated, np.nan, values)
            text += f" at no even rate: they are left out, and the others may be {held.lateness_s:.6g} s late"
        else:
            text += f": it is measured every {even.period_s:.6g} s, and the model is fitted at that rate"
            if slowest is None or even.period_s > (1 + SAME_RATE) * slowest[1].period_s:
                slowest = (column, even)
        warn("SWM058", f"{log.path.name}: {text}; log each measurement once, with its own time")
        repeats.append(text)
    if emptied:
        log = replace(log, columns={**log.columns, **emptied})
    if slowest is not None:
        log = _resampled(log, slowest[1], source, slowest[0] == source)
    return log, repeats


def _even_times(time_s: Array, values: Array, held: Held) -> _Even | None:
    """Return the measurements of a column that come at an even rate below that of the log; else None."""
    flags = held.repeated | np.isnan(values)
    rows = np.flatnonzero(~flags)
    lasts = np.diff(rows)
    if not (lasts > 1).any():
        return None
    factor = int(np.median(lasts[lasts > 1]))
    # a rest repeats itself without a repeated measurement: it counts neither for nor against the factor
    shown = lasts[(lasts > 1) | (values[rows[1:]] != values[rows[1:] - 1])]
    if np.mean(shown == factor) >= REGULAR_SHARE:
        kept = _every(rows, lasts, factor)
        times = time_s[kept]
        return _Even(kept, times, usual_step(times))
    if held.even:
        times = held.measured_s[rows]
        return _Even(rows, times + float(np.min(time_s[rows] - times)), held.period_s)
    return None


def _every(rows: Array, lasts: Array, factor: int) -> Array:
    """Return the rows to keep: of a rest, too, only every ``factor``-th one."""
    kept: list[int] = []
    for row, length in zip(rows.tolist(), [*lasts.tolist(), 1], strict=True):
        if length > 1 or not kept or row - kept[-1] >= factor:
            kept.append(row)
    return np.array(kept)


def _resampled(log: Log, even: _Even, source: str | None, by_source: bool) -> Log:
    """Return the log at the times of the measurements of its output, or of its input (``by_source``)."""
    columns = {}
    for name, values in log.columns.items():
        if name == source and not by_source:
            columns[name] = _means(log.time_s, values, even.times_s)
        elif by_source and name != source:
            columns[name] = np.interp(even.times_s, log.time_s, values)
        else:
            columns[name] = values[even.rows]
    return replace(log, columns={**columns, TIME: even.times_s})


def _means(time_s: Array, values: Array, times: Array) -> Array:
    """Return the means of a held signal from each time to the next; NaN where a sample is missing."""
    steps, missing = np.diff(time_s), np.isnan(values)
    held = np.column_stack([np.where(missing, 0.0, values), missing])
    total = np.vstack([[0.0, 0.0], np.cumsum(held[:-1] * steps[:, None], axis=0)])
    ends = np.append(times, 2 * times[-1] - times[-2])
    row = np.clip(np.searchsorted(time_s, ends + 1e-6 * steps.min(), side="right") - 1, 0, None)
    integral = total[row] + held[row] * (ends - time_s[row])[:, None]
    mean, empty = (np.diff(integral, axis=0) / np.diff(ends)[:, None]).T
    return np.where(empty > 1e-3, np.nan, mean)


def _is_lossy(values: Array, repeated: Array) -> bool:
    """Return whether a signal repeats samples at no even rate, and moves by more than its rounding."""
    changes = np.abs(np.diff(values[~repeated]))
    return bool(repeated.any() and np.median(changes) >= COARSE_STEPS * (step_of(values) or quantum(values)))


def _is_designed(levels: Array) -> bool:
    """Return whether the values between the repeats are independent, as the levels of a random staircase."""
    return rt.ljung_box(levels).passed
