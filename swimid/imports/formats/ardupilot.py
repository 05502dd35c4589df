"""Readers of ArduPilot logs: DataFlash (text, ``.bin``), CSV of one message type, and MAVLink (``.tlog``).

The library pymavlink reads binary logs. In a text log a message is a line such as ``IMU, 1234, 0, ...``. If a
log has several instances of a sensor, one is read. Units are those of the log messages of ArduPilot, or those
that MAVLink defines. Latitude and longitude become metres. Axes forward, right, down are converted to
forward, left, up.
"""

from __future__ import annotations

import contextlib
import io
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from swimid.errors import InputError
from swimid.imports.formats import open_table
from swimid.imports.formats.gps import east_north
from swimid.imports.table import (
    Array,
    ForeignTable,
    Format,
    Peek,
    ReaderOptions,
    axes,
    choose,
    flat,
    is_text,
    of_records,
    rename_columns,
    rows,
)
from swimid.kinematics.attitude import AXES, from_frd, with_angles
from swimid.logs.log import TIME

#: Column of the log for each field of a message of ArduPilot.
ARDUPILOT_FIELDS: dict[str, str] = {
    **axes("Gyr{}", "w{}_rad_s", "XYZ", "xyz"),
    **axes("Acc{}", "a{}_m_s2", "XYZ", "xyz"),
    **axes("Mag{}", "m{}_T", "XYZ", "xyz"),
    **{angle: f"{angle.lower()}_rad" for angle in ("Roll", "Pitch", "Yaw")},
    **{f"Des{angle}": f"desired_{angle.lower()}_rad" for angle in ("Roll", "Pitch", "Yaw")},
    **axes("P{}", "{}_m", "NED", "xyz"),
    **axes("V{}", "v{}_m_s", "NED", "xyz"),
    **axes("Q{}", "q{}", "1234", "wxyz"),
}
#: Column of the log for each field of a message of MAVLink.
MAVLINK: dict[str, str] = {
    **axes("{}gyro", "w{}_rad_s"),
    **axes("{}acc", "a{}_m_s2"),
    **axes("{}mag", "m{}_T"),
    **{angle: f"{angle}_rad" for angle in ("roll", "pitch", "yaw")},
    **dict(zip(("rollspeed", "pitchspeed", "yawspeed"), ("wx_rad_s", "wy_rad_s", "wz_rad_s"), strict=True)),
    **axes("{}", "{}_m"),
    **axes("v{}", "v{}_m_s"),
    **axes("q{}", "q{}", "1234", "wxyz"),
}
#: Factors to SI units: from the units of ArduPilot (degrees to radians, milligauss to tesla), by the ending
#: of the log column; and from the units that MAVLink states, by unit.
FACTORS = {"_rad": np.pi / 180, "_T": 1e-7}
STATED = {
    **dict.fromkeys(("m", "m/s", "m/s/s", "rad", "rad/s"), 1.0), "mm": 1e-3, "cm": 1e-2, "mm/s": 1e-3,
    "cm/s": 1e-2, "mG": 9.80665e-3, "mrad/s": 1e-3, "mgauss": 1e-7, "gauss": 1e-4,
}  # fmt: skip
#: Fields that state the time, with their factor to seconds. The first field that a message has is used.
_TIMES = {"TimeUS": 1e-6, "time_boot_ms": 1e-3, "time_usec": 1e-6}
#: Fields of latitude and longitude, with the factor to degrees.
_PLACES = {("Lat", "Lng"): 1.0, ("lat", "lon"): 1e-7}
#: Fields that number the instances of a sensor.
_INSTANCES = ("I", "C", "Instance", "id")
_TITLE = "binary log of ArduPilot or MAVLink"
#: First bytes of a binary DataFlash log (MAGIC), and bytes with which a message of MAVLink begins after its
#: time stamp (_MARKS).
MAGIC, _MARKS = b"\xa3\x95", (b"\xfe", b"\xfd")


def _is_binary(peek: Peek) -> bool:
    is_mavlink = peek.path.suffix.lower() == ".tlog" and peek.head[8:9] in _MARKS
    return is_mavlink or peek.head.startswith(MAGIC)


def _open_binary(path: Path, options: ReaderOptions, select: str | None) -> ForeignTable:
    """Return a table of the messages of one type in a binary log, with the names and units of the log."""
    from pymavlink import DFReader, mavutil

    head, opened = Peek.of(path).head, mavutil.mavlogfile
    if head.startswith(MAGIC):
        opened = DFReader.DFReader_binary
    elif head[8:9] not in _MARKS:
        raise InputError(f"is no {_TITLE}", file=path, hint="name its format: --as NAME")
    messages: dict[str, list[Any]] = {}
    with contextlib.redirect_stdout(io.StringIO()) as said, contextlib.redirect_stderr(said):
        log = opened(str(path))
        while (message := log.recv_match(type=select)) is not None:
            messages.setdefault(message.get_type(), []).append(message)
    notes = ["the file is damaged; its readable part was read"] * bool(said.getvalue())
    known = {name for name, (one, *_) in messages.items() if _has_quantity(one.to_dict())}
    kind = choose(select, [name for name in messages if select or name in known], "message type", path)
    records = [dict(flat(one.to_dict())) | {"recorded_s": one._timestamp} for one in messages[kind]]
    units = getattr(messages[kind][0], "fieldunits_by_name", {})
    return ForeignTable(of_records(records), units=units, metadata={"type": kind}, notes=notes)


def _has_quantity(fields: dict[str, Any]) -> bool:
    """Return whether a message has a time, and a field of a known quantity."""
    places = {name for names in _PLACES for name in names}
    return bool({*_TIMES} & {*fields}) and bool({*ARDUPILOT_FIELDS, *MAVLINK, *places} & {*fields})


BINARY = Format("mavlink", _TITLE, _open_binary, None, (".bin", ".tlog"), (MAGIC,), "mavlink")


def _recognises(peek: Peek) -> bool:
    types = {line.split(",")[0].strip() for line in peek.lines[:50]}
    return "TimeUS" in peek.header or ("FMT" in types and b"TimeUS" in peek.head) or _is_binary(peek)


def _read(path: Path, options: ReaderOptions, select: str | None) -> ForeignTable:
    kind, _, instance = (select or "").rstrip("]").partition("[")
    peek = Peek.of(path)
    if _is_binary(peek):
        table = open_table(path, kind="mavlink", select=kind or None)
    elif peek.header[0] == "FMT" or "TimeUS" not in peek.header:
        table = _messages(path, kind or None)
    else:
        table, instance = open_table(path), instance or kind
    table = _choose_instance(table, instance, path)
    columns = _convert_fields(table)
    for (lat, lon), factor in _PLACES.items():
        if lat in table.columns:
            place, origin = east_north(*(factor * table.columns[name].astype(float) for name in (lat, lon)))
            columns |= {"x_m": place["y_m"], "y_m": place["x_m"]}
            table.metadata |= origin
    time = next((name for name in _TIMES if name in table.columns), None)
    if not columns or time is None:
        hint = f"assign fields in a mapping; known fields: {', '.join([*ARDUPILOT_FIELDS, *MAVLINK])}"
        raise InputError(
            "needs a time and at least one field of a known quantity, and has not both", file=path, hint=hint
        )
    time_s = table.columns[time].astype(float) * _TIMES[time]
    return replace(table, columns={TIME: time_s, **with_angles(from_frd(columns))}, units={})


def _choose_instance(table: ForeignTable, instance: str, path: Path) -> ForeignTable:
    """Return the messages of one instance of a sensor: of the selected instance, or of the first one."""
    by = next((name for name in _INSTANCES if name in table.columns), None)
    if by is None or is_text(table.columns[by]):
        return table
    there = [f"{value:g}" for value in np.unique(table.columns[by])]
    taken = choose(instance or there[0], there, "instance", path)
    table = rows(table, table.columns[by] == float(taken))
    if len(there) > 1 and not instance:
        other = there[1]
        if "type" in table.metadata:
            other = f"{table.metadata['type']}[{other}]"
        note = f"instance {taken} of {', '.join(there)} is taken (--select {other} takes another instance)"
        table.notes.append(note)
    return table


def _convert_fields(table: ForeignTable) -> dict[str, Array]:
    """Return the fields of known quantities in SI units, by their log columns, with unwrapped yaw angles.

    A field without a known unit is left out, such as the raw counts of a sensor. Quaternions have no unit.
    """
    columns = rename_columns(table, ARDUPILOT_FIELDS)
    for name in columns:
        columns[name] *= next((f for ending, f in FACTORS.items() if name.endswith(ending)), 1.0)
    units = {MAVLINK[name]: STATED.get(unit) for name, unit in table.units.items() if name in MAVLINK}
    for name, values in rename_columns(table, MAVLINK).items():
        factor = 1.0 if name in AXES else units.get(name)
        if factor is not None:
            columns[name] = values * factor
    yaws = [name for name in columns if "yaw" in name]
    return columns | {name: np.unwrap(np.angle(np.exp(1j * columns[name]))) for name in yaws}


def _messages(path: Path, kind: str | None) -> ForeignTable:
    """Return a table of the messages of one type in a text log of ArduPilot."""
    import pandas as pd

    text = path.read_text(encoding="utf-8", errors="replace")
    messages = [[cell.strip() for cell in line.split(",")] for line in text.split("\n")]
    timed = [cells for cells in messages if cells[0] == "FMT" and "TimeUS" in cells[5:]]
    formats = {cells[3]: cells[5:] for cells in timed if not {*ARDUPILOT_FIELDS}.isdisjoint(cells[5:])}
    present = dict.fromkeys(cells[0] for cells in messages)
    kind = choose(kind, list(filter(formats.get, present)), "message type", path)
    found = {at: cells[1:] for at, cells in enumerate(messages, start=1) if cells[0] == kind}
    whole = {at: cells for at, cells in found.items() if len(cells) == len(formats[kind])}
    frame = pd.DataFrame.from_dict(whole, orient="index", columns=formats[kind])
    frame = frame.apply(pd.to_numeric, errors="coerce").dropna(axis=1, how="all")
    lost = len(found) - len(whole)
    notes = []
    if lost:
        notes.append(f"{lost} of {len(found)} rows of {kind} are cut off and left out")
    columns = dict(zip(frame, frame.to_numpy(dtype=float).T, strict=True))
    return ForeignTable(columns, metadata={"type": kind}, notes=notes, lines=frame.index.to_numpy())


PROFILE = Format("ardupilot", "log of ArduPilot or MAVLink", _read, _recognises)
