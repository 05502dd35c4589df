"""Tree of rigid links in water, in space: compiled equations of motion and their integration.

The unknowns are the base's pose (position and unit quaternion) and the angles of the passive hinges. Driven
hinges enter by their angle, rate and acceleration. Every link has a constant symmetric apparent inertia for
its velocity ``(v, w)`` at its origin, in its own axes,

    ``p = A v + B w``,  ``h = B' v + D w``  (rigid body plus added mass),

and the wrench that moves it follows from Kirchhoff's equations,

    ``f = p' + w x p``,  ``m = h' + w x h + v x p``.

A pass from the base outwards computes velocities, accelerations and wrenches with the unknown accelerations
at zero (recursive Newton-Euler). A pass back sums the wrenches and the composite inertias. One LDL^T
factorisation gives the accelerations (Featherstone 2008, Rigid Body Dynamics Algorithms, chapters 5, 6 and 9;
Kadapa et al., sea lion, Eq 1).

The state of a robot with p passive hinges is ``(x, y, z, qw, qx, qy, qz, passive angles.., velocity of the
base in its own axes (u, v, w), its angular velocity, passive rates..)``. The functions check no index.
:mod:`swimid.swimmer.spatial.assembly` has done so.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numba
import numpy as np

from swimid.swimmer.planar.engine import BROKEN, passive_torque, positive, solve

#: Columns of the tables.
TOPOLOGY = ("parent", "driven", "passive", "massless")
#: Columns of the table of hinges: place on the parent, axis in the child, and rotation from child to parent
#: row by row, ``M0 + sin M1 + (1 - cos) M2``.
JOINT = (
    *(f"at_{c}" for c in "xyz"),
    *(f"axis_{c}" for c in "xyz"),
    *(f"turn{m}_{r}{c}" for m in range(3) for r in range(3) for c in range(3)),
)
#: Columns of the table of apparent inertias: blocks A, B and D.
INERTIA = (
    *(f"A{p}" for p in ("00", "01", "02", "11", "12", "22")),
    *(f"B{r}{c}" for r in range(3) for c in range(3)),
    *(f"D{p}" for p in ("00", "01", "02", "11", "12", "22")),
)
#: Columns of the table of drag points; ``size`` is half the height over which a point leaves the water, 0 if
#: it never does.
DRAG = (
    "x",
    "y",
    "z",
    "quadratic_x",
    "quadratic_y",
    "quadratic_z",
    "linear_x",
    "linear_y",
    "linear_z",
    "size",
)
DAMPING = ("quadratic_p", "quadratic_q", "quadratic_r", "linear_p", "linear_q", "linear_r")
FOIL = (
    "x", "y", "z", "half_rho_area", "cl", "cd0", "cd1",
    "chord_x", "chord_y", "chord_z", "normal_x", "normal_y", "normal_z", "size",
)  # fmt: skip
FORCE = ("x", "y", "z", "force_x", "force_y", "force_z", "world", "size")
WAKE = (
    "x", "y", "z", "half_mass", "chord_x", "chord_y", "chord_z", "normal_x", "normal_y", "normal_z",
)  # fmt: skip

#: First columns in the work array: rotation to the parent (9), v, w, v', w', f, m, A (6), B (9), D (6),
#: rotation to the world (9), place in the world (3), and the number of columns.
_R, _V, _W, _DV, _DW, _F, _M, _A, _B, _D, _TURN, _PLACE, _WORK = (
    0,
    9,
    12,
    15,
    18,
    21,
    24,
    27,
    33,
    42,
    48,
    57,
    60,
)


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"}, inline="always")
def wet(height, size):  # type: ignore[no-untyped-def]
    """Return the share of a point's section in the water, with its middle at ``height`` above the surface.

    It falls smoothly (cubic) from 1 at ``-size`` to 0 at ``size``. It is 1 if ``size`` is 0.
    """
    if size <= 0.0:
        return 1.0
    s = min(max(0.5 * (1.0 - height / size), 0.0), 1.0)
    return s * s * (3.0 - 2.0 * s)


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"}, inline="always")
def _turn_of(c, s, joint, i, out):  # type: ignore[no-untyped-def]
    """Compute the rotation of hinge ``i`` from child to parent at an angle with cosine ``c``, sine ``s``."""
    for m in range(9):
        out[m] = joint[i, 6 + m] + s * joint[i, 15 + m] + (1.0 - c) * joint[i, 24 + m]


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"}, inline="always")
def _outwards(state, row, topology, joint, inertia, work):  # type: ignore[no-untyped-def]
    """Compute velocities, known parts of accelerations, wrenches and inertias of all links."""
    passives = (len(state) - 13) // 2
    twist = 7 + passives
    for i in range(topology.shape[0]):
        w = work[i]
        if i == 0:
            qw, qx, qy, qz = state[3], state[4], state[5], state[6]
            norm = 1.0 / math.sqrt(qw * qw + qx * qx + qy * qy + qz * qz)
            qw, qx, qy, qz = qw * norm, qx * norm, qy * norm, qz * norm
            w[_TURN] = 1.0 - 2.0 * (qy * qy + qz * qz)
            w[_TURN + 1] = 2.0 * (qx * qy - qw * qz)
            w[_TURN + 2] = 2.0 * (qx * qz + qw * qy)
            w[_TURN + 3] = 2.0 * (qx * qy + qw * qz)
            w[_TURN + 4] = 1.0 - 2.0 * (qx * qx + qz * qz)
            w[_TURN + 5] = 2.0 * (qy * qz - qw * qx)
            w[_TURN + 6] = 2.0 * (qx * qz - qw * qy)
            w[_TURN + 7] = 2.0 * (qy * qz + qw * qx)
            w[_TURN + 8] = 1.0 - 2.0 * (qx * qx + qy * qy)
            for m in range(3):
                w[_PLACE + m] = state[m]
                w[_V + m] = state[twist + m]
                w[_W + m] = state[twist + 3 + m]
                w[_DV + m] = 0.0
                w[_DW + m] = 0.0
        else:
            u = work[topology[i, 0]]
            d, k = topology[i, 1], topology[i, 2]
            c, s, rate, bend = 1.0, 0.0, 0.0, 0.0
            if d >= 0:
                rate, bend, c, s = row[d, 1], row[d, 2], row[d, 3], row[d, 4]
            elif k >= 0:
                rate = state[twist + 6 + k]
                c, s = math.cos(state[7 + k]), math.sin(state[7 + k])
            _turn_of(c, s, joint, i, w)
            x, y, z = joint[i, 0], joint[i, 1], joint[i, 2]
            # velocity and acceleration of the hinge, in the parent's axes
            a0 = u[_V] + u[_W + 1] * z - u[_W + 2] * y
            a1 = u[_V + 1] + u[_W + 2] * x - u[_W] * z
            a2 = u[_V + 2] + u[_W] * y - u[_W + 1] * x
            b0 = u[_DV] + u[_DW + 1] * z - u[_DW + 2] * y
            b1 = u[_DV + 1] + u[_DW + 2] * x - u[_DW] * z
            b2 = u[_DV + 2] + u[_DW] * y - u[_DW + 1] * x
            for m in range(3):
                r0, r1, r2 = w[m], w[3 + m], w[6 + m]
                w[_V + m] = r0 * a0 + r1 * a1 + r2 * a2
                w[_W + m] = r0 * u[_W] + r1 * u[_W + 1] + r2 * u[_W + 2]
                w[_DV + m] = r0 * b0 + r1 * b1 + r2 * b2
                w[_DW + m] = r0 * u[_DW] + r1 * u[_DW + 1] + r2 * u[_DW + 2]
            if d >= 0 or k >= 0:
                # motion of the hinge, s = axis rate: v' -= s x v, w' -= s x w_parent, w += s, w' += axis bend
                e0, e1, e2 = joint[i, 3] * rate, joint[i, 4] * rate, joint[i, 5] * rate
                w[_DV] -= e1 * w[_V + 2] - e2 * w[_V + 1]
                w[_DV + 1] -= e2 * w[_V] - e0 * w[_V + 2]
                w[_DV + 2] -= e0 * w[_V + 1] - e1 * w[_V]
                w[_DW] += joint[i, 3] * bend - (e1 * w[_W + 2] - e2 * w[_W + 1])
                w[_DW + 1] += joint[i, 4] * bend - (e2 * w[_W] - e0 * w[_W + 2])
                w[_DW + 2] += joint[i, 5] * bend - (e0 * w[_W + 1] - e1 * w[_W])
                w[_W] += e0
                w[_W + 1] += e1
                w[_W + 2] += e2
            for m in range(3):
                t0, t1, t2 = u[_TURN + 3 * m], u[_TURN + 3 * m + 1], u[_TURN + 3 * m + 2]
                w[_PLACE + m] = u[_PLACE + m] + t0 * x + t1 * y + t2 * z
                w[_TURN + 3 * m] = t0 * w[0] + t1 * w[3] + t2 * w[6]
                w[_TURN + 3 * m + 1] = t0 * w[1] + t1 * w[4] + t2 * w[7]
                w[_TURN + 3 * m + 2] = t0 * w[2] + t1 * w[5] + t2 * w[8]
        for m in range(21):
            w[_A + m] = inertia[i, m]
        if topology[i, 3] != 0:
            for m in range(6):
                w[_F + m] = 0.0
        else:
            _newton_euler(w)


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"}, inline="always")
def _newton_euler(w):  # type: ignore[no-untyped-def]
    """Compute the wrench that the motion of a link needs, at its origin."""
    v0, v1, v2 = w[_V], w[_V + 1], w[_V + 2]
    w0, w1, w2 = w[_W], w[_W + 1], w[_W + 2]
    a0, a1, a2 = w[_DV], w[_DV + 1], w[_DV + 2]
    b0, b1, b2 = w[_DW], w[_DW + 1], w[_DW + 2]
    m00, m01, m02, m11, m12, m22 = w[_A], w[_A + 1], w[_A + 2], w[_A + 3], w[_A + 4], w[_A + 5]
    c00, c01, c02 = w[_B], w[_B + 1], w[_B + 2]
    c10, c11, c12 = w[_B + 3], w[_B + 4], w[_B + 5]
    c20, c21, c22 = w[_B + 6], w[_B + 7], w[_B + 8]
    i00, i01, i02, i11, i12, i22 = w[_D], w[_D + 1], w[_D + 2], w[_D + 3], w[_D + 4], w[_D + 5]
    p0 = m00 * v0 + m01 * v1 + m02 * v2 + c00 * w0 + c01 * w1 + c02 * w2
    p1 = m01 * v0 + m11 * v1 + m12 * v2 + c10 * w0 + c11 * w1 + c12 * w2
    p2 = m02 * v0 + m12 * v1 + m22 * v2 + c20 * w0 + c21 * w1 + c22 * w2
    h0 = c00 * v0 + c10 * v1 + c20 * v2 + i00 * w0 + i01 * w1 + i02 * w2
    h1 = c01 * v0 + c11 * v1 + c21 * v2 + i01 * w0 + i11 * w1 + i12 * w2
    h2 = c02 * v0 + c12 * v1 + c22 * v2 + i02 * w0 + i12 * w1 + i22 * w2
    w[_F] = m00 * a0 + m01 * a1 + m02 * a2 + c00 * b0 + c01 * b1 + c02 * b2 + w1 * p2 - w2 * p1
    w[_F + 1] = m01 * a0 + m11 * a1 + m12 * a2 + c10 * b0 + c11 * b1 + c12 * b2 + w2 * p0 - w0 * p2
    w[_F + 2] = m02 * a0 + m12 * a1 + m22 * a2 + c20 * b0 + c21 * b1 + c22 * b2 + w0 * p1 - w1 * p0
    w[_M] = (
        c00 * a0 + c10 * a1 + c20 * a2 + i00 * b0 + i01 * b1 + i02 * b2
        + w1 * h2 - w2 * h1 + v1 * p2 - v2 * p1
    )  # fmt: skip
    w[_M + 1] = (
        c01 * a0 + c11 * a1 + c21 * a2 + i01 * b0 + i11 * b1 + i12 * b2
        + w2 * h0 - w0 * h2 + v2 * p0 - v0 * p2
    )  # fmt: skip
    w[_M + 2] = (
        c02 * a0 + c12 * a1 + c22 * a2 + i02 * b0 + i12 * b1 + i22 * b2
        + w0 * h1 - w1 * h0 + v0 * p1 - v1 * p0
    )  # fmt: skip


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"}, inline="always")
def _push(w, x, y, z, fx, fy, fz):  # type: ignore[no-untyped-def]
    """Subtract a force at a point of a link from the wrench that its motion needs."""
    w[_F] -= fx
    w[_F + 1] -= fy
    w[_F + 2] -= fz
    w[_M] -= y * fz - z * fy
    w[_M + 1] -= z * fx - x * fz
    w[_M + 2] -= x * fy - y * fx


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"}, inline="always")
def _height(w, x, y, z, surface):  # type: ignore[no-untyped-def]
    """Return the height of a point of a link above the water surface."""
    return w[_PLACE + 2] + w[_TURN + 6] * x + w[_TURN + 7] * y + w[_TURN + 8] * z - surface


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"}, inline="always")
def _drags(drag_link, drag, surface, work):  # type: ignore[no-untyped-def]
    """Add drag at points, along each axis of the link."""
    for e in range(drag.shape[0]):
        w = work[drag_link[e]]
        x, y, z = drag[e, 0], drag[e, 1], drag[e, 2]
        vx = w[_V] + w[_W + 1] * z - w[_W + 2] * y
        vy = w[_V + 1] + w[_W + 2] * x - w[_W] * z
        vz = w[_V + 2] + w[_W] * y - w[_W + 1] * x
        share = 1.0
        if drag[e, 9] > 0.0:
            share = wet(_height(w, x, y, z, surface), drag[e, 9])
        fx = -share * (drag[e, 3] * abs(vx) + drag[e, 6]) * vx
        fy = -share * (drag[e, 4] * abs(vy) + drag[e, 7]) * vy
        fz = -share * (drag[e, 5] * abs(vz) + drag[e, 8]) * vz
        _push(w, x, y, z, fx, fy, fz)


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"}, inline="always")
def _dampings(damping_link, damping, work):  # type: ignore[no-untyped-def]
    """Add moments against rotation."""
    for e in range(damping.shape[0]):
        w = work[damping_link[e]]
        for m in range(3):
            w[_M + m] += (damping[e, m] * abs(w[_W + m]) + damping[e, 3 + m]) * w[_W + m]


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"}, inline="always")
def _foils(foil_link, foil, surface, work):  # type: ignore[no-untyped-def]
    """Add lift and drag of fins at their points. Flow along the span has no effect."""
    for e in range(foil.shape[0]):
        w = work[foil_link[e]]
        x, y, z = foil[e, 0], foil[e, 1], foil[e, 2]
        vx = w[_V] + w[_W + 1] * z - w[_W + 2] * y
        vy = w[_V + 1] + w[_W + 2] * x - w[_W] * z
        vz = w[_V + 2] + w[_W] * y - w[_W + 1] * x
        along = vx * foil[e, 7] + vy * foil[e, 8] + vz * foil[e, 9]
        across = vx * foil[e, 10] + vy * foil[e, 11] + vz * foil[e, 12]
        square = along * along + across * across
        # a point at rest has no direction of flow, and no force
        divisor = positive(square, square, 1.0)
        share = 1.0
        if foil[e, 13] > 0.0:
            share = wet(_height(w, x, y, z, surface), foil[e, 13])
        lift = 2.0 * foil[e, 4] * along * across / divisor
        resistance = foil[e, 5] + 2.0 * foil[e, 6] * across * across / divisor
        push = share * foil[e, 3] * math.sqrt(square)
        forward = push * (lift * across - resistance * along)
        up = push * (-lift * along - resistance * across)
        _push(
            w, x, y, z,
            forward * foil[e, 7] + up * foil[e, 10],
            forward * foil[e, 8] + up * foil[e, 11],
            forward * foil[e, 9] + up * foil[e, 12],
        )  # fmt: skip


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"}, inline="always")
def _forces(force_link, force, surface, work):  # type: ignore[no-untyped-def]
    """Add constant forces, in the axes of a link or of the world. Buoyancy ends above the surface."""
    for e in range(force.shape[0]):
        w = work[force_link[e]]
        x, y, z = force[e, 0], force[e, 1], force[e, 2]
        fx, fy, fz = force[e, 3], force[e, 4], force[e, 5]
        if force[e, 6] != 0.0:
            a, b, c = fx, fy, fz
            fx = w[_TURN] * a + w[_TURN + 3] * b + w[_TURN + 6] * c
            fy = w[_TURN + 1] * a + w[_TURN + 4] * b + w[_TURN + 7] * c
            fz = w[_TURN + 2] * a + w[_TURN + 5] * b + w[_TURN + 8] * c
        if force[e, 7] > 0.0:
            share = wet(_height(w, x, y, z, surface), force[e, 7])
            fx, fy, fz = share * fx, share * fy, share * fz
        _push(w, x, y, z, fx, fy, fz)


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"}, inline="always")
def _wakes(wake_link, wake, work):  # type: ignore[no-untyped-def]
    """Add momentum shed at trailing edges. An edge that moves backwards sheds none."""
    for e in range(wake.shape[0]):
        w = work[wake_link[e]]
        x, y, z = wake[e, 0], wake[e, 1], wake[e, 2]
        vx = w[_V] + w[_W + 1] * z - w[_W + 2] * y
        vy = w[_V + 1] + w[_W + 2] * x - w[_W] * z
        vz = w[_V + 2] + w[_W] * y - w[_W + 1] * x
        along = vx * wake[e, 4] + vy * wake[e, 5] + vz * wake[e, 6]
        across = vx * wake[e, 7] + vy * wake[e, 8] + vz * wake[e, 9]
        forward = wake[e, 3] * across * across
        side = -2.0 * wake[e, 3] * max(along, 0.0) * across
        _push(
            w, x, y, z,
            forward * wake[e, 4] + side * wake[e, 7],
            forward * wake[e, 5] + side * wake[e, 8],
            forward * wake[e, 6] + side * wake[e, 9],
        )  # fmt: skip


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"}, inline="always")
def _coupling(i, k, topology, joint, work, matrix):  # type: ignore[no-untyped-def]
    """Compute the wrench for a unit acceleration of passive hinge ``k``, and transfer it to the base."""
    w = work[i]
    a0, a1, a2 = joint[i, 3], joint[i, 4], joint[i, 5]
    f0 = w[_B] * a0 + w[_B + 1] * a1 + w[_B + 2] * a2
    f1 = w[_B + 3] * a0 + w[_B + 4] * a1 + w[_B + 5] * a2
    f2 = w[_B + 6] * a0 + w[_B + 7] * a1 + w[_B + 8] * a2
    m0 = w[_D] * a0 + w[_D + 1] * a1 + w[_D + 2] * a2
    m1 = w[_D + 1] * a0 + w[_D + 3] * a1 + w[_D + 4] * a2
    m2 = w[_D + 2] * a0 + w[_D + 4] * a1 + w[_D + 5] * a2
    matrix[6 + k, 6 + k] = a0 * m0 + a1 * m1 + a2 * m2
    at = i
    while at > 0:
        w = work[at]
        g0 = w[0] * f0 + w[1] * f1 + w[2] * f2
        g1 = w[3] * f0 + w[4] * f1 + w[5] * f2
        g2 = w[6] * f0 + w[7] * f1 + w[8] * f2
        n0 = w[0] * m0 + w[1] * m1 + w[2] * m2
        n1 = w[3] * m0 + w[4] * m1 + w[5] * m2
        n2 = w[6] * m0 + w[7] * m1 + w[8] * m2
        x, y, z = joint[at, 0], joint[at, 1], joint[at, 2]
        f0, f1, f2 = g0, g1, g2
        m0, m1, m2 = n0 + y * g2 - z * g1, n1 + z * g0 - x * g2, n2 + x * g1 - y * g0
        at = topology[at, 0]
        other = topology[at, 2]
        if at > 0 and other >= 0:
            value = joint[at, 3] * m0 + joint[at, 4] * m1 + joint[at, 5] * m2
            matrix[6 + k, 6 + other] = value
            matrix[6 + other, 6 + k] = value
    matrix[6 + k, 0], matrix[6 + k, 1], matrix[6 + k, 2] = f0, f1, f2
    matrix[6 + k, 3], matrix[6 + k, 4], matrix[6 + k, 5] = m0, m1, m2


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"}, inline="always")
def _turned_symmetric(w, at, out):  # type: ignore[no-untyped-def]
    """Write ``R S R'`` of the symmetric block at ``at`` into ``out`` (6)."""
    s0, s1, s2, s3, s4, s5 = w[at], w[at + 1], w[at + 2], w[at + 3], w[at + 4], w[at + 5]
    a0, a1, a2 = (
        w[0] * s0 + w[1] * s1 + w[2] * s2,
        w[0] * s1 + w[1] * s3 + w[2] * s4,
        w[0] * s2 + w[1] * s4 + w[2] * s5,
    )
    b0, b1, b2 = (
        w[3] * s0 + w[4] * s1 + w[5] * s2,
        w[3] * s1 + w[4] * s3 + w[5] * s4,
        w[3] * s2 + w[4] * s4 + w[5] * s5,
    )
    c0, c1, c2 = (
        w[6] * s0 + w[7] * s1 + w[8] * s2,
        w[6] * s1 + w[7] * s3 + w[8] * s4,
        w[6] * s2 + w[7] * s4 + w[8] * s5,
    )
    out[0] = a0 * w[0] + a1 * w[1] + a2 * w[2]
    out[1] = a0 * w[3] + a1 * w[4] + a2 * w[5]
    out[2] = a0 * w[6] + a1 * w[7] + a2 * w[8]
    out[3] = b0 * w[3] + b1 * w[4] + b2 * w[5]
    out[4] = b0 * w[6] + b1 * w[7] + b2 * w[8]
    out[5] = c0 * w[6] + c1 * w[7] + c2 * w[8]


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"}, inline="always")
def _to_parent(i, p, joint, work, block):  # type: ignore[no-untyped-def]
    """Add the wrench and composite inertia of a link to those of its parent, in its axes, at its origin."""
    w, u = work[i], work[p]
    x, y, z = joint[i, 0], joint[i, 1], joint[i, 2]
    g0 = w[0] * w[_F] + w[1] * w[_F + 1] + w[2] * w[_F + 2]
    g1 = w[3] * w[_F] + w[4] * w[_F + 1] + w[5] * w[_F + 2]
    g2 = w[6] * w[_F] + w[7] * w[_F + 1] + w[8] * w[_F + 2]
    u[_F] += g0
    u[_F + 1] += g1
    u[_F + 2] += g2
    u[_M] += w[0] * w[_M] + w[1] * w[_M + 1] + w[2] * w[_M + 2] + y * g2 - z * g1
    u[_M + 1] += w[3] * w[_M] + w[4] * w[_M + 1] + w[5] * w[_M + 2] + z * g0 - x * g2
    u[_M + 2] += w[6] * w[_M] + w[7] * w[_M + 1] + w[8] * w[_M + 2] + x * g1 - y * g0
    _turned_symmetric(w, _A, block)
    a0, a1, a2, a3, a4, a5 = block[0], block[1], block[2], block[3], block[4], block[5]
    _turned_symmetric(w, _D, block)
    # R B R'
    e0, e1, e2 = (
        w[0] * w[_B] + w[1] * w[_B + 3] + w[2] * w[_B + 6],
        w[0] * w[_B + 1] + w[1] * w[_B + 4] + w[2] * w[_B + 7],
        w[0] * w[_B + 2] + w[1] * w[_B + 5] + w[2] * w[_B + 8],
    )
    e3, e4, e5 = (
        w[3] * w[_B] + w[4] * w[_B + 3] + w[5] * w[_B + 6],
        w[3] * w[_B + 1] + w[4] * w[_B + 4] + w[5] * w[_B + 7],
        w[3] * w[_B + 2] + w[4] * w[_B + 5] + w[5] * w[_B + 8],
    )
    e6, e7, e8 = (
        w[6] * w[_B] + w[7] * w[_B + 3] + w[8] * w[_B + 6],
        w[6] * w[_B + 1] + w[7] * w[_B + 4] + w[8] * w[_B + 7],
        w[6] * w[_B + 2] + w[7] * w[_B + 5] + w[8] * w[_B + 8],
    )
    b0, b1, b2 = (
        e0 * w[0] + e1 * w[1] + e2 * w[2],
        e0 * w[3] + e1 * w[4] + e2 * w[5],
        e0 * w[6] + e1 * w[7] + e2 * w[8],
    )
    b3, b4, b5 = (
        e3 * w[0] + e4 * w[1] + e5 * w[2],
        e3 * w[3] + e4 * w[4] + e5 * w[5],
        e3 * w[6] + e4 * w[7] + e5 * w[8],
    )
    b6, b7, b8 = (
        e6 * w[0] + e7 * w[1] + e8 * w[2],
        e6 * w[3] + e7 * w[4] + e8 * w[5],
        e6 * w[6] + e7 * w[7] + e8 * w[8],
    )
    # with S = r x, the velocity of the link's origin is v - S w, so that B becomes C = B - A S, and D becomes
    # D - B' S + S C
    c0, c1, c2 = b0 - (a1 * z - a2 * y), b1 - (a2 * x - a0 * z), b2 - (a0 * y - a1 * x)
    c3, c4, c5 = b3 - (a3 * z - a4 * y), b4 - (a4 * x - a1 * z), b5 - (a1 * y - a3 * x)
    c6, c7, c8 = b6 - (a4 * z - a5 * y), b7 - (a5 * x - a2 * z), b8 - (a2 * y - a4 * x)
    u[_A] += a0
    u[_A + 1] += a1
    u[_A + 2] += a2
    u[_A + 3] += a3
    u[_A + 4] += a4
    u[_A + 5] += a5
    u[_B] += c0
    u[_B + 1] += c1
    u[_B + 2] += c2
    u[_B + 3] += c3
    u[_B + 4] += c4
    u[_B + 5] += c5
    u[_B + 6] += c6
    u[_B + 7] += c7
    u[_B + 8] += c8
    u[_D] += block[0] - (b3 * z - b6 * y) + (y * c6 - z * c3)
    u[_D + 1] += block[1] - (b6 * x - b0 * z) + (y * c7 - z * c4)
    u[_D + 2] += block[2] - (b0 * y - b3 * x) + (y * c8 - z * c5)
    u[_D + 3] += block[3] - (b7 * x - b1 * z) + (z * c1 - x * c7)
    u[_D + 4] += block[4] - (b1 * y - b4 * x) + (z * c2 - x * c8)
    u[_D + 5] += block[5] - (b2 * y - b5 * x) + (x * c5 - y * c2)


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"}, inline="always")
def _inwards(state, topology, joint, passive, work, matrix, right, block):  # type: ignore[no-untyped-def]
    """Sum wrenches and composite inertias, and write the equations of the passive hinges."""
    passives = passive.shape[0]
    # hinges on different branches do not couple, but the last factorisation has filled their entries
    for k in range(6, 6 + passives):
        for m in range(6, k):
            matrix[k, m] = 0.0
    for i in range(topology.shape[0] - 1, 0, -1):
        k = topology[i, 2]
        if k >= 0:
            torque = passive_torque(passive, k, state[7 + k], state[13 + passives + k])
            w = work[i]
            needed = joint[i, 3] * w[_M] + joint[i, 4] * w[_M + 1] + joint[i, 5] * w[_M + 2]
            right[6 + k] = torque - needed
            _coupling(i, k, topology, joint, work, matrix)
        _to_parent(i, topology[i, 0], joint, work, block)


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"}, forceinline=True)
def derivative(  # type: ignore[no-untyped-def]
    state,
    row,
    topology,
    joint,
    inertia,
    passive,
    drag_link,
    drag,
    damping_link,
    damping,
    foil_link,
    foil,
    force_link,
    force,
    wake_link,
    wake,
    surface,
    free_base,
    work,
    matrix,
    right,
    block,
    rate,
):
    """Compute the rate of the state, and write it into ``rate``.

    Parameters
    ----------
    state, rate : ndarray, shape (13 + 2 passive hinges,)
    row : ndarray, shape (driven hinges, 5)
        Angle, rate, acceleration, cosine and sine of each driven hinge.
    topology : ndarray of int, shape (links, 4); joint : ndarray, shape (links, 33)
    inertia : ndarray, shape (links, 21); passive : ndarray, shape (passive hinges, 11)
        Columns of ``swimid.swimmer.planar.engine.PASSIVE``
    drag_link, drag, damping_link, damping, foil_link, foil, force_link, force, wake_link, wake : ndarray
        Element lists, columns as :data:`DRAG`, :data:`DAMPING`, :data:`FOIL`, :data:`FORCE`, :data:`WAKE`.
    surface : float, m
        Height of the water surface in the world.
    free_base : bool
        Whether the base moves; otherwise it keeps its pose.
    work : ndarray, shape (links, 60)
    matrix : ndarray, shape (n, n), n = 6 + passive hinges
    right : ndarray, shape (n,); block : ndarray, shape (6,)
        Work arrays.
    """
    passives = passive.shape[0]
    n = 6 + passives
    _outwards(state, row, topology, joint, inertia, work)
    _drags(drag_link, drag, surface, work)
    _dampings(damping_link, damping, work)
    _foils(foil_link, foil, surface, work)
    _forces(force_link, force, surface, work)
    _wakes(wake_link, wake, work)
    _inwards(state, topology, joint, passive, work, matrix, right, block)
    w = work[0]
    first = 6
    if free_base:
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
    solve(matrix, right, first)
    twist = 7 + passives
    u, v, s = state[twist], state[twist + 1], state[twist + 2]
    p, q, r = state[twist + 3], state[twist + 4], state[twist + 5]
    for m in range(3):
        rate[m] = w[_TURN + 3 * m] * u + w[_TURN + 3 * m + 1] * v + w[_TURN + 3 * m + 2] * s
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
def settled(state):  # type: ignore[no-untyped-def]
    """Scale the quaternion of a state to length 1, in place."""
    length = 0.0
    for j in range(3, 7):
        length += state[j] ** 2
    length = math.sqrt(length)
    for j in range(3, 7):
        state[j] /= length


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"})
def integrate(  # type: ignore[no-untyped-def]
    start,
    step,
    table,
    topology,
    joint,
    inertia,
    passive,
    drag_link,
    drag,
    damping_link,
    damping,
    foil_link,
    foil,
    force_link,
    force,
    wake_link,
    wake,
    surface,
    free_base,
):
    """Return states and rates on the step grid, by a fourth-order Runge-Kutta method with fixed steps.

    Parameters
    ----------
    start : ndarray, shape (13 + 2 passive hinges,)
    step : float, s
    table : ndarray, shape (2 steps + 1, driven hinges, 5)
        Driven hinges on the half-step grid; see :func:`derivative`.
    others
        See :func:`derivative`.

    Returns
    -------
    states, rates : ndarray, shape (steps + 1, 13 + 2 passive hinges)
        NaN from where the motion breaks down. The quaternion is scaled to length 1 after each step.
    """
    steps = (table.shape[0] - 1) // 2
    size = len(start)
    n = 6 + passive.shape[0]
    states = np.empty((steps + 1, size))
    rates = np.empty((steps + 1, size))
    work = np.zeros((topology.shape[0], _WORK))
    matrix = np.zeros((n, n))
    right = np.zeros(n)
    block = np.zeros(6)
    slope, total, trial = np.empty(size), np.empty(size), np.empty(size)
    states[0] = start
    for i in range(steps + 1):
        here = states[i]
        for stage in range(4):
            # row of the table: that of the state, twice that of the middle of the step, that of its end
            at = 2 * i + (stage + 1) // 2
            if stage == 0:
                trial[:] = here
            else:
                share = step if stage == 3 else 0.5 * step
                for j in range(size):
                    trial[j] = here[j] + share * slope[j]
            derivative(
                trial, table[at], topology, joint, inertia, passive, drag_link, drag, damping_link, damping,
                foil_link, foil, force_link, force, wake_link, wake, surface, free_base, work, matrix, right,
                block, slope,
            )  # fmt: skip
            if stage == 0:
                largest = 0.0
                for j in range(size):
                    rates[i, j] = slope[j]
                    total[j] = slope[j]
                    largest = max(largest, abs(here[j]))
                    if not abs(slope[j]) < math.inf:
                        largest = math.inf
                if not largest < BROKEN:
                    states[i:] = math.nan
                    rates[i:] = math.nan
                    return states, rates
                if i == steps:
                    return states, rates
            else:
                weight = 1.0 if stage == 3 else 2.0
                for j in range(size):
                    total[j] += weight * slope[j]
        for j in range(size):
            states[i + 1, j] = here[j] + step / 6.0 * total[j]
        settled(states[i + 1])
    return states, rates


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"}, inline="always")
def _powers(work, before):  # type: ignore[no-untyped-def]
    """Return the power of the forces added since the wrenches ``before``, and update these wrenches."""
    power = 0.0
    for i in range(work.shape[0]):
        for m in range(6):
            power += (before[i, m] - work[i, _F + m]) * work[i, _V + m]
            before[i, m] = work[i, _F + m]
    return power


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"}, inline="always")
def _accelerate(twist, rate, topology, joint, inertia, work, moved):  # type: ignore[no-untyped-def]
    """Add the wrenches for the accelerations of base and passive hinges, and return the kinetic energy, J."""
    energy = 0.0
    full = np.zeros((6, 6))
    for i in range(topology.shape[0]):
        w = work[i]
        if i == 0:
            for m in range(6):
                moved[0, m] = rate[twist + m]
        else:
            u, k = moved[topology[i, 0]], topology[i, 2]
            x, y, z = joint[i, 0], joint[i, 1], joint[i, 2]
            a0 = u[0] + u[4] * z - u[5] * y
            a1 = u[1] + u[5] * x - u[3] * z
            a2 = u[2] + u[3] * y - u[4] * x
            for m in range(3):
                moved[i, m] = w[m] * a0 + w[3 + m] * a1 + w[6 + m] * a2
                moved[i, 3 + m] = w[m] * u[3] + w[3 + m] * u[4] + w[6 + m] * u[5]
                if k >= 0:
                    moved[i, 3 + m] += joint[i, 3 + m] * rate[twist + 6 + k]
        if topology[i, 3] != 0:
            continue
        at = 0
        for r in range(3):
            for c in range(3):
                full[r, 3 + c] = full[3 + c, r] = inertia[i, 6 + 3 * r + c]
            for c in range(r, 3):
                full[r, c] = full[c, r] = inertia[i, at]
                full[3 + r, 3 + c] = full[3 + c, 3 + r] = inertia[i, 15 + at]
                at += 1
        for r in range(6):
            for c in range(6):
                w[_F + r] += full[r, c] * moved[i, c]
                energy += 0.5 * w[_V + r] * full[r, c] * w[_V + c]
    return energy


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"})
def energetics(states, rates, table, *tables):  # type: ignore[no-untyped-def]
    """Return the hinge torques of a run by inverse dynamics, with its energies and powers.

    See :func:`swimid.swimmer.planar.engine.energetics`. The torque of a base is zero.
    """
    topology, joint, inertia, passive = tables[:4]
    drag_link, drag, damping_link, damping, foil_link, foil, force_link, force = tables[4:12]
    wake_link, wake, surface, _ = tables[12:]
    count, links = states.shape[0], topology.shape[0]
    torque, flow = np.zeros((count, links)), np.empty((count, 3))
    work, before, moved = np.zeros((links, _WORK)), np.zeros((links, 6)), np.zeros((links, 6))
    block = np.zeros(6)
    twist = 7 + passive.shape[0]
    for t in range(count):
        state = states[t]
        _outwards(state, table[t], topology, joint, inertia, work)
        before[:] = work[:, _F : _F + 6]
        _drags(drag_link, drag, surface, work)
        _dampings(damping_link, damping, work)
        _foils(foil_link, foil, surface, work)
        _wakes(wake_link, wake, work)
        flow[t, 1] = -_powers(work, before)
        _forces(force_link, force, surface, work)
        flow[t, 2] = -_powers(work, before)
        flow[t, 0] = _accelerate(twist, rates[t], topology, joint, inertia, work, moved)
        for i in range(links - 1, 0, -1):
            w = work[i]
            torque[t, i] = joint[i, 3] * w[_M] + joint[i, 4] * w[_M + 1] + joint[i, 5] * w[_M + 2]
            _to_parent(i, topology[i, 0], joint, work, block)
    return torque, flow


def shapes(tables: Mapping[str, Any]) -> tuple[int, list[tuple[int, ...]]]:
    """Return the length of the state, and the shapes of the work arrays of :func:`derivative`."""
    n = 6 + len(tables["passive"])
    return 2 * n + 1, [(len(tables["topology"]), _WORK), (n, n), (n,), (6,)]
