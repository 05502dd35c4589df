"""Reader of ULog recordings, and of their topics of PX4, by the library pyulog.

The axes of PX4 are forward, right, down (body) and north, east, down (world). The reader converts body axes
and world axes so that y points left and z up.
"""

from __future__ import annotations

import contextlib
import io
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from swimid.imports.table import ForeignTable, Format, Peek, ReaderOptions, axes, choose, rename_columns
from swimid.kinematics.attitude import from_frd, with_angles
from swimid.logs.log import TIME

MAGIC = (b"ULog\x01\x12\x35",)

#: Column of the log for each field of a topic of PX4.
PX4_FIELDS: dict[str, dict[str, str]] = {
    "vehicle_local_position": axes("{}", "{}_m") | axes("v{}", "v{}_m_s") | {"heading": "yaw_rad"},
    "vehicle_attitude": axes("q[{}]", "q{}", "1234", "wxyz"),
    "vehicle_angular_velocity": axes("xyz[{}]", "w{}_rad_s", "123", "xyz"),
    "vehicle_acceleration": axes("xyz[{}]", "a{}_m_s2", "123", "xyz"),
    "sensor_combined": axes("gyro_rad[{}]", "w{}_rad_s", "123", "xyz")
    | axes("accelerometer_m_s2[{}]", "a{}_m_s2", "123", "xyz"),
    "sensor_gyro": axes("{}", "w{}_rad_s"),
    "sensor_accel": axes("{}", "a{}_m_s2"),
}


def _load(path: Path) -> tuple[Any, dict[str, Any]]:
    """Return a ULog recording and its topics by name. Instances of a topic are ``name[0]``, ``name[1]``."""
    from pyulog import ULog

    # Discard the warnings that pyulog prints for a damaged file, because stdout is reserved for results.
    with contextlib.redirect_stdout(io.StringIO()):
        log = ULog(str(path))
    several = {data.name for data in log.data_list if data.multi_id}
    return log, {data.name + f"[{data.multi_id}]" * (data.name in several): data for data in log.data_list}


def _open(path: Path, options: ReaderOptions, select: str | None) -> ForeignTable:
    log, topics = _load(path)
    topic = choose(select, list(topics), "topic", path)
    # Count the elements of a vector from 1 (rename ``q[0]`` to ``q[1]``), as in the tables of all formats.
    columns = {
        re.sub(r"\[(\d+)\]$", lambda index: f"[{int(index[1]) + 1}]", name): values
        for name, values in topics[topic].data.items()
    }
    notes = []
    if log.dropouts:
        notes.append(f"{len(log.dropouts)} dropouts while it was recorded")
    if log.file_corruption:
        notes.append("the file is damaged; its readable part was read")
    return ForeignTable(columns, metadata={"topic": topic}, notes=notes)


def _topics(path: Path) -> dict[str, str]:
    """Return the known topics of PX4 in a recording, each with its name without the instance number."""
    return {topic: data.name for topic, data in _load(path)[1].items() if data.name in PX4_FIELDS}


def _recognises(peek: Peek) -> bool:
    return bool(_topics(peek.path))


def _read_px4(path: Path, options: ReaderOptions, select: str | None) -> ForeignTable:
    topics = _topics(path)
    table = _open(path, options, choose(select, list(topics), "topic", path))
    columns = rename_columns(table, PX4_FIELDS[topics[table.metadata["topic"]]])
    time_s = table.columns[table.column("timestamp", path)].astype(np.int64) * 1e-6
    return replace(table, columns={TIME: time_s, **with_angles(from_frd(columns))})


ULOG = Format("ulog", "ULog recording", _open, endings=(".ulg", ".ulog"), magic=MAGIC, extra="ulog")
PX4 = Format("px4", "ULog recording of PX4", _read_px4, _recognises, magic=MAGIC, extra="ulog")
