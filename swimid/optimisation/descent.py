"""Gradient searches in lockstep: many of them, each with one evaluation of all their points a step."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from swimid.fitting.model import Array

#: First and last radius of the differences, as a share of the range.
FIRST, LAST = 0.1, 1e-3
#: Steps at most.
STEPS = 24
#: A value that is no number counts as this.
BROKEN = 1e9
#: Points at which a model of the function is looked at, and how often that is repeated in a smaller box.
LOOKED, ZOOMS = 512, 3

#: What is minimised and by how much each limit is passed, shape (n, 1 + limits), at points in the unit cube,
#: shape (n, d), of the searches they belong to, shape (n,). A limit that is kept to is negative.
Evaluate = Callable[[Array, NDArray[np.int64]], Array]


@dataclass(frozen=True)
class Descended:
    """Where searches ended.

    Attributes
    ----------
    points : ndarray, shape (k, d)
    values : ndarray, shape (k,)
        What is minimised there, with what passing limits costs.
    """

    points: Array
    values: Array

    @property
    def best(self) -> int:
        """The search that found the least value."""
        return int(np.argmin(self.values))


def merit(parts: Array) -> Array:
    """What is minimised with what passing limits costs, shape (n,), of parts, shape (n, 1 + limits)."""
    total = parts[:, 0] + np.maximum(parts[:, 1:], 0.0).sum(axis=1)
    return np.minimum(np.nan_to_num(total, nan=BROKEN, posinf=BROKEN), BROKEN)


def descend(
    evaluate: Evaluate,
    starts: Array,
    *,
    first: float = FIRST,
    last: float = LAST,
    steps: int = STEPS,
    advance: Callable[[], Any] = lambda: None,
) -> Descended:
    """Minimise from several starts within the unit cube and limits.

    Parameters
    ----------
    starts : ndarray, shape (k, d)
    first, last : float
        Radius of the differences at the beginning, and below which a search ends.

    Notes
    -----
    Central differences give the gradient and the curvature along each axis of what is minimised and of each
    limit. The minimum of that model, limits costing what they are passed by, within a box of twice the radius
    competes with the points of the differences. The radius halves where nothing is better, and where the step
    is small against it. Points of differences that would leave the cube lie on its face.

    >>> def bowl(x, owner):
    ...     return np.column_stack([(x[:, 0] - 0.3) ** 2 + 4 * (x[:, 1] - 1.2) ** 2])
    >>> [round(float(v), 2) for v in descend(bowl, np.array([[0.5, 0.5]])).points[0]]
    [0.3, 1.0]
    """
    points = np.array(starts, dtype=float)
    count, width = points.shape
    parts = evaluate(points, np.arange(count))
    values = merit(parts)
    radius = np.full(count, first)
    for _ in range(steps):
        active = np.flatnonzero(radius >= last)
        if not len(active):
            break
        stencil = np.repeat(points[active][:, None, :], 2 * width, axis=1)
        for k in range(width):
            stencil[:, 2 * k, k] -= radius[active]
            stencil[:, 2 * k + 1, k] += radius[active]
        stencil = np.clip(stencil, 0.0, 1.0)
        around = evaluate(stencil.reshape(-1, width), np.repeat(active, 2 * width))
        around = around.reshape(len(active), 2 * width, -1)
        suggested = np.array(
            [_step(points[j], parts[j], stencil[n], around[n], radius[j]) for n, j in enumerate(active)]
        )
        tried = evaluate(suggested, active)
        gain = merit(tried)
        for n, j in enumerate(active):
            near = merit(around[n])
            at = int(np.argmin(near))
            moved = float(np.abs(suggested[n] - points[j]).max())
            if gain[n] <= near[at] and gain[n] < values[j]:
                points[j], parts[j], values[j] = suggested[n], tried[n], gain[n]
                radius[j] *= 0.5 if moved < radius[j] else 1.0
            elif near[at] < values[j]:
                points[j], parts[j], values[j] = stencil[n, at], around[n, at], near[at]
            else:
                radius[j] *= 0.5
        advance()
    return Descended(points, values)


@cache
def _cube(width: int) -> Array:
    """Even points of the cube from -1 to 1, its middle among them."""
    from scipy.stats import qmc

    points = 2.0 * qmc.Sobol(width, scramble=False).random(LOOKED) - 1.0
    return np.vstack([np.zeros(width), points])


def _step(point: Array, parts: Array, stencil: Array, around: Array, radius: float) -> Array:
    """Where the differences suggest the minimum, within the cube and twice the radius."""
    if not np.isfinite(parts).all():
        return np.asarray(stencil[int(np.argmin(merit(around)))])
    slope, bend = np.zeros((2, len(point), len(parts)))
    for k in range(len(point)):
        ends = [(stencil[m, k] - point[k], around[m]) for m in (2 * k, 2 * k + 1)]
        told = [(away, (to - parts) / away) for away, to in ends if away and np.isfinite(to).all()]
        if len(told) == 2:
            (a, down), (b, up) = told
            bend[k] = 2.0 * (up - down) / (b - a)
            slope[k] = down - 0.5 * bend[k] * a
        elif told:
            slope[k] = told[0][1]
    middle, half = np.zeros(len(point)), 2.0 * radius
    for _ in range(ZOOMS):
        moves = np.clip(point + middle + half * _cube(len(point)), 0.0, 1.0) - point
        moves = np.clip(moves, -2.0 * radius, 2.0 * radius)
        model = parts + moves @ slope + 0.5 * moves**2 @ bend
        middle, half = moves[int(np.argmin(merit(model)))], 0.2 * half
    return np.asarray(point + middle)
