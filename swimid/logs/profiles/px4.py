"""ULog recordings of PX4.

Axes are forward, right, down and north, east, down; they are turned to y left and z up.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from swimid.errors import InputError
from swimid.logs.choices import Choices
from swimid.logs.foreign import ulog
from swimid.logs.foreign.base import Options, Table, one_of
from swimid.logs.log import TIME
from swimid.logs.profiles.base import Peek, Profile
from swimid.logs.rotation import AXES, from_frd, with_angles

_XYZ = list(enumerate("xyz", start=1))
#: Columns by topic; the units are those of the PX4 message definitions.
TOPICS: dict[str, dict[str, str]] = {
    "vehicle_local_position": {
        **{axis: f"{axis}_m" for axis in "xyz"},
        **{f"v{axis}": f"v{axis}_m_s" for axis in "xyz"},
        "heading": "yaw_rad",
    },
    "vehicle_attitude": {f"q[{k}]": axis for k, axis in enumerate(AXES, start=1)},
    "vehicle_angular_velocity": {f"xyz[{k}]": f"w{axis}_rad_s" for k, axis in _XYZ},
    "vehicle_acceleration": {f"xyz[{k}]": f"a{axis}_m_s2" for k, axis in _XYZ},
    "sensor_combined": {
        **{f"gyro_rad[{k}]": f"w{axis}_rad_s" for k, axis in _XYZ},
        **{f"accelerometer_m_s2[{k}]": f"a{axis}_m_s2" for k, axis in _XYZ},
    },
    "sensor_gyro": {axis: f"w{axis}_rad_s" for axis in "xyz"},
    "sensor_accel": {axis: f"a{axis}_m_s2" for axis in "xyz"},
}


def _recognises(peek: Peek) -> bool:
    return peek.head.startswith(ulog.MAGIC) and bool(_known(ulog.topics(peek.path)))


def _known(topics: list[str]) -> list[str]:
    return [topic for topic in topics if topic.partition("[")[0] in TOPICS]


def _read(path: Path, choices: Choices) -> Table:
    topic = one_of(choices.select, _known(ulog.topics(path)), file=path, what="topic", key="--select with")
    table = ulog.READER.open(path, Options(topic=topic))
    if "timestamp" not in table.columns:
        raise InputError("this column is missing", file=path, column="timestamp")
    stamps = table.columns["timestamp"].astype(np.int64)
    fields = TOPICS[topic.partition("[")[0]]
    columns: dict[str, Any] = {
        target: np.asarray(table.columns[name], dtype=float)
        for name, target in fields.items()
        if name in table.columns
    }
    return Table(
        {TIME: stamps * 1e-6, **with_angles(from_frd(columns))}, metadata=table.metadata, notes=table.notes
    )


PROFILE = Profile("px4", "ULog recording of PX4", _recognises, _read, extra="ulog")
