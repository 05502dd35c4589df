"""The interface of foreign formats: what a file holds, and its columns in pieces."""

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

#: One piece of a file: columns by name, all of one length.
Chunk = dict[str, NDArray[Any]]
Kind = Literal["number", "time", "text"]


class Options(yamlio.Document):
    """How to read the file, where that cannot be told from the file itself (``reader:``)."""

    #: The format, where neither ending nor content says it.
    kind: str | None = None
    #: Between the cells of a text file: one character, ``tab`` or ``whitespace``.
    delimiter: Annotated[str, Field(min_length=1, max_length=10)] | None = None
    #: Whether a line of names stands above the samples.
    header: bool | None = None
    #: Lines before the header, or before the samples.
    skip_rows: Annotated[int, Field(ge=0)] | None = None
    #: Cells that mean "no sample", beside the empty cell and ``nan``.
    missing: list[float | str] = []
    #: Lines that begin with this are no samples.
    comment: Annotated[str, Field(min_length=1, max_length=4)] = "#"
    decimal: Literal[".", ","] | None = None
    encoding: str | None = None
    #: Topic of a recording that holds several.
    topic: str | None = None
    #: Group or struct of a file that holds several.
    dataset: str | None = None


@dataclass(frozen=True)
class Column:
    """One column a file offers.

    Attributes
    ----------
    name : str
        As a mapping names it. Of a matrix ``acc`` the columns are ``acc[1]``, ``acc[2]``, ...
    kind : {"number", "time", "text"}
        ``time`` holds dates, which come as ``datetime64[ns]``.
    rows : int or None
        How many, where that is known without reading the file.
    """

    name: str
    kind: Kind = "number"
    rows: int | None = None


@dataclass(eq=False)
class Source:
    """One opened file (one topic of it, where it holds several).

    Attributes
    ----------
    columns : list of Column
        What it offers, in the file's order; ``"3"`` also means the third.
    metadata : dict
        What the file says of itself: plain values.
    scalars : dict of str to float
        Single numbers beside the columns, a sampling rate for instance.
    notes : list of str
        What a user should know of how it was read.
    comments : list of str
        Its comment lines, without their mark.
    steps : int or None
        Size of the work in the steps that ``chunks`` reports; None where unknown.
    """

    columns: list[Column]
    metadata: dict[str, Any] = field(default_factory=dict)
    scalars: dict[str, float] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    comments: list[str] = field(default_factory=list)
    steps: int | None = None

    def chunks(self, names: Sequence[str], step: Callable[[int], None]) -> Iterator[Chunk]:
        """The named columns piece by piece, in the file's order.

        Numbers come as float64 or integers, dates as ``datetime64[ns]``; NaN or NaT where a
        cell is empty. ``step`` is called with the progress of each piece.
        """
        raise NotImplementedError

    def lines(self, count: int) -> NDArray[np.int64] | None:
        """Line of the file of each of ``count`` samples, from 1; None where it has no lines."""
        return None

    def close(self) -> None:
        """Let the file go, where it is held open."""


@dataclass(frozen=True)
class Reader:
    """One foreign format.

    Attributes
    ----------
    name : str
        For ``reader: {kind: name}``.
    title : str
        In words.
    endings : tuple of str
        File endings that mean this format, with their dot.
    open : callable
        ``open(path, options) -> Source``.
    magic : tuple of bytes
        What such a file begins with; it decides before the ending does.
    extra : str
        The optional dependency to install, ``"mcap"`` for ``pip install swimid[mcap]``.
    """

    name: str
    title: str
    endings: tuple[str, ...]
    open: Callable[[Path, Options], Source]
    magic: tuple[bytes, ...] = ()
    extra: str = ""


class Loaded(Source):
    """A :class:`Source` whose columns were read whole: for formats that cannot be read in pieces."""

    def __init__(self, values: dict[str, NDArray[Any]], **more: Any) -> None:
        columns = [Column(name, kind_of(column), len(column)) for name, column in values.items()]
        super().__init__(columns, steps=1, **more)
        self._values = values

    def chunks(self, names: Sequence[str], step: Callable[[int], None]) -> Iterator[Chunk]:
        """All of it at once."""
        yield {name: self._values[name] for name in names}
        step(1)


def kind_of(values: NDArray[Any]) -> Kind:
    """What an array holds, as a :class:`Column` says it."""
    return "time" if values.dtype.kind == "M" else "text" if values.dtype.kind in "USO" else "number"


def dates(texts: Any) -> NDArray[Any]:
    """Dates in ISO 8601 as ``datetime64[ns]``, UTC; NaT for what is none."""
    import pandas as pd

    parsed = pd.to_datetime(pd.Series(texts, dtype=object), errors="coerce", format="ISO8601", utc=True)
    return parsed.dt.tz_localize(None).to_numpy(dtype="datetime64[ns]")


@contextmanager
def reading(path: Path, what: str) -> Iterator[None]:
    """What a library raises of a damaged file becomes an :class:`InputError`: it is no readable ``what``."""
    try:
        yield
    except (InputError, ImportError):
        raise
    except Exception as error:
        raise InputError(f"is no readable {what}: {first_line(error)}", file=path) from error


def flat(
    value: Any, deepest: int, fields: Callable[[Any], Any] = lambda value: value, name: str = ""
) -> Iterator[tuple[str, Any]]:
    """What a nested record holds by its dotted names, of lists up to 100 long ``name[1]``, ``name[2]``, ...

    ``fields`` makes a dict of what has parts, and leaves the rest as it is.
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


def one_of(wanted: str | None, known: Sequence[str], *, file: Path, what: str, key: str) -> str:
    """The topic or group asked for, or the only one there is.

    Raises
    ------
    InputError
        When it is not there, or none was named and there are several.
    """
    if not known:
        raise InputError(f"holds no {what} with samples", file=file)
    if wanted is None:
        if len(known) > 1:
            raise InputError(
                f"holds {len(known)} {what}s; the mapping must name one",
                file=file,
                hint=f"write reader: {{{key}: ...}} with one of: {', '.join(known[:20])}",
            )
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
) -> Loaded:
    """A file of named arrays: its columns, of a matrix ``name[1]``, ``name[2]``, ..., and its single numbers.

    A row vector is taken as a column; a matrix that is wider than long lies on its side where
    the other arrays say so.

    Raises
    ------
    InputError
        When there is no column; ``hint`` says what to do.
    """
    lengths = Counter(size for values in arrays.values() for size in {n for n in values.shape if n > 1})
    longest = max(lengths, key=lambda n: (lengths[n], n), default=0)
    columns: dict[str, NDArray[Any]] = {}
    scalars: dict[str, float] = {}
    for name, values in arrays.items():
        if values.size == 1 and longest > 1:
            scalars[name] = float(values.reshape(-1)[0])
        elif values.ndim <= 2 and values.size:
            if (
                values.ndim == 2
                and len(values) != longest
                and (values.shape[1] == longest or len(values) == 1)
            ):
                values = values.T
            matrix = values.reshape(len(values), -1)
            single = matrix.shape[1] == 1
            columns |= {name if single else f"{name}[{k}]": part for k, part in enumerate(matrix.T, start=1)}
    if not columns:
        raise InputError("holds no columns of numbers", file=path, hint=hint)
    return Loaded(columns, metadata=metadata or {}, scalars=scalars)
