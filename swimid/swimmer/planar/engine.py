"""Tree of rigid links in water, in a plane: compiled equations of motion and their integration.

The unknowns are the base's pose and the angles of the passive joints. Driven joints enter by their angle,
rate and acceleration. Every link has a constant symmetric apparent inertia ``G`` (rigid body plus added mass)
for its velocity ``nu = (u, v, r)`` at its origin, in its own axes. Its momentum is ``P = G nu``. By
Kirchhoff's equations, the wrench that moves it is

    ``f = G nu' + (-r P_y, r P_x, u P_y - v P_x)``.

A pass from the base to the outer links computes velocities, accelerations and wrenches, with the unknown
accelerations set to zero (recursive Newton-Euler). A pass back to the base sums the wrenches and the
composite inertias. One LDL^T factorisation gives the accelerations. The result equals the Lagrange equations
in the papers on the built-in robots ``tfish`` (Eqs 1, 2, 5) and ``dolphin`` (Eqs 3, 6).

The state of a robot with p passive joints, n = 3 + p, is ``(x, y, theta, passive angles.., u, v, r, passive
rates..)``: the pose in the world, and the velocity in the base's own axes.
"""

from __future__ import annotations

import math

import numpy as np

from swimid.files.kernels import numba
from swimid.swimmer.engine import (
    LEAST_SPEED,
    PASSIVE,
    Engine,
    begin_stage,
    find_heading,
    has_diverged,
    inflow_speed,
    passive_torque,
    positive,
    product_of,
    reduce_input,
    rudder_force,
    solve_accelerations,
    thrust_of,
    wake_growth,
)

#: Columns of each input array, by the name of the array.
COLUMNS: dict[str, tuple[str, ...]] = {
    "topology": ("parent", "driven", "passive"),
    "joint": ("x", "y", "cos_mount", "sin_mount"),
    "inertia": ("uu", "uv", "ur", "vv", "vr", "rr"),
    "passive": PASSIVE,
    "drag": ("x", "y", "quadratic_x", "quadratic_y", "linear_x", "linear_y", "quadratic_r", "linear_r"),
    "foil": ("x", "y", "half_rho_area", "cl", "cd0", "cd1", "cos_chord", "sin_chord"),
    "force": ("x", "y", "force_x", "force_y", "world"),
    "wake": ("x", "y", "half_mass"),
    "load": ("x", "y", "force_x", "force_y", "moment", "world", "loss"),
    "propeller": (
        *("x", "y", "axis_x", "axis_y", "static", "slope", "curve", "share", "wake", "jet", "wake_decay"),
        *("wake_port", "wake_starboard"),
    ),
    "rudder": (
        *("x", "y", "hull_x", "hull_y", "inflow_x", "inflow_y", "lift", "drag_share", "hull_share"),
        *("straightening_port", "straightening_starboard", "ratio", "gain", "covered"),
    ),
    "term": ("x", "y", "coefficient"),
    "slider": ("x", "y", "travel_x", "travel_y", "mass", "weight"),
}
#: Indices in a row of ``term_link``, by the name of a velocity, and by the name of a component of force and
#: moment. The velocity ``1`` fills up a row. The vertical plane has w, q, Z and M in place of v, r, Y and N.
PLANAR_VELOCITIES = {name: i for i, name in enumerate(("1", "u", "v", "r", "|u|", "|v|", "|r|", "U", "/U"))}
PLANAR_VELOCITIES |= {"w": 2, "q": 3, "|w|": 5, "|q|": 6}
PLANAR_COMPONENTS = {"X": 0, "Y": 1, "N": 2, "Z": 1, "M": 2}


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


@numba.njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _add_elements(state, row, tables, forced, time, work):  # type: ignore[no-untyped-def]
    """Add the forces of all elements and effects to the wrenches on the links."""
    drag_link, drag, foil_link, foil, force_link, force, wake_link, wake, load_link, load = tables[4:14]
    propeller_link, propeller, rudder_link, rudder, term_link, term, slider_link, slider = tables[14:22]
    _drag(drag_link, drag, work)
    _foils(foil_link, foil, work)
    _forces(force_link, force, work)
    _wakes(wake_link, wake, work)
    _loads(load_link, tables[22], load, row, work)
    _propellers(propeller_link, propeller, row, work)
    _rudders(rudder_link, rudder, propeller_link, propeller, row, work)
    _terms(term_link, term, work)
    _sliders(slider_link, slider, row, work)
    if forced is not None:
        _add_external_forces(time, state, work, forced)


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


@numba.njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def compute_planar_rate(state, row, tables, forced, time, work, matrix, right, rate):  # type: ignore[no-untyped-def]
    """Compute the time derivative of the state vector (:attr:`swimid.swimmer.engine.Engine.compute_rate`)."""
    n = len(state) // 2
    topology, joint, inertia, passive = tables[:4]
    _outwards(state, row, topology, joint, inertia, None, work)
    _add_elements(state, row, tables, forced, time, work)
    _inwards(state, topology, joint, passive, work, matrix, right)
    first = 3
    if tables[-1]:
        first = 0
        matrix[0, 0], matrix[1, 1], matrix[2, 2] = work[0, 11], work[0, 14], work[0, 16]
        matrix[1, 0], matrix[2, 0], matrix[2, 1] = work[0, 12], work[0, 13], work[0, 15]
        right[0], right[1], right[2] = -work[0, 8], -work[0, 9], -work[0, 10]
    solve_accelerations(matrix, right, first)
    u, v = state[n], state[n + 1]
    c, s = work[0, 17], work[0, 18]
    rate[0] = c * u - s * v
    rate[1] = s * u + c * v
    for i in range(2, n):
        rate[i] = state[n + i]
    for i in range(n):
        rate[n + i] = right[i] if i >= first else 0.0


@numba.njit(cache=True, nogil=True, error_model="numpy")
def integrate_planar(start, step, table, tables, forced, begin):  # type: ignore[no-untyped-def]
    """Integrate the equations of motion (:attr:`swimid.swimmer.engine.Engine.integrate`)."""
    steps, size = (table.shape[0] - 1) // 2, len(start)
    states, rates = np.empty((steps + 1, size)), np.empty((steps + 1, size))
    work, right = np.zeros((tables[0].shape[0], 19)), np.zeros(size // 2)
    matrix = np.zeros((size // 2, size // 2))
    slope, total, trial = np.empty(size), np.empty(size), np.empty(size)
    states[0] = start
    for i in range(steps + 1):
        for stage in range(4):
            begin_stage(stage, step, states[i], slope, total, trial)
            half = (stage + 1) // 2
            time = begin + step * (i + 0.5 * half)
            compute_planar_rate(trial, table[2 * i + half], tables, forced, time, work, matrix, right, slope)
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
def compute_planar_torques(states, rates, table, tables, forced, begin, step):  # type: ignore[no-untyped-def]
    """Return moments and base wrench (:attr:`swimid.swimmer.engine.Engine.compute_torques`)."""
    topology, joint, inertia = tables[:3]
    links = topology.shape[0]
    moments, work = np.empty((states.shape[0], links)), np.zeros((links, 19))
    wrench = np.empty((states.shape[0], 3))
    for t in range(states.shape[0]):
        _outwards(states[t], table[t], topology, joint, inertia, rates[t], work)
        _add_elements(states[t], table[t], tables, forced, begin + step * t, work)
        for i in range(links - 1, -1, -1):
            moments[t, i] = work[i, 10]
            if i > 0:
                _to_parent(i, topology[i, 0], joint, work)
        wrench[t] = work[0, 8:11]
    return moments, wrench


@numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")
def keep_state(state):  # type: ignore[no-untyped-def]
    """Leave the state after an integration step unchanged, because in a plane it needs no correction."""


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


PLANAR_ENGINE = Engine(
    columns=COLUMNS,
    coordinates=3,
    speeds=3,
    work=19,
    velocities=PLANAR_VELOCITIES,
    components=PLANAR_COMPONENTS,
    compute_rate=compute_planar_rate,
    integrate=integrate_planar,
    compute_torques=compute_planar_torques,
    correct_state=keep_state,
)
