"""Height of a quadcopter from the lift of its rotors, and the binary logs of a Crazyflie.

The model is one link that the rotors lift along its z axis. The lift column has their squared speeds, or
squared voltages, times the cosine of the tilt, so that the link itself stays level.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np

from validation.real_gaps.row import Array, Gap, write_log

#: Names of a quadcopter that is heavier than its robot file says.
HEAVIER = frozenset({"parameter:m"})


def robot(mass_kg: float) -> dict[str, object]:
    """Robot file of a quadcopter of known mass and unknown thrust."""
    coefficients = {
        "m": {"value": mass_kg, "unit": "kg", "bounds": [0.01, 0.2], "free": False, "meaning": "mass"},
        "k_t": {"value": 0.4, "unit": "N", "bounds": [0.05, 2], "meaning": "thrust at the unit of lift"},
    }
    link = {"name": "frame", "mass_kg": "m", "com_m": [0, 0, 0], "inertia_kg_m2": [2e-5, 2e-5, 3e-5]}
    rotors = {"kind": "load", "link": "frame", "input": "rotors", "force_N": [0, 0, "k_t"]}
    return {
        "format": "swimid-robot/1",
        "name": "quadcopter",
        "fluid": {"density_kg_m3": 1.2, "gravity_m_s2": 9.81},
        "multibody": {
            "base": "free",
            "coefficients": coefficients,
            "links": [link],
            "inputs": {"rotors": {"column": "lift", "measured": True}},
            "elements": [{"kind": "hydrostatics", "link": "frame"}, rotors],
        },
    }


def write_window(path: Path, time: Array, height: Array, lift: Array, begin: float, span: float) -> None:
    """Write the log of a part of a flight. A long part would show the drift of the thrust."""
    use = (time >= begin) & (time < begin + span)
    write_log(path, {"t_s": time[use] - begin, "z_m": height[use], "lift": lift[use]})


def mass_reader(mass_kg: float) -> Callable[[Gap], tuple[float, float | None]]:
    """Return a reader of the change of the mass; a change of the thrust is one of the mass per thrust."""

    def read(gap: Gap) -> tuple[float, float | None]:
        for cause in gap["causes"]:
            for name, parameter in cause["parameters"].items():
                if name == "m":
                    return parameter["value"] - mass_kg, parameter["stderr"]
                if name == "k_t":
                    ratio = parameter["from"] / parameter["value"]
                    return mass_kg * (ratio - 1), mass_kg * ratio * parameter["stderr"] / parameter["value"]
        raise KeyError("neither mass nor thrust among the causes")

    return read


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
