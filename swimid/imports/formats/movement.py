"""Reader of datasets of the Python package ``movement``: netCDF with ``position(time, space, ...)``.

A dataset holds the points (dimension ``keypoint``) of one or several animals (``individual``), and the
confidence of each point, or of each animal. Before version 0.17 these names were plural. In two dimensions,
coordinates count from the upper left corner of the picture, with y down, also after
``movement.transforms.scale`` has converted them to a unit of length (attribute ``space_unit``). The reader
converts these coordinates to y up. Coordinates in three dimensions keep their axes. Times are seconds or
frame numbers (attribute ``time_unit``).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from swimid.errors import InputError
from swimid.imports.formats.keypoints import points
from swimid.imports.table import Array, ForeignTable, Format, Peek, ReaderOptions, choose, length
from swimid.logs.log import TIME

#: Names of the dimensions before version 0.17 of ``movement``, with their present names.
_RENAMED = {"keypoints": "keypoint", "individuals": "individual"}


def _recognises(peek: Peek) -> bool:
    if peek.head.startswith(b"CDF"):  # netCDF 3, whose header names dimensions and variables
        return all(word in peek.head for word in (b"position", b"space", b"individual"))
    return peek.holds("position", "time", "space")


def _read(path: Path, options: ReaderOptions, select: str | None) -> ForeignTable:
    import xarray

    # Do not decode the times: numbers with the unit "seconds" would become time differences.
    with xarray.open_dataset(path, decode_times=False) as file:
        data = file.load()
    data = data.rename({old: new for old, new in _RENAMED.items() if old in data.dims})
    if "position" not in data or not {"time", "space"} <= set(data["position"].dims):
        text = "has no variable 'position' with the dimensions 'time' and 'space'"
        raise InputError(text, file=path, hint="movement datasets are saved by ds.to_netcdf(path)")
    if "individual" in data.dims:
        names = list(map(str, data["individual"].values))
        data = data.isel(individual=names.index(choose(select, names, "individual", path)))
    if "keypoint" not in data.dims:
        data = data.expand_dims(keypoint=[""])
    position, space = data["position"], list(map(str, data["space"].values))
    stated = position.attrs.get("space_unit") or data.attrs.get("space_unit")
    if not stated and "z" not in space:
        stated = "px"
    factor, unit = length(options.length_unit or stated, path)
    y_axis = "up" if "z" in space else "down"
    clock = {"seconds": TIME, "frames": "frame"}.get(str(data.attrs.get("time_unit")))
    if clock is None:
        text = f"the attribute time_unit is {data.attrs.get('time_unit')!r}"
        raise InputError(text, file=path, hint="it must be 'seconds' or 'frames'")
    about = ("source_software", "source_file", "fps")
    metadata = {n: data.attrs[n] for n in about if isinstance(data.attrs.get(n), str | float | int)}
    columns = points(_select_points(data, factor), unit, y_axis)
    columns = {clock: data["time"].to_numpy().astype(float), **columns}
    return ForeignTable(columns, metadata=metadata)


def _select_points(data: Any, factor: float) -> dict[str, Array]:
    """Return the coordinates of each point of a dataset times ``factor``, and its likelihood if known."""
    columns: dict[str, Array] = {}
    for k, name in enumerate(data["keypoint"].values):
        prefix = f"{name}.".removeprefix(".")
        point = data.isel(keypoint=k, missing_dims="ignore")
        for at, axis in enumerate(data["space"].values):
            columns[f"{prefix}{axis}"] = point["position"].isel(space=at).to_numpy().astype(float) * factor
        if "confidence" in data:
            confidence = point["confidence"].to_numpy().astype(float)
            # A confidence that is missing in all samples is unknown, and must not count as low.
            if np.isfinite(confidence).any():
                columns[f"{prefix}likelihood"] = confidence
    return columns


PROFILE = Format("movement", "dataset of movement", _read, _recognises, extra="netcdf")
