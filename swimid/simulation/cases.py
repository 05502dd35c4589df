"""The runs ``swimid simulate`` is asked for, as cases: a beat, a weight, an input log, recorded trials."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from swimid.blackbox import trials as arma
from swimid.errors import InputError, UsageError, suggestion
from swimid.files.provenance import Input
from swimid.fitting import drives
from swimid.fitting.drives import CruiseInput, Cycle, RigInput, SurgeInput, SwimInput
from swimid.fitting.model import Array, Trial
from swimid.logs import log as log_format
from swimid.logs import trials as trials_format
from swimid.logs.beat import find_beat
from swimid.logs.trials import StrokeDrive, TrialSet
from swimid.notices import warn
from swimid.propulsion import trials as propulsion
from swimid.propulsion.model import SPEED, RecoilModel, SurgeModel, velocity_ratio
from swimid.results import parameters as parameters_format
from swimid.results.parameters import ParameterFile
from swimid.rig import model as rig
from swimid.robots import file as robot_format
from swimid.robots.file import Robot
from swimid.simulation import catalogue
from swimid.simulation.applied import Applied, Quantity
from swimid.simulation.options import SimulateOptions
from swimid.simulation.run import Case, Quantities
from swimid.simulation.swim_quantities import Steady
from swimid.swimmer import stroke_cycles
from swimid.swimmer import trials as swimmer
from swimid.swimmer.model import Swimmer
from swimid.swimmer.planar import drive

#: Length and rate of a run where nothing else says.
DURATION_S, RATE_HZ = 15.0, 50.0
#: More integration steps than this are taken for a slip.
MOST_STEPS = 20_000_000
#: A course so long that the start from rest does not matter.
FAR_M = 1e9
#: A joint bent farther than this is no swimming beat.
STEEPEST_DEG = 90.0


def place(options: SimulateOptions) -> Path | None:
    """What the parameters are called in messages and logs."""
    return None if options.params is None else parameters_format.place(options.params)


def _case(
    options: SimulateOptions,
    applied: Applied,
    trial: Trial,
    robot: str,
    *,
    extra: Mapping[str, Any] | None = None,
    quantities: Quantities | None = None,
    per_run: bool = False,
    **metadata: Any,
) -> Case:
    comments = _metadata(options, robot, **metadata)
    return Case(trial.id, applied, applied.values(), trial, extra or {}, comments, quantities, per_run)


def _metadata(options: SimulateOptions, robot: str, **more: Any) -> dict[str, Any]:
    """Comment lines every log has."""
    path = place(options)
    return {
        "robot": robot,
        **({} if path is None else {"params": path.name}),
        **({"set": dict(options.chosen)} if options.chosen else {}),
        **({"readings": dict(options.readings)} if options.readings else {}),
        **more,
    }


def _times(options: SimulateOptions, stroke: Cycle | None = None) -> Array:
    """Even sample times of the run, s; as long as the stroke's cycles where they are counted."""
    whole = DURATION_S if stroke is None or math.isinf(stroke.cycles) else stroke.cycles / stroke.frequency_hz
    duration = options.duration_s or whole
    rate = options.sample_rate_hz or RATE_HZ
    if duration * max(rate, 1.0 / options.dt) > MOST_STEPS:
        raise UsageError(f"{duration:g} s at this rate and step are too many samples")
    count = max(round(duration * rate), 1)
    return np.arange(count + 1) / rate


def _needed(options: SimulateOptions, what: str, *names: str) -> list[Any]:
    """These options, without each of which the run is refused."""
    for name in names:
        if getattr(options, name) is None:
            raise UsageError(f"{what} needs --{name.replace('_', '-')}")
    return [getattr(options, name) for name in names]


def of_options(options: SimulateOptions) -> Case:
    """The one run the options describe.

    Raises
    ------
    UsageError
        When options are missing that this model needs.
    InputError
        For anything wrong in a file.
    """
    path = place(options)
    if path is None:
        if options.robot is None:
            raise UsageError("name a parameter file (--params) or a robot (--robot)")
        return _swim(options, None, options.robot, None)
    file = catalogue.read_parameters(options.params)
    if file.model in ("multilink", "multibody"):
        return _swim(options, file, *catalogue.robot_of_parameters(file, path, options.robot))
    if options.readings:
        raise UsageError(f"--reading belongs to robots with links, not to the model '{file.model}'")
    makers = {
        "falling-weight": _falling_weight,
        "towed": _towed,
        "arma": _arma,
        RecoilModel.name: _cruise,
        SurgeModel.name: _surge,
    }
    if file.model not in makers:
        raise UsageError(
            f"the model '{file.model}' can be simulated for recorded trials only",
            hint="give them with --trials",
        )
    return makers[file.model](options, file, path)


def of_trials(
    trials: str | Path | TrialSet, options: SimulateOptions, only: str | None
) -> tuple[list[Case], Sequence[Input]]:
    """Recorded trials with their own drives and start states, and everything that was read for them.

    Raises
    ------
    UsageError
        For a trial that is not there; without a parameter file.
    InputError
        For anything wrong in a file.
    """
    if options.params is None:
        raise UsageError("--trials needs a parameter file: --params")
    experiment, applied = catalogue.load(trials, options)
    names = [t.id for t in experiment.trials]
    if only is not None and only not in names:
        hint = suggestion(only, names)
        name = trials_format.place(trials).name
        raise UsageError(f"there is no trial '{only}' in {name}", hint=hint)
    model = experiment.model
    cases = []
    for trial in experiment.trials:
        if only not in (None, trial.id):
            continue
        values = applied.values(trial.id)
        metadata = _metadata(options, experiment.robot.name, experiment=experiment.name, trial=trial.id)
        extra: dict[str, Any] = dict(trial.inputs) if experiment.name in ("towed", "arma") else {}
        quantities = None
        if model.swimmer is not None:
            if trial.swim.drive is not None:
                metadata["drive"] = drive_block(trial.swim)
            metadata["dt_s"] = model.swimmer.max_step
            extra = commands(model.swimmer, trial, values)
            quantities = _swim_quantities(model.swimmer, trial, values)
        elif model.timed_runs:
            extra = {
                "fin": [trial.id] * len(trial.time_s),
                "frequency_hz": trial.inputs["frequency_hz"],
                "amplitude_deg": np.rad2deg(trial.inputs["amplitude_rad"]),
                "distance_m": trial.inputs["distance_m"],
            }
        cases.append(Case(trial.id, applied, values, trial, extra, metadata, quantities, model.timed_runs))
    return cases, experiment.inputs


# ------------------------------------------------------------ swimmers with links


def _swim(options: SimulateOptions, file: ParameterFile | None, name: str, folder: Path | None) -> Case:
    readings = {**(file.settings.get("readings", {}) if file else {}), **options.readings}
    robot, model = swimmer.robot_model(name, folder, readings=readings, max_step=options.dt)
    applied = Applied(model, file, place(options), options.chosen)
    values = applied.values()
    try:
        model.check(values)
    except InputError as error:
        raise InputError(
            f"with these parameters, {error.reason}",
            file=place(options) or robot_format.locate(name, folder),
            column=error.column,
        ) from error
    swim = SwimInput(pose=(0.0,) * len(model.pose) if model.free_base else None)
    beaten = options.frequency_hz is not None or options.amplitude_deg is not None
    metadata: dict[str, Any] = {
        "experiment": "free-swim" if model.free_base and not model.in_space else "multibody",
        "dt_s": options.dt,
    }
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
            raise UsageError(f"the robot '{robot.name}' has no driven joint: there is nothing to beat")
        time = _times(options)
    if swim.drive is not None:
        metadata["drive"] = drive_block(swim)
    trial = Trial("run", "fit", time, {}, swim=swim)
    return _case(
        options,
        applied,
        trial,
        robot.name,
        extra=commands(model, trial, values),
        quantities=_swim_quantities(model, trial, values),
        **metadata,
    )


def drive_block(swim: SwimInput) -> dict[str, Any]:
    """A beat or a stroke as the ``drive`` of a trials file."""
    if swim.stroke is not None:
        stroke = swim.stroke
        return {
            "stroke": stroke.name,
            "frequency_hz": stroke.frequency_hz,
            "scale": stroke.scale,
            "ramp_s": stroke.ramp_s,
            **({} if math.isinf(stroke.cycles) else {"cycles": stroke.cycles}),
        }
    beat = swim.beat
    assert beat is not None
    return {
        "waveform": beat.waveform,
        "frequency_hz": beat.frequency_hz,
        "amplitude_deg": float(f"{math.degrees(beat.amplitude_rad):.12g}"),
        "bias_deg": float(f"{math.degrees(beat.bias_rad):.12g}"),
        "asymmetry": beat.asymmetry,
        "ramp_s": beat.ramp_s,
        **({"phase_deg": math.degrees(beat.phase_rad)} if beat.phase_rad else {}),
    }


def _stroke(name: str, options: SimulateOptions) -> StrokeDrive:
    if options.amplitude_deg is not None or options.bias_deg or options.asymmetry:
        raise UsageError(
            "--stroke takes the place of a beat: leave out --amplitude-deg, --bias-deg, --asymmetry"
        )
    # a beat is eased in by default, a stroke begins as it is
    ramp = 0.0 if options.ramp_s == options.declared()["ramp_s"].default else options.ramp_s
    return StrokeDrive(
        stroke=name,
        frequency_hz=options.frequency_hz,
        scale=options.scale,
        ramp_s=ramp,
        cycles=options.cycles,
    )


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
        bias_gain = law.gain if law.bias_gain is None else law.bias_gain
        bend = abs(law.gain) * amplitude + abs(bias_gain * options.bias_deg)
        if bend > STEEPEST_DEG:
            warn("SWM054", f"{axis.name} bends by up to {bend:.0f} degrees")
            break
    if options.asymmetry and options.waveform != "a-cpg":
        warn("SWM004", f"--asymmetry belongs to the waveform a-cpg; a {options.waveform} has none")
    return drives.Beat(
        options.waveform,
        f,
        math.radians(amplitude),
        math.radians(options.bias_deg),
        options.asymmetry if options.waveform == "a-cpg" else 0.0,
        options.ramp_s,
    )


def _recorded_joints(path: Path, options: SimulateOptions, model: Swimmer) -> tuple[Array, list[Any]]:
    """Sample times, and each driven joint's motion from a log."""
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
    if options.sample_rate_hz is None:
        return log.time_s[log.time_s <= end], joints
    return begin + np.arange(int((end - begin) * options.sample_rate_hz) + 1) / options.sample_rate_hz, joints


def commands(model: Swimmer, trial: Trial, values: Array) -> dict[str, Array]:
    """Commanded angle of every driven joint, rad, as the columns of a log."""
    phase = float(values[model.index("drive_phase")])
    time = trial.time_s - float(values[model.index("clock_offset")])
    return {
        axis.column.replace("joint", "cmd"): model.command(k, trial.swim, time, phase)
        for k, axis in enumerate(model.driven)
    }


def beat_frequency(
    model: Swimmer, trial: Trial, values: Array, measured: Sequence[Array] = ()
) -> float | None:
    """Frequency of a run's beat, Hz: the drive's, else that of its driven joints, else of ``measured``."""
    if trial.swim.drive is not None:
        return float(trial.swim.drive.frequency_hz)
    for angle in (*commands(model, trial, values).values(), *measured):
        beat = find_beat(trial.time_s, angle)
        if beat is not None:
            return beat.frequency_hz
    return None


def _swim_quantities(model: Swimmer, trial: Trial, values: Array) -> Quantities | None:
    """From parameter vectors to what the last beats come to, or each stroke; None without a beat."""
    frequency = beat_frequency(model, trial, values)
    if frequency is None:
        return None
    if model.body is None:
        return _stroke_quantities(model, trial, frequency)
    steady = Steady.of(model, trial, frequency)
    if steady is None:
        return None

    def compute(values: Array) -> dict[str, Quantity]:
        columns, energetics = model.with_energetics([(values, steady.trial)], [steady.window.length_s])[0]
        return steady.quantities(model, values, columns, energetics)

    return compute


def _stroke_quantities(model: Swimmer, trial: Trial, frequency: float) -> Quantities | None:
    """From parameter vectors to what each stroke comes to; None where not one is whole."""
    windows = stroke_cycles.windows(trial.time_s, frequency)

    def compute(values: Array) -> dict[str, Quantity]:
        columns = model.attempt(values, trial)
        return {
            f"cycle_{k}_{name}": Quantity(value, stroke_cycles.QUANTITIES[name])
            for k, window in enumerate(windows, 1)
            for name, value in stroke_cycles.quantities(trial.time_s, columns, window).items()
        }

    return compute if windows else None


# ------------------------------------------------------------ other models


def _robot(options: SimulateOptions, file: ParameterFile, path: Path) -> Robot:
    return robot_format.read(*catalogue.robot_of_parameters(file, path, options.robot))


def _rig_body(file: ParameterFile, robot: Robot) -> tuple[float, bool, float]:
    """Mass of the body (kg), whether its drag coefficient is known, and ``rho A / 2`` (kg/m)."""
    mass, area = robot.body.inertial_mass_kg, robot.body.frontal_area_m2
    known = "drag_coefficient" in file.parameters
    if known and area is None:
        raise InputError(f"the robot '{robot.name}' has no body.frontal_area_m2 for its drag coefficient")
    if mass is None:
        raise InputError(f"the robot '{robot.name}' has no body.inertial_mass_kg")
    return mass, known, 0.5 * robot.fluid.density_kg_m3 * (area or 0.0)


def _falling_weight(options: SimulateOptions, file: ParameterFile, path: Path) -> Case:
    (pulling,) = _needed(options, "a falling weight", "pulling_mass_kg")
    robot = _robot(options, file, path)
    mass, known, factor = _rig_body(file, robot)
    force = pulling * robot.fluid.gravity_m_s2
    inertia = mass + pulling + robot.rig.pulley_inertia_kg
    model = rig.falling_weight(mass_kg=inertia, force_N=force, area_known=known, pulley=True)
    on_rig = RigInput(inertia, force, pulley=True, area_factor=factor, release_s=0.0)
    trial = Trial("run", "fit", _times(options), {}, rig=on_rig)

    def compute(values: Array) -> dict[str, Quantity]:
        c = model.coefficients(values, on_rig)
        net = force - c["dry"]
        quantities = {}
        if net > 0 and (c["quadratic"] > 0 or c["linear"] > 0):
            # q v^2 + l v = F
            top = 2 * net / (c["linear"] + math.sqrt(c["linear"] ** 2 + 4 * c["quadratic"] * net))
            quantities["terminal_speed_m_s"] = Quantity(top, "m/s")
        simulated = model.simulate(values, trial)
        quantities["last_speed_m_s"] = Quantity(float(simulated[model.speed][-1]), "m/s")
        quantities["distance_m"] = Quantity(float(simulated["x_m"][-1]), "m")
        return quantities

    applied = Applied(model, file, path, options.chosen)
    metadata: dict[str, Any] = {"experiment": "falling-weight", "pulling_mass_kg": pulling}
    return _case(options, applied, trial, robot.name, quantities=compute, **metadata)


def _towed(options: SimulateOptions, file: ParameterFile, path: Path) -> Case:
    (source,) = _needed(options, "towing", "input")
    robot = _robot(options, file, path)
    mass, known, factor = _rig_body(file, robot)
    log = log_format.read(source, required=("force_N",), optional=())
    force = log["force_N"]
    if np.isnan(force).any():
        raise InputError("the applied force is missing in places", file=log.path, column="force_N")
    largest = max(float(np.abs(force).max()), 1e-9)
    model = rig.towed(mass_kg=mass, force_N=largest, area_known=known)
    on_rig = RigInput(mass, area_factor=factor, release_s=float(log.time_s[0]))
    trial = Trial("run", "fit", log.time_s, {}, inputs={"force_N": force}, rig=on_rig)
    applied = Applied(model, file, path, options.chosen)
    metadata: dict[str, Any] = {"experiment": "towed", "input": source.name}
    return _case(options, applied, trial, robot.name, extra=trial.inputs, **metadata)


def _arma(options: SimulateOptions, file: ParameterFile, path: Path) -> Case:
    model = arma.model_of(file, path)
    applied = Applied(model, file, path, options.chosen)
    robot = options.robot or file.robot or "unknown"
    if options.input is None:
        if model.sine is None:
            raise UsageError(
                f"this model runs on the column '{model.source}': give a log with --input run.csv"
            )
        count = round((options.duration_s or DURATION_S) / model.sample_time_s)
        trial = Trial("run", "fit", np.linspace(0.0, count * model.sample_time_s, count + 1), {})
        return _case(options, applied, trial, robot, experiment="arma")
    wanted = () if model.sine else (model.source,)
    log = log_format.read(options.input, required=wanted, optional=(model.output,))
    measured = {model.output: log[model.output]} if model.output in log else {}
    trial = Trial("run", "fit", log.time_s, measured, inputs={name: log[name] for name in wanted})
    metadata: dict[str, Any] = {"experiment": "arma", "input": options.input.name}
    return _case(options, applied, trial, robot, extra=trial.inputs, **metadata)


def _cruise(options: SimulateOptions, file: ParameterFile, path: Path) -> Case:
    frequency, amplitude, fin = _needed(options, "cruising", "frequency_hz", "amplitude_deg", "fin")
    distance = options.distance_m
    robot = _robot(options, file, path)
    drag_path = catalogue.drag_file(file, path)
    drag = parameters_format.read(drag_path, model=("falling-weight", "towed", "free-decay"))
    area, mass = propulsion.drag_numbers(drag, parameters_format.place(drag_path), robot)
    unknown = [n.removeprefix("inertia_") for n in file.parameters if n.startswith("inertia_")]
    inertias = propulsion.fin_inertias(robot, [fin, *unknown], robot_format.locate(robot.name))
    fins = {name: None if name in unknown else inertia for name, inertia in inertias.items()}
    model = RecoilModel(drag_area_kg_m=area, moving_mass_kg=mass, fins=fins)
    applied = Applied(model, file, path, options.chosen)
    values = applied.values()
    for name, law in (("frequency_exponent", 3.0), ("amplitude_exponent", 2.0)):
        if values[model.index(name)] != law:
            raise UsageError(
                f"{name} is not that of the law; its reference is in the fitted table: give it with --trials"
            )
    inputs = {
        "frequency_hz": np.array([frequency]),
        "amplitude_rad": np.deg2rad([float(amplitude)]),
        "distance_m": np.array([distance or FAR_M]),
    }
    trial = Trial(fin, "fit", np.zeros(1), {}, inputs=inputs, cruise=CruiseInput(fin, fins[fin]))

    def compute(values: Array) -> dict[str, Quantity]:
        mean = float(model.simulate(values, trial)[SPEED][0])
        terminal = mean / float(velocity_ratio(model.b1, 0.0, distance or FAR_M))
        quantities = {"terminal_speed_m_s": Quantity(terminal, "m/s")}
        if distance is not None:
            quantities[SPEED] = Quantity(mean, "m/s")
        quantities["propulsive_force_N"] = Quantity(area * terminal**2, "N")
        return quantities

    extra = {
        "fin": [fin],
        "frequency_hz": inputs["frequency_hz"],
        "amplitude_deg": np.array([amplitude]),
        "distance_m": np.array([distance or math.nan]),
    }
    return _case(
        options,
        applied,
        trial,
        robot.name,
        extra=extra,
        quantities=compute,
        per_run=True,
        experiment="cruise",
    )


def _surge(options: SimulateOptions, file: ParameterFile, path: Path) -> Case:
    frequency, amplitude = _needed(options, "a beat", "frequency_hz", "amplitude_deg")
    robot = _robot(options, file, path)
    model = SurgeModel(amplitudes_rad=[1.0], frequencies_hz=[1.0], speed_m_s=0.1)
    catalogue.set_references(model, file, path)
    applied = Applied(model, file, path, options.chosen)
    surge = SurgeInput(frequency, math.radians(amplitude))
    trial = Trial("run", "fit", _times(options), {}, surge=surge)

    def compute(values: Array) -> dict[str, Quantity]:
        return {"last_speed_m_s": Quantity(float(model.simulate(values, trial)["u_m_s"][-1]), "m/s")}

    drive = {"frequency_hz": frequency, "amplitude_deg": amplitude}
    return _case(options, applied, trial, robot.name, quantities=compute, experiment="free-swim", drive=drive)
