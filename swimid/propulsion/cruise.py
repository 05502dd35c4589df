"""The recoil law from a cruise table: fit, departures, operating points, and its evidence."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from swimid.errors import NoTrustworthyResult
from swimid.fitting import fit_common, output_error
from swimid.fitting.experiment import Experiment
from swimid.fitting.metrics import FitResult
from swimid.fitting.model import Array, Model, Parameter, Trial, chosen
from swimid.notices import warn
from swimid.progress import Progress
from swimid.propulsion import trials as cruise_trials
from swimid.propulsion.model import SPEED, RecoilModel, strouhal, velocity_ratio
from swimid.results import evidence as ev
from swimid.results import numbers
from swimid.results.parameters import Estimate, ParameterFile

#: A frequency is left out of the fit where its runs lie off the law by more than this share, and by more than
#: so many standard errors.
DEPARTURE_SHARE, DEPARTURE_Z = 0.01, 4.0
#: The exponents of the law.
LAWS = {"frequency_exponent": 3.0, "amplitude_exponent": 2.0}
#: Distance over which the average speed is the terminal one to a millionth, m.
FAR_M = 1e7
#: Parameters that the law takes from a drag file.
DRAG_NUMBERS = ("drag_coefficient", "added_mass")


def fit(
    experiment: Experiment,
    choices: tuple[Parameter, ...],
    origin: dict[str, Any],
    wake: str,
    keep_departures: bool,
    progress: Progress,
) -> tuple[ParameterFile, ev.Evidence]:
    """Fit the law, leave out what departs from it, carry the errors of the drag file along.

    Parameters
    ----------
    choices : tuple of Parameter
        Those of the model with the user's choices applied.
    origin : dict
        The provenance block.

    Raises
    ------
    NoTrustworthyResult
        When neither parameter can be identified.
    """
    model = experiment.model
    assert isinstance(model, RecoilModel)
    if all(inertia is None for inertia in model.fins.values()):
        warn(
            "SWM019",
            "no fin's hydrodynamic inertia is known: only its product with the efficiency is determined; the "
            "efficiency is held at its starting value",
        )
    everything = output_error.fit(model, experiment.trials, parameters=choices, progress=progress)
    fit_common.refuse_interrupted(everything)
    departures = [] if keep_departures else _departures(model, experiment.trials, choices)
    kept = [_without(t, [d["frequency_hz"] for d in departures]) for t in experiment.trials]
    result = everything
    if departures:
        result = output_error.fit(model, kept, parameters=choices, progress=progress)
    if all(result.status[label] != "estimated" for label in result.labels):
        raise NoTrustworthyResult("neither efficiency nor offset can be identified from this table")
    exponents = free_exponents(model, kept, choices, LAWS, "power")
    result = _with_drag_error(result, kept, choices, experiment)
    points = _operating_points(experiment, result, wake)
    file = fit_common.parameter_file(
        result,
        robot=experiment.robot.name,
        provenance=origin,
        derived=_derived(experiment, result, model, points) | exponents,
        settings={"wake": wake, "drag_file": str(experiment.facts["drag_path"])},
    )
    file._drag = experiment.facts["drag"]
    assert file.fit is not None
    assert file.fit.model_extra is not None
    file.fit.model_extra["departures"] = departures
    file.fit.model_extra["operating_points"] = points
    checks = [
        *fit_common.checks(result, file),
        _departure_check(departures, everything),
        *_exponent_checks(exponents),
    ]
    evidence = ev.Evidence(
        verb="fit-propulsion",
        title=f"Propulsion of {experiment.robot.name}: energy recoil law",
        verdict=ev.judged(fit_common.answer(file), checks),
        checks=checks,
        tables=_tables(experiment, points),
        figures=[*_figures(experiment, result, points), *fit_common.figures(result)[1:]],
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


def free_exponents(
    model: Model, trials: Sequence[Trial], choices: tuple[Parameter, ...], laws: Mapping[str, float], of: str
) -> dict[str, Estimate]:
    """Each exponent of a law of thrust or power set free in turn; warns of one that is not that of the law.

    Parameters
    ----------
    laws : mapping of str to float
        Value of each exponent under the law.
    of : str
        The quantity that has the exponents, for the warning.
    """
    exponents = {}
    for name, law in laws.items():
        try:
            result = output_error.fit(model, trials, parameters=chosen(choices, freed=(name,)))
        except NoTrustworthyResult:
            continue
        fit_common.refuse_interrupted(result)
        value, stderr, status = result.value(name), result.stderr(name), result.status[name]
        # with the offset held at a bound the exponent answers another question
        if result.status.get("amplitude_offset_deg", "estimated") != "estimated":
            status = "unidentifiable"
        exponents[f"free_{name}"] = Estimate(
            value=value, stderr=stderr, unit="1", bounds=(0, 6), status=status
        )  # type: ignore[arg-type]
        if status == "estimated" and stderr and abs(value - law) > 3 * stderr:
            warn(
                "SWM031",
                f"set free, the {name.replace('_', ' ')} of {of} is {numbers.measured(value, stderr)}, the "
                f"law says {law:g}",
            )
    return exponents


def _by_drag_error(experiment: Experiment) -> dict[str, RecoilModel]:
    """Return the model with each number of the drag file larger by its standard error, where it has one."""
    drag, fins = experiment.facts["drag"], [t.id for t in experiment.trials]
    models = {}
    for name in DRAG_NUMBERS:
        if drag.parameters[name].stderr:
            moved = drag.model_copy(deep=True)
            moved.parameters[name].value += drag.parameters[name].stderr
            path = experiment.facts["drag_path"]
            models[name] = cruise_trials.recoil_model(experiment.robot, fins, moved, path=path)
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


# ------------------------------------------------------------ evidence


def _departure_check(departures: list[dict[str, Any]], everything: FitResult) -> ev.Check:
    """Return the check that every frequency follows the law."""
    off = ", ".join(f"{d['frequency_hz']:g} Hz: {numbers.percent(d['share'], 2)}" for d in departures)
    units = {p.name: p.unit for p in everything.parameters}
    fitted = [
        f"{n} {numbers.measured(everything.value(n), everything.stderr(n), units[n])}"
        for n in everything.labels
    ]
    limit = f"within {100 * DEPARTURE_SHARE:g} % or {DEPARTURE_Z:g} standard errors"
    text = f"left out of the fit; with these frequencies {'; '.join(fitted)}" if departures else ""
    reason = f"runs depart from the law at {off}, and are left out"
    return ev.check(
        "every frequency follows the law", off or "all", not departures, limit, text, reason=reason
    )


def _exponent_checks(exponents: dict[str, Estimate]) -> list[ev.Check]:
    """Return the checks that each exponent, set free with the offset, is that of the law."""
    found = []
    for name, law in LAWS.items():
        e = exponents.get(f"free_{name}")
        if e is None:
            continue
        agrees, value = None, "not identifiable"
        if e.status == "estimated" and e.stderr is not None:
            agrees, value = abs(e.value - law) <= 3 * e.stderr, numbers.measured(e.value, e.stderr)
        words = name.replace("_", " ")
        reason = f"the {words} of power is {value}, not {law:g}"
        text = "of the power, set free with the offset"
        found.append(ev.check(words, value, agrees, f"{law:g} (the law)", text, reason=reason))
    return found


def _tables(experiment: Experiment, points: list[dict[str, Any]]) -> list[ev.Table]:
    """Return the runs and the fins."""
    units = {
        "f (Hz)": ("frequency_hz", 1.0),
        "amplitude (°)": ("amplitude_deg", 1.0),
        "average speed (cm/s)": ("mean_speed_m_s", 100.0),
        "terminal speed (cm/s)": ("terminal_speed_m_s", 100.0),
        "force (mN)": ("propulsive_force_N", 1e3),
        "Strouhal, fin": ("strouhal_fin", 1.0),
        "Strouhal, axle": ("strouhal_axle", 1.0),
        "efficiency (%)": ("efficiency", 100.0),
    }
    runs: list[list[Any]] = [
        [p["fin"], *(None if p[key] is None else factor * p[key] for key, factor in units.values())]
        for p in points
    ]
    fins: list[list[Any]] = []
    for t in experiment.trials:
        inertia = t.cruise.inertia_kg_m2
        grams = None if inertia is None else numbers.number(1e7 * inertia, 5)
        fins.append([t.id, experiment.robot.fins[t.id].area_m2, grams])
    about_runs = (
        "Force is drag at terminal speed. Strouhal number with the fin's length as lever of the wake width "
        "(Eq 28) and with the distance from the axle to the trailing edge."
    )
    about_fins = "The inertia of a rectangle follows from Eq 6; where none is shown it is not known."
    inertia_title = "hydrodynamic inertia (g cm²)"
    return [
        ev.Table(id="points", title="Runs", columns=["fin", *units], rows=runs, caption=about_runs),
        ev.Table(
            id="fins",
            title="Fins",
            columns=["fin", "area (m²)", inertia_title],
            rows=fins,
            caption=about_fins,
            folded=True,
        ),
    ]


def _figures(experiment: Experiment, result: FitResult, points: list[dict[str, Any]]) -> list[ev.Figure]:
    """Return speeds over frequency and over amplitude with the law; force and Strouhal number."""
    amplitudes, counts = np.unique([round(p["amplitude_deg"], 6) for p in points], return_counts=True)
    amplitude = float(amplitudes[np.argmax(counts)])
    at_amplitude = [p for p in points if abs(p["amplitude_deg"] - amplitude) < 1e-6]
    swept = [
        f
        for f in sorted({p["frequency_hz"] for p in points})
        if len({p["amplitude_deg"] for p in points if p["frequency_hz"] == f}) > 2
    ]
    over_frequency, over_amplitude, force, wake = [], [], [], []
    for group, trial in enumerate(experiment.trials):
        runs = [p for p in at_amplitude if p["fin"] == trial.id]
        if runs:
            f = np.array([p["frequency_hz"] for p in runs])
            line = np.linspace(0.0, f.max(), 60)[1:]
            law = 100 * _law(result, trial, line, np.full(len(line), amplitude))
            over_frequency.append(_points(f, runs, "mean_speed_m_s", 100.0, group))
            over_frequency.append(ev.Trace(x=line, y=law, group=group))
            force.append(_points(f, runs, "propulsive_force_N", 1e3, group))
            terminal = _law(result, trial, line, np.full(len(line), amplitude), FAR_M)
            force.append(ev.Trace(x=line, y=1e3 * result.model.drag_area_kg_m * terminal**2, group=group))
            wake.append(_points(f, runs, "strouhal", 1.0, group))
        runs = [p for p in points if p["fin"] == trial.id and p["frequency_hz"] in swept[:1]]
        if runs:
            a = np.array([p["amplitude_deg"] for p in runs])
            line = np.linspace(0.0, a.max(), 80)[1:]
            law = 100 * _law(result, trial, np.full(len(line), swept[0]), line)
            measured = _points(a, runs, "mean_speed_m_s", 100.0, group)
            powers = np.array(measured.y, dtype=float) ** 1.5
            over_amplitude.append(measured.model_copy(update={"y": powers.tolist()}))
            over_amplitude.append(ev.Trace(x=line, y=law**1.5, group=group))
    title, x_label = f"at {amplitude:g}°", "frequency (Hz)"
    speeds = [ev.Panel(x_label=x_label, y_label="average speed (cm/s)", traces=over_frequency, title=title)]
    if over_amplitude:
        panel = ev.Panel(x_label="amplitude (°)", y_label="speed¹·⁵ ((cm/s)¹·⁵)", traces=over_amplitude)
        speeds.append(panel.model_copy(update={"title": f"at {swept[0]:g} Hz"}))
    efficient = [ev.Mark(at=0.25), ev.Mark(at=0.4, label="efficient swimmers")]
    forces = [
        ev.Panel(x_label=x_label, y_label="propulsive force (mN)", traces=force, title=title),
        ev.Panel(x_label=x_label, y_label="Strouhal number", traces=wake, title=title, marks=efficient),
    ]
    about_speeds = (
        "Points are runs, lines the fitted law: straight through the origin over frequency, straight with "
        "the offset as intercept over amplitude."
    )
    about_forces = (
        "Lines are the fitted law: force grows with the square of frequency, the Strouhal number is constant."
    )
    return [
        ev.Figure(id="speeds", title="Average speed", caption=about_speeds, panels=speeds, columns=2),
        ev.Figure(
            id="force", title="Force and Strouhal number", caption=about_forces, panels=forces, columns=2
        ),
    ]


def _points(x: Array, runs: list[dict[str, Any]], key: str, factor: float, group: int) -> ev.Trace:
    """Return a quantity of runs of one fin as points."""
    y = np.array([factor * p[key] for p in runs])
    return ev.Trace(x=x, y=y, style="points", label=runs[0]["fin"], group=group)


def _law(
    result: FitResult, trial: Trial, frequency: Array, amplitude_deg: Array, distance_m: float | None = None
) -> Array:
    """Return the average speed of runs under the law, m/s, by default over the median distance."""
    if distance_m is None:
        distance_m = float(np.median(trial.inputs["distance_m"]))
    runs = replace(
        trial,
        time_s=np.arange(len(frequency), dtype=float),
        inputs={
            "frequency_hz": frequency,
            "amplitude_rad": np.deg2rad(amplitude_deg),
            "distance_m": np.full(len(frequency), distance_m),
        },
    )
    return result.model.simulate(result.values(trial.id), runs)[SPEED]
