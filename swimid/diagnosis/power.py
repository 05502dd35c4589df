"""What trials could show: the smallest size of each effect, and the effects they never tell from it.

Nothing is asked of a cause here. The changes that effects make in these trials, the numbers of the model
projected out, are held against the noise of the very trials, by the rule a diagnosis decides by.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import chndtrinc

from swimid.diagnosis import candidates, crossval, posterior
from swimid.diagnosis.candidates import Trialled
from swimid.diagnosis.context import FitContext
from swimid.diagnosis.posterior import CALIBRATED, UNSURE, Record
from swimid.diagnosis.power_file import Row
from swimid.diagnosis.search import Search, context_of
from swimid.effects.base import Effect
from swimid.fitting.model import Array, Parameter

#: How often an effect of the size told is to be seen.
POWER = 0.9
#: Share of a change that is left of rounding once the model's numbers are projected out.
ROUNDING = 1e-9


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
    return float(chndtrinc(drop, numbers, 1.0 - POWER)) if math.isfinite(drop) else math.inf


def told_apart(record: Record, cosine: float) -> bool:
    """Whether a very large effect is told from another whose change is so like its own."""
    left = max(1.0 - cosine**2, 0.0)
    return 0.5 * CALIBRATED.directions * record.parts * math.log1p(left / CALIBRATED.form) > math.log(
        (1.0 - UNSURE) / UNSURE
    )


class _Line(NamedTuple):
    """An effect along one direction of its parameters.

    Attributes
    ----------
    parameter : Parameter
        Says how large it is; the others that are not null say where and when.
    values : ndarray, shape (n,)
        Its values tried.
    places : ndarray of int, shape (n,)
        Of the changes they make, among all columns.
    """

    tried: Trialled
    parameter: Parameter
    values: Array
    places: NDArray[np.intp]


def shown(
    given: FitContext, effects: Sequence[Effect], asked: Collection[str] | None, *, seed: int
) -> tuple[list[Row], dict[str, str]]:
    """What trials could show of each effect, and why nothing of some.

    The noise is what the model alone and a generic description of what is left leave.

    Parameters
    ----------
    effects : sequence of Effect
        All that apply, in every form.
    asked : collection of str or None
        Names of those asked about; None for all.

    Returns
    -------
    list of Row
        An effect each, in the order given.
    dict of name to reason
    """
    context, noise_model, fit, _ = context_of(given, effects)
    search = Search(context, noise_model, effects, effects, rng=np.random.default_rng(seed))
    search.begin(context.start((), noise_model, fit))
    search.learn(search.null)
    base, record = search.null.fit, search.record
    wanted = [e for e in effects if asked is None or e.name in asked]
    columns: list[list[Array]] = []
    lines: list[_Line] = []
    left_out: dict[str, str] = {}
    for tried in candidates.simulate(context, base, wanted):
        found = _lines(tried, columns)
        lines += found
        if not found:
            nothing = "it changes nothing that was measured in these trials"
            left_out.setdefault(
                tried.effect.name, nothing if tried.points else "the model breaks down with it"
            )
    inner = crossval.normal_equations(context, base, search.noise_model, columns)
    left = crossval.projected(inner)[:-1, :-1]
    whole = inner.products.sum(axis=0).diagonal()[inner.shared : -1]
    best: dict[str, tuple[float, Row, int]] = {}
    for line in lines:
        effect, p, kinds = line.tried.effect, line.parameter, len(line.tried.parameters)
        of_trials = sum(one.per_trial for one in line.tried.parameters)
        shared, per_trial = kinds - of_trials, of_trials * len(context.trials)
        penalty = posterior.penalty(shared, per_trial, record.samples, len(context.trials))
        needs = noncentrality(needed(record, kinds) + penalty, shared + per_trial)
        squares = np.maximum(left.diagonal()[line.places], 0.0)
        total = whole[line.places]
        strengths = np.abs(line.values - p.start) / p.scale
        strength, at = _strength(strengths, np.where(squares > ROUNDING * total, squares, 0.0), needs)
        if effect.name not in best or strength < best[effect.name][0]:
            size = float(p.start + (line.values[at] - p.start) * strength / strengths[at])
            row = Row(
                effect=effect.name,
                stage=effect.stage,
                parameter=p.name,
                size=size if p.lower <= size <= p.upper else None,
                unit=p.unit,
                absorbed=candidates.absorbed(squares[at], total[at]),
            )
            best[effect.name] = strength, row, int(line.places[at])
    for name, (_, row, place) in best.items():
        if row.size is not None:
            row.alike = [
                other
                for other, (_, _, there) in best.items()
                if other != name and not told_apart(record, candidates.cosine(left, place, there))
            ]
    return [row for _, row, _ in best.values()], {n: why for n, why in left_out.items() if n not in best}


def _lines(tried: Trialled, columns: list[list[Array]]) -> list[_Line]:
    """The directions an effect is tried in; their changes are put to the columns."""
    null = np.array([p.start for p in tried.parameters])
    groups: dict[tuple[int, ...], list[tuple[float, int]]] = {}
    for point, changed in tried.points:
        moved = tuple(np.flatnonzero(point != null).tolist())
        if moved and sum(float(c @ c) for c in changed) > candidates.NOTHING:
            groups.setdefault(moved, []).append((float(point[moved[0]]), len(columns)))
            columns.append(changed)
    return [
        _Line(tried, tried.parameters[moved[0]], *(np.array(part) for part in zip(*members, strict=True)))
        for moved, members in groups.items()
    ]


def _strength(strengths: Array, squares: Array, wanted: float) -> tuple[float, int]:
    """Distance from none at which the squared change is as wanted, and the try nearest to it.

    From there it goes by the square of the size; infinite where there is none.
    """
    with np.errstate(divide="ignore"):
        reached = strengths * np.sqrt(wanted / squares)
    nearest = int(np.argmin(np.abs(np.log(reached / strengths))))
    return float(reached[nearest]), nearest
