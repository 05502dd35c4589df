"""Command ``fit-propulsion``: fit of the energy recoil law, or of thrust and drag in straight swimming."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from swimid.errors import NoTrustworthyResult, UsageError
from swimid.files import provenance
from swimid.fitting import fit_common, output_error
from swimid.fitting.fit_common import Experiment
from swimid.fitting.model import Array, Model, Parameter, Trial, choose_parameters
from swimid.fitting.output_error import FitResult
from swimid.fitting.uncertainty import UNIDENTIFIABLE
from swimid.logs.trials import TrialSet
from swimid.notices import Progress, record_warnings, silent, warn
from swimid.options import takes
from swimid.propulsion import trials as propulsion_trials
from swimid.propulsion.model import SPEED, RecoilModel, SurgeModel, strouhal, velocity_ratio
from swimid.propulsion.options import FitPropulsionOptions
from swimid.results import evidence as ev
from swimid.results import numbers
from swimid.results.parameters import Estimate, Fitted, ParameterFile

#: Limits for a beat frequency whose runs depart from the recoil law. A frequency is left out of the fit if
#: the relative deviation of the mean speed exceeds DEPARTURE_RTOL, and the deviation in standard errors
#: exceeds DEPARTURE_Z. At least MIN_LEVELS frequencies stay in the fit, and at most a third of the
#: frequencies is left out.
DEPARTURE_RTOL, DEPARTURE_Z, MIN_LEVELS = 0.01, 4.0, 3
#: Exponents of beat frequency and amplitude in the propulsive power according to the recoil law.
LAWS = {"frequency_exponent": 3.0, "amplitude_exponent": 2.0}
#: Maximum deviation, in standard errors, at which an estimated exponent agrees with the exponent of the
#: recoil law or of the thrust law.
EXPONENT_Z = 3.0
#: Parameters of the drag file that the recoil law uses.
DRAG_PARAMETERS = ("drag_coefficient", "added_mass")
#: Columns of the report table of cruise runs. Each title has the key of its quantity in an operating point,
#: and the factor that converts the quantity to the unit in the title.
COLUMNS = {
    "f (Hz)": ("frequency_hz", 1.0),
    "amplitude (°)": ("amplitude_deg", 1.0),
    "average speed (cm/s)": ("mean_speed_m_s", 100.0),
    "terminal speed (cm/s)": ("terminal_speed_m_s", 100.0),
    "force (mN)": ("propulsive_force_N", 1e3),
    "Strouhal, fin": ("strouhal_fin", 1.0),
    "Strouhal, axle": ("strouhal_axle", 1.0),
    "efficiency (%)": ("efficiency", 100.0),
}
#: Type of the result of a propulsion fit: parameter file, checks, and further fields of the evidence file
#: (title, tables, figures, methods) by name.
Made = tuple[ParameterFile, list[ev.Check], dict[str, Any]]
#: Exponent of the beat amplitude in the power law of thrust in straight swimming.
AMPLITUDE_EXPONENT = 2.0

#: Sentence on average and terminal speeds for the methods section of a report.
CONVERSION = "Average speeds were converted to terminal speeds by the velocity ratio of Eq 25."


@takes(FitPropulsionOptions)
def fit_propulsion(
    trials: str | Path | TrialSet,
    *,
    options: FitPropulsionOptions,
    output: Path | None = None,
    progress: Progress = silent,
) -> Fitted:
    """Identify the propulsion of a caudal fin from cruise speeds or from straight free swimming.

    Cruise speeds give the efficiency and amplitude offset of the energy recoil law, which is valid for a
    rigid fin. Straight free swimming gives thrust and drag. Frequencies whose runs depart from the recoil law
    (SWM030) are left out of the fit, and the result is not valid at these frequencies. The initial speed of a
    held-out trial is estimated from the trial itself, with all other parameters held.

    Parameters
    ----------
    trials : path or TrialSet
        Trials file, or the result of :func:`swimid.load`. It describes a cruise experiment (recoil law,
        boxfish paper Eqs 3-6, 25-27) or straight free-swim trials. Free-swim trials are fitted with the surge
        averaged over tail beats, a thrust by a power of the amplitude, and quadratic drag.
    output : path, optional
        Parameter file to write, together with its evidence file.
    progress : Progress
        Progress bar of the search.

    Returns
    -------
    Fitted
        For a cruise ``.parameters`` has ``recoil_efficiency`` (1), ``amplitude_offset_deg`` (deg), and
        ``inertia_<fin>`` (kg m^2) for each fin of unknown inertia. ``.quantities`` has ``velocity_ratio``
        (1), the minimum and the maximum propulsive force (N), and the free exponents (1). The standard errors
        include those of the drag file. ``.tables()`` has speeds, forces and Strouhal numbers of each run,
        with both levers of the wake width. For straight runs ``.parameters`` has ``thrust_acceleration``
        (m/s^2), ``surge_drag`` (1/m, drag per mass), and the exponents of amplitude and frequency (1).

    Raises
    ------
    InputError, UsageError
        If a file or an option is wrong.
    NoTrustworthyResult
        If no parameter can be identified.

    References
    ----------
    .. [1] W. L. Chan, G. Lee, B. Kim, J. M. Choi, T. Kang, "Experimental Parameter Identification and
       Performance Analysis of a Fish Robot with Ostraciiform Swimming Mode using Rigid Caudal Fins".
       Eqs 3 to 6 and 25 to 27: the recoil law; Eq 28: the Strouhal number; Tables 3 and 4: amplitude offset
       and efficiency.

    Examples
    --------
    >>> import swimid
    >>> drag = swimid.fit_drag("sample_logs/rig/trials.yaml")
    >>> fin = fit_propulsion("sample_logs/cruise/trials.yaml", drag=drag)
    >>> round(fin["recoil_efficiency"].value, 2), round(fin["amplitude_offset_deg"].value, 1)
    (0.34, 5.4)
    >>> fin.verdict, list(fin.warnings["code"])
    ('caution', ['SWM030'])
    """
    with record_warnings(repeat=True) as notices:
        experiment = fit_common.load_experiment(trials, command="fit-propulsion", drag=options.drag)
        choices = fit_common.prepare_fit(experiment, output, fixed=options.fixed, freed=options.freed)
        origin = provenance.collect(experiment.inputs, settings=options.settings())
        fit = _fit_recoil_law
        if experiment.name != "cruise":
            fit = _fit_surge
            if options.drag is not None:
                raise UsageError("--drag is valid only for a cruise experiment: omit it for free-swim trials")
            if options.keep_departures:
                warn("SWM004", "--keep-departures has no effect: it is used only in a cruise experiment")
        file, checks, shown = fit(experiment, choices, options, progress)
        file.provenance = origin
    shown["references"] = list(experiment.robot.sources)
    return fit_common.finish("fit-propulsion", file, checks, notices, output, **shown)


# ---------------------------------------------------------------- beat-averaged surge


def _fit_surge(
    experiment: Experiment, choices: tuple[Parameter, ...], options: FitPropulsionOptions, progress: Progress
) -> Made:
    """Fit thrust and drag of straight swimming to the surge averaged over tail beats.

    The initial speed of each trial is estimated, unless the user holds it.

    Parameters
    ----------
    choices : tuple of Parameter
        Parameters of the model with the choices of the user.

    Raises
    ------
    NoTrustworthyResult
        If neither thrust nor drag can be identified.
    """
    model = experiment.model
    assert isinstance(model, SurgeModel)
    result = output_error.fit_output_error(model, experiment.trials, parameters=choices, progress=progress)
    fit_common.refuse_interrupted(result)
    result = output_error.complete_fit(result)
    if all(result.status[label] != "estimated" for label in result.common_labels):
        raise NoTrustworthyResult("neither thrust nor drag can be identified from these trials")
    amplitudes = {round(t.surge.amplitude_rad, 6) for t in experiment.trials if t.role == "fit"}
    laws = {"amplitude_exponent": AMPLITUDE_EXPONENT}
    if len(amplitudes) < 2:
        laws = {}
    derived, exponent_checks = _free_exponents(model, experiment.trials, choices, laws, "thrust")
    derived |= _derive_surge(model, result, experiment.facts["beats"])
    settings = {
        "reference_amplitude_rad": model.reference_amplitude_rad,
        "reference_frequency_hz": model.reference_frequency_hz,
        **experiment.facts,
    }
    robot = experiment.robot.name
    file = fit_common.parameter_file(result, robot=robot, provenance={}, derived=derived, settings=settings)
    checks = [*fit_common.checks(result), fit_common.beat_check(experiment.facts["beats"]), *exponent_checks]
    state = "estimated"
    if not any(label.startswith("initial_speed[") for label in result.labels):
        state = "held"
    methods = [
        "Surge was averaged over whole tail beats, their frequency found in the yaw, and du/dt = a "
        f"(A/A_ref)^n - c u² fitted to {len(result.trials)} straight trials by output-error maximum "
        f"likelihood, with the initial speed of each trial {state}.",
    ]
    title, figures = f"Propulsion of {robot}: beat-averaged surge", fit_common.figures(result)
    return file, checks, {"title": title, "figures": figures, "methods": methods}


def _derive_surge(
    model: SurgeModel, result: FitResult, beats: Mapping[str, Mapping[str, Any]]
) -> dict[str, Estimate]:
    """Return the thrust coefficient at an amplitude of 1 rad, and the frequency of the beats."""
    reference = model.reference_amplitude_rad
    thrust, exponent = result.value("thrust_acceleration"), result.value("amplitude_exponent")
    at_one = thrust / reference**exponent
    spread = math.hypot(
        (result.stderr("thrust_acceleration") or 0.0) / thrust,
        (result.stderr("amplitude_exponent") or 0.0) * abs(math.log(reference)),
    )
    derived = {"thrust_coefficient": _make_estimate(at_one, at_one * spread, "m/s^2")}
    if spread >= UNIDENTIFIABLE:
        derived["thrust_coefficient"].status = "unidentifiable"
    measured = [b for b in beats.values() if b["found_hz"] is not None]
    if measured:
        values = [float(b["found_hz"]) for b in measured]
        scatter = float(np.std(values) / math.sqrt(len(values)))
        error = max(scatter, min(float(b["stderr_hz"]) for b in measured))
        derived["beat_frequency"] = _make_estimate(float(np.median(values)), error, "Hz")
    return derived


def _make_estimate(value: float, stderr: float, unit: str) -> Estimate:
    """Return an estimate with the status ``estimated`` for a derived quantity."""
    return Estimate(value=value, stderr=stderr, unit=unit, status="estimated")


# ---------------------------------------------------------------- recoil law


def _fit_recoil_law(
    experiment: Experiment, choices: tuple[Parameter, ...], options: FitPropulsionOptions, progress: Progress
) -> Made:
    """Fit the energy recoil law to cruise runs, without the beat frequencies whose runs depart from the law.

    The standard errors include the uncertainty of the drag parameters.

    Parameters
    ----------
    choices : tuple of Parameter
        Parameters of the model with the choices of the user.

    Raises
    ------
    NoTrustworthyResult
        If neither the recoil efficiency nor the amplitude offset can be identified.
    """
    model = experiment.model
    assert isinstance(model, RecoilModel)
    if all(inertia is None for inertia in model.fins.values()):
        warn(
            "SWM019",
            "the robot file states no hydrodynamic inertia of a fin. The trials determine only the product "
            "of inertia and efficiency, so the efficiency is held at the start value",
        )
    everything = output_error.fit_output_error(
        model, experiment.trials, parameters=choices, progress=progress
    )
    fit_common.refuse_interrupted(everything)
    departures: list[dict[str, Any]] = []
    if not options.keep_departures:
        departures = _find_departures(model, experiment.trials, choices)
    kept, result, left_out = experiment.trials, everything, [d["frequency_hz"] for d in departures]
    if departures:
        kept = _blank_frequencies(experiment.trials, left_out)
        result = output_error.fit_output_error(model, kept, parameters=choices, progress=progress)
    if all(result.status[label] != "estimated" for label in result.labels):
        raise NoTrustworthyResult("neither efficiency nor offset can be identified from this table")
    exponents, exponent_checks = _free_exponents(model, kept, choices, LAWS, "power")
    result = output_error.with_intervals(result)
    result = _with_drag_error(result, kept, choices, experiment)
    points = _operating_points(experiment, result)
    file = fit_common.parameter_file(
        result,
        robot=experiment.robot.name,
        provenance={},
        derived=_derive(experiment, result, points) | exponents,
        settings={"drag_file": str(experiment.facts["drag_path"])},
    )
    file._drag = experiment.facts["drag"]
    assert file.fit is not None
    assert file.fit.model_extra is not None
    file.fit.model_extra.update(departures=departures, operating_points=points)
    departed = _departure_check(departures, everything)
    said = (
        "Recoil efficiency and amplitude offset were estimated from the average speeds of "
        f"{result.samples} runs over {len(experiment.trials)} fins by weighted least squares under the "
        "energy recoil law (Eqs 5, 25 to 27), with drag coefficient and added mass from the "
        "falling-weight rig and their uncertainty carried along."
    )
    shown = {
        "title": f"Propulsion of {experiment.robot.name}: energy recoil law",
        "tables": [_run_table(points)],
        "figures": [_speed_figure(experiment, result, points, left_out), _residual_figure(result)],
        "methods": [said, CONVERSION],
    }
    checks = [*fit_common.checks(result, held_out=False), _predict_fins(model, result, kept, choices)]
    return file, [*checks, departed, *exponent_checks], shown


def _predict_fins(
    model: RecoilModel, result: FitResult, trials: Sequence[Trial], choices: tuple[Parameter, ...]
) -> ev.Check:
    """Return a check of the speeds of each fin, predicted by a fit to the other fins.

    Only a fin with a known inertia can be predicted. The check does not pass with fewer than two such fins.
    """
    errors, known = [], [trial for trial in trials if model.fins[trial.id] is not None]
    if len(known) > 1:
        for left_out in known:
            roles = [replace(t, role="validate" if t is left_out else "fit") for t in trials]
            without = output_error.fit_output_error(model, roles, parameters=choices)
            errors += [s.residual / s.measured for s in without.series_of(SPEED, "validate")]
    fitted = [s.residual / s.measured for s in result.series_of(SPEED, "fit")]
    error, usual = (100 * ev.compute_rms(*parts) if parts else math.nan for parts in (errors, fitted))
    limit = fit_common.VALIDATION_RATIO * usual
    reason = f"the error on fins that were not fitted is {error:.2g} %, above {limit:.2g} %"
    if not errors:
        reason = "no fin can be held out: two fins with known inertia are needed"
    text = "root-mean-square error of the speeds of each fin, predicted by a fit to the others"
    shown = ("fins held out in turn", f"{error:.2g} %", error <= limit, f"≤ {limit:.2g} %", text)
    return ev.make_check(*shown, reason=reason)


# ------------------------------------------------------------ checks of the law


def _blank_frequencies(trials: Sequence[Trial], frequencies: Sequence[float]) -> list[Trial]:
    """Return copies of cruise trials in which the speeds at the given beat frequencies are set to NaN."""
    kept = []
    for trial in trials:
        out = np.isclose(trial.inputs["frequency_hz"][:, None], frequencies).any(axis=1)
        kept.append(replace(trial, measured={SPEED: np.where(out, np.nan, trial.measured[SPEED])}))
    return kept


def _find_departures(
    model: RecoilModel, trials: list[Trial], choices: tuple[Parameter, ...]
) -> list[dict[str, Any]]:
    """Find the beat frequencies whose runs depart from the recoil law.

    Return a dictionary for each such frequency, in the order of detection. To test a frequency, the law is
    fitted without this frequency and without the frequencies that were found before.
    """
    levels = np.unique(np.concatenate([t.inputs["frequency_hz"] for t in trials])).tolist()
    departures: list[dict[str, Any]] = []
    while len(levels) - len(departures) > MIN_LEVELS and len(departures) < len(levels) // 3:
        out, tests = [d["frequency_hz"] for d in departures], []
        for level in [one for one in levels if one not in out]:
            with suppress(NoTrustworthyResult):
                fitted = output_error.fit_output_error(
                    model, _blank_frequencies(trials, [*out, level]), parameters=choices
                )
                test = _departure(fitted, trials, level)
                if test is not None and abs(test["z"]) > DEPARTURE_Z and abs(test["share"]) > DEPARTURE_RTOL:
                    tests.append(test)
        if not tests:
            break
        departures.append(max(tests, key=lambda t: abs(t["z"])))
    return departures


def _departure(fitted: FitResult, trials: list[Trial], level: float) -> dict[str, Any] | None:
    """Compare the speeds at one beat frequency with the fitted recoil law.

    Return the mean relative deviation from the law, its standard error and their ratio z. Return None if no
    speed was measured at this frequency.
    """
    shares, spread = [], []
    size = float(np.sqrt(np.mean([np.nanmean(s.z_scores**2) for s in fitted.series])))
    reference = fitted.noise[SPEED].value_sd
    for trial in trials:
        predicted = fitted.model.run(fitted.values(trial.id), trial)[SPEED]
        at = np.isclose(trial.inputs["frequency_hz"], level) & np.isfinite(trial.measured[SPEED])
        at &= predicted > 0
        shares += list(trial.measured[SPEED][at] / predicted[at] - 1)
        known = np.asarray(trial.value_sd[SPEED])
        spread += list(size * known[at] * reference / float(np.sqrt(np.mean(known**2))) / predicted[at])
    if not shares:
        return None
    share, variance = float(np.mean(shares)), float(np.mean(np.square(spread)))
    # Combine the standard errors of the mean speed at this frequency and of the fitted law. The standard
    # error of the law is about twice that of the mean of all runs.
    error = math.sqrt(variance * (1 / len(shares) + 4 / max(fitted.samples, 1)))
    return {"frequency_hz": level, "share": share, "stderr": error, "z": share / error, "runs": len(shares)}


def _departure_check(departures: list[dict[str, Any]], everything: FitResult) -> ev.Check:
    """Check that cruise runs at every beat frequency follow the recoil law, and warn of each that departs."""
    for d in departures:
        word = "slower" if d["share"] < 0 else "faster"
        warn(
            "SWM030",
            f"the runs at {d['frequency_hz']:g} Hz are {abs(100 * d['share']):.1f} % {word} than the law "
            f"fitted to the other frequencies ({abs(d['z']):.1f} standard errors, {d['runs']} runs) and are "
            "left out of the fit. A fin that flexes at high frequency may be the cause (source, section 4.2)",
        )
    off = ", ".join(f"{d['frequency_hz']:g} Hz: {numbers.percent(d['share'], 2)}" for d in departures)
    values = []
    for n in everything.labels:
        unit = everything.parameter(n).unit
        values.append(f"{n} {numbers.format_estimate(everything.value(n), everything.stderr(n), unit)}")
    fitted = "; ".join(values)
    limit = f"within {100 * DEPARTURE_RTOL:g} % or {DEPARTURE_Z:g} standard errors"
    text = f"left out of the fit; with these frequencies {fitted}" * bool(departures)
    reason = f"the runs at {off} depart from the law and are left out"
    name = "every frequency follows the law"
    return ev.make_check(name, off or "all", not departures, limit, text, reason=reason)


def _free_exponents(
    model: Model, trials: Sequence[Trial], choices: tuple[Parameter, ...], laws: Mapping[str, float], of: str
) -> tuple[dict[str, Estimate], list[ev.Check]]:
    """Estimate each exponent of a power law of thrust or power in a separate fit, and check its value.

    The check passes if the estimate agrees with the exponent of the law.

    Parameters
    ----------
    laws : mapping of str to float
        Value of each exponent in the law.
    of : str
        Name of the quantity that is a power law, for the messages.

    Returns
    -------
    exponents : dict of str to Estimate
        Estimates of the exponents, with names such as ``free_frequency_exponent``.
    checks : list of Check
    """
    exponents, checks = {}, []
    for name, law in laws.items():
        try:
            result = output_error.fit_output_error(
                model, trials, parameters=choose_parameters(choices, freed=(name,))
            )
        except NoTrustworthyResult:
            continue
        fit_common.refuse_interrupted(result)
        value, stderr, status = result.value(name), result.stderr(name), result.status[name]
        # Report an exponent as not identifiable if the amplitude offset is not identifiable or is at its
        # bound.
        if result.status.get("amplitude_offset_deg", "estimated") != "estimated":
            status = "unidentifiable"
        exponents[f"free_{name}"] = Estimate(
            value=value, stderr=stderr, unit="1", bounds=(0, 6), status=status
        )  # type: ignore[arg-type]
        words, shown, agrees = name.replace("_", " "), "not identifiable", None
        if status == "estimated" and stderr:
            shown, agrees = numbers.format_estimate(value, stderr), abs(value - law) <= EXPONENT_Z * stderr
        if agrees is False:
            warn("SWM031", f"the estimated {words} of {of} is {shown}; the law has {law:g}")
        reason = f"the estimated {words} of {of} is {shown}, not {law:g}"
        text = f"exponent of the {of}, estimated together with the other parameters"
        checks.append(ev.make_check(words, shown, agrees, f"{law:g} (the law)", text, reason=reason))
    return exponents, checks


# ------------------------------------------------------------ errors of the drag file


def _models_by_drag_error(experiment: Experiment) -> dict[str, RecoilModel]:
    """Return copies of the recoil model, in each of which one drag parameter is larger by its standard error.

    The key of a model is the name of this parameter. Parameters without a standard error have no model.
    """
    drag, fins = experiment.facts["drag"], [t.id for t in experiment.trials]
    models = {}
    for name in DRAG_PARAMETERS:
        if drag.parameters[name].stderr:
            moved = drag.model_copy(deep=True)
            moved.parameters[name].value += drag.parameters[name].stderr
            path = experiment.facts["drag_path"]
            models[name] = propulsion_trials.recoil_model(experiment.robot, fins, moved, path=path)
    return models


def _with_drag_error(
    result: FitResult, trials: list[Trial], choices: tuple[Parameter, ...], experiment: Experiment
) -> FitResult:
    """Return a copy of the fit whose covariance also includes the uncertainty of the drag parameters."""
    drag: ParameterFile = experiment.facts["drag"]
    shifts, joint = np.zeros((2, len(result.labels))), np.eye(2)
    for name, other in _models_by_drag_error(experiment).items():
        moved = output_error.fit_output_error(other, trials, parameters=choices)
        shifts[DRAG_PARAMETERS.index(name)] = moved.estimate - result.estimate
    if drag.correlation and all(n in drag.correlation.names for n in DRAG_PARAMETERS):
        i, j = (drag.correlation.names.index(n) for n in DRAG_PARAMETERS)
        joint[0, 1] = joint[1, 0] = drag.correlation.matrix[i][j]
    return replace(result, covariance=result.covariance + shifts.T @ joint @ shifts)


def _derive(experiment: Experiment, result: FitResult, points: list[dict[str, Any]]) -> dict[str, Estimate]:
    """Return the velocity ratio and the smallest and largest propulsive force of the cruise runs (N).

    The velocity ratio is the average speed of a run from rest divided by the terminal speed.
    """
    coefficient = experiment.facts["drag"].parameters["drag_coefficient"]
    distance = float(np.median(np.concatenate([t.inputs["distance_m"] for t in experiment.trials])))
    models = (experiment.model, *_models_by_drag_error(experiment).values())
    ratio, *moved = (float(velocity_ratio(m.b1, distance)) for m in models)  # type: ignore[attr-defined]
    error = math.sqrt(sum((other - ratio) ** 2 for other in moved))
    scatter = 2 * result.noise[SPEED].value_sd / float(np.median([p["mean_speed_m_s"] for p in points]))
    relative = math.hypot((coefficient.stderr or 0.0) / coefficient.value, scatter)
    forces = [p["propulsive_force_N"] for p in points]
    return {
        "velocity_ratio": _make_estimate(ratio, error, "1"),
        "smallest_propulsive_force": _make_estimate(min(forces), min(forces) * relative, "N"),
        "largest_propulsive_force": _make_estimate(max(forces), max(forces) * relative, "N"),
    }


# ------------------------------------------------------------ operating points


def _operating_points(experiment: Experiment, result: FitResult) -> list[dict[str, Any]]:
    """Return the terminal speed, propulsive force, Strouhal numbers and efficiency of every cruise run."""
    model = result.model
    assert isinstance(model, RecoilModel)
    offset = np.deg2rad(result.value("amplitude_offset_deg"))
    points = []
    for trial in experiment.trials:
        fin, inertia = experiment.robot.fins[trial.id], trial.cruise.inertia_kg_m2
        for k in np.flatnonzero(np.isfinite(trial.measured[SPEED])):
            speed, distance = float(trial.measured[SPEED][k]), trial.inputs["distance_m"][k]
            f, a = float(trial.inputs["frequency_hz"][k]), float(trial.inputs["amplitude_rad"][k])
            terminal = float(speed / velocity_ratio(model.b1, distance))
            efficiency = None
            if inertia is not None and a > offset:
                efficiency = float(
                    model.drag_area_kg_m * terminal**3 / (8 * np.pi**2 * inertia * (a - offset) ** 2 * f**3)
                )
            points.append(
                {
                    "fin": trial.id,
                    "frequency_hz": f,
                    "amplitude_deg": float(np.rad2deg(a)),
                    "mean_speed_m_s": speed,
                    "terminal_speed_m_s": terminal,
                    "propulsive_force_N": float(model.drag_area_kg_m * terminal**2),
                    "strouhal_fin": strouhal(f, a, fin.length_m, terminal),
                    "strouhal_axle": strouhal(f, a, fin.length_m + fin.axle_gap_m, terminal),
                    "efficiency": efficiency,
                }
            )
    return points


def _run_table(points: list[dict[str, Any]]) -> ev.Table:
    """Return the report table with the speeds, force, Strouhal numbers and efficiency of each cruise run."""
    runs = []
    for p in points:
        row: dict[str, ev.Cell] = {"fin": p["fin"]}
        for title, (key, factor) in COLUMNS.items():
            row[title] = p[key] and factor * p[key]
        runs.append(row)
    about = (
        "Force is drag at terminal speed. The lever of the wake width in the Strouhal number is the length "
        "of the fin (Eq 28), or the distance from the axle to the trailing edge."
    )
    return ev.make_table("points", "Runs", runs, about)


def _speed_figure(
    experiment: Experiment, result: FitResult, points: list[dict[str, Any]], left_out: list[float]
) -> ev.Figure:
    """Return the figure of the average speed of cruise runs over beat frequency and over beat amplitude.

    The figure shows the measured runs as points and the fitted recoil law as lines.
    """
    amplitudes, counts = np.unique([round(p["amplitude_deg"], 6) for p in points], return_counts=True)
    amplitude = float(amplitudes[np.argmax(counts)])
    settings = {(p["frequency_hz"], p["amplitude_deg"]) for p in points}
    frequencies, counts = np.unique([f for f, _ in settings], return_counts=True)
    swept = frequencies[counts > 2][:1].tolist()
    common = [p for p in points if abs(p["amplitude_deg"] - amplitude) < 1e-6]
    over_frequency = _frequency_traces(experiment, result, common, amplitude, left_out)
    title, y_label = f"at {amplitude:g}°", "average speed (cm/s)"
    speeds = [ev.panel("frequency (Hz)", y_label, over_frequency, title=title)]
    over_amplitude = []
    for group, trial in enumerate(experiment.trials):
        runs = [p for p in points if p["fin"] == trial.id and p["frequency_hz"] in swept]
        if runs:
            line = np.linspace(0.0, max(p["amplitude_deg"] for p in runs), 400)[1:]
            law = _law_cm_s(result, trial, np.full(len(line), swept[0]), line)
            over_amplitude += _points(runs, trial.id, "amplitude_deg", 1.5, group)
            over_amplitude.append(ev.Trace(x=line, y=law**1.5, group=group))
    if over_amplitude:
        title, y_label = f"at {swept[0]:g} Hz", "speed¹·⁵ ((cm/s)¹·⁵)"
        speeds.append(ev.panel("amplitude (°)", y_label, over_amplitude, title=title))
    about = (
        "Points are runs, lines the fitted law: straight through the origin over frequency, straight with "
        "the offset as intercept over amplitude. Runs that depart from the law are not fitted."
    )
    return ev.panels("speeds", "Average speed", about, speeds)


def _frequency_traces(
    experiment: Experiment,
    result: FitResult,
    points: Sequence[dict[str, Any]],
    amplitude: float,
    left_out: Sequence[float],
) -> list[ev.Trace]:
    """Return measured speeds over frequency at one amplitude, and the lines of the fitted law."""
    traces: list[ev.Trace] = []
    kept = [p for p in points if p["frequency_hz"] not in left_out]
    for group, trial in enumerate(experiment.trials):
        reach = [p["frequency_hz"] for p in points if p["fin"] == trial.id]
        traces += _points(kept, trial.id, "frequency_hz", 1.0, group)
        if reach:
            line = np.linspace(0.0, max(reach), 60)[1:]
            law = _law_cm_s(result, trial, line, np.full(len(line), amplitude))
            traces.append(ev.Trace(x=[0.0, *line], y=[0.0, *law], group=group))
    rest = [{**p, "fin": "not fitted"} for p in points if p not in kept]
    return traces + _points(rest, "not fitted", "frequency_hz", 1.0, len(experiment.trials))


def _residual_figure(result: FitResult) -> ev.Figure:
    """Return the figure of the average-speed residuals of cruise runs over beat frequency and amplitude."""
    inputs = {t.id: t.inputs for t in result.trials}
    panels = []
    for name, factor, label in (
        ("frequency_hz", 1.0, "frequency (Hz)"),
        ("amplitude_rad", 180 / np.pi, "amplitude (°)"),
    ):
        traces, fins = [], result.series_of(SPEED)
        reach = factor * max(float(np.ptp(inputs[s.trial][name])) for s in fins)
        for group, s in enumerate(fins):
            # Shift the points of each fin sideways, so that points of different fins do not hide each other.
            x = factor * inputs[s.trial][name] + 0.025 * reach * (group - (len(fins) - 1) / 2)
            traces.append(ev.Trace(x=x, y=s.z_scores, style="points", label=s.trial, group=group))
        spans = [ev.Span(start=-2.0, end=2.0, axis="y", label="±2 sd")]
        panels.append(ev.panel(label, "residual / sd", traces, spans=spans))
    caption = (
        "Measured minus fitted average speed over the standard deviation of the noise. The points of the "
        "fins are moved sideways."
    )
    return ev.panels("residuals", "Residuals of the average speed", caption, panels)


def _points(runs: list[dict[str, Any]], fin: str, x: str, power: float, group: int) -> list[ev.Trace]:
    """Return the trace that shows the cruise runs of one fin as points; an empty list without such runs.

    ``x`` is the key of the horizontal axis. The vertical axis has the average speed (cm/s) to the given
    power.
    """
    own = [p for p in runs if p["fin"] == fin]
    if not own:
        return []

    def speed(run: dict[str, Any]) -> float:
        return float((100 * run["mean_speed_m_s"]) ** power)

    return [ev.make_point_trace(own, lambda run: run[x], speed, label=fin, group=group)]


def _law_cm_s(result: FitResult, trial: Trial, frequency: Array, amplitude_deg: Array) -> Array:
    """Return the average speed that the fitted recoil law predicts for cruise runs of a fin, cm/s.

    The distance of the runs is the median distance of the measured runs.
    """
    distance = np.full(len(frequency), np.median(trial.inputs["distance_m"]))
    amplitude = np.deg2rad(amplitude_deg)
    inputs = {"frequency_hz": frequency, "amplitude_rad": amplitude, "distance_m": distance}
    runs = replace(trial, time_s=np.arange(len(frequency), dtype=float), inputs=inputs)
    return 100 * result.model.run(result.values(trial.id), runs)[SPEED]
