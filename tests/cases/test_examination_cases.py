"""Recorded inputs whose faults ``swimid import`` once missed, or which it condemned though sound."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from swimid import import_log
from swimid.errors import InputError

Case = Callable[..., Path]


@pytest.fixture
def imported(case: Case) -> Callable[..., dict[str, Any]]:
    """Import one file of a case, if need be with a mapping; return what was found, with the verdict."""

    def run(name: str, file: str, rules: str = "", **options: Any) -> dict[str, Any]:
        folder = case(name)
        if rules:
            options["map_path"] = folder / rules
        found = import_log(folder / file, **options).data
        return found | {"level": found["verdict"]["level"], "text": found["verdict"]["text"]}

    return run


@pytest.mark.parametrize(
    ("file", "jumps"), [("flips180.txt", 189), ("flips90.txt", 189), ("signs.txt", 0), ("clean.txt", 0)]
)
def test_flips_of_an_attitude(file: str, jumps: int, imported: Any) -> None:
    found = imported("t4-o09-mocap-flips", file, "map2.yaml")
    assert sum(found["jumps"].values()) == jumps
    assert found["level"] == {0: "good"}.get(jumps, "caution")


@pytest.mark.parametrize(("file", "low", "high"), [("plain.csv", 25, 26), ("plain8.csv", 8, 9)])
def test_reversed_headings(file: str, low: int, high: int, imported: Any) -> None:
    found = imported("t4-o06-trex-csv", file)
    assert low - 1 <= found["jumps"]["yaw_rad"] <= high
    assert found["level"] == "caution"
    assert found["stroke"]["frequency_hz"] == pytest.approx(1.2, abs=1e-3)


@pytest.mark.parametrize(
    ("file", "angle"),
    [("plus180.csv", "1"), ("plus90.csv", "9"), ("compass.csv", "5"), ("turn_plus180.csv", "180")],
)
def test_a_heading_at_an_angle_to_the_course(file: str, angle: str, imported: Any) -> None:
    found = imported("t4-heading-against-course", file)
    assert found["level"] == "caution"
    assert f"stands at {angle}" in found["text"]


def test_a_compass_heading_on_a_bend_is_mirrored(imported: Any) -> None:
    assert imported("t4-heading-against-course", "turn_compass.csv")["level"] == "bad"


@pytest.mark.parametrize(
    ("file", "lost"), [("bead.csv", 4), ("mid.csv", 2), ("first.csv", 6), ("clean.csv", 0)]
)
def test_lost_samples_written_as_zero(file: str, lost: int, imported: Any) -> None:
    found = imported("t4-lost-as-zero", file, "map.yaml")
    assert sum(found["jumps"].values()) == lost
    assert ("missing: [0]" in found["text"]) == bool(lost)


@pytest.mark.parametrize(
    ("file", "spikes"), [("tow1.csv", 9), ("tow4.csv", 9), ("neg2.csv", 6), ("clean3.csv", 0)]
)
def test_spikes_of_a_load_cell(file: str, spikes: int, imported: Any) -> None:
    found = imported("t4-o02-loadcell-spikes", file, "map.yaml")
    assert sum(found["jumps"].values()) == spikes
    assert found["level"] == {0: "good"}.get(spikes, "caution")


def test_implausible_times(imported: Any) -> None:
    with pytest.raises(InputError, match="the file states ms for the times, the mapping states ns"):
        imported("t4-speed-of-213700", "plain.nc", "map.yaml")


def test_a_command_may_hold_one_value(imported: Any) -> None:
    assert imported("t4-command-held", "run.csv")["level"] == "good"


def test_a_score_may_be_zero(imported: Any) -> None:
    found = imported("t4-score-held-at-zero", "run.analysis.csv", rate_hz=50.0)
    assert found["level"] != "bad"
    assert found["stroke"]["frequency_hz"] == pytest.approx(1.5, abs=3e-3)


def test_a_rotation_whose_rate_drifts(imported: Any) -> None:
    stroke = imported("t4-beat-whose-rate-drifts", "gyro.csv")["stroke"]
    low, high = stroke["ci95_hz"]
    assert low < 0.659 < high
    assert high - low < 0.08


def test_a_swim_between_rests(imported: Any) -> None:
    stroke = imported("t4-import-stroke", "swim2_arduino.txt", "table-1.map.yaml")["stroke"]
    assert stroke["frequency_hz"] == pytest.approx(1.2, abs=2e-3)


def test_stamps_of_a_coarse_clock(imported: Any) -> None:
    found = imported("t4-float32-times", "f32.csv")
    assert found["median_rate_hz"] == pytest.approx(50.0, rel=2e-4)
    assert found["level"] == "caution"
    assert "the clock counts in 7.812 ms" in found["text"]
    rounded = imported("t4-rounded-stamps", "r.csv", "m.yaml")
    assert rounded["median_rate_hz"] == pytest.approx(120.0, rel=1e-4)


def test_rows_that_come_late(imported: Any) -> None:
    found = imported("t4-late-rows", "late.csv", "map.yaml")
    assert found["samples"] == 1200
    assert found["level"] == "caution"
    assert found["rows"]["late"] == 17


@pytest.mark.parametrize(("file", "level"), [("crashed.h5", "caution"), ("nanfill.h5", "good")])
def test_rows_that_were_never_filled(file: str, level: str, imported: Any) -> None:
    found = imported("t4-o08-preallocated-zeros", file, "map.yaml")
    assert found["samples"] == 1400
    assert found["level"] == level
    assert found["speed"]["path_m_s"] == pytest.approx(0.2011, abs=2e-4)
