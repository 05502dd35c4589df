"""Reader of C3D files, by the library ezc3d: points, and analogue channels.

The file states rates and units. A point with a negative residual is missing. The parameter ``Y_SCREEN`` of
the group POINT states the vertical axis: ``+Z`` or ``+Y``. In the second case y becomes z, and z becomes -y.
"""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np

from swimid.errors import InputError
from swimid.logs.foreign import Array, Format, Options, Peek, Table, choose, complete, in_si, length, unique
from swimid.logs.kinematics import from_y_up
from swimid.logs.log import TIME


def _recognises(peek: Peek) -> bool:
    # The first byte is the block of the parameters, which is usually 2. The second one is always 80.
    return peek.head[1:2] == b"P" and (peek.head[:1] == b"\x02" or peek.path.suffix.lower() == ".c3d")


def _read(path: Path, options: Options, select: str | None) -> Table:
    import ezc3d

    file = ezc3d.c3d(str(path))
    groups, data = file["parameters"], file["data"]
    header = file["header"]["points"]
    complete(path, _stated_frames(path), header["last_frame"] - header["first_frame"] + 1)
    samples = {"points": data["points"], "analog": data["analogs"]}
    there = [name for name, values in samples.items() if values.size]
    start = float(header["first_frame"])
    if choose(select, there, "kind of data", path) == "analog":
        return _analog(data["analogs"][0], groups, start)
    return _points(data, groups, start, options, path)


def _stated_frames(path: Path) -> int | None:
    """Return the number of frames that the header of a file states; None if they are too many for its field.

    The library reads a file that is cut off without an error, and changes the number in its header.
    """
    with path.open("rb") as stream:
        head = stream.read(512)
        stream.seek(512 * (head[0] - 1) + 3)
        processor = stream.read(1)
    order = ">" if processor == b"\x56" else "<"  # 86 stands for the byte order of MIPS
    first, last = struct.unpack(f"{order}HH", head[6:10])
    return last - first + 1 if last < 0xFFFF else None


def _values(groups: Any, group: str, name: str) -> list[Any]:
    """Return the values of a parameter and of its continuations, such as ``LABELS2``; empty if missing."""
    found: list[Any] = []
    for ending in ("", "2", "3", "4"):
        if group in groups and f"{name}{ending}" in groups[group]:
            found += list(groups[group][f"{name}{ending}"]["value"])
    return found


def _points(data: Any, groups: Any, start: float, options: Options, path: Path) -> Table:
    stated = next(iter(_values(groups, "POINT", "UNITS")), "")
    factor, unit = length(options.length_unit or str(stated), path)
    rate = float(next(iter(_values(groups, "POINT", "RATE")), 0.0))
    if not rate > 0:
        raise InputError("states no rate of the points", file=path)
    vertical, notes = str(next(iter(_values(groups, "POINT", "Y_SCREEN")), "")), []
    if vertical not in ("+Z", "+Y"):
        notes.append("the file does not state its vertical axis; z is taken as up")
    cells = data["points"][:3] * factor
    residuals = data["meta_points"]["residuals"][0]
    cells[:, residuals < 0] = np.nan
    columns: dict[str, Array] = {TIME: (start + np.arange(cells.shape[2])) / rate}
    names = unique(map(str, _values(groups, "POINT", "LABELS")))
    for name, place in zip(names, np.moveaxis(cells, 1, 0), strict=False):
        if vertical == "+Y":
            place = from_y_up(*place)
        columns |= {f"{name}_{axis}_{unit}": v for axis, v in zip("xyz", place, strict=True)}
    return Table(columns, notes=notes)


def _analog(cells: Array, groups: Any, start: float) -> Table:
    rate = float(_values(groups, "ANALOG", "RATE")[0])
    points = float(next(iter(_values(groups, "POINT", "RATE")), rate)) or rate
    columns: dict[str, Array] = {TIME: start / points + np.arange(cells.shape[1]) / rate}
    names = unique(map(str, _values(groups, "ANALOG", "LABELS")))
    units = _values(groups, "ANALOG", "UNITS")
    units += [""] * len(names)
    for k, values in enumerate(cells):
        name, converted = in_si(names[k], str(units[k]), values)
        columns[name] = converted
    return Table(columns)


PROFILE = Format("c3d", "C3D file", _read, _recognises, extra="c3d")
