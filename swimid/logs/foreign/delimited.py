"""Text files of columns: comma, semicolon, tab, blanks; with a header line or without."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from swimid.errors import InputError, first_line
from swimid.files.delimited import MISSING
from swimid.logs import units
from swimid.logs.foreign import layout
from swimid.logs.foreign.base import Options, Reader, Table

#: Largest share of rows with a wrong number of cells that are left out; with more the file is refused.
MAX_RAGGED = 0.01
_BLANKS, _EDGES = re.compile(rb"[ \t]+"), re.compile(rb"(?m)^ | (?=\r?$)")


def _open(path: Path, options: Options) -> Table:
    found = layout.find(path, options)
    text = _samples(path, found)
    ragged: list[str] = []
    wanted = [pa.float64() if number else pa.string() for number in found.numbers]
    try:
        parsed = _parse(text, found, wanted, ragged)
    except pa.ArrowInvalid:
        # some cell is no number: its column stays text, and is refused if a mapping asks for it
        ragged.clear()
        try:
            parsed = _parse(text, found, [pa.string()] * len(wanted), ragged)
        except pa.ArrowInvalid as error:
            raise InputError(f"cannot be parsed: {first_line(error)}", file=path) from error
    columns, stated = {}, dict(zip(found.names, found.units, strict=False))
    for name, number in zip(found.names, found.numbers, strict=True):
        cells = parsed.column(name)
        if pa.types.is_string(cells.type):
            columns[name] = _converted(cells.to_pandas(), found, number, name, stated)
        else:
            columns[name] = cells.to_numpy()
    rows = parsed.num_rows
    unbroken = text.count(b"\n") + (not text.endswith(b"\n")) == rows and found.comment.encode() not in text
    lines = np.arange(rows, dtype=np.int64) + found.first_line if unbroken else _lines(path, found, ragged)
    notes = [*found.notes, *_ragged(path, found, ragged, rows)]
    return Table(columns, units=stated, notes=notes, comments=found.comments, lines=lines)


def _samples(path: Path, found: layout.Layout) -> bytes:
    """Return the lines of samples as UTF-8 text, without comments."""
    text = path.read_bytes()
    if found.encoding not in ("utf-8", "ascii"):
        text = text.decode(found.encoding, "replace").encode()
    start = 0
    for _ in range(found.first_line - 1):
        start = text.index(b"\n", start) + 1
    text, mark = text[start:], found.comment.encode()
    if mark in text:
        text = b"\n".join(line for line in text.split(b"\n") if not line.lstrip().startswith(mark))
    return _EDGES.sub(b"", _BLANKS.sub(b" ", text)) if found.blanks else text


def _parse(text: bytes, found: layout.Layout, kinds: list[Any], ragged: list[str]) -> pa.Table:
    from pyarrow import csv

    def skip(row: Any) -> str:
        ragged.append(row.text)
        return "skip"

    return csv.read_csv(
        pa.BufferReader(text),
        read_options=csv.ReadOptions(column_names=found.names),
        parse_options=csv.ParseOptions(
            delimiter=found.delimiter,
            quote_char='"' if b'"' in text else False,
            invalid_row_handler=skip,
        ),
        convert_options=csv.ConvertOptions(
            column_types=dict(zip(found.names, kinds, strict=True)),
            null_values=[*MISSING, *found.missing],
            strings_can_be_null=True,
            decimal_point=found.decimal,
        ),
    )


def _converted(
    cells: Any, found: layout.Layout, number: bool, name: str, stated: dict[str, str]
) -> NDArray[Any]:
    """Return a column of text as numbers if each cell is a number, or a number with a unit; else as it is."""
    import pandas as pd

    known = cells.notna()
    plain = cells.str.strip()
    if number:
        numbers = pd.to_numeric(plain.str.replace(found.decimal, ".", regex=False), errors="coerce")
        if numbers.notna().equals(known):
            return numbers.to_numpy(dtype=float, na_value=np.nan)
    parts = plain[known].str.fullmatch(layout.QUANTITY)
    if known.any() and parts.all():
        split = plain[known].str.extract(f"^{layout.QUANTITY}$")
        names = {spelled: units.canonical(spelled) for spelled in split[1].unique()}
        quantities = [{q for q, table in units.UNITS.items() if unit in table} for unit in names.values()]
        shared = set.intersection(*quantities)
        if shared:
            table = units.UNITS[min(shared, key=list(units.UNITS).index)]
            values = np.full(len(cells), np.nan)
            first = next(iter(names.values()))
            factors = split[1].map({s: table[unit] / table[first] for s, unit in names.items()})
            values[known.to_numpy()] = split[0].astype(float) * factors
            stated[name] = first
            return values
    return cells.to_numpy(dtype=object, na_value=None)


def _lines(path: Path, found: layout.Layout, ragged: list[str]) -> NDArray[np.int64]:
    """Return the line of each sample; blank lines, comments and ragged lines are skipped."""
    skipped = {text.strip() for text in ragged}
    samples = layout.rows(path, found)
    numbers = (at for at, cells in samples if found.delimiter.join(cells).strip() not in skipped)
    return np.fromiter(numbers, dtype=np.int64)


def _ragged(path: Path, found: layout.Layout, ragged: list[str], rows: int) -> list[str]:
    """Return the note about rows with a wrong number of cells, or refuse the file for too many."""
    if not ragged:
        return []
    texts = {text.strip() for text in ragged}
    samples = layout.rows(path, found)
    line, cells = next(
        ((at, len(cells)) for at, cells in samples if found.delimiter.join(cells).strip() in texts), (None, 0)
    )
    if len(ragged) > max(1, MAX_RAGGED * rows):
        more = f" (and {len(ragged) - 1} more such lines)" if len(ragged) > 1 else ""
        raise InputError(
            f"has {cells} cells where {len(found.names)} columns are expected{more}",
            file=path,
            line=line,
            hint="give delimiter, header or skip_rows under 'reader:' of the mapping",
        )
    return [
        f"{len(ragged)} of {rows + len(ragged)} lines have a wrong number of cells and are left out "
        f"(first: line {line})"
    ]


READER = Reader("delimited", "delimited text file", (".csv", ".txt", ".tsv", ".dat", ".asc", ".log"), _open)
