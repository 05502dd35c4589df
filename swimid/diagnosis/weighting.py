"""Estimate the weights of residuals: noise level, autocorrelation, and between-trial variation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from swimid.diagnosis import random_effects, remainder
from swimid.diagnosis.context import Fit, FitContext
from swimid.diagnosis.floor import nuisance_residuals, repeats
from swimid.diagnosis.noise_model import NoiseModel, brief, coloured
from swimid.diagnosis.nominal import ParameterChange
from swimid.diagnosis.random_effects import FEWEST, RandomEffect
from swimid.effects.base import Effect
from swimid.fitting import uncertainty as sample_noise
from swimid.fitting.model import Array

#: Number of iterations that reweight the residuals before any effect is fitted.
WEIGHTINGS = 2
#: Fits during the estimation of weights: relative tolerance of the cost (COARSE), and maximum number of
#: iterations (FEW).
COARSE, FEW = 1e-3, 8
#: Ratio of the standard deviation of fitted random effects to the assumed one above which the assumed one is
#: replaced (STRAINED), and maximum number of such replacements (SETTLINGS).
STRAINED, SETTLINGS = 2.0, 3
#: Minimum number of samples of a trial from which the autocorrelation of the noise can be estimated.
SHORT = 20


def weigh(context: FitContext) -> tuple[NoiseModel, Fit]:
    """Refit the model without effects, and estimate the weights of the residuals from its own residuals."""
    problem = context.problem(())
    sample_noise.weigh_first(problem)
    noise_model = NoiseModel([list(sds) for sds in problem.sd])
    start = np.clip(problem.start, problem.lower, problem.upper)
    previous: dict[str, tuple[float, float]] = {}
    fit = context.fit((), noise_model, context.begins(problem, start), tolerance=COARSE)
    for _ in range(WEIGHTINGS):
        previous = sample_noise.estimate(problem, fit.theta, previous)
        noise_model = NoiseModel([list(sds) for sds in problem.sd])
        fit = context.fit((), noise_model, [fit.theta], tolerance=COARSE, warm=fit)
    counted = {c for t in context.trials if np.any(t.time_sd_s) for c in t.measured}
    # The noise of a counted channel is a multiple of its known rounding error. Store the rounding error in
    # units of the noise.
    rounding = {c: 1.0 / factor for c, (factor, _) in previous.items() if c in counted and factor > 0}
    return replace(noise_model, rounding=rounding), fit


def random_effect_columns(
    context: FitContext, fit: Fit, effects: Sequence[Effect]
) -> tuple[list[Array], list[RandomEffect]]:
    """Return the weighted changes of each trial by possible random effects, each at its typical scale.

    Returns
    -------
    columns : list of ndarray, shape (n_k, q)
    kinds : list of RandomEffect, length q
    """
    columns: list[list[Array]] = []
    found: list[RandomEffect] = []
    value = {p.name: p.start for p in context.parameters} | dict(zip(fit.labels, fit.theta, strict=True))
    possible = random_effects.kinds(
        context.model, context.parameters, context.trials, effects, value, repeated=bool(repeats(context))
    )
    for kind in possible:
        if kind.effect is None:
            change = ParameterChange(context.parameters[kind.place])
            half = context.changes(fit, change, [np.array([0.5 * kind.size])])[0]
        else:
            point = np.array(kind.null)
            upper = kind.effect.parameters(context.model, context.trials)[kind.place].upper
            sign = 1.0 if point[kind.place] + 0.5 * kind.size <= upper else -1.0
            point[kind.place] += sign * 0.5 * kind.size
            half = [sign * c for c in context.changes(fit, kind.effect, [point])[0]]
        if all(np.isfinite(c).all() for c in half) and sum(float(c @ c) for c in half) > 0:
            columns.append([2.0 * c for c in half])
            found.append(kind)
    stacked = [
        np.column_stack([np.empty((len(r), 0)), *(c[k] for c in columns)])
        for k, r in enumerate(fit.residuals)
    ]
    return stacked, found


def see(
    context: FitContext,
    fit: Fit,
    noise_model: NoiseModel,
    residuals: Sequence[Array],
    effects: Sequence[Effect],
    unknowns: float,
    *,
    common: int | None = None,
    cautious: bool = False,
) -> tuple[NoiseModel, list[RandomEffect]]:
    """Estimate a noise model from residuals: first the autocorrelation, then the random effects.

    Parameters
    ----------
    residuals : sequence of ndarray, shape (n_k,)
        Weighted residuals, including the between-trial variation.
    unknowns : float
        Number of parameters that were fitted to the residuals.
    common : int, optional
        Number of these parameters that are effects shared by all trials. If it is not given, random effects
        are left out, because they would hide effects that have not been tried yet.
    cautious : bool
        As in :func:`swimid.diagnosis.random_effects.spread`.

    Returns
    -------
    noise_model : NoiseModel
    kinds : list of RandomEffect
        Possible random effects with their estimated standard deviations. The noise model contains only the
        part that may be chance.
    """
    problem = fit.problem
    plain = replace(noise_model, random_effects=(), long_memory=None)
    if not tells_noise(context):
        # A few trials do not separate low-frequency noise from a gap, so return short-memory noise.
        whole = coloured(problem, residuals, plain, unknowns=unknowns)
        return replace(brief(whole, problem, residuals, list(whole.colour)), long_memory=whole), []
    # Estimate the autocorrelation from residuals without trim, gain and clock of single trials. The random
    # effects are estimated afterwards.
    columns, kinds = random_effect_columns(context, fit, effects)
    still = nuisance_residuals(fit, residuals, columns)
    noise_model = coloured(problem, still, plain, unknowns=unknowns + len(kinds) * len(residuals))
    slow = remainder.drifting(remainder.low_frequency(problem, still))
    noise_model = brief(noise_model, problem, still, slow)
    if common is None:
        return noise_model, []
    own = [fit.own(k) for k in range(len(context.trials))]
    shown = random_effects.spread(
        partial(noise_model.whiten, problem),
        residuals,
        own,
        columns,
        repeats=repeats(context),
        used=common,
        cautious=cautious,
    )
    kinds = [replace(kind, sd=s.sd, most=s.most) for kind, s in zip(kinds, shown, strict=True)]
    differing = tuple(kind.scattering(kind.sd) for kind in kinds if min(kind.sd, kind.most) > 0)
    return replace(noise_model, random_effects=differing), kinds


def settled(context: FitContext, leading: Fit, noise_model: NoiseModel) -> NoiseModel:
    """Increase between-trial standard deviations until they agree with the random effects of a fit.

    A standard deviation that is estimated from linearised residuals may be far too small. Between-trial
    variation then distorts the coefficients, and effects seem to correct the coefficients.

    Parameters
    ----------
    leading : Fit
        The model with the most probable effect.
    """
    for _ in range(SETTLINGS):
        if not noise_model.random_effects:
            break
        begin = context.start(leading.effects, noise_model, leading)
        leading = context.fit(leading.effects, noise_model, [begin], iterations=FEW, tolerance=COARSE)
        scatter = leading.scatter()
        shown = [(kind, scatter.get(kind.label, 0.0) / kind.size) for kind in noise_model.random_effects]
        if not any(size > STRAINED * kind.sd for kind, size in shown):
            break
        wider = (kind.scattering(size) if size > STRAINED * kind.sd else kind for kind, size in shown)
        noise_model = replace(noise_model, random_effects=tuple(wider))
    return noise_model


def tells_noise(context: FitContext) -> bool:
    """Return whether there are enough and long enough trials to estimate the between-trial variation."""
    short = all(sum(int(m.sum()) for m in masks) < SHORT for masks in context.shape.masks)
    return context.folds.whole and len(context.trials) >= FEWEST and not short
