"""Progress of long loops; the caller decides whether and how it is shown."""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext
from typing import Protocol


class Step(Protocol):
    """Advances one running bar."""

    def __call__(self, amount: int = 1) -> None:
        """Advance by ``amount``."""
        ...


class Progress(Protocol):
    """Opens a bar: ``with progress("tracking", total=600) as step: step()``."""

    def __call__(self, description: str, total: int | None = None) -> AbstractContextManager[Step]:
        """Open a bar of ``total`` steps, or of an unknown number."""
        ...


def show(step: Step, text: str) -> None:
    """Put a remark beside a running bar, if the bar has a ``note(text)``."""
    note = getattr(step, "note", None)
    if note is not None:
        note(text)


def silent(description: str, total: int | None = None) -> AbstractContextManager[Step]:
    """Show no progress: the default of every library function."""

    def step(amount: int = 1) -> None:
        return None

    return nullcontext(step)
