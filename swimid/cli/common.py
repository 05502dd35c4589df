"""Options, output streams and exit statuses of every command.

stdout has the result only: plain text or, with ``--json``, one JSON document, which also reports errors.
Progress, warnings and errors go to stderr.
"""

from __future__ import annotations

import json
import os
import shlex
import sys
import textwrap
import traceback
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, fields
from functools import partial
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from swimid.errors import InputError, Interrupted, SwimidError, UsageError, naming
from swimid.files import atomic, provenance
from swimid.notices import Notice, recorded
from swimid.progress import Progress, Step, silent

if TYPE_CHECKING:
    from click._termui_impl import ProgressBar

    from swimid.results.result import Result

#: Terminal codes that move up one line and clear it.
ERASE_BAR = "\x1b[1A\x1b[2K"
#: Maximum width of a line on the terminal.
WIDTH = 100
#: Maximum number of warnings of one code that are all printed. If there are more, three of them and a count
#: are printed, unless -v is given.
MAX_ALIKE = 5
_flag = partial(click.Option, is_flag=True)
#: Options of every command, in addition to ``-o``.
SHARED = (
    _flag(["--json", "as_json"], help="Print the result as one JSON document on stdout."),
    _flag(["--force"], help="Overwrite an output that swimid did not write."),
    _flag(["-q", "--quiet"], help="Print errors only."),
    click.Option(["-v", "--verbose"], count=True, help="Print every warning, also many of one kind."),
    _flag(["--no-progress"], help="No progress bars."),
    _flag(["--debug"], help="Show tracebacks."),
)


@dataclass(frozen=True)
class Shared:
    """Values of the options that every command has."""

    output: Path | None = None
    as_json: bool = False
    force: bool = False
    quiet: bool = False
    verbose: int = 0
    no_progress: bool = False
    debug: bool = False

    @classmethod
    def taken_from(cls, typed: dict[str, Any]) -> Shared:
        """Remove the shared options from the options that were typed, and return them."""
        return cls(**{one.name: typed.pop(one.name) for one in fields(cls)})


@dataclass
class Run:
    """Run of one command. It supplies progress bars and stores the outcome, which is printed at the end."""

    command: str
    shared: Shared
    outcome: Result | None = None

    @property
    def progress(self) -> Progress:
        """Progress bars on stderr if stderr is a terminal, else no progress."""
        shared = self.shared
        hidden = shared.no_progress or shared.quiet or not sys.stderr.isatty() or bool(os.environ.get("CI"))
        return silent if hidden else _bar


class Bug(SwimidError):
    """Error that is a bug in swimid."""


@contextmanager
def running(command: str, shared: Shared) -> Iterator[Run]:
    """Run a command, print its outcome and warnings, and convert errors to exit statuses.

    The exit status is 0 for success, 2 for wrong usage, 3 for an invalid input, 4 for no trustworthy result,
    1 for a bug, and 130 for an interrupt.
    """
    run = Run(command, shared)
    notices: list[Notice] = []
    written: list[Path] = []
    interrupts: list[Callable[[], None]] = []

    def noted(interrupt: Callable[[], None]) -> None:
        interrupts.append(interrupt)  # a search may catch the exception and return its best result
        interrupt()

    try:
        with (
            atomic.on_interrupt(noted),
            naming(None),
            recorded() as notices,
            atomic.noted() as written,
            atomic.locked(shared.output),
        ):
            yield run
        assert run.outcome is not None
        if interrupts:
            places = ", ".join(map(str, run.outcome.outputs)) or "nothing"
            raise Interrupted(f"interrupted; the result is of a search cut short: wrote {places}")
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(0)
    except (click.exceptions.ClickException, click.exceptions.Exit, click.exceptions.Abort):
        raise
    except (KeyboardInterrupt, Exception) as caught:  # noqa: BLE001 - the last line of defence
        if shared.debug:
            traceback.print_exc()
        error = _as_error(caught, shared.output, written)
        _print(run, {"error": error.to_dict()}, notices, "", written)
        click.echo(f"{'This is a bug in swimid' if isinstance(error, Bug) else 'Error'}: {error}", err=True)
        sys.exit(error.exit_status)
    outcome, text = run.outcome, ""
    if not (shared.as_json or shared.quiet):
        text = outcome.summary()
    _print(run, {"result": outcome.data}, notices, text, outcome.outputs)


def _as_error(caught: BaseException, output: Path | None, written: list[Path]) -> SwimidError:
    """Return the exception that ended a command as an error of swimid."""
    if isinstance(caught, SwimidError):
        return caught
    if isinstance(caught, KeyboardInterrupt):
        return Interrupted(f"interrupted; {_left(output, written)}")
    if isinstance(caught, MemoryError):
        return InputError(f"not enough memory for this input: {caught}")
    return Bug(f"{type(caught).__name__}: {caught}", hint="run again with --debug and report the traceback")


def _left(output: Path | None, written: list[Path]) -> str:
    """Return a text about the files that an interrupted command has written."""
    from swimid.files.atomic import has_pieces, place

    if written:
        return f"written before: {', '.join(map(str, written))}"
    if output is not None and has_pieces(output):
        return f"{place(output)} keeps what was computed: the same command goes on from there"
    return "nothing was written"


def _print(
    run: Run, answer: dict[str, Any], notices: list[Notice], text: str, outputs: Iterable[Path]
) -> None:
    """Print the answer on stdout, and warnings, written files and the next command on stderr."""
    if not run.shared.quiet:
        most = (MAX_ALIKE, sys.maxsize)[run.shared.verbose > 0]
        for line in _warning_lines(notices, most):
            click.echo(line, err=True)
    if run.shared.as_json:
        from swimid.files import yamlio

        document = {
            "schema": 1,
            "ok": "result" in answer,
            "command": run.command,
            **answer,
            "warnings": [{"code": one.code, "text": one.text} for one in notices],
            "outputs": [str(path) for path in outputs],
        }
        click.echo(json.dumps(yamlio.plain(document, finite=True), ensure_ascii=False))
    elif not run.shared.quiet:
        if text:
            click.echo(text)
        for path in outputs:
            click.echo(f"wrote {path}", err=True)
        if "result" in answer and (following := _next_command(run.outcome)):
            click.echo(f"next: {following}", err=True)


def _warning_lines(notices: list[Notice], most: int) -> Iterator[str]:
    """Yield warnings by code, wrapped. Of more than ``most`` with one code, yield three and a count."""
    wrapped = partial(
        textwrap.fill,
        width=WIDTH,
        subsequent_indent="    ",
        break_long_words=False,
        break_on_hyphens=False,
    )
    for code in dict.fromkeys(one.code for one in notices):
        texts = [one.text for one in notices if one.code == code]
        shown = texts
        if len(texts) > most:
            shown = texts[:3]
        yield from (wrapped(f"warning {code}: {text}") for text in shown)
        if len(shown) < len(texts):
            yield f"warning {code}: {len(texts) - len(shown)} more like these; -v prints them"


def _next_command(outcome: Result | None) -> str:
    """Return the suggested next command after a written result; empty if there is none."""
    from swimid.results.kinds import LOG_ENDINGS
    from swimid.results.terminal import next_command

    if outcome is None or not outcome.outputs:
        return ""
    provenance = getattr(outcome.evidence, "provenance", {})
    if not provenance and outcome.path.suffix not in LOG_ENDINGS:
        return ""
    return next_command(outcome.command, shlex.quote(str(outcome.path)), provenance)


def protect(output: Path | None, shared: Shared, *, inputs: Iterable[str | Path] = ()) -> None:
    """Refuse an output that would replace an input, or a file that swimid did not write.

    Raises
    ------
    UsageError
        If the output is an input, or was not written by swimid and ``--force`` is not given.
    InputError
        If the folder of the output does not exist.
    """
    if output is None:
        return
    if str(output) == "-":
        raise UsageError("this result is files, not a stream: name one", hint="--json prints it on stdout")
    atomic.check_writable(output, inputs=inputs)
    if not shared.force and not provenance.is_own(output):
        raise UsageError(
            f"{output} exists and was not written by swimid", hint="name another output, or give --force"
        )


class _BarStep:
    """Progress bar: a call advances the bar, ``note`` sets the remark next to it."""

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
