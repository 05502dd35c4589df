"""Residuals in units of the noise: coloured measurement noise and chance differences between trials.

White-noise likelihoods are absurdly sure of themselves: residuals are first weighted by the size of the
noise of each sample, then whitened by an autoregression of each channel, then by the covariance that
random trims, gains and clocks of single trials add (a low-rank, Woodbury, whitening).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.linalg import solve_toeplitz
from scipy.signal import lfilter

from swimid.estimators.problem import Problem
from swimid.estimators.residual_tests import fit_autoregression, joined
from swimid.models.base import Array

#: Largest order of the autoregression, and samples each coefficient needs.
ORDER, PER_ORDER = 6, 25
#: Noise of short memory: share of its variance with a memory, and that memory from sample to sample.
COLOURED, POLE = 0.4, 0.8
#: Fewest trials that tell a spread, and how far it must exceed the sampling error of one trial.
FEWEST, CLEAR = 3, 2.0
#: Chance differences are at most this large, in typical sizes: beyond, they are an effect.
CHANCE = 0.5


@dataclass(frozen=True)
class Lens:
    """A linear map of each trial's weighted residuals to independent ones of unit variance.

    Attributes
    ----------
    sd : list of list of ndarray
        By trial and channel, standard deviation of each sample (:attr:`Problem.sd`).
    colour : mapping of channel to ndarray
        Autoregression of the weighted residuals.
    size : mapping of channel to float
        Standard deviation of its innovations.
    whole : mapping of channel to float
        Standard deviation of the weighted residuals themselves, that of a sample without a past.
    spread : list of (ndarray, ndarray) or None
        By trial: directions (n_k, q), orthonormal, in which chance differences of that trial act, and the
        factor by which they are reduced.
    """

    sd: list[list[Array]]
    colour: Mapping[str, Array] = field(default_factory=dict)
    size: Mapping[str, float] = field(default_factory=dict)
    whole: Mapping[str, float] = field(default_factory=dict)
    spread: Sequence[tuple[Array, Array] | None] = ()

    def install(self, problem: Problem) -> None:
        """Give a problem of the same trials this noise's weights."""
        problem.sd = [[sd.copy() for sd in sds] for sds in self.sd]

    def through(self, problem: Problem, k: int, rows: Array) -> Array:
        """Weighted residuals of trial ``k``, or columns of derivatives, as the lens shows them.

        Parameters
        ----------
        rows : ndarray, shape (n_k,) or (n_k, m)
        """
        found = np.array(rows, dtype=float)
        at = 0
        for channel, mask in zip(problem.channels[k], problem.masks[k], strict=True):
            count = int(mask.sum())
            part = slice(at, at + count)
            found[part] = self._coloured(channel, mask, found[part])
            at += count
        if self.spread and self.spread[k] is not None:
            directions, less = self.spread[k]  # type: ignore[misc]
            inside = directions.T @ found
            found = found - directions @ ((less[:, None] if found.ndim > 1 else less) * inside)
        return found

    def _coloured(self, channel: str, mask: Array, rows: Array) -> Array:
        a = self.colour.get(channel, np.empty(0))
        size = self.size.get(channel, 1.0)
        if not len(a):
            return rows / size
        result = np.empty_like(rows)
        # stretches without a missing sample; the first sample of each has no past, the next too little
        at = np.flatnonzero(mask)
        for part in np.split(np.arange(len(at)), np.flatnonzero(np.diff(at) > 1) + 1):
            if not len(part):
                continue
            result[part] = lfilter(np.concatenate(([1.0], a)), [1.0], rows[part], axis=0) / size
            result[part[: len(a)]] = 0.0
            result[part[0]] = rows[part[0]] / self.whole.get(channel, 1.0)
        return result


def _series(problem: Problem, residuals: Sequence[Array]) -> dict[str, list[Array]]:
    """Weighted residuals of each channel, one series a trial that has it; NaN where a sample is missing."""
    found: dict[str, list[Array]] = {}
    for k, values in enumerate(residuals):
        at = 0
        for channel, mask in zip(problem.channels[k], problem.masks[k], strict=True):
            count = int(mask.sum())
            series = np.full(len(mask), np.nan)
            series[mask] = values[at : at + count]
            at += count
            found.setdefault(channel, []).append(series)
    return found


def coloured(problem: Problem, residuals: Sequence[Array], lens: Lens, *, unknowns: int = 0) -> Lens:
    """The lens with autoregressions and sizes as the weighted residuals show them.

    Parameters
    ----------
    residuals : sequence of ndarray
        Of each trial, weighted by the lens's ``sd``.
    unknowns : int
        Numbers fitted to them, for the degrees of freedom.
    """
    total = sum(len(r) for r in residuals)
    freedom = max(1.0 - unknowns / max(total, 1), 0.2)
    colour, size, whole = {}, {}, {}
    for channel, series_list in _series(problem, residuals).items():
        x = joined(series_list, gap=ORDER + 1)
        n = int(np.isfinite(x).sum())
        longest = max(int(np.isfinite(s).sum()) for s in series_list)
        order = min(ORDER, longest // PER_ORDER)
        centred = x - np.nanmean(x) if n else x
        variance = float(np.nanmean(centred**2)) if n else 1.0
        a = np.empty(0)
        if order >= 1 and n > 3 * PER_ORDER and variance > 0:
            fitted = fit_autoregression(x, max_order=order)
            a, variance = fitted.coefficients, fitted.variance
        else:
            variance = float(np.nanmean(x**2)) if n else 1.0
        colour[channel] = a
        size[channel] = float(np.sqrt(max(variance / freedom, 1e-300)))
        whole[channel] = float(np.sqrt(max(np.nanmean(x**2) / freedom, 1e-300))) if n else 1.0
    return Lens(lens.sd, colour, size, whole, lens.spread)


def brief(lens: Lens, problem: Problem, residuals: Sequence[Array], channels: Sequence[str]) -> Lens:
    """The lens with noise of short memory in some channels: what moves slower there is no noise.

    Its size is that of the second differences, to which slow motion adds little; a part of it, `COLOURED`,
    has a memory of a few samples (`POLE`), as a tracker's has.
    """
    colour, size, whole = dict(lens.colour), dict(lens.size), dict(lens.whole)
    lags = COLOURED * POLE ** np.arange(ORDER + 1.0)
    lags[0] = 1.0
    a = -solve_toeplitz(lags[:-1], lags[1:])
    innovation = float(1.0 + a @ lags[1:])
    known = _series(problem, residuals)
    for channel in channels:
        bend = np.concatenate([np.diff(series, 2) for series in known[channel]])
        bend = bend[np.isfinite(bend)]
        if len(bend) < PER_ORDER:
            continue
        variance = max(float(np.mean(bend**2)) / (6.0 - 8.0 * lags[1] + 2.0 * lags[2]), 1e-300)
        colour[channel], size[channel] = a, float(np.sqrt(innovation * variance))
        whole[channel] = float(np.sqrt(variance))
    return Lens(lens.sd, colour, size, whole, lens.spread)


def spread(
    lens: Lens,
    problem: Problem,
    residuals: Sequence[Array],
    own: Sequence[Array],
    chance: Sequence[Array],
    *,
    used: int = 0,
) -> tuple[Lens, Array]:
    """The lens with the chance differences between trials, as the trials show them.

    Parameters
    ----------
    residuals : sequence of ndarray, shape (n_k,)
        Weighted.
    own : sequence of ndarray, shape (n_k, m)
        Weighted derivatives to the trial's own start state, which is estimated.
    chance : sequence of ndarray, shape (n_k, q)
        Weighted derivatives to what may differ by chance, each per its typical size.
    used : int
        Numbers common to all trials that were fitted to the residuals and may have taken such differences up.

    Returns
    -------
    lens : Lens
    sd : ndarray, shape (q,)
        Of each kind of difference, in its typical size: the variance of the trials' own least-squares
        estimates, robustly, less its sampling variance. The lens has at most `CHANCE` of it.
    """
    q = chance[0].shape[1] if len(chance) else 0
    sd = np.zeros(q)
    best = Lens(lens.sd, lens.colour, lens.size, lens.whole)
    if len(residuals) < FEWEST:
        return best, sd
    left = list(range(q))
    while left:
        # one kind at a time, the clearest first: together they are too much alike to be told apart
        seen = [
            best.through(problem, k, np.column_stack((chance[k][:, left], own[k], r)))
            for k, r in enumerate(residuals)
        ]
        found = [_variance(seen, i, len(left), used) for i in range(len(left))]
        i = int(np.argmax([clear for _, clear in found]))
        variance, clear = found[i]
        if variance <= 0.0 or clear <= CLEAR:
            break
        sd[left.pop(i)] = float(np.sqrt(variance))
        best = replace(best, spread=_directions(best, problem, chance, np.minimum(sd, CHANCE)))
    return best, sd


def _variance(seen: Sequence[Array], i: int, kinds: int, used: int) -> tuple[float, float]:
    """Variance of one kind of difference between trials, and how clear it is: its ratio to the sampling's."""
    estimates, errors = [], []
    for block in seen:
        z, starts, r = block[:, i], block[:, kinds:-1], block[:, -1]
        if starts.shape[1]:
            both = np.column_stack((z, r))
            normal = starts.T @ starts
            normal[np.diag_indices(len(normal))] += 1e-10 * np.trace(normal) + 1e-300
            both = both - starts @ np.linalg.solve(normal, starts.T @ both)
            z, r = both[:, 0], both[:, 1]
        size = float(z @ z)
        if size > 1e-9:
            estimates.append(float(z @ r) / size)
            errors.append(1.0 / size)
    n = len(estimates)
    if n < FEWEST:
        return 0.0, 0.0
    b, c = np.array(estimates), np.array(errors)
    # median absolute deviation against the standard deviation: one odd trial is not the rule
    robust = (1.4826 * float(np.median(np.abs(b - np.median(b)))) * (1.0 + 0.8 / n)) ** 2
    spread = min(max(robust, 0.0), float(np.var(b, ddof=1))) * (n - 1) / max(n - 1 - used, 1)
    typical = float(np.median(c))
    return spread - typical, spread / typical


def _directions(
    lens: Lens, problem: Problem, chance: Sequence[Array], sd: Array
) -> list[tuple[Array, Array] | None]:
    """Of each trial, the directions of chance differences and the factors by which they are reduced."""
    plain = Lens(lens.sd, lens.colour, lens.size, lens.whole)
    found: list[tuple[Array, Array] | None] = []
    for k, columns in enumerate(chance):
        seen = plain.through(problem, k, columns[:, sd > 0]) * sd[sd > 0]
        if not np.any(seen):
            found.append(None)
            continue
        u, s, _ = np.linalg.svd(seen, full_matrices=False)
        found.append((u, 1.0 - 1.0 / np.sqrt(1.0 + s**2)))
    return found
