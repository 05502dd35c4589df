"""Whiten residuals: coloured measurement noise and between-trial random effects.

A likelihood of white noise gives far too small uncertainties. Residuals are therefore weighted by the
standard deviation of the noise of each sample, and then whitened by an autoregression of each channel. Random
effects are per-trial parameters. Every fit estimates them, with the between-trial standard deviation as
prior.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.linalg import solve_toeplitz
from scipy.sparse import block_diag, coo_array, csr_array

from swimid.diagnosis.random_effects import RandomEffect
from swimid.fitting.model import Array
from swimid.fitting.problem import Problem
from swimid.fitting.uncertainty import fit_autoregression, joined

#: Autoregression of the noise: maximum order (ORDER), and minimum number of samples per coefficient
#: (PER_ORDER).
ORDER, PER_ORDER = 6, 25
#: Short-memory noise: fraction of the variance that is correlated in time, and correlation of that part
#: between successive samples.
COLOURED, POLE = 0.4, 0.8
#: Excess of the mean square of residuals over that of the rounding error, in standard errors, above which the
#: residuals are not only rounding (two standard errors: 95 %).
ROUNDED = 2.0


@dataclass(frozen=True)
class NoiseModel:
    """Linear map from the weighted residuals of each trial to independent residuals of unit variance.

    Attributes
    ----------
    sd : list of list of ndarray
        Standard deviation of each sample, by trial and channel (:attr:`Problem.sd`).
    colour : mapping of channel to ndarray
        Coefficients of the autoregression of the weighted residuals.
    size : mapping of channel to float
        Standard deviation of the innovations of the autoregression.
    whole : mapping of channel to float
        Standard deviation of the weighted residuals. It whitens samples without a predecessor.
    random_effects : tuple of RandomEffect
        Random effects of the trials.
    rounding : mapping of channel to float
        Standard deviation of the weighted rounding error, for channels recorded by a counter of known step.
    long_memory : NoiseModel or None
        Noise model in which low-frequency residuals count as noise. It is set only if there are too few
        trials to separate low-frequency noise from a gap.
    """

    sd: list[list[Array]]
    colour: Mapping[str, Array] = field(default_factory=dict)
    size: Mapping[str, float] = field(default_factory=dict)
    whole: Mapping[str, float] = field(default_factory=dict)
    random_effects: tuple[RandomEffect, ...] = ()
    rounding: Mapping[str, float] = field(default_factory=dict)
    long_memory: NoiseModel | None = None
    _whitening: dict[tuple[object, ...], csr_array] = field(
        init=False, repr=False, compare=False, default_factory=dict
    )

    def install(self, problem: Problem) -> None:
        """Set the weights of a problem with the same trials to those of this noise model."""
        problem.sd = [list(sds) for sds in self.sd]

    def whiten(self, problem: Problem, k: int, rows: Array) -> Array:
        """Return the whitened residuals, or columns of derivatives, of trial ``k``.

        Parameters
        ----------
        rows : ndarray, shape (n_k,) or (n_k, m)
            Weighted residuals or derivatives.
        """
        channels, masks = problem.channels[k], problem.masks[k]
        key: tuple[object, ...] = (*channels, *(mask.tobytes() for mask in masks))
        if key not in self._whitening:
            blocks = [self._whitened(channel, mask) for channel, mask in zip(channels, masks, strict=True)]
            self._whitening[key] = block_diag(blocks, format="csr") if blocks else csr_array((0, 0))
        return np.asarray(self._whitening[key] @ rows)

    def _whitened(self, channel: str, mask: Array) -> coo_array:
        """Return the whitening matrix of one channel's weighted residuals, shape (n, n)."""
        a, count = self.colour.get(channel, np.empty(0)), int(np.sum(mask))
        taps = np.concatenate(([1.0], a)) / self.size.get(channel, 1.0)
        lags, first = np.arange(len(taps)), 1.0 / self.whole.get(channel, 1.0)
        # Find the segments without a missing sample. The first sample of a segment has no predecessor, and
        # the next samples have fewer predecessors than the order of the autoregression.
        begin = np.concatenate(([0], np.flatnonzero(np.diff(np.flatnonzero(mask)) > 1) + 1))[:count]
        past = np.arange(count) - np.repeat(begin, np.diff([*begin, count]))
        whole = np.flatnonzero(past >= len(a))
        rows, columns = np.repeat(whole, len(taps)), (whole[:, None] - lags).ravel()
        values = np.tile(taps, len(whole))
        if len(a):
            rows, columns = (np.concatenate((places, begin)) for places in (rows, columns))
            values = np.concatenate((values, np.full(len(begin), first)))
        return coo_array((values, (rows, columns)), shape=(count, count))


def coloured(
    problem: Problem, residuals: Sequence[Array], noise_model: NoiseModel, *, unknowns: float = 0.0
) -> NoiseModel:
    """Estimate the autoregressions and the standard deviations of a noise model from weighted residuals.

    Parameters
    ----------
    residuals : sequence of ndarray
        Residuals of each trial, weighted by ``sd`` of the noise model.
    unknowns : float
        Number of fitted parameters, subtracted from the degrees of freedom.
    """
    total = sum(len(r) for r in residuals)
    freedom = max(1.0 - unknowns / max(total, 1), 0.2)
    colour, size, whole = {}, {}, {}
    for channel, series_list in problem.series(residuals).items():
        x = joined(series_list, gap=ORDER + 1)
        n = int(np.isfinite(x).sum())
        longest = max(int(np.isfinite(s).sum()) for s in series_list)
        order = min(ORDER, longest // PER_ORDER)
        squared = variance = float(np.nanmean(x**2))
        colour[channel] = np.empty(0)
        if order >= 1 and n > 3 * PER_ORDER and np.nanvar(x) > 0:
            fitted = fit_autoregression(x, max_order=order)
            colour[channel], variance = fitted.coefficients, fitted.variance
        size[channel] = float(np.sqrt(max(variance / freedom, 1e-300)))
        whole[channel] = float(np.sqrt(max(squared / freedom, 1e-300)))
    return replace(noise_model, colour=colour, size=size, whole=whole)


def brief(
    noise_model: NoiseModel, problem: Problem, residuals: Sequence[Array], channels: Sequence[str]
) -> NoiseModel:
    """Return a copy of the noise model with short-memory noise in the given channels.

    Low-frequency residuals of these channels then do not count as noise.

    The noise level is estimated from second differences of the residuals, to which low frequencies contribute
    little. A fraction `COLOURED` of the noise variance is correlated over a few samples (`POLE`), as in a
    tracker. If the residuals of a rounded record are no larger than the rounding error, they count as
    rounding, however slow they are.
    """
    colour, size, whole = dict(noise_model.colour), dict(noise_model.size), dict(noise_model.whole)
    lags = COLOURED * POLE ** np.arange(ORDER + 1.0)
    lags[0] = 1.0
    a = -solve_toeplitz(lags[:-1], lags[1:])
    innovation = float(1.0 + a @ lags[1:])
    known = problem.series(residuals)
    for channel in channels:
        bend = np.concatenate([np.diff(series, 2) for series in known[channel]])
        bend = bend[np.isfinite(bend)]
        if len(bend) < PER_ORDER:
            continue
        left = np.concatenate(known[channel])
        left = left[np.isfinite(left)]
        rounding = noise_model.rounding.get(channel, 0.0) ** 2
        if np.mean(left**2) <= rounding * (1.0 + ROUNDED * np.sqrt(2.0 / len(left))):
            continue
        variance = float(np.mean(bend**2)) / (6.0 - 8.0 * lags[1] + 2.0 * lags[2])
        variance = max(variance, rounding, 1e-300)
        colour[channel], size[channel] = a, float(np.sqrt(innovation * variance))
        whole[channel] = float(np.sqrt(variance))
    return replace(noise_model, colour=colour, size=size, whole=whole)
