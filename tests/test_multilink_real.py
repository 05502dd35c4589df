"""Multi-link models against recordings made by others: the tail-actuated fish and the pendula."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from swimid.fitting import fit_common, output_error
from swimid.fitting.drives import TailBeat
from swimid.fitting.fit_common import load_experiment
from swimid.fitting.model import Array, SwimInput, Trial, choose_parameters
from swimid.fitting.output_error import FitResult
from swimid.swimmer import trials as swimmer
from tests.conftest import ROOT, Ran
from tests.generators import real_logs

EXAMPLES = ROOT / "docs" / "examples"

#: The single pendulum, its mass and centre of mass as published.
SINGLE = """
format: swimid-robot/1
name: single-pendulum
fluid: {density_kg_m3: 1.2, gravity_m_s2: 9.81}
multilink:
  plane: vertical
  base: fixed
  heading_deg: 90
  coefficients:
    I_1: {value: 5.0e-4, unit: kg m2, bounds: [1.0e-6, 0.01]}
    k_1: {value: 1.0e-4, unit: N m s/rad, bounds: [0, 0.01]}
  links:
    - {name: block, length_m: 0.10, mass_kg: 1.0, com_m: 0.05, inertia_kg_m2: 8.0e-4, inertia_about: com}
    - {name: arm1, length_m: 0.20, mass_kg: 0.14758, com_m: 0.14775, inertia_kg_m2: I_1, inertia_about: com}
  joints:
    - {name: hinge1, parent: block, child: arm1, at_m: 0.0, passive: {damping_N_m_s_rad: k_1}}
  elements:
    - {kind: hydrostatics, link: arm1}
"""


@pytest.mark.parametrize("name", ["msu-fish", "double-pendulum"])
def test_the_example_robots_move(name: str) -> None:
    _, model = swimmer.robot_model(str(EXAMPLES / f"{name}.yaml"))
    starts = {"initial_angle_hinge1": 0.2, "initial_angle_hinge2": 0.2}
    values = np.array([starts.get(p.name, p.start) for p in model.parameters])
    trial = Trial("one", "fit", np.linspace(0.0, 4.0, 121), {}, swim=SwimInput(TailBeat("sine", 2.0, 0.3)))
    simulated = model.simulate(values, trial)
    assert all(np.isfinite(v).all() for v in simulated.values())
    if name == "msu-fish":
        assert simulated["u_m_s"][-30:].mean() > 0.025  # it starts from rest
    else:
        assert np.ptp(simulated["joint2_rad"]) > 0.1


def rms(result: FitResult, role: str, coefficients: Mapping[str, float]) -> float:
    """Root-mean-square error of all joint angles with given coefficients.

    Each window starts from its own best start state, sought from that of the fit.
    """
    squares = []
    for trial in (t for t in result.trials if t.role == role):
        parameters = tuple(
            replace(p, start=result.value(p.name, trial.id) if p.per_trial else coefficients[p.name])
            for p in result.parameters
        )
        # every joint counts alike
        found = output_error.estimate_start(
            result.model, parameters, trial, dict.fromkeys(trial.measured, 1.0)
        )
        values = np.array([found.get(f"{p.name}[{trial.id}]", p.start) for p in parameters])
        simulated = result.model.simulate(values, trial)
        squares += [np.mean((y - simulated[name]) ** 2) for name, y in trial.measured.items()]
    return float(np.sqrt(np.mean(squares)))


class TestSinglePendulum:
    def test_the_period_is_that_of_the_published_pendulum(
        self, swimid: Callable[..., Ran], real_data: Path, tmp_path: Path
    ) -> None:
        """I / (m a g), the only ratio besides damping that a free swing tells."""
        windows, (a, m, inertia, _, g) = real_logs.read_pendulum(real_data, 1)
        (tmp_path / "single.yaml").write_text(SINGLE)
        ran = swimid(
            "fit-graybox", real_logs.write_pendulum(tmp_path, windows, Path("single.yaml")), "--json"
        )
        found = ran.json["result"]["parameters"]["I_1"]
        ratio = (found["value"] + 0.14758 * 0.14775**2) / (0.14758 * 0.14775 * 9.81)
        assert ratio == pytest.approx((inertia + m * a**2) / (m * a * g), rel=0.01)
        # six windows of nine seconds of swings of up to 1.6 rad
        assert ran.json["result"]["fit"]["channels"]["joint1_rad"]["rmse"] < 0.005


#: The coefficients of the double pendulum's robot file.
COEFFICIENTS = ("a_1", "L_1", "I_1", "I_2", "k_1", "k_2", "f_1", "f_2")
#: What the robot file of the double pendulum holds: masses, the second arm's centre of mass, gravity.
M1, M2, A2, G = 0.09384, 0.13760, 0.11678, 9.81


def groups(
    m1: float,
    m2: float,
    a1: float,
    a2: float,
    length: float,
    i1: float,
    i2: float,
    k1: float,
    k2: float,
    g: float,
) -> dict[str, float]:
    """What free swings of a double pendulum tell: everything over the second arm's moment of weight."""
    weight = m2 * a2 * g
    return {
        "first inertia": (m1 * a1**2 + i1 + m2 * length**2) / weight,
        "second inertia": (i2 + m2 * a2**2) / weight,
        "coupling": m2 * a2 * length / weight,
        "first weight": (m1 * a1 + m2 * length) * g / weight,
        "first damping": k1 / weight,
        "second damping": k2 / weight,
    }


def with_masses_of_the_file(published: Array) -> dict[str, float]:
    """The robot file's coefficients that swing as the published pendulum does."""
    told = groups(*published)
    weight = M2 * A2 * G
    length = told["coupling"] * weight / (M2 * A2)
    a1 = (told["first weight"] * weight / G - M2 * length) / M1
    return {
        "a_1": a1,
        "L_1": length,
        "I_1": told["first inertia"] * weight - M1 * a1**2 - M2 * length**2,
        "I_2": told["second inertia"] * weight - M2 * A2**2,
        "k_1": told["first damping"] * weight,
        "k_2": told["second damping"] * weight,
        "f_1": 0.0,
        "f_2": 0.0,
    }


@pytest.fixture(scope="class")
def pendulum(real_data: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[FitResult, Array]:
    """The double pendulum fitted to its 26 windows, and the published parameters."""
    folder = tmp_path_factory.mktemp("pendulum")
    windows, published = real_logs.read_pendulum(real_data, 2)
    file = real_logs.write_pendulum(folder, windows, EXAMPLES / "double-pendulum.yaml")
    experiment = load_experiment(file, start_state="estimate")
    return output_error.fit_output_error(experiment.model, experiment.trials), published


@pytest.fixture(scope="class")
def viscous(pendulum: tuple[FitResult, Array]) -> FitResult:
    """The same without dry friction."""
    result, _ = pendulum
    parameters = tuple(
        replace(p, start=0.0, free=False) if p.name in ("f_1", "f_2") else p for p in result.parameters
    )
    return output_error.fit_output_error(result.model, result.trials, parameters=parameters)


@pytest.mark.slow
class TestDoublePendulum:
    def test_estimates_from_free_swings_agree_with_the_published_values(
        self, pendulum: tuple[FitResult, Array]
    ) -> None:
        """Within 1 %; the 3 % asked of them leave room for the dry friction the published model has not."""
        result, published = pendulum
        value = result.value
        found = groups(
            M1, M2, value("a_1"), A2, value("L_1"), value("I_1"), value("I_2"), value("k_1"), value("k_2"), G
        )
        told = groups(*published)
        for name in ("first inertia", "second inertia", "coupling", "first weight"):
            assert found[name] == pytest.approx(told[name], rel=0.01), name

    def test_errors_are_no_larger_than_the_published_parameters_give(
        self, pendulum: tuple[FitResult, Array]
    ) -> None:
        """In the windows both were fitted to and in those held out."""
        result, published = pendulum
        ours = {name: result.value(name) for name in COEFFICIENTS}
        theirs = with_masses_of_the_file(published)
        for role in ("fit", "validate"):
            assert rms(result, role, ours) < rms(result, role, theirs), role
        each = [np.sqrt(np.nanmean(s.residual**2)) for s in result.series if s.role == "fit"]
        assert max(each) < 0.036  # the largest with the published parameters from the first sample

    def test_dry_friction_is_identified_and_lowers_the_errors(
        self, pendulum: tuple[FitResult, Array], viscous: FitResult
    ) -> None:
        """Both hinges have some, and errors fall by a fifth and more, in the windows held out too."""
        result, _ = pendulum
        for name in ("f_1", "f_2"):
            assert result.value(name) > 3 * (result.stderr(name) or np.inf), name
        for role in ("fit", "validate"):
            with_it, without = (
                rms(r, role, {name: r.value(name) for name in COEFFICIENTS}) for r in (result, viscous)
            )
            assert with_it < 0.8 * without, role

    def test_damping_alone_grows_as_the_swing_dies(self, viscous: FitResult) -> None:
        """What a viscous hinge cannot do, and why no damping agrees with any other."""
        result = viscous
        parameters = tuple(
            replace(p, start=result.value(p.name), free=p.name in ("k_1", "k_2")) if not p.per_trial else p
            for p in result.parameters
        )
        windows = {t.id: replace(t, role="fit") for t in result.trials}
        early = [windows[f"fit{n:02d}"] for n in range(8, 12)]
        late = [windows[f"validate{n:02d}"] for n in range(4)]
        first, last = (
            output_error.fit_output_error(result.model, t, parameters=parameters) for t in (early, late)
        )
        for name in ("k_1", "k_2"):
            apart = last.value(name) - first.value(name)
            assert apart > 3 * np.hypot(last.stderr(name) or 0.0, first.stderr(name) or 0.0), name
            assert last.value(name) > 2 * first.value(name), name


class TestFishBeat:
    @pytest.mark.slow
    def test_the_beat_differs_from_the_stated_one(self, real_data: Path) -> None:
        """The authors' scripts say 1 Hz; straight runs beat at 2.0 Hz, biased ones at 1.85 to 2.4 Hz."""
        runs = real_logs.read_fish(real_data)
        assert len(runs) == 54
        straight = [r.frequency_hz for r in runs if r.bias_deg == 0]
        assert np.mean(straight) == pytest.approx(2.01, abs=0.02)
        assert all(1.84 < r.frequency_hz < 2.42 for r in runs)


@pytest.fixture(scope="class")
def fish(real_data: Path, tmp_path_factory: pytest.TempPathFactory) -> FitResult:
    """The fish fitted to amplitudes 15 and 30 degrees, 20 degrees held out."""
    folder = tmp_path_factory.mktemp("fish")
    file = real_logs.write_fish(
        folder, real_logs.read_fish(real_data), EXAMPLES / "msu-fish.yaml", lag_rad=real_logs.LAG_RAD
    )
    experiment = load_experiment(
        file, channels=("u_m_s", "yaw_rate_rad_s"), start_state="estimate", max_step=0.012
    )
    parameters = choose_parameters(experiment.model.parameters, freed=("drive_phase",))
    return output_error.with_held_out(
        output_error.fit_output_error(experiment.model, experiment.trials, parameters=parameters)
    )


def steady(trial: Trial) -> NDArray[np.bool_]:
    """The last two thirds of a run, by when it turns steadily."""
    return trial.time_s > trial.time_s[0] + (trial.time_s[-1] - trial.time_s[0]) / 3


def turning(result: FitResult, role: str) -> Array:
    """Bias, measured and simulated mean yaw rate of each biased run, shape (runs, 3)."""
    rows = []
    for trial in result.trials:
        bias = trial.swim.beat.bias_rad
        if trial.role == role and bias != 0:
            (series,) = (s for s in result.series if (s.trial, s.channel) == (trial.id, "yaw_rate_rad_s"))
            late = steady(trial)
            rows.append((bias, series.measured[late].mean(), series.simulated[late].mean()))
    return np.array(rows)


def beside_trend_and_beat(time_s: Array, values: Array, frequency_hz: float) -> float:
    """Size of what is neither a cubic trend nor a harmonic of the beat: no model of a swimmer has it."""
    angle = 2 * np.pi * frequency_hz * time_s
    trend = np.vander((time_s - time_s[0]) / (time_s[-1] - time_s[0]), 4)
    design = np.column_stack([trend, np.cos(angle), np.sin(angle), np.cos(2 * angle), np.sin(2 * angle)])
    weights, *_ = np.linalg.lstsq(design, values, rcond=None)
    return float(np.sqrt(np.sum((values - design @ weights) ** 2) / (len(values) - design.shape[1])))


@pytest.mark.slow
class TestFish:
    def test_every_coefficient_is_identified(self, fish: FitResult) -> None:
        shared = [label for label in fish.labels if "[" not in label]
        assert shared == ["c_v", "J", "c_f", "c_d", "m_e", "m_t"]
        assert all(fish.status[name] == "estimated" for name in shared)
        for name in shared:
            # axial drag is the smallest force on a fish that gains speed to the end of its run
            share = 0.4 if name == "c_f" else 0.2
            assert (fish.stderr(name) or np.inf) < share * fish.value(name), name

    def test_surge_of_runs_held_out(self, fish: FitResult) -> None:
        """At most 12 % of the range over all of them, and little above what no model can have."""
        held_out = [s for s in fish.series if s.role == "validate" and s.channel == "u_m_s"]
        whole = fit_common.compute_score(
            *(np.concatenate([getattr(s, w) for s in held_out]) for w in ("measured", "simulated"))
        )
        assert whole.nrmse < 0.12
        beats = {t.id: t.swim.beat.frequency_hz for t in fish.trials}
        rest = [beside_trend_and_beat(s.time_s, s.residual, beats[s.trial]) for s in held_out]
        assert whole.rmse < 1.25 * np.sqrt(np.mean(np.square(rest)))
        each = [fit_common.compute_score(s.measured, s.simulated).nrmse for s in held_out]
        assert np.mean(each) < 0.12

    def test_the_fish_starts_from_rest(self, fish: FitResult) -> None:
        """No speed and no turn are told; larger beats swim faster."""
        values = np.array([fish.value(p.name) if not p.per_trial else 0.0 for p in fish.parameters])
        speeds = []
        for degrees in real_logs.AMPLITUDES_DEG:
            beat = TailBeat("sine", 2.0, np.radians(degrees))
            trial = Trial(f"rest{degrees}", "fit", np.linspace(0.0, 10.0, 301), {}, swim=SwimInput(beat))
            speeds.append(fish.model.simulate(values, trial)["u_m_s"][-30:].mean())
        assert 0.05 < speeds[0] < speeds[1] < speeds[2] < 0.4

    @pytest.mark.parametrize("role", ["fit", "validate"])
    def test_yaw_rate_against_bias(self, fish: FitResult, role: str) -> None:
        """A tail turned counter-clockwise turns the fish clockwise, at the measured rate within a tenth."""
        bias, measured, simulated = turning(fish, role).T
        assert np.all(np.sign(measured) == -np.sign(bias))
        assert np.all(np.sign(simulated) == -np.sign(bias))
        assert np.sum(simulated * measured) / np.sum(measured**2) == pytest.approx(1.0, abs=0.1)
        assert np.sqrt(np.mean((simulated - measured) ** 2)) < 0.15 * np.sqrt(np.mean(measured**2))
