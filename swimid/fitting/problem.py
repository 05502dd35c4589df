"""Least-squares problem of an output-error fit, and Levenberg-Marquardt search within bounds.

:class:`Problem` computes the residuals of all trials and their derivatives. :func:`minimise` searches for the
minimum of the sum of squared residuals. SciPy's trust-region method decomposes the whole Jacobian in every
iteration. With thousands of residuals and few parameters the normal equations need a tenth of that time, and
the parameters are scaled well enough for them. Tests compare the optima of both methods.
"""

from __future__ import annotations

import math
import multiprocessing
import os
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from swimid.files import isolated
from swimid.fitting.model import Array, Model, Parameter, Trial

#: Minimum duration of one simulation, s, above which several simulations are divided among threads.
WORTH_A_THREAD = 3e-4
#: Maximum step of a search, in standard errors, after which the earlier derivatives are used again. The
#: resulting error of the optimum is much smaller than this step.
REUSE_DISTANCE = 0.01
#: Value of the weighted residual of a sample that the model cannot simulate.
BROKEN_RESIDUAL = 1e6
#: Number of latest points of a search whose simulations are cached.
MAX_CACHED_POINTS = 12
#: Maximum number of columns of a block of derivatives whose products are computed without BLAS. For few
#: columns, waking the threads of BLAS takes longer than the multiplication.
FEW_COLUMNS = 8


class Box(NamedTuple):
    """Bounds and typical scales of the unknowns of a least-squares problem, shape (p,) each."""

    lower: Array
    upper: Array
    scale: Array


@dataclass(frozen=True)
class Blocks:
    """Derivatives of residuals, without the columns that are zero in all rows of a trial.

    Products with such derivatives need a time proportional to the number of trials, and not to its square.

    Attributes
    ----------
    shape : (int, int)
        Numbers of residuals and of unknowns.
    parts : list of (slice, ndarray of int, ndarray)
        Rows, columns and derivatives of each block. Each row is in one block.
    """

    shape: tuple[int, int]
    parts: list[tuple[slice, NDArray[np.intp], Array]]

    def columns(self, chosen: NDArray[np.bool_]) -> Blocks:
        """Return the derivatives with respect to the unknowns that a mask chooses, shape (p,)."""
        index = np.cumsum(chosen) - 1
        kept = [(own, at[chosen[at]], part[:, chosen[at]]) for own, at, part in self.parts]
        return Blocks((self.shape[0], int(chosen.sum())), [(own, index[at], part) for own, at, part in kept])

    def factorise(self, scale: Array) -> tuple[list[Array], list[Array]]:
        """Return a QR factorisation of the block of each trial, with its columns multiplied by ``scale``.

        For n_k residuals and m_k unknowns of trial k, the first list has the orthonormal columns, shape (n_k,
        m_k). The second has the triangular factors with a column for all p unknowns, shape (m_k, p).
        """
        bases, factors = [], []
        for _, at, part in self.parts:
            basis, factor = np.linalg.qr(part * scale[at])
            whole = np.zeros((len(factor), self.shape[1]))
            whole[:, at] = factor
            bases.append(basis)
            factors.append(whole)
        return bases, factors

    def scale_columns(self, scale: Array) -> Blocks:
        """Return the derivatives multiplied by one factor for each unknown."""
        return Blocks(self.shape, [(own, at, part * scale[at]) for own, at, part in self.parts])

    def along(self, step: Array) -> Array:
        """Return the change of the residuals by a step, shape (n,)."""
        found = np.zeros(self.shape[0])
        for own, at, part in self.parts:
            found[own] = part @ step[at]
        return found

    def gradient(self, residuals: Array) -> Array:
        """Return the product of the transposed derivatives and residuals, shape (p,)."""
        found = np.zeros(self.shape[1])
        for own, at, part in self.parts:
            found[at] += _product(part, residuals[own])
        return found

    def normal(self) -> Array:
        """Return the product of the transposed derivatives and the derivatives, shape (p, p)."""
        found = np.zeros((self.shape[1],) * 2)
        for _, at, part in self.parts:
            found[at[:, None], at] += _product(part, part)
        return found

    def update_secant(self, off: Array, step: Array, weights: Array) -> Blocks:
        """Return the derivatives after a secant update of each block.

        Parameters
        ----------
        off : ndarray, shape (n,)
            Difference between the residuals after the step and their linear prediction.
        step, weights : ndarray, shape (p,)
            Step, and weight of each unknown in the length of the step.
        """
        parts = []
        for own, at, part in self.parts:
            along = step[at] * weights[at]
            length = float(along @ step[at])
            parts.append((own, at, part + np.outer(off[own], along / length) if length > 0 else part))
        return Blocks(self.shape, parts)


def _product(part: Array, other: Array) -> Array:
    """Return the product of a transposed block and residuals or the block itself."""
    if part.shape[1] <= FEW_COLUMNS:
        return np.einsum("ij,i...->j...", part, other)
    return np.asarray(part.T @ other)


class ParameterMap:
    """Map from the unknowns of a fit to the values of a model's parameters in each trial.

    The values of the model's parameters in trial k are ``A_k theta + b`` with the unknowns theta. A fixed
    parameter is an entry of b. An estimated one is an unknown that all trials share, or one unknown for each
    trial. Several parameters of the model may share one unknown (:attr:`Parameter.members`).

    Attributes
    ----------
    labels : list of str, length p
        One label for each unknown: the name of its parameter, or ``name[trial]`` if each trial has its own
        value.
    slots : list of (int, int or None), length p
        Index of the parameter of each unknown, and index of its trial (None if all trials share it).
    taken : list of ndarray
        For each trial the indices of the unknowns that affect it.
    start, lower, upper, scale : ndarray, shape (p,)
        Start values, bounds and typical scales of the unknowns. A start value that the log of a trial
        suggests replaces that of the parameter.
    means : ndarray, shape (p,)
        Start values of the unknowns without suggestions from logs.
    """

    def __init__(self, model: Model, parameters: Sequence[Parameter], trials: Sequence[Trial]) -> None:
        self.parameters, self.trials = list(parameters), list(trials)
        rows = [[model.index(name) for name in p.members or (p.name,)] for p in self.parameters]
        self._offset = np.zeros(len(model.parameters))
        for p, own in zip(self.parameters, rows, strict=True):
            self._offset[own] = p.start
        unknowns = list(self._list_unknowns())
        self.slots = [(i, k) for i, k, _, _ in unknowns]
        self.labels = [label for _, _, label, _ in unknowns]
        self.taken: list[NDArray[np.intp]] = [
            np.array([j for j, (_, owner) in enumerate(self.slots) if owner in (None, k)], dtype=int)
            for k in range(len(self.trials))
        ]
        # For each trial, the indices of its values and of their unknowns.
        self._entries = [self._index_values(rows, taken) for taken in self.taken]
        own_parameters = [self.parameters[i] for i, _ in self.slots]
        self.lower, self.upper, self.scale, self.means = (
            np.array([getattr(p, name) for p in own_parameters])
            for name in ("lower", "upper", "scale", "start")
        )
        starts = np.array([start for _, _, _, start in unknowns], dtype=float)
        self.start = np.clip(starts, self.lower, self.upper)

    def _index_values(self, rows: Sequence[Sequence[int]], taken: NDArray[np.intp]) -> NDArray[np.intp]:
        """Return the indices of the values of a trial that are unknowns, and of these unknowns."""
        pairs = [(row, j) for j in taken for row in rows[self.slots[j][0]]]
        return np.array(pairs, dtype=int).reshape(-1, 2).T

    def _list_unknowns(self) -> Iterator[tuple[int, int | None, str, float]]:
        """Yield parameter, trial, label and start value of each unknown."""
        for i, p in enumerate(self.parameters):
            if p.free and not p.per_trial:
                yield i, None, p.name, p.start
            for k, t in enumerate(self.trials):
                if p.free and p.per_trial and p.name not in t.held:
                    yield i, k, f"{p.name}[{t.id}]", t.starts.get(p.name, p.start)

    @property
    def box(self) -> Box:
        """Bounds and typical scales of the unknowns."""
        return Box(self.lower, self.upper, self.scale)

    def search_range(self) -> tuple[Array, Array]:
        """Return the range from which starting points are sampled: lower and upper ends, each shape (p,).

        The range of a parameter with two bounds ends at the bounds. Other ranges end at one typical scale on
        either side of the start value, or at the bound if that is nearer.
        """
        bounded = np.isfinite(self.lower) & np.isfinite(self.upper)
        low = np.where(bounded, self.lower, np.maximum(self.start - self.scale, self.lower))
        high = np.where(bounded, self.upper, np.minimum(self.start + self.scale, self.upper))
        return low, high

    def own(self, trial: int) -> list[int]:
        """Return the indices of the unknowns that belong to one trial only."""
        return [j for j, (_, owner) in enumerate(self.slots) if owner == trial]

    def vector(self, theta: Array, trial: int) -> Array:
        """Return the values of the model's parameters in one trial."""
        values = self._offset.copy()
        rows, unknowns = self._entries[trial]
        values[rows] = theta[unknowns]
        return values


class Problem(ParameterMap):
    """Least-squares problem: weighted residuals of trials and their derivatives, for given unknowns.

    Simulations and derivatives are cached without weights, so that new weights need no new simulation.

    Parameters
    ----------
    jobs : int
        Number of threads for simulations that take longer than :data:`WORTH_A_THREAD`. The results do not
        depend on the number of threads.

    Attributes
    ----------
    channels : list of list of str
        Names of the channels of each trial that have samples.
    masks, sd : list of list of ndarray, each shape (n_k,)
        Arrays by trial and channel: a mask of the existing samples, and their standard deviations.
    counts : list of int
        Number of residuals of each trial.
    evaluations : int
        Number of simulations of single trials so far.
    near : float
        Maximum step after which derivatives are used again, as in :data:`REUSE_DISTANCE`.
    prior : tuple of ndarray, shapes (p,) and (m, p)
        Prior of the unknowns: mean, and square root of the precision matrix with m rows. The prior adds the
        rows ``root @ (theta - mean)`` to the residuals. The default is no prior.
    whiten : callable
        Function that is called with the index of a trial and its weighted residuals or their derivatives. It
        returns independent residuals of unit variance, or their derivatives. The default returns its
        argument.
    """

    def __init__(
        self, model: Model, parameters: Sequence[Parameter], trials: Sequence[Trial], *, jobs: int = 1
    ) -> None:
        super().__init__(model, parameters, trials)
        self.model, self.jobs, self.near, self.evaluations = model, jobs, REUSE_DISTANCE, 0
        self.channels, self.masks, self.sd, self._kept = [], [], [], []
        for t in self.trials:
            measured = [c.name for c in model.channels if c.name in t.measured]
            names = [name for name in measured if np.isfinite(t.measured[name]).any()]
            masks = [np.isfinite(t.measured[name]) for name in names]
            whole = all(mask.all() for mask in masks)
            self.channels.append(names)
            self.masks.append(masks)
            self.sd.append([np.ones(len(t.time_s)) for _ in names])
            self._kept.append(slice(None) if whole else np.concatenate(masks))
        self.prior = self.means, np.zeros((0, len(self.labels)))
        self.whiten: Callable[[int, Array], Array] = lambda k, rows: rows
        self._measured = [self.stack(k, t.measured) for k, t in enumerate(self.trials)]
        self.counts = [len(values) for values in self._measured]
        self._simulated: dict[bytes, list[dict[str, Array]]] = {}
        self._slopes: tuple[Array, bool, list[Array]] | None = None
        self._held: list[dict[str, Array]] = [{} for _ in self.trials]
        self._weights: dict[int, tuple[list[Array], Array]] = {}
        self._typical_s = math.inf

    def simulations(self, theta: Array) -> list[dict[str, Array]]:
        """Return the simulated channels of every trial, cached for :data:`MAX_CACHED_POINTS` points."""
        key = np.asarray(theta, dtype=float).tobytes()
        if key not in self._simulated:
            found = self.simulate_points([(theta, k) for k in range(len(self.trials))])
            while len(self._simulated) >= MAX_CACHED_POINTS:
                del self._simulated[next(iter(self._simulated))]
            self._simulated[key] = found
        return self._simulated[key]

    def find_broken(self, theta: Array) -> list[str]:
        """Return the ids of trials in which a measured sample cannot be simulated."""
        return [
            self.trials[k].id
            for k, simulated in enumerate(self.simulations(theta))
            if not np.isfinite(self.stack(k, simulated)).all()
        ]

    def trial_residuals(self, theta: Array, k: int) -> Array:
        """Return the weighted residuals of a trial, channel after channel, without missing samples."""
        with np.errstate(over="ignore", invalid="ignore"):
            error = self._measured[k] - self.stack(k, self.simulations(theta)[k])
            values = error * self.sample_weights(k)
        return np.where(np.isfinite(values), values, BROKEN_RESIDUAL)

    def residuals(self, theta: Array) -> Array:
        """Return the whitened residuals of all trials, followed by those of the prior, shape (n,)."""
        mean, root = self.prior
        parts = [self.whiten(k, self.trial_residuals(theta, k)) for k in range(len(self.trials))]
        return np.concatenate([*parts, root @ (theta - mean)])

    def blocks(self, theta: Array, *, central: bool = False) -> Blocks:
        """Return the derivatives of :meth:`residuals`: a block for each trial, and one for a prior."""
        parts, end = [], 0
        for k, rows in enumerate(self.own_jacobians(theta, central=central)):
            begin, end = end, end + self.counts[k]
            parts.append((slice(begin, end), self.taken[k], self.whiten(k, rows)))
        _, root = self.prior
        if len(root):
            parts.append((slice(end, end + len(root)), np.arange(len(theta)), root))
        return Blocks((end + len(root), len(theta)), parts)

    def trial_jacobians(self, theta: Array) -> list[Array]:
        """Return the derivatives of each trial's residuals with respect to all unknowns, shape (n_k, p)."""
        own = self.own_jacobians(theta)
        found = [np.zeros((len(rows), len(theta))) for rows in own]
        for whole, rows, numbers in zip(found, own, self.taken, strict=True):
            whole[:, numbers] = rows
        return found

    def own_jacobians(self, theta: Array, *, central: bool = False) -> list[Array]:
        """Return the derivatives of each trial's residuals with respect to the unknowns that affect it.

        The derivatives of a trial have the shape (n_k, m_k). The unknowns are the shared ones, and those of
        the trial. Forward differences have a relative accuracy of about 1e-6. Central differences are more
        accurate and cost twice as much. Derivatives at an earlier point are used again if the point is within
        :attr:`near` of it.
        """
        slopes = self._derivatives(theta, central)
        return [-self.sample_weights(k)[:, None] * rows for k, rows in enumerate(slopes)]

    def hold_derivatives(self, other: Problem, derivatives: Sequence[Array]) -> None:
        """Use the derivatives of another problem with the same trials in place of computed ones.

        The given derivatives replace those with respect to the unknowns that both problems have.

        Parameters
        ----------
        derivatives : sequence of ndarray, each shape (n_k, m_k)
            Derivatives of the simulated samples of each trial with respect to the unknowns that affect it,
            multiplied by the weights of the other problem.
        """
        self._slopes = None
        for k, numbers in enumerate(other.taken):
            columns = np.ascontiguousarray((derivatives[k] / other.sample_weights(k)[:, None]).T)
            self._held[k] |= {other.labels[j]: column for j, column in zip(numbers, columns, strict=True)}

    def reuse_derivatives(self, other: Problem, theta: Array, derivatives: Sequence[Array]) -> None:
        """Use known derivatives at a point as long as :attr:`near` allows it.

        Parameters
        ----------
        theta : ndarray, shape (p,)
        derivatives : sequence of ndarray, each shape (n_k, m_k)
            As in :meth:`hold_derivatives`, for a problem with the same unknowns.
        """
        known = [rows / other.sample_weights(k)[:, None] for k, rows in enumerate(derivatives)]
        self._slopes = (theta.copy(), False, known)

    def solve(self, theta: Array, *, secant: bool = False, **settings: Any) -> Solution:
        """Minimise the sum of squared residuals inside the bounds, from ``theta`` on.

        The ``settings`` are those of :func:`minimise`.

        Parameters
        ----------
        secant : bool
            Whether to update the Jacobian from step to step by the secant method, for each trial separately.
        """
        settings["undamped"] = len(self.prior[1]) > 0
        return minimise(self.residuals, self.blocks, theta, self.box, secant=secant, **settings)

    def sample_weights(self, k: int) -> Array:
        """Return the factors from errors to weighted residuals of the samples of a trial, shape (n_k,)."""
        known = self._weights.get(k)
        # Compute the weights again only if an array of standard deviations was replaced.
        if known is None or any(a is not b for a, b in zip(known[0], self.sd[k], strict=True)):
            each = [1.0 / sd for sd in self.sd[k]]
            known = self._weights[k] = list(self.sd[k]), self.at_samples(k, each)
        return known[1]

    def stack(self, k: int, series: Mapping[str, Array]) -> Array:
        """Return the samples of all channels of a trial as one array, shape (n_k,).

        Missing samples are left out, so that the order is that of the residuals.
        """
        return self.at_samples(k, [series[c] for c in self.channels[k]])

    def at_samples(self, k: int, parts: Sequence[Array]) -> Array:
        """Join one series for each channel of a trial, without missing samples, shape (n_k,)."""
        return np.concatenate([np.empty(0), *parts])[self._kept[k]]

    def by_channel(self, k: int, rows: Array) -> list[tuple[str, NDArray[np.bool_], Array]]:
        """Split the rows of a trial's residuals or derivatives by channel.

        Each item of the result has the name of a channel, the mask of its samples, and its rows.
        """
        ends = np.cumsum([int(mask.sum()) for mask in self.masks[k]])
        return list(zip(self.channels[k], self.masks[k], np.split(rows, ends)[:-1], strict=True))

    def series(self, residuals: Sequence[Array]) -> dict[str, list[Array]]:
        """Return the residuals by channel, with one series for each trial that measures the channel.

        Missing samples are NaN.
        """
        found: dict[str, list[Array]] = {}
        for k, values in enumerate(residuals):
            for channel, mask, part in self.by_channel(k, values):
                series = np.full(len(mask), np.nan)
                series[mask] = part
                found.setdefault(channel, []).append(series)
        return found

    @np.errstate(over="ignore", invalid="ignore")
    def _derivatives(self, theta: Array, central: bool) -> list[Array]:
        """Return the derivatives of each trial's simulated samples with respect to its unknowns.

        The derivatives of a trial have the shape (n_k, m_k).
        """
        if self._slopes is not None and self._is_near(theta, central, *self._slopes):
            return self._slopes[2]
        size = np.maximum(np.abs(theta), self.scale)
        here = [self.stack(k, simulated) for k, simulated in enumerate(self.simulations(theta))]
        steps = (1e-6, 1e-5)[central] * size
        # Use a backward difference if a forward step would exceed the upper bound.
        steps = np.where(theta + steps > self.upper, -steps, steps)
        both = central & (theta - steps >= self.lower) & (theta - steps <= self.upper)
        ahead, back = (theta + sign * np.diag(steps) for sign in (1, -1))
        points: list[tuple[Array, int]] = []
        # Order the simulations by trial, so that simulations of one trial can share the computed motion of
        # its drive.
        for k, numbers in enumerate(self.taken):
            for j in (j for j in numbers if self.labels[j] not in self._held[k]):
                points += [(moved[j], k) for moved in (ahead, back)[: 1 + both[j]]]
        moves = iter(self.simulate_points(points))
        width = (theta + steps) - np.where(both, theta - steps, theta)
        slopes = []
        for k, numbers in enumerate(self.taken):
            columns = np.empty((len(numbers), len(here[k])))
            for column, j in zip(columns, numbers, strict=True):
                if self.labels[j] in self._held[k]:
                    column[:] = self._held[k][self.labels[j]]
                    continue
                column[:] = self.stack(k, next(moves))
                column -= self.stack(k, next(moves)) if both[j] else here[k]
                column /= width[j]
            columns[~np.isfinite(columns)] = 0.0
            slopes.append(np.ascontiguousarray(columns.T))
        self._slopes = (theta.copy(), central, slopes)
        return slopes

    def _is_near(
        self, theta: Array, central: bool, where: Array, was_central: bool, slopes: list[Array]
    ) -> bool:
        """Return whether known derivatives are accurate enough, and near enough (:attr:`near`)."""
        if central and not was_central:
            return False
        moved = left = 0.0
        for k, rows in enumerate(slopes):
            change = rows @ (theta - where)[self.taken[k]] * self.sample_weights(k)
            residuals = self.trial_residuals(theta, k)
            moved += float(change @ change)
            left += float(residuals @ residuals)
        # Compare with a step of one standard error, which changes the cost by the variance of the residuals.
        return moved * sum(map(len, slopes)) <= self.near**2 * left

    def simulate_points(self, points: list[tuple[Array, int]]) -> list[dict[str, Array]]:
        """Simulate trials at given points, and return the measured channels of each simulation.

        Each item of ``points`` has the values of the unknowns and the index of the trial.
        """
        self.evaluations += len(points)
        runs = [(self.vector(theta, k), self.trials[k]) for theta, k in points]
        begun, threads = time.perf_counter(), 1
        # Use the shortest duration of a simulation so far, because the first one may have compiled the model.
        if self.jobs > 1 and len(runs) > 1 and WORTH_A_THREAD < self._typical_s < math.inf:
            threads = self.jobs
            # Give each thread whole batches of the size that the model simulates at once.
            together = self.model.batch_size
            share = math.ceil(len(runs) / threads / together) * together
            parts = [runs[i : i + share] for i in range(0, len(runs), share)]
            with map_in_threads(self.model.run_many, parts, threads) as batches:
                found = [one for batch in batches for one in batch]
        else:
            found = self.model.run_many(runs)
        if runs:
            self._typical_s = min(self._typical_s, (time.perf_counter() - begun) * threads / len(runs))
        return [
            {c: y for c, y in one.items() if c in trial.measured}
            for one, (_, trial) in zip(found, runs, strict=True)
        ]


# ---------------------------------------------------------------- Levenberg-Marquardt search


#: Decrease of the cost by a step of a search, as a fraction of the predicted decrease, below which the step
#: is corrected for curvature.
MIN_AGREEMENT = 0.9
#: Maximum length of the correction of a step for curvature, as a fraction of the length of the step.
MAX_CORRECTION = 0.75
#: Decrease of the cost by an undamped step, in units of the noise variance, above which a search continues.
MIN_REST = 1.0
#: Fractions of an undamped step that are tried if the whole step increases the cost (SHORTER), and factor by
#: which the damping is multiplied after an undamped step (LESS_DAMPED).
SHORTER, LESS_DAMPED = (0.3, 0.1), 0.01
#: Minimum decrease of the cost by a step, as a fraction of the predicted decrease, that allows a secant
#: update instead of new derivatives.
SECANT_AGREEMENT = 0.75
#: Maximum number of successive secant updates before new derivatives are computed.
MAX_SECANT_STEPS = 5
#: Reasons why a search ended. ``STILL``: the step or the decrease of the cost is below the tolerance.
#: ``STUCK``: no step lowers the cost, and the predicted decrease is negligible. ``KINKED``: no step lowers
#: the cost, and the predicted decrease is not negligible; such a search has failed.
NO_CHANGE = "cost and parameters no longer change"
STUCK = "no step lowers the cost"
KINKED = "no step lowers the cost, although its gradient is not zero"

#: Type of a function that watches a search. It is called with parameters, cost and iteration at the start and
#: after each step that lowers the cost. It returns a reason to end the search, or None.
Watch = Callable[[Array, float, int], "str | None"]


@dataclass(frozen=True)
class Solution:
    """End point of a search: the parameters, their sum of squares, and the reason why the search ended."""

    x: Array
    cost: float
    success: bool
    message: str
    iterations: int


class _Tried(NamedTuple):
    """Tried step of a search, in typical scales, with its end point and the residuals and cost at this point.

    The cost is infinite if it is not a number.
    """

    step: Array
    x: Array
    residuals: Array
    cost: float


def minimise(
    residuals: Callable[[Array], Array],
    jacobian: Callable[[Array], Blocks],
    start: Array,
    box: Box,
    *,
    max_iterations: int = 200,
    watch: Watch | None = None,
    **settings: Any,
) -> Solution:
    """Minimise a sum of squares within bounds.

    Parameters
    ----------
    residuals : callable, (p,) -> (n,)
    jacobian : callable
        Function from the parameters to the derivatives of the residuals.
    start : ndarray, shape (p,)
    box : Box
        Bounds and typical scales of the parameters.
    watch : callable, optional
        Function that is called after each step and may end the search (:data:`Watch`).
    **settings
        Attributes of the search (:class:`_Descent`): ``tolerance``, ``secant`` and ``undamped``.

    Notes
    -----
    The damping follows Nielsen [2]_. A parameter at a bound is left out of a step if the gradient pushes it
    outwards. A parameter that would cross a bound is set to the bound, and the step of the other parameters
    is computed again.

    References
    ----------
    .. [1] C. G. Broyden, Mathematics of Computation 19 (1965), 577-593.
    .. [2] H. B. Nielsen, "Damping parameter in Marquardt's method", IMM-REP-1999-05, 1999.
    """
    descent = _Descent(residuals, jacobian, box, watch or (lambda x, cost, iteration: None), **settings)
    return descent.run(np.asarray(start, dtype=float), max_iterations)


@dataclass
class _Descent:
    """State of a Levenberg-Marquardt search.

    Attributes
    ----------
    tolerance : float
        The search ends if neither the cost nor the parameters change by more than this fraction.
    secant : bool
        Whether the Jacobian is updated after a step by the secant method. A new Jacobian is then computed
        only if a step falls short of its prediction, and such a step is also corrected for curvature. Use it
        if derivatives are expensive.
    undamped : bool
        Whether the search ends only where an undamped step does not lower the cost. Use it if a prior
        determines directions that the data do not determine, because damping hides such directions.
    x, r, cost
        Current point, its residuals, and their sum of squares.
    rows : Blocks
        Derivatives with respect to the scaled parameters.
    age : int
        Number of secant updates since the derivatives were computed.
    renew : bool
        Whether to compute new derivatives in the next iteration.
    """

    residuals: Callable[[Array], Array]
    jacobian: Callable[[Array], Blocks]
    box: Box
    watch: Watch
    tolerance: float = 1e-10
    secant: bool = False
    undamped: bool = False
    x: Array = field(init=False)
    r: Array = field(init=False)
    cost: float = field(init=False)
    rows: Blocks = field(init=False)
    damping: float = field(init=False, default=1e-3)
    growth: float = field(init=False, default=2.0)
    age: int = field(init=False, default=0)
    renew: bool = field(init=False, default=True)

    # Ignore overflows: the cost of a very bad step may overflow, is then infinite, and the step is rejected.
    @np.errstate(over="ignore", invalid="ignore")
    def run(self, start: Array, max_iterations: int) -> Solution:
        """Search from a starting point."""
        self.x = np.clip(start, self.box.lower, self.box.upper)
        self.r = self.residuals(self.x)
        self.cost = float(self.r @ self.r)
        if not np.isfinite(self.cost):
            text = "the simulation diverges at the starting values"
            return Solution(self.x, self.cost, False, text, 0)
        self.watch(self.x, self.cost, 0)
        for iteration in range(1, max_iterations + 1):
            reason = self._iterate(iteration)
            if reason is not None:
                return Solution(self.x, self.cost, reason is not KINKED, reason, iteration)
        text = f"not converged after {max_iterations} iterations"
        return Solution(self.x, self.cost, False, text, max_iterations)

    def _iterate(self, iteration: int) -> str | None:
        """Take one step that lowers the cost, and return the reason to end the search, if there is one."""
        lower, upper, scale = self.box
        if self.renew:
            self.rows, self.age = self.jacobian(self.x).scale_columns(scale), 0
        self.renew = True
        gradient, normal = self.rows.gradient(self.r), self.rows.normal()
        blocked = ((self.x <= lower) & (gradient > 0)) | ((self.x >= upper) & (gradient < 0))
        free = ~blocked
        size = np.sqrt(np.maximum(np.diag(normal), 1e-300))
        # Compute the cosine of the angle between the residuals and each column of the Jacobian.
        slope = np.abs(gradient[free]) / (size[free] * np.sqrt(max(self.cost, 1e-300)))
        if not free.any() or self.cost <= 1e-300 or np.max(slope, initial=0.0) < 1e-12:
            return "the gradient of the cost is zero"
        for _ in range(40):
            tried, predicted = self._try_step(gradient, normal, blocked, size)
            small = np.abs(tried.step) <= self.tolerance * (np.abs(self.x / scale) + self.tolerance)
            if tried.cost < self.cost:
                return self._accept(tried, predicted, bool(small.all()), normal, blocked, iteration)
            if self.age:
                # Compute new derivatives, because the secant updates may be the reason why the cost does not
                # fall.
                return None
            if small.all() or abs(predicted) <= 1e-3 * self.tolerance * self.cost:
                return STUCK
            self.damping *= self.growth
            self.growth *= 2.0
        return KINKED

    def _try_step(
        self, gradient: Array, normal: Array, blocked: NDArray[np.bool_], size: Array
    ) -> tuple[_Tried, float]:
        """Try the damped step, and return it with the decrease of the cost that it predicts."""
        solve = partial(_step, normal, damping=self.damping * size**2, blocked=blocked)
        low, high = (self.box.lower - self.x) / self.box.scale, (self.box.upper - self.x) / self.box.scale
        step = solve(gradient, low=low, high=high)
        predicted = -float(2 * step @ gradient + step @ normal @ step)
        tried = self._attempt(step)
        short = self.cost - tried.cost < MIN_AGREEMENT * predicted and np.isfinite(tried.cost)
        if self.secant and short:
            bend = self.rows.gradient(tried.residuals - self.r - self.rows.along(step))
            bent = solve(bend, low=low - step, high=high - step)
            if np.linalg.norm(bent * size) <= MAX_CORRECTION * np.linalg.norm(tried.step * size):
                tried = min(tried, self._attempt(tried.step + bent), key=lambda t: t.cost)
        return tried, predicted

    def _accept(
        self,
        tried: _Tried,
        predicted: float,
        small: bool,
        normal: Array,
        blocked: NDArray[np.bool_],
        iteration: int,
    ) -> str | None:
        """Take a step that lowers the cost, and return the reason to end the search, if there is one."""
        lowered, off = self.cost - tried.cost, tried.residuals - self.r - self.rows.along(tried.step)
        gain = lowered / predicted if predicted > 0 else 0.0
        self.damping = max(self.damping * max(1.0 / 3.0, 1.0 - (2.0 * gain - 1.0) ** 3), 1e-12)
        self.growth = 2.0
        still = small or (
            lowered <= self.tolerance * self.cost and predicted <= 10 * self.tolerance * self.cost
        )
        self.x, self.r, self.cost = tried.x, tried.residuals, tried.cost
        reason = self.watch(self.x, self.cost, iteration)
        # End only with new derivatives, because a secant update may be the reason for a small step.
        if still and not self.age:
            reason = NO_CHANGE
        if reason is NO_CHANGE and self.undamped:
            rest = self._try_undamped(normal, blocked)
            reason = NO_CHANGE if self.cost - rest.cost <= MIN_REST else None
            if rest.cost < self.cost:
                self.x, self.r, self.cost = rest.x, rest.residuals, rest.cost
            self.damping *= LESS_DAMPED
        updates = self.secant and gain > SECANT_AGREEMENT and self.age < MAX_SECANT_STEPS
        if reason is None and updates and not still:
            weights = np.sqrt(np.maximum(np.diag(normal), 1e-300)) ** 2
            self.rows = self.rows.update_secant(off, tried.step, weights)
            self.age, self.renew = self.age + 1, False
        return reason

    def _attempt(self, step: Array) -> _Tried:
        x = np.clip(self.x + step * self.box.scale, self.box.lower, self.box.upper)
        r = self.residuals(x)
        return _Tried(step, x, r, float(np.nan_to_num(r @ r, nan=math.inf, posinf=math.inf)))

    def _try_undamped(self, normal: Array, blocked: NDArray[np.bool_]) -> _Tried:
        """Try the undamped Gauss-Newton step within the bounds, and shorter ones if it increases the cost.

        Either the parameters that would leave the bounds are set to them, or the step ends where the first
        parameter reaches its bound, whichever lowers the cost more in the linear model.
        """
        gradient, (lower, upper, scale) = self.rows.gradient(self.r), self.box
        ends = (lower - self.x) / scale, (upper - self.x) / scale
        none, damping = np.full(len(self.x), np.inf), 1e-12 * np.maximum(np.diag(normal), 1e-300)
        within, free = (
            _step(normal, gradient, damping, low, high, blocked) for low, high in (ends, (-none, none))
        )
        moves = free != 0.0
        limit = np.where(free < 0.0, *ends)[moves]
        until = free * min(float(np.min(limit / free[moves], initial=1.0)), 1.0)
        step = min(within, until, key=lambda step: float(2.0 * step @ gradient + step @ normal @ step))
        tried = self._attempt(step)
        for part in SHORTER:
            # After a long step, the derivatives may be invalid.
            if not tried.cost < self.cost:
                tried = self._attempt(part * step)
        return tried


def _step(
    normal: Array, gradient: Array, damping: Array, low: Array, high: Array, blocked: NDArray[np.bool_]
) -> Array:
    """Return the damped Gauss-Newton step within limits.

    Parameters whose step would leave the limits ``low`` and ``high`` are set to the limits. Blocked
    parameters do not move.
    """
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


# ---------------------------------------------------------------- stopping criteria based on the noise


#: Number of successive steps of a search whose total effect is compared with the noise.
BRIEF = 5
#: Test for a search that is too slow: number of successive steps whose total progress is judged (STRIDE), and
#: number of iterations before the first test (CREEPING).
STRIDE, CREEPING = 10, 40
#: Relative decrease of the cost by the last :data:`STRIDE` steps below which a search is ended as too slow.
MIN_DECREASE = 2e-4
#: Messages of a search that ended because its steps are below the noise, or because its progress is slow.
HIDDEN = "cost and estimates change by less than the noise"
STALLED = "the cost decreases too slowly"


@dataclass
class Patience:
    """Rule that ends a search whose steps are below the noise, or whose progress in a flat valley is slow.

    Attributes
    ----------
    cost : float
        Decrease of the cost that is below the noise; negative if the noise is not known.
    move : ndarray, shape (p,)
        Change of each parameter that is below the noise; infinite for parameters that may still change.
    path : list of (ndarray, float)
        Parameters and cost at the start and after each step of the search.
    """

    cost: float = -1.0
    move: Array = field(default_factory=lambda: np.full(1, math.inf))
    path: list[tuple[Array, float]] = field(default_factory=list)

    def __call__(self, x: Array, cost: float, iteration: int) -> str | None:
        """Return the reason to end the search after the latest step, or None to continue it."""
        self.path.append((x, cost))
        lowered, moved = self.last(BRIEF)
        if lowered <= self.cost and np.all(np.abs(moved) <= self.move):
            return HIDDEN
        if iteration > CREEPING and self.last(STRIDE)[0] < MIN_DECREASE * cost:
            return STALLED
        return None

    def last(self, steps: int) -> tuple[float, Array]:
        """Return the decrease of the cost and the change of the parameters over the last ``steps`` steps.

        The decrease and the change are infinite if the search has made fewer steps.
        """
        if not self.path:
            return math.inf, np.empty(0)
        x, cost = self.path[-1]
        if len(self.path) <= steps:
            return math.inf, np.full(len(x), math.inf)
        there, before = self.path[-1 - steps]
        return before - cost, x - there


# ---------------------------------------------------------------- threads and processes


Item = TypeVar("Item")
Made = TypeVar("Made")

#: Function and items that the process pool works on. Forked processes inherit them.
_work: tuple[Callable[[Any], Any], list[Any]] | None = None


def map_in_processes(function: Callable[[Item], Made], items: Iterable[Item], jobs: int) -> Iterator[Made]:
    """Call a function for many items in parallel processes, and yield the results in order.

    On Linux the items are divided among forked processes. Threads would not help, because most of a
    simulation is Python code, which threads do not run simultaneously. A forked process starts with
    everything in memory. Only results are sent back; other changes that the function makes are lost. The
    processes end with this process, also if it is killed. On other systems forking is not safe, and one
    process is used.
    """
    global _work
    items = list(items)
    if jobs <= 1 or len(items) <= 1 or _work is not None or sys.platform != "linux":
        yield from map(function, items)
        return
    _work = function, items
    try:
        context = multiprocessing.get_context("fork")
        count, own = min(jobs, len(items)), (os.getpid(),)
        with ProcessPoolExecutor(
            count, mp_context=context, initializer=isolated.end_with, initargs=own
        ) as pool:
            yield from pool.map(_one, range(len(items)))
    finally:
        _work = None


def _one(index: int) -> Any:
    assert _work is not None
    function, items = _work
    return function(items[index])


@contextmanager
def map_in_threads(
    work: Callable[[Item], Made], items: Iterable[Item], jobs: int
) -> Iterator[Iterator[Made]]:
    """Call a function for many items in several threads.

    Parameters
    ----------
    work : callable
        Function that is called with one item, in any thread. After the first exception or interrupt it is not
        called again.
    items : iterable
    jobs : int
        Number of threads, at least one.

    Yields
    ------
    iterator
        Results in the order of the items. The iterator waits for each result. When the ``with`` block ends,
        items that have not started are cancelled.
    """
    failures: list[BaseException] = []

    def one(item: Item) -> Made:
        # Stop all threads after the first exception. The caller may notice it late, and the threads would
        # process further items until then.
        if failures:
            raise failures[0]
        try:
            return work(item)
        except BaseException as failure:
            failures.append(failure)
            raise

    pool = ThreadPoolExecutor(max(jobs, 1))
    try:
        waiting = [pool.submit(one, item) for item in items]
        yield (future.result() for future in waiting)
    finally:
        pool.shutdown(cancel_futures=True)


# ---------------------------------------------------------------- integration step


#: Maximum change of a simulated sample when the integration step is halved, for which the step counts as
#: small enough. STEP_ERROR is this change in standard deviations of the noise. STEP_LIMIT applies if the
#: noise is unknown, and is a fraction of the range of the channel.
STEP_ERROR, STEP_LIMIT = 0.1, 1e-3
#: Maximum number of times that the integration step is halved.
MAX_REFINEMENTS = 6
#: Range of a channel below which nothing moves in it, in the unit of the channel.
MIN_RANGE = 1e-9

#: Standard deviations of the noise of one trial, by channel: one value, or one value for each sample.
Noise = Mapping[str, Any]


class StepChoice(NamedTuple):
    """Model with the chosen integration step, and the accuracy of its simulations.

    Attributes
    ----------
    model : Model
    changes : list of dict of str to float
        Maximum change of a sample when the step is halved, divided by the maximum allowed change, for each
        simulation and channel. The value is infinite if the simulation diverges. The list is empty if the
        model does not integrate.
    halvings: int
        Number of times that the step was halved.
    """

    model: Model
    changes: list[dict[str, float]]
    halvings: int

    @property
    def change(self) -> float:
        """Maximum of :attr:`changes`. The step is small enough if it is at most 1."""
        return max((_largest(changes) for changes in self.changes), default=0.0)


def choose_step(
    model: Model,
    runs: Sequence[tuple[Array, Trial]],
    noise: Sequence[Noise] = (),
    *,
    halvings: int = MAX_REFINEMENTS,
) -> StepChoice:
    """Halve the integration step of a model until its simulations are accurate and do not diverge.

    A simulation is accurate if no sample changes by more than a tenth of its noise when the step is halved. A
    channel of unknown noise may change by a thousandth of its range. If a trial has measured channels, only
    those count. A simulation that diverges with every step has no effect on the choice.

    Parameters
    ----------
    model : Model
        Model with the maximum step.
    runs : sequence of (values, trial)
        Simulations for which the step is chosen.
    noise : sequence of mapping, optional
        Standard deviations of the noise of each simulation, by channel.
    halvings : int
        Maximum number of times that the step is halved. With 0 the step is only tested.
    """
    noise = noise or [{}] * len(runs)
    changes: list[dict[str, float]] = [{} for _ in runs]
    levels, models, rest = [0] * len(runs), [model], list(range(len(runs)))
    rough = model.run_many(runs) if model.refine() is not None else []
    while rest and (finer := models[-1].refine()) is not None:
        fine = finer.run_many([runs[k] for k in rest])
        for k, one, other in zip(rest, rough, fine, strict=True):
            changes[k] = _changes(runs[k][1], one, other, noise[k])
        left = [(k, other) for k, other in zip(rest, fine, strict=True) if _largest(changes[k]) > 1.0]
        rest, rough = [k for k, _ in left], [other for _, other in left]
        if len(models) > halvings:
            break
        models.append(finer)
        for k in rest:
            levels[k] += 1
    chosen = max((k for k, one in zip(levels, changes, strict=True) if _largest(one) < math.inf), default=0)
    return StepChoice(models[chosen], changes, chosen)


def _largest(changes: Mapping[str, float]) -> float:
    """Return the largest change of a simulation; 0 if it has none."""
    return max(changes.values(), default=0.0)


def is_broken_down(trial: Trial, simulated: Mapping[str, Array]) -> bool:
    """Return whether a simulation diverges before the inputs of its trial end."""
    lost = any(not np.isfinite(values[-1]) for values in simulated.values())
    return lost and all(np.isfinite(values[-1]) for values in trial.inputs.values())


def _changes(
    trial: Trial, rough: Mapping[str, Array], fine: Mapping[str, Array], noise: Noise
) -> dict[str, float]:
    """Return the changes of the channels of one simulation (see :attr:`StepChoice.changes`)."""
    names = [name for name in rough if name in trial.measured] or list(rough)
    if is_broken_down(trial, rough):
        return dict.fromkeys(names, math.inf)
    found = {}
    for name in names:
        both = np.isfinite(rough[name]) & np.isfinite(fine[name])
        span = float(np.ptp(rough[name][both])) if both.any() else 0.0
        if name in noise:
            allowed = STEP_ERROR * np.broadcast_to(noise[name], both.shape)[both]
        elif span > MIN_RANGE:
            allowed = np.array(STEP_LIMIT * span)
        else:
            continue
        shares = np.abs(fine[name] - rough[name])[both] / allowed
        found[name] = float(np.max(shares[np.isfinite(shares)], initial=0.0))
    return found
