"""Readers of LabVIEW files: measurement files (LVM, text), and TDMS by the library nptdms.

Both formats state the unit of each channel and the sampling interval. A channel is converted to SI units if
its unit belongs to one quantity only. Any other channel keeps its name and its values, and a mapping must
state its unit.
"""

from __future__ import annotations

import contextlib
import logging
import re
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from swimid.errors import InputError
from swimid.imports.table import (
    Array,
    ForeignTable,
    Format,
    Peek,
    ReaderOptions,
    choose,
    from_first,
    in_si,
    numbers,
)
from swimid.logs.log import TIME
from swimid.logs.units import UNITS, canonical, unique

_END = "***End_of_Header***"
_SEPARATORS = {"Tab": "\t", "Comma": ","}
#: Pattern of the names of channels that hold the time.
_TIME_NAME = re.compile(r"(.*[ _])?(t|time)", re.I)


def _add_times(
    columns: dict[str, Array], clocks: dict[str, tuple[float, float]], metadata: dict[str, Any], path: Path
) -> ForeignTable:
    """Return the table of channels at their common times; with row numbers if the file states no times.

    Parameters
    ----------
    columns : dict of str to ndarray, each shape (n,)
        Channels, and perhaps their times. The lengths of the channels may differ.
    clocks : dict of str to (float, float)
        Time of the first sample and interval of each channel, s. Channels without a clock are kept.

    Raises
    ------
    InputError
        The intervals differ, or the channels have no time in common.
    """
    if TIME in columns:
        return ForeignTable(columns, metadata=metadata)
    if not clocks:
        rows = np.arange(len(next(iter(columns.values()))), dtype=float)
        return ForeignTable({"frame": rows, **columns}, metadata=metadata)
    starts, steps = np.array(list(clocks.values())).T
    if np.ptp(steps) > 1e-9 * steps[0]:
        text = f"channels have different times: intervals {', '.join(f'{step:g} s' for step in {*steps})}"
        raise InputError(text, file=path, hint="write channels of one rate to one group")
    # Number the first and the last sample of each channel, counted from the first sample of the first
    # channel.
    first = (starts - starts[0]) / steps[0]
    counts = np.array([len(columns[name]) for name in clocks])
    at = np.arange(np.ceil(first.max() - 1e-6), np.floor((first + counts).min() + 1e-6))
    if len(at) < 2:
        begins = ", ".join(f"{start:g} s" for start in starts)
        text = f"channels have no time in common: they start at {begins}"
        raise InputError(text, file=path, hint="record the channels at the same time")
    for name, lead, count in zip(clocks, first, counts, strict=True):
        if lead or count != len(at):
            columns[name] = np.interp(at, lead + np.arange(count), columns[name])
    notes = []
    if np.ptp(first):
        metadata |= {"channels_start_s": {name: start for name, (start, _) in clocks.items()}}
    if np.abs(first - np.round(first)).max() > 1e-3:
        notes.append("channels start between the samples of other channels, and are interpolated")
    if np.ptp(counts):
        notes.append(f"channels have different numbers of samples; the {len(at)} common samples are taken")
    return ForeignTable({TIME: starts[0] + steps[0] * at, **columns}, metadata=metadata, notes=notes)


# ---------------------------------------------------------------- LVM


def _is_lvm(peek: Peek) -> bool:
    return bool(peek.lines) and peek.lines[0].startswith("LabVIEW Measurement")


def _read_lvm(path: Path, options: ReaderOptions, select: str | None) -> ForeignTable:
    lines = path.read_text(encoding="utf-8-sig", errors="replace").splitlines()
    ends = [at for at, line in enumerate(lines) if line.strip().startswith(_END)]
    top = "\n".join(lines[: min(ends, default=0)])
    head = {key.strip(): value.strip() for key, value in re.findall(r"(?m)^([^\t,\n]*)[\t,]?(.*)$", top)}
    mark = _SEPARATORS.get(head.get("Separator", "Comma"), "\t")
    # The first header describes the file. Each further header describes a segment.
    starts = {str(k): (before + 1, end) for k, (before, end) in enumerate(pairwise(ends), start=1)}
    if not starts:
        raise InputError("has no segment with samples", file=path, hint=f"a segment follows a line {_END}")
    begin, end = starts[choose(select, list(starts), "segment", path)]
    segment = {cells[0]: cells[1:] for cells in (line.split(mark) for line in lines[begin:end])}
    names = [name.strip() for name in "".join(lines[end + 1 : end + 2]).split(mark)]
    names = names[: [*names, "Comment"].index("Comment")]
    last = next((at for at in range(end + 2, len(lines)) if not lines[at].strip()), len(lines))
    if not names or last <= end + 2:
        raise InputError("ends before the first sample: copy the file again", file=path, line=len(lines))
    decimal = head.get("Decimal_Separator") or "."
    values, rows = numbers(path, end + 2, mark, len(names), most=last - end - 2, decimal=decimal)
    form = head.get("X_Columns", "One")
    if form == "Multi":
        hint = "write the file with one column of x values (or none)"
        raise InputError("has more than one column of x values", file=path, hint=hint)
    table = _convert_channels(names, values, segment, decimal, path, has_times=form == "One")
    return replace(table, lines=rows[: len(next(iter(table.columns.values())))])


def _convert_channels(
    names: list[str],
    values: Array,
    segment: dict[str, list[str]],
    decimal: str,
    path: Path,
    *,
    has_times: bool,
) -> ForeignTable:
    """Return the table of the channels of a segment, in SI units, at their common times.

    ``segment`` is the header of the segment: for each key the cells of all channels. If ``has_times`` is
    true, the first column of ``values`` holds the times.
    """

    def read_value(key: str, at: int) -> str:
        return "".join(segment.get(key, [])[at : at + 1]).strip()

    columns: dict[str, Array] = {}
    clocks: dict[str, tuple[float, float]] = {}
    in_time, channels = read_value("X_Dimension", 0) in ("Time", ""), range(len(names) - 1)
    stamps = np.array([_date(read_value("Date", k), read_value("Time", k), decimal) for k in channels])
    leads, metadata = from_first(stamps)
    for at, name in enumerate(unique(names[1:])):
        column, columns[column] = in_si(name, read_value("Y_Unit_Label", at), values[:, at + 1])
        start, step = (float(read_value(key, at).replace(decimal, ".") or 0) for key in ("X0", "Delta_X"))
        if in_time and step > 0:
            clocks[column] = start + leads[at], step
    if in_time and has_times and len(set(clocks.values())) < 2:
        columns = {TIME: values[:, 0], **columns}
    return _add_times(columns, clocks, metadata, path)


def _date(day: str, time: str, decimal: str) -> Any:
    """Return the date and time of day of a channel (``2019/07/22``, ``17:18:18.938945``), or NaT."""
    with contextlib.suppress(ValueError):
        return np.datetime64(f"{day.replace('/', '-')}T{time.replace(decimal, '.')[:18]}", "ns")
    return np.datetime64("NaT", "ns")


LVM = Format("lvm", "LabVIEW measurement file", _read_lvm, _is_lvm)


# ---------------------------------------------------------------- TDMS


def _read_tdms(path: Path, options: ReaderOptions, select: str | None) -> ForeignTable:
    from nptdms import TdmsFile
    from nptdms.log import log_manager

    log_manager.set_level(logging.ERROR)  # the library prints a warning of a file that is cut off
    file = TdmsFile.read(path)
    if file.file_status.incomplete_final_segment:
        raise InputError("is cut off within its samples", file=path, hint="copy the file again")
    groups = {group.name: list(filter(len, group.channels())) for group in file.groups()}
    channels = groups[choose(select, list(filter(groups.get, groups)), "group", path)]
    columns: dict[str, Array] = {}
    clocks: dict[str, tuple[float, float]] = {}
    metadata = {str(key): value for key, value in file.properties.items() if isinstance(value, str)}
    stamps = np.array([c.properties.get("wf_start_time") for c in channels], dtype="datetime64[ns]")
    leads, origin = from_first(stamps)
    for at, shown in enumerate(unique(channel.name for channel in channels)):
        unit, values = str(channels[at].properties.get("unit_string", "")), channels[at][:]
        if values.dtype.kind == "M" and TIME not in columns:
            columns[TIME], origin = from_first(values)
        elif values.dtype.kind not in "iufb":
            continue
        elif _TIME_NAME.fullmatch(channels[at].name) and canonical(unit) in UNITS["time"]:
            columns[TIME] = values.astype(float) * UNITS["time"][canonical(unit)]
        else:
            column, columns[column] = in_si(shown, unit, values.astype(float))
            step = float(channels[at].properties.get("wf_increment", 0.0))
            if step > 0:
                start = float(channels[at].properties.get("wf_start_offset", 0.0))
                clocks[column] = start + leads[at], step
    return _add_times(columns, clocks, metadata | origin, path)


TDMS = Format("tdms", "TDMS file", _read_tdms, lambda peek: peek.head.startswith(b"TDSm"), extra="tdms")
