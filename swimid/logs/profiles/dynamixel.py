"""Logs of Dynamixel servos (X series) with the names of the control table: Present Position, Goal Position,
...

A turn has 4096 ticks and 2048 is the middle; velocities count 0.229 rev/min (ROBOTIS e-Manual, X series). The
present position is the joint, the goal position its command. A number in the name is that of the servo.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np

from swimid.errors import InputError
from swimid.logs import clock, units
from swimid.logs.choices import Choices
from swimid.logs.foreign import open_table
from swimid.logs.foreign.base import Table, is_text
from swimid.logs.log import TIME
from swimid.logs.profiles.base import Peek, Profile

TICKS_PER_TURN, MIDDLE_TICK, REV_PER_MIN = 4096, 2048, 0.229
_FIELD = re.compile(
    r"(dxl|id|servo|motor|joint)?[ _]*(?P<before>\d*)[ _:.-]*"
    r"(?P<what>present|goal)[ _]*(?P<which>position|velocity)"
    r"[ _\[(#id]*(?P<after>\d*)[\])]?",
    re.I,
)
_TIME = re.compile(r"(?P<name>t|time|timestamp)[ _]*[(\[]?(?P<unit>s|ms|us|ns|sec|seconds)[)\]]?", re.I)


def _recognises(peek: Peek) -> bool:
    fields = [hit for name in peek.header if (hit := _FIELD.fullmatch(name))]
    return any(hit["which"].lower() == "position" for hit in fields)


def _read(path: Path, choices: Choices) -> Table:
    table = open_table(path)
    fields = {name: hit for name in table.columns if (hit := _FIELD.fullmatch(name.strip()))}
    numbers = list(dict.fromkeys(hit["before"] or hit["after"] or "1" for hit in fields.values()))
    columns: dict[str, Any] = {}
    for name, hit in fields.items():
        if is_text(table.columns[name]):
            raise InputError("holds text, not ticks", file=path, column=name)
        ticks = table.columns[name].astype(float)
        # joints count from 1, in the order of the file; servos may have any number
        joint = numbers.index(hit["before"] or hit["after"] or "1") + 1
        stem = "joint" if hit["what"].lower() == "present" else "cmd"
        if hit["which"].lower() == "position":
            columns[f"{stem}{joint}_rad"] = (ticks - MIDDLE_TICK) * 2 * np.pi / TICKS_PER_TURN
        else:
            columns[f"{stem}{joint}_rad_s"] = ticks * REV_PER_MIN * units.UNITS["turn rate"]["rpm"]
    if not columns:
        hint = "its columns are named as in the control table: Present Position, Goal Position"
        raise InputError("has no position of a servo", file=path, hint=hint)
    metadata = {"servos": [int(number) for number in numbers]}
    return Table(
        _times(table, path, columns),
        metadata=metadata,
        notes=table.notes,
        lines=table.lines,
        scalars=table.scalars,
    )


def _times(table: Table, path: Path, columns: dict[str, Any]) -> dict[str, Any]:
    """Return the columns with their times in front, or with the numbers of the rows."""
    for name in table.columns:
        hit = _TIME.fullmatch(name.strip())
        unit = (
            hit["unit"] if hit else table.units.get(name) if name.strip().lower() in ("t", "time") else None
        )
        if unit:
            time = clock.Time(source=name, unit=units.canonical(unit))
            return {TIME: clock.seconds(table, time, len(next(iter(columns.values()))), path, {}), **columns}
    return {"frame": np.arange(len(next(iter(columns.values()))), dtype=float), **columns}


PROFILE = Profile("dynamixel", "log of Dynamixel servos", _recognises, _read)
