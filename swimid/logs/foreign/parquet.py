"""Parquet files, row group by row group."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from swimid.errors import InputError
from swimid.logs.foreign.base import Chunk, Column, Options, Reader

#: Samples a piece.
ROWS = 500_000


def _kind(kind: pa.DataType) -> Literal["number", "time", "text"] | None:
    types = pa.types
    if types.is_integer(kind) or types.is_floating(kind) or types.is_boolean(kind) or types.is_decimal(kind):
        return "number"
    if types.is_timestamp(kind):
        return "time"
    return "text" if types.is_string(kind) or types.is_large_string(kind) else None


class ParquetSource:
    """One Parquet file."""

    def __init__(self, path: Path, options: Options) -> None:
        import pyarrow.parquet as pq

        self._path = path
        try:
            self._file = pq.ParquetFile(path)
            schema = self._file.schema_arrow
        except (pa.ArrowException, OSError) as error:
            raise _broken(path, error) from error
        rows = self._file.metadata.num_rows
        kinds = {field.name: _kind(field.type) for field in schema}
        self.columns = [Column(name, kind, rows) for name, kind in kinds.items() if kind is not None]
        left_out = [name for name, kind in kinds.items() if kind is None]
        self.notes = (
            [f"columns that hold no plain values left out: {', '.join(left_out)}"] if left_out else []
        )
        self.metadata: dict[str, Any] = {}
        stored = (schema.metadata or {}).get(b"swimid")
        self.comments = stored.decode("utf-8", "replace").splitlines() if stored else []
        self.scalars: dict[str, float] = {}
        self.steps: int | None = rows

    def chunks(self, names: Sequence[str], step: Callable[[int], None]) -> Iterator[Chunk]:
        """Pieces of :data:`ROWS` samples."""
        try:
            for batch in self._file.iter_batches(batch_size=ROWS, columns=list(dict.fromkeys(names))):
                yield {name: plain(batch.column(name)) for name in names}
                step(batch.num_rows)
        except (pa.ArrowException, OSError) as error:
            raise _broken(self._path, error) from error

    def lines(self, count: int) -> NDArray[np.int64] | None:
        """A Parquet file has no lines."""
        return None

    def close(self) -> None:
        """Close the file."""
        self._file.close()


def plain(values: pa.Array) -> NDArray[Any]:
    """An Arrow array as numpy: dates as ``datetime64[ns]``, numbers with nulls as NaN."""
    if pa.types.is_timestamp(values.type):
        return values.cast(pa.timestamp("ns")).to_numpy(zero_copy_only=False)
    if pa.types.is_decimal(values.type) or pa.types.is_boolean(values.type):
        values = values.cast(pa.float64())
    return values.to_numpy(zero_copy_only=False)


def _broken(path: Path, error: Exception) -> InputError:
    first = (str(error) or type(error).__name__).splitlines()[0]
    return InputError(f"is no readable Parquet file: {first}", file=path)


READER = Reader("parquet", "Parquet file", (".parquet", ".pq"), ParquetSource, magic=(b"PAR1",))
