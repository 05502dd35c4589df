"""Readers of text files of OpenSim: marker trajectories (TRC), and motions or storages (MOT, STO).

The header states the conventions: ``Units`` and ``DataRate`` of a TRC file, ``inDegrees`` of a motion.
Coordinates of a motion are angles, except translations, whose names end in ``_tx``, ``_ty`` or ``_tz``.
Forces are in N, torques in N m, and points of application in m. A file does not state its vertical axis. The
axes of the file are kept, and a note says that OpenSim itself has y up.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from swimid.errors import InputError
from swimid.imports.table import ForeignTable, Format, Peek, ReaderOptions, length, numbers
from swimid.logs.log import TIME
from swimid.logs.sampling import usual_step
from swimid.logs.units import safe
from swimid.notices import warn

#: Unit of the columns of a motion file, by a pattern of their names. The first matching pattern is used.
_UNITS = {r".*(force.*_p|_t)[xyz]": "m", r".*(torque|moment).*": "Nm", r".*force.*": "N", r".*": "rad"}
#: Pattern of the names of log columns that hold a component of a vector.
_VECTOR = re.compile(r".*_[tvp]?[xyz]_(m|px|N|Nm)")
#: Pattern of the name of a column of a motion file that holds the value or the speed of a coordinate
#: (``/jointset/hip/hip_flexion/value``).
_OPENSIM_COORDINATE = re.compile(r"(?:.*/)?(?P<name>[^/]+)/(?P<kind>value|speed)")


def _recognises(peek: Peek) -> bool:
    starts = [line.strip().lower() for line in peek.lines[:60]]
    return bool(starts) and (starts[0].startswith("pathfiletype") or "endheader" in starts)


def _read(path: Path, options: ReaderOptions, select: str | None) -> ForeignTable:
    lines = path.read_text(encoding="utf-8-sig", errors="replace").splitlines()
    if lines and lines[0].strip().lower().startswith("pathfiletype"):
        table = _markers(lines, options.length_unit, path)
    else:
        table = _motion(lines, path)
    if any(map(_VECTOR.fullmatch, table.columns)):
        note = "the file does not state its vertical axis, and its axes are kept. OpenSim itself has y up"
        table.notes.append(f"{note}: map x to x, -z to y and y to z if the file has, too")
    return table


def _markers(lines: list[str], length_unit: str | None, path: Path) -> ForeignTable:
    if len(lines) < 6:
        raise InputError("ends within the header: copy the file again", file=path, line=len(lines))
    head = dict(zip(lines[1].split(), lines[2].split(), strict=False))
    factor, unit = length(length_unit or head.get("Units"), path)
    names = [safe(name) for name in lines[3].split("\t")[2:] if name.strip()]
    values, at = numbers(path, 5, "\t", 2 + 3 * len(names))
    targets = [f"{name}_{axis}_{unit}" for name in names for axis in "xyz"]
    time_s = values[:, 1]
    columns = {TIME: time_s, **dict(zip(targets, values.T[2:] * factor, strict=True))}
    rate, notes = float(head.get("DataRate", "nan")), []
    step = usual_step(time_s)
    if abs(step * rate - 1.0) > 0.01:
        notes.append(f"the header states {rate:g} Hz, but the times have a rate of {1 / step:g} Hz")
    return ForeignTable(columns, notes=notes, lines=at)


def _motion(lines: list[str], path: Path) -> ForeignTable:
    head = [line.lower().replace(" ", "").strip() for line in lines]
    if "endheader" not in head[:-2]:
        raise InputError("has no line 'endheader' with samples below it", file=path)
    end = head.index("endheader")
    names = lines[end + 1].split()
    if names[:1] != ["time"]:
        text = f"the first column must be 'time', not '{''.join(names[:1])}'"
        raise InputError(text, file=path, line=end + 2)
    in_degrees = "indegrees=yes" in head[:end]
    if not in_degrees and "indegrees=no" not in head[:end]:
        hint = "add the line inDegrees=yes or inDegrees=no above 'endheader'"
        raise InputError("does not state the unit of the angles", file=path, line=end + 1, hint=hint)
    # Determine the delimiter: the cells of a storage file are separated by tabs, or aligned with blanks.
    delimiter = "\t" if "\t" in lines[end + 2] else r"\s+"
    values, at = numbers(path, end + 2, delimiter, len(names))
    columns, left_out = {TIME: values[:, 0]}, []
    has_coordinates = path.suffix.lower() == ".mot" or "coordinates" in head[0]
    for name, cells in zip(names[1:], values.T[1:], strict=True):
        target, is_angle = _name_column(name)
        if is_angle and not (has_coordinates or _OPENSIM_COORDINATE.fullmatch(name)):
            left_out.append(name)
            continue
        if is_angle and in_degrees:
            cells = np.radians(cells)
        columns[target] = cells
    if left_out:
        text = f"columns that are no coordinates are left out: {', '.join(left_out[:20])}"
        warn("SWM004", f"{path.name}: {text}")
    return ForeignTable(columns, lines=at)


def _name_column(name: str) -> tuple[str, bool]:
    """Return the log column for a column of a motion file, and whether it holds an angle or its rate."""
    word, rate = safe(name), ""
    if hit := _OPENSIM_COORDINATE.fullmatch(name):
        word, rate = safe(hit["name"]), {"value": "", "speed": "_s"}[hit["kind"]]
    unit = next(unit for pattern, unit in _UNITS.items() if re.fullmatch(pattern, word))
    return f"{word}_{unit}{rate}", unit == "rad"


PROFILE = Format("opensim", "TRC, MOT or STO file of OpenSim", _read, _recognises)
