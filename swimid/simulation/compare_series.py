"""What ``compare`` compares: the channels of each trial, measured beside simulated; the comparison file."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Literal, NamedTuple

import numpy as np
from pydantic import Field
from scipy.integrate import cumulative_trapezoid

from swimid.errors import NoTrustworthyResult, UsageError, suggestion
from swimid.files import yamlio
from swimid.files.yamlio import Number, Numbers
from swimid.fitting import metrics, mistakes, output_error
from swimid.fitting.experiment import Experiment
from swimid.fitting.model import Array, Channel, Model, Trial
from swimid.logs.sampling import slope
from swimid.notices import warn
from swimid.simulation import cases, swim_quantities
from swimid.simulation.catalogue import Applied
from swimid.swimmer.planar.model import Body


class ChannelScore(yamlio.Document):
    """Errors of one channel, in its unit; measured minus simulated."""

    unit: str
    #: ``logged``, or ``pose``: derived from the logged pose and the simulated one alike.
    source: Literal["logged", "pose"] = "logged"
    rmse: Number = None
    #: Over the measured range (tendon fish, Eq 13).
    nrmse: Number = None
    vaf: Number = None
    fit_percent: Number = None
    bias: Number = None
    samples: int
    #: Difference of the largest magnitudes, and that over the measured one (tendon fish, Eq 14).
    peak_error: Number = None
    peak_error_normalised: Number = None
    #: Of the simulation ahead of the measurement, at the beat.
    phase_error_rad: Number = None
    #: Error per sample left when time may be stretched within a quarter of a beat.
    dtw_distance: Number = None


class CycleTable(yamlio.Document):
    """Means and largest magnitudes of every whole stroke."""

    time_s: Numbers
    mean_measured: Numbers
    mean_simulated: Numbers
    peak_measured: Numbers
    peak_simulated: Numbers


class Speed(yamlio.Document):
    """Mean speed over the last whole beats, m/s."""

    measured: Number = None
    simulated: Number = None
    beats: int


class Cruise(yamlio.Document):
    """Steady swimming of the model under the drive of a trial that begins in motion.

    The start speed of such a trial comes from the trial itself, so its simulated speed is no prediction
    before the speed has settled.
    """

    #: Speed at which the model settles, m/s; null where it never settles.
    settled: Number = None
    #: Time in which a difference from that speed falls by a factor e, s; null where it never settles.
    settling_s: Number = None
    #: Whether the measured speed is steady, so that the two can be compared.
    steady: bool


class TrialComparison(yamlio.Document):
    """One trial."""

    id: str
    role: Literal["fit", "validate"]
    #: Start state: from the parameter file, estimated from this trial, or at rest at the first pose.
    start: Literal["file", "estimated", "neutral"]
    start_values: dict[str, float] = {}
    frequency_hz: Number = None
    #: What drove it.
    drive: dict[str, Any] = {}
    channels: dict[str, ChannelScore]
    cycles: dict[str, CycleTable] = {}
    mean_speed: Speed | None = None
    cruise: Cruise | None = None


class CycleComparison(yamlio.Document):
    """One stroke of a motion profile: quantities by name (Tables I and II of the sea lion paper), in SI."""

    cycle: int
    #: Means over the profile's trials.
    measured: dict[str, Number]
    simulated: dict[str, Number]
    #: Standard deviation over them, where there are several.
    spread: dict[str, Number] = {}


class ProfileComparison(yamlio.Document):
    """Trials that repeat one motion, the mean of them against that of their simulations."""

    name: str
    trials: list[str]
    cycles: list[CycleComparison] = []
    #: Between the mean paths, and the mean angles.
    position_rmse_m: Number = None
    orientation_rmse_rad: Number = None
    #: From the first sample to the last, ``measured`` and ``simulated``.
    surge_m: dict[str, Number] = {}
    heave_m: dict[str, Number] = {}


class ComparisonFile(yamlio.ResultFile):
    """A comparison file."""

    kind: ClassVar[str] = "comparison file"
    format: Literal["swimid-comparison/1"] = "swimid-comparison/1"
    verdict: Literal["good", "caution", "bad"]
    model: str
    robot: str
    experiment: str
    params: str
    #: All trials together, by channel.
    channels: dict[str, ChannelScore]
    trials: list[TrialComparison]
    #: Of a robot in space.
    profiles: list[ProfileComparison] = []
    #: Root-mean-square error of the mean speeds of all trials, m/s.
    mean_speed_rmse_m_s: Number = None
    provenance: dict[str, Any] = Field(default_factory=dict)

    @property
    def mean_speeds(self) -> list[tuple[TrialComparison, float, float]]:
        """The trials that have a mean speed, with the measured and the simulated one, m/s."""
        return [
            (t, t.mean_speed.measured, t.mean_speed.simulated)
            for t in self.trials
            if t.mean_speed and t.mean_speed.measured is not None and t.mean_speed.simulated is not None
        ]


Start = Literal["file", "estimated", "neutral"]
#: Per-trial parameters that say how a trial starts and is seen, and nothing of the robot.
STARTS = ("start_", "initial_", "clock_offset", "drive_phase", "camera_rotation", "rest_position")
#: Half width of the derivative's window: this share of a beat, or s where there is none.
WINDOW_BEATS, WINDOW_S = 0.2, 0.15
#: Minimum number of samples of a stroke, and of their share of what a whole one has.
MIN_SAMPLES, WHOLE = 4, 0.95


@dataclass(frozen=True)
class Pair:
    """One channel, measured and simulated at the same times.

    Attributes
    ----------
    source : {"logged", "pose"}
        ``pose``: both series derived from positions by the same smoothing derivative.
    time_s, measured, simulated : ndarray, shape (n,)
    """

    channel: Channel
    source: Literal["logged", "pose"]
    time_s: Array
    measured: Array
    simulated: Array


class Compared(NamedTuple):
    """One trial: its channels, the parameters of its simulation, and what the comparison file says of it."""

    trial: Trial
    pairs: dict[str, Pair]
    #: The same with positions in the trial's own axes (:func:`swimid.fitting.metrics.own_axes`), for scores.
    own: dict[str, Pair]
    values: Array
    record: TrialComparison

    @property
    def errors(self) -> mistakes.Errors:
        """Errors of the measured channels, as the search for usual mistakes takes them."""
        simulated = {n: p.simulated for n, p in self.pairs.items() if n in self.trial.measured}
        return mistakes.misfits(self.trial, simulated)


def compared(
    experiment: Experiment, applied: Applied, trial: Trial, *, refit: bool, channels: Sequence[str] = ()
) -> Compared:
    """Simulate a trial and set its channels beside the measured ones.

    Parameters
    ----------
    refit : bool
        Estimate the start state of a trial that the parameter file does not know, all shared
        parameters held.
    channels : sequence of str
        Compare these only.

    Raises
    ------
    UsageError
        For a channel the trial has not.
    NoTrustworthyResult
        When the simulation breaks down.
    """
    model: Model = experiment.model
    values, start, start_values = start_of(applied, trial, refit)
    if refit:
        model, level = model.at_own_level(values, trial)
        if level:
            start, start_values = "estimated", level
    simulated = model.attempt(values, trial)
    logged = {**{k: v for k, v in trial.inputs.items() if k in simulated}, **trial.measured}
    for channel in model.given(trial):
        logged.pop(channel, None)
    pairs = {
        c.name: Pair(c, "logged", trial.time_s, logged[c.name], simulated[c.name])
        for c in model.channels
        if c.name in logged and np.isfinite(logged[c.name]).sum() > 1
    }
    for pair in pairs.values():
        lost = np.isfinite(pair.measured) & ~np.isfinite(pair.simulated)
        if lost.any() and not model.has_gaps:
            where = trial.time_s[int(np.argmax(lost))]
            if trial.swim.steady and lost.sum() == np.isfinite(pair.measured).sum():
                raise NoTrustworthyResult(
                    f"the model has no steady swimming under the drive of '{trial.id}': its speed never "
                    "settles",
                    hint="without drag nothing slows it down; --start-state estimate starts from the trial's "
                    "own speed",
                )
            raise NoTrustworthyResult(
                f"the simulation of '{trial.id}' breaks down at t = {where:.4g} s",
                hint="check the parameters' signs and units and the drive, or take a smaller --dt",
            )
    frequency, body = None, model.body
    if model.swimmer is not None and body is not None:
        turning = (body.velocity[2], body.pose[2]) if body.free else ()
        series = [pairs[name].measured for name in turning if name in pairs]
        frequency = cases.beat_frequency(model.swimmer, trial, values, series)
        pairs |= _velocity_pairs(model, body, trial, pairs, frequency)
    for name in channels:
        if name not in pairs:
            hint = suggestion(name, list(pairs))
            raise UsageError(f"the trial '{trial.id}' has no channel '{name}' to compare", hint=hint)
    pairs = {name: p for name, p in pairs.items() if name in channels or not channels}
    by_stroke: dict[str, CycleTable] = {}
    speed = None
    if body is not None and frequency is not None:
        # a position has no mean of a stroke worth comparing
        positions = body.pose if body.free else ()
        by_stroke = {n: cycles(p, frequency) for n, p in pairs.items() if n not in positions}
        speed = mean_speed(trial, pairs, body, frequency)
    measured, simulated = metrics.own_axes(
        {n: p.measured for n, p in pairs.items()}, {n: p.simulated for n, p in pairs.items()}
    )
    own = {n: replace(p, measured=measured[n], simulated=simulated[n]) for n, p in pairs.items()}
    placed = metrics.pose_channels(model)
    record = TrialComparison(
        id=trial.id,
        role=trial.role,  # type: ignore[arg-type]
        start=start,
        start_values=start_values,
        frequency_hz=frequency,
        drive=cases.drive_block(trial.swim) if trial.swim.beat is not None else {},
        channels={name: scored([p], frequency, own_motion=name in placed) for name, p in own.items()},
        cycles=by_stroke,
        mean_speed=speed,
        cruise=_cruise(applied, trial, values, pairs),
    )
    return Compared(trial, pairs, own, values, record)


def start_of(
    applied: Applied, trial: Trial, refit: bool, tolerance: float = output_error.START_TOLERANCE
) -> tuple[Array, Start, dict[str, float]]:
    """Parameters of a trial with its start state: from the file, estimated, or neutral."""
    model = applied.model
    values = applied.values(trial.id)
    own = [p for p in model.parameters if p.per_trial]
    if any(f"{p.name}[{trial.id}]" in applied.known for p in own):
        return values, "file", {}
    estimated = applied.fitted_per_trial()
    coefficients = model.swimmer.coefficients if model.swimmer is not None else []
    names = {
        p.name
        for p in own
        if (p.free or p.name in estimated)
        and (p.name.startswith(STARTS) or p.name in coefficients)
        and p.name not in applied.chosen
    }
    if not refit or not names:
        return values, "neutral", {}
    sd = _noise(applied, trial)
    best: dict[str, float] = {}
    least = math.inf
    unphased = "drive_phase" in names and "drive_phase" not in trial.starts
    # an unknown phase of the beat has a minimum on every side
    begun = [{"drive_phase": k * math.pi / 2} for k in range(4)] if unphased else [{}]
    for start in begun:
        at = zip(model.parameters, _replaced(model, values, start), strict=True)
        held = tuple(replace(p, start=float(v), free=p.name in names) for p, v in at)
        try:
            labelled = output_error.estimate_start(model, held, trial, sd, tolerance=tolerance)
        except (NoTrustworthyResult, np.linalg.LinAlgError):
            continue
        tried = {label.split("[")[0]: v for label, v in labelled.items()}
        cost = _cost(model, _replaced(model, values, tried), trial, sd)
        if cost < least:
            best, least = tried, cost
    if not best or not np.isfinite(list(best.values())).all():
        warn("SWM056", f"{trial.id}: the start state could not be estimated; it is taken as at rest")
        return values, "neutral", {}
    return _replaced(model, values, best), "estimated", best


def _replaced(model: Model, values: Array, start: Mapping[str, float]) -> Array:
    """The parameters with another start state."""
    values = values.copy()
    for name, value in start.items():
        values[model.index(name)] = value
    return values


def _cost(model: Model, values: Array, trial: Trial, sd: Mapping[str, float]) -> float:
    """Squared residuals of a trial over the noise; infinite where the simulation breaks down."""
    simulated = model.attempt(values, trial)
    total = 0.0
    for channel, size in sd.items():
        there = np.isfinite(trial.measured[channel])
        total += float(np.sum(((trial.measured[channel] - simulated[channel])[there] / size) ** 2))
    return total if math.isfinite(total) else math.inf


def _noise(applied: Applied, trial: Trial) -> dict[str, float]:
    """Noise of the channels a start state is estimated from: those the parameters were fitted to.

    Where none of them was, every measured channel, each with a hundredth of its range.
    """
    known = applied.noise()
    noise = {name: known[name] for name in trial.measured if name in known}
    if noise:
        # axes of the world are no axes of the motion: one noise for both
        place = [name for name in ("x_m", "y_m") if name in noise]
        return noise | dict.fromkeys(
            place, math.hypot(*(noise[n] for n in place)) / math.sqrt(len(place) or 1)
        )
    for name, values in trial.measured.items():
        there = values[np.isfinite(values)]
        noise[name] = (0.01 * float(np.ptp(there)) if len(there) else 0.0) or 1.0
    return noise


def _velocity_pairs(
    model: Model, body: Body, trial: Trial, pairs: Mapping[str, Pair], frequency: float | None
) -> dict[str, Pair]:
    """Surge, sway and turning rate from the pose, where the log has no such columns."""
    if not body.free or not all(name in pairs for name in body.pose):
        return {}
    half = WINDOW_BEATS / frequency if frequency else WINDOW_S
    pose = [pairs[name] for name in body.pose]
    measured = _velocities([p.measured for p in pose], trial.time_s, half)
    simulated = _velocities([p.simulated for p in pose], trial.time_s, half)
    known = {c.name: c for c in model.channels}
    return {
        name: Pair(known[name], "pose", trial.time_s, y, z)
        for name, y, z in zip(body.velocity, measured, simulated, strict=True)
        if name not in pairs and np.isfinite(y).sum() > 8
    }


def _velocities(pose: list[Array], time: Array, half: float) -> list[Array]:
    x, y, heading = pose
    dx, dy, rate = slope(time, x, half), slope(time, y, half), slope(time, heading, half)
    c, s = np.cos(heading), np.sin(heading)
    return [c * dx + s * dy, -s * dx + c * dy, rate]


# ------------------------------------------------------------ numbers


def scored(parts: list[Pair], frequency: float | None = None, *, own_motion: bool = False) -> ChannelScore:
    """Score a channel over one trial, or over several (see :func:`swimid.fitting.metrics.score_trials`)."""
    series = [(p.measured, p.simulated) for p in parts]
    # peaks of a pose are about the trial's own mean
    middle = [float(np.nanmean(y)) if own_motion else 0.0 for y, _ in series]
    measured, simulated = (
        np.concatenate([pair[side] - m for pair, m in zip(series, middle, strict=True)]) for side in (0, 1)
    )
    peak, relative = metrics.peak_error(measured, simulated)
    timing = _timing(parts[0], frequency) if frequency is not None and len(parts) == 1 else {}
    return ChannelScore(
        unit=parts[0].channel.unit,
        source=parts[0].source,
        **vars(metrics.score_trials(series, own_motion=own_motion)),
        peak_error=peak,
        peak_error_normalised=relative,
        **timing,
    )


def pooled(done: Sequence[Compared], model: Model) -> dict[str, ChannelScore]:
    """Return the errors of each channel of a model over all trials that have it, by channel."""
    pose = metrics.pose_channels(model)
    parts = {c.name: [one.own[c.name] for one in done if c.name in one.own] for c in model.channels}
    return {name: scored(pairs, own_motion=name in pose) for name, pairs in parts.items() if pairs}


def cycles(pair: Pair, frequency_hz: float) -> CycleTable:
    """Return means and largest magnitudes of every whole stroke, over the samples both series have.

    Strokes are counted from time zero, where the drive starts. Times are the middles of the strokes. A stroke
    with too few samples has no values.
    """
    time, both = pair.time_s, np.isfinite(pair.measured) & np.isfinite(pair.simulated)
    number = np.floor(time * frequency_hz + 1e-9).astype(int)
    step = float(np.median(np.diff(time)))
    needed = max(MIN_SAMPLES, WHOLE / (frequency_hz * step))
    strokes = np.arange(number[0], number[-1] + 1)
    rows = np.full((4, len(strokes)), np.nan)
    for j, k in enumerate(strokes):
        mine = both & (number == k)
        if mine.sum() >= needed:
            y, z = pair.measured[mine], pair.simulated[mine]
            rows[:, j] = y.mean(), z.mean(), np.abs(y).max(), np.abs(z).max()
    # a stroke that an end of the record cuts is none; one with a gap stays, as NaN
    whole = np.flatnonzero(np.isfinite(rows).all(axis=0))
    kept = slice(whole[0], whole[-1] + 1) if len(whole) else slice(0, 0)
    names = ("mean_measured", "mean_simulated", "peak_measured", "peak_simulated")
    columns = dict(zip(names, rows[:, kept], strict=True))
    return CycleTable.model_validate({"time_s": (strokes[kept] + 0.5) / frequency_hz, **columns})


def _timing(pair: Pair, frequency: float) -> dict[str, float]:
    """Phase error at the beat, and the error left when time may be stretched."""
    phase = metrics.phase_error(pair.measured, pair.simulated, pair.time_s, frequency_hz=frequency)
    # time warping is computed over 2000 samples at most
    keep = slice(None, None, max(1, -(-len(pair.time_s) // 2000)))
    step = float(np.median(np.diff(pair.time_s[keep])))
    band = max(1, round(0.25 / (frequency * step)))
    distance = metrics.dtw_distance(pair.measured[keep], pair.simulated[keep], band=band)
    return {"phase_error_rad": phase, "dtw_distance": distance}


def _cruise(applied: Applied, trial: Trial, values: Array, pairs: Mapping[str, Pair]) -> Cruise | None:
    """Steady speed of the model, for a trial whose start speed is among its parameters; None for others."""
    model = applied.model
    swimmer, body = model.swimmer, model.body
    began = [p.name for p in model.parameters if p.name.startswith("initial_")]
    if swimmer is None or body is None or not any(values[model.index(name)] for name in began):
        return None
    found = swimmer.cruise(values, trial)
    if found is None:
        return None
    frequency = float(trial.swim.drive.frequency_hz) if trial.swim.drive is not None else math.nan
    half = 0.5 * (trial.time_s[0] + trial.time_s[-1])
    speeds = []
    for mine in (trial.time_s <= half, trial.time_s >= half):
        part = {
            name: replace(p, time_s=p.time_s[mine], measured=p.measured[mine], simulated=p.simulated[mine])
            for name, p in pairs.items()
        }
        one = mean_speed(replace(trial, time_s=trial.time_s[mine]), part, body, frequency)
        speeds.append(math.nan if one is None or one.measured is None else one.measured)
    early, late = speeds
    return Cruise(
        settled=found.speed_m_s,
        settling_s=found.settling_s,
        steady=abs(late - early) <= metrics.GOOD_SPEED * abs(late),
    )


def mean_speed(trial: Trial, pairs: Mapping[str, Pair], body: Body, frequency: float) -> Speed | None:
    """Mean speed over the last whole beats, measured and simulated by the same rule."""
    if not body.free:
        return None
    beat = trial.swim.beat
    begin = max(float(trial.time_s[0]), beat.ramp_s if beat is not None else -math.inf)
    pose = [pairs.get(name) for name in body.pose[:2]]
    surge = pairs.get(body.velocity[0])
    series = [p for p in pose if p is not None] if None not in pose else [surge] if surge else []
    if not series:
        return None
    there = np.all([np.isfinite(p.measured) & np.isfinite(p.simulated) for p in series], axis=0)
    if there.sum() < 3:
        return None
    time = trial.time_s[there]
    window = swim_quantities.last_beats(max(begin, float(time[0])), float(time[-1]), frequency)
    if window is None:
        return None
    edges = np.linspace(window.begin_s, window.end_s, window.beats + 1)
    speeds = []
    for side in ("measured", "simulated"):
        means = [_beat_means(time, getattr(p, side)[there], edges) for p in series]
        if len(means) == 1:
            speeds.append(float(means[0].mean()))
        elif window.beats > 1:
            path = float(np.hypot(*(np.diff(m) for m in means)).sum())
            speeds.append(path / (edges[-1] - edges[1]))
        else:
            ends = [np.diff(np.interp(edges, time, getattr(p, side)[there])) for p in series]
            speeds.append(float(np.hypot(*ends)[0]) / (edges[1] - edges[0]))
    return Speed(measured=speeds[0], simulated=speeds[1], beats=window.beats)


def _beat_means(time: Array, values: Array, edges: Array) -> Array:
    """Mean between successive edges, of the series joined by straight lines."""
    integral = cumulative_trapezoid(values, time, initial=0.0)
    means: Array = np.diff(np.interp(edges, time, integral)) / np.diff(edges)
    return means
