"""ULog recordings of PX4.

Axes are forward, right, down and north, east, down; they are turned to y left and z up.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from swimid.logs.foreign import ulog
from swimid.logs.foreign.base import Options, Table
from swimid.logs.log import TIME
from swimid.logs.profiles.base import Peek, Profile, axes, choose, renamed
from swimid.logs.rotation import from_frd, with_angles

#: Columns by topic; the units are those of the PX4 message definitions.
TOPICS: dict[str, dict[str, str]] = {
    "vehicle_local_position": axes("{}", "{}_m") | axes("v{}", "v{}_m_s") | {"heading": "yaw_rad"},
    "vehicle_attitude": axes("q[{}]", "q{}", "1234", "wxyz"),
    "vehicle_angular_velocity": axes("xyz[{}]", "w{}_rad_s", "123", "xyz"),
    "vehicle_acceleration": axes("xyz[{}]", "a{}_m_s2", "123", "xyz"),
    "sensor_combined": axes("gyro_rad[{}]", "w{}_rad_s", "123", "xyz")
    | axes("accelerometer_m_s2[{}]", "a{}_m_s2", "123", "xyz"),
    "sensor_gyro": axes("{}", "w{}_rad_s"),
    "sensor_accel": axes("{}", "a{}_m_s2"),
}


def _recognises(peek: Peek) -> bool:
    return peek.head.startswith(ulog.MAGIC) and bool(_known(peek.path))


def _known(path: Path) -> list[str]:
    return [topic for topic in ulog.topics(path) if topic.partition("[")[0] in TOPICS]


def _read(path: Path, select: str | None, length_unit: str | None) -> Table:
    topic = choose(select, _known(path), "topic", path)
    table = ulog.READER.open(path, Options(topic=topic))
    time_s = table.columns[table.column("timestamp", path)].astype(np.int64) * 1e-6
    columns = renamed(table, TOPICS[topic.partition("[")[0]])
    return replace(table, columns={TIME: time_s, **with_angles(from_frd(columns))})


PROFILE = Profile("px4", "ULog recording of PX4", _recognises, _read, extra="ulog")
