"""Cases for ``simulate``: runs driven by a beat, a weight or an input log, and recorded trials."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from swimid.blackbox.model import ArxModel
from swimid.errors import InputError, UsageError, suggestion
from swimid.files.provenance import Input
from swimid.fitting import drives
from swimid.fitting.drives import Cycle
from swimid.fitting.model import Array, CruiseInput, Model, RigInput, SurgeInput, SwimInput, Trial
from swimid.logs import kinematics
from swimid.logs import log as log_format
from swimid.logs import trials as trials_format
from swimid.logs.beat import find_beat
from swimid.logs.trials import StrokeDrive, TrialSet
from swimid.notices import warn
from swimid.propulsion import trials as propulsion
from swimid.propulsion.model import SPEED, RecoilModel, SurgeModel, velocity_ratio
from swimid.results import numbers
from swimid.results import parameters as parameters_format
from swimid.results.parameters import ParameterFile
from swimid.rig import model as rig
from swimid.robots import file as robot_format
from swimid.robots.file import Robot
from swimid.simulation import catalogue
from swimid.simulation.catalogue import Applied, Compute, Quantity
from swimid.simulation.options import SimulateOptions
from swimid.simulation.swim_quantities import SwimRun, quantity
from swimid.swimmer import drive
from swimid.swimmer import trials as swimmer
from swimid.swimmer.model import Swimmer

#: Default duration of a run, s, and default sample rate, Hz.
DURATION_S, RATE_HZ = 15.0, 50.0
#: Maximum number of samples or integration steps of a run.
MAX_SAMPLES = 20_000_000
#: Length of a course on which the start from rest has a negligible effect on the mean speed, m.
FAR_M = 1e9
#: Maximum bend of a joint, degrees. A larger bend gives a warning.
MAX_BEND_DEG = 90.0


@dataclass(frozen=True)
class Case:
    """One run to simulate.

    Attributes
    ----------
    values : ndarray, shape (len(applied.model.parameters),)
    trial : Trial
        Sample times, drive and start of the run.
    metadata : dict
        Metadata of the log.
    extra : dict of str to ndarray, each shape (n,)
        Columns of the log in addition to the simulated channels: commands, forces, measured inputs.
    quantities : callable or None
        Function from parameter vectors to the quantities of the run.
    """

    applied: Applied
    values: Array
    trial: Trial
    metadata: Mapping[str, Any]
    extra: Mapping[str, Any] = field(default_factory=dict)
    quantities: Compute | None = None

    @property
    def id(self) -> str:
        """Id of the trial."""
        return self.trial.id

    @property
    def per_run(self) -> bool:
        """Whether each sample stands for one run of a table, so that the log has no time column."""
        return self.applied.model.timed_runs


def place(options: SimulateOptions) -> Path | None:
    """Return the path of the parameters for messages and logs; None without a parameter file."""
    return None if options.params is None else parameters_format.place(options.params)


def _metadata(options: SimulateOptions, robot: str, **more: Any) -> dict[str, Any]:
    """Return the metadata of a log: the entries that every log has, and the entries in ``more``."""
    path = place(options)
    lines: dict[str, Any] = {"robot": robot}
    if path is not None:
        lines["params"] = path.name
    if options.chosen:
        lines["set"] = dict(options.chosen)
    if options.readings:
        lines["readings"] = dict(options.readings)
    return lines | more


def _times(options: SimulateOptions, stroke: Cycle | None = None) -> Array:
    """Return equally spaced sample times of the run, s.

    By default, a stroke with a limited number of cycles determines the duration.
    """
    duration = options.duration_s or DURATION_S
    if options.duration_s is None and stroke is not None and math.isfinite(stroke.cycles):
        duration = stroke.cycles / stroke.frequency_hz
    rate = options.sample_rate_hz or RATE_HZ
    if duration * max(rate, 1.0 / options.dt) > MAX_SAMPLES:
        raise UsageError(f"{duration:g} s at this rate and step are too many samples")
    return np.arange(max(round(duration * rate), 1) + 1) / rate


def _needed(options: SimulateOptions, what: str, *names: str) -> list[Any]:
    """Return the values of the named options, which the kind of run in ``what`` requires.

    Raises
    ------
    UsageError
        If one of the options is missing.
    """
    for name in names:
        if getattr(options, name) is None:
            raise UsageError(f"{what} needs --{name.replace('_', '-')}")
    return [getattr(options, name) for name in names]


def case_of_options(options: SimulateOptions) -> Case:
    """Return the case of the run that the options describe.

    Raises
    ------
    UsageError
        If an option that this model needs is missing.
    InputError
        If a file is invalid.
    """
    path = place(options)
    if path is None:
        return _swim(options, None)
    file = catalogue.read_parameters(options.params)
    if file.model in ("multilink", "multibody"):
        return _swim(options, file)
    if options.readings:
        raise UsageError(f"--reading belongs to robots with links, not to the model '{file.model}'")
    if file.model == "arma":
        return _arma(options, file, path)
    makers = {
        "falling-weight": _falling_weight,
        RecoilModel.name: _cruise,
        SurgeModel.name: _surge,
    }
    if file.model not in makers:
        raise UsageError(
            f"the model '{file.model}' can be simulated for recorded trials only",
            hint="give them with --trials",
        )
    robot = robot_format.read(*catalogue.robot_of_parameters(file, path, options.robot))
    model, trial, metadata, more = makers[file.model](options, file, path, robot)
    applied = Applied(model, file, path, options.chosen)
    return Case(applied, applied.values(), trial, _metadata(options, robot.name, **metadata), **more)


def cases_of_trials(
    trials: str | Path | TrialSet, options: SimulateOptions, only: str | None
) -> tuple[list[Case], Sequence[Input]]:
    """Return recorded trials as cases, with their own drives and start states, and the inputs of the trials.

    Raises
    ------
    UsageError
        If the trial is unknown, or there is no parameter file.
    InputError
        If a file is invalid.
    """
    if options.params is None:
        raise UsageError("--trials needs a parameter file: --params")
    experiment, applied = catalogue.load(trials, options)
    names = [t.id for t in experiment.trials]
    if only is not None and only not in names:
        name = trials_format.place(trials).name
        raise UsageError(f"there is no trial '{only}' in {name}", hint=suggestion(only, names))
    cases = []
    for trial in experiment.trials:
        if only not in (None, trial.id):
            continue
        metadata = _metadata(options, experiment.robot.name, experiment=experiment.name, trial=trial.id)
        swims = experiment.model.swimmer
        if swims is not None:
            cases.append(_swimming(applied, applied.values(trial.id), swims, trial, metadata))
            continue
        extra: dict[str, Any] = {}
        if experiment.model.timed_runs:
            extra = _table(trial.id, trial.inputs)
        elif experiment.name in ("towed", "arma"):
            extra = dict(trial.inputs)
        cases.append(Case(applied, applied.values(trial.id), trial, metadata, extra))
    return cases, experiment.inputs


# ------------------------------------------------------------ swimmers with links


def _swimming(
    applied: Applied, values: Array, model: Swimmer, trial: Trial, metadata: dict[str, Any]
) -> Case:
    """Return the case of a robot with links."""
    if trial.swim.drive is not None:
        metadata["drive"] = drive_block(trial)
    metadata["dt_s"] = model.max_step
    extra, quantities = commands(model, trial, values), _swim_quantities(model, trial, values)
    return Case(applied, values, trial, metadata, extra, quantities)


def _swim(options: SimulateOptions, file: ParameterFile | None) -> Case:
    """Return the case of a robot with links that is driven by a beat, a stroke or recorded joint angles."""
    applied = catalogue.load_robot(options, file)
    values, model = applied.values(), applied.model.swimmer
    assert model is not None
    swim, kind = SwimInput(), "multibody"
    if model.free_base:
        swim = SwimInput(pose=(0.0,) * len(model.pose))
        kind = "multibody" if model.in_space else "free-swim"
    metadata = _metadata(options, model.robot.name, experiment=kind)
    beaten = options.frequency_hz is not None or options.amplitude_deg is not None
    if options.input is not None:
        if beaten:
            raise UsageError(
                "--input takes the place of a beat: leave out --frequency-hz and --amplitude-deg"
            )
        time, joints = _recorded_joints(options.input, options, model)
        swim = replace(swim, joints=joints)
        metadata["input"] = options.input.name
    elif options.stroke is not None:
        swim = replace(swim, stroke=swimmer.cycle_of(_stroke(options.stroke, options), model))
        time = _times(options, swim.stroke)
    else:
        if model.driven:
            swim = replace(swim, beat=_beat(options, model))
        elif beaten:
            raise UsageError(f"the robot '{model.robot.name}' has no driven joint: there is nothing to beat")
        time = _times(options)
    return _swimming(applied, values, model, Trial("run", "fit", time, {}, swim=swim), metadata)


def drive_block(trial: Trial) -> dict[str, Any]:
    """Return the drive of a trial as in a trials file; empty if measured joint angles drive the robot."""
    beat, stroke = trial.swim.beat, trial.swim.stroke
    block: dict[str, Any] = swimmer.drive_of(trial)
    if stroke is not None:
        block = {"stroke": stroke.name, **block, "ramp_s": stroke.ramp_s}
        if math.isfinite(stroke.cycles):
            block["cycles"] = stroke.cycles
    elif beat is not None:
        block = {"waveform": beat.waveform, **block, "ramp_s": beat.ramp_s}
        optional = {"lag_deg": beat.lag_rad, "phase_deg": beat.phase_rad}
        for key, angle in optional.items():
            block.pop(key, None)
            if angle:
                block[key] = math.degrees(angle)
    return block


def setting_text(key: str, value: float | str) -> str:
    """Return one setting of a drive in words.

    >>> setting_text("amplitude_deg", 20.0)
    'amplitude 20°'
    """
    name, unit = numbers.split_unit(key)
    if not isinstance(value, str):
        value = numbers.number(value, 4, unit)
    return f"{name} {value}"


def _stroke(name: str, options: SimulateOptions) -> StrokeDrive:
    if options.amplitude_deg is not None or options.bias_deg or options.asymmetry:
        raise UsageError(
            "--stroke takes the place of a beat: leave out --amplitude-deg, --bias-deg, --asymmetry"
        )
    # the default ramp is for beats only: a stroke has no ramp unless one is given
    ramp = 0.0 if options.ramp_s == options.declared()["ramp_s"].default else options.ramp_s
    hertz, scale, cycles = options.frequency_hz, options.scale, options.cycles
    return StrokeDrive(stroke=name, frequency_hz=hertz, scale=scale, ramp_s=ramp, cycles=cycles)


def _beat(options: SimulateOptions, model: Swimmer) -> drives.Beat:
    f, amplitude = _needed(options, "a beat", "frequency_hz", "amplitude_deg")
    rate = options.sample_rate_hz or RATE_HZ
    if f * options.dt >= 0.5:
        raise UsageError(
            f"a beat of {f:g} Hz cannot be integrated with steps of {options.dt:g} s",
            hint=f"take --dt {0.02 / f:.1g} or less",
        )
    if f >= 0.5 * rate:
        warn("SWM054", f"{rate:g} samples a second do not show a beat of {f:g} Hz: raise --sample-rate-hz")
    for axis in model.driven:
        law = axis.driven
        assert law is not None
        bias_gain = law.bias_gain
        if bias_gain is None:
            bias_gain = law.gain
        bend = abs(law.gain) * amplitude + abs(bias_gain * options.bias_deg)
        if bend > MAX_BEND_DEG:
            warn("SWM054", f"{axis.name} bends by up to {bend:.0f} degrees")
            break
    asymmetry = options.asymmetry
    if asymmetry and options.waveform != "a-cpg":
        warn("SWM004", f"--asymmetry belongs to the waveform a-cpg; a {options.waveform} has none")
        asymmetry = 0.0
    angles = math.radians(amplitude), math.radians(options.bias_deg)
    return drives.Beat(options.waveform, f, *angles, asymmetry, options.ramp_s)


def _recorded_joints(path: Path, options: SimulateOptions, model: Swimmer) -> tuple[Array, list[Any]]:
    """Return the sample times of the run, and the motion of each driven joint from a log."""
    measured = [a.column for a in model.driven]
    commanded = [name.replace("joint", "cmd") for name in measured]
    log = log_format.read(path, optional=(*measured, *commanded))
    joints = []
    for axis, joint, command in zip(model.driven, measured, commanded, strict=True):
        servo = axis.driven is not None and axis.driven.servo is not None
        order = [command, joint] if servo else [joint, command]
        there = [name for name in order if name in log and np.isfinite(log[name]).sum() >= 5]
        if not there:
            raise InputError(
                f"the driven joint '{axis.name}' needs the column '{joint}' or '{command}'",
                file=log.path,
                column=joint,
            )
        joints.append(drive.spline_motion(drive.measured(log.time_s, log[there[0]])))
    begin, end = float(log.time_s[0]), float(log.time_s[-1])
    if options.duration_s is not None:
        end = min(end, begin + options.duration_s)
    rate = options.sample_rate_hz
    if rate is None:
        return log.time_s[log.time_s <= end], joints
    return begin + np.arange(int((end - begin) * rate) + 1) / rate, joints


def commands(model: Swimmer, trial: Trial, values: Array) -> dict[str, Array]:
    """Return the commanded angle of every driven joint, rad, as the columns of a log."""
    phase = float(values[model.index("drive_phase")])
    time = trial.time_s - float(values[model.index("clock_offset")])
    return {
        axis.column.replace("joint", "cmd"): model.command(k, trial.swim, time, phase)
        for k, axis in enumerate(model.driven)
    }


def beat_frequency(
    model: Swimmer, trial: Trial, values: Array, measured: Sequence[Array] = ()
) -> float | None:
    """Return the frequency of the drive, or else of the first joint or measured channel with a beat, Hz."""
    if trial.swim.drive is not None:
        return float(trial.swim.drive.frequency_hz)
    for angle in (*commands(model, trial, values).values(), *measured):
        beat = find_beat(trial.time_s, angle)
        if beat is not None:
            return beat.frequency_hz
    return None


def _each(compute: Callable[[Array], dict[str, Quantity]]) -> Compute:
    """Return a function of several parameter vectors that calls ``compute`` for each vector."""
    return lambda vectors: [compute(values) for values in vectors]


def _swim_quantities(model: Swimmer, trial: Trial, values: Array) -> Compute | None:
    """Return the function for the quantities of the last beats, or of each stroke; None without a beat."""
    frequency = beat_frequency(model, trial, values)
    if frequency is None:
        return None
    if model.body is None:
        windows = kinematics.whole_cycles(trial.time_s, frequency)

        def by_stroke(values: Array) -> dict[str, Quantity]:
            columns = model.attempt(values, trial)
            found: dict[str, Quantity] = {}
            for k, window in enumerate(windows, 1):
                of_cycle = kinematics.cycle_quantities(trial.time_s, columns, window)
                found |= {f"cycle_{k}_{name}": quantity(name, value) for name, value in of_cycle.items()}
            return found

        return _each(by_stroke) if windows else None
    run = SwimRun.of(model, trial, frequency)
    if run is None:
        return None

    def of_last_beats(vectors: Sequence[Array]) -> list[dict[str, Quantity]]:
        pairs = [(values, run.trial) for values in vectors]
        simulated = model.with_energetics(pairs, [run.window.duration_s] * len(pairs))
        return [
            run.quantities(model, values, columns, energetics)
            for values, (columns, energetics) in zip(vectors, simulated, strict=True)
        ]

    return of_last_beats


# ------------------------------------------------------------ other models

#: Model, trial, metadata, and further attributes of a case.
_Made = tuple[Model, Trial, dict[str, Any], dict[str, Any]]


def _falling_weight(options: SimulateOptions, file: ParameterFile, path: Path, robot: Robot) -> _Made:
    (pulling,) = _needed(options, "a falling weight", "pulling_mass_kg")
    mass, area = robot.body.inertial_mass_kg, robot.body.frontal_area_m2
    known = "drag_coefficient" in file.parameters
    if known and area is None:
        raise InputError(f"the robot '{robot.name}' has no body.frontal_area_m2 for its drag coefficient")
    if mass is None:
        raise InputError(f"the robot '{robot.name}' has no body.inertial_mass_kg")
    factor = 0.5 * robot.fluid.density_kg_m3 * (area or 0.0)
    force = pulling * robot.fluid.gravity_m_s2
    inertia = mass + pulling + robot.rig.pulley_inertia_kg
    model = rig.falling_weight(mass_kg=inertia, force_N=force, area_known=known, pulley=True)
    on_rig = RigInput(inertia, force, pulley=True, area_factor=factor, release_s=0.0)
    trial = Trial("run", "fit", _times(options), {}, rig=on_rig)

    def compute(values: Array) -> dict[str, Quantity]:
        simulated = model.simulate(values, trial)
        ends = {
            "last_speed_m_s": Quantity(float(simulated[model.speed][-1]), "m/s"),
            "distance_m": Quantity(float(simulated["x_m"][-1]), "m"),
        }
        top = rig.terminal_speed(model.coefficients(values, on_rig), force)
        if not math.isnan(top):
            ends = {"terminal_speed_m_s": Quantity(top, "m/s"), **ends}
        return ends

    metadata = {"experiment": "falling-weight", "pulling_mass_kg": pulling}
    return model, trial, metadata, {"quantities": _each(compute)}


def _arma(options: SimulateOptions, file: ParameterFile, path: Path) -> Case:
    model = ArxModel.from_file(file, path)
    metadata = _metadata(options, options.robot or file.robot or "unknown", experiment="arma")
    if options.input is not None:
        wanted: tuple[str, ...] = ()
        if not model.sine:
            wanted = (model.source,)
        log = log_format.read(options.input, required=wanted, optional=(model.output,))
        measured = {model.output: log[model.output]} if model.output in log else {}
        trial = Trial("run", "fit", log.time_s, measured, inputs={name: log[name] for name in wanted})
        metadata["input"] = options.input.name
    elif model.sine is not None:
        count = round((options.duration_s or DURATION_S) / model.sample_time_s)
        trial = Trial("run", "fit", np.linspace(0.0, count * model.sample_time_s, count + 1), {})
    else:
        raise UsageError(f"this model runs on the column '{model.source}': give a log with --input run.csv")
    applied = Applied(model, file, path, options.chosen)
    return Case(applied, applied.values(), trial, metadata, trial.inputs)


def _cruise(options: SimulateOptions, file: ParameterFile, path: Path, robot: Robot) -> _Made:
    frequency, amplitude, fin = _needed(options, "cruising", "frequency_hz", "amplitude_deg", "fin")
    unknown = [n.removeprefix("inertia_") for n in file.parameters if n.startswith("inertia_")]
    drag, place = catalogue.drag_file(file, path), robot_format.locate(robot.name)
    model = propulsion.recoil_model(robot, [fin, *unknown], drag, unknown=unknown, path=place)
    for name, law in (("frequency_exponent", 3.0), ("amplitude_exponent", 2.0)):
        value = options.chosen.get(name, law)
        if name in file.parameters and name not in options.chosen:
            value = file.parameters[name].value
        if value != law:
            raise UsageError(
                f"{name} is not that of the law; its reference is in the fitted table: give it with --trials"
            )
    inputs = {
        "frequency_hz": np.array([frequency]),
        "amplitude_rad": np.deg2rad([float(amplitude)]),
        "distance_m": np.array([options.distance_m or FAR_M]),
    }
    trial = Trial(fin, "fit", np.zeros(1), {}, inputs=inputs, cruise=CruiseInput(fin, model.fins[fin]))

    def compute(values: Array) -> dict[str, Quantity]:
        mean = float(model.simulate(values, trial)[SPEED][0])
        terminal = mean / float(velocity_ratio(model.b1, 0.0, options.distance_m or FAR_M))
        quantities = {"terminal_speed_m_s": Quantity(terminal, "m/s")}
        if options.distance_m is not None:
            quantities[SPEED] = Quantity(mean, "m/s")
        return {**quantities, "propulsive_force_N": Quantity(model.drag_area_kg_m * terminal**2, "N")}

    extra = _table(fin, {**inputs, "distance_m": np.array([options.distance_m or math.nan])})
    extra["amplitude_deg"] = np.array([amplitude])
    return model, trial, {"experiment": "cruise"}, {"extra": extra, "quantities": _each(compute)}


def _table(fin: str, inputs: Mapping[str, Array]) -> dict[str, Any]:
    """Return the columns of a cruise table without the speed."""
    return {
        "fin": [fin] * len(inputs["frequency_hz"]),
        "frequency_hz": inputs["frequency_hz"],
        "amplitude_deg": np.rad2deg(inputs["amplitude_rad"]),
        "distance_m": inputs["distance_m"],
    }


def _surge(options: SimulateOptions, file: ParameterFile, path: Path, robot: Robot) -> _Made:
    frequency, amplitude = _needed(options, "a beat", "frequency_hz", "amplitude_deg")
    model = SurgeModel(amplitudes_rad=[1.0], frequencies_hz=[1.0], speed_m_s=0.1)
    catalogue.set_references(model, file, path)
    trial = Trial("run", "fit", _times(options), {}, surge=SurgeInput(frequency, math.radians(amplitude)))

    def compute(values: Array) -> dict[str, Quantity]:
        return {"last_speed_m_s": Quantity(float(model.simulate(values, trial)["u_m_s"][-1]), "m/s")}

    drive = {"frequency_hz": frequency, "amplitude_deg": amplitude}
    return model, trial, {"experiment": "free-swim", "drive": drive}, {"quantities": _each(compute)}
