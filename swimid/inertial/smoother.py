"""From a record to the likeliest motion, with its uncertainty: dead reckoning, then error states.

The path is reckoned from accelerations and a first attitude; its errors against the samples, and everything
known of it (rests, attitudes, what the user declares, another log), are smoothed; then the same about the
path so found, until it stays (the iterated smoother of Bell 1994, doi:10.1137/0804035: steps of Gauss and
Newton on the whole path). Begun at the integral of the turn rates instead, a minute of fast turning would
leave an attitude that is off by radians, and no small turn corrects that.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Self

import numpy as np
from scipy.spatial.transform import Rotation

from swimid.inertial import errorstate, strapdown
from swimid.inertial.errorstate import ALONE, MOVING, PARTS, Errors, Observation, cross_matrix, jacobian
from swimid.inertial.record import GRAVITY_M_S2, Array, Record, resampled
from swimid.inertial.rest import Noise
from swimid.inertial.sensor import DRIFT_TIME_S, Sensor

#: Longest step between nodes, s, and most nodes.
NODE_S, MOST_NODES = 0.02, 20_000
#: A step over this many sample times has lost samples; how long lost motion is alike, s; and the time over
#: which an error of scale keeps its sign, s.
GAP_STEPS, HIDDEN_S, RHYTHM_S = 1.5, 0.1, 0.5
#: Turns of linearising and smoothing; biases and attitude settle in two.
PASSES = 3
#: The parts that change from sample to sample.
CHANGING = ("position", "velocity", "rotation", "acceleration_bias", "rate_bias")


@dataclass(frozen=True, kw_only=True)
class State:
    """What the errors are errors of, at one instant; of a path, at every sample."""

    #: Sensor to world.
    rotation: Rotation
    #: Shape (3,) or (n, 3). Of the sensor, world axes.
    position: Array = field(default_factory=partial(np.zeros, 3))
    velocity: Array = field(default_factory=partial(np.zeros, 3))
    #: Shape (3,) or (n, 3).
    acceleration_bias: Array = field(default_factory=partial(np.zeros, 3))
    rate_bias: Array = field(default_factory=partial(np.zeros, 3))
    #: Shape (3, 3). Errors of scale and alignment: this times the reading was taken off.
    acceleration_scale: Array = field(default_factory=partial(np.zeros, (3, 3)))
    rate_scale: Array = field(default_factory=partial(np.zeros, (3, 3)))
    #: Shape (3,). From the sensor to the reference point, sensor axes, m.
    lever: Array = field(default_factory=partial(np.zeros, 3))
    #: Body to sensor.
    mount: Rotation = field(default_factory=Rotation.identity)
    #: Shape (2,). Gravity's horizontal components in the world, over g.
    tilt: Array = field(default_factory=partial(np.zeros, 2))
    #: To add to the times of the other log.
    clock_s: float = 0.0

    def corrected(self, error: Array) -> Self:
        """The same with its error taken out, shape (states,), or (n, states) of a path."""
        parts = {}
        for name, part in PARTS.items():
            off, value = error[..., part], getattr(self, name)
            if not off.size:
                break  # no other log: it is no state
            off = off if name in CHANGING else np.atleast_2d(off)[-1]
            turned = isinstance(value, Rotation)
            parts[name] = (
                Rotation.from_rotvec(off) * value if turned else value + off.reshape(np.shape(value))
            )
        return replace(self, **parts)

    def less(self, other: State) -> Array:
        """The error of another state seen from this one, all states."""
        parts = []
        for name in PARTS:
            here, there = getattr(self, name), getattr(other, name)
            turned = isinstance(here, Rotation)
            parts.append((here * there.inv()).as_rotvec() if turned else np.ravel(here - there))
        return np.concatenate(parts)


@dataclass(frozen=True, kw_only=True)
class Nominal(State):
    """A reckoned path at every sample."""

    #: Shape (n,).
    time_s: Array
    #: Shape (n, 3). Specific force less its bias, sensor axes.
    force: Array
    #: Shape (n, 3). Turn rate less its bias, sensor axes.
    rate: Array
    #: Shape (m,). Rows at which its errors are followed.
    nodes: np.ndarray
    #: How many errors are.
    states: int

    @property
    def node_s(self) -> Array:
        """Times of the nodes."""
        return self.time_s[self.nodes]

    @property
    def acceleration(self) -> Array:
        """Acceleration of the sensor, world axes, gravity removed, shape (n, 3)."""
        return self.rotation.apply(self.force) + gravity(self.tilt)


@dataclass(frozen=True)
class Prior:
    """What is known before anything is observed."""

    #: Sensor to world, n of them: the attitude to begin the search at.
    guide: Rotation
    #: At the first sample.
    state: State
    #: Deviations of its parts; those of the sensor's errors are the sensor's.
    sd: Mapping[str, Any]


@dataclass(frozen=True)
class Smoothed:
    """The corrected path, and the covariance of what is left of its errors."""

    #: With the errors taken out.
    path: Nominal
    #: Of the last pass, at the nodes of the path.
    errors: Errors
    #: What a next pass would start from; the path it would be about is ``path``.
    origin: State

    def with_clock(self, clock_s: float) -> Smoothed:
        """The same path to go on from, with another offset between the clocks."""
        path, origin = replace(self.path, clock_s=clock_s), replace(self.origin, clock_s=clock_s)
        return replace(self, path=path, origin=origin)

    def score(self, kind: str) -> float | None:
        """Innovations of a kind of observation, in their deviations, rms; None where there are none."""
        seen = self.errors.scores.get(kind)
        return None if seen is None else float(np.sqrt(np.mean(np.concatenate(seen) ** 2)))

    def widened(self, factor: float) -> Smoothed:
        """The same with all deviations times ``factor``."""
        errors = replace(self.errors, covariance=self.errors.covariance * factor**2)
        return replace(self, errors=errors)


def gravity(tilt: Array) -> Array:
    """Gravity in the world, m/s^2, shape (3,)."""
    return -GRAVITY_M_S2 * np.array([tilt[0], tilt[1], 1.0])


def smooth(
    record: Record,
    prior: Prior,
    sensor: Sensor,
    noise: Noise,
    observe: Callable[[Nominal], list[Observation]],
    *,
    states: int = ALONE,
    after: Smoothed | None = None,
    passes: int = PASSES,
) -> Smoothed:
    """Reckon, smooth the errors, and again.

    Parameters
    ----------
    observe : callable
        Everything that is known of a path besides the samples; :mod:`swimid.inertial.aiding` makes it.
    states : int
        With those of another log lever, mounting, the world's tilt and its clock are estimated.
    after : Smoothed, optional
        An earlier answer to go on from.
    passes : int
        Reckonings.
    """
    if after is None:
        now, path = prior.state, _reckoned(record, prior, states)
    else:
        now, path = after.origin, _about(record, after.origin, after.path)
    driving = _driving_noise(record, sensor, noise, path)
    covariance = _start_covariance(prior, sensor, states)
    for turn in range(passes):
        if turn:
            path = _about(record, now, path)
        transition, defect = _transitions(record, path)
        mean = prior.state.less(now)[:states]
        errors = errorstate.smooth_errors(mean, covariance, transition, driving, observe(path), defect)
        # constant biases by their means over the record
        begin, mean = errors.mean[0].copy(), errors.mean.mean(axis=0)
        begin[MOVING:ALONE] = mean[MOVING:ALONE]
        now, path = now.corrected(begin), _corrected(record, path, errors)
    return Smoothed(path, errors, now)


def _node_rows(time_s: Array) -> np.ndarray:
    """Rows of a record at which its errors are followed, shape (m,)."""
    duration = float(time_s[-1] - time_s[0])
    spacing = max(NODE_S, duration / MOST_NODES)
    if np.median(np.diff(time_s)) >= spacing:
        return np.arange(len(time_s))
    wanted = np.searchsorted(time_s, np.arange(time_s[0], time_s[-1], spacing))
    return np.unique(np.concatenate([wanted, [len(time_s) - 1]]))


def _reckoned(record: Record, prior: Prior, states: int) -> Nominal:
    """The path that follows from accelerations, an attitude and where it starts."""
    t, start = record.time_s, prior.state
    known = {**vars(start), "rotation": prior.guide, "nodes": _node_rows(t), "states": states}
    path = _about(record, start, Nominal(**known, time_s=t, force=record.acceleration, rate=record.rate))
    velocity = strapdown.integral(t, path.acceleration, start.velocity)
    return replace(path, velocity=velocity, position=strapdown.integral(t, velocity, start.position))


def _about(record: Record, origin: State, path: Nominal) -> Nominal:
    """The same path with the readings corrected by an origin's biases and scales."""
    force = record.acceleration - origin.acceleration_bias - record.acceleration @ origin.acceleration_scale.T
    rate = record.rate - origin.rate_bias - record.rate @ origin.rate_scale.T
    constant = {name: getattr(origin, name) for name in PARTS if name not in CHANGING}
    constant["acceleration_bias"] = np.broadcast_to(origin.acceleration_bias, force.shape)
    constant["rate_bias"] = np.broadcast_to(origin.rate_bias, rate.shape)
    return replace(path, **constant, force=force, rate=rate)


def _corrected(record: Record, path: Nominal, errors: Errors) -> Nominal:
    """The path, and the readings it was reckoned from, without their errors."""
    x = resampled(path.time_s, path.node_s, errors.mean)
    bias_a, bias_w = x[:, PARTS["acceleration_bias"]], x[:, PARTS["rate_bias"]]
    scale_a, scale_w = (x[-1, PARTS[name]].reshape(3, 3) for name in ("acceleration_scale", "rate_scale"))
    force = path.force - bias_a - record.acceleration @ scale_a.T
    rate = path.rate - bias_w - record.rate @ scale_w.T
    return replace(path.corrected(x), force=force, rate=rate)


def _start_covariance(prior: Prior, sensor: Sensor, states: int) -> Array:
    sds = {
        **prior.sd,
        "acceleration_bias": sensor.acceleration_bias_sd,
        "rate_bias": sensor.rate_bias_sd,
        "acceleration_scale": sensor.scale_sd,
        "rate_scale": sensor.scale_sd,
    }
    parts = [np.broadcast_to(sds.get(name, 0.0), part.stop - part.start) for name, part in PARTS.items()]
    return np.diag(np.concatenate(parts)[:states] ** 2)


def _transitions(record: Record, path: Nominal) -> tuple[Array, Array]:
    """Transition matrices over the steps between nodes, and their defects, shape (steps, 9).

    Matrices are exp(F dt) to third order in dt, with means over the step (Groves 2013, Principles of GNSS,
    Inertial, and Multisensor Integrated Navigation Systems, 2nd ed., sec. 14.2, on a world that does not
    turn). A defect is the position, velocity and turn that the samples make of a step, less those of the
    path: 0 for a path that was reckoned from the samples.
    """
    t, rows, states, turn = path.time_s, path.nodes, path.states, path.rotation.as_matrix()
    dt = np.diff(t[rows])[:, None]

    def mean(values: Array) -> Array:
        steps = np.diff(strapdown.integral(t, values.reshape(len(t), -1))[rows], axis=0) / dt
        return steps.reshape(-1, *values.shape[1:])

    def turn_by(readings: Array) -> Array:
        """Every column of the rotation matrix times every component, which runs fastest."""
        parts = [mean(turn * readings[:, None, j, None]) for j in range(3)]
        return np.stack(parts, axis=-1).reshape(-1, 3, 9)

    by_force, by_bias = -cross_matrix(mean(path.rotation.apply(path.force))), -mean(turn)
    by_scale_a, by_scale_w = -turn_by(record.acceleration), -turn_by(record.rate)
    by_tilt = -GRAVITY_M_S2 * np.eye(3)[:, :2]
    place = jacobian(states, len(dt), 3, velocity=np.eye(3))
    speed = jacobian(
        states, len(dt), 3, rotation=by_force, acceleration_bias=by_bias, acceleration_scale=by_scale_a,
        tilt=by_tilt,
    )  # fmt: skip
    angle = jacobian(states, len(dt), 3, rate_bias=by_bias, rate_scale=by_scale_w)
    f = np.concatenate([place, speed, angle], axis=1) * dt[:, :, None]
    square = f[:, :, :MOVING] @ f
    transition = np.tile(np.eye(states), (len(dt), 1, 1))
    transition[:, :MOVING] += f + square / 2 + f[:, :, :MOVING] @ square / 6
    velocity = strapdown.integral(t, path.acceleration)
    position = strapdown.integral(t, velocity)
    first, last = rows[:-1], rows[1:]
    sensed = strapdown.attitude(t, path.rate, path.rotation[0])
    step = sensed[first].inv() * sensed[last]
    defect = np.hstack(
        [
            path.velocity[first] * dt + np.diff(position[rows], axis=0)
            - velocity[first] * dt - np.diff(path.position[rows], axis=0),
            np.diff(velocity[rows], axis=0) - np.diff(path.velocity[rows], axis=0),
            (path.rotation[first] * step * path.rotation[last].inv()).as_rotvec(),
        ]
    )  # fmt: skip
    return transition, defect


def _driving_noise(record: Record, sensor: Sensor, noise: Noise, path: Nominal) -> Array:
    """Covariance each step between nodes adds, shape (steps, states, states).

    Noise of the sensor, errors of its scale, and what bridged samples hide.
    """
    dt = np.diff(record.time_s)
    # a step of several sample times, or bridged samples, hide what the sensor did there
    hidden = np.maximum(dt - GAP_STEPS * record.step_s, 0.0)

    def white(density: float, readings: Array, moving: Array, filled: np.ndarray) -> Array:
        lost = filled[1:] | filled[:-1]
        variance = density**2 * dt
        variance += float(np.sum(np.std(readings, axis=0) ** 2)) * (hidden**2 + lost * dt * HIDDEN_S)
        # what scales leave (bending) acts with the motion's own rhythm: white beyond half a stroke
        variance += sensor.bending_sd**2 * np.sum(moving[1:] ** 2, axis=1) * dt * RHYTHM_S
        return np.diff(np.concatenate([[0.0], np.cumsum(variance)])[path.nodes])

    moving = record.acceleration - np.median(record.acceleration, axis=0)
    velocity = white(noise.acceleration, record.acceleration, moving, record.filled_acceleration)
    angle = white(noise.rate, record.rate, record.rate, record.filled_rate)
    dt_nodes = np.diff(path.node_s)
    q = np.zeros((len(dt_nodes), path.states, path.states))
    for i in range(3):
        q[:, 3 + i, 3 + i] = velocity
        q[:, i, i] = velocity * dt_nodes**2 / 3
        q[:, i, 3 + i] = q[:, 3 + i, i] = velocity * dt_nodes / 2
        q[:, 6 + i, 6 + i] = angle
        q[:, 9 + i, 9 + i] = sensor.acceleration_drift**2 / DRIFT_TIME_S * dt_nodes
        q[:, 12 + i, 12 + i] = sensor.rate_drift**2 / DRIFT_TIME_S * dt_nodes
    return q
