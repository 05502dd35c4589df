"""Limit cycle of a periodically driven robot: the motion that repeats after each period of the drive."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from swimid.fitting.model import Array

#: Relative tolerance of the fixed point: the maximum change of the state over a period, divided by the
#: amplitude of the motion. With steps of 1e-6 of a parameter (:mod:`swimid.fitting.problem`), derivatives in
#: fits are then accurate to 1e-4.
STATE_RTOL = 1e-10
#: Numbers of periods that are simulated from rest before Newton's method, and between two attempts of
#: Newton's method.
N_FIRST_PERIODS, N_MORE_PERIODS = 20, 60
#: Maximum number of attempts of Newton's method, and maximum number of iterations per attempt.
MAX_ATTEMPTS, MAX_ITERATIONS = 8, 12
#: Maximum factor by which a perturbation changes in one period of a motion that settles. At this
#: factor the perturbation falls to 1/e in 1000 periods. A motion without damping has a factor of 1 within
#: 1e-6, which is the error of the finite differences.
MAX_MULTIPLIER = 1.0 - 1e-3
#: Step of the finite differences, as a fraction of the amplitude of the motion.
DIFFERENCE_SHARE = 1e-6


class LimitCycle(NamedTuple):
    """Fixed point of the map from the state at the beginning of a period to the state at its end.

    Attributes
    ----------
    state : ndarray, shape (m,)
        State at the beginning of the period.
    slopes : ndarray, shape (m, m)
        Derivative of the map at this state.
    """

    state: Array
    slopes: Array

    @property
    def multiplier(self) -> float:
        """Largest magnitude of an eigenvalue: the factor of the slowest perturbation in one period."""
        return float(np.max(np.abs(np.linalg.eigvals(self.slopes)), initial=0.0))


def limit_cycle(
    period: Callable[[Array], Array], begin: Array, *, near: LimitCycle | None = None
) -> LimitCycle | None:
    """Find the limit cycle to which a motion settles.

    Parameters
    ----------
    period : callable
        Function from the state at the beginning of a period, shape (m,), to the states over the period, shape
        (n, m).
    begin : ndarray, shape (m,)
        Initial state, at rest, from which the motion settles.
    near : LimitCycle, optional
        Limit cycle for slightly different parameters, from which the search starts.

    Returns
    -------
    LimitCycle or None
        None if the motion does not settle: it has no attracting limit cycle with the period of the drive.

    Notes
    -----
    After some simulated periods, Newton's method solves ``period(s) - s = 0`` for the initial state s
    (shooting; Nayfeh and Balachandran, *Applied Nonlinear Dynamics*, 1995, section 5.2). The cycle is
    attracting if every eigenvalue of the derivative (Floquet multiplier) lies inside the unit circle.

    Examples
    --------
    A state that is halved and then increased by one in every period:

    >>> found = limit_cycle(lambda s: np.array([s, 0.5 * s + 1.0]), np.zeros(1))
    >>> round(float(found.state[0]), 9), round(found.multiplier, 6)
    (2.0, 0.5)
    """
    if near is not None:
        found = _newton(period, near.state, near.slopes)
        if found is not None and found.multiplier <= MAX_MULTIPLIER:
            return found
    state = begin
    for attempt in range(MAX_ATTEMPTS):
        for _ in range(N_FIRST_PERIODS if attempt == 0 else N_MORE_PERIODS):
            state = period(state)[-1]
        if not np.isfinite(state).all():
            return None
        found = _newton(period, state, None)
        if found is not None and found.multiplier <= MAX_MULTIPLIER:
            return found
    return None


def _newton(period: Callable[[Array], Array], state: Array, slopes: Array | None) -> LimitCycle | None:
    """Return the fixed point near a state by Newton's method; None if the iteration diverges."""
    before = np.inf
    for _ in range(MAX_ITERATIONS):
        states = period(state)
        if not np.isfinite(states).all():
            return None
        size = np.maximum(np.max(np.abs(states), axis=0, initial=0.0), 1e-12)
        miss = states[-1] - state
        error = float(np.max(np.abs(miss) / size, initial=0.0))
        if slopes is None or (error > STATE_RTOL and error > 0.1 * before):
            slopes = _slopes(period, state, states[-1], DIFFERENCE_SHARE * size)
            if not np.isfinite(slopes).all():
                return None
        if error <= STATE_RTOL:
            return LimitCycle(state, slopes)
        before = error
        try:
            state = state - np.linalg.solve(slopes - np.eye(len(state)), miss)
        except np.linalg.LinAlgError:
            return None
    return None


def _slopes(period: Callable[[Array], Array], state: Array, end: Array, steps: Array) -> Array:
    """Return the derivative of the map over one period, by forward differences."""
    columns = [(period(state + step)[-1] - end) / np.max(step) for step in np.diag(steps)]
    return np.array(columns).T.reshape(len(state), len(state))
