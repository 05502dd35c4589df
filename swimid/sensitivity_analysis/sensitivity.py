"""``sensitivity``: what each output is most sensitive to, and how outputs change with the drive."""

from __future__ import annotations

import itertools
import math
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from swimid.errors import NoTrustworthyResult, UsageError, suggestion
from swimid.files import atomic, provenance
from swimid.files.checkpoint import Checkpoint
from swimid.fitting.experiment import Experiment
from swimid.fitting.model import Array, Parameter, Trial
from swimid.fitting.parallel import in_threads
from swimid.logs.trials import TrialSet
from swimid.notices import recorded
from swimid.options import takes
from swimid.progress import Progress, silent
from swimid.results import blocks
from swimid.results import evidence as ev
from swimid.results import parameters as parameters_format
from swimid.results.result import FileResult
from swimid.sensitivity_analysis import evidence as sensitivity_evidence
from swimid.sensitivity_analysis import indices
from swimid.sensitivity_analysis import outputs as sensitivity_outputs
from swimid.sensitivity_analysis.file import (
    FORMAT,
    Axis,
    Effects,
    Index,
    Measured,
    MeasuredChannel,
    Output,
    Range,
    SensitivityFile,
    Shares,
    Simulations,
    Sweep,
    SweptOutput,
)
from swimid.sensitivity_analysis.indices import Morris, Sobol
from swimid.sensitivity_analysis.options import SensitivityOptions
from swimid.sensitivity_analysis.outputs import Run
from swimid.simulation import catalogue, compare_series
from swimid.simulation.applied import Applied, Quantity
from swimid.swimmer import trials as swimmer
from swimid.swimmer.model import Swimmer

if TYPE_CHECKING:
    import pandas as pd

#: Rows of the design, or trajectories, where nothing else is asked for.
SAMPLES = {"sobol": 256, "morris": 32, "none": 0}
#: A total index whose interval lies below this is negligible.
NEGLIGIBLE = 0.01
#: An output that varies less than this share of its size does not vary.
CONSTANT = 1e-9
#: Points of a sweep at most.
MOST_POINTS = 10_000


@dataclass(frozen=True, eq=False)
class Sensitivity(FileResult[SensitivityFile]):
    """Sensitivity indices of coefficients, and outputs over a grid of drives, as ``sensitivity`` gives them.

    Attributes
    ----------
    indices : DataFrame
        A row for each coefficient of each output (``output``, ``trial``, ``coefficient``; without a trial of
        all together): ``first`` and ``total`` Sobol index (1), each a dict of ``value`` and ``ci95``; or by
        Morris ``mu``, ``mu_star``, ``mu_star_ci95`` and ``sigma``, in the unit of the output.
    file : SensitivityFile
        What :meth:`save` writes; it also has the ranges, and the ``sweep`` over the grid.
    """

    format = FORMAT
    file_type = SensitivityFile

    @property
    def indices(self) -> pd.DataFrame:
        """A row for each coefficient of each output: Sobol shares, or elementary effects (Morris)."""
        import pandas as pd

        return pd.DataFrame(
            [
                {"output": o.quantity, "trial": o.trial, "coefficient": name, **index.model_dump()}
                for o in self.file.outputs
                for name, index in {**o.shares, **o.effects}.items()
            ]
        )

    @classmethod
    def _told(cls, document: SensitivityFile, evidence: ev.Evidence | None) -> str:
        return (
            sensitivity_evidence.summary(document, evidence)
            if evidence
            else super()._told(document, evidence)
        )


class Study(NamedTuple):
    """What is varied, and what is looked at.

    Attributes
    ----------
    runs : list of (Run, ndarray)
        With the parameter vector of each, its start state in it.
    columns : list of (quantity, trial, unit)
        Outputs in order.
    centre : ndarray, shape (s,)
        Outputs with the given coefficients.
    """

    applied: Applied
    ranges: Mapping[str, Range]
    runs: Sequence[tuple[Run, Array]]
    columns: Sequence[tuple[str, str, str]]
    centre: Array

    @property
    def groups(self) -> dict[str, list[int]]:
        """The outputs of each quantity that more than one trial has."""
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
    """Vary the coefficients of a robot with links over ranges, and its drive over a grid.

    By default all coefficients vary that a fit estimates, and those with a range of their own. A parameter
    file gives values, standard errors, start states and noise. The indices hold for the ranges given: another
    range is another answer.

    Parameters
    ----------
    trials : path or TrialSet
        Trials: a file, or what :func:`swimid.load` gives.
        Of a free-swim or multibody experiment.
    output : Path, optional
        Sensitivity file to write; its evidence goes beside it.
    progress : Progress
        Shows the simulations.

    Returns
    -------
    Sensitivity
        ``.indices`` has a row for each coefficient of each output: Sobol indices (1) with their 95 %
        intervals, or elementary effects (in the unit of the output, over the whole range). ``.file.sweep``
        has the outputs over the grid, with standard deviations where a covariance is known.

    Raises
    ------
    UsageError, InputError
        For bad files and options.
    NoTrustworthyResult
        When more than one in a hundred simulations breaks down.

    References
    ----------
    .. [1] Saltelli, Annoni, Azzini, Campolongo, Ratto, Tarantola (2010), doi:10.1016/j.cpc.2009.09.018: Sobol
       indices.
    .. [2] Gamboa, Janon, Klein, Lagnoux (2014), doi:10.1214/14-EJS895: those of several outputs together.
    .. [3] Morris (1991), doi:10.2307/1269043: elementary effects.
    .. [4] Campolongo, Cariboni, Saltelli (2007), doi:10.1016/j.envsoft.2006.10.004: mu*.
    .. [5] Herman, Usher (2017), doi:10.21105/joss.00097: SALib.

    Examples
    --------
    Which of two coefficients of the tendon fish turns its heading more?

    >>> found = sensitivity(
    ...     "sample_logs/tfish/trials.yaml",
    ...     method="morris",
    ...     samples=4,
    ...     ranges=["20%"],
    ...     coefficients=["c_ma", "c_d4"],
    ... )
    >>> one = found.indices.query("output == 'yaw_amplitude_rad' and trial == 'f10a20'")
    >>> one.set_index("coefficient")["mu_star"].idxmax()
    'c_d4'
    """
    method, params, sweep = options.method, options.params, options.sweep
    count = SAMPLES[method] if options.samples is None else options.samples
    if method == "none" and not sweep:
        raise UsageError("--method none leaves nothing to do without --sweep")
    with recorded(repeat=True) as notices:
        experiment, applied = _loaded(trials, options)
        if output is not None:
            atomic.check_writable(output, inputs=experiment.inputs)
        over = _ranges(applied, options.ranges, options.coefficients) if method != "none" else {}
        swept = _swept(experiment, sweep, options.trial)
        origin = provenance.collect(experiment.inputs, settings=options.settings(samples=count))
        keep = Checkpoint.beside(output, [origin["inputs"], origin["settings"]])
        ahead_s = _simulated_s(experiment.trials, count, len(over))
        _swimmer(applied).prepare(progress, simulated_s=ahead_s, checkpoint=keep)
        workers = options.jobs or os.cpu_count() or 1
        file = SensitivityFile(
            verdict="caution",
            model=experiment.model.name,
            robot=experiment.robot.name,
            experiment=experiment.name,
            params=parameters_format.place(params).name if params is not None else None,
            method=method,
            samples=count,
            trials=[t.id for t in experiment.trials],
            ranges=over,
            provenance=origin,
        )
        checks = []
        if method != "none":
            study = _study(experiment, applied, over)
            estimates = (indices.sobol if method == "sobol" else indices.morris)(
                _evaluation(study),
                np.array([r.low for r in over.values()]),
                np.array([r.high for r in over.values()]),
                samples=count,
                seed=options.seed,
                groups=list(study.groups.values()),
                names=list(over),
                jobs=workers,
                checkpoint=keep,
                progress=progress,
            )
            file.outputs = _outputs(study, estimates)
            file.simulations = Simulations(
                evaluated=estimates.evaluations, broken=estimates.broken, left_out=estimates.left_out
            )
            checks += sensitivity_evidence.index_checks(file, _step_change(study, estimates))
            checks += sensitivity_evidence.correlation_check(_correlated(applied, over))
        if swept is not None:
            file.sweep = _sweep(applied, swept, sweep, workers, keep, progress)
            file.measured = _measured(experiment, applied, sweep)
            checks += sensitivity_evidence.sweep_checks(file.sweep, bool(applied.uncertain()[0]))
    verdict = ev.judged(sensitivity_evidence.answer(file), checks)
    file.verdict = verdict.level
    evidence = ev.Evidence(
        verb="sensitivity",
        title=f"Sensitivity of {experiment.robot.name}, {experiment.name}",
        verdict=verdict,
        checks=checks,
        tables=sensitivity_evidence.tables(file),
        figures=sensitivity_evidence.figures(file),
        notices=blocks.notices(notices),
        methods=sensitivity_evidence.methods(file),
        references=[*sensitivity_evidence.REFERENCES[method], *experiment.robot.sources],
        provenance=origin,
    )
    saved = Sensitivity.of(file, evidence).saved(output)
    keep.done()
    return saved


def _simulated_s(trials: Sequence[Trial], samples: int, coefficients: int) -> float:
    """How much time of the trials a study of so many rows simulates, s."""
    return samples * (coefficients + 2) * sum(float(t.time_s[-1] - t.time_s[0]) for t in trials)


def _loaded(source: str | Path | TrialSet, options: SensitivityOptions) -> tuple[Experiment, Applied]:
    if options.params is None:
        if options.robot is not None:
            raise UsageError("--robot belongs to --params: the trials file names the robot")
        experiment = swimmer.load(source, readings=dict(options.readings), max_step=options.dt)
        return experiment, Applied(experiment.model, chosen=dict(options.chosen))
    experiment, applied = catalogue.load(source, options)
    if applied.model.swimmer is None:
        raise UsageError(f"a study needs a robot with links, not the model '{applied.model.name}'")
    return experiment, applied


def _swimmer(applied: Applied) -> Swimmer:
    """The model as that of a robot with links, on which :func:`_loaded` insists."""
    assert applied.model.swimmer is not None
    return applied.model.swimmer


# ------------------------------------------------------------ what is varied


def _ranges(applied: Applied, texts: Sequence[str], coefficients: Sequence[str]) -> dict[str, Range]:
    """The range of every coefficient that is varied."""
    parted = [text.partition("=") for text in texts]
    own = {name.strip(): _ends(name.strip(), ends) for name, equals, ends in parted if equals}
    rules = [name.strip() for name, equals, _ in parted if not equals]
    if len(rules) > 1:
        raise UsageError(f"--range: {' and '.join(rules)} contradict each other")
    rule = rules[0] if rules else "bounds"
    shared = {p.name: p for p in applied.model.parameters if not p.per_trial}
    for name in (*own, *coefficients):
        if name not in shared:
            raise UsageError(f"there is no coefficient '{name}'", hint=suggestion(name, list(shared)))
        if name in applied.chosen:
            raise UsageError(f"{name} is held by --set and cannot be varied")
    values = dict(zip([p.name for p in applied.model.parameters], applied.values().tolist(), strict=True))
    names, covariance = applied.uncertain()
    errors = dict(zip(names, np.sqrt(np.diag(covariance)).tolist(), strict=True))
    ranges = {}
    for p in shared.values():
        wanted = p.name in coefficients if coefficients else p.free or p.name in own
        if not wanted or p.name in applied.chosen:
            continue
        if p.name in own:
            low, high, source = *own[p.name], "given"
        else:
            low, high, source = _by_rule(p, values[p.name], rule, errors)
        if math.isnan(low):
            if coefficients:
                raise UsageError(f"{p.name} has no standard error to make a range of")
            continue
        if not (math.isfinite(low) and math.isfinite(high)):
            raise UsageError(f"{p.name} has no bounds", hint=f"give them: --range {p.name}=LOW,HIGH")
        if not low < high:
            raise UsageError(f"the range of {p.name} is empty: {low:g} to {high:g}")
        ranges[p.name] = Range(value=values[p.name], low=low, high=high, unit=p.unit, source=source)  # type: ignore[arg-type]
    if not ranges:
        raise UsageError("there is no coefficient to vary", hint="name one: --range NAME=LOW,HIGH")
    return ranges


def _correlated(applied: Applied, over: Mapping[str, Range]) -> tuple[float, str, str] | None:
    """The largest correlation of two coefficients whose ranges are their standard errors, and the two."""
    names, covariance = applied.uncertain()
    sd = np.sqrt(np.diag(covariance))
    kept = [k for k, name in enumerate(names) if name in over and over[name].source == "stderr"]
    pairs = [
        (float(covariance[i, j] / (sd[i] * sd[j])), names[i], names[j])
        for i, j in itertools.combinations(kept, 2)
    ]
    return max(pairs, key=lambda pair: abs(pair[0]), default=None)


def _ends(name: str, text: str) -> tuple[float, float]:
    try:
        low, high = (float(part) for part in text.split(","))
    except ValueError:
        raise UsageError(f"--range: '{name}={text}' should be NAME=LOW,HIGH") from None
    return low, high


def _by_rule(p: Parameter, value: float, rule: str, errors: Mapping[str, float]) -> tuple[float, float, str]:
    """Ends of a range and what they are of; NaN where two standard errors are not known."""
    if rule == "bounds":
        return p.lower, p.upper, rule
    if rule == "stderr":
        if not errors:
            raise UsageError("--range stderr needs a parameter file with standard errors: --params")
        half = 2 * errors.get(p.name, math.nan)
    else:
        try:
            share = float(rule.removesuffix("%")) / 100.0
        except ValueError:
            share = math.nan
        if not rule.endswith("%") or not 0 < share < math.inf:
            raise UsageError(f"--range: '{rule}' should be bounds, stderr, 20% or NAME=LOW,HIGH")
        half, rule = share * abs(value), "share"
        if half == 0:
            raise UsageError(
                f"{p.name} is 0, of which no share is a range",
                hint=f"give it one, --range {p.name}=LOW,HIGH, or hold it, --set {p.name}=0",
            )
    return max(value - half, p.lower), min(value + half, p.upper), rule


# ------------------------------------------------------------ the outputs


def _study(experiment: Experiment, applied: Applied, over: Mapping[str, Range]) -> Study:
    """The runs with their start states, and what they come to with the given coefficients."""
    model = _swimmer(applied)
    runs, columns, centre = [], [], []
    for trial in experiment.trials:
        values, _, _ = compare_series.start_of(applied, trial, refit=bool(trial.measured))
        run = sensitivity_outputs.run_of(model, trial, applied.noise())
        quantities = sensitivity_outputs.outputs(model, values, run)
        broken = [name for name, q in quantities.items() if not math.isfinite(q.value)]
        if broken or not sensitivity_outputs.possible(model, values):
            raise NoTrustworthyResult(
                f"the simulation of '{trial.id}' breaks down with the given coefficients",
                hint="check the parameters and the drive, or take a smaller --dt",
            )
        runs.append((run, values))
        columns += [(name, trial.id, q.unit) for name, q in quantities.items()]
        centre += [q.value for q in quantities.values()]
    if not columns:
        raise NoTrustworthyResult("these trials have no output: the base is held and nothing yields")
    return Study(applied, over, runs, columns, np.array(centre))


def _evaluation(study: Study, model: Swimmer | None = None) -> Callable[[Array], Array]:
    """From coefficients, shape (n, d), to the outputs, shape (n, s); NaN where a simulation breaks down."""
    known = model or _swimmer(study.applied)
    places = [known.index(name) for name in study.ranges]

    def vectors(point: Array) -> list[Array]:
        found = [start.copy() for _, start in study.runs]
        for values in found:
            values[places] = point
        return found

    def evaluate(points: Array) -> Array:
        results = np.full((len(points), len(study.columns)), np.nan)
        asked = [(k, vectors(point)) for k, point in enumerate(points)]
        asked = [(k, each) for k, each in asked if all(sensitivity_outputs.possible(known, v) for v in each)]
        trials = [run.trial for run, _ in study.runs]
        simulated = iter(
            known.simulate_many([one for _, each in asked for one in zip(each, trials, strict=True)])
        )
        for k, _ in asked:
            quantities = [
                sensitivity_outputs.of_columns(known, next(simulated), run).values() for run, _ in study.runs
            ]
            results[k] = [q.value for of_run in quantities for q in of_run]
        return results

    return evaluate


def _step_change(study: Study, estimates: Sobol | Morris) -> float:
    """Largest change of an output when the integration step is halved, over its deviation in the ranges."""
    finer = _swimmer(study.applied).refined()
    given = np.array([r.value for r in study.ranges.values()])
    change = np.abs(_evaluation(study, finer)(given[None])[0] - study.centre)
    vary = estimates.sd > CONSTANT * np.abs(estimates.mean)
    return float(np.max(change[vary] / estimates.sd[vary], initial=0.0))


def _outputs(study: Study, estimates: Sobol | Morris) -> list[Output]:
    outputs = [
        Output(
            quantity=quantity,
            trial=trial,
            unit=unit,
            value=float(study.centre[k]),
            mean=float(estimates.mean[k]),
            sd=float(estimates.sd[k]),
        )
        for k, (quantity, trial, unit) in enumerate(study.columns)
    ]
    for quantity, members in study.groups.items():
        sd = float(np.sqrt(np.mean(estimates.sd[members] ** 2)))
        outputs.append(Output(quantity=quantity, unit=study.columns[members[0]][2], sd=sd))
    for row, one in enumerate(outputs):
        assert one.sd is not None
        if isinstance(estimates, Morris):
            one.effects = {name: _effects(estimates, row, k) for k, name in enumerate(study.ranges)}
        elif one.sd > CONSTANT * abs(one.mean or 0.0):
            one.shares = {name: _shares(estimates, row, k) for k, name in enumerate(study.ranges)}
    return outputs


def _ci95(ends: Array, row: int, k: int) -> tuple[float, float]:
    return float(ends[0, row, k]), float(ends[1, row, k])


def _shares(sobol: Sobol, row: int, k: int) -> Shares:
    first = Index(value=float(sobol.first[row, k]), ci95=_ci95(sobol.first_ci, row, k))
    total = Index(value=float(sobol.total[row, k]), ci95=_ci95(sobol.total_ci, row, k))
    negligible = total.ci95[1] < NEGLIGIBLE
    return Shares(first=first, total=total, first_told=first.ci95[0] > 0, negligible=negligible)


def _effects(morris: Morris, row: int, k: int) -> Effects:
    return Effects(
        mu=float(morris.mu[row, k]),
        mu_star=float(morris.mu_star[row, k]),
        mu_star_ci95=_ci95(morris.mu_star_ci, row, k),
        sigma=float(morris.sigma[row, k]),
    )


# ------------------------------------------------------------ the drive


def _swept(
    experiment: Experiment, sweep: Mapping[str, tuple[float, float, int]], name: str | None
) -> Trial | None:
    """The trial whose drive is swept."""
    if not sweep:
        if name is not None:
            raise UsageError("--trial belongs to --sweep")
        return None
    if len(sweep) > 2:
        raise UsageError("a sweep has one axis or two")
    known = {t.id: t for t in experiment.trials}
    if name is not None and name not in known:
        raise UsageError(f"there is no trial '{name}'", hint=suggestion(name, list(known)))
    driven = [t for t in experiment.trials if sensitivity_outputs.drive_of(t)]
    trial = known[name] if name is not None else (driven or experiment.trials)[0]
    allowed = list(sensitivity_outputs.drive_of(trial))
    if not allowed:
        raise UsageError(f"the trial '{trial.id}' has no drive to sweep: measured joints move it")
    for axis in sweep:
        if axis not in allowed:
            raise UsageError(f"--sweep: the drive has no '{axis}'", hint=suggestion(axis, allowed))
    for axis, (low, high, count) in sweep.items():
        if not low < high or count < 2:
            raise UsageError(f"--sweep {axis}: needs LOW below HIGH and two points or more")
        if low < 0 and axis != "bias_deg":
            raise UsageError(f"--sweep {axis}: {low:g} is below zero")
        if axis == "frequency_hz" and low == 0:
            raise UsageError("--sweep frequency_hz: zero is no frequency")
    if math.prod(axis[2] for axis in sweep.values()) > MOST_POINTS:
        raise UsageError(f"a sweep of more than {MOST_POINTS} points is taken for a slip")
    return trial


def _sweep(
    applied: Applied,
    trial: Trial,
    sweep: Mapping[str, tuple[float, float, int]],
    jobs: int,
    checkpoint: Checkpoint,
    progress: Progress,
) -> Sweep:
    """Outputs over the grid with their deviations, by the delta method from the coefficients' covariance."""
    model = _swimmer(applied)
    axes = [Axis(name=name, values=[float(v) for v in np.linspace(*axis)]) for name, axis in sweep.items()]
    grid = [dict(zip(sweep, point, strict=True)) for point in itertools.product(*(a.values for a in axes))]
    values = applied.values()
    known = bool(applied.uncertain()[0])
    if known:
        applied.warn_without_error("the deviations of the sweep")

    def run(drive: Mapping[str, float]) -> Run:
        return sensitivity_outputs.run_of(model, sensitivity_outputs.driven_otherwise(trial, drive))

    units = {n: q.unit for n, q in sensitivity_outputs.outputs(model, values, run(grid[0])).items()}
    if not units:
        raise NoTrustworthyResult("the trial has no output: its base is held and nothing yields")

    def one(moved: Run) -> Array:
        def compute(point: Array) -> dict[str, Quantity]:
            return sensitivity_outputs.outputs(model, point, moved)

        quantities = applied.with_errors(values, compute)
        return np.array([[quantities[n].value, quantities[n].stderr or 0.0] for n in units]).ravel()

    def kept(k: int) -> Array:
        return checkpoint.kept(f"sweep {k}", lambda: one(run(grid[k])))

    computed = []
    with (
        progress("sweep", total=len(grid)) as step,
        in_threads(kept, range(len(grid)), jobs) as rows,
    ):
        for row in rows:
            computed.append(row)
            step()
    table = np.array(computed).reshape(len(axes[0].values), -1, len(units), 2)
    lost = ~np.isfinite(table[..., 0]).all(axis=-1)
    table[lost] = np.nan
    outputs = [
        SweptOutput(
            quantity=name,
            unit=unit,
            values=table[:, :, k, 0],  # type: ignore[arg-type]
            stderr=table[:, :, k, 1] if known else None,  # type: ignore[arg-type]
        )
        for k, (name, unit) in enumerate(units.items())
    ]
    return Sweep(trial=trial.id, axes=axes, outputs=outputs, broken=int(lost.sum()))


def _measured(
    experiment: Experiment, applied: Applied, sweep: Mapping[str, tuple[float, float, int]]
) -> list[Measured]:
    """The actual error of every trial that has the axes of the sweep."""
    model = _swimmer(applied)
    units = {c.name: c.unit for c in model.channels}
    trials = []
    for trial in experiment.trials:
        drive = sensitivity_outputs.drive_of(trial)
        if not trial.measured or not set(sweep) <= set(drive):
            continue
        values, _, _ = compare_series.start_of(applied, trial, refit=True)
        errors = sensitivity_outputs.errors(model, values, trial)
        trials.append(
            Measured(
                trial=trial.id,
                role=trial.role,  # type: ignore[arg-type]
                drive={name: float(f"{value:.12g}") for name, value in drive.items()},
                inside=all(low <= drive[name] <= high for name, (low, high, _) in sweep.items()),
                channels={
                    name: MeasuredChannel(unit=units[name], rmse=rmse, nrmse=nrmse)
                    for name, (rmse, nrmse) in errors.items()
                },
            )
        )
    return trials
