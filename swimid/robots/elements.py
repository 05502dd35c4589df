"""Hydrodynamic elements and other forces of a robot file, for a robot in a plane and in 3-D.

The class of an element has the entries that do not depend on the axes. Its two forms add the entries with
components: :mod:`swimid.robots.planar` and :mod:`swimid.robots.spatial`. Each form returns its points and
directions with three components along the axes of the link: forward, to port and up. In a plane, the second
axis lies in the plane, and the third component is 0. A function of :mod:`swimid.swimmer.assembly` adds the
element to the equations of motion, for both forms.
"""

from __future__ import annotations

import re
from typing import Annotated, Literal

from pydantic import AfterValidator, Field, PositiveFloat

from swimid.files import yamlio
from swimid.robots.quantities import Quantity


class OnLink(yamlio.Document):
    """Base class of the hydrodynamic and other force elements of a robot file. Each acts on one link."""

    link: str
    #: Name of the element, to which the interpretations of the published source (``readings``) refer.
    name: str = ""


class AddedMass(OnLink):
    """Added mass and added moments of inertia of a link at a point.

    The added mass enters the kinetic energy only (tendon fish Eq 2, dolphin Eq 3). The added-mass force of
    Eqs 6 and 7 in these papers is a derivative of this energy, and must not be applied again.
    """

    kind: Literal["added-mass"]


class Drag(OnLink):
    """Quadratic and linear drag along the axes of a link, at a point or on strips between two points."""

    kind: Literal["drag"]


class Damping(OnLink):
    """Linear and quadratic damping moments that oppose the rotation of a link."""

    kind: Literal["damping"]


class Foil(OnLink):
    """Lift and drag of a fin with the polar of a flat plate."""

    kind: Literal["foil"]
    area_m2: Quantity
    lift_coefficient: Quantity
    drag_coefficient_0: Quantity = 0.0
    drag_coefficient_1: Quantity = 0.0


class Hydrostatics(OnLink):
    """Weight and buoyancy of a link."""

    kind: Literal["hydrostatics"]
    volume_m3: Quantity = 0.0


class Force(OnLink):
    """Constant force at a point of a link."""

    kind: Literal["force"]
    frame: Literal["link", "world"] = "link"


class Load(OnLink):
    """Force and moment on a link that are proportional to an input."""

    kind: Literal["load"]
    input: str
    #: Axes of the force: those of the link, or those of the world, as for a buoyancy.
    frame: Literal["link", "world"] = "link"


class Propeller(OnLink):
    """Law of a propeller: ``T = rho n^2 D^4 K_T(J)`` with the advance ratio ``J = u_a / (n D)``.

    The input is the rate n, 1/s. ``u_a`` is 1 - w times the velocity of the propeller through the water along
    its axis. The force on the link is (1 - t) T along the axis. The polynomial K_T also holds for negative J.
    A propeller that turns backwards has the thrust of its mirror image, ``T(-n, -u_a) = -T(n, u_a)``.
    """

    kind: Literal["propeller"]
    input: str
    diameter_m: PositiveFloat
    #: Coefficients k_0, k_1, k_2 of ``K_T = k_0 + k_1 J + k_2 J^2``. The last coefficients may be omitted.
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


class Rudder(OnLink):
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


class MovingMass(OnLink):
    """Mass that an input moves along a line of a link, as the battery of a glider.

    The moving mass shifts the centre of mass and changes the inertia of the link. Its acceleration pushes the
    link back. The link's own mass excludes the moving mass. The input is a position, by default in m.
    """

    kind: Literal["moving-mass"]
    input: str
    mass_kg: Quantity
    #: Whether the weight of the mass acts at the mass; in a plane only if the plane is vertical.
    weighs: bool = False


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


def _check_terms(terms: dict[str, Quantity]) -> dict[str, Quantity]:
    for name in terms:
        derivative_parts(name)
    return terms


class Derivatives(OnLink):
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
    terms: Annotated[dict[str, Quantity], Field(min_length=1), AfterValidator(_check_terms)]
