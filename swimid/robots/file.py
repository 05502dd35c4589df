"""The robot file (``swimid-robot/1``): everything known of a robot before any fit.

Built-in robots lie in ``swimid/robots`` as YAML; a user's own is a YAML file and needs no
code.
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, PositiveFloat

from swimid.errors import InputError, UsageError, nearest
from swimid.files import yamlio
from swimid.robots.planar import Multilink, Reading
from swimid.robots.spatial import Multibody

FORMAT = "swimid-robot/1"
NonNegative = Annotated[float, Field(ge=0)]


class Fluid(yamlio.Document):
    """The water, and the gravity it lies in."""

    density_kg_m3: PositiveFloat = 997.0
    gravity_m_s2: PositiveFloat = 9.81


class Body(yamlio.Document):
    """The body as one rigid piece."""

    inertial_mass_kg: NonNegative | None = None
    frontal_area_m2: PositiveFloat | None = None
    length_m: PositiveFloat | None = None
    width_m: PositiveFloat | None = None
    height_m: PositiveFloat | None = None
    roll_inertia_kg_m2: NonNegative | None = None
    pitch_inertia_kg_m2: NonNegative | None = None
    yaw_inertia_kg_m2: NonNegative | None = None


class Rig(yamlio.Document):
    """The test rig the robot is pulled or held by."""

    pulley_inertia_kg: NonNegative = 0.0
    encoder_resolution_m: PositiveFloat | None = None
    stiffness_N_m: NonNegative | None = None
    roll_stiffness_N_m_rad: NonNegative | None = None
    pitch_stiffness_N_m_rad: NonNegative | None = None
    yaw_stiffness_N_m_rad: NonNegative | None = None
    #: m g l of a pendulum or m g GM of a ship, whose restoring moment goes with the sine of the angle.
    roll_gravity_stiffness_N_m_rad: NonNegative | None = None
    pitch_gravity_stiffness_N_m_rad: NonNegative | None = None


class Theory(yamlio.Document):
    """An estimate from theory or tables, to put beside a measured parameter."""

    parameter: str
    value: float
    unit: str
    basis: str
    source: str = ""


class Fin(yamlio.Document):
    """A caudal fin; a rectangle's inertia follows from its size, another shape's is given."""

    shape: Literal["rectangle", "other"] = "rectangle"
    height_m: PositiveFloat
    length_m: PositiveFloat
    axle_gap_m: NonNegative = 0.0
    area_m2: PositiveFloat | None = None
    hydrodynamic_inertia_kg_m2: PositiveFloat | None = None


class Robot(yamlio.Document):
    """A robot file: what is known of a robot before any fit.

    Attributes
    ----------
    name, description : str
    sources : list of str
        The papers its numbers come from.
    fluid : Fluid
        ``density_kg_m3``, ``gravity_m_s2``.
    body : Body
        The body as one rigid piece: ``inertial_mass_kg``, ``frontal_area_m2``, ``length_m``, ...
    rig : Rig
        The test rig: ``pulley_inertia_kg``, ``stiffness_N_m``, ...
    fins : dict of str to Fin
    theory : list of Theory
        Values that theory gives, to compare estimates with.
    multilink, multibody : Multilink, Multibody or None
        Links, joints and elements of a robot in a plane, and of one in space.
    readings : dict of str to Reading
        Ambiguities of the sources and how each is read.
    """

    format: Literal["swimid-robot/1"]
    name: str
    description: str = ""
    sources: list[str] = []
    fluid: Fluid = Fluid()
    body: Body = Body()
    rig: Rig = Rig()
    fins: dict[str, Fin] = {}
    theory: list[Theory] = []
    #: Links, joints and elements of a planar multi-link robot.
    multilink: Multilink | None = None
    #: Links, hinges and elements of a robot that moves in space.
    multibody: Multibody | None = None
    #: Ambiguities of the source and the reading chosen for each.
    readings: dict[str, Reading] = {}

    def marker_places(self, plane: Literal["horizontal", "vertical"]) -> dict[str, tuple[float, float]]:
        """Markers seen from the reference point: forward, and to port (up in the vertical plane), m."""
        if self.multibody is not None:
            aside = 1 if plane == "horizontal" else 2
            origin = self.multibody.reference.at_m
            return {
                name: (marker.at_m[0] - origin[0], marker.at_m[aside] - origin[aside])
                for name, marker in self.multibody.markers.items()
            }
        if self.multilink is not None:
            start = self.multilink.reference
            return {
                name: (start.station_m - marker.station_m, marker.offset_m - start.offset_m)
                for name, marker in self.multilink.markers.items()
            }
        return {}


def built_in() -> list[str]:
    """Names of the robots that ship with swimid."""
    folder = resources.files("swimid") / "robots"
    return sorted(item.name.removesuffix(".yaml") for item in folder.iterdir() if item.name.endswith(".yaml"))


def locate(name: str, relative_to: Path | None = None) -> Path:
    """Path of a robot given by built-in name or by file.

    Raises
    ------
    InputError
        When it is neither; names the built-in robots.
    """
    if name in built_in():
        return Path(str(resources.files("swimid") / "robots" / f"{name}.yaml"))
    path = Path(name) if relative_to is None or Path(name).is_absolute() else relative_to / name
    if path.is_file():
        return path
    close = nearest(name, built_in())
    hint = f"did you mean '{close}'? " if close else ""
    raise InputError(
        f"there is no robot '{name}'",
        file=None if path.suffix not in (".yaml", ".yml") else path,
        hint=f"{hint}built-in robots: {', '.join(built_in())}; or give the path of a robot file",
    )


def read(name: str, relative_to: Path | None = None, *, readings: Mapping[str, str] | None = None) -> Robot:
    """Read a robot by built-in name, or by path relative to ``relative_to``.

    Parameters
    ----------
    readings : mapping of reading to option, optional
        Other readings of the source's ambiguities than those the file chooses.

    Raises
    ------
    InputError
        For anything wrong in the file.
    UsageError
        For a reading or an option that is not there.
    """
    return RobotFile(locate(name, relative_to)).read(readings or {})


class RobotFile:
    """A robot file, to be read in one way after another.

    Parameters
    ----------
    path : Path
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._data = yamlio.load(path)
        self._written = yamlio.validate(self._data, Robot, path)

    def read(self, readings: Mapping[str, str]) -> Robot:
        """The robot with other readings than those the file chooses (see :func:`read`)."""
        written, path = self._written.readings, self.path
        chosen = {key: reading.chosen for key, reading in written.items()}
        for key, option in readings.items():
            if key not in chosen or option not in written[key].options:
                known = list(chosen) if key not in chosen else list(written[key].options)
                what = f"reading '{key}'"
                if key in chosen:
                    what = f"option '{option}' of the {what}"
                raise UsageError(
                    f"the robot '{self._written.name}' has no {what}",
                    hint=f"there are: {', '.join(known) or 'none'}",
                )
            chosen[key] = option
        changes = {
            k: v for key, option in chosen.items() for k, v in written[key].options[option].set.items()
        }
        if not changes and all(written[key].chosen == option for key, option in chosen.items()):
            return self._written
        patched = yamlio.plain(self._data)
        for place, value in changes.items():
            try:
                _put(patched, place, value, path)
            except InputError as error:
                key = next(k for k, option in chosen.items() if place in written[k].options[option].set)
                where = f"readings.{key}.options.{chosen[key]}"
                raise located(InputError(error.reason, column=where), path) from error
        for key, option in chosen.items():
            patched["readings"][key]["chosen"] = option
        return yamlio.validate(patched, Robot, path)


def _put(data: Any, place: str, value: Any, path: Path) -> None:
    """Set a dotted path; members of lists go by their name or their number."""
    *way, last = place.split(".")
    for part in way:
        data = data[_key(data, part, place, path)]
    if isinstance(data, list):
        data[_key(data, last, place, path)] = value
    elif value is None:
        data.pop(last, None)
    else:
        data[last] = value


def _key(data: Any, part: str, place: str, path: Path) -> Any:
    key = _member(data, part)
    if key is None:
        raise InputError(
            f"a reading changes '{place}', but there is no '{part}'", file=path, column="readings"
        )
    return key


def _member(data: Any, part: str) -> Any:
    """Key or number of a member, of a list by its name or its number; None where there is no such member."""
    if isinstance(data, list):
        named = [i for i, m in enumerate(data) if isinstance(m, dict) and m.get("name") == part]
        index = named[0] if named else int(part) if part.isdigit() else len(data)
        return index if index < len(data) else None
    return part if isinstance(data, dict) and part in data else None


def located(error: InputError, path: Path) -> InputError:
    """The same error with its file and line, from the dotted path in its ``column``."""
    whole = data = yamlio.load(path)
    location: list[str | int] = []
    for part in (error.column or "").split("."):
        key = _member(data, part)
        if key is None:
            break
        location.append(key)
        data = data[key]
    line = yamlio.line_of(whole, location)
    return InputError(error.reason, file=path, line=line, column=error.column, hint=error.hint)
