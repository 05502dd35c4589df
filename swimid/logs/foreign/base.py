"""The interface of foreign formats: what a file holds, and its columns in pieces."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from swimid.errors import InputError, nearest
from swimid.files import yamlio

#: One piece of a file: columns by name, all of one length.
Chunk = dict[str, NDArray[Any]]


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
    kind: Literal["number", "time", "text"] = "number"
    rows: int | None = None


class Source(Protocol):
    """One opened file (one topic of it, where it holds several)."""

    #: What it offers, in the file's order; ``"3"`` also means the third.
    columns: list[Column]
    #: What the file says of itself: plain values.
    metadata: dict[str, Any]
    #: Its comment lines, without their mark.
    comments: list[str]
    #: Single numbers beside the columns, a sampling rate for instance.
    scalars: dict[str, float]
    #: What a user should know of how it was read.
    notes: list[str]
    #: Size of the work in the steps that ``chunks`` reports; None where unknown.
    steps: int | None

    def chunks(self, names: Sequence[str], step: Callable[[int], None]) -> Iterator[Chunk]:
        """The named columns piece by piece, in the file's order.

        Numbers come as float64 or integers, dates as ``datetime64[ns]``; NaN or NaT where a
        cell is empty. ``step`` is called with the progress of each piece.
        """
        ...

    def lines(self, count: int) -> NDArray[np.int64] | None:
        """Line of the file of each of ``count`` samples, from 1; None where it has no lines."""
        ...

    def close(self) -> None:
        """Let the file go."""
        ...


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


@dataclass
class Loaded:
    """A :class:`Source` whose columns were read whole: for formats that cannot be read in pieces."""

    values: dict[str, NDArray[Any]]
    metadata: dict[str, Any] = field(default_factory=dict)
    scalars: dict[str, float] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    comments: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        kinds = {"M": "time", "U": "text", "S": "text", "O": "text"}
        self.columns = [Column(n, kinds.get(v.dtype.kind, "number"), len(v)) for n, v in self.values.items()]  # type: ignore[arg-type]
        self.steps: int | None = 1

    def chunks(self, names: Sequence[str], step: Callable[[int], None]) -> Iterator[Chunk]:
        """All of it at once."""
        yield {name: self.values[name] for name in names}
        step(1)

    def lines(self, count: int) -> NDArray[np.int64] | None:
        """Such a file has no lines."""
        return None

    def close(self) -> None:
        """Nothing is held open."""


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


def spread(name: str, values: NDArray[Any]) -> dict[str, NDArray[Any]]:
    """A matrix as its columns ``name[1]``, ``name[2]``, ...; a vector as itself.

    >>> list(spread("acc", np.zeros((5, 3))))
    ['acc[1]', 'acc[2]', 'acc[3]']
    """
    flat = values.reshape(len(values), -1)
    if flat.shape[1] == 1:
        return {name: flat[:, 0]}
    return {f"{name}[{k + 1}]": flat[:, k] for k in range(flat.shape[1])}


def sorted_out(arrays: dict[str, NDArray[Any]]) -> tuple[dict[str, NDArray[Any]], dict[str, float]]:
    """Columns and single numbers of a file of named arrays.

    A row vector is taken as a column; a matrix that is wider than long lies on its side where
    the other arrays say so.
    """
    lengths: dict[int, int] = {}
    for values in arrays.values():
        for n in {size for size in values.shape if size > 1}:
            lengths[n] = lengths.get(n, 0) + 1
    longest = max(lengths, key=lambda n: (lengths[n], n), default=0)
    columns: dict[str, NDArray[Any]] = {}
    scalars: dict[str, float] = {}
    for name, values in arrays.items():
        if values.size == 1 and longest > 1:
            if values.dtype.kind in "iufb":
                scalars[name] = float(values.reshape(-1)[0])
            continue
        if values.ndim > 2 or values.size == 0:
            continue
        lying = (
            values.ndim == 2
            and values.shape[0] != longest
            and (values.shape[1] == longest or values.shape[0] == 1)
        )
        columns.update(spread(name, values.T if lying else values))
    return columns, scalars
