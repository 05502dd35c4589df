"""Rows of ArduPilot logs: text logs (``IMU, 1234, 0, ...`` under ``FMT`` lines), or CSV of one message type.

One instance of a sensor is taken. Units are those of the ArduPilot log messages; the axes forward, right,
down are turned to y left, z up.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from swimid.errors import InputError
from swimid.logs.choices import Choices
from swimid.logs.foreign import open_table
from swimid.logs.foreign.base import Table, is_text, one_of
from swimid.logs.log import TIME
from swimid.logs.profiles.base import Peek, Profile
from swimid.logs.rotation import from_frd, with_angles

#: Columns of a log and their factors to SI, by the name of a field.
FIELDS: dict[str, tuple[str, float]] = {
    **{f"Gyr{axis}": (f"w{axis.lower()}_rad_s", 1.0) for axis in "XYZ"},
    **{f"Acc{axis}": (f"a{axis.lower()}_m_s2", 1.0) for axis in "XYZ"},
    **{f"Mag{axis}": (f"m{axis.lower()}_T", 1e-7) for axis in "XYZ"},
    **{angle: (f"{angle.lower()}_rad", np.pi / 180) for angle in ("Roll", "Pitch", "Yaw")},
    **{f"Des{angle}": (f"desired_{angle.lower()}_rad", np.pi / 180) for angle in ("Roll", "Pitch", "Yaw")},
    **{f"P{axis}": (f"{name}_m", 1.0) for axis, name in zip("NED", "xyz", strict=True)},
    **{f"V{axis}": (f"v{name}_m_s", 1.0) for axis, name in zip("NED", "xyz", strict=True)},
    **{f"Q{k}": (f"q{axis}", 1.0) for k, axis in enumerate("wxyz", start=1)},
}
#: Fields that number the instance.
INSTANCE = ("I", "C", "Instance")


def _recognises(peek: Peek) -> bool:
    types = {line.split(",")[0].strip() for line in peek.lines[:50]}
    return "TimeUS" in peek.header or ("FMT" in types and "TimeUS" in peek.head.decode("latin-1"))


def _read(path: Path, choices: Choices) -> Table:
    kind, _, instance = (choices.select or "").rstrip("]").partition("[")
    if Peek.of(path).header[0] == "FMT" or "TimeUS" not in Peek.of(path).header:
        table = _messages(path, kind or None)
    else:
        table, instance = open_table(path), instance or kind
    rows = len(table.columns["TimeUS"])
    kept, notes = np.ones(rows, dtype=bool), list(table.notes)
    by = next((name for name in INSTANCE if name in table.columns), None)
    if by is not None and not is_text(table.columns[by]):
        there = [f"{value:g}" for value in dict.fromkeys(sorted(table.columns[by].tolist()))]
        taken = one_of(instance or there[0], there, file=path, what="instance", key="--select with")
        kept = table.columns[by] == float(taken)
        if len(there) > 1 and not instance:
            other = f"{table.metadata['type']}[{there[1]}]" if "type" in table.metadata else there[1]
            notes.append(f"instance {taken} of {', '.join(there)} is taken (another one: --select {other})")
    columns: dict[str, Any] = {}
    for name, (target, factor) in FIELDS.items():
        if name in table.columns and not is_text(table.columns[name]):
            columns[target] = table.columns[name][kept].astype(float) * factor
    if not columns:
        hint = f"a mapping says what they are; known fields: {', '.join(FIELDS)}"
        raise InputError("has no field of a known quantity", file=path, hint=hint)
    for name in ("yaw_rad", "desired_yaw_rad"):
        if name in columns:
            columns[name] = np.unwrap(columns[name])
    time = table.columns["TimeUS"][kept].astype(float) * 1e-6
    lines = None if table.lines is None else table.lines[kept]
    return Table(
        {TIME: time, **with_angles(from_frd(columns))}, metadata=table.metadata, notes=notes, lines=lines
    )


def _messages(path: Path, kind: str | None) -> Table:
    """Return the messages of one type of a text log."""
    formats: dict[str, list[str]] = {}
    rows: dict[str, list[tuple[int, list[str]]]] = {}
    with path.open(encoding="utf-8", errors="replace") as stream:
        for at, line in enumerate(stream, start=1):
            name, *cells = (cell.strip() for cell in line.split(","))
            if name == "FMT" and len(cells) > 4:
                formats[cells[2]] = cells[4:]
            else:
                rows.setdefault(name, []).append((at, cells))
    known = [name for name in rows if name in formats and {"TimeUS"} < set(formats[name])]
    known = [name for name in known if set(FIELDS) & set(formats[name])]
    kind = one_of(kind, known, file=path, what="message type", key="--select with")
    whole = [(at, cells) for at, cells in rows[kind] if len(cells) == len(formats[kind])]
    lost = len(rows[kind]) - len(whole)
    notes = [f"{lost} of {len(rows[kind])} rows of {kind} are cut off and left out"] if lost else []
    columns: dict[str, Any] = {}
    for k, name in enumerate(formats[kind]):
        cells = [row[k] for _, row in whole]
        try:
            columns[name] = np.array(cells, dtype=float)
        except ValueError:
            columns[name] = np.array(cells, dtype=object)
    lines = np.array([at for at, _ in whole], dtype=np.int64)
    return Table(columns, metadata={"type": kind}, notes=notes, lines=lines)


PROFILE = Profile("ardupilot", "log of ArduPilot", _recognises, _read)
