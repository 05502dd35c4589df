"""JSON lines: one object a line, nested ones by dotted names."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from swimid.errors import InputError
from swimid.logs.foreign.base import Options, Reader, Table, flat, of_records


def _open(path: Path, options: Options) -> Table:
    numbered = enumerate(path.read_bytes().split(b"\n"), start=1)
    lines = {at: line for at, line in numbered if line.strip()}
    records = []
    for at, line in lines.items():
        try:
            record = json.loads(line)
        except (ValueError, RecursionError) as error:
            raise InputError(f"is not JSON: {error}", file=path, line=at) from error
        if not isinstance(record, dict):
            hint = "a file of one JSON document must become one object a line"
            raise InputError("is no JSON object", file=path, line=at, hint=hint)
        records.append(dict(flat(record)))
    return Table(of_records(records), lines=np.array([*lines], dtype=np.int64))


READER = Reader("jsonl", "file of JSON lines", (".jsonl", ".ndjson", ".json"), _open, magic=(b'{"',))
