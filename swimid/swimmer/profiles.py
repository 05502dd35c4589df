"""How far a model is from its trials, motion profile by motion profile, as objectives of a search."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from swimid.fitting import warping
from swimid.fitting.fit_result import Series
from swimid.fitting.model import Array, Model, Parameter, Trial
from swimid.fitting.problem import Problem


class Profiles:
    """Distances of the simulated trials from the measured ones, a mean for each motion profile.

    A point of the search holds the shared coefficients; what belongs to single trials stays where their logs
    put it.

    Parameters
    ----------
    model : Model
    parameters : sequence of Parameter
        Those that are free and shared are searched.
    trials : sequence of Trial
        Those of role ``fit`` count.
    profiles : mapping of trial id to str
        The motion profile of each.
    scales : mapping of channel to float
        What an error of a channel counts as one, other than :data:`warping.SCALES`.
    band : float
        By what share of a record the two may be shifted.
    jobs : int
        Threads.

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
        band: float = warping.BAND,
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
            for kind in warping.KINDS
            if any(kind in self._groups[k] for k in self._members[name])
        ]

    def _grouped(self, k: int, scales: Mapping[str, float]) -> dict[str, tuple[list[str], list[float]]]:
        """Channels of a trial and their scales, by kind."""
        found: dict[str, tuple[list[str], list[float]]] = {}
        for channel in self.problem.channels[k]:
            kind = warping.kind_of(channel)
            names, sizes = found.setdefault(kind, ([], []))
            names.append(channel)
            sizes.append(scales.get(channel, warping.SCALES[kind]))
        return found

    def theta(self, point: Array) -> Array:
        """A point with the numbers of single trials, shape (p,)."""
        found = self.problem.start.copy()
        found[self._shared] = point
        return found

    def evaluate(self, points: Array, profile: str | None = None) -> Array:
        """Objectives of points, all or those of one profile.

        Parameters
        ----------
        points : ndarray, shape (n, d)

        Returns
        -------
        ndarray, shape (n, m)
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
        return warping.distance(measured, simulated[k], channels, scales, band=self.band)

    def close(self) -> None:
        """End the threads."""
        self.problem.close()
