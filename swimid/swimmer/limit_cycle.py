"""Limit cycle of a periodically driven robot: the state that one period of the drive maps onto itself."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from swimid.fitting.model import Array

#: Tolerance of the fixed point, relative to the size of the motion. Fits take differences over steps of 1e-6
#: of a parameter (:mod:`swimid.fitting.problem`); with this tolerance their derivatives are accurate to 1e-4.
STATE_RTOL = 1e-10
#: Periods simulated from rest before Newton's method, and between two of its attempts.
FIRST_PERIODS, MORE_PERIODS = 20, 60
#: Maximum numbers of attempts and of Newton iterations in one.
MAX_ATTEMPTS, MAX_ITERATIONS = 8, 12
#: Largest size of a perturbation after one period, relative to its size before, that counts as settling: the
#: perturbation then falls by 1/e in 1000 periods. Motion without damping has 1 within 1e-6, the error of the
#: differences.
LARGEST_MULTIPLIER = 1.0 - 1e-3


class LimitCycle(NamedTuple):
    """A fixed point of the map over one period.

    Attributes
    ----------
    state : ndarray, shape (m,)
        At the beginning of the period.
    slopes : ndarray, shape (m, m)
        Derivative of the map there.
    """

    state: Array
    slopes: Array

    @property
    def multiplier(self) -> float:
        """Largest magnitude of an eigenvalue of the derivative: what one period leaves of a perturbation."""
        return float(np.max(np.abs(np.linalg.eigvals(self.slopes)), initial=0.0))


def limit_cycle(
    period: Callable[[Array], Array], begin: Array, *, near: LimitCycle | None = None
) -> LimitCycle | None:
    """Find the limit cycle that a motion settles on.

    Parameters
    ----------
    period : callable
        From the state at the beginning of a period, shape (m,), to the states over it, shape (n, m).
    begin : ndarray, shape (m,)
        State from which the motion settles: at rest.
    near : LimitCycle, optional
        Limit cycle for slightly different parameters, from which the search starts.

    Returns
    -------
    LimitCycle or None
        None where the motion does not settle: it has no attracting limit cycle of the drive's period.

    Notes
    -----
    Newton's method on ``period(s) - s = 0``, after some simulated periods (shooting; Nayfeh and Balachandran,
    *Applied Nonlinear Dynamics*, 1995, section 5.2). The cycle attracts where every eigenvalue of the
    derivative (Floquet multiplier) lies inside the unit circle.

    Examples
    --------
    A state that halves in every period and gains one:

    >>> found = limit_cycle(lambda s: np.array([s, 0.5 * s + 1.0]), np.zeros(1))
    >>> round(float(found.state[0]), 9), round(found.multiplier, 6)
    (2.0, 0.5)
    """
    if near is not None:
        found = _newton(period, near.state, near.slopes)
        if found is not None and found.multiplier <= LARGEST_MULTIPLIER:
            return found
    state = begin
    for attempt in range(MAX_ATTEMPTS):
        for _ in range(FIRST_PERIODS if attempt == 0 else MORE_PERIODS):
            state = period(state)[-1]
        if not np.isfinite(state).all():
            return None
        found = _newton(period, state, None)
        if found is not None and found.multiplier <= LARGEST_MULTIPLIER:
            return found
    return None


def _newton(period: Callable[[Array], Array], state: Array, slopes: Array | None) -> LimitCycle | None:
    """Fixed point near a state; None where the iteration diverges."""
    before = np.inf
    for _ in range(MAX_ITERATIONS):
        states = period(state)
        if not np.isfinite(states).all():
            return None
        size = np.maximum(np.max(np.abs(states), axis=0, initial=0.0), 1e-12)
        miss = states[-1] - state
        error = float(np.max(np.abs(miss) / size, initial=0.0))
        if slopes is None or (error > STATE_RTOL and error > 0.1 * before):
            slopes = _slopes(period, state, states[-1], 1e-6 * size)
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
    """Derivative of the map over one period, by forward differences."""
    columns = [(period(state + step)[-1] - end) / np.max(step) for step in np.diag(steps)]
    return np.array(columns).T.reshape(len(state), len(state))
