"""The commands, found in the ``options.py`` of every package, as click takes them.

The files are read as text, so that the list of commands imports no package.
"""

from __future__ import annotations

import ast
import importlib
import inspect
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from swimid.cli import parsing
from swimid.cli.common import SHARED, Shared, protect, running
from swimid.errors import UsageError

if TYPE_CHECKING:
    from swimid.options import Declared, Options

#: Ending of the evidence beside a result.
EVIDENCE = ".evidence.json"


@dataclass(frozen=True)
class CommandSpec:
    """A command as its class of options states it; see :class:`swimid.options.Options`.

    Attributes
    ----------
    command, section, output, argument, output_flags, required, stdout, beside, function, page
        The arguments of the class.
    package, options, help : str
        The package and the name of the class; its docstring.
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
    page: str = ""

    def model(self) -> type[Options]:
        """Import the class of its options."""
        loaded: type[Options] = getattr(importlib.import_module(f"{self.package}.options"), self.options)
        return loaded

    def run(self) -> Any:
        """Import its function."""
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
    """A command; its options are imported when they are looked at."""

    def __init__(self, spec: CommandSpec) -> None:
        path = click.Path(path_type=Path)
        output = click.Option(
            [*spec.output_flags, "output"], type=path, required=spec.required, help=spec.output
        )
        # click keeps the lines of a paragraph that begins with \b
        help = re.sub(r"\n\n(Examples?:)", "\n\n\b\n\\1", spec.help)
        name = spec.command.split()[-1]
        super().__init__(name, params=[output, *SHARED], callback=self._called, help=help)
        self.spec = spec
        self._own: list[click.Parameter] | None = None

    def get_params(self, ctx: click.Context) -> list[click.Parameter]:
        """Return the files, the options of the command, those of every command."""
        if self._own is None:
            declared = self.spec.model().declared().values()
            self._own = [*_argument(self.spec.argument), *(_option(entry) for entry in declared)]
        return [*self._own, *super().get_params(ctx)]

    def _called(self, *, files: Any = None, **typed: Any) -> None:
        """Parse, protect the outputs, call the function, print."""
        shared = Shared.taken_from(typed)
        spec = self.spec
        with running(spec.command, shared) as run:
            declared = spec.model().declared()
            options = {name: parsing.value_of(declared[name], text) for name, text in typed.items()}
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
                # the document is the result: --quiet must not swallow it
                click.echo(outcome.text)
                outcome = replace(outcome, text="")
            run.outcome = outcome


def _argument(metavar: str) -> list[click.Parameter]:
    """Return the files a command takes: ``LOG...`` several, ``[NAME]`` a word or none, empty none."""
    if not metavar:
        return []
    count = -1 if metavar.endswith("...") else 1
    name = metavar.startswith("[")
    kind = str if name else click.Path(path_type=Path)
    return [click.Argument(["files"], nargs=count, required=not name, metavar=metavar, type=kind)]


def _option(entry: Declared) -> click.Option:
    """Return an option as click takes it; what is more than one word is parsed when the command runs."""
    names = [entry.flags, entry.name]
    if entry.kind is bool:
        shown = "/" in entry.flags and entry.default is not None
        return click.Option(names, is_flag=True, default=entry.default, show_default=shown, help=entry.help)
    word = parsing.word_of(entry)
    if entry.required:
        # a required option that has a default, None even, is not asked for
        return click.Option(names, required=True, metavar=entry.metavar, help=entry.help, **word)
    default = (entry.default or None) if word.get("multiple") else entry.default
    shown = default is not None
    return click.Option(
        names, metavar=entry.metavar, help=entry.help, default=default, show_default=shown, **word
    )


def _insist_distinct(places: list[Path]) -> None:
    """Refuse two outputs that are one file."""
    resolved = [place.resolve() for place in places]
    for place, file in zip(places, resolved, strict=True):
        if resolved.count(file) > 1:
            raise UsageError(f"two outputs would be written to {place}", hint="name another file for one")


def _protect_beside(output: Path, spec: CommandSpec, shared: Shared) -> None:
    """Refuse to replace files of others, and evidence of other results, beside the output."""
    from swimid.results import evidence

    for ending in spec.beside:
        protect(output.with_name(output.stem + ending), shared)
    if EVIDENCE in spec.beside and not shared.force:
        evidence.check_beside(output)
