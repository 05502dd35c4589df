"""``fit-drag``: drag, added mass and friction of a rig, by maximum likelihood or the boxfish paper's method.

The two-point method of the paper uses speeds at two displacements (Eqs 13-19). At a fixed displacement the
squared speed is a linear function of the pulling mass. The slopes at two displacements give ``a1`` (Eq 18),
and hence the drag coefficient and the added mass. Slope and intercept give the pulley friction (Eq 17). The
method assumes the same moving mass for all pulling weights. The bias is the error of
the method on noise-free data that are simulated with its own estimates. The reported standard error includes
the bias. The output-error fit does not assume an equal moving mass.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy import optimize

from swimid.errors import NoTrustworthyResult
from swimid.files import provenance
from swimid.fitting import fit_common, output_error
from swimid.fitting.fit_common import Experiment
from swimid.fitting.model import Array, Parameter, chosen
from swimid.fitting.output_error import FitResult
from swimid.logs.trials import TrialSet
from swimid.notices import Progress, recorded, silent
from swimid.options import takes
from swimid.results import evidence as ev
from swimid.results import numbers
from swimid.results.parameters import Fit, Fitted, ParameterFile
from swimid.rig import checks as rig_checks
from swimid.rig import trials as rig_experiment
from swimid.rig.model import falling_weight_closed_form
from swimid.rig.options import FitDragOptions

#: Reason why the two-point method has no result.
NO_ANSWER = "its speeds do not rise with the pulling mass as Eq 13 says"
#: Parameters of the two-point method, in 1 (no unit), kg and N.
NAMES = ("drag_coefficient", "added_mass", "pulley_friction")
#: Default displacements of the two-point method, as fractions of the displacement that all drops reached.
POINT_SHARES = (0.255, 0.51)
#: Half-width of the interval of displacement around a point in which the speed is fitted, as a fraction of
#: the first displacement.
HALF_WIDTH = 1 / 6
#: Minimum number of samples in the interval around a point. The noise is estimated from more than
#: ``MIN_SCATTER_SAMPLES`` samples.
MIN_SAMPLES, MIN_SCATTER_SAMPLES = 3, 4
#: Minimum number of different pulling masses for the two-point method.
MIN_MASSES = 3


@takes(FitDragOptions)
def fit_drag(
    trials: str | Path | TrialSet,
    *,
    options: FitDragOptions,
    output: Path | None = None,
    progress: Progress = silent,
) -> Fitted:
    """Identify drag, added mass and friction of a body on a rig: falling weight, towing or free decay.

    For a falling weight the report also shows the result of the two-point method, if the method can be used.
    Coloured residuals (SWM013) show that the model may lack an effect, which then biases the estimates. Use
    :func:`swimid.diagnose` to find this effect before you use the estimates.

    Parameters
    ----------
    trials : path or TrialSet
        Trials file, or the result of :func:`swimid.load`. Displacements are in m (rad for a rotation), forces
        in N (N m), pulling masses in kg.
    output : path, optional
        Parameter file to write, together with its evidence file.
    progress : Progress
        Progress bar of the search.

    Returns
    -------
    Fitted
        ``.parameters`` has ``drag_coefficient`` (1) or ``quadratic_drag`` (N s^2/m^2), ``added_mass`` (kg)
        and ``pulley_friction`` (N). A free decay also has ``linear_drag`` (N s/m) and ``stiffness`` (N/m), a
        rotation ``quadratic_damping``, ``linear_damping`` and ``added_inertia``. ``.verdict`` and
        ``.checks()`` judge them.

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
       Eqs 7 and 8: the equation of motion; Eqs 9 and 10: its closed form; Eqs 13 to 19: the two-point method.
    .. [2] V. Klein, E. A. Morelli, *Aircraft System Identification: Theory and Practice*, AIAA, 2006.
       Output error.

    Examples
    --------
    A weight over a pulley pulls the boxfish through the tank in seven drops:

    >>> drag = fit_drag("sample_logs/rig/trials.yaml")
    >>> drag.parameters.loc[["drag_coefficient", "added_mass"], "value"].round(1).to_dict()
    {'drag_coefficient': 0.7, 'added_mass': 0.7}
    >>> drag["added_mass"].unit, drag.converged, drag.verdict
    ('kg', True, 'good')
    """
    with recorded(repeat=True) as notices:
        experiment = rig_experiment.load(trials, coordinate=options.coordinate)
        choices = fit_common.prepare(
            experiment, output, fixed=options.fixed, freed=options.freed, bounds=options.bounds
        )
        result, facts, checks = _fit_best(experiment, choices, options.start_state, progress)
        pair = None
        try:
            pair = _two_point(experiment, options.points_m)
        except NoTrustworthyResult:
            if options.method == "two-point":
                raise
        origin = provenance.collect(experiment.inputs, settings=options.settings())
        file = fit_common.parameter_file(
            result,
            robot=experiment.robot.name,
            provenance=origin,
            derived=rig_checks.derive(experiment, result),
            settings=facts,
        )
        checks = [
            *fit_common.checks(result),
            *rig_checks.possible_checks(experiment, result),
            *checks,
        ]
    if result.shared and all(result.status[label] != "estimated" for label in result.shared):
        raise NoTrustworthyResult(
            f"none of {', '.join(result.shared)} can be identified from these trials",
            hint="use longer runs, more different forces, or fix what is known with --fix",
        )
    if options.method == "two-point":
        assert pair is not None
        file = _two_point_file(file, pair)
    figures, notes = fit_common.figures(result), []
    if pair is not None:
        figures.append(_speed_figure(pair))
        notes.append(_two_point_text(pair))
    evidence = ev.Evidence(
        command="fit-drag",
        title=f"Rig identification of {experiment.robot.name}: {experiment.name}",
        verdict=ev.judged(fit_common.answer(file), checks),
        checks=checks,
        tables=[_methods_table(experiment, result, pair)],
        figures=figures,
        notes=notes,
        notices=ev.notices(notices),
        methods=_methods(experiment, result, options.method, pair),
        references=list(experiment.robot.sources),
        provenance=origin,
    )
    return Fitted.of(file, evidence).saved(output)


# ------------------------------------------------------------ maximum likelihood


def _fit_best(
    experiment: Experiment, choices: tuple[Parameter, ...], start_state: str, progress: Progress
) -> tuple[FitResult, dict[str, str], list[ev.Check]]:
    """Return the best fit over interpretations of the logs and start states, its settings and its checks."""
    if start_state == "estimate":
        choices = chosen(choices, freed=("start_offset", "initial_speed"))
    no_spring = any(p.name == "stiffness" and not p.free and p.start == 0.0 for p in choices)
    adapted = []
    for p in choices:
        if p.name == "gravity_stiffness" and p.free and no_spring:
            # without a spring, the search starts at the gravity stiffness that follows from the period
            p = replace(p, start=p.scale)
        adapted.append(p)
    readings = experiment.variants or {"": experiment.trials}
    fits = {
        name: output_error.fit(experiment.model, trials, parameters=adapted, progress=progress)
        for name, trials in readings.items()
    }
    name = min(fits, key=lambda key: rig_checks.squared_error(fits[key]))
    facts = {}
    if name:
        facts["encoder_rounding"] = name
    plain = fits[name]
    free_start = any(p.free for p in adapted if p.name in rig_checks.STARTS)
    if experiment.name == "falling-weight" and start_state == "auto" and not free_start:
        best, facts["start_state"], omitted = rig_checks.fit_start_states(plain)
    else:
        best, omitted = plain, rig_checks.find_omitted(plain)
    checks = [rig_checks.omission_check(best, omitted)]
    if experiment.name == "towed":
        checks.append(rig_checks.sign_check(best))
    result = output_error.with_held_out(best)
    return result, facts, checks + rig_checks.trial_checks(plain, result)


def _methods(
    experiment: Experiment, result: FitResult, method: str, pair: TwoPointResult | None
) -> list[str]:
    count = len([t for t in result.trials if t.role == "fit"])
    sentences = [
        f"{', '.join(result.shared)} were estimated from {count} {experiment.name} trials ({result.samples} "
        "samples) by output-error maximum likelihood with a single-degree-of-freedom rig model.",
        fit_common.COVARIANCE,
    ]
    if method == "two-point" and pair is not None:
        points = " and ".join(f"{point:.3f} m" for point in pair.points_m)
        sentences.append(f"The two-point method (Eqs 13 to 19 of the boxfish paper) was used at {points}.")
    return sentences


def _methods_table(experiment: Experiment, result: FitResult, pair: TwoPointResult | None) -> ev.Table:
    """Return a table of the estimates of both methods together with values from theory."""
    theory = rig_checks.theory_estimates(experiment.robot)
    fitted = fit_common.estimates(result)
    rows: list[list[Any]] = []
    for name in dict.fromkeys([*NAMES, *(t.parameter for t in theory)]):
        if name not in fitted:
            continue
        e, two, bias = fitted[name], "", ""
        if pair is not None and name in pair.values:
            two = numbers.measured(pair.values[name], pair.stderr[name], e.unit)
            bias = numbers.number(pair.bias[name], 2, e.unit)
        known = "not identifiable"
        if e.status != "unidentifiable":
            known = numbers.measured(e.value, e.stderr, e.unit)
        quoted = [f"{numbers.number(t.value, 3, t.unit)} ({t.basis})" for t in theory if t.parameter == name]
        rows.append([name, known, two, bias, "; ".join(quoted)])
    return ev.Table(
        id="methods",
        title="Both methods and theory side by side",
        columns=["parameter", "maximum likelihood", "two-point", "two-point bias", "theory"],
        rows=rows,
        caption="The two-point method assumes an equal moving mass for all pulling weights. Its bias is its "
        "error on noise-free data of its own answer, and is part of its stated error.",
    )


# ------------------------------------------------------------ two-point method of the boxfish paper


@dataclass(frozen=True)
class Drop:
    """Falling-weight trial from the time of release on, without missing samples."""

    pulling_mass_kg: float
    time_s: Array
    displacement_m: Array


@dataclass(frozen=True)
class TwoPointResult:
    """Result of the two-point method.

    Attributes
    ----------
    values, stderr, bias : dict of str to float
        Results for the parameters :data:`NAMES`. The standard error combines random error and bias.
    points_m : tuple of float
        The two displacements.
    pulling_mass_kg : ndarray, shape (k,)
    speed_squared, speed_squared_sd : ndarray, shape (2, k), m2/s2
    slopes, intercepts : ndarray, shape (2,)
        Lines of squared speed over pulling mass at each displacement: alpha and beta of Eq 13.
    """

    values: dict[str, float]
    stderr: dict[str, float]
    bias: dict[str, float]
    points_m: tuple[float, float]
    pulling_mass_kg: Array
    speed_squared: Array
    speed_squared_sd: Array
    slopes: Array
    intercepts: Array

    @property
    def is_valid(self) -> bool:
        """Whether the speeds lie on rising lines, so that the standard errors are finite."""
        return all(map(math.isfinite, self.stderr.values()))


def speed_at(
    time_s: Array, displacement_m: Array, point_m: float, half_width_m: float
) -> tuple[float, float]:
    """Return the speed at a displacement and its standard error, m/s, by a straight-line fit around it.

    Raises
    ------
    NoTrustworthyResult
        If fewer than :data:`MIN_SAMPLES` samples lie around the point.
    """
    near = np.abs(displacement_m - point_m) <= half_width_m
    if near.sum() < MIN_SAMPLES:
        raise NoTrustworthyResult(
            f"only {int(near.sum())} samples lie within {half_width_m:.3g} m of the displacement "
            f"{point_m:.3g} m",
            hint="choose --points inside the measured displacement, or use the default method",
        )
    t, x = time_s[near] - time_s[near].mean(), displacement_m[near]
    spread = 0.0
    if len(t) > MIN_SCATTER_SAMPLES:
        # the residuals are those of a parabola, so that curvature does not count as noise; in the middle the
        # parabola has the slope of the line
        residual = x - np.polyval(np.polyfit(t, x, 2), t)
        spread = math.sqrt(float(residual @ residual) / (len(t) - 3))
    return float(t @ x) / float(t @ t), spread / math.sqrt(float(t @ t))


def two_point(
    drops: Sequence[Drop],
    *,
    mass_kg: float,
    frontal_area_m2: float,
    density_kg_m3: float,
    gravity_m_s2: float,
    points_m: tuple[float, float] | None = None,
) -> TwoPointResult:
    """Estimate drag coefficient, added mass and pulley friction from speeds at two displacements.

    Parameters
    ----------
    drops : sequence of Drop
        Falling-weight trials with at least three different pulling masses.
    mass_kg : float
        Inertia of body and pulley, without the pulling mass.
    points_m : (x1, x2), optional
        The two displacements. The default is :data:`POINT_SHARES` of the displacement that all drops reached.
        The paper used 0.293 and 0.584 m.

    Raises
    ------
    NoTrustworthyResult
        If there are too few drops, if a displacement is outside the data, or if the speeds do not follow a
        drag law.
    """
    masses = np.array([d.pulling_mass_kg for d in drops])
    if len(np.unique(masses)) < MIN_MASSES:
        raise NoTrustworthyResult(
            f"the two-point method needs at least {MIN_MASSES} different pulling masses"
        )
    reach = min(float(d.displacement_m.max()) for d in drops)
    points = points_m or (POINT_SHARES[0] * reach, POINT_SHARES[1] * reach)
    if not 0 < points[0] < points[1]:
        raise NoTrustworthyResult(f"the two displacements must rise from zero: {points[0]:g} {points[1]:g}")

    def speeds(displacements: Sequence[Array]) -> tuple[Array, Array]:
        """Return the speeds at the points and their standard errors, each shape (2, k)."""
        pairs = list(zip(drops, displacements, strict=True))
        width = points[0] * HALF_WIDTH
        fits = np.array([[speed_at(d.time_s, x, point, width) for d, x in pairs] for point in points])
        return fits[:, :, 0], fits[:, :, 1]

    def solve(squared: Array) -> tuple[Array, Array, Array]:
        slopes, intercepts = np.array([np.polyfit(masses, v, 1) for v in squared]).T
        a1 = solve_a1(slopes[0] / slopes[1], points)
        # tanh^2 phi(x) = 1 - exp(-2 a1 x), from Eq 14
        saturation = -np.expm1(-2 * a1 * np.array(points))
        drag = float(np.mean(2 * gravity_m_s2 * saturation / (density_kg_m3 * frontal_area_m2 * slopes)))
        moving = mass_kg + float(masses.mean())
        added = density_kg_m3 * drag * frontal_area_m2 / (2 * a1) - moving
        friction = float(np.mean(-gravity_m_s2 * intercepts / slopes))
        return np.array([drag, added, friction]), slopes, intercepts

    measured, measured_sd = speeds([d.displacement_m for d in drops])
    squared, squared_sd = measured**2, 2 * np.abs(measured) * measured_sd
    answer, slopes, intercepts = solve(squared)

    # random error, from the residuals of the squared speeds about their lines
    scatter = squared - (slopes[:, None] * masses + intercepts[:, None])
    pooled = math.sqrt(float(np.sum(scatter**2)) / max(2 * len(masses) - 4, 1))
    spread = np.maximum(squared_sd, pooled)
    variance = np.zeros(3)
    for at in np.ndindex(squared.shape):
        moved = squared.copy()
        moved[at] += spread[at]
        try:
            variance += (solve(moved)[0] - answer) ** 2
        except NoTrustworthyResult:
            variance = np.full(3, np.inf)
            break

    drag, added, friction = answer
    area_factor = 0.5 * density_kg_m3 * frontal_area_m2 * drag
    perfect = [
        falling_weight_closed_form(
            d.time_s, 0.0, mass_kg + added + weight, area_factor, weight * gravity_m_s2 - friction
        )[0]
        for d, weight in zip(drops, masses, strict=True)
    ]
    bias = solve(speeds(perfect)[0] ** 2)[0] - answer
    values, stderr, bias_of = (
        dict(zip(NAMES, v.tolist(), strict=True)) for v in (answer, np.hypot(np.sqrt(variance), bias), bias)
    )
    at_points = (float(points[0]), float(points[1]))
    return TwoPointResult(values, stderr, bias_of, at_points, masses, squared, squared_sd, slopes, intercepts)


def solve_a1(ratio: float, points_m: tuple[float, float]) -> float:
    """Solve Eq 18 for a1, 1/m. If the second displacement is twice the first, Eq 19 is the closed form.

    Raises
    ------
    NoTrustworthyResult
        If no drag coefficient gives this ratio of squared speeds.

    >>> round(solve_a1(0.75, (0.3, 0.6)), 3)
    1.831
    """
    x1, x2 = points_m
    if not x1 / x2 < ratio < 1:
        raise NoTrustworthyResult(
            f"the squared speeds at {x1:.3g} m and {x2:.3g} m have the ratio {ratio:.3f}; "
            f"drag needs one between {x1 / x2:.3f} and 1",
            hint="choose other --points, or use the default method",
        )
    if abs(x2 - 2 * x1) < 1e-9 * x1:
        return -math.log(1 / ratio - 1) / (2 * x1)

    def mismatch(a1: float) -> float:
        return math.expm1(-2 * a1 * x1) / math.expm1(-2 * a1 * x2) - ratio

    return float(optimize.brentq(mismatch, 1e-9 / x1, 50 / x1))


def _two_point(experiment: Experiment, points_m: tuple[float, float] | None) -> TwoPointResult:
    """Apply the two-point method to an experiment; raise an error if the method cannot be used."""
    body, fluid = experiment.robot.body, experiment.robot.fluid
    pulled = [t for t in experiment.trials if t.rig.pulley and t.role == "fit"]
    if body.inertial_mass_kg is None or body.frontal_area_m2 is None:
        raise NoTrustworthyResult("the two-point method needs the robot's inertial mass and frontal area")
    drops = [
        Drop(t.rig.pull / fluid.gravity_m_s2, t.time_s - t.rig.begin_s, t.measured["x_m"] - t.rig.x0)
        for t in pulled
    ]
    return two_point(
        drops,
        mass_kg=body.inertial_mass_kg + experiment.robot.rig.pulley_inertia_kg,
        frontal_area_m2=body.frontal_area_m2,
        density_kg_m3=fluid.density_kg_m3,
        gravity_m_s2=fluid.gravity_m_s2,
        points_m=points_m,
    )


def _two_point_file(file: ParameterFile, pair: TwoPointResult) -> ParameterFile:
    """Return a parameter file in which the estimates are those of the two-point method.

    Raises
    ------
    NoTrustworthyResult
        If the method has no finite standard errors.
    """
    if not pair.is_valid:
        raise NoTrustworthyResult(
            f"the two-point method has no answer: {NO_ANSWER}",
            hint="look at the pulling masses, or use --method ml",
        )
    parameters = {}
    for name, value in pair.values.items():
        found = {"value": value, "stderr": pair.stderr[name], "status": "estimated", "ci95": None}
        parameters[name] = file.parameters[name].model_copy(update=found)
    assert file.fit is not None
    fit = Fit(trials=file.fit.trials, converged=True, method="two-point", points_m=list(pair.points_m))  # type: ignore[call-arg]
    return file.model_copy(
        update={"parameters": parameters, "correlation": None, "identifiability": [], "fit": fit}
    )


def _two_point_text(pair: TwoPointResult) -> str:
    """Return the result of the two-point method as a sentence."""
    if not pair.is_valid:
        return f"The two-point method has no answer: {NO_ANSWER}."
    parts = [f"{n} {numbers.measured(value, pair.stderr[n])}" for n, value in pair.values.items()]
    return f"The two-point method gives {', '.join(parts)}."


def _speed_figure(pair: TwoPointResult) -> ev.Figure:
    order = np.argsort(pair.pulling_mass_kg)
    mass = pair.pulling_mass_kg[order]
    traces = []
    for i, point in enumerate(pair.points_m):
        squared, error = pair.speed_squared[i][order], 1.96 * pair.speed_squared_sd[i][order]
        line, label = pair.slopes[i] * mass + pair.intercepts[i], f"at {point:.3f} m"
        traces.append(ev.Trace(x=1e3 * mass, y=squared, y_error=error, style="points", label=label, group=i))
        traces.append(ev.Trace(x=1e3 * mass, y=line, group=i))
    title = "Squared speed against pulling mass"
    caption = "Squared speed at two displacements with 95 % intervals; the lines are fitted to these points."
    return ev.figure("speed-squared", title, caption, "pulling mass (g)", "squared speed (m²/s²)", traces)
