"""What moves the driven joints: a commanded waveform or a measured angle, as tables for the engine."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numba
import numpy as np
from scipy.interpolate import BSpline, make_smoothing_spline
from scipy.optimize import minimize_scalar

from swimid.fitting.easing import eased
from swimid.fitting.model import Array

#: Angle, rate and acceleration at given times.
Motion = tuple[Array, Array, Array]


@dataclass(frozen=True)
class Beat:
    """A commanded tail beat, in SI.

    Attributes
    ----------
    waveform : {"sine", "hopf", "a-cpg"}
    frequency_hz, amplitude_rad, bias_rad : float
    asymmetry : float
        h_a of Eq 10; the half-beat with rising angle lasts (1 - h) / 2 of a period.
    ramp_s : float
        The whole command is eased in by a quintic smoothstep over this time.
    phase_rad : float
        Phase at time zero.
    """

    waveform: str
    frequency_hz: float
    amplitude_rad: float
    bias_rad: float = 0.0
    asymmetry: float = 0.0
    ramp_s: float = 1.0
    phase_rad: float = 0.0

    def motion(
        self,
        time_s: Array,
        *,
        gain: float = 1.0,
        bias_gain: float = 1.0,
        phase_rad: float = 0.0,
        cell_s: Array | None = None,
    ) -> Motion:
        """Angle, rate and acceleration of a joint.

        Parameters
        ----------
        time_s : ndarray, shape (n,)
            Zero is where the drive starts, with phase zero; the joint is straight before.
        gain, bias_gain : float
            The joint's share of amplitude and bias.
        phase_rad : float
            Phase ahead of the drive's.
        cell_s : ndarray, shape (n,), optional
            Where the acceleration jumps (a-cpg), give its mean over such a stretch around each time
            (:func:`cells`).

        Returns
        -------
        tuple of ndarray, each shape (n,)
            rad, rad/s, rad/s2.
        """
        phase = self.phase_rad + phase_rad
        value, rate, bend = self._wave(time_s, phase)
        if cell_s is not None and self.waveform == "a-cpg":
            ends = [self._wave(time_s + side * cell_s, phase)[1] for side in (-0.5, 0.5)]
            bend = (ends[1] - ends[0]) / cell_s
        a, b = gain * self.amplitude_rad, bias_gain * self.bias_rad
        value, rate, bend = a * value + b, a * rate, a * bend
        ease, slope, curve = smoothstep(time_s, self.ramp_s)
        return value * ease, rate * ease + value * slope, bend * ease + 2 * rate * slope + value * curve

    def _wave(self, time_s: Array, phase_rad: float) -> Motion:
        omega = 2.0 * math.pi * self.frequency_hz
        if self.waveform == "a-cpg":
            return hopf(time_s, self.frequency_hz, self.asymmetry, phase_rad)
        if self.waveform == "hopf":
            return hopf(time_s, self.frequency_hz, 0.0, phase_rad)
        angle = omega * time_s + phase_rad
        return np.sin(angle), omega * np.cos(angle), -(omega**2) * np.sin(angle)


def cells(time_s: Array) -> Array:
    """Stretches around the times of a half-step grid that Runge-Kutta's weights tile the time with.

    An acceleration averaged over them adds up to the right rate, wherever it jumps.

    Parameters
    ----------
    time_s : ndarray, shape (n,), n >= 2

    Returns
    -------
    ndarray, shape (n,)
        A third of a step at its ends, two thirds in its middle.
    """
    half = float(time_s[1] - time_s[0])
    return np.where(np.arange(len(time_s)) % 2 == 0, 2.0 / 3.0 * half, 4.0 / 3.0 * half)


def hopf(time_s: Array, frequency_hz: float, asymmetry: float, phase_rad: float = 0.0) -> Motion:
    """Output alpha of the (asymmetric) Hopf oscillator on its limit cycle of radius one.

    Parameters
    ----------
    time_s : ndarray, shape (n,)
    frequency_hz : float
    asymmetry : float
        h_a, between -1 and 1.
    phase_rad : float
        Phase of the beat at time zero; with asymmetry it stands for the share of the period.

    Returns
    -------
    tuple of ndarray
        alpha and its first two derivatives.

    Notes
    -----
    Tendon fish, Eq 10, with two corrections: the bias belongs to the output (as printed it drops
    out of alpha), and the radius is one with the amplitude as a gain (as printed it would be the
    square root of A, reached at a rate that depends on the unit of A). On the limit cycle
    ``alpha = sin(psi)`` and ``psi' = omega / (1 - h sgn(alpha'))``: the period stays, the angle
    rises in (1 - h) / 2 of it and falls in (1 + h) / 2; the acceleration jumps at the turns.

    >>> value, rate, _ = hopf(np.array([0.0, 0.25]), 1.0, 0.0)
    >>> [round(float(v), 12) for v in value]
    [0.0, 1.0]
    """
    omega = 2.0 * math.pi * frequency_hz
    rising = 0.5 * (1.0 - asymmetry)  # share of the period with alpha rising
    # share of the period since the last lowest point; the drive starts in the middle of the rise
    share = np.mod(frequency_hz * time_s + phase_rad / (2.0 * math.pi) + 0.5 * rising, 1.0)
    up = share < rising
    psi = np.where(
        up,
        -0.5 * math.pi + math.pi * share / rising,
        0.5 * math.pi + math.pi * (share - rising) / (1.0 - rising),
    )
    speed = np.where(up, omega / (1.0 - asymmetry), omega / (1.0 + asymmetry))
    return np.sin(psi), speed * np.cos(psi), -(speed**2) * np.sin(psi)


def smoothstep(time_s: Array, ramp_s: float) -> Motion:
    """The ease-in of :func:`eased` with its first two derivatives; a step where ``ramp_s`` is zero."""
    if ramp_s <= 0:
        on = (time_s >= 0).astype(float)
        return on, np.zeros_like(on), np.zeros_like(on)
    s = np.clip(time_s / ramp_s, 0.0, 1.0)
    return (
        eased(time_s, ramp_s),
        30.0 * s**2 * (1.0 - s) ** 2 / ramp_s,
        60.0 * s * (1.0 - s) * (1.0 - 2.0 * s) / ramp_s**2,
    )


def measured(time_s: Array, angle_rad: Array) -> BSpline:
    """One smoothing spline through a measured joint angle, for angle, rate and acceleration alike.

    Parameters
    ----------
    time_s, angle_rad : ndarray, shape (n,)
        NaN where missing.

    Returns
    -------
    BSpline
        Cubic; the smoothing is chosen by generalised cross-validation.

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
    """Generalised cross-validation score of a natural cubic smoothing spline.

    Parameters
    ----------
    smoothing : float
        Weight of the integrated squared curvature.
    spacing : ndarray, shape (n - 1,)
    values : ndarray, shape (n,)

    Returns
    -------
    float
        ``n |residuals|^2 / trace(I - A)^2``.

    Notes
    -----
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

    Parameters
    ----------
    command : ndarray, shape (2 m + 1,)
        On half the grid of the result.
    step : float, s
        Step of the result's grid.
    omega : float, rad/s
    damping : float

    Returns
    -------
    ndarray, shape (m + 1, 3)
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


#: Half the width of the bell that smooths what an actuator adds to its command, s: a joint cannot jump.
SMOOTH_S = 0.015


def deviated(motion: Motion, actual: Array, step_s: float) -> Motion:
    """A commanded motion as the actuator really does it.

    Parameters
    ----------
    motion : Motion
        Command, on an even grid.
    actual : ndarray, shape (m,)
        What becomes of the angle; it may have corners.
    step_s : float
        Of the grid.

    Returns
    -------
    Motion
        The command plus the deviation, that smoothed by a cubic B-spline bell so that rate and
        acceleration belong to the angle. Without deviation it is the command.
    """
    deviation = actual - motion[0]
    if not deviation.any():
        return motion
    bells = _bells(step_s)
    padded = np.pad(deviation, len(bells[0]) // 2, mode="edge")
    parts = [np.convolve(padded, bell, mode="valid") for bell in bells]
    return motion[0] + parts[0], motion[1] + parts[1], motion[2] + parts[2]


@lru_cache(maxsize=32)
def _bells(step_s: float) -> list[Array]:
    """The bell and its first two derivatives on an even grid, each shape (2 reach + 1,)."""
    spacing = max(0.5 * SMOOTH_S, 1.5 * step_s)
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
    """Joint motions as the engine reads them.

    Parameters
    ----------
    count : int
        m, times in the table.
    motions : sequence of motions, each of shape (m,)
    mounts_rad : sequence of float
        Mounting angle of each joint.

    Returns
    -------
    ndarray, shape (m, joints, 5)
        Angle, rate, acceleration, and cosine and sine of the angle with its mounting angle.
    """
    found = np.empty((count, len(motions), 5))
    for k, (motion, mount) in enumerate(zip(motions, mounts_rad, strict=True)):
        for column, part in enumerate(motion):
            found[:, k, column] = part
        found[:, k, 3] = np.cos(motion[0] + mount)
        found[:, k, 4] = np.sin(motion[0] + mount)
    return found
