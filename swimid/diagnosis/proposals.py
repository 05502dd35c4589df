"""Propose trials that a lab could run next, within the limits of the robot and of the tank.

A proposed trial is a sequence of segments of equal duration. :data:`PROPOSALS` lists all of them. A protocol
turns the segments into the command of one kind of experiment: a beat or joint commands, a pulling force, an
input column, a cruise, or a release. A protocol is a function of the segments and of the maximum duration, s.
It returns None if the experiment cannot run the segments within its limits.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.special import chdtri

import swimid
from swimid.diagnosis import settings
from swimid.diagnosis.crossval import project_out, solve_normal
from swimid.diagnosis.gap_file import Advice
from swimid.diagnosis.screening import is_sound
from swimid.diagnosis.study import GapStudy, Hypothesis
from swimid.fitting.drives import Cycle, TailBeat, ease_in, straight
from swimid.fitting.fit_common import Experiment
from swimid.fitting.model import Array, Model, RigCoordinate, SurgeInput, SwimInput, Trial
from swimid.fitting.problem import Problem, map_in_processes
from swimid.logs.experiments import Drive
from swimid.logs.log import Log

if TYPE_CHECKING:
    from swimid.swimmer.model import Swimmer

#: Factors by which a proposed trial multiplies the lowest (LOWER) and the highest (HIGHER) setting of the
#: trials.
LOWER, HIGHER = 0.6, 1.4
#: Turning bias of a proposed beat, as a fraction of its amplitude. Amplitude and bias together then reach at
#: most :data:`HIGHER` times the largest amplitude of the trials.
BIAS = HIGHER - 1.0
#: Sample rate of the joint commands in a command file, Hz.
COMMAND_RATE_HZ = 100.0
#: Minimum number of beats in each segment of a proposed trial, after the ramp.
MIN_SEGMENT_BEATS = 2.0
#: Minimum number of samples of a proposed trial.
MIN_PROPOSAL_SAMPLES = 5
#: Maximum number of times that a proposed trial is shortened until its path fits into the tank.
MAX_CUTS = 8
#: Number of directions in a half circle along which the extent of a path is measured.
DIRECTIONS = 36


class Segment(NamedTuple):
    """Segment of a proposed trial: factors on the settings of the trials.

    A factor below one multiplies the lowest setting of the trials, a factor above one the highest. The factor
    one stands for the setting of the longest trial. With the amplitude zero the robot coasts. The bias is a
    fraction of the amplitude. For a force, a signal or a release, the amplitude is its size. The frequency is
    then the speed at which a recorded signal is played.
    """

    frequency: float = 1.0
    amplitude: float = 1.0
    bias: float = 0.0


#: Proposed trials. Each is a sequence of segments that last equally long.
PROPOSALS: tuple[tuple[Segment, ...], ...] = (
    (Segment(),),
    (Segment(frequency=LOWER),),
    (Segment(frequency=HIGHER),),
    (Segment(amplitude=LOWER),),
    (Segment(amplitude=HIGHER),),
    (Segment(frequency=HIGHER, amplitude=HIGHER),),
    (Segment(frequency=LOWER, amplitude=HIGHER),),
    (Segment(bias=BIAS),),
    (Segment(frequency=LOWER), Segment(frequency=HIGHER)),
    (Segment(amplitude=LOWER), Segment(amplitude=HIGHER)),
    (Segment(bias=-BIAS), Segment(bias=BIAS)),
    (Segment(amplitude=HIGHER), Segment(amplitude=0.0)),
)


@dataclass(frozen=True)
class TrialLimits:
    """Limits of a proposed trial.

    The driven joints of the robot file may state further limits.

    Attributes
    ----------
    experiment : Experiment
    tank_length_m : float or None
        Maximum extent of the path. None stands for the largest extent in the trials.
    max_frequency_hz : float
        Maximum frequency of a beat or stroke.
    max_amplitude_rad : float
            Maximum amplitude of a beat. For strokes and recorded commands, it is the maximum amplitude of
            each joint.
    """

    experiment: Experiment
    tank_length_m: float | None = None
    max_frequency_hz: float = math.inf
    max_amplitude_rad: float = math.inf


@dataclass(frozen=True)
class Proposal:
    """Proposed trial with its command.

    Attributes
    ----------
    text : str
        Text that says what to run.
    trial : Trial
        Trial to simulate, without measured channels.
    entry : mapping
        Keys of the trial's entry in a trials file besides ``id`` and ``log``, or the row of a cruise table.
    columns : mapping of str to ndarray, each shape (n,)
        Columns of the command file, ``t_s`` first.
    """

    text: str
    trial: Trial
    entry: Mapping[str, Any]
    columns: Mapping[str, Array]


#: Type of a protocol: a function of the segments and of the maximum duration of a trial, s.
Protocol = Callable[[Sequence[Segment], float], Proposal | None]


def _duration(trial: Trial) -> float:
    return float(trial.time_s[-1] - trial.time_s[0])


def _longest(trials: Sequence[Trial]) -> Trial:
    return max(trials, key=_duration)


def _cut(time_s: Array, duration_s: float) -> Array:
    """Return the sample times of a trial up to a duration."""
    return time_s[time_s <= time_s[0] + duration_s + 1e-9]


def _constant(segments: Sequence[Segment]) -> Segment | None:
    """Return the only segment of a trial with a motion and without a bias; None for other trials."""
    first = segments[0]
    if len(segments) > 1 or first.bias or not first.amplitude:
        return None
    return first


def round_down(value: float) -> float:
    """Return a value rounded towards zero to three significant digits.

    >>> round_down(2.5199), round_down(-0.12345)
    (2.51, -0.123)
    """
    if value == 0.0 or not math.isfinite(value):
        return value
    digits = 2 - math.floor(math.log10(abs(value)))
    size = math.floor(abs(value) * (1.0 + 1e-9) * 10.0**digits) / 10.0**digits
    return math.copysign(round(size, max(digits, 0)), value)


def choose_level(factor: float, values: Sequence[float], usual: float, most: float = math.inf) -> float:
    """Return the setting for a factor of a segment, at most ``most`` in size."""
    chosen = usual
    if factor > 1.0:
        chosen = round_down(factor * max(values))
    elif factor < 1.0:
        chosen = round_down(factor * min(values))
    return math.copysign(min(abs(chosen), most), chosen)


def change_levels(time_s: Array, levels: Sequence[float], edges_s: Sequence[float], ramp_s: float) -> Array:
    """Return a setting that changes smoothly from one segment to the next, shape (n,).

    Parameters
    ----------
    levels : sequence of float
        Setting of each segment.
    edges_s : sequence of float
        Start of each segment but the first.
    ramp_s : float
        Duration of each change.
    """
    found = np.full(len(time_s), levels[0], dtype=float)
    for change, at in zip(np.diff(levels), edges_s, strict=True):
        found += change * ease_in(time_s - at, ramp_s)
    return found


# ---------------------------------------------------------------- robots with links


def _size(drive: TailBeat | Cycle) -> float:
    """Return the amplitude of a beat in degrees, or the scale of a stroke."""
    if isinstance(drive, TailBeat):
        return math.degrees(drive.amplitude_rad)
    return drive.scale


def _start_from_rest(swim: SwimInput) -> SwimInput:
    """Return the input of a steady beat with the ramp that a trials file has by default."""
    if swim.beat is None or not swim.steady:
        return swim
    ramp_s = Drive.model_fields["ramp_s"].default
    return replace(swim, beat=replace(swim.beat, steady=False, ramp_s=ramp_s))


class Swim:
    """Protocol of a robot with links that starts from rest under a beat, a stroke or joint commands.

    Parameters
    ----------
    model : Swimmer
    trials : sequence of Trial
        Trials of the experiment, whose settings the segments multiply.
    limits : TrialLimits
    """

    def __init__(self, model: Swimmer, trials: Sequence[Trial], limits: TrialLimits) -> None:
        self.swimmer, self.limits = model, limits
        self.template = _longest([t for t in trials if t.swim.drive is not None] or trials)
        self.swim = self.template.swim
        every = [t.swim.drive for t in trials]
        drives = [d for d in every if d is not None and isinstance(d, type(self.swim.drive))]
        self.swim = _start_from_rest(self.swim)
        self.beat, self.stroke = self.swim.beat, self.swim.stroke
        #: Frequencies (Hz) and sizes of the drives of the trials; 1 for recorded commands.
        self.frequencies = [float(d.frequency_hz) for d in drives] or [1.0]
        self.sizes = [_size(d) for d in drives] or [1.0]
        #: Unit of the sizes: one degree (rad) for a beat, otherwise 1.
        self.unit = 1.0
        if self.beat is not None:
            self.unit = math.radians(1.0)
        #: Unit of the frequencies: 1 Hz, or the frequency of a beat in recorded commands (NaN if unknown).
        frequency = settings.list_settings(self.template).get("frequency")
        self.beat_hz = frequency.value if isinstance(frequency, settings.SettingValue) else math.nan
        if drives:
            self.beat_hz = 1.0

    def __call__(self, segments: Sequence[Segment], duration_s: float) -> Proposal | None:
        """Return a trial of these segments; its amplitude is lowered to the limits of the joints."""
        if self.beat is None and any(s.bias for s in segments):
            return None
        duration_s = min(duration_s, _duration(self.template))
        found, excess = self._at_size(segments, duration_s, 1.0)
        if excess > 1.0:
            found, excess = self._at_size(segments, duration_s, 0.999 / excess)
        if excess > 1.0:
            return None
        return found

    def _at_size(
        self, segments: Sequence[Segment], duration_s: float, factor: float
    ) -> tuple[Proposal | None, float]:
        """Return a trial with all amplitudes multiplied by ``factor``, and the excess over the joint limits.

        The excess is the largest ratio of an angle or a rate to its limit.
        """
        usual = self.swim.drive
        f, a, b = self._choose_levels(segments, factor)
        if self.swim.joints is not None and usual is None:
            # A record that is played faster ends earlier.
            duration_s = min(duration_s, _duration(self.template) * len(f) / sum(f))
        # The number of beats in each segment is NaN if the frequency of recorded commands is unknown.
        lengths = np.full(len(f), duration_s / len(f))
        lengths[0] -= getattr(usual, "ramp_s", 0.0)
        beats = (lengths * f * self.beat_hz)[np.array(a) != 0.0]
        sampled = _cut(self.template.time_s, duration_s)
        if np.any(beats < MIN_SEGMENT_BEATS - 1e-3) or len(sampled) < MIN_PROPOSAL_SAMPLES:
            return None, 0.0
        time = np.arange(round(duration_s * COMMAND_RATE_HZ) + 1) / COMMAND_RATE_HZ
        if usual is not None and len(f) == 1:
            # A trials file can state this motion without a command file.
            swim = self._scale_drive(f[0], self.unit * a[0], self.unit * b[0], steady=False)
        else:
            swim = self._join_segments(f, a, b, time, duration_s)
        angles = [self.swimmer.command(k, swim, time, 0.0) for k in range(len(self.swimmer.actuators))]
        names = [actuator.command for actuator in self.swimmer.actuators]
        held = {"drive_phase", *(p.name for p in self.swimmer.parameters if p.name.startswith("initial_"))}
        swim = replace(swim, pose=self.swim.pose)
        trial = Trial("proposed", "fit", sampled - sampled[0], {}, swim=swim, held=tuple(sorted(held)))
        text = f"{self._words(f, a, b)}, from rest, for {_duration(trial):.3g} s"
        columns = {"t_s": time, **dict(zip(names, angles, strict=True))}
        return Proposal(text, trial, _trial_entry(trial), columns), self._excess(angles)

    def _choose_levels(self, segments: Sequence[Segment], factor: float) -> tuple[list[float], ...]:
        """Return frequency, size and bias of each segment, with all sizes multiplied by ``factor``."""
        limits, usual = self.limits, self.swim.drive
        hz, size = 1.0, 1.0
        most_hz, most = limits.max_frequency_hz, math.inf
        if usual is not None:
            hz, size = float(usual.frequency_hz), _size(usual)
        elif math.isfinite(self.beat_hz):
            most_hz /= self.beat_hz
        if self.beat is not None:
            most = math.degrees(limits.max_amplitude_rad)
        f = [choose_level(s.frequency, self.frequencies, hz, most_hz) for s in segments]
        a = [choose_level(s.amplitude, self.sizes, size, most) for s in segments]
        if factor < 1.0:
            a = [round_down(factor * one) for one in a]
        return f, a, [round_down(s.bias * one) for s, one in zip(segments, a, strict=True)]

    def _scale_drive(self, hz: float, size: float, bias_rad: float, *, steady: bool) -> SwimInput:
        """Return the input with a single drive: a beat (size in rad), a stroke, or recorded commands.

        Recorded commands have the size 1, or no motion at the size 0.
        """
        if self.beat is not None:
            beat = replace(self.beat, frequency_hz=hz, amplitude_rad=size, bias_rad=bias_rad, steady=steady)
            return replace(self.swim, beat=beat)
        if self.stroke is not None:
            stroke = replace(self.stroke, frequency_hz=hz, scale=size, steady=steady)
            return replace(self.swim, stroke=stroke)
        if size:
            return self.swim
        return replace(self.swim, joints=[straight for _ in self.swim.joints or ()])

    def _join_segments(
        self, f: Sequence[float], a: Sequence[float], b: Sequence[float], time_s: Array, duration_s: float
    ) -> SwimInput:
        """Return the joint commands of several segments, as they are read from their command file."""
        from swimid.swimmer import drive as driven

        drive = self.swim.drive
        edges = [duration_s * k / len(f) for k in range(1, len(f))]
        begin_s, ramp_s, unit_hz, shift_s = 0.0, 0.5, 1.0, float(self.template.time_s[0])
        if drive is not None:
            unit_hz, shift_s = drive.frequency_hz, 0.0
            begin_s, ramp_s = drive.ramp_s, max(drive.ramp_s, 0.5 / max(f))
        frequency, size, bias = (change_levels(time_s, levels, edges, ramp_s) for levels in (f, a, b))
        if begin_s > 0.0:
            size, bias = (series * ease_in(time_s, begin_s) for series in (size, bias))
        played_s = shift_s + cumulative_trapezoid(frequency / unit_hz, time_s, initial=0.0)
        size, bias = self.unit * size, self.unit * bias
        idle, full = (self._scale_drive(unit_hz, amplitude, 0.0, steady=True) for amplitude in (0.0, 1.0))
        motions = []
        for k, actuator in enumerate(self.swimmer.actuators):
            law = actuator.law
            rest, moved = (self.swimmer.command(k, one, played_s, 0.0) for one in (idle, full))
            turn = driven.use_default(law.bias_gain, law.gain) * bias
            angle = rest + size * (moved - rest) + turn
            motions.append(driven.spline_motion(driven.fit_spline(time_s, angle)))
        commanded = self.swim.commanded or drive is not None
        return replace(self.swim, beat=None, stroke=None, joints=motions, commanded=commanded)

    def _excess(self, angles: Sequence[Array]) -> float:
        """Return the largest ratio of the angle or rate of an actuator to its limit."""
        found = [0.0]
        for actuator, angle in zip(self.swimmer.actuators, angles, strict=True):
            law, rate = actuator.law, float(np.max(np.abs(np.diff(angle)))) * COMMAND_RATE_HZ
            if law.max_angle_deg is not None:
                found.append(math.degrees(float(np.max(np.abs(angle)))) / law.max_angle_deg)
            if law.max_rate_deg_s is not None:
                found.append(math.degrees(rate) / law.max_rate_deg_s)
            if self.beat is None:
                found.append(0.5 * float(np.ptp(angle)) / self.limits.max_amplitude_rad)
        return max(found)

    def _words(self, f: Sequence[float], a: Sequence[float], b: Sequence[float]) -> str:
        """Return text that says what to run, for the frequency, size and bias of each segment."""
        run, speed, unit = "swim", "Hz", "deg"
        if self.stroke is not None:
            run, unit = f"swim with the stroke {self.stroke.name}", "times its angles"
        elif self.beat is None:
            run = f"play the commands of {self.template.id}"
            speed, unit = "times the speed", "times the angles"
        said = []
        for hz, size, bias in zip(f, a, b, strict=True):
            turn = f" with a bias of {bias:.3g} deg" * bool(bias)
            word = f"at {hz:.3g} {speed} and {size:.3g} {unit}{turn}"
            if size == 0.0:
                word = "without a beat (coast)"
            said.append(word)
        return f"{run} {', then '.join(said)}"


def _trial_entry(trial: Trial) -> dict[str, Any]:
    """Return the keys of a trial of a robot with links in a trials file."""
    entry: dict[str, Any] = {}
    if trial.swim.drive is not None:
        from swimid.simulation.cases import drive_block

        entry["drive"] = drive_block(trial)
    if trial.swim.coefficients:
        entry["coefficients"] = {name: float(v) for name, v in trial.swim.coefficients.items()}
    return entry


# ---------------------------------------------------------------- other experiments


def pull(
    trials: Sequence[Trial], limits: TrialLimits, segments: Sequence[Segment], duration_s: float
) -> Proposal | None:
    """Return a trial of a body that another falling weight or constant force pulls.

    Under quadratic drag, a force passes through the same positions as another force, in times that are
    proportional to the inverse square root of the force. The sample times of the trial with the nearest force
    are therefore scaled by this factor.
    """
    only, template, forces = _constant(segments), _longest(trials), [t.rig.pull for t in trials]
    if only is None or only.frequency != 1.0 or not min(forces) > 0:
        return None
    gravity = limits.experiment.robot.fluid.gravity_m_s2
    key, unit, per = "driving_force_N", "N", 1.0
    if template.rig.pulley:
        key, unit, per = "pulling_mass_kg", "kg", gravity
    size = choose_level(only.amplitude, [one / per for one in forces], template.rig.pull / per)
    force = size * per
    near = min(trials, key=lambda t: abs(math.log(t.rig.pull / force)))
    rig = replace(near.rig, force=force)
    if rig.pulley:
        rig = replace(rig, inertia=rig.inertia + (force - near.rig.pull) / gravity)
    slower = math.sqrt(near.rig.pull / force)
    time = _cut(rig.begin_s + slower * (near.time_s - rig.begin_s), duration_s)
    if len(time) < MIN_PROPOSAL_SAMPLES:
        return None
    trial = Trial("proposed", "fit", time, {}, rig=rig, held=near.held)
    columns = {"t_s": time, "force_N": np.full(len(time), force)}
    text = f"pull with {size:.3g} {unit}, for {_duration(trial):.3g} s"
    return Proposal(text, trial, {key: round(size, 9)}, columns)


def play(
    trials: Sequence[Trial], column: str, segments: Sequence[Segment], duration_s: float
) -> Proposal | None:
    """Return a trial in which an input column of the longest trial is scaled and played at another speed.

    The column is a towing force, or the input of a black-box model.
    """
    if any(s.bias for s in segments):
        return None
    template = _longest(trials)
    f, a = [s.frequency for s in segments], [s.amplitude for s in segments]
    duration_s = min(duration_s, _duration(template), _duration(template) * len(f) / sum(f))
    time = _cut(template.time_s, duration_s)
    if len(time) < MIN_PROPOSAL_SAMPLES:
        return None
    # A step of the input takes one sampling interval.
    step_s = float(time[1] - time[0])
    edges = [time[0] + duration_s * k / len(f) for k in range(1, len(f))]
    speed, size = (change_levels(time, levels, edges, step_s) for levels in (f, a))
    played = time[0] + cumulative_trapezoid(speed, time, initial=0.0)
    inputs = {column: size * np.interp(played, template.time_s, template.inputs[column])}
    trial = Trial("proposed", "fit", time, {}, inputs, template.rig, held=template.held)
    parts = ["at zero"] * len(segments)
    for k, s in enumerate(segments):
        if s.amplitude:
            parts[k] = f"{s.amplitude:g} times as large and {s.frequency:g} times as fast"
    text = f"play {column} of {template.id} {', then '.join(parts)}, for {_duration(trial):.3g} s"
    return Proposal(text, trial, {}, {"t_s": time, **inputs})


def cruise(
    model: Model, trials: Sequence[Trial], limits: TrialLimits, segments: Sequence[Segment], duration_s: float
) -> Proposal | None:
    """Return a steady beat with another frequency or amplitude, for a model that averages over beats.

    The trial is a timed cruise, or straight swimming.
    """
    only, template = _constant(segments), _longest(trials)
    if only is None:
        return None
    frequencies, sizes = (np.concatenate(parts) for parts in zip(*(t.steady for t in trials), strict=True))
    hz, size = (float(values[0]) for values in template.steady)
    hz = choose_level(only.frequency, frequencies.tolist(), hz, limits.max_frequency_hz)
    most = math.degrees(limits.max_amplitude_rad)
    deg = choose_level(only.amplitude, np.degrees(sizes).tolist(), math.degrees(size), most)
    text = f"swim at {hz:.3g} Hz and {deg:.3g} deg"
    setting = {"frequency_hz": hz, "amplitude_deg": round(deg, 9)}
    if not model.timed_runs:
        time = _cut(template.time_s, duration_s)
        if len(time) < MIN_PROPOSAL_SAMPLES or _duration(template) * hz < MIN_SEGMENT_BEATS:
            return None
        surge = SurgeInput(hz, math.radians(deg), float(time[0]))
        trial = Trial("proposed", "fit", time, {}, surge=surge, held=template.held)
        facts = limits.experiment.facts
        shape = {name: facts[name] for name in ("waveform", "asymmetry") if facts.get(name)}
        entry: dict[str, Any] = {"drive": {**shape, **setting}}
        end_s = float(time[-1])
        text += f", for {_duration(trial):.3g} s"
    else:
        distance_m = min(float(template.inputs["distance_m"][0]), limits.tank_length_m or math.inf)
        inputs = {"frequency_hz": hz, "amplitude_rad": math.radians(deg), "distance_m": distance_m}
        columns = {name: np.array([v]) for name, v in inputs.items()}
        trial = Trial("proposed", "fit", np.zeros(1), {}, columns, cruise=template.cruise)
        entry = {"fin": template.cruise.fin, **setting, "distance_m": distance_m}
        # Estimate the duration from the slowest cruise. The run ends at its distance.
        speeds = np.concatenate([v for t in trials for v in t.measured.values()])
        end_s = distance_m / float(np.nanmin(speeds))
        text += f" with the fin {template.cruise.fin}, over {distance_m:.3g} m"
    columns = {"t_s": np.array([0.0, end_s]), **{name: np.full(2, v) for name, v in setting.items()}}
    return Proposal(text, trial, entry, columns)


def release(
    rig: RigCoordinate, trials: Sequence[Trial], segments: Sequence[Segment], duration_s: float
) -> Proposal | None:
    """Return a free decay after a release from rest at another position or angle."""
    only, template = _constant(segments), _longest(trials)
    if only is None or only.frequency != 1.0:
        return None
    away = [abs(t.rig.x0) for t in trials]
    x0 = math.copysign(choose_level(only.amplitude, away, abs(template.rig.x0)), template.rig.x0)
    own = replace(template.rig, x0=x0)
    trial = Trial("proposed", "fit", template.time_s, {}, rig=own, held=template.held)
    ends = np.array([own.begin_s, float(template.time_s[-1])])
    columns = {"t_s": ends, rig.displacement.name: np.array([x0, np.nan])}
    text = f"release at {x0:.3g} {rig.displacement.unit}, for {_duration(trial):.3g} s"
    return Proposal(text, trial, {}, columns)


def _swim_protocol(swimmer: Swimmer, trials: Sequence[Trial], limits: TrialLimits) -> Swim | None:
    """Return the protocol of a robot with links; None if nothing drives it."""
    moved = [t for t in trials if t.swim.drive is not None or t.swim.joints]
    return Swim(swimmer, moved, limits) if moved and swimmer.driven else None


def _is_steady(trial: Trial) -> bool:
    """Return whether a trial is one steady beat of known frequency and amplitude."""
    return len(trial.steady[0]) == 1 and bool(np.isfinite(trial.steady).all())


def protocol_of(model: Model, trials: Sequence[Trial], limits: TrialLimits) -> Protocol | None:
    """Return the protocol of an experiment; None if nothing in it can be commanded."""
    swimmer, rig = model.swimmer, model.rig
    if swimmer is not None:
        return _swim_protocol(swimmer, trials, limits)
    if all(_is_steady(t) for t in trials):
        return partial(cruise, model, trials, limits)
    if rig is not None and rig.swings:
        return partial(release, rig, trials)
    column = getattr(model, "source", "force_N")
    if all(column in t.inputs for t in trials):
        return partial(play, trials, column)
    if rig is not None and all(t.rig.force is not None for t in trials):
        return partial(pull, trials, limits)
    return None


# ---------------------------------------------------------------- tank


def extents(columns: Mapping[str, Array]) -> Array:
    """Return the largest distance between two positions so far, at each sample, m, shape (n,).

    The positions are horizontal. The result is 0 without a position.
    """
    x, y = (np.atleast_1d(columns.get(name, 0.0)) for name in ("x_m", "y_m"))
    angles = np.pi * np.arange(DIRECTIONS)[:, None] / DIRECTIONS
    along = x * np.cos(angles) + y * np.sin(angles)
    ends = np.fmax.accumulate(along, axis=1) - np.fmin.accumulate(along, axis=1)
    return np.asarray(np.max(ends, axis=0))


def time_inside(time_s: Array, columns: Mapping[str, Array], length_m: float) -> float:
    """Return the duration for which a simulated path is no longer than ``length_m``, s.

    The duration is infinite if the whole path fits.
    """
    outside = np.flatnonzero(extents(columns) > length_m)
    if not len(outside):
        return math.inf
    return float(time_s[max(outside[0] - 1, 0)] - time_s[0])


def tank_length(trials: Sequence[Trial], limits: TrialLimits) -> float:
    """Return the maximum extent of a path, m: the stated one, or else the largest extent in the trials."""
    if limits.tank_length_m is not None:
        return limits.tank_length_m
    found = [float(np.nanmax(extents(t.measured), initial=0.0)) for t in trials]
    return max(found) or math.inf


def shorten(
    protocol: Protocol,
    segments: Sequence[Segment],
    length_m: float,
    paths: Callable[[Trial], Sequence[Mapping[str, Array]]],
) -> Proposal | None:
    """Return a proposed trial, shortened until no simulated path leaves the tank; None if this fails.

    Parameters
    ----------
    paths : callable
            Function that returns the channels that each rival model simulates in a trial.
    """
    duration_s = math.inf
    for _ in range(MAX_CUTS):
        found = protocol(segments, duration_s)
        if found is None:
            return None
        # Give each trial an id of its own, because simulations are cached by the id of the trial.
        found = replace(found, trial=replace(found.trial, id=found.text))
        inside_s = min(time_inside(found.trial.time_s, columns, length_m) for columns in paths(found.trial))
        if inside_s == math.inf:
            return found
        duration_s = min(inside_s, 0.999 * _duration(found.trial))
    return None


# ---------------------------------------------------------------- advice

#: Maximum number of proposed experiments in a report.
MAX_ADVICE = 4
#: Probability that the difference between two rivals due to noise alone is below :func:`compute_threshold`.
CONFIDENCE_LEVEL = 0.95
#: Name of the command file of a proposed trial if the user gives none.
COMMAND_FILE = "next.csv"


def compute_threshold(rivals: Sequence[Hypothesis]) -> float:
    """Return the difference between two rivals that noise alone may make, in noise standard deviations.

    A refit to pure noise lowers the squared residuals by a chi-square variable. Its degrees of freedom are
    the number of parameters that act on one trial.
    """
    most = max(len(fit.problem.taken[0]) for fit in rivals)
    return math.sqrt(float(chdtri(most, 1.0 - CONFIDENCE_LEVEL)))


def advise_trials(
    study: GapStudy, rivals: Sequence[Hypothesis], limits: TrialLimits, now: float
) -> list[Advice]:
    """Rank proposed trials by how well they would distinguish the first rival cause from the others.

    A trial distinguishes two rivals if their difference exceeds what noise alone may make. Trials that
    distinguish more rivals come first, then those with a larger difference. The last advice names the rivals
    that no trial distinguishes.

    Parameters
    ----------
    rivals : sequence of Hypothesis
        At least two fits, each with one of the rival causes.
    now : float
        Difference between the first two rival fits on the present trials, in noise standard deviations. It is
        the square root of the difference of their held-out squared residuals.
    """
    protocol = protocol_of(study.model, study.trials, limits)
    if protocol is None:
        return []
    models = [RivalModel(study, fit) for fit in rivals]
    length_m = tank_length(study.trials, limits)
    first, *others = [fit.effects[-1].name for fit in rivals]
    least = compute_threshold(rivals)

    def evaluate(segments: Sequence[Segment]) -> Advice | None:
        found = shorten(protocol, segments, length_m, lambda trial: [one.simulate(trial) for one in models])
        if found is None:
            return None
        advice = Advice(text=found.text, noise=least, now=now)
        sizes = [compute_difference(models[0], other, found.trial) for other in models[1:]]
        apart = {name: size for name, size in zip(others, sizes, strict=True) if size > least}
        if apart:
            advice.separates, advice.difference = [first, *apart], min(apart.values())
            advice._command = _log(found, advice, limits)
        return advice

    made = map_in_processes(evaluate, PROPOSALS, study.jobs)
    possible = {a.text: a for a in made if a is not None}
    found = [a for a in possible.values() if a.separates]
    found.sort(key=lambda a: (-len(a.separates), -(a.difference or 0.0)))
    left = [name for name in others if not any(name in a.separates for a in found)]
    found = found[:MAX_ADVICE]
    if left:
        found.append(Advice(text=_nothing(first, left, len(possible), length_m, least), noise=least))
    return found


def _nothing(first: str, left: Sequence[str], count: int, length_m: float, least: float) -> str:
    """Return a clause about rivals that no proposed trial distinguishes."""
    rivals = f"{first} from {' or '.join(left)}"
    if not count:
        return (
            f"none: no trial of {MIN_SEGMENT_BEATS:g} beats and {MIN_PROPOSAL_SAMPLES} samples satisfies the "
            f"limits (a path of at most {length_m:.3g} m), so that no trial distinguishes {rivals}"
        )
    return (
        f"none: none of {count} possible trials distinguishes {rivals} by more than the noise "
        f"({least:.2g} standard deviations)"
    )


def _log(proposal: Proposal, advice: Advice, limits: TrialLimits) -> Log:
    """Return the command file of a proposed trial."""
    sizes = {"difference": advice.difference, "noise": advice.noise, "now": advice.now}
    metadata = {
        "made_by": "swimid diagnose",
        "version": swimid.__version__,
        "robot": limits.experiment.robot.name,
        "experiment": limits.experiment.name,
        "run": advice.text,
        "separates": advice.separates,
        **{name: float(f"{size:.3g}") for name, size in sizes.items()},
        "trial": {"id": Path(COMMAND_FILE).stem, "log": COMMAND_FILE, **proposal.entry},
    }
    return Log(Path(COMMAND_FILE), metadata, dict(proposal.columns), None)


# ---------------------------------------------------------------- difference between rivals


class RivalModel:
    """Fitted model with a rival cause, which predicts proposed trials.

    Attributes
    ----------
    values : mapping of str to float
            Estimate of each parameter by name. For a parameter with a value for each trial, it is the mean of
            these values.
    sd : mapping of channel to float
        Typical noise of each measured channel.
    shared : list of str
        Names of the parameters that all trials share.
    precision : ndarray, shape (shared, shared)
        Precision matrix of these parameters from the present trials and the priors. The parameters of single
        trials are projected out.
    """

    def __init__(self, study: GapStudy, fit: Hypothesis) -> None:
        self.study, self.fit = study, fit
        problem = fit.problem
        names = np.array([problem.parameters[index].name for index, _ in problem.slots])
        self.values = {str(name): float(np.mean(fit.theta[names == name])) for name in names}
        sd: dict[str, list[Array]] = {}
        for channels, series in zip(problem.channels, problem.sd, strict=True):
            for channel, own in zip(channels, series, strict=True):
                sd.setdefault(channel, []).append(own)
        self.sd = {channel: float(np.median(np.concatenate(own))) for channel, own in sd.items()}
        shared = [j for j, (_, owner) in enumerate(problem.slots) if owner is None]
        self.shared = [fit.labels[j] for j in shared]
        self.precision = study.precision(problem)[np.ix_(shared, shared)]
        for k, residuals in enumerate(fit.residuals):
            # The function project_out() expects the residuals in the last column.
            block = np.column_stack((fit.columns(k, shared), residuals))
            seen = project_out(study, fit, k, block)[:, :-1]
            self.precision = self.precision + seen.T @ seen

    def problem(self, trial: Trial) -> tuple[Problem, Array]:
        """Return the residual problem of a proposed trial, with samples of zero, and the estimates."""
        measured = {channel: np.zeros(len(trial.time_s)) for channel in self.sd}
        trial = replace(trial, measured=measured)
        problem = self.study.problem(self.fit.effects, jobs=1, trials=[trial])
        problem.sd[0] = [np.full(len(trial.time_s), self.sd[c]) for c in problem.channels[0]]
        own = [self.values.get(problem.parameters[index].name, math.nan) for index, _ in problem.slots]
        return problem, np.where(np.isnan(own), problem.start, own)

    def simulate(self, trial: Trial) -> dict[str, Array]:
        """Return all channels of a proposed trial, measured or not."""
        problem, theta = self.problem(trial)
        return problem.model.run(problem.vector(theta, 0), problem.trials[0])

    def predict(self, trial: Trial) -> tuple[Array, Array, Array]:
        """Return the whitened samples of a proposed trial, their derivatives, and the prior precision.

        The derivatives have one column for each parameter that acts on the trial.
        """
        problem, theta = self.problem(trial)
        noise = self.study.noise
        samples = -noise.whiten(problem, 0, problem.trial_residuals(theta, 0))
        rows = -noise.whiten(problem, 0, problem.trial_jacobians(theta)[0])
        _, weight = self.study.compute_prior(problem)
        precision = np.diag(weight**2)
        at = [problem.labels.index(name) for name in self.shared]
        precision[np.ix_(at, at)] = self.precision
        return samples, rows, precision


def compute_difference(first: RivalModel, second: RivalModel, trial: Trial) -> float:
    """Return the difference between two rivals in a proposed trial, in noise standard deviations.

    The difference is the root of the squared residuals that one rival has if the other one is right. The
    wrong rival is refitted to the present trials and the proposed one together. Each rival is taken as right
    in turn, and the smaller difference is returned.
    """
    one, other = first.predict(trial), second.predict(trial)
    apart = one[0] - other[0]
    if not is_sound(apart):
        return 0.0
    left = []
    for _, rows, precision in (one, other):
        right = (rows.T @ apart)[:, None]
        taken = right.T @ solve_normal(rows.T @ rows + precision, right)
        left.append(float(apart @ apart - taken[0, 0]))
    return math.sqrt(max(min(left), 0.0))
