"""The report as one HTML page that needs nothing else: no script, no font, no server."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

import swimid
from swimid.errors import InputError
from swimid.notices import CODES
from swimid.progress import Progress, Step, silent
from swimid.results import evidence as evidence_format
from swimid.results import figures
from swimid.results.evidence import Figure, Verdict
from swimid.results.figures import Drawing
from swimid.results.sections import Block, Grid, Section, leaves

#: Word and symbol of every verdict; colour only comes on top.
LEVELS = {"good": ("✓", "Good"), "caution": ("!", "Caution"), "bad": ("✕", "Bad")}
CHECKS = {
    "pass": ("✓", "pass", "good"),
    "warn": ("!", "warn", "caution"),
    "fail": ("✕", "fail", "bad"),
    "info": ("i", "info", "muted"),
}
_ORDER = ["good", "caution", "bad"]
#: Number of figures and of open tables that stand in the main part of a result; the others are folded.
MAIN_FIGURES, MAIN_TABLES = 2, 1
#: Next command after a result, by the verb that made it. ``{trials}`` is its first input.
NEXT = {
    **dict.fromkeys(
        ("fit-drag", "fit-propulsion", "fit-graybox"),
        "swimid compare {trials} --params {file} -o comparison.yaml",
    ),
    "compare": "swimid diagnose {trials} --params PARAMETERS.yaml -o gap.yaml",
    **dict.fromkeys(("track video", "track imu", "import", "simulate"), "swimid plot {file} -o log.html"),
}


def verdict_badge(verdict: Verdict) -> tuple[str, str]:
    """Symbol and word of a verdict."""
    symbol, word = LEVELS[verdict.level]
    return symbol, verdict.word or word


def overall(sections: Sequence[Section]) -> Verdict:
    """The worst level among the results, and a sentence that says how many have it."""
    levels = [section.verdict.level for section in sections]
    worst = max(levels, key=_ORDER.index)
    count = levels.count(worst)
    words = {
        "good": ("can be used", "can be used"),
        "caution": ("needs care", "need care"),
        "bad": ("should not be used", "should not be used"),
    }[worst]
    if len(levels) == 1:
        return Verdict(level=worst, text=f"This result {words[0]}.", word=sections[0].verdict.word)
    if count == len(levels):
        return Verdict(level=worst, text=f"All {count} results {words[1]}.")
    return Verdict(level=worst, text=f"{count} of {len(levels)} results {words[count > 1]}.")


def warnings_by_code(sections: Sequence[Section]) -> list[tuple[str, str, list[tuple[str, str]]]]:
    """Every warning: code, meaning, and (result, text) of each time it was given."""
    texts: dict[str, list[tuple[str, str]]] = {}
    for section in sections:
        for notice in section.notices:
            name = section.path.name
            entry = (name, notice.text.removeprefix(f"{name}, ").removeprefix(f"{name}: "))
            if entry not in texts.setdefault(notice.code, []):
                texts[notice.code].append(entry)
    return [(code, CODES.get(code, "unknown code"), texts[code]) for code in sorted(texts)]


def references(sections: Sequence[Section]) -> list[str]:
    """What the results cite, each once."""
    return list(dict.fromkeys(text for section in sections for text in section.references))


def render(
    sections: Sequence[Section],
    *,
    title: str,
    created: datetime,
    digests: dict[str, str],
    progress: Progress = silent,
) -> str:
    """The whole page.

    Parameters
    ----------
    sections : sequence of Section
        At least one.
    title : str
        Heading and window title.
    created : datetime
        Printed at the foot; the same input and time give the same page.
    digests : dict of str to str
        SHA-256 of each result file by its path.
    progress : Progress
        Steps once per figure.

    Raises
    ------
    InputError
        When a figure of the evidence contradicts itself.
    """
    total = sum(isinstance(block, Figure) for section in sections for block in section.blocks)
    with progress("drawing", total=total) as step:
        results = [_result(section, f"r{k}", step) for k, section in enumerate(sections, 1)]
    environment = Environment(
        loader=PackageLoader("swimid.results"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.globals.update(levels=LEVELS, checks=CHECKS, leaves=leaves, verdict_badge=verdict_badge)
    return environment.get_template("report.html").render(
        title=title,
        version=swimid.__version__,
        created=created,
        verdict=overall(sections),
        results=results,
        references=references(sections),
        warnings=warnings_by_code(sections),
        digests=digests,
    )


def _result(section: Section, anchor: str, step: Step) -> dict[str, Any]:
    """Return what the template shows of a result: its card, its main blocks and its folded blocks."""
    main: list[dict[str, Any]] = []
    folded: list[dict[str, Any]] = []
    shown = {Figure: 0, Grid: 0}
    lead = None
    for index, block in enumerate(section.blocks, 1):
        kind = type(block)
        limit = {Figure: MAIN_FIGURES, Grid: MAIN_TABLES}.get(kind)
        fits = limit is None or (shown[kind] < limit and not getattr(block, "folded", False))
        if limit is not None and fits:
            shown[kind] += 1
        if isinstance(block, Figure) and lead is None:
            panel = block.model_copy(update={"panels": block.panels[:1]})
            lead = _draw(section, panel, f"{anchor}-lead-")[0]
        place = main if fits else folded
        place.append(_part(section, block, f"{anchor}-{index}", step))
    # figures stand before tables, as in a paper
    folded.sort(key=lambda part: part["kind"] == "grid")
    verdicts = [check.verdict for check in section.checks]
    counts = [f"{verdicts.count(one)} {one}" for one in ("pass", "warn", "fail") if one in verdicts]
    return {
        "section": section,
        "anchor": anchor,
        "main": main,
        "folded": folded,
        "lead": lead,
        "checks": ", ".join(counts),
        "next": _next(section),
    }


def _next(section: Section) -> str:
    """Return the next command after a result; empty if none is known."""
    verb = "" if section.evidence is None else section.evidence.verb
    inputs = section.provenance.get("inputs") or {}
    return NEXT.get(verb, "").format(file=section.path.name, trials=next(iter(inputs), "TRIALS.yaml"))


def _draw(section: Section, figure: Figure, prefix: str) -> list[Drawing]:
    try:
        return figures.draw(figure, prefix)
    except InputError as error:
        file = evidence_format.sidecar(section.path)
        raise InputError(error.reason, file=file, column=error.column) from error


def _part(section: Section, block: Block, anchor: str, step: Step) -> dict[str, Any]:
    """Return a block on its place in the page."""
    drawings: list[Drawing] = []
    if isinstance(block, Figure):
        drawings = _draw(section, block, f"{anchor}-")
        step()
    return {
        "anchor": anchor,
        "kind": type(block).__name__.lower(),
        "block": block,
        "drawings": drawings,
        "shared_legend": len(drawings) > 1 and all(d.legend == drawings[0].legend for d in drawings),
    }
