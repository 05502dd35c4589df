"""A film as a folder of pictures or a pattern of names, compared with the same film as one file."""

import cv2
import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner

from swimid.cli.main import track_group
from swimid.results import evidence
from swimid.tracking.frames import Video
from tests.generators.disc_film import ONE_RED, Disc, Film, straight

FILM = Film((Disc(straight(40, 120, 90, 10), radius=10),), duration_s=2.0)


def write(folder, name, frames):
    """Write pictures, {number: picture}, with names of a pattern."""
    folder.mkdir(exist_ok=True)
    for number, frame in frames.items():
        assert cv2.imwrite(str(folder / (name % number)), frame)
    return folder


@pytest.fixture
def pictures(tmp_path):
    return write(tmp_path / "shots", "shot_%04d.png", dict(enumerate(FILM.frames(), start=1)))


@pytest.fixture
def run(tmp_path):
    """Track a film; return the log (None if it fails) and the output."""
    setup = tmp_path / "setup.yaml"
    setup.write_text(ONE_RED)

    def run(film, *options, status=0, output=tmp_path / "run.csv"):
        command = ["video", film, "--setup", setup, "-o", output, *options]
        result = CliRunner().invoke(track_group, [str(part) for part in command])
        assert result.exit_code == status, result.output
        return (None if status else pd.read_csv(output, comment="#")), result.output

    return run


def off(log, times):
    """Return the maximum distance of the marker from the truth, px."""
    x, y = np.array([FILM.discs[0].place(t) for t in times]).T
    return np.hypot(log.red_x_px - x, log.red_y_px - y).max()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["", "shot_%04d.png", "shot_%d.png"])
def test_a_folder_and_a_pattern_give_the_track_of_the_film(pictures, run, tmp_path, name):
    log, output = run(pictures / name, "--fps", 30)
    np.testing.assert_allclose(log.t_s, FILM.times(), atol=1e-9)
    assert log.found.all()
    assert off(log, FILM.times()) < 0.2
    assert "SWM04" not in output.replace("SWM041", "")
    inputs = evidence.read(tmp_path / "run.evidence.json").provenance["inputs"]
    assert len(inputs) == 2
    assert "first_stamp_s" not in (tmp_path / "run.csv").read_text()


def test_pictures_are_in_the_order_of_their_numbers(tmp_path, run):
    """Names 1, 2, ..., 10, 11 are in the order of the numbers, not of the alphabet."""
    folder = write(tmp_path / "shots", "%d.bmp", dict(enumerate(FILM.frames(), start=5)))
    log, _ = run(folder, "--fps", 30)
    assert off(log, FILM.times()) < 0.2


def test_the_time_of_a_missing_picture_is_left_out(pictures, run):
    for number in (11, 12, 40):
        (pictures / f"shot_{number:04d}.png").unlink()
    log, output = run(pictures, "--fps", 30)
    there = np.delete(FILM.times(), [10, 11, 39])
    np.testing.assert_allclose(log.t_s, there, atol=1e-9)
    assert off(log, there) < 0.2
    assert "SWM044" in output
    told = " ".join(output.split())
    assert "3 pictures are missing by their numbers (after shot_0010.png, after shot_0039.png)" in told
    assert np.abs(log.vx_px_s - 90).max() < 2


def test_every_tenth_picture_is_an_even_series(tmp_path, run):
    folder = write(tmp_path / "shots", "%05d.png", {10 * k: f for k, f in enumerate(FILM.frames())})
    log, output = run(folder / "%05d.png", "--fps", 30)
    np.testing.assert_allclose(log.t_s, FILM.times(), atol=1e-9)
    assert "SWM04" not in output.replace("SWM041", "")


def test_uneven_numbers_define_only_the_order(tmp_path, run):
    """Milliseconds in the names give a warning and even steps."""
    names = {round(1000 * t) + 1_700_000_000_000: f for t, f in zip(FILM.times(), FILM.frames(), strict=True)}
    log, output = run(write(tmp_path / "shots", "%d.png", names), "--fps", 30)
    np.testing.assert_allclose(log.t_s, FILM.times(), atol=1e-9)
    assert "step unevenly (by 33 to 34)" in output


def test_a_damaged_picture_is_left_out(pictures, run):
    (pictures / "shot_0021.png").write_bytes(b"no picture")
    log, output = run(pictures, "--fps", 30)
    assert "1 of 60 pictures could not be decoded (shot_0021.png)" in output
    np.testing.assert_allclose(log.t_s, np.delete(FILM.times(), 20), atol=1e-9)


def test_a_series_that_is_no_film_is_refused_with_a_hint(pictures, run, tmp_path):
    """The cases are: no rate, two series, two sizes, and no pictures."""
    _, output = run(pictures, status=3)
    assert "--fps" in output
    _, output = run(pictures / "none_%04d.png", "--fps", 30, status=3)
    assert "no picture has a name like this" in output
    _, output = run(tmp_path / "nowhere" / "%d.png", "--fps", 30, status=3)
    assert "no such folder" in output
    (tmp_path / "empty").mkdir()
    _, output = run(tmp_path / "empty", "--fps", 30, status=3)
    assert "without pictures" in output
    cv2.imwrite(str(pictures / "shot_0030.png"), np.zeros((99, 99, 3), np.uint8))
    _, output = run(pictures, "--fps", 30, status=3)
    assert "shot_0030.png" in output
    assert "99 x 99" in output
    cv2.imwrite(str(pictures / "mask_0001.png"), np.zeros((9, 9, 3), np.uint8))
    _, output = run(pictures, "--fps", 30, status=3)
    assert "60 like shot_#.png, 1 like mask_#.png" in output


def test_a_setup_is_drafted_from_pictures(pictures, tmp_path):
    result = CliRunner().invoke(
        track_group,
        ["setup", str(pictures), "-o", str(tmp_path / "s.yaml"), "--fps", "30", "--marker", "red@40,120"],
    )
    assert result.exit_code == 0, result.output


def test_the_reader_returns_the_pictures_unchanged(pictures):
    for (_, frame), true in zip(Video(pictures, frame_rate_hz=30).frames(), FILM.frames(), strict=True):
        np.testing.assert_array_equal(frame, true)
