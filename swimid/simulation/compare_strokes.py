"""Motion profiles of a robot that moves in 3-D: comparison by strokes, as in the sea lion paper.

Trials that repeat a motion form one profile. The mean of the measurements is compared with the mean of the
simulations, over time and for each stroke (Tables I and II of the paper).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from swimid.fitting.fit_common import Experiment
from swimid.fitting.model import Array
from swimid.logs import kinematics
from swimid.logs.kinematics import CYCLE_QUANTITIES, QUANTITIES
from swimid.logs.sampling import slope
from swimid.results import evidence as ev
from swimid.results import numbers
from swimid.simulation.compare_series import Compared, CycleComparison, ProfileComparison
from swimid.simulation.swim_quantities import value_text

#: Half-width of the window in which a derivative is computed: in cycles of the stroke, and in s without a
#: stroke.
HALF_WIDTH_CYCLES, HALF_WIDTH_S = 0.1, 0.15
SIDES = ("measured", "simulated")
POSITION, ORIENTATION = ("x_m", "y_m", "z_m"), ("roll_rad", "pitch_rad", "yaw_rad")
#: Channels of the figure of mean channels, in the order of the sea lion paper (Kadapa et al.).
FIGURE_CHANNELS = ("x_m", "z_m", "speed_m_s", "pitch_rad", "roll_rad", "yaw_rad", "pitch_rate_rad_s")
#: Maximum number of samples of a curve.
MAX_SAMPLES = 200

#: Columns of a trial by side: ``measured`` and ``simulated``.
Columns = dict[str, dict[str, Array]]


class Profile(NamedTuple):
    """Trials that repeat one motion.

    Attributes
    ----------
    time_s : ndarray, shape (n,)
        Sample times of the first trial that all trials cover.
    repeats : dict of side to dict of channel to ndarray, shape (trials, n)
    record : ProfileComparison
        Entry of the comparison file.
    """

    time_s: Array
    repeats: dict[str, dict[str, Array]]
    record: ProfileComparison

    def mean(self, side: str, channel: str) -> Array:
        """Return the mean of a channel over the trials, shape (n,)."""
        return np.asarray(self.repeats[side][channel].mean(axis=0))


def compare_profiles(experiment: Experiment, done: Sequence[Compared]) -> list[Profile]:
    """Return the motion profiles of a robot that moves in 3-D; an empty list for other robots."""
    model = experiment.model.swimmer
    if model is None or not model.in_space:
        return []
    groups: dict[str, list[tuple[Compared, Columns]]] = {}
    for one in done:
        columns: Columns = {side: {n: getattr(p, side) for n, p in one.pairs.items()} for side in SIDES}
        if one.pairs:
            columns = {side: _with_speeds(series, one) for side, series in columns.items()}
            groups.setdefault(experiment.facts["profiles"][one.trial.id], []).append((one, columns))
    return [_profile(name, members) for name, members in groups.items()]


def _with_speeds(columns: Mapping[str, Array], done: Compared) -> dict[str, Array]:
    """Return the columns together with the pitch rate and the speed in the vertical plane."""
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


def _profile(name: str, members: Sequence[tuple[Compared, Columns]]) -> Profile:
    """Return repeated trials at common sample times, and the comparison of their means."""
    times = [done.trial.time_s for done, _ in members]
    begin, end = max(float(t[0]) for t in times), min(float(t[-1]) for t in times)
    clock = times[0][(times[0] >= begin - 1e-9) & (times[0] <= end + 1e-9)]
    first = members[0][1]
    common = [n for n in first["measured"] if all(n in columns["measured"] for _, columns in members)]
    repeats = {
        side: {
            n: np.array([_resampled(clock, d.trial.time_s, columns[side][n]) for d, columns in members])
            for n in common
        }
        for side in first
    }
    record = ProfileComparison(
        name=name, trials=[done.trial.id for done, _ in members], cycles=_cycles(members)
    )
    profile = Profile(clock, repeats, record)
    record.position_rmse_m = _rmse(profile, POSITION)
    record.orientation_rmse_rad = _rmse(profile, ORIENTATION)
    record.surge_m, record.heave_m = _displacement(profile, "x_m"), _displacement(profile, "z_m")
    return profile


def _resampled(clock: Array, time_s: Array, values: Array) -> Array:
    """Return values at other times; NaN outside the range of the valid samples."""
    known = np.isfinite(values)
    if known.sum() < 2:
        return np.full(len(clock), math.nan)
    return np.asarray(np.interp(clock, time_s[known], values[known], left=math.nan, right=math.nan))


def _rmse(profile: Profile, names: Sequence[str]) -> float | None:
    """Return the root-mean-square distance between the mean simulated and the mean measured series."""
    known = [name for name in names if name in profile.repeats["measured"]]
    errors = [profile.mean("measured", name) - profile.mean("simulated", name) for name in known]
    squares = np.sum(np.square(errors), axis=0)
    if not errors or not np.isfinite(squares).any():
        return None
    return math.sqrt(float(np.nanmean(squares)))


def _displacement(profile: Profile, name: str) -> dict[str, float | None]:
    """Return the change from the first to the last valid sample, measured and simulated."""
    if name not in profile.repeats["measured"]:
        return {}
    means = {side: profile.mean(side, name) for side in SIDES}
    known = np.flatnonzero(np.isfinite(sum(means.values())))
    if len(known) < 2:
        return {}
    return {side: float(values[known[-1]] - values[known[0]]) for side, values in means.items()}


def _cycles(members: Sequence[tuple[Compared, Columns]]) -> list[CycleComparison]:
    """Return the quantities of every whole stroke, averaged over the trials."""
    each = []
    for done, columns in members:
        time, stroke = done.trial.time_s, done.trial.swim.stroke
        windows = [] if stroke is None else kinematics.whole_cycles(time, stroke.frequency_hz)
        each.append([[kinematics.cycle_quantities(time, columns[s], w) for s in SIDES] for w in windows])
    comparisons = []
    for k, repeats in enumerate(zip(*each, strict=False), 1):
        comparison = CycleComparison(cycle=k, measured={}, simulated={})
        for name in CYCLE_QUANTITIES:
            values = np.array([[side.get(name, math.nan) for side in sides] for sides in repeats])
            if np.isnan(values).any():
                continue
            comparison.measured[name], comparison.simulated[name] = values.mean(axis=0).tolist()
            if len(values) > 1:
                comparison.spread[name] = float(np.std(values[:, 0], ddof=1))
        if comparison.measured:
            comparisons.append(comparison)
    return comparisons


# ------------------------------------------------------------ evidence


def tables(profiles: Sequence[ProfileComparison]) -> list[ev.Table]:
    """Return the table of the profiles and the table of their strokes."""
    rows: list[list[Any]] = []
    strokes: list[list[Any]] = []
    for p in profiles:
        ways = [way.get(side) for way in (p.surge_m, p.heave_m) for side in SIDES]
        texts = [numbers.number(way, 3, "m") for way in (*ways, p.position_rmse_m)]
        rows.append([p.name, len(p.trials), *texts, value_text(p.orientation_rmse_rad, "rad")])
        for cycle in p.cycles:
            for side, known, spread in (
                ("measured", cycle.measured, cycle.spread),
                ("simulated", cycle.simulated, {}),
            ):
                cells = [
                    value_text(known.get(n), QUANTITIES[n].unit, spread.get(n)) for n in CYCLE_QUANTITIES
                ]
                strokes.append([p.name, cycle.cycle, side, *cells])
    sides = [f"{way}, {side}" for way in ("surge", "heave") for side in SIDES]
    names = [numbers.split_unit(name)[0].replace("_", " ") for name in CYCLE_QUANTITIES]
    return [
        ev.Table(
            id="profiles",
            title="Motion profiles",
            columns=["profile", "trials", *sides, "position RMSE", "orientation RMSE"],
            rows=rows,
            caption="Means of trials that repeat a motion: displacement from first to last sample, "
            "and root-mean-square distance of mean simulated path and angles from the mean measured ones.",
        ),
        ev.Table(
            id="strokes",
            title="Quantities of each stroke",
            columns=["profile", "stroke", "", *names],
            rows=strokes,
            caption="Tables I and II of the sea lion paper; mean and standard deviation of repeated trials. "
            "Maximum speeds and rates derived from noisy positions are too large by up to a few standard "
            "deviations of their noise; those of a smoothed track are not.",
        ),
    ]


def figure(profile: Profile) -> ev.Figure:
    """Return the figure of the mean channels of repeated trials, measured and simulated, against time."""
    record, measured = profile.record, profile.repeats["measured"]
    caption = "Mean measured and simulated motion."
    if len(record.trials) > 1:
        caption = (
            f"Mean of {len(record.trials)} trials on one clock with their standard deviation, and mean of "
            "their simulations."
        )
    # leave out channels without motion: a symmetric stroke has neither roll nor yaw
    shown = [n for n in FIGURE_CHANNELS if n in measured and _moves(profile.mean("measured", n))]
    panels = [_panel(profile, name) for name in shown]
    return ev.Figure(id=f"profile-{record.name}", title=record.name, caption=caption, panels=panels)


def _moves(values: Array) -> bool:
    known = values[np.isfinite(values)]
    return bool(len(known)) and float(np.ptp(known)) > 1e-9


def _panel(profile: Profile, name: str) -> ev.Panel:
    factor, _ = numbers.in_degrees(numbers.split_unit(name)[1])
    keep = slice(None, None, max(len(profile.time_s) // MAX_SAMPLES, 1))
    time, repeats = profile.time_s[keep], profile.repeats["measured"][name]
    measured, simulated = (factor * profile.mean(side, name)[keep] for side in SIDES)
    error = None
    if len(repeats) > 1:
        error = factor * np.nan_to_num(np.std(repeats, axis=0, ddof=1)[keep])
    traces = [
        ev.Trace(x=time, y=measured, style="points", label="measured", group=0, y_error=error),
        ev.Trace(x=time, y=simulated, label="simulated", group=0),
    ]
    return ev.Panel(x_label="time (s)", y_label=numbers.column_title(name), traces=traces)
