"""Several objectives at once: the Pareto front by a genetic algorithm, and the choice of a point on it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from swimid.errors import extra_needed
from swimid.files.checkpoint import Checkpoint
from swimid.fitting.model import Array

#: The sea lion paper's settings (section II).
POPULATION, GENERATIONS, CROSSOVER = 80, 50, 0.8
#: An objective of a simulation that broke down.
BROKEN_OBJECTIVE = 1e9


@dataclass(frozen=True)
class Front:
    """The points of which none is better than another in every objective."""

    #: Shape (n, d): in the order of the first objective.
    points: Array
    #: Shape (n, m).
    objectives: Array
    #: Shape (generations, m): smallest value of each objective in the population of each generation.
    history: Array
    evaluations: int


def knee(objectives: Array) -> int:
    """The point nearest to the best of every objective, shape (n, m), each over its range on the front.

    The ideal-point rule (Miettinen 1999, Nonlinear Multiobjective Optimization, section 2.2).

    >>> knee(np.array([[0.0, 1.0], [0.2, 0.2], [1.0, 0.0]]))
    1
    """
    low, span = objectives.min(axis=0), np.ptp(objectives, axis=0)
    scaled = (objectives - low) / np.where(span > 0, span, 1.0)
    return int(np.argmin(np.linalg.norm(scaled, axis=1)))


def least_worst(objectives: Array) -> int:
    """The point whose worst objective, over the least of that objective on the front, is smallest.

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
    crossover: float = CROSSOVER,
    seed: int = 0,
    first: Array | None = None,
    checkpoint: Checkpoint | None = None,
    name: str = "front",
    advance: Callable[[], Any] = lambda: None,
) -> Front:
    """The front by NSGA-II (Deb et al. 2002, doi:10.1109/4235.996017).

    Parameters
    ----------
    evaluate : callable
        Objectives, shape (n, m), of points, shape (n, d), within finite bounds, shape (d,).
    objectives : int
        m.
    population, generations, crossover, seed
        Size, number of generations, probability of crossover; the same seed gives the same front.
    first : ndarray, shape (d,), optional
        A point that takes part from the beginning.
    checkpoint : Checkpoint, optional
        Keeps the objectives of every generation under ``name``: a search that was stopped is repeated with
        them up to there and goes on as if nothing had happened.
    advance : callable
        Called after each generation.
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
        pop_size=population, sampling=begin, crossover=SBX(prob=crossover, eta=15), mutation=PM(eta=20)
    )
    algorithm.setup(problem, termination=("n_gen", generations), seed=seed, verbose=False)
    history: list[Array] = []
    evaluations = 0
    while algorithm.has_next():
        asked = algorithm.ask()
        points = np.asarray(asked.get("X"), dtype=float)
        label = f"{name}: generation {len(history)}"
        found = _kept(keep, label, points, objectives)
        if found is None:
            found = np.nan_to_num(evaluate(points), nan=BROKEN_OBJECTIVE, posinf=BROKEN_OBJECTIVE)
            keep.put(label, np.concatenate([points.ravel(), found.ravel()]))
        Evaluator().eval(StaticProblem(problem, F=found), asked)
        algorithm.tell(infills=asked)
        history.append(np.asarray(algorithm.pop.get("F")).min(axis=0))
        evaluations += len(points)
        advance()
    best = algorithm.opt
    points, values = np.asarray(best.get("X"), dtype=float), np.asarray(best.get("F"), dtype=float)
    order = np.lexsort(values.T[::-1])
    return Front(points[order], values[order], np.array(history), evaluations)


def _kept(checkpoint: Checkpoint, label: str, points: Array, objectives: int) -> Array | None:
    """Objectives an earlier search found for just these points."""
    known = checkpoint.get(label)
    if known is None or len(known) != points.size + len(points) * objectives:
        return None
    if not np.array_equal(known[: points.size], points.ravel()):
        return None
    return known[points.size :].reshape(len(points), objectives)
