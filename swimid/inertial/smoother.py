"""From a record to the likeliest motion, with its uncertainty: dead reckoning, then error states.

The path is reckoned from turn rates and accelerations; its errors are smoothed with everything known
of it (rests, attitudes, what the user declares, another log); reckoning starts again with the
biases and attitude so found, until they stay.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

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
    TILT,
    Driving,
    Errors,
    Observation,
    P,
    T,
    V,
)
from swimid.inertial.record import GRAVITY_M_S2, Array, Record
from swimid.inertial.rest import Noise
from swimid.inertial.sensor import DRIFT_TIME_S, Sensor

#: Longest step between nodes, s, and most nodes.
NODE_S, MOST_NODES = 0.02, 60_000
#: A step over this many sample times has lost samples; how long lost motion is alike, s; and the time over
#: which an error of scale keeps its sign, s.
GAP_STEPS, HIDDEN_S, RHYTHM_S = 1.5, 0.1, 0.5
#: Reckonings; biases and attitude settle in two.
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
    lever: Array
    mount: Rotation
    tilt: Array
    clock_s: float


@dataclass(frozen=True)
class Start:
    """What is known at the first sample.

    ``position``, ``velocity``: shape (3,), with their deviations; ``rotation_sd``: roll, pitch and yaw
    about world axes, rad.
    """

    rotation: Rotation
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
        What a next pass would reckon from.
    """

    path: Nominal
    nodes: np.ndarray
    errors: Errors
    origin: Origin


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
        start.rotation,
        np.zeros(3),
        start.rate_bias,
        mounting.lever,
        mounting.mount,
        np.zeros(2),
        mounting.clock_s,
    )
    now = begin if after is None else after.origin
    for _ in range(passes):
        path = reckon(record, now)
        turn, force = _mean_turn_and_force(path, rows)
        errors = errorstate.smooth(
            _difference(begin, now)[:states],
            covariance,
            errorstate.transitions(record.time_s[rows], turn, force, states),
            errorstate.driving_noise(record.time_s[rows], driving, states),
            [o for aid in aids for o in aid(path, rows, states)],
        )
        now = _moved(now, errors)
        advance()
    return Smoothed(_corrected(path, errors, rows), rows, errors, now)


def reckon(record: Record, origin: Origin) -> Nominal:
    """The path that follows from the samples and where they start."""
    rate = record.rate - origin.rate_bias
    force = record.acceleration - origin.acceleration_bias
    rotation = strapdown.attitude(record.time_s, rate, origin.rotation)
    acceleration = rotation.apply(force) + gravity(origin.tilt)
    velocity = strapdown.integral(record.time_s, acceleration, origin.velocity)
    position = strapdown.integral(record.time_s, velocity, origin.position)
    return Nominal(
        record.time_s,
        rotation,
        velocity,
        position,
        force,
        rate,
        np.broadcast_to(origin.acceleration_bias, force.shape),
        np.broadcast_to(origin.rate_bias, rate.shape),
        origin.lever,
        origin.mount,
        origin.tilt,
        origin.clock_s,
    )


def at_nodes(errors: Errors, rows: np.ndarray, time_s: Array) -> Array:
    """Mean errors at every sample, shape (n, states)."""
    nodes = time_s[rows]
    return np.column_stack([np.interp(time_s, nodes, column) for column in errors.mean.T])


def _corrected(path: Nominal, errors: Errors, rows: np.ndarray) -> Nominal:
    x = at_nodes(errors, rows, path.time_s)
    fused = x.shape[1] > ALONE
    return Nominal(
        path.time_s,
        Rotation.from_rotvec(x[:, T]) * path.rotation,
        path.velocity + x[:, V],
        path.position + x[:, P],
        path.force - x[:, BA],
        path.rate - x[:, BG],
        path.acceleration_bias + x[:, BA],
        path.rate_bias + x[:, BG],
        path.lever + (x[-1, LEVER] if fused else 0.0),
        (Rotation.from_rotvec(x[-1, MOUNT]) * path.mount) if fused else path.mount,
        path.tilt + (x[-1, TILT] if fused else 0.0),
        path.clock_s + (float(x[-1, CLOCK]) if fused else 0.0),
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
            np.full(3, mounting.lever_sd),
            np.full(3, mounting.mount_sd),
            np.full(2, mounting.tilt_sd),
            [mounting.clock_sd],
        ]
    )
    return np.diag(sd[:states] ** 2)


def _mean_turn_and_force(path: Nominal, rows: np.ndarray) -> tuple[Array, Array]:
    """Mean rotation matrix and mean specific force (world) over every step between nodes."""
    matrices = path.rotation.as_matrix().reshape(-1, 9)
    force = path.rotation.apply(path.force)
    joint = strapdown.integral(path.time_s, np.hstack([matrices, force]))
    mean = np.diff(joint[rows], axis=0) / np.diff(path.time_s[rows])[:, None]
    return mean[:, :9].reshape(-1, 3, 3), mean[:, 9:]


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
    # an error of scale acts with the motion's own rhythm: white beyond half a stroke
    variance_a = variance_a + sensor.scale_sd**2 * np.sum(moving_a[1:] ** 2, axis=1) * dt * RHYTHM_S
    variance_w = variance_w + sensor.scale_sd**2 * np.sum(record.rate[1:] ** 2, axis=1) * dt * RHYTHM_S
    sums = np.vstack([np.zeros((1, 2)), np.cumsum(np.column_stack([variance_a, variance_w]), axis=0)])
    steps = np.diff(sums[rows], axis=0)
    return Driving(
        steps[:, 0],
        steps[:, 1],
        sensor.acceleration_drift**2 / DRIFT_TIME_S,
        sensor.rate_drift**2 / DRIFT_TIME_S,
    )
