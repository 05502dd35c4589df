"""What differs from trial to trial: a trim, a gain, a clock, the friction of a pulley.

No effect that all trials share can explain it. Each kind is a number of its own in every trial, with the
spread that the trials show as its prior: a mixed-effects model.
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

#: Numbers of single trials that a model knows and holds: they, too, may differ by chance. Typically by
#: their scale, or by a share of a common number.
OWN: dict[str, tuple[str, float] | None] = {
    "friction_deviation": ("pulley_friction", 0.1),
    "start_offset": None,
    "initial_speed": None,
}
#: Fewest trials that tell a spread, and how far it must exceed the sampling error of one trial.
FEWEST, CLEAR = 3, 2.0
#: Chance differences are at most this large, in typical sizes: beyond, they are an effect. Where settings are
#: repeated these tell it: then at most what repeats differ by, at this level of its upper confidence bound.
LARGEST_SD, LEVEL = 0.5, 0.95
#: No trial is farther off than so many spreads; a spread that few trials tell may be this much larger, in
#: typical sizes. Without an end random effects would take up any gap.
FARTHEST, UNSURE = 3.0, 0.1


@dataclass(frozen=True)
class RandomEffect:
    """One kind of random effect.

    Attributes
    ----------
    name : str
        In words.
    label : str
        Of its number among the parameters of a model on which it acts.
    size : float
        Typical size, in its unit.
    effect : Effect or None
        Whose parameter it is; None of a number of the model itself.
    place : int
        Of the parameter in the effect, or in the model.
    null : tuple of float
        Parameters of the effect at which it vanishes.
    sd : float
        Standard deviation between trials, in typical sizes.
    most : float
        The largest that may be chance.
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
        """The same with another spread, no larger than may be chance."""
        return replace(self, sd=min(sd, self.most))

    @property
    def width(self) -> float:
        """Standard deviation between trials, in its unit."""
        return self.sd * self.size

    def number(self, parameter: Parameter) -> Parameter:
        """A parameter as what each trial has for itself, no farther from its start than chance is."""
        farthest = FARTHEST * math.hypot(self.sd, UNSURE) * self.size
        lower = max(parameter.lower, parameter.start - farthest)
        upper = min(parameter.upper, parameter.start + farthest)
        return replace(parameter, scale=self.width, lower=lower, upper=upper, free=True, per_trial=True)

    @cached_property
    def acting(self) -> Effect | None:
        """The effect with a value for each trial; one object, so that what depends on it is found again."""
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
        """The value of each trial."""
        p = self.effect.parameters(model, trials)[self.kind.place]
        return (replace(self.kind.number(p), name=f"{self.effect.name} {p.name}"),)

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """The effect with this value."""
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
    """What may differ between trials: what scatters of the effects, and numbers of trials the model holds.

    Parameters
    ----------
    parameters : sequence of Parameter
        Of the model.
    value : mapping of name to float
        Common numbers as they are now.
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
    """How much trials differ by one kind, in its typical size.

    Attributes
    ----------
    sd : float
        Standard deviation; 0 where it is not clear that they do.
    most : float
        The largest that may be chance.
    likelihood : float
        Logarithm of what the residuals gain by it, of all trials but that which gains most.
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
    """How much trials differ by random_effects, as they show it.

    Parameters
    ----------
    whiten : callable
        Weighted columns of a trial, shape (n_k, m), in units of the noise.
    residuals : sequence of ndarray, shape (n_k,)
        Weighted, of simulations in which what may differ by chance is alike in all trials.
    own : sequence of ndarray, shape (n_k, m)
        Weighted derivatives to the trial's own start state, which is estimated.
    random_effects : sequence of ndarray, shape (n_k, q)
        Weighted derivatives to what may differ by random_effects, each per its typical size.
    repeats : sequence of sequence of int
        Trials of one setting, where there are several.
    used : int
        Numbers common to all trials that were fitted to the residuals and may have taken such differences up.
    cautious : bool
        Of a model that may still lack much: rather too small than too large, which would hide what it lacks.

    Returns
    -------
    list of Spread, length q
        Of each kind the variance of the trials' own least-squares estimates, robustly, less its sampling
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
        # one kind at a time, the likeliest first: together they are too much alike to be told apart
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
    """Each trial's own estimate of one kind of difference, and its sampling variance, by trial.

    Parameters
    ----------
    inner : sequence of ndarray
        Of each trial, inner products of the kinds, the residual and derivatives to the start state.
    known, sd : ndarray
        Kinds whose spread is known, and it.
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
    """Of estimates of single trials."""
    n = len(estimates)
    if n < FEWEST:
        return Spread()
    b, c = (np.array(x) for x in zip(*estimates.values(), strict=True))
    # median absolute deviation against the standard deviation: one odd trial is not the rule
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
    # that estimates are of this spread and not of the sampling alone: the logarithm of their density
    gained = 0.5 * (b**2 / c - b**2 / (c + variance) - np.log1p(variance / c))
    return Spread(math.sqrt(variance), _most(estimates, repeats), float(gained.sum() - gained.max()))


def _most(estimates: Mapping[int, tuple[float, float]], repeats: Sequence[Sequence[int]]) -> float:
    """Return the largest spread that may be chance: the upper bound of what repeats of one setting differ by.

    Without repeats it is :data:`LARGEST_SD`, and with few of them no more than that or than they differ by.
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
    # one pair leaves the bound wide: it shows more than that only where the pair itself differs by more
    return min(bound, max(LARGEST_SD, math.sqrt(squares / freedom)))
