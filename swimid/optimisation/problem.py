"""What the searches minimise: goals of runs over the unit cube of what is varied, within limits."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from swimid.files.checkpoint import Checkpoint
from swimid.fitting import global_search
from swimid.fitting.model import Array
from swimid.optimisation.descent import Descended, descend, merit
from swimid.optimisation.gait_file import Limit
from swimid.optimisation.performance import Performance, Point

#: Violating a limit adds a penalty of this many times the typical size of the goal, per relative violation.
PENALTY = 10.0
#: Largest relative violation at which a limit counts as kept.
LIMIT_RTOL = 1e-3
#: First radius, last radius and number of steps of the searches in draws, near the optimum of the estimates.
DRAW_RADIUS, DRAW_LAST, DRAW_STEPS = 0.03, 1e-3, 14


@dataclass
class Problem:
    """What is minimised over the unit cube of what is varied; every run is kept.

    Attributes
    ----------
    vary : dict of str to (float, float)
        What is varied, and its range.
    goals : list of (name, quantity, sign)
        The sign times the quantity is minimised.
    limits : dict of str to Limit
    fixed : dict of str to float
        The rest of the gait, where it differs from the drive of the performance.
    efficiency : float
        Mechanical over electrical power.
    scale : float
        A typical size of the first goal.
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
        """Return the point of the cube at which a gait lies."""
        low, high = np.array(list(self.vary.values()), dtype=float).T
        return np.asarray((np.array([at[name] for name in self.vary]) - low) / (high - low))

    def table(self, points: Array, values: Sequence[Array] | None = None) -> Array:
        """Return the quantities at points of the cube, shape (n, quantities)."""
        gaits = [{**self.fixed, **self.at(x)} for x in points]
        self.calls += 1
        found = self.checkpoint.kept(
            f"runs {self.calls}", lambda: self.performance.many(gaits, values, jobs=self.jobs).ravel()
        )
        return found.reshape(-1, len(self.performance.units))

    def quantity(self, table: Array, name: str) -> Array:
        """Return a quantity of runs, shape (n,): also what a limit is about."""
        units = list(self.performance.units)
        if name == "battery_power_W":
            return table[:, units.index("mean_positive_power_W")] / self.efficiency
        if name == "basin_m":
            body = self.performance.model.body
            assert body is not None
            return table[:, units.index("path_extent_m")] + body.length(self.performance.values)
        return table[:, units.index(name)]

    def goal_values(self, table: Array) -> Array:
        """Return the goals as they are told, shape (n, goals); a turn counts either way round."""
        columns = [self.quantity(table, quantity) for _, quantity, _ in self.goals]
        for k, (_, quantity, _) in enumerate(self.goals):
            if quantity.startswith("mean_") and quantity.endswith("_rate_rad_s"):
                columns[k] = np.abs(columns[k])
        return np.column_stack(columns)

    @property
    def signs(self) -> Array:
        """The sign of each goal: what is minimised is the sign times the quantity."""
        return np.array([sign for _, _, sign in self.goals])

    def wanted(self, table: Array) -> Array:
        """Return the goals as they are minimised, shape (n, goals)."""
        return np.asarray(self.goal_values(table) * self.signs)

    def passed(self, table: Array) -> Array:
        """Return the relative violation of each limit, shape (n, limits); negative where it is kept."""
        found = [np.empty((len(table), 0))]
        for limit in self.limits.values():
            value = self.quantity(table, limit.quantity)[:, None]
            if limit.at_most is not None:
                found.append(value / limit.at_most - 1.0)
            if limit.at_least is not None:
                found.append(1.0 - value / limit.at_least)
        return np.hstack(found)

    def keeps(self, table: Array) -> NDArray[np.bool_]:
        """Return whether runs keep the limits, shape (n,)."""
        return np.asarray((self.passed(table) <= LIMIT_RTOL).all(axis=1))

    def parts(self, table: Array) -> Array:
        """Return the first goal and the penalty of each limit of runs, shape (n, 1 + limits)."""
        return np.hstack([self.wanted(table)[:, :1], PENALTY * self.scale * self.passed(table)])

    def minimise(self, starts: Array, **how: Any) -> Descended:
        """Minimise the first goal from several starts (see :func:`~swimid.optimisation.descent.descend`)."""
        return descend(lambda x, _owner: self.parts(self.table(x)), starts, **how)

    def minimise_in_draws(
        self, vectors: Sequence[Array], start: Array, advance: Callable[[], Any] = lambda: None
    ) -> Descended:
        """Minimise the first goal with each of several coefficient vectors, all from one start."""
        return descend(
            lambda x, owner: self.parts(self.table(x, [vectors[k] for k in owner])),
            np.tile(start, (len(vectors), 1)),
            first=DRAW_RADIUS,
            last=DRAW_LAST,
            steps=DRAW_STEPS,
            advance=advance,
        )

    def costs(self, x: Array, vectors: Sequence[Array]) -> tuple[Array, Array]:
        """Return the quantities and the cost of one point with each of several coefficient vectors."""
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
            violation = np.maximum(self.passed(table), 0.0).sum(axis=1)
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
        return np.hstack([points, self.wanted(table)])[self.keeps(table)]
