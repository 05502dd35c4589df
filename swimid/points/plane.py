"""Map from the picture of a camera to a plane of the world: lens, scale or homography, and heights.

The module is used for films (``swimid.tracking``) and for points that another program tracked (``points``).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import special

from swimid.errors import InputError
from swimid.notices import warn
from swimid.points.scale import Camera, Scale

Array = NDArray[np.float64]
#: Maximum relative difference between the ratio of the widths and the ratio of the heights of two pictures of
#: the same proportions. The two ratios differ slightly because sizes are rounded to even pixels.
MAX_SCALE_DIFFERENCE = 0.02


class Calibrated(Protocol):
    """Part of a file that states how a camera sees the plane of motion."""

    @property
    def scale(self) -> Scale | None:
        """Scale from pixels to metres."""

    @property
    def camera(self) -> Camera | None:
        """Calibration of the camera."""

    @property
    def plane(self) -> str:
        """Plane of motion: ``horizontal`` or ``vertical``."""


@dataclass(frozen=True)
class Plane:
    """Map from pixels of the picture to coordinates of the world.

    Attributes
    ----------
    unit : str
        Unit of the world coordinates: ``"m"``, or ``"px"`` without a scale.
    matrix : ndarray, shape (3, 3)
        Homography from undistorted pixels to the world, at the height of the markers.
    lens : (ndarray, ndarray) or None
        Camera matrix and distortion coefficients.
    middle : ndarray, shape (2,)
        Middle of the picture, px.
    far_x : float
        World coordinate x of the right edge of the picture if the picture defines the origin; 0 if
        calibration points do.
    residual_px, residual : float
        Root-mean-square error of the calibration points, in px and in units of the world; 0 if the map is
        exact.
    variants : tuple of ndarray, each shape (3, 3)
        Copies of ``matrix`` for which one coordinate of one calibration point is moved by its standard
        deviation, which follows from the residual. Empty for four points, which have no residual.
    """

    unit: str
    matrix: Array
    lens: tuple[Array, Array] | None
    middle: Array
    far_x: float = 0.0
    residual_px: float = 0.0
    residual: float = 0.0
    variants: tuple[Array, ...] = ()

    def to_world(self, x: Array, y: Array) -> Array:
        """Return the world coordinates, shape (2, n), of picture points x and y, px. NaN stays NaN."""
        return _map_known(lambda points: _apply_homography(_undistort(points, self.lens), self.matrix), x, y)

    def to_image(self, x: Array, y: Array) -> Array:
        """Return the picture coordinates in px, shape (2, n), of world points x and y. NaN stays NaN."""
        return _map_known(self._backward, x, y)

    def variations(self, world: Array) -> Array:
        """Return the shifts of world points that each of the k ``variants`` causes, shape (k, 2, n)."""
        x, y = self.to_image(*world)
        moved = [replace(self, matrix=matrix).to_world(x, y) - world for matrix in self.variants]
        return np.array(moved).reshape(-1, 2, world.shape[1])

    def _backward(self, world: Array) -> Array:
        points = _apply_homography(world, np.linalg.inv(self.matrix))
        if self.lens is None:
            return points
        rays = cv2.convertPointsToHomogeneous(_apply_homography(points, np.linalg.inv(self.lens[0])))
        return cv2.projectPoints(rays, np.zeros(3), np.zeros(3), *self.lens)[0].reshape(-1, 2)

    def flip_x(self) -> Plane:
        """Return a copy of the plane whose world x axis has the opposite direction."""
        turn = np.array([[-1.0, 0, self.far_x], [0, 1, 0], [0, 0, 1]])
        variants = tuple(turn @ matrix for matrix in self.variants)
        return replace(self, matrix=turn @ self.matrix, variants=variants)

    @property
    def faces(self) -> str:
        """Direction of the world's x axis in the picture: "left" or "right"."""
        return ("right", "left")[int(self._jacobian(*self.middle[:, None])[0, 0, 0] < 0)]

    def _jacobian(self, x: Array, y: Array) -> Array:
        """Return derivatives of world coordinates with respect to picture coordinates, shape (2, 2, n)."""
        here = self.to_world(x, y)
        return np.stack([self.to_world(x + 1, y) - here, self.to_world(x, y + 1) - here], axis=1)

    def size_of_pixel(self, x: Any, y: Any) -> Any:
        """Return the length of a pixel in world units, at points of the picture.

        It is the geometric mean of the lengths in the two directions.
        """
        (xx, xy), (yx, yy) = self._jacobian(*np.atleast_1d(x, y))
        return np.sqrt(np.abs(xx * yy - yx * xy)).reshape(np.shape(x))


def _map_known(function: Callable[[Array], Array], x: Array, y: Array) -> Array:
    """Apply a map of points, shape (n, 2), to the points x and y that are not NaN.

    Return all points, shape (2, n).
    """
    known = np.isfinite(x) & np.isfinite(y)
    out = np.full((2, len(x)), np.nan)
    if known.any():
        out[:, known] = function(np.stack([x[known], y[known]], axis=1)).T
    return out


def _undistort(points: Array, lens: tuple[Array, Array] | None) -> Array:
    if lens is None:
        return points
    return cv2.undistortPoints(points.reshape(-1, 1, 2), *lens, P=lens[0]).reshape(-1, 2)


def _apply_homography(points: Array, matrix: NDArray[Any]) -> Array:
    return cv2.perspectiveTransform(points.reshape(-1, 1, 2).astype(float), matrix).reshape(-1, 2)


def plane_of(
    setup: Calibrated, width: int, height: int, *, pixel_aspect: float = 1.0, file: str | None = None
) -> Plane:
    """Return the map from pixels to the world for a setup and a picture size.

    ``pixel_aspect`` is the width of a pixel relative to its height. Lengths in pixels are in units of the
    height of a pixel. ``file`` names the setup in messages.

    Raises
    ------
    InputError
        The calibration points are on a line or fit no plane, or the camera matrix is for other pictures.
    """
    lens = None
    camera_centre = middle = np.array([(width - 1) / 2, (height - 1) / 2])
    if setup.camera is not None:
        matrix = camera_matrix(setup.camera, width, height, file, pixel_aspect)
        lens = (matrix, np.array(setup.camera.distortion))
        camera_centre = matrix[:2, 2]
    scale, factor, shrink, residuals = setup.scale, 1.0, 1.0, (0.0, 0.0)
    variants: tuple[Array, ...] = ()
    points = np.zeros((0, 2))
    if scale is None:
        text = "positions are in pixels (columns end in _px) and speeds in pixels per second"
        warn("SWM041", f"the setup has no scale: {text}; give scale in the setup for metres")
    else:
        if scale.points_px is not None:
            points = _undistort(np.array(scale.points_px), lens)
        factor = _metres_per_pixel(scale, points, pixel_aspect)
        if scale.heights is not None:
            shrink = 1 - scale.heights.marker_m / scale.heights.camera_m
    # The y axis of the picture points down. Flip the picture, so that yaw is counter-clockwise.
    across = factor * pixel_aspect
    matrix = np.array([[across, 0, 0], [0, -factor, factor * (height - 1)], [0, 0, 1.0]])
    far_x = across * (width - 1)
    if scale is not None and scale.points_m is not None:
        world = np.array(scale.points_m, dtype=float)
        matrix, residuals = _homography(points, world, file)
        variants = _variants(points, world, residuals[0])
        far_x = 0.0
        if setup.plane == "horizontal" and np.linalg.det(matrix) / matrix[2, 2] ** 3 > 0:
            warn(
                "SWM048",
                "the calibration points map the picture to a world seen from its back: x, y as given, and "
                "yaw is counter-clockwise from x to y there, clockwise in the picture",
            )
    # Move markers above the plane of the scale towards the point below the camera, because they appear too
    # far from this point.
    foot = _apply_homography(camera_centre[None], matrix)[0]
    nearer = np.array([[shrink, 0, (1 - shrink) * foot[0]], [0, shrink, (1 - shrink) * foot[1]], [0, 0, 1.0]])
    moved = tuple(nearer @ variant for variant in variants)
    unit = "px" if scale is None else "m"
    plane = Plane(unit, nearer @ matrix, lens, middle, far_x, *residuals, moved)
    if setup.plane == "vertical" and plane._jacobian(*middle[:, None])[1, 1, 0] > 0:
        warn(
            "SWM048",
            "z of the calibration points runs down in the picture: give heights, not depths, in points_m, or "
            "z and the pitch have the wrong sign (they are right if the camera hung upside down)",
        )
    return plane


def _metres_per_pixel(scale: Scale, points: Array, pixel_aspect: float) -> float:
    """Return the scale, m/px, as stated or from two calibration points; 1 if the setup has neither."""
    if scale.metres_per_pixel is not None:
        return scale.metres_per_pixel
    if scale.distance_m is not None:
        return scale.distance_m / float(np.hypot(*((points[1] - points[0]) * (pixel_aspect, 1.0))))
    return 1.0


def camera_matrix(
    camera: Camera, width: int, height: int, file: str | None, pixel_aspect: float = 1.0
) -> Array:
    """Return the camera matrix for pictures of the given width and height, px.

    The matrix in the setup is for pictures of the same proportions, or for the same pictures with square
    pixels.

    Raises
    ------
    InputError
        The matrix in the setup is for pictures of other proportions.
    """
    across, down = width / camera.size_px[0], height / camera.size_px[1]
    if min(abs(across / down * one - 1) for one in (1.0, pixel_aspect)) > MAX_SCALE_DIFFERENCE:
        size = " x ".join(f"{v:g}" for v in camera.size_px)
        text = f"the matrix is for pictures of {size} pixels; the film has {width} x {height}, no scaled copy"
        hint = "calibrate the camera in the mode in which it films"
        raise InputError(text, file=file, column="camera.size_px", hint=hint)
    # Scale the coordinates about the corner of the picture, which is half a pixel before the middle of the
    # first pixel.
    half = np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1]])
    scale = np.linalg.inv(half) @ np.diag([across, down, 1.0]) @ half
    return np.asarray(scale @ np.array(camera.matrix))


def _homography(image: Array, world: Array, file: str | None) -> tuple[Array, tuple[float, float]]:
    """Return the homography from picture to world through calibration points, and its errors.

    The errors are the root-mean-square errors of the points in the picture and in the world.
    """
    for name, points in (("points_px", image), ("points_m", world)):
        if _is_on_line(points):
            text = "the points lie on a line; four corners of an area are needed"
            raise InputError(text, file=file, column=name)
    matrix, _ = cv2.findHomography(image, world)
    if matrix is None or not np.isfinite(matrix).all() or abs(np.linalg.det(matrix)) < 1e-15:
        hint = "check the order of points_px and points_m"
        raise InputError("no plane fits these points", file=file, column="scale.points_m", hint=hint)
    sides = (np.column_stack([image, np.ones(len(image))]) @ matrix[2]) / matrix[2, 2]
    if np.any(sides <= 0):
        text = "the points are not in the same order in the picture and in the world"
        hint = "list points_px and points_m corner by corner, both going round the same way"
        raise InputError(text, file=file, column="scale.points_m", hint=hint)
    errors = (
        _apply_homography(world, np.linalg.inv(matrix)) - image,
        _apply_homography(image, matrix) - world,
    )
    in_image, in_world = (float(np.sqrt(np.mean(np.sum(error**2, 1)))) for error in errors)
    return matrix, (in_image, in_world)


def _variants(image: Array, world: Array, residual_px: float) -> tuple[Array, ...]:
    """Return copies of a homography, for each of which one calibration coordinate is moved by its error.

    The error is one standard deviation, which follows from the residual. The residual has ``2 n - 8`` degrees
    of freedom. The standard deviation is enlarged so that the 95 % interval is that of Student's distribution
    with these degrees of freedom.
    """
    freedom = 2 * len(image) - 8
    if freedom < 1:
        return ()
    sd = residual_px * np.sqrt(len(image) / freedom) * special.stdtrit(freedom, 0.025) / special.ndtri(0.025)
    moves = sd * np.eye(image.size).reshape(-1, *image.shape)
    return tuple(cv2.findHomography(image + move, world)[0] for move in moves)


def _is_on_line(points: Array) -> bool:
    """Return whether the calibration points lie on a line.

    Of four points, three on a line suffice, because they do not determine a homography.
    """
    rests = [points]
    if len(points) <= 4:
        rests = [np.delete(points, k, axis=0) for k in range(len(points))]
    return any(np.linalg.matrix_rank(rest - rest.mean(0), rtol=1e-3) < 2 for rest in rests)
