"""Estimate the between-trial variation, for example of trim, gain, clock or pulley friction.

An effect with equal parameters in all trials cannot explain this variation. Each random effect has one value
for each trial, with the between-trial standard deviation as prior (a mixed-effects model).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import special

from swimid.effects.base import Effect
from swimid.fitting.model import Array, Hooks, Model, Parameter, Trial

#: Per-trial parameters of a model that may be random effects. The value names a shared parameter, and the
#: fraction of it that is the typical scale of the random effect. None stands for the parameter's own scale.
OWN: dict[str, tuple[str, float] | None] = {
    "friction_deviation": ("pulley_friction", 0.1),
    "relative_drag_deviation": None,
    "start_offset": None,
    "initial_speed": None,
}
#: Those of them that are random effects only if settings are repeated. Between single trials of different
#: settings, they would absorb any drag that the model lacks.
OF_REPEATS = {"relative_drag_deviation"}
#: Estimation of a between-trial standard deviation: minimum number of trials (FEWEST), and minimum ratio of
#: the variance of the per-trial estimates to their sampling variance (CLEAR).
FEWEST, CLEAR = 3, 2.0
#: Maximum between-trial standard deviation that may be chance, in typical scales. A larger one is treated as
#: an effect. If settings are repeated, the maximum is the upper confidence bound, at level `LEVEL`, of the
#: standard deviation between repeats.
LARGEST_SD, LEVEL = 0.5, 0.95
#: Limits of a random effect, without which it would absorb any gap: maximum deviation of one trial in
#: between-trial standard deviations (FARTHEST), and allowance in typical scales for the error of a standard
#: deviation from few trials (UNSURE).
FARTHEST, UNSURE = 3.0, 0.1


@dataclass(frozen=True)
class RandomEffect:
    """Random effect: a quantity that differs at random between trials.

    Attributes
    ----------
    name : str
        Name of the quantity in texts.
    label : str
        Name of its parameter among the parameters of a model on which the random effect acts.
    size : float
        Typical scale, in the unit of the parameter.
    effect : Effect or None
        Effect to which the parameter belongs; None for a parameter of the model itself.
    place : int
        Index of the parameter in the effect or in the model.
    null : tuple of float
        Parameters of the effect at which the effect vanishes.
    sd : float
        Between-trial standard deviation, in typical scales.
    most : float
        Largest standard deviation that may be chance, in typical scales.
    """

    name: str
    label: str
    size: float
    effect: Effect | None
    place: int
    null: tuple[float, ...] = ()
    sd: float = 0.0
    most: float = LARGEST_SD

    def scattering(self, sd: float) -> RandomEffect:
        """Return a copy of the random effect with another between-trial standard deviation.

        The standard deviation is limited to the largest one that may be chance.
        """
        return replace(self, sd=min(sd, self.most))

    def number(self, parameter: Parameter) -> Parameter:
        """Return the per-trial parameter of the random effect, bounded by the largest chance deviation."""
        farthest = FARTHEST * math.hypot(self.sd, UNSURE) * self.size
        lower = max(parameter.lower, parameter.start - farthest)
        upper = min(parameter.upper, parameter.start + farthest)
        scale = self.sd * self.size
        return replace(parameter, scale=scale, lower=lower, upper=upper, free=True, per_trial=True)

    @cached_property
    def acting(self) -> Effect | None:
        """Return the effect whose parameter has one value for each trial; None for a model parameter.

        The same object is always returned, because results are cached by the object.
        """
        if self.effect is None:
            return None
        return TrialEffect(self, self.effect)


class TrialEffect(Effect):
    """Effect of which one parameter has a separate value for each trial (a random effect)."""

    name: ClassVar[str] = "chance"

    def __init__(self, kind: RandomEffect, effect: Effect) -> None:
        self.kind, self.effect = kind, effect

    def parameters(self, model: Model, trials: Sequence[Trial]) -> tuple[Parameter, ...]:
        """Return the per-trial parameter of the random effect."""
        p = self.effect.parameters(model, trials)[self.kind.place]
        return (replace(self.kind.number(p), name=f"{self.effect.name} {p.name}"),)

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Return the hooks of the effect with the value of this trial."""
        point = np.array(self.kind.null)
        point[self.kind.place] = values[0]
        return self.effect.hooks(point, trial, model)


def kinds(
    model: Model,
    parameters: Sequence[Parameter],
    trials: Sequence[Trial],
    effects: Sequence[Effect],
    value: Mapping[str, float],
    *,
    repeated: bool = False,
) -> list[RandomEffect]:
    """Return the possible random effects of a model.

    They come from effects whose parameters may differ at random between trials, and from per-trial parameters
    of the model.

    Parameters
    ----------
    parameters : sequence of Parameter
        Parameters of the model.
    value : mapping of name to float
        Present values of the shared parameters.
    repeated : bool
        Whether settings are repeated.
    """
    found = []
    for effect in effects:
        if not effect.scatters:
            continue
        own = effect.parameters(model, trials)
        null = tuple(p.start for p in own)
        for j, p in enumerate(own):
            if not p.per_trial:
                label = f"{TrialEffect.name}/{effect.name} {p.name}"
                found.append(RandomEffect(effect.name, label, p.scale, effect, j, null))
    for index, p in enumerate(parameters):
        if p.per_trial and not p.free and p.name in OWN and (repeated or p.name not in OF_REPEATS):
            share = OWN[p.name]
            size = share[1] * abs(float(value.get(share[0], 0.0))) if share else 0.0
            found.append(RandomEffect(p.name, p.name, size or p.scale, None, index))
    return found


class Spread(NamedTuple):
    """Between-trial variation of one random effect, in typical scales.

    Attributes
    ----------
    sd : float
        Standard deviation; 0 if it is not significant.
    most : float
        Largest standard deviation that may be chance.
    likelihood : float
        Increase in log-likelihood of the per-trial estimates by this variation, without the trial that
        contributes most.
    """

    sd: float = 0.0
    most: float = LARGEST_SD
    likelihood: float = -math.inf


def spread(
    whiten: Callable[[int, Array], Array],
    residuals: Sequence[Array],
    own: Sequence[Array],
    random_effects: Sequence[Array],
    *,
    repeats: Sequence[Sequence[int]] = (),
    used: int = 0,
    cautious: bool = False,
) -> list[Spread]:
    """Estimate the between-trial standard deviation of each random effect.

    Parameters
    ----------
    whiten : callable
        Function ``whiten(k, columns)`` that whitens weighted columns of trial ``k``, shape (n_k, m).
    residuals : sequence of ndarray, shape (n_k,)
        Weighted residuals of simulations with equal random effects in all trials.
    own : sequence of ndarray, shape (n_k, m)
        Weighted derivatives with respect to the initial state of the trial, which is estimated too.
    random_effects : sequence of ndarray, shape (n_k, q)
        Weighted derivatives with respect to the random effects, multiplied by their typical scales.
    repeats : sequence of sequence of int
        Indices of the trials of each repeated setting.
    used : int
        Number of shared parameters that were fitted to the residuals and may have absorbed such variation.
    cautious : bool
        Whether the model may still lack a large effect. Estimates are then rather too small than too large,
        because a large variation would hide the missing effect.

    Returns
    -------
    list of Spread, length q
        Variation of each random effect. The variance is the robust variance of the per-trial least-squares
        estimates, minus their sampling variance.
    """
    q = random_effects[0].shape[1] if len(random_effects) else 0
    found = [Spread()] * q
    if len(residuals) < FEWEST or not q:
        return found
    seen = [whiten(k, np.column_stack((random_effects[k], r, own[k]))) for k, r in enumerate(residuals)]
    inner = [block.T @ block for block in seen]
    left = list(range(q))
    while left:
        # Estimate one random effect at a time, the most likely first, because they are hardly distinguishable
        # when estimated together.
        sd = np.array([s.sd for s in found])
        known = np.flatnonzero(sd)
        tried = {i: _spread(_estimates(inner, i, known, sd[known], q), repeats, used, cautious) for i in left}
        i = max(left, key=lambda i: tried[i].likelihood)
        if tried[i].sd <= 0.0:
            break
        found[i] = tried[i]
        left.remove(i)
    return found


def _estimates(
    inner: Sequence[Array], i: int, known: NDArray[np.intp], sd: Array, kinds: int
) -> dict[int, tuple[float, float]]:
    """Return for each trial index the estimate of one random effect, and the estimate's sampling variance.

    Parameters
    ----------
    inner : sequence of ndarray
        Matrix of each trial: inner products of the random effects, the residual, and the derivatives with
        respect to the initial state.
    known, sd : ndarray
        Indices of random effects with a known standard deviation, and these standard deviations.
    """
    found = {}
    for k, products in enumerate(inner):
        starts = np.arange(kinds + 1, len(products))
        apart = np.concatenate((known, starts)).astype(int)
        ridge = np.concatenate((sd**-2.0, np.zeros(len(starts))))
        wanted = np.array([i, kinds])
        block = products[np.ix_(wanted, wanted)]
        if len(apart):
            normal = products[np.ix_(apart, apart)] + np.diag(ridge)
            own = normal.diagonal()[len(known) :]
            normal[np.diag_indices(len(normal))] += 1e-10 * float(own.sum()) + 1e-300
            mixed = products[np.ix_(apart, wanted)]
            block = block - mixed.T @ np.linalg.solve(normal, mixed)
        size = float(block[0, 0])
        if size > 1e-9:
            found[k] = float(block[0, 1]) / size, 1.0 / size
    return found


def _spread(
    estimates: Mapping[int, tuple[float, float]],
    repeats: Sequence[Sequence[int]],
    used: int,
    cautious: bool,
) -> Spread:
    """Return the between-trial variation of a random effect, computed from its per-trial estimates."""
    n = len(estimates)
    if n < FEWEST:
        return Spread()
    b, c = (np.array(x) for x in zip(*estimates.values(), strict=True))
    # Limit the standard deviation by the median absolute deviation, so that one outlier trial does not
    # determine it.
    middle = float(np.median(b))
    robust = 1.4826 * float(np.median(np.abs(b - middle))) * (1.0 + 0.8 / n)
    if cautious:
        variance = min(robust**2, float(np.var(b, ddof=1)))
    else:
        near = np.clip(b, middle - FARTHEST * robust, middle + FARTHEST * robust)
        variance = float(np.var(near, ddof=1))
    variance *= (n - 1) / max(n - 1 - used, 1)
    typical = float(np.median(c))
    if variance <= CLEAR * typical:
        return Spread()
    variance -= typical
    # Compute by how much the variation increases the log-density of each estimate, compared with its sampling
    # error alone.
    gained = 0.5 * (b**2 / c - b**2 / (c + variance) - np.log1p(variance / c))
    return Spread(math.sqrt(variance), _most(estimates, repeats), float(gained.sum() - gained.max()))


def _most(estimates: Mapping[int, tuple[float, float]], repeats: Sequence[Sequence[int]]) -> float:
    """Return the largest between-trial standard deviation that may be chance, from repeats of one setting.

    Without repeats it is :data:`LARGEST_SD`. With few repeats it is at most the larger of :data:`LARGEST_SD`
    and the standard deviation between the repeats.
    """
    squares, freedom = 0.0, 0
    for group in repeats:
        b = np.array([estimates[k][0] for k in group if k in estimates])
        if len(b) > 1:
            squares += float(np.sum((b - b.mean()) ** 2))
            freedom += len(b) - 1
    if not freedom:
        return LARGEST_SD
    bound = math.sqrt(squares / float(special.chdtri(freedom, LEVEL)))
    # A single pair of repeats gives a wide confidence bound. The result exceeds :data:`LARGEST_SD` only if
    # the standard deviation between the repeats does.
    return min(bound, max(LARGEST_SD, math.sqrt(squares / freedom)))
