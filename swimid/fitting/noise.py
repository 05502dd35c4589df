"""Noise of residuals: local levels, slow noise, autoregressions, and whitening of residuals and derivatives.

The weighted residual of a sample is independent noise of unit variance, plus slow noise. Slow noise is a
first-order process with the variance g and the time constant tau. Alternatively the residual follows an
autoregression. Whitening needs a number of operations that is proportional to the number of samples, also for
uneven time stamps. :func:`compute_posterior` weighs all values of g and tau by the restricted likelihood of
the residuals. For this likelihood each trial has its own values of all parameters, so that differences
between trials are not taken for slow noise.

References
----------
.. [1] H. D. Patterson, R. Thompson, "Recovery of inter-block information when block sizes are unequal",
   Biometrika 58 (1971), 545-554. Restricted likelihood.
.. [2] G. E. P. Box, G. M. Jenkins, G. C. Reinsel, "Time Series Analysis", 4th ed. (2008), appendix A3.2 and
   section 7.1: recursions of autoregressions.
.. [3] R. DerSimonian, N. Laird, "Meta-analysis in clinical trials", Controlled Clinical Trials 7 (1986),
   177-188. Shrinkage of local levels.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import special

from swimid.files.kernels import numba
from swimid.fitting.model import Array, Trial
from swimid.fitting.problem import Problem
from swimid.fitting.uncertainty import fit_joint

#: Ratios of slow to independent noise: variance of the slow noise, divided by the variance of the mean of the
#: independent noise over one time constant. The slow noise is negligible at the smallest ratio, and the
#: independent noise at the largest.
SLOW_NOISE_RATIOS = np.geomspace(0.03, 1e7, 12)
#: Number of time constants of slow noise (N_TIMES). They range from two sampling intervals to MAX_MEMORY
#: durations of the longest trial.
N_TIMES, MAX_MEMORY = 12, 1.5
#: Division of the residual of a trial for the comparison of local levels. N_BLOCKS is the number of blocks.
#: N_PARTS is the number of parts with one level each. MIN_BLOCKS is the minimum number of blocks in a part.
#: MIN_BLOCK is the minimum number of samples in a block.
N_BLOCKS, N_PARTS, MIN_BLOCKS, MIN_BLOCK = 40, 6, 3, 3
#: Significance level at which unequal local levels replace one level.
LEVEL_P_VALUE = 0.01
#: Minimum variance of the noise, in units of the mean squared residual.
MIN_VARIANCE = 1e-16
#: Minimum singular value of normalised derivatives, as a fraction of the largest, for a direction that the
#: derivatives determine.
DERIVATIVE_RTOL = 1e-7


# ---------------------------------------------------------------- whitening


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _filter_slow(rows, decay, ratio):  # type: ignore[no-untyped-def]
    """Return one-step prediction errors divided by their standard deviations, and the sum of log variances.

    The noise of a sample is independent noise of unit variance plus a first-order process of variance
    ``ratio``, whose value decays by the factor ``decay`` from the sample before (scalar Kalman filter).
    """
    samples, columns = rows.shape
    out = np.empty_like(rows)
    mean = np.zeros(columns)
    variance = ratio
    log_variance = 0.0
    for i in range(samples):
        if i > 0:
            mean *= decay[i]
            variance = decay[i] ** 2 * variance + ratio * (1.0 - decay[i] ** 2)
        total = variance + 1.0
        gain = variance / total
        root = math.sqrt(total)
        for j in range(columns):
            error = rows[i, j] - mean[j]
            out[i, j] = error / root
            mean[j] += gain * error
        variance *= 1.0 - gain
        log_variance += math.log(total)
    return out, log_variance


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _filter_autoregression(rows, position, predictors, deviations):  # type: ignore[no-untyped-def]
    """Return one-step prediction errors divided by their standard deviations, and the sum of log variances.

    ``position`` is the number of samples since the last gap. ``predictors`` has the coefficients of all
    orders up to the largest, one order in each row.
    """
    samples, columns = rows.shape
    out = np.empty_like(rows)
    log_variance = 0.0
    largest = len(deviations) - 1
    for i in range(samples):
        order = min(position[i], largest)
        for j in range(columns):
            error = rows[i, j]
            for lag in range(order):
                error += predictors[order, lag] * rows[i - lag - 1, j]
            out[i, j] = error / deviations[order]
        log_variance += 2.0 * math.log(deviations[order])
    return out, log_variance


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _correlate(rows, decay):  # type: ignore[no-untyped-def]
    """Return the correlation matrix of a first-order process, multiplied by columns."""
    samples, columns = rows.shape
    out = rows.copy()
    for j in range(columns):
        kept = 0.0
        for i in range(samples):
            out[i, j] += decay[i] * kept
            kept = rows[i, j] + decay[i] * kept
        kept = 0.0
        for i in range(samples - 1, -1, -1):
            out[i, j] += kept
            kept = decay[i] * (rows[i, j] + kept)
    return out


@dataclass(frozen=True)
class Autoregression:
    """Autoregression of a residual series of unit variance, with the predictors of all lower orders.

    Attributes
    ----------
    predictors : ndarray, shape (p + 1, p)
        Coefficients of the prediction from 0, 1, ... p previous samples.
    deviations : ndarray, shape (p + 1,)
        Standard deviations of the prediction errors.
    memory : float
        Number of samples in which the slowest mode decays by the factor e.
    """

    predictors: Array
    deviations: Array
    memory: float

    @classmethod
    def of(cls, coefficients: Array) -> Autoregression:
        """Return the autoregression with the given coefficients a1 ... ap, by the Levinson recursion [2]_."""
        order = len(coefficients)
        predictors, variances, a = np.zeros((order + 1, order)), np.ones(order + 1), coefficients
        for p in range(order, 0, -1):
            predictors[p, :p] = a
            # A series without noise may be predicted exactly.
            rest = max(1.0 - a[-1] ** 2, 1e-12)
            variances[:p] /= rest
            a = (a[:-1] - a[-1] * a[:-1][::-1]) / rest
        slowest = float(np.max(np.abs(np.roots(np.r_[1.0, coefficients])), initial=0.0))
        memory = -1.0 / math.log(min(max(slowest, 1e-9), 1.0 - 1e-9))
        return cls(predictors, np.sqrt(variances / variances[0]), memory)


@dataclass(frozen=True)
class NoiseRows:
    """Weighted residual and derivatives of one channel of one trial.

    Attributes
    ----------
    time_s : ndarray, shape (n,)
        Times of the existing samples.
    place : ndarray of int, shape (n,)
        Indices of these samples among all samples of the trial.
    basis : ndarray, shape (n, m)
        Orthonormal basis of the columns of the derivatives.
    factor : ndarray, shape (m, p)
        Coefficients of the derivatives in that basis, for all p unknowns of the trial.
    residual : ndarray, shape (n,)
    """

    time_s: Array
    place: NDArray[np.intp]
    basis: Array
    factor: Array
    residual: Array

    @classmethod
    def of(cls, time_s: Array, mask: NDArray[np.bool_], derivatives: Array, residual: Array) -> NoiseRows:
        """Return residual and derivatives of samples that a mask marks, without undetermined directions."""
        norms = np.maximum(np.linalg.norm(derivatives, axis=0), 1e-300)
        u, singular, vt = np.linalg.svd(derivatives / norms, full_matrices=False)
        kept = singular > DERIVATIVE_RTOL * singular.max(initial=0.0)
        factor = singular[kept, None] * vt[kept] * norms
        return cls(time_s[mask], np.flatnonzero(mask), u[:, kept], factor, residual)

    @classmethod
    def alone(cls, time_s: Array, mask: NDArray[np.bool_], residual: Array) -> NoiseRows:
        """Return the residual of samples that a mask marks, without derivatives. All samples have times."""
        nothing = np.empty((len(residual), 0))
        return cls(time_s[mask], np.flatnonzero(mask), nothing, nothing[:0], residual)

    @property
    def own_residual(self) -> Array:
        """Residual that remains after a fit of this series alone, shape (n,)."""
        return np.asarray(self.residual - self.basis @ (self.basis.T @ self.residual))

    @property
    def columns(self) -> Array:
        """Basis and residual side by side, shape (n, m + 1)."""
        return np.column_stack((self.basis, self.residual))


def compute_rows(
    problem: Problem, residuals: Sequence[Array], derivatives: Sequence[Array]
) -> dict[str, dict[int, NoiseRows]]:
    """Return the residual and the derivatives of each channel in each trial, by channel and trial index.

    Parameters
    ----------
    residuals, derivatives : sequence of ndarray, each shape (n_k,) and (n_k, p_k)
        Weighted residuals of each trial, and derivatives of its simulated samples in the same unit.
    """
    found: dict[str, dict[int, NoiseRows]] = {}
    for k, trial in enumerate(problem.trials):
        parts = zip(problem.by_channel(k, residuals[k]), problem.by_channel(k, derivatives[k]), strict=True)
        for (channel, mask, residual), (_, _, rows) in parts:
            found.setdefault(channel, {})[k] = NoiseRows.of(trial.time_s, mask, rows, residual)
    return found


# ---------------------------------------------------------------- posterior of the noise of a channel


@dataclass(frozen=True)
class NoiseForm:
    """Model of the noise of a channel: independent noise, slow noise, or an autoregression.

    Attributes
    ----------
    ratio : float
        Variance of the slow noise, divided by that of the independent noise; 0 without slow noise.
    time_s : float
        Correlation time of the noise, s; 0 for independent noise.
    autoregression : Autoregression or None
        Autoregression that replaces slow noise; None without one.
    """

    ratio: float = 0.0
    time_s: float = 0.0
    autoregression: Autoregression | None = None

    def filter(self, time_s: Array, place: NDArray[np.intp]) -> Callable[[Array], tuple[Array, float]]:
        """Return a function that whitens columns at given times and indices of the samples."""
        if self.autoregression is not None:
            ends = np.flatnonzero(np.diff(place, prepend=place[:1] - 2) > 1)
            position = np.arange(len(place)) - np.repeat(ends, np.diff(np.r_[ends, len(place)]))
            law = self.autoregression
            return lambda columns: _filter_autoregression(columns, position, law.predictors, law.deviations)
        if self.ratio > 0.0:
            decay = np.exp(-np.diff(time_s, prepend=time_s[0]) / self.time_s)
            return lambda columns: _filter_slow(columns, decay, self.ratio)
        return lambda columns: (columns, 0.0)

    def whiten(self, time_s: Array, place: NDArray[np.intp], columns: Array) -> tuple[Array, float]:
        """Return columns whitened to noise of equal variance, and the log determinant of the noise."""
        out, log_determinant = self.filter(time_s, place)(columns)
        return np.asarray(out), float(log_determinant)

    def correlate(self, time_s: Array, columns: Array) -> Array:
        """Return columns multiplied by the covariance of noise whose independent part has unit variance.

        The autocorrelation of an autoregression is replaced by that of its slowest mode.
        """
        if self.autoregression is not None:
            slow, fast = 1.0, 0.0
        else:
            slow, fast = self.ratio, 1.0
        if slow <= 0.0 or self.time_s <= 0.0:
            return np.asarray((slow + fast) * columns)
        decay = np.exp(-np.diff(time_s, prepend=time_s[:1]) / self.time_s)
        return np.asarray(fast * columns + slow * _correlate(np.ascontiguousarray(columns), decay))


@dataclass(frozen=True)
class NoisePosterior:
    """Probabilities of the noise models of a channel.

    Attributes
    ----------
    forms : list of NoiseForm, length m
    probability, variance : ndarray, shape (m,)
        Probability of each model, and variance of the independent noise if this model is true.
    degrees : int
        Degrees of freedom of the variance.
    log_likelihood : float
        Logarithm of the likelihood of the residuals, averaged over the models, without its constant.
    """

    forms: list[NoiseForm]
    probability: Array
    variance: Array
    degrees: int
    log_likelihood: float

    @property
    def memory_s(self) -> float:
        """Geometric mean correlation time of the noise, s; 0 if independent noise is more probable."""
        slow = np.array([form.time_s > 0.0 for form in self.forms])
        weight = self.probability[slow]
        if weight.sum() <= 0.5:
            return 0.0
        times = np.log([form.time_s for form in self.forms if form.time_s > 0.0])
        return float(np.exp(weight @ times / weight.sum()))


def compute_posterior(rows: Mapping[int, NoiseRows]) -> NoisePosterior:
    """Return the probabilities of the noise models of one channel.

    Notes
    -----
    Independent noise has the prior probability 1/2. The rest is divided between slow noise and the
    autoregression that the BIC selects. The likelihood of the autoregression is lowered by the BIC penalty of
    its coefficients. The prior of slow noise is constant in the logarithm of the ratio, and rises with the
    time constant. Therefore a trial that cannot exclude slow noise does not count as free of slow noise.
    """
    forms, prior = _possible_forms(rows)
    log_likelihood, squares, degrees = np.zeros(len(forms)), np.zeros(len(forms)), 0
    for part in rows.values():
        columns = part.columns
        degrees += len(columns) - part.basis.shape[1]
        for i, form in enumerate(forms):
            white, log_determinant = form.whiten(part.time_s, part.place, columns)
            products = white.T @ white
            gram, mixed = products[:-1, :-1], products[:-1, -1]
            # The factor of a Gram matrix of an orthonormal basis is well conditioned.
            lower = np.linalg.cholesky(gram)
            projected = np.linalg.solve(lower, mixed)
            squares[i] += products[-1, -1] - projected @ projected
            log_likelihood[i] -= 0.5 * log_determinant + np.log(np.diag(lower)).sum()
    degrees = max(degrees, 1)
    # The squared residuals of data without noise are at least the rounding errors.
    squares = np.maximum(squares, degrees * MIN_VARIANCE)
    weight = np.log(prior) + log_likelihood - 0.5 * degrees * np.log(squares)
    total = float(special.logsumexp(weight))
    return NoisePosterior(forms, np.exp(weight - total), squares / degrees, degrees, total)


def _possible_forms(rows: Mapping[int, NoiseRows]) -> tuple[list[NoiseForm], Array]:
    """Return the noise models of a channel that are compared, and their prior probabilities."""
    steps = np.concatenate([np.empty(0), *(np.diff(part.time_s) for part in rows.values())])
    step = float(np.median(steps)) if len(steps) else 0.0
    longest = max((float(np.ptp(part.time_s)) for part in rows.values()), default=0.0)
    forms, prior = [NoiseForm()], [1.0]
    if longest > 4.0 * step > 0.0:
        times = np.geomspace(2.0 * step, MAX_MEMORY * longest, N_TIMES)
        slow = [NoiseForm(ratio * step / time, float(time)) for time in times for ratio in SLOW_NOISE_RATIOS]
        weight = np.array([form.time_s for form in slow])
        forms, prior = forms + slow, prior + list(weight / weight.sum())
    series = []
    for part in rows.values():
        whole = np.full(part.place[-1] + 1, np.nan)
        whole[part.place] = part.own_residual
        series.append(whole)
    coefficients = fit_joint(series)
    if len(coefficients):
        law = Autoregression.of(coefficients)
        count = sum(len(part.residual) for part in rows.values())
        forms.append(NoiseForm(0.0, law.memory * step, law))
        prior.append(count ** (-0.5 * len(coefficients)))
    return forms, np.array(prior) / 2.0


# ---------------------------------------------------------------- local levels


def compute_levels(problem: Problem, theta: Array) -> dict[tuple[int, str], Array]:
    """Return the local level of the noise of each channel and trial in which levels differ significantly.

    The residual of a fit of each trial alone is divided into :data:`N_PARTS` parts. The level of a part is
    the scatter inside short blocks, so that slow noise does not count. Levels are shrunk towards their common
    mean as far as chance explains their differences [3]_.

    Returns
    -------
    dict of (trial index, channel) to ndarray, shape (n,)
        Factors by which the standard deviation of the noise is multiplied at each sample. A channel with one
        level, with a known shape of its error, or with uncertain time stamps is left out.
    """
    residuals = [problem.trial_residuals(theta, k) for k in range(len(problem.trials))]
    rows = compute_rows(problem, residuals, problem.own_jacobians(theta))
    found = {}
    for channel, parts in rows.items():
        if any(_has_known_shape(problem.trials[k], channel) for k in parts):
            continue
        scaled = {}
        for k, part in parts.items():
            sd = problem.sd[k][problem.channels[k].index(channel)][part.place]
            scaled[k] = part.own_residual * sd, part.time_s
        for k, level in _levels(scaled, {k: problem.trials[k].time_s for k in parts}).items():
            found[k, channel] = level
    return found


def _has_known_shape(trial: Trial, channel: str) -> bool:
    """Return whether the shape of the error of a channel follows from the recording."""
    return bool(trial.stamps_uncertain or np.any(trial.time_sd_s) or np.any(trial.value_sd.get(channel, 0.0)))


def _levels(series: dict[int, tuple[Array, Array]], times: dict[int, Array]) -> dict[int, Array]:
    """Return the local noise level of each series at given times; an empty dict for equal levels."""
    owner, middle, level, error = [], [], [], []
    for k, (values, time) in series.items():
        size = max(len(values) // N_BLOCKS, MIN_BLOCK)
        count = len(values) // size
        squares = values[: count * size].reshape(count, size).var(axis=1, ddof=1)
        ends = np.linspace(0, count, min(N_PARTS, max(count // MIN_BLOCKS, 1)) + 1).astype(int)
        for begin, end in itertools.pairwise(ends.tolist()):
            part = squares[begin:end]
            if len(part) < MIN_BLOCKS or not part.all():
                continue
            mean = float(part.mean())
            owner.append(k)
            middle.append(time[0] + 0.5 * (begin + end) / count * (time[-1] - time[0]))
            level.append(math.log(mean))
            error.append(float(part.var(ddof=1)) / mean**2 / len(part))
    y = np.array(level)
    if len(y) < 2 or len(set(owner)) < len(series):
        return {}
    chance = float(np.mean(error))
    spread = float(np.sum((y - y.mean()) ** 2))
    if special.chdtrc(len(y) - 1, spread / max(chance, 1e-12)) > LEVEL_P_VALUE:
        return {}
    between = max(spread / (len(y) - 1) - chance, 0.0)
    shrunk = y.mean() + between / (between + chance) * (y - y.mean())
    whose, at = np.array(owner), np.array(middle)
    return {k: np.exp(0.5 * np.interp(times[k], at[whose == k], shrunk[whose == k])) for k in series}
