"""Differences between trials: dependence of a parameter on a setting, and outlier trials.

If each trial had its own free value of a parameter, these values would absorb any effect that the model
lacks. For example, a force that grows with the setting of the trials would look like a friction that grows. A
random effect is limited by the standard deviation of the trials about a common value [1]_. The outlier is
found by predicting each trial from a fit of all others.

References
----------
.. [1] J. C. Pinheiro, D. M. Bates, "Mixed-Effects Models in S and S-PLUS", Springer, 2000.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import optimize, special

from swimid.errors import NoTrustworthyResult
from swimid.fitting import output_error, uncertainty
from swimid.fitting.model import Array
from swimid.fitting.output_error import FitResult
from swimid.fitting.uncertainty import orthogonal_part, sandwich

#: Minimum number of trials for an estimate of the between-trial standard deviation, and for the search for an
#: outlier trial.
MIN_TRIALS = 4
#: Minimum eigenvalue of an information matrix that is not a rounding error, as a fraction of the largest one.
MIN_INFORMATION = 1e-12
#: Significance level of the test for an outlier trial, corrected for the number of trials.
OUTLIER_P_VALUE = 1e-2
#: Minimum ratio of the outlier's prediction error to the median prediction error of the other trials. A trial
#: with a smaller ratio is not reported, even if its p-value is significant.
MIN_ERROR_RATIO = 2.0


@dataclass(frozen=True)
class OwnValues:
    """Separate estimates of one parameter for each trial, with all shared parameters free."""

    trials: tuple[str, ...]
    #: Estimates of the parameter, one for each trial, shape (n,).
    value: Array
    #: Covariance of the errors of these estimates, allowing for coloured residuals, shape (n, n). The
    #: variance is large for a combination of the values that the shared parameters can reproduce.
    covariance: Array


def estimate_own_values(result: FitResult, name: str, common: str) -> OwnValues:
    """Estimate one value of a parameter for each trial, by one Gauss-Newton step from the result of a fit.

    Parameters
    ----------
    name, common : str
        Per-trial parameter, and the shared parameter from which it deviates.
    """
    fixed = {"free": False, "start": result.value(common)}
    changes: dict[str, dict[str, Any]] = {name: {"free": True}, common: fixed}
    parameters = [replace(p, **changes.get(p.name, {})) for p in result.parameters]
    problem = output_error.weighted(result, tuple(parameters))
    parted = [label.partition("[") for label in problem.labels]
    theta = np.array([result.value(n, t.rstrip("]") or None) for n, _, t in parted])
    rows = problem.blocks(theta, central=True).scaled(problem.scale)
    residuals = [problem.trial_residuals(theta, k) for k in range(len(problem.trials))]
    held = np.array([result.status.get(label) == "at-bound" for label in problem.labels], dtype=bool)
    seen = ~held & (np.diag(rows.normal()) > 0)
    if not seen.any():
        return OwnValues((), np.empty(0), np.empty((0, 0)))
    rows = rows.columns(seen)
    bases, factors = rows.factored(np.ones(rows.shape[1]))
    projected = [basis.T @ r for basis, r in zip(bases, residuals, strict=True)]
    step = np.linalg.lstsq(np.concatenate(factors), -np.concatenate(projected), rcond=1e-12)[0]
    # Estimate the noise after the step, because the residuals before the step contain the differences between
    # trials.
    left = [r + part @ step[at] for r, (_, at, part) in zip(residuals, rows.parts, strict=True)]
    found = sandwich(problem, rows, left, uncertainty.autoregressions(problem, left))
    labels = [label for label, s in zip(problem.labels, seen, strict=True) if s]
    mine = [i for i, label in enumerate(labels) if label.startswith(f"{name}[")]
    others = [i for i in range(len(labels)) if i not in mine]
    root = found.root
    part = orthogonal_part(root[:, others], root[:, mine], math.sqrt(MIN_INFORMATION))
    values, vectors = np.linalg.eigh(part.T @ part)
    values = np.maximum(values, MIN_INFORMATION * values.max(initial=1e-300))
    size = problem.scale[seen][mine]
    return OwnValues(
        trials=tuple(labels[i][len(name) + 1 : -1] for i in mine),
        value=theta[seen][mine] + step[mine] * size,
        covariance=(vectors / values) @ vectors.T * np.outer(size, size),
    )


def compute_trend_p(own: OwnValues, setting: Array) -> float:
    """Test whether the value of a parameter depends linearly on a setting of the trials.

    The test allows for random variation between the trials.

    Parameters
    ----------
    setting : ndarray, shape (n,)
        Value of the setting in each trial.

    Returns
    -------
    float
        Two-sided p-value (Student's t) of a zero slope.
    """
    variances, values, turn = _contrasts(own)
    slope_column = turn @ np.asarray(setting, dtype=float)
    between = _reml(variances, values, slope_column)
    weight = 1.0 / (variances + between)
    information = float(np.sum(slope_column**2 * weight))
    if information <= 0 or len(values) < 2:
        return 1.0
    slope_over_error = float(np.sum(slope_column * values * weight)) / math.sqrt(information)
    return float(2.0 * special.stdtr(len(values) - 1, -abs(slope_over_error)))


def _contrasts(own: OwnValues) -> tuple[Array, Array, Array]:
    """Return independent contrasts between trials: error variances, values, and contrast matrix."""
    n = len(own.value)
    whole = np.linalg.qr(np.column_stack((np.ones(n), np.eye(n)[:, : n - 1])))[0]
    apart = whole[:, 1:].T
    variances, vectors = np.linalg.eigh(apart @ own.covariance @ apart.T)
    turn = vectors.T @ apart
    return np.maximum(variances, 0.0), turn @ own.value, turn


def _reml(variances: Array, values: Array, column: Array) -> float:
    """Estimate the between-trial variance of a parameter by restricted maximum likelihood (REML).

    The slope of the values over ``column`` is estimated together with the variance.
    """
    floor = 1e-12 * float(np.max(values**2, initial=0.0)) + 1e-300

    def minus(between: float) -> float:
        whole = variances + between + floor
        information = max(float(np.sum(column**2 / whole)), 1e-300)
        left = values - column * float(np.sum(column * values / whole)) / information
        return float(np.sum(np.log(whole) + left**2 / whole)) + math.log(information)

    top = 4.0 * float(np.max(values**2, initial=0.0)) + floor
    grid = np.concatenate(([0.0], np.geomspace(1e-10 * top, top, 60)))
    best = int(np.argmin([minus(b) for b in grid]))
    if best == 0:
        return 0.0
    low, high = grid[best - 1], grid[min(best + 1, len(grid) - 1)]
    return float(optimize.minimize_scalar(minus, bounds=(low, high), method="bounded").x)


# ---------------------------------------------------------------- the outlier among the trials


@dataclass(frozen=True)
class OutlierTrial:
    """Outlier: a trial that a fit of the other trials does not predict."""

    trial: str
    #: Prediction error of the trial, divided by the median prediction error of the other trials.
    error_ratio: float
    #: p-value of the trial's error (Student's t of the logarithms of the errors), corrected for the number of
    #: trials.
    p_value: float
    #: Fit of all other trials. The outlier has the role ``validate`` in the fit.
    others: FitResult


def find_outlier_trial(result: FitResult) -> OutlierTrial | None:
    """Find the trial that does not agree with the other trials.

    The suspect is the trial whose omission lowers the residuals of the remaining trials most. Its prediction
    error is compared with the prediction errors of the other trials, each predicted from the remaining ones.
    An effect that the model lacks in all trials raises all these errors, and makes no trial an outlier.

    Returns
    -------
    OutlierTrial or None
        None if no trial is an outlier, or if a fit without one of the trials fails.
    """
    names = [t.id for t in result.trials if t.role == "fit"]
    if len(names) < MIN_TRIALS:
        return None
    here = result.at_estimates()

    def without(*left_out: str) -> FitResult:
        trials = [replace(t, role="validate") if t.id in left_out else t for t in result.trials]
        fit = output_error.fit(result.model, trials, parameters=here, tested=False)
        return output_error.with_held_out(fit)

    try:
        fits = {name: without(name) for name in names}
        suspect = min(names, key=lambda name: fits[name].cost)
        scale = {name: max(noise.value_sd, 1e-300) for name, noise in fits[suspect].noise.items()}
        rest = [name for name in names if name != suspect]
        logs = np.log([_error(without(suspect, name), name, scale) for name in rest])
        far = float(np.log(_error(fits[suspect], suspect, scale)))
    except NoTrustworthyResult:
        return None
    n, sd = len(rest), float(np.std(logs, ddof=1))
    if not 0 < sd < math.inf:
        return None
    t = (far - float(np.mean(logs))) / (sd * np.sqrt(1.0 + 1.0 / n))
    # Apply Bonferroni's correction, because the suspect is the most distant of n + 1 trials.
    p_value = min(1.0, (n + 1) * float(special.stdtr(n - 1, -t)))
    ratio = float(np.exp(far - np.median(logs)))
    if p_value >= OUTLIER_P_VALUE or ratio < MIN_ERROR_RATIO:
        return None
    return OutlierTrial(suspect, ratio, p_value, fits[suspect])


def _error(result: FitResult, trial: str, scale: dict[str, float]) -> float:
    """Return the prediction error of a trial: root mean square of residuals divided by channel noise."""
    own = [s for s in result.series if s.trial == trial and s.channel in scale]
    values = np.concatenate([s.residual / scale[s.channel] for s in own])
    return float(np.sqrt(np.nanmean(values**2)))
