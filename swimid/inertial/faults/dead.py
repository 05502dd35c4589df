"""Channels that show nothing: zero or constant all the time, or stuck for a while."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Slerp

from swimid.errors import InputError
from swimid.inertial.faults.base import Finding, bridged
from swimid.inertial.record import CHANNELS, Record, resampled, rotations
from swimid.logs.log import runs

NAME = "dead channel"
#: A channel that keeps one value for longer than this while others move is stuck, s and samples.
STUCK_S, STUCK_SAMPLES = 0.5, 25
#: More of a channel stuck than this share: the channel is dead.
MOST = 0.3


def check(record: Record) -> tuple[Record, list[Finding]]:
    """Refuse a dead accelerometer or gyroscope axis; bridge stuck samples; leave a dead compass aside.

    A magnetometer, or an attitude, that comes at a lower rate is interpolated between its samples.
    """
    findings: list[Finding] = []
    values = record.channels
    stuck = np.column_stack([_stuck(record, column) for column in values.T])
    for name, column, share in zip(CHANNELS, values.T, stuck.mean(axis=0), strict=True):
        if np.ptp(column) == 0 or share > MOST:
            what = "zero" if not column.any() else "constant"
            how_long = "throughout" if np.ptp(column) == 0 else f"for {100 * share:.0f} % of the time"
            raise InputError(
                f"the channel is dead: {what} {how_long}",
                file=record.name,
                column=name,
                hint="motion in space needs three accelerations and three turn rates; mend "
                "the sensor or its wiring",
            )
    count = int(stuck.any(axis=1).sum())
    if count:
        which = ", ".join(name for name, flags in zip(CHANNELS, stuck.T, strict=True) if flags.any())
        text = f"{count} samples stuck at one value in {which}, bridged"
        findings.append(Finding(NAME, "handled", text, count))
        record = bridged(record, stuck)
    field, q = record.magnetic, record.quaternion
    if field is not None:
        rows = _measured(record, field)
        if len(rows) == 0 or np.any(np.ptp(field[rows], axis=0) == 0):
            findings.append(Finding(NAME, "handled", "the magnetometer is dead or has holes, not used"))
            record = replace(record, magnetic=None)
        else:
            record = replace(record, magnetic=resampled(record.time_s, record.time_s[rows], field[rows]))
    if q is not None:
        rows = _measured(record, q)
        if len(rows) == 0 or np.ptp(q[rows], axis=0).max() == 0 or _unnormed(q[rows]):
            text = "the quaternions are constant, have holes or are not of length 1, not used"
            findings.append(Finding(NAME, "handled", text))
            record = replace(record, quaternion=None)
        elif len(rows) < len(record):
            times = record.time_s[rows]
            between = Slerp(times, rotations(q[rows]))(np.clip(record.time_s, times[0], times[-1]))
            record = replace(record, quaternion=between.as_quat()[:, [3, 0, 1, 2]])
    return record, findings


def _measured(record: Record, values: np.ndarray) -> np.ndarray:
    """Return the rows in which a slower sensor has values; none where a hole is too long to bridge."""
    rows = np.flatnonzero(np.isfinite(values).all(axis=1))
    times = np.concatenate([record.time_s[:1], record.time_s[rows], record.time_s[-1:]])
    return rows if len(rows) > 1 and np.max(np.diff(times)) <= max(STUCK_S, 2 * record.step_s) else rows[:0]


def _unnormed(q: np.ndarray) -> bool:
    return bool(np.max(np.abs(np.linalg.norm(q, axis=1) - 1)) > 0.05)


def _stuck(record: Record, values: np.ndarray) -> np.ndarray:
    """Long runs of one value, unless the channel is so coarse that it often repeats itself."""
    flags = np.zeros(len(values), dtype=bool)
    same = np.concatenate(([False], np.diff(values) == 0))
    least = max(round(STUCK_S / record.step_s), STUCK_SAMPLES)
    long = [(first, last) for first, last in runs(same) if last - first >= least]
    for first, last in long:
        # at a level the channel often shows, it may just be at rest
        inside = np.zeros(len(values), dtype=bool)
        inside[max(first - 1, 0) : last] = True
        if not inside.all() and np.mean(values[~inside] == values[first]) < 0.01:
            flags |= inside
    return flags
