"""Recorded inputs of stroke, speed, repeated samples and frozen channels, with their true values."""

from __future__ import annotations

import json
import runpy
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tests.conftest import Ran

Case = Callable[..., Path]
Run = Callable[..., Ran]


def imported(swimid: Run, source: str) -> dict:
    """Import a log and return the result with the warning codes."""
    ran = swimid("import", source, "-o", "out.csv", "--json")
    assert ran.status == 0, ran.err
    return ran.json["result"]


@pytest.mark.parametrize("name", ["circle_xy", "circle_xyyaw"])
def test_a_circle_is_no_stroke(name: str, case: Case, swimid: Run) -> None:
    case("p-circle-is-stroke")
    assert "circles of 9 s" in imported(swimid, f"{name}.csv")["stroke"]["unknown"]


@pytest.mark.parametrize(
    "name", ["angle_rad", "fin_angle_rad", "force_N", "tail_rad", "tip_m", "y_m", "y_offset_m"]
)
def test_any_channel_shows_the_stroke(name: str, case: Case, swimid: Run) -> None:
    case("p-stroke-by-name")
    assert imported(swimid, f"{name}.csv")["stroke"]["frequency_hz"] == pytest.approx(0.9, abs=1e-3)


def test_near_repeats_are_left_out_and_the_rest_stays(case: Case, swimid: Run) -> None:
    case("p-near-repeats")
    found = imported(swimid, "held.csv")
    assert (found["track"]["repeats"], found["track"]["samples_jumped"]) == (1125, 0)
    assert found["samples"] == 375
    assert found["verdict"]["level"] != "bad"


@pytest.mark.parametrize("name", ["steps", "rest-swim-rest", "burst-coast", "square"])
def test_constant_stretches_are_imported(name: str, case: Case, swimid: Run) -> None:
    case("r-import-steps", "make.py", "make2.py")
    stroke = imported(swimid, f"{name}.csv")["stroke"]
    truth = {"rest-swim-rest": 1.0, "burst-coast": 1.0, "square": 0.1}
    if name == "steps":
        assert "4 cycles" in stroke["unknown"]  # three periods of 13 s
    else:
        assert stroke["frequency_hz"] == pytest.approx(truth[name], rel=1e-3)


def test_constant_stretches_are_plotted(case: Case, swimid: Run) -> None:
    case("r-import-steps", "make.py")
    assert swimid("plot", "steps.csv", "-o", "s.svg").status == 0


@pytest.mark.parametrize("name,channel", [("m1", "yaw_rad"), ("m2", "joint2_rad")])
def test_a_frozen_channel_is_bad(name: str, channel: str, case: Case, swimid: Run) -> None:
    case("n-import")
    found = imported(swimid, f"{name}.csv")
    assert found["verdict"]["level"] == "bad"
    value = next(check["value"] for check in found["checks"] if check["name"] == "Frozen channels")
    assert value.startswith(f"{channel} from 5")


def test_columns_with_constant_windows_are_imported(case: Case, swimid: Run) -> None:
    case("n-import")
    ran = swimid("import", "dlc2.csv", "--map", "map_dlc.yaml", "-o", "out.csv", "--json")
    assert ran.status == 0, ran.err
    assert ran.json["result"]["stroke"]["frequency_hz"] == pytest.approx(1.2, rel=1e-3)


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


@pytest.mark.slow
@pytest.mark.parametrize("strokes", [1.5, 2.5, 3.0, 3.8, 4.5])
@pytest.mark.parametrize("columns", [2, 4])
def test_fewer_than_four_strokes_are_unknown(strokes: float, columns: int, case: Case, swimid: Run) -> None:
    folder = case("p-fewer-than-four-strokes")
    # the generator of the sweep without the sweep itself
    text = (folder / "sweep.py").read_text().split("for cols in")[0]
    (folder / "make.py").write_text(text.replace(", swimid", ""))
    made = runpy.run_path(str(folder / "make.py"))["mk"]
    made("a.csv", strokes, ["x_m", "y_m", "yaw_rad", "tail_rad"][:columns])
    stroke = imported(swimid, "a.csv")["stroke"]
    if strokes > 4:
        assert stroke["frequency_hz"] == pytest.approx(0.6, rel=2e-3)
    else:
        assert f"only {strokes:.1f} cycles" in stroke["unknown"]


@pytest.mark.slow
@pytest.mark.parametrize("script,frames", [("mk2.py", "frames2"), ("mk3.py", "frames3")])
def test_without_a_stroke_the_advance_is_displacement_over_time(
    script: str, frames: str, case: Case, swimid: Run
) -> None:
    case("p-advance-speed-without-stroke", script)
    setup = Path("s2.yaml")
    if frames == "frames3":
        green = "  - name: green\n    hsv: {hue_deg: [105, 135], saturation: [0.5, 1], value: [0.4, 1]}\n"
        text = setup.read_text().replace(
            "head: red", f"{green}    area_px: [125, 1062]\nhead: red\ntail: green"
        )
        setup.write_text(text)
    ran = swimid("track", "video", frames, "--fps", 30, "--setup", setup, "-o", "run.csv", "--json")
    assert ran.status == 0, ran.err
    found = json.loads(json.dumps(ran.json["result"]))["swimming"]
    assert found["stroke_frequency"] is None
    assert "3.0 cycles" in found["stroke_unknown"]
    speed = found["advance_speed"]
    assert speed["value"] == pytest.approx(0.02, abs=3e-4)
    assert speed["low"] - 1e-4 <= 0.02 <= speed["high"] + 1e-4
