"""Tables and figures of motion profiles: those of the sea lion paper's validation."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from swimid.fitting.model import Array
from swimid.results import blocks, numbers
from swimid.results import evidence as ev
from swimid.simulation.compare_strokes import SIDES, Mean, Profile
from swimid.simulation.comparison_file import ProfileComparison
from swimid.swimmer.stroke_cycles import QUANTITIES

#: Headings of the quantities of a stroke.
HEADINGS = {
    "max_speed_m_s": "max. speed",
    "mean_speed_m_s": "mean speed",
    "final_pitch_rad": "final pitch",
    "max_pitch_rate_rad_s": "max. rate",
    "mean_pitch_rate_rad_s": "mean rate",
    "surge_m": "surge",
    "heave_m": "heave",
}
#: Tables by stroke: id, title, how their quantities end, and where the paper has them.
BY_STROKE = (
    ("cycle-velocity", "Speed in each stroke", ("speed_m_s",), "Table I"),
    ("cycle-angles", "Pitch and pitch rate in each stroke", ("pitch_rad", "pitch_rate_rad_s"), "Table II"),
    ("cycle-way", "Way made in each stroke", ("surge_m", "heave_m"), "Figs 3 and 5"),
)
#: Channels of a profile's figure, in the paper's order.
DRAWN = ("x_m", "z_m", "speed_m_s", "pitch_rad", "roll_rad", "yaw_rad", "pitch_rate_rad_s")
#: Samples of a channel in it.
MAX_SAMPLES = 150


def tables(profiles: Sequence[ProfileComparison]) -> list[ev.Table]:
    """Distances and errors of every profile, then speeds, angles and ways of every stroke."""
    tables = [_errors(profiles)] if profiles else []
    stroked = [p for p in profiles if p.cycles]
    if stroked:
        tables += [_by_stroke(id, title, ends, source, stroked) for id, title, ends, source in BY_STROKE]
    return tables


def _degrees(value: float | None) -> str:
    return numbers.number(None if value is None else numbers.in_degrees("rad")[0] * value, 3, "deg")


def _errors(profiles: Sequence[ProfileComparison]) -> ev.Table:
    rows: list[list[blocks.Cell]] = []
    for p in profiles:
        row: list[blocks.Cell] = [p.name, len(p.trials)]
        for way in (p.surge_m, p.heave_m):
            measured, simulated = way.get("measured"), way.get("simulated")
            share = (simulated - measured) / abs(measured) if measured and simulated is not None else None
            row += [numbers.number(v, 3, "m") for v in (measured, simulated)]
            row.append(numbers.percent(share, 2))
        rows.append([*row, numbers.number(p.position_rmse_m, 3, "m"), _degrees(p.orientation_rmse_rad)])
    return ev.Table(
        id="profiles",
        title="Motion profiles",
        columns=[
            "profile", "trials", "surge, measured", "simulated", "off", "heave, measured", "simulated", "off",
            "position RMSE", "orientation RMSE",
        ],
        rows=rows,
        caption="Means of the trials that repeat a motion: distance from the first sample to the last, and "
        "root-mean-square distance of the mean simulated path and angles from the mean measured ones.",
    )  # fmt: skip


def _by_stroke(
    id: str, title: str, endings: tuple[str, ...], source: str, profiles: Sequence[ProfileComparison]
) -> ev.Table:
    names = [name for name in HEADINGS if name.endswith(endings)]
    most = max(len(p.cycles) for p in profiles)
    rows = []
    for p in profiles:
        for side in SIDES:
            row: dict[str, blocks.Cell] = {"profile": p.name, "": side}
            for k in range(most):
                for name in names:
                    factor, unit = numbers.in_degrees(QUANTITIES[name])
                    value = getattr(p.cycles[k], side).get(name) if k < len(p.cycles) else None
                    spread = p.cycles[k].spread.get(name) if value is not None and side == SIDES[0] else None
                    row[f"{k + 1}: {HEADINGS[name]} ({numbers.unit_text(unit)})"] = (
                        numbers.measured(factor * value, factor * spread)
                        if value is not None and spread
                        else numbers.number(None if value is None else factor * value, 3)
                    )
            rows.append(row)
    caption = (
        f"As {source} of the sea lion paper, stroke by stroke. Where a motion was repeated: the mean "
        "and the standard deviation of the trials. Largest speeds and rates that are derived from noisy "
        "positions come out too large by up to a few standard deviations of their noise; those of a smoothed "
        "track do not."
    )
    return blocks.table(id, title, rows, caption)


def figures(profiles: Sequence[Profile], buoyancy: float) -> list[ev.Figure]:
    """The tables as a figure, then position, speed, pitch and pitch rate of every profile."""
    stroked = [p.record for p in profiles if p.record.cycles]
    figures = [_stroke_figure(stroked)] if stroked else []
    return [*figures, *(f for p in profiles for f in _profile_figure(p, buoyancy))]


def _profile_figure(profile: Profile, buoyancy: float) -> list[ev.Figure]:
    means, record = profile
    panels = [_panel(means[n]) for n in DRAWN if n in means and _moves(means[n])]
    if not panels:
        return []
    repeats = len(record.trials)
    legend = f"Points: mean of {repeats} trials with their standard deviation." if repeats > 1 else ""
    if any(m.band is not None for m in means.values()):
        legend += f" Shaded: simulated with {100 * buoyancy:g} % less to {100 * buoyancy:g} % more buoyancy."
    return [
        blocks.panels(
            f"profile-{record.name}",
            f"{record.name}: mean measured and simulated motion",
            f"{legend} Good: the line runs through the points; a gap wider than the shade is not "
            "explained by trim.".strip(),
            panels,
        )
    ]


def _moves(mean: Mean) -> bool:
    """Whether there is anything to see: a symmetric stroke has neither roll nor yaw."""
    values = mean.measured[np.isfinite(mean.measured)]
    return bool(len(values)) and float(np.ptp(values)) > 1e-9


def _panel(mean: Mean) -> ev.Panel:
    scale, unit = numbers.in_degrees(mean.channel.unit)
    step = max(len(mean.time_s) // MAX_SAMPLES, 1)

    def at(values: Array) -> Array:
        return scale * values[::step]

    spread, time = at(mean.spread), mean.time_s[::step]
    error = np.nan_to_num(spread) if np.isfinite(spread).any() else None
    low, high = (None, None) if mean.band is None else (at(end) for end in mean.band)
    points = ev.Trace(x=time, y=at(mean.measured), style="points", label="measured", group=0, y_error=error)
    line = ev.Trace(x=time, y=at(mean.simulated), label="simulated", group=1, lower=low, upper=high)
    y_label = f"{mean.channel.meaning} ({numbers.unit_text(unit)})"
    return blocks.panel("time (s)", y_label, [points, line])


def _stroke_figure(profiles: Sequence[ProfileComparison]) -> ev.Figure:
    panels = []
    strokes = [str(k + 1) for k in range(max(len(p.cycles) for p in profiles))]
    for name, heading in HEADINGS.items():
        scale, unit = numbers.in_degrees(QUANTITIES[name])
        traces = []
        for group, p in enumerate(profiles):
            cycles = [c for c in p.cycles if name in c.measured]
            x = np.array([c.cycle - 1.0 for c in cycles])
            measured, simulated, spread = (
                scale * np.array([float(getattr(c, side).get(name) or 0.0) for c in cycles])
                for side in (*SIDES, "spread")
            )
            error = spread if spread.any() else None
            label = f"{p.name}, measured"
            traces.append(ev.Trace(x=x, y=measured, style="points", label=label, group=group, y_error=error))
            traces.append(ev.Trace(x=x, y=simulated, label=f"{p.name}, simulated", group=group))
        y_label = f"{heading} ({numbers.unit_text(unit)})"
        panels.append(blocks.panel("stroke", y_label, traces, x_categories=strokes))
    return blocks.panels(
        "cycles",
        "Stroke by stroke",
        "Points: mean of the trials with their standard deviation; lines: simulated. Good: the lines "
        "pass through the points within their bars.",
        panels,
    )


def methods(profiles: Sequence[Profile], buoyancy: float) -> list[str]:
    """How the means and the band were made."""
    sentences = []
    if any(len(p.record.trials) > 1 for p in profiles):
        sentences.append(
            "Trials that repeat a motion were averaged on one clock, and so were their simulations."
        )
    if any(m.band is not None for p in profiles for m in p.means.values()):
        sentences.append(
            f"The band of the simulations is that of {100 * buoyancy:g} % less and more displaced volume, "
            "all else held (sea lion, section III)."
        )
    return sentences


def summary(profiles: Sequence[ProfileComparison]) -> list[str]:
    """A line for each profile."""
    if not profiles:
        return []
    width = max(len(p.name) for p in profiles)
    lines = ["", "  motion profiles: surge and heave measured, simulated; RMSE of position and orientation"]
    for p in profiles:
        pairs = [(way.get("measured"), way.get("simulated")) for way in (p.surge_m, p.heave_m)]
        ways = "  ".join(f"{numbers.number(v, 3, 'm'):>10}" for pair in pairs for v in pair)
        errors = f"{numbers.number(p.position_rmse_m, 3, 'm')}, {_degrees(p.orientation_rmse_rad)}"
        lines.append(f"  {p.name:<{width}}  {ways}  {errors}")
    return lines
