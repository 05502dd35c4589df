"""The same fit from many starts: is the minimum found the only one?"""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from swimid.errors import NoTrustworthyResult
from swimid.fitting import output_error
from swimid.fitting.fit_result import FitResult, Loss
from swimid.fitting.model import Array, Model, Parameter, Trial
from swimid.fitting.problem import Problem
from swimid.progress import Progress, show, silent

#: Two ends whose costs differ by less than this, relatively, are the same minimum.
SAME = 1e-3


class Start(NamedTuple):
    """One start and where it led, shape (p,) each: to NaN, at infinite cost, where the search failed."""

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
    loss: Loss = "linear",
    first: FitResult | None = None,
    progress: Progress = silent,
) -> tuple[FitResult, list[Start]]:
    """Fit from several starts and keep the best.

    Parameters
    ----------
    model, trials, parameters, jobs, loss
        As :func:`swimid.fitting.output_error.fit` takes them.
    starts : int
        The first are ``begins``; the others are uniform within the bounds, or within one scale of
        the start on a side without a bound.
    begins : sequence of ndarray, each shape (p,), optional
        Default the parameters' own start alone.
    first : FitResult, optional
        Fit from the first start, where it is known.

    Returns
    -------
    best : FitResult
        Of the fit with the least cost; a converged one where both are the same minimum (:data:`SAME`). A
        converged one is tested as :func:`swimid.fitting.output_error.held_to_restarts` does.
    ends : list of Start
        In the order they were run. After Ctrl-C those still to come are left out.

    Raises
    ------
    NoTrustworthyResult
        When no start leads anywhere: the first start's error.
    """
    parameters = tuple(parameters or model.parameters)
    problem = Problem(model, parameters, [t for t in trials if t.role == "fit"])
    rng = np.random.default_rng(seed)
    low, high = problem.box()
    given = [problem.start] if begins is None else list(begins)
    best: FitResult | None = None
    ends: list[Start] = []
    failure: NoTrustworthyResult | None = None
    results: list[FitResult] = []
    with progress("starts", total=starts) as step:
        for k in range(starts):
            begin = given[k] if k < len(given) else rng.uniform(low, high)
            try:
                if first is not None and k == 0:
                    found = first
                else:
                    found = output_error.fit(
                        model, trials, parameters=parameters,
                        jobs=jobs, loss=loss, begin=begin, tested=False, unfinished=True,
                    )  # fmt: skip
            except KeyboardInterrupt:
                if best is None:
                    raise
                break
            except NoTrustworthyResult as error:
                failure = failure or error
                ends.append(Start(begin, np.full(len(begin), np.nan), math.inf, False))
            else:
                ends.append(Start(begin, found.estimate, found.cost, found.converged))
                results.append(found)
                if best is None or _is_better(found, best):
                    best = found
                if found.interrupted:
                    break
            step()
            if best is not None:
                show(step, f"least cost {best.cost:.5g}, reached {agreeing(ends)} times")
    if best is None:
        assert failure is not None
        raise failure
    threads = jobs or os.cpu_count() or 1
    found = output_error.held_to_restarts(best, jobs=threads) if best.converged else best
    others = [r for r in results if r is not best]
    evaluations = found.evaluations + sum(r.evaluations for r in others)
    return replace(
        found, evaluations=evaluations, jacobians=found.jacobians + sum(r.jacobians for r in others)
    ), ends


def agreeing(ends: Sequence[Start]) -> int:
    """Number of starts that reached the lowest cost.

    Directions the data do not see may differ between equal minima, so parameters are not compared.

    >>> where = np.zeros(1)
    >>> agreeing([Start(where, where, cost, True) for cost in (1.0, 1.0005, 2.0)])
    2
    """
    least = min((e.cost for e in ends), default=math.inf)
    return sum(e.cost <= least * (1 + SAME) for e in ends)


def _is_better(found: FitResult, best: FitResult) -> bool:
    """Whether a fit takes the place of the best one so far: lower, or as low and converged."""
    if max(found.cost, best.cost) <= min(found.cost, best.cost) * (1 + SAME):
        return (not found.converged, found.cost) < (not best.converged, best.cost)
    return found.cost < best.cost
