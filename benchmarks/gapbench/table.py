"""The table of entries, as markdown."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from benchmarks.gapbench import scoring
from benchmarks.gapbench.scoring import Scored


def markdown(entries: Mapping[str, Sequence[Scored]]) -> str:
    """One column an entry; real cases in a table of their own."""
    columns = [scoring.figures(rows) for rows in entries.values()]
    body = [[row[0].name, *(figure.text for figure in row)] for row in zip(*columns, strict=True)]
    parts = [_table(["figure", *entries], body)]
    real = [[r for r in rows if r.label.kind == "real"] for rows in entries.values()]
    if any(real):
        body = [
            [row[0].label.robot, ", ".join(row[0].label.effects) or "none", *map(scoring.real_text, row)]
            for row in zip(*real, strict=True)
        ]
        parts.append(_table(["recording", "known cause", *entries], body))
    return "\n\n".join(parts) + "\n"


def _table(head: Sequence[str], body: Iterable[Sequence[str]]) -> str:
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    return "\n".join([*lines, *("| " + " | ".join(row) + " |" for row in body)])
