"""ULog recordings of PX4 autopilots, by ``pyulog``."""

from __future__ import annotations

import contextlib
import io
from pathlib import Path

from swimid.logs.foreign.base import Loaded, Options, Reader, one_of, reading


def _open(path: Path, options: Options) -> Loaded:
    from pyulog import ULog

    # the library prints what it thinks of a damaged file; stdout is for results
    with reading(path, "ULog file"), contextlib.redirect_stdout(io.StringIO()):
        log = ULog(str(path))
    several = {data.name for data in log.data_list if data.multi_id}
    topics = {f"{d.name}[{d.multi_id}]" if d.name in several else d.name: d for d in log.data_list}
    topic = one_of(options.topic, list(topics), file=path, what="topic", key="topic")
    values = {_field(name): column for name, column in topics[topic].data.items()}
    notes = [f"{len(log.dropouts)} dropouts while it was recorded"] if log.dropouts else []
    if log.file_corruption:
        notes.append("is damaged; what could be read of it was")
    return Loaded(values, metadata={"topic": topic}, notes=notes)


def _field(name: str) -> str:
    """``q[0]`` as ``q[1]``: columns count from 1 in every format.

    >>> _field("q[3]"), _field("timestamp")
    ('q[4]', 'timestamp')
    """
    base, bracket, index = name.partition("[")
    digits = index.rstrip("]")
    return f"{base}[{int(digits) + 1}]" if bracket and digits.isdecimal() else name


READER = Reader(
    "ulog", "ULog recording", (".ulg", ".ulog"), _open, magic=(b"ULog\x01\x12\x35",), extra="ulog"
)
