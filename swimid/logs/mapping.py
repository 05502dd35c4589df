"""The mapping of a foreign log to the log format (``swimid-mapping/1``, ``docs/import.md``).

A mapping says which source column becomes which target column, and in which unit it was written.
:func:`apply` returns the target columns in SI in the order of the file: its times may still repeat, go back
or be missing.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, field_validator, model_validator

from swimid.errors import InputError
from swimid.files import yamlio
from swimid.files.delimited import number_hint
from swimid.files.provenance import path_of
from swimid.logs import clock, instances, likelihood, profiles, units
from swimid.logs.choices import Choices
from swimid.logs.clock import Time
from swimid.logs.foreign import open_table
from swimid.logs.foreign.base import Options, Table, is_text
from swimid.logs.log import TIME, Log, metadata_of, written_by
from swimid.logs.rotation import AXES, rearranged
from swimid.logs.stated import ColumnKey, Stated
from swimid.notices import warn
from swimid.progress import Progress, silent

Array = NDArray[np.float64]
FORMAT: Literal["swimid-mapping/1"] = "swimid-mapping/1"
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
#: Unit of a quantity without a dimension.
NO_UNIT = "1"


class Column(Stated):
    """One column: ``target = source * (factor of the unit) * factor + offset``."""

    source: ColumnKey
    target: str
    #: Unit of the source, converted to that of the target's name; ``1`` for a quantity without a dimension.
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
        if self.unit not in (None, NO_UNIT):
            units.factor(self.unit, self.target)
        return self

    @property
    def scale(self) -> float:
        """Factor from the source to the target."""
        unit = 1.0 if self.unit in (None, NO_UNIT) else units.factor(str(self.unit), self.target)
        return self.factor * unit

    @property
    def known(self) -> bool:
        """Whether its quantity is stated: by the name of the target, or as a number without a dimension."""
        return self.unit == NO_UNIT or units.is_known(self.target)


class Quaternion(Stated):
    """Convention of the attitude quaternion in the file."""

    order: Literal["wxyz", "xyzw"] = "wxyz"
    direction: Literal["body-to-world", "world-to-body"] = "body-to-world"


class Mapping(Stated):
    """A mapping file."""

    format: Literal["swimid-mapping/1"]
    #: Name of a profile, for a file of a known format.
    profile: str | None = Field(default=None, alias="as")
    #: Track, instance, topic or message type to take, for a profile.
    select: str | int | None = None
    #: Unit of lengths, for a profile whose file states none.
    length_unit: str | None = None
    #: A tracked point with a likelihood below this is left empty.
    min_likelihood: Annotated[float, Field(ge=0, le=1)] = likelihood.MIN_LIKELIHOOD
    reader: Options = Options()
    time: Time | None = None
    #: Rows to take: by column the value, or values, they have there.
    where: dict[str, str | float | int | list[str | float | int]] = {}
    quaternion: Quaternion = Quaternion()
    columns: list[Column] = []
    #: Added to the metadata of the log.
    metadata: dict[str, str | float | int | bool | list[str | float | int]] = {}

    @model_validator(mode="after")
    def _consistent(self) -> Mapping:
        targets = [column.target for column in self.columns]
        twice = next((name for name in targets if targets.count(name) > 1), None)
        if twice:
            raise ValueError(f"two columns have the target '{twice}'")
        if self.profile is not None:
            return self
        if not self.columns:
            raise ValueError(
                "'columns' is missing: it says which column of the file becomes which of the log"
            )
        if (self.time is None) == (TIME not in targets):
            raise ValueError(f"give the time once: as 'time:', or as a column with the target {TIME}")
        if targets == [TIME]:
            raise ValueError("maps the time alone")
        return self

    @property
    def name(self) -> str:
        """Name of a mapping in memory in the provenance of a result."""
        return "mapping"


@dataclass(frozen=True)
class MappedLog:
    """A foreign log in target columns, before it is cleaned.

    Attributes
    ----------
    path : Path
        Where it was read.
    columns : dict of str to ndarray, each shape (n,)
        Target columns in SI, NaN where missing; ``t_s`` first. Times may repeat, go back or be missing.
    rows : ndarray of int, shape (n,)
        Line of each sample in a text file, else its row, from 1.
    metadata : dict
        That of the file, the profile and the mapping.
    notes : list of str
        Problems of the reading that a user must know.
    sources : dict of str to (str, float, float)
        Source, factor and offset of each target.
    unknown : list of str
        Columns whose quantity nothing states.
    profile : str
        Profile that read the file; empty without one.
    unlikely : dict of str to int
        Number of samples left empty for their likelihood, by point.
    hint : str
        What to do if the clock goes back.
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
    hint: str = ""

    @property
    def time_s(self) -> Array:
        """Sample times as they stand in the file, s, shape (n,)."""
        return self.columns[TIME]

    def __len__(self) -> int:
        return len(self.rows)


def of(given: str | Path | Mapping | dict[str, Any]) -> Mapping:
    """Return the mapping that was passed: a file, an object, or a dict with the keys of the file.

    Raises
    ------
    InputError
        It is invalid, or a value is still ``ASK``; names line and key.
    """
    if isinstance(given, Mapping):
        return given
    if isinstance(given, dict):
        return yamlio.validate({"format": FORMAT} | given, Mapping, "mapping")
    return yamlio.validated(given, Mapping)


def apply(
    mapping: Mapping | None,
    given: str | Path | Log,
    choices: Choices | None = None,
    *,
    progress: Progress = silent,
) -> MappedLog:
    """Read a foreign log through a mapping or a profile.

    Parameters
    ----------
    mapping : Mapping or None
        Without one the profile that recognises the file is used; without a profile the columns must have the
        names of the log format.
    given : path or Log
        The foreign log; or one in memory (:func:`swimid.logs.log.unread`).
    choices : Choices, optional
        What the user states beside the file, for a profile.
    progress : Progress
        Shows the reading.

    Raises
    ------
    InputError
        The file cannot be read, has no such column, or a cell is no number; names file, line and column.
    """
    path, choices = path_of(given), choices or Choices()
    if mapping is not None:
        choices = choices.completed(mapping.profile, mapping.select, mapping.length_unit)
    with progress(f"reading {path.name}", total=1) as step:
        profile = None
        if not isinstance(given, Log) and (mapping is None or mapping.profile is not None):
            profile = profiles.find(path, choices)
        if profile is None:
            table = open_table(given, None if mapping is None else mapping.reader)
        else:
            table = profile.table(path, choices)
        step(1)
    name = "" if profile is None else profile.name
    return _mapped(mapping or Mapping(format=FORMAT, **{"as": name}), table, path, name, choices)


def _mapped(mapping: Mapping, table: Table, path: Path, profile: str, choices: Choices) -> MappedLog:
    metadata = {
        **metadata_of(table.comments, path, strict=False),
        **_short(table.metadata),
        **mapping.metadata,
    }
    notes = list(table.notes)
    columns = mapping.columns or _identity(table, path, metadata)
    sources = {column.target: table.column(column.source, path) for column in columns}
    columns = [_with_unit(column, table.units.get(sources[column.target]), notes) for column in columns]
    time = _time(mapping, table, sources, choices, path)
    used = [table.column(key, path) for key in (*time.sources, *mapping.where)] if time else []
    rows = _same_length([*sources.values(), *used], table, path)
    found: dict[str, Array] = {}
    factor = 1.0
    if time is not None:
        found[TIME] = clock.seconds(table, time, rows, path, metadata)
        factor = units.factor(time.unit, TIME) if isinstance(time.unit, str) else 1.0
    by_target = {column.target: column for column in columns}
    for target in sorted(sources, key=lambda name: name != TIME):
        values = _numbers(table, sources[target], mapping.reader.missing, path)
        found.setdefault(target, values * by_target[target].scale + by_target[target].offset)
    chosen = instances.chosen(table, mapping.where, rows, path)
    instances.refuse_mixed(table, found[TIME], chosen, {*used, sources.get(TIME, "")}, path)
    if not chosen.all():
        found = {name: values[chosen] for name, values in found.items()}
    infinite = [name for name, values in found.items() if _without_infinity(values)]
    notes += [f"infinite values taken as missing in {', '.join(infinite)}"] if infinite else []
    points = likelihood.points(list(found), sources)
    unlikely = likelihood.empty(found, points, choices.cut(mapping.min_likelihood))
    if set(AXES) <= set(found):
        q = np.column_stack([found[axis] for axis in AXES])
        q = rearranged(q, mapping.quaternion.order, mapping.quaternion.direction)
        found |= dict(zip(AXES, q.T, strict=True))
    if time is not None and time.frame is None and time.sources:
        notes += _contradicted(table, table.column(time.sources[0], path))
    lines = np.arange(1, rows + 1, dtype=np.int64) if table.lines is None else table.lines
    return MappedLog(
        path,
        found,
        lines[:rows][chosen],
        metadata,
        notes,
        {c.target: (str(c.source), c.scale, c.offset) for c in columns},
        [c.target for c in columns if c.target != TIME and not c.known] if not _own(metadata) else [],
        profile,
        unlikely,
        clock.wrap_hint(found[TIME], factor),
    )


def _with_unit(column: Column, stated: str | None, notes: list[str]) -> Column:
    """Return a column with the unit that the file states for it, unless the mapping states one."""
    unit = units.canonical(stated or "")
    quantity = units.measured(column.target)
    if quantity is None or unit not in units.UNITS[quantity]:
        return column
    if column.unit is None:
        return column.model_copy(update={"unit": unit})
    if column.unit == NO_UNIT or column.scale != column.factor * units.factor(unit, column.target):
        text = f"the file states {unit} for '{column.source}', the mapping states {column.unit}"
        notes.append(f"{text}: the mapping is believed")
    return column


def _own(metadata: dict[str, Any]) -> bool:
    return written_by(metadata, "swimid")


def _short(metadata: dict[str, Any]) -> dict[str, Any]:
    """Return the remarks of a file as one line each."""
    return {
        key: value.strip().splitlines()[0][:120] if isinstance(value, str) and value.strip() else value
        for key, value in metadata.items()
    }


def _identity(table: Table, path: Path, metadata: dict[str, Any]) -> list[Column]:
    """Return the columns that are named as in the log format; the others are left out, with a warning."""
    if not {TIME, "frame"} & set(table.columns):
        raise _missing_time(table, path)
    kept, out = [], []
    for name, values in table.columns.items():
        numbers = values.dtype.kind != "M" and (not is_text(values) or _mostly_numbers(values))
        known = name == TIME or units.is_known(name) or _own(metadata)
        if numbers and known and _NAME.fullmatch(name):
            kept.append(Column(source=name, target=name))
        else:
            out.append(name)
    if not [column for column in kept if column.target != TIME]:
        raise InputError(
            "no column is named with its quantity and unit as in the log format (x_m, yaw_rad)",
            file=path,
            hint=f"write a mapping (swimid import --guess drafts one); the file has: {', '.join(out[:20])}",
        )
    out = [name for name in out if name != "frame"]
    if out and not _own(metadata):
        warn("SWM004", f"{path.name}: columns whose names state no unit are left out: {', '.join(out[:20])}")
    return kept


def _time(
    mapping: Mapping, table: Table, sources: dict[str, str], choices: Choices, path: Path
) -> Time | None:
    """Return where the time comes from; None if it is a column of the log format."""
    rate = choices.rate_hz
    stated = mapping.time or (None if rate is None else Time(rate_hz=rate))
    if TIME in sources:
        if stated is not None:
            text = f"states its times in {sources[TIME]}: a sample rate contradicts them"
            raise InputError(text, file=path, hint="leave the rate out")
        return None
    if stated is not None and not stated.sources and "frame" in table.columns and mapping.profile is not None:
        return stated.model_copy(update={"frame": "frame"})
    if stated is None and "rate_hz" in table.scalars and "frame" in table.columns:
        return Time(frame="frame", rate_hz="rate_hz")
    if stated is None:
        if mapping.profile:
            hint = "add --rate-hz with the frames per second of the film, as in --rate-hz 30"
            raise InputError("states no frame rate, thus no times", file=path, hint=hint)
        raise _missing_time(table, path)
    return stated


def _missing_time(table: Table, path: Path) -> InputError:
    hint = (
        "a mapping says which column is which (swimid import --guess drafts one); "
        f"the file has: {', '.join(list(table.columns)[:20])}"
    )
    return InputError("this column is missing", file=path, column=TIME, hint=hint)


def _same_length(names: Sequence[str], table: Table, path: Path) -> int:
    """Return the number of rows of the columns in use."""
    lengths = {name: len(table.columns[name]) for name in names}
    if len(set(lengths.values())) > 1:
        text = ", ".join(f"{name} {rows}" for name, rows in lengths.items())
        hint = "map columns of one length; logs of several rates are imported one by one"
        raise InputError(f"the columns have different numbers of samples: {text}", file=path, hint=hint)
    rows = next(iter(lengths.values()))
    if rows == 0:
        raise InputError("holds no samples", file=path)
    return rows


def _numbers(table: Table, name: str, missing: Sequence[float | str], path: Path) -> Array:
    """Return a column as numbers, with the marks of missing samples as NaN."""
    values = table.columns[name]
    if values.dtype.kind == "M":
        raise InputError("holds dates, not numbers", file=path, column=name)
    if is_text(values):
        values = _of_text(table, name, path)
    numbers = values.astype(float)
    marks = [mark for mark in missing if isinstance(mark, int | float)]
    return np.where(np.isin(numbers, marks), np.nan, numbers) if marks else numbers


def _mostly_numbers(cells: NDArray[Any]) -> bool:
    import pandas as pd

    there = pd.Series(cells, dtype=object).dropna()
    return bool(pd.to_numeric(there, errors="coerce").notna().sum() > len(there) / 2)


def _of_text(table: Table, name: str, path: Path) -> Array:
    import pandas as pd

    cells = pd.Series(table.columns[name], dtype=object)
    numbers = pd.to_numeric(cells, errors="coerce")
    bad = (numbers.isna() & cells.notna()).to_numpy(dtype=bool)
    if not bad.any():
        return numbers.to_numpy(dtype=float)
    if not _mostly_numbers(table.columns[name]):
        raise InputError("holds text, not numbers", file=path, column=name)
    row = int(np.argmax(bad))
    cell = str(cells.iloc[row]).strip()[:40]
    hint = f"{number_hint(cell)}, or name what marks it under 'missing:' of the mapping"
    raise InputError(f"'{cell}' is not a number", file=path, column=name, hint=hint, **table.place(row))


def _without_infinity(values: Array) -> bool:
    """Replace infinite values by NaN in place; return whether there were any."""
    infinite = np.isinf(values)
    values[infinite] = np.nan
    return bool(infinite.any())


def _contradicted(table: Table, name: str) -> list[str]:
    """Return the note about a time whose name and steps are those of a frame number."""
    values = table.columns[name]
    if is_text(values) or values.dtype.kind == "M" or not clock.COUNT.fullmatch(name.strip().lower()):
        return []
    steps = np.diff(values[np.isfinite(values)])
    if len(steps) == 0 or np.median(steps) != 1:
        return []
    return [
        f"'{name}' is mapped as a time, but its name and its steps of 1 are those of a frame number: "
        f"write time: {{frame: {name}, rate_hz: ...}}"
    ]
