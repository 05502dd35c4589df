"""How the traces of a figure are told apart, by colour and by something else, and the legend."""

from __future__ import annotations

from dataclasses import dataclass, field
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
    """One line of a legend.

    Attributes
    ----------
    label : str
    traces : list of (str, bool, Look)
        Those it stands for: style, whether with a band, look.
    dash : tuple of float, optional
        Of the reference line it stands for; without it and without traces that is shading.
    """

    label: str
    traces: list[tuple[str, bool, Look]] = field(default_factory=list)
    dash: tuple[float, ...] | None = None


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
    traces = [(t.label, (t.style, t.lower is not None, k)) for t, k in zip(panel.traces, looks, strict=True)]
    entries = []
    for label, shown in traces:
        if label:
            # A nameless trace of the same colour (the model of a measurement) shares the entry.
            mates = [other for name, other in traces if other[2].slot == shown[2].slot and not name]
            entries.append(Entry(label, [*mates, shown]))
    entries += [Entry(label, dash=dash) for label, dash in mark_dashes(panel).items() if label]
    labels = list(dict.fromkeys(span.label for span in panel.spans if span.label))
    return [*entries, Entry(labels[0])] if len(labels) == 1 else entries


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
