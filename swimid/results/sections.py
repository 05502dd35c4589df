"""What a report is made of: one section per result, of few kinds of blocks.

A page, Markdown and JSON are written from the same sections. A new kind of result makes
blocks and needs no drawing code.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

from swimid.results import numbers
from swimid.results.evidence import Check, Evidence, Figure, Image, NoticeRecord, Table, Verdict

Tone = Literal["", "good", "caution", "bad", "muted", "code"]


@dataclass(frozen=True)
class Cell:
    """One cell of a table.

    Attributes
    ----------
    text : str
    tone : str
        How it is set off: a badge in the colour of a verdict, muted, or a name in code type.
    numeric : bool
        Aligned to the right.
    level : float, optional
        -1 to 1: strength of a shade behind the number, by sign.
    """

    text: str
    tone: Tone = ""
    numeric: bool = False
    level: float | None = None


@dataclass(frozen=True)
class Grid:
    """A table; ``folded`` ones open on demand, where the medium can fold."""

    title: str
    columns: list[str]
    rows: list[list[Cell]]
    caption: str = ""
    folded: bool = False


@dataclass(frozen=True)
class Note:
    """A remark set off from the rest, or a list of sentences under a heading."""

    sentences: list[str]
    title: str = ""
    tone: Tone = ""


Block = Grid | Note | Figure | Image


@dataclass(frozen=True)
class Section:
    """One result.

    Attributes
    ----------
    path : Path
        The result file.
    kind : str
        What sort of result it is, in words.
    title : str
    verdict : Verdict
    facts : list of (str, str)
        Short particulars under the title: model, robot, trials.
    blocks : list of Block
        In the order of reading.
    checks, notices, methods, references, provenance
        As in the evidence.
    data : dict
        The result itself, for JSON.
    evidence : Evidence or None
    """

    path: Path
    kind: str
    title: str
    verdict: Verdict
    facts: list[tuple[str, str]] = field(default_factory=list)
    blocks: list[Block] = field(default_factory=list)
    checks: list[Check] = field(default_factory=list)
    notices: list[NoticeRecord] = field(default_factory=list)
    methods: list[str] = field(default_factory=list)
    references: list[str] = field(default_factory=list)
    provenance: dict[str, Any] = field(default_factory=dict)
    data: dict[str, Any] = field(default_factory=dict)
    evidence: Evidence | None = None


def cell(value: str | float | int | bool | None) -> Cell:
    """A value of a table as it is shown; numbers to four significant digits, nothing as a dash."""
    if isinstance(value, str):
        return Cell(value or numbers.NOTHING)
    return Cell(numbers.number(value), numeric=not isinstance(value, bool))


#: A number as :mod:`swimid.results.numbers` writes it, or a dash.
_NUMBER_TEXT = re.compile(r"[(−-]?\d[\d.]*( ± [\d.]+)?\)?( × 10[⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+)?( ?[°%])?|–|")
#: A longer table is folded.
LONG_TABLE = 25


def table_grid(table: Table) -> Grid:
    """A table of the evidence; columns of numbers, or of their texts, are aligned as numbers."""
    rows = [[cell(value) for value in row] for row in table.rows]
    for index in range(len(table.columns)):
        column = [row[index] for row in rows if index < len(row)]
        if all(c.numeric or _NUMBER_TEXT.fullmatch(c.text) for c in column):
            for row in rows:
                if index < len(row):
                    row[index] = replace(row[index], numeric=True)
    return Grid(table.title, table.columns, rows, table.caption, folded=len(rows) > LONG_TABLE)


def mapping_grid(title: str, entries: dict[str, Any], caption: str = "") -> Grid:
    """A table of names and values of a nested mapping, one leaf a row."""
    rows = [[Cell(name, "code"), cell(value)] for name, value in leaves(entries)]
    return Grid(title, ["Quantity", "Value"], rows, caption, folded=True)


def records_grid(title: str, records: Sequence[dict[str, Any]]) -> Grid:
    """A table of several mappings of one kind, one a row: a column for each leaf that any of them has."""
    flat = [dict(leaves(record)) for record in records]
    names = list(dict.fromkeys(name for record in flat for name in record))
    rows: list[list[str | float | None]] = [[record.get(name) for name in names] for record in flat]
    return replace(table_grid(Table(id="", title=title, columns=names, rows=rows)), folded=True)


def is_records(value: Any) -> bool:
    """Whether a value is a list of mappings."""
    return isinstance(value, list | tuple) and bool(value) and all(isinstance(v, dict) for v in value)


def leaves(entries: dict[str, Any], prefix: str = "") -> Iterable[tuple[str, str | float]]:
    """Names and values of the leaves of a nested mapping.

    ``a.b`` is a value inside ``a``, ``a[1].b`` one inside the first of several mappings in ``a``.
    """
    for key, value in entries.items():
        name = f"{prefix}{key}"
        if isinstance(value, dict):
            yield from leaves(value, f"{name}.")
        elif is_records(value):
            for number, record in enumerate(value, 1):
                yield from leaves(record, f"{name}[{number}].")
        elif isinstance(value, list | tuple):
            yield name, ", ".join(_leaf(v) for v in value) or numbers.NOTHING
        elif isinstance(value, str | int | float) and value != "":
            yield name, value
        else:
            yield name, _leaf(value)


def _leaf(value: Any) -> str:
    """A value within a text."""
    if value is None or isinstance(value, int | float):
        return numbers.number(value)
    if isinstance(value, dict):
        return ", ".join(f"{name} {_leaf(v)}" for name, v in leaves(value))
    if isinstance(value, list | tuple):
        return f"({', '.join(_leaf(v) for v in value)})"
    return str(value) or numbers.NOTHING


def words(key: str) -> str:
    """A key as a column heading: ``max_error`` is ``max error``, ``rmse`` is ``RMSE``."""
    text = key.replace("_", " ")
    return text.upper() if key in {"rmse", "nrmse", "aic", "bic", "mae", "vaf"} else text
