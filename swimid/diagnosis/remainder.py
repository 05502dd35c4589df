"""Test whether the remaining residuals have structure, and where."""

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
from swimid.fitting.parallel import map_in_processes
from swimid.fitting.problem import Problem

#: Tried prior standard deviations of a generic term, in its typical sizes.
WIDTHS = (0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0)
#: Maximum effective number of parameters of a description, as a share of the samples: beyond, it describes
#: noise.
MOST_USED = 0.5
#: Ratio from which motion is slower than noise; the same against the channel with the least; ratio that is
#: certain.
SLOW, AGAINST, SURE = 1.45, 1.25, 2.2

#: Minimum gain of a description per sample.
PER_SAMPLE = 0.002
#: Number of draws of pure noise, and quantile of their largest gain that a description must exceed.
DRAWS, QUANTILE = 400, 0.975
#: Minimum gain. Few samples determine their own noise: then half their number, but at least the second value.
LEAST_GAIN, LEAST_OF_FEW = 50.0, 25.0


def least_gain(samples: float) -> float:
    """Return the minimum gain that counts."""
    return float(np.clip(0.5 * samples, LEAST_OF_FEW, LEAST_GAIN))


@dataclass(frozen=True)
class Left:
    """Structure that a generic description finds beyond a fit.

    Attributes
    ----------
    gain : float
        Held-out decrease of the squared residuals, all terms together.
    threshold : float
        Gain that noise alone exceeds once in forty.
    places : dict of place to float
        Held-out gain of the terms of one place alone.
    columns : list of lists of ndarray
        Change of each trial by each term at its typical size, weighted.
    prior : list of float
        Best inverse variances.
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
        """Return whether the gain is larger than that of noise."""
        return self.gain > self.threshold


def _terms(context: FitContext, base: Fit) -> list[tuple[str, list[Array]]]:
    """Return the place of each generic term, and its change of each trial at its typical size.

    Terms that change nothing, or with which the model diverges, are left out.
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
    """Fit a generic description to the residuals of a fit, with a prior chosen on held-out folds."""
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
    """Return weighted residuals with every parameter and column fitted to all trials: noise and between-trial
    variation.

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
        # Far from the base the changes are not additive: residuals that do not decrease are no fit.
        better = float(rest @ rest) < float(base.residuals[k] @ base.residuals[k])
        found.append(r if better else bare)
    return found


@dataclass(frozen=True)
class LowFrequency:
    """Slow motion of a channel's residual against its noise.

    Attributes
    ----------
    ratio : float
        Root mean square of the residual after each trial had its own start state, trim, gain and clock, over
        that of its changes from sample to sample (over the square root of two). It is 1 for white noise, and
        a little more for the coloured noise of a tracker.
    share : float
        Share of its square beyond the smallest ratio of all channels, and beyond what noise may have.
    """

    ratio: float
    share: float


def low_frequency(problem: Problem, residuals: Sequence[Array]) -> dict[str, LowFrequency]:
    """Return the motion slower than noise in each channel that is no trim, gain or clock of a single trial.

    It does not require that trials share it: gusts, vortices, or a spring that differs from day to day appear
    here only.

    Parameters
    ----------
    residuals : sequence of ndarray, shape (n_k,)
        Weighted, as :func:`swimid.diagnosis.floor.nuisance_residuals` leaves them.
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
    """Return the channels in which something moves that is not noise."""
    if not found:
        return []
    least = max(min(s.ratio for s in found.values()), 1.0)
    return [c for c, s in found.items() if s.ratio > SURE or (s.ratio > SLOW and s.ratio > AGAINST * least)]
