"""Lack-of-fit test of a rig: do the trials speak for a parameter that the fit holds?

Every parameter that all trials share and that is held is tried in two ways. First it is freed beside the
others. The fit is judged by the parameter's standard error, which allows for coloured residuals and for
trials that disagree. Then it is put in the place of those that act alike (:data:`swimid.rig.model.ALIKE`):
dry friction in the place of a linear damping, gravity in the place of a spring. This fit has no more unknowns
than the stated one, so that their likelihoods can be compared. One test thus serves every parameter.

References
----------
.. [1] R. E. Kass, A. E. Raftery, "Bayes factors", Journal of the American Statistical Association 90 (1995),
   773-795: evidence is strong where twice the logarithm of the Bayes factor is above 6.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import special

from swimid.errors import NoTrustworthyResult
from swimid.fitting import output_error, restarts
from swimid.fitting.fit_result import FitResult
from swimid.fitting.model import Parameter, chosen
from swimid.fitting.residual_tests import SIGNIFICANCE
from swimid.notices import recorded, warn
from swimid.results import blocks, numbers
from swimid.results import evidence as ev
from swimid.rig.encoder import third_difference_sd
from swimid.rig.model import ALIKE

#: Where a parameter that was held starts, in its scale from the value at which it was held.
STARTS = (0.0, 1.0, -1.0)
#: Twice the logarithm of a likelihood ratio that is strong evidence (Kass and Raftery).
STRONG = 6.0
#: Number of draws of the noise of a measured force.
N_DRAWS = 30
#: Maximum number of parameters that the warning names.
MAX_NAMED = 3


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
    for start in STARTS if free else STARTS[:1]:
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
        held = [p.name for p in plain.parameters if not p.free and not p.per_trial]
        tried = f"tried, each in a fit of its own: {', '.join(held)}" if held else "none is held"
        return [blocks.check(name, "none", limit, True, text=tried)]
    more = f"; {len(omitted) - MAX_NAMED} more parameters, less well" if len(omitted) > MAX_NAMED else ""
    warn("SWM024", "; ".join(_sentence(plain, o) for o in omitted[:MAX_NAMED]) + more)
    best = omitted[0]
    contradicted = -best.criterion > STRONG
    other = moved(plain, best.fit)
    text = f"with it {', '.join(other)} would lie outside the stated interval" if other else ""
    return [
        blocks.check(
            name, best.text, limit, False, otherwise="fail" if other and contradicted else "warn", text=text
        )
    ]


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
