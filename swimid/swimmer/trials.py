"""Free-swimming and multibody trials of a robot with links, in its plane or in space."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from swimid.errors import InputError, UsageError, suggestion
from swimid.fitting import drives, metrics
from swimid.fitting.drives import Cycle, SwimInput
from swimid.fitting.experiment import Experiment, inputs_of, read_log
from swimid.fitting.model import Array, Trial
from swimid.logs import consistency
from swimid.logs import trials as trials_format
from swimid.logs.beat import find_beat, stated_against_found
from swimid.logs.log import Log
from swimid.logs.trials import Drive, FreeSwim, FreeSwimTrial, Multibody, StrokeDrive, TrialSet
from swimid.notices import warn
from swimid.robots import file as robot_format
from swimid.robots.file import Robot
from swimid.swimmer.model import Swimmer
from swimid.swimmer.options import STEP_S
from swimid.swimmer.planar import drive
from swimid.swimmer.planar.model import MultilinkModel

#: The start state is estimated when a log's first stretch moves faster than this share of its top
#: speed, by more than this many standard errors.
MOVING, CERTAIN = 0.05, 4.0
#: Length of that stretch, s.
OPENING_S = 0.3
#: Fewest samples in it from which anything is said, and the F ratio from which a more pliant curve counts.
MIN_OPENING = 7
BETTER = 6.0
#: The keys of a trials file that are used, by experiment.
USES = dict.fromkeys(
    ("free-swim", "multibody"),
    trials_format.EVERYWHERE
    | {"trials.coefficients", "trials.drive", "trials.start_state"}
    | {f"trials.drive.{key}" for kind in (Drive, StrokeDrive) for key in kind.model_fields},
)
#: Phases of the drive tried for a trial that begins in steady swimming.
PHASES = 12


def robot_model(
    name: str,
    relative_to: Path | None = None,
    *,
    readings: Mapping[str, str] | None = None,
    max_step: float = STEP_S,
) -> tuple[Robot, Swimmer]:
    """A robot with links and its model: in space where the file says how, else in its plane.

    Raises
    ------
    InputError
        With file and line, for anything wrong in the robot file, or when it has no links.
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
        if robot.multibody is not None:
            from swimid.swimmer.spatial.model import MultibodyModel

            return robot, MultibodyModel(robot, max_step=max_step)
        return robot, MultilinkModel(robot, max_step=max_step)
    except InputError as error:
        raise robot_format.located(error, path) from error


def load(
    source: str | Path | TrialSet,
    *,
    readings: Mapping[str, str] | None = None,
    channels: Sequence[str] = (),
    start_state: str = "auto",
    max_step: float = STEP_S,
) -> Experiment:
    """Read a free-swim or multibody trials file of a multi-link robot.

    Parameters
    ----------
    readings : mapping, optional
        Readings of the robot's source other than the file's.
    channels : sequence of str
        Columns to fit. By default the pose where it is logged, else the velocities, and the angles of
        passive joints (and of driven ones behind a servo) where they are logged.
    start_state : {"auto", "rest", "estimate", "steady"}
        State at the first sample. ``auto`` takes each trial's own key ``start_state``; where that is
        absent the log's first stretch decides. ``steady`` is the limit cycle of the trial's drive.

    Raises
    ------
    InputError
        For anything wrong in the trials file, the robot file or a log.
    UsageError
        For a channel the robot does not have.
    """
    path = trials_format.place(source)
    entries = trials_format.read(source, FreeSwim, Multibody, uses=USES)
    assert isinstance(entries, FreeSwim | Multibody)
    robot, model = robot_model(entries.robot, path.parent, readings=readings, max_step=max_step)
    known = [c.name for c in model.channels]
    for name in channels:
        if name not in known:
            raise UsageError(f"the robot has no channel '{name}'", hint=suggestion(name, known))
    pairs = [_trial(entry, path, model, channels) for entry in entries.trials]
    trials, read = [t for t, _ in pairs], [log for _, log in pairs]
    found = {e.id: _beat(e, log, model) for e, log in zip(entries.trials, read, strict=True)}
    moving = [t.id for t, log in pairs if _moving(t, log, model)]
    # offsets of the start pose, for each measured coordinate
    free = {
        name
        for name, column in zip(model.starts, model.pose, strict=True)
        if model.free_base and any(column in t.measured for t in trials)
    }
    if any(_headless(model, log) and model.pose[0] in t.measured for t, log in pairs):
        free.add(model.starts[2])
    states = {
        e.id: _start_state(e, start_state, moving=e.id in moving, model=model, path=path)
        for e in entries.trials
    }
    initial = set(model.initial([c for t in trials for c in t.measured]))
    own = {"rest": set(), "estimate": initial, "steady": {"drive_phase"}}
    free |= set().union(*(own[state] for state in states.values()))
    trials = [
        replace(
            t,
            held=tuple(sorted(free & {"drive_phase", *initial} - own[states[t.id]])),
            starts=_starts(t, log, model),
            swim=t.swim.begun() if states[t.id] == "steady" else t.swim,
        )
        for t, log in pairs
    ]
    model.parameters = tuple(replace(p, free=p.free or p.name in free) for p in model.parameters)
    trials = [_in_phase(t, model) if t.swim.steady else t for t in trials]
    _check_course(path, model, read, [getattr(e.drive, "frequency_hz", None) for e in entries.trials])
    facts = {
        "beats": found,
        "moving": moving,
        "start_states": states,
        "profiles": {entry.id: _profile(entry) for entry in entries.trials},
    }
    return Experiment(
        entries.experiment,
        robot,
        model,
        trials,
        inputs_of(path, entries, [log.source for log in read]),
        facts=facts,
        robot_path=robot_format.locate(entries.robot, path.parent),
    )


def _start_state(entry: FreeSwimTrial, chosen: str, *, moving: bool, model: Swimmer, path: Path) -> str:
    """State in which a trial begins: ``rest``, ``estimate`` or ``steady``.

    Raises
    ------
    InputError
        When a trial without a periodic drive, or of a robot in space, is to begin in steady swimming.
    """
    state = entry.start_state if chosen == "auto" else chosen
    if state == "auto":
        return "estimate" if moving else "rest"
    if state == "steady" and (entry.drive is None or model.in_space):
        lacking = "robots in space are not supported" if model.in_space else "it has no 'drive'"
        raise InputError(
            f"the trial '{entry.id}' cannot begin in steady swimming: {lacking}",
            file=path,
            column="start_state" if chosen == "auto" else "drive",
            hint="give the beat under 'drive', or start it from an estimated state (start_state: estimate)",
        )
    return state


def _in_phase(trial: Trial, model: Swimmer) -> Trial:
    """The trial with the phase from which a search starts: that of the stated robot's best run."""
    stated = {**{p.name: p.start for p in model.parameters}, **model.stated()}
    values = np.array([stated[p.name] for p in model.parameters])
    phase = model.index("drive_phase")
    tried = np.linspace(0.0, 2.0 * math.pi, PHASES, endpoint=False)
    runs = [np.array([*values[:phase], angle, *values[phase + 1 :]]) for angle in tried]
    simulated = [model.attempt(run, trial) for run in runs]
    model.forget([trial])
    if not all(np.isfinite(run[name]).all() for run in simulated for name in trial.measured):
        return trial
    misses = [_shape_error(trial, run) for run in simulated]
    return replace(trial, starts={**trial.starts, "drive_phase": float(tried[int(np.nanargmin(misses))])})


def _shape_error(trial: Trial, simulated: Mapping[str, Array]) -> float:
    """Squared error of the beat of a trial, relative to its size, summed over channels.

    Trends and the direction of the path are left out: they are no part of the beat.
    """
    total = 0.0
    measured, simulated = metrics.own_axes(trial.measured, simulated)
    for name, values in measured.items():
        there = np.isfinite(values)
        trend = np.polynomial.Polynomial.fit
        y, z = (
            side[name][there] - trend(trial.time_s[there], side[name][there], 1)(trial.time_s[there])
            for side in (measured, simulated)
        )
        total += float(np.sum((y - z) ** 2) / max(float(np.sum(y**2)), 1e-300))
    return total


def _check_course(
    path: Path, model: Swimmer, logs: Sequence[Log], frequencies_hz: Sequence[float | None]
) -> None:
    """Warn where the robot does not swim where its heading points."""
    if tuple(model.pose) != ("x_m", "y_m", "yaw_rad"):
        return
    tracks = [
        (log.time_s, log["x_m"], log["y_m"], log["yaw_rad"])
        for log in logs
        if all(c in log for c in model.pose)
    ]
    slowest = min((f for f in frequencies_hz if f), default=1.0)
    window_s = max(1.0, 1.0 / slowest)
    if consistency.is_in_degrees(tracks, window_s):
        warn(
            "SWM034", f"{path.name}, 'yaw_rad': the courses follow it if it is in degrees (a factor of 57.3)"
        )
        return
    seen = consistency.compare_course(tracks, window_s)
    if seen is None:
        return
    if seen.mirrored:
        warn(
            "SWM063",
            f"{path.name}: the courses follow the headings mirrored: the y axis or the heading of these "
            "logs has the wrong sign (a picture's y axis points down); turn it with factor: -1 in a mapping",
        )
    elif abs(seen.slip_rad) > math.pi / 4 and seen.spread_rad < consistency.LARGEST_SLIP:
        warn(
            "SWM063",
            f"{path.name}: the courses differ from the headings by {math.degrees(seen.slip_rad):.0f} "
            "degrees: about 180 is a heading from the tail, or swimming backwards, about 90 swapped axes",
        )


def _profile(entry: FreeSwimTrial) -> str:
    """The motion a trial repeats: its drive in words; of measured joints, the trial itself."""
    command = entry.drive
    if command is None:
        return entry.id
    if isinstance(command, StrokeDrive):
        said = [command.stroke]
        said += [f"{command.frequency_hz:g} Hz"] if command.frequency_hz else []
        said += [f"scale {command.scale:g}"] if command.scale != 1.0 else []
        return ", ".join(said)
    said = [command.waveform, f"{command.frequency_hz:g} Hz", f"{command.amplitude_deg:g} deg"]
    said += [f"bias {command.bias_deg:g} deg"] if command.bias_deg else []
    return ", ".join(said)


def beat_of(command: Drive) -> drives.Beat:
    """A trials file's drive in SI."""
    return drives.Beat(
        command.waveform,
        command.frequency_hz,
        math.radians(command.amplitude_deg),
        math.radians(command.bias_deg),
        command.asymmetry,
        command.ramp_s,
        math.radians(command.phase_deg),
    )


def cycle_of(command: StrokeDrive, model: Swimmer, path: Path | None = None) -> Cycle:
    """A stroke as the robot file has it.

    Raises
    ------
    InputError, UsageError
        When the robot has no such stroke as the trials file at the path, or without one the user, asks for.
    """
    body = model.robot.multibody
    known = {} if body is None else body.strokes
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
        math.inf if command.cycles is None else command.cycles,
        math.radians(command.phase_deg),
    )


def _trial(entry: FreeSwimTrial, path: Path, model: Swimmer, channels: Sequence[str]) -> tuple[Trial, Log]:
    known = [c.name for c in model.channels]
    commands = [a.column.replace("joint", "cmd") for a in model.driven]
    log = read_log(entry, path.parent, required=tuple(channels), optional=(*known, *commands))
    log = replace(log, columns={name: _unwrapped(name, values) for name, values in log.columns.items()})
    swim = SwimInput(coefficients=_own_coefficients(entry, path, model))
    if isinstance(entry.drive, StrokeDrive):
        swim = replace(swim, stroke=cycle_of(entry.drive, model, path))
    elif entry.drive is not None:
        swim = replace(swim, beat=beat_of(entry.drive))
    elif model.driven:
        motions = [_motion(model, k, log) for k in range(len(model.driven))]
        swim = replace(swim, joints=[m for m, _ in motions], commanded=any(told for _, told in motions))
    measured = {name: log[name] for name in (channels or _default_channels(model, log))}
    pose = [log[name] if name in log else np.full(len(log), np.nan) for name in model.pose]
    # in its plane a robot is where the log says or nowhere; a side view tells half of a pose in space
    if model.free_base and (len(pose) > 3 or all(name in log for name in model.pose[:2])):
        first = [float(v[np.isfinite(v)][0]) if np.isfinite(v).any() else 0.0 for v in pose]
        if _headless(model, log):
            first[2] = _course(*pose[:2])
        swim = replace(swim, pose=tuple(first))
    others = {n: v for n, v in log.columns.items() if n in known and n not in measured}
    return Trial(entry.id, entry.role, log.time_s, measured, inputs=others, swim=swim), log


def _headless(model: Swimmer, log: Log) -> bool:
    """Whether a log shows where a robot is in its plane, and not its heading: one marker."""
    *place, heading = model.pose
    known = [name in log and np.isfinite(log[name]).any() for name in (*place, heading)]
    return model.free_base and len(place) == 2 and all(known[:2]) and not known[2]


def _course(x: Array, y: Array) -> float:
    """Where a track sets out to, rad: to where it is a quarter of its farthest from its first point."""
    there = np.isfinite(x) & np.isfinite(y)
    along, across = x[there] - x[there][0], y[there] - y[there][0]
    gone = np.hypot(along, across)
    at = int(np.argmax(gone >= 0.25 * gone.max()))
    return math.atan2(across[at], along[at])


def _own_coefficients(entry: FreeSwimTrial, path: Path, model: Swimmer) -> dict[str, float]:
    """The coefficients a trial sets for itself."""
    for name in entry.coefficients:
        if name not in model.coefficients:
            raise InputError(
                f"the trial '{entry.id}' sets '{name}', which is no coefficient of the robot",
                file=path,
                column="coefficients",
                hint=suggestion(name, model.coefficients, "it has"),
            )
    return dict(entry.coefficients)


def _unwrapped(name: str, values: Array) -> Array:
    """A heading without its jumps at half a turn; other columns as they are."""
    if not name.endswith("_rad") or name.startswith("joint"):
        return values
    there = np.isfinite(values)
    found = values.copy()
    # values beyond one turn do not jump: they go on, or they are no radians
    # one turn, and the noise of a twentieth
    if there.any() and np.ptp(values[there]) <= 2.1 * math.pi:
        found[there] = np.unwrap(values[there])
    return found


def _default_channels(model: Swimmer, log: Log) -> list[str]:
    def there(names: Sequence[str]) -> list[str]:
        return [n for n in names if n in log and np.isfinite(log[n]).sum() > 1]

    chosen = []
    if model.free_base:
        pose = there(model.pose)
        whole = len(pose) == 3 or (len(model.pose) > 3 and len(pose) > 1)
        chosen = pose if whole else there(model.velocity) or pose
    chosen += there([a.column for a in model.passive])
    chosen += there([a.column for a in model.driven if a.driven and a.driven.servo])
    if not chosen:
        names = ", ".join(c.name for c in model.channels)
        raise InputError("holds none of the robot's channels", file=log.path, hint=f"it may have: {names}")
    return chosen


def _motion(model: Swimmer, number: int, log: Log) -> tuple[Any, bool]:
    """A driven joint's motion from its measured angle, or from its commanded one, and whether it was that.

    A joint no drive moves (gain 0) stays straight where the log has neither.
    """
    axis = model.driven[number]
    name, law = axis.column, axis.driven
    assert law is not None
    command = name.replace("joint", "cmd")
    for candidate in (command, name) if law.servo is not None else (name, command):
        if candidate in log and np.isfinite(log[candidate]).sum() >= 5:
            return drive.spline_motion(drive.measured(log.time_s, log[candidate])), candidate == command
    if law.gain == 0.0 and not law.bias_gain:
        return drives.straight, False
    raise InputError(
        f"the driven joint '{axis.name}' needs this column, or '{command}'",
        file=log.path,
        line=log.first_line - 1 if log.first_line else None,
        column=name,
        hint="or give the trial a 'drive' in the trials file",
    )


def _beat(entry: FreeSwimTrial, log: Log, model: Swimmer) -> dict[str, Any] | None:
    """The beat found in the heading, against the drive's."""
    if entry.drive is None or isinstance(entry.drive, StrokeDrive) or not model.free_base:
        return None
    for name in (*model.pose[2:], *model.velocity[2:]):
        if not name.removesuffix("_s").endswith("_rad"):
            continue
        if name in log and np.isfinite(log[name]).sum() > 16:
            seen = np.isfinite(log[name])
            time = log.time_s[seen]
            highest = min(8.0 * entry.drive.frequency_hz, 0.45 / float(np.median(np.diff(time))))
            found = find_beat(time, log[name][seen], highest_hz=highest)
            return stated_against_found(entry.id, entry.drive.frequency_hz, found, used="stated")
    return None


def _moving(trial: Trial, log: Log, model: Swimmer) -> bool:
    """Whether the log begins under way, or its first stretch shows the body or a passive joint in motion."""
    beat = trial.swim.drive
    still = beat is None or getattr(beat, "amplitude_rad", 1.0) == 0
    begun = 0.0 if still else trial.time_s[0]
    if beat is not None and begun > max(0.3 * beat.ramp_s, OPENING_S):
        return True
    body = (*model.pose, *model.velocity) if model.free_base else ()
    joints = tuple(a.column for a in model.passive)
    for name in (n for n in (*body, *joints) if n in log):
        values = log[name]
        seen = np.isfinite(values)
        there = _opening(log) & seen
        if there.sum() < MIN_OPENING:
            continue
        time = log.time_s[there] - log.time_s[there][0]
        sizes = np.abs(values[seen])
        if name.endswith("_s"):
            tops = {0: float(np.max(sizes))}
        else:
            k = int(there.sum()) - 1
            rates = (values[seen][k:] - values[seen][:-k]) / (log.time_s[seen][k:] - log.time_s[seen][:-k])
            tops = {1: float(np.max(np.abs(rates)))}
            if name in joints:
                tops[0] = float(np.max(sizes))
        if any(_off_zero(time, values[there], power, top) for power, top in tops.items()):
            return True
    return False


def _opening(log: Log) -> NDArray[np.bool_]:
    """The samples of a log's first stretch."""
    return log.time_s <= log.time_s[0] + max(OPENING_S, 8 * float(np.median(np.diff(log.time_s))))


def _starts(trial: Trial, log: Log, model: Swimmer) -> dict[str, float]:
    """Where a search for the start state begins: what the fitted channels show of it at first."""
    headless = _headless(model, log)

    def at_start(name: str, derivative: int) -> float | None:
        if headless and name == model.pose[2] and not derivative:
            return trial.swim.posed()[2]
        if name not in trial.measured:
            return None
        values = trial.measured[name]
        there = _opening(log) & np.isfinite(values)
        if there.sum() < MIN_OPENING:
            return None
        return _fitted(log.time_s[there] - log.time_s[0], values[there], derivative)[0]

    found: dict[str, float | None] = model.opening(at_start) if model.free_base else {}
    for axis in model.passive:
        joint, rate = axis.name, axis.column.replace("_rad", "_rate_rad_s")
        found[f"initial_angle_{joint}"] = at_start(axis.column, 0)
        found[f"initial_rate_{joint}"] = (
            at_start(rate, 0) if rate in trial.measured else at_start(axis.column, 1)
        )
    return {name: value for name, value in found.items() if value is not None}


def _off_zero(time_s: Array, values: Array, derivative: int, top: float) -> bool:
    """Whether a value (0) or its rate (1) at time zero is surely not zero, and not small against ``top``.

    By a polynomial; by one two orders higher where that fits much better: one that is too stiff
    takes a quick start from rest for motion.
    """
    value, error = _fitted(time_s, values, derivative)
    return abs(value) > max(CERTAIN * error, MOVING * top)


def _fitted(time_s: Array, values: Array, derivative: int) -> tuple[float, float]:
    """A value (0) or its rate (1) at time zero, with its standard error."""
    order = 1 + derivative
    stiff, pliant = (_at_zero(time_s, values, derivative, n) for n in (order, order + 2))
    free = len(time_s) - order - 3
    better = stiff[2] - pliant[2] > 2 * BETTER * pliant[2] / free
    value, error, _ = pliant if better else stiff
    return value, error


def _at_zero(time_s: Array, values: Array, derivative: int, order: int) -> tuple[float, float, float]:
    """Coefficient of a fitted polynomial, its standard error, and the sum of squares left."""
    design = np.vander(time_s, order + 1, increasing=True)
    weights, *_ = np.linalg.lstsq(design, values, rcond=None)
    left = values - design @ weights
    squares = float(left @ left)
    spread = float(np.linalg.inv(design.T @ design)[derivative, derivative])
    return float(weights[derivative]), math.sqrt(squares / (len(time_s) - order - 1) * spread), squares


def drive_of(trial: Trial) -> dict[str, float]:
    """The numbers of a trial's drive; empty where measured joints drive it."""
    beat, stroke = trial.swim.beat, trial.swim.stroke
    if stroke is not None:
        return {"frequency_hz": stroke.frequency_hz, "scale": stroke.scale}
    if beat is None:
        return {}
    return {
        "frequency_hz": beat.frequency_hz,
        "amplitude_deg": _round(math.degrees(beat.amplitude_rad)),
        "bias_deg": _round(math.degrees(beat.bias_rad)),
        "asymmetry": beat.asymmetry,
        "lag_deg": _round(math.degrees(beat.lag_rad)),
    }


def _round(value: float) -> float:
    return float(f"{value:.12g}")


def driven_range(trials: Sequence[Trial]) -> dict[str, tuple[float, float]]:
    """The range of each number of the drives of trials; of those that every driven trial has.

    Empty where measured joints drive them.
    """
    found = [known for trial in trials if (known := drive_of(trial))]
    names = [name for name in (found[0] if found else {}) if all(name in known for known in found)]
    return {n: (min(known[n] for known in found), max(known[n] for known in found)) for n in names}
