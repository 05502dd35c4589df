"""Entries of a robot file for a robot that moves in 3-D: links, hinges and hydrodynamic elements.

Every link has its own axes: x forward, y to port, z up when all hinges are straight. Their origin is at the
hinge that connects the link to its parent. The origin of the first link, the base, is arbitrary. Positions
are given in the axes of their link. Any physical quantity may be a product with named coefficients, as in
:mod:`swimid.robots.planar`.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Annotated, Literal

from pydantic import AfterValidator, Field, PositiveFloat, model_validator

from swimid.files import yamlio
from swimid.robots.planar import (
    Actuator,
    Coefficients,
    Connection,
    DerivativeTerms,
    Holder,
    Input,
    MovingMassLaw,
    OnLink,
    PropellerLaw,
    Quantity,
    RudderLaw,
)

#: Type of a vector with three physical quantities as components along the axes of a link.
Vector = tuple[Quantity, Quantity, Quantity]
Direction = tuple[float, float, float]
ZERO_VECTOR: Vector = (0.0, 0.0, 0.0)


def _long(direction: Direction) -> Direction:
    if not math.hypot(*direction) > 1e-6:
        raise ValueError("the direction has no length")
    return direction


#: Type of a direction in 3-D: a vector whose length is not zero. It need not be of length 1.
Axis = Annotated[Direction, AfterValidator(_long)]


class Body(yamlio.Document):
    """Rigid link of a robot in 3-D. A link without mass only connects two hinges."""

    name: str
    mass_kg: Quantity = 0.0
    com_m: Vector = ZERO_VECTOR
    #: Components xx, yy, zz of the inertia tensor of the link about its centre of mass, in the axes of the
    #: link. The components xy, xz, yz follow if they are not zero.
    inertia_kg_m2: Annotated[list[Quantity], Field(min_length=3, max_length=6)] = [0.0, 0.0, 0.0]

    @model_validator(mode="after")
    def _three_or_six(self) -> Body:
        if len(self.inertia_kg_m2) not in (3, 6):
            raise ValueError("inertia_kg_m2 has 3 members (xx, yy, zz) or 6 (and xy, xz, yz)")
        return self


class Hinge(Connection):
    """Hinge between a parent link and a child link of a robot in 3-D.

    A positive angle rotates the child link right-handed about the axis of the hinge.
    """

    #: Position of the hinge in the axes of the parent link, m.
    at_m: Vector = ZERO_VECTOR
    #: Direction of the rotation axis of the hinge, in the axes of the child link.
    axis: Axis
    #: Rotation from the axes of the parent link to those of the child link at zero hinge angle, degrees. It
    #: consists of right-handed rotations about x, then y, then z of the parent.
    mount_deg: Direction = (0.0, 0.0, 0.0)


class AddedMass(OnLink):
    """Added mass of a link at a point for motion along each axis of the link.

    The element also has the added moments of inertia for rotation about these axes.
    """

    kind: Literal["added-mass"]
    mass_kg: Vector = ZERO_VECTOR
    inertia_kg_m2: Vector = ZERO_VECTOR
    at_m: Vector = ZERO_VECTOR


class Spheroid(OnLink):
    """Added mass of a prolate spheroid with its long axis along x of the link (sea lion, Eqs 3 to 8)."""

    kind: Literal["spheroid"]
    #: Half the length of the prolate spheroid, and its maximum radius, m.
    semi_major_m: PositiveFloat
    semi_minor_m: PositiveFloat
    at_m: Vector = ZERO_VECTOR
    #: Factors by which the added masses of the spheroid along x, y and z are multiplied. The added inertia
    #: for rotation about y has the factor of z, and that for rotation about z the factor of y, because these
    #: rotations move water along z and y.
    factors: Vector = (1.0, 1.0, 1.0)
    #: Whether the spheroid has added moments of inertia for rotation about y and z. The sea lion paper has
    #: none.
    turning: bool = True

    @model_validator(mode="after")
    def _prolate(self) -> Spheroid:
        if self.semi_minor_m >= self.semi_major_m:
            raise ValueError("semi_minor_m must be smaller than semi_major_m")
        return self


class Plate(OnLink):
    """Added mass of a rectangular flat plate that moves normal to its plane.

    It is ``pi rho k b c^2 / 4`` with the span b and the chord c (sea lion paper, Eq 9).
    """

    kind: Literal["plate"]
    span_m: PositiveFloat
    chord_m: PositiveFloat
    #: Dimensionless coefficient k in the added mass of the plate (sea lion paper, Eq 9).
    k: Quantity = 1.0
    at_m: Vector = ZERO_VECTOR
    normal: Axis = (0.0, 0.0, 1.0)


class Drag(OnLink):
    """Quadratic and linear drag on a link along each of its axes, at a point or on strips between two points.

    The quadratic drag is ``-rho/2 C A |v| v`` with the velocity component v. The strips are at the points of
    the Gauss-Legendre rule. A few strips are enough for a surface with one coefficient. A surface whose parts
    have different coefficients needs one element for each part.
    """

    kind: Literal["drag"]
    area_m2: Vector = ZERO_VECTOR
    coefficient: Vector = (1.0, 1.0, 1.0)
    linear_N_s_m: Vector = ZERO_VECTOR
    #: Quadratic drag in addition to that of the areas: force divided by the square of the velocity.
    quadratic_N_s2_m2: Vector = ZERO_VECTOR
    at_m: Vector = ZERO_VECTOR
    #: End of the row of drag strips that begins at ``at_m``. The field ``area_m2`` is the area of the whole
    #: row.
    to_m: Vector | None = None
    strips: Annotated[int, Field(ge=1, le=200)] = 1
    #: Half the height of the band about the water surface, m, in which the drag of a surfacing element fades
    #: out. Without this entry, the element is assumed to be always under water.
    half_height_m: PositiveFloat | None = None

    @model_validator(mode="after")
    def _strips_between(self) -> Drag:
        if self.strips > 1 and self.to_m is None:
            raise ValueError("strips lie between at_m and to_m: give to_m")
        return self


class Damping(OnLink):
    """Linear and quadratic damping moments that oppose the rotation of a link about each of its axes."""

    kind: Literal["damping"]
    linear_N_m_s_rad: Vector = ZERO_VECTOR
    quadratic_N_m_s2_rad2: Vector = ZERO_VECTOR


class Foil(OnLink):
    """Lift and drag of a fin at one point of a link, with the polar of a flat plate.

    C_l = lift sin(2 a), C_d = drag0 + drag1 (1 - cos(2 a)), where a is the angle between the chord and the
    motion. Flow along the span has no effect.
    """

    kind: Literal["foil"]
    area_m2: Quantity
    at_m: Vector
    chord: Axis = (1.0, 0.0, 0.0)
    normal: Axis = (0.0, 0.0, 1.0)
    lift_coefficient: Quantity
    drag_coefficient_0: Quantity = 0.0
    drag_coefficient_1: Quantity = 0.0
    half_height_m: PositiveFloat | None = None

    @model_validator(mode="after")
    def _directions(self) -> Foil:
        if abs(sum(a * b for a, b in zip(self.chord, self.normal, strict=True))) > 1e-6:
            raise ValueError("chord and normal must be perpendicular")
        return self


class Hydrostatics(OnLink):
    """Weight of a link at its centre of mass, and buoyancy at the centre of buoyancy."""

    kind: Literal["hydrostatics"]
    volume_m3: Quantity = 0.0
    #: Position of the centre of buoyancy in the axes of the link, m; by default the centre of mass.
    buoyancy_at_m: Vector | None = None
    half_height_m: PositiveFloat | None = None


class Water(OnLink):
    """Mass of the water inside a flooded hull, which moves with the hull."""

    kind: Literal["water"]
    volume_m3: Quantity
    at_m: Vector = ZERO_VECTOR
    #: Radii of gyration, m, of the water inside the hull about x, y and z axes through the centre of this
    #: water.
    gyration_m: Direction = (0.0, 0.0, 0.0)
    #: Whether the volumes of the ``hydrostatics`` elements include the volume of the water inside the hull.
    #: The weight of this water is added only in that case.
    weighs: bool = False


class Force(OnLink):
    """Constant force that acts at a point of a link, with components in the axes of the link or the world."""

    kind: Literal["force"]
    at_m: Vector = ZERO_VECTOR
    force_N: Vector
    frame: Literal["link", "world"] = "link"


class Load(OnLink):
    """Force and moment on a link that are proportional to an input.

    Examples are a thruster, a towing line with a load cell, a measured force, and a variable buoyancy.
    """

    kind: Literal["load"]
    input: str
    at_m: Vector = ZERO_VECTOR
    #: Force and moment divided by the value of the input after the law of its actuator.
    force_N: Vector = ZERO_VECTOR
    #: Moment in the axes of the link.
    moment_N_m: Vector = ZERO_VECTOR
    #: Axes of the force: those of the link, or those of the world, as for a buoyancy.
    frame: Literal["link", "world"] = "link"


class Propeller(PropellerLaw):
    """Propeller at a point of a link, which pushes along its axis."""

    at_m: Vector
    axis: Axis = (1.0, 0.0, 0.0)


class Rudder(RudderLaw):
    """Rudder or fin of a link that moves along its x axis. Its lateral force is along ``side``.

    With a positive angle, the force on the rudder is opposite to ``side``.
    """

    at_m: Vector
    #: Direction across the hull and normal to the axis about which the rudder turns.
    side: Axis = (0.0, 1.0, 0.0)
    #: Point at which the induced lateral force acts on the hull; by default that of the rudder.
    hull_force_at_m: Vector | None = None
    #: Point whose lateral velocity is that of the inflow (the length l_R); by default that of the rudder.
    inflow_at_m: Vector | None = None

    @model_validator(mode="after")
    def _across(self) -> Rudder:
        if abs(self.side[0]) > 1e-6 * math.hypot(*self.side):
            raise ValueError("'side' must be perpendicular to the x axis of the link")
        return self


class MovingMass(MovingMassLaw):
    """Moving mass of a robot in space."""

    #: Place of the mass for an input of 0.
    at_m: Vector
    #: Displacement of the mass for an input of 1.
    travel_m: Vector = (1.0, 0.0, 0.0)


class Derivatives(DerivativeTerms):
    """Hydrodynamic derivatives of a link at a point."""

    at_m: Vector = ZERO_VECTOR


Element = Annotated[
    AddedMass
    | Spheroid
    | Plate
    | Drag
    | Damping
    | Foil
    | Hydrostatics
    | Water
    | Force
    | Load
    | Propeller
    | Rudder
    | MovingMass
    | Derivatives,
    Field(discriminator="kind"),
]


class Stroke(yamlio.Document):
    """Cyclic motion of several driven hinges, given by their angles at certain times (knots) of a period.

    The angles are interpolated by a smooth periodic curve.
    """

    period_s: PositiveFloat
    #: Times from 0 to the period, s, at which ``angles_deg`` has the angles of each hinge. The last angle of
    #: a hinge equals its first.
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
    """Point of the first link of a robot in 3-D: the reference point whose pose is logged, or a marker."""

    at_m: Direction = (0.0, 0.0, 0.0)


class Multibody(yamlio.Document):
    """Robot that moves in 3-D: a tree of links with their hinges, hydrodynamic elements and strokes.

    Vectors are in the axes of their link: x forward, y to port, z up.

    Example::

        multibody:
          coefficients: {z_drag: {value: 1.2, bounds: [0.1, 4]}}
          links:
            - {name: body, mass_kg: 24, com_m: [0, 0, -0.01], inertia_kg_m2: [0.17, 1.25, 1.25]}
            - {name: flipper, mass_kg: 0.5, com_m: [0, 0.16, 0], inertia_kg_m2: [0.0045, 0.0007, 0.0051]}
          joints:
            - {name: sweep, parent: body, child: flipper, at_m: [0.2, 0.1, 0], axis: [0, 0, 1], driven: {}}
          elements:
            - {kind: drag, link: body, area_m2: [0.04, 0.19, 0.19], coefficient: [0.25, 1, z_drag]}
            - {kind: plate, link: flipper, span_m: 0.32, chord_m: 0.12, at_m: [0, 0.16, 0]}
    """

    base: Literal["free", "fixed"] = "free"
    holder: Holder | None = None
    reference: Reference = Reference()
    markers: dict[str, Reference] = {}
    #: Height z of the water surface in the world frame, m. Without this entry, the robot is always under
    #: water.
    surface_z_m: float | None = None
    coefficients: Coefficients = {}
    inputs: dict[str, Input] = {}
    #: Actuators that several driven hinges follow, by name.
    actuators: dict[str, Actuator] = {}
    links: Annotated[list[Body], Field(min_length=1)]
    joints: list[Hinge] = []
    elements: list[Element] = []
    strokes: dict[str, Stroke] = {}

    @model_validator(mode="after")
    def _names(self) -> Multibody:
        driven = [h.name for h in self.joints if h.driven is not None and h.driven.actuator is None]
        driven += self.actuators
        for stroke, law in self.strokes.items():
            unknown = [name for name in law.angles_deg if name not in driven]
            if unknown:
                raise ValueError(
                    f"the stroke '{stroke}' moves '{unknown[0]}', which is no driven hinge with an actuator "
                    "of its own, and no actuator; there are: "
                    f"{', '.join(driven) or 'none'}"
                )
        return self
