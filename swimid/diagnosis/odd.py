"""Hypotheses that a single trial has parameters of its own, for example because its entry is wrong."""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from swimid.diagnosis import crossval, posterior
from swimid.diagnosis.crossval import NormalEquations, solved
from swimid.diagnosis.nominal import MIN_TRIALS
from swimid.diagnosis.posterior import Candidate, Posterior, Record
from swimid.diagnosis.settings import Folds
from swimid.diagnosis.study import Hypothesis, Study
from swimid.fitting.model import Array, Trial
from swimid.results import numbers

#: Minimum ratio of the posterior probabilities of the best hypotheses with and without an odd trial.
ODDS = 3.0
#: Maximum share of the excess of the other trials, if a trial is odd.
MAX_REST = 0.2
#: Minimum share of the squared gap that is due to an odd trial.
MIN_SHARE = 0.1
#: Maximum number of parameters that are named as differing in an odd trial.
MAX_NAMED = 2


class Odd(NamedTuple):
    """Trial with parameters of its own, and the fit of all trials that it was compared with."""

    trial: str
    fit: Hypothesis


def find(
    study: Study, fits: Sequence[Hypothesis], found: Posterior, record: Record, log_determinant: Array
) -> Odd | None:
    """Return the trial that most probably has parameters of its own, or None.

    The hypothesis of an odd trial is compared with all other hypotheses by the same posterior probability.

    Parameters
    ----------
    fits : sequence of Hypothesis
        Fits of all trials, to which the hypothesis of an odd trial is added.
    found : Posterior
        Probabilities of the hypotheses without an odd trial.
    log_determinant : ndarray, shape (folds,)
        Log-determinant that is subtracted from all deviances.
    """
    if not study.folds.whole or len(study.trials) <= MIN_TRIALS:
        return None
    candidates: dict[frozenset[str], tuple[Candidate, Odd]] = {}
    for fit in fits:
        for k, trial in enumerate(study.trials):
            names = frozenset({*(e.name for e in fit.effects), f"trial:{trial.id}"})
            deviances, strain = _deviances(study, fit, k)
            one = Candidate(names, deviances - log_determinant, strain, _numbers(fit))
            candidates[names] = one, Odd(trial.id, fit)
    null, *known = found.candidates
    every = posterior.posterior(null, [*known, *(c for c, _ in candidates.values())], record=record)
    best = max(candidates, key=lambda names: every.known[names])
    others = [p for names, p in every.known.items() if names not in candidates]
    if every.known[best] < ODDS * max([every.none, *others]):
        return None
    # A form error of the other hypothesis is a small share of the gap, and is spread over the trials.
    gap = found.excess[frozenset()]
    without = every.excess[frozenset(name for name in best if not name.startswith("trial:"))]
    if every.excess[best] > MAX_REST * without or without < MIN_SHARE * gap:
        return None
    # An effect that closes nearly all of the gap needs no odd trial. It may act in one trial only.
    if min(found.excess.values()) < MIN_SHARE * gap:
        return None
    return candidates[best][1]


def _numbers(fit: Hypothesis) -> int:
    """Return the number of shared parameters of the effects of a fit."""
    return sum("/" in label and "[" not in label for label in fit.labels)


def _deviances(study: Study, fit: Hypothesis, k: int) -> tuple[Array, float]:
    """Return deviances and strain if trial ``k`` has own values of all shared parameters."""
    alone = copy.copy(study)
    others = copy.copy(study)
    count = study.folds.count
    owner = study.folds.owner
    one = [rows if i == k else np.full(len(rows), count) for i, rows in enumerate(owner)]
    rest = [rows if i != k else np.full(len(rows), count) for i, rows in enumerate(owner)]
    alone.folds, others.folds = Folds(True, one, count + 1), Folds(True, rest, count + 1)
    found = crossval.normal_equations(others, fit)
    parts = {name: getattr(found, name)[:-1] for name in ("products", "samples", "own")}
    equations = replace(found, **parts)
    distance, log = crossval.deviances(equations)
    own = crossval.normal_equations(alone, fit)
    f = int(owner[k][0])
    distance[f] += _evidence(own, f)
    return np.asarray(distance + log), crossval.strain(equations)


def _evidence(equations: NormalEquations, f: int) -> float:
    """Return minus twice the log evidence of one fold with own values of the shared parameters."""
    shared = equations.shared
    inner = equations.products[f]
    normal = inner[:shared, :shared] + equations.prior
    pulled = equations.prior @ equations.pull
    right = inner[:shared, -1] + pulled
    scale = 1.0 / np.sqrt(np.maximum(np.diag(equations.prior), 1e-300))
    log = float(np.linalg.slogdet(scale[:, None] * normal * scale)[1])
    taken = float(right @ solved(normal, right[:, None])[:, 0])
    return float(inner[-1, -1]) + float(equations.pull @ pulled) - taken + log


def describe(study: Study, odd: Odd) -> str | None:
    """Return the parameters that differ most in the odd trial, as text; None if no parameters explain it.

    They are fitted to this trial alone and to the other trials, beginning at the fit to all trials.
    """
    fit = odd.fit
    k = next(i for i, trial in enumerate(study.trials) if trial.id == odd.trial)
    rest = [t for i, t in enumerate(study.trials) if i != k]
    before = study.noise.whiten(fit.problem, k, fit.residuals[k])
    one, other = (_fitted(study, fit, trials) for trials in ([study.trials[k]], rest))
    excess, left = float(before @ before) - len(before), one.squares - len(before)
    if left > MAX_REST * excess:
        return None
    changes = []
    for p in (p for p in study.parameters if p.name in one.values and p.name in other.values):
        (value, sd), (usual, other_sd) = one.values[p.name], other.values[p.name]
        size = abs(value - usual) / max(math.hypot(sd, other_sd), 1e-300)
        text = f"{p.name} {numbers.measured(value, sd, p.unit)} in place of {numbers.number(usual, 3)}"
        changes.append((size, text))
    changes.sort(key=lambda change: -change[0])
    return " and ".join(text for size, text in changes[:MAX_NAMED] if size > 2.0) or None


class _Own(NamedTuple):
    """Fit of some trials: estimates and standard errors by label, and sum of whitened squared residuals."""

    values: dict[str, tuple[float, float]]
    squares: float


def _fitted(study: Study, fit: Hypothesis, trials: Sequence[Trial]) -> _Own:
    """Return a fit of the model of another fit to some of its trials."""
    problem = study.problem(fit.effects, trials=trials, jobs=1)
    study.noise.of_new_trials(problem)
    noise = study.noise.plain
    problem.whiten = lambda i, rows: noise.whiten(problem, i, rows)
    known = dict(zip(fit.labels, fit.theta, strict=True))
    start = np.array([known.get(n, s) for n, s in zip(problem.labels, problem.start, strict=True)])
    found = problem.solve(start, tolerance=1e-3, max_iterations=15, secant=True)
    parts = [problem.trial_jacobians(found.x)[i] for i in range(len(trials))]
    rows = np.concatenate([noise.whiten(problem, i, part) for i, part in enumerate(parts)])
    variance = max(found.cost / max(len(rows) - len(found.x), 1), 1.0)
    covariance = variance * np.linalg.pinv(rows.T @ rows, hermitian=True)
    sd = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    values = zip(found.x.tolist(), sd.tolist(), strict=True)
    return _Own(dict(zip(problem.labels, values, strict=True)), found.cost)
