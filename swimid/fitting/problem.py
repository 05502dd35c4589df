"""The least-squares problem of an output-error fit, and its Levenberg-Marquardt search inside bounds.

:class:`Problem` has the residuals of all trials and their derivatives; :func:`minimise` searches. SciPy's
trust-region method decomposes the whole Jacobian in every iteration; with thousands of residuals and a
handful of parameters the normal equations cost a tenth of that, and on these well-scaled problems they lose
nothing that matters. Both give the same optimum (tested).
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from swimid.fitting.model import Array, Model, Parameter, Trial

#: Simulations that take longer than this, s, are shared among threads.
WORTH_A_THREAD = 3e-4
#: Derivatives are taken anew once the parameters have moved by more than this many standard
#: errors; an optimum found with the old ones is off by far less.
NEAR = 0.01
#: Weighted residual of a sample the model cannot simulate.
BROKEN = 1e6
#: Decrease of the squared residuals, in variances, that moves an estimate by a thirtieth of its error.
IMMATERIAL = 1e-3
#: Share of the squared residuals that ten steps of a search must lower.
LITTLE = 2e-4
#: Points whose simulations are kept.
KEPT = 5


class Problem:
    """Residuals and their derivatives as functions of the estimated numbers.

    Simulations and derivatives are kept unweighted, so that a change of weights costs none.

    Attributes
    ----------
    labels : list of str, length p
        One per estimated number; a per-trial parameter appears as ``name[trial]``.
    slots : list of (int, int or None), length p
        Parameter of each number, and the trial it belongs to.
    taken : list of (ndarray, ndarray)
        Of each trial, the parameters that are estimated and their places among the numbers.
    channels : list of list of str
        Channels of each trial that hold samples.
    masks, sd, damping : list of list of ndarray, each shape (n_k,)
        By trial and channel: where samples are, their standard deviations, and the factor (at
        most 1) by which a robust loss reduces a sample's residual.
    evaluations, jacobians : int
        Simulations of single trials so far, and derivatives of all residuals.
    jobs : int
        Threads among which simulations are shared when they take long; the results do not
        depend on it. :meth:`close` ends them.
    near : float
        As :data:`NEAR`, of this problem.
    random : ndarray of bool, length p
        Numbers that are random effects (:attr:`Parameter.spread`): each adds its distance from the middle, in
        standard deviations, to the weighted residuals of its trial.
    """

    def __init__(
        self, model: Model, parameters: Sequence[Parameter], trials: Sequence[Trial], *, jobs: int = 1
    ) -> None:
        self.model = model
        self.parameters = list(parameters)
        self.trials = list(trials)
        self.jobs = jobs
        self.near = NEAR
        self.channels = [
            [c.name for c in model.channels if c.name in t.measured and np.isfinite(t.measured[c.name]).any()]
            for t in self.trials
        ]
        self.labels: list[str] = []
        self.slots: list[tuple[int, int | None]] = []  # (parameter, trial or None)
        for index, parameter in enumerate(self.parameters):
            if not parameter.free:
                continue
            if not parameter.per_trial:
                self.labels.append(parameter.name)
                self.slots.append((index, None))
                continue
            for owner, trial in enumerate(self.trials):
                if parameter.name not in trial.held:
                    self.labels.append(f"{parameter.name}[{trial.id}]")
                    self.slots.append((index, owner))
        self.taken: list[tuple[NDArray[np.intp], NDArray[np.intp]]] = []
        for k in range(len(self.trials)):
            numbers = [j for j, (_, owner) in enumerate(self.slots) if owner in (None, k)]
            taken = [self.slots[j][0] for j in numbers]
            self.taken.append((np.array(taken, dtype=int), np.array(numbers, dtype=int)))
        of_trials = list(zip(self.trials, self.channels, strict=True))
        self.masks = [[np.isfinite(t.measured[c]) for c in names] for t, names in of_trials]
        self._complete = [all(mask.all() for mask in masks) for masks in self.masks]
        self.sd = [[np.ones(len(t.time_s)) for _ in names] for t, names in of_trials]
        self.damping = [[np.ones(len(sd)) for sd in sds] for sds in self.sd]
        self.evaluations = 0
        self.jacobians = 0
        self.base = np.array([p.start for p in self.parameters])
        of_numbers = [self.parameters[i] for i, _ in self.slots]
        self.lower, self.upper, self.scale, self._spread, self._middle = (
            np.array([getattr(p, name) for p in of_numbers])
            for name in ("lower", "upper", "scale", "spread", "start")
        )
        # as a trial's log suggests, else as the parameter says
        known = [{} if owner is None else self.trials[owner].starts for _, owner in self.slots]
        starts = [float(own.get(p.name, p.start)) for p, own in zip(of_numbers, known, strict=True)]
        self.start = np.clip(np.array(starts), self.lower, self.upper)
        self.random = np.isfinite(self._spread)
        self._measured = [self.stacked(k, t.measured) for k, t in enumerate(self.trials)]
        self._simulated: dict[bytes, list[dict[str, Array]]] = {}
        self._slopes: tuple[Array, bool, list[Array]] | None = None
        self._held: dict[str, list[Array]] = {}
        self._weights: dict[int, tuple[list[Array], Array]] = {}
        self._typical_s = math.inf
        self._pool: ThreadPoolExecutor | None = None

    def close(self) -> None:
        """End the threads, if any were started."""
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)
            self._pool = None

    def box(self) -> tuple[Array, Array]:
        """Ends of the range a search over all of it covers, each shape (p,).

        The bounds; where a side has none, one scale from the start.
        """
        bounded = np.isfinite(self.lower) & np.isfinite(self.upper)
        low = np.where(bounded, self.lower, np.maximum(self.start - self.scale, self.lower))
        high = np.where(bounded, self.upper, np.minimum(self.start + self.scale, self.upper))
        return low, high

    def own(self, trial: int) -> list[int]:
        """Places of the numbers that belong to one trial alone."""
        return [j for j, (_, owner) in enumerate(self.slots) if owner == trial]

    def vector(self, theta: Array, trial: int) -> Array:
        """Full parameter vector of one trial."""
        values = self.base.copy()
        parameters, numbers = self.taken[trial]
        values[parameters] = theta[numbers]
        return values

    def simulations(self, theta: Array) -> list[dict[str, Array]]:
        """Simulated channels of every trial; the last few points are remembered."""
        key = np.asarray(theta, dtype=float).tobytes()
        if key not in self._simulated:
            found = self.simulated([(theta, k) for k in range(len(self.trials))])
            while len(self._simulated) >= KEPT:
                del self._simulated[next(iter(self._simulated))]
            self._simulated[key] = found
        return self._simulated[key]

    def broken(self, theta: Array) -> list[str]:
        """Trials in which a measured sample cannot be simulated."""
        return [
            self.trials[k].id
            for k, simulated in enumerate(self.simulations(theta))
            if not np.isfinite(self.stacked(k, simulated)).all()
        ]

    def trial_residuals(self, theta: Array, k: int) -> Array:
        """Weighted residuals of trial ``k``, channel after channel, missing samples left out."""
        with np.errstate(over="ignore", invalid="ignore"):
            error = self._measured[k] - self.stacked(k, self.simulations(theta)[k])
            values = error * self.sample_weights(k)
        # a simulation that broke down costs, it does not crash
        return np.where(np.isfinite(values), values, BROKEN)

    def residuals(self, theta: Array) -> Array:
        """Weighted residuals of all trials, and of the random effects behind them, shape (n,)."""
        parts = [self.trial_residuals(theta, k) for k in range(len(self.trials))]
        return np.concatenate([*parts, *(r for r, _ in self.priors(theta))])

    def priors(self, theta: Array) -> list[tuple[Array, Array]]:
        """Residuals of each trial's random effects, shape (m_k,), and their derivatives, shape (m_k, p)."""
        found = []
        for k in range(len(self.trials)):
            mine = [j for j in self.own(k) if self.random[j]]
            rows = np.zeros((len(mine), len(theta)))
            rows[range(len(mine)), mine] = 1.0 / self._spread[mine]
            found.append(((theta[mine] - self._middle[mine]) / self._spread[mine], rows))
        return found

    def trial_jacobians(self, theta: Array, *, central: bool = False) -> list[Array]:
        """Derivative of each trial's residuals, shape (n_k, p) each.

        Forward differences, accurate to about 1e-6, or central ones at twice the cost. Those
        of an earlier point are used again within :data:`NEAR` of it.
        """
        found = []
        for k, rows in enumerate(self.own_jacobians(theta, central=central)):
            whole = np.zeros((len(rows), len(theta)))
            whole[:, self.taken[k][1]] = rows
            found.append(whole)
        return found

    def own_jacobians(self, theta: Array, *, central: bool = False) -> list[Array]:
        """The same to the numbers that each trial takes (:attr:`taken`) alone, shape (n_k, m_k) each; to the
        others it is zero.
        """
        slopes = self._derivatives(theta, central)
        return [-self.sample_weights(k)[:, None] * rows for k, rows in enumerate(slopes)]

    def hold_derivatives(self, labels: Sequence[str], rows: Sequence[Array]) -> None:
        """Take the derivatives to some numbers as known and unchanging.

        The rows, shape (n_k, len(labels)), are each trial's, of the simulated samples, weighted as here.
        """
        weights = [self.sample_weights(k) for k in range(len(self.trials))]
        self._slopes = None
        self._held = {
            label: [r[:, j] / w for r, w in zip(rows, weights, strict=True)] for j, label in enumerate(labels)
        }

    def jacobian(self, theta: Array) -> Array:
        """Derivative of all residuals, shape (n, p)."""
        return np.concatenate([*self.trial_jacobians(theta), *(rows for _, rows in self.priors(theta))])

    def solve(
        self,
        theta: Array,
        *,
        tolerance: float,
        unnoticed: Unnoticed | None = None,
        max_iterations: int = 200,
        watch: Callable[[Array, float, int], None] | None = None,
    ) -> Solution:
        """Minimise the squared residuals from ``theta`` on, inside the bounds, in at most so many iterations.

        The options are those of :func:`swimid.fitting.problem.minimise`.
        """
        return minimise(
            self.residuals,
            self.jacobian,
            theta,
            lower=self.lower,
            upper=self.upper,
            scale=self.scale,
            tolerance=tolerance,
            enough=IMMATERIAL,
            little=LITTLE,
            unnoticed=unnoticed,
            max_iterations=max_iterations,
            watch=watch,
        )

    def sample_weights(self, k: int) -> Array:
        """Factor from error to weighted residual of each sample of a trial, shape (n_k,)."""
        parts = [*self.damping[k], *self.sd[k]]
        known = self._weights.get(k)
        if known is None or any(a is not b for a, b in zip(known[0], parts, strict=True)):
            each = [d / sd for d, sd in zip(self.damping[k], self.sd[k], strict=True)]
            known = self._weights[k] = parts, self.at_samples(k, each)
        return known[1]

    def stacked(self, k: int, series: Mapping[str, Array]) -> Array:
        """Values of channels where a trial was measured, in the order of its residuals, shape (n_k,)."""
        return self.at_samples(k, [series[c] for c in self.channels[k]])

    def at_samples(self, k: int, parts: Sequence[Array]) -> Array:
        """What is known of each channel of a trial, where that was measured, shape (n_k,)."""
        masks = self.masks[k]
        whole = self._complete[k] and all(len(p) == len(m) for p, m in zip(parts, masks, strict=True))
        kept = parts if whole else [part[mask] for part, mask in zip(parts, masks, strict=True)]
        return np.concatenate(kept) if kept else np.empty(0)

    def by_channel(self, k: int, rows: Array) -> list[tuple[str, NDArray[np.bool_], Array]]:
        """Channel, mask and rows of each channel of a trial's residuals."""
        ends = np.cumsum([int(mask.sum()) for mask in self.masks[k]])
        parts = np.split(rows[: ends[-1]], ends[:-1]) if len(ends) else []
        return list(zip(self.channels[k], self.masks[k], parts, strict=True))

    def series(self, residuals: Sequence[Array]) -> dict[str, list[Array]]:
        """Residuals of each channel, one series a trial that has it; NaN where a sample is missing."""
        found: dict[str, list[Array]] = {}
        for k, values in enumerate(residuals):
            for channel, mask, part in self.by_channel(k, values):
                series = np.full(len(mask), np.nan)
                series[mask] = part
                found.setdefault(channel, []).append(series)
        return found

    def _derivatives(self, theta: Array, central: bool) -> list[Array]:
        """Derivative of each trial's simulated samples to the numbers it takes, shape (n_k, m_k) each."""
        if self._slopes is not None:
            where, was_central, known = self._slopes
            if (was_central or not central) and self._near(theta, where, known):
                return known
        size = np.maximum(np.abs(theta), self.scale)
        here = [self.stacked(k, simulated) for k, simulated in enumerate(self.simulations(theta))]
        steps = (1e-5 if central else 1e-6) * size
        # step towards the inside of the bounds
        steps = np.where(theta + steps > self.upper, -steps, steps)
        both = central & (theta - steps >= self.lower) & (theta - steps <= self.upper)
        points: list[tuple[Array, int]] = []
        # runs of one trial side by side read one table of its drive
        for k, (_, numbers) in enumerate(self.taken):
            for j in numbers:
                for sign in () if self.labels[j] in self._held else (1, -1) if both[j] else (1,):
                    moved = theta.copy()
                    moved[j] += sign * steps[j]
                    points.append((moved, k))
        moves = iter(self.simulated(points))
        width = (theta + steps) - np.where(both, theta - steps, theta)
        slopes = []
        for k, (_, numbers) in enumerate(self.taken):
            columns = np.empty((len(numbers), len(here[k])))
            with np.errstate(over="ignore", invalid="ignore"):
                for column, j in zip(columns, numbers, strict=True):
                    if self.labels[j] in self._held:
                        column[:] = self._held[self.labels[j]][k]
                        continue
                    ahead = self.stacked(k, next(moves))
                    back = self.stacked(k, next(moves)) if both[j] else here[k]
                    column[:] = (ahead - back) / width[j]
            columns[~np.isfinite(columns)] = 0.0
            slopes.append(np.ascontiguousarray(columns.T))
        self.jacobians += 1
        self._slopes = (theta.copy(), central, slopes)
        return slopes

    def _near(self, theta: Array, where: Array, slopes: list[Array]) -> bool:
        """Whether the step between two points is small against the noise of the estimates."""
        moved, left, samples = 0.0, 0.0, 0
        for k, rows in enumerate(slopes):
            change = rows @ (theta - where)[self.taken[k][1]] * self.sample_weights(k)
            residuals = self.trial_residuals(theta, k)
            moved += float(change @ change)
            left += float(residuals @ residuals)
            samples += len(residuals)
        # a step of one standard error in any direction changes the cost by the residuals' variance
        return moved * samples <= self.near**2 * left

    def simulated(self, points: list[tuple[Array, int]]) -> list[dict[str, Array]]:
        """Simulations of (numbers, trial) pairs, in their order: the measured channels of each."""
        self.evaluations += len(points)
        runs = [(self.vector(theta, k), self.trials[k]) for theta, k in points]
        begun = time.perf_counter()
        # the least so far: the first may have compiled the model
        if self.jobs > 1 and len(runs) > 1 and WORTH_A_THREAD < self._typical_s < math.inf:
            if self._pool is None:
                self._pool = ThreadPoolExecutor(self.jobs)
            # in whole batches of what the model runs at once
            together = self.model.together
            share = math.ceil(len(runs) / self.jobs / together) * together
            parts = [runs[i : i + share] for i in range(0, len(runs), share)]
            found = [one for part in self._pool.map(self.model.simulate_many, parts) for one in part]
            shared = self.jobs
        else:
            found = self.model.simulate_many(runs)
            shared = 1
        if runs:
            self._typical_s = min(self._typical_s, (time.perf_counter() - begun) * shared / len(runs))
        return [
            {c: y for c, y in one.items() if c in trial.measured}
            for one, (_, trial) in zip(found, runs, strict=True)
        ]


# ---------------------------------------------------------------- Levenberg-Marquardt search


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
