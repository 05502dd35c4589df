"""Offset between the clocks of two logs of one motion.

A linear regression predicts the motion in one log from the motion in the other log, apart from slow drift.
The clock offset with the best prediction is used.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy import optimize
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]

#: Minimum number of common samples for a comparison of two logs.
MIN_SAMPLES_OFFSET = 16
#: Maximum sample time of a compared log, as a fraction of the shortest period of drift. With a longer sample
#: time, motion cannot be distinguished from drift.
MAX_STEP = 0.2
#: Minimum overlap of the two logs in time, as a fraction of the shorter log.
MIN_OVERLAP = 0.3
#: SEARCH_PERIODS is the half-width of the grid of clock offsets that are tried, in periods of the signal.
#: N_OFFSETS is the number of offsets in this grid.
SEARCH_PERIODS, N_OFFSETS = 0.6, 61
#: Maximum time between two correlated residuals of the regression, s. Residuals further apart are taken as
#: independent.
INDEPENDENT_S = 1.0
#: Minimum fraction of the variance of one log that the other log explains if the two logs record the same
#: motion.
MIN_EXPLAINED = 0.2
#: MAX_RIVALS is the maximum number of alternative offsets that are compared with the best one. CHI2_99 is the
#: 99 % quantile of the chi-squared distribution with one degree of freedom, by which alternatives are
#: excluded.
MAX_RIVALS, CHI2_99 = 6, 6.635
#: Half-width of a 95 % interval in standard deviations.
BAND = 1.96


@dataclass(frozen=True)
class Offset:
    """Clock offset: time to add to one log so that its clock agrees with that of the reference log."""

    value_s: float
    stderr_s: float
    #: Limits of the 95 % interval of the offset, s.
    low_s: float
    high_s: float
    #: Fraction of the variance of the other log's channels, without drift, that the reference log explains.
    explained: float = np.nan
    #: Regression coefficients of the other log's channels on the reference channels, shape (k, d).
    factors: Array = field(default_factory=lambda: np.zeros((0, 0)))
    #: Mounting of the sensor: rotation from body to sensor axes; None unless the other log has three angles.
    mount: Rotation | None = None
    #: Handedness of the axes, from the correlation between the rotations in the two logs: -1 if an axis is
    #: mirrored, 1 if no axis is mirrored, 0 if unknown.
    handed: float = 0.0
    #: Alternative offsets that explain the other log about equally well, s, such as those that differ by one
    #: period.
    rivals: tuple[float, ...] = ()


def clock_offset(
    time_s: Array,
    reference: Array,
    seen_time_s: Array,
    seen: Array,
    *,
    slow_s: float = 5.0,
    near_s: tuple[float, float] | None = None,
) -> Offset | None:
    """Estimate the offset between the clocks of two logs of the same motion.

    Parameters
    ----------
    time_s : ndarray, shape (n,)
    reference : ndarray, shape (n, k)
        Channels of the log with the higher sample rate and less noise, for instance integrated turn rates.
    seen_time_s : ndarray, shape (m,)
    seen : ndarray, shape (m, d)
        Channels of the other log: linear functions of the reference channels plus white noise and slow drift.
        NaN where missing.
    slow_s : float
        Period above which a motion is taken for drift, s. Drift is not compared.
    near_s : (float, float), optional
        Interval in which the offset is known to be, s. If the interval is given, alternative offsets are
        searched, too.

    Returns
    -------
    Offset or None
        None if the records hardly overlap, or if one of them does not move.

    Notes
    -----
    The search starts at the maximum of the cross-correlation, summed over pairs of channels. From there the
    profile likelihood of the offset is maximised (Pawitan 2001, In All Likelihood, sec. 3.4). For each
    offset, the regression coefficients, the drift (cosines slower than ``slow_s``) and the noise of every
    channel are estimated. The standard error accounts for correlated residuals (Newey and West 1987,
    doi:10.2307/1913610).

    >>> t = np.arange(0.0, 20.0, 0.01)
    >>> wave = np.sin(6 * t) + 0.3 * np.sin(14 * t)
    >>> late = np.interp(t[::3] + 0.037, t, wave)
    >>> found = clock_offset(t, wave[:, None], t[::3], late[:, None] + 0.01 * np.cos(999 * t[::3, None] ** 2))
    >>> abs(found.value_s - 0.037) < 0.001
    True
    """
    known = np.isfinite(seen).all(axis=1)
    few = known.sum() < MIN_SAMPLES_OFFSET or np.ptp(time_s) == 0
    if few or np.median(np.diff(seen_time_s[known])) > MAX_STEP * slow_s:
        return None
    profile = _Profile(time_s, reference, seen_time_s[known], seen[known], slow_s)
    starts = profile.correlate(near_s)
    if len(starts) == 0:
        return None
    start, half = starts[0], SEARCH_PERIODS * profile.period_s
    low, high = near_s or (-np.inf, np.inf)
    grid = np.linspace(max(start - half, low), min(start + half, high), N_OFFSETS)
    values = np.array([profile(shift) for shift in grid])
    if not np.isfinite(values).any():
        return None
    best, width = float(grid[np.nanargmax(values)]), float(grid[1] - grid[0])
    bounds = max(best - width, low), min(best + width, high)
    found = optimize.minimize_scalar(lambda shift: -profile(shift), bounds=bounds, options={"xatol": 1e-6})
    offset = profile.offset(float(found.x))
    if offset is None or near_s is None:
        return offset
    return replace(offset, rivals=profile.rivals(offset.value_s, starts[1 : 1 + MAX_RIVALS]))


class _Profile:
    """Log-likelihood of a clock offset, maximised over all other parameters of the regression."""

    def __init__(self, t: Array, reference: Array, seen_t: Array, seen: Array, slow_s: float) -> None:
        self.t, self.reference = t, reference
        self.seen_t, self.seen, self.slow_s = seen_t, seen, slow_s
        fast = remove_drift(seen_t, seen, slow_s)
        speed = np.gradient(fast, seen_t, axis=0)
        lead = int(np.argmax(np.std(fast, axis=0)))
        turning = float(np.std(speed[:, lead]))
        self.period_s, self.excess = slow_s, 1.0
        if turning:
            self.period_s = 2 * np.pi * float(np.std(fast[:, lead])) / turning

    def correlate(self, near_s: tuple[float, float] | None) -> Array:
        """Return the clock offsets at the maxima of the cross-correlation, the largest maximum first.

        The cross-correlation is summed over pairs of channels.
        """
        from scipy import signal

        step = float(np.median(np.diff(self.seen_t)))
        a_t, b_t = (np.arange(t[0], t[-1], step) for t in (self.t, self.seen_t))
        if min(len(a_t), len(b_t)) < MIN_SAMPLES_OFFSET:
            return np.zeros(0)
        a = _normal(remove_drift(a_t, resample(a_t, self.t, self.reference), self.slow_s))
        b = _normal(remove_drift(b_t, resample(b_t, self.seen_t, self.seen), self.slow_s))
        ones_a, ones_b = np.ones(len(a)), np.ones(len(b))
        overlap = signal.correlate(ones_a, ones_b)
        alike = np.zeros(len(overlap))
        for other in b.T:
            energy_b = np.maximum(signal.correlate(ones_a, other**2), 1e-3 * np.sum(other**2))
            for one in a.T:
                energy_a = np.maximum(signal.correlate(one**2, ones_b), 1e-3 * np.sum(one**2))
                alike += signal.correlate(one, other) ** 2 / (energy_a * energy_b) / b.shape[1]
        # Rank the offsets by the gain in log-likelihood instead of the correlation, so that a short overlap
        # does not win by chance.
        score = -0.5 * overlap * np.log(1 - np.clip(alike, 0.0, 0.999))
        shifts = signal.correlation_lags(len(a), len(b)) * step + a_t[0] - b_t[0]
        allowed = overlap >= MIN_OVERLAP * min(len(a), len(b))
        if near_s is not None:
            allowed &= (shifts >= near_s[0]) & (shifts <= near_s[1])
        score = np.where(allowed, score, 0.0)
        maxima = np.flatnonzero((score > 0) & (score >= np.roll(score, 1)) & (score >= np.roll(score, -1)))
        return np.asarray(shifts[maxima][np.argsort(-score[maxima], kind="stable")])

    def fit(self, shift: float, inside: Array | None = None) -> tuple[Array, Array, Array, Array] | None:
        """Return the regression of the other log's channels on the reference channels at a clock offset.

        The result holds the reference channels, the channels of the other log, the regression coefficients,
        and the times in the overlap of the two logs, or of the samples that ``inside`` flags.

        The result is None if the two logs overlap too little.
        """
        when = self.seen_t + shift
        if inside is None:
            inside = (when >= self.t[0]) & (when <= self.t[-1])
        if inside.sum() < MIN_SAMPLES_OFFSET:
            return None
        expected = resample(when[inside], self.t, self.reference)
        both = remove_drift(self.seen_t[inside], np.hstack([expected, self.seen[inside]]), self.slow_s)
        x, y = np.hsplit(both, [expected.shape[1]])
        factors = np.asarray(np.linalg.lstsq(x, y, rcond=1e-9)[0], dtype=float)
        return x, y, factors, self.seen_t[inside]

    def __call__(self, shift: float) -> float:
        fitted = self.fit(shift)
        if fitted is None:
            return -np.inf
        x, y, factors, _ = fitted
        variance = np.mean((y - x @ factors) ** 2, axis=0)
        # Scale the log-likelihood from the samples in the overlap to all samples, so that a smaller overlap
        # has no advantage.
        return float(-0.5 * len(self.seen_t) * np.sum(np.log(np.maximum(variance, 1e-30))))

    def rivals(self, best: float, starts: Array) -> tuple[float, ...]:
        """Return the offsets near ``starts``, apart from ``best``, that the data do not exclude, s.

        Because the residuals are correlated, the likelihood ratio is divided by the ratio of the variance of
        the score to its information (Rotnitzky and Jewell 1990, doi:10.1093/biomet/77.3.485).
        """
        found, half, top = [], 0.2 * self.period_s, self(best)
        for start in starts[np.abs(starts - best) > half]:
            bounds = start - half, start + half
            other = optimize.minimize_scalar(lambda shift: -self(shift), bounds=bounds, method="bounded").x
            if 2 * (top - self(other)) / self.excess < CHI2_99:
                found.append(float(other))
        return tuple(found)

    def offset(self, value: float) -> Offset | None:
        """Return the clock offset ``value`` with its standard error, s; None if the error is unknown."""
        tiny = 1e-3 * self.period_s
        when = self.seen_t + value
        inside = (when >= self.t[0] + tiny) & (when <= self.t[-1] - tiny)
        here, after, before = (self.fit(shift, inside) for shift in (value, value + tiny, value - tiny))
        if here is None or after is None or before is None:
            return None
        x, y, factors, times = here
        residual = y - x @ factors
        slope = (after[0] @ factors - before[0] @ factors) / (2 * tiny)
        # Remove the component of the slope (derivative of the prediction with respect to the offset) that a
        # change of the regression coefficients can reproduce. This component has no information about the
        # offset.
        slope = slope - x @ np.linalg.lstsq(x, slope, rcond=1e-9)[0]
        variance = np.maximum(np.mean(residual**2, axis=0), 1e-30)
        information = float(np.sum(slope**2 / variance))
        if information <= 0:
            return None
        score = np.sum(slope * residual / variance, axis=1)
        lags = min(int(INDEPENDENT_S / float(np.median(np.diff(times)))), len(score) // 4)
        total = float(score @ score)
        for lag in range(1, lags + 1):
            total += 2 * (1 - lag / (lags + 1)) * float(score[lag:] @ score[:-lag])
        self.excess = max(total / information, 1.0)
        stderr = float(np.sqrt(self.excess / information))
        explained = 1 - float(np.sum(residual**2) / max(np.sum(y**2), 1e-30))
        return Offset(value, stderr, value - BAND * stderr, value + BAND * stderr, explained, factors)


def remove_drift(t: Array, channels: Array, slow_s: float) -> Array:
    """Return channels, shape (n, k), without drift: cosines with periods above ``slow_s`` are subtracted."""
    duration = float(t[-1] - t[0])
    count = max(int(2 * duration / slow_s), 1) + 1
    basis = np.cos(np.pi * np.outer((t - t[0]) / max(duration, 1e-12), np.arange(count)))
    # Solve the normal equations, which is fast. They are accurate enough because the cosines are nearly
    # orthogonal.
    gram = basis.T @ basis
    gram[np.diag_indices(count)] *= 1 + 1e-10
    return channels - basis @ np.linalg.solve(gram, basis.T @ channels)


def _normal(channels: Array) -> Array:
    """Return the channels that are not constant, each divided by its standard deviation."""
    spread = np.std(channels, axis=0)
    return channels[:, spread > 0] / spread[spread > 0]


def resample(at_s: Array, time_s: Array, values: Array) -> Array:
    """Return columns, shape (n, k), interpolated linearly from times ``time_s`` to ``at_s``, shape (m, k)."""
    return np.column_stack([np.interp(at_s, time_s, column) for column in values.T])
