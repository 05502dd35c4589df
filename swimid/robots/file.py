"""Robot file (``swimid-robot/1``) with the known properties of a robot: its format, and how it is read.

Properties are known if they need no fit, such as masses and lengths. Built-in robots are YAML files in
``swimid/robots``. A user can describe another robot in a YAML file, without writing code.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import Field, PositiveFloat, create_model, model_validator

from swimid.errors import InputError, UsageError, suggestion
from swimid.files import yamlio

if TYPE_CHECKING:
    from swimid.robots.planar import MultilinkRobot
    from swimid.robots.spatial import MultibodyRobot
else:
    # The function schema_of replaces these types of the fields multilink and multibody. It imports the
    # modules of the types only if a robot file has the field.
    MultilinkRobot = MultibodyRobot = Any

FORMAT = "swimid-robot/1"
NonNegative = Annotated[float, Field(ge=0)]


class Fluid(yamlio.Document):
    """Density of the water in which the robot swims, and acceleration of gravity."""

    density_kg_m3: PositiveFloat = 997.0
    gravity_m_s2: PositiveFloat = 9.81


class Body(yamlio.Document):
    """Masses, dimensions and moments of inertia of a robot that is regarded as a single rigid body."""

    inertial_mass_kg: PositiveFloat | None = None
    #: Frontal area, m2. Without it a fit estimates the coefficient of quadratic drag in place of the drag
    #: coefficient.
    frontal_area_m2: PositiveFloat | None = None
    #: Length, width and height give the added mass of a box, for comparison in reports.
    length_m: PositiveFloat | None = None
    width_m: PositiveFloat | None = None
    height_m: PositiveFloat | None = None
    roll_inertia_kg_m2: PositiveFloat | None = None
    pitch_inertia_kg_m2: PositiveFloat | None = None
    yaw_inertia_kg_m2: PositiveFloat | None = None


class TestRig(yamlio.Document):
    """Properties of the test rig that pulls the robot or holds it by a spring."""

    pulley_inertia_kg: NonNegative = 0.0
    encoder_resolution_m: PositiveFloat | None = None
    stiffness_N_m: NonNegative | None = None
    roll_stiffness_N_m_rad: NonNegative | None = None
    pitch_stiffness_N_m_rad: NonNegative | None = None
    yaw_stiffness_N_m_rad: NonNegative | None = None
    #: Stiffness of the restoring moment of gravity in roll: the product m g l of mass, gravity and length of
    #: a pendulum, or m g GM with the metacentric height GM of a ship. The restoring moment is this product
    #: times the sine of the roll angle.
    roll_gravity_stiffness_N_m_rad: NonNegative | None = None
    pitch_gravity_stiffness_N_m_rad: NonNegative | None = None


class Theory(yamlio.Document):
    """Value of a parameter from theory or published tables, which reports compare with its estimate."""

    parameter: str
    value: float
    unit: str
    basis: str
    source: str = ""


class Fin(yamlio.Document):
    """Dimensions and hydrodynamic moment of inertia of a caudal fin.

    The moment of inertia of a rectangular fin is computed from its size. For a fin of another shape it must
    be given.
    """

    shape: Literal["rectangle", "other"] = "rectangle"
    height_m: PositiveFloat
    length_m: PositiveFloat
    axle_gap_m: NonNegative = 0.0
    area_m2: PositiveFloat | None = None
    hydrodynamic_inertia_kg_m2: PositiveFloat | None = None


class ReadingOption(yamlio.Document):
    """Possible interpretation of an ambiguous statement in the source of a robot file.

    ``says`` describes the interpretation, and ``set`` has the entries of the file that it changes.
    """

    says: str
    #: New values of the entries of the robot file that this interpretation changes. The key is a dotted path,
    #: such as ``elements.0.axial_area_m2``. A member of a list is addressed by its name or index.
    set: dict[str, Any] = {}


class Reading(yamlio.Document):
    """Ambiguity in the source of a robot file, with its possible and its chosen interpretation."""

    question: str
    chosen: str
    options: dict[str, ReadingOption]

    @model_validator(mode="after")
    def _check_choice(self) -> Reading:
        if self.chosen not in self.options:
            raise ValueError(f"'{self.chosen}' is not an option; the options are: {', '.join(self.options)}")
        return self


class Robot(yamlio.Document):
    """Content of a robot file: the known properties of a robot before any fit.

    Example::

        format: swimid-robot/1
        name: my-fish
        sources: ["weighed and measured, 3 May"]
        body: {inertial_mass_kg: 1.2, length_m: 0.26, width_m: 0.1, height_m: 0.14}
        rig: {pulley_inertia_kg: 0.02, encoder_resolution_m: 0.00785}
        fins: {large: {shape: rectangle, height_m: 0.0875, length_m: 0.0437, axle_gap_m: 0.007}}

    Attributes
    ----------
    name, description : str
    sources : list of str
        Papers from which the quantities in the file are taken.
    fluid : Fluid
        Density of the water and gravity: ``density_kg_m3``, ``gravity_m_s2``.
    body : Body
        Robot as a single rigid body: ``inertial_mass_kg``, ``frontal_area_m2``, ``length_m``, ...
    rig : Rig
        Test rig: ``pulley_inertia_kg``, ``stiffness_N_m``, ...
    fins : dict of str to Fin
    theory : list of Theory
        Values from theory, for comparison with estimates.
    multilink, multibody : MultilinkRobot, MultibodyRobot or None
        Links, joints and elements of a robot in a plane, and of a robot in 3-D.
    readings : dict of str to Reading
        Ambiguities of the sources, each with its chosen interpretation.
    """

    format: Literal["swimid-robot/1"]
    name: str
    description: str = ""
    sources: list[str] = []
    fluid: Fluid = Fluid()
    body: Body = Body()
    rig: TestRig = TestRig()
    fins: dict[str, Fin] = {}
    theory: list[Theory] = []
    #: Links, joints and hydrodynamic elements of a robot that moves in a plane.
    multilink: MultilinkRobot | None = None
    #: Links, hinges and hydrodynamic elements of a robot that moves in 3-D.
    multibody: MultibodyRobot | None = None
    #: Ambiguities in the sources of the robot file, each with its chosen interpretation.
    readings: dict[str, Reading] = {}

    def marker_places(self, plane: Literal["horizontal", "vertical"]) -> dict[str, tuple[float, float]]:
        """Return the positions of markers and of points of the first link, relative to the reference point.

        The positions are in m. A position has the components forward and to port, or forward and up for the
        vertical plane. The reference point is the point whose pose is logged.
        """
        if self.multibody is not None:
            aside = {"horizontal": 1, "vertical": 2}[plane]
            origin = self.multibody.reference.at_m
            return {
                name: (marker.at_m[0] - origin[0], marker.at_m[aside] - origin[aside])
                for name, marker in self.multibody.markers.items()
            }
        if self.multilink is not None:
            start, base = self.multilink.reference, self.multilink.links[0].name
            found = {
                name: (start.station_m + point.at_m[0], point.at_m[1] - start.offset_m)
                for name, point in self.multilink.points.items()
                if point.link == base
            }
            return found | {
                name: (start.station_m - marker.station_m, marker.offset_m - start.offset_m)
                for name, marker in self.multilink.markers.items()
            }
        return {}


@cache
def schema_of(parts: frozenset[str] = frozenset({"multilink", "multibody"})) -> type[Robot]:
    """Return the pydantic model of a robot file that has the given optional fields.

    The fields are ``multilink`` and ``multibody``. The modules of their types are imported only for a file
    that has them.
    """
    fields: dict[str, Any] = {}
    if "multilink" in parts:
        from swimid.robots.planar import MultilinkRobot

        fields["multilink"] = MultilinkRobot | None, None
    if "multibody" in parts:
        from swimid.robots.spatial import MultibodyRobot

        fields["multibody"] = MultibodyRobot | None, None
    return create_model("Robot", __base__=Robot, __doc__=Robot.__doc__, **fields)


def _validate(data: Mapping[str, Any], path: Path) -> Robot:
    """Validate the content of a robot file, and return it as a robot."""
    return yamlio.validate(data, schema_of(frozenset(data) & {"multilink", "multibody"}), path)


def list_built_in_robots() -> list[str]:
    """Return the names of the built-in robots."""
    folder = resources.files("swimid") / "robots"
    return sorted(item.name.removesuffix(".yaml") for item in folder.iterdir() if item.name.endswith(".yaml"))


def locate(name: str, relative_to: Path | None = None, said: Mapping[str, Any] | None = None) -> Path:
    """Return the path of a robot file, given the name of a built-in robot or the path itself.

    ``said`` states where a file names the robot, for the error: ``file``, ``line`` and ``column``.

    Raises
    ------
    InputError
        If no such robot exists.
    """
    if name in list_built_in_robots():
        return Path(str(resources.files("swimid") / "robots" / f"{name}.yaml"))
    path = Path(name) if relative_to is None or Path(name).is_absolute() else relative_to / name
    if path.is_file() or path.is_dir():
        return path
    hint = suggestion(name, list_built_in_robots(), "built-in robots")
    raise InputError(
        f"there is no robot '{name}'",
        **(said or {"file": path if path.suffix in (".yaml", ".yml") else None}),
        hint=f"{hint}; or give the path of a robot file",
    )


def read(name: str, relative_to: Path | None = None, *, readings: Mapping[str, str] | None = None) -> Robot:
    """Read a robot file, given the name of a built-in robot or a path relative to ``relative_to``.

    Parameters
    ----------
    name : str
    relative_to : Path, optional
    readings : mapping of reading to option, optional
        Interpretations of the source's ambiguities that replace those of the file.

    Raises
    ------
    InputError
        For any error in the file.
    UsageError
        For an unknown ambiguity or an unknown interpretation.
    """
    return RobotFile(locate(name, relative_to)).read(readings or {})


class RobotFile:
    """Robot file that can be read with different interpretations of its sources.

    Parameters
    ----------
    path : Path
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._data = yamlio.load(path)
        self._written = _validate(self._data, path)

    def read(self, readings: Mapping[str, str]) -> Robot:
        """Return the robot, with some interpretations of the sources replaced (see :func:`read`)."""
        written, path = self._written.readings, self.path
        chosen = {key: reading.chosen for key, reading in written.items()}
        for key, option in readings.items():
            unknown, known = f"reading '{key}'", list(chosen)
            if key in chosen:
                unknown, known = f"option '{option}' of the {unknown}", list(written[key].options)
            if (option if key in chosen else key) not in known:
                hint = suggestion(option if key in chosen else key, known)
                raise UsageError(f"the robot '{self._written.name}' has no {unknown}", hint=hint)
            chosen[key] = option
        changes = any(written[key].options[option].set for key, option in chosen.items())
        if not changes and all(written[key].chosen == option for key, option in chosen.items()):
            return self._written
        patched = yamlio.plain(self._data)
        for key, option in chosen.items():
            for place, value in written[key].options[option].set.items():
                _put(patched, place, value, f"readings.{key}.options.{option}", path)
            patched["readings"][key]["chosen"] = option
        return _validate(patched, path)


def _put(data: Any, place: str, value: Any, where: str, path: Path) -> None:
    """Set the value at a dotted path in the data of a robot file.

    A member of a list is addressed by its name or its index. ``where`` is the dotted path of the
    interpretation that sets the value, for error messages.
    """

    def key_of(part: str) -> Any:
        key = _member(data, part)
        if key is None:
            raise add_location(
                InputError(f"sets '{place}', but the robot file has no '{part}'", column=where), path
            )
        return key

    *way, last = place.split(".")
    for part in way:
        data = data[key_of(part)]
    if isinstance(data, list):
        data[key_of(last)] = value
    elif value is None:
        data.pop(last, None)
    else:
        data[last] = value


def _member(data: Any, part: str) -> Any:
    """Return the key or index of one member of a mapping or list in a robot file; None if it has none.

    A member of a list is found by its name or its index.
    """
    if isinstance(data, list):
        for index, member in enumerate(data):
            named = isinstance(member, dict) and member.get("name") == part
            if named or part == str(index):
                return index
    elif isinstance(data, dict) and part in data:
        return part
    return None


def add_location(error: InputError, path: Path) -> InputError:
    """Return a copy of an error that also names the robot file and the line of its cause.

    The line is that of the entry to which the dotted path in the ``column`` of the error points.
    """
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
