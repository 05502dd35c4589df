"""``map``: what a robot comes to over a grid of gaits."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from swimid.errors import UsageError
from swimid.files import atomic
from swimid.files.checkpoint import Checkpoint
from swimid.fitting.model import Array
from swimid.notices import recorded
from swimid.optimisation import map_evidence
from swimid.optimisation.map_file import FORMAT, Axis, MapFile, Mapped
from swimid.optimisation.measured import Recorded, efficiency, recorded_trials
from swimid.optimisation.options import MapOptions
from swimid.optimisation.performance import TOGETHER, Performance, Point, in_parallel, points_of, study_of
from swimid.options import takes
from swimid.progress import Progress, silent
from swimid.results.result import FileResult

if TYPE_CHECKING:
    import pandas as pd

#: Maximum number of points of a map.
MAX_POINTS = 100_000
#: A change of speed from beat to beat above this share is not steady.
UNSTEADY = 0.005


@dataclass(frozen=True, eq=False)
class PerformanceMap(FileResult[MapFile]):
    """What a robot comes to over a grid of gaits, as ``map`` gives it.

    Attributes
    ----------
    frame : DataFrame
        A row for each point: its axes, and every quantity in SI units, NaN where there is none.
    file : MapFile
        What :meth:`save` writes; it also has standard deviations, measured trials and their region.
    """

    format = FORMAT
    file_type = MapFile

    @property
    def frame(self) -> pd.DataFrame:
        """A row for each point of the grid."""
        import pandas as pd

        points = points_of({axis.name: axis.values for axis in self.file.axes})
        columns = {name: np.array(q.values, dtype=float).ravel() for name, q in self.file.quantities.items()}
        return pd.DataFrame({**pd.DataFrame(points), **columns})


@takes(MapOptions)
def performance_map(
    *, options: MapOptions, output: Path | None = None, progress: Progress = silent
) -> PerformanceMap:
    """Speed, cost of transport, Strouhal number, turning and power of a robot over a grid of gaits.

    Each point is a run from rest, judged by its last whole beats. Where a parameter file has standard errors,
    those of the quantities follow by the delta method. What lies outside the range of the trials the
    coefficients were identified from is extrapolation: the trials file says where that begins.

    Parameters
    ----------
    output : path, optional
        Map file to write; its evidence goes beside it.
    progress : Progress
        Shows the points.

    Returns
    -------
    PerformanceMap
        ``.frame`` has a row a point; SI units, named in the columns.

    Raises
    ------
    UsageError, InputError
        For bad options and files.
    NoTrustworthyResult
        When every run breaks down.

    References
    ----------
    .. [1] D. Chen, Y. Xiong, B. Wang, R. Tong, Y. Meng, J. Yu, "Performance Optimization for Bionic Robotic
       Dolphin with Active Variable Stiffness Control".
       Section 4.3, Fig 11a: speed over frequency and stiffness; Eq 11: cost of transport.
    .. [2] "Locomotion Optimization of a Tendon-Driven Robotic Fish with Variable Passive Tail Fin".
       Table V: steering over bias and asymmetry.

    Examples
    --------
    >>> found = performance_map(
    ...     robot="dolphin", amplitude_deg=27, over={"frequency_hz": (2, 4, 2), "K_s": (0.2, 1.0, 3)}
    ... )
    >>> float(found.frame.loc[found.frame["mean_speed_m_s"].idxmax(), "frequency_hz"])
    4.0
    """
    with recorded(repeat=True) as notices:
        performance = Performance.of_options(options)
        if len(options.over) > 2:
            raise UsageError("a map has one axis or two")
        performance.check({name: axis[:2] for name, axis in options.over.items()}, "--over")
        performance.check_drive(options.over, "--over")
        if any(axis[2] < 2 for axis in options.over.values()):
            raise UsageError("--over: an axis has two points or more")
        if math.prod(axis[2] for axis in options.over.values()) > MAX_POINTS:
            raise UsageError(f"a map has at most {MAX_POINTS} points")
        axes = {name: [float(v) for v in np.linspace(*axis)] for name, axis in options.over.items()}
        beside = Recorded()
        if options.trials is not None:
            beside = recorded_trials(options.trials, performance, axes)
        study = study_of(performance, options, beside.inputs)
        if output is not None:
            atomic.check_writable(output, inputs=study.inputs)
        keep = Checkpoint.beside(output, study.key)
        points = points_of(axes)
        uncertain = performance.applied.uncertain()[0]
        runs = len(points) * (1 + 2 * len(uncertain))
        performance.model.prepare(progress, simulated_s=runs * options.duration_s, checkpoint=keep)
        found = _computed(performance, points, bool(uncertain), options.jobs, keep, progress)
        performance.insist(found[..., 0])
        if uncertain:
            performance.applied.warn_without_error("the deviations of the map")
        shape = (len(next(iter(axes.values()))), -1)
        quantities = {
            name: Mapped(
                unit=unit,
                values=found[:, k, 0].reshape(shape),  # type: ignore[arg-type]
                stderr=found[:, k, 1].reshape(shape) if uncertain else None,  # type: ignore[arg-type]
            )
            for k, (name, unit) in enumerate(performance.units.items())
            if np.isfinite(found[:, k, 0]).any()
        }
        units = performance.axes
        study.said["identified"] |= beside.region
        file = MapFile(
            **study.said,
            axes=[Axis(name=name, unit=units[name], values=values) for name, values in axes.items()],
            quantities=quantities,
            broken=int((~np.isfinite(found[..., 0])).all(axis=1).sum()),
            unsettled=_unsettled(quantities),
            measured=beside.points,
            efficiency=efficiency(beside.points),
        )
    evidence = map_evidence.evidence(file, notices, study.origin)
    file.verdict = evidence.verdict.level
    saved = PerformanceMap.of(file, evidence).saved(output)
    keep.done()
    return saved


def _computed(
    performance: Performance,
    points: Sequence[Point],
    uncertain: bool,
    jobs: int | None,
    checkpoint: Checkpoint,
    progress: Progress,
) -> Array:
    """Quantities of every point and their standard errors (NaN where unknown), shape (n, quantities, 2)."""
    size = 1 if uncertain else TOGETHER
    parts = [points[k : k + size] for k in range(0, len(points), size)]

    def compute(part: Sequence[Point]) -> Array:
        if uncertain:
            return np.array([performance.with_errors(point) for point in part]).ravel()
        table = performance.table(part)
        return np.stack([table, np.full_like(table, np.nan)], axis=-1).ravel()

    def one(k: int) -> Array:
        return checkpoint.kept(f"points {k}", lambda: compute(parts[k]))

    found = in_parallel(one, range(len(parts)), jobs, "gaits", progress)
    return np.concatenate([rows.reshape(-1, len(performance.units), 2) for rows in found])


def _unsettled(quantities: dict[str, Mapped]) -> int:
    """Points whose speed still changes from beat to beat."""
    if "speed_change_per_beat_m_s" not in quantities:
        return 0
    change = np.array(quantities["speed_change_per_beat_m_s"].values, dtype=float)
    speed = np.array(quantities["mean_speed_m_s"].values, dtype=float)
    return int((np.abs(change) > UNSTEADY * np.abs(speed)).sum())
