"""The options of ``swimid track imu``, in the field's units, as settings in SI."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from swimid.errors import UsageError
from swimid.inertial.alone import Declared
from swimid.inertial.paper import THRESHOLD_M_S2, THRESHOLD_RAD_S
from swimid.inertial.sensor import DEG, MILLI_G, Sensor
from swimid.inertial.track_imu_material import Settings


def settings_of(given: Mapping[str, Any]) -> Settings:
    """Settings from the command line's options, None where one was not given.

    Raises
    ------
    UsageError
        A rest that ends before it begins.
    """
    for start, end in given["still"]:
        if not start < end:
            raise UsageError(f"--still {start:g} {end:g}: the rest must end after it begins")
    usual = Sensor()

    def scaled(name: str, factor: float, default: float | None) -> float | None:
        return default if given[name] is None else given[name] * factor

    sensor = Sensor(
        given["accel_noise"],
        given["gyro_noise"],
        scaled("accel_bias_mg", MILLI_G, usual.acceleration_bias_sd) or usual.acceleration_bias_sd,
        scaled("gyro_bias_deg_s", DEG, usual.rate_bias_sd) or usual.rate_bias_sd,
        attitude_sd=scaled("attitude_sd_deg", DEG, None),
    )
    declared = Declared(
        list(given["still"]),
        given["rests"],
        tuple(dict.fromkeys(given["zero_mean"])),
        given["window_s"],
        given["mean_sd_m_s"],
        given["top_speed_m_s"],
        None if given["lever_m"] is None else np.asarray(given["lever_m"], dtype=float),
    )
    return Settings(
        given["method"],
        given["motion_mode"],
        THRESHOLD_M_S2 if given["threshold_m_s2"] is None else given["threshold_m_s2"],
        THRESHOLD_RAD_S if given["threshold_rad_s"] is None else given["threshold_rad_s"],
        given["mount_deg"],
        given["level_at_rest"],
        given["clock_offset_s"],
        given["fix_sd_m"],
        declared,
        sensor,
    )
