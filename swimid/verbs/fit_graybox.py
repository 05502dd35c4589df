"""``fit-graybox``: hydrodynamic coefficients of a multi-link swimmer from its trials."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from swimid.errors import InputError, NoTrustworthyResult
from swimid.estimators import identifiability, metrics, multistart, output_error, start_states
from swimid.estimators.fit_result import FitResult, Series
from swimid.experiments import multilink as multilink_experiment
from swimid.experiments.base import Experiment
from swimid.formats import evidence as ev
from swimid.formats import parameters as parameters_format
from swimid.formats import provenance
from swimid.formats import robot as robot_format
from swimid.formats.parameters import ParameterFile
from swimid.models.base import Model, Parameter
from swimid.models.multilink.drive import Beat as Drive
from swimid.models.multilink.model import DEFAULT_STEP, PLANES, prepare
from swimid.models.tied import Tied, groups_by_prefix
from swimid.notices import recorded
from swimid.progress import Progress, silent
from swimid.reporting import numbers
from swimid.signals.beat import find_beat
from swimid.verbs import fit_common
from swimid.verbs.outcome import Outcome

#: A channel's beat is looked for up to this multiple of the drive's frequency: surge beats at twice it.
BEAT_HARMONICS = 3.5


def fit_graybox(
    trials_file: str | Path,
    *,
    output: Path | None = None,
    fixed: Mapping[str, float] | None = None,
    freed: Sequence[str] = (),
    bounds: Mapping[str, tuple[float, float]] | None = None,
    share: Sequence[str] = (),
    channels: Sequence[str] = (),
    start_state: str = "auto",
    begin: Path | None = None,
    loss: output_error.Loss = "linear",
    starts: int = 1,
    seed: int = 0,
    subset: bool = False,
    readings: Mapping[str, str] | None = None,
    max_step: float = DEFAULT_STEP,
    jobs: int | None = None,
    progress: Progress = silent,
) -> Outcome:
    """Identify the coefficients of a multi-link robot by output error over all trials at once.

    Parameters
    ----------
    trials_file : path
        Of a free-swim or multibody experiment with a robot that has links.
    output : path, optional
        Parameter file to write; its evidence goes beside it.
    fixed, freed, bounds
        The user's choices by parameter name.
    share : sequence of str
        Prefixes: all coefficients of such a prefix and a number get one value.
    channels : sequence of str
        Columns to fit; default the pose where logged, else velocities, and passive joints.
    start_state : {"auto", "rest", "estimate"}
    begin : path, optional
        Parameter file whose values the search starts from.
    loss : {"linear", "huber"}
    starts, seed : int
        Number of starts over the bounds, the first being the given one.
    subset : bool
        Fix what the trials cannot tell, least identifiable first, until all the rest is known.
    readings : mapping, optional
        Readings of the robot's source other than the file's.
    max_step : float, s
    jobs : int, optional
        Threads; default one per processor.

    Raises
    ------
    InputError, UsageError
        For bad files and options.
    NoTrustworthyResult
        When nothing can be identified. Also when the search was interrupted: the best point so
        far is then written first.
    """
    with recorded(repeat=True) as notices:
        experiment = multilink_experiment.load(
            trials_file, readings=readings, channels=channels, start_state=start_state, max_step=max_step
        )
        prepare(progress)
        model = _tied(experiment.model, share)
        parameters = model.parameters if begin is None else _begun(model.parameters, begin, share)
        choices = fit_common.prepare(
            experiment,
            output,
            parameters=parameters,
            fixed=fixed,
            freed=freed,
            bounds=bounds,
            also=[begin] if begin else [],
        )
        if starts > 1:
            result, ends = multistart.multistart(
                model,
                experiment.trials,
                choices,
                starts=starts,
                seed=seed,
                jobs=jobs,
                loss=loss,
                progress=progress,
            )
        else:
            result = output_error.fit(
                model, experiment.trials, parameters=choices, jobs=jobs, loss=loss, progress=progress
            )
            ends = []
        left_out: list[str] = []
        if subset:
            result = _starting_here(result, experiment)
            result, left_out = identifiability.select_subset(result, jobs=jobs, progress=progress)
        result = start_states.with_held_out(result)
        origin = provenance.collect(
            [*experiment.inputs, *([begin] if begin else [])],
            settings={
                "fixed": dict(fixed or {}),
                "freed": list(freed),
                "bounds": {k: list(v) for k, v in (bounds or {}).items()},
                "share": list(share),
                "channels": list(channels),
                "start_state": start_state,
                "loss": loss,
                "starts": starts,
                "seed": seed,
                "subset": subset,
                "readings": dict(readings or {}),
                "max_step_s": max_step,
            },
        )
        file = _file(experiment, result, origin, left_out, output, trials_file, readings)
        checks = [*fit_common.checks(result, file), fit_common.beat_check(experiment.facts["beats"])]
        if ends:
            checks.append(_starts_check(ends))
    evidence = ev.Evidence(
        verb="fit-graybox",
        title=f"Gray-box identification of {experiment.robot.name}",
        verdict=fit_common.verdict(checks, fit_common.answer(file)),
        checks=checks,
        tables=_tables(experiment, result, ends),
        figures=[*_track(experiment, result), *fit_common.figures(result)],
        notices=fit_common.notices(notices),
        methods=_methods(experiment, result, ends, left_out),
        references=list(experiment.robot.sources),
        provenance=origin,
    )
    outputs = fit_common.save(output, file, evidence)
    if result.interrupted:
        kept = f"; the best point so far is in {output}, from which --start-from goes on" if output else ""
        raise NoTrustworthyResult(f"{result.message}{kept}")
    shared = [label for label in result.labels if "[" not in label]
    if shared and all(result.status[label] == "unidentifiable" for label in shared) and not file.derived:
        raise NoTrustworthyResult(
            f"none of {', '.join(shared)} can be identified from these trials",
            hint="use longer and more different trials, or fix what is known with --fix",
        )
    summary = "\n".join(
        [
            f"{experiment.robot.name}: {len(result.trials)} trials, {result.samples} samples, "
            f"{', '.join(result.noise)}",
            fit_common.summary_rows(fit_common.brief(file)),
            *(f"  {line}" for line in file.identifiability),
            *_scores(file),
            f"{evidence.verdict.level.upper()}: {fit_common.judgement(evidence)}",
        ]
    )
    return Outcome("fit-graybox", summary, file.model_dump(mode="json"), outputs)


def _tied(model: Model, share: Sequence[str]) -> Model:
    groups = {name: members for prefix in share for name, members in groups_by_prefix(model, prefix).items()}
    return Tied(model, groups) if groups else model


def _starting_here(result: FitResult, experiment: Experiment) -> FitResult:
    """The same with the estimates as start values: what a subset leaves out is held at them.

    Held where a search starts, often the middle of the bounds, it would pull all others off. An
    estimate that ran into a bound is no value to hold either: the robot file's is taken then.
    """
    body = experiment.robot.multilink
    assert body is not None

    def moved(p: Parameter) -> Parameter:
        if p.per_trial:
            return p
        value = result.value(p.name)
        margin = 1e-3 * p.scale
        if p.name in body.coefficients and (value - p.lower < margin or p.upper - value < margin):
            value = body.coefficients[p.name].value
        return replace(p, start=value)

    return replace(result, parameters=tuple(moved(p) for p in result.parameters))


def _begun(parameters: tuple[Parameter, ...], path: Path, share: Sequence[str]) -> tuple[Parameter, ...]:
    """The parameters starting from a file's values; a shared one from its members' mean."""
    file = parameters_format.read(path, model="multilink")
    found = []
    for parameter in parameters:
        members = [parameter.name]
        if parameter.name in share:
            members = [n for n in file.parameters if n.removeprefix(parameter.name).isdigit()]
        known = [file.parameters[n].value for n in members if n in file.parameters]
        if known and not parameter.per_trial:
            value = float(np.clip(np.mean(known), parameter.lower, parameter.upper))
            parameter = replace(parameter, start=value)
        found.append(parameter)
    if not any(p.name in file.parameters for p in parameters):
        raise InputError("holds none of this robot's coefficients", file=path)
    return tuple(found)


def _file(
    experiment: Experiment,
    result: FitResult,
    origin: dict[str, Any],
    left_out: list[str],
    output: Path | None,
    trials_file: str | Path,
    readings: Mapping[str, str] | None,
) -> ParameterFile:
    settings: dict[str, Any] = {}
    if readings:
        settings["readings"] = dict(readings)
    model = result.model
    if isinstance(model, Tied):
        settings["shared"] = {name: list(members) for name, members in model.groups.items()}
    if left_out:
        settings["fixed_as_unidentifiable"] = left_out
    file = fit_common.parameter_file(
        result,
        robot=_robot_reference(experiment, trials_file, output),
        provenance=origin,
        settings=settings,
        method=f"output error, {result.loss} loss",
    )
    parameters = file.parameters
    if isinstance(model, Tied):
        parameters = model.expanded(parameters)
    return file.model_copy(update={"parameters": parameters})


def _robot_reference(experiment: Experiment, trials_file: str | Path, output: Path | None) -> str:
    """The robot as the parameter file names it: built in, or a path relative to that file."""
    name, path = experiment.robot.name, experiment.inputs[1].resolve()
    if name in robot_format.built_in() and path == robot_format.locate(name).resolve():
        return name
    folder = output.parent if output else Path(trials_file).parent
    return Path(os.path.relpath(path, folder.resolve())).as_posix()


def _track(experiment: Experiment, result: FitResult) -> list[ev.Figure]:
    """The paths in the plane of motion, where the pose was fitted."""
    body = experiment.robot.multilink
    assert body is not None
    across, along = PLANES[body.plane].pose[:2]
    traces = []
    for group, trial in enumerate(t.id for t in result.trials):
        series = {s.channel: s for s in result.series if s.trial == trial}
        if across not in series or along not in series:
            continue
        held_out = ", held out" if series[across].role == "validate" else ""
        for style, part in (("points", "measured"), ("line" if not held_out else "dashed", "simulated")):
            x, y = getattr(series[across], part), getattr(series[along], part)
            step = max(len(x) // 200, 1) if style == "points" else 1
            label = f"{trial}{held_out}" if style == "points" else ""
            traces.append(ev.Trace(x=x[::step], y=y[::step], style=style, label=label, group=group))
    if not traces:
        return []
    view = "from above" if body.plane == "horizontal" else "from the side"
    panel = ev.Panel(
        x_label=f"{across[:-2]} (m)", y_label=f"{along[:-2]} (m)", traces=traces, equal_aspect=True
    )
    return [
        ev.Figure(
            id="track",
            title=f"Paths {view}",
            caption="Points are measured, lines simulated with the estimated parameters.",
            panels=[panel],
        )
    ]


def _starts_check(ends: Sequence[multistart.Start]) -> ev.Check:
    agree = multistart.agreeing(ends)
    return ev.Check(
        name="one minimum",
        value=f"{agree} of {len(ends)} starts end in it",
        limit="every start",
        verdict="pass" if agree == len(ends) else "warn",
        text="the other starts end higher; the lowest is reported" if agree < len(ends) else "",
    )


def _tables(experiment: Experiment, result: FitResult, ends: Sequence[multistart.Start]) -> list[ev.Table]:
    tables = [_metrics_table(result)]
    ranking = identifiability.ranked(result)
    if len(ranking) > 1:
        tables.append(
            ev.Table(
                id="ranking",
                title="What the trials know best",
                columns=["parameter", "share of its own", "status"],
                rows=[[label, round(share, 4), result.status[label]] for label, share in ranking],
                caption="From the best to the least identifiable parameter. The share is the part of the "
                "trials' sensitivity to it that those above it, and the start states, cannot imitate.",
            )
        )
    if ends:
        tables.append(
            ev.Table(
                id="starts",
                title="Starts",
                columns=["start", "converged", "cost"],
                rows=[[k + 1, end.converged, float(end.cost)] for k, end in enumerate(ends)],
                caption="The cost is the mean squared residual, averaged geometrically over the channels.",
            )
        )
    readings = experiment.robot.readings
    if readings:
        tables.append(
            ev.Table(
                id="readings",
                title="How the source was read",
                columns=["reading", "question", "chosen", "meaning"],
                rows=[[k, r.question, r.chosen, r.options[r.chosen].says] for k, r in readings.items()],
                caption="Other readings are options of the robot file (--reading NAME=OPTION).",
            )
        )
    return tables


def _metrics_table(result: FitResult) -> ev.Table:
    rows: list[list[Any]] = []
    units = {c.name: c.unit for c in result.model.channels}
    drives = {t.id: t.settings.get("beat") for t in result.trials}
    for s in result.series:
        score = metrics.score(s.measured, s.simulated)
        _, relative = metrics.peak_error(s.measured, s.simulated)
        rows.append(
            [
                s.trial,
                "held out" if s.role == "validate" else "fit",
                s.channel,
                numbers.number(score.rmse, 3, units[s.channel]),
                numbers.number(100 * score.nrmse, 3, "%"),
                numbers.number(100 * score.vaf, 4, "%"),
                numbers.number(100 * relative, 3, "%"),
                numbers.number(_dtw(s), 3, units[s.channel]),
                _phase(s, drives[s.trial]),
            ]
        )
    return ev.Table(
        id="metrics",
        title="Errors of every trial",
        columns=[
            "trial",
            "role",
            "channel",
            "RMSE",
            "NRMSE",
            "VAF",
            "peak error",
            "DTW distance",
            "phase error",
        ],
        rows=rows,
        caption="NRMSE is over the measured range (tendon fish, Eq 13); the peak error is the difference of "
        "the largest magnitudes over the measured one (Eq 14); DTW is the distance per sample after warping "
        "within 5 % of the record; the phase error is taken at the beat.",
    )


def _dtw(s: Series) -> float:
    return float(metrics.dtw_distance(s.measured, s.simulated, band=max(1, len(s.measured) // 20)))


def _phase(s: Series, drive: Drive | None) -> str:
    there = np.isfinite(s.measured)
    highest = None
    if drive is not None and there.sum() > 1:
        rate = 1.0 / float(np.median(np.diff(s.time_s[there])))
        highest = min(BEAT_HARMONICS * drive.frequency_hz, 0.45 * rate)
    beat = find_beat(s.time_s[there], s.measured[there], highest_hz=highest)
    if beat is None:
        return ""
    error = metrics.phase_error(s.measured, s.simulated, s.time_s, frequency_hz=beat.frequency_hz)
    return numbers.number(float(np.degrees(error)), 2, "deg")


def _methods(
    experiment: Experiment, result: FitResult, ends: Sequence[multistart.Start], left_out: list[str]
) -> list[str]:
    fitted = [t for t in result.trials if t.role == "fit"]
    names = [label for label in result.labels if "[" not in label]
    body = experiment.robot.multilink
    assert body is not None
    model = result.model.model if isinstance(result.model, Tied) else result.model
    said = [
        f"{', '.join(names)} were estimated from {len(fitted)} {experiment.name} trials ({result.samples} "
        f"samples of {', '.join(result.noise)}) by output-error maximum likelihood with a planar model of "
        f"{len(body.links)} links, integrated by a fourth-order Runge-Kutta method with steps of at most "
        f"{1e3 * getattr(model, 'max_step', DEFAULT_STEP):g} ms; halving them changes no sample by more than "
        f"{result.step_error:.2g} standard deviations of its noise.",
        "Standard errors follow from the Jacobian at the optimum with the residuals' autocorrelation "
        "accounted for.",
    ]
    if result.loss == "huber":
        said.append("Huber's loss was used.")
    if ends:
        said.append(
            f"{multistart.agreeing(ends)} of {len(ends)} starts, drawn evenly within the bounds, end in the "
            "reported minimum."
        )
    if left_out:
        said.append(f"{', '.join(left_out)} could not be identified and were held at the whole fit's values.")
    if any("[" in label for label in result.labels):
        kinds = dict.fromkeys(label.split("[")[0] for label in result.labels if "[" in label)
        said.append(
            f"Each trial has its own {', '.join(kinds)}; on held-out trials these are estimated with the "
            "rest held."
        )
    return said


def _scores(file: ParameterFile) -> list[str]:
    assert file.fit is not None
    lines = []
    for title, block in (("fit", file.fit.channels), ("held out", file.fit.validation.get("channels", {}))):
        for channel, score in block.items():
            rmse, nrmse = (
                numbers.number(score["rmse"], 3, score["unit"]),
                numbers.number(100 * score["nrmse"], 3),
            )
            vaf = numbers.number(100 * score["vaf"], 4)
            lines.append(f"  {title}, {channel}: RMSE {rmse}, NRMSE {nrmse} %, VAF {vaf} %")
    return lines
