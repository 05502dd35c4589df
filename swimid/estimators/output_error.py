"""Output-error identification: maximum likelihood over all samples of all trials.

The simulated channels are compared with the measured ones; what is left over is weighted by
a noise model estimated from the residuals themselves, and the uncertainty of the estimates
accounts for coloured residuals and for trials that scatter more than their noise.

Works for every :class:`swimid.models.base.Model`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy import stats

from swimid.errors import NoTrustworthyResult
from swimid.estimators import noise as noise_model
from swimid.estimators import sandwich
from swimid.estimators.fit_result import FitResult, Noise, Series
from swimid.estimators.levenberg import Solution
from swimid.estimators.problem import Problem
from swimid.models.base import Array, Model, Parameter, Trial
from swimid.progress import Progress, silent

#: A standard error above this share of a parameter's size makes it unidentifiable.
UNIDENTIFIABLE = 0.5
#: Rounds of weighting by the noise model.
ROUNDS = 4
#: The integration step is halved until halving it changes no sample by more than this many
#: standard deviations of its noise, at most so many times.
STEP_ERROR = 0.1
MAX_REFINEMENTS = 6


def fit(
    model: Model,
    trials: Sequence[Trial],
    *,
    parameters: Sequence[Parameter] | None = None,
    progress: Progress = silent,
) -> FitResult:
    """Estimate the free parameters of a model from all fit trials at once.

    Parameters
    ----------
    model : Model
    trials : sequence of Trial
        Those of role ``validate`` are simulated and scored, not fitted.
    parameters : sequence of Parameter, optional
        The model's with the user's choices applied
        (:func:`swimid.models.base.chosen`); default the model's own.

    Returns
    -------
    FitResult

    Raises
    ------
    NoTrustworthyResult
        When the search does not converge, or there are fewer samples than unknowns.

    Notes
    -----
    Weighted nonlinear least squares by a bounded Levenberg-Marquardt method, reweighted
    :data:`ROUNDS` times by the estimated noise. Covariance ``H^-1 M H^-1`` with ``H = J'J``
    and ``M = sum_trials J_k' R J_k``, R the correlation of the weighted residuals under an
    autoregression chosen by BIC; multiplied by the trials' scatter where they disagree.
    """
    parameters = tuple(parameters or model.parameters)
    for _ in range(MAX_REFINEMENTS):
        result = _fit_once(model, trials, parameters, progress)
        finer = model.refined()
        if finer is None:
            return result
        result = replace(result, step_error=_step_error(result, finer))
        if result.step_error <= STEP_ERROR:
            return result
        model = finer
    return result


def _step_error(result: FitResult, finer: Model) -> float:
    trials = {t.id: t for t in result.trials}
    worst = 0.0
    for name, trial in trials.items():
        fine = finer.simulate(result.values(name), trial)
        for s in result.series:
            if s.trial == name:
                change = np.abs(fine[s.channel] - s.simulated) / s.sd
                worst = max(worst, float(np.max(change[np.isfinite(change)], initial=0.0)))
    return worst


def _fit_once(
    model: Model, trials: Sequence[Trial], parameters: tuple[Parameter, ...], progress: Progress
) -> FitResult:
    fitted = [t for t in trials if t.role == "fit"]
    if not fitted:
        raise NoTrustworthyResult("no trial has the role 'fit'")
    problem = Problem(model, parameters, fitted)
    theta = problem.start
    samples = sum(int(mask.sum()) for masks in problem.masks for mask in masks)
    if samples <= len(theta):
        raise NoTrustworthyResult(
            f"{samples} samples cannot determine {len(theta)} unknowns",
            hint="give longer logs or more trials, or fix some parameters",
        )
    noise: dict[str, tuple[float, float]] = {}
    # equal weights everywhere stay equal: one round is enough
    even = len({c for names in problem.channels for c in names}) == 1 and not any(
        t.stamps_uncertain or t.time_sd_s or t.value_sd for t in fitted
    )
    rounds = 1 if even else ROUNDS
    with progress("fitting", total=rounds) as step:
        for round_ in range(rounds):
            if round_:
                noise = noise_model.estimate(problem, theta, noise)
            else:
                noise_model.weigh_first(problem, even)
            previous = theta
            solution = problem.solve(theta, tolerance=1e-6 if round_ < rounds - 1 else 1e-10)
            theta = solution.x
            step()
            if round_ > 1 and np.all(
                np.abs(theta - previous) <= 1e-7 * np.maximum(np.abs(theta), problem.scale)
            ):
                break
    noise = noise_model.estimate(problem, theta, noise)
    if not solution.success or not np.isfinite(theta).all():
        raise NoTrustworthyResult(
            f"the fit did not converge: {solution.message}",
            hint="check units and trial settings, or hold a parameter with --fix",
        )
    return _result(problem, theta, noise, solution, parameters, tuple(trials))


def _result(
    problem: Problem,
    theta: Array,
    noise: dict[str, tuple[float, float]],
    solution: Solution,
    parameters: tuple[Parameter, ...],
    trials: tuple[Trial, ...],
) -> FitResult:
    jacobians = problem.trial_jacobians(theta, central=True)
    residuals = [problem.trial_residuals(theta, k) for k in range(len(problem.trials))]
    samples = sum(len(r) for r in residuals)
    margin = 1e-6 * np.maximum(problem.scale, np.abs(theta))
    at_bound = (theta - problem.lower < margin) | (problem.upper - theta < margin)
    free = ~at_bound
    autoregressions = noise_model.autoregressions(problem, residuals)
    covariance = np.full((len(theta), len(theta)), np.nan)
    scatter, scatter_p = 1.0, 1.0
    null = np.zeros(len(theta), dtype=bool)
    if free.any():
        rows = [j[:, free] * problem.scale[free] for j in jacobians]
        correlated = sandwich.correlated_rows(problem, rows, autoregressions)
        part, null_part, scatter, scatter_p = sandwich.covariance(rows, correlated, residuals)
        # Student's t for few samples: the standard error is that whose 1.96-fold covers 95 %
        few = float(stats.t.ppf(0.975, max(samples - int(free.sum()), 1)) / stats.norm.ppf(0.975))
        covariance[np.ix_(free, free)] = few**2 * part * np.outer(problem.scale[free], problem.scale[free])
        null[np.flatnonzero(free)[null_part]] = True
    status = {}
    for j, label in enumerate(problem.labels):
        variance = covariance[j, j]
        limit = UNIDENTIFIABLE * max(abs(theta[j]), problem.scale[j])
        if at_bound[j]:
            status[label] = "at-bound"
        elif null[j] or not math.isfinite(variance) or math.sqrt(max(variance, 0.0)) > limit:
            status[label] = "unidentifiable"
        else:
            status[label] = "estimated"
    result = FitResult(
        model=problem.model,
        parameters=parameters,
        trials=trials,
        labels=problem.labels,
        estimate=theta,
        covariance=covariance,
        status=status,
        series=[],
        noise={
            c: Noise(noise_model.value_sd(problem, c, v), t, autoregressions[c])
            for c, (v, t) in noise.items()
        },
        scatter=scatter,
        scatter_p=scatter_p,
        samples=samples,
        converged=bool(solution.success),
        message=str(solution.message),
        evaluations=problem.evaluations,
    )
    return replace(result, series=_series(problem, result, trials))


def _series(problem: Problem, result: FitResult, trials: tuple[Trial, ...]) -> list[Series]:
    by_id = {t.id: k for k, t in enumerate(problem.trials)}
    series = []
    for trial in trials:
        simulated = problem.model.simulate(result.values(trial.id), trial)
        for channel in (c.name for c in problem.model.channels if c.name in trial.measured):
            if trial.id in by_id and channel in problem.channels[by_id[trial.id]]:
                k = by_id[trial.id]
                sd = problem.sd[k][problem.channels[k].index(channel)]
            else:
                sd = np.full(
                    len(trial.time_s), result.noise[channel].value_sd if channel in result.noise else np.nan
                )
            series.append(
                Series(
                    trial.id,
                    trial.role,
                    channel,
                    trial.time_s,
                    trial.measured[channel],
                    simulated[channel],
                    sd,
                )
            )
    return series
