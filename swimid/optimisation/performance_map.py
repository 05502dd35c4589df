"""``map``: what a robot comes to over a grid of gaits, with recorded trials beside it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np
from pydantic import Field

from swimid.errors import UsageError
from swimid.files import atomic, yamlio
from swimid.files.checkpoint import Checkpoint
from swimid.files.provenance import Input
from swimid.files.yamlio import Number, Rows
from swimid.fitting.experiment import read_log
from swimid.fitting.model import Array, Trial
from swimid.logs import trials as trials_format
from swimid.logs.kinematics import UNSTEADY, Window
from swimid.logs.log import Log
from swimid.logs.trials import TrialSet
from swimid.notices import Notice, recorded, warn
from swimid.optimisation import study as studies
from swimid.optimisation.options import MapOptions
from swimid.optimisation.performance import BATCH, BEAT, STROKE, Performance, Point, points_of
from swimid.optimisation.study import StudyFile, in_parallel, study_of
from swimid.options import takes
from swimid.progress import Progress, silent
from swimid.results import blocks, numbers
from swimid.results import evidence as ev
from swimid.results.result import FileResult
from swimid.simulation import compare_series
from swimid.simulation.catalogue import Applied
from swimid.simulation.swim_quantities import SwimRun
from swimid.swimmer import trials as swimmer
from swimid.swimmer.model import Swimmer

if TYPE_CHECKING:
    import pandas as pd


class Axis(yamlio.Document):
    """What is varied."""

    name: str
    unit: str
    values: list[float]


class Mapped(yamlio.Document):
    """A quantity over the grid: rows are the first axis, columns the second (one column without one)."""

    unit: str
    values: Rows
    #: Standard deviation from the coefficients' covariance; missing where none is known.
    stderr: Rows | None = None


class MeasuredPoint(yamlio.Document):
    """A recorded trial beside the map."""

    trial: str
    role: Literal["fit", "validate"]
    #: Where it lies on the axes.
    at: dict[str, float]
    inside: bool
    #: Mean speed over its last beats, by the same rule of log and simulation of this very trial, m/s.
    measured_m_s: Number = None
    simulated_m_s: Number = None
    #: By voltage and current, W, over its last beats; and what the model's joints give there.
    electrical_W: Number = None
    mechanical_W: Number = None


class Efficiency(yamlio.Document):
    """Mechanical over electrical power: what gear and motor leave."""

    value: float
    stderr: Number = None
    trials: int


class MapFile(StudyFile):
    """A map file."""

    kind: ClassVar[str] = "map file"
    format: Literal["swimid-map/1"] = "swimid-map/1"
    axes: list[Axis]
    quantities: dict[str, Mapped]
    #: Runs that broke down, and runs whose speed still changes.
    broken: int
    unsettled: int
    measured: list[MeasuredPoint] = []
    efficiency: Efficiency | None = None
    provenance: dict[str, Any] = Field(default_factory=dict)


#: Columns of electrical power in a log.
VOLTAGE, CURRENT = "voltage_V", "current_A"
#: Share of a window whose samples must have both.
LOGGED = 0.9
#: A trial lies on a map where what is not varied differs by no more than this share, and its unit's part.
SAME, LEAST = 0.02, 1e-3


def electrical_power(time_s: Array, voltage_V: Array, current_A: Array, window: Window) -> float:
    """Mean electrical power over a window, W (dolphin, section 4.2.2).

    NaN where less than :data:`LOGGED` of it was logged.

    >>> time = np.linspace(0.0, 1.0, 5)
    >>> electrical_power(time, np.full(5, 24.0), np.full(5, 2.0), Window(0.0, 1.0, 1, 1.0))
    48.0
    """
    power = voltage_V * current_A
    within = (time_s >= window.begin_s - 1e-9) & (time_s <= window.end_s + 1e-9)
    there = np.isfinite(power) & within
    if there.sum() < max(3, LOGGED * within.sum()):
        return math.nan
    return float(np.trapezoid(power[there], time_s[there]) / np.ptp(time_s[there]))


def efficiency(points: Sequence[MeasuredPoint]) -> Efficiency | None:
    """Return mechanical over electrical power of several trials, with the standard error of their scatter.

    Notes
    -----
    ``eta = sum P_m P_e / sum P_e^2``, least squares through the origin: losses in proportion.
    """
    pairs = [(p.mechanical_W, p.electrical_W) for p in points if p.mechanical_W and p.electrical_W]
    if not pairs:
        return None
    mechanical, electrical = np.array(pairs).T
    square = float(electrical @ electrical)
    value = float(mechanical @ electrical) / square
    left = mechanical - value * electrical
    stderr = None
    if len(left) > 1:
        stderr = math.sqrt(float(left @ left) / (len(left) - 1) / square)
    return Efficiency(value=value, stderr=stderr, trials=len(left))


@dataclass(frozen=True)
class Recorded:
    """The trials of a trials file as a map shows them.

    Attributes
    ----------
    inputs : list of Input
        The files that were read.
    region : dict of str to (float, float)
        The range of each axis in the trials the coefficients were identified from (role ``fit``).
    points : list of MeasuredPoint
        Every trial with a drive that differs from the map's in nothing but its axes.
    """

    inputs: Sequence[Input] = ()
    region: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    points: Sequence[MeasuredPoint] = ()


def recorded_trials(
    source: str | Path | TrialSet, performance: Performance, axes: Mapping[str, Sequence[float]]
) -> Recorded:
    """Return the trials of a trials file as a map shows them.

    Parameters
    ----------
    source : path or TrialSet
    performance : Performance
        Of the same robot.
    axes : dict of str to sequence of float
        Of the map.

    Raises
    ------
    UsageError, InputError
        For a trials file of another robot, and for anything wrong in it.
    """
    model, given = performance.model, performance.applied
    readings = given.file.settings.get("readings", {}) if given.file is not None else {}
    experiment = swimmer.load(source, readings=dict(readings), max_step=model.max_step)
    if experiment.robot.name != model.robot.name:
        raise UsageError(
            f"these are trials of the robot '{experiment.robot.name}', the map is of '{model.robot.name}'"
        )
    applied = Applied(experiment.model, given.file, given.path, given.chosen)
    entries: Any = trials_format.read(source)
    folder = trials_format.place(source).parent
    logs = {e.id: read_log(e, folder, required=(), optional=(VOLTAGE, CURRENT)) for e in entries.trials}
    places = {trial.id: _place(applied, trial, axes) for trial in experiment.trials}
    fitted = [places[t.id] for t in experiment.trials if t.role == "fit" and places[t.id]]
    region = {n: (min(p[n] for p in fitted), max(p[n] for p in fitted)) for n in axes if fitted}
    points = []
    for trial in experiment.trials:
        at = places[trial.id]
        if not at or not _is_alike(trial, performance, axes):
            continue
        compared = compare_series.compare_trial(experiment, applied, trial, refit=True)
        speed = compared.record.mean_speed
        electrical, mechanical = _powers(model, trial, logs[trial.id], compared.values)
        points.append(
            MeasuredPoint(
                trial=trial.id,
                role=trial.role,  # type: ignore[arg-type]
                at=at,
                inside=all(min(values) <= at[name] <= max(values) for name, values in axes.items()),
                measured_m_s=speed.measured if speed is not None else None,
                simulated_m_s=speed.simulated if speed is not None else None,
                electrical_W=electrical,
                mechanical_W=mechanical,
            )
        )
    return Recorded(experiment.inputs, region, points)


def _place(applied: Applied, trial: Trial, names: Iterable[str]) -> dict[str, float]:
    """Where a trial lies on axes of these names; empty where it does not say."""
    drive = swimmer.drive_of(trial)
    values = applied.values(trial.id).tolist()
    known = dict(zip((p.name for p in applied.model.parameters), values, strict=True))
    known |= {**(trial.swim.coefficients or {}), **drive}
    return {name: known[name] for name in names} if drive and set(names) <= set(known) else {}


def _is_alike(trial: Trial, performance: Performance, axes: Mapping[str, Sequence[float]]) -> bool:
    """Whether a trial's drive is that of the map where that is not varied."""
    known, own = swimmer.drive_of(trial), performance.drive
    names = [name for name in BEAT | STROKE if name in known and name not in axes]
    return all(abs(known[name] - own.get(name, 0.0)) <= max(SAME * abs(known[name]), LEAST) for name in names)


def _powers(model: Swimmer, trial: Trial, log: Log, values: Array) -> tuple[float, float]:
    """Electrical power of a log, and the power of the model's joints over the same beats, W; NaN for none."""
    drive = trial.swim.drive
    run = None if drive is None else SwimRun.of(model, trial, drive.frequency_hz)
    if run is None or VOLTAGE not in log or CURRENT not in log:
        return math.nan, math.nan
    electrical = electrical_power(log.time_s, log[VOLTAGE], log[CURRENT], run.window)
    columns, energetics = model.with_energetics([(values, run.trial)], [run.window.duration_s])[0]
    mechanical = math.nan
    if energetics is not None:
        mechanical = run.quantities(model, values, columns, energetics)["mean_positive_power_W"].value
    if mechanical > electrical:
        warn(
            "SWM002",
            f"{trial.id}: the joints give {mechanical:.3g} W where {electrical:.3g} W of electrical power "
            "were logged; are they in V and A, and of all motors?",
        )
    return electrical, mechanical


#: Maximum number of points of a map.
MAX_POINTS = 100_000


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
    evidence = evidence_of(file, notices, study.origin)
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
    size = 1 if uncertain else BATCH
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


#: Quantities that are drawn where the robot has them, in this order.
DRAWN = (
    "mean_speed_m_s", "cost_of_transport_J_m", "strouhal", "turning_radius_m", "mean_yaw_rate_rad_s",
    "mean_pitch_rate_rad_s", "max_yaw_rate_rad_s", "max_pitch_rate_rad_s", "yaw_range_in_beat_rad",
    "pitch_range_in_beat_rad", "surge_m", "mean_positive_power_W", "peak_torque_N_m",
)  # fmt: skip
#: Number of contours of a panel.
N_LEVELS = 6
#: Quantities with a best point: its name, and the sign that makes it the largest.
BEST = {"mean_speed_m_s": ("fastest", 1.0), "cost_of_transport_J_m": ("cheapest", -1.0)}


def evidence_of(file: MapFile, notices: Sequence[Notice], origin: dict[str, Any]) -> ev.Evidence:
    """Return the evidence of a map."""
    axes = " and ".join(f"{axis.name} ({len(axis.values)} values)" for axis in file.axes)
    return studies.evidence(
        file,
        "map",
        answer(file),
        _checks(file),
        {
            "Grid": ", ".join(f"{_axis_range(axis)} × {len(axis.values)}" for axis in file.axes),
            "Trials beside it": str(len(file.measured)),
        },
        notices,
        origin,
        tables=[_best_table(file), *_measured_table(file)],
        figures=_figures(file),
        methods=[
            f"The gait of {file.robot} was varied over {axes}; each run of {file.duration_s:g} s began at "
            "rest and was judged by its last whole beats. The power of driven joints is that of their "
            "torques, by inverse dynamics of the simulated motion; the cost of transport is mean positive "
            "power over speed. Standard deviations, where known, are those of the delta method."
        ],
    )


def _checks(file: MapFile) -> list[ev.Check]:
    axes = {axis.name: axis.values for axis in file.axes}
    drive = {name: float(value) for name, value in file.drive.items() if name in BEAT | STROKE}
    points = [{**drive, **point} for point in points_of(axes)]
    steady = len(points) - file.unsettled
    region = {n: ends for n, ends in file.identified.items() if n in axes or n in BEAT | STROKE}
    broken = f"{file.broken} of {len(points)}"
    checks = [
        ev.check("runs that broke down", broken, not file.broken, "none", reason=f"{broken} runs broke down"),
        studies.steady_check(steady, len(points)),
        studies.region_check(region, points),
    ]
    if (surge := file.quantities.get("mean_surge_from_start_m_s")) is not None:
        checks += studies.forwards_check([v for row in surge.values for v in row])
    if all(q.stderr is None for q in file.quantities.values()):
        checks.append(studies.unknown_check("uncertainty of the map"))
    known = [m for m in file.measured if m.measured_m_s is not None and m.simulated_m_s is not None]
    if known:
        off = np.array([m.measured_m_s - m.simulated_m_s for m in known])  # type: ignore[operator]
        value = f"{numbers.number(float(np.sqrt(np.mean(off**2))), 3, 'm/s')} over {len(off)} trials"
        checks.append(ev.check("measured mean speeds, RMSE", value, None))
    if (e := file.efficiency) is not None:
        value = f"{numbers.measured(e.value, e.stderr)} of {e.trials} trials"
        checks.append(ev.check("mechanical over electrical power", value, e.value <= 1.0, "≤ 1"))
    return checks


# ------------------------------------------------------------ in words


def _axis_range(axis: Axis) -> str:
    return f"{axis.name} {numbers.number(axis.values[0])} to {numbers.number(axis.values[-1])}"


def answer(file: MapFile) -> str:
    """Return the best points as a sentence."""
    parts = []
    for name, (word, sign) in BEST.items():
        values = np.array(file.quantities[name].values if name in file.quantities else np.nan, dtype=float)
        if not np.isfinite(values).any():
            continue
        at = np.unravel_index(int(np.nanargmax(sign * values)), values.shape)
        place = ", ".join(
            f"{axis.name} {numbers.number(axis.values[i], 3)}" for axis, i in zip(file.axes, at, strict=False)
        )
        edge = any(i in (0, len(axis.values) - 1) for axis, i in zip(file.axes, at, strict=False))
        rim = ", on the edge of the map" if edge else ""
        parts.append(
            f"{word} {numbers.number(float(values[at]), 3, file.quantities[name].unit)} at {place}{rim}"
        )
    text = "; ".join(parts) or "mapped"
    return f"{text[0].upper()}{text[1:]}."


# ------------------------------------------------------------ tables


def _best_table(file: MapFile) -> ev.Table:
    """Of one axis every point; of two, for each value of the first, the best points on the second."""
    first, rows = file.axes[0], []
    for i, at in enumerate(first.values):
        row: dict[str, blocks.Cell] = {first.name: numbers.number(at)}
        if len(file.axes) == 1:
            row |= {name: _cell(file, name, i, 0) for name in _drawn(file)}
        for name in BEST if len(file.axes) == 2 else ():
            if name in file.quantities:
                word, sign = BEST[name]
                values = sign * np.array(file.quantities[name].values[i], dtype=float)
                j = int(np.argmax(np.nan_to_num(values, nan=-np.inf)))
                row[f"{word} at {file.axes[1].name}"] = numbers.number(file.axes[1].values[j])
                row[word] = _cell(file, name, i, j)
        rows.append(row)
    return blocks.table("best", f"Best points at each {first.name}", rows)


def _cell(file: MapFile, name: str, row: int, column: int) -> str:
    q = file.quantities[name]
    factor, unit = numbers.in_degrees(q.unit)
    value, error = q.values[row][column], None if q.stderr is None else q.stderr[row][column]
    if value is None or error is None:
        return numbers.number(None if value is None else factor * value, 3, unit)
    return numbers.measured(factor * value, factor * error, unit)


def _measured_table(file: MapFile) -> list[ev.Table]:
    rows: list[dict[str, blocks.Cell]] = [
        {
            "trial": m.trial,
            "role": "held out" if m.role == "validate" else "fit",
            **{name: numbers.number(at) for name, at in m.at.items()},
            "measured": numbers.number(m.measured_m_s, 3, "m/s"),
            "simulated": numbers.number(m.simulated_m_s, 3, "m/s"),
            "electrical": numbers.number(m.electrical_W, 3, "W"),
            "joints": numbers.number(m.mechanical_W, 3, "W"),
        }
        for m in file.measured
    ]
    caption = (
        "Mean speed over the last beats of log and simulation; logged electrical power, and the joints'."
    )
    return [blocks.table("measured", "Measured trials on the map", rows, caption)] if rows else []


# ------------------------------------------------------------ figures


def _drawn(file: MapFile) -> list[str]:
    return [name for name in DRAWN if name in file.quantities]


def _figures(file: MapFile) -> list[ev.Figure]:
    drive = ", ".join(f"{name} {value}" for name, value in file.drive.items())
    caption = f"Runs of {file.duration_s:g} s from rest, over their last whole beats; {drive}."
    if len(file.axes) == 1:
        curves = [_curve(file, name) for name in _drawn(file)]
        return [blocks.panels("map", "Over the gait", caption, curves, columns=2)]
    heats = [_heat(file, name) for name in _drawn(file)]
    contours = [_contours(file, name) for name in _drawn(file)]
    lines = "Lines of equal value; outside the frame of the identification trials they are extrapolation."
    return [
        blocks.panels("map", "Over the grid of gaits", caption, heats, columns=1),
        blocks.panels("contours", "Contours", lines, contours, columns=1),
    ]


def _shown(file: MapFile, name: str) -> tuple[Array, str]:
    """A quantity in the unit it is drawn in, and its title."""
    factor, unit = numbers.in_degrees(file.quantities[name].unit)
    bare, printed = numbers.split_unit(name)[0].replace("_", " "), numbers.unit_text(unit)
    title = f"{bare} ({printed})" if printed else bare
    return factor * np.array(file.quantities[name].values, dtype=float), title


def _axis_title(axis: Axis) -> str:
    """What a coefficient is called is no column: ``K_s`` has no seconds."""
    if axis.name in BEAT | STROKE:
        return numbers.column_title(axis.name)
    unit = numbers.unit_text(axis.unit)
    return f"{axis.name} ({unit})" if unit else axis.name


def _heat(file: MapFile, name: str) -> ev.Panel:
    values, title = _shown(file, name)
    rows, columns = ([numbers.number(v, 3) for v in axis.values] for axis in file.axes)
    cells = [[float(f"{v:.3g}") for v in row] for row in values]
    heat = ev.Heat(rows=rows, columns=columns, values=cells, scale="linear")  # type: ignore[arg-type]
    down, along = (_axis_title(axis) for axis in file.axes)
    return blocks.panel(along, down, [], title=title, heat=heat)


def _contours(file: MapFile, name: str) -> ev.Panel:
    import contourpy
    from matplotlib.ticker import MaxNLocator

    values, title = _shown(file, name)
    down, along = file.axes
    finite = values[np.isfinite(values)]
    traces = []
    if np.ptp(finite) > 0:
        lines = contourpy.contour_generator(along.values, down.values, np.ma.masked_invalid(values))
        low, high = float(finite.min()), float(finite.max())
        levels = [v for v in MaxNLocator(N_LEVELS).tick_values(low, high) if low < v < high]
        for k, level in enumerate(levels):
            # a row of NaN ends each line
            found = [np.vstack([np.asarray(line), [[np.nan, np.nan]]]) for line in lines.lines(level)]
            if found:
                x, y = np.vstack(found).T
                traces.append(ev.Trace(x=x, y=y, label=numbers.number(float(level), 3), group=k))
    if all(axis.name in file.identified for axis in file.axes):
        (x0, x1), (y0, y1) = (file.identified[axis.name] for axis in (along, down))
        frame = {"x": [x0, x1, x1, x0, x0], "y": [y0, y0, y1, y1, y0]}
        traces.append(ev.Trace(**frame, style="dashed", label="identified inside", group=N_LEVELS + 1))
    inside = [m for m in file.measured if m.inside]
    if inside:
        points = blocks.points(inside, lambda m: m.at[along.name], lambda m: m.at[down.name], label="trials")
        traces.append(points)
    return blocks.panel(_axis_title(along), _axis_title(down), traces, title=title)


def _curve(file: MapFile, name: str) -> ev.Panel:
    values, title = _shown(file, name)
    axis, q = file.axes[0], file.quantities[name]
    x, y = np.array(axis.values), values[:, 0]
    traces = [ev.Trace(x=x, y=y, label="model")]
    if q.stderr is not None:
        half = 2 * numbers.in_degrees(q.unit)[0] * np.array(q.stderr, dtype=float)[:, 0]
        traces = [blocks.band(x, y, half, label="model, 2 sd")]
    measured = [m for m in file.measured if m.measured_m_s is not None and name == "mean_speed_m_s"]
    if measured:
        traces.append(
            blocks.points(measured, lambda m: m.at[axis.name], lambda m: m.measured_m_s, label="measured")
        )
    spans = []
    if axis.name in file.identified:
        low, high = file.identified[axis.name]
        spans = [ev.Span(start=low, end=high, label="range of the identification trials")]
    return blocks.panel(_axis_title(axis), title, traces, spans=spans)
