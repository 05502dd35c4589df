"""Likelihoods of tracked points: a point that its tracker hardly believes is no measurement."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
#: A tracked point with a likelihood below this is left empty; the default ``pcutoff`` of DeepLabCut.
MIN_LIKELIHOOD = 0.6
_LIKELIHOOD = re.compile(r"(?P<point>.+?)[ _.](likelihood|confidence|score|prob(ability)?)", re.I)
_COORDINATE = re.compile(r"[xyz]([ _.].*)?", re.I)


def points(targets: Sequence[str], sources: Mapping[str, str]) -> dict[str, list[str]]:
    """Return the coordinates of each likelihood: ``{nose_likelihood: [nose_x_px, nose_y_px]}``.

    A likelihood belongs to the coordinates that have the name of the same point, in the log or in the file.

    >>> points(["x_px", "y_px", "c"], {"x_px": "nose_x", "y_px": "nose_y", "c": "nose_likelihood"})
    {'c': ['x_px', 'y_px']}
    """
    found: dict[str, list[str]] = {}
    for named in ({name: name for name in targets}, sources):
        for target, name in named.items():
            hit = _LIKELIHOOD.fullmatch(name)
            if hit is None or target in found:
                continue
            point = hit["point"]
            belongs = [
                other
                for other, written in named.items()
                if written[: len(point)] == point
                and _COORDINATE.fullmatch(written[len(point) :].lstrip(" _."))
            ]
            if belongs:
                found[target] = belongs
    return found


def empty(columns: dict[str, Array], of: Mapping[str, Sequence[str]], minimum: float) -> dict[str, int]:
    """Empty the coordinates of unlikely points in place; return the number of samples by likelihood.

    A sample without a likelihood counts as unlikely.
    """
    emptied: dict[str, int] = {}
    for name, coordinates in of.items():
        unlikely = ~(columns[name] >= minimum)
        there = np.any([np.isfinite(columns[c]) for c in coordinates], axis=0)
        for coordinate in coordinates:
            columns[coordinate] = np.where(unlikely, np.nan, columns[coordinate])
        if count := int((unlikely & there).sum()):
            emptied[name] = count
    return emptied
