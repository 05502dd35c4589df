"""Pose, speeds and their standard deviations from the positions of markers in the picture.

A :class:`Plane` (lens, scale or homography, heights) maps pixels to metres, and :func:`build` returns the
pose. Coordinates are smoothed by a Kalman filter and a Rauch-Tung-Striebel smoother with uneven steps, gaps
and estimated noise (:func:`smooth_path`). The state of one coordinate is position and velocity (driven by
white acceleration), or position, velocity and acceleration (driven by white jerk). The powers of the driving
noise and of the measurement noise maximise the likelihood of the innovations. The model with the larger
likelihood is used.

The estimation of the noise, and the calibration of the standard deviation in gaps, run the filter hundreds of
times. Therefore the filter is a compiled loop.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy import special
from scipy.interpolate import CubicHermiteSpline
from scipy.optimize import minimize_scalar

from swimid.errors import NoTrustworthyResult
from swimid.files.kernels import numba
from swimid.logs.log import runs, unwrap
from swimid.logs.sampling import Held, find_held
from swimid.points.plane import Plane
from swimid.tracking.frames import CUT, LOST, STATUS_NAMES, Array, RawTrack
from swimid.tracking.setup import Setup

#: Minimum number of measured frames in a segment of a track. Shorter segments are left out.
MIN_SEGMENT = 5
#: Minimum standard deviation of the noise in the centre of a marker, px.
MIN_NOISE_PX = 0.01
#: Systematic error in the centre of a marker, px, measured on rendered H.264 films. It results from the phase
#: of the pixels, the codec and uneven light. It does not average out, and is added to the standard deviations
#: of the smoother.
SYSTEMATIC_PX = 0.05
#: LAGS are the lags at which the correlation of the errors of marker centres is computed, frames.
#: MIN_PRODUCTS is the minimum number of pairs of frames with such lags.
LAGS, MIN_PRODUCTS = (2, 3, 4, 5, 6), 50
#: Shift per frame, px, that is added to the marker centres before repeated pictures are searched for. It
#: makes repeats that the codec copied exactly look like other repeats, which differ by noise.
RAMP_PX = 1e-6
#: Probability that a film without hidden markers is reported to have a partly hidden one. The probability
#: FALSE_ALARM is exact for areas that are normally distributed and independent, but areas in films are not.
#: Therefore the limit for a single small area is multiplied by SINGLE_FRAME.
FALSE_ALARM, SINGLE_FRAME = 1e-3, 2.0
#: Half-width of a 95 % interval, in standard deviations. The maximum error of a partly hidden marker is
#: divided by this value to give a standard deviation.
TWO_SIDED = 1.96

#: N_STRETCHES is the number of measured segments that are hidden from the smoother to calibrate its standard
#: deviation in gaps. MARGIN is the number of known samples on each side of such a segment.
N_STRETCHES, MARGIN = 40, 20
#: Minimum number of samples in a segment from which the noise of a track is estimated.
MIN_NOISE_SAMPLES = 6
#: Decimal logarithms of the ratios of driving noise to measurement noise in the first, coarse search for the
#: maximum likelihood of a track.
NOISE_EXPONENTS = np.arange(-9.0, 4.5)
#: Variance of the unknown initial position in the Kalman filter, relative to the measurement variance. For
#: velocity and acceleration the variance is divided by the second and fourth power of the time step.
START_VARIANCE = 1e7


# ---------------------------------------------------------------- Kalman filter and smoother


@dataclass(frozen=True)
class SmoothedPath:
    """Smoothed coordinates of a path, with velocities, standard deviations and their common noise.

    Attributes
    ----------
    position, velocity, position_sd, velocity_sd : ndarray, shape (d, n)
        Smoothed values of the d coordinates and their standard deviations.
    measurement_sd : float
        Estimated standard deviation of a measurement of weight 1, in the unit of the coordinate.
    process_noise : float
        Power of the driving white noise: unit^2/s^3 for order 2, unit^2/s^5 for order 3.
    order : int
        Order of the model: 2 for white acceleration, 3 for white jerk.
    innovation : ndarray, shape (d, n)
        Normalised innovation of each measurement, NaN without a measurement.
    """

    position: Array
    velocity: Array
    position_sd: Array
    velocity_sd: Array
    measurement_sd: float
    process_noise: float
    order: int
    innovation: Array


# The following functions use loops because their matrices have only two or three rows. Array expressions take
# ten times as long to compile as these loops, and run more slowly.


@numba.njit(cache=True)
def compute_steps(times, q, order):  # type: ignore[no-untyped-def]  # pragma: no cover - compiled
    """Return transition matrix and noise covariance of the Kalman filter for each time step.

    The model is a chain of ``order`` integrators. White noise of power q drives the highest derivative. Entry
    (i, j) of the transition matrix is dt^(j - i) / (j - i)!.
    """
    factorial = (1.0, 1.0, 2.0)
    transitions, noises = np.zeros((len(times) - 1, order, order)), np.zeros((len(times) - 1, order, order))
    for k in range(len(times) - 1):
        dt = times[k + 1] - times[k]
        for i in range(order):
            for j in range(i, order):
                transitions[k, i, j] = dt ** (j - i) / factorial[j - i]
            for j in range(order):
                a, b = order - 1 - i, order - 1 - j
                noises[k, i, j] = q * dt ** (a + b + 1) / (factorial[a] * factorial[b] * (a + b + 1))
    return transitions, noises


@numba.njit(cache=True)
def _add_sandwich(a, b, result):  # type: ignore[no-untyped-def]  # pragma: no cover - compiled
    """Add the matrix product a b a' to ``result``."""
    n = len(a)
    for i in range(n):
        for j in range(n):
            for k in range(n):
                for m in range(n):
                    result[i, j] += a[i, k] * b[k, m] * a[j, m]


@numba.njit(cache=True)
def _forward(values, variances, transitions, noises, means, covariances, innovations):  # type: ignore[no-untyped-def]  # pragma: no cover - compiled
    """Run the Kalman filter over one coordinate.

    Write the filtered means and covariances, and the innovations with their variances, into the given arrays.
    """
    for k in range(len(values)):
        mean, covariance = means[k], covariances[k]
        if k > 0:
            covariance[:] = noises[k - 1]
            for i in range(len(mean)):
                for j in range(len(mean)):
                    mean[i] += transitions[k - 1, i, j] * means[k - 1, j]
            _add_sandwich(transitions[k - 1], covariances[k - 1], covariance)
        if values[k] == values[k]:
            innovations[0, k] = values[k] - mean[0]
            innovations[1, k] = covariance[0, 0] + variances[k]
            gain = covariance[:, 0] / innovations[1, k]
            for i in range(len(mean)):
                mean[i] += gain[i] * innovations[0, k]
                for j in range(len(mean)):
                    covariance[i, j] -= gain[i] * gain[j] * innovations[1, k]


@numba.njit(cache=True)
def _backward(gains, means, covariances):  # type: ignore[no-untyped-def]  # pragma: no cover - compiled
    """Run the Rauch-Tung-Striebel smoother in place: correct each state by the next state in time."""
    for k in range(len(gains) - 1, -1, -1):
        for i in range(means.shape[1]):
            for j in range(means.shape[1]):
                means[k, i] += gains[k, i, j] * means[k + 1, j]
        _add_sandwich(gains[k], covariances[k + 1], covariances[k])


def kalman(
    times: Array, values: Array, variances: Array, q: float, order: int, start: Array
) -> tuple[Array, Array, Array]:
    """Apply the Kalman filter to the measurements of one coordinate.

    Parameters
    ----------
    times, values, variances : ndarray, shape (n,)
        Times, measurements and their variances. ``values`` is NaN for a missing measurement.
    q : float
        Power of the driving noise.
    order : int
        Number of states, 2 or 3.
    start : ndarray, shape (order, order)
        Covariance of the state at times[0]. The mean position is the first measurement, and the mean
        derivatives are 0.

    Returns
    -------
    means, covariances : ndarray, shapes (n, order), (n, order, order)
        Filtered states.
    innovations : ndarray, shape (2, n)
        Innovations and their variances, NaN without a measurement.
    """
    means, covariances = np.zeros((len(times), order)), np.zeros((len(times), order, order))
    means[0, 0], covariances[0] = values[np.isfinite(values)][0], start
    innovations = np.full((2, len(times)), np.nan)
    _forward(values, variances, *compute_steps(times, q, order), means, covariances, innovations)
    return means, covariances, innovations


def rts(times: Array, means: Array, covariances: Array, q: float, order: int) -> tuple[Array, Array]:
    """Return smoothed means and covariances from the output of :func:`kalman` (Rauch, Tung and Striebel)."""
    transitions, noises = compute_steps(times, q, order)
    moved = transitions @ covariances[:-1]
    gains = np.linalg.solve(moved @ transitions.mT + noises, moved).mT
    keep = np.eye(order) - gains @ transitions
    smooth, spread = means.copy(), covariances.copy()
    smooth[:-1] = np.einsum("kij,kj->ki", keep, means[:-1])
    # Compute the smoothed covariance as a sum of positive terms. A difference of covariances would lose its
    # digits, because the variance of the initial state is large.
    spread[:-1] = keep @ covariances[:-1] @ keep.mT + gains @ noises @ gains.mT
    _backward(gains, smooth, spread)
    return smooth, spread


def make_start_covariance(order: int, variance: float, step: float) -> Array:
    """Return the covariance of the unknown initial state in the Kalman filter, shape (order, order)."""
    return np.diag([START_VARIANCE * variance / step ** (2 * i) for i in range(order)])


def _likelihood(
    pieces: list[tuple[Array, Array, Array]], ratio: float, order: int, step: float
) -> tuple[float, float]:
    """Return the log-likelihood of a track, maximised over the measurement variance, and this variance.

    For a given ratio of driving noise to measurement noise, all innovation variances are proportional to the
    measurement variance. Its most likely value is the mean of the squared normalised innovations. The first
    ``order`` innovations of each segment determine the unknown initial state and are not used.
    """
    squares, logs, count = 0.0, 0.0, 0
    q, start = ratio / step ** (2 * order - 1), make_start_covariance(order, 1.0, step)
    for times, values, weights in pieces:
        _, _, (innovations, expected) = kalman(times, values, weights, q, order, start)
        seen = np.flatnonzero(~np.isnan(innovations))[order:]
        squares += float(np.sum(innovations[seen] ** 2 / expected[seen]))
        logs += float(np.sum(np.log(expected[seen])))
        count += len(seen)
    variance = max(squares / count, 1e-300)
    return -0.5 * (count * np.log(variance) + logs + count), variance


def _estimate_noise(
    pieces: list[tuple[Array, Array, Array]], order: int, step: float
) -> tuple[float, float, float]:
    """Return the maximum log-likelihood of a track, and the noise ratio and variance at this maximum.

    The ratio is that of driving to measurement noise. The variance is that of a measurement.
    """

    def cost(exponent: float) -> float:
        return -_likelihood(pieces, 10.0**exponent, order, step)[0]

    middle = int(np.argmin([cost(exponent) for exponent in NOISE_EXPONENTS]))
    bounds = (NOISE_EXPONENTS[max(middle - 1, 0)], NOISE_EXPONENTS[min(middle + 1, len(NOISE_EXPONENTS) - 1)])
    ratio = float(10.0 ** minimize_scalar(cost, bounds=bounds, method="bounded", options={"xatol": 0.02}).x)
    likelihood, variance = _likelihood(pieces, ratio, order, step)
    return likelihood, ratio, variance


def _smooth_piece(
    times: Array, values: Array, weights: Array, noise: tuple[float, float, int], step: float
) -> tuple[Array, Array, Array]:
    """Return smoothed means, covariances and normalised innovations of one coordinate in a segment."""
    variance, power, order = noise
    start = make_start_covariance(order, variance, step)
    means, covariances, (off, expected) = kalman(times, values, variance * weights, power, order, start)
    means, covariances = rts(times, means, covariances, power, order)
    normalised = off / np.sqrt(expected)
    normalised[np.flatnonzero(~np.isnan(normalised))[:order]] = np.nan
    return means, covariances, normalised


def _gap_factor(
    times: Array, row: Array, weights: Array, path: Array, length: int, noise: tuple[float, float, int]
) -> float:
    """Return the factor by which position errors in a gap exceed the standard deviation of the smoother.

    The gap has ``length`` samples. The factor is at least 1. To estimate it, measured segments of this
    length, with ``MARGIN`` known samples on each side, are left out, interpolated and compared with the path.
    """
    whole = length + 2 * MARGIN
    known = runs(~np.isnan(row))
    starts = np.concatenate([np.zeros(0, int), *(np.arange(a, b - whole + 1) for a, b in known)])
    if len(row) <= whole or len(starts) < 5:
        return 1.0
    step = float(np.median(np.diff(times)))
    errors = []
    inside = slice(MARGIN, MARGIN + length)
    for start in starts[np.unique(np.linspace(0, len(starts) - 1, N_STRETCHES).astype(int))]:
        part = slice(start, start + whole)
        hidden = row[part].copy()
        hidden[inside] = np.nan
        means, covariances, _ = _smooth_piece(times[part], hidden, weights[part], noise, step)
        error = means[inside, 0] - path[part][inside]
        errors.append(np.abs(error) / np.sqrt(np.maximum(covariances[inside, 0, 0], 1e-300)))
    return max(1.0, float(np.percentile(np.concatenate(errors), 95)) / 1.96)


def smooth_path(
    times: Array,
    values: Array,
    weights: Array,
    segments: list[tuple[int, int]],
    *,
    min_sd: float = 0.0,
    trusted: NDArray[np.bool_] | None = None,
) -> SmoothedPath:
    """Smooth each segment of a path. All coordinates have the same noise variance.

    Parameters
    ----------
    times : ndarray, shape (n,)
        Times in s, strictly increasing.
    values : ndarray, shape (d, n)
        Measurements, NaN if missing.
    weights : ndarray, shape (n,)
        Variance of each measurement, relative to that of a measurement with weight 1.
    segments : list of (start, end)
        Segments to smooth, ``end`` exclusive. The result is NaN outside of the segments.
    min_sd : float
        Minimum standard deviation of a measurement.
    trusted : ndarray of bool, shape (n,), optional
        Measurements from which the noise is estimated. The errors of the other measurements are correlated
        from sample to sample, so that the likelihood would attribute them to motion.

    Notes
    -----
    The acceleration of a swimmer is not white noise, because it follows the stroke. Therefore the standard
    deviation in a gap is calibrated: measured segments of the same length are hidden and interpolated, and
    the standard deviation is multiplied by the ratio of the observed errors to the predicted standard
    deviation.

    The noise parameters maximise the likelihood of the innovations, with the measurement variance
    concentrated out (Harvey, A. C., 1989, *Forecasting, structural time series models and the Kalman filter*,
    section 3.4). The smoother is that of Rauch, Tung and Striebel (1965, AIAA J. 3(8), 1445-1450,
    doi:10.2514/3.3166).
    """
    step = float(np.median(np.diff(times)))
    known = values if trusted is None else np.where(trusted, values, np.nan)
    variance, power, order = noise = _path_noise(times, known, weights, segments, min_sd)
    names = ("position", "velocity", "position_sd", "velocity_sd", "innovation")
    out = {name: np.full(values.shape, np.nan) for name in names}
    for (i, row), (a, b) in product(enumerate(values), segments):
        means, covariances, innovation = _smooth_piece(times[a:b], row[a:b], weights[a:b], noise, step)
        out["position"][i, a:b], out["velocity"][i, a:b] = means[:, 0], means[:, 1]
        sds = np.sqrt(np.maximum(covariances.diagonal(axis1=1, axis2=2), 0))
        out["position_sd"][i, a:b], out["velocity_sd"][i, a:b] = sds[:, 0], sds[:, 1]
        out["innovation"][i, a:b] = innovation
    factors: dict[tuple[int, int], float] = {}
    for (i, row), (a, b) in product(enumerate(values), segments):
        for first, last in a + runs(np.isnan(row[a:b])):
            key = i, int(last - first)
            if key not in factors:
                factors[key] = _gap_factor(times, row, weights, out["position"][i], key[1], noise)
            out["position_sd"][i, first:last] *= factors[key]
            out["velocity_sd"][i, first:last] *= factors[key]
    return SmoothedPath(**out, measurement_sd=np.sqrt(variance), process_noise=float(power), order=order)


def _path_noise(
    times: Array, values: Array, weights: Array, segments: list[tuple[int, int]], min_sd: float
) -> tuple[float, float, int]:
    """Return measurement variance, power of the driving noise and order of the likeliest model of a path."""
    pieces = [
        (times[a:b], row[a:b], weights[a:b])
        for row, (a, b) in product(values, segments)
        if np.count_nonzero(~np.isnan(row[a:b])) >= MIN_NOISE_SAMPLES
    ]
    step = float(np.median(np.diff(times)))
    order, ratio, fitted = 2, 1e-2, max(min_sd, 1e-12) ** 2
    if pieces:
        fits = {order: _estimate_noise(pieces, order, step) for order in (2, 3)}
        order, (_, ratio, fitted) = max(fits.items(), key=lambda item: item[1][0])
    return max(fitted, min_sd**2), ratio * fitted / step ** (2 * order - 1), order


def warm_up() -> None:
    """Compile the Kalman filter and smoother, so that the first film does not wait for the compiler."""
    times, ones = np.arange(3.0), np.ones(3)
    _smooth_piece(times, ones, ones, (1.0, 1.0, 2), 1.0)


# ---------------------------------------------------------------- pose


@dataclass(frozen=True)
class Pose:
    """Pose of the robot in each frame: path of the reference point, and heading if there are two markers.

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
    path : SmoothedPath
        Smoothed path of the reference point: two coordinates, in units of the world.
    raw_angle : ndarray, shape (n,), or None
        Measured heading (pitch in the vertical plane, nose up), rad, unwrapped.
    angle : SmoothedPath or None
        Smoothed heading, rad; None for a single marker.
    markers : ndarray, shape (m, 2, n)
        Measured position of every marker in the world; NaN if it was not measured.
    separation : ndarray, shape (n,), or None
        Distance between head and tail marker, in units of the world.
    held : Held
        Frames that repeat the previous picture, and the times at which the pictures were taken.
    hidden : ndarray, shape (m, n)
        Maximum error of the centre of each marker that results from hidden parts, px; 0 if no part is hidden.
    plane : Plane
    rows : list of int
        Rows of the markers that the pose needs: head, and tail.
    """

    times: Array
    measured: NDArray[np.bool_]
    segment: NDArray[np.int64]
    raw: Array
    path: SmoothedPath
    raw_angle: Array | None
    angle: SmoothedPath | None
    markers: Array
    separation: Array | None
    held: Held
    hidden: Array
    plane: Plane
    rows: list[int]

    @property
    def body_velocity(self) -> Array | None:
        """Velocity of the body ahead and to port (up in the vertical plane), shape (2, n).

        The unit is that of the world coordinates per second. None without a heading.
        """
        if self.angle is None:
            return None
        (vx, vy), angle = self.path.velocity, self.angle.position[0]
        return np.stack([vx * np.cos(angle) + vy * np.sin(angle), vy * np.cos(angle) - vx * np.sin(angle)])

    @property
    def gaps(self) -> list[tuple[float, float]]:
        """Gaps of the track: times of the last measurement before and the first one after each gap, s."""
        fresh = ~self.held.repeated
        seen = self.times[self.measured]
        missing = np.flatnonzero(np.diff(np.flatnonzero(self.measured[fresh])) > 1)
        return [(float(seen[k]), float(seen[k + 1])) for k in missing]

    @property
    def is_interpolated(self) -> NDArray[np.bool_]:
        """Flags of frames within a segment in which the pose is interpolated, not measured, shape (n,)."""
        return (self.segment > 0) & ~self.measured


def orient_plane(track: RawTrack, setup: Setup, plane: Plane) -> Plane:
    """Return a copy of the plane whose x axis points ahead of a robot that is filmed from the side.

    With ``facing: auto`` the direction ahead is the mean direction from tail to head marker, or from the rear
    to the front marker if their positions on the robot are known. A single marker does not change the plane.
    """
    turn = setup.plane == "vertical" and setup.facing != plane.faces
    if turn and setup.facing == "auto":
        (front, _), (rear, _) = (plane.to_world(*track.centre(track.row(setup.roles[k]))) for k in (0, -1))
        ahead = np.nansum(front - rear)
        if setup.places is not None:
            ahead *= setup.places[0][0] - setup.places[1][0]
        turn = bool(ahead < 0)
    if turn:
        return plane.flip_x()
    return plane


def build(track: RawTrack, setup: Setup, plane: Plane) -> Pose:
    """Return the pose of the robot from the positions of the markers in the picture.

    If the positions of head and tail marker on the robot are known (``at_m``), the pose is that of a rigid
    body through the two markers. Its heading differs from the line of the markers by their angle on the
    robot, and the mid-points of the markers coincide. Otherwise the position is that of the head marker, and
    the heading is the direction of the line of the markers.

    Raises
    ------
    NoTrustworthyResult
        No segment has enough measurements.
    """
    times, rows = track.times, [track.row(name) for name in setup.roles]
    everyone = range(len(track.names))
    markers = np.array([plane.to_world(*track.centre(i)) for i in everyone])
    hidden = np.array([limit_hidden_error(track, i, plane) for i in everyone])
    # A frame repeats the previous picture if no marker centre moves between the two frames.
    ramp = RAMP_PX * np.arange(len(times))
    held = find_held(times, [values + ramp for row in rows for values in track.centre(row)])
    measured: NDArray[np.bool_] = np.all(track.is_whole[rows], axis=0) & ~held.repeated
    segments, segment = _segments(times, measured, setup.max_gap_s), np.zeros(len(times), dtype=np.int64)
    for number, (start, end) in enumerate(segments, start=1):
        segment[start:end] = number
    if not segments:
        raise NoTrustworthyResult(
            f"the markers are detected together in {int(measured.sum())} frames, but a speed needs "
            f"{MIN_SEGMENT} such frames without a gap of more than {setup.max_gap_s:g} s",
            hint="raise max_gap_s, or correct hsv and area_px in the setup",
        )
    measured &= segment > 0
    body = _MarkedBody(track, setup, plane, rows, markers, hidden, measured)
    clock, clock_sd = _picture_times(times, held)
    angle = body.smooth_angle(clock, segments)
    raw, path = body.smooth_position(clock, segments, (segment > 0) & ~held.repeated, angle)
    if held.repeated.any():
        path = _at_stamps(path, clock, times, segments, clock_sd)
        if angle is not None:
            angle = _at_stamps(angle, clock, times, segments, clock_sd)
    path, angle = _with_plane_error(path, angle, plane, body.separation)
    heading = (body.raw_angle, angle, markers, body.separation)
    return Pose(times, measured, segment, raw, path, *heading, held, hidden, plane, rows)


class _MarkedBody:
    """Rigid body through the head and the tail marker, or a point if there is one marker only.

    Its noise follows from the distance between the two markers.
    """

    separation: Array | None = None
    raw_angle: Array | None = None

    def __init__(
        self,
        track: RawTrack,
        setup: Setup,
        plane: Plane,
        rows: list[int],
        markers: Array,
        hidden: Array,
        measured: NDArray[np.bool_],
    ) -> None:
        head, tail = rows[0], rows[-1]
        self.setup, self.rows, self.markers, self.hidden = setup, rows, markers, hidden
        self.measured, self.trusted = measured, ~np.any(hidden[rows] > 0, axis=0)
        self.weights = [_weights(track, row, hidden[row]) for row in rows]
        self.pixel = plane.size_of_pixel(*(float(np.nanmedian(values)) for values in track.centre(head)))
        # Standard deviation ``white`` of the error of a marker's centre that averages out, and standard
        # deviations of the errors that do not average out: of the heading (``along``), and of the position.
        self.white, self.along = MIN_NOISE_PX * self.pixel, 0.0
        self.lasting = SYSTEMATIC_PX * self.pixel
        if tail == head:
            return
        forward = markers[head] - markers[tail]
        self.separation = np.hypot(*forward)
        self.distance = float(np.nanmedian(self.separation))
        white, self.along = _centroid_errors(np.where(measured & self.trusted, self.separation, np.nan))
        self.white, self.lasting = max(self.white, white), float(np.hypot(self.along, self.lasting))
        if setup.markers[0].method == "background":
            # The centre and the rear point of a silhouette follow from the same outline. Therefore the
            # distance between them does not show all errors of the heading.
            self.along = self.lasting
        if setup.places is not None:
            ahead, aside = np.subtract(*setup.places)
            forward = np.array([[ahead, aside], [-aside, ahead]]) @ forward
        self.raw_angle = np.where(measured, unwrap(np.arctan2(forward[1], forward[0])), np.nan)

    def smooth_angle(self, clock: Array, segments: list[tuple[int, int]]) -> SmoothedPath | None:
        """Return the smoothed heading; None for a single marker."""
        if self.raw_angle is None:
            return None
        turn = np.sqrt(2) / max(self.distance, 1e-12)
        weights, least = np.maximum(*self.weights), turn * self.white
        angle = smooth_path(
            clock, self.raw_angle[None], weights, segments, min_sd=least, trusted=self.trusted
        )
        # Add the errors of partly hidden markers. They do not average out, because they last as long as the
        # markers are hidden.
        off = np.hypot(*self.hidden[self.rows]) * self.pixel / TWO_SIDED / self.distance
        return _add_errors(angle, turn * self.along, off)

    def smooth_position(
        self,
        clock: Array,
        segments: list[tuple[int, int]],
        fresh: NDArray[np.bool_],
        angle: SmoothedPath | None,
    ) -> tuple[Array, SmoothedPath]:
        """Return measured and smoothed position of the reference point. ``fresh`` are the frames to use."""
        head, weights, used = self.rows[0], self.weights[0], self.rows[:1]
        raw, lever = np.where(fresh, self.markers[head], np.nan), np.zeros(2)
        if self.setup.places is not None and angle is not None:
            # Compute the mid-point only where both markers are measured. With one marker only, an error of
            # the scale would shift the reference point.
            raw = np.where(self.measured, self.markers[self.rows].mean(axis=0), np.nan)
            lever, weights = -np.mean(self.setup.places, axis=0), np.maximum(*self.weights)
            used = self.rows
        if angle is not None:
            # Turn the lever from the mid-point of the markers to the reference point by the smoothed heading.
            # The measured heading would add its noise to the path.
            raw = raw + _rotate(lever, angle.position[0])
        path = smooth_path(clock, raw, weights, segments, min_sd=self.white, trusted=self.trusted)
        path = _add_errors(path, self.lasting, self.hidden[used].max(axis=0) * self.pixel / TWO_SIDED)
        if angle is not None:
            # Add the position error that results from the error of the heading. It is perpendicular to the
            # line from the mid-point of the markers to the reference point.
            across = np.abs(_rotate(np.array([-lever[1], lever[0]]), angle.position[0]))
            velocity_sd = np.hypot(path.velocity_sd, across * angle.velocity_sd)
            path = replace(_add_errors(path, across * angle.position_sd), velocity_sd=velocity_sd)
        return raw, path


def _add_errors(values: SmoothedPath, *sds: Array | float) -> SmoothedPath:
    """Return a copy of smoothed coordinates whose standard deviations include further independent errors.

    ``sds`` are the standard deviations of these errors.
    """
    variance = values.position_sd**2 + sum(np.square(sd) for sd in sds)
    return replace(values, position_sd=np.sqrt(variance))


def _picture_times(times: Array, held: Held) -> tuple[Array, float]:
    """Return the times at which the pictures were taken, and the maximum error of their clock offset, s.

    The time stamp of a picture is up to ``lateness_s`` later than the picture. For a camera with even time
    steps, the delays of the stamps limit the offset common to all pictures to an interval, of which the
    middle is used. The times of frames that repeat a picture are interpolated.
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
    values: SmoothedPath, clock: Array, times: Array, segments: list[tuple[int, int]], clock_sd: float
) -> SmoothedPath:
    """Return smoothed coordinates at the time stamps of the frames, from those at the times of exposure.

    ``clock_sd`` is half of the interval of the offset common to all pictures, so that the 95 % band contains
    every offset.
    """
    position, velocity = values.position.copy(), values.velocity.copy()
    for a, b in segments:
        curve = CubicHermiteSpline(clock[a:b], values.position[:, a:b], values.velocity[:, a:b], axis=1)
        position[:, a:b], velocity[:, a:b] = curve(times[a:b]), curve(times[a:b], 1)
    return _add_errors(replace(values, position=position, velocity=velocity), velocity * clock_sd)


def _with_plane_error(
    path: SmoothedPath, angle: SmoothedPath | None, plane: Plane, separation: Array | None
) -> tuple[SmoothedPath, SmoothedPath | None]:
    """Return path and heading with standard deviations that include the error of the calibration points."""
    moved = plane.variations(path.position)
    path = _add_errors(path, *moved)
    if angle is None or separation is None:
        return path, angle
    line = float(np.nanmedian(separation)) * np.stack([np.cos(angle.position[0]), np.sin(angle.position[0])])
    # Compute the change of the heading: one end of the line between the markers moves across this line,
    # relative to the other end.
    apart = (moved - plane.variations(path.position - line)) / np.nansum(line**2, axis=0)
    return path, _add_errors(angle, *(apart[:, 1] * line[0] - apart[:, 0] * line[1]))


def _centroid_errors(separation: Array) -> tuple[float, float]:
    """Return the standard deviations of the white and of the correlated error in the centre of a marker.

    They follow from the distance between two markers on a rigid body, which is constant. Half of the variance
    of this distance is the variance of one centre along the line. The covariance at :data:`LAGS` frames is
    that of correlated errors. The remaining variance is that of white noise, which averages out. Outliers are
    clipped to four robust standard deviations.
    """
    off = separation - np.nanmedian(separation)
    off = np.clip(off, *(np.array([-4.0, 4.0]) * 1.4826 * np.nanmedian(np.abs(off))))
    total = float(np.nanmean(off**2)) / 2
    products = np.concatenate([off[lag:] * off[:-lag] for lag in LAGS])
    if np.isfinite(products).sum() < MIN_PRODUCTS:
        return 0.0, 0.0
    lasting = min(max(float(np.nanmean(products)) / 2, 0.0), total)
    return float(np.sqrt(total - lasting)), float(np.sqrt(lasting))


def _rotate(vector: Array, angle: Array) -> Array:
    """Return a vector given along body axes as a vector along world axes, for each heading, shape (2, n)."""
    cos, sin = np.cos(angle), np.sin(angle)
    return np.stack([vector[0] * cos - vector[1] * sin, vector[0] * sin + vector[1] * cos])


def _segments(times: Array, measured: NDArray[np.bool_], max_gap_s: float) -> list[tuple[int, int]]:
    """Return start and end (exclusive) of each segment of a track.

    Gaps of more than ``max_gap_s`` separate the segments.
    """
    seen, step = np.flatnonzero(measured), float(np.median(np.diff(times)))
    # Subtract one time step, so that the gap between two successive frames is zero.
    split = np.flatnonzero(np.diff(times[seen]) - step > max_gap_s + 1e-9)
    parts = [part for part in np.split(seen, split + 1) if len(part) >= MIN_SEGMENT]
    return [(int(part[0]), int(part[-1]) + 1) for part in parts]


def limit_hidden_error(track: RawTrack, marker: int, plane: Plane) -> Array:
    """Return the maximum error in the centre of a partly hidden marker, px, shape (n,); 0 if whole.

    The centre of the whole marker is the mean of the centres of the visible and of the hidden part, weighted
    by their areas. The centre of the hidden part is within the radius R. Therefore, with a hidden fraction e
    of the area, the error is at most R e / (1 - e), and less than R. The whole area is the median area on the
    plane, with an uncertainty given by its standard deviation. A sequence of smaller areas counts as hidden
    in two cases. Either two successive areas are smaller than chance explains with probability
    :data:`FALSE_ALARM` in a film, or the deviation of one area exceeds :data:`SINGLE_FRAME` times the
    deviation with this probability. The stricter limit for single areas is needed because the codec and the
    phase of the pixels reduce the areas of single frames.
    """
    off = np.zeros(len(track.times))
    seen = np.flatnonzero(track.is_whole[marker])
    if len(seen) < MIN_SEGMENT:
        return off
    area = track.area[marker, seen]
    share = area * plane.size_of_pixel(track.x[marker, seen], track.y[marker, seen]) ** 2
    share /= float(np.median(share))
    whole = area / share
    # Compute the minimum standard deviation of a relative area, which results because each pixel of the
    # outline is counted or not by chance.
    least = np.sqrt(2 * np.sqrt(np.pi * whole) / 12) / whole
    short = -np.log(share)
    scatter = np.maximum(_scatter(short), least)
    chance = FALSE_ALARM / len(seen)
    twice, once = -float(special.ndtri(np.sqrt(chance))), -SINGLE_FRAME * float(special.ndtri(chance))
    far = short / scatter
    ratio = np.exp(short + scatter) - 1  # e / (1 - e), where e is the hidden fraction
    bound = np.sqrt(whole / np.pi) * np.minimum(ratio, 1.0)
    for start, end in runs(short > 0):
        pairs = np.minimum(far[start : end - 1], far[start + 1 : end])
        if np.max(far[start:end]) > once or np.max(pairs, initial=0.0) > twice:
            off[seen[start:end]] = bound[start:end]
    return off


def _scatter(short: Array) -> float:
    """Return the standard deviation of the logarithm of a marker's area about its median.

    The result is the larger of two estimates: from the middle half of the areas, and from the areas above the
    median. The areas above the median show how heavy the tails are, because markers with large areas are not
    hidden.
    """
    middle = 1.4826 * float(np.median(np.abs(short)))
    large = -short[short < 0]
    if not len(large):
        return middle
    # Take half of the 95.45 % quantile, because a normal variable is within two standard deviations with
    # probability 0.9545.
    return max(middle, 0.5 * float(np.quantile(large, 0.9545)))


def _weights(track: RawTrack, marker: int, hidden: Array) -> Array:
    """Return the variance of each measured centre of a marker, relative to a typical one, shape (n,)."""
    seen = track.is_whole[marker]
    weights = np.ones(len(track.times))
    if seen.any():
        usual = float(np.median(track.confidence[marker, seen]))
        weights[seen] = np.clip(usual / np.maximum(track.confidence[marker, seen], 1e-3), 1, 5) ** 2
    noise = max(noise_px(track, marker), MIN_NOISE_PX)
    return np.asarray(weights + (hidden / TWO_SIDED / noise) ** 2)


def noise_px(track: RawTrack, marker: int) -> float:
    """Return the standard deviation of the white noise in a marker's centre, from second differences, px."""
    second = np.diff(np.stack(track.centre(marker)), n=2, axis=1)
    known = second[np.isfinite(second)]
    if not len(known):
        return 0.0
    return 1.4826 * float(np.median(np.abs(known))) / math.sqrt(6)


def columns(pose: Pose, track: RawTrack, setup: Setup) -> dict[str, Any]:
    """Return the columns of a log from the pose and the marker track, in the order of the log."""
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
        # Add the velocity error that results from an error of the heading. This error mixes surge and sway.
        out[f"u_sd_{unit}_s"] = np.hypot(speed_sd, turn_sd * out[f"{side}_{unit}_s"])
        out[f"{side}_sd_{unit}_s"] = np.hypot(speed_sd, turn_sd * out[f"u_{unit}_s"])
        out[f"{angle_name}_rate_sd_rad_s"] = pose.angle.velocity_sd[0]
    out[f"vx_sd_{unit}_s"], out[f"v{up}_sd_{unit}_s"] = pose.path.velocity_sd
    out[f"x_raw_{unit}"], out[f"{up}_raw_{unit}"] = pose.raw
    if pose.raw_angle is not None:
        out[f"{angle_name}_raw_rad"] = pose.raw_angle
    out["frame"] = np.arange(len(pose.times))
    out["found"] = pose.measured.astype(int)
    out["interpolated"] = pose.is_interpolated.astype(int)
    out["segment"] = pd.array(pose.segment, dtype="Int64")
    out["segment"][pose.segment == 0] = pd.NA
    worst, best = track.status[pose.rows].min(axis=0), track.status[pose.rows].max(axis=0)
    word = np.array(STATUS_NAMES, dtype=object)[np.where(worst == LOST, LOST, best)]
    word[(worst > LOST) & track.at_edge[pose.rows].any(axis=0)] = CUT
    out["status"] = word
    out["confidence"] = np.min(track.confidence[pose.rows], axis=0)
    for i, name in enumerate(track.names):
        out[f"{name}_x_px"], out[f"{name}_y_px"] = track.centre(i)
        if unit == "m":
            out[f"{name}_x_m"], out[f"{name}_{up}_m"] = pose.markers[i]
        out[f"{name}_area_px"], out[f"{name}_confidence"] = track.area[i], track.confidence[i]
        out[f"{name}_status"] = np.array(STATUS_NAMES)[track.status[i]]
        out[f"{name}_at_edge"] = track.at_edge[i].astype(int)
    return out
