"""What every verb returns."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class Outcome:
    """The result of one verb.

    Attributes
    ----------
    verb : str
        Its name as typed, ``"fit-drag"``.
    summary : str
        Plain text for the terminal: the answer first.
    result : dict
        The same for machines, JSON-able, full precision.
    outputs : list of Path
        The files written.
    """

    verb: str
    summary: str
    result: dict[str, Any]
    outputs: list[Path] = field(default_factory=list)
