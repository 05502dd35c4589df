"""Effects tried on the trials: a cheap screen at several strengths, then a refit together with the model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from swimid.diagnosis import crossval
from swimid.diagnosis.context import EFFECT_PRIOR, Fit, FitContext
from swimid.diagnosis.crossval import NormalEquations
from swimid.diagnosis.noise_model import NoiseModel
from swimid.effects.base import Effect
from swimid.fitting.model import Array, Parameter
from swimid.fitting.parallel import mapped

#: A change smaller than this (squared, in units of the noise) is none.
NOTHING = 1e-6
#: One this large, in units of the noise, is a simulation that broke down.
BROKEN = 3e4
#: Share of trials that must not break down for an effect to be judged by them.
SOUND = 0.7
#: Starts of a fit beyond the one the screen predicts: the sizes that help most as they are.
STARTS = 3
#: Parts of a trial that are judged in turn where each trial has a size for itself.
PARTS = 4


@dataclass(frozen=True)
class Tried:
    """One effect as the screen saw it.

    Attributes
    ----------
    effect : Effect
    parameters : tuple of Parameter
    point : ndarray
        Its parameters where the screen expects them.
    gains : ndarray, shape (folds,)
        Predicted drop of each fold's held-out misfit.
    absorbed : float
        Share of the squared change that the nominal numbers imitate.
    signature : list of ndarray
        Change of each trial at ``point``, weighted.
    starts : list of ndarray
        Points at which it was tried and helped as it was: other places to begin a refit.
    """

    effect: Effect
    parameters: tuple[Parameter, ...]
    point: Array
    gains: Array
    absorbed: float
    signature: list[Array]
    starts: list[Array] = field(default_factory=list)

    @property
    def gain(self) -> float:
        """Over all folds."""
        return float(self.gains.sum())


@dataclass(frozen=True)
class Refitted:
    """One effect fitted together with the model.

    Attributes
    ----------
    gains : ndarray, shape (folds,)
        Drop of each fold's held-out misfit against the model without it.
    inside : ndarray, shape (folds,)
        The same of the fits to all.
    """

    tried: Tried
    fit: Fit
    gains: Array
    inside: Array

    @property
    def gain(self) -> float:
        """Over all folds."""
        return float(self.gains.sum())

    @property
    def size(self) -> float:
        """How far the effect is from none, in typical sizes."""
        known = {f"{self.tried.effect.name}/{p.name}": p for p in self.tried.parameters}
        named = ((label.split("[")[0], v) for label, v in zip(self.fit.labels, self.fit.theta, strict=True))
        return max((abs(v - known[n].start) / known[n].scale for n, v in named if n in known), default=0.0)

    @property
    def stderr(self) -> float:
        """Standard error of the gain, from its spread over folds."""
        n = len(self.gains)
        return float(np.sqrt(n * np.var(self.gains, ddof=1))) if n > 1 else float("nan")


@dataclass
class Screen:
    """All effects tried on one base.

    Attributes
    ----------
    tried : list of Tried
        Best first.
    left_out : dict of name to reason
        Effects that change nothing here.
    """

    tried: list[Tried]
    left_out: dict[str, str] = field(default_factory=dict)


def within(change: Array) -> bool:
    """Whether a change is one, and not a simulation that broke down."""
    return bool(np.isfinite(change).all() and np.max(np.abs(change), initial=0.0) < BROKEN)


@dataclass(frozen=True)
class Trialled:
    """What an effect changes at each of the strengths it is tried at."""

    effect: Effect
    parameters: tuple[Parameter, ...]
    points: list[tuple[Array, list[Array]]]


def simulate(
    context: FitContext,
    base: Fit,
    effects: Sequence[Effect],
    *,
    jobs: int = 1,
) -> list[Trialled]:
    """The changes all effects make at several strengths."""

    def one(effect: Effect) -> list[tuple[Array, list[Array]]]:
        parameters = effect.parameters(context.model, context.trials)
        found = []
        points = list(effect.tries(parameters))
        for point, changed in zip(points, context.changes(base, effect, points), strict=True):
            sound = [within(c) for c in changed]
            # a trial on the verge of breaking down says nothing about the effect, the others do
            if sum(sound) > SOUND * len(sound):
                found.append(
                    (point, [c if ok else np.zeros(len(c)) for c, ok in zip(changed, sound, strict=True)])
                )
        return found

    return [
        Trialled(effect, effect.parameters(context.model, context.trials), points)
        for effect, points in zip(effects, mapped(one, effects, jobs), strict=True)
    ]


def screen(context: FitContext, base: Fit, noise_model: NoiseModel, simulated: Sequence[Trialled]) -> Screen:
    """Compare all effects at all strengths, the base's numbers projected out."""
    columns: list[list[Array]] = []
    places: list[list[int]] = []
    for tried in simulated:
        places.append(list(range(len(columns), len(columns) + len(tried.points))))
        columns += [changed for _, changed in tried.points]
    inner = crossval.normal_equations(context, base, noise_model, columns)
    plain = crossval.held_out(inner)
    left = crossval.projected(inner)
    total = inner.products.sum(axis=0)
    found, left_out = [], {}
    for tried, at in zip(simulated, places, strict=True):
        effect, parameters, points = tried.effect, tried.parameters, tried.points
        shared = [j for j, p in enumerate(parameters) if not p.per_trial]
        if len(shared) < len(parameters):
            best = _apart(context, base, noise_model, effect, parameters, points, plain)
        else:
            best = _best(inner, effect, parameters, points, at, plain, left, total)
        if best is None:
            broke = not tried.points
            left_out[effect.name] = (
                "the model broke down with it: the effect could not be judged"
                if broke
                else "it changes nothing that was measured in these trials"
            )
        else:
            found.append(best)
            left_out.pop(effect.name, None)
    found.sort(key=lambda t: -t.gain)
    return Screen(found, left_out)


def _strength(parameters: Sequence[Parameter], point: Array) -> float:
    """Largest distance of a point from null, in typical sizes."""
    return (
        max((abs(v - p.start) / p.scale for v, p in zip(point, parameters, strict=True)), default=1.0) or 1.0
    )


def _allowed(null: Array, step: Array, factor: float, lower: Array, upper: Array) -> float:
    """The factor of a step from null, cut where it leaves the bounds."""
    with np.errstate(divide="ignore", invalid="ignore"):
        ends = np.array([(lower - null) / step, (upper - null) / step])
    ends = ends[:, step != 0.0]
    low = float(np.max(np.min(ends, axis=0), initial=-np.inf))
    high = float(np.min(np.max(ends, axis=0), initial=np.inf))
    return float(np.clip(factor, low, high))


def _best(
    inner: NormalEquations,
    effect: Effect,
    parameters: tuple[Parameter, ...],
    points: list[tuple[Array, list[Array]]],
    at: list[int],
    plain: Array,
    left: Array,
    total: Array,
) -> Tried | None:
    """The best of an effect's tries, single ones and one per parameter together."""
    best: Tried | None = None
    leaders: dict[tuple[int, ...], tuple[float, int]] = {}
    null = np.array([p.start for p in parameters])
    s = inner.shared

    def consider(chosen: list[int]) -> None:
        nonlocal best
        prior = [(_strength(parameters, points[i][0]) / EFFECT_PRIOR) ** 2 for i in chosen]
        where = [at[i] for i in chosen]
        gains = plain - crossval.held_out(inner, where, prior)
        factors = crossval.together(inner, where, prior)[s:]
        inside = np.array([p.lower for p in parameters]), np.array([p.upper for p in parameters])
        if len(chosen) == 1:
            tried_at = points[chosen[0]][0]
            moved = tuple(int(j) for j in np.flatnonzero(tried_at != null))
            if gains.sum() > leaders.get(moved, (-np.inf, 0))[0]:
                leaders[moved] = (float(gains.sum()), chosen[0])
            # a size out of bounds is no size: what the effect does there is what it does at the bound; and
            # what has no size is there as a whole
            allowed = _allowed(null, tried_at - null, float(factors[0]), *inside) if parameters else 1.0
            if allowed != factors[0]:
                gains = np.minimum(gains, plain - crossval.held_out_less(inner, where[0], allowed))
                factors = np.array([allowed])
        point = null + sum(f * (points[i][0] - null) for f, i in zip(factors, chosen, strict=True))
        if best is None or gains.sum() > best.gain:
            whole = float(total[s + where[0], s + where[0]])
            own = float(left[where[0], where[0]])
            signature = [
                sum(f * points[i][1][k] for f, i in zip(factors, chosen, strict=True))
                for k in range(len(points[0][1]))
            ]
            best = Tried(
                effect,
                parameters,
                np.clip(point, *inside),
                gains,
                float(np.clip(1.0 - own / whole, 0.0, 1.0)) if whole > 0 else 1.0,
                signature,  # type: ignore[arg-type]
            )

    for i, _ in enumerate(points):
        if total[s + at[i], s + at[i]] > NOTHING:
            consider([i])
    if len(leaders) > 1:
        consider([i for _, i in leaders.values()])
    if best is not None:
        raw = [(float((plain - crossval.held_out_less(inner, at[i])).sum()), i) for i, _ in enumerate(points)]
        helped = sorted(raw)[::-1][:STARTS]
        best = replace(best, starts=[points[i][0] for _, i in helped])
        if not effect.smooth and helped and helped[0][0] > best.gain:
            best = replace(best, gains=plain - crossval.held_out_less(inner, at[helped[0][1]]))
    return best


def _apart(
    context: FitContext,
    base: Fit,
    noise_model: NoiseModel,
    effect: Effect,
    parameters: tuple[Parameter, ...],
    points: list[tuple[Array, list[Array]]],
    plain: Array,
) -> Tried | None:
    """The best try of an effect some of whose parameters each trial has for itself."""
    single = [j for j, p in enumerate(parameters) if p.per_trial]
    null = np.array([p.start for p in parameters])
    groups: dict[bytes, list[int]] = {}
    for i, (point, _) in enumerate(points):
        held = np.delete(point, single)
        groups.setdefault(held.tobytes(), []).append(i)
    best: Tried | None = None
    for members in groups.values():
        # one try for each parameter of its own suffices, the change is linear in it
        kept: dict[tuple[int, ...], int] = {}
        for i in members:
            moved = tuple(j for j in single if points[i][0][j] != null[j])
            if moved:
                kept.setdefault(moved, i)
        own = [points[i][1] for i in kept.values()]
        if not own or sum(float(np.vdot(c, c)) for o in own for c in o) < NOTHING:
            continue
        gains = own_gains(context, base, noise_model, own)
        if best is None or gains.sum() > best.gain:
            point = points[next(iter(kept.values()))][0]
            signature = [np.sum([o[k] for o in own], axis=0) for k in range(len(context.trials))]
            best = Tried(effect, parameters, point, gains, 0.0, signature)
    return best


def alike(context: FitContext, base: Fit, noise_model: NoiseModel, first: Tried, second: Tried) -> float:
    """Cosine between two effects' changes, the base's numbers projected out."""
    inner = crossval.projected(
        crossval.normal_equations(context, base, noise_model, [first.signature, second.signature])
    )
    norm = np.sqrt(max(inner[0, 0], 0.0) * max(inner[1, 1], 0.0))
    return float(inner[0, 1] / norm) if norm > 0 else 0.0


def own(fit: Fit, name: str, scale: float) -> list[Array]:
    """Derivatives of each trial to its own value of a parameter, per typical size."""
    found = []
    for k, rows in enumerate(fit.rows):
        mine = [
            j
            for j, (label, (_, owner)) in enumerate(zip(fit.labels, fit.problem.slots, strict=True))
            if owner == k and label.split("[")[0] == name
        ]
        found.append(rows[:, mine[0]] * scale if mine else np.zeros(len(rows)))
    return found


def own_gains(
    context: FitContext, base: Fit, noise_model: NoiseModel, own: Sequence[Sequence[Array]]
) -> Array:
    """Drop of misfit by changes whose size each trial has for itself, shape (folds,).

    The size is estimated from three quarters of a trial and judged on the other, in turn: what fits any
    start or any drift does not do so.

    Parameters
    ----------
    own : sequence of lists of ndarray
        Changes of each trial, weighted, per typical size.
    """
    problem = base.problem
    gains = np.zeros(context.folds.count)
    q = len(own)
    for k, trial in enumerate(context.trials):
        block = np.column_stack([*(c[k] for c in own), base.residuals[k]])
        seen = crossval.project_out(context, base, noise_model, k, block)[: len(block)]
        times = np.concatenate(
            [trial.time_s[mask] for mask in problem.masks[k]] if problem.masks[k] else [np.empty(0)]
        )
        cut = np.quantile(times, np.linspace(0, 1, PARTS + 1)[1:-1]) if len(times) else np.empty(0)
        part = np.searchsorted(cut, times, side="right")
        products = np.array([seen[part == b].T @ seen[part == b] for b in range(PARTS)])
        total = products.sum(axis=0)
        gain = 0.0
        for inner in products:
            rest = total - inner
            normal = rest[:q, :q] + np.eye(q) / EFFECT_PRIOR**2
            factor = np.linalg.solve(normal, rest[:q, q])
            gain += float(2.0 * factor @ inner[:q, q] - factor @ inner[:q, :q] @ factor)
        gains[int(context.folds.owner[k][0]) if len(context.folds.owner[k]) else 0] += gain
    return gains
