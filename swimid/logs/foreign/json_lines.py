"""JSON lines: one object a line, nested ones by dotted names."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from swimid.errors import InputError
from swimid.logs.foreign.base import Chunk, Column, Options, Reader

#: Lines a piece.
ROWS = 50_000
#: Lines looked at to know the columns.
SAMPLE = 200


class JsonLinesSource:
    """One file of JSON lines."""

    def __init__(self, path: Path, options: Options) -> None:
        self._path, self._prefix = path, options.dataset
        kinds: dict[str, Literal["number", "time", "text"]] = {}
        for _, record, _ in islice(self._records(), SAMPLE):
            for name, value in record.items():
                number = value is None or isinstance(value, int | float)
                if kinds.get(name) != "number" or not number:
                    kinds[name] = "number" if number else "time" if _is_date(value) else "text"
        if not kinds:
            raise InputError("holds no samples", file=path)
        self.columns = [Column(name, kind) for name, kind in kinds.items()]
        self.metadata: dict[str, Any] = {}
        self.comments: list[str] = []
        self.scalars: dict[str, float] = {}
        self.notes: list[str] = []
        self.steps: int | None = path.stat().st_size
        self._lines: list[int] = []

    def _records(self) -> Iterator[tuple[int, dict[str, Any], int]]:
        """Line number, flat record and size of every line."""
        try:
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
                    flat: dict[str, Any] = {}
                    _flatten("", record, flat, 0)
                    yield at, flat, len(line)
        except OSError as error:
            raise InputError(f"cannot be read: {error.strerror or error}", file=self._path) from error

    def chunks(self, names: Sequence[str], step: Callable[[int], None]) -> Iterator[Chunk]:
        """Pieces of :data:`ROWS` lines; what a line lacks is NaN."""
        kinds = {column.name: column.kind for column in self.columns}
        self._lines = []
        records = self._records()
        while piece := list(islice(records, ROWS)):
            self._lines += [at for at, _, _ in piece]
            yield {name: self._column(name, kinds[name], piece) for name in names}
            step(sum(size for _, _, size in piece))

    def _column(self, name: str, kind: str, piece: list[tuple[int, dict[str, Any], int]]) -> NDArray[Any]:
        if kind == "time":
            import pandas as pd

            texts = pd.Series([record.get(name) for _, record, _ in piece], dtype=object)
            dates = pd.to_datetime(texts, errors="coerce", format="ISO8601", utc=True)
            return dates.dt.tz_localize(None).to_numpy(dtype="datetime64[ns]")
        values = np.full(len(piece), np.nan)
        for row, (at, record, _) in enumerate(piece):
            value = record.get(name)
            if isinstance(value, int | float):
                try:
                    values[row] = value
                except OverflowError:
                    values[row] = np.nan
            elif value is not None:
                raise InputError(
                    f"'{str(value)[:40]}' is not a number", file=self._path, line=at, column=name
                )
        return values

    def lines(self, count: int) -> NDArray[np.int64]:
        """The line of each sample."""
        return np.asarray(self._lines[:count], dtype=np.int64)

    def close(self) -> None:
        """Nothing is held open between readings."""


def _flatten(prefix: str, value: Any, flat: dict[str, Any], depth: int) -> None:
    if isinstance(value, dict) and depth < 20:
        for name, inner in value.items():
            _flatten(f"{prefix}.{name}" if prefix else str(name), inner, flat, depth + 1)
    elif isinstance(value, list) and depth < 20 and len(value) <= 100:
        for at, inner in enumerate(value, start=1):
            _flatten(f"{prefix}[{at}]", inner, flat, depth + 1)
    else:
        flat[prefix] = value


def _is_date(value: Any) -> bool:
    return isinstance(value, str) and len(value) >= 10 and value[4:5] == "-" and value[7:8] == "-"


READER = Reader(
    "jsonl", "file of JSON lines", (".jsonl", ".ndjson", ".json"), JsonLinesSource, magic=(b'{"',)
)
