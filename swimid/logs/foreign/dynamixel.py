"""Reader of logs of Dynamixel servos (X series) with the column names of the servo's control table.

An example of a column name is Present Position. A rotation has 4096 ticks; the position 2048 is the angle 0.
Velocities have the unit 0.229 rev/min (ROBOTIS e-Manual, X series). The present position is the joint angle,
and the goal position is the command. A number in the name of a column is the number of the servo.
"""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from swimid.errors import InputError
from swimid.logs import mapping
from swimid.logs.foreign import UNITS, Format, Options, Peek, Table, canonical, is_text, open_table
from swimid.logs.log import TIME

_FIELD = re.compile(
    r"(dxl|id|servo|motor|joint)?[ _]*\d*[ _:.-]*(?P<what>present|goal)[ _]*(?P<which>position|velocity)"
    r"[ _\[(#id]*\d*[\])]?",
    re.I,
)
_TIME = re.compile(r"(t|time|timestamp)[ _]*[(\[]?(?P<unit>s|ms|us|ns|sec|seconds)?[)\]]?", re.I)


def _recognises(peek: Peek) -> bool:
    fields = [hit for name in peek.header if (hit := _FIELD.fullmatch(name))]
    return any(hit["which"].lower() == "position" for hit in fields)


def _read(path: Path, options: Options, select: str | None) -> Table:
    table = open_table(path)
    fields = {name: hit for name in table.columns if (hit := _FIELD.fullmatch(name.strip()))}
    if not fields:
        hint = "its columns are named as in the control table: Present Position, Goal Position"
        raise InputError("has no position of a servo", file=path, hint=hint)
    servos = {name: int([*re.findall(r"\d+", name), "1"][0]) for name in fields}
    # Number the joints from 1 in the order of the file, because the numbers of servos are arbitrary.
    numbers = list(dict.fromkeys(servos.values()))
    rows = len(table.columns[next(iter(fields))])
    columns = {"frame": np.arange(rows, dtype=float)}
    for name in table.columns:
        hit = _TIME.fullmatch(name.strip())
        unit = hit and (hit["unit"] or table.units.get(name))
        if unit and TIME not in columns:
            time = mapping.Time(source=name, unit=canonical(unit))
            columns = {TIME: mapping.seconds(table, time, rows, path, {})}
    for name, hit in fields.items():
        if is_text(table.columns[name]):
            raise InputError("holds text, not ticks", file=path, column=name)
        ticks = table.columns[name].astype(float)
        stem = {"present": "joint", "goal": "cmd"}[hit["what"].lower()]
        joint = f"{stem}{numbers.index(servos[name]) + 1}"
        if hit["which"].lower() == "position":
            columns[f"{joint}_rad"] = (ticks - 2048) * 2 * np.pi / 4096
        else:
            columns[f"{joint}_rad_s"] = ticks * 0.229 * UNITS["turn rate"]["rpm"]
    return replace(table, columns=columns, metadata={"servos": numbers}, units={})


PROFILE = Format("dynamixel", "log of Dynamixel servos", _read, _recognises)
