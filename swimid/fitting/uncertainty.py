"""Noise model and uncertainty of a fit: residual tests, covariance of estimates, and identifiability.

The error of a measured value has one of three forms. It is constant, it has a known shape times an unknown
factor, or (with uncertain time stamps) it includes the speed times the error of the time stamp. The residuals
divided by the standard deviation of the error follow an autoregression.

The tests are functions of arrays. A residual series is one array at a constant sampling rate, in which NaN
marks missing samples. Several trials are joined with NaN between them (:func:`join_series`). A pair of
samples counts only if both exist, so that gaps do not bias a test. The tests of statsmodels use the same
formulas, but count all samples. With a fifth of the samples missing, the Ljung-Box test of statsmodels
rejects 0.8 % of white series at the 5 % level. The test of this module rejects 5.4 %.

References
----------
.. [1] G. M. Ljung, G. E. P. Box, "On a measure of lack of fit in time series models",
   Biometrika 65 (1978), 297-303. doi:10.1093/biomet/65.2.297
.. [2] L. Ljung, "System Identification: Theory for the User", 2nd ed. (1999), section 16.6.
.. [3] W. K. Newey, K. D. West, "A simple, positive semi-definite, heteroskedasticity and
   autocorrelation consistent covariance matrix", Econometrica 55 (1987), 703-708.
   doi:10.2307/1913610
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy import optimize, special
from scipy.linalg import matmul_toeplitz, toeplitz
from scipy.sparse import csgraph

from swimid.fitting.model import Array
from swimid.fitting.problem import Blocks, Problem
from swimid.results import numbers

if TYPE_CHECKING:
    from swimid.fitting.output_error import FitResult


def weigh_first(problem: Problem) -> None:
    """Set the sample weights of a problem before the noise is estimated.

    The assumed noise of a channel is 1 % of its standard deviation, or the known shape of its error.
    """
    for k, trial in enumerate(problem.trials):
        for i, channel in enumerate(problem.channels[k]):
            values = trial.measured[channel]
            problem.sd[k][i] = np.full(len(values), 0.01 * (float(np.nanstd(values)) or 1.0))
            known = np.asarray(trial.value_sd.get(channel, 0.0), dtype=float)
            if np.any(known > 0):
                problem.sd[k][i] = np.broadcast_to(known, values.shape).copy()


def estimate_noise(
    problem: Problem,
    theta: Array,
    previous: dict[str, tuple[float, float]],
    levels: Mapping[tuple[int, str], Array] = MappingProxyType({}),
) -> dict[str, tuple[float, float]]:
    """Estimate the errors of measured values and of time stamps, and set the sample weights of a problem.

    Parameters
    ----------
    theta : ndarray, shape (p,)
        Unknowns at which the residuals are computed.
    previous : dict of channel name to (float, float)
        Standard deviations of the previous noise iteration; empty in the first iteration.
    levels : mapping of (trial index, channel) to ndarray, shape (n,)
        Local levels of the noise: relative standard deviations of the samples.

    Returns
    -------
    dict of channel name to (value, stamp)
        Standard deviation of the values in the unit of the channel, and of the time stamps in s. If the shape
        of the error is known, the first value is a factor that is applied to this shape.
    """
    found: dict[str, tuple[float, float]] = {}
    simulations = problem.simulations(theta)
    for channel, owners in _owners(problem).items():
        errors, rates, shapes = [], [], []
        for k in owners:
            trial, simulated = problem.trials[k], simulations[k][channel]
            rate = np.zeros_like(simulated)
            if trial.stamps_uncertain or np.any(trial.time_sd_s):
                rate = np.abs(problem.model.sensitivity_to_time(problem.vector(theta, k), trial)[channel])
            errors.append(trial.measured[channel] - simulated)
            rates.append(rate)
            known = np.hypot(trial.value_sd.get(channel, 0.0), trial.time_sd_s * rate)
            shapes.append(levels.get((k, channel), known))
        uncertain = [float(problem.trials[k].stamps_uncertain) for k in owners]
        stamped = [free * rate for free, rate in zip(uncertain, rates, strict=True)]
        constant, stamp = _components(errors, stamped, shapes, any(uncertain), previous.get(channel))
        found[channel] = (constant, stamp)
        for k, shape, rate in zip(owners, shapes, stamped, strict=True):
            sd = np.hypot(constant, stamp * rate)
            if np.any(shape > 0):
                sd = np.maximum(shape, 0.05 * np.median(shape)) * (constant or 1e-15)
            largest = np.nanmax(np.abs(problem.trials[k].measured[channel]))
            problem.sd[k][problem.channels[k].index(channel)] = np.maximum(sd, 1e-12 * max(1e-6, largest))
    return found


def _owners(problem: Problem) -> dict[str, list[int]]:
    """Return for each channel the indices of the trials that have samples of it."""
    names = sorted({c for channels in problem.channels for c in channels})
    return {c: [k for k, channels in enumerate(problem.channels) if c in channels] for c in names}


def _components(
    errors: list[Array],
    rates: list[Array],
    shapes: list[Array],
    uncertain: bool,
    previous: tuple[float, float] | None,
) -> tuple[float, float]:
    """Return the standard deviations of the errors of values and of time stamps in one channel.

    If the shape of the error is known, the first result is the factor that is applied to this shape. The
    ``rates`` are zero in trials with exact time stamps.
    """
    r, rate, shape = (np.concatenate(parts) for parts in (errors, rates, shapes))
    there = np.isfinite(r)
    if np.any(shape > 0):
        floor = np.where(shape > 0, np.maximum(shape, 0.05 * np.median(shape[shape > 0])), 1.0)
        return float(np.sqrt(np.mean((r / floor)[there] ** 2))), 0.0
    square, rate2 = r[there] ** 2, rate[there] ** 2
    mean = float(np.mean(square))
    if not uncertain:
        return math.sqrt(mean), 0.0
    variance = np.full(len(square), max(mean, 1e-300))
    if previous is not None:
        variance = np.maximum(previous[0] ** 2 + previous[1] ** 2 * rate2, 1e-3 * variance)
    design = np.column_stack((np.ones_like(rate2), rate2)) / variance[:, None]
    norm = np.linalg.norm(design, axis=0)
    norm[norm == 0] = 1.0
    value, stamp = optimize.nnls(design / norm, square / variance)[0] / norm
    # Keep the variance of the values above zero, because a sample without error would outweigh all others.
    return math.sqrt(max(float(value), 1e-4 * mean)), math.sqrt(max(float(stamp), 0.0))


def value_sd(problem: Problem, channel: str, constant: float) -> float:
    """Return the noise level of a channel: root mean square of the standard deviations of its samples.

    With uncertain time stamps, return ``constant``, the standard deviation of the measured values without the
    error of the time stamps.
    """
    owners = _owners(problem)[channel]
    if any(problem.trials[k].stamps_uncertain for k in owners):
        return constant
    squares = []
    for k in owners:
        i = problem.channels[k].index(channel)
        squares.append(np.mean(problem.sd[k][i][problem.masks[k][i]] ** 2))
    return float(np.sqrt(np.mean(squares)))


def autoregressions(problem: Problem, residuals: list[Array]) -> dict[str, Array]:
    """Fit an autoregression to the weighted residuals of each channel over all trials.

    The result has the coefficients by channel. They are empty for white residuals.
    """
    return {channel: fit_joint(series) for channel, series in problem.series(residuals).items()}


# ---------------------------------------------------------------- tests of residuals


#: Minimum p-value at which a residual series counts as white, or as independent of an input.
SIGNIFICANCE = 0.01


@dataclass(frozen=True)
class SeriesCorrelation:
    """Autocorrelation function of a series, with the confidence band of white noise.

    Each field has the shape (m,) for m lags.
    """

    #: Lags in samples.
    lags: np.ndarray
    #: Correlation coefficient of the series with itself at each lag; NaN if no pair of samples exists.
    values: np.ndarray
    #: Half-width of the 95 % confidence band around zero.
    bound: np.ndarray
    #: Number of sample pairs for each lag.
    pairs: np.ndarray


@dataclass(frozen=True)
class TestResult:
    """Result of a chi-square test of residuals."""

    __test__ = False  # not a pytest class

    statistic: float
    #: Number of degrees of freedom: the mean of the statistic under the null hypothesis.
    degrees: float
    #: Probability of a statistic at least this large under the null hypothesis.
    p_value: float

    @property
    def is_passed(self) -> bool:
        """Whether the test does not reject the null hypothesis at the level :data:`SIGNIFICANCE`."""
        return self.p_value >= SIGNIFICANCE


def join_series(parts: Sequence[np.ndarray], *, gap: int) -> np.ndarray:
    """Join several series with ``gap`` samples of NaN between them.

    ``gap`` must be at least the largest lag that is used.

    >>> join_series([np.array([1.0]), np.array([2.0])], gap=2)
    array([ 1., nan, nan,  2.])
    """
    apart = [piece for part in parts for piece in (np.full(gap, np.nan), np.asarray(part, dtype=float))]
    return np.concatenate(apart[1:]) if apart else np.empty(0)


def default_lags(samples: int) -> int:
    """Return the number of lags for a residual test: a fifth of the number of samples, but at most 25."""
    return max(1, min(25, samples // 5))


def _centre(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return a copy of x without its mean and with zeros for NaN, and a mask of the finite samples."""
    x = np.asarray(x, dtype=float)
    there = np.isfinite(x)
    return np.where(there, x - np.sum(x[there]) / max(np.count_nonzero(there), 1), 0.0), there


def _compute_lag_means(
    x: np.ndarray, x_there: np.ndarray, y: np.ndarray, y_there: np.ndarray, lags: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the mean of x(k) y(k - lag) over existing sample pairs, and their number, for each lag."""
    n = len(x)
    means = np.full(len(lags), np.nan)
    pairs = np.zeros(len(lags), dtype=int)
    for i, lag in enumerate(lags):
        if lag < n:
            now, then = slice(lag, n), slice(0, n - lag)
            pairs[i] = np.count_nonzero(x_there[now] & y_there[then])
            means[i] = np.dot(x[now], y[then]) / (pairs[i] or np.nan)
    return means, pairs


def autocorrelation(x: np.ndarray, *, max_lag: int | None = None) -> SeriesCorrelation:
    """Compute the autocorrelation at lags 0 .. max_lag, and the confidence band of white noise.

    The band is ``1.96 / sqrt(pairs)``. The value at a lag is the mean over the sample pairs of this lag,
    because the number of pairs differs if there are gaps.

    Parameters
    ----------
    x : ndarray, shape (n,)
        Series; NaN for missing samples. The mean is removed. The result is NaN for a constant series.
    max_lag : int, optional
        Largest lag. The default is :func:`default_lags`.

    >>> autocorrelation(np.array([1.0, -1.0] * 50), max_lag=2).values.round(6)
    array([ 1., -1.,  1.])
    """
    values, there = _centre(x)
    count = int(np.count_nonzero(there))
    if max_lag is None:
        max_lag = default_lags(count)
    lags = np.arange(max_lag + 1)
    means, pairs = _compute_lag_means(values, there, values, there, lags)
    variance = means[0] if means[0] > 0 else np.nan
    return SeriesCorrelation(lags, means / variance, 1.96 / np.sqrt(np.maximum(pairs, 1)), pairs)


def count_absorbed(fitted: np.ndarray, tested: np.ndarray) -> float:
    """Return the number of tested regressors that a fit has made orthogonal to its residuals.

    A regression removes from the residuals what its own regressors explain. A test of whether the residuals
    depend on other regressors loses a degree of freedom only as far as the fitted regressors explain the
    tested ones.

    Parameters
    ----------
    fitted, tested : ndarray, shape (n, p) and (n, m)
        Regressors of the fit and of the test. A row with NaN is left out.

    Returns
    -------
    float
        Sum of the squared canonical correlations, between 0 and min(p, m). The part that is due to chance is
        subtracted, as in the adjusted coefficient of determination.

    Notes
    -----
    For least squares with the regressors H, the residuals ``(I - H (H'H)^-1 H') e`` have the covariance
    ``sigma^2 (V'V - V'H (H'H)^-1 H'V)`` with the tested regressors V. The mean of the chi-square statistic of
    V is the trace of that matrix relative to ``sigma^2 V'V``. Pure autoregressions lose one degree of freedom
    for each coefficient [1]_. A model whose input explains the output loses fewer.
    """
    there = np.isfinite(fitted).all(axis=1) & np.isfinite(tested).all(axis=1)
    n, (p, m) = int(np.count_nonzero(there)), (fitted.shape[1], tested.shape[1])
    if n <= p + m:
        return float(min(p, m))
    bases = []
    for columns in (fitted[there], tested[there]):
        left, singular, _ = np.linalg.svd(
            columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300), False
        )
        bases.append(left[:, singular > 1e-6 * singular[0]])
    common = float(np.sum((bases[0].T @ bases[1]) ** 2))
    chance = bases[0].shape[1] * bases[1].shape[1] / n
    limit = min(base.shape[1] for base in bases)
    return float(np.clip((common - chance) / (1.0 - max(base.shape[1] for base in bases) / n), 0.0, limit))


def lag_matrix(x: np.ndarray, lags: Sequence[int]) -> np.ndarray:
    """Return the samples of a series shifted by each of m lags, shape (n, m); 0 for missing samples."""
    x = np.where(np.isfinite(x), x, 0.0)
    return np.column_stack([np.concatenate((np.zeros(lag), x[: len(x) - lag])) for lag in lags])


def ljung_box(x: np.ndarray, *, lags: int | None = None, fitted: float = 0.0) -> TestResult:
    """Test a series for whiteness (Ljung-Box).

    Parameters
    ----------
    x : ndarray, shape (n,)
        Residuals; NaN for missing samples.
    lags : int, optional
        Number of lags that are tested together. The default is :func:`default_lags`.
    fitted : float
        Number of degrees of freedom that are lost because parameters were estimated from the same data. It is
        the number of coefficients of a pure autoregressive or moving-average model, and follows from
        :func:`count_absorbed` for other models.

    Returns
    -------
    TestResult
        The p-value is 1 for a series that is constant or shorter than two samples.

    Notes
    -----
    Without gaps the statistic is ``n (n + 2) sum r_k^2 / (n - k)`` of [1]_. With gaps, ``n - k`` is replaced
    by the number of sample pairs at lag k, and r_k is the mean product of these pairs.

    The statistic of m lags of white noise has the mean m and the variance ``2 m (1 + 2 (m - 3) / n)`` to the
    first order in 1 / n, because two squared autocorrelations ``n r^2`` have the covariance ``4 / n``. The
    p-value is that of a multiple of a chi-square variable with this mean and variance. The chi-square
    distribution itself rejects 2.4 % of white series of 150 samples at the 1 % level.
    """
    correlation = autocorrelation(x, max_lag=lags)
    n = int(correlation.pairs[0]) if len(correlation.pairs) else 0
    r, pairs = correlation.values[1:], correlation.pairs[1:]
    use = np.isfinite(r) & (pairs > 0)
    degrees = max(int(np.count_nonzero(use)) - fitted, 1.0)
    if n < 2 or not np.any(use):
        return TestResult(0.0, degrees, 1.0)
    statistic = (n + 2) / n * float(np.sum(pairs[use] * r[use] ** 2))
    excess = 1.0 + 2.0 * max(int(np.count_nonzero(use)) - 3, 0) / n
    return TestResult(statistic, degrees, float(special.chdtrc(degrees / excess, statistic / excess)))


def independence(
    residuals: np.ndarray,
    source: np.ndarray,
    *,
    lags: int | None = None,
    first: int = 0,
    fitted: float = 0.0,
) -> TestResult:
    """Test the independence of residuals from the past of an input (source), with a chi-square statistic.

    Parameters
    ----------
    residuals, source : ndarray, shape (n,)
        Series at the same sampling rate; NaN for missing samples.
    lags : int, optional
        Number of lags that are tested together, ``first`` to ``first + lags - 1``. The default is
        :func:`default_lags`.
    fitted : float
        Number of degrees of freedom that are lost because parameters were estimated from the same data
        (:func:`count_absorbed`).

    Returns
    -------
    TestResult
        Result of the test. Without ``fitted`` the number of degrees of freedom is the numerical rank of the
        covariance matrix of the source. It is two for a single sine, for any number of lags.

    Notes
    -----
    The statistic is ``n r' P^-1 r`` with ``P = sum_j R_e(j) R_u(j)`` ([2]_, section 16.6). The vector r has
    the cross-covariances, and R_u(j) is the shifted Toeplitz covariance matrix of the source. Residual
    covariances inside the confidence band of white noise are set to zero.
    """
    e, e_there = _centre(residuals)
    u, u_there = _centre(source)
    top = default_lags(int(np.count_nonzero(e_there)))
    number = lags or top
    means, pairs = _compute_lag_means(e, e_there, u, u_there, np.arange(first, first + number))
    if not np.all(pairs) or not e.any() or not u.any():
        return TestResult(0.0, number, 1.0)
    re = autocorrelation(residuals, max_lag=top)
    covariances = np.nan_to_num(_compute_lag_means(u, u_there, u, u_there, np.arange(number + top))[0])
    power = float(np.mean(e[e_there] ** 2))
    matrix = np.zeros((number, number))
    for j in range(-top, top + 1):
        r = re.values[abs(j)]
        if j and not abs(r) > re.bound[abs(j)]:
            continue
        index = np.abs(np.arange(-(number - 1), number) + j)
        column, row = covariances[index[number - 1 :]], covariances[index[number - 1 :: -1]]
        matrix += power * r * toeplitz(column, row)
    matrix = (matrix + matrix.T) / 2
    eigenvalues, vectors = np.linalg.eigh(matrix)
    keep = eigenvalues > 1e-6 * eigenvalues[-1]
    projected = vectors.T @ (means * np.sqrt(pairs))
    if not keep.any():
        return TestResult(0.0, number, 1.0)
    degrees = max(int(np.count_nonzero(keep)) - fitted, 1.0)
    statistic = float(np.sum(projected[keep] ** 2 / eigenvalues[keep]))
    return TestResult(statistic, degrees, float(special.chdtrc(degrees, statistic)))


def fit_joint(parts: Sequence[np.ndarray]) -> np.ndarray:
    """Fit one autoregression to the series of several trials, and return its coefficients.

    The result is empty if the series are white, or shorter than 12 samples together.
    """
    x = join_series(parts, gap=30)
    if np.isfinite(x).sum() < 12 or not np.nanstd(x) > 0:
        return np.empty(0)
    return fit_autoregression(x, max_order=default_lags(max(map(len, parts))))


def fit_autoregression(x: np.ndarray, *, max_order: int | None = None) -> np.ndarray:
    """Fit an autoregression to all segments of a series by Burg's method, whose results are always stable.

    The autoregression is ``x(k) + a1 x(k-1) + ... + ap x(k-p) = e(k)`` with white noise e.

    Parameters
    ----------
    x : ndarray, shape (n,)
        Series; NaN for missing samples. The mean is removed.
    max_order : int, optional
        Largest order; the default is :func:`default_lags`. The BIC selects the order.

    Returns
    -------
    ndarray, shape (p,)
        Coefficients a1 to ap; empty for a white series.

    Raises
    ------
    ValueError
        If fewer than three samples are finite.
    """
    values, there = _centre(x)
    n = int(np.count_nonzero(there))
    if n < 3:
        raise ValueError(f"an autoregression needs at least three finite samples, not {n}")
    top = min(max_order or default_lags(n), n - 2)
    stretches = np.ma.clump_unmasked(np.ma.masked_array(values, ~there))
    pairs = [(values[part], values[part]) for part in stretches]
    # Store the variance of the innovation and the coefficients of each order.
    fits = [(float(np.mean(values[there] ** 2)), np.empty(0))]
    for _ in range(top):
        pairs = [(f[1:], b[:-1]) for f, b in pairs]
        under = sum(float(np.dot(f, f) + np.dot(b, b)) for f, b in pairs)
        if not 0 < under < math.inf:
            break
        reflection = -2.0 * sum(float(np.dot(f, b)) for f, b in pairs) / under
        variance, a = fits[-1]
        a = np.concatenate((a + reflection * a[::-1], [reflection]))
        pairs = [(f + reflection * b, b + reflection * f) for f, b in pairs]
        fits.append((variance * max(1.0 - reflection**2, 0.0), a))
    tiny = np.finfo(float).tiny
    criteria = [n * np.log(max(variance, tiny)) + np.log(n) * len(a) for variance, a in fits]
    return fits[int(np.argmin(criteria))][1]


def long_run_covariance(scores: np.ndarray) -> np.ndarray:
    """Estimate the covariance matrix of a sum of correlated vectors (Newey and West).

    Parameters
    ----------
    scores : ndarray, shape (n, p)
        Row k is the regressor times the residual at sample k. A row with NaN is a gap.

    Returns
    -------
    ndarray, shape (p, p)
        Matrix ``M = G_0 + sum_l (1 - l / (L + 1)) (G_l + G_l')`` with ``G_l = sum_k s_k s_(k-l)'`` [3]_. It
        is positive semi-definite. If J is the derivative of the model and J'J is invertible, the covariance
        of a least-squares estimate is ``(J'J)^-1 M (J'J)^-1``. The bandwidth L of the Bartlett window is
        ``floor(4 (n / 100)^(2/9))``. It is at least twice the largest lag with significant correlation of the
        scores.
    """
    scores = np.atleast_2d(np.asarray(scores, dtype=float))
    there = np.all(np.isfinite(scores), axis=1)
    n = int(np.count_nonzero(there))
    memory = 0
    for column in np.where(there[:, None], scores, np.nan).T:
        correlation = autocorrelation(column)
        outside = np.abs(correlation.values[1:]) > correlation.bound[1:]
        memory = max(memory, int(np.argmin(np.append(outside, False))))
    lags = max(int(4 * (max(n, 1) / 100) ** (2 / 9)), 2 * memory)
    rows = np.where(there[:, None], scores, 0.0)
    covariance = rows.T @ rows
    for lag in range(1, min(lags, max(len(rows) - 1, 0)) + 1):
        lagged = rows[lag:].T @ rows[:-lag]
        covariance += (1.0 - lag / (lags + 1.0)) * (lagged + lagged.T)
    return covariance


# ---------------------------------------------------------------- covariance of the estimates


def _autocorrelation(coefficients: Array, lags: int) -> Array:
    """Return the autocorrelation of an autoregression at lags 0 .. lags, shape (lags + 1,)."""
    from scipy.signal import lfilter

    # Compute the autocorrelation of the impulse response of 1 / A. The response must be long enough to decay.
    length = lags + 1 + min(20000, max(2000, 10 * lags))
    response = lfilter([1.0], np.concatenate(([1.0], coefficients)), np.eye(1, length)[0])
    spectrum = np.fft.rfft(response, 2 * length)
    covariance = np.fft.irfft(np.abs(spectrum) ** 2)[: lags + 1]
    return np.asarray(covariance / covariance[0])


def _correlate_rows(problem: Problem, rows: list[Array], autoregressions: dict[str, Array]) -> list[Array]:
    """Return derivatives of each trial multiplied by the correlation matrix of the trial's residuals.

    The correlation follows from the autoregression of each channel. Rows of the derivatives after the samples
    of a trial belong to random effects. Random effects are uncorrelated, so that these rows stay unchanged.
    """
    longest = max(len(t.time_s) for t in problem.trials)
    rho = {c: _autocorrelation(a, longest - 1) for c, a in autoregressions.items() if len(a)}
    products = []
    for k, whole in enumerate(rows):
        product, end = whole.copy(), 0
        for channel, mask, part in problem.by_channel(k, whole):
            begin, end = end, end + len(part)
            if channel in rho:
                even = np.zeros((len(mask), whole.shape[1]))
                even[mask] = part
                product[begin:end] = matmul_toeplitz(rho[channel][: len(mask)], even)[mask]
        products.append(product)
    return products


def orthogonal_part(others: Array, columns: Array, floor: float) -> Array:
    """Return the component of ``columns`` that is orthogonal to all combinations of ``others``.

    Directions of ``others`` with a singular value below ``floor`` times the largest one are ignored.
    """
    u, singular, _ = np.linalg.svd(others, full_matrices=False)
    seen = u[:, singular > floor * singular.max(initial=0.0)]
    return np.asarray(columns - seen @ (seen.T @ columns))


@dataclass(frozen=True)
class Sandwich:
    """Covariance of least-squares estimates by the sandwich formula, with intermediate quantities."""

    #: Covariance ``H^-1 M H^-1``, shape (p, p). Rows and columns of parameters that do not affect the
    #: residuals are NaN.
    covariance: Array
    #: Mask of the parameters that do not affect the residuals, shape (p,).
    null: NDArray[np.bool_]
    #: Square root of the information matrix, shape (p, p): ``root' root`` is the inverse of the covariance.
    #: It is accurate even if the covariance is infinite.
    root: Array
    #: Gauss-Newton step from the estimates to the minimum without bounds, shape (p,).
    step: Array
    #: Mean decrease of the sum of squared residuals for each parameter that is fitted to noise alone. It is 1
    #: for white noise of unit variance, and larger for coloured noise.
    gain: float


def sandwich(
    problem: Problem,
    blocks: Blocks,
    residuals: list[Array],
    autoregressions: dict[str, Array],
) -> Sandwich:
    """Compute the covariance of estimates under coloured residuals.

    Parameters
    ----------
    blocks, residuals : Blocks and list of ndarray, each shape (n_k,)
        Weighted derivatives and residuals of each trial. Columns are scaled to parameters of similar size.
    autoregressions : dict of channel name to ndarray
        Coefficients of the autoregression of the weighted residuals.

    Notes
    -----
    With the singular value decomposition ``J = U S V'`` the middle factor ``U' R U`` is computed from the
    orthogonal matrix U. A direction that the data hardly determine then has a large variance, and not a small
    variance that is only rounding error. The derivatives of each trial are replaced by their triangular
    factor first, because few unknowns affect each of many trials.
    """
    samples, unknowns = blocks.shape
    squares = np.zeros(unknowns)
    for _, at, part in blocks.parts:
        squares[at] += np.sum(part**2, axis=0)
    null = squares == 0
    size = np.sqrt(np.where(null, 1.0, squares))
    bases, factors = blocks.factorise(1.0 / size)
    u, singular, vt = np.linalg.svd(np.concatenate(factors), full_matrices=False)
    good = (singular > 1e-8 * singular[0]) & (singular[0] > 0)
    # A parameter that takes part in an undetermined direction is not identifiable.
    null |= (np.abs(vt[~good]) > 1e-3).any(axis=0)
    coloured = _correlate_rows(problem, bases, autoregressions)
    cores = [basis.T @ part for basis, part in zip(bases, coloured, strict=True)]
    projected = [basis.T @ r for basis, r in zip(bases, residuals, strict=True)]
    directions = np.split(u, np.cumsum([len(f) for f in factors])[:-1])
    variance = float(sum(r @ r for r in residuals)) / max(samples - unknowns, 1)
    middle = u.T @ np.concatenate([core @ part for part, core in zip(directions, cores, strict=True)])
    middle = 0.5 * (middle + middle.T)
    spread = math.sqrt(variance)
    values, vectors = np.linalg.eigh(middle)
    values = np.maximum(values, 1e-9 * values.max(initial=1e-300))
    outer = vt[good].T / singular[good] / size[:, None]
    covariance = spread**2 * outer @ middle[np.ix_(good, good)] @ outer.T
    covariance[null] = covariance[:, null] = np.nan
    return Sandwich(
        covariance=0.5 * (covariance + covariance.T),
        null=null,
        root=(vectors / np.sqrt(values)).T @ (singular[:, None] * vt * size) / max(spread, 1e-30),
        step=-outer @ (u[:, good].T @ np.concatenate(projected)),
        # The gain is the mean of r' U U' r for noise r with the correlation R, divided by the number of
        # columns of U.
        gain=spread**2 * float(np.trace(middle[np.ix_(good, good)])) / max(int(good.sum()), 1),
    )


# ---------------------------------------------------------------- identifiability


#: Maximum standard error of an identifiable parameter, as a fraction of its magnitude. The magnitude is the
#: absolute value of the estimate, or the typical scale of the parameter if that is larger.
UNIDENTIFIABLE = 0.5
#: Minimum singular value of a direction in parameter space that the data determine, as a fraction of the
#: largest singular value.
UNSEEN = 1e-7
#: Minimum standard error of a parameter in a group of confounded parameters, as a fraction of its magnitude.
VAGUE = 0.5 * UNIDENTIFIABLE
#: Maximum number of confounded parameters in a group whose known weighted sum the report states. A sum of
#: more parameters is hard to read.
MAX_GROUP_NAMES = 6
#: Minimum weight of a parameter that is shown in a known weighted sum of parameters, as a fraction of the
#: largest weight.
NEGLIGIBLE = 0.01


@dataclass(frozen=True)
class Combination:
    """Weighted sum of parameters that the trials determine, although they do not determine each parameter."""

    #: Weight of each label, divided by the largest weight. If the units of the parameters differ, these are
    #: weights of the parameters divided by their :attr:`divisors`.
    weights: dict[str, float]
    #: Labels of all parameters in the confounded group, including those of negligible weight.
    members: tuple[str, ...]
    value: float
    stderr: float
    #: Unit of the sum: that of the parameter whose weight is 1, or ``"1"`` if units differ.
    unit: str
    #: Magnitude of each parameter, with its unit, by which the parameter is divided. Empty if all units are
    #: equal.
    divisors: dict[str, str] = field(default_factory=dict)

    @property
    def text(self) -> str:
        """Weighted sum as text, such as ``c_f0 + 0.31 c_f13 = 0.0123 ± 0.0002``."""
        terms = ""
        for label, weight in self.weights.items():
            if label in self.divisors:
                label = f"{label}/({self.divisors[label]})"
            factor = f"{abs(weight):.2g} ".removeprefix("1 ")
            terms += f"{' - ' if weight < 0 else ' + '}{factor}{label}"
        terms = f"{terms[1]}{terms[3:]}".removeprefix("+")
        return f"{terms} = {numbers.format_estimate(self.value, self.stderr, self.unit)}"


def unidentifiable(result: FitResult) -> list[str]:
    """Return the labels of the parameters of a fit that the trials do not determine."""
    return [label for label in result.labels if result.status[label] == "unidentifiable"]


def find_confounded(result: FitResult) -> list[tuple[str, ...]]:
    """Return groups of parameters whose separate effects the trials do not determine.

    At least one parameter of a group is not identifiable, and at least one is shared by all trials. The
    members take part in the same undetermined combination, and each has a standard error above :data:`VAGUE`
    of its magnitude. Parameters that do not affect the residuals are in no group.
    """
    if len(usable := _usable(result)) < 2:
        return []
    _, singular, vt = np.linalg.svd((result.information_root * _sizes(result))[:, usable])
    # If the matrix has fewer rows than columns, it has no information on the remaining directions.
    singular = np.pad(singular, (0, len(vt) - len(singular)))
    floor = np.maximum(singular, UNSEEN * singular.max(initial=0.0) + 1e-150)
    errors = np.linalg.norm(vt / floor[:, None], axis=0)
    vague = [i for i, error in zip(usable, errors, strict=True) if error > VAGUE]
    if len(vague) < 2:
        return []
    _, singular, vt = np.linalg.svd(_marginal(result, vague))
    dark = vt[singular * UNIDENTIFIABLE < 1.0]
    overlap = np.abs(dark.T @ dark) > 0.02
    _, numbers = csgraph.connected_components(overlap, directed=False)
    groups = [
        tuple(result.labels[i] for i, g in zip(vague, numbers, strict=True) if g == n) for n in set(numbers)
    ]
    unknown = set(unidentifiable(result))
    groups = [g for g in groups if len(g) > 1 and unknown & set(g) and any("[" not in label for label in g)]
    return sorted(groups, key=lambda g: result.labels.index(g[0]))


def combinations(result: FitResult) -> list[Combination]:
    """Return for each group of confounded parameters the weighted sum that the trials determine best.

    A group without a known sum is left out. The sum is the leading eigenvector of the information matrix of
    the group. For this matrix all other parameters are free, and all parameters are divided by their
    magnitudes.
    """
    found = []
    for group in find_confounded(result):
        index = [result.labels.index(label) for label in group]
        size = _sizes(result)[index]
        _, singular, vt = np.linalg.svd(_marginal(result, index), full_matrices=False)
        if singular[0] * UNIDENTIFIABLE < 1.0:
            continue
        kept = np.where(np.abs(vt[0]) < NEGLIGIBLE * np.abs(vt[0]).max(), 0.0, vt[0])
        direction = vt[0]
        if _sd(kept, singular, vt) * singular[0] <= 1.1:
            direction = kept
        units = [result.parameter(g).unit for g in group]
        unit, counted, divisors = units[0], np.ones(len(group)), {}
        if len(set(units)) > 1:
            # Divide each parameter by its rounded magnitude, so that a reader can compute the sum from the
            # text.
            unit, short = "1", [f"{s:.2g}" for s in size]
            words = [f"{t} {u}".removesuffix(" 1") for t, u in zip(short, units, strict=True)]
            counted, divisors = np.array([float(t) for t in short]), dict(zip(group, words, strict=True))
        weights = direction * counted / size
        one = float(weights[np.argmax(np.abs(weights))])
        weights /= one
        found.append(
            Combination(
                weights={g: float(w) for g, w in zip(group, weights, strict=True) if w != 0},
                members=group,
                value=float(weights @ (result.estimate[index] / counted)),
                stderr=_sd(direction, singular, vt) / abs(one),
                unit=unit,
                divisors=divisors,
            )
        )
    return found


def sentences(result: FitResult) -> list[str]:
    """Return sentences for the report on parameters that are not identifiable and on their known sums."""
    known = {c.members: f", which determine only {c.text}" for c in combinations(result)}
    said, grouped = [], set()
    for group in find_confounded(result):
        grouped |= set(group)
        named, rest = list(group), known.get(group, ", which determine no sum of these parameters")
        if len(group) > MAX_GROUP_NAMES:
            # A sum of many terms is not readable. The parameter file has their correlations.
            named, rest = [label for label in group if "[" not in label], ""
            if len(named) < len(group):
                named.append(f"{len(group) - len(named)} parameters of single trials")
        said.append(f"{numbers.join_names(named)} cannot be separated by these trials{rest}")
    trials: dict[str, list[str]] = {}
    for label in (label for label in unidentifiable(result) if label not in grouped):
        name, _, trial = label.partition("[")
        trials.setdefault(name, []).append(trial.rstrip("]"))
    # Sentences on parameters of single trials come first.
    for name, places in sorted(trials.items(), key=lambda item: item[1] == [""]):
        where = "from these trials" if places == [""] else f"in {', '.join(places)}"
        said.append(f"{name} is not identifiable {where}")
    return said


def _sizes(result: FitResult) -> Array:
    """Return the magnitude of each parameter: absolute estimate, or typical scale if that is larger."""
    return np.maximum(np.abs(result.estimate), [result.parameter(label).scale for label in result.labels])


def _usable(result: FitResult) -> list[int]:
    """Return the indices of the parameters of a fit that no bound holds.

    The result is empty if the fit has no information matrix.
    """
    if result.information_root.shape[1] != len(result.labels):
        return []
    return [int(i) for i in np.flatnonzero(np.isfinite(result.information_root).all(axis=0))]


def _marginal(result: FitResult, index: Sequence[int]) -> Array:
    """Return a square root of the information matrix of some parameters of a fit, with all others free.

    The parameters are divided by their magnitudes.
    """
    scaled = result.information_root * _sizes(result)
    others = [i for i in _usable(result) if i not in index]
    chosen = scaled[:, list(index)]
    return orthogonal_part(scaled[:, others], chosen, UNSEEN) if others else chosen


def _sd(direction: Array, singular: Array, vt: Array) -> float:
    """Return the standard error of a weighted sum of scaled parameters with weights ``direction``.

    The information matrix of the parameters is ``vt' s^2 vt`` with the singular values s.
    """
    parts = vt @ direction
    floor = np.maximum(singular, UNSEEN * singular[0])
    return float(np.linalg.norm(parts / floor))
