"""What was set in trials: repeats, and how many settings there are."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from swimid.diagnosis import settings
from swimid.diagnosis.settings import SettingValue
from swimid.fitting.drives import Cycle, Motion, TailBeat
from swimid.fitting.model import Array, CruiseInput, RigInput, SurgeInput, SwimInput, Trial
from swimid.robots.spatial import HingeStroke

TIME = np.arange(0.0, 12.0, 0.02)
LAW = HingeStroke(period_s=1.0, knots_s=[0.0, 0.25, 0.5, 1.0], angles_deg={"flipper": [0.0, 30.0, 10.0, 0.0]})


def beating(number: int, beat: TailBeat, **swim: object) -> Trial:
    """A trial with a stated beat, as trials files give it: no coefficients of its own, unless it has."""
    return Trial(f"t{number}", "fit", TIME, {}, swim=SwimInput(**{"beat": beat, "coefficients": {}, **swim}))


def logged(
    number: int, frequency_hz: float, degrees: float, *, noise: float = 0.0, commanded: bool = True
) -> Trial:
    """A trial whose joints follow a log."""
    rng = np.random.default_rng(number)
    angle = math.radians(degrees) * np.sin(2.0 * math.pi * frequency_hz * TIME + 0.3 * number)
    angle = angle + noise * rng.standard_normal(len(TIME))

    def motion(time_s: Array) -> Motion:
        still = np.zeros(len(time_s))
        return np.interp(time_s, TIME, angle), still, still

    swim = SwimInput(joints=[motion], commanded=commanded, coefficients={})
    return Trial(f"t{number}", "fit", TIME, {}, swim=swim)


def stroked(number: int, frequency_hz: float, scale: float = 1.0) -> Trial:
    """A trial that repeats a stroke of the robot file."""
    stroke = Cycle("thrust", LAW, frequency_hz, scale)
    return Trial(f"t{number}", "fit", TIME, {}, swim=SwimInput(stroke=stroke, coefficients={}))


def repeats(trials: Sequence[Trial]) -> int:
    """How many trials repeat an earlier one."""
    return len(trials) - len({settings.describe_setting(t) for t in trials})


def test_logged_joints_of_other_beats_are_no_repeats() -> None:
    trials = [logged(0, 1.0, 10.0), logged(1, 1.5, 10.0), logged(2, 1.0, 20.0)]
    assert repeats(trials) == 0
    assert settings.count_settings(trials) == 3


def test_a_command_played_again_is_a_repeat_and_measured_angles_are_none() -> None:
    again = replace(logged(1, 1.0, 10.0), id="again")
    assert repeats([logged(1, 1.0, 10.0), again]) == 1
    measured = [logged(1, 1.0, 10.0, noise=1e-3, commanded=False), logged(2, 1.0, 10.0, commanded=False)]
    assert repeats(measured) == 0


def test_one_manoeuvre_played_again_is_one_setting() -> None:
    """Half a stroke has no beat to be known by."""
    assert settings.describe_settings(logged(1, 0.04, 20.0)) == {}
    trials = [replace(logged(1, 0.04, 20.0), id=name) for name in "abc"]
    assert settings.count_settings(trials) == 1
    assert settings.count_settings([*trials, logged(2, 0.04, 20.0)]) == 2


def test_logged_joints_of_one_beat_are_one_setting() -> None:
    trials = [logged(k, f, 10.0, noise=0.003) for k, f in enumerate((1.0, 1.01, 0.99))]
    assert settings.count_settings(trials) == 1
    assert settings.describe_settings(trials[0]) == {"frequency": "1 Hz", "amplitude": "10 deg"} | {
        "bias": settings.describe_settings(trials[0])["bias"]
    }


def test_a_stroke_is_repeated_at_its_frequency_and_scale_only() -> None:
    trials = [stroked(0, 0.5), stroked(1, 0.5), stroked(2, 0.8), stroked(3, 0.5, 0.7)]
    assert repeats(trials) == 1
    assert settings.count_settings(trials) == 3
    assert settings.describe_settings(trials[2]) == {
        "stroke": "thrust",
        "frequency": "0.8 Hz",
        "scale": "1 times",
    }


def test_beats_are_one_setting_where_they_differ_by_less_than_a_stated_one_may() -> None:
    beat = TailBeat("sine", 1.0, 0.3)
    near = [replace(beat, frequency_hz=f, bias_rad=b) for f, b in ((1.0, 0.0), (1.03, 0.01), (0.98, 0.0))]
    trials = [beating(k, b) for k, b in enumerate(near)]
    assert repeats(trials) == 0
    assert settings.count_settings(trials) == 1
    assert settings.count_settings([*trials, beating(9, replace(beat, bias_rad=0.1))]) == 2
    assert settings.count_settings([*trials, beating(9, beat, coefficients={"d_p": 0.01})]) == 2
    assert settings.count_settings([*trials, beating(9, replace(beat, waveform="hopf"))]) == 2


def test_another_fin_at_the_same_beat_is_another_setting() -> None:
    beat = {"frequency_hz": np.array([2.0]), "amplitude_rad": np.array([0.3])}
    fins = [Trial(f"r{k}", "fit", TIME[:1], {}, beat, cruise=CruiseInput(f)) for k, f in enumerate("AAB")]
    assert repeats(fins) == 1
    assert settings.count_settings(fins) == 2


def test_settings_of_different_kinds_are_never_equal() -> None:
    """A beat of 2 Hz is neither the text nor another frequency beyond the tolerance of 5 %."""
    beat = SettingValue(2.0, "Hz")
    assert beat == SettingValue(2.09, "Hz")
    assert beat != SettingValue(2.12, "Hz")
    assert beat != "2 Hz"
    assert SettingValue(0.0, "rad", against=0.3) == SettingValue(0.01, "rad", against=0.3)
    assert SettingValue(0.0, "rad") != SettingValue(0.01, "rad")


def test_ballast_is_another_setting_and_a_towed_body_is_known_by_its_trial() -> None:
    def rig(name: str, **known: float) -> Trial:
        return Trial(name, "fit", TIME, {}, rig=RigInput(**{"area_factor": 2.0, "inertia": 1.0, **known}))

    drops = [rig("a", force=1.0), rig("b", force=1.0), rig("c", force=1.0, inertia=1.5)]
    assert repeats(drops) == 1
    assert settings.count_settings(drops) == 2
    assert repeats([rig("a"), rig("b")]) == 0


@pytest.mark.parametrize(
    ("trial", "told"),
    [
        (Trial("a", "fit", TIME, {}, rig=RigInput(force=1.96133)), {"force": "1.96 N"}),
        (
            Trial(
                "a", "fit", TIME, {}, surge=SurgeInput(frequency_hz=1.2345, amplitude_rad=math.radians(20))
            ),
            {"frequency": "1.23 Hz", "amplitude": "20 deg"},
        ),
        (Trial("a", "fit", TIME, {}), {}),
    ],
)
def test_words(trial: Trial, told: dict[str, str]) -> None:
    assert settings.describe_settings(trial) == told


def test_trials_of_which_nothing_is_known_are_a_setting_each() -> None:
    trials = [Trial(name, "fit", TIME, {}) for name in "abc"]
    assert settings.count_settings(trials) == 3
    assert repeats(trials) == 0
