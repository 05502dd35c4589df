"""Checks, tables, figures and sentences of ``swimid map``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from swimid.fitting.model import Array
from swimid.notices import Notice
from swimid.optimisation import grid, trust
from swimid.optimisation.map_file import Axis, MapFile, Mapped
from swimid.optimisation.performance import BEAT, STROKE
from swimid.results import blocks, numbers
from swimid.results import evidence as ev

#: What is drawn, in this order, of what there is; an ending in ``*`` stands for the robot's turn.
DRAWN = (
    "mean_speed_m_s",
    "cost_of_transport_J_m",
    "strouhal",
    "turning_radius_m",
    "mean_yaw_rate_rad_s",
    "mean_pitch_rate_rad_s",
    "peak_yaw_rate_rad_s",
    "peak_pitch_rate_rad_s",
    "yaw_range_in_beat_rad",
    "pitch_range_in_beat_rad",
    "max_pitch_rate_rad_s",
    "surge_m",
    "mean_positive_power_W",
    "peak_torque_N_m",
)
#: Contours of a panel.
LEVELS = 6
#: What is best where it is largest, and where it is least.
LARGEST, LEAST = ("mean_speed_m_s",), ("cost_of_transport_J_m",)
REFERENCES = [
    "D. Chen, Y. Xiong, B. Wang, R. Tong, Y. Meng, J. Yu: Performance Optimization for Bionic Robotic "
    "Dolphin with Active Variable Stiffness Control",
    "Locomotion Optimization of a Tendon-Driven Robotic Fish with Variable Passive Tail Fin",
]


def evidence(file: MapFile, notices: Sequence[Notice], origin: dict[str, Any]) -> ev.Evidence:
    """What a map rests on."""
    checks = [*_checks(file), *trust.coefficients_check(notices)]
    return ev.Evidence(
        verb="map",
        title=f"Map of {file.robot}",
        verdict=ev.judged(answer(file), checks),
        checks=checks,
        tables=_tables(file),
        figures=_figures(file),
        notices=blocks.notices(notices),
        methods=_methods(file),
        references=REFERENCES,
        provenance=origin,
    )


# ------------------------------------------------------------ checks


def _checks(file: MapFile) -> list[ev.Check]:
    points = int(np.prod([len(axis.values) for axis in file.axes]))
    checks = [
        ev.check(
            "runs that broke down",
            f"{file.broken} of {points}",
            not file.broken,
            "none",
            "they are left empty" if file.broken else "",
        ),
        ev.check(
            "steady at the end of the run",
            f"{points - file.unsettled} of {points}",
            not file.unsettled,
            "speed changes by 0.5 % a beat or less",
            "" if not file.unsettled else "speeds are those after --duration-s from rest, not steady ones",
        ),
        _region_check(file),
    ]
    if "mean_surge_from_start_m_s" in file.quantities:
        surge = [v for row in file.quantities["mean_surge_from_start_m_s"].values for v in row]
        checks += trust.forwards_check(surge)
    known = any(q.stderr is not None for q in file.quantities.values())
    checks.append(
        ev.check(
            "uncertainty of the map",
            "from the coefficients' covariance" if known else "not known",
            None,
            text="" if known else "give a parameter file with standard errors: --params",
        )
    )
    off = _residuals(file)
    if len(off):
        value = f"{numbers.number(float(np.sqrt(np.mean(off**2))), 3, 'm/s')} over {len(off)} trials"
        checks.append(ev.check("measured mean speeds, RMSE", value, None))
    if file.efficiency is not None:
        e = file.efficiency
        value = numbers.measured(e.value, e.stderr)
        checks.append(
            ev.check(
                "mechanical over electrical power", value, e.value <= 1.0, "≤ 1", f"of {e.trials} trials"
            )
        )
    return checks


def _region_check(file: MapFile) -> ev.Check:
    drive = {name: float(value) for name, value in file.drive.items() if name in BEAT | STROKE}
    axes = {axis.name: axis.values for axis in file.axes}
    return trust.region_check(
        {name: ends for name, ends in file.identified.items() if name in axes or name in BEAT | STROKE},
        [{**drive, **point} for point in grid.points_of(axes)],
    )


def _residuals(file: MapFile) -> Array:
    """Measured less simulated mean speed of every trial that has both, m/s."""
    return np.array(
        [
            m.measured_m_s - m.simulated_m_s
            for m in file.measured
            if m.measured_m_s is not None and m.simulated_m_s is not None
        ]
    )


# ------------------------------------------------------------ in words


def best(file: MapFile, name: str) -> tuple[float, list[tuple[Axis, float]], bool] | None:
    """The best value of a quantity, where it lies on the axes, and whether that is on the map's edge."""
    if name not in file.quantities:
        return None
    values = np.array(file.quantities[name].values, dtype=float)
    if not np.isfinite(values).any():
        return None
    at = np.unravel_index(int((np.nanargmax if name in LARGEST else np.nanargmin)(values)), values.shape)
    where = [(axis, axis.values[i]) for axis, i in zip(file.axes, at, strict=False)]
    edge = any(i in (0, len(axis.values) - 1) for axis, i in zip(file.axes, at, strict=False))
    return float(values[at]), where, edge


def _best_text(file: MapFile, name: str, word: str) -> str:
    found = best(file, name)
    if found is None:
        return ""
    value, where, edge = found
    unit = file.quantities[name].unit
    place = ", ".join(f"{axis.name} {numbers.number(at, 3)}" for axis, at in where)
    rim = ", on the edge of the map" if edge else ""
    return f"{word} {numbers.number(value, 3, unit)} at {place}{rim}"


def answer(file: MapFile) -> str:
    """The best points, as a sentence."""
    parts = [
        _best_text(file, "mean_speed_m_s", "fastest"),
        _best_text(file, "cost_of_transport_J_m", "cheapest"),
    ]
    text = "; ".join(part for part in parts if part) or "Mapped"
    return f"{text[0].upper()}{text[1:]}."


def summary(file: MapFile, evidence: ev.Evidence) -> str:
    """Plain text for the terminal."""
    axes = ", ".join(
        f"{a.name} {numbers.number(a.values[0])} to {numbers.number(a.values[-1])} ({len(a.values)})"
        for a in file.axes
    )
    lines = [f"{file.robot}, {file.params or 'the robot file'}: {axes}", ""]
    drawn = [(name, file.quantities[name]) for name in DRAWN if name in file.quantities]
    width = max((len(numbers.split_unit(name)[0]) for name, _ in drawn), default=0)
    for name, q in drawn:
        factor, unit = numbers.in_degrees(q.unit)
        values = factor * np.array(q.values, dtype=float)
        text = numbers.interval(float(np.nanmin(values)), float(np.nanmax(values)), None, unit)
        lines.append(f"  {numbers.split_unit(name)[0].replace('_', ' '):<{width}}  {text}")
    for m in file.measured:
        if m.measured_m_s is not None and m.simulated_m_s is not None:
            place = ", ".join(f"{name} {numbers.number(at, 3)}" for name, at in m.at.items())
            off = numbers.number(m.measured_m_s - m.simulated_m_s, 2, "m/s")
            lines.append(
                f"  {m.trial} ({place}): measured {numbers.number(m.measured_m_s, 3, 'm/s')}, off {off}"
            )
    lines += ["", f"  {answer(file)}", f"{evidence.verdict.level.upper()}: {blocks.judgement(evidence)}"]
    return "\n".join(lines)


# ------------------------------------------------------------ tables


def _tables(file: MapFile) -> list[ev.Table]:
    tables = []
    first = file.axes[0]
    if len(file.axes) == 2 and "mean_speed_m_s" in file.quantities:
        tables.append(_ridge(file))
    if file.measured:
        rows: list[dict[str, blocks.Cell]] = [
            {
                "trial": m.trial,
                "role": "held out" if m.role == "validate" else "fit",
                **{name: numbers.number(at) for name, at in m.at.items()},
                "measured": numbers.number(m.measured_m_s, 3, "m/s"),
                "simulated": numbers.number(m.simulated_m_s, 3, "m/s"),
                "electrical": numbers.number(m.electrical_W, 3, "W"),
                "joints": numbers.number(m.mechanical_W, 3, "W"),
                "inside the map": m.inside,
            }
            for m in file.measured
        ]
        caption = (
            "Mean speed over the last beats of log and simulation of the trial itself, by one rule; "
            "electrical power by voltage and current, and what the joints of the simulation give there."
        )
        tables.append(blocks.table("measured", "Measured trials on the map", rows, caption))
    if len(file.axes) == 1:
        rows = [
            {
                first.name: numbers.number(at),
                **{name: _cell(q, k, 0) for name, q in file.quantities.items() if name in DRAWN},
            }
            for k, at in enumerate(first.values)
        ]
        tables.append(blocks.table("points", "Points of the map", rows))
    return tables


def _cell(q: Mapped, row: int, column: int) -> str:
    factor, unit = numbers.in_degrees(q.unit)
    value = q.values[row][column]
    if value is None:
        return numbers.NOTHING
    error = None if q.stderr is None else q.stderr[row][column]
    if error:
        return numbers.measured(factor * value, factor * error, unit)
    return numbers.number(factor * value, 3, unit)


def _ridge(file: MapFile) -> ev.Table:
    """For each value of the first axis where on the second the robot is fastest, and where cheapest."""
    across = file.axes[1]
    rows = []
    for i, at in enumerate(file.axes[0].values):
        row: dict[str, blocks.Cell] = {file.axes[0].name: numbers.number(at)}
        for name, word in ((LARGEST[0], "fastest"), (LEAST[0], "cheapest")):
            if name not in file.quantities:
                continue
            values = np.array(file.quantities[name].values[i], dtype=float)
            if np.isfinite(values).any():
                j = int((np.nanargmax if name in LARGEST else np.nanargmin)(values))
                row[f"{word} at {across.name}"] = numbers.number(across.values[j])
                row[word] = _cell(file.quantities[name], i, j)
            else:
                row[f"{word} at {across.name}"] = row[word] = numbers.NOTHING
        rows.append(row)
    return blocks.table("ridge", f"Best {across.name} at each {file.axes[0].name}", rows)


# ------------------------------------------------------------ figures


def _figures(file: MapFile) -> list[ev.Figure]:
    drawn = [name for name in DRAWN if name in file.quantities]
    if len(file.axes) == 1:
        panels = [_curve(file, name) for name in drawn]
        return [blocks.panels("map", "Over the gait", _caption(file), panels, columns=2)]
    heats = [_heat(file, name) for name in drawn]
    contours = [_contours(file, name) for name in drawn]
    figures = [
        blocks.panels("map", "Over the grid of gaits", _caption(file), heats, columns=1),
        blocks.panels(
            "contours",
            "Contours",
            "Lines of equal value. Points: recorded trials. The frame is the range of the trials that the "
            "coefficients were identified from; outside it the map is extrapolation."
            if _region(file)
            else "Lines of equal value.",
            contours,
            columns=1,
        ),
    ]
    if "mean_speed_m_s" in drawn:
        figures.append(_slices(file))
    return figures


def _caption(file: MapFile) -> str:
    drive = ", ".join(f"{name} {value}" for name, value in file.drive.items())
    return f"Runs of {file.duration_s:g} s from rest, over their last whole beats; {drive}."


def _shown(file: MapFile, name: str) -> tuple[Array, str]:
    """A quantity in the unit it is drawn in, and its title."""
    factor, unit = numbers.in_degrees(file.quantities[name].unit)
    bare = numbers.split_unit(name)[0].replace("_", " ")
    printed = numbers.unit_text(unit)
    return factor * np.array(file.quantities[name].values, dtype=float), (
        f"{bare} ({printed})" if printed else bare
    )


def _heat(file: MapFile, name: str) -> ev.Panel:
    values, title = _shown(file, name)
    rows, columns = ([numbers.number(v, 3) for v in axis.values] for axis in file.axes)
    cells = [[float(f"{v:.3g}") for v in row] for row in values]
    heat = ev.Heat(rows=rows, columns=columns, values=cells, scale="linear")  # type: ignore[arg-type]
    down, along = (_axis_title(axis) for axis in file.axes)
    return blocks.panel(along, down, [], title=title, heat=heat)


def _axis_title(axis: Axis) -> str:
    """What a coefficient is called is no column: ``K_s`` has no seconds."""
    if axis.name in BEAT | STROKE:
        return numbers.column_title(axis.name)
    unit = numbers.unit_text(axis.unit)
    return f"{axis.name} ({unit})" if unit else axis.name


def _contours(file: MapFile, name: str) -> ev.Panel:
    import contourpy

    values, title = _shown(file, name)
    down, along = file.axes
    finite = values[np.isfinite(values)]
    traces = []
    if np.ptp(finite) > 0:
        lines = contourpy.contour_generator(along.values, down.values, np.ma.masked_invalid(values))
        for k, level in enumerate(_levels(finite)):
            x: list[float] = []
            y: list[float] = []
            for line in lines.lines(level):
                points = np.asarray(line)
                x += [*points[:, 0].tolist(), np.nan]
                y += [*points[:, 1].tolist(), np.nan]
            if x:
                traces.append(ev.Trace(x=x, y=y, label=numbers.number(float(level), 3), group=k))
    traces += _region(file)
    shown = [m for m in file.measured if m.inside]
    if shown:
        traces.append(
            ev.Trace(
                x=[m.at[along.name] for m in shown],
                y=[m.at[down.name] for m in shown],
                style="points",
                label="trials",
                group=LEVELS + 2,
            )
        )
    return blocks.panel(_axis_title(along), _axis_title(down), traces, title=title)


def _levels(values: Array) -> Array:
    """Round levels between the smallest and the largest value."""
    from matplotlib.ticker import MaxNLocator

    ticks = np.asarray(MaxNLocator(LEVELS).tick_values(float(values.min()), float(values.max())))
    return np.asarray(ticks[(ticks > values.min()) & (ticks < values.max())])


def _region(file: MapFile) -> list[ev.Trace]:
    if not all(axis.name in file.identified for axis in file.axes):
        return []
    (x0, x1), (y0, y1) = (file.identified[axis.name] for axis in reversed(file.axes))
    label = "identified inside"
    if x0 == x1 and y0 == y1:
        return [ev.Trace(x=[x0], y=[y0], style="points", label=label, group=LEVELS + 1)]
    return [
        ev.Trace(
            x=[x0, x1, x1, x0, x0],
            y=[y0, y0, y1, y1, y0],
            style="dashed",
            label=label,
            group=LEVELS + 1,
        )
    ]


def _curve(file: MapFile, name: str) -> ev.Panel:
    values, title = _shown(file, name)
    axis, q = file.axes[0], file.quantities[name]
    x, y = np.array(axis.values), values[:, 0]
    factor, _ = numbers.in_degrees(q.unit)
    if q.stderr is not None:
        traces = [blocks.band(x, y, 2 * factor * np.array(q.stderr, dtype=float)[:, 0], label="model, 2 sd")]
    else:
        traces = [ev.Trace(x=x, y=y, label="model")]
    traces += _measured_speeds(file, name)
    spans = []
    if axis.name in file.identified:
        low, high = file.identified[axis.name]
        spans = [ev.Span(start=low, end=high, label="range of the identification trials")]
    return blocks.panel(_axis_title(axis), title, traces, spans=spans)


def _measured_speeds(file: MapFile, name: str) -> list[ev.Trace]:
    axis = file.axes[0]
    shown = [m for m in file.measured if m.measured_m_s is not None]
    if name != "mean_speed_m_s" or not shown:
        return []
    return [blocks.points(shown, lambda m: m.at[axis.name], lambda m: m.measured_m_s, label="measured")]


def _slices(file: MapFile) -> ev.Figure:
    """Speed over the second axis at a few values of the first, and the measured speeds of nearby trials."""
    values, title = _shown(file, "mean_speed_m_s")
    down, along = file.axes
    rows = np.unique(np.linspace(0, len(down.values) - 1, min(len(down.values), 5)).astype(int))
    traces = []
    for k, i in enumerate(rows):
        label = f"{down.name} {numbers.number(down.values[i], 3)}"
        traces.append(ev.Trace(x=along.values, y=values[i], label=label, group=k))
    panels = [blocks.panel(_axis_title(along), title, traces)]
    shown = [m for m in file.measured if m.measured_m_s is not None and m.simulated_m_s is not None]
    if shown:
        off = [m.measured_m_s - m.simulated_m_s for m in shown]  # type: ignore[operator]
        trace = ev.Trace(x=[m.measured_m_s for m in shown], y=off, style="points")
        x, y = "measured mean speed (m/s)", "measured less simulated (m/s)"
        panels.append(blocks.panel(x, y, [trace], marks=[ev.Mark(at=0.0)]))
    return blocks.panels(
        "slices", "Speed along the map, and what was measured", "", panels, columns=len(panels)
    )


def _methods(file: MapFile) -> list[str]:
    axes = " and ".join(f"{a.name} ({len(a.values)} values)" for a in file.axes)
    sentences = [
        f"The gait of {file.robot} was varied over {axes}; each run of {file.duration_s:g} s began at rest "
        "and was judged by its last whole beats. The power of the driven joints is that of their torques, by "
        "inverse dynamics of the simulated motion; the cost of transport is mean positive power over speed."
    ]
    if any(q.stderr is not None for q in file.quantities.values()):
        sentences.append("Standard deviations follow from the coefficients' covariance by the delta method.")
    return sentences
