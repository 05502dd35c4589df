"""The optimisation problem over gaits, its gradient search, and draws of the coefficients."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from swimid.errors import NoTrustworthyResult
from swimid.files import yamlio
from swimid.files.checkpoint import Checkpoint
from swimid.files.yamlio import Number
from swimid.fitting import global_search
from swimid.fitting.model import Array
from swimid.optimisation.performance import Performance, Point
from swimid.simulation.catalogue import Applied, is_possible

#: Number of draws that are made at once, and the maximum number in all.
BLOCK, MAX_DRAWS = 50_000, 5_000_000
#: First and last radius of the finite differences, as a share of the range, and maximum number of steps.
FIRST_RADIUS, LAST_RADIUS, MAX_STEPS = 0.1, 1e-3, 24
#: Value of the function where it cannot be computed.
BROKEN = 1e9
#: Number of points at which the local model is evaluated, and of repetitions in a smaller box.
N_MODEL_POINTS, N_ZOOMS = 512, 3
#: Violating a limit adds a penalty of this many times the typical size of the goal, per relative violation.
PENALTY = 10.0
#: Largest relative violation at which a limit counts as kept.
LIMIT_RTOL = 1e-3
#: First radius, last radius and number of steps of the searches in draws, which begin at the optimum.
DRAW_RADIUS, DRAW_LAST, DRAW_STEPS = 0.03, 1e-3, 14

#: Function of points in the unit cube, shape (n, d), and of the index of the search of each, shape (n,).
#: Returns the goal and the violation of each limit, shape (n, 1 + limits), negative if a limit is kept.
Evaluate = Callable[[Array, NDArray[np.int64]], Array]


def interval95(values: Array) -> Array:
    """Return the 95 % interval over draws, shape (2, ...), of values with one draw in each row."""
    return np.asarray(np.nanquantile(values, [0.025, 0.975], axis=0, method="weibull"))


@dataclass(frozen=True)
class Draws:
    """Draws of the coefficients.

    Attributes
    ----------
    vectors : list of ndarray
        Parameter vectors of the model.
    inside : float
        Share of the draws within the bounds; the others were replaced.
    """

    vectors: list[Array]
    inside: float


def drawn(applied: Applied, count: int, seed: int) -> Draws:
    """Draw parameter vectors from the covariance of the coefficients.

    The normal distribution is truncated at the bounds of each coefficient, and at impossible masses.

    Raises
    ------
    NoTrustworthyResult
        If fewer than ``count`` of MAX_DRAWS draws are possible.
    """
    model, centre = applied.model, applied.values()
    names, covariance = applied.uncertain()
    index = [model.index(name) for name in names]
    lower = np.array([model.parameters[k].lower for k in index])
    upper = np.array([model.parameters[k].upper for k in index])
    sd = np.sqrt(np.diag(covariance))
    # the correlation is singular if coefficients share a value, so that it has no Cholesky factor
    values, vectors = np.linalg.eigh(covariance / np.outer(sd, sd))
    root = sd[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))
    rng = np.random.default_rng(seed)
    found: list[Array] = []
    for made in range(0, MAX_DRAWS, BLOCK):
        moved = centre[index] + rng.standard_normal((BLOCK, len(names))) @ root.T
        for k in np.flatnonzero(((moved >= lower) & (moved <= upper)).all(axis=1)):
            vector = centre.copy()
            vector[index] = moved[k]
            if is_possible(model, vector):
                found.append(vector)
            if len(found) == count:
                return Draws(found, count / (made + int(k) + 1))
    raise NoTrustworthyResult(
        "hardly a draw of the coefficients from their covariance is possible",
        hint="they lie at their bounds or are hardly known; hold them (--set) or fit them better",
    )


# ------------------------------------------------------------ gradient search


@dataclass(frozen=True)
class Minima:
    """Ends of several searches.

    Attributes
    ----------
    points : ndarray, shape (k, d)
    values : ndarray, shape (k,)
        Goal with the penalties of violated limits.
    """

    points: Array
    values: Array

    @property
    def best(self) -> int:
        """Index of the search with the least value."""
        return int(np.argmin(self.values))


def merit(parts: Array) -> Array:
    """Return the goal plus the violations of the limits, shape (n,), of parts of shape (n, 1 + limits)."""
    total = parts[:, 0] + np.maximum(parts[:, 1:], 0.0).sum(axis=1)
    return np.minimum(np.nan_to_num(total, nan=BROKEN, posinf=BROKEN), BROKEN)


def descend(
    evaluate: Evaluate,
    starts: Array,
    *,
    first: float = FIRST_RADIUS,
    last: float = LAST_RADIUS,
    steps: int = MAX_STEPS,
    advance: Callable[[], Any] = lambda: None,
) -> Minima:
    """Minimise a function with limits over the unit cube from several starts at once.

    Parameters
    ----------
    starts : ndarray, shape (k, d)
    first, last : float
        First radius of the finite differences, and the radius below which a search ends.

    Notes
    -----
    Central differences give the gradient and the curvature along each axis, of the goal and of each limit.
    The minimum of this quadratic model with penalties, in a box of twice the radius, is compared with the
    points of the differences. The radius is halved if no point is better, or if the step is shorter than it.
    Points outside the cube are moved to its face.

    >>> def bowl(x, owner):
    ...     return np.column_stack([(x[:, 0] - 0.3) ** 2 + 4 * (x[:, 1] - 1.2) ** 2])
    >>> [round(float(v), 2) for v in descend(bowl, np.array([[0.5, 0.5]])).points[0]]
    [0.3, 1.0]
    """
    points = np.array(starts, dtype=float)
    count, width = points.shape
    parts = evaluate(points, np.arange(count))
    values = merit(parts)
    radius = np.full(count, first)
    for _ in range(steps):
        active = np.flatnonzero(radius >= last)
        if not len(active):
            break
        stencil = np.repeat(points[active][:, None, :], 2 * width, axis=1)
        for k in range(width):
            stencil[:, 2 * k, k] -= radius[active]
            stencil[:, 2 * k + 1, k] += radius[active]
        stencil = np.clip(stencil, 0.0, 1.0)
        around = evaluate(stencil.reshape(-1, width), np.repeat(active, 2 * width))
        around = around.reshape(len(active), 2 * width, -1)
        suggested = np.array(
            [
                _model_minimum(points[j], parts[j], stencil[n], around[n], radius[j])
                for n, j in enumerate(active)
            ]
        )
        tried = evaluate(suggested, active)
        tried_values = merit(tried)
        for n, j in enumerate(active):
            near = merit(around[n])
            at = int(np.argmin(near))
            if tried_values[n] <= near[at] and tried_values[n] < values[j]:
                moved = float(np.abs(suggested[n] - points[j]).max())
                points[j], parts[j], values[j] = suggested[n], tried[n], tried_values[n]
                if moved < radius[j]:
                    radius[j] *= 0.5
            elif near[at] < values[j]:
                points[j], parts[j], values[j] = stencil[n, at], around[n, at], near[at]
            else:
                radius[j] *= 0.5
        advance()
    return Minima(points, values)


@cache
def _cube(width: int) -> Array:
    """Return points that fill the cube from -1 to 1 evenly, its centre first."""
    from scipy.stats import qmc

    points = 2.0 * qmc.Sobol(width, scramble=False).random(N_MODEL_POINTS) - 1.0
    return np.vstack([np.zeros(width), points])


def _model_minimum(point: Array, parts: Array, stencil: Array, around: Array, radius: float) -> Array:
    """Return the minimum of the quadratic model within the cube and twice the radius."""
    if not np.isfinite(parts).all():
        return np.asarray(stencil[int(np.argmin(merit(around)))])
    slope, curvature = np.zeros((2, len(point), len(parts)))
    for k in range(len(point)):
        sides = []
        for m in (2 * k, 2 * k + 1):
            distance = stencil[m, k] - point[k]
            if distance and np.isfinite(around[m]).all():
                sides.append((distance, (around[m] - parts) / distance))
        if len(sides) == 2:
            (a, below), (b, above) = sides
            curvature[k] = 2.0 * (above - below) / (b - a)
            slope[k] = below - 0.5 * curvature[k] * a
        elif sides:
            slope[k] = sides[0][1]
    middle, half = np.zeros(len(point)), 2.0 * radius
    for _ in range(N_ZOOMS):
        moves = np.clip(point + middle + half * _cube(len(point)), 0.0, 1.0) - point
        moves = np.clip(moves, -2.0 * radius, 2.0 * radius)
        model = parts + moves @ slope + 0.5 * moves**2 @ curvature
        middle, half = moves[int(np.argmin(merit(model)))], 0.2 * half
    return np.asarray(point + middle)


# ------------------------------------------------------------ the problem


class Limit(yamlio.Document):
    """Limit of a quantity of a gait."""

    quantity: str
    at_most: Number = None
    at_least: Number = None
    unit: str


@dataclass
class Problem:
    """Goals and limits over the unit cube of the varied parameters of a gait.

    Attributes
    ----------
    vary : dict of str to (float, float)
        Ranges of the varied parameters.
    goals : list of (name, quantity, sign)
        The sign times the quantity is minimised.
    limits : dict of str to Limit
    fixed : dict of str to float
        Other parameters of the gait that differ from the drive of the performance.
    efficiency : float
        Mechanical over electrical power.
    checkpoint : Checkpoint
        Keeps the result of every batch of simulations.
    scale : float
        Typical size of the first goal.
    """

    performance: Performance
    vary: Mapping[str, tuple[float, float]]
    goals: Sequence[tuple[str, str, float]]
    limits: Mapping[str, Limit]
    fixed: Point = field(default_factory=dict)
    efficiency: float = 1.0
    jobs: int = 1
    checkpoint: Checkpoint = field(default_factory=Checkpoint)
    scale: float = 1.0
    calls: int = field(default=0, init=False)

    def at(self, x: Array) -> dict[str, float]:
        """Return the gait at a point of the cube."""
        low, high = np.array(list(self.vary.values()), dtype=float).T
        return dict(zip(self.vary, (low + x * (high - low)).tolist(), strict=True))

    def place(self, at: Mapping[str, float]) -> Array:
        """Return the point of the cube of a gait."""
        low, high = np.array(list(self.vary.values()), dtype=float).T
        return np.asarray((np.array([at[name] for name in self.vary]) - low) / (high - low))

    def table(self, points: Array, values: Sequence[Array] | None = None) -> Array:
        """Simulate points of the cube; return their quantities, shape (n, quantities)."""
        gaits = [{**self.fixed, **self.at(x)} for x in points]
        self.calls += 1
        found = self.checkpoint.kept(
            f"runs {self.calls}", lambda: self.performance.many(gaits, values, jobs=self.jobs).ravel()
        )
        return found.reshape(-1, len(self.performance.units))

    def quantity(self, table: Array, name: str) -> Array:
        """Return a quantity of simulations, shape (n,), also one that only limits use."""
        units = list(self.performance.units)
        if name == "battery_power_W":
            return table[:, units.index("mean_positive_power_W")] / self.efficiency
        if name == "basin_m":
            body = self.performance.model.body
            assert body is not None
            return table[:, units.index("path_extent_m")] + body.length(self.performance.values)
        return table[:, units.index(name)]

    def goal_values(self, table: Array) -> Array:
        """Return the goals in their own units, shape (n, goals); turning rates without their sign."""
        columns = []
        for _, quantity, _ in self.goals:
            column = self.quantity(table, quantity)
            if quantity.startswith("mean_") and quantity.endswith("_rate_rad_s"):
                column = np.abs(column)
            columns.append(column)
        return np.column_stack(columns)

    @property
    def signs(self) -> Array:
        """Signs of the goals, shape (goals,)."""
        return np.array([sign for _, _, sign in self.goals])

    def wanted(self, table: Array) -> Array:
        """Return the goals as they are minimised, shape (n, goals)."""
        return np.asarray(self.goal_values(table) * self.signs)

    def violations(self, table: Array) -> Array:
        """Return the relative violation of each limit, shape (n, limits); negative if it is kept."""
        found = [np.empty((len(table), 0))]
        for limit in self.limits.values():
            value = self.quantity(table, limit.quantity)[:, None]
            if limit.at_most is not None:
                found.append(value / limit.at_most - 1.0)
            if limit.at_least is not None:
                found.append(1.0 - value / limit.at_least)
        return np.hstack(found)

    def keeps_limits(self, table: Array) -> NDArray[np.bool_]:
        """Return whether simulations keep the limits, shape (n,)."""
        return np.asarray((self.violations(table) <= LIMIT_RTOL).all(axis=1))

    def parts(self, table: Array) -> Array:
        """Return the first goal and the penalty of each limit, shape (n, 1 + limits)."""
        return np.hstack([self.wanted(table)[:, :1], PENALTY * self.scale * self.violations(table)])

    def minimise(self, starts: Array, **how: Any) -> Minima:
        """Minimise the first goal from several starts (see :func:`descend`)."""
        return descend(lambda x, _owner: self.parts(self.table(x)), starts, **how)

    def minimise_in_draws(
        self, vectors: Sequence[Array], start: Array, advance: Callable[[], Any] = lambda: None
    ) -> Minima:
        """Minimise the first goal with each of several parameter vectors, all from one start."""
        return descend(
            lambda x, owner: self.parts(self.table(x, [vectors[k] for k in owner])),
            np.tile(start, (len(vectors), 1)),
            first=DRAW_RADIUS,
            last=DRAW_LAST,
            steps=DRAW_STEPS,
            advance=advance,
        )

    def costs(self, x: Array, vectors: Sequence[Array]) -> tuple[Array, Array]:
        """Return quantities and cost of one point with each of several parameter vectors."""
        table = self.table(np.tile(x, (len(vectors), 1)), vectors)
        return table, merit(self.parts(table))

    def front(self, population: int, generations: int, seed: int, **how: Any) -> Array:
        """Search the Pareto front of two goals by NSGA-II.

        Returns
        -------
        ndarray, shape (n, varied + 2)
            Points of the cube that keep the limits, and the goals as they are minimised.
        """

        def cost(points: Array) -> Array:
            table = self.table(points)
            violation = np.maximum(self.violations(table), 0.0).sum(axis=1)
            return self.wanted(table) + PENALTY * self.scale * violation[:, None]

        width = len(self.vary)
        found = global_search.nsga2(
            cost, np.zeros(width), np.ones(width), objectives=2, population=population,
            generations=generations, seed=seed, **how,
        )  # fmt: skip
        sound = (found.objectives < global_search.BROKEN_OBJECTIVE).all(axis=1)
        points = found.points[sound]
        if not self.limits or not len(points):
            return np.hstack([points, found.objectives[sound]])
        table = self.table(points)
        return np.hstack([points, self.wanted(table)])[self.keeps_limits(table)]
