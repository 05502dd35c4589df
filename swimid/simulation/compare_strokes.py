"""``compare`` for robots in space: motion profiles, stroke by stroke, as the sea lion paper does it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from swimid.fitting.experiment import Experiment
from swimid.fitting.model import Array, Channel
from swimid.logs.sampling import slope
from swimid.simulation.compare_series import Compared, CycleComparison, ProfileComparison
from swimid.swimmer import run_quantities

#: Half width of the window speeds are derived in, as a share of a stroke, and s where there is none.
WINDOW_STROKE, WINDOW_S = 0.1, 0.15
SIDES = ("measured", "simulated")
POSITION = ("x_m", "y_m", "z_m")
#: What is derived where it is not logged.
DERIVED = (
    Channel("pitch_rate_rad_s", "rad/s", "pitch rate"),
    Channel("vx_m_s", "m/s", "speed along x"),
    Channel("vz_m_s", "m/s", "speed along z"),
    Channel("speed_m_s", "m/s", "speed in the vertical plane"),
)
ORIENTATION = ("roll_rad", "pitch_rad", "yaw_rad")


@dataclass(frozen=True)
class Mean:
    """One channel of a motion profile, the mean over its repeats.

    Attributes
    ----------
    time_s, measured, simulated : ndarray, shape (n,)
        On the clock of the profile's first trial, as far as all repeats reach.
    spread : ndarray, shape (n,)
        Standard deviation of the measured repeats; NaN where there is one.
    band : tuple of ndarray or None
        Least and most of the simulations with less, as much and more buoyancy.
    """

    channel: Channel
    time_s: Array
    measured: Array
    spread: Array
    simulated: Array
    band: tuple[Array, Array] | None = None


class Profile(NamedTuple):
    """Trials that repeat one motion: means by channel, and what the comparison file says of them."""

    means: dict[str, Mean]
    record: ProfileComparison


class _Sides(NamedTuple):
    """A trial's columns as measured, as simulated, and as simulated with less and more buoyancy."""

    done: Compared
    columns: dict[str, dict[str, Array]]


def profiles(experiment: Experiment, done: Sequence[Compared], *, buoyancy: float) -> list[Profile]:
    """The motion profiles of a robot in space.

    Parameters
    ----------
    buoyancy : float
        The band's half width, as a share of the buoyancy; 0 for none.
    """
    model = experiment.model.swimmer
    if model is None or not model.in_space:
        return []
    factors = {"less": 1.0 - buoyancy, "more": 1.0 + buoyancy} if buoyancy else {}
    others = {side: other for side, k in factors.items() if (other := model.with_buoyancy(k)) is not None}
    repeats: dict[str, list[_Sides]] = {}
    for one in (d for d in done if d.pairs):
        columns = {side: {n: getattr(p, side) for n, p in one.pairs.items()} for side in SIDES}
        for side, other in others.items():
            simulated = other.attempt(one.values, one.trial)
            columns[side] = {n: simulated[n] for n in one.pairs}
        sides = _Sides(one, {side: _with_speeds(series, one) for side, series in columns.items()})
        repeats.setdefault(experiment.facts["profiles"][one.trial.id], []).append(sides)
    return [_profile(name, members) for name, members in repeats.items()]


def _profile(name: str, members: Sequence[_Sides]) -> Profile:
    means = _means(members)
    record = ProfileComparison(
        name=name,
        trials=[m.done.trial.id for m in members],
        cycles=_cycles(members),
        position_rmse_m=_rmse(means, POSITION),
        orientation_rmse_rad=_rmse(means, ORIENTATION),
        surge_m=_way(means.get("x_m")),
        heave_m=_way(means.get("z_m")),
    )
    return Profile(means, record)


# ---------------------------------------------------------------- series


def _with_speeds(columns: Mapping[str, Array], done: Compared) -> dict[str, Array]:
    """With the speed in the vertical plane and the pitch rate."""
    stroke, time = done.trial.swim.stroke, done.trial.time_s
    half = WINDOW_STROKE / stroke.frequency_hz if stroke is not None else WINDOW_S
    extended = dict(columns)
    if "pitch_rad" in columns and "pitch_rate_rad_s" not in columns:
        extended["pitch_rate_rad_s"] = slope(time, columns["pitch_rad"], half)
    if "x_m" in columns and "z_m" in columns:
        own = {"u_m_s", "w_m_s", "pitch_rad"} <= columns.keys()
        moving = run_quantities.velocity(time, columns) if own else None
        if moving is None:
            moving = np.array([slope(time, columns[name], half) for name in ("x_m", "z_m")])
        extended["vx_m_s"], extended["vz_m_s"] = moving
        extended["speed_m_s"] = np.hypot(*moving)
    return extended


def _means(members: Sequence[_Sides]) -> dict[str, Mean]:
    """Means of every channel all repeats have, on the first one's clock."""
    times = [m.done.trial.time_s for m in members]
    begin, end = max(float(t[0]) for t in times), min(float(t[-1]) for t in times)
    clock = times[0][(times[0] >= begin - 1e-9) & (times[0] <= end + 1e-9)]
    channels = {c.name: c for c in (*DERIVED, *(p.channel for p in members[0].done.pairs.values()))}
    means: dict[str, Mean] = {}
    for name in members[0].columns["measured"] if len(clock) else ():
        if any(name not in m.columns["measured"] for m in members):
            continue
        series = {
            side: np.array(
                [_on(clock, t, m.columns[side][name]) for t, m in zip(times, members, strict=True)]
            )
            for side in members[0].columns
        }
        measured = series.pop("measured")
        spread = np.std(measured, axis=0, ddof=1) if len(members) > 1 else np.full(len(clock), math.nan)
        simulated = [repeated.mean(axis=0) for repeated in series.values()]
        band = (np.min(simulated, axis=0), np.max(simulated, axis=0)) if len(simulated) > 1 else None
        means[name] = Mean(channels[name], clock, measured.mean(axis=0), spread, simulated[0], band)
    return means


def _on(clock: Array, time: Array, values: Array) -> Array:
    there = np.isfinite(values)
    if there.sum() < 2:
        return np.full(len(clock), math.nan)
    resampled: Array = np.interp(clock, time[there], values[there], left=math.nan, right=math.nan)
    return resampled


# ---------------------------------------------------------------- numbers


def _rmse(means: Mapping[str, Mean], names: Sequence[str]) -> float | None:
    """Root-mean-square distance of the mean simulated path from the mean measured one."""
    parts = [means[n].measured - means[n].simulated for n in names if n in means]
    if not parts:
        return None
    squares = np.sum(np.square(parts), axis=0)
    squares = squares[np.isfinite(squares)]
    return math.sqrt(float(squares.mean())) if len(squares) else None


def _way(mean: Mean | None) -> dict[str, float]:
    """From the first to the last sample, measured and simulated."""
    if mean is None:
        return {}
    both = np.isfinite(mean.measured) & np.isfinite(mean.simulated)
    if both.sum() < 2:
        return {}
    ends = {side: getattr(mean, side)[both] for side in SIDES}
    return {side: float(values[-1] - values[0]) for side, values in ends.items()}


def _cycles(members: Sequence[_Sides]) -> list[CycleComparison]:
    """Every whole stroke: each trial's quantities, then their means."""
    each = [_quantities(m) for m in members]
    comparisons = []
    for k, repeats in enumerate(zip(*each, strict=False), 1):
        comparison = CycleComparison(cycle=k, measured={}, simulated={})
        for name in run_quantities.QUANTITIES:
            values = [[stroke[side].get(name) for side in SIDES] for stroke in repeats]
            if any(None in pair for pair in values):
                continue
            measured, simulated = np.array(values, dtype=float).T
            comparison.measured[name] = float(measured.mean())
            comparison.simulated[name] = float(simulated.mean())
            if len(measured) > 1:
                comparison.spread[name] = float(np.std(measured, ddof=1))
        if comparison.measured:
            comparisons.append(comparison)
    return comparisons


def _quantities(sides: _Sides) -> list[dict[str, dict[str, float]]]:
    trial = sides.done.trial
    stroke = trial.swim.stroke
    if stroke is None:
        return []
    return [
        {side: run_quantities.quantities(trial.time_s, sides.columns[side], window) for side in SIDES}
        for window in run_quantities.windows(trial.time_s, stroke.frequency_hz)
    ]
