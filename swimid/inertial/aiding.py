"""What is known of a motion besides the samples: observations for :mod:`swimid.inertial.smoother`."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.spatial.transform import Rotation

from swimid.inertial.attitude import Source
from swimid.inertial.errorstate import ALONE, BG, CLOCK, LEVER, MOUNT, Observation, P, T, V, cross_matrix
from swimid.inertial.record import Array, Record
from swimid.inertial.rest import Noise, Rest
from swimid.inertial.sensor import FILTER_MEMORY_S, QUATERNION_MEMORY_S
from swimid.inertial.smoother import Aid, Nominal

#: Time between repeated observations of one thing, s.
EVERY_S = 0.5
#: A robot at rest in water still drifts: m/s, and rad/s.
REST_SPEED_SD, REST_RATE_SD = 0.01, 5e-4
#: Outliers lie beyond this many deviations.
GATE = 6.0


def rests(record: Record, still: list[Rest], noise: Noise, *, speed_sd: float = REST_SPEED_SD) -> Aid:
    """Zero velocity (Skog et al. 2010) and the gyroscope's bias in still stretches."""

    def make(path: Nominal, rows: np.ndarray, states: int) -> list[Observation]:
        found = []
        for rest in still:
            nodes = _spaced(path.time_s[rows], rest_nodes(rest, rows), EVERY_S)
            for node in nodes:
                h = np.zeros((3, states))
                h[:, V] = np.eye(3)
                found.append(
                    Observation(int(node), "rest", -path.velocity[rows[node]], h, np.full(3, speed_sd))
                )
            found += _bias(record, path, rest, rows, noise, states)
        return found

    return make


def biases(record: Record, still: list[Rest], noise: Noise) -> Aid:
    """The gyroscope's bias alone, in stretches that are still but perhaps not at rest."""

    def make(path: Nominal, rows: np.ndarray, states: int) -> list[Observation]:
        return [o for rest in still for o in _bias(record, path, rest, rows, noise, states)]

    return make


def _bias(
    record: Record, path: Nominal, rest: Rest, rows: np.ndarray, noise: Noise, states: int
) -> list[Observation]:
    nodes = rest_nodes(rest, rows)
    if not len(nodes):
        return []
    duration = path.time_s[rest.last - 1] - path.time_s[rest.first]
    middle = int(nodes[len(nodes) // 2])
    h = np.zeros((3, states))
    h[:, BG] = np.eye(3)
    seen = record.rate[rest.rows].mean(axis=0) - path.rate_bias[rows[middle]]
    sd = np.hypot(noise.rate / np.sqrt(max(duration, record.step_s)), REST_RATE_SD)
    return [Observation(middle, "gyroscope at rest", seen, h, np.full(3, sd))]


def attitudes(source: Source, sd: float) -> Aid:
    """The attitude of a filter or of the sensor itself, with errors that last.

    A filter's tilt is wrong while the body accelerates, some seconds; the sensor's own quaternions may be
    wrong by the same turn all the time, so that a log of them counts as one measurement.
    """

    def make(path: Nominal, rows: np.ndarray, states: int) -> list[Observation]:
        nodes = _spaced(path.time_s[rows], np.arange(len(rows)), 1.0)
        axes = slice(0, 3 if source.heading else 2)
        at = rows[nodes]
        off = (source.rotation[at] * path.rotation[at].inv()).as_rotvec()
        own = source.kind == "quaternion columns"
        memory = max(QUATERNION_MEMORY_S, 0.5 * float(np.ptp(path.time_s))) if own else FILTER_MEMORY_S
        wide = sd * np.sqrt(2 * memory)
        h = np.zeros((3, states))
        h[:, T] = np.eye(3)
        return [
            Observation(int(node), "attitude", off[k, axes], h[axes], np.full(axes.stop, wide))
            for k, node in enumerate(nodes)
        ]

    return make


def speed_limit(top_m_s: float) -> Aid:
    """No faster than this: each velocity is 0 with half of it as deviation, as one measurement a log.

    Its weight is spread over the log, so that a steady cruise, which is off by the same all the time, is not
    pulled to rest by the number of samples.
    """

    def make(path: Nominal, rows: np.ndarray, states: int) -> list[Observation]:
        nodes = _spaced(path.time_s[rows], np.arange(len(rows)), 1.0)
        h = np.zeros((3, states))
        h[:, V] = np.eye(3)
        wide = np.full(3, 0.5 * top_m_s * np.sqrt(len(nodes)))
        return [Observation(int(node), "top speed", -path.velocity[rows[node]], h, wide) for node in nodes]

    return make


def zero_mean(axis: int, window_s: float, sd: float) -> Aid:
    """A body velocity whose mean over every window is 0: no sway, or no heave (declared)."""

    def make(path: Nominal, rows: np.ndarray, states: int) -> list[Observation]:
        t = path.time_s
        body = path.rotation * path.mount
        direction = body.apply(np.eye(3)[axis])
        found = []
        edges = np.searchsorted(t, np.arange(t[0], t[-1] - window_s, window_s))
        for first, last in pairwise(edges):
            along, v = direction[first:last], path.velocity[first:last]
            node = int(np.searchsorted(rows, (first + last) // 2))
            h = np.zeros((1, states))
            h[0, V] = along.mean(axis=0)
            h[0, T] = np.cross(along, v).mean(axis=0)
            found.append(
                Observation(
                    min(node, len(rows) - 1),
                    f"no {('surge', 'sway', 'heave')[axis]}",
                    -np.array([np.mean(np.sum(along * v, axis=1))]),
                    h,
                    np.array([sd]),
                )
            )
        return found

    return make


@dataclass(frozen=True)
class Fixes:
    """Poses from another log, on its own clock.

    Attributes
    ----------
    time_s : ndarray, shape (m,)
    position : ndarray, shape (m, 3)
        Of the reference point, world axes, m; NaN where not measured, whole columns where an axis never is.
    position_sd : ndarray, shape (3,)
    rotation : Rotation or None
        Body to world, m of them.
    turns : ndarray of bool, shape (m, 3)
        Which turns about world axes were measured.
    rotation_sd : float
        rad.
    """

    time_s: Array
    position: Array
    position_sd: Array
    rotation: Rotation | None
    turns: np.ndarray
    rotation_sd: float


def fixes(seen: Fixes) -> Aid:
    """Poses another log measured."""

    def make(path: Nominal, rows: np.ndarray, states: int) -> list[Observation]:
        t = path.time_s
        clock_times = seen.time_s + path.clock_s
        inside = np.flatnonzero((clock_times >= t[0]) & (clock_times <= t[-1]))
        when = clock_times[inside]
        velocity = np.column_stack([np.interp(when, t, column) for column in path.velocity.T])
        place = np.column_stack([np.interp(when, t, column) for column in path.position.T])
        row = np.clip(np.searchsorted(t, when), 1, len(t) - 1)
        row -= (when - t[row - 1]) < (t[row] - when)
        turn = Rotation.from_rotvec(path.rate[row] * (when - t[row])[:, None])
        rotation = path.rotation[row] * turn
        lever, spin = rotation.apply(path.lever), rotation.apply(path.rate[row])
        node = np.clip(np.searchsorted(t[rows], when), 1, len(rows) - 1)
        node -= (when - t[rows[node - 1]]) < (t[rows[node]] - when)
        matrices, arms = rotation.as_matrix(), cross_matrix(lever)
        found = []
        for k, index in enumerate(inside):
            there = np.isfinite(seen.position[index])
            if there.any():
                h = np.zeros((3, states))
                h[:, P] = np.eye(3)
                h[:, V] = np.eye(3) * (when[k] - t[rows[node[k]]])
                h[:, T] = -arms[k]
                if states > ALONE:
                    h[:, LEVER] = matrices[k]
                    h[:, CLOCK] = velocity[k] + np.cross(spin[k], lever[k])
                off = seen.position[index] - place[k] - lever[k]
                found.append(
                    Observation(int(node[k]), "position", off[there], h[there], seen.position_sd[there], GATE)
                )
            turned = seen.turns[index]
            if seen.rotation is not None and turned.any():
                h = np.zeros((3, states))
                h[:, T] = np.eye(3)
                if states > ALONE:
                    h[:, MOUNT] = matrices[k]
                    h[:, CLOCK] = spin[k]
                off = (seen.rotation[index] * (rotation[k] * path.mount).inv()).as_rotvec()
                sd = np.full(int(turned.sum()), seen.rotation_sd)
                found.append(Observation(int(node[k]), "orientation", off[turned], h[turned], sd, GATE))
        return found

    return make


def rest_nodes(rest: Rest, rows: np.ndarray) -> np.ndarray:
    """Nodes within a rest."""
    return np.flatnonzero((rows >= rest.first) & (rows < rest.last))


def _spaced(times: Array, nodes: np.ndarray, every_s: float) -> np.ndarray:
    """Of these nodes, one at least ``every_s`` after the other."""
    if not len(nodes):
        return nodes
    marks = np.arange(times[nodes[0]], times[nodes[-1]] + 1e-9, every_s)
    return nodes[np.unique(np.clip(np.searchsorted(times[nodes], marks), 0, len(nodes) - 1))]
