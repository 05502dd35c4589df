"""The interface of file formats: a reader makes a :class:`Table` of a file."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from swimid.errors import InputError, first_line, nearest
from swimid.files import yamlio


class Options(yamlio.Document):
    """How to read the file, where the file itself does not say it (``reader:`` of a mapping)."""

    #: The format, where neither ending nor content says it.
    kind: str | None = None
    #: Delimiter of a text file: one character, ``tab`` or ``whitespace``.
    delimiter: Annotated[str, Field(min_length=1, max_length=10)] | None = None
    #: Whether a line of names stands above the samples.
    header: bool | None = None
    #: Number of lines before the header, or before the samples.
    skip_rows: Annotated[int, Field(ge=0)] | None = None
    #: Cells that mean "no sample", besides the empty cell and ``nan``.
    missing: list[float | str] = []
    #: Lines that begin with this are comments.
    comment: Annotated[str, Field(min_length=1, max_length=4)] = "#"
    decimal: Literal[".", ","] | None = None
    encoding: str | None = None
    #: Topic of a recording that holds several.
    topic: str | None = None
    #: Group or struct of a file that holds several.
    dataset: str | None = None


@dataclass(eq=False)
class Table:
    """The samples of one file (one topic of it, if it holds several).

    Attributes
    ----------
    columns : dict of str to ndarray, each shape (n,)
        In the order of the file: numbers, dates (``datetime64[ns]``, UTC) or text (``object``). The columns
        of a matrix ``acc`` are ``acc[1]``, ``acc[2]``, ...
    units : dict of str to str
        Units that the file states, by column.
    metadata : dict
        What the file says about itself: plain values.
    scalars : dict of str to float
        Single numbers beside the columns, a sampling rate for instance.
    notes : list of str
        Problems of the reading that a user must know.
    comments : list of str
        Comment lines, without their mark.
    lines : ndarray of int, shape (n,), or None
        Line of the file of each row, from 1; None for a file without lines.
    """

    columns: dict[str, NDArray[Any]]
    units: dict[str, str] = field(default_factory=dict)
    metadata: dict[str, Any] = field(default_factory=dict)
    scalars: dict[str, float] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    comments: list[str] = field(default_factory=list)
    lines: NDArray[np.int64] | None = None

    def column(self, key: str | int, path: Path) -> str:
        """Return the name of a column given by its name, or by its number from 1.

        Raises
        ------
        InputError
            There is no such column; names the nearest.
        """
        names = list(self.columns)
        if isinstance(key, str) and key in names:
            return key
        if isinstance(key, int) or key.isdecimal():
            if not 1 <= int(key) <= len(names):
                raise InputError(f"has {len(names)} columns, no column {key}", file=path)
            return names[int(key) - 1]
        loose = [name for name in names if name.strip().lower() == key.strip().lower()]
        if len(loose) == 1:
            return loose[0]
        close = nearest(key, names)
        hint = f"did you mean '{close}'?" if close else f"the file has: {', '.join(names[:30])}"
        raise InputError("there is no such column", file=path, column=key, hint=hint)

    def place(self, row: int) -> dict[str, int]:
        """Return where a row stands, for an :class:`InputError`: its line, or its row from 1."""
        return {"row": row + 1} if self.lines is None else {"line": int(self.lines[row])}


@dataclass(frozen=True)
class Reader:
    """One file format.

    Attributes
    ----------
    name : str
        For ``reader: {kind: name}``.
    title : str
        In words.
    endings : tuple of str
        File endings of this format, with their dot.
    open : callable
        ``open(path, options) -> Table``.
    magic : tuple of bytes
        First bytes of such a file; they decide before the ending does.
    extra : str
        The optional dependency to install, ``"mcap"`` for ``pip install swimid[mcap]``.
    """

    name: str
    title: str
    endings: tuple[str, ...]
    open: Callable[[Path, Options], Table]
    magic: tuple[bytes, ...] = ()
    extra: str = ""


def is_text(values: NDArray[Any]) -> bool:
    """Return whether a column holds text."""
    return values.dtype.kind in "USO"


@contextmanager
def reading(path: Path, what: str) -> Iterator[None]:
    """Turn every exception of a library into an :class:`InputError`: the file is no readable ``what``."""
    try:
        yield
    except (InputError, ImportError):
        raise
    except Exception as error:
        raise InputError(f"is no readable {what}: {first_line(error)}", file=path) from error


def flat(
    value: Any, deepest: int, fields: Callable[[Any], Any] = lambda value: value, name: str = ""
) -> Iterator[tuple[str, Any]]:
    """Yield the values of a nested record by their dotted names.

    Elements of lists with up to 100 elements are ``name[1]``, ``name[2]``, ... ``fields`` turns a value that
    has parts into a dict and returns any other as it is.
    """
    value = fields(value) if deepest > 0 else value
    if isinstance(value, dict) and deepest > 0:
        for key, inner in value.items():
            yield from flat(inner, deepest - 1, fields, f"{name}.{key}" if name else str(key))
    elif isinstance(value, list | tuple | np.ndarray) and deepest > 0 and len(value) <= 100:
        for at, inner in enumerate(value, start=1):
            yield from flat(inner, deepest - 1, fields, f"{name}[{at}]")
    else:
        yield name, value


def of_records(records: Sequence[dict[str, Any]]) -> dict[str, NDArray[Any]]:
    """Return the columns of flat records: numbers (NaN where a record lacks one), dates or text."""
    import pandas as pd

    columns: dict[str, NDArray[Any]] = {}
    for name in dict.fromkeys(key for record in records for key in record):
        values = [record.get(name) for record in records]
        known = [value for value in values if value is not None]
        if any(isinstance(value, str) for value in known):
            columns[name] = np.array(values, dtype=object)
        elif known and all(isinstance(value, np.datetime64) for value in known):
            columns[name] = np.array(values, dtype="datetime64[ns]")
        elif known and all(isinstance(value, bool | int | float | np.number) for value in known):
            # a whole number of hundreds of digits is no measurement
            numbers = pd.to_numeric(pd.Series(values, dtype=object), errors="coerce")
            columns[name] = numbers.to_numpy(dtype=numbers.dtype if numbers.dtype.kind in "iu" else float)
    return columns


def one_of(wanted: str | None, known: Sequence[str], *, file: Path, what: str, key: str) -> str:
    """Return the topic or group that was asked for, or the only one there is.

    Raises
    ------
    InputError
        It is not there, or none was named and there are several.
    """
    if not known:
        raise InputError(f"holds no {what} with samples", file=file)
    if wanted is None:
        if len(known) > 1:
            text = f"holds {len(known)} {what}s; name one"
            raise InputError(text, file=file, hint=f"{key} one of: {', '.join(known[:20])}")
        return known[0]
    if wanted not in known:
        close = nearest(wanted, list(known))
        hint = f"did you mean '{close}'?" if close else f"it holds: {', '.join(known[:20])}"
        raise InputError(f"holds no {what} '{wanted}'", file=file, hint=hint)
    return wanted


def of_arrays(
    arrays: dict[str, NDArray[Any]],
    path: Path,
    metadata: dict[str, Any] | None = None,
    *,
    hint: str | None = None,
) -> Table:
    """Return the table of a file of named arrays.

    The columns of a matrix are ``name[1]``, ``name[2]``, ... A row vector is one column. A matrix that is
    wider than long is transposed if the other arrays have its width as their length. Single numbers become
    scalars.

    Raises
    ------
    InputError
        There is no column; ``hint`` says what to do.
    """
    lengths = Counter(size for values in arrays.values() for size in {n for n in values.shape if n > 1})
    longest = max(lengths, key=lambda n: (lengths[n], n), default=1)
    columns: dict[str, NDArray[Any]] = {}
    scalars: dict[str, float] = {}
    for name, values in arrays.items():
        if values.size == 1 and longest > 1:
            scalars[name] = float(values.reshape(-1)[0])
        elif values.ndim <= 2 and values.size:
            if values.ndim == 2 and len(values) != longest and longest in values.shape[1:]:
                values = values.T
            if values.ndim == 2 and len(values) == 1:
                values = values.T
            matrix = values.reshape(len(values), -1)
            single = matrix.shape[1] == 1
            columns |= {name if single else f"{name}[{k}]": part for k, part in enumerate(matrix.T, start=1)}
    if not columns:
        raise InputError("holds no columns of numbers", file=path, hint=hint)
    return Table(columns, metadata=metadata or {}, scalars=scalars)
