"""Command ``sensitivity``: Sobol indices of the outputs of a robot with respect to its coefficients."""

from __future__ import annotations

import itertools
import math
import os
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy.interpolate import CubicSpline

from swimid.errors import NoTrustworthyResult, UsageError, suggestion
from swimid.files import atomic, provenance, yamlio
from swimid.files.atomic import Checkpoint
from swimid.files.yamlio import Number
from swimid.fitting.fit_common import Experiment
from swimid.fitting.model import Array, Model, Parameter, Trial
from swimid.fitting.problem import choose_step, map_in_threads
from swimid.kinematics.cycles import CYCLE_QUANTITIES
from swimid.logs.trials import TrialSet
from swimid.notices import Notice, Progress, record_warnings, silent
from swimid.options import takes
from swimid.results import evidence as ev
from swimid.results import numbers
from swimid.results import parameters as parameters_format
from swimid.results.result import FileResult
from swimid.sensitivity_analysis.options import SensitivityOptions
from swimid.simulation import catalogue, compare_series
from swimid.simulation.cases import SwimRun, units_of
from swimid.simulation.catalogue import Applied, Quantity, is_possible
from swimid.swimmer.model import Swimmer

if TYPE_CHECKING:
    import pandas as pd

#: Maximum ratio of the standard deviation of an output to its mean at which the output counts as constant.
CONSTANT_SHARE = 1e-9
#: Maximum width of the 95 % interval of a total Sobol index. A wider interval gives a warning.
MAX_WIDTH = 0.3
#: Maximum change of an output when the integration step is halved, divided by the standard deviation of the
#: output over the ranges of the coefficients. A larger change gives a warning.
MAX_STEP_CHANGE = 0.05
#: Maximum correlation between the estimates of two coefficients that are varied independently. A stronger
#: correlation gives a warning.
MAX_ESTIMATE_CORRELATION = 0.5
REFERENCES = [
    "Saltelli, Annoni, Azzini, Campolongo, Ratto, Tarantola (2010): Variance based sensitivity analysis of "
    "model output. Computer Physics Communications 181, doi:10.1016/j.cpc.2009.09.018",
    "Gamboa, Janon, Klein, Lagnoux (2014): Sensitivity analysis for multidimensional and functional outputs. "
    "Electronic Journal of Statistics 8, doi:10.1214/14-EJS895",
]


class Range(yamlio.Document):
    """Range over which an analysis varies a coefficient, and given value of the coefficient."""

    value: float
    low: float
    high: float
    unit: str
    #: Origin of the range: ``bounds`` of the parameter, ``stderr`` (two standard errors on either side),
    #: ``share`` (a fraction of the value on either side), or ``given``.
    source: Literal["bounds", "stderr", "share", "given"]


class Index(yamlio.Document):
    """Sobol index of a coefficient with its 95 % interval."""

    value: float
    ci95: tuple[float, float]


class Shares(yamlio.Document):
    """First-order and total Sobol index of a coefficient for one output.

    The first-order index is the fraction of the output's variance that the coefficient causes alone. The
    total index is the fraction that it causes together with its interactions with other coefficients.
    """

    first: Index
    total: Index


class OutputIndices(yamlio.Document):
    """Simulated output with its Sobol indices.

    The output belongs to one trial or, if ``trial`` is None, to all trials together.
    """

    quantity: str
    unit: str
    trial: str | None = None
    #: Value of the output with the given coefficients; None for all trials together.
    value: Number = None
    #: Mean and standard deviation of the output over the ranges of the coefficients.
    mean: Number = None
    sd: Number = None
    shares: dict[str, Shares] = {}


class Simulations(yamlio.Document):
    """Number of simulated points of the Sobol design, and number of those that diverged."""

    evaluated: int
    broken: int
    #: Number of rows of the Sobol design that were left out because the simulation of one of their points
    #: diverged.
    left_out: int


class SensitivityFile(yamlio.ResultFile):
    """Content of a sensitivity file: Sobol indices of the outputs with respect to the coefficients."""

    kind: ClassVar[str] = "sensitivity file"
    format: Literal["swimid-sensitivity/2"] = "swimid-sensitivity/2"
    verdict: Literal["good", "caution", "bad"]
    model: str
    robot: str
    experiment: str
    params: str | None = None
    #: Number of rows of the Sobol design of the analysis.
    samples: int
    trials: list[str]
    ranges: dict[str, Range]
    outputs: list[OutputIndices]
    simulations: Simulations
    provenance: yamlio.Provenance = Field(default_factory=dict)


class Sensitivity(FileResult[SensitivityFile]):
    """Result of ``sensitivity``: Sobol indices of the coefficients of a robot for each output.

    Attributes
    ----------
    indices : DataFrame
        A row for each coefficient of each output: ``output``, ``trial`` (None for all trials together),
        ``coefficient``, and ``first`` and ``total`` Sobol index (1), each a dict of ``value`` and ``ci95``.
    file : SensitivityFile
        All results, including the ranges of the coefficients. :meth:`save` writes this file.
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
    """Measured samples of one channel of a trial, with which a simulation is compared.

    The root-mean-square error of the simulation is divided by ``scale``. The quotient has the unit ``unit``.
    """

    time_s: Array
    values: Array
    scale: float
    unit: str


@dataclass(frozen=True)
class StudyRun:
    """Trial that is simulated at each point of the design, with the data for its outputs.

    Attributes
    ----------
    trial : Trial
        Trial with the times at which it is simulated, and without its measurements.
    swim : SwimRun or None
        Drive and last whole cycles of the simulation; None if measured joints drive the robot.
    measured : mapping of str to MeasuredChannel
    values : ndarray
        Parameter vector of the model: given coefficients, and initial state of the trial.
    """

    trial: Trial
    swim: SwimRun | None
    measured: Mapping[str, MeasuredChannel]
    values: Array

    def outputs(self, model: Model, values: Array, columns: Mapping[str, Array]) -> dict[str, Quantity]:
        """Return the outputs of the simulated trial by name. They are NaN if the simulation diverges."""
        outputs: dict[str, Quantity] = {}
        if self.swim is not None:
            swimmer: Swimmer = model.swimmer
            known, units = self.swim.quantities(swimmer, values, columns, None), units_of(swimmer)
            for name in _swim_outputs(swimmer, self.swim):
                outputs[name] = Quantity(known.get(name, math.nan), units[name])
        for name, channel in self.measured.items():
            error = math.nan
            if np.isfinite(columns[name]).all():
                curve = CubicSpline(self.trial.time_s, columns[name])
                error = math.sqrt(float(np.mean((channel.values - curve(channel.time_s)) ** 2)))
            outputs[f"misfit_{name}"] = Quantity(error / channel.scale, channel.unit)
        return outputs


def _swim_outputs(model: Swimmer, swim: SwimRun) -> list[str]:
    """Return the names of the quantities of a simulation that are outputs of the sensitivity analysis."""
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
class SensitivityStudy:
    """Setup of a sensitivity analysis: model, ranges of the coefficients, trials to simulate, and outputs.

    Attributes
    ----------
    columns : sequence of (quantity, trial, unit)
        Quantity, trial and unit of each output, in order.
    """

    model: Model
    ranges: Mapping[str, Range]
    runs: Sequence[StudyRun]
    columns: Sequence[tuple[str, str, str]]

    @property
    def groups(self) -> dict[str, list[int]]:
        """Indices in :attr:`columns` of the outputs of each quantity that several trials have."""
        groups: dict[str, list[int]] = {}
        for k, (quantity, _, _) in enumerate(self.columns):
            groups.setdefault(quantity, []).append(k)
        return {quantity: members for quantity, members in groups.items() if len(members) > 1}

    def outputs(self, points: Array) -> Array:
        """Simulate all trials at n points in the space of the coefficients, and return their outputs.

        Points in the space of d coefficients have the shape (n, d), and their s outputs the shape (n, s). The
        outputs of a point are NaN if its coefficients are impossible, or if a simulation diverges.
        """
        vectors = np.repeat(np.array([run.values for run in self.runs])[None], len(points), axis=0)
        vectors[:, :, [self.model.index(name) for name in self.ranges]] = points[:, None]
        possible = np.array([all(is_possible(self.model, one) for one in each) for each in vectors])
        pairs = [(one, run) for each in vectors[possible] for one, run in zip(each, self.runs, strict=True)]
        simulated = self.model.run_many([(one, run.trial) for one, run in pairs])
        values = [
            quantity.value
            for (one, run), columns in zip(pairs, simulated, strict=True)
            for quantity in run.outputs(self.model, one, columns).values()
        ]
        results = np.full((len(points), len(self.columns)), np.nan)
        results[possible] = np.reshape(values, (-1, len(self.columns)))
        return results

    def compute_indices(self, options: SensitivityOptions, keep: Checkpoint, progress: Progress) -> Sobol:
        """Return the Sobol indices of the outputs."""
        return sobol(
            self.outputs,
            np.array([r.low for r in self.ranges.values()]),
            np.array([r.high for r in self.ranges.values()]),
            samples=options.samples,
            seed=options.seed,
            groups=list(self.groups.values()),
            jobs=options.jobs or os.cpu_count() or 1,
            checkpoint=keep,
            progress=progress,
        )

    def test_step(self, estimates: Sobol) -> tuple[Array, float]:
        """Return the outputs at the given values, and their largest change when the step is halved.

        The change is divided by the standard deviation of the output over the ranges.
        """
        given = np.array([[r.value for r in self.ranges.values()]])
        (centre,), finer = self.outputs(given), self.model.refine()
        if finer is None:
            return centre, 0.0
        vary = estimates.sd > CONSTANT_SHARE * np.abs(estimates.mean)
        change = np.abs(replace(self, model=finer).outputs(given)[0] - centre)
        return centre, float(np.max(change[vary] / estimates.sd[vary], initial=0.0))


@takes(SensitivityOptions)
def sensitivity(
    trials: str | Path | TrialSet,
    *,
    options: SensitivityOptions,
    output: Path | None = None,
    progress: Progress = silent,
) -> Sensitivity:
    """Estimate the sensitivity of the outputs of a model to its coefficients.

    By default, the varied coefficients are those that a fit estimates and those with a given range. A
    parameter file supplies values, standard errors, initial states and noise. The indices are valid for the
    given ranges only.

    Parameters
    ----------
    trials : path or TrialSet
        Trials file of any experiment, or the trials that :func:`swimid.load` returns.
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
        If more than one in a hundred simulations diverges.

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
    params = options.params
    with record_warnings(repeat=True) as notices:
        if params is None and options.robot is not None:
            raise UsageError(
                "--robot is valid only with --params: omit it, because the trials file names the robot"
            )
        experiment, applied = catalogue.load(trials, options)
        if output is not None:
            atomic.check_writable(output, inputs=experiment.inputs)
        over = _ranges(applied, options.ranges, options.coefficients)
        origin = provenance.collect(experiment.inputs, settings=options.settings())
        keep = Checkpoint.of_output(output, [origin["inputs"], origin["settings"]])
        applied.model.prepare(progress)
        runs = [(applied.values(trial), trial) for trial in experiment.trials]
        chosen = choose_step(applied.model, runs, [applied.noise()] * len(runs))
        applied = applied.at_step(chosen.model)
        study = _study(experiment, applied, over)
        estimates = study.compute_indices(options, keep, progress)
        centre, step_change = study.test_step(estimates)
        file = SensitivityFile(
            verdict="caution",
            model=applied.model.name,
            robot=experiment.robot.name,
            experiment=experiment.name,
            params=parameters_format.source_path(params).name if params is not None else None,
            samples=options.samples,
            trials=[t.id for t in experiment.trials],
            ranges=over,
            outputs=_outputs(study, centre, estimates),
            simulations=Simulations(
                evaluated=estimates.evaluations, broken=estimates.broken, left_out=estimates.left_out
            ),
            provenance=origin,
        )
    strongest, source = _find_correlation(applied, over), f"those of {experiment.values_from}"
    evidence = _make_evidence(file, step_change, strongest, source, notices)
    evidence.references += experiment.robot.sources
    file.verdict = evidence.verdict.level
    saved = Sensitivity.of(file, evidence).write_output(output)
    keep.finish()
    return saved


def _make_evidence(
    file: SensitivityFile,
    step_change: float,
    strongest: tuple[float, str, str] | None,
    source: str,
    notices: Sequence[Notice],
) -> ev.Evidence:
    """Return the verdict, the checks, the tables and the figure of a sensitivity analysis.

    Parameters
    ----------
    step_change : float
            Largest change of an output when the integration step is halved, divided by its standard deviation
            over the ranges.
    strongest : (float, str, str) or None
            Strongest correlation between the estimates of two coefficients, and the names of the two.
    source : str
            Text that names the source of the values if there is no parameter file.
    """
    checks = _checks(file, step_change, strongest)
    return ev.Evidence(
        command="sensitivity",
        title=f"Sensitivity of {file.robot}, {file.experiment}",
        verdict=ev.make_verdict(_answer(file), checks),
        facts={
            "Robot": file.robot,
            "Parameters": file.params or source,
            "Trials": str(len(file.trials)),
            "Method": f"Sobol, {file.samples} rows ({file.simulations.evaluated} points)",
        },
        checks=checks,
        tables=[_totals(file), _range_table(file)],
        figures=[_map(file)],
        notices=list(notices),
        methods=[_method(file)],
        references=[*REFERENCES],
        provenance=file.provenance,
    )


# ------------------------------------------------------------ ranges


def _ranges(applied: Applied, texts: Sequence[str], coefficients: Sequence[str]) -> dict[str, Range]:
    """Return the range of every coefficient that the analysis varies."""
    rules = [text.strip() for text in texts if "=" not in text]
    pairs = [text.partition("=") for text in texts if "=" in text]
    own = {name.strip(): _ends(name.strip(), ends) for name, _, ends in pairs}
    shared = {p.name: p for p in applied.model.parameters if not p.per_trial}
    _refuse_names((*own, *coefficients), shared, applied.chosen)
    names, covariance = applied.uncertain()
    errors = dict(zip(names, np.sqrt(np.diag(covariance)).tolist(), strict=True))
    ranges = {}
    for name in coefficients or [p.name for p in shared.values() if p.free or p.name in own]:
        if name in applied.chosen:
            continue
        value = float(applied.values()[applied.model.index(name)])
        half, source = _half_width((rules or ["bounds"])[-1], value, errors.get(name, math.nan))
        ends = max(value - half, shared[name].lower), min(value + half, shared[name].upper)
        if name in own:
            ends, source = own[name], "given"
        elif math.isnan(half) and coefficients:
            text = f"{name} has no standard error, from which its range would be computed"
            raise UsageError(text, hint=f"give the range: --range {name}=LOW,HIGH")
        if name in own or not math.isnan(half):
            ranges[name] = _make_range(shared[name], value, *ends, source)
    if not ranges:
        hint = "give a range, --range NAME=LOW,HIGH, or a parameter file with standard errors, --params"
        raise UsageError("no coefficient has a range or a standard error", hint=hint)
    return {name: ranges[name] for name in shared if name in ranges}


def _refuse_names(names: Sequence[str], shared: Collection[str], held: Collection[str]) -> None:
    """Refuse coefficients that the model does not have, or that ``--set`` holds."""
    for name in names:
        if name not in shared:
            hint = suggestion(name, list(shared), "it has")
            raise UsageError(f"the model has no coefficient '{name}'", hint=hint)
        if name in held:
            raise UsageError(f"{name} is fixed by --set and cannot be varied: omit either")


def _make_range(p: Parameter, value: float, low: float, high: float, source: str) -> Range:
    """Return the range of a coefficient."""
    if not (math.isfinite(low) and math.isfinite(high)):
        raise UsageError(f"{p.name} has no bounds", hint=f"give the bounds: --range {p.name}=LOW,HIGH")
    if not low < high:
        hint = f"give another range, --range {p.name}=LOW,HIGH, or fix the value, --set {p.name}={value:g}"
        raise UsageError(f"the range of {p.name} is empty: {low:g} to {high:g}", hint=hint)
    return Range(value=value, low=low, high=high, unit=p.unit, source=source)  # type: ignore[arg-type]


def _ends(name: str, text: str) -> tuple[float, float]:
    """Return the ends of a range from the text ``LOW,HIGH`` of an option ``NAME=LOW,HIGH``."""
    try:
        low, high = (float(part) for part in text.split(","))
    except ValueError:
        raise UsageError(f"--range: '{name}={text}' should be NAME=LOW,HIGH") from None
    return low, high


def _half_width(rule: str, value: float, stderr: float) -> tuple[float, str]:
    """Return half the width of a coefficient's range by a rule of ``--range``, and the kind of rule.

    The half-width is NaN if the rule needs a standard error that is unknown (NaN).
    """
    if rule == "bounds":
        return math.inf, rule
    if rule == "stderr":
        return 2 * stderr, rule
    try:
        share = float(rule.removesuffix("%")) / 100.0
    except ValueError:
        share = math.nan
    if not rule.endswith("%") or not 0 < share < math.inf:
        raise UsageError(f"--range: '{rule}' should be bounds, stderr, 20% or NAME=LOW,HIGH")
    return share * abs(value), "share"


def _find_correlation(applied: Applied, over: Mapping[str, Range]) -> tuple[float, str, str] | None:
    """Return the strongest correlation between the estimates of two coefficients, and their names.

    Only coefficients whose ranges follow from their standard errors are compared. The result is None if there
    are fewer than two such coefficients.
    """
    names, covariance = applied.uncertain()
    sd = np.sqrt(np.diag(covariance))
    kept = [k for k, name in enumerate(names) if name in over and over[name].source == "stderr"]
    pairs = [
        (float(covariance[i, j] / (sd[i] * sd[j])), names[i], names[j])
        for i, j in itertools.combinations(kept, 2)
    ]
    return max(pairs, key=lambda pair: abs(pair[0]), default=None)


# ------------------------------------------------------------ outputs


def _study(experiment: Experiment, applied: Applied, over: Mapping[str, Range]) -> SensitivityStudy:
    """Return the setup of an analysis: the trials with their initial states, and the outputs of each trial.

    An error is raised if a simulation with the given coefficients diverges.
    """
    model = applied.model
    runs, columns = [], []
    for trial in experiment.trials:
        run = _run(applied, model, trial)
        quantities = run.outputs(model, run.values, model.run(run.values, run.trial))
        broken = any(not math.isfinite(q.value) for q in quantities.values())
        if broken or not is_possible(model, run.values):
            raise NoTrustworthyResult(
                f"the simulation of '{trial.id}' diverges with the given coefficients",
                hint="check the parameters and the drive, or take a smaller --dt",
            )
        runs.append(run)
        columns += [(name, trial.id, q.unit) for name, q in quantities.items()]
    if not columns:
        raise NoTrustworthyResult("these trials have no output: the base is fixed and no joint is passive")
    return SensitivityStudy(model, over, runs, columns)


def _run(applied: Applied, model: Model, trial: Trial) -> StudyRun:
    """Return a trial prepared for simulation, with its initial state and its measured channels."""
    values, _, _ = compare_series.start_of(applied, trial, refit=bool(trial.measured))
    swim, times = None, trial.time_s
    if model.swimmer is not None and trial.swim.drive is not None:
        swim = SwimRun.of(model.swimmer, trial, trial.swim.drive.frequency_hz)
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
    if swim is not None:
        trial = replace(trial, time_s=times, measured={}, inputs={})
    return StudyRun(trial, swim, measured, values)


def _outputs(study: SensitivityStudy, centre: Array, estimates: Sobol) -> list[OutputIndices]:
    """Return the outputs of each trial, and then those of all trials together, with their Sobol indices."""
    statistics = np.column_stack([centre, estimates.mean, estimates.sd]).tolist()
    outputs = [
        OutputIndices(quantity=quantity, trial=trial, unit=unit, value=value, mean=mean, sd=sd)
        for (quantity, trial, unit), (value, mean, sd) in zip(study.columns, statistics, strict=True)
    ]
    for quantity, members in study.groups.items():
        sd = float(np.sqrt(np.mean(estimates.sd[members] ** 2)))
        outputs.append(OutputIndices(quantity=quantity, unit=study.columns[members[0]][2], sd=sd))
    for row, one in enumerate(outputs):
        assert one.sd is not None
        if one.sd > CONSTANT_SHARE * abs(one.mean or 0.0):
            one.shares = {name: _shares(estimates, row, k) for k, name in enumerate(study.ranges)}
    return outputs


def _shares(sobol: Sobol, row: int, k: int) -> Shares:
    def index(values: Array, ends: Array) -> Index:
        return Index(value=float(values[row, k]), ci95=ends[:, row, k].tolist())

    return Shares(first=index(sobol.first, sobol.first_ci), total=index(sobol.total, sobol.total_ci))


# ------------------------------------------------------------ evidence


def _headline(file: SensitivityFile) -> list[OutputIndices]:
    """Return one output for each quantity: that of all trials together, or that of the only trial."""
    outputs: dict[str, OutputIndices] = {}
    for one in file.outputs:
        if one.trial is None or one.quantity not in outputs:
            outputs[one.quantity] = one
    return list(outputs.values())


def _rank_coefficients(output: OutputIndices) -> list[tuple[str, Index]]:
    """Return the coefficients with their total indices for an output, largest index first."""
    entries = [(name, shares.total) for name, shares in output.shares.items()]
    return sorted(entries, key=lambda item: -item[1].value)


def _checks(
    file: SensitivityFile, step_change: float, strongest: tuple[float, str, str] | None
) -> list[ev.Check]:
    """Return the checks of a sensitivity analysis for its evidence.

    Parameters
    ----------
    step_change : float
        Maximum change of an output when the integration step is halved, divided by the standard deviation of
        the output over the ranges.
    strongest : (correlation, name, name) or None
        Strongest correlation between the estimates of two coefficients whose ranges follow from their
        standard errors, and the names of the two.
    """
    runs = file.simulations
    totals = [(name, o.quantity, index) for o in _headline(file) for name, index in _rank_coefficients(o)]
    widths = [(index.ci95[1] - index.ci95[0], f"{name} in {output}") for name, output, index in totals]
    width, where = max(widths, default=(0.0, ""))
    left_out = f"{runs.left_out} rows of the design left out" * bool(runs.broken)
    samples = f"{where}: take more --samples" * bool(width > MAX_WIDTH)
    broken, wide = f"{runs.broken} of {runs.evaluated}", f"at most {numbers.format_number(width, 2)} wide"
    change, steady = f"{numbers.format_number(step_change, 2)} sd", step_change <= MAX_STEP_CHANGE
    halved = "maximum change of an output when the step is halved, over its deviation in the ranges"
    none, limit = "none (refused above 1 %)", f"≤ {MAX_WIDTH:g}"
    lost = f"{broken} simulations diverged"
    unclear = f"the interval of the index of {where} is too wide, {numbers.format_number(width, 2)}"
    coarse = f"halving the integration step changes an output by {change} over the ranges"
    checks = [
        ev.make_check("simulations that diverged", broken, not runs.broken, none, left_out, reason=lost),
        ev.make_check("narrow intervals", wide, width <= MAX_WIDTH, limit, samples, reason=unclear),
        ev.make_check("integration step", change, steady, f"≤ {MAX_STEP_CHANGE:g} sd", halved, reason=coarse),
    ]
    if strongest is not None:
        size, one, other = strongest
        value = f"correlation up to {numbers.format_number(size, 2)} ({one}, {other})"
        sound = abs(size) <= MAX_ESTIMATE_CORRELATION
        text = "independent ranges contain values that the correlated estimates exclude" * (not sound)
        limit = f"≤ {MAX_ESTIMATE_CORRELATION:g} in size"
        reason = f"the estimates of {one} and {other} are correlated, but their ranges are independent"
        checks.append(ev.make_check("ranges independent", value, sound, limit, text, reason=reason))
    return checks


def _answer(file: SensitivityFile) -> str:
    """Return a sentence with the most influential coefficients of the first three outputs."""
    parts = []
    for o in _headline(file)[:3]:
        named = [
            f"{name} ({numbers.format_number(index.value, 2)})" for name, index in _rank_coefficients(o)[:2]
        ]
        if named:
            parts.append(f"{o.quantity} is most sensitive to {', '.join(named)}")
    return "; ".join(parts) + "."


# ------------------------------------------------------------ tables


def _totals(file: SensitivityFile) -> ev.Table:
    """Return a table of the three coefficients with the largest total indices for each output."""
    ranks = ("largest", "second", "third")
    rows: list[dict[str, ev.Cell]] = []
    for o in _headline(file):
        row: dict[str, ev.Cell] = {"output": o.quantity, **dict.fromkeys(ranks, "")}
        for rank, (name, index) in zip(ranks, _rank_coefficients(o), strict=False):
            low, high = (numbers.format_number(end, 2) for end in index.ci95)
            row[rank] = f"{name} {numbers.format_number(index.value, 2)} ({low} … {high})"
        rows.append(row)
    return ev.make_table("totals", "Total indices, 95 %", rows)


def _range_table(file: SensitivityFile) -> ev.Table:
    rows: list[dict[str, ev.Cell]] = [
        {
            "coefficient": name,
            "given": numbers.format_number(r.value),
            "from": numbers.format_number(r.low),
            "to": numbers.format_number(r.high),
            "unit": numbers.unit_text(r.unit),
            "range": r.source,
        }
        for name, r in file.ranges.items()
    ]
    caption = "Uniform and independent of each other; a wider range of a coefficient raises its share."
    return ev.make_table("ranges", "Ranges of the coefficients", rows, caption)


# ------------------------------------------------------------ figures


def _map(file: SensitivityFile) -> ev.Figure:
    outputs = [o for o in _headline(file) if o.shares]
    names = list(file.ranges)
    values = [[round(o.shares[name].total.value, 2) for name in names] for o in outputs]
    heat = ev.Heat(rows=[o.quantity for o in outputs], columns=names, values=values, scale="linear")  # type: ignore[arg-type]
    caption = "Total Sobol indices: the share of an output's variance that a coefficient takes part in."
    title = "Sensitivity of each output"
    return ev.panels("indices", title, caption, [ev.panel("", "", [], heat=heat)])


def _method(file: SensitivityFile) -> str:
    """Return a sentence that describes the sensitivity analysis, for the methods section of a paper."""
    runs, trials = file.simulations, f"{len(file.trials)} {file.experiment} trials"
    return (
        f"First-order and total Sobol indices of the outputs of {trials} to {', '.join(file.ranges)}, "
        f"independent and uniform over their ranges, were estimated from {file.samples} rows of a scrambled "
        f"Sobol sequence ({runs.evaluated} points, {runs.broken} of which diverged) by the estimators of "
        "Saltelli et al. (2010), with intervals by the jackknife over "
        "independently scrambled parts of the design; those of all trials together "
        "are shares of their summed variance (Gamboa et al. 2014)."
    )


# ---------------------------------------------------------------- Sobol indices


#: Maximum fraction of the model evaluations that may diverge. With a larger fraction the analysis fails.
MAX_BROKEN_SHARE = 0.01
#: Number of points of the Sobol design that are evaluated in one call of the model function.
ROWS_PER_BATCH = 8
#: Maximum number of independently scrambled parts of the design. The intervals of the indices follow from the
#: differences between these parts.
MAX_PARTS = 8

#: Type of the model function. Its argument is an array of n points in the space of the d parameters, shape
#: (n, d). It returns s outputs for each point, shape (n, s), which are NaN if the model diverges.
Evaluate = Callable[[Array], Array]


@dataclass(frozen=True)
class Sobol:
    """Sobol indices of s outputs, followed by g groups of outputs, with respect to d parameters.

    Attributes
    ----------
    mean, sd : ndarray, shape (s,)
        Mean and standard deviation of each output over the ranges of the parameters.
    evaluations, broken, left_out : int
        Number of evaluations, number of evaluations that diverged, and number of rows of the design that
        were left out.
    first, total : ndarray, shape (s + g, d)
        First-order and total indices.
    first_ci, total_ci : ndarray, shape (2, s + g, d)
        Ends of the 95 % intervals of the first-order and total indices.
    """

    mean: Array
    sd: Array
    evaluations: int
    broken: int
    left_out: int
    first: Array
    total: Array
    first_ci: Array
    total_ci: Array


def sobol(
    evaluate: Evaluate,
    lower: Array,
    upper: Array,
    *,
    samples: int = 256,
    seed: int = 0,
    groups: Sequence[Sequence[int]] = (),
    jobs: int = 1,
    checkpoint: Checkpoint | None = None,
    progress: Progress = silent,
) -> Sobol:
    """Estimate first-order and total Sobol indices (Saltelli et al. 2010, doi:10.1016/j.cpc.2009.09.018).

    Parameters
    ----------
    evaluate : callable
        Function from points to outputs, which is called from several threads.
    lower, upper : ndarray, shape (d,), d >= 2
        Lower and upper ends of the ranges of the parameters, which are uniformly distributed.
    samples : int
        Number of rows of the design, a power of two. Each row has d + 2 points.
    seed : int
        Seed of the scrambled Sobol sequences.
    groups : sequence of sequences of int
        Groups of outputs. The indices of a group refer to the sum of the variances of its outputs (Gamboa et
        al. 2014, doi:10.1214/14-EJS895).
    jobs : int
        Number of threads. The result does not depend on it.
    checkpoint : Checkpoint, optional
        File in which the outputs are stored, so that an interrupted run can be continued.
    progress : Progress

    Returns
    -------
    Sobol
        Indices of the whole design, with intervals from the jackknife over its parts. Rows with a point that
        diverges are left out.

    Raises
    ------
    UsageError
        If there are fewer than two parameters, or the number of samples is not a power of two.
    NoTrustworthyResult
        If more than :data:`MAX_BROKEN_SHARE` of the evaluations diverge.
    """
    from scipy import stats

    d = len(lower)
    if d < 2:
        raise UsageError("Sobol indices share an output's variance between parameters: vary two or more")
    if samples < 2 or samples & (samples - 1):
        raise UsageError(f"the number of samples must be a power of two, not {samples}")
    number = min(MAX_PARTS, samples)
    points = _make_design(lower, upper, samples, number, seed)
    results, broken = _evaluate_design(evaluate, points, jobs, checkpoint or Checkpoint(), progress)
    values = results.reshape(samples, d + 2, -1)
    sound = np.isfinite(values).all(axis=(1, 2))
    outputs = np.moveaxis(values[sound], 0, -1)  # shape (d + 2, s, rows)
    both = outputs[:2].transpose(1, 0, 2).reshape(outputs.shape[1], -1)
    mean, sd = both.mean(axis=1), both.std(axis=1)
    outputs = outputs - mean[:, None]
    part = np.repeat(np.arange(number), samples // number)[sound]
    found = _indices(outputs, groups)
    left = len(np.unique(part))
    half = stats.t.ppf(0.975, left - 1) * _jackknife_error(outputs, part, groups)
    ends = np.stack([found - half, found + half], axis=1)
    left_out = samples - outputs.shape[-1]
    return Sobol(mean, sd, len(points), broken, left_out, *found, *ends)


def _make_design(lower: Array, upper: Array, samples: int, parts: int, seed: int) -> Array:
    """Return the points of the design, shape (samples (d + 2), d), from scrambled Sobol sequences."""
    from scipy.stats import qmc

    d = len(lower)
    unit = np.concatenate([
        qmc.Sobol(2 * d, scramble=True, bits=64, rng=rng).random(samples // parts)
        for rng in np.random.default_rng(seed).spawn(parts)
    ])  # fmt: skip
    a, b = (lower + part * (upper - lower) for part in (unit[:, :d], unit[:, d:]))
    design = np.concatenate([a[:, None], b[:, None], np.repeat(a[:, None], d, axis=1)], axis=1)
    design[:, 2 + np.arange(d), np.arange(d)] = b
    return design.reshape(-1, d)


def _evaluate_design(
    evaluate: Evaluate, points: Array, jobs: int, keep: Checkpoint, progress: Progress
) -> tuple[Array, int]:
    """Return the outputs at all points of the design, and how many evaluations diverged."""
    parts = [points[k : k + ROWS_PER_BATCH] for k in range(0, len(points), ROWS_PER_BATCH)]
    broken, done = 0, list[Array]()

    def compute_part(k: int) -> Array:
        outputs = keep.get_or_compute(f"points {k}", lambda: evaluate(parts[k]).ravel())
        return outputs.reshape(len(parts[k]), -1)

    with (
        progress("sensitivity", total=len(parts)) as step,
        map_in_threads(compute_part, range(len(parts)), jobs) as results,
    ):
        for outputs in results:
            done.append(outputs)
            broken += int((~np.isfinite(outputs).all(axis=1)).sum())
            if broken > MAX_BROKEN_SHARE * len(points):
                raise NoTrustworthyResult(
                    f"{broken} of the first {sum(map(len, done))} simulations diverge, more than "
                    f"{100 * MAX_BROKEN_SHARE:g} % of all",
                    hint="narrow the ranges (--range NAME=LOW,HIGH), or take a smaller step (--dt)",
                )
            step()
    return np.concatenate(done), broken


def _jackknife_error(outputs: Array, part: NDArray[np.int64], groups: Sequence[Sequence[int]]) -> Array:
    """Return the jackknife standard errors of the indices, shape (2, s + g, d).

    The errors follow from estimates that leave out one part of the design in turn. The first axis holds
    first-order and total indices, the second one s outputs and g groups of outputs, the third one d
    parameters. A bootstrap over the rows would give too wide intervals, because the rows of one Sobol
    sequence are not independent. The parts are independent.
    """
    without = np.array([_indices(outputs[..., part != k], groups) for k in np.unique(part)])
    number = len(without)
    return np.sqrt((number - 1) / number * ((without - without.mean(axis=0)) ** 2).sum(axis=0))


def _indices(outputs: Array, groups: Sequence[Sequence[int]]) -> Array:
    """Return first-order and total indices of outputs and of groups of outputs, shape (2, s + g, d).

    The outputs of n rows of the design have the shape (d + 2, s, n). The estimators are those of
    ``scipy.stats.sobol_indices``, which requires that the number of rows is a power of two. The indices of a
    group are the mean indices of its outputs, weighted by the variances of the outputs.
    """
    a, b, ab = outputs[0], outputs[1], outputs[2:]
    mean, variance = np.mean([a, b], axis=(0, -1)), np.var([a, b], axis=(0, -1))
    with np.errstate(invalid="ignore", divide="ignore"):
        first = np.mean((b - mean[:, None]) * (ab - a), axis=-1) / variance
        total = 0.5 * np.mean((a - ab) ** 2, axis=-1) / variance
    # Set the indices of an output without variance to zero.
    indices = np.nan_to_num([first.T, total.T], posinf=0.0, neginf=0.0)
    parts = [indices]
    for members in groups:
        weights = variance[list(members)]
        weights = weights / max(weights.sum(), np.finfo(float).tiny)
        parts.append(np.einsum("m,kmd->kd", weights, indices[:, list(members)])[:, None])
    return np.concatenate(parts, axis=1)
