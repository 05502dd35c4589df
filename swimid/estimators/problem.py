"""The least-squares problem of an output-error fit: residuals of all trials and their derivatives."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from swimid.estimators.levenberg import Solution, minimise
from swimid.models.base import Array, Model, Parameter, Trial


class Problem:
    """Residuals and their derivatives as functions of the estimated numbers.

    Attributes
    ----------
    labels : list of str, length p
        One per estimated number; a per-trial parameter appears as ``name[trial]``.
    slots : list of (int, int or None), length p
        Parameter of each number, and the trial it belongs to.
    channels : list of list of str
        Channels of each trial that hold samples.
    masks, sd : list of list of ndarray, each shape (n_k,)
        By trial and channel: where samples are, and their standard deviations.
    """

    def __init__(self, model: Model, parameters: Sequence[Parameter], trials: Sequence[Trial]) -> None:
        self.model = model
        self.parameters = list(parameters)
        self.trials = list(trials)
        self.channels = [
            [c.name for c in model.channels if c.name in t.measured and np.isfinite(t.measured[c.name]).any()]
            for t in self.trials
        ]
        self.labels: list[str] = []
        self.slots: list[tuple[int, int | None]] = []  # (parameter, trial or None)
        for index, parameter in enumerate(self.parameters):
            if not parameter.free:
                continue
            owners: list[int | None] = list(range(len(self.trials))) if parameter.per_trial else [None]
            for owner in owners:
                name = parameter.name
                self.labels.append(name if owner is None else f"{name}[{self.trials[owner].id}]")
                self.slots.append((index, owner))
        self.masks = [
            [np.isfinite(t.measured[c]) for c in names]
            for t, names in zip(self.trials, self.channels, strict=True)
        ]
        self.sd = [
            [np.ones(len(t.time_s)) for _ in names]
            for t, names in zip(self.trials, self.channels, strict=True)
        ]
        self.evaluations = 0
        self.base = np.array([p.start for p in self.parameters])
        self.lower = np.array([self.parameters[i].lower for i, _ in self.slots])
        self.upper = np.array([self.parameters[i].upper for i, _ in self.slots])
        self.scale = np.array([self.parameters[i].scale for i, _ in self.slots])
        starts = np.array([self.parameters[i].start for i, _ in self.slots])
        self.start = np.clip(starts, self.lower, self.upper)

    def vector(self, theta: Array, trial: int) -> Array:
        """Full parameter vector of one trial."""
        values = self.base.copy()
        for number, (index, owner) in zip(theta, self.slots, strict=True):
            if owner is None or owner == trial:
                values[index] = number
        return values

    def trial_residuals(self, theta: Array, k: int) -> Array:
        """Weighted residuals of trial ``k``, channel after channel, missing samples left out."""
        trial = self.trials[k]
        simulated = self.model.simulate(self.vector(theta, k), trial)
        self.evaluations += 1
        parts = [
            ((trial.measured[c] - simulated[c]) / sd)[mask]
            for c, sd, mask in zip(self.channels[k], self.sd[k], self.masks[k], strict=True)
        ]
        values = np.concatenate(parts) if parts else np.empty(0)
        # a simulation that broke down costs, it does not crash
        return np.where(np.isfinite(values), values, 1e6)

    def residuals(self, theta: Array) -> Array:
        """Weighted residuals of all trials, shape (n,)."""
        return np.concatenate([self.trial_residuals(theta, k) for k in range(len(self.trials))])

    def trial_jacobians(self, theta: Array, *, central: bool = False) -> list[Array]:
        """Derivative of each trial's residuals, shape (n_k, p) each."""
        jacobians = []
        steps = 1e-6 * np.maximum(np.abs(theta), self.scale)
        if central:
            steps = 1e-5 * np.maximum(np.abs(theta), self.scale)
        # step towards the inside of the bounds
        steps = np.where(theta + steps > self.upper, -steps, steps)
        for k in range(len(self.trials)):
            here = self.trial_residuals(theta, k)
            columns = np.zeros((len(here), len(theta)))
            for j, (_, owner) in enumerate(self.slots):
                if owner is not None and owner != k:
                    continue
                moved = theta.copy()
                moved[j] += steps[j]
                ahead = self.trial_residuals(moved, k)
                inside = self.lower[j] <= theta[j] - steps[j] <= self.upper[j]
                if central and inside:
                    moved[j] = theta[j] - steps[j]
                    columns[:, j] = (ahead - self.trial_residuals(moved, k)) / (2 * steps[j])
                else:
                    columns[:, j] = (ahead - here) / steps[j]
            jacobians.append(columns)
        return jacobians

    def jacobian(self, theta: Array) -> Array:
        """Derivative of all residuals, shape (n, p)."""
        return np.concatenate(self.trial_jacobians(theta))

    def solve(self, theta: Array, *, tolerance: float) -> Solution:
        """Minimise the squared residuals from ``theta`` on, inside the bounds."""
        return minimise(
            self.residuals,
            self.jacobian,
            theta,
            lower=self.lower,
            upper=self.upper,
            scale=self.scale,
            tolerance=tolerance,
        )
