"""Model of a robot with links, in a plane or in 3-D: it computes channels from parameters and trials."""

from __future__ import annotations

import copy
import math
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Collection, Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline

from swimid.fitting.model import (
    NONE,
    Array,
    Channel,
    Hooks,
    Model,
    Parameter,
    Request,
    Scales,
    Trial,
    unless_broken,
)
from swimid.notices import Progress, silent
from swimid.results.numbers import split_unit
from swimid.robots.file import Robot
from swimid.robots.quantities import Polynomial
from swimid.swimmer.drive import DrivenJoints, DrivenMotion, Grid, TrialCache, joint_motion
from swimid.swimmer.engine import interpolate_states, pack_forces
from swimid.swimmer.lanes import LANES, Kernels, Room
from swimid.swimmer.options import STEP_S
from swimid.swimmer.steady import SteadySpeed, SteadySwimming
from swimid.swimmer.tree import MovingJoint, Tree, coefficients, law_of

if TYPE_CHECKING:
    from swimid.fitting.model import SwimInput

#: Maximum number of cached trajectories per trial. A parameter that only affects the measurement, such as the
#: clock offset, needs no new simulation.
MAX_TRAJECTORIES = 2
#: Maximum number of requested simulations in memory: several batches of the compiled kernel.
MAX_REQUESTS = 8 * LANES


#: Placeholder for the joint motion of a simulation whose trajectory is cached.
NO_DRIVEN_MOTION = DrivenMotion(np.empty((0, 0, 5)), 0)


class Trajectory(NamedTuple):
    """Simulated trajectory at the integration steps.

    Attributes
    ----------
    grid : Grid
    states, rates : ndarray, shape (steps + 1, k)
        State vectors, and their time derivatives.
    drive : DrivenMotion
    """

    grid: Grid
    states: Array
    rates: Array
    drive: DrivenMotion


class SimulationRequest(NamedTuple):
    """Request for a simulation of a trial. It has a cached trajectory, or else the inputs of the integration.

    Attributes
    ----------
    values : ndarray
        Parameters of the model. They include the coefficients that the entry of the trial sets.
    trial : Trial
    hooks : Hooks
    key : hashable
        Cache key. Simulations of a trial with equal keys have equal trajectories.
    grid : Grid
    kept : Trajectory or None
        Cached trajectory; None if the simulation must be computed.
    start : ndarray
        Initial state vector.
    drive : DrivenMotion
    tables : mapping
        Input arrays of the equations of motion, by name.
    """

    values: Array
    trial: Trial
    hooks: Hooks
    key: Hashable
    grid: Grid
    kept: Trajectory | None
    start: Array = np.empty(0)
    drive: DrivenMotion = NO_DRIVEN_MOTION
    tables: Mapping[str, Any] = MappingProxyType({})


@dataclass(frozen=True)
class Energetics:
    """Torques and powers of the driven joints in a simulation, at its integration steps.

    Attributes
    ----------
    time_s : ndarray, shape (m,)
        Times with an even step.
    torque_N_m, rate_rad_s : ndarray, shape (m, driven joints)
        Torque of each driven joint on its child link, and rate of the joint.
    actuator_of : sequence of int
        Index of the actuator of each driven joint.
    """

    time_s: Array
    torque_N_m: Array
    rate_rad_s: Array
    actuator_of: Sequence[int]

    @property
    def power_W(self) -> Array:
        """Mechanical power of each actuator, which is that of its joints, shape (m, actuators)."""
        found = np.zeros((len(self.time_s), max(self.actuator_of, default=-1) + 1))
        for joint, actuator in enumerate(self.actuator_of):
            found[:, actuator] += self.torque_N_m[:, joint] * self.rate_rad_s[:, joint]
        return found

    def mean(self, power_W: Array) -> float:
        """Return the mean of a power over the simulated time by the trapezoidal rule, W."""
        return float(np.trapezoid(power_W, self.time_s) / (self.time_s[-1] - self.time_s[0]))

    def mean_power_W(self) -> float:
        """Return the mean mechanical power of all driven joints together, W. Negative power is subtracted."""
        return self.mean(self.power_W.sum(axis=1))

    def mean_positive_power_W(self) -> float:
        """Return the mean mechanical power of all actuators without energy recovery, W.

        Negative power of an actuator counts as zero.
        """
        return self.mean(np.maximum(self.power_W, 0.0).sum(axis=1))


class Swimmer(Model, ABC):
    """Model of a robot with links.

    Trajectories are cached. A trajectory stays valid while only parameters of the measurement change, such as
    the clock offset. The drive and the initial pose of a trial are in :attr:`Trial.swim`.

    Parameters
    ----------
    robot : Robot
    max_step : float, s
        Maximum integration step. Each sampling interval is divided into equal steps no longer than this.
    """

    #: Channels of the pose and of the velocity of the reference point.
    pose: tuple[str, ...]
    velocity: tuple[str, ...]
    #: Channels of force and torque on the holder of a fixed base. The torque is about the reference point.
    reactions: tuple[str, ...]
    #: Words for the pose coordinates and the velocities in the names of the parameters of the initial state,
    #: such as x in ``start_x`` and surge in ``initial_surge``.
    places: tuple[str, ...]
    rates: tuple[str, ...]
    #: Camera parameters of each trial. They affect how the motion of a free base is measured, not the motion.
    camera: tuple[Parameter, ...] = ()
    tree: Tree

    def __init__(self, robot: Robot, *, max_step: float = STEP_S) -> None:
        self.robot, self.max_step = robot, max_step
        self.tree = self._tree()
        self.engine = self.tree.engine
        self.coordinates, self.speeds = self.engine.coordinates, self.engine.speeds
        self.driven, self.passive = self.tree.driven, self.tree.passive
        self.actuators = self.tree.actuators
        # the first parameters are the coefficients of the robot file
        self.free_base, self.coefficients = self.tree.free_base, self.tree.names
        # name the parameters for the offset of the start pose of each trial
        self.starts = tuple(f"start_{word}" for word in self.places)
        self.parameters = (*coefficients(self.tree.body.coefficients), *_trial_parameters(self))
        self.channels = _channels(self)
        self._index_parameters()
        self.inputs = self.tree.body.inputs
        self.kernels = Kernels(self.tree, self._room)
        self._checked: bytes | None = None
        self._clear_caches()

    def _index_parameters(self) -> None:
        """Find the indices of the parameters by their use, and the joint columns of a state vector."""
        self._at = {p.name: i for i, p in enumerate(self.parameters)}
        views = {"clock_offset", *(p.name for p in self.camera), *self._offsets()}
        views |= {f"{word}_{name}" for word in ("offset", "drift") for name in self.reactions}
        moving = [i for i, p in enumerate(self.parameters) if p.name not in views]
        self._dynamic = np.array(moving, dtype=np.intp)
        self._angles, self._speeds = (
            np.array([self._at[f"initial_{word}_{axis.name}"] for axis in self.passive], dtype=int)
            for word in ("angle", "rate")
        )
        first = self.coordinates + len(self.passive)
        self._joint_columns = {a.column: self.coordinates + k for k, a in enumerate(self.passive)}
        self._joint_columns |= {a.rate: first + self.speeds + k for k, a in enumerate(self.passive)}
        velocities = [f"initial_{name}" for name in self.rates]
        self._velocities, self._offset = (
            np.array([self._at[name] for name in names if self.free_base], dtype=int)
            for names in (velocities, self.starts)
        )

    def _clear_caches(self) -> None:
        """Set empty caches of simulations. A copy with another integration step needs caches of its own."""
        self.joints = DrivenJoints(self.tree, self._mounts())
        self.steady = SteadySwimming(self)
        self._trajectories: TrialCache[Trajectory] = TrialCache(MAX_TRAJECTORIES)
        self._grids: dict[str, tuple[Array, Grid]] = {}

    # -------------------------------------------------------- defined by the planar and the 3-D model

    @abstractmethod
    def _tree(self) -> Tree:
        """Return the links of the robot, with their input arrays for the equations of motion."""

    @abstractmethod
    def _offsets(self) -> tuple[str, ...]:
        """Return the names of the start-pose offsets that do not affect the simulated motion."""

    @abstractmethod
    def _velocities_of_pose(self, seen: Callable[[str, int], float | None]) -> Sequence[float | None]:
        """Return the velocities at the first sample that follow from the pose; empty if the pose gives none.

        See :meth:`start_velocities`.
        """

    @abstractmethod
    def observe(self, values: Array, trial: Trial, states: Array) -> dict[str, Array]:
        """Return the channels of pose and velocity of the reference point from simulated states."""

    @abstractmethod
    def _begin(self, start: Array, values: Array, trial: Trial, begin_s: float, hooks: Hooks) -> None:
        """Write the initial pose and velocity of the base into the state vector ``start``."""

    @abstractmethod
    def at_reference(self, wrench: Array) -> Array:
        """Convert a wrench at the origin of a fixed base to one at the reference point, in world axes."""

    def start_velocities(self, seen: Callable[[str, int], float | None]) -> dict[str, float | None]:
        """Return start values of the velocities at the first sample, by parameter name.

        Measured velocities are preferred to those that follow from the pose.

        Parameters
        ----------
        seen : callable
            Function of a channel and a derivative order (0 or 1). It returns the value or the rate of the
            channel at the first sample, or None if it is unknown.
        """
        names = [f"initial_{name}" for name in self.rates]
        found = {name: seen(column, 0) for name, column in zip(names, self.velocity, strict=True)}
        moved = zip(names, self._velocities_of_pose(seen), strict=False)
        return found | {name: value for name, value in moved if found[name] is None}

    def list_determined_starts(self, measured: Collection[str]) -> list[str]:
        """Return the names of the initial velocities, angles and rates that measured channels determine.

        For a robot in a plane, any measured channels determine all of them.
        """
        return [p.name for p in self.parameters if p.name.startswith("initial_")]

    @property
    @abstractmethod
    def reference_m(self) -> Sequence[float] | NDArray[np.float64]:
        """Position of the reference point in the axes of the base, m."""

    @abstractmethod
    def start_course(self, trial: Trial) -> tuple[float, float, float]:
        """Return the position on the two axes of the motion (m) and the heading (rad) at the first sample."""

    def typical_force(self, scales: Scales) -> float:
        """Return the drag at the typical speed, plus the force for accelerating to this speed, N."""
        tables, columns = self.tree.tables(self.start_coefficients), self.engine.columns
        drag = tables["drag"][:, columns["drag"].index("quadratic_x")].sum()
        size, rest = (columns["foil"].index(name) for name in ("half_rho_area", "cd0"))
        drag += tables["foil"][:, size] @ tables["foil"][:, rest]
        mass = tables["inertia"][:, 0].sum()
        return float(drag * scales.speed**2 + mass * scales.speed / scales.duration)

    @property
    def course(self) -> tuple[str, ...]:
        """Channels of the position and of the heading. The heading comes last, after the horizontal axes."""
        return self.pose

    @cached_property
    def _memory(self) -> list[int]:
        """Indices of the state entries on which the motion over a period of the drive depends.

        These entries are passive joint angles, velocities of a free base and passive joint rates.
        """
        passives, first = len(self.passive), self.coordinates + len(self.passive)
        begin = first + self.speeds * (not self.free_base)
        return [*range(self.coordinates, first), *range(begin, first + self.speeds + passives)]

    def cycle_states(self, states: Array) -> Array:
        """Return those quantities of states on which the motion over a period of the drive depends.

        The motion is the same from any place, and in a plane in any heading. The result has the m quantities
        of n states, shape (n, m).
        """
        return states[:, self._memory]

    def with_cycle_state(self, start: Array, quantities: Array) -> Array:
        """Return a state vector in which the quantities of :meth:`cycle_states` have the given values."""
        state = start.copy()
        state[self._memory] = quantities[-len(self._memory) :]
        return state

    def influences(self, hooks: Hooks) -> NDArray[np.intp]:
        """Return the indices of the parameters that affect the simulated motion."""
        return self._dynamic

    def _mounts(self) -> list[float]:
        """Return the mounting angle, rad, that is added to the angle of each driven joint."""
        return [0.0] * len(self.driven)

    def _room(self) -> Room | None:
        """Return the elements and forces that effects may add to the simulation; None if they add none."""
        return None

    def frame(self, run: SimulationRequest) -> Array:
        """Return the pose of the simulation's coordinate frame in the world, for external forces."""
        raise NotImplementedError

    def _add_water_motion(self, found: dict[str, Array], hooks: Hooks, begin_s: float, time_s: Array) -> None:
        """Add the motion of the water to channels that were simulated relative to the water."""

    # -------------------------------------------------------- used by fits

    @property
    def swimmer(self) -> Self:
        """The model itself, because it is a model of a robot with links (see :attr:`Model.swimmer`)."""
        return self

    def get_file_values(self) -> dict[str, float]:
        """Return the values of the coefficients in the robot file."""
        return {name: c.value for name, c in self.tree.body.coefficients.items()}

    @property
    def start_coefficients(self) -> Array:
        """Start values of the coefficients of the robot file."""
        return np.array([p.start for p in self.parameters[: len(self.coefficients)]])

    def list_input_channels(self, trial: Trial) -> list[str]:
        """Return the channels of measured joint angles that drive the simulation.

        Joints with a servo or a shared actuator are not among them, because their angles are simulated.
        """
        if trial.swim.joints is None:
            return []
        return [a.column for a in self.driven if a.law is not None and not a.law.is_computed]

    def check(self, values: Array) -> None:
        """Raise an error if the coefficients give physically impossible masses or inertias.

        Raises
        ------
        InputError
        """
        own = values[: len(self.coefficients)]
        if own.tobytes() != self._checked:
            self.tree.check(own)
            self._checked = own.tobytes()

    def command(self, number: int, swim: SwimInput, time_s: Array, phase_rad: float) -> Array:
        """Return the commanded angle of an actuator, rad, shape (n,)."""
        return joint_motion(self.actuators[number], number, swim, time_s, phase_rad)[0]

    def is_commanded(self, trial: Trial) -> bool:
        """Return whether commands act in a trial: a drive, logged commands, or unmeasured inputs."""
        joints = trial.swim.drive is not None
        if trial.swim.joints is not None:
            joints = trial.swim.commanded
        return joints or any(not law.measured for law in self.inputs.values())

    def commands(self, trial: Trial) -> Iterator[tuple[Array, Array, float]]:
        """Yield time (s), command and maximum rate of the command of each actuator and input.

        The commands of actuators are in rad, those of inputs in the unit of their column.
        """
        yield from self.joints.commands(trial)

    def compute_inputs(self, trial: Trial) -> Array:
        """Return the inputs behind the laws of their actuators during a trial, shape (n, inputs)."""
        values = np.array([p.start for p in self.parameters])
        grid = self._grid(values, trial, NONE)
        return self.joints.motion(values, trial, grid, 0.0, NONE).table[:, len(self.driven) :, 0]

    def thrusters(self, tables: Mapping[str, Any]) -> tuple[NDArray[np.intp], NDArray[np.intp], Array]:
        """Return the loads that are thrusters: forces in the axes of a link that follow a command.

        Returns
        -------
        rows : ndarray of int, shape (thrusters,)
            Rows of the loads in the input array ``load``.
        inputs : ndarray of int, shape (thrusters,)
            Indices of the inputs of the thrusters.
        forces_N : ndarray, shape (thrusters,)
            Forces of the thrusters for an input of 1.
        """
        columns = self.engine.columns["load"]
        along = [i for i, name in enumerate(columns) if name.startswith("force_")]
        forces = np.linalg.norm(tables["load"][:, along], axis=1)
        inputs = tables["load_input"] - len(self.driven)
        measured = np.array([law.measured for law in self.inputs.values()], dtype=bool)
        commanded = ~measured[inputs] & (tables["load"][:, columns.index("world")] == 0.0)
        rows = np.flatnonzero(commanded & (forces > 0.0))
        return rows, inputs[rows], forces[rows]

    def lose_thrust(self, tables: dict[str, Any], loss: float) -> None:
        """Let the thrust T of each thruster fall by ``loss sqrt(|T|) u`` at the velocity u along the thrust.

        The unit of ``loss`` is (kg/m)^0.5.
        """
        rows, _, forces = self.thrusters(tables)
        tables["load"][rows, self.engine.columns["load"].index("loss")] = loss / forces**1.5

    def list_joint_coefficients(self) -> list[str]:
        """Return the names of the coefficients in the laws of the passive joints, such as their stiffness."""
        entries = [entry for axis in self.passive for entry in law_of(axis.joint)]
        used = {name for entry in entries for name in entry.names}
        return [name for name in self.coefficients if name in used]

    def forget(self, trials: Sequence[Trial]) -> None:
        """Remove the cached results of trials that will not be simulated again."""
        names = {trial.id for trial in trials}
        self._trajectories.forget(names)
        self.joints.forget(names)
        for acting in self.acting:
            acting.forget(names)
        for name in names:
            self._grids.pop(name, None)

    # -------------------------------------------------------- compilation and variants of the model

    def prepare(self, progress: Progress = silent, *, effects: bool = False) -> None:
        """Compile the kernels (see :meth:`Model.prepare`)."""
        effects = effects or any(effect.stage not in ("actuation", "sensing") for effect in self.effects)
        self.kernels.prepare(self.robot.name, progress, effects=effects)

    def refine(self) -> Self:
        """Return the same model with half the integration step."""
        return self._with_step(0.5 * self.max_step)

    def coarser(self) -> Self:
        """Return the same model with twice the integration step."""
        return self._with_step(2.0 * self.max_step)

    def _with_step(self, max_step: float) -> Self:
        other = copy.copy(self)
        other.max_step = max_step
        other._clear_caches()
        return other

    def read_otherwise(self, robot: Robot) -> Self:
        """Return the model of the same robot with another interpretation of its source.

        The effects of this model act on the new one as well. If the parameter names agree, the new model
        takes over the parameters of this model. It also takes over the compiled kernels if the constant
        entries of the input arrays agree.
        """
        other = type(self)(robot, max_step=self.max_step)
        same = [p.name for p in other.parameters] == [p.name for p in self.parameters[: len(self._at)]]
        if same:
            other.parameters = self.parameters[: len(self._at)]
            draws = np.random.default_rng(0).uniform(0.5, 1.5, (3, len(self.coefficients)))
            if all(self.kernels.own.fits(other.tree.tables(draw)) for draw in draws):
                other.kernels = self.kernels
        other = other._with_acting([(acting.effect, acting.parameters) for acting in self.acting])
        if same:
            other.parameters = self.parameters
        return other

    # -------------------------------------------------------- simulation

    def simulate_hooked(self, values: Array, trial: Trial, hooks: Hooks) -> dict[str, Array]:
        """Simulate a trial with effects (see :meth:`Model.simulate_hooked`)."""
        return self._at_samples(values, trial, hooks, self.trajectory(values, trial, hooks))

    @property
    def batch_size(self) -> int:
        """Number of simulations in one batch of the compiled kernel (see :attr:`Model.batch_size`)."""
        return LANES if self.kernels.used else 1

    def simulate_many(self, runs: Sequence[Request]) -> list[dict[str, Array]]:
        """Simulate several trials in batches of the compiled kernel (see :meth:`Model.simulate_many`)."""

        def observe(k: int, run: SimulationRequest, trajectory: Trajectory) -> tuple[int, dict[str, Array]]:
            return k, self._at_samples(*runs[k], trajectory)

        channels = dict(filter(None, unless_broken(observe, self._simulate_many(runs))))
        return [channels.get(k) or self.make_broken(trial) for k, (_, trial, _) in enumerate(runs)]

    def with_energetics(
        self, runs: Sequence[tuple[Array, Trial]], last_s: Sequence[float]
    ) -> list[tuple[dict[str, Array], Energetics | None]]:
        """Simulate several trials, and compute torques and powers over the last part of each simulation.

        All effects of the model act on the motion, except those of sensors and clocks.

        Parameters
        ----------
        runs : sequence of (values, trial)
        last_s : sequence of float
            Length of the last part of each simulation, s. It is rounded to whole integration steps.

        Returns
        -------
        list of (channels, Energetics)
            If a simulation diverges, its channels are NaN and its energetics are None.
        """
        asked = [self._arguments(*run, measured=False) for run in runs]
        found: dict[int, tuple[dict[str, Array], Energetics | None]] = {}
        for k, run, trajectory in self._simulate_many(asked):
            if np.isfinite(trajectory.states[-1]).all():
                columns = self._at_samples(*asked[k], trajectory)
                found[k] = columns, _energetics(self, run, trajectory, last_s[k])
        return [found.get(k) or (self.make_broken(trial), None) for k, (_, trial) in enumerate(runs)]

    def trajectory(self, values: Array, trial: Trial, hooks: Hooks = NONE) -> Trajectory:
        """Return the simulated trajectory of a trial at the integration steps.

        The motion begins at the origin of the world. In flowing water it is relative to the water.
        """
        request = self.request(values, trial, hooks)
        ((_, _, found),) = self._trajectories_of([(0, request)])
        return found

    def cruise(self, values: Array, trial: Trial) -> SteadySpeed | None:
        """Return the steady swimming of the model under the drive of a trial, with all effects.

        Returns
        -------
        SteadySpeed or None
            None if the drive is not periodic, or if the base is fixed.
        """
        if trial.swim.drive is None or not self.free_base:
            return None
        return self.steady.cruise(*self._arguments(values, trial))

    def request(self, values: Array, trial: Trial, hooks: Hooks) -> SimulationRequest:
        """Return the request for a simulation of a trial with effects.

        The request has all inputs of the integration, or the trajectory if it is cached.
        """
        if trial.swim.coefficients:
            values = values.copy()
            for name, value in trial.swim.coefficients.items():
                values[self._at[name]] = value
        grid = self._grid(values, trial, hooks)
        key = values[self.influences(hooks)].tobytes(), hooks.key, grid
        kept = self._trajectories.get(trial.id, key)
        if kept is not None:
            return SimulationRequest(values, trial, hooks, key, grid, kept)
        motion = self.joints.motion(values, trial, grid, self.value(values, "drive_phase"), hooks)
        passives = len(self.passive)
        start = np.zeros(self.coordinates + self.speeds + 2 * passives)
        self._begin(start, values, trial, grid.begin_s, hooks)
        start[self.coordinates : self.coordinates + passives] = values[self._angles]
        start[len(start) - passives :] = values[self._speeds]
        tables = self._tables(values, hooks)
        run = SimulationRequest(values, trial, hooks, key, grid, None, start, motion, tables)
        return run._replace(start=self.steady.initial_state(run)) if trial.swim.steady else run

    def _tables(self, values: Array, hooks: Hooks) -> dict[str, Any]:
        """Return the input arrays of the equations of motion, as effects change them, by name."""
        tables = self.tree.tables(values[: len(self.coefficients)])
        if not hooks.tables:
            return tables
        # copy the cached input arrays, because an effect writes into them
        own = {name: t.copy() if isinstance(t, np.ndarray) else t for name, t in tables.items()}
        return hooks.change_values(own, "tables")

    def _pack_forces(self, run: SimulationRequest) -> tuple[Any, ...] | None:
        """Return the forces of effects as the engine takes them; None if there are none."""
        if not run.hooks.force:
            return None
        return pack_forces(run.hooks.force, self.frame(run), len(self.tree.links))

    def integrate(self, run: SimulationRequest) -> tuple[Array, Array]:
        """Integrate a simulation by the scalar engine, and return the states and their time derivatives."""
        tables = tuple(run.tables.values())
        states, rates = self.engine.integrate(
            run.start, run.grid.step_s, run.drive.table, tables, self._pack_forces(run), run.grid.begin_s
        )
        return states, rates

    def torques(self, run: SimulationRequest, trajectory: Trajectory, first: int) -> tuple[Array, Array]:
        """Return the torques on the links, and the wrench on the base, from step ``first`` on.

        The torques have the shape (m, links), N m. The wrench is force (N) and moment (N m) at the origin of
        the base, in the axes of the base.
        """
        tables, grid = tuple(self._tables(run.values, run.hooks).values()), trajectory.grid
        drive = trajectory.drive.table[::2][first:]
        begin_s, forces = grid.begin_s + first * grid.step_s, self._pack_forces(run)
        torque, wrench = self.engine.compute_torques(
            trajectory.states[first:], trajectory.rates[first:], drive, tables, forces, begin_s, grid.step_s
        )
        return np.asarray(torque), np.asarray(wrench)

    def _compute_reactions(
        self, values: Array, trial: Trial, hooks: Hooks, trajectory: Trajectory, time_s: Array
    ) -> dict[str, Array]:
        """Return the force and torque of the robot on its holder as a load cell measures them, by channel.

        The torque is about the reference point. The holder responds like a damped oscillator. Each channel
        has an offset and a drift in each trial.
        """
        grid = trajectory.grid
        run = SimulationRequest(values, trial, hooks, (), grid, trajectory)
        _, wrench = self.torques(run, trajectory, 0)
        steps = grid.times(1)
        found = {}
        for name, force in zip(self.reactions, self.at_reference(-wrench).T, strict=True):
            if self.tree.body.holder is not None:
                force = self._resonant(values, force, grid.step_s)
            seen = np.asarray(make_interp_spline(steps, force, k=3)(np.clip(time_s, steps[0], steps[-1])))
            offset, drift = (self.value(values, f"{word}_{name}") for word in ("offset", "drift"))
            found[name] = seen + offset + drift * (trial.time_s - trial.time_s[0])
        return found

    def _resonant(self, values: Array, force: Array, step_s: float) -> Array:
        """Return the force that a sensor measures behind the elastic holder of the robot.

        The result is exact for a force that is linear between the steps.
        """
        from scipy.signal import cont2discrete, lfilter

        named = self.tree.name_values(values)
        holder = self.tree.body.holder
        omega = 2.0 * math.pi * Polynomial.of(holder.natural_frequency_hz).at(named)
        damping = Polynomial.of(holder.damping_ratio).at(named)
        law = ([omega**2], [1.0, 2.0 * damping * omega, omega**2])
        numerator, denominator, _ = cont2discrete(law, step_s, method="foh")
        return np.asarray(force[0] + lfilter(numerator.ravel(), denominator, force - force[0]))

    def value(self, values: Array, name: str) -> float:
        """Return the value of a parameter, or 0 if the model does not have the parameter."""
        return float(values[self._at[name]]) if name in self._at else 0.0

    def _simulate_many(self, runs: Sequence[Request]) -> Iterator[tuple[int, SimulationRequest, Trajectory]]:
        """Simulate trials with effects, and yield the index, the request and the trajectory of each.

        A simulation that diverges before its first step is left out. Only a few requests are in memory at
        a time, because each of them may have a joint motion of its own.
        """
        for first in range(0, len(runs), MAX_REQUESTS):
            asked = enumerate(unless_broken(self.request, runs[first : first + MAX_REQUESTS]), first)
            yield from self._trajectories_of([(k, run) for k, run in asked if run is not None])

    def _trajectories_of(
        self, runs: Sequence[tuple[int, SimulationRequest]]
    ) -> Iterator[tuple[int, SimulationRequest, Trajectory]]:
        """Yield number, request and trajectory of each requested simulation.

        A trajectory is yielded as soon as it is known, so that a large batch needs little memory. Requests
        with equal keys are simulated once.
        """
        missing: dict[tuple[str, Hashable], SimulationRequest] = {}
        equal: dict[tuple[str, Hashable], list[int]] = {}
        for k, run in runs:
            if run.kept is not None:
                yield k, run, run.kept
                continue
            missing.setdefault((run.trial.id, run.key), run)
            equal.setdefault((run.trial.id, run.key), []).append(k)
        # the many simulations of one trial for a Jacobian are not needed again
        counts = Counter(trial for trial, _ in missing)
        lasting = {trial for trial, count in counts.items() if count <= MAX_TRAJECTORIES}
        for at, (states, rates) in self.integrate_many(missing):
            run = missing[at]
            trajectory = Trajectory(run.grid, states, rates, run.drive)
            if run.trial.id in lasting:
                self._trajectories.put(run.trial.id, run.key, trajectory)
            yield from ((k, run, trajectory) for k in equal[at])

    def integrate_many(
        self, runs: Mapping[Any, SimulationRequest]
    ) -> Iterator[tuple[Any, tuple[Array, Array]]]:
        """Yield key, states and rates of all simulations. Those that the kernels can compute come first."""
        rest = dict(runs)
        for at, result in self.kernels.run(runs, self.frame):
            del rest[at]
            yield at, result
        yield from ((at, self.integrate(run)) for at, run in rest.items())

    def _grid(self, values: Array, trial: Trial, hooks: Hooks) -> Grid:
        """Return the integration grid of a trial.

        The grid extends beyond the last sample if the clock of the log is late relative to the clock of the
        drive.
        """
        known = self._grids.get(trial.id)
        if known is None or known[0] is not trial.time_s:
            known = self._grids[trial.id] = (trial.time_s, integration_grid(trial.time_s, self.max_step))
        begin, step, steps = known[1]
        offset = self.value(values, "clock_offset")
        ahead = offset + hooks.clock_s + hooks.clock_drift * (float(trial.time_s[-1]) - offset)
        late = min(max(-ahead, 0.0), step * steps)
        return Grid(begin, step, steps + math.ceil(late / step))

    def _at_samples(self, values: Array, trial: Trial, hooks: Hooks, run: Trajectory) -> dict[str, Array]:
        """Return the channels of a trajectory, interpolated at the samples of a trial."""
        time = hooks.compute_event_times(trial.time_s - self.value(values, "clock_offset"))
        states = interpolate_states(time, run.grid.begin_s, run.grid.step_s, run.states, run.rates)
        found: dict[str, Array] = {}
        if self.free_base:
            found.update(self.observe(values, trial, states))
            if hooks.flow:
                self._add_water_motion(found, hooks, run.grid.begin_s, time)
        for name, column in self._joint_columns.items():
            found[name] = states[:, column]
        if self.driven:
            columns = (axis.column for axis in self.driven)
            found.update(zip(columns, run.drive.interpolate_states(time, run.grid), strict=True))
        if not self.free_base and (not trial.measured or trial.measured.keys() & set(self.reactions)):
            found |= self._compute_reactions(values, trial, hooks, run, time)
        return hooks.sense(found, trial.time_s) if hooks.output else found


#: Typical scales of the start pose and velocity of a free base, by unit.
START_SCALES = {"m": 0.01, "rad": 0.05, "m/s": 0.1, "rad/s": 0.5}


def _trial_parameters(model: Swimmer) -> list[Parameter]:
    """Return the per-trial parameters: initial state, drive phase, start pose, clock offset and camera.

    Start pose, clock offset and camera affect mainly how the motion is measured.
    """
    initial, view = [], []
    if model.free_base:
        for name, column in zip(model.rates, model.velocity, strict=True):
            unit, meaning = split_unit(column)[1], f"{name.replace('_', ' ')} at the first sample"
            initial.append(trial_parameter(f"initial_{name}", unit, START_SCALES[unit], meaning))
        for name, word, column in zip(model.starts, model.places, model.pose, strict=True):
            unit, meaning = split_unit(column)[1], f"{word} of the start against the first sample"
            view.append(trial_parameter(name, unit, START_SCALES[unit], meaning))
    else:
        for name in model.reactions:
            bare, unit = split_unit(name)
            words = bare.replace("_", " ")
            view.append(trial_parameter(f"offset_{name}", unit, 0.1, f"offset of the {words}"))
            view.append(trial_parameter(f"drift_{name}", f"{unit}/s", 0.01, f"drift of the {words}"))
    for axis in model.passive:
        for word, unit, scale in (("angle", "rad", 0.1), ("rate", "rad/s", 1.0)):
            meaning = f"{word} of {axis.name} at the first sample"
            initial.append(trial_parameter(f"initial_{word}_{axis.name}", unit, scale, meaning))
    phase = trial_parameter("drive_phase", "rad", 1.0, "phase of the beat at time zero")
    clock = trial_parameter("clock_offset", "s", 0.01, "the log's clock ahead of the drive's")
    return [*initial, phase, *view, clock, *model.camera[: len(view) * model.free_base]]


def _channels(model: Swimmer) -> tuple[Channel, ...]:
    """Return the channels of a model.

    The channels are pose and velocity of a free base, angles of all joints, and rates of passive joints.
    """
    found = []
    if model.free_base:
        names, words = (*model.pose, *model.velocity), (*model.places, *model.rates)
        for name, word in zip(names, words, strict=True):
            unit = split_unit(name)[1]
            found.append(Channel(name, unit, word.replace("_", " ") + " speed" * (unit == "m/s")))
    else:
        for name in model.reactions:
            bare, unit = split_unit(name)
            found.append(Channel(name, unit, f"{bare.replace('_', ' along ')} on the holder"))

    def position(axis: MovingJoint) -> tuple[int, str]:
        return len(axis.column), axis.column

    for axis in sorted([*model.passive, *model.driven], key=position):
        found.append(Channel(axis.column, "rad", f"angle of {axis.name}"))
    for axis in model.passive:
        found.append(Channel(axis.rate, "rad/s", f"rate of {axis.name}"))
    return tuple(found)


def _energetics(model: Swimmer, run: SimulationRequest, trajectory: Trajectory, last_s: float) -> Energetics:
    """Return torques and powers of the driven joints over the last ``last_s`` seconds of a trajectory."""
    steps = max(round(last_s / trajectory.grid.step_s), 1)
    first = max(len(trajectory.states) - 1 - steps, 0)
    torque = model.torques(run, trajectory, first)[0][:, [a.link for a in model.driven]]
    rates = trajectory.drive.table[::2][first:, : len(model.driven), 1]
    return Energetics(trajectory.grid.times(1)[first:], torque, rates, model.tree.actuator_of)


def trial_parameter(name: str, unit: str, scale: float, meaning: str) -> Parameter:
    """Return a per-trial parameter. It is zero unless it is estimated."""
    return Parameter(name, unit, -math.inf, math.inf, 0.0, scale, False, True, meaning)


def integration_grid(time_s: Array, max_step: float) -> Grid:
    """Return the time grid for the integration of a trial.

    The median sampling interval is divided into equal steps, so that the samples of an evenly sampled log lie
    on the grid. If the sampling interval is shorter than the maximum step, the step is a whole multiple of
    the interval.

    >>> integration_grid(np.array([0.0, 0.02, 0.04]), 0.005)
    Grid(begin_s=0.0, step_s=0.005, steps=8)
    >>> integration_grid(np.arange(9) / 1000, 0.005)
    Grid(begin_s=0.0, step_s=0.005, steps=2)
    """
    begin, end = float(time_s[0]), float(time_s[-1])
    if end <= begin:
        return Grid(begin, max_step, 1)
    typical = float(np.median(np.diff(time_s)))
    even = (end - begin) / max(round((end - begin) / typical), 1)
    if even > max_step:
        step = even / math.ceil(even / max_step - 1e-9)
    else:
        step = even * math.floor(max_step / even + 1e-9)
    return Grid(begin, step, max(1, math.ceil((end - begin) / step - 1e-6)))


def flows(hooks: Hooks, time_s: Array) -> tuple[Array, Array]:
    """Return displacement (m) and velocity (m/s) of the water in the world, shape (n, 2) each."""
    parts = [flow(time_s) for flow in hooks.flow]
    return np.asarray(sum(p[0] for p in parts)), np.asarray(sum(p[1] for p in parts))


def rotate_vector(x: Array | float, y: Array | float, angle: Array | float) -> Array:
    """Return a vector rotated by an angle (rad), shape (2, n)."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([c * x - s * y, s * x + c * y])
