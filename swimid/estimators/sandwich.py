"""Covariance of output-error estimates under coloured residuals and scattering trials."""

from __future__ import annotations

import math

import numpy as np
from scipy import stats
from scipy.linalg import matmul_toeplitz

from swimid.estimators.problem import Problem
from swimid.models.base import Array

#: Trials are called inconsistent below this p-value.
HETEROGENEITY = 1e-3


def autocovariance(coefficients: Array, lags: int) -> Array:
    """Autocorrelation of an autoregression at lags 0 .. lags, shape (lags + 1,).

    Parameters
    ----------
    coefficients : ndarray, shape (p,)
        Of ``x(k) + a1 x(k-1) + .. = e(k)``.
    """
    rho = np.zeros(lags + 1)
    rho[0] = 1.0
    p = len(coefficients)
    if p == 0:
        return rho
    # impulse response of 1 / A, long enough to have died out, correlated with itself
    length = lags + 1 + min(20000, max(2000, 10 * lags))
    from scipy.signal import lfilter

    impulse = np.zeros(length)
    impulse[0] = 1.0
    response = lfilter([1.0], np.concatenate(([1.0], coefficients)), impulse)
    spectrum = np.fft.rfft(response, 2 * length)
    covariance = np.fft.irfft(np.abs(spectrum) ** 2)[: lags + 1]
    return covariance / covariance[0]


def correlated_rows(
    problem: Problem, jacobians: list[Array], autoregressions: dict[str, Array]
) -> list[Array]:
    """R J for each trial, R the residuals' correlation matrix under their autoregressions.

    Parameters
    ----------
    jacobians : list of ndarray, each shape (n_k, p)
        Of the weighted residuals of each trial.
    autoregressions : dict of channel name to ndarray

    Returns
    -------
    list of ndarray, each shape (n_k, p)
    """
    longest = max(len(t.time_s) for t in problem.trials)
    rho = {c: autocovariance(a, longest - 1) for c, a in autoregressions.items()}
    products = []
    for k, jacobian in enumerate(jacobians):
        parts, at = [], 0
        for channel, mask in zip(problem.channels[k], problem.masks[k], strict=True):
            count = int(mask.sum())
            rows = np.zeros((len(mask), jacobian.shape[1]))
            rows[mask] = jacobian[at : at + count]
            at += count
            if len(autoregressions[channel]):
                rows = matmul_toeplitz(rho[channel][: len(mask)], rows)
            parts.append(rows[mask])
        products.append(np.concatenate(parts) if parts else np.zeros((0, jacobian.shape[1])))
    return products


def covariance(
    jacobians: list[Array], correlated: list[Array], residuals: list[Array]
) -> tuple[Array, Array, float, float]:
    """Covariance, null parameters, scatter factor and its p-value, in scaled parameters.

    Parameters
    ----------
    jacobians, correlated : list of ndarray, each shape (n_k, p)
        J and R J of each trial (:func:`correlated_rows`).
    residuals : list of ndarray, each shape (n_k,)

    Returns
    -------
    covariance : ndarray, shape (p, p)
        ``H^-1 M H^-1``, enlarged by the square of the scatter factor.
    null : ndarray of bool, shape (p,)
        Parameters the data do not see.
    scatter : float
        At least 1.
    p_value : float
        Of the test that the trials agree: their scores, each zero on average at the common
        optimum, against their own covariance.
    """
    j = np.concatenate(jacobians)
    samples, unknowns = j.shape
    size = np.linalg.norm(j, axis=0)
    null = size == 0
    size = np.where(null, 1.0, size)
    _, singular, vt = np.linalg.svd(j / size, full_matrices=False)
    good = (
        singular > 1e-8 * singular[0] if len(singular) and singular[0] > 0 else np.zeros(len(singular), bool)
    )
    # a parameter with a part in a direction the data do not see is not identifiable
    null |= (np.abs(vt[~good]) > 1e-3).any(axis=0)
    inverse = (vt[good].T / singular[good] ** 2) @ vt[good] / np.outer(size, size)
    variance = sum(float(r @ r) for r in residuals) / max(samples - unknowns, 1)
    meat = sum(a.T @ b for a, b in zip(jacobians, correlated, strict=True)) * variance
    covariance = inverse @ meat @ inverse
    covariance = 0.5 * (covariance + covariance.T)
    if len(jacobians) < 3:
        return covariance, null, 1.0, 1.0
    statistic, degrees = 0.0, -unknowns
    for a, b, r in zip(jacobians, correlated, residuals, strict=True):
        score = a.T @ r
        spread = (a.T @ b) * variance
        scale = np.sqrt(np.maximum(np.diag(spread), 1e-300))
        values, vectors = np.linalg.eigh(spread / np.outer(scale, scale))
        keep = values > 1e-6 * max(values.max(initial=0.0), 1e-300)
        part = vectors[:, keep].T @ (score / scale)
        statistic += float(np.sum(part**2 / values[keep]))
        degrees += int(keep.sum())
    if degrees < 1:
        return covariance, null, 1.0, 1.0
    p_value = float(stats.chi2.sf(statistic, degrees))
    factor = math.sqrt(statistic / degrees) if p_value < HETEROGENEITY else 1.0
    return covariance * max(factor, 1.0) ** 2, null, max(factor, 1.0), p_value
