"""Body wave of a trial, measured and simulated, for ``compare``.

The lateral motion of the joints and of the ends of the body follows from the pose and the joint angles. The
same function (:func:`swimid.kinematics.wave.measure`) measures both waves in the same windows.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any, Literal

import numpy as np

from swimid.files import yamlio
from swimid.files.yamlio import Number
from swimid.fitting.model import Array, Model, Trial
from swimid.kinematics import wave
from swimid.kinematics.speed import Estimate
from swimid.results import evidence as ev

WAVE_SIDES = ("measured", "simulated")


class WaveQuantity(yamlio.Document):
    """Quantity of a body wave: measured with its 95 % interval, simulated, and simulated minus measured.

    A wavelength or a wave speed is null if the phase does not increase towards the rear significantly.
    """

    measured: Number = None
    low: Number = None
    high: Number = None
    simulated: Number = None
    difference: Number = None


class WaveStation(yamlio.Document):
    """Joint or end of the body, with the lateral motion there."""

    name: str
    #: Distance behind the front end of the straight body.
    behind_m: float
    amplitude_m: WaveQuantity
    #: Phase lag behind the reference station of the wave.
    phase_rad: WaveQuantity


class BodyWave(yamlio.Document):
    """Body wave of a trial, measured and simulated."""

    #: ``world`` if the wave includes the motion of the base; ``base`` if it is relative to the base.
    frame: Literal["world", "base"]
    frequency_hz: float
    #: Number of windows of two cycles.
    windows: int
    #: Station whose phase lag is zero: the one that moves most in the measurement.
    reference: str
    wavelength_m: WaveQuantity
    wave_speed_m_s: WaveQuantity
    stations: list[WaveStation]


def compare_waves(
    model: Model,
    values: Array,
    trial: Trial,
    simulated: Mapping[str, Array],
    compared: Collection[str],
    frequency_hz: float | None,
) -> BodyWave | None:
    """Return the body wave of a trial, measured and simulated.

    Return None if the robot has no links in a plane, if not all joint angles are measured, without a beat, if
    the trial is too short, or if the model predicts none of the channels of the wave.

    Parameters
    ----------
    values : ndarray
        Parameters of the model in this trial.
    simulated : mapping of channel to ndarray, shape (n,)
    compared : collection of str
        Measured channels that the model predicts. Joint angles that drive the simulation are not among them.
    frequency_hz : float or None

    Notes
    -----
    The wave includes the motion of the base if the pose is measured. Otherwise it is relative to the base,
    without the stations that do not move then.
    """
    body = model.body
    if body is None or frequency_hz is None:
        return None
    moving = [link for link in body.spine if link in body.joints]
    joints = [body.joints[link].column for link in moving]
    measured = {**trial.inputs, **trial.measured}
    frame: Literal["world", "base"] = "base"
    needed = joints
    if body.free and set(body.pose) <= set(compared):
        frame, needed = "world", [*body.pose, *joints]
    if not joints or not set(needed) <= measured.keys() or set(needed).isdisjoint(compared):
        return None
    begin = -np.inf
    if trial.swim.drive is not None:
        begin = trial.swim.drive.ramp_s
    rows = trial.time_s >= begin
    for name in needed:
        rows &= np.isfinite(measured[name]) & np.isfinite(simulated[name])
    # relative to the base, all stations up to the first moving joint stand still
    first = 0
    if frame == "base":
        first = body.spine.index(moving[0]) + 1
    rest, names = body.at_rest(), body.stations[first:]
    if not rows.any() or len(names) < 2:
        return None
    behind = wave.distances(body.midline(values, rest)[0][0])[first:]
    unknown = {name: np.zeros(rows.sum()) for name in rest}

    def of(side: Mapping[str, Array], like: wave.Wave | None = None) -> wave.Wave | None:
        columns = unknown | {name: side[name][rows] for name in needed}
        stations, heading = body.midline(values, columns)
        time = trial.time_s[rows]
        return wave.measure(time, stations[:, first:], behind, heading, frequency_hz, like)

    seen = of(measured)
    if seen is None:
        return None
    made = of(simulated, seen)
    if made is None:
        return None
    return _document(seen, made, names, frame)


def _document(
    measured: wave.Wave, simulated: wave.Wave, names: Sequence[str], frame: Literal["world", "base"]
) -> BodyWave:
    stations = [
        WaveStation(
            name=name,
            behind_m=float(measured.behind[k]),
            amplitude_m=_quantity(measured.amplitude[k], simulated.amplitude[k]),
            phase_rad=_quantity(measured.phase[k], simulated.phase[k]),
        )
        for k, name in enumerate(names)
    ]
    return BodyWave(
        frame=frame,
        frequency_hz=measured.frequency_hz,
        windows=measured.windows,
        reference=names[measured.reference],
        wavelength_m=_quantity(measured.length, simulated.length),
        wave_speed_m_s=_quantity(measured.speed, simulated.speed),
        stations=stations,
    )


def _quantity(measured: Estimate | None, simulated: Estimate | None) -> WaveQuantity:
    found = WaveQuantity()
    if measured is not None:
        found = WaveQuantity(measured=measured.value, low=measured.low, high=measured.high)
    if simulated is not None:
        found.simulated = simulated.value
        if measured is not None:
            found.difference = simulated.value - measured.value
    return found


# ------------------------------------------------------------ evidence


def method() -> str:
    """Return the sentence on the body wave for the methods section of a paper."""
    return (
        "The body wave was computed from the measured joint angles and, in the same way, from the simulated "
        "ones: sines at the beat frequency were fitted to the lateral motion of joints and ends of the body "
        f"in windows of {wave.CYCLES} cycles. The 95 % intervals are from the variation between windows."
    )


def tabulate_waves(waves: Mapping[str, BodyWave]) -> ev.Table:
    """Return the table of measured and simulated body waves, by trial."""
    rows: list[list[Any]] = []
    for trial, one in waves.items():
        rows.append(_row(trial, "wavelength, m", one.wavelength_m))
        rows.append(_row(trial, "wave speed, m/s", one.wave_speed_m_s))
        rows += [_row(trial, f"amplitude at {s.name}, mm", s.amplitude_m, 1e3) for s in one.stations]
        rows += [_row(trial, f"phase lag at {s.name}, rad", s.phase_rad) for s in one.stations]
    return ev.Table(
        id="wave",
        title="Body wave",
        columns=["trial", "quantity", "measured", "95 % from", "to", "simulated", "difference"],
        rows=rows,
        caption=_caption(waves) + " The difference is simulated minus measured.",
        folded=len(waves) > 1,
    )


def _row(trial: str, name: str, one: WaveQuantity, factor: float = 1.0) -> list[Any]:
    cells: list[Any] = [trial, name]
    for value in (one.measured, one.low, one.high, one.simulated, one.difference):
        if value is not None:
            value = factor * value
        cells.append(value)
    return cells


def _caption(waves: Mapping[str, BodyWave]) -> str:
    text = {
        "world": "Lateral motion in the world, across the mean heading",
        "base": "Lateral motion relative to the base of the robot",
    }
    frames = "; or ".join(dict.fromkeys(text[one.frame] for one in waves.values()))
    return f"{frames}. The phase lag is that behind the station that moves most in the measurement."


def draw_waves(waves: Mapping[str, BodyWave]) -> ev.Figure:
    """Return the figure of amplitude and phase along the body, with two panels for each trial.

    Parameters
    ----------
    waves : mapping of title to BodyWave
    """
    panels = []
    for title, one in waves.items():
        behind = [station.behind_m for station in one.stations]
        shown = (("lateral amplitude (mm)", "amplitude_m", 1e3), ("phase lag (rad)", "phase_rad", 1.0))
        for label, name, factor in shown:
            found = [getattr(station, name) for station in one.stations]
            bars = [0.5 * factor * (q.high - q.low) for q in found]
            measured, simulated = ([factor * getattr(q, side) for q in found] for side in WAVE_SIDES)
            traces = ev.pair((behind, behind), (measured, simulated), y_error=bars)
            panels.append(ev.panel("distance behind the front end (m)", label, traces, title=title))
    caption = f"{_caption(waves)} Bars are 95 % intervals."
    return ev.panels("wave", "Body wave", caption, panels)
