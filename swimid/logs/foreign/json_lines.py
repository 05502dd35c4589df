"""JSON lines: one object a line, nested ones by dotted names."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Callable, Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from swimid.errors import InputError
from swimid.logs.foreign.base import Chunk, Column, Kind, Options, Reader, Source, dates, flat

#: Lines a piece.
ROWS = 50_000
#: Lines looked at to know the columns.
SAMPLE = 200
#: What is nested deeper is no number.
DEEPEST = 20


class JsonLinesSource(Source):
    """One file of JSON lines."""

    def __init__(self, path: Path, options: Options) -> None:
        self._path = path
        kinds: dict[str, Kind] = {}
        for _, record, _ in islice(self._records(), SAMPLE):
            for name, value in record.items():
                number = value is None or isinstance(value, int | float)
                if kinds.get(name) != "number" or not number:
                    kinds[name] = "number" if number else "time" if _is_date(value) else "text"
        if not kinds:
            raise InputError("holds no samples", file=path)
        columns = [Column(name, kind) for name, kind in kinds.items()]
        super().__init__(columns, steps=path.stat().st_size)
        self._lines: list[int] = []

    def _records(self) -> Iterator[tuple[int, dict[str, Any], int]]:
        """Line number, flat record and size of every line."""
        with self._path.open("rb") as stream:
            for at, line in enumerate(stream, start=1):
                if not line.strip():
                    continue
                try:
                    record = json.loads(line)
                except (ValueError, RecursionError) as error:
                    raise InputError(f"is not JSON: {error}", file=self._path, line=at) from error
                if not isinstance(record, dict):
                    raise InputError("is no JSON object", file=self._path, line=at)
                yield at, dict(flat(record, DEEPEST)), len(line)

    def chunks(self, names: Sequence[str], step: Callable[[int], None]) -> Iterator[Chunk]:
        """Pieces of :data:`ROWS` lines; what a line lacks is NaN."""
        times = {column.name for column in self.columns if column.kind == "time"}
        self._lines = []
        records = self._records()
        while piece := list(islice(records, ROWS)):
            self._lines += [at for at, _, _ in piece]
            yield {
                name: dates([record.get(name) for _, record, _ in piece])
                if name in times
                else self._numbers(name, piece)
                for name in names
            }
            step(sum(size for _, _, size in piece))

    def _numbers(self, name: str, piece: list[tuple[int, dict[str, Any], int]]) -> NDArray[np.float64]:
        values = np.full(len(piece), np.nan)
        for row, (at, record, _) in enumerate(piece):
            value = record.get(name)
            if isinstance(value, int | float):
                # a whole number of hundreds of digits is none that a sensor gives
                with contextlib.suppress(OverflowError):
                    values[row] = value
            elif value is not None:
                raise InputError(
                    f"'{str(value)[:40]}' is not a number", file=self._path, line=at, column=name
                )
        return values

    def lines(self, count: int) -> NDArray[np.int64]:
        """The line of each sample."""
        return np.asarray(self._lines[:count], dtype=np.int64)


def _is_date(value: Any) -> bool:
    return isinstance(value, str) and len(value) >= 10 and value[4:5] == "-" and value[7:8] == "-"


READER = Reader(
    "jsonl", "file of JSON lines", (".jsonl", ".ndjson", ".json"), JsonLinesSource, magic=(b'{"',)
)
