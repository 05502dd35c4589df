"""The sea lion swims in the package as in a simulator of other code, which makes the truth of its fits."""

from __future__ import annotations

import copy
import csv
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from tests.generators import sealion

STROKE_S = 2.9


def _swum(body: dict[str, Any], stroke: str, water: sealion.Water) -> dict[str, np.ndarray]:
    """Columns of one cycle by the other code, with the true coefficients."""
    time, motion = np.arange(88) / 30.0, sealion.stroke(body, stroke, STROKE_S)
    robot = sealion.Robot(body, sealion.Coefficients().values(), water)
    found = sealion.states(robot, motion, sealion.start_state(robot, motion), time, rtol=1e-9)
    return sealion.pose_columns(time, found)


def _package(swimid: Any, folder: Path, multibody: dict[str, Any], stroke: str) -> dict[str, np.ndarray]:
    """Columns of one cycle by ``swimid simulate``, with the true coefficients."""
    robot = yaml.safe_load(sealion.ROBOT_FILE.read_text())
    robot["multibody"] = copy.deepcopy(multibody)
    for name, value in sealion.Coefficients().values().items():
        robot["multibody"]["coefficients"][name]["value"] = value
    (folder / "robot.yaml").write_text(yaml.safe_dump(robot, sort_keys=False))
    ran = swimid(
        "simulate", "--robot", folder / "robot.yaml", "--stroke", stroke, "--cycles", 1, "--ramp-s", 0,
        "--duration-s", STROKE_S, "--sample-rate-hz", 30, "--dt", 0.001, "-o", folder / "run.csv",
    )  # fmt: skip
    assert ran.status == 0, ran.err
    with (folder / "run.csv").open() as lines:
        rows = list(csv.DictReader(line for line in lines if not line.startswith("#")))
    return {name: np.array([float(row[name]) for row in rows]) for name in rows[0]}


def test_mechanics_agree_with_the_package(swimid: Any, tmp_path: Path) -> None:
    """The same water in both, flippers out of step, so that the robot rolls, yaws and drifts.

    The tolerance is a thousandth of the camera's noise; the package's fixed steps of 1 ms cost less.
    """
    body = sealion.read_robot()
    angles = body["strokes"]["characteristic-pelvis"]["angles_deg"]
    angles["right_sweep"] = [0.3 * a for a in angles["right_sweep"]]
    angles["pelvis_yaw"] = [1.5 * a for a in angles["pelvis_pitch"]]
    ours = _swum(body, "characteristic-pelvis", sealion.Water(slices=None, smoothing_m_s=0.0))
    theirs = _package(swimid, tmp_path, body, "characteristic-pelvis")
    assert min(np.ptp(theirs[name]) for name in ("y_m", "roll_rad", "yaw_rad")) > 0.01
    for name in ("x_m", "y_m", "z_m", "roll_rad", "pitch_rad", "yaw_rad"):
        atol = 1e-3 * (sealion.POSITION_M if name.endswith("_m") else sealion.ANGLE_RAD)
        np.testing.assert_allclose(theirs[name], ours[name][: len(theirs[name])], atol=atol)


@pytest.mark.parametrize("stroke", ["characteristic", "characteristic-pelvis"])
def test_paths_agree_with_the_package(swimid: Any, tmp_path: Path, stroke: str) -> None:
    """Its eight strips and three a flipper against slices, and so on: a few per cent of the way."""
    theirs = _package(swimid, tmp_path, sealion.read_robot(), stroke)
    ours = _swum(sealion.read_robot(), stroke, sealion.Water())
    ours = {k: v[: len(theirs["x_m"])] for k, v in ours.items()}
    way = np.hypot(np.diff(ours["x_m"]), np.diff(ours["z_m"])).sum()
    apart = np.hypot(ours["x_m"] - theirs["x_m"], ours["z_m"] - theirs["z_m"]).max()
    assert apart < 0.04 * way
