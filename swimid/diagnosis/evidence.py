"""Evidence of a diagnosis: checks, tables and methods; its figures are in ``figures``."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from swimid.diagnosis import gap_file as gap_format
from swimid.diagnosis import summary as words
from swimid.diagnosis.figures import Drawings, figures
from swimid.diagnosis.gap_file import GapFile, Score
from swimid.results import blocks, numbers
from swimid.results import evidence as ev

#: An effect that the nominal coefficients imitate beyond this share is seen through them only.
HIDDEN = 0.9

#: Warnings that logs contradict what is written of them: of the beat, and of the course.
CONTRADICTING = ("SWM032", "SWM063")

KENNEDY = (
    "Kennedy, M. C., & O'Hagan, A. (2001). Bayesian calibration of computer models. Journal of the Royal "
    "Statistical Society B, 63(3), 425-464."
)
KLEIN = (
    "Klein, V., & Morelli, E. A. (2006). Aircraft System Identification: Theory and Practice. AIAA "
    "Education Series."
)
YAO = (
    "Yao, Y., Vehtari, A., Simpson, D., Gelman, A. (2018). Using stacking to average Bayesian predictive "
    "distributions. Bayesian Analysis, 13(3), 917-1007."
)
BOX = (
    "Box, G. E. P., & Hill, W. J. (1967). Discrimination among mechanistic models. Technometrics, 9(1), "
    "57-71."
)
RAD = (
    "Rad, K. R., & Maleki, A. (2020). A scalable estimate of the out-of-sample prediction error via "
    "approximate leave-one-out cross-validation. Journal of the Royal Statistical Society B, 82(4), 965-996."
)


def evidence(
    file: GapFile,
    drawings: Drawings,
    *,
    sources: Sequence[str] = (),
    notices: Sequence[ev.NoticeRecord] = (),
) -> ev.Evidence:
    """What a diagnosis rests on.

    Parameters
    ----------
    sources : sequence of str
        Of the robot, to cite.
    """
    cited = [KENNEDY, KLEIN, RAD, YAO, *([BOX] if file.advice else [])]
    named = [source for cause in file.causes for source in cause.sources]
    said, tests = verdict(file), checks(file)
    against = [notice.text for notice in notices if notice.code in CONTRADICTING]
    if against:
        tests.append(
            ev.check("logs as written of", "contradicted", False, "no contradiction", "; ".join(against))
        )
        if said.level == "good":
            said = said.model_copy(update={"level": "caution"})
    return ev.Evidence(
        verb="diagnose",
        title=f"Gap between trials and model: {file.robot}, {file.experiment}",
        verdict=said,
        checks=tests,
        tables=tables(file),
        figures=figures(file, drawings),
        notices=list(notices),
        methods=methods(file),
        references=list(dict.fromkeys([*sources, *cited, *named])),
        provenance=dict(file.provenance),
    )


def verdict(file: GapFile) -> ev.Verdict:
    """The verdict as the report grades it."""
    said = words.verdict_sentence(file)
    closed = next((s for s in file.closing if s.closed is not None), None)
    if closed is not None:
        said += f" Of the gap in {closed.channel} {words.closed_text(closed)} is closed."
    text = ev.judged(said, checks(file)).text
    return ev.Verdict(level=file.level, word=gap_format.WORDS[file.verdict], text=text)


# ---------------------------------------------------------------- checks


def checks(file: GapFile) -> list[ev.Check]:
    """The tests the answer has to pass."""
    of_answer = _no_gap if file.verdict == "none" else _causes
    return [check for part in (_data, of_answer, _predicts, _coefficients, _left) for check in part(file)]


def _data(file: GapFile) -> Iterable[ev.Check]:
    if file.as_given:
        errors = [f"{c} {numbers.percent(s.nrmse)}" for c, s in file.as_given.items()]
        yield ev.check(
            "errors with the parameters as given",
            "; ".join(errors),
            None,
            text="root-mean-square error over the measured range, all trials, as compare has it",
        )
    if file.moved:
        yield ev.check(
            "parameters as given",
            words.changes_text(file.moved),
            False,
            "within their standard errors",
            "values in the parameter file and in the refit",
        )
    if file.unreproduced:
        yield blocks.check(
            "output that the model reproduces",
            "; ".join(f"{numbers.percent(v, 2)} of {c}" for c, v in file.unreproduced.items()),
            "at least 50 %",
            False,
            otherwise="fail",
            text="one less the error over the standard deviation of the output",
        )
    if file.at_bound:
        yield ev.check(
            "bounds without effects",
            words.bounds_text(file),
            False,
            "inside",
            "a coefficient that the refit without effects takes to its bound may stand in for a cause",
        )
    if file.odd_trial is not None:
        times = numbers.number(file.odd_trial.times, 2)
        yield blocks.check(
            "no trial contradicts the others",
            f"{file.odd_trial.trial}: {times} times the others' error",
            "as the others",
            False,
            otherwise="fail",
            text="error of a trial predicted from all others; look at what is written of it",
        )
    if file.refuted:
        yield blocks.check(
            "held-out trials bear the likeliest cause out",
            words.listed(file.refuted),
            "no worse with it",
            False,
            otherwise="fail",
            text="squared held-out errors grow with it by more than the gap and the noise",
        )
    # the largest is first
    none = file.verdict == "none" or file.follows
    for largest in [c for c in file.where.channels if c.nrmse is not None][:1]:
        yield ev.check(
            "error of the model" if none else "size of the gap",
            words.error_of(largest) if none else words.size_of(largest),
            True if none else None,
            text="root-mean-square error of the refitted model over the measured range, in the channel with "
            f"most of the gap; {file.floor_from or 'the floor is what noise alone would leave'}",
        )


def _no_gap(file: GapFile) -> Iterable[ev.Check]:
    best = words.likeliest(file)
    if best is not None:
        yield ev.check(
            "probability of the likeliest effect",
            f"{numbers.percent(best.probability, 2)} ({best.effect})",
            file.told_of_gap,
            "no gap above 50 %",
            f"of all effects tried; {words.otherwise_text(file)}",
        )
    apart = [c for c in file.where.channels if c.differs]
    if apart:
        yield ev.check(
            "differences between trials",
            "; ".join(words.error_of(c) for c in apart),
            file.repeats,
            "as between repeats",
            "most of the squared error is that trials differ from one another; only repeats of a setting "
            "tell whether that is chance",
        )


def _causes(file: GapFile) -> Iterable[ev.Check]:
    for cause in file.causes:
        won = next((s.won for s in file.scores if s.effect == cause.effect and s.won[1]), None)
        most = f"; positive in {won[0]} of {won[1]} folds" if won else ""
        yield ev.check(
            f"held-out gain of {cause.effect}",
            numbers.measured(cause.gain, cause.gain_stderr) + most,
            cause.gain is not None and cause.gain > 2.0 * (cause.gain_stderr or 0.0),
            "> 2 std. errors",
            "drop of the squared residuals, in units of the noise, in approximate cross-validation",
        )
    if file.causes:
        sets = [f"{c.effect}: {words.listed(c.equivalent)}" for c in file.causes if c.equivalent]
        yield ev.check(
            "rivals",
            "; ".join(sets) or "none",
            not sets,
            "none",
            "effects that have 90 % of the probability with the cause, the other causes given",
        )
        meaning = "an effect as large as it may be, a joint wholly locked, or one that stands in for another"
        yield _inside("sizes of the causes", file.bounded, meaning)
    if file.predicted is not None:
        before, after = (numbers.number(v, 2) for v in (file.predicted.before, file.predicted.after))
        yield ev.check(
            "distance of held-out data from the prediction",
            f"{before} without, {after} with the causes",
            file.predicted.after < file.predicted.before,
            "smaller with them",
            "root mean square, 1 where the model is right: what the coefficients' uncertainty and chance "
            "differences between trials allow is taken into account",
        )
    for s in file.closing[:3]:
        if s.half_closed is not None:
            yield ev.check(
                f"gap closed in {s.channel}",
                words.closed_text(s),
                s.half_closed,
                f"≥ {100 * gap_format.HALF:g} %, interval above 0",
                f"{words.held_out_text(file)}: {words.errors_text(s)}",
            )
    if any(None not in (e.before, e.after) for e in file.extrapolation):
        yield ev.check(
            "carries over to settings left out",
            f"not to {words.listed(file.lost)}" if file.lost else "yes",
            not file.lost,
            "all",
            "an effect that loses where it was not fitted takes up errors and causes none",
        )


def _inside(name: str, ends: Sequence[str], meaning: str) -> ev.Check:
    """Whether some numbers end inside their bounds."""
    value = f"at a bound: {words.listed(ends)}" if ends else "inside their bounds"
    return ev.check(name, value, not ends, "inside", meaning)


def _predicts(file: GapFile) -> Iterable[ev.Check]:
    if file.held_out == "validation":
        yield ev.check(
            "validation trials are predicted",
            f"not {words.unpredicted_text(file)}" if file.unpredicted else "yes",
            not file.unpredicted,
            "no worse than may be expected",
            "error of a trial that took part in no fit, over what noise and the uncertainty of the "
            "coefficients allow",
        )
    if file.single:
        yield ev.check(
            "settings",
            "1",
            False,
            "≥ 2",
            "of one setting coefficients may imitate what the model lacks; nothing is tested at another",
        )


def _coefficients(file: GapFile) -> Iterable[ev.Check]:
    if file.absorbed:
        meaning = "a coefficient at its bound still stands in for something"
        yield _inside("coefficients with the causes", file.stuck, meaning)
    stood_in = [a.coefficient for a in words.moved(file)]
    if stood_in:
        yield ev.check(
            "coefficients that stood in for the causes",
            words.listed(stood_in),
            None,
            text="their values without the causes are not to be used",
        )
    named = {c.effect for c in file.causes}
    hidden = [s for s in file.scores if s.effect in named and (s.absorbed or 0.0) > HIDDEN]
    if hidden:
        yield ev.check(
            "hidden in the coefficients",
            "; ".join(f"{s.effect}: {numbers.percent(s.absorbed, 2)}" for s in hidden),
            False,
            f"≤ {100 * HIDDEN:g} %",
            "share of the cause's signature that the model's own coefficients imitate",
        )


def _left(file: GapFile) -> Iterable[ev.Check]:
    yield ev.check(
        "what remains",
        words.remaining_text(file),
        file.remaining.white,
        "no structure",
        "whether a description without any physics still gains on held-out trials",
    )


# ---------------------------------------------------------------- tables


def tables(file: GapFile) -> list[ev.Table]:
    """What cannot be told apart, every effect tried, the coefficients, and settings left out."""
    found = (_equivalence(file), _absorbed(file), _extrapolations(file), _scores(file))
    return [table for table in found if table.rows]


def _equivalence(file: GapFile) -> ev.Table:
    scores = {s.effect: s for s in file.scores}
    rows = []
    for cause in (c for c in file.causes if c.equivalent):
        for name in (cause.effect, *cause.equivalent):
            s = scores.get(name, Score(effect=name, gain=None))
            gain, probability = numbers.measured(s.gain, s.stderr), numbers.percent(s.probability, 2)
            rows.append([cause.effect, name, s.stage or numbers.NOTHING, gain, probability])
    return ev.Table(
        id="equivalent",
        title="What these trials cannot tell apart",
        columns=["Cause", "Effect", "Stage", "Held-out gain ± std. error", "Probability"],
        rows=rows,
        caption="Any of these may be the cause: together they make up 90 % of the probability, the "
        "other causes given. Good: no such table.",
    )


def _absorbed(file: GapFile) -> ev.Table:
    strayed = {a.coefficient for a in words.moved(file)}
    rows = [
        [
            a.coefficient,
            numbers.NOTHING
            if a.given is None
            else numbers.measured(a.given.value, a.given.stderr, a.given.unit),
            *(words.value_text(v) for v in (a.without, a.with_effect)),
            numbers.bounds_text(a.bounds),
            "yes" if a.coefficient in strayed else "no",
        ]
        for a in file.absorbed
    ]
    return ev.Table(
        id="coefficients",
        title="Coefficients of the model without and with the causes",
        columns=["Coefficient", "As given", "Refitted without", "Refitted with", "Allowed", "Stood in"],
        rows=rows,
        caption="A coefficient stood in for a cause when it moves by more than "
        f"{words.MOVED_STDERR:g} standard errors and {100 * words.MOVED_SHARE:g} % once the cause is "
        "there. Good: values with the causes that agree with those found by other means.",
    )


def _extrapolations(file: GapFile) -> ev.Table:
    return ev.Table(
        id="extrapolation",
        title="Settings left out of the fit",
        columns=["Left out", "Without the causes", "With them"],
        rows=[
            [e.left_out, numbers.number(e.before, 3), numbers.number(e.after, 3)] for e in file.extrapolation
        ],
        caption="Distance of all trials of a setting from what the model fitted to the others predicts, "
        "root-mean-square, over what noise and uncertain coefficients allow. Good: smaller with the causes, "
        "and near 1.",
    )


def _scores(file: GapFile) -> ev.Table:
    rows = [
        [
            s.effect,
            s.stage or numbers.NOTHING,
            s.variant or numbers.NOTHING,
            numbers.measured(s.gain, s.stderr) if s.refitted else numbers.NOTHING,
            f"{s.won[0]} of {s.won[1]}" if s.won[1] else numbers.NOTHING,
            numbers.percent(s.absorbed, 2),
            numbers.number(s.screened, 3),
            numbers.percent(s.probability, 2),
        ]
        for s in file.scores
    ]
    columns = ["Effect", "Stage", "Form", "Held-out gain ± std. error", "Positive in", "Imitated", "Screen"]
    return ev.Table(
        id="scores",
        title="Every effect that was tried",
        columns=[*columns, "Probability"],
        rows=rows,
        caption="Gain: drop of the squared residuals in approximate cross-validation, in units of the noise; "
        "each effect alone. Probability: that it is among the causes. Imitated: share of "
        "an effect's signature that the refitted coefficients reproduce without it. Screen: the gain "
        "predicted before refitting; effects it left out have no other. Good: one gain far above all others.",
    )


# ---------------------------------------------------------------- methods


def methods(file: GapFile) -> list[str]:
    """Sentences for a methods section, from what was run."""
    refitted = sum(s.refitted for s in file.scores)
    count = str(refitted) if refitted == len(file.scores) else f"{refitted} of {len(file.scores)}"
    said = [
        f"The discrepancy between {len(file.trials)} {file.experiment} trials of {file.robot} and the model "
        f"{file.model} was treated as part of the model (Kennedy and O'Hagan 2001): its coefficients were "
        "refitted by output error, with residuals weighted by their own colour (Klein and Morelli 2006), "
        f"alone and together with each of {count} candidate effects, from several sizes of it."
    ]
    if file.floor_from:
        said.append(f"The noise floor: {file.floor_from.rstrip('.')}.")
    said.append(
        "Effects and sets of them were weighed by a Student likelihood of what each leaves beyond the noise "
        "at its optimum, folds weighted by the Bayesian bootstrap (Yao et al. 2018): "
        f"{words.otherwise_text(file)}. Held-out gains are drops of the squared residuals in approximate "
        "cross-validation: one Gauss-Newton step from the fit to all trials leaves a group of them out (Rad "
        "and Maleki 2020); noise model and spreads between trials stay those of all."
    )
    said += [f"{text.rstrip('.')}." for text in file.rounds]
    said.append(words.verdict_sentence(file))
    said += [
        f"Of the gap in {s.channel}, {words.closed_text(s)} was closed {words.held_out_text(file)} "
        f"({words.errors_text(s)})."
        for s in file.closing[:1]
        if s.closed is not None
    ]
    if file.advice:
        said.append(
            "The next experiment was chosen by how far the rivals' predictions differ in it (Box and Hill "
            "1967)."
        )
    return said
