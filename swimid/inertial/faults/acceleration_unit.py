"""Accelerations in g, mg or cm/s^2 where m/s^2 is said; or with gravity taken out already."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from swimid.errors import InputError
from swimid.inertial.faults.base import Finding
from swimid.inertial.record import GRAVITY_M_S2, Record

NAME = "acceleration unit"
#: How far the typical size may be from 1 g: sensors are off by a few percent, swimming adds some.
NEAR = 0.12
UNITS = {"g": GRAVITY_M_S2, "mg": 1e-3 * GRAVITY_M_S2, "ft/s2": 0.3048, "cm/s2": 0.01}


def check(record: Record) -> tuple[Record, list[Finding]]:
    """The median size of specific force is 1 g, whatever the motion of a swimmer."""
    size = float(np.median(np.linalg.norm(record.acceleration, axis=1)))
    if abs(size / GRAVITY_M_S2 - 1) <= NEAR:
        return record, []
    close = {name: size * factor / GRAVITY_M_S2 for name, factor in UNITS.items()}
    fitting = sorted((abs(np.log(ratio)), name) for name, ratio in close.items() if ratio > 0)
    if fitting and fitting[0][0] <= NEAR:
        name = fitting[0][1]
        factor = UNITS[name]
        # mg and cm/s2 differ by 2 %: the nearer is taken, an error of scale at worst
        text = f"accelerations are in {name} (typically {size:.4g} at 1 g), converted by {factor:.6g}"
        return replace(record, acceleration=record.acceleration * factor), [Finding(NAME, "handled", text)]
    hint = (
        "gravity seems to be taken out already; give the accelerometer's own readings"
        if size < 0.5 * GRAVITY_M_S2
        else "say the unit in a mapping (--map)"
    )
    raise InputError(
        f"the typical size of the acceleration is {size:.4g} m/s2, where gravity alone makes 9.81",
        file=record.name,
        column="ax_m_s2 ... az_m_s2",
        hint=hint,
    )
