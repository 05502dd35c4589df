"""Checks, tables, figures and sentences of ``swimid map``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from swimid.fitting.model import Array
from swimid.notices import Notice
from swimid.optimisation import trust
from swimid.optimisation.map_file import Axis, MapFile
from swimid.optimisation.performance import BEAT, STROKE, points_of
from swimid.results import blocks, numbers
from swimid.results import evidence as ev

#: Quantities that are drawn where the robot has them, in this order.
DRAWN = (
    "mean_speed_m_s", "cost_of_transport_J_m", "strouhal", "turning_radius_m", "mean_yaw_rate_rad_s",
    "mean_pitch_rate_rad_s", "peak_yaw_rate_rad_s", "peak_pitch_rate_rad_s", "yaw_range_in_beat_rad",
    "pitch_range_in_beat_rad", "max_pitch_rate_rad_s", "surge_m", "mean_positive_power_W", "peak_torque_N_m",
)  # fmt: skip
#: Number of contours of a panel.
N_LEVELS = 6
#: Quantities with a best point: its name, and the sign that makes it the largest.
BEST = {"mean_speed_m_s": ("fastest", 1.0), "cost_of_transport_J_m": ("cheapest", -1.0)}


def evidence(file: MapFile, notices: Sequence[Notice], origin: dict[str, Any]) -> ev.Evidence:
    """Return the evidence of a map."""
    axes = " and ".join(f"{axis.name} ({len(axis.values)} values)" for axis in file.axes)
    return trust.evidence(
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
        trust.steady_check(steady, len(points)),
        trust.region_check(region, points),
    ]
    if (surge := file.quantities.get("mean_surge_from_start_m_s")) is not None:
        checks += trust.forwards_check([v for row in surge.values for v in row])
    if all(q.stderr is None for q in file.quantities.values()):
        checks.append(trust.unknown_check("uncertainty of the map"))
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
