"""Model of a robot in 3-D: checks of its robot file, and simulation."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from swimid.errors import InputError
from swimid.fitting.model import TRACEABLE, Array, Hooks, Trial
from swimid.kinematics.attitude import angles, from_angles
from swimid.robots import spatial as parts
from swimid.robots.file import Fluid
from swimid.swimmer.assembly import UPPER, lever_matrix
from swimid.swimmer.engine import place_frame
from swimid.swimmer.lanes import Room
from swimid.swimmer.model import SimulationRequest, Swimmer, flows, rotate_vector
from swimid.swimmer.spatial.engine import SPATIAL_ENGINE
from swimid.swimmer.tree import (
    SYMMETRIC,
    Polynomial,
    Tree,
    check_apparent,
    use_default,
)


def centre_of_mass(row: Array) -> Array:
    """Return the centre of mass of a row of the ``inertia`` input array without added mass, m, shape (3,)."""
    whole = full(row)
    return np.array([whole[5, 1], whole[3, 2], whole[4, 0]]) / whole[0, 0]


def full(row: Array) -> Array:
    """Return the inertia matrix that a row of the ``inertia`` input array represents, shape (6, 6)."""
    b = row[6:15].reshape(3, 3)
    return np.block([[row[:6][SYMMETRIC], b], [b.T, row[15:][SYMMETRIC]]])


#: Height of the water surface if the robot file states none, m. It is high enough that the robot is always
#: under water.
NOWHERE = 1e9


class SpatialTree(Tree):
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
    engine, up = SPATIAL_ENGINE, (0.0, 0.0, 1.0)

    def __init__(self, body: parts.MultibodyRobot, fluid: Fluid) -> None:
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
                    f"the mass is {mass:g} kg; it must not be negative", column=f"{where}.mass_kg"
                )
            whole = full(apparent[i])
            if not whole.any():
                if not (self.topology[:, 0] == i).any():
                    text = "the link has no mass and carries no other link: give it a mass, or remove it"
                    raise InputError(text, column=f"{where}.mass_kg")
                continue
            check_apparent(
                whole,
                np.diag(whole),
                column=f"{where}.inertia_kg_m2",
                hint="every moment of inertia of a link with mass must be positive",
            )
            if mass > 0:
                _check_moments(rigid[i], mass, where)


def _check_moments(row: Array, mass: float, where: str) -> None:
    """Raise an error if a principal moment of inertia is not positive or exceeds the sum of the others."""
    whole = full(row)
    lever = -whole[:3, 3:] / mass
    central = whole[3:, 3:] - mass * (lever.T @ lever)
    moments = np.sort(np.linalg.eigvalsh(central))
    if moments[0] <= 0 or moments[2] > (1.0 + 1e-9) * (moments[0] + moments[1]):
        raise InputError(
            f"no rigid body has the principal moments {', '.join(f'{m:.4g}' for m in moments)} kg m2",
            column=f"{where}.inertia_kg_m2",
            hint="moments about the centre of mass are positive, and at most the sum of the other two",
        )


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
        Maximum integration step. Each sampling interval is divided into equal steps that are not longer.
    """

    name = "multibody"
    offers = frozenset({"command", "tables", "force", "flow", "output", "clock"})
    in_space = True
    pose = ("x_m", "y_m", "z_m", "roll_rad", "pitch_rad", "yaw_rad")
    velocity = ("u_m_s", "v_m_s", "w_m_s", "roll_rate_rad_s", "pitch_rate_rad_s", "yaw_rate_rad_s")
    reactions = (*(f"force_{c}_N" for c in "xyz"), *(f"torque_{c}_N_m" for c in "xyz"))
    places = ("x", "y", "z", "roll", "pitch", "yaw")
    rates = ("surge", "sway", "heave", "roll_rate", "pitch_rate", "yaw_rate")
    tree: SpatialTree

    def _tree(self) -> SpatialTree:
        assert self.robot.multibody is not None
        return SpatialTree(self.robot.multibody, self.robot.fluid)

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
            lever = lever_matrix(place)
            inertia[link, 6:] -= moved * np.concatenate([lever.ravel(), (lever @ lever)[UPPER]])
        tables["inertia"] = inertia
        self.tree.move_weight(tables, link, centre, by)

    def influences(self, hooks: Hooks) -> NDArray[np.intp]:
        """Return the indices of the parameters that affect the simulated motion."""
        if (hooks.flow or hooks.force) and self.free_base:
            return np.append(self._dynamic, self._at["start_yaw"])
        return self._dynamic

    @property
    def course(self) -> tuple[str, ...]:
        """Channels of the position and of the heading."""
        return (*self.pose[:3], "yaw_rad")

    @property
    def reference_m(self) -> Array:
        """Position of the reference point in the axes of the base, m."""
        return self.tree.reference

    def start_course(self, trial: Trial) -> tuple[float, float, float]:
        """Return the horizontal position (m) and the heading (rad) at the first sample of a trial."""
        x, y, _, _, _, heading = trial.swim.get_pose(6)
        return float(x), float(y), float(heading)

    def _attitude_matters(self) -> bool:
        """Return whether roll and pitch affect the motion of a free base, by weight or a water surface."""
        return self.free_base and (self.tree.world_forces or self._surface_matters())

    def _surface_matters(self) -> bool:
        """Return whether the height affects the motion of a free base."""
        return self.free_base and getattr(self.tree.body, "surface_z_m", None) is not None

    def cycle_states(self, states: Array) -> Array:
        """Return those quantities of states on which the motion over a period of the drive depends.

        The quantities include roll and pitch if weight or buoyancy acts, and the height above the base if the
        robot may surface.
        """
        parts = [states[:, self._memory]]
        if self._attitude_matters():
            parts[:0] = angles(Rotation.from_quat(_sound(states[:, [4, 5, 6, 3]])))[:2]
        if self._surface_matters():
            parts.insert(0, states[:, 2])
        return np.column_stack(parts)

    def with_cycle_state(self, start: Array, quantities: Array) -> Array:
        """Return a state vector in which the quantities of :meth:`cycle_states` have the given values.

        Without a water surface, the reference point keeps its height.
        """
        state = super().with_cycle_state(start, quantities)
        first = int(self._surface_matters())
        if self._attitude_matters() and np.isfinite(quantities).all():
            before = Rotation.from_quat(start[[4, 5, 6, 3]])
            roll, pitch = quantities[first : first + 2]
            turn = from_angles([roll], [pitch], [0.0])[0]
            state[3:7] = np.roll(turn.as_quat(), 1)
            state[2] += (before.apply(self.tree.reference) - turn.apply(self.tree.reference))[2]
        if first:
            state[2] = quantities[0]
        return state

    def frame(self, run: SimulationRequest) -> Array:
        """Return the coordinate frame of the simulation in the world, for external forces."""
        x, y, _ = self.start_course(run.trial)
        *_, roll, pitch, yaw = self._first_pose(run.values, run.trial) if self.free_base else [0.0] * 6
        begin = from_angles([roll], [pitch], [0.0])[0].apply(self.tree.reference)
        offset = rotate_vector(begin[0], begin[1], yaw)
        return place_frame((x - offset[0], y - offset[1], yaw), self.tree.reference)

    def _room(self) -> Room:
        hull = int(np.argmax(self.tree.rigid(self.start_coefficients)[:, 0]))
        links = {"base": 0, "hull": hull, "last": len(self.tree.links) - 1}
        # include the points at which weights act, because an effect that moves a mass moves its weight, too
        filled = {"inertia": hull, "force": np.s_[:, :3]}
        return Room({}, filled, [(known, links[known.on]) for _, known in sorted(TRACEABLE.items())])

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
        """Convert a wrench at the origin of a fixed base to one at the reference point, in world axes."""
        force, moment = wrench[:, :3], wrench[:, 3:]
        return np.hstack([force, moment - np.cross(self.tree.reference, force)])

    def _first_pose(self, values: Array, trial: Trial) -> Array:
        """Return the logged pose at the first sample plus the estimated offsets of the trial, shape (6,)."""
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
    """Return quaternions in which the NaN rows of a simulation that diverged are the identity."""
    broken = ~np.isfinite(quaternions).all(axis=1, keepdims=True)
    return np.where(broken, [0.0, 0.0, 0.0, 1.0], quaternions)
