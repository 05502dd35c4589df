"""Pose, speeds and their standard deviations from the positions of markers in the picture.

:class:`Plane` (lens, scale or homography, heights) maps pixels to metres, and :func:`build` returns the pose.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy import special
from scipy.interpolate import CubicHermiteSpline
from scipy.ndimage import maximum_filter1d

from swimid.errors import InputError, NoTrustworthyResult
from swimid.logs.log import runs
from swimid.logs.sampling import Held, find_held, usual_step
from swimid.notices import warn
from swimid.tracking.detect import CUT, LOST, STATUS, RawTrack
from swimid.tracking.setup import Camera, Setup
from swimid.tracking.smooth import Smoothed, smooth

Array = NDArray[np.float64]

#: Maximum relative difference between the horizontal and the vertical ratio of two picture sizes. The ratios
#: differ because sizes are rounded to even pixels.
MAX_SCALE_DIFFERENCE = 0.02
#: Minimum number of measurements in a segment.
MIN_SEGMENT = 5
#: Minimum standard deviation of the noise of a centroid, px.
MIN_NOISE_PX = 0.01
#: Systematic error of a centroid, px, measured on rendered H.264 films. It results from the phase of the
#: pixels, the codec and uneven light. It does not average out, and is added to the standard deviations of the
#: smoother.
SYSTEMATIC_PX = 0.05
#: Lags over which the errors of centroids are correlated, in frames, and minimum number of pairs with such
#: lags.
LAGS, MIN_PRODUCTS = (2, 3, 4, 5, 6), 50
#: Criteria for frames that repeat the previous picture. MAX_CHANGE is the maximum change of the picture about
#: the markers, relative to the maximum change nearby, and MAX_CHANGE_OF_NEIGHBOURS relative to the changes in
#: the frames on both sides. MAX_HELD_FRAMES is the maximum number of successive repeats. MIN_HELD_RUNS is the
#: minimum number of runs of repeats, because fewer runs occur by chance.
MAX_CHANGE, MAX_CHANGE_OF_NEIGHBOURS, MAX_HELD_FRAMES, MIN_HELD_RUNS = 0.2, 0.33, 15, 4
#: Probability of a false report of a partly hidden marker in a whole film, if areas were normally distributed
#: and independent, and factor on the limit for single frames, because areas are neither.
FALSE_ALARM, SINGLE_FRAME = 1e-3, 2.0
#: Half-width of a 95 % interval, in standard deviations. For a hidden marker the half-width is its maximum
#: error.
TWO_SIDED = 1.96


@dataclass(frozen=True)
class Plane:
    """Map from pixels of the picture to coordinates of the world.

    Attributes
    ----------
    unit : str
        Unit of the world coordinates: ``"m"``, or ``"px"`` without a scale.
    matrix : ndarray, shape (3, 3)
        Homography from undistorted pixels to the world.
    lens : (ndarray, ndarray) or None
        Camera matrix and distortion coefficients.
    shrink : float
        Factor on the distance from ``foot``, for markers above the plane.
    foot : ndarray, shape (2,)
        Point of the world below the camera.
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
    shrink: float
    foot: Array
    middle: Array
    far_x: float = 0.0
    residual_px: float = 0.0
    residual: float = 0.0
    variants: tuple[Array, ...] = ()

    def to_world(self, x: Array, y: Array) -> Array:
        """Return the world coordinates, shape (2, n), of points of the picture; NaN stays NaN."""
        return _map_known(self._forward, x, y)

    def to_image(self, x: Array, y: Array) -> Array:
        """Project points from world coordinates to the picture, shape (2, n); NaN stays NaN."""
        return _map_known(self._backward, x, y)

    def variations(self, world: Array) -> Array:
        """Return the shifts of world points, shape (2, n), caused by the k ``variants``, shape (k, 2, n)."""
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
        """Return the plane with its x axis to the left of the picture if ``left``, otherwise to the right."""
        if self.runs_left == left:
            return self
        turn = np.array([[-1.0, 0, self.far_x], [0, 1, 0], [0, 0, 1]])
        variants = tuple(turn @ matrix for matrix in self.variants)
        foot = _mapped(self.foot[None], turn)[0]
        return replace(self, matrix=turn @ self.matrix, foot=foot, variants=variants)

    @property
    def runs_left(self) -> bool:
        """Whether the x axis points to the left of the picture."""
        return bool(self._jacobian(*self.middle[:, None])[0, 0, 0] < 0)

    @property
    def faces(self) -> str:
        """Direction of the x axis in the picture: "left" or "right"."""
        return "left" if self.runs_left else "right"

    @property
    def upside_down(self) -> bool:
        """Whether the second axis points down in the picture."""
        return bool(self._jacobian(*self.middle[:, None])[1, 1, 0] > 0)

    def _jacobian(self, x: Array, y: Array) -> Array:
        """Return the derivatives of the two coordinates by column and row of the picture, shape (2, 2, n)."""
        here = self.to_world(x, y)
        return np.stack([self.to_world(x + 1, y) - here, self.to_world(x, y + 1) - here], axis=1)

    def size_of_pixel(self, x: float, y: float) -> float:
        """Return the length of a pixel at a point of the picture (geometric mean of the two directions)."""
        return float(self.sizes_of_pixels(np.array([x]), np.array([y]))[0])

    def sizes_of_pixels(self, x: Array, y: Array) -> Array:
        """Return :meth:`size_of_pixel` at many points, shape (n,)."""
        (xx, xy), (yx, yy) = self._jacobian(x, y)
        return np.sqrt(np.abs(xx * yy - yx * xy))


def _map_known(function: Callable[[Array], Array], x: Array, y: Array) -> Array:
    """Apply a map of points, shape (n, 2), to points without NaN; return all points, shape (2, n)."""
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


def plane_of(setup: Setup, width: int, height: int, *, file: str | None = None) -> Plane:
    """Return the plane of a setup for a picture size. ``file`` names the setup in messages.

    Raises
    ------
    InputError
        The calibration points are on a line or fit no plane, or the camera matrix is for other pictures.
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
        text = "positions are in pixels (columns end in _px) and speeds in pixels per second"
        warn("SWM041", f"the setup has no scale: {text}; give scale in the setup for metres")
    else:
        if scale.points_px is not None:
            points = _undistorted(np.array(scale.points_px), lens)
        if scale.distance_m is not None:
            factor = scale.distance_m / float(np.hypot(*(points[1] - points[0])))
        if scale.metres_per_pixel is not None:
            factor = scale.metres_per_pixel
        if scale.heights is not None:
            shrink = 1 - scale.heights.marker_m / scale.heights.camera_m
    # y of the picture points down: the picture is flipped, so that yaw is counter-clockwise
    matrix = np.array([[factor, 0, 0], [0, -factor, factor * (height - 1)], [0, 0, 1.0]])
    far_x = factor * (width - 1)
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
    unit = "px" if scale is None else "m"
    plane = Plane(unit, matrix, lens, shrink, foot, middle, far_x, *residuals, variants)
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
        The matrix is for pictures of other proportions.
    """
    across, down = width / camera.size_px[0], height / camera.size_px[1]
    if abs(across / down - 1) > MAX_SCALE_DIFFERENCE:
        size = " x ".join(f"{v:g}" for v in camera.size_px)
        text = f"the matrix is for pictures of {size} pixels; the film has {width} x {height}, no scaled copy"
        hint = "calibrate the camera in the mode in which it films"
        raise InputError(text, file=file, column="camera.size_px", hint=hint)
    # coordinates scale about the corner of the picture, half a pixel before the middle of the first pixel
    half = np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1]])
    scale = np.linalg.inv(half) @ np.diag([across, down, 1.0]) @ half
    return np.asarray(scale @ np.array(camera.matrix))


def _homography(image: Array, world: Array, file: str | None) -> tuple[Array, tuple[float, float]]:
    """Return the map of calibration points, and its root-mean-square errors in picture and world."""
    for name, points in (("points_px", image), ("points_m", world)):
        if _is_on_line(points):
            text = "the points lie on a line; four corners of an area are needed"
            raise InputError(text, file=file, column=name)
    matrix, _ = cv2.findHomography(image, world)
    if matrix is None or not np.isfinite(matrix).all() or abs(np.linalg.det(matrix)) < 1e-15:
        raise InputError("no plane fits these points", file=file, column="scale.points_m")
    sides = (np.column_stack([image, np.ones(len(image))]) @ matrix[2]) / matrix[2, 2]
    if np.any(sides <= 0):
        text = "the points are not in the same order in the picture and in the world"
        hint = "list points_px and points_m corner by corner, both going round the same way"
        raise InputError(text, file=file, column="scale.points_m", hint=hint)
    errors = (_mapped(world, np.linalg.inv(matrix)) - image, _mapped(image, matrix) - world)
    in_image, in_world = (float(np.sqrt(np.mean(np.sum(error**2, 1)))) for error in errors)
    return matrix, (in_image, in_world)


def _variants(image: Array, world: Array, residual_px: float) -> tuple[Array, ...]:
    """Return copies of the map for which one coordinate of one point is moved by its standard deviation.

    The residual has ``2 n - 8`` degrees of freedom. The standard deviation is enlarged so that the 95 %
    interval is that of Student's distribution with these degrees of freedom.
    """
    freedom = 2 * len(image) - 8
    if freedom < 1:
        return ()
    sd = residual_px * np.sqrt(len(image) / freedom) * special.stdtrit(freedom, 0.025) / special.ndtri(0.025)
    moves = sd * np.eye(image.size).reshape(-1, *image.shape)
    return tuple(cv2.findHomography(image + move, world)[0] for move in moves)


def _is_on_line(points: Array) -> bool:
    """Return whether all points lie on a line, or all but one in the case of four points."""
    rests = [points]
    if len(points) <= 4:
        rests = [np.delete(points, k, axis=0) for k in range(len(points))]
    return any(np.linalg.matrix_rank(rest - rest.mean(0), rtol=1e-3) < 2 for rest in rests)


@dataclass(frozen=True)
class Pose:
    """Path of the reference point, and heading if there are two markers.

    Attributes
    ----------
    times : ndarray, shape (n,)
        Time stamps of the frames, s.
    measured : ndarray of bool, shape (n,)
        Whether all markers that the pose needs were found whole.
    segment : ndarray of int, shape (n,)
        Number of the segment: 1, 2, ...; 0 before the first detection, after the last, and in gaps longer
        than the limit.
    raw : ndarray, shape (2, n)
        Measured position of the reference point, or of the head marker if the positions of the markers on the
        robot are unknown.
    path : Smoothed
        Two coordinates, in units of the world.
    raw_angle : ndarray, shape (n,), or None
        Measured heading (pitch in the vertical plane, nose up), rad, unwrapped.
    angle : Smoothed or None
        Smoothed heading, rad; None for a single marker.
    markers : ndarray, shape (m, 2, n)
        Measured position of every marker in the world; NaN if it was not measured.
    separation : ndarray, shape (n,), or None
        Distance between head and tail marker, in units of the world.
    held : Held
        Frames that repeat the previous picture, and the times at which the pictures were taken.
    hidden : ndarray, shape (m, n)
        Maximum error of each centre because part of the marker is hidden, px; 0 if none is.
    plane : Plane
    rows : list of int
        Rows of the markers that the pose needs: head, and tail.
    """

    times: Array
    measured: NDArray[np.bool_]
    segment: NDArray[np.int64]
    raw: Array
    path: Smoothed
    raw_angle: Array | None
    angle: Smoothed | None
    markers: Array
    separation: Array | None
    held: Held
    hidden: Array
    plane: Plane
    rows: list[int]

    @property
    def body_velocity(self) -> Array | None:
        """Velocity ahead and to port (up in the vertical plane), shape (2, n); None without a heading."""
        if self.angle is None:
            return None
        (vx, vy), angle = self.path.velocity, self.angle.position[0]
        return np.stack([vx * np.cos(angle) + vy * np.sin(angle), vy * np.cos(angle) - vx * np.sin(angle)])

    @property
    def gaps(self) -> list[tuple[float, float]]:
        """Times of the last measurement before each gap and of the first measurement after it, s."""
        fresh = ~self.held.repeated
        seen = self.times[self.measured]
        missing = np.flatnonzero(np.diff(np.flatnonzero(self.measured[fresh])) > 1)
        return [(float(seen[k]), float(seen[k + 1])) for k in missing]

    @property
    def interpolated(self) -> NDArray[np.bool_]:
        """Whether the pose is within a segment, but interpolated instead of measured, shape (n,)."""
        return (self.segment > 0) & ~self.measured


def facing(track: RawTrack, setup: Setup, plane: Plane) -> Plane:
    """Return the plane whose x axis points ahead of the robot, for a camera at the side.

    With ``facing: auto`` the direction ahead is the mean direction from tail to head marker, or from the rear
    to the front marker if their positions on the robot are known. A single marker does not change the plane.
    """
    if setup.plane == "horizontal":
        return plane
    if setup.facing != "auto":
        return plane.along_x(setup.facing == "left")
    if setup.tail is None:
        return plane
    (front, _), (rear, _) = (plane.to_world(*track.centre(track.row(name))) for name in setup.roles)
    ahead = np.nansum(front - rear)
    if setup.places is not None:
        ahead *= setup.places[0][0] - setup.places[1][0]
    return plane if ahead >= 0 else plane.along_x(not plane.runs_left)


def build(track: RawTrack, setup: Setup, plane: Plane) -> Pose:
    """Return the pose from the positions of the markers in the picture.

    If the positions of head and tail marker on the robot are known (``at_m``), the pose is that of a rigid
    body through both markers: its heading differs from the line of the markers by their angle on the robot,
    and the mid-points of the markers coincide. Otherwise the position is that of the head marker, and the
    heading is the direction of the line of the markers.

    Raises
    ------
    NoTrustworthyResult
        No segment has enough measurements.
    """
    times, rows = track.times, [track.row(name) for name in setup.roles]
    everyone = range(len(track.names))
    markers = np.array([plane.to_world(*track.centre(i)) for i in everyone])
    hidden = np.array([hidden_px(track, i, plane) for i in everyone])
    held = _held_pictures(track, rows)
    clock, clock_sd = _picture_times(times, held)
    measured: NDArray[np.bool_] = np.all(track.found[rows], axis=0) & ~held.repeated
    segment, segments = _segments(times, measured, setup.max_gap_s)
    if not segments:
        raise NoTrustworthyResult(
            f"the markers are seen together in {int(measured.sum())} frames, never in {MIN_SEGMENT} "
            "close enough to each other to give a speed"
        )
    measured &= segment > 0
    head, tail = rows[0], rows[-1]
    pixel = plane.size_of_pixel(*(float(np.nanmedian(values)) for values in track.centre(head)))
    trusted = ~np.any(hidden[rows] > 0, axis=0)
    weights = _weights(track, head, hidden[head])
    raw = np.where((segment > 0) & ~held.repeated, markers[head], np.nan)
    lever, forward = np.zeros(2), markers[head] - markers[tail]
    white, lasting = MIN_NOISE_PX * pixel, SYSTEMATIC_PX * pixel
    angle = raw_angle = separation = None
    if tail != head:
        separation = np.hypot(*forward)
        distance = float(np.nanmedian(separation))
        centroid = _centroid_errors(np.where(measured & trusted, separation, np.nan))
        white, lasting = max(white, centroid[0]), float(np.hypot(centroid[1], lasting))
        both = np.maximum(weights, _weights(track, tail, hidden[tail]))
        if setup.places is not None:
            # the mid-point needs both markers: with a single marker, errors of the scale would enter
            raw = np.where(measured, (markers[head] + markers[tail]) / 2, np.nan)
            places = np.array(setup.places)
            lever, weights = -places.mean(axis=0), both
            ahead, aside = places[0] - places[1]
            forward = np.array([[ahead, aside], [-aside, ahead]]) @ forward
        raw_angle = np.arctan2(forward[1], forward[0])
        known = np.isfinite(raw_angle)
        raw_angle[known] = np.unwrap(raw_angle[known])
        raw_angle[~measured] = np.nan
        turn = np.sqrt(2) / max(distance, 1e-12)
        angle = smooth(clock, raw_angle[None], both, segments, min_sd=turn * white, trusted=trusted)
        # both ends of a silhouette follow from one outline: its length does not show all errors of its
        # direction
        along = centroid[1]
        if setup.markers[0].method == "background":
            along = lasting
        # the errors of partly hidden markers last as long as the markers are hidden
        off = np.hypot(*hidden[rows]) * pixel / TWO_SIDED / distance
        angle = _widened(angle, turn * along, off)
        # the smoothed heading is used, because the raw heading would add its noise to the path
        raw = raw + _turned(lever, angle.position[0])
    path = smooth(clock, raw, weights, segments, min_sd=white, trusted=trusted)
    used = [head] if setup.places is None else rows
    path = _widened(path, lasting, hidden[used].max(axis=0) * pixel / TWO_SIDED)
    if angle is not None:
        # an error of the heading moves the reference point across the lever
        across = np.abs(_turned(np.array([-lever[1], lever[0]]), angle.position[0]))
        path = replace(
            _widened(path, across * angle.position_sd),
            velocity_sd=np.hypot(path.velocity_sd, across * angle.velocity_sd),
        )
    if held.repeated.any():
        path = _at_stamps(path, clock, times, segments, clock_sd)
        if angle is not None:
            angle = _at_stamps(angle, clock, times, segments, clock_sd)
    path, angle = _with_plane_error(path, angle, plane, separation)
    heading = (raw_angle, angle, markers, separation)
    return Pose(times, measured, segment, raw, path, *heading, held, hidden, plane, rows)


def _widened(values: Smoothed, *sds: Array | float) -> Smoothed:
    """Return smoothed coordinates with independent errors of the standard deviations ``sds`` added."""
    variance = values.position_sd**2 + sum(np.square(sd) for sd in sds)
    return replace(values, position_sd=np.sqrt(variance))


def _held_pictures(track: RawTrack, rows: list[int]) -> Held:
    """Return the frames that repeat the previous picture.

    In these frames the picture about the markers hardly changes. The picture also changes little while the
    robot rests or reverses. Therefore the change must be large just before and after, and the markers must
    continue in the same direction. The times of the pictures follow from the cumulative sum of the changes,
    in which repeats are exact.
    """
    change = np.zeros(len(track.times)) if track.change is None else np.nan_to_num(track.change)
    usual = maximum_filter1d(change, 2 * MAX_HELD_FRAMES + 3)
    place = np.concatenate([np.stack(track.centre(row)) for row in rows])
    repeated = np.zeros(len(change), dtype=bool)
    for start, end in runs(change < MAX_CHANGE * usual):
        sides = [k for k in (start - 1, end) if 1 <= k < len(change)]
        sharp = MAX_CHANGE_OF_NEIGHBOURS * change[sides].min() > change[start:end].max()
        steps = [place[:, k] - place[:, k - 1] for k in sides]
        onward = len(steps) < 2 or steps[0] @ steps[1] > 0
        first = max(start, 1)
        repeated[first:end] = sharp and onward and 0 < end - first <= MAX_HELD_FRAMES
    if len(runs(repeated)) < MIN_HELD_RUNS:
        return Held(np.zeros_like(repeated), usual_step(track.times), 0.0, track.times, 0.0)
    least = float(np.median(change[~repeated]))
    return find_held(track.times, [np.cumsum(np.where(repeated, 0.0, np.maximum(change, least)))])


def _picture_times(times: Array, held: Held) -> tuple[Array, float]:
    """Return the times at which the pictures were taken, and the maximum error of their common offset, s.

    The stamp of a picture is up to ``lateness_s`` later than the picture. For a camera with even time steps,
    the delays of the stamps limit the common offset to an interval, of which the middle is used. The times of
    frames that repeat a picture are interpolated.
    """
    fresh = np.flatnonzero(~held.repeated)
    taken = held.measured_s[fresh]
    left = max(held.lateness_s - float(np.max(times[fresh] - taken)), 0.0)
    between = np.interp(np.arange(len(times)), fresh, times[fresh] - taken + left / 2)
    clock = np.interp(np.arange(len(times)), fresh, taken - left / 2)
    outside = np.arange(len(times)) > fresh[-1]
    clock[outside] = times[outside] - between[outside]
    return clock, left / 2


def _at_stamps(
    values: Smoothed, clock: Array, times: Array, segments: list[tuple[int, int]], clock_sd: float
) -> Smoothed:
    """Return coordinates at the stamps of the frames, from values smoothed at the times of the pictures.

    ``clock_sd`` is half of the interval of the common offset, so that the 95 % band contains every offset.
    """
    position, velocity = values.position.copy(), values.velocity.copy()
    for a, b in segments:
        curve = CubicHermiteSpline(clock[a:b], values.position[:, a:b], values.velocity[:, a:b], axis=1)
        position[:, a:b], velocity[:, a:b] = curve(times[a:b]), curve(times[a:b], 1)
    return _widened(replace(values, position=position, velocity=velocity), velocity * clock_sd)


def _with_plane_error(
    path: Smoothed, angle: Smoothed | None, plane: Plane, separation: Array | None
) -> tuple[Smoothed, Smoothed | None]:
    """Return path and heading with the error of the calibration points in their standard deviations."""
    moved = plane.variations(path.position)
    path = _widened(path, *moved)
    if angle is None or separation is None:
        return path, angle
    line = float(np.nanmedian(separation)) * np.stack([np.cos(angle.position[0]), np.sin(angle.position[0])])
    # the heading changes as one end of the line moves across it relative to the other end
    apart = (moved - plane.variations(path.position - line)) / np.nansum(line**2, axis=0)
    return path, _widened(angle, *(apart[:, 1] * line[0] - apart[:, 0] * line[1]))


def _centroid_errors(separation: Array) -> tuple[float, float]:
    """Return the standard deviations of the white and of the correlated error of a centroid.

    The distance between two markers on a rigid part is constant. Half of its variance is the variance of one
    centroid along the line. The covariance at :data:`LAGS` frames is that of correlated errors. The remaining
    variance is that of white noise, which averages out. Outliers are clipped to four robust standard
    deviations.
    """
    off = separation - np.nanmedian(separation)
    off = np.clip(off, *(np.array([-4.0, 4.0]) * 1.4826 * np.nanmedian(np.abs(off))))
    total = float(np.nanmean(off**2)) / 2
    products = np.concatenate([off[lag:] * off[:-lag] for lag in LAGS])
    if np.isfinite(products).sum() < MIN_PRODUCTS:
        return 0.0, 0.0
    lasting = min(max(float(np.nanmean(products)) / 2, 0.0), total)
    return float(np.sqrt(total - lasting)), float(np.sqrt(lasting))


def _turned(vector: Array, angle: Array) -> Array:
    """Return a vector along body axes in world axes, for each heading, shape (2, n)."""
    cos, sin = np.cos(angle), np.sin(angle)
    return np.stack([vector[0] * cos - vector[1] * sin, vector[0] * sin + vector[1] * cos])


def _segments(
    times: Array, measured: NDArray[np.bool_], max_gap_s: float
) -> tuple[NDArray[np.int64], list[tuple[int, int]]]:
    """Return the number of the segment of each frame, and start and end (exclusive) of each segment."""
    number = np.zeros(len(times), dtype=np.int64)
    seen = np.flatnonzero(measured)
    if len(seen) < MIN_SEGMENT:
        return number, []
    step = float(np.median(np.diff(times)))
    # the gap between neighbours that are one step apart is zero
    split = np.flatnonzero(np.diff(times[seen]) - step > max_gap_s + 1e-9)
    segments = []
    for part in np.split(seen, split + 1):
        if len(part) >= MIN_SEGMENT:
            segments.append((int(part[0]), int(part[-1]) + 1))
            number[part[0] : part[-1] + 1] = len(segments)
    return number, segments


def hidden_px(track: RawTrack, marker: int, plane: Plane) -> Array:
    """Return the maximum error of the centre of a partly hidden marker, shape (n,), px; 0 if it is whole.

    The centre of the whole marker is the mean of the centres of the visible and of the hidden part, weighted
    by their areas. The centre of the hidden part is within the radius R. Therefore, with a hidden fraction e
    of the area, the error is at most R e / (1 - e), and less than R. The whole area is the median area on the
    plane, with an uncertainty given by its standard deviation. A run of smaller areas counts as hidden in two
    cases: two successive areas are smaller than chance explains with probability :data:`FALSE_ALARM` in a
    film, or one area is :data:`SINGLE_FRAME` times further away. The stricter limit is needed because the
    codec and the phase of the pixels reduce the areas of single frames.
    """
    off = np.zeros(len(track.times))
    seen = np.flatnonzero(track.found[marker])
    if len(seen) < MIN_SEGMENT:
        return off
    area = track.area[marker, seen]
    share = area * plane.sizes_of_pixels(track.x[marker, seen], track.y[marker, seen]) ** 2
    share /= float(np.median(share))
    whole = area / share
    # minimum standard deviation: each pixel of the outline belongs to the marker by chance
    least = np.sqrt(2 * np.sqrt(np.pi * whole) / 12) / whole
    short = -np.log(share)
    scatter = np.maximum(_scatter(short), least)
    chance = FALSE_ALARM / len(seen)
    twice, once = -float(special.ndtri(np.sqrt(chance))), -SINGLE_FRAME * float(special.ndtri(chance))
    far = short / scatter
    ratio = np.exp(short + scatter) - 1  # e / (1 - e)
    bound = np.sqrt(whole / np.pi) * np.minimum(ratio, 1.0)
    for start, end in runs(short > 0):
        pairs = np.minimum(far[start : end - 1], far[start + 1 : end])
        if np.max(far[start:end]) > once or np.max(pairs, initial=0.0) > twice:
            off[seen[start:end]] = bound[start:end]
    return off


def _scatter(short: Array) -> float:
    """Return the standard deviation of the logarithms of areas about their median.

    It is the larger of two estimates: from the middle half of the areas, and from the areas above the median.
    The latter show how heavy the tails are, because markers with large areas are not hidden.
    """
    middle = 1.4826 * float(np.median(np.abs(short)))
    large = -short[short < 0]
    if not len(large):
        return middle
    # a normal variable is within two standard deviations with probability 0.9545
    return max(middle, 0.5 * float(np.quantile(large, 0.9545)))


def _weights(track: RawTrack, marker: int, hidden: Array) -> Array:
    """Return the variance of each centroid relative to that of a typical one, shape (n,)."""
    seen = track.found[marker]
    weights = np.ones(len(track.times))
    if seen.any():
        usual = float(np.median(track.confidence[marker, seen]))
        weights[seen] = np.clip(usual / np.maximum(track.confidence[marker, seen], 1e-3), 1, 5) ** 2
    noise = max(noise_px(track, marker), MIN_NOISE_PX)
    return np.asarray(weights + (hidden / TWO_SIDED / noise) ** 2)


def noise_px(track: RawTrack, marker: int) -> float:
    """Return the standard deviation of the white noise of a centroid, from second differences, px."""
    second = np.diff(np.stack(track.centre(marker)), n=2, axis=1)
    known = second[np.isfinite(second)]
    if not len(known):
        return 0.0
    return 1.4826 * float(np.median(np.abs(known))) / math.sqrt(6)


def columns(pose: Pose, track: RawTrack, setup: Setup) -> dict[str, Any]:
    """Return the columns of the log, in order."""
    unit = pose.plane.unit
    up, angle_name, side = setup.axes
    vx, vy = pose.path.velocity
    out: dict[str, Any] = {"t_s": pose.times}
    out[f"x_{unit}"], out[f"{up}_{unit}"] = pose.path.position
    if pose.angle is not None and pose.body_velocity is not None:
        out[f"{angle_name}_rad"] = pose.angle.position[0]
        out[f"u_{unit}_s"], out[f"{side}_{unit}_s"] = pose.body_velocity
        out[f"{angle_name}_rate_rad_s"] = pose.angle.velocity[0]
    out[f"vx_{unit}_s"], out[f"v{up}_{unit}_s"] = vx, vy
    out[f"x_sd_{unit}"], out[f"{up}_sd_{unit}"] = pose.path.position_sd
    speed_sd = np.sqrt(np.mean(pose.path.velocity_sd**2, axis=0))
    if pose.angle is not None:
        turn_sd = pose.angle.position_sd[0]
        out[f"{angle_name}_sd_rad"] = turn_sd
        # an error of the heading mixes surge and sway
        out[f"u_sd_{unit}_s"] = np.hypot(speed_sd, turn_sd * out[f"{side}_{unit}_s"])
        out[f"{side}_sd_{unit}_s"] = np.hypot(speed_sd, turn_sd * out[f"u_{unit}_s"])
        out[f"{angle_name}_rate_sd_rad_s"] = pose.angle.velocity_sd[0]
    out[f"vx_sd_{unit}_s"], out[f"v{up}_sd_{unit}_s"] = pose.path.velocity_sd
    out[f"x_raw_{unit}"], out[f"{up}_raw_{unit}"] = pose.raw
    if pose.raw_angle is not None:
        out[f"{angle_name}_raw_rad"] = pose.raw_angle
    out["frame"] = np.arange(len(pose.times))
    out["found"] = pose.measured.astype(int)
    out["interpolated"] = pose.interpolated.astype(int)
    out["segment"] = pd.array(pose.segment, dtype="Int64")
    out["segment"][pose.segment == 0] = pd.NA
    worst, best = track.status[pose.rows].min(axis=0), track.status[pose.rows].max(axis=0)
    word = np.array(STATUS, dtype=object)[np.where(worst == LOST, LOST, best)]
    word[(worst > LOST) & track.at_edge[pose.rows].any(axis=0)] = CUT
    out["status"] = word
    out["confidence"] = np.min(track.confidence[pose.rows], axis=0)
    for i, name in enumerate(track.names):
        out[f"{name}_x_px"], out[f"{name}_y_px"] = track.centre(i)
        if unit == "m":
            out[f"{name}_x_m"], out[f"{name}_{up}_m"] = pose.markers[i]
        out[f"{name}_area_px"], out[f"{name}_confidence"] = track.area[i], track.confidence[i]
        out[f"{name}_status"] = np.array(STATUS)[track.status[i]]
        out[f"{name}_at_edge"] = track.at_edge[i].astype(int)
    return out
