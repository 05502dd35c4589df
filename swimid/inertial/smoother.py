"""Estimation of a motion with its uncertainty by an error-state Kalman filter and smoother.

Integration of accelerations along a first estimate of the attitude gives a path. The errors of the path are
estimated from the samples and from all observations (rests, attitudes, statements of the user, another log).
The path is corrected and the estimation repeated until it converges. The method is the iterated smoother of
Bell (1994, doi:10.1137/0804035), which makes Gauss-Newton steps on the whole path. The iteration does not
start from integrated turn rates. After a minute of fast rotation, their attitude is wrong by radians, which
small corrections cannot repair.

The errors are those of position, velocity and attitude (true minus estimated, a small rotation about world
axes), the biases of accelerometer and gyroscope (sensor axes), and their errors of scale and alignment. With
another log there are also the errors of the lever from the sensor to the reference point, of the mounting, of
the tilt of the world against gravity, and of the offset between the clocks. The smoother is that of Rauch,
Tung and Striebel (1965, doi:10.2514/3.3166).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Self

import numpy as np
from scipy.spatial.transform import Rotation
from threadpoolctl import threadpool_limits

from swimid.inertial import record as recording
from swimid.inertial.record import Array, ImuRecord, ImuSetup, Sensor, SensorNoise, integral, resampled
from swimid.kinematics.attitude import angles
from swimid.logs.log import runs

#: Slice of each quantity in the vector of errors that the smoother estimates. Errors of scale are 3 x 3
#: matrices, stored by rows.
ERROR_SLICES = {
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
#: Number of elements of the vector of errors: for an inertial log only, and together with another log.
ALONE, FUSED = 33, 42
#: Number of elements of the vector of errors that follow the equations of motion (position, velocity and
#: attitude). The other errors are constant or drift.
N_MOTION_ERRORS = 9


#: Names of the quantities whose errors change from sample to sample.
CHANGING = ("position", "velocity", "rotation", "acceleration_bias", "rate_bias")
#: Default number of linearisations of the smoother. Biases and attitude converge in two.
PASSES = 3
#: Time step of a record above which samples count as lost, in median sample times.
LONG_STEP = 1.5
#: HIDDEN_S is the correlation time of the motion that interpolated samples do not show, s. RHYTHM_S is the
#: correlation time of errors due to nonlinearity (half a stroke), s.
HIDDEN_S, RHYTHM_S = 0.1, 0.5
#: Time between nodes, s, and maximum number of nodes. Nodes are the samples at which errors are estimated.
#: For long records the time between them is longer.
NODE_S, MAX_NODES = 0.02, 20_000
#: Value added to the diagonal of a predicted correlation matrix, so that the matrix can be inverted.
NODE_RIDGE = 1e-12


def jacobian(states: int, *shape: int, **by: Array) -> Array:
    """Return a matrix of derivatives with respect to the vector of errors, shape (*shape, states).

    Parameters
    ----------
    states : int
        Number of elements of the vector of errors. Quantities beyond this number, which need another log, are
        omitted.
    **by : ndarray
        Derivatives with respect to a quantity, by its name in :data:`ERROR_SLICES`. Other derivatives are 0.
    """
    out = np.zeros((*shape, states))
    for name, values in by.items():
        if ERROR_SLICES[name].stop <= states:
            out[..., ERROR_SLICES[name]] = values
    return out


@dataclass(frozen=True)
class Observation:
    """Observation: measurement of m values that depend on the errors of a path at one node."""

    node: int
    #: Name of the quantity that is observed, such as "rest". Innovations are reported separately for each
    #: name.
    kind: str
    #: Measured minus predicted values of the observation, shape (m,).
    residual: Array
    #: Derivatives of the observed values with respect to the errors, shape (m, states).
    sensitivity: Array
    #: Standard deviations of the independent noise of the observed values, shape (m,).
    sd: Array
    #: Maximum innovation, in standard deviations. An observation with a larger innovation is an outlier and
    #: is not used.
    gate: float = np.inf
    #: Whether the observation contributes to the log-likelihood. An observation that is outside of the record
    #: for another candidate clock offset does not contribute.
    counted: bool = True


@dataclass(frozen=True)
class Errors:
    """Errors of a path at its nodes, which the smoother has estimated."""

    #: Estimated means of the errors at the nodes, shape (nodes, states).
    mean: Array
    #: Covariances of the errors at the nodes, shape (nodes, states, states).
    covariance: Array
    #: Smoother gains, shape (nodes - 1, states, states). They relate the errors at successive nodes.
    gain: Array
    #: Log-likelihood of the observations for which ``counted`` is true.
    likelihood: float
    #: Normalised innovations for each kind of observation.
    scores: dict[str, list[Array]]
    #: Number of observations that were left out as outliers.
    rejected: int

    @threadpool_limits.wrap(limits=1)
    def draw(self, sensitivity: Array, count: int) -> Array:
        """Draw random trajectories of linear functions of the errors. The trajectories have mean 0.

        Parameters
        ----------
        sensitivity : ndarray, shape (nodes, m, states)
            Derivatives of the m functions with respect to the errors.
        count : int
            Number of trajectories.

        Returns
        -------
        ndarray, shape (nodes, m, count)
            Values of the functions minus their means. The seed is fixed, so that equal errors give equal
            trajectories.

        Notes
        -----
        The method is backward sampling (Fruehwirth-Schnatter 1994, doi:10.1111/j.1467-9892.1994.tb00184.x).
        Given the errors x at node k + 1, the errors at node k are Gaussian with mean G x and covariance P(k)
        - G P(k + 1) G', where G is the smoother gain and P the smoothed covariance. The trajectories have the
        smoothed covariance at every node and the correct correlation between nodes.
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


@threadpool_limits.wrap(limits=1)  # threads slow down small matrices
def smooth_errors(
    start_mean: Array,
    start: Array,
    transition: Array,
    noise: Array,
    observations: list[Observation],
    defect: Array,
) -> Errors:
    """Estimate the errors at the nodes by a Kalman filter forwards and a smoother backwards.

    Parameters
    ----------
    start_mean, start : ndarray, shape (states,) and (states, states)
        Mean and covariance of the errors at the first node before any observation.
    transition, noise : ndarray, shape (nodes - 1, states, states)
        Transition matrices and noise covariances of the steps between nodes.
    observations : list of Observation
    defect : ndarray, shape (nodes - 1, 9)
        Change of the errors of position, velocity and attitude in each step that is added to the transition;
        see ``_transitions``.
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
            mean[:N_MOTION_ERRORS] += defect[k - 1]
            cov = transition[k - 1] @ cov @ transition[k - 1].T + noise[k - 1]
        predicted[k], predicted_cov[k] = mean, cov
        for seen in at.get(k, ()):
            mean, cov, score, likely = _update(mean, cov, seen)
            if score is None:
                rejected += 1
                continue
            scores.setdefault(seen.kind, []).append(score)
            likelihood += likely * seen.counted
        means[k], covs[k] = mean, cov
    gains = np.empty((nodes - 1, states, states))
    for k in range(nodes - 2, -1, -1):
        # Divide the errors by their standard deviations, because these differ by many powers of ten.
        size = np.sqrt(np.maximum(np.diag(predicted_cov[k + 1]), 1e-300))[:, None]
        scaled = predicted_cov[k + 1] / size / size.T + NODE_RIDGE * np.eye(states)
        gain = (np.linalg.solve(scaled, transition[k] @ covs[k] / size) / size).T
        means[k] = means[k] + gain @ (means[k + 1] - predicted[k + 1])
        # Use Joseph's form, because the difference of nearly equal covariances would consist of rounding
        # errors.
        left = np.eye(states) - gain @ transition[k]
        covs[k] = left @ covs[k] @ left.T + gain @ (covs[k + 1] + noise[k]) @ gain.T
        gains[k] = gain
        covs[k] = 0.5 * (covs[k] + covs[k].T)
    return Errors(means, covs, gains, likelihood, scores, rejected)


def _update(mean: Array, cov: Array, seen: Observation) -> tuple[Array, Array, Array | None, float]:
    """Return mean and covariance of the errors after an observation, with its innovation and log-likelihood.

    An innovation above ``gate`` is an outlier. It leaves mean and covariance unchanged, and None is returned
    for the innovation.
    """
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
    cov = left @ cov @ left.T + (gain * seen.sd**2) @ gain.T  # Joseph's form stays positive definite
    size = len(innovation) * np.log(2 * np.pi) + np.log(np.linalg.det(spread))
    likely = -0.5 * float(size + innovation @ inverse @ innovation)
    return mean + gain @ innovation, 0.5 * (cov + cov.T), score, likely


def skew_matrices(vectors: Array) -> Array:
    """Return the matrices M with ``M u = v x u`` for vectors v, shape (..., 3, 3)."""
    return np.swapaxes(np.cross(vectors[..., None, :], np.eye(3)), -1, -2)


# ---------------------------------------------------------------- the path


@dataclass(frozen=True, kw_only=True)
class MotionState:
    """State of the motion and of the sensor: the quantities whose errors are in :data:`ERROR_SLICES`.

    A state holds these quantities at one time or, for a path, at n samples.
    """

    #: Rotation from sensor to world axes.
    rotation: Rotation
    #: Position, m, and velocity, m/s, of the sensor along world axes, shape (3,) or (n, 3).
    position: Array = field(default_factory=partial(np.zeros, 3))
    velocity: Array = field(default_factory=partial(np.zeros, 3))
    #: Biases of accelerometer, m/s^2, and gyroscope, rad/s, along sensor axes, shape (3,) or (n, 3).
    acceleration_bias: Array = field(default_factory=partial(np.zeros, 3))
    rate_bias: Array = field(default_factory=partial(np.zeros, 3))
    #: Errors of scale and alignment of accelerometer and gyroscope, shape (3, 3). The product of this matrix
    #: and a reading is subtracted from the reading.
    acceleration_scale: Array = field(default_factory=partial(np.zeros, (3, 3)))
    rate_scale: Array = field(default_factory=partial(np.zeros, (3, 3)))
    #: Vector from the sensor to the reference point of the body (lever), in sensor axes, m, shape (3,).
    lever: Array = field(default_factory=partial(np.zeros, 3))
    #: Mounting: rotation from body to sensor axes.
    mount: Rotation = field(default_factory=Rotation.identity)
    #: Tilt of the world axes: horizontal components of gravity, divided by g, shape (2,).
    tilt: Array = field(default_factory=partial(np.zeros, 2))
    #: Clock offset: time that is added to the time stamps of the other log, s.
    clock_s: float = 0.0

    def correct(self, error: Array) -> Self:
        """Return the state corrected by an error, shape (states,), or (n, states) for a path."""
        parts: dict[str, Any] = {}
        for name, part in ERROR_SLICES.items():
            off, value = error[..., part], getattr(self, name)
            if not off.size:
                break  # without another log the vector of errors is shorter
            if name not in CHANGING:
                off = np.atleast_2d(off)[-1]
            if isinstance(value, Rotation):
                parts[name] = Rotation.from_rotvec(off) * value
            else:
                parts[name] = value + off.reshape(np.shape(value))
        return replace(self, **parts)

    def minus(self, other: MotionState) -> Array:
        """Return the difference between this state and another one as a vector of errors, shape (FUSED,)."""
        parts = []
        for name in ERROR_SLICES:
            here, there = getattr(self, name), getattr(other, name)
            if isinstance(here, Rotation):
                parts.append((here * there.inv()).as_rotvec())
            else:
                parts.append(np.ravel(here - there))
        return np.concatenate(parts)


@dataclass(frozen=True, kw_only=True)
class Nominal(MotionState):
    """Path at n samples, about which the smoother linearises and estimates the errors."""

    time_s: Array
    #: Specific force after correction of bias and scale, sensor axes, m/s^2, shape (n, 3).
    force: Array
    #: Turn rate after correction of bias and scale, sensor axes, rad/s, shape (n, 3).
    rate: Array
    #: Rows of the samples at which the errors are estimated (nodes), shape (nodes,).
    nodes: np.ndarray
    #: Number of elements of the vector of errors: :data:`ALONE` or :data:`FUSED`.
    states: int

    @property
    def node_s(self) -> Array:
        """Times of the nodes, s."""
        return self.time_s[self.nodes]

    @property
    def acceleration(self) -> Array:
        """Acceleration of the sensor without gravity, world axes, m/s^2, shape (n, 3)."""
        return self.rotation.apply(self.force) + gravity(self.tilt)


@dataclass(frozen=True)
class SmoothedMotion:
    """Result of the smoother: path after correction of its errors, and covariance of the remaining errors."""

    path: Nominal
    #: Path before the last correction, about which the errors were linearised. Their covariance is valid only
    #: with derivatives at this path. With another path, whose lever differs, errors of the attitude would
    #: count as errors of the position.
    about: Nominal
    #: Errors of the path that were estimated in the last iteration of the smoother.
    errors: Errors
    #: State at the first sample, from which a further iteration of the smoother would start.
    origin: MotionState
    #: Error class of the sensor that was assumed.
    sensor: Sensor

    def score(self, kind: str) -> float | None:
        """Return the root-mean-square normalised innovation of one kind of observation; None without any."""
        if kind not in self.errors.scores:
            return None
        return float(np.sqrt(np.mean(np.concatenate(self.errors.scores[kind]) ** 2)))


def gravity(tilt: Array) -> Array:
    """Return the gravity vector in world axes with the given tilt, m/s^2, shape (3,)."""
    return -recording.GRAVITY_M_S2 * np.array([tilt[0], tilt[1], 1.0])


def smooth_motion(
    setup: ImuSetup,
    start: MotionState,
    sd: Mapping[str, Any],
    sensor: Sensor,
    observe: Callable[[Nominal], list[Observation]],
    *,
    states: int = ALONE,
    after: SmoothedMotion | None = None,
    passes: int = PASSES,
) -> SmoothedMotion:
    """Estimate the most likely motion of the sensor, with the covariance of its errors.

    Parameters
    ----------
    setup : Setup
        The iteration starts at the attitude of its source.
    start : State
        State at the first sample before any observation.
    sd : mapping
        Standard deviations of the quantities of this state, except for the biases and scales of the sensor.
    sensor : Sensor
    observe : callable
        Returns the observations of a path; see :mod:`swimid.inertial.estimate`.
    states : int
        Number of elements of the vector of errors: :data:`ALONE`, or :data:`FUSED` to estimate also lever,
        mounting, tilt of the world and clock offset.
    after : Smoothed, optional
        Result from which the iteration continues.
    passes : int
        Number of linearisations.
    """
    record = setup.record
    if after is None:
        now, path = start, _integrate(setup, start, states)
    else:
        now, path = after.origin, _about(record, after.origin, after.path)
    driving = _compute_process_noise(record, sensor, setup.noise, path)
    covariance = _start_covariance(sd, sensor, states)
    for turn in range(passes):
        if turn:
            path = _about(record, now, path)
        transition, defect = _transitions(record, path)
        mean = start.minus(now)[:states]
        errors = smooth_errors(mean, covariance, transition, driving, observe(path), defect)
        # For the next linearisation, assume constant biases that are equal to the means over the record.
        begin, mean = errors.mean[0].copy(), errors.mean.mean(axis=0)
        begin[N_MOTION_ERRORS:ALONE] = mean[N_MOTION_ERRORS:ALONE]
        now, about = now.correct(begin), path
        path = path.correct(resampled(path.time_s, path.node_s, errors.mean))
        path = _with_readings(record, path)
    return SmoothedMotion(path, about, errors, now, sensor)


def _integrate(setup: ImuSetup, start: MotionState, states: int) -> Nominal:
    """Return the path by integration of the accelerations along the attitude before smoothing."""
    record, t = setup.record, setup.record.time_s
    nodes = np.arange(len(record))
    spacing = max(NODE_S, float(t[-1] - t[0]) / MAX_NODES)
    if record.step_s < spacing:
        nodes = np.unique(np.append(np.searchsorted(t, np.arange(t[0], t[-1], spacing)), len(t) - 1))
    known = {**vars(start), "rotation": setup.source.rotation, "nodes": nodes, "states": states}
    path = _about(record, start, Nominal(**known, time_s=t, force=record.acceleration, rate=record.rate))
    velocity = integral(t, path.acceleration, start.velocity)
    return replace(path, velocity=velocity, position=integral(t, velocity, start.position))


def _about(record: ImuRecord, origin: MotionState, path: Nominal) -> Nominal:
    """Return a copy of the path with biases, scales and other constants from the state ``origin``."""
    constant = {name: getattr(origin, name) for name in ERROR_SLICES if name not in CHANGING}
    for name in ("acceleration_bias", "rate_bias"):
        constant[name] = np.broadcast_to(getattr(origin, name), path.rate.shape)
    return _with_readings(record, replace(path, **constant))


def _with_readings(record: ImuRecord, path: Nominal) -> Nominal:
    """Return a copy of the path with readings corrected by the biases and scales of the path."""
    force = record.acceleration - path.acceleration_bias - record.acceleration @ path.acceleration_scale.T
    rate = record.rate - path.rate_bias - record.rate @ path.rate_scale.T
    return replace(path, force=force, rate=rate)


def _start_covariance(sd: Mapping[str, Any], sensor: Sensor, states: int) -> Array:
    """Return the initial covariance of the errors, before any observation, shape (states, states)."""
    sds = {
        **sd,
        "acceleration_bias": sensor.acceleration_bias_sd,
        "rate_bias": sensor.rate_bias_sd,
        "acceleration_scale": sensor.scale_sd,
        "rate_scale": sensor.scale_sd,
    }
    parts = [
        np.broadcast_to(sds.get(name, 0.0), part.stop - part.start) for name, part in ERROR_SLICES.items()
    ]
    return np.diag(np.concatenate(parts)[:states] ** 2)


def _transitions(record: ImuRecord, path: Nominal) -> tuple[Array, Array]:
    """Return transition matrices of the errors between successive nodes, and the defects of the path.

    The matrices are exp(F dt) to third order in dt, with means over the step (Groves 2013, Principles of
    GNSS, Inertial, and Multisensor Integrated Navigation Systems, 2nd ed., sec. 14.2, without the rotation of
    the earth). The defects have the shape (steps, 9). A defect is the change of position, velocity and
    attitude in a step according to the samples, minus the change of the path in this step. It is 0 for a path
    that was integrated from the samples.
    """
    t, rows, states, turn = path.time_s, path.nodes, path.states, path.rotation.as_matrix()
    dt = np.diff(t[rows])[:, None]

    def mean(values: Array) -> Array:
        steps = np.diff(integral(t, values.reshape(len(t), -1))[rows], axis=0) / dt
        return steps.reshape(-1, *values.shape[1:])

    def turn_by(readings: Array) -> Array:
        """Return derivatives of rotated readings with respect to the scale matrix, averaged over each step.

        The derivatives are products of the columns of the rotation matrix and the components of the readings.
        The index of the component varies fastest.
        """
        parts = [mean(turn * readings[:, None, j, None]) for j in range(3)]
        return np.stack(parts, axis=-1).reshape(-1, 3, 9)

    by_force, by_bias = -skew_matrices(mean(path.rotation.apply(path.force))), -mean(turn)
    by_scale_a, by_scale_w = -turn_by(record.acceleration), -turn_by(record.rate)
    by_tilt = -recording.GRAVITY_M_S2 * np.eye(3)[:, :2]
    place = jacobian(states, len(dt), 3, velocity=np.eye(3))
    speed = jacobian(
        states, len(dt), 3, rotation=by_force, acceleration_bias=by_bias, acceleration_scale=by_scale_a,
        tilt=by_tilt,
    )  # fmt: skip
    angle = jacobian(states, len(dt), 3, rate_bias=by_bias, rate_scale=by_scale_w)
    f = np.concatenate([place, speed, angle], axis=1) * dt[:, :, None]
    square = f[:, :, :N_MOTION_ERRORS] @ f
    transition = np.tile(np.eye(states), (len(dt), 1, 1))
    transition[:, :N_MOTION_ERRORS] += f + square / 2 + f[:, :, :N_MOTION_ERRORS] @ square / 6
    velocity = integral(t, path.acceleration)
    position = integral(t, velocity)
    first, last = rows[:-1], rows[1:]
    sensed = recording.integrate_attitude(t, path.rate, path.rotation[0])
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


def _compute_process_noise(record: ImuRecord, sensor: Sensor, noise: SensorNoise, path: Nominal) -> Array:
    """Return the noise covariance of the errors in each step, shape (steps, states, states).

    A step leads from one node to the next. The covariance contains the noise of the sensor, its nonlinearity,
    the drift of its biases, and the motion in missing samples.
    """
    dt = np.diff(record.time_s)
    hidden = np.maximum(dt - LONG_STEP * record.step_s, 0.0)

    def white(density: float, readings: Array, moving: Array, sensed: int) -> Array:
        lost = record.filled[1:, sensed] | record.filled[:-1, sensed]
        variance, correlated = density**2 * dt, np.zeros(len(dt))
        for first, last in runs(lost):
            correlated[first:last] = min(float(dt[first:last].sum()), HIDDEN_S)
        variance += float(np.sum(np.std(readings, axis=0) ** 2)) * (hidden**2 + dt * correlated)
        # Add the errors due to nonlinearity. They are correlated over half a stroke, and act as white noise
        # over longer times.
        variance += sensor.bending_sd**2 * np.sum(moving[1:] ** 2, axis=1) * dt * RHYTHM_S
        return np.diff(np.concatenate([[0.0], np.cumsum(variance)])[path.nodes])

    moving = record.acceleration - np.median(record.acceleration, axis=0)
    velocity = white(noise.acceleration_m_s2_per_rt_hz, record.acceleration, moving, 0)
    angle = white(noise.rate_rad_s_per_rt_hz, record.rate, record.rate, 1)
    dt_nodes = np.diff(path.node_s)
    q = np.zeros((len(dt_nodes), path.states, path.states))
    for i in range(3):
        q[:, 3 + i, 3 + i] = velocity
        q[:, i, i] = velocity * dt_nodes**2 / 3
        q[:, i, 3 + i] = q[:, 3 + i, i] = velocity * dt_nodes / 2
        q[:, 6 + i, 6 + i] = angle
        q[:, 9 + i, 9 + i] = sensor.acceleration_drift**2 / recording.DRIFT_TIME_S * dt_nodes
        q[:, 12 + i, 12 + i] = sensor.rate_drift**2 / recording.DRIFT_TIME_S * dt_nodes
    return q


# ---------------------------------------------------------------- the motion of the reference point


#: Number of random error trajectories from which a standard deviation is computed. The relative error of the
#: standard deviation is 1 / sqrt(2 N_DRAWS) = 6 %.
N_DRAWS = 128
#: Minimum number of samples for the high-pass filter, and maximum cut-off frequency of the filter as a
#: fraction of the sample rate.
MIN_FILTERED, MAX_CUTOFF = 32, 0.45
#: Names of the quantities that are set to NaN where the estimated motion is impossible.
EMPTIED = ("position", "velocity", "body_velocity", "position_sd", "velocity_sd", "body_velocity_sd")
#: Motion of the reference point at n samples, as arrays of shape (n, 3) by name: ``position`` (m) and
#: ``velocity`` (m/s) along world axes, ``body_velocity`` (m/s), ``angle`` (roll, pitch and yaw, rad),
#: ``rate`` about body axes (rad/s), and ``acceleration`` of the sensor without gravity along world axes
#: (m/s^2). ``quaternion`` (x, y, z, w) converts from body to world. Standard deviations end in ``_sd``.
Motion = dict[str, Array]


def _transfer_velocity(smoothed: SmoothedMotion) -> tuple[Array, Array, Array, Array]:
    """Return velocity of the reference point, and derivatives of its motion with respect to the errors.

    The velocity is along world axes and has shape (n, 3). The derivatives are those of position, velocity and
    body rotation with respect to the errors at the nodes. Each has the shape (nodes, 3, states).
    """
    path, about = smoothed.path, smoothed.about
    rows, lever = path.nodes, about.lever
    rate, rotation = about.rate[rows], about.rotation[rows]
    matrix = rotation.as_matrix()
    shape = (path.states, len(rows), 3)
    arm, swing = rotation.apply(lever), rotation.apply(np.cross(rate, lever))
    by_place = jacobian(*shape, position=np.eye(3), rotation=-skew_matrices(arm), lever=matrix)
    by_speed = jacobian(
        *shape,
        velocity=np.eye(3),
        rotation=-skew_matrices(swing),
        rate_bias=matrix @ skew_matrices(lever),
        lever=matrix @ skew_matrices(rate),
    )
    by_turn = jacobian(*shape, rotation=np.eye(3), mount=matrix)
    velocity = path.velocity + path.rotation.apply(np.cross(path.rate, path.lever))
    return velocity, by_place, by_speed, by_turn


def at_reference(smoothed: SmoothedMotion) -> Motion:
    """Return the smoothed motion of the reference point of the body, with standard deviations."""
    path, covariance = smoothed.path, smoothed.errors.covariance
    body, rows = path.rotation * path.mount, path.nodes
    velocity, by_place, by_speed, by_turn = _transfer_velocity(smoothed)
    by_body_speed = _in_body(body[rows], velocity[rows], by_speed, by_turn)

    def sd(jacobian: Array) -> Array:
        variance = np.einsum("nij,njk,nik->ni", jacobian, covariance, jacobian)
        return resampled(path.time_s, path.node_s, np.sqrt(np.maximum(variance, 0.0)))

    return attitude_only(body, path.mount.inv().apply(path.rate), path.acceleration) | {
        "position": path.position + path.rotation.apply(path.lever),
        "velocity": velocity,
        "body_velocity": body.inv().apply(velocity),
        "position_sd": sd(by_place),
        "velocity_sd": sd(by_speed),
        "body_velocity_sd": sd(by_body_speed),
        "angle_sd": sd(recording.turn_to_angles(body[rows]) @ by_turn),
    }


def attitude_only(rotation: Rotation, rate: Array, acceleration: Array, sd: float = np.nan) -> Motion:
    """Return a motion that holds the attitude, but neither position nor velocity.

    Parameters
    ----------
    rotation : Rotation
        Attitude from body to world, n elements.
    rate, acceleration : ndarray, shape (n, 3)
        See :data:`Motion`.
    sd : float
        Standard deviation of the angles, rad.
    """
    motion: Motion = {name: np.full(rate.shape, np.nan) for name in EMPTIED}
    known = {"angle": np.column_stack(angles(rotation)), "quaternion": rotation.as_quat()}
    return motion | known | {"rate": rate, "acceleration": acceleration, "angle_sd": np.full(rate.shape, sd)}


def _in_body(body: Rotation, velocity: Array, speed_error: Array, turn_error: Array) -> Array:
    """Return errors of the velocity along body axes, from its errors along world axes and rotation errors.

    ``velocity`` has shape (n, 3). The errors have shape (n, 3, m), where m is the number of random samples or
    of derivatives.
    """
    to_body = np.swapaxes(body.as_matrix(), 1, 2)
    return np.asarray(to_body @ (speed_error + skew_matrices(velocity) @ turn_error))


def surge_within_stroke(smoothed: SmoothedMotion, cutoff_hz: float) -> Motion:
    """Return the high-pass filtered surge velocity (oscillation within a stroke), and its standard deviation.

    The result has the entry ``surge``, m/s, shape (n, 1). The velocity is high-pass filtered along world axes
    before it is converted to body axes. Otherwise drift would enter the surge velocity as the heading
    oscillates.

    Notes
    -----
    The standard deviation is that of :data:`N_DRAWS` random trajectories of the errors, filtered like the
    velocity. The standard deviation contains every error above the cut-off frequency: noise, errors of scale
    and alignment times gravity and motion, and errors of the attitude times gravity.
    """
    path, nodes = smoothed.path, len(smoothed.path.nodes)
    velocity, _, by_speed, by_turn = _transfer_velocity(smoothed)
    body, fast = path.rotation * path.mount, _high_pass(path.time_s, velocity, cutoff_hz)
    drawn = smoothed.errors.draw(np.concatenate([by_speed, by_turn], axis=1), N_DRAWS)
    speed = _high_pass(path.node_s, drawn[:, :3].reshape(nodes, -1), cutoff_hz).reshape(nodes, 3, N_DRAWS)
    error = _in_body(body[path.nodes], fast[path.nodes], speed, drawn[:, 3:])[:, :1]
    sd = resampled(path.time_s, path.node_s, np.sqrt(np.mean(error**2, axis=2)))
    return {"surge": body.inv().apply(fast)[:, :1], "surge_sd": sd}


def _high_pass(time_s: Array, values: Array, cutoff_hz: float) -> Array:
    """Return channels, shape (n, k), without oscillations slower than ``cutoff_hz``.

    The high-pass filter is a Butterworth filter of fourth order without phase shift. The result is NaN if the
    record is too short for the filter or has too low a sample rate.
    """
    from scipy import signal

    step = float(np.median(np.diff(time_s)))
    even = np.arange(time_s[0], time_s[-1] + 0.5 * step, step)
    if len(even) < MIN_FILTERED or cutoff_hz >= MAX_CUTOFF / step:
        return np.full_like(values, np.nan)
    sos = signal.butter(2, cutoff_hz, "high", fs=1 / step, output="sos")
    length = min(len(even) - 1, int(3 / (cutoff_hz * step)))
    fast = signal.sosfiltfilt(sos, resampled(even, time_s, values), axis=0, padlen=length)
    return resampled(time_s, even, fast)
