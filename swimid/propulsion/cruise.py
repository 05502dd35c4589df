"""The recoil law from a cruise table: fit, departures, operating points."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from swimid.errors import NoTrustworthyResult
from swimid.fitting import fit_common, output_error
from swimid.fitting.experiment import Experiment
from swimid.fitting.model import Parameter, Trial, chosen
from swimid.fitting.output_error import FitResult
from swimid.notices import warn
from swimid.progress import Progress
from swimid.propulsion import cruise_evidence as propulsion_cruise_evidence
from swimid.propulsion import trials as experiment_module
from swimid.propulsion.cruise_evidence import DEPARTURE_SHARE, DEPARTURE_Z, LAWS
from swimid.propulsion.model import SPEED, RecoilModel, strouhal, velocity_ratio
from swimid.results import blocks, numbers
from swimid.results import evidence as ev
from swimid.results.parameters import Estimate, ParameterFile

#: What the law takes from a drag file.
DRAG_NUMBERS = ("drag_coefficient", "added_mass")


def fit(
    experiment: Experiment,
    choices: tuple[Parameter, ...],
    origin: dict[str, Any],
    wake: str,
    keep_departures: bool,
    progress: Progress,
) -> tuple[ParameterFile, ev.Evidence]:
    """Fit the law, leave out what departs from it, carry the drag file's errors along.

    Parameters
    ----------
    choices : tuple of Parameter
        The model's with the user's choices applied.
    origin : dict
        The provenance block.

    Raises
    ------
    NoTrustworthyResult
        When neither parameter can be identified.
    """
    model = experiment.model
    assert isinstance(model, RecoilModel)
    if all(t.cruise.inertia_kg_m2 is None for t in experiment.trials):
        warn(
            "SWM019",
            "no fin's hydrodynamic inertia is known: only its product with the efficiency is determined; the "
            "efficiency is held at its starting value",
        )
    everything = output_error.fit(model, experiment.trials, parameters=choices, progress=progress)
    fit_common.refuse_interrupted(everything)
    departures = [] if keep_departures else _departures(model, experiment.trials, choices)
    kept = [_without(t, [d["frequency_hz"] for d in departures]) for t in experiment.trials]
    result = (
        output_error.fit(model, kept, parameters=choices, progress=progress) if departures else everything
    )
    if all(result.status[label] != "estimated" for label in result.labels):
        raise NoTrustworthyResult("neither efficiency nor offset can be identified from this table")
    exponents = _exponents(model, kept, choices)
    result = _with_drag_error(result, kept, choices, experiment)
    points = _operating_points(experiment, result, wake)
    derived = _derived(experiment, result, model, points)
    file = fit_common.parameter_file(
        result,
        robot=experiment.robot.name,
        provenance=origin,
        derived=derived | exponents,
        settings={"wake": wake, "drag_file": str(experiment.facts["drag_path"])},
    )
    file._drag = experiment.facts["drag"]
    assert file.fit is not None
    assert file.fit.model_extra is not None
    file.fit.model_extra["departures"] = departures
    file.fit.model_extra["operating_points"] = points
    offsets = _offsets(experiment)
    checks = fit_common.checks(result, file) + propulsion_cruise_evidence.law_checks(departures, exponents)
    evidence = ev.Evidence(
        verb="fit-propulsion",
        title=f"Propulsion of {experiment.robot.name}: energy recoil law",
        verdict=ev.judged(fit_common.answer(file), checks),
        checks=checks,
        tables=propulsion_cruise_evidence.tables(experiment, points, offsets, departures, everything, result),
        figures=propulsion_cruise_evidence.figures(experiment, result, points),
        methods=[
            "Recoil efficiency and amplitude offset were estimated from the average speeds of "
            f"{result.samples} runs over {len(experiment.trials)} fins by weighted least squares under the "
            "energy recoil law (Eqs 5, 25 to 27), with drag coefficient and added mass from the "
            "falling-weight rig and their uncertainty carried along.",
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
    departures: list[dict[str, Any]] = []
    while len(levels) - len(departures) > 3 and len(departures) < len(levels) // 3:
        out = [d["frequency_hz"] for d in departures]
        tests = []
        for level in (f for f in levels if f not in out):
            rest = [_without(t, [*out, float(level)]) for t in trials]
            try:
                fitted = output_error.fit(model, rest, parameters=choices)
            except NoTrustworthyResult:
                continue
            test = _departure(fitted, trials, float(level))
            if test is not None:
                tests.append(test)
        tests = [t for t in tests if abs(t["z"]) > DEPARTURE_Z and abs(t["share"]) > DEPARTURE_SHARE]
        if not tests:
            break
        worst = max(tests, key=lambda t: abs(t["z"]))
        departures.append(worst)
        warn(
            "SWM030",
            f"the runs at {worst['frequency_hz']:g} Hz are {abs(100 * worst['share']):.1f} % "
            f"{'slower' if worst['share'] < 0 else 'faster'} than the law fitted to the other frequencies "
            f"({abs(worst['z']):.1f} standard errors, {worst['runs']} runs); they are left out of the fit. "
            "Fins that flex at high frequency do this (source, section 4.2)",
        )
    return departures


def _departure(fitted: FitResult, trials: list[Trial], level: float) -> dict[str, Any] | None:
    """How far the runs at a frequency lie off the law; None where the law gives them no speed."""
    shares, spread = [], []
    size = float(np.sqrt(np.mean([np.nanmean(s.weighted**2) for s in fitted.series])))
    reference = fitted.noise[SPEED].value_sd
    for trial in trials:
        predicted = fitted.model.simulate(fitted.values(trial.id), trial)[SPEED]
        at = np.isclose(trial.inputs["frequency_hz"], level) & np.isfinite(trial.measured[SPEED])
        at &= predicted > 0
        shares += list(trial.measured[SPEED][at] / predicted[at] - 1)
        known = np.asarray(trial.value_sd[SPEED])
        spread += list(size * known[at] * reference / float(np.sqrt(np.mean(known**2))) / predicted[at])
    if not shares:
        return None
    share = float(np.mean(shares))
    error = float(np.sqrt(np.mean(np.square(spread)) / len(shares)))
    # the law's own uncertainty at a level is of the order of one run's among all others
    error = math.hypot(error, float(np.sqrt(np.mean(np.square(spread)) / max(fitted.samples, 1))) * 2)
    return {"frequency_hz": level, "share": share, "stderr": error, "z": share / error, "runs": len(shares)}


def _exponents(
    model: RecoilModel, trials: list[Trial], choices: tuple[Parameter, ...]
) -> dict[str, Estimate]:
    """Each exponent of the law set free in turn; the offset stays free with it."""
    exponents = {}
    for name, law in LAWS.items():
        try:
            result = output_error.fit(model, trials, parameters=chosen(choices, freed=(name,)))
        except NoTrustworthyResult:
            continue
        value, stderr = result.value(name), result.stderr(name)
        # with the offset held at a bound the exponent answers another question
        held = result.status.get("amplitude_offset_deg", "estimated") != "estimated"
        status = "unidentifiable" if held else result.status[name]
        exponents[f"free_{name}"] = Estimate(
            value=value, stderr=stderr, unit="1", bounds=(0, 6), status=status
        )  # type: ignore[arg-type]
        if status == "estimated" and stderr and abs(value - law) > 3 * stderr:
            warn(
                "SWM031",
                f"set free, the {name.replace('_', ' ')} of power is "
                f"{numbers.measured(value, stderr)}, the law says {law:g}",
            )
    return exponents


def _by_drag_error(experiment: Experiment) -> dict[str, RecoilModel]:
    """The model with each number of the drag file larger by its standard error, where it has one."""
    drag, path = experiment.facts["drag"], experiment.facts["drag_path"]
    fins = {t.id: t.cruise.inertia_kg_m2 for t in experiment.trials}
    models = {}
    for name in DRAG_NUMBERS:
        if drag.parameters[name].stderr:
            moved = drag.model_copy(deep=True)
            moved.parameters[name].value += drag.parameters[name].stderr
            area, mass = experiment_module.drag_numbers(moved, path, experiment.robot)
            models[name] = RecoilModel(drag_area_kg_m=area, moving_mass_kg=mass, fins=fins)
    return models


def _with_drag_error(
    result: FitResult, trials: list[Trial], choices: tuple[Parameter, ...], experiment: Experiment
) -> FitResult:
    """Add what the drag file's uncertainty contributes to the covariance."""
    drag: ParameterFile = experiment.facts["drag"]
    shifts = np.zeros((2, len(result.labels)))
    for name, other in _by_drag_error(experiment).items():
        moved = output_error.fit(other, trials, parameters=choices)
        shifts[DRAG_NUMBERS.index(name)] = moved.estimate - result.estimate
    rho = 0.0
    if drag.correlation and all(n in drag.correlation.names for n in DRAG_NUMBERS):
        i, j = (drag.correlation.names.index(n) for n in DRAG_NUMBERS)
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
        fin, inertia = experiment.robot.fins[trial.id], trial.cruise.inertia_kg_m2
        levers = {"fin": fin.length_m, "axle": fin.length_m + fin.axle_gap_m}
        for k in np.flatnonzero(np.isfinite(trial.measured[SPEED])):
            speed, distance = float(trial.measured[SPEED][k]), trial.inputs["distance_m"][k]
            f, a = float(trial.inputs["frequency_hz"][k]), float(trial.inputs["amplitude_rad"][k])
            terminal = float(speed / velocity_ratio(model.b1, 0.0, distance))
            efficiency = None
            if inertia is not None and a > offset:
                efficiency = float(
                    model.drag_area_kg_m * terminal**3 / (8 * np.pi**2 * inertia * (a - offset) ** 2 * f**3)
                )
            ratios = {name: strouhal(f, a, lever, terminal) for name, lever in levers.items()}
            points.append(
                {
                    "fin": trial.id,
                    "frequency_hz": f,
                    "amplitude_deg": float(np.rad2deg(a)),
                    "mean_speed_m_s": speed,
                    "terminal_speed_m_s": terminal,
                    "propulsive_force_N": float(model.drag_area_kg_m * terminal**2),
                    "strouhal": ratios[wake],
                    "strouhal_fin": ratios["fin"],
                    "strouhal_axle": ratios["axle"],
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
    ratios = [float(velocity_ratio(other.b1, 0.0, distance)) for other in _by_drag_error(experiment).values()]
    variance = sum((ratio - centre) ** 2 for ratio in ratios)
    quantities = {
        "velocity_ratio": Estimate(value=centre, stderr=math.sqrt(variance), unit="1", status="estimated")
    }
    coefficient = drag.parameters["drag_coefficient"]
    relative_drag = (coefficient.stderr or 0.0) / coefficient.value
    scatter = 2 * result.noise[SPEED].value_sd / float(np.median([p["mean_speed_m_s"] for p in points]))
    for end, pick in (("smallest", min), ("largest", max)):
        force = pick(p["propulsive_force_N"] for p in points)
        quantities[f"{end}_propulsive_force"] = Estimate(
            value=force, stderr=force * math.hypot(relative_drag, scatter), unit="N", status="estimated"
        )
    return quantities


def _offsets(experiment: Experiment) -> list[dict[str, blocks.Cell]]:
    """Amplitude offset of each fin and frequency: where the line of v^1.5 meets zero (Figs 9, 10)."""
    rows: list[dict[str, blocks.Cell]] = []
    for trial in experiment.trials:
        for f in np.unique(trial.inputs["frequency_hz"]):
            at = np.isclose(trial.inputs["frequency_hz"], f) & np.isfinite(trial.measured[SPEED])
            x, y = np.rad2deg(trial.inputs["amplitude_rad"][at]), trial.measured[SPEED][at] ** 1.5
            if len(np.unique(x)) < 3:
                continue
            (slope, level), covariance = np.polyfit(x, y, 1, cov="unscaled")
            residual = y - slope * x - level
            covariance = covariance * float(residual @ residual) / max(len(x) - 2, 1)
            gradient = np.array([level / slope**2, -1 / slope])
            error = math.sqrt(float(gradient @ covariance @ gradient))
            offset = numbers.measured(float(-level / slope), error, "deg")
            rows.append({"fin": trial.id, "f (Hz)": float(f), "offset": offset})
    return rows
