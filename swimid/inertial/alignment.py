"""How a sensor sits in a body that another log follows: clock, mounting, and the first pose."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from swimid.errors import NoTrustworthyResult
from swimid.inertial import clock, strapdown
from swimid.inertial.clock import Offset
from swimid.inertial.record import Array, Record, resampled
from swimid.inertial.setup import Source
from swimid.logs.rotation import angles, from_angles

#: Slower than this is drift, s: of an integrated gyroscope, of a twice integrated accelerometer.
SLOW_TURN_S, SLOW_WAY_S = 10.0, 2.0
#: A reference that explains less of what was seen is of another trial.
LEAST_EXPLAINED = 0.2


@dataclass(frozen=True)
class Poses:
    """What another log says of the robot."""

    #: Shape (m,). On its own clock.
    time_s: Array
    #: Shape (m, 3). World axes, m; NaN where not measured.
    position: Array
    #: Shape (m, 3). Roll, pitch and yaw, rad, signs of :func:`swimid.logs.rotation.angles`; NaN where not
    #: measured. All three are, or yaw, or pitch, or none.
    angles: Array

    @property
    def measured(self) -> np.ndarray:
        """Which of the angles are, shape (3,)."""
        return np.asarray(np.isfinite(self.angles).any(axis=0))

    @property
    def full(self) -> bool:
        """Whether all three angles are there."""
        return bool(self.measured.all())

    @property
    def rotation(self) -> Rotation:
        """Body to world, m of them; angles that are not there or missing are 0."""
        return from_angles(*np.nan_to_num(self.angles).T)

    @property
    def turned(self) -> np.ndarray:
        """Which rows have every angle that the log has, shape (m,)."""
        there = self.measured
        return np.asarray(there.any() & np.isfinite(self.angles[:, there]).all(axis=1))

    @property
    def turns(self) -> np.ndarray:
        """Which angles of which rows are compared: those of rows that have all, shape (m, 3)."""
        return np.isfinite(self.angles) & self.turned[:, None]


@dataclass(frozen=True)
class Fit:
    """A sensor's rates against a body's."""

    #: To add to the other log's times.
    offset: Offset
    #: "turn rates", "yaw", "pitch" or "path".
    by: str
    #: Body to sensor, where three angles tell it.
    mount: Rotation | None = None
    #: Determinant of the best matrix between rates: -1 where an axis is mirrored, 0 where they cannot tell.
    handed: float = 0.0


def fit_clocks(record: Record, source: Source, poses: Poses) -> list[Fit]:
    """Clock offsets by turns and by the path, the surest first, and what turns tell of the mounting.

    Raises
    ------
    NoTrustworthyResult
        When nothing in the two logs moves together.
    """
    fits = [fit for fit in (_by_turns(record, source, poses), _by_path(record, source, poses)) if fit]
    good = [fit for fit in fits if fit.offset.explained >= LEAST_EXPLAINED]
    if not good:
        best = max((fit.offset.explained for fit in fits), default=0.0)
        raise NoTrustworthyResult(
            f"the two logs do not move together (the inertial one explains {100 * best:.0f} % of the other); "
            "their clocks cannot be set",
            hint="are they of the same trial, with units and axes right? --clock-offset-s gives the offset",
        )
    return sorted(good, key=lambda fit: fit.offset.stderr_s)


def fit_at(record: Record, poses: Poses, offset_s: float) -> Fit:
    """The same for a clock offset that is given."""
    return _fitted(
        record, poses, Offset(offset_s, 0.0, offset_s, offset_s, np.nan, np.zeros((0, 0))), "given"
    )


def _fitted(record: Record, poses: Poses, offset: Offset, by: str) -> Fit:
    """What an offset tells of the mounting, where there are three angles."""
    if not poses.full:
        return Fit(offset, by)
    mount, handed = _mount(record, replace(poses, time_s=poses.time_s + offset.value_s))
    return Fit(offset, by, mount, handed)


def _by_turns(record: Record, source: Source, poses: Poses) -> Fit | None:
    rows = np.flatnonzero(poses.turned)
    if len(rows) < 16:
        return None
    if poses.full:
        name, rate, seen = "turn rates", record.rate, _wound(poses.rotation[rows])
    else:
        world = source.rotation.apply(record.rate)
        name, rate = ("yaw", world[:, 2:]) if poses.measured[2] else ("pitch", record.rate)
        seen = poses.angles[rows][:, poses.measured]
    turned = strapdown.integral(record.time_s, rate - rate.mean(axis=0))
    offset = clock.offset(record.time_s, turned, poses.time_s[rows], seen, slow_s=SLOW_TURN_S)
    if offset is None or poses.full:
        return None if offset is None else _fitted(record, poses, offset, name)
    return Fit(offset, name, None, float(np.sign(offset.factors[0, 0])) if poses.measured[2] else 0.0)


def _by_path(record: Record, source: Source, poses: Poses) -> Fit | None:
    axes = np.isfinite(poses.position).mean(axis=0) > 0.1
    if not axes.any():
        return None
    way, seen = _way(record, source), poses.position[:, axes]
    offset = clock.offset(record.time_s, way, poses.time_s, seen, slow_s=SLOW_WAY_S)
    return None if offset is None else Fit(offset, "path")


def _wound(rotation: Rotation) -> Array:
    """The body's turns added up, shape (m, 3): increments about body axes."""
    steps = (rotation[:-1].inv() * rotation[1:]).as_rotvec()
    return np.vstack([np.zeros((1, 3)), np.cumsum(steps, axis=0)])


def _mount(record: Record, poses: Poses) -> tuple[Rotation, float]:
    """Body to sensor from increments of turn and from the direction of gravity; handedness.

    Wahba's problem (1965, doi:10.1137/1007077), solved by SVD (Markley 1988). Gravity weighs as much as
    all turns, so that a body that turns about one axis only is placed as well.
    """
    rows = np.flatnonzero(
        poses.turned & (poses.time_s > record.time_s[0]) & (poses.time_s < record.time_s[-1])
    )
    rotation, t = poses.rotation[rows], poses.time_s[rows]
    body = clock.without_slow(t, _wound(rotation), SLOW_TURN_S)
    turned = strapdown.integral(record.time_s, record.rate - record.rate.mean(axis=0))
    sensor = clock.without_slow(t, resampled(t, record.time_s, turned), SLOW_TURN_S)
    up_body = rotation.inv().apply([0.0, 0.0, 1.0])
    force = strapdown.integral(record.time_s, record.acceleration)
    mean_force = resampled(t, record.time_s, force)
    window = np.clip(np.searchsorted(t, t + 1.0), 0, len(t) - 1)
    span = np.maximum(t[window] - t, 1e-9)[:, None]
    long = (t[window] - t) > 0.5
    up_sensor = ((mean_force[window] - mean_force) / span)[long] / 9.81
    joint = np.cumsum(up_body, axis=0)
    count = np.maximum(window - np.arange(len(t)), 1)[:, None]
    up_body = ((joint[window] - joint) / count)[long]
    cross = sensor.T @ body / max(np.sum(body**2), 1e-30)
    with_gravity = cross + (up_sensor.T @ up_body / max(len(up_body), 1) if long.any() else 0.0)
    u, _, vt = np.linalg.svd(with_gravity)
    proper = np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    free = np.linalg.svd(cross)[1]
    handed = float(np.sign(np.linalg.det(cross))) if free[2] > 0.02 * free[0] else 0.0
    return Rotation.from_matrix(u @ proper @ vt), handed


def world_turn(record: Record, source: Source, poses: Poses, mount: Rotation) -> Rotation:
    """The turn from the source's world to that of the other log; poses on the record's clock.

    By its angles where there is a yaw, else the turn about the vertical that lays the reckoned path on the
    seen one.
    """
    inside = (poses.time_s >= record.time_s[0]) & (poses.time_s <= record.time_s[-1])
    if poses.measured[2]:
        rows = np.flatnonzero(poses.turned & inside)
        near = np.clip(np.searchsorted(record.time_s, poses.time_s[rows]), 0, len(record) - 1)
        if not len(rows):
            return Rotation.identity()
        body = source.rotation[near] * mount
        if poses.full:
            return (poses.rotation[rows] * body.inv()).mean()
        turn = float(np.angle(np.mean(np.exp(1j * (poses.angles[rows, 2] - angles(body)[2])))))
    else:
        rows = np.flatnonzero(inside & np.isfinite(poses.position[:, :2]).all(axis=1))
        if len(rows) < 16:
            return Rotation.identity()
        t = poses.time_s[rows]
        reckoned = resampled(t, record.time_s, _way(record, source)[:, :2])
        both = clock.without_slow(t, np.hstack([reckoned, poses.position[rows, :2]]), SLOW_WAY_S)
        cross = both[:, :2].T @ both[:, 2:]
        turn = float(np.arctan2(cross[0, 1] - cross[1, 0], cross[0, 0] + cross[1, 1]))
    return Rotation.from_rotvec([0.0, 0.0, turn])


def _way(record: Record, source: Source) -> Array:
    """Accelerations integrated twice, world axes, without what is slower than :data:`SLOW_WAY_S`."""
    force = source.rotation.apply(record.acceleration)
    force = force - force.mean(axis=0)
    way = strapdown.integral(record.time_s, strapdown.integral(record.time_s, force))
    return clock.without_slow(record.time_s, way, SLOW_WAY_S)
