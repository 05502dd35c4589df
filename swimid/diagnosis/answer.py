"""Assemble the gap file of a diagnosis (verdict, causes, next experiment) from the fitted hypotheses."""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import special

from swimid.diagnosis import (
    advice,
    crossval,
    dropouts,
    evidence,
    facts,
    places,
    remainder,
    settings,
    shrinkage,
    verdict,
)
from swimid.diagnosis.candidates import Refitted, Tried
from swimid.diagnosis.context import FINE, STEPS, Fit, FitContext, covariance
from swimid.diagnosis.facts import Found, Named, Predictions
from swimid.diagnosis.floor import by_channel, excess, floors, measured, repeats, rms
from swimid.diagnosis.gap_file import (
    Absorbed,
    Advice,
    Cause,
    ChangedValue,
    ChannelGap,
    Closed,
    Distance,
    Facts,
    GapFile,
    HeldOut,
    Hypothesis,
    Remaining,
    Score,
    Shrinkage,
    Step,
    Value,
    Verdict,
    Where,
)
from swimid.diagnosis.noise_model import NoiseModel, coloured
from swimid.diagnosis.nominal import Begun
from swimid.diagnosis.search import State
from swimid.diagnosis.settings import Folds
from swimid.diagnosis.shrinkage import Misfit, Piece
from swimid.effects.base import STAGES, Stage
from swimid.effects.sensing import MarkerDropout
from swimid.errors import NoTrustworthyResult
from swimid.fitting.model import Array, Parameter, Trial
from swimid.fitting.uncertainty import sandwich
from swimid.notices import Progress, silent
from swimid.results.numbers import listed
from swimid.results.parameters import Estimate

#: Significance level of the two-sided test that reports parameters as changed by a refit. It applies to all
#: parameters of a diagnosis together.
MOVED = 0.05
#: Standard deviation of the prior that holds a parameter at its given value, in units of the parameter's
#: typical scale.
PINNED = 1e-6
#: Texts that advise the user to record trials at another setting (ANOTHER), or to repeat a setting (REPEAT).
ANOTHER = "run another setting: what coefficients imitate at one they do not imitate at all"
REPEAT = "repeat one setting three times: what repeats is physics, what does not is chance"


def answer(
    state: State,
    validation: Sequence[Trial],
    begun: Begun,
    raw: Sequence[Trial],
    *,
    progress: Progress = silent,
) -> tuple[GapFile, list[Piece]]:
    """Return the gap file of a diagnosis, and the held-out trial with the largest errors.

    Parameters
    ----------
    validation : sequence of Trial
        Trials that no fit uses.
    begun : Begun
        Parameters of the parameter file, and those whose change is not a hypothesis.
    raw : sequence of Trial
        The fitted trials, failed samples included.

    Returns
    -------
    GapFile
        The caller adds the names of the model, the robot, the experiment, the parameter file and the trials.
    list of Piece
        Measured and simulated samples of this held-out trial.

    Raises
    ------
    NoTrustworthyResult
        If the refitted model cannot simulate these trials.
    """
    context = state.context
    if state.changed:
        # If a changed parameter is among the causes, measure the gap with the parameter values as given.
        state.nominal = _as_given(state)
    nominal = state.nominal
    ranges = _ranges(context, nominal)
    errors = {c: rms(left) for c, left in by_channel(nominal, nominal.residuals).items()}
    if all(size > shrinkage.ASTRAY * ranges[c] for c, size in errors.items()):
        raise NoTrustworthyResult(
            f"the refitted model is off by more than {shrinkage.ASTRAY:g} times the range of every channel",
            hint="look at the units of the logs, at the drive, and at the coefficients it begins with",
        )
    alike = _alone(state, nominal), _alone(state, state.base)
    share = _structured_share(state)
    drifts = {c: state.low_frequency[c].share for c in remainder.drifting(state.low_frequency)}
    noise = floors(context, state.base, state.nuisance_residuals, share, alike[1], state.noise_model).less(
        drifts
    )
    floor = noise.inside
    failed = dropouts.misfit(state, raw, floor)
    every = _predictions(state, alike, floor, validation, progress)
    held = every
    imitated = facts.by_coefficients(state) and not state.changed
    if state.changed or imitated:
        held = [replace(piece, before=piece.shipped) for piece in every]
    predictions = Predictions.of(state, validation)
    distance = None
    chance: Mapping[str, float] = {}
    if state.base.effects:
        without, with_causes = predictions.total
        distance = Distance(before=without.times, after=with_causes.times)
        # The expected between-trial variation of the held-out trials is used only if the model with the
        # causes predicts these trials. Otherwise a gap could be taken for between-trial variation.
        if not with_causes.shown:
            chance = with_causes.chance
    # The floor in ``noise.levels`` is increased for the noise that fitted parameters absorb. If the residuals
    # have structure, this increase would include absorbed structure, so the floor without it is used.
    levels = noise.of_held_out(chance)
    reached = levels
    if state.left is not None and state.left.found:
        reached = floor
    outside = shrinkage.capped(reached, held)
    closing = shrinkage.shrinkages(held, outside, noise.of_trials, ranges)
    found = facts.find(state, held, noise, outside, predictions, imitated=imitated, dropout=failed > 0)
    told = Told.of(state, found, noise.inside)
    closed: Closed | None = verdict.closed_share(found.facts)
    if not told.causes:
        distance = closed = None
    how = noise.how
    if told.verdict == "none":
        # The residuals are indistinguishable from noise and between-trial variation, so all of them count as
        # noise.
        floor = {c: max(floor[c], rms(v)) for c, v in by_channel(nominal, told.gap).items()}
        how = "all that the model leaves: noise, and what differs from trial to trial"
    rows = _scores(state)
    stages = _stages(rows, gap=bool(told.causes))
    causes = _causes(state, told, begun.given, closing)
    if failed:
        causes = dropouts.among(state, causes, raw, floor, failed, ranges)
        closed = verdict.over_channels(causes[0].shrinkage)
        if causes[0].effect == MarkerDropout.name:
            stages = {k: float(k == "sensing") for k in stages}
    cells = places.Map(context, nominal, told.gap, floor)
    where = Where(
        channels=_channels(state, told.gap, floor, ranges),
        stage=stages,
        regime=places.regimes(cells),
        time=places.times(cells),
    )
    if told.verdict != "none":
        where.phase = places.phases(cells)
    file = GapFile(
        verdict=told.verdict,
        where=where,
        waterfall=_waterfall(state, told, every, outside),
        closed=closed,
        causes=causes,
        remaining=told.left,
        advice=_advice(state, told),
        facts=found.facts,
        setting_count=settings.count([*context.trials, *validation]),
        at_bound=_at_bounds(nominal),
        moved=_moved(state, told.base, begun.unweighed),
        hypotheses=_hypotheses(state),
        samples=sum(len(r) for r in nominal.residuals) or None,
        tried=state.tried or None,
        held_out=_held_out(context, validation),
        predicted=distance,
        floor_from=how,
        repeats=bool(repeats(context)),
        scores=rows,
        reasons=_reasons(state),
        left_out=dict(state.screen.left_out),
    )
    if file.verdict == "none" and any(check.verdict == "warn" for check in evidence.checks(file)):
        file.advice = [Advice(text=REPEAT)]
        if file.setting_count == 1:
            file.advice = [Advice(text=ANOTHER)]
    return file, shrinkage.worst(held, levels, with_causes=bool(causes))


@dataclass(frozen=True)
class Told:
    """Answer of a diagnosis: its verdict, its causes, and the model with these causes.

    Attributes
    ----------
    causes : tuple of Named
        Causes that the answer states.
    base : Fit
        The model with these causes; without causes, the model without effects.
    gap : list of ndarray, shape (n_k,)
        The gap of each trial (:func:`swimid.diagnosis.facts.gap_of`).
    left : Remaining
        Part of the gap that the causes do not close.
    """

    verdict: Verdict
    facts: Facts
    causes: tuple[Named, ...]
    base: Fit
    gap: list[Array]
    left: Remaining

    @classmethod
    def of(cls, state: State, found: Found, floor: Mapping[str, float]) -> Told:
        """Return the answer that follows from the facts."""
        decided = verdict.decide(found.facts)
        causes = tuple(c for c in found.causes if c.name in decided.causes)
        base = state.nominal
        if causes:
            base = state.base
        gap = facts.gap_of(state, base)
        left = facts.remaining(state, base, gap, floor)
        if left.share is not None and left.share > verdict.MOST:
            # The remaining gap shows that a cause outside the catalogue acts, so compute the probabilities of
            # the causes under this condition.
            beside = state.posterior.beside_outside
            causes = tuple(replace(c, probability=beside(*c.alike)) for c in causes)
        known = found.facts
        if decided.verdict == "unexplained" and not found.causes and known.unpredicted:
            where = f"validation trials {', '.join(known.unpredicted)}"
            left = Remaining(share=1.0, where=where, white=False)
        if known.unreproduced:
            where = f"all of {', '.join(known.unreproduced)} but its mean"
            left = Remaining(share=1.0, where=where, white=False)
        return cls(decided.verdict, known, causes, base, gap, left)


def _predictions(
    state: State,
    alike: tuple[Fit, Fit],
    floor: Mapping[str, float],
    validation: Sequence[Trial],
    progress: Progress,
) -> list[Piece]:
    """Return the held-out samples, with the predictions of the models without and with the causes.

    A random effect may absorb a cause, and a cause may absorb between-trial variation. Each model is
    therefore fitted with and without random effects, and the fits that predict held-out data better are used.

    Parameters
    ----------
    alike : tuple of Fit
        The models without and with the causes, fitted without random effects.
    """
    context = state.context
    fits = [[alike[0], *(_alone(state, fit) for fit in state.between), alike[1]]]
    if state.noise_model.random_effects:
        fits.insert(0, [state.nominal, *state.between, state.base])
    shipped = {p.name: p.start for p in context.parameters if not p.per_trial}
    total = len(validation) or context.folds.count
    with progress("held-out trials", total=len(fits) * total) as step:
        found = [
            shrinkage.pieces(
                context, models, state.noise_model, floor, shipped, validation, step=lambda: step(1)
            )
            for models in fits
        ]
    best = shrinkage.better(found, floor)
    for models, one in zip(fits, found, strict=True):
        if one and one[0].after is best[0].after:
            state.predictive = models[-1]
    return best


def _waterfall(state: State, told: Told, held: Sequence[Piece], floor: Mapping[str, float]) -> list[Step]:
    """Return the held-out errors as given, refitted, after each cause in turn, and of the noise alone."""
    causes = [found.ranked[0].tried.effect.name for found in state.rounds]
    labels = ["as given", "refitted", *(f"+ {name}" for name in causes)]
    if not told.causes or told.base is not state.base:
        # The answer names no effect, or held-out data or an outlier trial contradict the effects.
        labels = labels[:2]
    steps = shrinkage.waterfall(held, floor, labels)
    if state.changed:
        # The other parameters are not refitted beside a changed parameter.
        del steps[1]
    return steps


def _held_out(context: FitContext, validation: Sequence[Trial]) -> HeldOut:
    """Return which data are held out: validation trials, whole fitted trials, or segments of them."""
    if validation:
        return "validation"
    if context.folds.whole:
        return "trials"
    return "stretches"


def _as_given(state: State) -> Fit:
    """Return a fit of the per-trial parameters only. All shared parameters keep their given values."""
    context, noise_model = state.context, state.noise_model
    problem = context.problem((), noise_model.random_effects)
    noise_model.install(problem)
    mean, weight = context.expected(problem)
    start = context.start((), noise_model, state.nominal)
    for j, (_, owner) in enumerate(problem.slots):
        if owner is None:
            start[j] = mean[j] = problem.start[j]
            weight[j] = 1.0 / (PINNED * problem.scale[j])
    root = np.diag(weight)[weight > 0]
    found = context.search(problem, noise_model, [start], FINE, STEPS, (mean, root))
    return context.at((), noise_model, found.x)


def _alone(state: State, fit: Fit) -> Fit:
    """Refit a model without random effects, which may have absorbed a cause."""
    if not state.noise_model.random_effects:
        return fit
    context, noise_model = state.context, replace(state.noise_model, random_effects=())
    begin = context.start(fit.effects, noise_model, fit)
    starts = context.begins(context.problem(fit.effects), begin)
    return context.fit(fit.effects, noise_model, starts, tolerance=FINE)


def _reasons(state: State) -> list[str]:
    differing = []
    for kind in (kind for kind in state.random_effects if kind.sd > 0.02):
        chance = ""
        if kind.sd > kind.most:
            chance = f", {kind.most:.2g} of it by chance"
        differing.append(f"{kind.name} ({kind.sd:.2g} of its typical size{chance})")
    if not differing:
        return []
    return [f"trials differ in {listed(differing)}, which is part of the noise"]


def _ranges(context: FitContext, nominal: Fit) -> dict[str, float]:
    """Return the measured range of each channel over the fitted trials, in the channel's unit.

    A range of zero is replaced by 1.
    """
    return {c: float(np.ptp(values)) or 1.0 for c, values in measured(context, nominal).items()}


def _channels(
    state: State, residuals: Sequence[Array], floor: Mapping[str, float], ranges: Mapping[str, float]
) -> list[ChannelGap]:
    nominal, units = state.nominal, {c.name: c.unit for c in state.context.model.channels}
    beyond = excess(nominal, residuals, floor)
    total = sum(beyond.values()) or 1.0
    within = by_channel(nominal, nominal.residuals)
    return [
        ChannelGap(
            channel=channel,
            nrmse=rms(left) / ranges[channel],
            floor=floor[channel] / ranges[channel],
            share=beyond[channel] / total,
            rmse=rms(left),
            unit=units.get(channel, "1"),
            within=rms(within[channel]) / ranges[channel],
        )
        for channel, left in by_channel(nominal, residuals).items()
    ]


def _causes(state: State, told: Told, given: Mapping[str, Estimate], closing: list[Shrinkage]) -> list[Cause]:
    if not told.causes:
        return []
    sd = parameter_errors(state, told.base)
    estimated = [sizes(told.base, c, sd, given) for c in told.causes]
    causes = [
        Cause(
            effect=c.best.tried.effect.name,
            probability=float(np.clip(c.probability, 0.0, 1.0)),
            equivalent=list(c.equivalent),
            parameters=parameters,
            stage=c.best.tried.effect.stage,
            meaning=evidence.changes_text(parameters) or c.best.tried.effect.meaning,
            sources=list(c.best.tried.effect.sources),
            gain=c.best.gain,
            gain_stderr=c.best.stderr,
        )
        for c, parameters in zip(told.causes, estimated, strict=True)
    ]
    first = {
        "shrinkage": closing,
        "absorbed": _absorbed(state, told.base, given, sd),
        "extrapolation": _extrapolations(state, told.base),
    }
    return [causes[0].model_copy(update=first), *causes[1:]]


def _changed(known: Estimate, value: float, stderr: float, unit: str, *, inside: bool) -> ChangedValue:
    """Compare the estimate of a parameter with its value in the parameter file."""
    size = abs(value - known.value) / max(math.hypot(stderr, known.stderr or 0.0), 1e-300)
    changed = ChangedValue(value=value, unit=unit, given=known.value, standard_errors=size, status="at-bound")
    if inside:
        changed.status, changed.stderr = "estimated", stderr
    return changed


def sizes(
    base: Fit, cause: Named, sd: Mapping[str, float], given: Mapping[str, Estimate]
) -> dict[str, ChangedValue | Value]:
    """Return the estimated parameters of a cause, by name.

    A parameter with a separate value for each trial is reported as the root mean square of these values.
    """
    effect = cause.best.tried.effect
    found: dict[str, ChangedValue | Value] = {}
    for p in cause.best.tried.parameters:
        name = f"{effect.name}/{p.name}"
        if effect.adds_to is not None:
            value, inside = (
                base.value(effect.adds_to) + base.value(name),
                base.inside[base.labels.index(name)],
            )
            known = given[effect.adds_to]
            found[effect.adds_to] = _changed(known, value, sd[effect.name], p.unit, inside=inside)
            continue
        labels = [n for n in base.labels if n.split("[")[0] == name]
        values = [base.value(n) for n in labels]
        if not values:
            continue
        if p.per_trial:
            found[f"{p.name}_rms"] = Value(value=rms(np.array(values)), unit=p.unit)
            continue
        # An estimate that is less than its standard error away from a bound counts as at the bound. This does
        # not apply to a bound that equals the null value of the effect.
        near = sd.get(labels[0], 0.0)
        if any(b != p.start and abs(values[0] - b) <= near for b in (p.lower, p.upper)):
            found[p.name] = Value(value=values[0], unit=p.unit, status="at-bound")
        else:
            found[p.name] = Value(value=values[0], stderr=sd.get(labels[0]), unit=p.unit)
    return found


def _moved(state: State, base: Fit, given: Mapping[str, Estimate]) -> dict[str, ChangedValue]:
    """Return the parameters whose refitted values differ significantly from those of the parameter file.

    The significance level is 5 % (two-sided) for all parameters together (Bonferroni).
    """
    sd = parameter_errors(state, base)
    inside = dict(zip(base.labels, base.inside, strict=True))
    names = [p for p in state.context.parameters if p.name in given and inside.get(p.name)]
    limit = -float(special.ndtri(0.5 * MOVED / max(len(names), 1)))
    found = {}
    for p in names:
        change = _changed(given[p.name], base.value(p.name), sd[p.name], p.unit, inside=True)
        if (change.standard_errors or 0.0) > limit:
            found[p.name] = change
    return found


def _at_bounds(fit: Fit) -> dict[str, float]:
    """Return the shared coefficients of the model that are at a bound, with the value of the bound."""
    ends = zip(fit.labels, fit.theta, fit.inside, strict=True)
    return {label: float(value) for label, value, inside in ends if not inside and "[" not in label}


def _absorbed(
    state: State, base: Fit, given: Mapping[str, Estimate], sd: Mapping[str, float]
) -> list[Absorbed]:
    nominal = state.nominal
    plain = parameter_errors(state, nominal)
    # A changed parameter is a cause itself, so it is not listed as a coefficient that absorbed a cause.
    causes = {e.adds_to for e in base.effects}
    found = []
    for p in state.context.parameters:
        if p.per_trial or p.name not in nominal.labels or p.name in causes:
            continue
        values = [_estimate(fit, p, errors) for fit, errors in ((nominal, plain), (base, sd))]
        one = Absorbed(coefficient=p.name, without=values[0], with_effect=values[1])
        if p.name in given:
            known = given[p.name]
            one.given = Value(value=known.value, stderr=known.stderr, unit=p.unit, status=known.status)
        found.append(one)
    return found


def _estimate(fit: Fit, p: Parameter, errors: Mapping[str, float]) -> Value:
    value = fit.value(p.name)
    if not fit.inside[fit.labels.index(p.name)]:
        return Value(value=value, unit=p.unit, status="at-bound")
    return Value(value=value, stderr=errors.get(p.name), unit=p.unit)


def _extrapolations(state: State, base: Fit) -> dict[str, Distance]:
    """Return the errors in predicting the extreme settings, for the models without and with the causes.

    The extreme settings are the highest and the lowest frequency, amplitude and force. The trials at each of
    them are predicted by a fit to all other trials.
    """
    context = state.context
    if not context.folds.whole:
        return {}
    known = [settings.words(t) for t in context.trials]
    found = {}
    for kind in ("frequency", "amplitude", "force"):
        labels = [words.get(kind, "") for words in known]
        levels = sorted({*labels} - {""}, key=lambda text: float(text.split()[0]))
        if len(levels) <= 2:
            continue
        for label in (levels[-1], levels[0]):
            parts = zip(labels, context.folds.owner, strict=True)
            cut = copy.copy(context)
            cut.folds = Folds(True, [np.full(len(rows), int(own == label)) for own, rows in parts], 2)
            times = []
            for fit in (state.nominal, base):
                inner = crossval.normal_equations(cut, fit, state.noise_model)
                times.append(Misfit(float(crossval.predictive(inner)[1]), int(inner.samples[1])).times)
            found[f"{kind} {label}"] = Distance(before=times[0], after=times[1])
    return found


def _advice(state: State, told: Told) -> list[Advice]:
    repeat = [Advice(text=f"{REPEAT} (now left: {told.left.where})")]
    for trial in told.facts.odd_trial:
        text = f"check the entry of {trial}; diagnose without it (role: validate)"
        return [Advice(text=text), *repeat]
    if told.verdict == "unexplained" and told.facts.unpredicted:
        trials = ", ".join(told.facts.unpredicted)
        return [Advice(text=f"fit {trials}, too (role: fit): what acts there alone shows nowhere else")]
    rivals = []
    if told.causes:
        found = next(r for r in state.rounds if r.ranked[0] is told.causes[0].best)
        # No experiment distinguishes a changed parameter from an effect that changes the trials in the same
        # way.
        ranked = [r for r in found.ranked if r.tried.effect.name not in found.same]
        rivals = [r for r in ranked if r.tried.effect.name in told.causes[0].alike]
        if len(rivals) == 1:
            rivals = ranked[:2]
    if len(rivals) < 2 and told.verdict == "unexplained":
        return repeat
    if len(rivals) < 2 or state.limits is None:
        return []
    now = math.sqrt(max(rivals[0].gain - rivals[1].gain, 0.0))
    fits = [r.fit for r in rivals]
    if len(told.causes[0].alike) == 1 and now > advice.threshold(fits):
        # The present trials already exclude the next best rival.
        return []
    try:
        return advice.advise(state.context, fits, state.noise_model, state.limits, now)
    except (ArithmeticError, np.linalg.LinAlgError):
        return []


def _scores(state: State) -> list[Score]:
    """Return the score of each candidate effect.

    The score comes from the fit with this effect only. If the effect was not fitted, the score comes from the
    screening.
    """
    rows: dict[str, Score] = {}
    refitted: list[tuple[Tried, Refitted | None]] = [(r.tried, r) for r in state.singles]
    for tried, found in [*refitted, *((t, None) for t in state.screen.tried)]:
        name, gains = tried.effect.name, {}
        if found is not None:
            gains = {"gain": found.gain, "stderr": found.stderr, "probability": state.posterior.having(name)}
        row = Score(
            effect=name,
            stage=tried.effect.stage,
            variant=", ".join(p.name for p in tried.parameters),
            absorbed=tried.absorbed,
            **gains,
        )
        rows.setdefault(name, row)
    return list(rows.values())


def _hypotheses(state: State) -> list[Hypothesis]:
    """Return every fitted hypothesis with its probability. The model without effects comes first."""
    found = state.posterior
    return [
        Hypothesis(
            effects=sorted(c.names),
            numbers=c.numbers,
            score=c.score,
            slow=c.slow,
            alike=dict(c.alike),
            folds=c.folds.tolist(),
            probability=found.sets.get(c.names, found.none),
        )
        for c in found.candidates
    ]


def _stages(rows: Sequence[Score], *, gap: bool) -> dict[Stage, float | None]:
    """Return the probability that the cause of the gap acts in each simulation stage.

    It is the sum of the probabilities of the effects of the stage, normalised over all stages. If there is no
    gap, all of these probabilities are 0.
    """
    applied = {row.stage for row in rows}
    stages = [stage for stage in STAGES if stage != "rig" or "rig" in applied]
    sums = {stage: sum(row.probability or 0.0 for row in rows if row.stage == stage) for stage in stages}
    total = sum(sums.values())
    if not gap or total <= 0:
        return dict.fromkeys(stages, 0.0)
    return {stage: v / total for stage, v in sums.items()}


def _structured_share(state: State) -> float:
    """Return the fraction of the squared residuals that generic smooth terms without physics explain.

    The residuals are those of the model with the causes, whitened.
    """
    left = state.left
    if left is None or not left.found:
        return 0.0
    whole = sum(
        float(np.sum(state.noise_model.whiten(state.base.problem, k, r) ** 2))
        for k, r in enumerate(state.base.residuals)
    )
    return float(np.clip(left.gain / max(whole, 1e-300), 0.0, 1.0))


def parameter_errors(state: State, fit: Fit) -> Mapping[str, float]:
    """Return the standard errors of the parameters of a fit, by label.

    The sum of a model parameter and its change has a standard error of its own, labelled with the name of the
    effect. If a few trials do not determine the memory of the noise, the standard errors are at least those
    of a sandwich estimate with correlated residuals.
    """
    # Each row of the matrix selects one parameter, or sums a model parameter and its change.
    names, rows = list(fit.labels), list(np.eye(len(fit.labels)))
    for effect in fit.effects:
        if effect.adds_to is not None:
            parts = (effect.adds_to, f"{effect.name}/change")
            names.append(effect.name)
            rows.append(np.isin(fit.labels, parts).astype(float))
    combined = np.array(rows)

    def errors(covariance: Array) -> Array:
        variance = np.einsum("ij,jk,ik->i", combined, covariance, combined)
        return np.asarray(np.sqrt(np.maximum(variance, 0.0)))

    sd = errors(covariance(fit, state.noise_model, state.context.precision(fit.problem)))
    if state.noise_model.long_memory is not None:
        scale = fit.problem.scale
        colour = coloured(fit.problem, fit.residuals, NoiseModel(state.noise_model.sd)).colour
        derivatives = [r * scale for r in fit.rows]
        robust = sandwich(fit.problem, derivatives, list(fit.residuals), dict(colour)).covariance
        sd = np.fmax(sd, errors(scale[:, None] * robust * scale))
    return dict(zip(names, sd, strict=True))
