"""Channels clipped at the end of their range."""

from __future__ import annotations

import numpy as np

from swimid.errors import InputError
from swimid.inertial.faults.base import Finding, bridged
from swimid.inertial.record import CHANNELS, Array, Flags, Record
from swimid.logs.log import runs

NAME = "saturated channel"
#: A value is the end of the range when it is an extreme held in this many runs of two or more samples.
RUNS, RUN_LENGTH = 3, 2
#: And when it is this many times as frequent as what lies beside it, within this share of the range.
PILED, BESIDE = 2.0, 0.01
#: More of a channel clipped than this share: refused.
MOST = 0.1


def check(record: Record) -> tuple[Record, list[Finding]]:
    """Bridge clipped samples, which hide how far the motion went; refuse where they are many."""
    values = record.channels
    clipped = np.column_stack([_clipped(column) for column in values.T])
    share = clipped.mean(axis=0)
    if not share.any():
        return record, []
    worst = int(np.argmax(share))
    limit = float(np.max(np.abs(values[:, worst])))
    if share[worst] > MOST:
        raise InputError(
            f"{100 * share[worst]:.1f} % of the samples are clipped at {limit:.4g}",
            file=record.name,
            column=CHANNELS[worst],
            hint="use a sensor, or a setting, with a larger range",
        )
    count = int(clipped.any(axis=1).sum())
    which = ", ".join(n for n, s in zip(CHANNELS, share, strict=True) if s)
    text = (
        f"{count} samples clipped at the end of the range in {which}; bridged, and the path known worse there"
    )
    return bridged(record, clipped), [Finding(NAME, "handled", text, count)]


def _clipped(values: Array) -> Flags:
    flags = np.zeros(len(values), dtype=bool)
    for extreme in (float(np.max(values)), float(np.min(values))):
        at = values == extreme
        held = [(a, b) for a, b in runs(at) if b - a >= RUN_LENGTH]
        # the tail of an open range thins out; a closed one piles up at its end, also against coarse levels
        below = values[~at]
        near = np.abs(below - extreme) <= max(BESIDE * np.ptp(values), float(np.min(np.abs(below - extreme))))
        if len(held) >= RUNS and at.sum() > PILED * near.sum():
            flags |= at
    return flags
