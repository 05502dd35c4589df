"""How far a model is from its trials, motion profile by motion profile, as objectives of a search."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from swimid.fitting.metrics import Series, dtw_distance
from swimid.fitting.model import Array, Model, Parameter, Trial
from swimid.fitting.problem import Problem

#: Which channels make up a distance together.
KINDS: dict[str, tuple[str, ...]] = {
    "position": ("x_m", "y_m", "z_m"),
    "orientation": ("roll_rad", "pitch_rad", "yaw_rad"),
    "speed": ("u_m_s", "v_m_s", "w_m_s"),
    "turning": ("roll_rate_rad_s", "pitch_rate_rad_s", "yaw_rate_rad_s"),
}
#: What an error counts as one in each: m, rad (5 degrees), m/s, rad/s (10 degrees a second).
SCALES = {
    "position": 0.05,
    "orientation": math.radians(5.0),
    "speed": 0.05,
    "turning": math.radians(10.0),
}
#: The unit of each.
UNITS = {"position": "m", "orientation": "rad", "speed": "m/s", "turning": "rad/s"}
#: By this share of the record the two may be shifted at most.
BAND = 0.05


def kind_of(channel: str) -> str:
    """The distance a channel is part of; a joint's angle counts as orientation, its rate as turning."""
    for kind, names in KINDS.items():
        if channel in names:
            return kind
    return "turning" if channel.endswith("_rate_rad_s") else "orientation"


def distance(
    measured: Mapping[str, Array],
    simulated: Mapping[str, Array],
    channels: Sequence[str],
    scales: Sequence[float],
    *,
    band: float = BAND,
) -> float:
    """Dynamic-time-warping distance per sample of several channels warped as one.

    Parameters
    ----------
    measured, simulated : mapping of channel to ndarray, shape (n,)
        On one clock of even steps. Samples that are not measured in every channel are left out.
    scales : sequence of float
        What an error of each channel counts as one, in the channel's unit.
    band : float
        By what share of the record the two may be shifted at most (Sakoe and Chiba 1978).

    Returns
    -------
    float
        Root of the least sum of squares over n; NaN where nothing is left or the simulation broke down.

    >>> late = {"x_m": np.array([0.0, 0.0, 1.0, 2.0, 2.0])}
    >>> distance({"x_m": np.array([0.0, 1.0, 2.0, 2.0, 2.0])}, late, ["x_m"], [0.05], band=0.2)
    0.0
    """
    first = np.column_stack([measured[n] for n in channels])
    second = np.column_stack([simulated[n] for n in channels])
    there = np.isfinite(first).all(axis=1)
    if not there.any() or not np.isfinite(second[there]).all():
        return math.nan
    y, z = (v[there] / np.asarray(scales) for v in (first, second))
    return dtw_distance(y, z, band=max(round(band * len(y)), 1))


class Profiles:
    """Distances of the simulated trials from the measured ones, a mean for each motion profile.

    A point of the search holds the shared coefficients; what belongs to single trials stays where their logs
    put it.

    Parameters
    ----------
    parameters : sequence of Parameter
        Those that are free and shared are searched.
    trials : sequence of Trial
        Those of role ``fit`` count.
    profiles : mapping of trial id to str
        The motion profile of each.
    scales : mapping of channel to float
        What an error of a channel counts as one, other than :data:`SCALES`.
    band : float
        By what share of a record the two may be shifted.

    Attributes
    ----------
    labels : list of str, length d
        The coefficients searched.
    lower, upper, start : ndarray, shape (d,)
    names : list of str
        Of the profiles.
    objectives : list of (str, str)
        Profile and kind of each objective.
    """

    def __init__(
        self,
        model: Model,
        parameters: Sequence[Parameter],
        trials: Sequence[Trial],
        profiles: Mapping[str, str],
        *,
        scales: Mapping[str, float] | None = None,
        band: float = BAND,
        jobs: int = 1,
    ) -> None:
        self.problem = Problem(model, parameters, [t for t in trials if t.role == "fit"], jobs=jobs)
        self.band = band
        self._shared = [j for j, (_, owner) in enumerate(self.problem.slots) if owner is None]
        self.labels = [self.problem.labels[j] for j in self._shared]
        low, high = self.problem.box()
        self.lower, self.upper = low[self._shared], high[self._shared]
        self.start = self.problem.start[self._shared]
        of = [profiles[t.id] for t in self.problem.trials]
        self.names = list(dict.fromkeys(of))
        self._members = {name: [k for k, p in enumerate(of) if p == name] for name in self.names}
        self._groups = [self._grouped(k, scales or {}) for k in range(len(of))]
        self.objectives = [
            (name, kind)
            for name in self.names
            for kind in KINDS
            if any(kind in self._groups[k] for k in self._members[name])
        ]

    def _grouped(self, k: int, scales: Mapping[str, float]) -> dict[str, tuple[list[str], list[float]]]:
        """Channels of a trial and their scales, by kind."""
        found: dict[str, tuple[list[str], list[float]]] = {}
        for channel in self.problem.channels[k]:
            kind = kind_of(channel)
            names, sizes = found.setdefault(kind, ([], []))
            names.append(channel)
            sizes.append(scales.get(channel, SCALES[kind]))
        return found

    def of(self, profile: str) -> list[int]:
        """Places of a profile's objectives."""
        return [j for j, (name, _) in enumerate(self.objectives) if name == profile]

    @property
    def columns(self) -> list[str]:
        """Columns of the objectives in a table."""
        return [f"{kind}[{profile}]" for profile, kind in self.objectives]

    @property
    def kinds(self) -> list[str]:
        """Kinds of distance, each once."""
        return list(dict.fromkeys(kind for _, kind in self.objectives))

    def theta(self, point: Array) -> Array:
        """A point with the numbers of single trials, shape (p,)."""
        found = self.problem.start.copy()
        found[self._shared] = point
        return found

    def evaluate(self, points: Array, profile: str | None = None) -> Array:
        """Objectives, shape (n, m), of points, shape (n, d), all or those of one profile.

        In units of the scales; NaN where a simulation breaks down.
        """
        members = [k for name in self.names if profile in (None, name) for k in self._members[name]]
        thetas = [self.theta(p) for p in points]
        runs = iter(self.problem.simulated([(theta, k) for theta in thetas for k in members]))
        return np.array([self._scored({k: next(runs) for k in members}, profile) for _ in points])

    def scored(self, series: Sequence[Series]) -> Array:
        """All objectives of a fit's series, shape (m,); NaN where a trial is not among them."""
        by_trial: dict[str, dict[str, Array]] = {}
        for s in series:
            by_trial.setdefault(s.trial, {})[s.channel] = s.simulated
        known = {k: by_trial[t.id] for k, t in enumerate(self.problem.trials) if t.id in by_trial}
        return np.array(self._scored(known, None))

    def _scored(self, simulated: Mapping[int, Mapping[str, Array]], profile: str | None) -> list[float]:
        found = []
        for name, kind in self.objectives:
            if profile in (None, name):
                parts = [self._distance(k, kind, simulated) for k in self._members[name]]
                found.append(float(np.mean([p for p in parts if p is not None])))
        return found

    def _distance(self, k: int, kind: str, simulated: Mapping[int, Mapping[str, Array]]) -> float | None:
        """One trial's distance; None where it does not measure this."""
        if kind not in self._groups[k]:
            return None
        if k not in simulated:
            return math.nan
        channels, scales = self._groups[k][kind]
        measured = self.problem.trials[k].measured
        return distance(measured, simulated[k], channels, scales, band=self.band)

    def close(self) -> None:
        """End the threads."""
        self.problem.close()
