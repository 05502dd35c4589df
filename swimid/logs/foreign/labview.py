"""Readers of LabVIEW files: measurement files (LVM, text), and TDMS by the library nptdms.

Both state the unit of each channel and the sampling interval. A channel is converted to SI units if its unit
belongs to one quantity only. Otherwise it keeps its name and its values, and a mapping must state its unit.
"""

from __future__ import annotations

import logging
import re
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from swimid.errors import InputError
from swimid.logs.foreign import (
    UNITS,
    Array,
    Format,
    Options,
    Peek,
    Table,
    canonical,
    choose,
    in_si,
    numbers,
    unique,
)
from swimid.logs.log import TIME

_END = "***End_of_Header***"
_SEPARATORS = {"Tab": "\t", "Comma": ","}
#: Pattern of the names of channels that hold the time.
_TIME_NAME = re.compile(r"(.*[ _])?(t|time)", re.I)


def _clock(columns: dict[str, Array], rows: int) -> dict[str, Array]:
    """Return the columns of a file, with row numbers if it states no times."""
    if TIME in columns:
        return columns
    return {"frame": np.arange(rows, dtype=float), **columns}


# ---------------------------------------------------------------- LVM


def _is_lvm(peek: Peek) -> bool:
    return bool(peek.lines) and peek.lines[0].startswith("LabVIEW Measurement")


def _read_lvm(path: Path, options: Options, select: str | None) -> Table:
    lines = path.read_text(encoding="utf-8-sig", errors="replace").splitlines()
    ends = [at for at, line in enumerate(lines) if line.strip().startswith(_END)]
    head: dict[str, list[str]] = {}
    mark = ","
    for line in lines[: ends[0] if ends else 0]:
        key, *cells = re.split(r"[\t,]", line, maxsplit=1)
        head[key.strip()] = cells
        if key.strip() == "Separator":
            mark = _SEPARATORS.get("".join(cells).strip(), "\t")
    # The first header describes the file, each other one a segment.
    starts = {str(k): (before + 1, end) for k, (before, end) in enumerate(pairwise(ends), start=1)}
    if not starts:
        raise InputError("has no segment with samples", file=path, hint=f"a segment follows a line {_END}")
    begin, end = starts[choose(select, list(starts), "segment", path)]
    segment = {cells[0]: cells[1:] for cells in (line.split(mark) for line in lines[begin:end])}
    names = [name.strip() for name in lines[end + 1].split(mark)] if end + 1 < len(lines) else []
    if "Comment" in names:
        names = names[: names.index("Comment")]
    last = next((at for at in range(end + 2, len(lines)) if not lines[at].strip()), len(lines))
    if not names or last == end + 2:
        raise InputError("ends before its samples", file=path, line=len(lines))
    decimal = "".join(head.get("Decimal_Separator", ["."])).strip() or "."
    values, rows = numbers(path, end + 2, mark, len(names), most=last - end - 2, decimal=decimal)

    def stated(key: str, at: int) -> str:
        cells = segment.get(key, [])
        return cells[at].strip() if at < len(cells) else ""

    form = "".join(head.get("X_Columns", ["One"])).strip()
    if form == "Multi":
        hint = "write the file with one column of x values (or none)"
        raise InputError("has a column of x values for each channel", file=path, hint=hint)
    columns: dict[str, Array] = {}
    if stated("X_Dimension", 0) in ("Time", ""):
        if form == "One":
            columns[TIME] = values[:, 0]
        elif stated("Delta_X", 0):
            start, step = (float(stated(key, 0).replace(decimal, ".") or 0) for key in ("X0", "Delta_X"))
            columns[TIME] = start + step * np.arange(len(values), dtype=float)
    for at, name in enumerate(unique(names[1:])):
        column, converted = in_si(name, stated("Y_Unit_Label", at), values[:, at + 1])
        columns[column] = converted
    return Table(_clock(columns, len(values)), lines=rows)


LVM = Format("lvm", "LabVIEW measurement file", _read_lvm, _is_lvm)


# ---------------------------------------------------------------- TDMS


def _is_tdms(peek: Peek) -> bool:
    return peek.head.startswith(b"TDSm")


def _read_tdms(path: Path, options: Options, select: str | None) -> Table:
    from nptdms import TdmsFile
    from nptdms.log import log_manager

    log_manager.set_level(logging.ERROR)  # the library prints a warning of a file that is cut off
    file = TdmsFile.read(path)
    if file.file_status.incomplete_final_segment:
        raise InputError("is cut off within its samples", file=path, hint="copy the file again")
    groups = {group.name: [c for c in group.channels() if len(c)] for group in file.groups()}
    there = [name for name, channels in groups.items() if channels]
    name = choose(select, there, "group", path)
    columns: dict[str, Array] = {}
    names = unique(channel.name for channel in groups[name])
    for shown, channel in zip(names, groups[name], strict=True):
        unit = str(channel.properties.get("unit_string", ""))
        values = channel[:]
        if values.dtype.kind == "M":
            nanoseconds = values.astype("datetime64[ns]").astype(np.int64)
            columns.setdefault(TIME, (nanoseconds - nanoseconds[0]) * 1e-9)
        elif (
            values.dtype.kind in "iufb"
            and _TIME_NAME.fullmatch(channel.name)
            and canonical(unit) in UNITS["time"]
        ):
            columns[TIME] = values.astype(float) * UNITS["time"][canonical(unit)]
        elif values.dtype.kind in "iufb":
            column, converted = in_si(shown, unit, values.astype(float))
            columns[column] = converted
    if TIME not in columns:
        columns = _waveform_times(groups[name], path) | columns
    metadata = {str(key): value for key, value in file.properties.items() if isinstance(value, str)}
    return Table(_clock(columns, len(groups[name][0])), metadata=metadata)


def _waveform_times(channels: list[Any], path: Path) -> dict[str, Array]:
    """Return the column of the times that the properties of waveform channels state; empty if they do not.

    Raises
    ------
    InputError
        The channels of the group have different times.
    """
    keys = ("wf_start_offset", "wf_increment")
    clocks = {tuple(float(c.properties.get(key, 0.0)) for key in keys) for c in channels}
    clocks = {clock for clock in clocks if clock[1] > 0}
    if len(clocks) > 1:
        steps = ", ".join(f"{step:g} s" for _, step in sorted(clocks))
        hint = "write channels of one rate to one group"
        raise InputError(f"channels have different times: intervals {steps}", file=path, hint=hint)
    if not clocks:
        return {}
    start, step = clocks.pop()
    return {TIME: start + step * np.arange(len(channels[0]), dtype=float)}


TDMS = Format("tdms", "TDMS file", _read_tdms, _is_tdms, extra="tdms")
