"""Provenance of a result: command, version, inputs and their SHA-256."""

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
    """Return the SHA-256 of a file in hexadecimal digits."""
    with file_errors(path), Path(path).open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


class InMemory(Protocol):
    """An input in memory."""

    @property
    def name(self) -> str:
        """Name of the input."""
        ...

    def digest(self) -> str:
        """Return the SHA-256 of its content in hexadecimal digits."""
        ...


@dataclass(frozen=True)
class Held:
    """Name and SHA-256 of an input that was in memory."""

    name: str
    sha256: str

    def digest(self) -> str:
        """Return the SHA-256 of its content."""
        return self.sha256


#: An input of a result.
Input = str | Path | InMemory


def path_of(given: Input) -> Path:
    """Return the path of an input; the name of one in memory."""
    return Path(given if isinstance(given, str | Path) else given.name)


def digests_of(inputs: Iterable[Input]) -> dict[str, str]:
    """Return the SHA-256 of each input by its name, of a file relative to the working folder.

    Inputs in memory that differ but have the same name are numbered.
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
    """Return the SHA-256 of one input in hexadecimal digits."""
    return sha256(given) if isinstance(given, str | Path) else given.digest()


def digest_together(name: str | Path, files: Sequence[str | Path]) -> dict[str, str]:
    """Return one SHA-256 for many files under one name: that of their digests and names.

    A single file keeps its own SHA-256.
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
    """Return the ``provenance`` block of a result.

    Parameters
    ----------
    inputs : iterable of paths and objects
        Every file that was read, and every input in memory.
    settings : dict, optional
        Options of the command, with defaults.
    digests : dict, optional
        :func:`digests_of` the inputs, if they are known already.
    """
    return {
        "command": command_line(),
        "version": swimid.__version__,
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "inputs": digests_of(inputs) if digests is None else digests,
        "packages": _versions(),
    } | ({"settings": settings} if settings else {})


def command_line() -> str:
    """Return the command as it was typed, without the folder of the program."""
    program = Path(sys.argv[0]).name
    return shlex.join(["swimid" if program == "__main__.py" else program, *sys.argv[1:]])


def _versions() -> dict[str, str]:
    """Return the versions of Python and of the imported libraries."""
    labels = ("numpy", "scipy", "numba", "pandas", "opencv", "control")
    loaded = {label: sys.modules.get("cv2" if label == "opencv" else label) for label in labels}
    return {"python": sys.version.split()[0]} | {
        label: str(getattr(module, "__version__", "unknown"))
        for label, module in loaded.items()
        if module is not None
    }
