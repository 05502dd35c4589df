"""Readers of tracked points in images: tables of DeepLabCut and Anipose, and files of SLEAP.

A table of DeepLabCut (CSV, HDF5) has one row per frame, and x, y and likelihood of each body part. The levels
of its column header are scorer, (individuals,) bodyparts and coords. SLEAP writes HDF5 (array ``tracks`` with
axes tracks, x and y, nodes, frames), CSV (``node.x``, ``node.y``), and projects (``.slp``). In the files,
coordinates are pixels from the upper left corner, with y down. The reader converts them to y up. Files of
DeepLabCut and SLEAP state no frame rate.

Anipose writes x, y and z of points that several cameras see (CSV). Unit and axes of these coordinates are
those of the calibration of the cameras. The file states neither unit nor axes.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from swimid.errors import InputError, extra_needed
from swimid.imports.formats import open_table
from swimid.imports.table import (
    Array,
    ForeignTable,
    Format,
    Peek,
    ReaderOptions,
    choose,
    is_text,
    length,
    rows,
)
from swimid.logs.units import safe

_LEVELS = ("scorer", "individuals", "bodyparts", "coords")
_CELL = re.compile(r"(?!instance\.).+\.(x|y|score)")


def points(found: Mapping[str, Array], unit: str = "px", y_axis: str = "down") -> dict[str, Array]:
    """Convert columns of tracked points to those of a log: coordinates with y up, and likelihoods.

    A point is named ``<point>.x``, or ``x`` if the file has only one. ``unit`` is the unit of the
    coordinates, px or m, and ``y_axis`` the direction of y in the file, ``down`` or ``up``.

    >>> points({"tail tip.y": np.array([2.0]), "tail tip.score": np.array([0.9])})
    {'tail_tip_y_px': array([-2.]), 'tail_tip_score': array([0.9])}
    """
    columns: dict[str, Array] = {}
    for name, values in found.items():
        point, dot, what = name.rpartition(".")
        if what == "y" and y_axis == "down":
            values = -values
        if what not in ("likelihood", "score"):
            what += f"_{unit}"
        columns[f"{safe(point)}_{what}" if dot else what] = values
    return columns


def _levels(peek: Peek) -> list[str]:
    """Return the names of the header levels in a table of DeepLabCut, from the first lines of the file."""
    starts = [line.split(",")[0].strip() for line in peek.lines[:4]]
    return [start for start in starts if start in _LEVELS]


def _is_deeplabcut(peek: Peek) -> bool:
    levels = _levels(peek)
    return (levels[:1] == ["scorer"] and "bodyparts" in levels) or peek.holds("df_with_missing")


def _read_deeplabcut(path: Path, options: ReaderOptions, select: str | None) -> ForeignTable:
    import pandas as pd

    peek, lines = Peek.of(path), None
    if peek.lines:
        levels = len(_levels(peek))
        if "bodyparts" not in _levels(peek):
            hint = "a table of DeepLabCut begins with the lines scorer, bodyparts, coords"
            raise InputError("has no line of body parts", file=path, hint=hint)
        frame = pd.read_csv(path, header=list(range(levels)), index_col=0)
        lines = np.arange(len(frame), dtype=np.int64) + levels + 1
    else:
        frame = pd.DataFrame(pd.read_hdf(path))
    if "individuals" in frame.columns.names:
        animals = [str(name) for name in frame.columns.unique("individuals")]
        frame = frame.xs(choose(select, animals, "individual", path), axis=1, level="individuals")
    if isinstance(frame.index, pd.MultiIndex) or not pd.api.types.is_numeric_dtype(frame.index):
        text = "the rows are labelled pictures, not the frames of a film"
        raise InputError(text, file=path, hint="import the table that analyze_videos writes")
    # Leave out other columns of a point, such as the variances that Lightning Pose adds.
    known = [key for key in frame.columns if key[-1] in ("x", "y", "likelihood")]
    found = {f"{key[-2]}.{key[-1]}": frame[key].to_numpy(dtype=float) for key in known}
    columns = {"frame": frame.index.to_numpy(dtype=float), **points(found)}
    return ForeignTable(columns, metadata={"y_axis": "up, from the upper edge of the frame"}, lines=lines)


def _is_anipose(peek: Peek) -> bool:
    return {"fnum", "M_00", "center_0"} <= set(peek.header)


def _read_anipose(path: Path, options: ReaderOptions, select: str | None) -> ForeignTable:
    table = open_table(path)
    names = [name.removesuffix("_ncams") for name in table.columns if name.endswith("_ncams")]
    if not names or "fnum" not in table.columns:
        hint = "a table of Anipose has the columns fnum, nose_x, nose_y, nose_z, nose_score and nose_ncams"
        raise InputError("is no table of Anipose", file=path, hint=hint)
    factor, unit = length(options.length_unit, path)
    found: dict[str, Array] = {}
    for name in names:
        found |= {f"{name}.{axis}": table.columns[f"{name}_{axis}"].astype(float) * factor for axis in "xyz"}
        if f"{name}_score" in table.columns:
            found[f"{name}.score"] = table.columns[f"{name}_score"].astype(float)
    columns = {"frame": table.columns["fnum"].astype(float), **points(found, unit, "up")}
    notes = [*table.notes, "the axes are those of the calibration; z is taken as up"]
    return ForeignTable(columns, notes=notes, lines=table.lines)


def _is_sleap(peek: Peek) -> bool:
    cells = {hit[1] for name in peek.header if (hit := _CELL.fullmatch(name))}
    is_table = "frame_idx" in peek.header and {"x", "y"} <= cells
    return is_table or peek.holds("tracks", "node_names") or peek.holds(*_PROJECT)


def _read_sleap(path: Path, options: ReaderOptions, select: str | None) -> ForeignTable:
    peek = Peek.of(path)
    if peek.lines:
        return _of_text(path, select)
    return _of_arrays(path, select, *(_project(path) if peek.holds(*_PROJECT) else _analysis(path)))


#: Data sets of a project of SLEAP (``.slp``) that hold its points.
_PROJECT = ("metadata", "frames", "instances", "points", "pred_points")


def _of_text(path: Path, select: str | None) -> ForeignTable:
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


def _project(path: Path) -> tuple[Array, Array, list[str], list[str]]:
    """Return the points in a project of SLEAP; the returned values are those of :func:`_analysis`."""
    with extra_needed("reading a project of SLEAP", "sleap", file=path):
        from sleap_io import load_slp
    labels = load_slp(str(path), open_videos=False)
    if len(labels.videos) > 1:
        hint = "save one project for each video"
        raise InputError(f"holds the points of {len(labels.videos)} videos", file=path, hint=hint)
    if not labels.tracks and max((len(frame) for frame in labels), default=0) > 1:
        hint = "give each individual a track in SLEAP, and save the project"
        raise InputError("has several individuals without a track", file=path, hint=hint)
    x, y, scores = labels.numpy(return_confidence=True).T.swapaxes(1, 2)
    names = [track.name for track in labels.tracks]
    return np.stack([x, y], axis=1), scores, labels.skeleton.node_names, names


def _analysis(path: Path) -> tuple[Array, Array, list[str], list[str]]:
    """Return coordinates, scores, names of the nodes and of the tracks in an analysis file of SLEAP.

    The coordinates have the shape (tracks, 2, nodes, frames), the scores (tracks, nodes, frames).
    """
    import h5py

    with h5py.File(path, "r") as file:
        tracks = np.asarray(file["tracks"], dtype=float)
        scores = np.asarray(file.get("point_scores", []), dtype=float)
        nodes, names = ([one.decode() for one in file.get(key, [])] for key in ("node_names", "track_names"))
    return tracks, scores, nodes, names


def _of_arrays(
    path: Path, select: str | None, tracks: Array, scores: Array, nodes: list[str], names: list[str]
) -> ForeignTable:
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
    return ForeignTable({"frame": np.arange(tracks.shape[3], dtype=float), **points(found)})


DEEPLABCUT = Format("deeplabcut", "table of DeepLabCut", _read_deeplabcut, _is_deeplabcut, extra="deeplabcut")
ANIPOSE = Format("anipose", "table of Anipose", _read_anipose, _is_anipose)
SLEAP = Format("sleap", "file of SLEAP", _read_sleap, _is_sleap, (".slp",), extra="hdf5")
