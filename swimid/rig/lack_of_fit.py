"""Lack-of-fit tests of a rig: omitted parameters, differences between trials, and the measured force.

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
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy import special

from swimid.errors import NoTrustworthyResult
from swimid.fitting import between_trials, fit_common, output_error
from swimid.fitting.between_trials import MIN_ERROR_RATIO, OUTLIER_P_VALUE, OutlierTrial, find_outlier_trial
from swimid.fitting.covariance import HETEROGENEITY
from swimid.fitting.metrics import FitResult
from swimid.fitting.model import Array, Parameter, Trial, chosen
from swimid.fitting.noise import SIGNIFICANCE, fit_autoregression, long_run_covariance
from swimid.notices import recorded, warn
from swimid.results import blocks, numbers
from swimid.results import evidence as ev
from swimid.results.parameters import Estimate
from swimid.rig.model import ALIKE
from swimid.rig.trials import third_difference_sd

#: Start values of a freed parameter, as multiples of its typical scale from the value at which it was held.
FREED_STARTS = (0.0, 1.0, -1.0)
#: Minimum of twice the logarithm of a likelihood ratio that counts as strong evidence [1]_.
STRONG = 6.0
#: Number of random samples of the noise of a measured force.
N_DRAWS = 30
#: Maximum number of parameters that a warning names.
MAX_NAMED = 3
#: Maximum p-value, and maximum ratio of the sums of squared residuals with and without start parameters, at
#: which each trial gets its own start state.
START_P, START_RATIO = 1e-6, 0.8
#: Parameters of the start state of a trial, and their descriptions in a warning.
STARTS = {"initial_speed": "moving", "clock_offset": "at another time than their first sample"}
#: Deviation of the friction in a trial from the common friction, and the common friction.
FRICTION, COMMON_FRICTION = "friction_deviation", "pulley_friction"
#: Maximum p-value of the slope of the friction over the pulling mass that counts as a trend.
TREND_P = 1e-2
#: Maximum ratio of the squared residuals with one more shared parameter to those with a parameter for each
#: trial. Up to this ratio the shared parameter is preferred.
SHARED_RATIO = 1.1
#: Minimum number of samples at rest for the check of the force at rest.
MIN_SAMPLES = 10
#: Minimum displacement of a body that has moved, in standard deviations of the measurement noise.
MOVED_SD = 5.0


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
    p_value : float
        Probability that the estimate is this far from the held value by chance, with Bonferroni's correction
        for all held parameters. NaN if the parameter replaces others.
    """

    parameter: Parameter
    fit: FitResult
    replaced: tuple[str, ...]
    evidence: float
    p_value: float

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
    def command(self) -> str:
        """Command-line options for a fit with the parameter."""
        name = self.parameter.name
        if any(p.name == name and p.free for p in self.fit.model.parameters):
            return f"leave out --fix {name}"
        held = "".join(f" --fix {other}=0" for other in self.replaced)
        acting = next(p for p in self.fit.parameters if p.name == name)
        if acting.free:
            return f"free it with --free {name}{held}"
        return f"choose it with --fix {name}={acting.start:g}{held}"

    def sentence(self, stated: FitResult) -> str:
        """Return a sentence on the effect of the parameter on the fit, and the options to use."""
        share = f"{100.0 * (1.0 - self.fit.cost / stated.cost):.3g} % of the squared residuals"
        explains = "the trials as well"
        if not self.replaced:
            explains = f"{share} ({blocks.p_text(self.p_value)})"
        elif self.evidence > STRONG:
            explains = f"{share} with no more unknowns"
        return f"{self.text} would explain {explains}: {self.command}"


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
            if distance > 2.0 * error:
                error = math.hypot(error, _force_error(fit, name))
            # unlike the standard error, the likelihood ratio does not depend on the parametrisation
            z = min(distance / error, math.sqrt(max(evidence, 0.0)))
            sides = 1.0 if parameter.start in parameter.bounds else 2.0
            p_value = min(1.0, len(held) * sides * float(special.ndtr(-z)))
            if p_value < SIGNIFICANCE and evidence > 0.0:
                found.append(Omitted(parameter, fit, (), evidence, p_value))
        fit, replaced = _fit_replacement(stated, parameter)
        if fit is not None and fit.status.get(name, "fixed") in ("estimated", "fixed"):
            evidence = compute_evidence(stated, fit)
            if evidence > -STRONG and find_moved(stated, fit):
                found.append(Omitted(parameter, fit, replaced, evidence, math.nan))
    return sorted(found, key=lambda omitted: omitted.criterion)


def fit_freed(stated: FitResult, name: str) -> FitResult | None:
    """Return the best fit with one more free parameter, from several start values; None if all fail."""
    held = next((p for p in stated.parameters if p.name == name and not p.free), None)
    if held is None:
        return None
    return _fit_from_starts(stated, held, chosen(stated.parameters, freed=(name,)))


def _force_error(fit: FitResult, name: str) -> float:
    """Return the standard error of an estimate due to the noise of a measured force, to first order.

    Noise of the force moves the simulated body on a random walk. The autocorrelation of the residuals shows
    only a part of this motion. The size of the noise is estimated from third differences, because a smooth
    force has hardly any.
    """
    fitted = [t for t in fit.trials if t.role == "fit"]
    if not any("force_N" in t.inputs for t in fitted):
        return 0.0
    rng = np.random.default_rng(0)
    theta = np.asarray(fit.estimate, dtype=float)
    problem = output_error.weighted(fit)
    before = problem.residuals(theta)
    inverse = np.linalg.pinv(problem.jacobian(theta) * problem.scale)[fit.labels.index(name)]
    moves = []
    for _ in range(N_DRAWS):
        disturbed = []
        for trial in fitted:
            force = trial.inputs["force_N"]
            noise = rng.normal(0.0, third_difference_sd(force), len(force))
            disturbed.append(replace(trial, inputs={**trial.inputs, "force_N": force + noise}))
        problem = output_error.weighted(replace(fit, trials=tuple(disturbed)))
        moves.append(float(inverse @ (problem.residuals(theta) - before)))
    return float(problem.scale[fit.labels.index(name)] * np.sqrt(np.mean(np.square(moves))))


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
    sentences = [o.sentence(stated) for o in omitted[:MAX_NAMED]]
    if len(omitted) > MAX_NAMED:
        sentences.append(f"{len(omitted) - MAX_NAMED} more parameters, less well")
    warn("SWM024", "; ".join(sentences))
    best = omitted[0]
    moved = find_moved(stated, best.fit)
    text = f"with it {', '.join(moved)} would lie outside the stated interval" * bool(moved)
    check = ev.check(name, best.text, False, limit, text, reason=f"the trials speak for {best.text}")
    if moved and -best.criterion > STRONG:
        check.verdict = "fail"
    return check


# ------------------------------------------------------------ differences between trials


@dataclass(frozen=True)
class Explained:
    """A fit that describes differences between trials, with its entries for parameter file and report."""

    result: FitResult
    #: Entries for the settings in the parameter file.
    facts: dict[str, Any] = field(default_factory=dict)
    derived: dict[str, Estimate] = field(default_factory=dict)
    checks: list[ev.Check] = field(default_factory=list)


def explain_trials(
    plain: FitResult,
    choices: tuple[Parameter, ...],
    pulling_kg: Mapping[str, float | None],
    odd: OutlierTrial | None,
    *,
    insist: bool,
) -> Explained:
    """Return a fit with a start state or a friction of each trial, if the data clearly support it.

    Parameters
    ----------
    plain : FitResult
        Fit with all trials starting at rest, and without per-trial parameters.
    choices : tuple of Parameter
        Parameters with the choices of the user.
    pulling_kg : mapping of str to float
        Pulling mass of each trial, kg.
    odd : OutlierTrial or None
        Trial that contradicts the others.
    insist : bool
        Whether to estimate a friction of each trial without comparing it with other explanations.

    Raises
    ------
    NoTrustworthyResult
        If ``insist`` is true and the trials do not determine the friction.
    """
    if insist:
        return _explain_friction(plain, pulling_kg, odd, *_fit_friction(plain, odd))
    fits: dict[str, FitResult] = {}
    for name in STARTS:
        rival = fit_freed(plain, name)
        if rival is not None and _is_significant(plain, rival):
            fits[name] = rival
    with suppress(NoTrustworthyResult):
        with_friction, spread = _fit_friction(plain, odd)
        if spread.p_value < HETEROGENEITY:
            fits[FRICTION] = with_friction
    omitted = find_omitted(plain)
    least = min((squared_error(rival) for rival in fits.values()), default=math.inf)
    if not fits or (omitted and squared_error(omitted[0].fit) < SHARED_RATIO * least):
        return Explained(plain, {"start_state": "rest"}, checks=[omission_check(plain, omitted)])
    reason = min(fits, key=lambda name: squared_error(fits[name]))
    if reason == FRICTION:
        return _explain_friction(plain, pulling_kg, odd, with_friction, spread)
    best = fits[reason]
    unit = next(p.unit for p in choices if p.name == reason)
    warn(
        "SWM017",
        f"the trials start {STARTS[reason]}; {reason} is estimated for each ({_list_values(best, reason)} "
        f"{unit}). Use --start-state rest to insist on rest at the first sample",
    )
    # test again, because the start states may have absorbed a part of the omitted effect
    return Explained(best, {"start_state": reason}, checks=[omission_check(best, find_omitted(best))])


def find_odd(plain: FitResult) -> OutlierTrial | None:
    """Return the outlier trial; search for it only if residuals are coloured or trials disagree."""
    if plain.scatter_p < HETEROGENEITY or any(len(n.autoregression) for n in plain.noise.values()):
        return find_outlier_trial(plain)
    return None


def odd_check(result: FitResult, odd: OutlierTrial) -> ev.Check:
    """Return the check that no trial contradicts the others; warn of the trial that does."""
    units = {p.name: p.unit for p in result.parameters}
    without = "; ".join(
        f"{label} {numbers.measured(odd.others.value(label), odd.others.stderr(label), units[label])}"
        for label in odd.others.shared
    )
    return fit_common.warned_check(
        "SWM071",
        "no trial contradicts the others",
        f"{odd.trial}: {numbers.number(odd.error_ratio, 2)} times the others' error",
        False,
        f"below {MIN_ERROR_RATIO:g} times, or p ≥ {OUTLIER_P_VALUE:g}",
        f"without it: {without}. Check its entry in the trials file (pulling mass, force, unit), or leave it "
        "out of the fit with role: validate",
        f"{odd.trial} contradicts the other trials",
        failed=bool(find_moved(result, odd.others)),
    )


def _fit_friction(plain: FitResult, odd: OutlierTrial | None) -> tuple[FitResult, between_trials.Spread]:
    """Return the fit with friction as a random effect, and its standard deviation between trials.

    Raises
    ------
    NoTrustworthyResult
        If the trials do not determine the friction.
    """
    pulled = [t for t in plain.trials if t.role == "fit" and t.rig.pulley]
    reason = ""
    if not any(p.name == FRICTION for p in plain.parameters) or len(pulled) < between_trials.MIN_TRIALS:
        reason = f"it takes at least {between_trials.MIN_TRIALS} trials with a pulley"
    elif COMMON_FRICTION not in plain.labels:
        reason = f"{COMMON_FRICTION} is held"
    if reason:
        raise NoTrustworthyResult(f"{FRICTION} cannot be estimated: {reason}")
    # start from the fit of the other trials, because an outlier moves the estimates out of the linear range
    near = odd.others if odd is not None and COMMON_FRICTION in odd.others.labels else None
    return between_trials.fit_random_effect(plain, FRICTION, COMMON_FRICTION, near=near)


def _explain_friction(
    plain: FitResult,
    pulling_kg: Mapping[str, float | None],
    odd: OutlierTrial | None,
    with_friction: FitResult,
    spread: between_trials.Spread,
) -> Explained:
    """Return the fit with friction as a random effect, or the plain fit if friction is not random."""
    facts: dict[str, Any] = {"start_state": "rest"}
    if spread.sd == 0.0:
        return Explained(plain, facts)
    checks = [omission_check(with_friction, find_omitted(with_friction))]
    # leave out the outlier, which could cause a trend or hide one
    others = with_friction if odd is None else odd.others
    own = between_trials.estimate_own_values(others, FRICTION, COMMON_FRICTION)
    pulling = np.array([pulling_kg.get(name) or math.nan for name in own.trials])
    trend = between_trials.estimate_trend(own, pulling)
    refused = ""
    if trend.p_value < TREND_P:
        verb = "grows" if trend.slope > 0 else "falls"
        refused = f"{verb} with its pulling mass, by {numbers.measured(trend.slope, trend.stderr, 'N/kg')}"
        warn(
            "SWM070",
            f"the friction of each trial {refused} (p = {trend.p_value:.1g}). This is not a random variation "
            "but a force that the model lacks, such as another law of drag or a bearing under load. Find it "
            "with: swimid diagnose TRIALS --params FILE",
        )
    elif spread.sd > others.value(COMMON_FRICTION):
        refused = "varies by more than its mean, so that it would push in some trials"
        warn("SWM072", f"the friction of each trial {refused}: it is not a friction")
    if refused:
        name, limit = "friction differs by chance only", f"no trend (p ≥ {TREND_P:g}), none that pushes"
        text = "all parameters absorb a part of what the model lacks"
        reason = f"the friction of each trial {refused}"
        checks.append(ev.check(name, refused, False, limit, text, otherwise="fail", reason=reason))
        return Explained(plain, facts, checks=checks)
    size = numbers.measured(spread.sd, spread.stderr, "N")
    warn(
        "SWM014",
        f"the pulley friction differs from trial to trial by {size} ({_list_values(with_friction, FRICTION)} "
        "N): a random effect; the standard errors allow for it",
    )
    estimate = Estimate(value=spread.sd, stderr=spread.stderr, unit="N", status="estimated")
    facts["friction"] = "random effect of each trial"
    return Explained(with_friction, facts, {"friction_spread": estimate}, checks)


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


def _list_values(result: FitResult, name: str) -> str:
    """List the values of a per-trial parameter as text."""
    return ", ".join(
        f"{label[len(name) + 1 : -1]} {value:+.3g}"
        for label, value in zip(result.labels, result.estimate, strict=True)
        if label.startswith(f"{name}[")
    )


# ------------------------------------------------------------ measured force


def force_checks(result: FitResult) -> list[ev.Check]:
    """Return the checks of the measured force of towed trials; warn of each check that fails."""
    return [_sign_check(result), *_rest_check(result)]


def _sign_check(result: FitResult) -> ev.Check:
    """Check that no trial fits better if the sign of the force is changed."""
    name, limit = "sign of force_N", "no trial agrees better with -force_N"
    fitted = [t for t in result.trials if t.role == "fit"]
    channel = next(s.channel for s in result.series if s.role == "fit")

    def mean_square(trial: Trial, values: Array) -> float:
        if channel not in trial.measured:
            return math.nan
        simulated = result.model.simulate(values, trial)[channel]
        return float(np.nanmean((trial.measured[channel] - simulated) ** 2))

    def turned(trial: Trial) -> Trial:
        return replace(trial, inputs={**trial.inputs, "force_N": -trial.inputs["force_N"]})

    # simulate with the start values, because a fit to a force of the wrong sign makes the body so heavy that
    # no force moves it
    start = np.array([p.start for p in result.model.parameters])
    suspects = [t.id for t in fitted if mean_square(turned(t), start) < mean_square(t, start)]
    trials = list(result.trials)
    for k, trial in enumerate(trials):
        if trial.id in suspects:
            trials[k] = turned(trial)
    found = None
    if suspects:
        with suppress(NoTrustworthyResult), recorded():
            found = output_error.fit(result.model, trials, parameters=result.parameters, tested=False)
    if found is None or compute_evidence(result, found) <= STRONG:
        return ev.check(name, "as stated", True, limit)
    where = ", ".join(sorted(suspects))
    if len(suspects) == len(fitted):
        where = "all trials"
    unit = next(c.unit for c in result.model.channels if c.name == channel)
    rmse = []
    for fit, shown in ((result, result.trials), (found, trials)):
        squares = [mean_square(t, fit.values(t.id)) for t in shown if t.role == "fit"]
        rmse.append(numbers.number(math.sqrt(float(np.mean(squares))), 2, unit))
    reason = f"with force_N times -1 in {where} the error of {channel} falls from {rmse[0]} to {rmse[1]}"
    text = (
        "force_N must be the force on the body, positive along x_m: turn its sign in the log, or with "
        "factor: -1 in the mapping of an import"
    )
    check = ("SWM110", name, f"wrong in {where}", False, limit, text, reason)
    return fit_common.warned_check(*check, failed=True)


def _rest_check(result: FitResult) -> list[ev.Check]:
    """Check that the force is zero while the body is at rest, within its offset and the dry friction."""
    loads = {}
    for trial in result.trials:
        count = _count_still(trial)
        if trial.role == "fit" and count >= MIN_SAMPLES:
            loads[trial.id] = _load_at_rest(result, trial, count)
    if not loads:
        return []
    name, allowed = "force at rest", f"zero (p ≥ {SIGNIFICANCE:g})"
    beyond = {trial: load for trial, load in loads.items() if load[2] < SIGNIFICANCE / len(loads)}
    if not beyond:
        return [ev.check(name, "zero within its noise", True, allowed)]
    worst = min(beyond, key=lambda trial: beyond[trial][2])
    size = numbers.measured(*beyond[worst][:2], "N")
    text = (
        f"it is not zero in {len(beyond)} of {len(loads)} trials that begin at rest: a sensor that was not "
        "tared (--free force_offset), one that drifts (--free force_drift), or dry friction that holds the "
        "body (--free dry_friction)"
    )
    reason = f"force_N is {size} in {worst} while the body stands still"
    check = ("SWM111", name, f"{size} in {worst}", False, allowed, text, reason)
    return [fit_common.warned_check(*check)]


def _count_still(trial: Trial) -> int:
    """Return the number of samples at the start of a trial in which the body is certainly at rest.

    The result is half the number of samples before the first visible motion, because the force that starts
    the motion begins earlier.
    """
    counts = []
    for values in trial.measured.values():
        there = np.flatnonzero(np.isfinite(values))
        x = values[there]
        if len(x) < 2 * MIN_SAMPLES:
            return 0
        first = float(np.median(x[:MIN_SAMPLES]))
        away = np.flatnonzero(np.abs(x - first) > MOVED_SD * third_difference_sd(x))
        counts.append(int(there[away[0]] if len(away) else 0))
    return min(counts, default=0) // 2


def _load_at_rest(result: FitResult, trial: Trial, count: int) -> tuple[float, float, float]:
    """Return the mean force at rest that the fit does not explain, its standard error, and its p-value."""
    drift = result.value("force_drift") * (trial.time_s - trial.rig.begin_s)
    force: Array = (trial.inputs["force_N"] + result.value("force_offset") + drift)[:count]
    mean = float(force.mean())
    error = math.sqrt(float(long_run_covariance((force - mean)[:, None])[0, 0])) / count
    excess = max(abs(mean) - result.value("dry_friction"), 0.0)
    errors = (result.stderr("force_offset") or 0.0, result.stderr("dry_friction") or 0.0)
    z = excess / math.hypot(error, *errors, 1e-300)
    return mean, error, 2.0 * float(special.ndtr(-z))
