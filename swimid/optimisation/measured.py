"""Recorded trials beside a map: measured speeds, electrical power, and where the coefficients were found."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from swimid.errors import UsageError
from swimid.files.provenance import Input
from swimid.fitting.experiment import read_log
from swimid.fitting.model import Array, Trial
from swimid.logs import trials as trials_format
from swimid.logs.trials import TrialSet
from swimid.notices import warn
from swimid.optimisation.map_file import Efficiency, MeasuredPoint
from swimid.optimisation.performance import BEAT, STROKE, Performance
from swimid.simulation import compare_series
from swimid.simulation.applied import Applied
from swimid.simulation.swim_quantities import Steady, Window
from swimid.swimmer import trials as swimmer

#: Columns of electrical power in a log.
VOLTAGE, CURRENT = "voltage_V", "current_A"
#: Share of a window whose samples must have both.
LOGGED = 0.9
#: A trial lies on a map where what is not varied differs by no more than this share, and its unit's part.
SAME, LEAST = 0.02, 1e-3


def electrical_power(time_s: Array, voltage_V: Array, current_A: Array, window: Window) -> float:
    """Mean electrical power over a window, W (dolphin, section 4.2.2).

    NaN where less than :data:`LOGGED` of it was logged.

    >>> time = np.linspace(0.0, 1.0, 5)
    >>> electrical_power(time, np.full(5, 24.0), np.full(5, 2.0), Window(0.0, 1.0, 1, 1.0))
    48.0
    """
    power = voltage_V * current_A
    within = (time_s >= window.begin_s - 1e-9) & (time_s <= window.end_s + 1e-9)
    there = np.isfinite(power) & within
    if there.sum() < max(3, LOGGED * within.sum()):
        return math.nan
    return float(np.trapezoid(power[there], time_s[there]) / np.ptp(time_s[there]))


def efficiency(mechanical_W: Sequence[float], electrical_W: Sequence[float]) -> Efficiency | None:
    """Mechanical over electrical power of several trials, with the standard error of their scatter.

    Notes
    -----
    ``eta = sum P_m P_e / sum P_e^2``, least squares through the origin: losses in proportion.

    >>> found = efficiency([1.0, 2.0, 3.0], [4.0, 8.0, 12.0])
    >>> found.value, found.stderr
    (0.25, 0.0)
    """
    mechanical, electrical = np.asarray(mechanical_W, dtype=float), np.asarray(electrical_W, dtype=float)
    there = np.isfinite(mechanical) & np.isfinite(electrical) & (electrical > 0)
    mechanical, electrical = mechanical[there], electrical[there]
    if not len(mechanical):
        return None
    square = float(electrical @ electrical)
    value = float(mechanical @ electrical) / square
    stderr = None
    if len(mechanical) > 1:
        left = mechanical - value * electrical
        stderr = math.sqrt(float(left @ left) / (len(left) - 1) / square)
    return Efficiency(value=value, stderr=stderr, trials=len(mechanical))


class Recorded:
    """The trials of a trials file as a map shows them.

    Parameters
    ----------
    source : path or TrialSet
    performance : Performance
        Of the same robot.

    Raises
    ------
    UsageError, InputError
        For a trials file of another robot, and for anything wrong in it.
    """

    def __init__(self, source: str | Path | TrialSet, performance: Performance) -> None:
        model = performance.model
        self.experiment = swimmer.load(
            source, readings=_readings(performance.applied), max_step=model.max_step
        )
        if self.experiment.robot.name != model.robot.name:
            raise UsageError(
                f"these are trials of the robot '{self.experiment.robot.name}', the map is of "
                f"'{model.robot.name}'"
            )
        path = trials_format.place(source)
        entries: Any = trials_format.read(source)
        self._logs = {
            e.id: read_log(e, path.parent, required=(), optional=(VOLTAGE, CURRENT)) for e in entries.trials
        }
        given = performance.applied
        self.applied = Applied(self.experiment.model, given.file, given.path, given.chosen)
        self._performance = performance

    @property
    def inputs(self) -> list[Input]:
        """The files that were read."""
        return self.experiment.inputs

    def place(self, trial: Trial, names: Sequence[str]) -> dict[str, float]:
        """Where a trial lies on axes of these names; empty where it does not say."""
        known = swimmer.drive_of(trial)
        if not known:
            return {}
        values = dict(
            zip(
                (p.name for p in self.experiment.model.parameters), self.applied.values(trial.id), strict=True
            )
        )
        own = {**{n: float(v) for n, v in values.items()}, **(trial.swim.coefficients or {})}
        found = {**own, **known}
        return {name: found[name] for name in names} if all(name in found for name in names) else {}

    def region(self, names: Sequence[str]) -> dict[str, tuple[float, float]]:
        """The range of each axis in the trials the coefficients were identified from (role ``fit``)."""
        places = [self.place(t, names) for t in self.experiment.trials if t.role == "fit"]
        places = [place for place in places if place]
        if not places:
            return {}
        return {n: (min(p[n] for p in places), max(p[n] for p in places)) for n in names}

    def points(self, axes: Mapping[str, Sequence[float]]) -> list[MeasuredPoint]:
        """Every trial with a drive that differs from the map's in nothing but its axes."""
        found = []
        for trial in self.experiment.trials:
            at = self.place(trial, list(axes))
            if not at or not self._alike(trial, axes):
                continue
            inside = all(min(values) <= at[name] <= max(values) for name, values in axes.items())
            found.append(self._point(trial, at, inside))
        return found

    def _alike(self, trial: Trial, axes: Mapping[str, Sequence[float]]) -> bool:
        """Whether a trial's drive is that of the map where that is not varied."""
        known, own = swimmer.drive_of(trial), self._performance.drive
        names = [name for name in BEAT | STROKE if name in known and name not in axes]
        return all(
            abs(known[name] - own.get(name, 0.0)) <= max(SAME * abs(known[name]), LEAST) for name in names
        )

    def _point(self, trial: Trial, at: dict[str, float], inside: bool) -> MeasuredPoint:
        compared = compare_series.compared(self.experiment, self.applied, trial, refit=True)
        speed = compared.record.mean_speed
        drive = trial.swim.drive
        electrical = mechanical = math.nan
        log = self._logs[trial.id]
        if drive is not None and VOLTAGE in log and CURRENT in log:
            run = Steady.of(self._performance.model, trial, drive.frequency_hz)
            if run is not None:
                electrical = electrical_power(log.time_s, log[VOLTAGE], log[CURRENT], run.window)
                model = self._performance.model
                pair = [(compared.values, run.trial)]
                columns, energetics = model.with_energetics(pair, [run.window.length_s])[0]
                told = run.quantities(model, compared.values, columns, energetics)
                mechanical = told["mean_positive_power_W"].value if told else math.nan
                if mechanical > electrical:
                    warn(
                        "SWM002",
                        f"{trial.id}: the joints give {mechanical:.3g} W where {electrical:.3g} W of "
                        "electrical power were logged; are they in V and A, and of all motors?",
                    )
        return MeasuredPoint(
            trial=trial.id,
            role=trial.role,  # type: ignore[arg-type]
            at=at,
            inside=inside,
            measured_m_s=speed.measured if speed is not None else None,
            simulated_m_s=speed.simulated if speed is not None else None,
            electrical_W=electrical,
            mechanical_W=mechanical,
        )


def _readings(applied: Applied) -> dict[str, str]:
    return dict(applied.file.settings.get("readings", {})) if applied.file is not None else {}
