"""Record of the files that a command reads, and the names by which results state files.

Every function that reads a file calls :func:`note` when it opens the file. Most do so through
:func:`swimid.errors.file_errors`. Provenance, checkpoint keys and the states of a batch are made from this
record of files and their SHA-256.
"""

from __future__ import annotations

import hashlib
import importlib.util
import os
import site
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

#: Maximum size of files whose SHA-256 is computed when they are opened, bytes. The SHA-256 of a larger file
#: is computed only when it is needed, because some commands open many large files and need no SHA-256.
MAX_AT_ONCE = 1 << 20
_PACKAGE = os.path.dirname(os.path.abspath(__file__))
#: Folders that contain the home folders of users on Linux and macOS.
_HOMES = {"/home", "/Users"}


@dataclass
class Opened:
    """File that was read, or series of pictures that was read together.

    Attributes
    ----------
    files : sequence of Path
        The file, or the files of the series.
    stamp : list of int
        Size and time stamp of the files when they were opened (:func:`stamp_of`).
    sha256 : str
        SHA-256 of the content when the files were opened; empty if it is not computed yet.
    """

    files: Sequence[Path]
    stamp: list[int] | None
    sha256: str = ""

    def digest(self) -> tuple[str, bool]:
        """Return the SHA-256 of the content, and whether the content has changed since it was opened.

        If the content has changed, the SHA-256 is that of the former content. It is empty if it was not
        computed before the change.
        """
        same = stamp_of(self.files) == self.stamp
        if self.sha256 and same:
            return self.sha256, False
        try:
            found = digest_of(self.files)
        except OSError:
            found = ""
        if same and stamp_of(self.files) == self.stamp:
            self.sha256 = found
        return self.sha256, found != self.sha256


@dataclass
class FileRecord:
    """Files that are read in a ``with`` block.

    Attributes
    ----------
    folder : str
        Folder of the result, to which the names of files are relative.
    known : dict
        Opened files by absolute path, including those of the enclosing block.
    paths : dict
        Absolute paths of the files of this block, in the order in which they were opened first.
    """

    folder: str
    known: dict[str, Opened]
    paths: dict[str, None] = field(default_factory=dict)


_RECORD: ContextVar[FileRecord | None] = ContextVar("_RECORD", default=None)


@contextmanager
def record(output: str | Path | None = None) -> Iterator[FileRecord]:
    """Record the files that are read in a ``with`` block. ``output`` is the result that will be written."""
    outer = _RECORD.get()
    folder = os.getcwd()
    if output is not None:
        folder = os.path.dirname(os.path.abspath(output))
    inner = FileRecord(folder, {} if outer is None else outer.known)
    token = _RECORD.set(inner)
    try:
        yield inner
    finally:
        _RECORD.reset(token)
        if outer is not None:
            outer.paths |= inner.paths


def note(path: str | Path, files: Sequence[Path] | None = None, *, at_once: bool = False) -> None:
    """Add a file that is about to be read to the record of the current command.

    Parameters
    ----------
    path : path
        File, folder of pictures, or pattern of the names of pictures.
    files : sequence of Path, optional
        Pictures of a series; by default all files of a folder.
    at_once : bool
        Whether the SHA-256 is computed now, even for a large file.
    """
    now = _RECORD.get()
    if now is None:
        return
    place = os.path.abspath(path)
    if place not in now.known:
        parts = [Path(os.path.abspath(one)) for one in files or files_of(Path(path))]
        stamp = stamp_of(parts)
        if stamp is None and not at_once:
            return
        opened = now.known[place] = Opened(parts, stamp)
        if at_once or (stamp and stamp[0] <= MAX_AT_ONCE):
            opened.digest()
    now.paths.setdefault(place)


@contextmanager
def watch() -> Iterator[None]:
    """Note every file that Python code of the user opens in a ``with`` block, such as a data table."""
    _listen()
    heard: list[str] = []
    token = _HEARD.set(heard)
    try:
        yield
    finally:
        _HEARD.reset(token)
        places = (sys.prefix, sys.base_prefix, site.getusersitepackages(), _PACKAGE, "/proc", "/sys", "/etc")
        system = tuple(f"{place}{os.sep}" for place in places)
        for path in map(os.path.abspath, dict.fromkeys(heard)):
            if path.endswith(".pyc"):
                path = importlib.util.source_from_cache(path)
            if not path.startswith(system) and os.path.isfile(path):
                note(path)


_HEARD: ContextVar[list[str] | None] = ContextVar("_HEARD", default=None)


@cache
def _listen() -> None:
    """Start adding the names of all files that are opened for reading to the list of :func:`watch`."""

    def hear(event: str, arguments: tuple[Any, ...]) -> None:
        if event != "open" or not isinstance(arguments[0], str):
            return
        heard = _HEARD.get()
        if heard is not None and set(arguments[1] or "").isdisjoint("wax+"):
            heard.append(arguments[0])

    sys.addaudithook(hear)


def list_files() -> dict[str, Opened]:
    """Return the files that the current command has read, by absolute path."""
    now = _RECORD.get()
    return {} if now is None else now.known


def paths() -> list[str]:
    """Return the absolute paths of the files that the current command has read, in the order of opening."""
    now = _RECORD.get()
    return [] if now is None else [*now.paths]


def files_of(path: Path) -> list[Path]:
    """Return the visible files of a folder, sorted by name; for a file, return the file itself."""
    if not path.is_dir():
        return [path]
    return sorted(one for one in path.iterdir() if one.is_file() and not one.name.startswith("."))


def stamp_of(files: Sequence[Path]) -> list[int] | None:
    """Return the total size of files, bytes, and their time of modification; None if a file is missing.

    For one file the time is in ns. For several files it is replaced by a hash of their names, sizes and
    times.
    """
    try:
        found = [(file.name, file.stat().st_size, file.stat().st_mtime_ns) for file in files]
    except OSError:
        return None
    size = sum(one[1] for one in found)
    if len(found) == 1:
        return [size, found[0][2]]
    return [size, int(hashlib.sha256(repr(found).encode()).hexdigest()[:12], 16)]


def digest_of(files: Sequence[Path]) -> str:
    """Return the SHA-256 of the content of a file, or of the names and the contents of several files.

    Raises
    ------
    OSError
        If a file cannot be read.
    """
    digests = []
    for file in files:
        with file.open("rb") as stream:
            digests.append(hashlib.file_digest(stream, "sha256").hexdigest())
    if len(files) == 1:
        return digests[0]
    lines = "".join(f"{digest}  {file.name}\n" for digest, file in zip(digests, files, strict=True))
    return hashlib.sha256(lines.encode()).hexdigest()


# ---------------------------------------------------------------- names in results


def name_of(path: str | Path, folder: str | Path | None = None) -> str:
    """Return the name by which a result states a file.

    The name is the path relative to the folder of the result, or to ``folder``. For a file of swimid it
    begins with ``swimid/``. A path that leads through the root folder or a folder of home folders is reduced
    to the file name, so that a published result does not state the folders of its author.
    """
    place, now = os.path.abspath(path), _RECORD.get()
    if folder is None and now is not None:
        folder = now.folder
    folder = os.path.abspath(folder or "")
    if place.startswith(_PACKAGE + os.sep):
        return Path(place).relative_to(os.path.dirname(_PACKAGE)).as_posix()
    try:
        common = os.path.commonpath([place, folder])
    except ValueError:  # The paths are on two drives of Windows.
        return os.path.basename(place)
    above = {str(one) for one in Path(os.path.expanduser("~")).parents} | _HOMES
    if common in above or common == os.path.dirname(common):
        return os.path.basename(place)
    return Path(os.path.relpath(place, folder)).as_posix()


def publish_word(text: str) -> str:
    """Return a command-line word or option value, with its path in the form that results state."""
    option, equal, value = "", "", text
    if text.startswith("--"):
        option, equal, value = text.partition("=")
    is_path = os.path.isabs(value) or (os.sep in value and os.path.isdir(os.path.dirname(value)))
    if is_path or ("." in value and os.path.exists(value)):
        value = name_of(value)
    return f"{option}{equal}{value}"


def remove_folders(text: str) -> str:
    """Return a text of a log without the folders of the installation, of the user and of the working folder.

    >>> remove_folders(f'File "{__file__}"')
    'File "swimid/reading.py"'
    """
    known = (os.path.dirname(_PACKAGE), sys.prefix, sys.base_prefix, os.getcwd(), os.path.expanduser("~"))
    for folder in sorted(filter(lambda one: len(one) > 1, known), key=len, reverse=True):
        text = text.replace(f"{folder}{os.sep}", "")
    return text
