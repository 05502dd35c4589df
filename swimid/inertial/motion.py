"""The motion of the body's reference point, how sure each number of it is, and its part within a stroke."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import signal
from scipy.spatial.transform import Rotation

from swimid.inertial.aiding import turn_to_angles
from swimid.inertial.errorstate import cross_matrix, jacobian
from swimid.inertial.record import Array, resampled
from swimid.inertial.smoother import Smoothed

#: Slower than this is no motion within a stroke where no stroke is found, Hz; with one: this share of its
#: frequency.
LOWEST_HZ, STROKE_SHARE = 0.3, 0.5


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
    missing = np.full((len(time_s), 3), np.nan)
    sd = np.full((len(time_s), 3), attitude_sd)
    return Motion(
        time_s, rotation, missing, missing, missing, rate, acceleration, missing, missing, missing, sd
    )


def at_reference(smoothed: Smoothed) -> Motion:
    """Carry path and covariance from the sensor to the reference point."""
    path, covariance = smoothed.path, smoothed.errors.covariance
    body = path.rotation * path.mount
    position = path.position + path.rotation.apply(path.lever)
    velocity = path.velocity + path.rotation.apply(np.cross(path.rate, path.lever))
    # at the nodes, of position, velocity and turn with respect to the states
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
    to_body = np.swapaxes(body[rows].as_matrix(), 1, 2)
    by_body_speed = to_body @ (by_speed + cross_matrix(velocity[rows]) @ by_turn)

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
        sd(by_place),
        sd(by_speed),
        sd(by_body_speed),
        sd(turn_to_angles(body[rows]) @ by_turn),
    )


def surge_within_stroke(motion: Motion, cutoff_hz: float) -> Array:
    """The surge within a stroke, m/s, shape (n,).

    The velocity is high-passed along the world's axes before it is turned to the body's: a drifting velocity
    would leak into the surge with every swing of the heading.
    """
    fast = np.column_stack([_high_passed(motion.time_s, column, cutoff_hz) for column in motion.velocity.T])
    return np.asarray(motion.rotation.inv().apply(fast)[:, 0])


def _high_passed(time_s: Array, values: Array, cutoff_hz: float) -> Array:
    """A channel less everything slower than ``cutoff_hz``: fourth-order Butterworth, no phase shift."""
    step = float(np.median(np.diff(time_s)))
    even = np.arange(time_s[0], time_s[-1] + 0.5 * step, step)
    if len(even) < 32 or cutoff_hz >= 0.45 / step:
        return np.full_like(values, np.nan)
    sos = signal.butter(2, cutoff_hz, "high", fs=1 / step, output="sos")
    length = min(len(even) - 1, int(3 / (cutoff_hz * step)))
    return np.interp(time_s, even, signal.sosfiltfilt(sos, np.interp(even, time_s, values), padlen=length))


def high_passed_sd(acceleration_noise: float, cutoff_hz: float, scale_sd: float, values: Array) -> float:
    """Deviation of a high-passed velocity, m/s.

    Notes
    -----
    White acceleration noise of density N leaves ``N / (2 pi sqrt(f_c))`` after integration and a sharp
    high pass at f_c (integral of ``N^2 / (2 pi f)^2`` from f_c up); an error of scale adds in proportion.
    """
    white = acceleration_noise / (2 * np.pi * np.sqrt(cutoff_hz))
    return float(np.hypot(white, scale_sd * np.nanstd(values)))
