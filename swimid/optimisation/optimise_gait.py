"""Command ``optimise gait``: search for the best gait of a robot within limits, with its uncertainty."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np
from pydantic import Field

from swimid.errors import NoTrustworthyResult, UsageError, suggestion
from swimid.files import yamlio
from swimid.files.atomic import Checkpoint
from swimid.files.yamlio import Number, Pair, Rows
from swimid.fitting.model import Array
from swimid.kinematics.cycles import UNSTEADY
from swimid.notices import Notice, Progress, record_warnings, silent
from swimid.optimisation import study as studies
from swimid.optimisation.options import OptimiseGaitOptions
from swimid.optimisation.problem import MAX_STEPS, GaitProblem, Limit, interval95, merit
from swimid.optimisation.study import BEAT, STROKE, OptimisationStudy, Performance, StudyFile, study_of
from swimid.options import takes
from swimid.results import evidence as ev
from swimid.results import numbers
from swimid.results.result import FileResult
from swimid.simulation.cases import format_quantity
from swimid.simulation.catalogue import draw_parameters

#: Two tolerances. The first is the maximum distance from a bound at which a varied parameter counts as at
#: this bound, as a fraction of its range. The second is the relative distance at which a limit counts as
#: reached.
BOUND_TOL, ACTIVE_RTOL = 0.005, 0.01
#: Maximum relative difference between the goal values of the searches from two starting points at which the
#: searches count as agreeing.
AGREE_RTOL = 0.005
#: Settings of the search for a random sample of the coefficients: radius of the finite differences in the
#: first step, radius at the end, and maximum number of steps. Such a search starts from the optimum for the
#: estimated coefficients.
DRAW_RADIUS, DRAW_LAST, DRAW_STEPS = 0.03, 1e-3, 14
#: Minimum fraction of the random samples of the coefficients in which the best gait must satisfy its limits.
MIN_KEPT = 0.9
#: Number of points of a Sobol sequence that are tried for each starting point of the search.
N_POINTS_PER_START = 4


class Varied(yamlio.Document):
    """Range and unit of a varied parameter of the gait."""

    unit: str
    low: float
    high: float


class GaitFile(StudyFile):
    """Content of a gait file: best gait, quantities of its simulation in SI units, and uncertainty."""

    kind: ClassVar[str] = "gait file"
    format: Literal["swimid-gait/2"] = "swimid-gait/2"
    vary: dict[str, Varied]
    #: Name of the goal as in the option ``--goal``, name of the optimised quantity of the simulation, and
    #: unit of this quantity.
    goal: str
    quantity: str
    unit: str
    limits: dict[str, Limit] = {}
    #: Value of the goal, including penalties, at the end of the search from each starting point. The best
    #: value is first.
    ends: list[float] = []
    #: Values of the varied parameters at the best gait, and value of the goal at this gait.
    at: dict[str, float]
    best: float
    #: Varied parameters that lie at an end of their range. A better gait may lie beyond this end.
    at_bound: list[str] = []
    #: Names of the limits that the best gait reaches.
    held_by: list[str] = []
    quantities: dict[str, Number] = {}
    #: Number of random samples of the coefficients that were used, and fraction of all drawn samples that lay
    #: within the bounds of the coefficients. Only these are used.
    draws: int = 0
    inside: Number = None
    #: 95 % interval of each varied parameter of the best gait over the random samples of the coefficients.
    at_ci95: dict[str, Pair] = {}
    #: 95 % interval of the goal at the gait ``at`` over the random samples of the coefficients.
    best_ci95: Pair = (None, None)
    #: Fraction of the random samples of the coefficients in which the gait ``at`` satisfies all limits; None
    #: without limits.
    kept_in_draws: Number = None
    #: Best gait for each random sample of the coefficients: one row of parameters in the order of ``vary``.
    drawn: Rows = []
    provenance: yamlio.Provenance = Field(default_factory=dict)


class BestGait(FileResult[GaitFile]):
    """Best gait, the result of ``optimise gait``.

    Attributes
    ----------
    at : dict of str to float
        Values of the varied parameters at the best gait.
    file : GaitFile
        All results, including the intervals and the final goal of each search. :meth:`save` writes this file.
    """

    file_type = GaitFile

    @property
    def at(self) -> dict[str, float]:
        """Values of the varied parameters at the best gait."""
        return dict(self.file.at)


@takes(OptimiseGaitOptions)
def optimise_gait(
    *, options: OptimiseGaitOptions, output: Path | None = None, progress: Progress = silent
) -> BestGait:
    """Find the best gait of a robot within limits, with the uncertainty that follows from the coefficients.

    The goal is optimised by a gradient search with finite differences from several starting points. If the
    parameter file has standard errors, the search is repeated for random samples of the coefficients. These
    give the 95 % interval of the best gait.

    Parameters
    ----------
    output : path, optional
        Gait file to write. The evidence is written to the same folder.
    progress : Progress
        Shows the progress of the searches.

    Returns
    -------
    BestGait
        ``.at`` is the gait. ``.file`` also has the intervals.

    Raises
    ------
    UsageError, InputError
        If an option or a file is invalid.
    NoTrustworthyResult
        If every simulation diverges, or if no gait satisfies the limits.

    References
    ----------
    .. [1] "Locomotion Optimization of a Tendon-Driven Robotic Fish with Variable Passive Tail Fin".
       Section IV: gait and stiffness.

    Examples
    --------
    >>> found = optimise_gait(
    ...     robot="dolphin", amplitude_deg=27, frequency_hz=3, vary={"K_s": (0.1, 2.0)}, duration_s=6
    ... )
    >>> 0.3 < found.at["K_s"] < 0.9
    True
    """
    with record_warnings(repeat=True) as notices:
        performance = Performance.of_options(options)
        study = study_of(performance, options, output)
        problem = _problem(performance, options, study.checkpoint)
        known = bool(performance.applied.uncertain()[0])
        performance.model.prepare(progress)
        problem.performance = performance = performance.at_step(options.vary)
        file = _find(problem, options, study, progress)
        if known:
            performance.applied.warn_without_error("the intervals")
            _set_intervals(problem, file, options, progress)
    return study.save(BestGait, file, make_gait_evidence(file, notices, study.origin))


# ------------------------------------------------------------ the problem


def _problem(performance: Performance, options: OptimiseGaitOptions, keep: Checkpoint) -> GaitProblem:
    if not options.vary:
        hint = "give the range of each: --vary NAME=LOW,HIGH"
        raise UsageError("no parameter of the gait is varied", hint=hint)
    performance.check_gaits(options.vary, "--vary")
    turn = "yaw" if performance.model.in_space else performance.turn
    quantity, sign = {
        "speed": ("mean_speed_m_s", -1.0),
        "radius": ("turning_radius_m", 1.0),
        "turn-rate": (f"mean_{turn}_rate_rad_s", -1.0),
        "cost-of-transport": ("cost_of_transport_J_m", 1.0),
        "power": ("mean_positive_power_W", 1.0),
    }[options.goal]
    limits = _limits(performance, options)
    known = (*performance.units, "basin_m")
    if quantity not in known:
        names = ", ".join(performance.units)
        raise UsageError(f"--goal {options.goal} needs {quantity}, and this robot has only {names}")
    for name, limit in limits.items():
        if limit.quantity not in known:
            raise UsageError(
                f"--limit {name} needs {limit.quantity}, which this robot does not have: omit it"
            )
    if options.goal == "power" and options.reach_speed_m_s is None:
        text = "--goal power needs a speed; without a speed, no motion is the optimum"
        raise UsageError(text, hint="give the speed with --reach-speed-m-s")
    return GaitProblem(performance, options.vary, [(quantity, sign)], limits, checkpoint=keep)


def _limits(performance: Performance, options: OptimiseGaitOptions) -> dict[str, Limit]:
    known = {
        "torque_N_m": ("peak_torque_N_m", 1.0, "N m"),
        "joint_rate_deg_s": ("peak_joint_rate_rad_s", math.pi / 180.0, "rad/s"),
        "tank_m": ("basin_m", 1.0, "m"),
    }
    found = {}
    for name, value in options.limits.items():
        if name not in known:
            raise UsageError(f"--limit: '{name}' cannot be limited", hint=suggestion(name, list(known)))
        if not value > 0:
            raise UsageError(f"--limit {name}: {value:g} is not above zero")
        if name == "tank_m" and performance.model.body is None:
            raise UsageError("--limit tank_m is valid only for robots that move in a plane: omit it")
        quantity, factor, unit = known[name]
        found[name] = Limit(quantity=quantity, at_most=factor * value, unit=unit)
    if options.reach_speed_m_s is not None:
        speed = options.reach_speed_m_s
        found["reach_speed_m_s"] = Limit(quantity="mean_speed_m_s", at_least=speed, unit="m/s")
    return found


# ------------------------------------------------------------ searches


def _choose_starts(problem: GaitProblem, options: OptimiseGaitOptions) -> Array:
    """Return the best points of a Sobol sequence in the unit cube, as starting points of the search.

    Also set the typical scale of the goal in ``problem``, which the penalties need.
    """
    exponent = math.ceil(math.log2(N_POINTS_PER_START * options.starts))
    from scipy.stats import qmc

    points = qmc.Sobol(len(problem.vary), seed=options.seed).random_base2(exponent)
    table = problem.table(points)
    problem.performance.insist(table)
    wanted = problem.compute_objectives(table)[:, 0]
    if np.isfinite(wanted).any():
        problem.scale = float(np.nanmedian(np.abs(wanted)))
    return points[np.argsort(merit(problem.parts(table)), kind="stable")[: options.starts]]


def _find(
    problem: GaitProblem, options: OptimiseGaitOptions, study: OptimisationStudy, progress: Progress
) -> GaitFile:
    """Search for the best gait from several starting points; return it and its simulated quantities."""
    starts = _choose_starts(problem, options)
    with progress("search", total=MAX_STEPS) as step:
        found = problem.minimise(starts, advance=step)
    ((quantity, sign),) = problem.goals
    x, units = found.points[int(np.argmin(found.values))], problem.performance.units
    table = problem.table(x[None])
    if not problem.keeps_limits(table).all():
        text = "the search found no gait that satisfies the limits"
        raise NoTrustworthyResult(text, hint="widen the ranges of --vary, or relax the limits")
    best = float(problem.goal_values(table)[0, 0])
    if not math.isfinite(best):
        text = "the goal is undefined for every gait: for example, a robot that does not turn has no radius"
        raise NoTrustworthyResult(text)
    violations = np.abs(problem.violations(table)[0])
    axes = problem.performance.axes
    return GaitFile(
        **study.head,
        vary={n: Varied(unit=axes[n], low=low, high=high) for n, (low, high) in problem.vary.items()},
        goal=options.goal,
        quantity=quantity,
        unit=units[quantity],
        limits=dict(problem.limits),
        ends=(np.sort(found.values) * sign).tolist(),
        at=problem.at(x),
        best=best,
        at_bound=[n for n, v in zip(problem.vary, x, strict=True) if min(v, 1.0 - v) < BOUND_TOL],
        held_by=[n for n, v in zip(problem.limits, violations, strict=True) if v < ACTIVE_RTOL],
        quantities=dict(zip(units, table[0].tolist(), strict=True)),
    )


def _set_intervals(
    problem: GaitProblem, file: GaitFile, options: OptimiseGaitOptions, progress: Progress
) -> None:
    """Set the 95 % intervals of the best gait in ``file``, from random samples of the coefficients."""
    vectors, file.inside = draw_parameters(problem.performance.applied, options.draws, options.seed)
    file.draws = len(vectors)
    nominal = np.tile(problem.place(file.at), (len(vectors), 1))
    with progress("gaits of draws", total=DRAW_STEPS) as step:
        best = problem.minimise(
            nominal, vectors, first=DRAW_RADIUS, last=DRAW_LAST, steps=DRAW_STEPS, advance=step
        )
    file.drawn = [list(problem.at(x).values()) for x in best.points]
    ends = interval95(np.array(file.drawn, dtype=float)).T.tolist()
    file.at_ci95 = {name: (a, b) for name, (a, b) in zip(problem.vary, ends, strict=True)}
    table = problem.table(nominal, vectors)
    file.best_ci95 = tuple(interval95(problem.goal_values(table)[:, 0]).tolist())
    if problem.limits:
        file.kept_in_draws = float(problem.keeps_limits(table).mean())


# ------------------------------------------------------------ evidence


def make_gait_evidence(file: GaitFile, notices: Sequence[Notice], origin: dict[str, Any]) -> ev.Evidence:
    """Return the checks, tables and figures of the best gait that a search has found."""
    limits = [
        f"{name} {numbers.format_number(limit.at_most or limit.at_least, 4, limit.unit)}"
        for name, limit in file.limits.items()
    ]
    facts = {
        "Goal": file.goal,
        "Varied": ", ".join(file.vary),
        "Limits": ", ".join(limits) or "none",
        "Draws": str(file.draws or "none"),
    }
    figures = []
    if file.drawn:
        figures.append(_draws_figure(file))
    return studies.make_evidence(
        file, "optimise gait", answer(file), _checks(file), facts, notices, origin,
        tables=[_gait_table(file), _quantity_table(file)], figures=figures, methods=_methods(file),
    )  # fmt: skip


def _checks(file: GaitFile) -> list[ev.Check]:
    agree = sum(abs(end - file.ends[0]) <= AGREE_RTOL * abs(file.ends[0]) for end in file.ends)
    text = "a better gait may be elsewhere: look for more with --starts" * (agree <= 1)
    value = f"{agree} of {len(file.ends)}"
    name, reason = "starts that end at the best gait", f"only {value} starts end at the best gait"
    checks = [ev.make_check(name, value, agree > 1, "two or more", text, reason=reason)]
    bound = ", ".join(file.at_bound)
    text = f"a better gait may lie beyond the range of {bound}" * bool(bound)
    checks.append(
        ev.make_check("gait within its ranges", bound or "yes", not bound, "inside", text, reason=text)
    )
    checks += studies.forwards_check([file.quantities.get("mean_surge_from_start_m_s")])
    change, speed = (file.quantities.get(n) for n in ("speed_change_per_beat_m_s", "mean_speed_m_s"))
    if change is not None and speed:
        checks.append(studies.steady_check(int(abs(change / speed) <= UNSTEADY), 1))
    drive = {name: float(value) for name, value in file.drive.items() if name in BEAT | STROKE}
    checks.append(studies.region_check(file.identified, [{**drive, **file.at}]))
    if file.inside is None:
        return [*checks, studies.make_undefined_check("uncertainty of the gait")]
    checks.append(studies.draws_check(file.inside))
    if file.kept_in_draws is not None:
        passed, value = file.kept_in_draws >= MIN_KEPT, numbers.percent(file.kept_in_draws, 2)
        text = "leave a larger margin to the limits, or reduce the standard errors by trials" * (not passed)
        name, limit = "draws in which the limits are kept", f"≥ {numbers.percent(MIN_KEPT)}"
        checks.append(ev.make_check(name, value, passed, limit, text))
    return checks


def answer(file: GaitFile) -> str:
    """Return a sentence with the best gait, the value of its goal, and the limits that it reaches."""
    place = ", ".join(f"{n} {numbers.format_number(v, 4, file.vary[n].unit)}" for n, v in file.at.items())
    held = f", limited by {', '.join(file.held_by)}" * bool(file.held_by)
    return f"Best gait: {place}; {file.goal} {format_quantity(file.best, file.unit, digits=4)}{held}."


def _gait_table(file: GaitFile) -> ev.Table:
    """Return a table of the varied parameters and the goal of the best gait, with their intervals."""
    units = {name: v.unit for name, v in file.vary.items()} | {file.goal: file.unit}
    known = {**file.at_ci95, file.goal: file.best_ci95}
    rows: list[dict[str, ev.Cell]] = []
    for name, value in {**file.at, file.goal: file.best}.items():
        factor, shown = numbers.in_degrees(units[name])
        low, high = factor * np.array(known.get(name, (None, None)), dtype=float)
        row: dict[str, ev.Cell] = {"": name, "best gait": format_quantity(value, units[name], digits=4)}
        rows.append({**row, "95 %": numbers.interval(low, high, None, shown)})
    caption = "Intervals are over draws of the coefficients."
    return ev.make_table("gait", "Gait", rows, caption * bool(file.draws))


def _quantity_table(file: GaitFile) -> ev.Table:
    rows: list[dict[str, ev.Cell]] = []
    for name, value in file.quantities.items():
        if value is not None:
            bare, unit = numbers.split_unit(name)
            rows.append({"quantity": bare.replace("_", " "), "value": format_quantity(value, unit, digits=4)})
    return ev.make_table("quantities", "Quantities of the best gait", rows)


def _draws_figure(file: GaitFile) -> ev.Figure:
    panels = []
    for name, column in zip(file.vary, np.array(file.drawn, dtype=float).T, strict=True):
        share = (np.arange(len(column)) + 0.5) / len(column)
        mark = ev.Mark(at=file.at[name], axis="x", label="best gait")
        trace = ev.Trace(x=np.sort(column), y=share, style="step", label="share of draws below")
        label = f"{name} ({numbers.unit_text(file.vary[name].unit) or '1'})"
        panels.append(ev.panel(label, "share of draws", [trace], marks=[mark]))
    caption = "Distribution of the best gait over draws of the coefficients; a steep step is a certain gait."
    return ev.panels("draws", "Uncertainty of the best gait", caption, panels)


def _methods(file: GaitFile) -> list[str]:
    ranges = {name: numbers.interval(v.low, v.high, None, v.unit) for name, v in file.vary.items()}
    varied = ", ".join(f"{name} ({ends})" for name, ends in ranges.items())
    sentences = [
        f"The {file.goal} of {file.robot} was optimised over {varied} by finite differences from several "
        f"starts; each run of {file.duration_s:g} s began at rest and was judged by its last whole beats."
    ]
    if file.draws:
        sentences.append(
            f"Intervals are percentiles over {file.draws} draws of the coefficients from their covariance."
        )
    return sentences
