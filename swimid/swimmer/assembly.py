"""Rows of the input arrays of an engine, from the links and elements of a robot file.

Each kind of element (:mod:`swimid.robots.elements`) has a function in ``ADDERS``, which adds its rows for a
robot in a plane and in 3-D. The rows are written with the columns in 3-D. :class:`TableRows` takes the
columns that the engine of the robot has.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from swimid.robots import elements as parts
from swimid.robots.elements import MAX_FACTORS, derivative_parts
from swimid.robots.planar import SlenderBody, TrailingEdge
from swimid.robots.quantities import Components, Entry, Polynomial, gauss_points, use_default
from swimid.robots.spatial import Plate, Spheroid, Water, unit_vector
from swimid.swimmer.engine import ELEMENT_COLUMNS, LINK_COLUMNS, Engine

#: Type of a row of an input array before it is evaluated.
Row = list[Entry]
#: Row and column indices of the upper triangle of a symmetric 3 by 3 matrix, which is stored in an input
#: array.
UPPER = np.triu_indices(3)
#: Names in 3-D of those columns that have another name in a plane, by input array and by name in a plane.
PLANAR_NAMES = {
    "joint": {"x": "at_x", "y": "at_y", "cos_mount": "turn0_00", "sin_mount": "turn0_10"},
    "inertia": {"uu": "A00", "uv": "A01", "ur": "B02", "vv": "A11", "vr": "B12", "rr": "D22"},
    "foil": {"cos_chord": "chord_x", "sin_chord": "chord_y"},
    "load": {"moment": "moment_z"},
}


def select_columns(engine: Engine, table: str, entries: Components) -> Row:
    """Return the entries of a row for the columns that the engine has in an input array.

    The given row has the columns in 3-D. A column that the row lacks is 0.
    """
    names = (LINK_COLUMNS | ELEMENT_COLUMNS)[table]
    known = dict(zip(names, entries, strict=True))
    return [known.get(PLANAR_NAMES.get(table, {}).get(c, c), 0.0) for c in engine.columns[table]]


@dataclass
class TableRows:
    """Rows of the input arrays of an engine, as they are collected from a robot file.

    Attributes
    ----------
    engine : Engine
    density_kg_m3, gravity_m_s2 : float
    up : sequence of float
        Upward direction along the axes of the links when all joints are straight.
    index : mapping of link name to int
    inertia : list of rows, one per link
        Apparent inertia about the origin of the link.
    inputs : sequence of str
        Names of the inputs, in the order of their rows in the drive array.
    first_input : int
        Row of the first input in the drive array, after the driven joints.
    propellers : sequence of str
        Names of the propellers, in the order of their rows.
    elements : mapping of input array to list of (integers, row)
        Hydrodynamic elements, each with the index of its link and its further integers
        (:data:`swimid.swimmer.engine.INTEGERS`).
    loads : list of int
        Index of the input of each load.
    acts_in_world : bool
        Whether a force with a fixed direction in the world acts, such as weight.
    """

    engine: Engine
    density_kg_m3: float
    gravity_m_s2: float
    up: Sequence[float]
    index: Mapping[str, int]
    inputs: Sequence[str]
    first_input: int
    propellers: Sequence[str]
    inertia: list[Row] = field(init=False)
    elements: dict[str, list[tuple[tuple[int, ...], Row]]] = field(init=False)
    loads: list[int] = field(default_factory=list)
    acts_in_world: bool = False

    def __post_init__(self) -> None:
        self.inertia = [[0.0] * len(self.engine.columns["inertia"]) for _ in self.index]
        self.elements = {name: [] for name in ELEMENT_COLUMNS if name in self.engine.columns}

    def add(self, table: str, link: str, entries: Components, *integers: int) -> None:
        """Add a row to an input array, for an element of a link. The row has the columns in 3-D."""
        row = select_columns(self.engine, table, entries)
        self.elements[table].append(((self.index[link], *integers), row))

    def add_load(self, link: str, name: str, entries: Components) -> None:
        """Add a row to the input array ``load``, for a load on a link that is proportional to an input."""
        self.add("load", link, entries)
        self.loads.append(self.inputs.index(name))

    def add_force(
        self, link: str, point: Components, force: Components, world: bool, size: Any = None
    ) -> None:
        """Add a constant force at a point of a link. ``size`` is the half height of a surfacing element."""
        self.acts_in_world |= world
        self.add("force", link, [*point, *force, float(world), size or 0.0])

    def add_weight(self, link: str, point: Components, weight: Polynomial, size: Any = None) -> None:
        """Add a force that acts upwards at a point of a link, or downwards if it is negative."""
        self.add_force(link, point, [component * weight for component in self.up], True, size)

    def add_mass(
        self, link: str, point: Components, mass: Components, moments: Components = (0.0,) * 6
    ) -> None:
        """Add a point mass with one value for each direction, and an inertia about this point.

        With the diagonal matrix M of the masses and the matrix S of the cross product with the position of
        the point, the blocks of the inertia matrix are M, ``-M S`` and ``J - S M S``. The velocity of the
        point is ``v - S w``.

        Parameters
        ----------
        link : str
        point : 3 entries, m
        mass : 3 entries, or 3 by 3 entries of a symmetric matrix, kg
        moments : 6 entries, kg m2
            Components xx, yy, zz, xy, xz, yz of the inertia J about the point.
        """
        matrix = _polynomials(mass)
        if matrix.ndim == 1:
            matrix = np.diag(matrix)
        inertia = _polynomials(moments)[[[0, 3, 4], [3, 1, 5], [4, 5, 2]]]
        lever = lever_matrix(_polynomials(point))
        ms = matrix @ lever
        entries = [*matrix[UPPER], *(-ms).ravel(), *(inertia - lever @ ms)[UPPER]]
        row = self.inertia[self.index[link]]
        added = select_columns(self.engine, "inertia", entries)
        row[:] = [Polynomial.of(a) + Polynomial.of(b) for a, b in zip(row, added, strict=True)]

    def add_rigid(self, link: Any) -> None:
        """Add the mass and inertia of a link, without added mass."""
        self.add_mass(link.name, link.centre, [link.mass_kg] * 3, link.moments)

    def add_torque(self, joint: Any) -> None:
        """Add the torque of an actuator on a joint: moments on its child link and on its parent link."""
        moment = _polynomials(unit_vector(joint.axis)) * Polynomial.of(joint.torque.gain_N_m)
        # the rotation about the axis does not change the axis, so that the mounting rotation is enough
        reaction = -(mount_of(joint).as_matrix().astype(object) @ moment)
        for link, own in ((joint.child, moment), (joint.parent, reaction)):
            self.add_load(link, joint.torque.input, [*[0.0] * 6, *own, 0.0, 0.0])

    def row_of(self, name: str) -> int:
        """Return the row of an input in the drive array."""
        return self.first_input + self.inputs.index(name)


def _polynomials(entries: Any) -> Any:
    """Return entries of a robot file as an array of polynomials in its coefficients."""
    entries = np.asarray(entries, dtype=object)
    return np.array([Polynomial.of(entry) for entry in entries.ravel()], dtype=object).reshape(entries.shape)


def lever_matrix(point: Any) -> Any:
    """Return the matrix of the cross product with a vector, shape (3, 3), of numbers or polynomials."""
    x, y, z = point
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def mount_of(joint: Any) -> Rotation:
    """Return the rotation from the axes of the child link to those of the parent link at zero joint angle."""
    return Rotation.from_euler("xyz", joint.mount_angles_deg, degrees=True)


def joint_row(point: Components, axis: Sequence[float], mount: Rotation) -> Row:
    """Return the row of a joint in the ``joint`` input array in 3-D.

    Parameters
    ----------
    point : sequence of 3 entries, m
        Position of the joint on the parent link.
    axis : sequence of 3 float
        Direction of the joint in the axes of the child link, of any length.
    mount : Rotation
        Rotation from the child's axes to the parent's axes at zero angle.
    """
    unit = unit_vector(axis)
    cross, zero = lever_matrix(unit), mount.as_matrix()
    return [*point, *unit, *np.ravel([zero, zero @ cross, zero @ cross @ cross])]


# ---------------------------------------------------------------- elements


def _add_added_mass(element: Any, link: Any, rows: TableRows) -> None:
    rows.add_mass(link.name, element.point(link), element.masses, [*element.inertias, 0.0, 0.0, 0.0])


def spheroid_coefficients(semi_major: float, semi_minor: float) -> tuple[float, float, float]:
    """Return Lamb's coefficients of a prolate spheroid: along its axis, across its axis, and for rotation.

    Returns
    -------
    k1, k2 : float
        Added masses along and across the axis, divided by the displaced mass: ``alpha_0 / (2 - alpha_0)`` and
        ``beta_0 / (2 - beta_0)``. Eq 7 of Kadapa et al. on a sea lion robot prints a_0 in place of alpha_0.
    k : float
        Added inertia about a cross axis, divided by the moment of inertia of the displaced water (Lamb 1932,
        section 115): ``e^4 (b - a) / ((2 - e^2) (2 e^2 - (2 - e^2) (b - a)))`` with a = alpha_0 and b =
        beta_0.

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


def _add_spheroid(element: Spheroid, link: Any, rows: TableRows) -> None:
    """Add the added mass of a prolate spheroid at its centre (Kadapa et al. on a sea lion, Eqs 3 to 8)."""
    a, b = element.semi_major_m, element.semi_minor_m
    displaced = 4.0 / 3.0 * math.pi * rows.density_kg_m3 * a * b * b
    k1, k2, turning = spheroid_coefficients(a, b)
    factors = _polynomials(element.factors)
    inertia = turning * displaced * (a * a + b * b) / 5.0 * element.turning
    # rotation about z moves water along y, and rotation about y along z, so the factors of these axes apply
    about = factors[[0, 2, 1]] * np.array([0.0, inertia, inertia])
    masses = factors * (np.array([k1, k2, k2]) * displaced)
    rows.add_mass(link.name, element.at_m, masses, [*about, 0.0, 0.0, 0.0])


def _add_plate(element: Plate, link: Any, rows: TableRows) -> None:
    """Add the added mass ``pi rho k b c^2 / 4`` of a flat plate across its plane (Kadapa et al., Eq 9)."""
    mass = 0.25 * math.pi * rows.density_kg_m3 * element.span_m * element.chord_m**2
    unit: Any = np.array(unit_vector(element.normal))
    rows.add_mass(link.name, element.at_m, np.outer(unit, unit) * (Polynomial.of(element.k) * mass))


def _add_water(element: Water, link: Any, rows: TableRows) -> None:
    """Add the inertia of the water inside a hull, and the weight of this water if ``weighs`` is true."""
    mass = rows.density_kg_m3 * Polynomial.of(element.volume_m3)
    about = np.array(element.gyration_m, dtype=object) ** 2 * mass
    rows.add_mass(link.name, element.at_m, [mass] * 3, [*about, 0.0, 0.0, 0.0])
    if element.weighs:
        rows.add_weight(link.name, element.at_m, -rows.gravity_m_s2 * mass)


def _add_slender_body(element: SlenderBody, link: Any, rows: TableRows) -> None:
    """Add added mass ``c_m rho pi h^2 / 4`` and drag ``rho/2 (c_f p, c_d h) |v| v`` per length.

    Added mass and drag act on strips of a link with a height h and a perimeter p that vary along the link
    (Eqs 4, 7 and 8 of the paper on the built-in robot ``dolphin``).
    """
    at = np.array([s.station_m for s in element.sections])
    heights = np.array([s.height_m for s in element.sections])
    girths = np.array([s.perimeter_m for s in element.sections])
    low, high = float(at[0]), float(at[-1])
    for station, share in gauss_points(low, high, element.strips):
        height, girth = float(np.interp(station, at, heights)), float(np.interp(station, at, girths))
        half = 0.5 * rows.density_kg_m3 * share * (high - low)
        mass = 0.5 * half * math.pi * height**2 * Polynomial.of(element.added_mass_coefficient)
        forward = mass * float(element.added_mass_direction == "both")
        rows.add_mass(link.name, [-station, 0.0, 0.0], [forward, mass, 0.0])
        friction = half * girth * Polynomial.of(element.friction_coefficient)
        drag = half * height * Polynomial.of(element.drag_coefficient)
        rows.add("drag", link.name, [-station, 0.0, 0.0, friction, drag, *[0.0] * 5])


def _add_trailing_edge(element: TrailingEdge, link: Any, rows: TableRows) -> None:
    """Add the momentum shed into the wake at a trailing edge (Lighthill 1971, Proc. R. Soc. Lond. B 179:125).

    With the velocity u of the edge along the axis of its link, the velocity w across, and the added mass m
    per length at the edge, the reaction of the water on a slender body is

        ``[-m u w n + 1/2 m w^2 t] at the edge - d/dt integral of m w n over the body``

    with unit vectors n across and t along. The integral is the impulse of the lateral added mass of the
    links, and acts through their kinetic energy. The other terms are added here. They take the power 1/2 m u
    w^2, which the wake carries away. The theory does not cover an edge that moves backwards (u < 0). Such an
    edge sheds nothing: the force across is then zero, and the remaining force resists the motion.
    """
    half = 0.5 * Polynomial.of(element.added_mass_kg_m)
    rows.add("wake", link.name, [*element.point(link), half])


def _add_drag(element: Any, link: Any, rows: TableRows) -> None:
    """Add drag ``-rho/2 C A |v| v`` and linear drag along each axis of a link, at a point or on strips."""
    gains = [Polynomial.of(g) for g in (*element.quadratic(0.5 * rows.density_kg_m3), *element.linear)]
    for point, share in element.points(link):
        shares = [share * gain for gain in gains]
        rows.add("drag", link.name, [*point, *shares, element.half_height_m or 0.0])


def _add_damping(element: Any, link: Any, rows: TableRows) -> None:
    """Add the moment ``-(linear + quadratic |r|) r`` against the rotation of a link at the rate r."""
    if "damping" in rows.engine.columns:
        rows.add("damping", link.name, element.moments)
        return
    # in a plane, the columns of ``drag`` have the damping of the rotation as well
    damping = dict(zip(ELEMENT_COLUMNS["damping"], element.moments, strict=True))
    row = [damping.get(name, 0.0) for name in rows.engine.columns["drag"]]
    rows.elements["drag"].append(((rows.index[link.name],), row))


def _add_foil(element: parts.Foil, link: Any, rows: TableRows) -> None:
    """Add lift and drag of a fin with the polar of a flat plate (paper on the robot ``dolphin``, Eq 9)."""
    gain = 0.5 * rows.density_kg_m3 * Polynomial.of(element.area_m2)
    polar = element.lift_coefficient, element.drag_coefficient_0, element.drag_coefficient_1
    form: Any = element
    size = form.half_height_m or 0.0
    rows.add("foil", link.name, [*form.point(link), gain, *polar, *form.directions, size])


def _add_hydrostatics(element: Any, link: Any, rows: TableRows) -> None:
    """Add the weight of a link at its centre of mass, and the buoyancy of the link."""
    gravity = rows.gravity_m_s2
    rows.add_weight(link.name, link.centre, -gravity * Polynomial.of(link.mass_kg))
    lift = gravity * rows.density_kg_m3 * Polynomial.of(element.volume_m3)
    if lift.terms:
        rows.add_weight(link.name, element.point(link), lift, element.half_height_m)


def _add_constant_force(element: Any, link: Any, rows: TableRows) -> None:
    rows.add_force(link.name, element.point(link), element.force, element.frame == "world")


def _add_load(element: Any, link: Any, rows: TableRows) -> None:
    rows.acts_in_world |= element.frame == "world"
    row = [*element.point(link), *element.wrench, float(element.frame == "world"), 0.0]
    rows.add_load(link.name, element.input, row)


def _add_propeller(element: Any, link: Any, rows: TableRows) -> None:
    """Add a propeller whose thrust depends on its rate and on the velocity of advance."""
    size, density = element.diameter_m, rows.density_kg_m3
    padded = [*element.thrust_coefficients, 0.0, 0.0][:3]
    gains = [density * size**n * Polynomial.of(k) for n, k in zip((4, 3, 2), padded, strict=True)]
    shares = [1.0 - Polynomial.of(e) for e in (element.thrust_deduction, element.wake_fraction)]
    jet = 8.0 / (math.pi * density * size**2)
    growth = [Polynomial.of(element.wake_port) - 1.0, Polynomial.of(element.wake_starboard) - 1.0]
    row = [*element.point(link), *element.direction, *gains, *shares, jet, element.wake_decay, *growth]
    rows.add("propeller", link.name, row, rows.row_of(element.input))


def _add_rudder(element: Any, link: Any, rows: TableRows) -> None:
    """Add the normal force on a rudder, and the lateral force on the hull that it induces."""
    row = [
        *element.points,
        0.5 * rows.density_kg_m3 * Polynomial.of(element.area_m2) * Polynomial.of(element.lift_slope),
        1.0 - Polynomial.of(element.resistance_deduction),
        element.hull_force,
        element.straightening,
        use_default(element.straightening_starboard, element.straightening),
        element.inflow_ratio,
        element.slipstream_gain,
        element.slipstream_share,
    ]
    behind = rows.propellers.index(element.propeller) if element.propeller else -1
    rows.add("rudder", link.name, row, rows.row_of(element.input), behind)


def _add_moving_mass(element: Any, link: Any, rows: TableRows) -> None:
    """Add a mass that an input moves along a line of a link."""
    rows.acts_in_world |= element.weighs
    weight = rows.gravity_m_s2 * float(element.weighs) * Polynomial.of(element.mass_kg)
    row = [*element.point(link), *element.travel, element.mass_kg, weight]
    rows.add("slider", link.name, row, rows.row_of(element.input))


def _add_derivatives(element: Any, link: Any, rows: TableRows) -> None:
    """Add forces and moments that are products of the velocities of a point of a link."""
    engine, point = rows.engine, element.point(link)
    for name, coefficient in element.terms.items():
        component, factors = derivative_parts(name)
        padded = [*factors, *["1"] * (MAX_FACTORS - len(factors))]
        integers = engine.components[component], *(engine.velocities[factor] for factor in padded)
        rows.add("term", link.name, [*point, coefficient], *integers)


#: Functions that add the rows of an element to the input arrays, by kind of element.
ADDERS: dict[str, Callable[[Any, Any, TableRows], None]] = {
    "added-mass": _add_added_mass,
    "spheroid": _add_spheroid,
    "plate": _add_plate,
    "water": _add_water,
    "slender-body": _add_slender_body,
    "trailing-edge": _add_trailing_edge,
    "drag": _add_drag,
    "damping": _add_damping,
    "foil": _add_foil,
    "hydrostatics": _add_hydrostatics,
    "force": _add_constant_force,
    "load": _add_load,
    "propeller": _add_propeller,
    "rudder": _add_rudder,
    "moving-mass": _add_moving_mass,
    "derivatives": _add_derivatives,
}
