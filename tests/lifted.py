"""Planar robots in the tables of the engine in space, to compare both engines."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from swimid.fitting.model import Array
from swimid.robots.file import Fluid
from swimid.robots.planar import MultilinkRobot
from swimid.swimmer.assembly import joint_row
from swimid.swimmer.engine import INTEGERS
from swimid.swimmer.planar.model import PlanarTree
from swimid.swimmer.spatial.engine import COLUMNS, SPATIAL_ENGINE
from swimid.swimmer.spatial.model import NOWHERE, MultibodyModel


class Lifted(PlanarTree):
    """Links of a planar robot, with their tables for the engine in space.

    A planar file is silent about motion off the plane. The robot is taken as symmetric: no mass and no force
    acts off the plane, and inertias about axes in the plane equal those about its normal.
    """

    def __init__(self, body: MultilinkRobot, fluid: Fluid) -> None:
        super().__init__(body, fluid)
        #: The engine that takes the tables.
        self.engine = SPATIAL_ENGINE
        #: The second axis of the plane, the axis across it, and the turn of the planar angle.
        self.second, self.across = (1, 2) if body.plane == "horizontal" else (2, 1)
        self.normal = np.array([0.0, 0.0, 1.0] if body.plane == "horizontal" else [0.0, -1.0, 0.0])
        self.reference = self._point(-body.reference.station_m, body.reference.offset_m)
        draw = np.random.default_rng(0).uniform(0.5, 1.5, len(self.names))
        self._turning = np.flatnonzero(super().tables(draw)["drag"][:, 6:].any(axis=1))

    def tables(self, values: Array) -> dict[str, Any]:
        """Return the tables of the engine in space."""
        flat = super().tables(values)
        topology = np.concatenate([flat["topology"], np.zeros((len(self.links), 1), dtype=np.int64)], axis=1)
        found: dict[str, Any] = {
            "topology": np.ascontiguousarray(topology),
            "joint": np.array([self._hinge(row) for row in flat["joint"]]),
            "inertia": np.array([self._solid(row) for row in flat["inertia"]]),
            "passive": flat["passive"],
        }
        # the rows follow from the file, because a coefficient may become zero
        turning = [(flat["drag_link"][k], flat["drag"][k]) for k in self._turning]
        rows: dict[str, tuple[Any, list[Array]]] = {
            "drag": (flat["drag_link"], [self._drag(row) for row in flat["drag"]]),
            "damping": ([i for i, _ in turning], [self._damping(row) for _, row in turning]),
            "foil": (flat["foil_link"], [self._foil(row) for row in flat["foil"]]),
            "force": (flat["force_link"], [self._force(row) for row in flat["force"]]),
            "load": (flat["load_link"], [self._load(row) for row in flat["load"]]),
        }
        for name, (owner, table) in rows.items():
            found[f"{name}_link"] = np.array(owner, dtype=np.int64)
            found[name] = np.array(table).reshape(len(table), len(COLUMNS[name]))
        for name, count in INTEGERS.items():
            found[f"{name}_link"] = np.empty((0, count), dtype=np.int64)
            found[name] = np.empty((0, len(COLUMNS[name])))
        found["load_input"] = flat["load_input"]
        found["surface"], found["free_base"] = NOWHERE, self.free_base
        return found

    def _point(self, x: float, y: float) -> Array:
        point = np.zeros(3)
        point[0], point[self.second] = x, y
        return point

    def _hinge(self, row: Array) -> list[float]:
        mount = Rotation.from_rotvec(math.atan2(row[3], row[2]) * self.normal)
        return [float(e) for e in joint_row(list(self._point(row[0], row[1])), self.normal, mount)]  # type: ignore[arg-type]

    def _solid(self, row: Array) -> Array:
        uu, uv, ur, vv, vr, rr = row
        e, o, sign = self.second, self.across, float(self.normal.sum())
        mass, coupling, moment = np.zeros((3, 3)), np.zeros((3, 3)), np.eye(3) * rr
        mass[0, 0], mass[e, e], mass[o, o] = uu, vv, 0.5 * (uu + vv)
        mass[0, e] = mass[e, 0] = uv
        coupling[0, o], coupling[e, o] = sign * ur, sign * vr
        upper = np.triu_indices(3)
        return np.concatenate([mass[upper], coupling.ravel(), moment[upper]])

    def _drag(self, row: Array) -> Array:
        return np.concatenate(
            [self._point(row[0], row[1]), self._point(row[2], row[3]), self._point(row[4], row[5]), [0.0]]
        )

    def _damping(self, row: Array) -> Array:
        found = np.zeros(6)
        found[self.across], found[3 + self.across] = row[6], row[7]
        return found

    def _foil(self, row: Array) -> Array:
        chord, normal = self._point(row[6], row[7]), self._point(-row[7], row[6])
        return np.concatenate([self._point(row[0], row[1]), row[2:6], chord, normal, [0.0]])

    def _force(self, row: Array) -> Array:
        return np.concatenate([self._point(row[0], row[1]), self._point(row[2], row[3]), [row[4], 0.0]])

    def _load(self, row: Array) -> Array:
        return np.concatenate(
            [self._point(row[0], row[1]), self._point(row[2], row[3]), row[4] * self.normal, row[5:]]
        )


class LiftedModel(MultibodyModel):
    """A planar robot as a model in space."""

    def _tree(self) -> Lifted:  # type: ignore[override]
        assert self.robot.multilink is not None
        return Lifted(self.robot.multilink, self.robot.fluid)
