"""Tests whether the answer of a search is a minimum: starts around it must lead back to it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from swimid.fitting import global_search, output_error
from swimid.fitting.fit_common import load_experiment
from swimid.fitting.model import Array, Channel, Model, Parameter, Trial, choose_parameters
from swimid.notices import SwimidWarning
from swimid.rig import model
from tests.conftest import Ran
from tests.generators import rig as generator
from tests.generators.files import write_log, write_trials
from validation.real_gaps.rows import screw_drive

Run = Callable[..., Ran]


class Terrace(Model):
    """A line whose slope acts in steps, between which the cost is flat."""

    name = "terrace"
    channels = (Channel("x_m", "m"),)

    def __init__(self, step: float) -> None:
        self.step = step
        self.parameters = (
            Parameter("slope", "1", -10.0, 10.0, 0.0, 1.0),
            Parameter("level", "m", -10.0, 10.0, 0.0, 1.0),
        )

    def simulate(self, values: Array, trial: Trial) -> dict[str, Array]:
        slope = np.floor(values[0] / self.step) * self.step + 1e-3 * values[0]
        return {"x_m": slope * trial.time_s + values[1]}


class Valley(Model):
    """A smooth cost with a bent valley: two standard errors along it lead far up its side."""

    name = "valley"
    channels = (Channel("x_m", "m"),)
    parameters = (Parameter("a", "1", -10.0, 10.0, 1.0, 1.0), Parameter("b", "1", -10.0, 10.0, 1.0, 1.0))

    def simulate(self, values: Array, trial: Trial) -> dict[str, Array]:
        a, b = values
        return {"x_m": 100.0 * (b - a**2) * np.sin(9 * trial.time_s) + a * np.cos(9 * trial.time_s)}


def _line(rng: np.random.Generator) -> list[Trial]:
    time = np.linspace(0.0, 1.0, 200)
    return [Trial("a", "fit", time, {"x_m": 2.0 * time + 0.5 + rng.normal(0, 0.05, 200)})]


def test_a_search_stuck_on_a_step_is_restarted_beside_it(rng: np.random.Generator) -> None:
    trials = _line(rng)
    alone = output_error.fit_output_error(Terrace(0.05), trials, tested=False)
    with pytest.warns(SwimidWarning, match="SWM073"):
        found = output_error.fit_output_error(Terrace(0.05), trials)
    assert found.restarts
    assert found.cost < 0.9 * alone.cost


def test_kinks_are_distinguished_from_bends(rng: np.random.Generator) -> None:
    """Stairs are searched with their own derivatives from many starts, and a bend is not."""
    time = np.linspace(0.0, 1.0, 200)
    measured = Valley().simulate(np.array([0.8, 0.6]), Trial("a", "fit", time, {}))["x_m"]
    data = [Trial("a", "fit", time, {"x_m": measured + rng.normal(0, 2.0, 200)})]
    bent = output_error.fit_output_error(Valley(), data, tested=False)
    stairs = output_error.fit_output_error(Terrace(0.05), _line(rng), tested=False)
    for seed in range(5):
        around = output_error.search_around(bent, seed=seed)
        assert not around.rough
        assert around.evaluations < 60
        assert output_error.search_around(stairs, seed=seed).rough


def test_every_simulation_of_a_fit_is_counted(rng: np.random.Generator) -> None:
    """Count also searches after a restart, and the tests of each answer."""
    counted = [0]

    class Counting(Terrace):
        def simulate(self, values: Array, trial: Trial) -> dict[str, Array]:
            counted[0] += 1
            return super().simulate(values, trial)

    with pytest.warns(SwimidWarning, match="SWM073"):
        found = output_error.fit_output_error(Counting(0.05), _line(rng))
    assert found.restarts
    assert found.evaluations == counted[0]
    counted[0] = 0
    several, _ = global_search.multistart(Counting(0.05), _line(rng), starts=3)
    assert several.evaluations == counted[0]


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
def test_dry_friction_in_a_driven_slide(tmp_path: Path, seed: int) -> None:
    """The likelihood of the answer is at least that of the truth, which is within four standard errors."""
    experiment = load_experiment(generator.write_slide(tmp_path, np.random.default_rng(seed)))
    choices = choose_parameters(
        experiment.model.parameters,
        fixed={"quadratic_drag": 0.0},
        freed=("linear_drag", "dry_friction", "force_offset"),
    )
    found = output_error.fit_output_error(experiment.model, experiment.trials, parameters=choices)
    truth = {"added_mass": 10.0, "linear_drag": 200.0, "dry_friction": 20.0, "force_offset": 3.0}
    for name, true in truth.items():
        error = found.stderr(name)
        assert error is not None
        assert abs(found.value(name) - true) < 4 * error, name
    # the start offset refers to the first sample of the log, which has noise
    first = experiment.trials[0].rig.x0
    known = {**truth, "start_offset[slide.csv]": -first, "initial_speed[slide.csv]": 0.0}
    point = np.array([known[label] for label in found.labels])
    there = output_error.evaluate_fit(found.model, experiment.trials, point, parameters=choices)
    assert found.samples * np.log(found.cost / there.cost) < 0.0
    assert found.noise["x_m"].value_sd == pytest.approx(1e-4, rel=0.1)


@pytest.mark.slow
def test_the_answer_does_not_depend_on_where_the_friction_starts(tmp_path: Path) -> None:
    experiment = load_experiment(generator.write_slide(tmp_path, np.random.default_rng(3)))
    choices = choose_parameters(
        experiment.model.parameters,
        fixed={"quadratic_drag": 0.0},
        freed=("linear_drag", "dry_friction", "force_offset"),
    )
    ends = []
    for start in (0.0, 5.0, 20.0, 40.0):
        begun = tuple(replace(p, start=start) if p.name == "dry_friction" else p for p in choices)
        ends.append(output_error.fit_output_error(experiment.model, experiment.trials, parameters=begun))
    least = min(end.cost for end in ends)
    for end in ends:
        # twice the log-likelihood may differ by two, less than for two standard errors
        assert end.samples * np.log(end.cost / least) < 2.0


def test_a_body_breaks_away_between_two_steps() -> None:
    """A force that grows by 1 N/s on 1 kg held by 0.505 N moves it as (t - 0.505)^3 / 6 from then on."""
    time = np.linspace(0.0, 1.0, 11)
    x, _ = model.integrate_rig(time, 0.0, 0.01, time, 0.0, 0.0, (1.0, 0.0, 0.0, 0.505, 0.0, 0.0, 0.0, 0.0))
    assert x == pytest.approx(np.maximum(time - 0.505, 0.0) ** 3 / 6, abs=1e-12)


def test_a_decay_that_sticks(swimid: Run, tmp_path: Path) -> None:
    """The solution is analytic between turning points: dry friction shifts the middle of each half swing.

    Every number of half swings before the body sticks has a minimum of its own.
    """
    inertia, stiffness, linear, dry = 3.5, 150.0, 1.0, 0.6
    (tmp_path / "buoy.yaml").write_text(
        "format: swimid-robot/1\nname: buoy\nbody: {inertial_mass_kg: 3.0}\nrig: {stiffness_N_m: 150}\n"
    )
    time = np.arange(0.0, 12.0, 0.01)
    rate, loss = np.sqrt(stiffness / inertia), linear / (2 * inertia)
    swing = np.sqrt(rate**2 - loss**2)
    x, place, start = np.empty(len(time)), 0.05, 0.0
    while abs(place) > dry / stiffness:
        middle = np.sign(place) * dry / stiffness
        t = time - start
        here = t >= 0
        x[here] = middle + (place - middle) * np.exp(-loss * t[here]) * (
            np.cos(swing * t[here]) + loss / swing * np.sin(swing * t[here])
        )
        start += np.pi / swing
        place = middle - (place - middle) * np.exp(-loss * np.pi / swing)
    x[time >= start] = place
    x += np.random.default_rng(0).normal(0, 2e-4, len(x))
    write_log(tmp_path / "d.csv", {"t_s": time, "z_m": x})
    write_trials(tmp_path / "t.yaml", "free-decay", "buoy.yaml", ["log: d.csv"])
    ran = swimid(
        "fit-drag", tmp_path / "t.yaml", "--free", "dry_friction", "--fix", "quadratic_drag=0", "--json"
    )
    p = ran.json["result"]["parameters"]
    for name, true in (("added_mass", 0.5), ("linear_drag", 1.0), ("dry_friction", 0.6)):
        assert abs(p[name]["value"] - true) < 4 * p[name]["stderr"], (name, p[name])
    assert ran.json["result"]["fit"]["channels"]["z_m"]["rmse"] == pytest.approx(2e-4, rel=0.1)


@pytest.mark.slow
def test_a_real_drive_with_dry_friction(real_data: Path, tmp_path: Path) -> None:
    """The published friction of a positioning system (Janot and others) is found from any start.

    The log is raw at 100 Hz. Published are 95.1 kg, 203.5 N s/m and 20.4 N, from the force and not from the
    position. Three standard errors and a tenth are allowed.
    """
    time, position, force = screw_drive.read(real_data / "emps" / "DATA_EMPS.mat")
    rows = np.c_[time, force, position][::10]
    np.savetxt(tmp_path / "d.csv", rows, delimiter=",", header="t_s,force_N,x_m", comments="")
    (tmp_path / "cart.yaml").write_text("format: swimid-robot/1\nname: cart\nbody: {inertial_mass_kg: 60}\n")
    write_trials(tmp_path / "t.yaml", "towed", "cart.yaml", ["log: d.csv"])
    experiment = load_experiment(tmp_path / "t.yaml")
    choices = choose_parameters(
        experiment.model.parameters,
        fixed={"quadratic_drag": 0.0},
        freed=("linear_drag", "dry_friction", "force_offset"),
    )
    ends = []
    for start in (0.0, 30.0):
        begun = tuple(replace(p, start=start) if p.name == "dry_friction" else p for p in choices)
        ends.append(output_error.fit_output_error(experiment.model, experiment.trials, parameters=begun))
    for found in ends:
        for name, published in (("added_mass", 35.1), ("linear_drag", 203.5), ("dry_friction", 20.4)):
            error = found.stderr(name)
            assert error is not None
            assert abs(found.value(name) - published) < 3 * error + 0.1 * published, name
    assert abs(ends[0].value("dry_friction") - ends[1].value("dry_friction")) < 0.2
