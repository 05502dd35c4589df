"""Readers of tracks of points without parts: tables of trackpy, and trajectories of idtracker.ai.

In both formats, coordinates are pixels from the upper left corner of the picture, with y down. The readers
convert them to y up. A table of trackpy has one row per frame and particle. ``ep`` is the standard deviation
of a coordinate. Trajectories of idtracker.ai are an array with the shape (frames, individuals, 2) in HDF5, or
CSV with the columns ``x1``, ``y1``, ``x2``, ... beside a file ``attributes.json``. The ``.npy`` files of
idtracker.ai are Python pickles, which can run any program when they are loaded. Therefore such files are
refused.
"""

from __future__ import annotations

import contextlib
import json
from pathlib import Path
from typing import Any

import numpy as np

from swimid.errors import InputError, file_errors
from swimid.imports.formats import open_table
from swimid.imports.formats.keypoints import points
from swimid.imports.table import Array, ForeignTable, Format, Peek, ReaderOptions, choose, rows
from swimid.logs.log import TIME

_NUMPY = b"\x93NUMPY"
#: Columns that every table of trackpy has (_TRACK), and columns of which it has at least one (_FEATURES).
_TRACK, _FEATURES = {"frame", "particle", "x", "y"}, {"mass", "raw_mass", "signal", "ecc", "ep"}


def _is_trackpy(peek: Peek) -> bool:
    names = set(peek.header)
    if peek.head.startswith(b"PAR1"):
        # Ignore a missing pyarrow here. The reader of Parquet then names the extra to install.
        import pyarrow.parquet

        names = set(pyarrow.parquet.read_schema(peek.path).names)
    return names >= _TRACK and bool(names & _FEATURES)


def _read_trackpy(path: Path, options: ReaderOptions, select: str | None) -> ForeignTable:
    table = open_table(path).whole()
    if not set(table.columns) >= _TRACK:
        hint = f"a table of trackpy has the columns {', '.join(sorted(_TRACK))}"
        raise InputError("is no table of trackpy", file=path, hint=hint)
    particle = table.columns["particle"].astype(float)
    numbers, counts = np.unique(particle[np.isfinite(particle)], return_counts=True)
    # List the longest tracks first, because a table holds many short tracks.
    names = [f"{numbers[k]:.0f}" for k in np.argsort(-counts, kind="stable")]
    table = rows(table, particle == float(choose(select, names, "particle", path)))
    order = np.argsort(table.columns["frame"], kind="stable")
    known = [name for name in ("x", "y", "z", "ep") if name in table.columns]
    found: dict[str, Array] = {name: table.columns[name].astype(float)[order] for name in known}
    ep = found.pop("ep", None)
    columns = {"frame": table.columns["frame"].astype(float)[order], **points(found)}
    if ep is not None:
        columns |= dict.fromkeys(("x_sd_px", "y_sd_px"), np.where(ep >= 0, ep, np.nan))
    lines = None if table.lines is None else table.lines[order]
    return ForeignTable(columns, notes=table.notes, lines=lines)


TRACKPY = Format("trackpy", "table of trackpy", _read_trackpy, _is_trackpy)


def _attributes(path: Path) -> dict[str, Any]:
    """Return the content of ``attributes.json`` beside a table of idtracker.ai; empty if there is none."""
    place = path.with_name("attributes.json")
    with contextlib.suppress(OSError, ValueError, InputError), file_errors(place):
        found = json.loads(place.read_text(encoding="utf-8"))
        if isinstance(found, dict) and "frames_per_second" in found:
            return found
    return {}


def _is_idtracker(peek: Peek) -> bool:
    if peek.head.startswith(_NUMPY):
        return b"'|O'" in peek.head[:128]
    if {"x1", "y1"} <= set(peek.header):
        return bool(_attributes(peek.path))
    return peek.holds("trajectories", "areas", "setup_points")


def _read_idtracker(path: Path, options: ReaderOptions, select: str | None) -> ForeignTable:
    peek = Peek.of(path)
    lines, time_s, attributes = None, None, {}
    if peek.head.startswith(_NUMPY):
        tracks = _of_numpy(path)
    elif peek.lines:
        table, attributes = open_table(path), _attributes(path)
        lines, (tracks, time_s) = table.lines, _of_table(table.columns, path)
    else:
        import h5py

        with h5py.File(path, "r") as file:
            tracks, attributes = np.asarray(file["trajectories"], dtype=float), dict(file.attrs)
    if tracks.ndim != 3 or tracks.shape[2] != 2:
        raise InputError(f"has the shape {tracks.shape}; it must be (frames, individuals, 2)", file=path)
    labels = [str(label) for label in attributes.get("identities_labels", ())]
    if len(labels) != tracks.shape[1]:
        labels = [str(k) for k in range(1, tracks.shape[1] + 1)]
    x, y = tracks[:, labels.index(choose(select, labels, "individual", path))].T
    frames = np.arange(len(tracks), dtype=float)
    clock = {"frame": frames}
    rate = attributes.get("frames_per_second")
    if rate:
        clock = {TIME: frames / float(rate)}
    elif time_s is not None:
        clock = {TIME: time_s}
    kept = {name: attributes[name] for name in ("body_length", "version") if name in attributes}
    metadata = {f"idtrackerai_{name}": np.asarray(value).item() for name, value in kept.items()}
    return ForeignTable({**clock, **points({"x": x, "y": y})}, metadata=metadata, lines=lines)


def _of_table(columns: dict[str, Any], path: Path) -> tuple[Array, Array | None]:
    """Return the tracks and the times in the columns of a table; None without times."""
    times = [columns[name] for name in ("time", "seconds") if name in columns]
    names = [name for name in columns if name not in ("time", "seconds")]
    if names[:2] != ["x1", "y1"] or len(names) % 2:
        hint = "trajectories of idtracker.ai have the columns x1, y1, x2, y2, ..."
        raise InputError("is no table of trajectories", file=path, hint=hint)
    cells = np.column_stack([columns[name].astype(float) for name in names])
    return cells.reshape(len(cells), -1, 2), next(iter(times), None)


def _of_numpy(path: Path) -> Array:
    """Return the array in a ``.npy`` file.

    Raises
    ------
    InputError
        The file holds Python objects.
    """
    if b"'|O'" in Peek.of(path).head[:128]:
        text = "holds a Python pickle, which can run any program when it is loaded"
        hint = f"export HDF5 where idtracker.ai is installed: idtrackerai_format {path.name} --formats h5"
        raise InputError(text, file=path, hint=hint)
    return np.asarray(np.load(path, allow_pickle=False), dtype=float)


IDTRACKER = Format(
    "idtrackerai", "trajectory file of idtracker.ai", _read_idtracker, _is_idtracker, extra="hdf5"
)
