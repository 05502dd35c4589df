"""Differences between trials: random effects with an estimated spread, and the outlier among the trials.

A free value for each trial would take up whatever the model lacks: a force that grows with the setting of the
trials looks like a friction that does. A random effect is limited by the spread of the trials about a common
value [1]_. The outlier is found by predicting each trial from a fit of all others.

References
----------
.. [1] J. C. Pinheiro, D. M. Bates, "Mixed-Effects Models in S and S-PLUS", Springer, 2000.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy import optimize, special

from swimid.errors import NoTrustworthyResult
from swimid.fitting import noise as noise_model
from swimid.fitting import output_error
from swimid.fitting.covariance import UNIDENTIFIABLE, orthogonal_part, sandwich
from swimid.fitting.metrics import FitResult
from swimid.fitting.model import Array
from swimid.fitting.restarts import weighted

#: Minimum number of trials for an estimate of their spread, and for a search for an outlier.
MIN_TRIALS = 4
#: Maximum number of fits with an updated spread, and the relative change of the spread that ends them.
MAX_SPREAD_ITERATIONS, SPREAD_RTOL = 8, 0.05
#: Smallest share of the largest information that counts as information.
MIN_INFORMATION = 1e-12
#: Significance level of the test for an outlier, corrected for the number of trials.
OUTLIER_P_VALUE = 1e-2
#: Minimum ratio of the outlier's prediction error to that of the others. Below it a trial is no mistake,
#: however regular the others are.
MIN_ERROR_RATIO = 2.0


@dataclass(frozen=True)
class OwnValues:
    """Estimates of one parameter from each trial by itself, with all shared parameters free."""

    trials: tuple[str, ...]
    #: Shape (n,).
    value: Array
    #: Covariance of their errors under coloured residuals, shape (n, n). It is large for a combination that
    #: the shared parameters can imitate.
    covariance: Array


@dataclass(frozen=True)
class Spread:
    """Standard deviation of a parameter between trials, and the p-value of the test that there is none."""

    sd: float
    stderr: float
    p_value: float


@dataclass(frozen=True)
class Trend:
    """Slope of a parameter over a setting of the trials; the p-value is two-sided, of Student's t."""

    slope: float
    stderr: float
    p_value: float


def estimate_own_values(result: FitResult, name: str, common: str) -> OwnValues:
    """Estimate the value of each trial by one linear step from a fit.

    Parameters
    ----------
    name, common : str
        The per-trial parameter, and the shared one that it deviates from.
    """
    parameters = []
    for p in result.parameters:
        if p.name == name:
            p = replace(p, free=True, spread=math.inf)
        elif p.name == common:
            p = replace(p, free=False, start=result.value(common))
        parameters.append(p)
    problem = weighted(result, tuple(parameters))
    parted = [label.partition("[") for label in problem.labels]
    theta = np.array([result.value(n, t.rstrip("]") or None) for n, _, t in parted])
    rows = [j * problem.scale for j in problem.trial_jacobians(theta, central=True)]
    residuals = [problem.trial_residuals(theta, k) for k in range(len(problem.trials))]
    held = np.array([result.status.get(label) == "at-bound" for label in problem.labels], dtype=bool)
    seen = ~held & (np.linalg.norm(np.concatenate(rows), axis=0) > 0)
    if not seen.any():
        return OwnValues((), np.empty(0), np.empty((0, 0)))
    rows = [r[:, seen] for r in rows]
    step = np.linalg.lstsq(np.concatenate(rows), -np.concatenate(residuals), rcond=1e-12)[0]
    # the noise is estimated after the step, because the residuals before it hold the difference of the trials
    left = [r + j @ step for r, j in zip(residuals, rows, strict=True)]
    found = sandwich(problem, rows, left, noise_model.autoregressions(problem, left))
    labels = [label for label, s in zip(problem.labels, seen, strict=True) if s]
    mine = [i for i, label in enumerate(labels) if label.startswith(f"{name}[")]
    others = [i for i in range(len(labels)) if i not in mine]
    root = found.root * found.scatter
    part = orthogonal_part(root[:, others], root[:, mine], math.sqrt(MIN_INFORMATION))
    values, vectors = np.linalg.eigh(part.T @ part)
    values = np.maximum(values, MIN_INFORMATION * values.max(initial=1e-300))
    size = problem.scale[seen][mine]
    return OwnValues(
        trials=tuple(labels[i][len(name) + 1 : -1] for i in mine),
        value=theta[seen][mine] + step[mine] * size,
        covariance=(vectors / values) @ vectors.T * np.outer(size, size),
    )


def estimate_spread(own: OwnValues) -> Spread:
    """Estimate the standard deviation between trials by restricted maximum likelihood.

    >>> own = OwnValues(tuple("abcdef"), np.array([1.0, -1.0, 1.0, -1.0, 1.0, -1.0]), 1e-6 * np.eye(6))
    >>> round(estimate_spread(own).sd, 2)
    1.1
    """
    variances, values, _ = _contrasts(own)
    between, gain = _reml(variances, values, np.zeros(len(values)))
    if between == 0.0:
        return Spread(0.0, 0.0, 1.0)
    sd = math.sqrt(between)
    information = float(np.sum((variances + between) ** -2.0))
    error = math.sqrt(2.0 / information) / (2.0 * sd)
    # a spread of zero is at the edge of the possible: half of a chi-square distribution (Self and Liang 1987)
    return Spread(sd, error, 0.5 * float(special.chdtrc(1, max(gain, 0.0))))


def estimate_trend(own: OwnValues, setting: Array) -> Trend:
    """Estimate the slope of the trials' values over a setting, shape (n,), beside their random spread."""
    variances, values, turn = _contrasts(own)
    slope_column = turn @ np.asarray(setting, dtype=float)
    between, _ = _reml(variances, values, slope_column)
    weight = 1.0 / (variances + between)
    information = float(np.sum(slope_column**2 * weight))
    if information <= 0 or len(values) < 2:
        return Trend(0.0, math.inf, 1.0)
    slope = float(np.sum(slope_column * values * weight)) / information
    error = 1.0 / math.sqrt(information)
    return Trend(slope, error, float(2.0 * special.stdtr(len(values) - 1, -abs(slope) / error)))


def _contrasts(own: OwnValues) -> tuple[Array, Array, Array]:
    """Return independent differences between trials: error variances, values, and the map to them."""
    n = len(own.value)
    whole = np.linalg.qr(np.column_stack((np.ones(n), np.eye(n)[:, : n - 1])))[0]
    apart = whole[:, 1:].T
    variances, vectors = np.linalg.eigh(apart @ own.covariance @ apart.T)
    turn = vectors.T @ apart
    return np.maximum(variances, 0.0), turn @ own.value, turn


def _reml(variances: Array, values: Array, column: Array) -> tuple[float, float]:
    """Return the variance between trials, and the gain in twice the restricted log-likelihood over none.

    The slope over ``column`` is estimated beside it, unless that is zero.
    """
    floor = 1e-12 * float(np.max(values**2, initial=0.0)) + 1e-300

    def minus(between: float) -> float:
        whole = variances + between + floor
        left, extra = values, 0.0
        if column.any():
            information = float(np.sum(column**2 / whole))
            left = values - column * float(np.sum(column * values / whole)) / max(information, 1e-300)
            extra = math.log(max(information, 1e-300))
        return float(np.sum(np.log(whole) + left**2 / whole)) + extra

    top = 4.0 * float(np.max(values**2, initial=0.0)) + floor
    grid = np.concatenate(([0.0], np.geomspace(1e-10 * top, top, 60)))
    best = int(np.argmin([minus(b) for b in grid]))
    if best == 0:
        return 0.0, 0.0
    low, high = grid[best - 1], grid[min(best + 1, len(grid) - 1)]
    between = float(optimize.minimize_scalar(minus, bounds=(low, high), method="bounded").x)
    return between, minus(0.0) - minus(between)


def fit_random_effect(
    result: FitResult, name: str, common: str, *, near: FitResult | None = None
) -> tuple[FitResult, Spread]:
    """Fit with a per-trial parameter as a random effect about the shared one.

    Parameters
    ----------
    result : FitResult
        Fit without it: the start of the search, and the choices for all other parameters.
    name, common : str
        The per-trial parameter, whose start is its mean, and the shared one that it deviates from.
    near : FitResult, optional
        Another start of the search: a fit of the same trials, or of some of them.

    Returns
    -------
    result : FitResult
        The standard errors of shared parameters hold for this number of trials (Student's t).
    spread : Spread
        ``sd`` is 0 if the trials show none; the result is then the one given.

    Raises
    ------
    NoTrustworthyResult
        If a fit does not converge.
    """
    now, last = replace(near or result, trials=result.trials), 0.0
    found = Spread(0.0, 0.0, 1.0)
    rounds: list[FitResult] = []
    for _ in range(MAX_SPREAD_ITERATIONS):
        own = estimate_own_values(now, name, common)
        if len(own.trials) < MIN_TRIALS:
            return result, Spread(0.0, 0.0, 1.0)
        found = estimate_spread(own)
        if found.sd == 0.0:
            return result, found
        if abs(found.sd - last) <= SPREAD_RTOL * last:
            break
        last = found.sd
        parameters = []
        for p in result.parameters:
            if p.name == name:
                # a value that is known no better than its spread counts as identified
                p = replace(p, free=True, spread=last, scale=max(p.scale, last / UNIDENTIFIABLE))
            elif not p.per_trial:
                p = replace(p, start=now.value(p.name))
            parameters.append(p)
        now = output_error.fit(result.model, result.trials, parameters=parameters, tested=False)
        rounds.append(now)
    now = output_error.check_by_restarts(now, jobs=1)
    earlier = [result, *rounds[:-1]]
    now = replace(
        now,
        evaluations=now.evaluations + sum(r.evaluations for r in earlier),
        jacobians=now.jacobians + sum(r.jacobians for r in earlier),
    )
    return _widened(now, name), found


def _widened(result: FitResult, name: str) -> FitResult:
    """Return the result with the random effect's share of the covariance widened for few trials."""
    mine = np.array([label.startswith(f"{name}[") for label in result.labels])
    others = np.flatnonzero(~mine & np.isfinite(np.diag(result.covariance)))
    if not len(others) or mine.sum() < 2:
        return result
    root = result.information_root[:, others]
    alone = np.linalg.pinv(root.T @ root, rcond=MIN_INFORMATION, hermitian=True)
    widen = float(special.stdtrit(int(mine.sum()) - 1, 0.975) / special.ndtri(0.975)) ** 2
    covariance = result.covariance.copy()
    place = np.ix_(others, others)
    covariance[place] += (widen - 1.0) * (covariance[place] - alone)
    return replace(result, covariance=covariance)


# ---------------------------------------------------------------- the outlier among the trials


@dataclass(frozen=True)
class OutlierTrial:
    """A trial that a fit of the others does not predict."""

    trial: str
    #: Its prediction error over the typical one of the others.
    error_ratio: float
    #: Student's t of the logarithms of the errors, corrected for the number of trials.
    p_value: float
    #: Fit of all other trials; this one has the role ``validate``.
    others: FitResult


def find_outlier_trial(result: FitResult) -> OutlierTrial | None:
    """Find the trial that does not agree with the others.

    The suspect is the trial whose absence lowers the residuals of the rest most. Its prediction error is
    compared with those of the other trials, each predicted from the rest. What the model lacks in all trials
    is in these errors too, so that it makes no trial an outlier.

    Returns
    -------
    OutlierTrial or None
        None if there is none, or a fit of the others fails.
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
    n = len(rest)
    sd = float(np.std(logs, ddof=1))
    if not sd > 0 or not np.isfinite(sd):
        return None
    t = (far - float(np.mean(logs))) / (sd * np.sqrt(1.0 + 1.0 / n))
    # the most distant of n + 1 trials was chosen (Bonferroni)
    p_value = min(1.0, (n + 1) * float(special.stdtr(n - 1, -t)))
    ratio = float(np.exp(far - np.median(logs)))
    if p_value >= OUTLIER_P_VALUE or ratio < MIN_ERROR_RATIO:
        return None
    return OutlierTrial(suspect, ratio, p_value, fits[suspect])


def _error(result: FitResult, trial: str, scale: dict[str, float]) -> float:
    """Return the root-mean-square error of a trial, in units of the noise of its channels."""
    own = [s for s in result.series if s.trial == trial and s.channel in scale]
    values = np.concatenate([s.residual / scale[s.channel] for s in own])
    return float(np.sqrt(np.nanmean(values**2)))
