"""Start states of trials that took no part in a fit.

A held-out trial starts where it starts: its own pose, speed and clock are no part of the shared
parameters it is to test. They are estimated from the trial itself with all shared ones held.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from swimid.fitting.fit_result import FitResult
from swimid.fitting.model import Model, Parameter, Trial
from swimid.fitting.problem import Problem

#: Relative tolerance of the search.
TOLERANCE = 1e-8


def estimate(
    model: Model,
    parameters: tuple[Parameter, ...],
    trial: Trial,
    sd: Mapping[str, float],
    *,
    tolerance: float = TOLERANCE,
) -> dict[str, float]:
    """Per-trial parameters of one trial by label, ``name[trial]``, the shared ones held at their starts.

    Parameters
    ----------
    parameters : tuple of Parameter
        Shared ones with their values as ``start``; of the others those that are free are estimated.
    sd : mapping of channel name to float
        Noise of each channel, for the weights; channels that are not in it are not used.
    """
    held = [replace(p, free=p.free and p.per_trial) for p in parameters]
    used = {c: v for c, v in trial.measured.items() if c in sd}
    problem = Problem(model, held, [replace(trial, role="fit", measured=used)])
    try:
        if not problem.labels:
            return {}
        for i, channel in enumerate(problem.channels[0]):
            problem.sd[0][i] = np.full(len(trial.time_s), sd[channel])
        begin = problem.start
        if problem.broken(begin):
            # known from other coefficients, with which it did not diverge
            begin = np.clip([held[i].start for i, _ in problem.slots], problem.lower, problem.upper)
        solution = problem.solve(begin, tolerance=tolerance)
        return {label: float(v) for label, v in zip(problem.labels, solution.x, strict=True)}
    finally:
        problem.close()


def with_held_out(result: FitResult) -> FitResult:
    """The result with each validation trial simulated from its own start state."""
    waiting = [t for t in result.trials if t.role == "validate"]
    if not any(p.free and p.per_trial for p in result.parameters):
        return result
    sd = {name: noise.value_sd for name, noise in result.noise.items()}
    found: dict[str, float] = {}
    for trial in waiting:
        found.update(estimate(result.model, result.at_estimates(), trial, sd))
    result = replace(result, start_states=found)
    simulated = {t.id: result.model.simulate(result.values(t.id), t) for t in waiting}
    series = [
        replace(s, simulated=simulated[s.trial][s.channel]) if s.trial in simulated else s
        for s in result.series
    ]
    return replace(result, series=series)
