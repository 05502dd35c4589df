"""The options of ``track video`` and ``track setup``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Self

from swimid.errors import UsageError
from swimid.options import Options, Source, option


class TrackVideoOptions(Options):
    """What ``track video`` can be told."""

    setup: Source = option(help="Setup file (swimid-setup/1).")
    overlay_path: Path | None = option(
        None, flag="--overlay", written=True, help="Also write the video with the track drawn in."
    )
    fps: float | None = option(None, help="True frame rate in Hz, where the container's is wrong.")
    max_gap_s: float | None = option(
        None, flag="--max-gap", help="Longest dropout to bridge, s  [default: the setup's]."
    )
    from_s: float | None = option(
        None, flag="--from", help="Speeds and stroke from here on, s  [default: over the steady part]."
    )
    to_s: float | None = option(
        None, flag="--to", help="Speeds and stroke up to here, s. The log holds every frame."
    )


@dataclass(frozen=True)
class Pick:
    """A marker shown by hand: its name and one of its pixels. Several of one name look alike."""

    name: str
    x: float
    y: float

    @classmethod
    def of_text(cls, text: str, flag: str) -> Self:
        """Read ``red@320,240``.

        Raises
        ------
        UsageError
            For anything else.
        """
        name, _, place = text.partition("@")
        try:
            x, y = (float(part) for part in place.split(","))
        except ValueError:
            name = ""
        if not name:
            raise UsageError(f"{flag}: '{text}' must look like red@320,240")
        return cls(name, x, y)


class TrackSetupOptions(Options):
    """What ``track setup`` can be told."""

    picks: tuple[Pick, ...] = option(
        (),
        flag="--marker",
        metavar="NAME@X,Y",
        help="Pick a marker of any shade by one of its pixels; head first, then tail. "
        "Equal markers: one name.",
    )
    frame: int = option(0, help="Frame the --marker pixels are in.")
    metres_per_pixel: float | None = option(None, help="Scale as a factor.")
    scale_points: tuple[float, float, float, float] | None = option(
        None, help="Scale: pixels X1 Y1 X2 Y2 of two points."
    )
    scale_distance_m: float | None = option(None, help="Their distance in metres.")
    plane: Literal["horizontal", "vertical"] = option("horizontal", help="Camera above, or at the side.")
    fps: float | None = option(None, help="True frame rate in Hz, where the container's is wrong.")
