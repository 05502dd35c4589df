"""Search the hypotheses of a diagnosis: fit each effect, and sets of effects, to their optimum.

Each effect is fitted together with the model, from several sizes. A linear screen predicts the benefit of
each effect. It orders the work and excludes no effect. Hypotheses that remain probable after a rough fit are
fitted to their optimum. Sets of effects extend the best smaller sets by the effects with the largest
predicted benefit. The noise is estimated with the whole catalogue, even if only some effects are requested.
The fit of an effect therefore does not depend on the other requested effects.

That a single trial has parameters of its own is a hypothesis as well. If it is the most probable one, the
search begins again without this trial.
"""

from __future__ import annotations

import copy
import math
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import combinations

import numpy as np
from threadpoolctl import threadpool_limits

from swimid.diagnosis import candidates, noise, odd, posterior, remainder
from swimid.diagnosis.candidates import Screening
from swimid.diagnosis.dropouts import Dropouts, detect_failures
from swimid.diagnosis.posterior import MAX_NO_GAP_PROBABILITY, Candidate, DataSize, Posterior
from swimid.diagnosis.readings import OtherReading
from swimid.diagnosis.remainder import Structure
from swimid.diagnosis.study import FINE, HEAT, MAX_FOLD_ITERATIONS, ROUGH, GapStudy, Hypothesis
from swimid.diagnosis.verdict import MIN_SURE_PROBABILITY
from swimid.effects.base import Effect
from swimid.files.atomic import Checkpoint
from swimid.fitting.fit_common import step_check
from swimid.fitting.model import Array, Model, Trial
from swimid.fitting.problem import map_in_processes
from swimid.fitting.rivals import STRONG
from swimid.fitting.steps import STEP_ERROR, StepChoice, choose_step
from swimid.logs.sampling import white_noise_sd
from swimid.notices import Progress, show, silent

#: Maximum change of a simulated sample when the integration step is halved, if the noise of a channel is
#: smaller: as a fraction of the range of the channel, and in the search for effects as a fraction of the
#: change by the effect.
SMALL_CHANGE, SMALL_EFFECT = 1e-4, 0.5
#: Search for larger sets of effects: number of hypotheses to which a further effect is added (PARENTS), and
#: number of the resulting sets that are fitted (SETS).
PARENTS, SETS = 3, 10
#: Hypotheses whose rough fit continues after one iteration: number of the best ones (NEAREST), and maximum
#: cost of others, divided by the lowest cost (FAR).
NEAREST, FAR = 12, 4.0
#: Number of alternatives to each effect of a set that are fitted together with the other effects of the set.
RIVALS = 4
#: Minimum posterior probability, divided by the largest one, with which a hypothesis is fitted to its optimum
#: (PROBABLE), and number of the best hypotheses that are fitted in any case (CONTENDERS).
PROBABLE, CONTENDERS = 1e-4, 6
#: Minimum cosine between the changes of the trials by an effect and by a changed parameter at which the two
#: changes count as equal. At this cosine, each change explains nine tenths of the square of the other.
MIN_SAME_COSINE = 0.95
#: Maximum number of effects in one hypothesis.
MAX_EFFECTS = 3
#: Maximum number of times that the noise is learnt before sets of effects are tried.
MAX_NOISE_UPDATES = 3

Key = frozenset[int]


@dataclass
class Round:
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
        Changes of the samples of each trial by an effect, by channel, for a step of the search. It allows a
        fraction of them, and at least the noise.
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
    """Choose the integration step by the fitted model, and by the model with each effect on the commands.

    A backlash, a dead band or a rate limit needs a smaller step than the smooth motion of the model. The
    samples may change by :data:`SMALL_EFFECT` of the effect, or by their noise, because the step is chosen
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
    Study
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
class HypothesisSearch:
    """Search over all hypotheses for one set of trials.

    Parameters
    ----------
    effects : sequence of Effect
        Effects in every form.
    every : sequence of Effect
        All effects, also those that are not requested. The noise is estimated with them.
    step : callable
        Function that is called with the name of each fitted effect.

    Attributes
    ----------
    null : Hypothesis
        The model without effects.
    pool : dict of frozenset of int to Hypothesis
        All hypotheses, by the identities of their effects.
    first : list of Hypothesis
        Fits with a single effect before the noise was estimated with the leading hypothesis.
    screens : dict of frozenset of int to list of Tried
        Screening results of the effects that can be added to a hypothesis, largest predicted gain first.
    first_screen : list of Tried
        Screening results of every effect added to the model without effects, at the first noise model.
    left_out : dict of name to reason
        Effects that could not be screened.
    posterior : Posterior
        Probabilities of all hypotheses.
    base : Hypothesis
        The model with the causes, the most probable hypothesis.
    between : list of Hypothesis
        The model with the first cause, with the first two causes, and so on, without the last model
        (:attr:`base`).
    singles : list of Hypothesis
        Fits with a single effect, best first.
    rounds : list of Round
        One for each cause. Changed parameters come first, and then the causes in order of their gain.
    dropouts : Dropouts
        Failed samples.
    left : Left
        Structure that remains with the causes.
    odd_trials : dict of str to str
        Trials that were left out because they have parameters of their own, and how these differ.
    """

    study: GapStudy
    effects: Sequence[Effect]
    every: Sequence[Effect]
    rng: np.random.Generator
    step: Callable[[str], None] = lambda _: None
    checkpoint: Checkpoint = field(default_factory=Checkpoint)
    #: Number of fits of each set of effects so far, by its name in the checkpoint.
    fits: Counter[str] = field(default_factory=Counter)
    null: Hypothesis = field(init=False)
    pool: dict[Key, Hypothesis] = field(init=False, default_factory=dict)
    first: list[Hypothesis] = field(init=False, default_factory=list)
    screens: dict[Key, list[Screening]] = field(init=False, default_factory=dict)
    first_screen: list[Screening] = field(init=False, default_factory=list)
    left_out: dict[str, str] = field(init=False, default_factory=dict)
    posterior: Posterior = field(init=False)
    base: Hypothesis = field(init=False)
    between: list[Hypothesis] = field(init=False, default_factory=list)
    singles: list[Hypothesis] = field(init=False, default_factory=list)
    rounds: list[Round] = field(init=False, default_factory=list)
    dropouts: Dropouts = field(init=False)
    left: Structure = field(init=False)
    odd_trials: dict[str, str] = field(init=False, default_factory=dict)
    _cosines: dict[frozenset[int], float] = field(init=False, default_factory=dict)

    # ------------------------------------------------------------ fits

    def prepare(self, acting: Iterable[Sequence[Effect]]) -> None:
        """Compile the models of all interpretations of the robot among sets of effects.

        Worker processes would compile them several times.
        """
        for effects in acting:
            self.study.build_model(effects).prepare(effects=True)

    def begin(self, start: Array) -> Hypothesis:
        """Fit the model without effects.

        If the coefficients are far from their prior means, a second fit starts at the prior means. Without
        it, an effect could seem to explain the difference between a poor optimum and the best one.
        """
        others = self.study.begins(self.study.problem(()), start)
        self.null = self.study.fit((), [start], others=others, tolerance=FINE)
        self.pool[self.null.key] = self.null
        return self.null

    def screen(self, parent: Hypothesis) -> list[Screening]:
        """Screen all effects that can be added to a hypothesis.

        The screening simulates each effect at several sizes and linearises the model about each of them.
        """
        if parent.key not in self.screens:
            self.prepare([parent.effects])
            rest = [e for e in self.effects if e.joins(parent.effects)]
            found: list[Screening] = []
            left_out: dict[str, str] = {}
            for readings in (False, True):
                # Screen the interpretations of the robot separately from all other effects, so that they do
                # not change the rounding errors of the other inner products.
                part = [e for e in rest if isinstance(e, OtherReading) == readings]
                more, without = candidates.screen_effects(
                    self.study, parent, candidates.simulate_effects(self.study, parent, part)
                )
                found += more
                left_out |= without
            found.sort(key=lambda t: -t.gain)
            self.screens[parent.key] = found
            if not self.first_screen:
                self.first_screen, self.left_out = found, left_out
        return self.screens[parent.key]

    def add_effects(self, parents: Iterable[Hypothesis], most: int | None = None) -> None:
        """Fit each hypothesis of ``parents`` with one more effect, and add the results to the pool.

        All hypotheses are fitted roughly first. Those that are not improbable are then fitted to the optimum.
        If ``most`` is given, only this number of the most promising combinations is fitted.
        """
        promised: dict[Key, tuple[float, Hypothesis, Screening]] = {}
        for parent in parents:
            for t in self.screen(parent):
                key = parent.key | {id(t.effect)}
                expected = parent.deviance - t.gain
                if key not in promised or expected < promised[key][0]:
                    promised[key] = expected, parent, t
        order = sorted(promised.values(), key=lambda p: p[0])
        new = [(p, t) for _, p, t in order[:most] if p.key | {id(t.effect)} not in self.pool]
        self.prepare((*parent.effects, tried.effect) for parent, tried in new)
        self._fit_all([(self._name((*p.effects, t.effect)), p, t) for p, t in new])
        self.finish()

    def _fit_all(self, new: Sequence[tuple[str, Hypothesis, Screening]]) -> None:
        """Add rough fits of hypotheses with one more effect to the pool, or those of an interrupted run.

        The fits of hypotheses that are far from the best one after one iteration end there.
        """
        kept = [self.checkpoint.get(name) for name, _, _ in new]

        def begin(k: int) -> Array:
            known = kept[k]
            return self._pack(self.fit_step(*new[k][1:])) if known is None else known

        def proceed(k: int) -> Array:
            _, parent, tried = new[k]
            effects = (*parent.effects, tried.effect)
            start = self._unpack(effects, results[k]).theta
            return self._pack(
                self.study.fit(effects, [start], tolerance=ROUGH, iterations=HEAT, brief=True, hold=parent)
            )

        results = list(map_in_processes(begin, range(len(new)), self.study.jobs))
        order = sorted(range(len(new)), key=lambda k: results[k][-1])
        near = [
            k
            for rank, k in enumerate(order)
            if kept[k] is None and (rank < NEAREST or results[k][-1] < FAR * results[order[0]][-1])
        ]
        for k, found in zip(near, map_in_processes(proceed, near, self.study.jobs), strict=True):
            results[k] = found
        for k, found in enumerate(results):
            name, parent, tried = new[k]
            if kept[k] is None:
                self.checkpoint.put(name, found)
            h = self._unpack((*parent.effects, tried.effect), found, tried)
            self.pool[h.key] = h
            self.step(tried.effect.name)

    def _pack(self, h: Hypothesis) -> Array:
        """Return a hypothesis with its deviances as one array, for a checkpoint or another process."""
        return np.concatenate((h.deviances, h.log_determinant, h.theta, [h.strain, h.cost]))

    def _unpack(self, effects: Sequence[Effect], values: Array, tried: Screening | None = None) -> Hypothesis:
        """Return the hypothesis with the given numbers (:meth:`_packed`). Its fit is rough."""
        own, log, theta = np.split(values[:-2], np.array([1, 2]) * self.study.folds.count)
        strain, cost = values[-2:].tolist()
        h = self.study.at(effects, theta, cost)
        h.tried, h.rough = tried, True
        vars(h).update(deviance_parts=(own, log, strain))
        return h

    def _name(self, effects: Sequence[Effect]) -> str:
        """Return the name under which the next fit of a set of effects is stored.

        It states the form of each effect, the number of trials and of random effects, and how often the set
        was fitted before. The search is deterministic, so that a resumed search gives each fit the same name.
        """
        model, trials = self.study.model, self.study.trials
        own = ("/".join((e.name, *(p.name for p in e.parameters(model, trials)))) for e in effects)
        name = "+".join([*own, str(len(trials)), str(len(self.study.noise.random_effects))])
        self.fits[name] += 1
        return f"{name}+{self.fits[name]}"

    def fit_step(self, parent: Hypothesis, tried: Screening) -> Hypothesis:
        """Return the first step of a joint fit of the hypothesis ``parent`` and one more effect.

        The starting points are the size that the screen predicts, the size that reduced the residuals most
        without a refit, and the prior means of the coefficients.
        """
        study = self.study
        effects = (*parent.effects, tried.effect)
        names = [f"{tried.effect.name}/{p.name}" for p in tried.parameters]
        points = [tried.point]
        # The trials are nearly linear in a changed parameter, so that its predicted optimum is enough.
        if names and tried.effect.adds_to is None and tried.start is not None:
            points.append(tried.start)
        starts = [study.start(effects, parent, dict(zip(names, p, strict=True))) for p in points]
        others = study.begins(study.problem(effects), starts[0])
        steps = 1
        if others:
            # From distorted coefficients, the predicted size is inaccurate, and one step does not show which
            # starting point is best.
            steps, starts = MAX_FOLD_ITERATIONS, starts[-1:]
        fit = study.fit(
            effects, starts, others=others, tolerance=ROUGH, iterations=steps, brief=True, hold=parent
        )
        if names and not fit.cost <= parent.cost:
            # An added effect cannot increase the cost, because its null value gives the model without it.
            fit = replace(fit, theta=study.start(effects, parent), cost=parent.cost)
        return fit

    def refit_without(self, h: Hypothesis, effect: Effect) -> Hypothesis:
        """Refit a hypothesis without one of its effects, and return the smaller hypothesis.

        The starting points are the optima of the hypothesis and of the smaller one. Otherwise further effects
        could seem to explain the difference between a poor optimum and the best one.
        """
        study = self.study
        rest = tuple(e for e in h.effects if e is not effect)
        known = self.pool.get(h.key - {id(effect)})
        if known is not None and not known.rough and (h.key, known.key) in self._returned:
            return known
        near = self.null if known is None else known
        starts = [study.start(rest, fit) for fit in (h, near)]
        smaller = study.fit(rest, starts, tolerance=ROUGH, iterations=HEAT, brief=True, hold=h)
        if known is not None and not smaller.cost < known.cost:
            smaller = known
        if smaller is not known or known.rough:
            smaller = study.refit(study.at(rest, smaller.theta, smaller.cost), tolerance=ROUGH)
            smaller.tried = None if known is None else known.tried
        self._put(smaller)
        self._returned.add((h.key, smaller.key))
        return smaller

    _returned: set[tuple[Key, Key]] = field(init=False, default_factory=set)

    def _put(self, h: Hypothesis) -> None:
        """Add a hypothesis to the pool, or replace it by the same hypothesis at another optimum."""
        self.pool[h.key] = h
        self.screens.pop(h.key, None)
        self.null = self.pool[frozenset()]

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

    def best(self, size: int) -> list[Hypothesis]:
        """Return the hypotheses with a given number of effects, best first.

        If an effect has several forms, only the best form of each set is returned.
        """
        found = [h for h in self.pool.values() if len(h.effects) == size and not h.is_imitating]
        first: dict[frozenset[str], Hypothesis] = {}
        for h in sorted(found, key=lambda h: h.deviance):
            first.setdefault(h.names, h)
        return list(first.values())

    def contenders(self) -> list[Hypothesis]:
        """Return the hypotheses that are not improbable, and the best ones of each size."""
        sets = self.compute_posterior().sets
        least = PROBABLE * max(sets.values(), default=0.0)
        found = []
        for size in range(1, MAX_EFFECTS + 1):
            for rank, h in enumerate(self.best(size)):
                if rank < CONTENDERS or sets.get(h.names, 0.0) > least:
                    found.append(h)
        return found

    def finish(self) -> None:
        """Fit the hypotheses that are not improbable to their optimum."""
        while wanted := [h for h in self.contenders() if h.rough]:
            for h in self._refit_all(self.study, wanted):
                self._put(h)

    def _refit_all(self, study: GapStudy, wanted: Sequence[Hypothesis]) -> Iterator[Hypothesis]:
        """Yield hypotheses in a study, which are continued to their optimum."""

        def one(h: Hypothesis) -> tuple[Array, float, list[Array], list[Array]]:
            fit = study.refit(h, tolerance=ROUGH)
            return fit.theta, fit.cost, fit.residuals, fit.derivatives

        for h, result in zip(wanted, map_in_processes(one, wanted, study.jobs), strict=True):
            theta, cost, residuals, derivatives = result
            fit = study.at(h.effects, theta, cost)
            fit.tried = h.tried
            # Keep what the worker process has computed.
            vars(fit).update(residuals=residuals, derivatives=derivatives)
            yield fit

    def restrict(self, effects: Sequence[Effect]) -> None:
        """Continue with some of the effects only."""
        keys, names = {id(e) for e in effects}, {e.name for e in effects}
        self.effects = effects
        self.pool = {key: h for key, h in self.pool.items() if key <= keys}
        self.first = [h for h in self.first if h.last_screening.effect.name in names]
        self.first_screen = [t for t in self.first_screen if t.effect.name in names]
        self.left_out = {name: why for name, why in self.left_out.items() if name in names}
        self.finish()

    # ------------------------------------------------------------ noise and integration step

    def select_leading(self) -> Hypothesis:
        """Return the hypothesis from whose residuals the noise is estimated.

        It is the one whose probability exceeds that of a sure answer (:data:`MIN_SURE_PROBABILITY`).
        Otherwise the trials' random effects may change which hypothesis is probable. The most probable
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

        It pays for its effects, and for coefficients that are far from their priors.
        """
        study = self.study
        self.prepare([h.effects])
        differing = noise.list_random_candidates(study, h, self.every)
        known = noise.with_random_effects(study, h, study.noise, differing, largest=noise.BESIDE_GAP)
        strain = self._shift(h, study.with_noise(known), h).strain
        price = posterior.compute_price(
            replace(self._candidate(h), strain=strain), self._candidate(self.null), self.record
        )
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
        # Repeats show the error of the stamps by themselves.
        if uncertain and not noise.has_repeats(study.trials):
            study = study.with_noise(noise.update_weights(study, fit))
            fit = self._shift(leading, study, leading)
        terms = remainder.simulate_terms(study, fit)
        differing = noise.list_random_candidates(study, fit, self.every)
        changes = [t.changes for t in terms]
        known = noise.estimate_measurement_noise(study, fit, changes, differing)
        left = remainder.find_structure(study.with_noise(known), fit, terms, rng=self.rng)
        largest = noise.BESIDE_GAP
        if not left.is_present:
            # Nothing that the trials share remains, so that everything else is noise.
            known = noise.estimate_measurement_noise(study, fit, [], differing, brief=bool(fit.effects))
            largest = noise.LARGEST_SD
        known = noise.with_random_effects(study, fit, known, differing, largest=largest)
        self.change(study.with_noise(known))
        without = noise.with_held_means(self.pool[leading.key])
        if without is not None:
            self.change(study.with_noise(without))
        return largest

    def settle(self) -> None:
        """Learn the noise again until the leading hypothesis and its random effects do not change.

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
        their old parameters. Those that are not improbable are refitted then.
        """
        kept = [h for h in self.pool.values() if h.effects]
        if not self.first:
            self.first = self.rank(self.null, self.best(1))
        (fit,) = self._refit_all(study, [self.null])
        self.study = study
        for known in (self.pool, self.screens, self._cosines, self._returned):
            known.clear()
        self._put(fit)

        def one(h: Hypothesis) -> tuple[Array, Array, float]:
            return h.deviance_parts

        def put(moved: Sequence[Hypothesis]) -> None:
            for h, found in zip(moved, map_in_processes(one, moved, study.jobs), strict=True):
                vars(h).update(deviance_parts=found)
                known = self.pool.get(h.key)
                if known is None or h.deviance < known.deviance:
                    self._put(h)

        put([self._shift(h, study, fit) for h in kept])
        # An effect cannot increase the deviance, because its null value gives the model without it. Where it
        # does, the parameters are far from their optimum with the other noise. A step from the null value
        # finds it again if the effect is smooth.
        worse = [
            h
            for h in self.pool.values()
            if h.effects and h.deviance > fit.deviance and all(e.smooth for e in h.effects)
        ]
        put([self._shift(replace(h, theta=study.start(h.effects, fit)), study, fit) for h in worse])
        self.finish()

    def _shift(self, h: Hypothesis, study: GapStudy, null: Hypothesis) -> Hypothesis:
        """Return a hypothesis at the same parameters in another study.

        Its derivatives are those that are known, or else those of ``null`` and of its own effects. Further
        random effects have the values of ``null``.
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

    # ------------------------------------------------------------ probabilities

    def compute_posterior(self) -> Posterior:
        """Return the posterior probability of each set of effects fitted so far."""
        found = [self._candidate(h) for size in range(1, MAX_EFFECTS + 1) for h in self.best(size)]
        return posterior.compute_posterior_probabilities(
            self._candidate(self.null), found, record=self.record
        )

    @property
    def count(self) -> int:
        """Return the number of different effects in the search. Without effects, return 1."""
        return max(len({e.name for e in self.effects}), 1)

    @property
    def record(self) -> DataSize:
        """Return the size of the data set: numbers of residuals, folds and effects."""
        return DataSize(float(sum(self.null.problem.counts)), self.study.folds.count, self.count)

    def _candidate(self, h: Hypothesis) -> Candidate:
        mine = {e.name for e in h.effects}
        shared = [n for n in h.labels if "[" not in n and n.rpartition("/")[0] in mine]
        wider = self.study.widen_priors(h.problem)
        widening = sum(math.log(sd / self.study.prior[name][1]) for name, (_, sd) in wider.items())
        deviances = h.deviances - self.null.log_determinant
        return Candidate(h.names, deviances, h.strain, len(shared), widening, self._compute_similarities(h))

    def _compute_similarities(self, h: Hypothesis) -> dict[str, float]:
        """Return for each effect of a hypothesis its largest similarity to another effect of the hypothesis.

        The similarity of two effects is the squared cosine between the changes of the trials that they
        cause.
        """
        if len(h.names) < 2:
            return {}
        screened = {id(t.effect): t for t in self.first_screen}
        mine = [(e.name, screened.get(id(e))) for e in h.effects]
        found = dict.fromkeys(sorted(h.names), 0.0)
        for (one, first), (other, second) in combinations(mine, 2):
            # An effect that changes nothing when it is the only effect has no screening result.
            if first is None or second is None:
                continue
            pair = frozenset((id(first), id(second)))
            if pair not in self._cosines:
                self._cosines[pair] = candidates.compute_cosine(self.study, self.null, first, second)
            found[one], found[other] = (max(found[n], self._cosines[pair] ** 2) for n in (one, other))
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


def search_causes(
    given: GapStudy,
    effects: Sequence[Effect],
    *,
    asked: Collection[str] | None = None,
    seed: int = 0,
    most: int = MAX_EFFECTS,
    checkpoint: Checkpoint | None = None,
    progress: Progress = silent,
) -> HypothesisSearch:
    """Run the complete search of a diagnosis: noise, fits of hypotheses, and choice of the causes.

    Parameters
    ----------
    effects : sequence of Effect
        All effects that apply, in every form. The noise is estimated from the residuals of the best
        hypothesis.
    asked : collection of str, optional
        Names of the effects that may be causes; all effects by default.
    """
    odd_trials: dict[str, str] = {}

    def start_search(study: GapStudy, fit: Hypothesis) -> HypothesisSearch:
        """Return a search with the fits of single effects."""
        with progress("effects", total=len(effects)) as shown:
            found = HypothesisSearch(
                study, effects, effects, rng=np.random.default_rng(seed),
                checkpoint=checkpoint or Checkpoint(),
                step=partial(show, shown),
            )  # fmt: skip
            found.begin(study.start((), fit))
            found.add_effects([found.null])
            found.compare()
        return found

    with threadpool_limits(limits=1, user_api="blas"):
        while True:
            study, fit, dropouts = prepare_study(given, effects)
            differing = noise.list_random_candidates(study, fit, effects)
            search = start_search(odd.add_random_effects(study, differing), fit)
            known = [search.null, *search.best(1)[:PARENTS]]
            trial = odd.find_contradicting_trial(known, search.record, differing)
            said = None if trial is None else odd.describe(trial, differing)
            if trial is None or said is None:
                break
            odd_trials[trial.trial] = said
            given = given.copy_with(given.model, [t for t in given.trials if t.id != trial.trial])
        search.settle()
        if search.posterior.outside > 0.5 and search.study.noise.random_effects:
            # The random values of the trials may have taken up what an effect explains.
            other = start_search(study, fit)
            other.settle()
            if other.posterior.outside < search.posterior.outside:
                search = other
        search.restrict([e for e in effects if asked is None or e.name in asked])
        search.odd_trials, search.dropouts = odd_trials, dropouts
        choose_causes(search, most, progress)
        if dropouts.count:
            simulated = search.base.problem.simulations(search.base.theta)
            search.dropouts = dropouts.confirm(detect_failures(given.trials, simulated))
        search.study = search.study.with_noise(noise.with_floors(search.study, search.base))
        terms = remainder.simulate_terms(search.study, search.base)
        search.left = remainder.find_structure(search.study, search.base, terms, rng=search.rng)
    return search


def choose_causes(search: HypothesisSearch, most: int, progress: Progress = silent) -> None:
    """Choose the most probable set of causes, and compare each cause with its alternatives.

    Larger sets are tried as long as the remaining excess could make one of them more probable.
    """
    search.compare()
    count = search.count
    while 0 < len(search.base.names) < min(most, count):
        best, size = search.base, len(search.base.names)
        loses = posterior.compute_prior_log_odds(size, count) - posterior.compute_prior_log_odds(
            size + 1, count
        )
        # The noise was estimated from the residuals of the best hypothesis, so it may contain part of the
        # excess of this hypothesis. Add the gain that the screening predicts.
        gains = [0.0, *(t.gain for t in search.screen(best))]
        if (
            posterior.compute_largest_gain(search.posterior.excess[best.names] + max(gains), search.record)
            < loses
        ):
            break
        with progress(f"sets of {size + 1}", total=SETS) as shown:
            search.step = partial(show, shown)
            parents = search.best(size)[:PARENTS]
            search.add_effects([*parents, *([best] if best not in parents else [])], SETS)
        larger = min(search.best(size + 1), key=lambda h: h.deviance, default=best)
        if best.deviance - larger.deviance < posterior.compute_tolerance(search.record, 0.0):
            break
        # The noise was estimated from residuals that may contain what a larger set explains.
        before = search.study.noise
        search.learn(max(search.best(size + 1)[:PARENTS], key=search.likelihood))
        search.compare()
        if len(search.base.names) <= size:
            # With the noise of the larger set, that set is not needed. Go back, unless no gap is left then.
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
    search.base = best = prefer_parameters(search)
    search.singles = search.rank(search.null, search.best(1))
    known = {h.last_screening.effect.name for h in search.singles}
    search.singles += [h for h in search.first if h.last_screening.effect.name not in known]
    for effect in best.effects:
        base = search.refit_without(best, effect)
        rivals = [h for h in search.best(len(best.names)) if base.key < h.key and h.key != best.key]
        ranked = [*search.rank(base, [best]), *search.rank(base, rivals)]
        likely = search.posterior.probabilities
        least = PROBABLE * likely.get(best.names, 0.0)
        same = [
            h.last_screening.effect.name
            for h in ranked[1:]
            if _are_twins(search.posterior, best.names, base.names | {h.last_screening.effect.name})
            or (
                effect.adds_to is not None
                and likely.get(h.names, 0.0) > least
                and _is_same_change(search, base, ranked[0].last_screening, h.last_screening)
            )
        ]
        search.rounds.append(Round(ranked, tuple(same)))
    # A changed parameter comes first, because it needs no additional physics.
    search.rounds.sort(key=lambda r: (r.effect.adds_to is None, -r.ranked[0].gain))
    smaller = best
    for last in reversed(search.rounds[1:]):
        smaller = search.refit_without(smaller, last.effect)
        search.between.insert(0, smaller)


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


def _are_twins(found: Posterior, *sets: frozenset[str]) -> bool:
    """Return whether two sets of effects leave the same residuals."""
    known = {c.names: c for c in found.candidates}
    return all(names in known for names in sets) and posterior.are_twins(*(known[names] for names in sets))


def _is_same_change(search: HypothesisSearch, base: Hypothesis, first: Screening, second: Screening) -> bool:
    """Return whether two effects change the trials in the same way when added to a hypothesis.

    The deviances with the two effects, and with their strains, must differ by no more than noise. Effects
    without strong evidence between their deviances are the same in any case.
    """
    known = {c.names: c.deviance + c.strain for c in search.posterior.candidates}
    one, other = (known.get(base.names | {t.effect.name}, np.inf) for t in (first, second))
    if not abs(one - other) <= posterior.compute_tolerance(search.record, 0.0):
        return False
    return (
        abs(one - other) < STRONG
        or abs(candidates.compute_cosine(search.study, base, first, second)) > MIN_SAME_COSINE
    )
