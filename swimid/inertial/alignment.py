"""Alignment of an inertial sensor with another log of the trial, in time and in attitude.

The module computes the clock offset, the mounting of the sensor, and the rotation between the world axes of
the two logs.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from swimid.errors import NoTrustworthyResult
from swimid.imports.clocks import MIN_EXPLAINED, MIN_SAMPLES_OFFSET, Offset, clock_offset, remove_drift
from swimid.inertial import record as recording
from swimid.inertial.record import Array, AttitudeSource, ImuRecord, Poses, integral, resampled, turns_of
from swimid.kinematics.attitude import angles

#: Minimum period of a component that counts as drift, s: SLOW_TURN_S in integrated turn rates, and
#: SLOW_PATH_S in accelerations integrated twice.
SLOW_TURN_S, SLOW_PATH_S = 10.0, 2.0
#: Minimum fraction of the samples of the other log in which a coordinate is measured.
MIN_MEASURED = 0.1
#: Length of the windows over which the direction of gravity is averaged, s, and minimum length of an
#: incomplete window at the end of the log, s.
GRAVITY_S, MIN_GRAVITY_S = 1.0, 0.5
#: Minimum ratio of the smallest to the largest singular value of the correlation matrix between the rotations
#: in two logs. Below this ratio a mirrored axis cannot be detected.
MIN_SINGULAR = 0.02


def align(
    record: ImuRecord, source: AttitudeSource, poses: Poses, stated_s: float | None = None
) -> list[Offset]:
    """Return up to two estimates of the clock offset: from the rotations and from the paths in the two logs.

    The estimates are in order of increasing standard error.

    Parameters
    ----------
    stated_s : float, optional
        Offset that the user states. It replaces the estimates.

    Raises
    ------
    NoTrustworthyResult
        The two logs do not show the same motion.
    """
    if stated_s is not None:
        return [_with_mount(record, poses, Offset(stated_s, 0.0, stated_s, stated_s))]
    found = [one for one in (_by_turns(record, source, poses), _by_path(record, source, poses)) if one]
    good = [one for one in found if one.explained >= MIN_EXPLAINED]
    if not good:
        best = max((one.explained for one in found), default=0.0)
        raise NoTrustworthyResult(
            f"the two logs do not move together (the inertial log explains only {100 * best:.0f} % of the "
            "other log), so that the offset between their clocks cannot be estimated",
            hint="check that both are of the same trial, and check units and axes; or give the offset with "
            "--clock-offset-s",
        )
    return sorted(good, key=lambda one: one.stderr_s)


def _with_mount(record: ImuRecord, poses: Poses, offset: Offset) -> Offset:
    if not poses.has_angle.all():
        return offset
    mount, handed = _find_mount(record, replace(poses, time_s=poses.time_s + offset.value_s))
    return replace(offset, mount=mount, handed=handed)


def _by_turns(record: ImuRecord, source: AttitudeSource, poses: Poses) -> Offset | None:
    rows = np.flatnonzero(poses.has_attitude)
    if len(rows) < MIN_SAMPLES_OFFSET:
        return None
    seen, rate = poses.angles[rows][:, poses.has_angle], record.rate
    by_yaw = seen.shape[1] == 1 and bool(poses.has_angle[2])
    if poses.has_angle.all():
        seen = _sum_turns(poses.rotation[rows])
    elif by_yaw:
        rate = source.rotation.apply(record.rate)[:, 2:]
    turned = integral(record.time_s, rate - rate.mean(axis=0))
    offset = clock_offset(record.time_s, turned, poses.time_s[rows], seen, slow_s=SLOW_TURN_S)
    if offset is not None and by_yaw:
        return replace(offset, handed=float(np.sign(offset.factors[0, 0])))
    return offset and _with_mount(record, poses, offset)


def _by_path(record: ImuRecord, source: AttitudeSource, poses: Poses) -> Offset | None:
    axes = np.isfinite(poses.position).mean(axis=0) > MIN_MEASURED
    if not axes.any():
        return None
    path, seen = _fast_path(record, source), poses.position[:, axes]
    return clock_offset(record.time_s, path, poses.time_s, seen, slow_s=SLOW_PATH_S)


def _sum_turns(rotation: Rotation) -> Array:
    """Return the sum of the rotation vectors from the first attitude up to each one, rad, shape (m, 3).

    The rotation vectors are those between successive attitudes, about body axes.
    """
    return np.vstack([np.zeros((1, 3)), np.cumsum(turns_of(rotation), axis=0)])


def _find_mount(record: ImuRecord, poses: Poses) -> tuple[Rotation, float]:
    """Return the mounting of the sensor (rotation from body to sensor axes) from another log with attitudes.

    The second returned value is the handedness: the sign of the determinant of the correlation between the
    rotations in the two logs.

    The mounting solves Wahba's problem (1965, doi:10.1137/1007077) by SVD (Markley 1988). The vectors are
    rotations about body axes and the direction of gravity. Gravity has the same weight as all rotations
    together, so that the mounting is also determined for a body that rotates about one axis only.
    """
    t = record.time_s
    rows = np.flatnonzero(poses.has_attitude & (poses.time_s > t[0]) & (poses.time_s < t[-1]))
    rotation, when = poses.rotation[rows], poses.time_s[rows]
    body = remove_drift(when, _sum_turns(rotation), SLOW_TURN_S)
    turned = integral(t, record.rate - record.rate.mean(axis=0))
    sensor = remove_drift(when, resampled(when, t, turned), SLOW_TURN_S)
    # Average the direction of gravity over a window that begins at each pose. In sensor axes, the average is
    # that of the specific force; in body axes, that of the attitudes of the poses.
    last = np.clip(np.searchsorted(when, when + GRAVITY_S), 0, len(when) - 1)
    span, count = when[last] - when, np.maximum(last - np.arange(len(when)), 1)
    long = span > MIN_GRAVITY_S
    force = resampled(when, t, integral(t, record.acceleration))
    up_sensor = (force[last] - force)[long] / span[long, None] / recording.GRAVITY_M_S2
    up = np.cumsum(rotation.inv().apply([0.0, 0.0, 1.0]), axis=0)
    up_body = (up[last] - up)[long] / count[long, None]
    cross = sensor.T @ body / max(np.sum(body**2), 1e-30)
    u, _, vt = np.linalg.svd(cross + up_sensor.T @ up_body / max(len(up_body), 1))
    proper = np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    singular, handed = np.linalg.svd(cross)[1], 0.0
    if singular[2] > MIN_SINGULAR * singular[0]:
        handed = float(np.sign(np.linalg.det(cross)))
    return Rotation.from_matrix(u @ proper @ vt), handed


def find_world_turn(record: ImuRecord, source: AttitudeSource, poses: Poses, mount: Rotation) -> Rotation:
    """Return the rotation from the world axes of the attitude source to those of the other log.

    If the other log has a yaw, the rotation follows from its angles. Otherwise it is the rotation about the
    vertical that best aligns the path from the accelerations with the measured path.

    Parameters
    ----------
    poses : Poses
        Poses on the clock of the record.
    mount : Rotation
        Mounting from body to sensor.
    """
    inside = (poses.time_s >= record.time_s[0]) & (poses.time_s <= record.time_s[-1])
    if poses.has_angle[2]:
        rows = np.flatnonzero(poses.has_attitude & inside)
        if not len(rows):
            return Rotation.identity()
        near = np.clip(np.searchsorted(record.time_s, poses.time_s[rows]), 0, len(record) - 1)
        body = source.rotation[near] * mount
        if poses.has_angle.all():
            return (poses.rotation[rows] * body.inv()).mean()
        turn = float(np.angle(np.mean(np.exp(1j * (poses.angles[rows, 2] - angles(body)[2])))))
    else:
        rows = np.flatnonzero(inside & np.isfinite(poses.position[:, :2]).all(axis=1))
        # Do not rotate the axes if the other log has no horizontal path: a coordinate that it lacks is
        # constant.
        if len(rows) < MIN_SAMPLES_OFFSET or np.ptp(poses.position[rows, :2], axis=0).min() == 0:
            return Rotation.identity()
        t = poses.time_s[rows]
        path = resampled(t, record.time_s, _fast_path(record, source)[:, :2])
        both = remove_drift(t, np.hstack([path, poses.position[rows, :2]]), SLOW_PATH_S)
        cross = both[:, :2].T @ both[:, 2:]
        turn = float(np.arctan2(cross[0, 1] - cross[1, 0], cross[0, 0] + cross[1, 1]))
    return Rotation.from_rotvec([0.0, 0.0, turn])


def _fast_path(record: ImuRecord, source: AttitudeSource) -> Array:
    """Return the path from accelerations along world axes (m), without drift slower than ``SLOW_PATH_S``."""
    force = source.rotation.apply(record.acceleration)
    path = integral(record.time_s, integral(record.time_s, force - force.mean(axis=0)))
    return remove_drift(record.time_s, path, SLOW_PATH_S)
