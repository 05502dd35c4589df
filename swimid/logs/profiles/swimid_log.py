"""The log format of swimid: columns are read under their own names."""

from __future__ import annotations

from pathlib import Path

from swimid.logs.foreign import open_table
from swimid.logs.foreign.base import Table
from swimid.logs.log import TIME
from swimid.logs.profiles.base import Peek, Profile


def _recognises(peek: Peek) -> bool:
    """Return whether the first line that is no comment names ``t_s``."""
    header = next((line for line in peek.lines if line.strip() and not line.startswith("#")), "")
    return TIME in [cell.strip().strip('"') for cell in header.split(",")]


def _read(path: Path, select: str | None, length_unit: str | None) -> Table:
    return open_table(path)


PROFILE = Profile("swimid", "log of swimid", _recognises, _read)
