"""``compare`` for robots in space: motion profiles, stroke by stroke, as the sea lion paper does it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from swimid.fitting.experiment import Experiment
from swimid.fitting.model import Array
from swimid.fitting.swimmer import Swimmer
from swimid.logs.derivative import slope
from swimid.simulation.compare_series import Compared
from swimid.simulation.comparison_file import CycleComparison, ProfileComparison
from swimid.swimmer import stroke_cycles

#: Half width of the window speeds are derived in, as a share of a stroke, and s where there is none.
WINDOW_STROKE, WINDOW_S = 0.1, 0.15
SIDES = ("measured", "simulated")
POSITION = ("x_m", "y_m", "z_m")
#: What is derived where it is not logged: unit and meaning.
DERIVED = {
    "pitch_rate_rad_s": ("rad/s", "pitch rate"),
    "vx_m_s": ("m/s", "speed along x"),
    "vz_m_s": ("m/s", "speed along z"),
    "speed_m_s": ("m/s", "speed in the vertical plane"),
}
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
    model = experiment.model.swimmer
    if model is None or not model.in_space:
        return []
    names = experiment.facts["profiles"]
    factors = [1.0 + k * buoyancy for k in (-1, 1)] if buoyancy else []
    others = [other for k in factors if (other := model.with_buoyancy(k)) is not None]
    seen = {d.trial.id: _Seen.of(d, others) for d in done if d.pairs}
    found = []
    for name in dict.fromkeys(names[trial] for trial in seen):
        members = [one for trial, one in seen.items() if names[trial] == name]
        means = _means(members)
        found.append(Profile(name, [m.done for m in members], means, _record(name, members, means)))
    return found


# ---------------------------------------------------------------- series


@dataclass(frozen=True)
class _Seen:
    """One trial's columns, speeds in the vertical plane and the pitch rate among them.

    ``sides`` are those of :data:`SIDES`, ``band`` the simulations with less and with more buoyancy.
    """

    done: Compared
    sides: dict[str, dict[str, Array]]
    band: list[dict[str, Array]]

    @classmethod
    def of(cls, done: Compared, others: Sequence[Swimmer]) -> _Seen:
        """As logged, or derived from the pose on every side alike."""
        sides = {side: {n: getattr(p, side) for n, p in done.pairs.items()} for side in SIDES}
        band = []
        for other in others:
            with np.errstate(over="ignore", invalid="ignore"):
                simulated = other.simulate(done.values, done.trial)
            band.append({n: simulated[n] for n in done.pairs})
        return cls(
            done,
            {side: _with_speeds(columns, done) for side, columns in sides.items()},
            [_with_speeds(columns, done) for columns in band],
        )

    def told(self, name: str) -> tuple[str, str]:
        """Unit and meaning of a column."""
        pair = self.done.pairs.get(name)
        return DERIVED[name] if pair is None else (pair.unit, pair.meaning)


def _with_speeds(columns: Mapping[str, Array], done: Compared) -> dict[str, Array]:
    """With the speed in the vertical plane and the pitch rate."""
    stroke, time = done.trial.swim.stroke, done.trial.time_s
    half = WINDOW_STROKE / stroke.frequency_hz if stroke is not None else WINDOW_S
    found = dict(columns)
    if "pitch_rad" in columns and "pitch_rate_rad_s" not in columns:
        found["pitch_rate_rad_s"] = slope(time, columns["pitch_rad"], half)
    if "x_m" in columns and "z_m" in columns:
        own = {"u_m_s", "w_m_s", "pitch_rad"} <= columns.keys()
        moving = stroke_cycles.velocity(time, columns) if own else None
        if moving is None:
            moving = np.array([slope(time, columns[name], half) for name in ("x_m", "z_m")])
        found["vx_m_s"], found["vz_m_s"] = moving
        found["speed_m_s"] = np.hypot(*moving)
    return found


def _means(members: Sequence[_Seen]) -> dict[str, Mean]:
    """Means of every channel all repeats have, on the first one's clock."""
    times = [m.done.trial.time_s for m in members]
    begin, end = max(float(t[0]) for t in times), min(float(t[-1]) for t in times)
    clock = times[0][(times[0] >= begin - 1e-9) & (times[0] <= end + 1e-9)]
    found: dict[str, Mean] = {}
    for name in members[0].sides["measured"]:
        if any(name not in m.sides["measured"] for m in members) or not len(clock):
            continue

        def on_clock(columns: Sequence[Mapping[str, Array]], name: str = name) -> Array:
            return np.array([_on(clock, t, c[name]) for t, c in zip(times, columns, strict=True)])

        measured, simulated = (on_clock([m.sides[side] for m in members]) for side in SIDES)
        spread = np.std(measured, axis=0, ddof=1) if len(members) > 1 else np.full(len(clock), math.nan)
        middle = simulated.mean(axis=0)
        band = None
        if members[0].band:
            low, high = (on_clock([m.band[k] for m in members]).mean(axis=0) for k in (0, 1))
            band = (np.min((low, middle, high), axis=0), np.max((low, middle, high), axis=0))
        unit, meaning = members[0].told(name)
        found[name] = Mean(unit, meaning, clock, measured.mean(axis=0), spread, middle, band)
    return found


def _on(clock: Array, time: Array, values: Array) -> Array:
    there = np.isfinite(values)
    if there.sum() < 2:
        return np.full(len(clock), math.nan)
    found: Array = np.interp(clock, time[there], values[there], left=math.nan, right=math.nan)
    return found


# ---------------------------------------------------------------- numbers


def _record(name: str, members: Sequence[_Seen], means: Mapping[str, Mean]) -> ProfileComparison:
    return ProfileComparison(
        name=name,
        trials=[m.done.trial.id for m in members],
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


def _cycles(members: Sequence[_Seen]) -> list[CycleComparison]:
    """Every whole stroke: each trial's quantities, then their means."""
    each = [_quantities(m) for m in members]
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


def _quantities(seen: _Seen) -> list[dict[str, dict[str, float]]]:
    trial = seen.done.trial
    stroke = trial.swim.stroke
    if stroke is None:
        return []
    return [
        {side: stroke_cycles.quantities(trial.time_s, seen.sides[side], window) for side in SIDES}
        for window in stroke_cycles.windows(trial.time_s, stroke.frequency_hz)
    ]
