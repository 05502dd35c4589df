"""Faults of recording: each is searched for, and repaired or refused, in the order of :data:`FAULTS`."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.ndimage import median_filter
from scipy.spatial.transform import Slerp

from swimid.errors import InputError
from swimid.inertial import conventions
from swimid.inertial.record import CHANNELS, Array, Finding, Flags, Record, resampled, rotations
from swimid.logs import sampling
from swimid.logs.clock import in_order
from swimid.logs.log import runs

#: Maximum share of rows without a usable time, and of missing cells in a channel.
MAX_MISSING = 0.5
#: No sensor shows more, in any unit its readings come in.
LARGEST = 1e5
#: Readings this many spans of all others away are wrong; single ones among `WINDOW` samples, or marks.
SPANS, WINDOW = 30.0, 7
#: A channel that keeps one value for longer than this while others move is stuck, s and samples.
STUCK_S, STUCK_SAMPLES = 0.5, 25
#: Maximum share of a channel that is stuck.
MAX_STUCK = 0.3
#: Below this share samples repeat by chance, at rest and with few digits.
MIN_REPEATED = 0.005
#: A value is the end of the range when it is an extreme held in this many runs of two or more samples.
RUNS, RUN_LENGTH = 3, 2
#: And when it is this many times as frequent as its neighbours, within this share of the range.
PILED, BESIDE = 2.0, 0.01
#: Maximum share of clipped samples in a channel.
MAX_CLIPPED = 0.1
#: A step longer than this many sample times has lost samples; a hole longer than this, s, is refused.
LONG_STEP, MAX_HOLE_S = 1.6, 2.0
#: Jitter worth a warning, in sample times.
NOTABLE_JITTER = 0.05

Mended = tuple[Record, list[Finding]]


def mend(record: Record) -> Mended:
    """Return the record with every fault found and repaired, and the findings.

    Raises
    ------
    InputError
        Of the first fault that cannot be repaired.
    """
    findings: list[Finding] = []
    for check in FAULTS:
        record, new = check(record)
        findings += new
    return record, findings


def bridged(record: Record, bad: Flags) -> Record:
    """Return the record with the bad samples, shape (n, 6), interpolated, and marked as filled."""
    values = record.channels
    for column, hole in zip(values.T, bad.T, strict=True):
        if hole.any() and not hole.all():
            column[hole] = np.interp(record.time_s[hole], record.time_s[~hole], column[~hole])
    acceleration, rate = (half.any(axis=1) for half in np.hsplit(bad, 2))
    return replace(
        record.with_channels(values),
        filled_acceleration=record.filled_acceleration | acceleration,
        filled_rate=record.filled_rate | rate,
    )


def _channels(flags: Flags) -> str:
    """Return the names of the channels in which a flag is set."""
    return ", ".join(name for name, bad in zip(CHANNELS, flags.T, strict=True) if bad.any())


def stamps(record: Record) -> Mended:
    """Keep the first of each repeated stamp, put late rows in place; refuse a clock that was reset."""
    order = in_order(record.time_s, dict(zip(CHANNELS, record.channels.T, strict=True)))
    if order.reset_row is not None:
        row = order.reset_row
        raise InputError(
            f"time goes back at t = {record.time_s[row]:g} s (sample {row + 1}) and counts on from there",
            file=record.name,
            column="t_s",
            hint="was the clock reset or wrapped? cut the log there, one file for each piece",
        )
    gone = order.untimed + order.repeated + order.clashing
    if gone > MAX_MISSING * len(record):
        raise InputError(
            f"{gone} of {len(record)} samples have no time of their own",
            file=record.name,
            column="t_s",
            hint="the stamps are too coarse: give the time with more decimals, or by 'rate_hz' in a mapping",
        )
    if not order.changed:
        return record, []
    text = f"{gone} samples without a time of their own left out, {order.late} out of order put in place"
    return record.take(order.index), [Finding("repeated stamps", "handled", text, gone + order.late)]


def wild(record: Record) -> Mended:
    """Take readings that no motion makes as missing: marks for "no sample", and glitches of transmission."""
    values = record.channels
    bad = np.column_stack([_wild(column) for column in values.T])
    if not bad.any():
        return record, []
    largest, count = float(np.max(np.abs(values[bad]))), int(bad.any(axis=1).sum())
    text = f"{count} samples in {_channels(bad)} that no motion makes (up to {largest:.4g}) taken as missing"
    finding = Finding("wild readings", "handled", text, count)
    return record.with_channels(np.where(bad, np.nan, values)), [finding]


def _wild(values: Array) -> Flags:
    flags = np.abs(np.nan_to_num(values)) > LARGEST
    there = np.flatnonzero(np.isfinite(values) & ~flags)
    if len(there) < 2 * WINDOW:
        return flags
    # a mark, however often it comes, is one value far from all the others
    for extreme in (float(values[there].max()), float(values[there].min())):
        others = values[there][values[there] != extreme]
        if len(others) > WINDOW and abs(extreme - np.median(others)) > SPANS * np.ptp(others) > 0:
            flags |= values == extreme
    there = np.flatnonzero(np.isfinite(values) & ~flags)
    calm = median_filter(values[there], size=WINDOW, mode="nearest")
    span = float(np.ptp(calm))
    if span > 0:
        flags[there] |= np.abs(values[there] - calm) > SPANS * span
    return flags


def missing(record: Record) -> Mended:
    """Bridge missing cells; their stretch of the path is known worse."""
    bad = ~np.isfinite(record.channels)
    share = bad.mean(axis=0)
    worst = int(np.argmax(share))
    if share[worst] > MAX_MISSING:
        text = f"{100 * share[worst]:.0f} % of the samples are missing"
        raise InputError(text, file=record.name, column=CHANNELS[worst])
    count = int(bad.any(axis=1).sum())
    if not count:
        return record, []
    text = f"{count} samples with missing cells, bridged from their neighbours"
    return bridged(record, bad), [Finding("missing cells", "handled", text, count)]


def dead(record: Record) -> Mended:
    """Refuse a dead accelerometer or gyroscope axis; bridge stuck samples; do not use a dead compass.

    A magnetometer, or an attitude, that comes at a lower rate is interpolated between its samples.
    """
    values = record.channels
    stuck = np.column_stack([_stuck(record, column) for column in values.T])
    for name, column, share in zip(CHANNELS, values.T, stuck.mean(axis=0), strict=True):
        constant = np.ptp(column) == 0
        if constant or share > MAX_STUCK:
            raise InputError(
                f"the channel is dead: one value for {100 * max(share, constant):.0f} % of the time",
                file=record.name,
                column=name,
                hint="three accelerations and three turn rates are needed; mend the sensor or its wiring",
            )
    texts, count = [], int(stuck.any(axis=1).sum())
    if count:
        texts.append(f"{count} samples stuck at one value in {_channels(stuck)}, bridged")
        record = bridged(record, stuck)
    field, q, t = record.magnetic, record.quaternion, record.time_s
    if field is not None:
        rows = _measured(record, field)
        if len(rows) == 0 or np.any(np.ptp(field[rows], axis=0) == 0):
            texts.append("the magnetometer is dead or has holes, not used")
            record = replace(record, magnetic=None)
        else:
            record = replace(record, magnetic=resampled(t, t[rows], field[rows]))
    if q is not None:
        rows = _measured(record, q)
        lengths = np.linalg.norm(q[rows], axis=1)
        if len(rows) == 0 or np.ptp(q[rows], axis=0).max() == 0 or np.max(np.abs(lengths - 1)) > 0.05:
            texts.append("the quaternions are constant, have holes or are not of length 1, not used")
            record = replace(record, quaternion=None)
        elif len(rows) < len(record):
            between = Slerp(t[rows], rotations(q[rows]))(np.clip(t, t[rows[0]], t[rows[-1]]))
            record = replace(record, quaternion=between.as_quat()[:, [3, 0, 1, 2]])
    return record, [Finding("dead channel", "handled", text, count) for text in texts]


def _measured(record: Record, values: Array) -> np.ndarray:
    """Return the rows in which a slower sensor has values; none where a hole is too long to bridge."""
    rows = np.flatnonzero(np.isfinite(values).all(axis=1))
    times = np.concatenate([record.time_s[:1], record.time_s[rows], record.time_s[-1:]])
    return rows if len(rows) > 1 and np.max(np.diff(times)) <= max(STUCK_S, 2 * record.step_s) else rows[:0]


def _stuck(record: Record, values: Array) -> Flags:
    """Return the long runs of one value, unless the channel is so coarse that it often repeats itself."""
    flags = np.zeros(len(values), dtype=bool)
    least = max(round(STUCK_S / record.step_s), STUCK_SAMPLES)
    for first, last in runs(np.concatenate(([False], np.diff(values) == 0))):
        if last - first < least:
            continue
        inside = np.zeros(len(values), dtype=bool)
        inside[max(first - 1, 0) : last] = True
        # at a level the channel often shows, it may just be at rest
        if not inside.all() and np.mean(values[~inside] == values[first]) < 0.01:
            flags |= inside
    return flags


def held(record: Record) -> Mended:
    """Bridge samples that repeat the one before: the logger asks faster than the sensor answers."""
    same = np.concatenate(([False], np.all(np.diff(record.channels, axis=0) == 0, axis=1)))
    count = int(same.sum())
    if count < MIN_REPEATED * len(same) or count > 0.9 * len(same):
        return record, []
    text = f"{count} samples repeat the one before in every channel; bridged from the true ones"
    bad = np.repeat(same[:, None], 6, axis=1)
    return bridged(record, bad), [Finding("repeated samples", "handled", text, count)]


def saturated(record: Record) -> Mended:
    """Bridge clipped samples, which hide how far the motion went; refuse where they are many."""
    values = record.channels
    clipped = np.column_stack([_clipped(column) for column in values.T])
    share = clipped.mean(axis=0)
    if not share.any():
        return record, []
    worst = int(np.argmax(share))
    if share[worst] > MAX_CLIPPED:
        limit = float(np.max(np.abs(values[:, worst])))
        raise InputError(
            f"{100 * share[worst]:.1f} % of the samples are clipped at {limit:.4g}",
            file=record.name,
            column=CHANNELS[worst],
            hint="use a sensor, or a setting, with a larger range",
        )
    count = int(clipped.any(axis=1).sum())
    text = f"{count} samples clipped at the end of the range in {_channels(clipped)}, bridged"
    return bridged(record, clipped), [Finding("saturated channel", "handled", text, count)]


def _clipped(values: Array) -> Flags:
    flags = np.zeros(len(values), dtype=bool)
    for extreme in (float(np.max(values)), float(np.min(values))):
        at = values == extreme
        held_runs = [(a, b) for a, b in runs(at) if b - a >= RUN_LENGTH]
        # the tail of an open range thins out; a closed one piles up at its end, also against coarse levels
        below = np.abs(values[~at] - extreme)
        near = below <= max(BESIDE * np.ptp(values), float(np.min(below)))
        if len(held_runs) >= RUNS and at.sum() > PILED * near.sum():
            flags |= at
    return flags


def dropped(record: Record) -> Mended:
    """Count samples that are missing; the trapezoid spans them, and the errors grow there."""
    steps = np.diff(record.time_s)
    wide = steps > LONG_STEP * record.step_s
    if not wide.any():
        return record, []
    longest = float(steps.max())
    if longest > MAX_HOLE_S:
        raise InputError(
            f"no samples for {longest:.2f} s after t = {record.time_s[int(np.argmax(steps))]:.3f} s: "
            "motion in between is unknown",
            file=record.name,
            column="t_s",
            hint="cut the log there, one file for each piece",
        )
    count = int(np.sum(np.round(steps[wide] / record.step_s) - 1))
    text = f"{count} samples dropped in {int(wide.sum())} places, the longest {longest:.3f} s; spanned"
    return record, [Finding("dropped samples", "handled", text, count)]


def jitter(record: Record) -> Mended:
    """Report uneven steps; every integral uses the samples' own stamps."""
    uneven = sampling.rate(record.time_s).jitter
    single = np.diff(record.time_s)
    single = single[single < LONG_STEP * record.step_s]
    uneven = max(uneven, float(np.std(single)) / record.step_s) if uneven else 0.0
    if uneven < NOTABLE_JITTER:
        return record, []
    text = (
        f"time steps vary by {100 * uneven:.0f} % (rms) of {1e3 * record.step_s:.3g} ms; the stamps are used"
    )
    return record, [Finding("clock jitter", "handled", text)]


#: A new fault is a function here that returns the record, repaired where it can be, and findings, or raises
#: an InputError.
FAULTS = (
    stamps,
    wild,
    missing,
    dead,
    held,
    saturated,
    conventions.acceleration_unit,
    dropped,
    jitter,
    conventions.rate_unit,
    conventions.axes,
    conventions.quaternions,
)
