"""Reader of text files of the program Tracker (Open Source Physics).

A file holds the names of the tracks, then the column names t, x, y, then the samples. Times are in seconds.
Lengths are in metres, unless the project sets another unit, which the column names state (``x (cm)``).
"""

from __future__ import annotations

import re
from pathlib import Path

from swimid.errors import InputError
from swimid.imports.table import ForeignTable, Format, Peek, ReaderOptions, choose, length, numbers
from swimid.logs.log import TIME
from swimid.logs.units import safe

_TRACKER_NAME = re.compile(
    r"(t|step|frame|(?P<kind>[va]?)_?\{?(?P<axis>[xyr])\}?)(\s*[(\[](?P<unit>[^)\]/]*)[^)\]]*[)\]])?"
)
#: Ending that is added to the unit of length in the name of a log column, by the first letter of the Tracker
#: column: no letter for a position, ``v`` for a velocity, ``a`` for an acceleration.
_PER = {"": "", "v": "_s", "a": "_s2"}


def _layout(lines: list[str], path: Path) -> tuple[int, str, list[str], list[str]]:
    """Return header height, delimiter, and cells of the last two header lines.

    Raises
    ------
    InputError
        The file does not have the layout of Tracker.
    """
    is_multi = bool(lines) and lines[0].strip().startswith("#multi:")
    height = 2 + is_multi
    for mark in ("\t", ",", ";") * (len(lines) > height):
        tracks = [cell.strip().lstrip("#") for cell in lines[height - 2].split(mark)]
        names = [cell.strip() for cell in lines[height - 1].split(mark)]
        hits = [hit for hit in map(_TRACKER_NAME.fullmatch, names) if hit]
        has_place = any(hit["kind"] == "" and hit["axis"] in ("x", "y") for hit in hits)
        if len(hits) > 2 and hits[0][1] == "t" and has_place and (is_multi or not any(tracks[1:])):
            return height, mark, tracks, names
    hint = "Tracker exports a line with the track, a line 't x y', and the samples"
    raise InputError("is no export of Tracker", file=path, hint=hint)


def _recognises(peek: Peek) -> bool:
    return bool(_layout(peek.lines, peek.path))


def _read_tracker(path: Path, options: ReaderOptions, select: str | None) -> ForeignTable:
    import pandas as pd

    lines = path.read_text(encoding="utf-8-sig").splitlines()
    height, mark, above, names = _layout(lines[:4], path)
    decimal = "," if mark != "," and "," in "".join(lines[height:]) else "."
    values, rows = numbers(path, height, mark, len(names), decimal=decimal)
    # Assign each column to its track. The name of a track is in the cell above the first of its columns.
    filled = pd.Series(above).reindex(range(len(names)))
    owners = filled.where(filled != "").ffill().fillna("").tolist()
    tracks = list(filter(None, dict.fromkeys(owners[1:])))
    track = None
    if select:
        track = choose(select, tracks, "track", path)
        tracks = [track]
    columns = {TIME: values[:, 0]}
    matches = enumerate(map(_TRACKER_NAME.fullmatch, names))
    hits = {k: hit for k, hit in matches if hit and hit["axis"] and track in (None, owners[k])}
    for k, hit in hits.items():
        factor, unit = length(options.length_unit or hit["unit"] or "m", path)
        target = f"{hit['kind']}{hit['axis']}_{unit}{_PER[hit['kind']]}"
        if len(tracks) > 1:
            target = f"{safe(owners[k])}_{target}"
        columns[target] = values[:, k] * factor
    notes = []
    if options.length_unit is None and not any(hit["unit"] for hit in hits.values()):
        default = "metres are Tracker's default (else add --length-unit cm)"
        notes.append(f"the file states no unit of length; {default}")
    return ForeignTable(columns, notes=notes, lines=rows)


TRACKER = Format("tracker", "export of Tracker", _read_tracker, _recognises)
