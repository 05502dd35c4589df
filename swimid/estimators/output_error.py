"""Output-error identification: maximum likelihood over all samples of all trials.

The simulated channels are compared with the measured ones; what is left over is weighted by
a noise model estimated from the residuals themselves, and the uncertainty of the estimates
accounts for coloured residuals and for trials that scatter more than their noise.

Works for every :class:`swimid.models.base.Model`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import optimize, stats
from scipy.linalg import matmul_toeplitz

from swimid.errors import NoTrustworthyResult
from swimid.estimators.levenberg import Solution, minimise
from swimid.estimators.residual_tests import fit_autoregression, joined
from swimid.models.base import Array, Model, Parameter, Trial
from swimid.progress import Progress, silent

#: A standard error above this share of a parameter's size makes it unidentifiable.
UNIDENTIFIABLE = 0.5
#: Rounds of weighting by the noise model.
ROUNDS = 4
#: Trials are called inconsistent below this p-value.
HETEROGENEITY = 1e-3
#: The integration step is halved until halving it changes no sample by more than this many
#: standard deviations of its noise, at most so many times.
STEP_ERROR = 0.1
MAX_REFINEMENTS = 6


@dataclass(frozen=True)
class Noise:
    """Noise of one channel.

    Attributes
    ----------
    value_sd : float
        Standard deviation of the measured value, in the channel's unit (root mean square
        where it differs from sample to sample).
    time_sd_s : float
        Standard deviation of the time stamps, s; 0 where they are taken as exact.
    autoregression : ndarray, shape (p,)
        Coefficients of the weighted residuals' autoregression; empty where they are white.
    """

    value_sd: float
    time_sd_s: float
    autoregression: Array


@dataclass(frozen=True)
class Series:
    """Measured against simulated for one channel of one trial.

    Attributes
    ----------
    time_s, measured, simulated, sd : ndarray, shape (n,)
        ``sd`` is the standard deviation the noise model gives each sample.
    """

    trial: str
    role: str
    channel: str
    time_s: Array
    measured: Array
    simulated: Array
    sd: Array

    @property
    def residual(self) -> Array:
        """Measured minus simulated, shape (n,), NaN where missing."""
        return self.measured - self.simulated

    @property
    def weighted(self) -> Array:
        """Residual over its standard deviation, shape (n,)."""
        return self.residual / self.sd


@dataclass(frozen=True)
class FitResult:
    """Estimates, their covariance and all that judges them.

    Attributes
    ----------
    parameters : tuple of Parameter
        As fitted, the user's choices applied.
    labels : list of str
        One per estimated number; a per-trial parameter appears as ``name[trial]``.
    estimate : ndarray, shape (p,)
    covariance : ndarray, shape (p, p)
        Rows of parameters at a bound or not identifiable are NaN.
    status : dict of label to str
        ``estimated``, ``at-bound`` or ``unidentifiable``.
    series : list of Series
        Fitted and validation trials.
    noise : dict of channel name to Noise
    scatter : float
        Factor by which the trials scatter more than their noise (1 where they agree); already
        in the covariance.
    scatter_p : float
        p-value of the test that they agree.
    samples : int
    converged : bool
    message : str
    evaluations : int
        Simulations of single trials.
    step_error : float
        Largest change of a simulated sample when the integration step is halved, in standard
        deviations of its noise.
    """

    model: Model
    parameters: tuple[Parameter, ...]
    trials: tuple[Trial, ...]
    labels: list[str]
    estimate: Array
    covariance: Array
    status: dict[str, str]
    series: list[Series]
    noise: dict[str, Noise]
    scatter: float
    scatter_p: float
    samples: int
    converged: bool
    message: str
    evaluations: int
    step_error: float = 0.0

    def stderr(self, label: str) -> float | None:
        """Standard error of one estimate, or None where there is none."""
        if label not in self.labels:
            return None
        index = self.labels.index(label)
        variance = float(self.covariance[index, index])
        return math.sqrt(variance) if math.isfinite(variance) and variance >= 0 else None

    def value(self, name: str, trial: str | None = None) -> float:
        """Value of a parameter, estimated or fixed; of one trial where it is per trial."""
        label = name if trial is None else f"{name}[{trial}]"
        if label in self.labels:
            return float(self.estimate[self.labels.index(label)])
        return next(p.start for p in self.parameters if p.name == name)

    def values(self, trial: str) -> Array:
        """Full parameter vector of one trial."""
        return np.array([self.value(p.name, trial if p.per_trial else None) for p in self.parameters])


class _Problem:
    """Residuals and their derivatives as functions of the estimated numbers."""

    def __init__(self, model: Model, parameters: Sequence[Parameter], trials: Sequence[Trial]) -> None:
        self.model = model
        self.parameters = list(parameters)
        self.trials = list(trials)
        self.channels = [
            [c.name for c in model.channels if c.name in t.measured and np.isfinite(t.measured[c.name]).any()]
            for t in self.trials
        ]
        self.labels: list[str] = []
        self.slots: list[tuple[int, int | None]] = []  # (parameter, trial or None)
        for index, parameter in enumerate(self.parameters):
            if not parameter.free:
                continue
            owners: list[int | None] = list(range(len(self.trials))) if parameter.per_trial else [None]
            for owner in owners:
                name = parameter.name
                self.labels.append(name if owner is None else f"{name}[{self.trials[owner].id}]")
                self.slots.append((index, owner))
        self.masks = [
            [np.isfinite(t.measured[c]) for c in names]
            for t, names in zip(self.trials, self.channels, strict=True)
        ]
        self.sd = [
            [np.ones(len(t.time_s)) for _ in names]
            for t, names in zip(self.trials, self.channels, strict=True)
        ]
        self.evaluations = 0
        self.base = np.array([p.start for p in self.parameters])
        self.lower = np.array([self.parameters[i].lower for i, _ in self.slots])
        self.upper = np.array([self.parameters[i].upper for i, _ in self.slots])
        self.scale = np.array([self.parameters[i].scale for i, _ in self.slots])
        starts = np.array([self.parameters[i].start for i, _ in self.slots])
        self.start = np.clip(starts, self.lower, self.upper)

    def vector(self, theta: Array, trial: int) -> Array:
        values = self.base.copy()
        for number, (index, owner) in zip(theta, self.slots, strict=True):
            if owner is None or owner == trial:
                values[index] = number
        return values

    def _trial_residuals(self, theta: Array, k: int) -> Array:
        trial = self.trials[k]
        simulated = self.model.simulate(self.vector(theta, k), trial)
        self.evaluations += 1
        parts = [
            ((trial.measured[c] - simulated[c]) / sd)[mask]
            for c, sd, mask in zip(self.channels[k], self.sd[k], self.masks[k], strict=True)
        ]
        values = np.concatenate(parts) if parts else np.empty(0)
        # a simulation that broke down costs, it does not crash
        return np.where(np.isfinite(values), values, 1e6)

    def residuals(self, theta: Array) -> Array:
        return np.concatenate([self._trial_residuals(theta, k) for k in range(len(self.trials))])

    def trial_jacobians(self, theta: Array, *, central: bool = False) -> list[Array]:
        """Derivative of each trial's residuals, shape (n_k, p) each."""
        jacobians = []
        steps = 1e-6 * np.maximum(np.abs(theta), self.scale)
        if central:
            steps = 1e-5 * np.maximum(np.abs(theta), self.scale)
        # step towards the inside of the bounds
        steps = np.where(theta + steps > self.upper, -steps, steps)
        for k in range(len(self.trials)):
            here = self._trial_residuals(theta, k)
            columns = np.zeros((len(here), len(theta)))
            for j, (_, owner) in enumerate(self.slots):
                if owner is not None and owner != k:
                    continue
                moved = theta.copy()
                moved[j] += steps[j]
                ahead = self._trial_residuals(moved, k)
                inside = self.lower[j] <= theta[j] - steps[j] <= self.upper[j]
                if central and inside:
                    moved[j] = theta[j] - steps[j]
                    columns[:, j] = (ahead - self._trial_residuals(moved, k)) / (2 * steps[j])
                else:
                    columns[:, j] = (ahead - here) / steps[j]
            jacobians.append(columns)
        return jacobians

    def jacobian(self, theta: Array) -> Array:
        return np.concatenate(self.trial_jacobians(theta))

    def solve(self, theta: Array, *, tolerance: float) -> Solution:
        return minimise(
            self.residuals,
            self.jacobian,
            theta,
            lower=self.lower,
            upper=self.upper,
            scale=self.scale,
            tolerance=tolerance,
        )


def fit(
    model: Model,
    trials: Sequence[Trial],
    *,
    parameters: Sequence[Parameter] | None = None,
    progress: Progress = silent,
) -> FitResult:
    """Estimate the free parameters of a model from all fit trials at once.

    Parameters
    ----------
    model : Model
    trials : sequence of Trial
        Those of role ``validate`` are simulated and scored, not fitted.
    parameters : sequence of Parameter, optional
        The model's with the user's choices applied
        (:func:`swimid.models.base.chosen`); default the model's own.

    Returns
    -------
    FitResult

    Raises
    ------
    NoTrustworthyResult
        When the search does not converge, or there are fewer samples than unknowns.

    Notes
    -----
    Weighted nonlinear least squares by a bounded Levenberg-Marquardt method, reweighted
    :data:`ROUNDS` times by the estimated noise. Covariance ``H^-1 M H^-1`` with ``H = J'J``
    and ``M = sum_trials J_k' R J_k``, R the correlation of the weighted residuals under an
    autoregression chosen by BIC; multiplied by the trials' scatter where they disagree.
    """
    parameters = tuple(parameters or model.parameters)
    for _ in range(MAX_REFINEMENTS):
        result = _fit_once(model, trials, parameters, progress)
        finer = model.refined()
        if finer is None:
            return result
        result = replace(result, step_error=_step_error(result, finer))
        if result.step_error <= STEP_ERROR:
            return result
        model = finer
    return result


def _step_error(result: FitResult, finer: Model) -> float:
    trials = {t.id: t for t in result.trials}
    worst = 0.0
    for name, trial in trials.items():
        fine = finer.simulate(result.values(name), trial)
        for s in result.series:
            if s.trial == name:
                worst = max(worst, float(np.nanmax(np.abs(fine[s.channel] - s.simulated) / s.sd)))
    return worst


def _fit_once(
    model: Model, trials: Sequence[Trial], parameters: tuple[Parameter, ...], progress: Progress
) -> FitResult:
    fitted = [t for t in trials if t.role == "fit"]
    if not fitted:
        raise NoTrustworthyResult("no trial has the role 'fit'")
    problem = _Problem(model, parameters, fitted)
    theta = problem.start
    samples = sum(int(mask.sum()) for masks in problem.masks for mask in masks)
    if samples <= len(theta):
        raise NoTrustworthyResult(
            f"{samples} samples cannot determine {len(theta)} unknowns",
            hint="give longer logs or more trials, or fix some parameters",
        )
    noise: dict[str, tuple[float, float]] = {}
    # equal weights everywhere stay equal: one round is enough
    even = len({c for names in problem.channels for c in names}) == 1 and not any(
        t.stamps_uncertain or t.time_sd_s or t.value_sd for t in fitted
    )
    rounds = 1 if even else ROUNDS
    with progress("fitting", total=rounds) as step:
        for round_ in range(rounds):
            if round_:
                noise = _estimate_noise(problem, theta, noise)
            else:
                _weigh_first(problem, even)
            previous = theta
            solution = problem.solve(theta, tolerance=1e-6 if round_ < rounds - 1 else 1e-10)
            theta = solution.x
            step()
            if round_ > 1 and np.all(
                np.abs(theta - previous) <= 1e-7 * np.maximum(np.abs(theta), problem.scale)
            ):
                break
    noise = _estimate_noise(problem, theta, noise)
    if not solution.success or not np.isfinite(theta).all():
        raise NoTrustworthyResult(
            f"the fit did not converge: {solution.message}",
            hint="check units and trial settings; fix or bound a parameter; start nearer with --start",
        )
    return _result(problem, theta, noise, solution, parameters, tuple(trials))


def _weigh_first(problem: _Problem, even: bool) -> None:
    """First weights: each channel by its own size, known error shapes as they are."""
    if even:
        return
    for k, trial in enumerate(problem.trials):
        for i, channel in enumerate(problem.channels[k]):
            values = trial.measured[channel]
            known = trial.value_sd.get(channel)
            if known is not None and np.any(np.asarray(known) > 0):
                problem.sd[k][i] = np.broadcast_to(np.asarray(known, dtype=float), values.shape).copy()
            else:
                spread = float(np.nanstd(values)) or 1.0
                problem.sd[k][i] = np.full(len(values), 0.01 * spread)


def _estimate_noise(
    problem: _Problem, theta: Array, previous: dict[str, tuple[float, float]]
) -> dict[str, tuple[float, float]]:
    """Size of value and stamp errors by channel, from the residuals; sets the weights."""
    found: dict[str, tuple[float, float]] = {}
    names = sorted({c for channels in problem.channels for c in channels})
    for channel in names:
        residuals, rates, shapes, uncertain, places = [], [], [], [], []
        for k, trial in enumerate(problem.trials):
            if channel not in problem.channels[k]:
                continue
            i = problem.channels[k].index(channel)
            values = problem.vector(theta, k)
            simulated = problem.model.simulate(values, trial)[channel]
            needs_rate = trial.stamps_uncertain or trial.time_sd_s > 0
            rate = (
                problem.model.sensitivity_to_time(values, trial)[channel]
                if needs_rate
                else np.zeros_like(simulated)
            )
            residuals.append(trial.measured[channel] - simulated)
            rates.append(np.abs(rate))
            known = np.broadcast_to(
                np.asarray(trial.value_sd.get(channel, 0.0), dtype=float), simulated.shape
            )
            shapes.append(np.sqrt(known**2 + (trial.time_sd_s * rate) ** 2))
            uncertain.append(trial.stamps_uncertain)
            places.append((k, i))
        constant, stamp = _components(residuals, rates, shapes, uncertain, previous.get(channel))
        found[channel] = (constant, stamp)
        for (k, i), shape, rate, free in zip(places, shapes, rates, uncertain, strict=True):
            if np.any(shape > 0):
                sd = np.maximum(shape, 0.05 * np.median(shape)) * (constant or 1e-15)
            else:
                sd = np.sqrt(constant**2 + (stamp * rate) ** 2) if free else np.full(len(rate), constant)
            problem.sd[k][i] = np.maximum(
                sd, 1e-12 * max(1e-6, np.nanmax(np.abs(problem.trials[k].measured[channel])))
            )
    return found


def _components(
    residuals: list[Array],
    rates: list[Array],
    shapes: list[Array],
    uncertain: list[bool],
    previous: tuple[float, float] | None,
) -> tuple[float, float]:
    """Standard deviations of value and stamp; the first is a factor where the shape is known."""
    r = np.concatenate(residuals)
    there = np.isfinite(r)
    shape = np.concatenate(shapes)
    if np.any(shape > 0):
        floor = np.where(shape > 0, np.maximum(shape, 0.05 * np.median(shape[shape > 0])), 1.0)
        return float(np.sqrt(np.mean((r[there] / floor[there]) ** 2))), 0.0
    square = r[there] ** 2
    if not any(uncertain):
        return float(np.sqrt(np.mean(square))), 0.0
    rate2 = np.concatenate([q**2 if u else np.zeros_like(q) for q, u in zip(rates, uncertain, strict=True)])[
        there
    ]
    variance = np.full(len(square), max(float(np.mean(square)), 1e-300))
    if previous is not None:
        variance = np.maximum(previous[0] ** 2 + previous[1] ** 2 * rate2, 1e-3 * variance)
    design = np.column_stack((np.ones_like(rate2), rate2)) / variance[:, None]
    size = np.linalg.norm(design, axis=0)
    size[size == 0] = 1.0
    parts = optimize.nnls(design / size, square / variance)[0] / size
    # neither part may vanish altogether: a sample with no error would outweigh all others
    least = 1e-4 * float(np.mean(square))
    return math.sqrt(max(float(parts[0]), least)), math.sqrt(max(float(parts[1]), 0.0))


def _result(
    problem: _Problem,
    theta: Array,
    noise: dict[str, tuple[float, float]],
    solution: Solution,
    parameters: tuple[Parameter, ...],
    trials: tuple[Trial, ...],
) -> FitResult:
    jacobians = problem.trial_jacobians(theta, central=True)
    residuals = [problem._trial_residuals(theta, k) for k in range(len(problem.trials))]
    samples = sum(len(r) for r in residuals)
    margin = 1e-6 * np.maximum(problem.scale, np.abs(theta))
    at_bound = (theta - problem.lower < margin) | (problem.upper - theta < margin)
    free = ~at_bound
    autoregressions = _autoregressions(problem, residuals)
    covariance = np.full((len(theta), len(theta)), np.nan)
    scatter, scatter_p = 1.0, 1.0
    null = np.zeros(len(theta), dtype=bool)
    if free.any():
        part, null_part, scatter, scatter_p = _covariance(
            [j[:, free] * problem.scale[free] for j in jacobians],
            _correlated(problem, [j[:, free] * problem.scale[free] for j in jacobians], autoregressions),
            residuals,
            sum(1 for _, owner in problem.slots if owner is None),
        )
        covariance[np.ix_(free, free)] = part * np.outer(problem.scale[free], problem.scale[free])
        null[np.flatnonzero(free)[null_part]] = True
    status = {}
    for j, label in enumerate(problem.labels):
        variance = covariance[j, j]
        limit = UNIDENTIFIABLE * max(abs(theta[j]), problem.scale[j])
        if at_bound[j]:
            status[label] = "at-bound"
        elif null[j] or not math.isfinite(variance) or math.sqrt(max(variance, 0.0)) > limit:
            status[label] = "unidentifiable"
        else:
            status[label] = "estimated"
    result = FitResult(
        model=problem.model,
        parameters=parameters,
        trials=trials,
        labels=problem.labels,
        estimate=theta,
        covariance=covariance,
        status=status,
        series=[],
        noise={c: Noise(_value_sd(problem, c, v), t, autoregressions[c]) for c, (v, t) in noise.items()},
        scatter=scatter,
        scatter_p=scatter_p,
        samples=samples,
        converged=bool(solution.success),
        message=str(solution.message),
        evaluations=problem.evaluations,
    )
    return replace(result, series=_series(problem, result, trials))


def _value_sd(problem: _Problem, channel: str, constant: float) -> float:
    """Root mean square of the samples' standard deviations, stamps apart where they are free."""
    owners = [k for k, names in enumerate(problem.channels) if channel in names]
    if any(problem.trials[k].stamps_uncertain for k in owners):
        return constant
    squares = [np.mean(problem.sd[k][problem.channels[k].index(channel)] ** 2) for k in owners]
    return float(np.sqrt(np.mean(squares)))


def _autoregressions(problem: _Problem, residuals: list[Array]) -> dict[str, Array]:
    """Autoregression of the weighted residuals, pooled over trials, by channel."""
    parts: dict[str, list[Array]] = {}
    for k, values in enumerate(residuals):
        at = 0
        for channel, mask in zip(problem.channels[k], problem.masks[k], strict=True):
            series = np.full(len(mask), np.nan)
            series[mask] = values[at : at + int(mask.sum())]
            at += int(mask.sum())
            parts.setdefault(channel, []).append(series)
    found = {}
    for channel, series_list in parts.items():
        x = joined(series_list, gap=30)
        if np.isfinite(x).sum() < 12 or np.nanstd(x) == 0:
            found[channel] = np.empty(0)
            continue
        longest = max(len(s) for s in series_list)
        fitted = fit_autoregression(x, max_order=max(1, min(25, longest // 5)))
        found[channel] = fitted.coefficients
    return found


def autocovariance(coefficients: Array, lags: int) -> Array:
    """Autocorrelation of an autoregression at lags 0 .. lags, shape (lags + 1,).

    Parameters
    ----------
    coefficients : ndarray, shape (p,)
        Of ``x(k) + a1 x(k-1) + .. = e(k)``.
    """
    rho = np.zeros(lags + 1)
    rho[0] = 1.0
    p = len(coefficients)
    if p == 0:
        return rho
    # impulse response of 1 / A, long enough to have died out, correlated with itself
    length = lags + 1 + min(20000, max(2000, 10 * lags))
    from scipy.signal import lfilter

    impulse = np.zeros(length)
    impulse[0] = 1.0
    response = lfilter([1.0], np.concatenate(([1.0], coefficients)), impulse)
    spectrum = np.fft.rfft(response, 2 * length)
    covariance = np.fft.irfft(np.abs(spectrum) ** 2)[: lags + 1]
    return covariance / covariance[0]


def _correlated(problem: _Problem, jacobians: list[Array], autoregressions: dict[str, Array]) -> list[Array]:
    """R J for each trial, R the residuals' correlation matrix."""
    longest = max(len(t.time_s) for t in problem.trials)
    rho = {c: autocovariance(a, longest - 1) for c, a in autoregressions.items()}
    products = []
    for k, jacobian in enumerate(jacobians):
        parts, at = [], 0
        for channel, mask in zip(problem.channels[k], problem.masks[k], strict=True):
            count = int(mask.sum())
            rows = np.zeros((len(mask), jacobian.shape[1]))
            rows[mask] = jacobian[at : at + count]
            at += count
            if len(autoregressions[channel]):
                rows = matmul_toeplitz(rho[channel][: len(mask)], rows)
            parts.append(rows[mask])
        products.append(np.concatenate(parts) if parts else np.zeros((0, jacobian.shape[1])))
    return products


def _covariance(
    jacobians: list[Array], correlated: list[Array], residuals: list[Array], shared: int
) -> tuple[Array, Array, float, float]:
    """Covariance, null parameters, scatter factor and its p-value, in scaled parameters."""
    j = np.concatenate(jacobians)
    samples, unknowns = j.shape
    size = np.linalg.norm(j, axis=0)
    null = size == 0
    size = np.where(null, 1.0, size)
    _, singular, vt = np.linalg.svd(j / size, full_matrices=False)
    good = (
        singular > 1e-8 * singular[0] if len(singular) and singular[0] > 0 else np.zeros(len(singular), bool)
    )
    # a parameter with a part in a direction the data do not see is not identifiable
    null |= (np.abs(vt[~good]) > 1e-3).any(axis=0)
    inverse = (vt[good].T / singular[good] ** 2) @ vt[good] / np.outer(size, size)
    variance = sum(float(r @ r) for r in residuals) / max(samples - unknowns, 1)
    meat = sum(a.T @ b for a, b in zip(jacobians, correlated, strict=True)) * variance
    covariance = inverse @ meat @ inverse
    covariance = 0.5 * (covariance + covariance.T)
    if len(jacobians) < 3:
        return covariance, null, 1.0, 1.0
    statistic, degrees = 0.0, -unknowns
    for a, b, r in zip(jacobians, correlated, residuals, strict=True):
        score = a.T @ r
        spread = (a.T @ b) * variance
        scale = np.sqrt(np.maximum(np.diag(spread), 1e-300))
        values, vectors = np.linalg.eigh(spread / np.outer(scale, scale))
        keep = values > 1e-6 * max(values.max(initial=0.0), 1e-300)
        part = vectors[:, keep].T @ (score / scale)
        statistic += float(np.sum(part**2 / values[keep]))
        degrees += int(keep.sum())
    if degrees < 1:
        return covariance, null, 1.0, 1.0
    p_value = float(stats.chi2.sf(statistic, degrees))
    factor = math.sqrt(statistic / degrees) if p_value < HETEROGENEITY else 1.0
    return covariance * max(factor, 1.0) ** 2, null, max(factor, 1.0), p_value


def _series(problem: _Problem, result: FitResult, trials: tuple[Trial, ...]) -> list[Series]:
    by_id = {t.id: k for k, t in enumerate(problem.trials)}
    series = []
    for trial in trials:
        simulated = problem.model.simulate(result.values(trial.id), trial)
        for channel in (c.name for c in problem.model.channels if c.name in trial.measured):
            if trial.id in by_id and channel in problem.channels[by_id[trial.id]]:
                k = by_id[trial.id]
                sd = problem.sd[k][problem.channels[k].index(channel)]
            else:
                sd = np.full(
                    len(trial.time_s), result.noise[channel].value_sd if channel in result.noise else np.nan
                )
            series.append(
                Series(
                    trial.id,
                    trial.role,
                    channel,
                    trial.time_s,
                    trial.measured[channel],
                    simulated[channel],
                    sd,
                )
            )
    return series


def profile_interval(
    result: FitResult, name: str, *, level: float = 0.95
) -> tuple[float | None, float | None]:
    """Profile-likelihood interval of one shared parameter.

    The parameter is held at values ever farther from its estimate, all others are refitted,
    and the interval ends where the fit is worse by the chi-square quantile. Coloured residuals
    and scattering trials widen it by the same factor as they widen the standard error.

    Returns
    -------
    low, high : float or None
        None where the interval runs into a bound or does not end within some ten standard errors.
    """
    stderr = result.stderr(name)
    if stderr is None:
        return None, None
    whole = _weighted_problem(result, result.parameters)
    best = whole.residuals(result.estimate)
    cost = float(best @ best)
    rows = whole.jacobian(result.estimate)
    j = result.labels.index(name)
    variance = cost / max(len(best) - len(result.labels), 1)
    white = float(np.linalg.pinv(rows.T @ rows)[j, j]) * variance
    inflation = stderr**2 / white if white > 0 else 1.0
    limit = float(stats.chi2.ppf(level, 1)) * variance * inflation
    centre, others = float(result.estimate[j]), np.delete(result.estimate, j)

    def excess(value: float) -> float:
        held = tuple(replace(p, start=value, free=False) if p.name == name else p for p in result.parameters)
        return _weighted_problem(result, held).solve(others, tolerance=1e-8).cost - cost - limit

    parameter = next(p for p in result.parameters if p.name == name)
    ends: list[float | None] = []
    for side, bound in ((-1.0, parameter.lower), (1.0, parameter.upper)):
        near, end = centre, None
        for k in range(7):
            far = centre + side * 2.5 * stderr * 1.4**k
            if (far - bound) * side >= 0:
                break
            if excess(far) > 0:
                end = float(optimize.brentq(excess, near, far, xtol=1e-3 * stderr))
                break
            near = far
        ends.append(end)
    return ends[0], ends[1]


def _weighted_problem(result: FitResult, parameters: tuple[Parameter, ...]) -> _Problem:
    """The fit's problem with its final weights, for other choices of parameters."""
    problem = _Problem(result.model, parameters, [t for t in result.trials if t.role == "fit"])
    known = {(s.trial, s.channel): s.sd for s in result.series}
    for k, trial in enumerate(problem.trials):
        problem.sd[k] = [known[trial.id, channel] for channel in problem.channels[k]]
    return problem
