"""``optimise gait``: the best gait within limits, its uncertainty, and a robust gait."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from swimid.errors import NoTrustworthyResult, UsageError, suggestion
from swimid.files import atomic, yamlio
from swimid.files.atomic import Checkpoint
from swimid.files.yamlio import Number, Pair, Rows
from swimid.fitting import global_search
from swimid.fitting.model import Array
from swimid.logs.kinematics import UNSTEADY
from swimid.notices import Notice, recorded
from swimid.optimisation import study as studies
from swimid.optimisation.options import OptimiseGaitOptions
from swimid.optimisation.performance import BEAT, STROKE, Performance
from swimid.optimisation.problem import (
    DRAW_STEPS,
    MAX_STEPS,
    Limit,
    Problem,
    descend,
    drawn,
    interval95,
    merit,
)
from swimid.optimisation.study import Study, StudyFile, study_of
from swimid.options import takes
from swimid.progress import Progress, silent
from swimid.results import blocks, numbers
from swimid.results import evidence as ev
from swimid.results.result import FileResult

#: Tolerances: for a gait at its bound, as a fraction of the range of the parameter, and for an active limit,
#: as a fraction of the limit.
BOUND_TOL, ACTIVE_RTOL = 0.005, 0.01
#: First and last radius of the finite differences in the search for the robust gait, as a fraction of the
#: range, and maximum number of steps.
ROBUST_RADIUS, ROBUST_LAST, ROBUST_STEPS = 0.05, 0.005, 10
#: Fraction of the coefficient samples that counts as the worst samples.
WORST = 0.1
#: Maximum relative difference of the goal between two starting points of the search that agree.
AGREE_RTOL = 0.005
#: Minimum fraction of the coefficient samples in which a gait must satisfy its limits.
MIN_KEPT = 0.9
#: Number of points of the Sobol sequence per starting point of the search.
N_POINTS_PER_START = 4
NO_GAIT = "no gait keeps to the limits"


class Varied(yamlio.Document):
    """Range of a varied parameter."""

    unit: str
    low: float
    high: float


class Gait(yamlio.Document):
    """A gait, with the quantities of its simulation in SI units."""

    at: dict[str, float]
    #: Parameters at an end of their range. A better gait may lie beyond this end.
    at_bound: list[str] = []
    #: Names of the active limits.
    held_by: list[str] = []
    goals: dict[str, Number]
    quantities: dict[str, Number] = {}
    #: 95 % interval of each goal of this gait over random samples of the coefficients.
    goals_ci95: dict[str, Pair] = {}
    #: 95 % interval of each parameter of the best gait over random samples of the coefficients.
    at_ci95: dict[str, Pair] = {}
    #: Loss of this gait over random samples of the coefficients: its 90 % quantile, and its mean over the
    #: worst tenth. The loss is the goal (with penalties) minus that of the best gait for the same sample, in
    #: the unit of the goal. Only samples that were not used to find the gait count.
    loss_90: Number = None
    loss_worst_tenth: Number = None
    #: Fraction of the coefficient samples in which the gait satisfies its limits; None without limits.
    kept_in_draws: Number = None


class GaitFile(StudyFile):
    """Gait file: the best gait, with its uncertainty."""

    kind: ClassVar[str] = "gait file"
    format: Literal["swimid-gait/2"] = "swimid-gait/2"
    vary: dict[str, Varied]
    #: Quantity and unit of each goal.
    goals: dict[str, tuple[str, str]]
    limits: dict[str, Limit] = {}
    #: Value of the goal with penalties at the end of each search, the best first; empty for two goals.
    ends: list[float] = []
    optimum: Gait
    #: Gait with the minimum mean loss over the worst tenth of the coefficient samples. It is the best gait if
    #: no other gait has a smaller loss.
    robust: Gait | None = None
    #: Number of random samples of the coefficients, and fraction of the samples that lie within the bounds.
    draws: int = 0
    inside: Number = None
    #: Best gait for each coefficient sample, in the order of ``vary``; empty for two goals.
    drawn: Rows = []
    #: Pareto front of two goals: each row has the varied parameters and then the goals.
    front: Rows = []
    #: Lower and upper end of the 95 % interval of each goal, for each gait of the front.
    front_ci95: Rows = []
    provenance: dict[str, Any] = Field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class BestGait(FileResult[GaitFile]):
    """Best gait, the result of ``optimise gait``.

    Attributes
    ----------
    at : dict of str to float
        Varied parameters at the best gait.
    file : GaitFile
        All results, including the intervals, the robust gait and the ends of the searches. :meth:`save`
        writes this file.
    """

    file_type = GaitFile

    @property
    def at(self) -> dict[str, float]:
        """Varied parameters at the best gait."""
        return dict(self.file.optimum.at)


@takes(OptimiseGaitOptions)
def optimise_gait(
    *, options: OptimiseGaitOptions, output: Path | None = None, progress: Progress = silent
) -> BestGait:
    """Find the best gait of a robot within limits, with the uncertainty of its coefficients.

    One goal is minimised by finite differences from several starting points, and two goals by NSGA-II. If the
    parameter file has standard errors, the search is repeated for random samples of the coefficients. These
    give the interval of the best gait and its loss. The robust gait has the minimum mean loss over the worst
    tenth of the samples.

    Parameters
    ----------
    output : path, optional
        Gait file to write. The evidence is written to the same folder.
    progress : Progress
        Shows the progress of the searches.

    Returns
    -------
    BestGait
        ``.at`` is the gait. ``.file`` also has the intervals, the robust gait, and the front of two goals.

    Raises
    ------
    UsageError, InputError
        For bad options and files.
    NoTrustworthyResult
        If every simulation breaks down, or if no gait satisfies the limits.

    References
    ----------
    .. [1] "Locomotion Optimization of a Tendon-Driven Robotic Fish with Variable Passive Tail Fin".
       Section IV: gait and stiffness.
    .. [2] Deb, Pratap, Agarwal, Meyarivan (2002), doi:10.1109/4235.996017: NSGA-II.
    .. [3] Rockafellar, Uryasev (2000), doi:10.21314/JOR.2000.038: the mean over the worst fraction of
    outcomes.

    Examples
    --------
    >>> found = optimise_gait(
    ...     robot="dolphin", amplitude_deg=27, frequency_hz=3, vary={"K_s": (0.1, 2.0)}, duration_s=6
    ... )
    >>> 0.3 < found.at["K_s"] < 0.9
    True
    """
    with recorded(repeat=True) as notices:
        performance = Performance.of_options(options)
        study = study_of(performance, options)
        if output is not None:
            atomic.check_writable(output, inputs=study.inputs)
        keep = Checkpoint.beside(output, study.key)
        problem = _problem(performance, options, keep)
        known = bool(performance.applied.uncertain()[0])
        performance.model.prepare(progress, simulated_s=_simulated_s(options, known), checkpoint=keep)
        find, carry = _find_one, _carry_one
        if len(options.goals) == 2:
            find, carry = _find_front, _carry_front
        file = find(problem, options, study, progress)
        if known:
            performance.applied.warn_without_error("the intervals")
            draws = drawn(performance.applied, options.draws, options.seed)
            file.draws, file.inside = len(draws.vectors), draws.inside
            carry(problem, file, draws.vectors, progress)
    evidence = evidence_of(file, notices, study.origin)
    file.verdict = evidence.verdict.level
    saved = BestGait.of(file, evidence).saved(output)
    keep.done()
    return saved


# ------------------------------------------------------------ the problem


def _simulated_s(options: OptimiseGaitOptions, uncertain: bool) -> float:
    """Return the expected simulated time of all gaits together, s."""
    points = 2 * len(options.vary) + 1
    runs = (options.starts * MAX_STEPS + options.draws * (DRAW_STEPS + ROBUST_STEPS) * uncertain) * points
    if len(options.goals) == 2:
        runs = options.population * (options.generations + options.draws * uncertain)
    return runs * options.duration_s


def _problem(performance: Performance, options: OptimiseGaitOptions, keep: Checkpoint) -> Problem:
    if not options.vary:
        raise UsageError("say what may be varied: --vary NAME=LOW,HIGH")
    performance.check(options.vary, "--vary")
    performance.check_drive(options.vary, "--vary")
    if len(options.goals) > 2 or len(set(options.goals)) < len(options.goals):
        raise UsageError("--goal: one, or two that differ")
    turn = "yaw" if performance.model.in_space else performance.turn
    quantities = {
        "speed": ("mean_speed_m_s", -1.0),
        "radius": ("turning_radius_m", 1.0),
        "turn-rate": (f"mean_{turn}_rate_rad_s", -1.0),
        "cost-of-transport": ("cost_of_transport_J_m", 1.0),
        "power": ("mean_positive_power_W", 1.0),
    }
    goals = [(goal, *quantities[goal]) for goal in options.goals]
    limits = _limits(performance, options)
    known = (*performance.units, "battery_power_W", "basin_m")
    for goal, quantity, _ in goals:
        if quantity not in known:
            raise UsageError(f"--goal {goal} is not for this robot: it has {', '.join(performance.units)}")
    for name, limit in limits.items():
        if limit.quantity not in known:
            raise UsageError(f"--limit {name} is not for this robot")
    if options.goals == ("power",) and options.reach_speed_m_s is None:
        raise UsageError("the least power is that of no motion", hint="give the speed: --reach-speed-m-s")
    jobs = options.jobs or os.cpu_count() or 1
    return Problem(
        performance, options.vary, goals, limits, efficiency=options.efficiency, jobs=jobs, checkpoint=keep
    )


def _limits(performance: Performance, options: OptimiseGaitOptions) -> dict[str, Limit]:
    known = {
        "torque_N_m": ("peak_torque_N_m", 1.0, "N m"),
        "joint_rate_deg_s": ("peak_joint_rate_rad_s", math.pi / 180.0, "rad/s"),
        "battery_W": ("battery_power_W", 1.0, "W"),
        "tank_m": ("basin_m", 1.0, "m"),
    }
    found = {}
    for name, value in options.limits.items():
        if name not in known:
            raise UsageError(
                f"--limit: there is no '{name}'", hint=suggestion(name, list(known), "there are")
            )
        if not value > 0:
            raise UsageError(f"--limit {name}: {value:g} is not above zero")
        if name == "tank_m" and performance.model.body is None:
            raise UsageError("--limit tank_m is for robots in a plane")
        quantity, factor, unit = known[name]
        found[name] = Limit(quantity=quantity, at_most=factor * value, unit=unit)
    if options.reach_speed_m_s is not None:
        speed = options.reach_speed_m_s
        found["reach_speed_m_s"] = Limit(quantity="mean_speed_m_s", at_least=speed, unit="m/s")
    return found


# ------------------------------------------------------------ searches


def _choose_starts(problem: Problem, options: OptimiseGaitOptions) -> Array:
    """Return the best points of a Sobol sequence as starting points, and set the scale of the goal."""
    exponent = math.ceil(math.log2(N_POINTS_PER_START * options.starts))
    from scipy.stats import qmc

    points = qmc.Sobol(len(problem.vary), seed=options.seed).random_base2(exponent)
    table = problem.table(points)
    problem.performance.insist(table)
    wanted = problem.wanted(table)[:, 0]
    if np.isfinite(wanted).any():
        problem.scale = float(np.nanmedian(np.abs(wanted)))
    return points[np.argsort(merit(problem.parts(table)), kind="stable")[: options.starts]]


def _file(problem: Problem, study: Study, optimum: Array, **found: Any) -> GaitFile:
    units = problem.performance.axes
    return GaitFile(
        **study.head,
        vary={n: Varied(unit=units[n], low=low, high=high) for n, (low, high) in problem.vary.items()},
        goals={goal: (q, problem.performance.units[q]) for goal, q, _ in problem.goals},
        limits=dict(problem.limits),
        optimum=_gait(problem, optimum),
        **found,
    )


def _find_one(problem: Problem, options: OptimiseGaitOptions, study: Study, progress: Progress) -> GaitFile:
    """Find the best gait for one goal."""
    starts = _choose_starts(problem, options)
    with progress("search", total=MAX_STEPS) as step:
        found = problem.minimise(starts, advance=step)
    ends = np.sort(found.values) * problem.signs[0]
    return _file(problem, study, found.points[found.best], ends=ends.tolist())


def _find_front(problem: Problem, options: OptimiseGaitOptions, study: Study, progress: Progress) -> GaitFile:
    """Find the Pareto front of two goals, and its point that is nearest to the best values of both goals."""
    _choose_starts(problem, options)
    with progress("NSGA-II", total=options.generations) as step:
        front = problem.front(options.population, options.generations, options.seed, advance=step)
    if not len(front):
        raise NoTrustworthyResult(NO_GAIT, hint="widen what is varied, or the limits")
    points, values = front[:, :-2], front[:, -2:]
    gaits = np.array([list(problem.at(x).values()) for x in points])
    rows = np.hstack([gaits, values * problem.signs])
    return _file(problem, study, points[global_search.knee(values)], front=rows)


def _gait(problem: Problem, x: Array) -> Gait:
    """Simulate a point of the unit cube and return its gait."""
    table = problem.table(x[None])
    if not problem.keeps_limits(table).all():
        raise NoTrustworthyResult(NO_GAIT, hint="widen what is varied, or the limits")
    values = problem.goal_values(table)[0]
    if not np.isfinite(values).all():
        raise NoTrustworthyResult("the goal has no value anywhere: a robot that does not turn has no radius")
    at = problem.at(x)
    violations = np.abs(problem.violations(table)[0])
    return Gait(
        at=at,
        at_bound=[n for n, v in zip(at, x, strict=True) if min(v, 1.0 - v) < BOUND_TOL],
        held_by=[n for n, v in zip(problem.limits, violations, strict=True) if v < ACTIVE_RTOL],
        goals={goal: float(v) for (goal, _, _), v in zip(problem.goals, values, strict=True)},
        quantities={name: float(v) for name, v in zip(problem.performance.units, table[0], strict=True)},
    )


# ------------------------------------------------------------ uncertainty


def _carry_front(problem: Problem, file: GaitFile, vectors: Sequence[Array], progress: Progress) -> None:
    """Set the 95 % interval of both goals for every gait of a front."""
    best = list(file.optimum.at.values())
    with progress("front in draws", total=len(file.front)) as step:
        for row in np.array(file.front, dtype=float):
            gait = dict(zip(problem.vary, row[: len(problem.vary)].tolist(), strict=True))
            table, _ = problem.costs(problem.place(gait), vectors)
            file.front_ci95.append([*interval95(problem.goal_values(table)).T.ravel().tolist()])
            if list(gait.values()) == best:
                _set_draws(problem, file.optimum, table)
            step()


def _set_draws(problem: Problem, gait: Gait, table: Array, lost: Array | None = None) -> None:
    """Set the intervals of a gait over coefficient samples, and its losses.

    The losses ``lost`` are those in the samples that were not used to find the gait.
    """
    ends = interval95(problem.goal_values(table)).T.tolist()
    gait.goals_ci95 = {goal: (a, b) for (goal, _, _), (a, b) in zip(problem.goals, ends, strict=True)}
    if problem.limits:
        gait.kept_in_draws = float(problem.keeps_limits(table).mean())
    if lost is not None:
        gait.loss_90 = float(np.quantile(lost, 1.0 - WORST))
        gait.loss_worst_tenth = worst_tenth(lost)


def _carry_one(problem: Problem, file: GaitFile, vectors: Sequence[Array], progress: Progress) -> None:
    """Set intervals and losses over coefficient samples for one goal, and find the robust gait."""
    nominal = problem.place(file.optimum.at)
    with progress("gaits of draws", total=DRAW_STEPS) as step:
        best = problem.minimise_in_draws(vectors, nominal, step)
    file.drawn = [list(problem.at(x).values()) for x in best.points]
    ends = interval95(np.array(file.drawn, dtype=float)).T.tolist()
    file.optimum.at_ci95 = {name: (a, b) for name, (a, b) in zip(problem.vary, ends, strict=True)}
    # half of the coefficient samples selects the robust gait, the other half gives the loss of this gait
    robust = _find_robust(problem, vectors[::2], best.points[::2], best.values[::2], nominal, progress)
    table, cost = problem.costs(nominal, vectors)
    robust_table, robust_cost = problem.costs(robust, vectors)
    least = np.minimum(best.values, np.minimum(cost, robust_cost))
    lost, robust_lost = (cost - least)[1::2], (robust_cost - least)[1::2]
    _set_draws(problem, file.optimum, table, lost)
    file.robust = file.optimum.model_copy(update={"at_ci95": {}})
    kept = problem.keeps_limits(problem.table(robust[None])).all()
    if kept and worst_tenth(robust_lost) < worst_tenth(lost):
        file.robust = _gait(problem, robust)
        _set_draws(problem, file.robust, robust_table, robust_lost)


def worst_tenth(lost: Array) -> float:
    """Return the mean over the worst tenth of losses.

    >>> worst_tenth(np.arange(20.0))
    18.5
    """
    count = max(round(WORST * len(lost)), 1)
    return float(np.sort(lost)[-count:].mean())


def _find_robust(
    problem: Problem,
    vectors: Sequence[Array],
    points: Array,
    values: Array,
    nominal: Array,
    progress: Progress,
) -> Array:
    """Find the gait with the minimum mean loss over the worst tenth of the coefficient samples.

    ``points`` and ``values`` are the best gait for each sample and its goal.
    """

    def losses(x: Array, _owner: NDArray[np.int64]) -> Array:
        table = problem.table(np.repeat(x, len(vectors), axis=0), list(vectors) * len(x))
        cost = merit(problem.parts(table)).reshape(len(x), -1)
        return np.array([[worst_tenth(row)] for row in cost - values])

    starts = np.array([nominal, np.median(points, axis=0)])
    with progress("robust gait", total=ROBUST_STEPS) as step:
        found = descend(
            losses, starts, first=ROBUST_RADIUS, last=ROBUST_LAST, steps=ROBUST_STEPS, advance=step
        )
    return found.points[found.best]


# ------------------------------------------------------------ evidence


def evidence_of(file: GaitFile, notices: Sequence[Notice], origin: dict[str, Any]) -> ev.Evidence:
    """Return the evidence of a gait."""
    limits = [
        f"{name} {numbers.number(limit.at_most or limit.at_least, 4, limit.unit)}"
        for name, limit in file.limits.items()
    ]
    facts = {
        "Goal": ", ".join(file.goals),
        "Varied": ", ".join(file.vary),
        "Limits": ", ".join(limits) or "none",
        "Draws": str(file.draws or "none"),
    }
    figures, notes = [], []
    if file.front:
        figures.append(_front_figure(file))
        notes = [
            f"The front has {len(file.front)} gaits; shown is the one nearest to the best of both goals."
        ]
    if file.drawn:
        figures.append(_draws_figure(file))
    return studies.evidence(
        file, "optimise gait", answer(file), _checks(file), facts, notices, origin,
        tables=[_gait_table(file), _quantity_table(file)], figures=figures, notes=notes,
        methods=_methods(file),
    )  # fmt: skip


def _checks(file: GaitFile) -> list[ev.Check]:
    optimum = file.optimum
    checks = []
    if file.ends:
        agree = sum(abs(end - file.ends[0]) <= AGREE_RTOL * abs(file.ends[0]) for end in file.ends)
        text = "" if agree > 1 else "a better gait may be elsewhere: look for more with --starts"
        value = f"{agree} of {len(file.ends)}"
        name, reason = "starts that end at the best gait", f"{value} starts end at it"
        checks.append(ev.check(name, value, agree > 1, "two or more", text, reason=reason))
    bound = ", ".join(optimum.at_bound)
    text = f"a better gait may lie beyond the range of {bound}" * bool(bound)
    checks.append(ev.check("gait within its ranges", bound or "yes", not bound, "inside", text, reason=text))
    checks += studies.forwards_check([optimum.quantities.get("mean_surge_from_start_m_s")])
    change, speed = (optimum.quantities.get(n) for n in ("speed_change_per_beat_m_s", "mean_speed_m_s"))
    if change is not None and speed:
        checks.append(studies.steady_check(int(abs(change / speed) <= UNSTEADY), 1))
    drive = {name: float(value) for name, value in file.drive.items() if name in BEAT | STROKE}
    checks.append(studies.region_check(file.identified, [{**drive, **optimum.at}]))
    if file.inside is None:
        return [*checks, studies.unknown_check("uncertainty of the gait")]
    checks.append(studies.draws_check(file.inside))
    gaits = {"best gait": optimum}
    if file.robust is not None:
        gaits["robust gait"] = file.robust
    known = {word: g.kept_in_draws for word, g in gaits.items() if g.kept_in_draws is not None}
    if known:
        value = ", ".join(f"{word} {numbers.percent(share, 2)}" for word, share in known.items())
        text = "take the robust gait, leave more room to the limits, or fit better"
        text *= next(iter(known.values())) < MIN_KEPT
        name, limit = "draws in which the limits are kept", f"≥ {numbers.percent(MIN_KEPT)} of one"
        checks.append(ev.check(name, value, max(known.values()) >= MIN_KEPT, limit, text))
    return checks


def _goal_text(file: GaitFile, goal: str, value: float | None) -> str:
    factor, unit = numbers.in_degrees(file.goals[goal][1])
    return numbers.number(None if value is None else factor * value, 4, unit)


def _range_text(ends: Sequence[str]) -> str:
    """Join both ends of an interval in one text; return one end if both have the same text."""
    return " … ".join(dict.fromkeys(ends))


def answer(file: GaitFile) -> str:
    """Return the best gait as a sentence."""
    gait = file.optimum
    place = ", ".join(f"{n} {numbers.number(v, 4, file.vary[n].unit)}" for n, v in gait.at.items())
    goals = ", ".join(f"{goal} {_goal_text(file, goal, value)}" for goal, value in gait.goals.items())
    held = f", limited by {', '.join(gait.held_by)}" if gait.held_by else ""
    return f"Best gait: {place}; {goals}{held}."


def _gait_table(file: GaitFile) -> ev.Table:
    """Return the best gait and the robust gait as a table, with intervals and losses."""
    rows = []
    for word, gait in (("best gait", file.optimum), ("robust gait", file.robust)):
        if gait is None:
            continue
        row: dict[str, blocks.Cell] = {"gait": word}
        for name, value in gait.at.items():
            row[name] = numbers.number(value, 4, file.vary[name].unit)
            row[f"{name}, 95 %"] = _range_text([numbers.number(e) for e in gait.at_ci95.get(name, ())])
        for goal, reached in gait.goals.items():
            ends = [_goal_text(file, goal, e) for e in gait.goals_ci95.get(goal, ())]
            row[goal] = _goal_text(file, goal, reached)
            row[f"{goal}, 95 %"] = _range_text(ends)
        if gait.loss_90 is not None:
            goal = next(iter(file.goals))
            row["loss, 90 % of draws"] = f"≤ {_goal_text(file, goal, gait.loss_90)}"
            row["loss, worst tenth"] = _goal_text(file, goal, gait.loss_worst_tenth)
        rows.append(row)
    caption = (
        "Intervals and losses are over draws of the coefficients. Losses are against the best gait of each "
        "draw, over the draws that did not select the robust gait."
    )
    return blocks.table("gaits", "Gaits", rows, caption * bool(file.draws))


def _quantity_table(file: GaitFile) -> ev.Table:
    rows: list[dict[str, blocks.Cell]] = []
    for name, value in file.optimum.quantities.items():
        if value is not None:
            bare, unit = numbers.split_unit(name)
            factor, shown = numbers.in_degrees(unit)
            text = numbers.number(factor * value, 4, shown)
            rows.append({"quantity": bare.replace("_", " "), "value": text})
    return blocks.table("quantities", "Quantities of the best gait", rows)


def _axis_label(file: GaitFile, name: str) -> str:
    return f"{name} ({numbers.unit_text(file.vary[name].unit) or '1'})"


def _front_figure(file: GaitFile) -> ev.Figure:
    width = len(file.vary)
    factors, shown = zip(*(numbers.in_degrees(unit) for _, unit in file.goals.values()), strict=True)
    table = np.array(file.front, dtype=float)
    values = table[:, width:] * factors
    best = np.array(list(file.optimum.goals.values()), dtype=float) * factors
    labels = [f"{g} ({numbers.unit_text(u)})" for g, u in zip(file.goals, shown, strict=True)]
    error = None
    if file.front_ci95:
        error = 0.5 * factors[1] * np.ptp(np.array(file.front_ci95, dtype=float)[:, 2:], axis=1)
    traces = [
        ev.Trace(x=values[:, 0], y=values[:, 1], style="points", label="front", y_error=error),  # type: ignore[arg-type]
        ev.Trace(x=best[:1], y=best[1:], style="points", label="best gait"),
    ]
    panels = [blocks.panel(labels[0], labels[1], traces)]
    for k, name in enumerate(file.vary):
        trace = ev.Trace(x=values[:, 0], y=table[:, k], style="points")
        panels.append(blocks.panel(labels[0], _axis_label(file, name), [trace]))
    caption = "No gait is better in both goals than one of these; bars are 95 % intervals over draws."
    return blocks.panels("front", "Pareto front of two goals", caption, panels)


def _draws_figure(file: GaitFile) -> ev.Figure:
    gaits = {"best gait": file.optimum, "robust gait": file.robust}
    panels = []
    for name, column in zip(file.vary, np.array(file.drawn, dtype=float).T, strict=True):
        share = (np.arange(len(column)) + 0.5) / len(column)
        marks = [ev.Mark(at=gait.at[name], axis="x", label=word) for word, gait in gaits.items() if gait]
        trace = ev.Trace(x=np.sort(column), y=share, style="step", label="share of draws below")
        panels.append(blocks.panel(_axis_label(file, name), "share of draws", [trace], marks=marks))
    caption = "Distribution of the best gait over draws of the coefficients; a steep step is a certain gait."
    return blocks.panels("draws", "Uncertainty of the best gait", caption, panels)


def _methods(file: GaitFile) -> list[str]:
    varied = ", ".join(
        f"{name} ({numbers.number(v.low)} to {numbers.number(v.high, 4, v.unit)})"
        for name, v in file.vary.items()
    )
    search = "by finite differences from several starts"
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
            "The robust gait minimises the mean of the worst tenth of losses against the best gait of each "
            "draw (Rockafellar and Uryasev 2000) over half of the draws; losses are over the other half."
        )
    return sentences
