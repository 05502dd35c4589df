"""Entries of a robot file for a robot that moves in 3-D: links, hinges and forms of the elements.

Every link has its own axes: x forward, y to port, z up when all hinges are straight. Their origin is at the
hinge that connects the link to its parent. The origin of the first link, the base, is arbitrary. Positions
are given in the axes of their link. Any physical quantity may be a product with named coefficients
(:mod:`swimid.robots.quantities`).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Annotated, Literal

import numpy as np
from pydantic import AfterValidator, Field, PositiveFloat, model_validator

from swimid.files import yamlio
from swimid.robots import elements
from swimid.robots.elements import Derivatives, OnLink
from swimid.robots.joints import Actuator, Holder, Input, Joint
from swimid.robots.quantities import (
    Coefficients,
    Components,
    Polynomial,
    Quantity,
    Vector,
    gauss_points,
    multiply_pairs,
    use_default,
)

Direction = tuple[float, float, float]
ZERO_VECTOR: Vector = (0.0, 0.0, 0.0)


def _check_length(direction: Direction) -> Direction:
    if not math.hypot(*direction) > 1e-6:
        raise ValueError("the direction is the zero vector: give at least one component that is not 0")
    return direction


#: Type of a direction in 3-D: a vector whose length is not zero. It need not be of length 1.
AxisDirection = Annotated[Direction, AfterValidator(_check_length)]


def unit_vector(direction: Sequence[float]) -> list[float]:
    """Return the unit vector of a direction."""
    vector = np.asarray(direction, dtype=float)
    return [float(x) for x in vector / np.linalg.norm(vector)]


class SpatialLink(yamlio.Document):
    """Rigid link of a robot in 3-D. A link without mass only connects two hinges."""

    name: str
    mass_kg: Quantity = 0.0
    com_m: Vector = ZERO_VECTOR
    #: Components xx, yy, zz of the inertia tensor of the link about its centre of mass, in the axes of the
    #: link. The components xy, xz, yz follow if they are not zero.
    inertia_kg_m2: Annotated[list[Quantity], Field(min_length=3, max_length=6)] = [0.0, 0.0, 0.0]

    @model_validator(mode="after")
    def _three_or_six(self) -> SpatialLink:
        if len(self.inertia_kg_m2) not in (3, 6):
            raise ValueError(
                f"inertia_kg_m2 has {len(self.inertia_kg_m2)} values: "
                "give xx, yy, zz, or all of xx, yy, zz, xy, xz, yz"
            )
        return self

    @property
    def centre(self) -> Components:
        """Centre of mass in the axes of the link, m."""
        return self.com_m

    @property
    def moments(self) -> Components:
        """Moments of inertia about the centre of mass: xx, yy, zz, xy, xz, yz, kg m2."""
        return [*self.inertia_kg_m2, *[0.0] * (6 - len(self.inertia_kg_m2))]


class Hinge(Joint):
    """Hinge between a parent link and a child link of a robot in 3-D.

    A positive angle rotates the child link right-handed about the axis of the hinge.
    """

    #: Position of the hinge in the axes of the parent link, m.
    at_m: Vector = ZERO_VECTOR
    #: Direction of the rotation axis of the hinge, in the axes of the child link.
    axis: AxisDirection
    #: Rotation from the axes of the parent link to those of the child link at zero hinge angle, degrees. It
    #: consists of right-handed rotations about x, then y, then z of the parent.
    mount_deg: Direction = (0.0, 0.0, 0.0)

    def point(self, parent: SpatialLink) -> Components:
        """Return the position of the hinge in the axes of the parent link, m."""
        return self.at_m

    @property
    def mount_angles_deg(self) -> Direction:
        """Rotation about x, y and z from the parent to the child at zero hinge angle, degrees."""
        return self.mount_deg


class InSpace(OnLink):
    """Base class of elements in 3-D that act at a point."""

    #: Position in the axes of the link, m.
    at_m: Vector = ZERO_VECTOR

    def point(self, link: SpatialLink) -> Components:
        """Return the position of the element in the axes of its link, m."""
        return self.at_m


class SpatialAddedMass(InSpace, elements.AddedMass):
    """Added mass of a link at a point for motion along each axis of the link.

    The element also has the added moments of inertia for rotation about these axes.
    """

    mass_kg: Vector = ZERO_VECTOR
    inertia_kg_m2: Vector = ZERO_VECTOR

    @property
    def masses(self) -> Components:
        """Added mass for motion along each axis, kg."""
        return self.mass_kg

    @property
    def inertias(self) -> Components:
        """Added moment of inertia about each axis, kg m2."""
        return self.inertia_kg_m2


class Spheroid(InSpace):
    """Added mass of a prolate spheroid with its long axis along x of the link (sea lion, Eqs 3 to 8)."""

    kind: Literal["spheroid"]
    #: Half the length of the prolate spheroid, and its maximum radius, m.
    semi_major_m: PositiveFloat
    semi_minor_m: PositiveFloat
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
            text = f"semi_minor_m {self.semi_minor_m:g} must be below semi_major_m {self.semi_major_m:g}"
            raise ValueError(text)
        return self


class Plate(InSpace):
    """Added mass of a rectangular flat plate that moves normal to its plane.

    The added mass is ``pi rho k b c^2 / 4`` with the span b and the chord c (sea lion paper, Eq 9).
    """

    kind: Literal["plate"]
    span_m: PositiveFloat
    chord_m: PositiveFloat
    #: Dimensionless coefficient k in the added mass of the plate (sea lion paper, Eq 9).
    k: Quantity = 1.0
    normal: AxisDirection = (0.0, 0.0, 1.0)


class SpatialDrag(InSpace, elements.Drag):
    """Quadratic and linear drag on a link along each of its axes, at a point or on strips between two points.

    The quadratic drag is ``-rho/2 C A |v| v`` with the velocity component v. The strips are at the points of
    the Gauss-Legendre rule. A few strips are enough for a surface with one coefficient. A surface whose parts
    have different coefficients needs one element for each part.
    """

    area_m2: Vector = ZERO_VECTOR
    #: Drag coefficient along each axis of the link.
    coefficient: Vector = (1.0, 1.0, 1.0)
    linear_N_s_m: Vector = ZERO_VECTOR
    #: Quadratic drag in addition to that of the areas: force divided by the square of the velocity.
    quadratic_N_s2_m2: Vector = ZERO_VECTOR
    #: End of the row of drag strips that begins at ``at_m``. The field ``area_m2`` is the area of the whole
    #: row.
    to_m: Vector | None = None
    strips: Annotated[int, Field(ge=1, le=200)] = 1
    #: Half the height of the band about the water surface, m, in which the drag of a surfacing element fades
    #: out. Without this entry, the element is assumed to be always under water.
    half_height_m: PositiveFloat | None = None

    @model_validator(mode="after")
    def _strips_between(self) -> SpatialDrag:
        if self.strips > 1 and self.to_m is None:
            raise ValueError(
                f"'strips' is {self.strips}, but 'to_m' is missing: give 'to_m', or set 'strips: 1'"
            )
        return self

    def quadratic(self, half_density: float) -> Components:
        """Return the quadratic drag along each axis, N s2/m2, for half the density of the water."""
        products = multiply_pairs(self.area_m2, self.coefficient)
        pairs = zip(products, self.quadratic_N_s2_m2, strict=True)
        return [half_density * product + Polynomial.of(more) for product, more in pairs]

    @property
    def linear(self) -> Components:
        """Linear drag along each axis, N s/m."""
        return self.linear_N_s_m

    def points(self, link: SpatialLink) -> Iterator[tuple[Components, float]]:
        """Yield the points at which the drag acts, each with its share of the drag."""
        start, end = (
            np.array([Polynomial.of(x) for x in point])
            for point in (self.at_m, use_default(self.to_m, self.at_m))
        )
        yield from gauss_points(start, end, self.strips)


class SpatialDamping(elements.Damping):
    """Linear and quadratic damping moments that oppose the rotation of a link about each of its axes."""

    linear_N_m_s_rad: Vector = ZERO_VECTOR
    quadratic_N_m_s2_rad2: Vector = ZERO_VECTOR

    @property
    def moments(self) -> Components:
        """Quadratic and linear damping moments about x, y and z."""
        return *self.quadratic_N_m_s2_rad2, *self.linear_N_m_s_rad


class SpatialFoil(InSpace, elements.Foil):
    """Lift and drag of a fin at one point of a link.

    The polar is that of a flat plate with the angle of attack a: C_l = lift sin(2 a), C_d = drag0 + drag1 (1
    - cos(2 a)). Flow along the span has no effect.
    """

    at_m: Vector
    chord: AxisDirection = (1.0, 0.0, 0.0)
    normal: AxisDirection = (0.0, 0.0, 1.0)
    half_height_m: PositiveFloat | None = None

    @model_validator(mode="after")
    def _directions(self) -> SpatialFoil:
        product = sum(a * b for a, b in zip(self.chord, self.normal, strict=True))
        if abs(product) > 1e-6:
            raise ValueError(f"chord and normal must be perpendicular; their scalar product is {product:g}")
        return self

    @property
    def directions(self) -> Components:
        """Unit vectors along the chord and normal to it."""
        return *unit_vector(self.chord), *unit_vector(self.normal)


class SpatialHydrostatics(elements.Hydrostatics):
    """Weight of a link at its centre of mass, and buoyancy at the centre of buoyancy."""

    #: Position of the centre of buoyancy in the axes of the link, m; by default the centre of mass.
    buoyancy_at_m: Vector | None = None
    half_height_m: PositiveFloat | None = None

    def point(self, link: SpatialLink) -> Components:
        """Return the centre of buoyancy in the axes of the link, m."""
        return use_default(self.buoyancy_at_m, link.com_m)  # type: ignore[no-any-return]


class Water(InSpace):
    """Mass of the water inside a flooded hull, which moves with the hull."""

    kind: Literal["water"]
    volume_m3: Quantity
    #: Radii of gyration, m, of the water inside the hull about x, y and z axes through the centre of this
    #: water.
    gyration_m: Direction = (0.0, 0.0, 0.0)
    #: Whether the volumes of the ``hydrostatics`` elements include the volume of the water inside the hull.
    #: The weight of this water is added only in that case.
    weighs: bool = False


class SpatialForce(InSpace, elements.Force):
    """Constant force that acts at a point of a link, with components in the axes of the link or the world."""

    force_N: Vector

    @property
    def force(self) -> Components:
        """Components of the force, N."""
        return self.force_N


class SpatialLoad(InSpace, elements.Load):
    """Force and moment on a link that are proportional to an input, for an input of 1 behind its actuator.

    Examples are a thruster, a towing line with a load cell, a measured force, and a variable buoyancy.
    """

    force_N: Vector = ZERO_VECTOR
    #: Moment in the axes of the link.
    moment_N_m: Vector = ZERO_VECTOR

    @property
    def wrench(self) -> Components:
        """Components of the force (N) and of the moment (N m) for an input of 1."""
        return *self.force_N, *self.moment_N_m


class SpatialPropeller(InSpace, elements.Propeller):
    """Propeller at a point of a link, which pushes along its axis."""

    at_m: Vector
    #: Direction of a positive thrust, in the axes of the link.
    axis: AxisDirection = (1.0, 0.0, 0.0)

    @property
    def direction(self) -> Components:
        """Unit vector of a positive thrust."""
        return unit_vector(self.axis)


class SpatialRudder(InSpace, elements.Rudder):
    """Rudder or fin of a link that moves along its x axis. Its lateral force is along ``side``.

    With a positive angle, the force on the rudder is opposite to ``side``.
    """

    at_m: Vector
    #: Direction across the hull and normal to the axis about which the rudder turns.
    side: AxisDirection = (0.0, 1.0, 0.0)
    #: Point at which the induced lateral force acts on the hull; by default that of the rudder.
    hull_force_at_m: Vector | None = None
    #: Point whose lateral velocity is that of the inflow (the length l_R); by default that of the rudder.
    inflow_at_m: Vector | None = None

    @model_validator(mode="after")
    def _across(self) -> SpatialRudder:
        if abs(self.side[0]) > 1e-6 * math.hypot(*self.side):
            raise ValueError(f"side {list(self.side)} must be perpendicular to the x axis of the link")
        return self

    @property
    def points(self) -> Components:
        """Points of the force on the rudder, of the force on the hull and of the inflow, and the side."""
        points = self.at_m, self.hull_force_at_m, self.inflow_at_m
        own = [entry for point in points for entry in use_default(point, self.at_m)]
        return [*own, *unit_vector(self.side)]


class SpatialMovingMass(InSpace, elements.MovingMass):
    """Moving mass of a robot in space."""

    #: Place of the mass for an input of 0.
    at_m: Vector
    #: Displacement of the mass for an input of 1.
    travel_m: Vector = (1.0, 0.0, 0.0)

    @property
    def travel(self) -> Components:
        """Displacement of the mass for an input of 1, m."""
        return self.travel_m


class SpatialDerivatives(InSpace, Derivatives):
    """Hydrodynamic derivatives of a link at a point."""


Element = Annotated[
    SpatialAddedMass
    | Spheroid
    | Plate
    | SpatialDrag
    | SpatialDamping
    | SpatialFoil
    | SpatialHydrostatics
    | Water
    | SpatialForce
    | SpatialLoad
    | SpatialPropeller
    | SpatialRudder
    | SpatialMovingMass
    | SpatialDerivatives,
    Field(discriminator="kind"),
]


class HingeStroke(yamlio.Document):
    """Cyclic motion of several driven hinges, given by their angles at certain times (knots) of a period.

    The angles are interpolated by a smooth periodic curve.
    """

    period_s: PositiveFloat
    #: Times from 0 to the period, s, at which ``angles_deg`` has the angles of each hinge. The last angle of
    #: a hinge equals its first.
    knots_s: Annotated[list[float], Field(min_length=4)]
    angles_deg: dict[str, list[float]]

    @model_validator(mode="after")
    def _periodic(self) -> HingeStroke:
        if any(b <= a for a, b in pairwise(self.knots_s)):
            raise ValueError(f"knots_s must increase: {self.knots_s}")
        if self.knots_s[0] != 0.0 or not math.isclose(self.knots_s[-1], self.period_s):
            raise ValueError(f"knots_s must run from 0 to period_s, {self.period_s:g}: {self.knots_s}")
        for name, angles in self.angles_deg.items():
            if len(angles) != len(self.knots_s):
                raise ValueError(f"'{name}' has {len(angles)} angles at {len(self.knots_s)} knots")
            if angles[0] != angles[-1]:
                raise ValueError(
                    f"'{name}': the last angle {angles[-1]:g} must equal the first, {angles[0]:g}"
                )
        return self


class SpatialReference(yamlio.Document):
    """Point of the first link of a robot in 3-D: the reference point whose pose is logged, or a marker."""

    at_m: Direction = (0.0, 0.0, 0.0)


class MultibodyRobot(yamlio.Document):
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
    reference: SpatialReference = SpatialReference()
    markers: dict[str, SpatialReference] = {}
    #: Height z of the water surface in the world frame, m. Without this entry, the robot is always under
    #: water.
    surface_z_m: float | None = None
    coefficients: Coefficients = {}
    inputs: dict[str, Input] = {}
    #: Actuators that several driven hinges follow, by name.
    actuators: dict[str, Actuator] = {}
    links: Annotated[list[SpatialLink], Field(min_length=1)]
    joints: list[Hinge] = []
    elements: list[Element] = []
    strokes: dict[str, HingeStroke] = {}

    @model_validator(mode="after")
    def _names(self) -> MultibodyRobot:
        driven = [h.name for h in self.joints if h.driven is not None and h.driven.actuator is None]
        driven += self.actuators
        for stroke, law in self.strokes.items():
            unknown = [name for name in law.angles_deg if name not in driven]
            if unknown:
                raise ValueError(
                    f"the stroke '{stroke}' cannot move '{unknown[0]}': name an actuator, or a driven hinge "
                    "without 'actuator'; there are: "
                    f"{', '.join(driven) or 'none'}"
                )
        return self
