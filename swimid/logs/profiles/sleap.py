"""SLEAP analysis files: HDF5 (``tracks``: tracks, x and y, nodes, frames) and CSV (``node.x``, ``node.y``).

Coordinates are pixels with the origin in the upper left corner and y down; here y points up. The file states
no frame rate.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np

from swimid.errors import InputError
from swimid.logs.choices import Choices
from swimid.logs.foreign import open_table
from swimid.logs.foreign.base import Table, is_text, one_of
from swimid.logs.profiles.base import Peek, Profile, safe

_CELL = re.compile(r"(?P<node>.+)\.(?P<what>x|y|score)")


def _recognises(peek: Peek) -> bool:
    points = [hit["what"] for name in peek.header if (hit := _CELL.fullmatch(name))]
    return ("frame_idx" in peek.header and {"x", "y"} <= set(points)) or peek.holds("tracks", "node_names")


def _read(path: Path, choices: Choices) -> Table:
    return _of_text(path, choices) if Peek.of(path).lines else _of_hdf5(path, choices)


def _points(found: dict[tuple[str, str], Any], columns: dict[str, Any]) -> dict[str, Any]:
    for (node, what), values in found.items():
        if what == "score":
            columns[f"{safe(node)}_score"] = values
        else:
            columns[f"{safe(node)}_{what}_px"] = -values if what == "y" else values
    return columns


def _of_text(path: Path, choices: Choices) -> Table:
    table = open_table(path)
    if "frame_idx" not in table.columns:
        raise InputError("this column is missing", file=path, column="frame_idx")
    kept: Any = np.ones(len(table.columns["frame_idx"]), dtype=bool)
    if "track" in table.columns:
        track = table.columns["track"]
        names = [str(name) for name in dict.fromkeys(track) if name is not None and name == name]
        if len(names) > 1 or choices.select:
            kept = track.astype(str) == one_of(
                choices.select, names, file=path, what="track", key="--select with"
            )
    found = {
        (hit["node"], hit["what"]): np.asarray(values[kept], dtype=float)
        for name, values in table.columns.items()
        if (hit := _CELL.fullmatch(name)) and not is_text(values) and hit["node"] != "instance"
    }
    columns = _points(found, {"frame": table.columns["frame_idx"][kept]})
    lines = None if table.lines is None else table.lines[kept]
    return Table(columns, notes=table.notes, lines=lines)


def _of_hdf5(path: Path, choices: Choices) -> Table:
    import h5py

    with h5py.File(path, "r") as file:
        tracks = np.asarray(file["tracks"], dtype=float)
        nodes = [_word(name) for name in file["node_names"]]
        names = [_word(name) for name in file.get("track_names", [])] or [str(k) for k in range(len(tracks))]
        scores = np.asarray(file["point_scores"], dtype=float) if "point_scores" in file else None
    if tracks.ndim != 4 or tracks.shape[1] != 2 or tracks.shape[2] != len(nodes):
        text = f"'tracks' has the shape {tracks.shape}; it must be (tracks, 2, {len(nodes)} nodes, frames)"
        raise InputError(text, file=path)
    names = names if len(names) == len(tracks) else [str(k) for k in range(len(tracks))]
    at = names.index(one_of(choices.select, names, file=path, what="track", key="--select with"))
    found: dict[tuple[str, str], Any] = {}
    for k, node in enumerate(nodes):
        found[node, "x"], found[node, "y"] = tracks[at, 0, k], tracks[at, 1, k]
        if scores is not None and scores.shape == (len(tracks), len(nodes), tracks.shape[3]):
            found[node, "score"] = scores[at, k]
    return Table(_points(found, {"frame": np.arange(tracks.shape[3], dtype=float)}))


def _word(name: Any) -> str:
    return name.decode() if isinstance(name, bytes) else str(name)


PROFILE = Profile("sleap", "analysis file of SLEAP", _recognises, _read)
