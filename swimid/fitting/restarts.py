"""Is the answer of a search a minimum? Points around it, and short searches from some, must not lie lower.

A search stops where its own model of the cost promises nothing more. Where the cost has corners, as with
dry friction, or a bound keeps a parameter from leaving, that is no minimum.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import optimize, special

from swimid.fitting.metrics import FitResult
from swimid.fitting.model import Array, Parameter
from swimid.fitting.noise import huber_damping
from swimid.fitting.problem import IMMATERIAL, Problem, minimise

#: Pairs of points tried around the answer, and their distance in standard errors under white noise.
PAIRS, PAIR_DISTANCE = 3, 2.0
#: A cost of a pair of points that is off by more than this share of what curvature predicts (or of a standard
#: error's worth) has corners.
ROUGH = 0.5
#: Distances, in the same standard errors, from which short searches start, and those where it has corners.
FAR, FAR_ROUGH = (10.0,), (3.0, 10.0, 30.0, 100.0, 3.0, 10.0, 30.0, 100.0)
#: Iterations of such a search, and of the two that came lowest where the cost has corners.
SHORT, LONG = 3, 10
#: Sizes a parameter with corners is tried at: in its scale, where the search may have gone far astray, and in
#: its estimate, since a decay that sticks has a minimum for every number of half swings it may take.
SIZES, FACTORS = (0.25, 1.0, 3.0), (0.6, 0.8, 0.9, 1.1, 1.25, 1.6)
#: How far inside a parameter at its bound is tried, in its scale.
INSIDE = 1.0
#: Relative size beyond which a step along a direction the data hardly see does not go.
LARGEST = 0.5


@dataclass(frozen=True)
class Tested:
    """What points around an answer came to."""

    #: With a lower cost than the answer, shape (p,); None where none was found.
    point: Array | None
    #: Simulations of single trials it took, and derivatives.
    evaluations: int
    jacobians: int
    #: The cost has corners: a parameter says so, or it is not as its curvature says.
    rough: bool


def held(result: FitResult, *, jobs: int = 1, seed: int = 0) -> Tested:
    """Hold the answer of a fit against points near it.

    Where the cost is smooth, the derivatives at the answer serve all starts: a step that leads at least
    half the way back to it, as the data measure ways, ends a start. Only what leads elsewhere is searched
    with derivatives of its own.
    """
    if not len(result.labels):
        return Tested(None, 0, 0, False)
    problem = weighted(result, jobs=jobs)
    try:
        point, rough = _better(problem, result, np.random.default_rng(seed))
        return Tested(point, problem.evaluations, problem.jacobians, rough)
    finally:
        problem.close()


def weighted(result: FitResult, parameters: tuple[Parameter, ...] | None = None, *, jobs: int = 1) -> Problem:
    """The fit's problem with its final weights, also for other choices of parameters."""
    fitted = [t for t in result.trials if t.role == "fit"]
    problem = Problem(result.model, parameters or result.parameters, fitted, jobs=jobs)
    weigh(problem, result)
    return problem


def weigh(problem: Problem, result: FitResult) -> None:
    """Give a problem the final weights of a fit of its trials."""
    known = {(s.trial, s.channel): s for s in result.series}
    for k, trial in enumerate(problem.trials):
        series = [known[trial.id, channel] for channel in problem.channels[k]]
        problem.sd[k] = [s.sd for s in series]
        if result.loss == "huber":
            problem.damping[k] = [huber_damping(s.weighted) for s in series]


def _better(problem: Problem, result: FitResult, rng: np.random.Generator) -> tuple[Array | None, bool]:
    """A point with a lower cost, if there is one, and whether the cost has corners."""
    theta = np.asarray(result.estimate, dtype=float)
    here = _cost(problem, theta)
    rows = problem.jacobian(theta)
    variance = here / max(result.samples - len(theta), 1)
    steps = _standard_steps(problem, theta, rows, variance)
    material = max(IMMATERIAL * here / max(result.samples, 1), 1e-9 * here)
    tried: list[tuple[float, Array]] = []
    rough = kinked(result)
    for _ in range(PAIRS):
        step = PAIR_DISTANCE * steps @ _unit(rng, len(theta))
        pair = [np.clip(theta + sign * step, problem.lower, problem.upper) for sign in (1.0, -1.0)]
        costs = [_cost(problem, point) for point in pair]
        tried += list(zip(costs, pair, strict=True))
        inside = (np.allclose(point, theta + sign * step) for point, sign in zip(pair, (1, -1), strict=True))
        if all(inside) and not rough:
            predicted = float(np.sum((rows @ step) ** 2))
            off = 0.5 * sum(costs) - here - predicted
            rough = abs(off) > ROUGH * max(predicted, variance) and not _smooth(
                problem, theta, rows, step, off
            )
    starts = [
        np.clip(theta + far * steps @ _unit(rng, len(theta)), problem.lower, problem.upper)
        for far in (FAR_ROUGH if rough else FAR)
    ]
    starts += _inside(problem, result, theta, rough)
    tolerance = 0.1 * material / max(here, 1e-300)
    if rough:
        ends = _searched(problem, starts, SHORT, tolerance)
        lowest = [point for _, point in sorted(ends, key=lambda end: end[0])[:2]]
        ends += _searched(problem, lowest, LONG, tolerance)
    else:
        ends = []
        for start in starts:
            end = _stepped(problem, start, rows)
            ends.append(end)
            if end[0] >= here - material and not _back(rows, theta, start, end[1]):
                ends += _searched(problem, [end[1]], SHORT, tolerance)
    tried += ends
    cost, point = min(tried, key=lambda pair: pair[0])
    return (point if cost < here - material else None), rough


def _smooth(problem: Problem, theta: Array, rows: Array, step: Array, off: float) -> bool:
    """Whether what the cost is off by vanishes as in a bent valley, with the fourth power of the step.

    That of corners goes as the step, and that of stairs as its square.
    """
    here = _cost(problem, theta)
    for _ in range(2):
        step = step / 4.0
        predicted = float(np.sum((rows @ step) ** 2))
        nearer = 0.5 * (_cost(problem, theta + step) + _cost(problem, theta - step)) - here - predicted
        # 1/256 is left of a bend at a quarter of the distance, 1/16 of stairs
        if abs(nearer) < 1.0 / 32.0 * abs(off):
            return True
        off = nearer
    return False


def kinked(result: FitResult) -> bool:
    """Whether an estimated parameter puts corners into the cost."""
    return any(p.kinked and p.free for p in result.parameters)


def _stepped(problem: Problem, start: Array, rows: Array) -> tuple[float, Array]:
    """One Gauss-Newton step with derivatives as they are at the answer, in bounds; its cost and end."""
    end = minimise(
        problem.residuals,
        lambda _: rows,
        start,
        lower=problem.lower,
        upper=problem.upper,
        scale=problem.scale,
        max_iterations=1,
    )
    return end.cost if np.isfinite(end.cost) else np.inf, end.x


def _back(rows: Array, theta: Array, start: Array, end: Array) -> bool:
    """Whether an end is on the way back to the answer, ways measured by what they change in the residuals."""
    before, after = (float(np.linalg.norm(rows @ (point - theta))) for point in (start, end))
    return after <= 0.5 * before


def _searched(
    problem: Problem, starts: list[Array], most: int, tolerance: float
) -> list[tuple[float, Array]]:
    found = [problem.solve(start, tolerance=tolerance, max_iterations=most) for start in starts]
    return [(solution.cost, solution.x) for solution in found if np.isfinite(solution.cost)]


def _cost(problem: Problem, theta: Array) -> float:
    r = problem.residuals(theta)
    return float(r @ r)


def _unit(rng: np.random.Generator, size: int) -> Array:
    direction = rng.normal(size=size)
    return np.asarray(direction / np.linalg.norm(direction))


def _standard_steps(problem: Problem, theta: Array, rows: Array, variance: float) -> Array:
    """Columns that move by one standard error under white noise, independent of each other, shape (p, p)."""
    rows = rows * problem.scale
    at_bound = (theta <= problem.lower) | (theta >= problem.upper)
    rows[:, at_bound] = 0.0
    values, vectors = np.linalg.eigh(rows.T @ rows)
    sizes = np.sqrt(variance / np.maximum(values, 1e-300))
    largest = LARGEST * np.max(np.maximum(np.abs(theta), problem.scale) / problem.scale)
    steps = vectors * np.minimum(sizes, largest)
    steps[at_bound] = 0.0
    return np.asarray(problem.scale[:, None] * steps)


def _inside(problem: Problem, result: FitResult, theta: Array, rough: bool) -> list[Array]:
    """The answer with parameters at their bounds moved inside, and those with corners to other sizes."""
    kinked = {p.name for p in result.parameters if p.kinked}
    found = []
    margin = 1e-3 * problem.scale
    for j, label in enumerate(problem.labels):
        name, per_trial = label.split("[")[0], "[" in label
        values: list[float] = []
        if name in kinked and not per_trial:
            values = [size * problem.scale[j] for size in SIZES] + [f * theta[j] for f in FACTORS if theta[j]]
        elif theta[j] - problem.lower[j] < margin[j]:
            values = [problem.lower[j] + INSIDE * problem.scale[j]]
        elif problem.upper[j] - theta[j] < margin[j]:
            values = [problem.upper[j] - INSIDE * problem.scale[j]]
        for value in values if not per_trial or rough else []:
            point = theta.copy()
            point[j] = np.clip(value, problem.lower[j], problem.upper[j])
            found.append(point)
    return found


def profile_interval(
    result: FitResult, name: str, *, level: float = 0.95
) -> tuple[float | None, float | None]:
    """Profile-likelihood interval of one shared parameter.

    The parameter is held at values ever farther from its estimate, all others are refitted,
    and the interval ends where the fit is worse by the chi-square quantile. Coloured residuals
    and scattering trials widen it by the same factor as they widen the standard error. An
    end is None where the interval runs into a bound or does not end within some ten standard errors.
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

    def excess(value: float) -> float:
        held = tuple(replace(p, start=value, free=False) if p.name == name else p for p in result.parameters)
        return weighted(result, held).solve(others, tolerance=1e-8).cost - cost - limit

    parameter = result.parameter(name)
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
