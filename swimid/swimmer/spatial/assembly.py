"""From a robot file's links, hinges and elements to the checked tables the engine reads.

Each kind of element (:mod:`swimid.robots.spatial`) adds rows to the tables by one function of ``ADDERS``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from swimid.errors import InputError
from swimid.fitting.model import Array
from swimid.robots.file import Fluid
from swimid.robots.planar import Multilink
from swimid.robots.spatial import (
    AddedMass,
    Body,
    Damping,
    Drag,
    Foil,
    Force,
    Hinge,
    Hydrostatics,
    Multibody,
    Plate,
    Spheroid,
    Water,
)
from swimid.swimmer.planar import assembly as planar
from swimid.swimmer.spatial import engine
from swimid.swimmer.tree import Entry, Polynomial, Row, Tree


@dataclass
class Tables(planar.Tables):
    """Rows being collected, as polynomials.

    The tables of a planar robot, with ``damping``: (link index, row) in columns of ``engine.DAMPING``.
    """

    damping: list[tuple[int, Row]] = field(default_factory=list)

    def add_mass(
        self,
        link: str,
        mass: Sequence[Sequence[Entry]],
        at: Sequence[Entry],
        turning: Sequence[Sequence[Entry]] | None = None,
    ) -> None:
        """Add a mass (which may differ by direction) at a place, and a moment of inertia about it."""
        self.add_to(link, block(mass, at, turning or diagonal((0.0, 0.0, 0.0))))


def _polynomials(vector: Sequence[Entry]) -> list[Polynomial]:
    return [Polynomial.of(entry) for entry in vector]


#: Rows and columns of the entries a symmetric block is stored by.
UPPER = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))


def block(
    mass: Sequence[Sequence[Entry]],
    at: Sequence[Entry],
    turning: Sequence[Sequence[Entry]],
) -> Row:
    """The stored entries (:data:`swimid.swimmer.spatial.engine.INERTIA`) of a mass at a place.

    A, ``B = -M S`` and ``D = J - S M S`` with ``S`` the lever's cross product: the velocity of the place (m)
    is ``v - S w``. The mass is symmetric, 3 by 3, momentum of the place for its velocity, kg; turning is
    inertia about that place, kg m2.
    """
    m = np.array([[Polynomial.of(e) for e in row] for row in mass])
    x, y, z = _polynomials(at)
    none = Polynomial.of(0.0)
    lever = np.array([[none, -z, y], [z, none, -x], [-y, x, none]])
    ms = m @ lever
    sms = lever @ ms
    a = [m[r, c] for r, c in UPPER]
    d = [Polynomial.of(turning[r][c]) - sms[r, c] for r, c in UPPER]
    return [*a, *(-ms).ravel(), *d]


def diagonal(values: Sequence[Entry]) -> list[list[Entry]]:
    """A matrix of these values on its diagonal."""
    return [[values[r] if r == c else 0.0 for c in range(3)] for r in range(3)]


def along(direction: Sequence[float], size: Entry) -> list[list[Entry]]:
    """A mass that only motion along a unit direction feels."""
    unit = np.asarray(direction, dtype=float) / np.linalg.norm(direction)
    return [[Polynomial.of(size) * float(unit[r] * unit[c]) for c in range(3)] for r in range(3)]


def full(row: Array) -> Array:
    """The 6 by 6 matrix of a stored row of numbers, shape (6, 6)."""
    a, b, d = (np.zeros((3, 3)) for _ in range(3))
    for n, (r, c) in enumerate(UPPER):
        a[r, c] = a[c, r] = row[n]
        d[r, c] = d[c, r] = row[15 + n]
    b[:] = np.asarray(row[6:15]).reshape(3, 3)
    return np.block([[a, b], [b.T, d]])


def _added_mass(element: AddedMass, body: Body, tables: Tables) -> None:
    """Added mass along the axes of a link, and added inertia about them. Add the masses at their place."""
    tables.add_mass(body.name, diagonal(element.mass_kg), element.at_m, diagonal(element.inertia_kg_m2))


def spheroid_coefficients(semi_major: float, semi_minor: float) -> tuple[float, float, float]:
    """Lamb's coefficients k1 (along the axis), k2 (across) and k' (turning about a cross axis).

    Returns
    -------
    k1, k2 : float
        Shares of the displaced mass, ``alpha_0 / (2 - alpha_0)`` and ``beta_0 / (2 - beta_0)``; the paper's
        Eq 7 writes a_0 (the semi-major axis' letter) for alpha_0.
    k : float
        Share of the displaced water's moment of inertia (Lamb 1932, section 115), with a, b for the two,
        ``e^4 (b - a) / ((2 - e^2) (2 e^2 - (2 - e^2) (b - a)))``.

    >>> [round(k, 3) for k in spheroid_coefficients(6.0, 1.0)]
    [0.045, 0.917, 0.762]
    """
    e = math.sqrt(1.0 - (semi_minor / semi_major) ** 2)
    log = math.log((1.0 + e) / (1.0 - e))
    alpha = 2.0 * (1.0 - e * e) / e**3 * (0.5 * log - e)
    beta = 1.0 / (e * e) - (1.0 - e * e) / (2.0 * e**3) * log
    off = 2.0 - e * e
    turning = e**4 * (beta - alpha) / (off * (2.0 * e * e - off * (beta - alpha)))
    return alpha / (2.0 - alpha), beta / (2.0 - beta), turning


def _spheroid(element: Spheroid, body: Body, tables: Tables) -> None:
    """Added mass of a prolate spheroid (sea lion, Eqs 3 to 8).

    Add the water a spheroid moves, at its middle.
    """
    a, b = element.semi_major_m, element.semi_minor_m
    displaced = 4.0 / 3.0 * math.pi * tables.density_kg_m3 * a * b * b
    k1, k2, turning = spheroid_coefficients(a, b)
    factors = _polynomials(element.factors)
    masses = [f * (k * displaced) for f, k in zip(factors, (k1, k2, k2), strict=True)]
    inertia = turning * displaced * (a * a + b * b) / 5.0 if element.turning else 0.0
    # turning about z moves water sideways, about y up and down: the factors go with it
    about = (0.0, factors[2] * inertia, factors[1] * inertia)
    tables.add_mass(body.name, diagonal(masses), element.at_m, diagonal(about))


def _plate(element: Plate, body: Body, tables: Tables) -> None:
    """Added mass of a flat plate (sea lion, Eq 9).

    Add ``pi rho k b c^2 / 4`` across the plate, at its place.
    """
    mass = 0.25 * math.pi * tables.density_kg_m3 * element.span_m * element.chord_m**2
    tables.add_mass(body.name, along(element.normal, Polynomial.of(element.k) * mass), element.at_m)


def _drag(element: Drag, body: Body, tables: Tables) -> None:
    """Add ``-rho/2 C A |v| v`` and linear drag, integrated along a row of strips by Gauss's rule.

    Drag along each axis of a link, at points (sea lion, Eq 2).
    """
    half = 0.5 * tables.density_kg_m3
    areas, coefficients = _polynomials(element.area_m2), _polynomials(element.coefficient)
    quadratic = [half * a * c for a, c in zip(areas, coefficients, strict=True)]
    linear = _polynomials(element.linear_N_s_m)
    near = _polynomials(element.at_m)
    far = near if element.to_m is None else _polynomials(element.to_m)
    for point, weight in zip(*np.polynomial.legendre.leggauss(element.strips), strict=True):
        along, share = 0.5 * (1.0 + float(point)), 0.5 * float(weight)
        at = [
            a if element.to_m is None else (1.0 - along) * a + along * b
            for a, b in zip(near, far, strict=True)
        ]
        gains = [share * gain for gain in (*quadratic, *linear)]
        tables.add("drag", body.name, [*at, *gains, element.half_height_m or 0.0])


def _damping(element: Damping, body: Body, tables: Tables) -> None:
    """Add quadratic and linear moments about the link's axes.

    Moments against rotation.
    """
    tables.add("damping", body.name, [*element.quadratic_N_m_s2_rad2, *element.linear_N_m_s_rad])


def _foil(element: Foil, body: Body, tables: Tables) -> None:
    """Add the fin's point, area, polar and directions.

    Lift and drag of a fin with the polar of a flat plate.
    """
    chord, normal = (
        [float(c) for c in np.asarray(d) / np.linalg.norm(d)] for d in (element.chord, element.normal)
    )
    gain = 0.5 * tables.density_kg_m3 * Polynomial.of(element.area_m2)
    polar = element.lift_coefficient, element.drag_coefficient_0, element.drag_coefficient_1
    row = [*element.at_m, gain, *polar, *chord, *normal, element.half_height_m or 0.0]
    tables.add("foil", body.name, row)


def _hydrostatics(element: Hydrostatics, body: Body, tables: Tables) -> None:
    """Add the weight at the centre of mass, and buoyancy where the element says.

    Weight and buoyancy of a link.
    """
    gravity = tables.gravity_m_s2
    weight = -gravity * Polynomial.of(body.mass_kg)
    tables.add("force", body.name, [*body.com_m, 0.0, 0.0, weight, 1.0, 0.0])
    lift = gravity * tables.density_kg_m3 * Polynomial.of(element.volume_m3)
    if lift.terms:
        at = body.com_m if element.buoyancy_at_m is None else element.buoyancy_at_m
        tables.add("force", body.name, [*at, 0.0, 0.0, lift, 1.0, element.half_height_m or 0.0])


def _water(element: Water, body: Body, tables: Tables) -> None:
    """Add its inertia; in a hull open to the water its weight and the buoyancy of its space balance.

    Water inside a hull.
    """
    mass = tables.density_kg_m3 * Polynomial.of(element.volume_m3)
    about = [mass * float(k) ** 2 for k in element.gyration_m]
    tables.add_mass(body.name, diagonal((mass, mass, mass)), element.at_m, diagonal(about))
    if element.weighs:
        weight = -tables.gravity_m_s2 * mass
        tables.add("force", body.name, [*element.at_m, 0.0, 0.0, weight, 1.0, 0.0])


def _force(element: Force, body: Body, tables: Tables) -> None:
    """Add the force at its point.

    A constant force.
    """
    world = 1.0 if element.frame == "world" else 0.0
    tables.add("force", body.name, [*element.at_m, *element.force_N, world, 0.0])


#: Function that adds the rows of an element to the tables, by its kind.
ADDERS: dict[str, Callable[[Any, Any, Tables], None]] = {
    "added-mass": _added_mass,
    "spheroid": _spheroid,
    "plate": _plate,
    "drag": _drag,
    "damping": _damping,
    "foil": _foil,
    "hydrostatics": _hydrostatics,
    "water": _water,
    "force": _force,
}


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
        rows = self.fill(fluid, Tables, ADDERS, engine)
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
        xx, yy, zz, xy, xz, yz = moments
        turning = [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]
        rows.add_mass(link.name, diagonal((mass, mass, mass)), link.com_m, turning)

    def _place(self, joint: Hinge | None) -> Row:
        if joint is None:
            return [0.0] * len(engine.JOINT)
        mount = Rotation.from_euler("xyz", joint.mount_deg, degrees=True)
        return hinge_row(joint.at_m, np.array(joint.axis), mount)


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


def hinge_row(at: Sequence[Entry], axis: Array, mount: Rotation) -> Row:
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
