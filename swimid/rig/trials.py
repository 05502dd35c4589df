"""Functions that read the trials of a rig with one degree of freedom: falling weight, towing, free decay."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from swimid.errors import InputError
from swimid.files.provenance import Input
from swimid.fitting.fit_common import Experiment, inputs_of, read_log, warn_mass
from swimid.fitting.model import Array, RigInput, Trial, chosen
from swimid.logs import tracks
from swimid.logs import trials as trials_format
from swimid.logs.log import Log, longest_run, runs, unwrapped
from swimid.logs.sampling import step_of, white_noise_sd
from swimid.logs.trials import FallingWeight, FallingWeightTrial, FreeDecay, RigTrial, Towed, TrialSet
from swimid.notices import warn
from swimid.rig import model as rig
from swimid.robots.file import Robot

#: Relative tolerance of comparisons in a free decay. A sample within it counts as the extreme of a swing. A
#: swing within it counts as equal to the largest swing.
EXTREME_RTOL = 0.05
#: Minimum duration near the extreme of a swing, as a fraction of a period, at which the body is assumed to
#: have been held there before release. A free swing stays within 5 % of its extreme for 0.1 of a period,
#: ``2 arccos(0.95) / (2 pi)``.
HELD_PERIODS = 0.1
#: Maximum creep of the rest position after the only overshoot of a free decay, as a fraction of the
#: overshoot. The relative error of the damping ratio is about this fraction divided by the logarithmic
#: decrement of a half swing, which is about 1 or more if the second overshoot is hidden.
MAX_CREEP = 0.2
#: Minimum number of samples of a falling-weight trial.
MIN_SAMPLES = 5
#: Maximum position of the first sample of a drop, as a fraction of the drop distance, at which the drop is
#: assumed to start at the origin.
ORIGIN_RTOL = 0.02
#: Maximum number of successive missing samples of the applied force, which are interpolated.
MAX_FORCE_GAP = 4
MASS = "inertial_mass_kg"
_DRAG = ("trials.frontal_area_m2", "trials.fluid_density_kg_m3")
#: Keys of a trials file that each rig experiment uses. Other keys have no effect on the experiment.
USES = {
    "falling-weight": trials_format.EVERYWHERE
    | {"trials.pulling_mass_kg", "trials.driving_force_N", f"trials.{MASS}", *_DRAG},
    "towed": trials_format.EVERYWHERE | {f"trials.{MASS}", *_DRAG},
    "free-decay": trials_format.EVERYWHERE | {f"trials.{MASS}"},
}


def load(source: str | Path | TrialSet, *, coordinate: str | None = None) -> Experiment:
    """Read a trials file of a rig experiment.

    Parameters
    ----------
    coordinate : str, optional
        Coordinate of a free decay. It is needed if the logs hold several coordinates.

    Raises
    ------
    InputError
        If the trials file, the robot file or a log is wrong.
    """
    path = trials_format.place(source)
    entries = trials_format.read(source, FallingWeight, Towed, FreeDecay, uses=USES)
    robot = trials_format.robot_of(entries, path)
    if coordinate is not None and not isinstance(entries, FreeDecay):
        warn("SWM004", "--coordinate belongs to a free-decay experiment and has no effect here")
    if isinstance(entries, FreeDecay):
        return _free_decay(path, entries, robot, coordinate)
    if isinstance(entries, FallingWeight):
        return _falling_weight(path, entries, robot)
    assert isinstance(entries, Towed)
    return _towed(path, entries, robot)


def _mass(entry: RigTrial, robot: Robot, path: Path) -> float:
    mass = entry.inertial_mass_kg
    if mass is None:
        mass = robot.body.inertial_mass_kg
    if mass is None:
        raise InputError(
            f"the trial '{entry.id}' has no inertial mass",
            file=path,
            column=MASS,
            hint=f"give it in the trial, or as body.inertial_mass_kg of the robot '{robot.name}'",
        )
    return mass


def _area_factors(entries: Sequence[RigTrial], robot: Robot, path: Path) -> list[float]:
    """Return the factor ``rho A / 2`` of the drag law for each trial, kg/m; zeros without a frontal area.

    ``rho`` is the density of the fluid, and ``A`` the frontal area of the body.
    """
    factors: list[float] = []
    for entry in entries:
        area = entry.frontal_area_m2 or robot.body.frontal_area_m2 or 0.0
        factors.append(0.5 * (entry.fluid_density_kg_m3 or robot.fluid.density_kg_m3) * area)
        if not area and entry.fluid_density_kg_m3 is not None:
            raise InputError(
                f"the density of the fluid in '{entry.id}' has no effect without a frontal area",
                file=path,
                column="fluid_density_kg_m3",
                hint="give frontal_area_m2 in the trial or in the robot file",
            )
    if any(factors) and not all(factors):
        missing = entries[factors.index(0.0)].id
        raise InputError(
            f"some trials have a frontal area and '{missing}' has none", file=path, column="frontal_area_m2"
        )
    return factors


# ------------------------------------------------------------ falling weight


def _falling_weight(path: Path, entries: FallingWeight, robot: Robot) -> Experiment:
    factors = _area_factors(entries.trials, robot, path)
    drops = [_drop(e, path, robot, factor) for e, factor in zip(entries.trials, factors, strict=True)]
    logs, known, records = zip(*drops, strict=True)
    model = rig.falling_weight(
        mass_kg=float(np.median([k.inertia for k in known])) or 1.0,
        force_N=float(np.median([k.pull for k in known])),
        area_known=factors[0] > 0,
        pulley=any(k.pulley for k in known),
        speed_m_s=float(np.median([np.ptp(r.position) / np.ptp(r.time_s) for r in records])) or 0.1,
    )
    span = min(float(record.time_s[-1] - record.time_s[0]) for record in records)
    model.parameters = chosen(
        model.parameters,
        # Limit the time between the release and the start of the log to the duration of the shortest trial.
        bounds={"clock_offset": (-span, span)},
        # Estimate the start position of drops that do not start at the origin, because their first measured
        # position has noise.
        freed=("start_offset",) * any(k.x0 != 0 for k in known),
    )

    def trials(rounding: str) -> list[Trial]:
        made = []
        for entry, record, one in zip(entries.trials, records, known, strict=True):
            clicks = record.kind == "clicks"
            # Leave out the first row of a log with one row per encoder step, because it defines the origin
            # and is not a measurement.
            rows = slice(int(clicks and record.position[0] == 0), None)
            position = {"x_m": true_position(record, rounding)[rows]}
            trial = Trial(entry.id, entry.role, record.time_s[rows], position, rig=one)
            if record.position_sd:
                trial = replace(trial, value_sd={"x_m": record.position_sd})
            made.append(replace(trial, time_sd_s=record.time_sd_s, stamps_uncertain=clicks))
        return made

    variants = {}
    if any(r.kind == "sampled" for r in records):
        variants = {name: trials(name) for name in ROUNDINGS}
    inputs = inputs_of(path, entries, logs)
    return Experiment("falling-weight", robot, model, trials("floor"), inputs, variants)


def _without_standstill(log: Log) -> tuple[Array, Array]:
    """Return the times and displacements of a drop up to the time at which the body comes to rest.

    Raises
    ------
    InputError
        If there are too few samples, or if the displacement does not grow.
    """
    there = np.isfinite(log["x_m"])
    time, position = log.time_s[there], log["x_m"][there]
    if len(time) < MIN_SAMPLES:
        raise InputError(
            f"has {len(time)} displacement samples; a fit needs at least {MIN_SAMPLES}",
            file=log.path,
            column="x_m",
        )
    span = float(position.max() - position.min())
    zero = np.flatnonzero((position == 0.0) & (np.maximum.accumulate(position) > 0.1 * span))
    if len(zero):
        raise InputError(
            f"is exactly 0 in {len(zero)} rows, from {time[zero[0]]:.4g} s to {time[zero[-1]]:.4g} s, after "
            f"it had grown to {np.max(position[: zero[0]]):.3g} m: is that a code for a lost sample?",
            file=log.path,
            line=log.line(int(np.flatnonzero(there)[zero[0]])),
            column="x_m",
            hint="empty these cells, or state 'missing: [0]' under 'reader:' in the mapping of an import",
        )
    noise = float(np.median(np.abs(np.diff(position, 2))))
    arrived = position.max() - max(0.01 * span, 6.0 * noise)
    before = np.flatnonzero(position < arrived)
    reference = np.flatnonzero(position < position.min() + 0.7 * (arrived - position.min()))
    if len(before) and len(reference) and len(position) - before[-1] >= 6:
        last, far = int(before[-1]) + 1, int(reference[-1])
        # Compute the time in which the body at its mean speed would cover the rest of the distance.
        needed = 0.0
        if time[last] > time[far] and position[last] > position[far]:
            speed = (position[last] - position[far]) / (time[last] - time[far])
            needed = (position.max() - arrived) / speed
        still = time[-1] - time[last]
        if time[last] > time[far] and still >= max(5.0 * needed, 0.05 * (time[last] - time[0])):
            warn(
                "SWM018",
                f"{log.path.name}: the body stands still from {time[last]:.3g} s on; the {still:.3g} s after "
                "that are left out (set another end with end_s in the trials file)",
            )
            time, position = time[:last], position[:last]
    if position[-1] <= position[0]:
        raise InputError(
            "the displacement does not grow; x_m must point along the pull", file=log.path, column="x_m"
        )
    return time, position


def _drop(
    entry: FallingWeightTrial, path: Path, robot: Robot, factor: float
) -> tuple[Input, RigInput, Displacement]:
    """Return the log of a falling-weight trial, its known quantities and its displacement record.

    The known quantities are the moving mass, the driving force and the time of release.
    """
    log = read_log(entry, path.parent, required=("x_m",))
    time, position = _without_standstill(log)
    record = read_encoder(time, position, robot.rig.encoder_resolution_m)
    mass = _mass(entry, robot, path)
    pulley = entry.pulling_mass_kg is not None
    if entry.pulling_mass_kg is not None:
        warn_mass(f"the trial '{entry.id}' has the pulling mass", entry.pulling_mass_kg, mass, path)
        force = entry.pulling_mass_kg * robot.fluid.gravity_m_s2
        mass += entry.pulling_mass_kg + robot.rig.pulley_inertia_kg
    else:
        force = float(entry.driving_force_N or 0.0)
        if force <= 0:
            raise InputError(
                f"the driving force of '{entry.id}' must be positive, along x_m",
                file=path,
                column="driving_force_N",
            )
    travelled = position - position[0]
    from_origin = abs(position[0]) <= ORIGIN_RTOL * float(travelled.max())
    # If the body has already moved in the first row of a drop, it was released before this row. The release
    # is at time zero if the driving force can have moved the body that far since time zero. Otherwise the
    # time of release is estimated from the time that the driving force needs.
    quickest = np.sqrt(2.0 * max(float(position[0]), 0.0) * mass / force)
    at_zero = from_origin and position[0] > 0 and 0.5 * quickest <= time[0] <= 5.0 * quickest
    # Accept only the count of an encoder as proof that the body has moved before the first row, because a
    # camera position has noise.
    counted = record.kind != "continuous" and record.position[0] > 0 and from_origin
    release, x0 = float(time[0]), float(position[0])
    if at_zero:
        release = 0.0
    elif counted:
        release -= 1.4 * float(quickest)
    if from_origin:
        x0 = 0.0
    known = RigInput(mass, force=force, pulley=pulley, area_factor=factor, release_s=release, x0=x0)
    return log.source, known, record


# ------------------------------------------------------------ towed


def _towed(path: Path, entries: Towed, robot: Robot) -> Experiment:
    factors = _area_factors(entries.trials, robot, path)
    trials, logs, forces, speeds = [], [], [], []
    for entry, factor in zip(entries.trials, factors, strict=True):
        log = read_log(entry, path.parent, required=("force_N",), optional=("x_m", "u_m_s"))
        logs.append(log.source)
        measured = {c: log[c] for c in ("x_m", "u_m_s") if c in log}
        if not measured:
            raise InputError("needs a column x_m or u_m_s beside force_N", file=log.path)
        force = log["force_N"]
        missing = np.isnan(force)
        known = np.flatnonzero(~missing)
        # A force may change in one step, as dry friction does where the body reverses. Spikes are errors.
        spikes = known[:0]
        if len(known) > tracks.WINDOW:
            spikes = known[~tracks.find_jumps(log.time_s[known], force[known, None], brief=True)[0]]
        missing[spikes] = True
        if len(spikes):
            first = log.time_s[spikes[0]]
            text = f"{len(spikes)} outliers of force_N, the first at {first:.4g} s, are interpolated"
            warn("SWM058", f"{log.path.name}: {text}: does the amplifier of the load cell fail there?")
        if longest_run(missing) > MAX_FORCE_GAP:
            first, _ = max(runs(missing).tolist(), key=np.ptp)
            text = f"the applied force is missing for more than {MAX_FORCE_GAP} samples; it drives the model"
            raise InputError(text, file=log.path, line=log.line(first), column="force_N")
        # The model takes the force between two samples from the line through them, also across a spike.
        force = np.interp(log.time_s, log.time_s[~missing], force[~missing])
        x = measured.get("x_m", np.zeros(1))
        if "u_m_s" in measured:
            speeds.append(float(np.nanmean(np.abs(measured["u_m_s"]))))
        else:
            speeds.append(float((np.nanmax(x) - np.nanmin(x)) / np.ptp(log.time_s)))
        mass, begin, first = _mass(entry, robot, path), float(log.time_s[0]), float(x[np.isfinite(x)][0])
        # A body that coasts down has no measured force: its drag then takes its momentum.
        taken = mass * speeds[-1] / float(np.ptp(log.time_s))
        forces.append(max(float(np.sqrt(np.mean(force**2))), taken))
        rig_input = RigInput(mass, area_factor=factor, release_s=begin, x0=first)
        trials.append(Trial(entry.id, entry.role, log.time_s, measured, {"force_N": force}, rig_input))
    model = rig.towed(
        mass_kg=float(np.median([t.rig.inertia for t in trials])),
        force_N=max(float(np.median(forces)), 1e-9),
        area_known=factors[0] > 0,
        speed_m_s=float(np.median(speeds)) or 0.1,
    )
    if not any("x_m" in t.measured for t in trials):
        model.parameters = chosen(model.parameters, fixed={"start_offset": 0.0})
    return Experiment("towed", robot, model, trials, inputs_of(path, entries, logs))


# ------------------------------------------------------------ free decay


def _free_decay(path: Path, entries: FreeDecay, robot: Robot, coordinate: str | None) -> Experiment:
    logs = [read_log(e, path.parent, required=(), optional=tuple(rig.COORDINATES)) for e in entries.trials]
    name = coordinate or _coordinate(logs)
    rotation = rig.COORDINATES[name][2]
    axis = name.removesuffix("_rad")
    trials, periods, amplitudes = [], [], []
    for entry, log in zip(entries.trials, logs, strict=True):
        if name not in log:
            raise InputError("this column is missing", file=log.path, column=name)
        time, values, period, amplitude = _decay(log, name)
        periods.append(period)
        amplitudes.append(amplitude)
        inertia = _inertia(entry, robot, axis, rotation, path)
        known = RigInput(inertia, release_s=float(time[0]), x0=float(values[0]))
        trials.append(Trial(entry.id, entry.role, time, {name: values}, rig=known))
    inertia = trials[0].rig.inertia
    stiffness = robot.rig.stiffness_N_m
    if rotation:
        stiffness = getattr(robot.rig, f"{axis}_stiffness_N_m_rad", None)
    gravity = getattr(robot.rig, f"{axis}_gravity_stiffness_N_m_rad", None)
    if gravity is not None and stiffness is None:
        stiffness = 0.0
    if stiffness is None:
        warn(
            "SWM019",
            f"the restoring stiffness is not known: the decay determines ratios to the inertia {inertia:g} "
            "only; added inertia is held at zero and the stiffness estimated",
        )
    model = rig.free_decay(
        name,
        inertia=inertia,
        stiffness=stiffness,
        guess=inertia * (2 * math.pi / float(np.median(periods))) ** 2,
        amplitude=float(np.median(amplitudes)),
        gravity=gravity or 0.0,
    )
    inputs = inputs_of(path, entries, [log.source for log in logs])
    return Experiment("free-decay", robot, model, trials, inputs)


def _coordinate(logs: list[Log]) -> str:
    common = [c for c in rig.COORDINATES if all(c in log for log in logs)]
    if len(common) != 1:
        raise InputError(
            f"one coordinate is needed in every log, and there are {len(common)} ({', '.join(common)})",
            file=logs[0].path,
            hint=f"choose one of {', '.join(rig.COORDINATES)} with --coordinate",
        )
    return common[0]


def _inertia(entry: RigTrial, robot: Robot, axis: str, rotation: bool, path: Path) -> float:
    """Return the known mass or moment of inertia of a free decay; 1 if a moment of inertia is unknown."""
    if not rotation:
        return _mass(entry, robot, path)
    if entry.inertial_mass_kg is not None:
        raise InputError(
            f"the mass of '{entry.id}' has no effect on a free decay in {axis}",
            file=path,
            column=MASS,
            hint=f"the inertia is {axis}_inertia_kg_m2 of the robot file",
        )
    inertia = getattr(robot.body, f"{axis}_inertia_kg_m2")
    if not inertia:
        warn(
            "SWM019",
            f"the robot '{robot.name}' has no {axis}_inertia_kg_m2: all parameters are per unit of "
            "total inertia",
        )
    return float(inertia or 1.0)


def _swings(values: Array, noise: float, log: Log, name: str) -> tuple[Array, Array]:
    """Divide the record of a free decay into half swings, which alternate about the rest position.

    Returns
    -------
    crossings : ndarray, shape (n - 1,)
        Index of the first sample of each half swing except the first.
    extremes : ndarray, shape (n,)
        Value of each half swing that is farthest from the rest position.

    Raises
    ------
    InputError
        If the record has fewer than three half swings, and no overshoot after which it comes to rest.
    """
    found = None
    # Most records end with the body at rest, so that the last quarter of the record gives the rest position.
    # If no swings are found about this level, try the middle of the range of the record.
    end = float(np.median(values[len(values) * 3 // 4 :]))
    for level in (end, 0.5 * float(values.max() + values.min())):
        for _ in range(3):
            crossings, extremes = _half_swings(values, level, noise)
            if len(extremes) < 3:
                break
            found = crossings, extremes
            # Estimate the rest position by a weighted mean of three successive extremes. The error of this
            # mean is of second order in the decay per half swing.
            level = float(extremes[-3:] @ (0.25, 0.5, 0.25))
        if found is not None:
            return found
    # A creep of the rest position can hide the swings after the first overshoot, and a strongly damped body
    # has none. A record that comes to rest after one overshoot shorter than the first swing determines both.
    crossings, extremes = _half_swings(values, end, noise)
    if len(extremes) == 2 and abs(extremes[1] - end) < abs(extremes[0] - end):
        after = values[np.argmin(np.abs(values - extremes[1])) :]
        creep = abs(float(np.median(after[len(after) // 2 :]) - np.median(after[: len(after) // 2 + 1])))
        if len(after) > len(values) // 4 and creep < MAX_CREEP * abs(extremes[1] - end):
            return crossings, extremes
    raise InputError(
        "does not swing: it has no overshoot after which it comes to rest without a creep",
        file=log.path,
        column=name,
        hint="cut a slow creep after the swings off with end_s in the trials file; a body that is damped so "
        "strongly that it hardly swings needs 'experiment: towed' with a measured force",
    )


def _half_swings(values: Array, level: float, noise: float) -> tuple[Array, Array]:
    """Return the indices at which a record crosses a level, and the extreme value between two crossings.

    An extreme is the value that is farthest from the level. The ends of the record count as crossings.
    """
    away = values - level
    amplitude = float(np.max(np.abs(away)))
    # Ignore values within a band around the level, so that noise does not count as a crossing.
    band = min(max(0.1 * amplitude, 4.0 * noise), 0.25 * amplitude)
    state = np.sign(away) * (np.abs(away) > band)
    marked = np.flatnonzero(state)
    crossings = marked[1:][np.diff(state[marked]) != 0]
    extremes = [part[np.argmax(np.abs(part))] for part in np.split(away, crossings)]
    return crossings, np.array(extremes) + level


def _period(time: Array, values: Array, crossings: Array, extremes: Array) -> float:
    """Return the mean period of a free decay, s, over the swings before the first irregular swing.

    The arguments ``crossings`` and ``extremes`` begin at the first swing (:func:`_swings`).
    """
    if len(crossings) == 1:
        # The extremes of two successive half swings are half a period apart.
        before, after = values[: crossings[0]], values[crossings[0] :]
        near = np.abs(before - extremes[0]) <= EXTREME_RTOL * abs(extremes[0] - extremes[1])
        turns = np.flatnonzero(near)[-1], crossings[0] + np.argmin(np.abs(after - extremes[1]))
        return 2.0 * float(np.ptp(time[[*turns]]))
    halves = np.diff(time[crossings])
    regular = np.abs(halves / np.median(halves) - 1.0) < 0.3
    count = max(int(np.argmin([*regular, False])), 1)
    # Use an even number of half swings, because the two half swings of a period differ in duration if the
    # crossed level is not the rest position.
    count = max(count - count % 2, 1)
    return 2.0 * float(np.sum(halves[:count])) / count


def _decay(log: Log, name: str) -> tuple[Array, Array, float, float]:
    """Return the record of a free decay from its release on, its period (s) and its first amplitude.

    The record consists of times and values. Swings of a free decay do not grow, so that the decay begins with
    the first of the largest swings. If the body was held at an excursion before its release, or was at rest
    before it was deflected, the decay begins at the end of this time.
    """
    column = unwrapped(name, log[name])
    there = np.isfinite(column)
    time, values = log.time_s[there], column[there]
    noise = white_noise_sd(values, 0.0)
    crossings, extremes = _swings(values, noise, log, name)
    heights = np.abs(np.diff(extremes))
    largest = float(heights.max())
    slack = max(EXTREME_RTOL * largest, 3.0 * math.sqrt(2.0) * noise)
    first = int(np.argmax(heights >= largest - slack))
    begin, end = ([0, *crossings.tolist()][first + k] for k in (0, 1))
    period = _period(time, values, crossings[first:], extremes[first:])
    amplitude = 0.5 * float(heights[first])
    part, since = values[begin:end], time[begin:end] - time[begin]
    margin = max(EXTREME_RTOL * amplitude, 3.0 * noise)
    near = np.flatnonzero(np.abs(part - extremes[first]) <= margin)
    held = since[near[-1]] - since[near[0]] > HELD_PERIODS * period
    moving = since[np.abs(part - part[0]) > margin]
    waits = first == 0 and len(moving) > 0 and moving[0] > HELD_PERIODS * period
    late = since[near[0]] > 0.5 * period
    if held:
        level = float(np.median(part[near]))
        spread = 1.4826 * float(np.median(np.abs(part[near] - level)))
        # The release lies between the last sample at this level and the next one.
        begin += int(np.flatnonzero(np.abs(part - level) <= max(3.0 * spread, 1e-3 * amplitude))[-1]) + 1
    elif first or waits or late:
        begin += int(np.argmax(np.abs(part - part[-1])))
    if begin > 0.5 * len(values):
        raise InputError(
            f"the largest swing is at {time[begin]:g} s, in the second half of it: this is no free decay",
            file=log.path,
            column=name,
            hint="cut the log with start_s and end_s in the trials file",
        )
    if begin > 3:
        warn(
            "SWM018",
            f"{log.path.name}: {time[begin] - time[0]:.3g} s before the release from the largest excursion "
            "left out",
        )
    start = int(np.flatnonzero(there)[begin])
    return log.time_s[start:], column[start:], period, amplitude


# ------------------------------------------------------------ encoder


@dataclass(frozen=True)
class Displacement:
    """Displacement record of a trial on a rig, with its known measurement errors.

    Attributes
    ----------
    kind : str
        ``continuous``: there is no encoder. ``clicks``: there is one row for each step of the encoder, so
        that the displacement is exact and the time has an error. ``sampled``: the rows are the count of the
        encoder at regular times.
    time_s, position : ndarray, shape (n,)
        Samples of the record. If ``rounded`` is 0 or 1, these are the times at which a sampled count changed.
    resolution : float or None
        Step of the encoder, in the unit of the displacement; None without an encoder.
    time_sd_s : float or ndarray, shape (n,)
        Standard deviation of the times, due to the sampling interval.
    position_sd : float
        Standard deviation of the positions, due to the step of the encoder.
    rounded : int or None
        Number of the case in :data:`ROUNDINGS`; None if the positions are not those of a sampled count.
    """

    kind: Literal["continuous", "clicks", "sampled"]
    time_s: Array
    position: Array
    resolution: float | None = None
    time_sd_s: float | Array = 0.0
    position_sd: float = 0.0
    rounded: int | None = None


#: Possible roundings of an encoder count. Each has the difference of true position and count, in encoder
#: steps, in three cases: when the count rises, when it falls, and on average while it is constant.
ROUNDINGS = {"floor": (0.0, 1.0, 0.5), "nearest": (-0.5, 0.5, 0.0), "ceil": (-1.0, 0.0, -0.5)}


def read_encoder(time_s: Array, position: Array, resolution: float | None = None) -> Displacement:
    """Detect an encoder in a displacement record, and return the record with its measurement errors.

    Parameters
    ----------
    resolution : float, optional
        Known step of the encoder. It is needed for records that move several steps per sample.
    """
    plain = Displacement("continuous", time_s, position)
    step = step_of(position)
    if step is None:
        return plain
    counts = np.round((position - position[0]) / step).astype(int)
    moves = np.diff(counts)
    forward = moves[moves != 0]
    if len(forward) < 3 or np.mean(np.sign(forward) == np.sign(np.median(forward))) < 0.98:
        # Rounded noisy values rise and fall, but the count of an encoder moves in one direction.
        return plain
    if np.mean(np.abs(moves) == 1) > 0.9 and np.std(np.diff(time_s)) >= 0.02 * np.mean(np.diff(time_s)):
        return Displacement("clicks", time_s, position, step)
    if np.median(np.abs(moves)) <= 1 and np.mean(moves == 0) > 0.05:
        at = np.flatnonzero(moves) + 1
        gap = time_s[at] - time_s[at - 1]
        # If the count changed by m steps within an interval, assign the middle one of these m steps to the
        # middle of the interval.
        middle = position[at] - 0.5 * (moves[at - 1] - np.sign(moves[at - 1])) * step
        times = time_s[at] - 0.5 * gap
        # The time of the change is uniformly distributed between two samples. Its standard deviation is the
        # sampling interval divided by sqrt(12).
        falls = int(middle[-1] < middle[0])
        return Displacement("sampled", times, middle, step, gap / np.sqrt(12.0), 0.0, falls)
    if np.median(np.abs(moves)) <= 3 or (resolution is not None and abs(step / resolution - 1) < 0.02):
        return Displacement("sampled", time_s, position, step, 0.0, step / np.sqrt(12.0), 2)
    return plain


def true_position(record: Displacement, rounding: str) -> Array:
    """Return the true positions of an encoder record under an assumed rounding of its counts.

    The rounding is a key of :data:`ROUNDINGS`. A record that was not counted is returned unchanged.
    """
    if record.rounded is None or record.resolution is None:
        return record.position
    return record.position + ROUNDINGS[rounding][record.rounded] * record.resolution
