"""Command ``sensitivity``: Sobol indices of the outputs of a robot with respect to its coefficients."""

from __future__ import annotations

import itertools
import math
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

from swimid.errors import NoTrustworthyResult, UsageError, suggestion
from swimid.files import atomic, provenance
from swimid.files.atomic import Checkpoint
from swimid.fitting.fit_common import Experiment
from swimid.fitting.model import Array, Parameter, Trial
from swimid.logs.kinematics import CYCLE_QUANTITIES
from swimid.logs.trials import TrialSet
from swimid.notices import Progress, recorded, silent
from swimid.options import takes
from swimid.results import parameters as parameters_format
from swimid.results.result import FileResult
from swimid.sensitivity_analysis import evidence as sensitivity_evidence
from swimid.sensitivity_analysis.evidence import (
    Index,
    Output,
    Range,
    SensitivityFile,
    Shares,
    Simulations,
)
from swimid.sensitivity_analysis.indices import Sobol, sobol
from swimid.sensitivity_analysis.options import SensitivityOptions
from swimid.simulation import catalogue, compare_series
from swimid.simulation.catalogue import Applied, Quantity, is_possible
from swimid.simulation.swim_quantities import SwimRun, units_of
from swimid.swimmer.model import Swimmer

if TYPE_CHECKING:
    import pandas as pd

#: Maximum ratio of the standard deviation of an output to its mean, for an output that counts as constant.
CONSTANT_SHARE = 1e-9
#: Threshold of the total index: a coefficient is negligible if its 95 % interval lies below this value.
NEGLIGIBLE = 0.01


@dataclass(frozen=True, eq=False)
class Sensitivity(FileResult[SensitivityFile]):
    """Result of ``sensitivity``: Sobol indices of coefficients.

    Attributes
    ----------
    indices : DataFrame
        A row for each coefficient of each output: ``output``, ``trial`` (None for all trials together),
        ``coefficient``, and ``first`` and ``total`` Sobol index (1), each a dict of ``value`` and ``ci95``.
    file : SensitivityFile
        Sensitivity file that :meth:`save` writes, which also has the ranges.
    """

    file_type = SensitivityFile

    @property
    def indices(self) -> pd.DataFrame:
        """Table of Sobol indices, with a row for each coefficient of each output."""
        import pandas as pd

        return pd.DataFrame(
            [
                {"output": o.quantity, "trial": o.trial, "coefficient": name, **index.model_dump()}
                for o in self.file.outputs
                for name, index in o.shares.items()
            ]
        )


class MeasuredChannel(NamedTuple):
    """Measured samples of a channel. The RMS error of a simulation is divided by ``scale``."""

    time_s: Array
    values: Array
    scale: float
    unit: str


@dataclass(frozen=True)
class Run:
    """Trial to simulate, with the data for its outputs.

    Attributes
    ----------
    trial : Trial
        The trial at the times at which it is simulated.
    swim : SwimRun or None
        Last whole cycles of the run; None if measured joints drive the robot.
    measured : mapping of str to MeasuredChannel
    values : ndarray
        Given coefficients, with the start state of the trial.
    """

    trial: Trial
    swim: SwimRun | None
    measured: Mapping[str, MeasuredChannel]
    values: Array

    def outputs(self, model: Swimmer, values: Array, columns: Mapping[str, Array]) -> dict[str, Quantity]:
        """Return the outputs of a simulated run; NaN if the simulation breaks down."""
        outputs: dict[str, Quantity] = {}
        if self.swim is not None:
            known, units = self.swim.quantities(model, values, columns, None), units_of(model)
            for name in _swim_outputs(model, self.swim):
                outputs[name] = known.get(name, Quantity(math.nan, units[name]))
        for name, channel in self.measured.items():
            error = math.nan
            if np.isfinite(columns[name]).all():
                curve = CubicSpline(self.trial.time_s, columns[name])
                error = math.sqrt(float(np.mean((channel.values - curve(channel.time_s)) ** 2)))
            outputs[f"misfit_{name}"] = Quantity(error / channel.scale, channel.unit)
        return outputs


def _swim_outputs(model: Swimmer, swim: SwimRun) -> list[str]:
    """Return the names of the quantities of a swimming run that are outputs of the analysis."""
    if model.in_space:
        return list(CYCLE_QUANTITIES)
    amplitudes = [f"amplitude_{axis.name}_rad" for axis in model.passive]
    if not model.free_base:
        return amplitudes
    turn = model.pose[2].removesuffix("_rad")
    outputs = ["mean_surge_m_s", f"{turn}_range_in_beat_rad", *amplitudes]
    if swim.commanded_turn:
        outputs.append(f"mean_{turn}_rate_rad_s")
    return outputs


@dataclass(frozen=True)
class Study:
    """Setup of an analysis: coefficients with their ranges, runs, and outputs.

    Attributes
    ----------
    columns : sequence of (quantity, trial, unit)
        Quantity, trial and unit of each output, in order.
    centre : ndarray, shape (s,)
        Values of the outputs with the given coefficients.
    """

    applied: Applied
    ranges: Mapping[str, Range]
    runs: Sequence[Run]
    columns: Sequence[tuple[str, str, str]]
    centre: Array

    @property
    def groups(self) -> dict[str, list[int]]:
        """Indices of the outputs of each quantity, for the quantities that more than one trial has."""
        groups: dict[str, list[int]] = {}
        for k, (quantity, _, _) in enumerate(self.columns):
            groups.setdefault(quantity, []).append(k)
        return {quantity: members for quantity, members in groups.items() if len(members) > 1}


@takes(SensitivityOptions)
def sensitivity(
    trials: str | Path | TrialSet,
    *,
    options: SensitivityOptions,
    output: Path | None = None,
    progress: Progress = silent,
) -> Sensitivity:
    """Estimate the sensitivity of the outputs of a robot with links to its coefficients.

    By default, the varied coefficients are those that a fit estimates and those with a given range. A
    parameter file supplies values, standard errors, start states and noise. The indices are valid for the
    given ranges only.

    Parameters
    ----------
    trials : path or TrialSet
        Trials file of a free-swim or multibody experiment, or the trials that :func:`swimid.load` returns.
    output : Path, optional
        Sensitivity file to write. The evidence file is written next to it.
    progress : Progress
        Progress over the simulations.

    Returns
    -------
    Sensitivity
        ``.indices`` has a row for each coefficient of each output: Sobol indices (1) with their 95 %
        intervals.

    Raises
    ------
    UsageError, InputError
        If a file or an option is invalid.
    NoTrustworthyResult
        If more than one in a hundred simulations breaks down.

    References
    ----------
    .. [1] Saltelli, Annoni, Azzini, Campolongo, Ratto, Tarantola (2010), doi:10.1016/j.cpc.2009.09.018: Sobol
       indices.
    .. [2] Gamboa, Janon, Klein, Lagnoux (2014), doi:10.1214/14-EJS895: indices of several outputs together.

    Examples
    --------
    Compare the effect of two coefficients of the tendon fish on its heading:

    >>> found = sensitivity(
    ...     "sample_logs/tfish/trials.yaml",
    ...     samples=8,
    ...     ranges=["20%"],
    ...     coefficients=["c_ma", "c_d4"],
    ... )
    >>> one = found.indices.query("output == 'yaw_range_in_beat_rad' and trial == 'f10a20'")
    >>> max(zip(one["total"].str["value"], one["coefficient"]))[1]
    'c_d4'
    """
    count, params = options.samples, options.params
    with recorded(repeat=True) as notices:
        experiment, applied = _load(trials, options)
        if output is not None:
            atomic.check_writable(output, inputs=experiment.inputs)
        over = _ranges(applied, options.ranges, options.coefficients)
        origin = provenance.collect(experiment.inputs, settings=options.settings())
        keep = Checkpoint.beside(output, [origin["inputs"], origin["settings"]])
        # total simulated time
        ahead_s = sum(float(t.time_s[-1] - t.time_s[0]) for t in experiment.trials) * count * (len(over) + 2)
        _swimmer(applied).prepare(progress, simulated_s=ahead_s, checkpoint=keep)
        study = _study(experiment, applied, over)
        estimates = sobol(
            _evaluation(study),
            np.array([r.low for r in over.values()]),
            np.array([r.high for r in over.values()]),
            samples=count,
            seed=options.seed,
            groups=list(study.groups.values()),
            names=list(over),
            jobs=options.jobs or os.cpu_count() or 1,
            checkpoint=keep,
            progress=progress,
        )
        file = SensitivityFile(
            verdict="caution",
            model=experiment.model.name,
            robot=experiment.robot.name,
            experiment=experiment.name,
            params=parameters_format.place(params).name if params is not None else None,
            samples=count,
            trials=[t.id for t in experiment.trials],
            ranges=over,
            outputs=_outputs(study, estimates),
            simulations=Simulations(
                evaluated=estimates.evaluations, broken=estimates.broken, left_out=estimates.left_out
            ),
            provenance=origin,
        )
        step_change = _step_change(study, estimates)
    evidence = sensitivity_evidence.evidence(file, step_change, _correlated(applied, over), notices)
    evidence.references += experiment.robot.sources
    file.verdict = evidence.verdict.level
    saved = Sensitivity.of(file, evidence).saved(output)
    keep.done()
    return saved


def _load(source: str | Path | TrialSet, options: SensitivityOptions) -> tuple[Experiment, Applied]:
    if options.params is None and options.robot is not None:
        raise UsageError("--robot belongs to --params: the trials file names the robot")
    experiment, applied = catalogue.load(source, options)
    if applied.model.swimmer is None:
        raise UsageError(
            f"a study needs free-swim or multibody trials of a robot with links, not '{experiment.name}'"
        )
    return experiment, applied


def _swimmer(applied: Applied) -> Swimmer:
    """Return the model of a robot with links. :func:`_load` refuses other models."""
    assert applied.model.swimmer is not None
    return applied.model.swimmer


# ------------------------------------------------------------ ranges


def _ranges(applied: Applied, texts: Sequence[str], coefficients: Sequence[str]) -> dict[str, Range]:
    """Return the range of every coefficient that is varied."""
    parts = [text.partition("=") for text in texts]
    own = {name.strip(): _ends(name.strip(), ends) for name, equals, ends in parts if equals}
    rules = [name.strip() for name, equals, _ in parts if not equals] or ["bounds"]
    if len(rules) > 1:
        raise UsageError(f"--range: {' and '.join(rules)} contradict each other")
    shared = {p.name: p for p in applied.model.parameters if not p.per_trial}
    for name in (*own, *coefficients):
        if name not in shared:
            raise UsageError(f"there is no coefficient '{name}'", hint=suggestion(name, list(shared)))
        if name in applied.chosen:
            raise UsageError(f"{name} is held by --set and cannot be varied")
    varied = coefficients or [p.name for p in shared.values() if p.free or p.name in own]
    values = dict(zip([p.name for p in applied.model.parameters], applied.values().tolist(), strict=True))
    names, covariance = applied.uncertain()
    errors = dict(zip(names, np.sqrt(np.diag(covariance)).tolist(), strict=True))
    ranges = {}
    for name, p in shared.items():
        if name not in varied or name in applied.chosen:
            continue
        if name in own:
            low, high, source = *own[name], "given"
        else:
            low, high, source = _by_rule(p, values[name], rules[0], errors)
        if math.isnan(low):
            if coefficients:
                raise UsageError(f"{name} has no standard error to make a range of")
            continue
        if not (math.isfinite(low) and math.isfinite(high)):
            raise UsageError(f"{name} has no bounds", hint=f"give them: --range {name}=LOW,HIGH")
        if not low < high:
            raise UsageError(f"the range of {name} is empty: {low:g} to {high:g}")
        ranges[name] = Range(value=values[name], low=low, high=high, unit=p.unit, source=source)  # type: ignore[arg-type]
    if not ranges:
        raise UsageError("there is no coefficient to vary", hint="name one: --range NAME=LOW,HIGH")
    return ranges


def _ends(name: str, text: str) -> tuple[float, float]:
    """Return the ends of a range from an option ``NAME=LOW,HIGH``."""
    try:
        low, high = (float(part) for part in text.split(","))
    except ValueError:
        raise UsageError(f"--range: '{name}={text}' should be NAME=LOW,HIGH") from None
    return low, high


def _by_rule(p: Parameter, value: float, rule: str, errors: Mapping[str, float]) -> tuple[float, float, str]:
    """Return both ends of a range and the origin of the range; NaN if the standard error is unknown."""
    if rule == "bounds":
        return p.lower, p.upper, rule
    if rule == "stderr":
        if not errors:
            raise UsageError("--range stderr needs a parameter file with standard errors: --params")
        half = 2 * errors.get(p.name, math.nan)
        return max(value - half, p.lower), min(value + half, p.upper), rule
    try:
        share = float(rule.removesuffix("%")) / 100.0
    except ValueError:
        share = math.nan
    if not rule.endswith("%") or not 0 < share < math.inf:
        raise UsageError(f"--range: '{rule}' should be bounds, stderr, 20% or NAME=LOW,HIGH")
    half = share * abs(value)
    if half == 0:
        raise UsageError(
            f"{p.name} is 0, of which no share is a range",
            hint=f"give it one, --range {p.name}=LOW,HIGH, or hold it, --set {p.name}=0",
        )
    return max(value - half, p.lower), min(value + half, p.upper), "share"


def _correlated(applied: Applied, over: Mapping[str, Range]) -> tuple[float, str, str] | None:
    """Return the strongest correlation of two coefficients with ranges from standard errors, with names."""
    names, covariance = applied.uncertain()
    sd = np.sqrt(np.diag(covariance))
    kept = [k for k, name in enumerate(names) if name in over and over[name].source == "stderr"]
    pairs = [
        (float(covariance[i, j] / (sd[i] * sd[j])), names[i], names[j])
        for i, j in itertools.combinations(kept, 2)
    ]
    return max(pairs, key=lambda pair: abs(pair[0]), default=None)


# ------------------------------------------------------------ outputs


def _study(experiment: Experiment, applied: Applied, over: Mapping[str, Range]) -> Study:
    """Return the runs with their start states, and the outputs with the given coefficients."""
    model = _swimmer(applied)
    runs, columns, centre = [], [], []
    for trial in experiment.trials:
        run = _run(applied, model, trial)
        quantities = run.outputs(model, run.values, model.attempt(run.values, run.trial))
        broken = any(not math.isfinite(q.value) for q in quantities.values())
        if broken or not is_possible(model, run.values):
            raise NoTrustworthyResult(
                f"the simulation of '{trial.id}' breaks down with the given coefficients",
                hint="check the parameters and the drive, or take a smaller --dt",
            )
        runs.append(run)
        columns += [(name, trial.id, q.unit) for name, q in quantities.items()]
        centre += [q.value for q in quantities.values()]
    if not columns:
        raise NoTrustworthyResult("these trials have no output: the base is fixed and no joint is passive")
    return Study(applied, over, runs, columns, np.array(centre))


def _run(applied: Applied, model: Swimmer, trial: Trial) -> Run:
    """Return a trial to simulate, with its start state and its measured channels."""
    values, _, _ = compare_series.start_of(applied, trial, refit=bool(trial.measured))
    swim, times = None, trial.time_s
    if trial.swim.drive is not None:
        swim = SwimRun.of(model, trial, trial.swim.drive.frequency_hz)
    if swim is not None:
        times = swim.trial.time_s
    measured, units, noise = {}, {c.name: c.unit for c in model.channels}, applied.noise()
    for name, samples in trial.measured.items():
        known = np.isfinite(samples) & (trial.time_s <= times[-1])
        if known.sum() < 2:
            continue
        scale, unit = 1.0, units[name]
        if noise.get(name, 0.0) > 0:
            scale, unit = noise[name], "1"
        measured[name] = MeasuredChannel(trial.time_s[known], samples[known], scale, unit)
    return Run(replace(trial, time_s=times, measured={}, inputs={}), swim, measured, values)


def _evaluation(study: Study, model: Swimmer | None = None) -> Callable[[Array], Array]:
    """Return the function from coefficients, shape (n, d), to the outputs, shape (n, s).

    Outputs are NaN where a simulation breaks down.
    """
    known = model or _swimmer(study.applied)
    places = [known.index(name) for name in study.ranges]

    def evaluate(points: Array) -> Array:
        vectors = np.repeat(np.array([run.values for run in study.runs])[None], len(points), axis=0)
        vectors[:, :, places] = points[:, None]
        possible = np.array([all(is_possible(known, one) for one in each) for each in vectors])
        pairs = [(one, run) for each in vectors[possible] for one, run in zip(each, study.runs, strict=True)]
        simulated = known.simulate_many([(one, run.trial) for one, run in pairs])
        values = [
            quantity.value
            for (one, run), columns in zip(pairs, simulated, strict=True)
            for quantity in run.outputs(known, one, columns).values()
        ]
        results = np.full((len(points), len(study.columns)), np.nan)
        results[possible] = np.reshape(values, (-1, len(study.columns)))
        return results

    return evaluate


def _step_change(study: Study, estimates: Sobol) -> float:
    """Return the maximum change of an output when the integration step is halved.

    The change is divided by the standard deviation of the output over the ranges.
    """
    finer = _swimmer(study.applied).refined()
    given = np.array([r.value for r in study.ranges.values()])
    change = np.abs(_evaluation(study, finer)(given[None])[0] - study.centre)
    vary = estimates.sd > CONSTANT_SHARE * np.abs(estimates.mean)
    return float(np.max(change[vary] / estimates.sd[vary], initial=0.0))


def _outputs(study: Study, estimates: Sobol) -> list[Output]:
    """Return the outputs of each trial, then the outputs of all trials together, with their indices."""
    statistics = np.column_stack([study.centre, estimates.mean, estimates.sd]).tolist()
    outputs = [
        Output(quantity=quantity, trial=trial, unit=unit, value=value, mean=mean, sd=sd)
        for (quantity, trial, unit), (value, mean, sd) in zip(study.columns, statistics, strict=True)
    ]
    for quantity, members in study.groups.items():
        sd = float(np.sqrt(np.mean(estimates.sd[members] ** 2)))
        outputs.append(Output(quantity=quantity, unit=study.columns[members[0]][2], sd=sd))
    for row, one in enumerate(outputs):
        assert one.sd is not None
        if one.sd > CONSTANT_SHARE * abs(one.mean or 0.0):
            one.shares = {name: _shares(estimates, row, k) for k, name in enumerate(study.ranges)}
    return outputs


def _shares(sobol: Sobol, row: int, k: int) -> Shares:
    first, total = (
        Index(value=float(index[row, k]), ci95=ends[:, row, k].tolist())
        for index, ends in ((sobol.first, sobol.first_ci), (sobol.total, sobol.total_ci))
    )
    negligible = total.ci95[1] < NEGLIGIBLE
    return Shares(first=first, total=total, first_told=first.ci95[0] > 0, negligible=negligible)
