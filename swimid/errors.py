"""The errors swimid raises on purpose, each with the exit status it ends the command with.

::

    SwimidError
    +-- UsageError          2  options or arguments are wrong
    +-- InputError          3  a file cannot be read or is invalid   (also a ValueError)
    +-- NoTrustworthyResult 4  the computation ended without a result that can be trusted
        +-- Interrupted   130  it was stopped before its end
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import Any

#: Argument of each option of the function that runs; None where the options themselves are typed.
_ARGUMENTS: ContextVar[Mapping[str, str] | None] = ContextVar("_ARGUMENTS")
#: A command, which is left as it is, or one option.
_OPTION = re.compile(r"swimid [a-z][^\n;]*|(?<![\w-])--?[a-z][a-z-]*")


@contextmanager
def naming(arguments: Mapping[str, str] | None) -> Iterator[None]:
    """Let messages of this block name arguments (``start_state``) in place of options (``--start-state``).

    Parameters
    ----------
    arguments : mapping or None
        The argument of each option, beside those of a block around this one. None keeps the options also in
        inner blocks: they were typed.
    """
    inside = None
    outside = _ARGUMENTS.get({})
    if arguments is not None and outside is not None:
        inside = {**outside, **arguments}
    token = _ARGUMENTS.set(inside)
    try:
        yield
    finally:
        _ARGUMENTS.reset(token)


def in_words_of_the_caller(text: str) -> str:
    """Return a message with the names of options as the caller writes them.

    >>> with naming({"--start-state": "start_state", "--raw": "clean=False"}):
    ...     in_words_of_the_caller("give --start-state rest, or --raw")
    'give start_state rest, or clean=False'
    """
    arguments = _ARGUMENTS.get({})
    return _OPTION.sub(lambda found: arguments.get(found[0], found[0]), text) if arguments else text


class SwimidError(Exception):
    """Base of every error a user can cause. Anything else that escapes is a bug.

    Attributes
    ----------
    message : str
        What is wrong.
    hint : str or None
        What to do about it.
    exit_status : int
        Exit status of the command.
    """

    exit_status = 1

    def __init__(self, message: str, *, hint: str | None = None) -> None:
        self.message = in_words_of_the_caller(message)
        self.hint = None if hint is None else in_words_of_the_caller(hint)
        super().__init__(self.message)

    def __str__(self) -> str:
        return self.message if self.hint is None else f"{self.message}\n  hint: {self.hint}"

    def to_dict(self) -> dict[str, Any]:
        """Return the error as the ``error`` member of the ``--json`` document."""
        return {
            "type": type(self).__name__,
            "message": self.message,
            "hint": self.hint,
            "exit_status": self.exit_status,
        }


class UsageError(SwimidError, ValueError):
    """Options or arguments do not exist, are not allowed, or contradict each other.

    Attributes
    ----------
    message, hint, exit_status
        As of :class:`SwimidError`.

    Examples
    --------
    >>> import swimid
    >>> try:
    ...     swimid.fit_drag("sample_logs/rig/trials.yaml", methods="ml")
    ... except UsageError as error:
    ...     print(error.hint)
    did you mean 'method'?
    """

    exit_status = 2


class InputError(SwimidError, ValueError):
    """An input cannot be read or is invalid.

    Parameters
    ----------
    message : str
        What is wrong, with the offending value and what is allowed.
    file : path, optional
        The file it is in.
    line : int, optional
        Line of a text file, counted from 1 as editors do.
    frame : int, optional
        Frame of a video, counted from 0.
    row : int, optional
        Row of a table in memory, counted from 0.
    column : str, optional
        Name of the column, or dotted path of the key.
    hint : str, optional
        What to do about it.
    """

    exit_status = 3

    def __init__(
        self,
        message: str,
        *,
        file: str | Path | None = None,
        line: int | None = None,
        frame: int | None = None,
        row: int | None = None,
        column: str | None = None,
        hint: str | None = None,
    ) -> None:
        self.file: str | None = None
        if file is not None:
            self.file = str(file)
        self.line = line
        self.frame = frame
        self.row = row
        self.column = column
        self.reason = in_words_of_the_caller(message)
        counted = {"line": line, "frame": frame, "row": row}
        place = [self.file, *(f"{name} {n}" for name, n in counted.items() if n is not None)]
        place.append(column and f"'{column}'")
        where = ", ".join(filter(None, place))
        super().__init__(": ".join(filter(None, [where, message])), hint=hint)

    def to_dict(self) -> dict[str, Any]:
        """Return the error with its place, as the ``error`` member of the ``--json`` document."""
        return super().to_dict() | {
            "file": self.file,
            "line": self.line,
            "frame": self.frame,
            "column": self.column,
            "reason": self.reason,
        }


class NoTrustworthyResult(SwimidError):
    """The computation ended without a result that should be used.

    Attributes
    ----------
    message, hint, exit_status
        As of :class:`SwimidError`.
    """

    exit_status = 4


class Interrupted(NoTrustworthyResult):
    """The computation was stopped (Ctrl-C); the message names the files that were written."""

    exit_status = 130


def first_line(error: BaseException) -> str:
    """Return the first line of the message of a library's error."""
    return (str(error) or type(error).__name__).splitlines()[0]


def nearest(word: str, allowed: list[str] | tuple[str, ...]) -> str | None:
    """Return the allowed word most like ``word``, or None if none is close.

    >>> nearest("pulling_mas_kg", ["pulling_mass_kg", "role"])
    'pulling_mass_kg'
    """
    import difflib

    matches = difflib.get_close_matches(word, list(allowed), n=1, cutoff=0.6)
    if matches:
        return matches[0]
    begun = [name for name in allowed if word and (name.startswith(word) or word.startswith(f"{name}_"))]
    return min(begun, key=len) if begun else None


def suggestion(word: str, allowed: list[str] | tuple[str, ...], lead: str = "there are") -> str:
    """Return the hint for a word that is not allowed: the nearest allowed one, or all after the lead.

    >>> suggestion("gap", ["robot", "trials"])
    'there are: robot, trials'
    """
    close = nearest(word, allowed)
    if close:
        return f"did you mean '{close}'?"
    return f"{lead}: {', '.join(allowed) or 'none'}"


@contextmanager
def extra_needed(task: str, extra: str, *, file: str | Path | None = None) -> Iterator[None]:
    """Turn the failed import of an optional library into an error that names its extra.

    It is an :class:`InputError` where a file needs the library, else a :class:`UsageError`.

    Examples
    --------
    >>> with extra_needed("a genetic search", "search"):
    ...     import no_such_library
    Traceback (most recent call last):
    swimid.errors.UsageError: a genetic search needs no_such_library, which is not installed
      hint: pip install 'swimid[search]'
    """
    try:
        yield
    except ImportError as error:
        text, hint = f"{task} needs {error.name}, which is not installed", f"pip install 'swimid[{extra}]'"
        if file is not None:
            raise InputError(text, file=file, hint=hint) from error
        raise UsageError(text, hint=hint) from error


@contextmanager
def file_errors(file: str | Path, done: str = "read") -> Iterator[None]:
    """Turn an error of the operating system into an :class:`InputError` (cannot be ``done``, and the reason).

    Examples
    --------
    >>> with file_errors("absent.yaml"), open("absent.yaml"):
    ...     pass
    Traceback (most recent call last):
    swimid.errors.InputError: absent.yaml: cannot be read: No such file or directory
      hint: check the path
    """
    try:
        yield
    except OSError as error:
        hint = "check the path" if isinstance(error, FileNotFoundError) else None
        raise InputError(f"cannot be {done}: {error.strerror or error}", file=file, hint=hint) from error
