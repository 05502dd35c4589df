"""The options of ``import`` and ``plot``."""

from __future__ import annotations

import contextlib
import math
from typing import Any, Self

from pydantic import model_validator

from swimid.errors import UsageError
from swimid.options import Options, Source, option


class ImportOptions(Options):
    """Options of the import of a log."""

    map_path: Source = option(None, flag="--map", recorded=False, help="Mapping file (swimid-mapping/1).")
    profile: str | None = option(
        None,
        flag="--as",
        metavar="PROFILE",
        help="Format of the file: ardupilot, deeplabcut, dynamixel, opensim, px4, ros2, sleap, swimid, "
        "tracker  [default: recognised by its content].",
    )
    select: str | None = option(
        None,
        metavar="NAME",
        help="Track, individual, instance, topic or message type to take, if the file holds several.",
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
    clean: bool | None = option(
        None,
        flag="--clean/--raw",
        help="Take repeats and jumps out of the track, or keep all  "
        "[default: clean a track of two coordinates].",
    )
    start_s: float | None = option(None, flag="--start", help="Keep the log from here, s on its own clock.")
    end_s: float | None = option(None, flag="--end", help="Keep the log up to here, s.")
    along: str | None = option(
        None,
        metavar="LINE",
        help="Put the way along a line in the place of the track, as x_m: line (the one it keeps closest "
        "to), x, -y, z, or components as in 0.6,-0.8.",
    )
    scale: float | None = option(
        None,
        metavar="M_PER_PX",
        recorded="metres_per_pixel",
        help="Metres a pixel, for a track in pixels.",
    )
    stroke_hz: tuple[float, float] | None = option(
        None,
        flag="--stroke",
        metavar="LOW HIGH",
        help="Frequencies between which the stroke is known to lie, Hz.",
    )

    @property
    def stated(self) -> dict[str, Any]:
        """What was stated about the file beside its mapping, without what was not given."""
        names = {"profile", "select", "rate_hz", "length_unit", "min_likelihood"}
        return self.model_dump(include=names, exclude_none=True)

    @model_validator(mode="after")
    def _can_be_meant(self) -> Self:
        if self.start_s is not None and self.end_s is not None and self.end_s <= self.start_s:
            raise UsageError(f"--end {self.end_s:g} lies before --start {self.start_s:g}")
        if self.scale is not None and not (math.isfinite(self.scale) and self.scale > 0):
            raise UsageError(f"--scale {self.scale:g}: a pixel has a positive size in metres")
        if self.stroke_hz is not None and not 0 < self.stroke_hz[0] < self.stroke_hz[1]:
            raise UsageError("--stroke takes two frequencies in Hz, the lower first")
        if self.along is not None:
            direction(self.along)
        return self

    def settings(self, **found: Any) -> dict[str, Any]:
        """The options as the provenance records them, without those that were not given."""
        return {key: value for key, value in super().settings(**found).items() if value is not None}


def direction(text: str) -> tuple[float, ...] | None:
    """Return the unit vector that a text names: ``x``, ``-y``, ``0.6,-0.8``; None for ``line``.

    Raises
    ------
    UsageError
        It names none.
    """
    if text == "line":
        return None
    parts: list[float] = []
    if text[-1:] in ("x", "y", "z") and text[:-1] in ("", "-", "+"):
        parts = [float(f"{text[:-1]}1") * (axis == text[-1]) for axis in "xyz"]
    with contextlib.suppress(ValueError):
        parts = parts or [float(part) for part in text.split(",")]
    if len(parts) not in (2, 3) or not all(map(math.isfinite, parts)) or not any(parts):
        hint = "give line, x, -y, z or components as in 0.6,-0.8"
        raise UsageError(f"--along: '{text}' is no direction", hint=hint)
    return tuple(part / math.hypot(*parts) for part in [*parts, 0.0][:3])


class PlotOptions(
    Options,
    command="plot",
    section="Publish",
    argument="LOG...",
    output="The picture: .html, .svg or .png.",
    required=True,
    beside=(),
):
    """Draw logs: channels, track from above, spectra; several over each other.

    Examples:
      swimid plot run.csv -o run.png
      swimid plot imu.csv camera.csv -o both.html
    """

    title: str | None = option(None, help="Title above the figures.")
