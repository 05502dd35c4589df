"""Differences between trials: random effects with an estimated spread, and the trial that contradicts the
rest.

A free number for each trial would take up whatever the model leaves out: a force that grows with the setting
of the trials looks like a friction that does. A random effect may only be as large as the trials' scatter
about a common value allows (Pinheiro and Bates, "Mixed-Effects Models in S and S-PLUS", 2000). The odd trial
is found by prediction of each trial by a fit of all the rest.
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

#: Fewest trials from which a spread is estimated.
FEWEST = 4
#: Rounds of estimating the spread and fitting with it, at most, and the relative change that ends them.
ROUNDS, SETTLED = 8, 0.05
#: Smallest share of the largest information that still counts as some.
LEAST = 1e-12


@dataclass(frozen=True)
class Own:
    """What each trial by itself says of a number, all shared parameters free."""

    trials: tuple[str, ...]
    #: Shape (n,).
    value: Array
    #: Shape (n, n): of their errors, under coloured residuals. What the shared parameters can imitate is
    #: hardly known.
    covariance: Array


@dataclass(frozen=True)
class Spread:
    """Standard deviation of a number between trials, and the p-value of the test that there is none."""

    sd: float
    stderr: float
    p_value: float


@dataclass(frozen=True)
class Trend:
    """How a number follows a setting of the trials, per unit of that; p-value two-sided, of Student's t."""

    slope: float
    stderr: float
    p_value: float


def own_numbers(result: FitResult, name: str, common: str) -> Own:
    """Each trial's own value of a per-trial parameter that deviates from a common one, by one linear step."""
    parameters = tuple(
        replace(p, free=True, spread=math.inf)
        if p.name == name
        else replace(p, free=False, start=result.value(common))
        if p.name == common
        else p
        for p in result.parameters
    )
    problem = weighted(result, parameters)
    parted = [label.partition("[") for label in problem.labels]
    theta = np.array([result.value(n, t.rstrip("]") or None) for n, _, t in parted])
    rows = [j * problem.scale for j in problem.trial_jacobians(theta, central=True)]
    residuals = [problem.trial_residuals(theta, k) for k in range(len(problem.trials))]
    held = np.array([result.status.get(label) == "at-bound" for label in problem.labels], dtype=bool)
    seen = ~held & (np.linalg.norm(np.concatenate(rows), axis=0) > 0)
    if not seen.any():
        # at a point where every number is at a bound or without effect, none is known
        return Own((), np.empty(0), np.empty((0, 0)))
    rows = [r[:, seen] for r in rows]
    step = np.linalg.lstsq(np.concatenate(rows), -np.concatenate(residuals), rcond=1e-12)[0]
    # the noise is what is left once every trial has its own number: before, it holds what is sought
    left = [r + j @ step for r, j in zip(residuals, rows, strict=True)]
    found = sandwich(problem, rows, left, noise_model.autoregressions(problem, left))
    labels = [label for label, s in zip(problem.labels, seen, strict=True) if s]
    mine = [i for i, label in enumerate(labels) if label.startswith(f"{name}[")]
    root = found.root * found.scatter
    others = [i for i in range(len(labels)) if i not in mine]
    part = orthogonal_part(root[:, others], root[:, mine], math.sqrt(LEAST))
    values, vectors = np.linalg.eigh(part.T @ part)
    values = np.maximum(values, LEAST * values.max(initial=1e-300))
    size = problem.scale[seen][mine]
    return Own(
        trials=tuple(labels[i][len(name) + 1 : -1] for i in mine),
        value=theta[seen][mine] + step[mine] * size,
        covariance=(vectors / values) @ vectors.T * np.outer(size, size),
    )


def spread(own: Own) -> Spread:
    """Standard deviation between trials by restricted maximum likelihood.

    >>> s = spread(Own(tuple("abcdef"), np.array([1.0, -1.0, 1.0, -1.0, 1.0, -1.0]), 1e-6 * np.eye(6)))
    >>> round(s.sd, 2)
    1.1
    """
    variances, values, _ = _contrasts(own)
    between, gain = _reml(variances, values, None)
    sd = math.sqrt(between)
    information = float(np.sum((variances + between) ** -2.0))
    error = math.sqrt(2.0 / information) / (2.0 * sd) if sd > 0 and information > 0 else 0.0
    # no spread lies at the edge of what is possible: half the chi-square (Self and Liang 1987)
    return Spread(sd, error, 0.5 * float(special.chdtrc(1, max(gain, 0.0))) if sd > 0 else 1.0)


def trend(own: Own, setting: Array) -> Trend:
    """Slope of the trials' numbers over a setting, shape (n,), beside a spread by chance."""
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


def _contrasts(own: Own) -> tuple[Array, Array, Array]:
    """Independent differences between trials: their error variances, values, and the map from numbers."""
    n = len(own.value)
    whole = np.linalg.qr(np.column_stack((np.ones(n), np.eye(n)[:, : n - 1])))[0]
    apart = whole[:, 1:].T
    variances, vectors = np.linalg.eigh(apart @ own.covariance @ apart.T)
    turn = vectors.T @ apart
    return np.maximum(variances, 0.0), turn @ own.value, turn


def _reml(variances: Array, values: Array, column: Array | None) -> tuple[float, float]:
    """Variance between trials, and twice the gain in restricted log-likelihood over none."""
    floor = 1e-12 * float(np.max(values**2, initial=0.0)) + 1e-300

    def minus(between: float) -> float:
        whole = variances + between + floor
        left, extra = values, 0.0
        if column is not None:
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


def fit(
    result: FitResult, name: str, common: str, *, near: FitResult | None = None
) -> tuple[FitResult, Spread]:
    """Fit with a per-trial parameter as a random effect about the shared one.

    Parameters
    ----------
    result : FitResult
        Without it: where the search begins, and the choices of all other parameters.
    name, common : str
        The per-trial parameter, whose start is its middle, and the shared one it deviates from.
    near : FitResult, optional
        Where the search begins instead: of the same trials or some of them.

    Returns
    -------
    result : FitResult
        Standard errors of shared parameters hold for this many trials (Student's t).
    spread : Spread
        ``sd`` 0 where the trials show none; the result is then the one given.

    Raises
    ------
    NoTrustworthyResult
        When a fit does not converge.
    """
    none = Spread(0.0, 0.0, 1.0)
    now, last = result if near is None else replace(near, trials=result.trials), 0.0
    found = none
    rounds: list[FitResult] = []
    for _ in range(ROUNDS):
        own = own_numbers(now, name, common)
        if len(own.trials) < FEWEST:
            return result, none
        found = spread(own)
        if found.sd == 0.0:
            return result, found
        if abs(found.sd - last) <= SETTLED * last:
            break
        last = found.sd
        parameters = tuple(
            # a number known no better than its spread is not worse known than it can be
            replace(p, free=True, spread=last, scale=max(p.scale, last / UNIDENTIFIABLE))
            if p.name == name
            else replace(p, start=p.start if p.per_trial else now.value(p.name))
            for p in result.parameters
        )
        now = output_error.fit(result.model, result.trials, parameters=parameters, tested=False)
        rounds.append(now)
    now = output_error.held_to_restarts(now, jobs=1)
    earlier = [result, *rounds[:-1]]
    now = replace(
        now,
        evaluations=now.evaluations + sum(r.evaluations for r in earlier),
        jacobians=now.jacobians + sum(r.jacobians for r in earlier),
    )
    return _for_few(now, name), found


def _for_few(result: FitResult, name: str) -> FitResult:
    """The same with what the random effect adds to the covariance widened for few trials."""
    mine = np.array([label.startswith(f"{name}[") for label in result.labels])
    others = np.flatnonzero(~mine & np.isfinite(np.diag(result.covariance)))
    if not len(others) or mine.sum() < 2:
        return result
    root = result.information_root[:, others]
    alone = np.linalg.pinv(root.T @ root, rcond=LEAST, hermitian=True)
    widen = float(special.stdtrit(int(mine.sum()) - 1, 0.975) / special.ndtri(0.975)) ** 2
    covariance = result.covariance.copy()
    place = np.ix_(others, others)
    covariance[place] += (widen - 1.0) * (covariance[place] - alone)
    return replace(result, covariance=covariance)


# ---------------------------------------------------------------- the odd trial


#: Fewest trials among which one can be odd: of fewer the others do not show how far off is far.
MIN_TRIALS = 4
#: A trial is odd when chance would put one of them as far off less often than this.
ODD = 1e-2
#: ... and its error of prediction is at least so many times that of the others: less is no mistake in a
#: trial, however regular the others are.
TIMES = 2.0


@dataclass(frozen=True)
class Odd:
    """A trial that the others do not predict."""

    trial: str
    #: Its error of prediction over the others' typical one.
    times: float
    #: Of the most distant of so many trials by Student's t of the logarithms of their errors.
    p_value: float
    #: Of all other trials; this one has the role ``validate``.
    others: FitResult


def odd_trial(result: FitResult) -> Odd | None:
    """The trial that does not agree with the others; None where there is none, or a fit of the others fails.

    The suspect is the one whose absence lowers the misfit of the rest most. Its error, predicted from
    them, is then held against the errors with which each of them is predicted by the rest: what the model
    lacks for all trials is in those errors too, and makes none of them odd.
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
        # so that channels of other units count alike
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
    # the most distant of n + 1 trials was picked (Bonferroni)
    p_value = min(1.0, (n + 1) * float(special.stdtr(n - 1, -t)))
    times = float(np.exp(far - np.median(logs)))
    return Odd(suspect, times, p_value, fits[suspect]) if p_value < ODD and times >= TIMES else None


def _error(result: FitResult, trial: str, scale: dict[str, float]) -> float:
    """Root-mean-square error of a trial over the noise."""
    own = [s for s in result.series if s.trial == trial and s.channel in scale]
    values = np.concatenate([s.residual / scale[s.channel] for s in own])
    return float(np.sqrt(np.nanmean(values**2)))
