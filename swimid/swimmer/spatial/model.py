"""The robot in space as a model: parameters in, channels out."""

from __future__ import annotations

import math
import threading
from collections import OrderedDict
from collections.abc import Callable, Collection
from typing import Any, Protocol

import numpy as np
from scipy.spatial.transform import Rotation

from swimid.fitting.hooks import NONE, Hooks
from swimid.fitting.inputs import SwimInput
from swimid.fitting.model import Array, Channel, Parameter, Trial
from swimid.fitting.swimmer import Swimmer
from swimid.logs.rotation import angles, from_angles
from swimid.robots.file import Robot
from swimid.robots.spatial import Hydrostatics
from swimid.swimmer.planar import drive
from swimid.swimmer.planar.engine import sampled
from swimid.swimmer.planar.model import DEFAULT_STEP, KEPT, grid
from swimid.swimmer.polynomial import Polynomial
from swimid.swimmer.spatial import engine
from swimid.swimmer.spatial.assembly import Assembly, Axis
from swimid.swimmer.spatial.planar import Lifted
from swimid.swimmer.spatial.stroke import Cycle
from swimid.swimmer.tree import coefficients

#: Pose and velocity of the reference point, as logs hold them.
POSE = ("x_m", "y_m", "z_m", "roll_rad", "pitch_rad", "yaw_rad")
VELOCITY = ("u_m_s", "v_m_s", "w_m_s", "roll_rate_rad_s", "pitch_rate_rad_s", "yaw_rate_rad_s")
WORDS = ("x", "y", "z", "roll", "pitch", "yaw")
RATES = ("surge", "sway", "heave", "roll_rate", "pitch_rate", "yaw_rate")
#: Signs of roll, pitch (nose up) and yaw against rotation about x, y and z.
SIGNS = np.array([1.0, -1.0, 1.0])


class Tree(Protocol):
    """What the model asks of a robot's tables."""

    names: list[str]
    driven: list[Axis]
    passive: list[Axis]
    free_base: bool
    links: int
    reference: Array

    def tables(self, values: Array) -> dict[str, Any]:
        """The arguments of :func:`engine.integrate` from ``topology`` on, by their names."""
        ...

    def check(self, values: Array) -> None:
        """Refuse masses and inertias that no body has."""
        ...


class MultibodyModel(Swimmer):
    """A robot with links in space (:mod:`swimid.swimmer.spatial.engine`).

    What is known of a trial is its :attr:`Trial.swim`. A robot of a
    planar file moves in space as in its plane.

    Parameters
    ----------
    robot : Robot
        With a ``multibody`` or a ``multilink`` part.
    max_step : float, s
        Each sampling interval is cut into equal steps no longer than this.
    """

    name = "multibody"
    offers = frozenset({"command", "tables", "output", "clock"})
    in_space = True

    def __init__(self, robot: Robot, *, max_step: float = DEFAULT_STEP) -> None:
        self.robot = robot
        self.max_step = max_step
        self.tree: Tree
        if robot.multibody is not None:
            self.tree = Assembly(robot.multibody, robot.fluid)
            known = robot.multibody.coefficients
        else:
            assert robot.multilink is not None
            self.tree = Lifted(robot.multilink, robot.fluid)
            known = robot.multilink.coefficients
        self.pose, self.velocity = POSE, VELOCITY
        self.driven, self.passive = self.tree.driven, self.tree.passive
        self.free_base = self.tree.free_base
        self.coefficients = self.tree.names
        #: Per-trial offsets of the start pose.
        self.starts = tuple(f"start_{word}" for word in WORDS)
        self.parameters = (*coefficients(known), *self._start(), *self._view())
        self._at = {p.name: i for i, p in enumerate(self.parameters)}
        self._count = len(self.tree.names)
        self._dynamic = [i for i, p in enumerate(self.parameters) if p.name not in self._seen_only()]
        self._servos = [_servo(axis) for axis in self.tree.driven]
        self.channels = self._channels()
        self._kept: dict[str, OrderedDict[bytes, tuple[Any, ...]]] = {}
        self._moved: dict[str, tuple[tuple[float, ...], Array]] = {}
        self._lock = threading.Lock()

    # -------------------------------------------------------- what it offers

    def _start(self) -> list[Parameter]:
        found = []
        if self.tree.free_base:
            for name, column in zip(RATES, VELOCITY, strict=True):
                unit, scale = ("m/s", 0.1) if column.endswith("_m_s") else ("rad/s", 0.5)
                words = f"{name.replace('_', ' ')} at the first sample"
                found.append(_own(f"initial_{name}", unit, scale, words))
        for axis in self.tree.passive:
            found.append(
                _own(f"initial_angle_{axis.name}", "rad", 0.1, f"angle of {axis.name} at the first sample")
            )
            found.append(
                _own(f"initial_rate_{axis.name}", "rad/s", 1.0, f"rate of {axis.name} at the first sample")
            )
        found.append(_own("drive_phase", "rad", 1.0, "phase of the beat at time zero"))
        return found

    def _view(self) -> list[Parameter]:
        found = []
        if self.tree.free_base:
            for name, word, column in zip(self.starts, WORDS, POSE, strict=True):
                unit, scale = ("m", 0.01) if column.endswith("_m") else ("rad", 0.05)
                found.append(_own(name, unit, scale, f"{word} of the start against the first sample"))
        found.append(_own("clock_offset", "s", 0.01, "the log's clock ahead of the drive's"))
        return found

    def _seen_only(self) -> tuple[str, ...]:
        """What only changes how a run is seen: the run itself begins over the origin, heading along x."""
        return ("clock_offset", "start_x", "start_y", "start_yaw")

    def _channels(self) -> tuple[Channel, ...]:
        found = []
        if self.tree.free_base:
            for names, words in ((POSE, WORDS), (VELOCITY, RATES)):
                for name, word in zip(names, words, strict=True):
                    unit = name.split("_", 1)[1].replace("rate_rad_s", "rad/s").replace("_", "/")
                    found.append(Channel(name, unit, word.replace("_", " ")))
        for axis in sorted([*self.tree.passive, *self.tree.driven], key=lambda a: (len(a.column), a.column)):
            found.append(Channel(axis.column, "rad", f"angle of {axis.name}"))
        for axis in self.tree.passive:
            found.append(Channel(axis.column.replace("_rad", "_rate_rad_s"), "rad/s", f"rate of {axis.name}"))
        return tuple(found)

    def opening(self, seen: Callable[[str, int], float | None]) -> dict[str, float | None]:
        """Velocities at the first sample, by parameter, as channels show them; still where none does.

        Parameters
        ----------
        seen : callable
            Value (0) or rate (1) of a channel there; None where it does not tell.
        """
        names = [f"initial_{name}" for name in RATES]
        found = {name: seen(column, 0) for name, column in zip(names, VELOCITY, strict=True)}
        turned = [seen(column, 0) or 0.0 for column in POSE[3:]]
        rates = [seen(column, 1) for column in POSE]
        if any(r is not None for r in rates[:3]):
            body = from_angles(*([a] for a in turned))[0].inv().apply([r or 0.0 for r in rates[:3]])
            # rates of the angles stand for those about the axes: at the start the body is nearly level
            moved = [*(float(v) for v in body), *rates[3:]]
            found = {n: v if found[n] is None else found[n] for n, v in zip(names, moved, strict=True)}
        return found

    def initial(self, measured: Collection[str]) -> list[str]:
        """The start velocities, angles and rates that channels can tell: of a side view, in its plane."""
        blind = [
            f"initial_{name}"
            for name, place, speed in zip(RATES, POSE, VELOCITY, strict=True)
            if place not in measured and speed not in measured
        ]
        return [p.name for p in self.parameters if p.name.startswith("initial_") and p.name not in blind]

    def check(self, values: Array) -> None:
        """Refuse coefficients that make masses no body has."""
        self.tree.check(values[: self._count])

    def command(self, number: int, swim: SwimInput, time_s: Array, phase_rad: float) -> Array:
        """What a driven hinge is told to do, rad."""
        return hinge_motion(self.tree.driven[number], number, swim, time_s, phase_rad)[0]

    def with_buoyancy(self, factor: float) -> MultibodyModel | None:
        """The same model with every volume that displaces water multiplied; None where none does."""
        body = self.robot.multibody
        if body is None or not any(isinstance(e, Hydrostatics) and e.volume_m3 for e in body.elements):
            return None
        elements = [
            e.model_copy(update={"volume_m3": _times(factor, e.volume_m3)})
            if isinstance(e, Hydrostatics)
            else e
            for e in body.elements
        ]
        changed = body.model_copy(update={"elements": elements})
        other = MultibodyModel(self.robot.model_copy(update={"multibody": changed}), max_step=self.max_step)
        other.parameters = self.parameters
        return other

    # -------------------------------------------------------- simulation

    def _posed(self, values: Array, trial: Trial) -> Array:
        """Pose of the reference point at the first sample, shape (6,)."""
        pose = np.array(trial.swim.posed(6), dtype=float)
        return pose + [self._value(values, name) for name in self.starts]

    def simulate(self, values: Array, trial: Trial) -> dict[str, Array]:
        """Pose, velocity and joint angles at the trial's samples (see :meth:`Model.simulate`)."""
        return self.hooked(values, trial, NONE)

    def hooked(self, values: Array, trial: Trial, hooks: Hooks) -> dict[str, Array]:
        """The same with what else acts on the chain (see :meth:`Model.hooked`)."""
        values = self.of_trial(values, trial)
        begin, step, states, rates, table = self._run(values, trial, hooks)
        time = trial.time_s - self._value(values, "clock_offset") - hooks.clock_s
        seen, _ = sampled(time, begin, step, states, rates)
        passives = len(self.tree.passive)
        found: dict[str, Array] = {}
        if self.tree.free_base:
            found.update(self._seen(values, trial, seen))
        for k, axis in enumerate(self.tree.passive):
            found[axis.column] = seen[:, 7 + k]
            found[axis.column.replace("_rad", "_rate_rad_s")] = seen[:, 13 + passives + k]
        if self.tree.driven:
            driven, _ = sampled(
                time,
                begin,
                step,
                np.ascontiguousarray(table[::2, :, 0]),
                np.ascontiguousarray(table[::2, :, 1]),
            )
            for k, axis in enumerate(self.tree.driven):
                found[axis.column] = driven[:, k]
        return hooks.seen(found, trial.time_s) if hooks.output else found

    def _run(self, values: Array, trial: Trial, hooks: Hooks) -> tuple[Any, ...]:
        """Begin, step, states, rates and joint table of a run; what was run last is kept."""
        begin, step, steps = grid(trial.time_s, self.max_step)
        late = min(max(-self._value(values, "clock_offset") - hooks.clock_s, 0.0), step * steps)
        steps += math.ceil(late / step)
        key = values[self._dynamic].tobytes() + hooks.key + np.array((begin, step, steps)).tobytes()
        with self._lock:
            kept = self._kept.setdefault(trial.id, OrderedDict())
            if key in kept:
                kept.move_to_end(key)
                return kept[key]
        table = self._hinges(values, trial, begin, step, steps, hooks)
        tables = self.tree.tables(values[: self._count])
        if hooks.tables:
            own = {name: t.copy() if isinstance(t, np.ndarray) else t for name, t in tables.items()}
            tables = hooks.changed(own, "tables")
        start = self._started(values, trial)
        states, rates = engine.integrate(start, step, table, *tables.values())
        with self._lock:
            kept[key] = (begin, step, states, rates, table)
            while len(kept) > KEPT:
                kept.popitem(last=False)
            return kept[key]

    def _started(self, values: Array, trial: Trial) -> Array:
        passives = len(self.tree.passive)
        start = np.zeros(13 + 2 * passives)
        start[3] = 1.0
        if self.tree.free_base:
            _, _, z, roll, pitch, _ = self._posed(values, trial)
            turn = from_angles([roll], [pitch], [0.0])[0]
            place = -turn.apply(self.tree.reference)
            start[2] = z + place[2]
            start[3:7] = np.roll(turn.as_quat(), 1)
            speed = np.array([self._value(values, f"initial_{name}") for name in RATES])
            spin = speed[3:] * SIGNS
            start[7 + passives : 10 + passives] = speed[:3] - np.cross(spin, self.tree.reference)
            start[10 + passives : 13 + passives] = spin
        for k, axis in enumerate(self.tree.passive):
            start[7 + k] = self._value(values, f"initial_angle_{axis.name}")
            start[13 + passives + k] = self._value(values, f"initial_rate_{axis.name}")
        return start

    def _hinges(
        self, values: Array, trial: Trial, begin: float, step: float, steps: int, hooks: Hooks
    ) -> Array:
        """The driven hinges on the half-step grid; kept, since no coefficient but a servo's moves them."""
        if hooks.command or any(servo is not None for servo in self._servos):
            return self._table(values, trial, begin, step, steps, hooks)
        key = (begin, step, steps, self._value(values, "drive_phase"))
        with self._lock:
            known = self._moved.get(trial.id)
        if known is None or known[0] != key:
            known = key, self._table(values, trial, begin, step, steps, hooks)
            with self._lock:
                self._moved[trial.id] = known
        return known[1]

    def _table(
        self, values: Array, trial: Trial, begin: float, step: float, steps: int, hooks: Hooks
    ) -> Array:
        if trial.swim.measured:
            hooks = NONE  # measured joints are what the actuators did
        phase = self._value(values, "drive_phase")
        known = dict(zip(self.tree.names, values, strict=False))
        half = begin + 0.5 * step * np.arange(2.0 * steps + 1.0)
        motions = []
        for k, (axis, servo) in enumerate(zip(self.tree.driven, self._servos, strict=True)):
            if servo is None:
                motion = hinge_motion(axis, k, trial.swim, half, phase)
                if hooks.command:
                    motion = drive.deviated(motion, hooks.actuated(half, motion[0], k), 0.5 * step)
                motions.append(motion)
                continue
            fine = begin + 0.25 * step * np.arange(4.0 * steps + 1.0)
            command = hooks.actuated(fine, hinge_motion(axis, k, trial.swim, fine, phase)[0], k)
            omega, damping = 2 * math.pi * servo[0].at(known), servo[1].at(known)
            answer = drive.servo(np.ascontiguousarray(command), 0.5 * step, omega, damping)
            motions.append((answer[:, 0], answer[:, 1], answer[:, 2]))
        return drive.table(len(half), motions, [0.0] * len(motions))

    def _seen(self, values: Array, trial: Trial, states: Array) -> dict[str, Array]:
        """Pose and velocity of the reference point."""
        passives = len(self.tree.passive)
        turn = Rotation.from_quat(_sound(states[:, [4, 5, 6, 3]]))
        place = states[:, :3] + turn.apply(self.tree.reference)
        x, y, _, _, _, yaw = self._posed(values, trial)
        c, s = math.cos(yaw), math.sin(yaw)
        dx, dy = place[:, 0] - place[0, 0], place[:, 1] - place[0, 1]
        spin = states[:, 10 + passives : 13 + passives]
        velocity = states[:, 7 + passives : 10 + passives] + np.cross(spin, self.tree.reference)
        broken = ~np.isfinite(states[:, 3])
        roll, pitch, heading = (np.where(broken, np.nan, a) for a in angles(turn))
        pose = (x + c * dx - s * dy, y + s * dx + c * dy, place[:, 2], roll, pitch, heading + yaw)
        return dict(zip((*POSE, *VELOCITY), (*pose, *velocity.T, *(spin * SIGNS).T), strict=True))


def hinge_motion(axis: Axis, number: int, swim: SwimInput, time_s: Array, phase_rad: float) -> drive.Motion:
    """What a driven hinge is told to do: a measured angle, its part of the stroke, its share of the beat."""
    if swim.joints is not None:
        return swim.joints[number](time_s)
    law = axis.driven
    assert law is not None
    lag = math.radians(law.phase_lag_deg)
    stroke: Cycle | None = swim.stroke
    if stroke is not None:
        return stroke.motion(axis.name, time_s, phase_rad=phase_rad - lag)
    beat: drive.Beat | None = swim.beat
    if beat is None:
        zero = np.zeros_like(time_s)
        return zero, zero, zero
    bias_gain = law.gain if law.bias_gain is None else law.bias_gain
    return beat.motion(
        time_s, gain=law.gain, bias_gain=bias_gain, phase_rad=phase_rad - lag, cell_s=drive.cells(time_s)
    )


def _times(factor: float, quantity: float | str) -> float | str:
    """A quantity of a robot file, multiplied."""
    return f"{factor!r} * {quantity}" if isinstance(quantity, str) else factor * quantity


def _own(name: str, unit: str, scale: float, meaning: str) -> Parameter:
    return Parameter(name, unit, -math.inf, math.inf, 0.0, scale, False, True, meaning)


def _servo(axis: Axis) -> tuple[Polynomial, Polynomial] | None:
    law = axis.driven
    if law is None or law.servo is None:
        return None
    return Polynomial.of(law.servo.natural_frequency_hz), Polynomial.of(law.servo.damping_ratio)


def _sound(quaternions: Array) -> Array:
    """Quaternions with those of a broken run replaced by none at all."""
    broken = ~np.isfinite(quaternions).all(axis=1, keepdims=True)
    return np.where(broken, [0.0, 0.0, 0.0, 1.0], quaternions)
