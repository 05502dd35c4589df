"""Checks of a rig fit, and quantities derived from its parameters.

The checks look for omitted parameters, start states, an outlier trial, a measured force of the wrong sign,
and parameters that no body can have. Added mass, drag and driving force are compared with the largest values
that any body of the known size can have, from theory and tables. Terminal speed, period and damping ratios
are derived with their standard errors.

The reference fit (``stated``) has the parameters that the user chose. Each parameter that it holds for all
trials is tested in two ways. First the parameter is freed in addition to the others. The test compares its
estimate with its standard error, which allows for coloured residuals and for trials that disagree. Then it
replaces the parameters with a similar effect (:data:`swimid.rig.model.ALIKE`). For example, dry friction
replaces linear damping. This fit has as many unknowns as the reference fit, so that their likelihoods can be
compared.

References
----------
.. [1] R. E. Kass, A. E. Raftery, "Bayes factors", Journal of the American Statistical Association 90 (1995),
   773-795: evidence is strong if twice the logarithm of the Bayes factor is above 6.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy import special

from swimid.errors import NoTrustworthyResult
from swimid.fitting import fit_common, output_error
from swimid.fitting.fit_common import Experiment
from swimid.fitting.model import Array, Parameter, Trial, chosen
from swimid.fitting.output_error import FitResult
from swimid.fitting.uncertainty import HETEROGENEITY, SIGNIFICANCE, UNIDENTIFIABLE, fit_autoregression
from swimid.notices import recorded, warn
from swimid.results import evidence as ev
from swimid.results import numbers
from swimid.results.parameters import Estimate
from swimid.rig.model import ALIKE, COORDINATES, terminal_speed
from swimid.robots.file import Body, Robot, Theory

#: Start values of a freed parameter, as multiples of its typical scale from the value at which it was held.
FREED_STARTS = (0.0, 1.0, -1.0)
#: Minimum of twice the logarithm of a likelihood ratio that counts as strong evidence [1]_.
STRONG = 6.0
#: Maximum number of parameters that a warning names.
MAX_NAMED = 3
#: Maximum p-value, and maximum ratio of the sums of squared residuals with and without start parameters, at
#: which each trial gets its own start state.
START_P, START_RATIO = 1e-6, 0.8
#: Parameters of the start state of a trial, and their descriptions in a warning.
STARTS = {"initial_speed": "moving", "clock_offset": "at another time than their first sample"}
#: Maximum ratio of the squared residuals with one more shared parameter to those with a parameter for each
#: trial. Up to this ratio the shared parameter is preferred.
SHARED_RATIO = 1.1
#: Maximum p-value of the slope of the friction over the pulling force that counts as a trend.
TREND_P = 1e-2

# ------------------------------------------------------------ omitted parameters


@dataclass(frozen=True)
class Omitted:
    """A held parameter that the data support.

    Attributes
    ----------
    fit : FitResult
        Fit with the parameter.
    replaced : tuple of str
        Parameters that it replaces; empty if the parameter is freed in addition to the others.
    evidence : float
        Twice the logarithm of the likelihood ratio of the fit with the parameter to the reference fit.
    """

    parameter: Parameter
    fit: FitResult
    replaced: tuple[str, ...]
    evidence: float

    @property
    def text(self) -> str:
        """Name and estimate of the parameter as text."""
        name = self.parameter.name
        size = numbers.measured(self.fit.value(name), self.fit.stderr(name), self.parameter.unit)
        return f"{name} {size}" + f" in the place of {', '.join(self.replaced)}" * bool(self.replaced)

    @property
    def criterion(self) -> float:
        """BIC minus that of the reference fit, which is about -2 times the logarithm of the Bayes factor."""
        return math.log(self.fit.samples) * (not self.replaced) - self.evidence

    @property
    def sentence(self) -> str:
        """Sentence on the effect of the parameter on the fit, with the options that choose it."""
        name = self.parameter.name
        held = "".join(f" --fix {other}=0" for other in self.replaced)
        acting = next(p for p in self.fit.parameters if p.name == name)
        choice = f"--free {name}"
        if not acting.free:
            choice = f"--fix {name}={acting.start:g}"
        change = numbers.percent(math.expm1(-self.evidence / self.fit.samples), 2)
        return f"{self.text} would change the squared residuals by {change}: use {choice}{held}"


def find_omitted(stated: FitResult) -> list[Omitted]:
    """Return the held parameters that the data support, sorted by BIC (lowest first).

    A freed parameter is supported if its p-value is below :data:`SIGNIFICANCE`. A replacement is supported
    unless its log-likelihood is lower than that of the reference fit by strong evidence (:data:`STRONG`). It
    must also move an estimate of the reference fit out of its 95 % interval.
    """
    held = [p for p in stated.parameters if not p.free and not p.per_trial]
    found = []
    for parameter in held:
        name = parameter.name
        fit = fit_freed(stated, name)
        if fit is not None and fit.stderr(name) and fit.status[name] == "estimated":
            evidence = compute_evidence(stated, fit)
            distance, error = abs(fit.value(name) - parameter.start), fit.stderr(name) or 0.0
            # unlike the standard error, the likelihood ratio does not depend on the parametrisation
            z = min(distance / error, math.sqrt(max(evidence, 0.0)))
            sides = 1.0 if parameter.start in parameter.bounds else 2.0
            p_value = min(1.0, len(held) * sides * float(special.ndtr(-z)))
            if p_value < SIGNIFICANCE and evidence > 0.0:
                found.append(Omitted(parameter, fit, (), evidence))
        fit, replaced = _fit_replacement(stated, parameter)
        if fit is not None and fit.status.get(name, "fixed") in ("estimated", "fixed"):
            evidence = compute_evidence(stated, fit)
            if evidence > -STRONG and find_moved(stated, fit):
                found.append(Omitted(parameter, fit, replaced, evidence))
    return sorted(found, key=lambda omitted: omitted.criterion)


def fit_freed(stated: FitResult, name: str) -> FitResult | None:
    """Return the best fit with one more free parameter, from several start values; None if all fail."""
    held = next((p for p in stated.parameters if p.name == name and not p.free), None)
    if held is None:
        return None
    return _fit_from_starts(stated, held, chosen(stated.parameters, freed=(name,)))


def _fit_replacement(stated: FitResult, held: Parameter) -> tuple[FitResult | None, tuple[str, ...]]:
    """Return the fit in which a parameter replaces those with a similar effect, and the replaced names.

    A parameter is not tested if only the user, and not the model, holds it.
    """
    alike = next((names for names in ALIKE if held.name in names), ())
    others = [
        p for p in stated.parameters if p.name in alike and p is not held and (p.free or p.start != 0.0)
    ]
    by_default = any(p.name == held.name and not p.free for p in stated.model.parameters)
    if not others or not by_default or held.start != 0.0:
        return None, ()
    if not all(p.lower <= 0.0 <= p.upper for p in others):
        return None, ()
    names = tuple(p.name for p in others)
    fixed = dict.fromkeys(names, 0.0)
    parameters = chosen(stated.parameters, fixed=fixed, freed=(held.name,))
    if not any(p.free for p in others):
        fixed[held.name] = sum(p.start for p in others)
        parameters = chosen(stated.parameters, fixed=fixed)
    return _fit_from_starts(stated, held, parameters), names


def _fit_from_starts(
    stated: FitResult, held: Parameter, parameters: tuple[Parameter, ...]
) -> FitResult | None:
    """Return the best fit with the given parameters, from several start values of the parameter ``held``."""
    free = any(p.name == held.name and p.free for p in parameters)
    starts = [held.start]
    if free:
        starts = [held.start + start * held.scale for start in FREED_STARTS]
    fits = []
    for value in starts:
        if not held.lower <= value <= held.upper:
            continue
        begun = []
        for p in parameters:
            start = p.start
            if free and p.name == held.name:
                start = value
            elif p.free and p.name in stated.labels:
                start = stated.value(p.name)
            begun.append(replace(p, start=start))
        # ignore a search that fails, because another start value may succeed
        with suppress(NoTrustworthyResult), recorded():
            fits.append(output_error.fit(stated.model, stated.trials, parameters=begun, tested=False))
    if not fits:
        return None
    return replace(min(fits, key=lambda fit: fit.cost), parameters=parameters)


def compute_evidence(stated: FitResult, fit: FitResult) -> float:
    """Return twice the logarithm of the likelihood ratio of a fit to the reference fit."""
    return stated.samples * math.log(max(stated.cost, 1e-300) / max(fit.cost, 1e-300))


def find_moved(stated: FitResult, other: FitResult) -> list[str]:
    """Return the shared parameters whose 95 % interval in one fit excludes the estimate of another fit."""
    found = []
    for label in stated.shared:
        error = stated.stderr(label)
        beyond = error is None or abs(other.value(label) - stated.value(label)) > 1.96 * error
        if beyond and stated.status[label] != "unidentifiable":
            found.append(label)
    return found


def omission_check(stated: FitResult, omitted: Sequence[Omitted]) -> ev.Check:
    """Check that the data support no held parameter; warn of the parameters that the data support."""
    name = "no parameter left out"
    limit = f"p ≥ {SIGNIFICANCE:g}, and no other law explains as much"
    if not omitted:
        held = ", ".join(p.name for p in stated.parameters if not p.free and not p.per_trial)
        return ev.check(name, "none", True, limit, f"tested, each in a fit of its own: {held or 'none'}")
    warn("SWM024", "; ".join(o.sentence for o in omitted[:MAX_NAMED]))
    best = omitted[0]
    moved = find_moved(stated, best.fit)
    text = f"with it {', '.join(moved)} would lie outside the stated interval" * bool(moved)
    check = ev.check(name, best.text, False, limit, text, reason=f"the trials speak for {best.text}")
    if moved and -best.criterion > STRONG:
        check.verdict = "fail"
    return check


# ------------------------------------------------------------ differences between trials


def fit_start_states(plain: FitResult) -> tuple[FitResult, str, list[Omitted]]:
    """Return a fit with a start state of each trial, if the data clearly support it; else the given fit.

    The given fit is also returned if a friction of each trial lowers the residuals more than the start
    states, or if an omitted parameter lowers them about as much.

    Parameters
    ----------
    plain : FitResult
        Fit with all trials starting at rest, and without per-trial parameters.

    Returns
    -------
    result : FitResult
    start_state : str
        Name of the parameter of the start state that is estimated; ``rest`` if there is none.
    omitted : list of Omitted
        Omitted parameters of the result.
    """
    fits = {}
    for name in STARTS:
        rival = fit_freed(plain, name)
        if rival is not None and _is_significant(plain, rival):
            fits[name] = rival
    omitted = find_omitted(plain)
    if not fits:
        return plain, "rest", omitted
    reason = min(fits, key=lambda name: squared_error(fits[name]))
    best = fits[reason]
    if omitted and squared_error(omitted[0].fit) < SHARED_RATIO * squared_error(best):
        return plain, "rest", omitted
    friction = fit_freed(plain, "friction_deviation")
    if friction is not None and squared_error(friction) < squared_error(best):
        return plain, "rest", omitted
    unit = next(p.unit for p in best.parameters if p.name == reason)
    values = ", ".join(
        f"{label[len(reason) + 1 : -1]} {value:+.3g}"
        for label, value in zip(best.labels, best.estimate, strict=True)
        if label.startswith(f"{reason}[")
    )
    warn(
        "SWM017",
        f"the trials start {STARTS[reason]}; {reason} is estimated for each ({values} {unit}). Use "
        "--start-state rest to insist on rest at the first sample",
    )
    # test again, because the start states may have absorbed a part of the omitted effect
    return best, reason, find_omitted(best)


def trial_checks(plain: FitResult, result: FitResult) -> list[ev.Check]:
    """Return a check if the friction differs between trials, and one if a trial contradicts the others.

    Both are tested only if the residuals of the plain fit are coloured or trials disagree.
    """
    coloured = any(len(noise.autoregression) for noise in plain.noise.values())
    if plain.scatter_p >= HETEROGENEITY and not coloured:
        return []
    from swimid.fitting import between_trials

    checks = _friction_check(plain)
    odd = between_trials.find_outlier_trial(plain)
    if odd is None:
        return checks
    units = {p.name: p.unit for p in result.parameters}
    without = "; ".join(
        f"{label} {numbers.measured(odd.others.value(label), odd.others.stderr(label), units[label])}"
        for label in odd.others.shared
    )
    size = f"{odd.trial}: {numbers.number(odd.error_ratio, 2)} times the others' error"
    limit = f"below {between_trials.MIN_ERROR_RATIO:g} times, or p ≥ {between_trials.OUTLIER_P_VALUE:g}"
    text = (
        f"without it: {without}. Check its entry in the trials file (pulling mass, force, unit), or leave it "
        "out of the fit with role: validate"
    )
    reason = f"{odd.trial} contradicts the other trials"
    check = ("SWM071", "no trial contradicts the others", size, False, limit, text, reason)
    return [*checks, fit_common.warned_check(*check, failed=bool(find_moved(result, odd.others)))]


def _friction_check(plain: FitResult) -> list[ev.Check]:
    """Return a check that fails if the friction follows the pulling force, and warns if it differs at random.

    The frictions are linearised at the fit. They show that trials differ, but not by how much.
    """
    from swimid.fitting import between_trials

    if "pulley_friction" not in plain.labels:
        return []
    own = between_trials.estimate_own_values(plain, "friction_deviation", "pulley_friction")
    if len(own.trials) < between_trials.MIN_TRIALS:
        return []
    code, how, p_value = "SWM014", "differs from trial to trial", between_trials.estimate_spread(own).p_value
    if p_value >= HETEROGENEITY:
        return []
    pulls = {t.id: t.rig.pull for t in plain.trials}
    trend_p = between_trials.compute_trend_p(own, np.array([pulls[name] for name in own.trials]))
    follows = trend_p < TREND_P
    if follows:
        code, how, p_value = "SWM070", "follows the pulling mass", trend_p
    value, limit = f"{how} ({ev.p_text(p_value)})", f"p ≥ {HETEROGENEITY:g}; for a trend p ≥ {TREND_P:g}"
    reason = f"the pulley friction {value}"
    text = "standard errors do not allow for it: find the cause with swimid diagnose TRIALS --params FILE"
    check = (code, "same friction in all trials", value, False, limit, text, reason)
    return [fit_common.warned_check(*check, failed=follows)]


def _is_significant(plain: FitResult, rival: FitResult) -> bool:
    """Return whether an F-test that allows for coloured noise prefers a fit with more unknowns."""
    extra = len(rival.labels) - len(plain.labels)
    before, after = squared_error(plain), squared_error(rival)
    if after <= 0 or before <= after or after > START_RATIO * before:
        return False
    colour = 1.0
    for noise in rival.noise.values():
        if len(noise.autoregression):
            series = np.concatenate([s.weighted for s in rival.series if s.role == "fit"])
            fitted = fit_autoregression(series, order=len(noise.autoregression))
            colour = max(colour, fitted.long_run_variance / float(np.nanvar(series)))
    statistic = (before - after) / (after / max(rival.samples - len(rival.labels), 1)) / colour
    return bool(special.chdtrc(extra, statistic) < START_P)


def squared_error(result: FitResult) -> float:
    """Return the sum of squared residuals of the fitted trials."""
    return float(sum(np.nansum(s.residual**2) for s in result.series if s.role == "fit"))


# ------------------------------------------------------------ measured force


def sign_check(result: FitResult) -> ev.Check:
    """Check that no trial fits better if the sign of the measured force is changed."""
    name, limit = "sign of force_N", "no trial agrees better with -force_N"
    fitted = [t for t in result.trials if t.role == "fit"]
    channel = next(s.channel for s in result.series if s.role == "fit")
    # simulate with the start values, because a fit to a force of the wrong sign makes the body so heavy that
    # no force moves it
    start = np.array([p.start for p in result.model.parameters])

    def mean_square(trial: Trial) -> float:
        simulated = result.model.simulate(start, trial)[channel]
        return float(np.nanmean((trial.measured[channel] - simulated) ** 2))

    turned = {}
    for trial in fitted:
        other = replace(trial, inputs={**trial.inputs, "force_N": -trial.inputs["force_N"]})
        if channel in trial.measured and mean_square(other) < mean_square(trial):
            turned[trial.id] = other
    found = None
    if turned:
        trials = [turned.get(t.id, t) for t in result.trials]
        with suppress(NoTrustworthyResult), recorded():
            found = output_error.fit(result.model, trials, parameters=result.parameters, tested=False)
    if found is None or compute_evidence(result, found) <= STRONG:
        return ev.check(name, "as stated", True, limit)
    where = ", ".join(sorted(turned))
    if len(turned) == len(fitted):
        where = "all trials"
    change = math.expm1(-0.5 * compute_evidence(result, found) / result.samples)
    reason = f"with force_N times -1 in {where} the error of {channel} falls by {-100 * change:.3g} %"
    text = (
        "force_N must be the force on the body, positive along x_m: turn its sign in the log, or with "
        "factor: -1 in the mapping of an import"
    )
    check = ("SWM110", name, f"wrong in {where}", False, limit, text, reason)
    return fit_common.warned_check(*check, failed=True)


# ------------------------------------------------------------ derived quantities


#: Added-mass coefficients of square prisms that move along their length (DNV-RP-C205, appendix D). Each row
#: has the ratio of length to side, and the added mass divided by the mass of the displaced water.
PRISM = np.array(
    [[1.0, 0.68], [2.0, 0.36], [3.0, 0.24], [4.0, 0.19], [5.0, 0.15], [6.0, 0.13], [7.0, 0.11], [10.0, 0.08]]
)
#: Maximum length of a body, in diameters of a circle with the frontal area of the body.
MAX_SLENDERNESS = 10.0
#: Minimum and maximum density of water (fresh to salt, kg/m3), and kinematic viscosity of water at 20 degrees
#: Celsius (m2/s).
WATER_KG_M3, WATER_VISCOSITY_M2_S = (950.0, 1050.0), 1.0e-6
#: Step of the finite differences of the delta method, in standard errors of the parameter.
DELTA_STEP = 1e-4
#: Function of the coefficients of the equation of motion; NaN if the quantity does not exist.
Quantity = Callable[[Mapping[str, float]], float]


def derive(experiment: Experiment, result: FitResult) -> dict[str, Estimate]:
    """Return the terminal speed of each falling-weight trial, or the period and damping ratios of a decay.

    A decay has two damping ratios. One includes all damping, at the amplitude of the largest first swing. The
    other includes linear damping only, and is the limit for small swings.
    """
    first = result.trials[0]
    quantities: dict[str, Estimate | None] = {}
    if experiment.name == "falling-weight":
        for trial in result.trials:
            terminal = partial(terminal_speed, force=trial.rig.pull)
            quantities[f"terminal_speed[{trial.id}]"] = propagate(result, trial, terminal, "m/s")
    if experiment.name == "free-decay":
        amplitude = max(_first_amplitude(result, t) for t in result.trials)
        unit = COORDINATES[result.model.channels[0].name][0]
        ratio = partial(_equivalent_ratio, amplitude=amplitude)
        quantities["natural_period_s"] = propagate(result, first, _period, "s")
        quantities["damping_ratio_linear"] = propagate(result, first, _linear_ratio, "1")
        quantities["first_swing"] = Estimate(value=amplitude, unit=unit, status="fixed")
        quantities["damping_ratio_first_swing"] = propagate(result, first, ratio, "1")
    return {name: e for name, e in quantities.items() if e is not None}


def propagate(result: FitResult, trial: Trial, quantity: Quantity, unit: str) -> Estimate | None:
    """Return the value and the standard error of a function of a trial's coefficients (delta method).

    The status is ``fixed`` if the function depends on no estimated parameter, and ``at-bound`` if it depends
    on a parameter at its bound. It is ``unidentifiable`` if the standard error is above half the value. The
    result is None if the function has no finite value.
    """

    def at(values: Array) -> float:
        return quantity(result.model.coefficients(values, trial.rig))  # type: ignore[attr-defined]

    values = result.values(trial.id)
    centre = at(values)
    if not math.isfinite(centre):
        return None
    names = [p.name for p in result.parameters]
    gradient = np.zeros(len(result.labels))
    unknown = False
    for j, label in enumerate(result.labels):
        name, _, owner = label.partition("[")
        if owner and owner != f"{trial.id}]":
            continue
        k = names.index(name)
        parameter, error = result.parameters[k], result.stderr(label)
        step = DELTA_STEP * (error or parameter.scale)
        moved = values.copy()
        moved[k] += step
        if moved[k] > parameter.upper:
            moved[k] = values[k] - step
        gradient[j] = (at(moved) - centre) / (moved[k] - values[k])
        # the value 0 at a lower bound of 0 needs no error: the errors of the other parameters allow for it
        vanishes = result.status[label] == "at-bound" and parameter.lower == 0.0 >= values[k]
        if gradient[j] != 0 and error is None and not vanishes:
            unknown = True
    known = np.isfinite(np.diag(result.covariance)) & (gradient != 0)
    statuses = {result.status[label] for label, g in zip(result.labels, gradient, strict=True) if g != 0}
    variance = float(gradient[known] @ result.covariance[np.ix_(known, known)] @ gradient[known])
    estimate = Estimate(value=centre, unit=unit, status="fixed")
    if unknown or not (math.isfinite(variance) and variance >= 0):
        estimate.status = "unidentifiable"
    elif known.any():
        estimate.status, estimate.stderr = "estimated", math.sqrt(variance)
    if estimate.stderr is None and "at-bound" in statuses:
        estimate.status = "at-bound"
    elif unit != "1" and (estimate.stderr or 0.0) > UNIDENTIFIABLE * abs(centre):
        estimate.status = "unidentifiable"
    return estimate


def _rate(c: Mapping[str, float]) -> float:
    """Return the natural angular frequency of small swings, rad/s; NaN without a restoring force."""
    stiffness = c["stiffness"] + c["gravity"]
    return math.sqrt(stiffness / c["inertia"]) if stiffness > 0 else math.nan


def _period(c: Mapping[str, float]) -> float:
    return 2 * math.pi / _rate(c)


def _linear_ratio(c: Mapping[str, float]) -> float:
    return c["linear"] / (2 * c["inertia"] * _rate(c))


def _equivalent_ratio(c: Mapping[str, float], amplitude: float) -> float:
    """Return the damping ratio with which linear damping alone would lose the same energy in a swing.

    Linear, quadratic and dry damping are linearised at the given amplitude (Chakrabarti, "Empirical
    calculation of roll damping for ships and barges", Ocean Engineering 2001).
    """
    speed = _rate(c) * amplitude
    if not speed > 0:
        return math.nan
    whole = c["linear"] + 8.0 / (3.0 * math.pi) * c["quadratic"] * speed + 4.0 / math.pi * c["dry"] / speed
    return whole / (2.0 * c["inertia"] * _rate(c))


def _first_amplitude(result: FitResult, trial: Trial) -> float:
    """Return the maximum displacement of the fitted decay from its rest position."""
    series = next(s for s in result.series if s.trial == trial.id)
    values = series.simulated[np.isfinite(series.simulated)]
    rest = result.values(trial.id)[result.model.index("rest_position")]
    return float(np.max(np.abs(values - rest), initial=0.0))


# ------------------------------------------------------------ possible bodies


def possible_checks(experiment: Experiment, result: FitResult) -> list[ev.Check]:
    """Check that added mass, drag, swing and driving force are physically possible.

    The limits follow from body mass, frontal area and size only. If a limit depended on the stated force, a
    wrong force could pass the check.
    """
    limits = [_added_mass_limit(experiment, result), _drag_limit(experiment, result)]
    checks = [_estimate_check(result, *limit) for limit in limits if limit is not None]
    coordinate = result.model.channels[0].name
    if coordinate in ("roll_rad", "pitch_rad"):
        checks.append(_swing_check(experiment, coordinate))
    if experiment.name == "falling-weight":
        checks += _force_check(experiment)
    return checks


#: Name of an estimate, its maximum, the body that has this maximum, and the inputs to check if it is
#: exceeded.
Limit = tuple[str, float, str, str]


def _drag_limit(experiment: Experiment, result: FitResult) -> Limit | None:
    """Return the limit of the drag coefficient: the maximum of all body shapes at the simulated speeds."""
    density = experiment.robot.fluid.density_kg_m3
    sized = [t for t in result.trials if t.role == "fit" and t.rig.area_factor]
    if result.status.get("drag_coefficient", "unidentifiable") == "unidentifiable" or not sized:
        return None
    speeds = [result.model.simulate(result.values(t.id), t)["u_m_s"] for t in sized]
    reached = [
        reynolds(float(np.nanmax(np.abs(u), initial=0.0)), 2.0 * t.rig.area_factor / density, density)
        for u, t in zip(speeds, sized, strict=True)
    ]
    most = max_drag_coefficient(max(reached))
    if not math.isfinite(most):
        return None
    basis = f"a body of any shape at a Reynolds number of {numbers.number(max(reached), 2)}"
    return "drag_coefficient", most, basis, "forces, areas, lengths"


def _added_mass_limit(experiment: Experiment, result: FitResult) -> Limit | None:
    """Return the limit of the added mass or of the added moment of inertia."""
    name = next((n for n in ("added_mass", "added_inertia") if n in result.labels), None)
    if name is None or result.status[name] == "unidentifiable":
        return None
    density, inputs = experiment.robot.fluid.density_kg_m3, "masses, forces"
    along = result.model.channels[0].name == "x_m"
    box = _box(experiment.robot.body)
    if box is not None:
        most = max_added_mass_in_box(*box, density, along=along)
        if name == "added_inertia":
            most = max_added_inertia(*box, density)
        return name, most, "a body in its box", inputs
    displaced = max(_max_displaced(experiment, t) for t in result.trials)
    if name == "added_inertia" or displaced <= 0:
        return None
    area = max(2.0 * t.rig.area_factor / density for t in result.trials)
    if along and area:
        return name, max_added_mass(displaced, area, density), "a body of its mass and size", inputs
    return name, max_added_mass(displaced, None, density), "a body of its mass", inputs


def _estimate_check(result: FitResult, name: str, most: float, basis: str, inputs: str) -> ev.Check:
    """Check that an estimate is not above its limit."""
    value, error = result.value(name), result.stderr(name) or 0.0
    unit = next(p.unit for p in result.parameters if p.name == name)
    size, limit = numbers.measured(value, error or None, unit), numbers.number(most, 2, unit)
    words, text = name.replace("_", " "), f"look at {inputs} and their units, and at what the model lacks"
    reason = f"{words} {size} is more than {basis} can have ({limit})"
    check = ("SWM072", f"{words} possible", size, not value > most, f"≤ {limit}", text, reason)
    return fit_common.warned_check(*check, failed=value - 1.96 * error > most)


def _swing_check(experiment: Experiment, name: str) -> ev.Check:
    """Check that the angle of a decay in roll or pitch stays within half a revolution of its median."""
    swings = []
    for trial in experiment.trials:
        values = trial.measured[name]
        swings.append((float(np.nanmax(np.abs(values - np.nanmedian(values)))), trial.id))
    size, limit = f"{numbers.number(max(swings)[0], 3, 'rad')} in {max(swings)[1]}", f"≤ {math.pi:.3g} rad"
    text = "a body that swings farther in roll or pitch turns over: are these degrees?"
    reason = f"the body swings by {size}, which no body does"
    check = ("SWM072", "swing possible", size, max(swings)[0] <= math.pi, limit, text, reason)
    return fit_common.warned_check(*check, failed=True)


def _force_check(experiment: Experiment) -> list[ev.Check]:
    """Check that the driving force of a body without a pulley is at most its weight or net buoyancy."""
    gravity = experiment.robot.fluid.gravity_m_s2
    forces: list[tuple[float, float, str]] = []
    for trial in experiment.trials:
        rig, water = trial.rig, _water_in_body(experiment, trial)
        if not rig.pulley and math.isfinite(water) and rig.inertia > 0:
            forces.append((rig.pull, gravity * max(rig.inertia, water - rig.inertia), trial.id))
    if not forces:
        return []
    force, most, name = max(forces, key=lambda f: f[0] / f[1])
    size, limit = f"{numbers.number(force, 3, 'N')} in {name}", f"≤ {numbers.number(most, 3, 'N')}"
    text = "look at its unit and the mass; only a drive of another kind is stronger"
    reason = f"the driving force of {size} is more than a body of its mass and size weighs or lifts"
    check = ("SWM072", "driving force possible", size, force <= most, limit, text, reason)
    return [fit_common.warned_check(*check)]


def _max_displaced(experiment: Experiment, trial: Trial) -> float:
    """Return the maximum mass of water that the body of a trial can displace, kg."""
    rig, gravity = trial.rig, experiment.robot.fluid.gravity_m_s2
    pulling = (experiment.facts.get("pulling_mass_kg") or {}).get(trial.id)
    if pulling is not None:
        return rig.inertia - pulling - experiment.robot.rig.pulley_inertia_kg
    if rig.pulley:
        return rig.inertia
    # a rising body displaces more than its own mass, by its net buoyancy, but not more than its size allows
    return max(rig.inertia, min(rig.inertia + rig.pull / gravity, _water_in_body(experiment, trial)))


def _box(body: Body) -> tuple[float, float, float] | None:
    """Return the length, width and height of a body, m; None if one is unknown."""
    if body.length_m and body.width_m and body.height_m:
        return body.length_m, body.width_m, body.height_m
    return None


def _water_in_body(experiment: Experiment, trial: Trial) -> float:
    """Return the mass of water in the largest body of the known size, kg; infinite if the size is unknown.

    Without a box, the body is as long as a body of its frontal area can be (:data:`MAX_SLENDERNESS`).
    """
    box, density = _box(experiment.robot.body), experiment.robot.fluid.density_kg_m3
    if box is not None:
        return density * math.prod(box)
    if not trial.rig.area_factor:
        return math.inf
    area = 2.0 * trial.rig.area_factor / density
    return density * area * MAX_SLENDERNESS * 2.0 * math.sqrt(area / math.pi)


# ------------------------------------------------------------ theory and tables


def prism_added_mass(length_m: float, width_m: float, height_m: float, density_kg_m3: float) -> float:
    """Return the added mass of a box that moves along its length, kg.

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
    """Return the maximum added mass of a body that fits into a box, kg.

    Parameters
    ----------
    along : bool
        Whether the body moves along its length. Otherwise it may move in any direction.

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
    """Return the maximum added inertia, kg m2, of a body that rotates about a point in its bounding box.

    Notes
    -----
    The limit is derived as in :func:`max_added_mass_in_box`. It is the moment of inertia of a sphere of water
    whose radius is the diagonal of the box.

    >>> round(max_added_inertia(1.0, 1.0, 1.0, 1000.0))
    26119
    """
    radius = float(np.sqrt(length_m**2 + width_m**2 + height_m**2))
    return 0.4 * density_kg_m3 * 4.0 / 3.0 * float(np.pi) * radius**5


def max_added_mass(displaced_kg: float, frontal_area_m2: float | None, density_kg_m3: float) -> float:
    """Return the maximum added mass of a convex body that moves perpendicular to its frontal area, kg.

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
    """Return the Reynolds number with the diameter of the frontal area; NaN if the fluid is not water.

    >>> round(reynolds(1.0, np.pi / 4, 1000.0))
    1000000
    """
    low, high = WATER_KG_M3
    if not low <= density_kg_m3 <= high:
        return float("nan")
    return speed_m_s * 2.0 * float(np.sqrt(frontal_area_m2 / np.pi)) / WATER_VISCOSITY_M2_S


def max_drag_coefficient(reynolds_number: float) -> float:
    """Return the maximum drag coefficient of any body, based on its frontal area.

    The result is NaN if the Reynolds number is not positive.

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
    """Return the theoretical estimates of the robot file, and the added mass of a prism of its size."""
    quoted = list(robot.theory)
    box = _box(robot.body)
    if box is not None:
        value = prism_added_mass(*box, robot.fluid.density_kg_m3)
        quoted.append(
            Theory(parameter="added_mass", value=value, unit="kg", basis="square prism", source="DNV-RP-C205")
        )
    return quoted
