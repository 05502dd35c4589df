"""Input arrays of the planar equations of motion from the parts of a robot file, with their checks.

The parts are links, joints and elements. Each kind of element (:mod:`swimid.robots.planar`) has a function in
``ADDERS`` that adds rows to the input arrays.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
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
from swimid.swimmer.tree import Polynomial, Row, Rows, Table, Tree, check_apparent, given, quantities


def _add_mass(
    rows: Rows,
    link: str,
    at: Sequence[Polynomial],
    forward: Polynomial,
    port: Polynomial,
    turning: Polynomial,
) -> None:
    """Add a mass, with a value for each direction, at a point, and a moment of inertia about the point."""
    x, y = at
    about = turning + forward * y * y + port * x * x
    rows.add_inertia(link, [forward, 0.0, -(forward * y), port, port * x, about])


def _point(station: float | str, offset: float | str) -> list[Polynomial]:
    """Return a point of a link in the axes of the link."""
    return [-Polynomial.of(station), Polynomial.of(offset)]


def _added_mass(element: AddedMass, link: Link, rows: Rows) -> None:
    """Add the added mass of a link at a station, by default at its centre of mass.

    It enters the kinetic energy only (tendon fish Eq 2, dolphin Eq 3). The added-mass force of Eqs 6 and 7 in
    these papers is a derivative of this energy, and must not be applied again.
    """
    station = given(element.at_m, link.com_m)
    masses = element.surge_kg, element.sway_kg, element.inertia_kg_m2
    _add_mass(rows, link.name, _point(station, element.offset_m), *(Polynomial.of(m) for m in masses))


def _damping(element: Damping, link: Link, rows: Rows) -> None:
    """Add the moment ``-(linear + quadratic |r|) r`` against the rotation of a link at the rate r."""
    turning = element.quadratic_N_m_s2_rad2, element.linear_N_m_s_rad
    rows.add("drag", link.name, [*[0.0] * 6, *turning])


def _drag(element: Drag, link: Link, rows: Rows) -> None:
    """Add Morison drag ``-rho/2 c S |v| v`` along each axis of a link (tendon fish, Eq 7).

    The drag acts at a point or on strips. The areas are divided among the strips by the weights of Gauss's
    rule.
    """
    half = 0.5 * rows.density_kg_m3
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
        high = given(element.to_m, link.length_m)
        nodes, weights = np.polynomial.legendre.leggauss(element.strips)
        stations = [Polynomial.of(low + 0.5 * (high - low) * (1.0 + float(z))) for z in nodes]
        shares = [0.5 * float(w) for w in weights]
    for station, share in zip(stations, shares, strict=True):
        row = [-station, element.offset_m, *(share * g for g in gains), 0.0, 0.0]
        rows.add("drag", link.name, row)


def _foil(element: Foil, link: Link, rows: Rows) -> None:
    """Add lift and drag of a fin with the polar of a flat plate (dolphin, Eq 9)."""
    chord = math.radians(element.chord_deg)
    polar = element.lift_coefficient, element.drag_coefficient_0, element.drag_coefficient_1
    gain = 0.5 * rows.density_kg_m3 * Polynomial.of(element.area_m2)
    at = _point(element.at_m, element.offset_m)
    rows.add("foil", link.name, [*at, gain, *polar, math.cos(chord), math.sin(chord)])


def _force(element: Force, link: Link, rows: Rows) -> None:
    """Add a constant force at a point of a link, in the axes of the link or of the world."""
    at, world = _point(element.at_m, element.offset_m), float(element.frame == "world")
    rows.add("force", link.name, [*at, element.forward_N, element.port_N, world])


def _hydrostatics(element: Hydrostatics, link: Link, rows: Rows) -> None:
    """Add the weight of a link at its centre of mass, and the buoyancy of the link, in the vertical plane."""
    gravity = rows.gravity_m_s2
    weight = -gravity * Polynomial.of(link.mass_kg)
    rows.add("force", link.name, [*_point(link.com_m, link.com_offset_m), 0.0, weight, 1.0])
    lift = gravity * rows.density_kg_m3 * Polynomial.of(element.volume_m3)
    if lift.terms:
        station = given(element.buoyancy_at_m, link.com_m)
        where = _point(station, element.buoyancy_offset_m)
        rows.add("force", link.name, [*where, 0.0, lift, 1.0])


def _slender_body(element: SlenderBody, link: Link, rows: Rows) -> None:
    """Add added mass ``c_m rho pi h^2 / 4`` and drag ``rho/2 (c_f p, c_d h) |v| v`` per length.

    Both act on strips of a link with a height h and a perimeter p that vary along it (dolphin, Eqs 4, 7 and
    8).
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
            0.25 * rows.density_kg_m3 * math.pi * height**2 * float(width)
        )
        forward = mass * float(element.added_mass_direction == "both")
        zero = Polynomial.of(0.0)
        _add_mass(rows, link.name, (Polynomial.of(-float(station)), zero), forward, mass, zero)
        half = 0.5 * rows.density_kg_m3 * float(width)
        friction = half * girth * Polynomial.of(element.friction_coefficient)
        drag = half * height * Polynomial.of(element.drag_coefficient)
        rows.add("drag", link.name, [-float(station), 0.0, friction, drag, *[0.0] * 4])


def _trailing_edge(element: TrailingEdge, link: Link, rows: Rows) -> None:
    """Add the momentum shed into the wake at a trailing edge (Lighthill 1971, Proc. R. Soc. Lond. B 179:125).

    With the velocity u of the edge along the axis of its link, the velocity w across, and the added mass m
    per length at the edge, the reaction of the water on a slender body is

        ``[-m u w n + 1/2 m w^2 t] at the edge - d/dt integral of m w n over the body``

    with unit vectors n across and t along. The integral is the impulse of the lateral added mass of the
    links, and acts through their kinetic energy. The other terms are added here. They take the power 1/2 m u
    w^2, which the wake carries away. The theory does not cover an edge that moves backwards (u < 0). Such an
    edge sheds nothing: the force across is then zero, and the remaining force resists the motion.
    """
    station = given(element.at_m, link.length_m)
    half = 0.5 * Polynomial.of(element.added_mass_kg_m)
    rows.add("wake", link.name, [*_point(station, element.offset_m), half])


#: Functions that add the rows of an element to the input arrays, by kind of element.
ADDERS: dict[str, Callable[[Any, Any, Rows], None]] = {
    "added-mass": _added_mass,
    "damping": _damping,
    "drag": _drag,
    "foil": _foil,
    "force": _force,
    "hydrostatics": _hydrostatics,
    "slender-body": _slender_body,
    "trailing-edge": _trailing_edge,
}


#: Minimum and maximum radius of gyration of a link, as a multiple of its length. Other values indicate a
#: wrong unit.
GYRATION = (0.02, 5.0)
#: Maximum density of a link, kg/m3. The volume is a block as long as the link, and as wide and high as the
#: robot is long. A higher density indicates a wrong unit (solid lead has 11340).
MAX_DENSITY = 5000.0
#: Maximum length, as a multiple of the robot's length, and maximum area, as a multiple of the square of that
#: length.
MAX_EXTENT = 3.0
#: Patterns of keys: quantities that are lengths, and quantities of elements that must not be negative.
LENGTH = re.compile(r"(?!.*_(N|N_s|kg)_m$).*_m")
LOSS = re.compile(r"area_m2|coefficient|linear|quadratic|volume|mass_kg_m")
#: Quantities of a passive joint that must not be negative, with their columns in the input array ``passive``.
ONE_SIGN = {
    "stiffness_N_m_rad": 0,
    "damping_N_m_s_rad": 2,
    "quadratic_damping_N_m_s2_rad2": 3,
    "tendon.spring_N_m": 5,
    "friction_N_m": 9,
}
#: Maximum magnitude of any quantity.
MAX_QUANTITY = 1e15


class Assembly(Tree):
    """Links of a robot in a plane, with their input arrays and checks (:class:`swimid.swimmer.tree.Tree`).

    Parameters
    ----------
    body : Multilink
    fluid : Fluid

    Attributes
    ----------
    world_forces : bool
        Whether forces with a fixed direction in the world act, such as weight.
    """

    part = "multilink"
    elements = ("drag", "foil", "force", "wake")
    engine, adders = engine, ADDERS

    def __init__(self, body: Multilink, fluid: Fluid) -> None:
        super().__init__(body)
        self._sizes = self._sized()
        rows = self.fill(fluid)
        self.world_forces = any(row[4] == 1.0 for _, row in rows.elements["force"])

    def _sized(self) -> tuple[list[str], NDArray[np.intp], NDArray[np.bool_], Table]:
        """Return paths, powers of a length, sign constraints and values of all quantities.

        The power is 1 for a length, 2 for an area and 0 otherwise. The sign constraint is true if the
        quantity must not be negative. The values are a :class:`Table` of the coefficients.
        """
        named = list(quantities(self.body, self.part))
        paths = [path for path, _ in named]
        keys = [path.rsplit(".", 1)[-1] for path in paths]
        powers = [2 * key.endswith("area_m2") or int(bool(LENGTH.fullmatch(key))) for key in keys]
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
        """Raise an error for impossible masses or inertias, and for values that indicate a wrong unit.

        Raises
        ------
        InputError
        """
        rigid, apparent = self._rigid(values), self._inertia(values)
        self._check_sizes(values)
        span = sum(link.length_m for link in self.links)
        for link, own, whole in zip(self.links, rigid, apparent, strict=True):
            _check_link(link, own, span)
            check_apparent(
                _full(whole),
                np.diag(_full(own)),
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
        """Raise an error for sizes out of proportion to the robot, and for negative areas or coefficients."""
        paths, powers, one_sign, table = self._sizes
        numbers, span = table(values)[:, 0], sum(link.length_m for link in self.links)
        far = np.where(powers > 0, MAX_EXTENT * span**powers, np.inf)
        sound = (np.abs(numbers) < MAX_QUANTITY) & (np.abs(numbers) <= far) & ~(one_sign & (numbers < 0))
        for k in np.flatnonzero(~sound)[:1]:
            number, power = float(numbers[k]), powers[k]
            if not abs(number) < MAX_QUANTITY:
                raise InputError(f"{number:g} is out of all proportion", column=paths[k])
            if abs(number) > far[k]:
                unit = ("m", "m2")[power - 1]
                raise InputError(
                    f"{number:g} {unit} is out of proportion to a robot {span:g} m long",
                    column=paths[k],
                    hint=f"lengths are in m, areas in m2: is it in {('mm', 'cm2')[power - 1]}?",
                )
            raise InputError(f"{number:g} is negative; it must not be", column=paths[k])

    def _add_rigid(self, link: Link, rows: Rows) -> None:
        mass = Polynomial.of(link.mass_kg)
        x, y = _point(link.com_m, link.com_offset_m)
        inertia = Polynomial.of(link.inertia_kg_m2)
        if link.inertia_about == "front":
            inertia = inertia - mass * (x * x + y * y)
        _add_mass(rows, link.name, (x, y), mass, mass, inertia)

    def _place(self, joint: Joint | None) -> Row:
        if joint is None:
            return [0.0, 0.0, 1.0, 0.0]
        station = given(joint.at_m, self.links[self.index[joint.parent]].length_m)
        mount = math.radians(joint.mount_deg)
        return [*_point(station, joint.offset_m), math.cos(mount), math.sin(mount)]


def _check_link(link: Link, own: Array, span: float) -> None:
    """Raise an error for a mass and inertia that no rigid link can have."""
    where = f"multilink.links.{link.name}"
    mass = float(own[0])
    if mass <= 0:
        raise InputError(f"its mass is {mass:g} kg; it must be positive", column=f"{where}.mass_kg")
    if mass > MAX_DENSITY * link.length_m * span**2:
        raise InputError(
            f"it weighs {mass:g} kg at a length of {link.length_m:g} m, in a robot {span:g} m long",
            column=f"{where}.mass_kg",
            hint="masses are in kg, lengths in m: is one of them in g or mm?",
        )
    x, y = own[4] / mass, -own[2] / mass
    central = float(own[5] - mass * (x * x + y * y))
    if central <= 1e-9 * mass * link.length_m**2:
        hint = None
        if link.inertia_about == "front":
            shift = f"the mass alone gives {mass * (x * x + y * y):.4g} kg m2 about the front end"
            hint = f"the file says it is about the front end: {shift}"
        raise InputError(
            f"its inertia leaves {central:.4g} kg m2 about the centre of mass; it must be positive",
            column=f"{where}.inertia_kg_m2",
            hint=hint,
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
    """Return the inertia matrix of a row of the ``inertia`` input array, shape (3, 3)."""
    a, b, c, d, e, f = row
    return np.array([[a, b, c], [b, d, e], [c, e, f]])
