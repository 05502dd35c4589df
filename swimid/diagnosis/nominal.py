"""Prepare the model for a diagnosis: which parameters are refitted, and their priors."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import numpy as np

from swimid.blackbox import model as arx
from swimid.diagnosis.random_effects import FEWEST, OWN
from swimid.effects.base import Effect
from swimid.files import tabular
from swimid.files.provenance import digests_of
from swimid.fitting.hooks import NONE, Hooks
from swimid.fitting.model import Array, Channel, Model, Parameter, Trial
from swimid.results.parameters import Estimate
from swimid.simulation.catalogue import Loaded

#: Endings of logs among the inputs.
LOGS = (".csv", *tabular.PARQUET)

#: Prior standard deviation of a coefficient that no other trials determine, as a share of its size.
OWN_PRIOR = 0.6
#: Share of its value that is added to the standard error of a black-box coefficient, because days differ. One
#: such coefficient means nothing by itself, so that none is said to have changed.
OTHER_PRIOR = 0.03
#: A rate whose noise follows the differenced pose this closely was computed from it.
DERIVED = 0.3
#: Prefix of the names of these hypotheses; the rest is the name of the parameter.
PREFIX = "parameter:"
#: Typical size of a change, as a share of the parameter's value.
TYPICAL_CHANGE = 0.1


class ParameterChange(Effect):
    """A change of one parameter of the model since the fit that its parameter file comes from.

    The change is a parameter of its own that is added to the model's. The model's parameter itself keeps the
    prior that the standard error of the file gives it. Every other parameter stays as given.

    Parameters
    ----------
    parameter : Parameter
        Parameter of the model; its start is the value in the file.
    """

    name: ClassVar[str]
    stage: ClassVar[None] = None  # type: ignore[assignment]
    meaning: ClassVar[str]
    needs: ClassVar[frozenset[str]] = frozenset()
    smooth: ClassVar[bool] = True

    def __init__(self, parameter: Parameter) -> None:
        vars(self).update(
            name=PREFIX + parameter.name,
            meaning=f"value of {parameter.name} other than the one in the parameter file",
            adds_to=parameter.name,
        )
        size = TYPICAL_CHANGE * abs(parameter.start) or parameter.scale
        self._change = replace(
            parameter,
            name="change",
            lower=parameter.lower - parameter.start,
            upper=parameter.upper - parameter.start,
            start=0.0,
            scale=size,
            free=True,
            known=None,
        )

    def parameters(self, model: Model, trials: Sequence[Trial]) -> tuple[Parameter, ...]:
        """Return the change, in the unit of the parameter."""
        return (self._change,)

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Return no hooks: the change is added to the parameter before the simulation."""
        return NONE

    def variants(self, model: Model, trials: Sequence[Trial]) -> Sequence[Effect]:
        """Return its only form."""
        return [self]

    def content(self) -> bytes:
        """Return its name, which identifies it within one diagnosis."""
        return self.name.encode()


@dataclass(frozen=True)
class Begun:
    """The model's trials and the prior of its coefficients, at the start of a diagnosis.

    Attributes
    ----------
    trials : list of Trial
        Of every role, as they are compared with the model.
    given : dict of name to Estimate
        Coefficients of the parameter file.
    own_data : bool
        Whether the file was fitted to one of these logs.
    prior : dict of name to (mean, sd)
        Of the refitted coefficients.
    changes : list of ParameterChange
        One hypothesis for each coefficient with a standard error from other trials: its value has changed.
    correlation : tuple of list of str and ndarray, shape (m, m)
        Names of these coefficients, and the correlation of their estimates.
    """

    trials: list[Trial]
    given: dict[str, Estimate]
    own_data: bool
    prior: dict[str, tuple[float, float]]
    changes: list[ParameterChange]
    correlation: tuple[list[str], Array]

    @property
    def unweighed(self) -> dict[str, Estimate]:
        """Return coefficients that were estimated from other trials, and whose change is no hypothesis."""
        weighed = {e.adds_to for e in self.changes}
        return {} if self.own_data else {n: e for n, e in self.given.items() if n not in weighed}


def begun(loaded: Loaded) -> Begun:
    """Return trials and priors at the start of a diagnosis; the model gets the refitted parameters."""
    model, applied = loaded.experiment.model, loaded.applied
    given = _given(loaded)
    own = applied.fitted_per_trial()
    if len(loaded.experiment.trials) >= FEWEST:
        # They are random effects here. Free in each trial they would absorb any gap.
        own -= OWN.keys()
    model.parameters = refitted(model.parameters, given, applied.values(), own=own)
    trials = [widened(t, model.channels) for t in apart(model, loaded.experiment.trials)]
    same = _own_data(loaded)
    known = set() if same or model.name == arx.NAME else from_elsewhere(model.parameters, given)
    changes = [ParameterChange(p) for p in model.parameters if p.name in known]
    names, covariance = applied.uncertain()
    mine = [i for i, name in enumerate(names) if name in known]
    sd = np.sqrt(np.diag(covariance))[mine]
    correlation = covariance[np.ix_(mine, mine)] / np.outer(sd, sd)
    before = prior(model.parameters, given, own_data=same, exact=known)
    return Begun(trials, given, same, before, changes, ([names[i] for i in mine], correlation))


def from_elsewhere(parameters: Sequence[Parameter], given: Mapping[str, Estimate]) -> set[str]:
    """Return the names of the shared free coefficients whose standard error the parameter file states."""
    stated = {name for name, e in given.items() if e.stderr and math.isfinite(e.stderr)}
    return {p.name for p in parameters if p.free and not p.per_trial and p.name in stated}


def _given(loaded: Loaded) -> dict[str, Estimate]:
    file = loaded.applied.file
    return {} if file is None else {name: e for name, e in file.parameters.items() if "[" not in name}


def _own_data(loaded: Loaded) -> bool:
    file = loaded.applied.file
    if file is None:
        return False
    known = set((file.provenance.get("inputs") or {}).values())
    logs = [p for p in loaded.experiment.inputs if not isinstance(p, Path) or p.suffix.lower() in LOGS]
    return any(digest in known for digest in digests_of(logs).values())


def refitted(
    parameters: Sequence[Parameter], given: Mapping[str, Estimate], values: Array, own: Collection[str] = ()
) -> tuple[Parameter, ...]:
    """Return the model's parameters as the diagnosis refits them.

    Estimated parameters of the file are free and start at their estimates. Fixed ones stay fixed. Per-trial
    parameters are free if the model says so.

    Parameters
    ----------
    own : collection of str
        Per-trial parameters that the file estimated for some trials.
    """
    found = []
    for p, value in zip(parameters, values, strict=True):
        if p.per_trial:
            found.append(replace(p, free=p.free or p.name in own))
            continue
        known = given.get(p.name)
        free = p.free if known is None else known.status != "fixed"
        start = float(np.clip(value, p.lower, p.upper))
        found.append(replace(p, start=start, free=free))
    return tuple(found)


def prior(
    parameters: Sequence[Parameter],
    given: Mapping[str, Estimate],
    *,
    own_data: bool,
    exact: Collection[str] = (),
) -> dict[str, tuple[float, float]]:
    """Return the prior mean and standard deviation of each refitted coefficient.

    Parameters
    ----------
    own_data : bool
        Whether the file was fitted to these same trials. Then it is no prior.
    exact : collection of str
        Coefficients that keep the standard error of the file. A change of one of them is a hypothesis of its
        own.
    """
    found = {}
    for p in parameters:
        if p.per_trial or not p.free:
            continue
        size = max(abs(p.start), 0.1 * p.scale)
        known = given.get(p.name)
        sd = OWN_PRIOR * max(size, p.scale if known is None else 0.0)
        if p.name in exact and known is not None and known.stderr:
            sd = min(sd, known.stderr)
        elif known is not None and not own_data and known.stderr and math.isfinite(known.stderr):
            sd = min(sd, math.hypot(known.stderr, OTHER_PRIOR * size))
        elif known is not None and known.stderr and math.isfinite(known.stderr):
            sd = max(sd, 3.0 * known.stderr)
        found[p.name] = (p.start, sd)
    return found


def widened(trial: Trial, channels: Sequence[Channel]) -> Trial:
    """Return the trial with every logged channel that is not computed from another."""
    measured = dict(trial.measured)
    joints_drive = trial.swim.joints is not None
    for channel in channels:
        name = channel.name
        values = trial.inputs.get(name)
        if name in measured or values is None or np.isfinite(values).sum() < 10:
            continue
        if name.startswith("joint") and joints_drive:
            continue
        if not name.startswith("joint") and _computed(name, values, trial):
            continue
        measured[name] = values
    return replace(trial, measured=measured)


def _computed(name: str, values: Array, trial: Trial) -> bool:
    """Return whether a velocity was computed from the logged pose."""
    source = {"yaw_rate_rad_s": "yaw_rad", "pitch_rate_rad_s": "pitch_rad"}.get(name)
    heading = next((c for c in ("yaw_rad", "pitch_rad") if c in trial.measured), None)
    time = trial.time_s
    if source is not None:
        if source not in trial.measured:
            return False
        rate = np.gradient(trial.measured[source], time)
    else:
        across = next((c for c in ("y_m", "z_m") if c in trial.measured), None)
        if heading is None or across is None or "x_m" not in trial.measured:
            return False
        vx = np.gradient(trial.measured["x_m"], time)
        vy = np.gradient(trial.measured[across], time)
        c, s = np.cos(trial.measured[heading]), np.sin(trial.measured[heading])
        rate = c * vx + s * vy if name == "u_m_s" else c * vy - s * vx
    rough, own = np.diff(rate, 2), np.diff(values, 2)
    there = np.isfinite(rough) & np.isfinite(own)
    if there.sum() < 20 or np.std(own[there]) == 0:
        return True
    return float(abs(np.corrcoef(rough[there], own[there])[0, 1])) > DERIVED


def apart(model: Model, trials: Sequence[Trial]) -> list[Trial]:
    """Return tables of runs as one trial for each run; other trials as they are."""
    return [run for trial in trials for run in model.apart(trial)]
