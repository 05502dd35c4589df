"""Profiles of known formats. All profiles in the modules of this package are found automatically.

A profile recognises its files by their content. It knows the units, axes and conventions of its format, or
reads them in the file. It returns a table in SI with columns named as in the log format.
"""

from __future__ import annotations

import codecs
import contextlib
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache, cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from swimid.errors import InputError, in_words_of_the_caller, suggestion
from swimid.logs.foreign import Table, discover, first_bytes, is_text, open_table, reading
from swimid.logs.log import TIME
from swimid.logs.units import UNITS, canonical

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Peek:
    """Beginning of a file, by which a profile recognises its format."""

    path: Path
    head: bytes

    @classmethod
    def of(cls, path: Path) -> Peek:
        """Read the beginning of a file.

        Raises
        ------
        InputError
            The file cannot be read.
        """
        return cls(path, first_bytes(path, 1 << 14))

    @cached_property
    def lines(self) -> list[str]:
        """The first lines of a text file; empty for any other file."""
        try:
            text = codecs.getincrementaldecoder("utf-8-sig")().decode(self.head)
        except UnicodeDecodeError:
            return []
        if "\x00" in text:
            return []
        return [line.rstrip("\r") for line in text.split("\n")]

    @cached_property
    def header(self) -> list[str]:
        """The cells of the first line, separated by commas, without blanks around them."""
        return [cell.strip().strip('"') for cell in (self.lines or [""])[0].split(",")]

    def holds(self, *names: str) -> bool:
        """Return whether the file is HDF5 and has data sets or groups of these names."""
        if self.head.startswith(b"\x89HDF"):
            # if h5py is missing, the reader of HDF5 names the extra to install
            with contextlib.suppress(OSError, ImportError):
                import h5py

                with h5py.File(self.path, "r") as file:
                    return all(name in file for name in names)
        return False


@dataclass(frozen=True)
class Profile:
    """One known format.

    Attributes
    ----------
    name : str
        Name for ``--as``.
    title : str
        Name of the format in messages.
    recognises : callable
        ``recognises(peek) -> bool``: whether a file has this format.
    read : callable
        ``read(path, select, length_unit) -> Table``, in SI with columns named as in the log format.
        ``select`` is the track, individual, instance, topic or message type to take, and ``length_unit`` the
        unit of lengths in a file that states none. Both are None if the user states nothing. Times are in
        ``t_s``. A format without times has ``frame``, and the rate in ``scalars["rate_hz"]`` if the file
        states it.
    extra : str
        Optional dependency to install.
    magic : bytes
        First bytes of such a file.
    """

    name: str
    title: str
    recognises: Callable[[Peek], bool]
    read: Callable[[Path, str | None, str | None], Table]
    extra: str = ""
    magic: bytes = b""

    def table(self, path: Path, select: str | None = None, length_unit: str | None = None) -> Table:
        """Read a file; the arguments are those of ``read``.

        Raises
        ------
        InputError
            The file has another format, or it holds several tracks and the user selects none.
        """
        Peek.of(path)
        try:
            with reading(path, self.title, self.extra):
                return self.read(path, select, length_unit)
        except InputError as error:
            if error.hint is None:
                error.hint = in_words_of_the_caller(
                    f"the file is read as a {self.title}; --as names another format"
                )
            raise


def safe(name: str) -> str:
    """Return a name as letters, digits and underscores, beginning with a letter.

    >>> safe("tail tip"), safe("/hip/value"), safe("2nd")
    ('tail_tip', 'hip_value', 'p2nd')
    """
    words = re.sub(r"[^A-Za-z0-9]+", "_", name).strip("_")
    return words if words[:1].isalpha() else f"p{words}"


def length(unit: str | None, path: Path) -> tuple[float, str]:
    """Return the factor to SI and the unit of lengths, "m" or "px".

    Raises
    ------
    InputError
        The unit is None or empty, or no unit of length.
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
    """Return the names of the components of a vector in the file, each with its name in the log.

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
    """Return a table with some of its rows."""
    lines = None if table.lines is None else table.lines[kept]
    return replace(table, columns={name: v[kept] for name, v in table.columns.items()}, lines=lines)


def numbers(path: Path, start: int, delimiter: str, width: int) -> tuple[Array, NDArray[np.int64]]:
    """Return the numbers below ``start`` lines, shape (n, width), and their lines; NaN for empty cells.

    Raises
    ------
    InputError
        There are no numbers.
    """
    import pandas as pd

    layout = {"sep": delimiter, "skiprows": start, "names": range(width), "index_col": False}
    table = pd.read_csv(path, skip_blank_lines=False, **layout)
    table = table.apply(pd.to_numeric).dropna(how="all")
    if table.empty:
        raise InputError("holds no samples under its header", file=path)
    return table.to_numpy(dtype=float), table.index.to_numpy() + start + 1


def _has_time(peek: Peek) -> bool:
    """Return whether the first line without a comment names ``t_s``."""
    header = next((line for line in peek.lines if line.strip() and not line.startswith("#")), "")
    return TIME in [cell.strip().strip('"') for cell in header.split(",")]


#: The log format of swimid: columns are read under their own names.
SWIMID = Profile("swimid", "log of swimid", _has_time, lambda path, select, length_unit: open_table(path))


@cache
def known() -> dict[str, Profile]:
    """Return the profiles by their names."""
    return {**discover(__name__, Profile), SWIMID.name: SWIMID}


def find(path: Path, name: str | None = None) -> Profile | None:
    """Return the profile of a name, or without a name the one that recognises the file; None if none does.

    Raises
    ------
    InputError
        There is no profile of the name, or the file cannot be read.
    """
    if name:
        if name not in known():
            hint = suggestion(name, list(known()))
            raise InputError(f"there is no profile '{name}'", file=path, hint=hint)
        return known()[name]
    peek = Peek.of(path)
    begin = (profile for profile in known().values() if peek.head.startswith(profile.magic))
    return next((profile for profile in begin if profile.recognises(peek)), None)
