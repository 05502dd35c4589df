"""Progress of long loops, without the library knowing who shows it."""

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
    """Put a remark beside a running bar, where whoever draws it has a ``note(text)`` for that."""
    note = getattr(step, "note", None)
    if note is not None:
        note(text)


def silent(description: str, total: int | None = None) -> AbstractContextManager[Step]:
    """The progress nobody sees: the default of every library function."""

    def step(amount: int = 1) -> None:
        return None

    return nullcontext(step)
