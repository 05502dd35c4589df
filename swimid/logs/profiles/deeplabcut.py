"""DeepLabCut: CSV and HDF5 with one row a frame, and x, y (pixels) and likelihood of each body part.

The columns have the levels scorer, (individuals,) bodyparts, coords. The origin is the upper left corner of
the frame and y points down; here y points up. The file states no frame rate.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from swimid.errors import InputError
from swimid.logs.foreign.base import Table
from swimid.logs.profiles.base import Peek, Profile, choose, points

LEVELS = ("scorer", "individuals", "bodyparts", "coords")


def _levels(peek: Peek) -> list[str]:
    """Return the levels of the column names that the file begins with."""
    starts = [line.split(",")[0].strip() for line in peek.lines[:4]]
    return [start for start in starts if start in LEVELS]


def _recognises(peek: Peek) -> bool:
    levels = _levels(peek)
    return (levels[:1] == ["scorer"] and "bodyparts" in levels) or peek.holds("df_with_missing")


def _read(path: Path, select: str | None, length_unit: str | None) -> Table:
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
        text = "its rows are labelled pictures, not the frames of a film"
        raise InputError(text, file=path, hint="import the table that analyze_videos writes")
    found = {f"{key[-2]}.{key[-1]}": cells.to_numpy(dtype=float) for key, cells in frame.items()}
    columns = {"frame": frame.index.to_numpy(dtype=float), **points(found)}
    return Table(columns, metadata={"y_axis": "up, from the upper edge of the frame"}, lines=lines)


PROFILE = Profile("deeplabcut", "table of DeepLabCut", _recognises, _read, extra="deeplabcut")
