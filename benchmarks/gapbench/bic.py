"""A peer: every effect refitted by least squares with independent noise; the BIC decides.

The textbook way (G. Schwarz, Ann. Stat. 6(2), 1978). Noise is white, of one size in each channel; trials
differ by nothing but their start states; nothing is held out; it cannot say that something else is missing.
An effect stays, and the next is sought beside it, while the BIC falls.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from benchmarks.gapbench.peers import Case, verdict
from swimid.diagnosis.noise import NoiseModel
from swimid.diagnosis.study import FINE, GapStudy, Hypothesis
from swimid.effects import catalogue
from swimid.effects.base import Effect
from swimid.fitting import uncertainty as sample_noise

#: Effects together at most; so many times the noise is read off the residuals before.
MOST, WEIGHTINGS = 2, 2


def diagnose(case: Case) -> dict[str, Any]:
    """Return the part of a gap file that the BIC of refits gives."""
    return verdict(rounds(case))


def rounds(case: Case) -> list[dict[str, float]]:
    """BIC of the model, under ``""``, and with each effect; then beside the best; and so on."""
    bench = GapStudy(case.model, case.model.parameters, case.trials, case.prior)
    effects = catalogue.applicable(catalogue.list_effects(), case.model, case.trials)
    found: list[dict[str, float]] = []
    with threadpool_limits(limits=1, user_api="blas"), ThreadPoolExecutor(os.cpu_count()) as pool:
        bench, fit = _nominal(bench)
        while len(found) < MOST:
            rest = [e for e in effects if e.name not in {own.name for own in fit.effects}]
            base = fit
            fits = list(pool.map(lambda e, base=base: _beside(bench, base, e), rest))
            bic = {"": compute_bic(fit)}
            best = {"": fit}
            for effect, other in zip(rest, fits, strict=True):
                value = compute_bic(other)
                # of an effect in several forms, the best
                if value < bic.get(effect.name, np.inf):
                    bic[effect.name], best[effect.name] = value, other
            found.append(bic)
            name = min(bic, key=bic.__getitem__)
            if name == "":
                break
            fit = best[name]
    return found


def _nominal(bench: GapStudy) -> tuple[GapStudy, Hypothesis]:
    """The trials with the noise that their own residuals show, and the model refitted."""
    problem = bench.problem(())
    sample_noise.weigh_first(problem)
    theta = np.clip(problem.start, problem.lower, problem.upper)
    sizes: Mapping[str, tuple[float, float]] = {}
    for _ in range(1 + WEIGHTINGS):
        bench = bench.with_noise(NoiseModel([list(sds) for sds in problem.sd]))
        fit = bench.fit((), [theta], others=bench.begins(problem, theta))
        theta = fit.theta
        sizes = sample_noise.estimate_noise(problem, theta, dict(sizes))
    return bench, fit


def _beside(bench: GapStudy, base: Hypothesis, effect: Effect) -> Hypothesis:
    """The optimum with one more effect, from the best of the sizes it is tried at."""
    effects = (*base.effects, effect)
    own = bench.build_model(effects).acting[-1].parameters
    starts = []
    for point in [*effect.tries(own), np.array([p.start for p in own])]:
        named = {f"{effect.name}/{p.name}": float(v) for p, v in zip(own, point, strict=False)}
        starts.append(bench.start(effects, base, named))
    problem = bench.problem(effects)
    first = min(starts, key=lambda theta: float(np.sum(problem.residuals(theta) ** 2)))
    return bench.fit(effects, [first], tolerance=FINE)


def compute_bic(fit: Hypothesis) -> float:
    """``sum n log(rss / n) + k log(sum n)`` over channels, each with a noise of its own."""
    total, samples = 0.0, 0
    for parts in fit.problem.series(fit.residuals).values():
        values = _finite(parts)
        total += len(values) * float(np.log(np.mean(values**2)))
        samples += len(values)
    return total + len(fit.theta) * float(np.log(samples))


def _finite(parts: Sequence[np.ndarray]) -> np.ndarray:
    values = np.concatenate(parts)
    return values[np.isfinite(values)]
