"""Assemble the gap file of a diagnosis (verdict, causes, next experiment) from the fitted hypotheses."""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy import special

from swimid.diagnosis import (
    advice,
    dropouts,
    evidence,
    facts,
    places,
    remainder,
    settings,
    shrinkage,
    verdict,
)
from swimid.diagnosis.candidates import Tried
from swimid.diagnosis.context import FINE, STEPS, Fit, FitContext, covariance, inverted
from swimid.diagnosis.facts import Found, Named, Predictions
from swimid.diagnosis.floor import by_channel, excess, floors, measured, repeats, rms
from swimid.diagnosis.gap_file import (
    Absorbed,
    Advice,
    Cause,
    ChangedValue,
    ChannelGap,
    Distance,
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
from swimid.diagnosis.shrinkage import Piece
from swimid.effects.base import STAGES, Stage
from swimid.effects.sensing import MarkerDropout
from swimid.errors import NoTrustworthyResult
from swimid.fitting.model import Array, Trial
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
    # A measured range of zero is replaced by 1.
    ranges = {c: float(np.ptp(values)) or 1.0 for c, values in measured(context, nominal).items()}
    errors = by_channel(nominal, nominal.residuals)
    if all(rms(left) > shrinkage.ASTRAY * ranges[c] for c, left in errors.items()):
        raise NoTrustworthyResult(
            f"the refitted model is off by more than {shrinkage.ASTRAY:g} times the range of every channel",
            hint="look at the units of the logs, at the drive, and at the coefficients it begins with",
        )
    alike = _alone(state, nominal), _alone(state, state.base)
    drifts = {c: state.low_frequency[c].share for c in remainder.drifting(state.low_frequency)}
    structured = _structured_share(state)
    noise = floors(
        context, state.base, state.nuisance_residuals, structured, alike[1], state.noise_model, drifts
    )
    floor = noise.inside
    failed = dropouts.misfit(state, raw, floor)
    every = _predictions(state, alike, floor, validation, progress)
    held = every
    imitated = facts.by_coefficients(state) and not state.changed
    if state.changed or imitated:
        held = [replace(piece, before=piece.shipped) for piece in every]
    predictions = Predictions.of(state, validation)
    without, with_causes = predictions.total
    chance: Mapping[str, float] = {}
    if state.base.effects and not with_causes.shown:
        # The expected between-trial variation of the held-out trials is used only if the model with the
        # causes predicts these trials. Otherwise a gap could be taken for between-trial variation.
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
    decided = verdict.decide(found.facts)
    named = [c for c in found.causes if c.name in decided.causes]
    base = state.base if named else nominal
    gap = facts.gap_of(state, base)
    left = facts.remaining(state, base, gap, floor)
    if left.share is not None and left.share > verdict.MOST:
        # The remaining gap shows that a cause outside the catalogue acts, so compute the probabilities of the
        # causes under this condition.
        named = [replace(c, probability=state.posterior.beside_outside(*c.alike)) for c in named]
    closed, distance = None, None
    if named:
        closed = verdict.closed_share(found.facts)
        distance = Distance(before=without.times, after=with_causes.times)
    how = noise.how
    if decided.verdict == "none":
        # The residuals are indistinguishable from noise and between-trial variation, so all of them count as
        # noise.
        floor = {c: max(floor[c], rms(v)) for c, v in by_channel(nominal, gap).items()}
        how = "all that the model leaves: noise, and what differs from trial to trial"
    sd = parameter_errors(state, base)
    causes = _causes(state, named, sd, begun.given, closing)
    if failed:
        causes = dropouts.among(state, causes, raw, floor, failed, ranges)
        closed = verdict.over_channels(causes[0].shrinkage)
    scores = _scores(state)
    cells = places.Map(context, nominal, gap, floor)
    where = Where(
        channels=_channels(state, gap, floor, ranges),
        stage=_stages(scores, causes),
        regime=places.regimes(cells),
        time=places.times(cells),
    )
    if decided.verdict != "none":
        where.phase = places.phases(cells)
    file = GapFile(
        verdict=decided.verdict,
        where=where,
        waterfall=_waterfall(state, every, outside, caused=bool(named)),
        closed=closed,
        causes=causes,
        remaining=_remaining(decided.verdict, found, left),
        facts=found.facts,
        setting_count=settings.count([*context.trials, *validation]),
        at_bound=_at_bounds(nominal),
        moved=_moved(state, base, sd, begun.unweighed),
        hypotheses=_hypotheses(state),
        samples=sum(len(r) for r in nominal.residuals) or None,
        tried=state.tried or None,
        held_out=_held_out(context, validation),
        predicted=distance,
        floor_from=how,
        repeats=bool(repeats(context)),
        scores=scores,
        reasons=_reasons(state),
        left_out=dict(state.screen.left_out),
    )
    file.advice = _advice(state, file, named)
    return file, shrinkage.worst(held, levels, with_causes=bool(causes))


def _remaining(decided: Verdict, found: Found, left: Remaining) -> Remaining:
    """Return the remaining gap. All of it remains if the model does not describe some data at all."""
    where = ""
    if decided == "unexplained" and not found.causes and found.facts.unpredicted:
        where = f"validation trials {', '.join(found.facts.unpredicted)}"
    if found.facts.unreproduced:
        where = f"all of {', '.join(found.facts.unreproduced)} but its mean"
    if where:
        return Remaining(share=1.0, where=where, white=False)
    return left


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


def _waterfall(
    state: State, held: Sequence[Piece], floor: Mapping[str, float], *, caused: bool
) -> list[Step]:
    """Return the held-out errors as given, refitted, after each cause in turn, and of the noise alone.

    There are no steps of causes if the answer names none (``caused``).
    """
    labels = ["as given", "refitted"]
    if caused:
        labels += [f"+ {found.ranked[0].tried.effect.name}" for found in state.rounds]
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
    for kind in state.random_effects:
        chance = ""
        if kind.sd > kind.most:
            chance = f", {kind.most:.2g} of it by chance"
        if kind.sd > 0.02:
            differing.append(f"{kind.name} ({kind.sd:.2g} of its typical size{chance})")
    if not differing:
        return []
    return [f"trials differ in {listed(differing)}, which is part of the noise"]


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


def _causes(
    state: State,
    named: Sequence[Named],
    sd: Mapping[str, float],
    given: Mapping[str, Estimate],
    closing: list[Shrinkage],
) -> list[Cause]:
    """Return the causes of the answer. The first one has the held-out errors and the coefficients of all."""
    causes = []
    for c in named:
        effect, parameters = c.best.tried.effect, sizes(state.base, c, sd, given)
        cause = Cause(
            effect=c.name,
            probability=float(np.clip(c.probability, 0.0, 1.0)),
            equivalent=list(c.equivalent),
            parameters=parameters,
            stage=effect.stage,
            meaning=evidence.changes_text(parameters) or effect.meaning,
            sources=list(effect.sources),
            gain=c.best.gain,
            gain_stderr=c.best.stderr,
        )
        causes.append(cause)
    for cause in causes[:1]:
        cause.shrinkage = closing
        cause.absorbed = _absorbed(state, given, sd)
        cause.extrapolation = _extrapolations(state)
    return causes


def _changed(known: Estimate, value: float, stderr: float, unit: str, *, inside: bool) -> ChangedValue:
    """Compare the estimate of a parameter with its value in the parameter file."""
    size = abs(value - known.value) / max(math.hypot(stderr, known.stderr or 0.0), 1e-300)
    changed = ChangedValue(value=value, unit=unit, given=known.value, standard_errors=size, status="at-bound")
    if inside:
        changed.status, changed.stderr = "estimated", stderr
    return changed


def _value(value: float, stderr: float | None, unit: str, *, inside: bool) -> Value:
    """Return an estimate, which has no standard error if it is at a bound."""
    if not inside:
        return Value(value=value, unit=unit, status="at-bound")
    return Value(value=value, stderr=stderr, unit=unit)


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
            inside = base.inside[base.labels.index(name)]
            value, known = base.value(effect.adds_to) + base.value(name), given[effect.adds_to]
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
        at_bound = any(b != p.start and abs(values[0] - b) <= near for b in (p.lower, p.upper))
        found[p.name] = _value(values[0], sd.get(labels[0]), p.unit, inside=not at_bound)
    return found


def _moved(
    state: State, base: Fit, sd: Mapping[str, float], given: Mapping[str, Estimate]
) -> dict[str, ChangedValue]:
    """Return the parameters whose refitted values differ significantly from those of the parameter file.

    The significance level is 5 % (two-sided) for all parameters together (Bonferroni).
    """
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


def _absorbed(state: State, given: Mapping[str, Estimate], sd: Mapping[str, float]) -> list[Absorbed]:
    """Return the values of the coefficients as given, and refitted without and with the causes."""
    nominal, base = state.nominal, state.base
    plain = parameter_errors(state, nominal)
    # A changed parameter is a cause itself, so it is not listed as a coefficient that absorbed a cause.
    causes = {e.adds_to for e in base.effects}
    found = []
    for p in state.context.parameters:
        if p.per_trial or p.name not in nominal.labels or p.name in causes:
            continue
        values = [
            _value(fit.value(p.name), errors.get(p.name), p.unit, inside=fit.inside[fit.labels.index(p.name)])
            for fit, errors in ((nominal, plain), (base, sd))
        ]
        one = Absorbed(coefficient=p.name, without=values[0], with_effect=values[1])
        if p.name in given:
            known = given[p.name]
            one.given = Value(value=known.value, stderr=known.stderr, unit=p.unit, status=known.status)
        found.append(one)
    return found


def _extrapolations(state: State) -> dict[str, Distance]:
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
            fits = (state.nominal, state.base)
            folds = [shrinkage.predictions(cut, fit, state.noise_model, ())[0] for fit in fits]
            before, after = (each["fold 2"].times for each in folds)
            found[f"{kind} {label}"] = Distance(before=before, after=after)
    return found


def _advice(state: State, file: GapFile, named: Sequence[Named]) -> list[Advice]:
    """Return the proposed next experiments of an answer with these causes."""
    if file.verdict == "none":
        if all(check.verdict != "warn" for check in evidence.checks(file)):
            return []
        text = ANOTHER if file.setting_count == 1 else REPEAT
        return [Advice(text=text)]
    repeat = [Advice(text=f"{REPEAT} (now left: {file.remaining.where})")]
    for trial in file.facts.odd_trial:
        text = f"check the entry of {trial}; diagnose without it (role: validate)"
        return [Advice(text=text), *repeat]
    if file.verdict == "unexplained" and file.facts.unpredicted:
        trials = ", ".join(file.facts.unpredicted)
        return [Advice(text=f"fit {trials}, too (role: fit): what acts there alone shows nowhere else")]
    rivals = []
    if named:
        found = next(r for r in state.rounds if r.ranked[0] is named[0].best)
        # No experiment distinguishes a changed parameter from an effect that changes the trials in the same
        # way.
        ranked = [r for r in found.ranked if r.tried.effect.name not in found.same]
        rivals = [r for r in ranked if r.tried.effect.name in named[0].alike]
        if len(rivals) == 1:
            rivals = ranked[:2]
    if len(rivals) < 2 and file.verdict == "unexplained":
        return repeat
    if len(rivals) < 2 or state.limits is None:
        return []
    now = math.sqrt(max(rivals[0].gain - rivals[1].gain, 0.0))
    fits = [r.fit for r in rivals]
    if len(named[0].alike) == 1 and now > advice.threshold(fits):
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
    for r in state.singles:
        having = state.posterior.having(r.tried.effect.name)
        row = _score(r.tried, gain=r.gain, stderr=r.stderr, probability=having)
        rows.setdefault(row.effect, row)
    for tried in state.screen.tried:
        rows.setdefault(tried.effect.name, _score(tried))
    return list(rows.values())


def _score(tried: Tried, **fitted: float) -> Score:
    effect, variant = tried.effect, ", ".join(p.name for p in tried.parameters)
    return Score(effect=effect.name, stage=effect.stage, variant=variant, absorbed=tried.absorbed, **fitted)


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


def _stages(rows: Sequence[Score], causes: Sequence[Cause]) -> dict[Stage, float | None]:
    """Return the probability that the cause of the gap acts in each simulation stage.

    It is the sum of the probabilities of the effects of the stage, normalised over all stages. It is 1 for
    the stage of failed samples, if they are the first cause. Without causes, all of these probabilities are
    0.
    """
    applied = {row.stage for row in rows}
    stages = [stage for stage in STAGES if stage != "rig" or "rig" in applied]
    sums = {stage: sum(row.probability or 0.0 for row in rows if row.stage == stage) for stage in stages}
    if causes and causes[0].effect == MarkerDropout.name:
        sums = {stage: float(stage == MarkerDropout.stage) for stage in stages}
    total = sum(sums.values())
    if not causes or total <= 0:
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
    of a sandwich estimate with correlated residuals and the same priors.
    """
    sums = {e.name: (e.adds_to, f"{e.name}/change") for e in fit.effects if e.adds_to is not None}
    # Each row of the matrix selects one parameter, or sums a model parameter and its change.
    rows = [np.isin(fit.labels, parts) for parts in sums.values()]
    combined = np.vstack((np.eye(len(fit.labels)), *rows))

    def errors(covariance: Array) -> Array:
        variance = np.einsum("ij,jk,ik->i", combined, covariance, combined)
        return np.asarray(np.sqrt(np.maximum(variance, 0.0)))

    precision = state.context.precision(fit.problem)
    sd = errors(covariance(fit, state.noise_model, precision))
    if state.noise_model.long_memory is not None:
        scale = fit.problem.scale
        colour = coloured(fit.problem, fit.residuals, NoiseModel(state.noise_model.sd)).colour
        derivatives = [r * scale for r in fit.rows]
        root = sandwich(fit.problem, derivatives, list(fit.residuals), dict(colour)).root / scale
        sd = np.fmax(sd, errors(inverted(precision + root.T @ root)))
    return dict(zip([*fit.labels, *sums], sd, strict=True))
