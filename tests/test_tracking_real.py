"""Real films measured by others (SWIMID_DATA), with hand-written and with proposed setups."""

import os
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tests.conftest import track

DATA = os.environ.get("SWIMID_DATA")
pytestmark = pytest.mark.skipif(not DATA, reason="SWIMID_DATA is not set")

BY_HAND = {
    "tractor_video.mp4": "{hue_deg: [345, 12], saturation: [0.55, 1], value: [0.35, 1]}\n"
    "    area_px: [100, 3000]",
    "ball2.mp4": "{hue_deg: [75, 130], saturation: [0.2, 1], value: [0.15, 0.65]}\n    area_px: [100, 8000]",
    "R1.MP4": "{hue_deg: [90, 190], saturation: [0.2, 1], value: [0.1, 0.6]}\n    area_px: [50, 600]",
    "R3.MP4": "{hue_deg: [90, 190], saturation: [0.2, 1], value: [0.1, 0.6]}\n    area_px: [50, 600]",
}


def tracked(tmp_path, folder, name, proposed, *options):
    video, setup = Path(DATA) / folder / name, tmp_path / "setup.yaml"
    if proposed:
        track("setup", video, "-o", setup)
    else:
        setup.write_text(f"format: swimid-setup/1\nmarkers:\n  - name: mark\n    hsv: {BY_HAND[name]}\n")
    track("video", video, "--setup", setup, "-o", tmp_path / "run.csv", *options)
    return pd.read_csv(tmp_path / "run.csv", comment="#")


@pytest.mark.parametrize("proposed", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_the_tractor_has_its_published_speed(tmp_path, proposed):
    """It is found in all frames but one at most, and moves by 2.49 px a frame."""
    log = tracked(tmp_path, "tracktor", "tractor_video.mp4", proposed)
    assert log.found.sum() >= 69
    seen = log[log.found == 1]
    slope = [np.polyfit(seen.frame, seen[c], 1)[0] for c in ("x_px", "y_px")]
    assert np.hypot(*slope) == pytest.approx(2.49, rel=0.02)
    # the published track is that of another point of the tractor, at a constant offset
    published = pd.read_csv(Path(DATA) / "tracktor" / "tractor_video_tracked.csv")
    marker = next(c for c in log.columns if c.endswith("_y_px") and not c.startswith(("y", "vy")))
    both = log[["frame", marker]].merge(published[["frame", "pos_y"]].astype({"frame": int}), on="frame")
    offset = (both[marker] - both.pos_y).dropna()
    assert offset.std() < 2


@pytest.mark.slow
@pytest.mark.parametrize("proposed", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_the_green_ball_is_found_only_when_it_is_visible(tmp_path, proposed):
    """A ball that is moved in and out of the picture is found only in frames that show it."""
    log = tracked(tmp_path, "green_ball", "ball2.mp4", proposed)
    seen = log.filter(regex="(?<!^)_status$").iloc[:, 0] != "lost"
    cut = log.filter(like="_at_edge").iloc[:, 0] == 1
    assert 860 <= seen.sum() <= 890
    # a ball that the edge of the picture cuts is seen, but not measured
    assert 20 <= cut.sum() <= 45
    assert ((log.found == 1) == (seen & ~cut)).all()
    # frames that show an empty wall, by inspection
    for start, end in ((0, 24), (470, 486), (794, 815), (972, 1004)):
        assert log.found[start:end].sum() == 0
        assert (
            log.filter(like="_x_px").iloc[start:end].drop(columns="x_px", errors="ignore").isna().all().all()
        )


@pytest.mark.slow
@pytest.mark.parametrize("proposed", [False, True])
@pytest.mark.parametrize("name, acceleration", [("R1.MP4", 340), ("R3.MP4", 773)])
def test_the_block_on_a_ramp_has_its_published_acceleration(tmp_path, name, acceleration, proposed):
    """The acceleration is constant while the block slides; a similar box in the corner is not followed."""
    log = tracked(tmp_path, "phystrack", name, proposed, "--fps", "240")
    x, y, t = log.x_px.to_numpy(), log.y_px.to_numpy(), log.t_s.to_numpy()
    seen = (log.found == 1).to_numpy()
    start = x[seen][0]
    sliding = np.flatnonzero(seen & (np.abs(x - start) > 8) & (x > 30))
    part = slice(sliding[0], sliding[-1] + 1)
    clock = t[part] - t[part][0]
    fits = [np.polyfit(clock, v[part], 2) for v in (x, y)]
    error = [v[part] - np.polyval(f, clock) for v, f in zip((x, y), fits, strict=True)]
    assert np.sqrt(np.mean(error[0] ** 2 + error[1] ** 2)) < 1
    assert 2 * np.hypot(fits[0][0], fits[1][0]) == pytest.approx(acceleration, rel=0.03)
    assert seen[part].mean() > 0.99
    assert seen[450:].sum() == 0


def test_a_grey_film_is_refused(tmp_path):
    """A grey film has no coloured marker: both commands report it and stop."""
    video = Path(DATA) / "grey_swimmer" / "grey.mp4"
    output = track("setup", video, "-o", tmp_path / "setup.yaml", status=4)
    assert "grey" in output.output
    assert not (tmp_path / "setup.yaml").exists()
    (tmp_path / "setup.yaml").write_text(
        f"format: swimid-setup/1\nmarkers:\n  - name: mark\n    hsv: {BY_HAND['R1.MP4']}\n"
    )
    output = track("video", video, "--setup", tmp_path / "setup.yaml", "-o", tmp_path / "run.csv", status=4)
    assert "grey" in output.output
