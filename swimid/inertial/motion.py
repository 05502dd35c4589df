"""The motion of the body's reference point, its standard deviations, and its part within a stroke.

:func:`by_paper` computes it as Shang, Wang, Tan and Cheng (2012, doi:10.1017/S0263574711001159) do.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from swimid.inertial import strapdown
from swimid.inertial.aiding import turn_to_angles
from swimid.inertial.errorstate import cross_matrix, jacobian
from swimid.inertial.record import Array, Record, resampled
from swimid.inertial.smoother import Nominal, Smoothed

#: Slower than this is no motion within a stroke where no stroke is found, Hz; with one: this share of its
#: frequency.
LOWEST_HZ, STROKE_SHARE = 0.3, 0.5
#: Trajectories of errors that are drawn. They give a standard deviation to 1 / sqrt(2 DRAWS) = 6 %.
DRAWS = 128


@dataclass(frozen=True)
class Motion:
    """Motion of the reference point at every sample."""

    #: Shape (n,).
    time_s: Array
    #: Body to world.
    rotation: Rotation
    #: Shape (n, 3). World axes, world axes and body axes (surge, sway, heave); m and m/s.
    position: Array
    velocity: Array
    body_velocity: Array
    #: Shape (n, 3). Turn rate, body axes, rad/s.
    rate: Array
    #: Shape (n, 3). Of the sensor, world axes, gravity removed, m/s^2.
    acceleration: Array
    #: Shape (n, 3). Standard deviations; angles are roll, pitch, yaw, rad.
    position_sd: Array
    velocity_sd: Array
    body_velocity_sd: Array
    angle_sd: Array


def without(motion: Motion, rows: np.ndarray) -> Motion:
    """The same with position and velocity, and their deviations, missing in these rows, shape (n,)."""
    empty = np.where(rows[:, None], np.nan, 0.0)
    names = ("position", "velocity", "body_velocity", "position_sd", "velocity_sd", "body_velocity_sd")
    return replace(motion, **{name: getattr(motion, name) + empty for name in names})


def of_attitude(
    time_s: Array, rotation: Rotation, rate: Array, acceleration: Array, attitude_sd: float
) -> Motion:
    """A motion of which only the attitude is known; shapes and units as in :class:`Motion`."""
    empty = np.full((len(time_s), 3), np.nan)
    sd = np.full((len(time_s), 3), attitude_sd)
    return Motion(time_s, rotation, empty, empty, empty, rate, acceleration, empty, empty, empty, sd)


def by_paper(
    record: Record,
    rotation: Rotation,
    mode: Literal["marching", "receding", "rotating"],
    threshold_m_s2: float,
    threshold_rad_s: float,
) -> tuple[Motion, Array]:
    """Compute the motion by the steps of Shang et al. (2012), section 5; it has no standard deviations.

    The constant part of the readings is removed, small readings are set to zero, accelerations are turned to
    the earth's axes (Eq 10), and velocity and position follow by the trapezoidal rule (Eqs 12 and 13). The
    paper states neither the filter nor the threshold.

    Parameters
    ----------
    record : Record
        In body axes.
    rotation : Rotation
        Body to earth, n of them: the inverse of the paper's ``M_e^f``.
    mode : str
        ``marching`` and ``receding``: the vehicle keeps its heading, so the constant part of all six
        channels is error (and gravity). ``rotating``: it turns at a mean rate, so that of the yaw rate
        is kept.
    threshold_m_s2, threshold_rad_s : float
        Readings below these are set to 0 ("discarded", sec. 5.2).

    Returns
    -------
    Motion
    ndarray, shape (6,)
        The constant parts, m/s^2 and rad/s.

    Notes
    -----
    Removing the mean acceleration makes the last velocity equal the first, whatever the vehicle did.
    """
    constant = record.channels.mean(axis=0)
    if mode == "rotating":
        constant[5] = 0.0
    readings = record.channels - constant
    readings[np.abs(readings) < np.repeat([threshold_m_s2, threshold_rad_s], 3)] = 0.0
    acceleration = rotation.apply(readings[:, :3])
    velocity = strapdown.integral(record.time_s, acceleration)
    moved = of_attitude(record.time_s, rotation, readings[:, 3:], acceleration, np.nan)
    position, in_body = strapdown.integral(record.time_s, velocity), rotation.inv().apply(velocity)
    return replace(moved, position=position, velocity=velocity, body_velocity=in_body), constant


@dataclass(frozen=True)
class Carried:
    """Velocity of the reference point, and how it and the turn of the body depend on the states at the nodes.

    ``velocity`` has shape (n, 3), in world axes; ``by_place``, ``by_speed`` and ``by_turn`` have shape
    (nodes, 3, states).
    """

    velocity: Array
    by_place: Array
    by_speed: Array
    by_turn: Array


def _carried(path: Nominal) -> Carried:
    """Carry velocity and sensitivities from the sensor to the reference point."""
    rows = path.nodes
    rate, rotation = path.rate[rows], path.rotation[rows]
    matrix = rotation.as_matrix()
    shape = (path.states, len(rows), 3)
    arm, swing = rotation.apply(path.lever), rotation.apply(np.cross(rate, path.lever))
    by_place = jacobian(*shape, position=np.eye(3), rotation=-cross_matrix(arm), lever=matrix)
    by_speed = jacobian(
        *shape,
        velocity=np.eye(3),
        rotation=-cross_matrix(swing),
        rate_bias=matrix @ cross_matrix(path.lever),
        lever=matrix @ cross_matrix(rate),
    )
    by_turn = jacobian(*shape, rotation=np.eye(3), mount=matrix)
    velocity = path.velocity + path.rotation.apply(np.cross(path.rate, path.lever))
    return Carried(velocity, by_place, by_speed, by_turn)


def at_reference(smoothed: Smoothed) -> Motion:
    """Carry path and covariance from the sensor to the reference point."""
    path, covariance = smoothed.path, smoothed.errors.covariance
    body, carried, rows = path.rotation * path.mount, _carried(path), path.nodes
    position, velocity = path.position + path.rotation.apply(path.lever), carried.velocity
    by_body_speed = _in_body(body[rows], velocity[rows], carried.by_speed, carried.by_turn)

    def sd(jacobian: Array) -> Array:
        variance = np.einsum("nij,njk,nik->ni", jacobian, covariance, jacobian)
        return resampled(path.time_s, path.node_s, np.sqrt(np.maximum(variance, 0.0)))

    return Motion(
        path.time_s,
        body,
        position,
        velocity,
        body.inv().apply(velocity),
        path.mount.inv().apply(path.rate),
        path.acceleration,
        sd(carried.by_place),
        sd(carried.by_speed),
        sd(by_body_speed),
        sd(turn_to_angles(body[rows]) @ carried.by_turn),
    )


def _in_body(body: Rotation, velocity: Array, speed_error: Array, turn_error: Array) -> Array:
    """Errors of the velocity along body axes, from those of the velocity and of the turn in world axes.

    ``velocity`` has shape (n, 3), the errors have shape (n, 3, m): samples, or derivatives.
    """
    to_body = np.swapaxes(body.as_matrix(), 1, 2)
    return np.asarray(to_body @ (speed_error + cross_matrix(velocity) @ turn_error))


def surge_within_stroke(motion: Motion, smoothed: Smoothed, cutoff_hz: float) -> tuple[Array, Array]:
    """Return the surge within a stroke and its standard deviation, m/s, each of shape (n,).

    The velocity is high-passed along the world's axes before it is turned to the body's: a drifting velocity
    would leak into the surge with every swing of the heading.

    Notes
    -----
    The deviation is that of :data:`DRAWS` trajectories of the smoother's errors, each high-passed like the
    velocity itself. So it holds every error that is faster than the cut-off: noise, errors of scale and
    alignment times gravity and motion, and errors of the attitude times gravity.
    """
    fast = _high_passed(motion.time_s, motion.velocity, cutoff_hz)
    surge = motion.rotation.inv().apply(fast)[:, 0]
    path = smoothed.path
    carried, nodes = _carried(path), len(path.nodes)
    drawn = smoothed.errors.draw(np.concatenate([carried.by_speed, carried.by_turn], axis=1), DRAWS)
    speed = _high_passed(path.node_s, drawn[:, :3].reshape(nodes, -1), cutoff_hz).reshape(nodes, 3, DRAWS)
    error = _in_body(motion.rotation[path.nodes], fast[path.nodes], speed, drawn[:, 3:])[:, 0]
    sd = np.interp(motion.time_s, path.node_s, np.sqrt(np.mean(error**2, axis=1)))
    return np.asarray(surge), sd


def _high_passed(time_s: Array, values: Array, cutoff_hz: float) -> Array:
    """Return channels, shape (n, k), less everything slower than ``cutoff_hz``.

    The filter is a Butterworth filter of fourth order without a phase shift. The result is NaN for a record
    that is too short or too slow for it.
    """
    from scipy import signal

    step = float(np.median(np.diff(time_s)))
    even = np.arange(time_s[0], time_s[-1] + 0.5 * step, step)
    if len(even) < 32 or cutoff_hz >= 0.45 / step:
        return np.full_like(values, np.nan)
    sos = signal.butter(2, cutoff_hz, "high", fs=1 / step, output="sos")
    length = min(len(even) - 1, int(3 / (cutoff_hz * step)))
    fast = signal.sosfiltfilt(sos, resampled(even, time_s, values), axis=0, padlen=length)
    return resampled(time_s, even, fast)
