"""Functions that suggest the next command on a result, with the names of the files of the result."""

from __future__ import annotations

import itertools
import os
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Any

from swimid.files.provenance import sha256
from swimid.reading import name_of
from swimid.results import evidence as ev

if TYPE_CHECKING:
    from swimid.results.result import Result


def quote_name(name: str | Path) -> str:
    """Return a file name as it is typed in a command: quoted for the shell, and not mistaken for an option.

    >>> quote_name("my $(run).yaml"), quote_name("-x.yaml")
    ("'my $(run).yaml'", './-x.yaml')
    """
    text = str(name)
    if text.startswith("-"):
        text = f"./{text}"
    return shlex.quote(text)


class _Free(dict[str, str]):
    """Mapping of default output names to unused names: ``gap.yaml`` to ``gap-2.yaml`` if the first exists."""

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self.folder = folder

    def __missing__(self, name: str) -> str:
        stem, dot, ending = name.rpartition(".")
        names = itertools.chain([name], (f"{stem}-{k}{dot}{ending}" for k in itertools.count(2)))
        places = (self.folder / one for one in names)
        return next(one.name for one in places if not (one.exists() or ev.sidecar(one).exists()))

    @property
    def repair_option(self) -> str:
        """Option that renames the second output of ``diagnose``; empty if no file has its default name."""
        name = self["repaired.yaml"]
        return "" if name == "repaired.yaml" else f" --repaired {name}"


def format_command(result: Result, file: str | Path, folder: Path) -> str:
    """Return the command of :attr:`Result.next_step` with file names; empty if an input file is missing.

    Parameters
    ----------
    result : Result
    file : path
        Path of the result file from ``folder``.
    folder : Path
        Folder in which the command is typed.
    """
    words: dict[str, Any] = {"file": quote_name(file), "free": _Free(folder)}
    words["data"] = {name: quote_name(value) for name, value in result.data.items() if isinstance(value, str)}
    step = result.next_step
    if "{trials}" in step:
        inputs = find_inputs(result, folder)
        about = getattr(result.document, "params", None)
        params = [place for name, place in inputs.items() if Path(name).name == Path(str(about)).name]
        if not inputs or ("{params}" in step and not params):
            return ""
        code = [place for place in inputs.values() if place.endswith(".py")]
        trials = next(place for place in inputs.values() if place not in code)
        # The trials file names the Python file of a user's simulator, so the command need not name it.
        own = [] if getattr(result.document, "model", None) == "python" else code
        words |= {"trials": quote_name(trials), "params": "".join(map(quote_name, params[:1]))}
        words["own"] = "".join(f" --experiment {quote_name(place)}" for place in own)
    return str(step.format(**words))


def find_inputs(result: Result, folder: Path = Path()) -> dict[str, str]:
    """Return the paths from ``folder`` of the YAML and Python files among the inputs of a result, by name.

    The names of inputs are relative to the folder of the result. This function searches for the folder that
    has files with these names and unchanged content. The mapping is empty if there is no such folder.
    """
    known = getattr(result.evidence, "provenance", {}).get("inputs", {})
    paths = getattr(known, "paths", {})
    digests = {
        name: digest
        for name, digest in known.items()
        if name.endswith((".yaml", ".yml", ".py")) and not name.startswith("swimid/robots/")
    }
    for base in (Path(), *result.path.absolute().parents):
        files = {name: base / paths.get(name, name) for name in digests}
        if all(file.is_file() and sha256(file) == digests[name] for name, file in files.items()):
            places = {name: os.path.relpath(file, folder) for name, file in files.items()}
            # Accept only short paths: a page must not state the home folder of its author.
            if all(Path(name_of(file, folder)) == Path(places[name]) for name, file in files.items()):
                return places
    return {}
