"""SLEAP analysis files: HDF5 (``tracks``: tracks, x and y, nodes, frames) and CSV (``node.x``, ``node.y``).

Coordinates are pixels with the origin in the upper left corner and y down; here y points up. The file states
no frame rate.
"""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from swimid.errors import InputError
from swimid.logs.foreign import open_table
from swimid.logs.foreign.base import Table, is_text
from swimid.logs.profiles.base import Array, Peek, Profile, choose, points, rows

_CELL = re.compile(r"(?!instance\.).+\.(x|y|score)")


def _recognises(peek: Peek) -> bool:
    cells = {hit[1] for name in peek.header if (hit := _CELL.fullmatch(name))}
    return ("frame_idx" in peek.header and {"x", "y"} <= cells) or peek.holds("tracks", "node_names")


def _read(path: Path, select: str | None, length_unit: str | None) -> Table:
    return _of_text(path, select) if Peek.of(path).lines else _of_hdf5(path, select)


def _of_text(path: Path, select: str | None) -> Table:
    import pandas as pd

    table = open_table(path)
    frames = table.column("frame_idx", path)
    if "track" in table.columns:
        tracks = pd.Series(table.columns["track"]).dropna().astype(str)
        names = list(tracks.unique())
        if len(names) > 1 or select:
            chosen = choose(select, names, "track", path)
            table = rows(table, table.columns["track"].astype(str) == chosen)
    cells = [name for name, values in table.columns.items() if _CELL.fullmatch(name) and not is_text(values)]
    found = points({name: table.columns[name].astype(float) for name in cells})
    return replace(table, columns={"frame": table.columns[frames], **found})


def _of_hdf5(path: Path, select: str | None) -> Table:
    import h5py

    with h5py.File(path, "r") as file:
        tracks = np.asarray(file["tracks"], dtype=float)
        nodes = [name.decode() for name in file["node_names"]]
        names = [name.decode() for name in file.get("track_names", [])]
        scores = np.asarray(file.get("point_scores", []), dtype=float)
    if tracks.ndim != 4 or tracks.shape[1] != 2 or tracks.shape[2] != len(nodes):
        text = f"'tracks' has the shape {tracks.shape}; it must be (tracks, 2, {len(nodes)} nodes, frames)"
        raise InputError(text, file=path)
    if len(names) != len(tracks):
        names = [str(k) for k in range(len(tracks))]
    at = names.index(choose(select, names, "track", path))
    found: dict[str, Array] = {}
    for k, node in enumerate(nodes):
        found[f"{node}.x"], found[f"{node}.y"] = tracks[at, :, k]
        if scores.shape == tracks[:, 0].shape:
            found[f"{node}.score"] = scores[at, k]
    return Table({"frame": np.arange(tracks.shape[3], dtype=float), **points(found)})


PROFILE = Profile("sleap", "analysis file of SLEAP", _recognises, _read, extra="hdf5")
