"""Channels that show nothing: zero or constant all the time, or stuck for a while."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from swimid.errors import InputError
from swimid.inertial.faults.base import Finding, bridged
from swimid.inertial.record import ACCELERATION, RATE, Record
from swimid.logs.log import runs

NAME = "dead channel"
#: A channel that keeps one value for longer than this while others move is stuck, s and samples.
STUCK_S, STUCK_SAMPLES = 0.5, 25
#: More of a channel stuck than this share: the channel is dead.
MOST = 0.3


def check(record: Record) -> tuple[Record, list[Finding]]:
    """Refuse a dead accelerometer or gyroscope axis; bridge stuck samples; leave a dead compass aside."""
    found: list[Finding] = []
    stuck = []
    for names, values in ((ACCELERATION, record.acceleration), (RATE, record.rate)):
        flags = np.zeros(values.shape, dtype=bool)
        for axis, name in enumerate(names):
            flags[:, axis] = _stuck(record, values[:, axis])
            if np.ptp(values[:, axis]) == 0 or flags[:, axis].mean() > MOST:
                what = (
                    "zero throughout"
                    if not values[:, axis].any()
                    else "constant throughout"
                    if np.ptp(values[:, axis]) == 0
                    else f"constant for {100 * flags[:, axis].mean():.0f} % of the time"
                )
                raise InputError(
                    f"the channel is dead: {what}",
                    file=record.name,
                    column=name,
                    hint="motion in space needs three accelerations and three turn rates; mend "
                    "the sensor or its wiring",
                )
        stuck.append(flags)
    count = int((stuck[0] | stuck[1]).any(axis=1).sum())
    if count:
        which = [
            n
            for flags, ns in zip(stuck, (ACCELERATION, RATE), strict=True)
            for n, f in zip(ns, flags.T, strict=True)
            if f.any()
        ]
        found.append(
            Finding(
                NAME, "handled", f"{count} samples stuck at one value in {', '.join(which)}, bridged", count
            )
        )
        record = bridged(record, stuck[0], stuck[1])
    if record.magnetic is not None and (
        not np.isfinite(record.magnetic).all() or np.any(np.ptp(record.magnetic, axis=0) == 0)
    ):
        found.append(Finding(NAME, "handled", "the magnetometer is dead or has holes, not used"))
        record = replace(record, magnetic=None)
    q = record.quaternion
    if q is not None and (not np.isfinite(q).all() or np.ptp(q, axis=0).max() == 0 or _unnormed(q)):
        found.append(
            Finding(
                NAME, "handled", "the quaternions are constant, have holes or are not of length 1, not used"
            )
        )
        record = replace(record, quaternion=None)
    return record, found


def _unnormed(q: np.ndarray) -> bool:
    return bool(np.max(np.abs(np.linalg.norm(q, axis=1) - 1)) > 0.05)


def _stuck(record: Record, values: np.ndarray) -> np.ndarray:
    """Long runs of one value, unless the channel is so coarse that it often repeats itself."""
    flags = np.zeros(len(values), dtype=bool)
    same = np.concatenate(([False], np.diff(values) == 0))
    least = max(round(STUCK_S / record.step_s), STUCK_SAMPLES)
    long = [(first, last) for first, last in runs(same) if last - first >= least]
    for first, last in long:
        # at a level the channel often shows, it may just be quiet
        inside = np.zeros(len(values), dtype=bool)
        inside[max(first - 1, 0) : last] = True
        if not inside.all() and np.mean(values[~inside] == values[first]) < 0.01:
            flags |= inside
    return flags
