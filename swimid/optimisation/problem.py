"""Optimisation problem over the gaits of a robot, and a gradient search that solves it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from swimid.files import yamlio
from swimid.files.atomic import Checkpoint
from swimid.files.yamlio import Number
from swimid.fitting import global_search
from swimid.fitting.model import Array
from swimid.optimisation.study import Performance, Point

#: Settings of a gradient search: radius of the finite differences (distance from the current point, as a
#: fraction of the range of a parameter) at the start and at the end, and maximum number of steps.
FIRST_RADIUS, LAST_RADIUS, MAX_STEPS = 0.1, 1e-3, 24
#: Value of the penalised goal at points where the goal cannot be computed. It is worse than any other value.
FAILED_GOAL = 1e9
#: Number of points at which the quadratic model of the objective is evaluated in one round of its
#: minimisation, and number of rounds. Each round has a smaller search region.
N_MODEL_POINTS, N_ZOOMS = 512, 3
#: Factor of the penalty for violating a limit of a gait. The penalty is this factor times the typical scale
#: of the goal times the relative violation.
PENALTY = 10.0
#: Maximum relative violation at which a limit of a gait still counts as satisfied.
LIMIT_RTOL = 1e-3
#: Type of an objective function with limits. Its arguments are n points in the unit cube of d varied
#: parameters, shape (n, d), and the index of the search to which each point belongs, shape (n,). It returns
#: the goal and the penalty for each limit, shape (n, 1 + limits). A penalty is negative if the limit is
#: satisfied.
Evaluate = Callable[[Array, NDArray[np.int64]], Array]


def interval95(values: Array) -> Array:
    """Return the ends of the 95 % interval over random samples (rows of ``values``), shape (2, ...)."""
    return np.asarray(np.nanquantile(values, [0.025, 0.975], axis=0, method="weibull"))


# ------------------------------------------------------------ gradient search


class Minima(NamedTuple):
    """Results of k gradient searches: their final points, and the penalised goal at these points."""

    points: Array
    values: Array


def merit(parts: Array) -> Array:
    """Return the penalised goal of n points: the goal plus the penalties of violated limits, shape (n,).

    The columns of ``parts`` are the goal and the penalty of each limit, shape (n, 1 + limits). A negative
    penalty (satisfied limit) counts as 0.
    """
    total = parts[:, 0] + np.maximum(parts[:, 1:], 0.0).sum(axis=1)
    return np.minimum(np.nan_to_num(total, nan=FAILED_GOAL, posinf=FAILED_GOAL), FAILED_GOAL)


def descend(
    evaluate: Evaluate,
    starts: Array,
    *,
    first: float = FIRST_RADIUS,
    last: float = LAST_RADIUS,
    steps: int = MAX_STEPS,
    advance: Callable[[], Any] = lambda: None,
) -> Minima:
    """Minimise an objective function with limits over the unit cube, from several starting points.

    Parameters
    ----------
    starts : ndarray, shape (k, d)
        Starting points of k searches in the d-dimensional unit cube.
    first, last : float
        Radius of the finite differences in the first step of a search, and radius below which a search ends.

    Notes
    -----
    Central differences give the gradient, and the curvature along each axis, of the goal and of each limit.
    Gradient and curvature define a quadratic model with penalties. The minimum of the model within twice the
    radius along each axis is compared with the points of the differences. The radius is halved if none of
    these points is better, or if the step is shorter than the radius. Points outside the cube are moved to
    its surface.

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
        stencil = _stencil(points[active], radius[active])
        around = evaluate(stencil.reshape(-1, width), np.repeat(active, 2 * width))
        around = around.reshape(len(active), 2 * width, -1)
        each = zip(points[active], parts[active], stencil, around, radius[active], strict=True)
        suggested = np.array([_model_minimum(*rows) for rows in each])
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


def _stencil(points: Array, radius: Array) -> Array:
    """Return the central-difference points about n points of the d-dimensional cube, shape (n, 2 d, d)."""
    width = points.shape[1]
    stencil = np.repeat(points[:, None, :], 2 * width, axis=1)
    for k in range(width):
        stencil[:, 2 * k, k] -= radius
        stencil[:, 2 * k + 1, k] += radius
    return np.clip(stencil, 0.0, 1.0)


@cache
def _cube(width: int) -> Array:
    """Return points that evenly fill a cube with coordinates from -1 to 1. The first point is the centre."""
    from scipy.stats import qmc

    points = 2.0 * qmc.Sobol(width, scramble=False).random(N_MODEL_POINTS) - 1.0
    return np.vstack([np.zeros(width), points])


def _model_minimum(point: Array, parts: Array, stencil: Array, around: Array, radius: float) -> Array:
    """Return the minimum of a quadratic model of the goal and its penalties near a point of the unit cube.

    The minimum lies within twice the radius along each axis.
    """
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
    """Limit of a gait: the maximum or the minimum of one quantity of its simulation."""

    quantity: str
    at_most: Number = None
    at_least: Number = None
    unit: str


@dataclass
class GaitProblem:
    """Optimisation problem over gaits, with goals and limits as functions on the unit cube.

    The axes of the cube are the varied parameters, scaled to their ranges.

    Attributes
    ----------
    vary : dict of str to (float, float)
        Ranges of the varied parameters.
    goals : list of (quantity, sign)
        The product of sign and quantity is minimised.
    limits : dict of str to Limit
    fixed : dict of str to float
        Parameters of the gait that are not varied, but replace those of the drive of ``performance``.
    checkpoint : Checkpoint
        Stores the result of every batch of simulations.
    scale : float
        Typical scale of the first goal.
    """

    performance: Performance
    vary: Mapping[str, tuple[float, float]]
    goals: Sequence[tuple[str, float]]
    limits: Mapping[str, Limit]
    fixed: Point = field(default_factory=dict)
    checkpoint: Checkpoint = field(default_factory=Checkpoint)
    scale: float = 1.0
    calls: int = field(default=0, init=False)

    def at(self, x: Array) -> dict[str, float]:
        """Return the values of the varied parameters at a point ``x`` of the unit cube."""
        low, high = np.array(list(self.vary.values()), dtype=float).T
        return dict(zip(self.vary, (low + x * (high - low)).tolist(), strict=True))

    def place(self, at: Mapping[str, float]) -> Array:
        """Return the point of the unit cube that belongs to given values of the varied parameters."""
        low, high = np.array(list(self.vary.values()), dtype=float).T
        return np.asarray((np.array([at[name] for name in self.vary]) - low) / (high - low))

    def table(self, points: Array, values: Sequence[Array] | None = None) -> Array:
        """Simulate gaits at points of the unit cube, and return their quantities, shape (n, quantities)."""
        gaits = [{**self.fixed, **self.at(x)} for x in points]
        self.calls += 1
        found = self.checkpoint.get_or_compute(
            f"runs {self.calls}", lambda: self.performance.many(gaits, values).ravel()
        )
        return found.reshape(-1, len(self.performance.units))

    def quantity(self, table: Array, name: str) -> Array:
        """Return one quantity of each simulation in a table, shape (n,).

        The name may also be ``basin_m``, which is no column of the table: the side of the square basin that
        encloses the motion of the robot.
        """
        units = list(self.performance.units)
        if name == "basin_m":
            body = self.performance.model.body
            assert body is not None
            return table[:, units.index("path_extent_m")] + body.length(self.performance.values)
        return table[:, units.index(name)]

    def goal_values(self, table: Array) -> Array:
        """Return the values of the goals in each simulation, in SI units, shape (n, goals).

        Turning rates are absolute values.
        """
        columns = []
        for quantity, _ in self.goals:
            column = self.quantity(table, quantity)
            if quantity.startswith("mean_") and quantity.endswith("_rate_rad_s"):
                column = np.abs(column)
            columns.append(column)
        return np.column_stack(columns)

    def compute_objectives(self, table: Array) -> Array:
        """Return the goals of each simulation with the signs for minimisation, shape (n, goals)."""
        return self.goal_values(table) * np.array([sign for _, sign in self.goals])

    def violations(self, table: Array) -> Array:
        """Return the relative violation of each limit in each simulation, shape (n, limits).

        The violation is negative if the limit is satisfied.
        """
        found = [np.empty((len(table), 0))]
        for limit in self.limits.values():
            value = self.quantity(table, limit.quantity)[:, None]
            if limit.at_most is not None:
                found.append(value / limit.at_most - 1.0)
            if limit.at_least is not None:
                found.append(1.0 - value / limit.at_least)
        return np.hstack(found)

    def keeps_limits(self, table: Array) -> NDArray[np.bool_]:
        """Return for each simulation whether it satisfies all limits, shape (n,)."""
        return np.asarray((self.violations(table) <= LIMIT_RTOL).all(axis=1))

    def parts(self, table: Array) -> Array:
        """Return the first goal with its sign for minimisation, and the penalty of each limit.

        The result has the shape (n, 1 + limits).
        """
        return np.hstack(
            [self.compute_objectives(table)[:, :1], PENALTY * self.scale * self.violations(table)]
        )

    def minimise(self, starts: Array, vectors: Sequence[Array] | None = None, **how: Any) -> Minima:
        """Minimise the first goal from several starting points (see :func:`descend`).

        With ``vectors``, the search from each starting point has its own parameter vector of the model.
        """

        def evaluate(x: Array, owner: NDArray[np.int64]) -> Array:
            values = None
            if vectors is not None:
                values = [vectors[k] for k in owner]
            return self.parts(self.table(x, values))

        return descend(evaluate, starts, **how)

    def front(self, population: int, generations: int, seed: int, first: Array) -> Array:
        """Search for the Pareto front of two goals without limits by NSGA-II, with ``first`` as a start.

        Returns
        -------
        ndarray, shape (n, varied + 2)
            Points of the unit cube, and the values of the goals that are minimised.
        """
        width = len(self.vary)
        found = global_search.nsga2(
            lambda points: self.compute_objectives(self.table(points)),
            np.zeros(width), np.ones(width), objectives=2,
            population=population, generations=generations, seed=seed, first=first,
        )  # fmt: skip
        sound = (found.objectives < global_search.BROKEN_OBJECTIVE).all(axis=1)
        return np.hstack([found.points, found.objectives])[sound]
