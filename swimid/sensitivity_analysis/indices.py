"""Sobol indices: fractions of the variance of an output that each parameter causes within its range."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from swimid.errors import NoTrustworthyResult, UsageError
from swimid.files.atomic import Checkpoint
from swimid.fitting.model import Array
from swimid.fitting.problem import map_in_threads
from swimid.progress import Progress, silent

#: Maximum fraction of the evaluations that may break down.
MAX_BROKEN_SHARE = 0.01
#: Number of points that are evaluated in one call.
BATCH = 8
#: Number of bootstrap samples.
N_DRAWS = 1000

#: Function from points, shape (n, d), to outputs, shape (n, s); NaN where the model breaks down.
Evaluate = Callable[[Array], Array]


@dataclass(frozen=True)
class Sobol:
    """Sobol indices of s outputs, followed by g groups of outputs, with respect to d parameters.

    Attributes
    ----------
    mean, sd : ndarray, shape (s,)
        Mean and standard deviation of the outputs over the ranges.
    evaluations, broken, left_out : int
        Number of evaluations, number of evaluations that broke down, and number of rows of the design that
        were replaced.
    first, total : ndarray, shape (s + g, d)
        First-order and total indices.
    first_ci, total_ci : ndarray, shape (2, s + g, d)
        Ends of the 95 % intervals.
    """

    mean: Array
    sd: Array
    evaluations: int
    broken: int
    left_out: int
    first: Array
    total: Array
    first_ci: Array
    total_ci: Array


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
    """Estimate first-order and total Sobol indices (Saltelli et al. 2010, doi:10.1016/j.cpc.2009.09.018).

    Parameters
    ----------
    evaluate : callable
        Function from points to outputs, which is called from several threads.
    lower, upper : ndarray, shape (d,), d >= 2
        Ends of the uniform ranges.
    samples : int
        Number of rows of the design, a power of two. Each row has d + 2 points.
    seed : int
        Seed of the scrambled Sobol sequence and of the bootstrap.
    groups : sequence of sequences of int
        Groups of outputs. The indices of a group refer to the sum of the variances of its outputs (Gamboa et
        al. 2014, doi:10.1214/14-EJS895).
    **how
        Arguments ``names``, ``jobs``, ``checkpoint`` and ``progress`` of :class:`Evaluations`.

    Returns
    -------
    Sobol
        Indices with intervals from the percentile bootstrap over the rows. If a point of a row breaks down,
        the row is replaced by the next row of the sequence.

    Raises
    ------
    UsageError
        If there are fewer than two parameters, or the number of samples is not a power of two.
    NoTrustworthyResult
        If more than :data:`MAX_BROKEN_SHARE` of the evaluations break down.
    """
    from scipy.stats import qmc

    d = len(lower)
    if d < 2:
        raise UsageError("Sobol indices share an output's variance between parameters: vary two or more")
    if samples < 2 or samples & (samples - 1):
        raise UsageError(f"the number of samples must be a power of two, not {samples}")
    # the second half of the rows replaces rows with points that break down
    unit = qmc.Sobol(2 * d, scramble=True, bits=64, rng=np.random.default_rng(seed)).random(2 * samples)
    a, b = (lower + part * (upper - lower) for part in (unit[:, :d], unit[:, d:]))
    design = np.concatenate([a[:, None], b[:, None], np.repeat(a[:, None], d, axis=1)], axis=1)
    design[:, 2 + np.arange(d), np.arange(d)] = b
    runs = Evaluations(evaluate, samples * (d + 2), **how)

    def of_rows(rows: NDArray[np.intp]) -> Array:
        labels = [f"{row}.{point}" for row in rows for point in range(d + 2)]
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
    rng = np.random.default_rng([seed, 1])
    drawn = [_indices(outputs[..., rng.integers(samples, size=samples)], groups) for _ in range(N_DRAWS)]
    first, total = _indices(outputs, groups)
    first_ci, total_ci = np.percentile(drawn, (2.5, 97.5), axis=0).transpose(1, 0, 2, 3)
    broken = len(runs.broken)
    return Sobol(mean, sd, runs.done, broken, unused - samples, first, total, first_ci, total_ci)


def _indices(outputs: Array, groups: Sequence[Sequence[int]]) -> Array:
    """Return first-order and total indices of outputs, shape (d + 2, s, n), as an array (2, s + g, d).

    The indices of a group are the mean indices of its outputs, weighted by the variances of the outputs.
    """
    from scipy.stats import sobol_indices

    a, b, ab = outputs[0], outputs[1], outputs[2:]
    variance = np.var([a, b], axis=(0, -1))
    with np.errstate(invalid="ignore"):
        found = sobol_indices(func={"f_A": a, "f_B": b, "f_AB": ab}, n=a.shape[-1])
    shape = (2, len(variance), len(ab))
    # the indices of an output without variance are set to zero
    indices = np.nan_to_num(np.reshape([found.first_order, found.total_order], shape))
    parts = [indices]
    for members in groups:
        weights = variance[list(members)]
        weights = weights / max(weights.sum(), np.finfo(float).tiny)
        parts.append(np.einsum("m,kmd->kd", weights, indices[:, list(members)])[:, None])
    return np.concatenate(parts, axis=1)


class Evaluations:
    """Evaluation of points in several threads, with a checkpoint and a count of points that break down.

    Parameters
    ----------
    evaluate : callable
    planned : int
        Number of evaluations that the design needs.
    names : sequence of str
        Names of the parameters, for error messages.
    jobs : int
        Number of threads. The result does not depend on it.
    checkpoint : Checkpoint, optional
        File in which the outputs are stored, so that an interrupted run can be continued.
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
        self._complete: list[Array] = []

    def of(self, labels: Sequence[str], points: Array) -> Array:
        """Return the outputs, shape (n, s), at points, shape (n, d); NaN at points that break down."""
        rows = []
        parts = range(0, len(points), BATCH)
        work = [(labels[i : i + BATCH], points[i : i + BATCH]) for i in parts]
        with (
            self.progress("sensitivity", total=len(points)) as step,
            map_in_threads(self._some, work, self.jobs) as results,
        ):
            for outputs, point in zip(chain.from_iterable(results), points, strict=True):
                self.done += 1
                if np.isfinite(outputs).all():
                    self._complete.append(point)
                    rows.append(outputs)
                else:
                    self.broken.append(point)
                    rows.append(np.full(len(outputs), np.nan))
                if len(self.broken) > MAX_BROKEN_SHARE * self.planned:
                    self.refuse()
                step()
        return np.array(rows)

    def _some(self, work: tuple[Sequence[str], Array]) -> list[Array]:
        """Return the outputs at a few points. Points in the checkpoint are not evaluated again."""
        labels, points = work
        known = {label: self.checkpoint.get(label) for label in labels}
        new = [k for k, label in enumerate(labels) if known[label] is None]
        if new:
            for k, outputs in zip(new, self.evaluate(points[new]), strict=True):
                self.checkpoint.put(labels[k], outputs)
                known[labels[k]] = outputs
        return [np.asarray(known[label]) for label in labels]

    def refuse(self) -> NoReturn:
        """Raise an error that names the parameter range in which the model breaks down.

        Raises
        ------
        NoTrustworthyResult
            Always.
        """
        raise NoTrustworthyResult(
            f"{len(self.broken)} of the first {self.done} simulations break down, more than "
            f"{100 * MAX_BROKEN_SHARE:g} % of all: {self._where()}",
            hint="narrow that coefficient's range (--range NAME=LOW,HIGH), or take a smaller step (--dt)",
        )

    def _where(self) -> str:
        """Return a text with the parameter whose values separate the broken points best, and its range."""
        from scipy.stats import ks_2samp

        bad = np.array(self.broken)
        low, high = bad.min(axis=0), bad.max(axis=0)
        names = list(self.names) or [f"parameter {k + 1}" for k in range(bad.shape[1])]
        if not self._complete:
            spans = ", ".join(f"{n} {a:.3g} to {b:.3g}" for n, a, b in zip(names, low, high, strict=True))
            return f"all that were tried, over {spans}"
        fine = np.array(self._complete)
        distances = [ks_2samp(bad[:, k], fine[:, k]).statistic for k in range(bad.shape[1])]
        k = int(np.argmax(distances))
        also = float(np.mean((fine[:, k] >= low[k]) & (fine[:, k] <= high[k])))
        return (
            f"all of them have {names[k]} between {low[k]:.3g} and {high[k]:.3g}, as have {100 * also:.0f} % "
            "of the others"
        )
