"""Repeated and frozen samples, few strokes and laps of further robots, sensors and units."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from numpy.typing import NDArray

from swimid.logs.sampling import find_frozen, find_held, find_uneven
from tests.conftest import SAMPLES, Ran

Array = NDArray[np.float64]
GAP = SAMPLES / "gap"


@pytest.mark.parametrize("share", [0.457, 0.8, 0.93])
def test_the_times_of_an_even_camera_are_found(share: float) -> None:
    stamps = np.arange(300) / 30
    picture = np.floor(share * np.arange(300) + 0.3).astype(int)
    rng = np.random.default_rng(0)
    place = np.array([0.2 * picture, np.sin(picture)])[:, :] + 0.01 * rng.normal(size=(2, 400))[:, picture]
    found = find_held(stamps, place)
    assert found.repeated.sum() == 300 - len(np.unique(picture))
    assert found.period_s == pytest.approx(1 / share / 30, rel=2e-3)
    off = found.measured_s - picture / share / 30
    assert np.ptp(off) < max(4.0 * found.measured_sd_s, 1e-3)


def test_a_log_that_begins_within_a_hold_keeps_the_period_of_the_camera() -> None:
    # the first sample of 100 shows a picture that was almost a period old
    stamps, late = np.arange(100) / 30, 0.99
    picture = np.floor(0.45 * np.arange(100) + late).astype(int)
    place = np.random.default_rng(4).normal(size=(2, 100))[:, picture]
    found = find_held(stamps, place)
    assert found.even
    off = found.measured_s - picture / 0.45 / 30
    assert np.ptp(off) < 4.0 * found.measured_sd_s + 1e-3


def test_a_slow_sensor_is_distinguished_from_one_at_rest() -> None:
    rng = np.random.default_rng(1)
    slow = np.repeat(np.cumsum(rng.normal(size=(200, 3)), axis=0), 3, axis=0).T
    assert find_held(np.arange(600) / 100, slow).repeated.sum() == 400
    rest = np.concatenate([np.zeros((3, 400)), slow[:, ::3]], axis=1)
    assert not find_held(np.arange(600) / 100, rest).repeated.any()


def test_three_samples_and_channels_with_levels_have_no_repeats() -> None:
    few = np.array([[0.0, 0.0, 1.0]])
    assert not find_held(np.arange(3.0), few).repeated.any()
    levels = np.repeat([0.0, 1.0, 0.0, 1.0], 50)[None]
    assert not find_held(np.arange(200) / 50, levels).repeated.any()


@pytest.mark.parametrize("jitter", [0.0, 1e-6])
def test_every_picture_that_is_logged_twice_is_a_repeat(jitter: float) -> None:
    """Also if the tracker measures the same picture with a small error each time."""
    rng = np.random.default_rng(6)
    pictures = np.cumsum(0.01 + 0.002 * rng.normal(size=(2, 200)), axis=1)
    place = np.repeat(pictures, 2, axis=1) + jitter * rng.normal(size=(2, 400))
    found = find_held(np.arange(400) / 60, place)
    assert found.repeated.tolist() == [False, True] * 200
    assert found.period_s == pytest.approx(1 / 30, rel=1e-6)


def test_channels_at_rest_are_not_frozen() -> None:
    rng = np.random.default_rng(2)
    time = np.arange(2000) / 50
    beat = np.where(time % 10 < 4, 0.3 * np.sin(2 * np.pi * time), 0.0)
    rests = np.concatenate([np.zeros(500), np.cumsum(np.linspace(0, 0.01, 1000)), np.full(500, 5.005)])
    columns = {
        "joint1_rad": beat,
        "x_m": rests,
        "z_m": np.round(0.02 * np.sin(0.4 * time), 3),
        "yaw_rad": np.repeat(np.sin(time[::4]) + 0.01 * rng.normal(size=500), 4),
    }
    assert not find_frozen(time, columns)
    columns["yaw_rad"] = np.sin(3 * time) + 1e-3 * rng.normal(size=2000)
    columns["yaw_rad"][700:760] = columns["yaw_rad"][700]
    assert find_frozen(time, columns) == {"yaw_rad": pytest.approx((14.0, 15.18))}


def test_gaps_and_slow_changes_of_the_rate_are_even_enough() -> None:
    rng = np.random.default_rng(3)
    missing = np.flatnonzero(rng.random(400) > 0.1) / 50.0
    clicks = np.sqrt(np.arange(1.0, 400.0))
    for stamps in (missing, clicks, np.cumsum(0.02 * (1 + 0.1 * rng.normal(size=400)))):
        assert find_uneven(stamps) == ("", False)
    bursts = np.floor(np.arange(400) / 4) * 0.08 + 1e-4 * (np.arange(400) % 4)
    assert find_uneven(bursts)[1]


def _few_strokes(time: Array, rng: np.random.Generator) -> dict[str, Array]:
    """Return 3.3 strokes of a dolphin in the vertical plane, in px, with a surge at twice the stroke."""
    phase = 2 * np.pi * 1.1 * time
    x = 90 * time + 2 * np.sin(2 * phase)
    return {
        "x_px": x + 0.2 * rng.normal(size=len(time)),
        "z_px": 15 * np.sin(phase) + 0.2 * rng.normal(size=len(time)),
        "pitch_rad": 0.2 * np.sin(phase + 1) + 0.01 * rng.normal(size=len(time)),
    }


def _laps(time: Array, rng: np.random.Generator) -> dict[str, Array]:
    """Return laps of 4 s on an ellipse, with a compass that turns."""
    turn = -2 * np.pi * time / 4.0
    return {
        "x_m": 1.5 * np.cos(turn) + 0.002 * rng.normal(size=len(time)),
        "y_m": 0.9 * np.sin(turn) + 0.002 * rng.normal(size=len(time)),
        "yaw_rad": turn - np.pi / 2 + 0.05 * np.sin(2 * turn) + 0.01 * rng.normal(size=len(time)),
    }


def _lapping_swimmer(time: Array, rng: np.random.Generator) -> dict[str, Array]:
    """Return the laps of a swimmer whose stroke of 1.7 Hz shows in its path alone."""
    turn, sway = 2 * np.pi * time / 6.0, 0.02 * np.sin(2 * np.pi * 1.7 * time)
    return {
        "x_m": (1 + sway) * np.cos(turn) + 0.001 * rng.normal(size=len(time)),
        "y_m": (1 + sway) * np.sin(turn) + 0.001 * rng.normal(size=len(time)),
    }


def _held_depth(time: Array, rng: np.random.Generator) -> dict[str, Array]:
    """Return a tether force sampled at 40 Hz in a log of 100 Hz: 2.5 rows a sample, with jitter."""
    sample = np.floor(time * 40.0 + 1e-9).astype(int)
    x = 0.15 * sample / 40 + 0.001 * rng.normal(size=sample[-1] + 1)[sample]
    y = 0.01 * np.sin(2 * np.pi * 1.3 * sample / 40) + 0.001 * rng.normal(size=sample[-1] + 1)[sample]
    return {"x_m": x + 1e-7 * rng.normal(size=len(time)), "y_m": y + 1e-7 * rng.normal(size=len(time))}


@pytest.mark.parametrize(
    "make,rate,seconds,level,said",
    [
        (_few_strokes, 50, 3.0, "good", "only 3.3 cycles"),
        (_laps, 20, 60.0, "good", "circles of 4 s"),
        (_lapping_swimmer, 25, 48.0, "good", "1.7"),
        (_held_depth, 100, 20.0, "good", "1.3"),
    ],
)
def test_stroke_and_verdict_of_further_logs(
    make: Callable[..., dict[str, Array]],
    rate: int,
    seconds: float,
    level: str,
    said: str,
    swimid: Callable[..., Ran],
    tmp_path: Path,
) -> None:
    time = np.arange(round(rate * seconds)) / rate
    columns = make(time, np.random.default_rng(5))
    pd.DataFrame({"t_s": time} | columns).to_csv(tmp_path / "log.csv", index=False, float_format="%.8f")
    ran = swimid("import", tmp_path / "log.csv", "-o", tmp_path / "out.csv", "--json")
    assert ran.status == 0, ran.err
    found = ran.json["result"]
    assert found["verdict"]["level"] == level
    if "frequency_hz" in found["stroke"]:
        assert found["stroke"]["frequency_hz"] == pytest.approx(float(said), rel=2e-3)
    else:
        assert said in found["stroke"]["unknown"]
    if make is _held_depth:
        assert found["track"]["repeats"] == 1200
        low, high = found["speed"]["line_ci95"]
        assert low <= 0.15 <= high


def test_a_frozen_tracker_is_named_and_its_samples_stay(swimid: Callable[..., Ran], tmp_path: Path) -> None:
    for path in GAP.glob("run*.csv"):
        log = pd.read_csv(path, comment="#")
        if path.stem == "run02":
            log.loc[100:140, ["x_m", "y_m"]] = log.loc[100, ["x_m", "y_m"]].to_numpy()
        log.to_csv(tmp_path / path.name, index=False)
    (tmp_path / "trials.yaml").write_text((GAP / "trials.yaml").read_text())
    args = ("--params", GAP / "params.yaml", "--no-refit-start", "-o", tmp_path / "c.yaml", "--json")
    warnings = swimid("compare", tmp_path / "trials.yaml", *args).json["warnings"]
    frozen = [w["text"] for w in warnings if w["code"] == "SWM035"]
    assert frozen
    assert all(text.startswith("run02.csv: ") for text in frozen)
    assert "SWM058" not in [w["code"] for w in warnings]


@pytest.mark.parametrize("rest", [slice(0, 2), slice(-2, None)])
def test_two_equal_samples_at_an_end_of_a_log_are_no_repeat(rest: slice) -> None:
    place = np.random.default_rng(3).normal(size=300)
    place[rest] = 0.0
    assert not find_held(np.arange(300) / 50, [place]).repeated.any()
    place[150] = place[149]
    assert find_held(np.arange(300) / 50, [place]).repeated[150]
