"""Figures of the evidence as SVG that follows the page.

Each panel becomes its own SVG without fixed colours: ink is ``currentColor``, the series are
CSS variables, so that one drawing serves light, dark and print. A panel is one column wide:
it can be read on a telephone, and two stand side by side on a screen. The legend is data for
the page, which sets it as text beside the drawing, where it hides nothing.
"""

from __future__ import annotations

import io
import math
import textwrap
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure as Canvas
from matplotlib.ticker import Formatter, FuncFormatter, LogLocator, MaxNLocator, NullFormatter
from numpy.typing import NDArray

from swimid.errors import InputError
from swimid.results import heat, looks, numbers, svg
from swimid.results.evidence import MAX_POINTS, Figure, Panel, Trace, thinned
from swimid.results.looks import GRID, INK, PAPER, SHADE, Entry, Look

#: So few points are drawn fully opaque.
_FEW = 60
#: From this many points on a trace is drawn as a cloud of dots.
_CLOUD = 150

Array = NDArray[np.float64]

SETTINGS: Any = {
    "svg.fonttype": "none",
    "svg.hashsalt": "swimid",
    "text.parse_math": False,
    "path.simplify": True,
    "path.simplify_threshold": 0.25,
    "axes.unicode_minus": True,
    "hatch.linewidth": 0.8,
    "font.family": "DejaVu Sans",
}


@dataclass(frozen=True)
class Size:
    """A drawing's extent in points, which are the page's pixels at scale 1."""

    width: float
    height: float
    font: float
    x_ticks: int


#: One column of a page, and of a journal.
PANEL = Size(400.0, 260.0, 11.0, 5)


@dataclass(frozen=True)
class Drawing:
    """One panel, drawn.

    Attributes
    ----------
    title : str
        Of the panel; may be empty.
    legend : list of Entry
        Empty where there is a single trace without a label.
    svg : str
        The drawing, one column wide.
    reduced : bool
        A trace had more points than are drawn.
    """

    title: str
    legend: list[Entry]
    svg: str
    reduced: bool


def draw(figure: Figure, prefix: str) -> list[Drawing]:
    """Draw every panel of a figure.

    Parameters
    ----------
    figure : Figure
        As in the evidence.
    prefix : str
        Put before every id inside the SVGs; unique on the page.

    Raises
    ------
    InputError
        When a trace's lists, or the rows of a heat map, differ in length.
    """
    for index, panel in enumerate(figure.panels):
        place = f"figures.{figure.id}.panels.{index}"
        for trace in panel.traces:
            _check(trace, place)
        if panel.heat is not None:
            heat.check(panel.heat, place)
    styles = looks.assigned(figure)
    reduced = [any(len(trace.x) > MAX_POINTS for trace in panel.traces) for panel in figure.panels]
    panels = [_reduced(panel) if few else panel for panel, few in zip(figure.panels, reduced, strict=True)]
    with mpl.rc_context(SETTINGS):
        drawn = _render(panels, styles, figure, prefix)
    return [
        Drawing(panel.title, looks.legend(panel, look), one, few)
        for panel, look, one, few in zip(panels, styles, drawn, reduced, strict=True)
    ]


def _check(trace: Trace, place: str) -> None:
    for name in ("y", "y_error", "lower", "upper"):
        values = getattr(trace, name)
        if values is not None and len(values) != len(trace.x):
            raise InputError(f"'{name}' has {len(values)} numbers for {len(trace.x)} of 'x'", column=place)


def _reduced(panel: Panel) -> Panel:
    """The panel with over-long traces cut to their envelope."""
    bare = {"y_error": None, "lower": None, "upper": None}
    traces = []
    for trace in panel.traces:
        if len(trace.x) > MAX_POINTS:
            x, y = thinned(_array(trace.x), _array(trace.y))
            trace = trace.model_copy(update={"x": x.tolist(), "y": y.tolist(), **bare})
        traces.append(trace)
    return panel.model_copy(update={"traces": traces})


# ---------------------------------------------------------------- drawing


def _render(panels: list[Panel], styles: list[list[Look]], figure: Figure, prefix: str) -> list[str]:
    drawn = [_axes(panel, look, PANEL) for panel, look in zip(panels, styles, strict=True)]
    # One left margin for all panels, so that axes that stand below each other line up.
    left = max((_tick_width(canvas, axes) for canvas, axes in drawn), default=40.0)
    texts = []
    for index, ((canvas, axes), panel) in enumerate(zip(drawn, panels, strict=True)):
        _place(canvas, axes, panel, PANEL, left)
        texts.append(svg.for_page(_svg(canvas), f"{prefix}{index}-", figure, panel))
    return texts


def height_of(panel: Panel, size: Size) -> float:
    """Height of a panel's drawing, points."""
    if panel.equal_aspect:
        return min(max(size.width * _shape(panel), 0.3 * size.width), 520.0, 1.1 * size.width) + 60
    return size.height if panel.heat is None else heat.height(panel.heat, size.font)


def _axes(panel: Panel, styles: list[Look], size: Size) -> tuple[Canvas, Axes]:
    canvas = Canvas(figsize=(size.width / 72, height_of(panel, size) / 72), dpi=72, facecolor="none")
    FigureCanvasSVG(canvas)
    axes = canvas.add_axes((0.1, 0.2, 0.88, 0.7), facecolor="none")
    frame(axes, size)
    paint(axes, panel, styles, size)
    return canvas, axes


def paint(axes: Axes, panel: Panel, styles: list[Look], size: Size) -> None:
    """Draw what a panel holds into axes, in the colours that stand for roles."""
    if panel.heat is not None:
        heat.draw(axes, panel.heat, size.width, size.font)
        return
    bars = [i for i, trace in enumerate(panel.traces) if trace.style == "bars"]
    # a model's line among the points of its group carries no markers: they would pass for data
    measured = {t.group for t in panel.traces if t.style == "points" and t.group is not None}
    for index, (trace, look) in enumerate(zip(panel.traces, styles, strict=True)):
        place = (bars.index(index), len(bars)) if index in bars else (0, 1)
        _trace(axes, trace, look, size, place, marked=trace.group not in measured)
    _scales(axes, panel, size)
    _marks(axes, panel, size)
    if panel.equal_aspect:
        axes.set_aspect("equal", adjustable="datalim")
    if panel.invert_y:
        axes.invert_yaxis()


def frame(axes: Axes, size: Size) -> None:
    """Spines, ticks and grid of the report's look."""
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        axes.spines[side].set(color=INK, alpha=0.45, linewidth=0.8)
    axes.tick_params(which="both", color=INK, labelcolor=INK, labelsize=size.font, length=3, width=0.8)
    axes.tick_params(which="minor", length=2, width=0.5)
    axes.grid(True, color=GRID, linewidth=0.7)
    axes.set_axisbelow(True)
    axes.margins(x=0.015, y=0.06)


def _trace(axes: Axes, trace: Trace, look: Look, size: Size, place: tuple[int, int], *, marked: bool) -> None:
    x, y = _array(trace.x), _array(trace.y)
    bars: dict[str, Any] = {"color": look.colour, "capsize": 2.5, "zorder": 2.1}
    if trace.lower is not None and trace.upper is not None:
        low, high = _array(trace.lower), _array(trace.upper)
        axes.fill_between(x, low, high, color=look.colour, alpha=0.2, linewidth=0, zorder=1.5)
    if trace.style == "bars":
        x = _bars(axes, x, y, look, place)
        bars = {"color": INK, "capsize": 3, "zorder": 2.4}
    elif trace.style == "arrows":
        axes.plot(x, y, color=look.colour, linewidth=1.0, solid_capstyle="round", zorder=2.3)
        return
    elif trace.style == "stems":
        axes.vlines(x, 0, y, color=look.colour, linewidth=1.2)
    elif trace.style != "points":
        _line(axes, x, y, trace.style, look, size, marked=marked)
    if trace.style in ("points", "stems"):
        _points(axes, x, y, look)
    if trace.y_error is not None:
        axes.errorbar(x, y, yerr=_array(trace.y_error), fmt="none", elinewidth=1.1, **bars)


def _line(axes: Axes, x: Array, y: Array, style: str, look: Look, size: Size, *, marked: bool) -> None:
    shown = int(np.count_nonzero(np.isfinite(y)))
    # More than two points a pixel of the width only make the file longer.
    dense = len(x) > 4 * size.width and bool(np.all(np.diff(x) > 0))
    axes.plot(
        *(thinned(x, y, int(2 * size.width)) if dense else (x, y)),
        color=look.colour,
        linewidth=1.1 if not marked else 1.5 if shown < 600 else 1.2,
        dashes=look.dash or (None, None),
        drawstyle="steps-post" if style == "step" else "default",
        marker=look.marker if marked else "",
        markersize=4.5,
        markevery=(0.05, 0.16) if shown > 12 else None,
        zorder=2.5 if look.dash else 2.0,
    )


def _points(axes: Axes, x: Array, y: Array, look: Look) -> None:
    diameter = float(np.interp(len(x), [30, 150, 600, 2000], [6.5, 3.8, 2.6, 2.0]))
    if len(x) < _CLOUD:
        opacity = 1.0 if len(x) <= _FEW else look.opacity
        style: dict[str, Any] = {"color": look.colour, "alpha": opacity, "mew": 0, "zorder": 2.2}
        axes.plot(x, y, ls="", marker=look.marker, ms=diameter, **style)
        return
    # One path of dots (strokes of no length with wide ends) takes a tenth of the space of
    # as many markers; at this size their shape could not be told anyway.
    gap = np.full(len(x), np.nan)
    (line,) = axes.plot(
        np.column_stack([x, x, gap]).ravel(),
        np.column_stack([y, y, gap]).ravel(),
        color=look.colour,
        alpha=min(0.75, look.opacity),
        linewidth=diameter,
        solid_capstyle="round" if look.marker == "o" else "projecting",
        zorder=1.9,
    )
    line.get_path().should_simplify = False


def _bars(axes: Axes, x: Array, y: Array, look: Look, place: tuple[int, int]) -> Array:
    """Bars of one of several traces side by side; their middles."""
    index, count = place
    pitch = float(np.min(np.diff(np.sort(x)))) if len(x) > 1 else 1.0
    width = 0.8 * pitch / count
    middle: Array = x + (index - (count - 1) / 2) * width
    style: dict[str, Any] = {"color": look.colour, "edgecolor": PAPER, "hatch": look.hatch}
    axes.bar(middle, y, width=0.92 * width, linewidth=0.0, zorder=2, **style)
    return middle


def _scales(axes: Axes, panel: Panel, size: Size) -> None:
    for axis, scale, name in ((axes.xaxis, panel.x_scale, "x"), (axes.yaxis, panel.y_scale, "y")):
        values = np.concatenate([_array(getattr(t, name)) for t in panel.traces] or [np.empty(0)])
        values = values[np.isfinite(values)]
        if scale == "log" and np.any(values > 0):
            (axes.set_xscale if name == "x" else axes.set_yscale)("log", nonpositive="mask")
            positive = values[values > 0]
            decades = math.log10(positive.max() / positive.min())
            axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if decades < 1.7 else (1.0,), numticks=12))
            axis.set_major_formatter(FuncFormatter(_log_label))
            axis.set_minor_formatter(NullFormatter())
            continue
        ticks = size.x_ticks if name == "x" else 6
        axis.set_major_locator(MaxNLocator(nbins=ticks, steps=[1, 2, 2.5, 5, 10]))
        axis.set_major_formatter(_Ticks())
        axis.get_offset_text().set(color=INK, fontsize=size.font)
    if panel.x_categories is not None:
        _categories(axes, panel.x_categories, size)


def _categories(axes: Axes, names: list[str], size: Size) -> None:
    shown = [looks.shortened(name, 26) for name in names]
    fits = sum(len(name) + 2 for name in shown) * size.font * 0.6 < size.width * 0.85
    looks.label_columns(axes, shown, level=fits)
    axes.tick_params(axis="x", length=0)
    axes.grid(False, axis="x")
    axes.set_xlim(-0.6, len(shown) - 0.4)


def _marks(axes: Axes, panel: Panel, size: Size) -> None:
    dashes = looks.mark_dashes(panel)
    for mark in panel.marks:
        line = axes.axhline if mark.axis == "y" else axes.axvline
        line(mark.at, color=INK, linewidth=1.0, dashes=dashes[mark.label], alpha=0.75, zorder=1.8)
    several = len({span.label for span in panel.spans if span.label}) > 1
    for span in panel.spans:
        axes.axvspan(span.start, span.end, facecolor=SHADE, edgecolor="none", zorder=0.5)
        if several and span.label:
            middle, across = (span.start + span.end) / 2, axes.get_xaxis_transform()
            style: dict[str, Any] = {"fontsize": size.font - 1.5, "color": INK, "clip_on": True}
            axes.text(middle, 0.985, span.label, transform=across, ha="center", va="top", **style)


def _tick_width(canvas: Canvas, axes: Axes) -> float:
    box = axes.yaxis.get_tightbbox()
    return 8.0 if box is None else float(axes.bbox.x0 - box.x0) + 4.0


def _place(canvas: Canvas, axes: Axes, panel: Panel, size: Size, left: float) -> None:
    """Set margins and labels. The y label lies above the axis, where it can be read."""
    width, height = size.width, canvas.get_figheight() * 72
    letters = int(width / (size.font * 0.58))
    y_label = textwrap.wrap(panel.y_label, letters) or [""]
    x_label = textwrap.wrap(panel.x_label, letters) or [""]
    line = size.font * 1.25
    top = 6 + line * len(y_label) + (4 if panel.y_label else 0)
    if axes.yaxis.get_offset_text().get_text():
        top += line
    ticks = axes.xaxis.get_tightbbox()
    tick_height = line if ticks is None else max(float(axes.bbox.y0 - ticks.y0), line)
    bottom = tick_height + 5 + (line * len(x_label) if panel.x_label else 0)
    right = 14.0
    axes.set_position(
        (left / width, bottom / height, (width - left - right) / width, (height - top - bottom) / height)
    )
    style: dict[str, Any] = {"fontsize": size.font, "color": INK, "linespacing": 1.2}
    canvas.text(0.0, 1 - 4 / height, "\n".join(y_label), ha="left", va="top", **style)
    centre = (left + (width - left - right) / 2) / width
    canvas.text(centre, 3 / height, "\n".join(x_label), ha="center", va="bottom", **style)


class _Ticks(Formatter):
    """Plain numbers with as many decimals as the tick spacing needs."""

    def __init__(self) -> None:
        self._offset = ""

    def __call__(self, value: float, pos: int | None = None) -> str:
        return numbers.number(float(value))

    def format_ticks(self, values: Any) -> list[str]:
        finite = [float(v) for v in values]
        largest = max((abs(v) for v in finite), default=0.0)
        power = int(f"{largest:e}".split("e")[1]) if largest else 0
        scale = 0 if -3 <= power < 5 else power
        self._offset = f"× {numbers.power_of_ten(scale)}" if scale else ""
        scaled = [v / 10.0**scale for v in finite]
        step = min((b - a for a, b in pairwise(scaled)), default=1.0)
        decimals = 0
        while decimals < 8 and abs(step) > 0 and abs(round(step, decimals) - step) > 1e-3 * abs(step):
            decimals += 1
        return [numbers.fixed(v, decimals) for v in scaled]

    def get_offset(self) -> str:
        return self._offset


def _log_label(value: float, pos: int | None = None) -> str:
    if 1e-3 <= value < 1e5:
        return numbers.number(value, 2)
    exponent = math.floor(math.log10(value) + 1e-9)
    lead = round(value / 10.0**exponent)
    return numbers.power_of_ten(exponent) if lead == 1 else f"{lead}×{numbers.power_of_ten(exponent)}"


def _array(values: list[float | None]) -> Array:
    return np.array([math.nan if v is None else v for v in values], dtype=float)


def _shape(panel: Panel) -> float:
    """Height over width of the data of an equal-aspect panel."""
    spans = []
    for name in ("x", "y"):
        values = np.concatenate([_array(getattr(t, name)) for t in panel.traces] or [np.zeros(1)])
        values = values[np.isfinite(values)]
        spans.append(float(np.ptp(values)) if len(values) else 0.0)
    if not spans[0] or not spans[1]:
        return 0.6
    return spans[1] / spans[0]


def _svg(canvas: Canvas) -> str:
    buffer = io.StringIO()
    canvas.savefig(buffer, format="svg", transparent=True, metadata={"Date": None, "Creator": None})
    return buffer.getvalue()
