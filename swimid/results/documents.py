"""The report as Markdown and as one JSON document."""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import datetime
from typing import Any

import swimid
from swimid.files import yamlio
from swimid.results.evidence import Figure, Image, Verdict
from swimid.results.page import CHECKS, overall, references, verdict_badge, warnings_by_code
from swimid.results.sections import Block, Grid, Note, Section, leaves

#: ``format`` of the JSON report.
FORMAT = "swimid-report/1"


def as_json(
    sections: Sequence[Section], *, title: str, created: datetime, digests: dict[str, str]
) -> dict[str, Any]:
    """All results and their evidence, at full precision, as plain data."""
    verdict = overall(sections)
    return {
        "format": FORMAT,
        "title": title,
        "created": created.isoformat(timespec="seconds"),
        "version": swimid.__version__,
        "verdict": verdict.model_dump(include={"level", "text"}),
        "results": [
            {
                "file": str(section.path),
                "sha256": digests[str(section.path)],
                "kind": section.kind,
                "title": section.title,
                "verdict": section.verdict.model_dump(),
                "notices": [notice.model_dump() for notice in section.notices],
                "provenance": yamlio.plain(section.provenance),
                "result": yamlio.plain(section.data),
                "evidence": None if section.evidence is None else section.evidence.model_dump(mode="json"),
            }
            for section in sections
        ],
    }


def as_markdown(
    sections: Sequence[Section], *, title: str, created: datetime, digests: dict[str, str]
) -> str:
    """The report as Markdown; figures appear by title and caption."""
    whole = overall(sections)
    lines = [f"# {_text(title)}", "", f"{_badge(whole)} {_text(whole.text)}", ""]
    for section in sections:
        verdict = section.verdict
        lines.append(f"- {_badge(verdict)} {_text(section.title)}: {_text(verdict.text)}")
    lines += ["", "## Checks", "", *_checks(sections)]
    for section in sections:
        lines += ["", f"## {_text(section.title)}", "", f"{section.kind}, {_code(section.path.name)}"]
        if section.facts:
            lines += ["", *(f"- {_text(name)}: {_text(value)}" for name, value in section.facts)]
        for block in section.blocks:
            lines += ["", *_block(block)]
    if any(section.methods for section in sections):
        lines += ["", "## Methods"]
        lines += [line for s in sections if s.methods for line in ("", _text(" ".join(s.methods)))]
    cited = [f"{number}. {_text(text)}" for number, text in enumerate(references(sections), start=1)]
    if cited:
        lines += ["", "## References", "", *cited]
    lines += ["", "## Warnings", ""]
    entries = [
        f"- {_code(code)} {_text(meaning)} ({_code(file)}): {_text(text)}"
        for code, meaning, texts in warnings_by_code(sections)
        for file, text in texts
    ]
    lines += entries or ["None."]
    lines += ["", "## Provenance"]
    for section in sections:
        lines += ["", f"### {_text(section.title)}", ""]
        lines.append(f"- result: {_code(str(section.path))}, SHA-256 {_code(digests[str(section.path)])}")
        lines += [f"- {_text(key)}: {_code(str(value))}" for key, value in leaves(section.provenance)]
    stamp = created.strftime("%Y-%m-%d %H:%M:%S")
    lines += ["", f"Made by swimid {swimid.__version__} on {stamp} UTC. Nothing was computed again."]
    return "\n".join(lines) + "\n"


def _badge(verdict: Verdict) -> str:
    return f"**{' '.join(verdict_badge(verdict))}.**"


def _checks(sections: Sequence[Section]) -> list[str]:
    rows = [
        [*map(_text, (s.title, c.name, c.value, c.limit)), " ".join(CHECKS[c.verdict][:2]), _text(c.text)]
        for s in sections
        for c in s.checks
    ]
    return _table(["Result", "Check", "Value", "Limit", "Verdict", "Meaning"], rows) if rows else ["None."]


def _block(block: Block) -> list[str]:
    if isinstance(block, Figure | Image):
        kind = "Figure" if isinstance(block, Figure) else "Picture"
        return [f"**{kind}: {_text(block.title)}.** {_text(block.caption)}"]
    if isinstance(block, Note):
        heading = [f"### {_text(block.title)}", ""] if block.title else []
        return [*heading, *(f"- {_text(sentence)}" for sentence in block.sentences)]
    return [f"### {_text(block.title)}", "", *_grid(block)]


def _grid(grid: Grid) -> list[str]:
    rows = [[_code(c.text) if c.tone == "code" else _text(c.text) for c in row] for row in grid.rows]
    numeric = [
        bool(grid.rows) and index < len(grid.rows[0]) and grid.rows[0][index].numeric
        for index in range(len(grid.columns))
    ]
    lines = _table([_text(column) for column in grid.columns], rows, numeric)
    return [*lines, "", _text(grid.caption)] if grid.caption else lines


def _table(columns: list[str], rows: list[list[str]], numeric: list[bool] | None = None) -> list[str]:
    rule = ["---:" if right else "---" for right in numeric or [False] * len(columns)]
    return [f"| {' | '.join(row)} |" for row in ([name or " " for name in columns], rule, *rows)]


def _text(text: str) -> str:
    """Text without meaning to Markdown or HTML, on one line."""
    plain = " ".join(text.split())
    plain = plain.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
    return re.sub(r"([\\`*\[\]|]|(?<!\w)_|_(?!\w))", r"\\\1", plain)


def _code(text: str) -> str:
    plain = " ".join(text.split()).replace("|", "\\|")
    longest = max((len(run) for run in re.findall(r"`+", plain)), default=0)
    fence = "`" * (longest + 1)
    return f"{fence} {plain} {fence}" if longest else f"`{plain}`"
