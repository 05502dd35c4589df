"""Options of the command ``swimid report``."""

from __future__ import annotations

from typing import Literal

from swimid.options import Options, option

Kind = Literal["html", "md"]


class ReportOptions(
    Options,
    argument="RESULT...",
    output="The report. Without it, or with -o -, it goes to stdout.",
    stdout={"format": "md"},
    beside=(),
    makes="page",
):
    """Make one self-contained page from any mixture of results.

    RESULT is a parameter file, a gap file, a log, or a folder of them. The evidence that swimid wrote beside
    it (drag.yaml: drag.evidence.json) brings its figures, checks and methods. Nothing is computed again.

    Examples:
      swimid report drag.yaml propulsion.yaml -o report.html
      swimid report drag.yaml --format md
    """

    format: Kind | None = option(
        None, help="What to write. Default: by the ending of -o; on stdout md, in Python html."
    )
    title: str | None = option(None, help="Title of the page.")
