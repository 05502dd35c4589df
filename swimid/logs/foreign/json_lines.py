"""JSON lines: one object a line, nested ones by dotted names."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from swimid.errors import InputError
from swimid.logs.foreign.base import Options, Reader, Table, flat, of_records

#: Fields nested deeper are left out.
DEEPEST = 20


def _open(path: Path, options: Options) -> Table:
    records, lines = [], []
    with path.open("rb") as stream:
        for at, line in enumerate(stream, start=1):
            if not line.strip():
                continue
            try:
                record = json.loads(line)
            except (ValueError, RecursionError) as error:
                raise InputError(f"is not JSON: {error}", file=path, line=at) from error
            if not isinstance(record, dict):
                hint = "a file of one JSON document must become one object a line"
                raise InputError("is no JSON object", file=path, line=at, hint=hint)
            records.append(dict(flat(record, DEEPEST)))
            lines.append(at)
    columns = of_records(records)
    if not columns:
        raise InputError("holds no samples", file=path)
    return Table(columns, lines=np.asarray(lines, dtype=np.int64))


READER = Reader("jsonl", "file of JSON lines", (".jsonl", ".ndjson", ".json"), _open, magic=(b'{"',))
