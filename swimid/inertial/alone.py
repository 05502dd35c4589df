"""Motion from an inertial unit alone, and checks of the motion against attitude and rests.

The smoother uses rests and attitudes as observations. Afterwards the motion is compared with them: a rest
implies a velocity of 0 and, through the accelerometer, a tilt; an attitude filter also gives the tilt. If the
motion contradicts either by more than their uncertainty, no position or velocity is written.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from swimid.inertial import aiding, smoother
from swimid.inertial.aiding import GATE, REST_RATE_SD, REST_SPEED_SD, rest_nodes
from swimid.inertial.record import Array, Finding
from swimid.inertial.setup import DEG, QUATERNION_SD, Rest, Sensor, Setup, Stillness
from swimid.inertial.smoother import PARTS, Nominal, Observation, Smoothed, cross_matrix, jacobian

#: Standard deviation, at the first sample, of the quantities that define the origin: position, m, and yaw,
#: rad.
ORIGIN_SD = 1e-6
#: Standard deviation of roll and pitch at the first sample, rad.
START_TILT_SD = 0.05
#: Maximum number of iterations that exclude rests. The last iteration excludes all rests.
MAX_STEPS = 3
#: Minimum increase in log-likelihood for replacing the stated class of sensor by another one: "strong"
#: evidence (Kass and Raftery 1995, doi:10.1080/01621459.1995.10476572, sec. 3.2).
MIN_GAIN = 3.0


@dataclass(frozen=True)
class Estimate:
    """Most likely motion, with the sensor errors and rests that it assumes."""

    smoothed: Smoothed
    #: Still periods, with the rests that were used.
    still: Stillness
    #: Sensor with the error class that is most likely for this recording.
    sensor: Sensor
    findings: list[Finding]
    #: Reasons why the motion is impossible; empty if it is possible.
    impossible: list[str]


def estimate(setup: Setup) -> Estimate:
    """Estimate the motion, choose the error class of the sensor, and test every rest.

    The errors of a consumer's chip are assumed if they clearly increase the likelihood of the observations.
    If the motion contradicts a rest, the rest with the largest contradiction is excluded first, then the next
    one, and finally all rests.
    """
    used, (smoothed, sensor) = setup, _choose_class(setup)
    first = smoothed, sensor
    wrong = doubts = find_contradictions(setup, smoothed)
    reasons: list[str] = []
    for step in range(1, MAX_STEPS + 1):
        if not doubts or not used.still.rests:
            break
        doubted = _doubted_rests(used, smoothed)
        if doubted and step < MAX_STEPS:
            rest, size = max(doubted, key=lambda pair: pair[1])
            reasons.append(_contradiction(setup, rest, size))
            used = used.without([rest])
        else:
            reasons.append("no rest is used")
            used = used.without(used.still.rests)
        smoothed, sensor = _choose_class(used)
        doubts = find_contradictions(used, smoothed)
    if doubts:
        return Estimate(first[0], setup.still, first[1], [], wrong)
    findings = class_findings(setup.sensor, sensor)
    if wrong:
        count = len(setup.still.rests)
        text = f"{'; '.join(reasons)}: {count - len(used.still.rests)} of {count} not used"
        findings.append(Finding("rests", "handled", text))
    return Estimate(smoothed, used.still, sensor, findings, [])


def class_findings(stated: Sensor, shown: Sensor) -> list[Finding]:
    """Return a finding if the recording shows the errors of another class of sensor than the stated one."""
    names = [name for name, other in stated.classes().items() if other == shown != stated]
    text = "the log shows the errors of {}; bands are made for one"
    return [Finding("sensor class", "noted", text.format(name)) for name in names[:1]]


def most_likely_class(
    stated: Smoothed, sensor: Sensor, attempt: Callable[[Sensor], Smoothed]
) -> tuple[Smoothed, Sensor]:
    """Return the most likely motion and the corresponding class of sensor.

    Parameters
    ----------
    stated : Smoothed
        Motion with the stated class. Another class must be more likely by ``MIN_GAIN``.
    sensor : Sensor
        Sensor of the stated class.
    attempt : callable
        Estimates the motion with another sensor.
    """
    best, shown = stated, sensor
    for other in sensor.classes().values():
        if other == sensor:
            continue
        smoothed = attempt(other)
        least = MIN_GAIN if best is stated else 0.0
        if smoothed.errors.likelihood - best.errors.likelihood > least:
            best, shown = smoothed, other
    return best, shown


def _choose_class(setup: Setup) -> tuple[Smoothed, Sensor]:
    stated = smooth(setup, setup.sensor)
    best, shown = most_likely_class(stated, setup.sensor, lambda other: smooth(setup, other, stated, 1))
    if best is not stated:
        best = smooth(setup, shown, best, smoother.PASSES - 1)
    return best, shown


def smooth(
    setup: Setup, sensor: Sensor, after: Smoothed | None = None, passes: int = smoother.PASSES
) -> Smoothed:
    """Return the most likely motion for one class of sensor; the path starts at the origin of the world.

    Parameters
    ----------
    after, passes
        See :func:`swimid.inertial.smoother.smooth`.
    """
    source, still, top_m_s = setup.source, setup.still, setup.options.top_speed_m_s
    yaw_sd = ORIGIN_SD
    if source.heading:
        stated = setup.options.attitude_sd_deg
        yaw_sd = QUATERNION_SD if stated is None else stated * DEG
    at_rest = bool(still.rests) and still.rests[0].first == 0
    mount = setup.mount.rotation
    state = smoother.State(
        rotation=source.rotation[0], rate_bias=setup.still_rate, lever=setup.lever(mount), mount=mount
    )
    sd = {
        "position": ORIGIN_SD,
        "velocity": REST_SPEED_SD if at_rest else 0.5 * top_m_s,
        "rotation": (START_TILT_SD, START_TILT_SD, yaw_sd),
    }

    def observe(path: Nominal) -> list[Observation]:
        return [*aiding.observe_alone(setup, path), *aiding.observe_speed_limit(top_m_s, path)]

    prior = smoother.Prior(source.rotation, state, sd)
    smoothed = smoother.smooth(setup.record, prior, sensor, still.noise, observe, after=after, passes=passes)
    setup.advance()
    return smoothed


# ---------------------------------------------------------------- contradictions


def find_contradictions(setup: Setup, smoothed: Smoothed) -> list[str]:
    """Return the contradictions of a motion with rests and attitude, one sentence each."""
    if not np.isfinite(smoothed.errors.mean).all():
        return ["the smoothing has no finite result"]
    sentences = [_contradiction(setup, rest, size) for rest, size in _doubted_rests(setup, smoothed)]
    up, other = (r.inv().apply([0.0, 0.0, 1.0]) for r in (smoothed.path.rotation, setup.source.rotation))
    away = np.arctan2(np.linalg.norm(np.cross(up, other), axis=1), np.sum(up * other, axis=1))
    tilt = slice(PARTS["rotation"].start, PARTS["rotation"].start + 2)
    own = float(np.mean(np.trace(smoothed.errors.covariance[:, tilt, tilt], axis1=1, axis2=2)))
    off = float(np.sqrt(np.mean(away**2)))
    limit = GATE * float(np.sqrt(2 * setup.attitude_sd**2 + own))
    if off > limit:
        sentences.append(
            f"its tilt departs from that of the {setup.source.kind} by {off / DEG:.0f} deg rms, "
            f"where {limit / DEG:.0f} deg is {GATE:g} deviations"
        )
    return sentences


def _doubted_rests(setup: Setup, smoothed: Smoothed) -> list[tuple[Rest, float]]:
    """Return the rests that the motion contradicts by more than ``GATE``, each with its contradiction."""
    sizes = [(rest, _departure(setup, smoothed, rest)) for rest in setup.still.rests]
    return [(rest, size) for rest, size in sizes if size > GATE]


def _contradiction(setup: Setup, rest: Rest, size: float) -> str:
    begin, end = setup.record.time_s[[rest.first, rest.last - 1]]
    return f"the rest from {begin:.1f} to {end:.1f} s contradicts the motion by {size:.0f} deviations"


def _departure(setup: Setup, smoothed: Smoothed, rest: Rest) -> float:
    """Return the largest difference between the motion and a robot at rest, in standard deviations."""
    record, path, errors = setup.record, smoothed.path, smoothed.errors
    nodes = rest_nodes(rest, path)
    if not len(nodes):
        return 0.0
    middle = int(nodes[len(nodes) // 2])
    covariance = errors.covariance[middle]
    variance = np.diag(covariance)

    def mean(values: Array) -> Array:
        return np.asarray(values[rest.rows].mean(axis=0))

    moving = np.abs(mean(path.velocity)) / np.sqrt(variance[PARTS["velocity"]] + REST_SPEED_SD**2)
    turning = np.abs(mean(path.rate)) / np.sqrt(variance[PARTS["rate_bias"]] + REST_RATE_SD**2)
    duration = max(float(path.time_s[rest.last - 1] - path.time_s[rest.first]), record.step_s)
    force = path.rotation[rest.rows].apply(path.force[rest.rows]).mean(axis=0)
    turn = path.rotation[int(path.nodes[middle])].as_matrix()
    h = jacobian(
        path.states,
        3,
        rotation=-cross_matrix(force),
        acceleration_bias=-turn,
        acceleration_scale=-np.kron(turn, mean(record.acceleration)),
    )
    spread = np.diag(h @ covariance @ h.T) + 2 * (REST_SPEED_SD / duration) ** 2
    return float(np.max([moving, turning, np.abs(mean(path.acceleration)) / np.sqrt(spread)]))
