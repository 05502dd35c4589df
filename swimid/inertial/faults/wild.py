"""Readings no motion makes: marks for "no sample", and glitches of transmission."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.ndimage import median_filter

from swimid.inertial.faults.base import Finding
from swimid.inertial.record import ACCELERATION, RATE, Array, Flags, Record

NAME = "wild readings"
#: No sensor shows more, in any unit its readings come in.
LARGEST = 1e5
#: Readings this many spans of all others away are none; single ones among `WINDOW` samples, or marks.
SPANS, WINDOW = 30.0, 7


def check(record: Record) -> tuple[Record, list[Finding]]:
    """Take wild readings as missing: the next check bridges them."""
    wild = [np.column_stack([_wild(c) for c in v.T]) for v in (record.acceleration, record.rate)]
    both = np.hstack(wild)
    if not both.any():
        return record, []
    which = ", ".join(n for n, bad in zip((*ACCELERATION, *RATE), both.T, strict=True) if bad.any())
    worst = float(np.max(np.abs(np.hstack([record.acceleration, record.rate])[both])))
    count = int(both.any(axis=1).sum())
    text = f"{count} samples in {which} that no motion makes (up to {worst:.4g}) taken as missing"
    mended = replace(
        record,
        acceleration=np.where(wild[0], np.nan, record.acceleration),
        rate=np.where(wild[1], np.nan, record.rate),
    )
    return mended, [Finding(NAME, "handled", text, count)]


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
