"""DeepLabCut: CSV and HDF5 with one row a frame, and x, y (pixels) and likelihood of each body part.

The columns have the levels scorer, (individuals,) bodyparts, coords. The origin is the upper left corner of
the frame and y points down; here y points up. The file states no frame rate.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from swimid.errors import InputError
from swimid.logs.choices import Choices
from swimid.logs.foreign.base import Table, one_of
from swimid.logs.profiles.base import Peek, Profile, safe

LEVELS = ("scorer", "individuals", "bodyparts", "coords")


def _recognises(peek: Peek) -> bool:
    starts = [line.split(",")[0].strip() for line in peek.lines[:4]]
    return (starts[:1] == ["scorer"] and "bodyparts" in starts) or peek.holds("df_with_missing")


def _read(path: Path, choices: Choices) -> Table:
    import pandas as pd

    if Peek.of(path).lines:
        with path.open(encoding="utf-8-sig") as stream:
            starts = [stream.readline().split(",")[0].strip() for _ in range(4)]
        levels = sum(start in LEVELS for start in starts)
        if "bodyparts" not in starts:
            hint = "a table of DeepLabCut begins with the lines scorer, bodyparts, coords"
            raise InputError("has no line of body parts", file=path, hint=hint)
        frame = pd.read_csv(path, header=list(range(levels)), index_col=0)
        first = levels + 1
        lines: Any = np.arange(first, first + len(frame), dtype=np.int64)
    else:
        frame, lines = pd.DataFrame(pd.read_hdf(path)), None
    frame.columns = frame.columns.set_names([str(name) for name in frame.columns.names])
    names = frame.columns.names
    if "individuals" in names:
        animals = [str(name) for name in dict.fromkeys(frame.columns.get_level_values("individuals"))]
        animal = one_of(choices.select, animals, file=path, what="individual", key="--select with")
        frame = frame.xs(animal, axis=1, level="individuals")
    columns: dict[str, Any] = {"frame": _frames(frame.index, path)}
    for key, values in frame.items():
        point, coordinate = (safe(str(part)) for part in key[-2:])
        cells = values.to_numpy(dtype=float)
        if coordinate == "likelihood":
            columns[f"{point}_likelihood"] = cells
        else:
            columns[f"{point}_{coordinate}_px"] = -cells if coordinate == "y" else cells
    return Table(columns, metadata={"y_axis": "up, from the upper edge of the frame"}, lines=lines)


def _frames(index: Any, path: Path) -> Any:
    """Return frame numbers; labelled frames have file names, from which the number is taken."""
    import pandas as pd

    if isinstance(index, pd.MultiIndex) or not pd.api.types.is_numeric_dtype(index):
        text = "its rows are labelled pictures, not the frames of a film"
        raise InputError(text, file=path, hint="import the table that analyze_videos writes")
    return index.to_numpy(dtype=float)


PROFILE = Profile("deeplabcut", "table of DeepLabCut", _recognises, _read, extra="deeplabcut")
