"""The robot file (``swimid-robot/1``): everything known of a robot before any fit.

Built-in robots lie in ``swimid/robots`` as YAML; a user's own is a YAML file and needs no
code.
"""

from __future__ import annotations

from importlib import resources
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, PositiveFloat

from swimid.errors import InputError, nearest
from swimid.formats import yamlio

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
    """A robot file."""

    format: Literal["swimid-robot/1"]
    name: str
    description: str = ""
    sources: list[str] = []
    fluid: Fluid = Fluid()
    body: Body = Body()
    rig: Rig = Rig()
    fins: dict[str, Fin] = {}
    theory: list[Theory] = []


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


def read(name: str, relative_to: Path | None = None) -> Robot:
    """Read a robot by built-in name, or by path relative to ``relative_to``."""
    return yamlio.validated(locate(name, relative_to), Robot)
