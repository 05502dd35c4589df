"""``fit-drag``: drag, added mass and friction of a rig, by maximum likelihood or the boxfish paper's method.

The paper's method uses speeds at two displacements (Eqs 13-19): at a fixed displacement the squared speed is
linear in the pulling mass; the slopes at two displacements give ``a1`` (Eq 18, Eq 19 where the second is
twice the first), hence drag coefficient and added mass; slope and intercept give the pulley friction (Eq
17). It treats the moving mass as the same for all pulling weights. How much that biases it is found by
running it on noise-free data computed at its own answer, and is reported and included in its stated error;
the output-error fit has no such step.
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
from swimid.fitting.experiment import Experiment
from swimid.fitting.global_search import agreeing, multistart
from swimid.fitting.metrics import FitResult
from swimid.fitting.model import Array, Parameter, chosen
from swimid.fitting.restarts import profile_interval
from swimid.logs.trials import TrialSet
from swimid.notices import recorded, warn
from swimid.options import takes
from swimid.progress import Progress, silent
from swimid.results import blocks, numbers
from swimid.results import evidence as ev
from swimid.results.fitted import Fitted
from swimid.results.parameters import Estimate, Fit, ParameterFile
from swimid.rig import derived, lack_of_fit
from swimid.rig import trials as rig_experiment
from swimid.rig.lack_of_fit import force_checks
from swimid.rig.model import falling_weight_closed_form
from swimid.rig.options import FitDragOptions

#: Why the two-point method has no answer.
NO_ANSWER = "its speeds do not rise with the pulling mass as Eq 13 says"


@takes(FitDragOptions)
def fit_drag(
    trials: str | Path | TrialSet,
    *,
    options: FitDragOptions,
    output: Path | None = None,
    progress: Progress = silent,
) -> Fitted:
    """Identify drag, added mass and friction of a body on a rig: falling weight, towing or free decay.

    Where both can be had, the report shows maximum likelihood and the two-point method (falling weight
    only) side by side. Where the residuals are coloured (SWM013) the model may lack something that the
    estimates have taken up: let :func:`swimid.diagnose` say what before they are used.

    Parameters
    ----------
    trials : path or TrialSet
        Trials: a file, or what :func:`swimid.load` gives. Displacements in m (rad of a rotation), forces in N
        (N m), pulling masses in kg.
    output : path, optional
        Parameter file to write; its evidence goes beside it.
    progress : Progress
        Shows the search and the profiles.

    Returns
    -------
    Fitted
        ``.parameters`` has ``drag_coefficient`` (1) or ``quadratic_drag`` (N s^2/m^2), ``added_mass`` (kg)
        and ``pulley_friction`` (N); of a free decay ``linear_drag`` (N s/m) and ``stiffness`` (N/m) too; of a
        rotation ``quadratic_damping``, ``linear_damping`` and ``added_inertia``. ``.correlation``,
        ``.verdict`` and ``.checks()`` say how far to trust them.

    Raises
    ------
    InputError, UsageError
        For bad files and options.
    NoTrustworthyResult
        When nothing can be identified.

    References
    ----------
    .. [1] W. L. Chan, G. Lee, B. Kim, J. M. Choi, T. Kang, "Experimental Parameter Identification and
       Performance Analysis of a Fish Robot with Ostraciiform Swimming Mode using Rigid Caudal Fins".
       Eqs 7 and 8: the equation of motion; Eqs 9 and 10: its closed form; Eqs 13 to 19: the two-point method.
    .. [2] V. Klein, E. A. Morelli, *Aircraft System Identification: Theory and Practice*, AIAA, 2006.
       Output error.

    Examples
    --------
    Seven drops of the boxfish, pulled through the tank by a weight over a pulley:

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
        best = _best_fit(experiment, choices, options.start_state, progress)
        result = best.result
        profiles = _profiles(result, progress) if options.profile else {}
        try:
            pair = _two_point(experiment, options.points_m)
        except NoTrustworthyResult:
            if options.method == "two-point":
                raise
            pair = None
        origin = provenance.collect(experiment.inputs, settings=options.settings())
        file = fit_common.parameter_file(
            result,
            robot=experiment.robot.name,
            provenance=origin,
            profiles=profiles,
            derived={**best.derived, **derived.derived(experiment, result)},
            settings=best.facts,
        )
        checks = [
            *fit_common.checks(result, file),
            *derived.possible(experiment, result),
            *best.checks,
        ]
    estimated = [label for label in result.labels if "[" not in label]
    if estimated and all(result.status[label] != "estimated" for label in estimated):
        raise NoTrustworthyResult(
            f"none of {', '.join(estimated)} can be identified from these trials",
            hint="use longer runs, more different forces, or fix what is known with --fix",
        )
    if options.method == "two-point":
        assert pair is not None
        file = _two_point_file(file, pair)
    evidence = ev.Evidence(
        verb="fit-drag",
        title=f"Rig identification of {experiment.robot.name}: {experiment.name}",
        verdict=ev.judged(fit_common.answer(file), checks),
        checks=checks,
        tables=_methods_table(experiment, result, pair),
        figures=fit_common.figures(result) + ([] if pair is None else [_speed_figure(pair)]),
        notes=_notes(pair),
        notices=blocks.notices(notices),
        methods=_methods(experiment, result, options.method, pair),
        references=list(experiment.robot.sources),
        provenance=origin,
    )
    return Fitted.of(file, evidence).saved(output)


# ------------------------------------------------------------ fitting


def _best_fit(
    experiment: Experiment, choices: tuple[Parameter, ...], start_state: str, progress: Progress
) -> lack_of_fit.Explained:
    """Return the fit under the reading of the logs that the data prefer, and what was chosen."""
    model = experiment.model
    if start_state == "estimate":
        choices = chosen(choices, freed=("start_offset", "initial_speed"))
    if any(p.name == "stiffness" and not p.free and p.start == 0.0 for p in choices):
        # without a spring the search for gravity begins at the stiffness that the period suggests
        choices = tuple(
            replace(p, start=p.scale) if p.name == "gravity_stiffness" and p.free else p for p in choices
        )
    # a friction of each trial is a random effect, never a free parameter
    friction = any(p.name == lack_of_fit.FRICTION and p.free for p in choices)
    choices = tuple(replace(p, free=False) if p.name == lack_of_fit.FRICTION else p for p in choices)
    readings = experiment.variants or {"": experiment.trials}
    fits = {
        name: output_error.fit(model, trials, parameters=choices, progress=progress)
        for name, trials in readings.items()
    }
    name = min(fits, key=lambda key: lack_of_fit.misfit(fits[key]))
    plain, checks = _from_starts(fits[name], progress)
    odd = lack_of_fit.odd_one(plain)
    free_start = any(p.free for p in choices if p.name in lack_of_fit.STARTS)
    if experiment.name == "falling-weight" and (friction or (start_state == "auto" and not free_start)):
        masses = experiment.facts.get("pulling_mass_kg", {})
        best = lack_of_fit.explain_trials(plain, choices, masses, odd, insist=friction)
    else:
        omitted = lack_of_fit.omitted_parameters(plain)
        best = lack_of_fit.Explained(plain, checks=lack_of_fit.omission_checks(plain, omitted))
    checks += best.checks
    if experiment.name == "towed":
        checks += force_checks(best.result)
    result = output_error.with_held_out(best.result)
    if odd is not None:
        checks.append(lack_of_fit.odd_check(result, odd))
    facts = {**({"encoder_rounding": name} if name else {}), **best.facts}
    return replace(best, result=result, facts=facts, checks=checks)


def _from_starts(first: FitResult, progress: Progress) -> tuple[FitResult, list[ev.Check]]:
    """Return the best fit from several starts, and the check that two lead to it; warn of a better one.

    Where the residuals are white they leave nothing that a better minimum could explain.
    """
    if first.interrupted or not any(len(noise.autoregression) for noise in first.noise.values()):
        return first, []
    best, ends = multistart(
        first.model,
        first.trials,
        first.parameters,
        starts=4,
        begins=[first.estimate],
        progress=progress,
    )
    if lack_of_fit.compute_evidence(first, best) > output_error.ANOTHER:
        change = 100 * (1 - best.cost / first.cost)
        warn(
            "SWM073",
            "the search from the start values ended in a poorer minimum: another start lowered the mean "
            f"squared residual by {change:.3g} %, and its answer is reported",
        )
    agree = agreeing(ends)
    value = f"{agree} of {len(ends)} starts end in it"
    reason = f"only {agree} of {len(ends)} searches ended in the lowest minimum"
    text = "the lowest is reported"
    return best, [ev.check("one minimum", value, agree > 1, "two at least", text, reason=reason)]


def _profiles(
    result: output_error.FitResult, progress: Progress
) -> dict[str, tuple[float | None, float | None]]:
    names = [label for label in result.labels if "[" not in label and result.stderr(label) is not None]
    intervals = {}
    with progress("profiling", total=len(names)) as step:
        for name in names:
            intervals[name] = profile_interval(result, name)
            step()
    return intervals


# ------------------------------------------------------------ two-point method


def _two_point(experiment: Experiment, points_m: tuple[float, float] | None) -> TwoPointResult:
    """The paper's method; raises where it does not apply."""
    body, fluid = experiment.robot.body, experiment.robot.fluid
    pulled = [t for t in experiment.trials if t.rig.pulley and t.role == "fit"]
    cannot = "the two-point method cannot be used: "
    if experiment.name != "falling-weight" or len(pulled) < 3:
        raise NoTrustworthyResult(
            f"{cannot}it needs a falling-weight experiment with at least three pulling masses"
        )
    if body.inertial_mass_kg is None or body.frontal_area_m2 is None:
        raise NoTrustworthyResult(f"{cannot}the robot's inertial mass and frontal area are needed")
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
    """The parameter file with the two-point method's values in place of the fit's.

    Raises
    ------
    NoTrustworthyResult
        When the method gives no errors: its points do not lie on lines, or not on rising ones.
    """
    if not pair.answers:
        raise NoTrustworthyResult(
            f"the two-point method has no answer: {NO_ANSWER}",
            hint="look at the pulling masses, or use --method ml",
        )
    parameters = {
        name: Estimate(
            value=value,
            stderr=pair.stderr[name],
            unit=file.parameters[name].unit,
            bounds=file.parameters[name].bounds,
            status="estimated",
            meaning=file.parameters[name].meaning,
        )
        for name, value in pair.values.items()
    }
    assert file.fit is not None
    fit = Fit(trials=file.fit.trials, converged=True, method="two-point", points_m=list(pair.points_m))  # type: ignore[call-arg]
    return file.model_copy(
        update={"parameters": parameters, "correlation": None, "identifiability": [], "fit": fit}
    )


# ------------------------------------------------------------ evidence


def _methods_table(
    experiment: Experiment, result: output_error.FitResult, pair: TwoPointResult | None
) -> list[ev.Table]:
    estimates = derived.theory_estimates(experiment.robot)
    fitted = fit_common.estimates(result, {})
    rows: list[list[Any]] = []
    for name in dict.fromkeys([*NAMES, *(t.parameter for t in estimates)]):
        if name not in fitted:
            continue
        e, two, bias = fitted[name], "", ""
        if pair is not None and name in pair.values:
            two = numbers.measured(pair.values[name], pair.stderr[name], e.unit)
            bias = numbers.number(pair.bias[name], 2, e.unit)
        known = "not identifiable"
        if e.status != "unidentifiable":
            known = numbers.measured(e.value, e.stderr, e.unit)
        quoted = [t for t in estimates if t.parameter == name]
        texts = [f"{numbers.number(t.value, 3, t.unit)} ({t.basis})" for t in quoted]
        rows.append([name, known, two, bias, "; ".join(texts)])
    return [
        ev.Table(
            id="methods",
            title="Both methods and theory side by side",
            columns=["parameter", "maximum likelihood", "two-point", "two-point bias", "theory"],
            rows=rows,
            caption="The two-point method takes the moving mass as equal for all pulling weights; its bias "
            "is its error on noise-free data of its own answer, and is part of its stated error.",
        )
    ]


def _notes(pair: TwoPointResult | None) -> list[str]:
    """Return the answer of the two-point method as a sentence."""
    if pair is None:
        return []
    if not pair.answers:
        return [f"The two-point method has no answer: {NO_ANSWER}."]
    parts = [f"{n} {numbers.measured(value, pair.stderr[n])}" for n, value in pair.values.items()]
    return [f"The two-point method gives {', '.join(parts)}."]


def _speed_figure(pair: TwoPointResult) -> ev.Figure:
    grams = 1e3 * pair.pulling_mass_kg
    order = np.argsort(grams)
    traces = []
    for i, point in enumerate(pair.points_m):
        squared, error = pair.speed_squared[i][order], 1.96 * pair.speed_squared_sd[i][order]
        line = pair.slopes[i] * pair.pulling_mass_kg[order] + pair.intercepts[i]
        label, x = f"at {point:.3f} m", grams[order]
        traces.append(ev.Trace(x=x, y=squared, y_error=error, style="points", label=label, group=i))
        traces.append(ev.Trace(x=x, y=line, group=i))
    caption = "Speeds at two displacements, with straight lines (Eq 13)."
    panel = ev.Panel(x_label="pulling mass (g)", y_label="squared speed (m²/s²)", traces=traces)
    title = "Squared speed against pulling mass"
    return ev.Figure(id="speed-squared", title=title, caption=caption, panels=[panel])


def _methods(
    experiment: Experiment, result: output_error.FitResult, method: str, pair: TwoPointResult | None
) -> list[str]:
    count = len([t for t in result.trials if t.role == "fit"])
    sentences = [
        f"{', '.join(result.shared)} were estimated from {count} {experiment.name} trials ({result.samples} "
        "samples) by output-error maximum likelihood with a single-degree-of-freedom rig model.",
        fit_common.COVARIANCE,
    ]
    if set(experiment.facts.get("encoder", {}).values()) - {"continuous"}:
        step = experiment.facts.get("resolution_m")
        size = f" of {numbers.number(1e3 * step, 3)} mm" if step else ""
        sentences.append(
            f"The displacement came from an encoder with steps{size}; its quantisation is part of the noise "
            "model."
        )
    if method == "two-point" and pair is not None:
        points = " and ".join(f"{point:.3f} m" for point in pair.points_m)
        sentences.append(f"The two-point method (Eqs 13 to 19 of the boxfish paper) was used at {points}.")
    return sentences


# ---------------------------------------------------------------- method of the boxfish paper


#: What the method gives: 1, kg, N.
NAMES = ("drag_coefficient", "added_mass", "pulley_friction")


@dataclass(frozen=True)
class Drop:
    """One falling-weight trial for this method, since release and without missing samples."""

    pulling_mass_kg: float
    time_s: Array
    displacement_m: Array


@dataclass(frozen=True)
class TwoPointResult:
    """What the method gives.

    Attributes
    ----------
    values, stderr, bias : dict of name to float
        Of :data:`NAMES`; the standard error is of chance and bias together. The bias is what the method gives
        on perfect data of its own answer, minus that answer.
    points_m : tuple of float
        The two displacements.
    pulling_mass_kg : ndarray, shape (k,)
    speed_squared, speed_squared_sd : ndarray, shape (2, k), m2/s2
    slopes, intercepts : ndarray, shape (2,)
        Of squared speed against pulling mass: alpha and beta of Eq 13.
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
    def answers(self) -> bool:
        """Whether the speeds lie on rising lines, so that there are errors."""
        return all(map(math.isfinite, self.stderr.values()))


def speed_at(
    time_s: Array, displacement_m: Array, point_m: float, half_width_m: float
) -> tuple[float, float]:
    """Speed at a displacement by a straight-line fit around it, and its standard error.

    Raises
    ------
    NoTrustworthyResult
        When fewer than three samples lie around the point.
    """
    near = np.abs(displacement_m - point_m) <= half_width_m
    if near.sum() < 3:
        raise NoTrustworthyResult(
            f"only {int(near.sum())} samples lie within {half_width_m:.3g} m of the displacement "
            f"{point_m:.3g} m",
            hint="choose --points inside the measured displacement, or use the default method",
        )
    t, x = time_s[near], displacement_m[near]
    if len(t) > 4:
        # A quadratic keeps the curvature out of the error estimate; its slope at the middle is the line's.
        residual = x - np.polyval(np.polyfit(t - t.mean(), x, 2), t - t.mean())
        spread = math.sqrt(float(residual @ residual) / max(len(t) - 3, 1))
    else:
        spread = 0.0
    centred = t - t.mean()
    slope = float(centred @ x) / float(centred @ centred)
    return slope, spread / math.sqrt(float(centred @ centred))


def two_point(
    drops: Sequence[Drop],
    *,
    mass_kg: float,
    frontal_area_m2: float,
    density_kg_m3: float,
    gravity_m_s2: float,
    points_m: tuple[float, float] | None = None,
) -> TwoPointResult:
    """Drag coefficient, added mass and pulley friction from speeds at two displacements.

    Parameters
    ----------
    drops : sequence of Drop
        At least three different pulling masses.
    mass_kg : float
        Inertia of body and pulley.
    points_m : (x1, x2), optional
        Default a quarter and a half of the displacement all drops reached. The paper took
        0.293 and 0.584 m. Each speed is fitted over a stretch of a sixth of x1 to either side.

    Raises
    ------
    NoTrustworthyResult
        Too few drops, points outside the data, or speeds that fit no drag at all.
    """
    masses = np.array([d.pulling_mass_kg for d in drops])
    if len(np.unique(masses)) < 3:
        raise NoTrustworthyResult("the two-point method needs at least three different pulling masses")
    reach = min(float(d.displacement_m.max()) for d in drops)
    points = points_m or (0.255 * reach, 0.51 * reach)
    if not 0 < points[0] < points[1]:
        raise NoTrustworthyResult(f"the two displacements must rise from zero: {points[0]:g} {points[1]:g}")
    width = points[0] / 6

    def speeds(displacements: Sequence[Array]) -> tuple[Array, Array]:
        """Speed at the points and its standard error, each shape (2, k)."""
        pairs = list(zip(drops, displacements, strict=True))
        fits = np.array([[speed_at(d.time_s, x, point, width) for d, x in pairs] for point in points])
        return fits[:, :, 0], fits[:, :, 1]

    def solve(squared: Array) -> tuple[Array, Array, Array]:
        slopes, intercepts = np.array([np.polyfit(masses, v, 1) for v in squared]).T
        a1 = _a1(slopes[0] / slopes[1], points)
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

    # from the scatter of the squared speeds about their lines
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

    def named(values: Array) -> dict[str, float]:
        return dict(zip(NAMES, map(float, values), strict=True))

    return TwoPointResult(
        values=named(answer),
        stderr=named(np.sqrt(np.sqrt(variance) ** 2 + bias**2)),
        bias=named(bias),
        points_m=(float(points[0]), float(points[1])),
        pulling_mass_kg=masses,
        speed_squared=squared,
        speed_squared_sd=squared_sd,
        slopes=slopes,
        intercepts=intercepts,
    )


def _a1(ratio: float, points: tuple[float, float]) -> float:
    """Solve Eq 18 for a1; Eq 19 where the second displacement is twice the first."""
    x1, x2 = points
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
