"""Command ``report``: one page with results and their evidence."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import swimid
from swimid.errors import UsageError
from swimid.files import atomic, yamlio
from swimid.files.provenance import sha256
from swimid.notices import recorded, warn
from swimid.options import takes
from swimid.progress import Progress, silent
from swimid.results import blocks, page
from swimid.results.evidence import Evidence, sidecar
from swimid.results.kinds import load_result
from swimid.results.options import Kind, ReportOptions
from swimid.results.result import Result, Text

#: ``format`` of the JSON report.
FORMAT = "swimid-report/1"
_ENDINGS: dict[str, Kind] = {".html": "html", ".htm": "html", ".md": "md", ".markdown": "md", ".json": "json"}


@takes(ReportOptions)
def report(
    inputs: Sequence[str | Path | Result],
    *,
    options: ReportOptions,
    output: str | Path | None = None,
    progress: Progress = silent,
) -> Text:
    """Write one document about any number of result files. No result is computed again.

    The default title is the title of a single result, or "Identification report" for several results.

    Parameters
    ----------
    inputs : sequence of paths and results
        Parameter files, gap files and logs, each with its ``.evidence.json`` in the same folder, or results
        in memory.
    output : path, optional
        File to write. With None or ``-`` no file is written.
    progress : Progress
        Progress over the files that are read and the figures that are drawn.

    Returns
    -------
    Result
        ``.document`` is the page (HTML, Markdown or JSON); a notebook shows it. ``.save(path)`` writes it.

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
    sources = list(dict.fromkeys(i if isinstance(i, Result) else Path(i) for i in inputs))
    paths = [source for source in sources if isinstance(source, Path)]
    target, kind = None, options.format or "html"
    if output is not None and str(output) != "-":
        target = atomic.check_writable(output, inputs=[*paths, *map(sidecar, paths)])
        kind = options.format or _ENDINGS.get(target.suffix.lower(), "html")
    results = []
    with progress("reading", total=len(sources)) as step:
        for source in sources:
            results.append(_read(source) if isinstance(source, Path) else source)
            step()
    contents = [result.content() for result in results]
    heading = options.title or "Identification report"
    if options.title is None and len(contents) == 1:
        heading = contents[0].title
    created = datetime.now(UTC)
    digests = {str(result.path): "of nothing: it was in memory" for result in results}
    digests |= {str(path): sha256(path) for path in paths}
    document = _as_json(results, contents, title=heading, created=created, digests=digests)
    if kind == "json":
        text = json.dumps(document, ensure_ascii=False, allow_nan=False, default=str) + "\n"
    else:
        text = page.render(
            results,
            contents,
            template=f"report.{kind}",
            title=heading,
            created=created,
            digests=digests,
            progress=progress,
        )
    if target is None:
        return Text("report", text.rstrip("\n"), document, document=text)
    atomic.write_text(target, text)
    whole = page.overall(contents)
    lines = [f"{whole.level}: {whole.text}"]
    for result, content in zip(results, contents, strict=True):
        lines.append(f"  {result.path.name}: {content.verdict.level}. {content.verdict.text}")
    return Text("report", "\n".join(lines), document, [target], document=text)


def _read(path: Path) -> Result:
    """Read a result with its evidence. Warnings that are raised meanwhile are added to the evidence.

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
            place = sidecar(path).name
            warn("SWM050", f"{path.name} has no evidence beside it ({place}): its checks are not shown")
    notices = [record for record in blocks.notices(raised) if record not in shown.notices]
    update = {"notices": [*shown.notices, *notices]}
    return replace(result, evidence=shown.model_copy(update=update))


def _as_json(
    results: Sequence[Result],
    contents: Sequence[Evidence],
    *,
    title: str,
    created: datetime,
    digests: dict[str, str],
) -> dict[str, Any]:
    """Return all results and their evidence, at full precision, as plain data."""
    return {
        "format": FORMAT,
        "title": title,
        "created": created.isoformat(timespec="seconds"),
        "version": swimid.__version__,
        "verdict": page.overall(contents).model_dump(include={"level", "text"}),
        "results": [
            {
                "file": str(result.path),
                "sha256": digests[str(result.path)],
                "kind": result.kind,
                "result": yamlio.plain(result.data),
                "evidence": content.model_dump(mode="json"),
            }
            for result, content in zip(results, contents, strict=True)
        ],
    }
