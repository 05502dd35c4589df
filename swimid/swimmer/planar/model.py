"""The multi-link robot as a model: parameters in, channels out."""

from __future__ import annotations

import math
import threading
from collections import OrderedDict
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from swimid.fitting.hooks import NONE, Hooks
from swimid.fitting.inputs import SwimInput
from swimid.fitting.model import Array, Channel, Parameter, Trial
from swimid.fitting.swimmer import Swimmer
from swimid.progress import Progress, silent
from swimid.robots.file import Robot
from swimid.swimmer.options import STEP_S
from swimid.swimmer.planar import drive, engine
from swimid.swimmer.planar.assembly import Assembly, Axis
from swimid.swimmer.planar.body import PlanarBody, SwimmerScales
from swimid.swimmer.polynomial import Polynomial
from swimid.swimmer.tree import coefficients

#: Largest integration step, s.
DEFAULT_STEP = STEP_S
#: Trajectories kept per trial: what changes only how they are seen costs no simulation.
KEPT = 4
#: Tables of the drive kept per trial: derivatives to what changes a command ask for the same few in turn.
TABLES = 12
#: Grid on which the command of a drive is read, s.
READ_S = 0.0025


@dataclass(frozen=True)
class Plane:
    """Names of the pose and velocity in a plane of motion."""

    pose: tuple[str, str, str]
    velocity: tuple[str, str, str]
    words: tuple[str, str, str, str, str, str]


PLANES = {
    "horizontal": Plane(
        ("x_m", "y_m", "yaw_rad"),
        ("u_m_s", "v_m_s", "yaw_rate_rad_s"),
        ("x", "y", "yaw", "surge", "sway", "yaw rate"),
    ),
    "vertical": Plane(
        ("x_m", "z_m", "pitch_rad"),
        ("u_m_s", "w_m_s", "pitch_rate_rad_s"),
        ("x", "z", "pitch", "surge", "heave", "pitch rate"),
    ),
}


@dataclass(frozen=True)
class Trajectory:
    """A simulated run on its own grid.

    Attributes
    ----------
    begin_s, step_s : float
    states, rates : ndarray, shape (steps + 1, 2 n)
        As :func:`engine.integrate`.
    driven : ndarray, shape (steps + 1, driven joints, 3)
        Angle, rate and acceleration.
    """

    begin_s: float
    step_s: float
    states: Array
    rates: Array
    driven: Array


class MultilinkModel(Swimmer):
    """A planar multi-link robot (:mod:`swimid.swimmer.planar.engine`).

    What is known of a trial is its :attr:`Trial.swim`.

    Parameters
    ----------
    robot : Robot
        With a ``multilink`` part.
    max_step : float, s
        Each sampling interval is cut into equal steps no longer than this.
    """

    name = "multilink"
    offers = frozenset({"command", "tables", "force", "flow", "output", "clock"})

    def __init__(self, robot: Robot, *, max_step: float = DEFAULT_STEP) -> None:
        assert robot.multilink is not None
        self.robot = robot
        self.max_step = max_step
        self.assembly = Assembly(robot.multilink, robot.fluid)
        self.plane = PLANES[robot.multilink.plane]
        self.pose, self.velocity = self.plane.pose, self.plane.velocity
        self.driven, self.passive = self.assembly.driven, self.assembly.passive
        self.free_base = self.assembly.free_base
        self.coefficients = self.assembly.names
        #: Per-trial offsets of the start pose.
        self.starts = tuple(f"start_{word}" for word in self.plane.words[:3])
        self.parameters = (*coefficients(robot.multilink.coefficients), *self._start(), *self._view())
        self._at = {p.name: i for i, p in enumerate(self.parameters)}
        self._count = len(self.assembly.names)
        self._dynamic = [i for i, p in enumerate(self.parameters) if p.name not in (*VIEW, *self.starts)]
        self._servos = [_servo(axis, self.assembly.names) for axis in self.assembly.driven]
        self.channels = self._channels()
        self._kept: dict[str, OrderedDict[bytes, Trajectory]] = {}
        self._tables: dict[tuple[Any, ...], Array] = {}
        self._motions: dict[tuple[Any, ...], list[drive.Motion]] = {}
        self._grids: dict[str, tuple[Array, tuple[float, float, int]]] = {}
        self._lock = threading.Lock()

    # -------------------------------------------------------- what it offers

    @property
    def body(self) -> PlanarBody:
        """Its links."""
        return PlanarBody(self)

    @property
    def axes(self) -> tuple[str, ...]:
        """Axes of the plane of motion; none where the base is held."""
        return tuple(name.removesuffix("_m") for name in self.pose[:2]) if self.free_base else ()

    def scales(self, trials: Sequence[Trial]) -> SwimmerScales:
        """Typical sizes of trials."""
        return SwimmerScales(self, trials)

    def origin(self, trial: Trial) -> dict[str, float]:
        """Pose at the first sample."""
        pose = trial.swim.posed()
        return dict(zip(self.pose, (float(p) for p in pose), strict=True))

    def commanded(self, trial: Trial) -> bool:
        """Whether a drive or a recorded command moves the joints, not their measured angles."""
        swim = trial.swim
        return swim.beat is not None if swim.joints is None else swim.commanded

    def commands(self, trial: Trial) -> Iterator[tuple[Array, Array, float]]:
        """What each driven joint is told to do."""
        time = np.arange(float(trial.time_s[0]), float(trial.time_s[-1]) + READ_S, READ_S)
        for number, axis in enumerate(self.assembly.driven):
            angle, rate, _ = joint_motion(axis, number, trial.swim, time, 0.0)
            yield time, angle, float(np.max(np.abs(rate)))

    def prepare(self, progress: Progress = silent) -> None:
        """Compile the kernels where that has not been done on this machine."""
        prepare(progress)

    def _start(self) -> list[Parameter]:
        inf, found = math.inf, []
        if self.assembly.free_base:
            for name, unit, scale, words in (
                ("surge", "m/s", 0.1, "surge at the first sample"),
                (self.plane.words[4], "m/s", 0.1, f"{self.plane.words[4]} at the first sample"),
                (f"{self.plane.words[2]}_rate", "rad/s", 0.5, f"{self.plane.words[5]} at the first sample"),
            ):
                found.append(Parameter(f"initial_{name}", unit, -inf, inf, 0.0, scale, False, True, words))
        for axis in self.assembly.passive:
            name = axis.joint.name
            found.append(
                Parameter(
                    f"initial_angle_{name}",
                    "rad",
                    -inf,
                    inf,
                    0.0,
                    0.1,
                    False,
                    True,
                    f"angle of {name} at the first sample",
                )
            )
            found.append(
                Parameter(
                    f"initial_rate_{name}",
                    "rad/s",
                    -inf,
                    inf,
                    0.0,
                    1.0,
                    False,
                    True,
                    f"rate of {name} at the first sample",
                )
            )
        found.append(
            Parameter(
                "drive_phase", "rad", -inf, inf, 0.0, 1.0, False, True, "phase of the beat at time zero"
            )
        )
        return found

    def _view(self) -> list[Parameter]:
        inf = math.inf
        words = self.plane.words
        view = [
            Parameter(
                self.starts[0],
                "m",
                -inf,
                inf,
                0.0,
                0.01,
                False,
                True,
                f"{words[0]} of the start against the first sample",
            ),
            Parameter(
                self.starts[1],
                "m",
                -inf,
                inf,
                0.0,
                0.01,
                False,
                True,
                f"{words[1]} of the start against the first sample",
            ),
            Parameter(
                self.starts[2],
                "rad",
                -inf,
                inf,
                0.0,
                0.05,
                False,
                True,
                f"{words[2]} of the start against the first sample",
            ),
            Parameter(
                "clock_offset", "s", -inf, inf, 0.0, 0.01, False, True, "the log's clock ahead of the drive's"
            ),
            Parameter(
                "camera_rotation",
                "rad",
                -inf,
                inf,
                0.0,
                0.02,
                False,
                True,
                "axes of the measured position against those of the heading",
            ),
        ]
        return view if self.assembly.free_base else [view[3]]

    def _channels(self) -> tuple[Channel, ...]:
        units = ("m", "m", "rad", "m/s", "m/s", "rad/s")
        found = []
        if self.assembly.free_base:
            names = (*self.plane.pose, *self.plane.velocity)
            found += [Channel(n, u, w) for n, u, w in zip(names, units, self.plane.words, strict=True)]
        joints = [*self.assembly.passive, *(a for a in self.assembly.driven)]
        for axis in sorted(joints, key=lambda a: a.column):
            found.append(Channel(axis.column, "rad", f"angle of {axis.joint.name}"))
        for axis in self.assembly.passive:
            column = axis.column.replace("_rad", "_rate_rad_s")
            found.append(Channel(column, "rad/s", f"rate of {axis.joint.name}"))
        return tuple(found)

    def opening(self, seen: Callable[[str, int], float | None]) -> dict[str, float | None]:
        """Velocities at the first sample, by parameter, as channels show them.

        Parameters
        ----------
        seen : callable
            Value (0) or rate (1) of a channel there; None where it does not tell.
        """
        names = [p.name for p in self._start()[:3]]
        found = {name: seen(column, 0) for name, column in zip(names, self.velocity, strict=True)}
        heading = seen(self.pose[2], 0)
        along, across, turn = (seen(column, 1) for column in self.pose)
        if heading is not None and along is not None and across is not None:
            c, s = math.cos(heading), math.sin(heading)
            moved = (c * along + s * across, c * across - s * along, turn)
            found = {n: v if found[n] is None else found[n] for n, v in zip(names, moved, strict=True)}
        return found

    def initial(self, measured: Collection[str]) -> list[str]:
        """The start velocities, angles and rates that these channels can tell: all."""
        return [p.name for p in self.parameters if p.name.startswith("initial_")]

    def check(self, values: Array) -> None:
        """Refuse coefficients that make masses no body has (:meth:`Assembly.check`)."""
        self.assembly.check(values[: self._count])

    def command(self, number: int, swim: SwimInput, time_s: Array, phase_rad: float) -> Array:
        """What a driven joint is told to do, rad."""
        return joint_motion(self.assembly.driven[number], number, swim, time_s, phase_rad)[0]

    # -------------------------------------------------------- simulation

    def trajectory(self, values: Array, trial: Trial, hooks: Hooks = NONE) -> Trajectory:
        """The run on its own step grid, from the world's origin; relative to the water where that flows.

        Parameters
        ----------
        values : ndarray, shape (len(self.parameters),)
        trial : Trial
        hooks : Hooks
        """
        values = self.of_trial(values, trial)
        placed = self._heading_matters() or hooks.force or hooks.flow
        dynamic = [*self._dynamic, *self._heading()] if placed else self._dynamic
        key = values[dynamic].tobytes() + hooks.key
        key = key + np.array(self._grid(values, trial, hooks)).tobytes()
        with self._lock:
            kept = self._kept.setdefault(trial.id, OrderedDict())
            if key in kept:
                kept.move_to_end(key)
                return kept[key]
        found = self._run(values, trial, hooks)
        with self._lock:
            kept[key] = found
            while len(kept) > KEPT:
                kept.popitem(last=False)
        return found

    def _heading_matters(self) -> bool:
        return self.assembly.world_forces and self.assembly.free_base

    def _heading(self) -> list[int]:
        return [self._at[n] for n in (self.starts[2],) if n in self._at]

    def _grid(self, values: Array, trial: Trial, hooks: Hooks = NONE) -> tuple[float, float, int]:
        """Begin, step and number of steps; a late clock asks for some beyond the last sample."""
        known = self._grids.get(trial.id)
        if known is None or known[0] is not trial.time_s:
            known = self._grids[trial.id] = (trial.time_s, grid(trial.time_s, self.max_step))
        begin, step, steps = known[1]
        late = min(max(-self._value(values, "clock_offset") - hooks.clock_s, 0.0), step * steps)
        return begin, step, steps + math.ceil(late / step)

    def _run(self, values: Array, trial: Trial, hooks: Hooks = NONE) -> Trajectory:
        begin, step, steps = self._grid(values, trial, hooks)
        table = self._table(values, trial, begin, step, steps, hooks)
        n = self.assembly.unknowns
        start = np.zeros(2 * n)
        body = self.robot.multilink
        assert body is not None
        if self.assembly.free_base:
            u, v, r = (values[self._at[p.name]] for p in self._start()[:3])
            a, b = body.reference.station_m, body.reference.offset_m
            start[n : n + 3] = u + r * b, v + r * a, r
            if hooks.flow:
                _, water = _flows(hooks, np.array([begin]))
                start[n : n + 2] -= _turned(
                    float(water[0, 0]), float(water[0, 1]), -self._start_heading(values, trial)
                )
            if self._heading_matters():
                start[2] = self._start_heading(values, trial)
        else:
            start[2] = math.radians(body.heading_deg)
        for k, axis in enumerate(self.assembly.passive):
            start[3 + k] = self._value(values, f"initial_angle_{axis.joint.name}")
            start[n + 3 + k] = self._value(values, f"initial_rate_{axis.joint.name}")
        tables = self.assembly.tables(values[: self._count])
        if hooks.tables:
            # a table without coefficients is the robot's own: an effect must not write into that
            own = {name: t.copy() if isinstance(t, np.ndarray) else t for name, t in tables.items()}
            tables = hooks.changed(own, "tables")
        if hooks.force:
            x, y, _ = trial.swim.posed()
            frame = (x, y, 0.0 if self._heading_matters() else self._start_heading(values, trial))
            at = (-body.reference.station_m, body.reference.offset_m)
            forced = engine.outside(hooks.force, frame, at, len(self.assembly.links))
        else:
            forced = None
        states, rates = engine.integrate(start, step, table, *tables.values(), forced, begin)
        return Trajectory(begin, step, states, rates, table[::2, :, :3])

    def _start_heading(self, values: Array, trial: Trial) -> float:
        pose = trial.swim.posed()
        return float(pose[2]) + self._value(values, self.starts[2])

    def _table(
        self, values: Array, trial: Trial, begin: float, step: float, steps: int, hooks: Hooks = NONE
    ) -> Array:
        if trial.swim.measured:
            hooks = NONE  # measured joints are what the actuators did
        phase = self._value(values, "drive_phase")
        servos = tuple(
            None
            if s is None
            else tuple(q.at(dict(zip(self.assembly.names, values, strict=False))) for q in s)
            for s in self._servos
        )
        key = (trial.id, begin, step, steps, phase, servos, hooks.command_key)
        kept = self._tables.get(key)
        if kept is not None:
            return kept
        half = begin + 0.5 * step * np.arange(2.0 * steps + 1.0)
        told = self._told(trial, begin, step, steps, phase)
        motions = []
        for k, (motion, servo) in enumerate(zip(told, servos, strict=True)):
            if servo is None:
                if hooks.command:
                    motion = drive.deviated(motion, hooks.actuated(half, motion[0], k), 0.5 * step)
                motions.append(motion)
                continue
            fine = begin + 0.25 * step * np.arange(4.0 * steps + 1.0)
            command = hooks.actuated(fine, motion[0], k)
            omega, damping = 2 * math.pi * servo[0], servo[1]
            answer = drive.servo(np.ascontiguousarray(command), 0.5 * step, omega, damping)
            motions.append((answer[:, 0], answer[:, 1], answer[:, 2]))
        mounts = [math.radians(a.joint.mount_deg) for a in self.assembly.driven]
        found = drive.table(len(half), motions, mounts)
        with self._lock:
            _keep(self._tables, key, found, TABLES)
        return found

    def _told(self, trial: Trial, begin: float, step: float, steps: int, phase: float) -> list[drive.Motion]:
        """What each driven joint is told to do, at every half step; where a servo follows, every quarter."""
        key = (trial.id, begin, step, steps, phase)
        kept = self._motions.get(key)
        if kept is not None:
            return kept
        found = []
        for k, (axis, servo) in enumerate(zip(self.assembly.driven, self._servos, strict=True)):
            part = 0.5 if servo is None else 0.25
            time = begin + part * step * np.arange(steps / part + 1.0)
            found.append(joint_motion(axis, k, trial.swim, time, phase))
        with self._lock:
            _keep(self._motions, key, found, KEPT)
        return found

    def simulate(self, values: Array, trial: Trial) -> dict[str, Array]:
        """Pose, velocity and joint angles at the trial's samples (see :meth:`Model.simulate`)."""
        return self.hooked(values, trial, NONE)

    def hooked(self, values: Array, trial: Trial, hooks: Hooks) -> dict[str, Array]:
        """The same with what else acts on the chain (see :meth:`Model.hooked`)."""
        run = self.trajectory(values, trial, hooks)
        time = trial.time_s - self._value(values, "clock_offset") - hooks.clock_s
        states, _ = engine.sampled(time, run.begin_s, run.step_s, run.states, run.rates)
        n = self.assembly.unknowns
        found: dict[str, Array] = {}
        if self.assembly.free_base:
            found.update(self._seen(values, trial, states))
            if hooks.flow:
                self._carried(found, hooks, run.begin_s, time)
        for k, axis in enumerate(self.assembly.passive):
            found[axis.column] = states[:, 3 + k]
            found[axis.column.replace("_rad", "_rate_rad_s")] = states[:, n + 3 + k]
        if self.assembly.driven:
            driven, _ = engine.sampled(
                time,
                run.begin_s,
                run.step_s,
                np.ascontiguousarray(run.driven[:, :, 0]),
                np.ascontiguousarray(run.driven[:, :, 1]),
            )
            for k, axis in enumerate(self.assembly.driven):
                found[axis.column] = driven[:, k]
        return hooks.seen(found, trial.time_s) if hooks.output else found

    def _carried(self, found: dict[str, Array], hooks: Hooks, begin_s: float, time_s: Array) -> None:
        """Add the water's own motion to what was simulated relative to it."""
        start, _ = _flows(hooks, np.array([begin_s]))
        moved, speed = _flows(hooks, time_s)
        x, y, heading = self.plane.pose
        found[x] = found[x] + moved[:, 0] - start[0, 0]
        found[y] = found[y] + moved[:, 1] - start[0, 1]
        u, v = _turned(speed[:, 0], speed[:, 1], -found[heading])
        along, across, _ = self.plane.velocity
        found[along], found[across] = found[along] + u, found[across] + v

    def _seen(self, values: Array, trial: Trial, states: Array) -> dict[str, Array]:
        """Pose and velocity of the reference point, in the camera's axes."""
        body = self.robot.multilink
        assert body is not None
        n = self.assembly.unknowns
        a, b = -body.reference.station_m, body.reference.offset_m
        pose = trial.swim.posed()
        offsets = [self._value(values, name) for name in self.starts]
        theta = states[:, 2]
        c, s = np.cos(theta), np.sin(theta)
        x = states[:, 0] + a * c - b * s
        y = states[:, 1] + a * s + b * c
        u, v, r = states[:, n], states[:, n + 1], states[:, n + 2]
        # the run starts at the origin, along x unless the world's axes matter
        heading = 0.0 if self._heading_matters() else float(pose[2]) + offsets[2]
        spin = heading + self._value(values, "camera_rotation")
        along, across = math.cos(spin), math.sin(spin)
        dx, dy = x - x[0], y - y[0]
        names, rates = self.plane.pose, self.plane.velocity
        return {
            names[0]: float(pose[0]) + offsets[0] + along * dx - across * dy,
            names[1]: float(pose[1]) + offsets[1] + across * dx + along * dy,
            names[2]: theta + heading,
            rates[0]: u - r * b,
            rates[1]: v + r * a,
            rates[2]: r,
        }


def _flows(hooks: Hooks, time_s: Array) -> tuple[Array, Array]:
    """Displacement and velocity of the water in the world, shape (n, 2) each."""
    parts = [flow(time_s) for flow in hooks.flow]
    return np.asarray(sum(p[0] for p in parts)), np.asarray(sum(p[1] for p in parts))


def _turned(x: Array | float, y: Array | float, angle: Array | float) -> Array:
    """A vector turned by an angle, shape (2, n)."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([c * x - s * y, s * x + c * y])


#: Parameters that change how a run is seen, not the run itself; so do the offsets of the start pose.
VIEW = ("clock_offset", "camera_rotation")


def _keep(kept: dict[tuple[Any, ...], Any], key: tuple[Any, ...], found: Any, most: int) -> None:
    """Keep something of a trial, whose id begins the key, and the latest others of that trial."""
    for old in [k for k in kept if k[0] == key[0]][: 1 - most or None]:
        kept.pop(old, None)
    kept[key] = found


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


def joint_motion(axis: Axis, number: int, swim: SwimInput, time_s: Array, phase_rad: float) -> drive.Motion:
    """What a driven joint is told to do: its share of the beat, or its measured angle."""
    if swim.joints is not None:
        return swim.joints[number](time_s)
    law = axis.joint.driven
    assert law is not None
    beat = swim.beat
    if beat is None:
        zero = np.zeros_like(time_s)
        return zero, zero, zero
    bias_gain = law.gain if law.bias_gain is None else law.bias_gain
    lag = math.radians(law.phase_lag_deg)
    moved: drive.Motion = beat.motion(
        time_s, gain=law.gain, bias_gain=bias_gain, phase_rad=phase_rad - lag, cell_s=drive.cells(time_s)
    )
    return moved


def _servo(axis: Axis, names: list[str]) -> tuple[Polynomial, Polynomial] | None:
    law = axis.joint.driven
    if law is None or law.servo is None:
        return None
    return Polynomial.of(law.servo.natural_frequency_hz), Polynomial.of(law.servo.damping_ratio)


def prepare(progress: Progress) -> None:
    """Compile the kernels where that has not been done on this machine, under a bar that says so."""
    line = engine.integrate.py_func.__code__.co_firstlineno
    cache = Path(engine.integrate.stats.cache_path)
    if engine.integrate.signatures or any(cache.glob(f"engine.integrate-{line}.*.nbi")):
        return
    with progress("compiling the simulation (on first use only)"):
        warm_up()


def warm_up() -> None:
    """Compile the kernels."""
    from swimid.robots import file as robot_format

    model = MultilinkModel(robot_format.read("tfish"))
    time = np.linspace(0.0, 0.1, 6)
    beat = drive.Beat("a-cpg", 1.0, 0.3)
    model.simulate(
        np.array([p.start for p in model.parameters]), Trial("warm", "fit", time, {}, swim=SwimInput(beat))
    )
    drive.servo(np.zeros(5), 0.1, 1.0, 1.0)
    drive.measured(np.arange(6.0), np.zeros(6))
    engine.sampled(np.array([0.0101]), 0.0, 0.005, np.zeros((3, 1)), np.zeros((3, 1)))
