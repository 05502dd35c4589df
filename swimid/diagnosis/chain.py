"""The steps of a diagnosis, strung together.

Is there a gap, where, by which effect, how far does it shrink, what is left, what next.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

import numpy as np
from threadpoolctl import threadpool_limits

from swimid.diagnosis import candidates, gram, remainder
from swimid.diagnosis.bench import Bench, Fit
from swimid.diagnosis.candidates import Refitted, Screen, Tried
from swimid.diagnosis.dropouts import Dropouts, look
from swimid.diagnosis.floor import quiet, scatter
from swimid.diagnosis.lens import CHANCE, FEWEST, Lens, brief, coloured, spread
from swimid.diagnosis.remainder import Generic, Left, Slow
from swimid.effects.base import Effect
from swimid.estimators import noise as noise_model
from swimid.formats.checkpoint import Checkpoint
from swimid.models.base import Array, Model, Parameter, Trial
from swimid.progress import Progress, show, silent

#: Rounds of weighting by the residuals before anything is tried.
WEIGHTINGS = 2
#: Relative tolerance of the cost meanwhile.
COARSE = 1e-3
#: For differences, in which its error cancels, a longer step may change a sample by this share of the range.
COARSE_CHANGE = 2e-3
#: Effects refitted in a round: those whose screened gain is at least this share of the best, so many at
#: most and at least.
SHARE, MOST, LEAST = 0.15, 9, 4
#: Of one effect, so many forms.
FORMS = 2
#: Of those, so many are refitted to the end.
FINISHED = 3
#: Of those again, only what comes this close to the best.
CLOSE = 0.6
#: What an effect loses in some folds may be this share of what it gains in the others.
LOST = 0.25
#: Of the folds, this share may be worse with it, by more misfit than chance makes of nothing.
LOSING, WORSE = 0.3, 2.0
#: So many effects take part before chance differences between trials are looked for.
LIKELIEST = 2
#: Trials shorter than so many samples do not tell how noise is coloured.
SHORT = 20
#: An effect this small, in typical sizes, is none.
NONE = 1e-3
#: Numbers of single trials that a model knows and holds: they, too, may differ by chance. Typically by
#: their scale, or by a share of a common number.
OWN: dict[str, tuple[str, float] | None] = {
    "friction_deviation": ("pulley_friction", 0.1),
    "start_offset": None,
    "initial_speed": None,
}
#: A further effect must gain this share of what the first one did.
FURTHER = 0.03
#: One chosen earlier must still gain this share of what the one chosen last does, or it stood in for it.
BESIDE = 0.1
#: Effects in a combination at most.
COMBINED = 3
#: Misfit by which two effects of unlike form may differ though they are one, as a share of the gain.
FORM = 0.08


@dataclass
class Round:
    """One step of forward selection.

    Attributes
    ----------
    base : Fit
        The model with the effects chosen before.
    screen : Screen
    ranked : list of Refitted
        Best first.
    lens : Lens
    threshold : float
    """

    base: Fit
    screen: Screen
    ranked: list[Refitted]
    lens: Lens
    threshold: float


@dataclass
class State:
    """Everything a diagnosis has found so far."""

    bench: Bench
    lens: Lens
    base: Fit
    dropouts: Dropouts
    rounds: list[Round] = field(default_factory=list)
    left: Left | None = None
    chance: list[str] = field(default_factory=list)
    chance_sd: Array = field(default_factory=lambda: np.empty(0))
    out_of_time: bool = False
    slow: dict[str, Slow] = field(default_factory=dict)
    generic: Generic | None = None
    #: Effects chosen first and found needless beside another, by name.
    taken_back: dict[str, str] = field(default_factory=dict)
    quiet: list[Array] = field(default_factory=list)
    scatter: dict[str, float] = field(default_factory=dict)


def weigh(bench: Bench) -> tuple[Lens, Fit]:
    """The nominal model refitted with weights from its own residuals."""
    problem = bench.problem(())
    noise_model.weigh_first(problem, False)
    lens = Lens([list(sds) for sds in problem.sd])
    start = np.clip(problem.start, problem.lower, problem.upper)
    previous: dict[str, tuple[float, float]] = {}
    fit = bench.fit((), lens, bench.begins(problem, start), tolerance=COARSE)
    for _ in range(WEIGHTINGS):
        previous = noise_model.estimate(problem, fit.theta, previous)
        lens = Lens([list(sds) for sds in problem.sd])
        fit = bench.fit((), lens, [fit.theta], tolerance=COARSE, chord=fit)
    return lens, fit


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
            if not np.max(np.abs(fine[channel] - rough[channel]), initial=0.0) <= COARSE_CHANGE * span:
                return None
    return quick


def chance_columns(bench: Bench, fit: Fit, effects: Sequence[Effect]) -> tuple[list[Array], list[str]]:
    """Changes of each trial by what may differ from trial to trial by chance, shape (n_k, q)."""
    columns: list[list[Array]] = []
    names: list[str] = []
    value = {p.name: p.start for p in bench.parameters} | dict(zip(fit.labels, fit.theta, strict=True))

    def keep(name: str, half: list[Array]) -> None:
        if all(np.isfinite(c).all() for c in half) and sum(float(c @ c) for c in half) > 0:
            columns.append([2.0 * c for c in half])
            names.append(name)

    for effect in effects:
        if not effect.scatters:
            continue
        parameters = effect.parameters(bench.model, bench.trials)
        for j, p in enumerate(parameters):
            if p.per_trial:
                continue
            point = np.array([q.start for q in parameters])
            sign = 1.0 if p.start + 0.5 * p.scale <= p.upper else -1.0
            point[j] = p.start + sign * 0.5 * p.scale
            keep(effect.name, bench.change(fit, effect, point))
    for index, p in enumerate(bench.parameters):
        if p.per_trial and not p.free and p.name in OWN:
            share = OWN[p.name]
            size = share[1] * abs(float(value.get(share[0], 0.0))) if share else 0.0
            keep(p.name, bench.moved(fit, index, 0.5 * (size or p.scale)))
    stacked = [
        np.column_stack([c[k] for c in columns]) if columns else np.empty((len(fit.residuals[k]), 0))
        for k in range(len(bench.trials))
    ]
    return stacked, names


def see(
    bench: Bench,
    fit: Fit,
    lens: Lens,
    residuals: Sequence[Array],
    effects: Sequence[Effect],
    unknowns: int,
    *,
    common: int | None = None,
) -> tuple[Lens, Array, list[str]]:
    """The lens as some residuals show the noise: colour first, then chance differences between trials.

    Parameters
    ----------
    residuals : sequence of ndarray, shape (n_k,)
        Weighted.
    unknowns : int
        Numbers fitted to them.
    common : int, optional
        Of these, effects that all trials share; without it chance differences are left out, as they would
        hide what no effect has yet been tried on.
    """
    apart = _apart(bench)
    chance, names = chance_columns(bench, fit, effects) if apart else ([], [])
    # the colour is that of what no trim, gain or clock of a single trial explains: those come after it
    still = quiet(fit, residuals, chance) if apart else residuals
    unknowns += len(names) * len(residuals) if apart else 0
    lens = coloured(fit.problem, still, Lens(lens.sd), unknowns=unknowns)
    if apart:
        lens = brief(lens, fit.problem, still, remainder.moves(remainder.slow(fit, still)))
    if common is None or not apart:
        return lens, np.empty(0), []
    own = [fit.own(k) for k in range(len(bench.trials))]
    lens, sd = spread(lens, fit.problem, residuals, own, chance, used=common)
    return lens, sd, names


def _apart(bench: Bench) -> bool:
    """Whether there are trials enough to tell what differs between them by chance."""
    short = all(sum(int(m.sum()) for m in masks) < SHORT for masks in bench.shape.masks)
    return bench.folds.whole and len(bench.trials) >= FEWEST and not short


def rank(
    state: State,
    effects: Sequence[Effect],
    scattering: Sequence[Effect],
    *,
    rng: np.random.Generator,
    jobs: int,
    step: Callable[[str], None],
    late: Callable[[], bool],
    checkpoint: Checkpoint,
) -> Round:
    """One round: screen, learn the noise from a saturated fit, screen again, refit the best."""
    bench = state.bench
    base, lens = state.base, state.lens
    simulated = candidates.simulate(bench, base, effects, jobs=jobs, step=step)
    generic = state.generic = remainder.simulate(bench, base, jobs=jobs)
    apart = _apart(bench)
    # the likeliest effects first, chance differences only in what they leave; then everything together
    for first in (True, False):
        screened = candidates.screen(bench, base, lens, simulated, rng=rng)
        if base.effects and not _hopeful(bench, base, lens, screened, generic, rng):
            return Round(base, screened, [], lens, candidates.LEAST_GAIN)
        if not apart:
            likely = [t for t in screened.tried if t.gain > 0][:MOST]
        else:
            likely = _likeliest(screened) if first else _certain(screened)
        columns, prior = [t.signature for t in likely], [1.0] * len(likely)
        if not (first and apart):
            left = remainder.find(bench, base, lens, generic, rng=rng)
            if left.found or not apart:
                columns, prior = columns + left.columns, prior + left.prior
        bare = remainder.saturated(bench, base, lens, columns, prior)
        unknowns, common = len(columns) + len(base.labels), min(len(likely), LIKELIEST)
        lens, sd, names = see(bench, base, lens, bare, scattering, unknowns, common=common)
        state.chance_sd, state.chance = sd, names
        base = bench.fit(base.effects, lens, [base.theta], chord=base)
    screened = candidates.screen(bench, base, lens, simulated, rng=rng)
    state.base, state.lens = base, lens
    plain = gram.folded(bench, base, lens)
    best = screened.tried[0].gain if screened.tried else 0.0
    each: list[Tried] = []
    for t in screened.tried:
        if sum(other.effect.name == t.effect.name for other in each) < FORMS:
            each.append(t)
    # beside what was found already, an effect is worth a refit where the screen sees something of it
    least = 0.5 * candidates.LEAST_GAIN if base.effects else 0.0
    promising = [
        t
        for i, t in enumerate(each)
        if t.gain > least and (i < LEAST or (i < MOST and t.gain > SHARE * best))
    ]

    def one(tried: Tried) -> Refitted | None:
        if late() and tried is not promising[0]:
            state.out_of_time = True
            return None
        found = candidates.refit(bench, base, plain, lens, tried, checkpoint=checkpoint)
        step(tried.effect.name)
        return found

    def again(first: Refitted) -> Refitted:
        return candidates.refit(bench, base, plain, lens, first.tried, begin=first.fit, checkpoint=checkpoint)

    with ThreadPoolExecutor(max(jobs, 1)) as pool:
        ranked = [r for r in pool.map(one, promising) if r is not None]
        ranked.sort(key=lambda r: -r.merit)
        best = max((r.merit for r in ranked), default=0.0)
        near = [r for r in ranked[:FINISHED] if r is ranked[0] or r.merit > CLOSE * best]
        ranked[: len(near)] = pool.map(again, near)
    ranked.sort(key=lambda r: -r.merit)
    samples = float(sum(len(r) for r in base.residuals))
    threshold = max(screened.threshold, candidates.PER_SAMPLE * samples, candidates.LEAST_GAIN)
    return Round(base, screened, ranked, lens, threshold)


def _likeliest(screened: Screen) -> list[Tried]:
    """The best effects that all trials share: what each trial has for itself may be chance."""
    found: dict[str, Tried] = {}
    for t in screened.tried:
        if t.gain > 0 and not any(p.per_trial for p in t.parameters):
            found.setdefault(t.effect.name, t)
    return list(found.values())[:LIKELIEST]


def _certain(screened: Screen) -> list[Tried]:
    """Effects that gain more than noise would: more of them would take chance differences for their own."""
    enough = max(screened.threshold, candidates.LEAST_GAIN)
    return [t for t in screened.tried if t.gain > enough][:MOST]


def _hopeful(
    bench: Bench, base: Fit, lens: Lens, screened: Screen, generic: Generic, rng: np.random.Generator
) -> bool:
    """Whether anything, an effect or a generic description, still promises more than half of what counts."""
    promised = max((t.gain for t in screened.tried), default=0.0)
    if promised > 0.5 * candidates.LEAST_GAIN:
        return True
    return remainder.find(bench, base, lens, generic, rng=rng).found


def run(
    model: Model,
    parameters: Sequence[Parameter],
    trials: Sequence[Trial],
    prior: Mapping[str, tuple[float, float]],
    effects: Sequence[Effect],
    *,
    seed: int = 0,
    jobs: int = 1,
    most: int = COMBINED,
    budget_s: float | None = None,
    checkpoint: Checkpoint | None = None,
    progress: Progress = silent,
) -> State:
    """Everything up to the choice of causes, on the trials that take part in fits."""
    keep = checkpoint or Checkpoint()
    begun = time.monotonic()
    rng = np.random.default_rng(seed)

    def late() -> bool:
        return budget_s is not None and time.monotonic() - begun > budget_s

    with threadpool_limits(limits=1, user_api="blas"):
        quick = coarser(model, [np.array([p.start for p in parameters])] * len(trials), trials)
        bench = Bench(model, parameters, trials, prior, jobs=jobs, quick=quick)
        lens, fit = weigh(bench)
        dropouts = look(bench.trials, fit.problem.simulations(fit.theta))
        if dropouts.count:
            bench = Bench(model, parameters, dropouts.without(trials), prior, jobs=jobs, quick=quick)
            lens, fit = weigh(bench)
        # a coarse step may do at the start values, and not from where trials were found to begin
        if bench.quick is not None:
            own = [fit.problem.vector(fit.theta, k) for k in range(len(bench.trials))]
            bench.quick = coarser(model, own, bench.trials)
        lens, sd, names = see(bench, fit, lens, fit.residuals, effects, len(fit.labels))
        fit = bench.fit((), lens, [fit.theta])
        state = State(bench, lens, fit, dropouts, chance=names, chance_sd=sd)
        while len(state.rounds) < max(most, 1):
            chosen = {e.name for e in state.base.effects}
            rest = [e for e in effects if e.name not in chosen]
            with progress(f"effects, round {len(state.rounds) + 1}", total=len(rest) + MOST) as step:

                def advance(name: str, step=step) -> None:  # type: ignore[no-untyped-def]
                    show(step, name)

                found = rank(
                    state, rest, effects, rng=rng, jobs=jobs, step=advance, late=late, checkpoint=keep
                )
            state.rounds.append(found)
            lead(state, found)
            if not found.ranked or not passes(state, found) or state.out_of_time:
                break
            if not without_the_needless(state, keep) and len(state.base.effects) + 1 > most:
                break
            # candidates are fitted only as far as their order needs
            best = state.rounds[-1].ranked[0].fit
            state.base = bench.fit(best.effects, state.lens, [best.theta], iterations=12, tolerance=1e-4)
            if late():
                state.out_of_time = True
                break
        if dropouts.count:
            simulated = [
                bench.affected(state.base.effects).simulate(state.base.problem.vector(state.base.theta, k), t)
                for k, t in enumerate(trials)
            ]
            state.dropouts = dropouts.confirmed(look(trials, simulated))
        generic = state.generic
        if generic is None or state.rounds[-1].base.effects != state.base.effects:
            generic = remainder.simulate(bench, state.base, jobs=jobs)
        state.left = remainder.find(bench, state.base, state.lens, generic, rng=rng)
        chance, _ = chance_columns(bench, state.base, effects)
        state.quiet = quiet(state.base, state.base.residuals, chance)
        state.slow = remainder.slow(state.base, state.quiet)
        if len(state.chance_sd):
            state.scatter = scatter(state.base, chance, np.minimum(state.chance_sd, CHANCE))
    return state


def without_the_needless(state: State, checkpoint: Checkpoint) -> bool:
    """Take back an effect chosen earlier that the one chosen last makes needless; whether there was one.

    An effect that stood in for the true one is found first where its linear guess was better.
    """
    bench, found = state.bench, state.rounds[-1]
    last = found.ranked[0]
    for i, earlier in enumerate(state.rounds[:-1]):
        stood_in = earlier.ranked[0].tried
        if stood_in.effect.name in state.taken_back:
            continue
        others = [e for e in last.fit.effects if e is not stood_in.effect]
        begin = bench.start(others, last.fit)
        without = bench.fit(
            others, found.lens, bench.begins(bench.problem(others), begin), iterations=12, tolerance=1e-4
        )
        plain = gram.folded(bench, without, found.lens)
        again = candidates.refit(
            bench, without, plain, found.lens, stood_in, begin=last.fit, checkpoint=checkpoint
        )
        if again.gain > max(found.threshold, BESIDE * last.gain):
            continue
        plain = gram.folded(bench, earlier.base, earlier.lens)
        kept = [r for r in earlier.ranked if r.tried.effect is not last.tried.effect]
        instead = candidates.refit(
            bench, earlier.base, plain, earlier.lens, last.tried, begin=without, checkpoint=checkpoint
        )
        # alone, on what was known of the noise then, it must count as well
        if why_not(state, earlier, instead):
            continue
        # it takes its place, and what else was chosen after it is chosen anew
        state.taken_back[stood_in.effect.name] = last.tried.effect.name
        earlier.ranked[:] = [instead, *kept]
        del state.rounds[i + 1 :]
        return True
    return False


def lead(state: State, found: Round) -> None:
    """Put the first effect of a round that counts at its head."""
    for i, candidate in enumerate(found.ranked):
        if counts(state, found, candidate):
            found.ranked.insert(0, found.ranked.pop(i))
            return


def passes(state: State, found: Round) -> bool:
    """Whether the effect at the head of a round counts."""
    return bool(found.ranked) and counts(state, found, found.ranked[0])


def counts(state: State, found: Round, best: Refitted) -> bool:
    """Whether an effect is one: beyond noise, in more than one fold, worth naming."""
    return not why_not(state, found, best)


def why_not(state: State, found: Round, best: Refitted) -> str:
    """Why an effect does not count, in words; empty where it does."""
    if best.gain <= found.threshold:
        return "it gains no more than noise alone may"
    if best.lost > LOST * (best.gain + best.lost):
        return "what it gains in some held-out folds it loses in others"
    if float(np.mean(best.gains < -WORSE)) > LOSING:
        return "it makes too many of the held-out folds worse"
    if best.size < NONE:
        return "its size is zero: the model itself has a better optimum"
    # a single fold tells nothing by itself: the effect was then read off it alone
    if len(best.gains) > 2 and best.gain - float(np.max(best.gains)) <= 0.5 * found.threshold:
        return "all it gains is in one held-out fold"
    first = state.rounds[0].ranked[0].gain if state.rounds and state.rounds[0] is not found else None
    if first is not None and best.gain <= FURTHER * first:
        return "beside what was found before it gains too little"
    return ""
