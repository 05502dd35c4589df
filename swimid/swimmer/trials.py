"""Reading and checking of free-swimming and multibody trials of a robot with links."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import NDArray

from swimid.errors import InputError, UsageError, suggestion
from swimid.fitting import drives, fit_common
from swimid.fitting.drives import Cycle
from swimid.fitting.fit_common import Experiment, read_trial_log
from swimid.fitting.model import Array, SwimInput, Trial
from swimid.kinematics.course import compare_course, is_in_degrees
from swimid.kinematics.frequency import compare_frequencies
from swimid.logs.experiments import Drive, FreeSwimTrial, Params, StrokeDrive
from swimid.logs.log import Log, unwrap_angle
from swimid.notices import warn
from swimid.robots import file as robot_format
from swimid.robots.file import Robot
from swimid.swimmer import drive as driven
from swimid.swimmer.model import Swimmer
from swimid.swimmer.options import STEP_S
from swimid.swimmer.planar.model import MultilinkModel
from swimid.swimmer.tree import Actuated

#: Minimum initial speed of a log that begins in motion: as a fraction of the maximum speed in the log, and as
#: a number of standard errors of the initial speed. Both must be exceeded.
MIN_SHARE, MIN_ERRORS = 0.05, 4.0
#: Length of the opening of a log: this time in s, or this number of sampling intervals if that is longer.
OPENING_S, OPENING_STEPS = 0.3, 8
#: Minimum number of samples in the opening of a log for an estimate of position or speed.
MIN_OPENING = 7
#: Minimum F ratio at which the opening of a log is fitted by a polynomial two orders higher than the simplest
#: one.
MIN_F_RATIO = 6.0
#: Maximum start time of a log that begins at rest, as a fraction of the duration of its drive's ramp.
MAX_RAMP_SHARE = 0.3
#: Minimum number of samples of a joint angle that drives a trial (MIN_JOINT_SAMPLES), and of a heading whose
#: beat frequency is estimated (MIN_BEAT_SAMPLES).
MIN_JOINT_SAMPLES, MIN_BEAT_SAMPLES = 5, 17
#: Number of drive phases that are tried as start values for a trial that begins in steady swimming.
N_PHASES = 12


def robot_model(
    name: str,
    relative_to: Path | None = None,
    *,
    readings: Mapping[str, str] | None = None,
    max_step: float = STEP_S,
) -> tuple[Robot, Swimmer]:
    """Return a robot with links and its model, in 3-D or in a plane as the robot file describes it.

    Parameters
    ----------
    name : str
        Name of a built-in robot, or path of a robot file.
    relative_to : Path, optional
        Folder for relative paths.
    readings : mapping, optional
        Interpretations of the robot's source that replace those of the file.
    max_step : float, s
        Maximum integration step.

    Raises
    ------
    InputError
        For any error in the robot file, with file and line, and for a robot without links.
    """
    robot = robot_format.read(name, relative_to, readings=readings)
    path = robot_format.locate(name, relative_to)
    if robot.multilink is None and robot.multibody is None:
        raise InputError(
            f"the robot '{robot.name}' has no 'multilink' or 'multibody' part: links, joints and elements",
            file=path,
            hint="fit-drag and fit-propulsion serve robots that are one body",
        )
    try:
        if robot.multibody is None:
            return robot, MultilinkModel(robot, max_step=max_step)
        from swimid.swimmer.spatial.model import MultibodyModel

        return robot, MultibodyModel(robot, max_step=max_step)
    except InputError as error:
        raise robot_format.add_location(error, path) from error


@dataclass(frozen=True)
class RobotTrial:
    """A trial in three forms: its entry in the trials file, its log, and the input of the model.

    Attributes
    ----------
    entry : FreeSwimTrial
    log : Log
    trial : Trial
    state : str
        State at the first sample: ``rest``, ``estimate`` or ``steady``.
    """

    entry: FreeSwimTrial
    log: Log
    trial: Trial
    state: str


def load(
    entries: Any,
    path: Path,
    *,
    command: str = "",
    params: Params | None = None,
    readings: Mapping[str, str] | None = None,
    channels: Sequence[str] = (),
    start_state: str = "auto",
    max_step: float = STEP_S,
) -> Experiment:
    """Read the logs of a free-swim or multibody trials file, and return the model of the robot with links.

    Parameters
    ----------
    entries : Trials
        Content of the trials file.
    path : Path
        Trials file.
    command : str
        Command that fits the trials.
    params : (Path, ParameterFile), optional
        Parameters, which state the readings and the start state of their fit.
    readings : mapping, optional
        Interpretations of the robot's source that replace those of the parameters and of the robot file.
    channels : sequence of str
        Columns to fit. By default these are the pose if it is logged, otherwise the velocities, and the
        logged angles of passive joints and of driven joints behind a servo or a shared actuator.
    start_state : {"auto", "rest", "estimate", "steady"}
        State at the first sample. ``auto`` takes the state of the parameters, or else the key ``start_state``
        of each trial. Without that key, the opening of the log decides. ``steady`` is the limit cycle under
        the trial's drive.
    max_step : float, s
        Maximum integration step.

    Raises
    ------
    InputError
        For any error in the trials file, the robot file or a log.
    UsageError
        For a channel that the robot does not have.
    """
    if params is not None:
        settings = params[1].settings
        readings = {**settings.get("readings", {}), **(readings or {})}
        if start_state == "auto":
            start_state = settings.get("start_state", "auto")
    robot, model = robot_model(entries.robot, path.parent, readings=readings, max_step=max_step)
    known = [c.name for c in model.channels]
    for name in channels:
        if name not in known:
            raise UsageError(f"the robot has no channel '{name}'", hint=suggestion(name, known, "it has"))
    recordings = [_recording(entry, path, model, channels, start_state) for entry in entries.trials]
    facts = {
        "beats": {r.trial.id: _beat(r.entry, r.log, model) for r in recordings},
        "profiles": {entry.id: _profile(entry) for entry in entries.trials},
    }
    trials = _with_starts(recordings, model)
    _check_course(path, model, recordings)
    robot_path = robot_format.locate(entries.robot, path.parent)
    sources = [r.log.source for r in recordings]
    return Experiment.of(entries, path, model, trials, sources, robot, facts=facts, robot_path=robot_path)


# ---------------------------------------------------------------- one trial


def _recording(
    entry: FreeSwimTrial, path: Path, model: Swimmer, channels: Sequence[str], start_state: str
) -> RobotTrial:
    """Read the log of a trial, and return the trial with its log and the input of the model."""
    known = [c.name for c in model.channels]
    optional = tuple(dict.fromkeys((*known, *input_columns(model))))
    log = read_trial_log(entry, path.parent, required=tuple(channels), optional=optional)
    turning = {name: values for name, values in log.columns.items() if not name.startswith("joint")}
    columns = log.columns | {name: unwrap_angle(name, values) for name, values in turning.items()}
    log = replace(log, columns=columns)
    measured = {name: log[name] for name in (channels or _default_channels(model, log))}
    others = {n: v for n, v in log.columns.items() if n in known and n not in measured}
    swim = replace(_drive_input(entry, log, path, model), pose=_first_pose(model, log))
    trial = Trial(entry.id, entry.role, log.time_s, measured, inputs=others, swim=swim)
    moving = _begins_in_motion(trial, log, model)
    return RobotTrial(entry, log, trial, _start_state(entry, start_state, moving, model, path))


def _drive_input(entry: FreeSwimTrial, log: Log, path: Path, model: Swimmer) -> SwimInput:
    """Return the input of the model for a trial: its drive, and the coefficients that its entry sets.

    The drive is a stroke, a beat, or logged joint angles.
    """
    for name in entry.coefficients:
        if name not in model.coefficients:
            raise InputError(
                f"the trial '{entry.id}' sets '{name}', which is no coefficient of the robot",
                file=path,
                column="coefficients",
                hint=suggestion(name, model.coefficients, "it has"),
            )
    swim = SwimInput(coefficients=dict(entry.coefficients), inputs=read_inputs(model, log))
    if isinstance(entry.drive, StrokeDrive):
        return replace(swim, stroke=cycle_of(entry.drive, model, path))
    if entry.drive is not None:
        return replace(swim, beat=_beat_of(entry.drive))
    return with_logged_joints(swim, model, log)


def read_inputs(model: Swimmer, log: Log) -> dict[str, Callable[[Array], Array]]:
    """Return the value of each input of a robot as a function of time.

    The value is linear between the samples of its column, and constant before and after them.

    Raises
    ------
    InputError
        The log lacks the column, or the column has fewer than two values.
    """
    found: dict[str, Any] = {}
    for name, law in model.inputs.items():
        values = log.columns.get(law.column, np.empty(0))
        known = np.isfinite(values)
        if known.sum() < 2:
            text = f"the input '{name}' of the robot needs this column with at least 2 values"
            raise InputError(
                text, file=log.path, column=law.column, hint="or name another column in the robot file"
            )
        found[name] = partial(np.interp, xp=log.time_s[known], fp=values[known])
    return found


def with_logged_joints(swim: SwimInput, model: Swimmer, log: Log) -> SwimInput:
    """Return the input of a model with the motions of its actuators from a log.

    Raises
    ------
    InputError
        The log lacks the angle and the command of an actuator.
    """
    if not model.actuators:
        return swim
    motions = [_read_motion(actuator, log) for actuator in model.actuators]
    commanded = any(is_command for _, is_command in motions)
    return replace(swim, joints=[motion for motion, _ in motions], commanded=commanded)


def _beat_of(command: Drive) -> drives.TailBeat:
    """Return the beat that an entry of a trials file states, in SI units."""
    return drives.TailBeat(
        command.waveform,
        command.frequency_hz,
        math.radians(command.amplitude_deg),
        math.radians(command.bias_deg),
        command.asymmetry,
        command.ramp_s,
        math.radians(command.phase_deg),
    )


def cycle_of(command: StrokeDrive, model: Swimmer, path: Path | None = None) -> Cycle:
    """Return a stroke of the robot file, with the frequency and scale that a trial commands.

    Parameters
    ----------
    command : StrokeDrive
    model : Swimmer
    path : Path, optional
        Trials file that contains the command, for error messages. Without a file, the command is an option.

    Raises
    ------
    InputError, UsageError
        If the robot has no such stroke.
    """
    known = {}
    if model.robot.multibody is not None:
        known = model.robot.multibody.strokes
    if command.stroke not in known:
        text = f"the robot '{model.robot.name}' has no stroke '{command.stroke}'"
        hint = suggestion(command.stroke, list(known), "it has")
        if path is None:
            raise UsageError(text, hint=hint)
        raise InputError(text, file=path, column="drive.stroke", hint=hint)
    law = known[command.stroke]
    return Cycle(
        command.stroke,
        law,
        command.frequency_hz or 1.0 / law.period_s,
        command.scale,
        command.ramp_s,
        command.cycles or math.inf,
        math.radians(command.phase_deg),
    )


def input_columns(model: Swimmer) -> list[str]:
    """Return the log columns of angles and commands of the actuators, and of the inputs."""
    angles = [actuator.column for actuator in model.actuators]
    commands = [actuator.command for actuator in model.actuators]
    return [*angles, *commands, *(law.column for law in model.inputs.values())]


def _read_motion(actuator: Actuated, log: Log) -> tuple[Any, bool]:
    """Return the motion of an actuator from its log, and whether this motion is a command.

    The measured angle is preferred, except that the commanded angle is preferred for an actuator with a
    servo. An actuator with a gain of 0 stays straight if neither angle is logged.
    """
    law, command = actuator.law, actuator.command
    candidates = [actuator.column, command]
    if law.servo is not None:
        candidates.reverse()
    for candidate in candidates:
        if candidate in log and np.isfinite(log[candidate]).sum() >= MIN_JOINT_SAMPLES:
            spline = driven.fit_spline(log.time_s, log[candidate])
            return driven.spline_motion(spline), candidate == command
    if law.gain == 0.0 and not law.bias_gain:
        return drives.straight, False
    raise InputError(
        f"the driven joint or actuator '{actuator.name}' needs this column or '{command}'",
        file=log.path,
        line=log.first_line - 1 if log.first_line else None,
        column=actuator.column,
        hint="add the column, or give the trial a 'drive' in the trials file",
    )


def _default_channels(model: Swimmer, log: Log) -> list[str]:
    """Return the log columns that are fitted if the user names no channels."""

    def select_logged(names: Sequence[str]) -> list[str]:
        return [n for n in names if n in log and np.isfinite(log[n]).sum() > 1]

    chosen = []
    if model.free_base:
        pose = select_logged(model.pose)
        # for a robot in 3-D, a side view that shows only part of the pose is sufficient
        complete = len(pose) == 3 or (model.in_space and len(pose) > 1)
        chosen = (complete and pose) or select_logged(model.velocity) or pose
    else:
        chosen = select_logged(model.reactions)
    chosen += select_logged([a.column for a in model.passive])
    chosen += select_logged([a.column for a in model.driven if a.law and a.law.is_computed])
    if not chosen:
        names = ", ".join(c.name for c in model.channels)
        raise InputError("holds none of the robot's channels", file=log.path, hint=f"channels: {names}")
    return chosen


def _profile(entry: FreeSwimTrial) -> str:
    """Return the name of a trial's motion profile, which describes its drive.

    If measured joint angles drive the trial, the name is the identifier of the trial.
    """
    command = entry.drive
    if command is None:
        return entry.id
    if isinstance(command, StrokeDrive):
        parts = [command.stroke]
        if command.frequency_hz:
            parts.append(f"{command.frequency_hz:g} Hz")
        if command.scale != 1.0:
            parts.append(f"scale {command.scale:g}")
        return ", ".join(parts)
    parts = [command.waveform, f"{command.frequency_hz:g} Hz", f"{command.amplitude_deg:g} deg"]
    if command.bias_deg:
        parts.append(f"bias {command.bias_deg:g} deg")
    return ", ".join(parts)


# ---------------------------------------------------------------- start of a trial


def _first_pose(model: Swimmer, log: Log) -> tuple[float, ...] | None:
    """Return the first pose in a log, with zero for coordinates that the log lacks.

    Return None if the base is fixed, or if the log of a robot in a plane lacks the position.
    """
    if not model.free_base or (not model.in_space and any(name not in log for name in model.pose[:2])):
        return None
    first = []
    for name in model.pose:
        values = log.columns.get(name, np.empty(0))
        first.append(float(next(iter(values[np.isfinite(values)]), 0.0)))
    if _lacks_heading(model, log):
        first[2] = _first_course(log[model.pose[0]], log[model.pose[1]])
    return tuple(first)


def _lacks_heading(model: Swimmer, log: Log) -> bool:
    """Return whether the log of a robot in a plane has the position but not the heading.

    The track of a single marker is such a log.
    """
    if not model.free_base or model.in_space:
        return False
    x, y, heading = (name in log and bool(np.isfinite(log[name]).any()) for name in model.pose)
    return x and y and not heading


def _first_course(x: Array, y: Array) -> float:
    """Return the direction (rad) in which a track begins.

    The direction is that from the first point of the track to the first point at a quarter of the largest
    distance.
    """
    known = np.isfinite(x) & np.isfinite(y)
    along, across = x[known] - x[known][0], y[known] - y[known][0]
    gone = np.hypot(along, across)
    at = int(np.argmax(gone >= 0.25 * gone.max()))
    return math.atan2(across[at], along[at])


def _start_state(entry: FreeSwimTrial, chosen: str, moving: bool, model: Swimmer, path: Path) -> str:
    """Return the state in which a trial begins: ``rest``, ``estimate`` or ``steady``.

    Raises
    ------
    InputError
        If ``steady`` is asked for a trial without a periodic drive.
    """
    state = entry.start_state if chosen == "auto" else chosen
    if state == "auto":
        return "estimate" if moving else "rest"
    if state == "steady" and entry.drive is None:
        raise InputError(
            f"the trial '{entry.id}' cannot begin in steady swimming: it has no 'drive'",
            file=path,
            column="start_state" if chosen == "auto" else "drive",
            hint="give the beat under 'drive', or start it from an estimated state (start_state: estimate)",
        )
    return state


def _with_starts(recordings: Sequence[RobotTrial], model: Swimmer) -> list[Trial]:
    """Free the parameters of the initial state in the model, and return trials with their start values."""
    measured = {name for r in recordings for name in r.trial.measured}
    free = _list_offsets(recordings, model, measured)
    initial = set(model.list_determined_starts(measured))
    estimated: dict[str, set[str]] = {"rest": set(), "estimate": initial, "steady": {"drive_phase"}}
    for r in recordings:
        free |= estimated[r.state]
    of_states = free & {"drive_phase", *initial}
    model.parameters = tuple(replace(p, free=p.free or p.name in free) for p in model.parameters)
    trials = []
    for r in recordings:
        held = tuple(sorted(of_states - estimated[r.state]))
        trial = replace(r.trial, held=held, starts=_start_values(r.trial, r.log, model))
        if r.state == "steady":
            trial = _with_phase(replace(trial, swim=trial.swim.make_steady()), model)
        trials.append(trial)
    return trials


def _list_offsets(recordings: Sequence[RobotTrial], model: Swimmer, measured: set[str]) -> set[str]:
    """Return the names of the offsets (and drifts) of the measured start pose or reactions."""
    if not model.free_base:
        channels = [name for name in model.reactions if name in measured]
        return {f"{word}_{name}" for word in ("offset", "drift") for name in channels}
    offsets = {name for name, column in zip(model.starts, model.pose, strict=True) if column in measured}
    for r in recordings:
        if _lacks_heading(model, r.log) and model.pose[0] in r.trial.measured:
            offsets.add(model.starts[2])
    return offsets


def _start_values(trial: Trial, log: Log, model: Swimmer) -> dict[str, float]:
    """Return start values for the initial state, estimated from the first samples of the log."""
    lacks_heading = _lacks_heading(model, log)

    def at_start(name: str, derivative: int) -> float | None:
        if lacks_heading and name == model.pose[2] and derivative == 0:
            return trial.swim.get_pose()[2]
        if name not in trial.measured:
            return None
        values = trial.measured[name]
        known = _is_opening(log) & np.isfinite(values)
        if known.sum() < MIN_OPENING:
            return None
        return _estimate_start(log.time_s[known] - log.time_s[0], values[known], derivative)[0]

    found: dict[str, float | None] = {}
    if model.free_base:
        found = model.start_velocities(at_start)
    for axis in model.passive:
        found[f"initial_angle_{axis.name}"] = at_start(axis.column, 0)
        rate = (axis.rate, 0) if axis.rate in trial.measured else (axis.column, 1)
        found[f"initial_rate_{axis.name}"] = at_start(*rate)
    return {name: value for name, value in found.items() if value is not None}


def _with_phase(trial: Trial, model: Swimmer) -> Trial:
    """Return the trial with a start value of the drive phase.

    The start value is the phase at which the robot with the coefficients of its file fits best.
    """
    stated = {**{p.name: p.start for p in model.parameters}, **model.get_file_values()}
    values = np.array([stated[p.name] for p in model.parameters])
    phases = np.linspace(0.0, 2.0 * math.pi, N_PHASES, endpoint=False)
    simulated = []
    for phase in phases:
        values[model.index("drive_phase")] = phase
        simulated.append(model.run(values.copy(), trial))
    model.forget([trial])
    if not all(np.isfinite(run[name]).all() for run in simulated for name in trial.measured):
        return trial
    errors = [_beat_error(trial, run) for run in simulated]
    return replace(trial, starts={**trial.starts, "drive_phase": float(phases[int(np.nanargmin(errors))])})


def _beat_error(trial: Trial, simulated: Mapping[str, Array]) -> float:
    """Return the squared error of a trial divided by the squared measurement, summed over channels.

    Trends and the direction of the path are removed, because they do not belong to the beat.
    """
    total = 0.0
    measured, simulated = fit_common.own_axes(trial.measured, simulated)
    for name, values in measured.items():
        known = np.isfinite(values)
        time = trial.time_s[known]
        y, z = (side[name][known] for side in (measured, simulated))
        y, z = (side - Polynomial.fit(time, side, 1)(time) for side in (y, z))
        total += float(np.sum((y - z) ** 2) / max(float(np.sum(y**2)), 1e-300))
    return total


def _begins_in_motion(trial: Trial, log: Log, model: Swimmer) -> bool:
    """Return whether a log begins in motion.

    A log begins in motion if it begins after the drive has started, or if the body or a passive joint moves
    in the opening of the log.
    """
    beat = trial.swim.drive
    beats = getattr(beat, "amplitude_rad", 1.0) != 0.0
    if beat is not None and beats and trial.time_s[0] > max(MAX_RAMP_SHARE * beat.ramp_s, OPENING_S):
        return True
    joints = [a.column for a in model.passive]
    body: list[str] = []
    if model.free_base:
        body = [*model.pose, *model.velocity]
    return any(_moves(log, name, name in joints) for name in (*body, *joints) if name in log)


def _moves(log: Log, name: str, is_joint: bool) -> bool:
    """Return whether a channel shows motion in the opening of a log.

    Signs of motion are a velocity, a rate, or a bent passive joint.
    """
    values, known = log[name], np.isfinite(log[name])
    opening = _is_opening(log) & known
    count = int(opening.sum())
    if count < MIN_OPENING:
        return False
    time = log.time_s[opening] - log.time_s[opening][0]

    def is_off_zero(derivative: int, changes: Array) -> bool:
        """Return whether the initial value or rate differs from zero.

        The value or rate must be significant, and not small compared with the largest one in the log.
        """
        value, error = _estimate_start(time, values[opening], derivative)
        return abs(value) > max(MIN_ERRORS * error, MIN_SHARE * float(np.max(np.abs(changes))))

    if name.endswith("_s"):
        return is_off_zero(0, values[known])
    steps = values[known][count - 1 :] - values[known][: 1 - count]
    rates = steps / (log.time_s[known][count - 1 :] - log.time_s[known][: 1 - count])
    return is_off_zero(1, rates) or (is_joint and is_off_zero(0, values[known]))


def _is_opening(log: Log) -> NDArray[np.bool_]:
    """Return a mask of the samples in the opening of a log (see :data:`OPENING_S`)."""
    length = max(OPENING_S, OPENING_STEPS * float(np.median(np.diff(log.time_s))))
    return log.time_s <= log.time_s[0] + length


def _estimate_start(time_s: Array, values: Array, derivative: int) -> tuple[float, float]:
    """Return a value (derivative 0) or its rate (derivative 1) at time zero, with its standard error.

    Value and standard error come from a polynomial that is fitted to the samples. A polynomial two orders
    higher is used if it fits much better, because a polynomial of low order would take a quick start from
    rest for initial motion.
    """
    order = 1 + derivative
    *stiff, stiff_squares = _at_zero(time_s, values, derivative, order)
    *pliant, pliant_squares = _at_zero(time_s, values, derivative, order + 2)
    free = len(time_s) - order - 3
    if stiff_squares - pliant_squares > 2 * MIN_F_RATIO * pliant_squares / free:
        return pliant[0], pliant[1]
    return stiff[0], stiff[1]


def _at_zero(time_s: Array, values: Array, derivative: int, order: int) -> tuple[float, float, float]:
    """Return a coefficient of a polynomial, its standard error, and the residual sum of squares.

    The polynomial is fitted to samples. The coefficient belongs to the power ``derivative``.
    """
    weights, covariance = np.polyfit(time_s, values, order, cov=True)
    residuals, at = values - np.polyval(weights, time_s), order - derivative
    return float(weights[at]), math.sqrt(covariance[at, at]), float(residuals @ residuals)


# ---------------------------------------------------------------- checks of the logs


def _beat(entry: FreeSwimTrial, log: Log, model: Swimmer) -> dict[str, Any] | None:
    """Return the stated frequency of a drive and the frequency found in the heading.

    Return None if the drive is not a beat, or if the heading has too few samples.
    """
    if entry.drive is None or isinstance(entry.drive, StrokeDrive) or not model.free_base:
        return None
    for name in (*model.pose[2:], *model.velocity[2:]):
        if not name.removesuffix("_s").endswith("_rad") or name not in log:
            continue
        if np.isfinite(log[name]).sum() >= MIN_BEAT_SAMPLES:
            used = "the stated value is used: correct it if it is wrong"
            return compare_frequencies(entry.id, entry.drive.frequency_hz, log.time_s, log[name], used)
    return None


def _check_course(path: Path, model: Swimmer, recordings: Sequence[RobotTrial]) -> None:
    """Warn if the robot does not swim in the direction of its heading."""
    if tuple(model.pose) != ("x_m", "y_m", "yaw_rad"):
        return
    logs = [r.log for r in recordings if all(name in r.log for name in model.pose)]
    tracks = [(log.time_s, log["x_m"], log["y_m"], log["yaw_rad"]) for log in logs]
    frequencies = [getattr(r.entry.drive, "frequency_hz", None) or math.inf for r in recordings]
    window_s = max(1.0, 1.0 / min(frequencies, default=math.inf))
    if is_in_degrees(tracks, window_s):
        warn(
            "SWM034",
            f"{path.name}, 'yaw_rad': the heading agrees with the path only in degrees (a factor of 57.3)",
        )
        return
    seen = compare_course(tracks, window_s)
    if seen is None:
        return
    if seen.mirrored:
        warn(
            "SWM063",
            f"{path.name}: the path agrees with the mirrored heading: y_m or yaw_rad has the wrong sign (the "
            "y axis of a picture points down). Give factor: -1 in a mapping",
        )
    elif text := seen.find_turn("yaw_rad"):
        warn("SWM063", f"{path.name}, 'yaw_rad': {text}")


# ---------------------------------------------------------------- drives of trials


def drive_of(trial: Trial) -> dict[str, float]:
    """Return the quantities of a trial's drive, by name.

    The result is empty if measured joint angles drive the trial.
    """
    beat, stroke = trial.swim.beat, trial.swim.stroke
    if stroke is not None:
        return {"frequency_hz": stroke.frequency_hz, "scale": stroke.scale}
    if beat is None:
        return {}
    return {
        "frequency_hz": beat.frequency_hz,
        "amplitude_deg": _degrees(beat.amplitude_rad),
        "bias_deg": _degrees(beat.bias_rad),
        "asymmetry": beat.asymmetry,
        "lag_deg": _degrees(beat.lag_rad),
    }


def _degrees(value_rad: float) -> float:
    """Return an angle in degrees, rounded to twelve digits."""
    return float(f"{math.degrees(value_rad):.12g}")


def find_drive_range(trials: Sequence[Trial]) -> dict[str, tuple[float, float]]:
    """Return the range of each drive quantity over those trials that have a drive.

    The result is empty if measured joint angles drive the trials.
    """
    found = [known for trial in trials if (known := drive_of(trial))]
    names = [name for name in next(iter(found), {}) if all(name in known for known in found)]
    return {n: (min(known[n] for known in found), max(known[n] for known in found)) for n in names}
