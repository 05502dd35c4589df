"""Fitted hypotheses of a diagnosis: the model with sets of effects, and their posterior probabilities.

Each effect is fitted together with the model, from several sizes. A linear screen predicts the benefit of
each effect. It orders the work and excludes no effect. Hypotheses that remain probable after a rough fit are
fitted to their optimum. Sets of effects extend the best smaller sets by the effects with the largest
predicted benefit.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np

from swimid.diagnosis import posterior, screening
from swimid.diagnosis.posterior import Candidate, DataSize, Posterior
from swimid.diagnosis.readings import OtherReading
from swimid.diagnosis.screening import Screening
from swimid.diagnosis.study import FINE, HEAT, MAX_FOLD_ITERATIONS, ROUGH, GapStudy, Hypothesis
from swimid.effects.base import Effect
from swimid.files.atomic import Checkpoint
from swimid.fitting.model import Array
from swimid.fitting.problem import map_in_processes

#: Hypotheses whose rough fit continues after one iteration: number of the best ones (NEAREST), and maximum
#: cost of others, divided by the lowest cost (FAR).
NEAREST, FAR = 12, 4.0
#: Minimum posterior probability, divided by the largest one, with which a hypothesis is fitted to its optimum
#: (PROBABLE), and number of the best hypotheses that are fitted in any case (CONTENDERS).
PROBABLE, CONTENDERS = 1e-4, 6
#: Maximum number of effects in one hypothesis.
MAX_EFFECTS = 3

Key = frozenset[int]


@dataclass(eq=False)
class HypothesisPool:
    """Fitted hypotheses of one study.

    Parameters
    ----------
    effects : sequence of Effect
        Effects in every form.
    step : callable
        Function that is called with the name of each fitted effect.

    Attributes
    ----------
    null : Hypothesis
        The model without effects.
    pool : dict of frozenset of int to Hypothesis
        All hypotheses, by the identities of their effects.
    screens : dict of frozenset of int to list of Screening
        Screening results of the effects that can be added to a hypothesis, largest predicted gain first.
    first_screen : list of Screening
            Screening results of every effect added to the model without effects, with the first noise model.
    left_out : dict of name to reason
        Effects that could not be screened.
    """

    study: GapStudy
    effects: Sequence[Effect]
    step: Callable[[str], None] = field(default=lambda _: None, kw_only=True)
    checkpoint: Checkpoint = field(default_factory=Checkpoint, kw_only=True)
    null: Hypothesis = field(init=False)
    pool: dict[Key, Hypothesis] = field(init=False, default_factory=dict)
    screens: dict[Key, list[Screening]] = field(init=False, default_factory=dict)
    first_screen: list[Screening] = field(init=False, default_factory=list)
    left_out: dict[str, str] = field(init=False, default_factory=dict)
    #: Number of fits of each set of effects so far, by its name in the checkpoint.
    _fits: Counter[str] = field(init=False, default_factory=Counter)
    _cosines: dict[frozenset[int], float] = field(init=False, default_factory=dict)
    #: Pairs of a hypothesis and a smaller one that was already refitted from the optimum of the larger one.
    _returned: set[tuple[Key, Key]] = field(init=False, default_factory=set)

    def prepare(self, acting: Iterable[Sequence[Effect]]) -> None:
        """Compile the models of sets of effects once, so that not every worker process compiles them."""
        for effects in acting:
            self.study.build_model(effects).prepare(effects=True)

    def begin(self, start: Array) -> Hypothesis:
        """Fit the model without effects, from ``start`` and from the prior means (:meth:`GapStudy.begins`).

        With one starting point, an effect could seem to explain the difference between a poor optimum and the
        best.
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
                simulated = screening.simulate_effects(self.study, parent, part)
                more, without = screening.screen_effects(self.study, parent, simulated)
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
        """Fit hypotheses with one more effect roughly, or read the fits of an interrupted run, and add them
        to the pool.

        A fit ends after one iteration if the hypothesis is then far from the best one.
        """
        kept = [self.checkpoint.get(name) for name, _, _ in new]

        def begin(k: int) -> Array:
            known = kept[k]
            return self._pack(self.fit_step(*new[k][1:])) if known is None else known

        def proceed(k: int) -> Array:
            _, parent, tried = new[k]
            effects = (*parent.effects, tried.effect)
            start = [self._unpack(effects, results[k]).theta]
            fit = self.study.fit(effects, start, tolerance=ROUGH, iterations=HEAT, brief=True, hold=parent)
            return self._pack(fit)

        results = list(map_in_processes(begin, range(len(new)), self.study.jobs))
        order = sorted(range(len(new)), key=lambda k: results[k][-1])
        near = [
            *order[:NEAREST],
            *(k for k in order[NEAREST:] if results[k][-1] < FAR * results[order[0]][-1]),
        ]
        near = [k for k in near if kept[k] is None]
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
        """Return the hypothesis whose array :meth:`_pack` returned, as a rough fit."""
        own, log, theta = np.split(values[:-2], np.array([1, 2]) * self.study.folds.count)
        strain, cost = values[-2:].tolist()
        h = self.study.at(effects, theta, cost)
        h.tried, h.rough = tried, True
        vars(h).update(deviance_parts=(own, log, strain))
        return h

    def _name(self, effects: Sequence[Effect]) -> str:
        """Return the name under which the next fit of a set of effects is stored.

        The search is deterministic, so that a resumed search gives each fit the same name.
        """
        model, trials = self.study.model, self.study.trials
        own = ("/".join((e.name, *(p.name for p in e.parameters(model, trials)))) for e in effects)
        name = "+".join([*own, str(len(trials)), str(len(self.study.noise.random_effects))])
        self._fits[name] += 1
        return f"{name}+{self._fits[name]}"

    def fit_step(self, parent: Hypothesis, tried: Screening) -> Hypothesis:
        """Return the first step of a joint fit of the hypothesis ``parent`` and one more effect.

        The starting points are the size that the screen predicts, the size that reduced the residuals most
        without a refit, and the prior means of the coefficients.
        """
        study = self.study
        effects = (*parent.effects, tried.effect)
        names = [f"{tried.effect.name}/{p.name}" for p in tried.parameters]
        points = [tried.point]
        # The trials are nearly linear in a changed parameter, so that its predicted optimum is a sufficient
        # start.
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

        The starting points are the optima of the hypothesis and of the smaller one. With one of them alone,
        further effects could seem to explain the difference between a poor optimum and the best one.
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

    def _put(self, h: Hypothesis) -> None:
        """Add a hypothesis to the pool, or replace it by the same hypothesis at another optimum."""
        self.pool[h.key] = h
        self.screens.pop(h.key, None)
        self.null = self.pool[frozenset()]

    def best(self, size: int) -> list[Hypothesis]:
        """Return hypotheses with ``size`` effects, best first; only the best form of each set of effects."""
        found = [h for h in self.pool.values() if len(h.effects) == size and not h.is_imitating]
        first: dict[frozenset[str], Hypothesis] = {}
        for h in sorted(found, key=lambda h: h.deviance):
            first.setdefault(h.names, h)
        return list(first.values())

    def contenders(self) -> list[Hypothesis]:
        """Return hypotheses that are not improbable, and the best hypotheses of each size."""
        sets = self.compute_posterior().sets
        least = PROBABLE * max(sets.values(), default=0.0)
        ranked = [pair for size in range(1, MAX_EFFECTS + 1) for pair in enumerate(self.best(size))]
        return [h for rank, h in ranked if rank < CONTENDERS or sets.get(h.names, 0.0) > least]

    def finish(self) -> None:
        """Fit the hypotheses that are not improbable to their optimum."""
        while wanted := [h for h in self.contenders() if h.rough]:
            for h in self._refit_all(self.study, wanted):
                self._put(h)

    def _refit_all(self, study: GapStudy, wanted: Sequence[Hypothesis]) -> Iterator[Hypothesis]:
        """Continue the fits of hypotheses in a study to their optimum, and yield the hypotheses."""

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

    def compute_posterior(self) -> Posterior:
        """Return the posterior probability of each set of effects fitted so far."""
        found = [self._candidate(h) for size in range(1, MAX_EFFECTS + 1) for h in self.best(size)]
        null = self._candidate(self.null)
        return posterior.compute_posterior_probabilities(null, found, record=self.record)

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
                self._cosines[pair] = screening.compute_cosine(self.study, self.null, first, second)
            found[one], found[other] = (max(found[n], self._cosines[pair] ** 2) for n in (one, other))
        return found
