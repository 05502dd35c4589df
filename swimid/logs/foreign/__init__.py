"""Logs of other programs: one module per format behind :class:`~swimid.logs.foreign.base.Source`.

Every module here that has a ``READER`` is found by itself; the next format is one new file.
"""

from __future__ import annotations

import importlib
import pkgutil
from functools import cache
from pathlib import Path

from swimid.errors import InputError, suggestion
from swimid.files import yamlio
from swimid.logs.foreign.base import Loaded, Options, Reader, Source
from swimid.logs.log import Log


@cache
def readers() -> dict[str, Reader]:
    """Every format by its name."""
    found: dict[str, Reader] = {}
    for entry in pkgutil.iter_modules(__path__):
        module = importlib.import_module(f"{__name__}.{entry.name}")
        reader = getattr(module, "READER", None)
        if isinstance(reader, Reader):
            found[reader.name] = reader
    return found


def reader_of(path: Path, options: Options) -> Reader:
    """The format of a file: the one asked for, or by how the file begins, or by its ending.

    Raises
    ------
    InputError
        When the file cannot be read or the format asked for does not exist.
    """
    known = readers()
    try:
        with path.open("rb") as stream:
            head = stream.read(512)
    except OSError as error:
        hint = "check the path" if isinstance(error, FileNotFoundError) else None
        raise InputError(f"cannot be read: {error.strerror or error}", file=path, hint=hint) from error
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


def open_source(given: str | Path | Log, options: Options | None = None) -> Source:
    """Open a log of another program, or what is in memory already.

    Raises
    ------
    InputError
        When it cannot be read, or its reader needs an extra that is not installed.
    """
    if isinstance(given, Log):
        return Loaded(dict(given.columns), comments=yamlio.dumps_flat(given.metadata).splitlines())
    path, options = Path(given), options or Options()
    reader = reader_of(path, options)
    try:
        return reader.open(path, options)
    except ImportError as error:
        raise InputError(
            f"is a {reader.title}, and {error.name} to read it is not installed",
            file=path,
            hint=f"pip install 'swimid[{reader.extra}]'",
        ) from error
