"""The log of one trial: CSV, or Parquet by its ending (``docs/formats.md``).

First column ``t_s``, strictly increasing; missing samples are empty cells; ``#`` lines
before the header hold YAML ``key: value`` metadata. Columns carry their unit as a suffix.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self, TypeAlias

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from swimid.errors import InputError
from swimid.files import atomic, yamlio
from swimid.files.delimited import MISSING, column_names, head, missing_column, number, number_hint
from swimid.logs import plausible
from swimid.notices import warn

if TYPE_CHECKING:
    import pandas as pd

TIME = "t_s"
PARQUET_ENDINGS = (".parquet", ".pq")
#: What a function that reads a log takes: its path, or the log itself.
LogLike: TypeAlias = "str | Path | Log | pd.DataFrame"


@dataclass(frozen=True)
class Log:
    """One trial's samples.

    Attributes
    ----------
    path : Path
        Where they were read; of a log in memory its name.
    metadata : dict
        The ``# key: value`` lines.
    columns : dict of str to ndarray, each shape (n,)
        Numbers, NaN where missing; ``t_s`` is among them. SI units and radians, named in the columns.
    first_line : int or None
        Line of the file that holds the first sample (0 for Parquet, None for a log in memory).
    time_s : ndarray, shape (n,)
        Sample times, s, strictly increasing.

    Examples
    --------
    >>> import pandas as pd
    >>> swum = Log.from_frame(pd.DataFrame({"t_s": [0.0, 0.1, 0.2], "x_m": [0.0, 0.03, 0.07]}))
    >>> len(swum), "x_m" in swum, float(swum["x_m"][-1])
    (3, True, 0.07)
    """

    path: Path
    metadata: dict[str, Any]
    columns: dict[str, NDArray[np.float64]]
    first_line: int | None = 0

    @classmethod
    def from_frame(
        cls,
        frame: pd.DataFrame,
        *,
        name: str = "log",
        metadata: Mapping[str, Any] | None = None,
        required: Sequence[str] = (),
    ) -> Self:
        """A log of a table in memory, checked as a file is.

        Parameters
        ----------
        frame : DataFrame, shape (n, k)
            One row a sample, the columns named as in the log format: ``t_s`` in s, strictly increasing, or
            as the index of this name; NaN where a sample is missing. Columns of words are left out.
        name : str
            What messages and the provenance of results call it.
        metadata : mapping, optional
            What the ``# key: value`` lines of a file say: ``frequency_hz``, ``robot``, ...
        required : sequence of str
            Columns that must be there, besides ``t_s``.

        Raises
        ------
        InputError
            Naming the column and the row (from 0): a column is missing or misnamed, a cell is no number or
            infinite, the time does not increase, or there are fewer than two samples.

        Examples
        --------
        >>> import pandas as pd
        >>> swum = Log.from_frame(pd.DataFrame({"t_s": [0.0, 0.1, 0.2], "x_m": [0.0, 0.03, 0.07]}))
        >>> len(swum), float(swum["x_m"][-1])
        (3, 0.07)
        """
        path, given = Path(name), arrays(frame, name)
        for column in (TIME, *required):
            if column not in given:
                raise missing_column(column, list(given), path, None)
        columns = {}
        for column, values in ({TIME: given[TIME]} | given).items():
            strict = column == TIME or column in required
            numbers = _numbers(values, strict, lambda row: {"row": row}, path, column)
            if numbers is not None:
                columns[column] = numbers
        log = cls(path, dict(metadata or {}), columns, None)
        _check(log, required, 2)
        _warn_missing(log)
        warn_units(log)
        return log

    @property
    def source(self) -> Path | Log:
        """What it is to the provenance: the file it was read from, or itself."""
        return self if self.first_line is None else self.path

    def chosen(self, required: Sequence[str], optional: Sequence[str] | None = None) -> Log:
        """The same log with the columns asked for, after the checks that :func:`read` makes."""
        _check_columns(list(self.columns), required, self.path, None)
        wanted = [n for n in self.columns if optional is None or n in {TIME, *required, *optional}]
        log = replace(self, columns={name: self.columns[name] for name in wanted})
        _check(log, required, 2)
        _warn_missing(log)
        warn_units(log)
        return log

    @property
    def name(self) -> str:
        """The file's name, or that of a log in memory."""
        return self.path.name

    def digest(self) -> str:
        """SHA-256 of the columns, their names and samples, as hexadecimal digits."""
        found = hashlib.sha256()
        for name, values in self.columns.items():
            found.update(f"{name}\n".encode())
            if values.dtype.kind == "f":  # one NaN is as good as another
                values = np.where(np.isnan(values), np.nan, values)
            plain = values.dtype.kind in "biufM"
            found.update(values.tobytes() if plain else "\n".join(map(str, values)).encode())
        return found.hexdigest()

    @property
    def time_s(self) -> NDArray[np.float64]:
        """Sample times, s, shape (n,)."""
        return self.columns[TIME]

    def frame(self) -> pd.DataFrame:
        """The columns as a table, one row a sample."""
        import pandas as pd

        return pd.DataFrame(self.columns)

    def __getitem__(self, column: str) -> NDArray[np.float64]:
        return self.columns[column]

    def __contains__(self, column: str) -> bool:
        return column in self.columns

    def __repr__(self) -> str:
        return f"<log {self.name}: {len(self)} samples of {', '.join(self.columns)}>"

    def __str__(self) -> str:
        return self.name

    def __len__(self) -> int:
        return len(self.time_s)

    def line(self, row: int) -> int | None:
        """Line of the file that holds sample ``row``; None for Parquet and in memory."""
        return _line_of(self.path, self.first_line - 1, row) if self.first_line else None

    def place(self, row: int) -> dict[str, Any]:
        """Where sample ``row`` is, for an :class:`InputError`: its line, or in memory its row."""
        return {"row": row} if self.first_line is None else {"line": self.line(row)}


def of(given: LogLike, *, name: str = "log", required: Sequence[str] = ()) -> Log:
    """The log that was handed over: read where it is a file, checked where it is a table.

    Raises
    ------
    InputError
        As :func:`read` and :meth:`Log.from_frame`.
    """
    if isinstance(given, str | Path):
        return read(given, required=required)
    if not isinstance(given, Log):
        return Log.from_frame(given, name=name, required=required)
    _check_columns(list(given.columns), required, given.path, None)
    return given


def unread(given: LogLike, *, name: str = "log") -> Path | Log:
    """A path as it is; a table in memory as a log that nobody has checked."""
    if isinstance(given, str | Path):
        return Path(given)
    return given if isinstance(given, Log) else Log(Path(name), {}, arrays(given, name), None)


def numeric(columns: Mapping[str, Any]) -> dict[str, NDArray[np.float64]]:
    """Of columns as they are written those :func:`read` gives back: numbers, no words."""
    import pandas as pd

    frame = pd.DataFrame(dict(columns)).select_dtypes(["number", "bool"])
    return {str(name): values.to_numpy(dtype=float, na_value=np.nan) for name, values in frame.items()}


def arrays(frame: pd.DataFrame, name: str) -> dict[str, NDArray[Any]]:
    """The columns of a table as they are: numbers, dates (``datetime64[ns]``, UTC), or words.

    Raises
    ------
    InputError
        Two columns have one name.
    """
    from pandas.api import types

    if frame.index.name == TIME and TIME not in frame:
        frame = frame.reset_index()
    twice = frame.columns[frame.columns.duplicated()]
    if len(twice):
        raise InputError("two columns have this name", file=name, column=str(twice[0]))
    found: dict[str, NDArray[Any]] = {}
    for column, values in frame.infer_objects().items():
        if types.is_timedelta64_dtype(values):
            values = values.dt.total_seconds()
        if isinstance(values.dtype, np.dtype) and values.dtype.kind in "biuf":
            found[str(column)] = values.to_numpy()
        elif types.is_numeric_dtype(values):
            found[str(column)] = values.to_numpy(dtype=float, na_value=np.nan)
        elif types.is_datetime64_any_dtype(values):
            clock = values.dt.tz_convert(None) if getattr(values.dt, "tz", None) is not None else values
            found[str(column)] = clock.to_numpy(dtype="datetime64[ns]")
        else:
            found[str(column)] = values.to_numpy(dtype=object)
    return found


def written_by(metadata: Mapping[str, Any], program: str) -> bool:
    """Whether ``swimid`` (or one of its verbs, ``swimid track``) wrote a log, by its metadata."""
    return str(metadata.get("made_by", "")).startswith(program)


def read(
    path: str | Path,
    *,
    required: Sequence[str] = (),
    optional: Sequence[str] | None = None,
    min_rows: int = 2,
) -> Log:
    """Read a log and check it.

    Parameters
    ----------
    required : sequence of str
        Columns that must be there, besides ``t_s``.
    optional : sequence of str, optional
        Further columns to take where they are there. Without it every column is taken
        that holds numbers, and columns of text are left out.
    min_rows : int
        Fewest samples accepted.

    Raises
    ------
    InputError
        Naming file, line and column: unreadable or empty file, missing or misnamed column
        (with the nearest name), a cell that is no number, time not increasing, a required
        column without a single sample.
    """
    path = Path(path)
    reader = _read_parquet if path.suffix.lower() in PARQUET_ENDINGS else _read_csv
    try:
        metadata, columns, first_line = reader(
            path, list(required), None if optional is None else list(optional)
        )
    except OSError as error:
        hint = "check the path" if isinstance(error, FileNotFoundError) else None
        raise InputError(f"cannot be read: {error.strerror or error}", file=path, hint=hint) from error
    log = Log(path, metadata, columns, first_line)
    _check(log, required, min_rows)
    _warn_missing(log)
    warn_units(log)
    return log


# ---------------------------------------------------------------- CSV


def _read_csv(
    path: Path, required: list[str], optional: list[str] | None
) -> tuple[dict[str, Any], dict[str, NDArray[np.float64]], int]:
    comments, header, header_line = head(path)
    metadata = metadata_of(comments, path)
    names = column_names(header, path, header_line)
    if all(number(name) is not None for name in names):
        raise InputError("the header line with the column names is missing", file=path, line=header_line)
    _check_columns(names, required, path, header_line)
    wanted = names if optional is None else [n for n in names if n in {TIME, *required, *optional}]
    try:
        table = _parse(path, header_line, names, wanted, pa.float64())
        columns = {name: table.column(name).to_numpy().astype(float) for name in wanted}
    except pa.ArrowInvalid:
        columns = _parse_with_care(path, header_line, names, wanted, {TIME, *required, *(optional or ())})
    return metadata, columns, header_line + 1


def _parse(path: Path, header_line: int, names: list[str], wanted: list[str], kind: pa.DataType) -> pa.Table:
    from pyarrow import csv

    return csv.read_csv(
        path,
        read_options=csv.ReadOptions(skip_rows=header_line, column_names=names),
        convert_options=csv.ConvertOptions(
            include_columns=wanted,
            column_types=dict.fromkeys(wanted, kind),
            null_values=MISSING,
            strings_can_be_null=True,
        ),
    )


def _parse_with_care(
    path: Path, header_line: int, names: list[str], wanted: list[str], strict: set[str]
) -> dict[str, NDArray[np.float64]]:
    """Column by column as text, to take what is numbers and to say which cell is none."""
    try:
        table = _parse(path, header_line, names, wanted, pa.string())
    except pa.ArrowInvalid as error:
        raise _ragged(path, header_line, len(names), error) from error
    columns: dict[str, NDArray[np.float64]] = {}
    for name in wanted:
        texts = table.column(name).to_pandas()
        numbers = _numbers(
            texts, name in strict, lambda row: {"line": _line_of(path, header_line, row)}, path, name
        )
        if numbers is not None:
            columns[name] = numbers
    return columns


def _numbers(
    cells: Any, strict: bool, place: Callable[[int], dict[str, Any]], path: Path, name: str
) -> NDArray[np.float64] | None:
    """A column as numbers; None for one of words (a status, say), which is no mistake unless ``strict``."""
    import pandas as pd

    cells = pd.Series(cells)
    numbers = pd.to_numeric(cells, errors="coerce")
    bad = (numbers.isna() & ~cells.isna()).to_numpy(dtype=bool)
    if bad.any():
        if not strict and bad.sum() > len(cells) // 2:
            return None
        row = int(np.argmax(bad))
        raise InputError(
            f"'{cells.iloc[row]}' is not a number",
            file=path,
            column=name,
            hint=number_hint(str(cells.iloc[row])),
            **place(row),
        )
    return numbers.to_numpy(dtype=float, na_value=np.nan)


def metadata_of(comments: list[str], path: Path, *, strict: bool = True) -> dict[str, Any]:
    """``# key: value`` lines as YAML, each on its own; a remark that is none is left out.

    Raises
    ------
    InputError
        Where a value is no YAML; without ``strict`` such a line counts as a remark.
    """
    metadata: dict[str, Any] = {}
    for line in comments:
        key, colon, value = line.partition(":")
        if not colon or not key.strip() or " " in key.strip():
            continue
        try:
            parsed = yamlio.parse_scalar(value)
        except ValueError as error:
            if not strict:
                continue
            raise InputError(f"its comment line is not YAML 'key: value': {error}", file=path) from error
        metadata[key.strip()] = parsed
    return metadata


def _ragged(path: Path, header_line: int, expected: int, error: Exception) -> InputError:
    with path.open("r", encoding="utf-8", errors="replace") as stream:
        for number, line in enumerate(stream, start=1):
            cells = line.count(",") + 1
            if number > header_line and line.strip() and cells != expected:
                return InputError(
                    f"has {cells} cells where the header names {expected} columns", file=path, line=number
                )
    return InputError(f"cannot be parsed: {str(error).splitlines()[0]}", file=path)


def _line_of(path: Path, header_line: int, row: int) -> int:
    """Line of a sample, blank lines counted."""
    with path.open("r", encoding="utf-8", errors="replace") as stream:
        samples = -1
        for number, line in enumerate(stream, start=1):
            if number > header_line and line.strip():
                samples += 1
                if samples == row:
                    return number
    return header_line + 1 + row


# ---------------------------------------------------------------- Parquet


def _read_parquet(
    path: Path, required: list[str], optional: list[str] | None
) -> tuple[dict[str, Any], dict[str, NDArray[np.float64]], int]:
    import pyarrow.parquet as pq

    if not path.exists():
        raise FileNotFoundError(2, "No such file or directory")
    try:
        file = pq.ParquetFile(path)
        names = list(file.schema_arrow.names)
        _check_columns(names, required, path, None)
        wanted = names if optional is None else [n for n in names if n in {TIME, *required, *optional}]
        table = file.read(columns=wanted)
    except (pa.ArrowException, OSError) as error:
        if isinstance(error, PermissionError):
            raise
        first = (str(error) or type(error).__name__).splitlines()[0]
        raise InputError(f"is no readable Parquet file: {first}", file=path) from error
    stored = (file.schema_arrow.metadata or {}).get(b"swimid", b"")
    metadata = metadata_of(stored.decode("utf-8", "replace").splitlines(), path)
    strict = {TIME, *required, *(optional or ())}
    columns = {}
    for name in wanted:
        kind = table.schema.field(name).type
        if pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_boolean(kind):
            values = table.column(name).to_pandas()
            columns[name] = values.to_numpy(dtype=float, na_value=np.nan)
        elif name in strict:
            raise InputError(f"holds {kind}, not numbers", file=path, column=name)
    return metadata, columns, 0


# ---------------------------------------------------------------- checks


def _check_columns(names: list[str], required: Sequence[str], path: Path, line: int | None) -> None:
    for column in (TIME, *required):
        if column in names:
            continue
        raise missing_column(column, names, path, line)
    if names[0] != TIME:
        raise InputError(f"the first column must be {TIME}", file=path, line=line, column=names[0])


def _check(log: Log, required: Sequence[str], min_rows: int) -> None:
    time = log.time_s
    if len(time) < min_rows:
        count = "no samples" if len(time) == 0 else f"{len(time)} samples"
        raise InputError(f"has {count}; at least {min_rows} are needed", file=log.path)
    if np.isnan(time).any():
        row = int(np.argmax(np.isnan(time)))
        raise InputError("has no value", file=log.path, column=TIME, **log.place(row))
    for name, values in log.columns.items():
        if np.isinf(values).any():
            row = int(np.argmax(np.isinf(values)))
            raise InputError("is infinite", file=log.path, column=name, **log.place(row))
    backwards = np.diff(time) <= 0
    if backwards.any():
        row = int(np.argmax(backwards)) + 1
        what = "repeats" if time[row] == time[row - 1] else "goes back"
        raise InputError(
            f"time {what}: {time[row]!r} after {time[row - 1]!r}".replace("np.float64(", "").replace(")", ""),
            file=log.path,
            column=TIME,
            hint="sort the rows and drop repeated ones",
            **log.place(row),
        )
    for name in required:
        if np.isnan(log[name]).all():
            raise InputError("every sample is missing", file=log.path, column=name)


def _warn_missing(log: Log) -> None:
    """One warning per log; columns with the same gaps are named together."""
    found: dict[tuple[int, int], list[str]] = {}
    for name, values in log.columns.items():
        missing = np.isnan(values)
        if missing.any() and not missing.all():
            found.setdefault((int(missing.sum()), longest_run(missing)), []).append(name)
    if found:
        parts = [
            f"{count} of {len(log)} (longest run {run}) in {', '.join(names)}"
            for (count, run), names in sorted(found.items())
        ]
        warn(
            "SWM001", f"{log.path.name}: samples are missing, {'; '.join(parts)}; they are masked, not filled"
        )


def runs(flags: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Unbroken runs of True as rows of (first, last + 1), shape (k, 2).

    >>> runs(np.array([True, True, False, True])).tolist()
    [[0, 2], [3, 4]]
    """
    return np.flatnonzero(np.diff(np.concatenate(([0], flags.astype(np.int8), [0])))).reshape(-1, 2)


def longest_run(flags: NDArray[np.bool_]) -> int:
    """Length of the longest unbroken run of True.

    >>> longest_run(np.array([True, False, True, True]))
    2
    """
    return int(np.max(np.diff(runs(flags)), initial=0))


def warn_units(log: Log) -> None:
    """Warn of values no swimmer reaches in the unit the column claims."""
    for doubt in plausible.doubts(log.time_s, log.columns):
        warn("SWM002", f"{log.path.name}, '{doubt.column}': {doubt.text}")


# ---------------------------------------------------------------- writing


def write(path: str | Path, columns: Mapping[str, Any], metadata: Mapping[str, Any] | None = None) -> None:
    """Write a log, whole or not at all.

    Parameters
    ----------
    columns : mapping of name to array_like, each shape (n,)
        ``t_s`` first. NaN becomes an empty cell; text columns are allowed.
    metadata : mapping, optional
        Plain values, one ``# key: value`` line each.
    """
    import pandas as pd

    path = Path(path)
    frame = pd.DataFrame(dict(columns))
    lines = [line for line in yamlio.dumps_flat(metadata or {}).splitlines() if line.strip()]
    with atomic.replacing(path) as temporary:
        if path.suffix.lower() in PARQUET_ENDINGS:
            import pyarrow.parquet as pq

            table = pa.Table.from_pandas(frame, preserve_index=False)
            stored = {**(table.schema.metadata or {}), b"swimid": "\n".join(lines).encode()}
            pq.write_table(table.replace_schema_metadata(stored), temporary)
        else:
            with open(temporary, "w", encoding="utf-8", newline="\n") as stream:
                stream.writelines(f"# {line}\n" for line in lines)
                frame.to_csv(stream, index=False, lineterminator="\n")
