"""Whether a smoothed motion can be (attitude, rests, speed), and how far an integrated path can be trusted.

A correction is tested against what it changes. A rest tells velocity, and through the accelerometer tilt; an
attitude filter tells tilt as well. A path that contradicts either by more than both state is not written.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from swimid.inertial.aiding import GATE, REST_RATE_SD, REST_SPEED_SD, rest_nodes
from swimid.inertial.errorstate import PARTS, cross_matrix, jacobian
from swimid.inertial.record import Array, Record
from swimid.inertial.rest import Rest
from swimid.inertial.sensor import BAND, DEG
from swimid.inertial.setup import Setup
from swimid.inertial.smoother import Smoothed

#: A position is trusted while its 95 % band is narrower than this, m, or than this share of the distance
#: travelled, whichever is more.
TRUSTED_WIDTH_M, TRUSTED_SHARE = 0.1, 0.1


def contradictions(setup: Setup, smoothed: Smoothed) -> list[str]:
    """What cannot be in a smoothed motion, one sentence each; nothing where it can be."""
    record, source = setup.record, setup.source
    if not np.isfinite(smoothed.errors.mean).all():
        return ["the smoothing came to no numbers"]
    sentences = [_contradiction(record, rest, size) for rest, size in _doubted(setup, smoothed)]
    away = _tilt_between(smoothed.path.rotation, source.rotation)
    tilt = slice(PARTS["rotation"].start, PARTS["rotation"].start + 2)
    own = float(np.mean(np.trace(smoothed.errors.covariance[:, tilt, tilt], axis1=1, axis2=2)))
    off = float(np.sqrt(np.mean(away**2)))
    limit = GATE * float(np.sqrt(2 * setup.attitude_sd**2 + own))
    if off > limit:
        sentences.append(
            f"its tilt departs from that of the {source.kind} by {off / DEG:.0f} deg rms, "
            f"where {limit / DEG:.0f} deg is {GATE:g} deviations"
        )
    return sentences


def worst(setup: Setup, smoothed: Smoothed) -> tuple[Rest, str] | None:
    """The rest at which the motion is least at rest, and what speaks against it; None where all can be."""
    doubted = _doubted(setup, smoothed)
    if not doubted:
        return None
    rest, size = max(doubted, key=lambda pair: pair[1])
    return rest, _contradiction(setup.record, rest, size)


def _doubted(setup: Setup, smoothed: Smoothed) -> list[tuple[Rest, float]]:
    """Rests at which the smoothed motion is not at rest, beyond :data:`GATE` deviations."""
    sizes = [(rest, _off_rest(setup.record, smoothed, rest)) for rest in setup.still.rests]
    return [(rest, size) for rest, size in sizes if size > GATE]


def _contradiction(record: Record, rest: Rest, size: float) -> str:
    begin, end = record.time_s[rest.first], record.time_s[rest.last - 1]
    return f"the rest from {begin:.1f} to {end:.1f} s contradicts the motion by {size:.0f} deviations"


def too_fast(velocity: Array, velocity_sd: Array, top_m_s: float) -> np.ndarray:
    """Samples faster than the robot can be, shape (n,).

    Above its top speed by more than the 95 % band, or by so much that what is taken of speed (0 with half the
    top speed as deviation of each component) excludes it, however wide the band.
    """
    speed = np.linalg.norm(velocity, axis=1)
    along = np.sqrt(np.sum((velocity * velocity_sd) ** 2, axis=1)) / np.maximum(speed, 1e-9)
    return (speed - BAND * along > top_m_s) | (speed > GATE * 0.5 * top_m_s)


@dataclass(frozen=True)
class Trust:
    """When the band of a position leaves the limit."""

    #: Time on the log's clock; None where it never does.
    until_s: float | None
    #: The same, counted from the end of the rest the log starts with (or from its start).
    seconds: float | None
    #: Largest half-width of the 95 % band of the horizontal position.
    widest_m: float


def reach(time_s: Array, position: Array, position_sd: Array, moving_from_s: float) -> Trust:
    """When the horizontal 95 % band first exceeds 0.1 m and 10 % of the distance travelled.

    Parameters
    ----------
    position, position_sd : ndarray, shape (n, 3)
        Missing (NaN) counts as not to be trusted.
    moving_from_s : float
        End of the rest at the start.
    """
    half = BAND * np.max(position_sd[:, :2], axis=1)
    travelled = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(position[:, :2], axis=0).T))])
    beyond = np.flatnonzero(~(half <= np.maximum(TRUSTED_WIDTH_M, TRUSTED_SHARE * travelled)))
    widest = float(np.nanmax(half)) if np.isfinite(half).any() else np.inf
    if not len(beyond):
        return Trust(None, None, widest)
    until = float(time_s[beyond[0]])
    return Trust(until, max(until - moving_from_s, 0.0), widest)


def _off_rest(record: Record, smoothed: Smoothed, rest: Rest) -> float:
    """Largest departure from rest, of velocity, acceleration and turn rate, in deviations."""
    path, errors = smoothed.path, smoothed.errors
    nodes = rest_nodes(rest, path)
    if not len(nodes):
        return 0.0
    middle = int(nodes[len(nodes) // 2])
    covariance = errors.covariance[middle]
    variance = np.diag(covariance)
    velocity = path.velocity[rest.rows].mean(axis=0)
    moving = np.abs(velocity) / np.sqrt(variance[PARTS["velocity"]] + REST_SPEED_SD**2)
    rate = path.rate[rest.rows].mean(axis=0)
    turning = np.abs(rate) / np.sqrt(variance[PARTS["rate_bias"]] + REST_RATE_SD**2)
    duration = max(float(path.time_s[rest.last - 1] - path.time_s[rest.first]), record.step_s)
    acceleration = path.acceleration[rest.rows].mean(axis=0)
    force = path.rotation[rest.rows].apply(path.force[rest.rows]).mean(axis=0)
    turn = path.rotation[int(path.nodes[middle])].as_matrix()
    by_scale = np.kron(turn, record.acceleration[rest.rows].mean(axis=0))
    by_turn = -cross_matrix(force)
    h = jacobian(path.states, 3, rotation=by_turn, acceleration_bias=-turn, acceleration_scale=-by_scale)
    spread = np.diag(h @ covariance @ h.T) + 2 * (REST_SPEED_SD / duration) ** 2
    return float(np.max([moving, turning, np.abs(acceleration) / np.sqrt(spread)]))


def _tilt_between(one: Rotation, other: Rotation) -> Array:
    """Angle between the verticals of two attitudes, rad, shape (n,)."""
    up = [r.inv().apply([0.0, 0.0, 1.0]) for r in (one, other)]
    return np.asarray(np.arctan2(np.linalg.norm(np.cross(*up), axis=1), np.sum(up[0] * up[1], axis=1)))
