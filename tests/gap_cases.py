"""Diagnoses made by hand, one for every verdict, to try the gap file and its report on."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from swimid.diagnosis import evidence as diagnose_evidence
from swimid.diagnosis import file as diagnose_file
from swimid.diagnosis import gap_file as gap_format
from swimid.diagnosis.gap_file import GapFile
from swimid.diagnosis.result import (
    Absorbed,
    Advice,
    Cause,
    Cell,
    ChannelGap,
    Extrapolation,
    Gap,
    Number,
    Overlay,
    Remaining,
    Score,
    Shrinkage,
    Sketch,
)
from swimid.results import evidence as ev

TRIALS = [f"f{f}a{a}" for f in (10, 14, 18) for a in (15, 20, 30)]
_CHANNELS = ["u_m_s", "yaw_rate_rad_s", "joint4_rad"]
_STAGES = ["actuation", "structure", "fluid", "environment", "sensing"]
_NAN = float("nan")

BACKLASH = Cause(
    effect="servo-backlash",
    stage="actuation",
    meaning="Play between the servo and the joint.",
    sources=("boxfish, section 4.2",),
    probability=0.94,
    equivalent=(),
    parameters={"backlash_rad": Number(0.0351234, 0.00212, "rad")},
    shrinkage=(
        Shrinkage("yaw_rate_rad_s", 0.061, 0.032, 0.088, 0.030, 29 / 31, (0.71, 1.06)),
        Shrinkage("u_m_s", 0.142, 0.034, 0.190, 0.021, 108 / 121, (0.81, 0.94)),
        Shrinkage("joint4_rad", 0.020, 0.021, 0.030, 0.020, _NAN, (_NAN, _NAN)),
    ),
    gain=3062.4,
    gain_stderr=410.0,
    absorbed=(
        Absorbed("c_d0", "1", Number(0.70, 0.03, "1"), Number(0.92, 0.02, "1"), Number(0.71, 0.03, "1")),
        Absorbed("c_ma", "1", None, Number(1.02, 0.05, "1"), Number(1.01, 0.05, "1"), (0.0, None)),
        Absorbed("c_f4", "1", None, Number(2.0, None, "1", "at-bound"), Number(1.9, 0.1, "1"), (0.0, 2.0)),
    ),
    extrapolations=(Extrapolation("1.8 Hz", 6.4, 1.3), Extrapolation("30 deg", 5.1, 1.2)),
)

CURRENT = replace(
    BACKLASH,
    effect="current",
    stage="environment",
    meaning="The water moves.",
    sources=(),
    probability=0.81,
    equivalent=("tether", "linear-drag"),
    parameters={
        "east_m_s": Number(0.012, 0.002, "m/s"),
        "north_m_s": Number(-0.1, None, "m/s", "at-bound"),
    },
    gain=812.0,
    gain_stderr=150.0,
)


#: Another reading of the robot has no numbers.
READING = replace(
    BACKLASH,
    effect="reading:drag_point=strips",
    stage="fluid",
    meaning='Another answer to "Where on a link is its speed taken?": spread evenly along each link.',
    sources=(),
    parameters={},
)


def _scores(first: str = "servo-backlash") -> tuple[Score, ...]:
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
        Score(name, stage, "joint 2" if name == "joint-locked" else "", gain, 0.3 * abs(gain) + 5, (5, 9),
              0.3, gain, True, 0.01)
        for (name, stage), gain in zip(names.items(), rng.uniform(-40, 400, len(names)), strict=True)
    ]  # fmt: skip
    scores = [
        replace(s, gain=3062.4, stderr=410.0, won=(9, 9), probability=0.94) if s.effect == first else s
        for s in scores
    ]
    weak = Score("wall", "environment", "+x", _NAN, _NAN, (0, 0), 0.97, 1.2, False, 0.0)
    return (weak, *scores)


def _maps() -> dict[str, tuple[list[str], list[str], np.ndarray]]:
    rng = np.random.default_rng(6)
    by_channel = rng.lognormal(0.3, 0.6, (len(TRIALS), len(_CHANNELS)))
    by_channel[2, 1] = np.nan
    phases = [f"{30 * k}°" for k in range(12)]
    return {
        "trial by channel": (TRIALS, _CHANNELS, by_channel),
        "phase by trial": (TRIALS, phases, rng.lognormal(0.2, 0.5, (len(TRIALS), 12))),
    }


def _overlays() -> tuple[Overlay, ...]:
    rng = np.random.default_rng(7)
    time = np.arange(0.0, 10.0, 0.02)
    found = []
    trials = (("f10a15", False, "u_m_s", "m/s"), ("f14a20", True, "yaw_rate_rad_s", "rad/s"))
    for trial, held_out, channel, unit in trials:
        after = 0.2 * (1 - np.exp(-time)) + 0.05 * np.sin(9 * time)
        before = after * 1.15
        measured = after + rng.normal(0, 0.01, len(time))
        found.append(Overlay(trial, channel, unit, held_out, time, measured, before, after))
    return tuple(found)


EXPLAINED = Gap(
    verdict="explained",
    channels=(
        ChannelGap("joint4_rad", "rad", 0.020, 0.020, 0.0, 0.003, 0.03),
        ChannelGap("yaw_rate_rad_s", "rad/s", 0.061, 0.030, 0.29, 0.09, 0.088),
        ChannelGap("u_m_s", "m/s", 0.142, 0.021, 0.71, 0.031, 0.190),
    ),
    stages={"actuation": 0.95, "structure": 0.03, "fluid": 0.02, "environment": 0.0, "sensing": 0.0},
    phase=tuple(Cell("phase", f"{30 * k}-{30 * k + 30}°", 1.5 + np.sin(k), 1 / 12) for k in range(12)),
    regime=(
        Cell("frequency", "1.0 Hz", 1.3, 0.1),
        Cell("frequency", "1.4 Hz", 3.1, 0.3),
        Cell("frequency", "1.8 Hz", 6.2, 0.6),
        Cell("amplitude", "15°", 6.0, 0.7),
        Cell("amplitude", "30°", 2.0, 0.3),
    ),
    time=(Cell("time", "start-up", 5.0, 0.6), Cell("time", "steady", 2.2, 0.4)),
    causes=(BACKLASH,),
    remaining=Remaining(0.04, "mostly in yaw_rate_rad_s", True, 3.0),
    advice=(
        Advice(
            "Swim at 1.0 Hz with 10 deg for 15 s: play takes the largest share of the smallest stroke.",
            ("servo-backlash", "amplitude-loss"),
            41.0,
            12.0,
        ),
    ),
    scores=_scores(),
    no_gap=0.001,
    outside=0.03,
    floor_from="repeats of one setting, and residuals of a saturated description",
    sketches=(
        Sketch(
            "surge force", "N", "speed", "m/s",
            np.linspace(0, 0.3, 10), 0.1 * np.linspace(0, 0.3, 10), np.full(10, 0.003), 40.0,
        ),
        Sketch(
            "yaw moment", "N m", "phase", "rad",
            np.linspace(0, 6.3, 12), np.zeros(12), np.full(12, _NAN), 2.0,
        ),
    ),
    overlays=_overlays(),
    maps=_maps(),
    forces={"surge force": 40.0, "yaw moment": 2.0},
    rounds=("Round 1: servo-backlash gains 3062.", "Round 2: no other effect gains more than noise would."),
    reasons=("One effect gains far more than noise and than any other.",),
)  # fmt: skip

# the others draw less: a page of every verdict is drawn in the tests
_BRIEF = replace(
    EXPLAINED,
    overlays=EXPLAINED.overlays[:1],
    maps={"trial by channel": EXPLAINED.maps["trial by channel"]},
    sketches=(),
    phase=EXPLAINED.phase[:1],
    regime=EXPLAINED.regime[:3],
)
NONE = replace(
    _BRIEF,
    verdict="none",
    channels=tuple(replace(c, nrmse=c.floor, share=_NAN) for c in EXPLAINED.channels),
    stages=dict.fromkeys(_STAGES, 0.0),
    causes=(),
    remaining=Remaining(_NAN, "", True, 0.0),
    advice=(),
    scores=tuple(replace(s, gain=min(s.gain, 30.0), probability=_NAN) for s in EXPLAINED.scores),
    rounds=(),
    reasons=(),
)
AMBIGUOUS = replace(_BRIEF, verdict="ambiguous", causes=(CURRENT,), scores=_scores("current"))
PAIR = replace(_BRIEF, causes=(BACKLASH, replace(CURRENT, equivalent=())))
UNEXPLAINED = replace(
    _BRIEF,
    verdict="unexplained",
    causes=(),
    remaining=Remaining(1.0, "surge force against speed", False, 911.0),
    stages={**EXPLAINED.stages, "rig": 0.0},
    advice=(),
)
REREAD = replace(
    _BRIEF, causes=(READING,), scores=_scores(READING.effect), at_bound={"c_d4": 6.0, "c_f0": 0.0}
)
PARTLY = replace(_BRIEF, verdict="unexplained", remaining=Remaining(0.4, "yaw moment", False, 200.0))

ALL = {
    "none": NONE,
    "explained": EXPLAINED,
    "pair": PAIR,
    "ambiguous": AMBIGUOUS,
    "unexplained": UNEXPLAINED,
    "partly": PARTLY,
    "reread": REREAD,
}


def gap_file(gap: Gap) -> GapFile:
    """The file of one of them."""
    return diagnose_file.gap_file(
        gap,
        model="multilink",
        robot="tfish",
        experiment="free-swim",
        params="tfish.yaml",
        trials=TRIALS,
        settings={"seed": 0},
        provenance={"command": "swimid diagnose trials.yaml", "version": "0", "created": "2026-01-02"},
    )


def written(folder: Path, name: str) -> Path:
    """One of them with its evidence, on disk."""
    gap = ALL[name]
    file = gap_file(gap)
    path = folder / f"{name}.yaml"
    gap_format.write(path, file)
    ev.write(ev.sidecar(path), diagnose_evidence.evidence(gap, file, sources=["a robot's paper"]))
    return path
