"""Read the binary logs that a Crazyflie writes to its micro SD card (format of Bitcraze, versions 1 and 2)."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

from tests.real_gaps.row import Array


def read_log(path: Path) -> dict[str, dict[str, Array]]:
    """Return the variables of each kind of event, and its time as ``timestamp`` in ms."""
    content = path.read_bytes()
    _magic, version, kinds = struct.unpack_from("<BHH", content, 0)
    position, formats = 5, {}
    for _ in range(kinds):
        (number,) = struct.unpack_from("<H", content, position)
        name, position = _text(content, position + 2)
        (count,) = struct.unpack_from("<H", content, position)
        position += 2
        fields = []
        for _ in range(count):
            field, position = _text(content, position)
            fields.append((field[:-3], "<" + field[-2]))
        formats[number] = (name, np.dtype(fields))
    head = {1: struct.Struct("<HI"), 2: struct.Struct("<HQ")}[version]
    events: dict[str, list[np.void]] = {name: [] for name, _ in formats.values()}
    times: dict[str, list[int]] = {name: [] for name in events}
    while position < len(content) - 4:
        number, time = head.unpack_from(content, position)
        name, kind = formats[number]
        events[name].append(np.frombuffer(content, kind, 1, position + head.size)[0])
        times[name].append(time)
        position += head.size + kind.itemsize
    scale = 1.0 if version == 1 else 1e-3
    return {
        name: {
            "timestamp": scale * np.array(times[name], float),
            **{field: np.array([row[field] for row in rows], float) for field in rows[0].dtype.names or ()},
        }
        for name, rows in events.items()
        if rows
    }


def _text(content: bytes, begin: int) -> tuple[str, int]:
    """Text that ends with a zero, and the index behind it."""
    end = content.index(0, begin)
    return content[begin:end].decode(), end + 1
