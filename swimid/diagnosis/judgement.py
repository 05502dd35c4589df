"""Decide the verdict of a diagnosis.

The fits propose a verdict and the causes. Further tests can only weaken the verdict.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from swimid.blackbox import model as arx
from swimid.diagnosis import remainder, shrinkage
from swimid.diagnosis.candidates import Refitted
from swimid.diagnosis.context import Fit, FitContext
from swimid.diagnosis.floor import Floor, by_channel, excess, measured, repeats, rms, split
from swimid.diagnosis.gap_file import Remaining, Verdict
from swimid.diagnosis.posterior import TENTH, UNSURE
from swimid.diagnosis.search import Round, State
from swimid.diagnosis.shrinkage import Misfit, Piece
from swimid.errors import NoTrustworthyResult
from swimid.fitting import output_error
from swimid.fitting.between_trials import MIN_TRIALS, OutlierTrial, find_outlier_trial
from swimid.fitting.model import Array, Trial

#: Minimum probability of causes in the catalogue, divided by that of all causes, for the verdict "explained".
#: Below it, the verdict is "ambiguous".
SURE = 0.8
#: Minimum number of repeats, in addition to one trial per setting, that are needed to conclude that settings
#: differ by more than chance. One repeat gives the between-repeat variance only one degree of freedom.
MIN_REPEATS = 2
#: Minimum total probability of a reported cause and its equivalents. Equivalents are added in the order of
#: decreasing probability until their sum reaches this minimum.
CREDIBLE = 0.9
#: Maximum number of effects that are reported for one cause: the cause and its equivalents. If there are
#: more, the most probable ones are listed.
SET = 3
#: Ratio above which trials differ by more than chance. The numerator is the between-trial standard deviation
#: minus two standard errors. The denominator is the largest standard deviation that may be chance.
DIFFERS = 2.0
#: Fraction of the squared residuals of all trials, minus the noise, above which a single trial is tested as
#: an outlier.
MAJORITY = 0.5


#: Type of a pair: distances of held-out data from the predictions without and with the causes.
Predicted = tuple[Misfit, Misfit]


@dataclass(frozen=True)
class Named:
    """Reported cause with its equivalents and probabilities.

    Attributes
    ----------
    probability : float
        Probability that the cause, or one of its equivalents, is missing in the model.
    closing : float
        Probability that the cause, or one of its equivalents, belongs to the set of effects that closes the
        gap best. It may act itself, or only imitate a cause outside the catalogue.
    alone : float
        Probability of the cause and of effects that change the trials in the same way, relative to all
        alternatives, given the other causes.
    crowded : bool
        Whether more effects cannot be distinguished from the cause than are listed.
    """

    best: Refitted
    equivalent: tuple[str, ...]
    probability: float
    closing: float
    alone: float
    crowded: bool = False

    @property
    def alike(self) -> tuple[str, ...]:
        """Return the names of the cause and its equivalents."""
        return (self.best.tried.effect.name, *self.equivalent)


def named(state: State, found: Round) -> Named:
    """Return the cause of a search round with its equivalents and probabilities."""
    best = found.ranked[0]
    name = best.tried.effect.name
    posterior = state.posterior
    exact = best.tried.effect.adds_to is not None
    share = posterior.instead(name, frozenset(e.name for e in state.base.effects), exact=exact)
    order = [name, *(n for n in share if n != name)]
    before = np.cumsum([0.0, *(share[n] for n in order[:-1])])
    alike = [n for n, sum_before in zip(order, before, strict=True) if sum_before < CREDIBLE]
    shown = list(dict.fromkeys([name, *found.same, *alike]))[:SET]
    return Named(
        best,
        tuple(shown[1:]),
        posterior.having(*shown),
        posterior.closing(*shown),
        share[name] + sum(share.get(n, 0.0) for n in found.same),
        len(alike) > SET,
    )


@dataclass(frozen=True)
class Judgement:
    """Verdict of a diagnosis, with its causes and reasons.

    Attributes
    ----------
    causes : tuple of Named
        Reported causes.
    base : Fit
        The model with all causes. It is the model without effects if held-out trials or an outlier trial
        contradict the causes.
    reasons : tuple of str
        Reasons for the verdict.
    unsure : tuple of str
        Reasons why the causes are not certain.
    refuted : tuple of str
        Names of causes with which held-out errors grow.
    odd : OutlierTrial or None
        Trial that contradicts the other trials.
    unpredicted : mapping of trial to float
        Validation trials that the model with the causes does not predict. The value is the root-mean-square
        error divided by the one expected of a correct model. It is not evaluated if the fitted trials alone
        give the verdict "unexplained".
    unreproduced : mapping of channel to float
        Channels of which a black-box model reproduces less than half, with the reproduced fraction.
    """

    verdict: Verdict
    causes: tuple[Named, ...]
    base: Fit
    reasons: tuple[str, ...] = ()
    unsure: tuple[str, ...] = ()
    refuted: tuple[str, ...] = ()
    odd: OutlierTrial | None = None
    unpredicted: Mapping[str, float] = field(default_factory=dict)
    unreproduced: Mapping[str, float] = field(default_factory=dict)

    @property
    def odd_trial(self) -> dict[str, float]:
        """Return the name and the error ratio of the outlier trial; empty without an outlier trial."""
        if self.odd is None:
            return {}
        return {self.odd.trial: self.odd.error_ratio}

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of the causes."""
        return tuple(c.best.tried.effect.name for c in self.causes)

    def model(self, state: State) -> Fit:
        """Return the fit of the model with the causes. If there are none, return that without effects."""
        if self.causes:
            return self.base
        return state.nominal


def judge(
    state: State,
    held: Sequence[Piece],
    noise: Floor,
    predicted: Predicted | None,
    *,
    dropout: bool,
    validation: Sequence[Trial] = (),
) -> tuple[Judgement, list[Array], Remaining]:
    """Return the verdict of a diagnosis, the gap, and the part of the gap that the causes do not close.

    The gap consists of the weighted residuals of the model without effects. It has one array, shape (n_k,),
    for each trial.

    Parameters
    ----------
    held : sequence of Piece
        Held-out predictions without and with the causes.
    noise : Floor
        Noise floor of each channel.
    predicted : tuple of Misfit or None
        Distances of held-out data from the predictions without and with the causes; None without causes.
    dropout : bool
        Whether failed samples are a cause. They explain the gap if nothing else is missing.
    validation : sequence of Trial
        Trials that are excluded from every fit.
    """
    floor = noise.inside
    told = _by_held_out(by_fits(state), state, held, floor, predicted)
    told = _by_single_trials(told, state, floor)
    # Count between-trial variation as part of the gap if a cause accounts for it.
    gap = state.nominal.marginal_residuals([e.name for e in told.base.effects])
    left = remaining(state, told.base, gap, floor)
    if told.verdict != "none":
        told = _by_remaining(told, state, left)
    if validation and told.verdict != "unexplained":
        off = shrinkage.unpredicted(state.context, told.model(state), state.noise_model, validation)
        told = replace(told, unpredicted=off)
        if told.causes and told.unpredicted:
            told = _by_prediction(told, state, held, floor)
    if told.verdict == "none" and told.unpredicted and not dropout:
        where = f"validation trials {', '.join(told.unpredicted)}"
        return replace(told, verdict="unexplained"), gap, Remaining(share=1.0, where=where, white=False)
    if told.verdict == "none":
        told = _by_differences(told, state, gap, noise, left)
    if told.verdict == "none" and dropout:
        told = replace(told, verdict="explained")
    unreproduced = _unreproduced(state, told.model(state))
    if unreproduced and told.verdict in ("none", "explained"):
        # The mean of a black-box output is estimated in each trial. The model may therefore fit although it
        # reproduces nothing but the mean.
        told = replace(told, verdict="unexplained", causes=(), base=state.nominal, unreproduced=unreproduced)
        left = Remaining(share=1.0, where=f"all of {', '.join(unreproduced)} but its mean", white=False)
    return told, gap, left


def _unreproduced(state: State, fit: Fit) -> dict[str, float]:
    """Return the outputs of which a black-box model reproduces less than half, with the reproduced fraction.

    The fraction is defined as in ``rwls`` and ``compare``: one minus the root-mean-square error divided by
    the standard deviation of the output.
    """
    if state.context.model.name != arx.NAME:
        return {}
    found = {}
    outputs = measured(state.context, fit)
    for channel, left in by_channel(fit, fit.residuals).items():
        share = 1.0 - rms(left) / max(float(np.std(outputs[channel])), 1e-300)
        if share < shrinkage.MOST:
            found[channel] = share
    return found


def by_fits(state: State) -> Judgement:
    """Return the verdict that is most probable by the fits, before the tests on held-out data.

    The verdicts are no gap, causes of the catalogue, and a cause outside the catalogue.
    """
    posterior = state.posterior
    chosen = []
    if posterior.none <= UNSURE:
        chosen = [named(state, r) for r in state.rounds]
    inside = sum(posterior.sets.values())
    verdict: Verdict = "none"
    if posterior.outside > posterior.none:
        verdict = "unexplained"
    if not chosen:
        return Judgement(verdict, (), state.base)
    if posterior.outside > inside:
        # If a cause outside the catalogue is more probable, list only effects that close part of the gap with
        # a probability above one half.
        return Judgement("unexplained", tuple(c for c in chosen if c.closing > 0.5), state.base)
    verdict = "explained"
    if inside < SURE * (inside + posterior.outside) or chosen[0].crowded or chosen[0].alone <= 0.5:
        verdict = "ambiguous"
    return Judgement(verdict, tuple(chosen), state.base)


def _by_held_out(
    told: Judgement,
    state: State,
    held: Sequence[Piece],
    floor: Mapping[str, float],
    predicted: Predicted | None,
) -> Judgement:
    if not told.causes or predicted is None:
        return told
    refused = replace(told, verdict="unexplained", causes=(), base=state.nominal)
    before, after = predicted
    # The causes may increase the squared distance by no more than the gap or the noise.
    allowed = max(before.distance - before.samples, before.samples)
    if after.distance - before.distance > allowed or not shrinkage.sound(held):
        return replace(refused, refuted=told.names)
    each, gaps = shrinkage.gained(held, floor)
    lowered, gap = float(each.sum()), max(float(gaps.sum()), 0.0)
    close = lowered > shrinkage.MOST * gap
    if held and not close and not lowered > max(TENTH * gap, shrinkage.chance(each)):
        why = f"{', '.join(told.names)}: held-out errors hardly fall with it"
        return replace(refused, reasons=(why,))
    if after.distance >= before.distance and (before.shown or lowered < 0.0 or told.verdict == "unexplained"):
        why = f"{', '.join(told.names)}: held-out data are no nearer to what the model with it predicts"
        return replace(refused, reasons=(why,))
    if held and not close:
        return _weakened(told, "less than half of the squared gap closes on held-out data")
    if by_coefficients(state) and not state.changed:
        return _weakened(told, "the refitted parameters of the file imitate the cause on held-out data")
    return told


def _weakened(told: Judgement, why: str) -> Judgement:
    """Return the judgement with a further reason for doubt. A verdict "explained" becomes "ambiguous"."""
    told = replace(told, unsure=(*told.unsure, why))
    if told.verdict == "explained":
        return replace(told, verdict="ambiguous")
    return told


def _by_prediction(
    told: Judgement, state: State, held: Sequence[Piece], floor: Mapping[str, float]
) -> Judgement:
    """Return a weaker judgement if a validation trial is not predicted with the causes.

    The causes stay in the report only if they close most of the gap of the validation trials.
    """
    trials = ", ".join(told.unpredicted)
    lowered, gap = (float(values.sum()) for values in shrinkage.gained(held, floor))
    if lowered > shrinkage.MOST * max(gap, 0.0):
        return _weakened(told, f"validation trials are not predicted with the cause: {trials}")
    why = f"{', '.join(told.names)}: validation trials are not predicted with it: {trials}"
    return replace(told, verdict="unexplained", causes=(), base=state.nominal, reasons=(*told.reasons, why))


def by_coefficients(state: State) -> bool:
    """Return whether mainly the prior of the coefficients identifies the causes.

    If refitted coefficients imitate the causes, held-out errors are as small without the causes. The causes
    are then compared with the errors of the parameters as given.
    """
    if not state.base.effects:
        return False
    null, *found = state.posterior.candidates
    best = next((c for c in found if c.names == state.posterior.best), null)
    return float(np.sum(null.folds - best.folds)) < 0.5 * (null.score - best.score)


def _by_single_trials(told: Judgement, state: State, floor: Mapping[str, float]) -> Judgement:
    if told.verdict != "unexplained" and not (told.reasons or told.unsure):
        return told
    nominal = state.nominal
    found = contradicting(state.context, nominal, nominal.marginal_residuals(), floor)
    if found is None:
        return told
    return replace(told, verdict="unexplained", causes=(), base=nominal, odd=found)


def _by_differences(
    told: Judgement, state: State, gap: Sequence[Array], noise: Floor, left: Remaining
) -> Judgement:
    """Change the verdict "none" to "unexplained" if the trials differ by more than chance.

    Chance differences are random differences of trim or friction, and differences between repeats of one
    setting.
    """
    apart = differs(state)
    if apart:
        return replace(told, verdict="unexplained", reasons=(*told.reasons, left.where))
    beyond = sum(excess(state.nominal, gap, noise.inside).values())
    samples = sum(len(r) for r in gap)
    further = noise.repeated and beyond > shrinkage.MOST * (beyond + samples)
    if further and sum(len(group) - 1 for group in repeats(state.context)) >= MIN_REPEATS:
        why = f"settings differ by more than their {noise.how}"
        return replace(told, verdict="unexplained", reasons=(*told.reasons, why))
    return told


def _by_remaining(told: Judgement, state: State, left: Remaining) -> Judgement:
    if not told.causes or not (left.share or 0.0) > shrinkage.MOST:
        return told
    why = f"{left.share:.0%} of the squared gap remains with {', '.join(told.names)}: {left.where}"
    # The remaining gap shows that a cause outside the catalogue acts, so recompute the probabilities of the
    # causes under this condition.
    beside = state.posterior.beside_outside
    causes = (replace(c, probability=beside(*c.alike)) for c in told.causes if c.closing > 0.5)
    return replace(told, verdict="unexplained", causes=tuple(causes), reasons=(*told.reasons, why))


def remaining(state: State, base: Fit, residuals: Sequence[Array], floor: Mapping[str, float]) -> Remaining:
    """Return the fraction of the gap that remains with the causes, and where it remains.

    Parameters
    ----------
    base : Fit
        The model with the causes.
    residuals : sequence of ndarray, shape (n_k,)
        The gap: weighted residuals of the model without effects.
    """
    left = state.left
    if left is None:
        return Remaining(share=0.0, where="", white=True)
    if left.found:
        # Without causes the whole gap remains.
        share = state.posterior.left if base is state.base else 1.0
        return Remaining(share=share, where=_where(state), white=False)
    moving = remainder.drifting(state.low_frequency)
    apart = bool(moving or differs(state))
    share = float(apart)
    if moving:
        whole = excess(state.nominal, residuals, floor)
        still = excess(base, state.nuisance_residuals, floor)
        share = min(sum(still[c] for c in moving) / max(sum(whole.values()), 1e-300), 1.0)
    return Remaining(share=share, where=_where(state), white=not apart)


def _where(state: State) -> str:
    """Return a text that says where the remaining residuals have structure."""
    left = state.left
    if left is None or not left.found:
        moving = remainder.drifting(state.low_frequency)
        if moving:
            return f"{' and '.join(moving)}, slower than noise and not alike in all trials"
        apart = differs(state)
        if apart:
            return f"trials differ as if by {' and '.join(apart)}, more than chance would make them"
        return "nothing that a smooth description finds"
    largest = sorted(left.places.items(), key=lambda item: -item[1])
    return " and ".join(place for place, gain in largest[:2] if gain > 0.3 * max(largest[0][1], 1e-300))


def differs(state: State) -> list[str]:
    """Return the names of random effects that vary between trials significantly more than by chance."""
    # Compute the factor that subtracts two standard errors from an estimated standard deviation.
    least = 1.0 - 2.0 / np.sqrt(2.0 * len(state.context.trials))
    return [kind.name for kind in state.random_effects if least * kind.sd > DIFFERS * kind.most]


def contradicting(
    context: FitContext, nominal: Fit, residuals: Sequence[Array], floor: Mapping[str, float]
) -> OutlierTrial | None:
    """Return the trial that contradicts the other trials (an outlier), or None.

    An outlier has most of the gap, and the other trials predict it worse than they predict each other.

    Parameters
    ----------
    nominal : Fit
        The model without effects.
    residuals : sequence of ndarray, shape (n_k,)
        Weighted residuals of that model.
    floor : mapping of channel to float
        Noise floor of each channel, in the unit of the channel.
    """
    if len(context.trials) < MIN_TRIALS or not context.folds.whole:
        return None
    excess = np.array([_excess(nominal, k, r, floor) for k, r in enumerate(residuals)])
    if not excess.max() > MAJORITY * excess.sum():
        return None
    known = dict(zip(nominal.labels, nominal.theta, strict=True))
    here = [
        replace(p, start=float(known[p.name])) if p.name in known and not p.per_trial else p
        for p in context.parameters
    ]
    try:
        return find_outlier_trial(
            output_error.fit(context.model, context.trials, parameters=here, tested=False)
        )
    except NoTrustworthyResult:
        return None


def _excess(fit: Fit, k: int, residual: Array, floor: Mapping[str, float]) -> float:
    """Return the sum of squared residuals of a trial minus the expected noise, in noise variances.

    The result is at least 0.
    """
    parts = split(fit, k, residual).items()
    return max(sum(float(np.nansum((v / max(floor[c], 1e-300)) ** 2 - 1.0)) for c, v in parts), 0.0)
