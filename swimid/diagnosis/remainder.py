"""Test whether the remaining residuals have structure, and in which part of the data.

The test fits a generic description to the residuals: smooth terms without a physical cause
(:mod:`swimid.diagnosis.generic`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag

from swimid.diagnosis import crossval
from swimid.diagnosis.candidates import within
from swimid.diagnosis.context import Fit, FitContext
from swimid.diagnosis.generic import Description, descriptions
from swimid.diagnosis.noise_model import NoiseModel
from swimid.fitting.model import Array
from swimid.fitting.problem import Problem, map_in_processes

#: Candidate prior standard deviations of the coefficients of a generic description, in typical scales.
WIDTHS = (0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0)
#: Maximum effective number of parameters of a generic description, as a fraction of the number of samples.
#: With more parameters it would describe noise.
MOST_USED = 0.5
#: Thresholds of :attr:`LowFrequency.ratio`. A channel moves slower than noise if its ratio exceeds `SURE`, or
#: if it exceeds both `SLOW` and `AGAINST` times the smallest ratio of all channels.
SLOW, AGAINST, SURE = 1.45, 1.25, 2.2

#: Minimum decrease of the held-out squared residuals per sample by a generic description, in units of the
#: noise variance.
PER_SAMPLE = 0.002
#: Number of random samples of pure noise, and quantile of the largest decrease of their squared residuals by
#: a generic description. The decrease in the trials must exceed this quantile.
DRAWS, QUANTILE = 400, 0.975
#: Upper and lower limit of the minimum decrease of the held-out squared residuals, in units of the noise
#: variance. Between the limits, the minimum is half the number of samples.
LEAST_GAIN, LEAST_OF_FEW = 50.0, 25.0


def least_gain(samples: float) -> float:
    """Return the minimum decrease of the held-out squared residuals that counts as structure."""
    return float(np.clip(0.5 * samples, LEAST_OF_FEW, LEAST_GAIN))


@dataclass(frozen=True)
class Left:
    """Structure that a generic description finds in the residuals of a fit.

    Attributes
    ----------
    gain : float
        Decrease of the held-out squared residuals by all terms together, in units of the noise variance.
    threshold : float
        Minimum decrease for structure. The probability that pure noise exceeds it is at most 1/40.
    places : dict of place to float
        Decrease of the held-out squared residuals by the terms of each place alone.
    columns : list of lists of ndarray
        Weighted change of each trial by each term at its typical scale.
    prior : list of float
        Inverse prior variance of each term, chosen for the largest decrease.
    freedom : float
        Effective number of parameters of all terms.
    """

    gain: float
    threshold: float
    places: dict[str, float]
    columns: list[list[Array]]
    prior: list[float]
    freedom: float

    @property
    def found(self) -> bool:
        """Return whether the residuals decrease by more than pure noise allows."""
        return self.gain > self.threshold


def _terms(context: FitContext, base: Fit) -> list[tuple[str, list[Array]]]:
    """Return the place of each generic term, and its weighted change of each trial at the typical scale.

    Terms that change nothing, or with which the simulation diverges, are left out.
    """

    def of(description: Description) -> list[tuple[str, list[Array]]]:
        parameters = description.parameters(context.model, context.trials)
        return [
            (description.place, changed)
            for changed in context.changes(base, description, description.tries(parameters))
            if all(within(c) for c in changed) and sum(float(c @ c) for c in changed) > 1e-9
        ]

    found = map_in_processes(of, descriptions(context.model, context.trials), context.jobs)
    return [term for of_each in found for term in of_each]


def find(context: FitContext, base: Fit, noise_model: NoiseModel, *, rng: np.random.Generator) -> Left:
    """Fit a generic description to the residuals of a fit. The width of its prior is chosen on held-out
    folds.
    """
    terms = _terms(context, base)
    columns = [changed for _, changed in terms]
    inner = crossval.normal_equations(context, base, noise_model, columns)
    plain = crossval.held_out(inner)
    draws = crossval.noise_draws(inner, rng, DRAWS)
    plain_drawn = crossval.held_out(inner, draws=draws)
    every = list(range(len(columns)))
    samples = float(inner.samples.sum())
    gain, prior, freedom = 0.0, [WIDTHS[0] ** -2] * len(columns), 0.0
    largest = np.zeros(DRAWS)
    for width in WIDTHS:
        tried = [width**-2] * len(columns)
        used = _freedom(inner, tried)
        if used > MOST_USED * samples:
            break
        gained = float((plain - crossval.held_out(inner, every, tried)).sum())
        drawn = (plain_drawn - crossval.held_out(inner, every, tried, draws)).sum(axis=0)
        largest = np.maximum(largest, drawn)
        if gained > gain:
            gain, prior, freedom = gained, tried, used
    places = {}
    for place in dict.fromkeys(place for place, _ in terms):
        mine = [i for i, (there, _) in enumerate(terms) if there == place]
        alone = (plain - crossval.held_out(inner, mine, [width**-2] * len(mine)) for width in WIDTHS)
        places[place] = max(float(gains.sum()) for gains in alone)
    least = max(float(np.quantile(largest, QUANTILE)), PER_SAMPLE * samples, least_gain(samples))
    return Left(gain, least, places, columns, prior, freedom)


def _freedom(inner: crossval.NormalEquations, prior: Sequence[float]) -> float:
    """Return the effective number of parameters of the generic terms: the trace of their hat matrix."""
    normal = inner.products.sum(axis=0)[:-1, :-1]
    ridge = block_diag(inner.prior, np.diag(prior))
    return float(np.trace(crossval.solved(normal + ridge, normal)[inner.shared :, inner.shared :]))


def saturated(
    context: FitContext,
    base: Fit,
    noise_model: NoiseModel,
    columns: Sequence[Sequence[Array]],
    prior: Sequence[float],
) -> list[Array]:
    """Return the weighted residuals of a fit of all parameters and all generic terms to all trials.

    These residuals consist of noise and between-trial variation.

    Returns
    -------
    list of ndarray, shape (n_k,)
    """
    inner = crossval.normal_equations(context, base, noise_model, columns)
    problem = base.problem
    mean, weight = context.expected(problem)
    shared = context.shared(base)
    factors = crossval.together(inner, range(len(columns)), prior)
    found = []
    for k in range(len(context.trials)):
        r = base.residuals[k] - base.rows[k][:, shared] @ factors[: len(shared)]
        for factor, column in zip(factors[len(shared) :], columns, strict=True):
            r = r - factor * column[k]
        mine = context.apart(base, k)
        rest, bare = r, base.fixed_effects_residual(k)
        if len(mine):
            scale = problem.scale[mine]
            own = base.rows[k][:, mine] * scale
            seen = noise_model.whiten(problem, k, np.column_stack((own, r)))
            known = weight[mine] * scale
            right = seen[:, :-1].T @ seen[:, -1] + known**2 * (mean - base.theta)[mine] / scale
            step = crossval.solved(seen[:, :-1].T @ seen[:, :-1] + np.diag(known**2), right[:, None])[:, 0]
            rest = r - own @ step
            begun = np.array([not problem.differs(j) for j in mine])
            r = r - own[:, begun] @ step[begun] + (bare - base.residuals[k])
        # Far from the base fit, the changes by the terms do not add up. Reject a result that does not reduce
        # the residuals.
        better = float(rest @ rest) < float(base.residuals[k] @ base.residuals[k])
        found.append(r if better else bare)
    return found


@dataclass(frozen=True)
class LowFrequency:
    """Slow motion in the residuals of a channel, compared with the noise of the channel.

    Attributes
    ----------
    ratio : float
        Root-mean-square residual divided by a noise level. The residual is that after each trial has its own
        start state, trim, gain and clock. The noise level is the root mean square of the sample-to-sample
        changes of the residual, divided by the square root of two. The ratio is 1 for white noise, and
        slightly larger for the coloured noise of a tracker.
    share : float
        Fraction of the mean-square residual that is slow motion. The reference without slow motion is the
        smallest ratio of all channels, at least 1 and at most `SLOW`.
    """

    ratio: float
    share: float


def low_frequency(problem: Problem, residuals: Sequence[Array]) -> dict[str, LowFrequency]:
    """Return the slow motion in the residuals of each channel. Trim, gain and clock of single trials are
    excluded.

    The motion may differ between trials. Gusts, vortices, or a spring that differs from day to day appear
    only here.

    Parameters
    ----------
    residuals : sequence of ndarray, shape (n_k,)
        Weighted residuals, as :func:`swimid.diagnosis.floor.nuisance_residuals` returns them.
    """
    ratios = {}
    for channel, of_trials in problem.series(residuals).items():
        parts = []
        for series in of_trials:
            steps = np.diff(series)
            there, moved = np.isfinite(series), np.isfinite(steps)
            if moved.sum() > 20:
                parts.append((np.mean(series[there] ** 2), np.mean(steps[moved] ** 2) / 2, moved.sum()))
        if parts:
            whole, rough, weight = (np.array(x) for x in zip(*parts, strict=True))
            ratios[channel] = float(np.sqrt((whole @ weight) / max(float(rough @ weight), 1e-300)))
    if not ratios:
        return {}
    least = min(max(min(ratios.values()), 1.0), SLOW)
    return {
        c: LowFrequency(q, float(np.clip(1.0 - (least / q) ** 2, 0.0, 1.0)) if q > 0 else 0.0)
        for c, q in ratios.items()
    }


def drifting(found: dict[str, LowFrequency]) -> list[str]:
    """Return the channels whose residuals move slower than noise."""
    if not found:
        return []
    least = max(min(s.ratio for s in found.values()), 1.0)
    return [c for c, s in found.items() if s.ratio > SURE or (s.ratio > SLOW and s.ratio > AGAINST * least)]
