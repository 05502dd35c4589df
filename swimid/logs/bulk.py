"""Logs of many samples, written piece by piece."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from pyarrow import csv
from pyarrow import parquet as pq

from swimid.files import atomic, yamlio
from swimid.files.delimited import worked_ahead
from swimid.logs.log import PARQUET_ENDINGS

#: Samples a piece.
ROWS = 100_000
#: Pieces printed beside each other.
WORKERS = min(os.cpu_count() or 1, 4)


def write(
    path: str | Path,
    columns: Mapping[str, NDArray[np.float64]],
    metadata: Mapping[str, Any],
    *,
    step: Callable[[int], None] = lambda amount: None,
) -> None:
    """Write a log of numbers, whole or not at all; what :func:`swimid.logs.log.write` is for few.

    Parameters
    ----------
    path : path
        CSV, or Parquet by its ending.
    columns : mapping of str to ndarray, each shape (n,)
        ``t_s`` first. NaN becomes an empty cell, every other number keeps its last bit.
    metadata : mapping
        Plain values, one ``# key: value`` line each.
    step : callable
        Called with the number of samples of each piece.
    """
    path = Path(path)
    lines = [line for line in yamlio.dumps_flat(metadata).splitlines() if line.strip()]
    schema = pa.schema([(name, pa.float64()) for name in columns])
    with atomic.replacing(path) as temporary, temporary.open("wb") as stream:
        if path.suffix.lower() in PARQUET_ENDINGS:
            stored = schema.with_metadata({b"swimid": "\n".join(lines).encode()})
            # Measured numbers hardly ever repeat: a dictionary of them only costs time.
            with pq.ParquetWriter(stream, stored, use_dictionary=False, write_statistics=False) as writer:
                for table in _tables(columns, stored):
                    writer.write_table(table)
                    step(len(table))
            return
        stream.writelines(f"# {line}\n".encode() for line in lines)
        stream.write((",".join(columns) + "\n").encode())
        # Printing numbers is the slow part, and runs beside itself; the pieces stay in order.
        with ThreadPoolExecutor(WORKERS) as pool:
            for count, text in worked_ahead(pool, _printed, _tables(columns, schema), WORKERS):
                stream.write(text)
                step(count)


def _tables(columns: Mapping[str, NDArray[np.float64]], schema: pa.Schema) -> Iterator[pa.Table]:
    count = len(next(iter(columns.values())))
    for start in range(0, count, ROWS):
        piece = [pa.array(values[start : start + ROWS], from_pandas=True) for values in columns.values()]
        yield pa.Table.from_arrays(piece, schema=schema)


def _printed(table: pa.Table) -> tuple[int, pa.Buffer]:
    sink = pa.BufferOutputStream()
    csv.write_csv(table, sink, csv.WriteOptions(include_header=False))
    return len(table), sink.getvalue()
