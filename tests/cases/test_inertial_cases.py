"""Recorded inputs of inertial logs, rigs and comparisons."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pandas as pd
import pytest
import yaml

from tests.conftest import Ran

Case = Callable[..., Path]
Command = Callable[..., Ran]


def values(path: str) -> dict[str, float]:
    """Return the values of the parameters in a parameter file."""
    file = yaml.safe_load(Path(path).read_text())
    return {name: entry["value"] for name, entry in file["parameters"].items()}


@pytest.mark.parametrize("command", [("track", "imu"), ("import",)])
def test_three_components_of_a_quaternion_are_refused(
    case: Case, swimid: Command, command: tuple[str, ...]
) -> None:
    case("t4-three-of-four-quaternions")
    ran = swimid(*command, "imu.csv", "--map", "three.yaml", "-o", "o.csv")
    assert ran.status == 3
    assert "'qz'" in ran.err


@pytest.mark.slow
@pytest.mark.parametrize(("log", "fault"), [("glitches", "wild readings"), ("mild", "corrupt readings")])
def test_corrupt_readings_of_an_inertial_sensor_are_left_out(
    case: Case, swimid: Command, log: str, fault: str
) -> None:
    case("t4-o11-imu-glitches")
    ran = swimid("track", "imu", f"{log}.csv", "-o", "run.csv", "--json")
    assert ran.status == 0
    data = json.loads(ran.out)["result"]
    found = {one["fault"]: one["count"] for one in data["faults"]}
    assert found[fault] >= 15
    assert found["corrupt quaternions"] == 15
    assert data["attitude_from"] == "quaternion columns"
    assert data["still_periods"][0]["to_s"] > 4.0
    until = data["path_trusted"]["until_s"]
    assert until is None or until > 6.0


@pytest.mark.slow
@pytest.mark.parametrize(("log", "low"), [("imu_low", True), ("imu_right", False)])
def test_the_scale_of_a_gyroscope_is_reported_beside_a_camera(
    case: Case, swimid: Command, log: str, low: bool
) -> None:
    case("t4-o10-gyro-scale")
    ran = swimid("track", "imu", f"{log}.csv", "--with", "camera.csv", "-o", "run.csv")
    assert ran.status == 0
    assert ("the gyroscope reads 0.87" in ran.err.replace("\n    ", " ")) == low


def test_a_linear_drag_that_starts_at_its_bound_is_estimated(case: Case, swimid: Command) -> None:
    case("t4-coast-down-linear")
    held = ("--fix", "quadratic_drag=0", "--fix", "added_mass=0", "--free", "linear_drag")
    ran = swimid("fit-drag", "fine.yaml", *held, "-o", "f.yaml")
    assert ran.status == 0
    assert values("f.yaml")["linear_drag"] == pytest.approx(2.4, abs=0.03)


def test_lost_samples_written_as_zero_are_named(case: Case, swimid: Command) -> None:
    case("t4-lost-as-zero")
    ran = swimid("fit-drag", "trials.yaml", "-o", "f.yaml")
    assert ran.status == 3
    assert "is exactly 0 in 4 rows" in ran.err
    assert "missing: [0]" in ran.err


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["tow", "neg"])
def test_outliers_of_a_driving_force_are_interpolated(case: Case, swimid: Command, kind: str) -> None:
    case("t4-o02-loadcell-spikes")
    ran = swimid("fit-drag", f"{kind}.yaml", "-o", "new.yaml")
    assert ran.status == 0
    assert "outliers of force_N" in ran.err
    assert values("new.yaml")["quadratic_drag"] == pytest.approx(6.0, rel=1e-3)
    assert values("new.yaml")["added_mass"] == pytest.approx(0.8, abs=0.01)


@pytest.mark.slow
def test_the_start_state_of_a_trial_belongs_to_its_samples(case: Case, swimid: Command) -> None:
    case("t4-o16-heading-invariance")
    channels = []
    for name in ("swap", "noswap"):
        ran = swimid("compare", f"{name}.yaml", "--params", "as.yaml", "-o", f"new_{name}.yaml")
        assert ran.status == 0
        channels.append(yaml.safe_load(Path(f"new_{name}.yaml").read_text())["channels"])
    assert channels[0] == channels[1]
    assert channels[0]["y_m"]["nrmse"] < 0.08


@pytest.mark.slow
def test_a_thruster_of_the_other_sign_is_named(case: Case, swimid: Command) -> None:
    case("t4-o15-thruster-reversed")
    ran = swimid("fit-graybox", "rev.yaml", "-o", "new.yaml", "--max-iterations", "30")
    assert "the sign of thrust3_N changed in all trials" in " ".join((ran.out + ran.err).split())


@pytest.mark.slow
def test_a_fin_on_a_load_cell_can_be_diagnosed(case: Case, swimid: Command) -> None:
    case("t4-diagnose-load-cell-crash")
    ran = swimid("diagnose", "lc_ca2.trials.yaml", "--params", "f_lc_base.yaml", "-o", "gap.yaml")
    assert ran.status == 0
    cause = yaml.safe_load(Path("gap.yaml").read_text())["causes"][0]
    assert cause["effect"] == "parameter:c_a"
    assert cause["parameters"]["c_a"]["value"] == pytest.approx(1.6, rel=0.1)
    assert pd.Series(cause["parameters"]["c_a"])["from"] == pytest.approx(0.8, rel=0.1)
