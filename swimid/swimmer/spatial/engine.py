"""Tree of rigid links in water, in 3-D: compiled equations of motion and their integration.

The unknowns are the base's pose (position and unit quaternion) and the angles of the passive hinges. Driven
hinges enter by their angle, rate and acceleration. Every link has a constant symmetric apparent inertia for
its velocity ``(v, w)`` at its origin, in its own axes,

    ``p = A v + B w``,  ``h = B' v + D w``  (rigid body plus added mass),

and the wrench that moves it follows from Kirchhoff's equations,

    ``f = p' + w x p``,  ``m = h' + w x h + v x p``.

A pass from the base to the outer links computes velocities, accelerations and wrenches, with the unknown
accelerations set to zero (recursive Newton-Euler). A pass back to the base sums the wrenches and the
composite inertias. One LDL^T factorisation gives the accelerations (Featherstone 2008, Rigid Body Dynamics
Algorithms, chapters 5, 6 and 9; Kadapa et al., sea lion, Eq 1).

The state of a robot with p passive hinges is ``(x, y, z, qw, qx, qy, qz, passive angles.., velocity of the
base in its own axes (u, v, w), its angular velocity, passive rates..)``.
"""

from __future__ import annotations

import math

import numpy as np

from swimid.files.kernels import numba
from swimid.swimmer.engine import (
    ELEMENT_COLUMNS,
    LEAST_SPEED,
    LINK_COLUMNS,
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
    "topology": ("parent", "driven", "passive", "massless"),
    **LINK_COLUMNS,
    "passive": PASSIVE,
    **{name: columns for name, columns in ELEMENT_COLUMNS.items() if name != "wake"},
}
#: Indices in a row of ``term_link``, by the name of a velocity or of a component of force and moment.
SPATIAL_VELOCITIES = {
    name: i for i, name in enumerate(("1", *"uvwpqr", *(f"|{letter}|" for letter in "uvwpqr"), "U", "/U"))
}
SPATIAL_COMPONENTS = {name: i for i, name in enumerate("XYZKMN")}

#: Minimum squared cosine of the pitch angle of a link at which its heading is defined.
LEAST_HEADING = 1e-12
#: First columns of the quantities of a link in the work array: rotation to the parent (9 columns), v, w, v',
#: w', f, m (3 each), A (6), B (9), D (6), rotation to the world (9) and position in the world (3). The last
#: constant is the number of columns.
_R, _V, _W, _DV, _DW, _F = 0, 9, 12, 15, 18, 21
_M, _A, _B, _D, _TURN, _PLACE, _N_WORK = 24, 27, 33, 42, 48, 57, 60


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"}, inline="always")
def _at(w, k):  # type: ignore[no-untyped-def]
    """Return the vector that begins at column ``k`` of a row of an array."""
    return w[k], w[k + 1], w[k + 2]


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"}, inline="always")
def _put(w, k, v):  # type: ignore[no-untyped-def]
    """Write a vector into a row of an array, from column ``k`` on."""
    w[k], w[k + 1], w[k + 2] = v


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"}, inline="always")
def _plus(a, b):  # type: ignore[no-untyped-def]
    """Return the sum of two vectors."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"}, inline="always")
def _times(number, v):  # type: ignore[no-untyped-def]
    """Return the product of a number and a vector."""
    return number * v[0], number * v[1], number * v[2]


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"}, inline="always")
def _dot(a, b):  # type: ignore[no-untyped-def]
    """Return the scalar product of two vectors."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"}, inline="always")
def _cross(a, b):  # type: ignore[no-untyped-def]
    """Return the cross product of two vectors."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"}, inline="always")
def _apply(w, k, v):  # type: ignore[no-untyped-def]
    """Return the product of the 3 by 3 matrix that begins at column ``k`` of a row, and a vector."""
    return _dot(_at(w, k), v), _dot(_at(w, k + 3), v), _dot(_at(w, k + 6), v)


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"}, inline="always")
def _apply_transpose(w, k, v):  # type: ignore[no-untyped-def]
    """Return the product of the transpose of the 3 by 3 matrix at column ``k`` of a row, and a vector."""
    return (
        w[k] * v[0] + w[k + 3] * v[1] + w[k + 6] * v[2],
        w[k + 1] * v[0] + w[k + 4] * v[1] + w[k + 7] * v[2],
        w[k + 2] * v[0] + w[k + 5] * v[1] + w[k + 8] * v[2],
    )


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"}, inline="always")
def _symmetric(w, k, v):  # type: ignore[no-untyped-def]
    """Return the product of the symmetric 3 by 3 matrix at column ``k`` of a row, and a vector.

    Six columns hold the upper triangle of the matrix.
    """
    s0, s1, s2, s3, s4, s5 = w[k], w[k + 1], w[k + 2], w[k + 3], w[k + 4], w[k + 5]
    return _dot((s0, s1, s2), v), _dot((s1, s3, s4), v), _dot((s2, s4, s5), v)


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"}, inline="always")
def _point_velocity(w, at):  # type: ignore[no-untyped-def]
    """Return the velocity of a point of a link, in the axes of the link."""
    return _plus(_at(w, _V), _cross(_at(w, _W), at))


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"}, inline="always")
def wet(height, size):  # type: ignore[no-untyped-def]
    """Return the fraction of the cross-section at a point that is under water.

    The centre of the cross-section is at ``height`` above the water surface.

    The fraction falls smoothly (cubic) from 1 at ``-size`` to 0 at ``size``. It is 1 if ``size`` is 0.
    """
    if size <= 0.0:
        return 1.0
    s = min(max(0.5 * (1.0 - height / size), 0.0), 1.0)
    return s * s * (3.0 - 2.0 * s)


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"}, inline="always")
def _put_attitude(w, qw, qx, qy, qz):  # type: ignore[no-untyped-def]
    """Write the rotation of the base to the world, which a quaternion of any length gives."""
    norm = 1.0 / math.sqrt(qw * qw + qx * qx + qy * qy + qz * qz)
    qw, qx, qy, qz = qw * norm, qx * norm, qy * norm, qz * norm
    first = (1.0 - 2.0 * (qy * qy + qz * qz), 2.0 * (qx * qy - qw * qz), 2.0 * (qx * qz + qw * qy))
    second = (2.0 * (qx * qy + qw * qz), 1.0 - 2.0 * (qx * qx + qz * qz), 2.0 * (qy * qz - qw * qx))
    third = (2.0 * (qx * qz - qw * qy), 2.0 * (qy * qz + qw * qx), 1.0 - 2.0 * (qx * qx + qy * qy))
    _put(w, _TURN, first)
    _put(w, _TURN + 3, second)
    _put(w, _TURN + 6, third)


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"}, forceinline=True)
def _outwards(state, row, topology, joint, inertia, rate, work):  # type: ignore[no-untyped-def]
    """Compute velocities, accelerations, wrenches and inertias of all links, from the base outwards.

    If the rate of the state is None, the unknown accelerations are taken as zero.
    """
    twist = 7 + (len(state) - 13) // 2
    for i in range(topology.shape[0]):
        w = work[i]
        if i == 0:
            _put_attitude(w, state[3], state[4], state[5], state[6])
            _put(w, _PLACE, _at(state, 0))
            for m in range(6):
                w[_V + m] = state[twist + m]
                w[_DV + m] = 0.0
                if rate is not None:
                    w[_DV + m] = rate[twist + m]
        else:
            u = work[topology[i, 0]]
            d, k = topology[i, 1], topology[i, 2]
            c, s, speed, bend = 1.0, 0.0, 0.0, 0.0
            if d >= 0:
                speed, bend, c, s = row[d, 1], row[d, 2], row[d, 3], row[d, 4]
            elif k >= 0:
                speed = state[twist + 6 + k]
                c, s = math.cos(state[7 + k]), math.sin(state[7 + k])
                if rate is not None:
                    bend = rate[twist + 6 + k]
            for m in range(9):
                w[m] = joint[i, 6 + m] + s * joint[i, 15 + m] + (1.0 - c) * joint[i, 24 + m]
            place, axis = _at(joint[i], 0), _at(joint[i], 3)
            # compute velocity and acceleration of the hinge, in the axes of the link
            _put(w, _V, _apply_transpose(w, _R, _point_velocity(u, place)))
            _put(w, _W, _apply_transpose(w, _R, _at(u, _W)))
            _put(w, _DV, _apply_transpose(w, _R, _plus(_at(u, _DV), _cross(_at(u, _DW), place))))
            _put(w, _DW, _apply_transpose(w, _R, _at(u, _DW)))
            if d >= 0 or k >= 0:
                # add the motion of the hinge, with s = axis speed: v' += v x s, w' += w_parent x s + axis
                # bend, w += s
                turning = _times(speed, axis)
                _put(w, _DV, _plus(_at(w, _DV), _cross(_at(w, _V), turning)))
                spun = _plus(_times(bend, axis), _cross(_at(w, _W), turning))
                _put(w, _DW, _plus(_at(w, _DW), spun))
                _put(w, _W, _plus(_at(w, _W), turning))
            _put(w, _PLACE, _plus(_at(u, _PLACE), _apply(u, _TURN, place)))
            for m in range(3):
                _put(w, _TURN + 3 * m, _apply_transpose(w, _R, _at(u, _TURN + 3 * m)))
        for m in range(21):
            w[_A + m] = inertia[i, m]
        if topology[i, 3] != 0:
            for m in range(6):
                w[_F + m] = 0.0
        else:
            _newton_euler(w)


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"}, inline="always")
def _momenta(w, v, spin):  # type: ignore[no-untyped-def]
    """Return the linear and the angular momentum of a link for its linear and angular velocity."""
    p = _plus(_symmetric(w, _A, v), _apply(w, _B, spin))
    return p, _plus(_apply_transpose(w, _B, v), _symmetric(w, _D, spin))


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"}, inline="always")
def _newton_euler(w):  # type: ignore[no-untyped-def]
    """Compute the wrench at the origin of a link that the motion of this link needs."""
    v, spin = _at(w, _V), _at(w, _W)
    p, h = _momenta(w, v, spin)
    force, moment = _momenta(w, _at(w, _DV), _at(w, _DW))
    _put(w, _F, _plus(force, _cross(spin, p)))
    _put(w, _M, _plus(moment, _plus(_cross(spin, h), _cross(v, p))))


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"}, inline="always")
def _push(w, at, force):  # type: ignore[no-untyped-def]
    """Apply a force at a point of a link.

    The force is subtracted from the wrench that the motion of the link needs.
    """
    w[_F] -= force[0]
    w[_F + 1] -= force[1]
    w[_F + 2] -= force[2]
    _put(w, _M, _plus(_at(w, _M), _cross(force, at)))


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"}, inline="always")
def _share(w, at, size, surface):  # type: ignore[no-untyped-def]
    """Return the fraction of the cross-section at a point of a link that is under water (see :func:`wet`)."""
    return wet(w[_PLACE + 2] + _dot(_at(w, _TURN + 6), at) - surface, size)


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"}, inline="always")
def _drags(drag_link, drag, surface, work):  # type: ignore[no-untyped-def]
    """Add the drag at points of the links, along each axis of a link."""
    for e in range(drag.shape[0]):
        w, at = work[drag_link[e]], _at(drag[e], 0)
        vx, vy, vz = _point_velocity(w, at)
        fx = -(drag[e, 3] * abs(vx) + drag[e, 6]) * vx
        fy = -(drag[e, 4] * abs(vy) + drag[e, 7]) * vy
        fz = -(drag[e, 5] * abs(vz) + drag[e, 8]) * vz
        _push(w, at, _times(_share(w, at, drag[e, 9], surface), (fx, fy, fz)))


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"}, inline="always")
def _dampings(damping_link, damping, work):  # type: ignore[no-untyped-def]
    """Add the moments that damp the rotation of the links."""
    for e in range(damping.shape[0]):
        w = work[damping_link[e]]
        for m in range(3):
            w[_M + m] += (damping[e, m] * abs(w[_W + m]) + damping[e, 3 + m]) * w[_W + m]


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"}, inline="always")
def _foils(foil_link, foil, surface, work):  # type: ignore[no-untyped-def]
    """Add the lift and the drag of fins, each at a point of a link. Flow along the span has no effect."""
    for e in range(foil.shape[0]):
        w, at = work[foil_link[e]], _at(foil[e], 0)
        chord, normal, v = _at(foil[e], 7), _at(foil[e], 10), _point_velocity(w, at)
        along, across = _dot(v, chord), _dot(v, normal)
        square = along * along + across * across
        # at a point at rest, where the force is zero, avoid a division by zero
        divisor = positive(square, square, 1.0)
        lift = 2.0 * foil[e, 4] * along * across / divisor
        resistance = foil[e, 5] + 2.0 * foil[e, 6] * across * across / divisor
        push = _share(w, at, foil[e, 13], surface) * foil[e, 3] * math.sqrt(square)
        forward = push * (lift * across - resistance * along)
        up = push * (-lift * along - resistance * across)
        _push(w, at, _plus(_times(forward, chord), _times(up, normal)))


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"}, inline="always")
def _forces(force_link, force, surface, work):  # type: ignore[no-untyped-def]
    """Add the constant forces of the robot file, which have a fixed direction in a link or in the world.

    Buoyancy falls to zero where a point leaves the water.
    """
    for e in range(force.shape[0]):
        w, at, own = work[force_link[e]], _at(force[e], 0), _at(force[e], 3)
        if force[e, 6] != 0.0:
            own = _apply_transpose(w, _TURN, own)
        _push(w, at, _times(_share(w, at, force[e, 7], surface), own))


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"}, inline="always")
def _loads(load_link, load_input, load, row, work):  # type: ignore[no-untyped-def]
    """Add the forces and moments that are proportional to inputs."""
    for e in range(load.shape[0]):
        w, at, force = work[load_link[e]], _at(load[e], 0), _at(load[e], 3)
        if load[e, 9] != 0.0:
            force = _apply_transpose(w, _TURN, force)
        size = reduce_input(row[load_input[e], 0], load[e, 10], _dot(_point_velocity(w, at), force))
        _push(w, at, _times(size, force))
        _put(w, _M, _plus(_at(w, _M), _times(-size, _at(load[e], 6))))


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"}, inline="always")
def _propeller_flow(e, propeller_link, propeller, row, work):  # type: ignore[no-untyped-def]
    """Return velocity of advance (m/s) and thrust (N) of propeller ``e``."""
    n = row[propeller_link[e, 1], 0]
    velocity = _point_velocity(work[propeller_link[e, 0]], _at(propeller[e], 0))
    along = _dot(velocity, _at(propeller[e], 3))
    # the velocity of oblique motion is the component horizontally to port of the propeller's axis
    aside = velocity[1] * propeller[e, 3] - velocity[0] * propeller[e, 4]
    speed = math.sqrt(along * along + aside * aside)
    growth = wake_growth(aside, speed, propeller[e, 12], propeller[e, 13], propeller[e, 14])
    advance = growth * propeller[e, 10] * along
    return advance, thrust_of(n, advance, propeller[e, 6], propeller[e, 7], propeller[e, 8])


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"}, inline="always")
def _propellers(propeller_link, propeller, row, work):  # type: ignore[no-untyped-def]
    """Add the thrusts of propellers."""
    for e in range(propeller.shape[0]):
        _, thrust = _propeller_flow(e, propeller_link, propeller, row, work)
        w = work[propeller_link[e, 0]]
        _push(w, _at(propeller[e], 0), _times(propeller[e, 9] * thrust, _at(propeller[e], 3)))


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"}, inline="always")
def _rudders(rudder_link, rudder, propeller_link, propeller, row, work):  # type: ignore[no-untyped-def]
    """Add the forces of rudders, and the forces on the hull that they induce."""
    for e in range(rudder.shape[0]):
        w, p = work[rudder_link[e, 0]], rudder_link[e, 2]
        side, velocity = _at(rudder[e], 9), _point_velocity(w, _at(rudder[e], 6))
        jet, thrust = 0.0, 0.0
        advance = velocity[0]
        if p >= 0:
            jet = propeller[p, 11]
            advance, thrust = _propeller_flow(p, propeller_link, propeller, row, work)
        along = inflow_speed(advance, thrust, jet, rudder[e, 17], rudder[e, 18], rudder[e, 19])
        angle = row[rudder_link[e, 1], 0]
        sine, cosine = math.sin(angle), math.cos(angle)
        aside = _dot(velocity, side)
        force = rudder_force(along, aside, rudder[e, 12], rudder[e, 15], rudder[e, 16], sine, cosine)
        lateral = _times(-force * cosine, side)
        _push(w, _at(rudder[e], 0), _plus(lateral, (-rudder[e, 13] * force * sine, 0.0, 0.0)))
        _push(w, _at(rudder[e], 3), _times(rudder[e, 14], lateral))


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"}, inline="always")
def _terms(term_link, term, work):  # type: ignore[no-untyped-def]
    """Add the forces and moments that are products of velocities at a point of a link."""
    for e in range(term.shape[0]):
        w, component, at = work[term_link[e, 0]], term_link[e, 1], _at(term[e], 0)
        velocity, (p, q, r) = _point_velocity(w, at), _at(w, _W)
        u, v, vertical = velocity
        speed = math.sqrt(_dot(velocity, velocity))
        inverse = 1.0 / max(speed, LEAST_SPEED)
        absolute = (abs(u), abs(v), abs(vertical), abs(p), abs(q), abs(r))
        velocities = (1.0, u, v, vertical, p, q, r, *absolute, speed, inverse)
        size = product_of(term[e, 3], term_link[e], velocities)
        if component < 3:
            force = (
                size if component == 0 else 0.0,
                size if component == 1 else 0.0,
                size if component == 2 else 0.0,
            )
            _push(w, at, force)
        else:
            w[_M + component - 3] -= size


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"}, inline="always")
def _sliders(slider_link, slider, row, work):  # type: ignore[no-untyped-def]
    """Add the masses that inputs move: their inertia, and the wrench that their motion needs."""
    for e in range(slider.shape[0]):
        w, k, travel = work[slider_link[e, 0]], slider_link[e, 1], _at(slider[e], 3)
        mass, weight = slider[e, 6], slider[e, 7]
        at = _plus(_at(slider[e], 0), _times(row[k, 0], travel))
        moved = _times(row[k, 1], travel)
        spin, velocity = _at(w, _W), _plus(_point_velocity(w, at), moved)
        # acceleration of the mass: rates of the components of its velocity, and their rotation with the link
        rate = _plus(_at(w, _DV), _plus(_cross(_at(w, _DW), at), _cross(spin, moved)))
        rate = _plus(_plus(rate, _times(row[k, 2], travel)), _cross(spin, velocity))
        down = _apply_transpose(w, _TURN, (0.0, 0.0, -weight))
        _push(w, at, _plus(down, _times(-mass, rate)))
        x, y, z = at
        w[_A] += mass
        w[_A + 3] += mass
        w[_A + 5] += mass
        _put(w, _B, _plus(_at(w, _B), (0.0, mass * z, -mass * y)))
        _put(w, _B + 3, _plus(_at(w, _B + 3), (-mass * z, 0.0, mass * x)))
        _put(w, _B + 6, _plus(_at(w, _B + 6), (mass * y, -mass * x, 0.0)))
        _put(w, _D, _plus(_at(w, _D), (mass * (y * y + z * z), -mass * x * y, -mass * x * z)))
        _put(
            w, _D + 3, _plus(_at(w, _D + 3), (mass * (x * x + z * z), -mass * y * z, mass * (x * x + y * y)))
        )


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"}, inline="always")
def _coupling(i, k, topology, joint, work, matrix):  # type: ignore[no-untyped-def]
    """Write the coupling of passive hinge ``k`` with the base and other hinges into the mass matrix.

    The entries follow from the wrench for a unit acceleration of the hinge, which is transferred to the base.
    """
    axis = _at(joint[i], 3)
    force, moment = _momenta(work[i], (0.0, 0.0, 0.0), axis)
    matrix[6 + k, 6 + k] = _dot(axis, moment)
    at = i
    while at > 0:
        w = work[at]
        force, moment = _apply(w, _R, force), _apply(w, _R, moment)
        moment = _plus(moment, _cross(_at(joint[at], 0), force))
        at = topology[at, 0]
        other = topology[at, 2]
        if at > 0 and other >= 0:
            value = _dot(_at(joint[at], 3), moment)
            matrix[6 + k, 6 + other] = value
            matrix[6 + other, 6 + k] = value
    _put(matrix[6 + k], 0, force)
    _put(matrix[6 + k], 3, moment)


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"}, inline="always")
def _add_upper(w, k, a, b, c):  # type: ignore[no-untyped-def]
    """Add a symmetric 3 by 3 matrix, given by its rows, to the upper triangle stored at column ``k``."""
    _put(w, k, _plus(_at(w, k), a))
    _put(w, k + 3, _plus(_at(w, k + 3), (b[1], b[2], c[2])))


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"}, inline="always")
def _rotate_matrix(w, product, k):  # type: ignore[no-untyped-def]
    """Return the rows of ``R M R'``, with the rotation R of a link to its parent and a matrix M.

    The matrix M is stored at column ``k``. The function ``product`` multiplies it by a vector.
    """
    return (
        _apply(w, _R, product(w, k, _at(w, _R))),
        _apply(w, _R, product(w, k, _at(w, _R + 3))),
        _apply(w, _R, product(w, k, _at(w, _R + 6))),
    )


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"}, inline="always")
def _to_parent(i, p, joint, work):  # type: ignore[no-untyped-def]
    """Add the wrench and composite inertia of a link to those of its parent.

    The wrench and the inertia are first converted to the axes and the origin of the parent.
    """
    w, u, place = work[i], work[p], _at(joint[i], 0)
    x, y, z = place
    force = _apply(w, _R, _at(w, _F))
    moment = _plus(_apply(w, _R, _at(w, _M)), _cross(place, force))
    _put(u, _F, _plus(_at(u, _F), force))
    _put(u, _M, _plus(_at(u, _M), moment))
    a0, a1, a2 = _rotate_matrix(w, _symmetric, _A)
    b0, b1, b2 = _rotate_matrix(w, _apply_transpose, _B)
    d0, d1, d2 = _rotate_matrix(w, _symmetric, _D)
    a1, a2 = (a0[1], a1[1], a1[2]), (a0[2], a1[2], a2[2])
    # with S = r x, the velocity of the link's origin is v - S w, so that B becomes C = B - A S, and D becomes
    # D - B' S + S C
    c0, c1, c2 = _plus(b0, _cross(place, a0)), _plus(b1, _cross(place, a1)), _plus(b2, _cross(place, a2))
    d0 = _plus(_plus(d0, _cross(place, (b0[0], b1[0], b2[0]))), _plus(_times(y, c2), _times(-z, c1)))
    d1 = _plus(_plus(d1, _cross(place, (b0[1], b1[1], b2[1]))), _plus(_times(z, c0), _times(-x, c2)))
    d2 = _plus(_plus(d2, _cross(place, (b0[2], b1[2], b2[2]))), _plus(_times(x, c1), _times(-y, c0)))
    _add_upper(u, _A, a0, a1, a2)
    _put(u, _B, _plus(_at(u, _B), c0))
    _put(u, _B + 3, _plus(_at(u, _B + 3), c1))
    _put(u, _B + 6, _plus(_at(u, _B + 6), c2))
    _add_upper(u, _D, d0, d1, d2)


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"}, inline="always")
def _inwards(state, topology, joint, passive, work, matrix, right):  # type: ignore[no-untyped-def]
    """Sum wrenches and composite inertias from the outer links to the base.

    The equations of the passive hinges are written on the way.
    """
    passives = passive.shape[0]
    # clear the entries of the last factorisation, because hinges on different branches do not couple
    for k in range(6, 6 + passives):
        for m in range(6, k):
            matrix[k, m] = 0.0
    for i in range(topology.shape[0] - 1, 0, -1):
        k = topology[i, 2]
        if k >= 0:
            torque = passive_torque(passive, k, state[7 + k], state[13 + passives + k])
            right[6 + k] = torque - _dot(_at(joint[i], 3), _at(work[i], _M))
            _coupling(i, k, topology, joint, work, matrix)
        _to_parent(i, topology[i, 0], joint, work)


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"}, inline="always")
def _add_external_forces(time, state, work, forced):  # type: ignore[no-untyped-def]
    """Add the external forces of effects (:class:`swimid.fitting.model.ExternalForce`).

    The forces act in the horizontal plane. Their axes are horizontal, and the first axis has the heading of
    the link.
    """
    links, places, constants, ends, frame, pose, velocity, wrench, functions = forced
    for e in range(len(links)):
        w, at = work[links[e]], (places[e, 0], places[e, 1], 0.0)
        length = math.sqrt(max(w[_TURN] * w[_TURN] + w[_TURN + 3] * w[_TURN + 3], LEAST_HEADING))
        c, s = w[_TURN] / length, w[_TURN + 3] / length
        vx, vy, _ = _apply(w, _TURN, _point_velocity(w, at))
        velocity[0], velocity[1] = c * vx + s * vy, c * vy - s * vx
        velocity[2] = _dot(_at(w, _TURN + 6), _at(w, _W))
        reference = _apply(work[0], _TURN, (frame[4], frame[5], frame[7]))
        a, b = state[0] + reference[0], state[1] + reference[1]
        pose[0] = frame[0] + frame[2] * a - frame[3] * b
        pose[1] = frame[1] + frame[3] * a + frame[2] * b
        pose[2] = find_heading((frame[6], frame[2], frame[3]), (0.0, 1.0, 0.0), (c, s))
        wrench[:] = 0.0
        functions[e](time, pose, velocity, constants[ends[e] : ends[e + 1]], wrench)
        fx, fy = c * wrench[0] - s * wrench[1], s * wrench[0] + c * wrench[1]
        _push(w, at, _apply_transpose(w, _TURN, (fx, fy, 0.0)))
        _put(w, _M, _plus(_at(w, _M), _times(-wrench[2], _at(w, _TURN + 6))))


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"}, forceinline=True)
def _add_elements(state, row, tables, forced, time, work):  # type: ignore[no-untyped-def]
    """Add the forces of all elements and effects to the wrenches on the links."""
    drag_link, drag, damping_link, damping, foil_link, foil, force_link, force, load_link, load = tables[4:14]
    propeller_link, propeller, rudder_link, rudder, term_link, term, slider_link, slider = tables[14:22]
    load_input, surface = tables[22], tables[23]
    _drags(drag_link, drag, surface, work)
    _dampings(damping_link, damping, work)
    _foils(foil_link, foil, surface, work)
    _forces(force_link, force, surface, work)
    _loads(load_link, load_input, load, row, work)
    _propellers(propeller_link, propeller, row, work)
    _rudders(rudder_link, rudder, propeller_link, propeller, row, work)
    _terms(term_link, term, work)
    _sliders(slider_link, slider, row, work)
    if forced is not None:
        _add_external_forces(time, state, work, forced)


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"}, forceinline=True)
def compute_spatial_rate(state, row, tables, forced, time, work, matrix, right, rate):  # type: ignore[no-untyped-def]
    """Compute the time derivative of the state vector (:attr:`swimid.swimmer.engine.Engine.compute_rate`)."""
    topology, joint, inertia, passive = tables[:4]
    passives = passive.shape[0]
    n = 6 + passives
    _outwards(state, row, topology, joint, inertia, None, work)
    _add_elements(state, row, tables, forced, time, work)
    _inwards(state, topology, joint, passive, work, matrix, right)
    w = work[0]
    first = 6
    if tables[-1]:
        first = 0
        matrix[0, 0], matrix[1, 1], matrix[2, 2] = w[_A], w[_A + 3], w[_A + 5]
        matrix[1, 0], matrix[2, 0], matrix[2, 1] = w[_A + 1], w[_A + 2], w[_A + 4]
        for r in range(3):
            for c in range(3):
                matrix[3 + r, c] = w[_B + 3 * c + r]
        matrix[3, 3], matrix[4, 4], matrix[5, 5] = w[_D], w[_D + 3], w[_D + 5]
        matrix[4, 3], matrix[5, 3], matrix[5, 4] = w[_D + 1], w[_D + 2], w[_D + 4]
        for m in range(6):
            right[m] = -w[_F + m]
    solve_accelerations(matrix, right, first)
    twist = 7 + passives
    _put(rate, 0, _apply(w, _TURN, _at(state, twist)))
    p, q, r = _at(state, twist + 3)
    qw, qx, qy, qz = state[3], state[4], state[5], state[6]
    rate[3] = -0.5 * (qx * p + qy * q + qz * r)
    rate[4] = 0.5 * (qw * p + qy * r - qz * q)
    rate[5] = 0.5 * (qw * q + qz * p - qx * r)
    rate[6] = 0.5 * (qw * r + qx * q - qy * p)
    for k in range(passives):
        rate[7 + k] = state[13 + passives + k]
    for m in range(n):
        rate[twist + m] = right[m] if m >= first else 0.0


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"}, inline="always")
def normalise_quaternion(state):  # type: ignore[no-untyped-def]
    """Scale the quaternion in a state vector to length 1, in place."""
    length = 0.0
    for j in range(3, 7):
        length += state[j] ** 2
    length = math.sqrt(length)
    for j in range(3, 7):
        state[j] /= length


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"})
def integrate_spatial(start, step, table, tables, forced, begin):  # type: ignore[no-untyped-def]
    """Integrate the equations of motion (:attr:`swimid.swimmer.engine.Engine.integrate`).

    The quaternion is scaled to length 1 after each step.
    """
    steps, size, n = (table.shape[0] - 1) // 2, len(start), 6 + tables[3].shape[0]
    states, rates = np.empty((steps + 1, size)), np.empty((steps + 1, size))
    work, matrix, right = np.zeros((tables[0].shape[0], _N_WORK)), np.zeros((n, n)), np.zeros(n)
    slope, total, trial = np.empty(size), np.empty(size), np.empty(size)
    states[0] = start
    for i in range(steps + 1):
        for stage in range(4):
            begin_stage(stage, step, states[i], slope, total, trial)
            half = (stage + 1) // 2
            time = begin + step * (i + 0.5 * half)
            compute_spatial_rate(trial, table[2 * i + half], tables, forced, time, work, matrix, right, slope)
            if stage == 0:
                rates[i] = slope
                if has_diverged(states[i], slope):
                    states[i:] = math.nan
                    rates[i:] = math.nan
                    return states, rates
                if i == steps:
                    return states, rates
        begin_stage(4, step, states[i], slope, total, states[i + 1])
        normalise_quaternion(states[i + 1])
    return states, rates


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"})
def compute_spatial_torques(states, rates, table, tables, forced, begin, step):  # type: ignore[no-untyped-def]
    """Return moments and base wrench (:attr:`swimid.swimmer.engine.Engine.compute_torques`)."""
    topology, joint, inertia = tables[:3]
    links = topology.shape[0]
    moments, work = np.zeros((states.shape[0], links)), np.zeros((links, _N_WORK))
    wrench = np.empty((states.shape[0], 6))
    for t in range(states.shape[0]):
        _outwards(states[t], table[t], topology, joint, inertia, rates[t], work)
        _add_elements(states[t], table[t], tables, forced, begin + step * t, work)
        for i in range(links - 1, 0, -1):
            moments[t, i] = _dot(_at(joint[i], 3), _at(work[i], _M))
            _to_parent(i, topology[i, 0], joint, work)
        wrench[t] = work[0, _F : _F + 6]
    return moments, wrench


SPATIAL_ENGINE = Engine(
    columns=COLUMNS,
    coordinates=7,
    speeds=6,
    work=_N_WORK,
    velocities=SPATIAL_VELOCITIES,
    components=SPATIAL_COMPONENTS,
    compute_rate=compute_spatial_rate,
    integrate=integrate_spatial,
    compute_torques=compute_spatial_torques,
    correct_state=normalise_quaternion,
)
