"""Whether a smoothed motion can be: its attitude, the rests that corrected it, and its speed.

A correction is tested against what it changes. A rest tells velocity, and through the accelerometer tilt; an
attitude filter tells tilt as well. A path that contradicts either by more than both state is not written.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from swimid.inertial.aiding import GATE, REST_RATE_SD, REST_SPEED_SD, rest_nodes
from swimid.inertial.attitude import Source
from swimid.inertial.errorstate import BA, BG, SA, T, V, cross_matrix
from swimid.inertial.record import Array, Record
from swimid.inertial.rest import Rest
from swimid.inertial.sensor import DEG
from swimid.inertial.smoother import Smoothed
from swimid.inertial.trust import BAND


def contradictions(
    record: Record, smoothed: Smoothed, rests: list[Rest], source: Source, attitude_sd: float
) -> list[str]:
    """What cannot be in a smoothed motion, one sentence each; nothing where it can be.

    Parameters
    ----------
    rests : list of Rest
        Those whose velocity was taken as 0.
    source : Source
        The attitude before smoothing, in the world of the path.
    attitude_sd : float
        Its deviation, rad.
    """
    if not np.isfinite(smoothed.errors.mean).all():
        return ["the smoothing came to no numbers"]
    found = [doubt(record, smoothed, rest) for rest in doubted(record, smoothed, rests)]
    away = _tilt_between(smoothed.path.rotation, source.rotation)
    spread = smoothed.errors.covariance[:, T, T]
    own = float(np.mean(np.trace(spread[:, :2, :2], axis1=1, axis2=2)))
    off = float(np.sqrt(np.mean(away**2)))
    limit = GATE * float(np.sqrt(2 * attitude_sd**2 + own))
    if off > limit:
        found.append(
            f"its tilt departs from that of the {source.kind} by {off / DEG:.0f} deg rms, "
            f"where {limit / DEG:.0f} deg is {GATE:g} deviations"
        )
    return found


def doubted(record: Record, smoothed: Smoothed, rests: list[Rest]) -> list[Rest]:
    """Rests at which the smoothed motion is not at rest, beyond :data:`GATE` deviations."""
    return [rest for rest in rests if _at_rest(record, smoothed, rest) > GATE]


def worst(record: Record, smoothed: Smoothed, rests: list[Rest]) -> Rest | None:
    """The most doubted of them; None where none is."""
    found = doubted(record, smoothed, rests)
    return max(found, key=lambda rest: _at_rest(record, smoothed, rest), default=None)


def doubt(record: Record, smoothed: Smoothed, rest: Rest) -> str:
    """What speaks against a rest."""
    begin, end = record.time_s[rest.first], record.time_s[rest.last - 1]
    size = _at_rest(record, smoothed, rest)
    return f"the rest from {begin:.1f} to {end:.1f} s contradicts the motion by {size:.0f} deviations"


def too_fast(velocity: Array, velocity_sd: Array, top_m_s: float) -> np.ndarray:
    """Samples faster than the robot can be, shape (n,).

    Above its top speed by more than the 95 % band, or by so much that what is taken of speed (0 with half the
    top speed as deviation of each component) excludes it, however wide the band.
    """
    speed = np.linalg.norm(velocity, axis=1)
    along = np.sqrt(np.sum((velocity * velocity_sd) ** 2, axis=1)) / np.maximum(speed, 1e-9)
    return (speed - BAND * along > top_m_s) | (speed > GATE * 0.5 * top_m_s)


def _at_rest(record: Record, smoothed: Smoothed, rest: Rest) -> float:
    """Largest departure from rest, of velocity, acceleration and turn rate, in deviations."""
    path, errors = smoothed.path, smoothed.errors
    nodes = rest_nodes(rest, smoothed.nodes)
    if not len(nodes):
        return 0.0
    middle = int(nodes[len(nodes) // 2])
    covariance = errors.covariance[middle]
    velocity = path.velocity[rest.rows].mean(axis=0)
    moving = np.abs(velocity) / np.sqrt(np.diag(covariance)[V] + REST_SPEED_SD**2)
    rate = path.rate[rest.rows].mean(axis=0)
    turning = np.abs(rate) / np.sqrt(np.diag(covariance)[BG] + REST_RATE_SD**2)
    duration = max(float(path.time_s[rest.last - 1] - path.time_s[rest.first]), record.step_s)
    acceleration = path.acceleration[rest.rows].mean(axis=0)
    force = path.rotation[rest.rows].apply(path.force[rest.rows]).mean(axis=0)
    turn = path.rotation[int(smoothed.nodes[middle])].as_matrix()
    h = np.zeros((3, len(covariance)))
    h[:, T], h[:, BA] = -cross_matrix(force)[0], -turn
    h[:, SA] = -np.kron(turn, record.acceleration[rest.rows].mean(axis=0))
    spread = np.diag(h @ covariance @ h.T) + 2 * (REST_SPEED_SD / duration) ** 2
    return float(np.max([moving, turning, np.abs(acceleration) / np.sqrt(spread)]))


def _tilt_between(one: Rotation, other: Rotation) -> Array:
    """Angle between the verticals of two attitudes, rad, shape (n,)."""
    up = [r.inv().apply([0.0, 0.0, 1.0]) for r in (one, other)]
    return np.asarray(np.arctan2(np.linalg.norm(np.cross(*up), axis=1), np.sum(up[0] * up[1], axis=1)))
