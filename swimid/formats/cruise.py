"""The table of a cruise experiment: one row per run."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from swimid.errors import InputError, nearest
from swimid.notices import warn

Array = NDArray[np.float64]
REQUIRED = ("fin", "frequency_hz", "amplitude_deg", "distance_m")
NUMBERS = ("frequency_hz", "amplitude_deg", "distance_m", "time_s", "mean_speed_m_s")


@dataclass(frozen=True)
class CruiseTable:
    """Runs of a robot from rest over a distance.

    Attributes
    ----------
    path : Path
    fin : list of str, length n
    frequency_hz, amplitude_deg, distance_m, mean_speed_m_s : ndarray, shape (n,)
        Speed NaN where the run has none.
    """

    path: Path
    fin: list[str]
    frequency_hz: Array
    amplitude_deg: Array
    distance_m: Array
    mean_speed_m_s: Array


def read(path: str | Path) -> CruiseTable:
    """Read the table.

    Raises
    ------
    InputError
        Naming line and column: missing columns, cells that are no positive number, no rows.
    """
    path = Path(path)
    try:
        frame = pd.read_csv(
            path, comment="#", dtype=str, keep_default_na=False, skipinitialspace=True, skip_blank_lines=False
        )
        with path.open(encoding="utf-8") as stream:
            header = next((i for i, text in enumerate(stream, 1) if text.strip() and text[0] != "#"), 1)
    except OSError as error:
        hint = "check the path" if isinstance(error, FileNotFoundError) else None
        raise InputError(f"cannot be read: {error.strerror or error}", file=path, hint=hint) from error
    except pd.errors.EmptyDataError as error:
        raise InputError("is empty", file=path) from error
    except (pd.errors.ParserError, UnicodeDecodeError, ValueError) as error:
        raise InputError(f"is no table: {str(error).splitlines()[0]}", file=path) from error
    names = [str(c).strip() for c in frame.columns]
    frame.columns = pd.Index(names)
    speed = "mean_speed_m_s" if "mean_speed_m_s" in names else "time_s"
    for column in (*REQUIRED, speed):
        if column not in names:
            close = nearest(column, names)
            hint = f"did you mean '{close}'? " if close else ""
            what = (
                "this column is missing"
                if column != "time_s"
                else "neither time_s nor mean_speed_m_s is there"
            )
            raise InputError(
                what, file=path, line=header, column=column, hint=f"{hint}the file has: {', '.join(names)}"
            )
    frame = frame[(frame != "").any(axis=1)]
    if frame.empty:
        raise InputError("has a header and no runs", file=path, line=header)
    columns = {
        name: _numbers(frame, name, path, header, required=name in REQUIRED)
        for name in NUMBERS
        if name in names
    }
    with np.errstate(divide="ignore"):
        speeds = columns["distance_m"] / columns["time_s"] if speed == "time_s" else columns[speed]
    missing = int(np.isnan(speeds).sum())
    if missing:
        warn("SWM001", f"{path.name}: {missing} of {len(speeds)} runs have no {speed}; they are left out")
    if np.nanmedian(speeds) > 20:
        warn(
            "SWM002",
            f"{path.name}, '{speed}': speeds of {np.nanmedian(speeds):.3g} m/s; is it mm/s (a factor "
            "of 1000)?",
        )
    if np.nanmax(columns["amplitude_deg"]) < 1.6:
        warn("SWM002", f"{path.name}, 'amplitude_deg': looks like radians (a factor of 57.3)")
    return CruiseTable(
        path,
        [str(f).strip() for f in frame["fin"]],
        columns["frequency_hz"],
        columns["amplitude_deg"],
        columns["distance_m"],
        speeds,
    )


def _numbers(frame: pd.DataFrame, name: str, path: Path, header: int, *, required: bool) -> Array:
    texts = frame[name].str.strip()
    values = pd.to_numeric(texts.replace("", np.nan), errors="coerce").to_numpy(dtype=float)
    empty = (texts == "").to_numpy()
    for row, (value, blank) in enumerate(zip(values, empty, strict=True)):
        if blank and not required:
            continue
        line = header + 1 + int(frame.index[row])
        if blank:
            raise InputError("has no value", file=path, line=line, column=name)
        if not np.isfinite(value):
            raise InputError(f"'{texts.iloc[row]}' is not a number", file=path, line=line, column=name)
        if value <= 0:
            raise InputError(f"{value:g} is not positive", file=path, line=line, column=name)
    return values
