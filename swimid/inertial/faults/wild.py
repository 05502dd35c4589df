"""Readings no motion makes: marks for "no sample", and glitches of transmission."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import median_filter

from swimid.inertial.faults.base import Finding
from swimid.inertial.record import CHANNELS, Array, Flags, Record

NAME = "wild readings"
#: No sensor shows more, in any unit its readings come in.
LARGEST = 1e5
#: Readings this many spans of all others away are none; single ones among `WINDOW` samples, or marks.
SPANS, WINDOW = 30.0, 7


def check(record: Record) -> tuple[Record, list[Finding]]:
    """Take wild readings as missing: the next check bridges them."""
    values = record.channels
    wild = np.column_stack([_wild(column) for column in values.T])
    if not wild.any():
        return record, []
    which = ", ".join(n for n, bad in zip(CHANNELS, wild.T, strict=True) if bad.any())
    largest, count = float(np.max(np.abs(values[wild]))), int(wild.any(axis=1).sum())
    text = f"{count} samples in {which} that no motion makes (up to {largest:.4g}) taken as missing"
    return record.with_channels(np.where(wild, np.nan, values)), [Finding(NAME, "handled", text, count)]


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
