"""Tree of rigid links in water, in a plane: compiled equations of motion and their integration.

The unknowns are the base's pose and the angles of the passive joints. Driven joints enter by their angle,
rate and acceleration. Every link has a constant symmetric apparent inertia ``G`` (rigid body plus added mass)
for its velocity ``nu = (u, v, r)`` at its origin, in its own axes. Its momentum is ``P = G nu``. By
Kirchhoff's equations, the wrench that moves it is

    ``f = G nu' + (-r P_y, r P_x, u P_y - v P_x)``.

A pass from the base to the outer links computes velocities, accelerations and wrenches, with the unknown
accelerations set to zero (recursive Newton-Euler). A pass back to the base sums the wrenches and the
composite inertias. One LDL^T factorisation gives the accelerations. The result equals the Lagrange equations
of the tendon fish (Eqs 1, 2, 5) and of the dolphin (Eqs 3, 6).

The state of a robot with p passive joints, n = 3 + p, is ``(x, y, theta, passive angles.., u, v, r, passive
rates..)``: the pose in the world, and the velocity in the base's own axes. The functions do not check
indices, because :mod:`swimid.swimmer.planar.model` has checked them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from swimid.files.kernels import numba
from swimid.fitting.model import MOST_FORCES, ExternalForce, no_force
from swimid.robots.planar import MAX_FACTORS

#: Magnitude of an entry of the state vector from which a simulation has broken down.
MAX_STATE = 1e6


@numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")
def positive(asked, then, otherwise):  # type: ignore[no-untyped-def]
    """Return ``then`` if ``asked`` is above 0, and ``otherwise`` if it is not, or if it is NaN.

    Both values are computed by the caller, whichever is returned.

    >>> positive(1.0, 2.0, 3.0)
    2.0
    """
    return then if asked > 0.0 else otherwise


@numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")
def correct_state(state):  # type: ignore[no-untyped-def]
    """Leave the state after an integration step unchanged.

    In a plane it needs no correction. In 3-D, the function of this name scales the quaternion.
    """


@numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")
def find_heading(frame, base, turn):  # type: ignore[no-untyped-def]
    """Return the heading of a link in the world, rad.

    The heading is continuous when the base turns by more than half a rotation.

    Parameters
    ----------
    frame : (heading in rad, its cosine, its sine)
        Direction of the simulation's axes in the world.
    base : (heading in rad, its cosine, its sine)
        Direction of the base in the simulation's axes.
    turn : (cosine, sine)
        Direction of the link in the simulation's axes.
    """
    across = turn[1] * base[1] - turn[0] * base[2]
    return frame[0] + base[0] + math.atan2(across, turn[0] * base[1] + turn[1] * base[2])


#: Columns of the input arrays of the engine. Each constant has the name of its array.
TOPOLOGY = ("parent", "driven", "passive")
JOINT = ("x", "y", "cos_mount", "sin_mount")
INERTIA = ("uu", "uv", "ur", "vv", "vr", "rr")
PASSIVE = (
    "stiffness",
    "cubic",
    "damping",
    "quadratic_damping",
    "rest",
    "spring",
    "pretension",
    "arm",
    "crank",
    "friction",
    "friction_below",
)
#: Entries of the input arrays that effects may change although they are zero in the robot file.
FILLED = {"passive": slice(0, PASSIVE.index("rest") + 1), "load": -1}
DRAG = ("x", "y", "quadratic_x", "quadratic_y", "linear_x", "linear_y", "quadratic_r", "linear_r")
FOIL = ("x", "y", "half_rho_area", "cl", "cd0", "cd1", "cos_chord", "sin_chord")
FORCE = ("x", "y", "force_x", "force_y", "world")
WAKE = ("x", "y", "half_mass")
#: Columns of the input array ``load``: force and moment for an input of 1, at a point of a link. The column
#: ``world`` is 1 if the force has the axes of the world. The column ``loss`` is the decrease of the input's
#: effect per square root of the input and per velocity along the force (:func:`reduce_input`).
LOAD = ("x", "y", "force_x", "force_y", "moment", "world", "loss")
#: Columns of the input array ``propeller``: point and axis, the coefficients of :func:`thrust_of`, and the
#: factors on the thrust (1 - t) and on the velocity of advance (1 - w). With the thrust T, the slipstream far
#: behind the propeller has the square of the velocity ``u_a^2 + jet T``.
PROPELLER = (
    "x",
    "y",
    "axis_x",
    "axis_y",
    "static",
    "slope",
    "curve",
    "share",
    "wake",
    "jet",
    "wake_decay",
    "wake_port",
    "wake_starboard",
)
#: Columns of the input array ``rudder``: points of the force on the rudder, of the force on the hull, and of
#: the inflow, and the coefficients of :func:`rudder_force`.
RUDDER = (
    "x",
    "y",
    "hull_x",
    "hull_y",
    "inflow_x",
    "inflow_y",
    "lift",
    "drag_share",
    "hull_share",
    "straightening_port",
    "straightening_starboard",
    "ratio",
    "gain",
    "covered",
)
#: Columns of the input array ``term``: point, and coefficient of a product of velocities.
TERM = ("x", "y", "coefficient")
#: Columns of the input array ``slider``: place of a moving mass for an input of 0, its displacement for an
#: input of 1, its mass, and its weight if it acts.
SLIDER = ("x", "y", "travel_x", "travel_y", "mass", "weight")
#: Index in a row of ``term_link`` of each velocity (1 fills up a row), and of each component of force and
#: moment. The vertical plane has w, q, Z and M in place of v, r, Y and N.
VELOCITIES = {name: i for i, name in enumerate(("1", "u", "v", "r", "|u|", "|v|", "|r|", "U", "/U"))}
VELOCITIES |= {"w": 2, "q": 3, "|w|": 5, "|q|": 6}
COMPONENTS = {"X": 0, "Y": 1, "N": 2, "Z": 1, "M": 2}
#: Number of integers for an element in the input array ``ELEMENT_link``: its link; for a propeller also the
#: row of its input; for a rudder also the rows of its input and of its propeller; for a term also its
#: component and the indices of its velocities.
INTEGERS = {"propeller": 2, "rudder": 3, "term": 2 + MAX_FACTORS, "slider": 2}
#: Speed below which the quotient of velocities and speed in a term falls to zero, m/s.
LEAST_SPEED = 1e-9


@numba.njit(cache=True, nogil=True, error_model="numpy")
def tendon_torque(angle, spring, pretension, arm, crank):  # type: ignore[no-untyped-def]
    """Return the torque of a wire and spring that pull a joint straight, N m.

    Parameters
    ----------
    angle : float, rad
    spring : float, N/m
        K_t.
    pretension : float, m
        d_p, elongation at zero angle.
    arm, crank : float, m
        l_3 and l_ps; the crank must be the shorter.

    Returns
    -------
    float
        ``-dE/dphi`` of the tendon fish's Eqs 3 and 4.

    Notes
    -----
    With ``D = sqrt(l_3^2 + l_ps^2 - 2 l_3 l_ps cos phi)`` and ``d_t = D - l_3 + l_ps`` it is
    ``-K_t (d_p + d_t) l_3 l_ps sin(phi) / D``. Eq 11 is the same when its garbled argument is
    read as ``arccos((l_3 - l_cr cos phi) / D)``.
    """
    distance = math.sqrt(arm * arm + crank * crank - 2.0 * arm * crank * math.cos(angle))
    stretch = distance - arm + crank
    return -spring * (pretension + stretch) * arm * crank * math.sin(angle) / distance


@numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")
def passive_torque(passive, k, angle, w):  # type: ignore[no-untyped-def]
    """Return the torque (N m) of passive joint ``k`` at an angle (rad) and a rate (rad/s).

    ``passive`` is the input array with the columns :data:`PASSIVE`.
    """
    off = angle - passive[k, 4]
    torque = -(passive[k, 0] + passive[k, 1] * off * off) * off
    torque -= (passive[k, 2] + passive[k, 3] * abs(w)) * w
    if passive[k, 9] != 0.0:
        torque -= passive[k, 9] * w / math.sqrt(w * w + passive[k, 10] * passive[k, 10])
    if passive[k, 5] != 0.0:
        torque += tendon_torque(angle, passive[k, 5], passive[k, 6], passive[k, 7], passive[k, 8])
    return torque


@numba.njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _outwards(state, row, topology, joint, inertia, rate, work):  # type: ignore[no-untyped-def]
    """Compute velocities, accelerations, wrenches and inertias of all links, from the base outwards.

    If the rate of the state is None, the unknown accelerations are taken as zero.
    """
    n = len(state) // 2
    for i in range(topology.shape[0]):
        if i == 0:
            c, s = 1.0, 0.0
            u, v, r = state[n], state[n + 1], state[n + 2]
            du, dv, dr = 0.0, 0.0, 0.0
            if rate is not None:
                du, dv, dr = rate[n], rate[n + 1], rate[n + 2]
            work[0, 17], work[0, 18] = math.cos(state[2]), math.sin(state[2])
        else:
            p, d, k = topology[i, 0], topology[i, 1], topology[i, 2]
            if d >= 0:
                w, dw = row[d, 1], row[d, 2]
                c, s = row[d, 3], row[d, 4]
            elif k >= 0:
                w, dw = state[n + 3 + k], 0.0
                if rate is not None:
                    dw = rate[n + 3 + k]
                ca, sa = math.cos(state[3 + k]), math.sin(state[3 + k])
                c = ca * joint[i, 2] - sa * joint[i, 3]
                s = sa * joint[i, 2] + ca * joint[i, 3]
            else:
                w, dw = 0.0, 0.0
                c, s = joint[i, 2], joint[i, 3]
            jx, jy = joint[i, 0], joint[i, 1]
            pr, pdr = work[p, 4], work[p, 7]
            a, b = work[p, 2] - pr * jy, work[p, 3] + pr * jx
            da, db = work[p, 5] - pdr * jy, work[p, 6] + pdr * jx
            u, v, r = c * a + s * b, c * b - s * a, pr + w
            du, dv, dr = c * da + s * db + w * v, c * db - s * da - w * u, pdr + dw
            work[i, 17] = work[p, 17] * c - work[p, 18] * s
            work[i, 18] = work[p, 18] * c + work[p, 17] * s
        g0, g1, g2 = inertia[i, 0], inertia[i, 1], inertia[i, 2]
        g3, g4, g5 = inertia[i, 3], inertia[i, 4], inertia[i, 5]
        px = g0 * u + g1 * v + g2 * r
        py = g1 * u + g3 * v + g4 * r
        work[i, 0], work[i, 1] = c, s
        work[i, 2], work[i, 3], work[i, 4] = u, v, r
        work[i, 5], work[i, 6], work[i, 7] = du, dv, dr
        work[i, 8] = g0 * du + g1 * dv + g2 * dr - r * py
        work[i, 9] = g1 * du + g3 * dv + g4 * dr + r * px
        work[i, 10] = g2 * du + g4 * dv + g5 * dr + u * py - v * px
        work[i, 11], work[i, 12], work[i, 13] = g0, g1, g2
        work[i, 14], work[i, 15], work[i, 16] = g3, g4, g5


@numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _push(work, i, x, y, fx, fy):  # type: ignore[no-untyped-def]
    """Apply a force at a point of link ``i``.

    The force is subtracted from the wrench that the motion of the link needs.
    """
    work[i, 8] -= fx
    work[i, 9] -= fy
    work[i, 10] -= x * fy - y * fx


@numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _drag(drag_link, drag, work):  # type: ignore[no-untyped-def]
    """Add the Morison drag at points of the links, and the damping of the links' rotation."""
    for e in range(drag.shape[0]):
        i = drag_link[e]
        r = work[i, 4]
        x, y = drag[e, 0], drag[e, 1]
        vx, vy = work[i, 2] - r * y, work[i, 3] + r * x
        fx = -(drag[e, 2] * abs(vx) + drag[e, 4]) * vx
        fy = -(drag[e, 3] * abs(vy) + drag[e, 5]) * vy
        _push(work, i, x, y, fx, fy)
        work[i, 10] += (drag[e, 6] * abs(r) + drag[e, 7]) * r


@numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _foils(foil_link, foil, work):  # type: ignore[no-untyped-def]
    """Add the lift and the drag of fins, each at a point of a link."""
    for e in range(foil.shape[0]):
        i = foil_link[e]
        r = work[i, 4]
        x, y = foil[e, 0], foil[e, 1]
        vx, vy = work[i, 2] - r * y, work[i, 3] + r * x
        square = vx * vx + vy * vy
        speed = math.sqrt(square)
        # at a point at rest, where the force is zero, avoid a division by zero
        divisor = positive(square, square, 1.0)
        along = vx * foil[e, 6] + vy * foil[e, 7]
        across = vy * foil[e, 6] - vx * foil[e, 7]
        lift = 2.0 * foil[e, 3] * along * across / divisor
        drag_coefficient = foil[e, 4] + 2.0 * foil[e, 5] * across * across / divisor
        push = foil[e, 2] * speed
        fx = push * (lift * vy - drag_coefficient * vx)
        fy = push * (-lift * vx - drag_coefficient * vy)
        _push(work, i, x, y, fx, fy)


@numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _forces(force_link, force, work):  # type: ignore[no-untyped-def]
    """Add the constant forces of the robot file, which have a fixed direction in a link or in the world."""
    for e in range(force.shape[0]):
        i = force_link[e]
        x, y = force[e, 0], force[e, 1]
        fx, fy = force[e, 2], force[e, 3]
        if force[e, 4] != 0.0:
            c, s = work[i, 17], work[i, 18]
            fx, fy = c * fx + s * fy, c * fy - s * fx
        _push(work, i, x, y, fx, fy)


@numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _wakes(wake_link, wake, work):  # type: ignore[no-untyped-def]
    """Add the reaction to the momentum that trailing edges shed into the wake.

    An edge that moves backwards sheds no momentum.
    """
    for e in range(wake.shape[0]):
        i = wake_link[e]
        r = work[i, 4]
        x, y = wake[e, 0], wake[e, 1]
        vx, vy = work[i, 2] - r * y, work[i, 3] + r * x
        _push(work, i, x, y, wake[e, 2] * vy * vy, -2.0 * wake[e, 2] * max(vx, 0.0) * vy)


@numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")
def reduce_input(size, loss, along):  # type: ignore[no-untyped-def]
    """Return the input of a load whose force falls with the velocity along the force.

    A propeller at the rate n has the thrust ``T = a n |n| - b |n| u`` with the velocity u along T. Its thrust
    at rest ``T_0 = a n |n|`` gives ``T = T_0 - c sqrt(|T_0|) u``.

    Parameters
    ----------
    size : float
        Input, by which the thrust at rest is proportional.
    loss : float
        ``c / g^1.5`` with the force g for an input of 1, N.
    along : float
        Scalar product of the velocity of the point of action and the force for an input of 1.
    """
    return size - loss * math.sqrt(abs(size)) * along


@numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _loads(load_link, load_input, load, row, work):  # type: ignore[no-untyped-def]
    """Add the forces and moments that are proportional to inputs."""
    for e in range(load.shape[0]):
        i = load_link[e]
        x, y = load[e, 0], load[e, 1]
        fx, fy = load[e, 2], load[e, 3]
        if load[e, 5] != 0.0:
            c, s = work[i, 17], work[i, 18]
            fx, fy = c * fx + s * fy, c * fy - s * fx
        along = (work[i, 2] - work[i, 4] * y) * fx + (work[i, 3] + work[i, 4] * x) * fy
        size = reduce_input(row[load_input[e], 0], load[e, 6], along)
        _push(work, i, x, y, size * fx, size * fy)
        work[i, 10] -= size * load[e, 4]


@numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")
def thrust_of(n, advance, static, slope, curve):  # type: ignore[no-untyped-def]
    """Return the thrust of a propeller, N, at a rate n (1/s) and a velocity of advance u (m/s).

    It is ``static n |n| + slope |n| u + curve sign(n) u^2``. With K_T = k_0 + k_1 J + k_2 J^2 and
    J = u / (n D), the coefficients are ``rho D^4 k_0``, ``rho D^3 k_1`` and ``rho D^2 k_2``. A propeller that
    turns backwards has the thrust of its mirror image, ``T(-n, -u) = -T(n, u)``.
    """
    side = positive(n, 1.0, positive(-n, -1.0, 0.0))
    return static * n * abs(n) + slope * abs(n) * advance + curve * side * advance * advance


@numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")
def inflow_speed(advance, thrust, jet, ratio, gain, covered):  # type: ignore[no-untyped-def]
    """Return the velocity of the water at a rudder along the hull, m/s (Yasukawa and Yoshimura 2015, Eq 24).

    The share ``covered`` of the rudder's height lies in the slipstream. There, the velocity has grown by the
    share ``gain`` of its growth far behind the propeller. In the printed equation this growth is
    ``u_P (sqrt(1 + 8 K_T / (pi J^2)) - 1)``. Written with the thrust it has no division by J.
    """
    far = math.sqrt(max(advance * advance + jet * thrust, 0.0))
    within = advance + gain * (far - abs(advance))
    size = math.sqrt(covered * within * within + (1.0 - covered) * advance * advance)
    return ratio * positive(covered * within + (1.0 - covered) * advance, size, -size)


@numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")
def rudder_force(along, aside, lift, port, starboard, sine, cosine):  # type: ignore[no-untyped-def]
    """Return the normal force on a rudder, N (Yasukawa and Yoshimura 2015, Eqs 21 to 23).

    ``F_N = rho / 2 A_R f_a U_R^2 sin(alpha_R)`` with the inflow velocity U_R and its angle to the rudder.

    Parameters
    ----------
    along : float, m/s
        Velocity of the water along the hull (:func:`inflow_speed`).
    aside : float, m/s
        Velocity of the hull to port, at the point of the inflow. The water has the opposite velocity,
        multiplied by the flow straightening coefficient of this side.
    lift : float
        ``rho / 2 A_R f_a``.
    port, starboard : float
        Flow straightening coefficients for motion to port and to starboard.
    sine, cosine : float
        Of the rudder angle.
    """
    across = aside * positive(aside, port, starboard)
    return lift * math.sqrt(along * along + across * across) * (along * sine + across * cosine)


@numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")
def wake_growth(aside, speed, decay, port, starboard):  # type: ignore[no-untyped-def]
    """Return the factor on 1 - w of a propeller in oblique motion (Yasukawa and Yoshimura 2015, Eq 18).

    It is ``1 + (1 - exp(-C_1 |b_P|)) (C_2 - 1)``, with the sine of the drift angle of the propeller for b_P.

    Parameters
    ----------
    aside, speed : float, m/s
        Velocity of the propeller to port, and its speed.
    decay : float
        C_1.
    port, starboard : float
        C_2 - 1 for motion to port and to starboard.
    """
    angle = abs(aside) / max(speed, LEAST_SPEED)
    return 1.0 + (1.0 - math.exp(-decay * angle)) * positive(aside, port, starboard)


@numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _propeller_flow(e, propeller_link, propeller, row, work):  # type: ignore[no-untyped-def]
    """Return velocity of advance (m/s) and thrust (N) of propeller ``e``."""
    i, n = propeller_link[e, 0], row[propeller_link[e, 1], 0]
    r = work[i, 4]
    vx, vy = work[i, 2] - r * propeller[e, 1], work[i, 3] + r * propeller[e, 0]
    aside, speed = vy * propeller[e, 2] - vx * propeller[e, 3], math.sqrt(vx * vx + vy * vy)
    growth = wake_growth(aside, speed, propeller[e, 10], propeller[e, 11], propeller[e, 12])
    advance = growth * propeller[e, 8] * (vx * propeller[e, 2] + vy * propeller[e, 3])
    return advance, thrust_of(n, advance, propeller[e, 4], propeller[e, 5], propeller[e, 6])


@numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _propellers(propeller_link, propeller, row, work):  # type: ignore[no-untyped-def]
    """Add the thrusts of propellers."""
    for e in range(propeller.shape[0]):
        _, thrust = _propeller_flow(e, propeller_link, propeller, row, work)
        push = propeller[e, 7] * thrust
        x, y = propeller[e, 0], propeller[e, 1]
        _push(work, propeller_link[e, 0], x, y, push * propeller[e, 2], push * propeller[e, 3])


@numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _rudders(rudder_link, rudder, propeller_link, propeller, row, work):  # type: ignore[no-untyped-def]
    """Add the forces of rudders, and the forces on the hull that they induce."""
    for e in range(rudder.shape[0]):
        i, p = rudder_link[e, 0], rudder_link[e, 2]
        r = work[i, 4]
        jet, thrust = 0.0, 0.0
        advance = work[i, 2] - r * rudder[e, 5]
        if p >= 0:
            jet = propeller[p, 9]
            advance, thrust = _propeller_flow(p, propeller_link, propeller, row, work)
        along = inflow_speed(advance, thrust, jet, rudder[e, 11], rudder[e, 12], rudder[e, 13])
        angle = row[rudder_link[e, 1], 0]
        sine, cosine = math.sin(angle), math.cos(angle)
        aside = work[i, 3] + r * rudder[e, 4]
        force = rudder_force(along, aside, rudder[e, 6], rudder[e, 9], rudder[e, 10], sine, cosine)
        _push(work, i, rudder[e, 0], rudder[e, 1], -rudder[e, 7] * force * sine, -force * cosine)
        _push(work, i, rudder[e, 2], rudder[e, 3], 0.0, -rudder[e, 8] * force * cosine)


@numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _sliders(slider_link, slider, row, work):  # type: ignore[no-untyped-def]
    """Add the masses that inputs move: their inertia, and the wrench that their motion needs."""
    for e in range(slider.shape[0]):
        i, k = slider_link[e, 0], slider_link[e, 1]
        s, ds, dds = row[k, 0], row[k, 1], row[k, 2]
        tx, ty, mass = slider[e, 2], slider[e, 3], slider[e, 4]
        x, y = slider[e, 0] + tx * s, slider[e, 1] + ty * s
        r, dr = work[i, 4], work[i, 7]
        vx, vy = work[i, 2] - r * y + tx * ds, work[i, 3] + r * x + ty * ds
        # acceleration of the mass: rates of the components of its velocity, and their rotation with the link
        ax = work[i, 5] - dr * y - r * ty * ds + tx * dds - r * vy
        ay = work[i, 6] + dr * x + r * tx * ds + ty * dds + r * vx
        c, t = work[i, 17], work[i, 18]
        _push(work, i, x, y, -mass * ax - slider[e, 5] * t, -mass * ay - slider[e, 5] * c)
        work[i, 11] += mass
        work[i, 13] -= mass * y
        work[i, 14] += mass
        work[i, 15] += mass * x
        work[i, 16] += mass * (x * x + y * y)


@numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")
def product_of(coefficient, integers, velocities):  # type: ignore[no-untyped-def]
    """Return the product of a coefficient and the velocities of a term.

    Parameters
    ----------
    coefficient : float
    integers : ndarray of int
        Row of ``term_link``.
    velocities : tuple of float
        Velocities in the order of their indices.
    """
    for m in range(2, len(integers)):
        coefficient = coefficient * velocities[integers[m]]
    return coefficient


@numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _terms(term_link, term, work):  # type: ignore[no-untyped-def]
    """Add the forces and moments that are products of velocities at a point of a link."""
    for e in range(term.shape[0]):
        i, component = term_link[e, 0], term_link[e, 1]
        x, y = term[e, 0], term[e, 1]
        r = work[i, 4]
        u, v = work[i, 2] - r * y, work[i, 3] + r * x
        speed = math.sqrt(u * u + v * v)
        inverse = 1.0 / max(speed, LEAST_SPEED)
        velocities = (1.0, u, v, r, abs(u), abs(v), abs(r), speed, inverse)
        size = product_of(term[e, 2], term_link[e], velocities)
        if component == 0:
            _push(work, i, x, y, size, 0.0)
        elif component == 1:
            _push(work, i, x, y, 0.0, size)
        else:
            work[i, 10] -= size


@numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _add_external_forces(time, state, work, forced):  # type: ignore[no-untyped-def]
    """Add the external forces of effects on the links (:class:`swimid.fitting.model.ExternalForce`)."""
    links, places, constants, ends, frame, pose, velocity, wrench, functions = forced
    for e in range(len(links)):
        i = links[e]
        x, y = places[e, 0], places[e, 1]
        r = work[i, 4]
        velocity[0], velocity[1], velocity[2] = work[i, 2] - r * y, work[i, 3] + r * x, r
        c, s = work[0, 17], work[0, 18]
        a, b = state[0] + c * frame[4] - s * frame[5], state[1] + s * frame[4] + c * frame[5]
        pose[0] = frame[0] + frame[2] * a - frame[3] * b
        pose[1] = frame[1] + frame[3] * a + frame[2] * b
        world = (frame[6], frame[2], frame[3])
        pose[2] = find_heading(world, (state[2], c, s), (work[i, 17], work[i, 18]))
        wrench[:] = 0.0
        own = constants[ends[e] : ends[e + 1]]
        functions[e](time, pose, velocity, own, wrench)
        _push(work, i, x, y, wrench[0], wrench[1])
        work[i, 10] -= wrench[2]


@numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _coupling(i, k, topology, joint, work, matrix):  # type: ignore[no-untyped-def]
    """Write the coupling of passive joint ``k`` with the base and other joints into the mass matrix.

    The entries follow from the wrench for a unit acceleration of the joint, which is transferred to the base.
    """
    hx, hy, hm = work[i, 13], work[i, 15], work[i, 16]
    at = i
    while at > 0:
        c, s = work[at, 0], work[at, 1]
        hx, hy = c * hx - s * hy, s * hx + c * hy
        hm += joint[at, 0] * hy - joint[at, 1] * hx
        at = topology[at, 0]
        other = topology[at, 2]
        if at > 0 and other >= 0:
            matrix[3 + k, 3 + other] = hm
            matrix[3 + other, 3 + k] = hm
    matrix[3 + k, 0], matrix[3 + k, 1], matrix[3 + k, 2] = hx, hy, hm


@numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _to_parent(i, p, joint, work):  # type: ignore[no-untyped-def]
    """Add the wrench and composite inertia of a link to those of its parent, in the parent's axes."""
    c, s = work[i, 0], work[i, 1]
    jx, jy = joint[i, 0], joint[i, 1]
    fx, fy = work[i, 8], work[i, 9]
    gx, gy = c * fx - s * fy, s * fx + c * fy
    work[p, 8] += gx
    work[p, 9] += gy
    work[p, 10] += work[i, 10] + jx * gy - jy * gx
    # rotate the inertia G into the parent's axes, then refer it to the parent's origin
    a0, a1, a3 = work[i, 11], work[i, 12], work[i, 14]
    b0 = c * c * a0 - 2.0 * c * s * a1 + s * s * a3
    b1 = c * s * (a0 - a3) + (c * c - s * s) * a1
    b3 = s * s * a0 + 2.0 * c * s * a1 + c * c * a3
    b2 = c * work[i, 13] - s * work[i, 15]
    b4 = s * work[i, 13] + c * work[i, 15]
    h2, h4 = b2 - b0 * jy + b1 * jx, b4 - b1 * jy + b3 * jx
    work[p, 11] += b0
    work[p, 12] += b1
    work[p, 13] += h2
    work[p, 14] += b3
    work[p, 15] += h4
    work[p, 16] += work[i, 16] - jy * (h2 + b2) + jx * (h4 + b4)


@numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _inwards(state, topology, joint, passive, work, matrix, right):  # type: ignore[no-untyped-def]
    """Sum wrenches and composite inertias from the outer links to the base.

    The equations of the passive joints are written on the way.
    """
    n = len(state) // 2
    # clear the entries of the last factorisation, because joints on different branches do not couple
    for k in range(3, n):
        for m in range(3, k):
            matrix[k, m] = 0.0
    for i in range(topology.shape[0] - 1, 0, -1):
        k = topology[i, 2]
        if k >= 0:
            torque = passive_torque(passive, k, state[3 + k], state[n + 3 + k])
            right[3 + k] = torque - work[i, 10]
            matrix[3 + k, 3 + k] = work[i, 16]
            _coupling(i, k, topology, joint, work, matrix)
        _to_parent(i, topology[i, 0], joint, work)


@numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")
def solve(matrix, right, first):  # type: ignore[no-untyped-def]
    """Solve the equations of motion from row ``first`` on for the accelerations.

    The LDL^T factorisation overwrites the lower triangle of the matrix. The solution overwrites ``right``.
    """
    n = len(right)
    for j in range(first, n):
        pivot = matrix[j, j]
        for m in range(first, j):
            pivot -= matrix[j, m] * matrix[j, m] * matrix[m, m]
        matrix[j, j] = positive(pivot, pivot, math.nan)
        for i in range(j + 1, n):
            entry = matrix[i, j]
            for m in range(first, j):
                entry -= matrix[i, m] * matrix[j, m] * matrix[m, m]
            matrix[i, j] = entry / pivot
    for i in range(first, n):
        for m in range(first, i):
            right[i] -= matrix[i, m] * right[m]
    for i in range(n - 1, first - 1, -1):
        right[i] /= matrix[i, i]
        for m in range(i + 1, n):
            right[i] -= matrix[m, i] * right[m]


@numba.njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def derivative(  # type: ignore[no-untyped-def]
    state,
    row,
    topology,
    joint,
    inertia,
    passive,
    drag_link,
    drag,
    foil_link,
    foil,
    force_link,
    force,
    wake_link,
    wake,
    load_link,
    load,
    propeller_link,
    propeller,
    rudder_link,
    rudder,
    term_link,
    term,
    slider_link,
    slider,
    load_input,
    free_base,
    forced,
    time,
    work,
    matrix,
    right,
    rate,
):
    """Compute the time derivative of the state vector, and write it into ``rate``.

    Parameters
    ----------
    state, rate : ndarray, shape (2 n,)
    row : ndarray, shape (driven joints + inputs, 5)
        Angle, rate, acceleration, cosine and sine (mounting angle included) of each driven joint. The value
        of each input in the first column.
    topology : ndarray of int, shape (links, 3); joint : ndarray, shape (links, 4)
    inertia : ndarray, shape (links, 6)
    passive : ndarray, shape (passive joints, 11)
    drag_link, drag, foil_link, foil, force_link, force, wake_link, wake, load_link, load : ndarray
        Links and properties of the elements, with the columns :data:`DRAG`, :data:`FOIL`, :data:`FORCE`,
        :data:`WAKE` and :data:`LOAD`.
    propeller_link, propeller, rudder_link, rudder, term_link, term, slider_link, slider : ndarray
        Integers (:data:`INTEGERS`) and properties of the elements, with the columns :data:`PROPELLER`,
        :data:`RUDDER`, :data:`TERM` and :data:`SLIDER`.
    load_input : ndarray of int
        Row of ``row`` with the input of each load.
    free_base : bool
        Whether the base moves; otherwise it keeps its pose.
    forced : tuple or None
        Forces of effects, as :func:`outside` packs them; None if there are none.
    time : float, s
    work : ndarray, shape (links, 19)
    matrix : ndarray, shape (n, n); right : ndarray, shape (n,)
        Work arrays.
    """
    n = len(state) // 2
    _outwards(state, row, topology, joint, inertia, None, work)
    _drag(drag_link, drag, work)
    _foils(foil_link, foil, work)
    _forces(force_link, force, work)
    _wakes(wake_link, wake, work)
    _loads(load_link, load_input, load, row, work)
    _propellers(propeller_link, propeller, row, work)
    _rudders(rudder_link, rudder, propeller_link, propeller, row, work)
    _terms(term_link, term, work)
    _sliders(slider_link, slider, row, work)
    if forced is not None:
        _add_external_forces(time, state, work, forced)
    _inwards(state, topology, joint, passive, work, matrix, right)
    first = 3
    if free_base:
        first = 0
        matrix[0, 0], matrix[1, 1], matrix[2, 2] = work[0, 11], work[0, 14], work[0, 16]
        matrix[1, 0], matrix[2, 0], matrix[2, 1] = work[0, 12], work[0, 13], work[0, 15]
        right[0], right[1], right[2] = -work[0, 8], -work[0, 9], -work[0, 10]
    solve(matrix, right, first)
    u, v = state[n], state[n + 1]
    c, s = work[0, 17], work[0, 18]
    rate[0] = c * u - s * v
    rate[1] = s * u + c * v
    for i in range(2, n):
        rate[i] = state[n + i]
    for i in range(n):
        rate[n + i] = right[i] if i >= first else 0.0


@numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")
def has_diverged(state, rate):  # type: ignore[no-untyped-def]
    """Return whether a simulation has broken down: a state is too large, or its rate is not finite."""
    largest = 0.0
    for j in range(len(state)):
        largest = max(largest, abs(state[j]))
        if not abs(rate[j]) < math.inf:
            largest = math.inf
    return not largest < MAX_STATE


@numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")
def begin_stage(stage, step, here, slope, total, trial):  # type: ignore[no-untyped-def]
    """Write the state of a stage of the Runge-Kutta method to ``trial``, and add the last slope to ``total``.

    The stages are 0 to 4. The state of stage 4 is the state after the step.
    """
    for j in range(len(here)):
        if stage == 0:
            trial[j] = here[j]
            total[j] = 0.0
        elif stage < 3:
            total[j] += stage * slope[j]
            trial[j] = here[j] + 0.5 * step * slope[j]
        elif stage == 3:
            total[j] += 2.0 * slope[j]
            trial[j] = here[j] + step * slope[j]
        else:
            trial[j] = here[j] + step / 6.0 * (total[j] + slope[j])


@numba.njit(cache=True, nogil=True, error_model="numpy")
def integrate(start, step, table, tables, forced, begin):  # type: ignore[no-untyped-def]
    """Integrate the equations of motion, and return the states and their rates at every step.

    The method is a fourth-order Runge-Kutta method with fixed steps.

    Parameters
    ----------
    start : ndarray, shape (2 n,)
    step : float, s
    table : ndarray, shape (2 steps + 1, driven joints + inputs, 5)
        Driven joints and inputs on the half-step grid; see :func:`derivative`.
    tables : tuple
        Arguments of :func:`derivative` from ``topology`` to ``free_base``.
    forced : tuple or None
        Forces of effects (see :func:`derivative`).
    begin : float, s
        Time of the first state.

    Returns
    -------
    states, rates : ndarray, shape (steps + 1, 2 n)
        NaN from the step at which the simulation breaks down.
    """
    topology, joint, inertia, passive, drag_link, drag, foil_link, foil = tables[:8]
    force_link, force, wake_link, wake, load_link, load, propeller_link, propeller = tables[8:16]
    rudder_link, rudder, term_link, term, slider_link, slider, load_input, free_base = tables[16:]
    steps, size = (table.shape[0] - 1) // 2, len(start)
    states, rates = np.empty((steps + 1, size)), np.empty((steps + 1, size))
    work, right = np.zeros((topology.shape[0], 19)), np.zeros(size // 2)
    matrix = np.zeros((size // 2, size // 2))
    slope, total, trial = np.empty(size), np.empty(size), np.empty(size)
    states[0] = start
    for i in range(steps + 1):
        for stage in range(4):
            begin_stage(stage, step, states[i], slope, total, trial)
            half = (stage + 1) // 2
            derivative(
                trial, table[2 * i + half], topology, joint, inertia, passive, drag_link, drag, foil_link,
                foil, force_link, force, wake_link, wake, load_link, load, propeller_link, propeller,
                rudder_link, rudder, term_link, term, slider_link, slider, load_input, free_base, forced,
                begin + step * (i + 0.5 * half), work, matrix, right, slope,
            )  # fmt: skip
            if stage == 0:
                rates[i] = slope
                if has_diverged(states[i], slope):
                    states[i:] = math.nan
                    rates[i:] = math.nan
                    return states, rates
                if i == steps:
                    return states, rates
        begin_stage(4, step, states[i], slope, total, states[i + 1])
    return states, rates


@numba.njit(cache=True, nogil=True, error_model="numpy")
def torques(states, rates, table, tables, forced=None, begin=0.0, step=0.0):  # type: ignore[no-untyped-def]
    """Return the joint torques in a simulation and the wrench on the base, by inverse dynamics.

    The torque of a link is the moment that its parent exerts on it. It is the generalised force of a driven
    joint, or the torque from the law of a passive joint. The wrench is what holds the base, at its origin and
    in its axes. For a free base both are zero up to rounding.

    Parameters
    ----------
    states, rates : ndarray, shape (m, 2 n)
        Result of :func:`integrate`.
    table : ndarray, shape (m, driven joints + inputs, 5)
        Driven joints and inputs at the same instants.
    tables : tuple
        Arguments of :func:`derivative` from ``topology`` to ``free_base``.
    forced : tuple, optional
        Forces of effects (see :func:`derivative`).
    begin, step : float, s
        Time of the first state, and time between two states. Only forces of effects depend on them.

    Returns
    -------
    torques : ndarray, shape (m, links), N m
    wrench : ndarray, shape (m, 3), N and N m
    """
    topology, joint, inertia = tables[:3]
    drag_link, drag, foil_link, foil, force_link, force, wake_link, wake = tables[4:12]
    load_link, load, propeller_link, propeller, rudder_link, rudder = tables[12:18]
    term_link, term, slider_link, slider, load_input = tables[18:23]
    links = topology.shape[0]
    found, work = np.empty((states.shape[0], links)), np.zeros((links, 19))
    wrench = np.empty((states.shape[0], 3))
    for t in range(states.shape[0]):
        _outwards(states[t], table[t], topology, joint, inertia, rates[t], work)
        _drag(drag_link, drag, work)
        _foils(foil_link, foil, work)
        _forces(force_link, force, work)
        _wakes(wake_link, wake, work)
        _loads(load_link, load_input, load, table[t], work)
        _propellers(propeller_link, propeller, table[t], work)
        _rudders(rudder_link, rudder, propeller_link, propeller, table[t], work)
        _terms(term_link, term, work)
        _sliders(slider_link, slider, table[t], work)
        if forced is not None:
            _add_external_forces(begin + step * t, states[t], work, forced)
        for i in range(links - 1, -1, -1):
            found[t, i] = work[i, 10]
            if i > 0:
                _to_parent(i, topology[i, 0], joint, work)
        wrench[t] = work[0, 8:11]
    return found, wrench


def shapes(tables: Mapping[str, Any]) -> tuple[int, list[tuple[int, ...]]]:
    """Return the length of the state vector, and the shapes of the work arrays of :func:`derivative`."""
    n = 3 + len(tables["passive"])
    return 2 * n, [(len(tables["topology"]), 19), (n, n), (n,)]


def place_frame(frame: Sequence[float], reference: tuple[float, float]) -> NDArray[np.float64]:
    """Return the coordinate frame of a simulation in the world, for the forces of effects, shape (7,).

    Parameters
    ----------
    frame : (x, y, heading), m and rad
        Origin and direction of the simulation's axes in the world.
    reference : (x, y), m
        Reference point in the base's axes. The forces depend on its position.
    """
    return np.array([frame[0], frame[1], math.cos(frame[2]), math.sin(frame[2]), *reference, frame[2]])


def outside(forces: Sequence[ExternalForce], frame: NDArray[np.float64], links: int) -> tuple[Any, ...]:
    """Return the forces of effects in the form of the argument ``forced`` of :func:`integrate`.

    Parameters
    ----------
    forces : sequence of ExternalForce, at most :data:`swimid.fitting.model.MOST_FORCES`
    frame : ndarray, shape (7,)
        Result of :func:`place_frame`.
    links : int
        Number of links.
    """
    functions = [f.function for f in forces] + [no_force] * (MOST_FORCES - len(forces))
    ends = np.concatenate(([0], np.cumsum([len(f.constants) for f in forces]))).astype(np.int64)
    return (
        np.array([f.link % links for f in forces], dtype=np.int64),
        np.array([(f.x, f.y) for f in forces]).reshape(-1, 2),
        np.concatenate([np.asarray(f.constants, dtype=float) for f in forces]),
        ends,
        frame,
        np.zeros(3),
        np.zeros(3),
        np.zeros(3),
        tuple(functions),
    )


@numba.njit(cache=True, nogil=True, error_model="numpy")
def interpolate_states(time, begin, step, states, rates):  # type: ignore[no-untyped-def]
    """Return the states of a simulation at given times, by cubic Hermite interpolation.

    Parameters
    ----------
    time : ndarray, shape (m,), s
        Times before the first step give the first state, times after the last step the last state.
    begin, step : float, s
        Time of the first state and step of the grid.
    states, rates : ndarray, shape (steps + 1, k)

    Returns
    -------
    ndarray, shape (m, k)
        The error is of fourth order in the step, as that of the integration.
    """
    count, size = len(time), states.shape[1]
    values = np.empty((count, size))
    last = states.shape[0] - 1
    for i in range(count):
        place = min(max((time[i] - begin) / step, 0.0), float(last))
        k = min(int(place), max(last - 1, 0))
        f = place - k
        # at a time on the grid, up to rounding, return the state of the grid
        if abs(f) < 1e-9 or abs(f - 1.0) < 1e-9 or last == 0:
            k = min(k + int(f + 0.5), last)
            for j in range(size):
                values[i, j] = states[k, j]
            continue
        h00, h10 = (1.0 + 2.0 * f) * (1.0 - f) ** 2, f * (1.0 - f) ** 2
        h01, h11 = f * f * (3.0 - 2.0 * f), f * f * (f - 1.0)
        for j in range(size):
            a, b = states[k, j], states[k + 1, j]
            da, db = step * rates[k, j], step * rates[k + 1, j]
            values[i, j] = h00 * a + h10 * da + h01 * b + h11 * db
    return values


@numba.njit(cache=True, nogil=True, error_model="numpy")
def observe_camera(states, speeds, reference, origin, heading, spin):  # type: ignore[no-untyped-def]
    """Return pose and velocity of the reference point of the robot as a camera measures them.

    Parameters
    ----------
    states : ndarray, shape (m, k)
        Position and heading of the base in the first columns; surge, sway and yaw rate from column
        ``speeds``.
    reference : (x, y), m
        Reference point in the base's axes.
    origin : (x, y), m
        Position of the reference point at the first sample.
    heading, spin : float, rad
        Angle that is added to the heading, and angle by which the path is turned about its first point.

    Returns
    -------
    ndarray, shape (6, m)
        Position (m), heading (rad), surge and sway (m/s), yaw rate (rad/s).
    """
    count, n = len(states), speeds
    a, b = reference
    found = np.empty((6, count))
    along, across = math.cos(spin), math.sin(spin)
    x0, y0 = 0.0, 0.0
    for i in range(count):
        theta, u, v, r = states[i, 2], states[i, n], states[i, n + 1], states[i, n + 2]
        c, s = math.cos(theta), math.sin(theta)
        x, y = states[i, 0] + a * c - b * s, states[i, 1] + a * s + b * c
        if i == 0:
            x0, y0 = x, y
        found[0, i] = origin[0] + along * (x - x0) - across * (y - y0)
        found[1, i] = origin[1] + across * (x - x0) + along * (y - y0)
        found[2, i] = theta + heading
        found[3, i], found[4, i], found[5, i] = u - r * b, v + r * a, r
    return found
