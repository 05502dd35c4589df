"""``swimid track camera``: the camera of rendered pictures, and pictures that do not determine it."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

import swimid as package
from swimid.tracking import setup as setup_format
from tests.conftest import Ran
from tests.generators import boards
from tests.generators.disc_film import Disc, Film, straight

WORDS = ("--squares", "9x6", "--square-mm", "25")
Run = Callable[..., Ran]


@pytest.fixture(scope="module")
def board(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Pictures of a tilted board, and four that cannot be used."""
    folder = boards.write(tmp_path_factory.mktemp("camera") / "board", 14)
    shutil.copy(folder / "03.png", folder / "20.png")
    cv2.imwrite(str(folder / "21.png"), np.full((240, 320), 128, np.uint8))
    cv2.imwrite(str(folder / "22.png"), np.full((480, 640), 128, np.uint8))
    (folder / "23.png").write_bytes(b"no picture")
    return folder


def test_the_camera_comes_back(board: Path, swimid: Run, tmp_path: Path) -> None:
    ran = swimid("track", "camera", board, *WORDS, "-o", tmp_path / "camera.yaml", "--json", "-v")
    assert ran.status == 0, ran.err
    assert ran.json["verdict"]["level"] == "good", ran.json["verdict"]
    for name, reason in (
        ("20.png", "shows the board in the same place as"),
        ("21.png", "does not show the whole board of 8 x 5 inner corners"),
        ("22.png", "has 640 x 480 pixels, but the first picture with the board has 320 x 240"),
        ("23.png", "cannot be decoded"),
    ):
        assert f"{name} {reason}" in ran.err
    made = package.load_result(tmp_path / "camera.yaml").file
    matrix, errors = np.array(made.camera.matrix), made.standard_errors
    for name, value, true in (
        ("fx", matrix[0, 0], boards.FOCAL),
        ("fy", matrix[1, 1], boards.FOCAL),
        ("cx", matrix[0, 2], boards.CENTRE[0]),
        ("cy", matrix[1, 2], boards.CENTRE[1]),
        ("k1", made.camera.distortion[0], boards.LENS[0]),
    ):
        assert abs(value - true) < 4 * errors[name], name
    assert errors["fx"] < 0.01 * boards.FOCAL


def test_a_setup_takes_the_camera(board: Path, swimid: Run, tmp_path: Path) -> None:
    camera, output = tmp_path / "camera.yaml", ("-o", tmp_path / "setup.yaml")
    package.track_camera(sorted(board.glob("0*.png")), squares="9x6", square_mm=25.0, output=camera)
    film = Film((Disc(straight(40, 80, 60)),), duration_s=1.0).write(tmp_path / "a.mp4")
    words = ("track", "setup", film, "--marker", "red@40,80", *output, "--camera")
    assert swimid(*words, tmp_path / "nowhere.yaml").status == 3
    assert swimid(*words, camera).status == 0
    made = package.load_result(camera).file
    assert setup_format.read(tmp_path / "setup.yaml").camera == made.camera


def test_pictures_in_one_plane_are_bad(swimid: Run, tmp_path: Path) -> None:
    """The focal length of flat pictures looks exact, and is wrong."""
    folder = boards.write(tmp_path / "flat", 10, tilt_deg=0.0)
    ran = swimid("track", "camera", folder, *WORDS, "-o", tmp_path / "camera.yaml")
    assert ran.status == 0
    assert "BAD" in ran.out
    assert "pictures in one plane do not determine the focal length" in " ".join(ran.out.split())


def test_one_picture_and_a_wrong_board_are_refused(board: Path, swimid: Run, tmp_path: Path) -> None:
    output = ("-o", tmp_path / "camera.yaml")
    ran = swimid("track", "camera", board / "02.png", *WORDS, *output)
    assert ran.status == 4
    assert "at least 3 at different tilts are needed" in ran.err
    few = [board / f"0{k}.png" for k in range(3)]
    ran = swimid("track", "camera", *few, "--squares", "8x5", "--square-mm", "25", *output)
    assert ran.status == 4
    assert "--squares 9x6" in ran.err
    ran = swimid("track", "camera", *few, "--squares", "9by6", "--square-mm", "25", *output)
    assert ran.status == 2
    assert "does not state two numbers of squares" in ran.err
    assert not output[1].exists()
