"""Progress of long loops. The caller decides whether and how the progress is shown."""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext
from typing import Protocol


class Step(Protocol):
    """Function that advances one progress bar."""

    def __call__(self, amount: int = 1) -> None:
        """Advance the bar by ``amount`` steps."""
        ...


class Progress(Protocol):
    """Function that opens a progress bar: ``with progress("tracking", total=600) as step: step()``."""

    def __call__(self, description: str, total: int | None = None) -> AbstractContextManager[Step]:
        """Open a bar with ``total`` steps; None for an unknown number of steps."""
        ...


def show(step: Step, text: str) -> None:
    """Show a remark next to a progress bar, if the bar has a method ``note(text)``."""
    note = getattr(step, "note", None)
    if note is not None:
        note(text)


def silent(description: str, total: int | None = None) -> AbstractContextManager[Step]:
    """Show no progress. Library functions do this by default."""

    def step(amount: int = 1) -> None:
        return None

    return nullcontext(step)
