"""The options of ``report``."""

from __future__ import annotations

from typing import Literal

from swimid.options import Options, option

Kind = Literal["html", "md", "json"]


class ReportOptions(Options):
    """What ``report`` can be told."""

    format: Kind | None = option(None, help="What to write. Default: by the ending of -o, else html.")
    title: str | None = option(None, help="Title of the page.")
