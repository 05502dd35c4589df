"""Do held-out data contradict the causes?

A model's coefficients are known as far as the fitted trials tell them, and what they do not tell may move a
held-out trial far off, with a cause or without. What contradicts a model is an error that no coefficients as
likely as those leave: its distance in the predictive distribution.
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

#: Relative tolerance of the search, and steps at most.
TOLERANCE, STEPS = 1e-3, 12
#: Chance that of all validation trials one is called unpredicted though the model is right.
CHANCE = 0.025


@dataclass(frozen=True)
class Misfit:
    """How far held-out data are from what a model predicts.

    Attributes
    ----------
    distance : float
        Squared Mahalanobis distance: about `samples` where the model is right.
    samples : int
    slow : bool
        Whether what is left of the samples moves slower than noise, or is too short to tell.
    chance : dict of channel to float
        Of validation trials, the mean square of what differs in them by chance, in the channel's unit
        squared: its expectation given their samples.
    """

    distance: float
    samples: int
    slow: bool = True
    chance: Mapping[str, float] = field(default_factory=dict)

    @property
    def shown(self) -> bool:
        """Whether the greater part of it is no noise."""
        return self.distance > self.samples / (1.0 - MOST)

    @property
    def times(self) -> float:
        """Root-mean-square over that of a model that is right."""
        return math.sqrt(max(self.distance, 0.0) / max(self.samples, 1))


@dataclass(frozen=True)
class Compared:
    """How far held-out data are from what a model predicts without causes and with them."""

    before: Misfit
    after: Misfit

    @property
    def distances(self) -> Distance:
        """Root-mean-square, as the gap file has them."""
        return Distance(before=self.before.times, after=self.after.times)

    @property
    def refuted(self) -> bool:
        """Whether with the causes they are farther off, by more than the gap and than the noise."""
        farther = self.after.distance - self.before.distance
        return farther > max(self.before.distance - self.before.samples, self.before.samples)

    @property
    def useless(self) -> bool:
        """Whether with the causes they are no nearer."""
        return self.after.distance >= self.before.distance


def compared(
    context: FitContext, before: Fit, after: Fit, noise_model: NoiseModel, validation: Sequence[Trial]
) -> Compared:
    """Held-out data against the predictions of two models.

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
    """Validation trials in whose squared distance from the prediction of a model the greater part is no
    noise, and by how many times each is off, the largest first.

    A trial whose noise is larger than that of the others, and no slower, is none.
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
    """The distance of validation trials, or of all folds each from the fit to the others, from a model."""
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
    # what an effect has for each of the fitted trials tells a held-out one nothing
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
    """Mean square of what the random effects of validation trials change, start states refitted, by channel:
    its expectation given their samples, effects no larger than is likely.
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
        # a root of their covariance
        root = np.linalg.inv(np.linalg.qr(np.vstack((seen, np.eye(len(mine)))), mode="r"))
        moved = beyond(jacobian[:, own] * scale[own], rows @ np.column_stack((away, root)))
        changes = np.column_stack((np.sum(moved**2, axis=1), problem.sample_weights(k) ** 2))
        for channel, _, part in problem.by_channel(k, changes):
            squared, weights = part.T
            # of a channel that no fitted trial has, the noise is not known
            if weights.all():
                squares.setdefault(channel, []).append(squared / weights)
    return {c: float(np.mean(np.concatenate(v))) for c, v in squares.items()}


def _weigh(problem: Mixed, fit: Fit, noise_model: NoiseModel) -> None:
    """Give trials the weights that those of the fit have, by channel."""
    weights: dict[str, list[Array]] = {}
    for channels, sds in zip(fit.problem.channels, noise_model.sd, strict=True):
        for channel, sd in zip(channels, sds, strict=True):
            weights.setdefault(channel, []).append(sd)
    typical = {channel: float(np.median(np.concatenate(sds))) for channel, sds in weights.items()}
    problem.sd = [
        [np.full(len(m), typical.get(c, np.inf)) for c, m in zip(channels, masks, strict=True)]
        for channels, masks in zip(problem.channels, problem.masks, strict=True)
    ]
