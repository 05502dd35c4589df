"""The single-degree-of-freedom rig in moving water, under forces that depend on its motion.

The equation of :mod:`swimid.rig.model` with the speed ``v - w`` through the water in the drag. Water
that accelerates carries along the body and the water that moves with it, as it does a neutrally buoyant
body: ``M (v' - w') = F - dry sgn(v) - linear (v - w) - quadratic (v - w) |v - w| - stiffness (x - rest)``.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from swimid.rig.dry_friction import MOST_EVENTS, breakaway


@numba.njit(cache=True, nogil=True)
def step_ends(time, start, max_step):  # type: ignore[no-untyped-def]
    """Where the steps of :func:`integrate_forced` begin and end, from the release on.

    Parameters
    ----------
    time : ndarray, shape (n,), s
    start, max_step : float, s

    Returns
    -------
    ndarray, shape (steps + 1,), s

    >>> step_ends(np.array([-1.0, 0.1, 0.15]), 0.0, 0.05)
    array([0.  , 0.05, 0.1 , 0.15])
    """
    count, now = 1, start
    for t in time:
        if t > now:
            count += max(1, math.ceil((t - now) / max_step - 1e-9))
            now = t
    ends = np.empty(count)
    ends[0] = now = start
    k = 0
    for t in time:
        if t > now:
            steps = max(1, math.ceil((t - now) / max_step - 1e-9))
            h = (t - now) / steps
            for j in range(steps - 1):
                ends[k + 1 + j] = now + (j + 1) * h
            k += steps
            ends[k] = now = t
    return ends


@numba.njit(cache=True, nogil=True)
def _acceleration(t, x, v, side, force, w, dw, c, extra, scratch):  # type: ignore[no-untyped-def]
    inertia, quadratic, linear, dry, stiffness, rest = c
    through = v - w
    pose, velocity, wrench = scratch[0], scratch[1], scratch[2]
    pose[0], velocity[0], wrench[0] = x, through, 0.0
    acting, (c1, f1), (c2, f2), (c3, f3), (c4, f4) = extra
    if acting > 0:
        f1(t, pose, velocity, c1, wrench)
    if acting > 1:
        f2(t, pose, velocity, c2, wrench)
    if acting > 2:
        f3(t, pose, velocity, c3, wrench)
    if acting > 3:
        f4(t, pose, velocity, c4, wrench)
    push = force + wrench[0] - linear * through - quadratic * through * abs(through) - stiffness * (x - rest)
    return (push - dry * side) / inertia + dw


@numba.njit(cache=True, nogil=True)
def _rk4(t, x, v, side, h, f0, f1, w0, dw, c, extra, scratch):  # type: ignore[no-untyped-def]
    fm, wm, w1 = 0.5 * (f0 + f1), w0 + 0.5 * h * dw, w0 + h * dw
    mid = t + 0.5 * h
    a1 = _acceleration(t, x, v, side, f0, w0, dw, c, extra, scratch)
    v2 = v + 0.5 * h * a1
    a2 = _acceleration(mid, x + 0.5 * h * v, v2, side, fm, wm, dw, c, extra, scratch)
    v3 = v + 0.5 * h * a2
    a3 = _acceleration(mid, x + 0.5 * h * v2, v3, side, fm, wm, dw, c, extra, scratch)
    v4 = v + h * a3
    a4 = _acceleration(t + h, x + h * v3, v4, side, f1, w1, dw, c, extra, scratch)
    return x + h * (v + 2.0 * v2 + 2.0 * v3 + v4) / 6.0, v + h * (a1 + 2.0 * a2 + 2.0 * a3 + a4) / 6.0


@numba.njit(cache=True, nogil=True)
def _with_friction(t, x, v, h, f0, f1, w0, dw, c, extra, scratch):  # type: ignore[no-untyped-def]
    """One step under dry friction, cut where the body stops and where it gets loose again."""
    inertia, dry = c[0], c[3]
    slope = (f1 - f0) / h
    done = 0.0
    for _ in range(MOST_EVENTS):
        f, w = f0 + slope * done, w0 + dw * done
        if v == 0.0:
            # forces of other kinds are taken as linear in what is left of the step
            left = h - done
            push = inertia * _acceleration(t + done, x, v, 0.0, f, w, dw, c, extra, scratch)
            end = inertia * _acceleration(t + h, x, v, 0.0, f1, w0 + dw * h, dw, c, extra, scratch)
            after, side = breakaway(push, (end - push) / left, dry, left)
            if side == 0.0:
                return x, v
            done += after
            f, w = f0 + slope * done, w0 + dw * done
        else:
            side = 1.0 if v > 0 else -1.0
        left = h - done
        x1, v1 = _rk4(t + done, x, v, side, left, f, f1, w, dw, c, extra, scratch)
        if v1 * side >= 0.0:
            return x1, v1
        low, high = 0.0, left
        cut = left * v / (v - v1) if v != 0.0 else 0.5 * left
        for _ in range(40):
            x1, v1 = _rk4(t + done, x, v, side, cut, f, f + slope * cut, w, dw, c, extra, scratch)
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
def integrate_forced(  # type: ignore[no-untyped-def]
    time, start, max_step, force, water, x0, v0, c, acting, f1, c1, f2, c2, f3, c3, f4, c4
):
    """Positions and speeds at given times, by fixed-step fourth-order Runge-Kutta.

    Parameters
    ----------
    time : ndarray, shape (n,), s
        Increasing. Samples before ``start`` hold the initial state.
    start, max_step : float, s
        Time of release; longest step.
    force : ndarray, shape (n,) or (1,), N
        Applied force at the samples (linear in between), or one constant value.
    water : ndarray, shape (steps + 1,), m/s
        Velocity of the water at :func:`step_ends`, linear in between.
    x0, v0 : float
        Initial position and speed.
    c : tuple of float
        Inertia, quadratic drag, linear drag, dry friction, stiffness and rest position.
    acting : int
        How many of the forces act.
    f1, c1, f2, c2, f3, c3, f4, c4
        Compiled forces (:class:`swimid.fitting.hooks.Force`) and their constants.

    Returns
    -------
    x, v : ndarray, shape (n,)
    """
    n = len(time)
    positions, speeds = np.empty(n), np.empty(n)
    scratch = np.zeros((3, 3))
    extra = (acting, (c1, f1), (c2, f2), (c3, f3), (c4, f4))
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
                f_begin = before + (after - before) * (j / steps)
                f_end = before + (after - before) * ((j + 1) / steps)
                w0, dw = water[at], (water[at + 1] - water[at]) / h
                at += 1
                if c[3] == 0.0:
                    x, v = _rk4(t, x, v, 0.0, h, f_begin, f_end, w0, dw, c, extra, scratch)
                else:
                    x, v = _with_friction(t, x, v, h, f_begin, f_end, w0, dw, c, extra, scratch)
            now = time[i]
        positions[i], speeds[i] = x, v
    return positions, speeds
