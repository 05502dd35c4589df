"""From a record to the likeliest motion, with its uncertainty: dead reckoning, then error states.

The path is reckoned from accelerations and a first attitude; its errors against the samples, and everything
known of it (rests, attitudes, what the user declares, another log), are smoothed; then the same about the
path so found, until it stays (the iterated smoother of Bell 1994, doi:10.1137/0804035: steps of Gauss and
Newton on the whole path). Begun at the integral of the turn rates instead, a minute of fast turning would
leave an attitude that is off by radians, and no small turn corrects that.

The errors are the true minus the reckoned: position, velocity and attitude (a small turn about world axes),
the biases of accelerometer and gyroscope (sensor axes), their errors of scale and alignment, and for fusion
the lever from the sensor to the reference point, the mounting turn, the tilt of the world against gravity,
and the offset between the clocks. They are smoothed after Rauch, Tung and Striebel (1965,
doi:10.2514/3.3166).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Self

import numpy as np
from scipy.spatial.transform import Rotation
from threadpoolctl import threadpool_limits

from swimid.inertial.record import GRAVITY_M_S2, Array, Record, integral, integrated_attitude, resampled
from swimid.inertial.setup import DRIFT_TIME_S, Noise, Sensor

#: Where the error of each part of the state lies; scales are matrices by rows.
PARTS = {
    "position": slice(0, 3),
    "velocity": slice(3, 6),
    "rotation": slice(6, 9),
    "acceleration_bias": slice(9, 12),
    "rate_bias": slice(12, 15),
    "acceleration_scale": slice(15, 24),
    "rate_scale": slice(24, 33),
    "lever": slice(33, 36),
    "mount": slice(36, 39),
    "tilt": slice(39, 41),
    "clock_s": slice(41, 42),
}
#: States without and with another log.
ALONE, FUSED = 33, 42
#: States that move from node to node by themselves; the others stay or wander.
MOVING = 9


def jacobian(states: int, *shape: int, **by: Array) -> Array:
    """Derivatives with respect to the states, shape (*shape, states), from those with respect to its parts.

    Parts that are no states, without another log, are left out.
    """
    out = np.zeros((*shape, states))
    for name, values in by.items():
        if PARTS[name].stop <= states:
            out[..., PARTS[name]] = values
    return out


@dataclass(frozen=True)
class Observation:
    """A measurement of the error at one node."""

    node: int
    #: What it is, for the account kept of each kind.
    kind: str
    #: Shape (m,). Measured minus reckoned.
    residual: Array
    #: Shape (m, states).
    sensitivity: Array
    #: Shape (m,). Standard deviations, independent of each other.
    sd: Array
    #: A residual beyond this many deviations is an outlier and not used; infinite for none.
    gate: float = np.inf
    #: Whether it counts in the likelihood; one that another clock leaves outside the record does not.
    counted: bool = True
    #: Which pose of another log it is of; -1 for none.
    fix: int = -1


@dataclass(frozen=True)
class Errors:
    """Smoothed errors."""

    #: Shape (nodes, states).
    mean: Array
    #: Shape (nodes, states, states).
    covariance: Array
    #: Shape (nodes - 1, states, states). Smoother gains: they tie the errors of successive nodes.
    gain: Array
    #: Log likelihood of the observations that were used and count.
    likelihood: float
    #: Normalised innovations of every observation, by its kind.
    scores: dict[str, list[Array]]
    #: Observations beyond their gate.
    rejected: int

    @threadpool_limits.wrap(limits=1)
    def draw(self, sensitivity: Array, count: int) -> Array:
        """Draw trajectories of the errors about their mean, as functions of them.

        Parameters
        ----------
        sensitivity : ndarray, shape (nodes, m, states)
            Derivatives of the functions with respect to the states.
        count : int
            Number of trajectories.

        Returns
        -------
        ndarray, shape (nodes, m, count)
            The seed is fixed: the same errors give the same trajectories.

        Notes
        -----
        Backward sampling (Fruehwirth-Schnatter 1994, doi:10.1111/j.1467-9892.1994.tb00184.x). Given the
        errors x at node k + 1, those at node k are Gaussian: mean G x, covariance P(k) - G P(k + 1) G',
        where G is the smoother gain and P the smoothed covariance. So the trajectories have the smoothed
        covariance at every node, and the correlation between nodes that it does not show.
        """
        rng = np.random.default_rng(0)
        nodes, states = self.mean.shape
        drawn = np.empty((nodes, sensitivity.shape[1], count))
        x = np.zeros((states, count))
        for k in range(nodes - 1, -1, -1):
            left = self.covariance[k]
            if k < nodes - 1:
                gain = self.gain[k]
                left = left - gain @ self.covariance[k + 1] @ gain.T
                x = gain @ x
            size = np.sqrt(np.maximum(np.diag(self.covariance[k]), 1e-300))
            variance, axes = np.linalg.eigh(left / np.outer(size, size))
            x = x + size[:, None] * (axes * np.sqrt(np.maximum(variance, 0.0))) @ rng.normal(size=x.shape)
            drawn[k] = sensitivity[k] @ x
        return drawn


@threadpool_limits.wrap(limits=1)  # threads cost more than they bring at this size
def smooth_errors(
    start_mean: Array,
    start: Array,
    transition: Array,
    noise: Array,
    observations: list[Observation],
    defect: Array,
) -> Errors:
    """Filter forwards and smooth backwards.

    Parameters
    ----------
    start_mean, start : ndarray, shape (states,) and (states, states)
        Mean and covariance of the errors at the first node before anything is seen.
    transition, noise : ndarray, shape (nodes - 1, states, states)
    observations : list of Observation
    defect : ndarray, shape (nodes - 1, 9)
        What each step adds to the errors of position, velocity and attitude besides.
    """
    nodes, states = len(transition) + 1, len(start)
    at: dict[int, list[Observation]] = {}
    for observation in observations:
        at.setdefault(observation.node, []).append(observation)
    predicted = np.zeros((nodes, states))
    predicted_cov = np.empty((nodes, states, states))
    mean, cov = start_mean.copy(), start.copy()
    means, covs = np.empty((nodes, states)), np.empty((nodes, states, states))
    scores: dict[str, list[Array]] = {}
    rejected, likelihood = 0, 0.0
    for k in range(nodes):
        if k:
            mean = transition[k - 1] @ mean
            mean[:MOVING] += defect[k - 1]
            cov = transition[k - 1] @ cov @ transition[k - 1].T + noise[k - 1]
        predicted[k], predicted_cov[k] = mean, cov
        for seen in at.get(k, ()):
            mean, cov, score, likely = _update(mean, cov, seen)
            if score is None:
                rejected += 1
            else:
                scores.setdefault(seen.kind, []).append(score)
                likelihood += likely if seen.counted else 0.0
        means[k], covs[k] = mean, cov
    gains = np.empty((nodes - 1, states, states))
    for k in range(nodes - 2, -1, -1):
        gain = np.linalg.solve(predicted_cov[k + 1] + 1e-18 * np.eye(states), transition[k] @ covs[k]).T
        means[k] = means[k] + gain @ (means[k + 1] - predicted[k + 1])
        covs[k] = covs[k] + gain @ (covs[k + 1] - predicted_cov[k + 1]) @ gain.T
        gains[k] = gain
        covs[k] = 0.5 * (covs[k] + covs[k].T)
    return Errors(means, covs, gains, likelihood, scores, rejected)


def _update(mean: Array, cov: Array, seen: Observation) -> tuple[Array, Array, Array | None, float]:
    h = seen.sensitivity
    innovation = seen.residual - h @ mean
    shared = h @ cov
    spread = shared @ h.T + np.diag(seen.sd**2)
    score = innovation / np.sqrt(np.diag(spread))
    if np.any(np.abs(score) > seen.gate):
        return mean, cov, None, 0.0
    inverse = np.linalg.inv(spread)
    gain = shared.T @ inverse
    left = np.eye(len(mean)) - gain @ h
    cov = left @ cov @ left.T + (gain * seen.sd**2) @ gain.T  # Joseph's form stays positive
    size = len(innovation) * np.log(2 * np.pi) + np.log(np.linalg.det(spread))
    likely = -0.5 * float(size + innovation @ inverse @ innovation)
    return mean + gain @ innovation, 0.5 * (cov + cov.T), score, likely


def cross_matrix(vectors: Array) -> Array:
    """Matrices of the cross products ``v x``, shape (..., 3, 3)."""
    return np.swapaxes(np.cross(vectors[..., None, :], np.eye(3)), -1, -2)


# ---------------------------------------------------------------- the path


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

    def score(self, kind: str) -> float | None:
        """Innovations of a kind of observation, in their deviations, rms; None where there are none."""
        seen = self.errors.scores.get(kind)
        return None if seen is None else float(np.sqrt(np.mean(np.concatenate(seen) ** 2)))


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
        errors = smooth_errors(mean, covariance, transition, driving, observe(path), defect)
        # constant biases by their means over the record
        begin, mean = errors.mean[0].copy(), errors.mean.mean(axis=0)
        begin[MOVING:ALONE] = mean[MOVING:ALONE]
        now, path = now.corrected(begin), _corrected(record, path, errors)
    return Smoothed(path, errors, now)


def _node_rows(time_s: Array) -> np.ndarray:
    """Rows of a record at which its errors are followed, shape (m,)."""
    duration = float(time_s[-1] - time_s[0])
    # Longest step between nodes, s, and most nodes.
    spacing = max(0.02, duration / 20_000)
    if np.median(np.diff(time_s)) >= spacing:
        return np.arange(len(time_s))
    wanted = np.searchsorted(time_s, np.arange(time_s[0], time_s[-1], spacing))
    return np.unique(np.concatenate([wanted, [len(time_s) - 1]]))


def _reckoned(record: Record, prior: Prior, states: int) -> Nominal:
    """The path that follows from accelerations, an attitude and where it starts."""
    t, start = record.time_s, prior.state
    known = {**vars(start), "rotation": prior.guide, "nodes": _node_rows(t), "states": states}
    path = _about(record, start, Nominal(**known, time_s=t, force=record.acceleration, rate=record.rate))
    velocity = integral(t, path.acceleration, start.velocity)
    return replace(path, velocity=velocity, position=integral(t, velocity, start.position))


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
        steps = np.diff(integral(t, values.reshape(len(t), -1))[rows], axis=0) / dt
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
    velocity = integral(t, path.acceleration)
    position = integral(t, velocity)
    first, last = rows[:-1], rows[1:]
    sensed = integrated_attitude(t, path.rate, path.rotation[0])
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
