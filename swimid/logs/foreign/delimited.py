"""Text files of columns: comma, semicolon, tab, spaces; with a header line or without."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from swimid.errors import InputError, first_line
from swimid.files.delimited import MISSING, number_hint, worked_ahead
from swimid.logs.foreign import layout
from swimid.logs.foreign.base import Chunk, Column, Options, Reader, Source, dates

#: Bytes of the file that are parsed at a time; threads share them by columns.
BLOCK = 8 << 20
#: Blocks that are parsed while earlier ones are worked on.
AHEAD = 2
#: Rows of a wrong number of cells up to this share are left out; more of them are an error.
RAGGED = 0.01


class DelimitedSource(Source):
    """One text file."""

    def __init__(self, path: Path, options: Options) -> None:
        self._path = path
        self.layout = layout.find(path, options)
        super().__init__(
            [Column(*pair) for pair in zip(self.layout.names, self.layout.kinds, strict=True)],
            notes=list(self.layout.notes),
            comments=self.layout.comments,
            steps=path.stat().st_size,
        )
        self._ragged: list[str] = []
        self._unbroken = False

    def chunks(self, names: Sequence[str], step: Callable[[int], None]) -> Iterator[Chunk]:
        """Pieces of :data:`BLOCK` bytes; dates where a column holds them, else numbers."""
        kinds = {column.name: column.kind for column in self.columns}
        words = [name for name in names if kinds[name] != "number"]
        rows, lines = 0, 0
        self._ragged.clear()

        def parsed(block: tuple[bytes, int, int]) -> tuple[pa.Table | None, int, int]:
            text, count, taken = block
            return None if text.isspace() else self._parsed(text, names, words), count, taken

        with ThreadPoolExecutor(1) as beside:
            blocks = layout.blocks(self._path, self.layout, BLOCK)
            for table, count, taken in worked_ahead(beside, parsed, blocks, AHEAD):
                if table is not None:
                    piece = {name: table.column(name).to_numpy() for name in names}
                    for name in words:
                        piece[name] = self._dates(name, piece[name], rows)
                    if table.num_rows:
                        yield piece
                    rows, lines = rows + table.num_rows, lines + count
                step(taken)
        self._unbroken = lines == rows
        self._report_ragged(rows)

    def _parsed(self, text: bytes, names: Sequence[str], words: Sequence[str]) -> pa.Table:
        from pyarrow import csv

        found = self.layout
        try:
            return csv.read_csv(
                pa.BufferReader(text),
                read_options=csv.ReadOptions(block_size=len(text), column_names=found.names),
                parse_options=csv.ParseOptions(
                    delimiter=found.delimiter,
                    quote_char='"' if b'"' in text else False,
                    invalid_row_handler=self._skip,
                ),
                convert_options=csv.ConvertOptions(
                    include_columns=list(dict.fromkeys(names)),
                    column_types={name: pa.string() if name in words else pa.float64() for name in names},
                    null_values=[*MISSING, *found.missing],
                    strings_can_be_null=True,
                    decimal_point=found.decimal,
                ),
            )
        except pa.ArrowInvalid as error:
            raise self._explained(error, names) from error

    def _skip(self, row: Any) -> str:
        self._ragged.append(row.text)
        return "skip"

    def _report_ragged(self, rows: int) -> None:
        if not self._ragged:
            return
        first, delimiter, count = self._ragged[0].strip(), self.layout.delimiter, len(self._ragged)
        samples = layout.rows(self._path, self.layout)
        line = next((at for at, cells in samples if delimiter.join(cells).strip() == first), None)
        if count > max(1, RAGGED * rows):
            more = f" (and {count - 1} more such lines)" if count > 1 else ""
            cells = len(first.split(delimiter))
            raise InputError(
                f"has {cells} cells where {len(self.columns)} columns are expected{more}",
                file=self._path,
                line=line,
                hint="give delimiter, header or skip_rows under 'reader:' of the mapping",
            )
        self.notes.append(
            f"{count} of {rows + count} lines have a wrong number of cells and are left out "
            f"(first: line {line})"
        )

    def _dates(self, name: str, cells: NDArray[Any], before: int) -> NDArray[Any]:
        import pandas as pd

        found = dates(cells)
        bad = np.isnat(found) & pd.notna(cells)
        if bad.any():
            row = int(np.argmax(bad))
            lines = self.lines(before + row + 1)
            raise InputError(
                f"'{cells[row]}' is neither a number nor a date",
                file=self._path,
                line=int(lines[-1]),
                column=name,
                hint=number_hint(str(cells[row])),
            )
        return found

    def _explained(self, error: Exception, names: Sequence[str]) -> InputError:
        """The cell that is no number, found again by looking."""
        found = self.layout
        for number, cells in layout.rows(self._path, found):
            for name in names:
                at = found.names.index(name)
                if at < len(cells) and not found.readable(cells[at]):
                    hint = f"{number_hint(cells[at])}, or name what marks it under 'missing:' of the mapping"
                    text = f"'{cells[at].strip()[:40]}' is not a number"
                    return InputError(text, file=self._path, line=number, column=name, hint=hint)
        return InputError(f"cannot be parsed: {first_line(error)}", file=self._path)

    def lines(self, count: int) -> NDArray[np.int64]:
        """Line of each sample, blank and comment lines counted."""
        if self._unbroken:
            return np.arange(count, dtype=np.int64) + self.layout.first_line
        skipped = {text.strip() for text in self._ragged}
        samples = layout.rows(self._path, self.layout)
        numbers = (at for at, cells in samples if self.layout.delimiter.join(cells).strip() not in skipped)
        return np.fromiter(islice(numbers, count), dtype=np.int64)


READER = Reader(
    "delimited", "delimited text file", (".csv", ".txt", ".tsv", ".dat", ".asc", ".log"), DelimitedSource
)
