"""Tests whether the end point of a search is a minimum, and profile-likelihood intervals.

No point near the estimates, and no short search from such a point, may reach a lower cost than the estimates.
A search ends where its local model of the cost predicts no decrease. Such a point need not be a minimum if
the cost is not smooth, as with dry friction, or if a bound holds a parameter.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import optimize, special

from swimid.fitting.metrics import FitResult
from swimid.fitting.model import Array, Parameter
from swimid.fitting.noise import huber_damping
from swimid.fitting.problem import Patience, Problem, minimise

#: Number of pairs of points around the estimates, and their distance from the estimates in standard errors
#: under white noise.
N_PAIRS, PAIR_DISTANCE = 3, 2.0
#: Minimum deviation of the mean cost of a pair from its quadratic prediction, as a fraction of the
#: prediction, that shows a non-smooth cost.
KINK_SHARE = 0.5
#: Distances from the estimates at which short searches start, in standard errors under white noise. The first
#: tuple is for a smooth cost, the second for a non-smooth cost.
SMOOTH_DISTANCES = (10.0,)
KINK_DISTANCES = (3.0, 10.0, 30.0, 100.0, 3.0, 10.0, 30.0, 100.0)
#: Number of iterations of a short search. If the cost is non-smooth, a second search starts from the two best
#: end points with the second number.
SHORT_ITERATIONS, LONG_ITERATIONS = 3, 10
#: Values at which a parameter with a non-smooth effect is tested: multiples of its typical scale, and
#: multiples of its estimate. Multiples of the scale help if the estimate is far from the best value. A free
#: decay with dry friction has a local minimum for every number of half swings before the body sticks.
SCALES, FACTORS = (0.25, 1.0, 3.0), (0.6, 0.8, 0.9, 1.1, 1.25, 1.6)
#: Distance from the bound at which a parameter at a bound is tested, in typical scales of the parameter.
INSIDE = 1.0
#: Maximum step along a direction that the data hardly determine, as a fraction of the parameter values.
MAX_STEP = 0.5
#: Minimum decrease of the sum of squared residuals that counts as a lower cost, in units of the residual
#: variance. Such a decrease moves an estimate by about a thirtieth of its standard error.
IMMATERIAL = 1e-3


@dataclass(frozen=True)
class Surroundings:
    """Result of a search around the estimates of a fit."""

    #: Point with a lower cost than the estimates, shape (p,); None if there is none.
    point: Array | None
    #: Number of simulations of single trials, and number of Jacobians.
    evaluations: int
    jacobians: int
    #: The cost is not smooth: :attr:`Parameter.kinked` of a parameter is set, or the cost deviates from its
    #: quadratic prediction.
    rough: bool


def search_around(result: FitResult, *, jobs: int = 1, seed: int = 0) -> Surroundings:
    """Search for a lower cost around the estimates of a fit.

    If the cost is smooth, all starting points use the derivatives at the estimates for one step. If this step
    leads at least half of the way back to the estimates, measured in residuals, the starting point is not
    searched further. Otherwise the search continues with new derivatives.
    """
    if not len(result.labels):
        return Surroundings(None, 0, 0, False)
    problem = weighted(result, jobs=jobs)
    point, rough = _better(problem, result, np.random.default_rng(seed))
    return Surroundings(point, problem.evaluations, problem.jacobians, rough)


def weighted(result: FitResult, parameters: tuple[Parameter, ...] | None = None, *, jobs: int = 1) -> Problem:
    """Return the least-squares problem of a fit with its final weights; its parameters can be replaced."""
    fitted = [t for t in result.trials if t.role == "fit"]
    problem = Problem(result.model, parameters or result.parameters, fitted, jobs=jobs)
    set_weights(problem, result)
    return problem


def set_weights(problem: Problem, result: FitResult) -> None:
    """Set the weights of a problem to the final weights of a fit of the same trials."""
    known = {(s.trial, s.channel): s for s in result.series}
    for k, trial in enumerate(problem.trials):
        series = [known[trial.id, channel] for channel in problem.channels[k]]
        problem.sd[k] = [s.sd for s in series]
        if result.loss == "huber":
            problem.damping[k] = [huber_damping(s.weighted) for s in series]


def _better(problem: Problem, result: FitResult, rng: np.random.Generator) -> tuple[Array | None, bool]:
    """Return a point with a lower cost (None if there is none), and whether the cost is not smooth."""
    theta = np.asarray(result.estimate, dtype=float)
    here = _cost(problem, theta)
    rows = problem.jacobian(theta)
    variance = here / max(result.samples - len(theta), 1)
    steps = _standard_steps(problem, theta, rows, variance)
    material = max(IMMATERIAL * here / max(result.samples, 1), 1e-9 * here)
    ends: list[tuple[float, Array]] = []
    rough = kinked(result)
    for _ in range(N_PAIRS):
        step = PAIR_DISTANCE * steps @ _unit(rng, len(theta))
        pair = [np.clip(theta + sign * step, problem.lower, problem.upper) for sign in (1.0, -1.0)]
        costs = [_cost(problem, point) for point in pair]
        ends += list(zip(costs, pair, strict=True))
        inside = (np.allclose(point, theta + sign * step) for point, sign in zip(pair, (1, -1), strict=True))
        if all(inside) and not rough:
            predicted = float(np.sum((rows @ step) ** 2))
            off = 0.5 * sum(costs) - here - predicted
            rough = abs(off) > KINK_SHARE * max(predicted, variance) and not _smooth(
                problem, theta, rows, step, off
            )
    distances = KINK_DISTANCES if rough else SMOOTH_DISTANCES
    starts = [
        np.clip(theta + far * steps @ _unit(rng, len(theta)), problem.lower, problem.upper)
        for far in distances
    ]
    starts += _inside(problem, result, theta, rough)
    tolerance = 0.1 * material / max(here, 1e-300)
    if rough:
        found = _searched(problem, starts, SHORT_ITERATIONS, tolerance)
        lowest = [point for _, point in sorted(found, key=lambda end: end[0])[:2]]
        ends += found + _searched(problem, lowest, LONG_ITERATIONS, tolerance)
    else:
        for start in starts:
            step_only = minimise(problem.residuals, lambda _: rows, start, problem.box, max_iterations=1)
            cost = step_only.cost if np.isfinite(step_only.cost) else np.inf
            ends.append((cost, step_only.x))
            before, after = (float(np.linalg.norm(rows @ (p - theta))) for p in (start, step_only.x))
            if cost >= here - material and after > 0.5 * before:
                ends += _searched(problem, [step_only.x], SHORT_ITERATIONS, tolerance)
    cost, point = min(ends, key=lambda pair: pair[0])
    if cost >= here - material:
        return None, rough
    return point, rough


def _smooth(problem: Problem, theta: Array, rows: Array, step: Array, off: float) -> bool:
    """Return whether the deviation from the quadratic prediction falls with the fourth power of the step.

    It does so for a smooth cost. With a kink it falls with the step, and with a piecewise constant cost it
    falls with the square of the step.
    """
    here = _cost(problem, theta)
    for _ in range(2):
        step = step / 4.0
        predicted = float(np.sum((rows @ step) ** 2))
        nearer = 0.5 * (_cost(problem, theta + step) + _cost(problem, theta - step)) - here - predicted
        # at a quarter of the distance, 1/256 of the deviation remains if smooth, 1/16 if piecewise constant
        if abs(nearer) < 1.0 / 32.0 * abs(off):
            return True
        off = nearer
    return False


def kinked(result: FitResult) -> bool:
    """Return whether an estimated parameter makes the cost non-smooth (:attr:`Parameter.kinked`)."""
    return any(p.kinked and p.free for p in result.parameters)


def _searched(
    problem: Problem, starts: list[Array], iterations: int, tolerance: float
) -> list[tuple[float, Array]]:
    """Return the cost and the end point of a short search from each starting point."""
    found = [problem.solve(start, tolerance=tolerance, max_iterations=iterations) for start in starts]
    return [(solution.cost, solution.x) for solution in found if np.isfinite(solution.cost)]


def _cost(problem: Problem, theta: Array) -> float:
    r = problem.residuals(theta)
    return float(r @ r)


def _unit(rng: np.random.Generator, size: int) -> Array:
    """Return a random unit vector."""
    direction = rng.normal(size=size)
    return np.asarray(direction / np.linalg.norm(direction))


def _standard_steps(problem: Problem, theta: Array, rows: Array, variance: float) -> Array:
    """Return independent steps of one standard error under white noise, as columns, shape (p, p)."""
    rows = rows * problem.scale
    at_bound = (theta <= problem.lower) | (theta >= problem.upper)
    rows[:, at_bound] = 0.0
    values, vectors = np.linalg.eigh(rows.T @ rows)
    sizes = np.sqrt(variance / np.maximum(values, 1e-300))
    largest = MAX_STEP * np.max(np.maximum(np.abs(theta), problem.scale) / problem.scale)
    steps = vectors * np.minimum(sizes, largest)
    steps[at_bound] = 0.0
    return np.asarray(problem.scale[:, None] * steps)


def _inside(problem: Problem, result: FitResult, theta: Array, rough: bool) -> list[Array]:
    """Return starting points in which one parameter has another value.

    A parameter at a bound is moved away from the bound. A parameter with a non-smooth effect is set to
    several values. Parameters of single trials are included only if the cost is not smooth.
    """
    kinked = {p.name for p in result.parameters if p.kinked}
    found = []
    margin = 1e-3 * problem.scale
    for j, label in enumerate(problem.labels):
        name, per_trial = label.split("[")[0], "[" in label
        values: list[float] = []
        if name in kinked and not per_trial:
            values = [size * problem.scale[j] for size in SCALES] + [
                f * theta[j] for f in FACTORS if theta[j]
            ]
        elif theta[j] - problem.lower[j] < margin[j]:
            values = [problem.lower[j] + INSIDE * problem.scale[j]]
        elif problem.upper[j] - theta[j] < margin[j]:
            values = [problem.upper[j] - INSIDE * problem.scale[j]]
        if per_trial and not rough:
            continue
        for value in values:
            point = theta.copy()
            point[j] = np.clip(value, problem.lower[j], problem.upper[j])
            found.append(point)
    return found


def profile_interval(
    result: FitResult, name: str, *, level: float = 0.95
) -> tuple[float | None, float | None]:
    """Return the profile-likelihood interval of one shared parameter.

    The parameter is held at values at increasing distance from its estimate, and all other parameters are
    fitted again. The interval ends where the sum of squared residuals, divided by the residual variance, has
    increased by the quantile of the chi-square distribution. Coloured residuals and trials that disagree
    widen the interval by the factor by which they increase the standard error. An end of the interval is None
    if the interval reaches a bound, or extends more than 18 standard errors from the estimate.
    """
    stderr = result.stderr(name)
    if stderr is None:
        return None, None
    whole = weighted(result, result.parameters)
    best = whole.residuals(result.estimate)
    cost = float(best @ best)
    rows = whole.jacobian(result.estimate)
    j = result.labels.index(name)
    variance = cost / max(len(best) - len(result.labels), 1)
    white = float(np.linalg.pinv(rows.T @ rows)[j, j]) * variance
    inflation = stderr**2 / white if white > 0 else 1.0
    limit = float(special.chdtri(1, 1.0 - level)) * variance * inflation
    centre, others = float(result.estimate[j]), np.delete(result.estimate, j)
    parameter = result.parameter(name)

    def excess(value: float) -> float:
        held = list(result.parameters)
        held[held.index(parameter)] = replace(parameter, start=value, free=False)
        problem = weighted(result, tuple(held))
        return problem.solve(others, tolerance=1e-8, watch=Patience()).cost - cost - limit

    ends: list[float | None] = []
    for side, bound in ((-1.0, parameter.lower), (1.0, parameter.upper)):
        near, end = centre, None
        for k in range(7):
            far = centre + side * 2.5 * stderr * 1.4**k
            if (far - bound) * side >= 0:
                break
            if excess(far) > 0:
                end = float(optimize.brentq(excess, near, far, xtol=1e-3 * stderr))
                break
            near = far
        ends.append(end)
    return ends[0], ends[1]
