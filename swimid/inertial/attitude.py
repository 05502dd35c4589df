"""Attitude of the sensor before any smoothing: its own quaternions, or a filter's."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from swimid.inertial.record import Array, Record, resampled, rotations
from swimid.inertial.rest import Rest

#: An attitude that the log itself brings.
QUATERNIONS = "quaternion columns"


@dataclass(frozen=True)
class Source:
    """An attitude at every sample."""

    #: Sensor to world, n of them.
    rotation: Rotation
    #: Whether its yaw is held by something (a compass, the sensor's own filter).
    heading: bool
    #: "quaternion columns", "gyroscope and accelerometer", "gyroscope, accelerometer and magnetometer".
    kind: str


def estimate(record: Record, rests: list[Rest]) -> Source:
    """The attitude to start from.

    Quaternion columns are taken as they are. Without them the offline form of VQF (Laidig and Seel
    2023, doi:10.1016/j.inffus.2022.10.014), which runs forwards and backwards, makes it from turn rates,
    accelerations and, where there is one, the magnetic field; the yaw of the first sample is then 0,
    or magnetic where there is a field.
    """
    if record.quaternion is not None:
        return Source(rotations(record.quaternion), True, QUATERNIONS)
    import vqf

    t, step = record.time_s, record.step_s
    even = bool(np.ptp(np.diff(t)) < 1e-3 * step)
    grid = t if even else np.arange(t[0], t[-1] + step, step)
    readings = [record.rate - still_rate(record, rests), record.acceleration, record.magnetic]
    if not even:
        readings = [None if values is None else resampled(grid, t, values) for values in readings]
    told = vqf.offlineVQF(*(None if v is None else np.ascontiguousarray(v) for v in readings), step)
    rotation = rotations(np.asarray(told["quat6D" if record.magnetic is None else "quat9D"]))
    if not even:
        rotation = Slerp(grid, rotation)(np.clip(t, grid[0], grid[-1]))
    if record.magnetic is None:
        yaw = rotation[0].as_euler("ZYX")[0]
        return Source(Rotation.from_rotvec([0.0, 0.0, -yaw]) * rotation, False, "gyroscope and accelerometer")
    # VQF's world is east-north-up; yaw is counted from x, which is east
    return Source(rotation, True, "gyroscope, accelerometer and magnetometer")


def still_rate(record: Record, rests: list[Rest]) -> Array:
    """Turn rate of the still stretches, the median of their means, shape (3,); 0 where there are none."""
    if not rests:
        return np.zeros(3)
    return np.asarray(np.median([record.rate[r.rows].mean(axis=0) for r in rests], axis=0))
