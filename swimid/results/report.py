"""``report``: results and their evidence as one page."""

from __future__ import annotations

import json
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

from swimid.errors import UsageError
from swimid.files import atomic
from swimid.files.provenance import sha256
from swimid.options import takes
from swimid.progress import Progress, silent
from swimid.results import documents, page
from swimid.results import reader as results
from swimid.results.evidence import sidecar
from swimid.results.options import Kind, ReportOptions
from swimid.results.result import Result, Text

_ENDINGS: dict[str, Kind] = {".html": "html", ".htm": "html", ".md": "md", ".markdown": "md", ".json": "json"}


@takes(ReportOptions)
def report(
    inputs: Sequence[str | Path | Result],
    *,
    options: ReportOptions,
    output: str | Path | None = None,
    progress: Progress = silent,
) -> Text:
    """Write one document about any number of result files. Nothing is computed again.

    By default its title is that of the only result, or "Identification report".

    Parameters
    ----------
    inputs : sequence of paths and results
        Parameter files, gap files, logs, each with its ``.evidence.json`` beside it; or results in memory.
    output : path, optional
        The file to write. None or ``-`` gives the document only.
    progress : Progress
        Steps once per file read and once per figure drawn.

    Returns
    -------
    Result
        ``.document`` is the page (HTML, Markdown or JSON); a notebook shows it. ``.save(path)`` writes it.

    Raises
    ------
    InputError
        When a result or its evidence is broken, or the output cannot be written.
    UsageError
        Without inputs, or for an output that is also an input.

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
    target = None if output is None or str(output) == "-" else Path(output)
    kind = options.format or _ENDINGS.get(target.suffix.lower() if target else "", "html")
    if target is not None:
        atomic.check_writable(target, inputs=[*paths, *map(sidecar, paths)])
    sections = []
    with progress("reading", total=len(sources)) as step:
        for source in sources:
            sections.append(results.load(source) if isinstance(source, Path) else source.section())
            step()
    heading = options.title or (sections[0].title if len(sections) == 1 else "Identification report")
    created = datetime.now(UTC)
    digests = {str(section.path): "of nothing: it was in memory" for section in sections}
    digests |= {str(path): sha256(path) for path in paths}
    document = documents.as_json(sections, title=heading, created=created, digests=digests)
    if kind == "html":
        text = page.render(sections, title=heading, created=created, digests=digests, progress=progress)
    elif kind == "md":
        text = documents.as_markdown(sections, title=heading, created=created, digests=digests)
    else:
        text = json.dumps(document, ensure_ascii=False, allow_nan=False, default=str) + "\n"
    if target is None:
        return Text("report", text.rstrip("\n"), document, document=text)
    atomic.write_text(target, text)
    whole = page.overall(sections)
    lines = [f"{page.verdict_badge(whole)[1]}: {whole.text}"]
    for section in sections:
        word = page.verdict_badge(section.verdict)[1].lower()
        lines.append(f"  {section.path.name}: {word}. {section.verdict.text}")
    return Text("report", "\n".join(lines), document, [target], document=text)
