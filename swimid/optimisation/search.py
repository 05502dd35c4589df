"""What ``optimise stiffness`` searches at every point of its grid."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from swimid.fitting import genetic
from swimid.fitting.model import Array
from swimid.optimisation.descent import PENALTY, descend
from swimid.optimisation.options import OptimiseStiffnessOptions
from swimid.optimisation.performance import TOGETHER, Performance, Point
from swimid.simulation.applied import Quantity

#: First and last radius by which the best end of a front is looked at, as a share of the range.
NEAR, LAST = 0.01, 5e-4


@dataclass(frozen=True)
class Search:
    """What is searched at every point of the grid."""

    performance: Performance
    coefficient: str
    between: tuple[float, float]
    options: OptimiseStiffnessOptions

    @property
    def names(self) -> tuple[str, str]:
        """The quantities behind the two objectives."""
        if self.options.objective == "speed":
            return "mean_surge_from_start_m_s", f"{self.turn}_rate_range_rad_s"
        first = (
            "cost_of_transport_J_m"
            if self.options.objective == "cost-of-transport"
            else "mean_positive_power_W"
        )
        return first, "mean_speed_m_s"

    @property
    def turn(self) -> str:
        """What turning is called in the robot's plane."""
        return self.performance.model.pose[2].removesuffix("_rad")

    def objectives(self, point: Point, stiffness: Array) -> Array:
        """Both objectives, to be minimised, shape (n, 2); NaN where a run breaks down."""
        found = self.quantities([{**point, self.coefficient: float(k)} for k in stiffness])
        signs = (-1.0, 1.0) if self.options.objective == "speed" else (1.0, -1.0)
        return np.array([[s * value_of(q, n) for s, n in zip(signs, self.names, strict=True)] for q in found])

    def quantities(
        self, points: Sequence[Point], values: Sequence[Array] | None = None
    ) -> list[dict[str, Quantity]]:
        """What runs come to, with the coefficients of each where they are given."""
        found = []
        for k in range(0, len(points), TOGETHER):
            part = slice(k, k + TOGETHER)
            found += self.performance.quantities(points[part], None if values is None else values[part])
        return found

    def penalty(self, scale: float) -> float:
        """What a speed of nothing costs where one is asked for, in the unit of the first objective."""
        return PENALTY * scale

    def parts(
        self, point: Point, stiffness: Array, values: Sequence[Array] | None = None, scale: float = 1.0
    ) -> Array:
        """The first objective, to be minimised, and what falling short of the speed asked for costs.

        Parameters
        ----------
        stiffness : ndarray, shape (n,)
        values : sequence of ndarray, optional
            The coefficients of each.
        scale : float
            A typical size of the objective.

        Returns
        -------
        ndarray, shape (n, 1) or (n, 2)
            NaN where a run breaks down.
        """
        found = self.quantities([{**point, self.coefficient: float(k)} for k in stiffness], values)
        first, second = self.names
        sign = -1.0 if self.options.objective == "speed" else 1.0
        rows = [[sign * value_of(q, first)] for q in found]
        if (goal := self.options.reach_speed_m_s) is not None:
            for row, q in zip(rows, found, strict=True):
                row.append(self.penalty(scale) * (1.0 - value_of(q, second) / goal))
        return np.array(rows)

    def front(self, number: int, point: Point) -> Array:
        """Stiffness and objectives of the Pareto front at a point of the grid, shape (n, 3)."""
        low, high = self.between
        found = genetic.nsga2(
            lambda points: self.objectives(point, points[:, 0]),
            np.array([low]),
            np.array([high]),
            objectives=2,
            population=self.options.population,
            generations=self.options.generations,
            seed=self.options.seed + number,
            first=np.array([self.reference]),
        )
        sound = (found.objectives < genetic.BROKEN_OBJECTIVE).all(axis=1)
        front = np.column_stack([found.points, found.objectives])[sound]
        return front if self.options.pick == "knee" else self._sharpened(point, front)

    def _sharpened(self, point: Point, front: Array) -> Array:
        """The front with its best end looked at closely, by differences."""
        began = self.chosen(front)
        if not math.isfinite(began):
            return front
        low, high = self.between
        scale = float(abs(front[np.argmin(np.abs(front[:, 0] - began)), 1]))
        found = descend(
            lambda x, _owner: self.parts(point, low + x[:, 0] * (high - low), scale=scale),
            np.array([[(began - low) / (high - low)]]),
            first=NEAR,
            last=LAST,
        )
        best = low + found.points[:1, 0] * (high - low)
        whole = np.vstack([front, [float(best[0]), *self.objectives(point, best)[0]]])
        worse = np.array(
            [(whole[:, 1:] <= row).all(axis=1) & (whole[:, 1:] < row).any(axis=1) for row in whole[:, 1:]]
        )
        kept = whole[~worse.any(axis=1)]
        return kept[np.argsort(kept[:, 1], kind="stable")]

    @property
    def reference(self) -> float:
        """The stiffness gains are told against."""
        if self.options.reference is not None:
            return self.options.reference
        return float(self.performance.values[self.performance.model.index(self.coefficient)])

    def chosen(self, front: Array) -> float:
        """The stiffness chosen on a front; NaN where none reaches the speed asked for."""
        goal = self.options.reach_speed_m_s
        if goal is not None:
            front = front[-front[:, 2] >= goal]
        if not len(front):
            return math.nan
        at = genetic.knee(front[:, 1:]) if self.options.pick == "knee" else int(np.argmin(front[:, 1]))
        return float(front[at, 0])


def value_of(quantities: Mapping[str, Quantity], name: str) -> float:
    """A quantity of a run; NaN where it has none."""
    return quantities[name].value if name in quantities else math.nan
