"""Whiten residuals: coloured measurement noise and between-trial random effects.

White-noise likelihoods give far too small uncertainties. Residuals are first weighted by the noise of each
sample, then whitened by an autoregression of each channel. Random effects are parameters of each trial that
every fit estimates, with the between-trial standard deviation as prior.
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

#: Maximum order of the autoregression, and minimum number of samples for each coefficient.
ORDER, PER_ORDER = 6, 25
#: Noise of short memory: correlated share of its variance, and correlation from sample to sample.
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
        Standard deviation of the weighted residuals, used for samples without a past.
    random_effects : tuple of RandomEffect
        Random effects of the trials.
    rounding : mapping of channel to float
        Standard deviation of the weighted rounding error, of channels read by a counter of known step.
    long_memory : NoiseModel or None
        The same with noise of long memory, if the trials are too few to decide.
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
        """Give a problem of the same trials the weights of this noise."""
        problem.sd = [[sd.copy() for sd in sds] for sds in self.sd]

    def whiten(self, problem: Problem, k: int, rows: Array) -> Array:
        """Return weighted residuals of trial ``k``, or columns of derivatives, whitened.

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
        """Return the whitening matrix of one channel's weighted residuals, shape (n, n)."""
        a, count = self.colour.get(channel, np.empty(0)), int(np.sum(mask))
        taps = np.concatenate(([1.0], a)) / self.size.get(channel, 1.0)
        lags, first = np.arange(len(taps)), 1.0 / self.whole.get(channel, 1.0)
        # Stretches without a missing sample. The first sample of each has no past, the next ones a short one.
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
    """Return the noise model with autoregressions and sizes estimated from weighted residuals.

    Parameters
    ----------
    residuals : sequence of ndarray
        Of each trial, weighted by the noise model's ``sd``.
    unknowns : float
        Number of fitted parameters, for the degrees of freedom.
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
    """Return the noise model with noise of short memory in some channels: slower motion there is not noise.

    Its size is that of the second differences, to which slow motion adds little. A share of its variance,
    `COLOURED`, is correlated over a few samples (`POLE`), as in a tracker. Residuals of a rounded record that
    are no larger than the rounding error are rounding, however slowly they move.
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
