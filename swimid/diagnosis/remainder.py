"""Is something left that an effect should explain, and where does it act?"""

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

#: Widths of the prior of a generic term tried, in its typical sizes.
WIDTHS = (0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0)
#: A description worth more numbers than this share of the samples describes their noise.
MOST_USED = 0.5
#: Ratio from which something moves that is not noise; and against the channel with the least.
SLOW, AGAINST, SURE = 1.45, 1.25, 2.2

#: Something is left where a description gains more than this per sample.
PER_SAMPLE = 0.002
#: And more than this quantile of the largest gain in so many draws of pure noise.
DRAWS, QUANTILE = 400, 0.975
#: And more than this; of few samples, whose noise is read off themselves, for half their number, but
#: never for less than the second.
LEAST_GAIN, LEAST_OF_FEW = 50.0, 25.0


def least_gain(samples: float) -> float:
    """The gain below which nothing counts, whatever noise alone would give."""
    return float(np.clip(0.5 * samples, LEAST_OF_FEW, LEAST_GAIN))


@dataclass(frozen=True)
class Left:
    """What a generic description finds beyond a fit.

    Attributes
    ----------
    gain : float
        Held-out drop of misfit, all terms together.
    threshold : float
        What noise alone gives at most once in forty.
    places : dict of place to float
        Held-out gain of the terms of one place alone.
    columns : list of lists of ndarray
        Change of each trial by each term at its typical size, weighted.
    prior : list of float
        Inverse variances that were best.
    freedom : float
        How many numbers fitted without a prior would take up as much of the noise as all terms do.
    """

    gain: float
    threshold: float
    places: dict[str, float]
    columns: list[list[Array]]
    prior: list[float]
    freedom: float

    @property
    def found(self) -> bool:
        """Whether there is more than noise would give."""
        return self.gain > self.threshold


def _terms(context: FitContext, base: Fit) -> list[tuple[str, list[Array]]]:
    """Return where each generic term acts, and what it changes in each trial at its typical size.

    Terms that change nothing, or with which the model breaks down, are left out.
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
    """What is left beyond a fit, by a generic description with a prior chosen on held-out folds."""
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
    """How many numbers without a prior the generic terms are worth: the trace of their hat matrix."""
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
    """Weighted residuals with every number and column fitted to all trials: what is noise, if anything, and
    what differs from trial to trial.

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
        # far from the base the changes no longer add up: what does not get smaller is no fit
        better = float(rest @ rest) < float(base.residuals[k] @ base.residuals[k])
        found.append(r if better else bare)
    return found


@dataclass(frozen=True)
class LowFrequency:
    """How much slower than its noise a channel's residual moves.

    Attributes
    ----------
    ratio : float
        Root-mean-square of what is left once each trial has had its own start state, trim, gain and clock,
        over that of its changes from sample to sample (over the square root of two): one for white
        noise, a little more for a tracker's coloured noise.
    share : float
        Of its square that is beyond the least ratio of all channels, and beyond what noise may have.
    """

    ratio: float
    share: float


def low_frequency(problem: Problem, residuals: Sequence[Array]) -> dict[str, LowFrequency]:
    """What moves slower than noise in each channel, and is no trim, gain or clock of a single trial.

    It does not ask whether trials share it: gusts, shed vortices at a phase of their own, a spring that
    differs from day to day show here, and nowhere else.

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
    """Channels in which something moves that is not noise."""
    if not found:
        return []
    least = max(min(s.ratio for s in found.values()), 1.0)
    return [c for c, s in found.items() if s.ratio > SURE or (s.ratio > SLOW and s.ratio > AGAINST * least)]
