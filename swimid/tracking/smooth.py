"""Kalman filter and Rauch-Tung-Striebel smoother with uneven steps, gaps and estimated noise.

The state of one coordinate is position and speed (driven by white acceleration) or
position, speed and acceleration (driven by white jerk). The strength of the driving noise
and the measurement noise are found by maximum likelihood of the innovations; of the two
models the likelier is taken.

The search for the noise, and the hidden stretches that calibrate the deviation in a gap, run the filter
hundreds of times: it is a compiled loop.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from swimid.logs.log import runs

Array = NDArray[np.float64]

#: Hidden stretches tried to calibrate the deviation in a gap, and known samples about each.
_TRIALS, _MARGIN = 40, 20


@dataclass(frozen=True)
class Smoothed:
    """One or more coordinates, smoothed together.

    Attributes
    ----------
    position, velocity, position_sd, velocity_sd : ndarray, shape (d, n)
    measurement_sd : float
        Estimated noise of a measurement of weight 1, in the coordinate's unit.
    process_noise : float
        Power of the driving white noise: unit^2/s^3 for order 2, unit^2/s^5 for order 3.
    order : int
        2: white acceleration, 3: white jerk.
    innovation : ndarray, shape (d, n)
        Normalised innovation of each measurement, NaN where none.
    """

    position: Array
    velocity: Array
    position_sd: Array
    velocity_sd: Array
    measurement_sd: float
    process_noise: float
    order: int
    innovation: Array


# Plain loops over matrices of two or three rows: array expressions and linear algebra routines
# take ten times as long to compile and run no faster at this size.


@njit(cache=True)
def _step(dt, q, order, transition, noise):  # type: ignore[no-untyped-def]  # pragma: no cover - compiled
    """Fill the transition matrix and the noise of a step of ``dt`` seconds."""
    for i in range(order):
        transition[i, i] = 1.0
    transition[0, 1] = dt
    if order == 2:
        noise[0, 0] = q * dt**3 / 3
        noise[0, 1] = noise[1, 0] = q * dt**2 / 2
        noise[1, 1] = q * dt
    else:
        transition[0, 2] = dt * dt / 2
        transition[1, 2] = dt
        noise[0, 0] = q * dt**5 / 20
        noise[0, 1] = noise[1, 0] = q * dt**4 / 8
        noise[0, 2] = noise[2, 0] = q * dt**3 / 6
        noise[1, 1] = q * dt**3 / 3
        noise[1, 2] = noise[2, 1] = q * dt**2 / 2
        noise[2, 2] = q * dt


@njit(cache=True)
def _product(a, b, result):  # type: ignore[no-untyped-def]  # pragma: no cover - compiled
    """result = a b."""
    n = len(a)
    for i in range(n):
        for j in range(n):
            total = 0.0
            for k in range(n):
                total += a[i, k] * b[k, j]
            result[i, j] = total


@njit(cache=True)
def _sandwich(a, b, work, result):  # type: ignore[no-untyped-def]  # pragma: no cover - compiled
    """result += a b a'."""
    n = len(a)
    _product(a, b, work)
    for i in range(n):
        for j in range(n):
            for k in range(n):
                result[i, j] += work[i, k] * a[j, k]


@njit(cache=True)
def _solve(a, b):  # type: ignore[no-untyped-def]  # pragma: no cover - compiled
    """b becomes a^-1 b for a positive definite a, which is used up."""
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
    """Kalman filter of one coordinate.

    Parameters
    ----------
    times, values, variances : ndarray, shape (n,)
        NaN in ``values`` is a missing measurement.
    q : float
        Power of the driving noise.
    order : int
        2 or 3.
    start : ndarray, shape (order, order)
        Covariance of the state at times[0]; its mean is the first measurement at rest.

    Returns
    -------
    means, covariances : ndarray, shapes (n, order), (n, order, order)
        Filtered.
    innovations, innovation_variances : ndarray, shape (n,)
        NaN where there is no measurement.
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
        # Joseph form: stays positive where the start is diffuse.
        for i in range(order):
            mean[i] += gain[i] * innovations[k]
            for j in range(order):
                keep[i, j] = (1.0 if i == j else 0.0) - (gain[i] if j == 0 else 0.0)
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
    """Rauch-Tung-Striebel pass over the output of :func:`kalman`."""
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
        # A sum of covariances: a difference would lose its digits where the start is diffuse.
        _product(turned, transition, keep)
        for i in range(order):
            for j in range(order):
                keep[i, j] = (1.0 if i == j else 0.0) - keep[i, j]
        predicted[:] = spread[k]
        spread[k] = 0.0
        _sandwich(keep, predicted, work, spread[k])
        _sandwich(turned, after, work, spread[k])
    return smooth, spread


def _start(order: int, variance: float, step: float) -> Array:
    # Variance of the unknown start, over the measurement variance (and per step for its rates).
    return np.diag([1e7 * variance / step ** (2 * i) for i in range(order)])


def _likelihood(
    pieces: list[tuple[Array, Array, Array]], ratio: float, order: int, step: float
) -> tuple[float, float]:
    """Concentrated log-likelihood and the measurement variance it implies.

    With the driving noise given over the measurement variance, the latter scales all
    innovation variances alike and its best value is the mean of the squared normalised
    innovations. The first ``order`` innovations of each piece only fix the unknown start.
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


def _best(pieces: list[tuple[Array, Array, Array]], order: int, step: float) -> tuple[float, ...]:
    """Log-likelihood, driving noise over measurement noise, measurement variance."""

    def score(exponent: float) -> float:
        return _likelihood(pieces, 10.0**exponent, order, step)[0]

    # Range searched for the driving noise over the measurement noise in one step, log10.
    grid = np.arange(-9.0, 4.0 + 0.5, 1.0)
    middle = int(np.argmax([score(g) for g in grid]))
    bounds = (grid[max(middle - 1, 0)], grid[min(middle + 1, len(grid) - 1)])
    found = minimize_scalar(lambda g: -score(g), bounds=bounds, method="bounded", options={"xatol": 0.02})
    best, variance = _likelihood(pieces, 10.0**found.x, order, step)
    return best, float(10.0**found.x), variance


def _gap_factor(
    times: Array, row: Array, weights: Array, path: Array, length: int, noise: tuple[float, float, int]
) -> float:
    """How much wider than stated the errors are in a gap of ``length`` samples, at least 1.

    Measured stretches of that length are hidden, with ``_MARGIN`` samples about them known,
    and compared with the path smoothed from all.
    """
    variance, power, order = noise
    whole = length + 2 * _MARGIN
    known = runs(~np.isnan(row))
    starts = np.concatenate([np.zeros(0, int), *(np.arange(a, b - whole + 1) for a, b in known)])
    if len(row) <= whole or len(starts) < 5:
        return 1.0
    first_step = float(np.median(np.diff(times)))
    errors = []
    for start in starts[np.unique(np.linspace(0, len(starts) - 1, _TRIALS).astype(int))]:
        part = slice(start, start + whole)
        hidden = row[part].copy()
        hidden[_MARGIN:-_MARGIN] = np.nan
        clock, start_state = times[part], _start(order, variance, first_step)
        filtered = kalman(clock, hidden, variance * weights[part], power, order, start_state)[:2]
        means, covariances = rts(clock, *filtered, power, order)
        inside = slice(_MARGIN, _MARGIN + length)
        error = means[inside, 0] - path[part][inside]
        errors.append(np.abs(error) / np.sqrt(np.maximum(covariances[inside, 0, 0], 1e-300)))
    return max(1.0, float(np.percentile(np.concatenate(errors), 95)) / 1.96)


def smooth(
    times: Array,
    values: Array,
    weights: Array,
    segments: list[tuple[int, int]],
    *,
    least_sd: float = 0.0,
    trusted: NDArray[np.bool_] | None = None,
) -> Smoothed:
    """Smooth coordinates that share their noise, segment by segment.

    Parameters
    ----------
    times : ndarray, shape (n,)
        s, strictly increasing.
    values : ndarray, shape (d, n)
        Measurements, NaN where missing.
    weights : ndarray, shape (n,)
        Variance of each measurement over that of a good one.
    segments : list of (start, end)
        Stretches to smooth, ``end`` exclusive; outside of them the result is NaN.
    least_sd : float
        Lower bound of the measurement noise.
    trusted : ndarray of bool, shape (n,), optional
        Measurements that the noise is estimated from. The errors of the others are not independent from
        sample to sample: with them the likelihood would take the noise for motion.

    Returns
    -------
    Smoothed

    Notes
    -----
    In gaps the stated deviation is calibrated: stretches of the same length that were
    measured are hidden and predicted, and where the errors come out larger than stated the
    deviation is widened by that factor (a beating swimmer is no white noise).

    Maximum likelihood of the innovations, the measurement variance concentrated out:
    Harvey, A. C. (1989), *Forecasting, structural time series models and the Kalman
    filter*, section 3.4. Smoother: Rauch, Tung & Striebel (1965), AIAA J. 3(8), 1445-1450,
    doi:10.2514/3.3166.
    """
    d, n = values.shape
    names = ("position", "velocity", "position_sd", "velocity_sd", "innovation")
    out = {name: np.full((d, n), np.nan) for name in names}
    told = values if trusted is None else np.where(trusted, values, np.nan)
    pieces = [
        (times[a:b], row[a:b], weights[a:b])
        for a, b in segments
        for row in told
        if np.count_nonzero(~np.isnan(row[a:b])) >= 6
    ]
    typical = float(np.median(np.diff(times))) if n > 1 else 1.0
    order, (_, ratio, fitted) = 2, (0.0, 1e-2, max(least_sd, 1e-12) ** 2)
    if pieces:
        fits = {order: _best(pieces, order, typical) for order in (2, 3)}
        order, (_, ratio, fitted) = max(fits.items(), key=lambda item: item[1][0])
    variance = max(fitted, least_sd**2)
    power = ratio * fitted / typical ** (2 * order - 1)
    for a, b in segments:
        for i in range(d):
            row = values[i, a:b]
            if np.isnan(row).all():
                continue
            start = _start(order, variance, typical)
            means, covariances, innovations, expected = kalman(
                times[a:b], row, variance * weights[a:b], power, order, start
            )
            means, covariances = rts(times[a:b], means, covariances, power, order)
            out["position"][i, a:b] = means[:, 0]
            out["velocity"][i, a:b] = means[:, 1]
            out["position_sd"][i, a:b] = np.sqrt(np.maximum(covariances[:, 0, 0], 0))
            out["velocity_sd"][i, a:b] = np.sqrt(np.maximum(covariances[:, 1, 1], 0))
            normalised = innovations / np.sqrt(expected)
            normalised[np.flatnonzero(~np.isnan(normalised))[:order]] = np.nan
            out["innovation"][i, a:b] = normalised
    noise = (variance, power, order)
    for a, b in segments:
        for i, row in enumerate(values):
            for first, last in a + runs(np.isnan(row[a:b])):
                factor = _gap_factor(times, row, weights, out["position"][i], int(last - first), noise)
                out["position_sd"][i, first:last] *= factor
                out["velocity_sd"][i, first:last] *= factor
    sd = float(np.sqrt(variance))
    return Smoothed(**out, measurement_sd=sd, process_noise=float(power), order=order)


def warm_up() -> None:
    """Compile the kernels of this module."""
    times, ones = np.arange(3.0), np.ones(3)
    for order in (2, 3):
        means, covariances = kalman(times, ones, ones, 1.0, order, np.eye(order))[:2]
        rts(times, means, covariances, 1.0, order)
