"""Reader of C3D files, by the library c3d: points, and analogue channels.

The file states rates and units. A point with a negative residual is missing. The parameter ``Y_SCREEN`` of
the group POINT states the vertical axis: ``+Z`` or ``+Y``. If it is ``+Y``, y becomes z, and z becomes -y.
"""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np

from swimid.errors import InputError
from swimid.imports.table import (
    Array,
    ForeignTable,
    Format,
    Peek,
    ReaderOptions,
    choose,
    complete,
    in_si,
    length,
)
from swimid.kinematics.attitude import from_y_up
from swimid.logs.log import TIME
from swimid.logs.units import unique


def _recognises(peek: Peek) -> bool:
    # The first byte is the number of the block with the parameters, which is usually 2. The second byte is
    # always 80.
    return peek.head[1:2] == b"P" and (peek.head[:1] == b"\x02" or peek.path.suffix.lower() == ".c3d")


def _read(path: Path, options: ReaderOptions, select: str | None) -> ForeignTable:
    import c3d

    with path.open("rb") as stream, warnings.catch_warnings(action="ignore"):
        file = c3d.Reader(stream)
        frames = list(file.read_frames(copy=True))
    complete(path, file.frame_count, len(frames))
    there = [name for name, used in (("points", file.point_used), ("analog", file.analog_used)) if used]
    start = float(file.first_frame - 1)
    if choose(select, there, "data set", path) == "analog":
        return _analog(file, np.concatenate([frame[2] for frame in frames], axis=1), start)
    return _points(file, np.array([frame[1] for frame in frames]), start, options, path)


def _texts(file: Any, name: str, size: int) -> list[str]:
    """Return the texts of a parameter and of its continuations, such as ``LABELS2``.

    The list has ``size`` items. Missing texts are empty.
    """
    parts = [file.get(f"{name}{ending}") for ending in ("", "2", "3", "4")]
    found = [str(text).strip() for part in parts if part is not None for text in np.ravel(part.string_array)]
    return [*found, *[""] * size][:size]


def _points(file: Any, cells: Array, start: float, options: ReaderOptions, path: Path) -> ForeignTable:
    factor, unit = length(options.length_unit or _texts(file, "POINT:UNITS", 1)[0], path)
    if not file.point_rate > 0:
        text = f"the frame rate of the points is {file.point_rate:g} Hz; it must be above 0 Hz"
        raise InputError(text, file=path, hint="set POINT:RATE, and export the file again")
    vertical, notes = _texts(file, "POINT:Y_SCREEN", 1)[0], []
    if vertical not in ("+Z", "+Y"):
        notes.append("the file does not state its vertical axis; z is taken as up")
    labels = _texts(file, "POINT:LABELS", cells.shape[1])
    names = unique(label or f"point {k}" for k, label in enumerate(labels, start=1))
    columns: dict[str, Array] = {TIME: (start + np.arange(len(cells))) / file.point_rate}
    for k, name in enumerate(names):
        residuals = cells[:, k, 3]
        place = np.where(residuals < 0, np.nan, cells[:, k, :3].T * factor)
        if vertical == "+Y":
            place = np.array(from_y_up(*place))
        columns |= {f"{name}_{axis}_{unit}": v for axis, v in zip("xyz", place, strict=True)}
    return ForeignTable(columns, notes=notes)


def _analog(file: Any, cells: Array, start: float) -> ForeignTable:
    time_s = start / file.point_rate + np.arange(cells.shape[1]) / file.analog_rate
    labels, units = (_texts(file, f"ANALOG:{name}", len(cells)) for name in ("LABELS", "UNITS"))
    names = unique(label or f"channel {k}" for k, label in enumerate(labels, start=1))
    converted = [in_si(*channel) for channel in zip(names, units, cells.astype(float), strict=True)]
    return ForeignTable({TIME: time_s, **dict(converted)})


PROFILE = Format("c3d", "C3D file", _read, _recognises, extra="c3d")
