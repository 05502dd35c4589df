"""Faults of recording: one module each, tried in this order."""

from __future__ import annotations

from types import ModuleType

from swimid.inertial.faults import (
    acceleration_unit,
    axes,
    dead,
    dropped,
    held,
    jitter,
    missing,
    order,
    quaternions,
    rate_unit,
    saturated,
    wild,
)
from swimid.inertial.faults.base import Finding
from swimid.inertial.record import Record

#: A new fault is a module with ``NAME``, as in ``docs/imu.md``, and ``check(record)``, which returns the
#: record, repaired where it can be, and findings, or raises an InputError; and a place here.
FAULTS: tuple[ModuleType, ...] = (
    order,
    wild,
    missing,
    dead,
    held,
    saturated,
    acceleration_unit,
    dropped,
    jitter,
    rate_unit,
    axes,
    quaternions,
)


def mend(record: Record) -> tuple[Record, list[Finding]]:
    """The record with every fault found and repaired, and what was found.

    Raises
    ------
    InputError
        Of the first fault that cannot be repaired.
    """
    findings: list[Finding] = []
    for fault in FAULTS:
        record, new = fault.check(record)
        findings += new
    return record, findings
