"""What an inertial unit tells without any help: the motion within a stroke."""

from __future__ import annotations

import numpy as np
from scipy import signal
from scipy.spatial.transform import Rotation

from swimid.inertial.record import Array

#: Slower than this is left out where no stroke is found, Hz; with one: this share of its frequency.
LOWEST_HZ, SHARE = 0.3, 0.5


def high_passed(time_s: Array, values: Array, cutoff_hz: float) -> Array:
    """A channel less everything slower than ``cutoff_hz``: fourth-order Butterworth, no phase shift."""
    step = float(np.median(np.diff(time_s)))
    even = np.arange(time_s[0], time_s[-1] + 0.5 * step, step)
    if len(even) < 32 or cutoff_hz >= 0.45 / step:
        return np.full_like(values, np.nan)
    sos = signal.butter(2, cutoff_hz, "high", fs=1 / step, output="sos")
    passed = signal.sosfiltfilt(
        sos, np.interp(even, time_s, values), padlen=min(len(even) - 1, int(3 / (cutoff_hz * step)))
    )
    return np.interp(time_s, even, passed)


def surge(time_s: Array, velocity: Array, rotation: Rotation, cutoff_hz: float) -> Array:
    """The surge within a stroke, m/s, shape (n,).

    The velocity is high-passed along the world's axes before it is turned to the body's: a drifting velocity
    would leak into the surge with every swing of the heading.

    Parameters
    ----------
    velocity : ndarray, shape (n, 3)
        World axes, m/s.
    rotation : Rotation
        Body to world, n of them.
    """
    fast = np.column_stack([high_passed(time_s, column, cutoff_hz) for column in velocity.T])
    return np.asarray(rotation.inv().apply(fast)[:, 0])


def high_passed_sd(acceleration_noise: float, cutoff_hz: float, scale_sd: float, values: Array) -> float:
    """Deviation of a high-passed velocity, m/s.

    Notes
    -----
    White acceleration noise of density N leaves ``N / (2 pi sqrt(f_c))`` after integration and a sharp
    high pass at f_c (integral of ``N^2 / (2 pi f)^2`` from f_c up); an error of scale adds in proportion.
    """
    white = acceleration_noise / (2 * np.pi * np.sqrt(cutoff_hz))
    return float(np.hypot(white, scale_sd * np.nanstd(values)))
