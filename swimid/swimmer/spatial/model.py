"""Model of a robot in 3-D: input arrays from a robot file, and simulation.

Each kind of element (:mod:`swimid.robots.spatial`) has a function in ``ADDERS`` that adds rows to the input
arrays of the equations of motion. :class:`Assembly` collects and checks them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from swimid.errors import InputError
from swimid.fitting.model import Array, Hooks, Trial
from swimid.kinematics.attitude import angles, from_angles
from swimid.robots import spatial as parts
from swimid.robots.file import Fluid
from swimid.swimmer.model import Swimmer, flows, rotate_vector
from swimid.swimmer.spatial import engine
from swimid.swimmer.tree import (
    SYMMETRIC,
    Entry,
    Polynomial,
    Row,
    TableRows,
    Tree,
    check_apparent,
    gauss_points,
    use_default,
)

#: Row and column indices of the upper triangle of a symmetric 3 by 3 matrix, which is stored in an input
#: array.
UPPER = np.triu_indices(3)
ZERO_MATRIX = np.zeros((3, 3))


def _vector(entries: Sequence[Entry]) -> Any:
    """Return entries of a robot file as an array of polynomials in its coefficients."""
    return np.array([Polynomial.of(entry) for entry in entries], dtype=object)


def cross_product_matrix(point: Any) -> Any:
    """Return the matrix of the cross product with a vector, shape (3, 3), of numbers or polynomials."""
    x, y, z = point
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def centre_of_mass(row: Array) -> Array:
    """Return the centre of mass of a row of the ``inertia`` input array without added mass, m, shape (3,)."""
    whole = full(row)
    return np.array([whole[5, 1], whole[3, 2], whole[4, 0]]) / whole[0, 0]


def _add_mass(rows: TableRows, link: str, mass: Any, at: Sequence[Entry], turning: Any = ZERO_MATRIX) -> None:
    """Add a point mass with one value for each direction, and an inertia about this point.

    The added entries (:data:`swimid.swimmer.spatial.engine.INERTIA`) are the blocks A = M, ``B = -M S`` and
    ``D = J - S M S`` of the inertia matrix. S is the matrix of the cross product with the position of the
    point. The velocity of the point is ``v - S w``.

    Parameters
    ----------
    mass : 3 by 3 entries, kg
        Symmetric matrix M. Its product with the velocity of the point is the momentum.
    at : 3 entries, m
        Position of the point.
    turning : 3 by 3 entries, kg m2
        Inertia J about the point.
    """
    lever = cross_product_matrix(_vector(at))
    ms = mass @ lever
    rows.add_inertia(link, [*mass[UPPER], *(-ms).ravel(), *(turning - lever @ ms)[UPPER]])


def full(row: Array) -> Array:
    """Return the inertia matrix that a row of the ``inertia`` input array represents, shape (6, 6)."""
    b = row[6:15].reshape(3, 3)
    return np.block([[row[:6][SYMMETRIC], b], [b.T, row[15:][SYMMETRIC]]])


def _added_mass(element: parts.AddedMass, body: parts.Body, rows: TableRows) -> None:
    """Add added masses along the axes of a link, and added inertias about these axes."""
    mass, turning = (np.diag(_vector(v)) for v in (element.mass_kg, element.inertia_kg_m2))
    _add_mass(rows, body.name, mass, element.at_m, turning)


def spheroid_coefficients(semi_major: float, semi_minor: float) -> tuple[float, float, float]:
    """Return Lamb's coefficients of a prolate spheroid: along its axis, across its axis, and for rotation.

    Returns
    -------
    k1, k2 : float
        Added masses along and across the axis, divided by the displaced mass: ``alpha_0 / (2 - alpha_0)`` and
        ``beta_0 / (2 - beta_0)``. Eq 7 of the sea lion paper prints a_0 in place of alpha_0.
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


def _spheroid(element: parts.Spheroid, body: parts.Body, rows: TableRows) -> None:
    """Add the added mass of a prolate spheroid at the centre of the spheroid (sea lion, Eqs 3 to 8)."""
    a, b = element.semi_major_m, element.semi_minor_m
    displaced = 4.0 / 3.0 * math.pi * rows.density_kg_m3 * a * b * b
    k1, k2, turning = spheroid_coefficients(a, b)
    factors = _vector(element.factors)
    masses = factors * (np.array([k1, k2, k2]) * displaced)
    inertia = turning * displaced * (a * a + b * b) / 5.0 * element.turning
    # rotation about z moves water along y, and rotation about y along z, so the factors of these axes apply
    about = factors[[0, 2, 1]] * np.array([0.0, inertia, inertia])
    _add_mass(rows, body.name, np.diag(masses), element.at_m, np.diag(about))


def _plate(element: parts.Plate, body: parts.Body, rows: TableRows) -> None:
    """Add the added mass ``pi rho k b c^2 / 4`` of a flat plate across its plane (sea lion, Eq 9)."""
    mass = 0.25 * math.pi * rows.density_kg_m3 * element.span_m * element.chord_m**2
    unit: Any = _unit(element.normal)
    _add_mass(rows, body.name, np.outer(unit, unit) * (Polynomial.of(element.k) * mass), element.at_m)


def _unit(direction: Sequence[float] | Array) -> Array:
    """Return the unit vector of a direction."""
    return np.asarray(direction, dtype=float) / np.linalg.norm(direction)


def _drag(element: parts.Drag, body: parts.Body, rows: TableRows) -> None:
    """Add drag ``-rho/2 C A |v| v`` and linear drag along each axis of a link (sea lion, Eq 2).

    The drag acts at a point, or on a row of strips at the points of Gauss's rule.
    """
    half = 0.5 * rows.density_kg_m3
    quadratic = half * _vector(element.area_m2) * _vector(element.coefficient)
    quadratic = quadratic + _vector(element.quadratic_N_s2_m2)
    gains = [*quadratic, *_vector(element.linear_N_s_m)]
    ends = _vector(element.at_m), _vector(use_default(element.to_m, element.at_m))
    for at, share in gauss_points(*ends, element.strips):
        shares = [share * gain for gain in gains]
        rows.add("drag", body.name, [*at, *shares, element.half_height_m or 0.0])


def _damping(element: parts.Damping, body: parts.Body, rows: TableRows) -> None:
    """Add quadratic and linear moments against rotation about the axes of a link."""
    rows.add("damping", body.name, [*element.quadratic_N_m_s2_rad2, *element.linear_N_m_s_rad])


def _foil(element: parts.Foil, body: parts.Body, rows: TableRows) -> None:
    """Add lift and drag of a fin with the polar of a flat plate."""
    gain = 0.5 * rows.density_kg_m3 * Polynomial.of(element.area_m2)
    polar = element.lift_coefficient, element.drag_coefficient_0, element.drag_coefficient_1
    row = [
        *element.at_m,
        gain,
        *polar,
        *_unit(element.chord),
        *_unit(element.normal),
        element.half_height_m or 0.0,
    ]
    rows.add("foil", body.name, row)


def _hydrostatics(element: parts.Hydrostatics, body: parts.Body, rows: TableRows) -> None:
    """Add the weight of a link at its centre of mass, and the buoyancy of the link."""
    gravity = rows.gravity_m_s2
    weight = -gravity * Polynomial.of(body.mass_kg)
    rows.add("force", body.name, [*body.com_m, 0.0, 0.0, weight, 1.0, 0.0])
    lift = gravity * rows.density_kg_m3 * Polynomial.of(element.volume_m3)
    if lift.terms:
        at = use_default(element.buoyancy_at_m, body.com_m)
        rows.add("force", body.name, [*at, 0.0, 0.0, lift, 1.0, element.half_height_m or 0.0])


def _water(element: parts.Water, body: parts.Body, rows: TableRows) -> None:
    """Add the inertia of the water inside a hull, and the weight of this water if ``weighs`` is true."""
    mass = rows.density_kg_m3 * Polynomial.of(element.volume_m3)
    about = np.array(element.gyration_m, dtype=object) ** 2 * mass
    _add_mass(rows, body.name, np.diag([mass] * 3), element.at_m, np.diag(about))
    if element.weighs:
        weight = -rows.gravity_m_s2 * mass
        rows.add("force", body.name, [*element.at_m, 0.0, 0.0, weight, 1.0, 0.0])


def _force(element: parts.Force, body: parts.Body, rows: TableRows) -> None:
    """Add a constant force at a point of a link, in the axes of the link or of the world."""
    world = float(element.frame == "world")
    rows.add("force", body.name, [*element.at_m, *element.force_N, world, 0.0])


def _load(element: parts.Load, body: parts.Body, rows: TableRows) -> None:
    """Add a force and a moment in the axes of a link that are proportional to an input."""
    world = float(element.frame == "world")
    row: Row = [*element.at_m, *element.force_N, *element.moment_N_m, world, 0.0]
    rows.add_load(body.name, element.input, row)


def _propeller(element: parts.Propeller, body: parts.Body, rows: TableRows) -> None:
    """Add a propeller whose thrust depends on its rate and on the velocity of advance."""
    rows.add_propeller(element, [*element.at_m], [*_unit(element.axis)])


def _rudder(element: parts.Rudder, body: parts.Body, rows: TableRows) -> None:
    """Add the normal force on a rudder, and the lateral force on the hull that it induces."""
    points = element.at_m, element.hull_force_at_m, element.inflow_at_m
    row = [entry for point in points for entry in use_default(point, element.at_m)]
    rows.add_rudder(element, [*row, *_unit(element.side)])


def _moving_mass(element: parts.MovingMass, body: parts.Body, rows: TableRows) -> None:
    """Add a mass that an input moves along a line of a link."""
    rows.add_mass(element, [*element.at_m])


def _derivatives(element: parts.Derivatives, body: parts.Body, rows: TableRows) -> None:
    """Add forces and moments that are products of the velocities of a point of a link."""
    rows.add_terms(element, [*element.at_m], engine.COMPONENTS, engine.VELOCITIES)


#: Functions that add the rows of an element to the input arrays, by kind of element.
ADDERS: dict[str, Callable[[Any, Any, TableRows], None]] = {
    "added-mass": _added_mass,
    "spheroid": _spheroid,
    "plate": _plate,
    "drag": _drag,
    "damping": _damping,
    "foil": _foil,
    "hydrostatics": _hydrostatics,
    "water": _water,
    "force": _force,
    "load": _load,
    "propeller": _propeller,
    "rudder": _rudder,
    "moving-mass": _moving_mass,
    "derivatives": _derivatives,
}


#: Height of the water surface if the robot file states none, m. It is high enough that the robot is always
#: under water.
NOWHERE = 1e9


class Assembly(Tree):
    """Links of a robot in 3-D, with their input arrays and checks (:class:`swimid.swimmer.tree.Tree`).

    Parameters
    ----------
    body : Multibody
    fluid : Fluid

    Attributes
    ----------
    topology : ndarray of int, shape (links, 4)
        The columns of :attr:`Tree.topology`, and a column with 1 for links without mass and added mass.
    reference : ndarray, shape (3,)
        Point of the base whose pose is logged, m.
    """

    part = "multibody"
    elements = ("drag", "damping", "foil", "force", "load", "propeller", "rudder", "term", "slider")
    engine, adders = engine, ADDERS

    def __init__(self, body: parts.Multibody, fluid: Fluid) -> None:
        super().__init__(body)
        self.reference = np.array(body.reference.at_m)
        self.constants = {"surface": use_default(body.surface_z_m, NOWHERE), **self.constants}
        rows = self.fill(fluid)
        massless = [[all(not Polynomial.of(e).terms for e in row)] for row in rows.inertia]
        self.topology = np.ascontiguousarray(np.hstack([self.topology, massless]), dtype=np.int64)

    def check(self, values: Array) -> None:
        """Raise an error for physically impossible masses or inertias.

        Raises
        ------
        InputError
        """
        rigid, apparent = self.rigid(values), self._inertia(values)
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
            check_apparent(
                whole,
                np.diag(whole),
                column=f"{where}.inertia_kg_m2",
                hint="every moment of inertia of a link with mass must be positive",
            )
            if mass > 0:
                _check_moments(rigid[i], mass, where)

    def _add_rigid(self, link: parts.Body, rows: TableRows) -> None:
        mass = Polynomial.of(link.mass_kg)
        moments = [*link.inertia_kg_m2, *[0.0] * (6 - len(link.inertia_kg_m2))]
        turning = _vector(moments)[[[0, 3, 4], [3, 1, 5], [4, 5, 2]]]
        _add_mass(rows, link.name, np.diag([mass] * 3), link.com_m, turning)

    def _add_torque(self, joint: parts.Hinge, rows: TableRows) -> None:
        assert joint.torque is not None
        moment = Polynomial.of(joint.torque.gain_N_m) * _vector(_unit(joint.axis).tolist())
        mount = Rotation.from_euler("xyz", joint.mount_deg, degrees=True)
        # the rotation about the axis does not change the axis, so that the mounting rotation is enough
        reaction = -(mount.as_matrix().astype(object) @ moment)
        for link, own in ((joint.child, moment), (joint.parent, reaction)):
            rows.add_load(link, joint.torque.input, [*[0.0] * 6, *own, 0.0, 0.0])

    def _place(self, joint: parts.Hinge | None) -> Row:
        if joint is None:
            return [0.0] * len(engine.JOINT)
        mount = Rotation.from_euler("xyz", joint.mount_deg, degrees=True)
        return hinge_row(joint.at_m, np.array(joint.axis), mount)


def _check_moments(row: Array, mass: float, where: str) -> None:
    """Raise an error if a principal moment of inertia is not positive or exceeds the sum of the others."""
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
    """Return the row of a hinge in the ``joint`` input array.

    Parameters
    ----------
    at : sequence of 3 entries, m
        Position of the hinge on the parent link.
    axis : ndarray, shape (3,)
        Direction of the hinge in the axes of the child link, of any length.
    mount : Rotation
        Rotation from the child's axes to the parent's axes at zero angle.
    """
    unit = _unit(axis)
    cross = cross_product_matrix(unit)
    zero = mount.as_matrix()
    turns = [zero, zero @ cross, zero @ cross @ cross]
    return [*at, *unit, *np.ravel(turns)]


#: Input arrays whose rows begin with a point of the robot.
POINT_TABLES = ("drag", "force", "load", "propeller", "rudder", "term", "slider", "joint")
#: Signs of roll, pitch (positive nose up) and yaw relative to rotations about x, y and z.
SIGNS = np.array([1.0, -1.0, 1.0])


class MultibodyModel(Swimmer):
    """Model of a robot with links in 3-D (:mod:`swimid.swimmer.spatial.engine`).

    Parameters
    ----------
    robot : Robot
        The robot must have a ``multibody`` part.
    max_step : float, s
        Each sampling interval is divided into equal steps no longer than this.
    """

    name = "multibody"
    offers = frozenset({"command", "tables", "flow", "output", "clock"})
    in_space = True
    coordinates, speeds = 7, 6
    engine = engine
    pose = ("x_m", "y_m", "z_m", "roll_rad", "pitch_rad", "yaw_rad")
    velocity = ("u_m_s", "v_m_s", "w_m_s", "roll_rate_rad_s", "pitch_rate_rad_s", "yaw_rate_rad_s")
    reactions = (*(f"force_{c}_N" for c in "xyz"), *(f"torque_{c}_N_m" for c in "xyz"))
    places = ("x", "y", "z", "roll", "pitch", "yaw")
    rates = ("surge", "sway", "heave", "roll_rate", "pitch_rate", "yaw_rate")
    tree: Assembly

    def _tree(self) -> Assembly:
        assert self.robot.multibody is not None
        return Assembly(self.robot.multibody, self.robot.fluid)

    @property
    def axes(self) -> tuple[str, ...]:
        """Horizontal axes along which the robot and the water may travel; none if the base is fixed."""
        if not self.free_base:
            return ()
        return ("x", "y")

    @property
    def extent(self) -> float:
        """Length of the robot, m: that in the robot file, or else the extent of its elements and hinges."""
        stated = self.robot.body.length_m
        if stated:
            return stated
        tables = self.tree.tables(self.start_coefficients)
        points = np.vstack([tables[name][:, :3] for name in POINT_TABLES])
        return float(np.linalg.norm(np.ptp(points, axis=0))) or 1.0

    def shift(self, tables: dict[str, Any], by: Array) -> None:
        """Move the centre of mass of the heaviest link, and its weight, by a vector in the axes of the link.

        The inertia about the centre of mass is unchanged.
        """
        rigid = self.tree.rigid(self.start_coefficients)
        link = int(np.argmax(rigid[:, 0]))
        mass, centre = rigid[link, 0], centre_of_mass(rigid[link])
        inertia = tables["inertia"].copy()
        for moved, place in ((-mass, centre), (mass, centre + by)):
            lever = cross_product_matrix(place)
            inertia[link, 6:] -= moved * np.concatenate([lever.ravel(), (lever @ lever)[UPPER]])
        tables["inertia"] = inertia
        self.tree.move_weight(tables, link, centre, by)

    def influences(self, hooks: Hooks) -> NDArray[np.intp]:
        """Return the indices of the parameters that affect the simulated motion."""
        if hooks.flow:
            return np.append(self._dynamic, self._at["start_yaw"])
        return self._dynamic

    def _offsets(self) -> tuple[str, ...]:
        # a simulation begins at x = y = 0 with its heading along x, so that these offsets do not affect it
        return ("start_x", "start_y", "start_yaw")

    def _velocities_of_pose(self, seen: Callable[[str, int], float | None]) -> Sequence[float | None]:
        rates = [seen(column, 1) for column in self.pose]
        if all(r is None for r in rates[:3]):
            return ()
        # if the velocity along an axis is unknown while others are known, it is taken as 0
        attitude = from_angles(*([seen(column, 0) or 0.0] for column in self.pose[3:]))[0]
        body = attitude.inv().apply([r or 0.0 for r in rates[:3]])
        # the body is nearly level, so the rates of roll, pitch and yaw approximate those about its axes
        return [*body.tolist(), *rates[3:]]

    def list_determined_starts(self, measured: Collection[str]) -> list[str]:
        """Return the names of the initial velocities, angles and rates that measured channels determine.

        A side view determines only the velocities in its plane.
        """
        blind = [
            f"initial_{name}"
            for name, place, speed in zip(self.rates, self.pose, self.velocity, strict=True)
            if place not in measured and speed not in measured
        ]
        return [name for name in super().list_determined_starts(measured) if name not in blind]

    def at_reference(self, wrench: Array) -> Array:
        """Return a wrench at the origin of a fixed base as one at the reference point, in world axes."""
        force, moment = wrench[:, :3], wrench[:, 3:]
        return np.hstack([force, moment - np.cross(self.tree.reference, force)])

    def _first_pose(self, values: Array, trial: Trial) -> Array:
        """Return the pose of the reference point at the first sample, with estimated offsets, shape (6,)."""
        pose = np.array(trial.swim.get_pose(6), dtype=float)
        return pose + values[self._offset]

    def _begin(self, start: Array, values: Array, trial: Trial, begin_s: float, hooks: Hooks) -> None:
        start[3] = 1.0
        if not self.free_base:
            return
        passives = len(self.passive)
        _, _, z, roll, pitch, yaw = self._first_pose(values, trial)
        turn = from_angles([roll], [pitch], [0.0])[0]
        place = -turn.apply(self.tree.reference)
        start[2] = z + place[2]
        start[3:7] = np.roll(turn.as_quat(), 1)
        speed = values[self._velocities]
        spin = speed[3:] * SIGNS
        start[7 + passives : 10 + passives] = speed[:3] - np.cross(spin, self.tree.reference)
        start[10 + passives : 13 + passives] = spin
        if hooks.flow:
            _, water = flows(hooks, np.array([begin_s]))
            x, y = rotate_vector(float(water[0, 0]), float(water[0, 1]), -float(yaw))
            start[7 + passives : 10 + passives] -= turn.inv().apply([x, y, 0.0])

    def _add_water_motion(self, found: dict[str, Array], hooks: Hooks, begin_s: float, time_s: Array) -> None:
        moved, speed = flows(hooks, np.append(begin_s, time_s))
        for k, name in enumerate(self.pose[:2]):
            found[name] = found[name] + moved[1:, k] - moved[0, k]
        turn = from_angles(*(np.nan_to_num(found[name]) for name in self.pose[3:]))
        water = turn.inv().apply(np.column_stack([speed[1:], np.zeros(len(time_s))]))
        for k, name in enumerate(self.velocity[:3]):
            found[name] = found[name] + water[:, k]

    def observe(self, values: Array, trial: Trial, states: Array) -> dict[str, Array]:
        """Return the channels of pose and velocity of the reference point from simulated states."""
        passives = len(self.passive)
        turn = Rotation.from_quat(_sound(states[:, [4, 5, 6, 3]]))
        place = states[:, :3] + turn.apply(self.tree.reference)
        x, y, _, _, _, yaw = self._first_pose(values, trial)
        c, s = math.cos(yaw), math.sin(yaw)
        dx, dy = place[:, 0] - place[0, 0], place[:, 1] - place[0, 1]
        spin = states[:, 10 + passives : 13 + passives]
        velocity = states[:, 7 + passives : 10 + passives] + np.cross(spin, self.tree.reference)
        broken = ~np.isfinite(states[:, 3])
        roll, pitch, heading = (np.where(broken, np.nan, a) for a in angles(turn))
        pose = (x + c * dx - s * dy, y + s * dx + c * dy, place[:, 2], roll, pitch, heading + yaw)
        return dict(zip((*self.pose, *self.velocity), (*pose, *velocity.T, *(spin * SIGNS).T), strict=True))


def _sound(quaternions: Array) -> Array:
    """Return quaternions in which the NaN rows of a simulation that broke down are the identity."""
    broken = ~np.isfinite(quaternions).all(axis=1, keepdims=True)
    return np.where(broken, [0.0, 0.0, 0.0, 1.0], quaternions)
