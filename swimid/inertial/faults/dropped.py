"""Samples that are not there: steps of several sample times."""

from __future__ import annotations

import numpy as np

from swimid.errors import InputError
from swimid.inertial.faults.base import Finding
from swimid.inertial.record import Record

NAME = "dropped samples"
#: A step longer than this many sample times has lost samples.
LONGER = 1.6
#: A hole longer than this is not bridged, s.
LONGEST_S = 2.0


def check(record: Record) -> tuple[Record, list[Finding]]:
    """Count what is missing; the trapezoid spans it and the errors grow as if nothing were known there."""
    steps = np.diff(record.time_s)
    wide = steps > LONGER * record.step_s
    if not wide.any():
        return record, []
    longest = float(steps.max())
    if longest > LONGEST_S:
        row = int(np.argmax(steps))
        raise InputError(
            f"no samples for {longest:.2f} s after t = {record.time_s[row]:.3f} s: "
            f"motion in between is unknown",
            file=record.name,
            column="t_s",
            hint="cut the log there, one file for each piece",
        )
    count = int(np.sum(np.round(steps[wide] / record.step_s) - 1))
    text = (
        f"{count} samples dropped in {int(wide.sum())} places, the longest "
        f"{longest:.3f} s; spanned by the trapezoid"
    )
    return record, [Finding(NAME, "handled", text, count)]
