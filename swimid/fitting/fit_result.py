"""What an output-error fit found: estimates, covariance, noise, and every series beside its simulation."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from swimid.fitting.model import Array, Model, Parameter, Trial

Loss = Literal["linear", "huber"]


@dataclass(frozen=True)
class Noise:
    """Noise of one channel."""

    #: Standard deviation of the measured value, in the channel's unit (root mean square where it differs from
    #: sample to sample).
    value_sd: float
    #: Standard deviation of the time stamps, s; 0 where they are taken as exact.
    time_sd_s: float
    #: Shape (p,): coefficients of the weighted residuals' autoregression; empty where they are white.
    autoregression: Array


@dataclass(frozen=True)
class Series:
    """Measured against simulated for one channel of one trial."""

    trial: str
    role: str
    channel: str
    #: Shape (n,) each: ``sd`` is the standard deviation the noise model gives each sample.
    time_s: Array
    measured: Array
    simulated: Array
    sd: Array

    @property
    def residual(self) -> Array:
        """Measured minus simulated, shape (n,), NaN where missing."""
        return self.measured - self.simulated

    @property
    def weighted(self) -> Array:
        """Residual over its standard deviation, shape (n,)."""
        return self.residual / self.sd


@dataclass(frozen=True)
class FitResult:
    """Estimates, their covariance and all that judges them."""

    model: Model
    #: As fitted, the user's choices applied.
    parameters: tuple[Parameter, ...]
    trials: tuple[Trial, ...]
    #: One per estimated number; a per-trial parameter appears as ``name[trial]``.
    labels: list[str]
    #: Shape (p,).
    estimate: Array
    #: Shape (p, p): rows of parameters at a bound, and of those the trials do not see at all, are NaN.
    covariance: Array
    #: Dict of label to str: ``estimated``, ``at-bound`` or ``unidentifiable``.
    status: dict[str, str]
    #: Fitted and validation trials.
    series: list[Series]
    #: Dict of channel name to Noise.
    noise: dict[str, Noise]
    #: Factor by which the trials scatter more than their noise (1 where they agree); already in the
    #: covariance.
    scatter: float
    #: p-value of the test that they agree.
    scatter_p: float
    samples: int
    converged: bool
    message: str
    #: Simulations of single trials, in all searches and tests that led to the answer; rates of change at
    #: uncertain stamps are not counted.
    evaluations: int
    #: Largest change of a simulated sample when the integration step is halved, in standard deviations of its
    #: noise.
    step_error: float = 0.0
    #: The search was stopped early; the estimate is the best it had come to.
    interrupted: bool = False
    #: Mean squared residual, averaged geometrically over channels of different units: the exponential of
    #: twice the negative log-likelihood per sample, less one. It can be compared between fits of the same
    #: samples, whatever their weights.
    cost: float = math.nan
    #: Shape (q, p): ``information_root' information_root`` is the inverse of the covariance, also where that
    #: is singular; columns of parameters that their bound holds are NaN.
    information_root: Array = field(default_factory=lambda: np.empty((0, 0)))
    #: ``linear`` or ``huber``.
    loss: Loss = "linear"
    #: Derivatives of all residuals taken in them.
    jacobians: int = 0
    #: Mapping of label to float: per-trial parameters of validation trials, estimated from them with the
    #: shared ones held.
    start_states: Mapping[str, float] = field(default_factory=dict)
    #: How often a start near the answer led to a better one, which then took its place; None where that was
    #: not tested.
    restarts: int | None = None
    #: Whether in the end none did any more.
    settled: bool = True

    @property
    def shared(self) -> list[str]:
        """The labels that all trials share."""
        return [label for label in self.labels if "[" not in label]

    def parameter(self, label: str) -> Parameter:
        """The parameter of an estimated number."""
        return next(p for p in self.parameters if p.name == label.split("[")[0])

    def series_of(self, channel: str, role: str | None = None) -> list[Series]:
        """A channel's series, of all trials or of those of one role."""
        return [s for s in self.series if s.channel == channel and role in (None, s.role)]

    def at_estimates(self) -> tuple[Parameter, ...]:
        """The parameters, those that all trials share starting at their estimates."""
        return tuple(p if p.per_trial else replace(p, start=self.value(p.name)) for p in self.parameters)

    def stderr(self, label: str) -> float | None:
        """Standard error of one estimate, or None where there is none."""
        if label not in self.labels:
            return None
        index = self.labels.index(label)
        variance = float(self.covariance[index, index])
        return math.sqrt(variance) if math.isfinite(variance) and variance >= 0 else None

    def value(self, name: str, trial: str | None = None) -> float:
        """Value of a parameter, estimated or fixed; of one trial where it is per trial."""
        label = name if trial is None else f"{name}[{trial}]"
        if label in self.labels:
            return float(self.estimate[self.labels.index(label)])
        if label in self.start_states:
            return self.start_states[label]
        return next(p.start for p in self.parameters if p.name == name)

    def values(self, trial: str) -> Array:
        """Full parameter vector of one trial."""
        return np.array([self.value(p.name, trial if p.per_trial else None) for p in self.parameters])
