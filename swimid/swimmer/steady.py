"""Steady swimming of a robot with links: its limit cycle under a periodic drive, and its speed."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from swimid.fitting.drives import Beat, Cycle
from swimid.fitting.model import NONE, Array, Trial
from swimid.swimmer.drive import Grid, TrialCache
from swimid.swimmer.limit_cycle import LimitCycle, limit_cycle

if TYPE_CHECKING:
    from swimid.swimmer.model import Run, Swimmer

#: Maximum number of cached limit cycles.
MAX_CYCLES = 64


class Cruise(NamedTuple):
    """Steady swimming of a model.

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
    """Cache of the limit cycles of a model.

    Parameters
    ----------
    model : Swimmer
    """

    def __init__(self, model: Swimmer) -> None:
        self.model = model
        self._cycles: TrialCache[tuple[LimitCycle | None]] = TrialCache(MAX_CYCLES)
        # indices of the state entries on which the motion over a period depends
        passives, first = len(model.passive), model.coordinates + len(model.passive)
        angles = list(range(model.coordinates, first))
        rates = list(range(first + model.speeds, first + model.speeds + passives))
        self._memory = [*angles, *rates]
        if model.free_base:
            self._memory = [*model.attitude(), *angles, *range(first, first + model.speeds), *rates]

    def initial_state(self, run: Run) -> Array:
        """Return the initial state of a simulation in steady swimming; NaN if the motion never settles."""
        cycle = self._limit_cycle(run)
        start = run.start.copy()
        start[self._memory] = np.nan
        if cycle is not None:
            # integrate over at least one period, because a shorter time would give small steps
            period = 1.0 / _drive_of(run).frequency_hz
            ahead = self._since_phase_zero(run) + period
            states = self._states(run, run.grid.begin_s - ahead, cycle.state, ahead / period)
            start[self._memory] = states[-1, self._memory]
        return start

    def cruise(self, values: Array, trial: Trial) -> Cruise:
        """Return the speed at which the model settles under the periodic drive of a trial.

        Parameters
        ----------
        values : ndarray
            Parameters of the model.
        trial : Trial
            Trial of a robot in a plane with a free base.
        """
        trial = replace(trial, id=f"{trial.id} (steady)", swim=trial.swim.begun())
        run = self.model.request(values, trial, NONE)
        cycle = self._limit_cycle(run)
        if cycle is None:
            return Cruise(math.nan, math.inf)
        period = 1.0 / _drive_of(run).frequency_hz
        begin = run.grid.begin_s - self._since_phase_zero(run)
        ends = self._states(run, begin, cycle.state)[[0, -1]]
        seen = self.model.observed(values, trial, ends)
        x, y, turned = (float(np.diff(seen[name])[0]) for name in self.model.pose)
        arc = math.hypot(x, y) / float(np.sinc(turned / (2.0 * math.pi)))
        return Cruise(arc / period, -period / math.log(max(cycle.multiplier, 1e-12)))

    def _limit_cycle(self, run: Run) -> LimitCycle | None:
        """Return the limit cycle under the drive of a simulation, at phase zero of the drive.

        None if the motion never settles.
        """
        section = run.grid.begin_s - self._since_phase_zero(run)
        phases_and_starts = ("drive_phase", "initial_")
        names = [p.name for p in self.model.parameters]
        moved = [i for i in self.model.influences(run.hooks) if not names[i].startswith(phases_and_starts)]
        kind = (replace(_drive_of(run), phase_rad=0.0), run.hooks.key, self.model.max_step)
        key = (*kind, run.values[moved].tobytes())
        known, last = self._cycles.get("", key), self._cycles.get("", kind)
        if known is not None:
            return known[0]

        def period(state: Array) -> Array:
            return self._states(run, section, state)[:, self._memory]

        found = limit_cycle(period, np.zeros(len(self._memory)), near=(last or (None,))[0])
        self._cycles.put("", key, (found,))
        if found is not None:
            self._cycles.put("", kind, (found,))
        return found

    def _states(self, run: Run, begin_s: float, state: Array, periods: float = 1.0) -> Array:
        """Integrate from a state on the limit cycle over some periods of the drive, and return all states."""
        period = 1.0 / _drive_of(run).frequency_hz
        # the number of steps depends only on whole periods, so that derivatives of the result are smooth
        steps = math.floor(periods) * math.ceil(period / self.model.max_step)
        grid = Grid(begin_s, periods * period / steps, steps)
        phase = self.model.value(run.values, "drive_phase")
        motion = self.model.joints.fresh_motion(run.values, run.trial, grid, phase, run.hooks)
        start = run.start.copy()
        start[self._memory] = state
        return self.model.integrate(replace(run, grid=grid, start=start, drive=motion))[0]

    def _since_phase_zero(self, run: Run) -> float:
        """Return the time from the last phase zero of the drive to the beginning of the simulation, s."""
        drive = _drive_of(run)
        phase = drive.phase_rad + self.model.value(run.values, "drive_phase")
        cycles = drive.frequency_hz * run.grid.begin_s + phase / (2.0 * math.pi)
        return (cycles % 1.0) / drive.frequency_hz


def _drive_of(run: Run) -> Beat | Cycle:
    drive = run.trial.swim.drive
    assert drive is not None
    return drive
