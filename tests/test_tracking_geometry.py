"""Geometry that a film states, films that are incomplete, several like objects, and the choice of a pair."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
from PIL import Image

from swimid.tracking.frames import Video
from tests.conftest import Ran
from tests.generators.disc_film import ONE_RED, YELLOW, Disc, Film, straight

Run = Callable[..., Ran]
GREEN = (60, 190, 40)


def write(path: Path, frames: Iterator[np.ndarray], codec: str, pixels: str, aspect: Fraction) -> Path:
    """Write a film that states the shape of its pixels."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=30)
        stream.width, stream.height, stream.pix_fmt = 320, 240, pixels
        stream.codec_context.sample_aspect_ratio = aspect
        if codec == "mjpeg":
            stream.codec_context.qmin = stream.codec_context.qmax = 2
        for image in frames:
            picture = av.VideoFrame.from_ndarray(image, format="bgr24").reformat(format=pixels)
            container.mux(stream.encode(picture))
        container.mux(stream.encode())
    return path


def rotate(path: Path) -> Path:
    """Write a rotation by 90 degrees into the track header of an MP4 file."""
    content = bytearray(path.read_bytes())
    at = content.index(b"tkhd") + 44
    matrix = [0, 1 << 16, 0, -(1 << 16), 0, 0, 0, 0, 1 << 30]
    content[at : at + 36] = b"".join(value.to_bytes(4, "big", signed=True) for value in matrix)
    path.write_bytes(content)
    return path


def level(ran: Ran) -> str:
    """Return the level of the verdict of a command with ``--json``."""
    assert ran.status == 0, ran.err
    return ran.json["verdict"]["level"]


@pytest.fixture
def tracked(swimid: Run, tmp_path: Path) -> Callable[..., Ran]:
    """Track a film with a setup."""

    def run(film: Path, setup: str = ONE_RED, *options: str) -> Ran:
        (tmp_path / "setup.yaml").write_text(setup)
        words = ("--setup", tmp_path / "setup.yaml", "-o", tmp_path / "run.csv", "--json", *options)
        return swimid("track", "video", film, *words)

    return run


# ---------------------------------------------------------------- shape of the pixels


@pytest.mark.parametrize(
    ("name", "codec", "pixels"),
    [("a.mp4", "libx264", "yuv420p"), ("a.mkv", "mpeg4", "yuv420p"), ("a.avi", "mjpeg", "yuvj420p")],
)
def test_lengths_across_are_stretched_by_the_pixel_aspect(
    name: str, codec: str, pixels: str, tracked: Callable[..., Ran], tmp_path: Path
) -> None:
    """A disc moves across and down at the same speed on the screen."""
    aspect = Fraction(64, 45)
    film = Film((Disc(straight(40, 40, 60 * 45 / 64, 60)),), duration_s=2.0)
    path = write(tmp_path / name, film.frames(), codec, pixels, aspect)
    assert Video(path).pixel_aspect == pytest.approx(64 / 45)
    scale = "scale: {points_px: [[100, 50], [190, 50]], distance_m: 1.28}\n"  # 90 * 64 / 45 = 128 lines
    ran = tracked(path, ONE_RED + scale, "--overlay", str(tmp_path / "overlay.mp4"))
    speed = ran.json["result"]["swimming"]["path_speed"]["value"]
    assert speed == pytest.approx(np.hypot(0.6, 0.6), rel=0.01)
    assert Video(tmp_path / "overlay.mp4").width == 454


def test_a_rotated_film_has_its_aspect_rotated(tmp_path: Path) -> None:
    film = Film((Disc(straight(40, 40, 60)),), duration_s=0.3)
    path = write(tmp_path / "a.mp4", film.frames(), "libx264", "yuv420p", Fraction(64, 45))
    video = Video(rotate(path))
    assert (video.width, video.height) == (240, 320)
    assert video.pixel_aspect == pytest.approx(45 / 64)


def test_pictures_of_unequal_density_are_named(tracked: Callable[..., Ran], tmp_path: Path) -> None:
    film, folder = Film((Disc(straight(40, 40, 60)),), duration_s=0.4), tmp_path / "pictures"
    folder.mkdir()
    for k, frame in enumerate(film.frames()):
        Image.fromarray(frame[:, :, ::-1]).save(folder / f"{k:03d}.png", dpi=(300, 200))
    ran = tracked(folder, ONE_RED, "--fps", "30")
    assert "SWM173" in ran.err
    assert "300 : 200" in ran.err


# ---------------------------------------------------------------- films that are incomplete


@pytest.mark.slow
def test_a_cut_film_is_a_caution(tracked: Callable[..., Ran], tmp_path: Path) -> None:
    film = Film((Disc(straight(40, 120, 60)),), duration_s=2.0)
    path = write(tmp_path / "a.avi", film.frames(), "mjpeg", "yuvj420p", Fraction(1))
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])
    ran = tracked(path)
    assert level(ran) == "caution"
    assert "of 60 frames could be decoded" in ran.json["verdict"]["text"]


@pytest.mark.slow
def test_a_series_with_missing_pictures_is_a_caution(tracked: Callable[..., Ran], tmp_path: Path) -> None:
    film, folder = Film((Disc(straight(40, 120, 60)),), duration_s=2.0), tmp_path / "pictures"
    folder.mkdir()
    for k, frame in enumerate(film.frames()):
        if k not in (20, 21):
            cv2.imwrite(str(folder / f"{k:03d}.png"), frame)
    ran = tracked(folder, ONE_RED, "--fps", "30")
    assert level(ran) == "caution"
    assert "2 pictures are missing by their numbers (after 019.png)" in ran.json["verdict"]["text"]


# ---------------------------------------------------------------- several objects of one colour


@pytest.mark.parametrize("others", [0, 1])
def test_a_second_moving_object_is_named(others: int, tracked: Callable[..., Ran], tmp_path: Path) -> None:
    """An object of the colour that stays, and a small one, are no alarm."""
    still = (Disc(lambda _: (280, 30)), Disc(lambda _: (30, 220), radius=4.0))
    second = (Disc(straight(40, 180, 50)),) * others
    film = Film((Disc(straight(40, 80, 50)), *still, *second), duration_s=4.0)
    ran = tracked(film.write(tmp_path / "a.mp4"))
    assert ("SWM172" in ran.err) == bool(others)
    if others:
        assert level(ran) == "caution"
        assert "2 objects of the colour of 'red' move" in ran.json["verdict"]["text"]
        for word in ("start_px", "number: 2", "ignore_px"):
            assert word in ran.json["verdict"]["text"]


# ---------------------------------------------------------------- choice of head and tail


@pytest.mark.slow
def test_the_rigid_pair_of_three_markers_is_chosen(swimid: Run, tmp_path: Path) -> None:
    """The marker on the fin is the largest; its distance to the others changes with every stroke."""

    def fin(time: float) -> tuple[float, float]:
        return 40 + 40 * time - 25 * np.sin(7 * time) ** 2, 120 + 25 * np.sin(7 * time)

    discs = (Disc(straight(110, 120, 40)), Disc(straight(75, 120, 40), colour=YELLOW), Disc(fin, 13.0, GREEN))
    film = Film(discs, duration_s=4.0).write(tmp_path / "a.mp4")
    ran = swimid("track", "setup", film, "-o", tmp_path / "setup.yaml", "--json")
    assert ran.status == 0, ran.err
    assert (ran.json["result"]["head"], ran.json["result"]["tail"]) == ("red", "yellow")
    [passed] = [one for one in ran.json["result"]["passed_over"] if one["colour"] == "green"]
    assert "these markers are not on one rigid part" in passed["reason"]
    picked = ["--marker=red@110,120", "--marker=green@40,120"]
    ran = swimid("track", "setup", film, *picked, "-o", tmp_path / "two.yaml", "--json")
    assert "SWM042" in ran.err
    assert "the distance of 'red' and 'green' changes by" in ran.err


def test_a_film_in_place_of_a_command(swimid: Run, tmp_path: Path) -> None:
    (tmp_path / "my film.mp4").write_bytes(b"film")
    ran = swimid("track", tmp_path / "my film.mp4")
    assert ran.status == 2
    assert f"type: swimid track setup '{tmp_path / 'my film.mp4'}' -o setup.yaml" in ran.err
