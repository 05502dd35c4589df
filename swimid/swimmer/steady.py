"""Steady swimming of a robot with links: its limit cycle under a periodic drive, and its speed."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from swimid.fitting.drives import Cycle, TailBeat
from swimid.fitting.model import Array, Hooks, Trial
from swimid.swimmer.drive import Grid, TrialCache

if TYPE_CHECKING:
    from swimid.swimmer.model import SimulationRequest, Swimmer


#: Relative tolerance of the fixed point: the maximum change of the state over a period, divided by the
#: amplitude of the motion. With steps of 1e-6 of a parameter (:mod:`swimid.fitting.problem`), derivatives in
#: fits are then accurate to 1e-4.
STATE_RTOL = 1e-10
#: Number of periods that are simulated from rest before Newton's method (N_FIRST_PERIODS), and between two
#: attempts of Newton's method (N_MORE_PERIODS).
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
    """Limit cycle of a periodically driven motion.

    The cycle is the fixed point of the map from the state at the beginning of a period to the state at its
    end.

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
        """Factor by which the slowest perturbation changes in one period.

        The factor is the largest magnitude of an eigenvalue of :attr:`slopes`.
        """
        return float(np.max(np.abs(np.linalg.eigvals(self.slopes)), initial=0.0))


def limit_cycle(
    period: Callable[[Array], Array], begin: Array, *, near: LimitCycle | None = None
) -> LimitCycle | None:
    """Find the limit cycle to which a periodically driven motion settles.

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
    """Return the limit cycle near a state by Newton's method; None if the iteration does not converge."""
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
    """Return the derivative of the state after one period with respect to the state at its beginning.

    The derivative is computed by forward differences.
    """
    columns = [(period(state + step)[-1] - end) / np.max(step) for step in np.diag(steps)]
    return np.array(columns).T.reshape(len(state), len(state))


#: Maximum number of cached limit cycles.
MAX_CYCLES = 64


class SteadySpeed(NamedTuple):
    """Speed of a model in steady swimming, and time in which it settles.

    Attributes
    ----------
    speed_m_s : float
        Length of the path over one period of the drive, divided by the period; NaN if the motion never
        settles.
    settling_s : float
        Time in which a deviation from steady swimming falls to 1/e; infinite if the motion never settles.
    """

    speed_m_s: float
    settling_s: float


class SteadySwimming:
    """Computation of the steady swimming of a model, with a cache of its limit cycles.

    Parameters
    ----------
    model : Swimmer
    """

    def __init__(self, model: Swimmer) -> None:
        self.model = model
        self._cycles: TrialCache[tuple[LimitCycle | None]] = TrialCache(MAX_CYCLES)

    def initial_state(self, run: SimulationRequest) -> Array:
        """Return the initial state of a simulation in steady swimming; NaN if the motion never settles."""
        cycle = self._limit_cycle(run)
        if cycle is None:
            return np.full_like(run.start, np.nan)
        # integrate over at least one period, because a shorter time would give small steps
        period = 1.0 / _drive_of(run).frequency_hz
        ahead = self._since_phase_zero(run) + period
        states = self._states(run, run.grid.begin_s - ahead, cycle.state, ahead / period)
        return self.model.with_cycle_state(run.start, self.model.cycle_states(states[-1:])[0])

    def cruise(self, values: Array, trial: Trial, hooks: Hooks) -> SteadySpeed:
        """Return the speed at which the model settles under the periodic drive of a trial, with effects.

        The speed is that through the water.

        Parameters
        ----------
        values : ndarray
            Parameters of the model.
        trial : Trial
            Trial of a robot with a free base.
        """
        trial = replace(trial, id=f"{trial.id} (steady)", swim=trial.swim.make_steady())
        run = self.model.request(values, trial, hooks)
        cycle = self._limit_cycle(run)
        if cycle is None:
            return SteadySpeed(math.nan, math.inf)
        period = 1.0 / _drive_of(run).frequency_hz
        begin = run.grid.begin_s - self._since_phase_zero(run)
        ends = self._states(run, begin, cycle.state)[[0, -1]]
        seen = self.model.observe(values, trial, ends)
        *way, turned = (float(np.diff(np.unwrap(seen[name]))[0]) for name in self.model.course)
        arc = math.hypot(*way[:2]) / float(np.sinc(turned / (2.0 * math.pi)))
        return SteadySpeed(
            math.hypot(arc, *way[2:]) / period, -period / math.log(max(cycle.multiplier, 1e-12))
        )

    def _limit_cycle(self, run: SimulationRequest) -> LimitCycle | None:
        """Return the limit cycle under the drive of a simulation, with its state at phase zero of the drive.

        Return None if the motion never settles.
        """
        section = run.grid.begin_s - self._since_phase_zero(run)
        phases_and_starts = ("drive_phase", "initial_")
        names = [p.name for p in self.model.parameters]
        moved = [i for i in self.model.influences(run.hooks) if not names[i].startswith(phases_and_starts)]
        kind = (repr(replace(_drive_of(run), phase_rad=0.0)), run.hooks.key, self.model.max_step)
        key = (*kind, run.values[moved].tobytes())
        known, last = self._cycles.get("", key), self._cycles.get("", kind)
        if known is not None:
            return known[0]

        def period(state: Array) -> Array:
            return self.model.cycle_states(self._states(run, section, state))

        at_rest = np.zeros(self.model.cycle_states(run.start[None]).shape[1])
        found = limit_cycle(period, at_rest, near=(last or (None,))[0])
        self._cycles.put("", key, (found,))
        if found is not None:
            self._cycles.put("", kind, (found,))
        return found

    def _states(self, run: SimulationRequest, begin_s: float, state: Array, periods: float = 1.0) -> Array:
        """Integrate from a state on the limit cycle over some periods of the drive, and return all states."""
        period = 1.0 / _drive_of(run).frequency_hz
        # the number of steps depends only on whole periods, so that derivatives of the result are smooth
        steps = math.floor(periods) * math.ceil(period / self.model.max_step)
        grid = Grid(begin_s, periods * period / steps, steps)
        phase = self.model.value(run.values, "drive_phase")
        motion = self.model.joints.motion(run.values, run.trial, grid, phase, run.hooks, cached=False)
        start = self.model.with_cycle_state(run.start, state)
        moved = run._replace(grid=grid, start=start, drive=motion)
        ((_, (states, _)),) = self.model.integrate_many({0: moved})
        return states

    def _since_phase_zero(self, run: SimulationRequest) -> float:
        """Return the time from the last phase zero of the drive to the beginning of the simulation, s."""
        drive = _drive_of(run)
        phase = drive.phase_rad + self.model.value(run.values, "drive_phase")
        cycles = drive.frequency_hz * run.grid.begin_s + phase / (2.0 * math.pi)
        return (cycles % 1.0) / drive.frequency_hz


def _drive_of(run: SimulationRequest) -> TailBeat | Cycle:
    drive = run.trial.swim.drive
    assert drive is not None
    return drive
