"""Diagnoses made by hand, one for every verdict, to try the gap file and its report on."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from pydantic import BaseModel

from swimid.diagnosis import evidence as diagnose_evidence
from swimid.diagnosis.gap_file import (
    Absorbed,
    Advice,
    Cause,
    Cell,
    ChangedValue,
    ChannelGap,
    Closed,
    EffectRow,
    Facts,
    GapFile,
    HeldOutTrial,
    Proposed,
    Remaining,
    Shrinkage,
    Value,
    WaterfallStep,
    Where,
)
from swimid.diagnosis.held_out import HeldOutSeries
from swimid.fitting import fit_common
from swimid.fitting.model import Trial
from swimid.results import evidence as ev
from swimid.simulation.compare_series import ChannelScore

Part = TypeVar("Part", bound=BaseModel)

TRIALS = [f"f{f}a{a}" for f in (10, 14, 18) for a in (15, 20, 30)]
_CHANNELS = ["u_m_s", "yaw_rate_rad_s", "joint4_rad"]
_STAGES = ["actuation", "structure", "fluid", "environment", "sensing"]
_NAN = float("nan")


def replace(part: Part, **changes: Any) -> Part:
    """A gap file, or a part of one, with some of it changed."""
    return type(part)(**{**dict(part), **changes})


def number(value: float, stderr: float | None, unit: str, status: str = "estimated") -> Value:
    """An estimate."""
    return Value(value=value, stderr=stderr, unit=unit, status=status)  # type: ignore[arg-type]


def absorbed(name: str, given: Value | None, without: Value, with_effect: Value) -> Absorbed:
    """A coefficient without and with the causes."""
    return Absorbed(coefficient=name, given=given, without=without, with_effect=with_effect)


def held_out(
    *after: float, before: float = 1700.0, as_given: float | None = None, samples: int = 100
) -> dict[str, HeldOutTrial]:
    """Return held-out trials with given squared errors with the causes.

    A correct model has the error 100 in each of them, and at most 170. The noise is independent, and the
    parameters are certain, so that a deviance decreases as much as a squared error.
    """
    given = before if as_given is None else as_given
    return {
        TRIALS[k]: HeldOutTrial(
            samples=samples,
            as_given=given,
            before=before,
            after=value,
            expected=100.0,
            limit=170.0,
            gain=before - value,
            gain_as_given=given - value,
        )
        for k, value in enumerate(after)
    }


def facts(
    *proposed: str, no_gap: float = 0.001, outside: float = 0.03, after: float = 160.0, **more: Any
) -> Facts:
    """Facts from which a verdict follows.

    They have three held-out trials, which a model with the causes, or without a gap, predicts well.
    """
    held = held_out(after + 1.0, after, after - 1.0, as_given=5400.0)
    if not proposed:
        held = held_out(101.0, 99.0, 100.0, before=100.0, as_given=110.0)
    known: dict[str, Any] = {
        "no_gap": no_gap,
        "outside": outside,
        "catalogue": 1.0 - no_gap - outside,
        "proposed": {name: Proposed(alone=0.95) for name in proposed},
        "held_out": held,
    }
    return Facts(**{**known, **more})


def _shrinkage(
    channel: str, before: float, after: float, shipped: float, floor: float, closed: float
) -> Shrinkage:
    return Shrinkage(channel=channel, before=before, after=after, shipped=shipped, floor=floor, closed=closed)


def _channel(channel: str, unit: str, nrmse: float, floor: float, share: float, rmse: float) -> ChannelGap:
    return ChannelGap(channel=channel, unit=unit, nrmse=nrmse, floor=floor, share=share, rmse=rmse)


def _step(label: str, squared: float, u: float, rate: float, joint: float) -> WaterfallStep:
    rmse = dict(zip(_CHANNELS, (u, rate, joint), strict=True))
    return WaterfallStep(label=label, squared=squared, rmse=rmse)


def _cell(kind: str, label: str, ratio: float, share: float) -> Cell:
    return Cell(kind=kind, label=label, ratio=ratio, share=share)


def _remaining(share: float, where: str, white: bool) -> Remaining:
    return Remaining(share=share, where=where, white=white)


BACKLASH = Cause(
    effect="servo-backlash",
    stage="actuation",
    meaning="Play between the servo and the joint.",
    sources=["boxfish, section 4.2"],
    probability=0.94,
    equivalent=[],
    parameters={"backlash_rad": number(0.0351234, 0.00212, "rad")},
    shrinkage=[
        _shrinkage("yaw_rate_rad_s", 0.061, 0.032, 0.088, 0.030, 0.955),
        _shrinkage("u_m_s", 0.142, 0.034, 0.190, 0.021, 0.963),
        _shrinkage("joint4_rad", 0.020, 0.021, 0.030, 0.020, _NAN),
    ],
    gain=3062.4,
    gain_stderr=410.0,
    absorbed=[
        absorbed("c_d0", number(0.70, 0.03, "1"), number(0.92, 0.02, "1"), number(0.71, 0.03, "1")),
        absorbed("c_ma", None, number(1.02, 0.05, "1"), number(1.01, 0.05, "1")),
        absorbed("c_f4", None, number(2.0, None, "1", "at-bound"), number(1.9, 0.1, "1")),
    ],
)

CURRENT = replace(
    BACKLASH,
    effect="current",
    stage="environment",
    meaning="The water moves.",
    sources=[],
    probability=0.81,
    equivalent=["tether", "linear-drag"],
    parameters={"east_m_s": number(0.012, 0.002, "m/s"), "north_m_s": number(-0.1, None, "m/s", "at-bound")},
    gain=812.0,
    gain_stderr=150.0,
)


#: Another reading of the robot has no numbers.
READING = replace(
    BACKLASH,
    effect="reading:drag_point=strips",
    stage="fluid",
    meaning='Another answer to "Where on a link is its speed taken?": spread evenly along each link.',
    sources=[],
    parameters={},
)


def _scores(first: str = "servo-backlash") -> list[EffectRow]:
    rng = np.random.default_rng(5)
    names = {
        "servo-backlash": "actuation",
        "amplitude-loss": "actuation",
        "joint-locked": "structure",
        "linear-drag": "fluid",
        "current": "environment",
        "tether": "environment",
        "time-offset": "sensing",
        "imu-bias": "sensing",
    }
    if first not in names:
        names[first] = "fluid"
    scores = [
        EffectRow(
            effect=name,
            stage=stage,  # type: ignore[arg-type]
            variant="joint 2" if name == "joint-locked" else "",
            gain=gain,
            stderr=0.3 * abs(gain) + 5,
            absorbed=0.3,
            probability=0.01,
        )
        for (name, stage), gain in zip(names.items(), rng.uniform(-40, 400, len(names)), strict=True)
    ]
    scores = [
        replace(s, gain=3062.4, stderr=410.0, probability=0.94) if s.effect == first else s for s in scores
    ]
    weak = EffectRow(
        effect="wall", stage="environment", variant="+x", gain=None, absorbed=0.97, probability=0.0
    )
    return [weak, *scores]


def worst() -> list[HeldOutSeries]:
    """A held-out trial of two channels."""
    rng = np.random.default_rng(7)
    time = np.arange(0.0, 10.0, 0.02)
    trial = Trial("f10a15", "fit", time, {})
    found = []
    for channel in ("u_m_s", "yaw_rate_rad_s"):
        after = 0.2 * (1 - np.exp(-time)) + 0.05 * np.sin(9 * time)
        before = after * 1.15
        measured = after + rng.normal(0, 0.01, len(time))
        found.append(HeldOutSeries(trial, channel, time, measured, before, after))
    return found


EXPLAINED = GapFile(
    verdict="explained",
    where=Where(
        channels=[
            _channel("joint4_rad", "rad", 0.020, 0.020, 0.0, 0.003),
            _channel("yaw_rate_rad_s", "rad/s", 0.061, 0.030, 0.29, 0.09),
            _channel("u_m_s", "m/s", 0.142, 0.021, 0.71, 0.031),
        ],
        stage={"actuation": 0.95, "structure": 0.03, "fluid": 0.02, "environment": 0.0, "sensing": 0.0},
        phase=[_cell("phase", f"{30 * k}-{30 * k + 30}°", 1.5 + np.sin(k), 1 / 12) for k in range(12)],
        regime=[
            _cell("frequency", "1.0 Hz", 1.3, 0.1),
            _cell("frequency", "1.4 Hz", 3.1, 0.3),
            _cell("frequency", "1.8 Hz", 6.2, 0.6),
            _cell("amplitude", "15°", 6.0, 0.7),
            _cell("amplitude", "30°", 2.0, 0.3),
        ],
        time=[_cell("time", "start-up", 5.0, 0.6), _cell("time", "steady", 2.2, 0.4)],
    ),
    waterfall=[
        _step("as given", 54.0, 0.042, 0.130, 0.0045),
        _step("refitted", 17.0, 0.031, 0.090, 0.0030),
        _step("+ servo-backlash", 1.6, 0.0074, 0.047, 0.0031),
        _step("noise alone", 1.0, 0.0046, 0.044, 0.0030),
    ],
    closed=Closed(
        before=54.0,
        refitted=17.0,
        after=1.6,
        share=52.4 / 53.0,
        ci95=(0.971, 0.995),
        by_refit=37.0 / 53.0,
        by_causes=15.4 / 16.0,
    ),
    causes=[BACKLASH],
    remaining=_remaining(0.04, "mostly in yaw_rate_rad_s", True),
    advice=[
        Advice(
            text="Swim at 1.0 Hz with 10 deg for 15 s: play takes the largest share of the smallest stroke.",
            separates=["servo-backlash", "amplitude-loss"],
            difference=41.0,
            now=12.0,
        )
    ],
    model="multilink",
    robot="tfish",
    experiment="free-swim",
    params="tfish.yaml",
    trials=TRIALS,
    scores=_scores(),
    facts=facts("servo-backlash"),
    held_out="trials",
    floor_from="the residuals of each trial with own parameters and smooth terms",
    reasons=["One effect gains far more than noise and than any other."],
    provenance={"command": "swimid diagnose trials.yaml", "version": "0", "created": "2026-01-02"},
)

# the others have less to draw: a page of every verdict is drawn in the tests
_BRIEF = replace(
    EXPLAINED,
    where=replace(EXPLAINED.where, phase=EXPLAINED.where.phase[:1], regime=EXPLAINED.where.regime[:3]),
)
NONE = replace(
    _BRIEF,
    verdict="none",
    where=replace(
        _BRIEF.where,
        channels=[replace(c, nrmse=c.floor, share=None) for c in EXPLAINED.where.channels],
        stage=dict.fromkeys(_STAGES, 0.0),
    ),
    waterfall=[
        _step("as given", 1.1, 0.0047, 0.045, 0.0031),
        _step("refitted", 1.0, 0.0046, 0.044, 0.0030),
        EXPLAINED.waterfall[-1],
    ],
    closed=None,
    causes=[],
    remaining=_remaining(_NAN, "", True),
    advice=[],
    scores=[
        replace(s, gain=None if s.gain is None else min(s.gain, 30.0), probability=None)
        for s in EXPLAINED.scores
    ],
    reasons=[],
    facts=facts(no_gap=0.91),
)
#: The causes lower most held-out errors, but not clearly, and there may be no gap.
UNTOLD = replace(
    NONE,
    verdict="ambiguous",
    facts=facts(
        "waves",
        no_gap=0.3,
        outside=0.1,
        held_out=held_out(100.0, 100.0, before=225.0) | {"f10a30": held_out(169.0, before=100.0)["f10a15"]},
    ),
)
#: What differs by chance between trials is noise.
SCATTERED = replace(
    NONE,
    random_effects={"trim": 0.2},
    reasons=["trials differ in trim (0.2 of its typical size), which is part of the noise"],
)
ODD = replace(NONE, odd_trials={"f18a30": "c_d0 1.40 ± 0.05 in place of 0.7"})
SINGLE = replace(NONE, setting_count=1)
_RIVALS = Proposed(alone=0.4, equivalent=CURRENT.equivalent)
AMBIGUOUS = replace(
    _BRIEF,
    verdict="ambiguous",
    causes=[CURRENT],
    scores=_scores("current"),
    facts=facts("current", proposed={"current": _RIVALS}),
)
PAIR = replace(
    _BRIEF,
    waterfall=[
        *EXPLAINED.waterfall[:3],
        _step("+ current", 1.1, 0.0048, 0.045, 0.0030),
        EXPLAINED.waterfall[-1],
    ],
    causes=[BACKLASH, replace(CURRENT, equivalent=[])],
    facts=facts("servo-backlash", "current"),
)
UNEXPLAINED = replace(
    _BRIEF,
    verdict="unexplained",
    where=replace(_BRIEF.where, stage={**EXPLAINED.where.stage, "rig": 0.0}),
    waterfall=[*EXPLAINED.waterfall[:2], EXPLAINED.waterfall[-1]],
    closed=None,
    causes=[],
    remaining=_remaining(1.0, "surge force against speed", False),
    advice=[],
    facts=facts(outside=0.9, held_out=held_out(1700.0, 1690.0, 1710.0)),
)
FOLLOWS = replace(
    NONE,
    verdict="unexplained",
    remaining=_remaining(1.0, "validation trials f10a15", False),
    held_out="validation",
    facts=facts(no_gap=0.91, held_out=held_out(2200.0, before=2200.0)),
)
REREAD = replace(
    _BRIEF,
    causes=[READING],
    scores=_scores(READING.effect),
    at_bound={"c_d4": 6.0, "c_f0": 0.0},
    facts=facts(READING.effect),
)
SOFTER = Cause(
    effect="parameter:k_t",
    meaning="k_t 0.06 → 0.0552 N·m/rad (−8 %, 71 standard errors)",
    probability=0.95,
    equivalent=["joint-stiffness"],
    parameters={
        "k_t": ChangedValue(value=0.0552, stderr=3e-5, unit="N m/rad", given=0.06, standard_errors=71.0)
    },
    shrinkage=BACKLASH.shrinkage[:2],
)
_OFF = {"u_m_s": ChannelScore(unit="m/s", rmse=0.042, nrmse=0.19, samples=900)}
CHANGED = replace(_BRIEF, causes=[SOFTER], as_given=_OFF, facts=facts(SOFTER.effect))
MOVED = replace(NONE, moved=SOFTER.parameters, as_given=_OFF)
NOT_GIVEN = replace(NONE, params=fit_common.ROBOT_FILE)
BLACK_BOX = replace(UNEXPLAINED, facts=facts(no_gap=0.9, unreproduced={"u_m_s": 0.003}))
#: The cause closes three quarters of the gap, and a cause outside the catalogue is likely.
PARTIAL = replace(
    _BRIEF,
    verdict="partial",
    waterfall=[
        *EXPLAINED.waterfall[:2],
        _step("+ servo-backlash", 7.4, 0.014, 0.065, 0.0031),
        EXPLAINED.waterfall[-1],
    ],
    closed=Closed(
        before=54.0, refitted=17.0, after=7.4, share=46.6 / 53.0, by_refit=37.0 / 53.0, by_causes=9.6 / 16.0
    ),
    remaining=_remaining(0.4, "yaw moment", False),
    facts=facts("servo-backlash", outside=0.6, after=740.0),
)
#: A refit of the parameters predicts held-out data as well as the cause does.
_IMITATED = facts("servo-backlash", held_out=held_out(161.0, 160.0, 159.0, before=160.0, as_given=5400.0))
IMITATED = replace(
    _BRIEF,
    verdict="ambiguous",
    closed=Closed(before=54.0, refitted=1.6, after=1.6, share=0.99, by_refit=0.99, by_causes=0.0),
    facts=_IMITATED,
)
#: The cause closes the gap of one held-out trial, and the other trials have none.
_CARRIED = facts(
    "servo-backlash",
    held_out=held_out(101.0, 99.0, 100.0, before=100.0) | {"f14a15": held_out(105.0)["f10a15"]},
)
CARRIED = replace(
    _BRIEF,
    verdict="ambiguous",
    closed=Closed(before=5.0, refitted=5.0, after=1.0, share=0.98, by_refit=0.0, by_causes=0.98),
    facts=_CARRIED,
)

ALL = {
    "none": NONE,
    "untold": UNTOLD,
    "scattered": SCATTERED,
    "odd trial": ODD,
    "single": SINGLE,
    "follows": FOLLOWS,
    "explained": EXPLAINED,
    "pair": PAIR,
    "ambiguous": AMBIGUOUS,
    "unexplained": UNEXPLAINED,
    "imitated": IMITATED,
    "carried": CARRIED,
    "partial": PARTIAL,
    "reread": REREAD,
    "changed": CHANGED,
    "moved": MOVED,
    "not given": NOT_GIVEN,
    "black box": BLACK_BOX,
}


def evidence(gap: GapFile, sources: Sequence[str] = ()) -> ev.Evidence:
    """What one of them rests on."""
    return diagnose_evidence.build_gap_evidence(gap, worst(), sources=sources)


def written(folder: Path, name: str) -> Path:
    """One of them with its evidence, on disk."""
    path = folder / f"{name}.yaml"
    ALL[name].write(path)
    ev.write(ev.sidecar(path), evidence(ALL[name], ["a robot's paper"]))
    return path
