"""What goes into a target and what comes out of it."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Exported:
    """A finished export.

    Attributes
    ----------
    text : str
        The file.
    limits : tuple of str
        What the target cannot carry, one sentence each.
    dangers : tuple of str
        Why the target's simulation may be unstable.
    """

    text: str
    limits: tuple[str, ...] = ()
    dangers: tuple[str, ...] = ()
