"""A robot with links as a model, in a plane or in space: parameters in, channels out."""

from __future__ import annotations

import math
import threading
from abc import abstractmethod
from collections import OrderedDict
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple, Self, TypeVar

import numpy as np

from swimid.files.checkpoint import Checkpoint
from swimid.fitting import drives
from swimid.fitting.drives import Motion, SwimInput
from swimid.fitting.hooks import NONE, Hooks
from swimid.fitting.model import Array, Channel, Model, Parameter, Trial, unless_broken
from swimid.progress import Progress, silent
from swimid.robots.file import Robot
from swimid.swimmer.energetics import Energetics, elastic
from swimid.swimmer.lanes.kernel import Engine, Kernel, Room, WideKernel
from swimid.swimmer.lanes.tracing import LANES
from swimid.swimmer.limit_cycle import STATE_RTOL, LimitCycle, limit_cycle
from swimid.swimmer.options import STEP_S
from swimid.swimmer.planar import drive
from swimid.swimmer.planar.engine import sampled
from swimid.swimmer.tree import Axis, Polynomial, Tree, coefficients, law_of

Kept = TypeVar("Kept")
#: Trajectories kept per trial: what changes only how they are seen costs no simulation.
KEPT = 4
#: Limit cycles kept.
CYCLES = 64
#: Tables of the drive kept per trial: derivatives to what changes a command ask for the same few in turn.
TABLES = 12


@dataclass(frozen=True)
class Drive:
    """The driven joints of a run.

    Attributes
    ----------
    table : ndarray, shape (2 steps + 1, driven joints, 5)
        On the half-step grid, as the engine takes it.
    angles, rates : ndarray, shape (steps + 1, driven joints)
        On the grid itself, for the channels.
    """

    table: Array
    angles: Array
    rates: Array
    _kept: dict[bytes, Array] = field(init=False, repr=False, compare=False, default_factory=dict)

    def sampled(self, time_s: Array, begin_s: float, step_s: float) -> Array:
        """Angles at any times, shape (n, driven joints), on a grid that begins there; the last are kept."""
        key = time_s.tobytes()
        found = self._kept.get(key)
        if found is None:
            found = sampled(time_s, begin_s, step_s, self.angles, self.rates)
            self._kept.clear()
            self._kept[key] = found
        return found


@dataclass(frozen=True)
class Trajectory:
    """A simulated run on its own grid."""

    begin_s: float
    step_s: float
    #: Shape (steps + 1, k) each: as the engine's ``integrate`` gives them.
    states: Array
    rates: Array
    drive: Drive


#: Of a run that is kept.
NO_DRIVE = Drive(np.empty((0, 0, 5)), np.empty((0, 0)), np.empty((0, 0)))


@dataclass(frozen=True)
class Run:
    """One run as the engine is asked for it: its trajectory where that is kept, else what it needs."""

    values: Array
    trial: Trial
    hooks: Hooks
    key: bytes
    begin_s: float
    step_s: float
    kept: Trajectory | None
    start: Array = field(default_factory=lambda: np.empty(0))
    drive: Drive = NO_DRIVE
    tables: Mapping[str, Any] = field(default_factory=dict)


class Cruise(NamedTuple):
    """Steady swimming of a model.

    Attributes
    ----------
    speed_m_s : float
        Path length over one period of the drive, over the period; NaN where the speed never settles.
    settling_s : float
        Time in which a difference from the steady speed falls by a factor e; infinite where it never settles.
    """

    speed_m_s: float
    settling_s: float


class Swimmer(Model):
    """A robot with links whose runs are kept as long as only how they are seen changes.

    What is known of a trial is its :attr:`Trial.swim`.

    Parameters
    ----------
    robot : Robot
    max_step : float, s
        Each sampling interval is cut into equal steps no longer than this.
    """

    #: Channels of the reference point.
    pose: tuple[str, ...]
    velocity: tuple[str, ...]
    #: The coordinates of the base in a state, and its velocities; those of passive joints follow each.
    coordinates: int
    speeds: int
    #: Words of the pose and of the velocities; parameters of the start are called by them.
    places: tuple[str, ...]
    rates: tuple[str, ...]
    #: Per-trial parameters, beside the clock, that only change how a run of a free base is seen.
    camera: tuple[Parameter, ...] = ()
    engine: Engine
    tree: Tree

    def __init__(self, robot: Robot, *, max_step: float = STEP_S) -> None:
        self.robot, self.max_step = robot, max_step
        self.tree = self._tree()
        self.driven, self.passive = self.tree.driven, self.tree.passive
        # the coefficients of the robot file are the first of the parameters
        self.free_base, self.coefficients = self.tree.free_base, self.tree.names
        # offsets of the start pose, of single trials
        self.starts = tuple(f"start_{word}" for word in self.places)
        self.parameters = (*coefficients(self.tree.body.coefficients), *self._start(), *self._view())
        self._at = {p.name: i for i, p in enumerate(self.parameters)}
        self._count = len(self.tree.names)
        seen = {"clock_offset", *(p.name for p in self.camera), *self._offsets()}
        self._dynamic = [i for i, p in enumerate(self.parameters) if p.name not in seen]
        self._servos = [_servo(axis) for axis in self.driven]
        self.channels = self._channels()
        self._kept: dict[str, OrderedDict[bytes, Trajectory]] = {}
        self._drives: dict[tuple[Any, ...], Drive] = {}
        self._motions: dict[tuple[Any, ...], list[Motion]] = {}
        self._grids: dict[str, tuple[Array, tuple[float, float, int]]] = {}
        self._commands: dict[str, tuple[SwimInput, Array, list[tuple[Array, Array, float]]]] = {}
        self._cycles: dict[tuple[Any, ...], LimitCycle | None] = {}
        self._lock = threading.Lock()
        #: Coefficients that were not refused, the last of them.
        self._sound: bytes | None = None
        #: The compiled form for several runs side by side, and whether runs take it (:meth:`prepare`).
        self.kernel: Kernel | None = None
        self.side_by_side = False
        #: The same for runs with what effects bring.
        self.wide: WideKernel | None = None
        self.wide_side_by_side = False

    # -------------------------------------------------------- what it offers

    @property
    def swimmer(self) -> Self:
        """Itself."""
        return self

    def stated(self) -> dict[str, float]:
        """The robot file's values of its coefficients."""
        return {name: c.value for name, c in self.tree.body.coefficients.items()}

    def given(self, trial: Trial) -> list[str]:
        """Measured joints that drive the run where no servo follows them."""
        if trial.swim.joints is None:
            return []
        return [a.column for a in self.driven if a.driven is not None and a.driven.servo is None]

    def with_buoyancy(self, factor: float) -> Self | None:
        """The same model with every volume that displaces water multiplied; None where none does."""
        return None

    @abstractmethod
    def _tree(self) -> Tree:
        """The robot's links with their tables."""

    @abstractmethod
    def _offsets(self) -> tuple[str, ...]:
        """Offsets of the start pose that only change how a run is seen."""

    def _start(self) -> list[Parameter]:
        found = []
        if self.free_base:
            for name, column in zip(self.rates, self.velocity, strict=True):
                unit, scale = ("m/s", 0.1) if column.endswith("_m_s") else ("rad/s", 0.5)
                words = f"{name.replace('_', ' ')} at the first sample"
                found.append(of_trial(f"initial_{name}", unit, scale, words))
        for axis in self.passive:
            for word, unit, scale in (("angle", "rad", 0.1), ("rate", "rad/s", 1.0)):
                words = f"{word} of {axis.name} at the first sample"
                found.append(of_trial(f"initial_{word}_{axis.name}", unit, scale, words))
        return [*found, of_trial("drive_phase", "rad", 1.0, "phase of the beat at time zero")]

    def _view(self) -> list[Parameter]:
        clock = of_trial("clock_offset", "s", 0.01, "the log's clock ahead of the drive's")
        if not self.free_base:
            return [clock]
        found = []
        for name, word, column in zip(self.starts, self.places, self.pose, strict=True):
            unit, scale = ("m", 0.01) if column.endswith("_m") else ("rad", 0.05)
            found.append(of_trial(name, unit, scale, f"{word} of the start against the first sample"))
        return [*found, clock, *self.camera]

    def _channels(self) -> tuple[Channel, ...]:
        found = []
        if self.free_base:
            for name, word in zip((*self.pose, *self.velocity), (*self.places, *self.rates), strict=True):
                unit = name.split("_", 1)[1].replace("rate_rad_s", "rad/s").replace("_", "/")
                words = word.replace("_", " ")
                found.append(Channel(name, unit, f"{words} speed" if unit == "m/s" else words))
        for axis in sorted([*self.passive, *self.driven], key=lambda a: (len(a.column), a.column)):
            found.append(Channel(axis.column, "rad", f"angle of {axis.name}"))
        for axis in self.passive:
            found.append(Channel(axis.rate, "rad/s", f"rate of {axis.name}"))
        return tuple(found)

    @abstractmethod
    def opening(self, seen: Callable[[str, int], float | None]) -> dict[str, float | None]:
        """Velocities at the first sample, by parameter, as channels show them.

        Parameters
        ----------
        seen : callable
            Value (0) or rate (1) of a channel there; None where it does not tell.
        """

    @abstractmethod
    def initial(self, measured: Collection[str]) -> list[str]:
        """The start velocities, angles and rates that these channels can tell."""

    def check(self, values: Array) -> None:
        """Refuse coefficients that make masses no body has.

        Raises
        ------
        InputError
        """
        own = values[: self._count].tobytes()
        if own != self._sound:
            self.tree.check(values[: self._count])
            self._sound = own

    def command(self, number: int, swim: SwimInput, time_s: Array, phase_rad: float) -> Array:
        """What a driven joint is told to do, rad."""
        return joint_motion(self.driven[number], number, swim, time_s, phase_rad)[0]

    def prepare(
        self,
        progress: Progress = silent,
        *,
        simulated_s: float = 0.0,
        affected_s: float = 0.0,
        checkpoint: Checkpoint | None = None,
    ) -> None:
        """Compile the kernels where that has not been done on this machine and pays."""
        kernel = self.kernels(effects=affected_s > 0.0)
        readings = (f"{q}={r.chosen}" for q, r in sorted(self.robot.readings.items()))
        name = "+".join(("kernels", f"{simulated_s:.0f}", *readings))
        begun = None if checkpoint is None else checkpoint.get(name)
        if begun is not None:
            # forms differ in the last digits: what is taken up goes on in its own
            self.side_by_side, self.wide_side_by_side = bool(begun[0]), bool(begun[1])
            return
        self.side_by_side = kernel.worth(4.0 * simulated_s / self.max_step, progress)
        if self.side_by_side and self.wide is not None:
            self.wide_side_by_side = self.wide.worth(4.0 * affected_s / self.max_step, progress)
        if checkpoint is not None:
            checkpoint.put(name, np.array([self.side_by_side, self.wide_side_by_side], dtype=float))

    def kernels(self, *, effects: bool = True) -> Kernel:
        """Make the kernels, not compiled: the robot's own, and the one with room for what effects bring.

        Returns
        -------
        Kernel
            The robot's own.
        """
        made = self.engine, self.tree.tables, self._count
        self.kernel = self.kernel or Kernel(*made)
        room = self._room() if effects and self.wide is None else None
        if room is not None:
            self.wide = WideKernel(*made, room)
        return self.kernel

    def refined(self) -> Self:
        """The same model with half the integration step."""
        return self._stepping(0.5 * self.max_step)

    def coarser(self) -> Self:
        """The same model with twice the integration step."""
        return self._stepping(2.0 * self.max_step)

    def _stepping(self, max_step: float) -> Self:
        other = type(self)(self.robot, max_step=max_step)
        other.parameters = self.parameters
        other.kernel, other.side_by_side = self.kernel, self.side_by_side
        other.wide, other.wide_side_by_side = self.wide, self.wide_side_by_side
        return other

    def read_otherwise(self, robot: Robot) -> Self:
        """The same model of the same robot, of whose source something was read otherwise.

        Its parameters are this model's where both have the same.

        It runs side by side where this one does and the compiled form serves both: where only numbers differ.
        """
        other = type(self)(robot, max_step=self.max_step)
        if [p.name for p in other.parameters] != [p.name for p in self.parameters]:
            return other
        other.parameters = self.parameters
        if self.kernel is not None and self.side_by_side:
            draws = np.random.default_rng(0).uniform(0.5, 1.5, (3, self._count))
            if all(self.kernel.fits(other.tree.tables(draw)) for draw in draws):
                other.kernel, other.side_by_side = self.kernel, True
                other.wide, other.wide_side_by_side = self.wide, self.wide_side_by_side
        return other

    def _value(self, values: Array, name: str) -> float:
        return float(values[self._at[name]]) if name in self._at else 0.0

    # -------------------------------------------------------- simulation

    @abstractmethod
    def _begin(self, start: Array, values: Array, trial: Trial, begin_s: float, hooks: Hooks) -> None:
        """Fill in the base's part of the first state."""

    @abstractmethod
    def _integrate(self, run: Run) -> tuple[Array, Array]:
        """States and rates of a run."""

    @abstractmethod
    def _seen(self, values: Array, trial: Trial, states: Array) -> dict[str, Array]:
        """Pose and velocity of the reference point."""

    def _room(self) -> Room | None:
        """What effects may bring; None where they bring nothing."""
        return None

    def _influences(self, hooks: Hooks) -> list[int]:
        """The parameters that a run depends on."""
        return self._dynamic

    def _carried(self, found: dict[str, Array], hooks: Hooks, begin_s: float, time_s: Array) -> None:
        """Add the water's own motion to what was simulated relative to it."""

    def simulate(self, values: Array, trial: Trial) -> dict[str, Array]:
        """Pose, velocity and joint angles at the trial's samples (see :meth:`Model.simulate`)."""
        return self.hooked(values, trial, NONE)

    def hooked(self, values: Array, trial: Trial, hooks: Hooks) -> dict[str, Array]:
        """The same with what else acts on the chain (see :meth:`Model.hooked`)."""
        return self._at_samples(values, trial, hooks, self.trajectory(values, trial, hooks))

    @property
    def together(self) -> int:
        """As many as there are lanes (see :attr:`Model.together`)."""
        return LANES if self.side_by_side else 1

    def hooked_many(self, runs: Sequence[tuple[Array, Trial, Hooks]]) -> list[dict[str, Array]]:
        """Several runs, side by side where the robot's kernel is compiled (see :meth:`Model.hooked_many`)."""
        if not self.side_by_side:
            return super().hooked_many(runs)
        each = self._each(runs)
        begun = [(*run, one[1]) for run, one in zip(runs, each, strict=True) if one is not None]
        seen = iter(unless_broken(self._at_samples, begun))
        simulated = [None if one is None else next(seen) for one in each]
        return [
            self.broken_down(trial) if one is None else one
            for one, (_, trial, _) in zip(simulated, runs, strict=True)
        ]

    def with_energetics(
        self, runs: Sequence[tuple[Array, Trial]], last_s: Sequence[float]
    ) -> list[tuple[dict[str, Array], Energetics | None]]:
        """Several runs, each as :meth:`simulate`, with torques and powers over its last stretch each.

        Parameters
        ----------
        last_s : sequence of float
            Length of that stretch of each, s; rounded to whole integration steps.

        Returns
        -------
        list of (channels, Energetics)
            NaN throughout, and None, where a run breaks down.
        """
        each = self._each([(values, trial, NONE) for values, trial in runs])
        found: list[tuple[dict[str, Array], Energetics | None]] = []
        for one, (values, trial), length_s in zip(each, runs, last_s, strict=True):
            if one is None or not np.isfinite(one[1].states[-1]).all():
                found.append((self.broken_down(trial), None))
                continue
            columns = self._at_samples(values, trial, NONE, one[1])
            found.append((columns, self._energetics(one[0].values, one[1], length_s)))
        return found

    def _each(self, runs: Sequence[tuple[Array, Trial, Hooks]]) -> list[tuple[Run, Trajectory] | None]:
        """What was asked and its trajectory, of each run; None where it breaks down before it begins."""
        asked = unless_broken(self._asked, runs)
        trajectories = iter(self._trajectories([one for one in asked if one is not None]))
        return [None if one is None else (one, next(trajectories)) for one in asked]

    def _energetics(self, values: Array, run: Trajectory, last_s: float) -> Energetics:
        """Over the last stretch of a run."""
        count = min(max(round(last_s / run.step_s), 1), len(run.states) - 1) + 1
        rows = slice(len(run.states) - count, None)
        tables = self.tree.tables(values[: self._count])
        states, drive = run.states[rows], run.drive.table[::2][rows]
        torque, flow = self.engine.energetics(states, run.rates[rows], drive, *tables.values())
        first, passives = self.coordinates, len(self.passive)
        angle = states[:, first : first + passives]
        rate = states[:, first + passives + self.speeds :]
        lost, stored = elastic(tables["passive"], angle, rate)
        return Energetics(
            time_s=np.asarray(run.begin_s + run.step_s * np.arange(len(run.states))[rows], dtype=float),
            torque_N_m=torque[:, [a.link for a in self.driven]],
            rate_rad_s=drive[:, :, 1],
            passive_torque_N_m=torque[:, [a.link for a in self.passive]],
            passive_rate_rad_s=rate,
            kinetic_J=flow[:, 0],
            stored_J=stored,
            water_W=flow[:, 1],
            weight_W=flow[:, 2],
            dissipated_W=lost,
        )

    def yielding(self) -> list[str]:
        """The coefficients that stand in the law of a passive joint."""
        used = {
            factor for axis in self.passive for q in law_of(axis.joint) for term in q.terms for factor in term
        }
        return [name for name in self.coefficients if name in used]

    def final_state(self, columns: Mapping[str, Array]) -> dict[str, float]:
        """Velocities, passive angles and rates at the end of a run, by the parameters of a start."""
        found = {}
        if self.free_base:
            for name, column in zip(self.rates, self.velocity, strict=True):
                found[f"initial_{name}"] = float(columns[column][-1])
        for axis in self.passive:
            found[f"initial_angle_{axis.name}"] = float(columns[axis.column][-1])
            found[f"initial_rate_{axis.name}"] = float(columns[axis.rate][-1])
        return found

    def forget(self, trials: Sequence[Trial]) -> None:
        """Let go of what is kept of trials that will not be simulated again."""
        names = {trial.id for trial in trials}
        with self._lock:
            for name in names:
                self._kept.pop(name, None)
                self._grids.pop(name, None)
                self._commands.pop(name, None)
            kept: dict[tuple[Any, ...], Any]
            for kept in (self._drives, self._motions):  # type: ignore[assignment]
                for key in [key for key in kept if key[0] in names]:
                    kept.pop(key, None)

    def _at_samples(self, values: Array, trial: Trial, hooks: Hooks, run: Trajectory) -> dict[str, Array]:
        """The channels of a run."""
        time = hooks.happened(trial.time_s - self._value(values, "clock_offset"))
        states = sampled(time, run.begin_s, run.step_s, run.states, run.rates)
        found: dict[str, Array] = {}
        if self.free_base:
            found.update(self._seen(values, trial, states))
            if hooks.flow:
                self._carried(found, hooks, run.begin_s, time)
        rates = self.coordinates + len(self.passive) + self.speeds
        for k, axis in enumerate(self.passive):
            found[axis.column] = states[:, self.coordinates + k]
            found[axis.rate] = states[:, rates + k]
        if self.driven:
            driven = run.drive.sampled(time, run.begin_s, run.step_s)
            for k, axis in enumerate(self.driven):
                found[axis.column] = driven[:, k].copy()  # of an array that is kept
        return hooks.seen(found, trial.time_s) if hooks.output else found

    def trajectory(self, values: Array, trial: Trial, hooks: Hooks = NONE) -> Trajectory:
        """The run on its own step grid, from the world's origin; relative to the water where that flows."""
        return self._trajectories([self._asked(values, trial, hooks)])[0]

    def _asked(self, values: Array, trial: Trial, hooks: Hooks) -> Run:
        """A run, with all the engine needs unless its trajectory is kept."""
        values = self._with_own_coefficients(values, trial)
        begin, step, steps = self._grid(values, trial, hooks)
        key = values[self._influences(hooks)].tobytes() + hooks.key + np.array((begin, step, steps)).tobytes()
        with self._lock:
            kept = self._kept.setdefault(trial.id, OrderedDict())
            if key in kept:
                kept.move_to_end(key)
                return Run(values, trial, hooks, key, begin, step, kept[key])
        driven = self._drive(values, trial, begin, step, steps, hooks)
        passives = len(self.passive)
        start = np.zeros(self.coordinates + self.speeds + 2 * passives)
        self._begin(start, values, trial, begin, hooks)
        for k, axis in enumerate(self.passive):
            start[self.coordinates + k] = self._value(values, f"initial_angle_{axis.name}")
            speed = self._value(values, f"initial_rate_{axis.name}")
            start[self.coordinates + passives + self.speeds + k] = speed
        tables = self.tree.tables(values[: self._count])
        if hooks.tables:
            # a table without coefficients is the robot's own: an effect must not write into that
            own = {name: t.copy() if isinstance(t, np.ndarray) else t for name, t in tables.items()}
            tables = hooks.changed(own, "tables")
        run = Run(values, trial, hooks, key, begin, step, None, start, driven, tables)
        return replace(run, start=self._steady_state(run)) if trial.swim.steady else run

    # -------------------------------------------------------- steady swimming

    def _memory(self) -> list[int]:
        """Places in a state that one period of the drive hands to the next."""
        passives = len(self.passive)
        angles = list(range(self.coordinates, self.coordinates + passives))
        first = self.coordinates + passives
        rates = list(range(first + self.speeds, first + self.speeds + passives))
        if not self.free_base:
            return [*angles, *rates]
        return [*self._attitude(), *angles, *range(first, first + self.speeds), *rates]

    def _attitude(self) -> list[int]:
        """Places in a state of the angles of the base that act on the motion."""
        return []

    def _limit_cycle(self, run: Run) -> tuple[LimitCycle | None, Callable[..., Array]]:
        """Limit cycle of a run's drive at phase zero, and a function that integrates from such a state.

        The function takes the time (s), the state there and a length (periods). It returns states.
        """
        command, memory = run.trial.swim.drive, self._memory()
        assert command is not None
        period = 1.0 / command.frequency_hz

        def states(begin_s: float, state: Array, periods: float = 1.0) -> Array:
            # the number of steps depends on whole periods alone, so that derivatives are smooth
            steps = math.floor(periods) * math.ceil(period / self.max_step)
            step = periods * period / steps
            driven = self._moved(
                run.trial, begin_s, step, steps, self._value(run.values, "drive_phase"),
                self._servos_at(run.values), run.hooks,
            )  # fmt: skip
            begin = run.start.copy()
            begin[memory] = state
            own = replace(run, begin_s=begin_s, step_s=step, start=begin, drive=driven)
            return self._integrate(own)[0]

        section = run.begin_s - self._since_phase_zero(run)
        driven = replace(command, phase_rad=0.0)
        others = ("drive_phase", "initial_")
        moved = [i for i in self._influences(run.hooks) if not self.parameters[i].name.startswith(others)]
        kind = (driven, run.hooks.key, self.max_step)
        key = (*kind, run.values[moved].tobytes())
        with self._lock:
            missing = key not in self._cycles
            known, near = self._cycles.get(key), self._cycles.get(kind)
        if missing:
            rest = np.zeros(len(memory))
            known = limit_cycle(lambda state: states(section, state)[:, memory], rest, near=near)
            with self._lock:
                self._cycles[key] = known
                if known is not None:
                    self._cycles[kind] = known
                while len(self._cycles) > CYCLES:
                    self._cycles.pop(next(iter(self._cycles)))
        return known, states

    def _since_phase_zero(self, run: Run) -> float:
        """Time from the last phase zero of the drive to the beginning of a run, s."""
        command = run.trial.swim.drive
        assert command is not None
        phase = command.phase_rad + self._value(run.values, "drive_phase")
        cycles = command.frequency_hz * run.begin_s + phase / (2.0 * math.pi)
        return (cycles % 1.0) / command.frequency_hz

    def _steady_state(self, run: Run) -> Array:
        """State of steady swimming at the beginning of a run; NaN where the motion never settles."""
        drive = run.trial.swim.drive
        assert drive is not None
        cycle, states = self._limit_cycle(run)
        start = run.start.copy()
        memory = self._memory()
        start[memory] = np.nan
        if cycle is not None:
            # from one period before, so that no step becomes small
            period = 1.0 / drive.frequency_hz
            ahead = self._since_phase_zero(run) + period
            start[memory] = states(run.begin_s - ahead, cycle.state, ahead / period)[-1, memory]
        return start

    def cruise(self, values: Array, trial: Trial) -> Cruise | None:
        """Speed at which the model settles under a trial's drive.

        Returns
        -------
        Cruise or None
            None where the question has no answer: no periodic drive, a fixed base, or motion in space.
        """
        if trial.swim.drive is None or not self.free_base or self.in_space:
            return None
        period = 1.0 / trial.swim.drive.frequency_hz
        trial = replace(trial, id=f"{trial.id} (steady)", swim=trial.swim.begun())
        run = self._asked(values, trial, NONE)
        cycle, states = self._limit_cycle(run)
        if cycle is None:
            return Cruise(math.nan, math.inf)
        end = states(run.begin_s - self._since_phase_zero(run), cycle.state)[[0, -1]]
        seen = self._seen(values, trial, end)
        x, y, turned = (float(np.diff(seen[name])[0]) for name in self.pose)
        arc = math.hypot(x, y) / float(np.sinc(turned / (2.0 * math.pi)))
        return Cruise(arc / period, -period / math.log(max(cycle.multiplier, 1e-12)))

    # -------------------------------------------------------- runs

    def _trajectories(self, runs: Sequence[Run]) -> list[Trajectory]:
        """Of each run; what is asked twice is run once."""
        trajectories = {(run.trial.id, run.key): run.kept for run in runs if run.kept is not None}
        missing = {(run.trial.id, run.key): run for run in runs if run.kept is None}
        lanes = {at: self.lane(run) for at, run in missing.items()}
        for kernel in (self.kernel, self.wide):
            together = [
                (at, missing[at], lane[1]) for at, lane in lanes.items() if lane and lane[0] is kernel
            ]
            if kernel is None or not together:
                continue
            motions = kernel.run(
                [run.start for _, run, _ in together],
                [run.step_s for _, run, _ in together],
                [run.drive.table for _, run, _ in together],
                [tables for _, _, tables in together],
            )
            for (at, run, _), (states, rates) in zip(together, motions, strict=True):
                trajectories[at] = self._keep(run, states, rates)
        for at, run in missing.items():
            if at not in trajectories:
                trajectories[at] = self._keep(run, *self._integrate(run))
        return [trajectories[run.trial.id, run.key] for run in runs]

    def lane(self, run: Run) -> tuple[Kernel, Mapping[str, Any]] | None:
        """The kernel that takes a run beside others, and its tables there; None where the engine must."""
        if self.kernel is None or not self.side_by_side:
            return None
        if not run.hooks.force and (not run.hooks.tables or self.kernel.fits(run.tables)):
            return self.kernel, run.tables
        if self.wide is None or not self.wide_side_by_side:
            return None
        frame = self._frame(run)
        tables = self.wide.widened(run.tables, run.hooks.force, frame, run.begin_s)
        return None if tables is None else (self.wide, tables)

    def _frame(self, run: Run) -> Array:
        """Where forces from outside find a run, as the engine takes it."""
        raise NotImplementedError

    def _keep(self, run: Run, states: Array, rates: Array) -> Trajectory:
        trajectory = Trajectory(run.begin_s, run.step_s, states, rates, run.drive)
        with self._lock:
            kept = self._kept.setdefault(run.trial.id, OrderedDict())
            kept[run.key] = trajectory
            while len(kept) > KEPT:
                kept.popitem(last=False)
        return trajectory

    def _with_own_coefficients(self, values: Array, trial: Trial) -> Array:
        """The parameters with the coefficients the trial sets for itself in place of the shared ones."""
        own = trial.swim.coefficients
        if not own:
            return values
        values = values.copy()
        for name, value in own.items():
            values[self._at[name]] = value
        return values

    def _grid(self, values: Array, trial: Trial, hooks: Hooks = NONE) -> tuple[float, float, int]:
        """Begin, step and number of steps; a late clock asks for some beyond the last sample."""
        known = self._grids.get(trial.id)
        if known is None or known[0] is not trial.time_s:
            known = self._grids[trial.id] = (trial.time_s, grid(trial.time_s, self.max_step))
        begin, step, steps = known[1]
        offset = self._value(values, "clock_offset")
        ahead = offset + hooks.clock_s + hooks.clock_drift * (float(trial.time_s[-1]) - offset)
        late = min(max(-ahead, 0.0), step * steps)
        return begin, step, steps + math.ceil(late / step)

    def _drive(
        self, values: Array, trial: Trial, begin: float, step: float, steps: int, hooks: Hooks
    ) -> Drive:
        """The driven joints on the half-step grid; kept, since no coefficient but a servo's moves them."""
        if trial.swim.measured:
            hooks = NONE  # measured joints are what the actuators did
        phase = self._value(values, "drive_phase")
        servos = self._servos_at(values)
        key = (trial.id, begin, step, steps, phase, servos, hooks.command_key)
        return self._cached(
            self._drives, TABLES, key, lambda: self._moved(trial, begin, step, steps, phase, servos, hooks)
        )

    def _servos_at(self, values: Array) -> tuple[tuple[float, float] | None, ...]:
        """Natural frequency (Hz) and damping ratio of each driven joint's servo."""
        named = dict(zip(self.tree.names, values, strict=False))
        return tuple(s and (s[0].at(named), s[1].at(named)) for s in self._servos)

    def _moved(
        self, trial: Trial, begin: float, step: float, steps: int, phase: float, servos: Any, hooks: Hooks
    ) -> Drive:
        lead = _memory_s(trial.swim, servos, hooks)
        if lead > 0.0:
            # actuators that remember have followed the steady beat for long
            before = math.ceil(lead / step)
            whole = self._actuated(trial, begin - before * step, step, steps + before, phase, servos, hooks)
            return Drive(whole.table[2 * before :], whole.angles[before:], whole.rates[before:])
        return self._actuated(trial, begin, step, steps, phase, servos, hooks)

    def _actuated(
        self, trial: Trial, begin: float, step: float, steps: int, phase: float, servos: Any, hooks: Hooks
    ) -> Drive:
        half = begin + 0.5 * step * np.arange(2.0 * steps + 1.0)
        told = self._told(trial, begin, step, steps, phase)
        motions: list[Motion] = []
        actual: list[Array] = []
        for k, (motion, servo) in enumerate(zip(told, servos, strict=True)):
            if servo is None:
                if hooks.command:
                    actual.append(hooks.actuated(half, motion[0], k))
                    # joints that do the same are the same motion
                    if k and motion is told[k - 1] and np.array_equal(actual[-2], actual[-1]):
                        motion = motions[-1]
                    else:
                        motion = drive.deviated(motion, actual[-1], 0.5 * step)
                motions.append(motion)
                continue
            fine = begin + 0.25 * step * np.arange(4.0 * steps + 1.0)
            command = hooks.actuated(fine, motion[0], k)
            omega, damping = 2 * math.pi * servo[0], servo[1]
            answer = drive.servo(np.ascontiguousarray(command), 0.5 * step, omega, damping)
            motions.append((answer[:, 0], answer[:, 1], answer[:, 2]))
        table = drive.table(len(half), motions, self._mounts())
        angles, rates = (np.ascontiguousarray(table[::2, :, k]) for k in range(2))
        return Drive(table, angles, rates)

    def _mounts(self) -> list[float]:
        """Angles between links where a driven joint's own is zero, rad, as the engine's table counts them."""
        return [0.0] * len(self.driven)

    def _told(self, trial: Trial, begin: float, step: float, steps: int, phase: float) -> list[Motion]:
        """What each driven joint is told to do, at every half step; where a servo follows, every quarter."""

        def motions() -> list[Motion]:
            found: list[Motion] = []
            for k, (axis, servo) in enumerate(zip(self.driven, self._servos, strict=True)):
                if k and self._alike(k, trial.swim):
                    found.append(found[-1])
                    continue
                part = 0.5 if servo is None else 0.25
                time = begin + part * step * np.arange(steps / part + 1.0)
                found.append(joint_motion(axis, k, trial.swim, time, phase))
            return found

        return self._cached(self._motions, KEPT, (trial.id, begin, step, steps, phase), motions)

    def _alike(self, k: int, swim: SwimInput) -> bool:
        """Whether a beat moves a driven joint as the one before it."""
        if swim.joints is not None or swim.stroke is not None or swim.beat is None:
            return False
        return swim.beat.lag_rad == 0.0 and self.driven[k - 1].driven == self.driven[k].driven

    def _cached(
        self, kept: dict[tuple[Any, ...], Kept], most: int, key: tuple[Any, ...], make: Callable[[], Kept]
    ) -> Kept:
        """Something of a trial, whose id begins the key, kept with the latest others of that trial."""
        known = kept.get(key)
        if known is None:
            known = make()
            with self._lock:
                for old in [k for k in kept if k[0] == key[0]][: 1 - most or None]:
                    kept.pop(old, None)
                kept[key] = known
        return known


def of_trial(name: str, unit: str, scale: float, meaning: str) -> Parameter:
    """A number of each trial, zero unless it is freed."""
    return Parameter(name, unit, -math.inf, math.inf, 0.0, scale, False, True, meaning)


def grid(time_s: Array, max_step: float) -> tuple[float, float, int]:
    """Begin, step and number of steps of the integration of a trial.

    The step divides the median sampling interval, so that samples of an even record lie on it, or is
    a whole multiple of it where samples come faster than steps.

    >>> grid(np.array([0.0, 0.02, 0.04]), 0.005)
    (0.0, 0.005, 8)
    >>> grid(np.arange(9) / 1000, 0.005)
    (0.0, 0.005, 2)
    """
    begin, end = float(time_s[0]), float(time_s[-1])
    if end <= begin:
        return begin, max_step, 1
    typical = float(np.median(np.diff(time_s)))
    even = (end - begin) / max(round((end - begin) / typical), 1)
    if even > max_step:
        step = even / math.ceil(even / max_step - 1e-9)
    else:
        step = even * math.floor(max_step / even + 1e-9)
    return begin, step, max(1, math.ceil((end - begin) / step - 1e-6))


def joint_motion(axis: Axis, number: int, swim: SwimInput, time_s: Array, phase_rad: float) -> Motion:
    """What a driven joint is told to do: a measured angle, its part of the stroke, its share of the beat."""
    if swim.joints is not None:
        return swim.joints[number](time_s)
    law = axis.driven
    assert law is not None
    phase = phase_rad - math.radians(law.phase_lag_deg)
    if swim.stroke is not None:
        return swim.stroke.motion(axis.name, time_s, phase_rad=phase)
    if swim.beat is None:
        return drives.straight(time_s)
    bias_gain = law.gain if law.bias_gain is None else law.bias_gain
    phase -= number * swim.beat.lag_rad
    return swim.beat.motion(
        time_s, gain=law.gain, bias_gain=bias_gain, phase_rad=phase, cell_s=drives.cells(time_s)
    )


def _memory_s(swim: SwimInput, servos: Sequence[tuple[float, float] | None], hooks: Hooks) -> float:
    """Time after which an actuator on a steady beat has forgotten how it began, s; 0 for any other run.

    A servo forgets at the rate of its damping. Backlash and limits of rate repeat from the second period on.
    """
    if not swim.steady or swim.drive is None:
        return 0.0
    rates = [2.0 * math.pi * s[0] * min(s[1], 1.0 / max(2.0 * s[1], 1e-9)) for s in servos if s is not None]
    forgotten = max((-math.log(STATE_RTOL) / max(rate, 1e-3) for rate in rates), default=0.0)
    return forgotten + (2.0 / swim.drive.frequency_hz if hooks.command else 0.0)


def _servo(axis: Axis) -> tuple[Polynomial, Polynomial] | None:
    law = axis.driven
    if law is None or law.servo is None:
        return None
    return Polynomial.of(law.servo.natural_frequency_hz), Polynomial.of(law.servo.damping_ratio)
