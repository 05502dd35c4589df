"""Links, hinges and hydrodynamic elements of a robot that moves in space, as the robot file holds them.

Every link has axes of its own: x forward, y to port, z up when all hinges are straight, with its origin at
the hinge that holds it (of the first link, the base, wherever the file's author put it). Places are given in
the axes of the link they belong to. Any physical number may be a product with named coefficients, as in a
planar robot (:mod:`swimid.robots.planar`).
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Annotated, Literal

from pydantic import Field, PositiveFloat, model_validator

from swimid.files import yamlio
from swimid.robots.planar import Coefficients, Driven, OnLink, Quantity, Yielding

#: Along the axes of a link.
Vector = tuple[Quantity, Quantity, Quantity]
Direction = tuple[float, float, float]
ZERO: Vector = (0.0, 0.0, 0.0)


def _unit(direction: Direction, name: str) -> None:
    if not math.sqrt(sum(d * d for d in direction)) > 1e-6:
        raise ValueError(f"{name} has no length")


class Body(yamlio.Document):
    """A rigid link; one without mass only carries a further hinge."""

    name: str
    mass_kg: Quantity = 0.0
    com_m: Vector = ZERO
    #: About the centre of mass: xx, yy, zz and, where the link is not symmetric, xy, xz, yz.
    inertia_kg_m2: Annotated[list[Quantity], Field(min_length=3, max_length=6)] = [0.0, 0.0, 0.0]

    @model_validator(mode="after")
    def _three_or_six(self) -> Body:
        if len(self.inertia_kg_m2) not in (3, 6):
            raise ValueError("inertia_kg_m2 has 3 members (xx, yy, zz) or 6 (and xy, xz, yz)")
        return self


class Hinge(yamlio.Document):
    """A hinge between two links; a positive angle turns the child right-handed about the axis."""

    name: str
    parent: str
    child: str
    #: Place on the parent.
    at_m: Vector = ZERO
    #: In the axes of the child, where the angle is zero those of the parent turned by ``mount_deg``.
    axis: Direction
    #: How the child's axes are turned against the parent's at zero angle: about x, then the old y, then the
    #: old z, right-handed, degrees.
    mount_deg: Direction = (0.0, 0.0, 0.0)
    #: One of the two; without either the links are joined rigidly.
    driven: Driven | None = None
    passive: Yielding | None = None

    @model_validator(mode="after")
    def _one_kind(self) -> Hinge:
        if self.driven is not None and self.passive is not None:
            raise ValueError(f"the hinge '{self.name}' is both driven and passive")
        _unit(self.axis, "axis")
        return self


class AddedMass(OnLink):
    """Added mass along the link's axes at a point, and added inertia about them."""

    kind: Literal["added-mass"]
    mass_kg: Vector = ZERO
    inertia_kg_m2: Vector = ZERO
    at_m: Vector = ZERO


class Spheroid(OnLink):
    """Added mass of a prolate spheroid along x (Lamb; sea lion, Eqs 3 to 8)."""

    kind: Literal["spheroid"]
    #: Half its length, and its largest radius.
    semi_major_m: PositiveFloat
    semi_minor_m: PositiveFloat
    at_m: Vector = ZERO
    #: What the added masses along x, y and z are multiplied with; turning about y moves water along z and
    #: that about z along y, so these factors apply to the added inertias, too.
    factors: Vector = (1.0, 1.0, 1.0)
    #: Whether turning about y and z moves water, too (not in the paper).
    turning: bool = True

    @model_validator(mode="after")
    def _prolate(self) -> Spheroid:
        if self.semi_minor_m >= self.semi_major_m:
            raise ValueError("semi_minor_m must be smaller than semi_major_m")
        return self


class Plate(OnLink):
    """Added mass of a rectangular flat plate across its plane (sea lion, Eq 9: pi rho k b c^2 / 4)."""

    kind: Literal["plate"]
    span_m: PositiveFloat
    chord_m: PositiveFloat
    #: Coefficient of additional mass.
    k: Quantity = 1.0
    at_m: Vector = ZERO
    normal: Direction = (0.0, 0.0, 1.0)

    @model_validator(mode="after")
    def _direction(self) -> Plate:
        _unit(self.normal, "normal")
        return self


class Drag(OnLink):
    """Drag ``-rho/2 C A |v| v`` along each axis of the link, at a point or on strips between two.

    Strips stand at the points of Gauss and Legendre with their weights: few are enough where the whole row is
    of one make. A row whose pieces have coefficients of their own is one element for each.
    """

    kind: Literal["drag"]
    area_m2: Vector = ZERO
    coefficient: Vector = (1.0, 1.0, 1.0)
    linear_N_s_m: Vector = ZERO
    at_m: Vector = ZERO
    #: The far end of a row of strips that begins at ``at_m``; areas are those of the whole row.
    to_m: Vector | None = None
    strips: Annotated[int, Field(ge=1, le=200)] = 1
    #: Half the height over which it leaves the water; without it it never does.
    half_height_m: PositiveFloat | None = None

    @model_validator(mode="after")
    def _strips_between(self) -> Drag:
        if self.strips > 1 and self.to_m is None:
            raise ValueError("strips lie between at_m and to_m: give to_m")
        return self


class Damping(OnLink):
    """Moments against a link's rotation about its axes."""

    kind: Literal["damping"]
    linear_N_m_s_rad: Vector = ZERO
    quadratic_N_m_s2_rad2: Vector = ZERO


class Foil(OnLink):
    """Lift and drag of a fin at one point, with the polar of a flat plate; flow along its span does nothing.

    C_l = lift sin(2 a), C_d = drag0 + drag1 (1 - cos(2 a)), a between the chord and the motion.
    """

    kind: Literal["foil"]
    area_m2: Quantity
    at_m: Vector
    chord: Direction = (1.0, 0.0, 0.0)
    normal: Direction = (0.0, 0.0, 1.0)
    lift_coefficient: Quantity
    drag_coefficient_0: Quantity = 0.0
    drag_coefficient_1: Quantity = 0.0
    half_height_m: PositiveFloat | None = None

    @model_validator(mode="after")
    def _directions(self) -> Foil:
        _unit(self.chord, "chord")
        _unit(self.normal, "normal")
        if abs(sum(a * b for a, b in zip(self.chord, self.normal, strict=True))) > 1e-6:
            raise ValueError("chord and normal must be perpendicular")
        return self


class Hydrostatics(OnLink):
    """Weight of a link at its centre of mass, and buoyancy of a volume."""

    kind: Literal["hydrostatics"]
    volume_m3: Quantity = 0.0
    #: Centre of buoyancy; default the centre of mass.
    buoyancy_at_m: Vector | None = None
    half_height_m: PositiveFloat | None = None


class Water(OnLink):
    """Water inside the hull that moves with it."""

    kind: Literal["water"]
    volume_m3: Quantity
    at_m: Vector = ZERO
    #: Radii of gyration of the water about its own middle.
    gyration_m: Direction = (0.0, 0.0, 0.0)
    #: Whether the volumes of the hydrostatics count the space it fills as displaced: the water then
    #: weighs, and moves the trim.
    weighs: bool = False


class Force(OnLink):
    """A constant force at a point, in the link's axes or the world's."""

    kind: Literal["force"]
    at_m: Vector = ZERO
    force_N: Vector
    frame: Literal["link", "world"] = "link"


Element = Annotated[
    AddedMass | Spheroid | Plate | Drag | Damping | Foil | Hydrostatics | Water | Force,
    Field(discriminator="kind"),
]


class Stroke(yamlio.Document):
    """A cycle of driven hinges: angles at times, smooth and periodic in between."""

    period_s: PositiveFloat
    #: Times of the knots, from 0 to the period, and each hinge's angle there; the last equals the first.
    knots_s: Annotated[list[float], Field(min_length=4)]
    angles_deg: dict[str, list[float]]

    @model_validator(mode="after")
    def _periodic(self) -> Stroke:
        if any(b <= a for a, b in pairwise(self.knots_s)):
            raise ValueError("knots_s must increase")
        if self.knots_s[0] != 0.0 or not math.isclose(self.knots_s[-1], self.period_s):
            raise ValueError("knots_s must run from 0 to period_s")
        for name, angles in self.angles_deg.items():
            if len(angles) != len(self.knots_s):
                raise ValueError(f"'{name}' has {len(angles)} angles at {len(self.knots_s)} knots")
            if angles[0] != angles[-1]:
                raise ValueError(f"'{name}' does not end where it began: the last angle must equal the first")
        return self


class Reference(yamlio.Document):
    """A point of the first link: the one whose pose the logs hold, or a marker that a camera follows."""

    at_m: Direction = (0.0, 0.0, 0.0)


class Multibody(yamlio.Document):
    """A tree of links in space."""

    base: Literal["free", "fixed"] = "free"
    reference: Reference = Reference()
    markers: dict[str, Reference] = {}
    #: Height of the water's surface in the world; without it there is none near.
    surface_z_m: float | None = None
    coefficients: Coefficients = {}
    links: Annotated[list[Body], Field(min_length=1)]
    joints: list[Hinge] = []
    elements: list[Element] = []
    strokes: dict[str, Stroke] = {}

    @model_validator(mode="after")
    def _names(self) -> Multibody:
        driven = [h.name for h in self.joints if h.driven is not None]
        for stroke, law in self.strokes.items():
            unknown = [name for name in law.angles_deg if name not in driven]
            if unknown:
                raise ValueError(
                    f"the stroke '{stroke}' moves '{unknown[0]}', which is no driven hinge; there are: "
                    f"{', '.join(driven) or 'none'}"
                )
        return self
