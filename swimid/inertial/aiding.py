"""What is known of a motion besides the samples: observations for :mod:`swimid.inertial.smoother`."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.spatial.transform import Rotation

from swimid.inertial.record import Array, Poses, resampled
from swimid.inertial.setup import FILTER_MEMORY_S, QUATERNION_MEMORY_S, QUATERNIONS, Rest, Setup
from swimid.inertial.smoother import Nominal, Observation, cross_matrix, jacobian
from swimid.logs.rotation import angles

#: A robot at rest in water still drifts: m/s, and rad/s.
REST_SPEED_SD, REST_RATE_SD = 0.01, 5e-4
#: Outliers lie beyond this many deviations.
GATE = 6.0
#: Body axes, of which the mean velocity along the last two may be declared to be 0.
AXES = ("surge", "sway", "heave")


def known(setup: Setup, path: Nominal) -> list[Observation]:
    """Everything known of a path without another log."""
    declared = [AXES.index(name) for name in dict.fromkeys(setup.options.zero_mean)]
    means = [seen for axis in declared for seen in _zero_mean(setup, axis, path)]
    return [*_stillness(setup, path), *_attitudes(setup, path), *means]


def _stillness(setup: Setup, path: Nominal) -> list[Observation]:
    """Zero velocity at rest (Skog et al. 2010), and the gyroscope's bias wherever it is still."""
    record, still = setup.record, setup.still
    observations = []
    wide = np.full(3, REST_SPEED_SD)
    by_velocity = jacobian(path.states, 3, velocity=np.eye(3))
    by_bias = jacobian(path.states, 3, rate_bias=np.eye(3))
    for rest in still.stretches:
        nodes = rest_nodes(rest, path)
        # Time between repeated observations of one thing, s.
        for node in _spaced(path, nodes, 0.5) if rest in still.rests else ():
            observations.append(
                Observation(int(node), "rest", -path.velocity[path.nodes[node]], by_velocity, wide)
            )
        if not len(nodes):
            continue
        duration = path.time_s[rest.last - 1] - path.time_s[rest.first]
        middle = int(nodes[len(nodes) // 2])
        seen = record.rate[rest.rows].mean(axis=0) - path.rate_bias[path.nodes[middle]]
        sd = np.hypot(still.noise.rate / np.sqrt(max(duration, record.step_s)), REST_RATE_SD)
        observations.append(Observation(middle, "gyroscope at rest", seen, by_bias, np.full(3, sd)))
    return observations


def _attitudes(setup: Setup, path: Nominal) -> list[Observation]:
    """The attitude of a filter or of the sensor itself, with errors that last.

    A filter's tilt is wrong while the body accelerates, some seconds; the sensor's own quaternions may be
    wrong by the same turn all the time, so that a log of them counts as one measurement.
    """
    source = setup.source
    nodes = _spaced(path, np.arange(len(path.nodes)), 1.0)
    axes = slice(0, 3 if source.heading else 2)
    at = path.nodes[nodes]
    off = (source.rotation[at] * path.rotation[at].inv()).as_rotvec()[:, axes]
    own = source.kind == QUATERNIONS
    memory = max(QUATERNION_MEMORY_S, 0.5 * float(np.ptp(path.time_s))) if own else FILTER_MEMORY_S
    wide = np.full(axes.stop, setup.attitude_sd * np.sqrt(2 * memory))
    h = jacobian(path.states, 3, rotation=np.eye(3))[axes]
    return [Observation(int(n), "attitude", turn, h, wide) for n, turn in zip(nodes, off, strict=True)]


def speed_limit(top_m_s: float, path: Nominal) -> list[Observation]:
    """No faster than this: each velocity is 0 with half of it as deviation, as one measurement a log.

    Its weight is spread over the log, so that a steady cruise, which is off by the same all the time, is not
    pulled to rest by the number of samples.
    """
    nodes = _spaced(path, np.arange(len(path.nodes)), 1.0)
    h = jacobian(path.states, 3, velocity=np.eye(3))
    wide = np.full(3, 0.5 * top_m_s * np.sqrt(len(nodes)))
    velocity = path.velocity[path.nodes]
    return [Observation(int(node), "top speed", -velocity[node], h, wide) for node in nodes]


def _zero_mean(setup: Setup, axis: int, path: Nominal) -> Iterator[Observation]:
    """A body velocity whose mean over every window is 0: no sway, or no heave (declared)."""
    t, window_s = path.time_s, setup.options.window_s
    direction = (path.rotation * path.mount).apply(np.eye(3)[axis])
    for first, last in pairwise(np.searchsorted(t, np.arange(t[0], t[-1] - window_s, window_s))):
        along, v = direction[first:last], path.velocity[first:last]
        node = min(int(np.searchsorted(path.nodes, (first + last) // 2)), len(path.nodes) - 1)
        by_turn = np.cross(along, v).mean(axis=0)
        h = jacobian(path.states, 1, velocity=along.mean(axis=0), rotation=by_turn)
        off = -np.array([np.mean(np.sum(along * v, axis=1))])
        yield Observation(node, f"no {AXES[axis]}", off, h, np.array([setup.options.mean_sd_m_s]))


@dataclass(frozen=True)
class Fixes(Poses):
    """Poses from another log, on its own clock, with their noise."""

    #: Shape (6,). Deviations of coordinates, m, and angles, rad.
    noise: Array
    #: Shape (m, 2). What the variance of position and attitude is divided by: below 1 for a stray one.
    weight: Array
    #: Shape (m,). Those whose likelihood is compared between clocks.
    counted: np.ndarray

    @property
    def sd(self) -> Array:
        """Deviations of coordinates and angles, shape (m, 6); larger where a fix is stray."""
        return np.asarray(self.noise / np.sqrt(np.repeat(self.weight, 3, axis=1)))

    @property
    def stray(self) -> np.ndarray:
        """Which positions and attitudes are, shape (m, 2)."""
        return self.weight < 1

    def take(self, rows: np.ndarray) -> Fixes:
        """Only these, shape (m,) of bool."""
        each = ("time_s", "position", "angles", "weight", "counted")
        return replace(self, **{name: getattr(self, name)[rows] for name in each})

    def unweighted(self) -> Fixes:
        """The same with none of them stray."""
        return replace(self, weight=np.ones_like(self.weight))


def against(seen: Fixes, path: Nominal, gate: float = np.inf) -> list[Observation]:
    """Every fix within a path as an observation of its errors; not used beyond ``gate`` deviations."""
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
    away, counted = seen.position[inside] - place - lever, seen.counted[inside].tolist()
    kinds = [("position", away, np.isfinite(away), by_place, place_sd)]
    turns = seen.turns[inside]
    if turns.any():
        told = turns.any(axis=0)
        off, by_turn = _turned(seen.rotation[inside], turns, rotation * path.mount)
        off, by_turn = off[:, told], by_turn[:, told]
        by_angle = jacobian(
            path.states,
            *off.shape,
            rotation=by_turn,
            mount=by_turn @ matrices,
            clock_s=by_turn @ spin[:, :, None],
        )
        kinds.append(("orientation", off, turns[:, told], by_angle, turn_sd[:, told]))
    observations = []
    for k, index in enumerate(inside.tolist()):
        for kind, off, measured, h, sd in kinds:
            there = measured[k]
            if there.any():
                values = (off[k, there], h[k, there], sd[k, there])
                observations.append(Observation(int(node[k]), kind, *values, gate, counted[k], index))
    return observations


def _nearest(times: Array, when: Array) -> np.ndarray:
    """Index of the nearest of these times."""
    index = np.clip(np.searchsorted(times, when), 1, len(times) - 1)
    return index - ((when - times[index - 1]) < (times[index] - when))


def _turned(measured: Rotation, turns: np.ndarray, body: Rotation) -> tuple[Array, Array]:
    """Measured less reckoned attitude, shape (k, 3), and what a small turn does to it, (k, 3, 3).

    Three angles together make a small turn about world axes. One alone is compared as an angle: of a body
    that tilts, the yaw is not its turn about the vertical.
    """
    if turns.all(axis=1).any():
        return (measured * body.inv()).as_rotvec(), np.broadcast_to(np.eye(3), (len(turns), 3, 3))
    off = np.column_stack(angles(measured)) - np.column_stack(angles(body))
    by_turn, pitch = turn_to_angles(body), angles(body)[1][:, None]
    # about the heading a turn rolls, and yaws by the tangent of the dip
    by_turn[:, 0] /= np.maximum(np.cos(pitch), 0.1)
    by_turn[:, 2] -= np.sin(pitch) * by_turn[:, 0]
    return np.angle(np.exp(1j * off)), by_turn


def turn_to_angles(body: Rotation) -> Array:
    """What a small turn about world axes does to roll, pitch and yaw of a level body, shape (n, 3, 3).

    Roll about the heading, pitch about starboard (nose up), yaw about the vertical.
    """
    yaw = angles(body)[2]
    out = np.zeros((len(yaw), 3, 3))
    out[:, 0, 0], out[:, 0, 1] = np.cos(yaw), np.sin(yaw)
    out[:, 1, 0], out[:, 1, 1] = np.sin(yaw), -np.cos(yaw)
    out[:, 2, 2] = 1.0
    return out


def rest_nodes(rest: Rest, path: Nominal) -> np.ndarray:
    """Nodes within a rest."""
    return np.flatnonzero((path.nodes >= rest.first) & (path.nodes < rest.last))


def _spaced(path: Nominal, nodes: np.ndarray, every_s: float) -> np.ndarray:
    """Of these nodes, one at least ``every_s`` after the other."""
    if not len(nodes):
        return nodes
    times = path.node_s[nodes]
    marks = np.arange(times[0], times[-1] + 1e-9, every_s)
    return nodes[np.unique(np.clip(np.searchsorted(times, marks), 0, len(nodes) - 1))]
