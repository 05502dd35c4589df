"""Screen effects: predict how much each of them would reduce the held-out residuals if it were refitted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain
from typing import NamedTuple

import numpy as np

from swimid.diagnosis import crossval
from swimid.diagnosis.crossval import NormalEquations
from swimid.diagnosis.study import EFFECT_PRIOR, GapStudy, Hypothesis
from swimid.effects.base import Effect
from swimid.fitting.model import Array, Parameter
from swimid.fitting.problem import map_in_processes

#: Sum of squared changes of the trials by an effect, in units of the noise variance, below which the effect
#: counts as having no influence.
MIN_SQUARED_CHANGE = 1e-6
#: Maximum change of a sample by an effect, in noise standard deviations. A larger change means that the
#: simulation diverged.
MAX_CHANGE_SD = 3e4
#: Minimum fraction of the trials that can be simulated with an effect without divergence. Parameter values of
#: the effect with a smaller fraction are left out.
MIN_SOUND_SHARE = 0.7
#: Number of parts into which each trial is divided to cross-validate an effect whose parameter has a separate
#: value for each trial.
TRIAL_PARTS = 4


@dataclass(frozen=True)
class Screening:
    """Screening result of one effect.

    Attributes
    ----------
    point : ndarray
        Predicted optimum of the effect's parameters.
    gains : ndarray, shape (folds,)
        Predicted decrease of the squared held-out residuals in each fold.
    absorbed : float
        Fraction of the squared change by the effect that the coefficients of the model can imitate.
    signature : list of ndarray, each shape (n_k,)
        Change of the samples of each trial at ``point``, divided by the noise standard deviation.
    start : ndarray or None
        Screened point at which the effect reduced the held-out residuals most. A refit also starts there.
    """

    effect: Effect
    parameters: tuple[Parameter, ...]
    point: Array
    gains: Array
    absorbed: float
    signature: list[Array]
    start: Array | None = None

    @property
    def gain(self) -> float:
        """Return the predicted decrease of the squared held-out residuals, summed over folds."""
        return float(self.gains.sum())


def is_sound(change: Array) -> bool:
    """Return whether the change of a trial by an effect is finite and below :data:`MAX_CHANGE_SD`.

    A larger change means that the simulation diverged.
    """
    return bool(np.isfinite(change).all() and np.max(np.abs(change), initial=0.0) < MAX_CHANGE_SD)


class ScreeningRuns(NamedTuple):
    """Simulated changes of the trials by one effect.

    Attributes
    ----------
    points : list of (ndarray, list of ndarray)
        Values of the effect's parameters, and the resulting change of each trial, divided by the noise
        standard deviation.
    """

    effect: Effect
    parameters: tuple[Parameter, ...]
    points: list[tuple[Array, list[Array]]]


def simulate_effects(study: GapStudy, base: Hypothesis, effects: Sequence[Effect]) -> list[ScreeningRuns]:
    """Simulate each effect with several parameter values and return the changes of the trials."""

    def one(effect: Effect) -> list[tuple[Array, list[Array]]]:
        parameters = effect.parameters(study.model, study.trials)
        found = []
        points = list(effect.tries(parameters))
        for point, changed in zip(points, study.changes(base, effect, points), strict=True):
            sound = [is_sound(c) for c in changed]
            # The change of a diverged trial is set to zero. The other trials still show the effect.
            if sum(sound) > MIN_SOUND_SHARE * len(sound):
                found.append(
                    (point, [c if ok else np.zeros(len(c)) for c, ok in zip(changed, sound, strict=True)])
                )
        return found

    return [
        ScreeningRuns(effect, effect.parameters(study.model, study.trials), points)
        for effect, points in zip(effects, map_in_processes(one, effects, study.jobs), strict=True)
    ]


def screen_effects(
    study: GapStudy, base: Hypothesis, simulated: Sequence[ScreeningRuns]
) -> tuple[list[Screening], dict[str, str]]:
    """Predict the decrease of the squared held-out residuals by each effect.

    The parameters of ``base`` are projected out.

    Returns
    -------
    list of Screening
        Screening results, largest predicted gain first.
    dict of name to reason
        Effects that change no measured sample or make the simulation diverge, with the reason.
    """
    columns = [changed for tried in simulated for _, changed in tried.points]
    inner = crossval.form_normal_equations(study, base, columns)
    plain = crossval.compute_held_out(inner)
    left = crossval.project_columns(inner).diagonal()
    whole = inner.products.sum(axis=0).diagonal()[inner.n_shared :]
    found, left_out, first = [], {}, 0
    for tried in simulated:
        if any(p.per_trial for p in tried.parameters):
            best = _screen_own(study, base, tried)
        else:
            best = _screen_shared(inner, tried, first, plain, left, whole)
        first += len(tried.points)
        if best is None:
            left_out[tried.effect.name] = "the effect changes no channel that was measured in these trials"
            if not tried.points:
                left_out[tried.effect.name] = "the simulation diverges with the effect, which was not judged"
        else:
            found.append(best)
            left_out.pop(tried.effect.name, None)
    found.sort(key=lambda t: -t.gain)
    return found, left_out


def _strength(parameters: Sequence[Parameter], point: Array) -> float:
    """Return the largest distance of an effect's parameters from their null values, in typical scales."""
    sizes = (abs(v - p.start) / p.scale for v, p in zip(point, parameters, strict=True))
    return max(sizes, default=1.0) or 1.0


def _limit_factor(null: Array, step: Array, factor: float, lower: Array, upper: Array) -> float:
    """Return a factor limited so that ``null + factor * step`` is within the bounds of the parameters."""
    with np.errstate(divide="ignore", invalid="ignore"):
        ends = np.array([(lower - null) / step, (upper - null) / step])
    ends = ends[:, step != 0.0]
    low = float(np.max(np.min(ends, axis=0), initial=-np.inf))
    high = float(np.min(np.max(ends, axis=0), initial=np.inf))
    return float(np.clip(factor, low, high))


def _screen_shared(
    inner: NormalEquations, tried: ScreeningRuns, first: int, plain: Array, left: Array, whole: Array
) -> Screening | None:
    """Return the screening result of an effect at the parameter vector with the largest predicted gain.

    The candidates are all simulated parameter vectors, and the combination of the best vectors of different
    parameters.

    Parameters
    ----------
    first : int
        Index of the effect's first column among the columns of all effects.
    plain : ndarray, shape (folds,)
        Squared held-out residuals without any effect.
    left, whole : ndarray
        Squared changes by all columns, with and without the shared parameters projected out.
    """
    parameters, points = tried.parameters, tried.points
    acting = [i for i in range(len(points)) if whole[first + i] > MIN_SQUARED_CHANGE]
    if not acting:
        return None
    gains, factors, chosen = _fit_points(inner, tried, first, plain, acting)
    column = first + chosen[0]
    raw = [plain - crossval.compute_held_out_less(inner, first + i) for i in range(len(points))]
    helped = max(range(len(points)), key=lambda i: (raw[i].sum(), i))
    if not tried.effect.smooth and raw[helped].sum() > gains.sum():
        gains = raw[helped]
    null, lower, upper = (np.array([getattr(p, n) for p in parameters]) for n in ("start", "lower", "upper"))
    step = sum(f * (points[i][0] - null) for f, i in zip(factors, chosen, strict=True))
    changes = zip(*(points[i][1] for i in chosen), strict=True)
    return Screening(
        tried.effect,
        parameters,
        np.clip(null + step, lower, upper),
        gains,
        float(np.clip(1.0 - left[column] / whole[column], 0.0, 1.0)),
        [np.asarray(sum(f * c for f, c in zip(factors, of, strict=True))) for of in changes],
        points[helped][0],
    )


def _fit_points(
    inner: NormalEquations, tried: ScreeningRuns, first: int, plain: Array, acting: Sequence[int]
) -> tuple[Array, Array, tuple[int, ...]]:
    """Return the gains, the factors and the indices of the parameter vectors with the largest gain.

    Parameters
    ----------
    acting : sequence of int
        Indices of the parameter vectors that change the trials.
    """
    parameters, points = tried.parameters, tried.points
    null = np.array([p.start for p in parameters])
    lower, upper = np.array([p.lower for p in parameters]), np.array([p.upper for p in parameters])

    def fit(*chosen: int) -> tuple[Array, Array, tuple[int, ...]]:
        """Fit the changes at some parameter vectors together. Return the gains and the fitted factors."""
        prior = [(_strength(parameters, points[i][0]) / EFFECT_PRIOR) ** 2 for i in chosen]
        where = [first + i for i in chosen]
        gains = plain - crossval.compute_held_out(inner, where, prior)
        return gains, crossval.fit_columns(inner, where, prior)[inner.n_shared :], chosen

    fits = {i: fit(i) for i in acting}
    leaders: dict[tuple[int, ...], int] = {}
    for i, (gains, _, _) in fits.items():
        moved = tuple(np.flatnonzero(points[i][0] != null).tolist())
        leader = leaders.setdefault(moved, i)
        if gains.sum() > fits[leader][0].sum():
            leaders[moved] = i
    rivals = []
    for i, (gains, factors, chosen) in fits.items():
        # The factor of the change is limited so that the parameters are within their bounds. An effect
        # without parameters always acts fully (factor 1).
        allowed = 1.0
        if parameters:
            allowed = _limit_factor(null, points[i][0] - null, float(factors[0]), lower, upper)
        if allowed != factors[0]:
            gains = np.minimum(gains, plain - crossval.compute_held_out_less(inner, first + i, allowed))
        rivals.append((gains, np.array([allowed]), chosen))
    if len(leaders) > 1:
        rivals.append(fit(*leaders.values()))
    return max(rivals, key=lambda one: float(one[0].sum()))


def _screen_own(study: GapStudy, base: Hypothesis, tried: ScreeningRuns) -> Screening | None:
    """Return the screening result of an effect with separate parameter values for each trial."""
    single = [j for j, p in enumerate(tried.parameters) if p.per_trial]
    null = [p.start for p in tried.parameters]
    # The change of a trial is linear in a per-trial parameter. One simulated value is therefore enough for
    # each combination of the other parameters.
    groups: dict[bytes, dict[tuple[int, ...], tuple[Array, list[Array]]]] = {}
    for point, changed in tried.points:
        moved = tuple(j for j in single if point[j] != null[j])
        if moved:
            groups.setdefault(np.delete(point, single).tobytes(), {}).setdefault(moved, (point, changed))
    best: Screening | None = None
    for group in groups.values():
        changes = [changed for _, changed in group.values()]
        signature = [np.sum(of_trial, axis=0) for of_trial in zip(*changes, strict=True)]
        if sum(float(np.vdot(c, c)) for c in chain(*changes)) < MIN_SQUARED_CHANGE:
            continue
        gains = compute_own_gains(study, base, changes)
        if best is None or gains.sum() > best.gain:
            point, _ = next(iter(group.values()))
            best = Screening(tried.effect, tried.parameters, point, gains, 0.0, signature)
    return best


def compute_cosine(study: GapStudy, base: Hypothesis, first: Screening, second: Screening) -> float:
    """Return the cosine between the changes of the trials by two effects.

    The parameters of ``base`` are projected out. The cosine is 0 if these parameters imitate the whole change
    due to one of the effects.
    """
    columns = [first.signature, second.signature]
    inner = crossval.project_columns(crossval.form_normal_equations(study, base, columns))
    norm = np.sqrt(max(inner[0, 0], 0.0) * max(inner[1, 1], 0.0))
    if norm <= 0:
        return 0.0
    return float(inner[0, 1] / norm)


def compute_own_gains(study: GapStudy, base: Hypothesis, own: Sequence[Sequence[Array]]) -> Array:
    """Return the decrease of the squared held-out residuals by an effect with per-trial parameters.

    The result has shape (folds,). The factor of the effect's change is estimated from three quarters of a
    trial and evaluated on the remaining quarter, for each quarter in turn. An effect that only fits the start
    of a trial or a drift therefore has no gain.

    Parameters
    ----------
    own : sequence of lists of ndarray
        Changes of each trial by one typical scale of a parameter, divided by the noise standard deviation.
    """
    problem = base.problem
    gains = np.zeros(study.folds.count)
    q = len(own)
    for k, trial in enumerate(study.trials):
        block = np.column_stack([*(c[k] for c in own), base.residuals[k]])
        seen = crossval.project_out(study, base, k, block)[: len(block)]
        times = np.concatenate([np.empty(0), *(trial.time_s[mask] for mask in problem.masks[k])])
        cut = np.quantile(times, np.linspace(0, 1, TRIAL_PARTS + 1)[1:-1]) if len(times) else np.empty(0)
        part = np.searchsorted(cut, times, side="right")
        products = np.array([seen[part == b].T @ seen[part == b] for b in range(TRIAL_PARTS)])
        total = products.sum(axis=0)
        gain = 0.0
        for inner in products:
            rest = total - inner
            normal = rest[:q, :q] + np.eye(q) / EFFECT_PRIOR**2
            factor = np.linalg.solve(normal, rest[:q, q])
            gain += float(2.0 * factor @ inner[:q, q] - factor @ inner[:q, :q] @ factor)
        gains[int(study.folds.owner[k][0]) if len(study.folds.owner[k]) else 0] += gain
    return gains
