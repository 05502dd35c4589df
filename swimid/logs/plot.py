"""Command ``swimid plot``, which draws logs as figures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Self

from swimid.errors import UsageError
from swimid.files import atomic
from swimid.logs import log
from swimid.logs.log import LogLike
from swimid.logs.logged import figures_of
from swimid.logs.options import PlotOptions
from swimid.notices import recorded
from swimid.options import takes
from swimid.results import drawing
from swimid.results import evidence as ev
from swimid.results.evidence import Evidence, Verdict
from swimid.results.result import Result

PICTURES = (".svg", ".png")


@dataclass(frozen=True, eq=False)
class Drawn(Result):
    """Figures of logs: result of ``plot``. They are saved as one picture."""

    kind = "Log"

    def save(self, path: str | Path) -> Self:
        """Write the figures to a file that ends in ``.svg`` or ``.png``.

        Raises
        ------
        InputError
            The folder does not exist, or files cannot be written to it.
        UsageError
            The path has another ending.
        """
        path = _picture(Path(path))
        assert self.evidence is not None
        drawing.write(path, self.evidence.figures, title=self.evidence.title)
        return replace(self, outputs=(*self.outputs, path))


@takes(PlotOptions)
def plot(
    logs: LogLike | Sequence[LogLike],
    *,
    options: PlotOptions,
    output: str | Path | None = None,
) -> Drawn:
    """Draw logs: channels over time, the track from above, and spectra of the channels.

    By default the title lists the names of the logs.

    Parameters
    ----------
    logs : path, Log or DataFrame, or a sequence of these
        Logs. Several logs are drawn over each other, each with its own time axis origin. A table has the
        columns of the log format, shape (n, k), in SI units.
    output : path, optional
        File that ends in ``.svg`` or ``.png``. Without this path nothing is written.

    Returns
    -------
    Drawn
        Its method ``figures()`` returns all figures in matplotlib; ``plot(name, axes)`` draws one of
        ``figure_names``.

    Raises
    ------
    InputError
        A log cannot be read.
    UsageError
        The output has another ending.

    Examples
    --------
    >>> import numpy as np, pandas as pd
    >>> t = np.arange(200) / 50
    >>> plot(pd.DataFrame({"t_s": t, "yaw_rad": 0.2 * np.sin(9 * t)})).figure_names
    ['channels', 'spectra-log']
    """
    if isinstance(logs, str) or not isinstance(logs, Sequence):
        logs = [logs]
    if not logs:
        raise UsageError("name at least one log to draw")
    if output is not None:
        paths = [one for one in logs if isinstance(one, str | Path)]
        output = atomic.check_writable(_picture(Path(output)), inputs=paths)
    records: list[log.Log] = []
    with recorded(repeat=True) as notices:
        for number, given in enumerate(logs, start=1):
            if isinstance(given, str | Path):
                records.append(log.read(given))
            else:
                name = f"log {number}" if len(logs) > 1 else "log"
                records.append(log.of(given, name=name))
        figures = figures_of(records)
    proof = Evidence(
        command="plot",
        title=options.title or " and ".join(record.name for record in records),
        verdict=Verdict(level="good", text="Drawn as logged, nothing judged."),
        facts={record.name: f"{len(record)} samples" for record in records},
        figures=figures,
        notices=ev.notices(notices),
    )
    data = {"logs": [str(record.path) for record in records], "figures": [figure.id for figure in figures]}
    drawn = Drawn("plot", "", data, evidence=proof, document=records)
    return drawn.saved(output)


def _picture(path: Path) -> Path:
    if path.suffix.lower() not in PICTURES:
        raise UsageError(f"{path}: a picture ends in {' or '.join(PICTURES)}")
    return path
