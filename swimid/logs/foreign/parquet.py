"""Parquet files, row group by row group."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa
from numpy.typing import NDArray

from swimid.logs.foreign.base import Chunk, Column, Kind, Options, Reader, Source, reading

#: Samples a piece.
ROWS = 500_000


class ParquetSource(Source):
    """One Parquet file."""

    def __init__(self, path: Path, options: Options) -> None:
        import pyarrow.parquet as pq

        self._path = path
        with reading(path, "Parquet file"):
            self._file = pq.ParquetFile(path)
            schema = self._file.schema_arrow
        rows = self._file.metadata.num_rows
        kinds = {field.name: _kind(field.type) for field in schema}
        left_out = [name for name, kind in kinds.items() if kind is None]
        stored = (schema.metadata or {}).get(b"swimid", b"")
        super().__init__(
            [Column(name, kind, rows) for name, kind in kinds.items() if kind is not None],
            notes=[f"columns that hold no plain values left out: {', '.join(left_out)}"] if left_out else [],
            comments=stored.decode("utf-8", "replace").splitlines(),
            steps=rows,
        )

    def chunks(self, names: Sequence[str], step: Callable[[int], None]) -> Iterator[Chunk]:
        """Pieces of :data:`ROWS` samples."""
        with reading(self._path, "Parquet file"):
            for batch in self._file.iter_batches(batch_size=ROWS, columns=list(dict.fromkeys(names))):
                yield {name: _plain(batch.column(name)) for name in names}
                step(batch.num_rows)

    def close(self) -> None:
        """Close the file."""
        self._file.close()


def _kind(kind: pa.DataType) -> Kind | None:
    types = pa.types
    if types.is_integer(kind) or types.is_floating(kind) or types.is_boolean(kind) or types.is_decimal(kind):
        return "number"
    if types.is_timestamp(kind):
        return "time"
    return "text" if types.is_string(kind) or types.is_large_string(kind) else None


def _plain(values: pa.Array) -> NDArray[Any]:
    """An Arrow array as numpy: dates as ``datetime64[ns]``, numbers with nulls as NaN."""
    if pa.types.is_timestamp(values.type):
        values = values.cast(pa.timestamp("ns"))
    elif pa.types.is_decimal(values.type) or pa.types.is_boolean(values.type):
        values = values.cast(pa.float64())
    return values.to_numpy(zero_copy_only=False)


READER = Reader("parquet", "Parquet file", (".parquet", ".pq"), ParquetSource, magic=(b"PAR1",))
