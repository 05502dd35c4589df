"""A planar chain of links in water, compiled: levers as in `tests.generators.swimmer`, Kutta's rule.

Positions are complex numbers; a point behind the front end of link k lies at ``front_k - a e_k`` with
a complex lever ``a`` and ``e_k = exp(i psi_k)``. Lagrange's equations in (nose, psi_0, psi_1, ...) are
reduced by the driven joints and integrated with Kutta's third-order rule, whose three stages fall on a
half-step grid.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from validation.blind.swim_tables import GRAVITY_M_S2, WATER_KG_M3


@njit(cache=True)
def passive_torque(law, angle, rate):  # type: ignore[no-untyped-def]
    torque = -law[0] * angle - law[1] * angle**3
    torque -= law[2] * (rate * rate + 1e-4) ** (0.5 * (law[3] - 1.0)) * rate
    if law[4] > 0.0:
        arm, crank = law[6], law[7]
        reach = np.sqrt(arm**2 + crank**2 - 2.0 * arm * crank * np.cos(angle))
        torque -= law[4] * (law[5] + reach - arm + crank) * arm * crank * np.sin(angle) / reach
    if law[8] > 0.0:
        torque -= law[8] * (angle - law[9] * np.tanh(angle / law[9]))
    if law[10] > 0.0:
        torque -= law[10] * (np.sinh(law[11] * angle) / law[11] - angle)
    return torque


@njit(cache=True)
def friction_line(speed, length, power):  # type: ignore[no-untyped-def]
    """ITTC-1957 friction over its value at 0.3 m/s, to a power; held below a Reynolds number of 3000."""
    number = np.log10(max(speed * length * 1e6, 3e3)) - 2.0
    return ((np.log10(0.3e6 * length) - 2.0) / number) ** (2.0 * power)


@njit(cache=True)
def solve(matrix, right, n):  # type: ignore[no-untyped-def]
    """Solve a symmetric positive definite system in place, by elimination."""
    for i in range(n):
        for j in range(i + 1, n):
            ratio = matrix[j, i] / matrix[i, i]
            for k in range(i, n):
                matrix[j, k] -= ratio * matrix[i, k]
            right[j] -= ratio * right[i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            right[i] -= matrix[i, k] * right[k]
        right[i] /= matrix[i, i]


@njit(cache=True)
def place(state, joints, chain, work):  # type: ignore[no-untyped-def]
    """Direction, front end, its velocity and the known part of the angular acceleration of every link."""
    n = 3 + chain.laws.shape[0]
    e, angle, rate, known = work.e, work.angle, work.rate, work.known
    for k in range(chain.length.size):
        if k == 0:
            angle[0], rate[0], known[0] = state[2], state[n + 2], 0.0
            work.front[0] = complex(state[0], state[1])
            work.speed[0] = complex(state[n], state[n + 1])
        else:
            j, p = k - 1, chain.passive[k - 1]
            if p < 0:
                angle[k] = angle[j] + joints[0, j]
                rate[k] = rate[j] + joints[1, j]
                known[k] = known[j] + joints[2, j]
            else:
                angle[k] = angle[j] + state[3 + p]
                rate[k] = rate[j] + state[n + 3 + p]
                known[k] = known[j]
            work.front[k] = work.front[j] - chain.length[j] * e[j]
            work.speed[k] = work.speed[j] - 1j * chain.length[j] * rate[j] * e[j]
        e[k] = complex(np.cos(angle[k]), np.sin(angle[k]))
        work.whirl[k] = rate[k] ** 2 * e[k]
        work.load[k] = 0.0
        work.torque[k] = 0.0


@njit(cache=True)
def apply(force, k, lever, work):  # type: ignore[no-untyped-def]
    """A force at a point of link k."""
    work.load[k] += force
    work.torque[k] += (1j * lever * work.e[k].conjugate() * force).real


@njit(cache=True)
def wave_node(where, water):  # type: ignore[no-untyped-def]
    along = where.real * water.stream_x + where.imag * water.stream_y
    return water.wave * np.cos(water.wave_number * along + water.wave_node)


@njit(cache=True)
def moving(where, t, flow, water):  # type: ignore[no-untyped-def]
    """Velocity of the water at a place."""
    stream = complex(water.stream_x, water.stream_y)
    if water.shear != 0.0:
        flow += water.shear * (where * stream.conjugate()).imag * stream
    if water.wave != 0.0:
        flow += wave_node(where, water) * np.cos(water.wave_rate * t + water.wave_phase) * stream
    return flow


@njit(cache=True)
def emerged(where, water):  # type: ignore[no-untyped-def]
    """Share of a section above the surface."""
    return 1.0 / (1.0 + np.exp(-min((where.imag - water.surface) / 0.012, 500.0)))


@njit(cache=True)
def drag(t, fin, near, flow, chain, water, work):  # type: ignore[no-untyped-def]
    """Friction and normal drag of every slice."""
    last = chain.length.size - 1
    for p in range(chain.link.size):
        k, b = chain.link[p], chain.behind[p]
        where = work.front[k] - b * work.e[k]
        through = work.speed[k] - 1j * b * work.rate[k] * work.e[k] - moving(where, t, flow, water)
        local = through * work.e[k].conjugate()
        u, w = local.real, local.imag
        fu, fw = -chain.along[p] * near * abs(u) * u, -chain.across[p] * near * abs(w) * w
        if water.slope != 0.0:
            attack = np.arctan2(w, abs(u))
            fw -= water.slope * chain.across[p] * abs(through) ** 2 * np.tanh(attack)
        if water.friction != 0.0:
            factor = friction_line(abs(through), water.friction_length, water.friction)
            fu, fw = factor * fu, factor * fw
        if k == last:
            fw *= fin * (1.0 + water.uneven * np.tanh(w / 0.02))
            fu *= fin
        force = complex(fu, fw) * work.e[k]
        if water.breach > 0.0:
            dry = emerged(where, water)
            force = (1.0 - dry) * force - 1j * water.breach * GRAVITY_M_S2 * chain.displaced[p] * dry
        apply(force, k, b, work)


@njit(cache=True)
def tail(state, out, n, fin, flow, chain, water, work):  # type: ignore[no-untyped-def]
    """The trailing edge's reactive force, and the foil's; returns the squared normal speed of the edge."""
    k = chain.length.size - 1
    e, end = work.e[k], chain.length[k]
    edge = (work.speed[k] - 1j * end * work.rate[k] * e - flow) * e.conjugate()
    if water.edge > 0.0:
        apply(complex(0.5 * edge.imag**2, -state[2 * n]) * water.edge * e, k, end, work)
    out[2 * n] = (edge.real * edge.imag - state[2 * n]) / water.edge_lag
    out[2 * n + 4] = 0.0
    if chain.foil[1] > 0.0:
        b = chain.foil[0]
        chord = e * complex(np.cos(state[2 * n + 4]), np.sin(state[2 * n + 4]))
        through = work.speed[k] - 1j * b * work.rate[k] * e - flow
        seen = through * chord.conjugate()
        attack = np.arctan2(seen.imag, seen.real)
        resistance = chain.foil[3] + chain.foil[4] * (1.0 - np.cos(2.0 * attack))
        polar = complex(resistance, chain.foil[2] * np.sin(2.0 * attack))
        force = -chain.foil[1] * fin * abs(through) * through * polar
        force *= 1.0 + water.uneven * np.tanh(seen.imag / 0.02)
        if water.breach > 0.0:
            force *= 1.0 - emerged(work.front[k] - b * e, water)
        apply(force, k, b, work)
        if water.bend > 0.0:
            out[2 * n + 4] = (
                -water.bend * (force * chord.conjugate()).imag - state[2 * n + 4]
            ) / water.bend_lag
    return edge.imag**2


@njit(cache=True)
def nose(state, out, n, gap, flow, chain, water, work, fin_speed2):  # type: ignore[no-untyped-def]
    """What acts half-way along the nose link, and the lagging states behind it."""
    half, e = 0.5 * chain.length[0], work.e[0]
    through = work.speed[0] - 1j * half * work.rate[0] * e - flow
    u, brisk = (through * e.conjugate()).real, abs(through)
    force = -water.low * (u**2 + 1e-6) ** (0.5 * (water.low_power - 1.0)) * u * e
    if water.image > 0.0:
        away = (work.front[0] - half * e) * complex(water.wall_nx, -water.wall_ny)
        touch = max(0.06 - away.real + water.wall_at, 0.0)
        force += (400.0 * touch - water.image * u**2 / gap**2) * complex(water.wall_nx, water.wall_ny)
    if water.line > 0.0:
        away = work.front[0] - half * e - complex(water.anchor_x, water.anchor_y)
        span = abs(away)
        force -= water.line * away / (1.0 + span / water.line_span)
        force -= water.line_drag * span * brisk * through
    side = 0.5 * WATER_KG_M3 * 0.01 * brisk**2 * np.sin(state[2 * n + 1])
    force += (1j * water.shed * side + water.memory * state[2 * n + 2]) * e + 1j * water.lift
    apply(force, 0, half, work)
    work.torque[0] -= water.righting * np.sin(work.angle[0])
    out[2 * n + 1] = water.shed_rate * brisk
    out[2 * n + 2] = state[2 * n + 3]
    out[2 * n + 3] = water.memory_rate * (
        water.memory_rate * (fin_speed2 - state[2 * n + 2]) - 2.0 * water.memory_damping * state[2 * n + 3]
    )


@njit(cache=True)
def assemble(carried, chain, work):  # type: ignore[no-untyped-def]
    """Mass matrix and right side over (nose, all angles); ``carried`` is the acceleration of the water."""
    links = chain.length.size
    matrix, e = work.matrix, work.e
    matrix[:, :] = 0.0
    matrix[0, 0] = matrix[1, 1] = chain.mass
    push = chain.mass * carried
    behind = 0.0j
    for k in range(links - 1, -1, -1):
        push += work.load[k] - chain.moment[k] * work.whirl[k]
        twist = chain.moment[k].conjugate() * carried + chain.length[k] * behind
        behind += work.load[k]
        for j in range(links):
            twist -= chain.coupling[k, j].conjugate() * work.whirl[j]
            matrix[2 + k, 2 + j] = (chain.coupling[k, j] * e[k] * e[j].conjugate()).real
        matrix[2 + k, 2 + k] += chain.inertia[k]
        arm = chain.moment[k] * e[k]
        matrix[0, 2 + k] = matrix[2 + k, 0] = arm.imag
        matrix[1, 2 + k] = matrix[2 + k, 1] = -arm.real
        work.right[2 + k] = work.torque[k] + (1j * e[k].conjugate() * twist).real
    work.right[0], work.right[1] = push.real, push.imag


@njit(cache=True)
def add_lateral(chain, work):  # type: ignore[no-untyped-def]
    """Water that follows only the normal motion of a point."""
    links = chain.length.size
    e, whirl, normals = work.e, work.whirl, work.normals
    for p in range(chain.lateral_link.size):
        k, b, mass = chain.lateral_link[p], chain.lateral_behind[p], chain.lateral_mass[p]
        back = e[k].conjugate()
        local = (work.speed[k] - 1j * b * work.rate[k] * e[k]) * back
        normals[0], normals[1] = -e[k].imag, e[k].real
        centripetal = 0.0j
        for j in range(links):
            lever = chain.length[j] if j < k else (b if j == k else 0.0)
            normals[2 + j] = -lever * (back * e[j]).real
            centripetal += lever * whirl[j]
        drift = (back * centripetal).imag - work.rate[k] * local.real
        force = -mass * (1j * drift - local.imag * work.rate[k])
        for i in range(2 + links):
            for j in range(2 + links):
                work.matrix[i, j] += mass * normals[i] * normals[j]
        work.right[0] += (force * e[k]).real
        work.right[1] += (force * e[k]).imag
        for j in range(k + 1):
            lever = chain.length[j] if j < k else b
            work.right[2 + j] += (1j * lever * e[j].conjugate() * force * e[k]).real
        work.right[2 + k] -= mass * local.imag * local.real


@njit(cache=True)
def reduce(chain, work):  # type: ignore[no-untyped-def]
    """Accelerations of the free coordinates, into ``work.answer``."""
    links, n = chain.length.size, work.answer.size
    matrix, spread, reduced, answer = work.matrix, work.spread, work.reduced, work.answer
    reduced[:, :] = 0.0
    answer[:] = 0.0
    for i in range(2 + links):
        right = work.right[i]
        for k in range(links):
            right -= matrix[i, 2 + k] * work.known[k]
        for a in range(n):
            answer[a] += spread[i, a] * right
        for c in range(n):
            total = 0.0
            for j in range(2 + links):
                total += matrix[i, j] * spread[j, c]
            for a in range(n):
                reduced[a, c] += spread[i, a] * total
    solve(reduced, answer, n)


@njit(cache=True)
def derivative(t, state, out, joints, flow, carried, chain, water, work):  # type: ignore[no-untyped-def]
    """Rate of change of the state; ``joints`` holds angle, rate and acceleration of every joint."""
    n = 3 + chain.laws.shape[0]
    place(state, joints, chain, work)
    middle = work.front[0] - 0.5 * chain.length[0] * work.e[0]
    gap = middle.real * water.wall_nx + middle.imag * water.wall_ny - water.wall_at
    gap = 0.10 + 0.05 * np.log1p(np.exp(min((gap - 0.10) / 0.05, 500.0)))
    near = 1.0 + water.image_drag / gap**2
    fin = water.thrust * (1.0 - 0.5 * water.torn * (1.0 + np.tanh((t - water.torn_at) / 0.1)))
    drag(t, fin, near, flow, chain, water, work)
    there = moving(middle, t, flow, water)
    fin_speed2 = tail(state, out, n, fin, there, chain, water, work)
    nose(state, out, n, gap, there, chain, water, work, fin_speed2)
    if water.wave != 0.0:
        beat = -water.wave_rate * np.sin(water.wave_rate * t + water.wave_phase)
        carried += wave_node(middle, water) * beat * complex(water.stream_x, water.stream_y)
    for j in range(chain.passive.size):
        p = chain.passive[j]
        if p >= 0:
            spring = passive_torque(chain.laws[p], state[3 + p], state[n + 3 + p])
            work.torque[j + 1] += spring
            work.torque[j] -= spring
    assemble(carried, chain, work)
    add_lateral(chain, work)
    reduce(chain, work)
    for a in range(n):
        out[a] = state[n + a]
        out[n + a] = work.answer[a]


@njit(cache=True)
def integrate(first, step, joints, flow, carried, chain, water, work):  # type: ignore[no-untyped-def]
    """States at every whole step, shape (steps + 1, states).

    ``joints`` (2 steps + 1, 3, joints), ``flow`` and ``carried`` (2 steps + 1), velocity and acceleration
    of the water as complex numbers, lie on the half-step grid; `Water` holds what depends on the place.
    """
    steps = (joints.shape[0] - 1) // 2
    found = np.empty((steps + 1, first.size))
    found[0] = first
    k1, k2, k3 = np.zeros_like(first), np.zeros_like(first), np.zeros_like(first)
    for i in range(steps):
        a, y, t = 2 * i, found[i], step * i
        derivative(t, y, k1, joints[a], flow[a], carried[a], chain, water, work)
        mid, b, c = t + 0.5 * step, a + 1, a + 2
        derivative(mid, y + 0.5 * step * k1, k2, joints[b], flow[b], carried[b], chain, water, work)
        far = y - step * k1 + 2.0 * step * k2
        derivative(t + step, far, k3, joints[c], flow[c], carried[c], chain, water, work)
        found[i + 1] = y + step / 6.0 * (k1 + 4.0 * k2 + k3)
    return found
