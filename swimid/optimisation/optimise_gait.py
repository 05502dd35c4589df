"""``optimise gait``: the best gait within limits, how sure it is, and a robust one beside it."""

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
from swimid.files.checkpoint import Checkpoint
from swimid.files.yamlio import Number, Pair, Rows
from swimid.fitting import global_search
from swimid.fitting.model import Array
from swimid.logs.kinematics import UNSTEADY
from swimid.notices import Notice, recorded
from swimid.optimisation import study as studies
from swimid.optimisation.options import OptimiseGaitOptions
from swimid.optimisation.performance import BEAT, STROKE, Performance
from swimid.optimisation.problem import DRAW_STEPS, STEPS, Limit, Problem, descend, drawn, merit
from swimid.optimisation.study import Study, StudyFile, study_of
from swimid.options import takes
from swimid.progress import Progress, silent
from swimid.results import blocks, numbers
from swimid.results import evidence as ev
from swimid.results.result import FileResult


class Varied(yamlio.Document):
    """What may be changed."""

    unit: str
    low: float
    high: float


class Gait(yamlio.Document):
    """A gait, with what the robot comes to."""

    at: dict[str, float]
    #: At an end of its range: a better gait may lie beyond.
    at_bound: list[str] = []
    #: Limits that hold it back.
    held_by: list[str] = []
    #: Of each goal; SI units.
    goals: dict[str, Number]
    quantities: dict[str, Number] = {}
    #: 95 % interval of each goal at this gait, from the coefficients' covariance.
    goals_ci95: dict[str, Pair] = {}
    #: 95 % interval of the best gait: where it lies in draws of the coefficients.
    at_ci95: dict[str, Pair] = {}
    #: What it loses against the best gait of each draw (in the goal's unit): in nine of ten draws at most,
    #: and on the average of the worst tenth; over draws that were not used to find it.
    loss_90: Number = None
    loss_worst_tenth: Number = None
    #: Share of draws in which it keeps to its limits; missing where it has none.
    kept_in_draws: Number = None


class GaitFile(StudyFile):
    """A gait file."""

    kind: ClassVar[str] = "gait file"
    format: Literal["swimid-gait/2"] = "swimid-gait/2"
    vary: dict[str, Varied]
    #: In the words of the options, and the quantity and unit of each.
    goals: dict[str, tuple[str, str]]
    limits: dict[str, Limit] = {}
    #: Value of the goal, with the penalties of the limits, at which the search from each start ended; the
    #: best first; empty for two goals.
    ends: list[float] = []
    optimum: Gait
    #: The gait that loses least in the worst tenth of draws; the best one where no other loses less.
    robust: Gait | None = None
    #: Number of draws of the coefficients, and the share of draws within the coefficients' bounds.
    draws: int = 0
    inside: Number = None
    #: Best gait of each draw, in the order of ``vary``; none for two goals.
    drawn: Rows = []
    #: Of two goals: the front, what is varied and then the goals; and the 95 % interval of each goal of each
    #: of these gaits, low and high.
    front: Rows = []
    front_ci95: Rows = []
    provenance: dict[str, Any] = Field(default_factory=dict)


#: A gait lies at an end of its range within this share of the range; a limit holds a gait back within this
#: share of the limit.
BOUND_TOL, LIMIT_TOL = 0.005, 0.01
#: First radius, last radius and number of steps of the search for the robust gait.
ROBUST_RADIUS, ROBUST_LAST, ROBUST_STEPS = 0.05, 0.005, 10
#: Share of draws that counts as the worst.
WORST = 0.1


@dataclass(frozen=True, eq=False)
class BestGait(FileResult[GaitFile]):
    """The best gait, as ``optimise gait`` gives it.

    Attributes
    ----------
    at : dict of str to float
        The best gait: what was varied.
    file : GaitFile
        What :meth:`save` writes; it also has intervals, the robust gait and the searches.
    """

    file_type = GaitFile

    @property
    def at(self) -> dict[str, float]:
        """What was varied, at the best gait."""
        return dict(self.file.optimum.at)


@takes(OptimiseGaitOptions)
def optimise_gait(
    *, options: OptimiseGaitOptions, output: Path | None = None, progress: Progress = silent
) -> BestGait:
    """The best gait of a robot within limits, with the uncertainty of its coefficients.

    One goal is searched by differences from several starts, two goals by NSGA-II. With a parameter file that
    has standard errors the search is repeated in draws of the coefficients: they say where the best gait may
    lie, and how much the one that was found loses. The robust gait loses least on the average of the worst
    tenth of draws.

    Parameters
    ----------
    output : path, optional
        Gait file to write; its evidence goes beside it.
    progress : Progress
        Shows the searches.

    Returns
    -------
    BestGait
        ``.at`` is the gait; the file has intervals, the robust gait, and the front of two goals.

    Raises
    ------
    UsageError, InputError
        For bad options and files.
    NoTrustworthyResult
        When every run breaks down, or no gait keeps to the limits.

    References
    ----------
    .. [1] "Locomotion Optimization of a Tendon-Driven Robotic Fish with Variable Passive Tail Fin".
       Section IV: gait and stiffness.
    .. [2] Deb, Pratap, Agarwal, Meyarivan (2002), doi:10.1109/4235.996017: NSGA-II.
    .. [3] Rockafellar, Uryasev (2000), doi:10.21314/JOR.2000.038: the average of the worst share of outcomes.

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
        single = len(options.goals) == 1
        file = (_one if single else _front)(problem, options, study, progress)
        if known:
            performance.applied.warn_without_error("the intervals")
            draws = drawn(performance.applied, options.draws, options.seed)
            file.draws, file.inside = len(draws.vectors), draws.inside
            (_one_in_draws if single else _front_in_draws)(problem, file, draws.vectors, progress)
    evidence = evidence_of(file, notices, study.origin)
    file.verdict = evidence.verdict.level
    saved = BestGait.of(file, evidence).saved(output)
    keep.done()
    return saved


# ------------------------------------------------------------ what is asked


def _simulated_s(options: OptimiseGaitOptions, uncertain: bool) -> float:
    stencil = 2 * len(options.vary) + 1
    if len(options.goals) == 2:
        runs = options.population * (options.generations + options.draws * uncertain)
    else:
        runs = (options.starts * STEPS + options.draws * (DRAW_STEPS + ROBUST_STEPS) * uncertain) * stencil
    return runs * options.duration_s


def _problem(performance: Performance, options: OptimiseGaitOptions, keep: Checkpoint) -> Problem:
    """The problem the options describe."""
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
    return Problem(
        performance,
        options.vary,
        goals,
        limits,
        efficiency=options.efficiency,
        jobs=options.jobs or os.cpu_count() or 1,
        checkpoint=keep,
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


def _begun(problem: Problem, options: OptimiseGaitOptions) -> Array:
    """Starts of the search: the best of a Sobol sequence in the cube; sets the goal's size."""
    from scipy.stats import qmc

    # four points for each start, in a whole power of two as the sequence asks
    exponent = math.ceil(math.log2(4 * options.starts))
    points = qmc.Sobol(len(problem.vary), seed=options.seed).random_base2(exponent)
    table = problem.table(points)
    problem.performance.insist(table)
    wanted = problem.wanted(table)[:, 0]
    if np.isfinite(wanted).any():
        problem.scale = float(np.nanmedian(np.abs(wanted)))
    return points[np.argsort(merit(problem.parts(table)), kind="stable")[: options.starts]]


def _file(problem: Problem, study: Study, optimum: Array, **found: Any) -> GaitFile:
    """The gait file of what was found."""
    return GaitFile(
        **study.said,
        vary={
            name: Varied(unit=problem.performance.axes[name], low=low, high=high)
            for name, (low, high) in problem.vary.items()
        },
        goals={goal: (q, problem.performance.units[q]) for goal, q, _ in problem.goals},
        limits=dict(problem.limits),
        optimum=_gait(problem, optimum),
        **found,
    )


def _one(problem: Problem, options: OptimiseGaitOptions, study: Study, progress: Progress) -> GaitFile:
    """The best gait for one goal."""
    starts = _begun(problem, options)
    with progress("search", total=STEPS) as step:
        found = problem.minimise(starts, advance=step)
    ends = np.sort(found.values) * problem.signs[0]
    return _file(problem, study, found.points[found.best], ends=ends.tolist())


def _front(problem: Problem, options: OptimiseGaitOptions, study: Study, progress: Progress) -> GaitFile:
    """The Pareto front of two goals, and the point on it that is nearest to the best of both."""
    _begun(problem, options)
    with progress("NSGA-II", total=options.generations) as step:
        front = problem.front(options.population, options.generations, options.seed, advance=step)
    if not len(front):
        raise NoTrustworthyResult("no gait keeps to the limits", hint="widen what is varied, or the limits")
    points, values = front[:, :-2], front[:, -2:]
    gaits = np.array([list(problem.at(x).values()) for x in points])
    rows = np.hstack([gaits, values * problem.signs])
    return _file(problem, study, points[global_search.knee(values)], front=rows)


def _gait(problem: Problem, x: Array) -> Gait:
    """A point of the cube as a gait, with what the robot comes to there."""
    table = problem.table(x[None])
    if not problem.keeps(table).all():
        raise NoTrustworthyResult("no gait keeps to the limits", hint="widen what is varied, or the limits")
    values = problem.goal_values(table)[0]
    if not np.isfinite(values).all():
        raise NoTrustworthyResult("the goal has no value anywhere: a robot that does not turn has no radius")
    at = problem.at(x)
    violations = np.abs(problem.passed(table)[0])
    return Gait(
        at=at,
        at_bound=[n for n, v in zip(at, x, strict=True) if min(v, 1.0 - v) < BOUND_TOL],
        held_by=[n for n, v in zip(problem.limits, violations, strict=True) if v < LIMIT_TOL],
        goals={goal: float(v) for (goal, _, _), v in zip(problem.goals, values, strict=True)},
        quantities={name: float(v) for name, v in zip(problem.performance.units, table[0], strict=True)},
    )


# ------------------------------------------------------------ how sure it is


def _interval(values: Array) -> Array:
    """Ends of the 95 % interval over draws, shape (2, ...)."""
    return np.asarray(np.nanquantile(values, [0.025, 0.975], axis=0, method="weibull"))


def _front_in_draws(problem: Problem, file: GaitFile, vectors: Sequence[Array], progress: Progress) -> None:
    """What the gaits of a front come to in draws of the coefficients.

    The front itself is that of the estimates.
    """
    width, best = len(problem.vary), list(file.optimum.at.values())
    with progress("front in draws", total=len(file.front)) as step:
        for row in file.front:
            gait = dict(zip(problem.vary, row[:width], strict=True))
            table, _ = problem.costs(problem.place(gait), vectors)  # type: ignore[arg-type]
            ends = _interval(problem.goal_values(table)).T
            file.front_ci95.append([*ends.ravel().tolist()])
            if row[:width] == best:
                _tell(problem, file.optimum, table)
            step()


def _tell(problem: Problem, gait: Gait, table: Array) -> None:
    """What a gait comes to in draws, and in how many of them it keeps to the limits."""
    ends = _interval(problem.goal_values(table)).T.tolist()
    gait.goals_ci95 = {goal: (a, b) for (goal, _, _), (a, b) in zip(problem.goals, ends, strict=True)}
    if problem.limits:
        gait.kept_in_draws = float(problem.keeps(table).mean())


def _one_in_draws(problem: Problem, file: GaitFile, vectors: Sequence[Array], progress: Progress) -> None:
    """Intervals from draws of the coefficients, and the robust gait."""
    nominal = problem.place(file.optimum.at)
    with progress("gaits of draws", total=DRAW_STEPS) as step:
        best = problem.minimise_in_draws(vectors, nominal, step)
    file.drawn = [list(problem.at(x).values()) for x in best.points]
    ends = _interval(np.array(file.drawn, dtype=float)).T.tolist()
    file.optimum.at_ci95 = {name: (a, b) for name, (a, b) in zip(problem.vary, ends, strict=True)}
    # the robust gait is chosen with one half of the draws, and tried with the other
    robust = _robust(problem, vectors[::2], best.points[::2], best.values[::2], nominal, progress)
    (table, cost), (robust_table, robust_cost) = (problem.costs(x, vectors) for x in (nominal, robust))
    least = np.minimum(best.values, np.minimum(cost, robust_cost))
    lost, robust_lost = (cost - least)[1::2], (robust_cost - least)[1::2]
    _lose(problem, file.optimum, table, lost)
    file.robust = file.optimum.model_copy(update={"at_ci95": {}})
    keeps = problem.keeps(problem.table(robust[None])).all()
    if keeps and worst_tenth(robust_lost) < worst_tenth(lost):
        file.robust = _gait(problem, robust)
        _lose(problem, file.robust, robust_table, robust_lost)


def _lose(problem: Problem, gait: Gait, table: Array, lost: Array) -> None:
    """What a gait comes to in draws, and what it loses in those it was not chosen with."""
    _tell(problem, gait, table)
    gait.loss_90 = float(np.quantile(lost, 1.0 - WORST))
    gait.loss_worst_tenth = worst_tenth(lost)


def worst_tenth(lost: Array) -> float:
    """Average of the worst tenth of losses.

    >>> worst_tenth(np.arange(20.0))
    18.5
    """
    count = max(round(WORST * len(lost)), 1)
    return float(np.sort(lost)[-count:].mean())


def _robust(
    problem: Problem,
    vectors: Sequence[Array],
    points: Array,
    values: Array,
    nominal: Array,
    progress: Progress,
) -> Array:
    """The point that loses least in the worst tenth of draws, whose best points and values are given."""

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


#: Two starts of the search end at the same value within this share of it.
AGREE_RTOL = 0.005
#: Smallest share of draws of the coefficients in which the limits are kept.
MIN_KEPT = 0.9


def evidence_of(file: GaitFile, notices: Sequence[Notice], origin: dict[str, Any]) -> ev.Evidence:
    """Return the evidence of a gait."""
    limits = [
        f"{name} {numbers.number(limit.at_most or limit.at_least, 4, limit.unit)}"
        for name, limit in file.limits.items()
    ]
    return studies.evidence(
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
        figures=[
            *([_front_figure(file)] if file.front else []),
            *([_drawn_figure(file)] if file.drawn else []),
        ],
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
        name, reason = "starts that end at the best gait", f"{value} starts end at it"
        checks.append(ev.check(name, value, agree > 1, "two or more", text, reason=reason))
    bound = ", ".join(optimum.at_bound)
    text = f"a better gait may lie beyond the range of {bound}" if bound else ""
    checks.append(ev.check("gait within its ranges", bound or "yes", not bound, "inside", text, reason=text))
    checks += studies.forwards_check([optimum.quantities.get("mean_surge_from_start_m_s")])
    change, speed = (optimum.quantities.get(n) for n in ("speed_change_per_beat_m_s", "mean_speed_m_s"))
    if change is not None and speed:
        checks.append(studies.steady_check(int(abs(change / speed) <= UNSTEADY), 1))
    drive = {name: float(value) for name, value in file.drive.items() if name in BEAT | STROKE}
    checks.append(studies.region_check(file.identified, [{**drive, **optimum.at}]))
    if file.inside is None:
        return [*checks, studies.unknown_check("uncertainty of the gait")]
    return [*checks, studies.draws_check(file.inside), *_kept_check(file)]


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


def _span(ends: Sequence[str]) -> str:
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
            row[f"{name}, 95 %"] = _span([numbers.number(e) for e in gait.at_ci95.get(name, ())])
        for goal, reached in gait.goals.items():
            row[goal] = _goal(file, goal, reached)
            row[f"{goal}, 95 %"] = _span([_goal(file, goal, e) for e in gait.goals_ci95.get(goal, ())])
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


def _front_figure(file: GaitFile) -> ev.Figure:
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


def _drawn_figure(file: GaitFile) -> ev.Figure:
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
