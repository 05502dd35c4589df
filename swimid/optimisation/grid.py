"""A grid of gaits, computed by all processors and taken up again where it was stopped."""

from __future__ import annotations

import itertools
import os
from collections.abc import Mapping, Sequence

import numpy as np

from swimid.files.checkpoint import Checkpoint
from swimid.fitting.model import Array
from swimid.fitting.parallel import in_threads
from swimid.optimisation.performance import TOGETHER, Performance, Point
from swimid.progress import Progress


def points_of(axes: Mapping[str, Sequence[float]]) -> list[dict[str, float]]:
    """The points of a grid, the last axis fastest."""
    return [dict(zip(axes, values, strict=True)) for values in itertools.product(*axes.values())]


def computed(
    performance: Performance,
    points: Sequence[Point],
    *,
    errors: bool,
    jobs: int | None,
    checkpoint: Checkpoint,
    progress: Progress,
) -> Array:
    """The quantities of every point and their standard errors, shape (n, quantities, 2).

    Parameters
    ----------
    errors : bool
        Carry the coefficients' covariance along; else the errors are NaN.
    """
    share = 1 if errors else TOGETHER
    parts = [points[k : k + share] for k in range(0, len(points), share)]
    width = len(performance.units)

    def one(k: int) -> Array:
        def compute() -> Array:
            if errors:
                return np.array([performance.with_errors(point) for point in parts[k]]).ravel()
            table = performance.table(parts[k])
            return np.stack([table, np.full_like(table, np.nan)], axis=-1).ravel()

        return checkpoint.kept(f"points {k}", compute).reshape(-1, width, 2)

    done = []
    with (
        progress("gaits", total=len(points)) as step,
        in_threads(one, range(len(parts)), jobs or os.cpu_count() or 1) as results,
    ):
        for part in results:
            done.append(part)
            step(len(part))
    return np.concatenate(done)
