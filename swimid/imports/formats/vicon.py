"""Reader of text exports of Vicon Nexus and Tracker: sections for trajectories, devices and other data.

A section has a line with its name, a line with its rate, a line with the names of its objects, a line with
the names of the columns (``Frame``, ``Sub Frame``, ``X``, ...), a line with their units, and rows up to an
empty line. The world has z up. A device may be sampled several times in a frame (``Sub Frame``).
"""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

from swimid.errors import InputError
from swimid.imports.table import Array, ForeignTable, Format, ReaderOptions, choose, in_si, numbers
from swimid.logs.log import TIME
from swimid.logs.units import unique


@dataclass(frozen=True)
class _Section:
    """Section of a file: rate in Hz, header lines, index of the first row and number of rows."""

    rate_hz: float
    names: list[str]
    columns: list[str]
    units: list[str]
    start: int
    count: int


def _mark(lines: list[str]) -> str:
    """Return the delimiter in the line of column names; empty if the file has no such line."""
    for line in lines[:6]:
        for mark in (",", "\t", ";"):
            if line.startswith(f"Frame{mark}Sub Frame{mark}"):
                return mark
    return ""


def _sections(lines: list[str], mark: str) -> dict[str, _Section]:
    rows = list(csv.reader(lines, delimiter=mark))
    empty = [at for at, cells in enumerate(rows) if not any(cell.strip() for cell in cells)]
    found = {}
    for at, cells in enumerate(rows):
        if cells[:2] == ["Frame", "Sub Frame"] and at >= 3 and at + 2 < len(rows):
            end = next((k for k in empty if k > at + 1), len(rows))
            name, rate = rows[at - 3][0].strip(), rows[at - 2][0]
            found[name] = _Section(float(rate), rows[at - 1], cells, rows[at + 1], at + 2, end - at - 2)
    return found


def _read(path: Path, options: ReaderOptions, select: str | None) -> ForeignTable:
    lines = path.read_text(encoding="utf-8-sig", errors="replace").splitlines()
    mark = _mark(lines)
    sections = _sections(lines, mark) if mark else {}
    if not sections:
        hint = "an export of Vicon has lines that begin with: Frame,Sub Frame"
        raise InputError("has no section with samples", file=path, hint=hint)
    part = sections[choose(select, list(sections), "section", path)]
    width = max(k for k, cell in enumerate(part.columns) if cell.strip()) + 1
    values, rows = numbers(path, part.start, mark, width, most=part.count)
    each = int(values[:, 1].max()) + 1
    time_s = ((values[:, 0] - 1) * each + values[:, 1]) / part.rate_hz
    columns: dict[str, Array] = {TIME: time_s}
    owners, units = (cells + [""] * width for cells in (part.names, part.units))
    several = len({owner.split(":")[0] for owner in owners if ":" in owner}) > 1
    names, shown = [], ""
    for k in range(2, width):
        # The name of an object stands above its first column, after the name of its subject.
        if owners[k].strip():
            shown = owners[k] if several else owners[k].split(":")[-1]
        column = part.columns[k].strip()
        if column in ("X", "Y", "Z"):
            column = column.lower()
        names.append(f"{shown} {column}")
    for k, name in enumerate(unique(names), start=2):
        target, cells = in_si(name, units[k].strip(), values[:, k])
        columns[target] = cells
    return ForeignTable(columns, lines=rows)


PROFILE = Format("vicon", "text export of Vicon", _read, lambda peek: bool(_mark(peek.lines)))
