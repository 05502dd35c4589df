"""What differs from trial to trial of a rig, and what all of them lack alike."""

from __future__ import annotations

import math
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy import optimize, special

from swimid.errors import NoTrustworthyResult
from swimid.fitting import random_effect
from swimid.fitting.fit_result import FitResult
from swimid.fitting.model import Parameter
from swimid.fitting.odd_trial import ODD, TIMES, Odd, odd_trial
from swimid.fitting.residual_tests import fit_autoregression
from swimid.fitting.sandwich import HETEROGENEITY
from swimid.notices import warn
from swimid.results import blocks, numbers
from swimid.results import evidence as ev
from swimid.results.parameters import Estimate
from swimid.rig.omitted import freed, moved, omission_checks, omitted_parameters

#: Another explanation than rest at the first sample is taken when it improves the fit beyond chance ...
SIGNIFICANCE = 1e-6
#: ... and leaves at most this share of the squared error.
GAIN = 0.8
#: What may differ at the start of a trial, and how a trial that does is described.
STARTS = {
    "initial_speed": "moving",
    "clock_offset": "at another time than their first sample",
}
#: The number that differs by chance, and the shared one it deviates from.
FRICTION, COMMON = "friction_deviation", "pulley_friction"
#: A friction follows a setting when chance would let it do so less often than this.
TREND = 1e-2


@dataclass(frozen=True)
class Explained:
    """A fit, and what was found to differ between its trials; ``facts`` are for the file's settings."""

    result: FitResult
    facts: dict[str, Any] = field(default_factory=dict)
    derived: dict[str, Estimate] = field(default_factory=dict)
    checks: list[ev.Check] = field(default_factory=list)


def explained(
    plain: FitResult,
    choices: tuple[Parameter, ...],
    pulling_kg: Mapping[str, float | None],
    odd: Odd | None,
    *,
    insist: bool,
) -> Explained:
    """What the trials of a falling weight have of their own, where the data clearly say so.

    The start of each trial is its own and may be anything. The friction of a pulley differs by chance: it
    is a random effect, and one that follows the pulling mass is no chance but a force the model lacks.

    Parameters
    ----------
    plain : FitResult
        From rest, with nothing of single trials.
    choices : tuple of Parameter
        The user's.
    pulling_kg : mapping of trial to mass
    odd : Odd or None
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


def odd_one(plain: FitResult) -> Odd | None:
    """The trial that contradicts the others, where residuals give reason to look for one."""
    coloured = any(len(n.autoregression) for n in plain.noise.values())
    return odd_trial(plain) if coloured or plain.scatter_p < HETEROGENEITY else None


def odd_check(result: FitResult, odd: Odd, pulling_kg: Mapping[str, float | None]) -> ev.Check:
    """That one trial contradicts the others, and what that does to the answer; warns of it."""
    units = {p.name: p.unit for p in result.parameters}
    without = "; ".join(
        f"{label} {numbers.measured(odd.others.value(label), odd.others.stderr(label), units[label])}"
        for label in odd.others.labels
        if "[" not in label
    )
    stated, hint = pulling_kg.get(odd.trial), ""
    mass = None if stated is None else _mass_that_fits(odd, stated)
    if mass is not None and stated is not None:
        hint = f" It would agree with a pulling mass of {1e3 * mass:.3g} g; stated are {1e3 * stated:.3g} g."
    times = numbers.number(odd.times, 2)
    warn(
        "SWM071",
        f"{odd.trial} contradicts the other trials: they predict it {times} times worse than one another."
        f"{hint} Without it: {without}. Look at what is written of it, or leave it out of the fit with "
        "role: validate",
    )
    value = f"{odd.trial}: {times} times the others' error"
    limit = f"below {TIMES:g} times, or p ≥ {ODD:g}"
    other = moved(result, odd.others)
    return blocks.check(
        "no trial contradicts the others",
        value,
        limit,
        False,
        otherwise="fail" if other else "warn",
        text=f"without it {', '.join(other)} would lie outside the stated interval" if other else "",
    )


# ------------------------------------------------------------ friction by chance


def _friction(plain: FitResult, odd: Odd | None) -> tuple[FitResult, random_effect.Spread]:
    """The fit with a friction that differs by chance; raises where these trials do not tell it."""
    pulled = [t for t in plain.trials if t.role == "fit" and t.rig.pulley]
    reason = ""
    if not any(p.name == FRICTION for p in plain.parameters) or len(pulled) < random_effect.FEWEST:
        reason = f"it takes at least {random_effect.FEWEST} trials with a pulley"
    elif COMMON not in plain.labels:
        reason = f"{COMMON} is held"
    if reason:
        raise NoTrustworthyResult(f"{FRICTION} cannot be estimated: {reason}")
    # where the others agree the model is nearly linear; pulled off by an odd one it is not
    near = odd.others if odd is not None and COMMON in odd.others.labels else None
    return random_effect.fit(plain, FRICTION, COMMON, near=near)


def _by_chance(
    plain: FitResult,
    pulling_kg: Mapping[str, float | None],
    odd: Odd | None,
    chance: FitResult,
    spread: random_effect.Spread,
) -> Explained:
    facts: dict[str, Any] = {"start_state": "rest"}
    if spread.sd == 0.0:
        return Explained(plain, facts)
    checks = omission_checks(chance, omitted_parameters(chance))
    # an odd trial has a reason of its own: it neither makes a trend nor hides one
    own = random_effect.own_numbers(chance if odd is None else odd.others, FRICTION, COMMON)
    masses = np.array([pulling_kg.get(name) or math.nan for name in own.trials])
    trend = random_effect.trend(own, masses)
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
    elif spread.sd > (chance if odd is None else odd.others).value(COMMON):
        # a force that only brakes does not scatter by more than there is of it
        refused = "would push in some trials: it differs by more than there is of it"
        warn("SWM072", f"the friction that each trial asks for {refused}, so it is not taken for a friction")
    if refused:
        limit = f"no trend (p ≥ {TREND:g}), none that pushes"
        text = "all parameters take up a part of what the model lacks"
        checks.append(
            blocks.check(
                "friction differs by chance only", refused, limit, False, otherwise="fail", text=text
            )
        )
        return Explained(plain, facts, checks=checks)
    warn(
        "SWM014",
        "the pulley friction differs from trial to trial by "
        f"{numbers.measured(spread.sd, spread.stderr, 'N')} ({_own(chance, FRICTION)} N): a random "
        "effect; the standard errors allow for it",
    )
    size = Estimate(value=spread.sd, stderr=spread.stderr, unit="N", status="estimated")
    return Explained(
        chance, {**facts, "friction": "random effect of each trial"}, {"friction_spread": size}, checks
    )


# ------------------------------------------------------------ the start of a trial


def _significant(plain: FitResult, rival: FitResult) -> bool:
    """Whether the rival's extra unknowns lower the error beyond what coloured noise allows."""
    extra = len(rival.labels) - len(plain.labels)
    before, after = misfit(plain), misfit(rival)
    if after <= 0 or before <= after or after > GAIN * before:
        return False
    colour = 1.0
    for noise in rival.noise.values():
        if len(noise.autoregression):
            series = np.concatenate([s.weighted for s in rival.series if s.role == "fit"])
            fitted = fit_autoregression(series, order=len(noise.autoregression))
            colour = max(colour, fitted.long_run_variance / float(np.nanvar(series)))
    statistic = (before - after) / (after / max(rival.samples - len(rival.labels), 1)) / colour
    return bool(special.chdtrc(extra, statistic) < SIGNIFICANCE)


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


def _mass_that_fits(odd: Odd, stated: float) -> float | None:
    """The pulling mass with which the odd trial agrees with the others; None where none does."""
    trial = next(t for t in odd.others.trials if t.id == odd.trial)
    values = odd.others.values(odd.trial)
    channel = odd.others.model.channels[0].name

    def error(log_factor: float) -> float:
        factor = math.exp(log_factor)
        known = replace(
            trial.rig,
            force=trial.rig.pull * factor,
            inertia=trial.rig.inertia + stated * (factor - 1.0),
        )
        seen = odd.others.model.simulate(values, replace(trial, rig=known))
        return float(np.nanmean((trial.measured[channel] - seen[channel]) ** 2))

    grid = np.linspace(-math.log(30.0), math.log(30.0), 121)
    best = int(np.argmin([error(g) for g in grid]))
    if best in (0, len(grid) - 1):
        return None
    ends = (grid[best - 1], grid[best + 1])
    optimum = optimize.minimize_scalar(error, bounds=ends, method="bounded", options={"xatol": 1e-5})
    # it agrees when it is then predicted as well as the others are
    return (
        stated * math.exp(float(optimum.x)) if optimum.fun * odd.times**2 <= TIMES**2 * error(0.0) else None
    )
