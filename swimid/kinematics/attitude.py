"""Attitudes: angles and quaternions of the log format, and the axes of other programs."""

from __future__ import annotations

import re
import warnings
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]


def angles(rotation: Rotation) -> tuple[Array, Array, Array]:
    """Return the roll, pitch and yaw angles of rotations, rad.

    The rotation is by yaw about z, then by pitch, then by roll. Pitch is positive with the nose up, which is
    counter-clockwise in the x-z plane. Roll is positive with the port side up. Roll and yaw are
    unwrapped.

    >>> from scipy.spatial.transform import Rotation
    >>> nose_up = Rotation.from_rotvec([0.0, -0.1, 0.0])
    >>> [round(float(a[0]), 3) for a in angles(Rotation.concatenate([nose_up]))]
    [0.0, 0.1, 0.0]
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # scipy warns at a pitch of ±90 degrees
        yaw, pitch, roll = np.atleast_2d(rotation.as_euler("ZYX")).T
    return np.unwrap(roll), -pitch, np.unwrap(yaw)


def from_angles(roll: Any, pitch: Any, yaw: Any) -> Rotation:
    """Return the rotations with given roll, pitch and yaw, rad, shape (n,): the inverse of :func:`angles`."""
    from scipy.spatial.transform import Rotation

    return Rotation.from_euler("ZYX", np.column_stack((yaw, -np.asarray(pitch), roll)))


#: Columns of a log with the attitude quaternion, which rotates from body to world. The real part is the
#: first.
AXES = ("qw", "qx", "qy", "qz")


def reorder_quaternion(q: Array, order: str = "wxyz", direction: str = "body-to-world") -> Array:
    """Convert quaternions, shape (n, 4), to real part first and to the rotation from body to world.

    >>> reorder_quaternion(np.array([[0.0, 0.0, 0.6, 0.8]]), "xyzw", "world-to-body").tolist()
    [[0.8, -0.0, -0.0, -0.6]]
    """
    if order == "xyzw":
        q = np.roll(q, 1, axis=1)
    if direction == "world-to-body":
        q = q * [1.0, -1.0, -1.0, -1.0]
    return q


def from_frd(columns: dict[str, Array]) -> dict[str, Array]:
    """Convert columns from body axes forward, right, down to body axes forward, left, up.

    The y and z components of vectors and quaternions change their sign, and so does yaw. Roll (right side
    down is port side up), pitch (nose up), and the real and the x component of a quaternion keep theirs.
    """
    turned = re.compile(r"(desired_)?([awvmq]?[yz]|yaw)(_.*)?")
    return {name: -values if turned.fullmatch(name) else values for name, values in columns.items()}


def from_y_up(x: Array, y: Array, z: Array) -> tuple[Array, Array, Array]:
    """Convert a vector from axes with y up to axes with z up: x stays, y becomes z, and z becomes -y.

    The vector part of a quaternion is converted likewise if world and body have the same convention.
    """
    return x, -z, y


def with_angles(columns: dict[str, Array]) -> dict[str, Array]:
    """Return the columns of a log, with roll, pitch and yaw computed from the quaternion columns.

    Samples whose quaternion is not of unit length have no angles (NaN). If no sample has a valid quaternion,
    the quaternion columns are removed.
    """
    if not set(AXES) <= set(columns):
        return columns
    q = np.column_stack([columns[axis] for axis in AXES])
    there = np.abs(np.linalg.norm(q, axis=1) - 1.0) < 0.05
    if not there.any():
        return {name: values for name, values in columns.items() if name not in AXES}
    from scipy.spatial.transform import Rotation

    turned = np.full((len(q), 3), np.nan)
    turned[there] = np.column_stack(angles(Rotation.from_quat(q[there], scalar_first=True)))
    return columns | dict(zip(("roll_rad", "pitch_rad", "yaw_rad"), turned.T, strict=True))
