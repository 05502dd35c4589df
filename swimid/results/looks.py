"""How the traces of a figure are told apart, by colour and by something else, and the legend."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from matplotlib.axes import Axes

from swimid.results.evidence import Figure, Panel, Trace

#: Colours that stand for a role until the SVG is written; see :mod:`swimid.results.svg`.
SERIES = [f"#a0000{i}" for i in range(1, 7)]
INK, GRID, PAPER, SHADE = "#b00001", "#b00002", "#b00003", "#b00004"

_MARKERS = ["o", "s", "^", "D", "v", "P", "X"]
_DASHES: list[tuple[float, ...]] = [(5, 2.2), (1.4, 1.8), (7, 2, 1.4, 2), (3, 1.5)]
_HATCHES = ["", "////", "....", "\\\\\\\\", "xx", "--"]
#: Styles told apart by the shape of their marker.
_POINTED = ("points", "stems")
_MARK_DASHES: list[tuple[float, ...]] = [(4, 3), (1, 2), (8, 3, 1, 3), (2, 2)]


@dataclass(frozen=True)
class Look:
    """How one trace is told from the others, by colour and by something else."""

    slot: int
    dash: tuple[float, ...] | None = None
    marker: str | None = None
    hatch: str = ""
    #: Below 1 for points that a line of the same colour must be seen through.
    opacity: float = 1.0

    @property
    def colour(self) -> str:
        """The colour drawn with, which stands for one of the page's."""
        return SERIES[self.slot % len(SERIES)]


@dataclass(frozen=True)
class Entry:
    """One line of a legend: its text, and a small SVG that shows the look."""

    label: str
    swatch: str


def assigned(figure: Figure) -> list[list[Look]]:
    """A look for every trace; the same group or label looks the same in every panel."""
    slots: dict[tuple[str, Any], int] = {}
    looks: list[list[Look]] = []
    for panel in figure.panels:
        keys = []
        for index, trace in enumerate(panel.traces):
            key = ("group", trace.group) if trace.group is not None else ("label", trace.label or index)
            slots.setdefault(key, len(slots))
            keys.append(key)
        drawn = [(slots[key], trace.style in _POINTED) for key, trace in zip(keys, panel.traces, strict=True)]
        used: dict[tuple[int, str], int] = {}
        row = []
        for (slot, pointed), trace in zip(drawn, panel.traces, strict=True):
            repeat = used.get((slot, trace.style), 0)
            used[slot, trace.style] = repeat + 1
            rivals = list(dict.fromkeys(other for other, kind in drawn if kind == pointed))
            lined = pointed and (slot, False) in drawn
            row.append(_look(trace, slot, repeat, rivals, lined))
        looks.append(row)
    return looks


def _look(trace: Trace, slot: int, repeat: int, rivals: list[int], lined: bool) -> Look:
    """The look of one trace; ``rivals`` are the slots of its kind (points or lines) in the panel."""
    shape = _MARKERS[(slot + repeat) % len(_MARKERS)] if len(rivals) > 1 else _MARKERS[repeat % len(_MARKERS)]
    if trace.style in _POINTED:
        return Look(slot, marker=shape, opacity=0.45 if lined else 1.0)
    if trace.style == "bars":
        place = rivals.index(slot) + repeat
        return Look(slot, hatch=_HATCHES[place % len(_HATCHES)])
    if trace.style == "arrows":
        return Look(slot)
    dash: tuple[float, ...] | None = None
    if trace.style == "dashed" or repeat:
        dash = _DASHES[repeat % len(_DASHES)]
    # Colour alone would not do: every further line carries a sparse marker as well.
    return Look(slot, dash=dash, marker=shape if slot != rivals[0] else None)


def legend(panel: Panel, looks: list[Look]) -> list[Entry]:
    """The legend of a panel: its labelled traces, reference lines and shading."""
    traces = list(zip(panel.traces, looks, strict=True))
    entries = []
    for trace, look in traces:
        if trace.label:
            # A nameless trace of the same colour (the model of a measurement) shares the entry.
            mates = [(t, k) for t, k in traces if k.slot == look.slot and not t.label]
            parts = "".join(_swatch(t, k) for t, k in [*mates, (trace, look)])
            entries.append(Entry(trace.label, _svg_swatch(parts)))
    for label, dash in mark_dashes(panel).items():
        if label:
            entries.append(
                Entry(label, _svg_swatch(f'<path d="M1 6H29" {_stroke("currentColor", 1.2, dash)}/>'))
            )
    labels = list(dict.fromkeys(span.label for span in panel.spans if span.label))
    if len(labels) == 1:
        box = '<rect x="3" y="1" width="24" height="10" style="fill:var(--shade);stroke:var(--grid)"/>'
        entries.append(Entry(labels[0], _svg_swatch(box)))
    return entries


def mark_dashes(panel: Panel) -> dict[str, tuple[float, ...]]:
    """The dashes of the reference lines by label; lines of one label look the same."""
    labels = dict.fromkeys(mark.label for mark in panel.marks)
    return {label: _MARK_DASHES[i % len(_MARK_DASHES)] for i, label in enumerate(labels)}


def shortened(name: str, letters: int) -> str:
    """A label of at most so many letters."""
    return name if len(name) <= letters else name[: letters - 1] + "…"


def label_columns(axes: Axes, names: list[str], *, level: bool) -> None:
    """Names in place of numbers on the horizontal axis, slanting where there is no room for them."""
    angle, align = (0, "center") if level else (35, "right")
    axes.set_xticks(range(len(names)), names, rotation=angle, ha=align, rotation_mode="anchor")


def _stroke(colour: str, width: float, dash: tuple[float, ...] | None = None) -> str:
    dashes = f";stroke-dasharray:{','.join(f'{d * width:g}' for d in dash)}" if dash else ""
    return f'style="fill:none;stroke:{colour};stroke-width:{width:g}{dashes}"'


_SHAPES = {
    "o": '<circle cx="15" cy="6" r="3.4"/>',
    "s": '<path d="M12 3h6v6h-6z"/>',
    "^": '<path d="M15 2l4 7.4h-8z"/>',
    "D": '<path d="M15 1.6l4.4 4.4-4.4 4.4-4.4-4.4z"/>',
    "v": '<path d="M15 10l4-7.4h-8z"/>',
    "P": '<path d="M13.6 2h2.8v2.6h2.6v2.8h-2.6v2.6h-2.8V7.4H11V4.6h2.6z"/>',
    "X": (
        '<path d="M12.5 2L15 4.5 17.5 2 19 3.5 16.5 6 19 8.5 17.5 10 15 7.5 12.5 10 11 8.5 13.5 6 11 3.5z"/>'
    ),
}


def _swatch(trace: Trace, look: Look) -> str:
    colour = f"var(--s{look.slot % len(SERIES) + 1})"
    parts = []
    if trace.lower is not None and trace.upper is not None:
        parts.append(f'<rect x="1" y="1" width="28" height="10" style="fill:{colour};opacity:.2"/>')
    if trace.style == "bars":
        lines = '<path d="M5 11L15 1M12 11L22 1M19 11L27 3" style="stroke:var(--paper);stroke-width:1.2"/>'
        parts.append(
            f'<rect x="3" y="1" width="24" height="10" style="fill:{colour}"/>{lines if look.hatch else ""}'
        )
    elif trace.style not in ("points", "stems"):
        parts.append(f'<path d="M1 6H29" {_stroke(colour, 2, look.dash)}/>')
    if look.marker:
        parts.append(f'<g style="fill:{colour}">{_SHAPES[look.marker]}</g>')
    return "".join(parts)


def _svg_swatch(inside: str) -> str:
    return f'<svg class="swatch" viewBox="0 0 30 12" width="30" height="12" aria-hidden="true">{inside}</svg>'
