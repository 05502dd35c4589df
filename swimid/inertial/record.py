"""One recording of an inertial unit, and the angles its attitude is told in."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

ACCELERATION = ("ax_m_s2", "ay_m_s2", "az_m_s2")
RATE = ("wx_rad_s", "wy_rad_s", "wz_rad_s")
CHANNELS = (*ACCELERATION, *RATE)
QUATERNION = ("qw", "qx", "qy", "qz")
MAGNETIC = ("mx", "my", "mz")
#: Standard gravity, m/s^2 (CGPM 1901).
GRAVITY_M_S2 = 9.80665


@dataclass(frozen=True)
class Record:
    """Samples of one inertial unit, in the sensor's axes."""

    #: Shape (n,).
    time_s: Array
    #: Shape (n, 3). Specific force, m/s^2.
    acceleration: Array
    #: Shape (n, 3). Turn rate, rad/s.
    rate: Array
    #: Shape (n, 4). w, x, y, z; sensor to world.
    quaternion: Array | None = None
    #: Shape (n, 3). Magnetic field, any unit.
    magnetic: Array | None = None
    #: Shape (n,). Samples that were not measured but bridged.
    filled_acceleration: Flags = field(default_factory=lambda: np.zeros(0, dtype=bool))
    filled_rate: Flags = field(default_factory=lambda: np.zeros(0, dtype=bool))
    metadata: Mapping[str, Any] = field(default_factory=dict)
    #: The file's name, for messages.
    name: str = "the log"

    def __post_init__(self) -> None:
        for flags in ("filled_acceleration", "filled_rate"):
            if len(getattr(self, flags)) != len(self.time_s):
                object.__setattr__(self, flags, np.zeros(len(self.time_s), dtype=bool))

    def __len__(self) -> int:
        return len(self.time_s)

    @property
    def step_s(self) -> float:
        """Typical sample time, s."""
        return float(np.median(np.diff(self.time_s)))

    @property
    def channels(self) -> Array:
        """Accelerations and turn rates, columns as in :data:`CHANNELS`, shape (n, 6)."""
        return np.hstack([self.acceleration, self.rate])

    def with_channels(self, values: Array) -> Record:
        """The same with other accelerations and turn rates, shape (n, 6)."""
        acceleration, rate = (np.ascontiguousarray(half) for half in np.hsplit(values, 2))
        return replace(self, acceleration=acceleration, rate=rate)

    def take(self, rows: Any) -> Record:
        """Only these rows."""
        arrays = {name: value[rows] for name, value in vars(self).items() if isinstance(value, np.ndarray)}
        return replace(self, **arrays)


@dataclass(frozen=True)
class Finding:
    """A fault of recording that was found."""

    #: Name of the fault, as in ``docs/imu.md``.
    fault: str
    #: "handled": repaired, or a doubt; "noted": left as it is, said; "refuted": a column is wrong.
    verdict: Literal["handled", "noted", "refuted"]
    #: What was found and what was done, one sentence.
    text: str
    #: Samples concerned; 0 where it is not a matter of samples.
    count: int = 0


def resampled(at_s: Array, time_s: Array, values: Array) -> Array:
    """Every column of ``values``, shape (n, k), at other times, linearly between samples, shape (m, k)."""
    return np.column_stack([np.interp(at_s, time_s, column) for column in values.T])


def rotations(quaternion: Array) -> Rotation:
    """Rotations of quaternions written w, x, y, z, shape (n, 4)."""
    return Rotation.from_quat(quaternion[:, [1, 2, 3, 0]])


def level(up: Array) -> Rotation:
    """The smallest turn that makes ``up``, shape (3,), the z axis.

    >>> level(np.array([0.0, 2.0, 0.0])).apply([0.0, 1.0, 0.0]).round(9).tolist()
    [0.0, 0.0, 1.0]
    """
    unit = np.asarray(up, dtype=float) / np.linalg.norm(up)
    axis = np.cross(unit, [0.0, 0.0, 1.0])
    size = float(np.linalg.norm(axis))
    if size < 1e-12:
        return Rotation.identity() if unit[2] > 0 else Rotation.from_rotvec([np.pi, 0.0, 0.0])
    return Rotation.from_rotvec(axis / size * np.arctan2(size, unit[2]))
