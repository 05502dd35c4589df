"""The one interface of every model.

A model is a robot plus an experiment: it has parameters with unit and bounds, output
channels, and it simulates a trial from parameter values. Fitting, comparing, diagnosing and
reporting are written once against this interface; a new model is one new file here.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from swimid.errors import UsageError, nearest, suggestion
from swimid.fitting.hooks import Hooks

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Parameter:
    """One number a fit may estimate.

    Attributes
    ----------
    name, unit : str
        Unit in SI, ``"1"`` where there is none.
    lower, upper : float
        Bounds; infinite where there is none.
    start : float
        Where the search starts, and the value while it is fixed.
    scale : float
        A typical size: sets finite-difference steps, and how large an uncertainty is still
        called an estimate where the value is near zero.
    free : bool
        Estimated unless the user says otherwise.
    per_trial : bool
        Each trial has a value of its own (a start offset, say).
    meaning, source : str
        For the report.
    known : float, optional
        What it was elsewhere: published, or measured otherwise.
    spread : float
        A number of each trial that differs by chance is a random effect: normal about the start with this
        standard deviation. Infinite where nothing is known of it beforehand.
    kinked : bool
        The motion has corners in it (a body that sticks and slips), so that searches are begun from several
        sizes.
    """

    name: str
    unit: str
    lower: float
    upper: float
    start: float
    scale: float
    free: bool = True
    per_trial: bool = False
    meaning: str = ""
    source: str = ""
    known: float | None = None
    spread: float = math.inf
    kinked: bool = False

    @property
    def bounds(self) -> tuple[float | None, float | None]:
        """Bounds with None for infinity, as files hold them."""
        return (
            self.lower if math.isfinite(self.lower) else None,
            self.upper if math.isfinite(self.upper) else None,
        )


@dataclass(frozen=True)
class Channel:
    """One measured and simulated quantity."""

    name: str
    unit: str
    meaning: str = ""


@dataclass(frozen=True)
class Trial:
    """One recorded trial as a model sees it.

    Attributes
    ----------
    id : str
    role : str
        ``"fit"`` or ``"validate"``.
    time_s : ndarray, shape (n,)
    measured : dict of channel name to ndarray, each shape (n,)
        NaN where missing.
    inputs : dict of name to ndarray
        Measured inputs on the same samples.
    settings : dict
        Known constants of this trial (a pulling mass, say), resolved against the robot.
    value_sd : dict of channel name to ndarray or float
        Known shape of the measurement error (its overall size is still estimated). Without it
        and without ``time_sd_s`` the error is taken as constant over each channel.
    time_sd_s : float
        Known standard deviation of the time stamps.
    stamps_uncertain : bool
        The stamps carry an error of unknown size: value and stamp errors are both estimated.
    """

    id: str
    role: str
    time_s: Array
    measured: Mapping[str, Array]
    inputs: Mapping[str, Array] = field(default_factory=dict)
    settings: Mapping[str, Any] = field(default_factory=dict)
    value_sd: Mapping[str, Array | float] = field(default_factory=dict)
    time_sd_s: float = 0.0
    stamps_uncertain: bool = False


class Model(ABC):
    """What a fit, a comparison and a diagnosis need of a model."""

    #: Name in the parameter file.
    name: str
    parameters: tuple[Parameter, ...]
    channels: tuple[Channel, ...]
    #: What a trial's ``time_s`` counts, for axes.
    abscissa: str = "time (s)"
    #: Hooks (:class:`swimid.fitting.hooks.Hooks`) that :meth:`hooked` obeys.
    offers: frozenset[str] = frozenset({"output", "clock"})

    @abstractmethod
    def simulate(self, values: Array, trial: Trial) -> dict[str, Array]:
        """Simulate one trial.

        Parameters
        ----------
        values : ndarray, shape (len(self.parameters),)
            One value per parameter, in the order of :attr:`parameters`; per-trial
            parameters hold this trial's value.
        trial : Trial

        Returns
        -------
        dict of channel name to ndarray, each shape (n,)
            At the trial's sample times. NaN where the model breaks down.
        """

    def hooked(self, values: Array, trial: Trial, hooks: Hooks) -> dict[str, Array]:
        """Simulate one trial with what else acts on the chain.

        A model that offers more than sensing and a late clock overrides this.
        """
        late = replace(trial, time_s=trial.time_s - hooks.clock_s) if hooks.clock_s else trial
        return hooks.seen(self.simulate(values, late), trial.time_s)

    def sensitivity_to_time(self, values: Array, trial: Trial) -> dict[str, Array]:
        """Rate of change of each channel with time, for trials whose stamps are uncertain."""
        step = 1e-4
        late = self.simulate(values, replace(trial, time_s=trial.time_s + step))
        early = self.simulate(values, replace(trial, time_s=np.maximum(trial.time_s - step, 0)))
        width = trial.time_s + step - np.maximum(trial.time_s - step, 0)
        return {name: (late[name] - early[name]) / width for name in late}

    def refined(self) -> Model | None:
        """The same model integrated with half the step; None where nothing is integrated."""
        return None

    def coarser(self) -> Model | None:
        """The same model integrated with twice the step, for searches; None where that gains nothing."""
        return None

    def index(self, name: str) -> int:
        """Position of a parameter by name.

        Raises
        ------
        UsageError
            With the nearest name, when there is none.
        """
        names = [p.name for p in self.parameters]
        if name not in names:
            close = nearest(name, names)
            hint = f"did you mean '{close}'?" if close else f"it has: {', '.join(names)}"
            raise UsageError(f"the model {self.name} has no parameter '{name}'", hint=hint)
        return names.index(name)


def chosen(
    parameters: tuple[Parameter, ...],
    *,
    fixed: Mapping[str, float] | None = None,
    freed: tuple[str, ...] = (),
    bounds: Mapping[str, tuple[float, float]] | None = None,
) -> tuple[Parameter, ...]:
    """The parameters with the user's choices applied: some fixed, some freed, some bounded."""
    fixed = dict(fixed or {})
    bounds = dict(bounds or {})
    names = [p.name for p in parameters]
    for name in (*fixed, *freed, *bounds):
        if name not in names:
            hint = suggestion(name, names)
            raise UsageError(f"there is no parameter '{name}'", hint=hint)
    result = []
    for parameter in parameters:
        if parameter.name in bounds:
            lower, upper = bounds[parameter.name]
            if not lower < upper:
                raise UsageError(f"the bounds of {parameter.name} are the wrong way round: {lower} {upper}")
            start = min(max(parameter.start, lower), upper)
            parameter = replace(parameter, lower=lower, upper=upper, start=start)
        if parameter.name in fixed:
            if not parameter.lower <= fixed[parameter.name] <= parameter.upper:
                raise UsageError(
                    f"{parameter.name} cannot be {fixed[parameter.name]:g}: "
                    f"it lies between {parameter.lower:g} and {parameter.upper:g}"
                )
            parameter = replace(parameter, start=float(fixed[parameter.name]), free=False)
        elif parameter.name in freed:
            parameter = replace(parameter, free=True)
        result.append(parameter)
    return tuple(result)
