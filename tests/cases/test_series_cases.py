"""Recorded inputs of ``rwls`` and ``track imu``, with the values that should come out."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy import signal

from tests.conftest import Ran

Run = Callable[..., Ran]
Case = Callable[..., Path]


def evidence(output: str) -> dict[str, Any]:
    """Read the evidence beside an output in the working folder."""
    return json.loads(Path(output).with_suffix(".evidence.json").read_text())


def level(output: str) -> str:
    """Return the grade of a result."""
    return evidence(output)["verdict"]["level"]


def codes(ran: Ran) -> list[str]:
    """Return the codes of the warnings on stderr."""
    return [line.split()[1].rstrip(":") for line in ran.err.splitlines() if line.startswith("warning SWM")]


# ---------------------------------------------------------------- rwls


def test_a_model_of_an_unrelated_command_is_not_good(case: Case, swimid: Run) -> None:
    case("r-rwls-good-0pct", "make.py")
    columns = ("--input", "cmd", "--output", "y", "--na", 2, "--nb", 2, "--validate", 0.25)
    ran = swimid("rwls", "unrelated.csv", *columns, "-o", "u.yaml")
    assert ran.status == 0
    assert level("u.yaml") == "bad"
    assert "BAD: The free run does not reproduce the held-out output." in ran.out


def test_a_model_of_noise_is_not_good(case: Case, swimid: Run) -> None:
    case("r-diagnose-none-noise", "make.py")
    ran = swimid("rwls", "t.yaml", "--na", 3, "--nb", 2, "--validate", 0.25, "-o", "arx.yaml")
    assert ran.status == 0
    assert level("arx.yaml") in ("caution", "bad")
    assert "CAUTION: " in ran.out or "BAD: " in ran.out


def test_a_model_that_was_tested_on_its_own_data_alone_is_not_good(case: Case, swimid: Run) -> None:
    case("r-diagnose-none-unfit", "make.py")
    ran = swimid("rwls", "fit.yaml", "--na", 3, "--nb", 2, "-o", "arx.yaml")
    assert ran.status == 0
    assert level("arx.yaml") == "bad"
    assert "diverges" in ran.out.partition("BAD: ")[2]


def test_repeated_samples_are_named_and_the_poles_are_those_of_the_system(case: Case, swimid: Run) -> None:
    case("c-13-held-samples-in-rwls")
    columns = ("--input", "u_V", "--output", "y_m_s", "--na", 2, "--nb", 2, "--validate", 0.25)
    ran = swimid("rwls", "dup2.csv", *columns, "-o", "d.yaml", "--json")
    assert "SWM058" in [w["code"] for w in ran.json["warnings"]]
    result = ran.json["result"]
    assert result["sample_time_s"] == pytest.approx(0.02)
    largest = result["poles"][0]
    assert abs(largest["magnitude"] - np.sqrt(0.7)) < 3 * largest["stderr_magnitude"] < 0.003
    assert level("d.yaml") == "caution"
    assert "repeat the sample before" in evidence("d.yaml")["verdict"]["text"]


def test_logs_of_two_rates_are_refused(case: Case, swimid: Run) -> None:
    case("c-21-sample-times-that-differ")
    for trials, rates in (("two.yaml", ("0.01 s", "0.02 s")), ("two52.yaml", ("0.02 s",))):
        ran = swimid("rwls", trials, "--na", 1, "--nb", 1, "-o", "o.yaml")
        assert ran.status == 3
        assert all(rate in ran.err for rate in rates)
    assert swimid("rwls", "ok.yaml", "--na", 1, "--nb", 1, "-o", "ok.out.yaml").status == 0
    ran = swimid("simulate", "--params", "ok.out.yaml", "--input", "r100.csv", "-o", "x.csv")
    assert ran.status == 3


def test_offset_and_start_state_stay_right(case: Case, swimid: Run) -> None:
    case("c-22-offset-and-initial-state")
    columns = ("--input", "u_V", "--output", "y_m_s", "-o", "o.yaml", "--json")
    found = swimid("rwls", "offset.csv", *columns, "--na", 2, "--nb", 2).json["result"]["parameters"]
    for name, true in (("a1", -1.5), ("a2", 0.7), ("b1", 0.2), ("b2", 0.1)):
        assert abs(found[name]["value"] - true) < 3 * found[name]["stderr"]
    a1 = swimid("rwls", "ic.csv", *columns, "--na", 1, "--nb", 1).json["result"]["parameters"]["a1"]
    assert abs(a1["value"] + np.exp(-1 / 100)) < 3 * a1["stderr"]
    khz = swimid("rwls", "khz.csv", *columns, "--na", 2, "--nb", 1, "--nk", 4).json["result"]
    assert khz["sample_time_s"] == pytest.approx(2e-6)
    assert abs(khz["parameters"]["b1"]["value"] - 0.2) < 3 * khz["parameters"]["b1"]["stderr"]


# ---------------------------------------------------------------- track imu


def yaw_error(output: str) -> np.ndarray:
    """Return the heading less the true one, from the same start, rad."""
    truth = np.loadtxt("truth.csv", delimiter=",")
    found = pd.read_csv(output, comment="#")
    error = found["yaw_rad"] - np.interp(found["t_s"], truth[:, 0], truth[:, 3])
    return np.asarray(error - error.iloc[0])


@pytest.mark.slow
def test_quaternions_from_world_to_body_are_named(case: Case, swimid: Run) -> None:
    case("c-09-quaternion-world-to-body")
    ran = swimid("track", "imu", "q_inv.csv", "-o", "o.csv")
    assert ran.status == 0
    assert "SWM090" in codes(ran)
    assert "quaternion: {direction: world-to-body}" in ran.err
    assert level("o.csv") == "bad"
    assert np.abs(yaw_error("o.csv")).max() < 0.02


@pytest.mark.slow
def test_quaternions_from_body_to_world_are_used(case: Case, swimid: Run) -> None:
    case("c-09-quaternion-world-to-body")
    ran = swimid("track", "imu", "q_ok.csv", "-o", "o.csv")
    assert "SWM090" not in codes(ran)
    assert "attitude quaternion columns" in ran.out
    assert level("o.csv") == "caution"
    assert np.abs(yaw_error("o.csv")).max() < 0.02


@pytest.mark.slow
def test_the_stated_unit_of_a_shaken_sensor_is_believed(case: Case, swimid: Run) -> None:
    case("r-imu-unit-energetic", "make.py")
    ran = swimid("track", "imu", "imu.csv", "--map", "m.yaml", "-o", "o.csv")
    assert ran.status == 0
    assert level("o.csv") == "caution"
    found = pd.read_csv("o.csv", comment="#")
    # 9 m/s2 at 1.9 Hz, through a high pass of fourth order at half of that frequency
    amplitude = np.sqrt(2) * found["u_osc_m_s"].iloc[800:-800].std()
    assert amplitude == pytest.approx(9 / (2 * np.pi * 1.9) / (1 + 2**-4), rel=0.03)


@pytest.mark.slow
def test_the_band_of_the_surge_holds_tilt_and_scale_errors(case: Case, swimid: Run) -> None:
    case("r-imu-uosc-band", "make.py")
    assert swimid("track", "imu", "imu.csv", "-o", "o.csv").status == 0
    found = pd.read_csv("o.csv", comment="#")
    inside = np.abs(found["u_osc_m_s"]) <= 1.96 * found["u_osc_sd_m_s"]
    assert inside.mean() > 0.85


@pytest.mark.slow
@pytest.mark.parametrize(
    ("camera", "offset_s"),
    [("cam0", 0.0), ("cam_neg", 0.112), ("cam_late", 12.4), ("cam_epoch", -1700000003.2)],
)
def test_the_offset_of_a_camera_clock_is_found(camera: str, offset_s: float, case: Case, swimid: Run) -> None:
    """The rates of the case are forward differences, which make the gyroscope 5 ms early."""
    case("c-25-camera-clock-offset")
    ran = swimid("track", "imu", "base.csv", "--with", f"{camera}.csv", "-o", "f.csv", "--json")
    assert ran.json["result"]["fusion"]["clock_offset_s"] == pytest.approx(offset_s - 0.005, abs=1.5e-3)


@pytest.mark.slow
@pytest.mark.parametrize("log", ["mag_sparse.csv", "mag_hold.csv"])
def test_a_slow_magnetometer_holds_the_heading(log: str, case: Case, swimid: Run) -> None:
    case("c-29-magnetometer-at-a-fifth-of-the-rate", "gen.py")
    ran = swimid("track", "imu", log, "-o", "o.csv")
    assert "SWM080" not in codes(ran)
    assert "attitude gyroscope, accelerometer and magnetometer" in " ".join(ran.out.split())
    assert np.abs(yaw_error("o.csv")).max() < 0.02


@pytest.mark.slow
@pytest.mark.parametrize("name", ["10_undisturbed_slow_translation_A", "15_undisturbed_fast_translation_A"])
def test_the_band_of_the_surge_on_hand_held_recordings(
    name: str, real_data: Path, tmp_path: Path, swimid: Run
) -> None:
    """Motion capture has errors of its own: a lever of some millimetres, and 2 ms between the clocks."""
    from scipy import io
    from scipy.spatial.transform import Rotation

    trial = io.loadmat(real_data / "broad" / f"{name}.mat", squeeze_me=True)
    rate_hz = float(trial["sampling_rate"])
    columns = {"t_s": np.arange(len(trial["imu_acc"])) / rate_hz}
    columns |= {f"a{axis}_m_s2": c for axis, c in zip("xyz", trial["imu_acc"].T, strict=True)}
    columns |= {f"w{axis}_rad_s": c for axis, c in zip("xyz", trial["imu_gyr"].T, strict=True)}
    pd.DataFrame(columns).to_csv(tmp_path / "imu.csv", index=False)
    ran = swimid("track", "imu", tmp_path / "imu.csv", "-o", tmp_path / "run.csv", "--json")
    found = pd.read_csv(tmp_path / "run.csv", comment="#")
    known = np.isfinite(trial["opt_quat"]).all(axis=1) & np.isfinite(trial["opt_pos"]).all(axis=1)
    rows = np.flatnonzero(known)
    place = np.column_stack([np.interp(np.arange(len(known)), rows, c) for c in trial["opt_pos"][rows].T])
    velocity = signal.savgol_filter(place, 15, 3, deriv=1, delta=1 / rate_hz, axis=0)
    sections = signal.butter(
        2, ran.json["result"]["surge_oscillation"]["above_hz"], "high", fs=rate_hz, output="sos"
    )
    fast = signal.sosfiltfilt(sections, velocity, axis=0)[rows]
    true = Rotation.from_quat(trial["opt_quat"][rows][:, [1, 2, 3, 0]]).inv().apply(fast)[:, 0]
    moving = trial["movement"].astype(bool)[rows]
    error = np.abs(found["u_osc_m_s"].to_numpy()[rows] - true)
    inside = error <= 1.96 * found["u_osc_sd_m_s"].to_numpy()[rows]
    print(f"{name}: {100 * inside[moving].mean():.0f} % inside while moving")
    assert inside[moving].mean() > 0.7
