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
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from scipy import special

from swimid.errors import NoTrustworthyResult
from swimid.fitting import fit_common, output_error
from swimid.fitting.between_trials import MIN_ERROR_RATIO, OUTLIER_P_VALUE, OutlierTrial, find_outlier_trial
from swimid.fitting.covariance import HETEROGENEITY
from swimid.fitting.metrics import FitResult
from swimid.fitting.model import Parameter, Trial, chosen
from swimid.fitting.noise import SIGNIFICANCE, fit_autoregression
from swimid.notices import recorded, warn
from swimid.results import evidence as ev
from swimid.results import numbers
from swimid.rig.model import ALIKE

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
        share = f"{math.expm1(-self.evidence / self.fit.samples):+.3g}"
        return f"{self.text} would change the squared residuals by {share} of them: use {choice}{held}"


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
    for name in (*STARTS, "friction_deviation"):
        rival = fit_freed(plain, name)
        if rival is not None and _is_significant(plain, rival):
            fits[name] = rival
    omitted = find_omitted(plain)
    reason = min(fits, key=lambda name: squared_error(fits[name]), default="")
    if reason not in STARTS:
        return plain, "rest", omitted
    best = fits[reason]
    if omitted and squared_error(omitted[0].fit) < SHARED_RATIO * squared_error(best):
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
