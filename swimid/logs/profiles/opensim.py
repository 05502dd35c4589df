"""OpenSim: marker trajectories (TRC) and motions or storages (MOT, STO).

Both state their conventions in the header: ``Units`` and ``DataRate`` of a TRC file, ``inDegrees`` of a
motion. Coordinates of a motion are angles, except translations, which end in ``_tx``, ``_ty`` or ``_tz``.
Forces are in N, torques in N m, points of application in m.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np

from swimid.errors import InputError
from swimid.logs.choices import Choices
from swimid.logs.foreign.base import Table
from swimid.logs.log import TIME
from swimid.logs.profiles.base import Peek, Profile, safe
from swimid.notices import warn

#: Columns of measured forces, by pattern, with their unit.
_FORCES = {r".*force.*_p[xyz]": "m", r".*(torque|moment).*": "Nm", r".*force.*": "N"}
_TRANSLATION = re.compile(r".*_t[xyz]")


def _recognises(peek: Peek) -> bool:
    starts = [line.strip().lower() for line in peek.lines[:60]]
    return bool(starts) and (starts[0].startswith("pathfiletype") or "endheader" in starts)


def _read(path: Path, choices: Choices) -> Table:
    lines = path.read_text(encoding="utf-8-sig", errors="replace").splitlines()
    if lines and lines[0].strip().lower().startswith("pathfiletype"):
        return _markers(lines, choices, path)
    return _motion(lines, path)


def _rows(path: Path, start: int, width: int) -> tuple[Any, Any]:
    """Return the numbers below ``start`` lines, shape (n, width), and their lines; empty cells are NaN."""
    import pandas as pd

    # a TRC file is separated by tabs and has empty cells; a storage may be aligned by blanks
    tabs = "\t" in path.read_text(encoding="utf-8-sig", errors="replace").splitlines()[start]
    table = pd.read_csv(
        path,
        sep="\t" if tabs else r"\s+",
        header=None,
        skiprows=start,
        names=range(width),
        skip_blank_lines=False,
    )
    table = table.apply(pd.to_numeric).dropna(how="all")
    if table.empty:
        raise InputError("holds no samples under its header", file=path)
    return table.to_numpy(dtype=float), table.index.to_numpy() + start + 1


def _markers(lines: list[str], choices: Choices, path: Path) -> Table:
    if len(lines) < 6:
        raise InputError("ends within its header", file=path, line=len(lines))
    head = dict(zip(lines[1].split(), lines[2].split(), strict=False))
    factor, si = choices.length(head.get("Units"), path)
    names = [name.strip() for name in lines[3].split("\t")[2:] if name.strip()]
    values, at = _rows(path, 5, 2 + 3 * len(names))
    columns: dict[str, Any] = {TIME: values[:, 1]}
    for k, name in enumerate(names):
        for axis, letter in enumerate("xyz"):
            columns[f"{safe(name)}_{letter}_{si}"] = values[:, 2 + 3 * k + axis] * factor
    rate = float(head.get("DataRate", "nan"))
    notes = []
    step = float(np.median(np.diff(values[:, 1]))) if len(values) > 1 else np.nan
    if abs(step * rate - 1.0) > 0.01:
        notes.append(f"its header states {rate:g} Hz, its times are {1 / step:g} Hz apart")
    return Table(columns, notes=notes, lines=at)


def _motion(lines: list[str], path: Path) -> Table:
    end = next((k for k, line in enumerate(lines) if line.strip().lower() == "endheader"), None)
    if end is None or len(lines) <= end + 2:
        raise InputError("has no line 'endheader' with samples below it", file=path)
    head = dict(line.strip().split("=", 1) for line in lines[:end] if "=" in line)
    names = lines[end + 1].split()
    if names[:1] != ["time"]:
        raise InputError("the first column must be 'time'", file=path, line=end + 2)
    degrees = {key.strip().lower(): value.strip().lower() for key, value in head.items()}.get("indegrees")
    if degrees not in ("yes", "no"):
        hint = "add the line inDegrees=yes or inDegrees=no above 'endheader'"
        raise InputError("states no 'inDegrees'", file=path, line=end + 1, hint=hint)
    values, at = _rows(path, end + 2, len(names))
    columns: dict[str, Any] = {TIME: values[:, 0]}
    coordinates = path.suffix.lower() == ".mot" or "coordinates" in lines[0].lower()
    left_out = []
    for k, name in enumerate(names[1:], start=1):
        stem, _, kind = name.rpartition("/")
        rate = "_s" if kind == "speed" and stem else ""
        word = safe(stem.rpartition("/")[2] if kind in ("value", "speed") else name)
        force = next((unit for pattern, unit in _FORCES.items() if re.fullmatch(pattern, word)), None)
        if force is not None:
            columns[f"{word}_{force}"] = values[:, k]
        elif _TRANSLATION.fullmatch(word):
            columns[f"{word}_m{rate}"] = values[:, k]
        elif coordinates or kind in ("value", "speed"):
            columns[f"{word}_rad{rate}"] = np.radians(values[:, k]) if degrees == "yes" else values[:, k]
        else:
            left_out.append(name)
    if left_out:
        warn(
            "SWM004", f"{path.name}: columns that are no coordinates are left out: {', '.join(left_out[:20])}"
        )
    return Table(columns, lines=at)


PROFILE = Profile("opensim", "TRC, MOT or STO file of OpenSim", _recognises, _read)
