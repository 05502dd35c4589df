"""Warnings of swimid, each with a stable code, and the interface of progress bars for long loops.

Functions of swimid issue a warning with :func:`warn`. In Python, the user sees a :class:`SwimidWarning`. A
command collects its warnings with :func:`record_warnings`, prints them at its end, and stores them in its
results.
The caller of a long loop decides whether and how the progress of the loop is shown.
"""

from __future__ import annotations

import sys
import time
import tomllib
import warnings
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass
from functools import cache
from html import escape
from pathlib import Path
from typing import Any

from swimid.errors import in_words_of_the_caller

#: File with the subject and the explanation (meaning and remedy) of each warning, by section and code.
WARNINGS_FILE = Path(__file__).parent / "warnings.toml"


@cache
def read_warnings() -> dict[str, dict[str, tuple[str, str]]]:
    """Return subject and explanation of each warning, by section and code."""
    return tomllib.loads(WARNINGS_FILE.read_text(encoding="utf-8"))


@cache
def read_codes() -> dict[str, str]:
    """Return the subject of each warning code. ``docs/warnings.md`` explains the codes."""
    return {code: text for codes in read_warnings().values() for code, (text, _) in codes.items()}


class SwimidWarning(UserWarning):
    """Warning of swimid with a stable code.

    Attributes
    ----------
    code : str
        Code of the warning, such as ``"SWM013"``. ``docs/warnings.md`` explains the codes.
    text : str
        Text of the warning, with the values that were found.

    Examples
    --------
    >>> with warnings.catch_warnings():
    ...     warnings.simplefilter("error", SwimidWarning)
    ...     try:
    ...         warn("SWM003", "the time steps differ by 12 %")
    ...     except SwimidWarning as doubt:
    ...         print(doubt.code)
    SWM003
    """

    def __init__(self, code: str, text: str) -> None:
        if code not in read_codes():
            raise KeyError(f"unknown warning code {code}")
        self.code = code
        self.text = in_words_of_the_caller(text)
        super().__init__(f"{code} {self.text}")


@dataclass(frozen=True)
class Notice:
    """Code and text of one recorded warning."""

    code: str
    text: str


def warn(code: str, text: str) -> None:
    """Issue a warning to the user with the given code."""
    warnings.warn(SwimidWarning(code, text), stacklevel=2)


@contextmanager
def record_warnings(*, repeat: bool = False) -> Iterator[list[Notice]]:
    """Collect the warnings of swimid that a ``with`` block issues, and yield their list, without duplicates.

    The collected warnings are not shown to the user. With ``repeat`` they are issued again at the end of the
    block, even after an error, so that an outer block collects them too.
    """
    notices: list[Notice] = []
    show_others = warnings.showwarning

    def keep(message: Warning | str, *rest: Any, **more: Any) -> None:
        if isinstance(message, SwimidWarning):
            notice = Notice(message.code, message.text)
            if notice not in notices:
                notices.append(notice)
        else:
            show_others(message, *rest, **more)

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("always", SwimidWarning)
            warnings.showwarning = keep
            yield notices
    finally:
        for notice in notices if repeat else []:
            warn(notice.code, notice.text)


# ---------------------------------------------------------------- progress

#: Minimum time between two updates of a progress bar in a notebook, s.
REFRESH_S = 0.2
#: Type of a function that advances one progress bar by one step, or by a number of steps: ``step(3)``.
Step = Callable[..., None]
#: Type of a function that opens a progress bar: ``with progress("tracking", total=600) as step: step()``.
#: Without ``total`` the number of steps is unknown.
Progress = Callable[..., AbstractContextManager[Step]]


def show(step: Step, text: str) -> None:
    """Show a remark next to a progress bar, if the function ``step`` of the bar has an attribute ``note``."""
    note = getattr(step, "note", None)
    if note is not None:
        note(text)


def silent(description: str, total: int | None = None) -> AbstractContextManager[Step]:
    """Return a progress bar that shows nothing."""

    def step(amount: int = 1) -> None:
        return None

    return nullcontext(step)


class Automatic:
    """Default of the argument ``progress``: a progress bar in a notebook, and no bar elsewhere."""

    def __call__(self, description: str, total: int | None = None) -> AbstractContextManager[Step]:
        """Return a progress bar with the given description and number of steps."""
        shell = getattr(sys.modules.get("IPython"), "get_ipython", lambda: None)()
        if hasattr(shell, "kernel"):
            return _in_notebook(description, total)
        return silent(description, total)

    def __repr__(self) -> str:
        return "automatic"


automatic = Automatic()


@contextmanager
def _in_notebook(description: str, total: int | None) -> Iterator[Step]:
    """Show a progress bar below the cell of a notebook during the ``with`` block."""
    from IPython.display import HTML, display

    place = display(HTML(""), display_id=True)
    done, shown_s, note = 0, 0.0, ""

    def step(amount: int = 1) -> None:
        nonlocal done, shown_s
        done += amount
        if time.monotonic() - shown_s > REFRESH_S:
            shown_s = time.monotonic()
            most = "" if total is None else f" max={total}"
            count = f"{done}" if total is None else f"{done} of {total}"
            text = escape(f"{description}{note}: ")
            place.update(HTML(f"{text}<progress value={done}{most}></progress> {count}"))

    def remark(text: str) -> None:
        nonlocal note
        note = f", {text}"

    step.note = remark  # type: ignore[attr-defined]
    try:
        yield step
    finally:
        place.update(HTML(""))
