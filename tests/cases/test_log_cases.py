"""Recorded inputs of logs, rigs and swimmers, with their true values."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml

from tests.conftest import Ran
from tests.test_rig_trials import near, parameter

Case = Callable[..., Path]
Run = Callable[..., Ran]


def imported(swimid: Run, source: str) -> dict:
    """Import a log and return the result with the warning codes."""
    ran = swimid("import", source, "-o", "out.csv", "--json")
    assert ran.status == 0, ran.err
    return ran.json["result"]


@pytest.mark.parametrize(
    "name", ["angle_rad", "fin_angle_rad", "force_N", "tail_rad", "tip_m", "y_m", "y_offset_m"]
)
def test_any_channel_shows_the_stroke(name: str, case: Case, swimid: Run) -> None:
    case("p-stroke-by-name")
    assert imported(swimid, f"{name}.csv")["stroke"]["frequency_hz"] == pytest.approx(0.9, abs=1e-3)


@pytest.mark.parametrize("kind", ["a ship of 161 m", "a step of 5.5 s"])
def test_a_stated_unit_is_believed(
    kind: str, tmp_path: Path, swimid: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    rng = np.random.default_rng(0)
    time = np.arange(0.0, 161.5, 0.5) if kind.startswith("a ship") else np.arange(0.0, 2500.0, 5.5)
    speed = 1.0 if kind.startswith("a ship") else 0.02
    frame = pd.DataFrame({"t_s": time, "x_m": speed * time + rng.normal(0, 0.01, len(time))})
    frame.to_csv("log.csv", index=False, float_format="%.4f")
    assert imported(swimid, "log.csv")["verdict"]["level"] == "caution"


@pytest.mark.parametrize("command", [("track", "imu"), ("import",)])
def test_three_components_of_a_quaternion_are_refused(
    case: Case, swimid: Run, command: tuple[str, ...]
) -> None:
    case("t4-three-of-four-quaternions")
    ran = swimid(*command, "imu.csv", "--map", "three.yaml", "-o", "o.csv")
    assert ran.status == 3
    assert "'qz'" in ran.err


@pytest.mark.slow
@pytest.mark.parametrize(("log", "low"), [("imu_low", True), ("imu_right", False)])
def test_the_scale_of_a_gyroscope_is_reported_beside_a_camera(
    case: Case, swimid: Run, log: str, low: bool
) -> None:
    case("t4-o10-gyro-scale")
    ran = swimid("track", "imu", f"{log}.csv", "--with", "camera.csv", "-o", "run.csv")
    assert ran.status == 0
    assert ("the gyroscope reads 0.87" in ran.err.replace("\n    ", " ")) == low


@pytest.mark.slow
def test_a_thruster_of_the_other_sign_is_named(case: Case, swimid: Run) -> None:
    case("t4-o15-thruster-reversed")
    ran = swimid("fit-graybox", "rev.yaml", "-o", "new.yaml", "--max-iterations", "30")
    assert "the sign of thrust3_N changed in all trials" in " ".join((ran.out + ran.err).split())


def codes(ran: Ran) -> list[str]:
    """Return the codes of the warnings on stderr."""
    return [line.split()[1].rstrip(":") for line in ran.err.splitlines() if line.startswith("warning SWM")]


def yaw_error(output: str) -> np.ndarray:
    """Return the heading less the true one, from the same start, rad."""
    truth = np.loadtxt("truth.csv", delimiter=",")
    found = pd.read_csv(output, comment="#")
    error = found["yaw_rad"] - np.interp(found["t_s"], truth[:, 0], truth[:, 3])
    return np.asarray(error - error.iloc[0])


@pytest.mark.slow
@pytest.mark.parametrize("log", ["mag_sparse.csv", "mag_hold.csv"])
def test_a_slow_magnetometer_holds_the_heading(log: str, case: Case, swimid: Run) -> None:
    case("c-29-magnetometer-at-a-fifth-of-the-rate", "gen.py")
    ran = swimid("track", "imu", log, "-o", "o.csv")
    assert "SWM080" not in codes(ran)
    assert "attitude gyroscope, accelerometer and magnetometer" in " ".join(ran.out.split())
    assert np.abs(yaw_error("o.csv")).max() < 0.02


def test_a_linear_drag_has_a_terminal_speed(case: Case, swimid: Run) -> None:
    case("r-linear-drag-no-terminal-speed", "make.py")
    linear = ("--free", "linear_drag", "--fix", "drag_coefficient=0", "--fix", "added_mass=0")
    ran = swimid("fit-drag", "t.yaml", *linear, "--json")
    assert parameter(ran, "terminal_speed[t1]")["value"] == pytest.approx(0.0278, rel=1e-3)
    assert "SWM024" not in ran.err
    assert "SWM024" not in swimid("fit-drag", "t.yaml").err


@pytest.mark.slow
def test_a_body_towed_backwards(case: Case, swimid: Run) -> None:
    case("c-31-towed-backwards", "gen.py")
    ran = swimid("fit-drag", "back.yaml", "--json")
    assert near(ran, "drag_coefficient", 0.705)
    assert near(ran, "added_mass", 0.684)
    assert "SWM024" not in ran.err
    assert "SWM110" not in ran.err


@pytest.mark.slow
def test_a_coefficient_that_nothing_uses_has_no_share(case: Case, swimid: Run) -> None:
    case("c-34-sobol-of-nothing")
    assert swimid("sensitivity", "tr.yaml", "--samples", "500", "-o", "s.yaml").status == 2
    ranges = ("--range", "c_n=1,3", "--range", "c_a=0.1,0.6", "--range", "c_x=0,4")
    chosen = ("--coefficients", "c_n,c_a,c_x", "--samples", "64")
    ran = swimid("sensitivity", "tr.yaml", *ranges, *chosen, "-o", "s.yaml")
    assert ran.status == 0
    outputs = yaml.safe_load(Path("s.yaml").read_text())["outputs"]
    shares = [o["shares"]["c_x"] for o in outputs if "c_x" in o.get("shares", {})]
    assert shares
    assert all(s["total"]["value"] == 0.0 for s in shares)


@pytest.mark.slow
def test_errors_do_not_depend_on_the_direction_or_on_a_wrapped_heading(case: Case, swimid: Run) -> None:
    case("t4-o16-heading-invariance")
    ran = swimid("fit-graybox", "as/trials.yaml", "--share", "c_f", "-o", "new.yaml")
    assert "GOOD:" in ran.out
    errors = []
    for name in ("as", "r90", "r180wrap", "r217wrap"):
        ran = swimid("compare", f"{name}/trials.yaml", "--params", "new.yaml", "-o", f"new_{name}.yaml")
        assert "GOOD:" in ran.out
        assert "SWM002" not in ran.err
        channels = yaml.safe_load(Path(f"new_{name}.yaml").read_text())["channels"]
        errors.append([channels[c]["rmse"] for c in ("x_m", "y_m", "yaw_rad")])
    for turned in errors[1:]:
        assert turned == pytest.approx(errors[0], rel=1e-3)
