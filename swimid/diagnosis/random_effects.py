"""Estimate the between-trial variation: trim, gain, clock, friction of a pulley.

No effect that all trials share can explain it. Each kind has one value for each trial, with the between-trial
standard deviation as prior: a mixed-effects model.
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

from swimid.effects.base import Effect, Stage
from swimid.fitting.hooks import Hooks
from swimid.fitting.model import Array, Model, Parameter, Trial

#: Per-trial parameters that a model holds, which may also differ by chance. Their typical size is their
#: scale, or a share of a common parameter.
OWN: dict[str, tuple[str, float] | None] = {
    "friction_deviation": ("pulley_friction", 0.1),
    "start_offset": None,
    "initial_speed": None,
}
#: Minimum number of trials for a standard deviation, and its minimum ratio to the sampling error of one
#: trial.
FEWEST, CLEAR = 3, 2.0
#: Maximum standard deviation by chance, in typical sizes; a larger one is an effect. If settings are
#: repeated, the limit is this upper confidence bound of the difference between repeats.
LARGEST_SD, LEVEL = 0.5, 0.95
#: Maximum number of standard deviations of one trial, and the possible excess, in typical sizes, of a
#: standard deviation from few trials. Without a limit random effects would absorb any gap.
FARTHEST, UNSURE = 3.0, 0.1


@dataclass(frozen=True)
class RandomEffect:
    """One kind of random effect.

    Attributes
    ----------
    name : str
        In words.
    label : str
        Of its parameter among the parameters of a model on which it acts.
    size : float
        Typical size, in its unit.
    effect : Effect or None
        Effect that has the parameter; None for a parameter of the model itself.
    place : int
        Index of the parameter in the effect, or in the model.
    null : tuple of float
        Parameters of the effect at which it vanishes.
    sd : float
        Between-trial standard deviation, in typical sizes.
    most : float
        Largest standard deviation that may be chance.
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
        """Return the same effect with another standard deviation, limited to what may be chance."""
        return replace(self, sd=min(sd, self.most))

    @property
    def width(self) -> float:
        """Return the between-trial standard deviation, in its unit."""
        return self.sd * self.size

    def number(self, parameter: Parameter) -> Parameter:
        """Return the parameter for one trial, with bounds at the largest chance deviation."""
        farthest = FARTHEST * math.hypot(self.sd, UNSURE) * self.size
        lower = max(parameter.lower, parameter.start - farthest)
        upper = min(parameter.upper, parameter.start + farthest)
        return replace(parameter, scale=self.width, lower=lower, upper=upper, free=True, per_trial=True)

    @cached_property
    def acting(self) -> Effect | None:
        """Return the effect with a value for each trial; always the same object, because results are
        cached by it.
        """
        return None if self.effect is None else TrialEffect(self, self.effect)


class TrialEffect(Effect):
    """One parameter of an effect, with a value for each trial."""

    name: ClassVar[str] = "chance"
    stage: ClassVar[Stage] = "sensing"
    meaning: ClassVar[str] = "It differs from trial to trial."
    needs: ClassVar[frozenset[str]] = frozenset()

    def __init__(self, kind: RandomEffect, effect: Effect) -> None:
        self.kind, self.effect = kind, effect

    def parameters(self, model: Model, trials: Sequence[Trial]) -> tuple[Parameter, ...]:
        """Return the parameter of each trial."""
        p = self.effect.parameters(model, trials)[self.kind.place]
        return (replace(self.kind.number(p), name=f"{self.effect.name} {p.name}"),)

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Return the hooks of the effect with this value."""
        point = np.array(self.kind.null)
        point[self.kind.place] = values[0]
        return self.effect.hooks(point, trial, model)


def kinds(
    model: Model,
    parameters: Sequence[Parameter],
    trials: Sequence[Trial],
    effects: Sequence[Effect],
    value: Mapping[str, float],
) -> list[RandomEffect]:
    """Return what may differ between trials: scattering effects, and per-trial parameters that the model
    holds.

    Parameters
    ----------
    parameters : sequence of Parameter
        Of the model.
    value : mapping of name to float
        Present values of the shared parameters.
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
        if p.per_trial and not p.free and p.name in OWN:
            share = OWN[p.name]
            size = share[1] * abs(float(value.get(share[0], 0.0))) if share else 0.0
            found.append(RandomEffect(p.name, p.name, size or p.scale, None, index))
    return found


class Spread(NamedTuple):
    """Between-trial variation of one kind, in its typical size.

    Attributes
    ----------
    sd : float
        Standard deviation; 0 if it is not significant.
    most : float
        Largest standard deviation that may be chance.
    likelihood : float
        Gain in log-likelihood of the residuals, without the trial that gains most.
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
    """Estimate the between-trial standard deviation of each kind.

    Parameters
    ----------
    whiten : callable
        Returns weighted columns of a trial, shape (n_k, m), in units of the noise.
    residuals : sequence of ndarray, shape (n_k,)
        Weighted, of simulations with equal random effects in all trials.
    own : sequence of ndarray, shape (n_k, m)
        Weighted derivatives with respect to the trial's own start state, which is estimated.
    random_effects : sequence of ndarray, shape (n_k, q)
        Weighted derivatives with respect to the random effects, each per its typical size.
    repeats : sequence of sequence of int
        Trials of one setting, where there are several.
    used : int
        Number of shared parameters that were fitted to the residuals and may have absorbed such differences.
    cautious : bool
        Whether the model may still lack much. Then estimates are rather too small than too large, because too
        large ones would hide what it lacks.

    Returns
    -------
    list of Spread, length q
        Of each kind the robust variance of the trials' own least-squares estimates, minus its sampling
        variance.
    """
    q = random_effects[0].shape[1] if len(random_effects) else 0
    found = [Spread()] * q
    if len(residuals) < FEWEST or not q:
        return found
    seen = [whiten(k, np.column_stack((random_effects[k], r, own[k]))) for k, r in enumerate(residuals)]
    inner = [block.T @ block for block in seen]
    left = list(range(q))
    while left:
        # One kind at a time, the most likely first, because together they are hardly distinguishable.
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
    """Return each trial's own estimate of one kind of difference, and its sampling variance, by trial.

    Parameters
    ----------
    inner : sequence of ndarray
        Of each trial, inner products of the kinds, the residual and derivatives with respect to the start
        state.
    known, sd : ndarray
        Kinds with a known standard deviation, and that standard deviation.
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
    """Return the variation from estimates of single trials."""
    n = len(estimates)
    if n < FEWEST:
        return Spread()
    b, c = (np.array(x) for x in zip(*estimates.values(), strict=True))
    # The median absolute deviation limits the standard deviation: one odd trial does not decide.
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
    # Log-density of the estimates with this variation, minus that with the sampling error alone.
    gained = 0.5 * (b**2 / c - b**2 / (c + variance) - np.log1p(variance / c))
    return Spread(math.sqrt(variance), _most(estimates, repeats), float(gained.sum() - gained.max()))


def _most(estimates: Mapping[int, tuple[float, float]], repeats: Sequence[Sequence[int]]) -> float:
    """Return the largest standard deviation that may be chance, from repeats of one setting.

    Without repeats it is :data:`LARGEST_SD`. With few repeats it is at most the larger of that and their own
    difference.
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
    # One pair leaves a wide bound: more than this is shown only if the pair itself differs by more.
    return min(bound, max(LARGEST_SD, math.sqrt(squares / freedom)))
