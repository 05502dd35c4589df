"""Options of the command ``import``."""

from __future__ import annotations

from typing import Any, Self

from pydantic import model_validator

from swimid.errors import UsageError
from swimid.options import Options, Source, option


class ImportOptions(Options):
    """Options of the command ``import``, which converts a foreign log to the log format."""

    map_path: Source = option(None, flag="--map", recorded=False, help="Mapping file (swimid-mapping/1).")
    profile: str | None = option(
        None,
        flag="--as",
        metavar="FORMAT",
        help="Format of the file: anipose, ardupilot, coco, deeplabcut, dynamixel, dynamixel-ax, "
        "dynamixel-x, gpx, idtrackerai, kinovea, movement, nmea, opensim, optitrack, px4, qualisys, ros2, "
        "sleap, swimid, tracker, trackpy, vicon, c3d, db3, delimited, hdf5, json, lvm, mat, mavlink, mcap, "
        "netcdf, npz, parquet, tdms, ulog, xlsx  "
        "[default: recognised by its content].",
    )
    select: str | None = option(
        None,
        metavar="NAME",
        help="Track, individual, rigid body, topic, message type, section, sheet, struct or group to take, "
        "if the file holds several.",
    )
    rate_hz: float | None = option(
        None, gt=0, help="Frames per second, for a file of a known format that states no times."
    )
    length_unit: str | None = option(
        None, metavar="UNIT", help="Unit of lengths (mm, cm, m, px), for a file that states none."
    )
    min_likelihood: float | None = option(
        None,
        ge=0,
        le=1,
        help="Leave a tracked point with a smaller likelihood (confidence, score) empty  [default: 0.6].",
    )
    robot: str | None = option(
        None,
        metavar="NAME|FILE",
        help="Robot whose pose and joint angles the tracked points show, built in or a file.",
    )
    points: Source = option(
        None,
        recorded=False,
        help="Points file (swimid-points/1): place of each tracked point on the robot, or a chain of points, "
        "and the scale  [default: the points of the robot file].",
    )
    calibrate_points: bool = option(False, help="Estimate the places of the points from the film, too.")
    every: int | None = option(
        None,
        ge=2,
        metavar="N",
        help="Average every N successive rows to one, for a recording of a high rate. Statistics of all rows "
        "are part of the result.",
    )
    clean: bool | None = option(
        None,
        flag="--clean/--raw",
        help="Leave repeats and jumps out of the track, or keep them  "
        "[default: clean a track of two coordinates].",
    )
    stroke_hz: tuple[float, float] | None = option(
        None,
        flag="--stroke",
        metavar="LOW HIGH",
        help="Lowest and highest possible frequency of the stroke, Hz.",
    )

    @property
    def file_values(self) -> dict[str, Any]:
        """Values that the user gives for a foreign file, such as its format and unit of length, by option.

        These values replace or complete those in the mapping of the file.
        """
        names = {"profile", "select", "rate_hz", "length_unit", "min_likelihood"}
        return self.model_dump(include=names, exclude_none=True)

    @model_validator(mode="after")
    def _can_be_meant(self) -> Self:
        if self.calibrate_points and self.robot is None:
            raise UsageError("--calibrate-points needs a robot: name it with --robot")
        if self.stroke_hz is not None and not 0 < self.stroke_hz[0] < self.stroke_hz[1]:
            raise UsageError("--stroke takes two frequencies in Hz, the lower first")
        return self

    def settings(self, **found: Any) -> dict[str, Any]:
        """Return the import options for the provenance of a log, without those that the user did not give."""
        given = {key: value for key, value in super().settings(**found).items() if value is not None}
        if not self.calibrate_points:
            del given["calibrate_points"]
        return given
