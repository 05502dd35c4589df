"""ULog recordings of PX4 autopilots, by ``pyulog``."""

from __future__ import annotations

import contextlib
import io
import re
from pathlib import Path
from typing import Any

from swimid.errors import InputError
from swimid.logs.foreign.base import Options, Reader, Table, one_of, reading

MAGIC = b"ULog\x01\x12\x35"


def _load(path: Path) -> tuple[Any, dict[str, Any]]:
    """Return the recording and its topics by name; several instances of one are ``name[0]``, ``name[1]``."""
    with reading(path, "ULog recording", "ulog"), contextlib.redirect_stdout(io.StringIO()):
        # the library prints warnings about a damaged file; stdout is for results
        from pyulog import ULog

        log = ULog(str(path))
    several = {data.name for data in log.data_list if data.multi_id}
    return log, {f"{d.name}[{d.multi_id}]" if d.name in several else d.name: d for d in log.data_list}


def topics(path: Path) -> list[str]:
    """Return the topics of a recording; none if it cannot be read."""
    with contextlib.suppress(InputError):
        return list(_load(path)[1])
    return []


def _open(path: Path, options: Options) -> Table:
    log, topics = _load(path)
    topic = one_of(options.topic, list(topics), file=path, what="topic")
    values = {_field(name): column for name, column in topics[topic].data.items()}
    notes = [f"{len(log.dropouts)} dropouts while it was recorded"] if log.dropouts else []
    if log.file_corruption:
        notes.append("the file is damaged; its readable part was read")
    return Table(values, metadata={"topic": topic}, notes=notes)


def _field(name: str) -> str:
    """Return ``q[0]`` as ``q[1]``: columns count from 1 in every format.

    >>> _field("q[3]"), _field("timestamp")
    ('q[4]', 'timestamp')
    """
    return re.sub(r"\[(\d+)\]$", lambda index: f"[{int(index[1]) + 1}]", name)


READER = Reader("ulog", "ULog recording", (".ulg", ".ulog"), _open, magic=(MAGIC,), extra="ulog")
