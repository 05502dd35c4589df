"""Setup file of a film, ``swimid-setup/1``: markers, camera and scale.

One setup file serves all films that are taken with the same camera and lights. ``swimid track setup`` drafts
the file from a film, and ``docs/tracking.md`` explains each key with an example.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, model_validator

from swimid.errors import InputError
from swimid.files import yamlio
from swimid.files.tabular import find_repeated
from swimid.files.yamlio import Document
from swimid.points.scale import Camera, Point, Points, Positive, Scale

FORMAT = "swimid-setup/1"

#: Type of a rectangle in the picture: position of its left, top, right and bottom side, px.
Box = tuple[float, float, float, float]


def _check_order(value: tuple[float, float]) -> tuple[float, float]:
    if value[0] > value[1]:
        raise ValueError(f"[{value[0]:g}, {value[1]:g}] must be [smallest, largest]")
    return value


_Fraction = Annotated[float, Field(ge=0, le=1)]
_Span = Annotated[tuple[_Fraction, _Fraction], AfterValidator(_check_order)]
_Area = Annotated[tuple[Positive, Positive], AfterValidator(_check_order)]
_Hue = Annotated[float, Field(ge=0, le=360)]


class HsvRange(Document):
    """Range of colours in hue (degrees), saturation and value (0 to 1).

    Hue is an angle. Therefore the range ``[345, 15]`` contains red at 0 degrees.
    """

    hue_deg: tuple[_Hue, _Hue] = (0.0, 360.0)
    saturation: _Span = (0.0, 1.0)
    value: _Span = (0.0, 1.0)


class Marker(Document):
    """Entry of a setup file for one kind of marker: colour, number of markers, and area in the picture."""

    name: Annotated[str, Field(max_length=40, pattern="^[A-Za-z][A-Za-z0-9_-]*$")]
    #: Method by which the marker is found. ``colour`` searches for the colour range ``hsv``. ``background``
    #: needs no colour: it follows the whole body, which differs from the empty scene.
    method: Literal["colour", "background"] = "colour"
    hsv: HsvRange | None = None
    number: Annotated[int, Field(ge=1, le=20)] = 1
    area_px: _Area | None = None
    #: Position of each marker of this kind in the first frame, px. The positions assign names to markers that
    #: look alike.
    start_px: Points | None = None
    #: Position of the marker on the robot, relative to the reference point: forward, and to port (up in the
    #: vertical plane), m.
    at_m: Point | None = None

    @model_validator(mode="after")
    def _keys_fit(self) -> Marker:
        if self.method == "background" and (self.hsv is not None or self.number > 1):
            raise ValueError(
                f"marker '{self.name}' has 'method: background': omit its hsv, and set 'number: 1'"
            )
        if self.method == "colour" and self.hsv is None:
            raise ValueError(f"marker '{self.name}' needs hsv")
        if self.start_px is not None and len(self.start_px) != self.number:
            text = f"marker '{self.name}' has number {self.number} and {len(self.start_px)} start points"
            raise ValueError(text)
        return self

    @property
    def names(self) -> list[str]:
        """Names of the tracked points of this kind of marker.

        A single marker has the name of its kind. Several markers have numbered names (name1, name2, ...). A
        silhouette has two points: its centre has the name of the kind, and its rear point has the ending
        ``_rear``.
        """
        if self.method == "background":
            return [self.name, f"{self.name}_rear"]
        return [self.name] if self.number == 1 else [f"{self.name}{i + 1}" for i in range(self.number)]


class Setup(Document):
    """Content of a setup file, which describes the films of one camera."""

    format: Literal["swimid-setup/1"]
    markers: Annotated[list[Marker], Field(min_length=1, max_length=20)]
    #: Names of the head marker and of the tail marker behind it. The path in the log is that of the head
    #: marker. With a single kind of marker, the first marker is the default head and a tail is not needed.
    head: str | None = None
    tail: str | None = None
    plane: Literal["horizontal", "vertical"] = "horizontal"
    #: Direction in the picture in which the robot faces, for a camera at its side. In the log, x increases in
    #: this direction.
    facing: Literal["auto", "right", "left"] = "auto"
    #: Direction in which the robot swims. A check fails if the robot moves in the opposite direction over
    #: most of its path.
    swims: Literal["head-first", "tail-first"] = "head-first"
    #: Robot file that states the position of each marker without ``at_m``. The robot file must have a marker
    #: of the same name.
    robot: str | None = None
    #: Scale from pixels to metres; without a scale, positions are in pixels.
    scale: Scale | None = None
    camera: Camera | None = None
    #: Frame rate of the film, Hz. It replaces the time stamps in the container.
    frame_rate_hz: Positive | None = None
    #: Maximum duration of a gap in the track that is interpolated, s.
    max_gap_s: Annotated[float, Field(ge=0)] = 1.0
    #: Boxes of the picture in which no markers are searched for, each [left, top, right, bottom] in px.
    ignore_px: list[Box] = []

    @model_validator(mode="after")
    def _names_fit(self) -> Setup:
        names = self.marker_names
        twice = find_repeated(names)
        if twice is not None:
            raise ValueError(f"two markers are named '{twice}': rename one marker")
        for role, chosen in (("head", self.head), ("tail", self.tail)):
            if chosen is not None and chosen not in names:
                raise ValueError(f"{role} '{chosen}' is no marker; the markers are: {', '.join(names)}")
        if self.tail is not None and self.head in (None, self.tail):
            raise ValueError(
                f"tail is '{self.tail}', and head is missing or the same marker: give two different markers"
            )
        if len(self.markers) > 1 and any(marker.method == "background" for marker in self.markers):
            text = f"method: background allows one marker, but the setup has {', '.join(names)}"
            raise ValueError(f"{text}: keep one marker, or choose another method")
        if self.head is None and len(self.markers) > 1:
            text = "no marker is the head: give head, and tail for a heading. The markers are"
            raise ValueError(f"{text}: {', '.join(names)}")
        if self.facing != "auto" and self.plane == "horizontal":
            raise ValueError(
                f"'facing: {self.facing}' is valid only with 'plane: vertical', not with '{self.plane}'"
            )
        return self

    @model_validator(mode="after")
    def _boxes_fit(self) -> Setup:
        for box in self.ignore_px:
            if box[2] <= box[0] or box[3] <= box[1]:
                raise ValueError(f"box {list(box)} has no area; a box is [left, top, right, bottom]")
        return self

    @model_validator(mode="after")
    def _places_fit(self) -> Setup:
        if self.robot is None and all(marker.at_m is None for marker in self.markers):
            return self
        if self.tail is None or self.scale is None:
            raise ValueError("at_m of the markers (or robot) needs a head, a tail and a scale")
        head, tail = (self.marker(name) for name in self.roles)
        for marker in (head, tail):
            if marker.at_m is None and self.robot is None:
                text = f"marker '{marker.name}' needs at_m, too: head and tail both have it or none"
                raise ValueError(text)
        if head.at_m is not None and head.at_m == tail.at_m:
            raise ValueError(f"markers '{self.head}' and '{self.tail}' have the same at_m {list(head.at_m)}")
        return self

    @property
    def name(self) -> str:
        """Name that the provenance of a result states for a setup that was not read from a file."""
        return "setup"

    @property
    def marker_names(self) -> list[str]:
        """Names of all markers, in the order of the file."""
        return [name for marker in self.markers for name in marker.names]

    @property
    def head_name(self) -> str:
        """Name of the head marker. The path in the log is that of this marker."""
        return self.head or self.marker_names[0]

    @property
    def roles(self) -> list[str]:
        """Names of the markers from which the pose is computed: head marker, and tail marker if it exists."""
        return [self.head_name] if self.tail is None else [self.head_name, self.tail]

    @property
    def axes(self) -> tuple[str, str, str]:
        """Column names of second coordinate, heading, and velocity across the heading in the log."""
        return ("y", "yaw", "v") if self.plane == "horizontal" else ("z", "pitch", "w")

    def marker(self, name: str) -> Marker:
        """Return the entry of the setup that describes a marker of the given name."""
        return next(marker for marker in self.markers if name in marker.names)

    @property
    def places(self) -> tuple[Point, Point] | None:
        """Positions of head and tail marker on the robot (``at_m``), m; None if they are unknown."""
        known = [at for at in (self.marker(name).at_m for name in self.roles) if at is not None]
        return (known[0], known[1]) if len(known) > 1 else None


def read_setup(given: str | Path | Setup | Mapping[str, Any]) -> Setup:
    """Return a checked setup from a setup file, a ``Setup``, or a dictionary with the keys of a setup file.

    Raises
    ------
    InputError
        See :func:`read`.
    """
    if isinstance(given, str | Path):
        return read(given)
    data = given.model_dump(mode="json", exclude_none=True) if isinstance(given, Setup) else given
    return _complete({"format": FORMAT, **data}, Path("setup"))


def read(path: str | Path) -> Setup:
    """Read and check a setup file, and add the marker positions from the robot file that ``robot`` names.

    Raises
    ------
    InputError
        A key is missing, unknown or has a value that is not allowed. The message names its line.
    """
    return _complete(yamlio.load(path), Path(path))


def _complete(data: Mapping[str, Any], path: Path) -> Setup:
    setup = yamlio.validate(data, Setup, path)
    if setup.plane == "vertical" and setup.tail is None and len(setup.markers) > 1:
        text = "plane: vertical with several markers needs a tail for the pitch"
        raise InputError(text, file=path, column="tail")
    if setup.robot is None:
        return setup
    filled = yamlio.plain(data)
    places = _robot_places(setup, setup.robot, path)
    for marker in filled["markers"]:
        if marker.get("at_m") is None and marker["name"] in places:
            marker["at_m"] = list(places[marker["name"]])
    return yamlio.validate(filled, Setup, path)


def _robot_places(setup: Setup, name: str, path: Path) -> dict[str, tuple[float, float]]:
    """Return the marker positions that a robot file states, m, by name of the marker.

    Raise an error if the file does not state the position of the head or tail marker.
    """
    from swimid.robots import file as robot_format

    def refuse(text: str, hint: str | None = None) -> InputError:
        return InputError(f"the robot '{name}' {text}", file=path, column="robot", hint=hint)

    robot = robot_format.read(str(robot_format.locate(name, path.parent, {"file": path, "column": "robot"})))
    if robot.multilink is not None and robot.multilink.plane != setup.plane:
        raise refuse(f"moves in the {robot.multilink.plane} plane, but the film shows another plane")
    places = robot.marker_places(setup.plane)
    for marker in (setup.marker(role) for role in setup.roles):
        if marker.at_m is None and marker.name not in places:
            text = f"names no marker '{marker.name}'; the robot names: {', '.join(places) or 'none'}"
            raise refuse(text, "name the markers of the film as in the robot file, or give at_m of each")
    return places
