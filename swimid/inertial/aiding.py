"""What is known of a motion besides the samples: observations for :mod:`swimid.inertial.smoother`."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.spatial.transform import Rotation

from swimid.inertial.attitude import QUATERNIONS, Source
from swimid.inertial.errorstate import ALONE, BG, CLOCK, LEVER, MOUNT, Observation, P, T, V, cross_matrix
from swimid.inertial.record import Array, Record
from swimid.inertial.rest import Noise, Rest
from swimid.inertial.sensor import FILTER_MEMORY_S, QUATERNION_MEMORY_S
from swimid.inertial.smoother import Aid, Nominal
from swimid.logs.rotation import angles

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
        own = source.kind == QUATERNIONS
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
        Which of roll, pitch and yaw were measured.
    rotation_sd : float
        rad.
    place_weight, turn_weight : ndarray, shape (m,)
        Weight of each position and each attitude, at most 1: a stray one's deviation is larger by its root.
    counted : ndarray of bool, shape (m,)
        Those whose likelihood is compared between clocks.
    """

    time_s: Array
    position: Array
    position_sd: Array
    rotation: Rotation | None
    turns: np.ndarray
    rotation_sd: float
    place_weight: Array
    turn_weight: Array
    counted: np.ndarray

    def take(self, rows: np.ndarray) -> Fixes:
        """Only these, shape (m,) of bool."""
        return replace(
            self,
            time_s=self.time_s[rows],
            position=self.position[rows],
            rotation=None if self.rotation is None else self.rotation[rows],
            turns=self.turns[rows],
            place_weight=self.place_weight[rows],
            turn_weight=self.turn_weight[rows],
            counted=self.counted[rows],
        )


@dataclass(frozen=True)
class Seen:
    """One fix against the path: which of them, and the observation it makes."""

    index: int
    observation: Observation


def fixes(seen: Fixes, gate: float = np.inf) -> Aid:
    """Poses another log measured; those beyond ``gate`` deviations are not used."""

    def make(path: Nominal, rows: np.ndarray, states: int) -> list[Observation]:
        return [one.observation for one in against(seen, path, rows, states, gate)]

    return make


def against(seen: Fixes, path: Nominal, rows: np.ndarray, states: int, gate: float = np.inf) -> list[Seen]:
    """Every fix within a path as an observation of its errors."""
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
    turned = _turned(seen, inside, rotation * path.mount)
    place_sd = seen.position_sd / np.sqrt(seen.place_weight[inside])[:, None]
    turn_sd = seen.rotation_sd / np.sqrt(seen.turn_weight[inside])
    by_place = np.zeros((len(inside), 3, states))
    by_place[:, :, P] = np.eye(3)
    by_place[:, :, V] = np.eye(3) * (when - t[rows[node]])[:, None, None]
    by_place[:, :, T] = -arms
    if states > ALONE:
        by_place[:, :, LEVER] = matrices
        by_place[:, :, CLOCK] = velocity + np.cross(spin, lever)
    away = seen.position[inside] - place - lever
    measured, counted = np.isfinite(away), seen.counted[inside].tolist()
    found = []
    for k, index in enumerate(inside.tolist()):
        there = measured[k]
        if there.any():
            off, h = away[k, there], by_place[k, there]
            place_seen = Observation(int(node[k]), "position", off, h, place_sd[k, there], gate, counted[k])
            found.append(Seen(index, place_seen))
        axes = seen.turns[index]
        if turned is not None and axes.any():
            off, by_turn = turned[0][k, axes], turned[1][k][axes]
            h = np.zeros((len(off), states))
            h[:, T] = by_turn
            if states > ALONE:
                h[:, MOUNT] = by_turn @ matrices[k]
                h[:, CLOCK] = by_turn @ spin[k]
            sd = np.full(len(off), turn_sd[k])
            found.append(Seen(index, Observation(int(node[k]), "orientation", off, h, sd, gate, counted[k])))
    return found


def _turned(seen: Fixes, inside: np.ndarray, body: Rotation) -> tuple[Array, Array] | None:
    """Measured less reckoned attitude, shape (k, 3), and what a small turn does to it, (k, 3, 3).

    Three angles together make a small turn about world axes. One alone is compared as an angle: of a body
    that tilts, the yaw is not its turn about the vertical.
    """
    if seen.rotation is None:
        return None
    measured = seen.rotation[inside]
    if seen.turns[inside].sum(axis=1).max(initial=0) == 3:
        return (measured * body.inv()).as_rotvec(), np.broadcast_to(np.eye(3), (len(inside), 3, 3))
    roll, pitch, yaw = angles(body)
    off = np.column_stack(angles(measured)) - np.column_stack([roll, pitch, yaw])
    off = np.angle(np.exp(1j * off))
    c, s, zero = np.cos(yaw), np.sin(yaw), np.zeros(len(yaw))
    # a turn about the vertical is yaw; about the heading it rolls, and yaws by the tangent of the dip
    along = np.stack([c, s, zero], -1)
    level = np.maximum(np.cos(pitch), 0.1)[:, None]
    rolls, pitches = along / level, np.stack([s, -c, zero], -1)
    yaws = np.stack([zero, zero, zero + 1], -1) - np.sin(pitch)[:, None] * rolls
    return off, np.stack([rolls, pitches, yaws], axis=1)


def rest_nodes(rest: Rest, rows: np.ndarray) -> np.ndarray:
    """Nodes within a rest."""
    return np.flatnonzero((rows >= rest.first) & (rows < rest.last))


def _spaced(times: Array, nodes: np.ndarray, every_s: float) -> np.ndarray:
    """Of these nodes, one at least ``every_s`` after the other."""
    if not len(nodes):
        return nodes
    marks = np.arange(times[nodes[0]], times[nodes[-1]] + 1e-9, every_s)
    return nodes[np.unique(np.clip(np.searchsorted(times[nodes], marks), 0, len(nodes) - 1))]
