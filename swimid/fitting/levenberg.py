"""Levenberg-Marquardt for few parameters, many residuals and a box.

SciPy's trust-region method decomposes the whole Jacobian in every iteration; with thousands
of residuals and a handful of parameters the normal equations cost a tenth of that, and on
these well-scaled problems they lose nothing that matters. Both give the same optimum (tested).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from swimid.fitting.model import Array

#: Iterations after which a decrease that is small against the noise is small enough.
PATIENCE = 12
#: Steps that are looked at together where each may be small and all of them not: to see a search creep, and
#: to see that it does no more than noise hides.
STRIDE, BRIEF = 10, 5
#: A search creeps that has taken so many steps, of which the last `STRIDE` together hardly lowered the cost.
CREEPING = 40

#: A step that lowers the cost by less than this share of what it should have is corrected for curvature,
#: by no more than this share of its length.
STRAIGHT, BENT = 0.9, 0.75
#: Derivatives are carried over a step that lowered the cost by more than this share of what it should have,
#: and over so many steps at most.
FAITHFUL, CARRIED_STEPS = 0.75, 5
#: What is said of a search that ends: at rest, where no step helps, on an edge, in a valley.
STILL = "cost and parameters no longer change"
STUCK = "no step lowers the cost"
HIDDEN = "cost and estimates change by less than noise shows"
KINKED = "no step lowers the cost though the gradient does not vanish"
STALLED = "the search creeps"
#: Columns that are a handful.
FEW = 16


@dataclass(frozen=True)
class Solution:
    """A minimum of the sum of squares, and that sum there."""

    x: Array
    cost: float
    success: bool
    message: str
    iterations: int
    #: Given up though steps still lowered the cost a little.
    stalled: bool = False
    #: What the last `STRIDE` steps together lowered the cost by, and how far they went, shape (p,); infinite
    #: where there were fewer.
    lowered: float = math.inf
    moved: Array = field(default_factory=lambda: np.full(1, math.inf))


class Unnoticed(NamedTuple):
    """What noise hides: a search may end whose last `BRIEF` steps together did no more."""

    #: By which they lowered the cost.
    cost: float
    #: By which they moved each parameter, shape (p,); infinite for those that nothing is claimed of.
    move: Array


class _Tried(NamedTuple):
    """A step in typical sizes, where it leads, and the residuals and their squares there; NaN is infinite."""

    step: Array
    x: Array
    residuals: Array
    cost: float


# A step so bad that its cost overflows costs infinity, and is not taken.
@np.errstate(over="ignore", invalid="ignore")
def minimise(
    residuals: Callable[[Array], Array],
    jacobian: Callable[[Array], Array],
    start: Array,
    *,
    lower: Array,
    upper: Array,
    scale: Array,
    tolerance: float = 1e-10,
    enough: float = 0.0,
    little: float = 0.0,
    unnoticed: Unnoticed | None = None,
    max_iterations: int = 200,
    watch: Callable[[Array, float, int], None] | None = None,
    secant: Callable[[Array, Array, Array, Array], Array] | None = None,
    corrected: bool = False,
) -> Solution:
    """Minimise a sum of squares within bounds.

    Parameters
    ----------
    residuals : callable, (p,) -> (n,)
    jacobian : callable, (p,) -> (n, p)
    start, lower, upper, scale : ndarray, shape (p,)
        ``scale`` is the typical size of each parameter.
    tolerance : float
        Stop when neither the cost nor the parameters change by more than this, relatively.
    enough : float
        Once `PATIENCE` iterations are spent, stop when a step lowers the cost by less than this: along a
        valley the data hardly tell, the last digits would take for ever.
    little : float
        Once `CREEPING` iterations are spent, stop when the last `STRIDE` together lowered the cost by less
        than this share of it.
    unnoticed : Unnoticed, optional
        Stop when the last `BRIEF` steps together did no more than this.
    watch : callable, optional
        Called with the parameters, their cost and the iteration at the start and after every
        step that lowers the cost.
    secant : callable, (n, p), (n,), (p,), (p,) -> (n, p)
        Derivatives after a step, from those before, what the residuals there differ by from what those
        predicted, the step and the weight of each parameter in its length; parameters in typical sizes. With
        it derivatives are taken anew only where a step fell short (Broyden, Math. Comp. 19, 1965; Nielsen's
        "secant version").

    Notes
    -----
    Damping after Nielsen ("Damping parameter in Marquardt's method", 1999). Parameters that
    lie at a bound and are pushed against it sit out the step; one that would cross a bound goes
    to the bound and the others' step is solved anew with it there.
    """
    x = np.clip(np.asarray(start, dtype=float), lower, upper)
    if len(x) == 0:
        r = residuals(x)
        return Solution(x, float(r @ r), True, "nothing to estimate", 0)
    r = residuals(x)
    cost = float(r @ r)
    if not np.isfinite(cost):
        return Solution(x, cost, False, "the model cannot be simulated at the starting values", 0)
    attempt = partial(_attempt, residuals, lower, upper, scale)
    told = watch or (lambda x, cost, iteration: None)
    told(x, cost, 0)
    damping, growth = 1e-3, 2.0
    path = [(x, cost)]
    end = partial(_solution, path)
    iteration = 0
    while iteration < max_iterations:
        rows, age, renew = jacobian(x) * scale, 0, False
        while not renew and iteration < max_iterations:
            iteration += 1
            gradient, normal = _products(rows, r)
            blocked = ((x <= lower) & (gradient > 0)) | ((x >= upper) & (gradient < 0))
            free = ~blocked
            size = np.sqrt(np.maximum(np.diag(normal), 1e-300))
            # cosine between the residuals and each column
            slope = np.abs(gradient[free]) / (size[free] * np.sqrt(max(cost, 1e-300)))
            if not free.any() or cost <= 1e-300 or np.max(slope, initial=0.0) < 1e-12:
                return end(True, "the gradient vanishes", iteration)
            renew = True
            for _ in range(40):
                weight, low, high = damping * size**2, (lower - x) / scale, (upper - x) / scale
                taken = _step(normal, gradient, weight, low, high, blocked)
                predicted = -float(2 * taken @ gradient + taken @ normal @ taken)
                tried = attempt(x, taken)
                if corrected and cost - tried.cost < STRAIGHT * predicted and np.isfinite(tried.cost):
                    bent = partial(
                        _step, normal, damping=weight, low=low - taken, high=high - taken, blocked=blocked
                    )
                    tried = _corrected(tried, bent, attempt, x, r, rows, size)
                small = np.all(np.abs(tried.step) <= tolerance * (np.abs(x / scale) + tolerance))
                if tried.cost < cost:
                    lowered, off = cost - tried.cost, tried.residuals - r - rows @ tried.step
                    gain = lowered / predicted if predicted > 0 else 0.0
                    damping *= max(1.0 / 3.0, 1.0 - (2.0 * gain - 1.0) ** 3)
                    damping = max(damping, 1e-12)
                    growth = 2.0
                    done = lowered <= tolerance * cost and predicted <= 10 * tolerance * cost
                    slight = iteration > PATIENCE and max(lowered, predicted) < enough
                    x, r, cost = tried.x, tried.residuals, tried.cost
                    path.append((x, cost))
                    told(x, cost, iteration)
                    # derivatives carried along may be why it was small
                    fresh = not age
                    why = _reason(
                        path, iteration, fresh and bool(done or small), fresh and slight, unnoticed, little
                    )
                    if why is not None:
                        return end(True, why, iteration)
                    if (
                        secant is not None
                        and gain > FAITHFUL
                        and age < CARRIED_STEPS
                        and not (done or slight or small)
                    ):
                        rows, age, renew = secant(rows, off, tried.step, size**2), age + 1, False
                    break
                if age:
                    # derivatives carried along may be what is wrong
                    break
                if small or abs(predicted) <= 1e-3 * tolerance * cost:
                    return end(True, STUCK, iteration)
                damping *= growth
                growth *= 2.0
            else:
                return end(False, KINKED, iteration)
    return end(False, f"not converged after {max_iterations} iterations", max_iterations)


def _reason(
    path: list[tuple[Array, float]],
    iteration: int,
    still: bool,
    slight: bool,
    unnoticed: Unnoticed | None,
    little: float,
) -> str | None:
    """Why to end a search after a step, if at all."""
    if still:
        return STILL
    if slight:
        return HIDDEN
    x, cost = path[-1]
    if unnoticed is not None and len(path) > BRIEF:
        there, before = path[-1 - BRIEF]
        if before - cost <= unnoticed.cost and np.all(np.abs(x - there) <= unnoticed.move):
            return HIDDEN
    if iteration > CREEPING and len(path) > STRIDE and path[-1 - STRIDE][1] - cost < little * cost:
        return STALLED
    return None


def _solution(path: list[tuple[Array, float]], success: bool, message: str, iterations: int) -> Solution:
    """The end of a path of points and their costs."""
    x, cost = path[-1]
    there, before = path[-1 - STRIDE] if len(path) > STRIDE else (np.full(len(x), math.inf), math.inf)
    return Solution(x, cost, success, message, iterations, message == STALLED, before - cost, x - there)


def _attempt(
    residuals: Callable[[Array], Array], lower: Array, upper: Array, scale: Array, x: Array, step: Array
) -> _Tried:
    there = np.clip(x + step * scale, lower, upper)
    r = residuals(there)
    cost = float(r @ r)
    return _Tried(step, there, r, cost if np.isfinite(cost) else math.inf)


def _corrected(
    tried: _Tried,
    solve: Callable[[Array], Array],
    attempt: Callable[[Array, Array], _Tried],
    x: Array,
    r: Array,
    rows: Array,
    size: Array,
) -> _Tried:
    """A step less what its residuals differ from the predicted ones by, where that is short and better."""
    bent = solve(rows.T @ (tried.residuals - r - rows @ tried.step))
    if np.linalg.norm(bent * size) > BENT * np.linalg.norm(tried.step * size):
        return tried
    return min(tried, attempt(x, tried.step + bent), key=lambda t: t.cost)


def _products(rows: Array, r: Array) -> tuple[Array, Array]:
    """Products of the columns with residuals and with each other, shapes (p,) and (p, p)."""
    if rows.shape[1] <= FEW:
        # waking BLAS threads for a handful of columns costs more than the sums
        return np.einsum("ij,i->j", rows, r), np.einsum("ij,ik->jk", rows, rows)
    return rows.T @ r, rows.T @ rows


def _step(
    normal: Array, gradient: Array, damping: Array, low: Array, high: Array, blocked: NDArray[np.bool_]
) -> Array:
    """Damped Gauss-Newton step within ``low .. high``, by fixing what would cross."""
    step = np.zeros(len(gradient))
    fixed = blocked.copy()
    while not fixed.all():
        free = ~fixed
        matrix = normal[np.ix_(free, free)] + np.diag(damping[free])
        right = -(gradient[free] + normal[np.ix_(free, fixed)] @ step[fixed])
        scale = 1.0 / np.sqrt(np.maximum(np.diag(matrix), 1e-300))
        step[free] = scale * np.linalg.solve(scale[:, None] * matrix * scale, right * scale)
        below, above = free & (step < low), free & (step > high)
        if not (below | above).any():
            break
        step = np.where(below, low, np.where(above, high, step))
        fixed |= below | above
    return step
