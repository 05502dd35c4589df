"""The ``swimid`` command: a click command for each class of options in the ``options.py`` of a package.

The files are parsed as text, so that the list of commands can be shown without an import of the packages.
"""

from __future__ import annotations

import ast
import importlib
import inspect
import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args, get_origin

import click

import swimid
from swimid.cli.common import SHARED, Shared, protect, running
from swimid.errors import UsageError

if TYPE_CHECKING:
    from swimid.options import Declared, Options

#: Ending of an evidence file.
EVIDENCE = ".evidence.json"


@dataclass(frozen=True)
class CommandSpec:
    """Declaration of a command by its class of options; see :class:`swimid.options.Options`.

    Attributes
    ----------
    command, section, output, argument, output_flags, required, stdout, beside, function
        Arguments of the class.
    package, options, help : str
        Name of the package, name of the class, and docstring of the class.
    """

    command: str
    section: str
    output: str
    package: str
    options: str
    help: str
    argument: str = "TRIALS"
    output_flags: tuple[str, ...] = ("-o", "--output")
    required: bool = False
    stdout: Mapping[str, Any] | None = None
    beside: tuple[str, ...] = (EVIDENCE,)
    function: str = ""

    def model(self) -> type[Options]:
        """Import and return the class of the options."""
        loaded: type[Options] = getattr(importlib.import_module(f"{self.package}.options"), self.options)
        return loaded

    def run(self) -> Any:
        """Import and return the function of the command."""
        name = self.function or re.sub("[ -]", "_", self.command)
        return getattr(importlib.import_module(f"{self.package}.{name}"), name)


@cache
def found() -> dict[str, CommandSpec]:
    """Return every command by its name."""
    specs = {}
    for path in sorted(Path(__file__).parents[1].glob("*/options.py")):
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.ClassDef) and node.keywords:
                given = {str(one.arg): ast.literal_eval(one.value) for one in node.keywords}
                help = ast.get_docstring(node) or ""
                spec = CommandSpec(
                    package=f"swimid.{path.parent.name}", options=node.name, help=help, **given
                )
                specs[spec.command] = spec
    return specs


class Command(click.Command):
    """Click command whose options are imported on first use."""

    def __init__(self, spec: CommandSpec) -> None:
        path = click.Path(path_type=Path)
        output = click.Option(
            [*spec.output_flags, "output"], type=path, required=spec.required, help=spec.output
        )
        # click keeps the line breaks of a paragraph that begins with \b
        help = re.sub(r"\n\n(Examples?:)", "\n\n\b\n\\1", spec.help)
        name = spec.command.split()[-1]
        super().__init__(name, params=[output, *SHARED], callback=self._called, help=help)
        self.spec = spec
        self._own: list[click.Parameter] | None = None

    def get_params(self, ctx: click.Context) -> list[click.Parameter]:
        """Return the file argument, the options of this command, and the options of every command."""
        if self._own is None:
            declared = self.spec.model().declared().values()
            self._own = [*_argument(self.spec.argument), *(_option(entry) for entry in declared)]
        return [*self._own, *super().get_params(ctx)]

    def _called(self, *, files: Any = None, **typed: Any) -> None:
        """Read the options, protect the outputs, call the function, and print or store the outcome."""
        shared = Shared.taken_from(typed)
        spec = self.spec
        with running(spec.command, shared) as run:
            declared = spec.model().declared()
            options = {name: value_of(declared[name], text) for name, text in typed.items()}
            output = shared.output
            if spec.stdout is not None and (output is None or str(output) == "-"):
                output = None
                options |= {name: value for name, value in spec.stdout.items() if options[name] is None}
            read = [*(files if isinstance(files, tuple) else (files,))] if files else []
            read += [file for entry in declared.values() for file in entry.files(options[entry.name])]
            written = [options[entry.name] for entry in declared.values() if entry.written]
            written = [place for place in [output, *written] if place is not None]
            _insist_distinct(written)

            def allow(path: Path | None) -> None:
                protect(path, shared, inputs=read)

            function = spec.run()
            offered: dict[str, Any] = {"progress": run.progress, "force": shared.force, "allow": allow}
            given = {
                name: offered[name] for name in inspect.signature(function).parameters if name in offered
            }
            if not {"allow", "force"} & set(given):
                for place in written:
                    allow(place)
            if output is not None and not output.is_dir():
                _protect_beside(output, spec, shared)
            outcome = function(*([files] if files else []), output=output, **options, **given)
            if spec.stdout is not None and output is None and not shared.as_json:
                # the document is the result: print it also with --quiet
                click.echo(outcome.text)
                outcome = replace(outcome, text="")
            run.outcome = outcome


def _argument(metavar: str) -> list[click.Parameter]:
    """Return the positional argument: ``LOG...`` is several files, ``[NAME]`` is an optional word."""
    if not metavar:
        return []
    count = (1, -1)[metavar.endswith("...")]
    if metavar.startswith("["):
        return [click.Argument(["files"], nargs=count, required=False, metavar=metavar, type=str)]
    path = click.Path(path_type=Path)
    return [click.Argument(["files"], nargs=count, required=True, metavar=metavar, type=path)]


def _option(entry: Declared) -> click.Option:
    """Return the click option. A value of several words is parsed when the command runs."""
    names = [entry.flags, entry.name]
    if entry.kind is bool:
        shown = "/" in entry.flags and entry.default is not None
        return click.Option(names, is_flag=True, default=entry.default, show_default=shown, help=entry.help)
    word = word_of(entry)
    if entry.required:
        # no default: click does not require an option that has a default, even if it is None
        return click.Option(names, required=True, metavar=entry.metavar, help=entry.help, **word)
    default = (entry.default or None) if word.get("multiple") else entry.default
    shown = default is not None
    return click.Option(
        names, metavar=entry.metavar, help=entry.help, default=default, show_default=shown, **word
    )


def _insist_distinct(places: list[Path]) -> None:
    """Refuse two outputs that are the same file."""
    resolved = [place.resolve() for place in places]
    for place, file in zip(places, resolved, strict=True):
        if resolved.count(file) > 1:
            raise UsageError(f"two outputs would be written to {place}", hint="name another file for one")


def _protect_beside(output: Path, spec: CommandSpec, shared: Shared) -> None:
    """Refuse to replace files of other programs, or evidence of other results, next to the output."""
    from swimid.results import evidence

    for ending in spec.beside:
        protect(output.with_name(output.stem + ending), shared)
    if EVIDENCE in spec.beside and not shared.force:
        evidence.check_beside(output)


# ---------------------------------------------------------------- values of options


def word_of(entry: Declared) -> dict[str, Any]:
    """Return the type arguments of a click option: ``type``, and ``multiple`` or ``nargs``."""
    kind, args = entry.kind, get_args(entry.kind)
    if _is_mapping(kind):
        return {"type": str, "multiple": True}
    if get_origin(kind) is not tuple:
        return {"type": _simple(kind, entry.limits)}
    if args[-1] is not Ellipsis:
        return {"type": str} if _by_commas(entry) else {"type": args[0], "nargs": len(args)}
    one = get_args(args[0]) if get_origin(args[0]) is tuple else ()
    if one:
        return {"type": one[0], "multiple": True, "nargs": len(one)}
    return {"type": str if entry.separated else _simple(args[0], {}), "multiple": True}


def value_of(entry: Declared, typed: Any) -> Any:
    """Return the value of an option from the text that was typed; None if no text was typed.

    Raises
    ------
    UsageError
        If the text is not a value of the option.
    """
    if typed is None or typed == ():
        return None
    kind = entry.kind
    if _is_mapping(kind):
        items, value = _named(typed, entry.flag), get_args(kind)[1]
        if value not in _READERS:
            return swept(items, entry.flag)
        return {name: _READERS[value](text, entry.flag) for name, text in items}
    if reads := getattr(next(iter(get_args(kind)), None), "of_text", None):
        return tuple(reads(text, entry.flag) for text in typed)
    if entry.separated:
        return tuple(part.strip() for text in typed for part in text.split(",") if part.strip())
    return number_pair(typed, entry.flag) if _by_commas(entry) else typed


def _simple(kind: Any, limits: Mapping[str, float]) -> Any:
    """Return the click type of an option whose value is a single word."""
    if get_origin(kind) is Literal:
        return click.Choice(list(get_args(kind)))
    if Path in (kind, *get_args(kind)) and str not in get_args(kind):
        return click.Path(path_type=Path)
    if kind in (int, float):
        if not limits:
            return kind
        low, high = (limits.get(near, limits.get(open_)) for near, open_ in (("ge", "gt"), ("le", "lt")))
        number_range: Any = click.IntRange if kind is int else click.FloatRange
        return number_range(low, high, min_open="gt" in limits, max_open="lt" in limits)
    return str


def _is_mapping(kind: Any) -> bool:
    origin = get_origin(kind)
    return isinstance(origin, type) and issubclass(origin, Mapping)


def _by_commas(entry: Declared) -> bool:
    """Return whether an option with several numbers is typed as one word with commas."""
    pair = get_origin(entry.kind) is tuple and Ellipsis not in get_args(entry.kind)
    return pair and "," in (entry.metavar or "")


def number(text: str, option: str) -> float:
    """Read one finite number."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise UsageError(f"{option}: '{text}' is not a number")
    return value


def number_pair(text: str, option: str) -> tuple[float, float]:
    """Read two numbers with a comma between them."""
    parts = text.split(",")
    if len(parts) != 2:
        raise UsageError(f"{option}: '{text}' should be two numbers with a comma between them")
    return number(parts[0], option), number(parts[1], option)


def swept(items: list[tuple[str, str]], option: str) -> dict[str, tuple[float, float, int]]:
    """Read ``NAME=LOW:HIGH:COUNT`` items."""
    sweeps = {}
    for name, value in items:
        parts = value.split(":")
        if len(parts) != 3 or not parts[2].strip().isdigit():
            raise UsageError(f"{option}: '{name}={value}' should be NAME=LOW:HIGH:COUNT")
        if name in sweeps:
            raise UsageError(f"{option}: {name} is given twice")
        sweeps[name] = (number(parts[0], option), number(parts[1], option), int(parts[2]))
    return sweeps


def _named(texts: tuple[str, ...], option: str) -> list[tuple[str, str]]:
    """Read ``NAME=VALUE`` items."""
    pairs = []
    for text in texts:
        name, equals, value = text.partition("=")
        if not equals or not name:
            raise UsageError(f"{option}: '{text}' should be NAME=VALUE")
        pairs.append((name.strip(), value))
    return pairs


#: Function that reads a value of a mapping, by the type of the value.
_READERS: dict[Any, Callable[[str, str], Any]] = {
    float: number,
    str: lambda text, option: text.strip(),
    tuple[float, float]: number_pair,
}


# ---------------------------------------------------------------- groups of commands

#: Headings of the list of commands, in the usual order of work.
SECTIONS = (
    "Make logs",
    "Identify",
    "Simulate and compare",
    "Diagnose",
    "Put to work",
    "Publish",
    "Help yourself",
)


class Sectioned(click.Group):
    """Command group whose help lists the commands by purpose."""

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write one list of commands for each section."""
        sections: dict[str, set[str]] = {title: set() for title in SECTIONS}
        for spec in found().values():
            sections.setdefault(spec.section, set()).add(spec.command.split()[0])
        for title, names in sections.items():
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
    A first session, on the logs that ship with the source:
      swimid fit-drag sample_logs/rig/trials.yaml -o drag.yaml
      swimid report drag.yaml -o report.html
    """


@main.group()
def track() -> None:
    """Make logs: from videos with coloured markers, and from IMU recordings."""


@main.group()
def optimise() -> None:
    """Find the best stiffness for each frequency and amplitude, or the best gait."""


for spec in found().values():
    {"track": track, "optimise": optimise}.get(spec.command.split()[0], main).add_command(Command(spec))


def entry() -> None:
    """Run the command line; entry point of the console script."""
    main(prog_name="swimid")
