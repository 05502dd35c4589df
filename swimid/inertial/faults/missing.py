"""Cells without a number."""

from __future__ import annotations

import numpy as np

from swimid.errors import InputError
from swimid.inertial.faults.base import Finding, bridged
from swimid.inertial.record import ACCELERATION, RATE, Record

NAME = "missing cells"
#: More than this share missing in a channel: nothing to bridge from.
MOST = 0.5


def check(record: Record) -> tuple[Record, list[Finding]]:
    """Bridge missing cells; their stretch of the path is known worse."""
    bad_a, bad_w = ~np.isfinite(record.acceleration), ~np.isfinite(record.rate)
    for names, bad in ((ACCELERATION, bad_a), (RATE, bad_w)):
        share = bad.mean(axis=0)
        if np.any(share > MOST):
            axis = int(np.argmax(share))
            raise InputError(
                f"{100 * share[axis]:.0f} % of the samples are missing", file=record.name, column=names[axis]
            )
    count = int((bad_a | bad_w).any(axis=1).sum())
    if not count:
        return record, []
    text = f"{count} samples with missing cells, bridged from their neighbours"
    return bridged(record, bad_a, bad_w), [Finding(NAME, "handled", text, count)]
