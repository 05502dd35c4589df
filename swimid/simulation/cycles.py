"""Measured against simulated, stroke by stroke and over the stroke's phase."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from swimid.fitting.model import Array

#: A stroke counts with at least so many samples, and this share of what a full one has.
FEWEST, SHARE = 4, 0.95
#: Bins of the stroke's phase.
BINS = 12


@dataclass(frozen=True)
class Cycles:
    """Every whole stroke of a channel.

    Attributes
    ----------
    time_s : ndarray, shape (k,)
        Middle of each stroke.
    mean_measured, mean_simulated, peak_measured, peak_simulated : ndarray, shape (k,)
        Means, and largest magnitudes; NaN for a stroke with too few samples.
    """

    time_s: Array
    mean_measured: Array
    mean_simulated: Array
    peak_measured: Array
    peak_simulated: Array


@dataclass(frozen=True)
class Phases:
    """Residual over the phase of the stroke.

    Attributes
    ----------
    phase_rad : ndarray, shape (bins,)
        Middle of each bin; zero is where the drive's command starts.
    residual, stderr : ndarray, shape (bins,)
        Mean of measured minus simulated, and its standard error from the spread between strokes.
    """

    phase_rad: Array
    residual: Array
    stderr: Array


def cycles(time_s: Array, measured: Array, simulated: Array, *, frequency_hz: float) -> Cycles:
    """Means and peaks of every whole stroke, over the samples both series have.

    Parameters
    ----------
    time_s, measured, simulated : ndarray, shape (n,)
    frequency_hz : float
        Strokes are counted from time zero, where the drive starts.
    """
    both = np.isfinite(measured) & np.isfinite(simulated)
    number = np.floor(time_s * frequency_hz + 1e-9).astype(int)
    step = float(np.median(np.diff(time_s)))
    needed = max(FEWEST, SHARE / (frequency_hz * step))
    which = np.arange(number[0], number[-1] + 1)
    rows = np.full((4, len(which)), np.nan)
    for j, k in enumerate(which):
        mine = both & (number == k)
        if mine.sum() < needed:
            continue
        y, z = measured[mine], simulated[mine]
        rows[:, j] = y.mean(), z.mean(), np.abs(y).max(), np.abs(z).max()
    # a stroke that an end of the record cuts is none; one with a gap stays, as NaN
    whole = np.flatnonzero(np.isfinite(rows).all(axis=0))
    kept = slice(whole[0], whole[-1] + 1) if len(whole) else slice(0, 0)
    return Cycles((which[kept] + 0.5) / frequency_hz, *rows[:, kept])


def phases(
    time_s: Array, measured: Array, simulated: Array, *, frequency_hz: float, bins: int = BINS
) -> Phases:
    """Mean residual in each part of the stroke.

    Parameters
    ----------
    time_s, measured, simulated : ndarray, shape (n,)
    frequency_hz : float
    bins : int
    """
    residual = measured - simulated
    there = np.isfinite(residual)
    turns = time_s * frequency_hz
    part = np.floor(np.mod(turns, 1.0) * bins).astype(int) % bins
    stroke = np.floor(turns).astype(int)
    mean, error = np.full(bins, np.nan), np.full(bins, np.nan)
    for k in range(bins):
        mine = there & (part == k)
        if not mine.any():
            continue
        # samples of one stroke are not independent: one mean for each
        each = [residual[mine & (stroke == s)].mean() for s in np.unique(stroke[mine])]
        mean[k] = float(np.mean(each))
        if len(each) > 1:
            error[k] = float(np.std(each, ddof=1)) / np.sqrt(len(each))
    return Phases(2 * np.pi * (np.arange(bins) + 0.5) / bins, mean, error)
