"""Motion from an inertial unit alone, and what its user declares."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from swimid.inertial import aiding, attitude, plausible, smoother
from swimid.inertial import rest as resting
from swimid.inertial.attitude import QUATERNIONS, Source, still_rate
from swimid.inertial.faults.base import Finding
from swimid.inertial.mounting import Mount
from swimid.inertial.record import Array, Record
from swimid.inertial.rest import Noise, Rest
from swimid.inertial.sensor import (
    FILTER_SD,
    QUATERNION_SD,
    SHEET_ACCELERATION_NOISE,
    SHEET_RATE_NOISE,
    Sensor,
)
from swimid.inertial.smoother import Aid, Mounting, Smoothed, Start

#: Which found rests count as rests of the body and not only of its noise.
RestUse = Literal["ends", "all", "none"]
#: Axes whose mean may be declared to be 0.
MEANS = {"sway": 1, "heave": 2}
#: Speed no swimming robot of the kind exceeds unless its user says so, m/s.
TOP_SPEED_M_S = 2.0
#: Roll, pitch and yaw at the first sample, deviation, rad: of a filter's tilt, of the zero of yaw.
START_TILT_SD, YAW_ZERO_SD = 0.05, 1e-6
#: A sensor of another class is believed when the log of the likelihoods' ratio exceeds this: "strong"
#: evidence (Kass and Raftery 1995, doi:10.1080/01621459.1995.10476572, sec. 3.2).
STRONG = 3.0
#: Turns of leaving rests out; the last leaves out all.
MOST_DROPPED = 3


@dataclass(frozen=True)
class Declared:
    """What the user says of the motion.

    Attributes
    ----------
    still : list of (float, float)
        Times between which the body is at rest, s.
    rests : str
        ``ends``: found rests at the start and end of the log are rests of the body; ``all``: every one;
        ``none``: they only tell biases and noise.
    zero_mean : tuple of str
        ``sway``, ``heave``: body velocities whose mean over a window is 0.
    window_s, mean_sd : float
        Length of that window, s, and how far the mean may be from 0, m/s.
    top_speed_m_s : float
        Speed the robot never exceeds, m/s.
    lever_m : ndarray, shape (3,)
        The sensor's place seen from the reference point, body axes, m.
    """

    still: list[tuple[float, float]] = field(default_factory=list)
    rests: RestUse = "ends"
    zero_mean: tuple[str, ...] = ()
    window_s: float = 2.0
    mean_sd: float = 0.02
    top_speed_m_s: float = TOP_SPEED_M_S
    lever_m: Array | None = None


@dataclass(frozen=True)
class Stillness:
    """Still stretches, which of them are rests, and the noise they tell."""

    found: list[Rest]
    used: list[Rest]
    noise: Noise


@dataclass(frozen=True)
class Judged:
    """The likeliest motion that can be.

    Attributes
    ----------
    smoothed : Smoothed
    still : Stillness
        With the rests that were believed.
    sensor : Sensor
        With the errors the log shows it to have.
    findings : list of Finding
    impossible : list of str
        Why none of it can be; empty where it can.
    """

    smoothed: Smoothed
    still: Stillness
    sensor: Sensor
    findings: list[Finding]
    impossible: list[str]


def stillness(record: Record, sensor: Sensor, declared: Declared) -> Stillness:
    """Find still stretches and decide which are rests."""
    found = resting.find(record)
    named = resting.declared(record, declared.still)
    ends = {"ends": ("start", "end"), "all": ("start", "between", "end"), "none": ()}[declared.rests]
    free = [r for r in found if not any(r.first < d.last and d.first < r.last for d in named)]
    used = sorted([*named, *(r for r in free if r.at in ends)], key=lambda r: r.first)
    still = sorted([*named, *free], key=lambda r: r.first)
    told = resting.noise(record, still)
    sheet = Noise(SHEET_ACCELERATION_NOISE, SHEET_RATE_NOISE, "data sheet")
    base = told or sheet
    given = sensor.acceleration_noise is not None or sensor.rate_noise is not None
    noise = Noise(
        base.acceleration if sensor.acceleration_noise is None else sensor.acceleration_noise,
        base.rate if sensor.rate_noise is None else sensor.rate_noise,
        "given" if given else base.source,
    )
    return Stillness(still, used, noise)


def lever_to_reference(mount: Mount, declared: Declared) -> Array:
    """From the sensor to the reference point, sensor axes, m, shape (3,)."""
    if declared.lever_m is None:
        return np.zeros(3)
    return np.asarray(mount.rotation.apply(-np.asarray(declared.lever_m, dtype=float)))


def common_aids(
    record: Record, source: Source, still: Stillness, sensor: Sensor, declared: Declared
) -> list[Aid]:
    """Everything known without another log."""
    only_still = [r for r in still.found if r not in still.used]
    sd = attitude_sd(source, sensor)
    return [
        aiding.rests(record, still.used, still.noise),
        aiding.biases(record, only_still, still.noise),
        aiding.attitudes(source, sd),
        *(aiding.zero_mean(MEANS[name], declared.window_s, declared.mean_sd) for name in declared.zero_mean),
    ]


def attitude_sd(source: Source, sensor: Sensor) -> float:
    """Deviation of the attitude before smoothing, rad."""
    return sensor.attitude_sd or (QUATERNION_SD if source.kind == QUATERNIONS else FILTER_SD)


def judged(
    record: Record,
    source: Source,
    still: Stillness,
    mount: Mount,
    sensor: Sensor,
    declared: Declared,
    *,
    advance: Callable[[], None] = lambda: None,
) -> Judged:
    """The likeliest motion, with the class of the sensor taken from the log and every rest tested.

    The errors of a better class come first; those of a consumer's chip are taken where they make the
    observations clearly likelier. The rest that contradicts the motion worst is left out, then the next, at
    last all of them.
    """
    sd, believed = attitude_sd(source, sensor), still
    whole = run_by_class(record, source, still, mount, sensor, declared, advance=advance)
    wrong = plausible.contradictions(record, whole[0], still.used, source, sd)
    attempt, doubts, said = whole, wrong, []
    for dropped in range(1, MOST_DROPPED + 1):
        if not doubts or not believed.used:
            break
        worst = plausible.worst(record, attempt[0], believed.used)
        if worst is None or dropped == MOST_DROPPED:
            said.append("no rest is used")
            believed = without(believed, believed.used)
        else:
            said.append(plausible.doubt(record, attempt[0], worst))
            believed = without(believed, [worst])
        if source.kind != QUATERNIONS:
            source = attitude.estimate(record, believed.found)
        attempt = run_by_class(record, source, believed, mount, sensor, declared, advance=advance)
        doubts = plausible.contradictions(record, attempt[0], believed.used, source, sd)
    if doubts:
        return Judged(whole[0], still, whole[1], [], wrong)
    findings = shown_class(sensor, attempt[1])
    if wrong:
        text = f"{'; '.join(said)}: {len(still.used) - len(believed.used)} of {len(still.used)} not used"
        findings.append(Finding("rests", "handled", text))
    return Judged(attempt[0], believed, attempt[1], findings, [])


def shown_class(stated: Sensor, shown: Sensor) -> list[Finding]:
    """What is said where a log shows the errors of another class of sensor."""
    names = [name for name, other in stated.classes().items() if other == shown != stated]
    return [
        Finding("sensor class", "noted", f"the log shows the errors of {name}; bands are made for one")
        for name in names[:1]
    ]


def without(still: Stillness, rests: list[Rest]) -> Stillness:
    """Stillness less some rests, which tell nothing then."""
    return replace(
        still,
        found=[r for r in still.found if r not in rests],
        used=[r for r in still.used if r not in rests],
    )


def run_by_class(
    record: Record,
    source: Source,
    still: Stillness,
    mount: Mount,
    sensor: Sensor,
    declared: Declared,
    *,
    advance: Callable[[], None] = lambda: None,
) -> tuple[Smoothed, Sensor]:
    """The likeliest motion, and the class of its sensor: another where that is clearly likelier."""

    def likeliest(sensor: Sensor, after: Smoothed | None, passes: int) -> Smoothed:
        return run(
            record, source, still, mount, sensor, declared, after=after, passes=passes, advance=advance
        )

    stated = likeliest(sensor, None, smoother.PASSES)
    others = [(likeliest(other, stated, 1), other) for other in sensor.classes().values() if other != sensor]
    best, shown = max(others, key=lambda pair: pair[0].errors.likelihood, default=(stated, sensor))
    if best.errors.likelihood <= stated.errors.likelihood + STRONG:
        return stated, sensor
    return likeliest(shown, best, smoother.PASSES - 1), shown


def run(
    record: Record,
    source: Source,
    still: Stillness,
    mount: Mount,
    sensor: Sensor,
    declared: Declared,
    *,
    after: Smoothed | None = None,
    passes: int = smoother.PASSES,
    advance: Callable[[], None] = lambda: None,
) -> Smoothed:
    """The likeliest motion, from the origin of the world."""
    at_rest = bool(still.used) and still.used[0].first == 0
    yaw_sd = (sensor.attitude_sd or QUATERNION_SD) if source.heading else YAW_ZERO_SD
    start = Start(
        source.rotation,
        velocity_sd=aiding.REST_SPEED_SD if at_rest else 0.5 * declared.top_speed_m_s,
        rotation_sd=(START_TILT_SD, START_TILT_SD, yaw_sd),
        rate_bias=still_rate(record, still.found),
    )
    mounting = Mounting(mount.rotation, lever_to_reference(mount, declared))
    aids = [
        *common_aids(record, source, still, sensor, declared),
        aiding.speed_limit(declared.top_speed_m_s),
    ]
    return smoother.run(
        record,
        start,
        mounting,
        sensor,
        still.noise,
        aids,
        after=after,
        passes=passes,
        advance=advance,
    )
