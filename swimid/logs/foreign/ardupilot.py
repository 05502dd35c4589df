"""Reader of ArduPilot logs: text logs (``FMT`` lines, then messages), or CSV of one message type.

A message is a line such as ``IMU, 1234, 0, ...``. If a log has several instances of a sensor, one is read.
Units are those of the log messages of ArduPilot. Axes forward, right, down are converted to forward, left,
up.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from swimid.errors import InputError
from swimid.logs.foreign import Format, Options, Peek, Table, axes, choose, is_text, open_table, renamed, rows
from swimid.logs.kinematics import from_frd, with_angles
from swimid.logs.log import TIME

#: Column of the log for each field of a message of ArduPilot.
FIELDS: dict[str, str] = {
    **axes("Gyr{}", "w{}_rad_s", "XYZ", "xyz"),
    **axes("Acc{}", "a{}_m_s2", "XYZ", "xyz"),
    **axes("Mag{}", "m{}_T", "XYZ", "xyz"),
    **{angle: f"{angle.lower()}_rad" for angle in ("Roll", "Pitch", "Yaw")},
    **{f"Des{angle}": f"desired_{angle.lower()}_rad" for angle in ("Roll", "Pitch", "Yaw")},
    **axes("P{}", "{}_m", "NED", "xyz"),
    **axes("V{}", "v{}_m_s", "NED", "xyz"),
    **axes("Q{}", "q{}", "1234", "wxyz"),
}
#: Factors from the units of ArduPilot to SI (degrees to radians, milligauss to tesla), by the ending of the
#: log column.
FACTORS = {"_rad": np.pi / 180, "_T": 1e-7}


def _recognises(peek: Peek) -> bool:
    types = {line.split(",")[0].strip() for line in peek.lines[:50]}
    return "TimeUS" in peek.header or ("FMT" in types and b"TimeUS" in peek.head)


def _read(path: Path, options: Options, select: str | None) -> Table:
    kind, _, instance = (select or "").rstrip("]").partition("[")
    header = Peek.of(path).header
    if header[0] == "FMT" or "TimeUS" not in header:
        table = _messages(path, kind or None)
    else:
        table, instance = open_table(path), instance or kind
    by = next((name for name in ("I", "C", "Instance") if name in table.columns), None)
    if by is not None and not is_text(table.columns[by]):
        there = [f"{value:g}" for value in np.unique(table.columns[by])]
        taken = choose(instance or there[0], there, "instance", path)
        table = rows(table, table.columns[by] == float(taken))
        if len(there) > 1 and not instance:
            other = there[1]
            if "type" in table.metadata:
                other = f"{table.metadata['type']}[{other}]"
            note = f"instance {taken} of {', '.join(there)} is taken (another one: --select {other})"
            table.notes.append(note)
    columns = renamed(table, FIELDS)
    if not columns:
        hint = f"a mapping says what they are; known fields: {', '.join(FIELDS)}"
        raise InputError("has no field of a known quantity", file=path, hint=hint)
    for name in columns:
        columns[name] *= next((f for ending, f in FACTORS.items() if name.endswith(ending)), 1.0)
        if "yaw" in name:
            columns[name] = np.unwrap(columns[name])
    time_s = table.columns["TimeUS"].astype(float) * 1e-6
    return replace(table, columns={TIME: time_s, **with_angles(from_frd(columns))})


def _messages(path: Path, kind: str | None) -> Table:
    """Return a table of the messages of one type in a text log of ArduPilot."""
    import pandas as pd

    text = path.read_text(encoding="utf-8", errors="replace")
    messages = [[cell.strip() for cell in line.split(",")] for line in text.split("\n")]
    formats = {cells[3]: cells[5:] for cells in messages if cells[0] == "FMT" and len(cells) > 5}
    formats = {
        kind: names for kind, names in formats.items() if "TimeUS" in names and set(FIELDS) & set(names)
    }
    present = dict.fromkeys(cells[0] for cells in messages)
    kind = choose(kind, [kind for kind in present if kind in formats], "message type", path)
    found = {at: cells[1:] for at, cells in enumerate(messages, start=1) if cells[0] == kind}
    whole = {at: cells for at, cells in found.items() if len(cells) == len(formats[kind])}
    frame = pd.DataFrame.from_dict(whole, orient="index", columns=formats[kind])
    frame = frame.apply(pd.to_numeric, errors="coerce").dropna(axis=1, how="all")
    lost = len(found) - len(whole)
    notes = []
    if lost:
        notes.append(f"{lost} of {len(found)} rows of {kind} are cut off and left out")
    columns = dict(zip(frame, frame.to_numpy(dtype=float).T, strict=True))
    return Table(columns, metadata={"type": kind}, notes=notes, lines=frame.index.to_numpy())


PROFILE = Format("ardupilot", "log of ArduPilot", _read, _recognises)
