"""Entries of a robot file for a robot that moves in a plane: links, joints and forms of the elements.

A station is a distance along a link, measured backwards from its front end. An offset is a distance to port
(upwards in the vertical plane). Any physical quantity may be a product with named coefficients, such as
``"2.133 * c_ma"`` (:mod:`swimid.robots.quantities`).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import pairwise
from typing import Annotated, ClassVar, Literal

from pydantic import Field, PositiveFloat, model_validator

from swimid.files import yamlio
from swimid.robots import elements
from swimid.robots.elements import Derivatives, MovingMass, OnLink, derivative_parts
from swimid.robots.joints import Actuator, Holder, Input, Joint, Tendon, Yielding
from swimid.robots.quantities import (
    Coefficients,
    Components,
    Entry,
    Polynomial,
    Quantity,
    gauss_points,
    multiply_pairs,
    use_default,
)


def point_of(station: Quantity, offset: Quantity) -> list[Polynomial]:
    """Return the position of a point in the axes of its link, from its station and its offset."""
    return [-Polynomial.of(station), Polynomial.of(offset), Polynomial.of(0.0)]


class Link(yamlio.Document):
    """Rigid link of a robot in a plane.

    The origin of its axes is at its front end, and the x axis points forward.
    """

    name: str
    length_m: PositiveFloat
    mass_kg: Quantity
    #: Distance of the centre of mass behind the front end of the link, m.
    com_m: Quantity
    com_offset_m: Quantity = 0.0
    inertia_kg_m2: Quantity
    #: Point about which the inertia of the link is given: its front end or its centre of mass.
    inertia_about: Literal["front", "com"]

    @property
    def centre(self) -> list[Polynomial]:
        """Centre of mass in the axes of the link, m."""
        return point_of(self.com_m, self.com_offset_m)

    @property
    def moments(self) -> list[Entry]:
        """Moments of inertia about the centre of mass: xx, yy, zz, xy, xz, yz, kg m2."""
        inertia = Polynomial.of(self.inertia_kg_m2)
        if self.inertia_about == "front":
            x, y, _ = self.centre
            inertia = inertia - Polynomial.of(self.mass_kg) * (x * x + y * y)
        return [0.0, 0.0, inertia, 0.0, 0.0, 0.0]


class Passive(Yielding):
    """Law of the moment in a passive joint of a robot in a plane, which may also have a tendon."""

    tendon: Tendon | None = None


class PlanarJoint(Joint):
    """Joint between a parent link and a child link of a robot in a plane.

    A positive angle rotates the child link counter-clockwise.
    """

    #: Distance of the joint behind the front end of the parent link, m; by default at its rear end.
    at_m: Quantity | None = None
    offset_m: Quantity = 0.0
    #: Angle of the child link relative to the parent link at zero joint angle, degrees.
    mount_deg: float = 0.0
    passive: Passive | None = None
    #: Direction of the rotation axis in the axes of the child link.
    axis: ClassVar[tuple[float, float, float]] = (0.0, 0.0, 1.0)

    def point(self, parent: Link) -> Components:
        """Return the position of the joint in the axes of the parent link, m."""
        return point_of(use_default(self.at_m, parent.length_m), self.offset_m)

    @property
    def mount_angles_deg(self) -> tuple[float, float, float]:
        """Rotation about x, y and z from the parent to the child at zero joint angle, degrees."""
        return 0.0, 0.0, self.mount_deg


class InPlane(OnLink):
    """Base class of elements in a plane that act at a point, which is given by its station and offset."""

    #: Distance of the element behind the front end of its link, m.
    at_m: Quantity | None = None
    #: Distance of the element to port (upwards in the vertical plane), m.
    offset_m: Quantity = 0.0
    #: Half the height of the band about the water surface. None, because an element in a plane is always
    #: under water.
    half_height_m: ClassVar[float | None] = None

    def point(self, link: Link) -> Components:
        """Return the position of the element in the axes of its link, m; by default the centre of mass."""
        return point_of(use_default(self.at_m, link.com_m), self.offset_m)


class PlanarAddedMass(InPlane, elements.AddedMass):
    """Added mass and added moment of inertia of a link, concentrated at one point of the link."""

    surge_kg: Quantity = 0.0
    sway_kg: Quantity = 0.0
    inertia_kg_m2: Quantity = 0.0

    @property
    def masses(self) -> Components:
        """Added mass for motion along each axis, kg."""
        return self.surge_kg, self.sway_kg, 0.0

    @property
    def inertias(self) -> Components:
        """Added moment of inertia about each axis, kg m2."""
        return 0.0, 0.0, self.inertia_kg_m2


class PlanarDrag(InPlane, elements.Drag):
    """Morison drag along and across a link (tendon fish, Eq 7), at one point or spread evenly along it."""

    axial_area_m2: Quantity = 0.0
    axial_coefficient: Quantity = 0.0
    normal_area_m2: Quantity = 0.0
    normal_coefficient: Quantity = 0.0
    #: Linear drag of the whole element for motion along the link: force divided by velocity, N s/m.
    axial_linear_N_s_m: Quantity = 0.0
    normal_linear_N_s_m: Quantity = 0.0
    #: Number of strips along the link on which the drag acts, at the points of Gauss's rule. With one strip,
    #: the drag acts at the point ``at_m`` (default: the middle of the link).
    strips: Annotated[int, Field(ge=1, le=200)] = 3
    from_m: float | None = None
    to_m: float | None = None

    @model_validator(mode="after")
    def _point_or_strips(self) -> PlanarDrag:
        if self.at_m is not None and self.strips != 1:
            raise ValueError(
                "at_m gives a single point, but strips is not 1: set strips: 1, or give from_m and to_m"
            )
        if self.to_m is not None and self.to_m <= (self.from_m or 0.0):
            raise ValueError(f"to_m is {self.to_m:g}; it must be greater than from_m, {self.from_m or 0.0:g}")
        return self

    def quadratic(self, half_density: float) -> Components:
        """Return the quadratic drag along each axis, N s2/m2, for half the density of the water."""
        areas = self.axial_area_m2, self.normal_area_m2, 0.0
        coefficients = self.axial_coefficient, self.normal_coefficient, 0.0
        return [half_density * product for product in multiply_pairs(areas, coefficients)]

    @property
    def linear(self) -> Components:
        """Linear drag along each axis, N s/m."""
        return self.axial_linear_N_s_m, self.normal_linear_N_s_m, 0.0

    def points(self, link: Link) -> Iterator[tuple[Components, float]]:
        """Yield the points at which the drag acts, each with its share of the drag."""
        if self.at_m is not None:
            yield point_of(self.at_m, self.offset_m), 1.0
            return
        rear = use_default(self.to_m, link.length_m)
        for station, share in gauss_points(self.from_m or 0.0, rear, self.strips):
            yield point_of(station, self.offset_m), share


class PlanarDamping(elements.Damping):
    """Linear and quadratic damping moment that opposes the rotation of a link in the plane."""

    linear_N_m_s_rad: Quantity = 0.0
    quadratic_N_m_s2_rad2: Quantity = 0.0

    @property
    def moments(self) -> Components:
        """Quadratic and linear damping moments about x, y and z."""
        return 0.0, 0.0, self.quadratic_N_m_s2_rad2, 0.0, 0.0, self.linear_N_m_s_rad


class Section(yamlio.Document):
    """Cross-section of a link at one station: its height normal to the plane of motion, and its perimeter."""

    station_m: Annotated[float, Field(ge=0)]
    height_m: Annotated[float, Field(ge=0)]
    perimeter_m: Annotated[float, Field(ge=0)]


class SlenderBody(OnLink):
    """Added mass and drag of a slender link with varying cross-section (dolphin paper, Eqs 4, 7 and 8).

    Added mass and drag act on strips along the link.
    """

    kind: Literal["slender-body"]
    #: Cross-sections of the link, in order from its front end backwards. Height and perimeter are
    #: interpolated linearly between two cross-sections.
    sections: Annotated[list[Section], Field(min_length=2)]
    added_mass_coefficient: Quantity = 0.0
    friction_coefficient: Quantity = 0.0
    drag_coefficient: Quantity = 0.0
    added_mass_direction: Literal["both", "normal"] = "both"
    strips: Annotated[int, Field(ge=1, le=200)] = 5

    @model_validator(mode="after")
    def _check_order(self) -> SlenderBody:
        stations = [s.station_m for s in self.sections]
        if any(b <= a for a, b in pairwise(stations)):
            raise ValueError(f"the stations of the sections must increase, but they are {stations}")
        return self


class PlanarFoil(InPlane, elements.Foil):
    """Lift and drag of a fin at one point of a link (dolphin paper, Eq 9).

    The polar is that of a flat plate with the angle of attack a: C_l = lift sin(2 a), C_d = drag0 + drag1 (1
    - cos(2 a)).
    """

    at_m: Quantity
    #: Angle from the x axis of the link to the chord of the fin, counter-clockwise, degrees.
    chord_deg: float = 0.0

    @property
    def directions(self) -> Components:
        """Unit vectors along the chord and normal to it."""
        c, s = math.cos(math.radians(self.chord_deg)), math.sin(math.radians(self.chord_deg))
        return c, s, 0.0, -s, c, 0.0


class TrailingEdge(InPlane):
    """Momentum shed into the wake where a slender body or its caudal fin ends (Lighthill 1971).

    Use it together with lateral added mass of the links, whose impulse is the other part of Lighthill's
    force. Use either a trailing edge or a foil on a fin, never both, because each accounts for the whole
    force.
    """

    kind: Literal["trailing-edge"]
    #: Lateral added mass per length at the trailing edge: rho pi h^2 / 4 for an edge of height h.
    added_mass_kg_m: Quantity
    #: Distance of the trailing edge behind the front end of the link, m; by default at its rear end.
    at_m: Quantity | None = None

    def point(self, link: Link) -> Components:
        """Return the position of the trailing edge in the axes of its link, m."""
        return point_of(use_default(self.at_m, link.length_m), self.offset_m)


class PlanarHydrostatics(elements.Hydrostatics):
    """Weight and buoyancy of a link, for a robot that moves in the vertical plane."""

    buoyancy_at_m: Quantity | None = None
    buoyancy_offset_m: Quantity = 0.0
    half_height_m: ClassVar[float | None] = None

    def point(self, link: Link) -> Components:
        """Return the centre of buoyancy in the axes of the link, m."""
        return point_of(use_default(self.buoyancy_at_m, link.com_m), self.buoyancy_offset_m)


class PlanarForce(InPlane, elements.Force):
    """Constant force that acts at a point of a link, with components in the axes of the link or the world."""

    at_m: Quantity = 0.0
    forward_N: Quantity = 0.0
    port_N: Quantity = 0.0

    @property
    def force(self) -> Components:
        """Components of the force, N."""
        return self.forward_N, self.port_N, 0.0


class PlanarLoad(InPlane, elements.Load):
    """Force and moment on a link that are proportional to an input, for an input of 1 behind its actuator.

    Examples are a thruster, a towing line with a load cell, a measured force, and a variable buoyancy.
    """

    at_m: Quantity = 0.0
    #: Force and moment divided by the value of the input after the law of its actuator.
    forward_N: Quantity = 0.0
    port_N: Quantity = 0.0
    moment_N_m: Quantity = 0.0

    @property
    def wrench(self) -> Components:
        """Components of the force (N) and of the moment (N m) for an input of 1."""
        return self.forward_N, self.port_N, 0.0, 0.0, 0.0, self.moment_N_m


class PlanarPropeller(InPlane, elements.Propeller):
    """Propeller at a point of a link of a robot in a plane."""

    at_m: Quantity
    #: Angle from the x axis of the link to the direction of a positive thrust, counter-clockwise, degrees.
    axis_deg: float = 0.0

    @property
    def direction(self) -> Components:
        """Unit vector of a positive thrust."""
        return math.cos(math.radians(self.axis_deg)), math.sin(math.radians(self.axis_deg)), 0.0


class PlanarRudder(InPlane, elements.Rudder):
    """Rudder of a robot in a plane."""

    at_m: Quantity
    #: Station at which the induced lateral force acts on the hull; by default that of the rudder.
    hull_force_at_m: Quantity | None = None
    #: Station whose lateral velocity is that of the inflow (the length l_R); by default that of the rudder.
    inflow_at_m: Quantity | None = None

    @property
    def points(self) -> Components:
        """Points of the force on the rudder, of the force on the hull and of the inflow, and the side."""
        stations = self.at_m, self.hull_force_at_m, self.inflow_at_m
        points = [point_of(use_default(station, self.at_m), self.offset_m) for station in stations]
        return [entry for point in points for entry in point] + [0.0, 1.0, 0.0]


class PlanarMovingMass(InPlane, MovingMass):
    """Moving mass of a robot in a plane."""

    #: Place of the mass for an input of 0: its station and offset.
    at_m: Quantity
    #: Displacement of the mass for an input of 1, forward and to port (upwards in the vertical plane).
    travel_m: tuple[Quantity, Quantity] = (1.0, 0.0)

    @property
    def travel(self) -> Components:
        """Displacement of the mass for an input of 1, m."""
        return *self.travel_m, 0.0


class PlanarDerivatives(InPlane, Derivatives):
    """Hydrodynamic derivatives of a link of a robot in a plane.

    The horizontal plane has X, Y, N and u, v, r. The vertical plane has X, Z, M and u, w, q, with q positive
    nose up. The point at which the terms act is by default the centre of mass.
    """


Element = Annotated[
    PlanarAddedMass
    | PlanarDrag
    | PlanarDamping
    | SlenderBody
    | PlanarFoil
    | TrailingEdge
    | PlanarHydrostatics
    | PlanarForce
    | PlanarLoad
    | PlanarPropeller
    | PlanarRudder
    | PlanarMovingMass
    | PlanarDerivatives,
    Field(discriminator="kind"),
]

#: Components and velocities of hydrodynamic derivatives in each plane of motion.
PLANE_LETTERS = {"horizontal": ("XYN", "uvr"), "vertical": ("XZM", "uwq")}


class PlanarReference(yamlio.Document):
    """Point of the first link of a robot in a plane: the reference point of the logged pose, or a marker."""

    station_m: float = 0.0
    offset_m: float = 0.0


class TrackedPoint(yamlio.Document):
    """Place of a tracked point on a robot in a plane: its link, and coordinates in the axes of this link.

    The origin of the axes is the front end of the link. x points forward, y to port (upwards in the vertical
    plane).
    """

    link: str
    at_m: tuple[float, float]


class MultilinkRobot(yamlio.Document):
    """Robot that moves in a plane: a tree of links with their joints and hydrodynamic elements.

    The first link is the base. Its front end is the point whose pose the log holds, unless ``reference``
    names another point. Stations are measured along a link from its front end backwards, offsets to port
    (upwards in the vertical plane).

    Example::

        multilink:
          plane: horizontal
          coefficients:
            c_n: {value: 1.5, bounds: [0, 5], meaning: normal drag, source: guess}
            k_t: {value: 0.1, unit: N m/rad, bounds: [0, 2], free: false}
          links:
            - {name: body, length_m: 0.2, mass_kg: 0.8, com_m: 0.09, inertia_kg_m2: 0.003, inertia_about: com}
            - {name: tail, length_m: 0.1, mass_kg: 0.05, com_m: 0.04, inertia_kg_m2: 4e-5, inertia_about: com}
            - {name: fin, length_m: 0.06, mass_kg: 0.01, com_m: 0.03, inertia_kg_m2: 3e-6, inertia_about: com}
          joints:                     # joint1_rad, joint2_rad, ... in the log, in this order
            - {name: hip, parent: body, child: tail, driven: {gain: 1.0}}
            - {name: hinge, parent: tail, child: fin, passive: {stiffness_N_m_rad: k_t}}
          elements:
            - {kind: drag, link: body, normal_area_m2: 0.02, normal_coefficient: c_n, strips: 4}
            - {kind: added-mass, link: body, surge_kg: 0.1, sway_kg: 0.7, inertia_kg_m2: 0.002}
            - {kind: foil, link: fin, area_m2: 0.005, at_m: 0.02, lift_coefficient: 1.2}
    """

    plane: Literal["horizontal", "vertical"]
    base: Literal["free", "fixed"] = "free"
    holder: Holder | None = None
    #: Heading of the first link if its base is fixed to the world, counter-clockwise, degrees.
    heading_deg: float = 0.0
    reference: PlanarReference = PlanarReference()
    markers: dict[str, PlanarReference] = {}
    #: Places of points that a tracker follows in a film, by the names that the tracker uses.
    points: dict[str, TrackedPoint] = {}
    coefficients: Coefficients = {}
    inputs: dict[str, Input] = {}
    #: Actuators that several driven joints follow, by name.
    actuators: dict[str, Actuator] = {}
    links: Annotated[list[Link], Field(min_length=1)]
    joints: list[PlanarJoint] = []
    elements: list[Element] = []

    @model_validator(mode="after")
    def _letters(self) -> MultilinkRobot:
        components, velocities = PLANE_LETTERS[self.plane]
        for element in self.elements:
            if isinstance(element, MovingMass) and element.weighs and self.plane == "horizontal":
                raise ValueError("'weighs' is set, but weight does not act in a horizontal plane: omit it")
            for name in element.terms if isinstance(element, Derivatives) else ():
                component, factors = derivative_parts(name)
                used = {factor.strip("|") for factor in factors} - {"U", "/U"}
                if component not in components or not used <= set(velocities):
                    raise ValueError(
                        f"the derivative '{name}' is not in the {self.plane} plane, which has the components "
                        f"{', '.join(components)} and the velocities {', '.join(velocities)}"
                    )
        return self
