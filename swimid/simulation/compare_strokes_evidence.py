"""Tables and figures of motion profiles: those of the sea lion paper's validation."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from swimid.fitting.model import Array
from swimid.results import evidence as ev
from swimid.results import numbers
from swimid.simulation.compare_strokes import Mean, Profile
from swimid.simulation.comparison_file import ProfileComparison

#: The paper's two tables: quantity, heading, unit shown.
VELOCITY = (("max_speed_m_s", "max. speed", "m/s"), ("mean_speed_m_s", "mean speed", "m/s"))
ANGULAR = (
    ("final_pitch_rad", "final pitch", "deg"),
    ("max_pitch_rate_rad_s", "max. rate", "deg/s"),
    ("mean_pitch_rate_rad_s", "mean rate", "deg/s"),
)
WAY = (("surge_m", "surge", "m"), ("heave_m", "heave", "m"))
#: Figures of a profile, as the paper draws them.
DRAWN = (
    ("position", ("x_m", "z_m")),
    ("speed", ("speed_m_s",)),
    ("orientation", ("pitch_rad", "roll_rad", "yaw_rad")),
    ("angular rate", ("pitch_rate_rad_s",)),
)


def tables(profiles: Sequence[ProfileComparison]) -> list[ev.Table]:
    """Distances and errors of every profile, then speeds, angles and ways of every stroke."""
    if not profiles:
        return []
    found = [_errors(profiles)]
    stroked = [p for p in profiles if p.cycles]
    if stroked:
        found.append(_by_cycle("cycle-velocity", "Speed in each stroke", VELOCITY, stroked, "Table I"))
        found.append(
            _by_cycle("cycle-angles", "Pitch and pitch rate in each stroke", ANGULAR, stroked, "Table II")
        )
        found.append(_by_cycle("cycle-way", "Way made in each stroke", WAY, stroked, "Figs 3 and 5"))
    return found


def _shown(value: float | None, unit: str) -> float | None:
    return math.degrees(value) if value is not None and unit.startswith("deg") else value


def _errors(profiles: Sequence[ProfileComparison]) -> ev.Table:
    rows: list[list[str | float | int | bool | None]] = []
    for p in profiles:
        row: list[str | float | int | bool | None] = [p.name, len(p.trials)]
        for way in (p.surge_m, p.heave_m):
            measured, simulated = way.get("measured"), way.get("simulated")
            row += [numbers.number(v, 3, "m") for v in (measured, simulated)]
            share = (simulated - measured) / abs(measured) if measured and simulated is not None else None
            row.append(numbers.percent(share, 2))
        row.append(numbers.number(p.position_rmse_m, 3, "m"))
        row.append(numbers.number(_shown(p.orientation_rmse_rad, "deg"), 3, "deg"))
        rows.append(row)
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


def _by_cycle(
    name: str,
    title: str,
    quantities: Sequence[tuple[str, str, str]],
    profiles: Sequence[ProfileComparison],
    source: str,
) -> ev.Table:
    most = max(len(p.cycles) for p in profiles)
    rows: list[list[str | float | int | bool | None]] = []
    for p in profiles:
        for side in ("measured", "simulated"):
            row: list[str | float | int | bool | None] = [p.name, side]
            for k in range(most):
                for key, _, unit in quantities:
                    if k >= len(p.cycles):
                        row.append(numbers.NOTHING)
                        continue
                    cycle = p.cycles[k]
                    value = _shown(getattr(cycle, side).get(key), unit)
                    spread = _shown(cycle.spread.get(key), unit) if side == "measured" else None
                    row.append(
                        numbers.measured(value, spread) if value is not None and spread
                        else numbers.number(value, 3)
                    )  # fmt: skip
            rows.append(row)
    heads = [
        f"{k + 1}: {head} ({numbers.unit_text(unit)})" for k in range(most) for _, head, unit in quantities
    ]
    return ev.Table(
        id=name,
        title=title,
        columns=["profile", "", *heads],
        rows=rows,
        caption=f"As {source} of the sea lion paper, stroke by stroke. Where a motion was repeated: the mean "
        "and the standard deviation of the trials. Largest speeds and rates that are derived from noisy "
        "positions come out too large by up to a few standard deviations of their noise; those of a smoothed "
        "track do not.",
    )


def figures(profiles: Sequence[Profile], buoyancy: float) -> list[ev.Figure]:
    """Position, speed, pitch and pitch rate of every profile, and the tables as a figure."""
    found = []
    stroked = [p for p in profiles if p.record.cycles]
    if stroked:
        found.append(_cycle_figure(stroked))
    return [*found, *(f for p in profiles for f in _profile_figure(p, buoyancy))]


def _profile_figure(profile: Profile, buoyancy: float) -> list[ev.Figure]:
    panels = []
    for _, names in DRAWN:
        panels += [_panel(profile.means[n]) for n in names if n in profile.means and _moves(profile.means[n])]
    if not panels:
        return []
    repeats = len(profile.trials)
    said = f"Points: mean of {repeats} trials with their standard deviation." if repeats > 1 else ""
    band = any(m.band is not None for m in profile.means.values())
    if band:
        said += f" Shaded: simulated with {100 * buoyancy:g} % less to {100 * buoyancy:g} % more buoyancy."
    return [
        ev.Figure(
            id=f"profile-{profile.name}",
            title=f"{profile.name}: mean measured and simulated motion",
            caption=f"{said} Good: the line runs through the points; a gap wider than the shade is not "
            "explained by trim.".strip(),
            columns=2,
            panels=panels,
        )
    ]


def _moves(mean: Mean) -> bool:
    """Whether there is anything to see: a symmetric stroke has neither roll nor yaw."""
    values = mean.measured[np.isfinite(mean.measured)]
    return bool(len(values)) and float(np.ptp(values)) > 1e-9


def _panel(mean: Mean) -> ev.Panel:
    turned = mean.unit.startswith("rad")
    scale, unit = (180.0 / math.pi, f"deg{mean.unit[3:]}") if turned else (1.0, mean.unit)
    step = max(len(mean.time_s) // 150, 1)

    def at(values: Array) -> Array:
        return scale * values[::step]

    seen = np.isfinite(at(mean.spread))
    points = ev.Trace(
        x=mean.time_s[::step],
        y=at(mean.measured),
        style="points",
        label="measured",
        group=0,
        y_error=np.where(seen, at(mean.spread), 0.0) if seen.any() else None,
    )
    line = ev.Trace(
        x=mean.time_s[::step],
        y=at(mean.simulated),
        label="simulated",
        group=1,
        lower=None if mean.band is None else at(mean.band[0]),
        upper=None if mean.band is None else at(mean.band[1]),
    )
    return ev.Panel(
        x_label="time (s)", y_label=f"{mean.meaning} ({numbers.unit_text(unit)})", traces=[points, line]
    )


def _cycle_figure(profiles: Sequence[Profile]) -> ev.Figure:
    panels = []
    strokes = [str(k + 1) for k in range(max(len(p.record.cycles) for p in profiles))]
    for key, head, unit in (*VELOCITY, *ANGULAR, *WAY):
        traces = []
        for group, p in enumerate(profiles):
            cycles = [c for c in p.record.cycles if key in c.measured]
            x = np.array([c.cycle - 1.0 for c in cycles])
            scale = 180.0 / math.pi if unit.startswith("deg") else 1.0
            measured, simulated, spread = (
                scale * np.array([float(side.get(key) or 0.0) for side in sides])
                for sides in zip(*((c.measured, c.simulated, c.spread) for c in cycles), strict=True)
            ) if cycles else (x, x, x)  # fmt: skip
            label = p.name
            traces.append(
                ev.Trace(
                    x=x, y=measured, style="points", label=f"{label}, measured", group=group,
                    y_error=spread if spread.any() else None,
                )
            )  # fmt: skip
            traces.append(ev.Trace(x=x, y=simulated, label=f"{label}, simulated", group=group))
        panels.append(
            ev.Panel(
                x_label="stroke",
                y_label=f"{head} ({numbers.unit_text(unit)})",
                traces=traces,
                x_categories=strokes,
            )
        )
    return ev.Figure(
        id="cycles",
        title="Stroke by stroke",
        caption="Points: mean of the trials with their standard deviation; lines: simulated. Good: the lines "
        "pass through the points within their bars.",
        columns=2,
        panels=panels,
    )


def methods(profiles: Sequence[Profile], buoyancy: float) -> list[str]:
    """How the means and the band were made."""
    if not profiles:
        return []
    said = []
    if any(len(p.trials) > 1 for p in profiles):
        said.append("Trials that repeat a motion were averaged on one clock, and so were their simulations.")
    if any(m.band is not None for p in profiles for m in p.means.values()):
        said.append(
            f"The band of the simulations is that of {100 * buoyancy:g} % less and more displaced volume, "
            "all else held (sea lion, section III)."
        )
    return said


def summary(profiles: Sequence[ProfileComparison]) -> list[str]:
    """A line for each profile."""
    if not profiles:
        return []
    width = max(len(p.name) for p in profiles)
    lines = ["", "  motion profiles: surge and heave measured, simulated; RMSE of position and orientation"]
    for p in profiles:
        pairs = [(way.get("measured"), way.get("simulated")) for way in (p.surge_m, p.heave_m)]
        ways = "  ".join(f"{numbers.number(v, 3, 'm'):>10}" for pair in pairs for v in pair)
        errors = (
            f"{numbers.number(p.position_rmse_m, 3, 'm')}, "
            f"{numbers.number(_shown(p.orientation_rmse_rad, 'deg'), 3, 'deg')}"
        )
        lines.append(f"  {p.name:<{width}}  {ways}  {errors}")
    return lines
