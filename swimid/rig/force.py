"""Checks of the measured force of a towed body: its sign, and its value while the body stands still."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from scipy import special

from swimid.errors import NoTrustworthyResult
from swimid.fitting import output_error
from swimid.fitting.fit_result import FitResult
from swimid.fitting.model import Array, Trial
from swimid.fitting.residual_tests import SIGNIFICANCE, long_run_covariance
from swimid.notices import recorded, warn
from swimid.results import blocks, numbers
from swimid.results import evidence as ev
from swimid.rig.encoder import third_difference_sd
from swimid.rig.omitted import STRONG, compute_evidence

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
        return blocks.check(name, "as stated", limit, True)
    where = "all trials" if len(suspects) == len(fitted) else ", ".join(sorted(suspects))
    before, after = (
        math.sqrt(float(np.mean([_error(r, t, r.values(t.id)) for t in trials if t.role == "fit"])))
        for r, trials in ((result, result.trials), (found, turned))
    )
    unit = next(c.unit for c in result.model.channels if c.name == _channel(result))
    change = f"from {numbers.number(before, 2, unit)} to {numbers.number(after, 2, unit)}"
    warn(
        "SWM110",
        f"with force_N times -1 in {where} the error of {_channel(result)} falls {change}: force_N must be "
        "the force on the body, positive along x_m. Turn its sign in the log, or with factor: -1 in the "
        "mapping of an import",
    )
    return blocks.check(
        name, f"wrong in {where}", limit, False, otherwise="fail", text=f"the error falls {change}"
    )


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
        return [blocks.check(name, "zero within its noise", allowed, True)]
    worst = min(beyond, key=lambda trial: beyond[trial][2])
    size = numbers.measured(*beyond[worst][:2], "N")
    warn(
        "SWM111",
        f"force_N is {size} in {worst} while the body stands still, and is not zero in {len(beyond)} of "
        f"{len(loads)} trials that begin at rest: a sensor that was not tared (--free force_offset), one "
        "that drifts (--free force_drift), or dry friction that holds the body (--free dry_friction)",
    )
    return [blocks.check(name, f"{size} in {worst}", allowed, False)]


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
