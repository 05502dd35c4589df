"""Text that Tracker (Open Source Physics) exports: a line with the tracks, a line of names, then t, x, y.

Tracker counts time in seconds. Its length unit is the metre unless the project sets another, which the names
state (``x (cm)``).
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np

from swimid.errors import InputError
from swimid.logs.choices import Choices
from swimid.logs.foreign.base import Table, one_of
from swimid.logs.log import TIME
from swimid.logs.profiles.base import Peek, Profile, safe

_NAME = re.compile(
    r"(?P<name>t|[xyr]|v_?\{?[xy]\}?|a_?\{?[xy]\}?|step|frame)(\s*[(\[](?P<unit>[^)\]]*)[)\]])?"
)
_KINDS = {"v": "_s", "a": "_s2"}


def _layout(lines: list[str]) -> tuple[int, str, list[str], list[str]] | None:
    """Return the index of the line of names, the delimiter, the track of each column, and the names."""
    multi = bool(lines) and lines[0].strip().startswith("#multi:")
    start = 1 if multi else 0
    if len(lines) < start + 3:
        return None
    for mark in ("\t", ",", ";"):
        names = [cell.strip() for cell in lines[start + 1].split(mark)]
        names = names[:-1] if names[-1] == "" else names
        hits = [_NAME.fullmatch(name) for name in names]
        known = [hit["name"] for hit in hits if hit]
        tracks = [cell.strip().lstrip("#") for cell in lines[start].split(mark)]
        if len(known) < 3 or known[0] != "t" or not {"x", "y"} & set(known):
            continue
        if not multi and any(tracks[1:]):
            continue
        owner, now = [], tracks[0]
        for k in range(len(names)):
            now = tracks[k] if k < len(tracks) and tracks[k] else now
            owner.append(now)
        return start + 1, mark, owner, names
    return None


def _recognises(peek: Peek) -> bool:
    return _layout(peek.lines) is not None


def _read(path: Path, choices: Choices) -> Table:
    import pandas as pd

    found = _layout(path.read_text(encoding="utf-8-sig").splitlines()[:4])
    if found is None:
        hint = "Tracker exports a line with the track, a line 't x y', and the samples"
        raise InputError("is no export of Tracker", file=path, hint=hint)
    at, mark, owner, names = found
    table = pd.read_csv(path, sep=mark, header=None, skiprows=at + 1, skip_blank_lines=False)
    table = table.iloc[:, : len(names)].apply(pd.to_numeric, errors="coerce").dropna(how="all")
    tracks = [track for track in dict.fromkeys(owner[1:]) if track]
    several = len(tracks) > 1
    track = (
        one_of(choices.select, tracks, file=path, what="track", key="--select with")
        if choices.select
        else None
    )
    columns: dict[str, Any] = {TIME: table[0].to_numpy(dtype=float)}
    stated: set[str] = set()
    for k, name in enumerate(names):
        hit = _NAME.fullmatch(name)
        if k == 0 or hit is None or hit["name"] in ("step", "frame", "t") or (track and owner[k] != track):
            continue
        word = re.sub(r"[_{}]", "", hit["name"])
        unit = (hit["unit"] or "").split("/")[0]
        stated |= {unit} if unit else set()
        factor, si = choices.length(unit or "m", path)
        target = f"{word}_{si}{_KINDS.get(word[0], '')}" if len(word) > 1 else f"{word}_{si}"
        columns[f"{safe(owner[k])}_{target}" if several and not track else target] = (
            table[k].to_numpy(dtype=float) * factor
        )
    notes = []
    if not stated and choices.length_unit is None:
        notes.append(
            "the file states no unit of length; metres are Tracker's default (another one: --length-unit cm)"
        )
    return Table(columns, notes=notes, lines=np.asarray(table.index + at + 2, dtype=np.int64))


PROFILE = Profile("tracker", "export of Tracker", _recognises, _read)
