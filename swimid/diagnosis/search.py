"""Search the hypotheses of a diagnosis: fit each effect, and sets of effects, to their optimum.

Each effect is fitted together with the model, from all tried sizes. A linear screen predicts the benefit of
each effect. The screen orders the work and excludes no effect. Sets of effects are fitted jointly. They
extend the best smaller sets by the effects with the largest predicted benefit. The noise model is estimated
with the whole catalogue, even if only some effects are requested. The fit of an effect therefore does not
depend on the other requested effects.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import combinations
from typing import NamedTuple

import numpy as np
from threadpoolctl import threadpool_limits

from swimid.diagnosis import candidates, crossval, posterior, remainder
from swimid.diagnosis.candidates import Refitted, Screen, Tried
from swimid.diagnosis.context import FINE, ROUGH, STEPS, Fit, FitContext
from swimid.diagnosis.dropouts import Dropouts, look
from swimid.diagnosis.floor import nuisance_residuals
from swimid.diagnosis.noise_model import NoiseModel
from swimid.diagnosis.posterior import UNSURE, Candidate, Posterior, Record
from swimid.diagnosis.proposals import Limits
from swimid.diagnosis.random_effects import RandomEffect
from swimid.diagnosis.readings import OtherReading
from swimid.diagnosis.remainder import Left, LowFrequency
from swimid.diagnosis.weighting import random_effect_columns, see, settled, tells_noise, weigh
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
SMALL_CHANGE, SMALL_EFFECT = 1e-4, 0.05
#: Search for larger sets of effects: number of hypotheses to which a further effect is added (PARENTS), and
#: number of the resulting sets that are fitted (SETS).
PARENTS, SETS = 4, 10
#: Number of alternatives to each effect of a set that are fitted together with the other effects of the set.
RIVALS = 4
#: Improbable hypotheses: their maximum posterior probability divided by the largest one (HOPELESS), the same
#: after a rough fit (ROUGHLY), and the maximum number of iterations of their refit with the estimated noise
#: (FEW).
HOPELESS, ROUGHLY, FEW = 1e-4, 1e-6, 2
#: Minimum cosine between the changes of the trials by an effect and by a changed parameter at which the two
#: changes count as equal. At this cosine, each change explains nine tenths of the square of the other.
SAME_COSINE = 0.95
#: Iterative estimation of the noise: maximum number of iterations (TURNS), and convergence tolerance of the
#: between-trial standard deviations, in typical scales (STAYS).
TURNS, STAYS = 6, 0.02
#: Maximum number of effects in one hypothesis.
COMBINED = 3

Key = frozenset[int]


class Outcome(NamedTuple):
    """Result of a fit that a worker process returns. It is small, because there are many hypotheses.

    Attributes
    ----------
    theta, cost
        Optimum (:class:`~swimid.diagnosis.context.Fit`).
    misfits, inside, slow
        Squared residuals (:class:`Hypothesis`).
    """

    theta: Array
    cost: float
    misfits: Array
    inside: Array
    slow: float | None

    def packed(self) -> Array:
        """Return all numbers of the outcome as one array, for a checkpoint."""
        slow = math.nan if self.slow is None else self.slow
        return np.concatenate([self.theta, self.misfits, self.inside, [self.cost, slow]])

    @classmethod
    def unpacked(cls, values: Array, folds: int) -> Outcome:
        """Return the outcome with the given numbers (:meth:`packed`). ``folds`` is the number of folds."""
        theta, misfits, inside = np.split(values[:-2], [len(values) - 2 - 2 * folds, len(values) - 2 - folds])
        slow = None if math.isnan(values[-1]) else float(values[-1])
        return cls(theta, float(values[-2]), misfits, inside, slow)


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """Hypothesis: the model with a set of effects, fitted to its optimum.

    Attributes
    ----------
    fit : Fit
        Optimum of the model with these effects.
    misfits : ndarray, shape (folds,)
        Held-out squared residuals of each fold, approximated by one Gauss-Newton step from the fit to all
        folds.
    tried : Tried or None
        Screening result of the effect that was added last; None for the model without effects.
    inside : ndarray, shape (folds,)
        Squared residuals of each fold in the fit to all folds.
    slow : float or None
        Squared residuals in a refit with the noise model :attr:`NoiseModel.long_memory`, if there is one.
    score : float
        Cost at the optimum plus the penalty for the parameters of the effects.
    """

    fit: Fit
    misfits: Array
    inside: Array
    slow: float | None
    score: float
    tried: Tried | None = None

    @property
    def key(self) -> Key:
        """Return the identities of the effects, which identify the hypothesis in the search."""
        return frozenset(id(e) for e in self.fit.effects)

    @property
    def names(self) -> frozenset[str]:
        """Return the names of the effects of the hypothesis."""
        return frozenset(e.name for e in self.fit.effects)

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
    """Intermediate results of a diagnosis.

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
        One for each cause. Changed parameters come first, and then the causes in order of their decrease of
        the held-out squared residuals.
    """

    context: FitContext
    noise_model: NoiseModel
    nominal: Fit
    base: Fit
    dropouts: Dropouts
    screen: Screen
    singles: list[Refitted]
    posterior: Posterior
    rounds: list[Round] = field(default_factory=list)
    left: Left | None = None
    between: list[Fit] = field(default_factory=list)
    random_effects: list[RandomEffect] = field(default_factory=list)
    low_frequency: dict[str, LowFrequency] = field(default_factory=dict)
    nuisance_residuals: list[Array] = field(default_factory=list)
    #: The model with the causes as it predicts held-out data best: with random effects, or without them.
    predictive: Fit | None = None
    #: Number of effects that apply to the model and that the user requested.
    tried: int = 0
    #: Limits of a proposed trial; None proposes none.
    limits: Limits | None = None

    @property
    def changed(self) -> bool:
        """Return whether the trials have a gap and a changed parameter is among the causes."""
        return self.posterior.none <= UNSURE and any(e.adds_to is not None for e in self.base.effects)


def step_of(
    model: Model,
    vectors: Sequence[Array],
    trials: Sequence[Trial],
    changes: Sequence[Mapping[str, float]] = (),
) -> Step:
    """Choose the integration step of a model by the noise of the trials.

    Parameters
    ----------
    vectors : sequence of ndarray
        Parameter values of each trial.
    changes : sequence of mapping of str to float, optional
        Changes of the samples of each trial by an effect, by channel. The search for effects allows a small
        fraction of them, and at least the noise.
    """
    runs = list(zip(vectors, trials, strict=True))
    noise = []
    for k, (trial, seen) in enumerate(zip(trials, model.simulate_many(runs), strict=True)):
        own = {}
        for name in trial.measured:
            sd = white_noise_sd(trial.measured[name] - seen[name], 0.0)
            allowed = max(STEP_ERROR * sd, SMALL_CHANGE * float(np.ptp(seen[name])))
            if changes:
                allowed = max(sd, SMALL_EFFECT * changes[k][name])
            own[name] = allowed / STEP_ERROR
        noise.append(own)
    return choose_step(model, runs, noise)


def step_of_search(context: FitContext, fit: Fit, effects: Sequence[Effect]) -> Step:
    """Choose the integration step by the fitted model, and by the model with each effect on the commands.

    A backlash, a dead band or a rate limit needs a smaller step than the smooth motion of the model. The
    samples may change by :data:`SMALL_EFFECT` of the effect, or by their noise, because the step is chosen
    again for the model with the causes.
    """
    trials = context.trials
    vectors = [fit.problem.vector(fit.theta, k) for k in range(len(trials))]
    found = step_of(context.model, vectors, trials)
    without = context.model.simulate_many(list(zip(vectors, trials, strict=True)))
    for effect in effects:
        tries = effect.tries(effect.parameters(context.model, trials))
        affected = context.affected((effect,))
        if not tries or affected.model is not context.model:
            continue
        own = [np.concatenate((values, tries[len(tries) // 2])) for values in vectors]
        if not affected.hooks(own[0], trials[0]).command:
            continue
        simulated = affected.simulate_many(list(zip(own, trials, strict=True)))
        changes = [
            {name: float(np.max(np.abs(seen[name] - plain[name]))) for name in trial.measured}
            for trial, seen, plain in zip(trials, simulated, without, strict=True)
        ]
        needed = step_of(affected, own, trials, changes)
        if needed.halvings > found.halvings:
            found = needed
    return found


@dataclass(eq=False)
class Search:
    """Search over all hypotheses for one set of trials with one noise model.

    Parameters
    ----------
    context : FitContext
    noise_model : NoiseModel
    effects : sequence of Effect
        Effects in every form.
    scattering : sequence of Effect
        Effects that may be random effects.
    step : callable
        Function that is called with the name of each fitted effect.
    """

    context: FitContext
    noise_model: NoiseModel
    effects: Sequence[Effect]
    scattering: Sequence[Effect]
    rng: np.random.Generator
    step: Callable[[str], None] = lambda _: None
    checkpoint: Checkpoint = field(default_factory=Checkpoint)
    #: Number of fits of each set of effects so far, by its name in the checkpoint.
    fits: Counter[str] = field(default_factory=Counter)
    null: Hypothesis = field(init=False)
    random_effects: list[RandomEffect] = field(init=False, default_factory=list)
    pool: dict[Key, Hypothesis] = field(init=False, default_factory=dict)
    screens: dict[Key, Screen] = field(init=False, default_factory=dict)
    #: Pairs of a set of effects and a smaller set that has been refitted from the optimum of the larger one.
    #: The sets are given by their keys.
    returned: set[tuple[Key, Key]] = field(init=False, default_factory=set)
    #: Keys of improbable hypotheses, whose fits were stopped after a few iterations.
    hopeless: set[Key] = field(init=False, default_factory=set)
    _cosines: dict[frozenset[int], float] = field(init=False, default_factory=dict)

    # ------------------------------------------------------------ fits

    def outcome(self, fit: Fit) -> Outcome:
        """Return the optimum and the squared residuals of a fit."""
        inner = crossval.normal_equations(self.context, fit, self.noise_model)
        slow, long_memory = None, self.noise_model.long_memory
        if long_memory is not None:
            equations = crossval.normal_equations(self.context, fit, long_memory)
            slow = float(crossval.projected(equations)[-1, -1])
        return Outcome(fit.theta, fit.cost, crossval.held_out(inner), inner.products[:, -1, -1], slow)

    def judged(
        self,
        fit: Fit,
        tried: Tried | None = None,
        parent: Hypothesis | None = None,
        found: Outcome | None = None,
    ) -> Hypothesis:
        """Return the hypothesis of a fit, with its squared residuals.

        Parameters
        ----------
        found : Outcome, optional
            Result of the fit, if a worker process has computed it.
        """
        found = found or self.outcome(fit)
        misfits, score = found.misfits, fit.cost + self.penalty(fit)
        if parent is not None and tried is not None and any(p.per_trial for p in tried.parameters):
            own = candidates.own(fit, tried)
            misfits = parent.misfits - candidates.own_gains(self.context, parent.fit, self.noise_model, own)
        return Hypothesis(fit, misfits, found.inside, found.slow, score, tried)

    def prepare(self, acting: Iterable[Sequence[Effect]]) -> None:
        """Compile the models of all interpretations of the robot among sets of effects.

        Worker processes would compile them several times.
        """
        for effects in acting:
            self.context.affected(effects).model.prepare(effects=True)

    def penalty(self, fit: Fit) -> float:
        """Return the BIC penalty for the parameters of the effects in a fit."""
        counts = fit.problem.counts
        mine = [label for label in fit.labels if _belongs(label, fit.effects)]
        each = sum("[" in label for label in mine)
        # A coefficient with a wider prior than in the model counts as a parameter of an effect.
        freed = len(self.context.loosened(fit.problem))
        return posterior.penalty(len(mine) - each + freed, each, float(sum(counts)), len(counts))

    def begin(self, start: Array) -> Hypothesis:
        """Fit the model without effects.

        If the coefficients are far from their prior means, a second fit starts at the prior means. Without
        it, an effect could seem to explain the difference between a poor optimum and the best one.
        """
        starts = self.context.begins(self.context.problem((), self.noise_model.random_effects), start)
        fit = self.context.fit((), self.noise_model, starts, tolerance=FINE)
        self.null = self.judged(fit)
        self.pool[self.null.key] = self.null
        return self.null

    def screened(self, parent: Hypothesis) -> Screen:
        """Screen all effects that can be added to a hypothesis.

        The screening simulates each effect at several sizes and linearises the model about each of them.
        """
        if parent.key not in self.screens:
            self.prepare([parent.fit.acting])
            rest = [e for e in self.effects if e.joins(parent.fit.effects)]
            found = Screen([])
            for readings in (False, True):
                # Screen the interpretations of the robot separately from all other effects, so that they do
                # not change the rounding errors of the other inner products.
                part = [e for e in rest if isinstance(e, OtherReading) == readings]
                simulated = candidates.simulate(self.context, parent.fit, part)
                if simulated:
                    more = candidates.screen(self.context, parent.fit, self.noise_model, simulated)
                    found.tried += more.tried
                    found.left_out |= more.left_out
            found.tried.sort(key=lambda t: -t.gain)
            self.screens[parent.key] = found
        return self.screens[parent.key]

    def beside(self, parents: Iterable[Hypothesis], most: int | None = None) -> None:
        """Fit each hypothesis of ``parents`` with one more effect, and add the results to the pool.

        All hypotheses are fitted roughly first. Those that are not improbable are then fitted to the optimum.
        If ``most`` is given, only this number of the most promising combinations is fitted.
        """
        context = self.context
        promised: dict[Key, tuple[float, Hypothesis, Tried]] = {}
        for parent in parents:
            for t in self.screened(parent).tried:
                key = parent.key | {id(t.effect)}
                expected = float(parent.misfits.sum()) - t.gain
                if key not in promised or expected < promised[key][0]:
                    promised[key] = expected, parent, t
        order = sorted(promised.values(), key=lambda p: p[0])
        new = [(p, t) for _, p, t in order[:most] if p.key | {id(t.effect)} not in self.pool]
        self.prepare((*parent.fit.acting, tried.effect) for parent, tried in new)
        names = [self._name((*parent.fit.effects, tried.effect)) for parent, tried in new]
        kept = [self.checkpoint.get(name) for name in names]

        def one(k: int) -> Outcome:
            known = kept[k]
            if known is not None:
                return Outcome.unpacked(known, context.folds.count)
            return self.outcome(self.fitted(*new[k]))

        for k, found in enumerate(map_in_processes(one, range(len(new)), context.jobs)):
            parent, tried = new[k]
            effects = (*parent.fit.effects, tried.effect)
            if kept[k] is None:
                self.checkpoint.put(names[k], found.packed())
            fit = context.at(effects, self.noise_model, found.theta, found.cost)
            h = self.judged(fit, tried, parent, found)
            self.pool[h.key] = h
            self.hopeless.add(h.key)
            self.step(tried.effect.name)
        self.finish(ROUGHLY, ROUGH)

    def _name(self, effects: Sequence[Effect]) -> str:
        """Return the name under which the next fit of a set of effects is stored.

        It states the form of each effect, the number of random effects, and how often the set was fitted
        before. The search is deterministic, so that a resumed search gives each fit the same name.
        """
        model, trials = self.context.model, self.context.trials
        own = ("/".join((e.name, *(p.name for p in e.parameters(model, trials)))) for e in effects)
        name = "+".join([*own, str(len(self.noise_model.random_effects))])
        self.fits[name] += 1
        return f"{name}+{self.fits[name]}"

    def fitted(self, parent: Hypothesis, tried: Tried) -> Fit:
        """Return a rough joint fit of the hypothesis ``parent`` and one more effect.

        The starting points are the size that the screen predicts, the sizes that reduced the residuals
        without a refit, and the prior means of the coefficients.
        """
        context, noise_model = self.context, self.noise_model
        effects = (*parent.fit.effects, tried.effect)
        names = [f"{tried.effect.name}/{p.name}" for p in tried.parameters]
        problem = context.problem(effects, noise_model.random_effects)
        points = [tried.point]
        # The trials are nearly linear in a changed parameter, so that its predicted optimum is enough.
        if names and tried.effect.adds_to is None:
            points += tried.starts
        starts = [
            context.start(effects, noise_model, parent.fit, dict(zip(names, point, strict=True)))
            for point in points
        ]
        starts += context.begins(problem, starts[0])[1:]
        fit = context.multistart(effects, noise_model, starts, warm=parent.fit, rough=True)
        if names and not fit.cost <= parent.fit.cost:
            # An added effect cannot increase the cost, because its null value gives the model without the
            # effect. If the cost is larger, start again at the null value.
            null = context.start(effects, noise_model, parent.fit)
            fit = context.multistart(effects, noise_model, [null], warm=parent.fit, rough=True)
        return fit

    def without(self, h: Hypothesis, effect: Effect) -> Hypothesis:
        """Refit a hypothesis without one of its effects, and return the smaller hypothesis.

        The starting points are the optimum of the hypothesis, and the optima of the best other hypotheses
        that contain the remaining effects. Otherwise further effects could seem to explain the difference
        between a poor optimum and the best one.
        """
        context, noise_model = self.context, self.noise_model
        rest = tuple(e for e in h.fit.effects if e is not effect)
        known = self.pool.get(h.key - {id(effect)})
        if known is None:
            starts = [context.start(rest, noise_model, fit) for fit in (h.fit, self.null.fit)]
            fit = context.multistart(rest, noise_model, starts, warm=h.fit)
            found = self.judged(fit)
            self.pool[found.key] = found
            return found
        others = [o for o in self.pool.values() if known.key < o.key and o.fit.cost < known.fit.cost]
        best = sorted(others, key=lambda o: o.fit.cost)[: PARENTS if rest else 0]
        new = [o for o in {h, *best} if (o.key, known.key) not in self.returned]
        if new:
            self.returned.update((o.key, known.key) for o in new)
            starts = [context.start(rest, noise_model, o.fit) for o in sorted(new, key=lambda o: o.fit.cost)]
            again = context.multistart(rest, noise_model, starts, warm=h.fit)
            if again.cost < known.fit.cost:
                self._refitted(known, self.outcome(again))
        return self.pool[known.key]

    def lessened(self) -> Posterior:
        """Return the posterior probabilities after refits of the most probable set without each effect.

        The refits make sure that the smaller sets are at their best optima.
        """
        while True:
            found = self.weighed()
            best = self.likeliest(found)
            before = len(self.returned)
            for effect in best.fit.effects:
                self.without(best, effect)
            if len(self.returned) == before:
                return found

    def best(self, size: int) -> list[Hypothesis]:
        """Return the hypotheses with a given number of effects, best first.

        If an effect has several forms, only the best form of each set is returned.
        """
        found = [h for h in self.pool.values() if len(h.fit.effects) == size and not h.ends]
        first: dict[frozenset[str], Hypothesis] = {}
        for h in sorted(found, key=lambda h: h.score):
            first.setdefault(h.names, h)
        return list(first.values())

    # ------------------------------------------------------------ noise

    def learn(self, leading: Hypothesis) -> None:
        """Estimate the noise from the residuals of the leading hypothesis, and refit all hypotheses.

        Structure that a generic description finds in these residuals (:mod:`swimid.diagnosis.remainder`) does
        not count as noise.
        """
        context, noise_model, fit = self.context, self.noise_model, leading.fit
        self.prepare([fit.acting])
        whole = tells_noise(context)
        # Estimate the between-trial variation first: standard deviations and optimum are updated in turn
        # until they converge. The generic description would absorb the variation, so it comes last.
        stays = False
        for turn in range(TURNS if whole else 2):
            left = remainder.find(context, fit, noise_model, rng=self.rng)
            last = stays or turn == TURNS - 1
            columns: list[list[Array]] = []
            prior: list[float] = []
            unknowns = float(len(fit.labels))
            if not whole or (last and left.found):
                columns, prior = left.columns, left.prior
                unknowns += left.freedom
            before = {kind.label: kind.sd for kind in noise_model.random_effects}
            noise_model, self.random_effects = see(
                context,
                fit,
                noise_model,
                remainder.saturated(context, fit, noise_model, columns, prior),
                self.scattering,
                unknowns,
                common=len(fit.effects),
                cautious=left.found,
            )
            noise_model = settled(context, fit, noise_model)
            fit = context.fit(
                fit.effects, noise_model, [context.start(fit.effects, noise_model, fit)], tolerance=FINE
            )
            now = {kind.label: kind.sd for kind in noise_model.random_effects}
            if last:
                break
            stays = all(abs(now.get(n, 0.0) - before.get(n, 0.0)) < STAYS for n in {*now, *before})
        found = self.weighed()
        far = {names for names, p in found.sets.items() if p < HOPELESS * max(found.sets.values())}
        held = {kind.label: kind.sd for kind in noise_model.random_effects}
        self.random_effects = [replace(k, sd=max(k.sd, held.get(k.label, 0.0))) for k in self.random_effects]
        self.noise_model = noise_model
        self.screens.clear()
        self._cosines.clear()
        self.returned.clear()
        kept, null = list(self.pool.values()), self.null
        self.pool.clear()
        self.begin(context.start((), noise_model, null.fit))

        def one(h: Hypothesis) -> Outcome:
            effects = h.fit.effects
            problem = context.problem(effects, noise_model.random_effects)
            sizes = {n: v for n, v in zip(h.fit.labels, h.fit.theta, strict=True) if _belongs(n, effects)}
            begun = context.start(effects, noise_model, self.null.fit, sizes)
            null = context.start(effects, noise_model, self.null.fit)
            if h.names in far:
                fit = context.fit(effects, noise_model, [begun], iterations=FEW, warm=self.null.fit)
                # An effect cannot increase the cost, because its null value gives the model without the
                # effect.
                if sizes and not fit.cost <= self.null.fit.cost:
                    fit = context.at(effects, noise_model, null, self.null.fit.cost)
                return self.outcome(fit)
            # Start at the previous optimum, and at the optimum of the model without effects. The second start
            # is needed because the previous per-trial values depend on the previous noise model.
            starts = [*context.begins(problem, context.start(effects, noise_model, h.fit)), begun]
            fit = context.multistart(effects, noise_model, starts, warm=self.null.fit)
            if sizes and not fit.cost <= self.null.fit.cost:
                fit = context.multistart(effects, noise_model, [null], warm=self.null.fit)
            return self.outcome(fit)

        # Fit parents before the hypotheses that are evaluated relative to them.
        old = sorted((h for h in kept if h.fit.effects), key=lambda h: len(h.fit.effects))
        self.hopeless = {h.key for h in old if h.names in far}
        for h, refit in zip(old, map_in_processes(one, old, self.context.jobs), strict=True):
            if h.tried is not None:
                self.step(h.tried.effect.name)
            self._refitted(h, refit)

    def refine(self, best: Hypothesis) -> bool:
        """Repeat all fits with a smaller integration step if the best hypothesis needs it.

        Return whether the step was too large.
        """
        context, fit = self.context, best.fit
        vectors = [fit.problem.vector(fit.theta, k) for k in range(len(context.trials))]
        needed = step_of(context.affected(fit.acting), vectors, context.trials)
        if not needed.halvings:
            step_check([trial.id for trial in context.trials], needed.changes)
            return False
        self.context = context = context.finer(needed.halvings)
        fit = context.fit(fit.effects, self.noise_model, [fit.theta], tolerance=FINE)
        self.learn(self.judged(fit, best.tried))
        self.finish()
        return True

    def finish(self, improbable: float = HOPELESS, tolerance: float = FINE) -> None:
        """Complete the early-stopped fits of hypotheses that are not improbable.

        Parameters
        ----------
        improbable : float
            Maximum posterior probability of an improbable hypothesis, divided by the largest one.
        tolerance : float
            Relative tolerance of the cost.
        """
        context, noise_model = self.context, self.noise_model

        def one(h: Hypothesis) -> Outcome:
            starts = [h.fit.theta]
            fit = context.fit(h.fit.effects, noise_model, starts, tolerance=tolerance, iterations=STEPS)
            return self.outcome(fit)

        while True:
            found = self.weighed().sets
            least = improbable * max(found.values(), default=0.0)
            wanted = [
                h for key, h in self.pool.items() if key in self.hopeless and found.get(h.names, 0.0) > least
            ]
            if not wanted:
                return
            for h, refit in zip(wanted, map_in_processes(one, wanted, self.context.jobs), strict=True):
                self._refitted(h, refit)
                self.hopeless.discard(h.key)

    def _refitted(self, h: Hypothesis, found: Outcome) -> None:
        """Replace a hypothesis in the pool by the same hypothesis at another optimum."""
        parent = None
        if h.tried is not None:
            parent = self.pool.get(h.key - {id(h.tried.effect)})
        fit = self.context.at(h.fit.effects, self.noise_model, found.theta, found.cost)
        self.pool[h.key] = self.judged(fit, h.tried, parent, found)
        self.screens.pop(h.key, None)
        self.null = self.pool[frozenset()]

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
        return Record(float(sum(self.null.fit.problem.counts)), self.context.folds.count, self.count)

    def _candidate(self, h: Hypothesis) -> Candidate:
        # All per-trial parameters of one effect, for example its cosine and sine amplitudes, count as one
        # parameter.
        mine = [n for n in h.fit.labels if _belongs(n, h.fit.effects)]
        kinds = {n.split("/")[0] if "[" in n else n for n in mine}
        slow = None
        if h.slow is not None:
            slow = h.slow + self.penalty(h.fit)
        # What an unfinished fit leaves is no error of an exact form.
        finished = bool(h.names) and h.key not in self.hopeless
        exact = finished and all(e.adds_to is not None for e in h.fit.effects)
        return Candidate(h.names, h.score, h.inside, len(kinds), slow, self._alike(h), exact)

    def _alike(self, h: Hypothesis) -> dict[str, float]:
        """Return for each effect of a hypothesis its largest similarity to another effect of the hypothesis.

        The similarity of two effects is the squared cosine between the changes of the trials that they
        cause.
        """
        if len(h.names) < 2:
            return {}
        screened = {id(t.effect): t for t in self.screened(self.null).tried}
        mine = [(e.name, screened.get(id(e))) for e in h.fit.effects]
        found = dict.fromkeys(sorted(h.names), 0.0)
        for (one, first), (other, second) in combinations(mine, 2):
            # An effect that changes nothing when it is the only effect has no screening result.
            if first is None or second is None:
                continue
            cosine = self._cosine(first, second)
            found[one], found[other] = (max(found[n], cosine**2) for n in (one, other))
        return found

    def _cosine(self, first: Tried, second: Tried) -> float:
        """Return the cosine between the changes of the trials by two effects.

        The model's parameters are projected out. The result is cached.
        """
        pair = frozenset((id(first), id(second)))
        if pair not in self._cosines:
            fit = self.null.fit
            self._cosines[pair] = candidates.alike(self.context, fit, self.noise_model, first, second)
        return self._cosines[pair]

    def likeliest(self, found: Posterior) -> Hypothesis:
        """Return the hypothesis of the most probable set, or the model without effects."""
        return next((h for h in self.best(len(found.best)) if h.names == found.best), self.null)

    def ranked(self, base: Hypothesis, hypotheses: Sequence[Hypothesis]) -> list[Refitted]:
        """Return the given hypotheses sorted by score, best first, with their gains over ``base``.

        Each hypothesis has one effect more than the hypothesis ``base``.
        """
        found = []
        for h in sorted(hypotheses, key=lambda h: h.score):
            (last,) = [e for e in h.fit.effects if id(e) not in base.key]
            found.append(Refitted(self._tried(base, h, last), h.fit, base.misfits - h.misfits))
        return found

    def _tried(self, base: Hypothesis, h: Hypothesis, effect: Effect) -> Tried:
        """Return the screening result of an effect of hypothesis ``h`` that is added to hypothesis
        ``base``.
        """
        if h.tried is not None and h.tried.effect is effect and base.key not in self.screens:
            return h.tried
        found = next((t for t in self.screened(base).tried if t.effect is effect), None)
        if found is None:
            parameters = effect.parameters(self.context.model, self.context.trials)
            null = np.array([p.start for p in parameters])
            signature = [np.zeros(count) for count in base.fit.problem.counts]
            found = Tried(effect, parameters, null, np.zeros(self.context.folds.count), 1.0, signature)
        return found


def _belongs(label: str, effects: Sequence[Effect]) -> bool:
    """Return whether a parameter belongs to one of the given effects."""
    return label.rpartition("/")[0] in {e.name for e in effects}


def context_of(given: FitContext, effects: Sequence[Effect]) -> tuple[FitContext, NoiseModel, Fit, Dropouts]:
    """Remove failed samples from the trials, estimate the noise, and fit the model without effects.

    Returns
    -------
    tuple of FitContext, NoiseModel, Fit and Dropouts
        The context without the failed samples, the noise model, the fit, and the failed samples.
    """
    fine, trials = given.model, given.trials
    start = [np.array([p.start for p in given.parameters])] * len(trials)
    # The search may take twice the given step if that is accurate enough.
    model = step_of(fine.coarser() or fine, start, trials).model
    context = given.replaced(model, trials)
    noise_model, fit = weigh(context)
    dropouts = look(context.trials, fit.problem.simulations(fit.theta))
    if dropouts.count:
        context = given.replaced(model, dropouts.without(trials))
        noise_model, fit = weigh(context)
    # The step was small enough at the start values of the parameters. It may be too large at the fitted
    # values, or for effects.
    needed = step_of_search(context, fit, effects)
    if needed.halvings:
        context = context.finer(needed.halvings)
        noise_model, fit = weigh(context)
    if context.model is not fine and fine.swimmer is not None:
        # The model with the original step is not simulated any more.
        fine.swimmer.forget(context.trials)
    noise_model, _ = see(context, fit, noise_model, fit.residuals, effects, len(fit.labels))
    return context, noise_model, fit, dropouts


def run(
    given: FitContext,
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
    with threadpool_limits(limits=1, user_api="blas"):
        context, noise_model, fit, dropouts = context_of(given, effects)
        allowed = [e for e in effects if asked is None or e.name in asked]
        with progress("effects", total=2 * len(effects)) as shown:
            search = Search(
                context, noise_model, effects, effects, rng=rng,
                checkpoint=checkpoint or Checkpoint(),
                step=lambda name: show(shown, name),
            )  # fmt: skip
            search.begin(context.start((), noise_model, fit))
            search.beside([search.null])
            found = search.lessened()
            leader = search.likeliest(found)
            search.learn(leader if found.sets.get(found.best, 0.0) > found.none else search.null)
        search.effects = allowed
        state = chosen(search, dropouts, {id(e) for e in allowed}, most, progress)
        if dropouts.count:
            simulated = state.base.problem.simulations(state.base.theta)
            state.dropouts = dropouts.confirmed(look(given.trials, simulated))
        context = state.context
        state.left = remainder.find(context, state.base, state.noise_model, rng=rng)
        columns, _ = random_effect_columns(context, state.base, effects)
        state.nuisance_residuals = nuisance_residuals(state.base, state.base.residuals, columns)
        state.low_frequency = remainder.low_frequency(state.base.problem, state.nuisance_residuals)
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
        # excess of this hypothesis. Add the decrease of the squared residuals that the screening predicts.
        left = found.excess[best.names] + max([0.0, *(t.gain for t in search.screened(best).tried)])
        if posterior.most(left, search.record) < loses:
            break
        with progress(f"sets of {size + 1}", total=SETS) as shown:
            search.step = partial(show, shown)
            parents = search.best(size)[:PARENTS]
            search.beside([*parents, *([best] if best not in parents else [])], SETS)
        larger = search.likeliest(search.lessened())
        if len(larger.names) == size:
            break
        # Estimate the noise again, from the residuals of the larger set of effects.
        keep = {h.key for n in range(1, size + 2) for h in search.best(n)[:PARENTS]}
        keep |= {larger.key - {k} for k in larger.key} | {larger.key, best.key, frozenset()}
        search.pool = {key: h for key, h in search.pool.items() if key in keep}
        search.learn(larger)
        search.finish()
        found = search.lessened()
        best = search.likeliest(found)
        if len(best.names) <= size:
            break  # with the noise model of the larger set, that set is not needed
    while True:
        for effect in best.fit.effects if len(best.names) > 1 else ():
            search.beside([search.without(best, effect)], RIVALS)
        found = search.lessened()
        if search.likeliest(found).names == best.names:
            break
        best = search.likeliest(found)
    if search.refine(best):
        return chosen(search, dropouts, allowed, most, progress)
    return rounds(search, best, found, dropouts)


def rounds(search: Search, best: Hypothesis, found: Posterior, dropouts: Dropouts) -> State:
    """Return the result of the search with one comparison for each cause.

    Each cause is compared with its alternatives while all other causes are in the model.
    """
    best = in_parameters(search, best, found)
    null = search.null
    state = State(
        search.context, search.noise_model, null.fit, best.fit, dropouts,
        search.screened(null), search.ranked(null, search.best(1)), found,
        random_effects=search.random_effects, tried=search.count,
    )  # fmt: skip
    for effect in best.fit.effects:
        base = search.without(best, effect)
        size = len(best.names)
        rivals = [h for h in search.best(size) if base.key < h.key and h.key != best.key]
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
        mine = search._tried(base, best, effect)
        for h in search.best(len(best.names)):
            rest = [e for e in h.fit.effects if id(e) not in base.key]
            if not base.key < h.key or rest[0].adds_to is None:
                continue
            likely = found.known.get(h.names, 0.0) >= UNSURE * found.known.get(best.names, 0.0)
            if likely and _same_change(search, found, base, mine, search._tried(base, h, rest[0])):
                best = h
                break
    return best


def _twins(found: Posterior, *sets: frozenset[str]) -> bool:
    """Return whether two sets of effects leave the same residuals."""
    known = {c.names: c for c in found.candidates}
    return all(names in known for names in sets) and posterior.are_twins(*(known[names] for names in sets))


def _same_change(search: Search, found: Posterior, base: Hypothesis, first: Tried, second: Tried) -> bool:
    """Return whether two effects change the trials in the same way when added to a hypothesis.

    The squared residuals with the two effects must also differ by no more than noise.
    """
    left = [found.excess.get(base.names | {t.effect.name}, np.inf) for t in (first, second)]
    if not abs(left[0] - left[1]) <= found.no_evidence:
        return False
    cosine = candidates.alike(search.context, base.fit, search.noise_model, first, second)
    return abs(cosine) > SAME_COSINE
