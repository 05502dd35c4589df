"""Test whether held-out data contradict the causes.

The coefficients are uncertain after a fit. This uncertainty can move the prediction of a held-out trial far
off, with or without a cause. A model is contradicted only by an error that no probable coefficients explain.
The error is measured as the Mahalanobis distance in the predictive distribution.
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

#: Relative tolerance of the optimisation, and its maximum number of steps.
TOLERANCE, STEPS = 1e-3, 12
#: Probability that at least one validation trial is reported as unpredicted although the model is correct.
CHANCE = 0.025


@dataclass(frozen=True)
class Misfit:
    """Distance of held-out data from the prediction of a model.

    Attributes
    ----------
    distance : float
        Squared Mahalanobis distance. For a correct model it is about ``samples``.
    samples : int
        Number of held-out samples.
    slow : bool
        Whether the residuals vary more slowly than noise, or are too short to decide.
    chance : dict of channel to float
        Expected mean square of the changes of validation trials by random effects, given the samples of the
        trials. Its unit is that of the channel, squared.
    """

    distance: float
    samples: int
    slow: bool = True
    chance: Mapping[str, float] = field(default_factory=dict)

    @property
    def shown(self) -> bool:
        """Return whether more than half of the squared distance is not noise."""
        return self.distance > self.samples / (1.0 - MOST)

    @property
    def times(self) -> float:
        """Return the ratio of the root-mean-square error to the one expected of a correct model."""
        return math.sqrt(max(self.distance, 0.0) / max(self.samples, 1))


@dataclass(frozen=True)
class Compared:
    """Distances of held-out data from the predictions without and with the causes."""

    before: Misfit
    after: Misfit

    @property
    def distances(self) -> Distance:
        """Return the ratios of the root-mean-square errors to the expected ones, for the gap file."""
        return Distance(before=self.before.times, after=self.after.times)

    @property
    def refuted(self) -> bool:
        """Return whether the causes increase the squared distance by more than both the gap and the noise."""
        farther = self.after.distance - self.before.distance
        return farther > max(self.before.distance - self.before.samples, self.before.samples)

    @property
    def useless(self) -> bool:
        """Return whether the causes do not reduce the distance."""
        return self.after.distance >= self.before.distance


def compared(
    context: FitContext, before: Fit, after: Fit, noise_model: NoiseModel, validation: Sequence[Trial]
) -> Compared:
    """Compare the distances of held-out data from the predictions of two models.

    Parameters
    ----------
    before, after : Fit
        The model without and with the causes.
    validation : sequence of Trial
        Trials that are excluded from every fit. Without such trials, each cross-validation fold is held out.
    """
    return Compared(*(misfit(context, fit, noise_model, validation) for fit in (before, after)))


def unpredicted(
    context: FitContext, fit: Fit, noise_model: NoiseModel, validation: Sequence[Trial]
) -> dict[str, float]:
    """Return the validation trials that a model does not predict, the largest error first.

    The value is the ratio of the root-mean-square error to the one expected of a correct model. More than
    half of the squared distance of such a trial is not noise. A trial is left out if its residuals are larger
    than the noise of the other trials, but not slower.
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
    """Return the distance of validation trials from their prediction. Without them, return the distance of
    each fold from the fit to the other folds.
    """
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
    # Per-trial values of the fitted trials carry no information about a held-out trial.
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
    """Return the expected mean square of the changes of validation trials by random effects, for each
    channel.

    The expectation is conditional on the samples of the trials. Start states are refitted, and random effects
    are limited to probable values.
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
        # Square root of the covariance matrix of the random effects.
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
    """Give trials the median weight that each channel has in the fit."""
    weights: dict[str, list[Array]] = {}
    for channels, sds in zip(fit.problem.channels, noise_model.sd, strict=True):
        for channel, sd in zip(channels, sds, strict=True):
            weights.setdefault(channel, []).append(sd)
    typical = {channel: float(np.median(np.concatenate(sds))) for channel, sds in weights.items()}
    problem.sd = [
        [np.full(len(m), typical.get(c, np.inf)) for c, m in zip(channels, masks, strict=True)]
        for channels, masks in zip(problem.channels, problem.masks, strict=True)
    ]
