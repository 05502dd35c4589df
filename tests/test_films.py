"""Films of a robot that swims tail first or has no markers, of repeated pictures, and of another camera."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pandas as pd
import pytest

import swimid
from swimid.errors import InputError
from tests.generators import film_writer
from tests.generators.disc_film import RED, YELLOW, Disc, Film

MARKERS = [
    {
        "name": "red",
        "method": "colour",
        "hsv": {"hue_deg": [345, 15], "saturation": [0.45, 1], "value": [0.3, 1]},
    },
    {"name": "yellow", "hsv": {"hue_deg": [40, 75], "saturation": [0.4, 1], "value": [0.35, 1]}},
]
SETUP = {"markers": MARKERS, "head": "red", "tail": "yellow", "scale": {"metres_per_pixel": 0.001}}
EXCHANGED = SETUP | {"head": "yellow", "tail": "red"}
SIZE = (320, 240)


def nose(t):
    """Return the place of the red disc at a time: down the picture, with a beat."""
    return 150 + 4 * math.sin(2 * math.pi * 1.3 * t), 60 + 45 * t


def rear(t):
    """Return the place of the yellow disc, 40 px behind the red one."""
    x, y = nose(t)
    turn = 0.1 * math.cos(2 * math.pi * 1.3 * t)
    return x - 40 * math.sin(turn), y - 40 * math.cos(turn)


@pytest.fixture(scope="module")
def film(tmp_path_factory):
    """Return a film of two seconds."""
    discs = (Disc(nose), Disc(rear, colour=YELLOW))
    return Film(discs, duration_s=2.0).write(tmp_path_factory.mktemp("films") / "film.mp4")


def verdicts(track):
    """Return the verdict of each check by its name."""
    return {check.name: check.verdict for check in track.evidence.checks}


@pytest.mark.slow
def test_a_robot_that_swims_tail_first_is_bad_unless_the_setup_states_it(film):
    assert verdicts(swimid.track_video(film, setup=SETUP))["Swims head first"] == "pass"
    with pytest.warns(swimid.SwimidWarning, match="SWM100"):
        wrong = swimid.track_video(film, setup=EXCHANGED)
    assert wrong.evidence.verdict.level == "bad"
    stated = swimid.track_video(film, setup=EXCHANGED | {"swims": "tail-first"})
    assert verdicts(stated)["Swims tail first"] == "pass"


@pytest.mark.slow
def test_false_detections_do_not_affect_the_direction_check(tmp_path):
    """A red float ahead of the robot is detected while the head marker is hidden, in a third of the film."""

    def hidden(t):
        return None if 0.7 < t < 1.4 else nose(t)

    discs = (Disc(hidden), Disc(rear, colour=YELLOW), Disc(lambda t: (40, 20 + 3 * math.sin(3 * t)), 10, RED))
    film = Film(discs, duration_s=2.5).write(tmp_path / "float.mp4")
    draft = swimid.track_setup(film)
    assert (draft.setup.head, draft.setup.tail) == ("red", "yellow")
    assert "swims head first in 100 % of the steps" in draft.text


@pytest.mark.parametrize("size", [(480, 360), (640, 480), (1280, 960)])
def test_a_camera_matrix_of_a_larger_picture_is_scaled(film, size):
    """The setup states the size of the pictures of the matrix; without it the setup is refused."""
    width, height = size
    matrix = [[width, 0, (width - 1) / 2], [0, width, (height - 1) / 2], [0, 0, 1]]
    setup = SETUP | {"camera": {"matrix": matrix}}
    with pytest.raises(InputError, match="size_px"):
        swimid.track_video(film, setup=setup)
    setup["camera"]["size_px"] = size
    with_size = swimid.track_video(film, setup=setup).frame
    plain = swimid.track_video(film, setup=SETUP).frame
    assert np.allclose(with_size.x_m, plain.x_m, atol=2e-5)


def test_a_camera_matrix_of_other_proportions_is_refused(film):
    matrix = [[640, 0, 319.5], [0, 640, 179.5], [0, 0, 1]]
    setup = SETUP | {"camera": {"matrix": matrix, "size_px": [640, 360]}}
    with pytest.raises(InputError, match="no scaled copy"):
        swimid.track_video(film, setup=setup)


def test_a_film_that_repeats_every_other_picture_is_not_good(tmp_path):
    """With 15 pictures/s in a film of 30 Hz half of the frames are left out; the band holds the truth."""
    taken = Film((Disc(nose), Disc(rear, colour=YELLOW)), duration_s=3.0, rate_hz=15.0)
    pictures = [picture for picture in taken.frames() for _ in range(2)]
    film = film_writer.write(
        tmp_path / "twice.mp4", pictures, size=SIZE, times=np.arange(90) / 30, rate_hz=30, crf=18
    )
    with pytest.warns(swimid.SwimidWarning, match="SWM058"):
        made = swimid.track_video(film, setup=SETUP)
    log = made.frame
    assert made.evidence.verdict.level == "caution"
    assert 40 <= (log.found == 0).sum() <= 46
    true = np.array([nose(t)[1] for t in log.t_s])
    assert (np.abs(239 - true - 1000 * log.y_m) <= 1.96 * 1000 * log.y_sd_m).mean() > 0.9


@pytest.mark.parametrize("shade", [60, 20])
def test_a_grey_body_in_front_of_its_empty_scene_is_followed(tmp_path, shade):
    """Centre, heading and direction of a rigid grey body without markers are within their bands."""
    rng = np.random.default_rng(4)
    scene = 170 + 90 * cv2.GaussianBlur(rng.normal(0, 1, SIZE[::-1]), (0, 0), 4)
    t = np.arange(60) / 30
    x, y, yaw = 260 - 80 * t, 100 + 15 * t, math.pi + 0.15 + 0.12 * np.sin(2 * np.pi * 1.4 * t)

    def frames():
        for k in range(len(t)):
            mask = np.zeros((4 * SIZE[1], 4 * SIZE[0]), np.uint8)
            outline = (
                4
                * np.array(cv2.ellipse2Poly((0, 0), (3000, 900), 0, 0, 360, 3))
                / 100
                @ np.array([[np.cos(yaw[k]), -np.sin(yaw[k])], [np.sin(yaw[k]), np.cos(yaw[k])]])
            )
            outline += 4 * (np.array([x[k], y[k]]) + 0.5) - 0.5
            cv2.fillPoly(mask, [np.round(64 * outline).astype(np.int32)], 255, shift=6)
            cover = cv2.resize(mask, SIZE, interpolation=cv2.INTER_AREA) / 255
            image = (scene * (1 - cover) + shade * cover)[..., None] + rng.normal(0, 3, (*SIZE[::-1], 3))
            yield np.clip(image, 0, 255).astype(np.uint8)

    film = film_writer.write(tmp_path / "body.mp4", frames(), size=SIZE, times=t, rate_hz=30, crf=16)
    draft = swimid.track_setup(film, background=True, metres_per_pixel=0.001)
    log = swimid.track_video(film, setup=draft.setup).frame
    assert draft.setup.markers[0].method == "background"
    truth = pd.DataFrame({"x_m": x / 1000, "y_m": (239 - y) / 1000, "yaw_rad": yaw})
    for name, sd in (("x_m", "x_sd_m"), ("y_m", "y_sd_m"), ("yaw_rad", "yaw_sd_rad")):
        error = log[name] - truth[name]
        error = error - 2 * np.pi * np.round(error.median() / (2 * np.pi)) if name == "yaw_rad" else error
        assert (error.abs() <= 1.96 * log[sd]).mean() > 0.85, name
