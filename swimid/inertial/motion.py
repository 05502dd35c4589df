"""The motion of the body's reference point, and how sure each number of it is."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from swimid.inertial.errorstate import ALONE, BG, LEVER, MOUNT, P, T, V, cross_matrix
from swimid.inertial.record import Array
from swimid.inertial.smoother import Smoothed
from swimid.logs.rotation import angles


@dataclass(frozen=True)
class Motion:
    """Motion of the reference point at every sample.

    Attributes
    ----------
    time_s : ndarray, shape (n,)
    rotation : Rotation
        Body to world.
    position, velocity, body_velocity : ndarray, shape (n, 3)
        World axes, world axes and body axes (surge, sway, heave); m and m/s.
    rate : ndarray, shape (n, 3)
        Turn rate, body axes, rad/s.
    acceleration : ndarray, shape (n, 3)
        Of the sensor, world axes, gravity removed, m/s^2.
    position_sd, velocity_sd, body_velocity_sd, angle_sd : ndarray, shape (n, 3)
        Standard deviations; angles are roll, pitch, yaw, rad.
    """

    time_s: Array
    rotation: Rotation
    position: Array
    velocity: Array
    body_velocity: Array
    rate: Array
    acceleration: Array
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
    path = smoothed.path
    body = path.rotation * path.mount
    arm = path.rotation.apply(path.lever)
    swing = path.rotation.apply(np.cross(path.rate, path.lever))
    position, velocity = path.position + arm, path.velocity + swing
    body_velocity = body.inv().apply(velocity)
    place, speed, body_speed, turn = _jacobians(smoothed, velocity, body)
    covariance = smoothed.errors.covariance
    nodes = path.time_s[smoothed.nodes]

    def sd(jacobian: Array) -> Array:
        variance = np.einsum("nij,njk,nik->ni", jacobian, covariance, jacobian)
        deviation = np.sqrt(np.maximum(variance, 0.0))
        return np.column_stack([np.interp(path.time_s, nodes, c) for c in deviation.T])

    return Motion(
        path.time_s,
        body,
        position,
        velocity,
        body_velocity,
        path.mount.inv().apply(path.rate),
        path.acceleration,
        sd(place),
        sd(speed),
        sd(body_speed),
        sd(turn),
    )


def _jacobians(smoothed: Smoothed, velocity: Array, body: Rotation) -> tuple[Array, Array, Array, Array]:
    """Of position, velocity, body velocity and angles with respect to the states, at the nodes."""
    path, rows = smoothed.path, smoothed.nodes
    m, states = len(rows), smoothed.errors.covariance.shape[1]
    turn = path.rotation[rows].as_matrix()
    rate, lever = path.rate[rows], path.lever
    place = np.zeros((m, 3, states))
    place[:, :, P] = np.eye(3)
    place[:, :, T] = -cross_matrix(path.rotation[rows].apply(lever))
    speed = np.zeros((m, 3, states))
    speed[:, :, V] = np.eye(3)
    speed[:, :, T] = -cross_matrix(path.rotation[rows].apply(np.cross(rate, lever)))
    speed[:, :, BG] = turn @ cross_matrix(lever)[0]
    heading = angles(body[rows])[2]
    c, s, zero, one = np.cos(heading), np.sin(heading), np.zeros(m), np.ones(m)
    # roll about the heading, pitch about starboard (nose up), yaw about the vertical
    world_to_angles = np.stack(
        [np.stack([c, s, zero], -1), np.stack([s, -c, zero], -1), np.stack([zero, zero, one], -1)], 1
    )
    turned = np.zeros((m, 3, states))
    turned[:, :, T] = np.eye(3)
    if states > ALONE:
        place[:, :, LEVER] = turn
        speed[:, :, LEVER] = turn @ cross_matrix(rate)
        turned[:, :, MOUNT] = turn
    to_body = np.swapaxes(body[rows].as_matrix(), 1, 2)
    body_speed = to_body @ (speed + cross_matrix(velocity[rows]) @ turned)
    return place, speed, body_speed, world_to_angles @ turned
