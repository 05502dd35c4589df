"""Text files of columns: comma, semicolon, tab, spaces; with a header line or without."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from swimid.errors import InputError
from swimid.files.delimited import MISSING, number_hint
from swimid.logs.foreign import layout
from swimid.logs.foreign.base import Chunk, Column, Options, Reader
from swimid.logs.foreign.layout import Layout

#: Bytes of the file that are parsed at a time; threads share them by columns.
BLOCK = 8 << 20
#: Blocks that are parsed while earlier ones are worked on.
AHEAD = 2
#: Rows of a wrong number of cells up to this share are left out; more of them are an error.
RAGGED = 0.01


class DelimitedSource:
    """One text file."""

    def __init__(self, path: Path, options: Options) -> None:
        self._path = path
        self._size = path.stat().st_size
        self.layout: Layout = layout.find(path, options)
        kinds = self.layout.kinds
        self.columns = [Column(name, kind) for name, kind in zip(self.layout.names, kinds, strict=True)]
        self.metadata: dict[str, Any] = {}
        self.comments = self.layout.comments
        self.scalars: dict[str, float] = {}
        self.notes = list(self.layout.notes)
        self.steps: int | None = self._size
        self._ragged: list[str] = []
        self._unbroken = False

    def chunks(self, names: Sequence[str], step: Callable[[int], None]) -> Iterator[Chunk]:
        """Pieces of :data:`BLOCK` bytes; dates where a column holds them, else numbers."""
        kinds = dict(zip(self.layout.names, self.layout.kinds, strict=True))
        dates = [name for name in names if kinds[name] != "number"]
        rows, lines = 0, 0
        self._ragged.clear()
        for table, count, taken in self._tables(names, dates):
            if table is not None:
                piece = {name: table.column(name).to_numpy() for name in names}
                for name in dates:
                    piece[name] = self._dates(name, piece[name], rows)
                if table.num_rows:
                    yield piece
                rows, lines = rows + table.num_rows, lines + count
            step(taken)
        self._unbroken = lines == rows
        self._report_ragged(rows)

    def _tables(
        self, names: Sequence[str], dates: Sequence[str]
    ) -> Iterator[tuple[pa.Table | None, int, int]]:
        """Blocks parsed one ahead of what is made of them, with their lines and bytes."""
        with ThreadPoolExecutor(1) as beside:
            waiting: deque[tuple[Future[pa.Table] | None, int, int]] = deque()
            for text, count, taken in layout.blocks(self._path, self.layout, BLOCK):
                blank = text.isspace()
                waiting.append(
                    (None if blank else beside.submit(self._parsed, text, names, dates), count, taken)
                )
                if len(waiting) > AHEAD:
                    yield _awaited(waiting.popleft())
            while waiting:
                yield _awaited(waiting.popleft())

    def _parsed(self, text: bytes, names: Sequence[str], dates: Sequence[str]) -> pa.Table:
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
                    column_types={name: pa.string() if name in dates else pa.float64() for name in names},
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
        first = self._ragged[0].strip()
        line = layout.line_of(self._path, self.layout, lambda text: text.strip() == first)
        cells = len(first.split(self.layout.delimiter))
        more = f" (and {len(self._ragged) - 1} more such lines)" if len(self._ragged) > 1 else ""
        if len(self._ragged) > max(1, RAGGED * rows):
            raise InputError(
                f"has {cells} cells where {len(self.layout.names)} columns are expected{more}",
                file=self._path,
                line=line,
                hint="give delimiter, header or skip_rows under 'reader:' of the mapping",
            )
        self.notes.append(
            f"{len(self._ragged)} of {rows + len(self._ragged)} lines have a wrong number of cells and are "
            f"left out (first: line {line})"
        )

    def _dates(self, name: str, cells: NDArray[Any], before: int) -> NDArray[Any]:
        import pandas as pd

        dates = pd.to_datetime(pd.Series(cells), errors="coerce", format="ISO8601", utc=True)
        bad = (dates.isna() & pd.notna(pd.Series(cells))).to_numpy(dtype=bool)
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
        return dates.dt.tz_localize(None).to_numpy(dtype="datetime64[ns]")

    def _explained(self, error: Exception, names: Sequence[str]) -> InputError:
        """The cell that is no number, found again by looking."""
        found = self.layout
        for number, cells in layout.rows(self._path, found):
            for name in names:
                at = found.names.index(name)
                if at < len(cells) and not layout.readable(cells[at], found):
                    return InputError(
                        f"'{cells[at].strip()[:40]}' is not a number",
                        file=self._path,
                        line=number,
                        column=name,
                        hint=number_hint(cells[at])
                        + ", or name what marks it under 'missing:' of the mapping",
                    )
        return InputError(f"cannot be parsed: {str(error).splitlines()[0]}", file=self._path)

    def lines(self, count: int) -> NDArray[np.int64]:
        """Line of each sample, blank and comment lines counted."""
        if self._unbroken:
            first = self.layout.first_line
            return np.arange(first, first + count, dtype=np.int64)
        skipped = {text.strip() for text in self._ragged}
        delimiter = self.layout.delimiter
        numbers = (
            number
            for number, cells in layout.rows(self._path, self.layout)
            if not skipped or delimiter.join(cells).strip() not in skipped
        )
        return np.fromiter(islice(numbers, count), dtype=np.int64)

    def close(self) -> None:
        """Nothing is held open between readings."""


def _awaited(one: tuple[Future[pa.Table] | None, int, int]) -> tuple[pa.Table | None, int, int]:
    table, count, taken = one
    return None if table is None else table.result(), count, taken


READER = Reader(
    "delimited", "delimited text file", (".csv", ".txt", ".tsv", ".dat", ".asc", ".log"), DelimitedSource
)
