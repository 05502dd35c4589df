"""Functions that read comments, header and cells of CSV files, and that import the library for Parquet."""

from __future__ import annotations

import csv
import io
import re
import warnings
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from swimid.errors import InputError, extra_needed, nearest

if TYPE_CHECKING:
    import pandas as pd

#: Texts of table cells that are read as missing values. The file formats of swimid use only the empty cell.
MISSING = ["", "nan", "-nan", "NaN", "NAN", "NA", "null"]
#: Maximum number of column names that a message quotes, and pattern of the names that a message may quote.
MAX_QUOTED, _NAME = 30, re.compile(r"[\w .()/\[\]°²-]{1,60}")


def head(path: Path) -> tuple[list[str], str, int]:
    """Return the comment lines of a CSV file without ``#``, its header line, and the number of this line.

    Raises
    ------
    InputError
        If the file is not UTF-8 text, or ends before a header.
    """
    comments: list[str] = []
    with path.open("rb") as stream:
        for number, raw in enumerate(stream, start=1):
            if len(raw) > 1_000_000 or b"\x00" in raw or b"\r" in raw.rstrip():
                text = "is not text: a line has a NUL, a carriage return before its end, or more than 1 MB"
                raise InputError(text, file=path, line=number, hint="save the file as CSV with line feeds")
            try:
                line = raw.decode("utf-8-sig").strip()
            except UnicodeDecodeError as error:
                raise InputError("is not UTF-8 text", file=path, line=number) from error
            if line.startswith("#"):
                comments.append(line[1:])
            elif line:
                return comments, line, number
    if not comments:
        raise InputError("is empty", file=path)
    raise InputError("holds comments only, no header and no samples", file=path)


def column_names(header: str, path: Path, line: int) -> list[str]:
    """Return the column names in the header line of a CSV file.

    Raises
    ------
    InputError
        If the names are not separated by commas, or two names are equal.
    """
    names = [name.strip().strip('"') for name in header.split(",")]
    if len(names) == 1 and re.search(r"[;\t]", header):
        text = "columns must be separated by commas, not by semicolons or tabs"
        raise InputError(text, file=path, line=line)
    twice = find_repeated(names)
    if twice is not None:
        raise InputError("two columns have this name: rename one column", file=path, line=line, column=twice)
    return names


def find_repeated(names: Iterable[str]) -> str | None:
    """Return the first name that occurs twice in a list; None if all names differ.

    >>> find_repeated(["x", "y", "z", "y"])
    'y'
    """
    return next((name for name, count in Counter(names).items() if count > 1), None)


def parse(
    text: bytes,
    names: Sequence[str],
    types: type | Mapping[str, type],
    *,
    delimiter: str = ",",
    decimal: str = ".",
    missing: Sequence[str] = MISSING,
) -> pd.DataFrame:
    """Parse the lines below the header of a CSV file into a table with one row for each line with text.

    A line with too few cells has missing values at its end. A line with too many cells is left out. Every
    number is the floating-point number that is nearest to the text in its cell.

    Parameters
    ----------
    text : bytes
        Lines under the header, as UTF-8 text.
    names : sequence of str
        Names of all columns.
    types : type or mapping of str to type
        ``float`` or ``str``, for all columns or by column name. Columns without a given type get one from
        their cells.

    Raises
    ------
    ValueError
        If a cell in a column of numbers is not a number, or a quotation mark is not closed.
    """
    import pandas as pd

    try:
        with warnings.catch_warnings():
            # Ignore the warnings of pandas about too many cells in the first line and about mixed types in a
            # column.
            warnings.simplefilter("ignore")
            return pd.read_csv(
                io.BytesIO(text),
                sep=delimiter,
                decimal=decimal,
                header=None,
                names=names,
                index_col=False,
                dtype=types,
                keep_default_na=False,
                na_values=missing,
                on_bad_lines="skip",
                encoding_errors="replace",
            )
    except pd.errors.EmptyDataError:
        return pd.DataFrame(columns=names, dtype=float)


def count_cells(line: str, delimiter: str = ",") -> int:
    """Return the number of cells in a line of a CSV file; 0 if a quotation mark is not closed.

    >>> count_cells('1,,"2,3"')
    3
    """
    if '"' not in line:
        return line.count(delimiter) + 1
    try:
        return len(next(csv.reader([line], delimiter=delimiter, strict=True)))
    except csv.Error:
        return 0


def column_error(
    column: str, names: Sequence[str], path: Path, line: int | None, what: str = "this column is missing"
) -> InputError:
    """Return the error for a column that a table lacks, with the most similar existing column as a hint.

    The hint does not quote the first line of a file that is no table, because it may be confidential.
    """
    is_table = len(names) > 1 and all(map(_NAME.fullmatch, names))
    if not is_table and "t_s" not in names:
        return InputError(what, file=path, line=line, column=column, hint="is this file a table with commas?")
    hint = f"the file has: {', '.join(names[:MAX_QUOTED])}"
    if len(names) > MAX_QUOTED:
        hint += f", and {len(names) - MAX_QUOTED} more"
    if close := nearest(column, list(names)):
        hint = f"did you mean '{close}'? {hint}"
    return InputError(what, file=path, line=line, column=column, hint=hint)


def parse_number(text: str) -> float | None:
    """Return the number in a cell of a table; None if the text is not a number.

    >>> parse_number(" 1e-3 "), parse_number("1,5"), parse_number("1_0")
    (0.001, None, None)
    """
    if "_" in text or not text.isascii():
        # Reject digits with underscores and digits of other scripts, which only Python reads as numbers.
        return None
    try:
        return float(text)
    except ValueError:
        return None


def plain_text(cell: Any) -> Any:
    """Return a cell for a CSV file, with an apostrophe before text that a spreadsheet takes for a formula.

    >>> plain_text("=1+1"), plain_text("-0.5"), plain_text(-0.5), plain_text("ok")
    ("'=1+1", '-0.5', -0.5, 'ok')
    """
    if (
        isinstance(cell, str)
        and cell.startswith(("=", "+", "-", "@", "\t", "\r"))
        and parse_number(cell) is None
    ):
        return f"'{cell}"
    return cell


def number_hint(text: str) -> str:
    """Return the hint for the error that the text of a table cell is not a number."""
    if parse_number(text.replace(",", ".")) is not None:
        return "write the decimal point as a dot"
    return "leave the cell empty where the sample is missing"


PARQUET_ENDINGS = (".parquet", ".pq")


def pyarrow() -> Any:
    """Import the Parquet library ``pyarrow`` with ``pyarrow.parquet``, and return it.

    Raises
    ------
    UsageError
        If pyarrow is not installed.
    """
    with extra_needed("a Parquet file", "parquet"):
        import pyarrow.parquet
    return pyarrow
