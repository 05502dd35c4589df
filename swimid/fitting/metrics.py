"""Result of an output-error fit, and errors of any simulation against a measurement, with their limits.

:class:`FitResult` holds the estimates, their covariance, the noise, and each measured series with its
simulation. All commands use the same errors. The origin and the axes of a pose are arbitrary, so that errors
of a pose are relative to each trial's own motion. Horizontal positions are rotated into the mean heading of
the trial (:func:`own_axes`). Ranges and variances are taken about the mean of each trial
(:func:`score_trials`).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numba
import numpy as np

from swimid.fitting.model import Array, Model, Parameter, Trial
from swimid.results import evidence as ev
from swimid.results import numbers


@dataclass(frozen=True)
class Noise:
    """Noise of one channel, as estimated by a fit."""

    #: Standard deviation of the measured values, in the unit of the channel. If it differs between samples,
    #: the root mean square over the samples.
    value_sd: float
    #: Standard deviation of the time stamps, s; 0 if the time stamps are exact.
    time_sd_s: float
    #: Coefficients of the autoregression of the weighted residuals, shape (p,). Empty if the residuals are
    #: white.
    autoregression: Array


@dataclass(frozen=True)
class Series:
    """Measured and simulated series of one channel of one trial."""

    trial: str
    role: str
    channel: str
    #: Time and values of the samples, shape (n,) each. ``sd`` is the standard deviation of each sample in the
    #: noise model.
    time_s: Array
    measured: Array
    simulated: Array
    sd: Array

    @property
    def residual(self) -> Array:
        """Measured minus simulated values, shape (n,); NaN for missing samples."""
        return self.measured - self.simulated

    @property
    def weighted(self) -> Array:
        """Residuals divided by the standard deviations of their samples, shape (n,)."""
        return self.residual / self.sd


@dataclass(frozen=True)
class FitResult:
    """Result of a fit: estimates, covariance, and the series and numbers that support them."""

    model: Model
    #: Parameters of the fit, with the choices of the user.
    parameters: tuple[Parameter, ...]
    trials: tuple[Trial, ...]
    #: One label for each unknown: the name of its parameter, or ``name[trial]`` if each trial has its own
    #: value.
    labels: list[str]
    #: Estimates, shape (p,).
    estimate: Array
    #: Covariance of the estimates, shape (p, p). NaN for parameters at a bound, and for parameters that do
    #: not affect the residuals.
    covariance: Array
    #: Status of each label: ``estimated``, ``at-bound`` or ``unidentifiable``.
    status: dict[str, str]
    #: Series of the fitted and of the validation trials.
    series: list[Series]
    #: Noise of each channel.
    noise: dict[str, Noise]
    #: Factor by which trials differ more than their noise explains; 1 if the trials agree. The covariance
    #: includes it.
    scatter: float
    #: p-value of the test that the trials agree.
    scatter_p: float
    samples: int
    converged: bool
    message: str
    #: Number of simulations of single trials in all searches and tests of the fit. Simulations for
    #: derivatives by time (uncertain time stamps) are not counted.
    evaluations: int
    #: Largest change of a simulated sample if the integration step is halved, in standard deviations of the
    #: noise.
    step_error: float = 0.0
    #: The user stopped the search. The estimates are then the best ones so far.
    interrupted: bool = False
    #: Mean squared residual, as a geometric mean over channels of different units. It is the exponential of
    #: (twice the negative log-likelihood per sample, minus one). It compares fits of the same samples, even
    #: if their weights differ.
    cost: float = math.nan
    #: Square root of the information matrix, shape (q, p): ``information_root' information_root`` is the
    #: inverse of the covariance. It is accurate even if the covariance is infinite. Columns of parameters
    #: held at a bound are NaN.
    information_root: Array = field(default_factory=lambda: np.empty((0, 0)))
    #: Estimates of the per-trial parameters of validation trials, by label. The shared parameters are held.
    start_states: Mapping[str, float] = field(default_factory=dict)
    #: Number of restarts near the estimates that led to a better fit; None if no restart was tested.
    restarts: int | None = None
    #: The last restart led to no better fit.
    settled: bool = True

    @property
    def shared(self) -> list[str]:
        """Labels of the unknowns that all trials share."""
        return [label for label in self.labels if "[" not in label]

    def parameter(self, label: str) -> Parameter:
        """Return the parameter to which the label of an unknown belongs."""
        return next(p for p in self.parameters if p.name == label.split("[")[0])

    def series_of(self, channel: str, role: str | None = None) -> list[Series]:
        """Return the series of a channel, by default of all trials; otherwise of the trials of one role."""
        return [s for s in self.series if s.channel == channel and role in (None, s.role)]

    def at_estimates(self) -> tuple[Parameter, ...]:
        """Return the parameters with the estimates of shared parameters as start values."""
        return tuple(replace(p, start=self.value(p.name)) for p in self.parameters)

    def stderr(self, label: str) -> float | None:
        """Return the standard error of an estimate; None if it has no standard error."""
        if label not in self.labels:
            return None
        index = self.labels.index(label)
        variance = float(self.covariance[index, index])
        return math.sqrt(variance) if math.isfinite(variance) and variance >= 0 else None

    def value(self, name: str, trial: str | None = None) -> float:
        """Return the value of a parameter, estimated or fixed; in one trial for a per-trial parameter."""
        for label in (f"{name}[{trial}]", name):
            if label in self.labels:
                return float(self.estimate[self.labels.index(label)])
            if label in self.start_states:
                return self.start_states[label]
        return next(p.start for p in self.parameters if p.name == name)

    def values(self, trial: str) -> Array:
        """Return the values of all parameters in one trial, in the order of the model."""
        return np.array([self.value(p.name, trial) for p in self.parameters])


# ---------------------------------------------------------------- errors


#: Maximum error for a good and for a usable description of a channel, as fractions of its measured range.
GOOD, USABLE = 0.15, 0.30
#: Maximum error of the mean speed of trials for a good and a usable model, as fractions of the measured
#: speed.
GOOD_SPEED, USABLE_SPEED = 0.10, 0.25


@dataclass(frozen=True)
class Score:
    """Errors of one channel."""

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
        """Return the errors as an entry of the parameter file."""
        return {**asdict(self), "unit": unit}


def score(measured: Array, simulated: Array) -> Score:
    """Compare two series, shape (n,). Samples missing in either are left out; NaN without samples.

    >>> score(np.array([0.0, 1.0, 2.0]), np.array([0.0, 1.0, 2.0])).fit_percent
    100.0
    """
    return score_trials([(measured, simulated)], own_motion=False)


def _ratio(value: float, size: float) -> float:
    """Return a value divided by a size; NaN unless the size is positive."""
    if size > 0:
        return value / size
    return math.nan


def score_trials(parts: Sequence[tuple[Array, Array]], *, own_motion: bool) -> Score:
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
    >>> round(score_trials([pair, turned], own_motion=True).vaf, 3), round(score(*pair).vaf, 3)
    (0.75, 0.75)
    """
    there = [pair for pair in (_both(y, z) for y, z in parts) if len(pair[0])]
    if not there:
        return Score(np.nan, np.nan, np.nan, np.nan, np.nan, 0)
    if not own_motion:
        there = [(np.concatenate([y for y, _ in there]), np.concatenate([z for _, z in there]))]
    error = np.concatenate([y - z for y, z in there])
    share = np.array([len(y) for y, _ in there]) / len(error)
    span = math.sqrt(float(share @ [np.ptp(y) ** 2 for y, _ in there]))
    variance = float(share @ [np.var(y) for y, _ in there])
    missed = float(share @ [np.var(y - z) for y, z in there])
    rmse = float(np.sqrt(np.mean(error**2)))
    return Score(
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
    there = np.isfinite(measured["x_m"]) & np.isfinite(measured["y_m"])
    if np.isfinite(heading).any():
        angle = float(np.nanmean(heading))
    elif there.any():
        x, y = (measured[name][there] for name in ("x_m", "y_m"))
        angle = math.atan2(y[-1] - y[0], x[-1] - x[0])
    else:
        return turned
    c, s = math.cos(angle), math.sin(angle)
    for side in turned:
        x, y = side["x_m"], side["y_m"]
        side["x_m"], side["y_m"] = c * x + s * y, c * y - s * x
    return turned


def peak_error(measured: Array, simulated: Array) -> tuple[float, float]:
    """Compute the difference between the largest magnitudes of two series, and its ratio to the measured one.

    This is Eq 14 of the T-Fish paper. Samples missing in either series, shape (n,), are left out.

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
    # A cos(wt) + B sin(wt) = |A - iB| cos(wt + arg(A - iB))
    phasor = cosine - 1j * sine
    if np.any(np.abs(phasor) <= 1e-12 * np.max(np.abs(both), axis=0)):
        return np.nan
    return float(np.angle(phasor[1] / phasor[0]))


def _both(measured: Array, simulated: Array) -> tuple[Array, Array]:
    """Return two series without the samples that are missing in either of them."""
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
    """Compile the numba function of this module before its first use."""
    warping_cost(np.zeros((2, 1)), np.ones((2, 1)), 1)


# ---------------------------------------------------------------- limits


def error_checks(
    scores: Mapping[str, Any], *, fitted: Iterable[str], noise: Iterable[str] = (), held_out: bool = False
) -> list[ev.Check]:
    """Check the errors of channels against the limits :data:`GOOD` and :data:`USABLE`.

    Parameters
    ----------
    scores : mapping of channel name to Score, or to an object with ``nrmse`` and ``vaf``
        Errors of each channel over all trials.
    fitted : iterable of str
        Channels to which the parameters were fitted. For these channels a negative variance accounted for
        fails.
    noise : iterable of str
        Channels whose residuals are white. Their errors are noise, and are not judged.
    held_out : bool
        The trials were held out. The names of the checks then say so.
    """
    where = "held-out " if held_out else ""
    found = []
    for name, score in scores.items():
        check = share_check(f"{where}error of {name}", score.nrmse, GOOD, USABLE, "measured range")
        if name in set(noise) and check.verdict != "pass":
            text = "the residuals are white: noise alone is left"
            check = ev.check(check.name, check.value, None, text=text)
        found.append(check)
    for name in (name for name in fitted if name in scores):
        vaf, said = scores[name].vaf, f"{where}variance accounted for, {name}"
        reason = f"the simulated {name} is farther from the measurement than a constant is"
        if vaf is not None and vaf < 0.0:
            value = numbers.percent(vaf)
            found.append(ev.check(said, value, False, "≥ 0 %", otherwise="fail", reason=reason))
    return found


def share_check(
    name: str, share: float | None, good: float, usable: float, of: str, text: str = ""
) -> ev.Check:
    """Check a fraction against two limits: it passes up to ``good`` and fails above ``usable``."""
    value = math.inf if share is None or math.isnan(share) else share
    shown = numbers.percent(share)
    return ev.check(
        name,
        shown,
        value <= good,
        f"≤ {100 * good:g} % of the {of} (fail above {100 * usable:g} %)",
        text,
        otherwise="warn" if value <= usable else "fail",
        reason=f"the {name} is {shown} of the {of}",
    )
