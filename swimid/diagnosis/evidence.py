"""Create the evidence of a diagnosis: checks, tables and figures."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from swimid.diagnosis import words
from swimid.diagnosis.gap_file import GapFile, Shrinkage
from swimid.diagnosis.words import held_out_text, listed, probability_text
from swimid.results import evidence as ev
from swimid.results import numbers
from swimid.results.numbers import number, percent

if TYPE_CHECKING:
    from swimid.diagnosis.shrinkage import Piece

Rows = list[list[Any]]
#: Minimum fraction of the gap of a channel that the causes should close.
HALF = 0.5
#: Codes of the warnings that a log contradicts the beat or the course that is stated for it.
CONTRADICTING = ("SWM032", "SWM063")
#: Maximum number of effects in a figure, of panels in a figure, and of points of a curve.
MAX_EFFECTS, MAX_PANELS, MAX_POINTS = 10, 4, 800

#: Heading of the noise-floor column in a table of errors. The columns to the left of it are errors of models.
FLOOR = "floor (%)"
#: References of the method (REFERENCES), and of the choice of the next experiment (BOX).
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


def evidence(
    file: GapFile,
    worst: Sequence[Piece] = (),
    *,
    sources: Sequence[str] = (),
    notices: Sequence[ev.NoticeRecord] = (),
) -> ev.Evidence:
    """Return the evidence of a diagnosis: verdict, checks, tables and figures.

    Parameters
    ----------
    worst : sequence of Piece
        Channels of the held-out trial with the largest errors.
    sources : sequence of str
        References of the robot.
    """
    tests = list(checks(file))
    against = "; ".join(notice.text for notice in notices if notice.code in CONTRADICTING)
    if against:
        tests.append(ev.check("logs agree with their metadata", "no", False, reason=against))
    verdict = ev.judged(words.answer(file), tests)
    word = {"none": "No gap"}.get(file.verdict, file.verdict.capitalize())
    errors = _errors(file)
    tables = [errors, _causes(file), _coefficients(file), _scores(file), _parts(file)]
    cited = [*sources, *REFERENCES]
    if file.advice:
        cited.append(BOX)
    return ev.Evidence(
        command="diagnose",
        title=f"Gap between trials and model: {file.robot}, {file.experiment}",
        verdict=verdict.model_copy(update={"word": word}),
        facts=_facts(file),
        notes=words.notes(file),
        checks=tests,
        tables=[table for table in tables if table.rows],
        figures=[_levels(errors), *_ranked(file), *_residuals(worst, bool(file.causes))],
        notices=list(notices),
        methods=words.methods(file),
        references=list(dict.fromkeys([*cited, *(source for c in file.causes for source in c.sources)])),
        provenance=dict(file.provenance),
    )


def _facts(file: GapFile) -> dict[str, str]:
    facts = {}
    if file.trials:
        facts["Trials"] = f"{len(file.trials)} against {file.params}"
    facts["Model"] = file.model
    facts["Effects tried"] = str(len({s.effect for s in file.scores}) or "")
    if file.no_gap is not None:
        facts["Probability"] = words.otherwise_text(file)
    if not file.closing:
        given = [f"{c} {percent(s.nrmse)}" for c, s in list(file.as_given.items())[:3]]
        facts["Errors of the parameters as given"] = ", ".join(given)
    return {name: value for name, value in facts.items() if value}


# ---------------------------------------------------------------- checks


def checks(file: GapFile) -> Iterable[ev.Check]:
    """Yield the checks that determine the level of the verdict."""
    yield from _of_trials(file)
    if file.verdict == "none":
        yield from _of_no_gap(file)
    else:
        yield from _of_causes(file)
    failed: Literal["warn", "fail"] = "warn"
    if file.verdict == "unexplained":
        failed = "fail"
    off = listed([f"{trial} is off by {number(t, 2)} times" for trial, t in file.unpredicted.items()])
    said = f"{off} the expected error"
    if file.held_out == "validation" and off:
        yield ev.check("validation trials", said, False, otherwise=failed, reason=said)
    elif file.held_out == "validation":
        yield ev.check("validation trials", "predicted", True)
    if file.setting_count is not None and file.setting_count < 2:
        said = "all trials have one setting, and nothing is tested at another"
        yield ev.check("settings", "1", False, "≥ 2", reason=said)
    passed: bool | None = file.remaining.white
    if file.verdict == "unexplained":
        passed = False  # unexplained, even if smooth terms find no structure
        if file.remaining.share is not None and file.remaining.share <= HALF:
            failed = "warn"
    elif file.verdict != "none":
        passed = passed or None
    said = words.remaining_text(file)
    text = "whether a description without any physics still gains on held-out trials"
    yield ev.check("remaining gap", said, passed, "no structure", text, otherwise=failed, reason=said)


def _of_trials(file: GapFile) -> Iterable[ev.Check]:
    for trial, times in file.odd_trial.items():
        said = f"{trial} contradicts the other trials, with {number(times, 2)} times their error"
        yield ev.check("trials agree", said, False, "all", otherwise="fail", reason=said)
    if file.unreproduced:
        said = listed([f"{percent(v, 2)} of {c}" for c, v in file.unreproduced.items()])
        reason = f"the model reproduces {said}"
        yield ev.check("output reproduced", said, False, "≥ 50 %", otherwise="fail", reason=reason)
    if file.refuted:
        said = f"held-out errors grow with {listed(file.refuted)}, the likeliest cause by the fits"
        yield ev.check("likeliest cause", "refuted", False, otherwise="fail", reason=said)
    if file.moved:
        said = words.changes_text(file.moved)
        reason = f"the parameters as given are others than those refitted: {said}"
        yield ev.check("parameters as given", said, False, "within their errors", reason=reason)
    if file.at_bound:
        said = listed([f"{name} at {number(bound, 3)}" for name, bound in file.at_bound.items()])
        text = "a coefficient that the refit without effects takes to its bound may stand in for a cause"
        passed = None
        if not file.causes:
            passed = False
        yield ev.check(
            "bounds without effects", said, passed, "inside", text, reason=f"bounds are hit: {said}"
        )


def _of_no_gap(file: GapFile) -> Iterable[ev.Check]:
    known = [s for s in file.scores if s.refitted and s.probability is not None]
    best = max(known, key=lambda s: s.probability or 0.0, default=None)
    said = words.otherwise_text(file)
    if best is not None:
        said += f", {best.effect} {probability_text(best.probability)}"
    yield ev.check("probabilities", said, file.told_of_gap, "no gap > 50 %", reason=said)
    apart = listed([c.channel for c in file.where.channels if c.differs])
    if apart:
        said = f"trials differ in {apart} by more than the noise within them"
        reason = f"{said}, and without repeats of a setting nothing tells whether that is chance"
        yield ev.check("differences between trials", said, file.repeats, "as between repeats", reason=reason)


def _of_causes(file: GapFile) -> Iterable[ev.Check]:
    if not file.causes:
        return
    first, *_ = file.causes
    rivals = [
        f"these trials cannot tell {c.effect} from {listed(c.equivalent, 'or')}"
        for c in file.causes
        if c.equivalent
    ]
    passed = None
    if file.verdict == "ambiguous":
        passed = False
    why = "; ".join(rivals + file.unsure) or "its probability is too low to name it"
    yield ev.check("rivals of the cause", "; ".join(rivals) or "none", passed, "none", reason=why)
    for c in (c for c in file.causes if c.gain is not None):
        gain, passed = numbers.measured(c.gain, c.gain_stderr), (c.gain or 0.0) > 2.0 * (c.gain_stderr or 0.0)
        reason = f"the held-out gain of {c.effect} is no more than two standard errors ({gain})"
        yield ev.check(f"held-out gain of {c.effect}", gain, passed, "> 2 standard errors", reason=reason)
    ends = [f"{c.effect}/{n}" for c in file.causes for n, v in c.parameters.items() if v.status == "at-bound"]
    stuck = [a.coefficient for a in first.absorbed if a.with_effect.status == "at-bound"]
    for name, found in (("sizes of the causes", ends), ("coefficients with the causes", stuck)):
        said = "inside"
        if found:
            said = f"{listed(found)} at a bound"
        yield ev.check(name, said, not found, "inside their bounds", reason=said)
    distances = {**first.extrapolation}
    if file.predicted is not None:
        distances["held-out data"] = file.predicted
    text = "distance from the prediction without and with the causes; 1 where the model is right"
    for name, distance in distances.items():
        before, after = distance.before or 0.0, distance.after or 0.0
        said = f"{number(before, 2)} without, {number(after, 2)} with the causes"
        reason = f"{name} left out of the fit is predicted worse with the causes"
        passed = after < before
        if name != "held-out data":  # the prediction of a single setting need not improve
            passed = after <= before
        yield ev.check(f"prediction of {name}", said, passed, "smaller with them", text, reason=reason)
    for s in [s for s in file.closing if s.closed is not None][:1]:
        share, low = percent(s.closed, 2), s.ci95[0]
        passed = (s.closed or 0.0) >= HALF and (low is None or low > 0)
        limit, reason = f"≥ {percent(HALF)}, interval above 0", f"of the gap in {s.channel} {share} closes"
        said = " ".join([share, interval_text(s)]).strip()
        yield ev.check(f"gap closed in {s.channel}", said, passed, limit, held_out_text(file), reason=reason)


def interval_text(s: Shrinkage) -> str:
    """Return the 95 % interval of the closed fraction as text, for example ``(81 … 94 %)``."""
    low, high = s.ci95
    if low is None or high is None:
        return ""
    return f"({number(100.0 * low, 2)} … {percent(high, 2)})"


# ---------------------------------------------------------------- tables


def _percents(*values: float | None) -> list[float | None]:
    return [None if v is None else 100.0 * v for v in values]


def _table(id: str, title: str, columns: str, rows: Rows, caption: str, *, folded: bool = True) -> ev.Table:
    """Return a table. Its column headings are given as one text, separated by vertical bars."""
    names = columns.split(" | ")
    return ev.Table(id=id, title=title, columns=names, rows=list(rows), caption=caption, folded=folded)


def _errors(file: GapFile) -> ev.Table:
    """Return the table of errors on held-out data. Without a cause, the table has the errors on all
    trials.
    """
    rows: Rows = [
        [s.channel, *_percents(s.shipped, s.before, s.after, s.floor, s.closed), interval_text(s)]
        for s in file.closing
    ]
    if rows:
        title = "Errors on held-out data"
        columns = (
            f"channel | as given (%) | refitted (%) | with causes (%) | {FLOOR} | closed (%) | 95 % interval"
        )
        caption = (
            f"Root-mean-square errors over the measured range, {held_out_text(file)}: the parameters as "
            "given, the model refitted without and with the causes, and noise alone. Closed is the share of "
            "the error above the noise floor that the causes take away."
        )
        return _table("errors", title, columns, rows, caption, folded=False)
    for c in file.where.channels:
        given = file.as_given[c.channel].nrmse if c.channel in file.as_given else None
        rows.append([c.channel, *_percents(given, c.nrmse, c.floor, c.share), number(c.rmse, 3, c.unit)])
    columns = f"channel | as given (%) | refitted (%) | {FLOOR} | of the gap (%) | RMSE"
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
        for name, size in ({n: words.value_text(v) for n, v in c.parameters.items()} or {"": ""}).items():
            rows.append([c.effect, name, size, *about])
            about = [""] * len(about)
    columns = "effect | parameter | value ± sd | probability | equivalent | stage | what it is"
    caption = (
        "Probability: that it, or one of its equivalents, is missing in the model; "
        f"{words.otherwise_text(file)}. Several causes act together."
    )
    return _table("causes", "Causes", columns, rows, caption, folded=False)


def _coefficients(file: GapFile) -> ev.Table:
    strayed = {a.coefficient for a in words.moved(file)}
    rows: Rows = []
    for a in (a for c in file.causes for a in c.absorbed):
        values = ["" if v is None else words.value_text(v) for v in (a.given, a.without, a.with_effect)]
        rows.append([a.coefficient, *values, a.coefficient in strayed])
    columns = "coefficient | as given | refitted without | refitted with | stood in"
    caption = (
        f"A coefficient stood in for a cause when it moves by more than {words.MOVED_STDERR:g} standard "
        f"errors and {100 * words.MOVED_SHARE:g} % with the causes: do not use its value without them."
    )
    title = "Coefficients of the model without and with the causes"
    return _table("coefficients", title, columns, rows, caption)


def _scores(file: GapFile) -> ev.Table:
    rows: Rows = []
    for s in file.scores:
        gain = won = ""
        if s.refitted:
            gain = numbers.measured(s.gain, s.stderr)
        if s.won[1]:
            won = f"{s.won[0]} of {s.won[1]}"
        about = [s.effect, s.stage or "", s.variant, probability_text(s.probability), gain, won]
        rows.append([*about, *_percents(s.absorbed)])
    rows += [[name, "", why, "", "", "", None] for name, why in file.left_out.items()]
    columns = "effect | stage | form | probability | held-out gain ± sd | positive in | imitated (%)"
    caption = (
        "Probability: that it is among the causes. Gain: drop of the squared residuals by the effect alone "
        "in approximate cross-validation, in units of the noise. Imitated: share of its signature that the "
        "refitted coefficients reproduce."
    )
    return _table("scores", "Every effect that was tried", columns, rows, caption)


def _parts(file: GapFile) -> ev.Table:
    rows: Rows = []
    if any(file.where.stage.values()):
        rows += [["stage", stage, None, *_percents(share), None] for stage, share in file.where.stage.items()]
    rows += [[c.kind, c.label, c.ratio, *_percents(c.share), None] for c in words.parts(file)]
    if any(file.forces.values()):
        rows += [["generic term", place, None, None, gain] for place, gain in file.forces.items()]
    columns = "over | part | residual over noise | of the gap (%) | held-out gain"
    caption = (
        "Root-mean-square residual of the refitted model over the noise; of a stage, its share of the "
        "evidence of all effects. Generic terms are smooth forces and sensor errors without any physics."
    )
    return _table("parts", "Where the gap is", columns, rows, caption)


# ---------------------------------------------------------------- figures


def _levels(table: ev.Table) -> ev.Figure:
    """Plot the columns of a table of errors up to the noise floor, side by side for each channel."""
    names, *columns = zip(*table.rows, strict=True) if table.rows else ((),)
    titles = table.columns[1 : table.columns.index(FLOOR) + 1]
    shown = [(t, v) for t, v in zip(titles, columns, strict=False) if any(one is not None for one in v)]
    traces = []
    for k, (title, values) in enumerate(shown):
        x = [n + 0.12 * (k - (len(shown) - 1) / 2) for n in range(len(names))]
        label = title.replace(FLOOR, "noise alone").removesuffix(" (%)")
        traces.append(ev.Trace(x=x, y=values, style="points", label=label, group=k))
    panel = ev.Panel(
        x_label="",
        y_label="error over the measured range (%)",
        y_scale="log",
        traces=traces,
        x_categories=[numbers.quantity(str(name)) for name in names],
    )
    return ev.Figure(id="errors", title=table.title, caption="Root-mean-square errors.", panels=[panel])


def _ranked(file: GapFile) -> list[ev.Figure]:
    gains = {s.effect: (s.gain, s.stderr) for s in file.scores if s.refitted and s.gain is not None}
    best = max((gain for gain, _ in gains.values()), default=0.0)
    # Leave out effects that make the fit much worse (such as another interpretation of the robot's source),
    # because their gains would compress the axis.
    shown = [name for name, (gain, _) in gains.items() if best <= 0 or gain >= -best][:MAX_EFFECTS]
    if not shown:
        return []
    named = {name for c in file.causes for name in (c.effect, *c.equivalent)}
    traces = []
    for group, label in enumerate(("cause or equivalent", "other effects")):
        places = [k for k, name in enumerate(shown) if (name in named) == (group == 0)]
        if not places:
            continue
        ends: list[float | None] = []
        for k in places:
            gain, error = gains[shown[k]]
            ends += [gain - (error or 0.0), gain + (error or 0.0), None]
        heights = np.ravel([(k, k, None) for k in places]).tolist()
        x = [gains[shown[k]][0] for k in places]
        traces.append(ev.Trace(x=x, y=places, style="points", label=label, group=group))
        traces.append(ev.Trace(x=ends, y=heights, group=group))
    panel = ev.Panel(
        x_label="decrease of squared residuals (noise variances)",
        y_label="",
        y_categories=[_plain(name) for name in shown],
        invert_y=True,
        traces=traces,
    )
    caption = (
        "Drop of the squared residuals, in units of the noise, with one standard error; each effect alone. "
        "Effects that overlap here differ in their probabilities, which compare them on equal data."
    )
    return [ev.Figure(id="effects", title="Gain of each effect", caption=caption, panels=[panel])]


def _plain(name: str) -> str:
    """Return the name of an effect in words: ``servo backlash``, ``added mass: lateral``."""
    return name.removeprefix(words.READING).replace("=", ": ").replace("-", " ").replace("_", " ")


def _residuals(worst: Sequence[Piece], caused: bool) -> list[ev.Figure]:
    panels = []
    for p in [p for p in worst if len(p.time_s) > 2][:MAX_PANELS]:
        factor, unit = numbers.in_degrees(numbers.split_unit(p.channel)[1])
        traces: list[ev.Trace] = []
        for label, simulated in {"without the causes": p.before, "with the causes": p.after}.items():
            x, y = ev.thinned(p.time_s, factor * (p.measured - simulated), MAX_POINTS)
            style = ("points", "line")[len(traces)]
            traces.append(ev.Trace(x=x, y=y, label=label, group=len(traces), style=style))
        y_label = f"residual of {numbers.quantity(p.channel)} ({numbers.unit_text(unit) or '1'})"
        if not caused:
            traces = traces[:1]
        panels.append(ev.Panel(x_label="time (s)", y_label=y_label, traces=traces, marks=[ev.Mark(at=0.0)]))
    if not panels:
        return []
    trial = worst[0].trial.id
    caption = f"Measured minus simulated in {trial}, the held-out trial with the largest errors."
    title = f"Residuals of the worst held-out trial, {trial}"
    return [ev.Figure(id="residuals", title=title, caption=caption, panels=panels)]
