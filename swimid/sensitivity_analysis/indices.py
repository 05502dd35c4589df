"""Global sensitivity: which parameter makes an output vary, over ranges of all of them at once."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Any, NoReturn, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.stats import ks_2samp, qmc, sobol_indices

from swimid.errors import NoTrustworthyResult, UsageError, extra_needed
from swimid.files.checkpoint import Checkpoint
from swimid.fitting.model import Array
from swimid.fitting.parallel import in_threads
from swimid.progress import Progress, silent

#: Share of the evaluations that may break down.
BROKEN = 0.01
#: Draws behind an interval, and its ends.
RESAMPLES = 1000
ENDS = (2.5, 97.5)
#: Levels of the grid on which Morris's trajectories move; the step is half of them.
LEVELS = 4

#: Points that are evaluated by one call.
TOGETHER = 8

#: Outputs, shape (n, s), at points, shape (n, d); NaN where the model breaks down.
Evaluate = Callable[[Array], Array]
Item = TypeVar("Item")
Result = TypeVar("Result")


@dataclass(frozen=True)
class Indices:
    """What indices of s outputs to d parameters rest on.

    Attributes
    ----------
    mean, sd : ndarray, shape (s,)
        Of the outputs over the ranges.
    evaluations, broken, left_out : int
        Evaluations in all, those that broke down, and rows of the design replaced for it (Sobol) or
        trajectories dropped (Morris).
    """

    mean: Array
    sd: Array
    evaluations: int
    broken: int
    left_out: int


@dataclass(frozen=True)
class Sobol(Indices):
    """Sobol indices, those of g groups of outputs after them.

    Attributes
    ----------
    first, total : ndarray, shape (s + g, d)
    first_ci, total_ci : ndarray, shape (2, s + g, d)
        Ends of the 95 % intervals.
    """

    first: Array
    total: Array
    first_ci: Array
    total_ci: Array


@dataclass(frozen=True)
class Morris(Indices):
    """Elementary effects per whole range, in the output's unit; means over g groups of outputs after them.

    Attributes
    ----------
    mu, mu_star, sigma : ndarray, shape (s + g, d)
        Mean, mean magnitude and standard deviation of the effects.
    mu_star_ci : ndarray, shape (2, s + g, d)
        Ends of the 95 % interval.
    """

    mu: Array
    mu_star: Array
    sigma: Array
    mu_star_ci: Array


def sobol(
    evaluate: Evaluate,
    lower: Array,
    upper: Array,
    *,
    samples: int = 256,
    seed: int = 0,
    groups: Sequence[Sequence[int]] = (),
    **how: Any,
) -> Sobol:
    """First-order and total Sobol indices (Saltelli et al. 2010, doi:10.1016/j.cpc.2009.09.018).

    Parameters
    ----------
    evaluate : callable
        Called from threads.
    lower, upper : ndarray, shape (d,), d >= 2
        Uniform ranges.
    samples : int
        n, a power of two: rows of the design, each of d + 2 points.
    seed : int
        Of the scrambled Sobol sequence and of the bootstrap.
    groups : sequence of sequences of int
        Outputs to pool: the indices of their summed variance (Gamboa et al. 2014, doi:10.1214/14-EJS895).
    **how
        Names, jobs, checkpoint and progress, as :class:`Runs` takes them.

    Returns
    -------
    Sobol
        Intervals by the percentile bootstrap over the rows. A row of which a point breaks down is replaced
        by the next one of the sequence, so that all its points are finite.

    Raises
    ------
    UsageError
        With fewer than two parameters, or another number of samples than a power of two.
    NoTrustworthyResult
        When more than :data:`BROKEN` of the evaluations break down, with the range in which they do.
    """
    d = len(lower)
    if d < 2:
        raise UsageError("Sobol indices share an output's variance between parameters: vary two or more")
    if samples < 2 or samples & (samples - 1):
        raise UsageError(f"the number of samples must be a power of two, not {samples}")
    # twice the rows: the second half is in reserve
    unit = qmc.Sobol(2 * d, scramble=True, bits=64, rng=np.random.default_rng(seed)).random(2 * samples)
    a, b = (lower + part * (upper - lower) for part in (unit[:, :d], unit[:, d:]))
    design = np.concatenate([a[:, None], b[:, None], np.repeat(a[:, None], d, axis=1)], axis=1)
    design[:, 2 + np.arange(d), np.arange(d)] = b
    runs = Runs(evaluate, samples * (d + 2), **how)

    def of_rows(rows: NDArray[np.intp]) -> Array:
        labels = [f"{r}.{p}" for r in rows for p in range(d + 2)]
        return runs.of(labels, design[rows].reshape(-1, d)).reshape(len(rows), d + 2, -1)

    unused = samples
    values = of_rows(np.arange(samples))
    while (bad := np.flatnonzero(~np.isfinite(values).all(axis=(1, 2)))).size:
        if unused + len(bad) > len(design):
            runs.refuse()
        values[bad] = of_rows(np.arange(unused, unused + len(bad)))
        unused += len(bad)
    outputs = np.moveaxis(values, 0, -1)  # (d + 2, s, n)
    both = outputs[:2].transpose(1, 0, 2).reshape(outputs.shape[1], -1)
    mean, sd = both.mean(axis=1), both.std(axis=1)
    outputs = outputs - mean[:, None]
    estimated = sobol_indices(func={"f_A": outputs[0], "f_B": outputs[1], "f_AB": outputs[2:]}, n=samples)
    shape = (outputs.shape[1], d)
    rng = np.random.default_rng([seed, 1])
    drawn = [_resampled(outputs[..., rng.integers(samples, size=samples)], groups) for _ in range(RESAMPLES)]
    return Sobol(
        mean,
        sd,
        runs.done,
        len(runs.broken),
        left_out=unused - samples,
        first=_pooled(estimated.first_order.reshape(shape), sd**2, groups),
        total=_pooled(estimated.total_order.reshape(shape), sd**2, groups),
        first_ci=np.percentile([first for first, _ in drawn], ENDS, axis=0),
        total_ci=np.percentile([total for _, total in drawn], ENDS, axis=0),
    )


def _resampled(outputs: Array, groups: Sequence[Sequence[int]]) -> tuple[Array, Array]:
    """Indices of one bootstrap sample, shape (s + g, d), by the estimators of SciPy's sobol_indices."""
    a, b, ab = outputs[0], outputs[1], outputs[2:]
    variance = np.var([a, b], axis=(0, -1))
    size = np.where(variance > 0, variance, 1.0)
    first = np.mean(b * (ab - a), axis=-1) / size
    total = 0.5 * np.mean((a - ab) ** 2, axis=-1) / size
    return _pooled(first.T, variance, groups), _pooled(total.T, variance, groups)


def _pooled(indices: Array, variance: Array, groups: Sequence[Sequence[int]]) -> Array:
    """Indices with those of the groups after them: means weighted by the outputs' variances."""
    parts = [indices]
    for members in groups:
        weights = variance[list(members)]
        known = weights.sum()
        parts.append(((weights @ indices[list(members)]) / (known if known > 0 else 1.0))[None])
    return np.concatenate(parts)


def morris(
    evaluate: Evaluate,
    lower: Array,
    upper: Array,
    *,
    samples: int = 32,
    seed: int = 0,
    groups: Sequence[Sequence[int]] = (),
    **how: Any,
) -> Morris:
    """Elementary effects (Morris 1991, doi:10.2307/1269043; mu* after Campolongo et al. 2007), by SALib.

    Parameters
    ----------
    samples : int
        Trajectories, each of d + 1 points, on a grid of :data:`LEVELS` levels.
    evaluate, lower, upper, seed, groups, **how
        As :func:`sobol` takes them.

    Returns
    -------
    Morris
        Intervals by SALib's bootstrap over the trajectories: mu* and 1.96 standard deviations of it. Half
        the width of a group's is the mean of its members', which is what it is when they move together and
        too wide otherwise. A trajectory of which a point breaks down is dropped.

    Raises
    ------
    UsageError
        With fewer than two trajectories.
    NoTrustworthyResult
        As :func:`sobol`.
    """
    d = len(lower)
    if samples < 2:
        raise UsageError("elementary effects need two trajectories or more")
    with extra_needed("the Morris method", "sensitivity"):
        from SALib.analyze.morris import analyze
        from SALib.sample.morris import sample

    problem = {"num_vars": d, "names": [str(k) for k in range(d)], "bounds": [[0.0, 1.0]] * d}
    unit = sample(problem, samples, num_levels=LEVELS, seed=seed)
    runs = Runs(evaluate, len(unit), **how)
    labels = [f"trajectory {r}.{p}" for r in range(samples) for p in range(d + 1)]
    values = runs.of(labels, lower + unit * (upper - lower))
    whole = np.isfinite(values).all(axis=1).reshape(samples, d + 1).all(axis=1)
    kept = np.repeat(whole, d + 1)
    settings = {"num_levels": LEVELS, "num_resamples": RESAMPLES, "seed": seed}
    parts = [analyze(problem, unit[kept], one, **settings) for one in values[kept].T]

    def averaged(key: str) -> Array:
        effects = np.array([part[key] for part in parts])
        return np.concatenate([effects, *(effects[list(m)].mean(axis=0)[None] for m in groups)])

    mu_star, half = averaged("mu_star"), averaged("mu_star_conf")
    return Morris(
        values[kept].mean(axis=0),
        values[kept].std(axis=0),
        runs.done,
        len(runs.broken),
        left_out=int((~whole).sum()),
        mu=averaged("mu"),
        mu_star=mu_star,
        sigma=averaged("sigma"),
        mu_star_ci=np.array([np.maximum(mu_star - half, 0.0), mu_star + half]),
    )


class Runs:
    """Evaluations in threads: kept, counted, and refused when too many break down.

    Parameters
    ----------
    evaluate : callable
    planned : int
        Evaluations the design needs.
    names : sequence of str
        Of the parameters, for the error.
    jobs : int
        Threads; the result does not depend on it.
    checkpoint : Checkpoint, optional
        Keeps every evaluation.
    progress : Progress
    """

    def __init__(
        self,
        evaluate: Evaluate,
        planned: int,
        *,
        names: Sequence[str] = (),
        jobs: int = 1,
        checkpoint: Checkpoint | None = None,
        progress: Progress = silent,
    ) -> None:
        self.evaluate, self.planned, self.names = evaluate, planned, names
        self.jobs, self.checkpoint, self.progress = jobs, checkpoint or Checkpoint(), progress
        self.done = 0
        self.broken: list[Array] = []
        self._fine: list[Array] = []

    def of(self, labels: Sequence[str], points: Array) -> Array:
        """Outputs at points, shape (n, d) to (n, s); NaN in the whole row where one breaks down."""
        rows = []
        parts = range(0, len(points), TOGETHER)
        work = [(labels[i : i + TOGETHER], points[i : i + TOGETHER]) for i in parts]
        with (
            self.progress("sensitivity", total=len(points)) as step,
            in_threads(self._some, work, self.jobs) as results,
        ):
            for outputs, point in zip(chain.from_iterable(results), points, strict=True):
                whole = bool(np.isfinite(outputs).all())
                (self._fine if whole else self.broken).append(point)
                rows.append(outputs if whole else np.full(len(outputs), np.nan))
                self.done += 1
                if len(self.broken) > BROKEN * self.planned:
                    self.refuse()
                step()
        return np.array(rows)

    def _some(self, work: tuple[Sequence[str], Array]) -> list[Array]:
        """Outputs at a few points; those kept from an earlier run are not evaluated again."""
        labels, points = work
        known = {label: self.checkpoint.get(label) for label in labels}
        new = [k for k, label in enumerate(labels) if known[label] is None]
        if new:
            for k, outputs in zip(new, self.evaluate(points[new]), strict=True):
                self.checkpoint.put(labels[k], outputs)
                known[labels[k]] = outputs
        return [np.asarray(known[label]) for label in labels]

    def refuse(self) -> NoReturn:
        """Say where the model breaks down.

        Raises
        ------
        NoTrustworthyResult
            Always.
        """
        raise NoTrustworthyResult(
            f"{len(self.broken)} of the first {self.done} simulations break down, more than "
            f"{100 * BROKEN:g} % of all: {self._where()}",
            hint="narrow that coefficient's range (--range NAME=LOW,HIGH), or take a smaller step (--dt)",
        )

    def _where(self) -> str:
        """The parameter whose values set the broken points apart most, and their range."""
        bad = np.array(self.broken)
        low, high = bad.min(axis=0), bad.max(axis=0)
        names = list(self.names) or [f"parameter {k + 1}" for k in range(bad.shape[1])]
        if not self._fine:
            spans = ", ".join(f"{n} {a:.3g} to {b:.3g}" for n, a, b in zip(names, low, high, strict=True))
            return f"all that were tried, over {spans}"
        fine = np.array(self._fine)
        distances = [ks_2samp(bad[:, k], fine[:, k]).statistic for k in range(bad.shape[1])]
        k = int(np.argmax(distances))
        also = float(np.mean((fine[:, k] >= low[k]) & (fine[:, k] <= high[k])))
        return (
            f"all of them have {names[k]} between {low[k]:.3g} and {high[k]:.3g}, as have {100 * also:.0f} % "
            "of the others"
        )
