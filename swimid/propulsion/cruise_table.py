"""The table of a cruise experiment: one row per run."""

from __future__ import annotations

import csv
import hashlib
import io
import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from swimid.errors import InputError
from swimid.files import tabular
from swimid.files.provenance import Held
from swimid.notices import warn

if TYPE_CHECKING:
    import pandas as pd

Array = NDArray[np.float64]
NUMBERS = ("frequency_hz", "amplitude_deg", "distance_m")
#: Line of the file (None in memory) and cells by column name.
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
    held, line = None, None
    try:
        if isinstance(source, str | Path):
            path = Path(source)
            _, header, line = tabular.head(path)
            names = tabular.column_names(header, path, line)
            text = path.read_text(encoding="utf-8-sig")
        else:
            path, names = Path("table"), [str(name) for name in source.columns]
            text = source.to_csv(index=False)
            held = Held("table", hashlib.sha256(text.encode()).hexdigest())
    except UnicodeDecodeError as error:
        raise InputError("is not UTF-8 text", file=path) from error
    except OSError as error:
        hint = "check the path" if isinstance(error, FileNotFoundError) else None
        raise InputError(f"cannot be read: {error.strerror or error}", file=path, hint=hint) from error
    speed = "mean_speed_m_s" if "mean_speed_m_s" in names else "time_s"
    for column in ("fin", *NUMBERS, speed):
        if column not in names:
            what = "this column is missing"
            if column == "time_s":
                what = "neither time_s nor mean_speed_m_s is there"
            raise tabular.missing_column(column, names, path, line, what)
    rows = _rows(text, path, line, names)
    if not rows:
        raise InputError("has a header and no runs", file=path, line=line)
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
    doubts = [
        (speed, typical > 20, f"speeds of {typical:.3g} m/s; is it mm/s (a factor of 1000)?"),
        (
            "distance_m",
            np.max(distance) > 50,
            "looks like centimetres or millimetres",
        ),
        ("amplitude_deg", np.max(columns["amplitude_deg"]) < 1.6, "looks like radians (a factor of 57.3)"),
    ]
    for column, doubtful, words in doubts:
        if doubtful:
            warn("SWM002", f"{path.name}, '{column}': {words}")
    fins = [cells["fin"] for _, cells in rows]
    frequency, amplitude, distance = (columns[name] for name in NUMBERS)
    return CruiseTable(path, held or path, fins, frequency, amplitude, distance, speeds)


def _rows(text: str, path: Path, header_line: int | None, names: list[str]) -> list[Row]:
    """Return line and cells by column name of every row that is not blank or a comment."""
    rows: list[Row] = []
    before = header_line or 1
    stream = io.StringIO(text, newline="")
    for _ in range(before):
        next(stream)
    reader = csv.reader(stream, skipinitialspace=True, strict=True)
    try:
        for cells in reader:
            line = before + reader.line_num if header_line else None
            if not any(cell.strip() for cell in cells) or cells[0].startswith("#"):
                continue
            if len(cells) != len(names):
                what = f"has {len(cells)} cells where the header names {len(names)} columns"
                raise InputError(what, file=path, line=line)
            rows.append((line, {n: c.strip() for n, c in zip(names, cells, strict=True)}))
    except csv.Error as error:
        raise InputError(f"is no table: {error}", file=path, line=before + reader.line_num) from error
    return rows


def _numbers(rows: list[Row], name: str, path: Path) -> Array:
    """Return a column of positive numbers; only a measurement may be missing, then it is NaN."""
    values = np.full(len(rows), np.nan)
    for row, (line, cells) in enumerate(rows):
        text = cells[name]
        if text in tabular.MISSING and name not in NUMBERS:
            continue
        value = tabular.number(text)
        what, hint = "", None
        if text in tabular.MISSING:
            what = "has no value"
        elif value is None or not math.isfinite(value):
            what, hint = f"'{text}' is not a number", tabular.number_hint(text)
        elif value <= 0:
            what = f"{value:g} is not positive"
        if what:
            raise InputError(what, file=path, line=line, column=name, hint=hint)
        values[row] = value
    return values
