"""Functions that draw the figures of results with matplotlib. A panel is as wide as one journal column.

The same function draws a panel for a notebook, for ``swimid plot`` and for a report. In a report, a panel is
an SVG element with the colours of the page, so that the same drawing can be shown on a light, a dark and a
printed page.
"""

from __future__ import annotations

import base64
import hashlib
import io
import math
import re
import textwrap
from collections.abc import Callable, Sequence
from functools import cache, partial
from html import escape
from itertools import count
from pathlib import Path
from string import ascii_lowercase
from typing import Any

import matplotlib as mpl
import numpy as np
from cycler import cycler
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Canvas
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from matplotlib.ticker import FuncFormatter, MultipleLocator, NullFormatter
from numpy.typing import NDArray

from swimid.files import atomic
from swimid.files.provenance import SOFTWARE
from swimid.results import numbers
from swimid.results.evidence import MAX_TRACE_POINTS, Figure, Heat, Panel, Trace, thin_curve

Array = NDArray[np.float64]

#: Width of a panel of a figure (one journal column) and its default height, inches.
WIDTH, HEIGHT = 3.5, 2.3
#: Maximum total height of a figure of three or more panels, and minimum height of one of its panels, inches.
TALLEST, LOW = 5.1, 1.2
#: Space that labels and title need around the axes of a panel, in width and in height, inches.
AXES_MARGIN_INCH = 0.6
#: Font size of figures, points, as in the style file ``figure.mplstyle``.
FONT = 8.0
#: Approximate width of a letter as a fraction of the font size. It is used to estimate the width of a text.
LETTER = 0.58
#: Resolution of figures that are written as PNG files, pixels per inch.
DPI = 300
#: Resolution of figures in a notebook, pixels per inch.
NOTEBOOK_DPI = 120
#: Minimum number of points at which a trace of points is drawn as a single SVG path of dots. The path takes a
#: tenth of the file size of separate markers.
MIN_CLOUD = 60
#: Minimum ratio of height to width at which a swimming path is drawn with equal scales on both axes. A
#: flatter path would look like a line.
MIN_SHAPE = 0.2
#: Minimum size, points, at which a marker of a trace gets an edge in the background colour. The edge
#: separates markers that overlap.
MIN_EDGED = 2.5
#: Opacity of the darkest cell of a heat map. It is so low that the number in the cell is legible.
DARKEST = 0.55

MARKERS = ("o", "s", "^", "D", "v", "P", "X")
DASHES = ((4, 2), (1, 1.5), (6, 2, 1, 2))


TEMPLATES = Path(__file__).parent / "templates"


@cache
def palette() -> dict[str, str]:
    """Return the colours of a report page in light mode by name, such as ``ink``, ``paper`` and ``s1``."""
    css = (TEMPLATES / "report.css").read_text(encoding="utf-8")
    names = ("ink", "grid", "paper", "shade", *(f"s{k}" for k in range(1, 7)))
    return {name: re.search(rf"--{name}: (#[0-9a-f]+)", css)[1] for name in names}  # type: ignore[index]


@cache
def style() -> Any:
    """Return the matplotlib settings for all figures of swimid."""
    file: Any = mpl.rc_params_from_file(TEMPLATES / "figure.mplstyle", use_default_template=False)
    inked = ("axes.edgecolor", "axes.labelcolor", "text.color", "xtick.color", "ytick.color")
    return {
        **file,
        **dict.fromkeys(inked, palette()["ink"]),
        "figure.facecolor": palette()["paper"],
        "grid.color": palette()["grid"],
        "axes.prop_cycle": cycler(color=[_colour(k) for k in range(6)]),
    }


# ---------------------------------------------------------------- one panel


def paint(
    axes: Axes, panel: Panel, slots: dict[Any, int], *, compact: bool = False, legend: bool = True
) -> None:
    """Draw a panel of a figure on matplotlib axes: traces or heat map, labels, reference lines, legend.

    Parameters
    ----------
    axes : Axes
    panel : Panel
    slots : dict
        Index of the colour and of the marker for each group of traces (:func:`slots_of`).
    compact : bool
        Draw a trace of many points as one path, which takes a tenth of the space in an SVG.
    legend : bool
        Draw the legend.
    """
    if panel.heat is not None:
        _heat(axes, panel.heat)
    # A group with points and a line shows a measurement and its model. Draw it as small dots on a broad, pale
    # line.
    pointed = {trace.group for trace in panel.traces if trace.style == "points"} - {None}
    lined = {trace.group for trace in panel.traces if trace.style in ("line", "dashed", "step")}
    seen: dict[tuple[int, str], int] = {}
    for index, trace in enumerate(panel.traces):
        slot = slots[_key(trace, index)]
        repeat = seen.setdefault((slot, trace.style), 0)
        seen[slot, trace.style] += 1
        paired = trace.group in pointed & lined
        small = paired or panel.y_categories is not None
        _trace(axes, trace, slot, repeat, paired=paired, small=small, compact=compact)
    axes.set_xlabel("\n".join(textwrap.wrap(panel.x_label, 52)))
    # Wrap the label of the vertical axis at two thirds of the height of the panel.
    letters = int(72 * _height(panel) / (1.5 * LETTER * FONT))
    axes.set_ylabel("\n".join(textwrap.wrap(panel.y_label, letters)))
    _scales(axes, panel)
    for mark in panel.marks:
        line = axes.axhline if mark.axis == "y" else axes.axvline
        line(mark.at, color=palette()["ink"], lw=0.6, dashes=(4, 3), zorder=1.8, label=mark.label or None)
    _spans(axes, panel)
    rows = _legend(axes) if legend else 0
    title = panel.title
    if panel.equal_aspect and not is_to_scale(panel):
        title = f"{title}, {panel.y_label.partition(' ')[0]} magnified".removeprefix(", ")
    axes.set_title("\n".join(textwrap.wrap(title, 52)), pad=5 + rows * 1.6 * (FONT - 1))


def slots_of(figure: Figure) -> dict[Any, int]:
    """Return the colour index of each group of traces. It is the same in every panel of a figure."""
    keys = [_key(trace, k) for panel in figure.panels for k, trace in enumerate(panel.traces)]
    slots: dict[Any, int] = {key: key for key in keys if isinstance(key, int)}
    free = (k for k in count() if k not in slots.values())
    for key in keys:
        if key not in slots:
            slots[key] = next(free)
    return slots


def _key(trace: Trace, index: int) -> Any:
    if trace.group is not None:
        return trace.group
    return trace.label or ("trace", index)


def _colour(slot: int) -> str:
    return palette()[f"s{slot % 6 + 1}"]


def _array(values: Sequence[float | None]) -> Array:
    return np.array(values, dtype=float)  # The conversion to float turns None into NaN.


def _trace(
    axes: Axes, trace: Trace, slot: int, repeat: int, *, paired: bool, small: bool, compact: bool
) -> None:
    """Draw one trace of a panel on its axes, as a line or as points.

    ``paired`` states that the trace is a measurement or its model, which are drawn over each other. ``small``
    selects small points. ``compact`` selects a single path for many points. ``slot`` is the colour index, and
    ``repeat`` the number of earlier traces with the same colour and style.
    """
    x, y, colour = _array(trace.x), _array(trace.y), _colour(slot)
    label = trace.label or None
    if trace.lower is not None and trace.upper is not None:
        band = axes.fill_between(x, _array(trace.lower), _array(trace.upper), color=colour, alpha=0.2, lw=0)
        if not np.any(y):  # A trace that is zero everywhere is a band without a line.
            band.set_label(trace.label)
            return
    elif len(x) > MAX_TRACE_POINTS:
        x, y = thin_curve(x, y)
    if trace.y_error is not None:
        axes.errorbar(x, y, yerr=_array(trace.y_error), fmt="none", ecolor=colour, lw=0.9, capsize=2)
    if trace.style in ("points", "stems"):
        if trace.style == "stems":
            axes.vlines(x, 0, y, color=colour, lw=0.9)
        _points(axes, x, y, slot, label, small=small, compact=compact)
        return
    steps = {"step": "steps-post"}.get(trace.style, "default")
    (line,) = axes.plot(x, y, color=colour, lw=1.0, label=label, zorder=2, drawstyle=steps)
    if paired:
        line.set(lw=1.6, alpha=0.5)
    if trace.style == "dashed" or repeat:
        line.set_dashes(DASHES[repeat % len(DASHES)])
    elif slot and not paired and trace.style != "arrows":
        line.set_dashes(DASHES[(slot - 1) % len(DASHES)])


def _points(
    axes: Axes, x: Array, y: Array, slot: int, label: str | None, *, small: bool, compact: bool
) -> None:
    """Draw points on axes, as markers or, if there are many and ``compact`` is true, as one path."""
    marker, colour = MARKERS[slot % len(MARKERS)], _colour(slot)
    size = float(np.interp(len(x), [20, 60, 400, 2000], [4.0, 3.0, 1.6, 1.2]))
    if small:
        size *= 0.6
    edge = {"mew": 0.0 if size < MIN_EDGED else 0.4, "mec": palette()["paper"]}
    if compact and len(x) >= MIN_CLOUD:
        # Draw the points as very short strokes with round ends, which saves space in an SVG file.
        end, gap = x + 1e-4 * (float(np.ptp(x[np.isfinite(x)])) or 1.0), np.full(len(x), np.nan)
        dots = [np.column_stack(parts).ravel() for parts in ((x, end, gap), (y, y, gap))]
        (line,) = axes.plot(*dots, color=colour, lw=size, solid_capstyle="round", zorder=2.5)
        line.get_path().should_simplify = False
        x, y, marker, size = np.array([]), np.array([]), "o", 3.0
    about: dict[str, Any] = {"ls": "", "color": colour, "label": label, "zorder": 2.5, **edge}
    axes.plot(x, y, marker=marker, ms=size, **about)


def _scales(axes: Axes, panel: Panel) -> None:
    """Set the scales, ticks and category names of the axes of a panel."""
    _scale_axis(axes, panel, "x")
    _scale_axis(axes, panel, "y")
    for names, axis in ((panel.x_categories, axes.xaxis), (panel.y_categories, axes.yaxis)):
        if names is not None:
            axis.set_ticks(range(len(names)), [_cut(name) for name in names])
            axis.grid(False)
    if panel.x_categories is not None:
        _slant(axes, panel.x_categories)
        axes.set_xlim(-0.6, len(panel.x_categories) - 0.4)
    if is_to_scale(panel):
        axes.set_aspect("equal", adjustable="box")
        step = max(float(ticks[1] - ticks[0]) for ticks in (axes.get_xticks(), axes.get_yticks()))
        # Use a common distance of ticks only if both axes then have several ticks.
        if 2 * step <= min(np.ptp(axes.get_xlim()), np.ptp(axes.get_ylim())):
            axes.xaxis.set_major_locator(MultipleLocator(step))
            axes.yaxis.set_major_locator(MultipleLocator(step))
    if panel.invert_y:
        axes.invert_yaxis()


def _scale_axis(axes: Axes, panel: Panel, name: str) -> None:
    """Set the scale of the axis ``"x"`` or ``"y"``: logarithmic, or with a power of ten in its label."""
    axis = axes.xaxis if name == "x" else axes.yaxis
    values = [v for trace in panel.traces for v in getattr(trace, name) if v is not None]
    if getattr(panel, f"{name}_scale") == "log" and any(v > 0 for v in values):
        getattr(axes, f"set_{name}scale")("log", nonpositive="mask")
        axis.set_major_formatter(FuncFormatter(partial(_format_tick, 1.0)))
        axis.set_minor_formatter(NullFormatter())
        return
    largest = max((abs(v) for v in values if math.isfinite(v)), default=0.0)
    power = math.floor(math.log10(largest or 1.0))
    if not -3 <= power < 5:
        axis.set_major_formatter(FuncFormatter(partial(_format_tick, 10.0**power)))
        axis.set_label_text(f"{axis.get_label_text()}, × {numbers.power_of_ten(power)}")


def _format_tick(factor: float, value: float, _: int | None) -> str:
    return f"{value / factor:.4g}".replace("-", "−")


def _cut(name: str, letters: int = 28) -> str:
    if len(name) > letters:
        name = name[: letters - 1] + "…"
    return name


def _slant(axes: Axes, names: Sequence[str]) -> None:
    """Slant the names of the categories on the x axis if horizontal names would overlap."""
    if sum(len(_cut(name)) + 2 for name in names) * LETTER * FONT > 60 * WIDTH:
        axes.tick_params(axis="x", labelrotation=35)
        for label in axes.get_xticklabels():
            label.set(ha="right", rotation_mode="anchor")


def _spans(axes: Axes, panel: Panel) -> None:
    labels = {span.label for span in panel.spans if span.label}
    for span in panel.spans:
        shade = axes.axvspan if span.axis == "x" else axes.axhspan
        area = shade(span.start, span.end, facecolor=palette()["shade"], lw=0, zorder=0.5)
        if len(labels) == 1:
            area.set_label(*labels)
        elif span.label:
            at, across = (span.start + span.end) / 2, axes.get_xaxis_transform()
            axes.text(at, 0.98, span.label, transform=across, ha="center", va="top", fontsize=FONT - 1.5)


def _legend(axes: Axes) -> int:
    """Draw the legend of a panel above its axes, and return the number of rows of the legend.

    A panel with a single line has no legend, and the number is 0.
    """
    handles, labels = axes.get_legend_handles_labels()
    found = dict(zip(labels, handles, strict=True))
    if not found or (len(found) == 1 and isinstance(next(iter(found.values())), Line2D)):
        return 0
    longest = max(len(label) for label in found)
    columns = max(int(60 * WIDTH / (longest * LETTER * (FONT - 1) + 28)), 1)
    columns = min(columns, len(found))
    axes.legend(list(found.values()), list(found), loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=columns)
    return math.ceil(len(found) / columns)


def _heat(axes: Axes, heat: Heat) -> None:
    """Draw a heat map on axes: a table of numbers in cells that are shaded by value."""
    values = np.array([_array(row) for row in heat.values]).reshape(len(heat.rows), len(heat.columns))
    shades = values
    if heat.scale == "log":
        shades = np.log(np.maximum(values, heat.neutral) / heat.neutral)
    known = shades[np.isfinite(shades)]
    low, high = (known.min(), known.max()) if len(known) else (0.0, 0.0)
    if heat.scale == "log":
        low, high = 0.0, max(high, math.log(3.0))
    rows = [_cut(name) for name in heat.rows]
    texts = [[numbers.format_number(float(value), 2) for value in row] for row in values]
    letters = max((len(text) for row in texts for text in row), default=1) + 1
    room = 72 * WIDTH - LETTER * FONT * max((len(row) for row in rows), default=0)
    size = min(FONT, room / max(len(heat.columns), 1) / (letters * LETTER))
    for (i, j), shade in np.ndenumerate(shades):
        if np.isfinite(shade):
            alpha = DARKEST * (shade - low) / (high - low) if high > low else 0.0
            axes.add_patch(Rectangle((j - 0.5, i - 0.5), 1, 1, facecolor=_colour(0), alpha=alpha, lw=0))
        axes.text(j, i, texts[i][j], ha="center", va="center", fontsize=max(size, 4.5))
    axes.set_xticks(range(len(heat.columns)), [_cut(name) for name in heat.columns])
    axes.set_yticks(range(len(heat.rows)), rows)
    axes.set(xlim=(-0.5, len(heat.columns) - 0.5), ylim=(len(heat.rows) - 0.5, -0.5))
    _slant(axes, heat.columns)
    axes.tick_params(length=0)
    axes.grid(False)
    axes.spines[:].set_visible(False)


# ---------------------------------------------------------------- whole figures


def _height(panel: Panel, panels: int = 1) -> float:
    """Return the height of a panel, inches, from its content and from the number of panels of its figure."""
    if panel.heat is not None:
        return 1.0 + 0.2 * len(panel.heat.rows)
    if panel.y_categories is not None:
        return max(1.0 + 0.16 * len(panel.y_categories), 1.6)
    if not is_to_scale(panel):
        return max(min(HEIGHT, TALLEST / panels), LOW)
    return min(max((WIDTH - AXES_MARGIN_INCH) * _shape(panel), 0.8), 4.0) + AXES_MARGIN_INCH


def is_to_scale(panel: Panel) -> bool:
    """Return whether a panel is drawn with equal scales on both axes. A flat path has different scales."""
    return panel.equal_aspect and _shape(panel) > MIN_SHAPE


def _shape(panel: Panel) -> float:
    """Return the range of y divided by the range of x over all traces of a panel."""
    spans = []
    for name in ("x", "y"):
        values = [v for trace in panel.traces for v in getattr(trace, name) if v is not None]
        spans.append(max(values, default=0.0) - min(values, default=0.0))
    if not spans[0]:
        return HEIGHT / WIDTH
    return spans[1] / spans[0]


def canvas(
    figures: Sequence[Figure],
    *,
    title: str = "",
    new: Callable[..., Canvas] = Canvas,
    step: Callable[[int], None] = lambda amount: None,
) -> Canvas:
    """Draw all panels of several figures below each other in one matplotlib figure, and return it.

    The matplotlib figure is as wide as a journal column. A panel has no legend if the panel above shows all
    its labels. Panels with the same horizontal range share the horizontal axis.

    Parameters
    ----------
    figures : sequence of Figure
    title : str
        Heading of the matplotlib figure.
    new : callable
        Function that creates the matplotlib figure. With ``pyplot.figure`` a notebook shows the figure.
    step : callable
        Function that is called once for each panel drawn.
    """
    heights: list[float] = []
    for figure in figures:
        heights += [_height(panel, len(figure.panels)) for panel in figure.panels]
    # Create the matplotlib figure outside ``rc_context``, which would undo the settings that a notebook
    # backend changes when it creates a figure.
    drawn = new(figsize=(WIDTH, sum(heights)), layout="constrained", facecolor=palette()["paper"])
    with mpl.rc_context(style()):
        if title:
            drawn.suptitle(title, x=0.02, ha="left", weight="bold")
        grid = iter(drawn.add_gridspec(len(heights), 1, height_ratios=heights))
        for figure in figures:
            slots = slots_of(figure)
            place: Axes | None = None
            for index, panel in enumerate(figure.panels):
                heading, legend, shared = "", True, None
                if index == 0 and len(figures) > 1:
                    heading = figure.title
                if place is not None:
                    above = figure.panels[index - 1]
                    legend = not _labels(panel) <= _labels(above)
                    if _same_range(above, panel):
                        place.set_xlabel("")
                        place.tick_params(labelbottom=False)
                        shared = place
                place = drawn.add_subplot(next(grid), sharex=shared)
                shown = panel.model_copy(update={"title": _panel_title(figure, index, heading)})
                paint(place, shown, slots, legend=legend)
                step(1)
    return drawn


def _panel_title(figure: Figure, index: int, heading: str = "") -> str:
    """Return the title of a panel of a figure, with a letter such as ``(a)`` if there are several panels.

    ``heading`` is used as the title of a panel that has none.
    """
    title = figure.panels[index].title or heading
    if len(figure.panels) == 1:
        return title
    return f"({ascii_lowercase[index % 26]}) {title}".rstrip()


def _same_range(panel: Panel, other: Panel) -> bool:
    """Return whether the horizontal axes of two panels have the same quantity and nearly the same range."""
    if panel.equal_aspect or panel.x_label != other.x_label or panel.x_categories != other.x_categories:
        return False
    first, second = (
        _array([v for trace in one.traces for v in trace.x if v is not None]) for one in (panel, other)
    )
    if not len(first) or not len(second):
        return False
    ends = np.array([[values.min(), values.max()] for values in (first, second)])
    return bool(np.all(np.abs(ends[0] - ends[1]) < 0.01 * np.ptp(ends)))


def _labels(panel: Panel) -> set[str]:
    parts: list[Any] = [*panel.traces, *panel.spans, *panel.marks]
    return {part.label for part in parts}


def write(
    path: Path, figures: Sequence[Figure], *, title: str, step: Callable[[int], None] = lambda amount: None
) -> None:
    """Write figures on a white background to an ``.svg`` or ``.png`` file, completely or not at all."""
    kind = path.suffix.lower().removeprefix(".")
    metadata = {"svg": {"Date": None, "Creator": SOFTWARE}, "png": {"Software": SOFTWARE}}[kind]
    with mpl.rc_context({**style(), "svg.fonttype": "path"}):
        drawn = canvas(figures, title=title, step=step)
        with atomic.replace_file(path) as temporary:
            drawn.savefig(temporary, format=kind, dpi=DPI, metadata=metadata)
            if kind == "svg":
                temporary.write_text(
                    _number_clips(temporary.read_text(encoding="utf-8"), ""), encoding="utf-8"
                )


def _number_clips(text: str, prefix: str) -> str:
    """Replace the ids of the clip paths in the text of an SVG file by a prefix and a serial number.

    matplotlib derives the ids from addresses in memory, which differ between runs.
    """
    names = dict.fromkeys(re.findall(r'<clipPath id="(p[0-9a-f]{10})"', text))
    ids = [f"p{hashlib.sha256(f'{prefix}{k}'.encode()).hexdigest()[:10]}" for k in range(len(names))]
    new = dict(zip(names, ids, strict=True))
    return re.sub(r"\bp[0-9a-f]{10}\b", lambda found: new.get(found[0], found[0]), text)


def for_notebook(figure: Figure) -> str:
    """Return a figure as a picture (PNG) in an HTML element, on a white background."""
    file = io.BytesIO()
    with mpl.rc_context(style()):
        canvas([figure]).savefig(file, format="png", dpi=NOTEBOOK_DPI)
    text = base64.b64encode(file.getvalue()).decode()
    return f'<img alt="{escape(figure.title, quote=True)}" src="data:image/png;base64,{text}">'


# ---------------------------------------------------------------- on a page


def for_page(figure: Figure, prefix: str) -> list[str]:
    """Draw each panel of a figure as an SVG element of an HTML page, and return the elements.

    The ids in the elements depend on ``prefix``, which must differ between the figures of a page.
    """
    drawings = []
    slots = slots_of(figure)
    for index, panel in enumerate(figure.panels):
        page: Any = {"svg.fonttype": "none", "figure.facecolor": "none", "svg.hashsalt": f"{prefix}{index}"}
        with mpl.rc_context({**style(), **page}):
            drawn = Canvas(figsize=(WIDTH, _height(panel)))
            shown = panel.model_copy(update={"title": _panel_title(figure, index)})
            paint(drawn.add_subplot(), shown, slots, compact=True)
            file = io.StringIO()
            drawn.savefig(file, format="svg", metadata={"Date": None, "Creator": None})
        names = ", ".join(trace.label for trace in panel.traces if trace.label)
        title = ": ".join(filter(None, [figure.title, panel.title]))
        about = f"{title}. {panel.y_label} over {panel.x_label}. {names}"
        drawings.append(_inline(_number_clips(file.getvalue(), f"{prefix}{index}-"), about))
    return drawings


def _inline(text: str, about: str) -> str:
    """Convert the text of an SVG file into an element of an HTML page.

    The style sheet, the metadata and ids without a reference are removed. Colours and fonts become those of
    the page. Coordinates are rounded to a tenth of a point. Only tags are changed, never the text between
    tags. ``about`` describes the drawing for screen readers.
    """
    text = re.sub(r"<(metadata|style)\b.*?</\1>|<!--.*?-->", "", text[text.index("<svg") :], flags=re.DOTALL)
    text = re.sub(r"<[^>]*>", _tag, text)
    text = re.sub(r">\s+<", "><", re.sub(r"<defs>\s*</defs>", "", text))
    box = "".join(re.findall(r'viewBox="[^"]+"', text)[:1])
    inside = text[text.index(">") + 1 :].strip()
    frame = f'xmlns="http://www.w3.org/2000/svg" {box}'
    return f'<svg {frame} role="img" aria-label="{escape(about, quote=True)}">{inside}'


def _tag(match: re.Match[str]) -> str:
    # Remove the ids of an SVG tag, except those of markers and clip paths, which are a letter and a hash.
    # matplotlib refers to no other ids.
    tag = re.sub(r' id="(?![a-z][0-9a-f]{10}")[^"]*"', "", match[0]).replace("xlink:href", "href")
    for name, colour in palette().items():
        tag = tag.replace(colour, f"var(--{name})".replace("var(--ink)", "currentColor"))
    tag = re.sub(r"font: (?:\w+ )?([\d.]+)px [^;\"]*", r"font-size: \1px", tag)
    tag = re.sub(r"font-family: [^;\"]*;? ?", "", tag)
    tag = re.sub(r'\bd="([^"]+)"', lambda m: f'd="{_path(m[1])}"', tag)
    return re.sub(r"(\d\.\d{2})\d+", r"\1", tag)


def _path(path: str) -> str:
    """Shorten the data of an SVG path: round its coordinates to a tenth of a point and remove spaces."""
    path = re.sub(r"-?\d+\.\d+(?:e-?\d+)?", lambda m: f"{float(m[0]):.1f}".removesuffix(".0"), path)
    return re.sub(r"\s*([MLCQz])\s*", r"\1", path.strip())
