"""The options of ``plot``."""

from __future__ import annotations

from swimid.options import Options, option


class PlotOptions(Options):
    """What ``plot`` can be told."""

    title: str | None = option(None, help="Title above the figures.")
