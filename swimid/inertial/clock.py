"""By how much the clocks of two logs of one trial differ, with an interval.

One log says how the other should look at any instant, up to unknown factors and slow drift; the
offset is where it looks most like it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from swimid.inertial.record import Array, resampled
from swimid.inertial.sensor import BAND

#: The likelihood is searched this far about the start, in periods of the signal.
_SEARCH_PERIODS = 0.6
#: Residuals this many seconds apart are taken as independent.
_MEMORY_S = 1.0
#: Least share of the shorter record that must overlap.
_OVERLAP = 0.3


@dataclass(frozen=True)
class Offset:
    """What to add to the times of the seen log to have them on the reference's clock."""

    #: Estimate, standard error and 95 % interval.
    value_s: float
    stderr_s: float
    low_s: float
    high_s: float
    #: Share of the variance of the seen channels, slow parts removed, that the reference explains.
    explained: float
    #: Shape (k, d). What the reference channels were multiplied with.
    factors: Array

    @property
    def excludes_zero(self) -> bool:
        """Whether clocks that agree lie outside the interval."""
        return not self.low_s <= 0.0 <= self.high_s


def offset(
    time_s: Array,
    reference: Array,
    seen_time_s: Array,
    seen: Array,
    *,
    slow_s: float = 5.0,
) -> Offset | None:
    """Estimate the offset between two clocks.

    Parameters
    ----------
    time_s : ndarray, shape (n,)
    reference : ndarray, shape (n, k)
        Channels of the faster, smoother log (integrated turn rates, say).
    seen_time_s : ndarray, shape (m,)
    seen : ndarray, shape (m, d)
        Channels of the other that are linear in the reference's, plus white noise and slow drift;
        NaN where missing.
    slow_s : float
        Slower than this is drift, and left out of the comparison.

    Returns
    -------
    Offset or None
        None when the records hardly overlap, or nothing moves in both.

    Notes
    -----
    The start is the peak of the cross-correlation, summed over pairs of channels. From there the
    profile likelihood (Pawitan 2001, In All Likelihood, sec. 3.4) of the offset is maximised: factors,
    drift (cosines slower than ``slow_s``) and the noise of every channel are solved for at each offset.
    The standard error contains what correlated residuals add to the variance of the score (Newey and West
    1987, doi:10.2307/1913610).

    >>> t = np.arange(0.0, 20.0, 0.01)
    >>> wave = np.sin(6 * t) + 0.3 * np.sin(14 * t)
    >>> late = np.interp(t[::3] + 0.037, t, wave)
    >>> found = offset(t, wave[:, None], t[::3], late[:, None] + 0.01 * np.cos(999 * t[::3, None] ** 2))
    >>> abs(found.value_s - 0.037) < 0.001
    True
    """
    there = np.isfinite(seen).all(axis=1)
    if there.sum() < 16 or np.ptp(time_s) == 0:
        return None
    if np.median(np.diff(seen_time_s[there])) > 0.2 * slow_s:
        return None  # too sparse to show anything faster than drift
    start = _correlate(time_s, reference, seen_time_s[there], seen[there], slow_s)
    if start is None:
        return None
    profile = _Profile(time_s, reference, seen_time_s[there], seen[there], slow_s)
    half = _SEARCH_PERIODS * profile.period_s
    grid = np.linspace(start - half, start + half, 61)
    values = np.array([profile(shift) for shift in grid])
    if not np.isfinite(values).any():
        return None
    best = float(grid[np.nanargmax(values)])
    width = float(grid[1] - grid[0])
    found = optimize.minimize_scalar(
        lambda shift: -profile(shift),
        bounds=(best - width, best + width),
        method="bounded",
        options={"xatol": 1e-6},
    )
    value = float(found.x)
    stderr = profile.spread(value)
    if not np.isfinite(stderr):
        return None
    fitted = profile.fit(value)
    assert fitted is not None
    x, y, factors, _ = fitted
    explained = 1 - float(np.sum((y - x @ factors) ** 2) / max(np.sum(y**2), 1e-30))
    return Offset(value, stderr, value - BAND * stderr, value + BAND * stderr, explained, factors)


class _Profile:
    """Log likelihood of an offset, everything else solved for."""

    def __init__(self, t: Array, reference: Array, seen_t: Array, seen: Array, slow_s: float) -> None:
        self.t, self.reference = t, reference
        self.seen_t, self.seen, self.slow_s = seen_t, seen, slow_s
        fast = without_slow(seen_t, seen, slow_s)
        speed = np.gradient(fast, seen_t, axis=0)
        lead = int(np.argmax(np.std(fast, axis=0)))
        turning = float(np.std(speed[:, lead]))
        self.period_s = 2 * np.pi * float(np.std(fast[:, lead])) / turning if turning else slow_s

    def fit(self, shift: float) -> tuple[Array, Array, Array, NDArray[np.intp]] | None:
        when = self.seen_t + shift
        inside = (when >= self.t[0]) & (when <= self.t[-1])
        if inside.sum() < 16:
            return None
        expected = resampled(when[inside], self.t, self.reference)
        both = without_slow(self.seen_t[inside], np.hstack([expected, self.seen[inside]]), self.slow_s)
        k = expected.shape[1]
        factors = np.asarray(np.linalg.lstsq(both[:, :k], both[:, k:], rcond=1e-9)[0], dtype=float)
        return both[:, :k], both[:, k:], factors, np.flatnonzero(inside)

    def __call__(self, shift: float) -> float:
        fitted = self.fit(shift)
        if fitted is None:
            return -np.inf
        x, y, factors, _ = fitted
        left = np.mean((y - x @ factors) ** 2, axis=0)
        # per sample, so that a smaller overlap is no advantage
        return float(-0.5 * len(self.seen_t) * np.sum(np.log(np.maximum(left, 1e-30))))

    def spread(self, shift: float) -> float:
        """Standard error, widened by what correlated residuals add to the variance of the score."""
        tiny = 1e-3 * self.period_s
        here, after, before = self.fit(shift), self.fit(shift + tiny), self.fit(shift - tiny)
        if here is None or after is None or before is None or len(after[3]) != len(before[3]):
            return np.nan
        x, y, factors, rows = here
        residual = y - x @ factors
        slope = (after[0] @ factors - before[0] @ factors) / (2 * tiny)
        if len(slope) != len(residual):
            return np.nan
        # what the other unknowns can imitate tells nothing of the offset
        slope = slope - x @ np.linalg.lstsq(x, slope, rcond=1e-9)[0]
        variance = np.maximum(np.mean(residual**2, axis=0), 1e-30)
        information = float(np.sum(slope**2 / variance))
        score = np.sum(slope * residual / variance, axis=1)
        step = float(np.median(np.diff(self.seen_t[rows])))
        lags = min(int(_MEMORY_S / step), len(score) // 4)
        total = float(score @ score)
        for lag in range(1, lags + 1):
            total += 2 * (1 - lag / (lags + 1)) * float(score[lag:] @ score[:-lag])
        if information <= 0:
            return np.nan
        return float(np.sqrt(max(total / information, 1.0) / information))


def without_slow(t: Array, channels: Array, slow_s: float) -> Array:
    """Channels less their parts slower than ``slow_s``, by cosines."""
    duration = float(t[-1] - t[0])
    count = max(int(2 * duration / slow_s), 1) + 1
    basis = np.cos(np.pi * np.outer((t - t[0]) / max(duration, 1e-12), np.arange(count)))
    gram = basis.T @ basis  # cosines are all but orthogonal: the normal equations do, and are fast
    gram[np.diag_indices(count)] *= 1 + 1e-10
    return channels - basis @ np.linalg.solve(gram, basis.T @ channels)


def _correlate(t: Array, reference: Array, seen_t: Array, seen: Array, slow_s: float) -> float | None:
    """Offset of the largest cross-correlation, summed over pairs of channels."""
    from scipy import signal

    step = float(np.median(np.diff(seen_t)))
    a_t, b_t = np.arange(t[0], t[-1], step), np.arange(seen_t[0], seen_t[-1], step)
    if len(a_t) < 16 or len(b_t) < 16:
        return None
    a = _normal(without_slow(a_t, resampled(a_t, t, reference), slow_s))
    b = _normal(without_slow(b_t, resampled(b_t, seen_t, seen), slow_s))
    lags = signal.correlation_lags(len(a), len(b))
    ones_a, ones_b = np.ones(len(a)), np.ones(len(b))
    overlap = signal.correlate(ones_a, ones_b)
    alike = np.zeros(len(lags))
    for other in b.T:
        energy_b = np.maximum(signal.correlate(ones_a, other**2), 1e-3 * np.sum(other**2))
        for one in a.T:
            energy_a = np.maximum(signal.correlate(one**2, ones_b), 1e-3 * np.sum(one**2))
            alike += signal.correlate(one, other) ** 2 / (energy_a * energy_b) / b.shape[1]
    # the likelihood's gain: a short overlap that looks alike by chance does not win
    score = -0.5 * overlap * np.log(1 - np.clip(alike, 0.0, 0.999))
    shifts = lags * step + a_t[0] - b_t[0]
    allowed = overlap >= _OVERLAP * min(len(a), len(b))
    if not allowed.any() or not np.any(score[allowed] > 0):
        return None
    return float(shifts[allowed][np.argmax(score[allowed])])


def _normal(channels: Array) -> Array:
    spread = np.std(channels, axis=0)
    return channels[:, spread > 0] / spread[spread > 0]
