"""``swimid plot``: logs as figures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Self

from swimid.errors import UsageError
from swimid.files import atomic, provenance
from swimid.logs import log
from swimid.logs.log import LogLike
from swimid.logs.logged import figures_of
from swimid.logs.options import PlotOptions
from swimid.notices import recorded
from swimid.options import takes
from swimid.progress import Progress, silent
from swimid.results import blocks, drawing, page
from swimid.results.evidence import Evidence, Verdict
from swimid.results.result import Result

PAGES = (".html", ".htm")
PICTURES = (".svg", ".png")


@dataclass(frozen=True, eq=False)
class Drawn(Result):
    """Figures of logs, as ``plot`` gives them; they are written as one page or picture.

    Attributes
    ----------
    inputs : sequence of path or Log
        What was drawn.
    progress : Progress
        Shows the drawing.
    """

    kind = "Log"

    inputs: Sequence[provenance.Input] = ()
    progress: Progress = field(default=silent, repr=False)

    def save(self, path: str | Path) -> Self:
        """Write the figures as ``.html``, ``.svg`` or ``.png``.

        Raises
        ------
        InputError
            When the folder does not exist or cannot be written.
        UsageError
            The ending is none of these.
        """
        path = _picture(Path(path))
        assert self.evidence is not None
        figures = self.evidence.figures
        if path.suffix.lower() in PAGES:
            digests = {str(provenance.path_of(one)): provenance.digest_of(one) for one in self.inputs}
            text = page.render(
                [self],
                [self.content()],
                template="report.html",
                title=self.evidence.title,
                created=datetime.now(UTC),
                digests=digests,
                progress=self.progress,
            )
            atomic.write_text(path, text)
        else:
            with self.progress("drawing", total=sum(len(figure.panels) for figure in figures)) as step:
                drawing.write(path, figures, title=self.evidence.title, step=step)
        return replace(self, outputs=(*self.outputs, path))

    @property
    def path(self) -> Path:
        """The first of the logs."""
        return provenance.path_of(self.inputs[0])


@takes(PlotOptions)
def plot(
    logs: LogLike | Sequence[LogLike],
    *,
    options: PlotOptions,
    output: str | Path | None = None,
    progress: Progress = silent,
) -> Drawn:
    """Draw logs: channels over time, the track from above, spectra.

    By default the title is the names of the logs.

    Parameters
    ----------
    logs : path, Log or DataFrame, or a sequence of these
        Several are drawn over each other, each on its own clock. A table has the columns of the log format,
        shape (n, k), SI units.
    output : path, optional
        ``.html``, ``.svg`` or ``.png``; without it nothing is written.
    progress : Progress
        Shows the drawing.

    Returns
    -------
    Drawn
        ``.figures()`` gives all on matplotlib, ``.plot(name, axes)`` one of ``.figure_names``.

    Raises
    ------
    InputError
        A log cannot be read.
    UsageError
        The ending of the output is none of these.

    Examples
    --------
    >>> import numpy as np, pandas as pd
    >>> t = np.arange(200) / 50
    >>> plot(pd.DataFrame({"t_s": t, "yaw_rad": 0.2 * np.sin(9 * t)})).figure_names
    ['channels', 'spectra-log']
    """
    listed = logs if isinstance(logs, Sequence) and not isinstance(logs, str) else [logs]
    given = [Path(one) if isinstance(one, str | Path) else one for one in listed]
    # a path named twice is drawn once
    given = list({one if isinstance(one, Path) else at: one for at, one in enumerate(given)}.values())
    if not given:
        raise UsageError("name at least one log to draw")
    if output is not None:
        output = atomic.check_writable(_picture(Path(output)), inputs=given)
    with recorded(repeat=True) as notices:
        names = [f"log {number}" if len(given) > 1 else "log" for number in range(1, len(given) + 1)]
        records = [log.of(one, name=name) for one, name in zip(given, names, strict=True)]
        figures = figures_of(records)
    inputs = [one if isinstance(one, Path) else record for one, record in zip(given, records, strict=True)]
    proof = Evidence(
        verb="plot",
        title=options.title or " and ".join(record.name for record in records),
        verdict=Verdict(level="good", text="Drawn as logged, nothing judged."),
        facts={record.name: f"{len(record)} samples" for record in records},
        figures=figures,
        notices=blocks.notices(notices),
    )
    paths = [str(provenance.path_of(one)) for one in inputs]
    data = {"logs": paths, "figures": [figure.id for figure in figures]}
    drawn = Drawn("plot", "", data, evidence=proof, document=records, inputs=inputs, progress=progress)
    return drawn.saved(output)


def _picture(path: Path) -> Path:
    if path.suffix.lower() not in (*PAGES, *PICTURES):
        raise UsageError(f"{path}: a picture ends in {', '.join((*PAGES, *PICTURES))}")
    return path
