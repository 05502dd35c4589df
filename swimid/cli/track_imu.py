"""``swimid track imu``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from swimid.cli.common import Shared, protect, running, shared_options

_POSITIVE = click.FloatRange(0, min_open=True)


@click.command("imu")
@click.argument("imu", type=click.Path(path_type=Path))
@click.option(
    "--map", "map_path", type=click.Path(path_type=Path), help="Mapping of foreign columns and units."
)
@click.option(
    "--with",
    "other",
    type=click.Path(path_type=Path),
    help="Another log of the trial to fuse with (a camera's).",
)
@click.option(
    "--method",
    type=click.Choice(["smoother", "paper"]),
    default="smoother",
    show_default=True,
    help="Error-state smoother, or the steps of Shang et al. (2012).",
)
@click.option(
    "--motion-mode",
    type=click.Choice(["marching", "receding", "rotating"]),
    default="marching",
    show_default=True,
    help="The paper's motion mode: which constant parts are removed.",
)
@click.option(
    "--threshold-m-s2",
    type=click.FloatRange(0),
    help="The paper's threshold on accelerations  [default: 0.02].",
)
@click.option(
    "--threshold-rad-s",
    type=click.FloatRange(0),
    help="The paper's threshold on turn rates  [default: 0.01].",
)
@click.option(
    "--still",
    type=float,
    nargs=2,
    multiple=True,
    metavar="T0 T1",
    help="Times, s, between which the robot rests. Repeatable.",
)
@click.option(
    "--rest",
    "rests",
    type=click.Choice(["ends", "all", "none"]),
    default="ends",
    show_default=True,
    help="Still periods found that are rests: those at both ends of the log, all, or none.",
)
@click.option(
    "--zero-mean",
    type=click.Choice(["sway", "heave"]),
    multiple=True,
    help="Declare that this velocity has no mean over --window-s. Repeatable.",
)
@click.option(
    "--window-s",
    type=_POSITIVE,
    default=2.0,
    show_default=True,
    help="Window of --zero-mean, s: whole strokes.",
)
@click.option(
    "--mean-sd-m-s",
    type=_POSITIVE,
    default=0.02,
    show_default=True,
    help="How far that mean may be from 0, m/s.",
)
@click.option(
    "--top-speed-m-s",
    type=_POSITIVE,
    default=2.0,
    show_default=True,
    help="Speed the robot never exceeds, m/s.",
)
@click.option(
    "--mount-deg",
    type=float,
    nargs=3,
    metavar="ROLL PITCH YAW",
    help="How the sensor is turned in the body, degrees.",
)
@click.option(
    "--level-at-rest", is_flag=True, help="The robot rests level: take the tilt seen there as the mounting's."
)
@click.option(
    "--lever-m",
    type=float,
    nargs=3,
    metavar="X Y Z",
    help="The sensor's place seen from the reference point, body axes, m.",
)
@click.option(
    "--clock-offset-s", type=float, help="Add this to the times of the other log  [default: estimated]."
)
@click.option(
    "--fix-sd-m", type=_POSITIVE, help="Noise of the other log's positions, m  [default: estimated]."
)
@click.option(
    "--accel-noise", type=_POSITIVE, help="Accelerometer noise, m/s2/sqrt(Hz)  [default: from still periods]."
)
@click.option(
    "--gyro-noise", type=_POSITIVE, help="Gyroscope noise, rad/s/sqrt(Hz)  [default: from still periods]."
)
@click.option(
    "--accel-bias-mg", type=_POSITIVE, help="Accelerometer bias before any calibration, mg  [default: 10]."
)
@click.option(
    "--gyro-bias-deg-s", type=_POSITIVE, help="Gyroscope bias before any calibration, deg/s  [default: 1]."
)
@click.option(
    "--attitude-sd-deg",
    type=_POSITIVE,
    help="Error of quaternions in the log, or of the attitude filter, deg  [default: 2, 1].",
)
@shared_options("The log, CSV or Parquet by its ending.", required=True)
def imu_command(imu: Path, map_path: Path | None, other: Path | None, shared: Shared, **given: Any) -> None:
    """Make motion of an inertial recording: velocity, position and attitude with their bands.

    Faults of recording are found, named, and repaired or refused. Without --with the summary says after how
    many seconds the integrated path is not to be trusted. Writes the log and its evidence.

    \b
    Example:
      swimid track imu imu.csv -o run.csv
      swimid track imu imu.csv --with camera.csv -o run.csv
      swimid track imu imu.csv --method paper --motion-mode marching -o paper.csv
    """
    with running("track imu", shared) as run:
        from swimid.inertial.settings import Settings
        from swimid.inertial.track_imu import track_imu

        inputs = tuple(path for path in (imu, map_path, other) if path is not None)
        protect(shared.output, shared, inputs=inputs)
        assert shared.output is not None
        run.finish(
            track_imu(
                imu,
                output=shared.output,
                map_path=map_path,
                other=other,
                settings=Settings.of_options(given),
                progress=run.progress,
            )
        )
