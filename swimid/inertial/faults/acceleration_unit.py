"""Accelerations in g, mg or cm/s^2 where m/s^2 is said; or with gravity taken out already."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from swimid.errors import InputError
from swimid.inertial.faults.base import Finding
from swimid.inertial.record import GRAVITY_M_S2, Record
from swimid.inertial.rest import MOST_ACCELERATION, WINDOW_S

NAME = "acceleration unit"
#: Relative deviation from 1 g at rest: sensors are off by a few percent, a swimmer that glides adds some.
NEAR = 0.12
UNITS = {"g": GRAVITY_M_S2, "mg": 1e-3 * GRAVITY_M_S2, "ft/s2": 0.3048, "cm/s2": 0.01}


def check(record: Record) -> tuple[Record, list[Finding]]:
    """Compare the specific force of quiet samples with gravity.

    The stated unit is believed unless quiet samples show gravity in another one. A sensor that is shaken all
    the time has no quiet samples: its unit is not doubted, because its readings can have any size.
    """
    size = _at_rest(record)
    if size is None:
        # without quiet samples gravity shows in the mean, or of a tumbling sensor in the typical size
        sizes = np.linalg.norm([record.acceleration.mean(axis=0), *record.acceleration], axis=1)
        size = float(max(sizes[0], np.median(sizes)))
        if size >= 0.5 * GRAVITY_M_S2:
            return record, []
    elif abs(size / GRAVITY_M_S2 - 1) <= NEAR:
        return record, []
    else:
        off = {name: abs(np.log(size * factor / GRAVITY_M_S2)) for name, factor in UNITS.items()}
        name = min(off, key=lambda unit: off[unit])
        if off[name] <= NEAR:
            factor = UNITS[name]
            # mg and cm/s2 differ by 2 %: the nearer is taken, an error of scale at worst
            text = f"accelerations are in {name} ({size:.4g} at rest), converted by {factor:.6g}"
            return replace(record, acceleration=record.acceleration * factor), [
                Finding(NAME, "handled", text)
            ]
    out = "gravity seems to be taken out already: give the accelerometer's own readings"
    raise InputError(
        f"the typical size of the acceleration is {size:.4g} m/s2, where gravity alone makes 9.81",
        file=record.name,
        column="ax_m_s2 ... az_m_s2",
        hint=out if size < 0.5 * GRAVITY_M_S2 else "say the unit in a mapping (--map)",
    )


def _at_rest(record: Record) -> float | None:
    """Return the median size of the specific force in windows in which it hardly changes; None without any.

    A window is quiet where the specific force deviates from its mean by less, relative to it, than that of a
    sensor at rest may deviate from gravity.
    """
    size = max(round(WINDOW_S / record.step_s), 4)
    count = len(record) // size
    windows = record.acceleration[: count * size].reshape(count, size, 3)
    sizes = np.linalg.norm(windows.mean(axis=1), axis=1)
    quiet = np.sqrt(windows.var(axis=1).sum(axis=1)) <= MOST_ACCELERATION / GRAVITY_M_S2 * sizes
    return float(np.median(sizes[quiet])) if quiet.any() else None
