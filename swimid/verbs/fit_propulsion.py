"""``fit-propulsion``: the recoil law from a cruise table, or beat-averaged surge from free swimming."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from swimid.errors import NoTrustworthyResult, UsageError
from swimid.estimators import output_error
from swimid.estimators.output_error import FitResult
from swimid.experiments import propulsion as experiment_module
from swimid.experiments.base import Experiment
from swimid.formats import evidence as ev
from swimid.formats import provenance
from swimid.formats.parameters import Estimate, ParameterFile
from swimid.models.base import Array, Parameter, Trial, chosen
from swimid.models.propulsion import SPEED, RecoilModel, strouhal, velocity_ratio
from swimid.notices import recorded, warn
from swimid.progress import Progress, silent
from swimid.reporting import numbers
from swimid.verbs import fit_common
from swimid.verbs.outcome import Outcome

#: A frequency at which all runs lie off the law by more than this share, and by more standard
#: errors than that, is left out of the fit and reported.
DEPARTURE_SHARE = 0.01
DEPARTURE_Z = 4.0
#: The paper's amplitude for single-point figures (Figs 8, 11, 12), taken where it was run.
LAWS = {"frequency_exponent": 3.0, "amplitude_exponent": 2.0}


def fit_propulsion(
    trials_file: str | Path,
    *,
    drag: Path | None = None,
    output: Path | None = None,
    wake: str = "fin",
    keep_departures: bool = False,
    fixed: dict[str, float] | None = None,
    freed: Sequence[str] = (),
    progress: Progress = silent,
) -> Outcome:
    """Identify the propulsion of a fin.

    Parameters
    ----------
    trials_file : path
        A cruise experiment (recoil law, boxfish paper Eqs 3-6, 25-27), or straight free-swim
        trials (beat-averaged surge: thrust by a power of amplitude, quadratic drag).
    drag : path, optional
        Drag file of the rig; needed for a cruise.
    output : path, optional
        Parameter file to write; its evidence goes beside it.
    wake : {"fin", "axle"}
        Lever of the wake width in the Strouhal number: the fin's length (the paper's Eq 28), or
        the distance from axle to trailing edge. Both are in the report.
    keep_departures : bool
        Fit frequencies that depart from the law too.
    fixed, freed
        The user's choices by parameter name.

    Raises
    ------
    InputError, UsageError
        For bad files and options.
    NoTrustworthyResult
        When nothing can be identified.
    """
    with recorded() as notices:
        experiment = experiment_module.load(trials_file, drag=drag)
        choices = chosen(experiment.model.parameters, fixed=fixed, freed=tuple(freed))
        settings = {
            "wake": wake,
            "keep_departures": keep_departures,
            "fixed": dict(fixed or {}),
            "freed": list(freed),
        }
        origin = provenance.collect(experiment.inputs, settings=settings)
        if experiment.name == "cruise":
            page = _cruise(experiment, choices, origin, wake, keep_departures, progress)
        else:
            if drag is not None:
                raise UsageError("--drag belongs to a cruise experiment; free-swim trials do not use it")
            page = _surge(experiment, choices, origin, progress)
    file, evidence = page
    for notice in notices:
        warn(notice.code, notice.text)
    evidence.notices = fit_common.notices(notices)
    outputs = fit_common.save(output, file, evidence)
    summary = "\n".join(
        [
            f"{experiment.name} of {experiment.robot.name}",
            fit_common.summary_rows(_brief(file)),
            f"{evidence.verdict.level.upper()}: {fit_common.judgement(evidence)}",
        ]
    )
    return Outcome("fit-propulsion", summary, file.model_dump(mode="json"), outputs)


def _brief(file: ParameterFile) -> ParameterFile:
    def shared(block: dict[str, Estimate]) -> dict[str, Estimate]:
        return {k: v for k, v in block.items() if "[" not in k}

    return file.model_copy(update={"parameters": shared(file.parameters), "derived": shared(file.derived)})


# ------------------------------------------------------------ cruise


def _cruise(
    experiment: Experiment,
    choices: tuple[Parameter, ...],
    origin: dict[str, Any],
    wake: str,
    keep_departures: bool,
    progress: Progress,
) -> tuple[ParameterFile, ev.Evidence]:
    model = experiment.model
    assert isinstance(model, RecoilModel)
    everything = output_error.fit(model, experiment.trials, parameters=choices, progress=progress)
    departures = [] if keep_departures else _departures(model, experiment.trials, choices)
    kept = [_without(t, [d["frequency_hz"] for d in departures]) for t in experiment.trials]
    result = (
        output_error.fit(model, kept, parameters=choices, progress=progress) if departures else everything
    )
    if all(result.status[label] == "unidentifiable" for label in result.labels):
        raise NoTrustworthyResult("neither efficiency nor offset can be identified from this table")
    exponents = _exponents(model, kept, choices)
    result = _with_drag_error(result, model, kept, choices, experiment)
    points = _operating_points(experiment, result, wake)
    derived = _derived(experiment, result, model, points)
    file = fit_common.parameter_file(
        result,
        robot=experiment.robot.name,
        provenance=origin,
        derived=derived | exponents,
        settings={"wake": wake, "drag_file": str(experiment.facts["drag_path"])},
    )
    assert file.fit is not None
    assert file.fit.model_extra is not None
    file.fit.model_extra["departures"] = departures
    file.fit.model_extra["operating_points"] = points
    offsets = _offsets(experiment)
    checks = fit_common.checks(result, file) + _law_checks(departures, exponents)
    evidence = ev.Evidence(
        verb="fit-propulsion",
        title=f"Propulsion of {experiment.robot.name}: energy recoil law",
        verdict=fit_common.verdict(checks, _answer(file)),
        checks=checks,
        tables=_cruise_tables(experiment, points, offsets, departures, everything, result),
        figures=_cruise_figures(experiment, result, points),
        methods=[
            "Recoil efficiency and amplitude offset were estimated from the average speeds of "
            f"{result.samples} runs over {len(experiment.trials)} fins by weighted least squares "
            "under the energy recoil "
            "law (Eqs 5, 25 to 27), with drag coefficient and added mass from the falling-weight rig "
            "and their "
            "uncertainty carried along.",
            "Average speeds were converted to terminal speeds by the velocity ratio of Eq 25.",
        ],
        references=list(experiment.robot.sources),
        provenance=origin,
    )
    return file, evidence


def _without(trial: Trial, frequencies: list[float]) -> Trial:
    """The trial with its runs at some frequencies masked."""
    speed = trial.measured[SPEED].copy()
    for frequency in frequencies:
        speed[np.isclose(trial.inputs["frequency_hz"], frequency)] = np.nan
    return replace(trial, measured={SPEED: speed})


def _departures(
    model: RecoilModel, trials: list[Trial], choices: tuple[Parameter, ...]
) -> list[dict[str, Any]]:
    """Frequencies at which the runs lie off the law fitted to all others, worst first."""
    levels = np.unique(
        np.concatenate([t.inputs["frequency_hz"][np.isfinite(t.measured[SPEED])] for t in trials])
    )
    found: list[dict[str, Any]] = []
    while len(levels) - len(found) > 3 and len(found) < len(levels) // 3:
        out = [d["frequency_hz"] for d in found]
        tests = []
        for level in (f for f in levels if f not in out):
            rest = [_without(t, [*out, float(level)]) for t in trials]
            try:
                fitted = output_error.fit(model, rest, parameters=choices)
            except NoTrustworthyResult:
                continue
            tests.append(_departure(fitted, trials, float(level)))
        tests = [t for t in tests if abs(t["z"]) > DEPARTURE_Z and abs(t["share"]) > DEPARTURE_SHARE]
        if not tests:
            break
        worst = max(tests, key=lambda t: abs(t["z"]))
        found.append(worst)
        warn(
            "SWM030",
            f"the runs at {worst['frequency_hz']:g} Hz are {abs(100 * worst['share']):.1f} % "
            f"{'slower' if worst['share'] < 0 else 'faster'} than the law fitted to the other frequencies "
            f"({abs(worst['z']):.1f} standard errors, {worst['runs']} runs); they are left out of the fit. "
            "Fins that flex at high frequency do this (source, section 4.2)",
        )
    return found


def _departure(fitted: FitResult, trials: list[Trial], level: float) -> dict[str, Any]:
    shares, spread = [], []
    for trial in trials:
        predicted = fitted.model.simulate(fitted.values(trial.id), trial)[SPEED]
        at = np.isclose(trial.inputs["frequency_hz"], level) & np.isfinite(trial.measured[SPEED])
        shares += list(trial.measured[SPEED][at] / predicted[at] - 1)
        size = float(np.sqrt(np.mean([np.nanmean(s.weighted**2) for s in fitted.series])))
        reference = fitted.noise[SPEED].value_sd
        shape = np.asarray(trial.value_sd[SPEED])[at]
        known = np.asarray(trial.value_sd[SPEED])
        spread += list(size * shape * reference / float(np.sqrt(np.mean(known**2))) / predicted[at])
    share = float(np.mean(shares))
    error = float(np.sqrt(np.mean(np.square(spread)) / len(shares)))
    # the law's own uncertainty at a level is of the order of one run's among all others
    error = math.hypot(error, float(np.sqrt(np.mean(np.square(spread)) / max(fitted.samples, 1))) * 2)
    return {"frequency_hz": level, "share": share, "stderr": error, "z": share / error, "runs": len(shares)}


def _exponents(
    model: RecoilModel, trials: list[Trial], choices: tuple[Parameter, ...]
) -> dict[str, Estimate]:
    """Each exponent of the law set free in turn; the offset stays free with it."""
    found = {}
    for name, law in LAWS.items():
        free = tuple(replace(p, free=True) if p.name == name else p for p in choices)
        try:
            result = output_error.fit(model, trials, parameters=free)
        except NoTrustworthyResult:
            continue
        value, stderr = result.value(name), result.stderr(name)
        status = result.status[name]
        found[f"free_{name}"] = Estimate(value=value, stderr=stderr, unit="1", bounds=(0, 6), status=status)  # type: ignore[arg-type]
        if status == "estimated" and stderr and abs(value - law) > 3 * stderr:
            warn(
                "SWM031",
                f"set free, the {name.replace('_', ' ')} of power is "
                f"{numbers.measured(value, stderr)}, the law says {law:g}",
            )
    return found


def _with_drag_error(
    result: FitResult,
    model: RecoilModel,
    trials: list[Trial],
    choices: tuple[Parameter, ...],
    experiment: Experiment,
) -> FitResult:
    """Add what the drag file's uncertainty contributes to the covariance."""
    drag: ParameterFile = experiment.facts["drag"]
    names = ("drag_coefficient", "added_mass")
    errors = [drag.parameters[n].stderr or 0.0 for n in names]
    if not any(errors):
        return result
    shifts = np.zeros((2, len(result.labels)))
    for i, name in enumerate(names):
        if not errors[i]:
            continue
        moved = drag.model_copy(deep=True)
        moved.parameters[name].value += errors[i]
        area, mass = experiment_module.drag_numbers(moved, experiment.facts["drag_path"], experiment.robot)
        other = RecoilModel(
            drag_area_kg_m=area,
            moving_mass_kg=mass,
            fins={t.id: t.settings.get("inertia_kg_m2") for t in trials},
        )
        shifts[i] = output_error.fit(other, trials, parameters=choices).estimate - result.estimate
    rho = 0.0
    if drag.correlation and all(n in drag.correlation.names for n in names):
        i, j = (drag.correlation.names.index(n) for n in names)
        rho = drag.correlation.matrix[i][j]
    joint = np.array([[1.0, rho], [rho, 1.0]])
    return replace(result, covariance=result.covariance + shifts.T @ joint @ shifts)


def _operating_points(experiment: Experiment, result: FitResult, wake: str) -> list[dict[str, Any]]:
    """Terminal speed, force, Strouhal numbers and single-run efficiency of every run."""
    model = result.model
    assert isinstance(model, RecoilModel)
    offset = np.deg2rad(result.value("amplitude_offset_deg"))
    points = []
    for trial in experiment.trials:
        fin = experiment.robot.fins[trial.id]
        for k, speed in enumerate(trial.measured[SPEED]):
            if not np.isfinite(speed):
                continue
            f, a = float(trial.inputs["frequency_hz"][k]), float(trial.inputs["amplitude_rad"][k])
            terminal = float(speed / velocity_ratio(model.b1, 0.0, trial.inputs["distance_m"][k]))
            inertia = trial.settings.get("inertia_kg_m2")
            efficiency = None
            if inertia is not None and a > offset:
                efficiency = float(
                    model.drag_area_kg_m * terminal**3 / (8 * np.pi**2 * inertia * (a - offset) ** 2 * f**3)
                )
            args = (np.array(f), np.array(a))
            numbers_st = {
                "fin": float(strouhal(*args, np.array(fin.length_m), np.array(terminal))),
                "axle": float(strouhal(*args, np.array(fin.length_m + fin.axle_gap_m), np.array(terminal))),
            }
            points.append(
                {
                    "fin": trial.id,
                    "frequency_hz": f,
                    "amplitude_deg": float(np.rad2deg(a)),
                    "mean_speed_m_s": float(speed),
                    "terminal_speed_m_s": terminal,
                    "propulsive_force_N": float(model.drag_area_kg_m * terminal**2),
                    "strouhal": numbers_st[wake],
                    "strouhal_fin": numbers_st["fin"],
                    "strouhal_axle": numbers_st["axle"],
                    "efficiency": efficiency,
                }
            )
    return points


def _derived(
    experiment: Experiment, result: FitResult, model: RecoilModel, points: list[dict[str, Any]]
) -> dict[str, Estimate]:
    drag: ParameterFile = experiment.facts["drag"]
    distance = float(np.median(np.concatenate([t.inputs["distance_m"] for t in experiment.trials])))
    centre = float(velocity_ratio(model.b1, 0.0, distance))
    variance = 0.0
    for name in ("drag_coefficient", "added_mass"):
        moved = drag.model_copy(deep=True)
        moved.parameters[name].value += drag.parameters[name].stderr or 0.0
        area, mass = experiment_module.drag_numbers(moved, experiment.facts["drag_path"], experiment.robot)
        variance += (float(velocity_ratio(area / mass, 0.0, distance)) - centre) ** 2
    found = {
        "velocity_ratio": Estimate(value=centre, stderr=math.sqrt(variance), unit="1", status="estimated")
    }
    relative_drag = (drag.parameters["drag_coefficient"].stderr or 0.0) / drag.parameters[
        "drag_coefficient"
    ].value
    for end, pick in (("smallest", min), ("largest", max)):
        point = pick(points, key=lambda p: p["propulsive_force_N"])
        force = point["propulsive_force_N"]
        scatter = 2 * result.noise[SPEED].value_sd / float(np.median([p["mean_speed_m_s"] for p in points]))
        found[f"{end}_propulsive_force"] = Estimate(
            value=force, stderr=force * math.hypot(relative_drag, scatter), unit="N", status="estimated"
        )
    return found


def _offsets(experiment: Experiment) -> list[list[Any]]:
    """Amplitude offset of each fin and frequency: where the line of v^1.5 meets zero (Figs 9, 10)."""
    rows: list[list[Any]] = []
    for trial in experiment.trials:
        for f in np.unique(trial.inputs["frequency_hz"]):
            at = np.isclose(trial.inputs["frequency_hz"], f) & np.isfinite(trial.measured[SPEED])
            x, y = np.rad2deg(trial.inputs["amplitude_rad"][at]), trial.measured[SPEED][at] ** 1.5
            if len(np.unique(x)) < 3:
                continue
            (slope, level), covariance = np.polyfit(x, y, 1, cov="unscaled")
            residual = y - slope * x - level
            covariance = covariance * float(residual @ residual) / max(len(x) - 2, 1)
            offset = -level / slope
            gradient = np.array([level / slope**2, -1 / slope])
            rows.append(
                [
                    trial.id,
                    float(f),
                    numbers.measured(
                        float(offset), math.sqrt(float(gradient @ covariance @ gradient)), "deg"
                    ),
                ]
            )
    return rows


def _law_checks(departures: list[dict[str, Any]], exponents: dict[str, Estimate]) -> list[ev.Check]:
    found = [
        ev.Check(
            name="every frequency follows the law",
            value="all"
            if not departures
            else ", ".join(f"{d['frequency_hz']:g} Hz: {100 * d['share']:+.1f} %" for d in departures),
            limit=f"within {100 * DEPARTURE_SHARE:g} % or {DEPARTURE_Z:g} standard errors",
            verdict="pass" if not departures else "warn",
            text="" if not departures else "left out of the fit",
        )
    ]
    for name, law in LAWS.items():
        e = exponents.get(f"free_{name}")
        if e is None:
            continue
        known = e.status == "estimated" and e.stderr is not None
        agrees = not known or abs(e.value - law) <= 3 * (e.stderr or 0.0)
        found.append(
            ev.Check(
                name=name.replace("_", " "),
                value=numbers.measured(e.value, e.stderr) if known else "not identifiable",
                limit=f"{law:g} (the law)",
                verdict="info" if not known else "pass" if agrees else "warn",
                text="of the power, set free with the offset",
            )
        )
    return found


def _answer(file: ParameterFile) -> str:
    return (
        "; ".join(
            f"{name} {numbers.measured(e.value, e.stderr, e.unit)}"
            for name, e in file.parameters.items()
            if e.status == "estimated" and "[" not in name
        )
        + "."
    )


def _cruise_tables(
    experiment: Experiment,
    points: list[dict[str, Any]],
    offsets: list[list[Any]],
    departures: list[dict[str, Any]],
    everything: FitResult,
    result: FitResult,
) -> list[ev.Table]:
    fins = [
        [
            t.id,
            experiment.robot.fins[t.id].height_m,
            experiment.robot.fins[t.id].length_m,
            experiment.robot.fins[t.id].area_m2,
            None
            if t.settings.get("inertia_kg_m2") is None
            else numbers.number(1e7 * t.settings["inertia_kg_m2"], 5),
        ]
        for t in experiment.trials
    ]
    tables = [
        ev.Table(
            id="fins",
            title="Fins",
            columns=["fin", "height (m)", "length (m)", "area (m²)", "hydrodynamic inertia (g cm²)"],
            rows=fins,
            caption="A rectangle's inertia follows from Eq 6; where none is shown it is not known.",
        ),
        ev.Table(
            id="points",
            title="Runs",
            columns=[
                "fin",
                "f (Hz)",
                "amplitude (deg)",
                "average speed (cm/s)",
                "terminal speed (cm/s)",
                "force (mN)",
                "Strouhal, fin",
                "Strouhal, axle",
                "efficiency (%)",
            ],
            rows=[
                [
                    p["fin"],
                    p["frequency_hz"],
                    round(p["amplitude_deg"], 3),
                    numbers.number(100 * p["mean_speed_m_s"], 4),
                    numbers.number(100 * p["terminal_speed_m_s"], 4),
                    numbers.number(1e3 * p["propulsive_force_N"], 4),
                    numbers.number(p["strouhal_fin"], 3),
                    numbers.number(p["strouhal_axle"], 3),
                    numbers.number(100 * p["efficiency"], 3) if p["efficiency"] is not None else None,
                ]
                for p in points
            ],
            caption="Force is drag at terminal speed. Strouhal number with the fin's length as lever "
            "of the wake "
            "width (the source's Eq 28) and with the distance from the axle to the trailing edge.",
        ),
    ]
    if offsets:
        tables.append(
            ev.Table(
                id="offsets",
                title="Amplitude offsets by fin and frequency",
                columns=["fin", "f (Hz)", "offset"],
                rows=offsets,
            )
        )
    if departures:
        names = [n for n in result.labels if "[" not in n]
        tables.append(
            ev.Table(
                id="departures",
                title="With and without the frequencies that depart from the law",
                columns=["parameter", "without", "with"],
                rows=[
                    [
                        n,
                        numbers.measured(result.value(n), result.stderr(n)),
                        numbers.measured(everything.value(n), everything.stderr(n)),
                    ]
                    for n in names
                ],
            )
        )
    return tables


def _cruise_figures(
    experiment: Experiment, result: FitResult, points: list[dict[str, Any]]
) -> list[ev.Figure]:
    amplitude = _most_common([p["amplitude_deg"] for p in points])
    frequencies = [
        f
        for f in sorted({p["frequency_hz"] for p in points})
        if len({p["amplitude_deg"] for p in points if p["frequency_hz"] == f}) > 2
    ]
    by_frequency, by_amplitude, force, wake = [], [], [], []
    for group, trial in enumerate(experiment.trials):
        at = sorted(
            (p for p in points if p["fin"] == trial.id and abs(p["amplitude_deg"] - amplitude) < 1e-6),
            key=lambda p: p["frequency_hz"],
        )
        if at:
            f = np.linspace(0.0, max(p["frequency_hz"] for p in at), 60)[1:]
            by_frequency += [
                ev.Trace(
                    x=[p["frequency_hz"] for p in at],
                    y=[100 * p["mean_speed_m_s"] for p in at],
                    style="points",
                    label=trial.id,
                    group=group,
                ),
                ev.Trace(x=f, y=100 * _law(result, trial, f, np.full(len(f), amplitude)), group=group),
            ]
            force.append(
                ev.Trace(
                    x=[p["frequency_hz"] for p in at],
                    y=[1e3 * p["propulsive_force_N"] for p in at],
                    style="points",
                    label=trial.id,
                    group=group,
                )
            )
            wake.append(
                ev.Trace(
                    x=[p["frequency_hz"] for p in at],
                    y=[p["strouhal"] for p in at],
                    style="points",
                    label=trial.id,
                    group=group,
                )
            )
        for f0 in frequencies[:1]:
            swept = sorted(
                (p for p in points if p["fin"] == trial.id and p["frequency_hz"] == f0),
                key=lambda p: p["amplitude_deg"],
            )
            if swept:
                a = np.linspace(0.0, max(p["amplitude_deg"] for p in swept), 80)[1:]
                by_amplitude += [
                    ev.Trace(
                        x=[p["amplitude_deg"] for p in swept],
                        y=[(100 * p["mean_speed_m_s"]) ** 1.5 for p in swept],
                        style="points",
                        label=trial.id,
                        group=group,
                    ),
                    ev.Trace(x=a, y=(100 * _law(result, trial, np.full(len(a), f0), a)) ** 1.5, group=group),
                ]
    panels = [
        ev.Panel(
            x_label="frequency (Hz)",
            y_label="average speed (cm/s)",
            traces=by_frequency,
            title=f"at {amplitude:g}°",
        )
    ]
    if by_amplitude:
        panels.append(
            ev.Panel(
                x_label="amplitude (deg)",
                y_label="average speed^1.5 (cm/s)^1.5",
                traces=by_amplitude,
                title=f"at {frequencies[0]:g} Hz",
            )
        )
    return [
        ev.Figure(
            id="speeds",
            title="Average speed against frequency and amplitude",
            columns=2,
            panels=panels,
            caption="Points are runs, lines the fitted law: straight through the origin against "
            "frequency, straight "
            "with the offset as intercept against amplitude. Runs below their line at high frequency "
            "point to a flexing fin.",
        ),
        ev.Figure(
            id="force",
            title="Propulsive force and Strouhal number",
            columns=2,
            panels=[
                ev.Panel(
                    x_label="frequency (Hz)",
                    y_label="propulsive force (mN)",
                    traces=force,
                    title=f"at {amplitude:g}°",
                ),
                ev.Panel(
                    x_label="frequency (Hz)",
                    y_label="Strouhal number",
                    traces=wake,
                    title=f"at {amplitude:g}°",
                    marks=[ev.Mark(at=0.25), ev.Mark(at=0.4, label="efficient swimmers")],
                ),
            ],
            caption="Force grows with the square of frequency under the law; the Strouhal number "
            "then stays constant.",
        ),
        *fit_common.figures(result)[1:],
    ]


def _law(result: FitResult, trial: Trial, frequency: Array, amplitude_deg: Array) -> Array:
    runs = replace(
        trial,
        time_s=np.arange(len(frequency), dtype=float),
        inputs={
            "frequency_hz": frequency,
            "amplitude_rad": np.deg2rad(amplitude_deg),
            "distance_m": np.full(len(frequency), float(np.median(trial.inputs["distance_m"]))),
        },
    )
    return result.model.simulate(result.values(trial.id), runs)[SPEED]


def _most_common(values: list[float]) -> float:
    rounded = np.round(values, 6)
    levels, counts = np.unique(rounded, return_counts=True)
    return float(levels[np.argmax(counts)])


# ------------------------------------------------------------ straight free swimming


def _surge(
    experiment: Experiment, choices: tuple[Parameter, ...], origin: dict[str, Any], progress: Progress
) -> tuple[ParameterFile, ev.Evidence]:
    model = experiment.model
    result = output_error.fit(model, experiment.trials, parameters=choices, progress=progress)
    shared = [label for label in result.labels if "[" not in label]
    if all(result.status[label] == "unidentifiable" for label in shared):
        raise NoTrustworthyResult("neither thrust nor drag can be identified from these trials")
    derived = _free_amplitude(experiment, choices)
    n = result.value("amplitude_exponent")
    stderr = result.stderr("thrust_acceleration")
    reference = model.reference_amplitude_rad  # type: ignore[attr-defined]
    at_one = result.value("thrust_acceleration") / reference**n
    relative = (stderr or 0.0) / result.value("thrust_acceleration")
    spread = math.hypot(relative, (result.stderr("amplitude_exponent") or 0.0) * abs(math.log(reference)))
    derived["thrust_coefficient"] = Estimate(
        value=at_one,
        stderr=at_one * spread,
        unit="m/s^2",
        status="estimated" if spread < 0.5 else "unidentifiable",
    )
    found = [b for b in experiment.facts["beats"].values() if b["found_hz"] is not None]
    if found:
        values = [float(b["found_hz"]) for b in found]
        derived["beat_frequency"] = Estimate(
            value=float(np.median(values)),
            stderr=max(
                float(np.std(values) / math.sqrt(len(values))), min(float(b["stderr_hz"]) for b in found)
            ),
            unit="Hz",
            status="estimated",
        )
    file = fit_common.parameter_file(
        result,
        robot=experiment.robot.name,
        provenance=origin,
        derived=derived,
        settings={
            "reference_amplitude_rad": reference,
            "reference_frequency_hz": model.reference_frequency_hz,  # type: ignore[attr-defined]
            "beats": experiment.facts["beats"],
        },
    )
    checks = [*fit_common.checks(result, file), _beat_check(experiment)]
    rows = [
        [
            name,
            b["stated_hz"],
            "none found" if b["found_hz"] is None else numbers.measured(b["found_hz"], b["stderr_hz"], "Hz"),
        ]
        for name, b in experiment.facts["beats"].items()
    ]
    evidence = ev.Evidence(
        verb="fit-propulsion",
        title=f"Propulsion of {experiment.robot.name}: beat-averaged surge",
        verdict=fit_common.verdict(checks, _answer(file)),
        checks=checks,
        tables=[
            ev.Table(
                id="beats",
                title="Beat frequency",
                columns=["trial", "stated (Hz)", "found in yaw"],
                rows=rows,
            )
        ],
        figures=fit_common.figures(result),
        methods=[
            "Surge was averaged over whole tail beats, their frequency found in the yaw, and "
            f"du/dt = a (A/A_ref)^n - c u² fitted to {len(result.trials)} straight trials by "
            "output-error maximum "
            "likelihood with each trial's initial speed estimated.",
        ],
        references=list(experiment.robot.sources),
        provenance=origin,
    )
    return file, evidence


def _free_amplitude(experiment: Experiment, choices: tuple[Parameter, ...]) -> dict[str, Estimate]:
    """The amplitude exponent of thrust set free, where several amplitudes were driven."""
    amplitudes = {round(t.settings["amplitude_rad"], 6) for t in experiment.trials if t.role == "fit"}
    if len(amplitudes) < 2:
        return {}
    name = "amplitude_exponent"
    free = tuple(replace(p, free=True) if p.name == name else p for p in choices)
    result = output_error.fit(experiment.model, experiment.trials, parameters=free)
    value, stderr = result.value(name), result.stderr(name)
    if stderr and abs(value - 2.0) > 3 * stderr:
        warn(
            "SWM031",
            f"set free, the amplitude exponent of thrust is {numbers.measured(value, stderr)}, fitted with 2",
        )
    return {
        f"free_{name}": Estimate(
            value=value, stderr=stderr, unit="1", bounds=(0, 6), status=result.status[name]
        )  # type: ignore[arg-type]
    }


def _beat_check(experiment: Experiment) -> ev.Check:
    beats = experiment.facts["beats"]
    wrong = [
        name
        for name, b in beats.items()
        if b["found_hz"] is not None
        and abs(b["found_hz"] - b["stated_hz"])
        > max(experiment_module.BEAT_TOLERANCE * b["stated_hz"], 3 * b["stderr_hz"])
    ]
    return ev.Check(
        name="beat frequency as stated",
        value="yes" if not wrong else f"not in {len(wrong)} of {len(beats)} trials",
        limit=f"within {100 * experiment_module.BEAT_TOLERANCE:g} %",
        verdict="warn" if wrong else "pass",
        text="found in the yaw of each log",
    )
