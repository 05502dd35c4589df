"""Figures of ``swimid diagnose``."""

from __future__ import annotations

import math
import re
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from swimid.diagnosis import summary as words
from swimid.diagnosis.gap_file import Cell, GapFile
from swimid.fitting.model import Array
from swimid.results import blocks, numbers
from swimid.results import evidence as ev

#: Effects, panels and sketches drawn; rows of a heat map.
MOST_EFFECTS, MOST_PANELS, MOST_SKETCHES, MOST_ROWS = 10, 4, 6, 24
#: Points of a curve.
_POINTS = 800

_ALONE = ev.Mark(at=1.0, label="noise alone")


@dataclass(frozen=True)
class Overlay:
    """One channel of a held-out trial: measured, simulated before and after."""

    trial: str
    channel: str
    unit: str
    time_s: Array
    measured: Array
    before: Array
    after: Array


@dataclass(frozen=True)
class Drawings:
    """What a gap file has no room for.

    Attributes
    ----------
    maps : mapping of title to (row labels, column labels, ratios)
        Heat maps of root-mean-square residual over floor: trial by channel, phase by trial ...
    forces : mapping of place to (mapping of term to float)
        Smooth forces (N) and moments (N m) that the model lacks, as :class:`swimid.diagnosis.remainder.Left`
        has them.
    """

    maps: Mapping[str, tuple[list[str], list[str], Array]] = field(default_factory=dict)
    overlays: Sequence[Overlay] = ()
    forces: Mapping[str, Mapping[str, float]] = field(default_factory=dict)


def figures(file: GapFile, drawings: Drawings) -> list[ev.Figure]:
    """Return the figures: what closes the gap, by how much, where the gap is, and what remains."""
    return [
        *_shrinkage(file),
        *_ranked(file),
        *_maps(drawings.maps),
        *_parts(file),
        *_overlays(drawings.overlays, bool(file.causes)),
        *_sketches(drawings.forces),
    ]


def _figure(id: str, title: str, caption: str, panels: Sequence[ev.Panel]) -> list[ev.Figure]:
    """A figure of panels two abreast, where there are any."""
    return [blocks.panels(id, title, caption, panels, min(len(panels), 2))] if panels else []


# ---------------------------------------------------------------- where


def _maps(maps: Mapping[str, tuple[list[str], list[str], Array]]) -> list[ev.Figure]:
    panels, cut = [], False
    for title, (rows, columns, ratios) in maps.items():
        if len(columns) > len(rows):
            rows, columns, ratios = columns, rows, ratios.T
        if len(rows) > MOST_ROWS:
            cut = True
            worst = np.argsort(-np.nan_to_num(ratios, nan=-1.0).max(axis=1), kind="stable")
            kept = np.sort(worst[:MOST_ROWS])
            rows, ratios = [rows[k] for k in kept], ratios[kept]
        heat = ev.Heat(rows=rows, columns=columns, values=list(ratios))
        panels.append(
            blocks.panel("", "root-mean-square residual over the noise", [], title=title, heat=heat)
        )
    few = f" The {MOST_ROWS} worst rows are shown where there are more." if cut else ""
    caption = (
        "Residual of the refitted model without any effect, in units of the noise. 1 is noise "
        "alone and not shaded; the shade grows with the logarithm. Good: every number near 1. A row or "
        "column that stands out says which trials, channels or part of the stroke the model lacks "
        f"something in.{few}"
    )
    return [blocks.panels("gap-map", "Where the gap is", caption, panels, 1)] if panels else []


def _parts(file: GapFile) -> list[ev.Figure]:
    groups: dict[str, list[Cell]] = {}
    for part in (file.where.regime, file.where.phase, file.where.time):
        for cell in sorted(part, key=lambda c: -(c.share or 0.0)):
            groups.setdefault(cell.kind, []).append(cell)
    return _figure(
        "gap-parts",
        "The gap over settings, phase and time",
        "Root-mean-square residual over the noise in each part of the data. Good: all near the "
        "line at 1. Growth with a setting tells what drives the gap.",
        [_part(kind, sorted(cells, key=_order)) for kind, cells in groups.items() if len(cells) > 1],
    )


def _order(cell: Cell) -> tuple[float, str]:
    """Parts by the number they begin with, those without one first."""
    found = re.match(r"[-−]?\d*\.?\d+", cell.label)
    return (float(found[0].replace("−", "-")) if found else -math.inf, cell.label)


def _part(kind: str, cells: Sequence[Cell]) -> ev.Panel:
    bars = ev.Trace(x=list(range(len(cells))), y=[c.ratio for c in cells], style="bars")
    names = [c.label for c in cells]
    return blocks.panel("", "residual over the noise", [bars], title=kind, x_categories=names, marks=[_ALONE])


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
        blocks.figure(
            "effects",
            "What each effect gains in approximate cross-validation",
            f"Drop of the squared residuals in units of the noise, with one standard error; the best "
            f"{len(shown)} of {len(file.scores)} effects, each alone. Good: one effect far above all others.",
            "",
            "held-out gain",
            traces,
            x_categories=[s.effect for s in shown],
        )
    ]


def _shrinkage(file: GapFile) -> list[ev.Figure]:
    found = [s for s in file.closing if s.before is not None and s.after is not None]
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
        blocks.figure(
            "shrinkage",
            "Errors before and after",
            f"Root-mean-square error over the range that all trials measure, {words.held_out_text(file)}. "
            "Good: with the causes it comes down to the noise floor.",
            "",
            "error over the range of all trials (%)",
            traces,
            x_categories=[s.channel for s in found],
        )
    ]


def _overlays(overlays: Sequence[Overlay], closed: bool) -> list[ev.Figure]:
    trials: dict[str, list[Overlay]] = {}
    for overlay in overlays:
        trials.setdefault(overlay.trial, []).append(overlay)
    held_out = "this trial was held out of the fit. Good: the"
    lines = (
        f"the model refitted without the causes dashed, with them solid; {held_out} solid line runs through "
        "the points, the dashed one beside them."
        if closed
        else f"lines the refitted model; {held_out} line runs through the points."
    )
    return [
        blocks.panels(
            f"overlay-{name}",
            f"{name}: before and after" if closed else f"{name}: measured and simulated",
            f"Points are measured, {lines}",
            [_overlay(o, closed) for o in parts[:MOST_PANELS]],
            1,
        )
        for name, parts in trials.items()
    ]


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
    return blocks.panel("time (s)", _label(name, unit), traces)


def _label(name: str, unit: str) -> str:
    return f"{name} ({numbers.unit_text(unit) or '1'})"


# ---------------------------------------------------------------- what is left


def _sketches(forces: Mapping[str, Mapping[str, float]]) -> list[ev.Figure]:
    panels = [
        blocks.panel(
            against,
            _label(place, "N m" if place.endswith("moment") else "N"),
            [curve],
            marks=[ev.Mark(at=0.0)],
        )
        for place, terms in forces.items()
        for against, curve in _curves(defaultdict(float, terms)).items()
    ]
    return _figure(
        "sketches",
        "The shape of what the model lacks",
        "The force, moment or sensor term that would have to be added to the refitted model, "
        "over what may drive it. Its shape hints at the physics: "
        "straight through zero over speed is linear drag, a constant is a trim or a current. Good: "
        "flat about zero.",
        panels[:MOST_SKETCHES],
    )


def _curves(factor: Mapping[str, float]) -> dict[str, ev.Trace]:
    """A smooth force over what may drive it, from the factors of its terms."""
    speed, time = np.linspace(-0.2, 1.0, 25), np.linspace(0.0, 1.0, 21)
    phase = np.linspace(0.0, 2.0 * np.pi, 49)
    of_phase = (
        factor["cos phase"] * np.cos(phase)
        + factor["sin phase"] * np.sin(phase)
        + factor["cos 2 phase"] * np.cos(2 * phase)
        + factor["sin 2 phase"] * np.sin(2 * phase)
    )
    of_speed = factor["constant"] + factor["speed"] * speed + factor["speed squared"] * speed * np.abs(speed)
    return {
        _label("phase", "deg"): ev.Trace(x=np.degrees(phase), y=of_phase),
        _label("speed over the fastest mean speed", "1"): ev.Trace(x=speed, y=of_speed),
        _label("time over the trial's length", "1"): ev.Trace(
            x=time, y=factor["constant"] + factor["time"] * time
        ),
    }
