"""Plain text of a result for a terminal."""

from __future__ import annotations

import re
import textwrap
from typing import Any

from swimid.results import numbers
from swimid.results.evidence import Evidence, Table

#: Maximum width of a line, and minimum width of a column whose texts are shortened, characters.
WIDTH, MIN_CUT = 100, 16
#: Pattern of a number as :mod:`swimid.results.numbers` writes it, of a dash, or of an empty text.
_NUMBER = re.compile(r"(> )?[(−-]?\d[\d.]*( ± [\d.]+)?\)?( × 10[⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+)?( ?[°%])?|–|")


def summary(evidence: Evidence) -> str:
    """Return title, facts, first table, notes and verdict, in lines of at most :data:`WIDTH` characters."""
    facts = "; ".join(f"{name[:1].lower()}{name[1:]} {value}" for name, value in evidence.facts.items())
    parts = [evidence.title, *filter(None, [_wrapped(facts)])]
    open_tables = [table for table in evidence.tables if not table.folded]
    if open_tables:
        parts += ["", table_text(open_tables[0])]
    if evidence.notes:
        parts += ["", *(_wrapped(note) for note in evidence.notes)]
    word = (evidence.verdict.word or evidence.verdict.level).upper()
    verdict = f"{word}: {evidence.verdict.text}"
    passed = sum(check.verdict == "pass" for check in evidence.checks)
    if passed:
        verdict += f" {passed} {('checks pass', 'check passes')[passed == 1]}."
    return "\n".join([*parts, "", textwrap.fill(verdict, WIDTH)])


def _wrapped(text: str) -> str:
    return textwrap.fill(text, WIDTH, initial_indent="  ", subsequent_indent="  ")


def cell_text(value: Any) -> str:
    """Return the text of a table cell: numbers with four significant digits, an empty cell as a dash."""
    if isinstance(value, str):
        return value or numbers.NOTHING
    return numbers.number(value)


def is_numeric(table: Table) -> list[bool]:
    """Return for each column whether all its cells are numbers, so that it is aligned to the right."""
    right = []
    for k in range(len(table.columns)):
        column = [row[k] for row in table.rows]
        right.append(all(not isinstance(v, bool) and _NUMBER.fullmatch(cell_text(v)) for v in column))
    return right


def table_text(table: Table) -> str:
    """Return a table as aligned columns. If lines are too long, texts are shortened or columns omitted."""
    rows = [table.columns, *([cell_text(value) for value in row] for row in table.rows)]
    right, left = is_numeric(table), WIDTH
    columns: list[list[str]] = []
    for k, column in enumerate(zip(*rows, strict=True)):
        width = max(map(len, column))
        left -= width + 2
        if left < 0:
            width += left
            if right[k] or width < MIN_CUT:
                break
            column = tuple(textwrap.shorten(cell, width, placeholder="…") for cell in column)
        columns.append([f"{cell:{'<>'[right[k]]}{width}}" for cell in column])
        if left <= 0:
            break
    return "\n".join(f"  {'  '.join(line)}".rstrip() for line in zip(*columns, strict=True))


#: Suggested next command after the result of each command. ``{trials}`` is the first YAML file among the
#: inputs of the result, ``{params}`` the last.
NEXT = {
    **dict.fromkeys(
        ("fit-drag", "fit-propulsion", "fit-graybox"),
        "swimid compare {trials} --params {file} -o comparison.yaml",
    ),
    "compare": "swimid diagnose {trials} --params {params} -o gap.yaml",
    **dict.fromkeys(("track video", "track imu", "import", "simulate"), "swimid plot {file} -o log.svg"),
    **dict.fromkeys(("diagnose", "rwls", "map", "sensitivity"), "swimid report {file} -o report.html"),
}


def next_command(command: str, file: str, provenance: dict[str, Any]) -> str:
    """Return the suggested next command after a result; empty if there is none."""
    files = [name for name in provenance.get("inputs") or {} if name.endswith((".yaml", ".yml"))]
    trials, *others = files or ["TRIALS.yaml"]
    params = (others or ["PARAMETERS.yaml"])[-1]
    return NEXT.get(command, "").format(file=file, trials=trials, params=params)
