"""Errors that swimid raises on purpose, and the exit status of the command for each of them.

::

    SwimidError
    +-- UsageError          2  options or arguments are wrong
        +-- UnknownName     2  a result has nothing of this name         (also a KeyError)
    +-- InputError          3  a file cannot be read or is invalid   (also a ValueError)
        +-- NotEnoughMemory 3  the input does not fit into the memory
    +-- NoTrustworthyResult 4  the computation ended without a result that can be trusted
        +-- Interrupted   130  the user stopped the computation
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import Any, TypeVar

from swimid.reading import note

Value = TypeVar("Value")
#: Name of the Python argument for each command-line option of the function that is running. The value is None
#: on the command line, where messages name the options as they are typed.
_ARGUMENTS: ContextVar[Mapping[str, str] | None] = ContextVar("_ARGUMENTS")
#: Pattern that finds command-line options in messages. It also matches whole commands, in which the options
#: are not replaced.
_OPTION = re.compile(r"swimid [a-z][^\n;]*|(?<![\w-])--?[a-z][a-z-]*")


#: Maximum number of files of a folder that a hint lists.
MAX_FILES = 5
#: Maximum number of allowed words that a hint lists besides the most similar one.
MAX_ALLOWED = 15


@contextmanager
def name_arguments(arguments: Mapping[str, str] | None) -> Iterator[None]:
    """Replace command-line options by Python arguments in all messages of a ``with`` block.

    Errors and warnings of the block then name ``start_state`` in place of ``--start-state``.

    Parameters
    ----------
    arguments : mapping or None
        Argument name of each option, in addition to the names of an enclosing block. None keeps the option
        names, also in inner blocks. The command line passes None.
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
    """Return a message that names each option as its caller does: as an option or as a Python argument.

    >>> with name_arguments({"--start-state": "start_state", "--raw": "clean=False"}):
    ...     in_words_of_the_caller("give --start-state rest, or --raw")
    'give start_state rest, or clean=False'
    """
    arguments = _ARGUMENTS.get({}) or {}
    return _OPTION.sub(lambda found: arguments.get(found[0], found[0]), text)


class SwimidError(Exception):
    """Base class of the errors that a user of swimid can cause. Any other exception is a bug in swimid.

    Attributes
    ----------
    message : str
        Description of the error.
    hint : str or None
        Suggested remedy.
    exit_status : int
        Exit status of the command.
    """

    exit_status = 1

    def __init__(self, message: str, *, hint: str | None = None) -> None:
        self.message = in_words_of_the_caller(message)
        self.hint = hint
        if hint is not None:
            self.hint = in_words_of_the_caller(hint)
        super().__init__(self.message)

    def __str__(self) -> str:
        return "\n  hint: ".join(filter(None, [self.message, self.hint]))

    def _render_traceback_(self) -> list[str]:
        """Return the lines that a notebook shows in place of a traceback."""
        return f"{type(self).__name__}: {self}".splitlines()

    def to_dict(self) -> dict[str, Any]:
        """Return the error and its location as a dictionary for the entry ``error`` of ``--json`` output."""
        return {"type": type(self).__name__, **vars(self), "exit_status": self.exit_status}


class UsageError(SwimidError, ValueError):
    """Error for options or arguments that do not exist, are not allowed, or contradict each other.

    Attributes
    ----------
    message, hint, exit_status
        See :class:`SwimidError`.

    Examples
    --------
    >>> import swimid
    >>> try:
    ...     swimid.fit_drag("sample_logs/rig/trials.yaml", methods="ml")
    ... except UsageError as error:
    ...     print(error.message)
    fit_drag has no option 'methods'
    """

    exit_status = 2


class UnknownName(UsageError, KeyError):
    """Error for a name that a result, a log or a simulation does not have."""


class InputError(SwimidError, ValueError):
    """Error for a file, or for data in memory, that cannot be read or is invalid.

    Parameters
    ----------
    message : str
        Description of the error, with the invalid value and the allowed values.
    file : path, optional
        File that contains the error.
    line : int, optional
        Line of a text file, counted from 1.
    frame : int, optional
        Frame of a video, counted from 0.
    row : int, optional
        Row of a table in memory, counted from 0.
    column : str, optional
        Name of the column, or dotted path of the key.
    hint : str, optional
        Suggested remedy.
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
        if file is not None:
            file = str(file)
        counted = {"line": line, "frame": frame, "row": row}
        place = [file, *(f"{name} {n}" for name, n in counted.items() if n is not None)]
        place.append(column and f"'{column}'")
        where = ", ".join(filter(None, place))
        super().__init__(": ".join(filter(None, [where, message])), hint=hint)
        self.file, self.line, self.frame, self.row, self.column = file, line, frame, row, column
        self.reason = in_words_of_the_caller(message)


class NotEnoughMemory(InputError):
    """Error for an input that does not fit into the memory, or into the memory limit of the process."""


class NoTrustworthyResult(SwimidError):
    """Error for a computation that ended without a trustworthy result, such as a fit that identifies nothing.

    Attributes
    ----------
    message, hint, exit_status
        See :class:`SwimidError`.
    """

    exit_status = 4


class Interrupted(NoTrustworthyResult):
    """Error for a computation that the user stopped with Ctrl-C. The message names the written files."""

    exit_status = 130


def first_line(error: BaseException) -> str:
    """Return the first line of an exception's message, or the name of its class if it has no message."""
    return (str(error) or type(error).__name__).splitlines()[0]


def nearest(word: str, allowed: list[str] | tuple[str, ...]) -> str | None:
    """Return the allowed word that is most similar to a mistyped word; None if no allowed word is similar.

    >>> nearest("pulling_mas_kg", ["pulling_mass_kg", "role"])
    'pulling_mass_kg'
    """
    import difflib

    for match in difflib.get_close_matches(word, list(allowed), n=1, cutoff=0.6):
        return match
    begun = [name for name in allowed if word and (name.startswith(word) or word.startswith(f"{name}_"))]
    return min(begun, key=len, default=None)


class Named(dict[str, Value]):
    """Mapping of names to values. An unknown name raises :class:`UnknownName` with the nearest name."""

    def __missing__(self, name: str) -> Value:
        raise UnknownName(f"there is no '{name}'", hint=suggestion(str(name), list(self)))


def suggestion(word: str, allowed: list[str] | tuple[str, ...], lead: str = "there are") -> str:
    """Return a hint for a word that is not allowed: the most similar allowed word, and all allowed words.

    ``lead`` is the text in front of the list of all allowed words. The list is left out if it is longer than
    :data:`MAX_ALLOWED` and there is a similar word.

    >>> suggestion("gap", ["robot", "trials"])
    'there are: robot, trials'
    """
    close, listed = nearest(word, allowed), f"{lead}: {', '.join(allowed) or 'none'}"
    if close is None:
        return listed
    return f"did you mean '{close}'?" + f" {listed}" * (len(allowed) <= MAX_ALLOWED)


@contextmanager
def extra_needed(task: str, extra: str, *, file: str | Path | None = None) -> Iterator[None]:
    """Convert the failed import of an optional library into an error that states how to install it.

    The import must be in the ``with`` block. The message has the command ``pip install 'swimid[extra]'``.

    The error is an :class:`InputError` if ``file`` is given, and else a :class:`UsageError`.

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
def file_errors(file: str | Path, done: str = "read", *, noted: bool = True) -> Iterator[None]:
    """Convert an error of the operating system in the ``with`` block into an :class:`InputError` for a file.

    The message states the failed action ``done`` (``"read"``, ``"written"``) and the reason. Reading a device
    or a pipe is also an error, because it may have no end and cannot be read twice. A file that is read is
    noted as an input of the command (:mod:`swimid.reading`), unless ``noted`` is False.

    Examples
    --------
    >>> with file_errors("absent.yaml"), open("absent.yaml"):
    ...     pass
    Traceback (most recent call last):
    swimid.errors.InputError: absent.yaml: cannot be read: No such file or directory
      hint: check the path
    """
    try:
        if done == "read" and Path(file).exists() and not (Path(file).is_file() or Path(file).is_dir()):
            hint = "save its content as a file"
            raise InputError("is a device or a pipe; inputs are files", file=file, hint=hint)
        if done == "read" and noted:
            note(file)
        yield
    except OSError as error:
        hint = None
        if done == "read" and Path(file).is_dir():
            names = sorted(one.name for one in Path(file).iterdir() if one.is_file())
            hint = f"name one of its files: {', '.join(names[:MAX_FILES]) or 'it has none'}"
            raise InputError("is a folder; a file is needed here", file=file, hint=hint) from error
        if isinstance(error, FileNotFoundError):
            hint = "check the path"
        raise InputError(f"cannot be {done}: {error.strerror or error}", file=file, hint=hint) from error
