"""Where a result comes from: command, version, inputs and their SHA-256."""

from __future__ import annotations

import hashlib
import os
import shlex
import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Protocol

import swimid
from swimid.errors import file_errors


def sha256(path: str | Path) -> str:
    """SHA-256 of a file as hexadecimal digits."""
    with file_errors(path), Path(path).open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


class InMemory(Protocol):
    """An input that is no file."""

    @property
    def name(self) -> str:
        """What it is called."""
        ...

    def digest(self) -> str:
        """SHA-256 of what it holds, as hexadecimal digits."""
        ...


@dataclass(frozen=True)
class Held:
    """What stands for an input that was in memory and is no longer needed."""

    name: str
    sha256: str

    def digest(self) -> str:
        """SHA-256 of what it held."""
        return self.sha256


#: An input of a result.
Input = str | Path | InMemory


def path_of(given: Input) -> Path:
    """Where an input lies; of one in memory its name."""
    return Path(given if isinstance(given, str | Path) else given.name)


def digests_of(inputs: Iterable[Input]) -> dict[str, str]:
    """SHA-256 of each input; a file by its name relative to the working folder, what is none by its own.

    Of several in memory that have one name but differ, the later ones are numbered.
    """
    digests: dict[str, str] = {}
    for given in inputs:
        if isinstance(given, str | Path):
            name = os.path.relpath(given)
            digests[name] = digests.get(name) or sha256(given)
            continue
        name, digest, count = given.name, given.digest(), 1
        while digests.get(name, digest) != digest:
            count += 1
            name = f"{given.name} ({count})"
        digests[name] = digest
    return digests


def digest_of(given: Input) -> str:
    """SHA-256 of one input as hexadecimal digits."""
    return sha256(given) if isinstance(given, str | Path) else given.digest()


def digest_together(name: str | Path, files: Sequence[str | Path]) -> dict[str, str]:
    """One SHA-256 for many files under one name: that of their digests, each with its file's name.

    A single file has its own.
    """
    if len(files) == 1:
        return {os.path.relpath(name): sha256(files[0])}
    lines = "".join(f"{sha256(file)}  {Path(file).name}\n" for file in files)
    return {os.path.relpath(name): hashlib.sha256(lines.encode()).hexdigest()}


def collect(
    inputs: Iterable[Input],
    *,
    settings: dict[str, Any] | None = None,
    digests: dict[str, str] | None = None,
) -> dict[str, Any]:
    """The ``provenance`` block of a result.

    Parameters
    ----------
    inputs : iterable of paths and objects
        Every file that was read, named relative to the working folder, and what was handed over in memory.
    settings : dict, optional
        The options the result was made with, defaults included.
    digests : dict, optional
        :func:`digests_of` the inputs, where they were taken while something else went on.
    """
    return {
        "command": command_line(),
        "version": swimid.__version__,
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "inputs": digests_of(inputs) if digests is None else digests,
        "packages": _versions(),
    } | ({"settings": settings} if settings else {})


def command_line() -> str:
    """The command as it was typed, with the program's bare name."""
    program = Path(sys.argv[0]).name
    return shlex.join(["swimid" if program == "__main__.py" else program, *sys.argv[1:]])


def _versions() -> dict[str, str]:
    """Versions of Python and of the libraries in use."""
    labels = ("numpy", "scipy", "numba", "pandas", "opencv", "control")
    loaded = {label: sys.modules.get("cv2" if label == "opencv" else label) for label in labels}
    return {"python": sys.version.split()[0]} | {
        label: str(getattr(module, "__version__", "unknown"))
        for label, module in loaded.items()
        if module is not None
    }
