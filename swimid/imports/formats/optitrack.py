"""Reader of CSV exports of OptiTrack Motive: the pose of a rigid body, and labelled markers.

The first line states the unit of length, the frame rate and the form of rotations (``Quaternion``, or the
order of Euler angles in degrees about the axes of the body, such as ``XYZ``). The world has y up. The reader
converts positions to a world with z up: x stays, y becomes z, and z becomes -y. The axes of a body are
converted in the same way. If all angles of a body are zero, it has the orientation in which it was defined in
Motive.
"""

from __future__ import annotations

import csv
import re
from itertools import islice
from pathlib import Path

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
    length,
    numbers,
)
from swimid.kinematics.attitude import AXES, from_y_up, with_angles
from swimid.logs.log import TIME
from swimid.logs.units import safe

#: Types of the columns that are read. ``Rigid Body Marker`` and ``Bone Marker`` are expected positions.
_BODY, _MARKER = "Rigid Body", "Marker"
_ORDER = re.compile(r"[XYZ]{3}")
#: Number of lines at the beginning of a file in which the column names are searched for.
_HEADER_LINES = 12


def _recognises(peek: Peek) -> bool:
    return peek.header[:1] == ["Format Version"] and "Take Name" in peek.header


def _read(path: Path, options: ReaderOptions, select: str | None) -> ForeignTable:
    with path.open(encoding="utf-8-sig", newline="") as stream:
        lines = list(islice(csv.reader(stream), _HEADER_LINES))
    at = next((k for k, cells in enumerate(lines) if cells[:1] == ["Frame"]), 0)
    top = next((k for k, cells in enumerate(lines) if {_BODY, _MARKER} & set(cells)), at)
    if top >= at:
        hint = "export rigid bodies or markers, with the header"
        raise InputError("has no rigid bodies and no markers", file=path, hint=hint)
    head = dict(zip(lines[0][::2], lines[0][1::2], strict=False))
    factor, unit = length(options.length_unit or head.get("Length Units"), path)
    space = head.get("Coordinate Space", "Global")
    if space != "Global":
        hint = "export with the coordinate space Global"
        raise InputError(f"the coordinate space is {space}", file=path, line=1, hint=hint)
    values, rows = numbers(path, at + 1, ",", len(lines[at]))
    complete(path, head.get("Total Exported Frames"), len(values), int(rows[-1]))
    # Find each column by its type, the name of its object, its kind (rotation or position) and its axis.
    width, header = len(lines[at]), [cells + [""] * len(lines[at]) for cells in lines[: at + 1]]
    found: dict[str, dict[str, dict[str, Array]]] = {_BODY: {}, _MARKER: {}}
    for k in range(2, width):
        kind, name, what, axis = header[top][k], header[top + 1][k], header[at - 1][k], header[at][k]
        if kind in found and what in ("Rotation", "Position") and not name.startswith("Unlabeled"):
            found[kind].setdefault(name, {})[f"{what} {axis}"] = values[:, k]
    columns: dict[str, Array] = {}
    if found[_BODY]:
        body = found[_BODY][choose(select, list(found[_BODY]), "rigid body", path)]
        columns |= _place(body, "", unit, factor) | _turn(body, head.get("Rotation Type", ""), path)
    for name, marker in found[_MARKER].items():
        columns |= _place(marker, f"{safe(name)}_", unit, factor)
    return ForeignTable({TIME: values[:, 1], **with_angles(columns)}, lines=rows)


def _place(cells: dict[str, Array], prefix: str, unit: str, factor: float) -> dict[str, Array]:
    """Return the columns of the position of a rigid body or a marker, with z up."""
    if not {"Position X", "Position Y", "Position Z"} <= set(cells):
        return {}
    place = from_y_up(*(factor * cells[f"Position {axis}"] for axis in "XYZ"))
    return {f"{prefix}{axis}_{unit}": values for axis, values in zip("xyz", place, strict=True)}


def _turn(cells: dict[str, Array], form: str, path: Path) -> dict[str, Array]:
    """Return the quaternion columns of a rigid body in a world with z up.

    Raises
    ------
    InputError
        The stated form of rotations is neither ``Quaternion`` nor an order of Euler angles.
    """
    from scipy.spatial.transform import Rotation

    if not {"Rotation X", "Rotation Y", "Rotation Z"} <= set(cells):
        return {}
    if form == "Quaternion":
        w, x, y, z = (cells[f"Rotation {axis}"] for axis in "WXYZ")
    elif _ORDER.fullmatch(form):
        angles = np.column_stack([cells[f"Rotation {axis}"] for axis in form])
        known = np.isfinite(angles).all(axis=1)
        q = np.full((len(angles), 4), np.nan)
        q[known] = Rotation.from_euler(form, angles[known], degrees=True).as_quat(scalar_first=True)
        w, x, y, z = q.T
    else:
        hint = "export with the rotation type Quaternion"
        raise InputError(f"the rotation type {form!r} is not supported", file=path, line=1, hint=hint)
    return dict(zip(AXES, (w, *from_y_up(x, y, z)), strict=True))


PROFILE = Format("optitrack", "CSV export of OptiTrack Motive", _read, _recognises)
