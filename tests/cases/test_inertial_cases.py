"""Recorded inputs of inertial logs, rigs and comparisons."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from tests.conftest import Ran

Case = Callable[..., Path]
Command = Callable[..., Ran]


@pytest.mark.parametrize("command", [("track", "imu"), ("import",)])
def test_three_components_of_a_quaternion_are_refused(
    case: Case, swimid: Command, command: tuple[str, ...]
) -> None:
    case("t4-three-of-four-quaternions")
    ran = swimid(*command, "imu.csv", "--map", "three.yaml", "-o", "o.csv")
    assert ran.status == 3
    assert "'qz'" in ran.err


@pytest.mark.slow
@pytest.mark.parametrize(("log", "low"), [("imu_low", True), ("imu_right", False)])
def test_the_scale_of_a_gyroscope_is_reported_beside_a_camera(
    case: Case, swimid: Command, log: str, low: bool
) -> None:
    case("t4-o10-gyro-scale")
    ran = swimid("track", "imu", f"{log}.csv", "--with", "camera.csv", "-o", "run.csv")
    assert ran.status == 0
    assert ("the gyroscope reads 0.87" in ran.err.replace("\n    ", " ")) == low


@pytest.mark.slow
def test_a_thruster_of_the_other_sign_is_named(case: Case, swimid: Command) -> None:
    case("t4-o15-thruster-reversed")
    ran = swimid("fit-graybox", "rev.yaml", "-o", "new.yaml", "--max-iterations", "30")
    assert "the sign of thrust3_N changed in all trials" in " ".join((ran.out + ran.err).split())
