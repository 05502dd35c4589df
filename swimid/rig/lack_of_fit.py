"""Lack-of-fit tests of a rig: parameters left out, differences between trials, and the measured force.

Every parameter that all trials share and that is held is tried in two ways. First it is freed beside the
others. The fit is judged by the parameter's standard error, which allows for coloured residuals and for
trials that disagree. Then it is put in the place of those that act alike (:data:`swimid.rig.model.ALIKE`):
dry friction in the place of a linear damping, gravity in the place of a spring. This fit has no more
unknowns than the stated one, so that their likelihoods can be compared. One test thus serves every
parameter. The measured force of a tow is tested for its sign, and for its value while the body stands still.

References
----------
.. [1] R. E. Kass, A. E. Raftery, "Bayes factors", Journal of the American Statistical Association 90 (1995),
   773-795: evidence is strong where twice the logarithm of the Bayes factor is above 6.
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
from swimid.fitting import between_trials, fit_common, output_error, restarts
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

#: Start values of a parameter that was held, in its scale from the value at which it was held.
FREED_STARTS = (0.0, 1.0, -1.0)
#: Twice the logarithm of a likelihood ratio that is strong evidence (Kass and Raftery).
STRONG = 6.0
#: Number of draws of the noise of a measured force.
N_DRAWS = 30
#: Maximum number of parameters that the warning names.
MAX_NAMED = 3
#: Largest p-value and largest share of the squared error at which a start of their own is taken for trials.
START_P, START_SHARE = 1e-6, 0.8
#: Parameters of the start of a trial, and the words for a trial that has them.
STARTS = {"initial_speed": "moving", "clock_offset": "at another time than their first sample"}
#: The friction of a trial, and the common one from which it deviates.
FRICTION, COMMON = "friction_deviation", "pulley_friction"
#: Largest p-value at which a friction follows the pulling mass.
TREND = 1e-2


@dataclass(frozen=True)
class Omitted:
    """A parameter for which the trials speak, although the fit holds it."""

    parameter: Parameter
    #: The fit with it.
    fit: FitResult
    #: The parameters in whose place it stands; empty where it is freed beside them.
    instead: tuple[str, ...]
    #: Twice the logarithm of the likelihood ratio, above zero where the fit with it is the better one.
    evidence: float
    #: Probability of an estimate this far from the held value by chance, Bonferroni for all held parameters.
    p_value: float

    @property
    def text(self) -> str:
        """Its name and its estimate."""
        name = self.parameter.name
        size = numbers.measured(self.fit.value(name), self.fit.stderr(name), self.parameter.unit)
        return f"{name} {size}" + (f" in the place of {', '.join(self.instead)}" if self.instead else "")

    @property
    def criterion(self) -> float:
        """Schwarz's criterion against the stated fit: minus twice the logarithm of the Bayes factor."""
        return (0.0 if self.instead else math.log(self.fit.samples)) - self.evidence

    @property
    def command(self) -> str:
        """The options that fit with it."""
        if any(p.name == self.parameter.name and p.free for p in self.fit.model.parameters):
            return f"leave out --fix {self.parameter.name}"
        held = "".join(f" --fix {name}=0" for name in self.instead)
        acting = next(p for p in self.fit.parameters if p.name == self.parameter.name)
        if acting.free:
            return f"free it with --free {acting.name}{held}"
        return f"choose it with --fix {acting.name}={acting.start:g}{held}"


def omitted_parameters(plain: FitResult) -> list[Omitted]:
    """Return the held parameters for which the trials speak, the best fit first.

    A freed one counts where chance would take its estimate this far from the held value with a probability
    below :data:`SIGNIFICANCE`, all held ones together. One in the place of others counts where the evidence
    for the stated fit is not :data:`STRONG`, and a stated 95 % interval lacks its answer.
    """
    held = [p for p in plain.parameters if not p.free and not p.per_trial]
    found = []
    for parameter in held:
        fit = freed(plain, parameter.name)
        error = None if fit is None else fit.stderr(parameter.name)
        if fit is not None and error and fit.status[parameter.name] == "estimated":
            away = abs(fit.value(parameter.name) - parameter.start)
            # what is far from chance without the noise of a measured force is looked at with it
            noise = _force_error(fit, parameter.name) if away > 2.0 * error else 0.0
            z = away / math.hypot(error, noise)
            sides = 1.0 if parameter.start in parameter.bounds else 2.0
            # the likelihood ratio does not depend on how a parameter is scaled, as the standard error does
            z = min(z, math.sqrt(max(compute_evidence(plain, fit), 0.0)))
            p_value = min(1.0, len(held) * sides * float(special.ndtr(-z)))
            if p_value < SIGNIFICANCE and compute_evidence(plain, fit) > 0.0:
                found.append(Omitted(parameter, fit, (), compute_evidence(plain, fit), p_value))
        fit, instead = _replacing(plain, parameter)
        acts = fit is not None and fit.status.get(parameter.name, "fixed") in ("estimated", "fixed")
        if fit is not None and acts and compute_evidence(plain, fit) > -STRONG and moved(plain, fit):
            found.append(Omitted(parameter, fit, instead, compute_evidence(plain, fit), math.nan))
    return sorted(found, key=lambda omitted: omitted.criterion)


def freed(plain: FitResult, name: str) -> FitResult | None:
    """Return the best fit with one more parameter free, from several starts; None where there is none."""
    held = next((p for p in plain.parameters if p.name == name and not p.free), None)
    return None if held is None else _best(plain, held, chosen(plain.parameters, freed=(name,)))


def _force_error(fit: FitResult, name: str) -> float:
    """Return the standard error of an estimate that the noise of a measured force makes, to first order.

    Noise of a force moves the simulated body on a random walk. The autocorrelation of the residuals shows
    only a part of that. The size of the noise comes from third differences, which a smooth force hardly has,
    and its effect on the estimate from :data:`N_DRAWS` simulations.
    """
    fitted = [t for t in fit.trials if t.role == "fit"]
    if not any("force_N" in t.inputs for t in fitted):
        return 0.0
    rng = np.random.default_rng(0)
    problem = restarts.weighted(fit)
    try:
        theta = np.asarray(fit.estimate, dtype=float)
        before = problem.residuals(theta)
        inverse = np.linalg.pinv(problem.jacobian(theta) * problem.scale)[fit.labels.index(name)]
    finally:
        problem.close()
    moves = []
    for _ in range(N_DRAWS):
        disturbed = []
        for trial in fitted:
            force = trial.inputs["force_N"]
            sd = third_difference_sd(force)
            disturbed.append(
                replace(trial, inputs={**trial.inputs, "force_N": force + rng.normal(0.0, sd, len(force))})
            )
        problem = restarts.weighted(replace(fit, trials=tuple(disturbed)))
        try:
            moves.append(float(inverse @ (problem.residuals(theta) - before)))
        finally:
            problem.close()
    return float(problem.scale[fit.labels.index(name)] * np.sqrt(np.mean(np.square(moves))))


def _replacing(plain: FitResult, held: Parameter) -> tuple[FitResult | None, tuple[str, ...]]:
    """Return the fit with a parameter in the place of those that act alike, and their names.

    A parameter that the user holds against the model's default is not meant to act.
    """
    alike = next((names for names in ALIKE if held.name in names), ())
    others = [p for p in plain.parameters if p.name in alike and p is not held and (p.free or p.start != 0.0)]
    by_default = any(p.name == held.name and not p.free for p in plain.model.parameters)
    if (
        not others
        or not by_default
        or held.start != 0.0
        or not all(p.lower <= 0.0 <= p.upper for p in others)
    ):
        return None, ()
    names = tuple(p.name for p in others)
    parameters = chosen(plain.parameters, fixed=dict.fromkeys(names, 0.0), freed=(held.name,))
    if not any(p.free for p in others):
        whole = sum(p.start for p in others)
        parameters = chosen(plain.parameters, fixed={**dict.fromkeys(names, 0.0), held.name: whole})
    return _best(plain, held, parameters), names


def _best(plain: FitResult, held: Parameter, parameters: tuple[Parameter, ...]) -> FitResult | None:
    """Return the best fit with other choices of parameters, from several values of the one that was held."""
    free = any(p.name == held.name and p.free for p in parameters)
    fits = []
    for start in FREED_STARTS if free else FREED_STARTS[:1]:
        value = held.start + start * held.scale
        if not held.lower <= value <= held.upper:
            continue
        begun = []
        for p in parameters:
            known = p.free and p.name in plain.labels
            begun.append(replace(p, start=plain.value(p.name)) if known else p)
        if free:
            begun = [replace(p, start=value) if p.name == held.name else p for p in begun]
        try:
            # a search that ends in a valley is no news where another one ends lower
            with recorded():
                fits.append(output_error.fit(plain.model, plain.trials, parameters=begun, tested=False))
        except NoTrustworthyResult:
            continue
    best = min(fits, key=lambda fit: fit.cost, default=None)
    return None if best is None else replace(best, parameters=parameters)


def compute_evidence(plain: FitResult, fit: FitResult) -> float:
    """Return twice the logarithm of the likelihood ratio of a fit against the stated one."""
    return plain.samples * math.log(max(plain.cost, 1e-300) / max(fit.cost, 1e-300))


def omission_checks(plain: FitResult, omitted: Sequence[Omitted]) -> list[ev.Check]:
    """Return the check that the trials speak for no held parameter; warn of those they speak for."""
    name = "no parameter left out"
    limit = f"p ≥ {SIGNIFICANCE:g}, and no other law explains as much"
    if not omitted:
        held = ", ".join(p.name for p in plain.parameters if not p.free and not p.per_trial)
        return [ev.check(name, "none", True, limit, f"tried, each in a fit of its own: {held or 'none'}")]
    more = f"; {len(omitted) - MAX_NAMED} more parameters, less well" if len(omitted) > MAX_NAMED else ""
    warn("SWM024", "; ".join(_sentence(plain, o) for o in omitted[:MAX_NAMED]) + more)
    best, other = omitted[0], moved(plain, omitted[0].fit)
    text = f"with it {', '.join(other)} would lie outside the stated interval" if other else ""
    reason = f"the trials speak for {best.text}"
    grade = "fail" if other and -best.criterion > STRONG else "warn"
    return [ev.check(name, best.text, False, limit, text, otherwise=grade, reason=reason)]  # type: ignore[arg-type]


def _sentence(plain: FitResult, omitted: Omitted) -> str:
    share = f"{100.0 * (1.0 - omitted.fit.cost / plain.cost):.3g} % of the squared residuals"
    if not omitted.instead:
        return f"{omitted.text} would explain {share} ({blocks.p_text(omitted.p_value)}): {omitted.command}"
    if omitted.evidence > STRONG:
        return f"{omitted.text} would explain {share} with no more unknowns: {omitted.command}"
    return f"{omitted.text} would explain the trials as well: {omitted.command}"


def moved(stated: FitResult, other: FitResult) -> list[str]:
    """Return the shared parameters whose stated 95 % interval lacks the other fit's value."""
    found = []
    for label in stated.shared:
        if stated.status[label] == "unidentifiable":
            continue
        error = stated.stderr(label)
        if error is None or abs(other.value(label) - stated.value(label)) > 1.96 * error:
            found.append(label)
    return found


# ------------------------------------------------------------ single trials


@dataclass(frozen=True)
class Explained:
    """A fit, and what was found to differ between its trials; ``facts`` are for the file's settings."""

    result: FitResult
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
    """Return the fit with starts or frictions of single trials, where the data clearly speak for them.

    The start of each trial is its own and may be anything. The friction of a pulley differs by chance: it
    is a random effect, and one that follows the pulling mass is no chance but a force the model lacks.

    Parameters
    ----------
    plain : FitResult
        From rest, with nothing of single trials.
    choices : tuple of Parameter
        The user's.
    pulling_kg : mapping of trial to mass
    odd : OutlierTrial or None
        The trial that contradicts the others.
    insist : bool
        The user frees the friction of each trial, so that nothing else is tried.

    Raises
    ------
    NoTrustworthyResult
        When a friction was insisted on that these trials do not tell.
    """
    if insist:
        return _by_chance(plain, pulling_kg, odd, *_friction(plain, odd))
    fits: dict[str, FitResult] = {}
    for name in STARTS:
        rival = freed(plain, name)
        if rival is not None and _significant(plain, rival):
            fits[name] = rival
    with suppress(NoTrustworthyResult):
        chance, spread = _friction(plain, odd)
        if spread.p_value < HETEROGENEITY:
            fits[FRICTION] = chance
    omitted = omitted_parameters(plain)
    least = min((misfit(rival) for rival in fits.values()), default=math.inf)
    if not fits or (omitted and misfit(omitted[0].fit) < 1.1 * least):
        # one number for all trials explains as much as one for each
        return Explained(plain, {"start_state": "rest"}, checks=omission_checks(plain, omitted))
    reason = min(fits, key=lambda name: misfit(fits[name]))
    if reason == FRICTION:
        return _by_chance(plain, pulling_kg, odd, chance, spread)
    best = fits[reason]
    unit = next(p.unit for p in choices if p.name == reason)
    warn(
        "SWM017",
        f"the trials start {STARTS[reason]}; {reason} is estimated for each ({_own(best, reason)} {unit}). "
        "Use --start-state rest to insist on rest at the first sample",
    )
    # starts of their own take up a part of what all trials lack
    return Explained(best, {"start_state": reason}, checks=omission_checks(best, omitted_parameters(best)))


def odd_one(plain: FitResult) -> OutlierTrial | None:
    """The trial that contradicts the others, where residuals give reason to look for one."""
    coloured = any(len(n.autoregression) for n in plain.noise.values())
    return find_outlier_trial(plain) if coloured or plain.scatter_p < HETEROGENEITY else None


def odd_check(result: FitResult, odd: OutlierTrial) -> ev.Check:
    """Return the check that one trial contradicts the others; warn of it."""
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
        failed=bool(moved(result, odd.others)),
    )


# ------------------------------------------------------------ friction by chance


def _friction(plain: FitResult, odd: OutlierTrial | None) -> tuple[FitResult, between_trials.Spread]:
    """The fit with a friction that differs by chance; raises where these trials do not tell it."""
    pulled = [t for t in plain.trials if t.role == "fit" and t.rig.pulley]
    reason = ""
    if not any(p.name == FRICTION for p in plain.parameters) or len(pulled) < between_trials.MIN_TRIALS:
        reason = f"it takes at least {between_trials.MIN_TRIALS} trials with a pulley"
    elif COMMON not in plain.labels:
        reason = f"{COMMON} is held"
    if reason:
        raise NoTrustworthyResult(f"{FRICTION} cannot be estimated: {reason}")
    # where the others agree the model is nearly linear; pulled off by an odd one it is not
    near = odd.others if odd is not None and COMMON in odd.others.labels else None
    return between_trials.fit_random_effect(plain, FRICTION, COMMON, near=near)


def _by_chance(
    plain: FitResult,
    pulling_kg: Mapping[str, float | None],
    odd: OutlierTrial | None,
    chance: FitResult,
    spread: between_trials.Spread,
) -> Explained:
    facts: dict[str, Any] = {"start_state": "rest"}
    if spread.sd == 0.0:
        return Explained(plain, facts)
    checks = omission_checks(chance, omitted_parameters(chance))
    # an odd trial has a reason of its own: it neither makes a trend nor hides one
    others = chance if odd is None else odd.others
    own = between_trials.estimate_own_values(others, FRICTION, COMMON)
    trend = between_trials.estimate_trend(
        own, np.array([pulling_kg.get(name) or math.nan for name in own.trials])
    )
    refused = ""
    if trend.p_value < TREND:
        slope = numbers.measured(trend.slope, trend.stderr, "N/kg")
        refused = f"{'grows' if trend.slope > 0 else 'falls'} with its pulling mass, by {slope}"
        warn(
            "SWM070",
            f"the friction that each trial asks for {refused} (p = {trend.p_value:.1g}): that is no chance "
            "but a force the model lacks, and is not taken up by a friction of each trial. A drag of another "
            "law does this, or a bearing under load",
        )
    elif spread.sd > others.value(COMMON):
        # a force that only brakes does not scatter by more than there is of it
        refused = "would push in some trials: it differs by more than there is of it"
        warn("SWM072", f"the friction that each trial asks for {refused}, so it is not taken for a friction")
    if refused:
        name, limit = "friction differs by chance only", f"no trend (p ≥ {TREND:g}), none that pushes"
        text = "all parameters take up a part of what the model lacks"
        reason = f"the friction that each trial asks for {refused}"
        checks.append(ev.check(name, refused, False, limit, text, otherwise="fail", reason=reason))
        return Explained(plain, facts, checks=checks)
    size = numbers.measured(spread.sd, spread.stderr, "N")
    warn(
        "SWM014",
        f"the pulley friction differs from trial to trial by {size} ({_own(chance, FRICTION)} N): a random "
        "effect; the standard errors allow for it",
    )
    estimate = Estimate(value=spread.sd, stderr=spread.stderr, unit="N", status="estimated")
    facts["friction"] = "random effect of each trial"
    return Explained(chance, facts, {"friction_spread": estimate}, checks)


# ------------------------------------------------------------ the start of a trial


def _significant(plain: FitResult, rival: FitResult) -> bool:
    """Whether the rival's extra unknowns lower the error beyond what coloured noise allows."""
    extra = len(rival.labels) - len(plain.labels)
    before, after = misfit(plain), misfit(rival)
    if after <= 0 or before <= after or after > START_SHARE * before:
        return False
    colour = 1.0
    for noise in rival.noise.values():
        if len(noise.autoregression):
            series = np.concatenate([s.weighted for s in rival.series if s.role == "fit"])
            fitted = fit_autoregression(series, order=len(noise.autoregression))
            colour = max(colour, fitted.long_run_variance / float(np.nanvar(series)))
    statistic = (before - after) / (after / max(rival.samples - len(rival.labels), 1)) / colour
    return bool(special.chdtrc(extra, statistic) < START_P)


def misfit(result: FitResult) -> float:
    """Sum of squared residuals of the fitted trials."""
    return float(sum(np.nansum(s.residual**2) for s in result.series if s.role == "fit"))


# ------------------------------------------------------------ words


def _own(result: FitResult, name: str) -> str:
    """The trials' values of a parameter."""
    labels = [label for label in result.labels if label.startswith(f"{name}[")]
    return ", ".join(
        f"{label[len(name) + 1 : -1]} {result.estimate[result.labels.index(label)]:+.3g}" for label in labels
    )


# ------------------------------------------------------------ measured force


#: Minimum number of samples of a stretch in which a body stands still.
MIN_SAMPLES = 10
#: Excursion beyond which a body has moved, in standard deviations of its noise.
MOVED = 5.0


def force_checks(result: FitResult) -> list[ev.Check]:
    """Return the checks of the measured force of a fit of towed trials; warn of those that fail."""
    return [_sign(result), *_at_rest(result)]


def _sign(result: FitResult) -> ev.Check:
    """Check that trials are not described better with the force turned round."""
    name, limit = "sign of force_N", "no trial agrees better with -force_N"
    fitted = [t for t in result.trials if t.role == "fit"]
    # at the start values, because a fit to the wrong sign makes the body so heavy that no force moves it
    start = np.array([p.start for p in result.model.parameters])
    suspects = {t.id for t in fitted if _error(result, _turned(t), start) < _error(result, t, start)}
    turned = [_turned(t) if t.id in suspects else t for t in result.trials]
    found = None
    if suspects:
        try:
            with recorded():
                found = output_error.fit(result.model, turned, parameters=result.parameters, tested=False)
        except NoTrustworthyResult:
            found = None
    if found is None or compute_evidence(result, found) <= STRONG:
        return ev.check(name, "as stated", True, limit)
    where = "all trials" if len(suspects) == len(fitted) else ", ".join(sorted(suspects))
    before, after = (
        math.sqrt(float(np.mean([_error(r, t, r.values(t.id)) for t in trials if t.role == "fit"])))
        for r, trials in ((result, result.trials), (found, turned))
    )
    unit = next(c.unit for c in result.model.channels if c.name == _channel(result))
    change = f"from {numbers.number(before, 2, unit)} to {numbers.number(after, 2, unit)}"
    reason = f"with force_N times -1 in {where} the error of {_channel(result)} falls {change}"
    text = (
        "force_N must be the force on the body, positive along x_m: turn its sign in the log, or with "
        "factor: -1 in the mapping of an import"
    )
    check = ("SWM110", name, f"wrong in {where}", False, limit, text, reason)
    return fit_common.warned_check(*check, failed=True)


def _turned(trial: Trial) -> Trial:
    return replace(trial, inputs={**trial.inputs, "force_N": -trial.inputs["force_N"]})


def _channel(result: FitResult) -> str:
    return next(s.channel for s in result.series if s.role == "fit")


def _error(result: FitResult, trial: Trial, values: Array) -> float:
    """Return the mean squared error of one trial, of the first measured channel."""
    channel = _channel(result)
    if channel not in trial.measured:
        return math.nan
    seen = result.model.simulate(values, trial)[channel]
    return float(np.nanmean((trial.measured[channel] - seen) ** 2))


def _at_rest(result: FitResult) -> list[ev.Check]:
    """Check that the force is zero while the body stands still, as far as offset and friction allow."""
    stretches = {t.id: n for t in result.trials if t.role == "fit" and (n := _still(t)) >= MIN_SAMPLES}
    if not stretches:
        return []
    loads = {t.id: _load(result, t, stretches[t.id]) for t in result.trials if t.id in stretches}
    limit = SIGNIFICANCE / len(loads)
    beyond = {name: load for name, load in loads.items() if load[2] < limit}
    name, allowed = "force at rest", f"zero (p ≥ {SIGNIFICANCE:g})"
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


def _still(trial: Trial) -> int:
    """Return the number of samples at the start of a trial in which the body stands still.

    It is half of those before a motion shows, because the force that makes it begins earlier.
    """
    counts = []
    for values in trial.measured.values():
        there = np.flatnonzero(np.isfinite(values))
        x = values[there]
        if len(x) < 2 * MIN_SAMPLES:
            return 0
        noise = third_difference_sd(x)
        first = float(np.median(x[:MIN_SAMPLES]))
        away = np.flatnonzero(np.abs(x - first) > MOVED * noise)
        counts.append(int(there[away[0]]) if len(away) else 0)
    return min(counts, default=0) // 2


def _load(result: FitResult, trial: Trial, count: int) -> tuple[float, float, float]:
    """Return the mean force that the fit does not explain at rest, its standard error, and its p-value."""
    values: Mapping[str, float] = {p.name: result.value(p.name) for p in result.parameters if not p.per_trial}
    drift = values["force_drift"] * (trial.time_s - trial.rig.begin_s)
    force: Array = (trial.inputs["force_N"] + values["force_offset"] + drift)[:count]
    mean = float(force.mean())
    error = math.sqrt(float(long_run_covariance((force - mean)[:, None])[0, 0])) / count
    over = max(abs(mean) - values["dry_friction"], 0.0)
    z = over / math.hypot(
        error, result.stderr("force_offset") or 0.0, result.stderr("dry_friction") or 0.0, 1e-300
    )
    return mean, error, 2.0 * float(special.ndtr(-z))
