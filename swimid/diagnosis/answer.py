"""The whole answer, from what a diagnosis tried."""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from swimid.diagnosis import advice, conclusion, crossval, places, remainder, shrinkage
from swimid.diagnosis.conclusion import Named
from swimid.diagnosis.context import FINE, Fit, FitContext
from swimid.diagnosis.floor import by_channel, split
from swimid.diagnosis.floor import floors as noise_floors
from swimid.diagnosis.folds import Folds
from swimid.diagnosis.nominal import Given
from swimid.diagnosis.posterior import UNSURE
from swimid.diagnosis.result import (
    Absorbed,
    Advice,
    Cause,
    ChannelGap,
    Extrapolation,
    Gap,
    Number,
    Remaining,
    Score,
    Shrinkage,
)
from swimid.diagnosis.search import State
from swimid.effects.sensing.marker_dropout import MarkerDropout
from swimid.fitting.model import Array, Parameter, Trial
from swimid.progress import Progress, silent

#: Failed samples count as a cause from this many on, and from this squared misfit.
FAILED, FAILED_MISFIT = 4, 50.0


def answer(
    state: State,
    validation: Sequence[Trial],
    given: Mapping[str, Given],
    raw: Sequence[Trial],
    *,
    seed: int = 0,
    progress: Progress = silent,
) -> Gap:
    """Verdict, causes, shrinkage, what remains, what next.

    Parameters
    ----------
    validation : sequence of Trial
        Trials that take part in no fit.
    given : mapping of name to Given
        The coefficients of the parameter file.
    raw : sequence of Trial
        The fitted trials with their failed samples still in.
    """
    rng = np.random.default_rng(seed)
    context = state.context
    nominal = state.nominal
    floor, how = noise_floors(
        context, state.base, state.nuisance_residuals, conclusion.structured_share(state)
    )
    for channel in remainder.drifting(state.low_frequency):
        floor[channel] *= math.sqrt(1.0 - state.low_frequency[channel].share)
    failed = _failed(state, nominal, raw, floor)
    chosen = [conclusion.named(state, r) for r in state.rounds]
    word = conclusion.verdict(state, chosen, dropout=failed > 0)
    surely = state.posterior.none <= UNSURE
    # beside something from outside only what acts rather than not
    chosen = [c for c in chosen if surely and (word != "unexplained" or c.probability > 0.5)]
    rows = conclusion.scores(state)
    shipped = {p.name: p.start for p in context.parameters if not p.per_trial}
    total = len(validation) or context.folds.count
    with progress("held-out trials", total=total) as step:
        held = shrinkage.pieces(
            context,
            _alone(state),
            state.base,
            state.noise_model,
            floor,
            shipped,
            validation,
            step=lambda: step(1),
        )
    closing = shrinkage.shrinkages(held, floor, rng=rng)
    reasons: list[str] = []
    sound = shrinkage.sound(held)
    if chosen and not (sound and (shrinkage.helps(held, floor) or _by_coefficients(state))):
        names = ", ".join(c.best.tried.effect.name for c in chosen)
        hides = "are no better with it: what differs from trial to trial hides it"
        reasons.append(
            f"{names}: held-out trials, simulated anew, {hides if sound else 'break down with it'}"
        )
        word = "ambiguous" if word == "explained" else word
    # what a cause accounts for is none of the random effects of the model without it
    gap_left = nominal.marginal_residuals([e.name for e in state.base.effects])
    size = {c: float(np.sqrt(np.mean(v**2))) for c, v in by_channel(nominal, gap_left).items()}
    if word == "none":
        # nothing it leaves can be told from noise and from what differs from trial to trial
        floor = {c: max(v, size[c]) for c, v in floor.items()}
        how = "all that the model leaves: noise, and what differs from trial to trial"
    causes = _causes(state, chosen, nominal, given, closing if word != "none" else ())
    if failed:
        causes = _with_failed(state, causes, raw, nominal, floor, failed, rows)
    where = places.Map(context, nominal, gap_left, floor)
    gap = word != "none"
    stages = conclusion.stages(rows, bool(chosen), {s.stage for s in rows})
    if failed and causes and causes[0].effect == MarkerDropout.name:
        stages = {k: (1.0 if k == "sensing" else 0.0) for k in stages}
    units = {c.name: c.unit for c in context.model.channels}
    left = state.left
    stuck = _at_bounds(context, nominal)
    return Gap(
        verdict=word,
        channels=_channels(context, nominal, gap_left, floor, shipped, units, held),
        stages=stages,
        phase=places.phases(where) if gap else (),
        regime=places.regimes(where),
        time=places.times(where),
        causes=tuple(causes) if gap else (),
        remaining=_remaining(state, nominal, gap_left, floor),
        advice=_advice(state, chosen, word, floor),
        scores=rows,
        no_gap=state.posterior.none,
        outside=state.posterior.outside,
        floor_from=how,
        held_out="validation" if validation else "trials" if context.folds.whole else "stretches",
        sketches=places.sketches(context, state.base, left) if left is not None and left.found else (),
        overlays=shrinkage.overlays(held, units),
        maps=places.maps(where),
        forces=dict(left.places) if left is not None else {},
        rounds=tuple(state.told),
        reasons=(*(_stuck(name, value) for name, value in stuck.items()), *reasons, *_reasons(state)),
        at_bound=stuck,
        hypotheses=conclusion.hypotheses(state),
        samples=sum(len(r) for r in nominal.residuals),
        tried=state.tried,
    )


def _by_coefficients(state: State) -> bool:
    """Whether most that tells the causes is that coefficients are known from elsewhere: refitted without them
    these imitate the causes, and held-out errors are as small.
    """
    null, *found = state.posterior.candidates
    best = next((c for c in found if c.names == state.posterior.best), null)
    return float(np.sum(null.folds - best.folds)) < 0.5 * (null.score - best.score)


def _alone(state: State) -> Fit:
    """The model refitted as if trials did not differ: what differs may have stood in for a cause, and nothing
    is known of it in a trial to come.
    """
    if not state.noise_model.random_effects:
        return state.nominal
    context, noise_model = state.context, replace(state.noise_model, random_effects=())
    begin = context.start((), noise_model, state.nominal)
    return context.fit((), noise_model, context.begins(context.problem(()), begin), tolerance=FINE)


def _reasons(state: State) -> tuple[str, ...]:
    said: list[str] = []
    said += [f"{name}: {why}" for name, why in state.singles.screen.left_out.items()]
    if state.out_of_time:
        said.append("the time budget ran out before every effect was refitted")
    said += [
        f"trials differ by chance in {kind.name}: {kind.sd:.2g} of its typical size; that is in the noise"
        for kind in state.random_effects
        if kind.sd > 0.02
    ]
    return tuple(said)


def _channels(
    context: FitContext,
    nominal: Fit,
    residuals: Sequence[Array],
    floor: Mapping[str, float],
    shipped: Mapping[str, float],
    units: Mapping[str, str],
    held: Sequence[shrinkage.Piece],
) -> tuple[ChannelGap, ...]:
    squares: dict[str, list[Array]] = {}
    spans: dict[str, list[Array]] = {}
    for k, trial in enumerate(context.trials):
        for channel, series in split(nominal, k, residuals[k]).items():
            there = np.isfinite(series)
            squares.setdefault(channel, []).append(series[there] ** 2)
            spans.setdefault(channel, []).append(trial.measured[channel][there])
    as_given: dict[str, list[Array]] = {}
    for p in held:
        error = (p.measured - p.shipped)[np.isfinite(p.measured)]
        as_given.setdefault(p.channel, []).append(error**2)
    excess = _excess(nominal, residuals, floor)
    total = sum(excess.values()) or 1.0
    found = []
    for channel, parts in squares.items():
        rmse = float(np.sqrt(np.mean(np.concatenate(parts))))
        span = float(np.ptp(np.concatenate(spans[channel]))) or 1.0
        before = as_given.get(channel)
        shipped_rmse = float(np.sqrt(np.mean(np.concatenate(before)))) if before else math.nan
        found.append(
            ChannelGap(
                channel, units.get(channel, "1"), rmse / span, floor[channel] / span, excess[channel] / total,
                rmse, shipped_rmse / span,
            )
        )  # fmt: skip
    return tuple(sorted(found, key=lambda c: -c.share))


def _causes(
    state: State,
    chosen: Sequence[Named],
    nominal: Fit,
    given: Mapping[str, Given],
    closing: tuple[Shrinkage, ...],
) -> list[Cause]:
    if not chosen:
        return []
    sd = conclusion.parameter_errors(state, state.base)
    absorbed = _absorbed(state, nominal, given, sd)
    beyond = _extrapolations(state, nominal)
    causes = []
    for number, c in enumerate(chosen):
        effect = c.best.tried.effect
        numbers: dict[str, Number] = {}
        for p in c.best.tried.parameters:
            labels = [n for n in state.base.labels if n.split("[")[0] == f"{effect.name}/{p.name}"]
            values = [state.base.value(n) for n in labels]
            if not values:
                continue
            if p.per_trial:
                size = float(np.sqrt(np.mean(np.square(values))))
                numbers[f"{p.name}_rms"] = Number(size, None, p.unit)
            else:
                bound = values[0] <= p.lower or values[0] >= p.upper
                error = sd.get(labels[0])
                status = "at-bound" if bound else "estimated"
                numbers[p.name] = Number(values[0], None if bound else error, p.unit, status)
        causes.append(
            Cause(
                effect.name,
                effect.stage,
                effect.meaning,
                effect.sources,
                float(np.clip(c.probability, 0.0, 1.0)),
                c.equivalent,
                numbers,
                closing if number == 0 else (),
                c.best.gain,
                c.best.stderr,
                absorbed if number == 0 else (),
                beyond if number == 0 else (),
            )
        )
    return causes


def _at_bounds(context: FitContext, fit: Fit) -> dict[str, float]:
    """The model's own shared coefficients that a fit ends with at a bound, and the bound."""
    own = {p.name for p in context.parameters if not p.per_trial}
    ends = zip(fit.labels, fit.theta, fit.inside, strict=True)
    return {label: float(value) for label, value, inside in ends if label in own and not inside}


def _stuck(name: str, bound: float) -> str:
    return f"{name} ends at its bound {bound:.4g} in the refit without effects: it may stand in for a cause"


def _absorbed(
    state: State, nominal: Fit, given: Mapping[str, Given], sd: Mapping[str, float]
) -> tuple[Absorbed, ...]:
    plain = conclusion.parameter_errors(state, nominal)
    found = []

    def refitted(p: Parameter, fit: Fit, error: Mapping[str, float]) -> Number:
        if p.name in _at_bounds(state.context, fit):
            return Number(fit.value(p.name), None, p.unit, "at-bound")
        return Number(fit.value(p.name), error.get(p.name), p.unit)

    for p in state.context.parameters:
        if p.per_trial or p.name not in nominal.labels:
            continue
        known = given.get(p.name)
        found.append(
            Absorbed(
                p.name,
                p.unit,
                Number(known.value, known.stderr, p.unit, known.status) if known else None,
                refitted(p, nominal, plain),
                refitted(p, state.base, sd),
                p.bounds,
            )
        )
    return tuple(found)


def _extrapolations(state: State, nominal: Fit) -> tuple[Extrapolation, ...]:
    """Errors on the outermost frequency, amplitude or force, left out of the fit."""
    context = state.context
    if not context.folds.whole:
        return ()
    settings = [places.knobs(t) for t in context.trials]
    found = []
    for kind in ("frequency", "amplitude", "force"):
        labels = [s.get(kind) for s in settings]
        levels = sorted({label for label in labels if label}, key=lambda text: float(text.split()[0]))
        if len(levels) < 3:
            continue
        for label in (levels[-1], levels[0]):
            inside = [k for k, own in enumerate(labels) if own == label]
            cut = copy.copy(context)
            owner = [np.full(len(o), int(k in inside)) for k, o in enumerate(context.folds.owner)]
            cut.folds = Folds(True, owner, ["rest", label])
            ratios = []
            for fit in (nominal, state.base):
                inner = crossval.normal_equations(cut, fit, state.noise_model)
                misfit = float(crossval.held_out(inner)[1])
                ratios.append(math.sqrt(max(misfit, 0.0) / max(float(inner.samples[1]), 1.0)))
            found.append(Extrapolation(f"{kind} {label}", ratios[0], ratios[1]))
    return tuple(found)


def _excess(fit: Fit, residuals: Sequence[Array], floor: Mapping[str, float]) -> dict[str, float]:
    """Squared residuals beyond those of the noise, in units of it, by channel."""
    found = by_channel(fit, residuals)
    beyond = {c: float(np.sum((v / max(floor[c], 1e-300)) ** 2 - 1.0)) for c, v in found.items()}
    return {c: b if b > 1e-9 * len(found[c]) else 0.0 for c, b in beyond.items()}


def _remaining(
    state: State, nominal: Fit, residuals: Sequence[Array], floor: Mapping[str, float]
) -> Remaining:
    left = state.left
    if left is None:
        return Remaining(0.0, "", True, 0.0)
    where = _where(state)
    if not left.found:
        moving = remainder.drifting(state.low_frequency)
        if moving:
            gap, still = (
                _excess(nominal, residuals, floor),
                _excess(state.base, state.nuisance_residuals, floor),
            )
            share = sum(still[c] for c in moving) / max(sum(gap.values()), 1e-300)
            return Remaining(min(share, 1.0), where, False, max(left.gain, 0.0))
        apart = bool(conclusion.differs(state))
        return Remaining(float(apart), where, not apart, max(left.gain, 0.0))
    return Remaining(state.posterior.left, where, False, left.gain)


def _where(state: State) -> str:
    """Where what is left acts, in words."""
    left = state.left
    if left is None or not left.found:
        moving = remainder.drifting(state.low_frequency)
        if moving:
            return f"{' and '.join(moving)}, slower than noise and not alike in all trials"
        apart = conclusion.differs(state)
        if apart:
            return f"trials differ as if by {' and '.join(apart)}, more than chance would make them"
        return "nothing that a smooth description finds"
    ranked = sorted(left.places.items(), key=lambda item: -item[1])
    return " and ".join(place for place, gain in ranked[:2] if gain > 0.3 * max(ranked[0][1], 1e-300))


def _advice(
    state: State, chosen: Sequence[Named], word: str, floor: Mapping[str, float]
) -> tuple[Advice, ...]:
    context, found = state.context, state.rounds
    if chosen:
        names = (chosen[0].best.tried.effect.name, *chosen[0].equivalent)
        rivals = [next(r for r in found[0].ranked if r.tried.effect.name == n) for n in names]
        if len(rivals) == 1:
            others = [r for r in found[0].ranked if r.tried.effect.name != names[0]]
            rivals += others[:1]
        if len(rivals) > 1:
            first, second = rivals[0], rivals[1]
            now = math.sqrt(max(first.gain - second.gain, 0.0))
            try:
                return advice.advise(context, [r.fit for r in rivals], found[0].noise_model, floor, now)
            except (ArithmeticError, np.linalg.LinAlgError):
                return ()
    if word == "unexplained":
        where = _where(state)
        return (
            Advice(
                "repeat one setting three times: what repeats is physics, what does not is chance (now left: "
                f"{where})",
                (),
                math.nan,
                math.nan,
            ),
        )
    return ()


# ------------------------------------------------------------ failed samples


def _failed(state: State, nominal: Fit, raw: Sequence[Trial], floor: Mapping[str, float]) -> float:
    """Squared misfit of the failed samples in units of the noise; 0 where they are too few to name."""
    if state.dropouts.count < FAILED:
        return 0.0
    total = sum(
        _failed_squares(state, nominal, raw, c)[0] / max(floor.get(c, 1.0), 1e-300) ** 2 for c in floor
    )
    return total if total > FAILED_MISFIT else 0.0


def _failed_squares(state: State, fit: Fit, raw: Sequence[Trial], channel: str) -> tuple[float, int]:
    total, count = 0.0, 0
    for k, trial in enumerate(raw):
        mask = state.dropouts.masks.get(trial.id, {}).get(channel)
        if mask is None:
            continue
        simulated = fit.problem.simulations(fit.theta)[k].get(channel)
        if simulated is None:
            continue
        error = (trial.measured[channel] - simulated)[mask]
        total += float(np.nansum(error**2))
        count += int(np.isfinite(error).sum())
    return total, count


def _with_failed(
    state: State,
    causes: list[Cause],
    raw: Sequence[Trial],
    nominal: Fit,
    floor: Mapping[str, float],
    misfit: float,
    rows: Sequence[Score],
) -> list[Cause]:
    """The causes with the failed samples among them, where their misfit puts them."""
    closing = list(causes[0].shrinkage) if causes else []
    widened = []
    for channel in floor:
        squares, count = _failed_squares(state, nominal, raw, channel)
        if not count:
            continue
        sound = [split(nominal, k, nominal.residuals[k]).get(channel) for k in range(len(raw))]
        own = np.concatenate([s[np.isfinite(s)] for s in sound if s is not None])
        values = np.concatenate(
            [t.measured[channel][np.isfinite(t.measured[channel])] for t in raw if channel in t.measured]
        )
        span = float(np.ptp(values)) or 1.0
        before = math.sqrt((float(np.sum(own**2)) + squares) / (len(own) + count)) / span
        known = next((s for s in closing if s.channel == channel), None)
        after = known.after if known else float(np.sqrt(np.mean(own**2))) / span
        level = floor[channel] / span
        widened.append(
            Shrinkage(
                channel,
                before,
                after,
                before,
                level,
                shrinkage.closed(before, after, level),
                (math.nan, math.nan),
            )
        )
    rest = [s for s in closing if s.channel not in {w.channel for w in widened}]
    stretches = state.dropouts.stretches
    kinds = sorted({kind for *_, kind in stretches})
    samples = sum(int(np.isfinite(t.measured[c]).sum()) for t in raw for c in t.measured)
    first = min(stretches, key=lambda s: s[2])
    effect = Cause(
        MarkerDropout.name,
        MarkerDropout.stage,
        f"{MarkerDropout.meaning} ({', '.join(kinds)}; in {len({s[0] for s in stretches})} trials)",
        MarkerDropout.sources,
        0.97,
        (),
        {
            "failed_share": Number(state.dropouts.count / max(samples, 1), None, "1"),
            "first_failure_s": Number(first[2], None, "s"),
        },
        (),
        misfit,
        math.nan,
    )
    ordered = sorted([*causes, effect], key=lambda c: -c.gain)
    head = ordered[0]
    carried = causes[0] if causes else effect
    ordered[0] = replace(
        head, shrinkage=(*widened, *rest), absorbed=carried.absorbed, extrapolations=carried.extrapolations
    )
    return [ordered[0], *(replace(c, shrinkage=(), absorbed=(), extrapolations=()) for c in ordered[1:])]
