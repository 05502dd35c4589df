"""Rows of several instances in one table: two sensors, two animals, two tags."""

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


def chosen(table: Table, where: Mapping[str, Any], rows: int, path: Path) -> NDArray[np.bool_]:
    """Return which rows to take, shape (rows,): in each column of ``where`` they have one of the values.

    Raises
    ------
    InputError
        No row is left; lists the values that are there.
    """
    kept = np.ones(rows, dtype=bool)
    for key, wanted in where.items():
        name = table.column(key, path)
        values = table.columns[name]
        options = wanted if isinstance(wanted, list) else [wanted]
        if is_text(values):
            texts = np.array([str(cell).strip() for cell in values])
            hits = np.isin(texts, [str(option) for option in options])
        else:
            hits = np.isin(values, [float(option) for option in options])
        if not hits.any():
            there = ", ".join(map(str, _distinct(values)[:10]))
            raise InputError(f"has no row with {wanted}; it holds {there}", file=path, column=name)
        kept &= hits
    if not kept.any():
        raise InputError(f"no row fulfils all of 'where': {dict(where)}", file=path)
    return kept


def refuse_mixed(table: Table, time_s: Array, kept: NDArray[np.bool_], used: Set[str], path: Path) -> None:
    """Raise if the rows are those of several instances in turn.

    A column tells instances apart if it changes at most rows and has few values, and either the times are
    even within each value and uneven over all rows, or its name is that of an instance.

    Raises
    ------
    InputError
        Names the column and its values.
    """
    time = time_s[kept]
    if len(time) < 10:
        return
    for name, whole in table.columns.items():
        of_time = whole.dtype.kind == "M" or _TIME.fullmatch(name.strip()) is not None
        if name in used or len(whole) != len(kept) or of_time:
            continue
        values = whole[kept]
        if not is_text(values) and not np.all(values == np.round(values)):
            continue
        _, codes = np.unique(values.astype(str) if is_text(values) else values, return_inverse=True)
        count = int(codes.max()) + 1
        if not 2 <= count <= MAX_INSTANCES or np.mean(np.diff(codes) != 0) < 0.5:
            continue
        if np.bincount(codes).min() < 0.2 * len(codes) / count:
            continue
        even = all(_evenness(time[codes == k]) > 0.8 for k in range(count))
        if (even and _evenness(time) < 0.6) or _NAME.fullmatch(name.strip().lower()):
            shown = _distinct(values)[:10]
            raise InputError(
                f"its rows are those of {count} instances in turn: {', '.join(map(str, shown))}",
                file=path,
                column=name,
                hint=f"choose one in the mapping: where: {{{name}: {shown[0]}}}",
            )


def _evenness(time: Array) -> float:
    """Return the share of steps that lie within half of the median step."""
    steps = np.diff(time)
    usual = float(np.median(steps)) if len(steps) else 0.0
    return float(np.mean(np.abs(steps - usual) <= 0.5 * usual)) if usual > 0 else 0.0


def _distinct(values: NDArray[Any]) -> list[Any]:
    known = [value for value in dict.fromkeys(values.tolist()) if value is not None and value == value]
    return [int(value) if isinstance(value, float) and value == int(value) else value for value in known]
