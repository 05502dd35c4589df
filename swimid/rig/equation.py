"""The equation of one degree of freedom, integrated: compiled kernels of the rig.

``M (v' - w') = F - dry sgn(v) - linear (v - w) - quadratic (v - w) |v - w| - R(x - rest)``

with the velocity ``w`` of the water and the restoring force
``R(d) = stiffness d + gravity sin(d) + cubic d^3``;
``gravity`` is m g l of a pendulum. Water that accelerates carries along the body and the water that moves
with it, as it does a neutrally buoyant body. At rest in still water it is Eqs 7 and 8 of the boxfish paper.
"""

from __future__ import annotations

import math

import numba
import numpy as np

#: Stops and breakaways within one integration step, at most.
MOST_EVENTS = 8


@numba.njit(cache=True, nogil=True)
def breakaway(push, slope, dry, left):  # type: ignore[no-untyped-def]
    """When a body at rest overcomes its dry friction, and to which side (0 where it stays).

    Parameters
    ----------
    push, slope : float
        Net force on it now, friction apart, and the rate at which that changes.
    dry : float
        Largest force that friction withstands.
    left : float, s
        How far to look, and the answer where it stays.

    >>> breakaway(0.5, 2.0, 1.0, 1.0)
    (0.25, 1.0)
    """
    if abs(push) > dry:
        return 0.0, (1.0 if push > 0 else -1.0)
    if slope == 0.0:
        return left, 0.0
    side = 1.0 if slope > 0 else -1.0
    after = (side * dry - push) / slope
    return (after, side) if after < left else (left, 0.0)


@numba.njit(cache=True, nogil=True)
def restoring(x, c):  # type: ignore[no-untyped-def]
    """Return the restoring force at a displacement, for the coefficients of the equation of motion."""
    _, _, _, _, stiffness, rest, gravity, cubic = c
    away = x - rest
    pull = stiffness * away
    if gravity != 0.0:
        pull += gravity * math.sin(away)
    if cubic != 0.0:
        pull += cubic * away * away * away
    return pull


# In still water without further forces ``extra`` is None: numba then compiles these functions without them.


@numba.njit(cache=True, nogil=True)
def _acceleration(t, x, v, side, force, w, dw, c, extra):  # type: ignore[no-untyped-def]
    inertia, quadratic, linear, dry, _, _, _, _ = c
    if extra is None:
        push = force - linear * v - quadratic * v * abs(v) - restoring(x, c)
        return (push - dry * side) / inertia
    through = v - w
    scratch, acting, (c1, f1), (c2, f2), (c3, f3), (c4, f4) = extra
    pose, velocity, wrench = scratch[0], scratch[1], scratch[2]
    pose[0], velocity[0], velocity[2], wrench[0] = x, through, v, 0.0
    if acting > 0:
        f1(t, pose, velocity, c1, wrench)
    if acting > 1:
        f2(t, pose, velocity, c2, wrench)
    if acting > 2:
        f3(t, pose, velocity, c3, wrench)
    if acting > 3:
        f4(t, pose, velocity, c4, wrench)
    push = force + wrench[0] - linear * through - quadratic * through * abs(through) - restoring(x, c)
    return (push - dry * side) / inertia + dw


@numba.njit(cache=True, nogil=True)
def _rk4(t, x, v, side, h, f0, f1, w0, dw, c, extra):  # type: ignore[no-untyped-def]
    fm, wm, w1 = 0.5 * (f0 + f1), w0 + 0.5 * h * dw, w0 + h * dw
    mid = t + 0.5 * h
    a1 = _acceleration(t, x, v, side, f0, w0, dw, c, extra)
    v2 = v + 0.5 * h * a1
    a2 = _acceleration(mid, x + 0.5 * h * v, v2, side, fm, wm, dw, c, extra)
    v3 = v + 0.5 * h * a2
    a3 = _acceleration(mid, x + 0.5 * h * v2, v3, side, fm, wm, dw, c, extra)
    v4 = v + h * a3
    a4 = _acceleration(t + h, x + h * v3, v4, side, f1, w1, dw, c, extra)
    return x + h * (v + 2.0 * v2 + 2.0 * v3 + v4) / 6.0, v + h * (a1 + 2.0 * a2 + 2.0 * a3 + a4) / 6.0


@numba.njit(cache=True, nogil=True)
def _with_friction(t, x, v, h, f0, f1, w0, dw, c, extra):  # type: ignore[no-untyped-def]
    """One step under dry friction, cut where the body stops and where it moves again."""
    inertia, dry = c[0], c[3]
    slope = (f1 - f0) / h
    done = 0.0
    for _ in range(MOST_EVENTS):
        f, w = f0 + slope * done, w0 + dw * done
        if v == 0.0:
            left = h - done
            if extra is None:
                after, side = breakaway(f - restoring(x, c), slope, dry, left)
            else:
                # forces of other kinds are taken as linear in what is left of the step
                push = inertia * _acceleration(t + done, x, v, 0.0, f, w, dw, c, extra)
                end = inertia * _acceleration(t + h, x, v, 0.0, f1, w0 + dw * h, dw, c, extra)
                after, side = breakaway(push, (end - push) / left, dry, left)
            if side == 0.0:
                return x, v
            done += after
            f, w = f0 + slope * done, w0 + dw * done
        else:
            side = 1.0 if v > 0 else -1.0
        left = h - done
        x1, v1 = _rk4(t + done, x, v, side, left, f, f1, w, dw, c, extra)
        if v1 * side >= 0.0:
            return x1, v1
        low, high = 0.0, left
        cut = left * v / (v - v1) if v != 0.0 else 0.5 * left
        for _ in range(40):
            x1, v1 = _rk4(t + done, x, v, side, cut, f, f + slope * cut, w, dw, c, extra)
            if v1 * side > 0:
                low = cut
            else:
                high = cut
            if high - low < 1e-14:
                break
            cut = 0.5 * (low + high)
        x, v = x1, 0.0
        done += cut
        if h - done <= 1e-14:
            break
    return x, v


@numba.njit(cache=True, nogil=True)
def _run(time, start, max_step, force, c, x0, v0, water, extra):  # type: ignore[no-untyped-def]
    n = len(time)
    positions, speeds = np.empty(n), np.empty(n)
    x, v, now = x0, v0, start
    constant = len(force) == 1
    at = 0
    for i in range(n):
        if time[i] > now:
            before = force[0] if constant or i == 0 else force[i - 1]
            after = force[0] if constant else force[i]
            width = time[i] - now
            steps = max(1, math.ceil(width / max_step - 1e-9))
            h = width / steps
            for j in range(steps):
                t = now + j * h
                f0 = before + (after - before) * (j / steps)
                f1 = before + (after - before) * ((j + 1) / steps)
                w0, dw = 0.0, 0.0
                if extra is not None:
                    w0, dw = water[at], (water[at + 1] - water[at]) / h
                    at += 1
                if c[3] == 0.0:
                    x, v = _rk4(t, x, v, 0.0, h, f0, f1, w0, dw, c, extra)
                else:
                    x, v = _with_friction(t, x, v, h, f0, f1, w0, dw, c, extra)
            now = time[i]
        positions[i], speeds[i] = x, v
    return positions, speeds


@numba.njit(cache=True, nogil=True)
def integrate(  # type: ignore[no-untyped-def]
    time,
    start,
    max_step,
    force,
    inertia,
    quadratic,
    linear,
    dry,
    stiffness,
    rest,
    x0,
    v0,
    gravity=0.0,
    cubic=0.0,
):
    """Return positions and speeds at given times, by fixed-step fourth-order Runge-Kutta.

    Parameters
    ----------
    time : ndarray, shape (n,), s
        Increasing. Samples before ``start`` hold the initial state.
    start : float, s
        Time of release.
    max_step : float, s
        Each interval between samples is cut into equal steps no longer than this, so that
        the steps do not depend on the parameters and finite differences stay smooth.
    force : ndarray, shape (n,) or (1,)
        Applied force at the samples (linear in between), or one constant value.
    inertia, quadratic, linear, dry, stiffness, rest, gravity, cubic : float
        Coefficients of the equation of motion.
    x0, v0 : float
        Initial position and speed.

    Returns
    -------
    x, v : ndarray, shape (n,)

    Notes
    -----
    Dry friction holds its sign within a step; a step in which the speed would change sign is
    cut at the reversal, where the body sticks while the net force is below the friction, and where
    it moves again. Both instants move with the parameters: kept to the grid of steps, the
    motion would be a staircase of the friction, and its derivative wrong.
    """
    c = (inertia, quadratic, linear, dry, stiffness, rest, gravity, cubic)
    return _run(time, start, max_step, force, c, x0, v0, None, None)


@numba.njit(cache=True, nogil=True)
def integrate_forced(  # type: ignore[no-untyped-def]
    time, start, max_step, force, water, x0, v0, c, acting, f1, c1, f2, c2, f3, c3, f4, c4
):
    """As :func:`integrate`, in moving water and under forces that depend on the motion.

    Parameters
    ----------
    water : ndarray, shape (steps + 1,), m/s
        Velocity of the water at :func:`step_ends`, linear in between.
    c : tuple of float
        Inertia, quadratic drag, linear drag, dry friction, stiffness, rest position, gravity stiffness and
        cubic stiffness.
    acting : int
        How many of the forces act.
    f1, c1, f2, c2, f3, c3, f4, c4
        Compiled forces (:class:`swimid.fitting.hooks.Force`) and their constants.
    """
    extra = (np.zeros((3, 3)), acting, (c1, f1), (c2, f2), (c3, f3), (c4, f4))
    return _run(time, start, max_step, force, c, x0, v0, water, extra)


@numba.njit(cache=True, nogil=True)
def step_ends(time, start, max_step):  # type: ignore[no-untyped-def]
    """Where the steps of :func:`integrate` begin and end, from the release on, s.

    >>> step_ends(np.array([-1.0, 0.1, 0.15]), 0.0, 0.05)
    array([0.  , 0.05, 0.1 , 0.15])
    """
    ends, now = [start], start
    for t in time:
        if t > now:
            steps = max(1, math.ceil((t - now) / max_step - 1e-9))
            h = (t - now) / steps
            for j in range(1, steps):
                ends.append(now + j * h)
            ends.append(t)
            now = t
    return np.array(ends)


@numba.njit(cache=True, nogil=True)
def falling_weight_closed_form(time, start, inertia, quadratic, force):  # type: ignore[no-untyped-def]
    """Displacement (m) and speed (m/s) of a body pulled from rest by a constant force, at ``time`` (s).

    Parameters
    ----------
    inertia : float, kg
        M of Eq 8.
    quadratic : float, N s2/m2
        ``rho C_d A / 2``; zero is allowed.
    force : float, N
        Net force ``m_w g - f_c``; the body stays where it is when it is not positive.

    Notes
    -----
    Eqs 9 and 10 of the boxfish paper. (Its Eq 14 misprints the argument: it is
    ``sqrt(a1 a2) t``, not ``sqrt(a1 a2 t)``.)

    >>> x, v = falling_weight_closed_form(np.array([100.0]), 0.0, 2.0, 4.0, 1.0)
    >>> float(v[0])
    0.5
    """
    x = np.zeros(len(time))
    v = np.zeros(len(time))
    if force <= 0.0:
        return x, v
    a1 = quadratic / inertia
    a2 = force / inertia
    rate = math.sqrt(a1 * a2)
    for i in range(len(time)):
        t = max(time[i] - start, 0.0)
        phi = rate * t
        if phi < 1e-4:
            # series of ln cosh and tanh: no division by a vanishing drag
            x[i] = 0.5 * a2 * t * t * (1.0 - phi * phi / 6.0)
            v[i] = a2 * t * (1.0 - phi * phi / 3.0)
        else:
            # one exponential serves ln cosh, without overflow, and tanh
            decay = math.exp(-2.0 * phi)
            x[i] = (phi + math.log1p(decay) - math.log(2.0)) / a1
            v[i] = math.sqrt(a2 / a1) * (1.0 - decay) / (1.0 + decay)
    return x, v


def warm_up() -> None:
    """Compile the kernels of this module."""
    time = np.array([0.0, 0.1])
    integrate(time, 0.0, 0.1, np.array([1.0]), 1.0, 1.0, 1.0, 0.1, 1.0, 0.0, 0.0, 0.0)
    falling_weight_closed_form(time, 0.0, 1.0, 1.0, 1.0)
