"""Reader of tracks of Kinovea: CSV of all tracks, text for Gnuplot, and annotation files (KVA).

CSV has the columns ``Time``, ``track/point/X``, ``track/point/Y``, ... The text has sections, each with the
name of a track in a comment and with t, x and y. Both formats have y up. They do not state the units of
length and time, which the user chooses in Kinovea. All times are times of frames, so that the frame numbers
follow from them. KVA is XML with the coordinates of each track in pixels, y down, and with time stamps.
"""

from __future__ import annotations

import csv
import re
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from swimid.errors import InputError
from swimid.imports.formats import open_table
from swimid.imports.formats.keypoints import points
from swimid.imports.table import Array, ForeignTable, Format, Peek, ReaderOptions, choose, length
from swimid.logs.log import TIME
from swimid.logs.sampling import find_grid, quantum

_TEXT = "#Kinovea Trajectory data export"
#: Seconds in the parts of a time: hours, minutes, seconds and hundredths.
_KINOVEA_CLOCK = [3600.0, 60.0, 1.0, 0.01]
_TRACK_NAME = re.compile(r"(?P<track>.+)/(?P<point>[^/]+)/(?P<axis>[XY])")


def _header(peek: Peek) -> list[str]:
    """Return the column names in the first line of a file, split at commas or semicolons."""
    line = (peek.lines or [""])[0].replace("\r", " ")
    mark = ";" if ";" in line else ","
    return next(csv.reader([line], delimiter=mark), [])


def _is_table(peek: Peek) -> bool:
    names = _header(peek)
    return names[:1] == ["Time"] and len(names) > 2 and all(_TRACK_NAME.fullmatch(name) for name in names[1:])


def _recognises(peek: Peek) -> bool:
    return b"<KinoveaVideoAnalysis" in peek.head or peek.lines[:1] == [_TEXT] or _is_table(peek)


def _read(path: Path, options: ReaderOptions, select: str | None) -> ForeignTable:
    peek = Peek.of(path)
    if b"<KinoveaVideoAnalysis" in peek.head:
        return _of_kva(path, select)
    if peek.lines[:1] == [_TEXT]:
        time, found = _of_text(path)
    elif _is_table(peek):
        time, found = _of_csv(path)
    else:
        hint = "export the tracks as CSV, or save a KVA file"
        raise InputError("is not a track export of Kinovea", file=path, hint=hint)
    factor, unit = length(options.length_unit, path)
    scaled = {name: values * factor for name, values in found.items()}
    frames = _frame_numbers(time)
    if frames is None:
        hint = "a mapping states the unit of the times: time: {source: Time, unit: ms}"
        raise InputError("the times are not multiples of a frame period", file=path, hint=hint)
    return ForeignTable({"frame": frames, "Time": time, **points(scaled, unit, "up")})


def _frame_numbers(time: Array) -> Array | None:
    """Return the frame number of each time, from 0; None if the times are not rounded multiples of a period.

    The initial guess of the period is the mean of the shortest time steps, which differ only by rounding.
    """
    steps, rounding = np.diff(time), quantum(time)
    shortest = np.min(steps, initial=np.inf)
    if not 0 < shortest < np.inf:
        return None
    starts = [float(np.mean(some)) for some in (steps[steps <= shortest + 1.01 * rounding], steps)]
    grid = find_grid(time, starts, max(rounding, 1e-6 * shortest), min_share=0.0)
    return None if grid is None else grid[1].astype(float)


def _of_csv(path: Path) -> tuple[Array, dict[str, Array]]:
    """Return the times and the coordinates of the points in a CSV table, by names such as ``point.x``."""
    table = open_table(path)
    hits = {name: hit for name in table.columns if (hit := _TRACK_NAME.fullmatch(name))}
    inner: dict[str, set[str]] = {}
    for hit in hits.values():
        inner.setdefault(hit["track"], set()).add(hit["point"])
    found = {}
    for name, hit in hits.items():
        point = hit["track"]
        if len(inner[point]) > 1:
            point = f"{point} {hit['point']}"
        found[f"{point}.{hit['axis'].lower()}"] = table.columns[name].astype(float)
    return table.columns["Time"].astype(float), found


def _of_text(path: Path) -> tuple[Array, dict[str, Array]]:
    """Return the times of all sections of a text, and coordinates of their tracks by names like ``track.x``.

    Kinovea 0.8 writes no names of tracks, and times as hours:minutes:seconds:hundredths. Empty lines separate
    its tracks.
    """
    import pandas as pd

    rows, name, count = [], "", 0
    lines = path.read_text(encoding="utf-8-sig", errors="replace").splitlines()
    for at, line in enumerate(lines[2:], start=3):
        cells = line.replace(",", ".").split()
        if line.startswith("#") or not cells:
            name = line[1:].strip()
            continue
        if len(cells) != 3:
            hint = "export the tracks again"
            raise InputError(f"has {len(cells)} values in place of t, x and y", file=path, line=at, hint=hint)
        count += not name
        name = name or f"track {count}"
        # A time without a colon is a number in the unit that the user chose.
        clock = [float(part) for part in cells[0].split(":")]
        time = clock[0] if len(clock) == 1 else np.dot(clock, _KINOVEA_CLOCK[-len(clock) :])
        rows.append((name, time, float(cells[1]), float(cells[2])))
    if not rows:
        raise InputError("holds no track", file=path, hint="export the tracks again")
    whole = pd.DataFrame(rows, columns=["track", "t", "x", "y"]).pivot(index="t", columns="track")
    found = {f"{name}.{axis}": values.to_numpy() for (axis, name), values in whole.items()}
    return whole.index.to_numpy(), found


def _of_kva(path: Path, select: str | None) -> ForeignTable:
    root = ElementTree.parse(path).getroot()
    tracks: dict[str, Array] = {}
    for track in root.iter("Track"):
        cells = [(point.text or "").split(";") for point in track.iter("TrackPoint")]
        name = track.get("name") or track.findtext("Label/Text") or track.get("id") or str(len(tracks) + 1)
        tracks[name] = np.array([[float(cell) for cell in row[:3]] for row in cells])
    chosen = tracks[choose(select, [name for name, cells in tracks.items() if len(cells)], "track", path)]
    x, y, stamps = chosen.T
    period = float(root.findtext("AverageTimeStampsPerFrame") or "nan")
    rate = float(root.findtext("CaptureFramerate") or "nan")
    if not period > 0:
        text = "has no AverageTimeStampsPerFrame, without which the times of the frames are unknown"
        raise InputError(text, file=path, hint="export the tracks from Kinovea as CSV")
    frames = np.round((stamps - stamps[0]) / period)
    clock = {"frame": frames}
    if rate > 0:
        clock = {TIME: (stamps - stamps[0]) / period / rate}
    return ForeignTable({**clock, **points({"x": x, "y": y})})


PROFILE = Format("kinovea", "track file of Kinovea", _read, _recognises)
