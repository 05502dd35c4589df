"""``optimise gait``: the best gait within limits, how sure it is, and a robust one beside it."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from swimid.errors import NoTrustworthyResult, UsageError, suggestion
from swimid.files import atomic
from swimid.files.checkpoint import Checkpoint
from swimid.fitting import global_search
from swimid.fitting.model import Array
from swimid.notices import recorded
from swimid.optimisation import gait_evidence
from swimid.optimisation.descent import STEPS, descend, merit
from swimid.optimisation.draws import drawn
from swimid.optimisation.gait_file import FORMAT, Gait, GaitFile, Limit, Varied
from swimid.optimisation.options import OptimiseGaitOptions
from swimid.optimisation.performance import Performance, Study, study_of
from swimid.optimisation.problem import DRAW_STEPS, Problem
from swimid.options import takes
from swimid.progress import Progress, silent
from swimid.results.result import FileResult

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

    format = FORMAT
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
    evidence = gait_evidence.evidence(file, notices, study.origin)
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
