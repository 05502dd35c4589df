"""The result of a diagnosis, and its evidence: checks, tables, figures and texts."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Self

import numpy as np

from swimid.diagnosis import verdict
from swimid.diagnosis.gap_file import (
    HELD_OUT,
    READING,
    Absorbed,
    Cause,
    Cell,
    ChangedValue,
    EffectRow,
    GapFile,
    Value,
    WaterfallStep,
)
from swimid.diagnosis.nominal import PREFIX
from swimid.diagnosis.posterior import Candidate, are_twins
from swimid.diagnosis.verdict import format_interval, format_otherwise
from swimid.errors import in_words_of_the_caller
from swimid.files import atomic
from swimid.fitting.fit_common import ROBOT_FILE, TRIALS_FILE
from swimid.logs import log as log_format
from swimid.logs.log import Log
from swimid.results import evidence as ev
from swimid.results import numbers
from swimid.results.numbers import format_number, join_names, percent, probability_text
from swimid.results.parameters import Fitted, ParameterFile
from swimid.results.result import FileResult
from swimid.simulators.repaired import SimulatorFile

if TYPE_CHECKING:
    import pandas as pd

    from swimid.diagnosis.held_out import HeldOutSeries


Rows = list[list[Any]]
#: Codes of two warnings: a log contradicts the beat frequency that is stated for its trial (SWM032), and the
#: course and the heading of a track contradict each other (SWM063).
CONTRADICTING = ("SWM032", "SWM063")
#: Maximum number of panels in a figure (MAX_PANELS), and of points of a curve (MAX_POINTS).
MAX_PANELS, MAX_POINTS = 4, 800

#: Literature that a diagnosis report cites for its method (REFERENCES), and for the choice of the next
#: experiment (BOX).
REFERENCES = (
    "Kennedy, M. C., & O'Hagan, A. (2001). Bayesian calibration of computer models. Journal of the Royal "
    "Statistical Society B, 63(3), 425-464.",
    "Klein, V., & Morelli, E. A. (2006). Aircraft System Identification: Theory and Practice. AIAA.",
    "Rad, K. R., & Maleki, A. (2020). A scalable estimate of the out-of-sample prediction error via "
    "approximate leave-one-out cross-validation. Journal of the Royal Statistical Society B, 82(4), 965-996.",
    "Yao, Y., Vehtari, A., Simpson, D., Gelman, A. (2018). Using stacking to average Bayesian predictive "
    "distributions. Bayesian Analysis, 13(3), 917-1007.",
)
BOX = (
    "Box, G. E. P., & Hill, W. J. (1967). Discrimination among mechanistic models. Technometrics, 9(1), "
    "57-71."
)


#: Name of the parameter file with the causes, in the folder of the gap file.
REPAIRED = "repaired.yaml"

#: Minimum share of the gap that a refit closes, at which the answer states this share.
MIN_REFIT_SHARE = 0.005
#: Text that defines the squared error of a held-out part.
SQUARED = (
    "The squared error is the squared Mahalanobis distance from the prediction, whose covariance includes "
    "the noise, the between-trial variation, and the uncertainty of the parameters."
)


def build_gap_evidence(
    file: GapFile,
    worst: Sequence[HeldOutSeries] = (),
    *,
    sources: Sequence[str] = (),
    notices: Sequence[ev.NoticeRecord] = (),
) -> ev.Evidence:
    """Return the evidence of a diagnosis: verdict, checks, tables and figures.

    Parameters
    ----------
    worst : sequence of HeldOutSeries
        Channels of the held-out trial with the largest errors.
    sources : sequence of str
        References of the robot.
    """
    tests = list(checks(file))
    against = "; ".join(notice.text for notice in notices if notice.code in CONTRADICTING)
    if against:
        tests.insert(0, ev.make_check("logs agree with their metadata", "no", False, reason=against))
    said = format_answer(file)
    verdict = ev.make_verdict(said, tests)
    word = "No gap" if file.verdict == "none" else file.verdict.capitalize()
    tables = [
        _waterfall(file), _parts_held_out(file), _errors(file), _causes(file), _coefficients(file),
        _scores(file), _parts(file),
    ]  # fmt: skip
    about = {
        "Trials": f"{len(file.trials)} against {file.params}",
        "Model": file.model,
        "Tried": _count_tried(file),
    }
    if file.facts.no_gap is not None:
        about["Probability"] = format_otherwise(file.facts)
    methods = _methods(file, said)
    cited = [*sources, *REFERENCES]
    if any(a.separates for a in file.advice):
        methods.append("The next experiment separates the rivals' predictions most (Box and Hill 1967).")
        cited.append(BOX)
    return ev.Evidence(
        command="diagnose",
        title=f"Gap between trials and model: {file.robot}, {file.experiment}",
        verdict=verdict.model_copy(update={"word": word}),
        facts={name: value for name, value in about.items() if value},
        notes=notes(file),
        checks=tests,
        tables=[table for table in tables if table.rows],
        figures=[*_steps(file.waterfall), *_residuals(worst, bool(file.causes))],
        notices=list(notices),
        methods=methods,
        references=list(dict.fromkeys([*cited, *(source for c in file.causes for source in c.sources)])),
        provenance=dict(file.provenance),
    )


def _count_tried(file: GapFile) -> str:
    """Return the numbers of effects, changed parameters and other readings that were tried."""
    counted: dict[str, set[str]] = {"effect": set(), "changed parameter": set(), "other reading": set()}
    prefixes = {PREFIX: "changed parameter", READING: "other reading"}
    for name in (s.effect for s in file.scores):
        counted[next((kind for p, kind in prefixes.items() if name.startswith(p)), "effect")].add(name)
    return join_names([f"{len(of)} {plural(kind, f'{kind}s', of)}" for kind, of in counted.items() if of])


# ---------------------------------------------------------------- checks


def checks(file: GapFile) -> Iterable[ev.Check]:
    """Yield the checks of a diagnosis, which decide whether its verdict is a pass, a caution or a failure."""
    grades: dict[bool, Literal["warn", "fail"]] = {False: "warn", True: "fail"}
    passed: bool | None
    for row in verdict.list_rows(file.facts):
        otherwise = grades[row.otherwise == "unexplained"]
        found = row.question, row.found, row.passed, row.needed
        yield ev.make_check(*found, otherwise=otherwise, reason=row.reason)
    if file.moved:
        said = format_changes(file.moved)
        reason = f"the given parameters differ from the refitted parameters: {said}"
        yield ev.make_check("parameters as given", said, False, "within their errors", reason=reason)
    if file.at_bound:
        said = join_names([f"{name} at {format_number(bound, 3)}" for name, bound in file.at_bound.items()])
        text = "a coefficient at its bound may compensate for a missing effect"
        passed = None if file.causes else False
        reason = f"the refit without effects ends at bounds: {said}"
        yield ev.make_check("bounds without effects", said, passed, "inside", text, reason=reason)
    if file.setting_count is not None and file.setting_count < 2:
        said = "all trials have the same setting, so that the answer is not tested at another setting"
        yield ev.make_check("settings", "1", False, "≥ 2", reason=said)
    if file.odd_trials:
        said = "; ".join(f"{name}: {text}" for name, text in file.odd_trials.items())
        text = "a trial that contradicts the other trials is left out; check its entry in the trials file"
        reason = f"trials that contradict the other trials are left out ({said})"
        yield ev.make_check("trials agree", said, False, "all", text, reason=reason)
    passed = file.remaining.white
    if file.causes:
        yield from _of_causes(file)
        passed = passed or None
    said = format_remaining(file)
    text = "whether a generic description without physics reduces the held-out residuals"
    otherwise = grades[file.verdict == "unexplained"]
    name = "structure that remains"
    yield ev.make_check(name, said, passed, "none", text, otherwise=otherwise, reason=said)


def _of_causes(file: GapFile) -> Iterable[ev.Check]:
    first, *_ = file.causes
    for c in file.causes:
        if c.gain is not None and len(file.causes) > 1:
            name, gain = f"held-out gain of {c.effect}", numbers.format_estimate(c.gain, c.gain_stderr)
            reason = f"the {name} is not above two standard errors ({gain})"
            passed = c.gain > 2.0 * (c.gain_stderr or 0.0)
            yield ev.make_check(name, gain, passed, "> 2 standard errors", reason=reason)
    ends = [f"{c.effect}/{n}" for c in file.causes for n, v in c.parameters.items() if v.status == "at-bound"]
    stuck = [a.coefficient for a in first.absorbed if a.with_effect.status == "at-bound"]
    for name, found in (("sizes of the causes", ends), ("coefficients with the causes", stuck)):
        said = f"{join_names(found)} at a bound" if found else "inside"
        yield ev.make_check(name, said, not found, "inside their bounds", reason=said)
    if file.facts.failed_samples and file.closed is not None:
        share = file.closed.share or 0.0
        said = f"{percent(share, 2)} {format_interval(file.closed)}".strip()
        name = "squared gap closed with the failed samples"
        reason = f"if the failed samples are included, only {said} of the squared gap closes"
        passed, needed = share >= verdict.MIN_CLOSED_SHARE, f"≥ {percent(verdict.MIN_CLOSED_SHARE)}"
        yield ev.make_check(name, said, passed, needed, reason=reason)


# ---------------------------------------------------------------- tables


def _percents(*values: float | None) -> list[float | None]:
    return [None if v is None else 100.0 * v for v in values]


def _table(id: str, title: str, columns: str, rows: Rows, caption: str, *, folded: bool = True) -> ev.Table:
    """Return a table of the report. ``columns`` is one text with the headings between vertical bars."""
    names = columns.split(" | ")
    return ev.Table(id=id, title=title, columns=names, rows=rows, caption=caption, folded=folded)


def _waterfall(file: GapFile) -> ev.Table:
    """Return the table of held-out errors: the model as given, with the causes in turn, and noise alone."""
    channels = list(file.waterfall[0].rmse) if file.waterfall else []
    rows: Rows = []
    for step in file.waterfall:
        errors = [format_number(step.rmse.get(c), 3, numbers.split_unit(c)[1]) for c in channels]
        rows.append([step.label, step.squared, *errors])
    columns = " | ".join(["model", "squared error over expected", *channels])
    caption = (
        f"Errors {HELD_OUT[file.held_out]}: squared error over its expectation for a correct model, and "
        "root-mean-square error of each channel, with the initial state fitted to each trial and "
        f"without the between-trial variation. {SQUARED}"
    )
    return _table("waterfall", "The gap on held-out data", columns, rows, caption, folded=False)


def _parts_held_out(file: GapFile) -> ev.Table:
    """Return the table of the held-out parts, from which the verdict follows."""
    rows: Rows = []
    for name, t in file.facts.held_out.items():
        errors = [v / t.expected for v in (t.as_given, t.before, t.after, t.limit)]
        rows.append([name, t.samples, *errors, t.after <= t.limit])
    columns = "part | samples | as given | refitted | with causes | limit | within noise"
    caption = (
        f"Squared error of each held-out part over its expectation. {SQUARED} Limit: the largest one that "
        "noise explains."
    )
    return _table("held-out", "Held-out parts", columns, rows, caption)


def _errors(file: GapFile) -> ev.Table:
    """Return the table of the errors of each channel on held-out data.

    If the diagnosis found no cause, the table has the errors on all trials.
    """
    closing = file.causes[0].shrinkage if file.causes else []
    rows: Rows = [[s.channel, *_percents(s.shipped, s.before, s.after, s.floor, s.closed)] for s in closing]
    if rows:
        title = "Errors on held-out data"
        columns = "channel | as given (%) | refitted (%) | with causes (%) | floor (%) | closed (%)"
        caption = (
            f"Root-mean-square errors over the measured range, {HELD_OUT[file.held_out]}: the parameters as "
            "given, the model refitted without and with the causes, and noise alone. Closed is the share of "
            "the squared error as given, above the squared noise floor, that the model with the causes does "
            "not have."
        )
        return _table("errors", title, columns, rows, caption, folded=False)
    for c in file.where.channels:
        given = file.as_given[c.channel].nrmse if c.channel in file.as_given else None
        errors = _percents(given, c.nrmse, c.floor, c.share)
        rows.append([c.channel, *errors, format_number(c.rmse, 3, c.unit)])
    columns = "channel | as given (%) | refitted (%) | floor (%) | of the gap (%) | RMSE"
    caption = (
        "Errors over the measured range without any effect: the parameters as given in all trials, the "
        "refitted model in the fitted trials."
    )
    if file.floor_from:
        caption += f" The floor: {file.floor_from.rstrip('.')}."
    return _table("errors", "The gap by channel", columns, rows, caption, folded=False)


def _causes(file: GapFile) -> ev.Table:
    rows: Rows = []
    for c in file.causes:
        about = [probability_text(c.probability), ", ".join(c.equivalent), c.stage or "", c.meaning]
        for name, size in ({n: format_value(v) for n, v in c.parameters.items()} or {"": ""}).items():
            rows.append([c.effect, name, size, *about])
            about = [""] * len(about)
    columns = "effect | parameter | value ± standard error | probability | equivalent | stage | what it is"
    caption = (
        "Probability: that it, or one of its equivalents, closes most of the gap; "
        f"{format_otherwise(file.facts)}. Several causes act together."
    )
    return _table("causes", "Causes", columns, rows, caption, folded=False)


def _coefficients(file: GapFile) -> ev.Table:
    strayed = {a.coefficient for a in select_moved(file)}
    rows: Rows = []
    for a in (a for c in file.causes for a in c.absorbed):
        values = ["" if v is None else format_value(v) for v in (a.given, a.without, a.with_effect)]
        rows.append([a.coefficient, *values, a.coefficient in strayed])
    columns = "coefficient | as given | refitted without | refitted with | compensated"
    caption = (
        f"A coefficient compensated for a cause if the causes change it by more than {MOVED_STDERR:g} "
        f"standard errors and {100 * MOVED_SHARE:g} %: do not use its value without the causes."
    )
    title = "Coefficients of the model without and with the causes"
    return _table("coefficients", title, columns, rows, caption)


def _twins(file: GapFile) -> list[list[EffectRow]]:
    """Return the effects in groups whose members leave the same residuals, in the order of the scores."""
    alone = {
        h.effects[0]: Candidate(frozenset(h.effects), np.array(h.deviances, dtype=float))
        for h in file.hypotheses
        if len(h.effects) == 1
    }
    plain = sum(v or 0.0 for h in file.hypotheses if not h.effects for v in h.deviances)
    groups: list[list[EffectRow]] = []
    for score in file.scores:
        mine = alone.get(score.effect)
        # An effect without influence leaves the residuals of the model without effects.
        if mine is not None and mine.deviance < plain:
            same = (g for g in groups if g[0].effect in alone and are_twins(mine, alone[g[0].effect]))
            if group := next(same, None):
                group.append(score)
                continue
        groups.append([score])
    return groups


def _scores(file: GapFile) -> ev.Table:
    rows: Rows = []
    for group in _twins(file):
        s = group[0]
        gain = "" if s.gain is None else numbers.format_estimate(s.gain, s.stderr)
        probability = min(sum(one.probability or 0.0 for one in group), 1.0)
        stages = dict.fromkeys(one.stage for one in group if one.stage)
        names = " or ".join(dict.fromkeys(one.effect for one in group))
        about = [names, ", ".join(stages), s.variant, probability_text(probability), gain]
        rows.append([*about, *_percents(s.absorbed)])
    rows += [[name, "", why, "", "", None] for name, why in file.left_out.items()]
    columns = "effect | stage | form | probability | held-out gain ± standard error | imitated (%)"
    caption = (
        "Probability: that it is among the causes. Gain: decrease of minus twice the log predictive density "
        "of held-out data by the effect alone. Imitated: share of its signature that the "
        "refitted coefficients reproduce. Effects that leave the same residuals share a row, a prior and the "
        "sum of their probabilities; form, gain and imitation are those of the first."
    )
    return _table("scores", "Every effect that was tried", columns, rows, caption)


def _parts(file: GapFile) -> ev.Table:
    rows: Rows = []
    if any(file.where.stage.values()):
        rows += [["stage", stage, None, *_percents(share)] for stage, share in file.where.stage.items()]
    rows += [[c.kind, c.label, c.ratio, *_percents(c.share)] for c in file.where.cells]
    columns = "over | part | residual over noise | of the gap (%)"
    caption = (
        "Root-mean-square residual of the refitted model over the noise; of a stage, its share of the "
        "evidence of all effects."
    )
    return _table("parts", "Where the gap is", columns, rows, caption)


# ---------------------------------------------------------------- figures


def _steps(steps: Sequence[WaterfallStep]) -> list[ev.Figure]:
    """Plot squared held-out errors of the model as given, after each cause in turn, and of noise alone."""
    if not steps:
        return []
    places = np.arange(len(steps) - 1)
    noise = steps[-1].rmse
    curves: dict[str, Any] = {"all channels": [step.squared for step in steps[:-1]]}
    for channel, floor in noise.items():
        if floor and len(noise) > 1:
            errors = np.array([step.rmse.get(channel) for step in steps[:-1]], dtype=float)
            curves[numbers.quantity(channel)] = (errors / floor) ** 2
    traces = []
    for k, (label, values) in enumerate(curves.items()):
        x = places + 0.1 * (k - (len(curves) - 1) / 2)
        traces.append(ev.Trace(x=x, y=values, style="points", label=label, group=k))
    caption = (
        "Squared error on held-out data of the model as given, after a refit of its parameters, and after "
        "each cause in turn: of all channels over its expectation for a correct model, and of each channel "
        "over the noise variance."
    )
    axes: dict[str, Any] = {"x_label": "", "y_label": "squared error over expectation or noise"}
    axes |= {"y_scale": "log", "x_categories": [step.label for step in steps[:-1]]}
    marks = [ev.Mark(at=1.0, label="noise alone")]
    title = "The gap on held-out data"
    return [ev.make_figure("waterfall", title, caption, traces=traces, marks=marks, **axes)]


def _residuals(worst: Sequence[HeldOutSeries], caused: bool) -> list[ev.Figure]:
    panels = []
    for p in [p for p in worst if len(p.time_s) > 2][:MAX_PANELS]:
        factor, unit = numbers.in_degrees(numbers.split_unit(p.channel)[1])
        runs = {"refitted": p.before, "with causes": p.after} if caused else {"refitted": p.before}
        traces: list[ev.Trace] = []
        for label, simulated in runs.items():
            x, y = ev.thin_curve(p.time_s, factor * (p.measured - simulated), MAX_POINTS)
            traces.append(ev.Trace(x=x, y=y, label=label, group=len(traces), style="points"))
        y_label = f"residual of {numbers.quantity(p.channel)} ({numbers.unit_text(unit) or '1'})"
        panels.append(ev.panel("time (s)", y_label, traces, marks=[ev.Mark(at=0.0)]))
    if not panels:
        return []
    trial = worst[0].trial.id
    caption = (
        f"Measured minus simulated in {trial}, the held-out trial with the largest errors, after a refit "
        "without and with the identified causes. Each prediction begins at the start state that fits the "
        "trial best."
    )
    title = f"Residuals of the worst held-out trial, {trial}"
    return [ev.panels("residuals", title, caption, panels)]


#: Minimum change of a reported coefficient: in standard errors (MOVED_STDERR), and as a fraction of its value
#: (MOVED_SHARE). The change must exceed both.
MOVED_STDERR, MOVED_SHARE = 2.0, 0.10
#: Maximum number of notes in a report (MAX_NOTES), and of places of the gap (settings, phases, times) in one
#: note (MAX_PARTS).
MAX_NOTES, MAX_PARTS = 5, 3


def format_answer(file: GapFile) -> str:
    """Return the answer of a diagnosis as sentences.

    The sentences name the causes with their sizes, and say by how much the causes reduce the held-out errors.
    """
    text = "The model has a gap, and none of the effects that were tried closes the gap."
    if file.verdict == "unexplained" and file.facts.unreproduced:
        text = "The model does not describe these trials, so that their gap cannot be separated from noise."
    elif file.verdict == "unexplained":
        if (file.facts.no_gap or 0.0) > 0.5 and file.held_out == "validation":
            text = "The model follows the trials it is fitted to, but not the validation trials."
    elif file.verdict == "none":
        is_refitted = file.moved or file.params in (ROBOT_FILE, TRIALS_FILE)
        model = "The refitted model" if is_refitted else "The model"
        text = f"{model} describes these trials as well as their noise allows."
    elif file.causes:
        text = _name_causes(file)
    elif file.verdict == "ambiguous":
        text = "These trials do not determine whether the model has a gap."
    return f"{text} {_format_closed(file)}".rstrip()


def _name_causes(file: GapFile) -> str:
    """Return sentences that name the causes of an explained, partial or ambiguous gap."""
    names = [_name_cause(c) for c in file.causes]
    if file.verdict == "ambiguous":
        cause = plural("cause is", "causes are", names)
        return f"The model has a gap whose likeliest {cause} {join_names(names)}."
    if file.verdict == "partial":
        closes = plural("closes", "close", names)
        return f"{join_names(names)} {closes} part of the gap, and the remaining gap exceeds the noise."
    alone = [_name_cause(c, rivals=False) for c in file.causes]
    text = f"{join_names(alone)} {plural('explains', 'together explain', names)} the gap."
    alike = [f"{c.effect} from {join_names(c.equivalent, 'or')}" for c in file.causes if c.equivalent]
    if alike:
        text += f" These trials cannot distinguish {join_names(alike)}."
    return text


def _format_closed(file: GapFile) -> str:
    """Return a sentence with the held-out errors of the parameters as given, their refit, and the causes."""
    closed, where = file.closed, HELD_OUT[file.held_out]
    if closed is None or closed.share is None:
        return ""
    before, after = format_number(closed.before, 3), format_number(closed.after, 3)
    parts = f"goes from {before} as given to {after} times its expectation"
    if closed.share > 0.0:
        parts += f": {percent(closed.share, 2)} of the gap closes {format_interval(closed)}".rstrip()
    if closed.by_refit is not None and closed.by_causes is not None and closed.by_refit >= MIN_REFIT_SHARE:
        by_refit, rest = percent(closed.by_refit, 2), percent(max(closed.by_causes, 0.0), 2)
        causes = plural("the cause closes", "the causes close", file.causes)
        said = f"A refit alone closes {by_refit}, and {causes} {rest} of the remainder"
        if all(c.effect.startswith(PREFIX) for c in file.causes):
            said = f"A refit of all coefficients closes {by_refit}"
        parts += f". {said}"
    return f"{where[0].upper()}{where[1:]} the squared error {parts}."


def plural(one: str, several: str, things: Collection[object]) -> str:
    """Return the text ``one`` if the collection has one entry, otherwise the text ``several``."""
    return one if len(things) == 1 else several


def _name_cause(cause: Cause, *, rivals: bool = True) -> str:
    """Return text that names a cause, its parameter values and its equivalent effects."""
    sizes = [f"{name} {format_value(v)}" for name, v in list(cause.parameters.items())[:2]]
    name = f"{cause.effect} ({', '.join(sizes)})" if sizes else cause.effect
    return join_names([format_changes(cause.parameters) or name, *(cause.equivalent if rivals else [])], "or")


def format_changes(parameters: Mapping[str, Value]) -> str:
    """Return text for changed parameters: ``k_t 0.06 → 0.05520 ± 0.00003 N·m/rad (71 standard errors)``."""
    said = []
    for name, v in parameters.items():
        if isinstance(v, ChangedValue):
            change = f"{format_number(v.given)} → {numbers.format_estimate(v.value, v.stderr, v.unit)}"
            said.append(f"{name} {change} ({format_number(v.standard_errors, 2)} standard errors)")
    return join_names(said)


def format_value(value: Value) -> str:
    """Return text for an estimate with its standard error and unit."""
    if value.status == "unidentifiable":
        return "not identifiable"
    text = numbers.format_estimate(value.value, value.stderr, value.unit)
    if value.status == "at-bound":
        text += ", at its bound"
    return text


def format_remaining(file: GapFile) -> str:
    """Return text that says which fraction of the squared gap the causes do not close, and where."""
    left = file.remaining
    share = "an unknown share" if left.share is None else percent(left.share, 2)
    where = f" ({left.where})" if left.where else ""
    return f"{share} of the squared gap remains{where}"


def select_moved(file: GapFile) -> list[Absorbed]:
    """Return the coefficients that compensated for missing causes, sorted from the largest change down."""
    far = []
    for a in (a for c in file.causes for a in c.absorbed):
        before, after = a.without.value, a.with_effect.value
        errors = [v.stderr for v in (a.without, a.with_effect) if v.stderr]
        if before is not None and after is not None and errors:
            by = abs(before - after)
            if by > MOVED_STDERR * max(errors) and by > MOVED_SHARE * abs(after):
                far.append((by / max(errors), a))
    return [a for _, a in sorted(far, key=lambda pair: -pair[0])]


def notes(file: GapFile) -> list[str]:
    """Return the notes of a report: next experiment, place of the gap, and reasons for the verdict."""
    said = [f"next experiment: {a.text}" for a in file.advice[:1]]
    worst: dict[str, Cell] = {}
    for cell in sorted(file.where.cells, key=lambda c: -(c.ratio or 0.0)):
        worst.setdefault(cell.kind, cell)
    if worst and file.verdict != "none":
        places = [
            f"{c.kind} {c.label} ({format_number(c.ratio, 2)} times the noise)".removeprefix("time ")
            for c in list(worst.values())[:MAX_PARTS]
        ]
        said.append(f"the gap is largest at {join_names(places)}")
    for a in select_moved(file)[:1]:
        values = " without the cause and ".join(format_value(v) for v in (a.without, a.with_effect))
        said.append(f"the coefficient {a.coefficient} compensated for the cause: {values} with the cause")
    said += [
        f"to use the other reading of the robot: --reading {c.effect.removeprefix(READING)}"
        for c in file.causes
        if c.effect.startswith(READING)
    ]
    sentences = [f"{text[:1].upper()}{text[1:].rstrip('.')}." for text in (*said, *file.reasons)]
    return sentences[:MAX_NOTES]


def _methods(file: GapFile, answer: str) -> list[str]:
    """Return sentences for a methods section that describe this diagnosis."""
    refitted = sum(s.gain is not None for s in file.scores)
    of = "" if refitted == len(file.scores) else f" of {len(file.scores)}"
    said = [
        f"The coefficients of {file.model} were refitted to {len(file.trials)} {file.experiment} trials of "
        f"{file.robot} by output error with coloured residuals (Klein and Morelli 2006), alone and with each "
        f"of {refitted}{of} candidate effects as part of the model (Kennedy and O'Hagan 2001).",
        "Sets of effects were compared by the log predictive density of held-out data, by one Gauss-Newton "
        "step for each fold (Rad and Maleki 2020), with a discrepancy of unknown variance and folds weighted "
        f"by the Bayesian bootstrap (Yao et al. 2018): {format_otherwise(file.facts)}.",
    ]
    if file.floor_from:
        said.append(f"The noise floor: {file.floor_from.rstrip('.')}.")
    return [*said, answer]


@dataclass(frozen=True, eq=False)
class Diagnosis(FileResult[GapFile]):
    """Result of ``diagnose``: the gap between trials and a model, and the causes of the gap.

    Attributes
    ----------
    answer : str
        Verdict: ``"none"``, ``"explained"``, ``"partial"``, ``"ambiguous"`` or ``"unexplained"``.
    causes : DataFrame
        One row for each parameter of each cause, the most probable cause first. Columns: ``effect``,
        ``probability`` (that this effect or an equivalent one is among the causes), ``parameter``, ``value``
        and ``stderr`` (in ``unit``), ``status``.
    shrinkage : DataFrame
        One row for each cause and channel. Columns: error on held-out data ``before`` and ``after`` the
        causes are added, noise ``floor``, error ``shipped`` of the parameters as given (all divided by the
        measured range), and fraction ``closed`` of the squared error above the floor.
    where : DataFrame
        One row for each channel. Columns: error ``nrmse`` of the refitted model, noise ``floor``, error
        ``within`` trials without between-trial variation (all divided by the measured range), ``share``
        (fraction of the squared gap), ``rmse`` (in ``unit``).
    next : Log or None
        Command file of the best proposed trial. None if no trial separates rival causes, and for a result
        that was read from a file.
    file : GapFile
        Content of the file that :meth:`save` writes. It also has rival causes, remaining residuals, proposed
        experiments and the scores of all effects.
    repaired : ParameterFile or None
        Parameters of the model with the causes, which every command takes as ``params``. None without a
        cause, and for a result that was read from a file.
    """

    repaired: ParameterFile | None = field(default=None, repr=False)
    #: Suffix and content of the simulator file of the user with the causes.
    simulator: tuple[str, SimulatorFile] | None = field(default=None, repr=False)

    file_type = GapFile
    leads_page = True

    def save(self, path: str | Path, repaired: str | Path | None = None) -> Self:
        """Write the gap file, its evidence, and the parameter file of the model with the causes.

        Parameters
        ----------
        repaired : path, optional
            Path of the parameter file; by default ``repaired.yaml`` in the folder of the gap file.

        Returns
        -------
        Diagnosis
            Copy of this result with the written files in :attr:`outputs`.

        Raises
        ------
        InputError, UsageError
            As for every result (:meth:`Result.save`).
        """
        with atomic.write_together():
            made = self
            if repaired is not None or not atomic.is_device(Path(path)):
                made = self.with_repaired(repaired or Path(path).with_name(REPAIRED))
            saved = super(Diagnosis, replace(made, outputs=self.outputs)).save(path)
        return replace(saved, outputs=[*saved.outputs, *made.outputs[len(self.outputs) :]])

    def with_repaired(self, path: str | Path) -> Self:
        """Write the parameter file of the model with the causes, if there is one, and name it in the notes.

        Returns
        -------
        Diagnosis
            Copy of this result with the written files in :attr:`outputs`.
        """
        if self.repaired is None:
            return self
        shown = self.evidence or self.bare()
        names = join_names([c.effect for c in self.file.causes])
        about = {
            "title": f"Model of {self.file.robot} with {names}",
            "tables": [], "figures": [], "methods": [], "notes": [],
        }  # fmt: skip
        fitted = Fitted.of(self.repaired, shown.model_copy(update=about)).save(path)
        said = f"The model with {names} is in {Path(path).name}: give it as --params to any command."
        outputs = [*self.outputs, *fitted.outputs]
        if self.simulator is not None:
            ending, (text, _, left_out) = self.simulator
            outputs.append(Path(path).with_suffix(ending))
            atomic.write_text(outputs[-1], text)
            said += f" The file of the simulator with it is {outputs[-1].name}"
            said += f", without {join_names(left_out)}." if left_out else "."
        noted = shown.model_copy(update={"notes": [*shown.notes, in_words_of_the_caller(said)]})
        return replace(self, evidence=noted, outputs=outputs)

    @property
    def next(self) -> Log | None:
        """Return the command file of the best proposed trial; None without one, or if the result was read."""
        return next((a.command for a in self.file.advice if a.command is not None), None)

    def with_command(self, path: Path) -> Self:
        """Write the command file of the best proposed trial. Return the result, with it in ``outputs``."""
        assert self.next is not None
        metadata = dict(self.next.metadata)
        metadata["trial"] = {**metadata["trial"], "id": path.stem, "log": path.name}
        log_format.write(path, self.next.columns, metadata)
        return replace(self, outputs=[*self.outputs, path])

    @property
    def answer(self) -> str:
        """Verdict: ``"none"``, ``"explained"``, ``"partial"``, ``"ambiguous"`` or ``"unexplained"``."""
        return self.file.verdict

    @property
    def causes(self) -> pd.DataFrame:
        """Return the causes as a table with one row for each parameter of each cause.

        A cause without parameters, such as another interpretation of the robot's source, has one row.
        """
        import pandas as pd

        columns = ["effect", "probability", "parameter", "value", "stderr", "unit", "status"]
        none = {"": Value(value=None, unit="")}
        rows = [
            {"effect": c.effect, "probability": c.probability, "parameter": name, **vars(v)}
            for c in self.file.causes
            for name, v in (c.parameters or none).items()
        ]
        return pd.DataFrame(rows, columns=columns)

    @property
    def shrinkage(self) -> pd.DataFrame:
        """Return the held-out errors of each channel without and with the causes."""
        import pandas as pd

        rows = [{"effect": c.effect, **s.model_dump()} for c in self.file.causes for s in c.shrinkage]
        return pd.DataFrame(rows)

    @property
    def where(self) -> pd.DataFrame:
        """Return the gap and the noise floor of each channel."""
        import pandas as pd

        return pd.DataFrame([c.model_dump() for c in self.file.where.channels])

    def bare(self) -> ev.Evidence:
        """Return the evidence that follows from the gap file only, if its evidence file is missing."""
        found = build_gap_evidence(self.file)
        text = f"No evidence file, so its figures cannot be shown. {found.verdict.text}"
        return found.model_copy(update={"verdict": found.verdict.lower_to("caution", text)})
