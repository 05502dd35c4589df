"""Entries of a robot file for a robot that moves in a plane: links, joints and hydrodynamic elements.

A station is a distance along a link, measured backwards from its front end. An offset is a distance to port
(upwards in the vertical plane). Any physical quantity may be a product with named coefficients, such as
``"2.133 * c_ma"``. A gray-box fit estimates these coefficients.
"""

from __future__ import annotations

import math
import re
from itertools import pairwise
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, BeforeValidator, Field, PositiveFloat, model_validator

from swimid.files import yamlio

#: Pattern of the name of a coefficient in a robot file.
NAME = re.compile(r"[A-Za-z_]\w*")


def factors(quantity: float | str) -> tuple[float, tuple[str, ...]]:
    """Split a quantity of a robot file into its numeric factor and the names of its coefficients.

    Raises
    ------
    ValueError
        If a factor is neither a number nor a name.

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


#: Type of a physical quantity in a robot file: a number, or a product of numbers and named coefficients.
Quantity = Annotated[float | str, BeforeValidator(_quantity)]


class Coefficient(yamlio.Document):
    """Named coefficient of a robot file: its value, and its bounds and start value in a fit."""

    value: float
    unit: str = "1"
    bounds: tuple[float | None, float | None] = (None, None)
    #: Start value of the coefficient in a fit; the default is ``value``.
    start: float | None = None
    #: Typical size of the coefficient. Its estimate is not identifiable if the standard error exceeds half of
    #: this size and also half of the estimate.
    scale: PositiveFloat | None = None
    #: Whether a fit estimates the coefficient by default.
    free: bool = True
    #: Whether the coefficient has a separate value for each trial, such as the trim of the robot.
    per_trial: bool = False
    meaning: str = ""
    source: str = ""

    @property
    def limits(self) -> tuple[float, float]:
        """Lower and upper bound of the coefficient. A bound that the file omits is infinite."""
        return yamlio.limits(self.bounds)

    @model_validator(mode="after")
    def _in_bounds(self) -> Coefficient:
        low, high = self.limits
        if not low < high:
            raise ValueError(f"the bounds are the wrong way round: {self.bounds[0]} {self.bounds[1]}")
        for name, value in (("value", self.value), ("start", self.start)):
            if value is not None and not low <= value <= high:
                raise ValueError(f"its {name} {value:g} lies outside its bounds")
        return self


def _check_coefficient_names(coefficients: dict[str, Coefficient]) -> dict[str, Coefficient]:
    for name in coefficients:
        if not NAME.fullmatch(name):
            raise ValueError(f"a coefficient cannot be called '{name}': letters, digits and _ only")
    return coefficients


Coefficients = Annotated[dict[str, Coefficient], AfterValidator(_check_coefficient_names)]


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


class Servo(yamlio.Document):
    """Second-order system with the commanded angle of a joint as input and the joint angle as output."""

    natural_frequency_hz: Quantity
    damping_ratio: Quantity = 0.7


class Tendon(yamlio.Document):
    """Wire with a spring that pulls a passive joint to zero angle (tendon fish paper, Eqs 3 and 4)."""

    spring_N_m: Quantity
    pretension_m: Quantity
    arm_m: PositiveFloat
    crank_m: PositiveFloat

    @model_validator(mode="after")
    def _crank_shorter(self) -> Tendon:
        if self.crank_m >= self.arm_m:
            raise ValueError(
                "crank_m must be shorter than arm_m; otherwise the wire is loose at zero angle (Eq 3)"
            )
        return self


class Actuator(yamlio.Document):
    """Law of an actuator, whose angle follows the drive of the trial or a logged angle."""

    #: Amplitude of the angle divided by the amplitude of the drive. The bias of the drive is multiplied by
    #: the same factor unless ``bias_gain`` is given.
    gain: float = 1.0
    bias_gain: float | None = None
    #: Phase lag of the angle behind the drive, degrees.
    phase_lag_deg: float = 0.0
    servo: Servo | None = None
    #: Maximum absolute angle and rate that may be commanded. Proposed trials respect these limits. Recorded
    #: trials are not checked.
    max_angle_deg: PositiveFloat | None = None
    max_rate_deg_s: PositiveFloat | None = None


class Driven(Actuator):
    """Law of a driven joint: its own actuator, or the transmission by which it follows a shared actuator.

    A shared actuator is named under ``actuators``, such as a tendon over several joints. The drive of a trial
    moves the actuator. Without a drive, the log has its measured angle (``joint_tendon_rad``) or its command
    (``cmd_tendon_rad``). Logged angles of the joints are then channels that a fit compares. Servo, limits and
    effects of actuation act on the actuator, and the joints follow without play.
    """

    #: Name of the shared actuator; by default the joint has its own.
    actuator: str | None = None
    #: Angle of the joint divided by that of the shared actuator.
    ratio: Quantity = 1.0
    #: Rows of actuator angle and joint angle, degrees, in place of a ratio. The actuator angles increase. A
    #: monotone cubic (PCHIP) interpolates the rows; beyond them the joint follows the tangent (SWM077).
    table_deg: Annotated[list[tuple[float, float]], Field(min_length=2)] | None = None

    @property
    def is_computed(self) -> bool:
        """Whether the angle is computed, from a command or a shared actuator. It is then never given."""
        return self.servo is not None or self.actuator is not None

    @model_validator(mode="after")
    def _one_law(self) -> Self:
        fields = Driven.model_fields
        stated = {name for name in self.model_fields_set if getattr(self, name) != fields[name].default}
        transmission = sorted(stated & {"ratio", "table_deg"})
        own = sorted(stated & set(Actuator.model_fields))
        if self.actuator is None:
            if transmission:
                raise ValueError(f"'{transmission[0]}' needs an 'actuator': name one of 'actuators'")
            return self
        if own:
            raise ValueError(
                f"'{own[0]}' would drive the joint a second time, because it follows the actuator "
                f"'{self.actuator}': state '{own[0]}' under 'actuators'"
            )
        if len(transmission) == 2:
            raise ValueError("give 'ratio' or 'table_deg', not both")
        for (low, _), (high, _) in pairwise(self.table_deg or ()):
            if high <= low:
                raise ValueError(
                    f"the actuator angles of 'table_deg' must increase, but {high:g} follows {low:g}: "
                    "sort the rows, and give each actuator angle once"
                )
        return self


class Yielding(yamlio.Document):
    """Law of the moment in a passive joint: spring, damper and dry friction."""

    stiffness_N_m_rad: Quantity = 0.0
    cubic_N_m_rad3: Quantity = 0.0
    damping_N_m_s_rad: Quantity = 0.0
    quadratic_damping_N_m_s2_rad2: Quantity = 0.0
    #: Moment of the dry friction in the joint, N m. It is smoothed at joint rates below
    #: ``friction_below_rad_s``.
    friction_N_m: Quantity = 0.0
    friction_below_rad_s: PositiveFloat = 0.02
    rest_deg: float = 0.0


class Passive(Yielding):
    """Law of the moment in a passive joint of a robot in a plane, which may also have a tendon."""

    tendon: Tendon | None = None


class Input(yamlio.Document):
    """Column of a log that loads act by, and the law of the actuator between the column and the loads.

    The law maps a value u of the column to ``sign(u) (|u| - dead_band)^power``, or 0 within the dead band.
    The result is multiplied by ``reverse`` if u is negative. It follows with a first-order lag. Between its
    samples a column is linear.

    Example::

        inputs:
          bow: {column: bow_N, measured: true}
          stern: {column: stern_pwm, power: 2, dead_band: 0.07, reverse: k_back, lag_s: tau}
        elements:
          - {kind: load, link: body, input: stern, at_m: 0.2, forward_N: k_s}
    """

    #: Column of the log: a measured force or torque, or the command of an actuator.
    column: str
    #: Whether the column was measured behind the actuator. Effects of actuators then do not apply.
    measured: bool = False
    power: Quantity = 1.0
    #: Absolute value of the column up to which the loads are zero, in the unit of the column.
    dead_band: Quantity = 0.0
    #: Factor on the loads for negative values of the column, for example of a propeller in reverse.
    reverse: Quantity = 1.0
    lag_s: Quantity = 0.0


class Torque(yamlio.Document):
    """Torque of an actuator on a passive joint, in the direction of a positive joint angle."""

    input: str
    #: Torque divided by the value of the input after the law of its actuator.
    gain_N_m: Quantity = 1.0


class Connection(yamlio.Document):
    """Connection between a parent link and a child link: a rigid, a driven or a passive joint."""

    name: str
    parent: str
    child: str
    driven: Driven | None = None
    passive: Yielding | None = None
    torque: Torque | None = None

    @model_validator(mode="after")
    def _one_kind(self) -> Self:
        if self.driven is not None and self.passive is not None:
            raise ValueError(f"the joint '{self.name}' is both driven and passive")
        if self.torque is not None and self.passive is None:
            raise ValueError(f"the joint '{self.name}' has a torque but is not passive: add 'passive: {{}}'")
        return self


class Joint(Connection):
    """Joint between a parent link and a child link of a robot in a plane.

    A positive angle rotates the child link counter-clockwise.
    """

    #: Distance of the joint behind the front end of the parent link, m; by default at its rear end.
    at_m: Quantity | None = None
    offset_m: Quantity = 0.0
    #: Angle of the child link relative to the parent link at zero joint angle, degrees.
    mount_deg: float = 0.0
    passive: Passive | None = None


class OnLink(yamlio.Document):
    """Base class of the hydrodynamic and other force elements of a robot file. Each acts on one link."""

    link: str
    #: Name of the element, to which the interpretations of the published source (``readings``) refer.
    name: str = ""


class AddedMass(OnLink):
    """Added mass and added moment of inertia of a link, concentrated at one point of the link."""

    kind: Literal["added-mass"]
    surge_kg: Quantity = 0.0
    sway_kg: Quantity = 0.0
    inertia_kg_m2: Quantity = 0.0
    at_m: Quantity | None = None
    offset_m: Quantity = 0.0


class Drag(OnLink):
    """Morison drag along and across a link, at one point or distributed evenly along the link."""

    kind: Literal["drag"]
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
    """Linear and quadratic damping moment that opposes the rotation of a link in the plane."""

    kind: Literal["damping"]
    linear_N_m_s_rad: Quantity = 0.0
    quadratic_N_m_s2_rad2: Quantity = 0.0


class Section(yamlio.Document):
    """Cross-section of a link at one station: its height normal to the plane of motion, and its perimeter."""

    station_m: Annotated[float, Field(ge=0)]
    height_m: Annotated[float, Field(ge=0)]
    perimeter_m: Annotated[float, Field(ge=0)]


class SlenderBody(OnLink):
    """Added mass and drag of a slender link with varying cross-section (dolphin paper, Eqs 4, 7 and 8).

    They act on strips along the link.
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
            raise ValueError("the stations of the sections must increase")
        return self


class Foil(OnLink):
    """Lift and drag of a fin at one point of a link (dolphin paper, Eq 9).

    The polar is that of a flat plate with the angle of attack a: C_l = lift sin(2 a), C_d = drag0 + drag1 (1
    - cos(2 a)).
    """

    kind: Literal["foil"]
    area_m2: Quantity
    at_m: Quantity
    offset_m: Quantity = 0.0
    #: Angle from the x axis of the link to the chord of the fin, counter-clockwise, degrees.
    chord_deg: float = 0.0
    lift_coefficient: Quantity
    drag_coefficient_0: Quantity = 0.0
    drag_coefficient_1: Quantity = 0.0


class TrailingEdge(OnLink):
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
    offset_m: Quantity = 0.0


class Hydrostatics(OnLink):
    """Weight and buoyancy of a link, for a robot that moves in the vertical plane."""

    kind: Literal["hydrostatics"]
    volume_m3: Quantity = 0.0
    buoyancy_at_m: Quantity | None = None
    buoyancy_offset_m: Quantity = 0.0


class Force(OnLink):
    """Constant force that acts at a point of a link, with components in the axes of the link or the world."""

    kind: Literal["force"]
    at_m: Quantity = 0.0
    offset_m: Quantity = 0.0
    forward_N: Quantity = 0.0
    port_N: Quantity = 0.0
    frame: Literal["link", "world"] = "link"


class Load(OnLink):
    """Force and moment on a link that are proportional to an input.

    Examples are a thruster, a towing line with a load cell, a measured force, and a variable buoyancy.
    """

    kind: Literal["load"]
    input: str
    at_m: Quantity = 0.0
    offset_m: Quantity = 0.0
    #: Force and moment divided by the value of the input after the law of its actuator.
    forward_N: Quantity = 0.0
    port_N: Quantity = 0.0
    moment_N_m: Quantity = 0.0
    #: Axes of the force: those of the link, or those of the world, as for a buoyancy.
    frame: Literal["link", "world"] = "link"


class PropellerLaw(OnLink):
    """Law of a propeller: ``T = rho n^2 D^4 K_T(J)`` with the advance ratio ``J = u_a / (n D)``.

    The input is the rate n, 1/s. ``u_a`` is 1 - w times the velocity of the propeller through the water along
    its axis. The force on the link is (1 - t) T along the axis. The polynomial K_T also holds for negative J.
    A propeller that turns backwards has the thrust of its mirror image, ``T(-n, -u_a) = -T(n, u_a)``.
    """

    kind: Literal["propeller"]
    input: str
    diameter_m: PositiveFloat
    #: Coefficients k_0, k_1, k_2 of ``K_T = k_0 + k_1 J + k_2 J^2``. The last ones may be omitted.
    thrust_coefficients: Annotated[list[Quantity], Field(min_length=1, max_length=3)]
    #: Wake fraction w: the water behind a hull moves with the hull by this share of its velocity.
    wake_fraction: Quantity = 0.0
    #: Growth of 1 - w in oblique motion: ``1 + (1 - exp(-C_1 |sin b|)) (C_2 - 1)``. The drift angle b is that
    #: of the propeller. The entries are C_1, and C_2 for motion of the propeller to port and to starboard.
    wake_decay: Quantity = 0.0
    wake_port: Quantity = 1.0
    wake_starboard: Quantity = 1.0
    #: Thrust deduction fraction t: the suction of the propeller on the hull, as a share of its thrust.
    thrust_deduction: Quantity = 0.0


class Propeller(PropellerLaw):
    """Propeller at a point of a link of a robot in a plane."""

    at_m: Quantity
    offset_m: Quantity = 0.0
    #: Angle from the x axis of the link to the direction of a positive thrust, counter-clockwise, degrees.
    axis_deg: float = 0.0


class RudderLaw(OnLink):
    """Law of a rudder of the MMG model (Yasukawa and Yoshimura 2015, J. Mar. Sci. Technol. 20:37-52).

    The input is the rudder angle d, rad. A positive angle turns a hull ahead of the rudder to port. The
    normal force is ``F_N = rho / 2 A_R f_a U_R^2 sin(a_R)``. The inflow along the hull is
    ``u_R = e sqrt(h (u_P + k (u_inf - u_P))^2 + (1 - h) u_P^2)`` with the far slipstream
    ``u_inf = sqrt(u_P^2 + 8 T / (pi rho D^2))`` of the propeller. The inflow across is g times the velocity
    of the hull there. The forces are ``-(1 - t_R) F_N sin d`` forward and ``-F_N cos d`` to port at the
    rudder, and ``-a_H F_N cos d`` to port at a point of the hull.
    """

    kind: Literal["rudder"]
    input: str
    #: Name of the propeller whose slipstream meets the rudder; empty for a rudder in open water.
    propeller: str = ""
    area_m2: Quantity
    #: Slope f_a of the normal force coefficient with the sine of the angle of attack.
    lift_slope: Quantity
    #: Velocity of the inflow divided by that at the propeller (e).
    inflow_ratio: Quantity = 1.0
    #: Share k of the far slipstream's growth of velocity that is reached at the rudder.
    slipstream_gain: Quantity = 1.0
    #: Share h of the rudder's height in the slipstream: propeller diameter divided by rudder height.
    slipstream_share: Quantity = 1.0
    #: Flow straightening coefficient g if the hull moves to port at the point of the inflow.
    straightening: Quantity = 1.0
    #: Flow straightening coefficient g for motion to starboard; by default that for motion to port.
    straightening_starboard: Quantity | None = None
    #: Steering resistance deduction t_R.
    resistance_deduction: Quantity = 0.0
    #: Lateral force a_H on the hull that the rudder induces, as a share of that on the rudder.
    hull_force: Quantity = 0.0


class Rudder(RudderLaw):
    """Rudder of a robot in a plane."""

    at_m: Quantity
    offset_m: Quantity = 0.0
    #: Station at which the induced lateral force acts on the hull; by default that of the rudder.
    hull_force_at_m: Quantity | None = None
    #: Station whose lateral velocity is that of the inflow (the length l_R); by default that of the rudder.
    inflow_at_m: Quantity | None = None


class MovingMassLaw(OnLink):
    """Mass that an input moves along a line of a link, as the battery of a glider.

    It moves the centre of mass and changes the inertia of the link. Its acceleration pushes the link back.
    The mass of the link does not include it. The input is a position, by default in m.
    """

    kind: Literal["moving-mass"]
    input: str
    mass_kg: Quantity
    #: Whether the weight of the mass acts, which moves with it. In a plane only if it is vertical.
    weighs: bool = False


class MovingMass(MovingMassLaw):
    """Moving mass of a robot in a plane."""

    #: Place of the mass for an input of 0: its station and offset.
    at_m: Quantity
    offset_m: Quantity = 0.0
    #: Displacement of the mass for an input of 1, forward and to port (upwards in the vertical plane).
    travel_m: tuple[Quantity, Quantity] = (1.0, 0.0)


#: Pattern of the name of a hydrodynamic derivative: a component, velocities with or without absolute value,
#: and divisions by the speed.
DERIVATIVE = re.compile(r"([XYZKMN])_((?:[uvwpqrU]|\|[uvwpqr]\|)+)((?:/U)*)")
#: Maximum number of velocities in a hydrodynamic derivative.
MAX_FACTORS = 6


def derivative_parts(name: str) -> tuple[str, list[str]]:
    """Split the name of a hydrodynamic derivative into its component and its velocities.

    >>> derivative_parts("Y_v|v|r/U")
    ('Y', ['v', '|v|', 'r', '/U'])

    Raises
    ------
    ValueError
        If the name has another form or more than :data:`MAX_FACTORS` velocities.
    """
    found = DERIVATIVE.fullmatch(name)
    if found is None:
        raise ValueError(
            f"'{name}' is no hydrodynamic derivative: write a component (X, Y, Z, K, M, N), '_' and "
            "velocities (u, v, w, p, q, r, |v|, the speed U, /U), such as Y_v, N_vvr, Y_v|v| or N_Uv"
        )
    factors = re.findall(r"\|.\||/?\w", found[2] + found[3])
    if len(factors) > MAX_FACTORS:
        raise ValueError(f"'{name}' has {len(factors)} velocities; at most {MAX_FACTORS} are possible")
    return found[1], factors


def _derivatives(terms: dict[str, Quantity]) -> dict[str, Quantity]:
    for name in terms:
        derivative_parts(name)
    return terms


class DerivativeTerms(OnLink):
    """Force and moment of a link as a sum of products of velocities: hydrodynamic derivatives (SNAME 1950).

    X, Y, Z are forces and K, M, N moments along x, y, z. u, v, w are velocities and p, q, r right-handed
    rates along and about the same axes, and U is the speed. The terms act at a point of the link, whose
    velocities they contain. A name is a component, ``_``, and up to six velocities: ``u``, an absolute value
    ``|v|``, the speed ``U``, or a division ``/U``. For coefficients from axes with y to starboard and z down,
    change the sign if an odd number of the letters Y, Z, M, N, v, w, q, r is in the name. The element
    ``added-mass`` has the moment of added mass in oblique motion, (m_y - m_x) u v. Most publications count it
    in N_v: add it as ``N_uv``.
    """

    kind: Literal["derivatives"]
    #: Coefficients by name: ``{Y_v: -12, N_vvr: c_nvvr, X_u|u|: -3, Y_vvv/U: -40}``, in SI units.
    terms: Annotated[dict[str, Quantity], Field(min_length=1), AfterValidator(_derivatives)]


class Derivatives(DerivativeTerms):
    """Hydrodynamic derivatives of a link of a robot in a plane.

    The horizontal plane has X, Y, N and u, v, r. The vertical plane has X, Z, M and u, w, q, with q positive
    nose up.
    """

    #: Station of the point at which the terms act; by default the centre of mass.
    at_m: Quantity | None = None
    offset_m: Quantity = 0.0


Element = Annotated[
    AddedMass
    | Drag
    | Damping
    | SlenderBody
    | Foil
    | TrailingEdge
    | Hydrostatics
    | Force
    | Load
    | Propeller
    | Rudder
    | MovingMass
    | Derivatives,
    Field(discriminator="kind"),
]

#: Components and velocities of hydrodynamic derivatives in each plane of motion.
PLANE_LETTERS = {"horizontal": ("XYN", "uvr"), "vertical": ("XZM", "uwq")}


class Reference(yamlio.Document):
    """Point of the first link of a robot in a plane: the reference point of the logged pose, or a marker."""

    station_m: float = 0.0
    offset_m: float = 0.0


class Holder(yamlio.Document):
    """Holder of a robot on a fixed base, between the robot and the load cell: a damped resonance.

    A robot with ``base: fixed`` has the force and the torque on its holder as channels, about the reference
    point and in the axes of the world: ``force_x_N``, ``force_y_N``, ``torque_yaw_N_m`` in the horizontal
    plane, ``force_x_N``, ``force_z_N``, ``torque_pitch_N_m`` in the vertical plane, and three forces and
    three torques in space. A fit estimates offset and drift of each channel in each trial. State the
    ``drive`` of such trials: a force of inertia from an encoder has the noise of a second derivative.
    """

    natural_frequency_hz: Quantity
    damping_ratio: Quantity = 0.05


class TrackedPoint(yamlio.Document):
    """Place of a tracked point on a robot in a plane: its link, and coordinates in the axes of this link.

    The origin of the axes is the front end of the link. x points forward, y to port (upwards in the vertical
    plane).
    """

    link: str
    at_m: tuple[float, float]


class Multilink(yamlio.Document):
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
    reference: Reference = Reference()
    markers: dict[str, Reference] = {}
    #: Places of points that a tracker follows in a film, by the names that the tracker uses.
    points: dict[str, TrackedPoint] = {}
    coefficients: Coefficients = {}
    inputs: dict[str, Input] = {}
    #: Actuators that several driven joints follow, by name.
    actuators: dict[str, Actuator] = {}
    links: Annotated[list[Link], Field(min_length=1)]
    joints: list[Joint] = []
    elements: list[Element] = []

    @model_validator(mode="after")
    def _letters(self) -> Multilink:
        components, velocities = PLANE_LETTERS[self.plane]
        for element in self.elements:
            if isinstance(element, MovingMass) and element.weighs and self.plane == "horizontal":
                raise ValueError("'weighs' belongs to a vertical plane: omit it in a horizontal one")
            for name in element.terms if isinstance(element, DerivativeTerms) else ():
                component, factors = derivative_parts(name)
                used = {factor.strip("|") for factor in factors} - {"U", "/U"}
                if component not in components or not used <= set(velocities):
                    raise ValueError(
                        f"the derivative '{name}' is not in the {self.plane} plane, which has the components "
                        f"{', '.join(components)} and the velocities {', '.join(velocities)}"
                    )
        return self
