"""swimid track imu on bodies that turn fast, stop and go, and on sensors as they are sold."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from swimid.inertial import estimate
from tests.conftest import Ran
from tests.generators import rigid
from tests.test_imu import BAND, VELOCITY, rms, save, table

VELOCITY_SD = ["vx_sd_m_s", "vy_sd_m_s", "vz_sd_m_s"]
PLACE, PLACE_SD = ["x_m", "y_m"], ["x_sd_m", "y_sd_m"]


def track(
    swimid: Callable[..., Ran],
    folder: Path,
    run: rigid.Run,
    *options: Any,
    camera: dict[str, np.ndarray] | None = None,
) -> tuple[dict[str, Any], pd.DataFrame]:
    """The result with its warning codes under "codes", and the log."""
    log = save(folder / "imu.csv", run.columns())
    more = [] if camera is None else ["--with", save(folder / "camera.csv", camera)]
    ran = swimid("track", "imu", log, *more, *options, "-o", folder / "run.csv", "--json")
    assert ran.status == 0, ran.err
    result = ran.json["result"] | {"codes": [w["code"] for w in ran.json["warnings"]]}
    return result, table(folder / "run.csv")


def tilt_error(run: rigid.Run, found: pd.DataFrame) -> np.ndarray:
    """Angle between true and found vertical, degrees."""
    told = Rotation.from_quat(found[["qx", "qy", "qz", "qw"]].to_numpy())
    up = told.inv().apply([0.0, 0.0, 1.0])
    return np.degrees(np.arccos(np.clip(np.sum(up * run.attitude[:, 2], axis=1), -1, 1)))


def verdict(folder: Path) -> str:
    return str(json.loads((folder / "run.evidence.json").read_text())["verdict"]["level"])


def inside(error: np.ndarray, sd: np.ndarray) -> float:
    return float(np.mean(np.abs(error) <= BAND * sd))


# ---------------------------------------------------------------- the generator


def test_the_generator_agrees_with_its_own_integral() -> None:
    """Readings without errors, integrated at 1 kHz, give back the closed motion."""
    run = rigid.tumbling(np.random.default_rng(0), unit=rigid.PERFECT, turn_s=4.0)
    step = run.time_s[1]
    middle = 0.5 * (run.rate[1:] + run.rate[:-1])
    turned = Rotation.from_matrix(run.attitude)
    # over one step the turn is the mean rate, to the third order of the step
    once = (turned[:-1].inv() * turned[1:]).as_rotvec() / step
    assert np.max(np.abs(once - middle)) < 0.01 * np.max(np.abs(middle))
    force = turned.apply(run.acceleration) - [0.0, 0.0, rigid.G]
    velocity = np.cumsum(force, axis=0) * step
    assert rms(velocity - run.velocity) < 0.05


# ---------------------------------------------------------------- fast turning, then rests


@pytest.mark.parametrize(
    ("unit", "pace"),
    [(rigid.POOR, 1.0), pytest.param(rigid.Unit(), 2.0, marks=pytest.mark.slow)],
    ids=["chip", "27 rad_s"],
)
@pytest.mark.slow
def test_rests_after_a_minute_of_fast_turning_leave_the_attitude_good(
    unit: rigid.Unit, pace: float, swimid: Callable[..., Ran], tmp_path: Path
) -> None:
    run = rigid.tumbling(np.random.default_rng(0), unit=unit, pace=pace)
    result, found = track(swimid, tmp_path, run)
    tilt = tilt_error(run, found)
    speed = np.linalg.norm(found[VELOCITY], axis=1)
    error = found[VELOCITY].to_numpy() - run.velocity
    print(f"tilt {np.sqrt(np.mean(tilt**2)):.1f} deg rms, {tilt.max():.1f} at most, {speed.max():.1f} m/s")
    # where turns add up errors of scale the accelerometer holds the tilt: to its bias (2.3 deg for 40 mg),
    # doubled for what accelerations add
    assert np.sqrt(np.mean(tilt**2)) < 5.0
    assert inside(error, found[VELOCITY_SD].to_numpy()) >= 0.9
    assert "SWM084" not in result["codes"]
    assert not {"turn-rate unit", "unconfirmed turn rates"} & {f["fault"] for f in result["faults"]}


def test_a_rest_in_which_it_turns_is_refused(swimid: Callable[..., Ran], tmp_path: Path) -> None:
    """Declared in the middle of a tumble."""
    run = rigid.tumbling(np.random.default_rng(1), turn_s=20.0)
    log = save(tmp_path / "imu.csv", run.columns())
    ran = swimid("track", "imu", log, "--still", 10, 14, "-o", tmp_path / "run.csv")
    assert ran.status == 3
    assert "10 to 14 s" in ran.err


@pytest.mark.slow
def test_a_stated_rest_in_mid_swim_is_not_used(swimid: Callable[..., Ran], tmp_path: Path) -> None:
    """Declared while the robot swims a circle and beats: it turns there against its true rests."""
    run = rigid.swim(np.random.default_rng(0), unit=rigid.Unit(), swim_s=12.0)
    result, found = track(swimid, tmp_path, run, "--still", 8, 11)
    tilt = tilt_error(run, found)
    print(f"tilt at most {tilt.max():.1f} deg")
    assert tilt.max() < 1.0
    assert "rests" in [f["fault"] for f in result["faults"]]
    assert "SWM080" in result["codes"]
    assert [p["used_as_rest"] for p in result["still_periods"]] == [True, True]


@pytest.mark.slow
def test_impossible_samples_are_empty(swimid: Callable[..., Ran], tmp_path: Path) -> None:
    """A robot said never to exceed 4 cm/s swims at 30."""
    run = rigid.swim(np.random.default_rng(2), unit=rigid.Unit(), swim_s=6.0)
    result, found = track(swimid, tmp_path, run, "--top-speed-m-s", 0.04)
    empty = found[[*VELOCITY, "x_m", "u_m_s", "vx_sd_m_s"]].isna().to_numpy()
    assert empty.any()
    assert (empty.all(axis=1) == empty.any(axis=1)).all()
    assert found[["roll_rad", "pitch_rad", "yaw_rad"]].notna().to_numpy().all()
    assert np.nanmax(np.linalg.norm(found[VELOCITY], axis=1)) <= 0.5 * 6 * 0.04
    assert "SWM086" in result["codes"]
    assert result["impossible"]
    assert verdict(tmp_path) == "bad"
    assert swimid("report", tmp_path / "run.csv", "-o", tmp_path / "report.html").status == 0


@pytest.mark.slow
@pytest.mark.parametrize("fused", [False, True], ids=["alone", "camera"])
def test_of_an_impossible_motion_only_the_attitude_is_written(
    fused: bool, swimid: Callable[..., Ran], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(estimate, "find_contradictions", lambda *_: ["it hovers upside down"])
    rng = np.random.default_rng(2)
    run = rigid.swim(rng, unit=rigid.Unit(), swim_s=6.0, rest_s=2.5, rate_hz=50.0)
    camera = rigid.camera(run, rng, rate_hz=10.0) if fused else None
    result, found = track(swimid, tmp_path, run, camera=camera)
    assert found[[*VELOCITY, *PLACE, "z_m", "u_m_s", *PLACE_SD]].isna().to_numpy().all()
    assert np.sqrt(np.mean(tilt_error(run, found) ** 2)) < 2.0
    assert "SWM086" in result["codes"]
    assert verdict(tmp_path) == "bad"
    assert swimid("report", tmp_path / "run.csv", "-o", tmp_path / "report.html").status == 0


# ---------------------------------------------------------------- rests of sensors as they are sold


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_true_rests_agree_with_a_poor_sensor(seed: int, swimid: Callable[..., Ran], tmp_path: Path) -> None:
    run = rigid.stop_and_go(np.random.default_rng(seed), unit=rigid.POOR, legs=2)
    result, found = track(swimid, tmp_path, run, "--rest", "all")
    print(f"innovations {result['rest_innovation_rms']:.2f}")
    assert "SWM084" not in result["codes"]
    assert "SWM086" not in result["codes"]
    assert inside(found[VELOCITY].to_numpy() - run.velocity, found[VELOCITY_SD].to_numpy()) >= 0.9


@pytest.mark.slow
def test_the_log_shows_the_class_of_the_sensor(swimid: Callable[..., Ran], tmp_path: Path) -> None:
    """A tumble shows the errors of a poor chip, and of a good unit that it is one."""
    for unit, chip in ((rigid.POOR, True), (rigid.Unit(), False)):
        run = rigid.tumbling(np.random.default_rng(0), unit=unit, turn_s=30.0)
        result, _ = track(swimid, tmp_path, run, "--force")
        assert ("sensor class" in [f["fault"] for f in result["faults"]]) is chip


@pytest.mark.slow
def test_a_chip_that_warms_up_keeps_its_rests(swimid: Callable[..., Ran], tmp_path: Path) -> None:
    """Biases that walk by 4 mg and 0.4 deg/s in 100 s: true rests are used, and the band holds the truth."""
    unit = replace(rigid.CHEAP, acceleration_drift=4 * rigid.MG, rate_drift=0.4 * rigid.DEG)
    run = rigid.stop_and_go(np.random.default_rng(2), unit=unit, legs=3)
    result, found = track(swimid, tmp_path, run, "--rest", "all")
    faults_found = {f["fault"]: f["text"] for f in result["faults"]}
    assert "warms up" in faults_found["sensor class"]
    assert "rests" not in faults_found
    assert inside(found[VELOCITY].to_numpy() - run.velocity, found[VELOCITY_SD].to_numpy()) >= 0.9


# ---------------------------------------------------------------- a camera on the same clock


@pytest.mark.slow
@pytest.mark.parametrize(
    ("yaw_sd", "unit"),
    [(0.005, rigid.Unit()), pytest.param(None, rigid.CHEAP, marks=pytest.mark.slow)],
    ids=["yaw", "path"],
)
def test_equal_clocks_are_found_in_fast_turning(
    yaw_sd: float | None, unit: rigid.Unit, swimid: Callable[..., Ran], tmp_path: Path
) -> None:
    rng = np.random.default_rng(0)
    run = rigid.fast_turning(rng, unit=unit, turn_s=10.0, rest_s=2.5)
    result, found = track(swimid, tmp_path, run, camera=rigid.camera(run, rng, yaw_sd=yaw_sd, rate_hz=20.0))
    fusion = result["fusion"]
    error = found[PLACE].to_numpy() - run.position[:, :2]
    print(
        f"offset {1e3 * fusion['clock_offset_s']:.2f} ms, rms {1e3 * rms(error):.2f} mm, {fusion['held_out']}"
    )
    assert fusion["clock_offset_s"] == 0.0
    assert fusion["clocks_agree"]
    low, high = fusion["clock_offset_95_s"]
    assert low <= 0 <= high
    assert high - low < (0.004 if yaw_sd else 0.015)
    assert fusion["fixes_stray"] == 0
    assert "SWM083" not in result["codes"]
    assert rms(error) < 0.001
    assert inside(error, found[PLACE_SD].to_numpy()) >= 0.9
    assert fusion["held_out"]["deviations"] < 1.5


@pytest.mark.slow
def test_a_clock_offset_is_found_in_fast_turning(swimid: Callable[..., Ran], tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    run = rigid.fast_turning(rng, unit=rigid.Unit(), turn_s=10.0, rest_s=2.5)
    result, found = track(swimid, tmp_path, run, camera=rigid.camera(run, rng, late_s=0.035, yaw_sd=0.005))
    fusion = result["fusion"]
    low, high = fusion["clock_offset_95_s"]
    assert low <= 0.035 <= high
    assert abs(fusion["clock_offset_s"] - 0.035) < 0.002
    assert "SWM083" in result["codes"]
    assert rms(found[PLACE].to_numpy() - run.position[:, :2]) < 0.002


@pytest.mark.slow
def test_a_reflection_tracked_for_seconds_is_reported(swimid: Callable[..., Ran], tmp_path: Path) -> None:
    """A sixth of the track is of something else: no good verdict, and a warning."""
    rng = np.random.default_rng(3)
    run = rigid.swim(rng, unit=rigid.CHEAP, swim_s=14.0, rest_s=3.0)
    camera = rigid.camera(run, rng, rate_hz=20.0)
    wrong = (camera["t_s"] > 9) & (camera["t_s"] < 12)
    camera["x_m"][wrong] += 0.4
    camera["y_m"][wrong] -= 0.3
    result, _ = track(swimid, tmp_path, run, camera=camera)
    fusion = result["fusion"]
    print(fusion["fixes_stray"], fusion["widened_by_lasting_errors"], fusion["held_out"], verdict(tmp_path))
    assert "SWM087" in result["codes"]
    assert verdict(tmp_path) == "bad"


@pytest.mark.slow
def test_a_poor_chip_and_a_camera_are_fused(swimid: Callable[..., Ran], tmp_path: Path) -> None:
    """Fast turning with scales off by 2 %: neither path nor turns look alike, but left-out fixes do."""
    rng = np.random.default_rng(0)
    run = rigid.fast_turning(rng, unit=rigid.POOR, turn_s=33.0)
    result, found = track(swimid, tmp_path, run, camera=rigid.camera(run, rng))
    assert result["fusion"]["clocks_agree"]
    assert rms(found[PLACE].to_numpy() - run.position[:, :2]) < 0.001
