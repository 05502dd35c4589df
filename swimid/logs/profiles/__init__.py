"""Profiles of known formats. All profiles in the modules of this package are found automatically.

A profile is a format that recognises its files by their content. It knows the units, axes and conventions of
these files, or reads them from the file. It returns a table in SI units whose columns are named as in the log
format. Times are in the column ``t_s``. A format without times has a column ``frame``, and the frame rate is
in ``scalars["rate_hz"]`` if the file states it.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from swimid.errors import InputError
from swimid.logs.foreign import Table, is_text
from swimid.logs.units import UNITS, canonical

Array = NDArray[np.float64]


def safe(name: str) -> str:
    """Return a name that consists of letters, digits and underscores, and begins with a letter.

    >>> safe("tail tip"), safe("/hip/value"), safe("2nd")
    ('tail_tip', 'hip_value', 'p2nd')
    """
    words = re.sub(r"[^A-Za-z0-9]+", "_", name).strip("_")
    return words if words[:1].isalpha() else f"p{words}"


def length(unit: str | None, path: Path) -> tuple[float, str]:
    """Return the factor of a unit of length to SI, and the resulting unit, "m" or "px".

    Raises
    ------
    InputError
        The unit is None, empty, or not a unit of length.
    """
    factors = {"px": 1.0, **UNITS["length"]}
    name = canonical(unit or "")
    hint = f"add --length-unit with one of: {', '.join(factors)}"
    if not name:
        raise InputError("states no unit of length", file=path, hint=hint)
    if name not in factors:
        raise InputError(f"'{name}' is no unit of length", file=path, hint=hint)
    return factors[name], name if name == "px" else "m"


def axes(source: str, target: str, letters: str = "xyz", names: str = "") -> dict[str, str]:
    """Return the names of the components of a vector in the file, each with the column name in the log.

    >>> axes("Gyr{}", "w{}_rad_s", "XYZ", "xyz")
    {'GyrX': 'wx_rad_s', 'GyrY': 'wy_rad_s', 'GyrZ': 'wz_rad_s'}
    """
    pairs = zip(letters, names or letters, strict=True)
    return {source.format(letter): target.format(name) for letter, name in pairs}


def renamed(table: Table, names: Mapping[str, str]) -> dict[str, Array]:
    """Return the columns of numbers with these names in the file, under their names in the log."""
    columns = table.columns
    found = [name for name in names if name in columns and not is_text(columns[name])]
    return {names[name]: columns[name].astype(float) for name in found}


def rows(table: Table, kept: NDArray[np.bool_]) -> Table:
    """Return a table with only the rows flagged in ``kept``."""
    lines = None if table.lines is None else table.lines[kept]
    return replace(table, columns={name: v[kept] for name, v in table.columns.items()}, lines=lines)


def numbers(path: Path, start: int, delimiter: str, width: int) -> tuple[Array, NDArray[np.int64]]:
    """Return the numbers after the first ``start`` lines, shape (n, width), and their lines; NaN if empty.

    Raises
    ------
    InputError
        There are no numbers after the header.
    """
    import pandas as pd

    layout = {"sep": delimiter, "skiprows": start, "names": range(width), "index_col": False}
    table = pd.read_csv(path, skip_blank_lines=False, **layout)
    table = table.apply(pd.to_numeric).dropna(how="all")
    if table.empty:
        raise InputError("holds no samples under its header", file=path)
    return table.to_numpy(dtype=float), table.index.to_numpy() + start + 1
