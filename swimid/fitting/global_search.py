"""Global search: fits from many starting points, and Pareto fronts of several objectives by NSGA-II."""

from __future__ import annotations

import functools
import math
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from swimid.errors import NoTrustworthyResult, extra_needed
from swimid.files.atomic import Checkpoint
from swimid.fitting import output_error
from swimid.fitting.model import Array, Model, Parameter, Trial
from swimid.fitting.output_error import UNFINISHED_ITERATIONS, FitResult
from swimid.fitting.problem import Problem
from swimid.notices import Progress, show, silent

#: Maximum relative difference between the costs of two fits that count as the same minimum.
SAME_COST_RTOL = 1e-3


class Start(NamedTuple):
    """Starting point and end point of one search of a multistart fit, shape (p,) each.

    If the search failed, the end point is NaN and the cost is infinite.
    """

    start: Array
    end: Array
    cost: float
    converged: bool


def multistart(
    model: Model,
    trials: Sequence[Trial],
    parameters: Sequence[Parameter] | None = None,
    *,
    starts: int = 8,
    seed: int = 0,
    begins: Sequence[Array] | None = None,
    jobs: int | None = None,
    max_iterations: int = UNFINISHED_ITERATIONS,
    first: FitResult | None = None,
    progress: Progress = silent,
) -> tuple[FitResult, list[Start]]:
    """Fit from several starting points, and return the best fit.

    Parameters
    ----------
    model, trials, parameters, jobs, max_iterations
        As in :func:`swimid.fitting.output_error.fit_output_error`.
    starts : int
        Number of starting points: ``begins``, and uniform random samples of the search range.
    begins : sequence of ndarray, each shape (p,), optional
        Starting points that are used first. The default is the start values of the parameters.
    first : FitResult, optional
        Result of the fit from the first starting point, if it is already known.

    Returns
    -------
    best : FitResult
        Fit of the lowest cost, tested as in :func:`swimid.fitting.output_error.check_by_restarts`.
    ends : list of Start
        Starting points and end points in the order of the searches, up to an interruption by Ctrl-C.

    Raises
    ------
    NoTrustworthyResult
        If all searches fail: the error of the first search.
    """
    parameters = tuple(parameters or model.parameters)
    points = _draw_starts(model, trials, parameters, begins, starts, seed)
    fit_from = functools.partial(
        output_error.fit_output_error, model, trials,
        parameters=parameters, jobs=jobs, tested=False, max_iterations=max_iterations,
    )  # fmt: skip
    ends: list[Start] = []
    outcomes: list[FitResult | NoTrustworthyResult] = []
    with progress("starts", total=starts) as step:
        for begin in points:
            try:
                result, first = first or fit_from(begin=begin), None
            except KeyboardInterrupt:
                if not any(isinstance(one, FitResult) for one in outcomes):
                    raise
                break
            except NoTrustworthyResult as error:
                outcomes.append(error)
                ends.append(Start(begin, np.full(len(begin), np.nan), math.inf, False))
            else:
                outcomes.append(result)
                ends.append(Start(begin, result.estimate, result.cost, result.converged))
                if result.interrupted:
                    break
            step()
            least = min(end.cost for end in ends)
            show(step, f"least cost {least:.5g}, reached {count_agreeing(ends)} times")
    return _select_best(outcomes, jobs or os.cpu_count() or 1), ends


def _draw_starts(
    model: Model,
    trials: Sequence[Trial],
    parameters: Sequence[Parameter],
    begins: Sequence[Array] | None,
    starts: int,
    seed: int,
) -> list[Array]:
    """Return the starting points of a multistart fit (see :func:`multistart`)."""
    problem = Problem(model, parameters, [t for t in trials if t.role == "fit"])
    rng = np.random.default_rng(seed)
    low, high = problem.search_range()
    points = list(begins or [problem.start])[:starts]
    return points + [rng.uniform(low, high) for _ in range(starts - len(points))]


def _select_best(outcomes: Sequence[FitResult | NoTrustworthyResult], jobs: int) -> FitResult:
    """Return the best of several fits, tested by restarts; raise the first failure if all fits failed."""
    results = [one for one in outcomes if isinstance(one, FitResult)]
    failures = [one for one in outcomes if isinstance(one, NoTrustworthyResult)]
    if not results:
        raise failures[0]
    best = plain = functools.reduce(_better, results)
    if best.converged:
        best = output_error.check_by_restarts(best, jobs=jobs)
    evaluations = best.evaluations - plain.evaluations + sum(r.evaluations for r in results)
    return replace(best, evaluations=evaluations)


def count_agreeing(ends: Sequence[Start]) -> int:
    """Return the number of searches of a multistart fit that ended at the lowest cost.

    Only costs are compared. End points of equal cost may differ in directions that the data do not determine.

    >>> where = np.zeros(1)
    >>> count_agreeing([Start(where, where, cost, True) for cost in (1.0, 1.0005, 2.0)])
    2
    """
    least = min((e.cost for e in ends), default=math.inf)
    return sum(e.cost <= least * (1 + SAME_COST_RTOL) for e in ends)


def _better(best: FitResult, other: FitResult) -> FitResult:
    """Return the better of two fits: the one with the lower cost.

    If their costs belong to the same minimum, a converged fit is preferred.
    """
    same = max(other.cost, best.cost) <= min(other.cost, best.cost) * (1 + SAME_COST_RTOL)
    return min(best, other, key=lambda result: (same and not result.converged, result.cost))


# ---------------------------------------------------------------- several objectives


#: Settings of NSGA-II from section II of Kadapa et al. on a bio-robotic sea lion: population size, number of
#: generations, and crossover probability.
POPULATION, GENERATIONS, CROSSOVER = 80, 50, 0.8
#: Value of all objectives of a genetic search for a point at which the simulation diverges.
BROKEN_OBJECTIVE = 1e9


@dataclass(frozen=True)
class Front:
    """Pareto front: points of which none is better than another one in every objective."""

    #: Points, sorted by the first objective, shape (n, d) for n points with d coordinates.
    points: Array
    #: Values of the m objectives at the points, shape (n, m).
    objectives: Array
    evaluations: int


def knee(objectives: Array) -> int:
    """Return the index of the point of a Pareto front that is nearest to the ideal point.

    The objectives of n points have the shape (n, m). Each is divided by its range on the front. The ideal
    point has the lowest value of each objective (Miettinen 1999, Nonlinear Multiobjective Optimization,
    section 2.2).

    >>> knee(np.array([[0.0, 1.0], [0.2, 0.2], [1.0, 0.0]]))
    1
    """
    low, span = objectives.min(axis=0), np.ptp(objectives, axis=0)
    scaled = (objectives - low) / np.where(span > 0, span, 1.0)
    return int(np.argmin(np.linalg.norm(scaled, axis=1)))


def least_worst(objectives: Array) -> int:
    """Return the index of the point of a Pareto front whose worst objective is best.

    The m objectives of n points have the shape (n, m). Each objective is divided by its lowest value on the
    front. The worst objective of a point has the largest ratio.

    >>> least_worst(np.array([[1.0, 9.0], [2.0, 4.0], [8.0, 2.0]]))
    1
    """
    best = np.maximum(objectives.min(axis=0), 1e-12)
    return int(np.argmin(np.max(objectives / best, axis=1)))


def nsga2(
    evaluate: Callable[[Array], Array],
    lower: Array,
    upper: Array,
    *,
    objectives: int,
    population: int = POPULATION,
    generations: int = GENERATIONS,
    seed: int = 0,
    first: Array | None = None,
    checkpoint: Checkpoint | None = None,
    name: str = "front",
    advance: Callable[[], Any] = lambda: None,
) -> Front:
    """Search for the Pareto front of several objectives by NSGA-II (Deb et al., doi:10.1109/4235.996017).

    Parameters
    ----------
    evaluate : callable
        Function from points, shape (n, d), to their objectives, shape (n, m). The points lie within the
        finite bounds ``lower`` and ``upper``, shape (d,).
    objectives : int
        Number of objectives, m.
    population, generations, seed
        Population size, number of generations and random seed. The same seed gives the same front.
    first : ndarray, shape (d,), optional
        A point of the first population.
    checkpoint : Checkpoint, optional
        Storage for the objectives of every generation, under ``name``, from which a search is resumed.
    advance : callable
        Function that is called after each generation.
    """
    with extra_needed("a genetic search", "search"):
        from pymoo.algorithms.moo.nsga2 import NSGA2
        from pymoo.core.evaluator import Evaluator
        from pymoo.core.problem import Problem
        from pymoo.operators.crossover.sbx import SBX
        from pymoo.operators.mutation.pm import PM
        from pymoo.problems.static import StaticProblem

    keep = checkpoint or Checkpoint()
    problem = Problem(n_var=len(lower), n_obj=objectives, xl=lower, xu=upper)
    begin = np.random.default_rng(seed).uniform(lower, upper, (population, len(lower)))
    if first is not None:
        begin[0] = np.clip(first, lower, upper)
    algorithm = NSGA2(
        pop_size=population, sampling=begin, crossover=SBX(prob=CROSSOVER, eta=15), mutation=PM(eta=20)
    )
    algorithm.setup(problem, termination=("n_gen", generations), seed=seed, verbose=False)
    evaluations = 0
    for generation in range(generations):
        asked = algorithm.ask()
        points = np.asarray(asked.get("X"), dtype=float)

        def objectives_of(points: Array = points) -> Array:
            return np.nan_to_num(evaluate(points), nan=BROKEN_OBJECTIVE, posinf=BROKEN_OBJECTIVE).ravel()

        found = keep.get_or_compute(f"{name}: generation {generation}", objectives_of).reshape(-1, objectives)
        Evaluator().eval(StaticProblem(problem, F=found), asked)
        algorithm.tell(infills=asked)
        evaluations += len(points)
        advance()
    best = algorithm.opt
    points, values = np.asarray(best.get("X"), dtype=float), np.asarray(best.get("F"), dtype=float)
    order = np.lexsort(values.T[::-1])
    return Front(points[order], values[order], evaluations)
