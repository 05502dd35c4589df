"""Cases of the command ``simulate``: a robot under a beat, a weight or logged inputs, and recorded trials.

The quantities of simulated swimming are defined in :mod:`swimid.kinematics.cycles`. :class:`SwimRun` samples
a simulation so that it ends in whole cycles. It adds the quantities that need the model: amplitudes of
passive joints, tail excursion and power.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from swimid.errors import UsageError, suggestion
from swimid.files.provenance import Input
from swimid.fitting import drives
from swimid.fitting.drives import Cycle
from swimid.fitting.model import Array, Model, SwimInput, Trial
from swimid.kinematics.cycles import (
    PER_CYCLE,
    QUANTITIES,
    Window,
    cycle_quantities,
    is_straight,
    last_cycles,
    plane_quantities,
    settling_time,
    tail_excursion,
    whole_cycles,
)
from swimid.kinematics.frequency import find_beat
from swimid.logs import log as log_format
from swimid.logs.experiments import StrokeDrive, read_experiments
from swimid.logs.sampling import DURATION_S, even_times
from swimid.notices import warn
from swimid.propulsion.trials import table_columns
from swimid.results import numbers
from swimid.results import parameters as parameters_format
from swimid.results.parameters import ParameterFile
from swimid.simulation import catalogue
from swimid.simulation.catalogue import Applied
from swimid.simulation.options import DriveOptions, SimulateOptions
from swimid.swimmer import trials as swimmer
from swimid.swimmer.model import Energetics, Swimmer
from swimid.swimmer.planar.model import PlanarBody

#: Default sample rate of a simulation, Hz.
RATE_HZ = 50.0
#: Parameters of a beat, and parameters of a stroke, each with its unit.
BEAT = {"frequency_hz": "Hz", "amplitude_deg": "deg", "bias_deg": "deg", "asymmetry": "1", "lag_deg": "deg"}
STROKE = {"frequency_hz": "Hz", "scale": "1"}
#: Type of a function from a model and parameter vectors to quantities, shape (vectors, quantities). An
#: undefined quantity is NaN.
Quantities = Callable[[Applied, Sequence[Array]], Array]


@dataclass(frozen=True)
class Case:
    """Model, parameters and drive (commanded motion or input) of one simulation.

    Attributes
    ----------
    values : ndarray, shape (len(applied.model.parameters),)
        Parameter vector.
    trial : Trial
        Sample times, drive and initial state of the simulation.
    metadata : dict
        Metadata of the log.
    extra : dict of str to ndarray, each shape (n,)
        Columns of the log in addition to the simulated channels, such as commands, forces and measured
        inputs.
    units : dict of str to str
        Names of the quantities of the simulation, with their units.
    quantities : callable or None
        Function from model and parameter vectors to the quantities of the simulation, in the order of
        ``units``.
    """

    applied: Applied
    values: Array
    trial: Trial
    metadata: Mapping[str, Any]
    extra: Mapping[str, Any] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    quantities: Quantities | None = None

    @property
    def id(self) -> str:
        """Identifier of the simulated trial."""
        return self.trial.id

    def at_step(self, model: Model) -> Case:
        """Return the same case with ``model``, which has another integration step."""
        metadata = dict(self.metadata)
        if model.swimmer is not None:
            metadata["dt_s"] = model.swimmer.max_step
        return replace(self, applied=self.applied.at_step(model), metadata=metadata)


def describe_point(options: SimulateOptions) -> Path | None:
    """Return the path of the parameter file for messages and logs; None if the options name none."""
    return None if options.params is None else parameters_format.source_path(options.params)


def _metadata(options: SimulateOptions, robot: str, **more: Any) -> dict[str, Any]:
    """Return the metadata of a simulated log: entries that every simulated log has, and those in ``more``."""
    path = describe_point(options)
    lines: dict[str, Any] = {"robot": robot}
    if path is not None:
        lines["params"] = path.name
    if options.chosen:
        lines["set"] = dict(options.chosen)
    if options.readings:
        lines["readings"] = dict(options.readings)
    return lines | more


def _times(options: SimulateOptions, stroke: Cycle | None = None) -> Array:
    """Return equally spaced sample times of a simulation, s.

    If the options state no duration, a stroke with a limited number of cycles determines the duration.
    """
    duration = options.duration_s or DURATION_S
    if options.duration_s is None and stroke is not None and math.isfinite(stroke.cycles):
        duration = stroke.cycles / stroke.frequency_hz
    return even_times(duration, options.sample_rate_hz or RATE_HZ, options.dt)


def case_of_options(options: SimulateOptions) -> Case:
    """Return the simulation case that the options describe.

    Raises
    ------
    UsageError
        If an option that this model needs is missing.
    InputError
        If a file is invalid.
    """
    path = describe_point(options)
    if path is None:
        return _swim(options, None)
    own = read_experiments(*options.own_experiments)
    file, described = catalogue.read_parameters(options.params, own)
    if file.model in ("multilink", "multibody"):
        return _swim(options, file)
    if options.readings:
        raise UsageError(
            f"--reading is valid only for robots with links: omit it for the model '{file.model}'"
        )
    name, kind = next(iter(described.items()))
    run = kind.prepare_run(options, (path, file), _times(options))
    robot = run.robot or options.robot or file.robot or "unknown"
    applied = Applied(run.model, file, path, options.chosen, [run.trial], options.own_effects)
    metadata = _metadata(options, robot, experiment=name, **run.metadata)
    compute = None
    if run.quantities is not None:
        compute = _each(run.quantities)
    return Case(applied, applied.values(), run.trial, metadata, run.extra, run.units, compute)


def cases_of_trials(options: SimulateOptions) -> tuple[list[Case], Sequence[Input]]:
    """Return recorded trials as simulation cases, and the input files of the trials.

    Each case has the drive and the start state of its trial.

    Raises
    ------
    UsageError
        If the trial is unknown, or there is no parameter file.
    InputError
        If a file is invalid.
    """
    if options.params is None:
        raise UsageError("--trials needs a parameter file: --params")
    experiment, applied = catalogue.load(options.trials, options)
    only, names = options.trial, [t.id for t in experiment.trials]
    if only is not None and only not in names:
        raise UsageError(f"the trials file has no trial '{only}'", hint=suggestion(only, names, "it has"))
    cases = []
    for trial in experiment.trials:
        if only not in (None, trial.id):
            continue
        metadata = _metadata(options, experiment.robot.name, experiment=experiment.name, trial=trial.id)
        swims = experiment.model.swimmer
        if swims is not None:
            cases.append(_swimming(applied, applied.values(trial), swims, trial, metadata))
            continue
        extra: dict[str, Any] = dict(trial.inputs)
        if experiment.model.timed_runs:
            extra = table_columns(trial.id, trial.inputs)
        cases.append(Case(applied, applied.values(trial), trial, metadata, extra))
    return cases, experiment.inputs


# ------------------------------------------------------------ swimmers with links


def _swimming(
    applied: Applied, values: Array, model: Swimmer, trial: Trial, metadata: dict[str, Any]
) -> Case:
    """Return the simulation case of a trial of a robot with links."""
    if trial.swim.drive is not None:
        metadata["drive"] = drive_block(trial)
    extra, quantities = commands(model, trial, values), _swim_quantities(model, trial, values)
    return Case(applied, values, trial, metadata, extra, units_of(model), quantities)


def _swim(options: SimulateOptions, file: ParameterFile | None) -> Case:
    """Return the simulation case of a robot with links under a beat, a stroke or recorded joint angles."""
    applied = catalogue.load_robot(options, file)
    values, model = applied.values(), applied.model.swimmer
    assert model is not None
    kind = "multibody"
    if model.free_base and not model.in_space:
        kind = "free-swim"
    metadata, drive = _metadata(options, model.robot.name, experiment=kind), list_drive_options(options)
    if options.input is not None:
        if "frequency_hz" in drive or "amplitude_deg" in drive:
            raise UsageError("--input replaces the beat: omit --frequency-hz and --amplitude-deg")
        time, swim = _read_inputs(options.input, options, model)
        metadata["input"] = options.input.name
    elif model.inputs:
        columns = ", ".join(law.column for law in model.inputs.values())
        text = f"the robot '{model.robot.name}' moves by inputs: --input names a log with {columns}"
        raise UsageError(text)
    elif model.driven or options.stroke is not None:
        check_drive(options)
        swim = swim_input(model, options, drive, options.cycles)
        time = _times(options, swim.stroke)
        if swim.beat is not None:
            _check_sampling(options, swim.beat.frequency_hz)
    elif drive:
        raise UsageError(f"the robot '{model.robot.name}' has no driven joint: omit the options of the beat")
    else:
        swim, time = SwimInput(pose=rest_pose(model)), _times(options)
    return _swimming(applied, values, model, Trial("run", "fit", time, {}, swim=swim), metadata)


def rest_pose(model: Swimmer) -> tuple[float, ...] | None:
    """Return the initial pose of a robot that starts at the origin; None for a robot on a fixed base."""
    return (0.0,) * len(model.pose) if model.free_base else None


def list_drive_options(options: DriveOptions) -> dict[str, float]:
    """Return the drive parameters that the options state.

    These are the parameters of a stroke if the options name a stroke, and else the parameters of a beat.
    """
    names = STROKE if options.stroke is not None else BEAT
    stated = {name: getattr(options, name) for name in names}
    return {name: float(value) for name, value in stated.items() if value is not None}


def check_drive(options: DriveOptions, varied: Collection[str] = (), option: str = "") -> None:
    """Raise an error for a drive that is incomplete or contradicts itself.

    Parameters
    ----------
    varied : collection of str
        Drive parameters that ``option`` varies.

    Raises
    ------
    UsageError
    """
    stated = {name for name in BEAT if getattr(options, name)} | set(varied)
    if options.stroke is not None:
        if stated & {"amplitude_deg", "bias_deg", "asymmetry", "lag_deg"}:
            raise UsageError(
                "--stroke replaces the beat: omit amplitude_deg, bias_deg, asymmetry and lag_deg"
            )
        return
    for name in ("frequency_hz", "amplitude_deg"):
        if name not in varied and getattr(options, name) is None:
            others = f", or vary {name} ({option})" * bool(option)
            hint = f"give --{name.replace('_', '-')}{others}"
            raise UsageError(f"the beat has no {name}", hint=hint)
    if "asymmetry" in stated and options.waveform != "a-cpg":
        raise UsageError("asymmetry is valid only with --waveform a-cpg: omit it, or choose this waveform")


def swim_input(
    model: Swimmer, options: DriveOptions, drive: Mapping[str, float], cycles: float | None = None
) -> SwimInput:
    """Return the input of a simulation from rest under a stroke or a beat with the given parameters."""
    if options.stroke is not None:
        # use the default ramp for beats only: a stroke has a ramp only if the options state one
        ramp = options.ramp_s * (options.ramp_s != options.declarations()["ramp_s"].default)
        command = StrokeDrive(
            stroke=options.stroke,
            frequency_hz=drive.get("frequency_hz"),
            scale=drive.get("scale", 1.0),
            ramp_s=ramp,
            cycles=cycles,
        )
        return SwimInput(stroke=swimmer.cycle_of(command, model), pose=rest_pose(model))
    beat = drives.TailBeat(
        options.waveform,
        drive["frequency_hz"],
        math.radians(drive["amplitude_deg"]),
        math.radians(drive.get("bias_deg", 0.0)),
        drive.get("asymmetry", 0.0),
        options.ramp_s,
        lag_rad=math.radians(drive.get("lag_deg", 0.0)),
    )
    return SwimInput(beat, pose=rest_pose(model))


def _check_sampling(options: SimulateOptions, frequency_hz: float) -> None:
    """Raise an error if the integration step is too long for a beat. Warn if the sample rate is too low."""
    rate = options.sample_rate_hz or RATE_HZ
    if frequency_hz * options.dt >= 0.5:
        raise UsageError(
            f"a beat of {frequency_hz:g} Hz cannot be integrated with steps of {options.dt:g} s",
            hint=f"take --dt {0.02 / frequency_hz:.1g} or less",
        )
    if frequency_hz >= 0.5 * rate:
        text = f"{rate:g} samples a second do not show a beat of {frequency_hz:g} Hz: raise --sample-rate-hz"
        warn("SWM054", text)


def drive_block(trial: Trial) -> dict[str, Any]:
    """Return the drive of a trial with the keys of a trials file.

    The result is empty if measured joint angles drive the robot.
    """
    beat, stroke = trial.swim.beat, trial.swim.stroke
    block: dict[str, Any] = swimmer.drive_of(trial)
    if stroke is not None:
        block = {"stroke": stroke.name, **block, "ramp_s": stroke.ramp_s, "cycles": stroke.cycles}
    elif beat is not None:
        phase = math.degrees(beat.phase_rad)
        block = {"waveform": beat.waveform, **block, "ramp_s": beat.ramp_s, "phase_deg": phase}
    # leave out entries that have no effect
    unused = [key for key in ("lag_deg", "phase_deg") if not block.get(key)]
    return {key: value for key, value in block.items() if key not in unused and value != math.inf}


def setting_text(key: str, value: float | str) -> str:
    """Return one setting of a drive in words.

    >>> setting_text("amplitude_deg", 20.0)
    'amplitude 20°'
    """
    name, unit = numbers.split_unit(key)
    if not isinstance(value, str):
        value = numbers.format_number(value, 4, unit)
    return f"{name} {value}"


def _read_inputs(path: Path, options: SimulateOptions, model: Swimmer) -> tuple[Array, SwimInput]:
    """Read a log, and return its sample times and the input of the model from its columns."""
    log = log_format.read(path, optional=tuple(swimmer.input_columns(model)))
    swim = SwimInput(inputs=swimmer.read_inputs(model, log), pose=rest_pose(model))
    swim = swimmer.with_logged_joints(swim, model, log)
    begin, end = float(log.time_s[0]), float(log.time_s[-1])
    if options.duration_s is not None:
        end = min(end, begin + options.duration_s)
    rate = options.sample_rate_hz
    if rate is None:
        return log.time_s[log.time_s <= end], swim
    return begin + even_times(end - begin, rate), swim


def commands(model: Swimmer, trial: Trial, values: Array) -> dict[str, Array]:
    """Return the commanded angle of every actuator, rad, as the columns of a log."""
    phase = float(values[model.index("drive_phase")])
    time = trial.time_s - float(values[model.index("clock_offset")])
    return {
        actuator.command: model.command(k, trial.swim, time, phase)
        for k, actuator in enumerate(model.actuators)
    }


def beat_frequency(
    model: Swimmer, trial: Trial, values: Array, measured: Sequence[Array] = ()
) -> float | None:
    """Return the beat frequency of a trial, Hz; None if there is no beat.

    The beat frequency is that of the drive. Without a drive, it is estimated from the first joint or measured
    channel that has a beat.
    """
    if trial.swim.drive is not None:
        return float(trial.swim.drive.frequency_hz)
    for angle in (*commands(model, trial, values).values(), *measured):
        beat = find_beat(trial.time_s, angle)
        if beat is not None:
            return beat.frequency_hz
    return None


def _each(compute: Callable[[Applied, Array], list[float]]) -> Quantities:
    """Return a function of several parameter vectors that calls ``compute`` for each vector."""
    return lambda applied, vectors: np.array([compute(applied, values) for values in vectors])


def _swim_quantities(model: Swimmer, trial: Trial, values: Array) -> Quantities | None:
    """Return the function that computes the quantities of the last beats or strokes of a simulation.

    Return None if there is no beat, or if no whole cycle fits into the trial.
    """
    frequency = beat_frequency(model, trial, values)
    if frequency is None:
        return None
    run = SwimRun.of(model, trial, frequency)
    if run is None:
        return None

    return lambda applied, vectors: quantities_of(applied.model.swimmer, [run] * len(vectors), vectors)


# ------------------------------------------------------------ quantities of a run


def format_quantity(value: float | None, unit: str, sd: float | None = None, *, digits: int = 3) -> str:
    """Return a quantity as text, with its unit and, if known, its standard deviation ``sd``.

    Angles are converted to degrees.
    """
    factor, shown = numbers.in_degrees(unit)
    if value is None:
        return numbers.format_number(None)
    if sd:
        return numbers.format_estimate(factor * value, factor * sd, shown)
    return numbers.format_number(factor * value, digits, shown)


def units_of(model: Swimmer) -> dict[str, str]:
    """Return the unit of each quantity that a simulation of a robot may have, by name."""
    scope, skipped = "none", "none"
    if model.in_space:
        scope = "cycle"
    elif model.free_base:
        scope = "plane"
        skipped = {"yaw_rad": "pitch", "pitch_rad": "yaw"}[model.pose[2]]
    named = {n: kind for n, kind in QUANTITIES.items() if skipped not in n.split("_")}
    units = {name: kind.unit for name, kind in named.items() if scope in kind.of}
    if not model.in_space:
        units |= {f"amplitude_{axis.name}_rad": "rad" for axis in model.passive}
    if model.driven:
        units |= {name: kind.unit for name, kind in QUANTITIES.items() if kind.of == "power"}
    return units


@dataclass(frozen=True)
class SwimRun:
    """Simulation under a beat or a stroke, sampled so that it ends in whole cycles.

    Attributes
    ----------
    trial : Trial
        Trial with :data:`~swimid.kinematics.cycles.PER_CYCLE` samples per cycle, from the start of the
        simulation on.
    window : Window
        Last whole beats of the simulation; for a robot that moves in 3-D, its last cycle.
    commanded_turn : bool
        Whether the drive has a bias or an asymmetry.
    """

    trial: Trial
    window: Window
    commanded_turn: bool

    @classmethod
    def of(cls, model: Swimmer, trial: Trial, frequency_hz: float) -> SwimRun | None:
        """Return the simulation with the drive and the duration of a trial.

        Return None if no whole cycle fits into the trial.
        """
        begin, end = float(trial.time_s[0]), float(trial.time_s[-1])
        beat = trial.swim.beat
        if model.in_space:
            ends, stroke = trial.time_s, trial.swim.stroke
            if stroke is not None:
                # end with the last cycle of the stroke, because its joints rest afterwards
                ends = np.minimum(ends, stroke.cycles / frequency_hz)
            window: Window | None = next(reversed(whole_cycles(ends, frequency_hz)), None)
        else:
            ramp = 0.0 if beat is None else beat.ramp_s
            window = last_cycles(max(begin, ramp), end, frequency_hz)
        if window is None:
            return None
        times = window.times()
        # begin the samples at the start of the trial
        lead = np.arange(begin, times[0] - 1e-9, times[1] - times[0])
        sampled = Trial(f"{trial.id} (last beats)", "fit", np.concatenate((lead, times)), {}, swim=trial.swim)
        return cls(sampled, window, beat is not None and bool(beat.bias_rad or beat.asymmetry))

    @classmethod
    def simulate_drive(cls, model: Swimmer, name: str, swim: SwimInput, duration_s: float) -> SwimRun:
        """Return a simulation from rest under a drive.

        The simulation is longer than ``duration_s`` if no whole beat after the ramp fits into ``duration_s``.

        Parameters
        ----------
        name : str
            Name of the simulation. The model caches simulations under this name, so each drive needs a
            different name.

        Notes
        -----
        Samples are counted from the end of the simulation, so that its quantities are smooth functions of the
        frequency. The simulation begins up to one sample before the drive. For a robot that moves in 3-D, the
        duration is rounded up to whole cycles.
        """
        assert swim.drive is not None
        end, frequency_hz = duration_s, float(swim.drive.frequency_hz)
        if swim.beat is not None:
            end = max(end, swim.beat.ramp_s + (1.0 + 1e-6) / frequency_hz)
        if model.in_space:
            end = max(math.ceil(end * frequency_hz - 1e-9), 1) / frequency_hz
        count = math.ceil(end * PER_CYCLE * frequency_hz - 1e-9)
        time = end - np.arange(count, -1, -1) / (PER_CYCLE * frequency_hz)
        run = cls.of(model, Trial(name, "fit", time, {}, swim=swim), frequency_hz)
        assert run is not None
        return run

    def quantities(
        self, model: Swimmer, values: Array, columns: Mapping[str, Array], energetics: Energetics | None
    ) -> dict[str, float]:
        """Return the quantities of the simulation by name. Their units are in :func:`units_of`.

        Parameters
        ----------
        columns : mapping of str to ndarray
            Channels of the model at the sample times of :attr:`trial`.
        energetics : Energetics or None
            Power and energy of the joints in the window; None if they are unknown.
        """
        body, time = model.body, self.trial.time_s
        if body is None:
            found = cycle_quantities(time, columns, self.window)
        else:
            count = self.window.cycles * PER_CYCLE + 1
            last = {name: series[-count:] for name, series in columns.items()}
            found = {f"amplitude_{a.name}_rad": 0.5 * float(np.ptp(last[a.column])) for a in body.passive}
            if body.free:
                found = self._of_last_cycles(body, values, last) | self._of_whole_run(body, columns) | found
        if energetics is not None and model.driven:
            found |= _power_quantities(energetics, found.get("mean_speed_m_s"))
        return found

    def _of_last_cycles(
        self, body: PlanarBody, values: Array, columns: Mapping[str, Array]
    ) -> dict[str, float]:
        """Return the quantities of the last whole cycles of a simulation, from the channels in them."""
        length = body.length(values)
        pose = [columns[name] for name in body.pose]
        found = plane_quantities(
            pose,
            [columns[name] for name in body.velocity],
            self.window,
            length_m=length,
            turn=body.pose[2].removesuffix("_rad"),
            commanded_turn=self.commanded_turn,
        )
        speed = found["mean_speed_m_s"]
        if is_straight(pose[2], speed, length):
            rear = int(np.argmax(body.straight(values)[1]))
            x, y = body.rear_ends(body.frames(values, columns))
            excursion = tail_excursion(x[rear], y[rear])
            found["tail_excursion_m"] = excursion
            found["strouhal"] = self.window.frequency_hz * excursion / speed
        return found

    def _of_whole_run(self, body: PlanarBody, columns: Mapping[str, Array]) -> dict[str, float]:
        """Return the quantities of a whole simulation: mean surge speed, settling time, extent of path."""
        time, surge = self.trial.time_s, columns[body.velocity[0]]
        return {
            "mean_surge_from_start_m_s": float(np.trapezoid(surge, time) / (time[-1] - time[0])),
            "settling_time_s": settling_time(time, surge, self.window.frequency_hz),
            "path_extent_m": max(float(np.ptp(columns[name])) for name in body.pose[:2]),
        }


def quantities_of(model: Swimmer, runs: Sequence[SwimRun], vectors: Sequence[Array]) -> Array:
    """Simulate a robot with links, and return the quantities of each simulation, shape (n, quantities).

    The quantities are in the order of :func:`units_of`. An undefined quantity is NaN.
    """
    pairs = [(values, run.trial) for values, run in zip(vectors, runs, strict=True)]
    simulated = model.with_energetics(pairs, [run.window.duration_s for run in runs])
    units, table = units_of(model), []
    for run, values, (columns, energetics) in zip(runs, vectors, simulated, strict=True):
        found = run.quantities(model, values, columns, energetics)
        table.append([found.get(name, math.nan) for name in units])
    return np.array(table)


def _power_quantities(energetics: Energetics, speed_m_s: float | None) -> dict[str, float]:
    """Return power, torque and angular rate of the driven joints, and the cost of transport (COT).

    Notes
    -----
    ``COT = P / V`` (dolphin, Eq 11). V is the mean speed. P is the mean positive mechanical power of the
    joints, because servos return no energy to the battery. Losses of gear and motor are not included.
    """
    positive = energetics.mean_positive_power_W()
    found = {
        "mean_power_W": energetics.mean_power_W(),
        "mean_positive_power_W": positive,
        "peak_torque_N_m": float(np.abs(energetics.torque_N_m).max()),
        "peak_joint_rate_rad_s": float(np.abs(energetics.rate_rad_s).max()),
    }
    if speed_m_s is not None and speed_m_s > 0:
        found["cost_of_transport_J_m"] = positive / speed_m_s
    return found
