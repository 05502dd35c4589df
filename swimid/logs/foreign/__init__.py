"""File formats: a :class:`~swimid.logs.foreign.base.Reader` makes a table of a file.

Every reader in a module here is found by itself: the next format is one new file.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

from swimid.errors import InputError, suggestion
from swimid.files import yamlio
from swimid.logs.foreign.base import Options, Reader, Table, discover, first_bytes, reading
from swimid.logs.log import Log


@cache
def readers() -> dict[str, Reader]:
    """Return the reader of each file format by its name."""
    return discover(__name__, Reader)


def reader_of(path: Path, options: Options) -> Reader:
    """Return the format of a file: the one asked for, or by its first bytes, or by its ending.

    Raises
    ------
    InputError
        The file cannot be read, or there is no such format.
    """
    known, head = readers(), first_bytes(path, 512)
    if not head:
        raise InputError("is empty", file=path)
    if options.kind is None:
        begins = [r for r in known.values() if r.magic and head.startswith(r.magic)]
        ends = [r for r in known.values() if path.suffix.lower() in r.endings]
        return [*begins, *ends, known["delimited"]][0]
    if options.kind not in known:
        hint = suggestion(options.kind, list(known))
        raise InputError(f"there is no reader '{options.kind}'", file=path, hint=hint)
    return known[options.kind]


def open_table(given: str | Path | Log, options: Options | None = None) -> Table:
    """Read a file as a table, or take a log in memory as one.

    Raises
    ------
    InputError
        The file cannot be read, or its reader needs an extra that is not installed.
    """
    if isinstance(given, Log):
        return Table(dict(given.columns), comments=yamlio.dumps_flat(given.metadata).splitlines())
    path, options = Path(given), options or Options()
    reader = reader_of(path, options)
    with reading(path, reader.title, reader.extra):
        table = reader.open(path, options)
    if not table.columns:
        raise InputError("holds no samples", file=path)
    return table
