"""``fit-graybox``: estimates hydrodynamic coefficients of a multi-link swimmer from its trials."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from swimid.errors import InputError, Interrupted, NoTrustworthyResult, UsageError
from swimid.files import atomic, provenance
from swimid.files.atomic import Checkpoint
from swimid.fitting import fit_common, mistakes, output_error, rivals
from swimid.fitting.fit import fit
from swimid.fitting.fit_common import Experiment
from swimid.fitting.global_search import Start, count_agreeing, multistart
from swimid.fitting.model import (
    Array,
    Model,
    Parameter,
    Trial,
    expand,
    groups_by_prefix,
    share,
    values_of,
)
from swimid.fitting.output_error import FitResult, Series
from swimid.fitting.rivals import Rival
from swimid.logs import trials as trials_format
from swimid.logs.trials import TrialSet
from swimid.notices import Progress, record_warnings, silent
from swimid.options import takes
from swimid.results import evidence as ev
from swimid.results import numbers
from swimid.results import parameters as parameters_format
from swimid.results.parameters import Fitted, ParameterFile
from swimid.swimmer import trials as swimmer
from swimid.swimmer.options import FitGrayboxOptions

if TYPE_CHECKING:
    from swimid.swimmer.front import FrontResult, Profiles

#: Default number of starting points. It applies if the user states none and the fit from one starting point
#: was quick or has a bad result.
DEFAULT_STARTS = 4
#: Maximum number of integration steps of a quick fit. A quick fit is repeated from other starting points.
#: These steps take about one second on one processor (1.3 us per step of the tendon fish,
#: benchmarks.bench_lanes).
MAX_QUICK_STEPS = 1e6
#: Maximum number of plotted points of a measured path.
MAX_PATH_POINTS = 200


@takes(FitGrayboxOptions)
def fit_graybox(
    trials: str | Path | TrialSet,
    *,
    options: FitGrayboxOptions,
    output: Path | None = None,
    progress: Progress = silent,
) -> Fitted:
    """Identify the coefficients of a robot with links by output error over all trials at once.

    Other methods are a Pareto front from which one point is chosen, and output error that starts from points
    of the front. Do not use a coefficient by itself if its status is ``"unidentifiable"`` (the trials
    determine only a combination of this coefficient with others) or ``"at-bound"`` (the estimate lies at the
    bound of the coefficient).

    Parameters
    ----------
    trials : path or TrialSet
        Trials of a free-swim or multibody experiment with a robot that has links: a trials file, or the
        result of :func:`swimid.load`.
    output : path, optional
        Parameter file to write. The evidence file of the fit is written to the same folder.
    progress : Progress

    Returns
    -------
    Fitted
        ``.parameters`` has the coefficients in the units of the robot file (mostly 1), and the offset of the
        start pose of each trial, such as ``start_x[f10a20]`` (m) and ``start_yaw[f10a20]`` (rad).
        ``.correlation``, ``.has_converged`` and ``.verdict`` show how far the estimates can be trusted.

    Raises
    ------
    InputError, UsageError
        For bad files and options.
    NoTrustworthyResult
        If no coefficient can be identified, or if the search did not converge or was interrupted
        (:class:`Interrupted`). In the last two cases the result so far is written first, with a mark.

    References
    ----------
    .. [1] "Locomotion Optimization of a Tendon-Driven Robotic Fish with Variable Passive Tail Fin".
       Eqs 1 to 7: the model in the horizontal plane; Table III: its hydrodynamic parameters.
    .. [2] D. Chen, Y. Xiong, B. Wang, R. Tong, Y. Meng, J. Yu, "Performance Optimization for Bionic Robotic
       Dolphin with Active Variable Stiffness Control".
       Eqs 3 to 9: the model in the vertical plane; Table 3: its hydrodynamic parameters.
    .. [3] S. Kadapa, N. Marcouiller, A. Drago, J. L. Tangorra, H. G. Kwatny, "Tuning hydrodynamic
       coefficients using a genetic algorithm for a numerical model of a bio-robotic sea lion".
       Section II: the genetic search.
    .. [4] K. Deb et al. (2002), doi:10.1109/4235.996017: NSGA-II.
    .. [5] V. Klein, E. A. Morelli, *Aircraft System Identification: Theory and Practice*, AIAA, 2006.
       Output error.

    Examples
    --------
    Fit two trials of the tendon fish with fixed friction coefficients:

    >>> import swimid
    >>> beats = {"f10a20": (1.0, 20), "f14a25": (1.4, 25)}
    >>> runs = [
    ...     {
    ...         "id": name,
    ...         "log": swimid.read_log(f"sample_logs/tfish/{name}.csv"),
    ...         "drive": {"frequency_hz": frequency, "amplitude_deg": amplitude},
    ...     }
    ...     for name, (frequency, amplitude) in beats.items()
    ... ]
    >>> trials = swimid.load(runs, experiment="free-swim", robot="tfish")
    >>> fit = fit_graybox(trials, fixed={"c_f0": 0.014, "c_f13": 0.014, "c_f4": 0.014})
    >>> fit.has_converged, fit["c_f4"].status, fit["c_ma"].unit
    (True, 'fixed', '1')
    >>> round(fit["c_ma"].value, 1)
    1.0
    """
    if not isinstance(trials, TrialSet):
        trials = TrialSet(trials_format.read(trials, "fit-graybox"), Path(trials))
    if not trials.entries.robot_form:
        return _fit_simulator(trials, options, output, progress)
    with record_warnings(repeat=True) as notices:
        posed = FitSetup.of(trials, options, output)
        experiment = posed.experiment
        _require_steady_swimming(experiment, posed.parameters)
        files = [parameters_format.origin(p) for p in (options.start_from, options.front) if p is not None]
        origin = provenance.collect([*experiment.inputs, *files], settings=options.settings())
        search = _search(posed, output, origin, progress)
        result = output_error.complete_fit(search.result)
        folder = (output or trials_format.place(trials)).parent
        file = _parameter_file(posed, result, origin, folder)
        checks, explanation = _check_fit(posed, result, search, progress)
    evidence = ev.Evidence(
        command="fit-graybox",
        title=f"Gray-box identification of {experiment.robot.name}",
        verdict=ev.make_verdict(fit_common.answer(file), checks),
        notes=[e.sentence for e in (explanation,) if e is not None],
        checks=checks,
        tables=_tables(experiment, result, search.ends),
        figures=[*_track(experiment, result), *fit_common.figures(result)],
        notices=list(notices),
        methods=_methods(experiment, result, search.ends, options.method),
        references=list(experiment.robot.sources),
        provenance=origin,
    )
    with atomic.write_together():
        if search.front is not None:
            search.front.add_evidence(evidence, result, options)
        fitted = Fitted.of(file, evidence).write_output(output)
        if search.front is not None and output is not None:
            points = search.front.save(output, options)
            fitted = replace(fitted, outputs=[*fitted.outputs, *points])
            search.checkpoint.finish()
    _require_result(result, file, search, trials, output, explanation)
    return fitted


def _check_fit(
    posed: FitSetup, result: FitResult, search: _Search, progress: Progress
) -> tuple[list[ev.Check], mistakes.Explanation | None]:
    """Return the checks of a fit, and the recording mistake that explains a bad fit; None if none does."""
    options = posed.options
    checks = [
        *fit_common.assess(result),
        fit_common.beat_check(posed.experiment.facts["beats"]),
    ]
    if search.ends:
        checks.append(_starts_check(search.ends, asked=options.starts is not None))
    before = {t.id: [s for s in result.series if s.trial == t.id] for t in result.trials}
    if options.method != "least-squares" or not mistakes.is_suspect(checks, before):
        return checks, None
    known = mistakes.list_mistakes(posed.model, result.trials)
    explanation = _explain(result, known, before, options, progress)
    checks.append(mistakes.check_mistakes(explanation, len(known)))
    return checks, explanation


def _fit_simulator(
    trials: TrialSet, options: FitGrayboxOptions, output: Path | None, progress: Progress
) -> Fitted:
    """Fit the simulator of a user as the command ``fit`` does.

    Raises
    ------
    UsageError
        If an option is given that only a robot with links has.
    """
    used = {"fixed", "freed", "bounds"}
    defaults = type(options)()
    other = [
        name
        for name in type(options).model_fields
        if name not in used | {"jobs"} and getattr(options, name) != getattr(defaults, name)
    ]
    if other:
        flag = type(options).declarations()[other[0]].flag
        raise UsageError(f"{flag} has no effect on the model of '{trials.experiment}': omit {flag}")
    given = {name: getattr(options, name) for name in used}
    return fit(trials, output=output, progress=progress, **given)


@dataclass(frozen=True)
class FitSetup:
    """Trials, model and parameters of a fit."""

    experiment: Experiment
    model: Model
    parameters: tuple[Parameter, ...]
    options: FitGrayboxOptions

    @classmethod
    def of(
        cls, trials: str | Path | TrialSet, options: FitGrayboxOptions, output: Path | None = None
    ) -> FitSetup:
        """Read the trials, and prepare model and parameters as the options say."""
        experiment = fit_common.load_experiment(
            trials,
            command="fit-graybox",
            readings=options.readings,
            channels=options.channels,
            start_state=options.start_state,
            max_step=options.dt,
        )
        model, begin = experiment.model, options.start_from
        groups: dict[str, tuple[str, ...]] = {}
        for prefix in options.share:
            groups |= groups_by_prefix(model.parameters, prefix)
        parameters = share(model.parameters, groups)
        if begin is not None:
            parameters = _start_from(begin, parameters)
        parameters = fit_common.prepare_fit(
            experiment,
            output,
            parameters=parameters,
            fixed=options.fixed,
            freed=options.freed,
            bounds=options.bounds,
            also=[begin] if isinstance(begin, Path) else [],
        )
        return cls(experiment, model, parameters, options)

    @cached_property
    def profiles(self) -> Profiles:
        """Objectives of a search of a Pareto front."""
        from swimid.swimmer.front import Profiles

        trials, names = self.experiment.trials, self.experiment.facts["profiles"]
        jobs, scales = self.options.jobs or os.cpu_count() or 1, self.options.scales
        return Profiles(self.model, self.parameters, trials, names, scales=scales, jobs=jobs)


@dataclass(frozen=True)
class _Search:
    """Result of a parameter estimation, with its starting points and its Pareto front.

    Attributes
    ----------
    result : FitResult
    front : FrontResult or None
        Pareto front, if one was searched.
    checkpoint : Checkpoint
        Stored generations of the search of the Pareto front, from which the search can be resumed.
    ends : list of Start
        End of the fit from each starting point, if there were several.
    starts : int
        Planned number of starting points.
    """

    result: FitResult
    front: FrontResult | None = None
    checkpoint: Checkpoint = field(default_factory=Checkpoint)
    ends: list[Start] = field(default_factory=list)
    starts: int = 1


def _search(posed: FitSetup, output: Path | None, origin: dict[str, Any], progress: Progress) -> _Search:
    """Estimate the parameters with the method that the options name."""
    options, model = posed.options, posed.model
    model.prepare(progress)
    if options.method == "least-squares":
        search = _least_squares(posed, None, progress)
    else:
        from swimid.swimmer import front

        checkpoint = Checkpoint.of_output(output, [origin["inputs"], origin["settings"]])
        found, chosen = front.fit_front(posed, checkpoint, progress)
        search = _Search(chosen)
        if options.method == "hybrid":
            search = _least_squares(posed, found.starts(options.starts or 1), progress)
        search = replace(search, front=found, checkpoint=checkpoint)
    return search


def _least_squares(posed: FitSetup, begins: Sequence[Array] | None, progress: Progress) -> _Search:
    """Estimate the parameters by output error from one or several starting points.

    Several starting points are used if the user asks for them, or if the fit from the first starting point
    was quick or has a bad result.
    """
    model, trials, options = posed.model, posed.experiment.trials, posed.options
    settings: dict[str, Any] = {
        "parameters": posed.parameters,
        "jobs": options.jobs,
        "max_iterations": options.max_iterations,
    }
    begin, starts = None, options.starts or 1
    if begins is not None:
        begin, starts = begins[0], max(starts, len(begins))
    first: FitResult | None = None
    if starts == 1:
        first = output_error.fit_output_error(model, trials, begin=begin, progress=progress, **settings)
        if options.starts is not None or first.interrupted or not _deserves_starts(first):
            return _Search(first)
        starts = DEFAULT_STARTS
    settings |= {"starts": starts, "seed": options.seed, "begins": begins, "first": first}
    result, ends = multistart(model, trials, progress=progress, **settings)
    return _Search(result, ends=ends, starts=starts)


def _deserves_starts(first: FitResult) -> bool:
    """Return whether to fit again from other starting points.

    Fit again if the first fit was quick, if it did not converge, or if its errors are too large.
    """
    lengths = [float(t.time_s[-1] - t.time_s[0]) for t in first.trials]
    steps = first.evaluations * float(np.mean(lengths)) / first.model.swimmer.max_step
    failing = [c for c in fit_common.error_checks(first, roles=("fit",)) if c.verdict == "fail"]
    return steps < MAX_QUICK_STEPS or not first.converged or bool(failing)


def _require_result(
    result: FitResult,
    file: ParameterFile,
    search: _Search,
    source: str | Path | TrialSet,
    output: Path | None,
    explanation: mistakes.Explanation | None,
) -> None:
    """Raise an error if a search was interrupted, did not converge, or identified no coefficient."""
    if result.interrupted or 0 < len(search.ends) < search.starts:
        reason = f"the search was interrupted after {len(search.ends)} of {search.starts} starts"
        if result.interrupted:
            reason = result.message
        if output is None:
            raise Interrupted(f"{reason}; nothing was written")
        raise Interrupted(
            f"{reason}; the best point so far is in {output}",
            hint=f"continue with --start-from {output}",
        )
    if not result.converged:
        kept = params = ""
        if output is not None:
            kept = f"; the result so far is in {output}, marked as not converged"
            params = f" --params {output}"
        hint = (
            "check units and trial settings, or search an effect that the model lacks: swimid diagnose "
            f"{trials_format.place(source)}{params} -o gap.yaml"
        )
        if explanation is not None:
            hint = explanation.sentence
        raise NoTrustworthyResult(f"the fit did not converge: {result.message}{kept}", hint=hint)
    unknown = [label for label in result.common_labels if result.status[label] == "unidentifiable"]
    if unknown and unknown == result.common_labels and not file.derived:
        raise NoTrustworthyResult(
            f"none of {', '.join(unknown)} can be identified from these trials",
            hint="use longer and more different trials, or fix known coefficients with --fix",
        )


def _require_steady_swimming(experiment: Experiment, parameters: Sequence[Parameter]) -> None:
    """Raise an error if a trial begins in steady swimming but the model reaches no steady speed."""
    model = experiment.model.swimmer
    starts = {p.name: p.start for p in (*model.parameters, *parameters)}
    fixed = {p.name for p in parameters if not p.free}
    stated = {name: value for name, value in model.get_file_values().items() if name not in fixed}
    points = [np.array([p[q.name] for q in model.parameters]) for p in (starts, starts | stated)]
    for trial in (t for t in experiment.trials if t.swim.steady):
        cruises = [model.cruise(point, trial) for point in points]
        if all(c is not None and not np.isfinite(c.speed_m_s) for c in cruises):
            raise NoTrustworthyResult(
                f"the speed of the model never becomes steady with the gait of '{trial.id}'",
                hint="the model may have no drag: free a drag coefficient, or use --start-state estimate",
            )


def _explain(
    result: FitResult,
    known: Sequence[mistakes.Mistake],
    before: mistakes.TrialSeries,
    options: FitGrayboxOptions,
    progress: Progress,
) -> mistakes.Explanation | None:
    """Return a recording mistake in the trials or logs that explains a bad fit; None if none does.

    Each mistake is corrected in each trial, first with fixed coefficients: those of the fit, and those of the
    robot file. Then the model is fitted again with each of the few most promising corrections. The results of
    these fits decide which mistake is returned.
    """
    model, trials = result.model, result.trials
    sd = {name: noise.value_sd for name, noise in result.noise.items()}
    stated = model.get_file_values()
    sets = (
        result.at_estimates(),
        tuple(replace(p, start=stated.get(p.name, p.start)) for p in result.parameters),
    )

    def simulate(trial: Trial) -> Iterator[dict[str, Array]]:
        for parameters in sets:
            own = output_error.estimate_start(
                model, parameters, trial, sd, tolerance=mistakes.SCREEN_START_RTOL
            )
            known = {p.name: own.get(f"{p.name}[{trial.id}]", p.start) for p in parameters}
            yield model.run(values_of(model, parameters, known), trial)

    with progress("trying usual mistakes") as step:

        def refit(changed: Sequence[Trial]) -> FitResult | None:
            step()
            rival = Rival("usual mistake", result.parameters, tuple(changed))
            fit = rivals.refit(result, rival, jobs=options.jobs, max_iterations=options.max_iterations)
            return None if fit is None else output_error.with_held_out(fit)

        return mistakes.search(trials, known, before, simulate, refit)


def _start_from(source: parameters_format.Source, parameters: tuple[Parameter, ...]) -> tuple[Parameter, ...]:
    """Return the parameters with start values from a parameter file.

    The start value of a shared parameter is the mean over its members.
    """
    file = parameters_format.read(source, model=("multilink", "multibody"))
    found = []
    for parameter in parameters:
        members = parameter.members or (parameter.name,)
        known = [file.parameters[n].value for n in members if n in file.parameters]
        if known and not parameter.per_trial:
            value = float(np.clip(np.mean(known), parameter.lower, parameter.upper))
            parameter = replace(parameter, start=value)
        found.append(parameter)
    if not any(p.name in file.parameters for p in parameters):
        raise InputError(
            "has none of the parameters of this robot",
            file=parameters_format.source_path(source),
            hint=f"the robot has: {', '.join(p.name for p in parameters)}",
        )
    return tuple(found)


def _parameter_file(
    posed: FitSetup, result: FitResult, origin: dict[str, Any], folder: Path
) -> ParameterFile:
    """Return the parameter file of a fit."""
    options, experiment = posed.options, posed.experiment
    settings: dict[str, Any] = {
        "readings": dict(options.readings),
        "shared": {p.name: list(p.members) for p in result.parameters if p.members},
    }
    if options.start_state != "auto":
        settings["start_state"] = options.start_state
    method = "output error"
    if options.method == "nsga2":
        method = "point of a Pareto front"
    file = fit_common.parameter_file(
        result,
        robot=fit_common.robot_reference(experiment, folder),
        provenance=origin,
        settings={name: value for name, value in settings.items() if value},
        method=method,
        unfinished=True,
    )
    # store the range of the drives, so that users of the coefficients are warned of drives outside it
    drives = swimmer.find_drive_range([t for t in experiment.trials if t.role == "fit"])
    if file.fit is not None and file.fit.model_extra is not None and drives:
        file.fit.model_extra["drives"] = {name: list(ends) for name, ends in drives.items()}
    return file.model_copy(update={"parameters": expand(result.parameters, file.parameters)})


def _track(experiment: Experiment, result: FitResult) -> list[ev.Figure]:
    """Plot the paths of the trials if the pose was fitted.

    Paths in 3-D are plotted as seen from above and from the side.
    """
    across, *others = result.model.swimmer.pose
    sides = others[:1]
    if result.model.swimmer.in_space:
        sides = ["z_m", "y_m"]
    panels = [panel for along in sides for panel in _paths(result, across, along)]
    if not panels:
        return []
    caption = (
        "Points are measured, lines simulated with the estimated parameters. Trials are ranked by the mean "
        "square of their weighted residuals in the path."
    )
    return [ev.Figure(id="track", title="Paths", caption=caption, panels=panels)]


def _paths(result: FitResult, across: str, along: str) -> list[ev.Panel]:
    """Plot the paths of the fitted trials with the largest and the smallest error.

    The path of the held-out trial with the largest error is plotted, too.
    """
    paths = {}
    for trial in result.trials:
        series = {s.channel: s for s in result.series if s.trial == trial.id}
        if across in series and along in series:
            paths[trial.id] = series[across], series[along]

    def error(series: Series) -> float:
        return float(sum(np.nanmean(s.z_scores**2) for s in paths[series.trial]))

    panels = []
    for title, x in ev.extremes([x for x, _ in paths.values()], error).items():
        every = slice(None, None, max(len(x.measured) // MAX_PATH_POINTS, 1))
        sides = [(s.measured[every], s.simulated) for s in paths[x.trial]]
        panels.append(ev.path(title, (across, along), *sides))
    return panels


def _starts_check(ends: Sequence[Start], *, asked: bool) -> ev.Check:
    """Return the check that counts the starting points from which the fit ends in the reported minimum.

    The check can fail only if the user asked for several starting points.
    """
    agree, count = count_agreeing(ends), len(ends)
    passed, text = None, ""
    if agree < count:
        text = "the other starts end at higher costs; the fit with the lowest cost is reported"
    if asked:
        passed = agree == count
    reason = f"only {agree} of {count} starts end in the reported minimum"
    value = f"{agree} of {count} starts end in the reported minimum"
    return ev.make_check("one minimum", value, passed, "every start", text, reason=reason)


def _tables(experiment: Experiment, result: FitResult, ends: Sequence[Start]) -> list[ev.Table]:
    """Return tables of errors, of starting points, and of the interpretations of the robot's source."""
    found = [
        ev.Table(
            id="metrics",
            title="Errors of every trial",
            columns=["trial", "data", "channel", "RMSE", "NRMSE", "VAF", "peak", "DTW"],
            rows=_error_rows(result),
            caption="NRMSE: over the measured range (tendon fish, Eq 13). Peak: difference of the largest "
            "magnitudes over the measured one (Eq 14). DTW: distance per sample after warping within 5 % of "
            "the record.",
            folded=True,
        ),
        ev.Table(
            id="starts",
            title="Starts",
            columns=["start", "converged", "cost"],
            rows=[[k, end.converged, float(end.cost)] for k, end in enumerate(ends, start=1)],
            caption="The cost is the mean squared residual, averaged geometrically over the channels.",
            folded=True,
        ),
        ev.Table(
            id="readings",
            title="Readings of the source",
            columns=["reading", "question", "chosen", "meaning"],
            rows=[
                [name, r.question, r.chosen, r.options[r.chosen].says]
                for name, r in experiment.robot.readings.items()
            ],
            caption="Other readings are options of the robot file (--reading NAME=OPTION).",
            folded=True,
        ),
    ]
    return [table for table in found if table.rows]


def _error_rows(result: FitResult) -> list[list[str]]:
    """Return the rows of the table of errors, one for each trial and channel."""
    rows = []
    units = {c.name: c.unit for c in result.model.channels}
    for s in result.series:
        unit, role = units[s.channel], {"validate": "held out"}.get(s.role, "fit")
        score = fit_common.compute_scores(result, s.role, [s.trial])[s.channel]
        warped = fit_common.dtw_distance(s.measured, s.simulated, band=max(1, len(s.measured) // 20))
        peak = fit_common.peak_error(s.measured, s.simulated)[1]
        shares = numbers.percent(score.nrmse), numbers.percent(score.vaf, 4), numbers.percent(peak)
        errors = [numbers.format_number(error, 3, unit) for error in (score.rmse, warped)]
        rows.append([s.trial, role, s.channel, errors[0], *shares, errors[1]])
    return rows


def _methods(experiment: Experiment, result: FitResult, ends: Sequence[Start], method: str) -> list[str]:
    """Return sentences for a methods section that describe the fit."""
    fitted = sum(t.role == "fit" for t in result.trials)
    model = result.model.swimmer
    kind, by = "planar model", "output-error maximum likelihood"
    if model.in_space:
        kind = "model in space"
    if method == "nsga2":
        by = "the search on the front"
    said = [
        f"{', '.join(result.common_labels)} were estimated from {fitted} {experiment.name} trials "
        f"({result.samples} samples of {', '.join(result.noise)}) by {by} with a {kind} of "
        f"{len(model.tree.links)} links, integrated by a fourth-order Runge-Kutta method with steps of at "
        f"most {1e3 * model.max_step:g} ms; halving them changes no sample by more than "
        f"{result.step_error:.2g} standard deviations of its noise.",
        fit_common.COVARIANCE,
    ]
    if ends:
        drawn = {"hybrid": "on the front"}.get(method, "drawn evenly within the bounds")
        said.append(f"{count_agreeing(ends)} of {len(ends)} starts, {drawn}, end in the reported minimum.")
    own = dict.fromkeys(label.split("[")[0] for label in result.labels if "[" in label)
    if own:
        said.append(
            f"Each trial has its own {', '.join(own)}; on held-out trials all other parameters were fixed."
        )
    return said
