"""Collect the facts from which the verdict of a diagnosis follows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from swimid.blackbox import model as arx
from swimid.diagnosis import remainder, shrinkage, verdict
from swimid.diagnosis.candidates import Refitted
from swimid.diagnosis.context import Fit, FitContext
from swimid.diagnosis.floor import Floor, by_channel, excess, measured, repeats, rms, split
from swimid.diagnosis.gap_file import Facts, Proposed, Remaining
from swimid.diagnosis.posterior import UNSURE
from swimid.diagnosis.search import Round, State
from swimid.diagnosis.shrinkage import Misfit, Piece
from swimid.diagnosis.verdict import MOST
from swimid.errors import NoTrustworthyResult
from swimid.fitting import output_error
from swimid.fitting.between_trials import MIN_TRIALS, find_outlier_trial
from swimid.fitting.model import Array, Trial

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
    def name(self) -> str:
        """Return the name of the effect."""
        return self.best.tried.effect.name

    @property
    def alike(self) -> tuple[str, ...]:
        """Return the names of the cause and its equivalents."""
        return (self.name, *self.equivalent)

    @property
    def proposed(self) -> Proposed:
        """Return the entry of the cause among the facts."""
        return Proposed(
            equivalent=list(self.equivalent), closing=self.closing, alone=self.alone, crowded=self.crowded
        )


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
class Predictions:
    """Distances of held-out data from the predictions without and with the causes.

    Attributes
    ----------
    folds, validation : tuple of mapping of str to Misfit
        Distance of each cross-validation fold, and of each validation trial, without and with the causes.
    """

    folds: tuple[Mapping[str, Misfit], ...]
    validation: tuple[Mapping[str, Misfit], ...]

    @classmethod
    def of(cls, state: State, validation: Sequence[Trial]) -> Predictions:
        """Return the distances for the models of a search."""
        fits = [state.nominal]
        if state.base.effects:
            fits.append(state.base)
        found = [shrinkage.predictions(state.context, fit, state.noise_model, validation) for fit in fits]
        folds, held = zip(*(found[0], found[-1]), strict=True)
        return cls(folds, held)

    @property
    def total(self) -> list[Misfit]:
        """Return the distances without and with the causes of all validation trials, or of the folds."""
        found = self.folds
        if self.validation[0]:
            found = self.validation
        return [shrinkage.total(each) for each in found]

    @property
    def gains(self) -> dict[str, float]:
        """Return by how much the causes decrease the squared distance of each fold and validation trial."""
        without, with_causes = ({**f, **v} for f, v in zip(self.folds, self.validation, strict=True))
        return {name: one.distance - with_causes[name].distance for name, one in without.items()}


@dataclass(frozen=True)
class Found:
    """Facts about the trials, and the objects that they describe.

    Attributes
    ----------
    facts : Facts
    causes : tuple of Named
        Proposed causes.
    """

    facts: Facts
    causes: tuple[Named, ...]


def find(
    state: State,
    held: Sequence[Piece],
    noise: Floor,
    outside: Mapping[str, float],
    predictions: Predictions,
    *,
    imitated: bool,
    dropout: bool,
) -> Found:
    """Collect the facts from which the verdict follows.

    Parameters
    ----------
    held : sequence of Piece
        Held-out predictions without and with the causes.
    noise : Floor
        Noise floor of each channel in the fitted trials.
    outside : mapping of channel to float
        Noise floor of each channel in the held-out data.
    imitated : bool
        Whether the refitted coefficients imitate the causes on held-out data.
    dropout : bool
        Whether failed samples are a cause. They explain the gap if nothing else is missing.
    """
    posterior, nominal, base = state.posterior, state.nominal, state.base
    causes: tuple[Named, ...] = ()
    if posterior.none <= UNSURE:
        causes = tuple(named(state, r) for r in state.rounds)
    model = nominal
    if causes:
        model = base
    gap = nominal.marginal_residuals()
    facts = Facts(
        no_gap=posterior.none,
        catalogue=sum(posterior.sets.values()),
        outside=posterior.outside,
        proposed={c.name: c.proposed for c in causes},
        held_out=shrinkage.by_trial(held, outside),
        noise=noise.of_trials(outside),
        gains=predictions.gains,
        imitated=imitated,
        diverged=not shrinkage.sound(held),
        unreproduced=_unreproduced(state, model),
        failed_samples=dropout,
    )
    if not causes:
        facts.differing = _differing(state, gap, noise)
    facts.unpredicted = shrinkage.unpredicted(predictions.validation[bool(causes)])
    facts.left = remaining(state, model, gap_of(state, model), noise.inside).share
    if verdict.decide(facts).verdict == "unexplained":
        facts.odd_trial = contradicting(state.context, nominal, noise.inside)
    return Found(facts, causes)


def gap_of(state: State, fit: Fit) -> list[Array]:
    """Return the gap: weighted residuals of the model without effects, one array of shape (n_k,) per trial.

    Between-trial variation counts as part of the gap if an effect of ``fit`` accounts for it.
    """
    return state.nominal.marginal_residuals([e.name for e in fit.effects])


def _unreproduced(state: State, fit: Fit) -> dict[str, float]:
    """Return the outputs of which a black-box model reproduces less than half, with the reproduced fraction.

    The fraction is defined as in ``rwls`` and ``compare``: one minus the root-mean-square error divided by
    the standard deviation of the output. The mean of a black-box output is estimated in each trial. The model
    may therefore fit although it reproduces nothing but the mean.
    """
    if state.context.model.name != arx.NAME:
        return {}
    found = {}
    outputs = measured(state.context, fit)
    for channel, left in by_channel(fit, fit.residuals).items():
        share = 1.0 - rms(left) / max(float(np.std(outputs[channel])), 1e-300)
        if share < MOST:
            found[channel] = share
    return found


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


def _differing(state: State, gap: Sequence[Array], noise: Floor) -> list[str]:
    """Return clauses about differences between trials without causes that are larger than by chance.

    Chance differences are random differences of trim or friction, and differences between repeats of one
    setting.
    """
    found = [f"they vary in {name}" for name in differs(state)]
    beyond = sum(excess(state.nominal, gap, noise.inside).values())
    samples = sum(len(r) for r in gap)
    further = noise.repeated and beyond > MOST * (beyond + samples)
    if further and sum(len(group) - 1 for group in repeats(state.context)) >= MIN_REPEATS:
        found.append(f"settings differ by more than their {noise.how}")
    return found


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
    share = 0.0
    if apart:
        # The between-trial variation that the model with the causes leaves is part of the remaining gap.
        still = base.marginal_residuals()
        whole = sum(excess(state.nominal, residuals, floor).values())
        share = min(sum(excess(base, still, floor).values()) / max(whole, 1e-300), 1.0)
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


def contradicting(context: FitContext, nominal: Fit, floor: Mapping[str, float]) -> dict[str, float]:
    """Return the trial that contradicts the other trials (an outlier) with its error ratio, or nothing.

    An outlier has most of the gap, and more of it than noise. The other trials predict it worse than they
    predict each other. The gap of a trial is what remains with its own values of the random effects. A trial
    whose trim, gain or clock differs by no more than chance is therefore no outlier.

    Parameters
    ----------
    nominal : Fit
        The model without effects.
    floor : mapping of channel to float
        Noise floor of each channel, in the unit of the channel.
    """
    if len(context.trials) < MIN_TRIALS or not context.folds.whole:
        return {}
    excess = np.array([_excess(nominal, k, r, floor) for k, r in enumerate(nominal.residuals)])
    worst = int(np.argmax(excess))
    if not excess[worst] > max(MAJORITY * excess.sum(), len(nominal.residuals[worst])):
        return {}
    known = dict(zip(nominal.labels, nominal.theta, strict=True))
    here = [
        replace(p, start=float(known[p.name])) if p.name in known and not p.per_trial else p
        for p in context.parameters
    ]
    try:
        found = find_outlier_trial(
            output_error.fit(context.model, context.trials, parameters=here, tested=False)
        )
    except NoTrustworthyResult:
        return {}
    if found is None:
        return {}
    return {found.trial: found.error_ratio}


def _excess(fit: Fit, k: int, residual: Array, floor: Mapping[str, float]) -> float:
    """Return the sum of squared residuals of a trial minus the expected noise, in noise variances.

    The result is at least 0.
    """
    parts = split(fit, k, residual).items()
    return max(sum(float(np.nansum((v / max(floor[c], 1e-300)) ** 2 - 1.0)) for c, v in parts), 0.0)
