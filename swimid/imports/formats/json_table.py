"""Reader of tables in JSON: a list of records, an object of columns, or one record in each line (JSON lines).

Nested records are columns with dotted names, and lists in a record are columns ``name[1]``, ``name[2]``, ...
The forms that pandas writes are read, too.
"""

from __future__ import annotations

import json
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from swimid.errors import InputError
from swimid.imports.table import MAX_ODD, ForeignTable, Format, ReaderOptions, choose, flat, of_records

_HINT = "a table in JSON is a list of records, an object of columns, or one record in each line"


def _read(path: Path, options: ReaderOptions, select: str | None) -> ForeignTable:
    text = path.read_bytes().decode(options.encoding or "utf-8-sig")
    lines, notes = None, []
    try:
        content = json.loads(text)
    except ValueError as error:
        filled = [
            (at, _parse_line(line)) for at, line in enumerate(text.split("\n"), start=1) if line.strip()
        ]
        broken = [at for at, value in filled if value is None]
        if len(broken) > max(1, MAX_ODD * len(filled)) or len(filled) - len(broken) < 2:
            raise InputError(f"is no JSON: {error}", file=path, hint=_HINT) from error
        if broken:
            share = f"{len(broken)} of {len(filled)} lines"
            notes.append(f"{share} are no JSON and are left out (first: line {broken[0]})")
        content = [value for _, value in filled if value is not None]
        lines = np.array([at for at, value in filled if value is not None], dtype=np.int64)
    for part in filter(None, (select or "").split(".")):
        if not isinstance(content, dict):
            raise InputError(f"holds no table '{select}'", file=path)
        content = content[choose(part, list(content), "table", path)]
    columns = _columns(content)
    if not columns:
        raise InputError("holds no table of numbers", file=path, hint=_HINT)
    longest = max(map(len, columns.values()))
    usual = [name for name, values in columns.items() if len(values) == longest]
    if len({name.partition(".")[0] for name in usual}) == 1:
        columns |= {name.partition(".")[2] or name: columns.pop(name) for name in usual}
    return ForeignTable(columns, notes=notes, lines=lines)


def _parse_line(line: str) -> Any:
    """Return the record in a line of JSON; None if the line is no record, for example if it is cut off."""
    try:
        value = json.loads(line)
    except ValueError:
        return None
    return value if isinstance(value, dict | list) else None


def _columns(value: Any, name: str = "") -> dict[str, NDArray[Any]]:
    """Return the columns of all lists in a value of JSON, with dotted names."""
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
