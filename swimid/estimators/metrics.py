"""How far a simulation is from a measurement."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from swimid.models.base import Array


@dataclass(frozen=True)
class Score:
    """Error of one channel.

    Attributes
    ----------
    rmse : float
        Root-mean-square error, in the channel's unit.
    nrmse : float
        RMSE over the measured range (maximum minus minimum).
    vaf : float
        Variance accounted for, ``1 - var(error) / var(measured)``.
    fit_percent : float
        ``100 (1 - |error| / |measured - mean|)``, as MATLAB's ``compare`` prints it.
    bias : float
        Mean error, measured minus simulated.
    samples : int
    """

    rmse: float
    nrmse: float
    vaf: float
    fit_percent: float
    bias: float
    samples: int

    def as_dict(self, unit: str) -> dict[str, Any]:
        """The score as a parameter file holds it."""
        return {**asdict(self), "unit": unit}


def score(measured: Array, simulated: Array) -> Score:
    """Compare two series, leaving out samples missing in either.

    Parameters
    ----------
    measured, simulated : ndarray, shape (n,)

    Returns
    -------
    Score
        NaN where nothing can be compared.

    >>> score(np.array([0.0, 1.0, 2.0]), np.array([0.0, 1.0, 2.0])).fit_percent
    100.0
    """
    there = np.isfinite(measured) & np.isfinite(simulated)
    y, e = measured[there], (measured - simulated)[there]
    if len(y) == 0:
        return Score(np.nan, np.nan, np.nan, np.nan, np.nan, 0)
    rmse = float(np.sqrt(np.mean(e**2)))
    span, variance = float(np.ptp(y)), float(np.var(y))
    return Score(
        rmse=rmse,
        nrmse=rmse / span if span > 0 else np.nan,
        vaf=1.0 - float(np.var(e)) / variance if variance > 0 else np.nan,
        fit_percent=100.0 * (1.0 - rmse / math.sqrt(variance)) if variance > 0 else np.nan,
        bias=float(np.mean(e)),
        samples=len(y),
    )
