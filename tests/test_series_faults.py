"""Logs with faults: repeated samples, unrelated channels, quaternions of another convention, units."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

import swimid
from swimid.notices import SwimidWarning
from tests.generators import series
from validation.coverage import uosc

MOTOR = {"input_column": "duty", "output_column": "speed_rad_s", "na": 1, "nb": 1, "held_out": (0.25,)}


def level(made: swimid.Result) -> str:
    """Return the grade of a result."""
    return made.evidence.verdict.level


@pytest.mark.parametrize("make", [series.motor_logged_four_times, series.motor_with_slow_sensor])
def test_a_motor_is_fitted_at_the_rate_of_its_sensor(
    make: Callable[[np.random.Generator], pd.DataFrame], rng: np.random.Generator
) -> None:
    with pytest.warns(SwimidWarning, match="SWM058.*speed_rad_s repeat the previous sample"):
        made = swimid.rwls([make(rng)], **MOTOR)
    assert made.document.sample_time_s == pytest.approx(0.04, rel=1e-3)
    a1 = made["a1"]
    assert abs(a1.value + 0.9) < 4 * a1.stderr < 0.02
    assert level(made) == "caution"


@pytest.mark.parametrize("levels", ["random", "few"])
def test_a_staircase_command_is_not_blamed(levels: str, rng: np.random.Generator) -> None:
    duty, speed = series.motor(rng, 800)
    if levels == "few":
        duty = np.sign(duty)
        for k in range(1, 800):
            speed[k] = 0.9 * speed[k - 1] + 0.4 * duty[k - 1] + 0.02 * rng.normal()
    table = pd.DataFrame({"t_s": np.arange(800) / 25, "duty": duty, "speed_rad_s": speed})
    made = swimid.rwls([table], **MOTOR)
    assert made.document.sample_time_s == pytest.approx(0.04)
    assert level(made) == "good"


def test_cells_filled_in_every_other_row_are_fitted_at_their_rate(rng: np.random.Generator) -> None:
    duty, speed = series.motor(rng, 600)
    table = pd.DataFrame({"t_s": np.arange(1200) / 50, "duty": np.repeat(duty, 2)})
    table["speed_rad_s"] = np.where(np.arange(1200) % 2 == 0, np.repeat(speed, 2), np.nan)
    with pytest.warns(SwimidWarning, match="are empty: it is measured every 0.04 s"):
        made = swimid.rwls([table], **MOTOR)
    assert abs(made["a1"].value + 0.9) < 4 * made["a1"].stderr


def test_a_rudder_that_is_not_connected_gives_no_good_model(rng: np.random.Generator) -> None:
    columns = {"input_column": "cmd1_rad", "output_column": "yaw_rate_rad_s", "na": 2, "nb": 2}
    made = swimid.rwls([series.yaw_from_a_current(rng)], **columns, held_out=(0.3,))
    assert level(made) in ("caution", "bad")
    assert f"{level(made).upper()}: " in made.summary()


def test_without_held_out_data_the_grade_says_what_was_tested(rng: np.random.Generator) -> None:
    duty, speed = series.motor(rng, 600)
    table = pd.DataFrame({"t_s": np.arange(600) / 25, "duty": duty, "speed_rad_s": speed})
    made = swimid.rwls([table], **{**MOTOR, "held_out": ()})
    assert level(made) == "caution"
    assert "checks warn: no data were held out" in made.evidence.verdict.text


@pytest.mark.slow
@pytest.mark.parametrize(
    ("order", "direction"),
    [
        pytest.param("wxyz", "world-to-body", marks=pytest.mark.slow),
        pytest.param("xyzw", "body-to-world", marks=pytest.mark.slow),
        ("xyzw", "world-to-body"),
    ],
)
def test_quaternions_of_another_convention_are_named(
    order: str, direction: str, tmp_path: Path, rng: np.random.Generator
) -> None:
    table, attitude = series.rolling(rng)
    written = attitude if direction == "body-to-world" else attitude.inv()
    columns = [3, 0, 1, 2] if order == "wxyz" else [0, 1, 2, 3]
    table[["qw", "qx", "qy", "qz"]] = written.as_quat()[:, columns]
    with pytest.warns(SwimidWarning, match="SWM090") as said:
        made = swimid.track_imu(table)
    line = next(str(w.message) for w in said if "SWM090" in str(w.message))
    assert ("order: xyzw" in line) == (order == "xyzw")
    assert ("direction: world-to-body" in line) == (direction == "world-to-body")
    assert level(made) == "bad"
    made.save(tmp_path / "run.csv")
    assert json.loads((tmp_path / "run.evidence.json").read_text())["verdict"]["level"] == "bad"


@pytest.mark.slow
def test_quaternions_at_a_lower_rate_are_used(rng: np.random.Generator) -> None:
    table, attitude = series.rolling(rng)
    told = attitude.as_quat()[:, [3, 0, 1, 2]]
    told[np.arange(len(told)) % 5 != 0] = np.nan
    table[["qw", "qx", "qy", "qz"]] = told
    made = swimid.track_imu(table)
    assert made.data["attitude_from"] == "quaternion columns"
    found = Rotation.from_quat(made.frame[["qx", "qy", "qz", "qw"]].to_numpy())
    assert np.degrees((found * attitude.inv()).magnitude()).max() < 2.0


def test_a_sensor_that_never_rests_keeps_its_stated_units(rng: np.random.Generator) -> None:
    made = swimid.track_imu(series.hopping(rng))
    assert "acceleration unit" not in [fault["fault"] for fault in made.data["faults"]]
    spin = made.frame["yaw_rate_rad_s"].abs().max()
    assert spin == pytest.approx(14, rel=0.05)
    assert level(made) != "good"


@pytest.mark.slow
def test_the_band_of_the_surge_covers_simulated_swims() -> None:
    """Ten swims; three hundred are measured by ``python -m validation.coverage uosc``."""
    shares = [uosc.one(seed).get("u_osc, whole log", np.nan) for seed in range(1, 11)]
    assert np.nanmean(shares) > 0.9
