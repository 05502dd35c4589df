"""What ``swimid import`` does to a log on request: cut it, scale a track in pixels, project it on a line."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from swimid.errors import InputError, UsageError
from swimid.logs import log, projection
from swimid.logs.mapping import MappedLog
from swimid.logs.projection import Projection

Array = NDArray[np.float64]
METRES = ("x_m", "y_m", "z_m")
PIXELS = ("x_px", "y_px", "z_px")
#: Columns that follow from a pose, beside those that begin with its coordinates.
_POSE_SPEEDS = ("u", "v", "w", "vx", "vy", "vz")


@dataclass(frozen=True)
class Request:
    """What was asked for.

    Attributes
    ----------
    start_s, end_s : float or None
        Part of the log that is kept, on its own clock.
    along : str or None
        Line the track is projected on, as :func:`swimid.logs.projection.direction` reads it.
    scale : float or None
        Metres a pixel.
    stroke_hz : (float, float) or None
        Range in which the stroke is known to lie.
    """

    start_s: float | None = None
    end_s: float | None = None
    along: str | None = None
    scale: float | None = None
    stroke_hz: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        """Refuse what cannot be meant.

        Raises
        ------
        UsageError
        """
        if self.start_s is not None and self.end_s is not None and self.end_s <= self.start_s:
            raise UsageError(f"--end {self.end_s:g} lies before --start {self.start_s:g}")
        if self.scale is not None and not (np.isfinite(self.scale) and self.scale > 0):
            raise UsageError(f"--scale {self.scale:g}: a pixel has a positive size in metres")
        if self.stroke_hz is not None and not 0 < self.stroke_hz[0] < self.stroke_hz[1]:
            raise UsageError("--stroke takes two frequencies in Hz, the lower first")
        if self.along is not None:
            try:
                projection.direction(self.along)
            except ValueError as error:
                raise UsageError(f"--along: {error}") from error

    def settings(self) -> dict[str, Any]:
        """What was asked for, without what was not."""
        asked = {
            "start_s": self.start_s,
            "end_s": self.end_s,
            "along": self.along,
            "metres_per_pixel": self.scale,
            "stroke_hz": None if self.stroke_hz is None else list(self.stroke_hz),
        }
        return {key: value for key, value in asked.items() if value is not None}


def cut(columns: dict[str, Array], request: Request, source: MappedLog) -> None:
    """Keep the part of the log that was asked for.

    Raises
    ------
    InputError
        No two samples lie in it.
    """
    if request.start_s is None and request.end_s is None:
        return
    time = columns[log.TIME]
    low = -np.inf if request.start_s is None else request.start_s
    high = np.inf if request.end_s is None else request.end_s
    kept = (time >= low) & (time <= high)
    if kept.sum() < 2:
        raise InputError(
            f"{int(kept.sum())} samples lie between --start and --end; the log goes from {time[0]:g} s "
            f"to {time[-1]:g} s",
            file=source.path,
        )
    for name in list(columns):
        columns[name] = columns[name][kept]


def measured(columns: dict[str, Array]) -> dict[str, Array]:
    """The columns as they were measured: of a track of swimid the positions before smoothing.

    What was bridged there, and is no measurement, is NaN.
    """
    raw = {name: columns[raw] for name in columns if (raw := _raw(name)) in columns}
    bridged = columns.get("interpolated")
    if not raw or bridged is None:
        return columns
    return {
        name: np.where(bridged == 1, np.nan, raw.get(name, values)) if _of_pose(name) else values
        for name, values in columns.items()
    }


def to_metres(columns: dict[str, Array], request: Request, source: MappedLog) -> None:
    """Convert the pose of a track in pixels, in place.

    Raises
    ------
    InputError
        There is none.
    """
    if request.scale is None:
        return
    if not any(name in columns for name in PIXELS):
        raise InputError("--scale is for a track in pixels: there is no column x_px", file=source.path)
    taken = [name for name in METRES if name in columns]
    if taken:
        raise InputError("there is a track in metres already", file=source.path, column=taken[0])
    for name in [name for name in columns if "_px" in name and _of_pose(name)]:
        columns[name.replace("_px", "_m")] = columns.pop(name) * request.scale


def along(columns: dict[str, Array], request: Request, source: MappedLog) -> Projection | None:
    """Put the distance along a line in the place of the pose, in place.

    Raises
    ------
    InputError
        There is no track, or it does not move.
    """
    if request.along is None:
        return None
    unit = "m" if any(name in columns for name in METRES) else "px"
    names = [name for name in (METRES if unit == "m" else PIXELS) if name in columns]
    if not names:
        raise InputError("--along needs a track: x_m, y_m, z_m, or those in px", file=source.path)
    towards = projection.direction(request.along)
    if towards is not None:
        axes = [METRES.index(name.replace("_px", "_m")) for name in names]
        if not np.isclose(np.linalg.norm(towards[axes]), 1.0):
            raise InputError(
                f"--along {request.along} points out of the plane of {', '.join(names)}", file=source.path
            )
        towards = towards[axes]
    try:
        found = projection.project([measured(columns)[name] for name in names], towards)
    except ValueError as error:
        raise InputError(str(error), file=source.path) from error
    for name in [name for name in columns if _of_pose(name)]:
        del columns[name]
    rest = dict(columns)
    columns.clear()
    columns[log.TIME] = rest.pop(log.TIME)
    columns[f"x_{unit}"] = found.along
    columns.update(rest)
    return found


def _raw(name: str) -> str:
    """Name of the column of a track before it was smoothed."""
    stem, _, unit = name.partition("_")
    return f"{stem}_raw_{unit}" if stem in ("x", "y", "z", "yaw", "pitch", "roll") else ""


def _of_pose(name: str) -> bool:
    """Whether a column is a pose or follows from it."""
    stem, _, rest = name.partition("_")
    if stem in ("x", "y", "z", "yaw", "pitch", "roll"):
        return bool(rest)
    return stem in _POSE_SPEEDS and rest.replace("sd_", "") in ("m_s", "px_s", "m_s2", "px_s2")
