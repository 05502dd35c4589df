"""The mapping of a foreign log to the log format (``swimid-mapping/1``, ``docs/import.md``).

Says which source column becomes which target column, and in which unit it was written.
:func:`apply` gives the target columns in SI as they are in the file: time may still repeat,
jump back or be missing.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, PositiveFloat, field_validator, model_validator

from swimid.errors import InputError, nearest
from swimid.files import yamlio
from swimid.files.provenance import path_of
from swimid.logs import units
from swimid.logs.foreign import Options, Source, open_source
from swimid.logs.log import TIME, Log, metadata_of, written_by
from swimid.progress import Progress, silent

FORMAT: Literal["swimid-mapping/1"] = "swimid-mapping/1"
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")

#: A column by its name in the file, or by its number from 1.
ColumnKey = Annotated[str | int, Field(union_mode="left_to_right")]


class Time(yamlio.Document):
    """Where the sample times come from: a column, or a constant rate."""

    source: ColumnKey | None = None
    unit: str = "s"
    #: Constant rate, Hz, where no column holds the time; or the name of a number in the file.
    rate_hz: PositiveFloat | str | None = None
    #: ``keep`` the file's own clock, count from the ``first`` sample, or take off so many seconds.
    origin: Literal["keep", "first"] | float = "keep"

    @model_validator(mode="after")
    def _one_way(self) -> Time:
        if (self.source is None) == (self.rate_hz is None):
            raise ValueError("give either 'source' (a column) or 'rate_hz'")
        units.factor(self.unit, TIME)
        return self


class Column(yamlio.Document):
    """One column: ``target = source * (unit's factor) * factor + offset``."""

    source: ColumnKey
    target: str
    #: Unit the source is written in, converted to that of the target's name.
    unit: str | None = None
    factor: float = 1.0
    #: In the target's unit.
    offset: float = 0.0

    @field_validator("target")
    @classmethod
    def _plain_name(cls, value: str) -> str:
        if not _NAME.fullmatch(value):
            raise ValueError(f"'{value}' must be letters, digits and underscores, as in x_m")
        return value

    @model_validator(mode="after")
    def _unit_fits(self) -> Column:
        if self.factor == 0:
            raise ValueError("a factor of 0 leaves nothing of the column")
        if self.unit is not None:
            units.factor(self.unit, self.target)
        return self

    @property
    def scale(self) -> float:
        """Factor from the source to the target."""
        return self.factor * (1.0 if self.unit is None else units.factor(self.unit, self.target))


class Mapping(yamlio.Document):
    """A mapping file."""

    format: Literal["swimid-mapping/1"]
    reader: Options = Options()
    time: Time | None = None
    columns: Annotated[list[Column], Field(min_length=1)]
    #: Added to the log's metadata.
    metadata: dict[str, str | float | int | bool | list[str | float | int]] = {}

    @model_validator(mode="after")
    def _consistent(self) -> Mapping:
        targets = [column.target for column in self.columns]
        twice = next((name for name in targets if targets.count(name) > 1), None)
        if twice:
            raise ValueError(f"two columns have the target '{twice}'")
        if (self.time is None) == (TIME not in targets):
            raise ValueError(f"give the time once: as 'time:', or as a column with the target {TIME}")
        if targets == [TIME]:
            raise ValueError("maps the time alone")
        return self

    @property
    def name(self) -> str:
        """What the provenance of a result calls a mapping that is no file."""
        return "mapping"


@dataclass(frozen=True)
class MappedLog:
    """A foreign log in target columns, not yet cleaned.

    Attributes
    ----------
    path : Path
        Where it was read.
    columns : dict of str to ndarray, each shape (n,)
        Target columns in SI, NaN where missing; ``t_s`` first. Times may repeat, jump back or
        be missing.
    rows : ndarray of int, shape (n,)
        Line of each sample in a text file, else its row, from 1.
    metadata : dict
        The file's own and the mapping's.
    notes : list of str
        What a user should know of how it was read.
    """

    path: Path
    columns: dict[str, NDArray[np.float64]]
    rows: NDArray[np.int64]
    metadata: dict[str, Any] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)

    @property
    def time_s(self) -> NDArray[np.float64]:
        """Sample times as they stand in the file, s, shape (n,)."""
        return self.columns[TIME]

    def __len__(self) -> int:
        return len(self.rows)


def of(given: str | Path | Mapping | dict[str, Any]) -> Mapping:
    """The mapping that was handed over: a file, an object, or a dictionary with the keys of the file.

    Raises
    ------
    InputError
        With line and key of what is wrong in it.
    """
    if isinstance(given, Mapping):
        return given
    if isinstance(given, dict):
        return yamlio.validate({"format": FORMAT} | given, Mapping, "mapping")
    return yamlio.validated(given, Mapping)


def apply(mapping: Mapping | None, given: str | Path | Log, *, progress: Progress = silent) -> MappedLog:
    """Read a foreign log through a mapping; without one its columns must have the names of the log format.

    Parameters
    ----------
    mapping : Mapping or None
    given : path or Log
        The foreign log; in memory its columns as they are (:func:`swimid.logs.log.unread`).
    progress : Progress
        Shows how far the file is read.

    Raises
    ------
    InputError
        The file cannot be read, has no such column, or holds what is no number; names file,
        line and column.
    """
    path = path_of(given)
    source = open_source(given, None if mapping is None else mapping.reader)
    try:
        mapped = _mapped(_identity(source, path) if mapping is None else mapping, path, source, progress)
    finally:
        source.close()
    text = [column.name for column in source.columns if column.kind != "number"]
    if mapping is None and text and not written_by(mapped.metadata, "swimid"):
        mapped.notes.append(f"columns of text left out: {', '.join(text)}")
    return mapped


def _identity(source: Source, path: Path) -> Mapping:
    """The mapping of a log whose columns have the names of the log format already."""
    names = [column.name for column in source.columns]
    if TIME not in names:
        raise InputError(
            "this column is missing",
            file=path,
            column=TIME,
            hint=f"a mapping says which column is which (swimid import --guess writes one); "
            f"the file has: {', '.join(names[:20])}",
        )
    numbers = [column.name for column in source.columns if column.kind == "number"]
    wanted = [TIME, *(name for name in numbers if name != TIME and _NAME.fullmatch(name))]
    if wanted == [TIME]:
        raise InputError("holds no column of numbers beside the time", file=path)
    return Mapping(format=FORMAT, columns=[Column(source=name, target=name) for name in wanted])


def _mapped(mapping: Mapping, path: Path, source: Source, progress: Progress) -> MappedLog:
    time = mapping.time
    sources = {column.target: _resolve(column.source, source, path) for column in mapping.columns}
    if time is not None and time.source is not None:
        sources = {TIME: _resolve(time.source, source, path), **sources}
    rate = _rate(time.rate_hz, source, path) if time is not None and time.rate_hz is not None else None
    _same_length(sources, source, path)
    pieces: dict[str, list[NDArray[Any]]] = {target: [] for target in sources}
    with progress(f"reading {path.name}", total=source.steps) as step:
        for chunk in source.chunks(list(dict.fromkeys(sources.values())), step):
            for target, name in sources.items():
                pieces[target].append(_numbers(chunk[name], name, mapping.reader.missing, path))
    count = sum(len(piece) for piece in next(iter(pieces.values())))
    if count == 0:
        raise InputError("holds no samples", file=path)
    lines = source.lines(count)
    own = {key: _short(value) for key, value in source.metadata.items()}
    metadata = {**metadata_of(source.comments, path, strict=False), **own, **mapping.metadata}
    columns: dict[str, NDArray[np.float64]] = {}
    if rate is not None:
        columns[TIME] = np.arange(count) / rate
    elif time is not None:
        columns[TIME] = _seconds(np.concatenate(pieces.pop(TIME)), time, metadata)
    by_target = {column.target: column for column in mapping.columns}
    for target in sorted(pieces, key=lambda name: name != TIME):
        whole = np.concatenate(pieces.pop(target))
        if whole.dtype.kind == "M" and target != TIME:
            raise InputError("holds dates, not numbers", file=path, column=sources[target])
        dates = whole.dtype.kind == "M"
        columns[target] = epoch_seconds(whole) if dates else _converted(whole, by_target[target])
    infinite = [name for name, values in columns.items() if _without_infinity(values)]
    told = [f"infinite values taken as missing in {', '.join(infinite)}"] if infinite else []
    rows = np.arange(1, count + 1, dtype=np.int64) if lines is None else lines
    return MappedLog(path, columns, rows, metadata, [*source.notes, *told])


def _short(value: Any) -> Any:
    """A remark of the file as one line."""
    return value.strip().splitlines()[0][:120] if isinstance(value, str) and value.strip() else value


def _resolve(key: str | int, source: Source, path: Path) -> str:
    """The name of the column a mapping means."""
    kinds = {column.name: column.kind for column in source.columns}
    names = list(kinds)
    if isinstance(key, str) and key in kinds:
        name = key
    elif isinstance(key, int) or key.isdecimal():
        if not 1 <= int(key) <= len(names):
            raise InputError(f"has {len(names)} columns, no column {key}", file=path)
        name = names[int(key) - 1]
    else:
        loose = [name for name in names if name.strip().lower() == key.strip().lower()]
        if len(loose) != 1:
            close = nearest(key, names)
            hint = f"did you mean '{close}'?" if close else f"the file has: {', '.join(names[:30])}"
            raise InputError("there is no such column", file=path, column=key, hint=hint)
        name = loose[0]
    if kinds[name] == "text":
        raise InputError("holds text, not numbers", file=path, column=name)
    return name


def _rate(given: float | str, source: Source, path: Path) -> float:
    if not isinstance(given, str):
        return given
    if given not in source.scalars:
        hint = f"single numbers in it: {', '.join(source.scalars) or 'none'}"
        raise InputError(f"holds no number '{given}' for the rate", file=path, hint=hint)
    rate = source.scalars[given]
    if not (np.isfinite(rate) and rate > 0):
        raise InputError(f"its rate '{given}' is {rate:g} Hz", file=path)
    return rate


def _same_length(sources: dict[str, str], source: Source, path: Path) -> None:
    known = {column.name: column.rows for column in source.columns}
    lengths = {name: known[name] for name in sources.values() if known[name] is not None}
    if len(set(lengths.values())) > 1:
        text = ", ".join(f"{name} {rows}" for name, rows in lengths.items())
        raise InputError(
            f"the columns have different numbers of samples: {text}",
            file=path,
            hint="map those of one length; logs of several rates are imported one by one",
        )


def _numbers(values: NDArray[Any], name: str, missing: Sequence[float | str], path: Path) -> NDArray[Any]:
    """Numbers or dates of one piece, markers of missing samples made NaN."""
    if values.dtype.kind not in "iufbM":
        try:
            values = values.astype(float)
        except (TypeError, ValueError) as error:
            raise InputError(f"holds what is no number: {error}", file=path, column=name) from error
    marks = [mark for mark in missing if isinstance(mark, int | float)]
    if marks and values.dtype.kind != "M":
        values = np.where(np.isin(values, np.asarray(marks, dtype=values.dtype)), np.nan, values)
    return values


def _seconds(values: NDArray[Any], time: Time, metadata: dict[str, Any]) -> NDArray[np.float64]:
    """Times in s; the origin is taken off before whole numbers become floating ones."""
    if values.dtype.kind == "M":
        factor, known = 1e-9, ~np.isnat(values)
        numbers = np.where(known, values.astype("datetime64[ns]").astype(np.int64), 0)
    else:
        factor, known = units.factor(time.unit, TIME), np.isfinite(values)
        numbers = values
    if time.origin == "first" and known.any():
        first = numbers[int(np.argmax(known))]
        seconds = (numbers - first) * factor
        metadata.setdefault("first_stamp_s", float(first) * factor)
    else:
        seconds = numbers * factor - (0.0 if isinstance(time.origin, str) else time.origin)
    return seconds if known.all() else np.where(known, seconds, np.nan)


def epoch_seconds(values: NDArray[Any]) -> NDArray[Any]:
    """Dates as seconds since 1970, NaN where missing; numbers as they are."""
    return _seconds(values, Time(source=1), {}) if values.dtype.kind == "M" else values


def _converted(values: NDArray[Any], column: Column) -> NDArray[np.float64]:
    numbers = values.astype(np.float64, copy=False)
    if column.scale != 1.0:
        numbers = np.multiply(numbers, column.scale, out=numbers if numbers.flags.writeable else None)
    return numbers + column.offset if column.offset else numbers


def _without_infinity(values: NDArray[np.float64]) -> bool:
    """Make infinite values missing, in place; whether there were any."""
    if not np.isinf((np.fmin.reduce(values), np.fmax.reduce(values))).any():
        return False
    values[np.isinf(values)] = np.nan
    return True
