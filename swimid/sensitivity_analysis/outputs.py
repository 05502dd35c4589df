"""What a run of a robot with links comes to, as ``sensitivity`` and its drive sweep ask for it."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from swimid.errors import InputError
from swimid.fitting import metrics
from swimid.fitting.drives import Beat, Cycle
from swimid.fitting.model import Array, Trial
from swimid.simulation import swim_quantities
from swimid.simulation.applied import Quantity
from swimid.simulation.swim_quantities import PER_BEAT
from swimid.swimmer import stroke_cycles
from swimid.swimmer.model import Swimmer

#: How the cycles of a trial become one number; what is not here is averaged.
OVER_CYCLES: dict[str, Callable[[list[float]], Any]] = {
    "max_speed_m_s": np.max,
    "max_pitch_rate_rad_s": np.max,
    "final_pitch_rad": lambda cycles: cycles[-1],
    "surge_m": np.sum,
    "heave_m": np.sum,
}
#: Steps between the samples of a run without a beat.
STEPS = 1000


@dataclass(frozen=True)
class Run:
    """A trial's drive and start, with the times its outputs are taken at.

    Attributes
    ----------
    trial : Trial
        At those times, which hold whole beats or cycles.
    last : slice
        The samples that count: those of the last whole beats, or all.
    begin_s : float
        Where the first cycle begins.
    measured : dict of channel to (times, values, scale, unit)
        Samples a misfit is taken over; it is divided by ``scale``.
    """

    trial: Trial
    last: slice
    begin_s: float
    measured: Mapping[str, tuple[Array, Array, float, str]]


def run_of(model: Swimmer, trial: Trial, noise: Mapping[str, float] | None = None) -> Run:
    """A trial as a run.

    Parameters
    ----------
    noise : mapping of channel to float, optional
        Standard deviation of each channel's noise: makes misfits of the measured channels, over it, or in
        the channel's unit where it is not known. None: no misfits.
    """
    measured = {}
    units = {c.name: c.unit for c in model.channels}
    for name, values in trial.measured.items() if noise is not None else ():
        there = np.isfinite(values)
        if there.sum() > 1:
            sd = (noise or {}).get(name, 0.0)
            scale, unit = (sd, "1") if sd > 0 else (1.0, units[name])
            measured[name] = (trial.time_s[there], values[there], scale, unit)
    drive = trial.swim.drive
    begin, end = float(trial.time_s[0]), float(trial.time_s[-1])
    times, last, anchor = np.linspace(begin, end, STEPS + 1), slice(None), begin
    if drive is not None:
        ramp = max(begin, drive.ramp_s)
        anchor = 0.0 if begin <= 0 else ramp
        if not model.in_space:
            window = swim_quantities.last_beats(ramp, end, drive.frequency_hz)
            last, anchor = slice(-(window.beats * PER_BEAT + 1) if window else None, None), end
        step = 1.0 / (drive.frequency_hz * PER_BEAT)
        first, stop = math.ceil((begin - anchor) / step + 1e-6), math.floor((end - anchor) / step - 1e-6) + 1
        times = np.concatenate(([begin], anchor + step * np.arange(first, stop), [end]))
    return Run(replace(trial, time_s=times, measured={}, inputs={}), last, anchor, measured)


def outputs(model: Swimmer, values: Array, run: Run) -> dict[str, Quantity]:
    """What a run comes to (see :func:`of_columns`)."""
    return of_columns(model, model.attempt(values, run.trial), run)


def of_columns(model: Swimmer, columns: Mapping[str, Array], run: Run) -> dict[str, Quantity]:
    """What a simulated run comes to; NaN where the simulation breaks down.

    In the plane over the last whole beats (at most four): mean surge, half its range, half the range of the
    heading about its straight course, the mean turning rate where the drive asks for turning, half the
    range of passive joints. In space the quantities of :mod:`swimid.swimmer.stroke_cycles` over all
    cycles: largest speed and pitch rate, mean speed and pitch rate, last pitch, way ahead and up in all.
    """
    quantities: dict[str, Quantity] = {}
    if model.free_base:
        quantities |= (_in_space if model.in_space else _in_plane)(model, columns, run)
    for axis in model.passive:
        angle = columns[axis.column][run.last]
        quantities[f"amplitude_{axis.name}_rad"] = Quantity(0.5 * float(np.ptp(angle)), "rad")
    if run.measured:
        simulated = np.stack([columns[name] for name in run.measured], axis=1)
        curves = CubicSpline(run.trial.time_s, simulated) if np.isfinite(simulated).all() else None
    for k, (name, (times, measured, scale, unit)) in enumerate(run.measured.items()):
        error = math.nan
        if curves is not None:
            error = math.sqrt(float(np.mean((measured - curves(times)[:, k]) ** 2)))
        quantities[f"misfit_{name}"] = Quantity(error / scale, unit)
    return quantities


def _in_plane(model: Swimmer, columns: Mapping[str, Array], run: Run) -> dict[str, Quantity]:
    time = run.trial.time_s[run.last]
    surge, heading = columns[model.velocity[0]][run.last], columns[model.pose[2]][run.last]
    turn = model.pose[2].removesuffix("_rad")
    duration = float(time[-1] - time[0])
    rate = float(heading[-1] - heading[0]) / duration
    course = heading - rate * (time - time[0])
    quantities = {
        "mean_surge_m_s": Quantity(float(np.trapezoid(surge, time)) / duration, "m/s"),
        "surge_amplitude_m_s": Quantity(0.5 * float(np.ptp(surge)), "m/s"),
        f"{turn}_amplitude_rad": Quantity(0.5 * float(np.ptp(course)), "rad"),
    }
    beat = run.trial.swim.beat
    if beat is None or beat.bias_rad or beat.asymmetry:
        quantities[f"mean_{turn}_rate_rad_s"] = Quantity(rate, "rad/s")
    return quantities


def _in_space(_model: Swimmer, columns: Mapping[str, Array], run: Run) -> dict[str, Quantity]:
    time, drive = run.trial.time_s, run.trial.swim.drive
    windows = (
        stroke_cycles.windows(time, drive.frequency_hz, begin_s=run.begin_s) if drive is not None else []
    )
    windows = windows or [stroke_cycles.Window(float(time[0]), float(time[-1]))]
    cycles = [stroke_cycles.quantities(time, columns, window) for window in windows]
    return {
        name: Quantity(float(OVER_CYCLES.get(name, np.mean)([c.get(name, math.nan) for c in cycles])), unit)
        for name, unit in stroke_cycles.QUANTITIES.items()
    }


# ------------------------------------------------------------ another drive


def drive_of(trial: Trial) -> dict[str, float]:
    """The numbers of a trial's drive a sweep may vary; empty where measured joints drive it."""
    beat, stroke = trial.swim.beat, trial.swim.stroke
    if isinstance(stroke, Cycle):
        return {"frequency_hz": stroke.frequency_hz, "scale": stroke.scale}
    if isinstance(beat, Beat):
        return {
            "frequency_hz": beat.frequency_hz,
            "amplitude_deg": math.degrees(beat.amplitude_rad),
            "bias_deg": math.degrees(beat.bias_rad),
        }
    return {}


def driven_otherwise(trial: Trial, drive: Mapping[str, float]) -> Trial:
    """The trial under another drive, from rest at its start pose.

    A stroke keeps its number of whole cycles; a beat its time, or its ramp and four beats where that is
    longer.
    """
    stroke, beat = trial.swim.stroke, trial.swim.beat
    given = {**drive_of(trial), **drive}
    frequency, end = given["frequency_hz"], float(trial.time_s[-1])
    if isinstance(stroke, Cycle):
        swim = replace(trial.swim, stroke=replace(stroke, frequency_hz=frequency, scale=given["scale"]))
        end = max(math.floor((end - float(trial.time_s[0])) * stroke.frequency_hz + 1e-6), 1) / frequency
    else:
        assert isinstance(beat, Beat)
        amplitude, bias = math.radians(given["amplitude_deg"]), math.radians(given["bias_deg"])
        moved = replace(beat, frequency_hz=frequency, amplitude_rad=amplitude, bias_rad=bias)
        swim = replace(trial.swim, beat=moved)
        end = max(end, beat.ramp_s + swim_quantities.BEATS / frequency)
    # a model keeps trajectories by the trial's name
    name = ", ".join([trial.id, *(f"{k} {v!r}" for k, v in drive.items())])
    return replace(trial, id=name, time_s=np.array([0.0, end]), measured={}, inputs={}, swim=swim)


def errors(model: Swimmer, values: Array, trial: Trial) -> dict[str, tuple[float, float]]:
    """Root-mean-square error of each measured channel, and the same over its measured range."""
    simulated = model.attempt(values, trial)
    errors = {}
    for name, measured in trial.measured.items():
        there = np.isfinite(measured)
        if there.sum() > 1 and np.isfinite(simulated[name][there]).all():
            score = metrics.score(measured, simulated[name])
            errors[name] = (score.rmse, score.nrmse)
    return errors


def possible(model: Swimmer, values: Array) -> bool:
    """Whether the coefficients make masses that a body has."""
    try:
        model.check(values)
    except InputError:
        return False
    return True
