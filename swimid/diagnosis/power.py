"""Compute the detection power of trials.

The results are the smallest detectable size of each effect, and the effects that cannot be distinguished. No
cause is sought. The change of these trials by each effect, with the model's parameters projected out, is
compared with the noise of the trials. The decision rule is that of a diagnosis.
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

#: Probability with which an effect of the reported size is detected.
POWER = 0.9
#: Minimum fraction of a squared change that remains after the model's parameters are projected out. A smaller
#: remainder is rounding error.
ROUNDING = 1e-9


def needed(record: Record, kinds: int) -> float:
    """Return the minimum excess of the model without an effect for which a gap is reported, if the effect
    closes the whole gap.
    """
    costs = CALIBRATED.number * kinds - posterior.prior(1, record.effects)
    wanted = costs + math.log((1.0 - UNSURE) / UNSURE)
    directions = CALIBRATED.directions * record.parts
    share = math.expm1(2.0 * wanted / directions)
    # The excess that is no evidence grows with the gap. Without room for it, no excess is enough.
    room = 1.0 - CALIBRATED.form * share
    return share * posterior.unit(record, 0.0) / room if room > 0 else math.inf


def noncentrality(drop: float, numbers: int) -> float:
    """Return the squared change, in units of the noise variance, that reduces the cost by at least ``drop``.

    The probability of such a reduction is 90 %.
    """
    return float(chndtrinc(drop, numbers, 1.0 - POWER)) if math.isfinite(drop) else math.inf


def told_apart(record: Record, cosine: float) -> bool:
    """Return whether a very large effect can be distinguished from another effect.

    The cosine is the one between the changes of the trials by the two effects.
    """
    left = max(1.0 - cosine**2, 0.0)
    return 0.5 * CALIBRATED.directions * record.parts * math.log1p(left / CALIBRATED.form) > math.log(
        (1.0 - UNSURE) / UNSURE
    )


class _Line(NamedTuple):
    """An effect whose size varies along one direction of its parameters.

    Attributes
    ----------
    parameter : Parameter
        Parameter that states the size of the effect. Further parameters that are not at their null values
        state place and time.
    values : ndarray, shape (n,)
        Tried values of the parameter.
    places : ndarray of int, shape (n,)
        Column indices of the changes of the trials at these values.
    """

    tried: Trialled
    parameter: Parameter
    values: Array
    places: NDArray[np.intp]


def shown(
    given: FitContext, effects: Sequence[Effect], asked: Collection[str] | None, *, seed: int
) -> tuple[list[Row], dict[str, str]]:
    """Return the detection power of each effect, and the reason for each effect that has none.

    The noise is estimated from the residuals of the model. Structure that a generic description finds in
    these residuals (:mod:`swimid.diagnosis.remainder`) does not count as noise.

    Parameters
    ----------
    effects : sequence of Effect
        All effects that apply, in every form.
    asked : collection of str or None
        Names of the requested effects; None for all effects.

    Returns
    -------
    list of Row
        One row for each effect, in the order given.
    dict of name to reason
        Effects without a detection power.
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
    """Return the directions in which an effect is tried, and append the changes of the trials to
    ``columns``.
    """
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
    """Return the distance from the null value at which the squared change reaches ``wanted``.

    The second value is the index of the nearest tried value. The squared change is assumed to be quadratic in
    the distance. The distance is infinite if the effect changes nothing.
    """
    with np.errstate(divide="ignore"):
        reached = strengths * np.sqrt(wanted / squares)
    nearest = int(np.argmin(np.abs(np.log(reached / strengths))))
    return float(reached[nearest]), nearest
