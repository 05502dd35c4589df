"""Functions that all fits use: reading logs, scoring, parameter file, checks and figures."""

from __future__ import annotations

import itertools
import math
import os
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from swimid.errors import InputError, Interrupted, NoTrustworthyResult
from swimid.files import atomic
from swimid.files.kernels import numba
from swimid.files.provenance import Input
from swimid.fitting.intervals import ASSUMED_DIFFERENCE, DIFFERENT, NORMAL, Differences
from swimid.fitting.model import POSITIONS, Array, Channel, Model, Parameter, Trial, choose_parameters
from swimid.fitting.output_error import FitResult
from swimid.fitting.problem import STEP_ERROR, STEP_LIMIT
from swimid.fitting.uncertainty import (
    SIGNIFICANCE,
    autocorrelation,
    combinations,
    join_series,
    ljung_box,
    sentences,
)
from swimid.logs import log as log_format
from swimid.logs import trials as trials_format
from swimid.logs.experiments import TrialEntry, Trials
from swimid.logs.log import FREQUENCY_RTOL, Log
from swimid.logs.sampling import LONG_HOLD, find_frozen, find_held, white_noise_sd
from swimid.logs.trials import TrialSet
from swimid.notices import Notice, warn
from swimid.results import evidence as ev
from swimid.results import numbers
from swimid.results.parameters import Correlation, Estimate, Fit, Fitted, ParameterFile, parameter_text
from swimid.robots import file as robot_format
from swimid.robots.file import Robot, locate

#: Minimum absolute correlation of two parameters that are reported as hard to separate.
HIGH_CORRELATION = 0.95
#: Ratio of the error on validation trials to the error on fitted trials above which a check warns.
VALIDATION_RATIO = 2.0
#: Sentence on standard errors for the methods section of a report.
COVARIANCE = (
    "Intervals contain 95 % of the error, averaged over forms of the noise with and without memory, and over "
    "differences of the parameters between the trials; a standard error is half an interval divided by 1.96."
)
#: Maximum number of parameters that a sentence names.
MAX_LISTED_PARAMETERS = 4
#: Maximum ratio of the standard deviation of the samples of a channel in which nothing moves to that of its
#: white noise. The ratio may exceed 1, because 100 samples give the noise with a standard error of a tenth.
MAX_STILL_RATIO = 1.3
#: Residual above which a sample is an outlier, in robust standard deviations.
OUTLIER = 8.0
#: Minimum change of the samples by the integration step, over the allowed change, that is shown as a number.
MIN_SHOWN_CHANGE = 1e-3
#: Verdicts of a check that does not pass, indexed by whether it fails: a warning, or a failure.
VERDICTS: tuple[Literal["warn"], Literal["fail"]] = ("warn", "fail")
#: Sources of the values of a model without a parameter file: the robot file (ROBOT_FILE), or the trials file
#: for a simulator of the user (TRIALS_FILE).
ROBOT_FILE, TRIALS_FILE = "the robot file", "the trials file"
#: Names of the channels of angles that a camera may measure in addition to a position.
ANGLE_CHANNELS = ("yaw_rad", "pitch_rad", "roll_rad")


# ---------------------------------------------------------------- a model with its trials


@dataclass(frozen=True)
class Experiment:
    """Experiment: a robot, its model, and the trials from which the model's parameters are estimated."""

    #: Name of the kind of experiment: the value of ``experiment`` in the trials file.
    name: str
    robot: Robot
    model: Model
    trials: list[Trial]
    #: All inputs for the provenance: the trials file, the robot file, the logs, and data in memory.
    inputs: list[Input]
    #: Alternative interpretations of the same logs by name (for example, how an encoder rounds). The fit
    #: selects the one with the smallest residuals. Empty if there is only one interpretation.
    variants: Mapping[str, list[Trial]] = field(default_factory=dict)
    #: Facts for the report that were found while the logs were read.
    facts: Mapping[str, Any] = field(default_factory=dict)
    #: Path of the robot file; None if the result does not refer to it.
    robot_path: Path | None = None
    #: Source of the values of the model, in words.
    values_from: str = ROBOT_FILE

    @classmethod
    def of(
        cls,
        entries: Trials,
        path: Path,
        model: Model,
        trials: list[Trial],
        sources: Sequence[Input],
        robot: Robot | None = None,
        **more: Any,
    ) -> Experiment:
        """Return the experiment of a trials file.

        Parameters
        ----------
        entries : Trials
            Content of the trials file.
        path : Path
            Trials file.
        model : Model
        trials : list of Trial
        sources : sequence of paths or objects
            Logs, and other inputs besides the trials file and the robot file.
        robot : Robot, optional
            By default the robot that the trials file names.
        **more
            Further attributes of the experiment.

        Raises
        ------
        InputError
            If the robot file is wrong.
        """
        inputs = [locate(entries.robot, path.parent), *sources]
        if not entries._in_memory:
            inputs.insert(0, path)
        robot = robot or robot_format.read(entries.robot, path.parent)
        model.fluid_density_kg_m3 = robot.fluid.density_kg_m3
        return cls(entries.experiment, robot, model, trials, inputs, **more)


@dataclass(frozen=True)
class SimulationRun:
    """Simulation of an experiment without a recording.

    Attributes
    ----------
    model : Model
    trial : Trial
        Sample times and inputs.
    robot : str
        Name of the robot in the metadata of the log. By default it is that of the parameter file.
    metadata : dict
        Further metadata of the log.
    extra : dict of str to ndarray, each shape (n,)
        Columns of the log in addition to the channels.
    units : dict of str to str
        Names of the quantities of the simulation, with their units.
    quantities : callable or None
        Function from the model with its effects and a parameter vector to the quantities, in the order of
        ``units``.
    """

    model: Model
    trial: Trial
    robot: str = ""
    metadata: Mapping[str, Any] = field(default_factory=dict)
    extra: Mapping[str, Any] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    quantities: Callable[[Any, Array], list[float]] | None = None


def load_experiment(source: str | Path | TrialSet, *, command: str = "", **options: Any) -> Experiment:
    """Read a trials file with its logs, and return the model with its trials.

    Parameters
    ----------
    source : path or TrialSet
    command : str
        Command that fits the trials. By default any experiment is read, for a simulation.
    **options
        Options of the command that the experiment may use.

    Raises
    ------
    InputError
        If the trials file, the robot file or a log is wrong, or if the command does not fit the experiment.
    """
    entries = trials_format.read(source, command)
    experiment: Experiment = entries.load(trials_format.place(source), command=command, **options)
    return experiment


def read_trial_log(
    entry: TrialEntry, folder: Path, *, required: tuple[str, ...], optional: tuple[str, ...] = ()
) -> Log:
    """Read the log of a trial, cut it to the interval in the trials file, and set repeated positions to NaN.

    Positions and angles of a log of ``track video`` are those measured in the frames, not the smoothed ones.
    The errors of smoothed values extend over many frames, which no noise model of a fit describes.
    """
    pose = [name for name in (*required, *optional) if name in (*POSITIONS, *ANGLE_CHANNELS)]
    measured = {name: re.sub(r"_(m|rad)$", r"_raw_\1", name) for name in pose}
    optional = (*optional, *measured.values())
    if entry._held is not None:
        log = entry._held.select_columns(required, optional)
    else:
        log = log_format.read(folder / entry.log, required=required, optional=optional)
    columns = {name: values for name, values in log.columns.items() if name not in measured.values()}
    if log_format.is_written_by(log.metadata, "swimid track video"):
        # A log that another program wrote may have a column of this name with another meaning.
        columns |= {name: log[raw] for name, raw in measured.items() if raw in log}
    return _cut(_blank_repeats(replace(log, columns=columns)), entry)


def _cut(log: Log, entry: TrialEntry) -> Log:
    """Return the part of a log in the interval that the trials file states."""
    if entry.start_s is None and entry.end_s is None:
        return log
    low = -np.inf if entry.start_s is None else entry.start_s
    high = np.inf if entry.end_s is None else entry.end_s
    keep = (log.time_s >= low) & (log.time_s <= high)
    if keep.sum() < 2:
        raise InputError(
            f"has fewer than 2 samples between start_s {low:g} and end_s {high:g}; the log runs from "
            f"{log.time_s[0]:g} to {log.time_s[-1]:g} s",
            file=log.path,
        )
    return replace(log, columns={k: v[keep] for k, v in log.columns.items()})


def _blank_repeats(log: Log) -> Log:
    """Return a copy of the log with NaN where a position only repeats that of the previous camera picture."""
    places = [name for name in POSITIONS if name in log]
    held = find_held(log.time_s, [log[name] for name in places])
    repeats = held.repeated.copy()
    for first, end in log_format.runs(repeats):
        # Keep long repetitions. A camera that stopped is a fault of the recording, which must show in the
        # residuals.
        if log.time_s[end - 1] - log.time_s[first] > LONG_HOLD * held.period_s:
            repeats[first:end] = False
    for name, (start, stop) in find_frozen(log.time_s, {name: log[name] for name in places}).items():
        warn("SWM035", f"{log.path.name}: {name} holds one value from {start:.4g} to {stop:.4g} s")
    at = np.flatnonzero(repeats)
    if not len(at):
        return log
    warn(
        "SWM058",
        f"{log.path.name}: {len(at)} of {len(log)} samples repeat the previous position and are left out: "
        "the log is written faster than the position is measured",
    )
    # An angle counts as repeated if all its values at the repeated positions equal the value before.
    angles = [n for n in ANGLE_CHANNELS if n in log and (log[n][at] == log[n][at - 1]).all()]
    masked = {n: np.where(repeats, np.nan, log[n]) for n in (*places, *angles)}
    return replace(log, columns={**log.columns, **masked})


def warn_mass(name: str, value: float, against: float, file: Path) -> None:
    """Warn if a mass is so large that it may be in grams."""
    if against > 0 and value >= against:
        warn(
            "SWM002",
            f"{file.name}: {name} {value:g} kg is not below the mass of the body, {against:g} kg; is it in "
            "grams (a factor of 1000)?",
        )


# ---------------------------------------------------------------- errors


#: Maximum error of a simulated channel that counts as good (GOOD) and as usable (USABLE), as fractions of the
#: measured range of the channel.
GOOD, USABLE = 0.15, 0.30
#: Minimum fraction of the variance of a channel that a usable model accounts for. Below one half, most of the
#: motion is not that of the model. The error of a constant is 0.35 of the range of a sine, so that an error
#: below ``USABLE`` does not show this.
MIN_VAF = 0.5
#: Maximum error of the simulated mean speed that counts as good (GOOD_SPEED) and as usable (USABLE_SPEED), as
#: fractions of the measured speed.
GOOD_SPEED, USABLE_SPEED = 0.10, 0.25


@dataclass(frozen=True)
class SeriesScore:
    """Errors of the simulation of one channel."""

    #: Root-mean-square error, in the unit of the channel.
    rmse: float
    #: Root-mean-square error divided by the measured range (maximum minus minimum). For a pose with several
    #: trials, the range is the root mean square of the ranges of the trials.
    nrmse: float
    #: Variance accounted for, ``1 - var(error) / var(measured)``.
    vaf: float
    #: Fit in percent, ``100 (1 - |error| / |measured - mean|)``, as MATLAB's ``compare`` prints it.
    fit_percent: float
    #: Mean error, measured minus simulated, in the unit of the channel.
    bias: float
    samples: int

    def as_dict(self, unit: str) -> dict[str, Any]:
        """Return the errors of the channel as an entry of the parameter file."""
        return {**asdict(self), "unit": unit}


def compute_score(measured: Array, simulated: Array) -> SeriesScore:
    """Return the errors of a simulated series compared with a measured one, shape (n,) each.

    Samples missing in either series are left out. Without samples the errors are NaN.

    >>> compute_score(np.array([0.0, 1.0, 2.0]), np.array([0.0, 1.0, 2.0])).fit_percent
    100.0
    """
    return score_trials([(measured, simulated)], own_motion=False)


def _ratio(value: float, size: float) -> float:
    """Return ``value / size``; NaN if ``size`` is not positive."""
    return value / size if size > 0 else math.nan


def score_trials(parts: Sequence[tuple[Array, Array]], *, own_motion: bool) -> SeriesScore:
    """Compute the errors of one channel over several trials.

    Parameters
    ----------
    parts : sequence of (ndarray, ndarray), each shape (n_k,)
        Measured and simulated values of each trial.
    own_motion : bool
        Whether the channel belongs to a pose. Range and variance are then taken about the mean of each trial.
        Otherwise they are taken over all trials together.

    Examples
    --------
    Two trials with different headings have the same motion and the same error:

    >>> wave = np.array([0.0, 1.0, 0.0, -1.0])
    >>> pair = (wave, 0.5 * wave)
    >>> turned = (wave + 90.0, 0.5 * wave + 90.0)
    >>> round(score_trials([pair, turned], own_motion=True).vaf, 3), round(compute_score(*pair).vaf, 3)
    (0.75, 0.75)
    """
    there = [pair for pair in (_both(y, z) for y, z in parts) if len(pair[0])]
    if not there:
        return SeriesScore(np.nan, np.nan, np.nan, np.nan, np.nan, 0)
    if not own_motion:
        there = [(np.concatenate([y for y, _ in there]), np.concatenate([z for _, z in there]))]
    error = np.concatenate([y - z for y, z in there])
    share = np.array([len(y) for y, _ in there]) / len(error)
    span = math.sqrt(float(share @ [np.ptp(y) ** 2 for y, _ in there]))
    variance = float(share @ [np.var(y) for y, _ in there])
    missed = float(share @ [np.var(y - z) for y, z in there])
    rmse = float(np.sqrt(np.mean(error**2)))
    return SeriesScore(
        rmse=rmse,
        nrmse=_ratio(rmse, span),
        vaf=1.0 - _ratio(missed, variance),
        fit_percent=100.0 * (1.0 - _ratio(rmse, math.sqrt(variance))),
        bias=float(np.mean(error)),
        samples=len(error),
    )


def pose_channels(model: Model) -> tuple[str, ...]:
    """Return the pose channels of a robot that moves freely; an empty tuple for any other model."""
    if model.swimmer is None or not model.swimmer.free_base:
        return ()
    return tuple(model.swimmer.pose)


def own_axes(
    measured: Mapping[str, Array], simulated: Mapping[str, Array]
) -> tuple[dict[str, Array], dict[str, Array]]:
    """Rotate the horizontal positions of one trial into the trial's own axes.

    Parameters
    ----------
    measured, simulated : mapping of channel name to ndarray, each shape (n,)
        Series of the trial. The axes are along and across the mean measured heading. Without a measured
        heading the first axis points from the first to the last measured position.

    Returns
    -------
    measured, simulated : dict of channel name to ndarray
        Series in which ``x_m`` is the coordinate along, and ``y_m`` the coordinate across the mean heading.
        If ``x_m`` or ``y_m`` is missing, the series are unchanged.

    Examples
    --------
    >>> still = {"x_m": np.zeros(2), "y_m": np.zeros(2)}
    >>> y, z = own_axes({"x_m": np.zeros(2), "y_m": np.array([0.0, 1.0])}, still)
    >>> y["x_m"].round(9).tolist(), z["x_m"].tolist()
    ([0.0, 1.0], [0.0, 0.0])
    """
    turned = dict(measured), dict(simulated)
    if not all(name in side for name in ("x_m", "y_m") for side in turned):
        return turned
    heading = measured.get("yaw_rad", np.empty(0))
    x, y = _both(measured["x_m"], measured["y_m"])
    angle = 0.0
    if np.isfinite(heading).any():
        angle = float(np.nanmean(heading))
    elif len(x):
        angle = math.atan2(y[-1] - y[0], x[-1] - x[0])
    c, s = math.cos(angle), math.sin(angle)
    for side in turned:
        x, y = side["x_m"], side["y_m"]
        side["x_m"], side["y_m"] = c * x + s * y, c * y - s * x
    return turned


def peak_error(measured: Array, simulated: Array) -> tuple[float, float]:
    """Return the peak error: absolute difference between the largest magnitudes of two series.

    The second value is this difference divided by the largest measured magnitude.

    The peak error is Eq 14 of "Locomotion Optimization of a Tendon-Driven Robotic Fish with Variable Passive
    Tail Fin". Samples missing in either series, shape (n,), are left out.

    >>> peak_error(np.array([0.0, -4.0, 2.0]), np.array([1.0, 3.0, 0.0]))
    (1.0, 0.25)
    """
    y, z = _both(measured, simulated)
    if len(y) == 0:
        return np.nan, np.nan
    peak = float(np.max(np.abs(y)))
    error = abs(peak - float(np.max(np.abs(z))))
    return error, _ratio(error, peak)


def dtw_distance(measured: Array, simulated: Array, *, band: int) -> float:
    """Compute the dynamic-time-warping distance, which is the error if time may be stretched.

    Parameters
    ----------
    measured, simulated : ndarray, shape (n,) or (n, d)
        Two series at the same times with constant steps. The d columns are warped together. Samples missing
        in either series are left out.
    band : int
        Maximum shift between the two series, in samples (Sakoe and Chiba, 1978). With 0 the distance is the
        root-mean-square error. With a larger shift it is at most the root-mean-square error.

    Returns
    -------
    float
        Square root of the minimum sum of squared differences divided by n, in the unit of the channel.

    >>> late = np.array([0.0, 0.0, 1.0, 0.0])
    >>> dtw_distance(np.array([0.0, 1.0, 0.0, 0.0]), late, band=1)
    0.0
    >>> round(dtw_distance(np.array([0.0, 1.0, 0.0, 0.0]), late, band=0), 3)
    0.707
    """
    y, z = _both(measured, simulated)
    if len(y) == 0:
        return np.nan
    cost = warping_cost(y.reshape(len(y), -1), z.reshape(len(z), -1), int(band))
    return math.sqrt(cost / len(y))


def phase_error(measured: Array, simulated: Array, time_s: Array, *, frequency_hz: float) -> float:
    """Compute the phase by which the simulation leads the measurement at one frequency.

    Parameters
    ----------
    measured, simulated, time_s : ndarray, shape (n,)
        Series and their times. Samples missing in either series are left out. The time steps may be uneven.
    frequency_hz : float
        Frequency of the beat. A sine of this frequency, a constant and a linear trend are fitted to both
        series.

    Returns
    -------
    float
        Phase in (-pi, pi], rad; positive if the simulation is early. NaN if a series has no component at the
        frequency, or if fewer than five samples exist.

    >>> t = np.linspace(0.0, 4.0, 200)
    >>> early = 0.3 * np.sin(2 * np.pi * t + 0.5)
    >>> round(phase_error(np.sin(2 * np.pi * t) + 0.1 * t, early, t, frequency_hz=1.0), 6)
    0.5
    """
    there = np.isfinite(measured) & np.isfinite(simulated)
    t = np.asarray(time_s)[there]
    if len(t) < 5:
        return np.nan
    angle = 2 * np.pi * frequency_hz * t
    design = np.column_stack((np.cos(angle), np.sin(angle), np.ones_like(t), t - t.mean()))
    both = np.column_stack((measured[there], simulated[there]))
    cosine, sine = np.linalg.lstsq(design, both, rcond=None)[0][:2]
    # Compute the phase from A cos(wt) + B sin(wt) = |A - iB| cos(wt + arg(A - iB)).
    phasor = cosine - 1j * sine
    if np.any(np.abs(phasor) <= 1e-12 * np.max(np.abs(both), axis=0)):
        return np.nan
    return float(np.angle(phasor[1] / phasor[0]))


def _both(measured: Array, simulated: Array) -> tuple[Array, Array]:
    """Return the measured and the simulated series without the samples that are missing in either."""
    there = np.isfinite(measured) & np.isfinite(simulated)
    if there.ndim > 1:
        there = np.asarray(there.all(axis=1))
    return np.asarray(measured, dtype=float)[there], np.asarray(simulated, dtype=float)[there]


@numba.njit(cache=True, nogil=True)
def warping_cost(a: Array, b: Array, band: int) -> float:
    """Return the minimum sum of squared distances along a warping path; both series have the shape (n, d).

    The path lies at most ``band`` cells off the diagonal (Sakoe and Chiba, 1978). Only two rows of the cost
    matrix are stored.
    """
    n = len(a)
    before = np.full(n + 1, np.inf)
    before[0] = 0.0
    for i in range(1, n + 1):
        row = np.full(n + 1, np.inf)
        for j in range(max(1, i - band), min(n, i + band) + 1):
            squares = 0.0
            for k in range(a.shape[1]):
                squares += (a[i - 1, k] - b[j - 1, k]) ** 2
            row[j] = squares + min(before[j], row[j - 1], before[j - 1])
        before = row
    return float(before[n])


def warm_up() -> None:
    """Compile the numba function :func:`warping_cost` before its first use."""
    warping_cost(np.zeros((2, 1)), np.ones((2, 1)), 1)


# ---------------------------------------------------------------- limits


def score_checks(
    scores: Mapping[str, Any],
    *,
    fitted: Iterable[str],
    noise: Iterable[str] = (),
    held_out: bool = False,
) -> list[ev.Check]:
    """Return checks of the errors of channels against the limits :data:`GOOD` and :data:`USABLE`.

    Parameters
    ----------
    scores : mapping of channel name to SeriesScore, or to an object with ``nrmse`` and ``vaf``
        Errors of each channel over all trials.
    fitted : iterable of str
        Channels to which the parameters were fitted. For these channels a check fails if the variance
        accounted for is below :data:`MIN_VAF`, or for channels in ``noise`` if it is negative.
    noise : iterable of str
        Channels whose residuals are white, or in which nothing moves. Their errors are noise and not judged.
    held_out : bool
        Whether the trials were held out of the fit. The names of the checks then say so.
    """
    where = held_out * "held-out "
    found, large = [], {}
    for name, score in scores.items():
        check = share_check(f"{where}error of {name}", score.nrmse, GOOD, USABLE, "measured range")
        if name in set(noise) and check.verdict != "pass":
            text = "the residuals are noise alone"
            check = ev.make_check(check.name, check.value, None, text=text)
        elif check.verdict != "pass":
            large[name] = check
        found.append(check)
    errors = numbers.join_names([f"{check.value} in {name}" for name, check in large.items()])
    for check in large.values():
        check.reason = f"the {where}error over the measured range is {errors}, above {100 * GOOD:g} %"
    for name in (name for name in fitted if name in scores):
        vaf, said = scores[name].vaf, f"{where}variance accounted for, {name}"
        least = 0.0 if name in set(noise) else MIN_VAF
        if vaf is not None and vaf < least:
            shown = numbers.percent(vaf)
            reason = f"the simulated {name} accounts for only {shown} of the variance of the measurement"
            if vaf < 0.0:
                reason = f"the error of the simulated {name} is larger than that of a constant"
            needed = f"≥ {100 * least:g} %"
            found.append(ev.make_check(said, shown, False, needed, otherwise="fail", reason=reason))
    return found


def share_check(
    name: str, share: float | None, good: float, usable: float, of: str, text: str = ""
) -> ev.Check:
    """Return a check of an error, as a fraction, that passes up to ``good`` and fails above ``usable``."""
    shown = numbers.percent(share)
    # Represent an unknown share by NaN. Comparisons with NaN are false, so that the check fails.
    value = math.nan if share is None else share
    otherwise = VERDICTS[not value <= usable]
    limit = f"≤ {100 * good:g} % of the {of} (fail above {100 * usable:g} %)"
    reason = f"the {name} is {shown} of the {of}, above {100 * good:g} %"
    return ev.make_check(name, shown, value <= good, limit, text, otherwise=otherwise, reason=reason)


# ---------------------------------------------------------------- document and checks


def estimates(result: FitResult) -> dict[str, Estimate]:
    """Return every parameter of a fitted model as an entry of the parameter file.

    Estimated parameters of single trials (start offsets, for example) have the name ``name[trial]``. Fixed
    parameters of single trials are left out.
    """
    found: dict[str, Estimate] = {}
    for p in result.parameters:
        labels = [label for label in result.labels if label.split("[")[0] == p.name]
        for label in labels or [p.name] * (not p.per_trial):
            found[label] = Estimate(
                value=result.value(label),
                stderr=result.stderr(label),
                unit=p.unit,
                bounds=p.bounds,
                status=result.status.get(label, "fixed"),  # type: ignore[arg-type]
                meaning=p.meaning,
            )
    return found


def _correlation(result: FitResult) -> Correlation | None:
    """Return the correlation matrix of the estimates of shared parameters that have standard errors.

    Return None for fewer than two such parameters.
    """
    keep = [i for i, label in enumerate(result.labels) if "[" not in label and result.stderr(label)]
    if len(keep) < 2:
        return None
    part = result.covariance[np.ix_(keep, keep)]
    sd = np.sqrt(np.diag(part))
    return Correlation(names=[result.labels[i] for i in keep], matrix=(part / np.outer(sd, sd)).tolist())


def _sum_confounded(result: FitResult) -> dict[str, Estimate]:
    """Return weighted sums of confounded parameters that the trials determine, by the text of each sum."""
    return {
        c.text.rpartition(" = ")[0]: Estimate(value=c.value, stderr=c.stderr, unit=c.unit, status="estimated")
        for c in combinations(result)
    }


def _identifiability(result: FitResult, correlation: Correlation | None) -> list[str]:
    """Return sentences on parameters of a fit that the trials do not determine, and warn of each."""
    said = sentences(result)
    for sentence in said:
        warn("SWM010", sentence)
    ends = {label: numbers.bounds_text(result.parameter(label).bounds) for label in result.labels}
    stuck = [f"{name} ({ends[name]})" for name, status in result.status.items() if status == "at-bound"]
    if stuck:
        text = "the best fit lies outside: widen the bounds, or search a missing effect (swimid diagnose)"
        warn("SWM012", f"estimates at a bound: {', '.join(stuck)}; {text}")
    if correlation is None:
        return said
    for (i, first), (j, second) in itertools.combinations(enumerate(correlation.names), 2):
        rho = correlation.matrix[i][j]
        if abs(rho) > HIGH_CORRELATION and result.status[first] == result.status[second] == "estimated":
            said.append(f"{first} and {second} are hard to separate (correlation {rho:+.3f})")
            warn("SWM011", said[-1])
    return said


def compute_scores(
    result: FitResult, role: str, trials: Sequence[str] | None = None
) -> dict[str, SeriesScore]:
    """Return the errors of each measured channel over the trials of one role.

    If ``trials`` are named, other trials are not used.
    """
    pose, found = pose_channels(result.model), _own_pairs(result, role, trials)
    return {
        c.name: score_trials(found[c.name], own_motion=c.name in pose)
        for c in result.model.channels
        if c.name in found
    }


def _own_pairs(
    result: FitResult, role: str, trials: Sequence[str] | None = None
) -> dict[str, list[tuple[Array, Array]]]:
    """Return measured and simulated values by channel, for each trial of a role in the trial's axes."""
    ids = [t.id for t in result.trials if t.role == role and (trials is None or t.id in trials)]
    found: dict[str, list[tuple[Array, Array]]] = {}
    for trial in ids:
        series = [s for s in result.series if s.trial == trial]
        measured, simulated = own_axes(
            {s.channel: s.measured for s in series}, {s.channel: s.simulated for s in series}
        )
        for s in series:
            found.setdefault(s.channel, []).append((measured[s.channel], simulated[s.channel]))
    return found


def is_still(series: Iterable[Array]) -> bool:
    """Return whether a channel moves in none of several series by more than the white noise of its samples.

    The explained variance of such a channel is that of the noise, and says nothing of a model.
    """
    return all(float(np.nanstd(y)) <= MAX_STILL_RATIO * white_noise_sd(y, 0.0) for y in series)


def refuse_interrupted(result: FitResult) -> None:
    """Raise :class:`Interrupted` if the user stopped the search of a fit."""
    if result.interrupted:
        raise Interrupted(f"{result.message}; nothing was written")


def insist_identified(result: FitResult, hint: str) -> None:
    """Raise :class:`NoTrustworthyResult` if a fit has shared parameters but identifies none of them.

    A fit whose trials differ raises no error, because its checks say what differs.
    """
    if result.differences is not None and result.differences.are_likely:
        return
    if result.common_labels and all(result.status[label] != "estimated" for label in result.common_labels):
        text = f"none of {', '.join(result.common_labels)} can be identified from these trials"
        raise NoTrustworthyResult(text, hint=hint)


def parameter_file(
    result: FitResult,
    *,
    robot: str,
    provenance: dict[str, Any],
    derived: dict[str, Estimate] | None = None,
    settings: dict[str, Any] | None = None,
    method: str = "maximum likelihood",
    unfinished: bool = False,
) -> ParameterFile:
    """Return the parameter file of a fit.

    Raises
    ------
    Interrupted
        If the user stopped the search, and ``unfinished`` is false.
    """
    if not unfinished:
        refuse_interrupted(result)
    correlation = _correlation(result)
    noise = {
        channel: {**asdict(n), "autoregression": [float(a) for a in n.autoregression]}
        for channel, n in result.noise.items()
    }
    units = {c.name: c.unit for c in result.model.channels}
    listed = {
        role: {name: score.as_dict(units[name]) for name, score in compute_scores(result, role).items()}
        for role in ("fit", "validate")
    }
    trials = {role: [t.id for t in result.trials if t.role == role] for role in listed}
    validation: dict[str, Any] = {}
    if listed["validate"]:
        validation = {"trials": trials["validate"], "channels": listed["validate"]}
    return ParameterFile(
        model=result.model.name,
        robot=robot,
        parameters=estimates(result),
        identifiability=_identifiability(result, correlation),
        correlation=correlation,
        derived={**_sum_confounded(result), **(derived or {})},
        settings=settings or {},
        fit=Fit(
            trials=trials["fit"],
            channels=listed["fit"],
            validation=validation,
            converged=result.converged,
            message=result.message,  # type: ignore[call-arg]
            noise=noise,
            method=method,  # type: ignore[call-arg]
            samples=result.samples,  # type: ignore[call-arg]
            between_trials=asdict(result.differences) if result.differences else {},  # type: ignore[call-arg]
            step_error=result.step_error,  # type: ignore[call-arg]
            samples_sha256={t.id: t.digest for t in result.trials},
        ),
        provenance=provenance,
    )


def robot_reference(experiment: Experiment, folder: Path) -> str:
    """Return the reference to the robot that a parameter file in a folder stores.

    The reference is the name of a built-in robot, or the path of a robot file relative to the folder. If the
    experiment does not know the path of the robot file, the reference is the name of the robot.
    """
    name = experiment.robot.name
    if experiment.robot_path is None:
        return name
    path = experiment.robot_path.resolve()
    if name in robot_format.list_built_in_robots() and path == robot_format.locate(name).resolve():
        return name
    return Path(os.path.relpath(path, folder.resolve())).as_posix()


def prepare_fit(
    experiment: Experiment,
    output: Path | None,
    *,
    parameters: Sequence[Parameter] | None = None,
    also: Sequence[Path] = (),
    **choices: Any,
) -> tuple[Parameter, ...]:
    """Check the output path of a fit, and return the parameters with the choices of the user.

    Parameters
    ----------
    output, also : Path
        Files for the check of the output path: ``output`` must be writable, and must not replace an input of
        the experiment or a path in ``also``.

    Raises
    ------
    InputError, UsageError
    """
    if output is not None:
        atomic.check_writable(output, inputs=(*experiment.inputs, *also))
    return choose_parameters(parameters or experiment.model.parameters, **choices)


def assess(result: FitResult) -> list[ev.Check]:
    """Return the checks of a fit, and those of its errors on fitted and on validation trials."""
    return [*checks(result), *error_checks(result)]


def describe_method(result: FitResult, trials: str, law: str) -> str:
    """Return a sentence that names the estimated parameters, the kind of trials, and the model's law."""
    count = sum(t.role == "fit" for t in result.trials)
    return (
        f"{', '.join(result.common_labels)} were estimated from {count} {trials} ({result.samples} samples) "
        f"by output-error maximum likelihood with {law}."
    )


def checks(result: FitResult, *, held_out: bool = True) -> list[ev.Check]:
    """Return the checks of a fit against their limits; warn of each check that does not pass.

    With ``held_out`` a fit without held-out trials does not pass. The caller sets it to False if it holds out
    parts of the data itself.
    """
    found = [*_convergence(result), *_check_identified(result)]
    found += _whiteness(result)
    if result.differences is not None:
        if result.differences.trials > 1:
            found.append(_consistency(result, result.differences))
        found.append(_visibility(result, result.differences))
    found += [check for channel in result.noise if (check := _outliers(result, channel))]
    if result.step_error:
        found += step_check(["the trials"], [{"a sample": result.step_error / STEP_ERROR}])
    if held_out:
        number = sum(t.role == "validate" for t in result.trials)
        text = "trials with role: validate are predicted, not fitted"
        shown = ("held-out trials", str(number), number > 0, "1 or more", text)
        found.append(ev.make_check(*shown, reason="no trial was held out (role: validate)"))
    channels = [c for c in result.model.channels if result.series_of(c.name, "validate")]
    return found + [_validation(result, c) for c in channels if c.name in result.noise]


def _convergence(result: FitResult) -> list[ev.Check]:
    """Return the checks whether the search ended at the minimum."""
    done, message = result.converged, result.message
    reason = f"the fit did not converge: {message}"
    value = numbers.format_number(done)
    found = [ev.make_check("converged", value, done, "yes", message, otherwise="fail", reason=reason)]
    if result.restarts is None:
        return found
    value = numbers.format_number(result.settled)
    if result.restarts:
        value += f", after {result.restarts} restarts"
    name, text = "starts near the answer lead back to it", "points and short searches around it"
    reason = "restarts near the best fit still find better fits"
    return [*found, ev.make_check(name, value, result.settled, "yes", text, reason=reason)]


def _check_identified(result: FitResult) -> list[ev.Check]:
    """Return the checks whether the trials determine the shared parameters, inside their bounds."""
    names = {p.name: parameter_text(p.name, p.meaning) for p in result.parameters}
    unknown, at_bound, known = (
        [names[label] for label in result.common_labels if result.status[label] == status]
        for status in ("unidentifiable", "at-bound", "estimated")
    )
    value, reason = "all", f"not identifiable: {', '.join(unknown)}"
    if unknown:
        value = f"not: {', '.join(unknown)}"
    otherwise = VERDICTS[len(known) < len(unknown)]
    text = "standard errors are below half of the sizes of identifiable parameters"
    shown = ("identifiable", value, not unknown, "every estimated parameter", text)
    found = [ev.make_check(*shown, otherwise=otherwise, reason=reason)]
    if at_bound:
        listed = ", ".join(at_bound)
        reason = f"estimates are at a bound: {listed}"
        found.append(ev.make_check("inside bounds", listed, False, "no parameter at a bound", reason=reason))
    return found


def step_check(trials: Sequence[str], changes: Sequence[Mapping[str, float]]) -> list[ev.Check]:
    """Return the check of the integration step, and warn the user if it does not pass.

    Parameters
    ----------
    trials : sequence of str
        Ids of the trials.
    changes : sequence of mapping of str to float
        Changes of the channels of each trial (:attr:`swimid.fitting.problem.StepChoice.changes`). There is no
        check if nothing is integrated.
    """
    found = {f"{name} of {t}": c for t, own in zip(trials, changes, strict=True) for name, c in own.items()}
    if not found:
        return []
    name, change = max(found.items(), key=lambda item: item[1])
    size = f"{change:.2g}"
    if change < MIN_SHOWN_CHANGE:
        size = f"below {MIN_SHOWN_CHANGE:g}"
    text = (
        "largest change of a sample when the step is halved, over the allowed change: "
        f"{STEP_ERROR:g} of the noise, or if that is unknown {STEP_LIMIT:g} of the range"
    )
    reason = f"halving the integration step changes {name} by {size} times the allowed change"
    return [warn_check("SWM016", "integration step", size, change <= 1.0, "≤ 1", text, reason)]


def warn_check(code: str, *shown: Any, failed: bool = False) -> ev.Check:
    """Return a check of a fit. If it does not pass, warn the user of its reason.

    Parameters
    ----------
    *shown
        Name, value, whether the check passes, limit, text and reason
        (:func:`swimid.results.evidence.make_check`).
    """
    *_, passed, _, text, reason = shown
    if not passed:
        warn(code, f"{reason}; {text}".removesuffix("; "))
    return ev.make_check(*shown[:-1], otherwise=VERDICTS[failed], reason=reason)


def _consistency(result: FitResult, differ: Differences) -> ev.Check:
    """Return the check whether the trials agree."""
    share = numbers.percent(differ.probability)
    if differ.probability > 0.999:
        share = "> 99.9 %"
    value, text = f"probability of differences {share}", ""
    different = [name for name, chance in differ.chance.items() if chance > 0.5]
    sizes = ", ".join(f"{name} by {_relative(result, name, differ.sd[name])}" for name in different)
    reason = f"parameters differ between the trials: {sizes or 'the trials do not show which'}"
    if differ.are_likely:
        value = f"{sizes or 'differences'} (probability {share})"
        text = "these are standard deviations between the trials, which the standard errors include"
    limit = f"≤ {numbers.percent(DIFFERENT)}"
    return warn_check("SWM014", "trials agree", value, not differ.are_likely, limit, text, reason)


def _visibility(result: FitResult, differ: Differences) -> ev.Check:
    """Return the check whether differences between these trials would show."""
    hidden = [name for name in differ.hidden if result.status.get(name) == "estimated"]
    name, limit = "differences between trials visible", "of every estimated parameter"
    if not hidden:
        return ev.make_check(name, "yes", True, limit)
    value, named = f"not of {', '.join(hidden)}", hidden[:MAX_LISTED_PARAMETERS]
    if len(hidden) > MAX_LISTED_PARAMETERS:
        named.append(f"{len(hidden) - MAX_LISTED_PARAMETERS} more")
    reason = f"these trials would not show whether {numbers.join_names(named)} differ between trials"
    if differ.trials == 1:
        value, reason = "one trial", "differences between trials are unknown, because one trial was fitted"
    share = numbers.percent(ASSUMED_DIFFERENCE)
    worst = max(hidden, key=lambda n: differ.hidden[n] / (result.stderr(n) or math.inf))
    error = numbers.format_number(NORMAL * differ.hidden[worst], 2, result.parameter(worst).unit)
    text = (
        f"intervals hold only for equal values in all trials; if {worst} differs by {share}, its interval is "
        f"± {error}. Fit repeats of one setting, or more settings"
    )
    return warn_check("SWM028", name, value, False, limit, text, reason)


def _relative(result: FitResult, name: str, sd: float) -> str:
    """Return a standard deviation between trials as text: as a share of the estimate.

    For an estimate near zero, it has the value with its unit.
    """
    size = abs(result.value(name))
    if size > 0.1 * result.parameter(name).scale:
        return numbers.percent(sd / size, 2)
    return numbers.format_number(sd, 2, result.parameter(name).unit)


def _outliers(result: FitResult, channel: str) -> ev.Check | None:
    """Return a check that warns of outliers among the residuals of a channel; None if there are none."""
    parts = {s.trial: s.z_scores for s in result.series_of(channel, "fit")}
    values = np.concatenate(list(parts.values()))
    values = values[np.isfinite(values)]
    if len(values) < 20:
        return None
    limit = OUTLIER * 1.4826 * float(np.median(np.abs(values - np.median(values))))
    owners = {t: int(np.sum(np.abs(v[np.isfinite(v)]) > limit)) for t, v in parts.items()}
    count = sum(owners.values())
    if limit <= 0 or not count:
        return None
    named = ", ".join(f"{t}: {n}" for t, n in owners.items() if n)
    return warn_check(
        "SWM025",
        f"no outliers, {channel}",
        f"{count} of {len(values)} samples",
        False,
        f"within {OUTLIER:g} robust standard deviations",
        f"{named}; outliers are fitted like all other samples: blank the cells if the sensor failed there",
        f"{count} of {len(values)} samples of {channel} are outliers",
    )


def _whiteness(result: FitResult) -> list[ev.Check]:
    """Return a check for each channel whether its residuals are white, and warn once of all that are not."""
    tests = {channel: ljung_box(_join_residuals(result, channel)) for channel in result.noise}
    coloured = {channel: test.p_value for channel, test in tests.items() if not test.is_passed}
    largest = ev.p_text(max(coloured.values(), default=1.0))
    if len(coloured) > 1:
        largest = largest.replace("=", "≤")
    reason = f"residuals are not white in {numbers.join_names(list(coloured))} ({largest})"
    text = "the model may miss an effect; the standard errors account for it"
    if coloured:
        warn("SWM013", f"{reason}; {text}")
    found = []
    for channel, test in tests.items():
        name, shown = f"white residuals, {channel}", ev.p_text(test.p_value)
        note, limit = text * (not test.is_passed), f"p ≥ {SIGNIFICANCE:g}"
        found.append(ev.make_check(name, shown, test.is_passed, limit, note, reason=reason))
    return found


def _validation(result: FitResult, channel: Channel) -> ev.Check:
    """Return a check of the error of a channel on validation trials.

    The error is compared with that on fitted trials, and with that of a constant.
    """
    held_out = result.series_of(channel.name, "validate")
    fitted = ev.compute_rms(*(s.residual for s in result.series_of(channel.name, "fit")))
    error = ev.compute_rms(*(s.residual for s in held_out))
    constant = ev.compute_rms(*(s.measured - np.nanmean(s.measured) for s in held_out))
    ratio = error / fitted if fitted else math.inf
    worst = max(held_out, key=lambda s: ev.compute_rms(s.residual))
    return warn_check(
        "SWM015",
        f"validation, {channel.name}",
        numbers.format_number(error, 3, channel.unit),
        ratio <= VALIDATION_RATIO,
        f"≤ {VALIDATION_RATIO:g} × fit error ({numbers.format_number(fitted, 3, channel.unit)})",
        f"root-mean-square error on trials that were not fitted, largest in {worst.trial}",
        f"the held-out error of {channel.name} is {ratio:.1f} times that of fitted trials",
        # The check fails if, on a logarithmic scale, the held-out error is closer to the error of a constant
        # than to the error on fitted trials.
        failed=error > math.sqrt(fitted * constant),
    )


def _join_residuals(result: FitResult, channel: str, role: str = "fit") -> Array:
    """Return the weighted residuals of a channel in the trials of one role, joined to one series."""
    return join_series([s.z_scores for s in result.series_of(channel, role)], gap=30)


def error_checks(result: FitResult, roles: Sequence[str] = ("fit", "validate")) -> list[ev.Check]:
    """Return checks of the errors on fitted and on validation trials, with the limits of ``compare``."""
    found = []
    for role in roles:
        known = {name: score for name, score in compute_scores(result, role).items() if name in result.noise}
        pairs = _own_pairs(result, role)
        still = [name for name in known if is_still(y for y, _ in pairs[name])]
        white = [name for name in known if ljung_box(_join_residuals(result, name, role)).is_passed]
        judged = [name for name in result.noise if name not in still]
        found += score_checks(known, fitted=judged, noise=white + still, held_out=role == "validate")
    return found


def beat_check(found: Mapping[str, Mapping[str, Any] | None]) -> ev.Check:
    """Return a check that the beat frequency found in each log equals the one stated in the trials file.

    The module :mod:`swimid.kinematics.frequency` finds the frequency.
    """
    known = {name: b for name, b in found.items() if b is not None and b["found_hz"] is not None}
    wrong, shown = [], "yes"
    for name, b in known.items():
        if abs(b["found_hz"] - b["stated_hz"]) > max(FREQUENCY_RTOL * b["stated_hz"], 3 * b["stderr_hz"]):
            wrong.append(name)
            shown = f"not in {len(wrong)} of {len(known)} trials"
    return ev.make_check(
        "beat frequency as stated",
        shown,
        not wrong,
        f"within {100 * FREQUENCY_RTOL:g} %",
        "found in the heading of each log",
        reason=f"the beat frequency measured in {', '.join(wrong)} differs from the stated frequency",
    )


def figures(result: FitResult) -> list[ev.Figure]:
    """Return the figures of a fit for each channel: measured and simulated series, and residuals."""
    found = []
    for channel in (c for c in result.model.channels if c.name in result.noise):
        series = result.series_of(channel.name)
        name = channel.meaning or channel.name
        factor, unit = numbers.in_degrees(channel.unit)
        found += [
            ev.make_fit_figure(
                f"overlay-{channel.name}",
                f"{name[:1].upper()}{name[1:]}, measured and simulated",
                "Points are measured, and thinned; lines are simulated with the estimated parameters. Trials "
                "are ranked by their root-mean-square residual over the noise.",
                f"{name} ({numbers.unit_text(unit) or '1'})",
                series,
                factor,
            ),
            ev.make_residual_figure(
                f"residuals-{channel.name}",
                f"Residuals of {name}",
                "Measured minus simulated over the standard deviation of the noise.",
                series,
                autocorrelation(_join_residuals(result, channel.name)),
            ),
        ]
    return found


def finish(
    command: str,
    file: ParameterFile,
    checks: list[ev.Check],
    warnings: Sequence[Notice],
    output: Path | None,
    **shown: Any,
) -> Fitted:
    """Return the result of a fit, and write its parameter file and evidence file if an output path is given.

    Parameters
    ----------
    command : str
        Name of the command in the evidence file.
    warnings : sequence of Notice
        Warnings that were recorded during the fit.
    **shown
        Further fields of the evidence file: title, tables, figures, notes, methods and references.
    """
    evidence = ev.Evidence(
        command=command,
        verdict=ev.make_verdict(answer(file), checks),
        checks=checks,
        notices=list(warnings),
        provenance=file.provenance,
        **shown,
    )
    return Fitted.of(file, evidence).write_output(output)


def answer(file: ParameterFile) -> str:
    """Return the main result of a fit: a sentence with the first three estimated shared parameters."""
    parts = [
        f"{parameter_text(name, e.meaning)} {numbers.format_estimate(e.value, e.stderr, e.unit)}"
        for name, e in file.parameters.items()
        if e.status == "estimated" and "[" not in name
    ]
    if len(parts) > 3:
        parts[3:] = [f"and {len(parts) - 3} more"]
    return f"{'; '.join(parts) or 'Nothing was estimated'}."
