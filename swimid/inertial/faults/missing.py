"""Cells without a number."""

from __future__ import annotations

import numpy as np

from swimid.errors import InputError
from swimid.inertial.faults.base import Finding, bridged
from swimid.inertial.record import CHANNELS, Record

NAME = "missing cells"
#: More than this share missing in a channel: nothing to bridge from.
MOST = 0.5


def check(record: Record) -> tuple[Record, list[Finding]]:
    """Bridge missing cells; their stretch of the path is known worse."""
    bad = ~np.isfinite(record.channels)
    share = bad.mean(axis=0)
    worst = int(np.argmax(share))
    if share[worst] > MOST:
        text = f"{100 * share[worst]:.0f} % of the samples are missing"
        raise InputError(text, file=record.name, column=CHANNELS[worst])
    count = int(bad.any(axis=1).sum())
    if not count:
        return record, []
    text = f"{count} samples with missing cells, bridged from their neighbours"
    return bridged(record, bad), [Finding(NAME, "handled", text, count)]
