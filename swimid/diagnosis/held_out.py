"""Predict held-out data, and compare their squared errors with those that a correct model would have.

Held-out data are validation trials, or cross-validation folds. Each model is refitted to the other data. The
squared error is the squared Mahalanobis distance from the prediction. The covariance of the prediction has
the noise, the random effects, and the uncertainty of the parameters.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy import special

from swimid.diagnosis import crossval
from swimid.diagnosis.gap_file import Closed, HeldOutTrial, Shrinkage, WaterfallStep
from swimid.diagnosis.noise import BETWEEN, NoiseModel, find_basis, join_channels
from swimid.diagnosis.posterior import CALIBRATED, MODEL_ERROR_SHARE
from swimid.diagnosis.study import FINE, GapStudy, Hypothesis
from swimid.fitting.model import Array, Trial
from swimid.fitting.problem import Problem

#: Probability that a correct model has at least one held-out trial above its limit.
FALSE_ALARM_RATE = 0.025
#: Minimum squared gap, as a fraction of the squared error, for a closed share. The share of a smaller gap is
#: a ratio of differences of nearly equal numbers.
LEAST_GAP = 0.04
#: Maximum width of the interval of a closed share that is stated.
MAX_INTERVAL_WIDTH = 1.0
#: Number of random errors of the parameters from which the interval of a closed share is computed.
DRAWS = 1000
#: Largest squared error of a sample, in units of the noise variance. A simulation with a larger error
#: diverged.
MAX_SQUARED_ERROR = 1e12


@dataclass(frozen=True)
class Prediction:
    """Prediction of the held-out samples of one part by a model that was fitted to the other parts.

    Attributes
    ----------
    part : str
        Name of the trial, and of its part if only a part is held out.
    residuals : dict of channel to ndarray, shape (n,)
            Measured minus predicted values, in the unit of the channel; NaN at samples that are not held out.
            The initial state is fitted to the part. Random effects have their values in the model with the
            causes, so that all models have the same differences between trials.
    squared : float
        Squared Mahalanobis distance of the samples from their prediction. The covariance has the noise, the
        random effects, and the uncertainty of the parameters.
    expected : int
        Mean of the squared distance for a correct model.
    samples : int
        Number of held-out samples.
    deviance : float
        Minus twice the log predictive density of the samples, up to a constant.
    """

    trial: Trial
    part: str
    residuals: dict[str, Array]
    squared: float
    expected: int
    samples: int
    deviance: float

    def limit(self, count: int) -> float:
        """Largest squared distance that noise explains, if ``count`` parts are held out.

        The squared distance of a correct model has a chi-squared distribution. To its quantile, the limit
        adds a model error of a tenth of the noise, and a discrepancy as large as the noise in a few
        directions (:func:`swimid.diagnosis.posterior.compute_tolerance`).
        """
        largest = float(special.chdtri(self.expected, FALSE_ALARM_RATE / max(count, 1)))
        return largest + MODEL_ERROR_SHARE**2 * self.samples + CALIBRATED.directions


def _predict_part(
    fit: Hypothesis,
    noise: NoiseModel,
    apart: Mapping[str, float],
    at: tuple[Problem, int, Array],
    part: str,
    chosen: NDArray[np.bool_],
    *,
    columns: Callable[[NDArray[np.intp]], Array],
    moved: Array,
    own: NDArray[np.intp],
) -> Prediction:
    """Return the prediction of some samples of a trial by a fit.

    Parameters
    ----------
    apart : mapping of label to float
        Random effects of the trials.
    at : tuple of Problem, int and ndarray
        Problem that has the trial, index of the trial in it, and parameters fitted without these samples.
    chosen : ndarray of bool, shape (n,)
        Mask of the samples.
    columns : callable
            Function that returns the weighted derivatives of the trial with respect to the parameters at some
            indices.
    moved : ndarray, shape (n, m)
        Changes of the trial by independent standard errors of the shared parameters.
    own : ndarray of int
        Indices of the parameters that are refitted to the held-out samples.
    """
    problem, k, theta = at
    chosen = chosen & (problem.sample_weights(k) > 0.0)
    random = fit.study.random(problem, k)
    weight, own_columns = fit.study.compute_prior(problem)[1][random], columns(own)
    # Set the random effects to their means in the residual, which is linearised about their fitted values.
    residual = _limit_errors(problem.trial_residuals(theta, k) + columns(random) @ theta[random])
    chance = columns(random) / weight
    usual = residual - chance @ (np.array([apart.get(problem.labels[j], 0.0) for j in random]) * weight)
    seen = noise.whiten(problem, k, np.column_stack((residual, moved, chance, own_columns, usual)))[chosen]
    count = 1 + moved.shape[1] + chance.shape[1]
    own_seen = seen[:, count:-1]
    basis = find_basis(own_seen)
    free = seen[:, :count] - basis @ (basis.T @ seen[:, :count])
    r, uncertain = free[:, 0], free[:, 1:]
    # Use singular values: in products of columns, the noise is lost beside a large uncertainty.
    axes, sizes, _ = np.linalg.svd(uncertain, full_matrices=False)
    gained = sizes**2
    squared = float(r @ r) - float((axes.T @ r) ** 2 @ (gained / (1.0 + gained)))
    deviance = squared + float(np.log1p(gained).sum())
    values = crossval.solve_normal(own_seen.T @ own_seen, own_seen.T @ seen[:, -1:])[:, 0]
    left = np.full(len(chosen), np.nan)
    left[chosen] = (usual - own_columns @ values)[chosen]
    residuals = {}
    for channel, mask, rows in problem.by_channel(k, np.column_stack((left, problem.sample_weights(k)))):
        there = np.isfinite(rows[:, 0]) & (rows[:, 1] > 0.0)
        if there.any():
            residuals[channel] = np.full(len(mask), np.nan)
            residuals[channel][np.flatnonzero(mask)[there]] = rows[there, 0] / rows[there, 1]
    expected = max(len(r) - basis.shape[1], 1)
    return Prediction(problem.trials[k], part, residuals, squared, expected, len(r), deviance)


def _limit_errors(residuals: Array) -> Array:
    """Return residuals limited to the largest ones that do not count as diverged."""
    largest = math.sqrt(MAX_SQUARED_ERROR)
    return np.asarray(np.clip(residuals, -largest, largest))


def root_of(covariance: Array) -> Array:
    """Return a square root of a covariance matrix, without negative eigenvalues by rounding."""
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))


def fit_as_given(study: GapStudy) -> Hypothesis:
    """Return the model with its shared parameters as given, and the initial state of each trial fitted."""
    shared = {p.name: p.start for p in study.parameters if not p.per_trial}
    problem = study.problem((), known=shared)
    return study.fit((), [np.clip(problem.start, problem.lower, problem.upper)], tolerance=FINE, known=shared)


def predict_parts(
    fits: Sequence[Hypothesis],
    validation: Sequence[Trial],
    noise: NoiseModel,
    step: Callable[[], None] = lambda: None,
) -> list[list[Prediction]]:
    """Return the predictions of all held-out parts by each model.

    Each cross-validation fold is held out once. Validation trials are held out of all fits.

    Parameters
    ----------
    fits : sequence of Hypothesis
        Models, fitted to all trials.
    noise : NoiseModel
        Noise and random effects that the held-out parts are expected to have.
    """
    last = fits[-1]
    values = {name: value for name, value in zip(last.labels, last.theta, strict=True) if _is_random(name)}
    for trial in validation:
        problem, theta = fit_further_trial(last, trial, noise)
        values |= {name: v for name, v in zip(problem.labels, theta, strict=True) if _is_random(name)}
    found = []
    for fit in fits:
        each = (_of_validation(fit, trial, noise, values) for trial in validation)
        found.append([*_of_folds(fit, noise, values), *each])
        step()
    return found


def _is_random(label: str) -> bool:
    """Return whether a label is that of a random effect in a trial."""
    return label.startswith(BETWEEN)


def _of_folds(fit: Hypothesis, noise: NoiseModel, apart: Mapping[str, float]) -> list[Prediction]:
    study, folds, problem = fit.study, fit.study.folds, fit.problem
    shared = study.select_shared(fit)
    _, each = crossval.compute_covariances(crossval.form_normal_equations(study, fit))
    found = []
    for f, theta in enumerate(study.refit_folds(fit) if len(shared) else [fit.theta] * folds.count):
        for k, trial in enumerate(study.trials):
            chosen = folds.owner[k] == f
            if not chosen.any():
                continue
            part = trial.id
            if not folds.whole:
                part += f", part {1 + f % max(folds.count // len(study.trials), 1)}"
            moved = fit.columns(k, shared) @ root_of(each[f])
            own = study.select_nonrandom(problem, k, study.select_own(fit, k))
            columns, at = partial(fit.columns, k), (problem, k, theta)
            found.append(
                _predict_part(fit, noise, apart, at, part, chosen, columns=columns, moved=moved, own=own)
            )
    return found


def _collect_shared(fit: Hypothesis) -> dict[str, float]:
    """Return the values of the parameters that all trials share, estimated or fixed, by name."""
    shared = {p.name: p.start for p in fit.problem.parameters if not p.per_trial and not p.free}
    for j, (_, owner) in enumerate(fit.problem.slots):
        if owner is None:
            shared[fit.labels[j]] = float(fit.theta[j])
    return shared


def fit_further_trial(fit: Hypothesis, trial: Trial, noise: NoiseModel) -> tuple[Problem, Array]:
    """Return the residual problem of a further trial, and its parameters.

    The parameters that only this trial has are fitted to it.
    """
    study, known = fit.study, _collect_shared(fit)
    problem = study.problem(fit.effects, trials=[trial], known=known, jobs=1)
    noise.of_new_trials(problem)
    problem.prior = study.compute_prior(problem)[0], study.root(problem)
    theta = problem.start
    if len(theta):
        theta = problem.solve(theta, tolerance=FINE, max_iterations=30, secant=True).x
    whole = study.problem(fit.effects, trials=[trial], jobs=1)
    whole.sd = problem.sd
    here = dict(zip(problem.labels, theta, strict=True)) | known
    point = np.array([here.get(label, start) for label, start in zip(whole.labels, whole.start, strict=True)])
    return whole, point


def _of_validation(
    fit: Hypothesis, trial: Trial, noise: NoiseModel, apart: Mapping[str, float]
) -> Prediction:
    study = fit.study
    whole, theta = fit_further_trial(fit, trial, noise)
    columns = -whole.trial_jacobians(theta)[0]
    covariance = crossval.compute_covariances(crossval.form_normal_equations(study, fit))[0]
    moved = _align_columns(fit, whole, columns) @ root_of(covariance)
    own, every = study.select_nonrandom(whole, 0, whole.own(0)), np.ones(len(columns), dtype=bool)
    return _predict_part(
        fit, noise, apart, (whole, 0, theta), trial.id, every,
        columns=lambda index: columns[:, index], moved=moved, own=own,
    )  # fmt: skip


def _align_columns(fit: Hypothesis, problem: Problem, columns: Array) -> Array:
    """Return the columns of another problem for the shared parameters of a fit; zero for those it lacks."""
    names = [fit.labels[j] for j in fit.study.select_shared(fit)]
    wide = np.column_stack((columns, np.zeros(len(columns))))
    return wide[:, [problem.labels.index(name) if name in problem.labels else -1 for name in names]]


def compute_closed(
    given: Hypothesis,
    refitted: Hypothesis,
    best: Hypothesis,
    validation: Sequence[Trial],
    noise: NoiseModel,
    parts: Sequence[Sequence[Prediction]],
) -> Closed:
    """Return the errors of three models on held-out data, and the shares of the gap that close.

    The gap of a model is its squared difference from the true motion without noise and without between-trial
    variation. The model with the causes is the best estimate of this motion. The gap of this model itself
    consists of the uncertainty of its parameters, and of the held-out error that it does not explain. The
    shares are medians over random errors of the parameters, with the interval of 95 %.

    Parameters
    ----------
    parts : sequence of sequence of Prediction
        Predictions by the three models.
    """
    study, shared = best.study, best.study.select_shared(best)
    root = root_of(crossval.compute_covariance(study, best)[np.ix_(shared, shared)])
    problems: list[tuple[Problem, int, Array, Array]] = [
        (best.problem, k, best.theta, best.columns(k, shared)) for k in range(len(study.trials))
    ]
    for trial in validation:
        problem, theta = fit_further_trial(best, trial, noise)
        columns = -problem.trial_jacobians(theta)[0]
        problems.append((problem, 0, theta, _align_columns(best, problem, columns)))
    gram, off = np.zeros((len(shared), len(shared))), np.zeros(2)
    cross = np.zeros((2, len(shared)))
    for problem, k, theta, columns in problems:
        typical = {n: 0.0 if _is_random(n) else v for n, v in zip(problem.labels, theta, strict=True)}
        moved = noise.standardise(problem, k, columns @ root)
        gram += moved.T @ moved
        here = _motion(best, problem.trials[k], problem, k, typical)
        for i, fit in enumerate((given, refitted)):
            other = _motion(fit, problem.trials[k], problem, k, typical | _collect_shared(fit))
            apart = _limit_errors(noise.standardise(problem, k, other - here))
            off[i] += float(apart @ apart)
            cross[i] += moved.T @ apart
    # An excess of up to two standard deviations of chi-squared may be noise.
    count = sum(p.expected for p in parts[-1])
    left = max(sum(p.squared for p in parts[-1]) - count - math.sqrt(8.0 * count), 0.0)
    drawn = np.random.default_rng(0).standard_normal((DRAWS, len(shared)))
    after = np.einsum("ri,ij,rj->r", drawn, gram, drawn) + left
    before, between = (np.maximum(off[i] + 2.0 * drawn @ cross[i] + after, 1e-300) for i in (0, 1))
    errors = [sum(p.squared for p in each) / sum(p.expected for p in each) for each in parts]
    low, share, high = np.quantile(1.0 - after / before, (0.025, 0.5, 0.975)).tolist()
    return Closed(
        before=errors[0],
        refitted=errors[1],
        after=errors[2],
        share=share,
        ci95=(low, high) if high - low <= MAX_INTERVAL_WIDTH else (None, None),
        by_refit=float(np.median(1.0 - between / before)),
        by_causes=float(np.median(1.0 - after / between)),
    )


def _motion(fit: Hypothesis, trial: Trial, problem: Problem, k: int, known: Mapping[str, float]) -> Array:
    """Return the weighted samples of a trial that a model simulates with known parameters."""
    model = fit.problem.model
    values = [known.get(f"{p.name}[{trial.id}]", known.get(p.name, p.start)) for p in model.parameters]
    return problem.stack(k, model.run(np.array(values), trial)) * problem.sample_weights(k)


# ---------------------------------------------------------------- tables of the answer


def tabulate_parts(
    given: Sequence[Prediction], before: Sequence[Prediction], after: Sequence[Prediction]
) -> dict[str, HeldOutTrial]:
    """Return the squared distance of each held-out part from each model: as given, refitted, with causes."""
    return {
        last.part: HeldOutTrial(
            samples=last.samples,
            as_given=one.squared,
            before=other.squared,
            after=last.squared,
            expected=last.expected,
            limit=last.limit(len(after)),
            gain=other.deviance - last.deviance,
            gain_as_given=one.deviance - last.deviance,
        )
        for one, other, last in zip(given, before, after, strict=True)
    }


def build_waterfall(
    steps: Mapping[str, Sequence[Prediction]], floors: Mapping[str, float]
) -> list[WaterfallStep]:
    """Return the held-out errors of each model, divided by their expectation.

    Parameters
    ----------
    steps : mapping of str to sequence of Prediction
        Predictions of each model, by its label.
    floors : mapping of channel to float
        Noise of each channel, in its unit.
    """
    found = []
    for label, parts in steps.items():
        count = max(sum(p.expected for p in parts), 1)
        squared = sum(p.squared for p in parts) / count
        found.append(WaterfallStep(label=label, squared=squared, rmse=compute_rms_errors(parts)))
    channels = found[0].rmse if found else {}
    noise = {channel: floors.get(channel) for channel in channels}
    return [*found, WaterfallStep(label="noise alone", squared=1.0, rmse=noise)]


def compute_rms_errors(parts: Sequence[Prediction]) -> dict[str, float | None]:
    """Return the root-mean-square error of each channel, in its unit."""
    residuals = join_channels(part for p in parts for part in p.residuals.items())
    return {c: float(np.sqrt(np.mean(r[np.isfinite(r)] ** 2))) for c, r in residuals.items()}


def compute_closed_share(before: float, after: float, expected: float) -> float | None:
    """Return the closed share of a squared gap, at most 1; None without a gap.

    The share is ``(before - after) / (before - expected)`` for squared errors.
    """
    gap = before - expected
    if not gap > LEAST_GAP * before:
        return None
    return min((before - after) / gap, 1.0)


def compute_shrinkages(
    given: Sequence[Prediction],
    before: Sequence[Prediction],
    after: Sequence[Prediction],
    floors: Mapping[str, float],
    ranges: Mapping[str, float],
) -> list[Shrinkage]:
    """Return the held-out errors and the closed share of the squared gap of each channel.

    Parameters
    ----------
    floors, ranges : mapping of channel to float
        Noise, and measured range in the fitted trials, of each channel, in its unit.
    """
    errors = [compute_rms_errors(parts) for parts in (given, before, after)]
    found = []
    for channel in errors[2]:
        size = ranges.get(channel) or 1.0
        shipped, refitted, last = (float(e[channel] or 0.0) / size for e in errors)
        floor = floors.get(channel, math.nan) / size
        closed = compute_closed_share(shipped**2, last**2, floor**2)
        sizes = {"shipped": shipped, "before": refitted, "after": last, "floor": floor}
        found.append(Shrinkage(channel=channel, closed=closed, **sizes))
    return found


@dataclass(frozen=True)
class HeldOutSeries:
    """Measured and predicted samples of one channel of a held-out trial, without and with the causes."""

    trial: Trial
    channel: str
    time_s: Array
    measured: Array
    before: Array
    after: Array


def select_worst(before: Sequence[Prediction], after: Sequence[Prediction]) -> list[HeldOutSeries]:
    """Return the channels of the held-out trial whose error is largest relative to its expectation."""
    if not after:
        return []
    ratios: dict[str, list[tuple[float, float]]] = {}
    for p in after:
        ratios.setdefault(p.trial.id, []).append((p.squared, p.expected))
    name = max(ratios, key=lambda n: sum(r[0] for r in ratios[n]) / sum(r[1] for r in ratios[n]))
    found = []
    mine = [(b, a) for b, a in zip(before, after, strict=True) if a.trial.id == name]
    trial = mine[0][1].trial
    for channel in mine[0][1].residuals:
        measured, missing = trial.measured[channel], np.full(len(trial.time_s), np.nan)
        # Each sample is held out in one part at most.
        predicted = [
            measured - np.fmax.reduce([missing, *(p.residuals.get(channel, missing) for p in parts)])
            for parts in zip(*mine, strict=True)
        ]
        found.append(HeldOutSeries(trial, channel, trial.time_s, measured, *predicted))
    return found


def is_finite(before: Sequence[Prediction], after: Sequence[Prediction]) -> bool:
    """Return whether no simulation of a held-out trial diverges because of the causes."""
    return not any(
        a.squared >= MAX_SQUARED_ERROR and b.squared < MAX_SQUARED_ERROR
        for b, a in zip(before, after, strict=True)
    )
