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

#: Methods in words.
METHODS = {"gradient": "gradient search", "nsga2": "NSGA-II"}
#: Both searches agree where their values differ by no more than this share.
AGREE = 0.005
#: Share of draws of the coefficients in which the limits are to be kept to.
SURE = 0.9
REFERENCES = [
    "Locomotion Optimization of a Tendon-Driven Robotic Fish with Variable Passive Tail Fin",
    "Deb, Pratap, Agarwal, Meyarivan (2002): A fast and elitist multiobjective genetic algorithm: NSGA-II. "
    "IEEE Transactions on Evolutionary Computation 6, doi:10.1109/4235.996017",
    "Blank, Deb (2020): pymoo: Multi-Objective Optimization in Python. IEEE Access 8, "
    "doi:10.1109/ACCESS.2020.2990567",
    "Rockafellar, Uryasev (2000): Optimization of conditional value-at-risk. Journal of Risk 2, "
    "doi:10.21314/JOR.2000.038",
]


def evidence(file: GaitFile, notices: Sequence[Notice], origin: dict[str, Any]) -> ev.Evidence:
    """What a gait rests on."""
    checks = [*_checks(file), *trust.coefficients_check(notices)]
    return ev.Evidence(
        verb="optimise gait",
        title=f"Gait of {file.robot}",
        verdict=ev.judged(answer(file), checks),
        checks=checks,
        tables=[_gaits(file), *_searches(file)],
        figures=_figures(file),
        notices=blocks.notices(notices),
        methods=_methods(file),
        references=REFERENCES,
        provenance=origin,
    )


def _checks(file: GaitFile) -> list[ev.Check]:
    optimum = file.optimum
    checks = []
    if len(file.goals) == 1:
        values = [s.value for s in file.searches if s.value is not None]
        apart = (max(values) - min(values)) / max(abs(v) for v in values) if len(values) > 1 else 0.0
        checks.append(
            ev.check(
                "two searches agree",
                f"to {numbers.percent(apart, 2)}",
                apart <= AGREE,
                f"≤ {numbers.percent(AGREE)}",
                ""
                if apart <= AGREE
                else "the better one is told: look for more with --starts, --generations",
            )
        )
    bound = ", ".join(optimum.at_bound)
    text = f"a better gait may lie beyond the range of {bound}" if bound else ""
    checks.append(ev.check("gait within its ranges", bound or "yes", not bound, "inside", text))
    checks += trust.forwards_check([optimum.quantities.get("mean_surge_from_start_m_s")])
    change = optimum.quantities.get("speed_change_per_beat_m_s")
    speed = optimum.quantities.get("mean_speed_m_s")
    if change is not None and speed:
        share = abs(change / speed)
        checks.append(
            ev.check(
                "steady at the end of the run",
                f"{numbers.percent(share, 2)} a beat",
                share <= 0.005,
                "≤ 0.5 %",
                "" if share <= 0.005 else "the best gait for a run of this length: see --duration-s",
            )
        )
    drive = {name: float(value) for name, value in file.drive.items() if name in BEAT | STROKE}
    checks.append(trust.region_check(file.identified, [{**drive, **optimum.at}]))
    if file.draws:
        checks.append(trust.draws_check(file.draws, file.inside, file.refused))
        checks += _kept_check(file)
    else:
        text = "give a parameter file with standard errors: --params"
        checks.append(ev.check("uncertainty of the gait", "not known", None, text=text))
    return checks


def _kept_check(file: GaitFile) -> list[ev.Check]:
    """Whether a gait that is told keeps to its limits whatever the coefficients are."""
    best = file.optimum.kept_in_draws
    if best is None:
        return []
    robust = None if file.robust is None else file.robust.kept_in_draws
    sound = max(best, robust or 0.0) >= SURE
    value = f"best gait {numbers.percent(best, 2)}"
    value += "" if robust is None else f", robust gait {numbers.percent(robust, 2)}"
    text = ""
    if best < SURE:
        text = "take the robust gait" if sound else "leave more room to the limits, or fit better"
    return [
        ev.check(
            "draws in which the limits are kept to", value, sound, f"≥ {numbers.percent(SURE)}", text=text
        )
    ]


# ------------------------------------------------------------ in words


def _amount(file: GaitFile, name: str, value: float | None) -> str:
    unit = file.vary[name].unit
    return numbers.number(value, 4, unit)


def _goal(file: GaitFile, goal: str, value: float | None) -> str:
    factor, unit = numbers.in_degrees(file.goals[goal][1])
    return numbers.NOTHING if value is None else numbers.number(factor * value, 4, unit)


def _where(file: GaitFile, gait: Gait) -> str:
    parts = []
    for name, value in gait.at.items():
        text = f"{name} {_amount(file, name, value)}"
        if ends := _ends(gait, name):
            text += f" (95 %: {ends})" if "…" in ends else f" ({ends})"
        parts.append(text)
    return ", ".join(parts)


def _ends(gait: Gait, name: str) -> str:
    """The 95 % interval of what is varied; nothing where none is known."""
    if name not in gait.at_ci95:
        return ""
    low, high = (numbers.number(end) for end in gait.at_ci95[name])
    if low != high:
        return f"{low} … {high}"
    return f"in all draws: {'the end of its range' if name in gait.at_bound else low}"


def _goal_ends(file: GaitFile, gait: Gait, goal: str) -> str:
    """The 95 % interval of a goal; nothing where none is known."""
    ends = [_goal(file, goal, end) for end in gait.goals_ci95.get(goal, ())]
    return " … ".join(dict.fromkeys(ends))


def answer(file: GaitFile) -> str:
    """The best gait, as a sentence."""
    goals = ", ".join(f"{goal} {_goal(file, goal, value)}" for goal, value in file.optimum.goals.items())
    held = f", held back by {', '.join(file.optimum.held_by)}" if file.optimum.held_by else ""
    return f"Best gait: {_where(file, file.optimum)}; {goals}{held}."


def summary(file: GaitFile, evidence: ev.Evidence) -> str:
    """Plain text for the terminal."""
    lines = [f"{file.robot}, {file.params or 'the robot file'}: {' and '.join(file.goals)}", ""]
    for word, gait in (("best gait", file.optimum), ("robust gait", file.robust)):
        if gait is None:
            continue
        lines.append(f"  {word:<12} {_where(file, gait)}")
        for goal, value in gait.goals.items():
            text = f"  {'':<12} {goal} {_goal(file, goal, value)}"
            if ends := _goal_ends(file, gait, goal):
                text += f" (95 %: {ends})"
            lines.append(text)
        if gait.loss_worst_tenth is not None:
            goal = next(iter(file.goals))
            lines.append(
                f"  {'':<12} loses {_goal(file, goal, gait.loss_90)} at most in 90 % of draws, "
                f"{_goal(file, goal, gait.loss_worst_tenth)} on the average of the worst tenth"
            )
    if file.optimum.held_by:
        lines.append(f"  held back by {', '.join(file.optimum.held_by)}")
    if file.front:
        lines.append(f"  {len(file.front)} gaits on the front; the one nearest to the best of both is told")
    for s in file.searches:
        if s.reached_after is not None:
            mark = ", kept" if s.method == file.kept else ""
            goal = next(iter(file.goals))
            lines.append(
                f"  {METHODS[s.method]}: {_goal(file, goal, s.value)} with {s.runs} runs, there after "
                f"{s.reached_after}{mark}"
            )
        elif s.value is not None:
            goal = next(iter(file.goals))
            lines.append(f"  {METHODS[s.method]}: {_goal(file, goal, s.value)} with {s.runs} runs, not there")
    lines += ["", f"{evidence.verdict.level.upper()}: {blocks.judgement(evidence)}"]
    return "\n".join(lines)


# ------------------------------------------------------------ tables


def _gaits(file: GaitFile) -> ev.Table:
    rows = []
    for word, gait in (("best", file.optimum), ("robust", file.robust)):
        if gait is None:
            continue
        row: dict[str, blocks.Cell] = {"gait": word}
        for name, value in gait.at.items():
            row[name] = _amount(file, name, value)
            row[f"{name}, 95 %"] = _ends(gait, name) or numbers.NOTHING
        for goal, reached in gait.goals.items():
            row[goal] = _goal(file, goal, reached)
            row[f"{goal}, 95 %"] = _goal_ends(file, gait, goal) or numbers.NOTHING
        if len(file.goals) == 1:
            goal = next(iter(file.goals))
            row["loss in 90 % of draws, at most"] = _goal(file, goal, gait.loss_90)
            row["loss, worst tenth"] = _goal(file, goal, gait.loss_worst_tenth)
        if file.limits and file.draws:
            row["limits kept to in draws"] = numbers.percent(gait.kept_in_draws, 2)
        rows.append(row)
    caption = (
        "Intervals of the gait: where it lies in draws of the coefficients. Losses against the best gait of "
        "each draw, over draws that the robust gait was not chosen with."
    )
    if len(file.goals) == 2:
        caption = (
            "Intervals of the goals: what this gait comes to in draws of the coefficients; of the gait: "
            "which gait of the front is nearest to the best of both there. The front itself is that of the "
            "estimates."
        )
    return blocks.table("gaits", "Gaits", rows, caption if file.draws else "")


def _searches(file: GaitFile) -> list[ev.Table]:
    rows: list[dict[str, blocks.Cell]] = [
        {
            "method": METHODS[s.method],
            "best": _goal(file, next(iter(file.goals)), s.value),
            "runs": s.runs,
            "within 0.1 % of the best after": s.reached_after,
            "kept": s.method == file.kept,
        }
        for s in file.searches
    ]
    tables = [blocks.table("searches", "Searches", rows)]
    quantities: list[dict[str, blocks.Cell]] = []
    for name, value in file.optimum.quantities.items():
        if value is not None:
            bare, unit = numbers.split_unit(name)
            factor, shown = numbers.in_degrees(unit)
            quantities.append(
                {"quantity": bare.replace("_", " "), "value": numbers.number(factor * value, 4, shown)}
            )
    tables.append(blocks.table("quantities", "What the robot comes to with the best gait", quantities))
    return tables


# ------------------------------------------------------------ figures


def _figures(file: GaitFile) -> list[ev.Figure]:
    figures = []
    if file.front:
        figures.append(_front(file))
    if file.drawn:
        figures.append(_drawn(file))
    return figures


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
        ends = factor * np.array(file.front_ci95, dtype=float)[:, 2:]
        error = 0.5 * np.ptp(ends, axis=1)
    traces = [
        ev.Trace(x=columns[0], y=columns[1], style="points", label="front", y_error=error),  # type: ignore[arg-type]
        ev.Trace(x=[best[0]], y=[best[1]], style="points", label="told"),
    ]
    panels = [blocks.panel(labels[0], labels[1], traces)]
    for k, name in enumerate(file.vary):
        panels.append(
            blocks.panel(
                labels[0], _title(file, name), [ev.Trace(x=columns[0], y=table[:, k], style="points")]
            )
        )
    caption = "No gait is better in both goals than one of these; below, what is set along the front."
    if error is not None:
        caption += " Bars: 95 % of the goal by the coefficients' covariance."
    return blocks.panels("front", "Pareto front of two goals", caption, panels, columns=2)


def _drawn(file: GaitFile) -> ev.Figure:
    table = np.array(file.drawn, dtype=float)
    names = list(file.vary)
    caption = (
        "Each point is the best gait with one draw of the coefficients from their covariance: how sure the "
        "best gait is. At an edge of the picture it is held by its range."
        if len(file.goals) == 1
        else "Each point is the gait of the front that is nearest to the best of both goals with one draw of "
        "the coefficients from their covariance; points may lie on each other."
    )
    panels = []
    if len(names) == 1:
        x = np.sort(table[:, 0])
        share = (np.arange(len(x)) + 0.5) / len(x)
        marks = [ev.Mark(at=file.optimum.at[names[0]], axis="x", label="best gait")]
        if file.robust is not None:
            marks.append(ev.Mark(at=file.robust.at[names[0]], axis="x", label="robust gait"))
        trace = ev.Trace(x=x, y=share, style="step", label="share of draws below")
        panels.append(blocks.panel(_title(file, names[0]), "share of draws", [trace], marks=marks))
    for k in range(1, len(names)):
        traces = [ev.Trace(x=table[:, 0], y=table[:, k], style="points", label="draws")]
        for label, gait in (("best gait", file.optimum), ("robust gait", file.robust)):
            if gait is not None:
                at = list(gait.at.values())
                traces.append(ev.Trace(x=[at[0]], y=[at[k]], style="points", label=label))
        panels.append(blocks.panel(_title(file, names[0]), _title(file, names[k]), traces))
    return blocks.panels("draws", "How sure the best gait is", caption, panels, columns=1)


def _methods(file: GaitFile) -> list[str]:
    varied = ", ".join(
        f"{name} ({numbers.number(v.low)} to {numbers.number(v.high, 4, v.unit)})"
        for name, v in file.vary.items()
    )
    settings = file.provenance.get("settings", {})
    sentences = [
        f"The {' and '.join(file.goals)} of {file.robot} was optimised over {varied}; each run of "
        f"{file.duration_s:g} s began at rest and was judged by its last whole beats."
    ]
    if len(file.goals) == 1:
        sentences.append(
            f"A search by differences from {settings.get('starts')} starts and NSGA-II (Deb et al. 2002, as "
            f"implemented in pymoo; population {settings.get('population')}, {settings.get('generations')} "
            f"generations) were tried; the {METHODS[file.kept]} needed fewer runs to come within 0.1 % of "
            "the best and was kept."
        )
    if file.draws and len(file.goals) == 2:
        sentences.append(
            f"The gaits of the front were simulated with {file.draws} draws of the coefficients from their "
            "covariance; intervals are percentiles."
        )
    elif file.draws:
        sentences.append(
            f"The search was repeated in {file.draws} draws of the coefficients from their covariance; "
            "intervals are their percentiles. The robust gait minimises the average of the worst tenth of "
            "losses against the best gait of each draw (Rockafellar and Uryasev 2000), over half of the "
            "draws; losses told are over the other half."
        )
    return sentences
