"""Covariance of output-error estimates under coloured residuals and scattering trials."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import special
from scipy.linalg import matmul_toeplitz

from swimid.fitting.model import Array
from swimid.fitting.problem import Problem

#: Trials are called inconsistent below this p-value.
HETEROGENEITY = 1e-3


def _autocorrelation(coefficients: Array, lags: int) -> Array:
    """Autocorrelation of an autoregression at lags 0 .. lags, shape (lags + 1,)."""
    if len(coefficients) == 0:
        return np.eye(1, lags + 1)[0]
    from scipy.signal import lfilter

    # impulse response of 1 / A, long enough to have died out, correlated with itself
    length = lags + 1 + min(20000, max(2000, 10 * lags))
    response = lfilter([1.0], np.concatenate(([1.0], coefficients)), np.eye(1, length)[0])
    spectrum = np.fft.rfft(response, 2 * length)
    covariance = np.fft.irfft(np.abs(spectrum) ** 2)[: lags + 1]
    return np.asarray(covariance / covariance[0])


def _correlated(problem: Problem, rows: list[Array], autoregressions: dict[str, Array]) -> list[Array]:
    """R times the rows of each trial, R the residuals' correlation matrix under their autoregressions.

    Rows beyond a trial's samples, of random effects, are white.
    """
    longest = max(len(t.time_s) for t in problem.trials)
    rho = {c: _autocorrelation(a, longest - 1) for c, a in autoregressions.items()}
    products = []
    for k, whole in enumerate(rows):
        parts = []
        for channel, mask, part in problem.by_channel(k, whole):
            even = np.zeros((len(mask), whole.shape[1]))
            even[mask] = part
            if len(autoregressions[channel]):
                even = matmul_toeplitz(rho[channel][: len(mask)], even)
            parts.append(even[mask])
        products.append(np.concatenate([*parts, whole[sum(map(len, parts)) :]]))
    return products


def orthogonal_part(others: Array, columns: Array, floor: float) -> Array:
    """The part of columns orthogonal to all others: what no combination of those can imitate.

    Directions in which the others have less than the share ``floor`` of their largest are not counted.
    """
    u, singular, _ = np.linalg.svd(others, full_matrices=False)
    seen = u[:, singular > floor * singular.max(initial=0.0)]
    return np.asarray(columns - seen @ (seen.T @ columns))


@dataclass(frozen=True)
class Sandwich:
    """Covariance of least-squares estimates, and what it was made of."""

    #: Shape (p, p): ``H^-1 M H^-1``, enlarged by the square of the scatter factor; rows and columns of
    #: parameters the data do not see are NaN.
    covariance: Array
    #: Shape (p,): parameters the data do not see.
    null: NDArray[np.bool_]
    #: Shape (p, p): square root of the information: ``root' root`` is the inverse of the covariance, and
    #: stays accurate where that is singular.
    root: Array
    #: Shape (p,): the Gauss-Newton step from here to the minimum without bounds.
    step: Array
    #: Sum of squares that one parameter, fitted to noise alone, takes up on average: 1 for white noise of
    #: unit variance, and as much more as noise is coloured along the parameters and the trials scatter.
    gain: float
    #: At least 1.
    scatter: float
    #: Of the test that the trials agree: their scores, each zero on average at the common optimum, against
    #: their own covariance.
    scatter_p: float


def sandwich(
    problem: Problem, jacobians: list[Array], residuals: list[Array], autoregressions: dict[str, Array]
) -> Sandwich:
    """Covariance of the estimates under coloured residuals and scattering trials.

    Parameters
    ----------
    jacobians, residuals : list of ndarray, each shape (n_k, p) and (n_k,)
        Weighted, of each trial; columns scaled to parameters of like size.
    autoregressions : dict of channel name to ndarray
        Of the weighted residuals.

    Notes
    -----
    With ``J = U S V'`` the middle ``U' R U`` is computed from the orthogonal U, so that a
    direction the data hardly see has a large variance, not the rounding error of a small one.
    """
    j = np.concatenate(jacobians)
    samples, unknowns = j.shape
    size = np.linalg.norm(j, axis=0)
    null = size == 0
    size = np.where(null, 1.0, size)
    u, singular, vt = np.linalg.svd(j / size, full_matrices=False)
    good = singular > 1e-8 * singular[0] if singular[0] > 0 else np.zeros(len(singular), bool)
    # a parameter with a part in a direction the data do not see is not identifiable
    null |= (np.abs(vt[~good]) > 1e-3).any(axis=0)
    ends = np.cumsum([0, *(len(r) for r in residuals)])
    directions = [u[a:b] for a, b in itertools.pairwise(ends)]
    coloured = _correlated(problem, directions, autoregressions)
    r = np.concatenate(residuals)
    variance = float(r @ r) / max(samples - unknowns, 1)
    middle = np.sum([a.T @ b for a, b in zip(directions, coloured, strict=True)], axis=0)
    middle = 0.5 * (middle + middle.T)
    back = singular[:, None] * vt * size
    scatter, p_value = _scatter(
        jacobians, [b @ back for b in coloured], residuals, variance, degrees=-int(good.sum())
    )
    spread = scatter * math.sqrt(variance)
    values, vectors = np.linalg.eigh(middle)
    values = np.maximum(values, 1e-9 * values.max(initial=1e-300))
    outer = vt[good].T / singular[good] / size[:, None]
    covariance = spread**2 * outer @ middle[np.ix_(good, good)] @ outer.T
    covariance[null] = covariance[:, null] = np.nan
    return Sandwich(
        covariance=0.5 * (covariance + covariance.T),
        null=null,
        root=(vectors / np.sqrt(values)).T @ back / max(spread, 1e-30),
        step=-outer @ (u[:, good].T @ r),
        # the mean of r' U U' r over noise r of correlation R, for each of the columns of U
        gain=spread**2 * float(np.trace(middle[np.ix_(good, good)])) / max(int(good.sum()), 1),
        scatter=scatter,
        scatter_p=p_value,
    )


def _scatter(
    jacobians: list[Array], correlated: list[Array], residuals: list[Array], variance: float, degrees: int
) -> tuple[float, float]:
    """Factor by which trials scatter more than their noise, and the p-value that they do not."""
    if len(jacobians) < 3:
        return 1.0, 1.0
    statistic = 0.0
    for whole, whole_b, r in zip(jacobians, correlated, residuals, strict=True):
        # numbers of other trials have nothing to say here, and their rounding errors would
        own = np.linalg.norm(whole, axis=0) > 0
        a, b = whole[:, own], whole_b[:, own]
        score = a.T @ r
        spread = (a.T @ b) * variance
        scale = np.sqrt(np.maximum(np.diag(spread), 1e-300))
        values, vectors = np.linalg.eigh(spread / np.outer(scale, scale))
        keep = values > 1e-6 * max(values.max(initial=0.0), 1e-300)
        part = vectors[:, keep].T @ (score / scale)
        statistic += float(np.sum(part**2 / values[keep]))
        degrees += int(keep.sum())
    if degrees < 1:
        return 1.0, 1.0
    p_value = float(special.chdtrc(degrees, statistic))
    return (max(math.sqrt(statistic / degrees), 1.0) if p_value < HETEROGENEITY else 1.0), p_value
