"""What every command shares: options, output streams, exit statuses.

stdout carries the result only (plain text, or one JSON document under ``--json``, on
failure too); progress, warnings and errors go to stderr.
"""

from __future__ import annotations

import json
import math
import os
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, fields
from functools import partial, wraps
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import click

from swimid.errors import SwimidError, UsageError
from swimid.files import atomic, lock, mark
from swimid.notices import Notice, recorded
from swimid.progress import Progress, Step, silent

if TYPE_CHECKING:
    from click._termui_impl import ProgressBar

    from swimid.results.result import Result

#: Version of the ``--json`` envelope.
ENVELOPE = 1
#: Terminal codes that go up a line and clear it.
ERASE_BAR = "\x1b[1A\x1b[2K"


@dataclass(frozen=True)
class Shared:
    """The options every verb takes."""

    output: Path | None
    as_json: bool
    quiet: bool
    verbose: int
    no_progress: bool
    debug: bool
    force: bool


def shared_options(
    output_help: str, *, output_flags: tuple[str, ...] = ("-o", "--output"), required: bool = False
) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Add the shared options to a command; it receives them as ``shared: Shared``.

    Parameters
    ----------
    output_help : str
        What ``-o`` writes.
    output_flags : tuple of str
        Other flags where ``--output`` means something else to this verb.
    """
    path = click.Path(path_type=Path)
    flag = partial(click.option, is_flag=True)
    options = [
        click.option(*output_flags, "output_path", type=path, required=required, help=output_help),
        flag("--json", "as_json", help="Print the result as one JSON document on stdout."),
        flag("--force", help="Overwrite an output that swimid did not write."),
        flag("-q", "--quiet", help="Print errors only."),
        click.option("-v", "--verbose", count=True, help="Say more about what is done."),
        flag("--no-progress", help="No progress bars."),
        flag("--debug", help="Show tracebacks."),
    ]

    def decorate(function: Callable[..., Any]) -> Callable[..., Any]:
        @wraps(function)
        def gather(*, output_path: Path | None, **given: Any) -> Any:
            flags = {field.name: given.pop(field.name) for field in fields(Shared) if field.name != "output"}
            return function(shared=Shared(output_path, **flags), **given)

        for option in reversed(options):
            gather = option(gather)
        return gather

    return decorate


class Run:
    """One verb being run: gives it progress, takes its outcome."""

    def __init__(self, shared: Shared) -> None:
        self.shared = shared
        self.outcome: Result | None = None

    @property
    def progress(self) -> Progress:
        """Bars on stderr when it is a terminal, else none."""
        shared = self.shared
        hidden = shared.no_progress or shared.quiet or not sys.stderr.isatty() or bool(os.environ.get("CI"))
        return silent if hidden else _bar

    def finish(self, outcome: Result) -> None:
        """Take the outcome; it is printed when the run ends."""
        self.outcome = outcome


@contextmanager
def running(verb: str, shared: Shared) -> Iterator[Run]:
    """Run a verb: print its outcome and warnings, turn errors into exit statuses.

    Exit status 0 done, 2 usage, 3 input, 4 no trustworthy result, 1 a bug, 130 interrupted.
    """
    run = Run(shared)
    notices: list[Notice] = []

    written: list[Path] = []

    def fail(kind: str, message: str, status: int, text: str = "") -> NoReturn:
        error = {"type": kind, "message": message, "exit_status": status}
        _fail(verb, shared, error, text or message, notices, outputs=[str(path) for path in written])

    try:
        with (
            _interrupts() as interrupts,
            recorded() as notices,
            atomic.noted() as written,
            lock.held(shared.output),
        ):
            yield run
    except SwimidError as error:
        if shared.debug:
            traceback.print_exc()
        _print_warnings(notices, shared)
        for path in () if shared.quiet else written:
            click.echo(f"wrote {path}", err=True)
        _fail(verb, shared, error.to_dict(), str(error), notices, outputs=[str(path) for path in written])
    except KeyboardInterrupt:
        fail("Interrupted", f"interrupted; {_left(shared.output, written)}", 130)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(0)
    except (click.exceptions.ClickException, click.exceptions.Exit, click.exceptions.Abort):
        raise
    except MemoryError as error:
        fail("InputError", f"not enough memory for this input: {error}", 3)
    except Exception as error:  # noqa: BLE001 - the last line of defence: a bug is reported as one
        if shared.debug:
            traceback.print_exc()
        message = f"{type(error).__name__}: {error}"
        hint = "run again with --debug and report the traceback"
        fail("Bug", message, 1, f"This is a bug in swimid: {message}\n  hint: {hint}")
    assert run.outcome is not None
    _print_warnings(notices, shared)
    outputs = [str(path) for path in run.outcome.outputs]
    if interrupts:
        notices = []
        wrote = f"wrote {', '.join(outputs)}" if outputs else "nothing was written"
        fail("Interrupted", f"interrupted; the result is of a search cut short: {wrote}", 130)
    if shared.as_json:
        _print_json(verb, {"result": _jsonable(run.outcome.data)}, notices, outputs=outputs)
    elif not shared.quiet:
        _print_text(run.outcome.summary(), outputs)


@contextmanager
def _interrupts() -> Iterator[list[int]]:
    """Every Ctrl-C while the work runs, also one that a search caught to go on with what it had."""
    seen: list[int] = []
    before = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or not callable(before):
        yield seen
        return

    def note(number: int, frame: Any) -> None:
        seen.append(number)
        before(number, frame)

    signal.signal(signal.SIGINT, note)
    try:
        yield seen
    finally:
        signal.signal(signal.SIGINT, before)


def _left(output: Path | None, written: list[Path]) -> str:
    """What an interrupted command leaves behind."""
    from swimid.files.checkpoint import has_pieces, place

    if written:
        return f"written before: {', '.join(str(path) for path in written)}"
    if output is not None and has_pieces(output):
        return f"{place(output)} keeps what was computed: the same command goes on from there"
    return "nothing was written"


def _fail(
    verb: str, shared: Shared, error: dict[str, Any], text: str, notices: list[Notice], **more: Any
) -> NoReturn:
    """End the command with an error's exit status; what is no bug is told as an error."""
    if shared.as_json:
        _print_json(verb, {"error": error}, notices, **more)
    click.echo(text if error["type"] == "Bug" else f"Error: {text}", err=True)
    sys.exit(error["exit_status"])


def _print_text(text: str, outputs: list[str]) -> None:
    if text:
        click.echo(text)
    for path in outputs:
        click.echo(f"wrote {path}", err=True)


def _print_json(verb: str, answer: dict[str, Any], notices: list[Notice], **more: Any) -> None:
    document = {
        "schema": ENVELOPE,
        "ok": "result" in answer,
        "verb": verb,
        **answer,
        "warnings": [{"code": n.code, "text": n.text} for n in notices],
        **more,
    }
    click.echo(json.dumps(document, ensure_ascii=False))


def _print_warnings(notices: list[Notice], shared: Shared) -> None:
    if shared.quiet:
        return
    for notice in notices:
        click.echo(f"warning {notice.code}: {notice.text}", err=True)


def _jsonable(value: Any) -> Any:
    """Plain JSON data; numbers keep every digit, NaN becomes null."""
    if isinstance(value, dict):
        return {str(k): _jsonable(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_jsonable(v) for v in value]
    if hasattr(value, "tolist"):
        return _jsonable(value.tolist())
    if hasattr(value, "model_dump"):
        return _jsonable(value.model_dump(mode="json"))
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Path):
        return str(value)
    return value


def protect(output: Path | None, shared: Shared, *, inputs: tuple[str | Path, ...] = ()) -> None:
    """Refuse an output that would destroy an input, or a file swimid did not write.

    Raises
    ------
    UsageError
        The output is an input, or another's file and ``--force`` was not given.
    InputError
        Its folder does not exist.
    """
    if output is None:
        return
    if str(output) == "-":
        raise UsageError("this result is files, not a stream: name one", hint="--json prints it on stdout")
    atomic.check_writable(output, inputs=inputs)
    if not shared.force and not mark.is_own(output):
        raise UsageError(
            f"{output} exists and was not written by swimid", hint="name another output, or give --force"
        )


class _BarStep:
    """A running bar: call it to advance, note what stands beside it."""

    def __init__(self, bar: ProgressBar[int], description: str) -> None:
        self._bar, self._description = bar, description

    def __call__(self, amount: int = 1) -> None:
        self._bar.update(amount)

    def note(self, text: str) -> None:
        self._bar.label = f"{self._description}: {text}"


@contextmanager
def _bar(description: str, total: int | None = None) -> Iterator[Step]:
    """Draw a progress bar on stderr, and remove it at the end."""
    steps = count() if total is None else range(total)
    with click.progressbar(steps, label=description, file=sys.stderr, show_pos=True) as bar:
        yield _BarStep(bar, description)
    click.echo(ERASE_BAR, file=sys.stderr, nl=False)
