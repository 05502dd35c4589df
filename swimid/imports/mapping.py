"""Mapping of a log of another program to the log format (``swimid-mapping/1``, ``docs/import.md``).

A mapping assigns a source column of the file to each target column of the log, with the unit of the source.
:func:`apply` returns the target columns in SI units, in the row order of the file. The times may still
repeat, go back or be missing.
"""

from __future__ import annotations

import json
import re
from collections import Counter, abc
from collections.abc import Sequence, Set
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, PositiveFloat, PrivateAttr, field_validator, model_validator

from swimid.errors import InputError, suggestion
from swimid.files import isolated, memory, yamlio
from swimid.files.provenance import path_of
from swimid.files.tabular import find_repeated
from swimid.files.yamlio import ASK
from swimid.imports.averaging import Averager, RowStatistics
from swimid.imports.formats import open_table
from swimid.imports.options import ImportOptions
from swimid.imports.table import (
    GROUPED,
    MAX_ODD,
    ForeignTable,
    ReaderOptions,
    in_words,
    is_text,
    numbers_in,
    restore_sign,
)
from swimid.kinematics.attitude import AXES, reorder_quaternion
from swimid.logs import log
from swimid.logs.log import TIME, Log, LogLike, is_written_by, metadata_of
from swimid.logs.sampling import PAUSE, SET, UNIFORM_SHARE, usual_step
from swimid.logs.units import COMPOUND, KNOWN, UNITS, canonical, quantity_of, states_quantity, unit_factor
from swimid.notices import Progress, silent, warn
from swimid.options import LARGEST, takes
from swimid.results.result import Text

Array = NDArray[np.float64]
FORMAT: Literal["swimid-mapping/1"] = "swimid-mapping/1"
_KEY_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
#: Maximum number of instances (sensors, animals, tags) that are recognised if their rows alternate in one
#: table.
MAX_INSTANCES = 16
#: Pattern of the names of columns that hold a time or a part of it, and pattern of the names of columns that
#: number instances (sensors, animals, tags).
OF_TIME = re.compile(r".*(time|stamp|date|n?sec(ond)?s?|nanosec)", re.I)
_INSTANCE = re.compile(
    r"(.*[ _.])?(i|id|instances?|tag|track|individual|animal|sensor|marker|device|servo|motor|frame_id)"
)
#: Minimum likelihood of a tracked point. The coordinates of a point with a lower likelihood are left empty.
#: The value is the default ``pcutoff`` of DeepLabCut.
MIN_LIKELIHOOD = 0.6
_LIKELIHOOD = re.compile(r"(?P<point>.+?)[ _.](likelihood|confidence|score|prob(ability)?)", re.I)
#: Hint at the end of an error message about a cell that is not a number.
MISSING_HINT = ", or name what marks it under 'missing:' of the mapping"
#: Pattern of the part of a column name that follows the name of a tracked point: a coordinate such as ``_x``.
_COORDINATE_NAME = r"[ _.]*(?i:[xyz]([ _.].*)?)"
#: Name of the unit of a dimensionless quantity in a mapping.
NO_UNIT = "1"
#: Length of a day, s: period with which a time of day repeats.
DAY_S = 86400.0
#: Example of a format of dates in a message.
EXAMPLE = "'%d.%m.%Y %H:%M:%S.%f'"
_TIME_OF_DAY = r"\d{1,2}:\d\d(:\d\d(\.\d+)?)?"
#: Pattern of the names of columns that hold a frame number or a row number.
COUNT = re.compile(
    r"(frame|index|idx|row|sample|num(ber)?|n|no|count)s?([ _.#]*(number|num|index|idx|no|id|#))?"
)

#: Type of the reference to a column of a foreign file: its name, or its number, counted from 1.
ColumnKey = Annotated[str | int, Field(union_mode="left_to_right")]


class Time(yamlio.Document):
    """Source of the sample times in a file (key ``time:`` of a mapping)."""

    #: Column that holds the times, or several columns that form one time: date and time of day, or seconds
    #: and nanoseconds.
    source: ColumnKey | list[ColumnKey] | None = None
    #: Key of the column that holds frame numbers. The time is the frame number divided by the rate.
    frame: ColumnKey | None = None
    #: Unit of the time column, or a list with the unit of each time column.
    unit: str | list[str] = "s"
    #: Rate of the rows or frames, Hz, or the name of a single number in the file that states this rate.
    rate_hz: PositiveFloat | str | None = None
    #: Format of dates for ``datetime.strptime``, if they are not ISO 8601.
    format: str | None = None
    #: Value at which the time counter restarts from 0, in the unit of the source column.
    wraps_at: PositiveFloat | None = None
    #: Origin of the time: ``keep`` leaves the times as in the file, ``first`` counts the time from the first
    #: sample.
    origin: Literal["keep", "first"] = "keep"
    #: Time that is added to the times of the file, s. If ``time:`` has no other key, the file must state its
    #: times.
    offset_s: float = 0.0

    @model_validator(mode="after")
    def _one_way(self) -> Time:
        if self.frame is None and self.rate_hz is not None and isinstance(self.source, str | int):
            self.frame, self.source = self.source, None
        given = (self.source is not None, self.frame is not None, self.rate_hz is not None)
        of_file = not any(given) and "offset_s" in self.model_fields_set
        if given not in ((True, False, False), (False, False, True), (False, True, True)) and not of_file:
            raise ValueError(
                "the time is not stated, or stated twice: give 'source' (a column), or 'rate_hz', or 'frame' "
                "and 'rate_hz', or, if the file states its times, 'offset_s' alone"
            )
        if isinstance(self.unit, list) and len(self.unit) != len(self.sources):
            raise ValueError(
                f"'unit' has {len(self.unit)} entries for {len(self.sources)} sources: give one for each"
            )
        for unit in self.units_of_sources or [str(self.unit)]:
            unit_factor(unit, TIME)
        return self

    @property
    def sources(self) -> list[str | int]:
        """Keys of the columns that hold the sample times; empty if the times follow from the row numbers."""
        if self.frame is not None:
            return [self.frame]
        if isinstance(self.source, list):
            return self.source
        return [key for key in [self.source] if key is not None]

    @property
    def units_of_sources(self) -> list[str]:
        """Unit of each column that holds the time, in the order of ``sources``."""
        if isinstance(self.unit, list):
            return self.unit
        return [self.unit] * len(self.sources)


class Column(yamlio.Document):
    """Mapping of one column: ``target = source * (factor from the unit to SI) * factor + offset``."""

    source: ColumnKey
    target: str
    #: Unit of the source column. Values are converted from this unit to the unit in the name of the target
    #: column. The unit of a dimensionless quantity is ``1``.
    unit: str | None = None
    factor: float = 1.0
    #: Offset that is added to the converted values, in the unit of the target column.
    offset: float = 0.0

    @field_validator("target")
    @classmethod
    def _plain_name(cls, value: str) -> str:
        if not _KEY_NAME.fullmatch(value):
            raise ValueError(f"'{value}' must consist of letters, digits and underscores, as in x_m")
        return value

    @model_validator(mode="after")
    def _unit_fits(self) -> Column:
        if self.scale == 0:
            raise ValueError(
                "the factor is 0, which would set all values of the column to 0: give another factor"
            )
        return self

    @property
    def scale(self) -> float:
        """Factor from the values of the source column to those of the target column."""
        if self.unit in (None, NO_UNIT):
            return self.factor
        return self.factor * unit_factor(str(self.unit), self.target)


class Quaternion(yamlio.Document):
    """Convention of the quaternions in the file: order of the elements, and direction of the rotation."""

    order: Literal["wxyz", "xyzw"] = "wxyz"
    direction: Literal["body-to-world", "world-to-body"] = "body-to-world"


class Align(yamlio.Document):
    """Columns that show one motion, by which the clocks of two logs are aligned (key ``align:``)."""

    #: Column of the log.
    this: str
    #: Column of the joined table, by the name of its target or of its source.
    that: str
    #: Maximum difference between the offset and the ``offset_s`` of the joined table, s.
    within_s: PositiveFloat | None = None


class TableSource(yamlio.Document):
    """Table that is read from a file: format, selection, layout, times and rows."""

    #: Name of the file format, such as ``deeplabcut``. A format that is a profile names the columns itself.
    profile: str | None = Field(default=None, alias="as")
    #: Track, individual, topic, message type, struct or group to read, if the file holds several.
    select: str | int | None = None
    reader: ReaderOptions = ReaderOptions()
    #: Source of the sample times, if the file does not state its times.
    time: Time | None = None
    #: Condition for the rows that are read: in each named column, a row must have one of the given values.
    where: dict[str, str | float | int | list[str | float | int]] = {}

    def table(self, given: str | Path | Log) -> ForeignTable:
        """Return the table in a file or in a log in memory."""
        select = None if self.select is None else str(self.select)
        return open_table(given, self.reader, select, self.profile)


class Joined(TableSource):
    """Columns of another topic, struct or file, which are interpolated at the times of the log."""

    #: Path of another file, relative to the folder of the imported log or, if it is not there, of the
    #: mapping; by default the imported file itself. ``{stem}`` is the name of the recording without its file
    #: name extension.
    file: str | None = None
    #: Columns that are added to the log, each with its source.
    columns: Annotated[list[Column], Field(min_length=1)]
    #: Value between two samples: ``line`` interpolates linearly, ``hold`` keeps the value of the first
    #: sample, for example of a command.
    between: Literal["line", "hold"] = "line"
    #: Columns by which the offset between the two clocks is estimated.
    align: Align | None = None


class Mapping(TableSource):
    """Content of a mapping file, which assigns the columns of a foreign file to those of a log."""

    #: Folder of the mapping file.
    _folder: Path = PrivateAttr(default=Path())

    format: Literal["swimid-mapping/1"]
    #: Minimum likelihood of a tracked point. The coordinates of a point with a lower likelihood are left
    #: empty.
    min_likelihood: Annotated[float, Field(ge=0, le=1)] = MIN_LIKELIHOOD
    quaternion: Quaternion = Quaternion()
    #: Columns of the log, each with its source.
    columns: list[Column] = []
    #: Further topics, structs or files whose columns are added to the log.
    join: list[Joined] = []
    #: Metadata of the log that are added to those in the file.
    metadata: dict[str, str | float | int | bool | list[str | float | int]] = {}

    @model_validator(mode="after")
    def _consistent(self) -> Mapping:
        columns = [*self.columns, *(column for one in self.join for column in one.columns)]
        targets = [column.target for column in columns]
        twice = find_repeated(targets)
        if twice:
            raise ValueError(f"two columns have the target '{twice}': rename or omit one column")
        targets = [column.target for column in self.columns]
        if self.profile is not None:
            return self
        if not self.columns:
            raise ValueError("'columns' is missing: it assigns columns of the file to those of the log")
        if (self.time is None) == (TIME not in targets):
            raise ValueError(f"the time is missing or given twice: give 'time:' or the target {TIME}")
        if targets == [TIME]:
            raise ValueError("the mapping has a time only: add a column of a measured quantity")
        return self

    @property
    def name(self) -> str:
        """Name of a mapping in memory, by which the provenance of a result refers to it."""
        return "mapping"


@dataclass(frozen=True)
class MappedLog:
    """Log of another program, converted to target columns and SI units. Its rows are not sorted or cleaned.

    Attributes
    ----------
    path : Path
        Path of the foreign log.
    columns : dict of str to ndarray, each shape (n,)
        Target columns in SI units, ``t_s`` first; NaN where missing. Times may repeat, go back or be missing.
    rows : ndarray of int, shape (n,)
        Line number of each sample in a text file; for other files the row number, from 1.
    metadata : dict
        Metadata of the file, of the profile and of the mapping.
    notes : list of str
        Problems found while the file was read, for the user.
    sources : dict of str to (str, float, float)
        Source column, factor and offset of each target column.
    unknown : list of str
        Target columns whose quantity is stated neither by the name nor by the mapping.
    profile : str
        Name of the profile that read the file; empty without a profile.
    unlikely : dict of str to int
        Number of samples that were left empty because of a low likelihood, by name of the likelihood column.
    all_rows : RowStatistics or None
        Statistics of all rows of the file, if each row of the log is a mean of several rows.
    """

    path: Path
    columns: dict[str, Array]
    rows: NDArray[np.int64]
    metadata: dict[str, Any] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    sources: dict[str, tuple[str, float, float]] = field(default_factory=dict)
    unknown: list[str] = field(default_factory=list)
    profile: str = ""
    unlikely: dict[str, int] = field(default_factory=dict)
    all_rows: RowStatistics | None = None

    @property
    def time_s(self) -> Array:
        """Sample times as they are in the file, s, shape (n,)."""
        return self.columns[TIME]

    def __len__(self) -> int:
        return len(self.rows)


def read_mapping(given: str | Path | Mapping | dict[str, Any]) -> Mapping:
    """Return the mapping for an argument: the path of a mapping file, a mapping, or a dict with its keys.

    Raises
    ------
    InputError
        The mapping is invalid, or a value is still ``ASK``. The message names line and key.
    """
    if isinstance(given, Mapping):
        return given
    if isinstance(given, dict):
        return yamlio.validate({"format": FORMAT} | given, Mapping, "mapping")
    found = yamlio.read_document(given, Mapping)
    found._folder = Path(given).parent
    return found


def apply(
    mapping: Mapping | None,
    given: str | Path | Log,
    stated: dict[str, Any] | None = None,
    *,
    every: int = 1,
    progress: Progress = silent,
) -> MappedLog:
    """Read a foreign log with a mapping or a profile. A long Parquet file is read in batches.

    Parameters
    ----------
    mapping : Mapping or None
        Mapping. If None, the profile that recognises the file is used. If there is no such profile, the
        columns must have the names of the log format.
    given : path or Log
        Path of the foreign log, or a log in memory (:func:`swimid.logs.log.unread`).
    stated : dict, optional
        Values stated by the user in addition to the mapping. ``profile``, ``select``, ``length_unit`` and
        ``min_likelihood`` replace the values of the mapping. ``rate_hz`` is the frame rate, Hz, for a mapping
        without a time.
    every : int
        Number of successive rows that are averaged to one (:class:`swimid.imports.averaging.Averager`).
    progress : Progress
        Shows the progress of the reading.

    Raises
    ------
    InputError
        The file cannot be read or does not fit in memory, a column is missing, or a cell is not a number. The
        message names file, line and column.
    """
    path, stated = path_of(given), dict(stated or {})
    rules = mapping or Mapping(format=FORMAT, **{"as": ""})
    if every > 1 and rules.join:
        text = "the columns under 'join:' have other times and cannot be averaged with --every"
        raise InputError(text, file=path, hint="import the recordings one by one")
    rate = stated.pop("rate_hz", None)
    if rate is not None and rules.time is None:
        stated["time"] = Time(rate_hz=rate)
    unit = stated.pop("length_unit", rules.reader.length_unit)
    stated["reader"] = rules.reader.model_copy(update={"length_unit": unit})
    rules = rules.model_copy(update=stated)
    with progress(f"reading {path.name}", total=1) as step:
        found = _read(rules, rules.table(given), path, every)
        for joined in rules.join:
            _join(found, joined, given, path, rules._folder)
        step(1)
    return found


def _join(log: MappedLog, joined: Joined, given: str | Path | Log, path: Path, folder: Path) -> None:
    """Add the columns of another table to a log, interpolated at its times, in place.

    ``folder`` is that of the mapping file.

    The times of each table count from its ``first_stamp_s``, if it has one. Values are missing before the
    first and after the last sample of the other table, and in its pauses.

    Raises
    ------
    InputError
        The other table cannot be read, or its times do not overlap with those of the log.
    """
    place = path
    if joined.file is not None:
        recorded = Path(str(log.metadata.get("source") or path.name)).stem
        name = joined.file.replace("{stem}", recorded)
        given = place = path.parent / name
        if not place.exists() and (folder / name).exists():
            given = place = folder / name
    fields = joined.model_dump(by_alias=True, exclude={"file", "between", "align"}, exclude_unset=True)
    rules = yamlio.validate({"format": FORMAT, **fields}, Mapping, "join")
    other = _read(rules, rules.table(given), place)
    begins = [float(one.metadata.get("first_stamp_s", 0.0)) for one in (log, other)]
    order = in_order(other.time_s, {})
    time_s = other.time_s[order.index] + (begins[1] - begins[0])
    if joined.align is not None:
        time_s = time_s + _offset(log, joined, joined.align, time_s, other, order.index, place)
    ends = np.nanmin(log.time_s), np.nanmax(log.time_s)
    if len(time_s) < 2 or time_s[-1] <= ends[0] or time_s[0] >= ends[1]:
        text = f"none of the {len(time_s)} samples lies within the log, {ends[0]:g} to {ends[1]:g} s"
        hint = "give the offset as 'offset_s' under 'time:', or two columns that move together under 'align:'"
        raise InputError(text, file=place, column=f"join: {joined.select or joined.file}", hint=hint)
    outside = ~((log.time_s >= time_s[0]) & (log.time_s <= time_s[-1]))
    before = np.clip(np.searchsorted(time_s, log.time_s, side="right") - 1, 0, len(time_s) - 1)
    if joined.between == "line":
        steps = np.append(np.diff(time_s), 0.0)
        outside |= steps[before] > PAUSE * usual_step(time_s)
    other.columns.pop(TIME)
    for name, values in other.columns.items():
        found = values[order.index][before]
        if joined.between == "line":
            found = np.interp(log.time_s, time_s, values[order.index])
        log.columns[name] = np.where(outside, np.nan, found)
    other.sources.pop(TIME, None)
    log.sources.update(other.sources)
    log.unknown.extend(other.unknown)
    log.notes.extend(other.notes)


#: Minimum period of a motion that counts as drift when two clocks are aligned: MIN_SLOW_S in s, and
#: MIN_SLOW_PERIODS in mean periods of the column.
MIN_SLOW_S, MIN_SLOW_PERIODS = 5.0, 3.0


def _offset(
    log: MappedLog,
    joined: Joined,
    align: Align,
    time_s: Array,
    other: MappedLog,
    rows: NDArray[np.int64],
    place: Path,
) -> float:
    """Return the time to add to the times of a joined table, s; state it in the metadata of the log.

    ``time_s`` has the times of the given rows of the joined table, as far as they are known.

    Raises
    ------
    InputError
        There is no such column, or the two columns do not show the same motion.
    """
    from swimid.imports import clocks

    order = in_order(log.time_s, {}).index
    targets = {key: column.target for column in joined.columns for key in (str(column.source), column.target)}
    for name, known in ((align.this, list(log.columns)), (align.that, list(targets))):
        if name not in known:
            hint = suggestion(name, known, "it has")
            raise InputError("there is no such column to align", file=place, column=name, hint=hint)
    that = other.columns[targets[align.that]][rows]
    there, near_s = np.isfinite(that), align.within_s or np.inf
    spread, turning = np.std(that[there]), np.std(np.gradient(that[there], time_s[there]))
    slow_s = max(MIN_SLOW_S, MIN_SLOW_PERIODS * 2 * np.pi * float(spread / max(turning, 1e-300)))
    # A held value is on average half a time step older than a linearly interpolated value.
    delay_s = 0.5 * usual_step(time_s[there]) * (joined.between == "hold")
    this_s, this = log.time_s[order], log.columns[align.this][order, None]
    pair = (time_s[there] + delay_s, that[there, None], this_s, this)
    found = clocks.clock_offset(*pair, slow_s=slow_s, near_s=(-near_s, near_s))
    explained = 0.0 if found is None else found.explained
    if found is None or explained < clocks.MIN_EXPLAINED:
        text = f"'{align.that}' explains only {100 * explained:.0f} % of '{align.this}'"
        hint = "align columns that move together, or state the offset: time: {offset_s: ...}"
        raise InputError(text, file=place, hint=hint)
    name, total_s = str(joined.select or place.name), -found.value_s
    if joined.time is not None:
        total_s += joined.time.offset_s
    stated = {"offset_s": total_s, "sd_s": found.stderr_s, "by": f"{align.this}, {align.that}"}
    log.metadata.setdefault("clock_offsets", {})[name] = stated
    target = targets[align.that]
    if SET.fullmatch(target) and target.removeprefix("cmd") != align.this.removeprefix("joint"):
        text = (
            f"the clock offset of {name} includes the lag of {align.this} behind {target}, but the standard "
            "error of the offset does not"
        )
        log.notes.append(f"{text}: a fit estimates the lag with --free clock_offset")
    if found.rivals:
        others = ", ".join(f"{total_s + found.value_s - rival:.3f}" for rival in found.rivals[:3])
        text = f"the clock of {name} is ambiguous: offsets of {total_s:.3f} and {others} s fit equally well"
        log.notes.append(f"{text}; 'offset_s' under 'time:' and 'within_s' under 'align:' restrict it")
    return -found.value_s


#: Number of copies of all cells that are in memory while a log is examined, measured with 10 million rows.
N_ROWS_COPIED = 8


class NoRowError(InputError):
    """Error for a table in which no row meets the condition ``where``."""


def _read(mapping: Mapping, table: ForeignTable, path: Path, every: int = 1) -> MappedLog:
    """Map the rows of a table and the following rows of its file. The mean of ``every`` rows becomes one row.

    Raises
    ------
    InputError
        The rows do not fit in memory, or no row is chosen.
    """
    metadata = metadata_of(table.comments, path, strict=False)
    metadata |= {key: _short(value) for key, value in table.metadata.items()} | mapping.metadata
    columns = mapping.columns or _identity(table, path, metadata)
    if mapping.profile is not None and TIME in table.columns:
        mapping, columns = _with_own_times(mapping, columns, table, path)
    table = replace(table, columns=table.columns | table.keys)
    keys: list[str | int] = [column.source for column in columns]
    if mapping.time is not None:
        keys += mapping.time.sources
    names = list(dict.fromkeys(table.column(key, path) for key in [*keys, *mapping.where]))
    if table.after:
        _check_memory(len(table.columns[names[0]]) + table.after, len(names), every, path)
    clock, averager = Clock(), Averager(every)
    pieces: list[MappedLog] = []
    errors: list[NoRowError] = []
    for batch in table.batches(names):
        try:
            pieces.append(_map_columns(mapping, columns, batch, path, metadata, clock))
        except NoRowError as error:
            errors.append(error)
            continue
        if every > 1:
            pieces[-1] = _average(pieces[-1], averager)
    if not pieces:
        raise errors[0]
    if every > 1:
        metadata["mean_of_rows"] = every
        pieces.append(_average(pieces[-1], averager, last=True))
        pieces[0] = replace(pieces[0], all_rows=averager.statistics)
    whole = _concatenate(pieces)
    for name, values in whole.columns.items():
        log.check_not_tiny(values, path, name)
    return whole


def _check_memory(rows: int, width: int, every: int, path: Path) -> None:
    """Raise an error if the means of ``every`` rows of ``width`` columns do not fit in memory."""
    hint = f"import means of successive rows, as in --every {100 * every}, or map fewer columns"
    what = f"{rows // every} rows of {width} columns"
    memory.check_fits(path, what, 8.0 * N_ROWS_COPIED * width * (rows // every), hint)
    if every == 1:
        isolated.check_size(path, 8 * width * rows)


def _average(piece: MappedLog, averager: Averager, *, last: bool = False) -> MappedLog:
    """Average the rows of a piece; if ``last`` is true, also the rows that wait in the averager."""
    if last:
        nothing = {name: values[:0] for name, values in piece.columns.items()}
        piece = replace(piece, columns=nothing, rows=piece.rows[:0], unlikely={})
    columns, rows = averager.take(piece.columns, piece.rows, last=last)
    return replace(piece, columns=columns, rows=rows)


def _concatenate(pieces: list[MappedLog]) -> MappedLog:
    """Return the log of successive batches of rows of one file."""
    first = pieces[0]
    if len(pieces) == 1:
        return first
    notes = list(dict.fromkeys(note for piece in pieces for note in piece.notes))
    unlikely: Counter[str] = Counter()
    for piece in pieces:
        unlikely.update(piece.unlikely)
    columns = {name: np.concatenate([piece.columns[name] for piece in pieces]) for name in first.columns}
    rows = np.concatenate([piece.rows for piece in pieces])
    return replace(first, columns=columns, rows=rows, notes=notes, unlikely=dict(unlikely))


def _find_unknown(columns: list[Column], metadata: dict[str, Any]) -> list[str]:
    """Return the targets whose quantity neither a unit nor the name states, in a log of others."""
    if is_written_by(metadata, "swimid"):
        return []
    return [c.target for c in columns if c.unit != NO_UNIT and not states_quantity(c.target)]


def _map_columns(
    mapping: Mapping,
    columns: list[Column],
    table: ForeignTable,
    path: Path,
    metadata: dict[str, Any],
    clock: Clock,
) -> MappedLog:
    notes = table.notes
    sources = {column.target: table.column(column.source, path) for column in columns}
    columns = [_with_unit(column, table.units.get(sources[column.target]), path) for column in columns]
    time = _time(mapping, table, sources, path)
    keys = [*mapping.where, *(time.sources if time is not None else ())]
    used = [table.column(key, path) for key in keys]
    rows = _same_length([*sources.values(), *used], table, path)
    found: dict[str, Array] = {}
    if time is not None:
        found[TIME] = seconds(table, time, rows, path, metadata, clock)
    for column in sorted(columns, key=lambda column: column.target != TIME):
        values = _values(column, table, sources[column.target], mapping.reader.missing, path, notes)
        found.setdefault(column.target, values)
    chosen = _select_rows(table, mapping.where, rows, path)
    if np.isnan(found[TIME]).any():
        # Leave out rows without any value. They only pad the table, and do not count as lost samples.
        padding = np.all([np.isnan(values) for values in found.values()], axis=0)
        chosen &= ~padding | padding.all()
    by, there = find_mixed(table, found[TIME], chosen, {*used, sources.get(TIME, "")})
    if there:
        text = f"the rows are those of {len(there)} instances in turn: {', '.join(there)}"
        hint = f"choose an instance: where: {{{by}: {there[0]}}}; 'join:' adds the columns of another"
        if not mapping.columns:
            hint = f"write a mapping with the lines 'as: {table.profile}' and {hint.partition(': ')[2]}"
        raise InputError(text, file=path, column=by, hint=hint)
    if not chosen.all():
        found = {name: values[chosen] for name, values in found.items()}
    _empty_infinite(found, notes)
    unlikely = empty_unlikely(found, sources, mapping.min_likelihood)
    _convert_quaternion(found, mapping.quaternion, path)
    notes += _check_frame_numbers(table, time, path)
    lines = table.before + np.arange(1, rows + 1, dtype=np.int64)
    if table.lines is not None:
        lines = table.lines
    scales = {column.target: (str(column.source), column.scale, column.offset) for column in columns}
    unknown = _find_unknown(columns, metadata)
    numbers = lines[:rows][chosen]
    return MappedLog(path, found, numbers, metadata, notes, scales, unknown, table.profile, unlikely)


def _empty_infinite(columns: dict[str, Array], notes: list[str]) -> None:
    """Set infinite values and values beyond :data:`LARGEST` to NaN, in place, with a remark on them."""
    infinite = [name for name, values in columns.items() if (np.abs(values) > LARGEST).any()]
    for name in infinite:
        columns[name][np.abs(columns[name]) > LARGEST] = np.nan
    if infinite:
        text = f"infinite values and values beyond ±{LARGEST:g} taken as missing"
        notes.append(f"{text} in {', '.join(infinite)}")


def _convert_quaternion(columns: dict[str, Array], convention: Quaternion, path: Path) -> None:
    """Convert the columns of a quaternion to the convention of the log, in place.

    Raises
    ------
    InputError
        The log has some of the four components, but not all.
    """
    lacking = [axis for axis in AXES if axis not in columns]
    if 0 < len(lacking) < len(AXES):
        hint = f"map {lacking[0]} too, or leave the other components ({', '.join(AXES)}) out"
        text = "this component of the quaternion is missing: the attitude needs all four"
        raise InputError(text, file=path, column=lacking[0], hint=hint)
    if not lacking:
        q = np.column_stack([columns[axis] for axis in AXES])
        q = reorder_quaternion(q, convention.order, convention.direction)
        columns |= dict(zip(AXES, q.T, strict=True))


def _with_unit(column: Column, stated: str | None, path: Path) -> Column:
    """Add the unit that the file states to the mapping of a column; raise an error if the two differ."""
    unit = canonical(stated or "")
    if unit not in UNITS.get(quantity_of(column.target) or "", {}):
        return column
    of_file = column.model_copy(update={"unit": unit})
    if column.unit is not None and column.scale != of_file.scale:
        text = f"the file states {unit}, the mapping states {column.unit}"
        hint = "leave 'unit' out, or, if the file is wrong, give a 'factor' in place of the unit"
        raise InputError(text, file=path, column=str(column.source), hint=hint)
    return of_file


#: Maximum relative difference between a stated sample rate and that of the times in a file.
RATE_RTOL = 0.01


def _with_own_times(
    mapping: Mapping, columns: list[Column], table: ForeignTable, path: Path
) -> tuple[Mapping, list[Column]]:
    """Return a mapping and its columns with the times that the file states, unless the mapping names others.

    Raises
    ------
    InputError
        The mapping states a rate that contradicts the times of the file.
    """
    time = mapping.time
    if TIME in [c.target for c in mapping.columns] or (time is not None and time.sources):
        return mapping, columns
    rest = [column for column in columns if column.target != TIME]
    if time is None:
        return mapping, [Column(source=TIME, target=TIME), *rest]
    rate, hz, values = table.scalars.get(str(time.rate_hz), time.rate_hz), np.nan, table.columns[TIME]
    if values.dtype.kind in "iuf":
        hz = 1 / usual_step(values)
    if rate is not None and not (isinstance(rate, float) and abs(rate / hz - 1) <= RATE_RTOL):
        text = f"states its times, at {hz:.6g} Hz: a rate of {rate} Hz contradicts them"
        raise InputError(text, file=path, hint="leave the rate out")
    own = time.model_copy(update={"source": TIME, "rate_hz": None})
    return mapping.model_copy(update={"time": own}), rest


def _short(value: Any) -> Any:
    """Return the first line of a text, at most 120 characters; return a value of another type unchanged."""
    return value.strip().partition("\n")[0][:120] if isinstance(value, str) else value


def _identity(table: ForeignTable, path: Path, metadata: dict[str, Any]) -> list[Column]:
    """Map each column with a name of the log format to itself; warn of all other columns."""
    names = ", ".join(list(table.columns)[:20])
    hint = f"a mapping says which column is which (swimid import --guess drafts one); the file has: {names}"
    hint = "; ".join([hint, *table.notes])
    if not {TIME, "frame"} & set(table.columns):
        raise InputError("this column is missing", file=path, column=TIME, hint=hint)
    kept, out = [], []
    own = is_written_by(metadata, "swimid")
    for name in table.columns:
        known = (own or states_quantity(name)) and _KEY_NAME.fullmatch(name)
        if known and _numbers(table, name, [], path) is not None:
            kept.append(Column(source=name, target=name))
        elif name != "frame":
            out.append(name)
    if {column.target for column in kept} <= {TIME}:
        text = "no column is named with its quantity and unit as in the log format (x_m, yaw_rad)"
        raise InputError(text, file=path, hint=hint)
    twice = [column.target for column in kept if f"{column.target} (2)" in out]
    if twice:
        text, hint = "several columns have this name", "choose one by number in a mapping, as in source: 2"
        raise InputError(text, file=path, column=twice[0], hint=hint)
    if out and not own:
        warn("SWM004", f"{path.name}: columns whose names state no unit are left out: {', '.join(out[:20])}")
    return kept


def _time(mapping: Mapping, table: ForeignTable, sources: dict[str, str], path: Path) -> Time | None:
    """Return the source of a file's sample times; None if the mapping has a column ``t_s``."""
    time, has_frames = mapping.time, "frame" in table.columns and mapping.profile is not None
    if TIME in sources:
        if time is not None:
            text = f"states its times in {sources[TIME]}: a sample rate contradicts them"
            raise InputError(text, file=path, hint="leave the rate out")
        return None
    if time is None or not (time.sources or time.rate_hz):
        hint = "add --rate-hz with the frames per second of the film, as in --rate-hz 30"
        stamps = [name for name in table.columns if OF_TIME.fullmatch(name.strip())]
        if stamps and not has_frames:
            hint = f"name the column of the times, as in time: {{source: {stamps[0]}, unit: ms}} of a mapping"
        raise InputError("states neither times nor a frame rate", file=path, hint=hint)
    if has_frames and not time.sources:
        return time.model_copy(update={"frame": "frame"})
    return _with_time_units(time, table, path)


def _with_time_units(time: Time, table: ForeignTable, path: Path) -> Time:
    """Add the units that the file states to the source of the times; raise an error if others are mapped."""
    stated = [canonical(table.units.get(table.column(key, path), "")) for key in time.sources]
    if not stated or time.frame is not None or not set(stated) <= set(UNITS["time"]):
        return time
    given = [canonical(unit) for unit in time.units_of_sources]
    if "unit" in time.model_fields_set and given != stated:
        text = f"the file states {', '.join(stated)} for the times, the mapping states {', '.join(given)}"
        hint = "leave 'unit' out of 'time:'"
        raise InputError(text, file=path, column=str(time.sources[0]), hint=hint)
    return time.model_copy(update={"unit": stated})


def _same_length(names: Sequence[str], table: ForeignTable, path: Path) -> int:
    """Return the common number of rows of the mapped columns; raise an error if their lengths differ."""
    lengths = {name: len(table.columns[name]) for name in names}
    if len(set(lengths.values())) > 1:
        text = ", ".join(f"{name} {rows}" for name, rows in lengths.items())
        hint = "map columns of one length; logs of several rates are imported one by one"
        raise InputError(f"the columns have different numbers of samples: {text}", file=path, hint=hint)
    rows = next(iter(lengths.values()))
    if rows == 0:
        raise InputError("holds no samples", file=path)
    return rows


def _numbers(table: ForeignTable, name: str, missing: Sequence[float | str], path: Path) -> Array | None:
    """Return a column of a file as numbers, with NaN for missing-sample codes; None for dates or text."""
    values = table.columns[name]
    if values.dtype.kind == "M":
        return None
    if is_text(values):
        found = log.cells_to_numbers(values, False, table.place, path, name, MISSING_HINT)
        if found is None:
            return None
        values = found
    numbers = values.astype(float, copy=False)
    marks = [mark for mark in missing if isinstance(mark, int | float)]
    return np.where(np.isin(numbers, marks), np.nan, numbers) if marks else numbers


def _values(
    column: Column,
    table: ForeignTable,
    name: str,
    missing: Sequence[float | str],
    path: Path,
    notes: list[str],
) -> Array:
    """Return the values of a target column, in SI units; raise an error for a column of text or dates."""
    values = _numbers(table, name, missing, path)
    if values is None:
        kind = "text" if is_text(table.columns[name]) else "dates"
        raise InputError(f"holds {kind}, not numbers", file=path, column=name)
    if column.target != TIME:
        values = restore_sign(values, name, notes)
    return values * column.scale + column.offset


def _check_frame_numbers(table: ForeignTable, time: Time | None, path: Path) -> list[str]:
    """Return a note if the name and the steps of a time column are those of a frame number.

    The result is a list with this note. It is empty for any other column.
    """
    if time is None or time.frame is not None or not time.sources:
        return []
    name = table.column(time.sources[0], path)
    values = table.columns[name]
    if values.dtype.kind not in "iuf" or not COUNT.fullmatch(name.strip().lower()):
        return []
    steps = np.diff(values[np.isfinite(values)])
    if len(steps) == 0 or np.median(steps) != 1:
        return []
    text = f"'{name}' is mapped as a time, but its name and its steps of 1 are those of a frame number"
    return [f"{text}: write time: {{frame: {name}, rate_hz: ...}}"]


# ---------------------------------------------------------------- selection of rows


def _select_rows(table: ForeignTable, where: dict[str, Any], rows: int, path: Path) -> NDArray[np.bool_]:
    """Flag the rows of a table that have one of the wanted values in each column of ``where``.

    The result has the shape (rows,).

    Raises
    ------
    NoRowError
        No row meets the condition. The message lists the values in the column.
    """
    kept = np.ones(rows, dtype=bool)
    for key, wanted in where.items():
        import pandas as pd

        name = table.column(key, path)
        values, options = table.columns[name], pd.Series(wanted)
        if is_text(values):
            hits = pd.Series(values).astype(str).str.strip().isin(options.astype(str)).to_numpy()
        else:
            hits = np.isin(values, pd.to_numeric(options, errors="coerce"))
        if not (kept & hits).any():
            there = ", ".join(_distinct(values[kept])[:10])
            held = "it holds"
            if table.after:
                held = "its first rows hold"
            raise NoRowError(f"has no row with {wanted}; {held} {there}", file=path, column=name)
        kept &= hits
    return kept


def find_mixed(
    table: ForeignTable, time_s: Array, kept: NDArray[np.bool_], used: Set[str]
) -> tuple[str, list[str]]:
    """Find a column that numbers sensors, animals or tags whose rows alternate; return its name and values.

    Each sensor, animal or tag is an instance. The column that numbers the instances has few values and
    changes from row to row in at least half of the rows. In addition, either its name is that of an instance,
    or the times are even within each of its values and uneven over all rows. Without such a column the result
    is ``("", [])``.
    """
    time = time_s[kept]
    if len(time) < 10:
        return "", []
    for name, whole in table.columns.items():
        of_time = whole.dtype.kind == "M" or OF_TIME.fullmatch(name.strip()) is not None
        if name in used or len(whole) != len(kept) or of_time:
            continue
        values = whole[kept]
        if not is_text(values) and not np.all(values == np.round(values)):
            continue
        import pandas as pd

        codes, found = pd.factorize(values, use_na_sentinel=False)
        count = len(found)
        if not 2 <= count <= MAX_INSTANCES or np.mean(np.diff(codes) != 0) < 0.5:
            continue
        if np.bincount(codes).min() < 0.2 * len(codes) / count:
            continue
        even = all(_evenness(time[codes == k]) > 0.8 for k in range(count))
        if (even and _evenness(time) < 0.6) or _INSTANCE.fullmatch(name.strip().lower()):
            return name, _distinct(values)
    return "", []


def _evenness(time: Array) -> float:
    """Return the fraction of time steps that differ from the median time step by at most half of it."""
    steps = np.diff(time)
    if len(steps) == 0 or not np.median(steps) > 0:
        return 0.0
    usual = float(np.median(steps))
    return float(np.mean(np.abs(steps - usual) <= 0.5 * usual))


def _distinct(values: NDArray[Any]) -> list[str]:
    """Return the distinct values of a column in order of first appearance, without missing values."""
    import pandas as pd

    # Convert whole numbers to integers, so that they are written without a decimal point.
    known: list[str] = pd.Series(pd.unique(values)).dropna().convert_dtypes().astype(str).tolist()
    return known


def empty_unlikely(columns: dict[str, Array], sources: dict[str, str], minimum: float) -> dict[str, int]:
    """Set coordinates of unlikely tracked points to NaN, in place; count them by likelihood column.

    A likelihood applies to the coordinates whose names begin with the name of the same point, in the log or
    in the file. A sample without a likelihood counts as unlikely.

    >>> columns = {"x_px": np.array([1.0, 2.0]), "c": np.array([0.9, 0.1])}
    >>> empty_unlikely(columns, {"x_px": "nose_x", "c": "nose_likelihood"}, 0.6), columns["x_px"]
    ({'c': 1}, array([ 1., nan]))
    """
    emptied: dict[str, int] = {}
    for names in ({name: name for name in columns}, sources):
        for target, name in names.items():
            hit = _LIKELIHOOD.fullmatch(name)
            if hit is None or target in emptied:
                continue
            point = re.compile(re.escape(hit["point"]) + _COORDINATE_NAME)
            coordinates = [other for other, written in names.items() if point.fullmatch(written)]
            if not coordinates:
                continue
            unlikely = ~(columns[target] >= minimum)
            there = np.any([np.isfinite(columns[coordinate]) for coordinate in coordinates], axis=0)
            for coordinate in coordinates:
                columns[coordinate] = np.where(unlikely, np.nan, columns[coordinate])
            emptied[target] = int((unlikely & there).sum())
    return {target: count for target, count in emptied.items() if count}


# ---------------------------------------------------------------- sample times


@dataclass
class Clock:
    """State of the clock of a file that is read in batches.

    Attributes
    ----------
    origin : list
        First value of each time column; empty before the first row with a time.
    counts : list of float
        Last value of each time column, unwrapped; empty before the first row.
    """

    origin: list[Any] = field(default_factory=list)
    counts: list[float] = field(default_factory=list)


def seconds(
    table: ForeignTable,
    time: Time,
    rows: int,
    path: Path,
    metadata: dict[str, Any],
    clock: Clock | None = None,
) -> Array:
    """Return the sample times of a foreign file, s, shape (rows,); NaN for a row without a time.

    The origin is subtracted before integers become floating-point numbers, so that no digit is lost. With
    ``origin: first`` the time of the first sample in the file's clock is stored as
    ``metadata['first_stamp_s']``. ``clock`` has the state of the clock after the previous batch of rows.

    Raises
    ------
    InputError
        A column or the rate is missing, or a cell holds no time. The message names the line and the column.
    """
    clock = clock or Clock()
    period = time.wraps_at
    parts, factors, is_parsed = _time_columns(table, time, rows, path)
    if is_parsed and parts[0].dtype.kind != "M":
        period = DAY_S
    known = np.logical_and.reduce([np.isfinite(part) for part in parts])
    if not known.any():
        return np.full(len(known), np.nan)
    first, total, values_of = 0.0, np.zeros(len(known)), []
    for k, part in enumerate(parts):
        if part.dtype.kind == "M":
            part, factors[k] = part.astype("datetime64[ns]").astype(np.int64), 1e-9
        elif period is not None:
            part = unwrap_counter(part, period, *clock.counts[k : k + 1])
        values_of.append(part)
    if not clock.origin:
        clock.origin = [values[np.argmax(known)] for values in values_of]
    clock.counts = [float(values[known][-1]) for values in values_of]
    for values, start, factor in zip(values_of, clock.origin, factors, strict=True):
        first += float(start) * factor
        if time.origin == "first":
            values = values - start
        total += values * factor
    if time.origin == "first":
        metadata.setdefault("first_stamp_s", first)
    return np.where(known, total + time.offset_s, np.nan)


def _time_columns(
    table: ForeignTable, time: Time, rows: int, path: Path
) -> tuple[list[NDArray[Any]], list[float], bool]:
    """Return the columns whose sum is the time, their factors to seconds, and whether they were text.

    Text is parsed to one column of dates, or of times of day in seconds, so that its factor is 1.
    """
    names = [table.column(key, path) for key in time.sources]
    parts = [table.columns[name] for name in names]
    if time.rate_hz is not None:
        parts = [_frames(table, name, path) for name in names]
        rate = table.scalars.get(str(time.rate_hz), time.rate_hz)
        if isinstance(rate, str) or not 0 < rate < np.inf:
            known = ", ".join(f"{name} = {value:g}" for name, value in table.scalars.items())
            hint = f"single numbers in the file: {known or 'none'}"
            raise InputError(f"holds no positive number '{time.rate_hz}' for the rate", file=path, hint=hint)
        return parts or [table.before + np.arange(rows, dtype=float)], [1.0 / rate], False
    if any(map(is_text, parts)):
        return [_parse_times(parts, table, time, names, path)], [1.0], True
    return parts, [unit_factor(unit, TIME) for unit in time.units_of_sources], False


def _frames(table: ForeignTable, name: str, path: Path) -> Array:
    """Return a column of frame numbers as floats; raise an error if a cell is a fraction or text."""
    values = table.columns[name]
    if is_text(values) or values.dtype.kind == "M":
        kind = "text" if is_text(values) else "dates"
        raise InputError(f"holds {kind}, not frame numbers", file=path, column=name)
    frames = values.astype(float)
    broken = np.isfinite(frames) & (frames != np.round(frames))
    if broken.any():
        row = int(np.argmax(broken))
        text = f"{frames[row]:g} is no frame number; frame numbers are whole"
        hint = "a column of times is 'source', without 'rate_hz'"
        raise InputError(text, file=path, column=name, hint=hint, **table.place(row))
    return frames


def unwrap_counter(counts: NDArray[Any], period: float, before: float = 0.0) -> Array:
    """Unwrap a counter that restarts from 0 at ``period``: return values that never decrease.

    ``before`` is the last unwrapped value of the previous batch of rows.

    >>> unwrap_counter(np.array([65534.0, 65535.0, 0.0, 1.0]), 65536).tolist()
    [65534.0, 65535.0, 65536.0, 65537.0]
    """
    values = counts.astype(float)
    turns, last = divmod(before, period)
    steps = np.diff(np.concatenate(([last], values)))
    return values + period * (turns + np.cumsum(steps < -period / 2))


def _parse_times(
    parts: list[NDArray[Any]], table: ForeignTable, time: Time, names: list[str], path: Path
) -> NDArray[Any]:
    """Convert the text of time cells to dates (``datetime64[ns]``), or to times of day in s."""
    cells = _join_cells(parts)
    stamps = _dates(cells, time.format)
    bad = (cells.notna() & stamps.isna()).to_numpy(dtype=bool)
    row = int(np.argmax(bad))
    if 0 < bad.mean() <= MAX_ODD and time.format is None:
        text = f"cells that are no dates are left empty, {bad.sum()} of {len(bad)} in {' and '.join(names)}"
        table.notes.append(f"{text}: '{cells.iloc[row][:40]}' in {in_words(table.place(row))}")
    elif bad.any():
        text = f"'{cells.iloc[row][:40]}' is neither a number nor a date or time that is known"
        formats = " or ".join(map(repr, date_formats(cells))) or EXAMPLE
        hint = f"state how it is written under 'time:' of the mapping, as in format: {formats}{MISSING_HINT}"
        raise InputError(text, file=path, column=" and ".join(names), hint=hint, **table.place(row))
    if stamps.dtype.kind == "m":
        return stamps.dt.total_seconds().to_numpy(dtype=float)
    return stamps.dt.tz_localize(None).to_numpy(dtype="datetime64[ns]")


def _join_cells(parts: list[NDArray[Any]]) -> Any:
    """Return the text of the cells of several columns, joined by blanks."""
    import pandas as pd

    # Write whole numbers without a decimal point, before they are joined with the text of another column.
    columns = [pd.Series(part).convert_dtypes().astype("string").str.strip() for part in parts]
    return columns[0].str.cat(columns[1:], sep=" ") if columns[1:] else columns[0]


def _dates(cells: Any, form: str | None) -> Any:
    """Return the dates or times of day in cells; a cell of another form becomes missing.

    If ``form`` is not given, the cells hold times of day or dates in the format ISO 8601. Seconds may have a
    fraction or none.
    """
    import pandas as pd

    read = partial(pd.to_datetime, errors="coerce", utc=True)
    if form is not None:
        stamps = read(cells, format=form)
        return stamps.fillna(read(cells.where(stamps.isna()), format=re.sub(r"\W%f", "", form)))
    plain = cells.str.replace(",", ".", regex=False)
    of_day = plain.str.fullmatch(_TIME_OF_DAY)
    if of_day.mean() > 0.5:
        minutes = plain.where(of_day).str.replace(r"^(\d+:\d+)$", r"\1:00", regex=True)
        return pd.to_timedelta(minutes, errors="coerce")
    return read(plain, format="ISO8601")


def date_formats(cells: Any) -> list[str]:
    """Return the formats for ``strptime`` that fit most cells: with the day first, and with the month first.

    >>> import pandas as pd
    >>> date_formats(pd.Series(["12/06/2018 23:59:40.5", "13/06/2018 0:00:00"]))
    ['%d/%m/%Y %H:%M:%S.%f']
    """
    cell = max(map(str, cells.dropna()), key=len, default="")
    hit = re.match(
        r"\d{1,2}(?P<mark>\W)(\d{1,2}|(?P<month>[A-Za-z]{3}))(?P=mark)(?P<year>\d{4}|\d\d)\b", cell
    )
    if hit is None:
        return []
    clock = re.sub(r"\d{1,2}:\d\d", "%H:%M", cell[hit.end() :], count=1)
    clock = re.sub(r"(?<=%M):\d\d", ":%S", clock)
    clock = re.sub(r"(?<=%S)(\W)\d+", r"\1%f", clock)
    if re.search("[AaPp][Mm]", clock):
        clock = re.sub("[AaPp][Mm]", "%p", clock).replace("%H", "%I")
    orders = [("%d", "%b")] if hit["month"] else [("%d", "%m"), ("%m", "%d")]
    year = "%Y" if len(hit["year"]) == 4 else "%y"
    formats = [hit["mark"].join([*order, year]) + clock for order in orders]
    return [form for form in formats if _dates(cells, form).notna().mean() > 1 - MAX_ODD]


# ---------------------------------------------------------------- rows in order

#: A late sample has an earlier time than the sample before. LATE_SHARE is the maximum fraction of late
#: samples, if their times do not fit into gaps of the record. LATE_RUN is the maximum number of late samples
#: in sequence. If there are more, the clock is taken to have been reset.
LATE_SHARE, LATE_RUN = 0.01, 20
#: Minimum time between a late sample that fits into a gap and its neighbours in the gap, in time steps.
MIN_DISTANCE = 0.5
#: Text of the import summary for each kind of row that is left out or moved. A number precedes this text.
ODD_ROWS = {
    "unfilled": "rows at the end, which repeat one row without a later time, are left out",
    "untimed": "rows without a time are left out",
    "misdated": "rows with a time far from all other times are left out",
    "repeated": "repeated rows are left out",
    "clashing": "rows with the time of the row before but other values are left out",
    "late": "late rows are sorted by their time",
}


@dataclass(frozen=True)
class Order:
    """Order of the rows of a record by their times, and numbers of rows that were left out or moved.

    Attributes
    ----------
    index : ndarray of int, shape (m,)
        Numbers of the rows that are kept, sorted by time.
    counts : dict of str to int
        Number of rows of each kind in :data:`ODD_ROWS`. Five kinds are left out: rows at the end that were
        never filled, rows without a time, single rows with a time far from all others, rows equal to an
        earlier row at the same time, and rows with other values at the time of an earlier row. Rows that
        follow a row with a later time are moved to the place of their time.
    reset_row : int or None
        Row at which the clock was reset, or None. A record with a reset clock cannot be sorted by time.
    """

    index: NDArray[np.int64]
    counts: dict[str, int]
    reset_row: int | None = None

    @property
    def summary(self) -> str:
        """Message on the numbers of rows that are left out or moved, by reason; empty if there are none."""
        return "; ".join(f"{count} {ODD_ROWS[name]}" for name, count in self.counts.items() if count)


def in_order(time_s: Array, columns: abc.Mapping[str, Array]) -> Order:
    """Return the order in which the rows of a record have strictly increasing times.

    Parameters
    ----------
    time_s : ndarray, shape (n,)
        Times, s, which may be NaN, repeat, or go back.
    columns : mapping of str to ndarray, each shape (n,)
        All other columns. These columns decide whether a row at the time of an earlier row is equal to that
        row or contradicts it.

    Notes
    -----
    Single rows that arrive late (packets on a network) are moved to the place of their time. A clock that
    goes back and counts on from the earlier time was reset. In that case the rows are not sorted, because the
    log does not show which times are right. Rows at the end that were never filled, such as those of a file
    that was created with its full length, hold one value each: missing or 0.
    """
    length = len(time_s)
    if length and not time_s[-1] >= np.fmax.reduce(time_s):
        rows = np.column_stack([time_s, *columns.values()])
        is_last = np.isclose(rows, rows[-1], rtol=0.0, atol=0.0, equal_nan=True).all(axis=1)
        length = int(np.max(np.flatnonzero(~is_last), initial=-1)) + 1
        length += length == len(time_s) - 1  # a single row does not count as an unfilled part
    index = np.flatnonzero(np.isfinite(time_s[:length]))
    wrong = _find_wrong_times(time_s[index])
    index, times = index[~wrong], time_s[index[~wrong]]
    counts = dict.fromkeys(ODD_ROWS, 0) | {"unfilled": len(time_s) - length, "untimed": length - len(wrong)}
    counts["misdated"] = int(wrong.sum())
    if np.all(np.diff(times) > 0):
        return Order(index, counts)
    behind = times < np.maximum.accumulate(times)
    late = counts["late"] = int(behind.sum())
    ranked = np.sort(times)
    beside = np.minimum(np.diff(ranked, prepend=-np.inf), np.diff(ranked, append=np.inf))
    far = beside[np.searchsorted(ranked, times[behind])] > MIN_DISTANCE * np.median(np.abs(np.diff(times)))
    most = max(1, LATE_SHARE * len(times))
    if (late > most and far.mean() < UNIFORM_SHARE) or log.longest_run(behind) > LATE_RUN:
        return Order(index, counts, int(index[np.argmax(behind)]))
    import pandas as pd

    rows = pd.DataFrame({**columns, TIME: time_s}).iloc[index].sort_values(TIME, kind="stable")
    again, counts["repeated"] = rows.duplicated(TIME), int(rows.duplicated().sum())
    counts["clashing"] = int(again.sum()) - counts["repeated"]
    return Order(rows.index[~again].to_numpy(), counts)


def _find_wrong_times(times: Array) -> NDArray[np.bool_]:
    """Return flags of single times, s, far before the first or after the last, between rows in order.

    Such times are corrupt. A row that only arrives late has a time close to the times of other rows.
    """
    none = np.zeros(len(times), dtype=bool)
    if len(times) < LATE_RUN:
        return none
    margin = LATE_RUN * np.median(np.abs(np.diff(times)))
    wrong = (times < times[[0, -1]].min() - margin) | (times > times[[0, -1]].max() + margin)
    if log.longest_run(wrong) > 1 or wrong.sum() > max(1, LATE_SHARE * len(times)):
        return none
    return wrong


# ---------------------------------------------------------------- draft of a mapping

#: Patterns of words in the name of a column with a unit of time. They show that the column holds clock times
#: (_OF_CLOCK), or that it holds intervals between events.
_OF_CLOCK = re.compile(
    r"\b(t|ts|tt|times?|(time)?stamps?|clock|millis|micros|elapsed|epoch|uptime|utc|s|secs?|ms|us|zeit|temps|"
    r"tiempo|tempo|tid|tijd)\b"
)
_OF_INTERVAL = re.compile(
    r"\b(period|duration|latency|delay|lag|lead|dt|delta|diff|pulse|pwm|width|duty|exposure|shutter|rtt|ping|"
    r"echo|tof|flight|response|reaction|rise|fall|settling|dead|loop|cycle|step|interval|jitter|processing)\b"
)
#: Comment in a draft on a column that may hold a compass heading, and pattern of the names of such columns.
OF_COMPASS = "; yaw_rad is counter-clockwise from x: a compass heading has factor: -1, offset: 1.5708"
COMPASS = re.compile(r"heading|compass|course|bearing|azimuth|direction|(?<![a-z])(cog|hdg)(?![a-z])")

_XYZ = r"[ _.\[]*(?P<axis>[xyz])\]?"
#: Target column of the log for each name of a foreign column that states a quantity but no unit. The names
#: are patterns, which must match the whole name in lower case.
_NAMES: list[tuple[str, str]] = [
    (r"(lin(ear)?[ _.]*)?a(cc(el(eration|erometer)?)?)?" + _XYZ, "a{axis}_m_s2"),
    (r"(gyr(o(scope)?)?|ang(ular)?[ _.]?(vel(ocity)?|rate)|omega|w|g)" + _XYZ, "w{axis}_rad_s"),
    (r"mag(net(ometer|ic)?([ _]field)?)?" + _XYZ, "m{axis}_T"),
    (r"(quat(ernion)?|q)[ _.\[]*(?P<axis>[wxyz])\]?", "q{axis}"),
    (r"(pos(ition)?|location)" + _XYZ, "{axis}_m"),
    (r"(vel(ocity)?|speed)" + _XYZ, "v{axis}_m_s"),
    (r"surge[ _.]?(vel(ocity)?|speed)", "u_m_s"),
    (r"sway[ _.]?(vel(ocity)?|speed)", "v_m_s"),
    (r"heave[ _.]?(vel(ocity)?|speed)", "w_m_s"),
    (r"(?P<axis>roll|pitch|yaw)[ _.]?(rate|vel(ocity)?|speed)", "{axis}_rate_rad_s"),
    (r"(?P<axis>roll|pitch|yaw)", "{axis}_rad"),
    (r"(?P<axis>roll|pitch|yaw)", "{axis}_rate_rad_s"),
    (r"(net[ _.]?)?force|thrust|load[ _.]?cell", "force_N"),
    (r"j(oint)?[ _.]?(angle)?[ _.\[]*(?P<axis>\d+)\]?", "joint{axis}_rad"),
    (r"(cmd|command|setpoint)[ _.\[]*(?P<axis>\d+)\]?", "cmd{axis}_rad"),
]
_UNIT = re.compile(r"(?P<bare>.*?)[ _]*(?:[\[(](?P<inside>[^\])]+)[\])]|/ ?(?P<over>[^\d\s]\S*))\s*")
#: Pattern of a column name that ends in a unit, such as ``heading_deg`` or ``x mm``.
_ENDING = re.compile(r"(?P<bare>.+?)[ _](?P<unit>[A-Za-z°µ/]+(?:_s2?)?)")


class Draft(Text):
    """Draft of a mapping, which ``guess_mapping`` returns. Its ``document`` is YAML text with comments."""

    next_step = "swimid import {data[file]} --map {file} -o {free[run.csv]}"

    @property
    def mapping(self) -> Mapping:
        """Mapping that the draft contains, for ``import_log`` and ``track_imu``.

        Raises
        ------
        InputError
            A value is still ``ASK``.
        """
        return read_mapping(yamlio.parse_scalar(self.document))


@takes(ImportOptions)
def guess_mapping(source: LogLike, *, options: ImportOptions, output: str | Path | None = None) -> Draft:
    """Draft a mapping that converts a foreign log to the log format.

    The draft states the values that follow from a profile, from the name of a column or from a stated unit.
    All other values are ``ASK``, with the first values of the column in a comment. A mapping with ``ASK`` is
    refused. Nothing is inferred from the magnitude of the values.

    Parameters
    ----------
    source : path, DataFrame or Log
        Foreign log. A table has shape (n, k), one row per sample.
    output : path, optional
        Path of the mapping file. Without a path nothing is written.

    Returns
    -------
    Draft
        ``.document`` holds the text of the mapping file, ``.mapping`` the mapping in memory.

    Raises
    ------
    InputError
        The file cannot be read.

    Notes
    -----
    The draft contains the values of these options of ``import``: format, selection, frame rate, unit of
    length and minimum likelihood.

    Examples
    --------
    >>> import pandas as pd
    >>> draft = guess_mapping(pd.DataFrame({"Time (ms)": [0, 20, 40], "Yaw [deg]": [1.0, 1.5, 1.2]}))
    >>> [(c.source, c.target, c.unit) for c in draft.mapping.columns]
    [('Yaw [deg]', 'yaw_rad', 'deg')]
    """
    given = log.unread(source)
    path = path_of(given)
    unit, select = options.length_unit, options.select
    table = open_table(
        given, ReaderOptions(bad_lines="skip", length_unit=unit), select, options.profile or ""
    )
    lines = [
        f"# Drafted from {path.name} by swimid import --guess. Answer or delete every line with {ASK};",
        "# an axis may be swapped or flipped (factor: -1), which no name states.",
        f"format: {FORMAT}",
    ]
    lines += [f"# {path.name}: {note}" for note in table.notes]
    if select is not None or "topic" in table.metadata:
        lines.append(_line("select", select or table.metadata["topic"]))
    stated = {"reader": unit and {"length_unit": unit}, "min_likelihood": options.min_likelihood}
    if table.profile not in ("", "swimid"):
        lines += [_line(key, value) for key, value in stated.items() if value]
        lines += _of_profile(table)
    else:
        lines += _of_names(table)
    text = "".join(re.sub(r"[\r\n]", " ", line) + "\n" for line in lines)
    if options.rate_hz is not None:
        text = text.replace(f"rate_hz: {ASK}", f"rate_hz: {options.rate_hz:.10g}")
    asked = sum(ASK in line.partition("#")[0] for line in text.split("\n"))
    data = {"file": str(path), "mapping": text, "open": asked}
    if output is None:
        return Draft("import", text.rstrip("\n"), data, document=text)
    todo = f"answer the {asked} lines with {ASK}" if asked else "look at every line"
    said = f"{path.name}: mapping drafted; {todo} of {output}"
    return Draft("import", said, data, document=text).write_output(output)


def _of_profile(table: ForeignTable) -> list[str]:
    """Return the lines of a drafted mapping for a file whose format has a profile."""
    lines = [f"as: {table.profile}"]
    if TIME not in table.columns:
        lines.append(_line("time", {"rate_hz": ASK}, "frames per second of the film"))
    names = [name for name in table.columns if name not in (TIME, "frame")]
    return [*lines, f"# columns of the log, which 'columns:' may choose and rename: {', '.join(names)}"]


def _of_names(table: ForeignTable) -> list[str]:
    """Return the lines of a drafted mapping for a file without a profile.

    The lines follow from the column names and the stated units.
    """
    usual = max((len(v) for v in table.columns.values()), default=0)
    columns = {key: values for key, values in table.columns.items() if len(values) == usual}
    asked = table.asked | _convert_asked(columns)
    time, forms = _guess_time(table, columns)
    taken: list[str] = []
    if isinstance(time, dict):
        taken = np.atleast_1d(time.get("source") or time["frame"]).tolist()
    lines = [_line("reader", dict.fromkeys(asked, ASK), "; ".join(asked.values()))] * bool(asked)
    lines += [_line("time", time, forms), "columns:"]
    for source, values in columns.items():
        if source in taken:
            continue
        target, unit = name_target(source, table.units.get(source))
        if is_text(values) or values.dtype.kind == "M" or not np.isfinite(values.astype(float)).any():
            left_out = _line("-", {"source": source, "target": "..."}, f"no numbers: {_first(values)}")
            lines.append(f"  # {left_out}")
            continue
        entries, comment = {"source": source, "target": target, "unit": unit}, _first(values)
        if COMPASS.search(source.lower()):
            comment += OF_COMPASS
        lines.append("  " + _line("-", entries, comment))
    lines.append("metadata: {}   # robot: ..., frequency_hz: ... (of the stroke, if known)")
    return lines


def _convert_asked(columns: dict[str, NDArray[Any]]) -> dict[str, str]:
    """Convert columns of text in which numbers prevail, in place; return the options that a user must state.

    The result maps each option of the reader to the reason why it is needed.
    """
    asked: dict[str, str] = {}
    for name in [name for name, values in columns.items() if is_text(values)]:
        found, odd = numbers_in(columns[name])
        texts = columns[name][odd].astype(str)
        if any(re.fullmatch(GROUPED, text) for text in texts):
            asked.setdefault("decimal", f"the decimal mark, for cells such as '{texts[0]}' in '{name}'")
            found = numbers_in([str(cell).replace(",", "") for cell in columns[name]])[0]
        elif odd.sum() < np.isfinite(found).sum():
            asked.setdefault("missing", f"the texts of missing samples, as in ['{texts[0]}'] in '{name}'")
        else:
            continue
        columns[name] = found
    return asked


def _line(key: str, value: Any, comment: str = "") -> str:
    """Return a line of YAML, ``key: value # comment``.

    If the key is a dash, the line is an item of a list.
    """
    text = _write_value(key, value)
    if isinstance(value, dict):
        entries = [f"{name}: {_write_value(name, v)}" for name, v in value.items() if v is not None]
        text = f"{{{', '.join(entries)}}}"
    start = f"{key}:".replace("-:", "-")
    if comment:
        text += f"   # {comment}"
    return f"{start} {text}"


def _write_value(key: str, value: Any) -> str:
    """Return the value of a key in a drafted mapping as YAML text.

    Names and units of the file are in quotes. Column numbers and keywords are not.
    """
    if value == ASK or key in ("target", "origin") or (key in ("source", "frame") and str(value).isdecimal()):
        return str(value)
    return json.dumps(value, ensure_ascii=False)


def name_target(source: str, written: str | None = None) -> tuple[str, str | None]:
    """Return the target column and the unit that follow from a foreign column's name and stated unit.

    An unknown target column or unit is ``ASK``. The unit is None for a column of the log format.

    >>> name_target("Yaw [deg]"), name_target("accX"), name_target("x_m"), name_target("level (mm)")
    (('yaw_rad', 'deg'), ('ax_m_s2', 'ASK'), ('x_m', None), ('level_m', 'mm'))
    """
    name = source.strip()
    if re.fullmatch(r"[A-Za-z]\w*", name, re.A) and states_quantity(name) and not written:
        return name, None
    bare, unit = _split(name)
    unit = canonical(written or unit or "")
    if unit not in KNOWN:
        unit = None
    target = _target(bare.strip(" _.").lower(), unit)
    if target is not None and quantity_of(target) is None:
        return target, unit
    return target or ASK, unit or ASK


def _split(name: str) -> tuple[str, str | None]:
    """Return the name of a column without its unit, and the unit, or None if the name states no unit."""
    if hit := _UNIT.fullmatch(name):
        return hit["bare"], hit["inside"] or hit["over"]
    if (hit := _ENDING.fullmatch(name)) and not COMPOUND.fullmatch(hit["bare"]):
        unit = canonical(re.sub(r"(?<=.)_(s2?)$", r"/\1", hit["unit"]))
        if unit in KNOWN:
            return hit["bare"], unit
    return name, None


def _target(bare: str, unit: str | None) -> str | None:
    """Return the log column for a foreign column name (without its unit) and unit; None if unknown."""
    targets = [
        target.format(**hit.groupdict()) for pattern, target in _NAMES if (hit := re.fullmatch(pattern, bare))
    ]
    if targets:
        fitting = [name for name in targets if unit is None or unit in UNITS.get(quantity_of(name) or "", {})]
        return next(iter(fitting), None)
    if unit is None or bare == "" or COMPASS.search(bare):
        return None
    # Derive the quantity from the unit, if no other quantity has this unit.
    quantities = [quantity for quantity, table in UNITS.items() if unit in table]
    word = re.sub(r"[^a-z0-9]+", "_", bare).strip("_")
    if len(quantities) != 1 or not word[:1].isalpha():
        return None
    return f"{word}_{next(iter(UNITS[quantities[0]])).replace('/', '_')}"


def _guess_time(table: ForeignTable, columns: dict[str, Any]) -> tuple[dict[str, Any] | str, str]:
    """Return the value of ``time:`` for a drafted mapping, and a comment.

    The value contains what column names and units state. The name of the column must be that of a clock,
    because a pulse or a delay also has a unit of time.
    """
    comment = "{source: ..., unit: ...}, {frame: ..., rate_hz: ...} or {rate_hz: ...}"
    stated = {name: _unit_of_time(name, table.units.get(name)) for name in columns}
    stamps = [name for name in columns if _is_clock(name, stated[name])]
    # Prefer the time stamp of the sensor (in the message header) to the time stamp of the recorder.
    stamps.sort(key=lambda name: "header" not in name.lower())
    counts = [name for name in columns if COUNT.fullmatch(name.strip().lower())]
    if TIME in columns:
        return {"source": TIME, "unit": "s"}, comment
    if stamps and is_text(columns[stamps[0]]):
        return _guess_dates({name: columns[name] for name in stamps if is_text(columns[name])}, comment)
    if stamps and columns[stamps[0]].dtype.kind == "M":
        return {"source": stamps[0], "origin": "first"}, comment
    if stamps:
        return {"source": stamps[0], "unit": stated[stamps[0]]}, comment
    if counts:
        return {"frame": counts[0], "rate_hz": ASK}, comment
    return ASK, comment


def _guess_dates(columns: dict[str, Any], comment: str) -> tuple[dict[str, Any], str]:
    """Return the value of ``time:`` for columns of text that form one date, and a comment on its format."""
    names = list(columns)
    time: dict[str, Any] = {"source": names if len(names) > 1 else names[0], "origin": "first"}
    cells = _join_cells(list(columns.values()))
    if _dates(cells, None).notna().mean() < (1 - MAX_ODD) * cells.notna().mean():
        formats = date_formats(cells)
        time["format"] = formats[0] if len(formats) == 1 else ASK
        comment = f"as in format: {' or '.join(map(repr, formats)) or EXAMPLE}"
    return time, comment


def _is_clock(name: str, unit: str) -> bool:
    """Return whether the name of a column says that it holds the times of the samples.

    ``unit`` is the unit of time that the name or the file states, or ``ASK``.
    """
    bare = _split(name.strip())[0]
    words = " ".join(re.findall(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])", bare)).lower()
    if _OF_INTERVAL.search(words):
        return False
    if unit == ASK:
        return words == "t" or OF_TIME.fullmatch(bare) is not None
    return not words or _OF_CLOCK.search(words) is not None or OF_TIME.fullmatch(bare) is not None


def _unit_of_time(name: str, written: str | None) -> str:
    """Return the unit that the name of a time column states; ``ASK`` if the name states no unit."""
    units_stated = (name_target(name, written)[1], canonical(name))
    return next((unit for unit in units_stated if unit in UNITS["time"]), ASK)


def _first(values: Any) -> str:
    """Return the first three values of a column as text, for a comment in a drafted mapping."""
    if values.dtype.kind == "f":
        return ", ".join(f"{value:.6g}" for value in values[:3])
    return ", ".join(str(value)[:30] for value in values[:3])
