"""How the sensor sits in the body: given, or told by gravity at rest."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from swimid.errors import InputError
from swimid.inertial.faults.base import Finding
from swimid.inertial.record import Array, Record, level
from swimid.inertial.rest import Rest, mean_accelerations
from swimid.inertial.sensor import DEG
from swimid.logs.rotation import from_angles

NAME = "gravity axis"
#: Within this angle of the z axis gravity is where it should be; farther off the sensor lies on its side.
UPRIGHT = 45 * DEG


@dataclass(frozen=True)
class Mount:
    """Body to sensor, how it is known, and gravity in the sensor at rest (unit vector)."""

    rotation: Rotation
    by: str
    up: Array


def settle(
    record: Record,
    rests: list[Rest],
    mount_deg: tuple[float, float, float] | None,
    *,
    level_at_rest: bool,
) -> tuple[Mount, list[Finding]]:
    """Body to sensor before any other log is looked at.

    Quaternion columns turn the body to the world, so that with them the sensor's axes are the body's. A body
    that came to rest lying otherwise than it began tells nothing of its mounting there: then the first rest
    does.

    Raises
    ------
    InputError
        When gravity points down the z axis: an accelerometer with the wrong sign, or upside down.
    """
    seen = mean_accelerations(record, rests)
    seen = seen / np.linalg.norm(seen, axis=1, keepdims=True)
    up = seen[0] if np.min(seen @ seen[0]) < np.cos(UPRIGHT) else seen.mean(axis=0)
    up = up / np.linalg.norm(up)
    if mount_deg is not None:
        roll, pitch, yaw = (np.array([angle * DEG]) for angle in mount_deg)
        return Mount(from_angles(roll, pitch, yaw)[0].inv(), "given", up), []
    if record.quaternion is not None:
        return Mount(Rotation.identity(), "quaternions", up), []
    if float(np.arccos(np.clip(up[2], -1, 1))) <= UPRIGHT:
        if level_at_rest:
            return Mount(level(up).inv(), "level at rest", up), []
        return Mount(Rotation.identity(), "as the sensor's axes", up), []
    axis = int(np.argmax(np.abs(up)))
    nearest = np.sign(up[axis]) * np.eye(3)[axis]
    name = f"{'-' if up[axis] < 0 else '+'}{'xyz'[axis]}"
    if name == "-z":
        raise InputError(
            "gravity points the wrong way at rest: az is negative where a sensor with z up shows +9.81",
            file=record.name,
            column="az_m_s2",
            hint="for an accelerometer of the other sign give factor -1 for all three axes in a mapping "
            "(--map); for a sensor mounted upside down give --mount-deg 180 0 0",
        )
    text = (
        f"gravity lies along the sensor's {name} axis, not +z: the sensor is taken as turned by the smallest "
        "turn that puts this axis up; give --mount-deg if the body's forward axis comes out wrong"
    )
    rotation = level(up if level_at_rest else nearest).inv()
    return Mount(rotation, f"{name} axis up", up), [Finding(NAME, "handled", text)]


def tilt_at_rest(up: Array, mount: Rotation) -> tuple[float, float]:
    """Roll and pitch of the body at rest, rad."""
    body = mount.inv().apply(up)
    return float(np.arctan2(body[1], body[2])), float(np.arctan2(body[0], np.hypot(body[1], body[2])))
