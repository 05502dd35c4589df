"""Prepare a diagnosis: select the model parameters to refit, and their priors."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import numpy as np

from swimid.blackbox import model as arx
from swimid.effects.base import Effect
from swimid.files.provenance import digests_of
from swimid.fitting.fit_common import Experiment
from swimid.fitting.model import NONE, Array, Channel, Hooks, Model, Parameter, Trial
from swimid.results.parameters import Estimate, ParameterFile
from swimid.results.result import LOG_ENDINGS
from swimid.simulation.catalogue import Loaded

#: Per-trial parameters of a model that may be random effects, by name. The value gives the typical scale of
#: the random effect: a shared parameter and a fraction of it, or None for the parameter's own scale.
RANDOM_PARAMETERS: dict[str, tuple[str, float] | None] = {
    "friction_deviation": ("pulley_friction", 0.1),
    "relative_drag_deviation": None,
    "start_offset": None,
    "initial_speed": None,
}
#: Per-trial parameters that are random effects only if settings are repeated. Between single trials of
#: different settings, they would absorb any drag that the model lacks.
RANDOM_IN_REPEATS = {"relative_drag_deviation"}
#: Minimum number of trials from which random effects are estimated.
MIN_RANDOM_TRIALS = 3

#: Prior standard deviation of a coefficient that was not estimated from other trials, as a fraction of its
#: value.
OWN_PRIOR = 0.6
#: Additional prior standard deviation of a black-box coefficient, as a fraction of its value. It allows for
#: conditions that differ between days. A change of a black-box coefficient is never a hypothesis, because a
#: single one has no physical meaning.
OTHER_PRIOR = 0.03
#: Additional prior standard deviation of a coefficient whose change is a hypothesis, as a fraction of its
#: value.
#: A smaller change between days is no cause.
OTHER_DAY = 0.01
#: Correlation between the noise of a logged rate and that of the differentiated pose above which the rate
#: counts as computed from the pose.
MAX_RATE_CORRELATION = 0.3
#: Prefix of the names of hypotheses that a parameter has changed. The rest of such a name is the parameter.
PREFIX = "parameter:"
#: Typical scale of a parameter's change since the parameter file was written, as a fraction of its value.
TYPICAL_CHANGE = 0.1


class ParameterChange(Effect):
    """Hypothesis that the value of one model parameter has changed since the parameter file was fitted.

    The change is a separate parameter that is added to the model's parameter. The prior of the model's
    parameter has the standard error of the file. All other parameters keep their priors.

    Parameters
    ----------
    parameter : Parameter
        Parameter of the model. Its start value is the value in the file.
    """

    name: ClassVar[str]
    stage: ClassVar[None] = None  # type: ignore[assignment]
    meaning: ClassVar[str]
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
        """Return the change as a parameter, in the unit of the model's parameter."""
        return (self._change,)

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Return no hooks, because the change is added to the parameter before the simulation."""
        return NONE


@dataclass(frozen=True)
class Preparation:
    """Trials, and priors of the coefficients, at the start of a diagnosis.

    Attributes
    ----------
    trials : list of Trial
        Trials of every role, with all channels that are compared with the model.
    given : dict of name to Estimate
        Coefficients of the parameter file.
    unweighed : dict of name to Estimate
        Coefficients that were estimated from other trials and whose change is not a hypothesis.
    prior : dict of name to (mean, sd)
        Prior of each refitted coefficient.
    changes : list of ParameterChange
        One hypothesis of a changed value for each coefficient whose standard error comes from other trials,
        and for each coefficient of a robot with links that was fixed at a value other than zero.
    correlation : tuple of list of str and ndarray, shape (m, m)
        Names of the estimated coefficients in ``changes``, and the correlation matrix of their estimates.
    """

    trials: list[Trial]
    given: dict[str, Estimate]
    unweighed: dict[str, Estimate]
    prior: dict[str, tuple[float, float]]
    changes: list[ParameterChange]
    correlation: tuple[list[str], Array]


def prepare_diagnosis(loaded: Loaded) -> Preparation:
    """Return trials and priors at the start of a diagnosis, and give the model its refitted parameters."""
    experiment, applied = loaded.experiment, loaded.applied
    model, file = experiment.model, applied.file
    estimates = {} if file is None else file.parameters
    given = {name: e for name, e in estimates.items() if "[" not in name}
    own_data = file is not None and _is_own_data(experiment, file)
    own = applied.list_per_trial()
    if len(experiment.trials) >= MIN_RANDOM_TRIALS:
        # Do not free the per-trial parameters of RANDOM_PARAMETERS. They are random effects in a diagnosis,
        # and without a prior they would absorb any gap.
        own -= RANDOM_PARAMETERS.keys()
    model.parameters = select_refitted(model.parameters, given, applied.values(), own=own)
    known = set() if own_data else _select_known(model, given)
    names, covariance = applied.uncertain()
    mine = [i for i, name in enumerate(names) if name in known]
    sd = np.sqrt(np.diag(covariance))[mine]
    correlation = covariance[np.ix_(mine, mine)] / np.outer(sd, sd)
    return Preparation(
        _list_runs(experiment),
        given,
        {} if own_data else {n: e for n, e in given.items() if n not in known},
        select_priors(model.parameters, given, own_data=own_data, exact=known),
        _list_changes(model, given, known),
        ([names[i] for i in mine], correlation),
    )


def _list_runs(experiment: Experiment) -> list[Trial]:
    """Return the trials with all channels, each row of a table of timed runs as a trial."""
    trials, model = experiment.trials, experiment.model
    if model.timed_runs:
        trials = [run for trial in trials for run in trial.split_rows()]
    return [add_channels(t, model.channels) for t in trials]


def _select_known(model: Model, given: Mapping[str, Estimate]) -> set[str]:
    """Return the refitted coefficients with a standard error, whose change is a hypothesis."""
    if model.name == arx.NAME:
        return set()
    stated = {name for name, e in given.items() if e.stderr and math.isfinite(e.stderr)}
    return {p.name for p in model.parameters if p.free and not p.per_trial and p.name in stated}


def _is_own_data(experiment: Experiment, file: ParameterFile) -> bool:
    """Return whether the parameter file was fitted to logs of these trials."""
    used = set((file.provenance.get("inputs") or {}).values())
    logs = [p for p in experiment.inputs if not isinstance(p, Path) or p.suffix.lower() in LOG_ENDINGS]
    return any(digest in used for digest in digests_of(logs).values())


def _list_changes(
    model: Model, given: Mapping[str, Estimate], known: Collection[str]
) -> list[ParameterChange]:
    """Return one hypothesis of a changed value for each coefficient that is known from other trials.

    The coefficients of a robot with links that were fixed at a value other than zero count as known.
    """
    fixed = set()
    if model.swimmer is not None:
        fixed = {name for name, e in given.items() if e.status == "fixed" and e.value}
    return [ParameterChange(p) for p in model.parameters if p.name in {*known, *fixed} and not p.per_trial]


def select_refitted(
    parameters: Sequence[Parameter], given: Mapping[str, Estimate], values: Array, own: Collection[str] = ()
) -> tuple[Parameter, ...]:
    """Return the model's parameters as the diagnosis refits them.

    Parameters that were estimated in the file are free and start at their estimates. Parameters that were
    fixed in the file stay fixed. Per-trial parameters are free if they are free in the model or listed in
    ``own``.

    Parameters
    ----------
    own : collection of str
        Names of per-trial parameters that the file estimated for some trials.
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


def select_priors(
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
        Whether the file was fitted to these same trials. Its standard errors then do not narrow the prior.
    exact : collection of str
        Names of coefficients whose prior has the standard error of the file. A change of one of them is a
        separate hypothesis.
    """
    found = {}
    for p in parameters:
        if p.per_trial or not p.free:
            continue
        size = max(abs(p.start), 0.1 * p.scale)
        known = given.get(p.name)
        # A fit to these same trials, in which a cause is missing, may have moved a coefficient to its bound.
        is_unknown = known is None or (own_data and known.status == "at-bound")
        sd = OWN_PRIOR * max(size, p.scale if is_unknown else 0.0)
        stderr = known.stderr if known is not None and known.stderr else math.nan
        if p.name in exact:
            sd = min(sd, math.hypot(stderr, OTHER_DAY * size))
        elif math.isfinite(stderr) and not own_data:
            sd = min(sd, math.hypot(stderr, OTHER_PRIOR * size))
        elif math.isfinite(stderr):
            sd = max(sd, 3.0 * stderr)
        found[p.name] = (p.start, sd)
    return found


def add_channels(trial: Trial, channels: Sequence[Channel]) -> Trial:
    """Return a copy of the trial in which all logged channels count as measured.

    Channels that were computed from other channels are left out.
    """
    measured = dict(trial.measured)
    joints_drive = trial.swim.joints is not None
    for channel in channels:
        name = channel.name
        values = trial.inputs.get(name)
        if name in measured or values is None or np.isfinite(values).sum() < 10:
            continue
        is_input = joints_drive if name.startswith("joint") else _is_computed(name, values, trial)
        if not is_input:
            measured[name] = values
    return replace(trial, measured=measured)


def _is_computed(name: str, values: Array, trial: Trial) -> bool:
    """Return whether a logged velocity or rate was computed by differentiation of the logged pose."""
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
        rate = c * vy - s * vx
        if name == "u_m_s":
            rate = c * vx + s * vy
    rough, own = np.diff(rate, 2), np.diff(values, 2)
    there = np.isfinite(rough) & np.isfinite(own)
    if there.sum() < 20 or np.std(own[there]) == 0:
        return True
    return float(abs(np.corrcoef(rough[there], own[there])[0, 1])) > MAX_RATE_CORRELATION
