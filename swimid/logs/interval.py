"""A number with its 95 % interval, and that of a mean over time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats

Array = NDArray[np.float64]
#: Blocks whose means tell how sure the mean of all is.
BLOCKS = 12


@dataclass(frozen=True)
class Estimate:
    """A value with its 95 % interval, in one unit; NaN ends where nothing tells how sure it is."""

    value: float
    low: float
    high: float


def mean_of_blocks(values: Array, weights: Array, shift: float = 0.0) -> Estimate:
    """Weighted mean with Student's interval over the means of :data:`BLOCKS` blocks of equal weight.

    Parameters
    ----------
    values, weights : ndarray, shape (n,)
        In the order of time; ``weights`` the time each value stands for, not all 0.
    shift : float
        A correction of the mean, as uncertain as it is large.
    """
    value = float(weights @ values / weights.sum())
    block = np.minimum((np.cumsum(weights) - 0.5 * weights) / weights.sum() * BLOCKS, BLOCKS - 1).astype(int)
    totals = np.bincount(block, weights, BLOCKS)
    held = totals > 0
    means = np.bincount(block, weights * values, BLOCKS)[held] / totals[held]
    half = 0.0  # of the block means; what noise adds is as uncertain as it is large
    if len(means) > 1:
        # neighbouring blocks are not independent: their correlation widens the interval
        off = means - means.mean()
        together = float(off[1:] @ off[:-1] / max(float(off @ off), 1e-300))
        widen = np.sqrt((1 + max(together, 0.0)) / (1 - min(max(together, 0.0), 0.8)))
        half = float(stats.t.ppf(0.975, len(means) - 1) * means.std(ddof=1) / np.sqrt(len(means)) * widen)
    half = float(np.hypot(half, shift))
    return Estimate(value + shift, value + shift - half, value + shift + half)
