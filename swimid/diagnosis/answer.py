"""Assemble the gap file of a diagnosis (verdict, causes, next experiment) from the fitted hypotheses."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from scipy import special

from swimid.blackbox import model as arx
from swimid.diagnosis import crossval, dropouts, evidence, held_out, places, proposals, settings, verdict
from swimid.diagnosis.gap_file import (
    Absorbed,
    Advice,
    Cause,
    ChangedValue,
    EffectRow,
    Facts,
    GapFile,
    HeldOut,
    HypothesisRow,
    Proposed,
    Remaining,
    Shrinkage,
    Value,
)
from swimid.diagnosis.held_out import HeldOutSeries, Prediction
from swimid.diagnosis.noise import NoiseModel
from swimid.diagnosis.nominal import Preparation
from swimid.diagnosis.proposals import TrialLimits
from swimid.diagnosis.screening import Screening
from swimid.diagnosis.search import CauseComparison, SearchResult
from swimid.diagnosis.study import GapStudy, Hypothesis
from swimid.effects.base import STAGES, Stage
from swimid.effects.sensing import MarkerDropout
from swimid.errors import NoTrustworthyResult
from swimid.fitting.model import Trial
from swimid.notices import Progress, silent
from swimid.results.evidence import compute_rms
from swimid.results.numbers import join_names
from swimid.results.parameters import Estimate

#: Significance level of the two-sided test that reports parameters as changed by a refit. It applies to all
#: parameters of a diagnosis together.
CHANGE_P_VALUE = 0.05
#: Minimum total probability of a reported cause and its equivalents (effects that the trials cannot
#: distinguish from the cause). Equivalents are added in the order of decreasing probability until their sum
#: reaches this minimum.
MIN_EQUIVALENT_PROBABILITY = 0.9
#: Maximum number of effects that are reported for one cause: the cause and its equivalents. If there are
#: more, the most probable ones are listed.
MAX_EQUIVALENTS = 3
#: Error of a simulation, divided by the measured range of the channel, above which the refitted model is
#: useless.
MAX_RELATIVE_ERROR = 10.0
#: Texts that advise the user to record trials at another setting (ANOTHER), or to repeat a setting (REPEAT).
ANOTHER = "run another setting: coefficients that imitate an effect at one setting do not do so at others"
REPEAT = "repeat one setting three times: repeats separate a missing effect from differences between trials"


def propose_cause(search: SearchResult, found: CauseComparison) -> Proposed:
    """Return a cause that the fits propose, with the effects that the trials cannot distinguish from it."""
    name, fit = found.name, search.base
    share = search.posterior.instead(name, fit.names)
    order = [name, *(n for n in share if n != name)]
    before = np.cumsum([0.0, *(share.get(n, 0.0) for n in order[:-1])])
    alike = [n for n, total in zip(order, before, strict=True) if total < MIN_EQUIVALENT_PROBABILITY]
    return Proposed(
        equivalent=list(dict.fromkeys([name, *found.same, *alike]))[1:MAX_EQUIVALENTS],
        alone=share.get(name, 0.0) + sum(share.get(n, 0.0) for n in found.same),
        crowded=len(alike) > MAX_EQUIVALENTS,
        per_trial=any(p.per_trial for p in found.ranked[0].last_screening.parameters),
        at_bound=any(n.rpartition("/")[0] == name and not fit.is_inside(n) for n in fit.labels),
    )


def answer(
    search: SearchResult,
    validation: Sequence[Trial],
    begun: Preparation,
    raw: Sequence[Trial],
    *,
    limits: TrialLimits,
    progress: Progress = silent,
) -> tuple[GapFile, list[HeldOutSeries]]:
    """Return the gap file of a diagnosis, and the held-out trial with the largest errors.

    Parameters
    ----------
    validation : sequence of Trial
        Trials that no fit uses.
    begun : Preparation
        Parameters of the parameter file, and those whose change is not a hypothesis.
    raw : sequence of Trial
        The fitted trials, failed samples included.
    limits : TrialLimits
        Limits of a proposed trial.

    Returns
    -------
    GapFile
        The caller adds the names of the model, the robot, the experiment, the parameter file and the trials.
    list of HeldOutSeries
        Measured and simulated samples of this held-out trial.

    Raises
    ------
    NoTrustworthyResult
        If the refitted model cannot simulate these trials.
    """
    study, null = search.study, search.null
    ranges = _compute_ranges(null)
    floor = places.compute_floors(study, search.base)
    raw = [trial for trial in raw if trial.id not in search.odd_trials]
    failed = dropouts.compute_misfit(search, raw, floor)
    validation = _remove_failed(search.base, validation, study.noise)
    fits, predictions = _predictions(search, validation, progress)
    facts = _collect_facts(search, predictions, failed)
    ends = predictions[0], predictions[1], predictions[-1 if facts.proposed else 1]
    decided = verdict.decide(facts)
    shown = [c for c in search.comparisons if c.name in decided.causes]
    base = search.base if shown else null
    sd = compute_stderr(study, base)
    closing = held_out.compute_shrinkages(*ends, floor, ranges)
    causes = _causes(search, shown, facts, sd, begun.given, closing)
    if failed:
        causes = dropouts.add_failed_samples(search, causes, raw, floor, failed, ranges)
    scores = _scores(search)
    where = places.locate_gap(study, null, floor, ranges)
    where.stage = _stages(scores, causes)
    if decided.verdict == "none":
        where.phase = []
    labels, closed = ["as given", "refitted"], None
    if shown:
        labels += [f"+ {c.name}" for c in search.comparisons]
        closed = held_out.compute_closed(fits[0], null, search.base, validation, study.noise, ends)
    file = GapFile(
        verdict=decided.verdict,
        where=where,
        waterfall=held_out.build_waterfall(dict(zip(labels, predictions, strict=False)), floor),
        closed=closed,
        causes=causes,
        remaining=_remaining(search, facts, named=bool(shown)),
        facts=facts,
        setting_count=settings.count_settings([*study.trials, *validation]),
        at_bound=_list_bounds(null),
        moved=_list_moved(search, base, sd, begun.unweighed),
        hypotheses=_hypotheses(search),
        samples=sum(len(r) for r in null.residuals) or None,
        tried=search.count,
        held_out=_name_held_out(study, validation),
        floor_from=_floor_text(study.noise),
        odd_trials=search.odd_trials,
        random_effects={effect.name: effect.sd for effect in study.noise.random_effects},
        scores=scores,
        reasons=_reasons(study.noise),
        left_out=dict(search.left_out),
    )
    file.advice = _advice(search, file, shown, limits)
    return file, held_out.select_worst(*ends[1:])


def _compute_ranges(null: Hypothesis) -> dict[str, float]:
    """Return the measured range of each channel; 1 in place of 0.

    Raises
    ------
    NoTrustworthyResult
        If the refitted model cannot simulate the trials.
    """
    ranges = {c: float(np.ptp(values)) or 1.0 for c, values in null.collect_measured().items()}
    if all(compute_rms(left) > MAX_RELATIVE_ERROR * ranges[c] for c, left in null.by_channel().items()):
        raise NoTrustworthyResult(
            f"the refitted model has residuals above {MAX_RELATIVE_ERROR:g} times the range in all channels",
            hint="check the units of the logs, the drive, and the start values of the coefficients",
        )
    return ranges


def _collect_facts(search: SearchResult, predictions: Sequence[Sequence[Prediction]], failed: float) -> Facts:
    """Return the facts from which the verdict follows.

    Parameters
    ----------
    predictions : sequence of sequence of Prediction
        Held-out predictions as given, refitted, and with the causes in turn.
    failed : float
        Squared residuals of failed samples that count as a cause.
    """
    odds = search.posterior
    causes = {c.name: propose_cause(search, c) for c in search.comparisons if odds.none <= 0.5}
    given, before, after = predictions[0], predictions[1], predictions[-1 if causes else 1]
    return Facts(
        no_gap=odds.none,
        catalogue=sum(odds.sets.values()),
        outside=odds.outside,
        proposed=causes,
        held_out=held_out.tabulate_parts(given, before, after),
        diverged=not held_out.is_finite(before, after),
        unreproduced=_compute_unreproduced(search.study, search.base if causes else search.null),
        failed_samples=failed > 0,
    )


def _remove_failed(fit: Hypothesis, validation: Sequence[Trial], noise: NoiseModel) -> list[Trial]:
    """Return validation trials without failed samples of markers, as the fitted trials are."""
    found = []
    for trial in validation:
        problem, theta = held_out.fit_further_trial(fit, trial, noise)
        (trial,) = dropouts.detect_failures([trial], problem.simulations(theta)).remove_from([trial])
        found.append(trial)
    return found


def _predictions(
    search: SearchResult, validation: Sequence[Trial], progress: Progress
) -> tuple[list[Hypothesis], list[list[Prediction]]]:
    """Return the fits (as given, refitted, with the causes in turn) and their held-out predictions."""
    fits = [held_out.fit_as_given(search.study), search.null, *search.between]
    if search.base is not search.null:
        fits.append(search.base)
    with progress("held-out trials", total=len(fits)) as step:
        return fits, held_out.predict_parts(fits, validation, search.study.noise, step=lambda: step(1))


def _compute_unreproduced(study: GapStudy, fit: Hypothesis) -> dict[str, float | None]:
    """Return the reproduced fraction of each output of a black-box model, where this fraction is below one
    half.

    The fraction is defined as in ``rwls`` and ``compare``: one minus the root-mean-square error divided by
    the standard deviation of the output. The mean of a black-box output is estimated in each trial. The model
    may therefore fit although it reproduces nothing but the mean.
    """
    if study.model.name != arx.NAME:
        return {}
    outputs = fit.collect_measured()
    shares = {
        channel: 1.0 - compute_rms(left) / max(float(np.std(outputs[channel])), 1e-300)
        for channel, left in fit.by_channel().items()
    }
    return {channel: share for channel, share in shares.items() if share < verdict.MIN_CLOSED_SHARE}


def _remaining(search: SearchResult, facts: Facts, *, named: bool) -> Remaining:
    """Return the share of the squared held-out gap that remains, and where the residuals have structure."""
    if facts.unreproduced:
        where = f"all motion of {', '.join(facts.unreproduced)} about its mean"
        return Remaining(share=1.0, where=where, white=False)
    left = search.structure
    where = "without structure"
    if left.is_present:
        largest = sorted(left.places.items(), key=lambda item: -item[1])
        where = " and ".join(p for p, gain in largest[:2] if gain > 0.3 * max(largest[0][1], 1e-300))
    share: float | None = 0.0
    if named:
        share = verdict.compute_remaining_share(facts)
    elif verdict.decide(facts).verdict == "unexplained":
        share = 1.0
    return Remaining(share=share, where=where, white=not left.is_present)


def _floor_text(noise: NoiseModel) -> str:
    """Return a text that says what the noise consists of."""
    said = "the noise of each channel, estimated with own parameters and smooth terms for each trial"
    slow = [f"{c} ({f.time_s:.2g} s)" for c, f in noise.forms.items() if f.time_s > 0.0]
    if slow:
        said += f", with a memory in {join_names(slow)}"
    return said


def _reasons(noise: NoiseModel) -> list[str]:
    differing = [f"{kind.name} ({kind.sd:.2g} of its typical size)" for kind in noise.random_effects]
    if not differing:
        return []
    return [f"trials differ at random in {join_names(differing)}, which has its own value in each trial"]


def _name_held_out(study: GapStudy, validation: Sequence[Trial]) -> HeldOut:
    """Return which data are held out: validation trials, whole fitted trials, or segments of them."""
    if validation:
        return "validation"
    if study.folds.whole:
        return "trials"
    return "stretches"


def _causes(
    search: SearchResult,
    shown: Sequence[CauseComparison],
    facts: Facts,
    sd: Mapping[str, float],
    given: Mapping[str, Estimate],
    closing: list[Shrinkage],
) -> list[Cause]:
    """Return the causes. The first entry also has the errors and the coefficients with all causes."""
    causes = []
    for found in shown:
        effect, best, equivalent = found.effect, found.ranked[0], facts.proposed[found.name].equivalent
        parameters = estimate_sizes(search.base, best.last_screening, sd, given)
        cause = Cause(
            effect=found.name,
            probability=search.posterior.compute_probability(found.name, *equivalent),
            equivalent=equivalent,
            parameters=parameters,
            stage=effect.stage,
            meaning=evidence.format_changes(parameters) or effect.meaning,
            sources=list(effect.sources),
            gain=best.gain,
            gain_stderr=best.gain_stderr,
        )
        causes.append(cause)
    for cause in causes[:1]:
        cause.shrinkage = closing
        cause.absorbed = _list_absorbed(search, given, sd)
    return causes


def _compare_with_file(
    known: Estimate, value: float, stderr: float, unit: str, *, inside: bool
) -> ChangedValue:
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


def estimate_sizes(
    base: Hypothesis, cause: Screening, sd: Mapping[str, float], given: Mapping[str, Estimate]
) -> dict[str, ChangedValue | Value]:
    """Return the estimated parameters of a cause, by name.

    A parameter with a separate value for each trial is reported as the root mean square of these values.
    """
    effect = cause.effect
    found: dict[str, ChangedValue | Value] = {}
    for p in cause.parameters:
        name = f"{effect.name}/{p.name}"
        if effect.adds_to is not None:
            value, known = base.value(effect.adds_to) + base.value(name), given[effect.adds_to]
            found[effect.adds_to] = _compare_with_file(
                known, value, sd[effect.name], p.unit, inside=base.is_inside(name)
            )
            continue
        labels = [n for n in base.labels if n.split("[")[0] == name]
        values = [base.value(n) for n in labels]
        if not values:
            continue
        if p.per_trial:
            found[f"{p.name}_rms"] = Value(value=compute_rms(np.array(values)), unit=p.unit)
            continue
        # An estimate that is less than its standard error away from a bound counts as at the bound. This does
        # not apply to a bound that equals the null value of the effect.
        near = sd.get(labels[0], 0.0)
        at_bound = any(b != p.start and abs(values[0] - b) <= near for b in (p.lower, p.upper))
        found[p.name] = _value(values[0], sd.get(labels[0]), p.unit, inside=not at_bound)
    return found


def _list_moved(
    search: SearchResult, base: Hypothesis, sd: Mapping[str, float], given: Mapping[str, Estimate]
) -> dict[str, ChangedValue]:
    """Return the parameters whose refitted values differ significantly from those of the parameter file.

    The significance level is 5 % (two-sided) for all parameters together (Bonferroni).
    """
    parameters = [p for p in search.study.parameters if p.name in given and base.is_inside(p.name)]
    limit = -float(special.ndtri(0.5 * CHANGE_P_VALUE / max(len(parameters), 1)))
    found = {}
    for p in parameters:
        change = _compare_with_file(given[p.name], base.value(p.name), sd[p.name], p.unit, inside=True)
        if (change.standard_errors or 0.0) > limit:
            found[p.name] = change
    return found


def _list_bounds(fit: Hypothesis) -> dict[str, float]:
    """Return the shared coefficients of the model that are at a bound, with the value of the bound."""
    return {label: fit.value(label) for label in fit.labels if "[" not in label and not fit.is_inside(label)}


def _list_absorbed(
    search: SearchResult, given: Mapping[str, Estimate], sd: Mapping[str, float]
) -> list[Absorbed]:
    """Return the values of the coefficients as given, and refitted without and with the causes."""
    nominal, base = search.null, search.base
    plain = compute_stderr(search.study, nominal)
    # A changed parameter is a cause itself, so it is not listed as a coefficient that absorbed a cause.
    causes = {e.adds_to for e in base.effects}
    found = []
    for p in search.study.parameters:
        if p.per_trial or p.name not in nominal.labels or p.name in causes:
            continue
        values = [
            _value(fit.value(p.name), errors.get(p.name), p.unit, inside=fit.is_inside(p.name))
            for fit, errors in ((nominal, plain), (base, sd))
        ]
        one = Absorbed(coefficient=p.name, without=values[0], with_effect=values[1])
        if p.name in given:
            known = given[p.name]
            one.given = Value(value=known.value, stderr=known.stderr, unit=p.unit, status=known.status)
        found.append(one)
    return found


def _advice(
    search: SearchResult, file: GapFile, shown: Sequence[CauseComparison], limits: TrialLimits
) -> list[Advice]:
    """Return the proposed next experiments of an answer with these causes."""
    if file.verdict == "none":
        if all(check.verdict != "warn" for check in evidence.checks(file)):
            return []
        return [Advice(text=ANOTHER if file.setting_count == 1 else REPEAT)]
    if file.verdict == "unexplained" and file.held_out == "validation":
        off = [name for name, t in file.facts.held_out.items() if t.after > t.limit]
        if off:
            text = f"set role: fit for {', '.join(off)}: no other trial shows effects that act only there"
            return [Advice(text=text)]
    rivals, has_equivalents = _select_rivals(file.facts, shown)
    if len(rivals) < 2:
        repeat = [Advice(text=f"{REPEAT} (remaining gap: {file.remaining.where})")]
        return repeat if file.verdict in ("partial", "unexplained") else []
    now = math.sqrt(max(rivals[0].gain - rivals[1].gain, 0.0))
    if not has_equivalents and now > proposals.compute_threshold(rivals):
        # The present trials already exclude the next best hypothesis.
        return []
    try:
        return proposals.advise_trials(search.study, rivals, limits, now)
    except (ArithmeticError, np.linalg.LinAlgError):
        return []


def _select_rivals(facts: Facts, shown: Sequence[CauseComparison]) -> tuple[list[Hypothesis], bool]:
    """Return the hypotheses that an experiment should separate, and whether the cause has equivalents.

    The hypotheses are the first cause and its equivalents. Without equivalents, they are the first cause and
    the next best hypothesis. A changed parameter and an effect that changes the trials in the same way are
    not separated, because no experiment can do so.
    """
    if not shown:
        return [], False
    first = shown[0]
    alike = {first.name, *facts.proposed[first.name].equivalent}
    ranked = [h for h in first.ranked if h.last_screening.effect.name not in first.same]
    rivals = [h for h in ranked if h.last_screening.effect.name in alike]
    return ranked[:2] if len(rivals) == 1 else rivals, len(alike) > 1


def _scores(search: SearchResult) -> list[EffectRow]:
    """Return the score of each candidate effect.

    The score comes from the fit with this effect only. If the effect was not fitted, the score comes from the
    screening.
    """
    rows: dict[str, EffectRow] = {}
    screens: list[Hypothesis | Screening] = [*search.singles, *search.first_screen]
    for h in screens:
        about: dict[str, float] = {}
        tried = h.last_screening if isinstance(h, Hypothesis) else h
        name = tried.effect.name
        if isinstance(h, Hypothesis):
            having = search.posterior.compute_probability(name)
            about = {"gain": h.gain, "stderr": h.gain_stderr, "probability": having}
        variant, stage = ", ".join(p.name for p in tried.parameters), tried.effect.stage
        row = EffectRow(effect=name, stage=stage, variant=variant, absorbed=tried.absorbed, **about)
        rows.setdefault(name, row)
    return list(rows.values())


def _hypotheses(search: SearchResult) -> list[HypothesisRow]:
    """Return every fitted hypothesis with its probability. The model without effects comes first."""
    found = search.posterior
    return [
        HypothesisRow(
            effects=sorted(c.names),
            deviances=c.deviances.tolist(),
            probability=found.sets.get(c.names, found.none),
            **{name: getattr(c, name) for name in ("numbers", "widening", "strain", "alike")},
        )
        for c in found.candidates
    ]


def _stages(rows: Sequence[EffectRow], causes: Sequence[Cause]) -> dict[Stage, float | None]:
    """Return the probability that the cause of the gap acts in each simulation stage.

    The probability of a stage is the sum of the probabilities of its effects, normalised over all stages. It
    is 1 for the stage of failed samples, if they are the first cause. Without causes, the probabilities of
    all stages are 0.
    """
    applied = {row.stage for row in rows}
    stages = [stage for stage in STAGES if stage != "rig" or stage in applied]
    sums = {stage: sum(row.probability or 0.0 for row in rows if row.stage == stage) for stage in stages}
    if causes and causes[0].effect == MarkerDropout.name:
        sums = {stage: float(stage == MarkerDropout.stage) for stage in stages}
    total = sum(sums.values())
    if not causes or total <= 0:
        return dict.fromkeys(stages, 0.0)
    return {stage: v / total for stage, v in sums.items()}


def compute_stderr(study: GapStudy, fit: Hypothesis) -> Mapping[str, float]:
    """Return the standard errors of the parameters of a fit, by label.

    The sum of a model parameter and its change has a standard error of its own, labelled with the name of the
    effect.
    """
    sums = [label.removesuffix("/change") for label in fit.changes.values()]
    # Each row of the matrix selects one parameter, or sums a model parameter and its change.
    rows = [np.isin(fit.labels, parts) for parts in fit.changes.items()]
    combined = np.vstack((np.eye(len(fit.labels)), *rows))
    variance = np.einsum("ij,jk,ik->i", combined, crossval.compute_covariance(study, fit), combined)
    sd = np.sqrt(np.maximum(variance, 0.0))
    return dict(zip([*fit.labels, *sums], sd, strict=True))
