"""Residuals in units of the noise: coloured measurement noise and random effects of trials.

White-noise likelihoods are absurdly sure of themselves: residuals are first weighted by the size of the
noise of each sample, then whitened by an autoregression of each channel. What differs between trials by
chance are numbers of each trial that every fit estimates, with the spread the trials show as their prior.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.linalg import solve_toeplitz
from scipy.sparse import block_diag, coo_array, csr_array

from swimid.diagnosis.random_effects import RandomEffect
from swimid.fitting.model import Array
from swimid.fitting.noise import fit_autoregression, joined
from swimid.fitting.problem import Problem

#: Largest order of the autoregression, and samples each coefficient needs.
ORDER, PER_ORDER = 6, 25
#: Noise of short memory: share of its variance with a memory, and that memory from sample to sample.
COLOURED, POLE = 0.4, 0.8
#: A mean square this many of its standard errors above that of rounding (two: 95 %) is more than rounding.
ROUNDED = 2.0


@dataclass(frozen=True)
class NoiseModel:
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
    random_effects : tuple of RandomEffect
        What differs from trial to trial.
    rounding : mapping of channel to float
        Standard deviation of the weighted rounding error, of channels read by a counter of known step.
    long_memory : NoiseModel or None
        The same with noise of long memory, where trials are too few to tell which it is.
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
        """Give a problem of the same trials this noise's weights."""
        problem.sd = [[sd.copy() for sd in sds] for sds in self.sd]

    def whiten(self, problem: Problem, k: int, rows: Array) -> Array:
        """Weighted residuals of trial ``k``, or columns of derivatives, whitened.

        Parameters
        ----------
        rows : ndarray, shape (n_k,) or (n_k, m)
        """
        channels, masks = problem.channels[k], problem.masks[k]
        key: tuple[object, ...] = (*channels, *(mask.tobytes() for mask in masks))
        if key not in self._whitening:
            blocks = [self._whitened(channel, mask) for channel, mask in zip(channels, masks, strict=True)]
            self._whitening[key] = block_diag(blocks, format="csr") if blocks else csr_array((0, 0))
        return np.asarray(self._whitening[key] @ rows)

    def _whitened(self, channel: str, mask: Array) -> coo_array:
        """The map of one channel's weighted residuals, shape (n, n)."""
        a, count = self.colour.get(channel, np.empty(0)), int(np.sum(mask))
        taps = np.concatenate(([1.0], a)) / self.size.get(channel, 1.0)
        lags, first = np.arange(len(taps)), 1.0 / self.whole.get(channel, 1.0)
        # stretches without a missing sample; the first sample of each has no past, the next too little
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
    """The noise model with autoregressions and sizes as the weighted residuals show them.

    Parameters
    ----------
    residuals : sequence of ndarray
        Of each trial, weighted by the noise model's ``sd``.
    unknowns : float
        Numbers fitted to them, for the degrees of freedom.
    """
    total = sum(len(r) for r in residuals)
    freedom = max(1.0 - unknowns / max(total, 1), 0.2)
    colour, size, whole = {}, {}, {}
    for channel, series_list in problem.series(residuals).items():
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
    return replace(noise_model, colour=colour, size=size, whole=whole)


def brief(
    noise_model: NoiseModel, problem: Problem, residuals: Sequence[Array], channels: Sequence[str]
) -> NoiseModel:
    """The noise model with noise of short memory in some channels: what moves slower there is no noise.

    Its size is that of the second differences, to which slow motion adds little; a part of it, `COLOURED`,
    has a memory of a few samples (`POLE`), as a tracker's has. What is left of a rounded record and no larger
    than its rounding error is that, however slowly it moves: the error of a slow body is slow.
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
