"""A result as plain text for a terminal."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Sequence
from typing import Any

from swimid.results import numbers
from swimid.results.evidence import Evidence, Table

#: Maximum width of a line.
WIDTH = 100
#: A number as :mod:`swimid.results.numbers` writes it, or a dash.
_NUMBER = re.compile(r"[(−-]?\d[\d.]*( ± [\d.]+)?\)?( × 10[⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+)?( ?[°%])?|–|")


def summary(evidence: Evidence) -> str:
    """Return title, facts, first table, notes and verdict, in lines of at most :data:`WIDTH` characters."""
    facts = "; ".join(f"{name[:1].lower()}{name[1:]} {value}" for name, value in evidence.facts.items())
    parts = [evidence.title, *([_wrapped(facts)] if facts else [])]
    open_tables = [table for table in evidence.tables if not table.folded]
    if open_tables:
        parts += ["", table_text(open_tables[0])]
    if evidence.notes:
        parts += ["", *(_wrapped(note) for note in evidence.notes)]
    passed = sum(check.verdict == "pass" for check in evidence.checks)
    counted = f" ({passed} checks pass)" if passed else ""
    word = (evidence.verdict.word or evidence.verdict.level).upper()
    verdict = f"{word}{counted}: {evidence.verdict.text}"
    return "\n".join([*parts, "", textwrap.fill(verdict, WIDTH)])


def _wrapped(text: str) -> str:
    return textwrap.fill(text, WIDTH, initial_indent="  ", subsequent_indent="  ")


def cell_text(value: Any) -> str:
    """Return a value of a table as it is shown; numbers to four significant digits, nothing as a dash."""
    if isinstance(value, str):
        return value or numbers.NOTHING
    return numbers.number(value)


def is_numeric(table: Table) -> list[bool]:
    """Return for each column whether it holds numbers, or texts of numbers, and is aligned to the right."""
    columns = zip(*table.rows, strict=True) if table.rows else [[] for _ in table.columns]
    return [
        all(not isinstance(value, bool) and _NUMBER.fullmatch(cell_text(value)) for value in column)
        for column in columns
    ]


def table_text(table: Table) -> str:
    """Return a table as aligned columns; the last columns are left out where the line is full."""
    rows = [table.columns, *([cell_text(value) for value in row] for row in table.rows)]
    widths = [max(len(row[k]) for row in rows) for k in range(len(table.columns))]
    right = is_numeric(table)
    room = [k for k in range(len(widths)) if sum(widths[: k + 1]) + 2 * (k + 1) <= WIDTH]
    return "\n".join(_line(row, widths, right, room) for row in rows)


def _line(row: Sequence[str], widths: list[int], right: list[bool], columns: list[int]) -> str:
    cells = [row[k].rjust(widths[k]) if right[k] else row[k].ljust(widths[k]) for k in columns]
    return f"  {'  '.join(cells)}".rstrip()


#: Next command after a result, by the command that made it. ``{trials}`` is its first input.
NEXT = {
    **dict.fromkeys(
        ("fit-drag", "fit-propulsion", "fit-graybox"),
        "swimid compare {trials} --params {file} -o comparison.yaml",
    ),
    "compare": "swimid diagnose {trials} --params PARAMETERS.yaml -o gap.yaml",
    **dict.fromkeys(("track video", "track imu", "import", "simulate"), "swimid plot {file} -o log.html"),
    **dict.fromkeys(("diagnose", "rwls", "map", "sensitivity"), "swimid report {file} -o report.html"),
}


def next_command(verb: str, file: str, provenance: dict[str, Any]) -> str:
    """Return the next command after a result; empty if none is known."""
    inputs = provenance.get("inputs") or {}
    return NEXT.get(verb, "").format(file=file, trials=next(iter(inputs), "TRIALS.yaml"))
