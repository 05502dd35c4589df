"""Time stamps that repeat, go back, or are missing."""

from __future__ import annotations

import numpy as np

from swimid.errors import InputError
from swimid.inertial.faults.base import Finding
from swimid.inertial.record import Record

NAME = "repeated stamps"
#: More stamps out of order than this share: the clock cannot be trusted.
MOST = 0.02


def check(record: Record) -> tuple[Record, list[Finding]]:
    """Keep the first of each repeated stamp, put swapped rows in order; refuse a clock that jumps back."""
    t = record.time_s
    found = []
    lost = ~np.isfinite(t)
    if lost.any():
        if lost.mean() > MOST:
            raise InputError(
                f"{int(lost.sum())} of {len(t)} samples have no time", file=record.name, column="t_s"
            )
        found.append(
            Finding(NAME, "handled", f"{int(lost.sum())} samples without a time left out", int(lost.sum()))
        )
        record = record.take(~lost)
        t = record.time_s
    back = np.flatnonzero(np.diff(t) < 0)
    if len(back):
        if len(back) > MOST * len(t) or float(np.min(np.diff(t))) < -100 * np.median(np.abs(np.diff(t))):
            row = int(back[0]) + 1
            raise InputError(
                f"time goes back in {len(back)} places, first from {t[row - 1]:g} to {t[row]:g} s (sample {row + 1})",
                file=record.name,
                column="t_s",
                hint="was the clock reset or wrapped? cut the log there, one file for each piece",
            )
        record = record.take(np.argsort(t, kind="stable"))
        found.append(Finding(NAME, "handled", f"{len(back)} samples out of order put in place", len(back)))
    keep = np.concatenate(([True], np.diff(record.time_s) > 0))
    if not keep.all():
        count = int((~keep).sum())
        if keep.sum() < 0.5 * len(keep):
            raise InputError(
                f"{count} of {len(keep)} time stamps repeat the one before",
                file=record.name,
                column="t_s",
                hint="the stamps are too coarse: give the time with more decimals, or by 'rate_hz' in a mapping",
            )
        record = record.take(keep)
        found.append(Finding(NAME, "handled", f"{count} repeated time stamps: the first of each is kept", count))
    return record, found
