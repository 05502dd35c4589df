"""The table of a cruise experiment: one row per run."""

from __future__ import annotations

import csv
import hashlib
import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from swimid.errors import InputError
from swimid.files import delimited
from swimid.files.provenance import Held
from swimid.notices import warn

if TYPE_CHECKING:
    import pandas as pd

Array = NDArray[np.float64]
REQUIRED = ("fin", "frequency_hz", "amplitude_deg", "distance_m")
NUMBERS = ("frequency_hz", "amplitude_deg", "distance_m")


#: Line, where there is one, and cells by column name.
Row = tuple[int | None, dict[str, str]]


@dataclass(frozen=True)
class CruiseTable:
    """Runs of a robot from rest over a distance; speed NaN where the run has none.

    ``source`` is what stands for it in the provenance.
    """

    path: Path
    source: Path | Held
    fin: list[str]
    frequency_hz: Array
    amplitude_deg: Array
    distance_m: Array
    mean_speed_m_s: Array


def read(source: str | Path | pd.DataFrame) -> CruiseTable:
    """Read the table, or take one in memory with the same columns.

    Raises
    ------
    InputError
        Naming line and column: missing columns, cells that are no positive number, no rows.
    """
    path, header_line = Path("table"), None
    try:
        if isinstance(source, str | Path):
            path = Path(source)
            _, header, header_line = delimited.head(path)
            names = delimited.column_names(header, path, header_line)
        else:
            names = [str(name) for name in source.columns]
        speed = "mean_speed_m_s" if "mean_speed_m_s" in names else "time_s"
        for column in (*REQUIRED, speed):
            if column not in names:
                what = "neither time_s nor mean_speed_m_s is there" if column == "time_s" else None
                raise delimited.missing_column(
                    column, names, path, header_line, what or "this column is missing"
                )
        rows = _cells(source) if header_line is None else _rows(path, header_line, names)
    except OSError as error:
        hint = "check the path" if isinstance(error, FileNotFoundError) else None
        raise InputError(f"cannot be read: {error.strerror or error}", file=path, hint=hint) from error
    if not rows:
        raise InputError("has a header and no runs", file=path, line=header_line)
    columns = {name: _numbers(rows, name, path) for name in (*NUMBERS, speed)}
    distance, given = columns["distance_m"], columns[speed]
    if np.isnan(given).all():
        raise InputError("every run's value is missing", file=path, column=speed)
    with np.errstate(over="ignore", under="ignore"):
        speeds = distance / given if speed == "time_s" else given
    none = np.isinf(speeds) | (speeds == 0)
    if none.any():
        row = int(np.argmax(none))
        raise InputError(
            f"a speed of {speeds[row]:g} m/s is none", file=path, line=rows[row][0], column=speed
        )
    missing = int(np.isnan(speeds).sum())
    if missing:
        warn("SWM001", f"{path.name}: {missing} of {len(speeds)} runs have no {speed}; they are left out")
    typical = np.nanmedian(speeds)
    doubts = {
        speed: (typical > 20, f"speeds of {typical:.3g} m/s; is it mm/s (a factor of 1000)?"),
        "distance_m": (
            np.max(distance) > 50,
            "looks like centimetres or millimetres (a factor of 100 or 1000)",
        ),
        "amplitude_deg": (np.max(columns["amplitude_deg"]) < 1.6, "looks like radians (a factor of 57.3)"),
    }
    for column, (doubtful, text) in doubts.items():
        if doubtful:
            warn("SWM002", f"{path.name}, '{column}': {text}")
    in_memory = None if isinstance(source, str | Path) else source.to_csv(index=False).encode()
    return CruiseTable(
        path,
        path if in_memory is None else Held("table", hashlib.sha256(in_memory).hexdigest()),
        [cells["fin"] for _, cells in rows],
        columns["frequency_hz"],
        columns["amplitude_deg"],
        distance,
        speeds,
    )


def _cells(frame: pd.DataFrame) -> list[Row]:
    """The rows of a table in memory as those of a file, which have no line."""
    blank = frame.isna()
    return [
        (None, {str(n): "" if blank.iloc[k][n] else str(frame.iloc[k][n]) for n in frame.columns})
        for k in range(len(frame))
    ]


def _rows(path: Path, header_line: int, names: list[str]) -> list[Row]:
    """Line and cells by column name of every row that is not blank or a comment."""
    rows: list[Row] = []
    with path.open(encoding="utf-8-sig", newline="") as stream:
        try:
            for _ in range(header_line):
                next(stream)
            reader = csv.reader(stream, skipinitialspace=True, strict=True)
            for cells in reader:
                line = header_line + reader.line_num
                if not any(cell.strip() for cell in cells) or cells[0].startswith("#"):
                    continue
                if len(cells) != len(names):
                    raise InputError(
                        f"has {len(cells)} cells where the header names {len(names)} columns",
                        file=path,
                        line=line,
                    )
                rows.append((line, {n: c.strip() for n, c in zip(names, cells, strict=True)}))
        except UnicodeDecodeError as error:
            raise InputError("is not UTF-8 text", file=path) from error
        except csv.Error as error:
            raise InputError(
                f"is no table: {error}", file=path, line=header_line + reader.line_num
            ) from error
    return rows


def _numbers(rows: list[Row], name: str, path: Path) -> Array:
    """A column of positive numbers; only a measurement may be missing, then it is NaN."""
    values = np.full(len(rows), np.nan)
    for row, (line, cells) in enumerate(rows):
        text = cells[name]
        if text in delimited.MISSING:
            if name in REQUIRED:
                raise InputError("has no value", file=path, line=line, column=name)
            continue
        value = delimited.number(text)
        if value is None or not math.isfinite(value):
            hint = delimited.number_hint(text)
            raise InputError(f"'{text}' is not a number", file=path, line=line, column=name, hint=hint)
        if value <= 0:
            raise InputError(f"{value:g} is not positive", file=path, line=line, column=name)
        values[row] = value
    return values
