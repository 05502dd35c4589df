"""Recordings of the rig with a running clock, stops, holds, and friction that differs between trials."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tests.conftest import Ran
from tests.generators import rig as generator
from tests.generators.files import write_log, write_trials

Run = Callable[..., Ran]
STEP = 0.00785
WEIGHTS = range(10, 41, 5)
TRUTH = {"drag_coefficient": 0.705, "added_mass": 0.685, "pulley_friction": 0.0308}


@pytest.fixture(scope="module")
def clicks() -> dict[int, np.ndarray]:
    """Exact click times of every pulling weight, s."""
    return {w: generator.click_times(float(w)) for w in WEIGHTS}


def _write(folder: Path, logs: dict[int, tuple[np.ndarray, np.ndarray]]) -> Path:
    lines = []
    for w, (t, x) in logs.items():
        write_log(folder / f"w{w}.csv", {"t_s": t, "x_m": x}, "%.7f")
        lines.append(f"log: w{w}.csv, id: w{w}, pulling_mass_kg: {w / 1000}")
    return write_trials(folder / "trials.yaml", "falling-weight", "boxfish", lines)


def _near_truth(ran: Ran, sigmas: float = 4.0) -> None:
    assert ran.status == 0, ran.err
    for name, true in TRUTH.items():
        e = ran.json["result"]["parameters"][name]
        assert abs(e["value"] - true) < sigmas * e["stderr"] + 2e-3 * true, (name, e)


@pytest.mark.slow
@pytest.mark.parametrize("clock", [0.0, 5.0, 1234.5])
def test_clicks_on_a_clock_that_runs_on(swimid: Run, tmp_path: Path, clicks: dict, clock: float) -> None:
    """The first row is the first click, not the release, and the clock has any origin."""
    rng = np.random.default_rng(1)
    logs = {
        w: (clock + t[1:] + rng.normal(0, 1e-4, len(t) - 1), STEP * np.arange(1, len(t)))
        for w, t in clicks.items()
    }
    ran = swimid("fit-drag", _write(tmp_path, logs), "--json")
    _near_truth(ran)


def test_a_body_that_stops_at_the_wall(swimid: Run, tmp_path: Path, clicks: dict) -> None:
    """Two of the logs count the position from another origin."""
    rng = np.random.default_rng(2)
    logs = {}
    for w, exact in clicks.items():
        t = np.arange(0.3, exact[-1] + 1.5, 0.03)
        x = np.interp(t, exact, STEP * np.arange(len(exact)))
        logs[w] = (t, x + rng.normal(0, 1e-3, len(t)) + {20: 0.5, 30: -2.0}.get(w, 0.0))
    ran = swimid("fit-drag", _write(tmp_path, logs), "--json", "-v")
    assert ran.err.count("stands still") == len(clicks)
    p = ran.json["result"]["parameters"]
    # a chord instead of the arc between clicks is off by less than a tenth of a step
    assert p["drag_coefficient"]["value"] == pytest.approx(0.705, abs=0.02)
    assert p["added_mass"]["value"] == pytest.approx(0.685, abs=0.03)


def test_a_decay_that_is_held_before_its_release(swimid: Run, tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    (tmp_path / "buoy.yaml").write_text(
        "format: swimid-robot/1\nname: buoy\nbody: {inertial_mass_kg: 2.0}\nrig: {stiffness_N_m: 150}\n"
    )
    t = np.arange(0, 9, 0.01)
    run = solve_ivp(
        lambda _, s: [s[1], (-150 * s[0] - 1.5 * s[1] - 12 * s[1] * abs(s[1])) / 3.2],
        (0, 9), [0.05, 0], t_eval=t,
        rtol=1e-10, atol=1e-12,
    )  # fmt: skip
    z = np.concatenate((np.full(70, 0.05), run.y[0])) + rng.normal(0, 5e-4, len(t) + 70)
    times = 0.01 * np.arange(len(z))
    write_log(tmp_path / "d.csv", {"t_s": times, "z_m": z})
    write_trials(tmp_path / "t.yaml", "free-decay", "buoy.yaml", ["log: d.csv"])
    p = swimid("fit-drag", tmp_path / "t.yaml", "--json").json["result"]["parameters"]
    for name, true in (("added_mass", 1.2), ("quadratic_drag", 12.0), ("linear_drag", 1.5)):
        assert abs(p[name]["value"] - true) < 4 * p[name]["stderr"], name


def test_a_friction_that_differs_between_trials_is_named(swimid: Run, tmp_path: Path) -> None:
    """The friction scatters by 5 %."""
    rng = np.random.default_rng(0)
    logs = {}
    for w in WEIGHTS:
        t = generator.click_times(float(w), friction_mN=30.8 * (1 + 0.05 * rng.normal()))
        logs[w] = (np.sort(t + np.r_[0, rng.normal(0, 2e-3, len(t) - 1)]), STEP * np.arange(len(t)))
    ran = swimid("fit-drag", _write(tmp_path, logs))
    assert "SWM014: parameters differ between the trials: pulley_friction by" in ran.err
    assert "GOOD" not in ran.out


def test_an_encoder_other_than_the_robots(swimid: Run, tmp_path: Path, clicks: dict) -> None:
    logs = {}
    for w, exact in clicks.items():
        t = np.arange(0, exact[-1], 0.02)
        fine = np.interp(t, exact, STEP * np.arange(len(exact)))
        logs[w] = (t, np.floor(fine / 0.02) * 0.02)
    ran = swimid("fit-drag", _write(tmp_path, logs), "--json")
    assert ran.json["result"]["settings"]["encoder_rounding"] == "floor"
    assert ran.json["result"]["parameters"]["added_mass"]["value"] == pytest.approx(0.685, abs=0.02)


def test_a_linear_drag_is_suggested_and_no_moving_start(swimid: Run, tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    logs = {}
    for w in WEIGHTS:
        mass, force = 1.901 + w / 1000, w / 1000 * 9.8 - 0.0308
        t = np.arange(0, 5, 0.02)
        run = solve_ivp(
            lambda _, s, m=mass, f=force: [s[1], (f - 0.03 * s[1] - 2.453 * s[1] ** 2) / m],
            (0, 5), [0, 0], t_eval=t,
            rtol=1e-10, atol=1e-12,
        )  # fmt: skip
        logs[w] = (t, run.y[0] + rng.normal(0, 2e-4, len(t)))
    ran = swimid("fit-drag", _write(tmp_path, logs), "--json")
    assert "SWM024" in ran.err
    assert "SWM017" not in ran.err
    free = swimid("fit-drag", tmp_path / "trials.yaml", "--free", "linear_drag", "--json")
    assert free.json["result"]["parameters"]["linear_drag"]["value"] == pytest.approx(0.03, rel=0.1)


def test_a_value_outside_the_bounds_is_wrong_usage(swimid: Run, samples: Path) -> None:
    ran = swimid("fit-drag", samples / "rig" / "trials.yaml", "--fix", "drag_coefficient=-1")
    assert ran.status == 2
    assert "must lie between 0 and 5" in ran.err


@pytest.mark.slow
def test_a_release_between_two_samples_leaves_the_damping_right(swimid: Run, tmp_path: Path) -> None:
    """The last sample before the release is no sample of the decay, also in a log of few samples."""
    inertia, stiffness, linear, quadratic = 0.003, 0.3, 0.001, 0.0004

    def rates(_: float, s: np.ndarray) -> list[float]:
        return [s[1], (-stiffness * s[0] - linear * s[1] - quadratic * s[1] * abs(s[1])) / inertia]

    run = solve_ivp(rates, (0.0, 8.0), [0.4, 0.0], rtol=1e-10, atol=1e-12, dense_output=True, max_step=0.01)
    (tmp_path / "robot.yaml").write_text(
        "format: swimid-robot/1\nname: float\nbody: {roll_inertia_kg_m2: 0.002}\n"
        "rig: {roll_stiffness_N_m_rad: 0.3}\n"
    )
    lines = []
    lines += [f"id: r{k}, log: {k}.csv" for k in range(3)]
    write_trials(tmp_path / "trials.yaml", "free-decay", "robot.yaml", lines)
    time, errors = np.arange(0.0, 8.0, 0.04), []
    for seed in range(6):
        for k, release in enumerate((0.801, 0.811, 0.825)):
            noise = 4e-4 * np.random.default_rng([seed, k]).normal(size=len(time))
            write_log(
                tmp_path / f"{k}.csv",
                {"t_s": time, "roll_rad": run.sol(np.maximum(time - release, 0.0))[0] + noise},
            )
        ran = swimid("fit-drag", tmp_path / "trials.yaml", "--json")
        found = ran.json["result"]["parameters"]["quadratic_damping"]
        errors.append((found["value"] - quadratic) / found["stderr"])
    # the mean of six errors has a standard deviation of 0.41; with that sample it is 2.3
    assert abs(np.mean(errors)) < 1.3
