"""Evidence of a diagnosis: checks, tables and methods; its figures are in ``diagnose_figures``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal

from swimid.diagnosis import figures as diagnose_figures
from swimid.diagnosis import gap_file as gap_format
from swimid.diagnosis import summary as words
from swimid.diagnosis.gap_file import Cause, GapFile, Score
from swimid.diagnosis.result import Gap
from swimid.results import evidence as ev
from swimid.results import numbers

#: The causes should close at least this share of a channel's gap.
GOOD_CLOSED = 0.5
#: An effect that the nominal coefficients imitate beyond this share is seen through them only.
HIDDEN = 0.9

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

Row = list[str | float | int | bool | None]


def evidence(
    gap: Gap,
    file: GapFile,
    *,
    sources: Sequence[str] = (),
    notices: Sequence[ev.NoticeRecord] = (),
    provenance: Mapping[str, Any] | None = None,
) -> ev.Evidence:
    """What a diagnosis rests on.

    Parameters
    ----------
    gap : Gap
    file : GapFile
        Made from it.
    sources : sequence of str
        Of the robot, to cite.
    provenance : mapping, optional
        Default that of the file.
    """
    references = [KENNEDY, KLEIN, RAD, YAO, *([BOX] if file.advice else [])]
    named = [source for cause in file.causes for source in cause.sources]
    return ev.Evidence(
        verb="diagnose",
        title=f"Gap between trials and model: {file.robot}, {file.experiment}",
        verdict=verdict(file),
        checks=checks(file),
        tables=tables(file),
        figures=diagnose_figures.figures(gap, file),
        notices=list(notices),
        methods=methods(file),
        references=list(dict.fromkeys([*sources, *references, *named])),
        provenance=dict(file.provenance if provenance is None else provenance),
    )


def verdict(file: GapFile) -> ev.Verdict:
    """The verdict as the report grades it."""
    level: Literal["good", "caution", "bad"] = "good"
    if file.verdict in ("ambiguous", "unexplained"):
        level = "caution"
    left = file.remaining.share
    if file.verdict == "unexplained" and (left is None or left > 0.5):
        level = "bad"
    said = [words.verdict_sentence(file)]
    closed = next((s for s in words.held_out(file) if s.closed is not None), None)
    if closed is not None:
        said.append(f"Of the gap in {closed.channel} {words.closed_text(closed)} is closed.")
    unsure = [c.name for c in checks(file) if c.verdict in ("warn", "fail")]
    if unsure:
        said.append(f"Look at: {', '.join(unsure)}.")
    return ev.Verdict(level=level, word=gap_format.WORDS[file.verdict], text=" ".join(said))


# ---------------------------------------------------------------- checks


def checks(file: GapFile) -> list[ev.Check]:
    """The tests the answer has to pass."""
    found = _at_bounds(file) + _size(file)
    if file.verdict == "none":
        return [*found, *_nothing_gains(file)]
    found += _gains(file) + _rivals(file) + _closed(file) + _transfer(file) + _coefficients(file)
    left = file.remaining
    found.append(
        ev.Check(
            name="what remains",
            value=words.remaining_text(file),
            limit="no structure",
            verdict="pass" if left.white else "warn",
            text="whether a description without any physics still gains on held-out trials",
        )
    )
    return found


def _at_bounds(file: GapFile) -> list[ev.Check]:
    if not file.at_bound:
        return []
    return [
        ev.Check(
            name="bounds without effects",
            value=words.bounds_text(file),
            limit="inside",
            verdict="warn",
            text="a coefficient that the refit without effects takes to its bound may stand in for a cause",
        )
    ]


def _size(file: GapFile) -> list[ev.Check]:
    known = [c for c in file.where.channels if c.nrmse is not None]
    if not known:
        return []
    # the largest is first
    return [
        ev.Check(
            name="size of the gap",
            value=words.size_of(known[0]),
            verdict="pass" if file.verdict == "none" else "info",
            text="root-mean-square error of the refitted model over the measured range, in the channel with "
            f"most of the gap; {file.floor_from or 'the floor is what noise alone would leave'}",
        )
    ]


def _nothing_gains(file: GapFile) -> list[ev.Check]:
    best = next((s for s in file.scores if s.refitted and s.gain is not None), None)
    if best is None:
        return []
    return [
        ev.Check(
            name="largest held-out gain",
            value=f"{numbers.number(best.gain, 3)} ({best.effect})",
            verdict="pass",
            text=f"of all effects tried; {words.otherwise_text(file)}",
        )
    ]


def _gains(file: GapFile) -> list[ev.Check]:
    found = []
    for cause in file.causes:
        above = cause.gain is not None and cause.gain > 2.0 * (cause.gain_stderr or 0.0)
        won = next((s.won for s in file.scores if s.effect == cause.effect and s.won[1]), None)
        most = f"; positive in {won[0]} of {won[1]} folds" if won else ""
        found.append(
            ev.Check(
                name=f"held-out gain of {cause.effect}",
                value=numbers.measured(cause.gain, cause.gain_stderr) + most,
                limit="> 2 std. errors",
                verdict="pass" if above else "warn",
                text="drop of the squared residuals, in units of the noise, in approximate cross-validation",
            )
        )
    return found


def _rivals(file: GapFile) -> list[ev.Check]:
    if not file.causes:
        return []
    sets = [c for c in file.causes if c.equivalent]
    return [
        ev.Check(
            name="rivals",
            value="; ".join(f"{c.effect}: {words.listed(c.equivalent)}" for c in sets) if sets else "none",
            limit="none",
            verdict="warn" if sets else "pass",
            text="effects that have 90 % of the probability with the cause, the other causes given",
        )
    ]


def _closed(file: GapFile) -> list[ev.Check]:
    found = []
    for s in words.held_out(file)[:3]:
        if s.closed is None:
            continue
        low = s.ci95[0]
        good = s.closed >= GOOD_CLOSED and (low is None or low > 0)
        found.append(
            ev.Check(
                name=f"gap closed in {s.channel}",
                value=words.closed_text(s),
                limit=f"≥ {100 * GOOD_CLOSED:g} %, interval above 0",
                verdict="pass" if good else "warn",
                text=f"{words.held_out_text(file)}: {words.errors_text(s)}",
            )
        )
    return found


def _transfer(file: GapFile) -> list[ev.Check]:
    tried = [e for c in file.causes[:1] for e in c.extrapolation if None not in (e.before, e.after)]
    if not tried:
        return []
    lost = [e.left_out for e in tried if (e.after or 0.0) > (e.before or 0.0)]
    return [
        ev.Check(
            name="carries over to settings left out",
            value="yes" if not lost else f"not to {words.listed(lost)}",
            limit="all",
            verdict="warn" if lost else "pass",
            text="an effect that loses where it was not fitted takes up errors and causes none",
        )
    ]


def _coefficients(file: GapFile) -> list[ev.Check]:
    known = {a.coefficient: a for c in file.causes for a in c.absorbed}
    if not known:
        return []
    stuck = [n for n, a in known.items() if a.with_effect.status == "at-bound"]
    stood_in = [a.coefficient for a in words.moved(file.causes)]
    found = [
        ev.Check(
            name="coefficients with the causes",
            value="inside their bounds" if not stuck else f"at a bound: {words.listed(stuck)}",
            limit="inside",
            verdict="warn" if stuck else "pass",
            text="a coefficient at its bound still stands in for something",
        )
    ]
    if stood_in:
        found.append(
            ev.Check(
                name="coefficients that stood in for the causes",
                value=words.listed(stood_in),
                verdict="info",
                text="their values without the causes are not to be used",
            )
        )
    hidden = [s for s in _answering(file) if s.absorbed is not None and s.absorbed > HIDDEN]
    if hidden:
        found.append(
            ev.Check(
                name="hidden in the coefficients",
                value="; ".join(f"{s.effect}: {numbers.percent(s.absorbed, 2)}" for s in hidden),
                limit=f"≤ {100 * HIDDEN:g} %",
                verdict="warn",
                text="share of the cause's signature that the model's own coefficients imitate",
            )
        )
    return found


def _answering(file: GapFile) -> list[Score]:
    names = {c.effect for c in file.causes}
    first: dict[str, Score] = {}
    for s in file.scores:
        if s.effect in names:
            first.setdefault(s.effect, s)
    return list(first.values())


# ---------------------------------------------------------------- tables


def tables(file: GapFile) -> list[ev.Table]:
    """What cannot be told apart, every effect tried, the coefficients, and settings left out."""
    found = [_equivalence(file)] if any(c.equivalent for c in file.causes) else []
    if any(c.absorbed for c in file.causes):
        found.append(_absorbed(file.causes))
    if any(c.extrapolation for c in file.causes):
        found.append(_extrapolations(file.causes))
    if file.scores:
        found.append(_scores(file))
    return found


def _equivalence(file: GapFile) -> ev.Table:
    scores = {s.effect: s for s in reversed(file.scores)}
    rows: list[Row] = []
    for cause in file.causes:
        for name in (cause.effect, *cause.equivalent) if cause.equivalent else ():
            s = scores.get(name)
            rows.append(
                [
                    cause.effect,
                    name,
                    (s.stage or numbers.NOTHING) if s else numbers.NOTHING,
                    numbers.measured(s.gain, s.stderr) if s else numbers.NOTHING,
                    numbers.percent(s.probability, 2) if s else numbers.NOTHING,
                ]
            )
    return ev.Table(
        id="equivalent",
        title="What these trials cannot tell apart",
        columns=["Cause", "Effect", "Stage", "Held-out gain ± std. error", "Probability"],
        rows=rows,
        caption="Any of these may be the cause: together they make up 90 % of the probability, the "
        "other causes given. Good: no such table.",
    )


def _absorbed(causes: Sequence[Cause]) -> ev.Table:
    known = {a.coefficient: a for c in causes for a in c.absorbed}
    strayed = {a.coefficient for a in words.moved(causes)}
    rows: list[Row] = [
        [
            name,
            "–" if a.given is None else numbers.measured(a.given.value, a.given.stderr, a.given.unit),
            *(words.value_text(v) for v in (a.without, a.with_effect)),
            numbers.bounds_text(a.bounds),
            "yes" if name in strayed else "no",
        ]
        for name, a in known.items()
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


def _extrapolations(causes: Sequence[Cause]) -> ev.Table:
    known = {e.left_out: e for c in causes for e in c.extrapolation}
    rows: list[Row] = [
        [name, numbers.number(e.before, 3), numbers.number(e.after, 3)] for name, e in known.items()
    ]
    return ev.Table(
        id="extrapolation",
        title="Settings left out of the fit",
        columns=["Left out", "Without the causes", "With them"],
        rows=rows,
        caption="Root-mean-square error on all trials of a setting, left out of the fit by one Gauss-Newton "
        "step from the fit to all, in units of the noise. Good: smaller with the causes, and near 1.",
    )


def _scores(file: GapFile) -> ev.Table:
    rows: list[Row] = []
    for s in file.scores:
        rows.append(
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
        )
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
    said = [
        f"The discrepancy between {len(file.trials)} {file.experiment} trials of {file.robot} and the model "
        f"{file.model} was treated as part of the model (Kennedy and O'Hagan 2001): its coefficients were "
        "refitted by output error, with residuals weighted by their own colour (Klein and Morelli 2006), "
        f"alone and together with each of {len(file.scores)} candidate effects, {refitted} of which passed "
        "a screen at finite effect size and were refitted."
    ]
    if file.floor_from:
        said.append(f"The noise floor: {file.floor_from.rstrip('.')}.")
    said.append(
        "Effects were ranked by the drop of the squared residuals in approximate cross-validation: one "
        "Gauss-Newton step from the fit to all trials leaves a group of them out (Rad and Maleki 2020); "
        "noise model and spreads between trials stay those of all."
        " Sets of effects were weighed by a Student likelihood of what each leaves beyond the noise, folds "
        f"weighted by the Bayesian bootstrap (Yao et al. 2018): {words.otherwise_text(file)}."
    )
    said += [f"{text.rstrip('.')}." for text in file.rounds]
    said.append(words.verdict_sentence(file))
    for s in words.held_out(file)[:1]:
        if s.closed is not None:
            said.append(
                f"Of the gap in {s.channel}, {words.closed_text(s)} was closed {words.held_out_text(file)} "
                f"({words.errors_text(s)})."
            )
    if file.advice:
        said.append(
            "The next experiment was chosen by how far the rivals' predictions differ in it (Box and Hill "
            "1967)."
        )
    return said
