"""The whole answer, from what a diagnosis tried."""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from swimid.diagnosis import advice, conclusion, crossval, places, remainder, shrinkage
from swimid.diagnosis.conclusion import Named
from swimid.diagnosis.context import FINE, Fit, FitContext
from swimid.diagnosis.drawings import Drawings
from swimid.diagnosis.floor import by_channel, split
from swimid.diagnosis.floor import floors as noise_floors
from swimid.diagnosis.folds import Folds
from swimid.diagnosis.gap_file import (
    Absorbed,
    Advice,
    Cause,
    ChannelGap,
    Extrapolation,
    GapFile,
    OddTrial,
    Remaining,
    Shrinkage,
    Stage,
    Value,
    Where,
    ranked,
)
from swimid.diagnosis.odd import contradicting
from swimid.diagnosis.posterior import UNSURE
from swimid.diagnosis.search import State
from swimid.effects.sensing.marker_dropout import MarkerDropout
from swimid.fitting.model import Array, Parameter, Trial
from swimid.fitting.odd_trial import Odd
from swimid.progress import Progress, silent
from swimid.results.parameters import Estimate

#: Failed samples count as a cause from this many on, and from this squared misfit.
FAILED, FAILED_MISFIT = 4, 50.0


def answer(
    state: State,
    validation: Sequence[Trial],
    given: Mapping[str, Estimate],
    raw: Sequence[Trial],
    *,
    seed: int = 0,
    progress: Progress = silent,
) -> tuple[GapFile, Drawings]:
    """Verdict, causes, shrinkage, what remains, what next.

    Parameters
    ----------
    validation : sequence of Trial
        Trials that take part in no fit.
    given : mapping of name to Estimate
        The coefficients of the parameter file.
    raw : sequence of Trial
        The fitted trials with their failed samples still in.

    Returns
    -------
    GapFile
        What was diagnosed is not yet named in it.
    Drawings
    """
    rng = np.random.default_rng(seed)
    context = state.context
    nominal = state.nominal
    alike = _alone(state, nominal), _alone(state, state.base)
    noise = noise_floors(
        context,
        state.base,
        state.nuisance_residuals,
        conclusion.structured_share(state),
        alike[1],
        state.noise_model,
    )
    floor, how = noise.inside, noise.how
    for channel in remainder.drifting(state.low_frequency):
        for levels in (floor, noise.levels):
            levels[channel] *= math.sqrt(1.0 - state.low_frequency[channel].share)
    failed = _failed(state, nominal, raw, floor)
    chosen = [conclusion.named(state, r) for r in state.rounds]
    word = conclusion.verdict(state, chosen, dropout=failed > 0)
    surely = state.posterior.none <= UNSURE
    # beside something from outside only what acts rather than not
    chosen = [c for c in chosen if surely and (word != "unexplained" or c.probability > 0.5)]
    rows = conclusion.scores(state)
    shipped = {p.name: p.start for p in context.parameters if not p.per_trial}
    # what differs between trials may have stood in for a cause, or a cause for what differs: each model is
    # fitted in the way that predicts better
    fits = [(nominal, state.base), alike] if state.noise_model.random_effects else [alike]
    total = len(validation) or context.folds.count
    with progress("held-out trials", total=len(fits) * total) as step:
        held = shrinkage.better(
            [
                shrinkage.pieces(
                    context, *pair, state.noise_model, floor, shipped, validation, step=lambda: step(1)
                )
                for pair in fits
            ],
            floor,
        )
    # where more than noise is left, what a fit takes up and misses elsewhere is of that, too
    more = _remaining(state, nominal, nominal.marginal_residuals(), floor).share
    outside = floor if more else shrinkage.capped(noise.levels, held)
    ranges = _ranges(context, nominal)
    closing = shrinkage.shrinkages(held, outside, noise.squares, ranges, rng=rng)
    reasons: list[str] = []
    refuted: list[str] = []
    names = [c.best.tried.effect.name for c in chosen]
    helped = True
    sound = shrinkage.sound(held)
    if chosen and shrinkage.refute(held, floor):
        refuted = names
        chosen, word, state.base = [], "unexplained", nominal
    if chosen and not (sound and (shrinkage.helps(held, floor) or _by_coefficients(state))):
        told = "close less than half of the squared gap with it" if sound else "break down with it"
        reasons.append(f"{', '.join(names)}: held-out trials, simulated anew, {told}")
        word = "ambiguous" if word == "explained" else word
        helped = False
    odd = None
    if word == "unexplained" or not helped:
        odd = contradicting(context, nominal, nominal.marginal_residuals(), floor)
    if odd is not None:
        chosen, word, state.base = [], "unexplained", nominal
    # what a cause accounts for is none of the random effects of the model without it
    gap_left = nominal.marginal_residuals([e.name for e in state.base.effects])
    remaining = _remaining(state, nominal, gap_left, floor)
    if chosen and (remaining.share or 0.0) > shrinkage.MOST:
        reasons.append(
            f"{remaining.share:.0%} of the squared gap remains with {', '.join(names)}: {remaining.where}"
        )
        word = "unexplained"
        chosen = [c for c in chosen if c.probability > 0.5]
    size = {c: _rms(v) for c, v in by_channel(nominal, gap_left).items()}
    if word == "none":
        # nothing it leaves can be told from noise and from what differs from trial to trial
        floor = {c: max(v, size[c]) for c, v in floor.items()}
        how = "all that the model leaves: noise, and what differs from trial to trial"
    gap = word != "none"
    causes = _causes(state, chosen, nominal, given, closing if gap else [])
    if failed:
        causes = _with_failed(state, causes, raw, nominal, floor, failed, ranges)
    where = places.Map(context, nominal, gap_left, floor)
    stages: dict[Stage, float | None] = {**conclusion.stages(rows, gap=bool(chosen))}
    if failed and causes and causes[0].effect == MarkerDropout.name:
        stages = {k: (1.0 if k == "sensing" else 0.0) for k in stages}
    units = {c.name: c.unit for c in context.model.channels}
    left = state.left
    stuck = _at_bounds(context, nominal)
    regime, phase, time = places.regimes(where), places.phases(where) if gap else [], places.times(where)
    file = GapFile(
        verdict=word,
        where=Where(
            channels=_channels(nominal, gap_left, floor, units, held, ranges),
            stage=stages,
            phase=phase,
            regime=regime,
            time=time,
        ),
        causes=causes if gap else [],
        remaining=remaining,
        advice=[*_without(odd), *_advice(state, chosen, word, floor)],
        odd_trial=None if odd is None else OddTrial(trial=odd.trial, times=odd.times),
        refuted=refuted,
        no_gap=state.posterior.none,
        outside=state.posterior.outside,
        at_bound=stuck,
        hypotheses=conclusion.hypotheses(state),
        samples=sum(len(r) for r in nominal.residuals) or None,
        tried=state.tried or None,
        held_out="validation" if validation else "trials" if context.folds.whole else "stretches",
        floor_from=how,
        scores=rows,
        forces={**left.places} if left is not None else {},
        rounds=state.told,
        reasons=[*(_stuck(name, value) for name, value in stuck.items()), *reasons, *_reasons(state)],
    )
    return ranked(file), Drawings(
        maps=places.maps(where),
        parts=[*regime, *phase, *time],
        overlays=shrinkage.overlays(held, units),
        sketches=places.sketches(left) if left is not None and left.found else [],
    )


def _without(odd: Odd | None) -> list[Advice]:
    if odd is None:
        return []
    return [Advice(text=f"look at what is written of {odd.trial}; diagnose without it (role: validate)")]


def _by_coefficients(state: State) -> bool:
    """Whether most that tells the causes is that coefficients are known from elsewhere: refitted without them
    these imitate the causes, and held-out errors are as small.
    """
    null, *found = state.posterior.candidates
    best = next((c for c in found if c.names == state.posterior.best), null)
    return float(np.sum(null.folds - best.folds)) < 0.5 * (null.score - best.score)


def _alone(state: State, fit: Fit) -> Fit:
    """A model refitted as if trials did not differ: what differs may have stood in for a cause, and nothing
    is known of it in a trial to come.
    """
    if not state.noise_model.random_effects:
        return fit
    context, noise_model = state.context, replace(state.noise_model, random_effects=())
    begin = context.start(fit.effects, noise_model, fit)
    starts = context.begins(context.problem(fit.effects), begin)
    return context.fit(fit.effects, noise_model, starts, tolerance=FINE)


def _reasons(state: State) -> list[str]:
    said = [f"{name}: {why}" for name, why in state.singles.screen.left_out.items()]
    if state.out_of_time:
        said.append("the time budget ran out before every effect was refitted")
    said += [
        f"trials differ by chance in {kind.name}: {kind.sd:.2g} of its typical size; that is in the noise"
        for kind in state.random_effects
        if kind.sd > 0.02
    ]
    return said


def _ranges(context: FitContext, nominal: Fit) -> dict[str, float]:
    """Measured range of each channel over the fitted trials, in its unit; 1 where it is none."""
    parts: dict[str, list[Array]] = {}
    for k, trial in enumerate(context.trials):
        for channel, series in split(nominal, k, nominal.residuals[k]).items():
            parts.setdefault(channel, []).append(trial.measured[channel][np.isfinite(series)])
    return {c: float(np.ptp(np.concatenate(p))) or 1.0 for c, p in parts.items()}


def _channels(
    nominal: Fit,
    residuals: Sequence[Array],
    floor: Mapping[str, float],
    units: Mapping[str, str],
    held: Sequence[shrinkage.Piece],
    ranges: Mapping[str, float],
) -> list[ChannelGap]:
    pieces = shrinkage.by_channel(held)
    excess = _excess(nominal, residuals, floor)
    total = sum(excess.values()) or 1.0
    found = []
    for channel, left in by_channel(nominal, residuals).items():
        rmse, size = _rms(left), ranges[channel]
        errors = [p.seen(p.measured - p.shipped) for p in pieces.get(channel, ())]
        found.append(
            ChannelGap(
                channel=channel,
                nrmse=rmse / size,
                floor=floor[channel] / size,
                share=excess[channel] / total,
                rmse=rmse,
                unit=units.get(channel, "1"),
                shipped=_rms(np.concatenate(errors)) / size if errors else None,
            )
        )
    return found


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _causes(
    state: State,
    chosen: Sequence[Named],
    nominal: Fit,
    given: Mapping[str, Estimate],
    closing: list[Shrinkage],
) -> list[Cause]:
    if not chosen:
        return []
    sd = conclusion.parameter_errors(state, state.base)
    causes = [
        Cause(
            effect=c.best.tried.effect.name,
            probability=float(np.clip(c.probability, 0.0, 1.0)),
            equivalent=list(c.equivalent),
            parameters=_values(state, c, sd),
            stage=c.best.tried.effect.stage,
            meaning=c.best.tried.effect.meaning,
            sources=list(c.best.tried.effect.sources),
            gain=c.best.gain,
            gain_stderr=c.best.stderr,
        )
        for c in chosen
    ]
    first = {
        "shrinkage": closing,
        "absorbed": _absorbed(state, nominal, given, sd),
        "extrapolation": _extrapolations(state, nominal),
    }
    return [causes[0].model_copy(update=first), *causes[1:]]


def _values(state: State, cause: Named, sd: Mapping[str, float]) -> dict[str, Value]:
    """The size of a cause: parameters of its effect, those of single trials by their root mean square."""
    found = {}
    for p in cause.best.tried.parameters:
        name = f"{cause.best.tried.effect.name}/{p.name}"
        labels = [n for n in state.base.labels if n.split("[")[0] == name]
        values = [state.base.value(n) for n in labels]
        if not values:
            continue
        if p.per_trial:
            found[f"{p.name}_rms"] = Value(value=_rms(np.array(values)), unit=p.unit)
        elif values[0] <= p.lower or values[0] >= p.upper:
            found[p.name] = Value(value=values[0], unit=p.unit, status="at-bound")
        else:
            found[p.name] = Value(value=values[0], stderr=sd.get(labels[0]), unit=p.unit)
    return found


def _at_bounds(context: FitContext, fit: Fit) -> dict[str, float]:
    """The model's own shared coefficients that a fit ends with at a bound, and the bound."""
    own = {p.name for p in context.parameters if not p.per_trial}
    ends = zip(fit.labels, fit.theta, fit.inside, strict=True)
    return {label: float(value) for label, value, inside in ends if label in own and not inside}


def _stuck(name: str, bound: float) -> str:
    return f"{name} ends at its bound {bound:.4g} in the refit without effects: it may stand in for a cause"


def _absorbed(
    state: State, nominal: Fit, given: Mapping[str, Estimate], sd: Mapping[str, float]
) -> list[Absorbed]:
    plain = conclusion.parameter_errors(state, nominal)
    found = []

    def refitted(p: Parameter, fit: Fit, error: Mapping[str, float]) -> Value:
        if p.name in _at_bounds(state.context, fit):
            return Value(value=fit.value(p.name), stderr=None, unit=p.unit, status="at-bound")
        return Value(value=fit.value(p.name), stderr=error.get(p.name), unit=p.unit)

    for p in state.context.parameters:
        if p.per_trial or p.name not in nominal.labels:
            continue
        known = given.get(p.name)
        found.append(
            Absorbed(
                coefficient=p.name,
                given=known
                and Value(value=known.value, stderr=known.stderr, unit=p.unit, status=known.status),
                without=refitted(p, nominal, plain),
                with_effect=refitted(p, state.base, sd),
                bounds=p.bounds,
            )
        )
    return found


def _extrapolations(state: State, nominal: Fit) -> list[Extrapolation]:
    """Errors on the outermost frequency, amplitude or force, left out of the fit."""
    context = state.context
    if not context.folds.whole:
        return []
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
            found.append(Extrapolation(left_out=f"{kind} {label}", before=ratios[0], after=ratios[1]))
    return found


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
        return Remaining(share=0.0, where="", white=True, gain=0.0)
    if left.found:
        return Remaining(share=state.posterior.left, where=_where(state), white=False, gain=left.gain)
    moving = remainder.drifting(state.low_frequency)
    apart = bool(moving or conclusion.differs(state))
    share = float(apart)
    if moving:
        gap = _excess(nominal, residuals, floor)
        still = _excess(state.base, state.nuisance_residuals, floor)
        share = min(sum(still[c] for c in moving) / max(sum(gap.values()), 1e-300), 1.0)
    return Remaining(share=share, where=_where(state), white=not apart, gain=max(left.gain, 0.0))


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
    largest = sorted(left.places.items(), key=lambda item: -item[1])
    return " and ".join(place for place, gain in largest[:2] if gain > 0.3 * max(largest[0][1], 1e-300))


def _advice(state: State, chosen: Sequence[Named], word: str, floor: Mapping[str, float]) -> list[Advice]:
    if chosen:
        first = state.rounds[0]
        names = (chosen[0].best.tried.effect.name, *chosen[0].equivalent)
        rivals = [next(r for r in first.ranked if r.tried.effect.name == n) for n in names]
        if len(rivals) == 1:
            rivals += [r for r in first.ranked if r.tried.effect.name != names[0]][:1]
        if len(rivals) > 1:
            now = math.sqrt(max(rivals[0].gain - rivals[1].gain, 0.0))
            try:
                return advice.advise(state.context, [r.fit for r in rivals], first.noise_model, floor, now)
            except (ArithmeticError, np.linalg.LinAlgError):
                return []
    if word != "unexplained":
        return []
    text = "repeat one setting three times: what repeats is physics, what does not is chance (now left: "
    return [Advice(text=f"{text}{_where(state)})")]


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
    ranges: Mapping[str, float],
) -> list[Cause]:
    """The causes with the failed samples among them, where their misfit puts them."""
    closing = {s.channel: s for s in causes[0].shrinkage} if causes else {}
    sound = by_channel(nominal, nominal.residuals)
    widened = {}
    for channel in floor:
        squares, count = _failed_squares(state, nominal, raw, channel)
        if not count:
            continue
        own = sound[channel]
        size = ranges[channel]
        before = math.sqrt((float(np.sum(own**2)) + squares) / (len(own) + count)) / size
        known = closing[channel].after if channel in closing else None
        after = _rms(own) / size if known is None else known
        level = floor[channel] / size
        widened[channel] = Shrinkage(
            channel=channel,
            before=before,
            after=after,
            shipped=before,
            floor=level,
            closed=shrinkage.closed(before, after, level),
        )
    stretches = state.dropouts.stretches
    kinds = sorted({kind for *_, kind in stretches})
    samples = sum(int(np.isfinite(y).sum()) for t in raw for y in t.measured.values())
    effect = Cause(
        effect=MarkerDropout.name,
        probability=0.97,
        parameters={
            "failed_share": Value(value=state.dropouts.count / max(samples, 1), unit="1"),
            "first_failure_s": Value(value=min(s[2] for s in stretches), unit="s"),
        },
        stage=MarkerDropout.stage,
        meaning=f"{MarkerDropout.meaning} ({', '.join(kinds)}; in {len({s[0] for s in stretches})} trials)",
        sources=list(MarkerDropout.sources),
        gain=misfit,
    )
    of_all = {
        "shrinkage": [*widened.values(), *(s for c, s in closing.items() if c not in widened)],
        "absorbed": causes[0].absorbed if causes else [],
        "extrapolation": causes[0].extrapolation if causes else [],
    }
    first, *rest = sorted([*causes, effect], key=lambda c: -(c.gain or 0.0))
    bare: dict[str, list[Any]] = {name: [] for name in of_all}
    return [first.model_copy(update=of_all), *(c.model_copy(update=bare) for c in rest)]
