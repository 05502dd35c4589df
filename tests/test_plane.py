"""Maps from pictures to the world: factors, homographies, heights and lenses, by geometry."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from swimid.errors import InputError
from swimid.points.plane import camera_matrix, plane_of
from swimid.points.scale import Camera, Heights, Scale

WIDTH, HEIGHT = 641, 481
#: Points of the picture, px: its corners, its middle and another one.
COLUMN = np.array([0.0, 640.0, 0.0, 640.0, 320.0, 100.0])
ROW = np.array([0.0, 0.0, 480.0, 480.0, 240.0, 400.0])


def seen(plane: str = "vertical", camera: Camera | None = None, **scale: Any) -> Any:
    """Return the part of a setup that states how a camera sees the plane of motion."""
    return SimpleNamespace(scale=Scale(**scale) if scale else None, camera=camera, plane=plane)


def test_pixels_are_counted_from_the_lower_left() -> None:
    with pytest.warns(UserWarning, match="SWM041"):
        plane = plane_of(seen(), WIDTH, HEIGHT)
    assert plane.unit == "px"
    np.testing.assert_allclose(plane.to_world(COLUMN, ROW), [COLUMN, 480.0 - ROW])
    assert plane.faces == "right"


@pytest.mark.parametrize(
    "scale", [{"metres_per_pixel": 0.002}, {"points_px": [[10, 20], [310, 420]], "distance_m": 1.0}]
)
def test_a_plane_turned_round_keeps_its_origin_in_a_corner(scale: dict[str, Any]) -> None:
    plane = plane_of(seen(**scale), WIDTH, HEIGHT)
    assert plane.unit == "m"
    np.testing.assert_allclose(plane.to_world(COLUMN, ROW), 0.002 * np.array([COLUMN, 480.0 - ROW]))
    turned = plane.flip_x()
    np.testing.assert_allclose(turned.to_world(COLUMN, ROW), 0.002 * np.array([640.0 - COLUMN, 480.0 - ROW]))
    assert turned.faces == "left"
    for one in (plane, turned):
        np.testing.assert_allclose(one.to_image(*one.to_world(COLUMN, ROW)), [COLUMN, ROW], atol=1e-9)
        np.testing.assert_allclose(one.size_of_pixel(COLUMN, ROW), 0.002)
        assert one.size_of_pixel(5.0, 6.0) == pytest.approx(0.002)
    hidden = np.array([np.nan, 3.0])
    assert np.isnan(plane.to_world(hidden, hidden)[:, 0]).all()
    assert np.isfinite(plane.to_world(hidden, hidden)[:, 1]).all()


def test_markers_above_the_scale_are_moved_towards_the_camera() -> None:
    """From 2 m above the scale, markers at 0.5 m are a quarter nearer to the point below the camera."""
    heights = Heights(marker_m=0.5, camera_m=2.0)
    plane = plane_of(seen(metres_per_pixel=0.002, heights=heights), WIDTH, HEIGHT)
    foot = np.array([[0.64], [0.48]])
    flat = 0.002 * np.array([COLUMN, 480.0 - ROW])
    np.testing.assert_allclose(plane.to_world(COLUMN, ROW), foot + 0.75 * (flat - foot))
    np.testing.assert_allclose(plane.to_image(*plane.to_world(COLUMN, ROW)), [COLUMN, ROW], atol=1e-9)


def oblique(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the pixels of world points that an inclined camera sees, shape (2, n)."""
    depth = 1.0 + 0.2 * y
    return np.array([300.0 + 200.0 * x / depth, 400.0 - 180.0 * y / depth])


CORNERS = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0], [0.5, 0.3]])


def test_a_homography_through_known_points() -> None:
    pixels = oblique(*CORNERS.T).T
    plane = plane_of(seen(points_px=pixels.tolist(), points_m=CORNERS.tolist()), WIDTH, HEIGHT)
    x, y = np.array([0.2, 0.9, -0.3]), np.array([0.7, 0.1, 1.2])
    np.testing.assert_allclose(plane.to_world(*oblique(x, y)), [x, y], atol=1e-6)
    np.testing.assert_allclose(plane.to_image(x, y), oblique(x, y), atol=1e-4)
    assert plane.residual_px < 1e-5
    assert plane.residual < 1e-7
    # the area of a pixel, by the determinant of the derivatives of the inverse map
    here = oblique(x, y)
    steps = [plane.to_world(here[0] + a, here[1] + b) - [x, y] for a, b in ((1e-3, 0), (0, 1e-3))]
    area = np.abs(steps[0][0] * steps[1][1] - steps[0][1] * steps[1][0]) * 1e6
    np.testing.assert_allclose(plane.size_of_pixel(*here), np.sqrt(area), rtol=0.01)
    turned = plane.flip_x()
    np.testing.assert_allclose(turned.to_world(*here), [-x, y], atol=1e-6)


def test_the_error_of_a_calibration_point_moves_the_map() -> None:
    """One of six points is off by 3 px: the residual, and how far points move with each coordinate."""
    world = np.vstack([CORNERS, [[0.2, 0.8]]])
    pixels = oblique(*world.T).T
    pixels[4, 0] += 3.0
    plane = plane_of(seen(points_px=pixels.tolist(), points_m=world.tolist()), WIDTH, HEIGHT)
    off = plane.to_image(*world.T) - pixels.T
    assert plane.residual_px == pytest.approx(np.sqrt(np.mean(np.sum(off**2, axis=0))), rel=1e-6)
    assert 0.5 < plane.residual_px < 3.0
    moved = plane.variations(np.array([[0.5], [0.5]]))
    assert moved.shape == (12, 2, 1)
    # the spread is some pixels, of 5 mm
    assert 0.001 < np.sqrt(np.sum(moved**2)) < 0.1
    np.testing.assert_allclose(
        plane.flip_x().variations(np.array([[-0.5], [0.5]]))[:, 0], -moved[:, 0], atol=1e-9
    )


@pytest.mark.parametrize(
    ("pixels", "world", "words"),
    [
        ([[0, 0], [10, 0], [20, 0], [30, 1]], CORNERS[:4], "on a line"),
        ([[0, 0], [100, 0], [0, 100], [100, 100]], CORNERS[:4], "not in the same order"),
    ],
)
def test_points_that_fit_no_plane_are_refused(pixels: Any, world: np.ndarray, words: str) -> None:
    with pytest.raises(InputError, match=words):
        plane_of(seen(points_px=pixels, points_m=world.tolist()), WIDTH, HEIGHT)


def test_depths_in_place_of_heights_and_a_world_from_behind_raise_a_warning() -> None:
    pixels = oblique(*CORNERS.T).T.tolist()
    upside = (CORNERS * [1, -1]).tolist()
    for kind in ("vertical", "horizontal"):
        with pytest.warns(UserWarning, match="SWM048"):
            plane_of(seen(kind, points_px=pixels, points_m=upside), WIDTH, HEIGHT)
        plane_of(seen(kind, points_px=pixels, points_m=CORNERS.tolist()), WIDTH, HEIGHT)


def test_a_lens_is_undone() -> None:
    """A barrel distortion of r (1 - 0.1 r^2), in units of the focal length about the middle of the lens."""
    matrix = ((500.0, 0.0, 310.0), (0.0, 500.0, 250.0), (0.0, 0.0, 1.0))
    camera = Camera(matrix=matrix, size_px=(WIDTH, HEIGHT), distortion=(-0.1, 0.0, 0.0, 0.0))
    plane = plane_of(seen(camera=camera, metres_per_pixel=0.002), WIDTH, HEIGHT)
    x, y = np.array([0.3, -0.5, 0.0]), np.array([0.2, 0.1, -0.4])
    shrunk = 1 - 0.1 * (x**2 + y**2)
    found = plane.to_world(310 + 500 * x * shrunk, 250 + 500 * y * shrunk)
    np.testing.assert_allclose(found, 0.002 * np.array([310 + 500 * x, 480 - (250 + 500 * y)]), atol=1e-5)
    back = plane.to_image(*found)
    np.testing.assert_allclose(back, [310 + 500 * x * shrunk, 250 + 500 * y * shrunk], atol=0.01)


def test_a_camera_matrix_is_scaled_about_the_corner() -> None:
    """At half the size, a pixel covers two by two; their common middle keeps its place in the scene."""
    matrix = ((800.0, 0.0, 639.5), (0.0, 800.0, 359.5), (0.0, 0.0, 1.0))
    camera = Camera(matrix=matrix, size_px=(1280, 720))
    half = camera_matrix(camera, 640, 360, None)
    np.testing.assert_allclose(half, [[400.0, 0.0, 319.5], [0.0, 400.0, 179.5], [0.0, 0.0, 1.0]])
    with pytest.raises(InputError, match="no scaled copy"):
        camera_matrix(camera, 640, 480, None)
    camera_matrix(camera, 640, 354, None)  # 1.7 %
