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


# The matrices have two or three rows. Array expressions take ten times as long to compile as these loops, and
# run more slowly.


@njit(cache=True)
def _steps(times, q, order):  # type: ignore[no-untyped-def]  # pragma: no cover - compiled
    """Return the transition matrix and the noise covariance of each step of a chain of integrators.

    Noise of power q drives the highest derivative. Entry (i, j) of the transition is dt^(j - i) / (j - i)!.
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


@njit(cache=True)
def _add_sandwich(a, b, result):  # type: ignore[no-untyped-def]  # pragma: no cover - compiled
    """Add a b a' to ``result``."""
    n = len(a)
    for i in range(n):
        for j in range(n):
            for k in range(n):
                for m in range(n):
                    result[i, j] += a[i, k] * b[k, m] * a[j, m]


@njit(cache=True)
def _forward(values, variances, transitions, noises, means, covariances, innovations):  # type: ignore[no-untyped-def]  # pragma: no cover - compiled
    """Fill the filtered states from the first state on, and the innovations with their variances."""
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


@njit(cache=True)
def _backward(gains, means, covariances):  # type: ignore[no-untyped-def]  # pragma: no cover - compiled
    """Add the smoothed state after each step to the state before it, from the last step on."""
    for k in range(len(gains) - 1, -1, -1):
        for i in range(means.shape[1]):
            for j in range(means.shape[1]):
                means[k, i] += gains[k, i, j] * means[k + 1, j]
        _add_sandwich(gains[k], covariances[k + 1], covariances[k])


def kalman(
    times: Array, values: Array, variances: Array, q: float, order: int, start: Array
) -> tuple[Array, Array, Array]:
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
    innovations : ndarray, shape (2, n)
        Innovations and their variances, NaN without a measurement.
    """
    means, covariances = np.zeros((len(times), order)), np.zeros((len(times), order, order))
    means[0, 0], covariances[0] = values[np.isfinite(values)][0], start
    innovations = np.full((2, len(times)), np.nan)
    _forward(values, variances, *_steps(times, q, order), means, covariances, innovations)
    return means, covariances, innovations


def rts(times: Array, means: Array, covariances: Array, q: float, order: int) -> tuple[Array, Array]:
    """Smooth the output of :func:`kalman` by the method of Rauch, Tung and Striebel."""
    transitions, noises = _steps(times, q, order)
    moved = transitions @ covariances[:-1]
    gains = np.linalg.solve(moved @ transitions.mT + noises, moved).mT
    keep = np.eye(order) - gains @ transitions
    smooth, spread = means.copy(), covariances.copy()
    smooth[:-1] = np.einsum("kij,kj->ki", keep, means[:-1])
    # a sum of covariances is accurate for a diffuse start, and a difference is not
    spread[:-1] = keep @ covariances[:-1] @ keep.mT + gains @ noises @ gains.mT
    _backward(gains, smooth, spread)
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
        _, _, (innovations, expected) = kalman(times, values, weights, q, order, start)
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
    means, covariances, (off, expected) = kalman(times, values, variance * weights, power, order, start)
    means, covariances = rts(times, means, covariances, power, order)
    normalised = off / np.sqrt(expected)
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
    factors: dict[tuple[int, int], float] = {}
    for (i, row), (a, b) in product(enumerate(values), segments):
        for first, last in a + runs(np.isnan(row[a:b])):
            key = i, int(last - first)
            if key not in factors:
                factors[key] = _gap_factor(times, row, weights, out["position"][i], key[1], noise)
            out["position_sd"][i, first:last] *= factors[key]
            out["velocity_sd"][i, first:last] *= factors[key]
    return Smoothed(
        **out, measurement_sd=float(np.sqrt(variance)), process_noise=float(noise[1]), order=order
    )


def warm_up() -> None:
    """Compile the functions of this module."""
    times, ones = np.arange(3.0), np.ones(3)
    _smooth_piece(times, ones, ones, (1.0, 1.0, 2), 1.0)
