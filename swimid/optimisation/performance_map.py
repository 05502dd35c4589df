"""Command ``map``: speed, cost of transport and other quantities of a robot over a grid of gaits."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import contourpy
import numpy as np
from matplotlib.ticker import MaxNLocator
from pydantic import Field

from swimid.errors import UsageError
from swimid.files import yamlio
from swimid.files.atomic import Checkpoint
from swimid.files.yamlio import Rows
from swimid.fitting.model import Array
from swimid.kinematics.cycles import UNSTEADY
from swimid.logs.log import to_xarray
from swimid.notices import Notice, Progress, record_warnings, silent
from swimid.optimisation import study as studies
from swimid.optimisation.options import MapOptions
from swimid.optimisation.study import BATCH_GAITS, BEAT, STROKE, Performance, Point, StudyFile, points_of
from swimid.options import takes
from swimid.results import evidence as ev
from swimid.results import numbers
from swimid.results.result import FileResult
from swimid.simulation.cases import format_quantity

if TYPE_CHECKING:
    import pandas as pd
    import xarray

#: Maximum number of grid points of a map.
MAX_GRID_POINTS = 100_000
#: Quantities that the evidence of a map plots and tabulates, in this order, if the robot has them.
DRAWN = (
    "mean_speed_m_s", "cost_of_transport_J_m", "strouhal", "turning_radius_m", "mean_yaw_rate_rad_s",
    "mean_pitch_rate_rad_s", "max_yaw_rate_rad_s", "yaw_range_in_beat_rad",
    "pitch_range_in_beat_rad", "max_pitch_rate_rad_s", "surge_m", "mean_positive_power_W", "peak_torque_N_m",
)  # fmt: skip
#: Approximate number of contour levels in a panel of a map.
N_LEVELS = 6
#: Quantities whose best grid point is reported. Each has a word for the best point, and a sign: 1 if the best
#: value is the maximum, -1 if it is the minimum.
BEST = {"mean_speed_m_s": ("fastest", 1.0), "cost_of_transport_J_m": ("cheapest", -1.0)}


class MapAxis(yamlio.Document):
    """Axis of a map: name, unit and values of a varied parameter."""

    name: str
    unit: str
    values: list[float]


class Mapped(yamlio.Document):
    """Values of one quantity over the grid of a map.

    Rows of ``values`` belong to the values of the first axis of the map, columns to those of the second axis.
    Without a second axis there is one column.
    """

    unit: str
    values: Rows
    #: Standard errors of the values, from the covariance of the coefficients; None if the covariance is
    #: unknown.
    stderr: Rows | None = None


class MapFile(StudyFile):
    """Content of a map file: quantities of a robot over a grid of gaits."""

    kind: ClassVar[str] = "map file"
    format: Literal["swimid-map/1"] = "swimid-map/1"
    axes: list[MapAxis]
    quantities: dict[str, Mapped]
    #: Number of simulations that diverged, and number of simulations in which the speed still changes at
    #: the end.
    broken: int
    unsettled: int
    provenance: yamlio.Provenance = Field(default_factory=dict)


class PerformanceMap(FileResult[MapFile]):
    """Map of the quantities of a robot over a grid of gaits, the result of ``map``.

    Attributes
    ----------
    frame : DataFrame
        One row for each grid point: the varied parameters, and every quantity in SI units (NaN if unknown).
    file : MapFile
        All results, including standard errors. :meth:`save` writes this file.
    """

    file_type = MapFile

    @property
    def frame(self) -> pd.DataFrame:
        """Table with one row for each grid point: the varied parameters, and every quantity in SI units."""
        import pandas as pd

        points = points_of({axis.name: axis.values for axis in self.file.axes})
        columns = {name: np.array(q.values, dtype=float).ravel() for name, q in self.file.quantities.items()}
        return pd.DataFrame({**pd.DataFrame(points), **columns})

    def to_xarray(self) -> xarray.Dataset:
        """Return the map as an ``xarray.Dataset`` over the axes of the map. Each quantity has its unit."""
        return to_xarray(self.frame, [axis.name for axis in self.file.axes])


@takes(MapOptions)
def performance_map(
    *, options: MapOptions, output: Path | None = None, progress: Progress = silent
) -> PerformanceMap:
    """Compute speed, cost of transport, turning and power of a robot over a grid of gaits.

    Each point is a simulation from rest, whose last whole beats are evaluated. If the parameter file has
    standard errors, the standard errors of the quantities are computed by the delta method. Points outside
    the range of the identification trials are extrapolation.

    Parameters
    ----------
    output : path, optional
        Map file to write. The evidence is written to the same folder.
    progress : Progress
        Shows the progress over the points.

    Returns
    -------
    PerformanceMap
        ``.frame`` has one row for each point, in SI units.

    Raises
    ------
    UsageError, InputError
        If an option or a file is invalid.
    NoTrustworthyResult
        If every simulation diverges.

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
    with record_warnings(repeat=True) as notices:
        performance = Performance.of_options(options)
        axes = _axes_of(performance, options)
        study = studies.study_of(performance, options, output)
        uncertain = bool(performance.applied.uncertain()[0])
        performance.model.prepare(progress)
        performance = performance.at_step({name: (axis[0], axis[-1]) for name, axis in axes.items()})
        given = performance, points_of(axes), options, study.checkpoint, progress
        table = _simulate(*given, uncertain=uncertain)
        performance.insist(table[..., 0])
        if uncertain:
            performance.applied.warn_without_error("the deviations of the map")
        file = _map_file(study, performance, axes, table, uncertain=uncertain)
    return study.save(PerformanceMap, file, make_map_evidence(file, notices, study.origin))


def _axes_of(performance: Performance, options: MapOptions) -> dict[str, list[float]]:
    """Return the values of the varied parameters along each axis of a map.

    Raises
    ------
    UsageError
        If the options describe a map without axes, with more than two axes, or with too many points.
    """
    over = options.over
    if len(over) > 2:
        raise UsageError(f"--over has {len(over)} axes: a map has one axis or two")
    performance.check_gaits({name: axis[:2] for name, axis in over.items()}, "--over")
    short = [name for name, axis in over.items() if axis[2] < 2]
    if short:
        raise UsageError(f"--over {short[0]} has {over[short[0]][2]} points: an axis has two or more")
    count = math.prod(axis[2] for axis in over.values())
    if count > MAX_GRID_POINTS:
        raise UsageError(f"--over has {count} points: a map has at most {MAX_GRID_POINTS} points")
    return {name: np.linspace(*axis).tolist() for name, axis in over.items()}


def _map_file(
    study: studies.OptimisationStudy,
    performance: Performance,
    axes: dict[str, list[float]],
    table: Array,
    *,
    uncertain: bool,
) -> MapFile:
    """Return a map file's content from values and standard errors ``table``, (points, quantities, 2)."""
    values, stderr = table[..., 0], table[..., 1]
    shape = (len(next(iter(axes.values()))), -1)
    quantities, columns = {}, {}
    for k, (name, unit) in enumerate(performance.units.items()):
        columns[name] = values[:, k]
        shown = {"values": values[:, k].reshape(shape)}
        if uncertain:
            shown["stderr"] = stderr[:, k].reshape(shape)
        if np.isfinite(values[:, k]).any():
            quantities[name] = Mapped(unit=unit, **shown)  # type: ignore[arg-type]
    change = np.abs(columns.get("speed_change_per_beat_m_s", np.zeros(len(values))))
    return MapFile(
        **study.head,
        axes=[MapAxis(name=n, unit=performance.axes[n], values=v) for n, v in axes.items()],
        quantities=quantities,
        broken=int((~np.isfinite(values)).all(axis=1).sum()),
        unsettled=int((change > UNSTEADY * np.abs(columns["mean_speed_m_s"])).sum()),
    )


def _simulate(
    performance: Performance,
    points: Sequence[Point],
    options: MapOptions,
    checkpoint: Checkpoint,
    progress: Progress,
    *,
    uncertain: bool,
) -> Array:
    """Simulate the gaits at grid points, and return their quantities with standard errors.

    The result has the shape (n, quantities, 2): values and standard errors. Unknown standard errors are NaN.
    """
    size = 1 if uncertain else BATCH_GAITS
    parts = [points[k : k + size] for k in range(0, len(points), size)]

    def compute(part: Sequence[Point]) -> Array:
        if uncertain:
            return np.array([performance.with_errors(point) for point in part]).ravel()
        table = performance.table(part)
        return np.stack([table, np.full_like(table, np.nan)], axis=-1).ravel()

    def load(k: int) -> Array:
        return checkpoint.get_or_compute(f"points {k}", lambda: compute(parts[k]))

    found = studies.in_parallel(load, len(parts), options.jobs, "gaits", progress)
    return np.concatenate([rows.reshape(-1, len(performance.units), 2) for rows in found])


# ------------------------------------------------------------ evidence


def make_map_evidence(file: MapFile, notices: Sequence[Notice], origin: dict[str, Any]) -> ev.Evidence:
    """Return the evidence of a map, with checks, tables and figures."""
    axes = " and ".join(f"{axis.name} ({len(axis.values)} values)" for axis in file.axes)
    grid = []
    for axis in file.axes:
        first, last = numbers.format_number(axis.values[0]), numbers.format_number(axis.values[-1])
        grid.append(f"{axis.name} {first} to {last} × {len(axis.values)}")
    methods = [
        f"The gait of {file.robot} was varied over {axes}; each run of {file.duration_s:g} s began at "
        "rest and was judged by its last whole beats. The power of driven joints is that of their "
        "torques, by inverse dynamics of the simulated motion; the cost of transport is mean positive "
        "power over speed. Standard deviations, where known, are those of the delta method."
    ]
    return studies.make_evidence(
        file, "map", answer(file), _checks(file),
        {"Grid": ", ".join(grid)},
        notices, origin, tables=[_best_table(file)], figures=_figures(file), methods=methods,
    )  # fmt: skip


def _checks(file: MapFile) -> list[ev.Check]:
    axes = {axis.name: axis.values for axis in file.axes}
    drive = {name: float(value) for name, value in file.drive.items() if name in BEAT | STROKE}
    points = [{**drive, **point} for point in points_of(axes)]
    region = {n: ends for n, ends in file.identified.items() if n in axes or n in BEAT | STROKE}
    broken = f"{file.broken} of {len(points)}"
    checks = [
        ev.make_check(
            "runs that diverged", broken, not file.broken, "none", reason=f"{broken} runs diverged"
        ),
        studies.steady_check(len(points) - file.unsettled, len(points)),
        studies.region_check(region, points),
    ]
    if (surge := file.quantities.get("mean_surge_from_start_m_s")) is not None:
        checks += studies.forwards_check(np.array(surge.values, dtype=object).ravel().tolist())
    if all(q.stderr is None for q in file.quantities.values()):
        checks.append(studies.make_undefined_check("uncertainty of the map"))
    return checks


def answer(file: MapFile) -> str:
    """Return a sentence with the highest speed and the lowest cost of transport in a map, and their gaits."""
    parts = []
    for name, (word, sign) in BEST.items():
        if name not in file.quantities:
            continue
        values = np.array(file.quantities[name].values, dtype=float)
        at = np.unravel_index(int(np.nanargmax(sign * values)), values.shape)[: len(file.axes)]
        on_axes = list(zip(file.axes, at, strict=True))
        place = ", ".join(f"{axis.name} {numbers.format_number(axis.values[i], 3)}" for axis, i in on_axes)
        best = numbers.format_number(sign * float(np.nanmax(sign * values)), 3, file.quantities[name].unit)
        edge = any(i in (0, len(axis.values) - 1) for axis, i in on_axes)
        parts.append(f"{word} {best} at {place}" + ", on the edge of the map" * edge)
    text = "; ".join(parts) or "mapped"
    return f"{text[0].upper()}{text[1:]}."


def _best_table(file: MapFile) -> ev.Table:
    """Return a table of the quantities at the best points of a map.

    With one axis the table has every grid point. With two axes it has the best points for each value of the
    first axis.
    """
    first, rows = file.axes[0], []
    for i, at in enumerate(first.values):
        row: dict[str, ev.Cell] = {first.name: numbers.format_number(at)}
        if len(file.axes) == 1:
            row |= {name: _cell(file, name, i, 0) for name in _select_plotted(file)}
        for name in BEST if len(file.axes) == 2 else ():
            if name in file.quantities:
                word, sign = BEST[name]
                values = sign * np.array(file.quantities[name].values[i], dtype=float)
                j = int(np.argmax(np.nan_to_num(values, nan=-np.inf)))
                row[f"{word} at {file.axes[1].name}"] = numbers.format_number(file.axes[1].values[j])
                row[word] = _cell(file, name, i, j)
        rows.append(row)
    return ev.make_table("best", f"Best points at each {first.name}", rows)


def _cell(file: MapFile, name: str, row: int, column: int) -> str:
    q, sd = file.quantities[name], None
    if q.stderr is not None:
        sd = q.stderr[row][column]
    return format_quantity(q.values[row][column], q.unit, sd)


def _select_plotted(file: MapFile) -> list[str]:
    return [name for name in DRAWN if name in file.quantities]


def _figures(file: MapFile) -> list[ev.Figure]:
    drive = ", ".join(f"{name} {value}" for name, value in file.drive.items())
    caption = f"Runs of {file.duration_s:g} s from rest, over their last whole beats; {drive}."
    if len(file.axes) == 1:
        curves = [_curve(file, name) for name in _select_plotted(file)]
        return [ev.panels("map", "Over the gait", caption, curves)]
    heats = [_heat(file, name) for name in _select_plotted(file)]
    contours = [_contours(file, name) for name in _select_plotted(file)]
    lines = "Lines of equal value; outside the frame of the identification trials they are extrapolation."
    return [
        ev.panels("map", "Over the grid of gaits", caption, heats),
        ev.panels("contours", "Contours", lines, contours),
    ]


def _to_plot_unit(file: MapFile, name: str) -> tuple[Array, str]:
    """Return the values of a quantity of a map in the unit of the plot, and the title of the quantity."""
    bare, unit = numbers.split_unit(name)[0].replace("_", " "), file.quantities[name].unit
    factor, shown = numbers.in_degrees(unit)
    return factor * np.array(file.quantities[name].values, dtype=float), _title(bare, shown)


def _title(name: str, unit: str) -> str:
    printed = numbers.unit_text(unit)
    return f"{name} ({printed})" if printed else name


def _axis_title(axis: MapAxis) -> str:
    """Return the title of an axis of a map.

    The title of a drive parameter has the unit from its name. The name of a coefficient is not split into
    name and unit, because it may end like a unit (``K_s``).
    """
    if axis.name in BEAT | STROKE:
        return numbers.column_title(axis.name)
    return _title(axis.name, axis.unit)


def _heat(file: MapFile, name: str) -> ev.Panel:
    values, title = _to_plot_unit(file, name)
    rows, columns = ([numbers.format_number(v, 3) for v in axis.values] for axis in file.axes)
    cells = [[float(f"{v:.3g}") for v in row] for row in values]
    heat = ev.Heat(rows=rows, columns=columns, values=cells, scale="linear")  # type: ignore[arg-type]
    down, along = (_axis_title(axis) for axis in file.axes)
    return ev.panel(along, down, [], title=title, heat=heat)


def _contours(file: MapFile, name: str) -> ev.Panel:
    values, title = _to_plot_unit(file, name)
    down, along = file.axes
    traces = []
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    lines = contourpy.contour_generator(along.values, down.values, np.ma.masked_invalid(values))
    levels = [v for v in MaxNLocator(N_LEVELS).tick_values(low, high) if low < v < high]
    for k, level in enumerate(levels):
        # End each contour line with a row of NaN, so that one curve can hold several separate lines.
        found = [np.vstack([np.asarray(line), [[np.nan, np.nan]]]) for line in lines.lines(level)]
        if found:
            x, y = np.vstack(found).T
            traces.append(ev.Trace(x=x, y=y, label=numbers.format_number(float(level), 3), group=k))
    if all(axis.name in file.identified for axis in file.axes):
        (x0, x1), (y0, y1) = (file.identified[axis.name] for axis in (along, down))
        frame = {"x": [x0, x1, x1, x0, x0], "y": [y0, y0, y1, y1, y0]}
        traces.append(ev.Trace(**frame, style="dashed", label="identified inside", group=N_LEVELS + 1))
    return ev.panel(_axis_title(along), _axis_title(down), traces, title=title)


def _curve(file: MapFile, name: str) -> ev.Panel:
    values, title = _to_plot_unit(file, name)
    axis, q = file.axes[0], file.quantities[name]
    x, y = np.array(axis.values), values[:, 0]
    traces = [ev.Trace(x=x, y=y, label="model")]
    if q.stderr is not None:
        half = 2 * numbers.in_degrees(q.unit)[0] * np.array(q.stderr, dtype=float)[:, 0]
        traces = [ev.band(x, y, half, label="model, 2 sd")]
    spans = []
    if axis.name in file.identified:
        low, high = file.identified[axis.name]
        spans = [ev.Span(start=low, end=high, label="range of the identification trials")]
    return ev.panel(_axis_title(axis), title, traces, spans=spans)
