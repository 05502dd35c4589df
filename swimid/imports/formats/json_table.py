"""Reader of tables in JSON: a list of records, an object of columns, or one record in each line (JSON lines).

Nested records are columns with dotted names, and lists in a record are columns ``name[1]``, ``name[2]``, ...
The forms that pandas writes are read, too.
"""

from __future__ import annotations

import contextlib
import json
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from swimid.errors import InputError
from swimid.imports.table import MAX_ODD, ForeignTable, Format, ReaderOptions, choose_part, flat, of_records

_HINT = "a table in JSON is a list of records, an object of columns, or one record in each line"


def _read(path: Path, options: ReaderOptions, select: str | None) -> ForeignTable:
    text = path.read_bytes().decode(options.encoding or "utf-8-sig")
    lines, notes = None, []
    try:
        content = json.loads(text)
    except ValueError as error:
        records, broken = _read_json_lines(text)
        total = len(records) + len(broken)
        if len(broken) > max(1, MAX_ODD * total) or len(records) < 2:
            raise InputError(f"is no JSON: {error}", file=path, hint=_HINT) from error
        if broken:
            share = f"{len(broken)} of {total} lines"
            notes.append(f"{share} are no JSON and are left out (first: line {broken[0]})")
        content, lines = list(records.values()), np.array(list(records), dtype=np.int64)
    columns = _columns(choose_part(content, select, "table", path))
    if not columns:
        raise InputError("holds no table of numbers", file=path, hint=_HINT)
    longest = max(map(len, columns.values()))
    usual = [name for name, values in columns.items() if len(values) == longest]
    if len({name.partition(".")[0] for name in usual}) == 1:
        columns |= {name.partition(".")[2] or name: columns.pop(name) for name in usual}
    return ForeignTable(columns, notes=notes, lines=lines)


def _read_json_lines(text: str) -> tuple[dict[int, Any], list[int]]:
    """Return the records in JSON lines by line number, and the numbers of lines with other text."""
    records, broken = {}, []
    for at, line in enumerate(text.split("\n"), start=1):
        value = None
        with contextlib.suppress(ValueError):
            value = json.loads(line)
        if isinstance(value, dict | list):
            records[at] = value
        elif line.strip():
            broken.append(at)
    return records, broken


def _columns(value: Any, name: str = "") -> dict[str, NDArray[Any]]:
    """Return each list in a nested JSON value as a column, by its dotted name."""
    if isinstance(value, dict) and {"columns", "data"} <= value.keys():
        value = [dict(zip(value["columns"], row, strict=True)) for row in value["data"]]
    elif isinstance(value, dict) and value and all(key.isdecimal() for key in value):
        value = list(value.values())
    if isinstance(value, dict):
        parts = (_columns(inner, f"{name}.{key}".removeprefix(".")) for key, inner in value.items())
        return dict(chain.from_iterable(part.items() for part in parts))
    if not isinstance(value, list) or len(value) < 2:
        return {}
    return of_records([dict(flat(one, name=name)) for one in value])


JSON = Format(
    "json",
    "table in JSON",
    _read,
    endings=(".json", ".jsonl", ".ndjson"),
    magic=(b'{"', b"[{", b"{\n", b"[\n", b"{\r", b"[\r", b"{ ", b"[["),
)
