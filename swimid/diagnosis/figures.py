"""Figures of ``swimid diagnose``."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

import numpy as np

from swimid.diagnosis import summary as words
from swimid.diagnosis.gap_file import GapFile
from swimid.diagnosis.result import Cell, Gap, Overlay, Sketch
from swimid.results import evidence as ev
from swimid.results import numbers

#: Effects, trials, panels and sketches drawn; rows of a heat map.
MOST_EFFECTS, MOST_TRIALS, MOST_PANELS, MOST_SKETCHES, MOST_ROWS = 10, 6, 4, 6, 24
#: Points of a curve.
_POINTS = 800

_ALONE = ev.Mark(at=1.0, label="noise alone")


def figures(gap: Gap, file: GapFile) -> list[ev.Figure]:
    """Where the gap is, what closes it, and what is left."""
    found = [*_maps(gap), *_parts(gap)]
    found += (
        _ranked(file) + _shrinkage(file) + _overlays(gap.overlays, bool(gap.causes)) + _sketches(gap.sketches)
    )
    return found


# ---------------------------------------------------------------- where


def _maps(gap: Gap) -> list[ev.Figure]:
    panels, cut = [], False
    for title, (rows, columns, values) in gap.maps.items():
        ratios = np.asarray(values, dtype=float)
        if ratios.size == 0:
            continue
        if len(columns) > len(rows):
            rows, columns, ratios = columns, rows, ratios.T
        if len(rows) > MOST_ROWS:
            cut = True
            worst = np.argsort(-np.nan_to_num(ratios, nan=-1.0).max(axis=1), kind="stable")[:MOST_ROWS]
            kept = np.sort(worst)
            rows, ratios = [rows[k] for k in kept], ratios[kept]
        panels.append(
            ev.Panel(
                title=title,
                x_label="",
                y_label="root-mean-square residual over the noise",
                heat=ev.Heat(rows=rows, columns=columns, values=list(ratios)),
            )
        )
    if not panels:
        return []
    few = f" The {MOST_ROWS} worst rows are shown where there are more." if cut else ""
    return [
        ev.Figure(
            id="gap-map",
            title="Where the gap is",
            caption="Residual of the refitted model without any effect, in units of the noise. 1 is noise "
            "alone and not shaded; the shade grows with the logarithm. Good: every number near 1. A row or "
            "column that stands out says which trials, channels or part of the stroke the model lacks "
            f"something in.{few}",
            panels=panels,
        )
    ]


def _parts(gap: Gap) -> list[ev.Figure]:
    groups: dict[str, list[Cell]] = {}
    for cell in (*gap.regime, *gap.phase, *gap.time):
        groups.setdefault(cell.kind, []).append(cell)
    panels = [_part(kind, sorted(cells, key=_order)) for kind, cells in groups.items() if len(cells) > 1]
    if not panels:
        return []
    return [
        ev.Figure(
            id="gap-parts",
            title="The gap over settings, phase and time",
            caption="Root-mean-square residual over the noise in each part of the data. Good: all near the "
            "line at 1. Growth with a setting tells what drives the gap.",
            panels=panels,
            columns=2 if len(panels) > 1 else 1,
        )
    ]


def _order(cell: Cell) -> tuple[float, str]:
    """Parts by the number they begin with, those without one first."""
    found = re.match(r"[-−]?\d*\.?\d+", cell.label)
    return (float(found[0].replace("−", "-")) if found else -math.inf, cell.label)


def _part(kind: str, cells: Sequence[Cell]) -> ev.Panel:
    return ev.Panel(
        title=kind,
        x_label="",
        y_label="residual over the noise",
        traces=[ev.Trace(x=list(range(len(cells))), y=[c.ratio for c in cells], style="bars")],
        x_categories=[c.label for c in cells],
        marks=[_ALONE],
    )


# ---------------------------------------------------------------- which


def _ranked(file: GapFile) -> list[ev.Figure]:
    shown = [s for s in file.scores if s.refitted and s.gain is not None][:MOST_EFFECTS]
    best = max((s.gain for s in shown if s.gain is not None), default=0.0)
    # another reading of the robot may lose millions
    shown = [s for s in shown if best <= 0 or s.gain is None or s.gain >= -best]
    if not shown:
        return []
    named = {c.effect for c in file.causes}
    alike = {name for c in file.causes for name in c.equivalent} - named
    groups: list[tuple[str, list[int]]] = [
        ("part of the answer", [k for k, s in enumerate(shown) if s.effect in named]),
        ("not to be told from it", [k for k, s in enumerate(shown) if s.effect in alike]),
        ("other effects", [k for k, s in enumerate(shown) if s.effect not in named | alike]),
    ]
    traces = [
        ev.Trace(
            x=places,
            y=[shown[k].gain for k in places],
            y_error=[shown[k].stderr for k in places],
            style="points",
            label=label,
        )
        for label, places in groups
        if places
    ]
    return [
        ev.Figure(
            id="effects",
            title="What each effect gains in approximate cross-validation",
            caption=f"Drop of the squared residuals in units of the noise, with one standard error; the best "
            f"{len(shown)} of {len(file.scores)} effects, each alone. Good: one effect far above all others.",
            panels=[
                ev.Panel(
                    x_label="",
                    y_label="held-out gain",
                    traces=traces,
                    x_categories=[s.effect for s in shown],
                )
            ],
        )
    ]


def _shrinkage(file: GapFile) -> list[ev.Figure]:
    found = [s for s in words.held_out(file) if s.before is not None and s.after is not None]
    if not found:
        return []
    series = [
        ("as given", [s.shipped for s in found]),
        ("refitted without", [s.before for s in found]),
        ("refitted with the causes", [s.after for s in found]),
        ("noise floor", [s.floor for s in found]),
    ]
    traces = [
        ev.Trace(
            x=list(range(len(found))),
            y=[None if v is None else 100.0 * v for v in values],
            style="bars",
            label=label,
        )
        for label, values in series
        if any(v is not None for v in values)
    ]
    return [
        ev.Figure(
            id="shrinkage",
            title="Errors before and after",
            caption=f"Root-mean-square error over the measured range, {words.held_out_text(file)}. "
            "Good: with the causes it comes down to the noise floor.",
            panels=[
                ev.Panel(
                    x_label="",
                    y_label="error over the measured range (%)",
                    traces=traces,
                    x_categories=[s.channel for s in found],
                )
            ],
        )
    ]


def _overlays(overlays: Sequence[Overlay], closed: bool) -> list[ev.Figure]:
    trials: dict[str, list[Overlay]] = {}
    for overlay in overlays:
        trials.setdefault(overlay.trial, []).append(overlay)
    # held-out trials are the ones that count
    order = sorted(trials, key=lambda t: not trials[t][0].held_out)[:MOST_TRIALS]
    missing = "" if len(order) == len(trials) else f" {len(order)} of {len(trials)} trials are shown."
    found = []
    for name in order:
        parts = trials[name][:MOST_PANELS]
        how = "held out of the fit" if parts[0].held_out else "part of the fit"
        lines = (
            "the model refitted without the causes dashed, with them solid; this trial was "
            f"{how}. Good: the solid line runs through the points, the dashed one beside them."
            if closed
            else f"lines the refitted model; this trial was {how}. Good: the line runs through the points."
        )
        found.append(
            ev.Figure(
                id=f"overlay-{name}",
                title=f"{name}: before and after" if closed else f"{name}: measured and simulated",
                caption=f"Points are measured, {lines}{missing}",
                panels=[_overlay(o, closed) for o in parts],
            )
        )
    return found


def _overlay(o: Overlay, closed: bool) -> ev.Panel:
    scale, unit = numbers.in_degrees(o.unit)
    traces = []
    styles = [("measured", o.measured, "points")]
    if closed:
        styles += [("without the causes", o.before, "dashed"), ("with the causes", o.after, "line")]
    else:
        styles.append(("refitted model", o.before, "line"))
    for k, (label, values, style) in enumerate(styles):
        x, y = ev.thinned(o.time_s, scale * np.asarray(values, dtype=float), _POINTS)
        traces.append(ev.Trace(x=x, y=y, style=style, label=label, group=k))  # type: ignore[arg-type]
    name = numbers.split_unit(o.channel)[0].replace("_", " ")
    return ev.Panel(x_label="time (s)", y_label=f"{name} ({numbers.unit_text(unit) or '1'})", traces=traces)


# ---------------------------------------------------------------- what is left


def _sketches(sketches: Sequence[Sketch]) -> list[ev.Figure]:
    shown = sorted(sketches, key=lambda s: -s.gain)[:MOST_SKETCHES]
    if not shown:
        return []
    panels = []
    for s in shown:
        y, error = np.asarray(s.y, dtype=float), np.nan_to_num(np.asarray(s.stderr, dtype=float))
        panels.append(
            ev.Panel(
                x_label=f"{s.against} ({numbers.unit_text(s.against_unit) or '1'})",
                y_label=f"{s.name} ({numbers.unit_text(s.unit) or '1'})",
                traces=[ev.Trace(x=s.x, y=y, lower=y - 2 * error, upper=y + 2 * error)],
                marks=[ev.Mark(at=0.0)],
            )
        )
    return [
        ev.Figure(
            id="sketches",
            title="The shape of what the model lacks",
            caption="The force, moment or sensor term that would have to be added to the refitted model, "
            "over what may drive it, with twice its standard error. Its shape hints at the physics: "
            "straight through zero over speed is linear drag, a constant is a trim or a current. Good: "
            "flat about zero.",
            panels=panels,
            columns=2 if len(panels) > 1 else 1,
        )
    ]
