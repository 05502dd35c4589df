"""Links, joints and hydrodynamic elements of a planar multi-link robot, as the robot file holds them.

Stations along a link are measured from its front end backwards, offsets to port (upwards in the
vertical plane). Any physical number may be a product with named coefficients, ``"2.133 * c_ma"``:
those are the parameters a gray-box fit estimates.
"""

from __future__ import annotations

import math
import re
from itertools import pairwise
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, PositiveFloat, model_validator

from swimid.files import yamlio

#: A factor of a quantity: the name of a coefficient.
NAME = re.compile(r"[A-Za-z_]\w*")


def factors(quantity: float | str) -> tuple[float, tuple[str, ...]]:
    """Number and coefficient names of a quantity.

    Raises
    ------
    ValueError
        When a factor is neither a number nor a name.

    >>> factors("0.5 * c_f0")
    (0.5, ('c_f0',))
    """
    if not isinstance(quantity, str):
        return float(quantity), ()
    number, names = 1.0, []
    for part in quantity.split("*"):
        word = part.strip()
        if NAME.fullmatch(word):
            names.append(word)
            continue
        try:
            number *= float(word)
        except ValueError:
            raise ValueError(
                f"'{quantity}' is neither a number nor a product of numbers and coefficient names"
            ) from None
    if not math.isfinite(number):
        raise ValueError(f"'{quantity}' is not finite")
    return number, tuple(sorted(names))


def _quantity(value: Any) -> Any:
    if isinstance(value, bool):
        raise ValueError(f"'{str(value).lower()}' is not a number")
    if isinstance(value, str):
        factors(value)
    return value


#: A number, or a product of numbers and coefficients.
Quantity = Annotated[float | str, BeforeValidator(_quantity)]


class Coefficient(yamlio.Document):
    """A named coefficient: what is known of it before a fit."""

    value: float
    unit: str = "1"
    bounds: tuple[float | None, float | None] = (None, None)
    #: Where a fit starts; default the value.
    start: float | None = None
    #: Typical size: an uncertainty above half of it (or of the value) is no estimate.
    scale: PositiveFloat | None = None
    #: Estimated unless the user says otherwise.
    free: bool = True
    #: Each trial has a value of its own: how the robot was trimmed, say.
    per_trial: bool = False
    meaning: str = ""
    source: str = ""

    @model_validator(mode="after")
    def _in_bounds(self) -> Coefficient:
        low = -float("inf") if self.bounds[0] is None else self.bounds[0]
        high = float("inf") if self.bounds[1] is None else self.bounds[1]
        if not low < high:
            raise ValueError(f"the bounds are the wrong way round: {self.bounds[0]} {self.bounds[1]}")
        for name, value in (("value", self.value), ("start", self.start)):
            if value is not None and not low <= value <= high:
                raise ValueError(f"its {name} {value:g} lies outside its bounds")
        return self


def _named(coefficients: dict[str, Coefficient]) -> dict[str, Coefficient]:
    for name in coefficients:
        if not NAME.fullmatch(name):
            raise ValueError(f"a coefficient cannot be called '{name}': letters, digits and _ only")
    return coefficients


Coefficients = Annotated[dict[str, Coefficient], AfterValidator(_named)]


class Link(yamlio.Document):
    """A rigid link; its frame sits at its front end, x forward."""

    name: str
    length_m: PositiveFloat
    mass_kg: Quantity
    #: Station of the centre of mass.
    com_m: Quantity
    com_offset_m: Quantity = 0.0
    inertia_kg_m2: Quantity
    #: The point the inertia is given about.
    inertia_about: Literal["front", "com"]


class Servo(yamlio.Document):
    """A second-order servo between the command and the joint."""

    natural_frequency_hz: Quantity
    damping_ratio: Quantity = 0.7


class Tendon(yamlio.Document):
    """A wire and spring that pull a joint straight (tendon fish, Eqs 3 and 4)."""

    spring_N_m: Quantity
    pretension_m: Quantity
    arm_m: PositiveFloat
    crank_m: PositiveFloat

    @model_validator(mode="after")
    def _crank_shorter(self) -> Tendon:
        if self.crank_m >= self.arm_m:
            raise ValueError(
                "crank_m must be shorter than arm_m, else the wire is loose at zero angle (Eq 3)"
            )
        return self


class Driven(yamlio.Document):
    """A joint that follows the drive, or a measured angle."""

    #: Share of the drive's amplitude and, unless ``bias_gain`` says otherwise, of its bias.
    gain: float = 1.0
    bias_gain: float | None = None
    #: Phase of this joint behind the drive's, degrees.
    phase_lag_deg: float = 0.0
    servo: Servo | None = None


class Yielding(yamlio.Document):
    """A hinge that yields: spring and damper."""

    stiffness_N_m_rad: Quantity = 0.0
    cubic_N_m_rad3: Quantity = 0.0
    damping_N_m_s_rad: Quantity = 0.0
    quadratic_damping_N_m_s2_rad2: Quantity = 0.0
    #: Dry friction, rounded off below ``friction_below_rad_s``.
    friction_N_m: Quantity = 0.0
    friction_below_rad_s: PositiveFloat = 0.02
    rest_deg: float = 0.0


class Passive(Yielding):
    """A joint that yields: spring, damper, or wire and spring."""

    tendon: Tendon | None = None


class Joint(yamlio.Document):
    """A hinge between two links; its angle is positive when the child is turned counter-clockwise."""

    name: str
    parent: str
    child: str
    #: Station on the parent; default its rear end.
    at_m: Quantity | None = None
    offset_m: Quantity = 0.0
    #: Angle between the links when the joint's own angle is zero.
    mount_deg: float = 0.0
    #: One of the two; without either the links are joined rigidly.
    driven: Driven | None = None
    passive: Passive | None = None

    @model_validator(mode="after")
    def _one_kind(self) -> Joint:
        if self.driven is not None and self.passive is not None:
            raise ValueError(f"the joint '{self.name}' is both driven and passive")
        return self


class OnLink(yamlio.Document):
    """What acts on a link."""

    link: str
    #: For readings to refer to.
    name: str = ""


class AddedMass(OnLink):
    """Added mass and inertia of a link, as if a body of that mass sat at a station."""

    kind: Literal["added-mass"]
    surge_kg: Quantity = 0.0
    sway_kg: Quantity = 0.0
    inertia_kg_m2: Quantity = 0.0
    at_m: Quantity | None = None
    offset_m: Quantity = 0.0


class Drag(OnLink):
    """Morison drag, axial and normal, at one station or spread evenly along the link."""

    kind: Literal["drag"]
    axial_area_m2: Quantity = 0.0
    axial_coefficient: Quantity = 0.0
    normal_area_m2: Quantity = 0.0
    normal_coefficient: Quantity = 0.0
    #: Linear drag of the whole element.
    axial_linear_N_s_m: Quantity = 0.0
    normal_linear_N_s_m: Quantity = 0.0
    #: Gauss strips along the link; 1 is a point at ``at_m`` (default mid-link).
    strips: Annotated[int, Field(ge=1, le=200)] = 3
    at_m: Quantity | None = None
    from_m: float | None = None
    to_m: float | None = None
    offset_m: Quantity = 0.0

    @model_validator(mode="after")
    def _point_or_strips(self) -> Drag:
        if self.at_m is not None and self.strips != 1:
            raise ValueError("at_m belongs to a single point: set strips: 1, or give from_m and to_m")
        if self.to_m is not None and self.to_m <= (self.from_m or 0.0):
            raise ValueError("to_m must lie behind from_m")
        return self


class Damping(OnLink):
    """Moment against a link's rotation."""

    kind: Literal["damping"]
    linear_N_m_s_rad: Quantity = 0.0
    quadratic_N_m_s2_rad2: Quantity = 0.0


class Section(yamlio.Document):
    """A cross-section: its station, height normal to the plane of bending forces, and girth."""

    station_m: Annotated[float, Field(ge=0)]
    height_m: Annotated[float, Field(ge=0)]
    perimeter_m: Annotated[float, Field(ge=0)]


class SlenderBody(OnLink):
    """Strips over a link of varying cross-section (dolphin, Eqs 4, 7 and 8)."""

    kind: Literal["slender-body"]
    #: Stations from the link's front end, linear in between.
    sections: Annotated[list[Section], Field(min_length=2)]
    added_mass_coefficient: Quantity = 0.0
    friction_coefficient: Quantity = 0.0
    drag_coefficient: Quantity = 0.0
    added_mass_direction: Literal["both", "normal"] = "both"
    strips: Annotated[int, Field(ge=1, le=200)] = 5

    @model_validator(mode="after")
    def _ordered(self) -> SlenderBody:
        stations = [s.station_m for s in self.sections]
        if any(b <= a for a, b in pairwise(stations)):
            raise ValueError("the stations of the sections must increase")
        return self


class Foil(OnLink):
    """Lift and drag of a fin at one point (dolphin, Eq 9).

    Polar of a flat plate: C_l = lift sin(2 a), C_d = drag0 + drag1 (1 - cos(2 a)).
    """

    kind: Literal["foil"]
    area_m2: Quantity
    at_m: Quantity
    offset_m: Quantity = 0.0
    #: Angle of the chord against the link's axis.
    chord_deg: float = 0.0
    lift_coefficient: Quantity
    drag_coefficient_0: Quantity = 0.0
    drag_coefficient_1: Quantity = 0.0


class TrailingEdge(OnLink):
    """Momentum shed into the wake where a slender body or its caudal fin ends (Lighthill 1971).

    Belongs with lateral added mass of the links, whose impulse is the other part of Lighthill's force.
    A fin that also has a foil's lift has its force counted twice.
    """

    kind: Literal["trailing-edge"]
    #: Lateral added mass per length at the edge: rho pi h^2 / 4 for an edge h high.
    added_mass_kg_m: Quantity
    #: Default the link's rear end.
    at_m: Quantity | None = None
    offset_m: Quantity = 0.0


class Hydrostatics(OnLink):
    """Weight at the centre of mass and buoyancy of a volume, in the vertical plane."""

    kind: Literal["hydrostatics"]
    volume_m3: Quantity = 0.0
    buoyancy_at_m: Quantity | None = None
    buoyancy_offset_m: Quantity = 0.0


class Force(OnLink):
    """A constant force at a point, in the link's axes or the world's."""

    kind: Literal["force"]
    at_m: Quantity = 0.0
    offset_m: Quantity = 0.0
    forward_N: Quantity = 0.0
    port_N: Quantity = 0.0
    frame: Literal["link", "world"] = "link"


Element = Annotated[
    AddedMass | Drag | Damping | SlenderBody | Foil | TrailingEdge | Hydrostatics | Force,
    Field(discriminator="kind"),
]


class ReadingOption(yamlio.Document):
    """One reading of an ambiguous symbol, and what it changes in the file."""

    says: str
    #: Dotted paths into the file (``elements.0.axial_area_m2``; list members by name or number).
    set: dict[str, Any] = {}


class Reading(yamlio.Document):
    """An ambiguity of the source, its readings, and the one chosen."""

    question: str
    chosen: str
    options: dict[str, ReadingOption]

    @model_validator(mode="after")
    def _known(self) -> Reading:
        if self.chosen not in self.options:
            raise ValueError(f"'{self.chosen}' is none of its options: {', '.join(self.options)}")
        return self


class Reference(yamlio.Document):
    """A point of the first link: the one whose pose the logs hold, or a marker that a camera follows."""

    station_m: float = 0.0
    offset_m: float = 0.0


class Multilink(yamlio.Document):
    """A planar tree of links."""

    plane: Literal["horizontal", "vertical"]
    base: Literal["free", "fixed"] = "free"
    #: Heading of a fixed base.
    heading_deg: float = 0.0
    reference: Reference = Reference()
    markers: dict[str, Reference] = {}
    coefficients: Coefficients = {}
    links: Annotated[list[Link], Field(min_length=1)]
    joints: list[Joint] = []
    elements: list[Element] = []
