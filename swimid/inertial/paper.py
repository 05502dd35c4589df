"""Motion by the method of the long-fin paper: ``swimid track imu --method paper``.

The method is that of Shang, Wang, Tan and Cheng (2012, doi:10.1017/S0263574711001159), section 5. The
constant part of the readings is subtracted, small readings are set to zero, and accelerations are converted
to the earth's axes (Eq 10). Velocity and position follow by the trapezoidal rule (Eqs 12 and 13). The paper
states neither its filter, nor the thresholds, nor an uncertainty. Because the mean acceleration is
subtracted, the final velocity always equals the initial one.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from swimid.inertial.options import TrackImuOptions
from swimid.inertial.record import Array, Record, integral

REFERENCE = (
    "Shang, L., Wang, S., Tan, M., Cheng, L. (2012). Swimming locomotion modeling for biomimetic underwater "
    "vehicle with two undulating long-fins. Robotica 30, 913-923. doi:10.1017/S0263574711001159"
)


def compute_motion(
    record: Record, rotation: Rotation, options: TrackImuOptions
) -> tuple[dict[str, Array], Array]:
    """Compute the motion of a vehicle.

    Parameters
    ----------
    record : Record
        Recording of n samples in body axes.
    rotation : Rotation
        Attitude from body to earth, shape (n,): the inverse of ``M_e^f`` of the paper.
    options : TrackImuOptions
        Thresholds ("discarded", sec. 5.2) and motion mode. In the modes ``marching`` and ``receding`` the
        constant parts of all six channels are errors and gravity, and are subtracted. In the mode
        ``rotating`` the mean yaw rate is motion, and is not subtracted.

    Returns
    -------
    dict of str to ndarray, shape (n, 3)
        Quantities of :class:`swimid.inertial.motion.Motion`.
    ndarray, shape (6,)
        Constant parts of the channels, m/s^2 and rad/s.
    """
    constant = record.channels.mean(axis=0)
    if options.motion_mode == "rotating":
        constant[5] = 0.0
    readings = record.channels - constant
    thresholds = np.repeat([options.threshold_m_s2, options.threshold_rad_s], 3)
    readings[np.abs(readings) < thresholds] = 0.0
    acceleration = rotation.apply(readings[:, :3])
    velocity = integral(record.time_s, acceleration)
    parts = {
        "position": integral(record.time_s, velocity),
        "velocity": velocity,
        "body_velocity": rotation.inv().apply(velocity),
        "rate": readings[:, 3:],
        "acceleration": acceleration,
    }
    return parts, constant


def describe(options: TrackImuOptions) -> str:
    """Return the sentence for a methods section."""
    return (
        "Velocity and position were computed from accelerations as by Shang et al. (2012): means subtracted "
        f"for {options.motion_mode} mode, readings below {options.threshold_m_s2:g} m/s² and "
        f"{options.threshold_rad_s:g} rad/s set to zero, rotation to earth axes (Eqs 10 and 11), trapezoids "
        "(Eqs 12 and 13)."
    )
