"""Command ``swimid report``, which creates one page with several results and their evidence.

The page is HTML without scripts, or Markdown. There is one template for each of these formats.
"""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Sequence
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

import swimid
from swimid import reading
from swimid.errors import UsageError
from swimid.files import atomic
from swimid.files.provenance import now, sha256
from swimid.notices import CODES, Progress, recorded, silent, warn
from swimid.options import takes
from swimid.results import drawing, numbers
from swimid.results import evidence as ev
from swimid.results.options import Kind, ReportOptions
from swimid.results.parameters import Fitted, value_text
from swimid.results.result import Result, Text, cell_text, is_numeric, load_result

_ENDINGS: dict[str, Kind] = {".html": "html", ".htm": "html", ".md": "md", ".markdown": "md"}
#: Symbol and word that a report shows for each level of a verdict, so that it is legible without colour.
LEVELS = {"good": ("✓", "Good"), "caution": ("!", "Caution"), "bad": ("✕", "Bad")}
CHECKS = {
    "pass": ("✓", "pass", "good"),
    "warn": ("!", "warn", "caution"),
    "fail": ("✕", "fail", "bad"),
    "info": ("i", "info", "muted"),
}
#: Maximum number of panels of figures, and maximum number of tables, that a report shows unfolded for a
#: result. The first figure is always shown. The remaining figures and tables are folded.
MAIN_PANELS, MAIN_TABLES = 3, 1
#: Maximum number of parameters in the figure that compares several fits of one model.
MAX_COMPARED = 6


@takes(ReportOptions)
def report(
    inputs: Sequence[str | Path | Result],
    *,
    options: ReportOptions,
    output: str | Path | None = None,
    progress: Progress = silent,
) -> Text:
    """Create one report page about any number of results. No result is computed again.

    The default title is the title of a single result, or "Identification report" for several results.

    Parameters
    ----------
    inputs : sequence of paths and results
        Parameter files, gap files and logs, each with its ``.evidence.json`` in the same folder, or a folder
        of them, or results in memory.
    output : path, optional
        File to write. With None or ``-`` no file is written.
    progress : Progress
        Progress over the figures that are drawn.

    Returns
    -------
    Result
        ``.document`` is the page (HTML or Markdown); a notebook shows it. ``.save(path)`` writes it.

    Raises
    ------
    InputError
        If a result or its evidence is invalid, or the output cannot be written.
    UsageError
        If there are no inputs, or the output is also an input.

    Examples
    --------
    >>> import swimid
    >>> page = report([swimid.fit_drag("sample_logs/rig/trials.yaml")], format="md")
    >>> print(page.document.splitlines()[0])
    # Rig identification of boxfish: falling-weight
    """
    if not inputs:
        raise UsageError("name at least one result file")
    sources = list(dict.fromkeys(source for given in inputs for source in _sources(given)))
    paths = [source for source in sources if isinstance(source, Path)]
    target, kind = None, options.format or "html"
    if output is not None and str(output) != "-":
        target = atomic.check_writable(output, inputs=[*paths, *map(ev.sidecar, paths)])
        kind = options.format or _ENDINGS.get(target.suffix.lower(), "html")
    results = []
    for source in sources:
        if isinstance(source, Path):
            source = _read(source)
        results.append(source)
    contents = [result.content() for result in results]
    heading = options.title or "Identification report"
    if options.title is None and len(contents) == 1:
        heading = contents[0].title
    created = now()
    digests = {str(result.path): "of nothing: it was in memory" for result in results}
    digests |= {str(path): sha256(path) for path in paths}
    text = render(
        results,
        contents,
        template=f"report.{kind}",
        title=heading,
        created=created,
        digests=digests,
        progress=progress,
    )
    whole = overall(contents)
    lines = [f"{whole.level}: {whole.text}"]
    verdicts = []
    for result, content in zip(results, contents, strict=True):
        lines.append(f"  {result.path.name}: {content.verdict.level}. {content.verdict.text}")
        verdicts.append({"file": str(result.path), **content.verdict.model_dump()})
    data = {"title": heading, "verdict": whole.model_dump(), "results": verdicts}
    if target is None:
        return Text("report", text.rstrip("\n"), data, document=text)
    atomic.write_text(target, text)
    return Text("report", "\n".join(lines), data, [target], document=text)


def _sources(given: str | Path | Result) -> list[Path | Result]:
    """Return the results that an input of a report names: itself, or all results of a folder."""
    if isinstance(given, Result):
        return [given]
    path = Path(given)
    if not path.is_dir():
        return [path]
    found: list[Path | Result] = []
    for place in sorted(path.glob("*.evidence.json"), key=lambda one: one.stat().st_mtime_ns):
        found.append(place.with_name(ev.read(place).result))
    if not found:
        raise UsageError(f"the folder {path} has no result with evidence", hint="name a result file")
    return found


def _read(path: Path) -> Result:
    """Read a result file with its evidence, and add the warnings of the reading to the evidence.

    Warns
    -----
    SWM050
        The evidence is missing.
    """
    with recorded(repeat=True) as raised:
        result = load_result(path)
        shown = result.evidence
        if shown is None:
            shown = result.bare()
            place = ev.sidecar(path).name
            warn("SWM050", f"{path.name} has no evidence beside it ({place}): its checks are not shown")
    notices = [*shown.notices, *(notice for notice in raised if notice not in shown.notices)]
    return replace(result, evidence=shown.model_copy(update={"notices": notices}))


# ---------------------------------------------------------------- page


def overall(contents: Sequence[ev.Evidence]) -> ev.Verdict:
    """Return the verdict on all results of a report together.

    Its level is the worst level among the results. Its text states how many results have this level.
    """
    levels = [shown.verdict.level for shown in contents]
    worst = max(levels, key=list(LEVELS).index)
    count = levels.count(worst)
    verb = {"good": "can be used", "caution": "needs care", "bad": "should not be used"}[worst]
    if len(levels) == 1:
        return ev.Verdict(level=worst, text=f"This result {verb}.", word=contents[0].verdict.word)
    which = f"{count} of {len(levels)} results"
    if count == len(levels):
        which = f"All {count} results"
    if count > 1:
        verb = verb.replace("needs", "need")
    return ev.Verdict(level=worst, text=f"{which} {verb}.")


def render(
    results: Sequence[Result],
    contents: Sequence[ev.Evidence],
    *,
    template: str,
    title: str,
    created: datetime,
    digests: dict[str, str],
    progress: Progress = silent,
) -> str:
    """Return the text of a report page on several results, in HTML or Markdown.

    Parameters
    ----------
    results : sequence of Result
        Results in the report, at least one.
    contents : sequence of Evidence
        Evidence of each result, as :meth:`Result.content` returns it.
    template : str
        Name of the template, ``"report.html"`` or ``"report.md"``.
    title : str
    created : datetime
        Time that is printed at the foot of the page. Reports with the same input and time are identical.
    digests : dict of str to str
        SHA-256 of each result file by its path.
    progress : Progress
        Progress over the figures.
    """
    environment = Environment(
        loader=PackageLoader("swimid.results"),
        autoescape=template.endswith("html"),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.globals.update(
        levels=LEVELS, checks=CHECKS, leaves=ev.leaves, cell=cell_text, numeric=is_numeric
    )
    environment.filters.update(md=_markdown, code=_code, name_of=reading.name_of)
    groups = compared(results)
    folded = [fit for fits, _ in groups for fit in fits]
    shown: list[tuple[ev.Evidence, Result | None]] = [(content, None) for _, content in groups]
    shown += zip(contents, results, strict=True)
    sections = []
    with progress("drawing", total=sum(len(content.figures) for content, _ in shown)) as step:
        for k, (content, result) in enumerate(shown, 1):
            pictures = []
            for n, figure in enumerate(content.figures):
                panels: list[str] = []
                if template.endswith("html"):
                    panels = drawing.for_page(figure, f"{k}-{n}-")
                pictures.append((_explained(figure), panels))
                step()
            section = _parts(content, pictures) | {"anchor": f"r{k}", "folded": result in folded}
            section |= {"kind": "Side by side", "path": None, "next": ""}
            if result is not None:
                command = result.next_command(result.path.name)
                section |= {"kind": result.kind, "path": result.path, "next": command}
            sections.append(section)
    return environment.get_template(template).render(
        title=title,
        version=swimid.__version__,
        created=created,
        verdict=overall(contents),
        results=sections,
        references=list(dict.fromkeys(text for content in contents for text in content.references)),
        warnings=_warnings(results, contents),
        digests=digests,
    )


def _parts(content: ev.Evidence, figures: list[tuple[ev.Figure, list[str]]]) -> dict[str, Any]:
    """Return the variables of the report template for one result.

    Figures and tables that are shown are separate from those that are folded.
    """
    panels = itertools.accumulate(len(figure.panels) for figure in content.figures)
    n_main = max(sum(total <= MAIN_PANELS for total in panels), 1)
    tables = [table for table in content.tables if not table.folded][:MAIN_TABLES]
    verdicts = [check.verdict for check in content.checks]
    counts = [f"{verdicts.count(one)} {one}" for one in ("pass", "warn", "fail") if one in verdicts]
    return {
        "content": content,
        "figures": figures[:n_main],
        "tables": tables,
        "more_figures": figures[n_main:],
        "more_tables": [table for table in content.tables if table not in tables],
        "checks": ", ".join(counts),
    }


def _explained(figure: ev.Figure) -> ev.Figure:
    """Add a remark to the caption of a figure if traces are so long that they are drawn as envelopes."""
    if all(len(trace.x) <= ev.MAX_POINTS for panel in figure.panels for trace in panel.traces):
        return figure
    caption = f"{figure.caption} Long traces are drawn as their envelope."
    return figure.model_copy(update={"caption": caption})


def _warnings(
    results: Sequence[Result], contents: Sequence[ev.Evidence]
) -> list[tuple[str, str, list[tuple[str, str]]]]:
    """Group the warnings of all results by code, without duplicates.

    Return for each code its meaning, and for each warning the name of the result and the text.
    """
    texts: dict[str, list[tuple[str, str]]] = {}
    for result, content in zip(results, contents, strict=True):
        for notice in content.notices:
            entry = (result.path.name, notice.text.removeprefix(f"{result.path.name}, "))
            if entry not in texts.setdefault(notice.code, []):
                texts[notice.code].append(entry)
    return [(code, CODES.get(code, "unknown code"), texts[code]) for code in sorted(texts)]


def _markdown(text: str) -> str:
    """Convert a text to one line of Markdown, with the special characters of Markdown and HTML escaped."""
    plain = " ".join(text.split()).replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
    return re.sub(r"([\\`*\[\]|]|(?<!\w)_|_(?!\w))", r"\\\1", plain)


def _code(text: str) -> str:
    plain = " ".join(str(text).split()).replace("|", "\\|")
    fence = "`" * (max(map(len, re.findall(r"`+", plain)), default=0) + 1)
    if len(fence) > 1:
        plain = f" {plain} "
    return f"{fence}{plain}{fence}"


# ---------------------------------------------------------------- several fits of one model


def compared(results: Sequence[Result]) -> list[tuple[list[Fitted], ev.Evidence]]:
    """Find fits of the same model among the results, and compare their parameters in a table and a figure.

    Return each group of two or more fits with this comparison. Fits belong to a group only if they have the
    same parameters in the same units.
    """
    groups: dict[Any, list[Fitted]] = {}
    for result in results:
        if isinstance(result, Fitted):
            shared = frozenset((n, e.unit) for n, e in result.file.parameters.items() if "[" not in n)
            groups.setdefault((result.file.model, shared), []).append(result)
    return [(fits, _side_by_side(fits)) for fits in groups.values() if len(fits) > 1]


def _side_by_side(fits: Sequence[Fitted]) -> ev.Evidence:
    names = [fit.path.stem for fit in fits]
    rows: list[list[Any]] = []
    panels = []
    for name, first in fits[0].file.parameters.items():
        held = [fit.file.parameters.get(name, first) for fit in fits]
        known = {k: e for k, e in enumerate(held) if e.status == "estimated"}
        if "[" in name or not known:
            continue
        rows.append([name, *map(value_text, held)])
        half = [numbers.Z95 * (e.stderr or math.nan) for e in known.values()]
        points = ev.Trace(x=list(known), y=[e.value for e in known.values()], y_error=half, style="points")
        label = f"{name} ({numbers.unit_text(first.unit) or '1'})"
        panels.append(ev.panel("", label, [points], x_categories=names))
    caption = "Estimates of each file; bars are 95 % intervals."
    return ev.Evidence(
        command="report",
        title=f"{len(fits)} fits of {fits[0].file.model} side by side",
        verdict=overall([fit.content() for fit in fits]),
        tables=[ev.Table(id="compared", title="Parameters", columns=["parameter", *names], rows=rows)],
        figures=[ev.panels("compared", "Estimates", caption, panels[:MAX_COMPARED])],
    )
