"""Parquet files."""

from __future__ import annotations

from pathlib import Path

from swimid.logs import log
from swimid.logs.foreign.base import Options, Reader, Table


def _open(path: Path, options: Options) -> Table:
    import pyarrow.parquet as pq
    from pyarrow.types import is_binary, is_nested

    table = pq.read_table(path)
    nested = [field.name for field in table.schema if is_nested(field.type) or is_binary(field.type)]
    notes = [f"columns that hold no plain values left out: {', '.join(nested)}"] if nested else []
    stored = (table.schema.metadata or {}).get(b"swimid", b"")
    frame = table.drop_columns(nested).to_pandas(ignore_metadata=True)
    return Table(
        log.arrays(frame, str(path)), notes=notes, comments=stored.decode("utf-8", "replace").splitlines()
    )


READER = Reader("parquet", "Parquet file", (".parquet", ".pq"), _open, magic=(b"PAR1",))
