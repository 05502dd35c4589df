"""Readers of the file formats of other programs. A :class:`Format` reads a file into a :class:`ForeignTable`.

All formats in the modules of this package are found automatically. To add a format, add a module.

A profile is a format that recognises its files by their content. It knows the units, axes and conventions of
these files, or reads them from the file. It returns a table in SI units whose columns are named as in the log
format. Times are in the column ``t_s``. A format without times has a column ``frame``.
"""

from __future__ import annotations

import importlib
import pkgutil
from functools import cache
from pathlib import Path
from typing import Any

from swimid.errors import InputError, extra_needed, first_line, in_words_of_the_caller, suggestion
from swimid.files import isolated, yamlio
from swimid.imports.table import ForeignTable, Format, Peek, ReaderOptions, convert_text
from swimid.logs.log import Log


@cache
def formats() -> dict[str, Format]:
    """Return all file formats that the modules of this package define, by name."""
    objects: list[Any] = []
    for entry in pkgutil.iter_modules(__path__, f"{__name__}."):
        objects += vars(importlib.import_module(entry.name)).values()
    return {one.name: one for one in objects if isinstance(one, Format)}


def find_format(path: Path, name: str | None) -> Format:
    """Return the file format of a given name, or, without a name, the format that fits a file's content.

    Without a name, the format is the profile that recognises the content of the file. If no profile
    recognises it, the first bytes of the file and then its file name extension determine the format. If the
    name is None, no profile is considered.

    Raises
    ------
    InputError
        The file cannot be read or is empty, or there is no such format.
    """
    known, peek = formats(), Peek.of(path)
    if not peek.head:
        raise InputError("is empty", file=path)
    if name:
        if name not in known:
            raise InputError(f"there is no format '{name}'", file=path, hint=suggestion(name, list(known)))
        return known[name]
    # Try the profile of swimid's own log format last, because a log of another program may have a column
    # named like its time.
    for profile in sorted(known, key="swimid".__eq__) if name is not None else ():
        if peek.head.startswith(known[profile].magic or b"") and peek.fits(known[profile]):
            return known[profile]

    def rank(one: Format) -> int:
        begins, ends = peek.head.startswith(one.magic), path.suffix.lower() in one.endings
        # A ZIP archive may be of any format, so that the file name extension decides.
        return 2 * (begins and (ends or not peek.head.startswith(b"PK"))) + ends

    plain = [one for one in known.values() if one.recognises is None]
    return max([known["delimited"], *plain], key=rank)


def open_table(
    given: str | Path | Log,
    options: ReaderOptions | None = None,
    select: str | None = None,
    kind: str | None = None,
) -> ForeignTable:
    """Read a file as a table, or convert a log in memory to a table.

    For a long Parquet file, the table has only the first rows. ``ForeignTable.batches`` yields the following
    rows.

    ``select`` is the track, topic, struct or group to read, if the file holds several. ``kind`` is the name
    of a format, as in :func:`find_format`.

    Raises
    ------
    InputError
        The file cannot be read, or its format needs an extra that is not installed.
    """
    if isinstance(given, Log):
        comments = yamlio.dumps_flat(given.metadata).splitlines()
        return convert_text(ForeignTable(dict(given.columns), comments=comments))
    path = Path(given)
    found = find_format(path, kind)
    hint = None
    if found.recognises is not None:
        hint = in_words_of_the_caller(f"the file is read as a {found.title}; --as names another format")
    read, task = found.open, (path, options or ReaderOptions(), select)
    try:
        with extra_needed(f"reading this {found.title}", found.extra, file=path):
            if found.extra:
                table = isolated.run_isolated(read, *task, file=path)
            else:
                table = read(*task)
    except InputError as error:
        error.hint = error.hint or hint
        raise
    except Exception as error:
        text = f"is no readable {found.title}: {first_line(error)}"
        raise InputError(text, file=path, hint=hint or "export or copy the file again") from error
    if not table.columns:
        raise InputError("holds no samples", file=path)
    if found.recognises is not None:
        table.profile = found.name
    return convert_text(table)
