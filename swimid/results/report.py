"""Command ``swimid report``, which creates one page with several results and their evidence.

The page is HTML without scripts, or Markdown. There is one template for each of these formats.
"""

from __future__ import annotations

import itertools
import math
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from functools import cached_property
from pathlib import Path
from typing import Any

import swimid
from swimid import reading
from swimid.errors import InputError, UsageError
from swimid.files import atomic
from swimid.files.provenance import now, sha256
from swimid.files.templates import environment
from swimid.notices import Progress, Step, read_codes, record_warnings, silent, warn
from swimid.options import takes
from swimid.results import drawing, numbers
from swimid.results import evidence as ev
from swimid.results.options import Kind, ReportOptions
from swimid.results.parameters import Fitted, estimate_text
from swimid.results.result import Result, Text, cell_text, is_numeric, load_result

_ENDINGS: dict[str, Kind] = {".html": "html", ".htm": "html", ".md": "md", ".markdown": "md"}
#: Symbol and word that a report shows for each level of a verdict, so that it is legible without colour.
LEVEL_SYMBOLS = {"good": ("✓", "Good"), "caution": ("!", "Caution"), "bad": ("✕", "Bad")}
CHECK_SYMBOLS = {
    "pass": ("✓", "pass", "good"),
    "warn": ("!", "warn", "caution"),
    "fail": ("✕", "fail", "bad"),
    "info": ("i", "info", "muted"),
}
#: Maximum number of panels of figures, and maximum number of tables, that a report shows unfolded for one
#: result. The first figure is always unfolded. The remaining figures and tables are folded.
MAIN_PANELS, MAIN_TABLES = 3, 1
#: Maximum number of parameters in the figure that compares several fits of one model.
MAX_COMPARED = 6


class Page(Text):
    """Result of ``report``, whose ``document`` is the text of the page."""

    next_step = "python -m webbrowser {file}"


@takes(ReportOptions)
def report(
    inputs: Sequence[str | Path | Result],
    *,
    options: ReportOptions,
    output: str | Path | None = None,
    progress: Progress = silent,
) -> Page:
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
    sources = list(dict.fromkeys(source for given in inputs for source in _sources(given)))
    if not sources:
        raise UsageError("no result is given", hint="name at least one result file")
    paths = [source for source in sources if isinstance(source, Path)]
    target, kind = None, options.format or "html"
    if output not in (None, "-", Path("-")):
        target = atomic.check_writable(Path(str(output)), inputs=[*paths, *map(ev.sidecar, paths)])
        kind = options.format or _ENDINGS.get(target.suffix.lower(), "html")
    results = [_read(source) for source in sources]
    contents = _make_titles(results)
    heading = options.title or "Identification report"
    if options.title is None and len(contents) == 1:
        heading = contents[0].title
    folder = Path() if target is None else target.parent
    page = ReportPage(results, contents, f"report.{kind}", heading, folder, now())
    text = page.render(progress)
    if target is None:
        return Page("report", text.rstrip("\n"), page.to_dict(), document=text)
    atomic.write_text(target, text)
    return Page("report", page.verdict_lines(), page.to_dict(), [target], document=text)


def _sources(given: str | Path | Result) -> list[Path | Result]:
    """Return the results that an input of a report stands for: one result, or all those of a folder."""
    if isinstance(given, Result):
        return [given]
    path = Path(given)
    if not path.is_dir():
        return [path]
    found: list[Path | Result] = []
    for place in sorted(path.glob("*.evidence.json"), key=lambda one: one.stat().st_mtime_ns):
        name = ev.read(place).result
        if name in ("", ".", ".."):
            text = f"'{name}' is not the name of a result file"
            raise InputError(text, file=place, column="result", hint="make the result again")
        found.append(place.with_name(name))
    if not found:
        raise UsageError(f"the folder {path} has no file *.evidence.json", hint="name a result file")
    return found


def _read(path: Path | Result) -> Result:
    """Read a result file with its evidence file, and add warnings of this reading to the evidence.

    A result in memory is returned as it is.

    Warns
    -----
    SWM050
        The evidence is missing.
    """
    if isinstance(path, Result):
        return path
    with record_warnings(repeat=True) as raised:
        result = load_result(path)
        shown = result.evidence
        if shown is None:
            shown = result.bare()
            place = ev.sidecar(path).name
            warn("SWM050", f"the evidence file {place} is missing: checks of {path.name} are not shown")
    notices = [*shown.notices, *(notice for notice in raised if notice not in shown.notices)]
    return replace(result, evidence=shown.model_copy(update={"notices": notices}))


# ---------------------------------------------------------------- page


def _make_titles(results: Sequence[Result]) -> list[ev.Evidence]:
    """Return the content of each result, with a title that no other result of the page has.

    On a page of several results, each title also names the parameter file of its result. Titles that are
    still equal also name the result file.
    """
    contents = [result.content() for result in results]
    titles = [content.title for content in contents]
    if len(results) > 1:
        about = [getattr(result.document, "params", None) for result in results]
        titles = [f"{one}, {Path(of).name}" if of else one for one, of in zip(titles, about, strict=True)]
    for k, result in enumerate(results):
        title = titles[k] if titles.count(titles[k]) == 1 else f"{titles[k]}, {result.path.name}"
        contents[k] = contents[k].model_copy(update={"title": title})
    return contents


def overall(results: Sequence[Result], contents: Sequence[ev.Evidence]) -> ev.Verdict:
    """Return the verdict on all results of a report together.

    The text begins with the verdict of a diagnosis, if there is one. The level is the worst level among the
    results. Results that are based only on the inputs of a diagnosis with a good verdict describe the model
    before its repair. The text names them, but the level does not depend on them.
    """
    leading = [content for result, content in zip(results, contents, strict=True) if result.leads_page]
    doubts, counted = _sort_by_level(results, contents, leading)
    whole = _worst(counted)
    if len(contents) == 1:
        return whole
    parts = [content.verdict.text for content in leading]
    if not leading or whole.level != "good":
        parts.append(whole.text)
    parts += [f"{level.capitalize()}: {', '.join(names)}." for level, names in doubts.items() if names]
    word = leading[0].verdict.word if leading and leading[0].verdict.level == whole.level else ""
    return ev.Verdict(level=whole.level, text=" ".join(parts), word=word)


def _sort_by_level(
    results: Sequence[Result], contents: Sequence[ev.Evidence], leading: Sequence[ev.Evidence]
) -> tuple[dict[str, list[str]], list[ev.Evidence]]:
    """Return the names of results that are not good, by level, and the evidence that sets the level."""
    solved = [_digests(content) for content in leading if content.verdict.level == "good"]
    names: dict[str, list[str]] = {"bad": [], "caution": [], "before the repair": [], "good": []}
    counted = []
    for result, content in zip(results, contents, strict=True):
        inputs = _digests(content)
        if inputs and not result.leads_page and any(inputs <= digests for digests in solved):
            names["before the repair"].append(result.path.name)
        else:
            counted.append(content)
            names[content.verdict.level].append(result.path.name)
    del names["good"]
    return names, counted


def _digests(content: ev.Evidence) -> set[str]:
    """Return the SHA-256 of each input of a result."""
    return set(content.provenance.get("inputs", {}).values())


def _worst(contents: Sequence[ev.Evidence]) -> ev.Verdict:
    """Return a verdict with the worst level among results, and with the number of results of this level."""
    levels = [shown.verdict.level for shown in contents]
    worst = max(levels, key=list(LEVEL_SYMBOLS).index)
    count = levels.count(worst)
    verb = {"good": "can be used", "caution": "needs care", "bad": "should not be used"}[worst]
    if len(levels) == 1:
        return ev.Verdict(level=worst, text=f"This result {verb}.", word=contents[0].verdict.word)
    which = f"{count} of {len(levels)} results"
    if count == len(levels):
        which = {2: "Both results"}.get(count, f"All {count} results")
    if count > 1:
        verb = verb.replace("needs", "need")
    return ev.Verdict(level=worst, text=f"{which} {verb}.")


@dataclass(frozen=True)
class ReportPage:
    """Content of a report page.

    Attributes
    ----------
    results : sequence of Result
        Results in the report, at least one.
    contents : sequence of Evidence
        Evidence of each result, as :meth:`Result.content` returns it.
    template : str
        Name of the template, ``"report.html"`` or ``"report.md"``.
    title : str
    folder : Path
        Folder of the page, in which the next commands are typed.
    created : datetime
        Time that is printed at the foot of the page. Reports with the same input and time are identical.
    """

    results: Sequence[Result]
    contents: Sequence[ev.Evidence]
    template: str
    title: str
    folder: Path
    created: datetime

    @cached_property
    def digests(self) -> dict[str, str]:
        """SHA-256 of each result file by its path."""
        digests = {}
        for result in self.results:
            digests[str(result.path)] = "of nothing: it was in memory"
            if result.outputs and result.path.exists():
                digests[str(result.path)] = sha256(result.path)
        return digests

    @cached_property
    def verdict(self) -> ev.Verdict:
        """Verdict on all results together."""
        return overall(self.results, self.contents)

    def verdict_lines(self) -> str:
        """Return lines of text: the verdict on all results, then the verdict on each result."""
        lines = [f"{self.verdict.level}: {self.verdict.text}"]
        for result, content in zip(self.results, self.contents, strict=True):
            lines.append(f"  {result.path.name}: {content.verdict.level}. {content.verdict.text}")
        return "\n".join(lines)

    def to_dict(self) -> dict[str, Any]:
        """Return title and verdicts as plain data."""
        verdicts = [
            {"file": str(result.path), **content.verdict.model_dump()}
            for result, content in zip(self.results, self.contents, strict=True)
        ]
        return {"title": self.title, "verdict": self.verdict.model_dump(), "results": verdicts}

    def render(self, progress: Progress = silent) -> str:
        """Return the text of the page, and report the progress over its figures."""
        templates = environment(
            "swimid.results",
            autoescape=self.template.endswith("html"),
            lstrip_blocks=True,
            keep_trailing_newline=True,
        )
        templates.globals.update(
            levels=LEVEL_SYMBOLS, checks=CHECK_SYMBOLS, leaves=ev.leaves, cell=cell_text, numeric=is_numeric
        )
        templates.filters.update(md=_markdown, code=_code, name_of=reading.name_of)
        return templates.get_template(self.template).render(
            title=self.title,
            version=swimid.__version__,
            created=self.created,
            verdict=self.verdict,
            results=self._sections(progress),
            references=list(dict.fromkeys(text for content in self.contents for text in content.references)),
            warnings=_warnings(self.results, self.contents),
            digests=self.digests,
        )

    def _sections(self, progress: Progress) -> list[dict[str, Any]]:
        """Return the template variables of each section: comparisons of fits, then single results."""
        groups = compare_fits(self.results)
        folded = [fit for fits, _ in groups for fit in fits]
        shown: list[tuple[ev.Evidence, Result | None]] = [(content, None) for _, content in groups]
        shown += zip(self.contents, self.results, strict=True)
        sections = []
        with progress("drawing", total=sum(len(content.figures) for content, _ in shown)) as step:
            for k, (content, result) in enumerate(shown, 1):
                section = _parts(content, self._draw(content, k, step))
                section |= {"anchor": f"r{k}", "folded": result in folded}
                section |= {"kind": "Side by side", "path": None, "next": ""}
                if result is not None:
                    command = _next_command(result, content, self.contents, self.folder, self.digests)
                    section |= {"kind": result.kind, "path": result.path, "next": command}
                sections.append(section)
        return sections

    def _draw(self, content: ev.Evidence, number: int, step: Step) -> list[tuple[ev.Figure, list[str]]]:
        """Return each figure with the SVG drawings of its panels; without drawings for Markdown."""
        pictures = []
        for n, figure in enumerate(content.figures):
            panels: list[str] = []
            if self.template.endswith("html"):
                panels = drawing.for_page(figure, f"{number}-{n}-")
            pictures.append((_explain_figure(figure), panels))
            step()
        return pictures


def _next_command(
    result: Result,
    content: ev.Evidence,
    contents: Sequence[ev.Evidence],
    folder: Path,
    digests: Mapping[str, str],
) -> str:
    """Return the command that a user may run next in the folder of the page; empty if there is none.

    There is no command for a result in memory. Commands that make a page, and commands whose result is
    already on the page, are not suggested.
    """
    if not result.path.exists() or "{trials}" not in result.next_step:
        return ""
    used = _digests(content)
    if "{file}" in result.next_step:
        used = {digests[str(result.path)]}
    command = result.next_step.split()[1]
    if any(other.command == command and used <= _digests(other) for other in contents):
        return ""
    return result.next_command(os.path.relpath(result.path, folder), folder)


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
        "check_count": ev.count_checks(content.checks),
    }


def _explain_figure(figure: ev.Figure) -> ev.Figure:
    """Return a figure whose caption also explains the drawing: scales of a path, envelopes of traces."""
    caption = figure.caption
    paths = [drawing.is_to_scale(panel) for panel in figure.panels if panel.equal_aspect]
    if paths:
        remark = "Both axes have the same scale."
        if not any(paths):
            remark = "The vertical axis is magnified: it has another scale than the horizontal axis."
        elif not all(paths):
            remark = "Both axes have the same scale, unless the title says that one is magnified."
        caption = f"{caption} {remark}"
    if any(len(trace.x) > ev.MAX_TRACE_POINTS for panel in figure.panels for trace in panel.traces):
        caption += " Long traces are drawn as their envelope."
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
    return [(code, read_codes().get(code, "unknown code"), texts[code]) for code in sorted(texts)]


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


def compare_fits(results: Sequence[Result]) -> list[tuple[list[Fitted], ev.Evidence]]:
    """Find fits of the same model among the results, and compare their parameters in a table and a figure.

    Return each group of two or more fits with its comparison. Fits of one model form a group only if they
    have the same parameters in the same units.
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
        rows.append([name, *map(estimate_text, held)])
        half = [numbers.Z95 * (e.stderr or math.nan) for e in known.values()]
        points = ev.Trace(x=list(known), y=[e.value for e in known.values()], y_error=half, style="points")
        label = f"{name} ({numbers.unit_text(first.unit) or '1'})"
        panels.append(ev.panel("", label, [points], x_categories=names))
    caption = "Estimates of each file; bars are 95 % intervals."
    return ev.Evidence(
        command="report",
        title=f"{len(fits)} fits of {fits[0].file.model} side by side",
        verdict=_worst([fit.content() for fit in fits]),
        tables=[ev.Table(id="compared", title="Parameters", columns=["parameter", *names], rows=rows)],
        figures=[ev.panels("compared", "Estimates", caption, panels[:MAX_COMPARED])],
    )
