"""``swimid plot``: logs as figures."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

from swimid.errors import UsageError
from swimid.files import atomic
from swimid.files.provenance import sha256
from swimid.logs import figures as log_figures
from swimid.logs import log
from swimid.notices import recorded
from swimid.progress import Progress, silent
from swimid.results import page, sheet
from swimid.results.evidence import NoticeRecord, Verdict
from swimid.results.result import Result
from swimid.results.sections import Section

PAGES = (".html", ".htm")
PICTURES = (".svg", ".png")


def plot(
    logs: Sequence[str | Path], *, output: str | Path, title: str | None = None, progress: Progress = silent
) -> Result:
    """Draw logs on one page or picture.

    Parameters
    ----------
    logs : sequence of paths
        Several are drawn over each other, each on its own clock.
    output : path
        ``.html``, ``.svg`` or ``.png``.
    title : str, optional
        Default: the names of the logs.

    Raises
    ------
    InputError
        A log cannot be read.
    UsageError
        The ending of the output is none of these.
    """
    output, paths = Path(output), list(dict.fromkeys(Path(path) for path in logs))
    ending = output.suffix.lower()
    if ending not in (*PAGES, *PICTURES):
        raise UsageError(f"{output}: a picture ends in {', '.join((*PAGES, *PICTURES))}")
    atomic.check_writable(output, inputs=tuple(paths))
    with recorded(repeat=True) as notices:
        records = [log.read(path) for path in paths]
        figures = log_figures.figures(records)
    heading = title or " and ".join(path.name for path in paths)
    if ending in PAGES:
        samples = ", ".join(f"{record.path.name}: {len(record)} samples" for record in records)
        section = Section(
            path=paths[0],
            kind="Log" if len(paths) == 1 else "Logs",
            title=heading,
            verdict=Verdict(level="good", text=f"Drawn as logged, nothing judged. {samples}."),
            blocks=list(figures),
            notices=[NoticeRecord(code=n.code, text=n.text) for n in notices],
        )
        digests = {str(path): sha256(path) for path in paths}
        text = page.render(
            [section], title=heading, created=datetime.now(UTC), digests=digests, progress=progress
        )
        atomic.write_text(output, text)
    else:
        with progress("drawing", total=sum(len(figure.panels) for figure in figures)) as step:
            sheet.write(output, figures, title=heading, step=step)
    names = [figure.title for figure in figures]
    result = {"logs": [str(path) for path in paths], "figures": [figure.id for figure in figures]}
    return Result("plot", f"{heading}: {', '.join(names)}", result, [output])
