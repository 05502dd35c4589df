"""Tracks of a polled camera: speed against the truth, jumps counted, gaps kept, the stroke told."""

from __future__ import annotations

import csv
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from swimid.kinematics.jumps import Cleaning, clean_track
from swimid.kinematics.speed import TrackSpeed, measure_speed
from swimid.kinematics.stroke import find_stroke
from swimid.logs import log
from swimid.logs.sampling import find_held
from tests.conftest import Ran
from tests.generators.polled_camera import Polled, polled

Run = Callable[..., Ran]


def _write(path: Path, made: Polled, head: str = "") -> None:
    with path.open("w", newline="") as stream:
        stream.write(head)
        writer = csv.writer(stream)
        writer.writerow(["t_s", "x_m", "y_m", "yaw_rad"])
        writer.writerows(made.rows)


def measured_speed(cleaning: Cleaning, *place: np.ndarray) -> TrackSpeed:
    """Return the speed of a cleaned track."""
    kept = np.where(cleaning.good, place, np.nan).T
    found = measure_speed(cleaning.held.measured_s, kept, offset_rows=cleaning.offset_rows)
    assert found is not None
    return found


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_speed_within_two_percent(seed: int, swimid: Run, tmp_path: Path) -> None:
    made = polled(seed)
    _write(tmp_path / "camera.csv", made)
    ran = swimid("import", tmp_path / "camera.csv", "-o", tmp_path / "run.csv", "--json")
    assert ran.status == 0, ran.err
    found = ran.json["result"]
    assert abs(found["speed"]["path_m_s"] / made.path_m_s - 1) < 0.02
    assert abs(found["speed"]["line_m_s"] / made.line_m_s - 1) < 0.02
    assert found["track"]["jumps"] == found["track"]["samples_jumped"] == made.jumps
    assert found["track"]["repeats"] == made.repeats
    assert [end - start for start, end in found["track"]["gaps_s"]] == pytest.approx([2.0], abs=0.2)
    record = log.read(tmp_path / "run.csv")
    assert record.metadata["track_cleaned"]["jumps"] == made.jumps
    assert len(record) == len(made.rows) - made.jumps - made.repeats
    assert not np.isnan(record["x_m"]).any()
    raw = swimid("import", tmp_path / "camera.csv", "-o", tmp_path / "raw.csv", "--raw", "-q")
    assert raw.status == 0
    assert len(log.read(tmp_path / "raw.csv")) == len(made.rows)


@pytest.mark.parametrize(
    "changes",
    [
        {"jump_samples": 8},
        {"noise_m": 0.003},
        {"noise_m": 0.0},
        {"turn_rad_s": 0.15},
        {"repeat_share": 0.5},
        {"rate_hz": 12.0},
        {"speed_m_s": 0.05, "sway_m": 0.002},
        {"sway_m": 0.0},
        {"gap_s": 6.0},
    ],
    ids=str,
)
def test_repeats_and_jumps_of_other_tracks(changes: dict[str, float]) -> None:
    made = polled(11, **changes)  # type: ignore[arg-type]
    time, x, y, _ = np.array(made.rows).T
    cleaning = clean_track(time, [x, y])
    speed = measured_speed(cleaning, x, y)
    assert cleaning.jumps == made.jumps
    assert abs(speed.path.value / made.path_m_s - 1) < 0.02


@pytest.mark.parametrize("seed", range(3))
def test_a_clean_track_stays_whole(seed: int) -> None:
    made = polled(seed, jumps=0, repeat_share=0.0, gap_s=0.0)
    time, x, y, _ = np.array(made.rows).T
    cleaning = clean_track(time, [x, y])
    assert cleaning.good.all()
    assert not cleaning.gaps


def test_the_interval_of_the_speed_covers_the_truth() -> None:
    """Of 8 steady runs the 95 % interval misses few: more than 2 misses have a chance below 1 %."""
    misses = 0
    for seed in range(8):
        made = polled(100 + seed, duration_s=20.0)
        time, x, y, _ = np.array(made.rows).T
        speed = measured_speed(clean_track(time, [x, y]), x, y)
        misses += not speed.line.low <= made.line_m_s <= speed.line.high
    assert misses <= 2


def test_a_track_that_goes_on_elsewhere_is_reported(swimid: Run, tmp_path: Path) -> None:
    made = polled(3, jumps=1, stays=True)
    _write(tmp_path / "camera.csv", made)
    ran = swimid("import", tmp_path / "camera.csv", "-o", tmp_path / "run.csv", "--json")
    found = ran.json["result"]
    assert found["track"]["goes_on_elsewhere"] == 1
    assert "SWM059" in [w["code"] for w in ran.json["warnings"]]
    assert abs(found["speed"]["path_m_s"] / made.path_m_s - 1) < 0.02


def test_a_rest_is_no_repeat_and_a_frozen_picture_is(rng: np.random.Generator) -> None:
    """The same pose for a second: kept where the robot goes on from there, else left out."""
    time = np.arange(300) / 30
    x = np.maximum(time - 2.0, 0.0) * 0.2  # at rest for 2 s, without noise
    still = clean_track(time, [x, 0 * x])
    assert not still.repeated.any()
    moving = 0.2 * time + 0.0005 * rng.normal(size=300)
    moving[100:130] = moving[100]
    frozen = clean_track(time, [moving, 0 * moving])
    assert frozen.repeated.sum() == 29
    assert len(frozen.gaps) == 1


def test_other_columns_of_a_repeat_stay(swimid: Run, tmp_path: Path) -> None:
    rows = [f"{k / 30:.4f},{0.2 * (k // 2) / 15:.5f},{0.001 * (k // 2) ** 1.1:.5f},{k}" for k in range(60)]
    (tmp_path / "a.csv").write_text("t_s,x_m,y_m,cmd1_rad\n" + "\n".join(rows) + "\n")
    assert swimid("import", tmp_path / "a.csv", "-o", tmp_path / "run.csv", "-q").status == 0
    record = log.read(tmp_path / "run.csv")
    assert len(record) == 60
    assert np.isnan(record["x_m"]).sum() == 30
    assert not np.isnan(record["cmd1_rad"]).any()


@pytest.mark.slow
@pytest.mark.parametrize("stated,told", [(1.2, False), (0.6, True), (2.4, True)])
def test_the_stroke_is_found_and_compared_with_the_metadata(
    stated: float, told: bool, swimid: Run, tmp_path: Path
) -> None:
    made = polled(7)
    _write(tmp_path / "camera.csv", made, f"# frequency_hz: {stated}\n")
    ran = swimid("import", tmp_path / "camera.csv", "-o", tmp_path / "run.csv", "--json")
    stroke = ran.json["result"]["stroke"]
    assert stroke["ci95_hz"][0] - 0.002 <= 1.2 <= stroke["ci95_hz"][1] + 0.002
    assert bool(stroke["contradiction"]) is told
    assert ("SWM032" in [w["code"] for w in ran.json["warnings"]]) is told


def test_harmonics_and_surge_at_twice_the_stroke(rng: np.random.Generator) -> None:
    time = np.arange(2000) / 100
    phase = 2 * np.pi * 1.5 * time
    columns = {
        "yaw_rad": 0.2 * np.sin(phase) + 0.02 * np.sin(3 * phase) + 0.002 * rng.normal(size=2000),
        "u_m_s": 0.2 + 0.05 * np.cos(2 * phase) + 0.002 * rng.normal(size=2000),
    }
    found = find_stroke(time, columns)
    assert found.beat is not None
    assert abs(found.beat.frequency_hz - 1.5) < 4 * found.beat.stderr_hz + 1e-3
    alone = find_stroke(time, {"u_m_s": columns["u_m_s"]})
    assert alone.beat is not None
    assert alone.maybe_double
    assert abs(alone.beat.frequency_hz - 3.0) < 0.01


def test_noise_has_no_stroke(rng: np.random.Generator) -> None:
    assert find_stroke(np.arange(500) / 30, {"yaw_rad": rng.normal(size=500)}).beat is None


# ---------------------------------------------------------------- written faster than measured


def track(rng: np.random.Generator, count: int = 80) -> np.ndarray:
    return np.cumsum(0.01 + 0.002 * rng.normal(size=count))


def stale(*columns: np.ndarray) -> np.ndarray:
    return find_held(np.arange(len(columns[0])) / 50, columns).repeated


@pytest.mark.parametrize("each", [2, 3, 8])
def test_pictures_written_several_times(rng: np.random.Generator, each: int) -> None:
    found = stale(np.repeat(track(rng), each), np.repeat(track(rng), each))
    assert found.sum() == 80 * (each - 1)
    assert not found[::each].any()


def test_three_rows_for_two_pictures(rng: np.random.Generator) -> None:
    x = track(rng)[np.arange(120) * 2 // 3]
    assert stale(x).sum() == np.sum(np.diff(x) == 0)


def test_samples_that_repeat_for_another_reason_stay(rng: np.random.Generator) -> None:
    x = track(rng, 200)
    at_rest = np.concatenate((np.zeros(120), x))
    stops = np.concatenate([np.concatenate((part, np.full(40, part[-1]))) for part in np.split(x, 8)])
    counted = np.floor(x / 0.015) * 0.015
    to_and_fro = np.round(0.1 * np.sin(0.05 * np.arange(2000)), 4)
    straight = np.zeros(200)
    slow = np.round(x / 50, 4)
    rounded = np.round(stops, 4)
    for columns in (
        [at_rest], [stops], [rounded], [counted], [to_and_fro], [x, straight], [straight], [slow]
    ):  # fmt: skip
        assert not stale(*columns).any()
    assert not stale(np.repeat(x, 2)[:6]).any()
