"""What trials could show: the smallest size of each effect, and the effects they never tell from it.

Nothing is asked of a cause here. The changes that effects make in these trials, the numbers of the model
projected out, are held against the noise of the very trials, by the rule a diagnosis decides by.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq
from scipy.stats import ncx2

from swimid.diagnosis import candidates, crossval, posterior
from swimid.diagnosis.posterior import CALIBRATED, UNSURE, Record
from swimid.diagnosis.power_file import Row
from swimid.diagnosis.search import Search, context_of
from swimid.effects.base import Effect
from swimid.fitting.model import Array, Model, Parameter, Trial

#: How often an effect of the size told is to be seen.
POWER = 0.9
#: Share of a change that is left of rounding once the model's numbers are projected out.
ROUNDING = 1e-9


@dataclass(frozen=True)
class _Column:
    """An effect at one size: its distance from none in typical sizes, and what tells it."""

    strength: float
    place: int
    parameter: Parameter
    value: float


@dataclass(frozen=True)
class _Line:
    """An effect along one direction of its parameters."""

    effect: Effect
    columns: tuple[_Column, ...]
    kinds: int
    shared: int
    per_trial: int


def needed(record: Record, kinds: int) -> float:
    """Excess of the model without an effect from which a gap is told, the effect leaving none."""
    costs = CALIBRATED.number * kinds - posterior.prior(1, record.effects)
    wanted = costs + math.log((1.0 - UNSURE) / UNSURE)
    directions = CALIBRATED.directions * record.parts
    share = math.expm1(2.0 * wanted / directions)
    # u grows with the gap: beyond so many times it nothing is enough
    room = 1.0 - CALIBRATED.form * share
    return share * posterior.unit(record, 0.0) / room if room > 0 else math.inf


def noncentrality(drop: float, numbers: int) -> float:
    """What squared change, in units of the noise, lowers the cost by so much with 90 % power."""
    if not math.isfinite(drop):
        return math.inf

    def missed(size: float) -> float:
        return float(ncx2.cdf(drop, numbers, size)) - (1.0 - POWER)

    high = 4.0 * drop + 40.0 + 4.0 * numbers
    return float(brentq(missed, 1e-9, high)) if missed(1e-9) > 0 else 0.0


def told_apart(record: Record, cosine: float) -> bool:
    """Whether a very large effect is told from another whose change is so like its own."""
    left = max(1.0 - cosine**2, 0.0)
    return 0.5 * CALIBRATED.directions * record.parts * math.log1p(left / CALIBRATED.form) > math.log(
        (1.0 - UNSURE) / UNSURE
    )


def begun(
    model: Model,
    parameters: Sequence[Parameter],
    trials: Sequence[Trial],
    prior: Mapping[str, tuple[float, float]],
    effects: Sequence[Effect],
    *,
    seed: int = 0,
    jobs: int = 1,
) -> Search:
    """The model alone, with the noise that it and a generic description of what is left leave."""
    context, noise_model, fit, _ = context_of(model, parameters, trials, prior, effects, jobs=jobs)
    search = Search(context, noise_model, effects, effects, rng=np.random.default_rng(seed), jobs=jobs)
    search.begin(context.start((), noise_model, fit))
    search.learn(search.null)
    return search


def shown(search: Search, effects: Sequence[Effect]) -> tuple[list[Row], Mapping[str, str]]:
    """What the trials of a search could show of each effect, and why nothing of some.

    Returns
    -------
    list of Row
        An effect each, in the order given.
    mapping of name to reason
    """
    context, base, noise_model = search.context, search.null.fit, search.noise_model
    simulated = candidates.simulate(context, base, effects, jobs=search.jobs)
    columns: list[list[Array]] = []
    lines: list[_Line] = []
    left_out: dict[str, str] = {}
    for tried in simulated:
        found = _lines(tried, columns, len(context.trials))
        if not found:
            left_out.setdefault(
                tried.effect.name,
                "it changes nothing that was measured in these trials"
                if tried.points
                else "the model breaks down with it",
            )
        lines += found
    inner = crossval.normal_equations(context, base, noise_model, columns)
    left = crossval.projected(inner)[:-1, :-1]
    whole = inner.products.sum(axis=0)[inner.shared : -1, inner.shared : -1]
    record = search.record
    best: dict[str, tuple[float, Row, int]] = {}
    for line in lines:
        penalty = posterior.penalty(line.shared, line.per_trial, record.samples, len(context.trials))
        drop = needed(record, line.kinds) + penalty
        wanted = noncentrality(drop, line.shared + line.per_trial)
        squares = np.array([max(left[c.place, c.place], 0.0) for c in line.columns])
        total = np.array([whole[c.place, c.place] for c in line.columns])
        seen = squares > ROUNDING * total
        strength, at = _strength(line.columns, np.where(seen, squares, 0.0), wanted)
        column = line.columns[at]
        p = column.parameter
        size = p.start + (column.value - p.start) * strength / column.strength
        inside = p.lower <= size <= p.upper
        absorbed = float(np.clip(1.0 - squares[at] / total[at], 0.0, 1.0)) if total[at] > 0 else 1.0
        name = line.effect.name
        if name not in best or strength < best[name][0]:
            row = Row(
                effect=name,
                stage=line.effect.stage,
                parameter=p.name,
                size=size if inside else None,
                unit=p.unit,
                absorbed=absorbed,
            )
            best[name] = strength, row, column.place
        left_out.pop(name, None)
    for name, (_, row, place) in best.items():
        if row.size is not None:
            row.alike = [
                other
                for other, (_, _, there) in best.items()
                if other != name and not told_apart(record, _cosine(left, place, there))
            ]
    return [row for _, row, _ in best.values()], left_out


def _lines(tried: candidates.Trialled, columns: list[list[Array]], trials: int) -> list[_Line]:
    """The directions an effect is tried in; their changes are put to the columns."""
    null = np.array([p.start for p in tried.parameters])
    groups: dict[tuple[int, ...], list[_Column]] = {}
    for point, changed in tried.points:
        moved = tuple(int(j) for j in np.flatnonzero(point != null))
        size = sum(float(c @ c) for c in changed)
        if not moved or not size > candidates.NOTHING:
            continue
        # the first parameter says how large it is; the rest say where and when
        p, value = tried.parameters[moved[0]], float(point[moved[0]])
        column = _Column(abs(value - p.start) / p.scale, len(columns), p, value)
        groups.setdefault(moved, []).append(column)
        columns.append(changed)
    per_trial = sum(p.per_trial for p in tried.parameters)
    kinds = len(tried.parameters)
    return [
        _Line(tried.effect, tuple(members), kinds, kinds - per_trial, per_trial * trials)
        for members in groups.values()
    ]


def _strength(columns: Sequence[_Column], squares: Array, wanted: float) -> tuple[float, int]:
    """Distance from none at which the squared change is as wanted, and the column nearest to it.

    From there it goes by the square of the size.
    """
    nearest, best = 0, math.inf
    for i, (c, square) in enumerate(zip(columns, squares, strict=True)):
        if square <= 0:
            continue
        strength = c.strength * math.sqrt(wanted / square)
        if abs(math.log(strength / c.strength)) < best:
            nearest, best = i, abs(math.log(strength / c.strength))
    if not math.isfinite(best):
        return math.inf, 0
    c = columns[nearest]
    return c.strength * math.sqrt(wanted / squares[nearest]), nearest


def _cosine(inner: Array, i: int, j: int) -> float:
    norm = math.sqrt(max(inner[i, i], 0.0) * max(inner[j, j], 0.0))
    return float(inner[i, j] / norm) if norm > 0 else 0.0
