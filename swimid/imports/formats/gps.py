"""Readers of satellite positions: GPX, and NMEA 0183 sentences (RMC, GGA).

Latitude and longitude become metres to the east (x) and to the north (y) of the first position, in the plane
that touches the ellipsoid of WGS 84 there. The metadata state the first position. Altitudes keep their own
column and are not used as z, because their errors are larger than the motion of a robot.
"""

from __future__ import annotations

import re
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np

from swimid.errors import InputError
from swimid.imports.table import (
    Array,
    ForeignTable,
    Format,
    Peek,
    ReaderOptions,
    choose,
    from_first,
    of_records,
)
from swimid.logs.log import TIME

#: Semi-major axis, m, and flattening of the ellipsoid of WGS 84 (NIMA TR8350.2).
AXIS_M, FLATTENING = 6378137.0, 1 / 298.257223563
_SENTENCE = re.compile(rb"\$[A-Z]{2}(RMC|GGA),")


def east_north(latitude_deg: Array, longitude_deg: Array) -> tuple[dict[str, Array], dict[str, float]]:
    """Return positions to the east and to the north of the first one, m, and the metadata of the first one.

    A position at latitude 0 and longitude 0 counts as missing, because receivers write 0, 0 before they know
    their position.

    >>> east_north(np.array([60.0, 60.001]), np.array([10.0, 10.0]))[0]["y_m"].round(1).tolist()
    [0.0, 111.4]
    """
    fix = np.isfinite(latitude_deg * longitude_deg) & ((latitude_deg != 0) | (longitude_deg != 0))
    first = int(np.argmax(fix))
    lat = np.radians(np.where(fix, latitude_deg, np.nan))
    lon = np.radians(longitude_deg - longitude_deg[first])
    square = FLATTENING * (2 - FLATTENING)
    normal = AXIS_M / np.sqrt(1 - square * np.sin(lat) ** 2)
    # Compute Cartesian coordinates, with the first position in the plane of x and z (Torge 2001, Geodesy,
    # sec. 4.1.3).
    x, y = normal * np.cos(lat) * np.cos(lon), normal * np.cos(lat) * np.sin(lon)
    z, at = (1 - square) * normal * np.sin(lat), lat[first]
    north = (z - z[first]) * np.cos(at) - (x - x[first]) * np.sin(at)
    origin = {"origin_latitude_deg": latitude_deg[first], "origin_longitude_deg": longitude_deg[first]}
    return {"x_m": y, "y_m": north}, {name: float(value) for name, value in origin.items()}


def _table(fixes: list[dict[str, Any]], path: Path, notes: list[str]) -> ForeignTable:
    """Return the table of positions with ``latitude``, ``longitude``, ``altitude_m`` and ``time`` (UTC)."""
    found = of_records(fixes)
    if not fixes or found["time"].dtype.kind != "M":
        raise InputError("has no valid positions with times", file=path, hint="record a track with its times")
    time_s, start = from_first(found["time"])
    place, origin = east_north(found["latitude"], found["longitude"])
    columns = {TIME: time_s, **place}
    if np.isfinite(found["altitude_m"].astype(float)).any():
        columns["altitude_m"] = found["altitude_m"].astype(float)
    return ForeignTable(columns, metadata=origin | start, notes=notes)


def _read_gpx(path: Path, options: ReaderOptions, select: str | None) -> ForeignTable:
    import gpxpy

    tracks = gpxpy.parse(path.read_text(encoding="utf-8-sig")).tracks
    titles = [one.name or "" for one in tracks]
    names = [t if t and titles.count(t) == 1 else str(k) for k, t in enumerate(titles, start=1)]
    points = {name: list(one.walk(only_points=True)) for name, one in zip(names, tracks, strict=True)}
    track = points[choose(select, [name for name, found in points.items() if found], "track", path)]
    fields = {"latitude": "latitude", "longitude": "longitude", "altitude_m": "elevation", "time": "time"}
    return _table([{name: getattr(p, of) for name, of in fields.items()} for p in track], path, [])


def _read_nmea(path: Path, options: ReaderOptions, select: str | None) -> ForeignTable:
    from pynmeagps import ERR_IGNORE, NMEAReader

    kinds = [hit.decode() for hit in _SENTENCE.findall(path.read_bytes())]
    kind = max(("RMC", "GGA"), key=kinds.count)
    with path.open("rb") as stream:
        read = [one for _, one in NMEAReader(stream, quitonerror=ERR_IGNORE) if one and one.msgID == kind]
    # GGA states only the time of day. Use an arbitrary first day for its dates.
    fixes, stamp = [], datetime(1970, 1, 1)
    for one in read:
        day = getattr(one, "date", stamp.date())
        of_day = datetime.combine(day or stamp.date(), one.time)
        stamp = of_day + timedelta(days=stamp - of_day > timedelta(hours=12))
        if getattr(one, "status", "A") == "A" and getattr(one, "quality", 1):
            fix = {"latitude": one.lat, "longitude": one.lon, "time": np.datetime64(stamp, "ns")}
            fixes.append(fix | {"altitude_m": float(getattr(one, "alt", "") or "nan")})
    notes = []
    if bad := kinds.count(kind) - len(read):
        notes.append(f"{bad} of {kinds.count(kind)} sentences {kind} with a wrong checksum left out")
    return _table(fixes, path, notes)


def _is_nmea(peek: Peek) -> bool:
    return _SENTENCE.search(peek.head) is not None


GPX = Format("gpx", "GPX file", _read_gpx, lambda peek: b"<gpx" in peek.head, (".gpx",), extra="gps")
NMEA = Format("nmea", "log of NMEA sentences", _read_nmea, _is_nmea, (".nmea",), extra="gps")
