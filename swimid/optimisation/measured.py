"""Recorded trials beside a map: measured speeds, electrical power, and where the coefficients were found."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from swimid.errors import UsageError
from swimid.files.provenance import Input
from swimid.fitting.experiment import read_log
from swimid.fitting.model import Array, Trial
from swimid.logs import trials as trials_format
from swimid.logs.log import Log
from swimid.logs.trials import TrialSet
from swimid.notices import warn
from swimid.optimisation.map_file import Efficiency, MeasuredPoint
from swimid.optimisation.performance import BEAT, STROKE, Performance
from swimid.simulation import compare_series
from swimid.simulation.applied import Applied
from swimid.simulation.swim_quantities import Steady, Window
from swimid.swimmer import trials as swimmer
from swimid.swimmer.model import Swimmer

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


def efficiency(points: Sequence[MeasuredPoint]) -> Efficiency | None:
    """Return mechanical over electrical power of several trials, with the standard error of their scatter.

    Notes
    -----
    ``eta = sum P_m P_e / sum P_e^2``, least squares through the origin: losses in proportion.
    """
    pairs = [(p.mechanical_W, p.electrical_W) for p in points if p.mechanical_W and p.electrical_W]
    if not pairs:
        return None
    mechanical, electrical = np.array(pairs).T
    square = float(electrical @ electrical)
    value = float(mechanical @ electrical) / square
    left = mechanical - value * electrical
    stderr = None
    if len(left) > 1:
        stderr = math.sqrt(float(left @ left) / (len(left) - 1) / square)
    return Efficiency(value=value, stderr=stderr, trials=len(left))


@dataclass(frozen=True)
class Recorded:
    """The trials of a trials file as a map shows them.

    Attributes
    ----------
    inputs : list of Input
        The files that were read.
    region : dict of str to (float, float)
        The range of each axis in the trials the coefficients were identified from (role ``fit``).
    points : list of MeasuredPoint
        Every trial with a drive that differs from the map's in nothing but its axes.
    """

    inputs: Sequence[Input] = ()
    region: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    points: Sequence[MeasuredPoint] = ()


def recorded_trials(
    source: str | Path | TrialSet, performance: Performance, axes: Mapping[str, Sequence[float]]
) -> Recorded:
    """Return the trials of a trials file as a map shows them.

    Parameters
    ----------
    source : path or TrialSet
    performance : Performance
        Of the same robot.
    axes : dict of str to sequence of float
        Of the map.

    Raises
    ------
    UsageError, InputError
        For a trials file of another robot, and for anything wrong in it.
    """
    model, given = performance.model, performance.applied
    readings = given.file.settings.get("readings", {}) if given.file is not None else {}
    experiment = swimmer.load(source, readings=dict(readings), max_step=model.max_step)
    if experiment.robot.name != model.robot.name:
        raise UsageError(
            f"these are trials of the robot '{experiment.robot.name}', the map is of '{model.robot.name}'"
        )
    applied = Applied(experiment.model, given.file, given.path, given.chosen)
    entries: Any = trials_format.read(source)
    folder = trials_format.place(source).parent
    logs = {e.id: read_log(e, folder, required=(), optional=(VOLTAGE, CURRENT)) for e in entries.trials}
    places = {trial.id: _place(applied, trial, axes) for trial in experiment.trials}
    fitted = [places[t.id] for t in experiment.trials if t.role == "fit" and places[t.id]]
    region = {n: (min(p[n] for p in fitted), max(p[n] for p in fitted)) for n in axes if fitted}
    points = []
    for trial in experiment.trials:
        at = places[trial.id]
        if not at or not _is_alike(trial, performance, axes):
            continue
        compared = compare_series.compared(experiment, applied, trial, refit=True)
        speed = compared.record.mean_speed
        electrical, mechanical = _powers(model, trial, logs[trial.id], compared.values)
        points.append(
            MeasuredPoint(
                trial=trial.id,
                role=trial.role,  # type: ignore[arg-type]
                at=at,
                inside=all(min(values) <= at[name] <= max(values) for name, values in axes.items()),
                measured_m_s=speed.measured if speed is not None else None,
                simulated_m_s=speed.simulated if speed is not None else None,
                electrical_W=electrical,
                mechanical_W=mechanical,
            )
        )
    return Recorded(experiment.inputs, region, points)


def _place(applied: Applied, trial: Trial, names: Iterable[str]) -> dict[str, float]:
    """Where a trial lies on axes of these names; empty where it does not say."""
    drive = swimmer.drive_of(trial)
    values = applied.values(trial.id).tolist()
    known = dict(zip((p.name for p in applied.model.parameters), values, strict=True))
    known |= {**(trial.swim.coefficients or {}), **drive}
    return {name: known[name] for name in names} if drive and set(names) <= set(known) else {}


def _is_alike(trial: Trial, performance: Performance, axes: Mapping[str, Sequence[float]]) -> bool:
    """Whether a trial's drive is that of the map where that is not varied."""
    known, own = swimmer.drive_of(trial), performance.drive
    names = [name for name in BEAT | STROKE if name in known and name not in axes]
    return all(abs(known[name] - own.get(name, 0.0)) <= max(SAME * abs(known[name]), LEAST) for name in names)


def _powers(model: Swimmer, trial: Trial, log: Log, values: Array) -> tuple[float, float]:
    """Electrical power of a log, and the power of the model's joints over the same beats, W; NaN for none."""
    drive = trial.swim.drive
    run = None if drive is None else Steady.of(model, trial, drive.frequency_hz)
    if run is None or VOLTAGE not in log or CURRENT not in log:
        return math.nan, math.nan
    electrical = electrical_power(log.time_s, log[VOLTAGE], log[CURRENT], run.window)
    columns, energetics = model.with_energetics([(values, run.trial)], [run.window.length_s])[0]
    mechanical = math.nan
    if energetics is not None:
        mechanical = run.quantities(model, values, columns, energetics)["mean_positive_power_W"].value
    if mechanical > electrical:
        warn(
            "SWM002",
            f"{trial.id}: the joints give {mechanical:.3g} W where {electrical:.3g} W of electrical power "
            "were logged; are they in V and A, and of all motors?",
        )
    return electrical, mechanical
