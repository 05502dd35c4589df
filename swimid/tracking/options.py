"""Options of the commands ``track video`` and ``track setup``."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Self

from pydantic import model_validator

from swimid.errors import UsageError
from swimid.options import Options, Source, option

#: Pattern of the name of a marker.
NAME = re.compile("[A-Za-z][A-Za-z0-9_-]{0,39}")


def _rate() -> Any:
    return option(None, gt=0, lt=math.inf, help="True frame rate in Hz, if that of the container is wrong.")


class TrackVideoOptions(
    Options,
    argument="VIDEO",
    output="The log, CSV or Parquet by its ending.",
    required=True,
    beside=(".evidence.json", ".png"),
    makes="log",
    metrics=("found_share",),
):
    """Track coloured markers in a film, and write a log of pose and speeds.

    VIDEO is a film, or, with --fps, a folder of pictures or a pattern of their names.
    Writes the log, its evidence (<stem>.evidence.json) and a plot (<stem>.png). Prints path speed, steady
    speed, frequency and amplitudes of the stroke, and accelerations, each with its 95 % interval.

    Example:
      swimid track video pool.mp4 --setup setup.yaml -o run.csv --overlay overlay.mp4
      swimid track video frames/%05d.png --fps 30 --setup setup.yaml -o run.csv
    """

    setup: Source = option(help="Setup file (swimid-setup/1).")
    overlay_path: Path | None = option(
        None,
        flag="--overlay",
        written=True,
        recorded=False,
        help="Also write the film with the track drawn in.",
    )
    fps: float | None = _rate()
    max_gap_s: float | None = option(
        None,
        ge=0,
        lt=math.inf,
        flag="--max-gap",
        help="Longest gap to interpolate, s  [default: that of the setup].",
    )
    from_s: float | None = option(
        None, flag="--from", help="Start of the window for speeds and stroke, s  [default: the steady part]."
    )
    to_s: float | None = option(None, flag="--to", help="End of that window, s. The log holds every frame.")

    @model_validator(mode="after")
    def _window(self) -> Self:
        for name, value in (("--from", self.from_s), ("--to", self.to_s)):
            if value is not None and not 0 <= value < math.inf:
                raise UsageError(f"{name} {value:g} must not be negative")
        if self.from_s is not None and self.to_s is not None and self.to_s <= self.from_s:
            raise UsageError(f"--from {self.from_s:g} must be before --to {self.to_s:g}")
        return self


@dataclass(frozen=True)
class Pick:
    """Name of a marker that the user picks in a frame, and the position of one of its pixels, px.

    Picks with the same name are several markers that look alike.
    """

    name: str
    x: float
    y: float

    def __post_init__(self) -> None:
        if not NAME.fullmatch(self.name):
            raise UsageError(
                f"a marker cannot be named '{self.name}'",
                hint="a name begins with a letter, and has at most 40 letters, digits, _ and -",
            )

    @classmethod
    def of_text(cls, text: str, flag: str) -> Self:
        """Return the picked marker that a text such as ``red@320,240`` describes.

        Raises
        ------
        UsageError
            The text does not have the form NAME@X,Y.
        """
        name, _, place = text.partition("@")
        try:
            x, y = (float(part) for part in place.split(","))
        except ValueError:
            name = ""
        if not name:
            example = "a name and a pixel, such as red@320,240"
            raise UsageError(f"{flag}: '{text}' is not {example}")
        return cls(name, x, y)


class TrackCameraOptions(Options, argument="PICTURE...", required=True, makes="camera"):
    """Calibrate a camera and its lens from pictures of a checkerboard.

    PICTURE is a picture, or a folder of them. Take ten or more in the mode in which the camera films, with
    the whole board in view, tilted to all sides, and in all parts of the picture.

    Example:
      swimid track camera board/*.png --squares 9x6 --square-mm 25 -o camera.yaml
      swimid track setup pool.mp4 --camera camera.yaml -o setup.yaml
    """

    squares: str = option(
        metavar="NxM", help="Number of squares along both sides of the board (not of inner corners)."
    )
    square_mm: float = option(gt=0, lt=math.inf, help="Side of a square, mm.")

    @model_validator(mode="after")
    def _two_sides(self) -> Self:
        if not re.fullmatch(r"\d{1,3}x\d{1,3}", self.squares) or min(self.board) < 3:
            text = f"--squares '{self.squares}' does not state two numbers of squares, each 4 or more"
            raise UsageError(text, hint="count the squares along both sides of the board: --squares 9x6")
        return self

    @property
    def board(self) -> tuple[int, int]:
        """Number of inner corners along both sides of the board."""
        across, down = self.squares.split("x")
        return int(across) - 1, int(down) - 1


class TrackSetupOptions(
    Options,
    argument="VIDEO",
    output="The setup file to write.",
    required=True,
    beside=(".markers.png",),
    makes="setup",
):
    """Draft a setup from a film: propose markers, draw them, and write a YAML file to edit.

    The file can be used as it is. Without --pick the command needs no display and no input. With --pick, a
    page in the browser shows the film: click on markers and on points of known distance, try the setup, and
    write it.

    Example:
      swimid track setup pool.mp4 -o setup.yaml
      swimid track setup pool.mp4 --pick -o setup.yaml
      swimid track setup pool.mp4 --marker nose@412,230 --marker tail@371,236 -o setup.yaml
    """

    picks: tuple[Pick, ...] = option(
        (),
        flag="--marker",
        metavar="NAME@X,Y",
        help="One pixel of a marker of any colour or shade; head first, then tail. "
        "Equal markers have one name.",
    )
    background: bool = option(False, help="Follow a whole body by its difference from the empty scene.")
    frame: int = option(0, ge=0, help="Frame of the --marker pixels.")
    metres_per_pixel: float | None = option(None, gt=0, help="Scale: metres per pixel.")
    camera: Source | None = option(None, help="Camera file of track camera, for the lens.")
    plane: Literal["horizontal", "vertical"] = option("horizontal", help="Camera above, or at the side.")
    fps: float | None = _rate()
    pick: bool = option(False, recorded=False, help="Pick markers and scale in a page of the browser.")
    port: int | None = option(
        None, ge=1, le=65535, recorded=False, help="Port of the page of --pick  [default: any free port]."
    )
    browser: bool = option(
        True, flag="--browser/--no-browser", recorded=False, help="Open the page of --pick in the browser."
    )

    @model_validator(mode="after")
    def _one_method(self) -> Self:
        if self.background and self.picks:
            raise UsageError("--background and --marker contradict each other: give one of them")
        for flag, given in (("--port", self.port is not None), ("--no-browser", not self.browser)):
            if given and not self.pick:
                raise UsageError(f"{flag} is an option of the page that --pick opens", hint="add --pick")
        return self
