"""From a record to the likeliest motion, with its uncertainty: dead reckoning, then error states.

The path is reckoned from accelerations and a first attitude; its errors against the samples, and everything
known of it (rests, attitudes, what the user declares, another log), are smoothed; then the same about the
path so found, until it stays (the iterated smoother of Bell 1994, doi:10.1137/0804035: steps of Gauss and
Newton on the whole path). Begun at the integral of the turn rates instead, a minute of fast turning would
leave an attitude that is off by radians, and no small turn corrects that.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial.transform import Rotation

from swimid.inertial import errorstate, strapdown
from swimid.inertial.errorstate import (
    ALONE,
    BA,
    BG,
    CLOCK,
    FUSED,
    LEVER,
    MOUNT,
    SA,
    SG,
    TILT,
    Driving,
    Errors,
    Observation,
    P,
    Steps,
    T,
    V,
)
from swimid.inertial.record import GRAVITY_M_S2, Array, Record
from swimid.inertial.rest import Noise
from swimid.inertial.sensor import DRIFT_TIME_S, Sensor

#: Longest step between nodes, s, and most nodes.
NODE_S, MOST_NODES = 0.02, 20_000
#: A step over this many sample times has lost samples; how long lost motion is alike, s; and the time over
#: which an error of scale keeps its sign, s.
GAP_STEPS, HIDDEN_S, RHYTHM_S = 1.5, 0.1, 0.5
#: Turns of linearising and smoothing; biases and attitude settle in two.
PASSES = 3


@dataclass(frozen=True)
class Nominal:
    """A reckoned path at every sample, with the parameters it was reckoned with.

    Attributes
    ----------
    time_s : ndarray, shape (n,)
    rotation : Rotation
        Sensor to world.
    velocity, position : ndarray, shape (n, 3)
        Of the sensor, world axes.
    force : ndarray, shape (n, 3)
        Specific force less its bias, sensor axes.
    rate : ndarray, shape (n, 3)
        Turn rate less its bias, sensor axes.
    acceleration_bias, rate_bias : ndarray, shape (n, 3)
    acceleration_scale, rate_scale : ndarray, shape (3, 3)
        Errors of scale and alignment: this times the reading was taken off.
    lever : ndarray, shape (3,)
        From the sensor to the reference point, sensor axes, m.
    mount : Rotation
        Body to sensor.
    tilt : ndarray, shape (2,)
        Gravity's horizontal components in the world, over g.
    clock_s : float
        To add to the times of the other log.
    """

    time_s: Array
    rotation: Rotation
    velocity: Array
    position: Array
    force: Array
    rate: Array
    acceleration_bias: Array
    rate_bias: Array
    acceleration_scale: Array
    rate_scale: Array
    lever: Array
    mount: Rotation
    tilt: Array
    clock_s: float = 0.0

    @property
    def acceleration(self) -> Array:
        """Acceleration of the sensor, world axes, gravity removed, shape (n, 3)."""
        return self.rotation.apply(self.force) + gravity(self.tilt)


@dataclass(frozen=True)
class Origin:
    """Everything a path is reckoned from; shapes and units as in :class:`Nominal`."""

    position: Array
    velocity: Array
    rotation: Rotation
    acceleration_bias: Array
    rate_bias: Array
    acceleration_scale: Array
    rate_scale: Array
    lever: Array
    mount: Rotation
    tilt: Array
    clock_s: float


@dataclass(frozen=True)
class Start:
    """What is known at the first sample, and the attitude to begin the search at.

    ``guide``: sensor to world, n of them. ``position``, ``velocity``: shape (3,), at the first sample, with
    their deviations; ``rotation_sd``: of the first attitude, roll, pitch and yaw about world axes, rad.
    """

    guide: Rotation
    position: Array = field(default_factory=lambda: np.zeros(3))
    velocity: Array = field(default_factory=lambda: np.zeros(3))
    position_sd: float = 1e-6
    velocity_sd: float = 1.0
    rotation_sd: tuple[float, float, float] = (0.05, 0.05, 1e-6)
    rate_bias: Array = field(default_factory=lambda: np.zeros(3))


@dataclass(frozen=True)
class Mounting:
    """How the sensor sits in the body: body to sensor, lever to the reference point (sensor axes, m).

    With the deviation of each, of the world's tilt against gravity (rad), and of the other log's clock (s).
    """

    mount: Rotation = field(default_factory=Rotation.identity)
    lever: Array = field(default_factory=lambda: np.zeros(3))
    mount_sd: float = 1e-6
    lever_sd: float = 1e-6
    tilt_sd: float = 1e-6
    clock_s: float = 0.0
    clock_sd: float = 1e-9


#: Makes observations of a reckoned path: called with the path, the rows of its nodes, and the
#: number of states.
Aid = Callable[[Nominal, np.ndarray, int], list[Observation]]


@dataclass(frozen=True)
class Smoothed:
    """The corrected path, and the covariance of what is left of its errors.

    Attributes
    ----------
    path : Nominal
        With the errors taken out.
    nodes : ndarray of int, shape (m,)
        Rows the covariance is known at.
    errors : Errors
        Of the last pass.
    origin : Origin
        What a next pass would start from; the path it would be about is ``path``.
    """

    path: Nominal
    nodes: np.ndarray
    errors: Errors
    origin: Origin


def with_clock(smoothed: Smoothed, clock_s: float) -> Smoothed:
    """The same path to go on from, with another offset between the clocks."""
    return replace(
        smoothed,
        path=replace(smoothed.path, clock_s=clock_s),
        origin=replace(smoothed.origin, clock_s=clock_s),
    )


def widened(smoothed: Smoothed, factor: float) -> Smoothed:
    """The same with all deviations times ``factor``."""
    errors = smoothed.errors
    return replace(smoothed, errors=replace(errors, covariance=errors.covariance * factor**2))


def gravity(tilt: Array) -> Array:
    """Gravity in the world, m/s^2, shape (3,)."""
    return -GRAVITY_M_S2 * np.array([tilt[0], tilt[1], 1.0])


def node_rows(time_s: Array) -> np.ndarray:
    """Rows of a record at which its errors are followed, shape (m,)."""
    duration = float(time_s[-1] - time_s[0])
    spacing = max(NODE_S, duration / MOST_NODES)
    if np.median(np.diff(time_s)) >= spacing:
        return np.arange(len(time_s))
    wanted = np.searchsorted(time_s, np.arange(time_s[0], time_s[-1], spacing))
    return np.unique(np.concatenate([wanted, [len(time_s) - 1]]))


def run(
    record: Record,
    start: Start,
    mounting: Mounting,
    sensor: Sensor,
    noise: Noise,
    aids: Sequence[Aid],
    *,
    fused: bool = False,
    after: Smoothed | None = None,
    passes: int = PASSES,
    advance: Callable[[], None] = lambda: None,
) -> Smoothed:
    """Reckon, smooth the errors, and again.

    Parameters
    ----------
    aids : sequence of callables
        Everything that is known besides the samples; :mod:`swimid.inertial.aiding` makes them.
    fused : bool
        Whether lever, mounting, the world's tilt and the other log's clock are states.
    after : Smoothed, optional
        An earlier answer to go on from.
    passes : int
        Reckonings.
    advance : callable
        Called after each pass.
    """
    states = FUSED if fused else ALONE
    rows = node_rows(record.time_s)
    driving = _driving(record, rows, sensor, noise)
    covariance = _start_covariance(start, mounting, sensor, states)
    begin = Origin(
        start.position,
        start.velocity,
        start.guide[0],
        np.zeros(3),
        start.rate_bias,
        np.zeros((3, 3)),
        np.zeros((3, 3)),
        mounting.lever,
        mounting.mount,
        np.zeros(2),
        mounting.clock_s,
    )
    path = reckon(record, begin, start.guide) if after is None else about(record, after.origin, after.path)
    now = begin if after is None else after.origin
    for turn in range(passes):
        if turn:
            path = about(record, now, path)
        steps = _steps(record, path, rows)
        errors = errorstate.smooth(
            _difference(begin, now)[:states],
            covariance,
            errorstate.transitions(record.time_s[rows], steps, states),
            errorstate.driving_noise(record.time_s[rows], driving, states),
            [o for aid in aids for o in aid(path, rows, states)],
            steps.defect,
        )
        now, path = _moved(now, errors), _corrected(record, path, errors, rows)
        advance()
    return Smoothed(path, rows, errors, now)


def reckon(record: Record, origin: Origin, rotation: Rotation) -> Nominal:
    """The path that follows from accelerations, an attitude and where it starts."""
    rate, force = _readings(record, origin)
    acceleration = rotation.apply(force) + gravity(origin.tilt)
    velocity = strapdown.integral(record.time_s, acceleration, origin.velocity)
    position = strapdown.integral(record.time_s, velocity, origin.position)
    return _nominal(record, origin, rotation, velocity, position, rate, force)


def about(record: Record, origin: Origin, path: Nominal) -> Nominal:
    """The same path with the readings corrected by an origin's biases and scales."""
    rate, force = _readings(record, origin)
    return _nominal(record, origin, path.rotation, path.velocity, path.position, rate, force)


def _readings(record: Record, origin: Origin) -> tuple[Array, Array]:
    rate = record.rate - origin.rate_bias - record.rate @ origin.rate_scale.T
    force = record.acceleration - origin.acceleration_bias - record.acceleration @ origin.acceleration_scale.T
    return rate, force


def _nominal(
    record: Record,
    origin: Origin,
    rotation: Rotation,
    velocity: Array,
    position: Array,
    rate: Array,
    force: Array,
) -> Nominal:
    return Nominal(
        record.time_s,
        rotation,
        velocity,
        position,
        force,
        rate,
        np.broadcast_to(origin.acceleration_bias, force.shape),
        np.broadcast_to(origin.rate_bias, rate.shape),
        origin.acceleration_scale,
        origin.rate_scale,
        origin.lever,
        origin.mount,
        origin.tilt,
        origin.clock_s,
    )


def at_nodes(errors: Errors, rows: np.ndarray, time_s: Array) -> Array:
    """Mean errors at every sample, shape (n, states)."""
    nodes = time_s[rows]
    return np.column_stack([np.interp(time_s, nodes, column) for column in errors.mean.T])


def _corrected(record: Record, path: Nominal, errors: Errors, rows: np.ndarray) -> Nominal:
    x = at_nodes(errors, rows, path.time_s)
    last = errors.mean[-1]
    fused = len(last) > ALONE
    scale_a, scale_w = last[SA].reshape(3, 3), last[SG].reshape(3, 3)
    return Nominal(
        path.time_s,
        Rotation.from_rotvec(x[:, T]) * path.rotation,
        path.velocity + x[:, V],
        path.position + x[:, P],
        path.force - x[:, BA] - record.acceleration @ scale_a.T,
        path.rate - x[:, BG] - record.rate @ scale_w.T,
        path.acceleration_bias + x[:, BA],
        path.rate_bias + x[:, BG],
        path.acceleration_scale + scale_a,
        path.rate_scale + scale_w,
        path.lever + (last[LEVER] if fused else 0.0),
        (Rotation.from_rotvec(last[MOUNT]) * path.mount) if fused else path.mount,
        path.tilt + (last[TILT] if fused else 0.0),
        path.clock_s + (float(last[CLOCK]) if fused else 0.0),
    )


def _difference(begin: Origin, now: Origin) -> Array:
    """Where the search began, seen from where it is: the prior mean of the errors, all states."""
    return np.concatenate(
        [
            begin.position - now.position,
            begin.velocity - now.velocity,
            (begin.rotation * now.rotation.inv()).as_rotvec(),
            begin.acceleration_bias - now.acceleration_bias,
            begin.rate_bias - now.rate_bias,
            (begin.acceleration_scale - now.acceleration_scale).ravel(),
            (begin.rate_scale - now.rate_scale).ravel(),
            begin.lever - now.lever,
            (begin.mount * now.mount.inv()).as_rotvec(),
            begin.tilt - now.tilt,
            [begin.clock_s - now.clock_s],
        ]
    )


def _moved(now: Origin, errors: Errors) -> Origin:
    """The origin after a pass; biases by their means over the record."""
    first, mean = errors.mean[0], errors.mean.mean(axis=0)
    fused = len(first) > ALONE
    return Origin(
        now.position + first[P],
        now.velocity + first[V],
        Rotation.from_rotvec(first[T]) * now.rotation,
        now.acceleration_bias + mean[BA],
        now.rate_bias + mean[BG],
        now.acceleration_scale + mean[SA].reshape(3, 3),
        now.rate_scale + mean[SG].reshape(3, 3),
        now.lever + (first[LEVER] if fused else 0.0),
        (Rotation.from_rotvec(first[MOUNT]) * now.mount) if fused else now.mount,
        now.tilt + (first[TILT] if fused else 0.0),
        now.clock_s + (float(first[CLOCK]) if fused else 0.0),
    )


def _start_covariance(start: Start, mounting: Mounting, sensor: Sensor, states: int) -> Array:
    sd = np.concatenate(
        [
            np.full(3, start.position_sd),
            np.full(3, start.velocity_sd),
            start.rotation_sd,
            np.full(3, sensor.acceleration_bias_sd),
            np.full(3, sensor.rate_bias_sd),
            np.full(18, sensor.scale_sd),
            np.full(3, mounting.lever_sd),
            np.full(3, mounting.mount_sd),
            np.full(2, mounting.tilt_sd),
            [mounting.clock_sd],
        ]
    )
    return np.diag(sd[:states] ** 2)


def _steps(record: Record, path: Nominal, rows: np.ndarray) -> Steps:
    """Means over every step between nodes, and what the samples make of it less what the path does."""
    t = path.time_s
    dt = np.diff(t[rows])[:, None]

    def mean(values: Array) -> Array:
        return np.diff(strapdown.integral(t, values)[rows], axis=0) / dt

    matrices = path.rotation.as_matrix()

    def columns_by(readings: Array) -> Array:
        parts = [mean((matrices * readings[:, None, j, None]).reshape(-1, 9)) for j in range(3)]
        return np.stack([part.reshape(-1, 3, 3) for part in parts], axis=-1)

    acceleration = path.acceleration
    velocity = strapdown.integral(t, acceleration)
    position = strapdown.integral(t, velocity)
    first, last = rows[:-1], rows[1:]
    sensed = strapdown.attitude(t, path.rate, path.rotation[0])
    step = sensed[first].inv() * sensed[last]
    defect = np.hstack(
        [
            path.velocity[first] * dt + np.diff(position[rows], axis=0) - velocity[first] * dt
            - np.diff(path.position[rows], axis=0),
            np.diff(velocity[rows], axis=0) - np.diff(path.velocity[rows], axis=0),
            (path.rotation[first] * step * path.rotation[last].inv()).as_rotvec(),
        ]
    )  # fmt: skip
    return Steps(
        mean(matrices.reshape(-1, 9)).reshape(-1, 3, 3),
        mean(path.rotation.apply(path.force)),
        columns_by(record.acceleration),
        columns_by(record.rate),
        defect,
    )


def _driving(record: Record, rows: np.ndarray, sensor: Sensor, noise: Noise) -> Driving:
    """Noise of the sensor, errors of its scale, and what bridged samples hide."""
    t = record.time_s
    dt = np.diff(t)
    moving_a = record.acceleration - np.median(record.acceleration, axis=0)
    spread_a, spread_w = np.std(record.acceleration, axis=0), np.std(record.rate, axis=0)
    variance_a = noise.acceleration**2 * dt
    variance_w = noise.rate**2 * dt
    # a step of several sample times, or bridged samples, hide what the sensor did there
    hidden = np.maximum(dt - GAP_STEPS * record.step_s, 0.0)
    lost_a = record.filled_acceleration[1:] | record.filled_acceleration[:-1]
    lost_w = record.filled_rate[1:] | record.filled_rate[:-1]
    variance_a = variance_a + float(np.sum(spread_a**2)) * (hidden**2 + lost_a * dt * HIDDEN_S)
    variance_w = variance_w + float(np.sum(spread_w**2)) * (hidden**2 + lost_w * dt * HIDDEN_S)
    # what scales leave (bending) acts with the motion's own rhythm: white beyond half a stroke
    variance_a = variance_a + sensor.bending_sd**2 * np.sum(moving_a[1:] ** 2, axis=1) * dt * RHYTHM_S
    variance_w = variance_w + sensor.bending_sd**2 * np.sum(record.rate[1:] ** 2, axis=1) * dt * RHYTHM_S
    sums = np.vstack([np.zeros((1, 2)), np.cumsum(np.column_stack([variance_a, variance_w]), axis=0)])
    steps = np.diff(sums[rows], axis=0)
    return Driving(
        steps[:, 0],
        steps[:, 1],
        sensor.acceleration_drift**2 / DRIFT_TIME_S,
        sensor.rate_drift**2 / DRIFT_TIME_S,
    )
