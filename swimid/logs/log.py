"""Reading, checking and writing the log of one trial.

A log is a CSV or Parquet file (``docs/formats.md``), or a table in memory. The first column is ``t_s``, which
increases strictly. A missing sample is an empty cell. Lines that begin with ``#`` before the header hold
metadata as YAML ``key: value``. The name of a column ends in its unit.
"""

from __future__ import annotations

import hashlib
import shlex
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self, TypeAlias

import numpy as np
from numpy.typing import NDArray
from pydantic_core import to_json

from swimid.errors import InputError, Named, extra_needed, file_errors, first_line
from swimid.files import atomic, isolated, memory, tabular, yamlio
from swimid.files.tabular import column_error, column_names, head, number_hint, parse_number
from swimid.notices import warn
from swimid.options import LARGEST, SMALLEST
from swimid.results import numbers as texts

if TYPE_CHECKING:
    import pandas as pd
    import xarray

    from swimid.kinematics.plot import Drawn

Array = NDArray[np.float64]
TIME = "t_s"
#: Maximum relative difference between the measured stroke frequency and the one stated in the metadata of a
#: log. A larger difference counts as a contradiction.
FREQUENCY_RTOL = 0.05
#: Number of rows of a log that are read or written in one block.
ROWS = 100_000
#: Number of copies of the content of a file that are in memory while a log is read.
N_COPIES = 4
#: Minimum mean time step of a log, s. A smaller one is an error of units: no recorder takes 1e12 samples per
#: second.
MIN_STEP_S = 1e-12
#: Hint in the error message for a column whose values are too large or too small.
RESCALE = "is the unit right? A mapping can state a factor: swimid import --map"
#: Type of an argument for which a function accepts the path of a log, the log itself, or a table.
LogLike: TypeAlias = "str | Path | Log | pd.DataFrame"


@dataclass(frozen=True)
class Log:
    """Log of one trial: its samples and metadata.

    Attributes
    ----------
    path : Path
        Path of the file; for a log in memory its name.
    metadata : dict
        Entries of the ``# key: value`` lines.
    columns : dict of str to ndarray, each shape (n,)
        Samples of each column, ``t_s`` included, in SI units and radians; NaN where missing.
    first_line : int or None
        Line of the file with the first sample; 0 for Parquet, None for a log in memory.
    time_s : ndarray, shape (n,)
        Sample times, s, strictly increasing.
    frame : DataFrame
        Columns of the log, one row per sample.

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
        """Create a log from a table in memory, with the same checks as for a file.

        Parameters
        ----------
        frame : DataFrame, shape (n, k)
            One row per sample, with the column names of the log format. ``t_s`` is a column or the index, in
            s, strictly increasing. A missing sample is NaN. Columns of text are left out.
        name : str
            Name of the log in messages and in the provenance of results.
        metadata : mapping, optional
            Metadata, as in the ``# key: value`` lines of a file: ``frequency_hz``, ``robot``, ...
        required : sequence of str
            Columns that the table must have besides ``t_s``.

        Raises
        ------
        InputError
            A column is missing or misnamed, a cell is no number or infinite, the time does not increase, or
            there are fewer than two samples. Rows are counted from 0.

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
                raise column_error(column, list(given), path, None)
        columns = _columns({TIME: given[TIME]} | given, {TIME, *required}, lambda row: {"row": row}, path)
        log = cls(path, dict(metadata or {}), columns, None)
        _check(log, required)
        return log

    @property
    def source(self) -> Path | Log:
        """Log as named in the provenance of a result: path of its file, or the log itself if in memory."""
        return self if self.first_line is None else self.path

    def select_columns(self, required: Sequence[str], optional: Sequence[str] | None = None) -> Log:
        """Return a copy of the log with only the requested columns, checked as by :func:`read`."""
        wanted = _columns_to_read(list(self.columns), required, optional, self.path, None)
        log = replace(self, columns={name: self.columns[name] for name in wanted})
        _check(log, required)
        return log

    @property
    def name(self) -> str:
        """Name of the log's file, or name of a log in memory."""
        return self.path.name

    def digest(self) -> str:
        """Return the SHA-256 of the names and samples of the log's columns, as hexadecimal digits."""
        digest = hashlib.sha256()
        for name, values in self.columns.items():
            digest.update(f"{name}\n".encode())
            if values.dtype.kind == "f":  # give all NaN one bit pattern, for equal digests of equal logs
                values = np.where(np.isnan(values), np.nan, values)
            if values.dtype.kind in "biufM":
                digest.update(values.tobytes())
            else:
                digest.update("\n".join(map(str, values)).encode())
        return digest.hexdigest()

    @property
    def time_s(self) -> NDArray[np.float64]:
        """Sample times of the log, s, shape (n,)."""
        return self.columns[TIME]

    @property
    def signals(self) -> dict[str, NDArray[np.float64]]:
        """Columns of the log by name, without the time ``t_s``."""
        return {name: values for name, values in self.columns.items() if name != TIME}

    @property
    def frame(self) -> pd.DataFrame:
        """Columns of the log as a table, one row per sample."""
        import pandas as pd

        return pd.DataFrame(self.columns)

    def to_xarray(self) -> xarray.Dataset:
        """Return the columns of the log as an ``xarray.Dataset`` over ``t_s``, each with its unit."""
        return to_xarray(self.frame, [TIME])

    def plot(self, **options: Any) -> Drawn:
        """Draw the log: channels over time, path and spectra (:func:`swimid.plot`)."""
        import swimid

        drawn: Drawn = swimid.plot(self, **options)
        return drawn

    def __getitem__(self, column: str) -> NDArray[np.float64]:
        return Named(self.columns)[column]

    def __contains__(self, column: str) -> bool:
        return column in self.columns

    def __repr__(self) -> str:
        return f"<log {self.name}: {len(self)} samples of {', '.join(self.columns)}>"

    def __str__(self) -> str:
        return self.name

    def __len__(self) -> int:
        return len(self.time_s)

    def line(self, row: int) -> int | None:
        """Return the line number of a sample in the file of the log; None for Parquet or a log in memory."""
        return _line_of(self.path, self.first_line - 1, row) if self.first_line else None

    def place(self, row: int) -> dict[str, Any]:
        """Return the place of a sample for an :class:`InputError`: line, or row for a log in memory."""
        return {"row": row} if self.first_line is None else {"line": self.line(row)}


def as_log(given: LogLike, *, name: str = "log", required: Sequence[str] = ()) -> Log:
    """Return the log for an argument that is a path, a table or a log.

    A path is read, a table is checked, and a log is returned unchanged.

    Raises
    ------
    InputError
        The errors of :func:`read` and :meth:`Log.from_frame`.
    """
    if isinstance(given, str | Path):
        return read(given, required=required)
    if not isinstance(given, Log):
        return Log.from_frame(given, name=name, required=required)
    _columns_to_read(list(given.columns), required, None, given.path, None)
    return given


def to_xarray(frame: pd.DataFrame, dimensions: Sequence[str]) -> xarray.Dataset:
    """Return a table as an ``xarray.Dataset``. Each variable has the unit of its column as ``units``.

    Parameters
    ----------
    frame : DataFrame, shape (n, k)
        A row for each combination of the values of the dimensions.
    dimensions : sequence of str
        Columns that become the dimensions.

    Raises
    ------
    UsageError
        If xarray is not installed.
    """
    with extra_needed("xarray", "netcdf"):
        import xarray  # noqa: F401 - pandas makes the dataset with it

    data = frame.set_index(list(dimensions)).to_xarray()
    for name in map(str, data.variables):
        data[name].attrs["units"] = texts.split_unit(name)[1]
    return data


def unread(given: LogLike, *, name: str = "log") -> Path | Log:
    """Return the path of a log, or the log in memory, without reading or checking its data.

    Text becomes a path, and a table becomes a log. A log is returned unchanged.
    """
    if isinstance(given, str | Path):
        return Path(given)
    if isinstance(given, Log):
        return given
    return Log(Path(name), {}, arrays(given, name), None)


def numeric(columns: Mapping[str, Any]) -> dict[str, NDArray[np.float64]]:
    """Return the numeric columns of a table as arrays of floats, with NaN for missing cells.

    Columns of text are left out.
    """
    import pandas as pd

    frame = pd.DataFrame(dict(columns)).select_dtypes(["number", "bool"])
    return {str(name): values.to_numpy(dtype=float, na_value=np.nan) for name, values in frame.items()}


def arrays(frame: pd.DataFrame, name: str) -> dict[str, NDArray[Any]]:
    """Return the columns of a table as arrays of numbers, dates (``datetime64[ns]``, UTC), or text.

    Raises
    ------
    InputError
        Two columns have the same name.
    """
    from pandas.api import types

    if not hasattr(frame, "columns"):
        text = f"a {type(frame).__name__} is no table"
        raise InputError(text, file=name, hint="pass a DataFrame, a Log or the path of a log")
    if frame.index.name == TIME and TIME not in frame:
        frame = frame.reset_index()
    twice = frame.columns[frame.columns.duplicated()]
    if len(twice):
        raise InputError("two columns have this name: rename one column", file=name, column=str(twice[0]))
    columns: dict[str, NDArray[Any]] = {}
    for column, values in frame.infer_objects().items():
        if types.is_timedelta64_dtype(values):
            values = values.dt.total_seconds()
        if types.is_datetime64_any_dtype(values):
            if getattr(values.dt, "tz", None) is not None:
                values = values.dt.tz_convert(None)
            columns[str(column)] = values.to_numpy(dtype="datetime64[ns]")
        elif isinstance(values.dtype, np.dtype):
            columns[str(column)] = values.to_numpy()
        elif types.is_numeric_dtype(values):
            columns[str(column)] = values.to_numpy(dtype=float, na_value=np.nan)
        else:
            columns[str(column)] = values.to_numpy(dtype=object)
    return columns


def is_written_by(metadata: Mapping[str, Any], program: str) -> bool:
    """Return whether the metadata of a log say that ``program`` (such as ``swimid track``) wrote it."""
    return str(metadata.get("made_by", "")).startswith(program)


def read(path: str | Path, *, required: Sequence[str] = (), optional: Sequence[str] | None = None) -> Log:
    """Read a log from a CSV or Parquet file, and check it.

    Parameters
    ----------
    required : sequence of str
        Columns that the log must have besides ``t_s``.
    optional : sequence of str, optional
        Further columns to read. By default all columns of numbers are read, and columns of text are left out.

    Raises
    ------
    InputError
        The file is unreadable or empty, a column is missing or misnamed, a cell is no number, the time does
        not increase, or a required column has no sample. The error names file, line and column.
    """
    path = Path(path)
    reader = _read_parquet if path.suffix.lower() in tabular.PARQUET_ENDINGS else _read_csv
    with file_errors(path):
        log = reader(path, required, optional)
    _check(log, required)
    return log


def _columns_to_read(
    names: list[str], required: Sequence[str], optional: Sequence[str] | None, path: Path, line: int | None
) -> list[str]:
    """Return the names of the columns to read from a log.

    Raises
    ------
    InputError
        A required column is missing, or ``t_s`` is not the first column.
    """
    for column in (TIME, *required):
        if column not in names:
            raise column_error(column, names, path, line)
    if names[0] != TIME:
        raise InputError(f"the first column must be {TIME}", file=path, line=line, column=names[0])
    return [name for name in names if optional is None or name in {TIME, *required, *optional}]


def _too_long(path: Path) -> str:
    """Return the hint of the error that a log does not fit in memory."""
    return f"average successive rows: swimid import {shlex.quote(str(path))} --every 100 -o short.parquet"


# ---------------------------------------------------------------- CSV


def _read_csv(path: Path, required: Sequence[str], optional: Sequence[str] | None) -> Log:
    comments, header, header_line = head(path)
    metadata = metadata_of(comments, path)
    names = column_names(header, path, header_line)
    if all(parse_number(name) is not None for name in names):
        raise InputError("the header line with the column names is missing", file=path, line=header_line)
    wanted = _columns_to_read(names, required, optional, path, header_line)
    size = path.stat().st_size
    memory.check_fits(path, f"{size} bytes of text", N_COPIES * size, _too_long(path))
    text = path.read_bytes().split(b"\n", header_line)[-1]
    read = partial(tabular.parse, text, names)
    try:
        table = read(dict.fromkeys(wanted, float))
    except ValueError:
        # At least one cell is not a number. Read all cells as text, to find columns of text and faulty cells.
        try:
            table = read(str)
        except ValueError as error:
            _refuse_ragged(path, header_line, len(names))
            raise InputError(f"cannot be parsed: {first_line(error)}", file=path) from error
    is_regular = b'"' not in text and text.count(b",") == len(table) * (len(names) - 1)
    if table[names[-1]].isna().any() or not is_regular:
        _refuse_ragged(path, header_line, len(names))
    cells, strict = {name: table[name] for name in wanted}, {TIME, *required, *(optional or ())}
    columns = _columns(cells, strict, lambda row: {"line": _line_of(path, header_line, row)}, path)
    return Log(path, metadata, columns, header_line + 1)


def _columns(
    cells: Mapping[str, Any], strict: set[str], place: Callable[[int], dict[str, Any]], path: Path
) -> dict[str, Array]:
    """Return the columns of numbers in a table; raise an error for text in a column listed in ``strict``."""
    found = {}
    for name, values in cells.items():
        numbers = cells_to_numbers(values, name in strict, place, path, name)
        if numbers is not None:
            found[name] = numbers
    return found


def cells_to_numbers(
    cells: Any, strict: bool, place: Callable[[int], dict[str, Any]], path: Path, name: str, more: str = ""
) -> NDArray[np.float64] | None:
    """Convert the cells of a column to numbers; return None for a column of text.

    ``more`` is text that is appended to the hint of the error message.

    Raises
    ------
    InputError
        A cell is not a number. Without ``strict``, a column in which most cells are not numbers is taken for
        text.
    """
    import pandas as pd

    cells = pd.Series(cells)
    numbers = pd.to_numeric(cells, errors="coerce")
    bad = (numbers.isna() & ~cells.isna()).to_numpy(dtype=bool)
    if bad.any():
        if not strict and bad.sum() > (~cells.isna()).sum() // 2:
            return None
        row = int(np.argmax(bad))
        cell = str(cells.iloc[row]).strip()[:40]
        text, hint = f"'{cell}' is not a number", f"{number_hint(cell)}{more}"
        raise InputError(text, file=path, column=name, hint=hint, **place(row))
    return numbers.to_numpy(dtype=float, na_value=np.nan)


def metadata_of(comments: list[str], path: Path, *, strict: bool = True) -> dict[str, Any]:
    """Return the metadata in comment lines ``# key: value``, with each value parsed as YAML.

    Other comment lines are left out.

    Raises
    ------
    InputError
        A value is not YAML. Without ``strict`` a line with such a value is left out.
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
            raise InputError(f"a comment line is not YAML 'key: value': {error}", file=path) from error
        metadata[key.strip()] = parsed
    return metadata


def _samples(path: Path, header_line: int) -> Iterator[tuple[int, str]]:
    """Yield the line number and the text of each line after the header of a file, without blank lines."""
    with path.open("r", encoding="utf-8", errors="replace") as stream:
        lines = enumerate(stream, start=1)
        yield from ((at, line) for at, line in lines if at > header_line and line.strip())


def _refuse_ragged(path: Path, header_line: int, width: int) -> None:
    """Raise an error if a line has more or fewer cells than the header; name the first such line."""
    for at, line in _samples(path, header_line):
        cells = tabular.count_cells(line.rstrip("\n"))
        if cells != width:
            text = f"has {cells or 'unreadable'} cells where the header names {width} columns"
            raise InputError(text, file=path, line=at)


def _line_of(path: Path, header_line: int, row: int) -> int:
    """Return the line number of a sample in a CSV file. Blank lines are counted, but hold no sample."""
    samples = islice(_samples(path, header_line), row, None)
    return next((at for at, _ in samples), header_line + 1 + row)


# ---------------------------------------------------------------- Parquet


def _read_parquet(path: Path, required: Sequence[str], optional: Sequence[str] | None) -> Log:
    pyarrow = tabular.pyarrow()
    path.stat()  # raise the error for a missing file before the reader reports a damaged file
    try:
        file = pyarrow.parquet.ParquetFile(path)
        isolated.check_parquet(path, file)
        wanted = _columns_to_read(list(file.schema_arrow.names), required, optional, path, None)
        rows = file.metadata.num_rows
        what = f"{rows} rows of {len(wanted)} columns"
        memory.check_fits(path, what, 8.0 * N_COPIES * rows * len(wanted), _too_long(path))
        table = file.read(columns=wanted)
    except (pyarrow.ArrowException, OSError) as error:
        if isinstance(error, PermissionError) or path.is_dir():
            raise
        raise InputError(f"is no readable Parquet file: {first_line(error)}", file=path) from error
    stored = (file.schema_arrow.metadata or {}).get(b"swimid", b"")
    metadata = metadata_of(stored.decode("utf-8", "replace").splitlines(), path)
    cells = arrays(table.to_pandas(ignore_metadata=True), str(path))
    strict = {TIME, *required, *(optional or ())}
    return Log(path, metadata, _columns(cells, strict, lambda row: {"row": row + 1}, path))


# ---------------------------------------------------------------- checks


def _check(log: Log, required: Sequence[str]) -> None:
    """Raise an error if a log is invalid; warn of missing samples and of unusual values."""
    time = log.time_s
    if len(time) < 2:
        raise InputError(f"has {len(time) or 'no'} samples; at least 2 are needed", file=log.path)
    _refuse(np.isnan(time), "has no value", log, TIME)
    for name, values in log.columns.items():
        _refuse(np.abs(values) > LARGEST, f"is infinite or beyond ±{LARGEST:g}", log, name, RESCALE)
        check_not_tiny(values, log.path, name)
    backwards = np.append(False, np.diff(time) < SMALLEST)
    if backwards.any():
        before, after = map(float, time[np.argmax(backwards) - 1 :][:2])
        what = "goes back" if after < before else "repeats"
        text = f"time {what}: {after!r} after {before!r}"
        _refuse(backwards, text, log, TIME, "sort the rows and drop repeated ones")
    for name in required:
        if np.isnan(log[name]).all():
            raise InputError("every sample is missing; at least 1 is needed", file=log.path, column=name)
    _warn_missing(log)
    warn_units(log)


def check_not_tiny(values: Array, path: Path, column: str) -> None:
    """Raise an error if all values of a column, or the mean time step, are too small for computations."""
    low, high = _ends(values)
    top, limit, what = max(-low, high), SMALLEST, "no value is larger than"
    if column == TIME:
        top, limit, what = (high - low) / max(len(values) - 1, 1), MIN_STEP_S, "the mean step is"
    if 0 < top < limit:
        text = f"{what} {top:g}; at least {limit:g} is needed"
        raise InputError(text, file=path, column=column, hint=RESCALE)


def _refuse(bad: NDArray[np.bool_], text: str, log: Log, column: str, hint: str | None = None) -> None:
    """Raise an error if a sample of a column is flagged as bad; name the first such sample."""
    if bad.any():
        raise InputError(text, file=log.path, column=column, hint=hint, **log.place(int(np.argmax(bad))))


def _warn_missing(log: Log) -> None:
    """Warn of all missing samples of a log in one message.

    Columns share one entry if they have the same number of missing samples and the same longest gap.
    """
    gaps: dict[tuple[int, int], list[str]] = {}
    for name, values in log.columns.items():
        missing = np.isnan(values)
        if missing.any() and not missing.all():
            gaps.setdefault((int(missing.sum()), longest_run(missing)), []).append(name)
    parts = [
        f"{count} of {len(log)} (longest run {run}) in {', '.join(names)}"
        for (count, run), names in sorted(gaps.items())
    ]
    if parts:
        text = f"samples are missing, {'; '.join(parts)}; they are masked, not filled"
        warn("SWM001", f"{log.path.name}: {text}")


def runs(flags: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Return each unbroken sequence of True in an array as (first index, last index + 1), shape (k, 2).

    >>> runs(np.array([True, True, False, True])).tolist()
    [[0, 2], [3, 4]]
    """
    return np.flatnonzero(np.diff(np.concatenate(([0], flags.astype(np.int8), [0])))).reshape(-1, 2)


def unwrap(angle: Array) -> Array:
    """Return an angle, rad, without steps of full turns between its known samples. Missing samples stay NaN.

    >>> unwrap(np.array([3.0, np.nan, -3.0])).round(2).tolist()
    [3.0, nan, 3.28]
    """
    known, values = np.isfinite(angle), np.array(angle, dtype=float)
    values[known] = np.unwrap(values[known])
    return values


def unwrap_angle(name: str, values: Array) -> Array:
    """Return a column without steps of full turns if it is an angle, and otherwise unchanged.

    An angle with a range above :data:`MAX_WRAPPED_RAD` is not wrapped, and is returned unchanged.
    """
    known = values[np.isfinite(values)]
    if not name.endswith("_rad") or not known.size or np.ptp(known) > MAX_WRAPPED_RAD:
        return values
    return unwrap(values)


def longest_run(flags: NDArray[np.bool_]) -> int:
    """Return the number of elements in the longest unbroken sequence of True in an array.

    >>> longest_run(np.array([True, False, True, True]))
    2
    """
    return int(np.max(np.diff(runs(flags)), initial=0))


def warn_units(log: Log) -> None:
    """Warn of columns of a log whose values are unusual for their unit, such as degrees in ``yaw_rad``."""
    for doubt in doubts(log.time_s, log.columns):
        warn("SWM002", f"{log.path.name}, '{doubt.column}': {doubt.text}")


# ---------------------------------------------------------------- writing


def write(path: str | Path, columns: Mapping[str, Any], metadata: Mapping[str, Any] | None = None) -> None:
    """Write a log to a CSV or Parquet file. If writing fails, an existing file is not changed.

    Parameters
    ----------
    columns : mapping of name to array_like, each shape (n,)
        Columns, ``t_s`` first. NaN becomes an empty cell; every other number is written exactly. Columns of
        text are allowed.
    metadata : mapping, optional
        Entries of the ``# key: value`` lines.
    """
    import pandas as pd

    path, frame = Path(path), pd.DataFrame(dict(columns))
    lines = [line for line in yamlio.dumps_flat(metadata or {}).splitlines() if line.strip()]
    pieces = [frame.iloc[start : start + ROWS] for start in range(0, len(frame), ROWS)]
    with atomic.replace_file(path) as temporary, temporary.open("wb") as stream:
        if path.suffix.lower() in tabular.PARQUET_ENDINGS:
            pyarrow = tabular.pyarrow()
            schema = pyarrow.Schema.from_pandas(frame, preserve_index=False)
            schema = schema.with_metadata({**(schema.metadata or {}), b"swimid": "\n".join(lines).encode()})
            # Switch off the dictionary of repeated values in Parquet. Measured values rarely repeat, so that
            # it would only cost time.
            options = {"use_dictionary": False, "write_statistics": False}
            with pyarrow.parquet.ParquetWriter(stream, schema, **options) as writer:
                for piece in pieces:
                    writer.write_table(pyarrow.Table.from_pandas(piece, schema, preserve_index=False))
            return
        stream.writelines(f"# {line}\n".encode() for line in lines)
        heading = frame.iloc[:0].rename(columns=tabular.plain_text)
        stream.write(heading.to_csv(index=False, lineterminator="\n").encode())
        numeric = {kind.name for kind in frame.dtypes} == {"float64"}
        for piece in pieces:
            if numeric:
                stream.write(_print_samples(piece.to_numpy()))
            else:
                piece = piece.map(tabular.plain_text)
                stream.write(piece.to_csv(index=False, header=False, lineterminator="\n").encode())


def _print_samples(samples: NDArray[np.float64]) -> bytes:
    """Return samples, shape (n, k), as lines of CSV with all significant digits."""
    # Format the numbers as a JSON list with pydantic, which is ten times as fast as writing CSV with pandas.
    text = np.frombuffer(bytearray(to_json(samples.ravel().tolist(), inf_nan_mode="constants")), np.uint8)
    text[-1] = ord(",")
    width = samples.shape[1]
    text[np.flatnonzero(text == ord(","))[width - 1 :: width]] = ord("\n")
    return text[1:].tobytes().replace(b"NaN", b"")


# ---------------------------------------------------------------- values that are unusual in the stated unit

# Values that are unusual for the unit of their column cause a warning only. They are still used in this unit.

#: Maximum plausible speed of a swimmer, m/s. Cavitation and muscle power limit it to 10 to 15 m/s.
#: Iosilevskii, G., Weihs, D. (2008). Speed limits on swimming of fishes and cetaceans. J. R. Soc. Interface
#: 5, 329-338.
MAX_SPEED_M_S = 15.0
#: Maximum plausible turn rate of a robot or a fin, rad/s: about ten rotations per second. The fastest escape
#: of a fish and a fin that beats through ±50 degrees at 10 Hz are slower.
MAX_RATE_RAD_S = 60.0
#: Maximum range of an angle for which jumps by a full rotation are removed, rad. An angle with a larger
#: range is already continuous, or is not in radians. The margin over one rotation is for noise.
MAX_WRAPPED_RAD = 2.1 * np.pi
#: Maximum plausible extent of a track along one axis, m. Tanks, pools and fields of view are smaller.
MAX_EXTENT_M = 100.0
#: Minimum median time step and minimum duration, in s, of a record whose times are probably in milliseconds.
#: A record must reach both limits.
MS_STEP_S, MS_DURATION_S = 5.0, 2000.0
#: Minimum plausible time step, and minimum plausible duration, of a record of more than 20 samples, s. Load
#: cells and inertial sensors are sampled at 100 kHz at most, and the fastest stroke of a small fish takes
#: 0.05 s.
SHORT_S, MIN_DURATION_S = 1e-5, 0.05
#: Maximum fraction of the samples of a column whose rate of change may exceed its limit without a warning.
#: Such samples are taken for outliers of the tracking.
OUTLIER_SHARE = 0.05


@dataclass(frozen=True)
class Doubt:
    """Column of a log with unusual values, and a message that names the unit that would explain them."""

    column: str
    text: str


def doubts(time_s: Array, columns: Mapping[str, Array]) -> list[Doubt]:
    """Return the columns of a log whose values are unusual for a swimmer, each with a message on its unit.

    Parameters
    ----------
    time_s : ndarray, shape (n,)
    columns : mapping of str to ndarray, each shape (n,)
        Columns of the log; ``t_s`` may be missing. NaN where a sample is missing.
    """
    found = []
    if len(time_s) > 2 and np.nanmedian(np.diff(time_s)) >= MS_STEP_S and np.ptp(time_s) >= MS_DURATION_S:
        text = "a step of 5 s or more is unusual: state the unit if it is milliseconds (a factor of 1000)"
        found.append(Doubt(TIME, text))
    elif len(time_s) > 20 and (np.nanmedian(np.diff(time_s)) < SHORT_S or np.ptp(time_s) < MIN_DURATION_S):
        span_s = np.ptp(time_s)
        text = f"lasts {span_s:.3g} s at {(len(time_s) - 1) / span_s:.3g} Hz, which is unusual"
        found.append(Doubt(TIME, f"{text}: state the unit of the time"))
    for name, values in columns.items():
        doubt = None if name == TIME else _doubt(name, time_s, values)
        if doubt is not None:
            found.append(Doubt(name, doubt))
    return found


def _doubt(name: str, time_s: Array, values: Array) -> str | None:
    """Return a message on unusual values of a column and their probable unit; None if all are usual."""
    low, high = _ends(values)
    largest = max(-low, high)
    if name.endswith("_rad"):
        tilted = name in ("roll_rad", "pitch_rad") and largest > 1.5 * np.pi
        fall, rise = _ends(np.diff(values))
        wrapped = max(-fall, rise) > 2.2 * np.pi
        bent = name[:3] in ("joi", "cmd") and largest > 2 * np.pi
        if tilted or wrapped or bent:
            return "unusual for radians: state the unit if it is degrees (a factor of 57.3)"
        rate = _usual_rate(time_s, unwrap_angle(name, values))
        if rate > MAX_RATE_RAD_S:
            return f"turns at {rate:.3g} rad/s: state the unit if it is degrees (a factor of 57.3)"
    elif name.endswith("_rad_s") and largest > MAX_RATE_RAD_S:
        return "unusual for rad/s: state the unit if it is degrees per second (a factor of 57.3)"
    elif name in ("x_m", "y_m", "z_m"):
        speed = _usual_rate(time_s, values)
        if speed > MAX_SPEED_M_S:
            return f"moves at {speed:.3g} m/s: state the unit if it is millimetres (a factor of 1000)"
        if high - low > MAX_EXTENT_M:
            return f"extends over {high - low:.3g} m: state the unit if it is millimetres (a factor of 1000)"
    elif name.endswith("_m_s") and largest > MAX_SPEED_M_S:
        return "unusual for m/s: state the unit if it is millimetres per second (a factor of 1000)"
    return None


def _usual_rate(time_s: Array, values: Array) -> float:
    """Return the rate of change that only the fastest :data:`OUTLIER_SHARE` of a channel's samples exceed.

    The unit is that of the channel per s. The returned rate is 0 if the record is too short.
    """
    known = np.isfinite(values) & np.isfinite(time_s)
    t, x = time_s[known], values[known]
    if len(t) < 3 or not np.median(np.diff(t)) > 0:
        return 0.0
    # Compute rates from differences over at least 0.1 s, so that noise or a single jump does not cause a high
    # rate.
    lag = max(1, min(round(0.1 / float(np.median(np.diff(t)))), len(t) // 4))
    steps = t[lag:] - t[:-lag]
    forward = steps > 0
    rates = np.abs(x[lag:] - x[:-lag])[forward] / steps[forward]
    return float(np.quantile(rates, 1.0 - OUTLIER_SHARE)) if len(rates) else 0.0


def _ends(values: Array) -> tuple[float, float]:
    """Return the minimum and the maximum of the numbers in an array; (0, 0) if all elements are NaN."""
    if len(values) == 0:
        return 0.0, 0.0
    low, high = np.nan_to_num([np.fmin.reduce(values), np.fmax.reduce(values)])
    return float(low), float(high)
