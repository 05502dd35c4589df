"""Differences between trials of a rig: random friction, an omitted force, a mistake in one trial."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml
from scipy.integrate import solve_ivp

from tests.conftest import Ran
from tests.generators import rig as generator

Run = Callable[..., Ran]
TRUTH = {"drag_coefficient": 0.705, "added_mass": 0.685, "pulley_friction": 0.0308, "linear_drag": 0.06}
WEIGHTS = tuple(range(10, 41, 5))


def verdict(ran: Ran) -> str:
    """Return the grade of the verdict, the last paragraph of the summary."""
    return ran.out.strip().split("\n\n")[-1].split(":")[0]


def parameter(ran: Ran, name: str) -> dict:
    """Return an estimate of the JSON result, or a quantity derived from estimates."""
    result = ran.json["result"]
    found: dict = {**result["parameters"], **result["derived"]}[name]
    return found


def near(ran: Ran, name: str, true: float, errors: float = 3.0) -> bool:
    """Return whether an estimate lies within so many of its standard errors of the truth."""
    e = parameter(ran, name)
    return bool(abs(e["value"] - true) <= errors * e["stderr"])


def _inside(ran: Ran, names: tuple[str, ...], sigmas: float = 3.0) -> None:
    for name in names:
        e = ran.json["result"]["parameters"][name]
        assert abs(e["value"] - TRUTH[name]) < sigmas * e["stderr"], (name, e)


@pytest.mark.slow
@pytest.mark.parametrize("weight, friction", [(20, 40.0), (40, 60.0), (10, 25.0)])
def test_one_odd_friction_is_named_beside_a_linear_drag(
    swimid: Run, tmp_path: Path, weight: int, friction: float
) -> None:
    """The message has the estimates without the odd trial, and the verdict is not good."""
    trials = generator.write_falls(
        tmp_path, np.random.default_rng(0), linear_N_s_m=0.06, odd={weight: {"friction_mN": friction}}
    )
    ran = swimid("fit-drag", trials, "--free", "linear_drag")
    assert ran.status == 0, ran.err
    words = " ".join(ran.err.split())
    found = re.search(f"w{weight} contradicts the other trials; without it: drag_coefficient (\\S+) ±", words)
    assert found
    assert float(found[1]) == pytest.approx(TRUTH["drag_coefficient"], abs=0.003)
    assert verdict(ran) != "GOOD"


def test_repeated_samples_of_a_log_are_left_out(swimid: Run, tmp_path: Path) -> None:
    """The log is written at twice the rate of the measurement."""
    trials = generator.write_falls(tmp_path, np.random.default_rng(3))
    for path in tmp_path.glob("w*.csv"):
        lines = path.read_text().splitlines()
        first = next(k for k, line in enumerate(lines) if line.startswith("t_s")) + 1
        rows = [line.split(",", 1) for line in lines[first:]]
        twice = [f"{t},{rows[k - k % 2][1]}" for k, (t, _) in enumerate(rows)]
        path.write_text("\n".join([*lines[:first], *twice]) + "\n")
    ran = swimid("fit-drag", trials, "--json")
    assert ran.status == 0, ran.err
    assert "repeat the previous position" in ran.err
    _inside(ran, ("drag_coefficient", "added_mass", "pulley_friction"))


def test_held_out_trials_are_predicted_despite_an_odd_one(swimid: Run, tmp_path: Path) -> None:
    trials = generator.write_falls(
        tmp_path,
        np.random.default_rng(0),
        linear_N_s_m=0.06,
        odd={20: {"friction_mN": 40.0}},
        held_out=(10, 40),
    )
    ran = swimid("fit-drag", trials, "--free", "linear_drag", "--json")
    fit = ran.json["result"]["fit"]
    assert fit["validation"]["channels"]["x_m"]["rmse"] < 10 * fit["channels"]["x_m"]["rmse"]
    assert "SWM015" not in ran.err
    _inside(ran, tuple(TRUTH))


def test_a_friction_that_grows_with_the_pulling_mass_is_no_random_effect(swimid: Run, tmp_path: Path) -> None:
    """The model lacks a linear drag, and one trial is odd: the trend is named, and the verdict is bad."""
    trials = generator.write_falls(
        tmp_path, np.random.default_rng(0), linear_N_s_m=0.06, odd={20: {"friction_mN": 40.0}}
    )
    ran = swimid("fit-drag", trials)
    assert "SWM070" in ran.err
    assert verdict(ran) == "BAD"


def test_an_omitted_drag_that_changes_the_estimates_is_bad(swimid: Run, tmp_path: Path) -> None:
    trials = generator.write_falls(tmp_path, np.random.default_rng(0), linear_N_s_m=0.06, held_out=(25,))
    assert verdict(swimid("fit-drag", trials)) == "BAD"
    assert verdict(swimid("fit-drag", trials, "--free", "linear_drag")) == "GOOD"


@pytest.mark.parametrize("stated, level", [(25.0, "CAUTION"), (120.0, "BAD")])
def test_a_mislabelled_weight_is_named(swimid: Run, tmp_path: Path, stated: float, level: str) -> None:
    """An error of a quarter could be friction; an error of a factor of six could not."""
    trials = generator.write_falls(tmp_path, np.random.default_rng(0), stated_g={20: stated})
    ran = swimid("fit-drag", trials)
    assert "w20 contradicts the other trials" in ran.err
    assert verdict(ran) == level


@pytest.mark.slow
def test_a_tow_with_another_gain_of_its_force_is_named(swimid: Run, tmp_path: Path) -> None:
    """Five tows of a body of 4 kg in all, 5 N s2/m2; the force of one is logged with another gain."""
    (tmp_path / "hull.yaml").write_text("format: swimid-robot/1\nname: hull\nbody: {inertial_mass_kg: 3.0}\n")
    rng, time = np.random.default_rng(0), np.arange(0, 15, 0.03)
    lines = ["format: swimid-trials/1", "experiment: towed", "robot: hull.yaml", "trials:"]
    for k in range(5):
        force = 2 * np.sin((1 + 0.3 * k) * time) + 1 + 0.5 * k
        run = solve_ivp(
            lambda s, y, force=force: [y[1], (np.interp(s, time, force) - 5 * y[1] * abs(y[1])) / 4],
            (0, 15), [0, 0], t_eval=time, rtol=1e-9, atol=1e-11, max_step=0.03,
        )  # fmt: skip
        rows = np.c_[time, force * (1.3 if k == 2 else 1.0), run.y[0] + rng.normal(0, 1e-3, len(time))]
        np.savetxt(tmp_path / f"{k}.csv", rows, delimiter=",", header="t_s,force_N,x_m", comments="")
        lines.append(f"  - {{log: {k}.csv, id: tow{k}}}")
    (tmp_path / "t.yaml").write_text("\n".join(lines) + "\n")
    ran = swimid("fit-drag", tmp_path / "t.yaml")
    assert "tow2 contradicts the other trials" in ran.err
    assert verdict(ran) != "GOOD"


@pytest.mark.parametrize("stated, level", [(20.0, "GOOD"), (20.2, "CAUTION"), (60.0, "BAD")])
def test_a_large_held_out_error_is_bad(swimid: Run, tmp_path: Path, stated: float, level: str) -> None:
    """The held-out errors are 1, about 5 and 250 times that of the fit."""
    trials = generator.write_falls(tmp_path, np.random.default_rng(0), stated_g={20: stated}, held_out=(20,))
    ran = swimid("fit-drag", trials)
    assert verdict(ran) == level
    assert ("largest in w20" in ran.err) is (level != "GOOD")


@pytest.mark.slow
def test_the_two_point_method_without_an_answer_is_an_error(swimid: Run, tmp_path: Path) -> None:
    trials = generator.write_falls(tmp_path, np.random.default_rng(0), stated_g={20: 120.0})
    ran = swimid("fit-drag", trials, "--method", "two-point")
    assert ran.status == 4
    assert "the two-point method has no answer" in ran.err
    assert "The two-point method has no answer" in swimid("fit-drag", trials).out


def test_late_releases_do_not_hide_an_omitted_drag(swimid: Run, tmp_path: Path) -> None:
    """The release of each trial is estimated, and the omitted drag is named."""
    rng = np.random.default_rng(0)
    lines = ["format: swimid-trials/1", "experiment: falling-weight", "robot: boxfish", "trials:"]
    for w, idle in zip(WEIGHTS, rng.uniform(0.3, 1.0, len(WEIGHTS)), strict=True):
        time = np.arange(0, 5, 0.02)
        x = np.zeros(len(time))
        moving = time > idle
        x[moving] = generator.fall(np.r_[0.0, time[moving] - idle], float(w), linear_N_s_m=0.06)[1:]
        rows = np.c_[time, x + rng.normal(0, 5e-4, len(time))]
        np.savetxt(tmp_path / f"w{w}.csv", rows, delimiter=",", header="t_s,x_m", comments="")
        lines.append(f"  - {{log: w{w}.csv, id: w{w}, pulling_mass_kg: {w / 1000}}}")
    (tmp_path / "t.yaml").write_text("\n".join(lines) + "\n")
    ran = swimid("fit-drag", tmp_path / "t.yaml")
    assert "SWM017" in ran.err
    assert "SWM024" in ran.err
    assert verdict(ran) == "BAD"


def test_the_measured_values_of_a_tracked_film_are_fitted(swimid: Run, tmp_path: Path) -> None:
    """A log of a film has smoothed positions, and the measured ones beside them."""
    trials = generator.write_falls(tmp_path, np.random.default_rng(3), noise_m=5e-4, held_out=(20,))
    plain = swimid("fit-drag", trials, "--json").json["result"]
    for path in tmp_path.glob("*.csv"):
        log = pd.read_csv(path)
        log["x_raw_m"] = log["x_m"]
        log["x_m"] = log["x_m"].rolling(9, center=True, min_periods=1).mean()
        text = log.to_csv(index=False, float_format="%.7f")
        path.write_text(f"# made_by: swimid track video\n{text}")
    tracked = swimid("fit-drag", trials, "--json").json["result"]
    assert tracked["parameters"] == plain["parameters"]


def test_a_column_of_the_same_name_in_another_log_is_not_fitted(swimid: Run, tmp_path: Path) -> None:
    """A raw reading in millimetres that a laboratory keeps beside its positions."""
    trials = generator.write_falls(tmp_path, np.random.default_rng(3), noise_m=5e-4, held_out=(20,))
    plain = swimid("fit-drag", trials, "--json").json["result"]
    for path in tmp_path.glob("*.csv"):
        log = pd.read_csv(path)
        log["x_raw_m"] = 1000 * log["x_m"]
        log.to_csv(path, index=False, float_format="%.7f")
    assert swimid("fit-drag", trials, "--json").json["result"]["parameters"] == plain["parameters"]


def rig(folder: Path, experiment: str, mass: float, log: str, entry: str = "") -> Path:
    """Write a robot, one log and a trials file, and return the trials file."""
    (folder / "boat.yaml").write_text(
        f"format: swimid-robot/1\nname: boat\nbody: {{inertial_mass_kg: {mass}}}\n"
    )
    (folder / "log.csv").write_text(log)
    text = f"format: swimid-trials/1\nexperiment: {experiment}\nrobot: boat.yaml\ntrials:\n"
    (folder / "trials.yaml").write_text(f"{text}  - {{log: log.csv{entry}}}\n")
    return folder / "trials.yaml"


def test_a_body_that_coasts_down_gives_its_linear_drag(
    swimid: Run, tmp_path: Path, rng: np.random.Generator
) -> None:
    """No force acts, and the search starts at a drag of 0, its bound: u = 1.2 exp(-3 t / 10)."""
    time = np.arange(0.0, 12.0, 0.1)
    speed = 1.2 * np.exp(-0.3 * time) + 0.01 * rng.normal(size=len(time))
    rows = [f"{t:.2f},0.0,{u:.5f}" for t, u in zip(time, speed, strict=True)]
    trials = rig(tmp_path, "towed", 10.0, "\n".join(["t_s,force_N,u_m_s", *rows]) + "\n")
    held = ("--fix", "quadratic_drag=0", "--fix", "added_mass=0", "--free", "linear_drag")
    ran = swimid("fit-drag", trials, *held, "-o", tmp_path / "f.yaml")
    assert ran.status == 0, ran.err
    drag = yaml.safe_load((tmp_path / "f.yaml").read_text())["parameters"]["linear_drag"]
    assert drag["value"] == pytest.approx(3.0, abs=0.1)
    assert drag["status"] == "estimated"


@pytest.mark.parametrize("lost", [slice(20, 22), slice(36, 40)])
def test_positions_that_return_to_exactly_zero_are_named(swimid: Run, tmp_path: Path, lost: slice) -> None:
    time = np.arange(0.0, 2.0, 0.05)
    place = 0.1 * time + 0.001
    place[lost] = 0.0
    rows = [f"{t:.2f},{x:.5f}" for t, x in zip(time, place, strict=True)]
    log = "\n".join(["t_s,x_m", *rows]) + "\n"
    ran = swimid(
        "fit-drag",
        rig(tmp_path, "falling-weight", 1.0, log, ", driving_force_N: 0.1"),
        "-o",
        tmp_path / "f.yaml",
    )
    assert ran.status == 3
    assert f"line {lost.start + 2}, 'x_m': is exactly 0 in {lost.stop - lost.start} rows" in ran.err


def test_a_mass_of_zero_is_refused(swimid: Run, tmp_path: Path) -> None:
    trials = rig(tmp_path, "towed", 0, "t_s,force_N,x_m\n0,1,0\n1,1,1\n2,1,2\n")
    ran = swimid("fit-drag", trials, "-o", tmp_path / "f.yaml")
    assert ran.status == 3
    assert "inertial_mass_kg" in ran.err


def test_spikes_of_a_towing_force_are_interpolated(
    swimid: Run, tmp_path: Path, rng: np.random.Generator
) -> None:
    """A body of 10 kg with a quadratic drag of 6 N s2/m2 is towed at a speed that varies."""
    time = np.arange(0.0, 8.0, 0.05)
    speed = 0.3 + 0.2 * np.sin(0.8 * time)
    force = 10.0 * 0.16 * np.cos(0.8 * time) + 6.0 * speed**2
    place = 0.3 * time + 0.25 * (1 - np.cos(0.8 * time)) + 0.001 * rng.normal(size=len(time))
    force[[30, 77, 120]] *= [-0.84, 100.0, -0.84]
    rows = [f"{t:.3f},{f:.5f},{x:.5f}" for t, f, x in zip(time, force, place, strict=True)]
    trials = rig(tmp_path, "towed", 10.0, "\n".join(["t_s,force_N,x_m", *rows]) + "\n")
    ran = swimid("fit-drag", trials, "--fix", "added_mass=0", "-o", tmp_path / "f.yaml")
    assert "3 outliers of force_N" in ran.err
    drag = yaml.safe_load((tmp_path / "f.yaml").read_text())["parameters"]["quadratic_drag"]
    assert drag["value"] == pytest.approx(6.0, rel=0.03)
