"""Values that are unusual in the stated unit.

The unit is believed all the same: magnitudes check what is stated, and infer nothing.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
#: The fastest swimming: cavitation and muscle power end it at 10 to 15 m/s. Iosilevskii, G., Weihs, D.
#: (2008). Speed limits on swimming of fishes and cetaceans. J. R. Soc. Interface 5, 329-338.
FASTEST_M_S = 15.0
#: Turn rate, rad/s: ten turns a second, more than the fastest escape of a fish or a fin that beats
#: through ±50 degrees at 10 Hz.
FASTEST_RAD_S = 60.0
#: Extent of a track that a tank, a pool and a field of view do not have, m.
WIDEST_M = 100.0
#: Share of the record below which they may lie above the limit: jumps of a tracker.
OUTLIER_SHARE = 0.05


@dataclass(frozen=True)
class Doubt:
    """A column with unusual values, and the unit that would explain them."""

    column: str
    text: str


def doubts(time_s: Array, columns: Mapping[str, Array]) -> list[Doubt]:
    """Return the columns of a log with values that are unusual for a swimmer.

    Parameters
    ----------
    time_s : ndarray, shape (n,)
    columns : mapping of str to ndarray, each shape (n,)
        With or without ``t_s``; NaN where missing.
    """
    texts: dict[str, str | None] = {}
    if len(time_s) > 2 and np.nanmedian(np.diff(time_s)) >= 5 and np.ptp(time_s) >= 2000:
        texts["t_s"] = (
            "a step of 5 s or more is unusual: state the unit if it is milliseconds (a factor of 1000)"
        )
    texts |= {name: _doubt(name, time_s, values) for name, values in columns.items() if name != "t_s"}
    return [Doubt(name, text) for name, text in texts.items() if text is not None]


def _doubt(name: str, time_s: Array, values: Array) -> str | None:
    low, high = _ends(values)
    largest = max(-low, high)
    if name.endswith("_rad"):
        tilted = name in ("roll_rad", "pitch_rad") and largest > 1.5 * np.pi
        wrapped = max(_ends(np.diff(values))) > 2.2 * np.pi
        bent = name[:3] in ("joi", "cmd") and largest > 2 * np.pi
        if tilted or wrapped or bent:
            return "unusual for radians: state the unit if it is degrees (a factor of 57.3)"
        rate = _usual_rate(time_s, values)
        if rate > FASTEST_RAD_S:
            return f"turns at {rate:.3g} rad/s: state the unit if it is degrees (a factor of 57.3)"
    elif name.endswith("_rad_s") and largest > FASTEST_RAD_S:
        return "unusual for rad/s: state the unit if it is degrees per second (a factor of 57.3)"
    elif name in ("x_m", "y_m", "z_m"):
        speed = _usual_rate(time_s, values)
        if speed > FASTEST_M_S:
            return f"moves at {speed:.3g} m/s: state the unit if it is millimetres (a factor of 1000)"
        if high - low > WIDEST_M:
            return f"extends over {high - low:.3g} m: state the unit if it is millimetres (a factor of 1000)"
    elif name.endswith("_m_s") and largest > FASTEST_M_S:
        return "unusual for m/s: state the unit if it is millimetres per second (a factor of 1000)"
    return None


def _usual_rate(time_s: Array, values: Array) -> float:
    """Rate of change that all but :data:`OUTLIER_SHARE` of a record stays below; 0 of too short a one."""
    known = np.isfinite(values) & np.isfinite(time_s)
    t, x = time_s[known], values[known]
    if len(t) < 3 or not np.median(np.diff(t)) > 0:
        return 0.0
    # over at least 0.1 s, so that noise and a jump do not make a rate
    lag = max(1, round(0.1 / float(np.median(np.diff(t)))))
    if len(t) <= 2 * lag:
        return 0.0
    steps = t[lag:] - t[:-lag]
    forward = steps > 0
    rates = np.abs(x[lag:] - x[:-lag])[forward] / steps[forward]
    return float(np.quantile(rates, 1.0 - OUTLIER_SHARE)) if len(rates) else 0.0


def _ends(values: Array) -> tuple[float, float]:
    """Smallest and largest value, zeros where there is none."""
    if len(values) == 0:
        return 0.0, 0.0
    low, high = float(np.fmin.reduce(values)), float(np.fmax.reduce(values))
    return (0.0, 0.0) if np.isnan(low) else (low, high)
