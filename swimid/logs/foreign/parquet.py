"""Parquet files."""

from __future__ import annotations

from pathlib import Path

from swimid.files import parquet
from swimid.logs import log
from swimid.logs.foreign.base import Options, Reader, Table


def _open(path: Path, options: Options) -> Table:
    import pyarrow.parquet

    table, types = pyarrow.parquet.read_table(path), pyarrow.types
    nested = [f.name for f in table.schema if types.is_nested(f.type) or types.is_binary(f.type)]
    notes = [f"columns that hold no plain values left out: {', '.join(nested)}"] if nested else []
    stored = (table.schema.metadata or {}).get(b"swimid", b"")
    frame = table.drop_columns(nested).to_pandas(ignore_metadata=True)
    return Table(
        log.arrays(frame, str(path)), notes=notes, comments=stored.decode("utf-8", "replace").splitlines()
    )


READER = Reader("parquet", "Parquet file", parquet.ENDINGS, _open, magic=(b"PAR1",), extra="parquet")
