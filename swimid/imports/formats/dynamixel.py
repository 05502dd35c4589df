"""Reader of logs of Dynamixel servos with the column names of the servo's control table.

An example of a column name is Present Position. Servos of the series X and MX have 4096 ticks per rotation,
and the position 2048 is the angle 0. AX servos and the XL-320 have 1024 ticks in 300 degrees, and the angle 0
is 512. Positions that may be from either group of servos are refused, unless the user names the format.
Velocities have the unit 0.229 rev/min (X series; ROBOTIS e-Manual). The present position is the joint angle,
and the goal position is the command. A number in the name of a column is the number of the servo. A column ID
numbers servos whose rows alternate.
"""

from __future__ import annotations

import re
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from swimid.errors import InputError
from swimid.imports import mapping
from swimid.imports.formats import open_table
from swimid.imports.table import Array, ForeignTable, Format, Peek, ReaderOptions, is_text
from swimid.imports.table import restore_sign as with_sign
from swimid.logs.log import TIME
from swimid.logs.units import UNITS, canonical

_FIELD = re.compile(
    r"(dxl|id|servo|motor|joint)?[ _]*\d*[ _:.-]*(?P<what>present|goal)[ _]*"
    r"(?P<which>position|velocity)"
    r"[ _\[(#id]*\d*[\])]?",
    re.I,
)
_ID = re.compile(r"(dxl|servo|motor)?[ _]*(id|number)?|joint", re.I)
_TIME = re.compile(r"(t|time|timestamp)[ _]*[(\[]?(?P<unit>s|ms|us|ns|sec|seconds)?[)\]]?", re.I)


def _recognises(peek: Peek) -> bool:
    fields = [hit for name in peek.header if (hit := _FIELD.fullmatch(name))]
    return any(hit["which"].lower() == "position" for hit in fields)


def _read(path: Path, options: ReaderOptions, select: str | None, device: str = "") -> ForeignTable:
    table = open_table(path)
    fields = {name: hit for name in table.columns if (hit := _FIELD.fullmatch(name.strip()))}
    if not fields:
        hint = "name the columns as in the control table: Present Position, Goal Position"
        raise InputError("has no column with the position of a servo", file=path, hint=hint)
    servos = {name: int([*re.findall(r"\d+", name), "1"][0]) for name in fields}
    # Number the joints from 1 in the order of the file, because the numbers of servos are arbitrary.
    numbers = list(dict.fromkeys(servos.values()))
    rows = len(table.columns[next(iter(fields))])
    columns, notes = {"frame": np.arange(rows, dtype=float)}, list(table.notes)
    for name in table.columns:
        hit = _TIME.fullmatch(name.strip())
        unit = hit and (hit["unit"] or table.units.get(name))
        if unit and TIME not in columns:
            time = mapping.Time(source=name, unit=canonical(unit))
            columns = {TIME: mapping.seconds(table, time, rows, path, {})}
    for name, hit in fields.items():
        if is_text(table.columns[name]):
            cell = max(map(str, table.columns[name]))
            text = f"'{cell}' is text; positions and speeds are whole numbers of servo ticks"
            raise InputError(text, file=path, column=name)
        ticks = table.columns[name].astype(float)
        stem = {"present": "joint", "goal": "cmd"}[hit["what"].lower()]
        joint = f"{stem}{numbers.index(servos[name]) + 1}"
        # No value of a servo exceeds 2^31. A larger value is a negative number of four bytes.
        ticks = with_sign(np.where(ticks >= 2.0**31, ticks - 2.0**32, ticks), name, notes)
        if hit["which"].lower() == "velocity":
            columns[f"{joint}_rad_s"] = ticks * 0.229 * UNITS["turn rate"]["rpm"]
        else:
            columns[f"{joint}_rad"] = _angle(ticks, device, path, name)
    keys = {name: values for name, values in table.columns.items() if _ID.fullmatch(name.strip())}
    return replace(table, columns=columns, metadata={"servos": numbers}, units={}, keys=keys, notes=notes)


def _angle(ticks: Array, device: str, path: Path, name: str) -> Array:
    """Return the angles of a servo, rad, for positions in ticks. ``device`` is ``x``, ``ax``, or unknown."""
    known = ticks[np.isfinite(ticks)]
    low, high = known.min(initial=1024), known.max(initial=0)
    if not device and low >= 0 and high < 1024:
        text = f"the ticks, {low:g} to {high:g}, are of 4096 in a turn (X, MX) or of 1024 in 300 degrees (AX)"
        hint = "name the servo: --as dynamixel-x, or --as dynamixel-ax (AX, XL-320)"
        raise InputError(text, file=path, column=name, hint=hint)
    if device == "ax":
        return (ticks - 512) * np.radians(300) / 1024
    return (ticks - 2048) * 2 * np.pi / 4096


TITLE = "log of Dynamixel servos"
PROFILE = Format("dynamixel", TITLE, _read, _recognises)
X = Format("dynamixel-x", f"{TITLE} of the series X or MX", partial(_read, device="x"), lambda peek: False)
AX = Format("dynamixel-ax", f"{TITLE} of the series AX", partial(_read, device="ax"), lambda peek: False)
