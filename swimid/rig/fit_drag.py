"""Command ``fit-drag``: drag, added mass and friction of a body on a rig, with checks of the estimates.

The checks look for omitted parameters, trials that do not start at rest, an outlier trial, a measured force
of the wrong sign, and estimates that no body can have. Added mass, drag and driving force are compared with
the largest values that any body of the known size can have, from theory and tables. Terminal speed, period
and damping ratios are derived with their standard errors.

The reference fit (``stated``) estimates the parameters that the user chose, and holds the others fixed. It
is compared with alternative fits, called rivals (:mod:`swimid.fitting.rivals`). A rival frees a parameter
that the reference fit holds for all trials, or estimates it in place of parameters with a similar effect
(:data:`swimid.rig.model.SIMILAR_PARAMETERS`), such as dry friction in place of linear damping. Further rivals
have another initial state or pulley friction in each trial, one trial with parameters of its own, or another
sign of the force.

The two-point method of the boxfish paper (Chan et al., see :func:`fit_drag`) uses speeds at two displacements
(Eqs 13-19). At a fixed displacement the squared speed is a linear function of the pulling mass. The slopes at
two displacements give ``a1`` (Eq 18), and hence the drag coefficient and the added mass. Slope and intercept
give the pulley friction (Eq 17). The method assumes the same moving mass for all pulling weights. The bias is
the error of the method on noise-free data that are simulated with its own estimates. The reported standard
error includes the bias. The output-error fit does not assume an equal moving mass.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy import optimize

from swimid.errors import NoTrustworthyResult
from swimid.files import provenance
from swimid.fitting import fit_common, output_error, rivals
from swimid.fitting.fit_common import Experiment
from swimid.fitting.model import Array, Model, Parameter, Trial, choose_parameters
from swimid.fitting.output_error import FitResult
from swimid.fitting.rivals import Judged, Rival
from swimid.fitting.uncertainty import UNIDENTIFIABLE
from swimid.logs.trials import TrialSet
from swimid.notices import Progress, record_warnings, silent, warn
from swimid.options import takes
from swimid.results import evidence as ev
from swimid.results import numbers
from swimid.results.parameters import Estimate, Fit, Fitted, ParameterFile
from swimid.rig.model import (
    COORDINATES,
    SIMILAR_PARAMETERS,
    compute_terminal_speed,
    falling_weight_closed_form,
)
from swimid.rig.options import FitDragOptions
from swimid.robots.file import Body, Robot, Theory

#: Minimum relative change of an estimate at which an omitted parameter makes a result bad. Drag and added
#: mass are proportional to the stated force, mass or density. No fit can check these values, which are rarely
#: known to better than 1 % (the density of water alone differs by 0.4 % between 5 and 30 °C). In simulated
#: tows without an omission the estimates change by at most 0.4 %, and by 3 % or more if an effect is omitted.
MATERIAL_SHARE = 0.01
#: Parameters of the force sensor, not of the body. The estimate of one changes if the other is estimated too.
OF_SENSOR = ("force_offset", "force_drift")
#: Maximum number of omitted parameters that one warning names.
MAX_OMITTED = 3
#: Per-trial parameters of the start of a trial, each with the words for a warning on how the trials start.
STARTS = {"initial_speed": "in motion", "clock_offset": "at another time than their first sample"}
#: Name of the per-trial parameter with which each trial has a pulley friction of its own.
OWN_FRICTION = "friction_deviation"
#: Reason that messages give if the two-point method has no result.
NO_ANSWER = "the speeds do not rise with the pulling mass as Eq 13 requires"
#: Names of the parameters that the two-point method estimates. The units of the estimates are 1, kg and N.
NAMES = ("drag_coefficient", "added_mass", "pulley_friction")
#: Default displacements of the two-point method, as fractions of the largest displacement that every drop
#: reached.
POINT_SHARES = (0.255, 0.51)
#: Half-width of the displacement interval over which the two-point method fits a speed, as a fraction of the
#: smaller of its two displacements.
HALF_WIDTH = 1 / 6
#: Minimum number of samples around each of the two displacements of the two-point method, and number of such
#: samples above which the noise of the samples is estimated.
MIN_SAMPLES_POINT, MIN_SCATTER_SAMPLES = 3, 4
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
        and ``pulley_friction`` (N). A free decay also has ``linear_drag`` (N s/m) and ``stiffness`` (N/m). A
        rotation has ``quadratic_damping``, ``linear_damping`` and ``added_inertia``. ``.verdict`` and
        ``.checks()`` assess the estimates.

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
    >>> drag["added_mass"].unit, drag.has_converged, drag.verdict
    ('kg', True, 'good')
    """
    with record_warnings(repeat=True) as notices:
        coordinate = options.coordinate
        experiment = fit_common.load_experiment(trials, command="fit-drag", coordinate=coordinate)
        if coordinate is not None and experiment.name != "free-decay":
            warn("SWM004", "--coordinate has no effect: it is used only in a free-decay experiment")
        choices = fit_common.prepare_fit(
            experiment, output, fixed=options.fixed, freed=options.freed, bounds=options.bounds
        )
        result, facts, checks = _fit_best(experiment, choices, options.start_state, progress)
        pair = _try_two_point(experiment, options)
        origin = provenance.collect(experiment.inputs, settings=options.settings())
        file = fit_common.parameter_file(
            result,
            robot=experiment.robot.name,
            provenance=origin,
            derived=derive(experiment, result),
            settings=facts,
        )
        checks = [
            *fit_common.assess(result),
            *possible_checks(experiment, result),
            *checks,
        ]
    hint = "use longer runs, more different forces, or fix known parameters with --fix"
    fit_common.insist_identified(result, hint)
    law = "a single-degree-of-freedom rig model"
    said = fit_common.describe_method(result, f"{experiment.name} trials", law)
    shown: dict[str, Any] = {
        "title": f"Rig identification of {experiment.robot.name}: {experiment.name}",
        "tables": [_methods_table(experiment, result, pair)],
        "figures": fit_common.figures(result),
        "methods": [said, fit_common.COVARIANCE],
        "references": list(experiment.robot.sources),
    }
    if pair is not None:
        shown["figures"].append(_speed_figure(pair))
        shown["notes"] = [pair.text]
        if options.method == "two-point":
            file = _two_point_file(file, pair)
            points = " and ".join(f"{point:.3f} m" for point in pair.points_m)
            said = f"The two-point method (Eqs 13 to 19 of the boxfish paper) was used at {points}."
            shown["methods"].append(said)
    return fit_common.finish("fit-drag", file, checks, notices, output, **shown)


def _try_two_point(experiment: Experiment, options: FitDragOptions) -> TwoPointResult | None:
    """Return the result of the two-point method; None if the method fails and the user did not choose it."""
    try:
        return two_point(experiment.trials, experiment.robot, options.points_m)
    except NoTrustworthyResult:
        if options.method == "two-point":
            raise
        return None


# ------------------------------------------------------------ maximum likelihood


def _fit_best(
    experiment: Experiment, choices: tuple[Parameter, ...], start_state: str, progress: Progress
) -> tuple[FitResult, dict[str, str], list[ev.Check]]:
    """Return the fit of a rig experiment with the smallest residuals, its settings and its checks.

    The compared fits differ in the rounding of encoder counts (down, to the nearest, up) and in the initial
    states of the trials.
    """
    if start_state == "estimate":
        choices = choose_parameters(choices, freed=("start_offset", "initial_speed"))
    known = {p.name: p.start for p in choices if not p.free}
    if known.get("stiffness") == 0.0:
        # Without a spring, start the search at the gravity stiffness that follows from the period of the
        # decay. This value is the typical scale of the parameter.
        swings = ("gravity_stiffness",)
        choices = tuple(replace(p, start=p.scale) if p.name in swings and p.free else p for p in choices)
    name, plain = _fit_readings(experiment, choices, progress)
    facts = {"encoder_rounding": name} if name else {}
    best = plain
    starts: tuple[str, ...] = ()
    if experiment.name == "falling-weight" and start_state == "auto" and known.keys() >= STARTS.keys():
        starts, facts["start_state"] = tuple(STARTS), "rest"
    judged = rivals.judge(plain, name_rivals(plain, starts))
    if judged and judged[0].is_better and judged[0].rival.name in starts:
        best, facts["start_state"] = judged[0].fit, judged[0].rival.name
        _warn_of_start(best, facts["start_state"])
        # Judge the other alternative fits again, because separate initial states may explain residuals that
        # another alternative seemed to explain.
        judged = rivals.judge(best, name_rivals(best))
    result = output_error.complete_fit(best)
    checks = [omission_check(result, find_omitted(best, judged))]
    if experiment.name == "towed":
        checks.append(sign_check(best))
    return result, facts, checks + trial_checks(best, result, judged)


def _fit_readings(
    experiment: Experiment, choices: tuple[Parameter, ...], progress: Progress
) -> tuple[str, FitResult]:
    """Return the rounding of encoder counts with the smallest residuals, and the fit with this rounding."""
    fits = {
        name: output_error.fit_output_error(experiment.model, trials, parameters=choices, progress=progress)
        for name, trials in (experiment.variants or {"": experiment.trials}).items()
    }
    name = first = next(iter(fits))
    if len(fits) > 1:
        name = min(fits, key=lambda key: rivals.compute_deviance(fits[first], [fits[key]]))
    return name, fits[name]


def _methods_table(experiment: Experiment, result: FitResult, pair: TwoPointResult | None) -> ev.Table:
    """Return a table of the maximum-likelihood and two-point estimates together with values from theory."""
    theory = theory_estimates(experiment.robot)
    fitted = fit_common.estimates(result)
    rows: list[list[Any]] = []
    for name in dict.fromkeys([*NAMES, *(t.parameter for t in theory)]):
        if name not in fitted:
            continue
        e, two, bias = fitted[name], "", ""
        if pair is not None and name in pair.values:
            two = numbers.format_estimate(pair.values[name], pair.stderr[name], e.unit)
            bias = numbers.format_number(pair.bias[name], 2, e.unit)
        known = "not identifiable"
        if e.status != "unidentifiable":
            known = numbers.format_estimate(e.value, e.stderr, e.unit)
        quoted = [
            f"{numbers.format_number(t.value, 3, t.unit)} ({t.basis})" for t in theory if t.parameter == name
        ]
        rows.append([name, known, two, bias, "; ".join(quoted)])
    return ev.Table(
        id="methods",
        title="Both methods and theory side by side",
        columns=["parameter", "maximum likelihood", "two-point", "two-point bias", "theory"],
        rows=rows,
        caption="The two-point method assumes an equal moving mass for all pulling weights. Its bias is its "
        "error on noise-free data of its own answer, and is part of its stated error.",
    )


# ------------------------------------------------------------ rivals


def name_rivals(stated: FitResult, starts: Sequence[str] = ()) -> list[Rival]:
    """Return the alternative fits (rivals) with which a fit of all trials is compared.

    In one alternative, a held parameter that all trials share is freed. In another, this parameter replaces
    the parameters with a similar effect. For a pulley, each trial may also have a friction of its own.

    Parameters
    ----------
    starts : sequence of str
        Per-trial parameters of the start of a trial that are also freed.
    """
    held = [p for p in stated.parameters if not p.free and not p.per_trial]
    found = [rivals.free(stated, name) for name in (*starts, *(p.name for p in held))]
    found += [rival for p in held if (rival := _name_replacement(stated, p)) is not None]
    if "pulley_friction" in stated.labels:
        fixed = {"pulley_friction": stated.value("pulley_friction")}
        found.append(
            Rival(
                OWN_FRICTION,
                choose_parameters(stated.parameters, fixed=fixed, freed=(OWN_FRICTION,)),
                stated.trials,
            )
        )
    return found


def _name_replacement(stated: FitResult, held: Parameter) -> Rival | None:
    """Return the alternative fit in which a held parameter replaces the parameters with a similar effect.

    Return None if there is no parameter to replace, or if the parameter is held only because the user chose
    to hold it.
    """
    alike = next((names for names in SIMILAR_PARAMETERS if held.name in names), ())
    acting = [p for p in stated.parameters if p.free or p.start != 0.0]
    others = [p for p in acting if p.name in alike and p is not held]
    can_vanish = all(p.lower <= 0.0 <= p.upper for p in others)
    is_absent = held.start == 0.0 and is_held_by_default(stated.model, held.name)
    if not (others and can_vanish and is_absent):
        return None
    fixed = dict.fromkeys([p.name for p in others], 0.0)
    parameters = choose_parameters(stated.parameters, fixed=fixed, freed=(held.name,))
    if not any(p.free for p in others):
        whole = {held.name: sum(p.start for p in others)}
        parameters = choose_parameters(stated.parameters, fixed=fixed | whole)
    return Rival(held.name, parameters, stated.trials, tuple(fixed))


def is_held_by_default(model: Model, name: str) -> bool:
    """Return whether a model holds a parameter unless the user frees it."""
    return any(p.name == name and not p.free for p in model.parameters)


def find_omitted(stated: FitResult, judged: Sequence[Judged]) -> list[Judged]:
    """Return the alternative fits whose additional parameter the data support, with intervals, best first.

    A freed parameter must improve the fit, and its interval must exclude the value at which it was held. A
    fit with a parameter that replaces others must be as good as the fit ``stated``, and move one of its
    estimates out of its 95 % interval.
    """
    found = []
    for one in judged:
        name, replaced = one.rival.name, one.rival.replaced
        held = next(p for p in stated.parameters if p.name == name)
        if held.per_trial or one.fit.status.get(name, "fixed") not in ("estimated", "fixed"):
            continue
        if replaced and one.score > -rivals.STRONG and find_moved(stated, one.fit):
            found.append(replace(one, fit=output_error.with_intervals(one.fit)))
        elif one.is_better and not replaced:
            fit = output_error.with_intervals(one.fit)
            if abs(fit.value(name) - held.start) > 1.96 * (fit.stderr(name) or math.inf):
                found.append(replace(one, fit=fit))
    return found


def _describe(omitted: Judged) -> str:
    """Return name, estimate and standard error of an omitted parameter as text."""
    place = ""
    if omitted.rival.replaced:
        place = f" in the place of {', '.join(omitted.rival.replaced)}"
    return _format_estimate(omitted.fit, omitted.rival.name) + place


def _suggest(stated: FitResult, omitted: Judged) -> str:
    """Return a sentence on the effect of an omitted parameter, with the options that include it in a fit."""
    name = omitted.rival.name
    held = "".join(f" --fix {other}=0" for other in omitted.rival.replaced)
    acting = next(p for p in omitted.fit.parameters if p.name == name)
    choice = f"--free {name}"
    if not acting.free:
        choice = f"--fix {name}={acting.start:g}"
    change = numbers.percent(omitted.fit.cost / max(stated.cost, 1e-300) - 1.0, 2)
    left_out = f"the fit leaves out {_describe(omitted)}"
    return f"{left_out}, which changes the squared residuals by {change}: use {choice}{held}"


def find_moved(stated: FitResult, other: FitResult) -> list[str]:
    """Return the shared parameters whose 95 % interval in the fit ``stated`` excludes the other estimate."""
    found = []
    for label in [one for one in stated.common_labels if stated.status[one] != "unidentifiable"]:
        error = stated.stderr(label)
        if error is None or abs(other.value(label) - stated.value(label)) > 1.96 * error:
            found.append(label)
    return found


def find_material(stated: FitResult, other: FitResult) -> list[str]:
    """Return the coefficients of the body that differ materially between the fit ``stated`` and another fit.

    A material difference is larger than 1.96 times its standard error, computed as for independent estimates,
    and larger than :data:`MATERIAL_SHARE`. A coefficient that is fixed in the other fit has zero error there.
    """

    def is_material(label: str) -> bool:
        error = math.hypot(stated.stderr(label) or 0.0, other.stderr(label) or 0.0)
        limit = max(1.96 * error, MATERIAL_SHARE * abs(stated.value(label)))
        return label not in OF_SENSOR and abs(other.value(label) - stated.value(label)) > limit

    return [*filter(is_material, find_moved(stated, other))]


def explains_differences(stated: FitResult, other: FitResult) -> bool:
    """Return whether a further parameter explains why the trials of the fit ``stated`` differ.

    A further parameter usually increases the standard errors of the estimates. It decreases them only if they
    included differences between trials that the parameter explains.
    """
    if stated.differences is None or not stated.differences.are_likely:
        return False
    pairs = [(stated.stderr(label), other.stderr(label)) for label in stated.common_labels]
    return all(after is not None and (before is None or after < before) for before, after in pairs)


def omission_check(stated: FitResult, omitted: Sequence[Judged]) -> ev.Check:
    """Check that the fit ``stated`` omits no parameter that the data support, and warn if it omits any.

    The check fails if an omitted parameter improves the fit and also either moves estimates materially
    (:func:`find_material`) or explains differences between trials.
    """
    name = "no parameter left out"
    limit = f"score ≤ {rivals.STRONG:g}, and no other law explains as much"
    if not omitted:
        held = ", ".join(p.name for p in stated.parameters if not p.free and not p.per_trial)
        return ev.make_check(name, "none", True, limit, f"tested, each in a separate fit: {held or 'none'}")
    failed = [
        o
        for o in omitted
        if o.is_better and (find_material(stated, o.fit) or explains_differences(stated, o.fit))
    ]
    best = [*failed, *omitted][0]
    first = sorted(omitted, key=lambda o: o is not best)[:MAX_OMITTED]
    warn("SWM024", "; ".join(_suggest(stated, o) for o in first))
    shifts = [
        f"{_format_estimate(stated, one)} becomes {_format_estimate(best.fit, one)}"
        for one in stated.common_labels
    ]
    reason = f"the fit leaves out {_describe(best)}"
    if explains_differences(stated, best.fit):
        reason += ", which explains why the trials differ"
    elif not find_material(stated, best.fit):
        reason += ", which changes no estimate materially"
    text = f"score {best.score:.3g}; with this parameter " + "; ".join(shifts)
    check = ev.make_check(name, _describe(best), False, limit, text, reason=reason)
    if failed:
        check.verdict = "fail"
    return check


# ------------------------------------------------------------ differences between trials


def _warn_of_start(fit: FitResult, name: str) -> None:
    """Warn that the trials do not start at rest, and state the estimates of the start parameter ``name``."""
    values = ", ".join(
        f"{label[len(name) + 1 : -1]} {value:+.3g}"
        for label, value in zip(fit.labels, fit.estimate, strict=True)
        if label.startswith(f"{name}[")
    )
    warn(
        "SWM017",
        f"the trials start {STARTS[name]}; {name} is estimated for each trial ({values} "
        f"{fit.parameter(name).unit}). Use --start-state rest to hold the trials at rest at the first sample",
    )


def trial_checks(stated: FitResult, result: FitResult, judged: Sequence[Judged]) -> list[ev.Check]:
    """Check whether the pulley friction depends on the pulling mass, and whether one trial is an outlier.

    Parameters
    ----------
    stated, result : FitResult
        The same fit without and with intervals of its estimates.
    judged : sequence of Judged
        Alternative fits. A fit in which one trial is an outlier must be better than each of them.
    """
    found = []
    own = next((one for one in judged if one.rival.name == OWN_FRICTION and one.is_better), None)
    if own is not None:
        found = _friction_check(own.fit)
    coloured = any(len(noise.autoregression) for noise in stated.noise.values())
    if not coloured and own is None:
        return found
    odd = rivals.find_odd_trial(stated)
    shared = [one for one in judged if one.rival.name != OWN_FRICTION]
    if odd is None or any(one.score > odd.score for one in shared):
        return found
    name = odd.rival.name
    without = "; ".join(_format_estimate(odd.fit, label) for label in odd.fit.common_labels)
    text = (
        f"without this trial: {without}. Check the entry of the trial in the trials file (pulling mass, "
        "force, unit), or leave the trial out of the fit with role: validate"
    )
    size, limit = f"{name}: score {odd.score:.3g}", f"score ≤ {rivals.STRONG:g}"
    reason = f"{name} contradicts the other trials"
    check = ("SWM071", "no trial contradicts the others", size, False, limit, text, reason)
    return [*found, fit_common.warn_check(*check, failed=bool(find_moved(result, odd.fit)))]


def _format_estimate(fit: FitResult, label: str) -> str:
    """Return the name, the estimate and the standard error of a fitted parameter as text."""
    return (
        f"{label} {numbers.format_estimate(fit.value(label), fit.stderr(label), fit.parameter(label).unit)}"
    )


def _friction_check(own: FitResult) -> list[ev.Check]:
    """Check whether pulley friction depends on the pulling force, from a fit with a friction per trial."""
    pulls = {f"{OWN_FRICTION}[{t.id}]": t.rig.pull for t in own.trials}
    index = [j for j, label in enumerate(own.labels) if label in pulls and own.stderr(label)]
    if len(index) < rivals.MIN_TRIALS_RIVAL:
        return []
    pull = np.array([pulls[own.labels[j]] for j in index])
    score = rivals.compute_trend_score(own.estimate[index], own.covariance[np.ix_(index, index)], pull)
    if score <= rivals.STRONG:
        return []
    value = f"follows the pulling mass (score {score:.3g})"
    text = "find the cause with swimid diagnose TRIALS --params FILE"
    shown = ("same friction in all trials", value, False, f"score ≤ {rivals.STRONG:g}", text)
    return [fit_common.warn_check("SWM070", *shown, f"the pulley friction {value}", failed=True)]


# ------------------------------------------------------------ measured force


def sign_check(result: FitResult) -> ev.Check:
    """Check the sign of the measured force of a towed body.

    The check fails if the model fits trials better with the sign of the force changed.
    """
    name, limit = "sign of force_N", "no trial agrees better with -force_N"
    fitted = [t for t in result.trials if t.role == "fit"]
    channel = next(s.channel for s in result.series if s.role == "fit")
    # Simulate with the start values of the parameters. Estimates from a force of the wrong sign are not
    # suitable, because they make the body so heavy that no force moves it.
    start = np.array([p.start for p in result.model.parameters])

    def mean_square(trial: Trial) -> float:
        simulated = result.model.run(start, trial)[channel]
        return float(np.nanmean((trial.measured[channel] - simulated) ** 2))

    turned = {}
    for trial in fitted:
        other = replace(trial, inputs={**trial.inputs, "force_N": -trial.inputs["force_N"]})
        if channel in trial.measured and mean_square(other) < mean_square(trial):
            turned[trial.id] = other
    trials = tuple(turned.get(t.id, t) for t in result.trials)
    judged = [Rival("sign of the force", result.parameters, trials)] if turned else []
    found = next((one for one in rivals.judge(result, judged) if one.is_better), None)
    if found is None:
        return ev.make_check(name, "as stated", True, limit)
    where = ", ".join(sorted(turned))
    if len(turned) == len(fitted):
        where = "all trials"
    change = math.sqrt(found.fit.cost / result.cost) - 1.0
    reason = (
        f"force_N has the wrong sign in {where}: multiplied by -1, force_N lowers the error of {channel} by "
        f"{-100 * change:.3g} %"
    )
    text = (
        "force_N must be the force on the body, positive along x_m: change its sign in the log, or with "
        "factor: -1 in the mapping of an import"
    )
    check = ("SWM110", name, f"wrong in {where}", False, limit, text, reason)
    return fit_common.warn_check(*check, failed=True)


# ------------------------------------------------------------ derived quantities


#: Added-mass coefficients of square prisms that move along their length (DNV-RP-C205, appendix D). Each row
#: has the ratio of length to side, and the added mass divided by the mass of the displaced water.
PRISM = np.array(
    [[1.0, 0.68], [2.0, 0.36], [3.0, 0.24], [4.0, 0.19], [5.0, 0.15], [6.0, 0.13], [7.0, 0.11], [10.0, 0.08]]
)
#: Maximum length that a body can have, in diameters of a circle with the frontal area of the body.
MAX_SLENDERNESS = 10.0
#: Minimum and maximum density of water (fresh to salt, kg/m3), and kinematic viscosity of water at 20 degrees
#: Celsius (m2/s).
WATER_KG_M3, WATER_VISCOSITY_M2_S = (950.0, 1050.0), 1.0e-6
#: Step of the finite differences of the delta method, in standard errors of the parameter.
DELTA_STEP = 1e-4
#: Type of a function that computes a quantity, such as the terminal speed, from the coefficients of the
#: equation of motion. The value of the function is NaN if the quantity does not exist.
Quantity = Callable[[Mapping[str, float]], float]


def derive(experiment: Experiment, result: FitResult) -> dict[str, Estimate]:
    """Return the quantities that follow from the estimates of a rig experiment.

    A falling-weight experiment has the terminal speed of each trial. A free decay has the natural period, the
    amplitude of the largest first swing, and two damping ratios. One ratio includes all damping at this
    amplitude. The other ratio includes linear damping only, and is the limit for small swings.
    """
    first = result.trials[0]
    quantities: dict[str, Estimate | None] = {}
    if experiment.name == "falling-weight":
        for trial in result.trials:
            terminal = partial(compute_terminal_speed, force=trial.rig.pull)
            quantities[f"terminal_speed[{trial.id}]"] = propagate(result, trial, terminal, "m/s")
    if experiment.name == "free-decay":
        amplitude = max(_first_amplitude(result, t) for t in result.trials)
        unit = COORDINATES[result.model.channels[0].name][0]
        ratio = partial(_damping_ratio, amplitude=amplitude)
        quantities["natural_period_s"] = propagate(result, first, lambda c: 2 * math.pi / _rate(c), "s")
        quantities["damping_ratio_linear"] = propagate(result, first, _damping_ratio, "1")
        quantities["first_swing"] = Estimate(value=amplitude, unit=unit, status="fixed")
        quantities["damping_ratio_first_swing"] = propagate(result, first, ratio, "1")
    return {name: e for name, e in quantities.items() if e is not None}


def propagate(result: FitResult, trial: Trial, quantity: Quantity, unit: str) -> Estimate | None:
    """Return the value of a derived quantity of a trial, and its standard error by the delta method.

    The quantity is a function of the coefficients of the equation of motion. Its status is ``fixed`` if it
    depends on no estimated parameter, and ``at-bound`` if it depends on a parameter at its bound. The status
    is ``unidentifiable`` if the standard error is above half the value. Return None if the quantity has no
    finite value.
    """

    def at(values: Array) -> float:
        return quantity(result.model.equation(values, trial))  # type: ignore[attr-defined]

    values = result.values(trial.id)
    centre = at(values)
    if not math.isfinite(centre):
        return None
    estimate = Estimate(value=centre, unit=unit, status="fixed")
    gradient = _differentiate(result, trial, at)
    unknown, bound = False, False
    for label in (result.labels[j] for j in np.flatnonzero(gradient)):
        parameter, held = result.parameter(label), result.status[label] == "at-bound"
        bound |= held
        # Ignore a parameter at its lower bound 0, which has no standard error. The standard errors of the
        # other parameters include the effect of its uncertainty.
        vanishes = held and parameter.lower == 0.0 >= values[result.model.index(parameter.name)]
        unknown |= result.stderr(label) is None and not vanishes
    known = np.isfinite(np.diag(result.covariance)) & (gradient != 0)
    variance = float(gradient[known] @ result.covariance[np.ix_(known, known)] @ gradient[known])
    if unknown or not (math.isfinite(variance) and variance >= 0):
        estimate.status = "unidentifiable"
    elif known.any():
        estimate.status, estimate.stderr = "estimated", math.sqrt(variance)
    if estimate.stderr is None and bound:
        estimate.status = "at-bound"
    elif unit != "1" and (estimate.stderr or 0.0) > UNIDENTIFIABLE * abs(centre):
        estimate.status = "unidentifiable"
    return estimate


def _differentiate(result: FitResult, trial: Trial, function: Callable[[Array], float]) -> Array:
    """Return the derivatives of a function with respect to the p unknowns of a fit, shape (p,)."""
    values, gradient = result.values(trial.id), np.zeros(len(result.labels))
    for j, label in enumerate(result.labels):
        parameter = result.parameter(label)
        if label not in (parameter.name, f"{parameter.name}[{trial.id}]"):
            continue
        k = result.model.index(parameter.name)
        moved, step = values.copy(), DELTA_STEP * (result.stderr(label) or parameter.scale)
        moved[k] += step
        if moved[k] > parameter.upper:
            moved[k] = values[k] - step
        gradient[j] = (function(moved) - function(values)) / (moved[k] - values[k])
    return gradient


def _rate(c: Mapping[str, float]) -> float:
    """Return the natural angular frequency of small swings, rad/s; NaN without a restoring force."""
    return math.sqrt(max(c["stiffness"] + c["gravity"], 0.0) / c["inertia"]) or math.nan


def _damping_ratio(c: Mapping[str, float], amplitude: float = 0.0) -> float:
    """Return the damping ratio of a free decay at a given amplitude, by equivalent linear damping.

    The equivalent linear damping dissipates the same energy in a swing as linear, quadratic and dry damping
    together (Chakrabarti, "Empirical calculation of roll damping for ships and barges", Ocean Engineering
    2001). At the amplitude 0 only linear damping is included.
    """
    whole, speed = c["linear"], _rate(c) * amplitude
    if speed > 0:
        whole += 8.0 / (3.0 * math.pi) * c["quadratic"] * speed + 4.0 / math.pi * c["dry"] / speed
    return whole / (2.0 * c["inertia"] * _rate(c))


def _first_amplitude(result: FitResult, trial: Trial) -> float:
    """Return the maximum displacement of a simulated free decay from its rest position, m or rad."""
    series = next(s for s in result.series if s.trial == trial.id)
    values = series.simulated[np.isfinite(series.simulated)]
    rest = result.values(trial.id)[result.model.index("rest_position")]
    return float(np.max(np.abs(values - rest), initial=0.0))


# ------------------------------------------------------------ possible bodies


def possible_checks(experiment: Experiment, result: FitResult) -> list[ev.Check]:
    """Check that estimated added mass and drag, swing angles and driving forces are physically possible.

    The limits are derived only from the mass, the frontal area and the size of the body. If a limit depended
    on the stated force, a wrong force could pass the check.
    """
    checks = []
    for name, most, basis, inputs in _limits(experiment, result):
        value, error, unit = result.value(name), result.stderr(name), result.parameter(name).unit
        size, limit = (
            numbers.format_estimate(value, error or None, unit),
            numbers.format_number(most, 2, unit),
        )
        words, text = (
            name.replace("_", " "),
            f"check {inputs}, their units, and effects that the model lacks",
        )
        reason = f"{words} {size} is physically impossible: {basis} has at most {limit}"
        check = ("SWM072", f"{words} possible", size, not value > most, f"≤ {limit}", text, reason)
        checks.append(fit_common.warn_check(*check, failed=value - 1.96 * (error or 0.0) > most))
    coordinate = result.model.channels[0].name
    if coordinate in ("roll_rad", "pitch_rad"):
        angles = {t.id: t.measured[coordinate] for t in experiment.trials}
        swings = {n: float(np.nanmax(np.abs(a - np.nanmedian(a)))) for n, a in angles.items()}
        name = max(swings, key=lambda trial: swings[trial])
        size, limit = f"{numbers.format_number(swings[name], 3, 'rad')} in {name}", f"≤ {math.pi:.3g} rad"
        text = "a body that swings farther in roll or pitch turns over: is the column in degrees?"
        reason = f"{coordinate} reaches {size} from the median; at most {math.pi:.3g} rad is possible"
        check = ("SWM072", "swing possible", size, swings[name] <= math.pi, limit, text, reason)
        checks.append(fit_common.warn_check(*check, failed=True))
    forces = _force_ratios(experiment)
    if forces:
        _, force, most, name = max(forces)
        size, limit = (
            f"{numbers.format_number(force, 3, 'N')} in {name}",
            f"≤ {numbers.format_number(most, 3, 'N')}",
        )
        text = "check the unit of the force and the mass; a weight or buoyancy cannot drive with more force"
        reason = f"the driving force of {size} exceeds the weight and the buoyancy of the body"
        check = ("SWM072", "driving force possible", size, force <= most, limit, text, reason)
        checks.append(fit_common.warn_check(*check))
    return checks


#: Type of the physical limit of an estimate: name of the estimate, its maximum, a description of the bodies
#: for which the maximum holds, and the inputs to check if the estimate exceeds the maximum.
Limit = tuple[str, float, str, str]


def _limits(experiment: Experiment, result: FitResult) -> Iterator[Limit]:
    """Yield the physical limit of each identifiable estimate: added mass, added inertia, drag coefficient."""
    density, box = experiment.robot.fluid.density_kg_m3, _box(experiment.robot.body)
    known = {name for name, status in result.status.items() if status != "unidentifiable"}
    along = result.model.channels[0].name == "x_m"
    areas = [2.0 * t.rig.area_factor / density for t in result.trials]
    inputs = "masses, forces"
    if "added_inertia" in known and box:
        yield "added_inertia", max_added_inertia(*box, density), "a body of this size", inputs
    if "added_mass" in known and box:
        yield "added_mass", max_added_mass_in_box(*box, density, along=along), "a body of this size", inputs
    elif "added_mass" in known:
        displaced, area = max(_max_displaced(experiment, t) for t in result.trials), max(areas) * along
        if displaced > 0:
            basis = "a body of its mass" + " and size" * bool(area)
            yield "added_mass", max_added_mass(displaced, area or None, density), basis, inputs
    if "drag_coefficient" in known:
        yield from _limit_drag(result, areas, density)


def _limit_drag(result: FitResult, areas: Sequence[float], density: float) -> Iterator[Limit]:
    """Yield the physical limit of the drag coefficient at the largest Reynolds number, if it is known."""
    sized = [(t, a) for t, a in zip(result.trials, areas, strict=True) if t.role == "fit" and a]
    speeds = [result.model.run(result.values(t.id), t)["u_m_s"] for t, _ in sized]
    tops = [float(np.nanmax(np.abs(u), initial=0.0)) for u in speeds]
    reached = [reynolds(top, a, density) for top, (_, a) in zip(tops, sized, strict=True)]
    most = max_drag_coefficient(max(reached, default=math.nan))
    if math.isfinite(most):
        basis = f"a body of any shape at a Reynolds number of {numbers.format_number(max(reached), 2)}"
        yield "drag_coefficient", most, basis, "forces, areas, lengths"


def _force_ratios(experiment: Experiment) -> list[tuple[float, float, float, str]]:
    """Compare the driving force of each drop without a pulley with the largest possible driving force.

    Return for each drop the ratio of driving force to largest possible force, the driving force (N), the
    largest possible force (N) and the name of the trial. The largest possible force is the weight of the body
    or, if larger, its maximum net buoyancy.
    """
    forces = []
    for trial in experiment.trials:
        rig, water = trial.rig, _water_in_body(experiment, trial)
        if (
            experiment.name == "falling-weight"
            and not rig.pulley
            and math.isfinite(water)
            and rig.inertia > 0
        ):
            most = experiment.robot.fluid.gravity_m_s2 * max(rig.inertia, water - rig.inertia)
            forces.append((rig.pull / most, rig.pull, most, trial.id))
    return forces


def _max_displaced(experiment: Experiment, trial: Trial) -> float:
    """Return the maximum mass of water that the body of a trial can displace, kg."""
    rig, weight = trial.rig, trial.rig.pull / experiment.robot.fluid.gravity_m_s2
    if rig.pulley:
        return rig.inertia - weight - experiment.robot.rig.pulley_inertia_kg
    # A rising body displaces its own mass plus the mass equivalent of its net buoyancy. It cannot displace
    # more water than its size allows.
    return max(rig.inertia, min(rig.inertia + weight, _water_in_body(experiment, trial)))


def _box(body: Body) -> tuple[float, float, float] | None:
    """Return the length, width and height of a body, m; None if one of these dimensions is unknown."""
    if body.length_m and body.width_m and body.height_m:
        return body.length_m, body.width_m, body.height_m
    return None


def _water_in_body(experiment: Experiment, trial: Trial) -> float:
    """Return the mass of water, kg, that fills the bounding box of the body; infinite if no size is known.

    If only the frontal area is known, the body is assumed to have the maximum length for this area
    (:data:`MAX_SLENDERNESS`).
    """
    box, density = _box(experiment.robot.body), experiment.robot.fluid.density_kg_m3
    area = 2.0 * trial.rig.area_factor / density
    if box is None:
        box = (area, MAX_SLENDERNESS, 2.0 * math.sqrt(area / math.pi))
    return density * math.prod(box) or math.inf


# ------------------------------------------------------------ theory and tables


def prism_added_mass(length_m: float, width_m: float, height_m: float, density_kg_m3: float) -> float:
    """Return the added mass of a box that moves through water along its own length, kg.

    Notes
    -----
    Tabulated coefficients of square prisms (DNV-RP-C205, appendix D) are interpolated at the length of the
    box divided by the side of a square with the same frontal area. The coefficient multiplies the mass of the
    displaced water.

    >>> round(prism_added_mass(1.0, 1.0, 1.0, 1000.0))
    680
    """
    side = np.sqrt(width_m * height_m)
    coefficient = float(np.interp(length_m / side, PRISM[:, 0], PRISM[:, 1]))
    return coefficient * density_kg_m3 * length_m * width_m * height_m


def max_added_mass_in_box(
    length_m: float, width_m: float, height_m: float, density_kg_m3: float, *, along: bool
) -> float:
    """Return the maximum added mass of any body that fits into a box of the given size, kg.

    Parameters
    ----------
    along : bool
        Whether the body moves along its length. If False, the body may move in any direction.

    Notes
    -----
    The flow around a moving body has the minimum kinetic energy of all possible flows (Kelvin). In one
    possible flow the surrounding water moves with the body. The added mass of a body is therefore at most the
    added mass of a larger body around it, plus all water between the two bodies. For motion along the length
    the larger body is the box. For motion in any direction it is the sphere around the box.

    >>> max_added_mass_in_box(1.0, 1.0, 1.0, 1000.0, along=True)
    1680.0
    """
    if along:
        displaced = density_kg_m3 * length_m * width_m * height_m
        return prism_added_mass(length_m, width_m, height_m, density_kg_m3) + displaced
    diagonal = float(np.sqrt(length_m**2 + width_m**2 + height_m**2))
    return 1.5 * density_kg_m3 * float(np.pi) / 6.0 * diagonal**3


def max_added_inertia(length_m: float, width_m: float, height_m: float, density_kg_m3: float) -> float:
    """Return the maximum added moment of inertia, kg m2, of a body that rotates about a point in its box.

    The box is the bounding box of the body with the given dimensions.

    Notes
    -----
    The limit is derived as in :func:`max_added_mass_in_box`. The limit is the moment of inertia of a sphere
    of water whose radius is the diagonal of the box.

    >>> round(max_added_inertia(1.0, 1.0, 1.0, 1000.0))
    26119
    """
    radius = float(np.sqrt(length_m**2 + width_m**2 + height_m**2))
    return 0.4 * density_kg_m3 * 4.0 / 3.0 * float(np.pi) * radius**5


def max_added_mass(displaced_kg: float, frontal_area_m2: float | None, density_kg_m3: float) -> float:
    """Return the maximum added mass, kg, of a convex body of known displacement and frontal area.

    The body moves perpendicular to its frontal area.

    Parameters
    ----------
    displaced_kg : float
        Mass of the displaced water, or an upper bound of this mass.
    frontal_area_m2 : float or None

    Notes
    -----
    A convex body fills at least a third of the prism around it, as a pyramid does. The added mass of a prism
    along its length is at most 0.8 of the mass of water in a cube of the same frontal area (DNV-RP-C205,
    appendix D). The rest follows as in :func:`max_added_mass_in_box`. Without a frontal area the limit is ten
    times the displaced water. This is more than the added mass of a disc that is ten times as wide as thick.

    >>> round(max_added_mass(1.0, 0.01, 1000.0), 3)
    3.8
    """
    if frontal_area_m2 is None:
        return 10.0 * displaced_kg
    return 3.0 * displaced_kg + 0.8 * density_kg_m3 * frontal_area_m2**1.5


def reynolds(speed_m_s: float, frontal_area_m2: float, density_kg_m3: float) -> float:
    """Return the Reynolds number of a body in water; NaN if the fluid density is not that of water.

    The length scale is the diameter of a circle with the frontal area of the body.

    >>> round(reynolds(1.0, np.pi / 4, 1000.0))
    1000000
    """
    low, high = WATER_KG_M3
    if not low <= density_kg_m3 <= high:
        return float("nan")
    return speed_m_s * 2.0 * float(np.sqrt(frontal_area_m2 / np.pi)) / WATER_VISCOSITY_M2_S


def max_drag_coefficient(reynolds_number: float) -> float:
    """Return an upper bound of the drag coefficient of any body at a Reynolds number.

    The drag coefficient refers to the frontal area of the body. The result is NaN if the Reynolds number is
    not positive.

    Notes
    -----
    Discs and plates across the flow have drag coefficients of 1.17 to 2, an open half cylinder has 2.3, and
    no body has 3 (Hoerner, Fluid-Dynamic Drag, 1965, chapter 3). In slow flow viscosity adds 24/Re for a
    sphere, 20.4/Re for a disc and 64/Re for a prolate spheroid that is ten times as long as wide (Happel and
    Brenner, Low Reynolds Number Hydrodynamics, section 5-11).

    >>> max_drag_coefficient(1e4), max_drag_coefficient(1.0)
    (3.0072, 75.0)
    """
    return 3.0 + 72.0 / reynolds_number if reynolds_number > 0 else float("nan")


def theory_estimates(robot: Robot) -> list[Theory]:
    """Return the theoretical estimates that the robot file states, and the added mass of a prism.

    The prism has the length, width and height of the robot. Its added mass is left out if they are unknown.
    """
    quoted = list(robot.theory)
    box = _box(robot.body)
    if box is not None:
        value = prism_added_mass(*box, robot.fluid.density_kg_m3)
        quoted.append(
            Theory(parameter="added_mass", value=value, unit="kg", basis="square prism", source="DNV-RP-C205")
        )
    return quoted


# ------------------------------------------------------------ two-point method of the boxfish paper


@dataclass(frozen=True)
class TwoPointResult:
    """Estimates, standard errors and bias of the two-point method of the boxfish paper.

    Attributes
    ----------
    values, stderr, bias : dict of str to float
        Estimate, standard error and bias of each parameter in :data:`NAMES`. The standard error combines
        random error and bias.
    points_m : tuple of float
        The two displacements.
    pulling_mass_kg : ndarray, shape (k,)
        Pulling mass of each of the k drops.
    speed_squared, speed_squared_sd : ndarray, shape (2, k), m2/s2
        Squared speed at each displacement, and its standard deviation.
    lines : ndarray, shape (2, 2)
        Slope and intercept of squared speed over pulling mass at each displacement: alpha and beta of Eq 13.
    """

    values: dict[str, float]
    stderr: dict[str, float]
    bias: dict[str, float]
    points_m: tuple[float, float]
    pulling_mass_kg: Array
    speed_squared: Array
    speed_squared_sd: Array
    lines: Array

    @property
    def is_valid(self) -> bool:
        """Whether all standard errors of the two-point method are finite.

        The standard errors are finite if the squared speeds rise with the pulling mass as the method assumes.
        """
        return all(map(math.isfinite, self.stderr.values()))

    @property
    def text(self) -> str:
        """Estimates of the two-point method as a sentence."""
        if not self.is_valid:
            return f"The two-point method has no result: {NO_ANSWER}."
        parts = [f"{n} {numbers.format_estimate(value, self.stderr[n])}" for n, value in self.values.items()]
        return f"The two-point method gives {', '.join(parts)}."


def speed_at(
    time_s: Array, displacement_m: Array, point_m: float, half_width_m: float
) -> tuple[float, float]:
    """Return the speed of a body at a given displacement, and the standard error of this speed, m/s.

    The speed is the slope of a straight line that is fitted to the samples around this displacement.

    Raises
    ------
    NoTrustworthyResult
        If fewer than :data:`MIN_SAMPLES_POINT` samples lie around the point.
    """
    near = np.abs(displacement_m - point_m) <= half_width_m
    if near.sum() < MIN_SAMPLES_POINT:
        raise NoTrustworthyResult(
            f"only {int(near.sum())} samples lie within {half_width_m:.3g} m of the displacement "
            f"{point_m:.3g} m",
            hint="choose --points inside the measured displacement, or use the default method",
        )
    t, x = time_s[near] - time_s[near].mean(), displacement_m[near]
    spread = 0.0
    if len(t) > MIN_SCATTER_SAMPLES:
        # Compute the residuals of a parabola, so that curvature does not count as noise. In the middle of the
        # interval the parabola has the slope of the line.
        residual = x - np.polyval(np.polyfit(t, x, 2), t)
        spread = math.sqrt(float(residual @ residual) / (len(t) - 3))
    return float(t @ x) / float(t @ t), spread / math.sqrt(float(t @ t))


def two_point(
    trials: Sequence[Trial], robot: Robot, points_m: tuple[float, float] | None = None
) -> TwoPointResult:
    """Estimate drag coefficient, added mass and pulley friction from speeds at two displacements.

    Parameters
    ----------
    trials : sequence of Trial
        Falling-weight trials without missing samples. Only those with a pulley and the role ``fit`` are used.
        These must have at least three different pulling masses.
    points_m : (x1, x2), optional
        The two displacements. The default is :data:`POINT_SHARES` of the displacement that all drops reached.
        The boxfish paper used 0.293 and 0.584 m.

    Raises
    ------
    NoTrustworthyResult
        If the body is not known, if there are too few drops, if a displacement is outside the data, or if the
        speeds do not follow a drag law.
    """
    body, density, gravity = robot.body, robot.fluid.density_kg_m3, robot.fluid.gravity_m_s2
    if body.inertial_mass_kg is None or body.frontal_area_m2 is None:
        raise NoTrustworthyResult("the two-point method needs the robot's inertial mass and frontal area")
    area, mass = body.frontal_area_m2, body.inertial_mass_kg + robot.rig.pulley_inertia_kg
    drops = [t for t in trials if t.rig.pulley and t.role == "fit"]
    masses = np.array([t.rig.pull / gravity for t in drops])
    times = [t.time_s - t.rig.begin_s for t in drops]
    measured_m = [t.measured["x_m"] - t.rig.x0 for t in drops]
    if len(np.unique(masses)) < MIN_MASSES:
        raise NoTrustworthyResult(
            f"the two-point method needs at least {MIN_MASSES} different pulling masses"
        )
    reach = min(float(x.max()) for x in measured_m)
    points = points_m or (POINT_SHARES[0] * reach, POINT_SHARES[1] * reach)
    if not 0 < points[0] < points[1]:
        raise NoTrustworthyResult(f"the two displacements must rise from zero: {points[0]:g} {points[1]:g}")

    def speeds(displacements: Sequence[Array]) -> tuple[Array, Array]:
        """Return the speeds of k drops at the two displacements and their standard errors, m/s.

        Both arrays have the shape (2, k).
        """
        pairs = list(zip(times, displacements, strict=True))
        width = points[0] * HALF_WIDTH
        fits = np.array([[speed_at(t, x, point, width) for t, x in pairs] for point in points])
        return fits[:, :, 0], fits[:, :, 1]

    def solve(squared: Array) -> tuple[Array, Array]:
        lines = np.array([np.polyfit(masses, v, 1) for v in squared])
        slopes, intercepts = lines.T
        a1 = solve_a1(slopes[0] / slopes[1], points)
        # Compute tanh^2 phi(x) = 1 - exp(-2 a1 x) at the two displacements (from Eq 14 of the boxfish paper).
        saturation = -np.expm1(-2 * a1 * np.array(points))
        drag = float(np.mean(2 * gravity * saturation / (density * area * slopes)))
        added = density * drag * area / (2 * a1) - mass - float(masses.mean())
        return np.array([drag, added, float(np.mean(-gravity * intercepts / slopes))]), lines

    measured, measured_sd = speeds(measured_m)
    squared, squared_sd = measured**2, 2 * np.abs(measured) * measured_sd
    answer, lines = solve(squared)
    variance = _random_variance(lambda moved: solve(moved)[0], squared, squared_sd, masses, lines)
    drag, added, friction = answer
    perfect = [
        falling_weight_closed_form(
            t, 0.0, mass + added + weight, 0.5 * density * area * drag, weight * gravity - friction
        )[0]
        for t, weight in zip(times, masses, strict=True)
    ]
    bias = solve(speeds(perfect)[0] ** 2)[0] - answer
    values, stderr, bias_of = (
        dict(zip(NAMES, v.tolist(), strict=True)) for v in (answer, np.hypot(np.sqrt(variance), bias), bias)
    )
    at_points = (float(points[0]), float(points[1]))
    return TwoPointResult(values, stderr, bias_of, at_points, masses, squared, squared_sd, lines)


def _random_variance(
    solve: Callable[[Array], Array], squared: Array, squared_sd: Array, masses: Array, lines: Array
) -> Array:
    """Return the variances of the estimates due to the random errors of the squared speeds, shape (3,).

    The random errors are estimated from the residuals of squared speed about its regression lines over the
    pulling mass. The variances are infinite if the method has no result for a squared speed displaced by its
    error.
    """
    scatter = squared - np.array([np.polyval(line, masses) for line in lines])
    pooled = math.sqrt(float(np.sum(scatter**2)) / max(2 * len(masses) - 4, 1))
    spread = np.maximum(squared_sd, pooled)
    answer, variance = solve(squared), np.zeros(3)
    for at in np.ndindex(squared.shape):
        moved = squared.copy()
        moved[at] += spread[at]
        try:
            variance += (solve(moved) - answer) ** 2
        except NoTrustworthyResult:
            return np.full(3, np.inf)
    return variance


def solve_a1(ratio: float, points_m: tuple[float, float]) -> float:
    """Solve Eq 18 of the boxfish paper for a1, the quadratic drag divided by the moving mass, 1/m.

    If the second displacement is twice the first, Eq 19 of the paper is the solution in closed form.

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


def _two_point_file(file: ParameterFile, pair: TwoPointResult) -> ParameterFile:
    """Return a copy of a parameter file with the estimates of the two-point method.

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


def _speed_figure(pair: TwoPointResult) -> ev.Figure:
    order = np.argsort(pair.pulling_mass_kg)
    mass = pair.pulling_mass_kg[order]
    traces = []
    for i, point in enumerate(pair.points_m):
        squared, error = pair.speed_squared[i][order], 1.96 * pair.speed_squared_sd[i][order]
        line, label = np.polyval(pair.lines[i], mass), f"at {point:.3f} m"
        traces.append(ev.Trace(x=1e3 * mass, y=squared, y_error=error, style="points", label=label, group=i))
        traces.append(ev.Trace(x=1e3 * mass, y=line, group=i))
    title = "Squared speed against pulling mass"
    caption = "Squared speed at two displacements with 95 % intervals; the lines are fitted to these points."
    return ev.make_figure(
        "speed-squared", title, caption, "pulling mass (g)", "squared speed (m²/s²)", traces
    )
