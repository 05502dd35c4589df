"""Velocity and position as Shang, Wang, Tan and Cheng (2012, doi:10.1017/S0263574711001159) compute them.

Section 5, step by step: the constant part of the readings is filtered off for each motion mode, small
readings are set to zero, accelerations and turn rates are turned to the earth's axes (Eqs 10 and 11), and
velocity and position follow by the trapezoidal rule (Eqs 12 and 13). The paper states neither the filter
nor the threshold; the readings taken are said below. It gives no uncertainty.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from swimid.inertial import strapdown
from swimid.inertial.record import Array, Record

Mode = Literal["marching", "receding", "rotating"]


@dataclass(frozen=True)
class PaperMotion:
    """Motion by the paper's steps."""

    #: Shape (n, 3). Earth axes, Eqs 10 and 11.
    acceleration: Array
    rate: Array
    #: Shape (n, 3). Earth axes, Eqs 12 and 13, from rest at the origin.
    velocity: Array
    position: Array
    #: Shape (3,). The constant parts.
    removed_acceleration: Array
    removed_rate: Array


def thresholded(values: Array, threshold: float) -> Array:
    """Readings below the threshold set to 0 ("discarded", sec. 5.2).

    >>> thresholded(np.array([0.01, -0.3]), 0.02).tolist()
    [0.0, -0.3]
    """
    return np.where(np.abs(values) < threshold, 0.0, values)


def integrate(
    record: Record,
    attitude: Rotation,
    mode: Mode,
    threshold_m_s2: float,
    threshold_rad_s: float,
) -> PaperMotion:
    """The paper's way, from a record in body axes.

    Parameters
    ----------
    record : Record
    attitude : Rotation
        Body to earth, n of them: the inverse of the paper's ``M_e^f``.
    mode : str
        ``marching`` and ``receding``: the vehicle keeps its heading, so the constant part of all six
        channels is error (and gravity). ``rotating``: it turns at a mean rate, so that of the yaw rate
        is kept.
    threshold_m_s2, threshold_rad_s : float
        Readings below these are set to 0. The paper: "small and not very clear".

    Notes
    -----
    Taking off the mean acceleration makes the last velocity equal the first, whatever the vehicle did.
    """
    mean_a, mean_w = record.acceleration.mean(axis=0), record.rate.mean(axis=0)
    if mode == "rotating":
        mean_w[2] = 0.0
    body_a = thresholded(record.acceleration - mean_a, threshold_m_s2)
    body_w = thresholded(record.rate - mean_w, threshold_rad_s)
    earth_a = attitude.apply(body_a)  # Eq 10: a_e = (M_e^f)^-1 a_f
    earth_w = attitude.apply(body_w)  # Eq 11
    velocity = strapdown.integral(record.time_s, earth_a)  # Eq 12
    position = strapdown.integral(record.time_s, velocity)  # Eq 13
    return PaperMotion(earth_a, earth_w, velocity, position, mean_a, mean_w)
