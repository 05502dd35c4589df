"""Options of the command ``track imu``."""

from __future__ import annotations

from typing import Literal

from swimid.options import Options, Source, option


class TrackImuOptions(
    Options, argument="IMU", output="The log, CSV or Parquet by its ending.", required=True, makes="log"
):
    """Compute velocity, position and attitude from an inertial recording, each with its uncertainty band.

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
        None, flag="--with", recorded=False, help="Camera log of the trial: any log of positions or angles."
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
        "ends", flag="--rest", help="Still periods that count as rests: those at both ends, all, or none."
    )
    top_speed_m_s: float = option(2.0, gt=0, help="Speed that the robot never exceeds, m/s.")
    mount_deg: tuple[float, float, float] | None = option(
        None, metavar="ROLL PITCH YAW", help="Mounting angles of the sensor in the body, degrees."
    )
    level_at_rest: bool = option(False, help="The robot rests level: its tilt then is the mounting's.")
    lever_m: tuple[float, float, float] | None = option(
        None, metavar="X Y Z", help="Position of the sensor from the reference point, body axes, m."
    )
    clock_offset_s: float | None = option(
        None, help="Offset to add to the times of the camera log, s  [default: estimated]."
    )
    fix_sd_m: float | None = option(
        None, gt=0, help="Noise of the positions in the camera log, m  [default: estimated]."
    )
