"""The least-squares problem of an output-error fit: residuals of all trials and their derivatives."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray

from swimid.fitting.levenberg import Solution, Unnoticed, minimise
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

        The options are those of :func:`swimid.fitting.levenberg.minimise`.
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
