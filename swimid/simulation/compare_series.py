"""Measured and simulated channels of each trial for ``compare``, and the comparison file."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Literal, NamedTuple

import numpy as np
from pydantic import Field

from swimid.errors import NoTrustworthyResult, UsageError, suggestion
from swimid.files import yamlio
from swimid.files.yamlio import Number
from swimid.fitting import fit_common, mistakes, output_error
from swimid.fitting.model import Array, Channel, Model, Trial
from swimid.fitting.output_error import Series
from swimid.fitting.problem import StepChoice, choose_step
from swimid.kinematics.cycles import body_velocity, cycle_means, cycle_speeds, last_cycles
from swimid.notices import warn
from swimid.simulation.cases import beat_frequency, drive_block
from swimid.simulation.catalogue import Applied
from swimid.swimmer.planar.model import PlanarBody

Start = Literal["file", "estimated", "neutral"]


class ChannelScore(yamlio.Document):
    """Errors of one channel, measured minus simulated, in the unit of the channel."""

    unit: str
    #: ``logged``, or ``pose`` if the measured and the simulated values are both derived from the pose.
    source: Literal["logged", "pose"] = "logged"
    rmse: Number = None
    #: RMSE divided by the measured range (tendon fish, Eq 13).
    nrmse: Number = None
    vaf: Number = None
    fit_percent: Number = None
    bias: Number = None
    samples: int
    #: Difference of the maximum magnitudes, and its ratio to the measured maximum (tendon fish, Eq 14).
    peak_error: Number = None
    peak_error_normalised: Number = None
    #: Phase lead of the simulation over the measurement at the beat frequency, rad.
    phase_error_rad: Number = None


class Speed(yamlio.Document):
    """Measured and simulated mean speed of a trial over its last whole beats, m/s.

    See :func:`swimid.kinematics.cycles.cycle_speeds`.
    """

    measured: float
    simulated: float
    beats: int


class CruiseSpeed(yamlio.Document):
    """Steady swimming of the model under the drive of a trial that begins in motion.

    The start speed of such a trial is estimated from the trial. The simulated speed is therefore a prediction
    only after it has become steady.
    """

    #: Steady speed of the model, m/s; null if the speed never becomes steady.
    settled: Number = None
    #: Whether the measured speed of the trial is steady, so that it can be compared with ``settled``.
    steady: bool


class TrialComparison(yamlio.Document):
    """Entry of one trial in the comparison file: start state, drive, and errors of its channels."""

    id: str
    role: Literal["fit", "validate"]
    #: Source of the initial state of the simulation: the parameter file, an estimate from the trial, or the
    #: assumption of rest at the first measured pose.
    start: Start
    start_values: dict[str, float] = {}
    frequency_hz: Number = None
    #: Drive of the trial, with the keys of a trials file.
    drive: dict[str, Any] = {}
    channels: dict[str, ChannelScore]
    mean_speed: Speed | None = None
    cruise: CruiseSpeed | None = None


class CycleComparison(yamlio.Document):
    """Measured and simulated quantities of one stroke of a motion profile (sea lion, Tables I and II).

    The quantities are in SI units, by name.
    """

    cycle: int
    #: Mean of each quantity over the trials of the profile.
    measured: dict[str, Number]
    simulated: dict[str, Number]
    #: Standard deviation of each measured quantity over the trials; empty for one trial.
    spread: dict[str, Number] = {}


class ProfileComparison(yamlio.Document):
    """Comparison of trials that repeat one motion: mean of the measurements, and mean of the simulations."""

    name: str
    trials: list[str]
    cycles: list[CycleComparison] = []
    #: Root-mean-square distance between the mean measured and the mean simulated path, and between the mean
    #: measured and the mean simulated angles.
    position_rmse_m: Number = None
    orientation_rmse_rad: Number = None
    #: Displacement of the robot from the first to the last sample, with the keys ``measured`` and
    #: ``simulated``.
    surge_m: dict[str, Number] = {}
    heave_m: dict[str, Number] = {}


class ComparisonFile(yamlio.ResultFile):
    """Comparison of measured trials with their simulation."""

    kind: ClassVar[str] = "comparison file"
    format: Literal["swimid-comparison/1"] = "swimid-comparison/1"
    verdict: Literal["good", "caution", "bad"]
    model: str
    robot: str
    experiment: str
    params: str
    #: Errors of all trials together, by channel.
    channels: dict[str, ChannelScore]
    trials: list[TrialComparison]
    #: Motion profiles of a robot that moves in 3-D.
    profiles: list[ProfileComparison] = []
    #: Root-mean-square error of the mean speeds of all trials, m/s.
    mean_speed_rmse_m_s: Number = None
    provenance: yamlio.Provenance = Field(default_factory=dict)

    @property
    def mean_speeds(self) -> list[tuple[TrialComparison, float, float]]:
        """Trials with a mean speed, each with the measured and the simulated mean speed, m/s."""
        return [(t, t.mean_speed.measured, t.mean_speed.simulated) for t in self.trials if t.mean_speed]


#: Prefixes of the names of per-trial parameters that describe the initial state or camera, not the robot.
START_PARAMETERS = ("start_", "initial_", "clock_offset", "drive_phase", "camera_rotation", "rest_position")
SIDES = ("measured", "simulated")
#: Half-width of the window in which a derivative of the pose is computed: in cycles of the beat, and in s for
#: a trial without a beat.
HALF_WIDTH_BEATS, HALF_WIDTH_S = 0.2, 0.15
#: Minimum number of valid derivatives of the pose for a channel that is derived from the pose.
MIN_DERIVATIVES = 9
#: Assumed standard deviation of the noise of a channel, as a fraction of the range of the channel. It is used
#: in the estimate of an initial state if the noise of the channel is unknown.
NOISE_RANGE_SHARE = 0.01


@dataclass(frozen=True)
class Pair:
    """Measured and simulated values of one channel at the same times.

    Attributes
    ----------
    source : {"logged", "pose"}
        ``pose`` if both series are derivatives of positions.
    time_s, measured, simulated : ndarray, shape (n,)
    """

    channel: Channel
    source: Literal["logged", "pose"]
    time_s: Array
    measured: Array
    simulated: Array


class Compared(NamedTuple):
    """Compared trial: its measured and simulated channels, and its entry in the comparison file."""

    trial: Trial
    pairs: dict[str, Pair]
    #: Channels of ``pairs``, but with positions along and across the mean heading of the trial
    #: (:func:`own_axes` of ``fit_common``).
    own: dict[str, Pair]
    record: TrialComparison
    #: Parameter values of the simulation.
    values: Array

    @property
    def series(self) -> list[Series]:
        """Series of the measured channels, in which common mistakes in trials are searched for."""
        return mistakes.series_of(self.trial, {n: p.simulated for n, p in self.pairs.items()})


def compare_trials(
    applied: Applied,
    trials: Sequence[Trial],
    *,
    refit: bool,
    channels: Sequence[str] = (),
    advance: Callable[[], Any] = lambda: None,
) -> tuple[list[Compared], StepChoice]:
    """Compare trials with simulations whose integration step is small enough for all trials.

    The step is chosen before the initial states are estimated, and tested with these estimates. See
    :func:`compare_trial` for the parameters and the errors.

    Returns
    -------
    list of Compared
    StepChoice
        Model with the chosen step, and its accuracy.
    """
    noise = [applied.noise()] * len(trials)
    chosen = choose_step(applied.model, [(applied.values(trial), trial) for trial in trials], noise)
    while True:
        applied = applied.at_step(chosen.model)
        done = []
        for trial in trials:
            done.append(compare_trial(applied, trial, refit=refit, channels=channels))
            advance()
        chosen = choose_step(applied.model, [(one.values, one.trial) for one in done], noise)
        if not chosen.halvings:
            return done, chosen


def compare_trial(applied: Applied, trial: Trial, *, refit: bool, channels: Sequence[str] = ()) -> Compared:
    """Simulate a trial and pair the simulated channels with the measured channels.

    Parameters
    ----------
    refit : bool
        Whether to estimate the start state of a trial if the parameter file does not have it, with all shared
        parameters fixed.
    channels : sequence of str
        Channels to compare; by default all channels.

    Raises
    ------
    UsageError
        If the trial does not have one of the channels.
    NoTrustworthyResult
        If the simulation diverges.
    """
    model = applied.model
    values, start, start_values = start_of(applied, trial, refit)
    if refit:
        model, level = model.at_own_level(values, trial)
        if level:
            start, start_values = "estimated", level
    simulated = model.run(values, trial)
    pairs = _pair_logged(model, trial, simulated)
    frequency, body = None, model.body
    drive = drive_block(trial) if trial.swim.beat is not None else {}
    if model.swimmer is not None and body is not None:
        turning = (body.velocity[2], body.pose[2]) if body.free else ()
        series = [pairs[name].measured for name in turning if name in pairs]
        frequency = beat_frequency(model.swimmer, trial, values, series)
        pairs |= _velocity_pairs(model, body, trial, pairs, frequency)
    pairs = _select_pairs(pairs, channels, trial)
    speed = None
    if body is not None and frequency is not None:
        speed = compute_body_speed(trial, pairs, body, frequency)
    own = _turn_pairs(pairs)
    placed = fit_common.pose_channels(model)
    record = TrialComparison(
        id=trial.id,
        role=trial.role,  # type: ignore[arg-type]
        start=start,
        start_values=start_values,
        frequency_hz=frequency,
        drive=drive,
        channels={name: _score([p], frequency, own_motion=name in placed) for name, p in own.items()},
        mean_speed=speed,
        cruise=_cruise(applied, trial, values, pairs),
    )
    return Compared(trial, pairs, own, record, values)


def _select_pairs(pairs: dict[str, Pair], channels: Sequence[str], trial: Trial) -> dict[str, Pair]:
    """Return the pairs of the named channels; all pairs if no channels are named."""
    for name in channels:
        if name not in pairs:
            hint = suggestion(name, list(pairs))
            raise UsageError(f"the trial '{trial.id}' has no channel '{name}' to compare", hint=hint)
    return {name: p for name, p in pairs.items() if name in channels or not channels}


def _turn_pairs(pairs: Mapping[str, Pair]) -> dict[str, Pair]:
    """Return the pairs of a trial, with positions rotated to its mean heading: along it and across it."""
    measured, simulated = fit_common.own_axes(
        {n: p.measured for n, p in pairs.items()}, {n: p.simulated for n, p in pairs.items()}
    )
    return {n: replace(p, measured=measured[n], simulated=simulated[n]) for n, p in pairs.items()}


def _pair_logged(model: Model, trial: Trial, simulated: Mapping[str, Array]) -> dict[str, Pair]:
    """Return measured and simulated values of each logged channel that the model simulates.

    Channels that drive the model are left out.

    Raises
    ------
    NoTrustworthyResult
        If the simulation diverges.
    """
    logged = {name: v for name, v in trial.inputs.items() if name in simulated} | dict(trial.measured)
    for channel in model.list_input_channels(trial):
        logged.pop(channel, None)
    pairs = {
        c.name: Pair(c, "logged", trial.time_s, logged[c.name], simulated[c.name])
        for c in model.channels
        if c.name in logged and np.isfinite(logged[c.name]).sum() > 1
    }
    for pair in pairs.values():
        known = np.isfinite(pair.measured)
        lost = known & ~np.isfinite(pair.simulated)
        if not lost.any() or model.has_gaps:
            continue
        if trial.swim.steady and (lost == known).all():
            raise NoTrustworthyResult(
                f"the speed of the model never becomes steady with the gait of '{trial.id}'",
                hint="check the drag of the model, or use --start-state estimate",
            )
        raise NoTrustworthyResult(
            f"the simulation of '{trial.id}' diverges at t = {trial.time_s[int(np.argmax(lost))]:.4g} s",
            hint="check the parameters' signs and units and the drive, or take a smaller --dt",
        )
    return pairs


def start_of(
    applied: Applied, trial: Trial, refit: bool, tolerance: float = output_error.START_RTOL
) -> tuple[Array, Start, dict[str, float]]:
    """Return the parameter vector of a trial, the source of its initial state, and the estimated state.

    Parameters
    ----------
    refit : bool
        Whether to estimate the start state from the trial if the parameter file does not have it.
    tolerance : float
        Convergence tolerance of the estimate of the start state.
    """
    model = applied.model
    values, owner = applied.values(trial), applied.owner(trial)
    if any(f"{p.name}[{owner}]" in applied.known for p in model.parameters if p.per_trial):
        return values, "file", {}
    names = _name_start_parameters(applied)
    if not refit or not names:
        return values, "neutral", {}
    sd = _noise(applied, trial)
    # start from four phases, because the cost has several minima over an unknown phase of the beat
    first: list[dict[str, float]] = [{}]
    if "drive_phase" in names and "drive_phase" not in trial.starts:
        first = [{"drive_phase": k * math.pi / 2} for k in range(4)]
    tried = []
    for start in first:
        at = zip(model.parameters, _replace_values(model, values, start), strict=True)
        held = tuple(replace(p, start=float(v), free=p.name in names) for p, v in at)
        with suppress(NoTrustworthyResult, np.linalg.LinAlgError):
            labelled = output_error.estimate_start(model, held, trial, sd, tolerance=tolerance)
            found = {label.split("[")[0]: v for label, v in labelled.items()}
            tried.append((_cost(model, _replace_values(model, values, found), trial, sd), found))
    cost, best = min(tried, key=lambda one: one[0], default=(math.inf, {}))
    if not math.isfinite(cost) or not np.isfinite(list(best.values())).all():
        warn("SWM056", f"{trial.id}: the start state could not be estimated; it is taken as at rest")
        return values, "neutral", {}
    return _replace_values(model, values, best), "estimated", best


def _name_start_parameters(applied: Applied) -> set[str]:
    """Return the names of the per-trial parameters that are estimated from a trial alone."""
    model, estimated = applied.model, applied.list_per_trial()
    coefficients = model.swimmer.coefficients if model.swimmer is not None else []
    own = [p for p in model.parameters if p.per_trial and (p.free or p.name in estimated)]
    names = {p.name for p in own if p.name.startswith(START_PARAMETERS) or p.name in coefficients}
    return names - set(applied.chosen)


def _replace_values(model: Model, values: Array, start: Mapping[str, float]) -> Array:
    """Return a copy of the parameter vector with the given values of start-state parameters, by name."""
    values = values.copy()
    for name, value in start.items():
        values[model.index(name)] = value
    return values


def _cost(model: Model, values: Array, trial: Trial, sd: Mapping[str, float]) -> float:
    """Return the sum of squared residuals of a trial, each divided by the noise ``sd`` of its channel.

    The sum is infinite if the simulation diverges.
    """
    simulated = model.run(values, trial)
    residuals = [(trial.measured[name] - simulated[name]) / size for name, size in sd.items()]
    known = [np.isfinite(trial.measured[name]) for name in sd]
    total = sum(float(np.sum(r[there] ** 2)) for r, there in zip(residuals, known, strict=True))
    return total if math.isfinite(total) else math.inf


def _noise(applied: Applied, trial: Trial) -> dict[str, float]:
    """Return the standard deviation of the noise of the channels from which a start state is estimated.

    These are the channels that the parameters were fitted to. If the trial has no such channel, all measured
    channels are used, each with a noise of :data:`NOISE_RANGE_SHARE` times its range.
    """
    known = applied.noise()
    noise = {name: known[name] for name in trial.measured if name in known}
    if noise:
        # use one noise for x and y, because the world axes have no relation to the direction of motion
        place = [noise[name] for name in ("x_m", "y_m") if name in noise]
        if place:
            mean = math.hypot(*place) / math.sqrt(len(place))
            noise |= {name: mean for name in ("x_m", "y_m") if name in noise}
        return noise
    for name, values in trial.measured.items():
        finite = values[np.isfinite(values)]
        noise[name] = 1.0
        if len(finite) and np.ptp(finite) > 0:
            noise[name] = NOISE_RANGE_SHARE * float(np.ptp(finite))
    return noise


def _velocity_pairs(
    model: Model, body: PlanarBody, trial: Trial, pairs: Mapping[str, Pair], frequency_hz: float | None
) -> dict[str, Pair]:
    """Return measured and simulated surge, sway and turning rate from the pose, if they are not logged."""
    if not body.free or not all(name in pairs for name in body.pose):
        return {}
    half = HALF_WIDTH_BEATS / frequency_hz if frequency_hz else HALF_WIDTH_S
    measured, simulated = (
        body_velocity(trial.time_s, [getattr(pairs[name], side) for name in body.pose], half)
        for side in ("measured", "simulated")
    )
    channels = {c.name: c for c in model.channels}
    return {
        name: Pair(channels[name], "pose", trial.time_s, y, z)
        for name, y, z in zip(body.velocity, measured, simulated, strict=True)
        if name not in pairs and np.isfinite(y).sum() >= MIN_DERIVATIVES
    }


# ------------------------------------------------------------ scores


def _score(parts: list[Pair], frequency_hz: float | None = None, *, own_motion: bool = False) -> ChannelScore:
    """Return the errors of a channel over one or several trials (see :func:`.score_trials`)."""
    series = [(p.measured, p.simulated) for p in parts]
    middle = [0.0] * len(series)
    if own_motion:  # count the peaks of a pose from the mean of the trial
        middle = [float(np.nanmean(y)) for y, _ in series]
    measured, simulated = (
        np.concatenate([pair[side] - m for pair, m in zip(series, middle, strict=True)]) for side in (0, 1)
    )
    peak, relative = fit_common.peak_error(measured, simulated)
    phase = None
    if frequency_hz is not None:
        (p,) = parts
        phase = fit_common.phase_error(p.measured, p.simulated, p.time_s, frequency_hz=frequency_hz)
    return ChannelScore(
        unit=parts[0].channel.unit,
        source=parts[0].source,
        **vars(fit_common.score_trials(series, own_motion=own_motion)),
        peak_error=peak,
        peak_error_normalised=relative,
        phase_error_rad=phase,
    )


def pool(done: Sequence[Compared], model: Model) -> dict[str, ChannelScore]:
    """Return the errors of each channel of a model over all trials that have it, by channel."""
    pose = fit_common.pose_channels(model)
    parts = {c.name: [one.own[c.name] for one in done if c.name in one.own] for c in model.channels}
    return {name: _score(pairs, own_motion=name in pose) for name, pairs in parts.items() if pairs}


def compute_body_speed(
    trial: Trial,
    pairs: Mapping[str, Pair],
    body: PlanarBody,
    frequency_hz: float,
    between_s: tuple[float, float] = (-math.inf, math.inf),
) -> Speed | None:
    """Return the measured and the simulated mean speed over the last whole beats, computed in the same way.

    Parameters
    ----------
    between_s : (float, float)
        Begin and end of the part of the trial that is used, s.

    Notes
    -----
    Without positions, the mean speed is the mean surge speed.
    """
    names = [name for name in body.pose if name in pairs]
    has_path = names[:2] == list(body.pose[:2])
    if not has_path:
        names = [name for name in body.velocity[:1] if name in pairs]
    if not body.free or not names:
        return None
    series = {side: np.array([getattr(pairs[name], side) for name in names]) for side in SIDES}
    known = np.isfinite(sum(series.values())).all(axis=0)
    known &= (trial.time_s >= between_s[0]) & (trial.time_s <= between_s[1])
    if known.sum() < 3:
        return None
    time, beat = trial.time_s[known], trial.swim.beat
    begin = float(time[0])
    if beat is not None:
        begin = max(begin, beat.ramp_s)
    window = last_cycles(begin, float(time[-1]), frequency_hz)
    if window is None:
        return None
    speeds = {}
    for side, rows in series.items():
        each = cycle_means(time, rows[0][known], window.edges_s)
        if has_path:
            each = cycle_speeds(time, rows[:2, known], window, *rows[2:, known])
        speeds[side] = float(each.mean())
    return Speed(**speeds, beats=window.cycles)


def _cruise(applied: Applied, trial: Trial, values: Array, pairs: Mapping[str, Pair]) -> CruiseSpeed | None:
    """Return the steady speed of the model for a trial that begins in motion; None for other trials."""
    model = applied.model
    swimmer, body, drive = model.swimmer, model.body, trial.swim.drive
    speeds = [p.name for p in model.parameters if p.name.startswith("initial_")]
    if swimmer is None or body is None or not any(values[model.index(name)] for name in speeds):
        return None
    settled = swimmer.cruise(values, trial)
    if settled is None or drive is None:
        return None
    middle = 0.5 * float(trial.time_s[0] + trial.time_s[-1])
    parts = ((-math.inf, middle), (middle, math.inf))
    early, late = (compute_body_speed(trial, pairs, body, drive.frequency_hz, part) for part in parts)
    steady = False
    if early is not None and late is not None:
        steady = abs(late.measured - early.measured) <= fit_common.GOOD_SPEED * abs(late.measured)
    return CruiseSpeed(settled=settled.speed_m_s, steady=steady)
