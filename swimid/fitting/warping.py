"""Distances between trajectories when time may be stretched a little."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from swimid.fitting.metrics import dtw_distance
from swimid.fitting.model import Array

#: Which channels make up a distance together.
KINDS: dict[str, tuple[str, ...]] = {
    "position": ("x_m", "y_m", "z_m"),
    "orientation": ("roll_rad", "pitch_rad", "yaw_rad"),
    "speed": ("u_m_s", "v_m_s", "w_m_s"),
    "turning": ("roll_rate_rad_s", "pitch_rate_rad_s", "yaw_rate_rad_s"),
}
#: What an error counts as one in each: m, rad (5 degrees), m/s, rad/s (10 degrees a second).
SCALES = {
    "position": 0.05,
    "orientation": math.radians(5.0),
    "speed": 0.05,
    "turning": math.radians(10.0),
}
#: The unit of each.
UNITS = {"position": "m", "orientation": "rad", "speed": "m/s", "turning": "rad/s"}
#: By this share of the record the two may be shifted at most.
BAND = 0.05


def kind_of(channel: str) -> str:
    """The distance a channel is part of; a joint's angle counts as orientation, its rate as turning."""
    for kind, names in KINDS.items():
        if channel in names:
            return kind
    return "turning" if channel.endswith("_rate_rad_s") else "orientation"


def distance(
    measured: Mapping[str, Array],
    simulated: Mapping[str, Array],
    channels: Sequence[str],
    scales: Sequence[float],
    *,
    band: float = BAND,
) -> float:
    """Dynamic-time-warping distance per sample of several channels warped as one.

    Parameters
    ----------
    measured, simulated : mapping of channel to ndarray, shape (n,)
        On one clock of even steps. Samples that are not measured in every channel are left out.
    channels : sequence of str
    scales : sequence of float
        What an error of each channel counts as one, in the channel's unit.
    band : float
        By what share of the record the two may be shifted at most (Sakoe and Chiba 1978).

    Returns
    -------
    float
        Root of the least sum of squares over n; NaN where nothing is left or the simulation broke down.

    >>> late = {"x_m": np.array([0.0, 0.0, 1.0, 2.0, 2.0])}
    >>> distance({"x_m": np.array([0.0, 1.0, 2.0, 2.0, 2.0])}, late, ["x_m"], [0.05], band=0.2)
    0.0
    """
    first = np.column_stack([measured[n] for n in channels])
    second = np.column_stack([simulated[n] for n in channels])
    there = np.isfinite(first).all(axis=1)
    if not there.any() or not np.isfinite(second[there]).all():
        return math.nan
    y, z = (v[there] / np.asarray(scales) for v in (first, second))
    return dtw_distance(y, z, band=max(round(band * len(y)), 1))
