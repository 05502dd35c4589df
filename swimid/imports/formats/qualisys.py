"""Reader of TSV exports of Qualisys Track Manager: markers (3D), and rigid bodies (6D).

Lengths are in millimetres, and the world has z up. A row may begin with the frame and the time. For a marker
that is not found, the cells are empty, ``NULL``, or 0, 0, 0. A body has x, y, z, three angles, the residual
and the rotation matrix, column by column. The residual is -1 if the body is not found. The reader uses the
matrix and not the angles, because the definition of the angles is a setting of the program.
"""

from __future__ import annotations

import re
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
from swimid.kinematics.attitude import AXES, with_angles
from swimid.logs.log import TIME
from swimid.logs.units import unique

#: Number of columns of a rigid body (_WIDTH). Among these columns, counted from 0, index of the residual
#: (_RESIDUAL) and of the first element of the rotation matrix (_MATRIX).
_WIDTH, _RESIDUAL, _MATRIX = 16, 6, 7
_KEY = re.compile(r"(?!NULL\b)[A-Z][A-Z_]+(\s|$)")


def _recognises(peek: Peek) -> bool:
    keys = {line.split("\t")[0] for line in peek.lines[:30]}
    return "NO_OF_FRAMES" in keys and "DATA_INCLUDED" in keys


def _read(path: Path, options: ReaderOptions, select: str | None) -> ForeignTable:
    lines = path.read_text(encoding="utf-8-sig", errors="replace").splitlines()
    # The header ends before the line of column names, or, without such a line, before the first row of
    # numbers.
    start = next((at for at, line in enumerate(lines) if not _KEY.match(line)), len(lines))
    head = {key: cells for key, *cells in (line.rstrip().split("\t") for line in lines[:start])}
    kind = head.get("DATA_INCLUDED", [""])[0]
    if kind not in ("3D", "6D"):
        hint = "export 3D or 6DOF data, with the header"
        raise InputError(f"has the data '{kind}', neither 3D nor 6D", file=path, hint=hint)
    names = [name for name in head.get({"3D": "MARKER_NAMES", "6D": "BODY_NAMES"}[kind], []) if name]
    each = {"3D": 3, "6D": _WIDTH}[kind]
    start, timed = _find_rows(lines, start, each * len(names))
    values, rows = numbers(path, start, "\t", timed + each * len(names))
    complete(path, head.get("NO_OF_FRAMES", [None])[0], len(values), int(rows[-1]))
    clock = {"frame": np.arange(len(values), dtype=float)}
    rate = head.get("FREQUENCY", [""])[0]
    if timed:
        clock = {TIME: values[:, 1]}
    elif rate.replace(".", "").isdecimal() and float(rate) > 0:
        clock = {TIME: clock["frame"] / float(rate)}
    factor, unit = length(options.length_unit or "mm", path)
    parts = np.split(values[:, timed:], len(names), axis=1)
    columns: dict[str, Array] = {}
    if kind == "6D":
        columns = _body(parts[names.index(choose(select, names, "body", path))], unit, factor)
    else:
        for name, part in zip(unique(names), parts, strict=True):
            part = np.where((part == 0).all(axis=1)[:, None], np.nan, part * factor)
            columns |= {f"{name}_{axis}_{unit}": v for axis, v in zip("xyz", part.T, strict=True)}
    return ForeignTable({**clock, **columns}, lines=rows)


def _find_rows(lines: list[str], start: int, width: int) -> tuple[int, int]:
    """Return the index of the first row of samples, and the number of its cells before the coordinates.

    The cells before the coordinates are those of frame and time, if the file has them. ``width`` is the
    number of cells with coordinates.
    """
    first = lines[start].rstrip("\t").split("\t")
    if first[0] == "Frame":
        return start + 1, 2
    if any(cell[:1].isalpha() for cell in first if cell not in ("NULL", "nan")):
        start += 1
        first = "".join(lines[start : start + 1]).rstrip("\t").split("\t")
    return start, 2 * (len(first) == 2 + width)


def _body(cells: Array, unit: str, factor: float) -> dict[str, Array]:
    """Return the log columns of the pose of a rigid body from its cells in the file, shape (n, 16)."""
    from scipy.spatial.transform import Rotation

    matrices = cells[:, _MATRIX:].reshape(-1, 3, 3).transpose(0, 2, 1)
    found = (cells[:, _RESIDUAL] >= 0) & (np.linalg.det(np.nan_to_num(matrices)) > 0.5)
    place = np.where(found[:, None], cells[:, :3] * factor, np.nan)
    q = np.full((len(cells), 4), np.nan)
    q[found] = Rotation.from_matrix(matrices[found]).as_quat(scalar_first=True)
    named = {f"{axis}_{unit}": v for axis, v in zip("xyz", place.T, strict=True)}
    return with_angles(named | dict(zip(AXES, q.T, strict=True)))


PROFILE = Format("qualisys", "TSV export of Qualisys", _read, _recognises)
