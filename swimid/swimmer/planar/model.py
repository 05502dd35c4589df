"""Model of a robot in a plane: checks of its robot file, interface for effects, and simulation."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from swimid.errors import InputError
from swimid.fitting.drives import TailBeat
from swimid.fitting.model import TRACEABLE, Array, Hooks, Parameter, Scales, SwimInput, Trial
from swimid.kinematics import wave
from swimid.robots import planar as parts
from swimid.robots.file import Fluid
from swimid.swimmer import drive
from swimid.swimmer.engine import PASSIVE, place_frame, tendon_torque
from swimid.swimmer.lanes import Room
from swimid.swimmer.model import SimulationRequest, Swimmer, flows, rotate_vector, trial_parameter
from swimid.swimmer.planar.engine import COLUMNS, PLANAR_ENGINE, observe_camera
from swimid.swimmer.tree import (
    SYMMETRIC,
    MovingJoint,
    Polynomial,
    PolynomialTable,
    Tree,
    check_apparent,
    list_quantities,
)

Point = tuple[float, float]
LinkFrames = tuple[Array, Array, Array]


#: Minimum and maximum radius of gyration of a link, as a multiple of its length. Other values indicate a
#: wrong unit.
GYRATION = (0.02, 5.0)
#: Maximum density of a link, kg/m3. The density is that of a block as long as the link, and as wide and high
#: as the robot is long. A higher density indicates a wrong unit (solid lead has 11340).
MAX_DENSITY = 5000.0
#: Maximum of a length in a robot file, as a multiple of the robot's length, and maximum of an area, as a
#: multiple of the square of the robot's length.
MAX_EXTENT = 3.0
#: Pattern of the keys of lengths in a robot file, and pattern of the dotted paths of quantities that must not
#: be negative.
LENGTH = re.compile(r"(?!.*_(N|N_s|kg)_m$).*_m")
LOSS = re.compile(
    r"multilink\.elements\..*\.\w*(area_m2|coefficient|linear|quadratic|volume|mass_kg_m)\w*"
    r"|multilink\.joints\..*\.passive\.(tendon\.)?(stiffness|damping|quadratic|spring|friction_N)\w*"
)
#: Maximum magnitude of any quantity in a robot file, in its unit.
MAX_QUANTITY = 1e15


class PlanarTree(Tree):
    """Links of a robot in a plane, with their input arrays and checks (:class:`swimid.swimmer.tree.Tree`).

    Parameters
    ----------
    body : Multilink
    fluid : Fluid

    """

    part = "multilink"
    engine, up = PLANAR_ENGINE, (0.0, 1.0, 0.0)

    def __init__(self, body: parts.MultilinkRobot, fluid: Fluid) -> None:
        super().__init__(body)
        self._sizes = self._list_sizes()
        self.fill(fluid)

    def _list_sizes(self) -> tuple[list[str], NDArray[np.intp], NDArray[np.bool_], PolynomialTable]:
        """Return path, dimension, sign constraint and value of each quantity in the robot file.

        The dimension is 1 for a length, 2 for an area and 0 otherwise. The sign constraint is true if the
        quantity must not be negative. The values are a :class:`PolynomialTable` of the coefficients.
        """
        named = list(list_quantities(self.body, self.part))
        paths = [path for path, _ in named]
        keys = [path.rsplit(".", 1)[-1] for path in paths]
        powers = [2 * key.endswith("area_m2") or int(bool(LENGTH.fullmatch(key))) for key in keys]
        losses = [LOSS.fullmatch(path) is not None for path in paths]
        table = PolynomialTable([[Polynomial.of(quantity)] for _, quantity in named], 1, self.names)
        return paths, np.array(powers), np.array(losses), table

    @property
    def unknowns(self) -> int:
        """Number of degrees of freedom: three of the base, and one for each passive joint."""
        return 3 + len(self.passive)

    def check(self, values: Array) -> None:
        """Raise an error for impossible masses or inertias, and for values that indicate a wrong unit.

        Raises
        ------
        InputError
        """
        rigid, apparent = self.rigid(values), self._inertia(values)
        self._check_sizes(values)
        span = sum(link.length_m for link in self.links)
        for link, own, whole in zip(self.links, rigid, apparent, strict=True):
            _check_link(link, own, span)
            check_apparent(
                whole[SYMMETRIC],
                np.diag(own[SYMMETRIC]),
                column=f"multilink.links.{link.name}",
                hint="an added mass or inertia is negative",
            )

    def _check_sizes(self, values: Array) -> None:
        """Raise an error for lengths or areas out of proportion, and for negative areas or coefficients."""
        paths, powers, one_sign, table = self._sizes
        numbers, span = table(values)[:, 0], sum(link.length_m for link in self.links)
        far = np.where(powers > 0, MAX_EXTENT * span**powers, np.inf)
        sound = (np.abs(numbers) < MAX_QUANTITY) & (np.abs(numbers) <= far) & ~(one_sign & (numbers < 0))
        for k in np.flatnonzero(~sound)[:1]:
            text, hint = f"{numbers[k]:g} is negative; it must be zero or positive", None
            if not abs(numbers[k]) < MAX_QUANTITY:
                text = f"{numbers[k]:g} is too large; it must be below {MAX_QUANTITY:g} in magnitude"
            elif abs(numbers[k]) > far[k]:
                unit, small = {1: ("m", "mm"), 2: ("m2", "cm2")}[powers[k]]
                text = f"{numbers[k]:g} {unit} is out of proportion to a robot {span:g} m long"
                hint = f"lengths are in m, areas in m2: is it in {small}?"
            raise InputError(text, column=paths[k], hint=hint)


def _centre(row: Array) -> Point:
    """Return the centre of mass (m) of a row of the ``inertia`` input array without added mass."""
    return float(row[4] / row[0]), float(-row[2] / row[0])


def _check_link(link: parts.Link, own: Array, span: float) -> None:
    """Raise an error for a mass and inertia that no rigid link can have."""
    where = f"multilink.links.{link.name}"
    mass = float(own[0])
    if mass <= 0:
        raise InputError(f"the mass is {mass:g} kg; it must be positive", column=f"{where}.mass_kg")
    if mass > MAX_DENSITY * link.length_m * span**2:
        raise InputError(
            f"the mass is {mass:g} kg at a length of {link.length_m:g} m, in a robot {span:g} m long",
            column=f"{where}.mass_kg",
            hint="masses are in kg, lengths in m: is one of them in g or mm?",
        )
    x, y = _centre(own)
    central = float(own[5] - mass * (x * x + y * y))
    if central <= 1e-9 * mass * link.length_m**2:
        hint = None
        if link.inertia_about == "front":
            least = f"{mass * (x * x + y * y):.4g} kg m2"
            hint = f"about the front end, the inertia of this link must exceed {least}"
        raise InputError(
            f"the inertia about the centre of mass is {central:.4g} kg m2; it must be positive",
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


# ---------------------------------------------------------------- links as effects use them

STIFFNESS, CUBIC, DAMPING, FRICTION = (
    PASSIVE.index(n) for n in ("stiffness", "cubic", "damping", "friction")
)
WIRE = slice(PASSIVE.index("spring"), PASSIVE.index("crank") + 1)
QUADRATIC = [COLUMNS["drag"].index(n) for n in ("quadratic_x", "quadratic_y", "quadratic_r")]
#: Angle for the stiffness of a straight joint with a tendon, rad. The stiffness is the torque at this angle,
#: divided by the angle.
SMALL_ANGLE_RAD = 1e-4


class PlanarBody:
    """Interface to the links of a planar robot for effects, at the start values of the parameters.

    The argument ``tables`` of the methods has the input arrays of the equations of motion, by name
    (:mod:`swimid.swimmer.tree`).

    Attributes
    ----------
    free : bool
        Whether the base moves; otherwise it is fixed.
    pose, velocity : tuple of str
        Channels of the reference point. The pose has two positions and the heading. The velocity has two
        components along the body's axes and the rate of the heading.
    words : tuple of str
        Descriptions of the channels of pose and velocity.
    lengths_m : tuple of float
        Length of each link; the base is the first.
    reference_m : (float, float)
        Reference point in the axes of the base, m.
    density_kg_m3, step_s : float
        Density of the water, and maximum integration step.
    driven, passive : sequence of Axis
    actuators : sequence of Actuated
    masses_kg : list of float
        Mass of each link, without added mass.
    """

    def __init__(self, model: MultilinkModel) -> None:
        self._model = model
        self.free = model.free_base
        self.pose, self.velocity = model.pose, model.velocity
        self.words = tuple(word.replace("_", " ") for word in (*model.places, *model.rates))
        self.lengths_m = tuple(link.length_m for link in model.tree.links)
        self.reference_m = model.reference_m
        self.density_kg_m3 = model.robot.fluid.density_kg_m3
        self.step_s = model.max_step
        self.driven, self.passive, self.actuators = model.driven, model.passive, model.actuators
        rigid = model.tree.rigid(model.start_coefficients)
        self.masses_kg = [float(row[0]) for row in rigid]
        self._centres = [_centre(row) for row in rigid]

    @property
    def vertical(self) -> bool:
        """Whether the plane of motion is vertical."""
        return "z_m" in self.pose

    @property
    def last(self) -> int:
        """Index of the last link of the robot."""
        return len(self.lengths_m) - 1

    @property
    def hull(self) -> int:
        """Index of the heaviest link, which counts as the hull."""
        return int(np.argmax(self.masses_kg))

    def centre(self, link: int) -> Point:
        """Return the centre of mass of a link in the axes of the link, m."""
        return self._centres[link]

    def tables(self) -> dict[str, Any]:
        """Return the input arrays at the start values of the parameters."""
        return self._model.tree.tables(self._model.start_coefficients)

    # -------------------------------------------------------- positions of the links

    def frames(self, values: Array, columns: Mapping[str, Array]) -> LinkFrames:
        """Return position (x, y, m) of the front end and heading (rad) of each link, shape (links, n) each.

        Parameters
        ----------
        values : ndarray
            Parameters of the model.
        columns : mapping of channel to ndarray, shape (n,)
            Pose of a free base, and angles of all joints.
        """
        tree, n = self._model.tree, len(next(iter(columns.values())))
        tables = tree.tables(values[: len(tree.names)])
        topology, joint = tables["topology"], tables["joint"]
        x, y, heading = np.zeros((3, len(tree.links), n))
        if self.free:
            heading[0] = columns[self.pose[2]]
            a, b = self.reference_m
            x[0] = columns[self.pose[0]] - a * np.cos(heading[0]) + b * np.sin(heading[0])
            y[0] = columns[self.pose[1]] - a * np.sin(heading[0]) - b * np.cos(heading[0])
        else:
            heading[0] = np.radians(self._model.links.heading_deg)
        angles: dict[int, Array] = {a.link: columns[a.column] for a in (*tree.driven, *tree.passive)}
        for i in range(1, len(tree.links)):
            parent = int(topology[i, 0])
            c, s = np.cos(heading[parent]), np.sin(heading[parent])
            x[i] = x[parent] + c * joint[i, 0] - s * joint[i, 1]
            y[i] = y[parent] + s * joint[i, 0] + c * joint[i, 1]
            mount = np.arctan2(joint[i, 3], joint[i, 2])
            heading[i] = heading[parent] + mount + angles.get(i, np.zeros(n))
        return x, y, heading

    def rear_ends(self, frames: LinkFrames) -> tuple[Array, Array]:
        """Return the position (x, y) of the rear end of each link, m, shape (links, n) each."""
        x, y, heading = frames
        length = np.array(self.lengths_m)[:, None]
        return x - length * np.cos(heading), y - length * np.sin(heading)

    @cached_property
    def spine(self) -> list[int]:
        """Indices of the links from the base to the rear."""
        topology = self._model.tree.topology
        moving = np.any(topology[:, 1:] >= 0, axis=1)
        return wave.spine(topology[:, 0].tolist(), moving.tolist())

    @cached_property
    def joints(self) -> dict[int, MovingJoint]:
        """Moving joint of each link with its parent, by the index of the link."""
        return {axis.link: axis for axis in (*self.driven, *self.passive)}

    @property
    def stations(self) -> list[str]:
        """Names of the stations of :meth:`midline`: both ends of the robot, and the joints between them."""
        names = ["front end"]
        for link in self.spine[1:]:
            name = f"front of {self._model.tree.links[link].name}"
            if link in self.joints:
                name = self.joints[link].name
            names.append(name)
        return [*names, "rear end"]

    def midline(self, values: Array, columns: Mapping[str, Array]) -> tuple[NDArray[np.complex128], Array]:
        """Return the stations on the midline of the robot, and the heading of the base.

        Parameters
        ----------
        values, columns
            As for :meth:`frames`.

        Returns
        -------
        stations : ndarray of complex, shape (n, k)
            Front end of each link of :attr:`spine`, and the rear end of the last link, x + iy, m.
        heading : ndarray, shape (n,)
            rad.
        """
        frames = self.frames(values, columns)
        fronts, rears = ((x + 1j * y).T for x, y in (frames[:2], self.rear_ends(frames)))
        return wave.stations_of(self.spine, fronts, rears), frames[2][0]

    def straight(self, values: Array) -> tuple[Array, Array]:
        """Return the distances of the front and rear ends of the links from the robot's front end, m.

        All joints are straight.
        """
        frames = self.frames(values, self.at_rest())
        x0, y0 = frames[0][0], frames[1][0]
        front, rear = (np.hypot(x - x0, y - y0)[:, 0] for x, y in (frames[:2], self.rear_ends(frames)))
        return front, rear

    def at_rest(self) -> dict[str, Array]:
        """Return channels for :meth:`frames`, shape (1,) each: the joints are straight, the pose is zero."""
        columns = {axis.column: np.zeros(1) for axis in self.joints.values()}
        if self.free:
            columns |= {name: np.zeros(1) for name in self.pose}
        return columns or {"": np.zeros(1)}

    def length(self, values: Array) -> float:
        """Return the length of the robot, m.

        The length is that in the robot file, or else the distance from the front end to the farthest rear
        end.
        """
        return self._model.robot.body.length_m or float(self.straight(values)[1].max())

    # -------------------------------------------------------- properties that are computed from input arrays

    def axial_mass(self, tables: dict[str, Any]) -> float:
        """Return the sum of the masses of all links along their own axes, with added mass, kg."""
        return float(tables["inertia"][:, 0].sum())

    def axial_drag(self, tables: dict[str, Any]) -> float:
        """Return the sum of the quadratic drag of all links along their own axes, N s2/m2."""
        return float(tables["drag"][:, 2].sum() + tables["foil"][:, 2] @ tables["foil"][:, 4])

    def fin(self, tables: dict[str, Any]) -> tuple[float, float, Point]:
        """Return the coefficients of the normal force on the last link, and the point at which it acts.

        The coefficients multiply ``|w| w`` and ``|u| w``, in N s2/m2, with the velocity u along and w across
        the link. The point is in the axes of the link, m.
        """
        drag = tables["drag"][tables["drag_link"] == self.last]
        foil = tables["foil"][tables["foil_link"] == self.last]
        quadratic = np.concatenate([drag[:, 3], 2.0 * foil[:, 2] * foil[:, 5]])
        lift = np.concatenate([np.zeros(len(drag)), 2.0 * foil[:, 2] * foil[:, 3]])
        weight = quadratic + lift
        if weight.sum() <= 0:
            return 0.0, 0.0, (0.0, 0.0)
        place = weight @ np.concatenate([drag[:, :2], foil[:, :2]]) / weight.sum()
        return float(quadratic.sum()), float(lift.sum()), (float(place[0]), float(place[1]))

    def stiffness(self, tables: dict[str, Any], joint: int) -> float:
        """Return the stiffness of a passive joint when it is straight, with its wire and spring, N m/rad."""
        row = tables["passive"][joint]
        wire = row[WIRE]
        if wire[0] == 0.0:
            return float(row[STIFFNESS])
        return float(row[STIFFNESS] - tendon_torque(SMALL_ANGLE_RAD, *wire) / SMALL_ANGLE_RAD)

    def damping(self, tables: dict[str, Any], joint: int) -> float:
        """Return the damping of a passive joint: torque divided by rate, N m s/rad."""
        return float(tables["passive"][joint, DAMPING])

    def friction(self, tables: dict[str, Any], joint: int) -> float:
        """Return the dry friction of a passive joint, N m."""
        return float(tables["passive"][joint, FRICTION])

    def joint_inertia(self, tables: dict[str, Any], joint: int) -> float:
        """Return the inertia of a passive joint's child link about the joint, with added mass, kg m2."""
        return float(tables["inertia"][self.passive[joint].link, 5])

    def compute_actuator_load(self, tables: dict[str, Any], actuator: int) -> tuple[float, float]:
        """Return inertia and quadratic drag, about an actuator, of all links that this actuator moves.

        All joints are straight, and the base is at rest. The inertia is in kg m2 and includes added mass. The
        drag is that in still water, in N m s2/rad2.
        """
        topology = tables["topology"]
        start = self._model.start_coefficients
        x, y, heading = (part[:, 0] for part in self.frames(start, self.at_rest()))
        # compute velocities and turn rates of the links at an actuator rate of 1 rad/s
        vx, vy, turn = np.zeros((3, len(x)))
        slopes = self._model.joints.slopes(start)
        for axis, slope, own in zip(self.driven, slopes, self._model.tree.actuator_of, strict=True):
            if own == actuator:
                turn[axis.link] = slope
        inertia, drag = 0.0, 0.0
        for link in range(1, len(x)):
            parent = topology[link, 0]
            vx[link] = vx[parent] - turn[parent] * (y[link] - y[parent])
            vy[link] = vy[parent] + turn[parent] * (x[link] - x[parent])
            turn[link] += turn[parent]
            c, s, r = np.cos(heading[link]), np.sin(heading[link]), turn[link]
            along, across = c * vx[link] + s * vy[link], c * vy[link] - s * vx[link]
            uu, uv, ur, vv, vr, rr = tables["inertia"][link]
            inertia += uu * along**2 + vv * across**2 + rr * r**2
            inertia += 2.0 * (uv * along * across + ur * along * r + vr * across * r)
            rows = tables["drag"][tables["drag_link"] == link]
            ahead, aside = np.abs(along - r * rows[:, 1]), np.abs(across + r * rows[:, 0])
            drag += rows[:, 2] @ ahead**3 + rows[:, 3] @ aside**3 + rows[:, 6].sum() * abs(r) ** 3
            fin = tables["foil"][tables["foil_link"] == link]
            flat = fin[:, 2] * (fin[:, 4] + 2.0 * fin[:, 5])
            drag += flat @ np.hypot(along - r * fin[:, 1], across + r * fin[:, 0]) ** 3
        return float(inertia), float(drag)

    @cached_property
    def loads(self) -> list[tuple[float, float]]:
        """Inertia and quadratic drag of the links of each actuator (:meth:`compute_actuator_load`)."""
        tables = self.tables()
        return [self.compute_actuator_load(tables, k) for k in range(len(self.actuators))]

    def normal_drag(self, tables: dict[str, Any]) -> tuple[NDArray[np.int64], Array]:
        """Return the points at which drag across links acts.

        Returns
        -------
        links : ndarray of int, shape (points,)
        points : ndarray, shape (points, 3)
            Position on the link (x, y, m), and drag force per ``|w| w`` (N s2/m2), with the velocity w across
            the link.
        """
        there = tables["drag"][:, 3] > 0
        return tables["drag_link"][there], tables["drag"][there][:, [0, 1, 3]]

    # -------------------------------------------------------- changes of input arrays

    def weigh(self, tables: dict[str, Any], link: int, at: Point, along: float, across: float) -> None:
        """Add a mass at a point of a link, in kg: one value for motion along the link, and one for across."""
        x, y = at
        rows = tables["inertia"].copy()
        rows[link] += (along, 0.0, -along * y, across, across * x, along * y * y + across * x * x)
        tables["inertia"] = rows

    def drag_more(self, tables: dict[str, Any], link: int, at: Point, linear: float) -> None:
        """Add a drag that is proportional to the velocity of a point of a link, N s/m."""
        tables["drag_link"] = np.append(tables["drag_link"], link)
        tables["drag"] = np.vstack([tables["drag"], [*at, 0.0, 0.0, linear, linear, 0.0, 0.0]])

    def room(self) -> dict[str, list[int]]:
        """Return the links of the rows that effects may add to an input array, by the name of the array.

        The method ``drag_more`` adds rows to ``drag``, ``lift`` to ``foil``, and ``shed`` to ``wake``.
        """
        links, _ = self.normal_drag(self.tables())
        return {"drag": [self.hull], "foil": [int(link) for link in links], "wake": [self.last]}

    def drag_times(self, tables: dict[str, Any], factor: float) -> None:
        """Multiply every quadratic drag coefficient of the links by a factor."""
        tables["drag"][:, QUADRATIC] *= factor

    def lift(self, tables: dict[str, Any], links: NDArray[np.int64], points: Array) -> None:
        """Add forces ``-k V w`` across links, at points with speed V and velocity w across the link (m/s).

        The force is that of a fin with the lift coefficient ``C_L sin(2 a)`` and the drag coefficient ``C_L
        (1 - cos(2 a))`` at the angle of attack a. The resultant has no component along the chord. Its
        coefficient across the chord is ``2 C_L sin(a)``.
        """
        one = np.ones(len(points))
        half = 0.5 * one
        rows = np.column_stack([points, half, 0.0 * one, half, one, 0.0 * one])
        tables["foil_link"] = np.append(tables["foil_link"], links)
        tables["foil"] = np.vstack([tables["foil"], rows])

    def shed(self, tables: dict[str, Any], mass_kg_m: float) -> None:
        """Add a trailing edge at the rear end of the last link, with an added mass per length (kg/m)."""
        tables["wake_link"] = np.append(tables["wake_link"], self.last)
        tables["wake"] = np.vstack([tables["wake"], [-self.lengths_m[-1], 0.0, 0.5 * mass_kg_m]])

    def stiffen(
        self,
        tables: dict[str, Any],
        joint: int,
        *,
        stiffness: float = 0.0,
        cubic: float = 0.0,
        damping: float = 0.0,
        friction: float = 0.0,
    ) -> None:
        """Add stiffness, damping or friction to the law of a passive joint.

        The arguments are stiffness (N m/rad), cubic stiffness (N m/rad3), damping (N m s/rad) and dry
        friction (N m).
        """
        passive = tables["passive"].copy()
        passive[joint, [STIFFNESS, CUBIC, DAMPING, FRICTION]] += stiffness, cubic, damping, friction
        tables["passive"] = passive


class SwimmerScales(Scales):
    """Typical scales of mass and force in the trials of a planar robot."""

    model: MultilinkModel

    @property
    def inertia(self) -> float:
        """Sum of the masses of all links along their own axes, with added mass, kg."""
        body = self.model.body
        return body.axial_mass(body.tables())

    @property
    def force(self) -> float:
        """Drag at the typical speed, plus the force for accelerating to this speed in one trial, N."""
        return self.model.typical_force(self)


#: For each plane of motion: its second axis, symbol and name of the velocity along this axis, and name of the
#: rotation.
PLANE_NAMES = {"horizontal": ("y", "v", "sway", "yaw"), "vertical": ("z", "w", "heave", "pitch")}


class MultilinkModel(Swimmer):
    """Model of a robot with links in a plane (:mod:`swimid.swimmer.planar.engine`).

    Parameters
    ----------
    robot : Robot
        The robot must have a ``multilink`` part.
    max_step : float, s
        Maximum integration step. Each sampling interval is divided into equal steps that are not longer.
    """

    name = "multilink"
    offers = frozenset({"command", "tables", "force", "flow", "output", "clock"})
    camera = (
        trial_parameter(
            "camera_rotation", "rad", 0.02, "axes of the measured position against those of the heading"
        ),
    )
    pose: tuple[str, str, str]
    velocity: tuple[str, str, str]
    tree: PlanarTree
    #: Cached interface to the links, with the parameters from which it was computed.
    _body: tuple[tuple[Parameter, ...], PlanarBody] | None = None

    def _tree(self) -> PlanarTree:
        second, v, sideways, turn = PLANE_NAMES[self.links.plane]
        self.pose = ("x_m", f"{second}_m", f"{turn}_rad")
        self.velocity = ("u_m_s", f"{v}_m_s", f"{turn}_rate_rad_s")
        self.places, self.rates = ("x", second, turn), ("surge", sideways, f"{turn}_rate")
        self.reactions = ("force_x_N", f"force_{second}_N", f"torque_{turn}_N_m")
        return PlanarTree(self.links, self.robot.fluid)

    def _offsets(self) -> tuple[str, ...]:
        return self.starts

    # -------------------------------------------------------- links and drive

    @property
    def links(self) -> parts.MultilinkRobot:
        """Part of the robot file with links, joints and elements."""
        assert self.robot.multilink is not None
        return self.robot.multilink

    @cached_property
    def reference_m(self) -> tuple[float, float]:
        """Position of the reference point in the axes of the base, m."""
        return -self.links.reference.station_m, self.links.reference.offset_m

    def start_course(self, trial: Trial) -> tuple[float, float, float]:
        """Return the position in the plane (m) and the heading (rad) at the first sample of a trial."""
        x, y, heading = trial.swim.get_pose()
        return float(x), float(y), float(heading)

    @property
    def body(self) -> PlanarBody:
        """Interface to the links for effects, at the start values of the parameters."""
        known = self._body
        if known is None or known[0] is not self.parameters:
            known = self._body = self.parameters, PlanarBody(self)
        return known[1]

    @property
    def axes(self) -> tuple[str, ...]:
        """Axes of the plane of motion; none if the base is fixed."""
        if not self.free_base:
            return ()
        return tuple(name.removesuffix("_m") for name in self.pose[:2])

    def shift(self, tables: dict[str, Any], by: Array) -> None:
        """Move centre of mass and weight of the heaviest link by a vector (m) in the axes of the link."""
        body = self.body
        link, mass, centre = body.hull, body.masses_kg[body.hull], body.centre(body.hull)
        body.weigh(tables, link, centre, -mass, -mass)
        body.weigh(tables, link, (centre[0] + by[0], centre[1] + by[1]), mass, mass)
        self.tree.move_weight(tables, link, centre, by)

    def scales(self, trials: Sequence[Trial]) -> SwimmerScales:
        """Return the typical scales of quantities in these trials, such as mass and force."""
        return SwimmerScales(self, trials)

    def origin(self, trial: Trial) -> dict[str, float]:
        """Return the pose of the robot at the first sample of a trial, by channel."""
        return dict(zip(self.pose, self.start_course(trial), strict=True))

    def _velocities_of_pose(self, seen: Callable[[str, int], float | None]) -> Sequence[float | None]:
        heading = seen(self.pose[2], 0)
        along, across, turn = (seen(column, 1) for column in self.pose)
        if heading is None or along is None or across is None:
            return ()
        return *rotate_vector(along, across, -heading).tolist(), turn

    # -------------------------------------------------------- simulation

    def influences(self, hooks: Hooks) -> NDArray[np.intp]:
        """Return the indices of the parameters that affect the simulated motion."""
        if self._heading_matters() or hooks.force or hooks.flow:
            starts = [self._at[n] for n in self.starts[2:] if n in self._at]
            return np.concatenate([self._dynamic, np.array(starts, dtype=np.intp)])
        return self._dynamic

    def _heading_matters(self) -> bool:
        """Return whether the heading affects the motion.

        The heading matters if forces with a fixed direction in the world, such as weight, act on a free base.
        """
        return self.tree.world_forces and self.free_base

    @cached_property
    def _memory(self) -> list[int]:
        return [2] * self._heading_matters() + super()._memory

    def _heading(self, values: Array, trial: Trial) -> float:
        """Return the heading at the first sample of a trial, with its estimated offset, rad."""
        return float(trial.swim.get_pose()[2]) + self.value(values, self.starts[2])

    def at_reference(self, wrench: Array) -> Array:
        """Convert a wrench at the origin of a fixed base to one at the reference point, in world axes."""
        fx, fy, moment = wrench.T
        a, b = self.reference_m
        along, across = rotate_vector(fx, fy, math.radians(self.links.heading_deg))
        return np.column_stack([along, across, moment - a * fy + b * fx])

    def _mounts(self) -> list[float]:
        return [math.radians(a.joint.mount_deg) for a in self.driven]

    def _begin(self, start: Array, values: Array, trial: Trial, begin_s: float, hooks: Hooks) -> None:
        n = self.tree.unknowns
        if not self.free_base:
            start[2] = math.radians(self.links.heading_deg)
            return
        u, v, r = values[self._velocities]
        x, y = self.reference_m
        start[n : n + 3] = u + r * y, v - r * x, r
        if hooks.flow:
            _, water = flows(hooks, np.array([begin_s]))
            heading = self._heading(values, trial)
            start[n : n + 2] -= rotate_vector(float(water[0, 0]), float(water[0, 1]), -heading)
        if self._heading_matters():
            start[2] = self._heading(values, trial)

    def frame(self, run: SimulationRequest) -> Array:
        """Return the coordinate frame of the simulation in the world, for external forces."""
        x, y, _ = run.trial.swim.get_pose()
        heading = 0.0 if self._heading_matters() else self._heading(run.values, run.trial)
        return place_frame((x, y, heading), self.reference_m)

    def _room(self) -> Room:
        body = self.body
        links = {"base": 0, "hull": body.hull, "last": body.last}
        # include the points at which weights act, because an effect that moves a mass moves its weight, too
        filled = {"inertia": body.hull, "force": np.s_[:, :2]}
        return Room(body.room(), filled, [(known, links[known.on]) for _, known in sorted(TRACEABLE.items())])

    def _add_water_motion(self, found: dict[str, Array], hooks: Hooks, begin_s: float, time_s: Array) -> None:
        moved, speed = flows(hooks, np.append(begin_s, time_s))
        x, y, heading = self.pose
        found[x] = found[x] + moved[1:, 0] - moved[0, 0]
        found[y] = found[y] + moved[1:, 1] - moved[0, 1]
        u, v = rotate_vector(speed[1:, 0], speed[1:, 1], -found[heading])
        along, across, _ = self.velocity
        found[along], found[across] = found[along] + u, found[across] + v

    def observe(self, values: Array, trial: Trial, states: Array) -> dict[str, Array]:
        """Return the channels of pose and velocity of the reference point, in the axes of the camera."""
        pose = trial.swim.get_pose()
        x, y, turned = values[self._offset].tolist()
        # a simulation starts at the origin, and along x unless forces with a fixed direction in the world act
        heading = 0.0 if self._heading_matters() else float(pose[2]) + turned
        spin = heading + self.value(values, "camera_rotation")
        origin = (float(pose[0]) + x, float(pose[1]) + y)
        seen = observe_camera(states, self.tree.unknowns, self.reference_m, origin, heading, spin)
        return dict(zip((*self.pose, *self.velocity), seen, strict=True))


def warm_up() -> None:
    """Compile the functions of the scalar engine and of the driven joints."""
    from swimid.robots import file as robot_format

    model = MultilinkModel(robot_format.read("tfish"))
    time = np.linspace(0.0, 0.1, 6)
    beat = TailBeat("a-cpg", 1.0, 0.3)
    model.simulate(
        np.array([p.start for p in model.parameters]), Trial("warm", "fit", time, {}, swim=SwimInput(beat))
    )
    drive.simulate_servo(np.zeros(5), 0.1, 1.0, 1.0)
    drive.fit_spline(np.arange(6.0), np.zeros(6))
