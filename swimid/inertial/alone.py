"""Motion from an inertial unit alone, and whether a smoothed motion can be (attitude, rests).

A correction is tested against what it changes. A rest tells velocity, and through the accelerometer tilt; an
attitude filter tells tilt as well. A path that contradicts either by more than both state is not written.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from swimid.inertial import aiding, smoother
from swimid.inertial.aiding import GATE, REST_RATE_SD, REST_SPEED_SD, rest_nodes
from swimid.inertial.record import Array, Finding, Record
from swimid.inertial.setup import DEG, QUATERNION_SD, Rest, Sensor, Setup, Stillness
from swimid.inertial.smoother import PARTS, Nominal, Observation, Smoothed, cross_matrix, jacobian

#: At the first sample, deviations: place, m, and the zero of yaw, rad; roll and pitch of a filter, rad.
ZERO_SD, START_TILT_SD = 1e-6, 0.05
#: Turns of leaving rests out; the last leaves out all.
MOST_DROPPED = 3


@dataclass(frozen=True)
class Estimate:
    """The likeliest motion."""

    smoothed: Smoothed
    #: With the rests that were believed.
    still: Stillness
    #: With the errors the log shows it to have.
    sensor: Sensor
    findings: list[Finding]
    #: Why none of it can be; empty where it can.
    impossible: list[str]


def estimate(setup: Setup) -> Estimate:
    """The likeliest motion, with the class of the sensor taken from the log and every rest tested.

    The errors of a better class come first; those of a consumer's chip are taken where they make the
    observations clearly likelier. The rest that contradicts the motion worst is left out, then the next, at
    last all of them.
    """
    believed, (smoothed, sensor) = setup, _by_class(setup)
    whole = smoothed, sensor
    wrong = doubts = contradictions(setup, smoothed)
    reasons: list[str] = []
    for dropped in range(1, MOST_DROPPED + 1):
        if not doubts or not believed.still.rests:
            break
        worst = _least_at_rest(believed, smoothed)
        if worst is None or dropped == MOST_DROPPED:
            reasons.append("no rest is used")
            believed = believed.without(believed.still.rests)
        else:
            rest, reason = worst
            reasons.append(reason)
            believed = believed.without([rest])
        smoothed, sensor = _by_class(believed)
        doubts = contradictions(believed, smoothed)
    if doubts:
        return Estimate(whole[0], setup.still, whole[1], [], wrong)
    findings = shown_class(setup.sensor, sensor)
    if wrong:
        all_rests, used = len(setup.still.rests), len(believed.still.rests)
        text = f"{'; '.join(reasons)}: {all_rests - used} of {all_rests} not used"
        findings.append(Finding("rests", "handled", text))
    return Estimate(smoothed, believed.still, sensor, findings, [])


def shown_class(stated: Sensor, shown: Sensor) -> list[Finding]:
    """What is said where a log shows the errors of another class of sensor."""
    names = [name for name, other in stated.classes().items() if other == shown != stated]
    return [
        Finding("sensor class", "noted", f"the log shows the errors of {name}; bands are made for one")
        for name in names[:1]
    ]


def likeliest_class(
    stated: Smoothed, sensor: Sensor, attempt: Callable[[Sensor], Smoothed]
) -> tuple[Smoothed, Sensor]:
    """The likeliest motion, and the class of its sensor: another where that is clearly likelier."""
    best, shown = stated, sensor
    for other in sensor.classes().values():
        if other == sensor:
            continue
        smoothed = attempt(other)
        gain = smoothed.errors.likelihood - best.errors.likelihood
        # A sensor of another class is believed when the log of the likelihoods' ratio exceeds this: "strong"
        # evidence (Kass and Raftery 1995, doi:10.1080/01621459.1995.10476572, sec. 3.2).
        if gain > (3.0 if best is stated else 0.0):
            best, shown = smoothed, other
    return best, shown


def _by_class(setup: Setup) -> tuple[Smoothed, Sensor]:
    stated = smooth(setup, setup.sensor)
    best, shown = likeliest_class(stated, setup.sensor, lambda other: smooth(setup, other, stated, 1))
    return (best, shown) if best is stated else (smooth(setup, shown, best, smoother.PASSES - 1), shown)


def smooth(
    setup: Setup, sensor: Sensor, after: Smoothed | None = None, passes: int = smoother.PASSES
) -> Smoothed:
    """The likeliest motion for a class of sensor, from the origin of the world."""
    source, still, top_m_s = setup.source, setup.still, setup.options.top_speed_m_s
    at_rest = bool(still.rests) and still.rests[0].first == 0
    yaw_sd = (sensor.attitude_sd or QUATERNION_SD) if source.heading else ZERO_SD
    mount = setup.mount.rotation
    state = smoother.State(
        rotation=source.rotation[0], rate_bias=setup.still_rate, lever=setup.lever(mount), mount=mount
    )
    sd = {
        "position": ZERO_SD,
        "velocity": aiding.REST_SPEED_SD if at_rest else 0.5 * top_m_s,
        "rotation": (START_TILT_SD, START_TILT_SD, yaw_sd),
    }

    def observe(path: Nominal) -> list[Observation]:
        return [*aiding.known(setup, path), *aiding.speed_limit(top_m_s, path)]

    prior = smoother.Prior(source.rotation, state, sd)
    smoothed = smoother.smooth(setup.record, prior, sensor, still.noise, observe, after=after, passes=passes)
    setup.advance()
    return smoothed


# ---------------------------------------------------------------- whether it can be


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


def _least_at_rest(setup: Setup, smoothed: Smoothed) -> tuple[Rest, str] | None:
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
