"""Proposed trials of each kind of experiment: settings, limits, commands and durations."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from swimid.diagnosis import proposals
from swimid.diagnosis.proposals import Proposal, Segment, Swim, TrialLimits, protocol_of
from swimid.fitting import drives
from swimid.fitting.model import CruiseInput, Model, RigInput, SurgeInput, SwimInput, Trial
from swimid.propulsion.model import RecoilModel, SurgeModel
from swimid.rig import model as rig
from swimid.robots import file as robots
from swimid.robots.spatial import HingeStroke
from swimid.swimmer.planar.model import MultilinkModel
from tests import effect_cases

#: Factors on the settings, whose names say what is changed.
USUAL, FASTER, SLOWER, LARGER = (
    (Segment(),), (Segment(frequency=1.4),), (Segment(frequency=0.6),), (Segment(amplitude=1.4),),
)  # fmt: skip


def limits(**stated: Any) -> TrialLimits:
    """Return limits of an experiment with the boxfish."""
    experiment: Any = SimpleNamespace(facts={"waveform": "sine"}, robot=robots.read("boxfish"))
    return TrialLimits(experiment, **stated)


def proposed(
    model: Model, trials: list[Trial], segments: tuple[Segment, ...], most_s: float, **stated: Any
) -> Any:
    protocol = protocol_of(model, trials, limits(**stated))
    assert protocol is not None
    found = protocol(segments, most_s)
    assert found is None or (found.trial.id, found.trial.role) == ("proposed", "fit")
    return found


# ---------------------------------------------------------------- straight swimming and cruises


def test_straight_swimming_at_another_beat() -> None:
    model = SurgeModel(amplitudes_rad=[0.2, 0.35], frequencies_hz=[1.0, 2.0], speed_m_s=0.2)
    trials = [
        Trial(f"s{k}", "fit", 0.3 + np.arange(count) / 2, {}, surge=SurgeInput(hz, size, 0.3))
        for k, (count, hz, size) in enumerate([(20, 1.0, 0.2), (31, 2.0, 0.35)])
    ]

    def beat(segments: tuple[Segment, ...], most_s: float = 99.0, **stated: Any) -> Proposal | None:
        return proposed(model, trials, segments, most_s, **stated)

    faster = beat(FASTER)
    assert faster is not None
    drive = {"frequency_hz": 2.8, "amplitude_deg": pytest.approx(math.degrees(0.35))}
    assert faster.entry == {"drive": {"waveform": "sine", **drive}}
    assert faster.text == "swim at 2.8 Hz and 20.1 deg, for 15 s"
    assert (faster.trial.surge.frequency_hz, faster.trial.surge.start_s) == (2.8, 0.3)
    assert faster.trial.surge.amplitude_rad == pytest.approx(0.35)
    np.testing.assert_allclose(faster.trial.time_s, 0.3 + np.arange(31) / 2)
    assert list(faster.columns) == ["t_s", "frequency_hz", "amplitude_deg"]
    assert faster.columns["t_s"].tolist() == [0.0, pytest.approx(15.3)]
    assert faster.columns["frequency_hz"].tolist() == [2.8, 2.8]
    slower = beat(SLOWER, 4.0)
    assert slower is not None
    assert slower.trial.surge.frequency_hz == 0.6
    assert slower.trial.time_s[-1] == pytest.approx(4.3)
    assert beat(SLOWER, 1.9) is None  # five samples are needed
    larger = beat(LARGER, max_amplitude_rad=0.4, max_frequency_hz=1.5)
    assert larger is not None
    assert larger.trial.surge.amplitude_rad == pytest.approx(0.4)
    assert larger.trial.surge.frequency_hz == 1.5
    assert beat((Segment(bias=0.4),)) is None
    assert beat((Segment(amplitude=0.0),)) is None
    assert beat(SLOWER + FASTER) is None


def test_a_cruise_ends_at_its_distance() -> None:
    model = RecoilModel(drag_area_kg_m=2.4, moving_mass_kg=1.9, fins={"a": 1e-4})
    cruise = CruiseInput(fin="a", inertia_kg_m2=1e-4, middle=(2.0, 0.4))
    trials = []
    for name, hz, speed in (("a", 1.5, 0.1), ("b", 2.0, 0.25)):
        setting = {"frequency_hz": hz, "amplitude_rad": 0.4, "distance_m": 1.5}
        inputs = {column: np.array([v]) for column, v in setting.items()}
        measured = {"mean_speed_m_s": np.array([speed])}
        trials.append(Trial(name, "fit", np.zeros(1), measured, inputs=inputs, cruise=cruise))
    found = proposed(model, trials, FASTER, 99.0)
    assert found.text == "swim at 2.8 Hz and 22.9 deg with the fin a, over 1.5 m"
    assert found.entry["fin"] == "a"
    assert found.entry["distance_m"] == 1.5
    assert found.columns["t_s"].tolist() == [0.0, pytest.approx(15.0)]  # at the slowest speed
    assert found.trial.inputs["amplitude_rad"] == pytest.approx([0.4])
    short = proposed(model, trials, SLOWER, 99.0, tank_length_m=0.6)
    assert short.entry["distance_m"] == 0.6
    assert short.trial.inputs["frequency_hz"].tolist() == [0.9]


# ---------------------------------------------------------------- rigs and signals


def falling(grams: float, duration_s: float, pulley: bool = True) -> Trial:
    mass, time = grams / 1000, 0.5 + np.arange(0.0, duration_s, 0.1)
    known = RigInput(1.2 + mass, mass * 9.8, pulley=pulley, release_s=0.5)
    return Trial(f"w{grams:g}", "fit", time, {}, rig=known)


def test_another_pulling_mass_passes_the_same_places_sooner() -> None:
    model = rig.falling_weight(mass_kg=1.2, force_N=0.25, area_known=False, pulley=True)
    trials = [falling(20, 10.05), falling(40, 7.05)]
    found = proposed(model, trials, LARGER, 99.0)
    assert found.entry == {"pulling_mass_kg": 0.056}
    assert found.trial.rig.force == pytest.approx(0.056 * 9.8)
    assert found.trial.rig.inertia == pytest.approx(1.256)
    # its time since release goes with the inverse square root of the force of the nearest trial
    np.testing.assert_allclose(found.trial.time_s, 0.5 + np.arange(0, 7.05, 0.1) / math.sqrt(1.4), rtol=1e-9)
    assert found.columns["force_N"] == pytest.approx(np.full(71, 0.056 * 9.8))
    assert found.text == "pull with 0.056 kg, for 5.92 s"
    short = proposed(model, trials, ((Segment(amplitude=0.6)),), 3.0)
    assert short.entry == {"pulling_mass_kg": 0.012}
    assert np.ptp(short.trial.time_s) == pytest.approx(3.0, abs=0.2)
    assert proposed(model, trials, FASTER, 99.0) is None
    assert proposed(model, trials, LARGER, 0.2) is None


def test_a_constant_force_without_a_pulley_adds_no_inertia() -> None:
    model = rig.falling_weight(mass_kg=1.2, force_N=0.25, area_known=False, pulley=False)
    trials = [falling(20, 10.05, pulley=False)]
    found = proposed(model, trials, LARGER, 99.0)
    assert found.entry == {"driving_force_N": pytest.approx(0.274)}
    assert found.trial.rig.inertia == pytest.approx(1.22)
    assert "pull with 0.274 N" in found.text


def test_a_signal_is_played_larger_and_faster() -> None:
    model = effect_cases.arx_model({"a1": -0.5, "b1": 0.5}, 0.05)
    time = 1.0 + np.arange(201) * 0.05
    trial = Trial("run", "fit", time, {}, inputs={"cmd1_rad": np.sin(time)})
    larger = proposed(model, [trial], LARGER, 99.0)
    np.testing.assert_allclose(larger.columns["cmd1_rad"], 1.4 * np.sin(time), atol=1e-12)
    assert larger.text == "play cmd1_rad of run 1.4 times as large and 1 times as fast, for 10 s"
    faster = proposed(model, [trial], FASTER, 99.0)
    assert faster.trial.time_s[-1] == pytest.approx(1.0 + 10.0 / 1.4, abs=0.05)
    np.testing.assert_allclose(
        faster.columns["cmd1_rad"], np.sin(1 + 1.4 * (faster.columns["t_s"] - 1)), atol=1e-3
    )
    halves = proposed(model, [trial], (Segment(amplitude=1.4), Segment(amplitude=0.0)), 8.0)
    played = halves.columns["cmd1_rad"]
    assert halves.trial.time_s[-1] == pytest.approx(9.0)
    np.testing.assert_allclose(played[:80], 1.4 * np.sin(time[:80]), atol=1e-9)
    np.testing.assert_allclose(played[82:], 0.0, atol=1e-9)
    assert halves.text.endswith("then at zero, for 8 s")
    assert proposed(model, [trial], (Segment(bias=0.4),), 99.0) is None
    assert proposed(model, [trial], USUAL, 0.1) is None


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_release_keeps_its_side(side: float) -> None:
    model = rig.free_decay("roll_rad", inertia=0.5, stiffness=4.0, guess=0.1, amplitude=0.3)
    time = np.arange(0.0, 9.0, 0.05)
    trials = [
        Trial(f"d{k}", "fit", time[:count], {}, rig=RigInput(0.5, release_s=0.2, x0=x0))
        for k, (count, x0) in enumerate([(100, 0.2), (180, 0.25 * side)])
    ]
    found = proposed(model, trials, LARGER, 99.0)
    assert found.trial.rig.x0 == pytest.approx(0.35 * side)
    assert found.text == f"release at {0.35 * side:.3g} rad, for 8.95 s"
    assert found.columns["t_s"].tolist() == [0.2, time[-1]]
    assert found.columns["roll_rad"][0] == pytest.approx(0.35 * side)
    assert np.isnan(found.columns["roll_rad"][1])
    assert proposed(model, trials, USUAL, 99.0).trial.rig.x0 == pytest.approx(0.25 * side)
    assert proposed(model, trials, FASTER, 99.0) is None


# ---------------------------------------------------------------- robots with links


@pytest.fixture(scope="module")
def fish() -> MultilinkModel:
    return MultilinkModel(robots.read("tfish"))


def beating(hz: float, deg: float, duration_s: float, **more: Any) -> Trial:
    beat = drives.TailBeat("sine", hz, math.radians(deg), **more)
    swim = SwimInput(beat, pose=(0.3, -0.2, 0.5), coefficients={"c_f": 1.1})
    return Trial(f"{hz} Hz", "fit", 2.0 + np.arange(0.0, duration_s + 0.01, 0.04), {}, swim=swim)


def beats(time: np.ndarray, hz: float, deg: float, bias_deg: float = 0.0) -> np.ndarray:
    """Return the angle of each of the three driven joints, rad, which share the beat."""
    return np.radians(deg * np.sin(2 * np.pi * hz * time) + bias_deg) / 3


@pytest.mark.parametrize(
    ("segment", "hz", "deg", "bias"),
    [
        (Segment(), 1.0, 20.0, 0.0),
        (Segment(frequency=1.4), 2.1, 20.0, 0.0),
        (Segment(amplitude=0.6), 1.0, 9.0, 0.0),
        (Segment(amplitude=1.4), 1.0, 28.0, 0.0),
        (Segment(bias=-0.4), 1.0, 20.0, -8.0),
    ],
)
def test_one_beat_from_rest(
    fish: MultilinkModel, segment: Segment, hz: float, deg: float, bias: float
) -> None:
    trials = [beating(1.0, 20.0, 10.0), beating(1.5, 15.0, 8.0)]
    found = proposed(fish, trials, (segment,), 99.0)
    drive = {"frequency_hz": hz, "amplitude_deg": pytest.approx(deg), "bias_deg": pytest.approx(bias)}
    assert found.entry["drive"] == {"waveform": "sine", "asymmetry": 0.0, "ramp_s": 1.0, **drive}
    assert found.entry["coefficients"] == {"c_f": 1.1}
    assert found.trial.swim.pose == (0.3, -0.2, 0.5)
    np.testing.assert_allclose(found.trial.time_s, np.arange(251) * 0.04, atol=1e-9)
    assert list(found.columns) == ["t_s", "cmd1_rad", "cmd2_rad", "cmd3_rad"]
    time = found.columns["t_s"]
    np.testing.assert_allclose(time, np.arange(1001) / 100, atol=1e-9)
    after = time >= 1.0
    for name in ("cmd1_rad", "cmd2_rad", "cmd3_rad"):
        np.testing.assert_allclose(found.columns[name][after], beats(time, hz, deg, bias)[after], atol=1e-9)
        assert found.columns[name][0] == 0.0
    turn = f" with a bias of {bias:g} deg" * bool(bias)
    assert found.text == f"swim at {hz:g} Hz and {deg:g} deg{turn}, from rest, for 10 s"


def test_several_beats_are_joined(fish: MultilinkModel) -> None:
    trials = [beating(1.0, 20.0, 10.0), beating(1.5, 15.0, 8.0)]
    found = proposed(fish, trials, SLOWER + FASTER, 99.0)
    assert found.text == "swim at 0.6 Hz and 20 deg, then at 2.1 Hz and 20 deg, from rest, for 10 s"
    assert "drive" not in found.entry
    time, angle = found.columns["t_s"], found.columns["cmd2_rad"]
    first = (time >= 1.0) & (time < 5.0)
    np.testing.assert_allclose(angle[first], beats(time, 0.6, 20.0)[first], atol=1e-5)
    # zero crossings of the second half, after the change of a second
    crossings = np.count_nonzero(np.diff(np.sign(angle[(time > 6.0) & (time < 9.9)])))
    assert crossings == pytest.approx(2 * 2.1 * 3.9, abs=1)
    coast = proposed(fish, trials, (Segment(amplitude=1.4), Segment(amplitude=0.0)), 8.0)
    assert coast.text == "swim at 1 Hz and 28 deg, then without a beat (coast), from rest, for 8 s"
    time, angle = coast.columns["t_s"], coast.columns["cmd2_rad"]
    first = (time >= 1.0) & (time < 4.0)
    np.testing.assert_allclose(angle[first], beats(time, 1.0, 28.0)[first], atol=1e-5)
    np.testing.assert_allclose(angle[time > 5.0], 0.0, atol=1e-9)
    turns = proposed(fish, trials, (Segment(bias=-0.4), Segment(bias=0.4)), 8.0)
    time, angle = turns.columns["t_s"], turns.columns["cmd2_rad"]
    first, second = (time >= 1.0) & (time < 4.0), time > 5.0
    np.testing.assert_allclose(angle[first], beats(time, 1.0, 20.0, -8.0)[first], atol=1e-5)
    np.testing.assert_allclose(angle[second], beats(time, 1.0, 20.0, 8.0)[second], atol=1e-5)
    assert turns.text.count("with a bias of") == 2


def test_beats_keep_the_limits(fish: MultilinkModel) -> None:
    trials = [beating(1.0, 20.0, 10.0)]
    slow = proposed(fish, trials, FASTER, 99.0, max_frequency_hz=1.2)
    assert slow.entry["drive"]["frequency_hz"] == 1.2
    small = proposed(fish, trials, LARGER, 99.0, max_amplitude_rad=math.radians(25.0))
    assert small.entry["drive"]["amplitude_deg"] == pytest.approx(25.0)
    # two beats are needed after the ramp of 1 s
    assert proposed(fish, trials, USUAL, 3.0) is not None
    assert proposed(fish, trials, USUAL, 2.9) is None
    # a steady trial begins with the ramp of a trials file
    steady = [beating(1.0, 20.0, 10.0, steady=True, ramp_s=0.0)]
    assert proposed(fish, steady, USUAL, 99.0).trial.swim.beat.ramp_s == 1.0


@pytest.mark.parametrize(
    ("limit", "deg"), [({"max_angle_deg": 8.0}, 23.9), ({"max_rate_deg_s": 2 * math.pi * 7.0}, 20.9)]
)
def test_joints_keep_their_own_limits(limit: dict[str, float], deg: float) -> None:
    """A third of the beat goes to each joint: 8 degrees there are 24, less a thousandth, rounded down."""
    robot = robots.read("tfish").model_copy(deep=True)
    assert robot.multilink is not None
    for joint in robot.multilink.joints:
        if joint.driven is not None:
            joint.driven = joint.driven.model_copy(update=limit)
    found = proposed(MultilinkModel(robot), [beating(1.0, 20.0, 10.0)], LARGER, 99.0)
    assert found.entry["drive"]["amplitude_deg"] == pytest.approx(deg, abs=0.11)
    assert proposed(MultilinkModel(robot), [beating(1.0, 20.0, 10.0)], USUAL, 99.0).text.startswith(
        "swim at 1 Hz and 20 deg"
    )


def test_a_stroke_is_scaled(fish: MultilinkModel) -> None:
    law = HingeStroke(
        period_s=1.0, knots_s=[0.0, 0.25, 0.5, 1.0], angles_deg={"joint1": [0.0, 30.0, 10.0, 0.0]}
    )
    stroke = drives.Cycle("thrust", law, 0.8, 1.2)
    swim = SwimInput(stroke=stroke, coefficients={})
    template = Trial("s", "fit", np.arange(0.0, 10.01, 0.04), {}, swim=swim)
    found = Swim(fish, [template], limits())((Segment(frequency=1.4, amplitude=0.6),), 99.0)
    assert found is not None
    assert found.trial.swim.stroke is not None
    assert (found.trial.swim.stroke.frequency_hz, found.trial.swim.stroke.scale) == (1.12, 0.72)
    assert (
        found.text == "swim with the stroke thrust at 1.12 Hz and 0.72 times its angles, from rest, for 10 s"
    )


def test_recorded_commands_are_played_faster_and_larger(fish: MultilinkModel) -> None:
    time = np.arange(0.0, 10.01, 0.04)

    def angle(when: np.ndarray) -> drives.Motion:
        turn = 2 * np.pi * 1.2
        return (
            0.2 * np.sin(turn * when),
            0.2 * turn * np.cos(turn * when),
            -0.2 * turn**2 * np.sin(turn * when),
        )

    swim = SwimInput(joints=[angle] * 3, commanded=True, coefficients={})
    trials = [Trial("log7", "fit", time, {}, swim=swim)]
    found = proposed(fish, trials, FASTER, 99.0)
    assert found.text.startswith("play the commands of log7 at 1.4 times the speed and 1 times the angles")
    when = found.columns["t_s"]
    assert when[-1] == pytest.approx(10.0 / 1.4, abs=0.04)
    np.testing.assert_allclose(found.columns["cmd1_rad"], 0.2 * np.sin(2 * np.pi * 1.68 * when), atol=2e-3)
    assert proposed(fish, trials, (Segment(bias=0.4),), 99.0) is None
    limited = proposed(fish, trials, LARGER, 99.0, max_amplitude_rad=0.21, max_frequency_hz=1.0)
    # 0.999 of the limit, rounded down to three digits
    assert np.abs(limited.columns["cmd1_rad"]).max() == pytest.approx(1.04 * 0.2, rel=1e-3)


# ---------------------------------------------------------------- tank


def test_the_extent_of_a_path_is_its_longest_chord() -> None:
    turn = np.linspace(0.0, 2 * np.pi, 721)
    circle = {"x_m": 3.0 + np.cos(turn), "y_m": -1.0 + np.sin(turn)}
    seen = proposals.extents(circle)
    # a chord of an arc, up to the diameter; 36 directions miss up to 1 - cos(2.5 deg)
    np.testing.assert_allclose(seen[:361], 2 * np.sin(turn[:361] / 2), rtol=1e-3)
    np.testing.assert_allclose(seen[361:], 2.0, rtol=1e-3)
    assert proposals.extents({"z_m": turn}).tolist() == [0.0]
    time = 5.0 + turn
    assert proposals.time_inside(time, circle, 2.1) == math.inf
    assert proposals.time_inside(time, circle, 1.0) == pytest.approx(np.pi / 3, abs=0.02)
    trials = [Trial("a", "fit", time, circle), Trial("b", "fit", time, {"x_m": turn})]
    assert proposals.tank_length(trials, limits()) == pytest.approx(2 * np.pi)
    assert proposals.tank_length(trials, limits(tank_length_m=1.3)) == 1.3
    assert proposals.tank_length([replace(trials[0], measured={})], limits()) == math.inf
