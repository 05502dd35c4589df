"""Search the causes of a gap: estimate the noise, fit sets of effects, and compare them.

The noise is estimated with the whole catalogue, even if only some effects are requested. The fit of an effect
therefore does not depend on the other requested effects.
A further hypothesis is that a single trial has parameters of its own. If this hypothesis is the most probable
one, the search begins again without the trial.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from operator import attrgetter

import numpy as np
from threadpoolctl import threadpool_limits

from swimid.diagnosis import noise, odd, posterior, remainder, screening
from swimid.diagnosis.dropouts import Dropouts, detect_failures
from swimid.diagnosis.pool import CONTENDERS, MAX_EFFECTS, PROBABLE, HypothesisPool
from swimid.diagnosis.posterior import MAX_NO_GAP_PROBABILITY, Posterior
from swimid.diagnosis.remainder import Structure
from swimid.diagnosis.screening import Screening
from swimid.diagnosis.study import GapStudy, Hypothesis
from swimid.diagnosis.verdict import MIN_SURE_PROBABILITY
from swimid.effects.base import Effect
from swimid.files.atomic import Checkpoint
from swimid.fitting.fit_common import step_check
from swimid.fitting.model import Array, Model, Trial
from swimid.fitting.problem import STEP_ERROR, StepChoice, choose_step, map_in_processes
from swimid.fitting.rivals import STRONG
from swimid.logs.sampling import white_noise_sd
from swimid.notices import Progress, show, silent

#: Maximum change of a simulated sample when the integration step is halved: as a fraction of the range of the
#: channel (SMALL_CHANGE), and in the search for effects as a fraction of the change due to the effect
#: (SMALL_EFFECT). If the noise of the channel is larger, the noise is the limit.
SMALL_CHANGE, SMALL_EFFECT = 1e-4, 0.5
#: Search for larger sets of effects: number of hypotheses to which a further effect is added (PARENTS), and
#: number of the resulting sets that are fitted (SETS).
PARENTS, SETS = 3, 10
#: Number of alternatives to each effect of a set that are fitted together with the other effects of the set.
RIVALS = 4
#: Minimum cosine between the changes of the trials by an effect and by a changed parameter at which the two
#: changes count as equal. At this cosine, each change explains nine tenths of the square of the other.
MIN_SAME_COSINE = 0.95
#: Maximum number of times that the noise is estimated before sets of effects are tried.
MAX_NOISE_UPDATES = 3


@dataclass
class CauseComparison:
    """Comparison of one candidate cause with its alternatives, while all other causes are in the model.

    Attributes
    ----------
    ranked : list of Hypothesis
        The hypothesis with the cause, followed by those with its alternatives in order of decreasing quality.
    same : tuple of str
        Names of effects that change the trials in the same way as the cause: twins of the cause, and the
        effects that are equivalent to a changed parameter.
    """

    ranked: list[Hypothesis]
    same: tuple[str, ...] = ()

    @property
    def effect(self) -> Effect:
        """Return the cause."""
        return self.ranked[0].last_screening.effect

    @property
    def name(self) -> str:
        """Return the name of the cause."""
        return self.effect.name


@dataclass(frozen=True, eq=False)
class SearchResult:
    """Result of a search, from which the answer of a diagnosis follows.

    Attributes
    ----------
    study : GapStudy
        Trials without odd ones, with the noise model and its floors.
    null : Hypothesis
        The model without effects.
    base : Hypothesis
        The model with the causes, the most probable hypothesis.
    between : list of Hypothesis
        The model with the first cause, with the first two causes, and so on, without the last model
        (:attr:`base`).
    posterior : Posterior
        Probabilities of all hypotheses.
    comparisons : list of CauseComparison
            One comparison for each cause. Changed parameters come first, and then the causes in order of
            their gain.
    singles : list of Hypothesis
        Fits with a single effect, best first.
    first_screen : list of Screening
        Screening results of every effect added to the model without effects, at the first noise model.
    left_out : dict of name to reason
        Effects that could not be screened.
    count : int
        Number of different effects.
    dropouts : Dropouts
        Failed samples.
    structure : Structure
            Structure in the residuals of the model with the causes.
    odd_trials : dict of str to str
        Trials that were left out because they have parameters of their own, and how these differ.
    """

    study: GapStudy
    null: Hypothesis
    base: Hypothesis
    between: list[Hypothesis]
    posterior: Posterior
    comparisons: list[CauseComparison]
    singles: list[Hypothesis]
    first_screen: list[Screening]
    left_out: dict[str, str]
    count: int
    dropouts: Dropouts
    structure: Structure
    odd_trials: dict[str, str]


def choose_model_step(
    model: Model,
    vectors: Sequence[Array],
    trials: Sequence[Trial],
    changes: Sequence[Mapping[str, float]] = (),
) -> StepChoice:
    """Choose the integration step of a model for its simulations of the trials.

    Parameters
    ----------
    vectors : sequence of ndarray, shape (p,)
        Parameter values of each trial.
    changes : sequence of mapping of str to float, optional
            Changes of the samples of each trial due to an effect, by channel; given in a search for effects.
            The step may then change a sample by a fraction of these values, or by the noise if it is larger.
    """
    runs = list(zip(vectors, trials, strict=True))
    allowances = []
    for k, (trial, seen) in enumerate(zip(trials, model.run_many(runs), strict=True)):
        own = {}
        for name in trial.measured:
            sd = white_noise_sd(trial.measured[name] - seen[name], 0.0)
            allowed = max(STEP_ERROR * sd, SMALL_CHANGE * float(np.ptp(seen[name])))
            if changes:
                allowed = max(sd, SMALL_EFFECT * changes[k].get(name, 0.0))
            own[name] = allowed / STEP_ERROR
        allowances.append(own)
    return choose_step(model, runs, allowances)


def choose_search_step(study: GapStudy, fit: Hypothesis, effects: Sequence[Effect]) -> StepChoice:
    """Choose an integration step for the fitted model, and for this model with each effect on the commands.

    A backlash, a dead band or a rate limit needs a smaller step than the smooth motion of the model. A sample
    may change by the fraction :data:`SMALL_EFFECT` of the effect, or by its noise, because the step is chosen
    again for the model with the causes.
    """
    trials = study.trials
    vectors = [fit.problem.vector(fit.theta, k) for k in range(len(trials))]
    found = choose_model_step(study.model, vectors, trials, [{}] * len(trials))
    without = study.model.run_many(list(zip(vectors, trials, strict=True)))
    for effect in effects:
        tries = effect.tries(effect.parameters(study.model, trials))
        if not tries or effect.in_place_of(study.model) is not study.model:
            continue
        affected = study.build_model((effect,))
        own = [np.concatenate((values, tries[len(tries) // 2])) for values in vectors]
        if not affected.hooks(own[0], trials[0]).command:
            continue
        simulated = affected.run_many(list(zip(own, trials, strict=True)))
        changes = [
            {name: float(np.max(np.abs(seen[name] - plain[name]))) for name in trial.measured}
            for trial, seen, plain in zip(trials, simulated, without, strict=True)
        ]
        needed = choose_model_step(affected, own, trials, changes)
        if needed.halvings > found.halvings:
            found = needed
    return found


def prepare_study(given: GapStudy, effects: Sequence[Effect]) -> tuple[GapStudy, Hypothesis, Dropouts]:
    """Remove failed samples from the trials, estimate the noise, and fit the model without effects.

    Returns
    -------
    GapStudy
        The study without the failed samples, with its noise model.
    Hypothesis
    Dropouts
        The failed samples.
    """
    fine, trials = given.model, given.trials
    start = [np.array([p.start for p in given.parameters])] * len(trials)
    # The search may take twice the given step if that is accurate enough.
    model = choose_model_step(fine.coarser() or fine, start, trials, [{}] * len(trials)).model
    study = given.copy_with(model, trials)
    known, fit = noise.estimate_weights(study)
    dropouts = detect_failures(study.trials, fit.problem.simulations(fit.theta))
    if dropouts.count:
        study = given.copy_with(model, dropouts.remove_from(trials))
        known, fit = noise.estimate_weights(study)
    # The step was small enough at the start values of the parameters. It may be too large at the fitted
    # values, or for effects.
    needed = choose_search_step(study, fit, effects)
    if needed.halvings:
        study = study.finer(needed.halvings)
        known, fit = noise.estimate_weights(study)
    if study.model is not fine and fine.swimmer is not None:
        # The model with the original step is not simulated any more.
        fine.swimmer.forget(study.trials)
    study = study.with_noise(known)
    terms = remainder.simulate_terms(study, fit)
    differing = noise.list_random_candidates(study, fit, effects)
    changes = [t.changes for t in terms]
    known = noise.estimate_measurement_noise(study, fit, changes, differing)
    return study.with_noise(known), fit, dropouts


@dataclass(eq=False)
class HypothesisSearch(HypothesisPool):
    """Pool of hypotheses whose noise model and integration step follow the most probable one.

    Parameters
    ----------
    every : sequence of Effect
        All effects, also those that are not requested. The noise is estimated with them.

    Attributes
    ----------
    first : list of Hypothesis
        Fits with a single effect before the noise was estimated with the leading hypothesis.
    posterior : Posterior
        Probabilities of all hypotheses.
    base : Hypothesis
        The most probable hypothesis.
    """

    every: Sequence[Effect]
    rng: np.random.Generator
    first: list[Hypothesis] = field(init=False, default_factory=list)
    posterior: Posterior = field(init=False)
    base: Hypothesis = field(init=False)

    def compare(self) -> None:
        """Compute the posterior probabilities, after refits of the most probable set without each effect.

        The refits make sure that the smaller sets are at their best optima.
        """
        while True:
            self.posterior = self.compute_posterior()
            likeliest = (h for h in self.best(len(self.posterior.best)) if h.names == self.posterior.best)
            self.base = next(likeliest, self.null)
            before = len(self._returned)
            for effect in self.base.effects:
                self.refit_without(self.base, effect)
            if len(self._returned) == before:
                return

    def select_leading(self) -> Hypothesis:
        """Return the hypothesis from whose residuals the noise is estimated.

        It is the hypothesis whose probability exceeds :data:`MIN_SURE_PROBABILITY` (a sure answer). Without a
        sure answer, the trials' random effects may change which hypothesis is probable. The most probable
        effects and the model without effects are then compared by :meth:`likelihood`. That comparison is not
        used for a sure answer, because its linear step is too optimistic far from an optimum.
        """
        known = self.posterior.probabilities
        if self.posterior.sets.get(self.posterior.best, 0.0) > MIN_SURE_PROBABILITY:
            return self.base
        if self.posterior.none > MIN_SURE_PROBABILITY:
            return self.null
        likeliest = sorted(self.best(1), key=lambda h: -known[h.names])
        scores = {h.key: self.likelihood(h) for h in (self.null, *likeliest[:CONTENDERS])}
        if not all(math.isfinite(score) for score in scores.values()):
            return self.base if known.get(self.posterior.best, 0.0) > self.posterior.none else self.null
        return self.pool[max(scores, key=lambda key: scores[key])]

    def likelihood(self, h: Hypothesis) -> float:
        """Return the restricted log-likelihood of a hypothesis with the random effects of its own residuals.

        The number of effects, and the distance of coefficients from their priors, decrease the result.
        """
        study = self.study
        self.prepare([h.effects])
        differing = noise.list_random_candidates(study, h, self.every)
        known = noise.with_random_effects(study, h, study.noise, differing, largest=noise.BESIDE_GAP)
        strain = self._shift(h, study.with_noise(known), h).strain
        candidate = replace(self._candidate(h), strain=strain)
        price = posterior.compute_price(candidate, self._candidate(self.null), self.record)
        if h.names:
            price -= posterior.compute_prior_log_odds(len(h.names), self.count)
        return known.log_likelihood - price

    def learn(self, leading: Hypothesis) -> float:
        """Estimate the noise from the residuals of the leading hypothesis, and refit the contenders.

        Structure that a generic description finds in these residuals (:mod:`swimid.diagnosis.remainder`) does
        not count as noise.

        Returns
        -------
        float
            Largest standard deviation that a random effect could have, in typical scales.
        """
        study, fit = self.study, leading
        self.prepare([fit.effects])
        uncertain = any(trial.stamps_uncertain for trial in study.trials)
        # With repeats, the differences between them show the error of the time stamps.
        if uncertain and not noise.has_repeats(study.trials):
            study = study.with_noise(noise.update_weights(study, fit))
            fit = self._shift(leading, study, leading)
        terms = remainder.simulate_terms(study, fit)
        differing = noise.list_random_candidates(study, fit, self.every)
        changes = [t.changes for t in terms]
        known = noise.estimate_measurement_noise(study, fit, changes, differing)
        structure = remainder.find_structure(study.with_noise(known), fit, terms, rng=self.rng)
        largest = noise.BESIDE_GAP
        if not structure.is_present:
            # The residuals have no structure that the trials share, so that all of them count as noise.
            known = noise.estimate_measurement_noise(study, fit, [], differing, brief=bool(fit.effects))
            largest = noise.LARGEST_SD
        known = noise.with_random_effects(study, fit, known, differing, largest=largest)
        self.change(study.with_noise(known))
        without = noise.with_held_means(self.pool[leading.key])
        if without is not None:
            self.change(study.with_noise(without))
        return largest

    def settle(self) -> None:
        """Estimate the noise again until the leading hypothesis and its random effects do not change.

        The first leading hypothesis was fitted with other random effects, and may have absorbed them.
        """
        leading = self.select_leading()
        for _ in range(MAX_NOISE_UPDATES):
            largest = self.learn(leading)
            self.compare()
            before, leading = leading, self.select_leading()
            study = self.study
            differing = noise.list_random_candidates(study, leading, self.every)
            known = noise.with_random_effects(study, leading, study.noise, differing, largest=largest)
            names = [{e.name for e in of.random_effects} for of in (known, study.noise)]
            if leading.key == before.key and names[0] == names[1]:
                return

    def change(self, study: GapStudy) -> None:
        """Continue with another noise model or integration step.

        The model without effects is refitted. The deviances of all other hypotheses follow from one step at
        their old parameters. Hypotheses that are then not improbable are refitted.
        """
        kept = [h for h in self.pool.values() if h.effects]
        if not self.first:
            self.first = self.rank(self.null, self.best(1))
        (fit,) = self._refit_all(study, [self.null])
        self.study = study
        for known in (self.pool, self.screens, self._cosines, self._returned):
            known.clear()
        self._put(fit)
        parts = attrgetter("deviance_parts")

        def put(moved: Sequence[Hypothesis]) -> None:
            for h, found in zip(moved, map_in_processes(parts, moved, study.jobs), strict=True):
                vars(h).update(deviance_parts=found)
                known = self.pool.get(h.key)
                if known is None or h.deviance < known.deviance:
                    self._put(h)

        put([self._shift(h, study, fit) for h in kept])
        # An effect cannot increase the deviance, because its null value gives the model without it. If it
        # seems to, its parameters are far from their optimum with the new noise. For a smooth effect, a step
        # from the null value finds this optimum.
        smooth = [h for h in self.pool.values() if h.effects and all(e.smooth for e in h.effects)]
        worse = [h for h in smooth if h.deviance > fit.deviance]
        put([self._shift(replace(h, theta=study.start(h.effects, fit)), study, fit) for h in worse])
        self.finish()

    def _shift(self, h: Hypothesis, study: GapStudy, null: Hypothesis) -> Hypothesis:
        """Return a hypothesis at the same parameters in another study.

        Derivatives that are already known are used again. The others are those of ``null`` and of the effects
        of the hypothesis. Random effects that the hypothesis lacks have their values in ``null``.
        """
        known = dict(zip(null.labels, null.theta, strict=True))
        own = {label: value for label, value in known.items() if label not in h.labels}
        near = [null, *([h] if "derivatives" in vars(h) else [])]
        found = study.at(h.effects, study.start(h.effects, h, own), h.cost, hold=near)
        found.tried, found.rough = h.tried, True
        return found

    def refine(self) -> bool:
        """Repeat the fits with a smaller integration step if the best hypothesis needs it.

        Return whether the step was too large.
        """
        study, best = self.study, self.base
        vectors = [best.problem.vector(best.theta, k) for k in range(len(study.trials))]
        needed = choose_model_step(study.build_model(best.effects), vectors, study.trials)
        if not needed.halvings:
            step_check([trial.id for trial in study.trials], needed.changes)
            return False
        self.change(study.finer(needed.halvings))
        return True

    def restrict(self, effects: Sequence[Effect]) -> None:
        """Continue with some of the effects only."""
        keys, names = {id(e) for e in effects}, {e.name for e in effects}
        self.effects = effects
        self.pool = {key: h for key, h in self.pool.items() if key <= keys}
        self.first = [h for h in self.first if h.last_screening.effect.name in names]
        self.first_screen = [t for t in self.first_screen if t.effect.name in names]
        self.left_out = {name: why for name, why in self.left_out.items() if name in names}
        self.finish()

    def find_screening(self, base: Hypothesis, h: Hypothesis, effect: Effect) -> Screening:
        """Return the screening result of an effect of hypothesis ``h`` that is added to hypothesis
        ``base``.
        """
        if h.tried is not None and h.tried.effect is effect:
            return h.tried
        found = next((t for t in self.screen(base) if t.effect is effect), None)
        if found is None:
            parameters = effect.parameters(self.study.model, self.study.trials)
            null = np.array([p.start for p in parameters])
            signature = [np.zeros(count) for count in base.problem.counts]
            found = Screening(effect, parameters, null, np.zeros(self.study.folds.count), 1.0, signature)
        return found

    def rank(self, base: Hypothesis, hypotheses: Sequence[Hypothesis]) -> list[Hypothesis]:
        """Return copies of hypotheses sorted by deviance, best first, with their gains over ``base``.

        Each hypothesis has one effect more than the hypothesis ``base``.
        """
        found = []
        for h in sorted(hypotheses, key=lambda h: h.deviance):
            (last,) = [e for e in h.effects if id(e) not in base.key]
            one = copy.copy(h)
            one.tried, one.gains = self.find_screening(base, h, last), base.deviances - h.deviances
            found.append(one)
        return found


def search_causes(
    given: GapStudy,
    effects: Sequence[Effect],
    *,
    asked: Collection[str] | None = None,
    seed: int = 0,
    most: int = MAX_EFFECTS,
    checkpoint: Checkpoint | None = None,
    progress: Progress = silent,
) -> SearchResult:
    """Run the complete search of a diagnosis: noise, fits of hypotheses, and choice of the causes.

    Parameters
    ----------
    effects : sequence of Effect
        All effects that apply, in every form. The noise is estimated from the residuals of the best
        hypothesis.
    asked : collection of str, optional
        Names of the effects that may be causes; all effects by default.
    """

    def start_search(study: GapStudy, fit: Hypothesis) -> HypothesisSearch:
        """Return a search with the fits of single effects."""
        with progress("effects", total=len(effects)) as shown:
            search = HypothesisSearch(
                study, effects, effects, np.random.default_rng(seed),
                checkpoint=checkpoint or Checkpoint(),
                step=partial(show, shown),
            )  # fmt: skip
            search.begin(study.start((), fit))
            search.add_effects([search.null])
            search.compare()
        return search

    odd_trials: dict[str, str] = {}
    with threadpool_limits(limits=1, user_api="blas"):
        while True:
            study, fit, dropouts = prepare_study(given, effects)
            differing = noise.list_random_candidates(study, fit, effects)
            search = start_search(odd.add_random_effects(study, differing), fit)
            fits = [search.null, *search.best(1)[:PARENTS]]
            trial = odd.find_contradicting_trial(fits, search.record, differing)
            text = None if trial is None else odd.describe(trial, differing)
            if trial is None or text is None:
                break
            odd_trials[trial.trial] = text
            given = given.copy_with(given.model, [t for t in given.trials if t.id != trial.trial])
        search.settle()
        if search.posterior.outside > 0.5 and search.study.noise.random_effects:
            # The random effects may have absorbed changes that an effect explains.
            other = start_search(study, fit)
            other.settle()
            if other.posterior.outside < search.posterior.outside:
                search = other
        search.restrict([e for e in effects if asked is None or e.name in asked])
        add_larger_sets(search, most, progress)
        return _build_result(search, given.trials, dropouts, odd_trials)


def _build_result(
    search: HypothesisSearch, trials: Sequence[Trial], dropouts: Dropouts, odd_trials: dict[str, str]
) -> SearchResult:
    """Compare the causes with their alternatives, and describe the residuals that remain with the causes.

    Parameters
    ----------
    trials : sequence of Trial
        Fitted trials with failed samples.
    """
    search.base = base = prefer_parameters(search)
    singles = search.rank(search.null, search.best(1))
    known = {h.last_screening.effect.name for h in singles}
    singles += [h for h in search.first if h.last_screening.effect.name not in known]
    comparisons = [compare_with_alternatives(search, effect) for effect in base.effects]
    # A changed parameter comes first, because it needs no additional physics.
    comparisons.sort(key=lambda c: (c.effect.adds_to is None, -c.ranked[0].gain))
    between: list[Hypothesis] = []
    for last in reversed(comparisons[1:]):
        between.insert(0, search.refit_without(between[0] if between else base, last.effect))
    if dropouts.count:
        dropouts = dropouts.confirm(detect_failures(trials, base.problem.simulations(base.theta)))
    study = search.study.with_noise(noise.with_floors(search.study, base))
    terms = remainder.simulate_terms(study, base)
    structure = remainder.find_structure(study, base, terms, rng=search.rng)
    return SearchResult(
        study, search.null, base, between, search.posterior, comparisons, singles, search.first_screen,
        search.left_out, search.count, dropouts, structure, odd_trials,
    )  # fmt: skip


def add_larger_sets(search: HypothesisSearch, most: int, progress: Progress = silent) -> None:
    """Fit larger sets of effects, as long as the remaining excess could make one of them more probable."""
    search.compare()
    count = search.count
    while 0 < len(search.base.names) < min(most, count):
        best, size = search.base, len(search.base.names)
        loses = posterior.compute_prior_log_odds(size, count)
        loses -= posterior.compute_prior_log_odds(size + 1, count)
        # The noise was estimated from the residuals of the best hypothesis, so it may contain part of the
        # excess of this hypothesis. Add the gain that the screening predicts.
        gains = [0.0, *(t.gain for t in search.screen(best))]
        excess = search.posterior.excess[best.names] + max(gains)
        if posterior.compute_largest_gain(excess, search.record) < loses:
            break
        with progress(f"sets of {size + 1}", total=SETS) as shown:
            search.step = partial(show, shown)
            parents = search.best(size)[:PARENTS]
            search.add_effects([*parents, *([best] if best not in parents else [])], SETS)
        larger = min(search.best(size + 1), key=lambda h: h.deviance, default=best)
        if best.deviance - larger.deviance < posterior.compute_tolerance(search.record, 0.0):
            break
        # Estimate the noise again: the residuals may have contained a gap that a larger set explains.
        before = search.study.noise
        search.learn(max(search.best(size + 1)[:PARENTS], key=search.likelihood))
        search.compare()
        if len(search.base.names) <= size:
            # With the noise estimated from a larger set, a smaller set is sufficient. Restore the previous
            # noise, unless the new noise leaves no gap.
            if search.posterior.none < MIN_SURE_PROBABILITY:
                search.change(search.study.with_noise(before))
                search.compare()
            break
    best = search.base
    for effect in best.effects if len(best.names) > 1 else ():
        search.add_effects([search.refit_without(best, effect)], RIVALS)
    search.compare()
    if search.refine():
        search.compare()


def compare_with_alternatives(search: HypothesisSearch, effect: Effect) -> CauseComparison:
    """Compare an effect of the most probable hypothesis with effects that could replace it."""
    best, odds = search.base, search.posterior
    base = search.refit_without(best, effect)
    rivals = [h for h in search.best(len(best.names)) if base.key < h.key and h.key != best.key]
    ranked = [*search.rank(base, [best]), *search.rank(base, rivals)]
    probabilities = odds.probabilities
    least = PROBABLE * probabilities.get(best.names, 0.0)
    candidates = {c.names: c for c in odds.candidates}
    same = []
    for h in ranked[1:]:
        other = h.last_screening
        is_same = effect.adds_to is not None and probabilities.get(h.names, 0.0) > least
        is_same = is_same and _is_same_change(search, base, ranked[0].last_screening, other)
        first, second = (candidates.get(n) for n in (best.names, base.names | {other.effect.name}))
        if is_same or (first is not None and second is not None and posterior.are_twins(first, second)):
            same.append(other.effect.name)
    return CauseComparison(ranked, tuple(same))


def prefer_parameters(search: HypothesisSearch) -> Hypothesis:
    """Return the most probable hypothesis, with changed parameters in place of equivalent effects.

    The changed parameter is preferred because it needs no additional physics.
    """
    best, known = search.base, search.posterior.probabilities
    for effect in best.effects:
        if effect.adds_to is not None:
            continue
        base = search.refit_without(best, effect)
        mine = search.find_screening(base, best, effect)
        for h in search.best(len(best.names)):
            rest = [e for e in h.effects if id(e) not in base.key]
            if not base.key < h.key or rest[0].adds_to is None:
                continue
            likely = known.get(h.names, 0.0) >= MAX_NO_GAP_PROBABILITY * known.get(best.names, 0.0)
            if likely and _is_same_change(search, base, mine, search.find_screening(base, h, rest[0])):
                best = h
                break
    return best


def _is_same_change(search: HypothesisSearch, base: Hypothesis, first: Screening, second: Screening) -> bool:
    """Return whether two effects change the trials in the same way when added to a hypothesis.

    The deviances with the two effects, priors included, must differ by no more than noise. If the difference
    is no strong evidence for one of them, the changes count as the same. If it is, their cosine must exceed
    :data:`MIN_SAME_COSINE`.
    """
    known = {c.names: c.deviance + c.strain for c in search.posterior.candidates}
    one, other = (known.get(base.names | {t.effect.name}, np.inf) for t in (first, second))
    if not abs(one - other) <= posterior.compute_tolerance(search.record, 0.0):
        return False
    if abs(one - other) < STRONG:
        return True
    return abs(screening.compute_cosine(search.study, base, first, second)) > MIN_SAME_COSINE
