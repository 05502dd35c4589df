"""What the driven joints do, as tables for the engine: measured angles, servos, deviations of actuators."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import lru_cache
from itertools import groupby

import numba
import numpy as np
from scipy.interpolate import BSpline, make_smoothing_spline
from scipy.optimize import minimize_scalar

from swimid.fitting.drives import Array, Motion


def measured(time_s: Array, angle_rad: Array) -> BSpline:
    """One cubic smoothing spline through a measured joint angle, for angle, rate and acceleration alike.

    The angles are NaN where missing; generalised cross-validation chooses the smoothing.

    Raises
    ------
    ValueError
        With fewer than five samples.
    """
    there = np.isfinite(angle_rad)
    if there.sum() < 5:
        raise ValueError("a measured joint needs at least five samples")
    times, angles = time_s[there], np.unwrap(angle_rad[there])
    # in units of the sampling interval the smoothing has one natural range, whatever the rate
    scale = float(np.median(np.diff(times)))
    places = (times - times[0]) / scale
    spacing = np.diff(places)
    grid = np.arange(-8.0, 10.0, 0.5)
    scores = [_cross_validation(10.0**power, spacing, angles) for power in grid]
    best = float(grid[int(np.argmin(scores))])
    around = (best - 0.5, best + 0.5)
    power = minimize_scalar(
        lambda p: _cross_validation(10.0**p, spacing, angles), bounds=around, method="bounded"
    ).x
    found = make_smoothing_spline(places, angles, lam=10.0**power)
    return BSpline(times[0] + scale * found.t, found.c, 3)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _cross_validation(smoothing, spacing, values):  # type: ignore[no-untyped-def]
    """Generalised cross-validation score ``n |residuals|^2 / trace(I - A)^2`` of a natural cubic spline.

    Reinsch's banded system for the curvatures; the trace from the bands of its inverse
    (Hutchinson and de Hoog, Numerische Mathematik 47, 1985).
    """
    n = len(values)
    m = n - 2
    left, right = 1.0 / spacing[:-1], 1.0 / spacing[1:]
    middle = -left - right
    # the bands of Q'Q, then of R + smoothing Q'Q and its factors
    square, beside, beyond = left**2 + middle**2 + right**2, np.zeros(m + 2), np.zeros(m + 2)
    pivot, first, second = np.zeros(m + 2), np.zeros(m + 2), np.zeros(m + 2)
    curvature = np.zeros(m + 2)
    for j in range(m):
        if j < m - 1:
            beside[j] = middle[j] * left[j + 1] + right[j] * middle[j + 1]
        if j < m - 2:
            beyond[j] = right[j] * left[j + 2]
    for j in range(m):
        pivot[j] = (spacing[j] + spacing[j + 1]) / 3.0 + smoothing * square[j]
        first[j] = (spacing[j + 1] / 6.0 if j < m - 1 else 0.0) + smoothing * beside[j]
        second[j] = smoothing * beyond[j]
        curvature[j] = values[j] * left[j] + values[j + 1] * middle[j] + values[j + 2] * right[j]
        if j > 0:
            pivot[j] -= first[j - 1] ** 2 * pivot[j - 1]
            first[j] -= second[j - 1] * first[j - 1] * pivot[j - 1]
            curvature[j] -= first[j - 1] * curvature[j - 1]
        if j > 1:
            pivot[j] -= second[j - 2] ** 2 * pivot[j - 2]
            curvature[j] -= second[j - 2] * curvature[j - 2]
        first[j] /= pivot[j]
        second[j] /= pivot[j]
    trace, inverse, near, far = 0.0, np.zeros(m + 2), np.zeros(m + 2), np.zeros(m + 2)
    for j in range(m - 1, -1, -1):
        curvature[j] = curvature[j] / pivot[j] - first[j] * curvature[j + 1] - second[j] * curvature[j + 2]
        near[j] = -first[j] * inverse[j + 1] - second[j] * near[j + 1]
        far[j] = -first[j] * near[j + 1] - second[j] * inverse[j + 2]
        inverse[j] = 1.0 / pivot[j] - first[j] * near[j] - second[j] * far[j]
        trace += square[j] * inverse[j] + 2.0 * (beside[j] * near[j] + beyond[j] * far[j])
    residual = np.zeros(n)
    for j in range(m):
        residual[j] += left[j] * curvature[j]
        residual[j + 1] += middle[j] * curvature[j]
        residual[j + 2] += right[j] * curvature[j]
    return n * np.sum(residual**2) / trace**2


def spline_motion(spline: BSpline) -> Callable[[Array], Motion]:
    """The spline as a motion, held at its ends."""
    rate, bend = spline.derivative(), spline.derivative(2)
    low, high = float(spline.t[0]), float(spline.t[-1])

    def motion(time_s: Array) -> Motion:
        inside = (time_s >= low) & (time_s <= high)
        t = np.clip(time_s, low, high)
        return spline(t), np.where(inside, rate(t), 0.0), np.where(inside, bend(t), 0.0)

    return motion


@numba.njit(cache=True, nogil=True, error_model="numpy")
def servo(command, step, omega, damping):  # type: ignore[no-untyped-def]
    """Angle, rate and acceleration of a second-order servo that starts at its command, at rest.

    Shape (m + 1, 3), on a grid of this step (s); the command, shape (2 m + 1,), is on half that grid, omega
    in rad/s.
    """
    count = (len(command) - 1) // 2
    result = np.empty((count + 1, 3))
    a, w = command[0], 0.0
    square, loss = omega * omega, 2.0 * damping * omega
    for i in range(count + 1):
        result[i, 0], result[i, 1] = a, w
        result[i, 2] = square * (command[2 * i] - a) - loss * w
        if i == count:
            break
        c0, c1, c2 = command[2 * i], command[2 * i + 1], command[2 * i + 2]
        w1 = w
        d1 = square * (c0 - a) - loss * w1
        w2 = w + 0.5 * step * d1
        d2 = square * (c1 - (a + 0.5 * step * w1)) - loss * w2
        w3 = w + 0.5 * step * d2
        d3 = square * (c1 - (a + 0.5 * step * w2)) - loss * w3
        w4 = w + step * d3
        d4 = square * (c2 - (a + step * w3)) - loss * w4
        a += step / 6.0 * (w1 + 2.0 * (w2 + w3) + w4)
        w += step / 6.0 * (d1 + 2.0 * (d2 + d3) + d4)
    return result


def deviated(motion: Motion, actual: Array, step_s: float) -> Motion:
    """A commanded motion on an even grid as the actuator really does it; its actual angle may have corners.

    The command plus the deviation, that smoothed by a cubic B-spline bell so that rate and
    acceleration belong to the angle. Without deviation it is the command.
    """
    deviation = actual - motion[0]
    if not deviation.any():
        return motion
    bells = _bells(step_s)
    reach = len(bells[0]) // 2
    padded = np.concatenate((np.full(reach, deviation[0]), deviation, np.full(reach, deviation[-1])))
    parts = [np.convolve(padded, bell, mode="valid") for bell in bells]
    return motion[0] + parts[0], motion[1] + parts[1], motion[2] + parts[2]


@lru_cache(maxsize=32)
def _bells(step_s: float) -> list[Array]:
    """The bell and its first two derivatives on an even grid, each shape (2 reach + 1,)."""
    # half the width of the bell, s: a joint cannot jump
    spacing = max(0.5 * 0.015, 1.5 * step_s)
    reach = math.ceil(2.0 * spacing / step_s)
    at = np.arange(-reach, reach + 1) * step_s / spacing
    bell = BSpline.basis_element(np.arange(-2.0, 3.0), extrapolate=False)
    found = []
    for order in range(3):
        kernel = np.nan_to_num(bell(at, nu=order)) / spacing**order
        # on a grid its moments are those of the bell only nearly: constants and polynomials come out exactly
        if order:
            kernel -= kernel.mean()
        found.append(kernel / float(kernel @ ((-at * spacing) ** order / math.factorial(order))))
    return found


def table(count: int, motions: Sequence[Motion], mounts_rad: Sequence[float]) -> Array:
    """Joint motions as the engine reads them, shape (count, joints, 5).

    Angle, rate, acceleration, and cosine and sine of the angle with the joint's mounting angle.
    """
    found = np.empty((count, len(motions), 5))
    joints = zip(motions, mounts_rad, range(len(motions)), strict=True)
    # joints of one motion side by side are written together
    for _, group in groupby(joints, key=lambda joint: (id(joint[0]), joint[1])):
        (motion, mount, first), *others = group
        parts = (np.ascontiguousarray(part, dtype=float) for part in motion)
        _columns(found, first, first + 1 + len(others), *parts, mount)
    return found


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _columns(found, first, end, angle, rate, acceleration, mount):  # type: ignore[no-untyped-def]
    for i in range(len(found)):
        c, s = math.cos(angle[i] + mount), math.sin(angle[i] + mount)
        for k in range(first, end):
            found[i, k, 0], found[i, k, 1], found[i, k, 2] = angle[i], rate[i], acceleration[i]
            found[i, k, 3], found[i, k, 4] = c, s
