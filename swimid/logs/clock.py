"""Sample times of a foreign table (from numbers, frame numbers, dates, times of day), and its row order.

:class:`Time` is the part ``time:`` of a mapping. :class:`Stated` is the base class of all parts of a mapping.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, PositiveFloat, field_validator, model_validator

from swimid.errors import InputError
from swimid.files import yamlio
from swimid.logs import units
from swimid.logs.foreign import Table, is_text
from swimid.logs.log import TIME, longest_run

Array = NDArray[np.float64]
_TIME_OF_DAY = r"\d{1,2}:\d\d(:\d\d(\.\d+)?)?"
_DATE = r"^(\d{1,2})[/.-](\d{1,2})[/.-](\d{4})(?:[T ]+|$)"
#: Names of columns that hold a frame number or a row number.
COUNT = re.compile(
    r"(frame|index|idx|row|sample|num(ber)?|n|no|count)s?([ _.#]*(number|num|index|idx|no|id|#))?"
)

#: Placeholder in a drafted mapping for a value that the user must state.
ASK = "ASK"
#: Key of a column: its name in the file, or its number, counted from 1.
ColumnKey = Annotated[str | int, Field(union_mode="left_to_right")]


class Stated(yamlio.Document):
    """Part of a mapping; a value that is still ``ASK`` is refused."""

    @field_validator("*", mode="before")
    @classmethod
    def _nothing_is_open(cls, value: Any) -> Any:
        inner = [value]
        if isinstance(value, list):
            inner = value
        elif isinstance(value, dict):
            inner = [*value.values()]
        if any(isinstance(part, str) and part == ASK for part in inner):
            raise ValueError(f"is still {ASK}: state it, or delete the line")
        return value


class Time(Stated):
    """Source of the sample times (``time:`` of a mapping)."""

    #: Column of the times, or several columns that form one time: date and time of day, or seconds and
    #: nanoseconds.
    source: ColumnKey | list[ColumnKey] | None = None
    #: Column of frame numbers. The time is the frame number divided by the rate.
    frame: ColumnKey | None = None
    #: Unit of the source column, or a list with the unit of each source column.
    unit: str | list[str] = "s"
    #: Rate of the rows or frames, Hz, or the name of the single number in the file that states this rate.
    rate_hz: PositiveFloat | str | None = None
    #: Format of dates for ``datetime.strptime``, if they are not ISO 8601.
    format: str | None = None
    #: Whether the day precedes the month in dates such as 03/11/2025.
    day_first: bool | None = None
    #: Value at which the time counter restarts from 0, in the unit of the source column.
    wraps_at: PositiveFloat | None = None
    #: Origin of the time: ``keep`` leaves the times as in the file, ``first`` counts from the first sample,
    #: and a number, s, is subtracted.
    origin: Literal["keep", "first"] | float = "keep"

    @model_validator(mode="after")
    def _one_way(self) -> Time:
        if self.frame is None and self.rate_hz is not None and isinstance(self.source, str | int):
            self.frame, self.source = self.source, None
        given = (self.source is not None, self.frame is not None, self.rate_hz is not None)
        if given not in ((True, False, False), (False, False, True), (False, True, True)):
            raise ValueError("give 'source' (a column), or 'rate_hz', or 'frame' and 'rate_hz'")
        if isinstance(self.unit, list) and len(self.unit) != len(self.sources):
            raise ValueError(f"{len(self.unit)} units stand beside {len(self.sources)} sources")
        for unit in self.units_of_sources or [str(self.unit)]:
            units.factor(unit, TIME)
        return self

    @property
    def sources(self) -> list[str | int]:
        """Columns that hold the time; empty if the time is counted from the rows."""
        if self.frame is not None:
            return [self.frame]
        if isinstance(self.source, list):
            return self.source
        return [key for key in [self.source] if key is not None]

    @property
    def units_of_sources(self) -> list[str]:
        """Unit of each column in ``sources``."""
        if isinstance(self.unit, list):
            return self.unit
        return [self.unit] * len(self.sources)


def seconds(table: Table, time: Time, rows: int, path: Path, metadata: dict[str, Any]) -> Array:
    """Return the sample times in s, shape (rows,); NaN for a row without a time.

    The origin is subtracted before integers become floating-point numbers, so that no digit is lost. With
    ``origin: first`` the time of the first sample in the file's clock is stored as
    ``metadata['first_stamp_s']``.

    Raises
    ------
    InputError
        A column or the rate is missing, or a cell holds no time. The message names the line and the column.
    """
    names = [table.column(key, path) for key in time.sources]
    parts = [table.columns[name] for name in names]
    factors = [units.factor(unit, TIME) for unit in time.units_of_sources]
    if time.rate_hz is not None:
        parts = [_frames(table, name, path) for name in names] or [np.arange(rows, dtype=float)]
        factors = [1.0 / _rate(time.rate_hz, table, path)]
    elif any(is_text(part) for part in parts):
        # text of times of day is already converted to seconds
        parts, factors = [_parsed(parts, table, time, names, path)], [1.0]
    known = np.logical_and.reduce([np.isfinite(part) for part in parts])
    if not known.any():
        return np.full(len(known), np.nan)
    row = int(np.argmax(known))
    first, total = 0.0, np.zeros(len(known))
    for part, factor in zip(parts, factors, strict=True):
        values = part
        if part.dtype.kind == "M":
            values, factor = part.astype("datetime64[ns]").astype(np.int64), 1e-9
        elif time.wraps_at is not None:
            values = unwrapped(part, time.wraps_at)
        first += float(values[row]) * factor
        if time.origin == "first":
            values = values - values[row]
        total += values * factor
    if time.origin == "first":
        metadata.setdefault("first_stamp_s", first)
    elif not isinstance(time.origin, str):
        total -= time.origin
    return np.where(known, total, np.nan)


def _rate(given: float | str, table: Table, path: Path) -> float:
    if not isinstance(given, str):
        return given
    rate = table.scalars.get(given, np.nan)
    if not 0 < rate < np.inf:
        known = ", ".join(f"{name} = {value:g}" for name, value in table.scalars.items())
        hint = f"single numbers in it: {known or 'none'}"
        raise InputError(f"holds no positive number '{given}' for the rate", file=path, hint=hint)
    return rate


def _frames(table: Table, name: str, path: Path) -> Array:
    """Return a column of frame numbers as floating-point numbers; a fraction or a text is refused."""
    values = table.columns[name]
    if is_text(values) or values.dtype.kind == "M":
        raise InputError("holds no frame numbers", file=path, column=name)
    frames = values.astype(float)
    broken = np.isfinite(frames) & (frames != np.round(frames))
    if broken.any():
        row = int(np.argmax(broken))
        text = f"{frames[row]:g} is no frame number; frame numbers are whole"
        hint = "a column of times is 'source', without 'rate_hz'"
        raise InputError(text, file=path, column=name, hint=hint, **table.place(row))
    return frames


def unwrapped(counts: NDArray[Any], period: float) -> Array:
    """Return the values of a counter that restarts from 0 at ``period`` as values that keep growing.

    >>> unwrapped(np.array([65534.0, 65535.0, 0.0, 1.0]), 65536).tolist()
    [65534.0, 65535.0, 65536.0, 65537.0]
    """
    values = counts.astype(float)
    steps = np.diff(values)
    return values + period * np.concatenate(([0.0], np.cumsum(steps < -period / 2)))


def _parsed(
    parts: list[NDArray[Any]], table: Table, time: Time, names: list[str], path: Path
) -> NDArray[Any]:
    """Return cells of text as dates (``datetime64[ns]``), or as times of day in s."""
    import pandas as pd

    # whole numbers in a column next to a text column are written without a decimal point
    columns = [pd.Series(part).convert_dtypes().astype("string").str.strip() for part in parts]
    cells = columns[0].str.cat(columns[1:], sep=" ") if columns[1:] else columns[0]
    plain = cells.str.replace(",", ".", regex=False)
    of_day = plain.str.fullmatch(_TIME_OF_DAY)
    if time.format is not None:
        stamps = pd.to_datetime(cells, format=time.format, errors="coerce", utc=True)
    elif of_day.mean() > 0.5:
        minutes = plain.where(of_day).str.replace(r"^(\d+:\d+)$", r"\1:00", regex=True)
        stamps = pd.to_timedelta(minutes, errors="coerce")
    else:
        if plain.str.match(_DATE).mean() > 0.5:
            if time.day_first is None:
                text = f"'{cells[cells.notna()].iloc[0]}' may have the day or the month first"
                hint = "add 'day_first: true' (or false) to 'time:' of the mapping"
                raise InputError(text, file=path, column=names[0], hint=hint)
            iso = r"\3-\2-\1 " if time.day_first else r"\3-\1-\2 "
            plain = plain.str.replace(_DATE, iso, regex=True).str.strip()
        stamps = pd.to_datetime(plain, errors="coerce", format="ISO8601", utc=True)
    bad = (cells.notna() & stamps.isna()).to_numpy(dtype=bool)
    if bad.any():
        row = int(np.argmax(bad))
        text = f"'{cells.iloc[row][:40]}' is neither a number nor a date or time that is known"
        hint = "state how it is written under 'time:' of the mapping, as in format: '%d.%m.%Y %H:%M:%S'"
        raise InputError(text, file=path, column=" and ".join(names), hint=hint, **table.place(row))
    if stamps.dtype.kind == "m":
        return unwrapped(stamps.dt.total_seconds().to_numpy(), 86400.0)
    return stamps.dt.tz_localize(None).to_numpy(dtype="datetime64[ns]")


# ---------------------------------------------------------------- rows in order

#: Maximum fraction of samples that arrive late, and maximum number of consecutive late samples. With more
#: late samples, the clock is taken to have been reset.
LATE_SHARE, LATE_RUN = 0.01, 20
#: Words of the summary for each kind of rows out of order, by the attribute of :class:`Order` that counts
#: these rows.
ODD_ROWS = {
    "untimed": "without a time left out",
    "repeated": "repeated left out",
    "clashing": "with the time of the row before but other values left out",
    "late": "that came late put in their place",
}


@dataclass(frozen=True)
class Order:
    """Order of the rows of a record by their times.

    Attributes
    ----------
    index : ndarray of int, shape (m,)
        Numbers of the rows that are kept, sorted by time.
    untimed : int
        Number of rows without a time, which are left out.
    repeated : int
        Number of rows equal to an earlier row at the same time, which are left out.
    clashing : int
        Number of rows with other values at the time of an earlier row, which are left out.
    late : int
        Number of rows that follow a row with a later time, and that are moved to the place of their time.
    reset_row : int or None
        Row at which the clock was reset, or None. A record with a reset clock cannot be sorted by time.
    """

    index: NDArray[np.int64]
    untimed: int = 0
    repeated: int = 0
    clashing: int = 0
    late: int = 0
    reset_row: int | None = None

    @property
    def counts(self) -> dict[str, int]:
        """Number of rows out of order, by kind (key of :data:`ODD_ROWS`)."""
        return {name: getattr(self, name) for name in ODD_ROWS}

    @property
    def changed(self) -> bool:
        """Whether any row is left out or moved."""
        return any(self.counts.values())

    @property
    def summary(self) -> str:
        """Words that say how many rows of each kind are left out or moved; empty if none is."""
        return "; ".join(f"{count} {ODD_ROWS[name]}" for name, count in self.counts.items() if count)


def in_order(time_s: Array, columns: Mapping[str, Array]) -> Order:
    """Return the order in which the rows of a record have strictly increasing times.

    Parameters
    ----------
    time_s : ndarray, shape (n,)
        Times, s, which may be NaN, repeat, or go back.
    columns : mapping of str to ndarray, each shape (n,)
        All other columns. They decide whether a row at the time of an earlier row is equal to it or
        contradicts it.

    Notes
    -----
    Single rows that arrive late (packets on a network) are moved to the place of their time. A clock that
    goes back and counts on from the earlier time was reset. In that case the rows are not sorted, because the
    log does not show which times are right.
    """
    index = np.flatnonzero(np.isfinite(time_s))
    times, untimed = time_s[index], len(time_s) - len(index)
    if np.all(np.diff(times) > 0):
        return Order(index, untimed)
    behind = times < np.maximum.accumulate(times)
    late = int(behind.sum())
    if late > max(1, LATE_SHARE * len(times)) or longest_run(behind) > LATE_RUN:
        return Order(index, untimed, late=late, reset_row=int(index[np.argmax(behind)]))
    import pandas as pd

    rows = pd.DataFrame({**columns, TIME: time_s}).iloc[index].sort_values(TIME, kind="stable")
    again, repeated = rows.duplicated(TIME), int(rows.duplicated().sum())
    return Order(rows.index[~again].to_numpy(), untimed, repeated, int(again.sum()) - repeated, late)
