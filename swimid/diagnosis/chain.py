"""The steps of a diagnosis, strung together.

Is there a gap, where, by which effect, how far does it shrink, what is left, what next.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from threadpoolctl import threadpool_limits

from swimid.diagnosis import candidates, chance, gram, remainder
from swimid.diagnosis.bench import TOLERANCE, Bench, Fit
from swimid.diagnosis.candidates import Refitted, Screen, Tried
from swimid.diagnosis.chance import CHANCE, FEWEST, Kind
from swimid.diagnosis.dropouts import Dropouts, look
from swimid.diagnosis.floor import quiet
from swimid.diagnosis.lens import Lens, brief, coloured
from swimid.diagnosis.remainder import Generic, Left, Slow
from swimid.diagnosis.result import Threshold
from swimid.effects.base import Effect
from swimid.files.checkpoint import Checkpoint
from swimid.fitting import noise as noise_model
from swimid.fitting.model import Array, Model, Parameter, Trial
from swimid.progress import Progress, show, silent

#: Rounds of weighting by the residuals before anything is tried.
WEIGHTINGS = 2
#: Relative tolerance of the cost meanwhile.
COARSE = 1e-3
#: A longer step of integration may change a sample by this share of the range: far below any noise.
SMALL_CHANGE = 1e-4
#: Effects refitted in a round: those whose screened gain is at least this share of the best, so many at
#: most and at least.
SHARE, MOST, LEAST = 0.15, 9, 4
#: Beside an effect that was found, at most so many.
FURTHER_MOST = 6
#: Of one effect, so many forms.
FORMS = 2
#: Of those, so many are refitted to the end.
FINISHED = 3
#: Of those again, only what comes this close to the best.
CLOSE = 0.6
#: What an effect loses in some folds may be this share of what it gains in the others.
LOST = 0.25
#: One whose losses are at most this share of its gains helps in every held-out fold.
STEADY = 0.02
#: Of the folds, this share may be worse with it, by more misfit than chance makes of nothing.
LOSING, WORSE = 0.3, 2.0
#: Of so many the one that fits best is in the model meanwhile.
LEADERS = 3
#: Steps that suffice to tell which.
FEW = 8
#: Trials that differ by this many times their spread show that it is larger; so often it is read anew.
STRAINED, SETTLINGS = 2.0, 3
#: Trials shorter than so many samples do not tell how noise is coloured.
SHORT = 20
#: An effect this small, in typical sizes, is none.
NONE = 1e-3
#: A further effect must gain this share of what the first one did.
FURTHER = 0.03
#: It is refitted where the screen sees this share of that.
SEEN = 0.2
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
    needs : Threshold
        What the gain an effect needs is made of.
    """

    base: Fit
    screen: Screen
    ranked: list[Refitted]
    lens: Lens
    needs: Threshold

    @property
    def threshold(self) -> float:
        """Gain an effect needs."""
        return self.needs.required


@dataclass
class State:
    """Everything a diagnosis has found so far."""

    bench: Bench
    lens: Lens
    base: Fit
    dropouts: Dropouts
    rounds: list[Round] = field(default_factory=list)
    left: Left | None = None
    chance: list[Kind] = field(default_factory=list)
    out_of_time: bool = False
    slow: dict[str, Slow] = field(default_factory=dict)
    generic: Generic | None = None
    #: Effects chosen first and found needless beside another, by name.
    taken_back: dict[str, str] = field(default_factory=dict)
    quiet: list[Array] = field(default_factory=list)


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
            if not np.max(np.abs(fine[channel] - rough[channel]), initial=0.0) <= SMALL_CHANGE * span:
                return None
    return quick


def chance_columns(bench: Bench, fit: Fit, effects: Sequence[Effect]) -> tuple[list[Array], list[Kind]]:
    """Changes of each trial, per typical size, by what may differ from trial to trial by chance.

    Returns
    -------
    columns : list of ndarray, shape (n_k, q)
    kinds : list of Kind, length q
    """
    columns: list[list[Array]] = []
    found: list[Kind] = []
    value = {p.name: p.start for p in bench.parameters} | dict(zip(fit.labels, fit.theta, strict=True))
    for kind in chance.kinds(bench.model, bench.parameters, bench.trials, effects, value):
        if kind.effect is None:
            half = bench.moved(fit, kind.place, 0.5 * kind.size)
        else:
            point = np.array(kind.null)
            upper = kind.effect.parameters(bench.model, bench.trials)[kind.place].upper
            sign = 1.0 if point[kind.place] + 0.5 * kind.size <= upper else -1.0
            point[kind.place] += sign * 0.5 * kind.size
            half = [sign * c for c in bench.changes(fit, kind.effect, [point])[0]]
        if all(np.isfinite(c).all() for c in half) and sum(float(c @ c) for c in half) > 0:
            columns.append([2.0 * c for c in half])
            found.append(kind)
    stacked = [
        np.column_stack([c[k] for c in columns]) if columns else np.empty((len(fit.residuals[k]), 0))
        for k in range(len(bench.trials))
    ]
    return stacked, found


def see(
    bench: Bench,
    fit: Fit,
    lens: Lens,
    residuals: Sequence[Array],
    effects: Sequence[Effect],
    unknowns: int,
    *,
    common: int | None = None,
    cautious: bool = False,
) -> tuple[Lens, list[Kind]]:
    """The lens as some residuals show the noise: colour first, then chance differences between trials.

    Parameters
    ----------
    residuals : sequence of ndarray, shape (n_k,)
        Weighted, with all that differs between trials by chance still in them.
    unknowns : int
        Numbers fitted to them.
    common : int, optional
        Of these, effects that all trials share; without it chance differences are left out, as they would
        hide what no effect has yet been tried on.
    cautious : bool
        As in :func:`swimid.diagnosis.chance.spread`.

    Returns
    -------
    lens : Lens
    kinds : list of Kind
        What may differ, with the spread the trials show: the lens has at most `CHANCE` of it.
    """
    apart = _apart(bench)
    columns, kinds = chance_columns(bench, fit, effects) if apart else ([], [])
    # the colour is that of what no trim, gain or clock of a single trial explains: those come after it
    still = quiet(fit, residuals, columns) if apart else residuals
    unknowns += len(kinds) * len(residuals) if apart else 0
    lens = coloured(fit.problem, still, Lens(lens.sd), unknowns=unknowns)
    if apart:
        lens = brief(lens, fit.problem, still, remainder.moves(remainder.slow(fit, still)))
    if common is None or not apart:
        return lens, []
    own = [fit.own(k) for k in range(len(bench.trials))]
    sd = chance.spread(
        partial(lens.through, fit.problem), residuals, own, columns, used=common, cautious=cautious
    )
    kinds = [replace(kind, sd=float(s)) for kind, s in zip(kinds, sd, strict=True)]
    differing = tuple(replace(kind, sd=min(kind.sd, CHANCE)) for kind in kinds if kind.sd > 0)
    return replace(lens, chance=differing), kinds


def settled(bench: Bench, leading: Fit, lens: Lens) -> Lens:
    """The lens with spreads that hold once the model is fitted with them.

    A spread read off residuals, to first order, may be far too small: what differs between trials then goes
    into the coefficients, and effects seem to bring them back.

    Parameters
    ----------
    leading : Fit
        The model with the likeliest effect.
    """
    for _ in range(SETTLINGS):
        if not lens.chance:
            break
        begin = bench.start(leading.effects, lens, leading)
        leading = bench.fit(leading.effects, lens, [begin], iterations=FEW, tolerance=COARSE)
        scatter = leading.scatter()
        shown = [scatter.get(kind.label, 0.0) / kind.size for kind in lens.chance]
        strained = [size > STRAINED * kind.sd for size, kind in zip(shown, lens.chance, strict=True)]
        if not any(strained):
            break
        wider = [
            replace(kind, sd=min(size, CHANCE)) if grows else kind
            for kind, size, grows in zip(lens.chance, shown, strained, strict=True)
        ]
        lens = replace(lens, chance=tuple(wider))
    return lens


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
    samples = float(sum(len(r) for r in base.residuals))
    least_gain = candidates.LEAST_GAIN if base.effects else candidates.least_gain(samples)
    simulated = candidates.simulate(bench, base, effects, jobs=jobs, step=step)
    generic = state.generic = remainder.simulate(bench, base, jobs=jobs)
    apart = _apart(bench)
    # beside what was found already, an effect is worth a refit where the screen sees something of it
    least, most = 0.0, MOST
    if base.effects:
        least, most = max(0.5 * least_gain, SEEN * FURTHER * _first_gain(state)), FURTHER_MOST
    # the likeliest effects first, chance differences only in what they leave; then everything together
    for first in (False,) if apart and base.effects else (True, False):
        screened = candidates.screen(bench, base, lens, simulated, rng=rng)
        if base.effects and not _hopeful(bench, base, lens, screened, generic, rng):
            return Round(base, screened, [], lens, _needed(screened, samples, least_gain))
        if apart:
            leading, likely = _leading(bench, base, lens, screened, least, jobs), []
        else:
            leading, likely = base, [t for t in screened.tried if t.gain > 0][:MOST]
        columns, prior = [t.signature for t in likely], [1.0] * len(likely)
        if not (first and apart):
            left = remainder.find(bench, base, lens, generic, rng=rng)
            if left.found or not apart:
                columns, prior = columns + left.columns, prior + left.prior
        bare = remainder.saturated(bench, leading, lens, columns, prior)
        unknowns = len(columns) + len(leading.labels)
        common = int(leading is not base)
        lens, state.chance = see(
            bench, leading, lens, bare, scattering, unknowns, common=common, cautious=not base.effects
        )
        if not first:
            lens = settled(bench, leading, lens)
            held = {kind.label: kind.sd for kind in lens.chance}
            state.chance = [replace(k, sd=max(k.sd, held.get(k.label, 0.0))) for k in state.chance]
        begin = bench.start(base.effects, lens, base)
        if first:
            base = bench.fit(base.effects, lens, [begin], tolerance=candidates.FINE)
        else:
            base = _based(bench, base.effects, lens, begin)
    screened = candidates.screen(bench, base, lens, simulated, rng=rng)
    state.base, state.lens = base, lens
    plain = gram.folded(bench, base, lens)
    best = screened.tried[0].gain if screened.tried else 0.0
    each: list[Tried] = []
    for t in screened.tried:
        if sum(other.effect.name == t.effect.name for other in each) < FORMS:
            each.append(t)
    promising = [
        t
        for i, t in enumerate(each)
        if t.gain > least and (i < LEAST or (i < most and t.gain > SHARE * best))
    ]

    def one(tried: Tried) -> Refitted | None:
        if late() and tried is not promising[0]:
            state.out_of_time = True
            return None
        found = candidates.refit(bench, base, plain, lens, tried, checkpoint=checkpoint)
        step(tried.effect.name)
        return found

    def again(first: Refitted) -> Refitted:
        return candidates.refit(
            bench, base, plain, lens, first.tried, begin=first.fit, jobs=spare, checkpoint=checkpoint
        )

    with ThreadPoolExecutor(max(jobs, 1)) as pool:
        ranked = [r for r in pool.map(one, promising) if r is not None]
        ranked.sort(key=lambda r: -r.merit)
        best = max((r.merit for r in ranked), default=0.0)
        near = [r for r in ranked[:FINISHED] if r is ranked[0] or r.merit > CLOSE * best]
        spare = max(jobs // max(len(near), 1), 1)
        ranked[: len(near)] = pool.map(again, near)
    ranked.sort(key=lambda r: -r.merit)
    return Round(base, screened, ranked, lens, _needed(screened, samples, least_gain))


def _needed(screened: Screen, samples: float, least_gain: float) -> Threshold:
    return Threshold(screened.threshold, candidates.PER_SAMPLE * samples, least_gain)


def _based(
    bench: Bench, effects: Sequence[Effect], lens: Lens, begin: Array, tolerance: float = TOLERANCE
) -> Fit:
    """The model that candidates are compared with, from known coefficients too where it has left them far
    behind: what a poor optimum misses, some effect would seem to explain.
    """
    own, *others = bench.begins(bench.problem(effects, lens.chance), begin)
    best = bench.fit(effects, lens, [own], tolerance=tolerance)
    for other in others:
        near = bench.fit(effects, lens, [other], iterations=FEW, tolerance=COARSE)
        if near.cost < best.cost:
            best = bench.fit(effects, lens, [near.theta], tolerance=tolerance)
    return best


def _first_gain(state: State) -> float:
    """What the effect found first gains."""
    return state.rounds[0].ranked[0].gain


def _leading(bench: Bench, base: Fit, lens: Lens, screened: Screen, least: float, jobs: int) -> Fit:
    """The model with whichever of the likeliest effects fits best: what it leaves is nearer to noise.

    Far from null an effect's change is not the screen's. Without one that counts, the base itself.

    Parameters
    ----------
    least : float
        Screened gain of an effect that is tried.
    """
    likely: dict[str, Tried] = {}
    for t in screened.tried:
        # what each trial has for itself may be chance
        if t.gain > least and not any(p.per_trial for p in t.parameters):
            likely.setdefault(t.effect.name, t)
    plain = gram.folded(bench, base, lens)

    def one(tried: Tried) -> Refitted:
        return candidates.refit(bench, base, plain, lens, replace(tried, starts=[]), iterations=FEW)

    with ThreadPoolExecutor(max(jobs, 1)) as pool:
        found = list(pool.map(one, list(likely.values())[:LEADERS]))
    best = max(found, key=lambda r: r.merit, default=None)
    least_gain = candidates.least_gain(sum(len(r) for r in base.residuals))
    if best is None or best.merit <= max(screened.threshold, least_gain):
        return base
    return candidates.refit(bench, base, plain, lens, best.tried, begin=best.fit, jobs=jobs).fit


def _hopeful(
    bench: Bench, base: Fit, lens: Lens, screened: Screen, generic: Generic, rng: np.random.Generator
) -> bool:
    """Whether anything, an effect or a generic description, still promises more than half of what counts."""
    promised = max((t.gain for t in screened.tried), default=0.0)
    if promised > 0.5 * candidates.least_gain(sum(len(r) for r in base.residuals)):
        return True
    return remainder.find(bench, base, lens, generic, rng=rng).found


def run(
    model: Model,
    parameters: Sequence[Parameter],
    trials: Sequence[Trial],
    prior: Mapping[str, tuple[float, float]],
    effects: Sequence[Effect],
    *,
    scattering: Sequence[Effect] | None = None,
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
        To try.
    scattering : sequence of Effect, optional
        Of which those that scatter may differ between trials; default the same.
    """
    scattering = effects if scattering is None else scattering
    keep = checkpoint or Checkpoint()
    begun = time.monotonic()
    rng = np.random.default_rng(seed)

    def late() -> bool:
        return budget_s is not None and time.monotonic() - begun > budget_s

    with threadpool_limits(limits=1, user_api="blas"):
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
        lens, kinds = see(bench, fit, lens, fit.residuals, scattering, len(fit.labels))
        fit = _based(bench, (), lens, bench.start((), lens, fit), candidates.FINE)
        state = State(bench, lens, fit, dropouts, chance=kinds)
        while len(state.rounds) < max(most, 1):
            chosen = {e.name for e in state.base.effects}
            rest = [e for e in effects if e.name not in chosen]
            with progress(f"effects, round {len(state.rounds) + 1}", total=len(rest) + MOST) as step:

                def advance(name: str, step=step) -> None:  # type: ignore[no-untyped-def]
                    show(step, name)

                found = rank(
                    state, rest, scattering, rng=rng, jobs=jobs, step=advance, late=late, checkpoint=keep
                )
            state.rounds.append(found)
            lead(state, found)
            if not found.ranked or not passes(state, found) or state.out_of_time:
                break
            if not without_the_needless(state, keep) and len(state.base.effects) + 1 > most:
                break
            # candidates are fitted only as far as their order needs
            best = state.rounds[-1].ranked[0].fit
            begin = bench.start(best.effects, state.lens, best)
            state.base = bench.fit(best.effects, state.lens, [begin], iterations=12, tolerance=1e-4)
            if late():
                state.out_of_time = True
                break
        if dropouts.count:
            simulated = state.base.problem.simulations(state.base.theta)
            state.dropouts = dropouts.confirmed(look(trials, simulated))
        generic = state.generic
        if generic is None or state.rounds[-1].base.effects != state.base.effects:
            generic = remainder.simulate(bench, state.base, jobs=jobs)
        state.left = remainder.find(bench, state.base, state.lens, generic, rng=rng)
        columns, _ = chance_columns(bench, state.base, scattering)
        state.quiet = quiet(state.base, state.base.residuals, columns)
        state.slow = remainder.slow(state.base, state.quiet)
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
        begin = bench.start(others, found.lens, last.fit)
        begins = bench.begins(bench.problem(others, found.lens.chance), begin)
        without = bench.fit(others, found.lens, begins, iterations=12, tolerance=1e-4)
        plain = gram.folded(bench, without, found.lens)
        again = candidates.refit(
            bench,
            without,
            plain,
            found.lens,
            stood_in,
            begin=last.fit,
            jobs=bench.jobs,
            checkpoint=checkpoint,
        )
        if again.gain > max(found.threshold, BESIDE * last.gain):
            continue
        plain = gram.folded(bench, earlier.base, earlier.lens)
        kept = [r for r in earlier.ranked if r.tried.effect is not last.tried.effect]
        instead = candidates.refit(
            bench,
            earlier.base,
            plain,
            earlier.lens,
            last.tried,
            begin=without,
            jobs=bench.jobs,
            checkpoint=checkpoint,
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
    # an effect of unlike form may lose a little wherever it hardly acts
    if best.lost > STEADY * best.gain and float(np.mean(best.gains < -WORSE)) > LOSING:
        return "it makes too many of the held-out folds worse"
    if best.size < NONE:
        return "its size is zero: the model itself has a better optimum"
    # a single fold tells nothing by itself: the effect was then read off it alone
    if len(best.gains) > 2 and best.gain - float(np.max(best.gains)) <= 0.5 * found.threshold:
        return "all it gains is in one held-out fold"
    further = bool(state.rounds) and state.rounds[0] is not found
    if further and best.gain <= FURTHER * _first_gain(state):
        return "beside what was found before it gains too little"
    return ""
