"""Choice of the integration step: it is halved until samples hardly change, and no further."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from swimid.fitting import drives, output_error
from swimid.fitting.model import SwimInput, Trial, choose_parameters
from swimid.fitting.problem import choose_step
from swimid.robots import file as robot_format
from swimid.swimmer.planar.model import MultilinkModel
from tests.test_simulate import LIGHT_FIN

pytestmark = pytest.mark.kernels
SWIM = SwimInput(drives.TailBeat("sine", 2.0, math.radians(20.0)), pose=(0.0, 0.0, 0.0))
TRIAL = Trial("swim", "fit", np.arange(0.0, 3.0, 0.02), {}, swim=SWIM)


def given(model: MultilinkModel) -> np.ndarray:
    return np.array([model.get_file_values().get(p.name, p.start) for p in model.parameters])


def test_a_smaller_noise_takes_a_smaller_step() -> None:
    model = MultilinkModel(robot_format.read("tfish"), max_step=0.02)
    run = (given(model), replace(TRIAL, measured={"x_m": np.zeros(len(TRIAL.time_s))}))
    found = [choose_step(model, [run], [{"x_m": sd}]) for sd in (math.inf, 1e-3, 1e-6)]
    assert found[0].halvings == 0 <= found[1].halvings < found[2].halvings
    assert all(step.change <= 1.0 for step in found)
    for step in found:
        assert step.model.max_step == pytest.approx(0.02 / 2**step.halvings)


def test_a_simulation_that_no_step_saves_does_not_count() -> None:
    model = MultilinkModel(robot_format.read("tfish"))
    broken = given(model)
    broken[model.index("c_d4")] = 1e9
    step = choose_step(model, [(given(model), TRIAL), (broken, replace(TRIAL, id="broken"))])
    assert step.halvings == 0
    assert step.change == math.inf
    assert max(step.changes[0].values()) <= 1.0


def test_a_fit_whose_step_diverges_at_its_start_takes_a_smaller_one(tmp_path: Path) -> None:
    path = tmp_path / "tuna.yaml"
    path.write_text(LIGHT_FIN, encoding="utf-8")
    robot = robot_format.read(str(path))
    fine, model = MultilinkModel(robot, max_step=5e-4), MultilinkModel(robot, max_step=0.01)
    seen = fine.simulate(given(fine), TRIAL)
    assert not np.isfinite(model.run(given(model), TRIAL)["x_m"]).all()
    rng = np.random.default_rng(1)
    measured = {n: seen[n] + rng.normal(0.0, 2e-4, len(seen[n])) for n in ("x_m", "y_m", "yaw_rad")}
    held = choose_parameters(model.parameters, fixed={"k_t": 0.1}, freed=["c_d"])
    fit = output_error.fit_output_error(
        model, [replace(TRIAL, measured=measured)], parameters=held, jobs=1, tested=False
    )
    assert fit.model.swimmer.max_step < 0.01
    assert fit.step_error <= 0.1
    assert fit.value("c_d") == pytest.approx(1.2, abs=4 * (fit.stderr("c_d") or 0.0))
