"""Table that a reader of foreign files returns, and functions that several readers use."""

from __future__ import annotations

import codecs
import contextlib
import re
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import chain
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from swimid.errors import (
    InputError,
    file_errors,
    suggestion,
)
from swimid.files import yamlio
from swimid.files.tabular import MISSING
from swimid.logs import log
from swimid.logs.units import UNITS, canonical, quantity_of, safe, unit_factor

Array = NDArray[np.float64]


#: Name of the file that describes a bag of ROS 2, in the folder of the bag.
BAG_INFORMATION = "metadata.yaml"
#: Maximum length of a list in a record whose elements become columns of a table. Longer lists are left out.
MAX_ELEMENTS = 100


class ReaderOptions(yamlio.Document):
    """Layout of a foreign file, as far as the user states it (key ``reader:`` of a mapping)."""

    #: Delimiter of a text file: one character, ``tab`` or ``whitespace``.
    delimiter: Annotated[str, Field(pattern=r"^([ !#-~\t]|tab|whitespace)$")] | None = None
    #: Whether a header line with column names precedes the samples in a text file.
    header: bool | None = None
    #: Number of lines before the header, or before the samples if there is no header.
    skip_rows: Annotated[int, Field(ge=0)] | None = None
    #: ``skip`` leaves out all lines with a wrong number of cells. By default a file with more than a few such
    #: lines is refused.
    bad_lines: Literal["skip"] | None = None
    #: Contents of cells that mark a missing sample, in addition to the empty cell and ``nan``.
    missing: list[float | str] = []
    #: Character or characters with which a comment line begins.
    comment: Annotated[str, Field(min_length=1, max_length=4)] = "#"
    decimal: Literal[".", ","] | None = None
    encoding: str | None = None
    #: Unit of lengths, for a file that does not state one.
    length_unit: str | None = None


@dataclass(eq=False)
class ForeignTable:
    """Content of one file, or of one topic in a file: samples, units and metadata.

    Attributes
    ----------
    columns : dict of str to ndarray, each shape (n,)
        Columns in the order of the file: numbers, dates (``datetime64[ns]``, UTC) or text (``object``). The
        columns of a matrix ``acc`` are ``acc[1]``, ``acc[2]``, ...
    units : dict of str to str
        Units that the file states, by column.
    metadata : dict
        Metadata of the file: text and single values that describe it.
    scalars : dict of str to float
        Single numbers in the file, such as a sampling rate.
    notes : list of str
        Problems found while the file was read, for the user.
    comments : list of str
        Text of the comment lines, without the comment character.
    lines : ndarray of int, shape (n,), or None
        Line number of each row in the file, from 1; None for a file without lines.
    profile : str
        Name of the profile that read the file; empty without a profile.
    keys : dict of str to ndarray, each shape (n,)
        Columns that are no part of the log, by which ``where:`` of a mapping chooses rows.
    names : list of str
        Names of all columns in the file; empty if these are the columns in ``columns``.
    before : int
        Number of rows in the file that precede those of the table.
    after : int
        Number of rows in the file that follow those of the table.
    rest : callable or None
        Function ``rest(names)`` that yields the rows after those of the table, in further tables with only
        the given columns; None if the table has all rows.
    asked : dict of str to str
        Options of the reader that a mapping must state, each with the reason.
    """

    columns: dict[str, NDArray[Any]]
    units: dict[str, str] = field(default_factory=dict)
    metadata: dict[str, Any] = field(default_factory=dict)
    scalars: dict[str, float] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    comments: list[str] = field(default_factory=list)
    lines: NDArray[np.int64] | None = None
    profile: str = ""
    keys: dict[str, NDArray[Any]] = field(default_factory=dict)
    names: list[str] = field(default_factory=list)
    before: int = 0
    after: int = 0
    rest: Callable[[list[str]], Iterator[ForeignTable]] | None = None
    asked: dict[str, str] = field(default_factory=dict)

    def batches(self, names: list[str]) -> Iterator[ForeignTable]:
        """Yield this table, and then the rows of the file that follow, with only the columns ``names``."""
        yield self
        if self.rest is not None:
            yield from map(convert_text, self.rest(names))

    def whole(self) -> ForeignTable:
        """Return the table with all rows of the file."""
        pieces = list(self.batches(list(self.columns)))
        columns = {name: np.concatenate([one.columns[name] for one in pieces]) for name in self.columns}
        return replace(self, columns=columns, after=0, rest=None)

    def column(self, key: str | int, path: Path) -> str:
        """Return the name of the column to which a key refers, which is a name or a number, counted from 1.

        Raises
        ------
        InputError
            There is no such column. The message suggests the most similar name.
        """
        known = list(self.columns)
        if self.rest is not None:
            known = self.names
        known = [*known, *self.keys]
        names = [*(self.names or self.columns), *self.keys]
        name = str(key)
        if isinstance(key, int) or (name not in known and name.isdecimal()):
            if not 1 <= int(name) <= len(names):
                raise InputError(f"has {len(names)} columns; column {key} does not exist", file=path)
            name = names[int(name) - 1]
        loose = [one for one in known if one.strip().lower() == name.strip().lower()]
        if name in known:
            return name
        if len(loose) == 1:
            return loose[0]
        hint = suggestion(name, known, "the file has")
        raise InputError("there is no such column", file=path, column=name, hint=hint)

    def place(self, row: int) -> dict[str, int]:
        """Return the place of a row in the file for an :class:`InputError`: line number, or row number."""
        return {"row": self.before + row + 1} if self.lines is None else {"line": int(self.lines[row])}


@dataclass(frozen=True)
class Peek:
    """Beginning of a file, by which a profile recognises the format of the file."""

    path: Path
    head: bytes

    @classmethod
    def of(cls, path: Path) -> Peek:
        """Read the beginning of a file.

        Raises
        ------
        InputError
            The file cannot be read, or is a folder that is no bag of ROS 2.
        """
        file = path
        if (path / BAG_INFORMATION).is_file():
            file = path / BAG_INFORMATION
        with file_errors(path), file.open("rb") as stream:
            return cls(path, stream.read(1 << 14))

    @cached_property
    def lines(self) -> list[str]:
        """First lines of the file if it is a text file; empty otherwise."""
        try:
            text = codecs.getincrementaldecoder("utf-8-sig")().decode(self.head)
        except UnicodeDecodeError:
            return []
        if "\x00" in text:
            return []
        return [line.rstrip("\r") for line in text.split("\n")]

    @cached_property
    def header(self) -> list[str]:
        """Cells of the first line, split at commas, without surrounding blanks and quotation marks."""
        return [cell.strip().strip('"') for cell in (self.lines or [""])[0].split(",")]

    def holds(self, *names: str) -> bool:
        """Return whether the file is HDF5 and contains data sets or groups with all given names."""
        if self.head.startswith(b"\x89HDF"):
            # Ignore a missing h5py and a damaged file here. The reader of HDF5 then raises the error.
            import h5py

            with h5py.File(self.path, "r") as file:
                return all(name in file for name in names)
        return False

    def fits(self, profile: Format) -> bool:
        """Return whether a profile recognises the file. A damaged file is refused by its reader instead."""
        with contextlib.suppress(Exception):
            return profile.recognises is not None and profile.recognises(self)
        return False


@dataclass(frozen=True)
class Format:
    """File format that can be read. A format with the attribute ``recognises`` is a profile.

    Attributes
    ----------
    name : str
        Name of the format, for the option ``--as``.
    title : str
        Name of the format in messages.
    open : callable
        Function ``open(path, options, select) -> Table``. ``select`` is the track, topic, struct or group to
        read, or None. :func:`open_table` converts the exceptions of a library to an :class:`InputError`.
    recognises : callable, optional
        Function ``recognises(peek) -> bool``. It returns whether a file has this format, judged by its
        content. Without this function the format is recognised by the first bytes or the file name extension.
    endings : tuple of str
        File name extensions of this format, with the dot.
    magic : tuple of bytes
        First bytes of a file of this format. The first bytes have precedence over the file name extension.
    extra : str
        Extra of swimid to install, such as ``"mcap"`` for ``pip install swimid[mcap]``.
    """

    name: str
    title: str
    open: Callable[[Path, ReaderOptions, str | None], ForeignTable]
    recognises: Callable[[Peek], bool] | None = None
    endings: tuple[str, ...] = ()
    magic: tuple[bytes, ...] = ()
    extra: str = ""


def is_text(values: NDArray[Any]) -> bool:
    """Return whether a column of a table holds text."""
    return values.dtype.kind in "USO"


#: Pattern of a number with separated groups of digits, such as 1,234.56.
GROUPED = r"[-+]?[1-9]\d{0,2}(,\d{3})+(\.\d*)?"
#: Maximum fraction of the cells of a column of numbers that may hold other text. Above this fraction, the
#: user must state which texts mark a missing sample. It is half of the fraction of rows that may be left out
#: of a usable log.
MAX_ODD = 0.05


def numbers_in(values: Any) -> tuple[Array, NDArray[np.bool_]]:
    """Return the numbers in a column of text, with NaN in all other cells, and flag cells with other text."""
    import pandas as pd

    cells = pd.Series(values).astype("string").str.strip()
    found = pd.to_numeric(cells, errors="coerce").to_numpy(dtype=float, na_value=np.nan)
    given = cells.notna() & ~cells.isin(MISSING)
    return found, np.isnan(found) & given.to_numpy(dtype=bool)


def convert_text(table: ForeignTable) -> ForeignTable:
    """Convert the columns of text in a table that hold numbers, or lists of numbers.

    Cells with other text become NaN if there are few of them (:data:`MAX_ODD`), and a note names them. Lists
    such as ``[0.1, 0.2]`` in the column ``p`` become the columns ``p[1]`` and ``p[2]``.
    """
    columns: dict[str, NDArray[Any]] = {}
    emptied: dict[tuple[int, ...], list[str]] = {}
    for name, values in table.columns.items():
        if not is_text(values):
            columns[name] = values
            continue
        found, odd = numbers_in(values)
        if odd.sum() > MAX_ODD * (odd.sum() + np.isfinite(found).sum()):
            columns |= _split_cells(name, values, table.units)
            continue
        columns[name] = found
        if odd.any():
            emptied.setdefault(tuple(np.flatnonzero(odd).tolist()), []).append(name)
    for rows, names in emptied.items():
        cells = table.columns[names[0]]
        places = [f"'{cells[row]}' in {in_words(table.place(row))}"[:80] for row in rows[:3]]
        text = f"cells that are no numbers are left empty, {len(rows)} of {len(cells)} in {', '.join(names)}"
        table.notes.append(f"{text}: {', '.join(places)}{', ...' * (len(rows) > 3)}")
    return replace(table, columns=columns)


def _split_cells(name: str, values: NDArray[Any], units: dict[str, str]) -> dict[str, NDArray[Any]]:
    """Return a column for each list element in a column of text; the column itself if it has no lists.

    If one unit follows each number in the cells, add it to ``units`` and return the numbers.
    """
    import pandas as pd

    cells = pd.Series(values).dropna().astype("string").str.strip()
    if cells.empty or not re.match(r"[\[(]|[-+.\d]+ ?[A-Za-z°µ%]", cells.iloc[0]):
        return {name: values}
    parts = cells.str.extract(r"^([-+\d.eE]+) ?([A-Za-z°µ%/]+\d?)$")
    if parts[1].nunique(dropna=False) == 1 and parts[1].notna().any():
        units[name] = str(parts[1].iloc[0])
        return {name: numbers_in(parts[0].reindex(range(len(values))))[0]}
    if not cells.str.fullmatch(r"[\[(][^\[\]()]*[\])]").all():
        return {name: values}
    parts = cells.str[1:-1].str.strip().str.split(r"\s*[,;]\s*|\s+", regex=True, expand=True)
    found = {f"{name}[{k + 1}]": numbers_in(parts[k].reindex(range(len(values))))[0] for k in parts}
    if len(found) > MAX_ELEMENTS or not all(np.isfinite(column).any() for column in found.values()):
        return {name: values}
    return found


def in_words(place: dict[str, int]) -> str:
    """Return the place of a row in a file as text, such as ``line 12``."""
    return " ".join(f"{kind} {number}" for kind, number in place.items())


def flat(
    value: Any, parts: Callable[[Any], Any] = lambda value: value, brackets: str = "[]", name: str = ""
) -> Iterator[tuple[str, Any]]:
    """Yield the single values of a nested record, each with its dotted name.

    Elements of lists are named ``name[1]``, ``name[2]``, ... Lists longer than :data:`MAX_ELEMENTS` are left
    out. ``parts`` converts a value that consists of several values to a dict or a list, and returns any other
    value unchanged.

    >>> dict(flat({"a": {"b": [1, 2]}, "c": 3}))
    {'a.b[1]': 1, 'a.b[2]': 2, 'c': 3}
    """
    value = parts(value)
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from flat(inner, parts, brackets, f"{name}.{key}".removeprefix("."))
    elif not isinstance(value, list | tuple):
        yield name, value
    elif len(value) <= MAX_ELEMENTS:
        for at, inner in enumerate(value, start=1):
            yield from flat(inner, parts, brackets, f"{name}{brackets[0]}{at}{brackets[1]}")


def of_records(records: Sequence[dict[str, Any]]) -> dict[str, NDArray[Any]]:
    """Convert flat records to columns of numbers, dates or text, with one row per record.

    A number is NaN where a record has no value.
    """
    import pandas as pd

    frame = pd.DataFrame.from_records(records)
    for name, values in frame.items():
        # Convert a column without text to floats. Such a column holds integers over 64 bits, or has no value
        # in some records.
        if values.dtype == object and not values.map(lambda value: isinstance(value, str)).any():
            frame[name] = pd.to_numeric(values, errors="coerce").astype(float)
    return log.arrays(frame, "records")


def choose(select: str | None, known: Sequence[str], what: str, path: Path) -> str:
    """Return the track, topic or group that the user selects; by default the only one in the file.

    Raises
    ------
    InputError
        There is no item of that name, or the file has several items and the user selects none of them.
    """
    if not known:
        raise InputError(f"holds no {what} with samples", file=path)
    if select is None and len(known) > 1:
        hint = f"--select with one of: {', '.join(known[:20])}"
        plural = re.sub("ys$", "ies", f"{what}s")
        raise InputError(f"holds {len(known)} {plural}; name one", file=path, hint=hint)
    if select is not None and select not in known:
        hint = suggestion(select, list(known), "the file holds")
        raise InputError(f"holds no {what} '{select}'", file=path, hint=hint)
    return select or known[0]


def choose_part(
    content: Any,
    select: str | None,
    what: str,
    path: Path,
    separators: str = ".",
    parts: Callable[[Any], Any] = lambda value: value,
) -> Any:
    """Return the part of nested dicts that ``select`` names; the whole content without a selection.

    ``parts`` is the argument of :func:`flat`.

    Raises
    ------
    InputError
        There is no such part.
    """
    for part in filter(None, re.split(f"[{separators}]", select or "")):
        if not isinstance(content, dict):
            raise InputError(f"holds no {what} '{select}'", file=path)
        content = parts(content[choose(part, list(content), what, path)])
    return content


def of_tree(content: Any, select: str | None, path: Path, parts: Callable[[Any], Any]) -> ForeignTable:
    """Return a table of the nested arrays in a file, or in the group of the file that ``select`` names.

    The columns of a matrix are named ``name[1]``, ``name[2]``, ... A row vector is one column. A matrix with
    more columns than rows is transposed if its number of columns is the usual length of the arrays. Single
    numbers become scalars, text becomes metadata. ``parts`` is the argument of :func:`flat`.

    Raises
    ------
    InputError
        There is no such group.
    """
    content = choose_part(parts(content), select, "struct or group", path, "/.", parts)
    if not isinstance(content, dict):
        content = {re.split("[/.]", str(select).strip("/."))[-1]: content}
    table, arrays = ForeignTable({}), {}
    for name, value in flat(content, parts, "{}"):
        array = np.atleast_1d(np.asarray(value))
        if isinstance(value, str) and value.strip():
            table.metadata[name] = value.strip()
        elif array.dtype.kind in "iufb" and array.ndim <= 2 and array.size:
            arrays[name] = array
    lengths = Counter(chain.from_iterable(set(values.shape) for values in arrays.values()))
    lengths[1] = 0
    longest = max(zip(lengths.values(), lengths, strict=True))[1]
    for name, values in arrays.items():
        matrix = values.reshape(len(values), -1)
        if len(matrix) == 1 or len(matrix) != longest == matrix.shape[1]:
            matrix = matrix.T
        if values.size == 1 and longest > 1:
            table.scalars[name] = float(values.item())
        elif matrix.shape[1] == 1:
            table.columns[name] = matrix[:, 0]
        else:
            table.columns |= {f"{name}[{k}]": part for k, part in enumerate(matrix.T, start=1)}
    return table


def restore_sign(values: Array, name: str, notes: list[str]) -> Array:
    """Return whole numbers with their sign, if they are negative numbers written as unsigned integers.

    A note on the column ``name`` is appended to ``notes``; any other column is returned unchanged. In two's
    complement of 16, 24 or 32 bits, small negative numbers are just below a power of two, and no number is
    near half of it. To distinguish them from single wrong values, the steps through zero must not exceed
    twice the steps elsewhere, or twice the range on the side of zero with the smaller range.

    >>> restore_sign(np.array([4.0, 1.0, 65534.0, 65531.0]), "speed", [])
    array([ 4.,  1., -2., -5.])
    >>> restore_sign(np.array([50000.0, 51000.0, 0.0, 52000.0]), "pressure", [])
    array([50000., 51000.,     0., 52000.])
    """
    top = np.max(values, initial=0.0, where=np.isfinite(values))
    bits = next((n for n in (16, 24, 32) if 0.75 * 2**n <= top < 2**n), 0)
    if not bits or np.nanmin(values) < 0:
        return values
    found = np.where(values >= 2.0 ** (bits - 1), values - 2.0**bits, values)
    known = found[np.isfinite(found)]
    if np.any(known % 1) or np.abs(known).max() >= 2.0 ** (bits - 2):
        return values
    low, steps, crosses = known.min(), np.abs(np.diff(known)), np.diff(known < 0)
    usual = max(steps.max(initial=0.0, where=~crosses), min(known.max(), -low))
    if low == -1 or not crosses.any() or steps[crosses].max() > 2 * usual:
        return values
    notes.append(f"unsigned integers of {bits} bits in '{name}' are read as negative (two's complement)")
    return found


def from_first(stamps: NDArray[np.datetime64]) -> tuple[Array, dict[str, Any]]:
    """Return the times since the first of some dates, s, and the metadata with the first one, s since 1970.

    Unknown dates (NaT) are replaced by the first date. If the first date is unknown, the metadata are empty.
    """
    metadata: dict[str, Any] = {}
    if not np.isnat(stamps[0]):
        metadata["first_stamp_s"] = float(stamps[0].astype("datetime64[ns]").astype(np.int64)) * 1e-9
    return np.nan_to_num((stamps - stamps[0]) / np.timedelta64(1, "s")), metadata


def length(unit: str | None, path: Path) -> tuple[float, str]:
    """Return the factor from a unit of length to SI or pixels, and the resulting unit, "m" or "px".

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


def in_si(name: str, unit: str, values: Array) -> tuple[str, Array]:
    """Return the name in the log of a channel whose unit the file states, and its values in SI units.

    A channel keeps its name and its values if its unit is unknown, or is a unit of several quantities (``g``,
    ``rpm``), unless the name of the channel states the quantity.

    >>> in_si("Fx 1", "mN", np.array([5.0])), in_si("load_kg", "g", np.array([2.0]))
    (('Fx_1_N', array([0.005])), ('load_kg', array([0.002])))
    >>> in_si("load", "g", np.array([2.0]))
    ('load', array([2.]))
    """
    known = canonical(unit)
    quantities = [quantity for quantity, units in UNITS.items() if known in units]
    if quantity_of(name) in quantities:
        return name, values * unit_factor(known, name)
    if len(quantities) != 1 or quantity_of(name) is not None:
        return name, values
    units = UNITS[quantities[0]]
    return f"{safe(name)}_{next(iter(units)).replace('/', '_')}", values * units[known]


def axes(source: str, target: str, letters: str = "xyz", names: str = "") -> dict[str, str]:
    """Return the column name in the log for each component of a vector, by the name in the file.

    >>> axes("Gyr{}", "w{}_rad_s", "XYZ", "xyz")
    {'GyrX': 'wx_rad_s', 'GyrY': 'wy_rad_s', 'GyrZ': 'wz_rad_s'}
    """
    pairs = zip(letters, names or letters, strict=True)
    return {source.format(letter): target.format(name) for letter, name in pairs}


def rename_columns(table: ForeignTable, names: Mapping[str, str]) -> dict[str, Array]:
    """Return the numeric columns of a table that ``names`` lists, by their names in the log.

    ``names`` maps names in the file to names in the log.
    """
    columns = table.columns
    found = [name for name in names if name in columns and not is_text(columns[name])]
    return {names[name]: columns[name].astype(float) for name in found}


def rows(table: ForeignTable, kept: NDArray[np.bool_]) -> ForeignTable:
    """Return a copy of a table with only the rows that ``kept`` flags."""
    lines = None if table.lines is None else table.lines[kept]
    return replace(table, columns={name: v[kept] for name, v in table.columns.items()}, lines=lines)


def numbers(
    path: Path, start: int, delimiter: str, width: int, *, most: int | None = None, decimal: str = "."
) -> tuple[Array, NDArray[np.int64]]:
    """Return the numbers in a text file after the first ``start`` lines, and their line numbers.

    The numbers have the shape (n, width). Empty cells become NaN, and cells beyond ``width`` are left out.
    ``most`` is the maximum number of lines to read.

    Raises
    ------
    InputError
        There are no numbers after the header, or the file ends within a line.
    """
    import pandas as pd

    with path.open("rb") as stream:
        stream.seek(max(0, path.stat().st_size - (1 << 16)))
        last = stream.read().rpartition(b"\n")[2]
    cells = last.count(delimiter.encode()) + 1
    if len(delimiter) == 1 and last.strip() and cells < width:
        text = f"ends within a line, after {cells} of {width} cells"
        raise InputError(text, file=path, hint="export or copy the file again")

    layout = {"sep": delimiter, "skiprows": start, "names": range(width), "index_col": False}
    form = {"decimal": decimal, "encoding_errors": "replace"}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", pd.errors.ParserWarning)  # of cells beyond the width
        table = pd.read_csv(path, skip_blank_lines=False, nrows=most, **layout, **form)
    table = table.apply(pd.to_numeric).dropna(how="all")
    if table.empty:
        raise InputError("holds no samples under its header", file=path)
    return table.to_numpy(dtype=float), table.index.to_numpy() + start + 1


def complete(path: Path, stated: str | int | None, held: int, line: int | None = None) -> None:
    """Raise an error if a file has fewer frames than its header states.

    ``stated`` is the number in the header, or None if there is none. ``held`` is the number of frames in the
    file, and ``line`` the line number of the last one.

    Raises
    ------
    InputError
        Frames are missing.
    """
    if stated is not None and held < int(stated):
        text = f"the header states {int(stated)} frames, but the file ends after {held}"
        raise InputError(text, file=path, line=line, hint="export or copy the file again")
