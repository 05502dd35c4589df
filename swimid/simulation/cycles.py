"""Measured against simulated, stroke by stroke and over the stroke's phase."""

from __future__ import annotations

import numpy as np

from swimid.fitting.model import Array
from swimid.simulation.comparison_file import CycleTable, PhaseTable

#: A stroke counts with at least so many samples, and this share of what a full one has.
FEWEST_SAMPLES, WHOLE = 4, 0.95
#: Bins of the stroke's phase.
BINS = 12


def cycles(time_s: Array, measured: Array, simulated: Array, *, frequency_hz: float) -> CycleTable:
    """Means and largest magnitudes of every whole stroke, over the samples both series have.

    Parameters
    ----------
    time_s, measured, simulated : ndarray, shape (n,)
    frequency_hz : float
        Strokes are counted from time zero, where the drive starts.

    Returns
    -------
    CycleTable
        Times are the middles of the strokes; a stroke with too few samples has no values.
    """
    both = np.isfinite(measured) & np.isfinite(simulated)
    number = np.floor(time_s * frequency_hz + 1e-9).astype(int)
    step = float(np.median(np.diff(time_s)))
    needed = max(FEWEST_SAMPLES, WHOLE / (frequency_hz * step))
    strokes = np.arange(number[0], number[-1] + 1)
    rows = np.full((4, len(strokes)), np.nan)
    for j, k in enumerate(strokes):
        mine = both & (number == k)
        if mine.sum() < needed:
            continue
        y, z = measured[mine], simulated[mine]
        rows[:, j] = y.mean(), z.mean(), np.abs(y).max(), np.abs(z).max()
    # a stroke that an end of the record cuts is none; one with a gap stays, as NaN
    whole = np.flatnonzero(np.isfinite(rows).all(axis=0))
    kept = slice(whole[0], whole[-1] + 1) if len(whole) else slice(0, 0)
    names = ("mean_measured", "mean_simulated", "peak_measured", "peak_simulated")
    columns = dict(zip(names, rows[:, kept], strict=True))
    return CycleTable.model_validate({"time_s": (strokes[kept] + 0.5) / frequency_hz, **columns})


def phases(time_s: Array, measured: Array, simulated: Array, *, frequency_hz: float) -> PhaseTable:
    """Mean of measured minus simulated in :data:`BINS` parts of the stroke.

    Parameters
    ----------
    time_s, measured, simulated : ndarray, shape (n,)
    frequency_hz : float

    Returns
    -------
    PhaseTable
        Phases are the middles of the parts, zero where the drive's command starts; standard errors are from
        the spread between strokes.
    """
    residual = measured - simulated
    there = np.isfinite(residual)
    turns = time_s * frequency_hz
    part = np.floor(np.mod(turns, 1.0) * BINS).astype(int) % BINS
    stroke = np.floor(turns).astype(int)
    mean, error = np.full(BINS, np.nan), np.full(BINS, np.nan)
    for k in range(BINS):
        mine = there & (part == k)
        if not mine.any():
            continue
        # samples of one stroke are not independent: one mean for each
        each = [residual[mine & (stroke == s)].mean() for s in np.unique(stroke[mine])]
        mean[k] = float(np.mean(each))
        if len(each) > 1:
            error[k] = float(np.std(each, ddof=1)) / np.sqrt(len(each))
    phase = 2 * np.pi * (np.arange(BINS) + 0.5) / BINS
    return PhaseTable.model_validate({"phase_rad": phase, "residual": mean, "stderr": error})
