"""How residuals are weighted: noise, its colour, and what differs between trials by chance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from swimid.diagnosis import chance, remainder
from swimid.diagnosis.bench import Bench, Fit
from swimid.diagnosis.chance import CHANCE, FEWEST, Kind
from swimid.diagnosis.floor import quiet
from swimid.diagnosis.lens import Lens, brief, coloured
from swimid.effects.base import Effect
from swimid.fitting import noise as noise_model
from swimid.fitting.model import Array

#: Rounds of weighting by the residuals before anything is tried.
WEIGHTINGS = 2
#: Relative tolerance of the cost meanwhile, and steps.
COARSE, FEW = 1e-3, 8
#: Trials that differ by this many times their spread show that it is larger; so often it is read anew.
STRAINED, SETTLINGS = 2.0, 3
#: Trials shorter than so many samples do not tell how noise is coloured.
SHORT = 20


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
    apart = tells_noise(bench)
    columns, kinds = chance_columns(bench, fit, effects) if apart else ([], [])
    # the colour is that of what no trim, gain or clock of a single trial explains: those come after it
    still = quiet(fit, residuals, columns) if apart else residuals
    unknowns += len(kinds) * len(residuals) if apart else 0
    lens = coloured(fit.problem, still, Lens(lens.sd), unknowns=unknowns)
    if not apart:
        # few trials do not tell what is slow in noise from a gap
        return replace(brief(lens, fit.problem, still, list(lens.colour)), slow=lens), []
    lens = brief(lens, fit.problem, still, remainder.moves(remainder.slow(fit, still)))
    if common is None:
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


def tells_noise(bench: Bench) -> bool:
    """Whether there are trials enough to tell what differs between them by chance."""
    short = all(sum(int(m.sum()) for m in masks) < SHORT for masks in bench.shape.masks)
    return bench.folds.whole and len(bench.trials) >= FEWEST and not short
