"""Pixels to the plane of motion: lens, scale or homography, height."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import special

from swimid.errors import InputError
from swimid.notices import warn
from swimid.tracking.setup import Camera, Setup

Array = NDArray[np.float64]

#: Largest distance of the principal point from the middle of the picture, as a share of its size, where the
#: size of the calibration's pictures is not known. Calibrated cameras have a few per cent; a matrix for
#: pictures 4/3 as large, the least ratio of common sizes, has 17 %.
MAX_OFF_CENTRE = 0.12
#: Largest focal length in widths of the picture there: a field of view of 19 degrees.
MAX_FOCAL_WIDTHS = 3.0
#: Largest difference of the two scales from one picture size to another: sizes are rounded to even pixels.
MAX_PROPORTION_ERROR = 0.02


@dataclass(frozen=True)
class Plane:
    """The map from image pixels to world coordinates.

    Attributes
    ----------
    unit : str
        ``"m"``, or ``"px"`` without a scale.
    matrix : ndarray, shape (3, 3)
        Homography from undistorted pixels to the world.
    lens : (ndarray, ndarray) or None
        Camera matrix and distortion.
    shrink : float
        Factor towards ``foot`` for markers above the plane.
    foot : ndarray, shape (2,)
        World point below the camera.
    middle : ndarray, shape (2,)
        Image point in the middle of the picture.
    far_x : float
        x of the picture's right edge where the picture sets the origin; 0 where calibration
        points do.
    residual_px, residual : float
        Root mean square error of the calibration points, in px and world units; 0 where
        the map is exact.
    variants : tuple of ndarray, each shape (3, 3)
        ``matrix`` with one coordinate of one calibration point moved by its standard deviation, which the
        residual gives; empty for four points, which have no residual.
    """

    unit: str
    matrix: Array
    lens: tuple[Array, Array] | None
    shrink: float
    foot: Array
    middle: Array
    far_x: float = 0.0
    residual_px: float = 0.0
    residual: float = 0.0
    variants: tuple[Array, ...] = ()

    @property
    def exact(self) -> bool:
        """Whether a homography fits its points exactly, so that nothing tells their error."""
        return bool(self.matrix[2, :2].any()) and not self.variants

    def to_world(self, x: Array, y: Array) -> Array:
        """World coordinates of image points, shape (2, n); NaN stays NaN."""
        return _of_known(self._forward, x, y)

    def to_image(self, x: Array, y: Array) -> Array:
        """Image points of world coordinates, shape (2, n); the inverse of :meth:`to_world`."""
        return _of_known(self._backward, x, y)

    def variations(self, world: Array) -> Array:
        """Return how far each of the ``variants`` moves points of the world, shape (k, 2, n), from (2, n)."""
        x, y = self.to_image(*world)
        moved = [replace(self, matrix=matrix).to_world(x, y) - world for matrix in self.variants]
        return np.array(moved).reshape(-1, 2, world.shape[1])

    def _forward(self, points: Array) -> Array:
        mapped = _mapped(_undistorted(points, self.lens), self.matrix)
        return self.foot + self.shrink * (mapped - self.foot)

    def _backward(self, world: Array) -> Array:
        points = _mapped(self.foot + (world - self.foot) / self.shrink, np.linalg.inv(self.matrix))
        if self.lens is None:
            return points
        rays = cv2.convertPointsToHomogeneous(_mapped(points, np.linalg.inv(self.lens[0])))
        return cv2.projectPoints(rays, np.zeros(3), np.zeros(3), *self.lens)[0].reshape(-1, 2)

    def along_x(self, left: bool) -> Plane:
        """The plane with x running to the left or to the right of the picture, reversed if need be."""
        if self.runs_left == left:
            return self
        turn = np.array([[-1.0, 0, self.far_x], [0, 1, 0], [0, 0, 1]])
        variants = tuple(turn @ matrix for matrix in self.variants)
        foot = _mapped(self.foot[None], turn)[0]
        return replace(self, matrix=turn @ self.matrix, foot=foot, variants=variants)

    @property
    def runs_left(self) -> bool:
        """Whether x runs to the left of the picture."""
        return bool(self._gradient()[0, 0] < 0)

    @property
    def upside_down(self) -> bool:
        """Whether the second coordinate grows downwards in the picture."""
        return bool(self._gradient()[1, 1] > 0)

    def _gradient(self) -> Array:
        """Change of the world coordinates (rows) with column and row of the picture, in its middle."""
        u, v = self.middle
        wx, wy = self.to_world(np.array([u, u + 1, u]), np.array([v, v, v + 1]))
        return np.array([wx[1:] - wx[0], wy[1:] - wy[0]])

    def size_of_pixel(self, x: float, y: float) -> float:
        """World length of one pixel about an image point (geometric mean of the two directions)."""
        return float(self.sizes_of_pixels(np.array([x]), np.array([y]))[0])

    def sizes_of_pixels(self, x: Array, y: Array) -> Array:
        """:meth:`size_of_pixel` about many image points, shape (n,)."""
        (x0, y0), (x1, y1), (x2, y2) = (self.to_world(x + dx, y + dy) for dx, dy in ((0, 0), (1, 0), (0, 1)))
        return np.sqrt(np.abs((x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)))


def _of_known(function: Callable[[Array], Array], x: Array, y: Array) -> Array:
    """A map of points, shape (n, 2), on those that are known: shape (2, n), NaN elsewhere."""
    known = np.isfinite(x) & np.isfinite(y)
    out = np.full((2, len(x)), np.nan)
    if known.any():
        out[:, known] = function(np.stack([x[known], y[known]], axis=1)).T
    return out


def _undistorted(points: Array, lens: tuple[Array, Array] | None) -> Array:
    if lens is None:
        return points
    return cv2.undistortPoints(points.reshape(-1, 1, 2), *lens, P=lens[0]).reshape(-1, 2)


def _mapped(points: Array, matrix: NDArray[Any]) -> Array:
    return cv2.perspectiveTransform(points.reshape(-1, 1, 2).astype(float), matrix).reshape(-1, 2)


def build(setup: Setup, width: int, height: int, *, file: str | None = None) -> Plane:
    """The plane of a setup for a picture size.

    Raises
    ------
    InputError
        When the calibration points lie on a line or fit no plane.
    """
    lens = None
    camera_centre = middle = np.array([(width - 1) / 2, (height - 1) / 2])
    if setup.camera is not None:
        lens = (camera_matrix(setup.camera, width, height, file), np.array(setup.camera.distortion))
        camera_centre = lens[0][:2, 2]
    scale, factor, shrink, residuals = setup.scale, 1.0, 1.0, (0.0, 0.0)
    variants: tuple[Array, ...] = ()
    points = np.zeros((0, 2))
    if scale is None:
        warn(
            "SWM041",
            "the setup has no scale: positions are in pixels (columns end in _px) and speeds in pixels per "
            "second; give scale in the setup for metres",
        )
    else:
        if scale.points_px is not None:
            points = _undistorted(np.array(scale.points_px), lens)
        if scale.distance_m is not None:
            factor = scale.distance_m / float(np.hypot(*(points[1] - points[0])))
        if scale.metres_per_pixel is not None:
            factor = scale.metres_per_pixel
        if scale.heights is not None:
            shrink = 1 - scale.heights.marker_m / scale.heights.camera_m
    # Images are left-handed (y down): flipped, so that yaw is counter-clockwise.
    matrix, far_x = (
        np.array([[factor, 0, 0], [0, -factor, factor * (height - 1)], [0, 0, 1.0]]),
        factor * (width - 1),
    )
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
    foot = _mapped(camera_centre[None], matrix)[0]
    plane = Plane(
        "px" if scale is None else "m", matrix, lens, shrink, foot, middle, far_x, *residuals, variants
    )
    if setup.plane == "vertical" and plane.upside_down:
        warn(
            "SWM048",
            "z of the calibration points runs down in the picture: give heights, not depths, in points_m, or "
            "z and the pitch have the wrong sign (they are right if the camera hung upside down)",
        )
    return plane


def camera_matrix(camera: Camera, width: int, height: int, file: str | None) -> Array:
    """Return the camera matrix for pictures of this size.

    Raises
    ------
    InputError
        The matrix is for pictures of other proportions, or, where their size is not given, the principal
        point is far from the middle of the picture or the focal length is many picture widths.
    """
    matrix, film = np.array(camera.matrix), f"{width} x {height} pixels"
    if camera.size_px is not None:
        across, down = width / camera.size_px[0], height / camera.size_px[1]
        if abs(across / down - 1) > MAX_PROPORTION_ERROR:
            size = " x ".join(f"{v:g}" for v in camera.size_px)
            raise InputError(
                f"the matrix is for pictures of {size} pixels; the film has {film}, no scaled copy",
                file=file,
                column="camera.size_px",
                hint="calibrate the camera in the mode in which it films",
            )
        # the middle of the first pixel is at 0: scaled about the corner of the picture, half a pixel before
        half = np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1]])
        return np.asarray(np.linalg.inv(half) @ np.diag([across, down, 1.0]) @ half @ matrix)
    off = float(np.abs(matrix[:2, 2] / (width, height) - 0.5).max())
    focal = max(matrix[0, 0], matrix[1, 1]) / width
    if off > MAX_OFF_CENTRE or focal > MAX_FOCAL_WIDTHS:
        raise InputError(
            f"the film has {film}: the principal point of the camera matrix is {100 * off:.0f} % of the "
            f"picture from its middle (allowed {100 * MAX_OFF_CENTRE:g} %), its focal length {focal:.1f} "
            f"widths of the picture (allowed {MAX_FOCAL_WIDTHS:g})",
            file=file,
            column="camera.matrix",
            hint="give the size of the pictures that the matrix is for, size_px: [width, height]",
        )
    return matrix


def _homography(image: Array, world: Array, file: str | None) -> tuple[Array, tuple[float, float]]:
    """The map of calibration points, and its root mean square error in the picture and in the world."""
    for name, points in (("points_px", image), ("points_m", world)):
        if _thin(points):
            text = "the points lie on a line; four corners of an area are needed"
            raise InputError(text, file=file, column=name)
    matrix, _ = cv2.findHomography(image, world)
    if matrix is None or not np.isfinite(matrix).all() or abs(np.linalg.det(matrix)) < 1e-15:
        raise InputError("no plane fits these points", file=file, column="scale.points_m")
    sides = (np.column_stack([image, np.ones(len(image))]) @ matrix[2]) / matrix[2, 2]
    if np.any(sides <= 0):
        raise InputError(
            "the points are not in the same order in the picture and in the world",
            file=file,
            column="scale.points_m",
            hint="list points_px and points_m corner by corner, both going round the same way",
        )
    errors = (_mapped(world, np.linalg.inv(matrix)) - image, _mapped(image, matrix) - world)
    in_image, in_world = (float(np.sqrt(np.mean(np.sum(error**2, 1)))) for error in errors)
    return matrix, (in_image, in_world)


def _variants(image: Array, world: Array, residual_px: float) -> tuple[Array, ...]:
    """Return the maps with one coordinate of one point moved by its standard deviation.

    The residual has ``2 n - 8`` degrees of freedom. The deviation is that of a normal variable whose 95 %
    interval is Student's with so many.
    """
    freedom = 2 * len(image) - 8
    if freedom < 1:
        return ()
    sd = residual_px * np.sqrt(len(image) / freedom) * special.stdtrit(freedom, 0.025) / special.ndtri(0.025)
    moves = sd * np.eye(image.size).reshape(-1, *image.shape)
    return tuple(cv2.findHomography(image + move, world)[0] for move in moves)


def _thin(points: Array) -> bool:
    """Whether all points, or all but one, lie on a line."""
    rests = [np.delete(points, k, axis=0) for k in range(len(points))] if len(points) <= 4 else [points]
    return any(np.linalg.matrix_rank(rest - rest.mean(0), rtol=1e-3) < 2 for rest in rests)
