"""Trials that begin in steady swimming: the limit cycle of the model, its speed, and fits."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from swimid.errors import InputError
from swimid.fitting.drives import TailBeat
from swimid.fitting.fit_common import load_experiment
from swimid.fitting.model import SwimInput, Trial
from swimid.swimmer import trials as swimmer
from tests.conftest import Ran
from tests.generators import three_link
from tests.generators.files import write_trials
from tests.lifted import Lifted, LiftedModel

BEAT = TailBeat("sine", 1.5, np.radians(25.0), ramp_s=0.5, phase_rad=0.7)


def _model(folder: Path, **drag: float) -> tuple[swimmer.Swimmer, np.ndarray]:
    _, model = swimmer.robot_model(str(three_link.robot(folder, **drag)))  # type: ignore[arg-type]
    values = np.array(
        [
            {**{p.name: p.start for p in model.parameters}, **model.get_file_values()}[p.name]
            for p in model.parameters
        ]
    )
    return model, values


def test_a_run_from_rest_settles_on_the_steady_run(tmp_path: Path) -> None:
    model, values = _model(tmp_path, c_d=2.0, c_f=0.2)
    time = np.arange(0.0, 60.0, 0.02)
    rest = model.simulate(values, Trial("rest", "fit", time, {}, swim=SwimInput(BEAT)))
    late = time > 58.0
    steady = model.simulate(
        values, Trial("steady", "fit", time[late], {}, swim=SwimInput(BEAT).make_steady())
    )
    for name in ("u_m_s", "v_m_s", "yaw_rate_rad_s", "joint1_rad"):
        np.testing.assert_allclose(steady[name], rest[name][late], atol=1e-5)
    cruise = model.cruise(values, Trial("any", "fit", time[:2], {}, swim=SwimInput(BEAT)))
    assert cruise is not None
    # three beats take 2 s
    way = np.hypot(*(rest[name][-1] - rest[name][-101] for name in ("x_m", "y_m")))
    assert cruise.speed_m_s == pytest.approx(way / 2.0, rel=0.01)


def test_the_phase_of_the_drive_moves_a_steady_run_along_its_cycle(tmp_path: Path) -> None:
    model, values = _model(tmp_path, c_d=2.0, c_f=0.2)
    time = np.arange(0.0, 2.0, 0.02)
    first = Trial("first", "fit", time, {}, swim=SwimInput(BEAT).make_steady())
    later = replace(first, id="later", time_s=time + 0.2)
    moved = values.copy()
    moved[model.index("drive_phase")] = 2.0 * np.pi * BEAT.frequency_hz * 0.2
    a, b = model.simulate(moved, first), model.simulate(values, later)
    np.testing.assert_allclose(a["u_m_s"], b["u_m_s"], atol=1e-6)


class Damped(Lifted):
    """A planar robot in the tables of the engine in space, with linear drag and damping off the plane."""

    def tables(self, values: np.ndarray) -> dict[str, Any]:
        found = super().tables(values)
        drag = found["drag"].copy()
        drag[:, 6 + self.across] = 0.5
        found["drag"] = drag
        found["damping_link"] = np.append(found["damping_link"], 0)
        found["damping"] = np.vstack([found["damping"], [0.0, 0.0, 0.0, 0.02, 0.02, 0.0]])
        return found


class DampedModel(LiftedModel):
    def _tree(self) -> Damped:  # type: ignore[override]
        assert self.robot.multilink is not None
        return Damped(self.robot.multilink, self.robot.fluid)


def test_steady_swimming_in_space_is_that_of_the_plane(tmp_path: Path) -> None:
    planar, values = _model(tmp_path, c_d=2.0, c_f=0.2)
    spatial = DampedModel(planar.robot)
    known = dict(zip((p.name for p in planar.parameters), values, strict=True))
    others = np.array([known.get(p.name, p.start) for p in spatial.parameters])
    trial = Trial("steady", "fit", np.arange(0.0, 2.0, 0.02), {}, swim=SwimInput(BEAT).make_steady())
    (a, b) = (m.cruise(v, trial) for m, v in ((planar, values), (spatial, others)))
    assert a is not None
    assert b is not None
    assert b.speed_m_s == pytest.approx(a.speed_m_s, rel=1e-6)
    assert b.settling_s == pytest.approx(a.settling_s, rel=1e-3)
    expected, found = planar.simulate(values, trial), spatial.simulate(others, trial)
    for name in ("x_m", "y_m", "yaw_rad", "u_m_s", "yaw_rate_rad_s", "joint1_rad"):
        np.testing.assert_allclose(found[name], expected[name], atol=1e-6, err_msg=name)


def test_without_drag_there_is_no_steady_swimming(tmp_path: Path) -> None:
    model, values = _model(tmp_path, c_d=0.0, c_f=0.0)
    trial = Trial("steady", "fit", np.arange(0.0, 1.0, 0.02), {}, swim=SwimInput(BEAT).make_steady())
    assert not np.isfinite(model.simulate(values, trial)["u_m_s"]).any()
    cruise = model.cruise(values, trial)
    assert cruise is not None
    assert np.isnan(cruise.speed_m_s)
    assert np.isinf(cruise.settling_s)


def test_a_trial_without_a_drive_cannot_begin_in_steady_swimming(tmp_path: Path) -> None:
    three_link.robot(tmp_path)
    time = np.arange(0.0, 1.0, 0.05)
    table = np.column_stack((time, 0.1 * time, 0 * time, 0 * time, np.sin(time), np.cos(time)))
    header = "t_s,x_m,y_m,yaw_rad,joint1_rad,joint2_rad"
    np.savetxt(tmp_path / "a.csv", table, delimiter=",", header=header, comments="")
    trials = tmp_path / "trials.yaml"
    write_trials(trials, "free-swim", "fish.yaml", ["id: a, log: a.csv, start_state: steady"])
    with pytest.raises(InputError, match="has no 'drive'"):
        load_experiment(trials)


@pytest.mark.slow
def test_fits_of_records_that_begin_in_steady_swimming(tmp_path: Path, swimid: Callable[..., Ran]) -> None:
    three_link.robot(tmp_path)
    trials = three_link.write(tmp_path, [0.9, 1.3, 1.7], steady_after_s=12.0, held_out=[1.3])
    ran = swimid("fit-graybox", trials, "--start-state", "steady", "-o", tmp_path / "fit.yaml")
    assert ran.status == 0
    found = yaml.safe_load((tmp_path / "fit.yaml").read_text())["parameters"]
    for name in ("c_d", "c_f"):
        assert found[name]["value"] == pytest.approx(three_link.TRUTH[name], abs=3.5 * found[name]["stderr"])
    ran = swimid("compare", trials, "--params", tmp_path / "fit.yaml", "-o", tmp_path / "cmp.yaml")
    assert "GOOD" in ran.out


@pytest.mark.slow
def test_compare_tests_the_cruising_speed_of_another_robot(
    tmp_path: Path, swimid: Callable[..., Ran]
) -> None:
    three_link.robot(tmp_path, c_d=0.0, c_f=0.0, free=False, name="dead")
    trials = three_link.write(tmp_path, [1.1, 1.6], steady_after_s=12.0, robot_file="dead.yaml")
    dead = tmp_path / "dead_fit.yaml"
    dead.write_text(
        "format: swimid-parameters/1\nmodel: multilink\nrobot: dead.yaml\nparameters:\n"
        "  c_d: {value: 0.0, unit: '1', bounds: [0, 5], status: fixed}\n"
        "  c_f: {value: 0.0, unit: '1', bounds: [0, 0.5], status: fixed}\n"
        "  initial_surge[none]: {value: 0.0, unit: m/s, bounds: [null, null], status: estimated}\n"
    )
    ran = swimid("compare", trials, "--params", dead, "-o", tmp_path / "cmp.yaml")
    assert "has no steady speed" in ran.out
    assert "BAD:" in ran.out
