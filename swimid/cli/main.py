"""Command-line interface of swimid, with a click command for each row of the table of commands.

The function and the options of a command are imported when it runs. The standard output has the result only:
plain text or, with ``--json``, one JSON document, which also reports errors. Progress, warnings and errors go
to the standard error.
"""

from __future__ import annotations

import inspect
import json
import os
import re
import shlex
import sys
import textwrap
import traceback
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace
from functools import cached_property, partial
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args, get_origin

import click

import swimid
from swimid.commands import COMMAND_SPECS, EVIDENCE, TABLE, CommandSpec
from swimid.errors import InputError, Interrupted, NotEnoughMemory, SwimidError, UsageError, name_arguments
from swimid.files import atomic, provenance
from swimid.notices import Notice, Progress, Step, record_warnings, silent

if TYPE_CHECKING:
    from swimid.options import Declared
    from swimid.results.result import Result

#: Terminal codes that erase a progress bar: they move up one line and clear it.
ERASE_BAR = "\x1b[1A\x1b[2K"
#: Maximum width of a line of a warning on the terminal, characters.
WIDTH = 100
#: Maximum number of warnings with the same code that are all printed. If there are more, only the first three
#: and the number of the remaining warnings are printed, unless -v is given.
MAX_ALIKE = 5
_flag = partial(click.Option, is_flag=True)
#: Command-line options that every command has in addition to ``-o``.
SHARED = (
    _flag(["--json", "as_json"], help="Print the result as one JSON document on stdout."),
    _flag(["--force"], help="Overwrite an output that swimid did not write."),
    _flag(["-q", "--quiet"], help="Print errors only."),
    click.Option(["-v", "--verbose"], count=True, help="Print every warning, also many of one kind."),
    _flag(["--no-progress"], help="No progress bars."),
    _flag(["--debug"], help="Show tracebacks."),
)

# ---------------------------------------------------------------- run of one command


class Bug(SwimidError):
    """Error that reports an unexpected exception as a bug in swimid."""


@dataclass
class CommandRun:
    """Execution of one command, with the values of the options that all commands share."""

    command: str
    output: Path | None = None
    as_json: bool = False
    force: bool = False
    quiet: bool = False
    verbose: int = 0
    no_progress: bool = False
    debug: bool = False
    #: Whether the output is locked while the command runs.
    lock: bool = True

    @property
    def progress(self) -> Progress:
        """Function that opens a progress bar on the standard error.

        The bar shows nothing if the standard error is not a terminal, or if the user wants no progress bars.
        """
        if self.no_progress or self.quiet or not sys.stderr.isatty() or os.environ.get("CI"):
            return silent
        return _bar

    def __call__(self, work: Callable[[], Result]) -> None:
        """Execute the command: call its function, print result and warnings, and exit with a status.

        ``work`` is the function without arguments that computes the result. The exit status is 0 for success,
        2 for wrong usage, 3 for an invalid input, 4 for no trustworthy result, 1 for a bug, and 130 for an
        interrupt.
        """
        notices: list[Notice] = []
        written: list[Path] = []
        interrupts: list[Callable[[], None]] = []

        def note_interrupt(interrupt: Callable[[], None]) -> None:
            # Record the interrupt, because a search may catch its exception and return the best result so
            # far.
            interrupts.append(interrupt)
            interrupt()

        try:
            with (
                atomic.on_interrupt(note_interrupt),
                name_arguments(None),
                record_warnings() as notices,
                atomic.record_writes() as written,
                atomic.hold_lock(self.output if self.lock else None),
            ):
                outcome = work()
            if interrupts:
                places = ", ".join(map(str, outcome.outputs)) or "nothing"
                text = f"interrupted before the search ended; the result so far is written: {places}"
                raise Interrupted(text)
        except BrokenPipeError:
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            sys.exit(0)
        except (KeyboardInterrupt, Exception) as caught:  # noqa: BLE001 - the last line of defence
            if self.debug:
                traceback.print_exc()
            if interrupts and not isinstance(caught, SwimidError):
                # A library may replace the exception of Ctrl-C by another one, such as during its import.
                caught = KeyboardInterrupt()
            error, lead = self._as_error(caught, written), "Error"
            if isinstance(error, Bug):
                lead = "This is a bug in swimid"
            self._print({"error": error.to_dict()}, notices, written)
            click.echo(f"{lead}: {error}", err=True)
            sys.exit(error.exit_status)
        self._print({"result": outcome.data}, notices, outcome.outputs, outcome)
        if outcome.exit_status:
            sys.exit(outcome.exit_status)

    def _as_error(self, caught: BaseException, written: list[Path]) -> SwimidError:
        """Convert the exception that ended the command into a :class:`SwimidError`.

        ``written`` has the files that the command wrote before the exception.
        """
        if isinstance(caught, SwimidError):
            return caught
        if isinstance(caught, OSError):
            # No reader or writer converted this error, for example for the cache of compiled functions.
            text = f"cannot be read or written: {caught.strerror or caught}"
            return InputError(text, file=caught.filename, hint="check the path and the space on the disk")
        if isinstance(caught, MemoryError):
            return NotEnoughMemory(f"not enough memory for this input: {caught}")
        if not isinstance(caught, KeyboardInterrupt):
            hint = "run again with --debug and report the traceback"
            return Bug(f"{type(caught).__name__}: {caught}", hint=hint)
        left = "nothing was written"
        if written:
            left = f"written before: {', '.join(map(str, written))}"
        elif self.output is not None and atomic.checkpoint_path(self.output).is_file():
            checkpoint = atomic.checkpoint_path(self.output)
            left = f"{checkpoint} keeps the computed part: the same command continues from there"
        return Interrupted(f"interrupted; {left}")

    def _print(
        self,
        answer: dict[str, Any],
        notices: list[Notice],
        outputs: Iterable[Path],
        outcome: Result | None = None,
    ) -> None:
        """Print the result of the command, its warnings, its files and a suggested next command.

        The result is printed on the standard output, and so is an error with ``--json``. Everything else is
        printed on the standard error.
        """
        if not self.quiet:
            for line in _warning_lines(notices, (MAX_ALIKE, sys.maxsize)[self.verbose > 0]):
                click.echo(line, err=True)
        following: list[str] = []
        if outcome is not None and (outcome.outputs or "{file}" not in outcome.next_step):
            following = list(filter(None, [outcome.next_command(outcome.path)]))
        if self.as_json:
            from swimid.files import yamlio

            document = {
                "schema": 1,
                "ok": "result" in answer,
                "command": self.command,
                **answer,
                "verdict": _verdict(outcome),
                "warnings": [{"code": one.code, "text": one.text} for one in notices],
                "outputs": [str(path) for path in outputs],
                "next": following,
            }
            click.echo(json.dumps(yamlio.plain(document, finite=True), ensure_ascii=False))
        if self.as_json or self.quiet:
            return
        if outcome is not None and (text := outcome.summary()):
            click.echo(text)
        for path in outputs:
            click.echo(f"wrote {path}", err=True)
        for line in following:
            click.echo(f"next: {line}", err=True)

    def protect(self, output: Path, *, inputs: Iterable[str | Path] = ()) -> None:
        """Raise an error if the output would replace an input, or a file that swimid did not write.

        Raises
        ------
        UsageError
            If the output is an input, or was not written by swimid and ``--force`` is not given.
        InputError
            If the folder of the output does not exist.
        """
        if str(output) == "-":
            hint = "name a file with -o, or print the result with --json"
            raise UsageError("the result of this command is a file and cannot go to stdout", hint=hint)
        atomic.check_writable(output, inputs=inputs)
        if not self.force and not provenance.is_own(output):
            raise UsageError(
                f"{output} exists and was not written by swimid", hint="name another output, or give --force"
            )


def _verdict(outcome: Result | None) -> dict[str, Any] | None:
    """Return level, text and reasons of the verdict on a result; None if nothing was checked."""
    if outcome is None or outcome.evidence is None or not outcome.evidence.checks:
        return None
    found = outcome.evidence
    reasons = [check.reason or check.name for check in found.checks if check.verdict in ("warn", "fail")]
    return {"level": found.verdict.level, "text": found.verdict.text, "reasons": reasons}


def _warning_lines(notices: list[Notice], most: int) -> Iterator[str]:
    """Yield the lines in which a command prints its warnings, grouped by warning code.

    If more than ``most`` warnings have the same code, only three of them and the number of the remaining
    warnings are printed.
    """
    wrapped = partial(
        textwrap.fill,
        width=WIDTH,
        subsequent_indent="    ",
        break_long_words=False,
        break_on_hyphens=False,
    )
    for code in dict.fromkeys(one.code for one in notices):
        shown = [one.text for one in notices if one.code == code]
        more = len(shown) - 3
        if len(shown) > most:
            shown = shown[:3]
        yield from (wrapped(f"warning {code}: {text}") for text in shown)
        if len(shown) == 3 and more > 0:
            yield f"warning {code}: {more} more like these; -v prints them"


@contextmanager
def _bar(description: str, total: int | None = None) -> Iterator[Step]:
    """Draw a progress bar on the standard error during the ``with`` block, and erase it at the end."""
    steps = range(total or 0)
    if total is None:
        steps = count()  # type: ignore[assignment]
    with click.progressbar(steps, label=description, file=sys.stderr, show_pos=True) as bar:

        def step(amount: int = 1) -> None:
            bar.update(amount)

        step.note = lambda text: setattr(bar, "label", f"{description}: {text}")  # type: ignore[attr-defined]
        yield step
    click.echo(ERASE_BAR, file=sys.stderr, nl=False)


# ---------------------------------------------------------------- commands


class _FilePath(click.Path):
    """Click type of a path. A path that is not UTF-8 is an error, because results state paths in UTF-8."""

    def __init__(self) -> None:
        super().__init__(path_type=Path)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the path that the user typed."""
        try:
            str(value).encode()
        except UnicodeEncodeError:
            self.fail(f"{str(value)!r} is not UTF-8; rename the file", param, ctx)
        return super().convert(value, param, ctx)


class Command(click.Command):
    """Click command whose class of options is imported when its options are first needed."""

    def __init__(self, spec: CommandSpec) -> None:
        super().__init__(spec.command.split()[-1], callback=self._run, short_help=spec.help)
        self.spec = spec

    @cached_property
    def _parameters(self) -> list[click.Parameter]:
        usage, options = self.spec.usage, self.spec.model().declarations()
        output = click.Option(
            [*usage.output_flags, "output"],
            type=_FilePath(),
            required=usage.required,
            help=usage.output_help,
        )
        return [*_argument(usage.argument), *map(_option, options.values()), output, *SHARED]

    def get_params(self, ctx: click.Context) -> list[click.Parameter]:
        """Return all parameters of the command: its argument, its own options and the shared options."""
        return [*self._parameters, *super().get_params(ctx)]

    def format_help_text(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the docstring of the class of options to the help text."""
        # Mark the examples with \b, so that click keeps their line breaks.
        text = inspect.getdoc(self.spec.model()) or ""
        self.help = re.sub(r"\n\n(Examples?:)", "\n\n\b\n\\1", text)
        super().format_help_text(ctx, formatter)

    def _run(self, *, files: Any = None, place: Path | None = None, **typed: Any) -> None:
        """Execute the command with the arguments and options that the user typed."""
        if place is not None and typed["output"] is not None:
            raise click.UsageError(f"two outputs are named, {place} and {typed['output']}: omit either")
        typed["output"] = place or typed["output"]
        shared = {one.name: typed.pop(one.name) for one in fields(CommandRun) if one.name in typed}
        run = CommandRun(self.spec.command, lock=self.spec.usage.lock, **shared)
        run(partial(self._outcome, run, files, typed))

    def _outcome(self, run: CommandRun, files: Any, typed: dict[str, Any]) -> Result:
        """Call the function of the command with the typed options, and return its result."""
        declared = self.spec.model().declarations()
        options = {name: value_of(declared[name], text) for name, text in typed.items()}
        output, defaults = run.output, self.spec.usage.stdout
        to_stdout = defaults is not None and output in (None, Path("-"))
        if defaults is not None and to_stdout:
            output = None
            options |= {name: value for name, value in defaults.items() if options[name] is None}
        function = self.spec.run()
        given = self._protect(function, run, files, output, options)
        outcome: Result = function(*filter(None, [files]), output=output, **options, **given)
        if to_stdout and not run.as_json:
            # Print the document also with --quiet, because it is the result.
            click.echo(outcome.text)
            outcome = replace(outcome, text="")
        return outcome

    def _protect(
        self, function: Any, run: CommandRun, files: Any, output: Path | None, options: Mapping[str, Any]
    ) -> dict[str, Any]:
        """Raise an error for an output that must not be replaced. Return the arguments that a function takes.

        A function with an argument ``allow`` or ``force`` protects its outputs itself.
        """
        inputs = list(files) if isinstance(files, tuple) else [files]
        written = [] if output is None else [output]
        for name, entry in self.spec.model().declarations().items():
            inputs += entry.files(options[name])
            if entry.written and options[name] is not None:
                written.append(options[name])
        _insist_distinct(written)
        allow = partial(run.protect, inputs=inputs)
        offered = {"progress": run.progress, "force": run.force, "allow": allow}
        given = {name: offered[name] for name in inspect.signature(function).parameters if name in offered}
        if not given.keys() & {"allow", "force"}:
            for place in written:
                allow(place)
        if output is not None and not output.is_dir():
            # Do not overwrite a file of another program, or the evidence of another result.
            from swimid.results import evidence

            for ending in self.spec.usage.beside:
                run.protect(output.with_name(output.stem + ending))
            if EVIDENCE in self.spec.usage.beside and not run.force:
                evidence.check_beside(output)
        return given


def check_words(spec: CommandSpec, words: list[str]) -> None:
    """Check the arguments and options of a command line without executing the command.

    Raises
    ------
    click.UsageError
        If an option does not exist or is missing, or if a value has the wrong type.
    UsageError
        If a value is not allowed.
    """
    context = Command(spec).make_context(spec.command, list(words))
    declared = spec.model().declarations()
    given = {name: value_of(entry, context.params[name]) for name, entry in declared.items()}
    spec.model().of(given)


def _argument(metavar: str) -> list[click.Parameter]:
    """Return the positional argument of a command as a list of click parameters.

    The list is empty for an empty ``metavar``. ``LOG...`` stands for several files, ``[NAME]`` for an
    optional word. A second word is the output, as an alternative to ``-o``.
    """
    if not metavar:
        return []
    metavar, _, place = metavar.partition(" ")
    if place:
        return [
            *_argument(metavar),
            click.Argument(["place"], required=False, metavar=place, type=_FilePath()),
        ]
    kind: click.ParamType = _FilePath()
    count = 1
    if metavar.endswith("..."):
        count = -1
    optional = metavar.startswith("[")
    if optional:
        kind = click.STRING
    return [click.Argument(["files"], nargs=count, required=not optional, metavar=metavar, type=kind)]


def _option(entry: Declared) -> click.Option:
    """Return the click option that corresponds to an option in a class of options.

    A value with several parts, such as ``NAME=VALUE``, is parsed when the command runs.
    """
    names = [entry.flags, entry.name]
    about: dict[str, Any] = {"help": entry.help, "metavar": entry.metavar, **word_of(entry)}
    if entry.required:
        # Pass no default to click, because click does not require an option with a default, even None.
        return click.Option(names, required=True, **about)
    default, shown = entry.default, entry.default is not None
    if entry.kind is bool:
        shown = shown and "/" in entry.flags
    elif default in ((), {}):
        default, shown = None, False
    return click.Option(names, default=default, show_default=shown, **about)


def _insist_distinct(places: list[Path]) -> None:
    """Raise an error if two outputs of a command are the same file."""
    resolved = [place.resolve() for place in places]
    for place, file in zip(places, resolved, strict=True):
        if resolved.count(file) > 1:
            hint = "name different files for the two outputs"
            raise UsageError(f"two outputs would be written to {place}", hint=hint)


# ---------------------------------------------------------------- values of options


def word_of(entry: Declared) -> dict[str, Any]:
    """Return the keyword arguments that tell click the type and the number of values of an option."""
    kind = entry.kind
    word: dict[str, Any] = {}
    if kind is bool:
        return {"is_flag": True}
    if get_origin(kind) is Mapping or get_args(kind)[-1:] == (Ellipsis,):
        kind, word = get_args(kind)[0], {"multiple": True}
    if entry.separated or _by_commas(entry):
        kind = str
    if get_origin(kind) is tuple:
        return word | {"type": get_args(kind)[0], "nargs": len(get_args(kind))}
    return word | {"type": _simple(kind, entry.limits)}


def value_of(entry: Declared, typed: Any) -> Any:
    """Convert the text that the user typed for an option into its value; None if the option is not given.

    Raises
    ------
    UsageError
        If the text is not a value of the option.
    """
    if typed is None or typed == ():
        return None
    kind = entry.kind
    if get_origin(kind) is Mapping:
        return _parse_named(typed, entry)
    if reads := getattr(next(iter(get_args(kind)), None), "of_text", None):
        return tuple(reads(text, entry.flag) for text in typed)
    if entry.separated:
        return tuple(part.strip() for text in typed for part in text.split(",") if part.strip())
    if _by_commas(entry):
        return _numbers(typed, kind, entry, typed, "two numbers with a comma between them")
    return typed


def _simple(kind: Any, limits: Mapping[str, float]) -> Any:
    """Return the click type for an option whose value is a single word, with the limits of a number."""
    if get_origin(kind) is Literal:
        return click.Choice(list(get_args(kind)))
    if Path in (kind, *get_args(kind)) and str not in get_args(kind):
        return _FilePath()
    if kind in (int, float):
        if not limits:
            return kind
        low, high = (limits.get(near, limits.get(open_)) for near, open_ in (("ge", "gt"), ("le", "lt")))
        number_range: Any = click.IntRange if kind is int else click.FloatRange
        made = number_range(low, high, min_open="gt" in limits, max_open="lt" in limits)
        made.name = {int: "integer", float: "number"}[kind]
        return made
    return str


def _by_commas(entry: Declared) -> bool:
    """Return whether the value of an option is several numbers that are typed as one word with commas."""
    pair = get_origin(entry.kind) is tuple and Ellipsis not in get_args(entry.kind)
    return pair and "," in (entry.metavar or "")


#: Pattern of a number that is typed as a part of an option. It excludes infinite numbers and NaN.
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d{1,2})?")


def _numbers(text: str, kind: Any, entry: Declared, whole: str, form: str) -> Any:
    """Convert the text of an option into a number, or into a tuple of numbers if the type is a tuple.

    ``whole`` and ``form`` are the typed text and its expected form in error messages.
    """
    parts = re.split("[,:]", text)
    count = max(len(get_args(kind)), 1)
    if len(parts) != count:
        raise UsageError(f"{entry.flag}: '{whole}' should be {form}")
    for part in parts:
        if not _NUMBER.fullmatch(part.strip()):
            raise UsageError(f"{entry.flag}: '{part}' is not a number")
    values = tuple(map(float, parts))
    return values if get_args(kind) else values[0]


def _parse_named(texts: tuple[str, ...], entry: Declared) -> dict[str, Any]:
    """Convert the texts of an option of the form ``NAME=VALUE`` into a mapping of names to values."""
    kind, named = get_args(entry.kind)[1], {}
    for text in texts:
        name, equals, value = text.partition("=")
        if not equals or not name:
            raise UsageError(f"{entry.flag}: '{text}' should be NAME=VALUE")
        if name.strip() in named:
            raise UsageError(f"{entry.flag}: {name.strip()} is given twice")
        found: Any = value.strip()
        if kind is not str:
            found = _numbers(value, kind, entry, text, entry.metavar or "NAME=VALUE")
        named[name.strip()] = found
    return named


# ---------------------------------------------------------------- groups of commands


class Sectioned(click.Group):
    """Command group whose help lists the commands by purpose."""

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the list of commands to the help text, with a heading for each purpose."""
        for title, commands in TABLE.items():
            names = {name.split()[0] for name, *_ in commands}
            rows = [(name, self.commands[name].get_short_help_str(limit=88)) for name in sorted(names)]
            with formatter.section(title):
                formatter.write_dl(rows)


@click.group(
    cls=Sectioned, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110}
)
@click.version_option(swimid.__version__, prog_name="swimid")
def main() -> None:
    """System identification for swimming robots.

    From overhead videos, rig recordings and IMU logs to published parameters: every number
    with its uncertainty, every result with the evidence it rests on.

    \b
    A first session, on a sample:
      swimid sample rig
      swimid fit-drag rig/trials.yaml -o drag.yaml
      swimid report drag.yaml -o report.html
    """


class Tracking(click.Group):
    """Command group whose error message names the right command if a file is typed in place of a command."""

    def resolve_command(self, ctx: click.Context, args: list[str]) -> Any:
        """Return the command that the first word names."""
        if args[0] not in self.commands and Path(args[0]).exists():
            file, kind = shlex.quote(args[0]), "setup"
            if Path(args[0]).suffix.lower() in (".csv", ".txt", ".parquet"):
                kind = "imu"
            output = {"setup": "setup.yaml", "imu": "run.csv"}[kind]
            ctx.fail(f"'{args[0]}' is a file; type: swimid track {kind} {file} -o {output}")
        return super().resolve_command(ctx, args)


@main.group("track", cls=Tracking)
def track_group() -> None:
    """Make logs: from videos with coloured markers, and from IMU recordings."""


@main.group()
def optimise() -> None:
    """Find the best stiffness for each frequency and amplitude, or the best gait."""


for spec in COMMAND_SPECS.values():
    {"track": track_group, "optimise": optimise}.get(spec.command.split()[0], main).add_command(Command(spec))


def entry() -> None:
    """Run the command line of swimid. This is the entry point of the console script ``swimid``."""
    main(prog_name="swimid")
