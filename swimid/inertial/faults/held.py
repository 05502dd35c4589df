"""Samples repeated under new stamps: a logger that asks faster than the sensor answers."""

from __future__ import annotations

import numpy as np

from swimid.inertial.faults.base import Finding, bridged
from swimid.inertial.record import Record

NAME = "repeated samples"
#: Below this share samples repeat by chance, at rest and with few digits.
LEAST = 0.005


def check(record: Record) -> tuple[Record, list[Finding]]:
    """Bridge samples that repeat the one before in every channel."""
    same = np.concatenate(([False], np.all(np.diff(record.channels, axis=0) == 0, axis=1)))
    count = int(same.sum())
    if count < LEAST * len(same) or count > 0.9 * len(same):
        return record, []
    text = f"{count} samples repeat the one before in every channel; bridged from the true ones"
    return bridged(record, np.repeat(same[:, None], 6, axis=1)), [Finding(NAME, "handled", text, count)]
