"""From a robot file's links, hinges and elements to the checked tables the engine reads."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from swimid.errors import InputError
from swimid.fitting.model import Array
from swimid.robots.file import Fluid
from swimid.robots.planar import Multilink
from swimid.robots.spatial import Body, Hinge, Multibody
from swimid.swimmer.planar import assembly as planar
from swimid.swimmer.polynomial import Polynomial
from swimid.swimmer.spatial import engine
from swimid.swimmer.spatial.elements import ADDERS, Row, Tables, diagonal, full, place
from swimid.swimmer.tree import Tree

#: Height of a surface that is nowhere near, m.
NOWHERE = 1e9


class Assembly(Tree):
    """The links of a robot in space, checked, with their tables (:class:`swimid.swimmer.tree.Tree`).

    Parameters
    ----------
    body : Multibody
    fluid : Fluid

    Attributes
    ----------
    topology : ndarray of int, shape (links, 4)
        As of every tree, and whether a link has neither mass nor water.
    reference : ndarray, shape (3,)
        The point of the base whose pose the logs hold, m.
    """

    part, hinge = "multibody", "hinge"
    elements = ("drag", "damping", "foil", "force", "wake")

    def __init__(self, body: Multibody, fluid: Fluid) -> None:
        super().__init__(body)
        self.reference = np.array(body.reference.at_m)
        surface = NOWHERE if body.surface_z_m is None else body.surface_z_m
        self.constants = {"surface": surface, **self.constants}
        empty: list[Row] = [[0.0] * len(engine.INERTIA) for _ in self.links]
        rows = Tables(fluid.density_kg_m3, fluid.gravity_m_s2, self.index, empty)
        self.fill(rows, ADDERS, engine)
        massless = [[all(not Polynomial.of(e).terms for e in row)] for row in rows.inertia]
        self.topology = np.ascontiguousarray(np.hstack([self.topology, massless]), dtype=np.int64)

    def check(self, values: Array) -> None:
        """Refuse masses and inertias that no body has.

        Raises
        ------
        InputError
        """
        rigid, apparent = self._rigid(values), self._inertia(values)
        for i, link in enumerate(self.links):
            where = f"{self.part}.links.{link.name}"
            mass = float(rigid[i, 0])
            if mass < 0:
                raise InputError(
                    f"its mass is {mass:g} kg; it must not be negative", column=f"{where}.mass_kg"
                )
            whole = full(apparent[i])
            if not whole.any():
                if not (self.topology[:, 0] == i).any():
                    raise InputError("it has no mass and nothing hangs on it", column=f"{where}.mass_kg")
                continue
            scale = np.sqrt(np.maximum(np.diag(whole), 1e-300))
            if np.linalg.eigvalsh(whole / np.outer(scale, scale)).min() <= 0:
                raise InputError(
                    "its apparent inertia (with added mass) is not positive definite",
                    column=f"{where}.inertia_kg_m2",
                    hint="every moment of inertia of a link with mass must be positive",
                )
            if mass > 0:
                _check_moments(rigid[i], mass, where)

    def _add_rigid(self, link: Body, rows: Tables) -> None:
        mass = Polynomial.of(link.mass_kg)
        moments = [*link.inertia_kg_m2, *[0.0] * (6 - len(link.inertia_kg_m2))]
        xx, yy, zz, xy, xz, yz = place(moments)
        turning = [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]
        rows.add_mass(link.name, diagonal((mass, mass, mass)), place(link.com_m), turning)

    def _place(self, joint: Hinge | None) -> Row:
        if joint is None:
            return [0.0] * len(engine.JOINT)
        mount = Rotation.from_euler("xyz", joint.mount_deg, degrees=True)
        return hinge_row(place(joint.at_m), np.array(joint.axis), mount)


def _check_moments(row: Array, mass: float, where: str) -> None:
    """Each principal moment of a body is at most the sum of the other two."""
    whole = full(row)
    lever = -whole[:3, 3:] / mass
    central = whole[3:, 3:] - mass * (lever.T @ lever)
    moments = np.sort(np.linalg.eigvalsh(central))
    if moments[0] <= 0 or moments[2] > (1.0 + 1e-9) * (moments[0] + moments[1]):
        raise InputError(
            f"no body has the principal moments {', '.join(f'{m:.4g}' for m in moments)} kg m2",
            column=f"{where}.inertia_kg_m2",
            hint="they are about the centre of mass; each is at most the sum of the other two",
        )


def hinge_row(at: Sequence[Polynomial | float], axis: Array, mount: Rotation) -> Row:
    """A row of the engine's ``JOINT`` table.

    The place on the parent (m), the axis in the child's axes, of any length, and the turn from child to
    parent at zero angle.
    """
    unit = np.asarray(axis, dtype=float) / np.linalg.norm(axis)
    x, y, z = unit
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    zero = mount.as_matrix()
    turns = [zero, zero @ cross, zero @ cross @ cross]
    return [*at, *(float(u) for u in unit), *(float(e) for turn in turns for e in turn.ravel())]


class Lifted(planar.Assembly):
    """A planar robot's links, with their tables as the engine in space reads them.

    What a planar file does not say is taken as symmetric: no mass and no force off the plane, inertia about
    the axes in it like that about its normal.
    """

    def __init__(self, body: Multilink, fluid: Fluid) -> None:
        super().__init__(body, fluid)
        #: The second axis of the plane, the axis across it, and the turn of the planar angle.
        self.second, self.across = (1, 2) if body.plane == "horizontal" else (2, 1)
        self.normal = np.array([0.0, 0.0, 1.0] if body.plane == "horizontal" else [0.0, -1.0, 0.0])
        self.reference = self._point(-body.reference.station_m, body.reference.offset_m)
        drag = next(table for name, _, table in self._elements if name == "drag")
        self._turning = np.flatnonzero(drag.occupied[:, 6:].any(axis=1))

    def tables(self, values: Array) -> dict[str, Any]:
        """The arguments of :func:`engine.integrate` from ``topology`` on, by their names."""
        flat = super().tables(values)
        topology = np.concatenate([flat["topology"], np.zeros((len(self.links), 1), dtype=np.int64)], axis=1)
        found: dict[str, Any] = {
            "topology": np.ascontiguousarray(topology),
            "joint": np.array([self._hinge(row) for row in flat["joint"]]),
            "inertia": np.array([self._solid(row) for row in flat["inertia"]]),
            "passive": flat["passive"],
        }
        # by the file, not by the values: a coefficient may come to zero
        turning = [(flat["drag_link"][k], flat["drag"][k]) for k in self._turning]
        rows: dict[str, tuple[Any, list[Array]]] = {
            "drag": (flat["drag_link"], [self._drag(row) for row in flat["drag"]]),
            "damping": ([i for i, _ in turning], [self._damping(row) for _, row in turning]),
            "foil": (flat["foil_link"], [self._foil(row) for row in flat["foil"]]),
            "force": (flat["force_link"], [self._force(row) for row in flat["force"]]),
            "wake": (flat["wake_link"], [self._wake(row) for row in flat["wake"]]),
        }
        for name, (owner, table) in rows.items():
            found[f"{name}_link"] = np.array(owner, dtype=np.int64)
            found[name] = np.array(table).reshape(len(table), len(getattr(engine, name.upper())))
        found["surface"], found["free_base"] = NOWHERE, self.free_base
        return found

    def _point(self, x: float, y: float) -> Array:
        point = np.zeros(3)
        point[0], point[self.second] = x, y
        return point

    def _hinge(self, row: Array) -> list[float]:
        mount = Rotation.from_rotvec(math.atan2(row[3], row[2]) * self.normal)
        return [float(e) for e in hinge_row(list(self._point(row[0], row[1])), self.normal, mount)]  # type: ignore[arg-type]

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

    def _wake(self, row: Array) -> Array:
        chord, normal = self._point(1.0, 0.0), self._point(0.0, 1.0)
        return np.concatenate([self._point(row[0], row[1]), [row[2]], chord, normal])
