"""Export of a log to a dataset of the Python package ``movement``: netCDF, written by xarray.

The dataset has the points of one individual. The track ``x_m``, ``y_m`` is the point ``reference``, and a
column such as ``nose_x_m`` belongs to the point ``nose``. The names of the dimensions are those of version
0.17. In two dimensions ``movement`` has y down, and so
has the dataset. In the vertical plane this is the direction of -z. All other columns are variables over time.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np

from swimid.errors import InputError, UsageError, extra_needed
from swimid.files import atomic
from swimid.files.provenance import path_of
from swimid.logs import log
from swimid.logs.log import Log, LogLike
from swimid.logs.sampling import find_uneven, usual_step
from swimid.results.result import Result

#: Name of the point that a log tracks, and pattern of the columns with a coordinate of a point.
REFERENCE = "reference"
COORDINATE_COLUMN = re.compile(r"((?P<point>.+)_)?(?P<axis>[xyz])_(?P<unit>m|px)")


class Dataset(Result):
    """Result of ``export`` to ``movement``, whose ``document`` is an ``xarray.Dataset``."""

    kind = "Dataset"
    ending = ".nc"

    def _write(self, path: Path) -> list[Path]:
        with atomic.replace_file(path) as temporary:
            self.document.to_netcdf(temporary, engine="h5netcdf")
        return [path]


def export(source: LogLike, output: str | Path | None) -> Dataset:
    """Write a log as a dataset of ``movement``.

    Parameters
    ----------
    source : path, DataFrame or Log
        Log with coordinates of at least one point, in m or px.
    output : path
        Path of the netCDF file to write.

    Raises
    ------
    InputError
        The log cannot be read, or has no coordinates.
    UsageError
        No output is given, or xarray is not installed.
    """
    if output is None or str(output) == "-":
        raise UsageError("a dataset of movement needs a file", hint="name it: -o run.nc")
    given = log.unread(source)
    output = atomic.check_writable(output, inputs=[given])
    record = given if isinstance(given, Log) else log.read(given)
    with extra_needed("a dataset of movement", "netcdf"):
        import h5netcdf  # noqa: F401 - xarray writes with it
        import xarray

    data = xarray.Dataset(*_content(record, path_of(given)))
    points, frames = (data.sizes[name] for name in ("keypoint", "time"))
    text = f"{record.path.name} as a dataset of movement: points {points}, frames {frames}"
    found = {"target": "movement", "points": data["keypoint"].values.tolist(), "frames": frames}
    return Dataset("export", text, found, document=data).write_output(output)


def _content(record: Log, path: Path) -> tuple[dict[str, Any], dict[str, Any], dict[str, Any]]:
    """Return the variables, the coordinates and the attributes of the dataset of a log."""
    hits = {name: hit for name in record.signals if (hit := COORDINATE_COLUMN.fullmatch(name))}
    unit = "m" if any(hit["unit"] == "m" for hit in hits.values()) else "px"
    places: dict[str, dict[str, str]] = {}
    for name, hit in hits.items():
        if hit["unit"] == unit:
            places.setdefault(hit["point"] or REFERENCE, {})[hit["axis"]] = name
    places = {point: axes for point, axes in places.items() if "x" in axes and len(axes) > 1}
    if not places:
        hint = "a point needs two columns, such as x_m and y_m, or nose_x_px and nose_y_px"
        raise InputError("has no coordinates of a point", file=path, hint=hint)
    is_spatial = any(len(axes) == 3 for axes in places.values())
    space = "xyz" if is_spatial else "xy"
    position = np.full((len(record), len(space), len(places), 1), np.nan)
    confidence = np.full((len(record), len(places), 1), np.nan)
    taken = []
    for k, (point, axes) in enumerate(places.items()):
        for axis, name in axes.items():
            sign, at = 1.0, "xyz".index(axis)
            if not is_spatial and axis != "x":
                sign, at = -1.0, 1
            position[:, at, k, 0] = sign * record[name]
            taken.append(name)
        known = [f"{point}_{word}" for word in ("likelihood", "score", "confidence")]
        for name in [name for name in known if name in record.signals][:1]:
            confidence[:, k, 0] = record[name]
            taken.append(name)
    variables = {
        "position": (("time", "space", "keypoint", "individual"), position, {"space_unit": unit}),
        "confidence": (("time", "keypoint", "individual"), confidence),
        **{name: ("time", values) for name, values in record.signals.items() if name not in taken},
    }
    individual = str(record.metadata.get("robot", "id_0"))
    coordinates = {
        "time": record.time_s, "space": list(space), "keypoint": list(places), "individual": [individual]
    }  # fmt: skip
    attributes: dict[str, Any] = {
        "ds_type": "poses",
        "time_unit": "seconds",
        "source_software": "swimid",
        "made_by": "swimid export",
        "source_file": path.name,
    }
    if not find_uneven(record.time_s)[0]:
        attributes["fps"] = 1.0 / usual_step(record.time_s)
    return variables, coordinates, attributes
