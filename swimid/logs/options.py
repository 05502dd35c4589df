"""The options of ``import`` and ``plot``."""

from __future__ import annotations

import math
from typing import Any, Self

from pydantic import model_validator

from swimid.errors import UsageError
from swimid.options import Options, Source, option


class ImportOptions(Options):
    """What the import of a log can be told."""

    map_path: Source = option(None, flag="--map", recorded=False, help="Mapping file (swimid-mapping/1).")
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

    @model_validator(mode="after")
    def _can_be_meant(self) -> Self:
        if self.start_s is not None and self.end_s is not None and self.end_s <= self.start_s:
            raise UsageError(f"--end {self.end_s:g} lies before --start {self.start_s:g}")
        if self.scale is not None and not (math.isfinite(self.scale) and self.scale > 0):
            raise UsageError(f"--scale {self.scale:g}: a pixel has a positive size in metres")
        if self.stroke_hz is not None and not 0 < self.stroke_hz[0] < self.stroke_hz[1]:
            raise UsageError("--stroke takes two frequencies in Hz, the lower first")
        if self.along is not None:
            from swimid.logs import projection

            try:
                projection.direction(self.along)
            except ValueError as error:
                raise UsageError(f"--along: {error}") from error
        return self

    def settings(self, **found: Any) -> dict[str, Any]:
        """The options as the provenance records them, without those that were not given."""
        return {key: value for key, value in super().settings(**found).items() if value is not None}


class ImportCommandOptions(ImportOptions):
    """What the command ``import`` can be told."""

    guess: bool = option(False, recorded=False, help="Write a mapping drafted from names and values instead.")


class PlotOptions(Options):
    """What ``plot`` can be told."""

    title: str | None = option(None, help="Title above the figures.")
