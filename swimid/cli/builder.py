"""A command made of a verb's options: what is typed becomes keyword arguments of its function."""

from __future__ import annotations

import importlib
import inspect
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from swimid.cli import parsing
from swimid.cli.common import Shared, protect, running, shared_options
from swimid.errors import UsageError

if TYPE_CHECKING:
    from swimid.options import Declared, Options

#: Ending of the evidence beside a result.
EVIDENCE = ".evidence.json"


@dataclass(frozen=True)
class Verb:
    """A command: what it is called, what it says, and the function that does it.

    Attributes
    ----------
    name : str
    function : str
        ``package.module:function``; it takes the argument, ``output``, the options, and ``progress``,
        ``allow`` or ``force`` where it wants them. Imported when the command runs.
    options : str
        ``package.module:class`` of its model of options. Imported when its options are looked at.
    output : str
        What ``-o`` writes.
    help : str
        Its first line is what the list of commands shows, where ``short`` is empty.
    short : str
    argument : str
        Metavar of the files it takes, ``LOG...`` for several, ``[NAME]`` for a word or none; empty for none.
    output_flags : tuple of str
    required : bool
        Whether it must be told where to write.
    prints : bool
        Whether without a file its document goes to stdout.
    beside : tuple of str
        Endings of the files that it writes beside the output, with the output's stem.
    check : callable, optional
        ``check(output, options, shared)`` before the work: what only the command line can get wrong. It may
        change the options.
    """

    name: str
    function: str
    options: str
    output: str
    help: str
    short: str = ""
    argument: str = "TRIALS"
    output_flags: tuple[str, ...] = ("-o", "--output")
    required: bool = False
    prints: bool = False
    beside: tuple[str, ...] = (EVIDENCE,)
    check: Callable[[Path | None, dict[str, Any], Shared], None] | None = None

    def model(self) -> type[Options]:
        """The model of its options."""
        return _load(self.options)

    def command(self) -> click.Command:
        """The command; its options are imported when they are looked at."""
        return _Command(self)


class _Command(click.Command):
    """A command with the options of a verb."""

    def __init__(self, verb: Verb) -> None:
        shared = shared_options(verb.output, output_flags=verb.output_flags, required=verb.required)
        plain = click.command()(shared(_runner(verb)))
        super().__init__(
            verb.name.split()[-1],
            params=plain.params,
            callback=plain.callback,
            help=inspect.cleandoc(verb.help),
            short_help=verb.short or None,
        )
        self.verb = verb
        self._own: list[click.Parameter] | None = None

    def get_params(self, ctx: click.Context) -> list[click.Parameter]:
        """The files, the options of the verb, those of every verb."""
        if self._own is None:
            declared = self.verb.model().declared().values()
            self._own = [*_argument(self.verb), *(_option(entry) for entry in declared)]
        return [*self._own, *super().get_params(ctx)]


def _argument(verb: Verb) -> list[click.Parameter]:
    if not verb.argument:
        return []
    count = -1 if verb.argument.endswith("...") else 1
    name = verb.argument.startswith("[")
    kind = str if name else click.Path(path_type=Path)
    return [click.Argument(["files"], nargs=count, required=not name, metavar=verb.argument, type=kind)]


def _option(entry: Declared) -> click.Option:
    """An option as click takes it; what is more than one word is parsed when the command runs."""
    names = [entry.flags, entry.name]
    if entry.kind is bool:
        shown = "/" in entry.flags and entry.default is not None
        return click.Option(names, is_flag=True, default=entry.default, show_default=shown, help=entry.help)
    word = parsing.word_of(entry)
    # a required option that has a default, None even, is not asked for
    default = (entry.default or None) if word.get("multiple") else entry.default
    unasked: dict[str, Any] = {"default": default, "show_default": default is not None}
    return click.Option(
        names,
        required=entry.required,
        metavar=entry.metavar,
        help=entry.help,
        **word,
        **({} if entry.required else unasked),
    )


def _runner(verb: Verb) -> Callable[..., None]:
    """What the command does: parse, protect the outputs, call the function, print."""

    def run_verb(shared: Shared, files: Any = None, **typed: Any) -> None:
        with running(verb.name, shared) as run:
            declared = verb.model().declared()
            options = {name: parsing.value_of(declared[name], text) for name, text in typed.items()}
            output = None if verb.prints and str(shared.output) == "-" else shared.output
            if verb.check is not None:
                verb.check(output, options, shared)
            read = [*(files if isinstance(files, tuple) else (files,))] if files else []
            read += [file for entry in declared.values() for file in entry.files(options[entry.name])]
            function = _load(verb.function)
            wanted = inspect.signature(function).parameters

            def allow(path: Path | None) -> None:
                protect(path, shared, inputs=tuple(read))

            offered: dict[str, Any] = {"progress": run.progress, "force": shared.force, "allow": allow}
            written = [output, *(options[entry.name] for entry in declared.values() if entry.written)]
            _insist_distinct([place for place in written if place is not None])
            if not {"allow", "force"} & set(wanted):
                for place in written:
                    allow(place)
            if output is not None and not output.is_dir():
                _protect_beside(output, verb, shared)
            given = {name: value for name, value in offered.items() if name in wanted}
            outcome = function(*([files] if files else []), output=output, **options, **given)
            if verb.prints and output is None and not shared.as_json:
                # the document is the result: --quiet must not swallow it
                click.echo(outcome.text)
                outcome = replace(outcome, text="")
            run.finish(outcome)

    return run_verb


def _insist_distinct(places: list[Path]) -> None:
    """Refuse two outputs that are one file."""
    resolved = [place.resolve() for place in places]
    for place, file in zip(places, resolved, strict=True):
        if resolved.count(file) > 1:
            raise UsageError(f"two outputs would be written to {place}", hint="name another file for one")


def _protect_beside(output: Path, verb: Verb, shared: Shared) -> None:
    """Refuse to replace files of others, and evidence of other results, beside the output."""
    from swimid.results import evidence

    for ending in verb.beside:
        protect(output.with_name(output.stem + ending), shared)
    if EVIDENCE in verb.beside and not shared.force:
        evidence.check_beside(output)


def _load(name: str) -> Any:
    module, _, attribute = name.partition(":")
    return getattr(importlib.import_module(module), attribute)
