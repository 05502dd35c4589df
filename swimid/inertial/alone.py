"""Motion from an inertial unit alone, and what its user declares."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from swimid.inertial import aiding, plausible, smoother
from swimid.inertial.errorstate import Observation
from swimid.inertial.record import Finding
from swimid.inertial.sensor import QUATERNION_SD, Sensor
from swimid.inertial.setup import Setup, Stillness
from swimid.inertial.smoother import Nominal, Prior, Smoothed, State

#: At the first sample, deviations: place, m, and the zero of yaw, rad; roll and pitch of a filter, rad.
ZERO_SD, START_TILT_SD = 1e-6, 0.05
#: A sensor of another class is believed when the log of the likelihoods' ratio exceeds this: "strong"
#: evidence (Kass and Raftery 1995, doi:10.1080/01621459.1995.10476572, sec. 3.2).
STRONG = 3.0
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
    wrong = doubts = plausible.contradictions(setup, smoothed)
    reasons: list[str] = []
    for dropped in range(1, MOST_DROPPED + 1):
        if not doubts or not believed.still.rests:
            break
        worst = plausible.worst(believed, smoothed)
        if worst is None or dropped == MOST_DROPPED:
            reasons.append("no rest is used")
            believed = believed.without(believed.still.rests)
        else:
            rest, reason = worst
            reasons.append(reason)
            believed = believed.without([rest])
        smoothed, sensor = _by_class(believed)
        doubts = plausible.contradictions(believed, smoothed)
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
        if gain > (STRONG if best is stated else 0.0):
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
    state = State(
        rotation=source.rotation[0], rate_bias=setup.still_rate, lever=setup.lever(mount), mount=mount
    )
    sd = {
        "position": ZERO_SD,
        "velocity": aiding.REST_SPEED_SD if at_rest else 0.5 * top_m_s,
        "rotation": (START_TILT_SD, START_TILT_SD, yaw_sd),
    }

    def observe(path: Nominal) -> list[Observation]:
        return [*aiding.known(setup, path), *aiding.speed_limit(top_m_s, path)]

    prior = Prior(source.rotation, state, sd)
    smoothed = smoother.smooth(setup.record, prior, sensor, still.noise, observe, after=after, passes=passes)
    setup.advance()
    return smoothed
