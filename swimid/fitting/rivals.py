"""Rivals of a fit: other hypotheses about the same trials, refitted and judged by one criterion.

A rival frees, fixes or replaces parameters, replaces trials, or gives one trial parameters of its own. The
score of a rival is the decrease of minus twice the log-likelihood of all residuals. The likelihood is
averaged over the forms of the noise (:mod:`swimid.fitting.noise`), with and without memory. Residuals that
are coloured, or that differ between trials, are noise with a memory under this likelihood. A rival must
explain more than such noise does. Each further unknown costs the logarithm of the number of samples [1]_. If
the trial or the mistake of a rival is one of m, the choice costs 2 log m. The score is then twice the
logarithm of the odds of the rival.

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

#: Score above which a rival is better than a fit, and minus the score down to which it is as good: strong
#: evidence (Kass and Raftery [2]_).
STRONG = 6.0
#: Start values of the search for a parameter that a rival frees. They are distances from the value at which
#: the parameter was held, in multiples of its typical scale.
FREED_STARTS: tuple[float, ...] = (0.0, 1.0, -1.0)
#: Maximum number of steps of generalised least squares, and smallest singular value of normalised derivatives
#: that determines a direction, as a fraction of the largest.
MAX_STEPS, DETERMINED = 5, 1e-4
#: Minimum number of trials for the search for a trial with parameters of its own, and for a parameter that
#: depends on a setting of the trials.
MIN_TRIALS_RIVAL = 4


@dataclass(frozen=True)
class Rival:
    """Changed hypothesis about the trials of a fit.

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
    """Rival of a fit, its own fit, and its score: twice the logarithm of the odds against the fit."""

    rival: Rival
    fit: FitResult
    score: float

    @property
    def is_better(self) -> bool:
        """Whether the evidence for the rival is strong."""
        return self.score > STRONG


def free(stated: FitResult, name: str) -> Rival:
    """Return the rival of a fit in which a held parameter is free."""
    return Rival(name, choose_parameters(stated.parameters, freed=(name,)), stated.trials)


def judge(stated: FitResult, rivals: Sequence[Rival]) -> list[Judged]:
    """Return the rivals that can be fitted with their scores, highest score first."""
    fits = [(rival, refit(stated, rival)) for rival in rivals]
    before = compute_deviance(stated, [stated])
    found = []
    for rival, fit in fits:
        if fit is not None:
            price = (len(fit.labels) - len(stated.labels)) * math.log(stated.samples)
            found.append(Judged(rival, fit, before - compute_deviance(stated, [fit]) - price))
    return sorted(found, key=lambda judged: -judged.score)


def refit(stated: FitResult, rival: Rival, **settings: Any) -> FitResult | None:
    """Return the fit of a rival with the lowest cost among several starts; None if all fits fail.

    The search begins at the estimates of the fit ``stated``, unless the rival changes trials. A parameter
    that only the rival estimates has several start values. The ``settings`` are those of
    :func:`swimid.fitting.output_error.fit_output_error`.
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
    """Return the start values of parameters from which a rival is fitted."""
    known = {}
    if all(any(trial is other for other in stated.trials) for trial in rival.trials):
        known = {label: stated.value(label) for label in stated.common_labels}
    freed = [p for p in rival.parameters if p.name == rival.name and p.free and p.name not in known]
    if not freed:
        return [known]
    values = [freed[0].start + step * freed[0].scale for step in FREED_STARTS]
    return [known | {rival.name: v} for v in values if freed[0].lower <= v <= freed[0].upper]


def compute_deviance(stated: FitResult, fits: Sequence[FitResult]) -> float:
    """Return minus twice the log-likelihood of all residuals, averaged over the forms of the noise.

    Least squares follows noise with a memory. The estimates are therefore moved by steps of generalised least
    squares under the most probable form of the noise.

    Parameters
    ----------
    stated : FitResult
        Fit whose weights the samples have.
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
    """Return the deviance of several problems at given points, and a step of each that may lower it.

    The steps are 0 if the most probable noise has no memory.
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
    """Return a step of generalised least squares under the most probable form of the noise, shape (p,)."""
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
    """Return the decrease of minus twice the log-likelihood from one set of simulations to another.

    The samples have the weights of ``before`` in both. If the measured values differ, the errors are compared
    with the measured range of the channel, or of the position. A simulation that diverges has no
    likelihood.
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
    """Return the measured range of each channel of each trial; coordinates of a position have one range."""
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
    """Return the probabilities of the forms of the noise of each channel from the residuals of its trials."""
    channels: dict[str, dict[int, NoiseRows]] = {}
    for channel, part in rows:
        parts = channels.setdefault(channel, {})
        parts[len(parts)] = part
    return {channel: compute_posterior(parts) for channel, parts in channels.items()}


# ---------------------------------------------------------------- rivals that concern single trials


def find_odd_trial(stated: FitResult) -> Judged | None:
    """Return the rival in which one trial has its own values of all parameters; None if it is not better.

    Its fit is that of the other trials.
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
    """Return the score of values that depend linearly on a setting of the trials.

    The values are compared with a random difference of each trial from a common value. Both have the
    restricted likelihood [3]_.

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
