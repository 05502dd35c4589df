"""Do held-out data contradict the causes?

A model's coefficients are known as far as the fitted trials tell them, and what they do not tell may move a
held-out trial far off, with a cause or without. What contradicts a model is an error that no coefficients as
likely as those leave: its distance in the predictive distribution.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from swimid.diagnosis import crossval
from swimid.diagnosis.context import Fit, FitContext, Mixed
from swimid.diagnosis.noise_model import NoiseModel
from swimid.fitting.model import Array, Trial

#: Relative tolerance of the search, and steps at most.
TOLERANCE, STEPS = 1e-3, 12


@dataclass(frozen=True)
class Misfit:
    """How far held-out data are from what a model predicts.

    Attributes
    ----------
    distance : float
        Squared Mahalanobis distance: about `samples` where the model is right.
    samples : int
    """

    distance: float
    samples: int


def refutes(
    context: FitContext, before: Fit, after: Fit, noise_model: NoiseModel, validation: Sequence[Trial]
) -> bool:
    """Whether with the causes held-out data are farther off, by more than the gap and than the noise.

    Parameters
    ----------
    before, after : Fit
        The model without and with the causes.
    validation : sequence of Trial
        Trials that took part in no fit; without any the folds are held out.
    """
    first, second = (misfit(context, fit, noise_model, validation) for fit in (before, after))
    gap = first.distance - first.samples
    return second.distance - first.distance > max(gap, first.samples)


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
    normal = inner.products.sum(axis=0)[:-1, :-1] + np.diag(inner.prior)
    mixed = normal[np.ix_(~common, common)]
    told = normal[np.ix_(common, common)] - mixed.T @ crossval.solved(normal[np.ix_(~common, ~common)], mixed)
    sizes, vectors = np.linalg.eigh(told)
    places = [problem.labels.index(label) for label in shared if label in problem.labels]
    mean, weight = context.expected(problem)
    mean[places], weight[places] = begin[places], 0.0
    root = np.zeros((len(places) + len(begin), len(begin)))
    root[: len(places), places] = np.sqrt(np.maximum(sizes, 0.0))[:, None] * vectors.T
    root[len(places) :] = np.diag(weight)
    try:
        found = context.search(problem, noise_model, [begin], TOLERANCE, STEPS, (mean, root))
    finally:
        problem.close()
    samples = sum(int(m.sum()) for masks in problem.masks for m in masks)
    return Misfit(float(found.cost), samples)


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
