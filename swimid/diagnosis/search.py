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

import math
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import combinations

import numpy as np
from threadpoolctl import threadpool_limits

from swimid.diagnosis import candidates, crossval, noise, odd, posterior, remainder
from swimid.diagnosis.candidates import Screen, Tried
from swimid.diagnosis.dropouts import Dropouts, look
from swimid.diagnosis.posterior import UNSURE, Candidate, Posterior, Record
from swimid.diagnosis.proposals import Limits
from swimid.diagnosis.readings import OtherReading
from swimid.diagnosis.remainder import Left
from swimid.diagnosis.study import FEW, FINE, ROUGH, Fit, Study
from swimid.effects.base import Effect
from swimid.files.atomic import Checkpoint
from swimid.fitting.fit_common import step_check
from swimid.fitting.model import Array, Model, Trial
from swimid.fitting.problem import map_in_processes
from swimid.fitting.steps import STEP_ERROR, Step, choose_step
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
SAME_COSINE = 0.95
#: Maximum number of effects in one hypothesis.
COMBINED = 3

Key = frozenset[int]


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """Hypothesis: the model with a set of effects, fitted to its optimum.

    Attributes
    ----------
    fit : Fit
        Optimum of the model with these effects.
    deviances : ndarray, shape (folds,)
        Minus twice the log predictive density of each fold, up to a constant.
    log_determinant : ndarray, shape (folds,)
        Part of the deviances that is the log-determinant of the covariance of the prediction.
    strain : float
        Squared distance of the parameters from their prior means.
    tried : Tried or None
        Screening result of the effect that was added last; None for the model without effects.
    rough : bool
        Whether the fit has not reached its optimum.
    """

    fit: Fit
    deviances: Array
    log_determinant: Array
    strain: float
    tried: Tried | None = None
    rough: bool = False

    @property
    def key(self) -> Key:
        """Return the identities of the effects, which identify the hypothesis in the search."""
        return frozenset(id(e) for e in self.fit.effects)

    @property
    def names(self) -> frozenset[str]:
        """Return the names of the effects of the hypothesis."""
        return frozenset(e.name for e in self.fit.effects)

    @property
    def deviance(self) -> float:
        """Sum of the deviances of all folds and of the prior."""
        return float(self.deviances.sum()) + self.strain

    @property
    def ends(self) -> list[str]:
        """Return the parameters of effects that are near a bound at which the effect could imitate others.

        The attribute :attr:`Effect.inside` of an effect lists such bounds.
        """
        fit, problem = self.fit, self.fit.problem
        ends = {"lower": problem.lower, "upper": problem.upper}
        wanted = {f"{e.name}/{name}": end for e in fit.effects for name, end in e.inside.items()}
        return [
            label
            for j, label in enumerate(fit.labels)
            if label in wanted and abs(fit.theta[j] - ends[wanted[label]][j]) < problem.scale[j]
        ]


@dataclass(frozen=True)
class Refitted:
    """Hypothesis with one more effect than a reference hypothesis.

    Attributes
    ----------
    gains : ndarray, shape (folds,)
        Decrease of the deviance of each fold, compared with the reference hypothesis.
    """

    tried: Tried
    fit: Fit
    gains: Array

    @property
    def gain(self) -> float:
        """Return the decrease of the deviance, summed over folds."""
        return float(self.gains.sum())

    @property
    def stderr(self) -> float:
        """Return the standard error of the summed gain, estimated from its variation over folds."""
        n = len(self.gains)
        if n < 2:
            return math.nan
        return float(np.sqrt(n * np.var(self.gains, ddof=1)))


@dataclass
class Round:
    """Comparison of one candidate cause with its alternatives, while all other causes are in the model.

    Attributes
    ----------
    ranked : list of Refitted
        The cause, followed by its alternatives in order of decreasing quality.
    same : tuple of str
        Names of effects that change the trials in the same way as the cause: twins of the cause, and the
        effects that are equivalent to a changed parameter.
    """

    ranked: list[Refitted]
    same: tuple[str, ...] = ()


@dataclass
class State:
    """Result of the search of a diagnosis.

    Attributes
    ----------
    nominal : Fit
        The model without effects.
    base : Fit
        The model with the causes.
    between : list of Fit
        The model with the first cause, with the first two causes, and so on, without the last model
        (:attr:`base`).
    screen : Screen
        Screening results of every effect added to the model without effects.
    singles : list of Refitted
        Fits with a single effect, best first.
    rounds : list of Round
        One for each cause. Changed parameters come first, and then the causes in order of their gain.
    left : Left
        Structure that remains with the causes.
    tried : int
        Number of effects that apply to the model and that the user requested.
    odd_trials : dict of str to str
        Trials that were left out because they have parameters of their own, and how these differ.
    limits : Limits or None
        Limits of a proposed trial; None proposes none.
    """

    study: Study
    nominal: Fit
    base: Fit
    dropouts: Dropouts
    screen: Screen
    singles: list[Refitted]
    posterior: Posterior
    rounds: list[Round] = field(default_factory=list)
    between: list[Fit] = field(default_factory=list)
    left: Left | None = None
    tried: int = 0
    odd_trials: dict[str, str] = field(default_factory=dict)
    limits: Limits | None = None


def step_of(
    model: Model,
    vectors: Sequence[Array],
    trials: Sequence[Trial],
    changes: Sequence[Mapping[str, float]] = (),
) -> Step:
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


def step_of_search(study: Study, fit: Fit, effects: Sequence[Effect]) -> Step:
    """Choose the integration step by the fitted model, and by the model with each effect on the commands.

    A backlash, a dead band or a rate limit needs a smaller step than the smooth motion of the model. The
    samples may change by :data:`SMALL_EFFECT` of the effect, or by their noise, because the step is chosen
    again for the model with the causes.
    """
    trials = study.trials
    vectors = [fit.problem.vector(fit.theta, k) for k in range(len(trials))]
    found = step_of(study.model, vectors, trials, [{}] * len(trials))
    without = study.model.run_many(list(zip(vectors, trials, strict=True)))
    for effect in effects:
        tries = effect.tries(effect.parameters(study.model, trials))
        if not tries or effect.in_place_of(study.model) is not study.model:
            continue
        affected = study.affected((effect,))
        own = [np.concatenate((values, tries[len(tries) // 2])) for values in vectors]
        if not affected.hooks(own[0], trials[0]).command:
            continue
        simulated = affected.run_many(list(zip(own, trials, strict=True)))
        changes = [
            {name: float(np.max(np.abs(seen[name] - plain[name]))) for name in trial.measured}
            for trial, seen, plain in zip(trials, simulated, without, strict=True)
        ]
        needed = step_of(affected, own, trials, changes)
        if needed.halvings > found.halvings:
            found = needed
    return found


def prepare(given: Study, effects: Sequence[Effect]) -> tuple[Study, Fit, Dropouts]:
    """Remove failed samples from the trials, estimate the noise, and fit the model without effects.

    Returns
    -------
    Study
        The study without the failed samples, with its noise model.
    Fit
    Dropouts
        The failed samples.
    """
    fine, trials = given.model, given.trials
    start = [np.array([p.start for p in given.parameters])] * len(trials)
    # The search may take twice the given step if that is accurate enough.
    model = step_of(fine.coarser() or fine, start, trials, [{}] * len(trials)).model
    study = given.replaced(model, trials)
    known, fit = noise.weigh(study)
    dropouts = look(study.trials, fit.problem.simulations(fit.theta))
    if dropouts.count:
        study = given.replaced(model, dropouts.without(trials))
        known, fit = noise.weigh(study)
    # The step was small enough at the start values of the parameters. It may be too large at the fitted
    # values, or for effects.
    needed = step_of_search(study, fit, effects)
    if needed.halvings:
        study = study.finer(needed.halvings)
        known, fit = noise.weigh(study)
    if study.model is not fine and fine.swimmer is not None:
        # The model with the original step is not simulated any more.
        fine.swimmer.forget(study.trials)
    study = study.with_noise(known)
    terms = remainder.generic_terms(study, fit)
    differing = noise.possible(study, fit, effects)
    changes = [t.changes for t in terms]
    known = noise.learn(study, fit, changes, differing)
    return study.with_noise(known), fit, dropouts


@dataclass(eq=False)
class Search:
    """Search over all hypotheses for one set of trials.

    Parameters
    ----------
    effects : sequence of Effect
        Effects in every form.
    every : sequence of Effect
        All effects, also those that are not requested. The noise is estimated with them.
    step : callable
        Function that is called with the name of each fitted effect.
    """

    study: Study
    effects: Sequence[Effect]
    every: Sequence[Effect]
    rng: np.random.Generator
    step: Callable[[str], None] = lambda _: None
    checkpoint: Checkpoint = field(default_factory=Checkpoint)
    #: Number of fits of each set of effects so far, by its name in the checkpoint.
    fits: Counter[str] = field(default_factory=Counter)
    null: Hypothesis = field(init=False)
    pool: dict[Key, Hypothesis] = field(init=False, default_factory=dict)
    #: Fits with a single effect before the noise was estimated with the leading hypothesis.
    first: list[Refitted] = field(init=False, default_factory=list)
    screens: dict[Key, Screen] = field(init=False, default_factory=dict)
    #: Screening results of every effect added to the model without effects, at the first noise model.
    first_screen: Screen = field(init=False)
    #: Structure that remained when the noise was estimated.
    left: Left | None = field(init=False, default=None)
    _cosines: dict[frozenset[int], float] = field(init=False, default_factory=dict)

    # ------------------------------------------------------------ fits

    def judged(self, fit: Fit, tried: Tried | None = None, *, rough: bool = False) -> Hypothesis:
        """Return the hypothesis of a fit, with its deviances."""
        equations = crossval.normal_equations(self.study, fit)
        distance, log_determinant = crossval.deviances(equations)
        strain = crossval.strain(equations)
        return Hypothesis(fit, distance + log_determinant, log_determinant, strain, tried, rough)

    def prepare(self, acting: Iterable[Sequence[Effect]]) -> None:
        """Compile the models of all interpretations of the robot among sets of effects.

        Worker processes would compile them several times.
        """
        for effects in acting:
            self.study.affected(effects).prepare(effects=True)

    def begin(self, start: Array) -> Hypothesis:
        """Fit the model without effects.

        If the coefficients are far from their prior means, a second fit starts at the prior means. Without
        it, an effect could seem to explain the difference between a poor optimum and the best one.
        """
        starts = self.study.begins(self.study.problem(()), start)
        self.null = self.judged(self.study.fit((), starts, tolerance=FINE))
        self.pool[self.null.key] = self.null
        return self.null

    def screened(self, parent: Hypothesis) -> Screen:
        """Screen all effects that can be added to a hypothesis.

        The screening simulates each effect at several sizes and linearises the model about each of them.
        """
        if parent.key not in self.screens:
            self.prepare([parent.fit.effects])
            rest = [e for e in self.effects if e.joins(parent.fit.effects)]
            found = Screen([])
            for readings in (False, True):
                # Screen the interpretations of the robot separately from all other effects, so that they do
                # not change the rounding errors of the other inner products.
                part = [e for e in rest if isinstance(e, OtherReading) == readings]
                simulated = candidates.simulate(self.study, parent.fit, part)
                if simulated:
                    more = candidates.screen(self.study, parent.fit, simulated)
                    found.tried += more.tried
                    found.left_out |= more.left_out
            found.tried.sort(key=lambda t: -t.gain)
            self.screens[parent.key] = found
            if not hasattr(self, "first_screen"):
                self.first_screen = found
        return self.screens[parent.key]

    def beside(self, parents: Iterable[Hypothesis], most: int | None = None) -> None:
        """Fit each hypothesis of ``parents`` with one more effect, and add the results to the pool.

        All hypotheses are fitted roughly first. Those that are not improbable are then fitted to the optimum.
        If ``most`` is given, only this number of the most promising combinations is fitted.
        """
        promised: dict[Key, tuple[float, Hypothesis, Tried]] = {}
        for parent in parents:
            for t in self.screened(parent).tried:
                key = parent.key | {id(t.effect)}
                expected = parent.deviance - t.gain
                if key not in promised or expected < promised[key][0]:
                    promised[key] = expected, parent, t
        order = sorted(promised.values(), key=lambda p: p[0])
        new = [(p, t) for _, p, t in order[:most] if p.key | {id(t.effect)} not in self.pool]
        self.prepare((*parent.fit.effects, tried.effect) for parent, tried in new)
        self._fit_all([(self._name((*p.fit.effects, t.effect)), p, t) for p, t in new])
        self.finish()

    def _fit_all(self, new: Sequence[tuple[str, Hypothesis, Tried]]) -> None:
        """Add rough fits of hypotheses with one more effect to the pool, or those of an interrupted run.

        The fits of hypotheses that are far from the best one after one iteration end there.
        """
        kept = [self.checkpoint.get(name) for name, _, _ in new]

        def begin(k: int) -> Array:
            known = kept[k]
            return self._packed(self.fitted(*new[k][1:])) if known is None else known

        def proceed(k: int) -> Array:
            _, parent, tried = new[k]
            effects, found = (*parent.fit.effects, tried.effect), results[k]
            fit = self.study.multistart(effects, [self._unpacked(effects, found).fit.theta], warm=parent.fit)
            return self._packed(fit)

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
            h = self._unpacked((*parent.fit.effects, tried.effect), found)
            self.pool[h.key] = replace(h, tried=tried)
            self.step(tried.effect.name)

    def _packed(self, fit: Fit) -> Array:
        """Return a fit with its deviances as one array, for a checkpoint or another process."""
        h = self.judged(fit)
        return np.concatenate((h.deviances, h.log_determinant, fit.theta, [h.strain, fit.cost]))

    def _unpacked(self, effects: Sequence[Effect], values: Array) -> Hypothesis:
        """Return the hypothesis with the given numbers (:meth:`_packed`). Its fit is rough."""
        own, log, theta = np.split(values[:-2], np.array([1, 2]) * self.study.folds.count)
        strain, cost = values[-2:].tolist()
        return Hypothesis(self.study.at(effects, theta, cost), own, log, strain, rough=True)

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

    def fitted(self, parent: Hypothesis, tried: Tried) -> Fit:
        """Return the first step of a joint fit of the hypothesis ``parent`` and one more effect.

        The starting points are the size that the screen predicts, the sizes that reduced the residuals
        without a refit, and the prior means of the coefficients.
        """
        study = self.study
        effects = (*parent.fit.effects, tried.effect)
        names = [f"{tried.effect.name}/{p.name}" for p in tried.parameters]
        points = [tried.point]
        # The trials are nearly linear in a changed parameter, so that its predicted optimum is enough.
        if names and tried.effect.adds_to is None:
            points += tried.starts
        starts = [study.start(effects, parent.fit, dict(zip(names, p, strict=True))) for p in points]
        others = study.begins(study.problem(effects), starts[0])[1:]
        # From distorted coefficients, one step does not show which starting point is best.
        steps = FEW if others else 1
        fit = study.first_steps(effects, [*starts, *others], warm=parent.fit, iterations=steps)
        if names and not fit.cost <= parent.fit.cost:
            # An added effect cannot increase the cost, because its null value gives the model without it.
            fit = study.at(effects, study.start(effects, parent.fit), parent.fit.cost, fit.problem)
        return fit

    def without(self, h: Hypothesis, effect: Effect) -> Hypothesis:
        """Refit a hypothesis without one of its effects, and return the smaller hypothesis.

        The starting points are the optima of the hypothesis and of the smaller one. Otherwise further effects
        could seem to explain the difference between a poor optimum and the best one.
        """
        study = self.study
        rest = tuple(e for e in h.fit.effects if e is not effect)
        known = self.pool.get(h.key - {id(effect)})
        if known is not None and not known.rough and (h.key, known.key) in self._returned:
            return known
        near = self.null if known is None else known
        starts = [study.start(rest, fit) for fit in (h.fit, near.fit)]
        fit = study.multistart(rest, starts, warm=h.fit)
        if known is not None and not fit.cost < known.fit.cost:
            fit = known.fit
        if known is None or known.rough or fit is not known.fit:
            fit = study.refit(study.at(rest, fit.theta, fit.cost), tolerance=ROUGH)
        smaller = self.judged(fit, None if known is None else known.tried)
        self._put(smaller)
        self._returned.add((h.key, smaller.key))
        return smaller

    _returned: set[tuple[Key, Key]] = field(init=False, default_factory=set)

    def _put(self, h: Hypothesis) -> None:
        """Add a hypothesis to the pool, or replace it by the same hypothesis at another optimum."""
        self.pool[h.key] = h
        self.screens.pop(h.key, None)
        self.null = self.pool[frozenset()]

    def lessened(self) -> Posterior:
        """Return the posterior probabilities after refits of the most probable set without each effect.

        The refits make sure that the smaller sets are at their best optima.
        """
        while True:
            found = self.weighed()
            best = self.likeliest(found)
            before = len(self._returned)
            for effect in best.fit.effects:
                self.without(best, effect)
            if len(self._returned) == before:
                return found

    def best(self, size: int) -> list[Hypothesis]:
        """Return the hypotheses with a given number of effects, best first.

        If an effect has several forms, only the best form of each set is returned.
        """
        found = [h for h in self.pool.values() if len(h.fit.effects) == size and not h.ends]
        first: dict[frozenset[str], Hypothesis] = {}
        for h in sorted(found, key=lambda h: h.deviance):
            first.setdefault(h.names, h)
        return list(first.values())

    def contenders(self) -> list[Hypothesis]:
        """Return the hypotheses that are not improbable, and the best ones of each size."""
        sets = self.weighed().sets
        least = PROBABLE * max(sets.values(), default=0.0)
        found = []
        for size in range(1, COMBINED + 1):
            for rank, h in enumerate(self.best(size)):
                if rank < CONTENDERS or sets.get(h.names, 0.0) > least:
                    found.append(h)
        return found

    def finish(self) -> None:
        """Fit the hypotheses that are not improbable to their optimum."""
        while wanted := [h for h in self.contenders() if h.rough]:
            for h, fit in self._refitted(self.study, wanted, ROUGH):
                self._put(self.judged(fit, h.tried))

    def _refitted(
        self, study: Study, wanted: Sequence[Hypothesis], tolerance: float
    ) -> Iterator[tuple[Hypothesis, Fit]]:
        """Yield hypotheses with their fits in a study, which are continued to their optimum."""

        def one(h: Hypothesis) -> tuple[Array, float, list[Array], list[Array]]:
            start = h.fit
            if study.model is not self.study.model:
                start = study.at(h.fit.effects, h.fit.theta)
            fit = study.refit(start, tolerance=tolerance)
            return fit.theta, fit.cost, fit.residuals, fit.derivatives

        for h, result in zip(wanted, map_in_processes(one, wanted, study.jobs), strict=True):
            theta, cost, residuals, derivatives = result
            fit = study.at(h.fit.effects, theta, cost)
            # Keep what the worker process has computed.
            vars(fit).update(residuals=residuals, derivatives=derivatives)
            yield h, fit

    # ------------------------------------------------------------ noise and integration step

    def learn(self, leading: Hypothesis) -> None:
        """Estimate the noise from the residuals of the leading hypothesis, and refit the contenders.

        Structure that a generic description finds in these residuals (:mod:`swimid.diagnosis.remainder`) does
        not count as noise.
        """
        study, fit = self.study, leading.fit
        self.prepare([fit.effects])
        terms = remainder.generic_terms(study, fit)
        differing = noise.possible(study, fit, self.every)
        changes = [t.changes for t in terms]
        known = noise.learn(study, fit, changes, differing)
        self.left = remainder.find(study.with_noise(known), fit, terms, rng=self.rng)
        largest = noise.BESIDE_GAP
        if not self.left.found:
            # Nothing that the trials share remains, so that everything else is noise.
            known = noise.learn(study, fit, [], differing, brief=bool(fit.effects))
            largest = noise.LARGEST_SD
        known = noise.with_random_effects(study, fit, known, differing, largest=largest)
        self.change(study.with_noise(known))

    def change(self, study: Study, hypotheses: Sequence[Hypothesis] | None = None) -> None:
        """Continue with another noise model or integration step.

        The model without effects is refitted. The deviances of all other hypotheses follow from one step at
        their old parameters. Those that are not improbable are refitted then.

        Parameters
        ----------
        hypotheses : sequence of Hypothesis, optional
            Hypotheses that are kept. Default: all.
        """
        kept = [h for h in hypotheses or self.pool.values() if h.fit.effects]
        if not self.first:
            self.first = self.ranked(self.null, self.best(1))
        ((_, fit),) = self._refitted(study, [self.null], ROUGH)
        self.study = study
        for known in (self.pool, self.screens, self._cosines, self._returned):
            known.clear()
        self._put(self.judged(fit))

        def one(h: Hypothesis) -> Array:
            problem = study.posed(h.fit.effects, 1)
            problem.hold_derivatives(fit.problem, fit.derivatives)
            return self._packed(study.at(h.fit.effects, h.fit.theta, h.fit.cost, problem))

        for h, found in zip(kept, map_in_processes(one, kept, study.jobs), strict=True):
            self._put(replace(self._unpacked(h.fit.effects, found), tried=h.tried))
        self.finish()

    def refine(self, best: Hypothesis) -> bool:
        """Repeat the fits with a smaller integration step if the best hypothesis needs it.

        Return whether the step was too large.
        """
        study, fit = self.study, best.fit
        vectors = [fit.problem.vector(fit.theta, k) for k in range(len(study.trials))]
        needed = step_of(study.affected(fit.effects), vectors, study.trials)
        if not needed.halvings:
            step_check([trial.id for trial in study.trials], needed.changes)
            return False
        keep = {best.key, *(best.key - {k} for k in best.key)}
        keep |= {h.key for h in self.best(len(best.key))[:CONTENDERS]}
        self.change(study.finer(needed.halvings), [h for key, h in self.pool.items() if key in keep])
        return True

    # ------------------------------------------------------------ probabilities

    def weighed(self) -> Posterior:
        """Return the posterior probability of each set of effects fitted so far."""
        found = [self._candidate(h) for size in range(1, COMBINED + 1) for h in self.best(size)]
        return posterior.posterior(self._candidate(self.null), found, record=self.record)

    @property
    def count(self) -> int:
        """Return the number of different effects in the search. Without effects, return 1."""
        return max(len({e.name for e in self.effects}), 1)

    @property
    def record(self) -> Record:
        """Return the size of the data set: numbers of residuals, folds and effects."""
        return Record(float(sum(self.null.fit.problem.counts)), self.study.folds.count, self.count)

    def _candidate(self, h: Hypothesis) -> Candidate:
        mine = {e.name for e in h.fit.effects}
        shared = [n for n in h.fit.labels if "[" not in n and n.rpartition("/")[0] in mine]
        # A coefficient with a wider prior than in the model counts as a parameter of an effect.
        numbers = len(shared) + len(self.study.loosened(h.fit.problem))
        deviances = h.deviances - self.null.log_determinant
        return Candidate(h.names, deviances, h.strain, numbers, self._alike(h))

    def _alike(self, h: Hypothesis) -> dict[str, float]:
        """Return for each effect of a hypothesis its largest similarity to another effect of the hypothesis.

        The similarity of two effects is the squared cosine between the changes of the trials that they
        cause.
        """
        if len(h.names) < 2:
            return {}
        screened = {id(t.effect): t for t in self.first_screen.tried}
        mine = [(e.name, screened.get(id(e))) for e in h.fit.effects]
        found = dict.fromkeys(sorted(h.names), 0.0)
        for (one, first), (other, second) in combinations(mine, 2):
            # An effect that changes nothing when it is the only effect has no screening result.
            if first is None or second is None:
                continue
            pair = frozenset((id(first), id(second)))
            if pair not in self._cosines:
                self._cosines[pair] = candidates.alike(self.study, self.null.fit, first, second)
            found[one], found[other] = (max(found[n], self._cosines[pair] ** 2) for n in (one, other))
        return found

    def likeliest(self, found: Posterior) -> Hypothesis:
        """Return the hypothesis of the most probable set, or the model without effects."""
        return next((h for h in self.best(len(found.best)) if h.names == found.best), self.null)

    def ranked(self, base: Hypothesis, hypotheses: Sequence[Hypothesis]) -> list[Refitted]:
        """Return the given hypotheses sorted by deviance, best first, with their gains over ``base``.

        Each hypothesis has one effect more than the hypothesis ``base``.
        """
        found = []
        for h in sorted(hypotheses, key=lambda h: h.deviance):
            (last,) = [e for e in h.fit.effects if id(e) not in base.key]
            found.append(Refitted(self.tried(base, h, last), h.fit, base.deviances - h.deviances))
        return found

    def tried(self, base: Hypothesis, h: Hypothesis, effect: Effect) -> Tried:
        """Return the screening result of an effect of hypothesis ``h`` that is added to hypothesis
        ``base``.
        """
        if h.tried is not None and h.tried.effect is effect:
            return h.tried
        found = next((t for t in self.screened(base).tried if t.effect is effect), None)
        if found is None:
            parameters = effect.parameters(self.study.model, self.study.trials)
            null = np.array([p.start for p in parameters])
            signature = [np.zeros(count) for count in base.fit.problem.counts]
            found = Tried(effect, parameters, null, np.zeros(self.study.folds.count), 1.0, signature)
        return found


def run(
    given: Study,
    effects: Sequence[Effect],
    *,
    asked: Collection[str] | None = None,
    seed: int = 0,
    most: int = COMBINED,
    checkpoint: Checkpoint | None = None,
    progress: Progress = silent,
) -> State:
    """Run the complete search of a diagnosis: noise, fits of hypotheses, and choice of the causes.

    Parameters
    ----------
    effects : sequence of Effect
        All effects that apply, in every form. The noise is estimated from the residuals of the best
        hypothesis.
    asked : collection of str, optional
        Names of the effects that may be causes; all effects by default.
    """
    rng = np.random.default_rng(seed)
    odd_trials: dict[str, str] = {}
    with threadpool_limits(limits=1, user_api="blas"):
        while True:
            study, fit, dropouts = prepare(given, effects)
            allowed = [e for e in effects if asked is None or e.name in asked]
            with progress("effects", total=len(effects)) as shown:
                search = Search(
                    study, effects, effects, rng=rng,
                    checkpoint=checkpoint or Checkpoint(),
                    step=partial(show, shown),
                )  # fmt: skip
                search.begin(study.start((), fit))
                search.beside([search.null])
                found = search.lessened()
                known = [search.null.fit, *(h.fit for h in search.best(1)[:PARENTS])]
                trial = odd.find(study, known, found, search.record, search.null.log_determinant)
                said = None if trial is None else odd.describe(study, trial)
                if trial is not None and said is not None:
                    odd_trials[trial.trial] = said
                    given = given.replaced(given.model, [t for t in given.trials if t.id != trial.trial])
                    continue
                leader = search.likeliest(found)
                search.learn(leader if found.sets.get(found.best, 0.0) > found.none else search.null)
            break
        search.effects = allowed
        state = chosen(search, dropouts, {id(e) for e in allowed}, most, progress)
        state.odd_trials = odd_trials
        if dropouts.count:
            simulated = state.base.problem.simulations(state.base.theta)
            state.dropouts = dropouts.confirmed(look(given.trials, simulated))
        state.study = state.study.with_noise(noise.with_floors(state.study, state.base))
        terms = remainder.generic_terms(state.study, state.base)
        state.left = remainder.find(state.study, state.base, terms, rng=rng)
    return state


def chosen(
    search: Search, dropouts: Dropouts, allowed: Collection[int], most: int, progress: Progress = silent
) -> State:
    """Choose the most probable set of causes.

    Larger sets are tried as long as the remaining excess could make one of them more probable.
    """
    search.pool = {key: h for key, h in search.pool.items() if key <= set(allowed)}
    search.finish()
    found = search.lessened()
    best = search.likeliest(found)
    count = search.count
    while 0 < len(best.names) < min(most, count):
        size = len(best.names)
        loses = posterior.prior(size, count) - posterior.prior(size + 1, count)
        # The noise was estimated from the residuals of the best hypothesis, so it may contain part of the
        # excess of this hypothesis. Add the gain that the screening predicts.
        left = found.excess[best.names] + max([0.0, *(t.gain for t in search.screened(best).tried)])
        if posterior.most(left, search.record) < loses:
            break
        with progress(f"sets of {size + 1}", total=SETS) as shown:
            search.step = partial(show, shown)
            parents = search.best(size)[:PARENTS]
            search.beside([*parents, *([best] if best not in parents else [])], SETS)
        larger = min(search.best(size + 1), key=lambda h: h.deviance, default=best)
        if best.deviance - larger.deviance < posterior.unit(search.record, 0.0):
            break
        # The noise was estimated from residuals that may contain what the larger set explains.
        search.learn(larger)
        found = search.lessened()
        best = search.likeliest(found)
        if len(best.names) <= size:
            break  # with the noise model of the larger set, that set is not needed
    for effect in best.fit.effects if len(best.names) > 1 else ():
        search.beside([search.without(best, effect)], RIVALS)
    found = search.lessened()
    best = search.likeliest(found)
    if search.refine(best):
        found = search.lessened()
        best = search.likeliest(found)
    return rounds(search, best, found, dropouts)


def rounds(search: Search, best: Hypothesis, found: Posterior, dropouts: Dropouts) -> State:
    """Return the result of the search with one comparison for each cause.

    Each cause is compared with its alternatives while all other causes are in the model.
    """
    best = in_parameters(search, best, found)
    null = search.null
    singles = search.ranked(null, search.best(1))
    known, mine = {r.tried.effect.name for r in singles}, {e.name for e in search.effects}
    singles += [r for r in search.first if r.tried.effect.name in mine - known]
    screen = search.first_screen
    screen = Screen(
        [t for t in screen.tried if t.effect.name in mine],
        {name: why for name, why in screen.left_out.items() if name in mine},
    )
    state = State(search.study, null.fit, best.fit, dropouts, screen, singles, found, tried=search.count)
    for effect in best.fit.effects:
        base = search.without(best, effect)
        rivals = [h for h in search.best(len(best.names)) if base.key < h.key and h.key != best.key]
        ranked = [*search.ranked(base, [best]), *search.ranked(base, rivals)]
        same = [
            r.tried.effect.name
            for r in ranked[1:]
            if _twins(found, best.names, base.names | {r.tried.effect.name})
            or (effect.adds_to is not None and _same_change(search, found, base, ranked[0].tried, r.tried))
        ]
        state.rounds.append(Round(ranked, tuple(same)))
    # A changed parameter comes first, because it needs no additional physics.
    state.rounds.sort(key=lambda r: (r.ranked[0].tried.effect.adds_to is None, -r.ranked[0].gain))
    smaller = best
    for last in reversed(state.rounds[1:]):
        smaller = search.without(smaller, last.ranked[0].tried.effect)
        state.between.insert(0, smaller.fit)
    return state


def in_parameters(search: Search, best: Hypothesis, found: Posterior) -> Hypothesis:
    """Replace each effect of a hypothesis that is equivalent to a changed parameter by that parameter.

    The changed parameter is preferred because it needs no additional physics.
    """
    for effect in best.fit.effects:
        if effect.adds_to is not None:
            continue
        base = search.without(best, effect)
        mine = search.tried(base, best, effect)
        for h in search.best(len(best.names)):
            rest = [e for e in h.fit.effects if id(e) not in base.key]
            if not base.key < h.key or rest[0].adds_to is None:
                continue
            likely = found.known.get(h.names, 0.0) >= UNSURE * found.known.get(best.names, 0.0)
            if likely and _same_change(search, found, base, mine, search.tried(base, h, rest[0])):
                best = h
                break
    return best


def _twins(found: Posterior, *sets: frozenset[str]) -> bool:
    """Return whether two sets of effects leave the same residuals."""
    known = {c.names: c for c in found.candidates}
    return all(names in known for names in sets) and posterior.are_twins(*(known[names] for names in sets))


def _same_change(search: Search, found: Posterior, base: Hypothesis, first: Tried, second: Tried) -> bool:
    """Return whether two effects change the trials in the same way when added to a hypothesis.

    The deviances with the two effects must also differ by no more than noise.
    """
    left = [found.excess.get(base.names | {t.effect.name}, np.inf) for t in (first, second)]
    if not abs(left[0] - left[1]) <= posterior.unit(search.record, 0.0):
        return False
    return abs(candidates.alike(search.study, base.fit, first, second)) > SAME_COSINE
