"""The hypotheses of a diagnosis: every effect, and sets of them, each fitted to its optimum.

Every effect is fitted together with the model from all the sizes it is tried at; a screen orders and
predicts, and dismisses none. Sets are fitted jointly, from what each further effect promises beside the best
smaller ones. The noise they are judged by comes from the whole catalogue, whatever effects are asked for: a
fit is the same alone and among others.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from threadpoolctl import threadpool_limits

from swimid.diagnosis import candidates, gram, posterior, remainder
from swimid.diagnosis.bench import FINE, STEPS, Bench, Fit
from swimid.diagnosis.candidates import Refitted, Screen, Tried
from swimid.diagnosis.chance import Kind
from swimid.diagnosis.dropouts import Dropouts, look
from swimid.diagnosis.floor import quiet
from swimid.diagnosis.lens import Lens
from swimid.diagnosis.posterior import Candidate, Posterior, Record
from swimid.diagnosis.remainder import Left, Slow
from swimid.diagnosis.weighting import chance_columns, see, settled, tells_noise, weigh
from swimid.effects.base import Effect
from swimid.files.checkpoint import Checkpoint
from swimid.fitting.model import Array, Model, Parameter, Trial
from swimid.progress import Progress, show, silent

#: A longer step of integration may change a sample by this share of the range: far below any noise.
SMALL_CHANGE = 1e-4
#: Hypotheses beside which further effects are tried, and how many of the sets that promise most are fitted.
PARENTS, SETS = 4, 10
#: Beside each of the others of a set, so many rivals of an effect are fitted.
RIVALS = 4
#: A set this unlikely against the likeliest is fitted on in so many steps only, once the noise is known.
HOPELESS, FEW = 1e-4, 2
#: The noise is learnt in so many turns at most, fewer where no spread between trials, in typical sizes,
#: changes by more than this.
TURNS, STAYS = 6, 0.02
#: Effects in a combination at most.
COMBINED = 3

Key = frozenset[int]


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """The model with a set of effects, fitted to its optimum.

    Attributes
    ----------
    fit : Fit
    misfits : ndarray, shape (folds,)
        Squared residuals of each fold, held out by one Gauss-Newton step from the fit to all.
    tried : Tried or None
        The effect fitted last, as the screen saw it beside the others; None of the model itself.
    inside : ndarray, shape (folds,)
        The same of the fit to all.
    score : float
        Cost of the optimum, and what a number of the effects must lower it by to mean anything.
    """

    fit: Fit
    misfits: Array
    inside: Array
    score: float
    tried: Tried | None = None

    @property
    def key(self) -> Key:
        """Which effects it has."""
        return frozenset(id(e) for e in self.fit.effects)

    @property
    def names(self) -> frozenset[str]:
        """Of its effects."""
        return frozenset(e.name for e in self.fit.effects)

    @property
    def misfit(self) -> float:
        """Over all folds."""
        return float(self.misfits.sum())


@dataclass
class Round:
    """One cause and its rivals, beside all other causes.

    Attributes
    ----------
    base : Fit
        The model with the other causes.
    screen : Screen
    ranked : list of Refitted
        Best first; the cause itself at the head.
    lens : Lens
    """

    base: Fit
    screen: Screen
    ranked: list[Refitted]
    lens: Lens


@dataclass
class State:
    """Everything a diagnosis has found so far.

    Attributes
    ----------
    nominal : Fit
        The model without any effect.
    base : Fit
        With the causes.
    singles : Round
        Every effect alone.
    rounds : list of Round
        One for each cause, that with the largest share first.
    """

    bench: Bench
    lens: Lens
    nominal: Fit
    base: Fit
    dropouts: Dropouts
    singles: Round
    posterior: Posterior
    rounds: list[Round] = field(default_factory=list)
    left: Left | None = None
    chance: list[Kind] = field(default_factory=list)
    out_of_time: bool = False
    slow: dict[str, Slow] = field(default_factory=dict)
    quiet: list[Array] = field(default_factory=list)
    #: Effects that apply, and are asked for.
    tried: int = 0
    #: Why a larger set was or was not taken.
    told: list[str] = field(default_factory=list)


def coarser(model: Model, vectors: Sequence[Array], trials: Sequence[Trial]) -> Model | None:
    """The model with twice the integration step, where that changes samples little.

    Parameters
    ----------
    vectors : sequence of ndarray
        Parameters of each trial.
    """
    quick = model.coarser()
    if quick is None:
        return None
    for values, trial in zip(vectors, trials, strict=True):
        fine, rough = model.simulate(values, trial), quick.simulate(values, trial)
        for channel in trial.measured:
            span = float(np.ptp(fine[channel]))
            if not np.max(np.abs(fine[channel] - rough[channel]), initial=0.0) <= SMALL_CHANGE * span:
                return None
    return quick


class Search:
    """All hypotheses on one bench, through one lens.

    Parameters
    ----------
    bench : Bench
    lens : Lens
    effects : sequence of Effect
        In every form.
    scattering : sequence of Effect
        Of which those that scatter may differ between trials.
    step : callable
        Called with the name of each effect fitted.
    late : callable
        Whether the time is up.
    """

    def __init__(
        self,
        bench: Bench,
        lens: Lens,
        effects: Sequence[Effect],
        scattering: Sequence[Effect],
        *,
        rng: np.random.Generator,
        jobs: int,
        step: Callable[[str], None] = lambda _: None,
        late: Callable[[], bool] = lambda: False,
        checkpoint: Checkpoint | None = None,
    ) -> None:
        self.bench, self.lens, self.effects, self.scattering = bench, lens, effects, scattering
        self.rng, self.jobs, self.step, self.late = rng, max(jobs, 1), step, late
        self.checkpoint = checkpoint or Checkpoint()
        self.chance: list[Kind] = []
        self.pool: dict[Key, Hypothesis] = {}
        self.screens: dict[Key, Screen] = {}
        self.out_of_time = False

    # ------------------------------------------------------------ fits

    def judged(self, fit: Fit, tried: Tried | None = None, parent: Hypothesis | None = None) -> Hypothesis:
        """A hypothesis from its optimum."""
        inner = gram.folded(self.bench, fit, self.lens)
        inside = inner.products[:, -1, -1]
        score = fit.cost + self.penalty(fit)
        single = [p for p in tried.parameters if p.per_trial] if tried is not None else []
        if not single or parent is None or tried is None:
            return Hypothesis(fit, gram.held_out(inner), inside, score, tried)
        own = [candidates.own(fit, f"{tried.effect.name}/{p.name}", p.scale) for p in single]
        gains = candidates.own_gains(self.bench, parent.fit, self.lens, own)
        return Hypothesis(fit, parent.misfits - gains, inside, score, tried)

    def penalty(self, fit: Fit) -> float:
        """What the numbers of its effects must lower the cost by."""
        samples = float(sum(len(r) for r in fit.residuals))
        mine = [label for label in fit.labels if _belongs(label, fit.effects)]
        each = sum("[" in label for label in mine)
        return posterior.penalty(len(mine) - each, each, samples, len(fit.residuals))

    def begin(self, start: Array) -> Hypothesis:
        """The model itself, from known coefficients too where it has left them far behind: what a poor
        optimum misses, some effect would seem to explain.
        """
        fit = based(self.bench, self.lens, start)
        self.null = self.judged(fit)
        self.pool[self.null.key] = self.null
        return self.null

    def screened(self, parent: Hypothesis) -> Screen:
        """Every further effect beside a hypothesis, to first order at each of its sizes."""
        if parent.key not in self.screens:
            rest = [e for e in self.effects if e.name not in {p.name for p in parent.fit.effects}]
            simulated = candidates.simulate(self.bench, parent.fit, rest, jobs=self.jobs)
            found = candidates.screen(self.bench, parent.fit, self.lens, simulated)
            self.screens[parent.key] = found
        return self.screens[parent.key]

    def beside(self, parents: Iterable[Hypothesis], most: int | None = None) -> list[Hypothesis]:
        """Each parent with one more effect, fitted jointly: all, or those that promise most."""
        promised: dict[Key, tuple[float, Hypothesis, Tried]] = {}
        for parent in parents:
            for t in self.screened(parent).tried:
                key = parent.key | {id(t.effect)}
                expected = parent.misfit - t.gain
                if key not in promised or expected < promised[key][0]:
                    promised[key] = expected, parent, t
        order = sorted(promised.values(), key=lambda p: p[0])
        work = [(parent, t) for _, parent, t in order[:most]]

        def one(item: tuple[Hypothesis, Tried]) -> Hypothesis | None:
            parent, tried = item
            known = self.pool.get(parent.key | {id(tried.effect)})
            if known is not None:
                return known
            if self.late() and item is not work[0]:
                self.out_of_time = True
                return None
            found = self.fitted(parent, tried)
            self.step(tried.effect.name)
            return found

        with ThreadPoolExecutor(self.jobs) as threads:
            found = [h for h in threads.map(one, work) if h is not None]
        for h in found:
            self.pool[h.key] = h
        return found

    def fitted(self, parent: Hypothesis, tried: Tried) -> Hypothesis:
        """A parent with one more effect at their joint optimum: from the size the screen predicts, from the
        sizes that helped as they were, and from where coefficients are known, too.
        """
        bench, lens = self.bench, self.lens
        effects = (*parent.fit.effects, tried.effect)
        names = [f"{tried.effect.name}/{p.name}" for p in tried.parameters]
        problem = bench.problem(effects, lens.chance)
        starts = []
        for point in (tried.point, *tried.starts):
            own = dict(zip(names, point, strict=True))
            starts += bench.begins(problem, bench.start(effects, lens, parent.fit, own))
        name = "+".join([*(e.name for e in effects), *names, str(len(lens.chance))])
        kept = self.checkpoint.get(name)
        if kept is not None and len(kept) == len(starts[0]):
            starts = [kept]
        fit = bench.raced(effects, lens, starts, chord=parent.fit)
        if not fit.cost <= parent.fit.cost:
            # a model without the effect is the model with it at nought
            fit = bench.raced(effects, lens, [bench.start(effects, lens, parent.fit)], chord=parent.fit)
        self.checkpoint.put(name, fit.theta)
        return self.judged(fit, tried, parent)

    def without(self, h: Hypothesis, effect: Effect) -> Hypothesis:
        """A hypothesis less one of its effects."""
        rest = tuple(e for e in h.fit.effects if e is not effect)
        key = h.key - {id(effect)}
        if key not in self.pool:
            starts = [self.bench.start(rest, self.lens, fit) for fit in (h.fit, self.null.fit)]
            self.pool[key] = self.judged(self.bench.raced(rest, self.lens, starts, chord=h.fit))
        return self.pool[key]

    def best(self, size: int) -> list[Hypothesis]:
        """Hypotheses of so many effects, best first, the best form of each set."""
        found = [h for h in self.pool.values() if len(h.fit.effects) == size]
        first: dict[frozenset[str], Hypothesis] = {}
        for h in sorted(found, key=lambda h: h.score):
            first.setdefault(frozenset(e.name for e in h.fit.effects), h)
        return list(first.values())

    # ------------------------------------------------------------ noise

    def learn(self, leading: Hypothesis) -> None:
        """The noise as the leading hypothesis and a generic description together leave it; all that was
        fitted is fitted on through it.
        """
        bench, lens, fit = self.bench, self.lens, leading.fit
        whole = tells_noise(bench)
        # what differs between trials first, spreads and optimum in turn until they stay, in all that the
        # hypothesis leaves: a generic description has it, too, and comes last
        stays = False
        for turn in range(TURNS if whole else 2):
            generic = remainder.simulate(bench, fit, jobs=self.jobs)
            left = remainder.find(bench, fit, lens, generic, rng=self.rng)
            last = stays or turn == TURNS - 1
            columns: list[list[Array]] = []
            prior: list[float] = []
            if not whole or (last and left.found):
                columns, prior = left.columns, left.prior
            before = {kind.label: kind.sd for kind in lens.chance}
            lens, self.chance = see(
                bench,
                fit,
                lens,
                remainder.saturated(bench, fit, lens, columns, prior),
                self.scattering,
                len(columns) + len(fit.labels),
                common=len(fit.effects),
                cautious=left.found,
            )
            lens = settled(bench, fit, lens)
            fit = bench.fit(fit.effects, lens, [bench.start(fit.effects, lens, fit)], tolerance=FINE)
            now = {kind.label: kind.sd for kind in lens.chance}
            if last:
                break
            stays = all(abs(now.get(n, 0.0) - before.get(n, 0.0)) < STAYS for n in {*now, *before})
        found = self.weighed()
        far = {names for names, p in found.sets.items() if p < HOPELESS * max(found.sets.values())}
        held = {kind.label: kind.sd for kind in lens.chance}
        self.chance = [replace(k, sd=max(k.sd, held.get(k.label, 0.0))) for k in self.chance]
        self.lens = lens
        self.screens.clear()
        kept, null = list(self.pool.values()), self.null
        self.pool.clear()
        self.begin(bench.start((), lens, null.fit))

        def one(h: Hypothesis) -> Hypothesis:
            effects, problem = h.fit.effects, bench.problem(h.fit.effects, lens.chance)
            starts = bench.begins(problem, bench.start(effects, lens, h.fit))
            steps = FEW if h.names in far else STEPS
            fit = bench.fit(effects, lens, starts, tolerance=FINE, iterations=steps)
            if not fit.cost <= self.null.fit.cost and h.names not in far:
                # its coefficients were those of a poor optimum: from the model's own, and its own sizes
                sizes = {n: v for n, v in zip(h.fit.labels, h.fit.theta, strict=True) if _belongs(n, effects)}
                starts = [bench.start(effects, lens, self.null.fit, own) for own in (sizes, {})]
                fit = bench.raced(effects, lens, starts, chord=fit)
            if h.tried is not None:
                self.step(h.tried.effect.name)
            return replace(h, fit=fit)

        with ThreadPoolExecutor(self.jobs) as threads:
            renewed = list(threads.map(one, (h for h in kept if h.fit.effects)))
        for h in sorted(renewed, key=lambda h: len(h.fit.effects)):
            parent = None if h.tried is None else self.pool.get(h.key - {id(h.tried.effect)})
            self.pool[h.key] = self.judged(h.fit, h.tried, parent)

    def weighed(self) -> Posterior:
        """How likely each set of effects fitted so far is."""
        found = [h for size in range(1, COMBINED + 1) for h in self.best(size)]
        return posterior.posterior(
            self._candidate(self.null),
            [self._candidate(h) for h in found],
            record=self.record,
        )

    @property
    def count(self) -> int:
        """How many effects there are, at least one."""
        return max(len({e.name for e in self.effects}), 1)

    @property
    def record(self) -> Record:
        """How much there is to judge by."""
        residuals = self.null.fit.residuals
        return Record(float(sum(len(r) for r in residuals)), self.bench.folds.count, self.count)

    def _candidate(self, h: Hypothesis) -> Candidate:
        kinds = {n.split("[")[0] for n in h.fit.labels if _belongs(n, h.fit.effects)}
        slow = None
        if self.lens.slow is not None:
            inner = gram.folded(self.bench, h.fit, self.lens.slow)
            slow = float(gram.projected(inner)[-1, -1]) + self.penalty(h.fit)
        return Candidate(h.names, h.score, h.inside, len(kinds), slow)

    def likeliest(self, found: Posterior) -> Hypothesis:
        """The hypothesis of the likeliest set, the model itself where there is none."""
        return next((h for h in self.best(len(found.best)) if h.names == found.best), self.null)

    def ranked(self, base: Hypothesis, hypotheses: Sequence[Hypothesis]) -> list[Refitted]:
        """Hypotheses of one more effect than the base, best first."""
        found = []
        for h in sorted(hypotheses, key=lambda h: h.score):
            (last,) = [e for e in h.fit.effects if id(e) not in base.key]
            found.append(
                Refitted(self._tried(base, h, last), h.fit, base.misfits - h.misfits, base.inside - h.inside)
            )
        return found

    def _tried(self, base: Hypothesis, h: Hypothesis, effect: Effect) -> Tried:
        """An effect of a hypothesis as the screen sees it beside the others."""
        if h.tried is not None and h.tried.effect is effect and base.key not in self.screens:
            return h.tried
        found = next((t for t in self.screened(base).tried if t.effect is effect), None)
        if found is None:
            parameters = effect.parameters(self.bench.model, self.bench.trials)
            null = np.array([p.start for p in parameters])
            signature = [np.zeros(len(r)) for r in base.fit.residuals]
            found = Tried(effect, parameters, null, np.zeros(self.bench.folds.count), 1.0, signature)
        return found


def _belongs(label: str, effects: Sequence[Effect]) -> bool:
    """Whether a number is one of some effects'."""
    return label.split("/")[0] in {e.name for e in effects}


def based(bench: Bench, lens: Lens, begin: Array) -> Fit:
    """The model itself, from known coefficients too where the start has left them far behind."""
    return bench.fit((), lens, bench.begins(bench.problem((), lens.chance), begin), tolerance=FINE)


def bench_of(
    model: Model,
    parameters: Sequence[Parameter],
    trials: Sequence[Trial],
    prior: Mapping[str, tuple[float, float]],
    effects: Sequence[Effect],
    *,
    jobs: int = 1,
) -> tuple[Bench, Lens, Fit, Dropouts]:
    """The trials without failed samples, the noise as the model alone leaves it, and its fit."""
    start = [np.array([p.start for p in parameters])] * len(trials)
    fine, model = model, coarser(model, start, trials) or model

    def weighed(sound: Sequence[Trial]) -> tuple[Bench, Lens, Fit]:
        found = Bench(model, parameters, sound, prior, jobs=jobs)
        return (found, *weigh(found))

    bench, lens, fit = weighed(trials)
    dropouts = look(bench.trials, fit.problem.simulations(fit.theta))
    if dropouts.count:
        bench, lens, fit = weighed(dropouts.without(trials))
    # a coarse step may do at the start values, and not from where trials were found to begin
    own = [fit.problem.vector(fit.theta, k) for k in range(len(bench.trials))]
    if model is not fine and coarser(fine, own, bench.trials) is None:
        model = fine
        bench, lens, fit = weighed(bench.trials)
    lens, _ = see(bench, fit, lens, fit.residuals, effects, len(fit.labels))
    return bench, lens, fit, dropouts


def run(
    model: Model,
    parameters: Sequence[Parameter],
    trials: Sequence[Trial],
    prior: Mapping[str, tuple[float, float]],
    effects: Sequence[Effect],
    *,
    asked: Collection[str] | None = None,
    seed: int = 0,
    jobs: int = 1,
    most: int = COMBINED,
    budget_s: float | None = None,
    checkpoint: Checkpoint | None = None,
    progress: Progress = silent,
) -> State:
    """Everything up to the choice of causes, on the trials that take part in fits.

    Parameters
    ----------
    effects : sequence of Effect
        All that apply, in every form: the noise is what the best of them leaves.
    asked : collection of str, optional
        Names of those that may be causes; default all.
    """
    begun = time.monotonic()
    rng = np.random.default_rng(seed)

    def late() -> bool:
        return budget_s is not None and time.monotonic() - begun > budget_s

    with threadpool_limits(limits=1, user_api="blas"):
        bench, lens, fit, dropouts = bench_of(model, parameters, trials, prior, effects, jobs=jobs)
        allowed = [e for e in effects if asked is None or e.name in asked]
        with progress("effects", total=2 * len(effects)) as shown:
            search = Search(
                bench, lens, effects, effects, rng=rng, jobs=jobs, late=late, checkpoint=checkpoint,
                step=lambda name: show(shown, name),
            )  # fmt: skip
            search.begin(bench.start((), lens, fit))
            search.beside([search.null])
            found = search.weighed()
            leader = search.likeliest(found)
            search.learn(leader if found.sets.get(found.best, 0.0) > found.none else search.null)
        search.effects = allowed
        state = chosen(search, dropouts, {id(e) for e in allowed}, most, progress)
        if dropouts.count:
            simulated = state.base.problem.simulations(state.base.theta)
            state.dropouts = dropouts.confirmed(look(trials, simulated))
        generic = remainder.simulate(bench, state.base, jobs=jobs)
        state.left = remainder.find(bench, state.base, state.lens, generic, rng=rng)
        columns, _ = chance_columns(bench, state.base, effects)
        state.quiet = quiet(state.base, state.base.residuals, columns)
        state.slow = remainder.slow(state.base, state.quiet)
    return state


def chosen(
    search: Search, dropouts: Dropouts, allowed: Collection[int], most: int, progress: Progress = silent
) -> State:
    """The likeliest set of causes: larger ones are tried as long as what is left could make one likelier."""
    search.pool = {key: h for key, h in search.pool.items() if key <= set(allowed)}
    told: list[str] = []
    found = search.weighed()
    best = search.likeliest(found)
    count = search.count
    while 0 < len(best.names) < min(most, count) and not search.out_of_time:
        size = len(best.names)
        loses = posterior.prior(size, count) - posterior.prior(size + 1, count)
        # noise read off the best of all has what it leaves in it: so much as the screen promises may be left
        left = found.excess[best.names] + max(0.0, *(t.gain for t in search.screened(best).tried))
        if posterior.most(left, found.excess[frozenset()], search.record) < loses:
            break
        with progress(f"sets of {size + 1}", total=SETS) as shown:
            search.step = partial(show, shown)
            parents = search.best(size)[:PARENTS]
            search.beside([*parents, *([best] if best not in parents else [])], SETS)
        larger = search.likeliest(search.weighed())
        if len(larger.names) == size:
            break
        # the noise is what the larger set leaves
        keep = {h.key for n in range(1, size + 2) for h in search.best(n)[:PARENTS]}
        keep |= {larger.key - {k} for k in larger.key} | {larger.key, best.key, frozenset()}
        search.pool = {key: h for key, h in search.pool.items() if key in keep}
        search.learn(larger)
        found = search.weighed()
        told.append(_told(best.names, larger.names, found))
        best = search.likeliest(found)
    while not search.out_of_time:
        for effect in best.fit.effects if len(best.names) > 1 else ():
            search.beside([search.without(best, effect)], RIVALS)
        found = search.weighed()
        if search.likeliest(found).names == best.names:
            break
        best = search.likeliest(found)
    return rounds(search, best, found, dropouts, told)


def _told(smaller: frozenset[str], larger: frozenset[str], found: Posterior) -> str:
    """What a larger set was worth."""
    first, second = (
        f"{' with '.join(sorted(n))} ({found.sets.get(n, 0.0):.2g}, leaving {found.excess.get(n, 0.0):.3g})"
        for n in (smaller, larger)
    )
    return f"probability, and squared residuals beyond the noise: {first}; {second}"


def rounds(search: Search, best: Hypothesis, found: Posterior, dropouts: Dropouts, told: list[str]) -> State:
    """What was found, cause by cause: each beside the others, with its rivals there."""
    null = search.null
    ones = search.best(1)
    singles = Round(
        search.null.fit,
        search.screened(search.null),
        search.ranked(null, ones),
        search.lens,
    )
    state = State(
        search.bench, search.lens, search.null.fit, best.fit, dropouts, singles, found, chance=search.chance,
        out_of_time=search.out_of_time, tried=search.count, told=told,
    )  # fmt: skip
    for effect in best.fit.effects:
        base = search.without(best, effect)
        size = len(best.names)
        rivals = [h for h in search.best(size) if base.key < h.key and h.key != best.key]
        ranked = [*search.ranked(base, [best]), *search.ranked(base, rivals)]
        state.rounds.append(Round(base.fit, search.screened(base), ranked, search.lens))
    state.rounds.sort(key=lambda r: -r.ranked[0].gain)
    return state
