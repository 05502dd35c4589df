"""Declarations of all commands, which are read as text from the files ``options.py`` of the packages.

The list of commands can therefore be shown without an import of the packages.
"""

from __future__ import annotations

import ast
import importlib
import inspect
import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from swimid.options import Options

#: Ending of the name of an evidence file, which a command writes next to its result.
EVIDENCE = ".evidence.json"
#: Kinds of files that a command makes, besides the result files, each of which has a format of its own.
KINDS = ("", "log", "parameters", "setup", "picture", "page")


@dataclass(frozen=True)
class CommandSpec:
    """Declaration of a command, which is read from its class of options (:class:`swimid.options.Options`).

    Attributes
    ----------
    command, section, output, argument, output_flags, required, stdout, beside, function, module, makes,
    metrics, lock
        Class arguments of the class of options.
    package, options, help : str
        Name of the package, and name and docstring of the class of options.
    """

    command: str
    section: str
    package: str
    options: str
    help: str
    output: str = ""
    argument: str = "TRIALS"
    output_flags: tuple[str, ...] = ("-o", "--output")
    required: bool = False
    stdout: Mapping[str, Any] | None = None
    beside: tuple[str, ...] = (EVIDENCE,)
    function: str = ""
    module: str = ""
    makes: str = ""
    metrics: tuple[str, ...] = ()
    lock: bool = True

    @property
    def kind(self) -> str:
        """Kind of file that the command makes, by which a batch connects steps: ``log``, ``result``, ..."""
        return self.makes if self.makes in KINDS else "result"

    @property
    def output_help(self) -> str:
        """Description of the output in the help text."""
        named = self.makes.partition("|")[0].replace("-", " ").replace("parameters", "parameter")
        return self.output or f"{named.capitalize()} file to write (YAML)."

    def model(self) -> type[Options]:
        """Import the class of options of the command, and return this class."""
        loaded: type[Options] = getattr(importlib.import_module(f"{self.package}.options"), self.options)
        return loaded

    @property
    def place(self) -> tuple[str, str]:
        """Module and name of the function that the command calls."""
        name = self.function or re.sub("[ -]", "_", self.command)
        return f"{self.package}.{self.module or name}", name

    def run(self) -> Any:
        """Import the function that the command calls, and return this function."""
        module, name = self.place
        return getattr(importlib.import_module(module), name)

    def result_type(self) -> Any:
        """Import the function that the command calls, and return the type of its result."""
        function = inspect.unwrap(self.run())
        kind = function.__annotations__["return"]
        return eval(kind, function.__globals__) if isinstance(kind, str) else kind


@cache
def find_commands() -> dict[str, CommandSpec]:
    """Find the declarations of all commands in the files ``options.py``, and return them by command name."""
    specs = {}
    for path in sorted(Path(__file__).parent.glob("*/options.py")):
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.ClassDef) and node.keywords:
                given = {str(one.arg): ast.literal_eval(one.value) for one in node.keywords}
                about = (f"swimid.{path.parent.name}", node.name, ast.get_docstring(node) or "")
                spec = CommandSpec(given.pop("command"), given.pop("section"), *about, **given)
                specs[spec.command] = spec
    return specs
