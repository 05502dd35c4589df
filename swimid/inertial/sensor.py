"""What is known of an inertial unit besides its samples: noise, biases, errors of scale."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from swimid.inertial.record import GRAVITY_M_S2

MILLI_G = 1e-3 * GRAVITY_M_S2
DEG = np.pi / 180


@dataclass(frozen=True)
class Sensor:
    """Error figures of an inertial unit; the defaults are those of the 3DM-GX1's class.

    Attributes
    ----------
    acceleration_noise, rate_noise : float or None
        White noise densities, m/s^2/sqrt(Hz) and rad/s/sqrt(Hz); None: from still periods, or where there
        are none 0.4 mg/sqrt(Hz) and 3.5 deg/sqrt(h) (MicroStrain 3DM-GX1 data sheet; Shang et al. 2012,
        Table I).
    acceleration_bias_sd, rate_bias_sd : float
        Of a bias nobody has measured, m/s^2 and rad/s: 10 mg and 1 deg/s.
    acceleration_drift, rate_drift : float
        What a bias changes by in 100 s, m/s^2 and rad/s: 0.2 mg ("short-term stability", Table I of
        Shang et al.) and 0.02 deg/s.
    scale_sd : float
        Error of scale and alignment of both sensors, 0.5 %.
    attitude_sd : float or None
        Of attitudes in the log, or of the filter's, rad; None: 2 deg (Table I) and 1 deg.
    """

    acceleration_noise: float | None = None
    rate_noise: float | None = None
    acceleration_bias_sd: float = 10 * MILLI_G
    rate_bias_sd: float = 1.0 * DEG
    acceleration_drift: float = 0.2 * MILLI_G
    rate_drift: float = 0.02 * DEG
    scale_sd: float = 0.005
    attitude_sd: float | None = None


#: Noise densities where nothing tells: m/s^2/sqrt(Hz), rad/s/sqrt(Hz).
SHEET_ACCELERATION_NOISE = 0.4 * MILLI_G
SHEET_RATE_NOISE = 3.5 * DEG / 60.0
#: Deviation of an attitude: the sensor's own, the filter's (rad).
QUATERNION_SD, FILTER_SD = 2.0 * DEG, 1.0 * DEG
#: How long an error of such an attitude lasts at least, s: so many seconds count as one measurement.
QUATERNION_MEMORY_S, FILTER_MEMORY_S = 10.0, 20.0
#: Time after which the drift of a bias is given, s.
DRIFT_TIME_S = 100.0
