"""Hypotheses that a single trial has parameters of its own, for example because its entry is wrong."""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag

from swimid.diagnosis import crossval, noise, posterior
from swimid.diagnosis.crossval import NormalEquations, solve_normal
from swimid.diagnosis.noise import BETWEEN, RandomCandidate, RandomEffect, Scatter
from swimid.diagnosis.nominal import MIN_RANDOM_TRIALS, OWN_PRIOR
from swimid.diagnosis.posterior import CALIBRATED, Candidate, DataSize
from swimid.diagnosis.settings import Folds
from swimid.diagnosis.study import EFFECT_PRIOR, MAX_FOLD_ITERATIONS, GapStudy, Hypothesis
from swimid.fitting import mistakes
from swimid.fitting.model import Array, Trial
from swimid.fitting.problem import Problem
from swimid.results import numbers

#: Minimum ratio of the posterior probabilities of the best hypotheses with and without an odd trial.
MIN_ODDS_RATIO = 3.0
#: Maximum number of parameters that are named as differing in an odd trial.
MAX_ODD_PARAMETERS = 2


class OddTrial(NamedTuple):
    """Trial with parameters of its own, or with a recording mistake.

    The attribute ``fit`` is the fit of all trials with which the odd trial was compared. The attribute
    ``mistake`` describes the recording mistake by its correction.
    """

    trial: str
    fit: Hypothesis
    mistake: str = ""


def find_contradicting_trial(
    fits: Sequence[Hypothesis], record: DataSize, differing: Sequence[RandomCandidate] = ()
) -> OddTrial | None:
    """Return the trial that most probably has parameters of its own or a recording mistake, or None.

    The hypothesis of an odd trial is compared with all other hypotheses by the same posterior probability.

    Parameters
    ----------
    fits : sequence of Hypothesis
            Fits of all trials, to which the hypothesis of an odd trial is added. The model without effects is
            the first one. In these fits, each trial has random values of the quantities that may differ by
            chance (:func:`add_random_effects`).
    differing : sequence of RandomCandidate
        Quantities that may differ by chance, of which an odd trial may have any value.
    """
    study = fits[0].study
    if not study.folds.whole or len(study.trials) <= MIN_RANDOM_TRIALS:
        return None
    log_determinant = fits[0].log_determinant
    known = [Candidate(h.names, h.deviances - log_determinant, h.strain, _numbers(h)) for h in fits]
    candidates: dict[frozenset[str], tuple[Candidate, OddTrial]] = {}
    for fit in fits:
        tried = [
            (OddTrial(trial.id, fit), *_deviances(study, fit, k, differing))
            for k, trial in enumerate(study.trials)
        ]
        mistaken = _undo_mistakes(fit) if fit in fits[:2] else []
        for odd, deviances, strain in [*tried, *mistaken]:
            names = frozenset({*fit.names, f"trial:{odd.trial}{odd.mistake}"})
            candidates[names] = Candidate(names, deviances - log_determinant, strain, _numbers(fit)), odd
    null, *others = known
    every = posterior.compute_posterior_probabilities(
        null, [*others, *(c for c, _ in candidates.values())], record=record
    )
    best = max(candidates, key=lambda names: every.probabilities[names])
    rest = [p for names, p in every.probabilities.items() if names not in candidates]
    if every.probabilities[best] < MIN_ODDS_RATIO * max([every.none, *rest]):
        return None
    # Even a true effect may leave a part of the gap, because its form is not exact. An odd trial must explain
    # nearly all of that part.
    if every.excess[best] > CALIBRATED.form * min(every.excess[c.names] for c in known):
        return None
    return candidates[best][1]


def add_random_effects(study: GapStudy, differing: Sequence[RandomCandidate]) -> GapStudy:
    """Return a study in which each trial has random values of all quantities that may differ by chance."""
    has_few = min(study.shape.counts, default=0) <= len(differing)
    if has_few or not study.folds.whole or len(study.trials) < MIN_RANDOM_TRIALS:
        return study
    return _with_random(study, {d.effect: noise.BESIDE_GAP for d in differing})


def _with_random(study: GapStudy, sizes: Mapping[Scatter, float]) -> GapStudy:
    random = tuple(RandomEffect(effect.label, sd, effect) for effect, sd in sizes.items())
    return study.with_noise(replace(study.noise, random_effects=random))


def _undo_mistakes(fit: Hypothesis) -> list[tuple[OddTrial, Array, float]]:
    """Return the deviances and strain after each possible recording mistake is undone in one trial.

    The trial is the one with the largest error. The result is empty if noise explains this error.
    """
    study = fit.study
    owners = [int(owner[0]) for owner in study.folds.owner]
    counts = np.bincount(owners, fit.problem.counts, study.folds.count)
    f = int(np.argmax(fit.deviances - fit.log_determinant - counts))
    if fit.deviances[f] - fit.log_determinant[f] < counts[f] + 2.0 * math.sqrt(2.0 * counts[f]):
        return []
    trial, found = study.trials[owners.index(f)], []
    shared = {fit.labels[j]: float(fit.theta[j]) for j in study.select_shared(fit)}
    before = _fit_trials(study, fit, [trial], shared, iterations=MAX_FOLD_ITERATIONS)
    for mistake in mistakes.list_mistakes(study.model, [trial]):
        undone = mistake.undo(trial)
        if undone is None:
            continue
        undone = replace(undone, id=f"{trial.id} ({mistake.says})")
        after = _fit_trials(study, fit, [undone], shared, iterations=MAX_FOLD_ITERATIONS)
        deviances = fit.deviances.copy()
        deviances[f] += after.excess - before.excess - 2.0 * _log_scale(trial, undone)
        found.append((OddTrial(trial.id, fit, mistake.says), deviances, fit.strain))
    return found


def _log_scale(trial: Trial, undone: Trial) -> float:
    """Return the logarithm of the factor by which undoing a mistake multiplies the volume of the samples.

    The density of the measured samples is that of the corrected ones times this factor.
    """
    total = 0.0
    for channel, values in trial.measured.items():
        spread, other = (float(np.nanstd(v)) for v in (values, undone.measured[channel]))
        if spread > 0.0 and other > 0.0:
            total += int(np.isfinite(values).sum()) * math.log(other / spread)
    return total


def _numbers(fit: Hypothesis) -> int:
    """Return the number of shared parameters of the effects of a fit."""
    return sum("/" in label and "[" not in label for label in fit.labels)


def _deviances(
    study: GapStudy, fit: Hypothesis, k: int, differing: Sequence[RandomCandidate]
) -> tuple[Array, float]:
    """Return deviances and strain if trial ``k`` has own values of all shared parameters and quantities."""
    alone, others = copy.copy(study), copy.copy(study)
    count, owner = study.folds.count, study.folds.owner
    for part, is_alone in ((alone, True), (others, False)):
        rows = [own if (i == k) == is_alone else np.full(len(own), count) for i, own in enumerate(owner)]
        part.folds = Folds(True, rows, count + 1)
    found = crossval.form_normal_equations(others, fit)
    parts = {name: getattr(found, name)[:-1] for name in ("products", "samples", "own", "random", "spread")}
    equations = replace(found, **parts)
    distance, log = crossval.compute_deviances(equations)
    own = crossval.form_normal_equations(alone, fit, [d.changes for d in differing])
    f = int(owner[k][0])
    mean, weight = _wide(study, fit.problem)
    shared = study.select_shared(fit)
    distance[f] += _evidence(own, f, (mean - fit.theta)[shared], weight[shared])
    return np.asarray(distance + log), crossval.compute_strain(equations)


def _wide(study: GapStudy, problem: Problem) -> tuple[Array, Array]:
    """Return prior means and inverse standard deviations of the parameters of an odd trial.

    The standard errors of the parameter file do not apply to a trial that differs from all others.
    """
    mean, weight = study.compute_prior(problem)
    for j, (index, owner) in enumerate(problem.slots):
        p = problem.parameters[index]
        if owner is None and "/" not in p.name:
            weight[j] = 1.0 / (OWN_PRIOR * max(abs(p.start), p.scale))
    return mean, weight


def _evidence(equations: NormalEquations, f: int, pull: Array, weight: Array) -> float:
    """Return minus twice the log evidence of one fold with own values of the shared parameters.

    Parameters
    ----------
    pull, weight : ndarray, shape (shared,)
        Prior means minus estimates, and inverse prior standard deviations. Further columns have the prior
        standard deviation of the size of an effect.
    """
    inner, more = equations.products[f], equations.products.shape[1] - 1 - equations.n_shared
    prior = block_diag(np.diag(weight**2), np.eye(more) / EFFECT_PRIOR**2)
    off = np.concatenate((pull, np.zeros(more)))
    normal, pulled = inner[:-1, :-1] + prior, prior @ off
    right = inner[:-1, -1] + pulled
    scale = 1.0 / np.sqrt(np.maximum(np.diag(prior), 1e-300))
    log = float(np.linalg.slogdet(scale[:, None] * normal * scale)[1])
    taken = float(right @ solve_normal(normal, right[:, None])[:, 0])
    return float(inner[-1, -1]) + float(off @ pulled) - taken + log


def describe(odd: OddTrial, differing: Sequence[RandomCandidate] = ()) -> str | None:
    """Return a text on the parameters that differ in the odd trial; None if no parameter explains it.

    The parameters are fitted to the other trials. Those that explain the odd trial best are then fitted to it
    alone, one by one, and at most :data:`MAX_ODD_PARAMETERS` together.
    """
    if odd.mistake:
        return f"with {odd.mistake}, the trial agrees with the other trials"
    fit, study = odd.fit, odd.fit.study
    (trial,) = (t for t in study.trials if t.id == odd.trial)
    others = _fit_trials(study, fit, [t for t in study.trials if t is not trial], {})
    shared = {label: value for label, (value, _) in others.values.items() if "[" not in label}
    free = {f"{BETWEEN}{d.effect.label}/deviation[{trial.id}]": d.effect for d in differing}

    def try_parameters(chosen: Sequence[str]) -> _TrialFit:
        known = {name: value for name, value in shared.items() if name not in chosen}
        sizes = {e: EFFECT_PRIOR if label in chosen else noise.BESIDE_GAP for label, e in free.items()}
        return _fit_trials(_with_random(study, sizes), fit, [trial], known)

    chosen: list[str] = []
    excess = try_parameters(chosen).excess
    while len(chosen) < min(MAX_ODD_PARAMETERS, len(shared) + len(free)):
        found = {label: try_parameters([*chosen, label]) for label in (*shared, *free) if label not in chosen}
        chosen.append(min(found, key=lambda label: found[label].excess))
        one = found[chosen[-1]]
        if one.excess > CALIBRATED.form * excess:
            continue
        return _describe_parameters(one, others, chosen)
    return None


def _describe_parameters(odd: _TrialFit, others: _TrialFit, labels: Sequence[str]) -> str | None:
    """Return text with the values of parameters of an odd trial and of the others; None if they agree."""
    texts = []
    for label in labels:
        (value, sd), (before, other_sd) = odd.values[label], others.values.get(label, (0.0, 0.0))
        if not abs(value - before) > 2.0 * math.hypot(sd, other_sd):
            return None
        name = label.split("[")[0]
        unit = next(p.unit for p in odd.problem.parameters if p.name == name)
        shown = name.removeprefix(BETWEEN).removesuffix("/deviation")
        changed = numbers.format_estimate(value, sd, unit)
        texts.append(f"{shown} {changed} in place of {numbers.format_number(before, 3)}")
    return " and ".join(texts)


class _TrialFit(NamedTuple):
    """Fit of some trials: problem, estimates and standard errors by label, and excess squared residuals."""

    problem: Problem
    values: dict[str, tuple[float, float]]
    excess: float


def _fit_trials(
    study: GapStudy,
    fit: Hypothesis,
    trials: Sequence[Trial],
    known: Mapping[str, float],
    *,
    iterations: int = 15,
) -> _TrialFit:
    """Return a fit of the model of ``fit`` to some of its trials, with wide priors.

    Parameters
    ----------
    known : mapping of label to float
        Shared parameters that are held at these values.
    """
    problem = study.problem(fit.effects, trials=trials, known=known, jobs=1)
    study.noise.of_new_trials(problem)
    problem.whiten = lambda i, rows: study.noise.whiten(problem, i, rows)
    mean, weight = _wide(study, problem)
    problem.prior = mean, np.diag(weight)[weight > 0.0]
    begin = dict(zip(fit.labels, fit.theta, strict=True))
    theta = np.array([begin.get(n, s) for n, s in zip(problem.labels, problem.start, strict=True)])
    if len(theta):
        theta = problem.solve(theta, tolerance=1e-3, max_iterations=iterations, secant=True).x
    jacobian = np.concatenate([problem.whiten(i, r) for i, r in enumerate(problem.trial_jacobians(theta))])
    residuals = [problem.whiten(i, problem.trial_residuals(theta, i)) for i in range(len(trials))]
    squares = float(sum(np.sum(r**2) for r in residuals))
    excess = squares + float(np.sum((weight * (theta - mean)) ** 2)) - len(jacobian)
    variance = max(squares / max(len(jacobian) - len(theta), 1), 1.0)
    covariance = variance * np.linalg.pinv(jacobian.T @ jacobian + np.diag(weight**2), hermitian=True)
    sd = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    values = zip(theta.tolist(), sd.tolist(), strict=True)
    return _TrialFit(problem, dict(zip(problem.labels, values, strict=True)), excess)
