"""From a robot file's links, hinges and elements to the checked tables the engine reads."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from swimid.errors import InputError
from swimid.fitting.model import Array
from swimid.robots.file import Fluid
from swimid.robots.planar import Driven
from swimid.robots.spatial import Body, Hinge, Multibody
from swimid.swimmer import tree
from swimid.swimmer.planar.engine import PASSIVE
from swimid.swimmer.polynomial import Polynomial, Table
from swimid.swimmer.spatial import engine
from swimid.swimmer.spatial.elements import Row, Tables, adders, place
from swimid.swimmer.spatial.inertia import diagonal, full

#: The part of the robot file.
PART = "multibody"
#: Height of a surface that is nowhere near, m.
NOWHERE = 1e9
#: The element tables, in the order of :func:`engine.integrate`.
ELEMENTS = (
    ("drag", engine.DRAG),
    ("damping", engine.DAMPING),
    ("foil", engine.FOIL),
    ("force", engine.FORCE),
    ("wake", engine.WAKE),
)


@dataclass(frozen=True)
class Axis:
    """A hinge that moves: its name, its column in a log, its link, and how it is driven."""

    name: str
    column: str
    link: int
    driven: Driven | None = None


class Assembly:
    """A robot's tree, checked, with its tables as functions of the coefficients.

    Parameters
    ----------
    body : Multibody
    fluid : Fluid

    Attributes
    ----------
    names : list of str
        Coefficients, in the order of the values given to :meth:`tables`.
    driven, passive : list of Axis
    free_base : bool
    links : int
    reference : ndarray, shape (3,)
        The point of the base whose pose the logs hold, m.

    Raises
    ------
    InputError
        With the dotted path of what is wrong.
    """

    def __init__(self, body: Multibody, fluid: Fluid) -> None:
        self.names = list(body.coefficients)
        tree.check_names(body, PART)
        links, joints = tree.ordered(body, PART)
        index = {link.name: i for i, link in enumerate(links)}
        moving = [j for j in body.joints if j.driven is not None or j.passive is not None]
        axes = {
            j.name: Axis(j.name, f"joint{k + 1}_rad", index[j.child], j.driven) for k, j in enumerate(moving)
        }
        self.driven = [axes[j.name] for j in moving if j.driven is not None]
        self.passive = [axes[j.name] for j in moving if j.passive is not None]
        self.free_base = body.base == "free"
        self.links = len(links)
        self.reference = np.array(body.reference.at_m)
        if not self.free_base and not self.passive:
            raise InputError(
                "a robot on a fixed base without a passive hinge has nothing to simulate",
                column=f"{PART}.base",
            )
        tables = Tables(fluid.density_kg_m3, fluid.gravity_m_s2, index, [[0.0] * 21 for _ in links])
        for link in links:
            _add_rigid(link, tables)
        rigid = [list(row) for row in tables.inertia]
        kinds = adders()
        for element in body.elements:
            kinds[element.kind](element, links[index[element.link]], tables)
        self._topology = np.full((len(links), 4), -1, dtype=np.int64)
        for i in range(1, len(links)):
            self._topology[i, 0] = index[joints[i].parent]
        for k, axis in enumerate(self.driven):
            self._topology[axis.link, 1] = k
        for k, axis in enumerate(self.passive):
            self._topology[axis.link, 2] = k
        self._topology[:, 3] = [all(not Polynomial.of(e).terms for e in row) for row in tables.inertia]
        self._names_of_links = [link.name for link in links]
        self._joint = Table([_hinge(j) for j in joints], len(engine.JOINT), self.names)
        self._rigid = Table(rigid, len(engine.INERTIA), self.names)
        self._inertia = Table(tables.inertia, len(engine.INERTIA), self.names)
        laws = {j.name: j for j in moving}
        self._passive = Table([_law(laws[a.name]) for a in self.passive], len(PASSIVE), self.names)
        self._elements = tree.element_tables(tables, ELEMENTS, self.names)
        self._surface = NOWHERE if body.surface_z_m is None else body.surface_z_m
        self.check(np.array([c.value for c in body.coefficients.values()]))

    def tables(self, values: Array) -> dict[str, Any]:
        """The arguments of :func:`engine.integrate` from ``topology`` on, by their names.

        Parameters
        ----------
        values : ndarray, shape (len(names),)
        """
        found: dict[str, Any] = {
            "topology": self._topology,
            "joint": self._joint(values),
            "inertia": self._inertia(values),
            "passive": self._passive(values),
        }
        for name, owner, table in self._elements:
            found[f"{name}_link"], found[name] = owner, table(values)
        found["surface"], found["free_base"] = self._surface, self.free_base
        return found

    def check(self, values: Array) -> None:
        """Refuse masses and inertias that no body has.

        Raises
        ------
        InputError
        """
        rigid, apparent = self._rigid(values), self._inertia(values)
        for i, name in enumerate(self._names_of_links):
            where = f"{PART}.links.{name}"
            mass = float(rigid[i, 0])
            if mass < 0:
                raise InputError(
                    f"its mass is {mass:g} kg; it must not be negative", column=f"{where}.mass_kg"
                )
            whole = full(apparent[i])
            if not whole.any():
                if self._childless(i):
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

    def _childless(self, i: int) -> bool:
        return not (self._topology[:, 0] == i).any()


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


def _add_rigid(link: Body, tables: Tables) -> None:
    mass = Polynomial.of(link.mass_kg)
    moments = [*link.inertia_kg_m2, *[0.0] * (6 - len(link.inertia_kg_m2))]
    xx, yy, zz, xy, xz, yz = place(moments)
    turning = [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]
    tables.add_inertia(link.name, diagonal((mass, mass, mass)), place(link.com_m), turning)


def _hinge(joint: Hinge | None) -> Row:
    if joint is None:
        return [0.0] * len(engine.JOINT)
    return hinge_row(
        place(joint.at_m), np.array(joint.axis), Rotation.from_euler("xyz", joint.mount_deg, degrees=True)
    )


def hinge_row(at: Sequence[Polynomial | float], axis: Array, mount: Rotation) -> Row:
    """A row of the engine's ``JOINT`` table.

    Parameters
    ----------
    at : 3
        Place on the parent, m.
    axis : ndarray, shape (3,)
        In the child's axes, of any length.
    mount : Rotation
        Child to parent at zero angle.
    """
    unit = np.asarray(axis, dtype=float) / np.linalg.norm(axis)
    x, y, z = unit
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    zero = mount.as_matrix()
    turns = [zero, zero @ cross, zero @ cross @ cross]
    return [*at, *(float(u) for u in unit), *(float(e) for turn in turns for e in turn.ravel())]


def _law(joint: Hinge) -> Row:
    law = joint.passive
    assert law is not None
    return [
        Polynomial.of(q)
        for q in (
            law.stiffness_N_m_rad,
            law.cubic_N_m_rad3,
            law.damping_N_m_s_rad,
            law.quadratic_damping_N_m_s2_rad2,
            math.radians(law.rest_deg),
            0.0,
            0.0,
            0.0,
            0.0,
            law.friction_N_m,
            law.friction_below_rad_s,
        )
    ]
