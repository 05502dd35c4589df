"""Speed and stroke in the output and the result of ``track video``, on rendered films."""

import json
import math
import os
from pathlib import Path

import pytest
from click.testing import CliRunner

from swimid.cli.main import main
from swimid.results import evidence
from tests.conftest import track
from tests.generators import clutter_video as clutter
from tests.generators.clutter_video import RED, YELLOW, Pool

SPEED, SWAY, BEAT, SECONDS = 50.0, 4.0, 1.5, 4.8
HSV = {
    "red": "{hue_deg: [345, 15], saturation: [0.45, 1]}",
    "yellow": "{hue_deg: [40, 75], saturation: [0.4, 1]}",
}


@pytest.fixture(scope="module")
def film(tmp_path_factory):
    """Return a film of a fish with constant speed and heading, and with sway at its beat."""
    folder = tmp_path_factory.mktemp("film")
    course = clutter.straight(30, 120, SPEED, 0, sway=SWAY, beat_hz=BEAT)
    things = (clutter.disc(course, 7, RED, ahead=20), clutter.disc(course, 7, YELLOW, ahead=-20))
    clutter.write(folder / "film.mp4", Pool(things, duration_s=SECONDS, rate_hz=25.0))
    markers = "".join(f"  - name: {name}\n    hsv: {hsv}\n" for name, hsv in HSV.items())
    text = f"format: swimid-setup/1\nmarkers:\n{markers}head: red\ntail: yellow\n"
    (folder / "px.yaml").write_text(text)
    (folder / "m.yaml").write_text(text + "scale: {metres_per_pixel: 0.002}\n")
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("unit, factor", [("px", 1.0), ("m", 0.002)])
def test_speed_and_stroke_with_intervals(film, unit, factor):
    """Speeds, stroke, sway and accelerations are near the truth, in metres and in pixels."""
    out = track(
        "video", film / "film.mp4", "--setup", film / f"{unit}.yaml", "-o", film / f"{unit}.csv", "--json"
    )
    found = json.loads(out.stdout)["result"]["swimming"]
    assert found["window"] == "steady part"
    wave = 2 * math.pi * BEAT * SWAY
    along = sum(math.hypot(SPEED, wave * math.cos(math.pi * k / 50)) for k in range(100)) / 100
    for key, truth, kind, near in (
        ("steady_speed", SPEED, f"{unit}/s", 0.01),
        ("path_speed", along, f"{unit}/s", 0.02),
        ("sway_amplitude", SWAY, unit, 0.02),
    ):
        assert found[key]["unit"] == kind
        assert found[key]["value"] / factor == pytest.approx(truth, rel=near), key
        assert found[key]["low"] < found[key]["value"] < found[key]["high"]
    assert found["stroke_frequency"]["value"] == pytest.approx(BEAT, rel=0.01)
    assert found["yaw_amplitude"] is None
    for axis in ("", "_x", "_y"):
        acceleration = found[f"acceleration{axis}"]
        assert acceleration["unit"] == f"{unit}/s^2"
        assert acceleration["low"] / factor <= 0.3
        assert acceleration["high"] / factor >= -0.3
    proof = evidence.read(film / f"{unit}.evidence.json")
    assert proof.tables[0].id == "swimming"
    page = CliRunner().invoke(main, ["report", str(film / f"{unit}.csv"), "-o", str(film / f"{unit}.md")])
    assert page.exit_code == 0
    assert "steady speed" in (film / f"{unit}.md").read_text()


def test_from_and_to_define_the_window(film):
    """Speeds are those of the window, as the summary states, and the log has all frames."""
    arguments = ("video", film / "film.mp4", "--setup", film / "m.yaml", "-o", film / "cut.csv")
    out = track(*arguments, "--from", 0.5, "--to", 4.0)
    assert "speeds over 0.5 to 4 s, as given" in " ".join(out.output.split())
    assert "stroke frequency" in out.output
    rows = [line for line in (film / "cut.csv").read_text().splitlines() if line[0] != "#"]
    assert len(rows) == 1 + round(25 * SECONDS)


@pytest.mark.parametrize(
    "options, words",
    [
        (("--from", 3, "--to", 1), "must be before"),
        (("--from", -1), "must not be negative"),
        (("--from", 60), "the track runs from 0 to"),
        (("--from", 1, "--to", 1.1), "frames with the markers are between"),
    ],
)
def test_an_impossible_window_is_refused(film, tmp_path, options, words):
    arguments = ("video", film / "film.mp4", "--setup", film / "m.yaml", "-o", tmp_path / "run.csv")
    assert words in track(*arguments, *options, status=2).output
    assert not (tmp_path / "run.csv").exists()


@pytest.mark.skipif(not os.environ.get("SWIMID_DATA"), reason="SWIMID_DATA is not set")
def test_a_block_on_a_ramp_gives_its_acceleration(tmp_path):
    """The published value is 340 px/s². There is no stroke and no steady speed."""
    video = Path(os.environ["SWIMID_DATA"]) / "phystrack" / "R1.MP4"
    (tmp_path / "setup.yaml").write_text(
        "format: swimid-setup/1\nmarkers:\n  - name: mark\n    area_px: [50, 600]\n"
        "    hsv: {hue_deg: [90, 190], saturation: [0.2, 1], value: [0.1, 0.6]}\n"
    )
    options = ("--fps", 240, "--from", 0.6, "--to", 1.5, "--json")
    out = track("video", video, "--setup", tmp_path / "setup.yaml", "-o", tmp_path / "run.csv", *options)
    found = json.loads(out.stdout)["result"]["swimming"]
    assert found["acceleration"]["low"] <= 340 <= found["acceleration"]["high"]
    assert found["acceleration"]["value"] == pytest.approx(340, rel=0.03)
    assert found["steady_speed"] is None
    assert found["stroke_frequency"] is None


@pytest.mark.slow
@pytest.mark.parametrize("radius", [5, 7, 9])
def test_a_whole_marker_is_not_reported_as_hidden(tmp_path, radius):
    """Pixel phase and codec change the area, in single frames by six standard deviations."""
    course = clutter.straight(30, 110, 35, 0, sway=8, beat_hz=0.9)
    things = [clutter.disc(course, radius, colour, ahead=x) for colour, x in ((RED, 20), (YELLOW, -20))]
    clutter.write(tmp_path / "film.mp4", Pool(tuple(things), duration_s=SECONDS, rate_hz=25.0))
    markers = "".join(f"  - name: {name}\n    hsv: {hsv}\n" for name, hsv in HSV.items())
    text = f"format: swimid-setup/1\nmarkers:\n{markers}head: red\ntail: yellow\n"
    (tmp_path / "s.yaml").write_text(text + "scale: {metres_per_pixel: 0.002}\n")
    track("video", tmp_path / "film.mp4", "--setup", tmp_path / "s.yaml", "-o", tmp_path / "run.csv")
    checks = {check.name: check for check in evidence.read(tmp_path / "run.evidence.json").checks}
    assert checks["Hidden in part"].verdict == "pass"
