"""The rate of change of a sampled signal, smoothed no more than is said."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
#: Samples a window needs for a cubic and something left over.
MIN_SAMPLES = 6


def slope(time_s: Array, values: Array, half_width_s: float) -> Array:
    """Derivative by a cubic fitted to the samples around each instant.

    Parameters
    ----------
    time_s, values : ndarray, shape (n,)
        Uneven steps and NaN are allowed.
    half_width_s : float
        Samples this far on either side are fitted; a window with too few of them takes in as many
        more on each side as it needs.

    Returns
    -------
    ndarray, shape (n,)
        NaN within half a window of the ends, and where a gap leaves no samples on one side.

    Notes
    -----
    Savitzky and Golay (1964) for any sampling. A sine of frequency f passes with a gain of
    ``1 - (2 pi f h)^4 / 504`` to leading order, h the half width.

    >>> t = np.linspace(0.0, 1.0, 101)
    >>> float(np.round(slope(t, t**3, 0.05)[50], 9))
    0.75
    """
    there = np.flatnonzero(np.isfinite(values))
    t, x = time_s[there], values[there]
    rates = np.full(len(time_s), np.nan)
    if len(t) < MIN_SAMPLES:
        return rates
    half = max(half_width_s, 0.5 * MIN_SAMPLES * float(np.median(np.diff(t))))
    first = np.searchsorted(t, time_s - half * (1 + 1e-9))
    last = np.searchsorted(t, time_s + half * (1 + 1e-9), side="right")
    inside = (time_s >= t[0] + half * (1 - 1e-9)) & (time_s <= t[-1] - half * (1 - 1e-9))
    for i in np.flatnonzero(inside & (last - first >= MIN_SAMPLES)):
        near = (t[first[i] : last[i]] - time_s[i]) / half
        if near[0] > -0.3 or near[-1] < 0.3:
            continue
        weights = np.linalg.lstsq(np.vander(near, 4, increasing=True), x[first[i] : last[i]], rcond=None)[0]
        rates[i] = weights[1] / half
    return rates
