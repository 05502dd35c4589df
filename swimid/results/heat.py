"""Heat maps: a table of numbers, each in a cell that is shaded by its size."""

from __future__ import annotations

import math

from matplotlib.axes import Axes
from matplotlib.patches import Rectangle

from swimid.errors import InputError
from swimid.results import looks, numbers
from swimid.results.evidence import Heat
from swimid.results.looks import INK, PAPER, SERIES

#: The darkest shade still lets the number be read on it, on light and dark pages.
_DARKEST = 0.55
#: A range smaller than this is not spread over all shades.
_LEAST_SPAN = 3.0
#: Letters of a label; longer ones are cut.
_LETTERS = 22
#: Width of a letter in units of the font size.
_LETTER = 0.62


def check(heat: Heat, place: str) -> None:
    """Refuse a map whose rows do not fit together.

    Raises
    ------
    InputError
        Naming what differs.
    """
    if len(heat.values) != len(heat.rows):
        raise InputError(f"'values' has {len(heat.values)} rows for {len(heat.rows)} labels", column=place)
    for row in heat.values:
        if len(row) != len(heat.columns):
            raise InputError(
                f"a row of 'values' has {len(row)} numbers for {len(heat.columns)} columns", column=place
            )


def height(heat: Heat, font: float) -> float:
    """Height of the drawing, points."""
    return 2.1 * font * max(len(heat.rows), 1) + 7.5 * font


def draw(axes: Axes, heat: Heat, width: float, font: float) -> None:
    """Draw the cells, their numbers and the labels of rows and columns.

    Parameters
    ----------
    width, font : float
        Of the whole drawing and of its text, points.
    """
    known = [v for row in heat.values for v in row if v is not None]
    largest = max([*known, _LEAST_SPAN * heat.neutral])
    labels = [looks.shortened(name, _LETTERS) for name in heat.rows]
    left = _LETTER * font * max((len(name) for name in labels), default=0)
    pitch = (width - left - 20) / max(len(heat.columns), 1)
    # three digits and a point are the longest number
    size = min(font, max(pitch / (4.4 * _LETTER), 6.5))
    for i, row in enumerate(heat.values):
        for j, value in enumerate(row):
            if value is not None:
                corner = (j - 0.5, i - 0.5)
                if heat.scale == "linear":
                    shade = _evenly(value, min(known), max(known))
                else:
                    shade = _shade(value, heat.neutral, largest)
                axes.add_patch(Rectangle(corner, 1, 1, facecolor=SERIES[0], alpha=shade, lw=0, zorder=1))
            text = numbers.number(value, 2)
            axes.text(j, i, text, ha="center", va="center", fontsize=size, color=INK, zorder=3)
    for k in range(1, len(heat.columns)):
        axes.axvline(k - 0.5, color=PAPER, linewidth=1.5, zorder=2)
    for k in range(1, len(heat.rows)):
        axes.axhline(k - 0.5, color=PAPER, linewidth=1.5, zorder=2)
    columns = [looks.shortened(name, _LETTERS) for name in heat.columns]
    level = max((len(name) for name in columns), default=0) * _LETTER * font < pitch
    looks.label_columns(axes, columns, level=level)
    axes.set_yticks(range(len(labels)), labels)
    axes.tick_params(length=0)
    axes.grid(False)
    for spine in axes.spines.values():
        spine.set_visible(False)
    axes.set_xlim(-0.5, max(len(columns), 1) - 0.5)
    axes.set_ylim(max(len(labels), 1) - 0.5, -0.5)


def _shade(value: float, neutral: float, largest: float) -> float:
    """Opacity of a cell, by the logarithm of its value between ``neutral`` and ``largest``."""
    if value <= neutral:
        return 0.0
    return _DARKEST * math.log(value / neutral) / math.log(largest / neutral)


def _evenly(value: float, smallest: float, largest: float) -> float:
    """Opacity of a cell, by the place of its value between two others."""
    return _DARKEST * (value - smallest) / (largest - smallest) if largest > smallest else 0.0
