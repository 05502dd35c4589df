"""``fit-drag``: drag, added mass and friction from a rig."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats

from swimid.errors import NoTrustworthyResult
from swimid.estimators import output_error, two_point
from swimid.estimators.profile import profile_interval
from swimid.estimators.residual_tests import fit_autoregression
from swimid.experiments import rig as rig_experiment
from swimid.experiments.base import Experiment
from swimid.formats import evidence as ev
from swimid.formats import provenance
from swimid.formats.parameters import Estimate, Fit, ParameterFile
from swimid.models import theory
from swimid.models.base import Parameter, Trial
from swimid.notices import recorded, warn
from swimid.progress import Progress, silent
from swimid.reporting import numbers
from swimid.verbs import fit_common
from swimid.verbs.outcome import Outcome

#: Trials are taken to start otherwise than at rest when that improves the fit beyond chance.
START_SIGNIFICANCE = 1e-6
#: ... and leaves at most this share of the squared error.
START_GAIN = 0.8
#: What may differ from trial to trial, besides noise, and how a start that does is described.
RIVALS = {
    "initial_speed": "moving",
    "clock_offset": "at another time than their first sample",
    "friction_deviation": "",
}


def fit_drag(
    trials_file: str | Path,
    *,
    output: Path | None = None,
    method: str = "ml",
    start_state: str = "auto",
    fixed: Mapping[str, float] | None = None,
    freed: Sequence[str] = (),
    bounds: Mapping[str, tuple[float, float]] | None = None,
    points_m: tuple[float, float] | None = None,
    profile: bool = False,
    coordinate: str | None = None,
    progress: Progress = silent,
) -> Outcome:
    """Identify a rig: falling weight, towing or free decay.

    Parameters
    ----------
    trials_file : path
    output : path, optional
        Parameter file to write; its evidence goes beside it.
    method : {"ml", "two-point"}
        Maximum likelihood over all samples, or the boxfish paper's Eqs 13-19 (falling weight
        only). The report shows both side by side where both can be had.
    start_state : {"auto", "rest", "estimate"}
        Whether the trials start at rest at their first sample; ``auto`` lets the data say.
    fixed, freed, bounds
        The user's choices by parameter name.
    points_m : (x1, x2), optional
        Displacements of the two-point method.
    profile : bool
        Profile-likelihood intervals beside the standard errors.
    coordinate : str, optional
        Coordinate of a free decay.

    Raises
    ------
    InputError, UsageError
        For bad files and options.
    NoTrustworthyResult
        When nothing can be identified.
    """
    with recorded(repeat=True) as notices:
        experiment = rig_experiment.load(trials_file, coordinate=coordinate)
        choices = fit_common.prepare(experiment, output, fixed=fixed, freed=freed, bounds=bounds)
        result, facts = _best_fit(experiment, choices, start_state, progress)
        profiles = _profiles(result, progress) if profile else {}
        pair = _two_point(experiment, points_m, insist=method == "two-point")
        origin = provenance.collect(
            experiment.inputs,
            settings={
                "method": method,
                "start_state": start_state,
                "fixed": dict(fixed or {}),
                "freed": list(freed),
                "bounds": {k: list(v) for k, v in (bounds or {}).items()},
            },
        )
        derived = _derived(experiment, result)
        file = fit_common.parameter_file(
            result,
            robot=experiment.robot.name,
            provenance=origin,
            profiles=profiles,
            derived=derived,
            settings=facts,
        )
        checks = fit_common.checks(result, file)
    estimated = [label for label in result.labels if "[" not in label]
    if estimated and all(result.status[label] != "estimated" for label in estimated):
        raise NoTrustworthyResult(
            f"none of {', '.join(estimated)} can be identified from these trials",
            hint="use longer runs, more different forces, or fix what is known with --fix",
        )
    if method == "two-point":
        assert pair is not None
        file = _two_point_file(file, pair)
    evidence = ev.Evidence(
        verb="fit-drag",
        title=f"Rig identification of {experiment.robot.name}: {experiment.name}",
        verdict=fit_common.verdict(checks, fit_common.answer(file)),
        checks=checks,
        tables=_tables(experiment, file, pair, result),
        figures=fit_common.figures(result) + _speed_figure(pair),
        notices=fit_common.notices(notices),
        methods=_methods(experiment, result, method, pair),
        references=list(experiment.robot.sources),
        provenance=origin,
    )
    outputs = fit_common.save(output, file, evidence)
    return Outcome(
        "fit-drag", _summary(experiment, file, evidence, pair), file.model_dump(mode="json"), outputs
    )


# ------------------------------------------------------------ fitting


def _best_fit(
    experiment: Experiment, choices: tuple[Parameter, ...], start_state: str, progress: Progress
) -> tuple[output_error.FitResult, dict[str, Any]]:
    """The fit under the reading of the logs the data prefer, and what was chosen."""
    facts: dict[str, Any] = {}
    model = experiment.model
    if start_state == "estimate":
        choices = _with_free(choices, ("start_offset", "initial_speed"))
    readings = experiment.variants or {"": experiment.trials}
    fits = {
        name: output_error.fit(model, trials, parameters=choices, progress=progress)
        for name, trials in readings.items()
    }
    name = min(fits, key=lambda key: _misfit(fits[key]))
    result = fits[name]
    if name:
        facts["encoder_rounding"] = name
    if start_state == "auto" and experiment.name == "falling-weight":
        result, found = _with_rivals(result, choices, progress)
        facts.update(found)
    return result, facts


def _misfit(result: output_error.FitResult) -> float:
    return float(sum(np.nansum(s.residual**2) for s in result.series if s.role == "fit"))


def _with_free(parameters: tuple[Parameter, ...], names: tuple[str, ...]) -> tuple[Parameter, ...]:
    return tuple(replace(p, free=True) if p.name in names else p for p in parameters)


def _with_rivals(
    result: output_error.FitResult, choices: tuple[Parameter, ...], progress: Progress
) -> tuple[output_error.FitResult, dict[str, Any]]:
    """Let the trials start otherwise, or their pulley friction differ, where the data clearly say so."""
    if any(p.free for p in choices if p.name in RIVALS):
        return result, {}
    fits: dict[str, output_error.FitResult] = {}
    for name in (*RIVALS, "linear_drag"):
        try:
            rival = output_error.fit(
                result.model,
                result.trials,
                parameters=_with_free(_rival_choices(result, choices, name), (name,)),
            )
        except NoTrustworthyResult:
            continue  # what cannot be estimated is no better explanation
        if _significant(result, rival):
            fits[name] = rival
    if not fits:
        return result, {"start_state": "rest"}
    least = min(_misfit(rival) for rival in fits.values())
    if "linear_drag" in fits and _misfit(fits["linear_drag"]) < 1.1 * least:
        # one number for all trials explains as much as one for each
        rival = fits["linear_drag"]
        size = numbers.measured(rival.value("linear_drag"), rival.stderr("linear_drag"), "N s/m")
        warn(
            "SWM024",
            "a linear drag beside the quadratic one would explain most of what the fit leaves over "
            f"({size}): "
            "try --free linear_drag",
        )
        return result, {"start_state": "rest"}
    fits.pop("linear_drag", None)
    if not fits:
        return result, {"start_state": "rest"}
    reason = min(fits, key=lambda name: _misfit(fits[name]))
    best = fits[reason]
    labels = [label for label in best.labels if label.startswith(f"{reason}[")]
    sizes = ", ".join(f"{label[len(reason) + 1 : -1]} {best.value(*_split(label)):+.3g}" for label in labels)
    unit = next(p.unit for p in choices if p.name == reason)
    if reason == "friction_deviation":
        warn(
            "SWM014",
            f"the pulley friction differs from trial to trial ({sizes} {unit}); the common one is "
            "their mean, with the standard error of a mean",
        )
        return _mean_friction(best, result.value("pulley_friction")), {
            "start_state": "rest",
            "friction": "per trial",
        }
    warn(
        "SWM017",
        f"the trials start {RIVALS[reason]}; {reason} is estimated for each ({sizes} {unit}). "
        "Use --start-state rest to insist on rest at the first sample",
    )
    return best, {"start_state": reason}


def _rival_choices(
    result: output_error.FitResult, choices: tuple[Parameter, ...], name: str
) -> tuple[Parameter, ...]:
    """The choices a rival is fitted with: with a friction of each trial there is no common one."""
    if name != "friction_deviation":
        return choices
    return tuple(
        replace(p, free=False, start=result.value("pulley_friction")) if p.name == "pulley_friction" else p
        for p in choices
    )


def _mean_friction(result: output_error.FitResult, base: float) -> output_error.FitResult:
    """The fit with the mean of the trials' frictions as the common one, and deviations from it.

    The standard error of the mean is the trials' scatter over the root of their number, with
    Student's t for so few of them, beside what the noise of each contributes.
    """
    mine = [i for i, label in enumerate(result.labels) if label.startswith("friction_deviation[")]
    values = result.estimate[mine]
    n = len(mine)
    student = float(stats.t.ppf(0.975, n - 1) / stats.norm.ppf(0.975))
    scatter = float(np.var(values, ddof=1)) / n * student**2
    weights = np.zeros((1, len(result.labels)))
    weights[0, mine] = 1.0 / n
    rows = np.vstack([weights, np.eye(len(result.labels))])
    covariance = rows @ np.nan_to_num(result.covariance) @ rows.T
    covariance[0, 0] += scatter
    estimate = np.concatenate(([base + values.mean()], result.estimate))
    for i in mine:
        estimate[i + 1] -= values.mean()
    parameters = tuple(
        replace(p, start=float(base + values.mean()), free=True) if p.name == "pulley_friction" else p
        for p in result.parameters
    )
    return replace(
        result,
        labels=["pulley_friction", *result.labels],
        estimate=estimate,
        covariance=covariance,
        status={"pulley_friction": "estimated", **result.status},
        parameters=parameters,
    )


def _split(label: str) -> tuple[str, str]:
    name, _, trial = label.partition("[")
    return name, trial.rstrip("]")


def _significant(plain: output_error.FitResult, rival: output_error.FitResult) -> bool:
    """Whether the rival's extra unknowns lower the error beyond what coloured noise allows."""
    extra = len(rival.labels) - len(plain.labels)
    before, after = _misfit(plain), _misfit(rival)
    if after <= 0 or before <= after or after > START_GAIN * before:
        return False
    colour = 1.0
    for noise in rival.noise.values():
        if len(noise.autoregression):
            series = np.concatenate([s.weighted for s in rival.series if s.role == "fit"])
            fitted = fit_autoregression(series, order=len(noise.autoregression))
            colour = max(colour, fitted.long_run_variance / float(np.nanvar(series)))
    statistic = (before - after) / (after / max(rival.samples - len(rival.labels), 1)) / colour
    return bool(stats.chi2.sf(statistic, extra) < START_SIGNIFICANCE)


def _profiles(
    result: output_error.FitResult, progress: Progress
) -> dict[str, tuple[float | None, float | None]]:
    names = [label for label in result.labels if "[" not in label and result.stderr(label) is not None]
    found = {}
    with progress("profiling", total=len(names)) as step:
        for name in names:
            found[name] = profile_interval(result, name)
            step()
    return found


# ------------------------------------------------------------ two-point method


def _two_point(
    experiment: Experiment, points_m: tuple[float, float] | None, *, insist: bool
) -> two_point.TwoPointResult | None:
    """The paper's method, where it applies; raises only when it was asked for."""
    body, rig = experiment.robot.body, experiment.robot.rig
    pulled = [t for t in experiment.trials if t.settings.get("pulley") and t.role == "fit"]
    reason = None
    if experiment.name != "falling-weight" or len(pulled) < 3:
        reason = "it needs a falling-weight experiment with at least three pulling masses"
    elif body.inertial_mass_kg is None or body.frontal_area_m2 is None:
        reason = "the robot's inertial mass and frontal area are needed"
    if reason:
        if insist:
            raise NoTrustworthyResult(f"the two-point method cannot be used: {reason}")
        return None
    gravity = experiment.robot.fluid.gravity_m_s2
    try:
        return two_point.two_point(
            [
                two_point.Drop(
                    t.id,
                    t.settings["force"] / gravity,
                    t.time_s - t.settings["release_s"],
                    t.measured["x_m"] - t.settings["x0"],
                )
                for t in pulled
            ],
            inertial_mass_kg=float(body.inertial_mass_kg or 0.0),
            pulley_inertia_kg=rig.pulley_inertia_kg,
            frontal_area_m2=float(body.frontal_area_m2 or 0.0),
            density_kg_m3=experiment.robot.fluid.density_kg_m3,
            gravity_m_s2=gravity,
            points_m=points_m,
        )
    except NoTrustworthyResult:
        if insist:
            raise
        return None


def _two_point_file(file: ParameterFile, pair: two_point.TwoPointResult) -> ParameterFile:
    """The parameter file with the two-point method's values in place of the fit's."""
    values = {
        "drag_coefficient": pair.drag_coefficient,
        "added_mass": pair.added_mass,
        "pulley_friction": pair.pulley_friction,
    }
    parameters = {
        name: Estimate(
            value=value,
            stderr=pair.stderr[name],
            unit=file.parameters[name].unit,
            bounds=file.parameters[name].bounds,
            status="estimated" if math.isfinite(pair.stderr[name]) else "unidentifiable",
        )
        for name, value in values.items()
    }
    assert file.fit is not None
    fit = Fit(trials=file.fit.trials, converged=True, method="two-point", points_m=list(pair.points_m))  # type: ignore[call-arg]
    return file.model_copy(
        update={"parameters": parameters, "correlation": None, "identifiability": [], "fit": fit}
    )


# ------------------------------------------------------------ what follows from the parameters


def _derived(experiment: Experiment, result: output_error.FitResult) -> dict[str, Estimate]:
    """Terminal speed of each falling-weight trial, or period and damping ratio of a decay."""
    found: dict[str, Estimate] = {}
    if experiment.name == "free-decay":
        trial = experiment.trials[0]

        def swing(values: np.ndarray) -> np.ndarray:
            c = result.model.coefficients(values, trial.settings)  # type: ignore[attr-defined]
            rate = math.sqrt(max(c["stiffness"], 0.0) / c["inertia"])
            return np.array(
                [
                    2 * math.pi / rate if rate else math.nan,
                    c["linear"] / (2 * c["inertia"] * rate) if rate else math.nan,
                ]
            )

        value, error = _propagated(result, trial, swing)
        found["natural_period_s"] = Estimate(value=value[0], stderr=error[0], unit="s", status="estimated")
        found["damping_ratio_linear"] = Estimate(
            value=value[1], stderr=error[1], unit="1", status="estimated"
        )
    if experiment.name == "falling-weight":
        for trial in experiment.trials:

            def terminal(values: np.ndarray, trial: Trial = trial) -> np.ndarray:
                c = result.model.coefficients(values, trial.settings)  # type: ignore[attr-defined]
                push = trial.settings["force"] - c["dry"]
                if push <= 0 or c["quadratic"] <= 0:
                    return np.array([math.nan])
                return np.array(
                    [
                        (math.sqrt(c["linear"] ** 2 + 4 * c["quadratic"] * push) - c["linear"])
                        / (2 * c["quadratic"])
                    ]
                )

            value, error = _propagated(result, trial, terminal)
            if math.isfinite(value[0]):
                found[f"terminal_speed[{trial.id}]"] = Estimate(
                    value=value[0], stderr=error[0], unit="m/s", status="estimated"
                )
    return found


def _propagated(
    result: output_error.FitResult, trial: Trial, function: Any
) -> tuple[list[float], list[float | None]]:
    """A function of the parameters with its standard error, to first order."""
    values = result.values(trial.id)
    centre = function(values)
    names = [p.name for p in result.parameters]
    labels = [label for label in result.labels if result.stderr(label) is not None and "[" not in label]
    gradient = np.zeros((len(centre), len(labels)))
    for j, label in enumerate(labels):
        step = 1e-4 * float(result.stderr(label) or 1.0)
        moved = values.copy()
        moved[names.index(label)] += step
        gradient[:, j] = (function(moved) - centre) / step
    index = [result.labels.index(label) for label in labels]
    variance = np.diag(gradient @ result.covariance[np.ix_(index, index)] @ gradient.T)
    return [float(v) for v in centre], [
        float(math.sqrt(v)) if math.isfinite(v) and v >= 0 else None for v in variance
    ]


# ------------------------------------------------------------ words and pictures


def _tables(
    experiment: Experiment,
    file: ParameterFile,
    pair: two_point.TwoPointResult | None,
    result: output_error.FitResult,
) -> list[ev.Table]:
    tables = []
    rows: list[list[Any]] = []
    names = ("drag_coefficient", "added_mass", "pulley_friction")
    estimates = theory.estimates(experiment.robot)
    fitted = fit_common.estimates(result, {})
    for name in dict.fromkeys([*names, *(t.parameter for t in estimates)]):
        if name not in fitted:
            continue
        e = fitted[name]
        row: list[Any] = [
            name,
            "not identifiable"
            if e.status == "unidentifiable"
            else numbers.measured(e.value, e.stderr, e.unit),
        ]
        row.append(
            ""
            if pair is None or name not in pair.stderr
            else numbers.measured(getattr(pair, name), pair.stderr[name], e.unit)
        )
        row.append(
            "" if pair is None or name not in pair.bias else numbers.number(pair.bias[name], 2, e.unit)
        )
        row.append(
            "; ".join(
                f"{numbers.number(t.value, 3, t.unit)} ({t.basis})" for t in estimates if t.parameter == name
            )
        )
        rows.append(row)
    if rows:
        tables.append(
            ev.Table(
                id="methods",
                title="Both methods and theory side by side",
                columns=["parameter", "maximum likelihood", "two-point", "two-point bias", "theory"],
                rows=rows,
                caption="The two-point method takes the moving mass as equal for all pulling "
                "weights; its bias is "
                "what it gives on perfect data computed at its own answer, and is part of its stated error.",
            )
        )
    return tables


def _speed_figure(pair: two_point.TwoPointResult | None) -> list[ev.Figure]:
    if pair is None:
        return []
    grams = 1e3 * pair.pulling_mass_kg
    order = np.argsort(grams)
    traces = []
    for i, point in enumerate(pair.points_m):
        traces.append(
            ev.Trace(
                x=grams[order],
                y=pair.speed_squared[i][order],
                y_error=1.96 * pair.speed_squared_sd[i][order],
                style="points",
                label=f"at {point:.3f} m",
                group=i,
            )
        )
        line = pair.slopes[i] * pair.pulling_mass_kg[order] + pair.intercepts[i]
        traces.append(ev.Trace(x=grams[order], y=line, group=i))
    return [
        ev.Figure(
            id="speed-squared",
            title="Squared speed against pulling mass",
            caption="Speeds read off at two displacements, with straight lines (Eq 13). Where the "
            "points do not lie "
            "on lines, the friction or the drag changes with speed.",
            panels=[ev.Panel(x_label="pulling mass (g)", y_label="squared speed (m²/s²)", traces=traces)],
        )
    ]


def _methods(
    experiment: Experiment, result: output_error.FitResult, method: str, pair: two_point.TwoPointResult | None
) -> list[str]:
    trials = [t for t in result.trials if t.role == "fit"]
    names = [label for label in result.labels if "[" not in label]
    said = [
        f"{', '.join(names)} were estimated from {len(trials)} {experiment.name} trials "
        f"({result.samples} samples) by "
        "output-error maximum likelihood with a single-degree-of-freedom rig model.",
        "Standard errors follow from the Jacobian at the optimum with the residuals' autocorrelation "
        "accounted for.",
    ]
    kinds = set(experiment.facts.get("encoder", {}).values()) - {"continuous"}
    if kinds:
        step = experiment.facts.get("resolution_m")
        size = f" of {numbers.number(1e3 * step, 3)} mm" if step else ""
        said.append(
            f"The displacement came from an encoder with steps{size}; its quantisation is part of "
            "the noise model."
        )
    if method == "two-point" and pair is not None:
        said.append(
            f"The two-point method (Eqs 13 to 19 of the source) was used at {pair.points_m[0]:.3f} "
            f"and {pair.points_m[1]:.3f} m."
        )
    return said


def _summary(
    experiment: Experiment, file: ParameterFile, evidence: ev.Evidence, pair: two_point.TwoPointResult | None
) -> str:
    assert file.fit is not None
    shown = file.model_copy(
        update={
            "derived": {k: v for k, v in file.derived.items() if "[" not in k},
            "parameters": {k: v for k, v in file.parameters.items() if "[" not in k},
        }
    )
    lines = [
        f"{experiment.name} of {experiment.robot.name}: {len(file.fit.trials)} trials"
        + (
            f", {file.fit.model_extra['samples']} samples"
            if file.fit.model_extra and "samples" in file.fit.model_extra
            else ""
        ),
        fit_common.summary_rows(shown),
    ]
    if pair is not None and getattr(file.fit, "method", "") != "two-point":
        lines.append(
            "  two-point method: "
            + "; ".join(
                numbers.measured(getattr(pair, name), pair.stderr[name], unit)
                for name, unit in (("drag_coefficient", "1"), ("added_mass", "kg"), ("pulley_friction", "N"))
            )
        )
    lines.append(f"{evidence.verdict.level.upper()}: " + fit_common.judgement(evidence))
    return "\n".join(lines)
