"""Observations that correct a path in :mod:`swimid.inertial.smoother`.

They come from rests, attitudes, statements of the user and another log of the same trial.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.spatial.transform import Rotation

from swimid.inertial.record import Array, Flags, Poses, resampled
from swimid.inertial.setup import FILTER_MEMORY_S, QUATERNION_MEMORY_S, QUATERNIONS, Rest, Setup
from swimid.inertial.smoother import Nominal, Observation, cross_matrix, jacobian
from swimid.logs.rotation import angles

#: Standard deviations of the velocity, m/s, and turn rate, rad/s, of a robot at rest in drifting water.
REST_SPEED_SD, REST_RATE_SD = 0.01, 5e-4
#: Maximum normalised residual, in standard deviations. Larger residuals are outliers.
GATE = 6.0
#: Names of the body axes. The user can state a mean velocity of 0 along the last two axes.
AXES = ("surge", "sway", "heave")
#: Standard deviation of a mean velocity that the user states as 0, m/s.
ZERO_MEAN_SD = 0.02
#: Interval between observations of velocity at rest, and between observations of attitude and top speed, s.
REST_STEP_S, STEP_S = 0.5, 1.0


def observe_alone(setup: Setup, path: Nominal) -> list[Observation]:
    """Return the observations of a path that need no other log."""
    stated = [AXES.index(name) for name in dict.fromkeys(setup.options.zero_mean)]
    means = [seen for axis in stated for seen in _zero_mean(setup, axis, path)]
    return [*_rests(setup, path), *_attitudes(setup, path), *means]


def _rests(setup: Setup, path: Nominal) -> list[Observation]:
    """Return observations of zero velocity at rests, and of the gyroscope bias in still periods.

    The method is that of Skog et al. (2010).
    """
    record, still = setup.record, setup.still
    observations = []
    by_velocity = jacobian(path.states, 3, velocity=np.eye(3))
    by_bias = jacobian(path.states, 3, rate_bias=np.eye(3))
    for rest in still.stretches:
        nodes = rest_nodes(rest, path)
        if not len(nodes):
            continue
        if rest in still.rests:
            for node in _spaced(path, nodes, REST_STEP_S):
                off, sd = -path.velocity[path.nodes[node]], np.full(3, REST_SPEED_SD)
                observations.append(Observation(int(node), "rest", off, by_velocity, sd))
        duration = path.time_s[rest.last - 1] - path.time_s[rest.first]
        middle = int(nodes[len(nodes) // 2])
        off = record.rate[rest.rows].mean(axis=0) - path.rate_bias[path.nodes[middle]]
        sd = np.full(3, np.hypot(still.noise.rate / np.sqrt(max(duration, record.step_s)), REST_RATE_SD))
        observations.append(Observation(middle, "gyroscope at rest", off, by_bias, sd))
    return observations


def _attitudes(setup: Setup, path: Nominal) -> list[Observation]:
    """Return observations of the attitude before smoothing, whose errors are correlated in time.

    The tilt of an attitude filter is wrong for some seconds while the body accelerates. The quaternions of a
    sensor may have the same rotation error throughout a log, so that all of them together count as one
    measurement.
    """
    source = setup.source
    nodes = _spaced(path, np.arange(len(path.nodes)), STEP_S)
    axes = slice(0, 3 if source.heading else 2)
    at = path.nodes[nodes]
    off = (source.rotation[at] * path.rotation[at].inv()).as_rotvec()[:, axes]
    memory_s = FILTER_MEMORY_S
    if source.kind == QUATERNIONS:
        memory_s = max(QUATERNION_MEMORY_S, 0.5 * float(np.ptp(path.time_s)))
    sd = np.full(axes.stop, setup.attitude_sd * np.sqrt(2 * memory_s))
    h = jacobian(path.states, 3, rotation=np.eye(3))[axes]
    return [Observation(int(n), "attitude", turn, h, sd) for n, turn in zip(nodes, off, strict=True)]


def observe_speed_limit(top_m_s: float, path: Nominal) -> list[Observation]:
    """Return observations of velocity 0 with half of the top speed as standard deviation.

    All these observations of a log together have the weight of a single one, so that a steady cruise is not
    pulled to rest.
    """
    nodes = _spaced(path, np.arange(len(path.nodes)), STEP_S)
    h = jacobian(path.states, 3, velocity=np.eye(3))
    sd = np.full(3, 0.5 * top_m_s * np.sqrt(len(nodes)))
    velocity = path.velocity[path.nodes]
    return [Observation(int(node), "top speed", -velocity[node], h, sd) for node in nodes]


def _zero_mean(setup: Setup, axis: int, path: Nominal) -> Iterator[Observation]:
    """Yield an observation of zero mean body velocity in every window, for an axis stated by the user."""
    t, window_s = path.time_s, setup.options.window_s
    direction = (path.rotation * path.mount).apply(np.eye(3)[axis])
    for first, last in pairwise(np.searchsorted(t, np.arange(t[0], t[-1] - window_s, window_s))):
        along, v = direction[first:last], path.velocity[first:last]
        node = min(int(np.searchsorted(path.nodes, (first + last) // 2)), len(path.nodes) - 1)
        by_turn = np.cross(along, v).mean(axis=0)
        h = jacobian(path.states, 1, velocity=along.mean(axis=0), rotation=by_turn)
        off = -np.array([np.mean(np.sum(along * v, axis=1))])
        yield Observation(node, f"no {AXES[axis]}", off, h, np.array([ZERO_MEAN_SD]))


@dataclass(frozen=True)
class Fixes(Poses):
    """Poses measured by another log (fixes), with their noise."""

    #: Standard deviations of the three coordinates, m, and the three angles, rad, shape (6,).
    noise: Array
    #: Weights of position and attitude, shape (m, 2). A weight is 1, or less for an outlier. It divides the
    #: variance.
    weight: Array
    #: Flags of the poses that are within the record for every candidate clock offset, shape (m,). Only these
    #: poses contribute to the log-likelihood.
    counted: Flags

    @property
    def sd(self) -> Array:
        """Standard deviations of coordinates and angles after weighting, shape (m, 6)."""
        return np.asarray(self.noise / np.sqrt(np.repeat(self.weight, 3, axis=1)))

    @property
    def stray(self) -> Flags:
        """Flags of positions and attitudes that are outliers, shape (m, 2)."""
        return self.weight < 1

    def take(self, rows: Flags) -> Fixes:
        """Return the poses that are selected by ``rows``, flags of shape (m,)."""
        each = ("time_s", "position", "angles", "weight", "counted")
        return replace(self, **{name: getattr(self, name)[rows] for name in each})

    def unweighted(self) -> Fixes:
        """Return the poses with all weights reset to 1."""
        return replace(self, weight=np.ones_like(self.weight))


def observe_fixes(seen: Fixes, path: Nominal, gate: float = np.inf) -> list[Observation]:
    """Return an observation for every pose within the time range of a path.

    Parameters
    ----------
    gate : float
        Maximum innovation, in standard deviations. Larger innovations are outliers.
    """
    t = path.time_s
    clock_times = seen.time_s + path.clock_s
    inside = np.flatnonzero((clock_times >= t[0]) & (clock_times <= t[-1]))
    when = clock_times[inside]
    velocity, place = resampled(when, t, path.velocity), resampled(when, t, path.position)
    row, node = _nearest(t, when), _nearest(path.node_s, when)
    turn = Rotation.from_rotvec(path.rate[row] * (when - t[row])[:, None])
    rotation = path.rotation[row] * turn
    lever, spin = rotation.apply(path.lever), rotation.apply(path.rate[row])
    matrices = rotation.as_matrix()
    place_sd, turn_sd = np.hsplit(seen.sd[inside], 2)
    by_place = jacobian(
        path.states,
        *place.shape,
        position=np.eye(3),
        velocity=np.eye(3) * (when - path.node_s[node])[:, None, None],
        rotation=-cross_matrix(lever),
        lever=matrices,
        clock_s=(velocity + np.cross(spin, lever))[:, :, None],
    )
    away = seen.position[inside] - place - lever
    kinds = [("position", away, np.isfinite(away), by_place, place_sd)]
    turns = seen.turns[inside]
    if turns.any():
        used = turns.any(axis=0)
        off, by_turn = _turned(seen.rotation[inside], turns, rotation * path.mount)
        off, by_turn = off[:, used], by_turn[:, used]
        by_angle = jacobian(
            path.states,
            *off.shape,
            rotation=by_turn,
            mount=by_turn @ matrices,
            clock_s=by_turn @ spin[:, :, None],
        )
        kinds.append(("orientation", off, turns[:, used], by_angle, turn_sd[:, used]))
    observations = []
    for k, index in enumerate(inside.tolist()):
        for kind, off, measured, h, sd in kinds:
            one = measured[k]
            if one.any():
                values = (off[k, one], h[k, one], sd[k, one])
                counted = bool(seen.counted[index])
                observations.append(Observation(int(node[k]), kind, *values, gate, counted, index))
    return observations


def _nearest(times: Array, when: Array) -> np.ndarray:
    """Return, for each time in ``when``, the index of the nearest element of ``times``."""
    index = np.clip(np.searchsorted(times, when), 1, len(times) - 1)
    return index - ((when - times[index - 1]) < (times[index] - when))


def _turned(measured: Rotation, turns: Flags, body: Rotation) -> tuple[Array, Array]:
    """Return measured minus estimated attitude and its derivative with respect to a small rotation.

    The difference has shape (k, 3), its derivative shape (k, 3, 3). If all three angles are measured, the
    difference is a small rotation about world axes. A single measured angle is compared as an angle, because
    the yaw of a tilted body differs from its rotation about the vertical.
    """
    if turns.all(axis=1).any():
        return (measured * body.inv()).as_rotvec(), np.broadcast_to(np.eye(3), (len(turns), 3, 3))
    off = np.column_stack(angles(measured)) - np.column_stack(angles(body))
    by_turn, pitch = turn_to_angles(body), angles(body)[1][:, None]
    # at a pitch other than 0, a rotation about the heading direction changes roll by 1/cos(pitch), and also
    # yaw
    by_turn[:, 0] /= np.maximum(np.cos(pitch), 0.1)
    by_turn[:, 2] -= np.sin(pitch) * by_turn[:, 0]
    return np.angle(np.exp(1j * off)), by_turn


def turn_to_angles(body: Rotation) -> Array:
    """Return the derivatives of roll, pitch and yaw with respect to small rotations, shape (n, 3, 3).

    The rotations are about world axes, and the body is nearly level. Roll is then about the heading
    direction, pitch about starboard (nose up), and yaw about the vertical.
    """
    yaw = angles(body)[2]
    out = np.zeros((len(yaw), 3, 3))
    out[:, 0, 0], out[:, 0, 1] = np.cos(yaw), np.sin(yaw)
    out[:, 1, 0], out[:, 1, 1] = np.sin(yaw), -np.cos(yaw)
    out[:, 2, 2] = 1.0
    return out


def rest_nodes(rest: Rest, path: Nominal) -> np.ndarray:
    """Return the indices of the nodes of a path that lie within a rest."""
    return np.flatnonzero((path.nodes >= rest.first) & (path.nodes < rest.last))


def _spaced(path: Nominal, nodes: np.ndarray, step_s: float) -> np.ndarray:
    """Return a subset of the nodes, at least ``step_s`` apart."""
    times = path.node_s[nodes]
    marks = np.arange(times[0], times[-1] + 1e-9, step_s)
    return nodes[np.unique(np.clip(np.searchsorted(times, marks), 0, len(nodes) - 1))]
