"""Result files and the readers that make sections of them.

A function in the module ``section`` of the room a result belongs to, registered for a ``format:`` of
YAML results or for the ending of other files, makes its section. These modules are found by
themselves: a new kind of result is one new file.
"""

from __future__ import annotations

import importlib.util
import json
import pkgutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import swimid
from swimid.errors import InputError, nearest
from swimid.files import yamlio
from swimid.notices import recorded, warn
from swimid.results import evidence as evidence_format
from swimid.results.evidence import Evidence, NoticeRecord, Verdict
from swimid.results.sections import Cell, Note, Section, table_grid

#: Makes the section of a result from its path, what is read from it, and its evidence.
Builder = Callable[[Path, Any, Evidence | None], Section]


class Reader(NamedTuple):
    """How a kind of result is read, and made a section of."""

    read: Callable[[Path], Any]
    build: Builder


_BY_FORMAT: dict[str, Reader] = {}
_BY_ENDING: dict[str, Reader] = {}


def reader(
    *, format: str | None = None, endings: tuple[str, ...] = (), read: Callable[[Path], Any] = yamlio.load
) -> Callable[[Builder], Builder]:
    """Register how results of a YAML ``format:``, or with certain file endings, become sections.

    Parameters
    ----------
    read : callable
        Gives what the decorated function takes as its second argument; by default the YAML as a mapping.

    Raises
    ------
    ValueError
        When another reader is registered for it.
    """

    def register(function: Builder) -> Builder:
        for key, table in ((format, _BY_FORMAT), *((ending, _BY_ENDING) for ending in endings)):
            if key is None:
                continue
            if key in table:
                raise ValueError(f"two readers for {key}")
            table[key] = Reader(read, function)
        return function

    return register


def _discover() -> None:
    for room in pkgutil.iter_modules(swimid.__path__):
        name = f"swimid.{room.name}.section"
        if room.ispkg and importlib.util.find_spec(name):
            importlib.import_module(name)


def load(path: str | Path) -> Section:
    """One result and its evidence as a section.

    Raises
    ------
    InputError
        When either is broken, or the file is no result.

    Warns
    -----
    SWM050
        The evidence is missing.
    SWM052
        The evidence is that of another run.
    """
    path = Path(path)
    _discover()
    kind = _reader_of(path)
    sidecar = evidence_format.sidecar(path)
    evidence = evidence_format.read(sidecar) if sidecar.exists() else None
    with recorded(repeat=True) as raised:
        section = kind.build(path, kind.read(path), evidence)
    notices = [NoticeRecord(code=notice.code, text=notice.text) for notice in raised]
    if evidence is None:
        text = f"{path.name} has no evidence beside it ({sidecar.name}): its figures and checks are not shown"
        warn("SWM050", text)
        return replace(section, notices=[*section.notices, *notices, NoticeRecord(code="SWM050", text=text)])
    return _joined(section, evidence, notices)


def of_document(name: Path, document: Any, format: str, evidence: Evidence) -> Section:
    """The section of a result that was never written.

    Parameters
    ----------
    name : Path
        What to call it.
    document : object
        What the reader of ``format`` (or of the ending of ``name``) would have read.
    """
    _discover()
    kind = _BY_FORMAT[format] if format else _BY_ENDING[name.suffix.lower()]
    return _joined(kind.build(name, document, evidence), evidence, [])


def _reader_of(path: Path) -> Reader:
    ending = path.suffix.lower()
    if ending in _BY_ENDING:
        return _BY_ENDING[ending]
    if path.name.endswith(".evidence.json"):
        stem = path.name.removesuffix(".evidence.json")
        there = [e for e in (".yaml", ".yml", *_BY_ENDING) if path.with_name(stem + e).exists()]
        result = stem + (there[0] if there else ".yaml")
        raise InputError("is the evidence of a result", file=path, hint=f"name the result itself: {result}")
    if ending not in {".yaml", ".yml"}:
        allowed = ", ".join([".yaml", *sorted(_BY_ENDING)])
        raise InputError(f"is no result file: its ending must be one of {allowed}", file=path)
    form = yamlio.load(path).get("format")
    if form not in _BY_FORMAT:
        what = "has no 'format'" if form is None else f"its format '{form}' is none a report can show"
        close = nearest(str(form), sorted(_BY_FORMAT))
        hint = f"did you mean '{close}'?" if close else f"known: {', '.join(sorted(_BY_FORMAT))}"
        raise InputError(what, file=path, line=1, column="format", hint=hint)
    return _BY_FORMAT[form]


def _joined(section: Section, evidence: Evidence, notices: list[NoticeRecord]) -> Section:
    """The section with its evidence, after making sure that they belong together."""
    blocks = [
        *section.blocks,
        *evidence.figures,
        *evidence.images,
        *(table_grid(table) for table in evidence.tables),
    ]
    verdict = evidence.verdict
    kept = [*evidence.notices, *(notice for notice in notices if notice not in evidence.notices)]
    difference = _difference(section.provenance, evidence.provenance)
    if difference:
        text = (
            f"the evidence of {section.path.name} is from another run ({difference} differ): "
            "its figures, checks and tables may not describe these numbers"
        )
        warn("SWM052", text)
        kept.append(NoticeRecord(code="SWM052", text=text))
        blocks.insert(0, Note([_sentence(text)], tone="bad"))
        level = verdict.level if verdict.level == "bad" else "caution"
        verdict = Verdict(level=level, text=f"Evidence and result do not belong together. {verdict.text}")
    return replace(
        section,
        title=evidence.title,
        verdict=verdict,
        blocks=blocks,
        checks=list(evidence.checks),
        notices=kept,
        methods=list(evidence.methods),
        references=list(evidence.references),
        provenance=section.provenance or evidence.provenance,
        evidence=evidence,
    )


def _sentence(text: str) -> str:
    return text[0].upper() + text[1:] + "."


def _difference(result: dict[str, Any], evidence: dict[str, Any]) -> str:
    """Names of the provenance keys both have and that differ; empty where nothing contradicts."""
    if not result:
        return ""

    def same(value: Any) -> Any:
        return json.loads(json.dumps(yamlio.plain(value), default=str))

    keys = [key for key in ("created", "command", "version", "inputs", "settings") if key in result]
    return ", ".join(key for key in keys if same(result[key]) != same(evidence.get(key)))


def status_cell(status: str) -> Cell:
    """The status of a parameter as a badge."""
    tones: dict[str, Any] = {
        "estimated": "good",
        "fixed": "muted",
        "at-bound": "caution",
        "unidentifiable": "bad",
    }
    labels = {"at-bound": "at its bound", "unidentifiable": "not identifiable"}
    return Cell(labels.get(status, status), tones.get(status, ""))
