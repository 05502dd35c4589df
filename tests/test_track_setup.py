"""Setups drafted from films with things that are no markers, and from markers picked by hand."""

import json

import cv2
import numpy as np
import pandas as pd
import pytest

from swimid.results import evidence
from swimid.tracking import setup as setup_format
from swimid.tracking.frames import scene_shifts
from tests.conftest import track
from tests.generators import clutter_video as clutter
from tests.generators.clutter_video import BLACK, GREY, RED, WHITE, YELLOW, Pool

ACROSS = clutter.straight(20, 118, 93, 0)


def rule(colour=YELLOW, y=120):
    """Return a rule on the floor of the pool; the fish passes over its middle at y = 120."""
    return clutter.rule(clutter.still(160, y, 0.2), 150, 12, colour)


def two_discs(motion, one=RED, other=YELLOW):
    """Return a grey fish with a disc at its front and one at its rear."""
    fish = clutter.fish(motion, 80, 30)
    return fish, clutter.disc(motion, 7, one, ahead=24), clutter.disc(motion, 7, other, ahead=-24)


@pytest.fixture(scope="module")
def covered_rule(tmp_path_factory):
    """Return a film of a grey fish without a marker over a yellow rule, seen through ripples."""
    folder = tmp_path_factory.mktemp("rule")
    return clutter.write(folder / "rule.mp4", Pool((rule(), clutter.fish(ACROSS)), ripple_px=2.0))


def test_a_rule_that_is_covered_at_times_is_not_proposed(tmp_path, covered_rule):
    """It is found in all frames, and the passing fish shifts its centre, but it does not move."""
    result = track("setup", covered_rule, "-o", tmp_path / "setup.yaml", status=4)
    assert "yellow (hue" in result.output
    assert "moves in only" in result.output
    assert not (tmp_path / "setup.yaml").exists()


@pytest.mark.parametrize("scale", ["", "scale: {metres_per_pixel: 0.002}\n"])
def test_a_motionless_track_is_never_good(tmp_path, covered_rule, scale):
    """With the rule as a marker in the setup, the verdict states that it does not move."""
    (tmp_path / "setup.yaml").write_text(
        "format: swimid-setup/1\nmarkers:\n  - name: mark\n"
        "    hsv: {hue_deg: [40, 70], saturation: [0.4, 1], value: [0.3, 1]}\n" + scale
    )
    result = track("video", covered_rule, "--setup", tmp_path / "setup.yaml", "-o", tmp_path / "run.csv")
    assert "SWM067" in result.output
    proof = evidence.read(tmp_path / "run.evidence.json")
    assert {c.name: c.verdict for c in proof.checks}["Motion"] in ("warn", "fail")
    assert proof.verdict.level != "good"


@pytest.mark.parametrize("turn_rad, verdict", [(0.0, "warn"), (0.004, "warn"), (0.12, "pass")])
def test_motion_of_less_than_a_radius_must_turn_the_robot(tmp_path, turn_rad, verdict):
    """A raft that rocks in a wave is no robot; a fish whose body turns with its beat in one place may be."""

    def rock(t):
        wave = np.sin(2 * np.pi * 1.3 * t)
        return 160 + 0.5 * wave, 118 + 3.0 * wave, turn_rad * wave

    video = clutter.write(tmp_path / "raft.mp4", Pool(two_discs(rock), duration_s=6.0))
    (tmp_path / "setup.yaml").write_text(
        "format: swimid-setup/1\nmarkers:\n"
        "  - {name: nose, hsv: {hue_deg: [345, 15], saturation: [0.45, 1], value: [0.3, 1]}}\n"
        "  - {name: rear, hsv: {hue_deg: [40, 70], saturation: [0.4, 1], value: [0.3, 1]}}\n"
        "head: nose\ntail: rear\nscale: {metres_per_pixel: 0.002}\n"
    )
    track("video", video, "--setup", tmp_path / "setup.yaml", "-o", tmp_path / "run.csv")
    checks = {check.name: check for check in evidence.read(tmp_path / "run.evidence.json").checks}
    assert checks["Motion"].verdict == verdict


def test_a_track_within_its_noise_is_bad(tmp_path):
    """A motionless disc without ripples is found in all frames; both commands report it."""
    buoy = clutter.disc(clutter.still(200, 60), 6, YELLOW)
    things = (buoy, clutter.fish(clutter.straight(20, 150, 93, 0)))
    video = clutter.write(tmp_path / "buoy.mp4", Pool(things, duration_s=2.0))
    result = track("setup", video, "-o", tmp_path / "setup.yaml", "--marker", "buoy@200,60")
    assert "SWM067" in result.output
    output = track("video", video, "--setup", tmp_path / "setup.yaml", "-o", tmp_path / "run.csv")
    assert "which is not above the noise" in " ".join(output.output.split())
    assert evidence.read(tmp_path / "run.evidence.json").verdict.level == "bad"


@pytest.mark.slow
def test_a_motionless_thing_in_front_of_a_swaying_camera_is_not_proposed(tmp_path):
    """A buoy that moves with the whole scene is rejected, and both commands warn of the camera."""
    floor = tuple(
        clutter.rule(clutter.still(40 + 60 * k, 60 + 45 * (k % 4), 0.5 * k), 50, 9, clutter.DARK)
        for k in range(5)
    )
    buoy = clutter.disc(clutter.still(230, 40), 5, YELLOW)
    things = (*floor, buoy, clutter.fish(clutter.straight(20, 150, 93, 0)))
    video = clutter.write(tmp_path / "sway.mp4", Pool(things, sway_px=8.0, flicker=0.02))
    result = track("setup", video, "-o", tmp_path / "setup.yaml", status=4)
    assert "yellow" in result.output
    assert "does not move (stays within" in result.output
    assert "SWM068" in result.output
    (tmp_path / "setup.yaml").write_text(
        "format: swimid-setup/1\nmarkers:\n  - name: buoy\n"
        "    hsv: {hue_deg: [40, 70], saturation: [0.4, 1], value: [0.3, 1]}\n"
        "scale: {metres_per_pixel: 0.002}\n"
    )
    track("video", video, "--setup", tmp_path / "setup.yaml", "-o", tmp_path / "run.csv")
    proof = evidence.read(tmp_path / "run.evidence.json")
    assert {c.name: c.verdict for c in proof.checks}["Camera"] == "warn"
    assert proof.verdict.level != "good"


def test_a_robot_near_the_camera_is_not_the_scene():
    """Over plain water nearly all corners are on the robot and move with it, not with the camera."""
    near = clutter.straight(90, 120, 40, 0)
    discs = ((RED, 50), (YELLOW, -50), (WHITE, 0))
    things = (clutter.rule(near, 150, 60, clutter.DARK), *(clutter.disc(near, 9, c, a) for c, a in discs))
    frames = clutter.frames(Pool(things, noise=1.0, flicker=0.0, duration_s=1.5))
    assert np.isnan(scene_shifts(frames[::10])[1:]).all()


@pytest.mark.slow
def test_a_marker_beside_a_rule_of_its_colour_is_followed(tmp_path):
    """The moving thing is the marker; the rule of its colour is left out, and other colours are listed."""
    fish = clutter.straight(20, 160, 93, 0)
    things = (rule(RED, 60), rule(YELLOW, 100), clutter.fish(fish), clutter.disc(fish, 5, RED, ahead=20))
    video = clutter.write(tmp_path / "two.mp4", Pool(things, ripple_px=2.0))
    result = track("setup", video, "-o", tmp_path / "setup.yaml")
    assert "head red; no tail" in result.output
    assert "passed over: yellow" in result.output
    assert "# passed over: yellow" in (tmp_path / "setup.yaml").read_text()
    track("video", video, "--setup", tmp_path / "setup.yaml", "-o", tmp_path / "run.csv")
    log = pd.read_csv(tmp_path / "run.csv", comment="#")
    assert (log.red_x_px - (40 + 93 * log.t_s)).abs().median() < 1.5


@pytest.mark.parametrize("nod_rad", [0.5, 0.8])
def test_the_halves_of_a_ball_are_not_a_rigid_pair(tmp_path, nod_rad):
    """The distance of the halves is not constant: one of them is proposed, without a tail."""
    ball = clutter.ball(clutter.straight(40, 60, 80, 40), 18, (RED, YELLOW), nod_rad=nod_rad)
    video = clutter.write(tmp_path / "ball.mp4", Pool((ball,)))
    result = track("setup", video, "-o", tmp_path / "setup.yaml", "--json")
    found = json.loads(result.stdout)["result"]
    assert found["tail"] is None
    assert len(found["markers"]) == 1
    assert any("not on one rigid part" in p["reason"] for p in found["passed_over"])


def test_a_rigid_pair_is_recognised_by_an_inclined_camera(tmp_path):
    """Lengths are much smaller at the far side and a quarter shorter along the view."""
    pool = Pool(two_discs(clutter.circle(160, 120, 80, 3.0)), far=0.6, flat=0.75)
    video = clutter.write(tmp_path / "askew.mp4", pool)
    result = track("setup", video, "-o", tmp_path / "setup.yaml")
    assert "head red, tail yellow" in result.output
    assert "SWM042" not in result.output


@pytest.mark.slow
@pytest.mark.parametrize(
    "colour, water",
    [(WHITE, (150, 122, 70)), (BLACK, (150, 122, 70)), (GREY, (190, 170, 140)), (WHITE, (128, 126, 124))],
    ids=["white", "black", "grey", "white-on-grey"],
)
def test_a_marker_of_any_shade_can_be_picked(tmp_path, colour, water):
    """Grey, white and black have no hue; saturation and value separate them from the water."""
    motion = clutter.straight(30, 60, 85, 40)
    pool = Pool((clutter.disc(motion, 8, colour),), water=water, flicker=0.04)
    video = clutter.write(tmp_path / "shade.mp4", pool)
    result = track("setup", video, "-o", tmp_path / "setup.yaml", "--marker", "mark@30,60")
    assert "mark: found in 100.0 %" in result.output
    track("video", video, "--setup", tmp_path / "setup.yaml", "-o", tmp_path / "run.csv")
    log = pd.read_csv(tmp_path / "run.csv", comment="#")
    assert (log.found == 1).mean() > 0.98
    assert (log.mark_x_px - (30 + 85 * log.t_s)).abs().max() < 0.6
    assert (log.mark_y_px - (60 + 40 * log.t_s)).abs().max() < 0.6


def test_a_pixel_of_the_water_is_refused(tmp_path):
    """No patch differs from its surroundings there, and the message states the colour."""
    video = clutter.write(tmp_path / "w.mp4", Pool(two_discs(ACROSS), duration_s=1.0))
    result = track("setup", video, "-o", tmp_path / "s.yaml", "--marker", "a@200,40", status=3)
    assert "stands out" in result.output or "colour of its surroundings" in result.output


def school(count=8):
    """Return equal discs, each on its own course."""
    return tuple(
        clutter.disc(clutter.straight(30 + 34 * k, 30 + 20 * (k % 3), 2 * k, 35 + 4 * (k % 2)), 6, RED)
        for k in range(count)
    )


@pytest.mark.slow
def test_eight_markers_of_one_colour_need_no_tail(tmp_path):
    """With ``number: 8`` every marker has its columns, and the first gives the position."""
    video = clutter.write(tmp_path / "school.mp4", Pool(school(), duration_s=2.0))
    (tmp_path / "setup.yaml").write_text(
        "format: swimid-setup/1\nmarkers:\n  - name: red\n    number: 8\n"
        "    hsv: {hue_deg: [345, 15], saturation: [0.45, 1], value: [0.3, 1]}\n"
    )
    for plane in ("", "plane: vertical\n"):
        (tmp_path / "setup.yaml").write_text((tmp_path / "setup.yaml").read_text() + plane)
        output = track("video", video, "--setup", tmp_path / "setup.yaml", "-o", tmp_path / "run.csv")
        assert output.exit_code == 0
        proof = evidence.read(tmp_path / "run.evidence.json")
        assert "Other markers found" in {check.name for check in proof.checks}
    log = pd.read_csv(tmp_path / "run.csv", comment="#")
    for k in range(8):
        error = log[f"red{k + 1}_x_px"] - (30 + 34 * k + 2 * k * log.t_s)
        assert error.abs().max() < 0.6, k
    assert "yaw_rad" not in log


@pytest.mark.slow
def test_picks_of_one_name_are_equal_markers(tmp_path):
    """Two discs on one fish become head and tail; with two courses there is no tail."""
    fish = clutter.straight(60, 118, 60, 0)
    pair = clutter.write(tmp_path / "pair.mp4", Pool(two_discs(fish, RED, RED), duration_s=2.0))
    apart = clutter.write(tmp_path / "apart.mp4", Pool(school(2), duration_s=2.0))
    for film, frame, (one, other), tail in (
        (pair, 0, ("84,118", "36,118"), "tail red2"),
        (pair, 20, ("144,118", "96,118"), "tail red2"),
        (apart, 0, ("30,30", "64,50"), "no tail"),
    ):
        marks = ["--marker", f"red@{one}", "--marker", f"red@{other}", "--frame", frame]
        result = track("setup", film, "-o", tmp_path / "s.yaml", "--force", *marks)
        assert tail in result.output
        rules = setup_format.read(tmp_path / "s.yaml")
        assert rules.markers[0].number == 2
        assert (rules.markers[0].start_px is None) == (frame > 0)
        track("video", film, "--setup", tmp_path / "s.yaml", "-o", tmp_path / "run.csv")
        if film == pair and not frame:
            log = pd.read_csv(tmp_path / "run.csv", comment="#")
            assert log.yaw_rad.abs().max() < 0.03  # the first pick is the head


def test_picks_of_one_colour_and_two_names_are_refused(tmp_path):
    """The markers would be exchanged; the hint suggests one name."""
    video = clutter.write(tmp_path / "pair.mp4", Pool(two_discs(ACROSS, RED, RED), duration_s=1.0))
    marks = ["--marker", "nose@91,118", "--marker", "rear@43,118", "--frame", 10]
    result = track("setup", video, "-o", tmp_path / "s.yaml", *marks, status=3)
    assert "have one colour" in result.output
    assert "name them alike" in result.output


def test_a_buoy_among_equal_markers_is_reported(tmp_path):
    """Of three discs one does not move; it is named, and the track is not good."""
    buoy = clutter.disc(clutter.still(280, 200), 7, RED)
    video = clutter.write(tmp_path / "three.mp4", Pool((*school(2), buoy), duration_s=2.0))
    (tmp_path / "setup.yaml").write_text(
        "format: swimid-setup/1\nmarkers:\n  - name: red\n    number: 3\n"
        "    hsv: {hue_deg: [345, 15], saturation: [0.45, 1], value: [0.3, 1]}\n"
        "scale: {metres_per_pixel: 0.002}\n"
    )
    result = track("video", video, "--setup", tmp_path / "setup.yaml", "-o", tmp_path / "run.csv")
    assert "red3 stayed within one radius of one position" in result.output
    assert evidence.read(tmp_path / "run.evidence.json").verdict.level == "caution"


def test_a_patch_larger_than_a_marker_is_taken(tmp_path):
    """A black fish on white, a fifth of the picture, is followed where it is picked, and its size is said."""
    (tmp_path / "frames").mkdir()
    rng = np.random.default_rng(3)
    for k in range(12):
        image = np.full((240, 480, 3), 245.0)
        cv2.ellipse(image, (230 + 2 * k, 130), (150, 50), 0, 0, 360, (15, 15, 15), -1, cv2.LINE_AA)
        image = np.clip(image + rng.normal(0, 2, image.shape), 0, 255).astype(np.uint8)
        cv2.imwrite(str(tmp_path / "frames" / f"{k:03d}.png"), image)
    marker = ("--marker", "body@240,130", "--fps", "100")
    output = track("setup", tmp_path / "frames", *marker, "-o", tmp_path / "s.yaml").output
    assert "SWM101" in output
    assert "area_px" in output
    assert "body: found in 100.0 %" in output
