"""Samples that are not taken: rows of other instances (sensors, animals, tags), and unlikely points."""

from __future__ import annotations

import re
from collections.abc import Mapping, Set
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from swimid.errors import InputError
from swimid.logs.foreign.base import Table, is_text

Array = NDArray[np.float64]
#: Largest number of instances in one table.
MAX_INSTANCES = 16
#: Names of columns that tell instances apart, and of columns that are part of a time.
_TIME = re.compile(r".*(time|stamp|date|n?sec(ond)?s?|nanosec)", re.I)
_NAME = re.compile(r"(.*[ _.])?(i|id|instance|instances|tag|track|individual|animal|sensor|marker|device)")
#: A tracked point with a likelihood below this is left empty; the default ``pcutoff`` of DeepLabCut.
MIN_LIKELIHOOD = 0.6
_LIKELIHOOD = re.compile(r"(?P<point>.+?)[ _.](likelihood|confidence|score|prob(ability)?)", re.I)
#: Coordinate of a point, behind its name.
_COORDINATE = r"[ _.]*(?i:[xyz]([ _.].*)?)"


def chosen(table: Table, where: Mapping[str, Any], rows: int, path: Path) -> NDArray[np.bool_]:
    """Return which rows to take, shape (rows,): in each column of ``where`` they have one of the values.

    Raises
    ------
    InputError
        No row is left; lists the values that are there.
    """
    import pandas as pd

    kept = np.ones(rows, dtype=bool)
    for key, wanted in where.items():
        name = table.column(key, path)
        values, options = table.columns[name], pd.Series(wanted)
        if is_text(values):
            hits = pd.Series(values).astype(str).str.strip().isin(options.astype(str)).to_numpy()
        else:
            hits = np.isin(values, pd.to_numeric(options, errors="coerce"))
        if not (kept & hits).any():
            there = ", ".join(_distinct(values[kept])[:10])
            raise InputError(f"has no row with {wanted}; it holds {there}", file=path, column=name)
        kept &= hits
    return kept


def find_mixed(table: Table, time_s: Array, kept: NDArray[np.bool_], used: Set[str]) -> tuple[str, list[str]]:
    """Return the column that tells apart several instances whose rows stand in turn, and its values; ("", [])
    if there is none.

    A column tells instances apart if it changes at most rows and has few values, and either the times are
    even within each value and uneven over all rows, or its name is that of an instance.
    """
    import pandas as pd

    time = time_s[kept]
    if len(time) < 10:
        return "", []
    for name, whole in table.columns.items():
        of_time = whole.dtype.kind == "M" or _TIME.fullmatch(name.strip()) is not None
        if name in used or len(whole) != len(kept) or of_time:
            continue
        values = whole[kept]
        if not is_text(values) and not np.all(values == np.round(values)):
            continue
        codes, found = pd.factorize(values, use_na_sentinel=False)
        count = len(found)
        if not 2 <= count <= MAX_INSTANCES or np.mean(np.diff(codes) != 0) < 0.5:
            continue
        if np.bincount(codes).min() < 0.2 * len(codes) / count:
            continue
        even = all(_evenness(time[codes == k]) > 0.8 for k in range(count))
        if (even and _evenness(time) < 0.6) or _NAME.fullmatch(name.strip().lower()):
            return name, _distinct(values)
    return "", []


def _evenness(time: Array) -> float:
    """Return the share of steps that lie within half of the median step."""
    steps = np.diff(time)
    usual = float(np.median(steps)) if len(steps) else 0.0
    return float(np.mean(np.abs(steps - usual) <= 0.5 * usual)) if usual > 0 else 0.0


def _distinct(values: NDArray[Any]) -> list[str]:
    """Return the values of a column in the order of their first appearance, without missing ones."""
    import pandas as pd

    # whole numbers are written without a decimal point
    known: list[str] = pd.Series(pd.unique(values)).dropna().convert_dtypes().astype(str).tolist()
    return known


def empty_unlikely(columns: dict[str, Array], sources: Mapping[str, str], minimum: float) -> dict[str, int]:
    """Empty the coordinates of unlikely points in place; return the number of samples by likelihood.

    A likelihood belongs to the coordinates that have the name of the same point, in the log or in the file.
    A sample without a likelihood counts as unlikely.

    >>> columns = {"x_px": np.array([1.0, 2.0]), "c": np.array([0.9, 0.1])}
    >>> empty_unlikely(columns, {"x_px": "nose_x", "c": "nose_likelihood"}, 0.6), columns["x_px"]
    ({'c': 1}, array([ 1., nan]))
    """
    emptied: dict[str, int] = {}
    for names in ({name: name for name in columns}, sources):
        for target, name in names.items():
            hit = _LIKELIHOOD.fullmatch(name)
            if hit is None or target in emptied:
                continue
            point = re.compile(re.escape(hit["point"]) + _COORDINATE)
            coordinates = [other for other, written in names.items() if point.fullmatch(written)]
            if not coordinates:
                continue
            unlikely = ~(columns[target] >= minimum)
            there = np.any([np.isfinite(columns[coordinate]) for coordinate in coordinates], axis=0)
            for coordinate in coordinates:
                columns[coordinate] = np.where(unlikely, np.nan, columns[coordinate])
            emptied[target] = int((unlikely & there).sum())
    return {target: count for target, count in emptied.items() if count}
