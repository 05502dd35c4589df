"""Turn rates in degrees per second where radians are said."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from swimid.inertial import strapdown
from swimid.inertial.faults.base import Finding, up_turning
from swimid.inertial.record import Record, rotations
from swimid.inertial.sensor import DEG

NAME = "turn-rate unit"
#: Where nothing else tells the unit, faster turns (99th percentile) are doubted, rad/s.
FASTEST = 12.0
#: A turn of gravity over a second that can be seen, rad.
VISIBLE = 0.02
#: Turned to axes that stand still for this long, s, gravity stays where it is; so many windows at most.
WINDOW_S, MOST_WINDOWS = 0.5, 200
#: A unit that leaves this share of what the other leaves of gravity's wandering is the right one.
CLEARLY = 0.5


def check(record: Record) -> tuple[Record, list[Finding]]:
    """Compare with how gravity, or the quaternions, turn; where neither tells, believe the stated unit."""
    scale = _against_quaternion(record)
    by = "the quaternions"
    if scale is None:
        scale, by = _where_gravity_stays(record), "gravity in the accelerometer"
    if scale is None:
        scale = _against_gravity(record)
    if scale is None:
        fast = float(np.quantile(np.linalg.norm(record.rate, axis=1), 0.99))
        text = (
            f"turn rates reach {fast:.0f} rad/s as stated, and nothing else in the log tells their unit; for "
            "another one, say it in a mapping (--map)"
        )
        return record, [Finding(NAME, "handled", text)] if fast > FASTEST else []
    if abs(np.log(scale / DEG)) < abs(np.log(scale)):
        text = f"turn rates are in deg/s (judged by {by}), converted"
        return replace(record, rate=record.rate * DEG), [Finding(NAME, "handled", text)]
    return record, []


def _where_gravity_stays(record: Record) -> float | None:
    """1 or a degree: the unit that makes specific force, turned back by the turn rates, stand still.

    Holds for turns of any size and speed. None where neither is clearly better than the other and than no
    turn at all: small turns, turns about the vertical, and axes that are not what they say.
    """
    size = max(round(WINDOW_S / record.step_s), 4)
    starts = np.arange(0, len(record) - size, size)
    starts = starts[:: max(len(starts) // MOST_WINDOWS, 1)]
    left = {1.0: 0.0, DEG: 0.0, 0.0: 0.0}
    for first in starts.tolist():
        rows = slice(first, first + size)
        for factor in left:
            turned = strapdown.attitude(
                record.time_s[rows], factor * record.rate[rows], Rotation.identity()
            ).apply(record.acceleration[rows])
            left[factor] += float(np.sum((turned - turned.mean(axis=0)) ** 2))
    best = min(left, key=lambda factor: left[factor])
    others = min(value for factor, value in left.items() if factor != best)
    return best if best and left[best] < CLEARLY * others else None


def _against_gravity(record: Record) -> float | None:
    """Factor from logged rates to rates that turn gravity as seen; None where it hardly turns."""
    seen, up, turned = up_turning(record)
    if len(seen) < 16:
        return None
    expected = -np.cross(turned - np.median(turned, axis=0), up)
    seen = seen - np.median(seen, axis=0)
    power = float(np.sum(expected**2))
    if power == 0 or np.sqrt(np.mean(np.sum(seen**2, axis=1))) < VISIBLE:
        return None
    agreement = float(np.sum(expected * seen)) / np.sqrt(power * float(np.sum(seen**2)))
    if abs(agreement) < 0.5:
        return None
    return abs(float(np.sum(expected * seen)) / power)


def _against_quaternion(record: Record) -> float | None:
    if record.quaternion is None:
        return None
    stride = max(round(0.1 / record.step_s), 1)
    rotation = rotations(record.quaternion[::stride])
    steps = (rotation[:-1].inv() * rotation[1:]).as_rotvec()
    if np.sqrt(np.mean(np.sum(steps**2, axis=1))) < 1e-3:
        return None
    total = np.concatenate([[np.zeros(3)], np.cumsum(record.rate, axis=0)]) * record.step_s
    turned = np.diff(total[: len(record) : stride], axis=0)[: len(steps)]
    return float(np.sqrt(np.sum(steps**2) / max(np.sum((turned - turned.mean(axis=0)) ** 2), 1e-30)))
