"""Attitudes in space and the angles they are told in."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]


def angles(rotation: Rotation) -> tuple[Array, Array, Array]:
    """Roll, pitch and yaw, rad: turned by yaw about z, then pitch, then roll; pitch is nose up.

    Nose up is counter-clockwise in the x-z plane, the sign of pitch in vertical-plane logs; roll is
    port side up. Yaw is unwrapped.

    >>> nose_up = Rotation.from_rotvec([0.0, -0.1, 0.0])
    >>> [round(float(a[0]), 3) for a in angles(Rotation.concatenate([nose_up]))]
    [0.0, 0.1, 0.0]
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # at the pole roll is set to 0
        yaw, pitch, roll = np.atleast_2d(rotation.as_euler("ZYX")).T
    return roll, -pitch, np.unwrap(yaw)


def from_angles(roll: Any, pitch: Any, yaw: Any) -> Rotation:
    """The inverse of :func:`angles`; all rad, shape (n,)."""
    return Rotation.from_euler("ZYX", np.column_stack((yaw, -np.asarray(pitch), roll)))
