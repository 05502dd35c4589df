"""Dynamic time warping within a band, compiled."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray


@numba.njit(cache=True, nogil=True)
def warping_cost(a: NDArray[np.float64], b: NDArray[np.float64], band: int) -> float:
    """Return the least sum of squared distances along a warping path, shape (n, d) both.

    Two rows of the cost matrix are kept; in each the path may lie ``band`` cells off the diagonal at most
    (Sakoe and Chiba, 1978).
    """
    n = len(a)
    before = np.full(n + 1, np.inf)
    before[0] = 0.0
    for i in range(1, n + 1):
        row = np.full(n + 1, np.inf)
        for j in range(max(1, i - band), min(n, i + band) + 1):
            squares = 0.0
            for k in range(a.shape[1]):
                squares += (a[i - 1, k] - b[j - 1, k]) ** 2
            row[j] = squares + min(before[j], row[j - 1], before[j - 1])
        before = row
    return float(before[n])


def warm_up() -> None:
    """Compile the kernel of this module."""
    warping_cost(np.zeros((2, 1)), np.ones((2, 1)), 1)
