"""Quantities of a simulated swimming run, for ``simulate``, ``map``, ``optimise`` and ``sensitivity``.

The quantities are defined in :mod:`swimid.logs.kinematics`. This module samples a run so that it ends in
whole cycles, and adds the quantities that need the model: amplitudes of passive joints, tail excursion,
power.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from swimid.fitting.model import Array, SwimInput, Trial
from swimid.logs import kinematics
from swimid.logs.kinematics import PER_CYCLE, QUANTITIES, Window
from swimid.results import numbers
from swimid.simulation.catalogue import Quantity
from swimid.swimmer.model import Energetics, Swimmer
from swimid.swimmer.planar.model import Body


def quantity(name: str, value: float) -> Quantity:
    """Return a quantity with the unit that :data:`swimid.logs.kinematics.QUANTITIES` has for it."""
    return Quantity(value, QUANTITIES[name].unit)


def value_text(value: float | None, unit: str, sd: float | None = None, *, digits: int = 3) -> str:
    """Return a value as text, with its unit and any standard deviation. Angles are in degrees."""
    factor, shown = numbers.in_degrees(unit)
    if value is None:
        return numbers.number(None)
    if sd:
        return numbers.measured(factor * value, factor * sd, shown)
    return numbers.number(factor * value, digits, shown)


def units_of(model: Swimmer) -> dict[str, str]:
    """Return the unit of each quantity that a run of a robot may have, by name."""
    scope, skipped = "none", "none"
    if model.in_space:
        scope = "cycle"
    elif model.free_base:
        scope = "plane"
        skipped = {"yaw_rad": "pitch", "pitch_rad": "yaw"}[model.pose[2]]
    named = {n: kind for n, kind in QUANTITIES.items() if skipped not in n.split("_")}
    units = {name: kind.unit for name, kind in named.items() if scope in kind.of}
    if not model.in_space:
        units |= {f"amplitude_{axis.name}_rad": "rad" for axis in model.passive}
    if model.driven:
        units |= {name: kind.unit for name, kind in QUANTITIES.items() if kind.of == "power"}
    return units


@dataclass(frozen=True)
class SwimRun:
    """Run with a beat or a stroke, sampled so that it ends in whole cycles.

    Attributes
    ----------
    trial : Trial
        The run with :data:`~swimid.logs.kinematics.PER_CYCLE` samples per cycle, from its start on.
    window : Window
        Last whole beats of the run; for a robot that moves in 3-D, its last cycle.
    commanded_turn : bool
        Whether the drive has a bias or an asymmetry.
    """

    trial: Trial
    window: Window
    commanded_turn: bool

    @classmethod
    def of(cls, model: Swimmer, trial: Trial, frequency_hz: float) -> SwimRun | None:
        """Return the run with the drive and the duration of a trial; None if no whole cycle fits into it."""
        begin, end = float(trial.time_s[0]), float(trial.time_s[-1])
        beat = trial.swim.beat
        if model.in_space:
            cycles = kinematics.whole_cycles(trial.time_s, frequency_hz)
            window = cycles[-1] if cycles else None
        else:
            ramp = 0.0 if beat is None else beat.ramp_s
            window = kinematics.last_cycles(max(begin, ramp), end, frequency_hz)
        if window is None:
            return None
        times = window.times()
        # the run begins at the start of the trial
        lead = np.arange(begin, times[0] - 1e-9, times[1] - times[0])
        sampled = Trial(f"{trial.id} (last beats)", "fit", np.concatenate((lead, times)), {}, swim=trial.swim)
        return cls(sampled, window, beat is not None and bool(beat.bias_rad or beat.asymmetry))

    @classmethod
    def driven(
        cls, model: Swimmer, name: str, swim: SwimInput, frequency_hz: float, duration_s: float
    ) -> SwimRun:
        """Return a run from rest, longer than ``duration_s`` if no whole beat after the ramp fits into it.

        Parameters
        ----------
        name : str
            Name of the run. The model caches simulations under this name, so each drive needs a different
            one.

        Notes
        -----
        Samples are counted from the end of the run, so that its quantities are smooth functions of the
        frequency. The run begins up to one sample before the drive. For a robot that moves in 3-D, the
        duration is rounded up to whole cycles.
        """
        end = duration_s
        if swim.beat is not None:
            end = max(end, swim.beat.ramp_s + (1.0 + 1e-6) / frequency_hz)
        if model.in_space:
            end = max(math.ceil(end * frequency_hz - 1e-9), 1) / frequency_hz
        count = math.ceil(end * PER_CYCLE * frequency_hz - 1e-9)
        time = end - np.arange(count, -1, -1) / (PER_CYCLE * frequency_hz)
        run = cls.of(model, Trial(name, "fit", time, {}, swim=swim), frequency_hz)
        assert run is not None
        return run

    def quantities(
        self, model: Swimmer, values: Array, columns: Mapping[str, Array], energetics: Energetics | None
    ) -> dict[str, Quantity]:
        """Return the quantities of the run by name. They are among the quantities of :func:`units_of`.

        Parameters
        ----------
        columns : mapping of str to ndarray
            Channels of the model at the sample times of :attr:`trial`.
        energetics : Energetics or None
            Power and energy of the joints in the window; None if they are unknown.
        """
        body, time = model.body, self.trial.time_s
        if body is None:
            found = kinematics.cycle_quantities(time, columns, self.window)
        else:
            count = self.window.cycles * PER_CYCLE + 1
            last = {name: series[-count:] for name, series in columns.items()}
            found = {f"amplitude_{a.name}_rad": 0.5 * float(np.ptp(last[a.column])) for a in body.passive}
            if body.free:
                found = self._of_last_cycles(body, values, last) | self._of_whole_run(body, columns) | found
        if energetics is not None and model.driven:
            found |= _power_quantities(energetics, found.get("mean_speed_m_s"))
        units = units_of(model)
        return {name: Quantity(value, units[name]) for name, value in found.items()}

    def _of_last_cycles(self, body: Body, values: Array, columns: Mapping[str, Array]) -> dict[str, float]:
        """Return the quantities of the last whole cycles, from the channels in the window."""
        length = body.length(values)
        pose = [columns[name] for name in body.pose]
        found = kinematics.plane_quantities(
            pose,
            [columns[name] for name in body.velocity],
            self.window,
            length_m=length,
            turn=body.pose[2].removesuffix("_rad"),
            commanded_turn=self.commanded_turn,
        )
        speed = found["mean_speed_m_s"]
        if kinematics.is_straight(pose[2], speed, length):
            rear = int(np.argmax(body.straight(values)[1]))
            x, y = body.rear_ends(body.frames(values, columns))
            excursion = kinematics.tail_excursion(x[rear], y[rear])
            found["tail_excursion_m"] = excursion
            found["strouhal"] = self.window.frequency_hz * excursion / speed
        return found

    def _of_whole_run(self, body: Body, columns: Mapping[str, Array]) -> dict[str, float]:
        """Return the quantities of the whole run."""
        time, surge = self.trial.time_s, columns[body.velocity[0]]
        return {
            "mean_surge_from_start_m_s": float(np.trapezoid(surge, time) / (time[-1] - time[0])),
            "settling_time_s": kinematics.settling_time(time, surge, self.window.frequency_hz),
            "path_extent_m": max(float(np.ptp(columns[name])) for name in body.pose[:2]),
        }


def _power_quantities(energetics: Energetics, speed_m_s: float | None) -> dict[str, float]:
    """Return power, torque and rate of the driven joints, and the cost of transport.

    Notes
    -----
    ``COT = P / V`` (dolphin, Eq 11). P is the mean positive mechanical power of the joints, because servos
    return no energy to the battery. Losses of gear and motor are not included.
    """
    positive = energetics.mean_positive_power_W()
    found = {
        "mean_power_W": energetics.mean_power_W(),
        "mean_positive_power_W": positive,
        "peak_torque_N_m": float(np.abs(energetics.torque_N_m).max()),
        "peak_joint_rate_rad_s": float(np.abs(energetics.rate_rad_s).max()),
    }
    if speed_m_s is not None and speed_m_s > 0:
        found["cost_of_transport_J_m"] = positive / speed_m_s
    return found
