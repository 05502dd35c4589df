"""Sobol indices: fractions of the variance of an output that each parameter causes within its range."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from swimid.errors import NoTrustworthyResult, UsageError
from swimid.files.atomic import Checkpoint
from swimid.fitting.model import Array
from swimid.fitting.problem import map_in_threads
from swimid.notices import Progress, silent

#: Maximum fraction of the model evaluations that may break down. The analysis is refused above it.
MAX_BROKEN_SHARE = 0.01
#: Number of points of the Sobol design that are evaluated in one call of the model function.
ROWS_PER_BATCH = 8
#: Maximum number of independently scrambled parts of the design. The intervals follow from their differences.
MAX_PARTS = 8

#: Type of the model function. Its argument is an array of n points in the space of the d parameters, shape
#: (n, d). It returns s outputs for each point, shape (n, s), which are NaN if the model breaks down.
Evaluate = Callable[[Array], Array]


@dataclass(frozen=True)
class Sobol:
    """Sobol indices of s outputs, followed by g groups of outputs, with respect to d parameters.

    Attributes
    ----------
    mean, sd : ndarray, shape (s,)
        Mean and standard deviation of each output over the ranges of the parameters.
    evaluations, broken, left_out : int
        Number of evaluations, number of evaluations that broke down, and number of rows of the design that
        were left out.
    first, total : ndarray, shape (s + g, d)
        First-order and total indices.
    first_ci, total_ci : ndarray, shape (2, s + g, d)
        Ends of the 95 % intervals of the first-order and total indices.
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
    jobs: int = 1,
    checkpoint: Checkpoint | None = None,
    progress: Progress = silent,
) -> Sobol:
    """Estimate first-order and total Sobol indices (Saltelli et al. 2010, doi:10.1016/j.cpc.2009.09.018).

    Parameters
    ----------
    evaluate : callable
        Function from points to outputs, which is called from several threads.
    lower, upper : ndarray, shape (d,), d >= 2
        Lower and upper ends of the ranges of the parameters, which are uniformly distributed.
    samples : int
        Number of rows of the design, a power of two. Each row has d + 2 points.
    seed : int
        Seed of the scrambled Sobol sequences.
    groups : sequence of sequences of int
        Groups of outputs. The indices of a group refer to the sum of the variances of its outputs (Gamboa et
        al. 2014, doi:10.1214/14-EJS895).
    jobs : int
        Number of threads. The result does not depend on it.
    checkpoint : Checkpoint, optional
        File in which the outputs are stored, so that an interrupted run can be continued.
    progress : Progress

    Returns
    -------
    Sobol
        Indices of the whole design, with intervals from the jackknife over its parts. Rows with a point that
        breaks down are left out.

    Raises
    ------
    UsageError
        If there are fewer than two parameters, or the number of samples is not a power of two.
    NoTrustworthyResult
        If more than :data:`MAX_BROKEN_SHARE` of the evaluations break down.
    """
    from scipy import stats

    d = len(lower)
    if d < 2:
        raise UsageError("Sobol indices share an output's variance between parameters: vary two or more")
    if samples < 2 or samples & (samples - 1):
        raise UsageError(f"the number of samples must be a power of two, not {samples}")
    number = min(MAX_PARTS, samples)
    points = _make_design(lower, upper, samples, number, seed)
    results, broken = _evaluate_design(evaluate, points, jobs, checkpoint or Checkpoint(), progress)
    values = results.reshape(samples, d + 2, -1)
    sound = np.isfinite(values).all(axis=(1, 2))
    outputs = np.moveaxis(values[sound], 0, -1)  # shape (d + 2, s, rows)
    both = outputs[:2].transpose(1, 0, 2).reshape(outputs.shape[1], -1)
    mean, sd = both.mean(axis=1), both.std(axis=1)
    outputs = outputs - mean[:, None]
    part = np.repeat(np.arange(number), samples // number)[sound]
    found = _indices(outputs, groups)
    left = len(np.unique(part))
    half = stats.t.ppf(0.975, left - 1) * _jackknife_error(outputs, part, groups)
    ends = np.stack([found - half, found + half], axis=1)
    left_out = samples - outputs.shape[-1]
    return Sobol(mean, sd, len(points), broken, left_out, *found, *ends)


def _make_design(lower: Array, upper: Array, samples: int, parts: int, seed: int) -> Array:
    """Return the points of the design, shape (samples (d + 2), d), from scrambled Sobol sequences."""
    from scipy.stats import qmc

    d = len(lower)
    unit = np.concatenate([
        qmc.Sobol(2 * d, scramble=True, bits=64, rng=rng).random(samples // parts)
        for rng in np.random.default_rng(seed).spawn(parts)
    ])  # fmt: skip
    a, b = (lower + part * (upper - lower) for part in (unit[:, :d], unit[:, d:]))
    design = np.concatenate([a[:, None], b[:, None], np.repeat(a[:, None], d, axis=1)], axis=1)
    design[:, 2 + np.arange(d), np.arange(d)] = b
    return design.reshape(-1, d)


def _evaluate_design(
    evaluate: Evaluate, points: Array, jobs: int, keep: Checkpoint, progress: Progress
) -> tuple[Array, int]:
    """Return the outputs at all points of the design, and how many evaluations broke down."""
    parts = [points[k : k + ROWS_PER_BATCH] for k in range(0, len(points), ROWS_PER_BATCH)]
    broken, done = 0, list[Array]()

    def compute_part(k: int) -> Array:
        outputs = keep.get_or_compute(f"points {k}", lambda: evaluate(parts[k]).ravel())
        return outputs.reshape(len(parts[k]), -1)

    with (
        progress("sensitivity", total=len(parts)) as step,
        map_in_threads(compute_part, range(len(parts)), jobs) as results,
    ):
        for outputs in results:
            done.append(outputs)
            broken += int((~np.isfinite(outputs).all(axis=1)).sum())
            if broken > MAX_BROKEN_SHARE * len(points):
                raise NoTrustworthyResult(
                    f"{broken} of the first {sum(map(len, done))} simulations break down, more than "
                    f"{100 * MAX_BROKEN_SHARE:g} % of all",
                    hint="narrow the ranges (--range NAME=LOW,HIGH), or take a smaller step (--dt)",
                )
            step()
    return np.concatenate(done), broken


def _jackknife_error(outputs: Array, part: NDArray[np.int64], groups: Sequence[Sequence[int]]) -> Array:
    """Return the standard errors of the indices, shape (2, s + g, d), from estimates without one part each.

    A bootstrap over the rows would give too wide intervals, because the rows of one Sobol sequence are not
    independent. The parts are.
    """
    without = np.array([_indices(outputs[..., part != k], groups) for k in np.unique(part)])
    number = len(without)
    return np.sqrt((number - 1) / number * ((without - without.mean(axis=0)) ** 2).sum(axis=0))


def _indices(outputs: Array, groups: Sequence[Sequence[int]]) -> Array:
    """Return first-order and total indices of outputs and of groups of outputs, shape (2, s + g, d).

    The outputs of n rows of the design have the shape (d + 2, s, n). The estimators are those of
    ``scipy.stats.sobol_indices``, which requires that the number of rows is a power of two. The indices of a
    group are the mean indices of its outputs, weighted by the variances of the outputs.
    """
    a, b, ab = outputs[0], outputs[1], outputs[2:]
    mean, variance = np.mean([a, b], axis=(0, -1)), np.var([a, b], axis=(0, -1))
    with np.errstate(invalid="ignore", divide="ignore"):
        first = np.mean((b - mean[:, None]) * (ab - a), axis=-1) / variance
        total = 0.5 * np.mean((a - ab) ** 2, axis=-1) / variance
    # Set the indices of an output without variance to zero.
    indices = np.nan_to_num([first.T, total.T], posinf=0.0, neginf=0.0)
    parts = [indices]
    for members in groups:
        weights = variance[list(members)]
        weights = weights / max(weights.sum(), np.finfo(float).tiny)
        parts.append(np.einsum("m,kmd->kd", weights, indices[:, list(members)])[:, None])
    return np.concatenate(parts, axis=1)
