"""``fit-drag``: drag, added mass and friction from a rig."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from swimid.errors import NoTrustworthyResult
from swimid.files import provenance
from swimid.fitting import fit_common, output_error
from swimid.fitting.experiment import Experiment
from swimid.fitting.fit_result import FitResult
from swimid.fitting.model import Parameter, chosen
from swimid.fitting.multistart import agreeing, multistart
from swimid.fitting.restarts import profile_interval
from swimid.logs.trials import TrialSet
from swimid.notices import recorded, warn
from swimid.options import takes
from swimid.progress import Progress, silent
from swimid.results import blocks, numbers
from swimid.results import evidence as ev
from swimid.results.fitted import Fitted
from swimid.results.parameters import Estimate, Fit, ParameterFile
from swimid.rig import derived as fit_drag_derived
from swimid.rig import theory, two_point
from swimid.rig import trials as rig_experiment
from swimid.rig.force import force_checks
from swimid.rig.omitted import compute_evidence, omission_checks, omitted_parameters
from swimid.rig.options import FitDragOptions
from swimid.rig.trial_effects import FRICTION, STARTS, Explained, explained, misfit, odd_check, odd_one

#: Number of searches, the first from the parameters' own start values.
SEARCHES = 4


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
        derived = {**best.derived, **fit_drag_derived.derived(experiment, result)}
        file = fit_common.parameter_file(
            result,
            robot=experiment.robot.name,
            provenance=origin,
            profiles=profiles,
            derived=derived,
            settings=best.facts,
        )
        checks = [
            *fit_common.checks(result, file),
            *fit_drag_derived.possible(experiment, result),
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
        tables=_tables(experiment, file, pair, result),
        figures=fit_common.figures(result) + _speed_figure(pair),
        notices=blocks.notices(notices),
        methods=_methods(experiment, result, options.method, pair),
        references=list(experiment.robot.sources),
        provenance=origin,
    )
    return Fitted.of(file, evidence).saved(output)


# ------------------------------------------------------------ fitting


def _best_fit(
    experiment: Experiment, choices: tuple[Parameter, ...], start_state: str, progress: Progress
) -> Explained:
    """The fit under the reading of the logs the data prefer, and what was chosen."""
    model = experiment.model
    if start_state == "estimate":
        choices = chosen(choices, freed=("start_offset", "initial_speed"))
    if any(p.name == "stiffness" and not p.free and p.start == 0.0 for p in choices):
        # without a spring the search for gravity begins at the stiffness that the period suggests
        begun = [
            replace(p, start=p.scale) if p.name == "gravity_stiffness" and p.free else p for p in choices
        ]
        choices = tuple(begun)
    # a friction of each trial is a random effect, never a free number
    friction = any(p.name == FRICTION and p.free for p in choices)
    choices = tuple(replace(p, free=False) if p.name == FRICTION else p for p in choices)
    readings = experiment.variants or {"": experiment.trials}
    fits = {
        name: output_error.fit(model, trials, parameters=choices, progress=progress)
        for name, trials in readings.items()
    }
    name = min(fits, key=lambda key: misfit(fits[key]))
    plain, starts = _from_starts(fits[name], progress)
    best, odd = Explained(plain), odd_one(plain)
    masses = experiment.facts.get("pulling_mass_kg", {})
    told = False
    if experiment.name == "falling-weight":
        free_start = any(p.free for p in choices if p.name in STARTS)
        if friction or (start_state == "auto" and not free_start):
            best = explained(plain, choices, masses, odd, insist=friction)
            told = True
    if not told:
        best = replace(best, checks=omission_checks(plain, omitted_parameters(plain)))
    forces = force_checks(best.result) if experiment.name == "towed" else []
    result = output_error.with_held_out(best.result)
    checks = [*starts, *best.checks, *forces, *([odd_check(result, odd, masses)] if odd else [])]
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
        starts=SEARCHES,
        begins=[first.estimate],
        progress=progress,
    )
    gain = compute_evidence(first, best)
    if gain > output_error.ANOTHER:
        change = 100 * (1 - best.cost / first.cost)
        warn(
            "SWM073",
            "the search from the start values ended in a poorer minimum: another start lowered the mean "
            f"squared residual by {change:.3g} %, and its answer is reported",
        )
    agree = agreeing(ends)
    value = f"{agree} of {len(ends)} starts end in it"
    return best, [
        blocks.check("one minimum", value, "two at least", agree > 1, text="the lowest is reported")
    ]


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


def _two_point(experiment: Experiment, points_m: tuple[float, float] | None) -> two_point.TwoPointResult:
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
        two_point.Drop(
            t.rig.pull / fluid.gravity_m_s2, t.time_s - t.rig.begin_s, t.measured["x_m"] - t.rig.x0
        )
        for t in pulled
    ]
    return two_point.two_point(
        drops,
        mass_kg=body.inertial_mass_kg + experiment.robot.rig.pulley_inertia_kg,
        frontal_area_m2=body.frontal_area_m2,
        density_kg_m3=fluid.density_kg_m3,
        gravity_m_s2=fluid.gravity_m_s2,
        points_m=points_m,
    )


def _two_point_file(file: ParameterFile, pair: two_point.TwoPointResult) -> ParameterFile:
    """The parameter file with the two-point method's values in place of the fit's.

    Raises
    ------
    NoTrustworthyResult
        When the method gives no errors: its points do not lie on lines, or not on rising ones.
    """
    if not pair.answers:
        raise NoTrustworthyResult(
            "the two-point method has no answer: its speeds do not rise with the pulling mass as Eq 13 says",
            hint="look at the pulling masses, or use --method ml",
        )
    parameters = {
        name: Estimate(
            value=value,
            stderr=pair.stderr[name],
            unit=file.parameters[name].unit,
            bounds=file.parameters[name].bounds,
            status="estimated",
        )
        for name, value in pair.values.items()
    }
    assert file.fit is not None
    fit = Fit(trials=file.fit.trials, converged=True, method="two-point", points_m=list(pair.points_m))  # type: ignore[call-arg]
    return file.model_copy(
        update={"parameters": parameters, "correlation": None, "identifiability": [], "fit": fit}
    )


# ------------------------------------------------------------ words and pictures


def _tables(
    experiment: Experiment,
    file: ParameterFile,
    pair: two_point.TwoPointResult | None,
    result: output_error.FitResult,
) -> list[ev.Table]:
    rows: list[dict[str, blocks.Cell]] = []
    estimates = theory.estimates(experiment.robot)
    fitted = fit_common.estimates(result, {})
    for name in dict.fromkeys([*two_point.NAMES, *(t.parameter for t in estimates)]):
        if name not in fitted:
            continue
        e, two, bias = fitted[name], "", ""
        if pair is not None and name in pair.values:
            two = numbers.measured(pair.values[name], pair.stderr[name], e.unit)
            bias = numbers.number(pair.bias[name], 2, e.unit)
        known = numbers.measured(e.value, e.stderr, e.unit)
        by_theory = [
            f"{numbers.number(t.value, 3, t.unit)} ({t.basis})" for t in estimates if t.parameter == name
        ]
        rows.append(
            {
                "parameter": name,
                "maximum likelihood": "not identifiable" if e.status == "unidentifiable" else known,
                "two-point": two,
                "two-point bias": bias,
                "theory": "; ".join(by_theory),
            }
        )
    if not rows:
        return []
    caption = (
        "The two-point method takes the moving mass as equal for all pulling weights; its bias is what it "
        "gives on perfect data computed at its own answer, and is part of its stated error."
    )
    return [blocks.table("methods", "Both methods and theory side by side", rows, caption)]


def _speed_figure(pair: two_point.TwoPointResult | None) -> list[ev.Figure]:
    if pair is None:
        return []
    grams = 1e3 * pair.pulling_mass_kg
    order = np.argsort(grams)
    traces = []
    for i, point in enumerate(pair.points_m):
        x, squared, error = grams[order], pair.speed_squared[i][order], 1.96 * pair.speed_squared_sd[i][order]
        line = pair.slopes[i] * pair.pulling_mass_kg[order] + pair.intercepts[i]
        label = f"at {point:.3f} m"
        traces.append(ev.Trace(x=x, y=squared, y_error=error, style="points", label=label, group=i))
        traces.append(ev.Trace(x=x, y=line, group=i))
    return [
        blocks.figure(
            "speed-squared",
            "Squared speed against pulling mass",
            "Speeds read off at two displacements, with straight lines (Eq 13). Where the points do not lie "
            "on lines, the friction or the drag changes with speed.",
            "pulling mass (g)",
            "squared speed (m²/s²)",
            traces,
        )
    ]


def _methods(
    experiment: Experiment, result: output_error.FitResult, method: str, pair: two_point.TwoPointResult | None
) -> list[str]:
    count = len([t for t in result.trials if t.role == "fit"])
    names = [label for label in result.labels if "[" not in label]
    sentences = [
        f"{', '.join(names)} were estimated from {count} {experiment.name} trials ({result.samples} samples) "
        "by output-error maximum likelihood with a single-degree-of-freedom rig model.",
        "Standard errors follow from the Jacobian at the optimum with the residuals' autocorrelation "
        "accounted for.",
    ]
    if set(experiment.facts.get("encoder", {}).values()) - {"continuous"}:
        step = experiment.facts.get("resolution_m")
        size = f" of {numbers.number(1e3 * step, 3)} mm" if step else ""
        sentences.append(
            f"The displacement came from an encoder with steps{size}; its quantisation is part of the noise "
            "model."
        )
    if method == "two-point" and pair is not None:
        sentences.append(
            f"The two-point method (Eqs 13 to 19 of the source) was used at {pair.points_m[0]:.3f} and "
            f"{pair.points_m[1]:.3f} m."
        )
    return sentences
