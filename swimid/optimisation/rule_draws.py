"""How sure a stiffness rule is: its optima looked for again in draws of the coefficients."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from swimid.files.checkpoint import Checkpoint
from swimid.fitting.model import Array
from swimid.fitting.parallel import in_threads
from swimid.optimisation.descent import KEPT_TO, WORST, descend
from swimid.optimisation.draws import drawn
from swimid.optimisation.rule import Optimum, RuleFile, fitted
from swimid.optimisation.search import Search
from swimid.progress import Progress

#: Radius from which the searches in draws begin, and at which they end, as a share of the range searched.
NEAR, LAST = 0.01, 0.0015
#: Steps at most: an optimum farther off is walked to.
STEPS = 14


@dataclass(frozen=True)
class Redone:
    """An optimum in draws of the coefficients.

    Attributes
    ----------
    stiffness : ndarray, shape (draws,)
        NaN where no stiffness reaches the speed asked for.
    lost : ndarray, shape (draws,)
        What the rule loses of the objective there, as a share.
    reached : ndarray, shape (draws,)
        Speed with the rule over the one asked for; infinite where none is.
    """

    stiffness: Array
    lost: Array
    reached: Array


def carry(search: Search, file: RuleFile, keep: Checkpoint, progress: Progress) -> None:
    """Carry the coefficients' covariance into a rule: optima, curves and losses in draws of them.

    Notes
    -----
    The optimum at each point of the grid is looked for anew in every draw, from that of the estimates on; the
    curves are fitted anew to what was found. The search beyond the front's end is one by differences.
    """
    options = search.options
    draws = drawn(search.performance.applied, options.draws, options.seed)
    file.draws, file.refused = len(draws.vectors), draws.refused
    file.inside = draws.inside if draws.inside < file.draws else None
    optima = [o for o in file.optima if o.stiffness is not None]

    def one(k: int) -> Array:
        def compute() -> Array:
            made = _redone(search, file, optima[k], draws.vectors)
            return np.concatenate([made.stiffness, made.lost, made.reached])

        return keep.kept(f"draws {k}", compute).reshape(3, -1)

    found = []
    with (
        progress("rule in draws", total=len(optima)) as step,
        in_threads(one, range(len(optima)), options.jobs or os.cpu_count() or 1) as results,
    ):
        for part in results:
            found.append(Redone(*part))
            step()
    for optimum, made in zip(optima, found, strict=True):
        _tell(optimum, made)
    for curve in file.curves:
        at = [k for k, o in enumerate(optima) if o.amplitude_deg == curve.amplitude_deg]
        f = np.array([optima[k].frequency_hz for k in at])
        columns = np.array([found[k].stiffness for k in at])
        curve.drawn = [_curve(f, column) for column in columns.T]


def _redone(search: Search, file: RuleFile, optimum: Optimum, vectors: Sequence[Array]) -> Redone:
    point = {"frequency_hz": optimum.frequency_hz, "amplitude_deg": optimum.amplitude_deg}
    (low, high), count = search.between, len(vectors)
    assert optimum.stiffness is not None
    scale = optimum.power_W or 1.0

    def parts(stiffness: Array, owner: NDArray[np.int64]) -> Array:
        return search.parts(point, stiffness, [vectors[k] for k in owner], scale)

    found = descend(
        lambda x, owner: parts(low + x[:, 0] * (high - low), owner),
        np.full((count, 1), (optimum.stiffness - low) / (high - low)),
        first=NEAR,
        last=LAST,
        steps=STEPS,
    )
    best = low + found.points[:, 0] * (high - low)
    ruled = file.stiffness_for(optimum.frequency_hz, optimum.amplitude_deg, outside="hold")
    each = np.arange(count)
    own = parts(best, each)
    with_rule = parts(np.full(count, ruled), each)
    with np.errstate(invalid="ignore", divide="ignore"):
        lost = (with_rule[:, 0] - own[:, 0]) / np.abs(own[:, 0])
    if own.shape[1] == 1:
        return Redone(best, lost, np.full(count, math.inf))
    best[~(own[:, 1] <= KEPT_TO * search.penalty(scale))] = math.nan
    return Redone(best, lost, 1.0 - with_rule[:, 1] / search.penalty(scale))


def _tell(optimum: Optimum, made: Redone) -> None:
    there = np.isfinite(made.stiffness)
    if there.any():
        ends = np.quantile(made.stiffness[there], [0.025, 0.975], method="weibull")
        optimum.stiffness_ci95 = (float(ends[0]), float(ends[1]))
    limited = np.isfinite(made.reached).any()
    if limited:
        optimum.reached_in_draws = float(np.mean(made.reached >= 1.0 - KEPT_TO))
    else:
        lost = np.nan_to_num(made.lost, nan=math.inf)
        told = float(np.quantile(lost, 1.0 - WORST, method="higher"))
        optimum.loss_90 = max(told, 0.0) if math.isfinite(told) else None


def _curve(frequency_hz: Array, stiffness: Array) -> list[Any]:
    there = np.isfinite(stiffness)
    if not there.any():
        return [None, None, None]
    return list(fitted(frequency_hz[there], stiffness[there]).coefficients)
