"""Kalman filter and Rauch-Tung-Striebel smoother with uneven steps, gaps and estimated noise.

The state of one coordinate is position and velocity (driven by white acceleration), or position, velocity and
acceleration (driven by white jerk). The powers of the driving noise and of the measurement noise maximise the
likelihood of the innovations. The model with the larger likelihood is used.

The estimation of the noise, and the calibration of the standard deviation in gaps, run the filter hundreds of
times. Therefore the filter is a compiled loop.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from swimid.logs.log import runs

Array = NDArray[np.float64]

#: Number of hidden segments that calibrate the standard deviation in a gap, and known samples on each side.
N_STRETCHES, MARGIN = 40, 20
#: Minimum number of samples in a segment from which the noise is estimated.
MIN_SAMPLES = 6
#: Powers of ten that are compared for the ratio between driving noise and measurement noise in one step.
RATIOS = np.arange(-9.0, 4.5)
#: Variance of the unknown initial position, relative to the measurement variance. For velocity and
#: acceleration it is divided by the second and fourth power of the time step.
START_VARIANCE = 1e7


@dataclass(frozen=True)
class Smoothed:
    """Coordinates that were smoothed together.

    Attributes
    ----------
    position, velocity, position_sd, velocity_sd : ndarray, shape (d, n)
        Smoothed values of the d coordinates and their standard deviations.
    measurement_sd : float
        Estimated standard deviation of a measurement of weight 1, in the unit of the coordinate.
    process_noise : float
        Power of the driving white noise: unit^2/s^3 for order 2, unit^2/s^5 for order 3.
    order : int
        2 for white acceleration, 3 for white jerk.
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


# The matrices have two or three rows. Array expressions and linear algebra routines take ten times as long to
# compile as these loops, and run no faster.


@njit(cache=True)
def _step(dt, q, order, transition, noise):  # type: ignore[no-untyped-def]  # pragma: no cover - compiled
    """Fill the transition matrix and the noise covariance of a chain of integrators in a step of ``dt`` s.

    Noise of power q drives the highest derivative. Entry (i, j) of the transition is dt^(j - i) / (j - i)!.
    """
    factorial = (1.0, 1.0, 2.0)
    for i in range(order):
        for j in range(i, order):
            transition[i, j] = dt ** (j - i) / factorial[j - i]
        for j in range(order):
            a, b = order - 1 - i, order - 1 - j
            power = a + b + 1
            noise[i, j] = q * dt**power / (factorial[a] * factorial[b] * power)


@njit(cache=True)
def _product(a, b, result):  # type: ignore[no-untyped-def]  # pragma: no cover - compiled
    """Write the product a b into ``result``."""
    n = len(a)
    for i in range(n):
        for j in range(n):
            total = 0.0
            for k in range(n):
                total += a[i, k] * b[k, j]
            result[i, j] = total


@njit(cache=True)
def _sandwich(a, b, work, result):  # type: ignore[no-untyped-def]  # pragma: no cover - compiled
    """Add a b a' to ``result``."""
    n = len(a)
    _product(a, b, work)
    for i in range(n):
        for j in range(n):
            for k in range(n):
                result[i, j] += work[i, k] * a[j, k]


@njit(cache=True)
def _solve(a, b):  # type: ignore[no-untyped-def]  # pragma: no cover - compiled
    """Replace b by a^-1 b for a positive definite a, which is overwritten."""
    n = len(a)
    for i in range(n):
        for j in range(i + 1, n):
            factor = a[j, i] / a[i, i]
            for k in range(n):
                a[j, k] -= factor * a[i, k]
                b[j, k] -= factor * b[i, k]
    for i in range(n - 1, -1, -1):
        for k in range(n):
            for j in range(i + 1, n):
                b[i, k] -= a[i, j] * b[j, k]
            b[i, k] /= a[i, i]


@njit(cache=True)
def kalman(  # pragma: no cover - compiled loops
    times: Array, values: Array, variances: Array, q: float, order: int, start: Array
) -> tuple[Array, Array, Array, Array]:
    """Apply the Kalman filter to one coordinate.

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
    innovations, innovation_variances : ndarray, shape (n,)
        NaN without a measurement.
    """
    transition, noise = np.zeros((order, order)), np.zeros((order, order))
    work, keep = np.zeros((order, order)), np.zeros((order, order))
    gain, moved = np.zeros(order), np.zeros(order)
    n = len(times)
    means, covariances = np.zeros((n, order)), np.zeros((n, order, order))
    innovations, spreads = np.full(n, np.nan), np.full(n, np.nan)
    mean, covariance = means[0], covariances[0]
    for k in range(n):
        if values[k] == values[k]:
            mean[0] = values[k]
            break
    covariance[:] = start
    for k in range(n):
        if k > 0:
            _step(times[k] - times[k - 1], q, order, transition, noise)
            mean, covariance = means[k], covariances[k]
            covariance[:] = noise
            for i in range(order):
                for j in range(order):
                    mean[i] += transition[i, j] * means[k - 1, j]
            _sandwich(transition, covariances[k - 1], work, covariance)
        if values[k] != values[k]:
            continue
        expected = covariance[0, 0] + variances[k]
        innovations[k] = values[k] - mean[0]
        spreads[k] = expected
        for i in range(order):
            gain[i] = covariance[i, 0] / expected
        # the Joseph form stays positive definite for a diffuse start
        for i in range(order):
            mean[i] += gain[i] * innovations[k]
            for j in range(order):
                keep[i, j] = (i == j) - gain[i] * (j == 0)
        _product(keep, covariance, work)
        for i in range(order):
            for j in range(order):
                moved[j] = variances[k] * gain[i] * gain[j]
                for m in range(order):
                    moved[j] += work[i, m] * keep[j, m]
            covariance[i] = moved
    return means, covariances, innovations, spreads


@njit(cache=True)
def rts(  # pragma: no cover - compiled
    times: Array, means: Array, covariances: Array, q: float, order: int
) -> tuple[Array, Array]:
    """Smooth the output of :func:`kalman` by the method of Rauch, Tung and Striebel."""
    smooth, spread = means.copy(), covariances.copy()
    transition, noise = np.zeros((order, order)), np.zeros((order, order))
    work, keep, after = np.zeros((order, order)), np.zeros((order, order)), np.zeros((order, order))
    predicted, gain, turned = np.zeros((order, order)), np.zeros((order, order)), np.zeros((order, order))
    for k in range(len(times) - 2, -1, -1):
        _step(times[k + 1] - times[k], q, order, transition, noise)
        for i in range(order):
            for j in range(order):
                predicted[i, j] = noise[i, j]
                after[i, j] = spread[k + 1, i, j] + noise[i, j]
        _sandwich(transition, spread[k], work, predicted)
        _product(transition, spread[k], gain)
        _solve(predicted, gain)
        for i in range(order):
            error = smooth[k + 1, i]
            for j in range(order):
                turned[i, j] = gain[j, i]
                error -= transition[i, j] * smooth[k, j]
            work[0, i] = error
        for i in range(order):
            for j in range(order):
                smooth[k, i] += turned[i, j] * work[0, j]
        # a sum of covariances is accurate for a diffuse start, and a difference is not
        _product(turned, transition, keep)
        for i in range(order):
            for j in range(order):
                keep[i, j] = (i == j) - keep[i, j]
        predicted[:] = spread[k]
        spread[k] = 0.0
        _sandwich(keep, predicted, work, spread[k])
        _sandwich(turned, after, work, spread[k])
    return smooth, spread


def _start(order: int, variance: float, step: float) -> Array:
    """Return the covariance of the unknown initial state, shape (order, order)."""
    return np.diag([START_VARIANCE * variance / step ** (2 * i) for i in range(order)])


def _likelihood(
    pieces: list[tuple[Array, Array, Array]], ratio: float, order: int, step: float
) -> tuple[float, float]:
    """Return the concentrated log-likelihood, and the measurement variance that maximises it.

    For a given ratio of driving noise to measurement variance, all innovation variances are proportional to
    the measurement variance. Its most likely value is the mean of the squared normalised innovations. The
    first ``order`` innovations of each segment determine the unknown initial state and are not used.
    """
    squares, logs, count = 0.0, 0.0, 0
    q, start = ratio / step ** (2 * order - 1), _start(order, 1.0, step)
    for times, values, weights in pieces:
        _, _, innovations, expected = kalman(times, values, weights, q, order, start)
        seen = np.flatnonzero(~np.isnan(innovations))[order:]
        squares += float(np.sum(innovations[seen] ** 2 / expected[seen]))
        logs += float(np.sum(np.log(expected[seen])))
        count += len(seen)
    if count == 0:
        return -np.inf, np.nan
    variance = max(squares / count, 1e-300)
    return -0.5 * (count * np.log(variance) + logs + count), variance


def _estimate_noise(
    pieces: list[tuple[Array, Array, Array]], order: int, step: float
) -> tuple[float, float, float]:
    """Return maximum log-likelihood, ratio of driving to measurement noise, and measurement variance."""

    def cost(exponent: float) -> float:
        return -_likelihood(pieces, 10.0**exponent, order, step)[0]

    middle = int(np.argmin([cost(exponent) for exponent in RATIOS]))
    bounds = (RATIOS[max(middle - 1, 0)], RATIOS[min(middle + 1, len(RATIOS) - 1)])
    ratio = float(10.0 ** minimize_scalar(cost, bounds=bounds, method="bounded", options={"xatol": 0.02}).x)
    likelihood, variance = _likelihood(pieces, ratio, order, step)
    return likelihood, ratio, variance


def _smooth_piece(
    times: Array, values: Array, weights: Array, noise: tuple[float, float, int], step: float
) -> tuple[Array, Array, Array]:
    """Return means, covariances and normalised innovations of one coordinate of a segment."""
    variance, power, order = noise
    start = _start(order, variance, step)
    means, covariances, innovations, expected = kalman(times, values, variance * weights, power, order, start)
    means, covariances = rts(times, means, covariances, power, order)
    normalised = innovations / np.sqrt(expected)
    normalised[np.flatnonzero(~np.isnan(normalised))[:order]] = np.nan
    return means, covariances, normalised


def _gap_factor(
    times: Array, row: Array, weights: Array, path: Array, length: int, noise: tuple[float, float, int]
) -> float:
    """Return the ratio, at least 1, of the errors in a gap of ``length`` samples to their standard deviation.

    Measured segments of that length, with ``MARGIN`` known samples on each side, are hidden, interpolated and
    compared with the path.
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


def smooth(
    times: Array,
    values: Array,
    weights: Array,
    segments: list[tuple[int, int]],
    *,
    min_sd: float = 0.0,
    trusted: NDArray[np.bool_] | None = None,
) -> Smoothed:
    """Smooth coordinates that share their noise, segment by segment.

    Parameters
    ----------
    times : ndarray, shape (n,)
        Times in s, strictly increasing.
    values : ndarray, shape (d, n)
        Measurements, NaN if missing.
    weights : ndarray, shape (n,)
        Variance of each measurement relative to a good one.
    segments : list of (start, end)
        Segments to smooth, ``end`` exclusive. The result is NaN outside of the segments.
    min_sd : float
        Minimum standard deviation of a measurement.
    trusted : ndarray of bool, shape (n,), optional
        Measurements from which the noise is estimated. The errors of the other measurements are correlated
        from sample to sample, so that the likelihood would attribute them to motion.

    Returns
    -------
    Smoothed

    Notes
    -----
    The acceleration of a swimmer is not white noise, because it follows the stroke. Therefore the standard
    deviation in a gap is calibrated: measured segments of the same length are hidden and interpolated, and
    the standard deviation is multiplied by the ratio of their errors to it.

    The noise maximises the likelihood of the innovations, with the measurement variance concentrated out
    (Harvey, A. C., 1989, *Forecasting, structural time series models and the Kalman filter*, section 3.4).
    The smoother is that of Rauch, Tung and Striebel (1965, AIAA J. 3(8), 1445-1450, doi:10.2514/3.3166).
    """
    names = ("position", "velocity", "position_sd", "velocity_sd", "innovation")
    out = {name: np.full(values.shape, np.nan) for name in names}
    known = values if trusted is None else np.where(trusted, values, np.nan)
    pieces = [
        (times[a:b], row[a:b], weights[a:b])
        for row, (a, b) in product(known, segments)
        if np.count_nonzero(~np.isnan(row[a:b])) >= MIN_SAMPLES
    ]
    step = float(np.median(np.diff(times))) if len(times) > 1 else 1.0
    order, ratio, fitted = 2, 1e-2, max(min_sd, 1e-12) ** 2
    if pieces:
        fits = {order: _estimate_noise(pieces, order, step) for order in (2, 3)}
        order, (_, ratio, fitted) = max(fits.items(), key=lambda item: item[1][0])
    variance = max(fitted, min_sd**2)
    noise = (variance, ratio * fitted / step ** (2 * order - 1), order)
    for (i, row), (a, b) in product(enumerate(values), segments):
        if np.isnan(row[a:b]).all():
            continue
        means, covariances, innovation = _smooth_piece(times[a:b], row[a:b], weights[a:b], noise, step)
        out["position"][i, a:b], out["velocity"][i, a:b] = means[:, 0], means[:, 1]
        sds = np.sqrt(np.maximum(covariances.diagonal(axis1=1, axis2=2), 0))
        out["position_sd"][i, a:b], out["velocity_sd"][i, a:b] = sds[:, 0], sds[:, 1]
        out["innovation"][i, a:b] = innovation
    for (i, row), (a, b) in product(enumerate(values), segments):
        for first, last in a + runs(np.isnan(row[a:b])):
            factor = _gap_factor(times, row, weights, out["position"][i], int(last - first), noise)
            out["position_sd"][i, first:last] *= factor
            out["velocity_sd"][i, first:last] *= factor
    return Smoothed(
        **out, measurement_sd=float(np.sqrt(variance)), process_noise=float(noise[1]), order=order
    )


def warm_up() -> None:
    """Compile the functions of this module."""
    times, ones = np.arange(3.0), np.ones(3)
    for order in (2, 3):
        means, covariances = kalman(times, ones, ones, 1.0, order, np.eye(order))[:2]
        rts(times, means, covariances, 1.0, order)
