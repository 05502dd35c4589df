"""A sample clock that is not even."""

from __future__ import annotations

import numpy as np

from swimid.inertial.faults.base import Finding
from swimid.inertial.record import Record
from swimid.logs import sampling

NAME = "clock jitter"
#: Jitter worth a word, in sample times.
NOTABLE = 0.05


def check(record: Record) -> tuple[Record, list[Finding]]:
    """Say how uneven the steps are; every integral uses the samples' own stamps."""
    jitter = sampling.rate(record.time_s).jitter
    single = np.diff(record.time_s)
    single = single[single < 1.6 * record.step_s]
    jitter = max(jitter, float(np.std(single)) / record.step_s) if jitter else 0.0
    if jitter < NOTABLE:
        return record, []
    text = (
        f"time steps vary by {100 * jitter:.0f} % (rms) of "
        f"{1e3 * record.step_s:.3g} ms; the stamps are used as they are"
    )
    return record, [Finding(NAME, "handled", text)]
