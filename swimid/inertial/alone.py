"""Motion from an inertial unit alone, and checks of the motion against attitude and rests.

The smoother uses rests and attitudes as observations. Afterwards the motion is compared with them: a rest
implies a velocity of 0 and, through the accelerometer, a tilt; an attitude filter also gives the tilt. If the
motion contradicts either by more than their uncertainty, no position or velocity is written.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from swimid.inertial import smoother
from swimid.inertial.record import Array, Finding
from swimid.inertial.setup import CLASSES, DEG, QUATERNION_SD, QUATERNIONS, Rest, Sensor, Setup
from swimid.inertial.smoother import PARTS, Nominal, Observation, Smoothed, cross_matrix, jacobian

#: Standard deviation, at the first sample, of the quantities that define the origin: position, m, and yaw,
#: rad.
ORIGIN_SD = 1e-6
#: Standard deviation of roll and pitch at the first sample, rad.
START_TILT_SD = 0.05
#: Maximum number of rest periods that are excluded one by one. If the motion still contradicts the rest
#: periods after that, all of them are excluded.
MAX_SINGLE = 2
#: Minimum increase in log-likelihood for replacing the stated class of sensor by another one: "strong"
#: evidence (Kass and Raftery 1995, doi:10.1080/01621459.1995.10476572, sec. 3.2).
MIN_GAIN = 3.0
#: Standard deviations of the velocity, m/s, and turn rate, rad/s, of a robot at rest in drifting water.
REST_SPEED_SD, REST_RATE_SD = 0.01, 5e-4
#: Correlation times of the attitude errors, s: minimum for quaternions, and value for a filter. Samples
#: within this time count as one measurement.
QUATERNION_MEMORY_S, FILTER_MEMORY_S = 10.0, 20.0
#: Maximum normalised residual, in standard deviations. Larger residuals are outliers.
GATE = 6.0
#: Interval between observations of velocity at rest, and between observations of attitude and top speed, s.
REST_STEP_S, STEP_S = 0.5, 1.0


@dataclass(frozen=True)
class Estimate:
    """Most likely motion, with the rests that it assumes."""

    smoothed: Smoothed
    #: Setup with the rests that were used.
    setup: Setup
    findings: list[Finding]
    #: Reasons why the motion is impossible; empty if it is possible.
    impossible: list[str]


def estimate(setup: Setup) -> Estimate:
    """Estimate the motion, choose the error class of the sensor, and test every rest.

    The errors of a consumer's chip are assumed if they clearly increase the likelihood of the observations.
    If the motion contradicts a rest, the rest with the largest contradiction is excluded first, then the next
    one, and finally all rests.
    """
    used, first = setup, _choose_class(setup)
    smoothed = first
    wrong = doubts = find_contradictions(setup, smoothed)
    reasons: list[str] = []
    while doubts and used.rests:
        dropped, reason = used.rests, "no rest is used"
        doubted = _doubted_rests(used, smoothed)
        if doubted and len(reasons) < MAX_SINGLE:
            rest, size = max(doubted, key=lambda pair: pair[1])
            dropped, reason = [rest], _contradiction(setup, rest, size)
        reasons.append(reason)
        used = used.without(dropped)
        smoothed = _choose_class(used)
        doubts = find_contradictions(used, smoothed)
    if doubts:
        return Estimate(first, setup, [], wrong)
    findings = class_findings(smoothed)
    if wrong:
        count = len(setup.rests)
        text = f"{'; '.join(reasons)}: {count - len(used.rests)} of {count} not used"
        findings.append(Finding("rests", "handled", text))
    return Estimate(smoothed, used, findings, [])


def class_findings(smoothed: Smoothed) -> list[Finding]:
    """Return a finding if the recording shows the errors of a class of sensor in :data:`CLASSES`."""
    names = [name for name, sensor in CLASSES.items() if sensor == smoothed.sensor]
    text = "the log shows the errors of {}; bands are made for one"
    return [Finding("sensor class", "noted", text.format(name)) for name in names]


def most_likely_class(stated: Smoothed, attempt: Callable[[Sensor], Smoothed]) -> Smoothed:
    """Return the motion with the most likely class of sensor.

    Parameters
    ----------
    stated : Smoothed
        Motion with the stated class. Another class must be more likely by ``MIN_GAIN``.
    attempt : callable
        Estimates the motion with another sensor.
    """
    best, least = stated, stated.errors.likelihood + MIN_GAIN
    for sensor in CLASSES.values():
        if sensor == stated.sensor:
            continue
        smoothed = attempt(sensor)
        if smoothed.errors.likelihood > least:
            best, least = smoothed, smoothed.errors.likelihood
    return best


def _choose_class(setup: Setup) -> Smoothed:
    stated = smooth(setup, setup.sensor)
    best = most_likely_class(stated, lambda sensor: smooth(setup, sensor, stated, 1))
    if best is not stated:
        best = smooth(setup, best.sensor, best, smoother.PASSES - 1)
    return best


def smooth(
    setup: Setup, sensor: Sensor, after: Smoothed | None = None, passes: int = smoother.PASSES
) -> Smoothed:
    """Return the most likely motion for one class of sensor; the path starts at the origin of the world.

    Parameters
    ----------
    after, passes
        See :func:`swimid.inertial.smoother.smooth`.
    """
    source, rests, top_m_s = setup.source, setup.rests, setup.options.top_speed_m_s
    yaw_sd = QUATERNION_SD if source.heading else ORIGIN_SD
    at_rest = bool(rests) and rests[0].first == 0
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
        return [*observe_alone(setup, path), *observe_speed_limit(top_m_s, path)]

    prior = smoother.Prior(source.rotation, state, sd)
    smoothed = smoother.smooth(setup.record, prior, sensor, setup.noise, observe, after=after, passes=passes)
    setup.advance()
    return smoothed


# ---------------------------------------------------------------- observations


def observe_alone(setup: Setup, path: Nominal) -> list[Observation]:
    """Return the observations of a path that need no other log."""
    return [*_rests(setup, path), *_attitudes(setup, path)]


def _rests(setup: Setup, path: Nominal) -> list[Observation]:
    """Return observations of zero velocity at rests, and of the gyroscope bias in still periods.

    The method is that of Skog et al. (2010).
    """
    record = setup.record
    observations = []
    by_velocity = jacobian(path.states, 3, velocity=np.eye(3))
    by_bias = jacobian(path.states, 3, rate_bias=np.eye(3))
    for rest in setup.still:
        nodes = rest_nodes(rest, path)
        if not len(nodes):
            continue
        if rest in setup.rests:
            for node in _spaced(path, nodes, REST_STEP_S):
                off, sd = -path.velocity[path.nodes[node]], np.full(3, REST_SPEED_SD)
                observations.append(Observation(int(node), "rest", off, by_velocity, sd))
        duration = path.time_s[rest.last - 1] - path.time_s[rest.first]
        middle = int(nodes[len(nodes) // 2])
        off = record.rate[rest.rows].mean(axis=0) - path.rate_bias[path.nodes[middle]]
        rate_sd = setup.noise.rate_rad_s_per_rt_hz / np.sqrt(max(duration, record.step_s))
        sd = np.full(3, np.hypot(rate_sd, REST_RATE_SD))
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


def rest_nodes(rest: Rest, path: Nominal) -> np.ndarray:
    """Return the indices of the nodes of a path that lie within a rest."""
    return np.flatnonzero((path.nodes >= rest.first) & (path.nodes < rest.last))


def _spaced(path: Nominal, nodes: np.ndarray, step_s: float) -> np.ndarray:
    """Return a subset of the nodes, at least ``step_s`` apart."""
    times = path.node_s[nodes]
    marks = np.arange(times[0], times[-1] + 1e-9, step_s)
    return nodes[np.unique(np.clip(np.searchsorted(times, marks), 0, len(nodes) - 1))]


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
    sizes = [(rest, _departure(setup, smoothed, rest)) for rest in setup.rests]
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
