"""Exit status and message for films and setups that cannot be used."""

import subprocess
import sys

import cv2
import numpy as np
import pytest
from click.testing import CliRunner

from swimid.cli.main import track_group
from tests.generators import pool_video
from tests.generators.pool_video import Scene

SETUP = """\
format: swimid-setup/1
markers:
  - name: red
    hsv: {hue_deg: [345, 15], saturation: [0.45, 1], value: [0.3, 1]}
"""


def run(*arguments):
    return CliRunner().invoke(track_group, [str(a) for a in arguments])


@pytest.fixture(scope="module")
def film(tmp_path_factory):
    folder = tmp_path_factory.mktemp("film")
    video, _, _ = pool_video.write_scene(folder, Scene(duration_s=3.0, dropout_s=None))
    return video


@pytest.fixture
def setup(tmp_path):
    path = tmp_path / "setup.yaml"
    path.write_text(SETUP)
    return path


def test_a_missing_film_is_refused(tmp_path, setup):
    result = run("video", tmp_path / "none.mp4", "--setup", setup, "-o", tmp_path / "run.csv")
    assert result.exit_code == 3
    assert "none.mp4" in result.output
    assert "no such file" in result.output


@pytest.mark.parametrize("content", [b"", b"hello, I am no video\n" * 50, bytes(range(256)) * 400])
def test_a_file_that_is_no_film_is_refused(tmp_path, setup, content):
    path = tmp_path / "bad.mp4"
    path.write_bytes(content)
    for verb in (["video", path, "--setup", setup], ["setup", path]):
        result = run(*verb, "-o", tmp_path / "out.csv")
        assert result.exit_code == 3, result.output
        assert "bad.mp4" in result.output
        assert "Traceback" not in result.output
        assert not (tmp_path / "out.csv").exists()


def test_a_recording_cut_before_its_index_is_refused(tmp_path, setup, film):
    """An MP4 without an index cannot be opened, and the message gives the reason."""
    path = tmp_path / "cut.mp4"
    path.write_bytes(film.read_bytes()[: film.stat().st_size // 2])
    result = run("video", path, "--setup", setup, "-o", tmp_path / "run.csv")
    assert result.exit_code == 3
    assert "index is missing" in result.output


def test_a_cut_recording_is_tracked_up_to_the_cut(tmp_path, setup, film):
    """A container with its index at the start yields the frames that it still has, with a warning."""
    import av

    whole = tmp_path / "whole.mp4"
    with av.open(str(film)) as source, av.open(str(whole), "w", options={"movflags": "faststart"}) as target:
        stream = target.add_stream_from_template(source.streams.video[0])
        for packet in source.demux(video=0):
            if packet.dts is not None:
                packet.stream = stream
                target.mux(packet)
    path = tmp_path / "cut.mp4"
    path.write_bytes(whole.read_bytes()[: int(0.6 * whole.stat().st_size)])
    result = run("video", path, "--setup", setup, "-o", tmp_path / "run.csv")
    assert result.exit_code == 0, result.output
    assert "SWM044" in result.output
    rows = (tmp_path / "run.csv").read_text().splitlines()
    assert 20 < len(rows) < 90


@pytest.mark.slow
def test_a_film_damaged_in_the_middle_gives_a_log_or_a_refusal(tmp_path, setup, film):
    """Overwritten bytes never cause a crash or messages of FFmpeg."""
    rng = np.random.default_rng(4)
    data = bytearray(film.read_bytes())
    middle = len(data) // 3
    data[middle : middle + len(data) // 5] = rng.integers(0, 256, len(data) // 5, dtype=np.uint8).tobytes()
    path = tmp_path / "damaged.mp4"
    path.write_bytes(data)
    command = [sys.executable, "-c", "from swimid.cli.main import track; track()"]
    done = subprocess.run(
        [*command, "video", str(path), "--setup", str(setup), "-o", str(tmp_path / "run.csv")],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode in (0, 3, 4), done.stderr
    assert "Traceback" not in done.stderr
    assert "[h264" not in done.stderr


def test_a_film_without_the_colour_is_refused(tmp_path, film):
    setup = tmp_path / "setup.yaml"
    setup.write_text(SETUP.replace("[345, 15]", "[280, 310]"))
    result = run("video", film, "--setup", setup, "-o", tmp_path / "run.csv")
    assert result.exit_code == 4
    assert "was found in no frame of 90" in result.output
    assert "swimid track setup" in result.output
    assert "Colours in the picture" in result.output
    assert not (tmp_path / "run.csv").exists()


def write_film(path, frames):
    writer = cv2.VideoWriter(
        str(path), cv2.VideoWriter.fourcc(*"mp4v"), 30, (frames[0].shape[1], frames[0].shape[0])
    )
    for frame in frames:
        writer.write(frame)
    writer.release()


def test_track_setup_refuses_grey_and_still_films(tmp_path):
    """Without colour or motion there is no proposal: exit status 4, and no file."""
    rng = np.random.default_rng(0)
    base = cv2.GaussianBlur(rng.integers(60, 190, (120, 160, 1), dtype=np.uint8).repeat(3, axis=2), (9, 9), 0)
    grey = [cv2.circle(base.copy(), (20 + 3 * i, 60), 8, (30, 30, 30), -1) for i in range(40)]
    still = [cv2.circle(base.copy(), (80, 60), 8, (20, 20, 220), -1) for _ in range(40)]
    for name, frames in (("grey", grey), ("still", still)):
        write_film(tmp_path / f"{name}.mp4", frames)
        result = run("setup", tmp_path / f"{name}.mp4", "-o", tmp_path / f"{name}.yaml")
        assert result.exit_code == 4, result.output
        assert "--marker" in result.output
        assert not (tmp_path / f"{name}.yaml").exists()


def test_a_marker_seen_in_few_frames_is_refused(tmp_path, setup):
    """The marker is in fewer than one of twenty frames."""
    water = np.full((120, 160, 3), (120, 100, 60), np.uint8)
    frames = [water.copy() for _ in range(200)]
    for i in range(50, 57):
        cv2.circle(frames[i], (60 + i, 60), 8, (30, 30, 220), -1)
    write_film(tmp_path / "moment.mp4", frames)
    result = run("video", tmp_path / "moment.mp4", "--setup", setup, "-o", tmp_path / "run.csv")
    assert result.exit_code == 4
    assert "7 of 200 frames only" in result.output


@pytest.mark.parametrize(
    "text, words",
    [
        (SETUP.replace("markers:", "markerz:"), ["markerz", "did you mean 'markers'"]),
        (SETUP + "max_gap: 1\n", ["line 5", "max_gap", "max_gap_s"]),
        (SETUP.replace("value: [0.3, 1]", "value: [0.9, 0.3]"), ["smallest, largest"]),
        (SETUP.replace("value: [0.3, 1]", "value: bright"), ["value"]),
        (SETUP + "    method: background\n", ["omit its hsv"]),
        (SETUP.replace("hsv:", "method: colour #"), ["marker 'red' needs hsv"]),
        (
            SETUP + "  - {name: body, method: background}\n",
            ["allows one marker, but the setup has red, body"],
        ),
        (
            SETUP + "scale: {metres_per_pixel: 0.002, points_px: [[0, 0], [9, 9]], distance_m: 1}\n",
            ["incomplete or contradicts itself"],
        ),
        (SETUP + "scale: {metres_per_pixel: -1}\n", ["metres_per_pixel"]),
        (SETUP + "scale: {points_px: [[0, 0], [9, 9]], points_m: [[0, 0], [1, 1]]}\n", ["four or more"]),
        (SETUP + "scale: {points_px: [[4, 4], [4, 4]], distance_m: 1}\n", ["both points_px are [4"]),
        (
            SETUP + "scale: {points_px: [[0, 0], [9, 9], [20, 20], [30, 30]], "
            "points_m: [[0, 0], [1, 1], [2, 2], [3, 3]]}\n",
            ["on a line"],
        ),
        (SETUP + "head: blue\n", ["head 'blue' is no marker", "red"]),
        (SETUP + "frame_rate_hz: 0\n", ["frame_rate_hz"]),
        (SETUP + "camera: {matrix: [[1, 0], [0, 1]]}\n", ["matrix"]),
        ("format: swimid-trials/1\nmarkers: []\n", ["format"]),
        ("", ["is empty"]),
    ],
)
def test_a_bad_setup_is_refused_with_the_place_of_the_error(tmp_path, film, text, words):
    path = tmp_path / "setup.yaml"
    path.write_text(text)
    result = run("video", film, "--setup", path, "-o", tmp_path / "run.csv")
    assert result.exit_code == 3, result.output
    assert "setup.yaml" in result.output
    for word in words:
        assert word in result.output
    assert not (tmp_path / "run.csv").exists()


@pytest.mark.parametrize("arguments, words", [(["--fps", "0"], "--fps"), (["--max-gap", "-1"], "--max-gap")])
def test_bad_options_are_refused(tmp_path, film, setup, arguments, words):
    result = run("video", film, "--setup", setup, "-o", tmp_path / "run.csv", *arguments)
    assert result.exit_code == 2
    assert words in result.output


def test_the_output_must_not_be_an_input(tmp_path, film, setup):
    """The log must not overwrite the setup."""
    before = setup.read_text()
    result = run("video", film, "--setup", setup, "-o", setup)
    assert result.exit_code == 2
    assert setup.read_text() == before
