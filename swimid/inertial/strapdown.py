"""Dead reckoning: attitude from turn rates, velocity and position from accelerations."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from scipy.integrate import cumulative_trapezoid
from scipy.spatial.transform import Rotation

from swimid.inertial.record import Array


@njit(cache=True)
def _integrate(vectors, start):  # type: ignore[no-untyped-def]  # pragma: no cover - compiled
    """Quaternions (x, y, z, w) after each turn of ``vectors`` about body axes."""
    n = len(vectors)
    q = np.empty((n + 1, 4))
    q[0] = start
    for k in range(n):
        x, y, z = vectors[k, 0], vectors[k, 1], vectors[k, 2]
        angle = np.sqrt(x * x + y * y + z * z)
        s = 0.5 - angle * angle / 48.0 if angle < 1e-4 else np.sin(0.5 * angle) / angle
        c = np.cos(0.5 * angle)
        x, y, z = s * x, s * y, s * z
        a, b, g, w = q[k, 0], q[k, 1], q[k, 2], q[k, 3]
        q[k + 1, 0] = w * x + a * c + b * z - g * y
        q[k + 1, 1] = w * y - a * z + b * c + g * x
        q[k + 1, 2] = w * z + a * y - b * x + g * c
        q[k + 1, 3] = w * c - a * x - b * y - g * z
        q[k + 1] /= np.sqrt(np.sum(q[k + 1] ** 2))
    return q


def attitude(time_s: Array, rate: Array, start: Rotation) -> Rotation:
    """Attitude at every sample, from turn rates.

    Parameters
    ----------
    time_s : ndarray, shape (n,)
    rate : ndarray, shape (n, 3)
        In the sensor's axes, rad/s, free of bias.
    start : Rotation
        Sensor to world at the first sample.

    Notes
    -----
    Each step turns by the trapezoid of the rates plus the coning term ``(w0 x w1) dt^2 / 12`` (Bortz
    1971, doi:10.1109/TAES.1971.310252, for rates that change linearly).
    """
    dt = np.diff(time_s)[:, None]
    turn = 0.5 * (rate[1:] + rate[:-1]) * dt + np.cross(rate[:-1], rate[1:]) * dt**2 / 12
    return Rotation.from_quat(_integrate(turn, start.as_quat()))


def integral(time_s: Array, values: Array, start: Any = 0.0) -> Array:
    """Trapezoidal integral of every column from the first sample on, shape (n, d).

    Shang et al. (2012), Eqs 12 and 13, with the samples' own steps.
    """
    return np.asarray(cumulative_trapezoid(values, time_s, axis=0, initial=0)) + start
