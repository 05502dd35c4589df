"""Height of a quadcopter from the lift of its rotors, and the binary logs of a Crazyflie.

The model is one link that the rotors lift along its z axis. The lift column has their squared speeds, or
squared voltages, times the cosine of the tilt, so that the link itself stays level.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from validation.real_gaps.row import AIR, Array, Gap, write_log, write_robot, write_trials

#: Names of a quadcopter that is heavier than its robot file says.
HEAVIER = frozenset({"parameter:m"})


#: Duration of a window, s. A longer one shows the drift of the thrust.
SPAN_S = 1.5


def write_quadcopter(path: Path, mass_kg: float) -> None:
    """Robot file of a quadcopter of known mass and unknown thrust."""
    coefficients = {
        "m": {"value": mass_kg, "unit": "kg", "bounds": [0.01, 0.2], "free": False, "meaning": "mass"},
        "k_t": {"value": 0.4, "unit": "N", "bounds": [0.05, 2], "meaning": "thrust at the unit of lift"},
    }
    link = {"name": "frame", "mass_kg": "m", "com_m": [0, 0, 0], "inertia_kg_m2": [2e-5, 2e-5, 3e-5]}
    rotors = {"kind": "load", "link": "frame", "input": "rotors", "force_N": [0, 0, "k_t"]}
    multibody = {"base": "free", "coefficients": coefficients, "links": [link]}
    multibody["inputs"] = {"rotors": {"column": "lift", "measured": True}}
    multibody["elements"] = [{"kind": "hydrostatics", "link": "frame"}, rotors]
    write_robot(path, fluid=AIR, multibody=multibody)


def write(
    folder: Path,
    mass_kg: float,
    flights: Mapping[str, tuple[str, Sequence[str], str]],
    begins_s: Sequence[float],
    read: Callable[[str, str], tuple[Array, Array, Array]],
) -> None:
    """Robot file, logs and trials files; every start is estimated.

    ``flights`` has the folder, the logs that are fitted and the log that is held out of each trials file, and
    ``read`` returns times, heights and lift of a log in a folder.
    """
    write_quadcopter(folder / "quadcopter.yaml", mass_kg)
    for name, (place, fitted, held_out) in flights.items():
        trials = []
        for flight in (*fitted, held_out):
            time, height, lift = read(place, flight)
            for index, begin in enumerate(begins_s):
                log = f"{name}{flight[-2:]}-{index}.csv"
                use = (time >= begin) & (time < begin + SPAN_S)
                columns = {"t_s": time[use] - begin, "z_m": height[use], "lift": lift[use]}
                write_log(folder / log, columns)
                role = "validate" if flight == held_out else "fit"
                trials.append({"log": log, "role": role, "start_state": "estimate"})
        write_trials(folder / f"{name}.yaml", "multibody", "quadcopter.yaml", trials)


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
