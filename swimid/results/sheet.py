"""Figures of the evidence as one stand-alone picture, SVG or PNG."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Callable, Sequence
from importlib import resources
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_hex
from matplotlib.figure import Figure as Canvas
from matplotlib.lines import Line2D

from swimid.files import atomic
from swimid.files.mark import SOFTWARE
from swimid.results import figures as drawing
from swimid.results import looks
from swimid.results.evidence import Figure, Panel
from swimid.results.figures import PANEL, Size
from swimid.results.looks import GRID, INK, PAPER, SERIES, SHADE, Look

#: A panel over the whole width of the sheet.
WIDE = Size(760.0, 280.0, 11.5, 9)
#: Points around everything, between panels, and of the heading.
MARGIN, BETWEEN, HEADING = 14.0, 26.0, 22.0
#: Pixels a point of a PNG.
PIXELS = 2.0


def write(
    path: Path, figures: Sequence[Figure], *, title: str, step: Callable[[int], None] = lambda amount: None
) -> None:
    """Draw figures below each other, on white, and write them whole or not at all.

    Parameters
    ----------
    path : path
        ``.svg`` or ``.png``.
    figures : sequence of Figure
    title : str
    step : callable
        Called once a panel.
    """
    settings = {**drawing.SETTINGS, "svg.fonttype": "path"}
    with mpl.rc_context(settings):
        drawn = canvas(figures, title=title, step=step)
        with atomic.replacing(path) as temporary:
            kind = path.suffix.lower().removeprefix(".")
            metadata = {"Date": None, "Creator": SOFTWARE} if kind == "svg" else {"Software": SOFTWARE}
            drawn.savefig(temporary, format=kind, dpi=72 * PIXELS, metadata=metadata)


def canvas(
    figures: Sequence[Figure],
    *,
    title: str = "",
    step: Callable[[int], None] = lambda amount: None,
    new: Callable[..., Canvas] = Canvas,
) -> Canvas:
    """Draw figures below each other as one of matplotlib's, made by ``new`` (``pyplot.figure`` shows it)."""
    rows = [row for figure in figures for row in _rows(figure)]
    top_room = HEADING if title else 0.0
    height = 2 * MARGIN + top_room + sum(_height(row) for row in rows)
    width = WIDE.width + 2 * MARGIN
    with mpl.rc_context(drawing.SETTINGS | {"svg.fonttype": mpl.rcParams["svg.fonttype"]}):
        drawn = new(figsize=(width / 72, height / 72), dpi=72, facecolor=PAPER)
        if new is Canvas:
            FigureCanvasAgg(drawn)
        style: dict[str, Any] = {"color": INK, "ha": "left", "va": "top"}
        drawn.text(MARGIN / width, 1 - MARGIN / height, title, fontsize=15, weight="bold", **style)
        top = height - MARGIN - top_room
        for heading, panels, size in rows:
            if heading:
                drawn.text(MARGIN / width, (top - 4) / height, heading, fontsize=13, weight="bold", **style)
            down = top - (HEADING if heading else 0.0)
            for index, (panel, look) in enumerate(panels):
                left = MARGIN + index * (size.width + 20)
                tall = drawing.height_of(panel, size)
                corner = ((left + 52) / width, (down - tall + 34) / height)
                box = (*corner, (size.width - 62) / width, (tall - 60) / height)
                axes = drawn.add_axes(box, facecolor="none")
                _panel(axes, panel, look, size)
                label = f"{panel.title}: {panel.y_label}" if panel.title else panel.y_label
                label = "\n".join(textwrap.wrap(label, int(size.width / 7)))
                drawn.text(left / width, (down - 4) / height, label, fontsize=size.font, **style)
                step(1)
            top -= _height((heading, panels, size))
        _coloured(drawn.findobj())
    return drawn


def paint(figure: Figure, places: Sequence[Axes]) -> None:
    """Draw each panel of a figure on axes of the caller's."""
    with mpl.rc_context(drawing.SETTINGS):
        for panel, look, axes in zip(figure.panels, looks.assigned(figure), places, strict=True):
            _panel(axes, panel, look, PANEL)
            legend = axes.get_legend()
            if legend is not None:  # inside: beside the axes it might lie over those of the user
                axes.legend(
                    handles=legend.legend_handles,
                    fontsize="small",
                    labelcolor=INK,
                    ncols=1 + len(legend.legend_handles) // 5,
                    framealpha=0.7,
                )
            axes.set_ylabel(panel.y_label, fontsize=PANEL.font, color=INK)
            axes.set_title(panel.title, fontsize=PANEL.font, color=INK)
            _coloured(axes.findobj())


_Row = tuple[str, list[tuple[Panel, list[Look]]], Size]


def _rows(figure: Figure) -> list[_Row]:
    panels = list(zip(figure.panels, looks.assigned(figure), strict=True))
    across, size = (2, PANEL) if figure.columns > 1 else (1, WIDE)
    parts = [panels[k : k + across] for k in range(0, len(panels), across)]
    return [(figure.title if k == 0 else "", part, size) for k, part in enumerate(parts)]


def _height(row: _Row) -> float:
    heading, panels, size = row
    tallest = max(drawing.height_of(panel, size) for panel, _ in panels)
    return tallest + BETWEEN + (HEADING if heading else 0.0)


def _panel(axes: Axes, panel: Panel, look: list[Look], size: Size) -> None:
    drawing.frame(axes, size)
    drawing.paint(axes, panel, look, size)
    axes.set_xlabel(panel.x_label, fontsize=size.font, color=INK)
    handles = []
    for trace, k in zip(panel.traces, look, strict=True):
        dash = "" if trace.style in ("points", "stems") else (0, k.dash) if k.dash else "-"
        style: dict[str, Any] = {"color": k.colour, "marker": k.marker or "", "linestyle": dash}
        if trace.label:
            handles.append(Line2D([], [], label=trace.label, **style))
    dashes = looks.mark_dashes(panel)
    handles += [Line2D([], [], color=INK, dashes=dashes[label], label=label) for label in dashes if label]
    spans = dict.fromkeys(span.label for span in panel.spans if span.label)
    handles += [Line2D([], [], color=SHADE, linewidth=7, label=label) for label in spans]
    if handles:
        axes.legend(
            handles=handles,
            loc="lower right",
            bbox_to_anchor=(1.0, 1.0),
            ncols=len(handles),
            frameon=False,
            fontsize=size.font - 1,
            labelcolor=INK,
            borderaxespad=0.1,
            handlelength=1.8,
            columnspacing=1.2,
        )


def _palette() -> dict[str, str]:
    """Colours of the page in daylight for the colours that stand for roles."""
    css = (resources.files("swimid.results") / "templates" / "report.css").read_text(encoding="utf-8")
    values: dict[str, str] = {}
    for name, value in re.findall(r"--([a-z0-9]+): (#[0-9a-f]+)", css):
        values.setdefault(name, value)  # the first block is that of daylight
    roles = {INK: "ink", GRID: "grid", PAPER: "paper", SHADE: "shade"}
    roles |= {colour: f"s{k}" for k, colour in enumerate(SERIES, start=1)}
    return {role: values[name] for role, name in roles.items()}


def _coloured(artists: Sequence[Artist]) -> None:
    """Give every artist the colour its role has on the page."""
    palette = _palette()
    for artist in artists:
        for name in ("color", "facecolor", "edgecolor", "markerfacecolor", "markeredgecolor"):
            get, put = getattr(artist, f"get_{name}", None), getattr(artist, f"set_{name}", None)
            if get is None or put is None:
                continue
            try:
                here = to_hex(get())
            except (TypeError, ValueError):
                continue  # several colours, or none
            if here in palette:
                put(palette[here])
