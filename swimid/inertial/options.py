"""The options of ``track imu``."""

from __future__ import annotations

from typing import Literal, Self

from pydantic import model_validator

from swimid.errors import UsageError
from swimid.options import Options, Source, option


class TrackImuOptions(
    Options,
    command="track imu",
    section="Make logs",
    argument="IMU",
    output="The log, CSV or Parquet by its ending.",
    required=True,
):
    """Compute velocity, position and attitude from an inertial recording, with their bands.

    Faults of the recording are found, and repaired or refused. Without --with the summary states after how
    many seconds the integrated path cannot be trusted. Writes the log and its evidence.

    Example:
      swimid track imu imu.csv -o run.csv
      swimid track imu imu.csv --with camera.csv -o run.csv
      swimid track imu imu.csv --method paper --motion-mode marching -o paper.csv
    """

    map_path: Source = option(
        None, flag="--map", recorded=False, help="Mapping of foreign columns and units."
    )
    other: Source = option(
        None, flag="--with", recorded=False, help="Another log of the same trial (of a camera) to fuse with."
    )
    method: Literal["smoother", "paper"] = option(
        "smoother", help="Error-state Kalman smoother, or the steps of Shang et al. (2012)."
    )
    motion_mode: Literal["marching", "receding", "rotating"] = option(
        "marching", help="Motion mode of the paper: it decides which constant parts are subtracted."
    )
    threshold_m_s2: float = option(0.02, ge=0, help="Threshold of the paper on accelerations.")
    threshold_rad_s: float = option(0.01, ge=0, help="Threshold of the paper on turn rates.")
    still: tuple[tuple[float, float], ...] = option(
        (), metavar="T0 T1", help="Start and end of a rest of the robot, s. Repeatable."
    )
    rests: Literal["ends", "all", "none"] = option(
        "ends",
        flag="--rest",
        help="Still periods that count as rests: those at both ends of the log, all, or none.",
    )
    zero_mean: tuple[Literal["sway", "heave"], ...] = option(
        (), help="Velocity whose mean over --window-s is 0. Repeatable."
    )
    window_s: float = option(2.0, gt=0, help="Window of --zero-mean, s: a whole number of strokes.")
    top_speed_m_s: float = option(2.0, gt=0, help="Speed that the robot never exceeds, m/s.")
    mount_deg: tuple[float, float, float] | None = option(
        None, metavar="ROLL PITCH YAW", help="Mounting angles of the sensor in the body, degrees."
    )
    level_at_rest: bool = option(
        False, help="The robot rests level: its tilt at rest is that of the mounting."
    )
    lever_m: tuple[float, float, float] | None = option(
        None, metavar="X Y Z", help="Position of the sensor from the reference point, body axes, m."
    )
    clock_offset_s: float | None = option(
        None, help="Offset to add to the times of the other log, s  [default: estimated]."
    )
    fix_sd_m: float | None = option(
        None, gt=0, help="Noise of the positions in the other log, m  [default: estimated]."
    )
    accel_noise: float | None = option(
        None, gt=0, help="Accelerometer noise, m/s2/sqrt(Hz)  [default: from still periods]."
    )
    gyro_noise: float | None = option(
        None, gt=0, help="Gyroscope noise, rad/s/sqrt(Hz)  [default: from still periods]."
    )
    accel_bias_mg: float = option(10.0, gt=0, help="Accelerometer bias before any calibration, mg.")
    gyro_bias_deg_s: float = option(1.0, gt=0, help="Gyroscope bias before any calibration, deg/s.")
    attitude_sd_deg: float | None = option(
        None,
        gt=0,
        help="Error of the quaternions in the log, or of the attitude filter, deg  [default: 2, 1].",
    )

    @model_validator(mode="after")
    def _check_rests(self) -> Self:
        for start, end in self.still:
            if not start < end:
                raise UsageError(f"--still {start:g} {end:g}: the rest must end after it begins")
        return self
