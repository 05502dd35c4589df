"""Alternative fits of the same trials (:class:`Rival`), each compared with the original fit by one score.

An alternative fit frees, fixes or replaces parameters, replaces trials, or gives one trial parameters of its
own. Its score is the decrease of minus twice the log-likelihood of all residuals. The likelihood is averaged
over models of the noise (:mod:`swimid.fitting.noise`), which may be white or autocorrelated. Autocorrelated
noise can also explain residuals that are coloured or that differ between trials. An alternative fit has a
high score only if it explains the residuals better than such noise does. Each additional unknown lowers the
score by the logarithm of the number of samples [1]_. If one of m trials or of m recording mistakes was
selected, the selection lowers the score by 2 log m. The score is then twice the logarithm of the odds for the
alternative fit against the original one.

References
----------
.. [1] G. Schwarz, "Estimating the dimension of a model", Annals of Statistics 6 (1978), 461-464.
.. [2] R. E. Kass, A. E. Raftery, "Bayes factors", Journal of the American Statistical Association 90 (1995),
   773-795: evidence is strong if twice the logarithm of the Bayes factor is above 6.
.. [3] J. C. Pinheiro, D. M. Bates, "Mixed-Effects Models in S and S-PLUS", Springer, 2000.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from swimid.errors import NoTrustworthyResult
from swimid.fitting import output_error
from swimid.fitting.model import POSITIONS, Array, Parameter, Trial, choose_parameters
from swimid.fitting.noise import NoisePosterior, NoiseRows, compute_posterior
from swimid.fitting.output_error import UNFINISHED_ITERATIONS, FitResult, Series
from swimid.fitting.problem import BROKEN_RESIDUAL, Problem
from swimid.notices import record_warnings

#: Minimum score at which an alternative fit is better than the original fit. With a score above minus this
#: value it is as good. The value stands for strong evidence (Kass and Raftery [2]_).
STRONG = 6.0
#: Start values of a parameter that an alternative fit frees. They are distances from the value at which the
#: original fit holds the parameter, in multiples of its typical scale.
FREED_STARTS: tuple[float, ...] = (0.0, 1.0, -1.0)
#: Maximum number of steps of generalised least squares (MAX_STEPS). Minimum singular value of normalised
#: derivatives in the directions of a step, as a fraction of the largest (DETERMINED). Finite differences do
#: not determine the other directions.
MAX_STEPS, DETERMINED = 5, 1e-4
#: Minimum number of trials for two kinds of alternative fits: those with one trial that has parameters of its
#: own, and those with a parameter that depends on a setting of the trials.
MIN_TRIALS_RIVAL = 4


@dataclass(frozen=True)
class Rival:
    """Alternative hypothesis about the trials of a fit, for comparison.

    Attributes
    ----------
    name : str
        Parameter that is freed or fixed, or the description of another change.
    parameters : tuple of Parameter
    trials : tuple of Trial
    replaced : tuple of str
        Parameters that the parameter ``name`` replaces.
    """

    name: str
    parameters: tuple[Parameter, ...]
    trials: tuple[Trial, ...]
    replaced: tuple[str, ...] = ()


@dataclass(frozen=True)
class Judged:
    """Alternative hypothesis with its fit and its score: twice the logarithm of the odds for it."""

    rival: Rival
    fit: FitResult
    score: float

    @property
    def is_better(self) -> bool:
        """Whether there is strong evidence for the alternative against the original fit."""
        return self.score > STRONG


def free(stated: FitResult, name: str) -> Rival:
    """Return the alternative hypothesis in which a parameter that a fit holds is free."""
    return Rival(name, choose_parameters(stated.parameters, freed=(name,)), stated.trials)


def judge(stated: FitResult, rivals: Sequence[Rival]) -> list[Judged]:
    """Return the alternatives that can be fitted, with their fits and scores, highest score first."""
    fits = [(rival, refit(stated, rival)) for rival in rivals]
    before = compute_deviance(stated, [stated])
    found = []
    for rival, fit in fits:
        if fit is not None:
            price = (len(fit.labels) - len(stated.labels)) * math.log(stated.samples)
            found.append(Judged(rival, fit, before - compute_deviance(stated, [fit]) - price))
    return sorted(found, key=lambda judged: -judged.score)


def refit(stated: FitResult, rival: Rival, **settings: Any) -> FitResult | None:
    """Return the fit of an alternative hypothesis with the lowest cost among several starts.

    Return None if all fits fail. The search begins at the estimates of the fit ``stated``, unless the
    hypothesis changes trials. A parameter that only the alternative fit estimates has several start values.
    The ``settings`` are those of :func:`swimid.fitting.output_error.fit_output_error`.
    """
    fits = []
    for start in _list_starts(stated, rival):
        begun = [replace(p, start=start.get(p.name, p.start)) if p.free else p for p in rival.parameters]
        # Ignore a search that fails, because a search from another start value may succeed.
        with suppress(NoTrustworthyResult), record_warnings():
            fits.append(
                output_error.fit_output_error(
                    stated.model, rival.trials, parameters=begun, tested=False, **settings
                )
            )
    if not fits:
        return None
    return replace(min(fits, key=lambda fit: fit.cost), parameters=rival.parameters)


def _list_starts(stated: FitResult, rival: Rival) -> list[dict[str, float]]:
    """Return the start values, by parameter name, from which an alternative hypothesis is fitted."""
    known = {}
    if all(any(trial is other for other in stated.trials) for trial in rival.trials):
        known = {label: stated.value(label) for label in stated.common_labels}
    freed = [p for p in rival.parameters if p.name == rival.name and p.free and p.name not in known]
    if not freed:
        return [known]
    values = [freed[0].start + step * freed[0].scale for step in FREED_STARTS]
    return [known | {rival.name: v} for v in values if freed[0].lower <= v <= freed[0].upper]


def compute_deviance(stated: FitResult, fits: Sequence[FitResult]) -> float:
    """Return minus twice the log-likelihood of all residuals, averaged over the models of the noise.

    Autocorrelated noise distorts least-squares estimates. The estimates are therefore moved by steps of
    generalised least squares under the most probable noise model.

    Parameters
    ----------
    stated : FitResult
        Original fit. Its sample weights are used for all ``fits``.
    fits : sequence of FitResult
        Fit of all trials, or fits of different trials.
    """
    problems = [output_error.rebuild_problem(fit) for fit in fits]
    for problem in problems:
        output_error.set_weights(problem, stated)
    points = [fit.estimate for fit in fits]
    deviance, steps = _evaluate(problems, points)
    for _ in range(MAX_STEPS):
        if not any(step.any() for step in steps):
            break
        points = [np.clip(x + dx, p.lower, p.upper) for p, x, dx in zip(problems, points, steps, strict=True)]
        lower, steps = _evaluate(problems, points)
        if not lower < deviance:
            break
        deviance = lower
    return deviance


def _evaluate(problems: Sequence[Problem], points: Sequence[Array]) -> tuple[float, list[Array]]:
    """Return the deviance of several problems at given points, and for each problem a step that may lower it.

    The steps are 0 if the most probable noise model is white noise.
    """
    rows = [
        (channel, NoiseRows.alone(trial.time_s, mask, part))
        for problem, theta in zip(problems, points, strict=True)
        for k, trial in enumerate(problem.trials)
        for channel, mask, part in problem.by_channel(k, problem.trial_residuals(theta, k))
    ]
    if any(np.max(np.abs(part.residual), initial=0.0) >= BROKEN_RESIDUAL for _, part in rows):
        return math.inf, [np.zeros(len(theta)) for theta in points]
    posteriors = _weigh_noise(rows)
    deviance = -2.0 * sum(posterior.log_likelihood for posterior in posteriors.values())
    if all(int(np.argmax(posterior.probability)) == 0 for posterior in posteriors.values()):
        return deviance, [np.zeros(len(theta)) for theta in points]
    return deviance, [_step(p, theta, posteriors) for p, theta in zip(problems, points, strict=True)]


def _step(problem: Problem, theta: Array, posteriors: Mapping[str, NoisePosterior]) -> Array:
    """Return a step of generalised least squares under the most probable noise model, shape (p,)."""
    white = [np.empty((0, len(theta) + 1))]
    jacobians = problem.trial_jacobians(theta)
    for k, trial in enumerate(problem.trials):
        both = np.column_stack((jacobians[k] * problem.scale, problem.trial_residuals(theta, k)))
        for channel, mask, part in problem.by_channel(k, both):
            posterior = posteriors[channel]
            best = int(np.argmax(posterior.probability))
            columns, _ = posterior.forms[best].whiten(trial.time_s[mask], np.flatnonzero(mask), part)
            white.append(columns / math.sqrt(posterior.variance[best]))
    whole = np.concatenate(white)
    norms = np.maximum(np.linalg.norm(whole[:, :-1], axis=0), 1e-300)
    # Leave out directions that finite differences do not determine.
    step = np.linalg.lstsq(whole[:, :-1] / norms, -whole[:, -1], rcond=DETERMINED)[0]
    return np.asarray(step / norms * problem.scale)


def compute_gain(before: Iterable[Series], after: Iterable[Series]) -> float:
    """Return the decrease of minus twice the log-likelihood between two sets of simulated series.

    Both sets have the sample weights of ``before``. If the measured values of the two sets differ, each error
    is divided by the measured range of its channel (for positions, by one common range). A simulation that
    diverges has no likelihood.
    """
    first = {(s.trial, s.channel): s for s in before}
    last = {(s.trial, s.channel): s for s in after}
    sizes, other_sizes = _ranges(first.values()), _ranges(last.values())
    rows: tuple[list[tuple[str, NoiseRows]], list[tuple[str, NoiseRows]]] = [], []
    for key in (key for key in first if key in last):
        there = np.isfinite(first[key].residual)
        if not there.any():
            continue
        errors = [side[key].residual[there] / first[key].sd[there] for side in (first, last)]
        if sizes[key] > 0.0 and other_sizes[key] > 0.0:
            errors[1] *= sizes[key] / other_sizes[key]
        if not (np.abs(errors[1]) < BROKEN_RESIDUAL).all():
            return -math.inf
        for side, error in zip(rows, errors, strict=True):
            side.append((key[1], NoiseRows.alone(first[key].time_s, there, error)))
    posteriors = [_weigh_noise(side).values() for side in rows]
    old, new = (sum(posterior.log_likelihood for posterior in side) for side in posteriors)
    return 2.0 * (new - old)


def _ranges(series: Iterable[Series]) -> dict[tuple[str, str], float]:
    """Return the measured range by trial and channel. All coordinates of a position have the same range."""
    spans = {
        (s.trial, s.channel): float(np.ptp(s.measured[there]))
        for s in series
        if (there := np.isfinite(s.measured)).any()
    }
    found = {}
    for trial, channel in spans:
        group = POSITIONS if channel in POSITIONS else (channel,)
        found[trial, channel] = math.hypot(*(spans.get((trial, name), 0.0) for name in group))
    return found


def _weigh_noise(rows: Iterable[tuple[str, NoiseRows]]) -> dict[str, NoisePosterior]:
    """Return the probabilities of the noise models of each channel, from the residuals of its trials."""
    channels: dict[str, dict[int, NoiseRows]] = {}
    for channel, part in rows:
        parts = channels.setdefault(channel, {})
        parts[len(parts)] = part
    return {channel: compute_posterior(parts) for channel, parts in channels.items()}


# ---------------------------------------------------------------- rivals that concern single trials


def find_odd_trial(stated: FitResult) -> Judged | None:
    """Return the alternative fit in which one trial has its own values of all parameters.

    Return None if no such fit is better than the original one. The returned fit is that of the other trials.
    """
    names = [t.id for t in stated.trials if t.role == "fit"]
    if len(names) < MIN_TRIALS_RIVAL:
        return None
    before, found = compute_deviance(stated, [stated]), []
    for name in names:
        parts = [tuple(t for t in stated.trials if (t.id == name) is alone) for alone in (False, True)]
        both = [Rival(name, stated.parameters, part) for part in parts]
        others, own = (refit(stated, rival, max_iterations=UNFINISHED_ITERATIONS) for rival in both)
        if others is not None and own is not None:
            price = len(stated.common_labels) * math.log(stated.samples) + 2.0 * math.log(len(names))
            score = before - compute_deviance(stated, [others, own]) - price
            found.append(Judged(both[0], others, score))
    best = max(found, key=lambda judged: judged.score, default=None)
    if best is None or not best.is_better:
        return None
    return best


def compute_trend_score(value: Array, covariance: Array, setting: Array) -> float:
    """Return the score of a linear dependence of a parameter on a setting of the trials.

    The alternative is that the values of the trials differ at random from a common value. Both hypotheses
    have the restricted likelihood [3]_.

    Parameters
    ----------
    value, setting : ndarray, shape (n,)
        Estimate of a parameter and value of the setting in each trial.
    covariance : ndarray, shape (n, n)
        Covariance of the estimates.
    """
    constant = np.ones((len(value), 1))
    contrasts = np.linalg.qr(np.column_stack((constant, np.eye(len(value))[:, 1:])))[0][:, 1:].T
    variances, vectors = np.linalg.eigh(contrasts @ covariance @ contrasts.T)
    turned = vectors.T @ contrasts
    largest = float(np.max(value**2, initial=1e-300))
    sizes = np.concatenate(([1e-12 * largest], np.geomspace(1e-10 * largest, 4.0 * largest, 60)))
    whole = np.maximum(variances, 0.0) + sizes[:, None]
    values, slopes = turned @ value, turned @ setting
    explained = np.sum(slopes * values / whole, axis=1) ** 2 / np.sum(slopes**2 / whole, axis=1)
    deviance = np.sum(np.log(whole) + values**2 / whole, axis=1)
    return float(np.min(deviance) - np.min(deviance - explained)) - math.log(len(value))
