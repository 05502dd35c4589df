"""Motion profiles of a robot in space: ``compare`` by strokes, as in the sea lion paper.

Trials that repeat a motion make one profile. Its mean is compared with the mean of its simulations, over time
and for each stroke (Tables I and II of the paper).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from swimid.fitting.experiment import Experiment
from swimid.fitting.model import Array, Channel
from swimid.logs import kinematics
from swimid.logs.kinematics import CYCLE_QUANTITIES, QUANTITIES
from swimid.logs.sampling import slope
from swimid.results import evidence as ev
from swimid.results import numbers
from swimid.simulation.compare_series import Compared, CycleComparison, ProfileComparison

#: Half width of the window of a derivative: cycles of the stroke, and s without a stroke.
HALF_WIDTH_CYCLES, HALF_WIDTH_S = 0.1, 0.15
SIDES = ("measured", "simulated")
#: Channels that are derived if they are not logged.
DERIVED = (
    Channel("pitch_rate_rad_s", "rad/s", "pitch rate"),
    Channel("vx_m_s", "m/s", "speed along x"),
    Channel("vz_m_s", "m/s", "speed along z"),
    Channel("speed_m_s", "m/s", "speed in the vertical plane"),
)
#: Channels of the figure of a profile, in the order of the paper.
FIGURE_CHANNELS = ("x_m", "z_m", "speed_m_s", "pitch_rad", "roll_rad", "yaw_rad", "pitch_rate_rad_s")
#: Maximum number of samples of a curve.
MAX_SAMPLES = 200
#: Tables by stroke: id, title, quantities with their headings, and their place in the paper.
STROKE_TABLES = (
    (
        "cycle-velocity",
        "Speed in each stroke",
        {"max_speed_m_s": "max. speed", "path_speed_m_s": "mean speed"},
        "Table I",
    ),
    (
        "cycle-angles",
        "Pitch and pitch rate in each stroke",
        {
            "final_pitch_rad": "final pitch",
            "max_pitch_rate_rad_s": "max. rate",
            "mean_pitch_rate_rad_s": "mean rate",
        },
        "Table II",
    ),
    (
        "cycle-way",
        "Displacement in each stroke",
        {"surge_m": "surge", "heave_m": "heave"},
        "Figs 3 and 5",
    ),
)


@dataclass(frozen=True)
class Mean:
    """Mean of one channel over the repeats of a motion.

    Attributes
    ----------
    time_s, measured, simulated : ndarray, shape (n,)
        On the clock of the first trial, in the time that all repeats cover.
    spread : ndarray, shape (n,)
        Standard deviation of the measured repeats; NaN for one trial.
    band : tuple of ndarray or None
        Minimum and maximum of the simulations with less, equal and more buoyancy.
    """

    channel: Channel
    time_s: Array
    measured: Array
    spread: Array
    simulated: Array
    band: tuple[Array, Array] | None = None


class Profile(NamedTuple):
    """Trials that repeat one motion: means by channel, and the entry of the comparison file."""

    means: dict[str, Mean]
    record: ProfileComparison


class _Repeat(NamedTuple):
    """A trial with its columns by side: measured, simulated, and simulated with less and more buoyancy."""

    done: Compared
    columns: dict[str, dict[str, Array]]


def compare_profiles(experiment: Experiment, done: Sequence[Compared], *, buoyancy: float) -> list[Profile]:
    """Return the motion profiles of a robot in space; none for other robots.

    Parameters
    ----------
    buoyancy : float
        Half width of the band, relative to the buoyancy; 0 for no band.
    """
    model = experiment.model.swimmer
    if model is None or not model.in_space:
        return []
    others = {}
    if buoyancy:
        others = {
            side: model.with_buoyancy(1.0 + sign * buoyancy) for side, sign in (("less", -1), ("more", 1))
        }
    repeats: dict[str, list[_Repeat]] = {}
    for one in done:
        if not one.pairs:
            continue
        columns = {side: {n: getattr(p, side) for n, p in one.pairs.items()} for side in SIDES}
        for side, other in others.items():
            if other is not None:
                simulated = other.attempt(one.values, one.trial)
                columns[side] = {n: simulated[n] for n in one.pairs}
        repeat = _Repeat(one, {side: _with_speeds(series, one) for side, series in columns.items()})
        repeats.setdefault(experiment.facts["profiles"][one.trial.id], []).append(repeat)
    return [_profile(name, members) for name, members in repeats.items()]


def _profile(name: str, members: Sequence[_Repeat]) -> Profile:
    """Return the means of repeated trials, and their comparison with those of the simulations."""
    means = _means(members)
    record = ProfileComparison(
        name=name,
        trials=[member.done.trial.id for member in members],
        cycles=_cycles(members),
        position_rmse_m=_rmse(means, ("x_m", "y_m", "z_m")),
        orientation_rmse_rad=_rmse(means, ("roll_rad", "pitch_rad", "yaw_rad")),
        surge_m=_displacement(means.get("x_m")),
        heave_m=_displacement(means.get("z_m")),
    )
    return Profile(means, record)


def _with_speeds(columns: Mapping[str, Array], done: Compared) -> dict[str, Array]:
    """Return columns with pitch rate and speed in the vertical plane."""
    stroke, time, half = done.trial.swim.stroke, done.trial.time_s, HALF_WIDTH_S
    if stroke is not None:
        half = HALF_WIDTH_CYCLES / stroke.frequency_hz
    extended = dict(columns)
    if "pitch_rad" in columns and "pitch_rate_rad_s" not in columns:
        extended["pitch_rate_rad_s"] = slope(time, columns["pitch_rad"], half)
    if "x_m" in columns and "z_m" in columns:
        moving = None
        if {"u_m_s", "w_m_s", "pitch_rad"} <= columns.keys():
            moving = kinematics.world_velocity(time, columns)
        if moving is None:
            moving = np.array([slope(time, columns[name], half) for name in ("x_m", "z_m")])
        extended["vx_m_s"], extended["vz_m_s"] = moving
        extended["speed_m_s"] = np.hypot(*moving)
    return extended


def _means(members: Sequence[_Repeat]) -> dict[str, Mean]:
    """Return the mean of every channel that all repeats have, on the clock of the first."""
    times = [member.done.trial.time_s for member in members]
    begin, end = max(float(t[0]) for t in times), min(float(t[-1]) for t in times)
    clock = times[0][(times[0] >= begin - 1e-9) & (times[0] <= end + 1e-9)]
    channels = {c.name: c for c in (*DERIVED, *(p.channel for p in members[0].done.pairs.values()))}
    common = set.intersection(*(set(member.columns["measured"]) for member in members))
    means: dict[str, Mean] = {}
    for name in members[0].columns["measured"] if len(clock) else ():
        if name not in common:
            continue
        series = {}
        for side in members[0].columns:
            repeats = [
                _resampled(clock, t, m.columns[side][name]) for t, m in zip(times, members, strict=True)
            ]
            series[side] = np.array(repeats)
        measured = series.pop("measured")
        spread = np.full(len(clock), math.nan)
        if len(members) > 1:
            spread = np.std(measured, axis=0, ddof=1)
        simulated = [repeated.mean(axis=0) for repeated in series.values()]
        band = None
        if len(simulated) > 1:
            band = np.min(simulated, axis=0), np.max(simulated, axis=0)
        means[name] = Mean(channels[name], clock, measured.mean(axis=0), spread, simulated[0], band)
    return means


def _resampled(clock: Array, time_s: Array, values: Array) -> Array:
    """Return values at other times; NaN outside of the known samples."""
    known = np.isfinite(values)
    if known.sum() < 2:
        return np.full(len(clock), math.nan)
    return np.asarray(np.interp(clock, time_s[known], values[known], left=math.nan, right=math.nan))


def _rmse(means: Mapping[str, Mean], names: Sequence[str]) -> float | None:
    """Return the root-mean-square distance of the mean simulated series from the mean measured ones."""
    parts = [means[n].measured - means[n].simulated for n in names if n in means]
    if not parts:
        return None
    squares = np.sum(np.square(parts), axis=0)
    squares = squares[np.isfinite(squares)]
    return math.sqrt(float(squares.mean())) if len(squares) else None


def _displacement(mean: Mean | None) -> dict[str, float]:
    """Return the change from the first to the last known sample, measured and simulated."""
    if mean is None:
        return {}
    known = np.flatnonzero(np.isfinite(mean.measured) & np.isfinite(mean.simulated))
    if len(known) < 2:
        return {}
    return {side: float(np.diff(getattr(mean, side)[known[[0, -1]]])[0]) for side in SIDES}


def _cycles(members: Sequence[_Repeat]) -> list[CycleComparison]:
    """Return the quantities of every whole stroke: means over the trials."""
    each = [_quantities(member) for member in members]
    comparisons = []
    for k, repeats in enumerate(zip(*each, strict=False), 1):
        comparison = CycleComparison(cycle=k, measured={}, simulated={})
        for name in CYCLE_QUANTITIES:
            if any(name not in stroke[side] for stroke in repeats for side in SIDES):
                continue
            measured, simulated = (np.array([stroke[side][name] for stroke in repeats]) for side in SIDES)
            comparison.measured[name] = float(measured.mean())
            comparison.simulated[name] = float(simulated.mean())
            if len(measured) > 1:
                comparison.spread[name] = float(np.std(measured, ddof=1))
        if comparison.measured:
            comparisons.append(comparison)
    return comparisons


def _quantities(repeat: _Repeat) -> list[dict[str, dict[str, float]]]:
    """Return the quantities of every whole stroke of a trial, measured and simulated."""
    trial = repeat.done.trial
    if trial.swim.stroke is None:
        return []
    return [
        {side: kinematics.cycle_quantities(trial.time_s, repeat.columns[side], window) for side in SIDES}
        for window in kinematics.whole_cycles(trial.time_s, trial.swim.stroke.frequency_hz)
    ]


# ------------------------------------------------------------ evidence


def methods(profiles: Sequence[Profile], buoyancy: float) -> list[str]:
    """Return sentences for a paper."""
    sentences = []
    if any(len(p.record.trials) > 1 for p in profiles):
        sentences.append(
            "Trials that repeat a motion were averaged on one clock, and so were their simulations."
        )
    if any(m.band is not None for p in profiles for m in p.means.values()):
        sentences.append(
            f"The band of the simulations is that of {100 * buoyancy:g} % less and more displaced volume, "
            "all else held (sea lion, section III)."
        )
    return sentences


def tables(profiles: Sequence[ProfileComparison]) -> list[ev.Table]:
    """Return the table of the profiles, and those of their strokes."""
    rows: list[list[Any]] = []
    for p in profiles:
        ways = [way.get(side) for way in (p.surge_m, p.heave_m) for side in SIDES]
        texts = [numbers.number(way, 3, "m") for way in (*ways, p.position_rmse_m)]
        factor, unit = numbers.in_degrees("rad")
        angle = p.orientation_rmse_rad
        angle = None if angle is None else factor * angle
        rows.append([p.name, len(p.trials), *texts, numbers.number(angle, 3, unit)])
    sides = [f"{way}, {side}" for way in ("surge", "heave") for side in SIDES]
    whole = ev.Table(
        id="profiles",
        title="Motion profiles",
        columns=["profile", "trials", *sides, "position RMSE", "orientation RMSE"],
        rows=rows,
        caption="Means of trials that repeat a motion: displacement from the first to the last sample, and "
        "root-mean-square distance of the mean simulated path and angles from the mean measured ones.",
    )
    stroked = [p for p in profiles if p.cycles]
    return [whole, *(_stroke_table(stroked, *which) for which in STROKE_TABLES)]


def _stroke_table(
    profiles: Sequence[ProfileComparison], id: str, title: str, headings: Mapping[str, str], source: str
) -> ev.Table:
    count = max((len(p.cycles) for p in profiles), default=0)
    units = {name: numbers.in_degrees(QUANTITIES[name][0]) for name in headings}
    rows: list[list[Any]] = []
    for p in profiles:
        for side in SIDES:
            row = [p.name, side]
            for cycle in p.cycles:
                for name, (factor, _) in units.items():
                    value, spread = getattr(cycle, side).get(name), cycle.spread.get(name)
                    if value is None:
                        row.append(numbers.number(None))
                    elif spread and side == "measured":
                        row.append(numbers.measured(factor * value, factor * spread))
                    else:
                        row.append(numbers.number(factor * value, 3))
            rows.append(row + [numbers.number(None)] * (2 + count * len(headings) - len(row)))
    columns = [
        f"{k + 1}: {heading} ({numbers.unit_text(units[name][1])})"
        for k in range(count)
        for name, heading in headings.items()
    ]
    return ev.Table(
        id=id,
        title=title,
        columns=["profile", "", *columns],
        rows=rows,
        caption=f"As {source} of the sea lion paper; of a repeated motion mean and standard deviation of the "
        "trials. Maximum speeds and rates derived from noisy positions are too large by up to a few "
        "standard deviations of their noise; those of a smoothed track are not.",
    )


def figure(profile: Profile) -> ev.Figure:
    """Return the figure of a profile: measured and simulated means over time."""
    means, record = profile
    caption = "Mean measured and simulated motion."
    if len(record.trials) > 1:
        caption = f"Mean of {len(record.trials)} trials with their standard deviation."
    if any(m.band is not None for m in means.values()):
        caption += " Shaded: simulated with less and with more buoyancy."
    panels = [_panel(means[n]) for n in FIGURE_CHANNELS if n in means and _moves(means[n])]
    return ev.Figure(
        id=f"profile-{record.name}", title=record.name, caption=caption, panels=panels, columns=2
    )


def _moves(mean: Mean) -> bool:
    """Return whether the channel moves: a symmetric stroke has neither roll nor yaw."""
    values = mean.measured[np.isfinite(mean.measured)]
    return bool(len(values)) and float(np.ptp(values)) > 1e-9


def _panel(mean: Mean) -> ev.Panel:
    scale, unit = numbers.in_degrees(mean.channel.unit)
    keep = slice(None, None, max(len(mean.time_s) // MAX_SAMPLES, 1))
    points: dict[str, Any] = {}
    if np.isfinite(mean.spread).any():
        points["y_error"] = scale * np.nan_to_num(mean.spread[keep])
    line: dict[str, Any] = {}
    if mean.band is not None:
        line = {name: scale * end[keep] for name, end in zip(("lower", "upper"), mean.band, strict=True)}
    time, measured, simulated = mean.time_s[keep], scale * mean.measured[keep], scale * mean.simulated[keep]
    traces = [
        ev.Trace(x=time, y=measured, style="points", label="measured", group=0, **points),
        ev.Trace(x=time, y=simulated, label="simulated", group=0, **line),
    ]
    label = f"{mean.channel.meaning} ({numbers.unit_text(unit)})"
    return ev.Panel(x_label="time (s)", y_label=label, traces=traces)
