"""Predict held-out data, and compare their squared errors with those that a correct model would have.

Held-out data are validation trials, or cross-validation folds. Each model is refitted to the other data. The
expected squared error of a correct model follows from the noise, from the random effects, and from the
uncertainty of the parameters.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import special

from swimid.diagnosis import crossval
from swimid.diagnosis.gap_file import HeldOutTrial, Shrinkage, Step
from swimid.diagnosis.noise import BETWEEN, NoiseModel, determined
from swimid.diagnosis.posterior import TENTH
from swimid.diagnosis.study import FINE, Hypothesis, Study
from swimid.fitting.model import Array, Trial
from swimid.fitting.noise import NoiseForm
from swimid.fitting.problem import Problem

#: Probability that a correct model has at least one held-out trial above its limit.
CHANCE = 0.025
#: Minimum share of the noise of a held-out part that a fit of its initial state leaves.
MIN_FREE = 0.05
#: Largest squared error of a sample, in units of the noise variance. The simulation of a larger one diverged.
WORST = 1e12


@dataclass(frozen=True)
class Prediction:
    """Prediction of the held-out samples of one trial by one model.

    Attributes
    ----------
    part : str
        Name of the trial, and of its part if only a part is held out.
    residuals : dict of channel to ndarray, shape (n,)
        Measured minus predicted values, in the unit of the channel; NaN at samples that are not held out.
    squares : dict of channel to float
        Sum of squared residuals of each channel, in units of the noise variance.
    expected, variance : float
        Mean and variance of the sum over channels if the model is correct.
    samples : int
        Number of held-out samples of channels whose noise is known.
    deviance : float
        Minus twice the log predictive density of the samples, up to a constant.
    """

    trial: Trial
    part: str
    residuals: dict[str, Array]
    squares: dict[str, float]
    expected: float
    variance: float
    samples: int
    deviance: float

    @property
    def squared(self) -> float:
        """Sum of squared residuals of all channels, in units of the noise variance."""
        return sum(self.squares.values())

    def limit(self, count: int) -> float:
        """Largest squared error that noise explains, if ``count`` parts are held out.

        The squared error is approximated by a scaled chi-squared variable (Satterthwaite). A model error of a
        tenth of the noise is allowed.
        """
        degrees = 2.0 * self.expected**2 / max(self.variance, 1e-300)
        largest = self.expected / degrees * float(special.chdtri(degrees, CHANCE / max(count, 1)))
        return largest + TENTH**2 * self.samples


@dataclass(frozen=True)
class Rows:
    """Rows of held-out samples of one trial: residuals, and derivatives of the predicted samples.

    Attributes
    ----------
    residual : ndarray, shape (n,)
        Weighted residual with the values of the random effects that the trial has.
    typical : ndarray, shape (n,)
        Weighted residual with the means of the random effects, linearised.
    shared : ndarray, shape (n, p)
        Weighted derivatives with respect to the shared parameters.
    covariance : ndarray, shape (p, p)
        Covariance of the shared parameters.
    own : ndarray, shape (n, m)
        Weighted derivatives with respect to the parameters that are refitted to the held-out samples.
    chance : ndarray, shape (n, q)
        Weighted changes by one standard deviation of each random effect.
    """

    residual: Array
    typical: Array
    shared: Array
    covariance: Array
    own: Array
    chance: Array

    def prediction(
        self, noise: NoiseModel, problem: Problem, k: int, part: str, chosen: NDArray[np.bool_]
    ) -> Prediction:
        """Return the prediction of the samples that a mask chooses."""
        trial, weights = problem.trials[k], problem.sample_weights(k)

        def standard(rows: Array) -> Array:
            return noise.standardise(problem, k, rows)[chosen]

        basis = determined(standard(self.own))

        def free(rows: Array) -> Array:
            return rows - basis @ (basis.T @ rows)

        left = np.clip(free(standard(self.residual)), -math.sqrt(WORST), math.sqrt(WORST))
        values, vectors = np.linalg.eigh(self.covariance)
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        moved = free(standard(self.shared @ root))
        gram = moved.T @ moved
        expected, variance = float(np.trace(gram)), 2.0 * float(np.sum(gram**2))
        residuals, squares, samples = {}, {}, 0
        taken = determined(standard(np.column_stack((self.own, self.chance))))
        whole, place = np.full((len(chosen), taken.shape[1] + 1), np.nan), np.flatnonzero(chosen)
        whole[place] = np.column_stack((left, taken))
        parts = zip(problem.by_channel(k, whole), problem.by_channel(k, weights), strict=True)
        for (channel, mask, series), (_, _, weight) in parts:
            there = np.isfinite(series[:, 0]) & (weight > 0.0)
            if not there.any():
                continue
            floor, own = noise.floor(channel), series[there, 1:]
            unit = np.full(len(mask), np.nan)
            unit[np.flatnonzero(mask)[there]] = series[there, 0] * floor / weight[there]
            residuals[channel], squares[channel] = unit, float(np.sum(series[there, 0] ** 2))
            count, time_s = int(there.sum()), trial.time_s[mask][there]
            samples += count
            single = float(noise.covariance(channel, time_s[:1], np.ones((1, 1)))[0, 0]) / floor**2
            absorbed = float(np.sum(own * noise.covariance(channel, time_s, own))) / floor**2
            expected += max(single * count - absorbed, MIN_FREE * count)
            variance += 2.0 * _squared_covariance(noise, channel, time_s) / floor**4
        deviance = self._deviance(noise, problem, k, chosen)
        return Prediction(trial, part, residuals, squares, expected, variance, samples, deviance)

    def _deviance(self, noise: NoiseModel, problem: Problem, k: int, chosen: NDArray[np.bool_]) -> float:
        """Return minus twice the log predictive density of the samples that a mask chooses."""
        values, vectors = np.linalg.eigh(self.covariance)
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        columns = np.column_stack((self.typical, self.shared @ root, self.chance, self.own))
        seen = noise.whiten(problem, k, columns)[chosen]
        count = self.shared.shape[1] + self.chance.shape[1] + 1
        basis = determined(seen[:, count:])
        free = seen[:, :count] - basis @ (basis.T @ seen[:, :count])
        r, moved = np.clip(free[:, 0], -math.sqrt(WORST), math.sqrt(WORST)), free[:, 1:]
        inner = np.eye(count - 1) + moved.T @ moved
        along = moved.T @ r
        squared = float(r @ r) - float(along @ np.linalg.solve(inner, along))
        return squared + float(np.linalg.slogdet(inner)[1])


def _squared_covariance(noise: NoiseModel, channel: str, time_s: Array) -> float:
    """Return the sum of the squared elements of the covariance matrix of the weighted noise of a series."""
    form = noise.forms.get(channel, NoiseForm())
    squared = replace(form, time_s=0.5 * form.time_s)
    if form.autoregression is None:
        # The square of 1 + ratio * r on the diagonal and of ratio * r beside it, with the correlation r.
        total = (1.0 + 2.0 * form.ratio) * len(time_s)
        if form.ratio > 0.0:
            rows = replace(squared, ratio=1.0).correlate(time_s, np.ones((len(time_s), 1)))
            total += form.ratio**2 * (float(rows.sum()) - len(time_s))
    else:
        total = float(squared.correlate(time_s, np.ones((len(time_s), 1))).sum())
    return noise.variance.get(channel, 1.0) ** 2 * total


def as_given(study: Study) -> Hypothesis:
    """Return the model with its shared parameters as given, and the initial state of each trial fitted."""
    shared = {p.name: p.start for p in study.parameters if not p.per_trial}
    problem = study.problem((), known=shared)
    return study.fit((), [np.clip(problem.start, problem.lower, problem.upper)], tolerance=FINE, known=shared)


def predictions(
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
        Models, fitted to all trials. The values that random effects have in each trial are those of the last
        one.
    noise : NoiseModel
        Noise and random effects that the held-out parts are expected to have.
    """
    values = dict(zip(fits[-1].labels, fits[-1].theta.tolist(), strict=True))
    for trial in validation:
        problem, point = _own_fit(fits[-1], trial, noise)
        values |= zip(problem.labels, point.tolist(), strict=True)
    scatter = {label: value for label, value in values.items() if label.startswith(BETWEEN)}
    found = []
    for fit in fits:
        each = (_of_validation(fit, trial, noise, scatter) for trial in validation)
        found.append([*_of_folds(fit, noise, scatter), *each])
        step()
    return found


def _of_folds(fit: Hypothesis, noise: NoiseModel, scatter: Mapping[str, float]) -> list[Prediction]:
    study, folds, problem = fit.study, fit.study.folds, fit.problem
    shared = study.shared(fit)
    _, each = crossval.covariances(crossval.normal_equations(study, fit))
    found = []
    for f, theta in enumerate(study.without_each(fit) if len(shared) else [fit.theta] * folds.count):
        point = np.array([scatter.get(label, v) for label, v in zip(fit.labels, theta, strict=True)])
        for k, trial in enumerate(study.trials):
            chosen = folds.owner[k] == f
            if not chosen.any():
                continue
            random = study.random(problem, k)
            own = fit.columns(k, study.settled(problem, k, study.apart(fit, k)))
            typical = problem.trial_residuals(theta, k) + fit.columns(k, random) @ theta[random]
            residual = problem.trial_residuals(point, k)
            rows = Rows(residual, typical, fit.columns(k, shared), each[f], own, study.chance(fit, k))
            part = (
                trial.id
                if folds.whole
                else f"{trial.id}, part {1 + f % max(folds.count // len(study.trials), 1)}"
            )
            found.append(rows.prediction(noise, problem, k, part, chosen))
    return found


def _own_fit(fit: Hypothesis, trial: Trial, noise: NoiseModel) -> tuple[Problem, Array]:
    """Return the problem of a further trial, and its parameters with fitted values of this trial."""
    study = fit.study
    known = {
        fit.labels[j]: float(fit.theta[j]) for j, (_, owner) in enumerate(fit.problem.slots) if owner is None
    }
    known |= {p.name: p.start for p in fit.problem.parameters if not p.per_trial and not p.free}
    problem = study.problem(fit.effects, trials=[trial], known=known, jobs=1)
    noise.of_new_trials(problem)
    problem.prior = study.expected(problem)[0], study.root(problem)
    theta = problem.start
    if len(theta):
        theta = problem.solve(theta, tolerance=FINE, max_iterations=30, secant=True).x
    whole = study.problem(fit.effects, trials=[trial], jobs=1)
    whole.sd = problem.sd
    here = dict(zip(problem.labels, theta, strict=True)) | known
    point = np.array([here.get(label, start) for label, start in zip(whole.labels, whole.start, strict=True)])
    return whole, point


def _of_validation(
    fit: Hypothesis, trial: Trial, noise: NoiseModel, scatter: Mapping[str, float]
) -> Prediction:
    study, shared = fit.study, fit.study.shared(fit)
    whole, theta = _own_fit(fit, trial, noise)
    point = np.array([scatter.get(label, v) for label, v in zip(whole.labels, theta, strict=True)])
    columns = -whole.trial_jacobians(theta)[0]
    at = [whole.labels.index(fit.labels[j]) if fit.labels[j] in whole.labels else -1 for j in shared]
    wide = np.column_stack((columns, np.zeros(len(columns))))
    covariance = crossval.covariances(crossval.normal_equations(study, fit))[0]
    random = study.random(whole, 0)
    own = columns[:, study.settled(whole, 0, whole.own(0))]
    typical = whole.trial_residuals(theta, 0) + columns[:, random] @ theta[random]
    chance = columns[:, random] / study.expected(whole)[1][random]
    rows = Rows(whole.trial_residuals(point, 0), typical, wide[:, at], covariance, own, chance)
    return rows.prediction(noise, whole, 0, trial.id, np.ones(len(columns), dtype=bool))


# ---------------------------------------------------------------- tables of the answer


def table(
    given: Sequence[Prediction], before: Sequence[Prediction], after: Sequence[Prediction]
) -> dict[str, HeldOutTrial]:
    """Return the squared errors of each held-out part by the models as given, refitted, and with causes."""
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


def waterfall(steps: Mapping[str, Sequence[Prediction]], floors: Mapping[str, float]) -> list[Step]:
    """Return the held-out errors of each model, and those that its noise and uncertainty explain.

    Parameters
    ----------
    steps : mapping of str to sequence of Prediction
        Predictions of each model, by its label.
    floors : mapping of channel to float
        Noise of each channel, in its unit.
    """
    found = []
    for label, parts in steps.items():
        count = max(sum(p.samples for p in parts), 1)
        found.append(
            Step(
                label=label,
                squared=sum(p.squared for p in parts) / count,
                expected=sum(p.expected for p in parts) / count,
                rmse=rms_errors(parts),
            )
        )
    channels = found[0].rmse if found else {}
    noise = {channel: floors.get(channel) for channel in channels}
    return [*found, Step(label="noise alone", squared=1.0, expected=1.0, rmse=noise)]


def rms_errors(parts: Sequence[Prediction]) -> dict[str, float | None]:
    """Return the root-mean-square error of each channel, in its unit."""
    residuals: dict[str, list[Array]] = {}
    for p in parts:
        for channel, series in p.residuals.items():
            residuals.setdefault(channel, []).append(series[np.isfinite(series)])
    return {c: float(np.sqrt(np.mean(np.concatenate(r) ** 2))) for c, r in residuals.items()}


def shrinkages(
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
    from swimid.diagnosis.verdict import share_closed

    errors = [rms_errors(parts) for parts in (given, before, after)]
    found = []
    for channel in errors[2]:
        size = ranges.get(channel) or 1.0
        shipped, refitted, last = (float(e[channel] or 0.0) / size for e in errors)
        floor = floors.get(channel, math.nan) / size
        closed = share_closed(shipped**2, last**2, floor**2)
        found.append(
            Shrinkage(
                channel=channel, shipped=shipped, before=refitted, after=last, floor=floor, closed=closed
            )
        )
    return found


@dataclass(frozen=True)
class Piece:
    """Measured and predicted samples of one channel of a held-out trial, without and with the causes."""

    trial: Trial
    channel: str
    time_s: Array
    measured: Array
    before: Array
    after: Array


def worst(before: Sequence[Prediction], after: Sequence[Prediction]) -> list[Piece]:
    """Return the channels of the held-out trial with the largest error, in units of its expectation."""
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
        series = []
        for which in (0, 1):
            whole = np.full(len(trial.time_s), np.nan)
            for pair in mine:
                part = pair[which].residuals.get(channel)
                if part is not None:
                    whole = np.where(np.isfinite(part), part, whole)
            series.append(whole)
        measured = trial.measured[channel]
        found.append(
            Piece(trial, channel, trial.time_s, measured, measured - series[0], measured - series[1])
        )
    return found


def sound(before: Sequence[Prediction], after: Sequence[Prediction]) -> bool:
    """Return whether no simulation of a held-out trial diverges because of the causes."""
    return not any(a.squared >= WORST and b.squared < WORST for b, a in zip(before, after, strict=True))


def floors(study: Study, fit: Hypothesis) -> dict[str, float]:
    """Return the noise floor of each channel in the fitted trials, in its unit.

    It consists of the measurement noise and of the random effects.
    """
    squares: dict[str, list[Array]] = {}
    for names, masks, sds in zip(fit.problem.channels, fit.problem.masks, fit.problem.sd, strict=True):
        for channel, mask, sd in zip(names, masks, sds, strict=True):
            squares.setdefault(channel, []).append(sd[mask] ** 2)
    return {
        c: study.noise.floor(c) * float(np.sqrt(np.mean(np.concatenate(parts))))
        for c, parts in squares.items()
    }
