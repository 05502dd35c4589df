"""``compare`` for robots in space: motion profiles, stroke by stroke, as the sea lion paper does it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from swimid.estimators import stroke_cycles
from swimid.experiments.base import Experiment
from swimid.formats.comparison import CycleComparison, ProfileComparison
from swimid.models.base import Array
from swimid.models.multibody.model import MultibodyModel
from swimid.signals.derivative import slope
from swimid.verbs.compare_series import Compared, Pair

#: Half width of the window speeds are derived in, as a share of a stroke, and s where there is none.
WINDOW_STROKE, WINDOW_S = 0.1, 0.15
#: How far buoyancy is varied for the band (sea lion, section III).
BUOYANCY_SHARE = 0.02
SIDES = ("measured", "simulated")
POSITION = ("x_m", "y_m", "z_m")
ORIENTATION = ("roll_rad", "pitch_rad", "yaw_rad")


@dataclass(frozen=True)
class Mean:
    """One channel of a motion profile, the mean over its repeats.

    Attributes
    ----------
    unit, meaning : str
    time_s, measured, simulated : ndarray, shape (n,)
        On the clock of the profile's first trial, as far as all repeats reach.
    spread : ndarray, shape (n,)
        Standard deviation of the measured repeats; NaN where there is one.
    band : tuple of ndarray or None
        Least and most of the simulations with less, as much and more buoyancy.
    """

    unit: str
    meaning: str
    time_s: Array
    measured: Array
    spread: Array
    simulated: Array
    band: tuple[Array, Array] | None = None


@dataclass(frozen=True)
class Profile:
    """Trials that repeat one motion, and their means.

    Attributes
    ----------
    name : str
    trials : list of Compared
    means : dict of channel to Mean
    record : ProfileComparison
    """

    name: str
    trials: list[Compared]
    means: dict[str, Mean]
    record: ProfileComparison


def profiles(experiment: Experiment, done: Sequence[Compared], *, buoyancy: float) -> list[Profile]:
    """The motion profiles of a robot in space.

    Parameters
    ----------
    buoyancy : float
        The band's half width, as a share of the buoyancy; 0 for none.
    """
    model = experiment.model
    if not isinstance(model, MultibodyModel):
        return []
    names = experiment.facts["profiles"]
    bands = {d.trial.id: _banded(model, d, buoyancy) for d in done}
    found = []
    for name in dict.fromkeys(names[d.trial.id] for d in done):
        members = [d for d in done if names[d.trial.id] == name and d.pairs]
        if members:
            means = _means([_with_speeds(d.pairs, d) for d in members], members, bands)
            found.append(Profile(name, members, means, _record(name, members, means)))
    return found


# ---------------------------------------------------------------- series


def _banded(model: MultibodyModel, done: Compared, share: float) -> list[dict[str, Pair]]:
    """The trial's pairs with less and with more buoyancy in place of the simulation."""
    if not share or not model.buoyant:
        return []
    found = []
    for factor in (1.0 - share, 1.0 + share):
        other = model.with_buoyancy(factor)
        with np.errstate(over="ignore", invalid="ignore"):
            simulated = other.simulate(done.values, done.trial)
        pairs = {
            n: Pair(n, p.unit, p.meaning, p.source, p.time_s, p.measured, simulated[n])
            for n, p in done.pairs.items()
            if n in simulated
        }
        found.append(_with_speeds(pairs, done))
    return found


def _with_speeds(pairs: Mapping[str, Pair], done: Compared) -> dict[str, Pair]:
    """With the speed in the vertical plane and the pitch rate, as logged or derived from the pose alike."""
    stroke = done.trial.settings.get("stroke")
    half = WINDOW_STROKE / stroke.frequency_hz if stroke is not None else WINDOW_S
    found = dict(pairs)

    def add(name: str, unit: str, meaning: str, values: Sequence[Array]) -> None:
        found[name] = Pair(name, unit, meaning, "pose", done.trial.time_s, values[0], values[1])

    def rates(name: str) -> list[Array]:
        return [slope(pairs[name].time_s, getattr(pairs[name], side), half) for side in SIDES]

    if "pitch_rad" in pairs and "pitch_rate_rad_s" not in pairs:
        add("pitch_rate_rad_s", "rad/s", "pitch rate", rates("pitch_rad"))
    if "x_m" in pairs and "z_m" in pairs:
        if {"u_m_s", "w_m_s", "pitch_rad"} <= pairs.keys():
            both = [stroke_cycles.velocity(done.trial.time_s, _side(pairs, side)) for side in SIDES]
            x, z = ([v[axis] for v in both if v is not None] for axis in (0, 1))
        else:
            x, z = rates("x_m"), rates("z_m")
        add("vx_m_s", "m/s", "speed along x", x)
        add("vz_m_s", "m/s", "speed along z", z)
        add("speed_m_s", "m/s", "speed in the vertical plane", [np.hypot(*v) for v in zip(x, z, strict=True)])
    return found


def _side(pairs: Mapping[str, Pair], side: str) -> dict[str, Array]:
    return {name: getattr(p, side) for name, p in pairs.items()}


def _means(
    each: Sequence[Mapping[str, Pair]],
    members: Sequence[Compared],
    bands: Mapping[str, list[dict[str, Pair]]],
) -> dict[str, Mean]:
    """Means of every channel all repeats have, on the first one's clock."""
    begin = max(float(d.trial.time_s[0]) for d in members)
    end = min(float(d.trial.time_s[-1]) for d in members)
    clock = members[0].trial.time_s
    clock = clock[(clock >= begin - 1e-9) & (clock <= end + 1e-9)]
    found: dict[str, Mean] = {}
    for name, first in each[0].items():
        if any(name not in pairs for pairs in each) or not len(clock):
            continue
        measured = np.array([_on(clock, pairs[name], "measured") for pairs in each])
        simulated = np.array([_on(clock, pairs[name], "simulated") for pairs in each])
        spread = np.std(measured, axis=0, ddof=1) if len(each) > 1 else np.full(len(clock), math.nan)
        sides = [bands[d.trial.id] for d in members]
        band = None
        if all(len(side) == 2 and name in side[0] for side in sides):
            low, high = (
                np.mean([_on(clock, side[k][name], "simulated") for side in sides], axis=0) for k in (0, 1)
            )
            between = (low, simulated.mean(axis=0), high)
            band = (np.min(between, axis=0), np.max(between, axis=0))
        found[name] = Mean(
            first.unit, first.meaning, clock, measured.mean(axis=0), spread, simulated.mean(axis=0), band
        )
    return found


def _on(clock: Array, pair: Pair, side: str) -> Array:
    values = getattr(pair, side)
    there = np.isfinite(values)
    if there.sum() < 2:
        return np.full(len(clock), math.nan)
    time = pair.time_s[there]
    found: Array = np.interp(clock, time, values[there], left=math.nan, right=math.nan)
    return found


# ---------------------------------------------------------------- numbers


def _record(name: str, members: Sequence[Compared], means: Mapping[str, Mean]) -> ProfileComparison:
    return ProfileComparison(
        name=name,
        trials=[d.trial.id for d in members],
        cycles=_cycles(members),
        position_rmse_m=_rmse(means, POSITION),
        orientation_rmse_rad=_rmse(means, ORIENTATION),
        surge_m=_way(means.get("x_m")),
        heave_m=_way(means.get("z_m")),
    )


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


def _cycles(members: Sequence[Compared]) -> list[CycleComparison]:
    """Every whole stroke: each trial's quantities, then their means."""
    each = [_quantities(d) for d in members]
    found = []
    for k in range(min(len(e) for e in each)):
        measured, spread, simulated = {}, {}, {}
        for name in stroke_cycles.QUANTITIES:
            values = [[cycle[side].get(name) for side in SIDES] for cycle in (e[k] for e in each)]
            if any(None in pair for pair in values):
                continue
            seen, said = np.array(values, dtype=float).T
            measured[name], simulated[name] = float(seen.mean()), float(said.mean())
            if len(seen) > 1:
                spread[name] = float(np.std(seen, ddof=1))
        if measured:
            found.append(CycleComparison(cycle=k + 1, measured=measured, spread=spread, simulated=simulated))
    return found


def _quantities(done: Compared) -> list[dict[str, dict[str, float]]]:
    stroke = done.trial.settings.get("stroke")
    if stroke is None:
        return []
    pairs = _with_speeds(done.pairs, done)
    windows = stroke_cycles.windows(done.trial.time_s, stroke.frequency_hz)
    return [
        {side: stroke_cycles.quantities(done.trial.time_s, _side(pairs, side), window) for side in SIDES}
        for window in windows
    ]
