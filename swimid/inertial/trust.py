"""How far an integrated path can be trusted, and from when on it cannot."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from swimid.inertial.record import Array

#: The 95 % band may be this wide, m, or this share of the distance travelled, whichever is more.
WIDTH_M, SHARE = 0.1, 0.1
BAND = 1.96


@dataclass(frozen=True)
class Trust:
    """When the band of a position leaves the limit.

    Attributes
    ----------
    until_s : float or None
        Time on the log's clock; None where it never does.
    seconds : float or None
        The same, counted from the end of the rest the log starts with (or from its start).
    widest_m : float
        Largest half-width of the 95 % band of the horizontal position.
    """

    until_s: float | None
    seconds: float | None
    widest_m: float


def horizon(time_s: Array, position: Array, position_sd: Array, moving_from_s: float) -> Trust:
    """When the horizontal 95 % band first exceeds 0.1 m and 10 % of the distance travelled.

    Parameters
    ----------
    position, position_sd : ndarray, shape (n, 3)
        Missing (NaN) counts as not to be trusted.
    moving_from_s : float
        End of the rest at the start.
    """
    half = BAND * np.max(position_sd[:, :2], axis=1)
    travelled = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(position[:, :2], axis=0).T))])
    within = half <= np.maximum(WIDTH_M, SHARE * travelled)
    beyond = np.flatnonzero(~within)
    widest = float(np.nanmax(half)) if np.isfinite(half).any() else np.inf
    if not len(beyond):
        return Trust(None, None, widest)
    until = float(time_s[beyond[0]])
    return Trust(until, max(until - moving_from_s, 0.0), widest)
