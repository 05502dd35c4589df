"""Model of a file of MuJoCo: its attributes are parameters, its controls are inputs, its sensors outputs."""

from __future__ import annotations

import copy
import functools
import math
import multiprocessing
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from swimid.errors import InputError, UsageError, suggestion
from swimid.fitting.model import Array, Hooks, Model, Parameter, Request, Scales, Trial
from swimid.simulators.model import SimulatorModel

#: Number of simulations that are in memory at once.
MAX_BATCH = 32
#: Number of samples from which the initial velocity of a trial is estimated.
FIRST_SAMPLES = 8
#: Slope of a channel over its first samples, divided by its standard error, above which a trial begins in
#: motion.
MOVES = 5.0
#: Relative size of the derivatives of the measured outputs with respect to a start offset (the displacement
#: of a joint at the first sample), compared with the largest ones, below which the offset is held at zero.
NO_EFFECT = 1e-4
#: Types of the joints that have one coordinate, in MuJoCo.
SLIDE, HINGE = 2, 3
#: Names of the degrees of freedom of free and ball joints.
FREE = ("x_m", "y_m", "z_m", "roll_rad", "pitch_rad", "yaw_rad")
BALL = ("roll_rad", "pitch_rad", "yaw_rad")


@dataclass(frozen=True)
class ArrayEntries:
    """Entries of an array of a compiled model that an attribute of the file sets.

    Attributes
    ----------
    field : str
            Name of the array in ``MjModel``. The name of an array of the options begins with ``opt.``.
    index : tuple
    factor : float
            Factor by which the value of the attribute is multiplied to give the entry.
    """

    field: str
    index: tuple[Any, ...]
    factor: float = 1.0


@dataclass(frozen=True)
class Attribute:
    """Attribute of a file of MuJoCo that is a parameter.

    Attributes
    ----------
    path : str
            Kind of element, name of the element, and name of the attribute: ``joint/tail/stiffness``.
    places : tuple of ArrayEntries
            Array entries that the attribute sets. The first entry has the value of the attribute.
    unit : str
    inertia_of : int or None
            Index of the body whose inertia is scaled with its mass; None if the attribute is no such mass.
    """

    path: str
    places: tuple[ArrayEntries, ...]
    unit: str
    inertia_of: int | None = None


#: Units of the attributes of joints and tendons, for a coordinate in m and in rad.
UNITS = {
    "stiffness": ("N/m", "N m/rad"),
    "damping": ("N s/m", "N m s/rad"),
    "armature": ("kg", "kg m^2"),
    "frictionloss": ("N", "N m"),
    "springref": ("m", "rad"),
}
#: Attributes that can be parameters, by kind of element and name: array of the compiled model, column of the
#: array (None if it has one), and unit. ``[i]`` stands for a component.
ATTRIBUTES: dict[str, dict[str, tuple[str, int | None, str]]] = {
    "body": {
        "mass": ("body_mass", None, "kg"),
        "gravcomp": ("body_gravcomp", None, "1"),
        "ipos": ("body_ipos", 0, "m"),
        "inertia": ("body_inertia", 0, "kg m^2"),
        "pos": ("body_pos", 0, "m"),
    },
    "geom": {
        "fluidcoef": ("geom_fluid", 1, "1"),
        "friction": ("geom_friction", 0, "1"),
        "margin": ("geom_margin", None, "m"),
    },
    "site": {"pos": ("site_pos", 0, "m")},
    "actuator": {
        "gainprm": ("actuator_gainprm", 0, "1"),
        "biasprm": ("actuator_biasprm", 0, "1"),
        "dynprm": ("actuator_dynprm", 0, "1"),
        "timeconst": ("actuator_dynprm", None, "s"),
        "gear": ("actuator_gear", 0, "1"),
    },
    "tendon": {
        "stiffness": ("tendon_stiffness", None, "N/m"),
        "damping": ("tendon_damping", None, "N s/m"),
        "frictionloss": ("tendon_frictionloss", None, "N"),
        "armature": ("tendon_armature", None, "kg"),
        "springlength": ("tendon_lengthspring", 0, "m"),
    },
    "option": {
        "density": ("opt.density", None, "kg/m^3"),
        "viscosity": ("opt.viscosity", None, "Pa s"),
        "wind": ("opt.wind", 0, "m/s"),
        "gravity": ("opt.gravity", 0, "m/s^2"),
    },
}
#: Array of the compiled model that holds an attribute of a joint, by name of the attribute. An array ``jnt_``
#: has one entry for each joint, ``dof_`` for each degree of freedom, and ``qpos_`` for each coordinate.
JOINT_ARRAYS = {
    "stiffness": "jnt_stiffness",
    "damping": "dof_damping",
    "armature": "dof_armature",
    "frictionloss": "dof_frictionloss",
    "springref": "qpos_spring",
}


class SensorOutput(NamedTuple):
    """Output of a model of MuJoCo: entries of the sensor data, and their meaning.

    Attributes
    ----------
    first, size : int
            Index of the first entry in ``sensordata``, and number of entries.
    part : str
            Component that is the output: ``x``, ``y``, ``z`` or ``value`` for one of the entries; ``roll``,
            ``pitch`` or ``yaw`` for an angle of the quaternion in the entries.
    place : bool
            Whether the output depends on the joint coordinates alone, and not on velocities.
    """

    first: int
    size: int
    part: str
    place: bool

    def of(self, data: Array) -> Array:
        """Return the output from sensor data whose last axis has the entries of ``sensordata``."""
        part = data[..., self.first : self.first + self.size]
        if self.part in ("x", "y", "z"):
            return np.asarray(part[..., "xyz".index(self.part)])
        if self.part == "value":
            return np.asarray(part[..., 0])
        w, x, y, z = np.moveaxis(part, -1, 0)
        if self.part == "roll":
            return np.asarray(np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)))
        if self.part == "pitch":
            return np.asarray(np.arcsin(np.clip(2 * (w * y - z * x), -1, 1)))
        return np.asarray(np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)))

    @property
    def turns(self) -> bool:
        """Whether the output is an angle that repeats after a turn."""
        return self.part in ("roll", "yaw")


class Fields(dict[str, Any]):
    """Arrays of a compiled model by name, copied when they are first read, so that effects change copies."""

    def __init__(self, compiled: Any) -> None:
        super().__init__()
        self._compiled = compiled

    def __missing__(self, name: str) -> Array:
        self[name] = base_array(self._compiled, name).copy()
        return np.asarray(self[name])


def base_array(compiled: Any, name: str) -> Array:
    """Return an array of a compiled model, or of its options (``opt.density``), as a NumPy array."""
    holder, _, field = name.rpartition(".")
    return np.atleast_1d(
        np.asarray(getattr(getattr(compiled, holder) if holder else compiled, field), dtype=float)
    )


@functools.cache
def mujoco() -> Any:
    """Return the module of MuJoCo.

    Raises
    ------
    UsageError
            If MuJoCo is not installed.
    """
    try:
        import mujoco as module
        import mujoco.batch
    except ImportError as error:
        raise UsageError("models of MuJoCo need mujoco", hint="pip install 'swimid[mujoco]'") from error
    # a simulation that diverges is stated in the result, and not by MuJoCo on the terminal
    module.set_mju_user_warning(lambda text: None)
    return module


def read_spec(path: Path) -> Any:
    """Return the specification of a file in MJCF or URDF.

    Raises
    ------
    InputError
        If the file does not exist, or MuJoCo cannot read it.
    """
    if not path.is_file():
        raise InputError("there is no such file", file=path, hint="check the path")
    try:
        return mujoco().MjSpec.from_file(str(path))
    except (ValueError, RuntimeError) as error:
        text = str(error).strip().replace("\n", " ")
        line = re.search(r"line (\d+)", text)
        raise InputError(f"MuJoCo cannot read it: {text}", file=path, line=line and int(line[1])) from error


def compile_spec(spec: Any, path: Path) -> Any:
    """Return the compiled model of a specification.

    Raises
    ------
    InputError
            If MuJoCo cannot compile the specification.
    """
    try:
        return spec.compile()
    except ValueError as error:
        raise InputError(f"MuJoCo cannot compile it: {error}", file=path) from error


class MjcfModel(SimulatorModel):
    """Model of a file of MuJoCo, which is simulated in batches.

    The time step and the integrator are those of the file.

    Parameters
    ----------
    path : Path
        File in MJCF or URDF.
    parameters : mapping of name to (Parameter, path, bool)
            Parameters by name, each with the path of its attribute, and whether the inertia of a body is
            scaled with its mass.
    inputs : mapping of str to str
            Column of the log that drives each actuator, by name of the actuator.
    outputs : mapping of str to str
            Path of the output in the file, by name of the channel: ``site/led/x``, ``body/head/yaw``,
            ``joint/tail``, ``joint/tail/rate`` or ``sensor/gyro/2``.
    keyframe : str, optional
        Keyframe from which trials start. By default they start from the reference configuration.

    Raises
    ------
    InputError
            If the file cannot be read, or lacks an element or attribute that is named.
    """

    name = "mjcf"
    file_ending = ".xml"

    def __init__(
        self,
        path: Path,
        parameters: Mapping[str, tuple[Any, str, bool]],
        inputs: Mapping[str, str],
        outputs: Mapping[str, str],
        keyframe: str | None = None,
    ) -> None:
        module = mujoco()
        self.path = path
        spec = read_spec(path)
        for body in spec.bodies:
            # the centre of mass of a body counts as fixed otherwise
            body.simple = False
        sensors = {channel: _add_sensor(spec, source, path) for channel, source in outputs.items()}
        self.compiled = compile_spec(spec, path)
        self.step_s = float(self.compiled.opt.timestep)
        self.outputs = {channel: _output(self.compiled, *sensor) for channel, sensor in sensors.items()}
        self.attributes: list[Attribute] = []
        made: list[Parameter] = []
        for name, (entry, place, scaled) in parameters.items():
            attribute = find_attribute(self.compiled, place, path, scale_inertia=scaled)
            first = attribute.places[0]
            entries = np.ravel(base_array(self.compiled, first.field)[first.index])
            start = float(entries[0]) / first.factor
            self.attributes.append(attribute)
            made.append(entry.to_parameter(name, start=start, unit=attribute.unit, source=attribute.path))
        self.actuators = [self._element("actuator", name) for name in inputs]
        self._key = -1 if keyframe is None else self._element("key", keyframe)
        data = module.MjData(self.compiled)
        module.mj_resetData(self.compiled, data)
        if self._key >= 0:
            module.mj_resetDataKeyframe(self.compiled, data, self._key)
        self._rest = data.qpos.copy(), data.qvel.copy(), data.ctrl.copy()
        joints = range(self.compiled.njnt)
        self.joint_names = [element_name(self.compiled, "joint", k) or f"joint{k}" for k in joints]
        self.dofs = _dofs(self.compiled, self.joint_names)
        super().__init__(made, tuple(inputs.values()), tuple(outputs))
        units = {name: "m" if name.endswith("_m") else "rad" for name in self.dofs}
        self.parameters += tuple(
            Parameter(
                f"{word}_{name}{end}", units[name] + per, -math.inf, math.inf, 0.0, scale, True, True, what
            )
            for word, end, per, scale, what in (
                ("start", "", "", 0.01, "offset of the start from the reference configuration"),
                ("initial", "_s", "/s", 0.1, "velocity at the first sample"),
            )
            for name in self.dofs
        )

    def _element(self, kind: str, name: str) -> int:
        return find_element(self.compiled, kind, name, self.path)

    # -------------------------------------------------------- interface of models

    def scales(self, trials: Sequence[Trial]) -> Scales:
        """Return the typical scales of the trials. The inertia is the mass of the moving bodies."""
        return _Scales(self, trials)

    @property
    def batch_size(self) -> int:
        """Number of simulations in a batch."""
        return MAX_BATCH

    def at_step(self, step_s: float) -> MjcfModel:
        """Return the model with another time step."""
        other = copy.copy(self)
        other.step_s = step_s
        return other

    def refine(self) -> Model | None:
        """Return None, because the time step is part of the user's model."""
        return None

    def simulate_hooked(self, values: Array, trial: Trial, hooks: Hooks) -> dict[str, Array]:
        """Simulate a trial (see :meth:`Model.simulate_hooked`)."""
        return self.simulate_many([(values, trial, hooks)])[0]

    def simulate_many(self, runs: Sequence[Request]) -> list[dict[str, Array]]:
        """Simulate several trials in batches (see :meth:`Model.simulate_many`)."""
        groups: dict[int, list[int]] = {}
        for k, (_, trial, hooks) in enumerate(runs):
            groups.setdefault(self._steps(trial, hooks), []).append(k)
        found: dict[int, dict[str, Array]] = {}
        for steps, members in groups.items():
            for first in range(0, len(members), MAX_BATCH):
                part = members[first : first + MAX_BATCH]
                found |= dict(zip(part, self._simulate_batch([runs[k] for k in part], steps), strict=True))
        return [found[k] for k in range(len(runs))]

    # -------------------------------------------------------- simulation

    def _steps(self, trial: Trial, hooks: Hooks) -> int:
        """Return the number of steps of a trial. If the clock of the log is late, more steps are needed."""
        last = max(float(trial.time_s[-1]), float(np.max(hooks.compute_event_times(trial.time_s[-1:]))))
        return math.ceil((last - float(trial.time_s[0])) / self.step_s - 1e-9) + 1

    def fields(self, values: Array, hooks: Hooks) -> Fields:
        """Return the arrays of the compiled model that parameters and effects change, by name."""
        found = Fields(self.compiled)
        for attribute, value in zip(self.attributes, values, strict=False):
            if attribute.inertia_of is not None:
                ratio = float(value) / float(found["body_mass"][attribute.inertia_of])
                found["body_inertia"][attribute.inertia_of] *= ratio
            for place in attribute.places:
                found[place.field][place.index] = place.factor * value
        hooks.change_values(found, "tables")
        return found

    def _simulate_batch(self, runs: Sequence[Request], steps: int) -> list[dict[str, Array]]:
        """Simulate runs with the same number of steps as one batch."""
        module = mujoco()
        batch = module.batch.Batch(self.compiled, len(runs), nthread=_threads())
        fields = [self.fields(values, hooks) for values, _, hooks in runs]
        for name in sorted({name for own in fields for name in own}):
            batch.expand(name).reshape(len(runs), -1)[:] = [own[name].ravel() for own in fields]
        if self.step_s != self.compiled.opt.timestep:
            batch.expand("opt.timestep")[:] = self.step_s
        batch.set_const()
        batch.reset(keyframe=self._key, stage=0)
        place, speed, control = (
            batch.bind("qpos"),
            batch.bind("qvel"),
            np.empty((len(runs), steps, self.compiled.nu)),
        )
        control[:] = self._rest[2]
        for k, (values, trial, hooks) in enumerate(runs):
            place[k], speed[k] = self._start(values)
            times: Array = float(trial.time_s[0]) + self.step_s * np.arange(float(steps))
            for number, (actuator, column) in enumerate(zip(self.actuators, self.columns, strict=True)):
                told: Array = np.array(np.interp(times, trial.time_s, trial.inputs[column]))
                control[k, :, actuator] = hooks.actuate(times, told, number)
        batch.forward(stage=0)
        clock = int(module.mjtState.mjSTATE_TIME)
        record = batch.rollout(steps, control, record=("sensordata", clock))
        return [
            self._read_outputs(record["sensordata"][k], record[clock][k, :, 0], trial, hooks)
            for k, (_, trial, hooks) in enumerate(runs)
        ]

    def _start(self, values: Array) -> tuple[Array, Array]:
        """Return the joint coordinates and the velocities of a model at the first sample of a trial."""
        first = len(self.attributes)
        offset, rate = (
            values[first : first + len(self.dofs)],
            values[first + len(self.dofs) :][: len(self.dofs)],
        )
        place = self._rest[0].copy()
        if offset.any():
            mujoco().mj_integratePos(self.compiled, place, np.ascontiguousarray(offset), 1.0)
        return place, self._rest[1] + rate

    def _read_outputs(self, data: Array, time: Array, trial: Trial, hooks: Hooks) -> dict[str, Array]:
        """Return the outputs at the samples of a trial from the sensor data of each step.

        The sensor data of a step belong to the state before this step.
        """
        begin = float(trial.time_s[0])
        grid = begin + self.step_s * np.arange(len(data))
        # a simulation that diverges stops, and its clock with it
        stopped = np.append(np.diff(time) <= 0.5 * self.step_s, False) | ~np.isfinite(data).all(axis=-1)
        at = np.clip(hooks.compute_event_times(trial.time_s), grid[0], grid[-1])
        found = {}
        for channel, output in self.outputs.items():
            series = output.of(data)
            if output.turns:
                series = np.unwrap(series) + _turns(series[0], trial.measured.get(channel))
            if stopped.any():
                series = np.where(np.logical_or.accumulate(stopped), np.nan, series)
            found[channel] = np.interp(at, grid, series)
        return hooks.sense(found, trial.time_s) if hooks.output else found

    # -------------------------------------------------------- start of a trial

    def set_start(self, trial: Trial, state: str = "auto") -> Trial:
        """Return a trial with the initial displacements and velocities of the joints that its log shows.

        Parameters
        ----------
        state : str
            With ``rest``, the trial starts at rest. With ``estimate``, the initial velocities are estimated
            as well. With ``auto``, they are estimated if the robot moves during the first samples.

        Notes
        -----
        The displacements give the simulated outputs their first measured values. Displacements that no
        measured output shows are held at zero.
        """
        first = {c: _first(trial.time_s, trial.measured[c]) for c in self.outputs if c in trial.measured}
        shown = {c: v for c, v in first.items() if v is not None and self.outputs[c].place}
        names = [p.name for p in self.parameters[len(self.attributes) :]]
        if not shown:
            return replace(trial, held=tuple(names))
        target, rates, errors = np.array(list(shown.values())).T
        pose = _StartPose(self, [self.outputs[channel] for channel in shown])
        from scipy.linalg import qr

        _, triangle, order = qr(pose.slopes(np.zeros(len(self.dofs))), mode="economic", pivoting=True)
        sizes = np.abs(np.diag(triangle))
        chosen = np.sort(order[: len(sizes)][sizes > NO_EFFECT * max(float(sizes[0]), 1e-12)])
        offset = pose.solve(target, chosen)
        starts = {f"start_{self.dofs[k]}": float(offset[k]) for k in chosen}
        moves = bool(np.any(np.abs(rates) > MOVES * errors))
        if {"rest": False, "estimate": True}.get(state, moves):
            speed = np.linalg.lstsq(pose.slopes(offset)[:, chosen], rates, rcond=None)[0]
            starts |= {f"initial_{self.dofs[k]}_s": float(v) for k, v in zip(chosen, speed, strict=True)}
        return replace(trial, starts=starts, held=tuple(name for name in names if name not in starts))


class _StartPose:
    """Outputs of a model at rest, as functions of the displacements of its joints from the rest pose."""

    def __init__(self, model: MjcfModel, outputs: Sequence[SensorOutput]) -> None:
        self._compiled, self._rest, self._outputs = model.compiled, model._rest[0], outputs
        self._data, self._count = mujoco().MjData(model.compiled), len(model.dofs)

    def outputs(self, offset: Array) -> Array:
        """Return the outputs at displacements ``offset`` of the joints."""
        self._data.qpos[:] = self._rest
        mujoco().mj_integratePos(self._compiled, self._data.qpos, offset, 1.0)
        mujoco().mj_forward(self._compiled, self._data)
        return np.array([output.of(self._data.sensordata) for output in self._outputs])

    def slopes(self, offset: Array) -> Array:
        """Return the derivatives of the outputs with respect to displacements, shape (outputs, offsets)."""
        size = 1e-5
        rows = size * np.eye(self._count)
        moved = [self.outputs(offset + row) - self.outputs(offset - row) for row in rows]
        return np.array(moved).T / (2.0 * size)

    def solve(self, target: Array, chosen: NDArray[np.intp]) -> Array:
        """Return displacements at which the outputs have given values. Only chosen ones differ from 0."""
        turning, offset = np.array([output.turns for output in self._outputs]), np.zeros(self._count)
        for _ in range(6):
            missing = target - self.outputs(offset)
            missing[turning] = np.angle(np.exp(1j * missing[turning]))
            slopes = self.slopes(offset)[:, chosen]
            offset[chosen] += np.linalg.lstsq(slopes, missing, rcond=NO_EFFECT)[0]
        return offset


class _Scales(Scales):
    """Scales of a model of MuJoCo."""

    @property
    def inertia(self) -> float:
        """Mass of the moving bodies, kg."""
        compiled = self.model.compiled  # type: ignore[attr-defined]
        return float(compiled.body_mass[compiled.body_weldid > 0].sum()) or 1.0


def _threads() -> int:
    """Return the number of threads of a batch: one in a worker of a pool, else all processors."""
    return 1 if multiprocessing.parent_process() is not None else os.cpu_count() or 1


def _turns(angle: float, measured: Array | None) -> float:
    """Return the whole turns between a simulated and a measured angle at the start, rad."""
    if measured is None or not np.isfinite(measured).any():
        return 0.0
    first = float(measured[np.isfinite(measured)][0])
    return 2.0 * math.pi * round((first - angle) / (2.0 * math.pi))


def _first(time_s: Array, values: Array) -> tuple[float, float, float] | None:
    """Return value, slope and standard error of the slope at the first sample; None without early samples."""
    time, values = time_s[:FIRST_SAMPLES] - time_s[0], values[:FIRST_SAMPLES]
    there = np.isfinite(values)
    if there.sum() < 4:
        return (float(values[there][0]), 0.0, math.inf) if there.any() else None
    design = np.vander(time[there], 3, increasing=True)
    solution = np.linalg.lstsq(design, values[there], rcond=None)[0]
    left = values[there] - design @ solution
    variance = float(left @ left) / max(int(there.sum()) - 3, 1)
    error = math.sqrt(max(variance * np.linalg.pinv(design.T @ design)[1, 1], 0.0))
    return float(values[there][0]), float(solution[1]), error


# ---------------------------------------------------------------- elements of a file


def element_name(compiled: Any, kind: str, number: int) -> str | None:
    """Return the name of an element of a compiled model; None if the element has no name."""
    module = mujoco()
    name = module.mj_id2name(compiled, getattr(module.mjtObj, f"mjOBJ_{kind.upper()}"), number)
    return str(name) if name else None


def find_element(compiled: Any, kind: str, name: str, path: Path) -> int:
    """Return the index of an element of a compiled model.

    Raises
    ------
    InputError
        If there is no such element. The hint has the nearest name.
    """
    module = mujoco()
    number = module.mj_name2id(compiled, getattr(module.mjtObj, f"mjOBJ_{kind.upper()}"), name)
    if number < 0:
        count = {"key": compiled.nkey, "joint": compiled.njnt, "actuator": compiled.nu}.get(kind)
        count = getattr(compiled, f"n{kind}") if count is None else count
        names = [known for k in range(count) if (known := element_name(compiled, kind, k))]
        raise InputError(f"has no {kind} '{name}'", file=path, hint=suggestion(name, names, "it has"))
    return int(number)


def find_attribute(compiled: Any, place: str, path: Path, *, scale_inertia: bool = False) -> Attribute:
    """Return the attribute with a path such as ``joint/tail/stiffness`` or ``geom/fin/fluidcoef[0]``.

    Raises
    ------
    InputError
        If the file has no such element, or the attribute cannot be a parameter.
    """
    parts = place.split("/")
    kind, name, word = parts[0], "/".join(parts[1:-1]), parts[-1]
    bracket = re.fullmatch(r"(\w+)\[(\d)\]", word)
    key, part = (bracket[1], int(bracket[2])) if bracket else (word, None)
    if kind not in (*ATTRIBUTES, "joint"):
        hint = suggestion(kind, [*ATTRIBUTES, "joint"])
        raise InputError(f"'{place}' names no kind of element", file=path, hint=hint)
    allowed = list(JOINT_ARRAYS if kind == "joint" else ATTRIBUTES[kind])
    if kind == "actuator":
        allowed = ["kp", "kv", *allowed]
    if key not in allowed:
        text = f"'{key}' of {place} cannot be a parameter"
        raise InputError(text, file=path, hint=suggestion(key, allowed))
    if kind == "option":
        field, column, unit = ATTRIBUTES[kind][key]
        return Attribute(place, (ArrayEntries(field, (_component(column, part, place, path) or 0,)),), unit)
    number = find_element(compiled, kind, name, path)
    if kind == "joint":
        return _joint_attribute(compiled, number, place, key, part)
    if key == "kp":
        return Attribute(place, _servo(compiled, number, place, path), "1")
    if key == "kv":
        return Attribute(place, (ArrayEntries("actuator_biasprm", (number, 2), -1.0),), "1")
    field, column, unit = ATTRIBUTES[kind][key]
    entry = _component(column, part, place, path)
    index: tuple[Any, ...] = (number,) if entry is None else (number, entry)
    if key == "timeconst":
        index = (number, 0)
    inertia = number if (kind, key) == ("body", "mass") and scale_inertia else None
    return Attribute(place, (ArrayEntries(field, index),), unit, inertia)


def _joint_attribute(compiled: Any, number: int, place: str, key: str, part: int | None) -> Attribute:
    """Return an attribute of a joint, for its component ``part`` or for all its degrees of freedom."""
    angular = compiled.jnt_type[number] != SLIDE
    at: Any = number
    if JOINT_ARRAYS[key].startswith("dof"):
        begin = int(compiled.jnt_dofadr[number])
        wide = {0: 6, 1: 3}.get(int(compiled.jnt_type[number]), 1)
        at = slice(begin, begin + wide) if part is None and wide > 1 else begin + (part or 0)
    elif key == "springref":
        at = int(compiled.jnt_qposadr[number])
    return Attribute(place, (ArrayEntries(JOINT_ARRAYS[key], (at,)),), UNITS[key][int(angular)])


def _component(column: int | None, part: int | None, place: str, path: Path) -> int | None:
    """Return the column of a component; None if the attribute has one value."""
    if column is None:
        if part is not None:
            raise InputError(f"'{place}' has only one value: omit [{part}]", file=path)
        return None
    if part is None:
        raise InputError(f"'{place}' has several values", file=path, hint=f"name one value: {place}[0]")
    return column + part


def _servo(compiled: Any, number: int, place: str, path: Path) -> tuple[ArrayEntries, ...]:
    """Return the two array entries that the gain of a position servo sets."""
    gain, bias = compiled.actuator_gainprm[number, 0], compiled.actuator_biasprm[number, 1]
    if not gain or bias != -gain:
        raise InputError(f"'{place}': the actuator is no position servo", file=path, hint="use gainprm[0]")
    return ArrayEntries("actuator_gainprm", (number, 0)), ArrayEntries("actuator_biasprm", (number, 1), -1.0)


def base_joints(compiled: Any) -> list[int]:
    """Return the joints by which the robot moves in the world: free joints, or several of one first body."""
    found = []
    for k in range(compiled.njnt):
        body = compiled.jnt_bodyid[k]
        several = compiled.body_parentid[body] == 0 and compiled.body_jntnum[body] > 1
        if several or compiled.jnt_type[k] not in (SLIDE, HINGE):
            found.append(k)
    return found


def _dofs(compiled: Any, joints: Sequence[str]) -> list[str]:
    """Return the names of the degrees of freedom of joints, with their units."""
    # free, ball, slide, hinge
    ends = {0: FREE, 1: BALL, 2: ("m",), 3: ("rad",)}
    kinds = zip(joints, compiled.jnt_type, strict=True)
    return [f"{name}_{end}" for name, kind in kinds for end in ends[int(kind)]]


#: Components of an output that is an angle of a body or of a site.
TURNS = ("roll", "pitch", "yaw")
#: MuJoCo's type of sensor for an output, by kind of element and component.
SENSORS = {
    ("site", "xyz"): "framepos",
    ("site", "turn"): "framequat",
    ("body", "xyz"): "framepos",
    ("body", "turn"): "framequat",
    ("joint", "value"): "jointpos",
    ("joint", "rate"): "jointvel",
    ("tendon", "value"): "tendonpos",
    ("tendon", "rate"): "tendonvel",
}


def _add_sensor(spec: Any, source: str, path: Path) -> tuple[str, str, bool]:
    """Add the sensor of an output to a specification.

    Return the name of the sensor, the component, and whether the output depends on coordinates alone.

    Raises
    ------
    InputError
        If ``source`` is not a valid output, or its element does not exist.
    """
    module = mujoco()
    kind, _, rest = source.partition("/")
    if kind == "sensor":
        name, _, component = rest.rpartition("/")
        if not component.isdigit():
            name, component = rest, "0"
        if spec.sensor(name) is None:
            raise InputError(
                f"has no sensor '{name}'", file=path, hint=suggestion(name, [s.name for s in spec.sensors])
            )
        return name, component, False
    name, _, component = rest.rpartition("/")
    if kind in ("joint", "tendon"):
        if component != "rate":
            name, component = rest, "value"
        group = component
    else:
        group = "xyz" if component in ("x", "y", "z") else "turn" if component in TURNS else ""
    if (kind, group) not in SENSORS:
        forms = "site/NAME/x, body/NAME/yaw, joint/NAME, joint/NAME/rate, tendon/NAME or sensor/NAME/0"
        raise InputError(f"'{source}' is not a valid output", file=path, hint=f"write {forms}")
    if getattr(spec, kind)(name) is None:
        names = [e.name for e in getattr(spec, {"body": "bodies"}.get(kind, kind + "s"))]
        raise InputError(f"has no {kind} '{name}'", file=path, hint=suggestion(name, [n for n in names if n]))
    own = f"swimid/{source}"
    kinds = {"site": "SITE", "body": "XBODY", "joint": "JOINT", "tendon": "TENDON"}
    spec.add_sensor(
        name=own,
        type=getattr(module.mjtSensor, f"mjSENS_{SENSORS[kind, group].upper()}"),
        objtype=getattr(module.mjtObj, f"mjOBJ_{kinds[kind]}"),
        objname=name,
    )
    return own, component, component != "rate"


def _output(compiled: Any, sensor: str, component: str, place: bool) -> SensorOutput:
    """Return the output of a sensor of a compiled model."""
    module = mujoco()
    number = module.mj_name2id(compiled, module.mjtObj.mjOBJ_SENSOR, sensor)
    first, count = int(compiled.sensor_adr[number]), int(compiled.sensor_dim[number])
    if component.isdigit():
        return SensorOutput(first + int(component), 1, "value", place)
    return SensorOutput(first, count, component, place)
