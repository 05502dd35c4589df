"""Checks, tables, figures and sentences of ``swimid optimise gait``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from swimid.notices import Notice
from swimid.optimisation import trust
from swimid.optimisation.gait_file import Gait, GaitFile
from swimid.optimisation.performance import BEAT, STROKE
from swimid.results import blocks, numbers
from swimid.results import evidence as ev

#: Two starts of the search end at the same value within this share of it.
AGREE_RTOL = 0.005
#: Change of the speed in a beat up to which it is steady, as a share of the speed.
STEADY_RTOL = 0.005
#: Smallest share of draws of the coefficients in which the limits are kept.
MIN_KEPT = 0.9


def evidence(file: GaitFile, notices: Sequence[Notice], origin: dict[str, Any]) -> ev.Evidence:
    """Return the evidence of a gait."""
    limits = [
        f"{name} {numbers.number(limit.at_most or limit.at_least, 4, limit.unit)}"
        for name, limit in file.limits.items()
    ]
    return trust.evidence(
        file,
        "optimise gait",
        answer(file),
        _checks(file),
        {
            "Goal": ", ".join(file.goals),
            "Varied": ", ".join(file.vary),
            "Limits": ", ".join(limits) or "none",
            "Draws": str(file.draws or "none"),
        },
        notices,
        origin,
        tables=[_gaits(file), _quantities(file)],
        figures=[*([_front(file)] if file.front else []), *([_drawn(file)] if file.drawn else [])],
        notes=[f"The front has {len(file.front)} gaits; shown is the one nearest to the best of both goals."]
        * bool(file.front),
        methods=_methods(file),
    )


def _checks(file: GaitFile) -> list[ev.Check]:
    optimum = file.optimum
    checks = []
    if file.ends:
        best = file.ends[0]
        agree = sum(abs(end - best) <= AGREE_RTOL * abs(best) for end in file.ends)
        text = "" if agree > 1 else "a better gait may be elsewhere: look for more with --starts"
        value = f"{agree} of {len(file.ends)}"
        checks.append(
            ev.check(
                "starts that end at the best gait",
                value,
                agree > 1,
                "two or more",
                text,
                reason=f"{value} starts end at it",
            )
        )
    bound = ", ".join(optimum.at_bound)
    text = f"a better gait may lie beyond the range of {bound}" if bound else ""
    checks.append(ev.check("gait within its ranges", bound or "yes", not bound, "inside", text, reason=text))
    checks += trust.forwards_check([optimum.quantities.get("mean_surge_from_start_m_s")])
    change, speed = (optimum.quantities.get(n) for n in ("speed_change_per_beat_m_s", "mean_speed_m_s"))
    if change is not None and speed:
        checks.append(trust.steady_check(int(abs(change / speed) <= STEADY_RTOL), 1))
    drive = {name: float(value) for name, value in file.drive.items() if name in BEAT | STROKE}
    checks.append(trust.region_check(file.identified, [{**drive, **optimum.at}]))
    if file.inside is None:
        return [*checks, trust.unknown_check("uncertainty of the gait")]
    return [*checks, trust.draws_check(file.inside), *_kept_check(file)]


def _kept_check(file: GaitFile) -> list[ev.Check]:
    """Whether a gait that is told keeps to its limits whatever the coefficients are."""
    shares = [gait.kept_in_draws for gait in (file.optimum, file.robust) if gait is not None]
    known = [share for share in shares if share is not None]
    if not known:
        return []
    text = ""
    if known[0] < MIN_KEPT:
        text = "take the robust gait, leave more room to the limits, or fit better"
    value = ", ".join(
        f"{word} {numbers.percent(share, 2)}"
        for word, share in zip(("best gait", "robust gait"), known, strict=False)
    )
    limit = f"≥ {numbers.percent(MIN_KEPT)} of one"
    name = "draws in which the limits are kept to"
    return [ev.check(name, value, max(known) >= MIN_KEPT, limit, text)]


# ------------------------------------------------------------ in words


def _goal(file: GaitFile, goal: str, value: float | None) -> str:
    factor, unit = numbers.in_degrees(file.goals[goal][1])
    return numbers.number(None if value is None else factor * value, 4, unit)


def _where(file: GaitFile, gait: Gait) -> str:
    return ", ".join(f"{name} {numbers.number(v, 4, file.vary[name].unit)}" for name, v in gait.at.items())


def _interval(ends: Sequence[str]) -> str:
    """Both ends in words; one where they are the same."""
    return " … ".join(dict.fromkeys(ends))


def _rows(file: GaitFile) -> list[dict[str, blocks.Cell]]:
    """A row for each of best and robust gait, with intervals and losses where they are known."""
    rows = []
    for word, gait in (("best gait", file.optimum), ("robust gait", file.robust)):
        if gait is None:
            continue
        row: dict[str, blocks.Cell] = {"gait": word}
        for name, value in gait.at.items():
            row[name] = numbers.number(value, 4, file.vary[name].unit)
            row[f"{name}, 95 %"] = _interval([numbers.number(e) for e in gait.at_ci95.get(name, ())])
        for goal, reached in gait.goals.items():
            row[goal] = _goal(file, goal, reached)
            row[f"{goal}, 95 %"] = _interval([_goal(file, goal, e) for e in gait.goals_ci95.get(goal, ())])
        if gait.loss_90 is not None:
            row["loss in 90 % of draws, at most"] = _goal(file, next(iter(file.goals)), gait.loss_90)
            row["loss, worst tenth"] = _goal(file, next(iter(file.goals)), gait.loss_worst_tenth)
        rows.append(row)
    return rows


def answer(file: GaitFile) -> str:
    """Return the best gait as a sentence."""
    goals = ", ".join(f"{goal} {_goal(file, goal, value)}" for goal, value in file.optimum.goals.items())
    held = f", held back by {', '.join(file.optimum.held_by)}" if file.optimum.held_by else ""
    return f"Best gait: {_where(file, file.optimum)}; {goals}{held}."


# ------------------------------------------------------------ tables and figures


def _gaits(file: GaitFile) -> ev.Table:
    caption = (
        "Intervals and losses are over draws of the coefficients; losses are against the best gait of each "
        "draw that the robust gait was not chosen with."
    )
    return blocks.table("gaits", "Gaits", _rows(file), caption if file.draws else "")


def _quantities(file: GaitFile) -> ev.Table:
    rows: list[dict[str, blocks.Cell]] = []
    for name, value in file.optimum.quantities.items():
        if value is not None:
            bare, unit = numbers.split_unit(name)
            factor, shown = numbers.in_degrees(unit)
            text = numbers.number(factor * value, 4, shown)
            rows.append({"quantity": bare.replace("_", " "), "value": text})
    return blocks.table("quantities", "What the robot comes to with the best gait", rows)


def _title(file: GaitFile, name: str) -> str:
    unit = numbers.unit_text(file.vary[name].unit)
    return f"{name} ({unit})" if unit else name


def _front(file: GaitFile) -> ev.Figure:
    table, width = np.array(file.front, dtype=float), len(file.vary)
    labels, columns, best = [], [], []
    for k, (goal, (_, unit)) in enumerate(file.goals.items()):
        factor, shown = numbers.in_degrees(unit)
        labels.append(f"{goal} ({numbers.unit_text(shown)})")
        columns.append(factor * table[:, width + k])
        best.append(factor * (file.optimum.goals[goal] or np.nan))
    error = None
    if file.front_ci95:
        factor, _ = numbers.in_degrees(list(file.goals.values())[1][1])
        error = 0.5 * factor * np.ptp(np.array(file.front_ci95, dtype=float)[:, 2:], axis=1)
    traces = [
        ev.Trace(x=columns[0], y=columns[1], style="points", label="front", y_error=error),  # type: ignore[arg-type]
        ev.Trace(x=best[:1], y=best[1:], style="points", label="told"),
    ]
    panels = [blocks.panel(labels[0], labels[1], traces)]
    for k, name in enumerate(file.vary):
        trace = ev.Trace(x=columns[0], y=table[:, k], style="points")
        panels.append(blocks.panel(labels[0], _title(file, name), [trace]))
    caption = "No gait is better in both goals than one of these; bars are 95 % intervals over draws."
    return blocks.panels("front", "Pareto front of two goals", caption, panels, columns=2)


def _drawn(file: GaitFile) -> ev.Figure:
    table, names = np.array(file.drawn, dtype=float), list(file.vary)
    gaits = {"best gait": file.optimum, **({"robust gait": file.robust} if file.robust else {})}
    panels = []
    for k, name in enumerate(names):
        x = np.sort(table[:, k])
        share = (np.arange(len(x)) + 0.5) / len(x)
        marks = [ev.Mark(at=gait.at[name], axis="x", label=label) for label, gait in gaits.items()]
        trace = ev.Trace(x=x, y=share, style="step", label="share of draws below")
        panels.append(blocks.panel(_title(file, name), "share of draws", [trace], marks=marks))
    caption = "The best gait of each draw of the coefficients: a steep step is a gait that is well known."
    return blocks.panels("draws", "How sure the best gait is", caption, panels, columns=2)


def _methods(file: GaitFile) -> list[str]:
    varied = ", ".join(
        f"{name} ({numbers.number(v.low)} to {numbers.number(v.high, 4, v.unit)})"
        for name, v in file.vary.items()
    )
    search = "by differences from several starts"
    if file.front:
        search = "by NSGA-II (Deb et al. 2002, as implemented in pymoo)"
    sentences = [
        f"The {' and '.join(file.goals)} of {file.robot} was optimised over {varied} {search}; each run of "
        f"{file.duration_s:g} s began at rest and was judged by its last whole beats."
    ]
    if file.draws:
        sentences.append(
            f"Intervals are percentiles over {file.draws} draws of the coefficients from their covariance."
        )
    if file.robust is not None:
        sentences.append(
            "The robust gait minimises the average of the worst tenth of losses against the best gait of each"
            " draw (Rockafellar and Uryasev 2000), over half of the draws; losses are told over the others."
        )
    return sentences
