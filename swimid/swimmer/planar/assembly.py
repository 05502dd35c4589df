"""From a robot file's links, joints and elements to the checked tables the engine reads.

Each kind of element (:mod:`swimid.robots.planar`) adds rows to the tables by one function of ``ADDERS``.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from swimid.errors import InputError
from swimid.fitting.model import Array
from swimid.robots.file import Fluid
from swimid.robots.planar import (
    AddedMass,
    Damping,
    Drag,
    Foil,
    Force,
    Hydrostatics,
    Joint,
    Link,
    Multilink,
    SlenderBody,
    TrailingEdge,
)
from swimid.swimmer.planar import engine
from swimid.swimmer.tree import Polynomial, Row, Table, Tree, quantities


@dataclass
class Tables:
    """Rows being collected, as polynomials.

    Attributes
    ----------
    density_kg_m3, gravity_m_s2 : float
    index : dict of link name to int
    inertia : list of rows, one per link
        Apparent inertia over (u, v, r) at the link's origin; columns of ``engine.INERTIA``.
    drag, foil, force, wake : list of (link index, row)
        Columns of ``engine.DRAG``, ``engine.FOIL``, ``engine.FORCE``, ``engine.WAKE``.
    """

    density_kg_m3: float
    gravity_m_s2: float
    index: dict[str, int]
    inertia: list[Row]
    drag: list[tuple[int, Row]] = field(default_factory=list)
    foil: list[tuple[int, Row]] = field(default_factory=list)
    force: list[tuple[int, Row]] = field(default_factory=list)
    wake: list[tuple[int, Row]] = field(default_factory=list)

    def add_inertia(
        self,
        link: str,
        x: Polynomial,
        y: Polynomial,
        forward: Polynomial,
        port: Polynomial,
        turning: Polynomial,
    ) -> None:
        """Add a mass (which may differ by direction) at a point, and a moment of inertia about it."""
        about = turning + forward * y * y + port * x * x
        self.add_to(link, [forward, 0.0, -(forward * y), port, port * x, about])

    def add_to(self, link: str, terms: Row) -> None:
        """Add terms to the row of inertia of a link."""
        at = self.index[link]
        self.inertia[at] = [
            Polynomial.of(a) + Polynomial.of(b) for a, b in zip(self.inertia[at], terms, strict=True)
        ]

    def add(self, table: str, link: str, row: Row) -> None:
        """Add a row to a table of elements."""
        getattr(self, table).append((self.index[link], row))


def _point(station: float | str, offset: float | str) -> list[Polynomial]:
    """A place on a link in its axes."""
    return [-Polynomial.of(station), Polynomial.of(offset)]


def _added_mass(element: AddedMass, link: Link, tables: Tables) -> None:
    """Add the element's mass at its station (default the link's centre of mass).

    Added mass: inertia of the water a link carries along, anisotropic where its masses differ.

    Counted once, in the kinetic energy (tendon fish Eq 2, dolphin Eq 3): the added-mass force of
    their Eqs 6 and 7 is its derivative and must not be applied again.
    """
    station = link.com_m if element.at_m is None else element.at_m
    at, mass = _point(station, element.offset_m), (element.surge_kg, element.sway_kg, element.inertia_kg_m2)
    tables.add_inertia(link.name, *at, *(Polynomial.of(m) for m in mass))


def _damping(element: Damping, link: Link, tables: Tables) -> None:
    """Add ``-(linear + quadratic |r|) r``.

    Moment against the rotation of a link.
    """
    turning = element.quadratic_N_m_s2_rad2, element.linear_N_m_s_rad
    tables.add("drag", link.name, [*[0.0] * 6, *turning])


def _drag(element: Drag, link: Link, tables: Tables) -> None:
    """Add ``-rho/2 c S |v| v`` along each axis, the areas shared out by Gauss's weights.

    Morison drag at a point or on Gauss strips (tendon fish, Eq 7).
    """
    half = 0.5 * tables.density_kg_m3
    gains = (
        half * Polynomial.of(element.axial_area_m2) * Polynomial.of(element.axial_coefficient),
        half * Polynomial.of(element.normal_area_m2) * Polynomial.of(element.normal_coefficient),
        Polynomial.of(element.axial_linear_N_s_m),
        Polynomial.of(element.normal_linear_N_s_m),
    )
    if element.at_m is not None:
        stations, shares = [Polynomial.of(element.at_m)], [1.0]
    else:
        low = element.from_m or 0.0
        high = link.length_m if element.to_m is None else element.to_m
        nodes, weights = np.polynomial.legendre.leggauss(element.strips)
        stations = [Polynomial.of(low + 0.5 * (high - low) * (1.0 + float(z))) for z in nodes]
        shares = [0.5 * float(w) for w in weights]
    for station, share in zip(stations, shares, strict=True):
        row = [-station, element.offset_m, *(share * g for g in gains), 0.0, 0.0]
        tables.add("drag", link.name, row)


def _foil(element: Foil, link: Link, tables: Tables) -> None:
    """Add the fin's point, area, polar and chord direction.

    Lift and drag of a fin (dolphin, Eq 9) with the polar of a flat plate.
    """
    chord = math.radians(element.chord_deg)
    polar = element.lift_coefficient, element.drag_coefficient_0, element.drag_coefficient_1
    gain = 0.5 * tables.density_kg_m3 * Polynomial.of(element.area_m2)
    at = _point(element.at_m, element.offset_m)
    tables.add("foil", link.name, [*at, gain, *polar, math.cos(chord), math.sin(chord)])


def _force(element: Force, link: Link, tables: Tables) -> None:
    """Add the force, fixed to the link or to the world.

    A constant force at a point of a link.
    """
    at, world = _point(element.at_m, element.offset_m), 1.0 if element.frame == "world" else 0.0
    tables.add("force", link.name, [*at, element.forward_N, element.port_N, world])


def _hydrostatics(element: Hydrostatics, link: Link, tables: Tables) -> None:
    """Add the link's weight at its centre of mass, and buoyancy where the element says.

    Weight and buoyancy of a link in the vertical plane.
    """
    gravity = tables.gravity_m_s2
    weight = -gravity * Polynomial.of(link.mass_kg)
    tables.add("force", link.name, [*_point(link.com_m, link.com_offset_m), 0.0, weight, 1.0])
    lift = gravity * tables.density_kg_m3 * Polynomial.of(element.volume_m3)
    if lift.terms:
        station = link.com_m if element.buoyancy_at_m is None else element.buoyancy_at_m
        where = _point(station, element.buoyancy_offset_m)
        tables.add("force", link.name, [*where, 0.0, lift, 1.0])


def _slender_body(element: SlenderBody, link: Link, tables: Tables) -> None:
    """Add added mass ``c_m rho pi h^2 / 4`` and drag ``rho/2 (c_f p, c_d h) |v| v`` per length.

    Strips over a link whose cross-section varies along it (dolphin, Eqs 4, 7 and 8).
    """
    at = np.array([s.station_m for s in element.sections])
    heights = np.array([s.height_m for s in element.sections])
    girths = np.array([s.perimeter_m for s in element.sections])
    low, high = float(at[0]), float(at[-1])
    nodes, weights = np.polynomial.legendre.leggauss(element.strips)
    stations = low + 0.5 * (high - low) * (1.0 + nodes)
    for station, width in zip(stations, 0.5 * (high - low) * weights, strict=True):
        height, girth = float(np.interp(station, at, heights)), float(np.interp(station, at, girths))
        mass = Polynomial.of(element.added_mass_coefficient) * (
            0.25 * tables.density_kg_m3 * math.pi * height**2 * float(width)
        )
        forward = mass if element.added_mass_direction == "both" else Polynomial.of(0.0)
        zero = Polynomial.of(0.0)
        tables.add_inertia(link.name, Polynomial.of(-float(station)), zero, forward, mass, zero)
        half = 0.5 * tables.density_kg_m3 * float(width)
        friction = half * girth * Polynomial.of(element.friction_coefficient)
        drag = half * height * Polynomial.of(element.drag_coefficient)
        tables.add("drag", link.name, [-float(station), 0.0, friction, drag, *[0.0] * 4])


def _trailing_edge(element: TrailingEdge, link: Link, tables: Tables) -> None:
    """Add the edge's point and half its added mass per length.

    Momentum shed into the wake at a trailing edge (Lighthill 1971, Proc. R. Soc. Lond. B 179:125).

    With u and w the edge's velocity along its link's axis and across it, and m the added mass per length
    there, the water's reaction on a slender body is

        ``[-m u w n + 1/2 m w^2 t] at the edge - d/dt integral of m w n over the body``

    (n and t unit vectors across and along). The integral is the impulse of the links' lateral added mass
    and acts through their kinetic energy; what is left acts here. It takes the energy 1/2 m u w^2 per time,
    which the wake carries off. An edge that moves backwards (u < 0) leads and sheds nothing, a case outside
    the theory: the force across is then zero, and what is left resists the motion.
    """
    station = link.length_m if element.at_m is None else element.at_m
    half = 0.5 * Polynomial.of(element.added_mass_kg_m)
    tables.add("wake", link.name, [*_point(station, element.offset_m), half])


#: Function that adds the rows of an element to the tables, by its kind.
ADDERS: dict[str, Callable[[Any, Any, Tables], None]] = {
    "added-mass": _added_mass,
    "damping": _damping,
    "drag": _drag,
    "foil": _foil,
    "force": _force,
    "hydrostatics": _hydrostatics,
    "slender-body": _slender_body,
    "trailing-edge": _trailing_edge,
}


#: A radius of gyration outside these multiples of a link's length is taken for a slip of units.
GYRATION = (0.02, 5.0)
#: So is a link heavier than a block of this density, kg/m3, its own length and as wide and high as the
#: robot is long (solid lead has 11340).
DENSEST = 5000.0
#: A length may not exceed this times the robot's, an area this times its square.
FAR = 3.0
#: Keys that hold lengths, and keys of elements whose quantity has only one sign.
LENGTH = re.compile(r"(?!.*_(N|N_s|kg)_m$).*_m")
LOSS = re.compile(r"area_m2|coefficient|linear|quadratic|volume|mass_kg_m")
#: What of a passive joint's law has only one sign, and its column in the engine's table.
ONE_SIGN = {
    "stiffness_N_m_rad": 0,
    "damping_N_m_s_rad": 2,
    "quadratic_damping_N_m_s2_rad2": 3,
    "tendon.spring_N_m": 5,
    "friction_N_m": 9,
}
#: A number beyond this is a slip of the pen.
HUGE = 1e15


class Assembly(Tree):
    """A planar robot's links, checked, with their tables (:class:`swimid.swimmer.tree.Tree`).

    Parameters
    ----------
    body : Multilink
    fluid : Fluid
    """

    part, hinge = "multilink", "joint"
    elements = ("drag", "foil", "force", "wake")

    def __init__(self, body: Multilink, fluid: Fluid) -> None:
        super().__init__(body)
        self._sizes = self._sized()
        rows = self.fill(fluid, Tables, ADDERS, engine)
        self.world_forces = any(row[4] == 1.0 for _, row in rows.force)

    def _sized(self) -> tuple[list[str], NDArray[np.intp], NDArray[np.bool_], Table]:
        """Paths of the quantities, the power of a length each is, which have one sign, their values."""
        named = quantities(self.body, "multilink")
        paths = [path for path, _ in named]
        keys = [path.rsplit(".", 1)[-1] for path in paths]
        powers = [2 if key.endswith("area_m2") else 1 if LENGTH.fullmatch(key) else 0 for key in keys]
        losses = [
            path.startswith("multilink.elements") and LOSS.search(key) is not None
            for path, key in zip(paths, keys, strict=True)
        ]
        table = Table([[Polynomial.of(quantity)] for _, quantity in named], 1, self.names)
        return paths, np.array(powers), np.array(losses), table

    @property
    def unknowns(self) -> int:
        """Degrees of freedom n: 3 of the base and one per passive joint."""
        return 3 + len(self.passive)

    def check(self, values: Array) -> None:
        """Refuse masses and inertias that no body has, and what looks like a slip of units.

        Raises
        ------
        InputError
        """
        rigid, apparent = self._rigid(values), self._inertia(values)
        self._check_sizes(values)
        span = sum(link.length_m for link in self.links)
        for link, own, whole in zip(self.links, rigid, apparent, strict=True):
            _check_link(link, own, span)
            scale = np.sqrt(np.diag(_full(own)))
            if np.linalg.eigvalsh(_full(whole) / np.outer(scale, scale)).min() <= 0:
                raise InputError(
                    "its apparent inertia (with added mass) is not positive definite",
                    column=f"multilink.links.{link.name}",
                    hint="an added mass or inertia is negative",
                )
        for axis, law in zip(self.passive, self._passive(values), strict=True):
            for key, column in ONE_SIGN.items():
                if law[column] < 0:
                    raise InputError(
                        f"{law[column]:g} is negative; it must not be",
                        column=f"multilink.joints.{axis.joint.name}.passive.{key}",
                    )

    def _check_sizes(self, values: Array) -> None:
        """Refuse sizes out of proportion to the robot, and negative areas and coefficients."""
        paths, powers, one_sign, table = self._sizes
        numbers, span = table(values)[:, 0], sum(link.length_m for link in self.links)
        far = np.where(powers > 0, FAR * span**powers, np.inf)
        sound = (np.abs(numbers) < HUGE) & (np.abs(numbers) <= far) & ~(one_sign & (numbers < 0))
        for k in np.flatnonzero(~sound)[:1]:
            number, power = float(numbers[k]), powers[k]
            if not abs(number) < HUGE:
                raise InputError(f"{number:g} is out of all proportion", column=paths[k])
            if abs(number) > far[k]:
                unit = ("m", "m2")[power - 1]
                raise InputError(
                    f"{number:g} {unit} is out of proportion to a robot {span:g} m long",
                    column=paths[k],
                    hint=f"lengths are in m, areas in m2: is it in {'mm' if power == 1 else 'cm2'}?",
                )
            raise InputError(f"{number:g} is negative; it must not be", column=paths[k])

    def _add_rigid(self, link: Link, rows: Tables) -> None:
        mass = Polynomial.of(link.mass_kg)
        x, y = _point(link.com_m, link.com_offset_m)
        inertia = Polynomial.of(link.inertia_kg_m2)
        if link.inertia_about == "front":
            inertia = inertia - mass * (x * x + y * y)
        rows.add_inertia(link.name, x, y, mass, mass, inertia)

    def _place(self, joint: Joint | None) -> Row:
        if joint is None:
            return [0.0, 0.0, 1.0, 0.0]
        station = self.links[self.index[joint.parent]].length_m if joint.at_m is None else joint.at_m
        mount = math.radians(joint.mount_deg)
        return [*_point(station, joint.offset_m), math.cos(mount), math.sin(mount)]


def _check_link(link: Link, own: Array, span: float) -> None:
    """Refuse a rigid link that no body is."""
    where = f"multilink.links.{link.name}"
    mass = float(own[0])
    if mass <= 0:
        raise InputError(f"its mass is {mass:g} kg; it must be positive", column=f"{where}.mass_kg")
    if mass > DENSEST * link.length_m * span**2:
        raise InputError(
            f"it weighs {mass:g} kg at a length of {link.length_m:g} m, in a robot {span:g} m long",
            column=f"{where}.mass_kg",
            hint="masses are in kg, lengths in m: is one of them in g or mm?",
        )
    x, y = own[4] / mass, -own[2] / mass
    central = float(own[5] - mass * (x * x + y * y))
    if central <= 1e-9 * mass * link.length_m**2:
        shift = f"the mass alone gives {mass * (x * x + y * y):.4g} kg m2 about the front end"
        raise InputError(
            f"its inertia leaves {central:.4g} kg m2 about the centre of mass; it must be positive",
            column=f"{where}.inertia_kg_m2",
            hint=f"the file says it is about the front end: {shift}"
            if link.inertia_about == "front"
            else None,
        )
    radius = math.sqrt(central / mass)
    if not GYRATION[0] <= radius / link.length_m <= GYRATION[1]:
        raise InputError(
            f"mass {mass:g} kg and inertia {central:.4g} kg m2 give a radius of gyration of "
            f"{1e3 * radius:.4g} mm for a length of {1e3 * link.length_m:.4g} mm",
            column=f"{where}.inertia_kg_m2",
            hint="lengths are in m, masses in kg, inertias in kg m2: is one in mm, g or g m2?",
        )


def _full(row: Array) -> Array:
    a, b, c, d, e, f = row
    return np.array([[a, b, c], [b, d, e], [c, e, f]])
