"""Test whether held-out data contradict the causes.

The fitted trials determine the coefficients with some uncertainty, which may move a held-out trial far off,
with a cause or without. A model is contradicted by an error that no probable coefficients leave: the distance
in the predictive distribution.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy import special

from swimid.diagnosis import crossval, remainder
from swimid.diagnosis.context import Fit, FitContext, Mixed, beyond
from swimid.diagnosis.gap_file import Distance
from swimid.diagnosis.noise_model import NoiseModel
from swimid.diagnosis.shrinkage import MOST
from swimid.fitting.model import Array, Trial

#: Relative tolerance of the search, and maximum number of steps.
TOLERANCE, STEPS = 1e-3, 12
#: Probability that one of all validation trials is called unpredicted although the model is right.
CHANCE = 0.025


@dataclass(frozen=True)
class Misfit:
    """Distance of held-out data from the prediction of a model.

    Attributes
    ----------
    distance : float
        Squared Mahalanobis distance: about `samples` for a correct model.
    samples : int
    slow : bool
        Whether the residuals of these samples move slower than noise, or are too short for an answer.
    chance : dict of channel to float
        Of validation trials, the mean square of their random effects, in the channel's unit squared: its
        expectation given their samples.
    """

    distance: float
    samples: int
    slow: bool = True
    chance: Mapping[str, float] = field(default_factory=dict)

    @property
    def shown(self) -> bool:
        """Return whether the greater part of the distance is not noise."""
        return self.distance > self.samples / (1.0 - MOST)

    @property
    def times(self) -> float:
        """Return the root mean square over that of a correct model."""
        return math.sqrt(max(self.distance, 0.0) / max(self.samples, 1))


@dataclass(frozen=True)
class Compared:
    """Distances of held-out data from the predictions without and with the causes."""

    before: Misfit
    after: Misfit

    @property
    def distances(self) -> Distance:
        """Return the root mean squares for the gap file."""
        return Distance(before=self.before.times, after=self.after.times)

    @property
    def refuted(self) -> bool:
        """Return whether the distance is larger with the causes, by more than the gap and than the noise."""
        farther = self.after.distance - self.before.distance
        return farther > max(self.before.distance - self.before.samples, self.before.samples)

    @property
    def useless(self) -> bool:
        """Return whether the distance is no smaller with the causes."""
        return self.after.distance >= self.before.distance


def compared(
    context: FitContext, before: Fit, after: Fit, noise_model: NoiseModel, validation: Sequence[Trial]
) -> Compared:
    """Compare held-out data with the predictions of two models.

    Parameters
    ----------
    before, after : Fit
        The model without and with the causes.
    validation : sequence of Trial
        Trials that took part in no fit; without any the folds are held out.
    """
    return Compared(*(misfit(context, fit, noise_model, validation) for fit in (before, after)))


def unpredicted(
    context: FitContext, fit: Fit, noise_model: NoiseModel, validation: Sequence[Trial]
) -> dict[str, float]:
    """Return validation trials that a model does not predict, and the ratio of the error to the expected one,
    largest first.

    More than half of the squared distance of such a trial is not noise. A trial whose noise is only larger
    than that of the others, and not slower, is left out.
    """
    inner = crossval.normal_equations(context, fit, noise_model)
    found = {}
    for trial in validation:
        seen = _of_trials(context, fit, noise_model, inner, [trial])
        largest = float(special.chdtri(max(seen.samples, 1), CHANCE / len(validation)))
        if seen.slow and seen.shown and seen.distance > largest:
            found[trial.id] = seen.times
    return dict(sorted(found.items(), key=lambda item: -item[1]))


def misfit(context: FitContext, fit: Fit, noise_model: NoiseModel, validation: Sequence[Trial]) -> Misfit:
    """Return the distance of validation trials, or of each fold from the fit to the others."""
    inner = crossval.normal_equations(context, fit, noise_model)
    if validation:
        return _of_trials(context, fit, noise_model, inner, validation)
    return Misfit(float(crossval.predictive(inner).sum()), int(inner.samples.sum()))


def _of_trials(
    context: FitContext,
    fit: Fit,
    noise_model: NoiseModel,
    inner: crossval.NormalEquations,
    validation: Sequence[Trial],
) -> Misfit:
    shared = [fit.labels[j] for j in context.shared(fit)]
    known = dict(zip(fit.labels, fit.theta, strict=True))
    ended = {
        label: known[label]
        for label, (_, owner) in zip(fit.labels, fit.problem.slots, strict=True)
        if owner is None and label not in shared
    }
    problem = context.problem(fit.effects, noise_model.random_effects, trials=validation, known=ended)
    _weigh(problem, fit, noise_model)
    begin = np.array([known.get(n, start) for n, start in zip(problem.labels, problem.start, strict=True)])
    # The per-trial values of the fitted trials say nothing about a held-out one.
    common = np.array([label in problem.labels for label in shared], dtype=bool)
    normal = inner.products.sum(axis=0)[:-1, :-1] + inner.prior
    mixed = normal[np.ix_(~common, common)]
    told = normal[np.ix_(common, common)] - mixed.T @ crossval.solved(normal[np.ix_(~common, ~common)], mixed)
    sizes, vectors = np.linalg.eigh(told)
    places = [problem.labels.index(label) for label in shared if label in problem.labels]
    mean, weight = context.expected(problem)
    mean[places], weight[places] = begin[places], 0.0
    root = np.zeros((len(places) + len(begin), len(begin)))
    root[: len(places), places] = np.sqrt(np.maximum(sizes, 0.0))[:, None] * vectors.T
    root[len(places) :] = np.diag(weight)
    found = context.search(problem, noise_model, [begin], TOLERANCE, STEPS, (mean, root))
    left = [problem.trial_residuals(found.x, k) for k in range(len(validation))]
    chance = _chance(problem, found.x, fit, noise_model)
    moving = remainder.low_frequency(problem, left)
    slow = not moving or any(channel.ratio > remainder.SLOW for channel in moving.values())
    return Misfit(float(found.cost), sum(len(r) for r in left), slow, chance)


def _chance(problem: Mixed, theta: Array, fit: Fit, noise_model: NoiseModel) -> dict[str, float]:
    """Return the expected mean square, by channel, of what random effects change in validation trials, given
    their samples.

    Start states are refitted, and random effects are limited to probable values.
    """
    if not problem.random_effects:
        return {}
    centre, scale = fit.centre(), problem.scale
    squares: dict[str, list[Array]] = {}
    for k, jacobian in enumerate(problem.trial_jacobians(theta)):
        mine = problem.differing(k)
        names = [problem.parameters[problem.slots[j][0]].name for j in mine]
        away = (theta[mine] - [centre[name] for name in names]) / scale[mine]
        likely = special.chdtri(len(mine), CHANCE)
        away *= math.sqrt(min(1.0, likely / max(float(away @ away), likely)))
        rows = jacobian[:, mine] * scale[mine]
        own = problem.begun(k)
        seen = noise_model.whiten(problem, k, np.column_stack((rows, jacobian[:, own] * scale[own])))
        seen = beyond(seen[:, len(mine) :], seen[:, : len(mine)])
        # A root of their covariance.
        root = np.linalg.inv(np.linalg.qr(np.vstack((seen, np.eye(len(mine)))), mode="r"))
        moved = beyond(jacobian[:, own] * scale[own], rows @ np.column_stack((away, root)))
        changes = np.column_stack((np.sum(moved**2, axis=1), problem.sample_weights(k) ** 2))
        for channel, _, part in problem.by_channel(k, changes):
            squared, weights = part.T
            # The noise of a channel that no fitted trial has is unknown.
            if weights.all():
                squares.setdefault(channel, []).append(squared / weights)
    return {c: float(np.mean(np.concatenate(v))) for c, v in squares.items()}


def _weigh(problem: Mixed, fit: Fit, noise_model: NoiseModel) -> None:
    """Give trials the weights of the fit, by channel."""
    weights: dict[str, list[Array]] = {}
    for channels, sds in zip(fit.problem.channels, noise_model.sd, strict=True):
        for channel, sd in zip(channels, sds, strict=True):
            weights.setdefault(channel, []).append(sd)
    typical = {channel: float(np.median(np.concatenate(sds))) for channel, sds in weights.items()}
    problem.sd = [
        [np.full(len(m), typical.get(c, np.inf)) for c, m in zip(channels, masks, strict=True)]
        for channels, masks in zip(problem.channels, problem.masks, strict=True)
    ]
