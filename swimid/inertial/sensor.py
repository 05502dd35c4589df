"""What is known of an inertial unit besides its samples: noise, biases, errors of scale."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from swimid.inertial.options import TrackImuOptions
from swimid.inertial.record import GRAVITY_M_S2

MILLI_G = 1e-3 * GRAVITY_M_S2
DEG = np.pi / 180
#: Standard deviations in half a 95 % band.
BAND = 1.96


@dataclass(frozen=True)
class Sensor:
    """Error figures of an inertial unit; the defaults are those of the 3DM-GX1's class."""

    #: White noise densities, m/s^2/sqrt(Hz) and rad/s/sqrt(Hz); None: from still periods, or where there are
    #: none 0.4 mg/sqrt(Hz) and 3.5 deg/sqrt(h) (MicroStrain 3DM-GX1 data sheet; Shang et al. 2012, Table I).
    acceleration_noise: float | None = None
    rate_noise: float | None = None
    #: Of a bias nobody has measured, m/s^2 and rad/s: 10 mg and 1 deg/s.
    acceleration_bias_sd: float = 10 * MILLI_G
    rate_bias_sd: float = 1.0 * DEG
    #: What a bias changes by in 100 s, m/s^2 and rad/s: 0.2 mg ("short-term stability", Table I of Shang et
    #: al.) and 0.02 deg/s.
    acceleration_drift: float = 0.2 * MILLI_G
    rate_drift: float = 0.02 * DEG
    #: Error of scale and alignment of both sensors, 0.5 %.
    scale_sd: float = 0.005
    #: What a scale changes by with the reading itself (nonlinearity), both sensors, 0.2 %.
    bending_sd: float = 0.002
    #: Of attitudes in the log, or of the filter's, rad; None: 2 deg (Table I) and 1 deg.
    attitude_sd: float | None = None

    @classmethod
    def of(cls, options: TrackImuOptions) -> Sensor:
        """The error figures as the options state them."""
        attitude_deg = options.attitude_sd_deg
        return cls(
            options.accel_noise,
            options.gyro_noise,
            options.accel_bias_mg * MILLI_G,
            options.gyro_bias_deg_s * DEG,
            attitude_sd=None if attitude_deg is None else attitude_deg * DEG,
        )

    def classes(self) -> dict[str, Sensor]:
        """The same with the errors of other classes of sensor where nothing is stated, by name."""
        usual = Sensor()

        def of(errors: dict[str, float]) -> Sensor:
            return replace(self, **{k: v for k, v in errors.items() if getattr(self, k) == getattr(usual, k)})

        return {CHIP_NAME: of(CHIP), WARMING_NAME: of(CHIP | WARMING)}


#: Errors of chips as they are soldered: limits of their data sheets over sqrt(3), as of what is even within.
#: InvenSense MPU-6050 (PS-MPU-6000A rev. 3.4, sec. 6.1 and 6.2: +-50 mg, +-20 deg/s, scale +-3 %, cross-axis
#: +-2 %), ICM-20948 (DS-000189: +-50 mg on a board, +-5 deg/s, +-1.5 %), Bosch BMI160 (+-40 mg, +-3 deg/s),
#: ST LSM6DSO (+-20 mg, +-1 deg/s, +-1 %). Once warm, their biases are as steady as those of better units.
CHIP: dict[str, float] = {
    "acceleration_bias_sd": 30 * MILLI_G,
    "rate_bias_sd": 5.0 * DEG,
    "scale_sd": 0.015,
}
#: What their biases change by in 100 s while they warm: ten degrees in five minutes, at 0.5 mg and 0.16 deg/s
#: for each (MPU-6050: +-35 mg over 70 degrees, +-20 deg/s over 125).
WARMING: dict[str, float] = {"acceleration_drift": 1.7 * MILLI_G, "rate_drift": 0.5 * DEG}
CHIP_NAME = "a consumer's chip (biases of 30 mg, scales off by 1.5 %)"
WARMING_NAME = (
    "a consumer's chip that warms up (biases of 30 mg that change by 1.7 mg and 0.5 deg/s in 100 s)"
)
#: Deviation of an attitude: the sensor's own, the filter's (rad).
QUATERNION_SD, FILTER_SD = 2.0 * DEG, 1.0 * DEG
#: How long an error of such an attitude lasts at least, s: so many seconds count as one measurement.
QUATERNION_MEMORY_S, FILTER_MEMORY_S = 10.0, 20.0
#: Time after which the drift of a bias is given, s.
DRIFT_TIME_S = 100.0
