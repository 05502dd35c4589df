"""Provenance of a result (command, inputs, versions), and the marks of files that swimid wrote.

By its mark swimid recognises a file that it may replace. Every file format has its mark in one place. Only
that place is read, because a file of another program may contain the word "swimid" anywhere.
``docs/formats.md`` lists the marks.
"""

from __future__ import annotations

import hashlib
import os
import re
import shlex
import sys
import zlib
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import swimid
from swimid.errors import UsageError, file_errors
from swimid.files import tabular


def sha256(path: str | Path) -> str:
    """Return the SHA-256 of the content of a file, or of the files in a folder, in hexadecimal digits."""
    if Path(path).is_dir():
        files = sorted(file for file in Path(path).iterdir() if file.is_file())
        return next(iter(digest_together(path, files).values()))
    with file_errors(path), Path(path).open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


@dataclass(frozen=True)
class Held:
    """Name and SHA-256 of an input of a computation that was in memory and not in a file."""

    name: str
    sha256: str

    def digest(self) -> str:
        """Return the SHA-256 of the content of the input in memory."""
        return self.sha256


#: Type of an input of a computation: the path of a file, or an object in memory with a ``name`` and a method
#: ``digest`` that returns the SHA-256 of its content.
Input = str | Path | Any


def path_of(given: Input) -> Path:
    """Return the path of an input file, or the name of an input in memory as a path."""
    return Path(given if isinstance(given, str | Path) else given.name)


def digests_of(inputs: Iterable[Input]) -> dict[str, str]:
    """Return the SHA-256 of the content of each input of a computation. The key is the name of the input.

    The name of a file is its path relative to the working folder. Different inputs in memory that have the
    same name are numbered.
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


def digest_together(name: str | Path, files: Sequence[str | Path]) -> dict[str, str]:
    """Return a single SHA-256 for an input that consists of several files. The key is the given name.

    It is computed from the names of the files and the SHA-256 of their contents. For a single file it is the
    SHA-256 of its content.
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
    """Return the block ``provenance`` of a result file: command, version, inputs, packages and settings.

    Parameters
    ----------
    inputs : iterable of paths and objects
        Every file that was read, and every input in memory.
    settings : dict, optional
        Options of the command, including defaults.
    digests : dict, optional
        Result of :func:`digests_of` for the inputs, if it is known already.
    """
    inputs = list(inputs)
    block: dict[str, Any] = {
        "command": command_line(),
        "version": swimid.__version__,
        "created": now().isoformat(timespec="seconds"),
        "inputs": digests or digests_of(inputs),
        "packages": _versions(),
    }
    if simulated := [os.path.relpath(path_of(given)) for given in inputs if says_simulated(given)]:
        block["simulated"] = simulated
    if settings:
        block["settings"] = settings
    return block


def now() -> datetime:
    """Return the present time (UTC), or the time that the variable ``SOURCE_DATE_EPOCH`` states.

    The variable holds seconds since 1970 (reproducible-builds.org). With it, two runs write the same bytes.

    Raises
    ------
    UsageError
        If the variable is not a whole number of seconds.
    """
    stated = os.environ.get("SOURCE_DATE_EPOCH")
    if not stated:
        return datetime.now(UTC)
    try:
        return datetime.fromtimestamp(int(stated), UTC)
    except (ValueError, OverflowError, OSError) as error:
        text = (
            f"the environment variable SOURCE_DATE_EPOCH is '{stated}', and must be whole seconds since 1970"
        )
        raise UsageError(text, hint="unset SOURCE_DATE_EPOCH") from error


def says_simulated(given: Input) -> bool:
    """Return whether an input states that its data are simulated.

    The comments at the top of a file, or the metadata of a log in memory, then have the word "simulated" or
    "synthetic".
    """
    if isinstance(given, str | Path):
        head = _head(Path(given))
    else:
        head = "".join(f"#{key}: {value}\n" for key, value in getattr(given, "metadata", {}).items())
    return _SIMULATED.match(head) is not None


def _head(path: Path) -> str:
    """Return the first bytes of a file (:data:`NEAR`) as text.

    For a Parquet file that swimid wrote, the text is ``PAR1`` and the metadata of the file as comment lines.
    For an HDF5 file with the attribute ``made_by``, it is this attribute as a comment line. A folder has no
    text.
    """
    if path.is_dir():
        return ""
    with file_errors(path), path.open("rb") as stream:
        head = stream.read(NEAR)
    if head.startswith(b"PAR1"):
        pyarrow, head = tabular.pyarrow(), b"PAR1"
        with suppress(pyarrow.ArrowInvalid):
            stored = (pyarrow.parquet.read_schema(path).metadata or {}).get(b"swimid", b"")
            head = b"".join(b"#%b\n" % line for line in stored.splitlines())
    if head.startswith(b"\x89HDF"):
        # Take a damaged file, and any file if h5py is missing, for one of another program.
        with suppress(OSError, RuntimeError, KeyError, ImportError):
            import h5py

            with h5py.File(path, "r") as file:
                head = f"# made_by: {file.attrs.get('made_by')}\n".encode()
    return head.decode("utf-8-sig", "replace").replace("\r\n", "\n")


def command_line() -> str:
    """Return the command line of this process as it was typed, without the folder of the program."""
    program = Path(sys.argv[0]).name.replace("__main__.py", "swimid")
    return shlex.join([program, *sys.argv[1:]])


def _versions() -> dict[str, str]:
    """Return the version of Python, and of each numerical library that is imported, by name."""
    versions = {"python": sys.version.split()[0]}
    for name in ("numpy", "scipy", "numba", "pandas", "cv2", "control"):
        if name in sys.modules:
            versions[name.replace("cv2", "opencv")] = str(sys.modules[name].__version__)
    return versions


# ---------------------------------------------------------------- marks of files that swimid wrote

#: Text in the metadata field ``Software`` or ``dc:creator`` of a picture that marks it as written by swimid.
SOFTWARE = "swimid"
#: Text in the comment of a GIF, or in the last box of a video file, that marks it as written by swimid.
MADE_BY = "made by swimid"
#: Bytes at the end of a video file that mark it as written by swimid. They form a ``free`` box, which players
#: skip (ISO/IEC 14496-12, section 8.1.2).
VIDEO_BOX = (8 + len(MADE_BY)).to_bytes(4, "big") + b"free" + MADE_BY.encode()
#: Number of bytes at the start and at the end of a file in which the mark of swimid is searched.
NEAR = 65536

_SIMULATED = re.compile(r"(?:#[^\n]*\n|\n)*?#[^\n]*\b(?:simulated?|synthetic)\b")
#: Pattern of the names of file formats that only swimid writes. The excluded formats are also written by
#: hand.
_FORMAT = r"swimid-(?!trials/|robot/|setup/|mapping/|plan/)[a-z-]+/\d+"
#: Pattern of the beginning of a file that swimid wrote, up to the mark. Its alternatives are, in this order:
#: log, JSON, JSON Schema, findings of ``doctor``, XML, Python, shell script, HTML, C header, CSV of a Pareto
#: front, SVG,
#: PNG, GIF.
_BEGINNING = re.compile(
    "|".join((
        r"(?:#[^\n]*\n|\n)*?# *(?:made_by|imported_by): *['\"]?swimid [a-z]",
        rf'\{{\s*"format": ?"{_FORMAT}"',
        r'\{\s*"\$schema": "[^"]*",\s*"\$comment": "written by swimid ',
        r'\{\s*"swimid": "[^"]*",\s*"python": ',
        r"<\?xml [^>]*>\s*<!--\s*Written by swimid \d",
        r'"""Written by swimid \d',
        r"#!/bin/bash\n# Written by swimid\.",
        r"<!DOCTYPE html>\s*<html\b[^>]*>\s*<head>\s*(?:<meta [^>]*>\s*)*?"
        r'<meta name="generator" content="swimid ',
        r"/\*(?:(?!\*/).)*\*/\s*#ifndef SWIMID_STIFFNESS_RULE_H\b",
        r"index,profile,(?:[^,\n]+,)+[^,\n]+\[[^\n]*\]\n",
        r"<\?xml [^>]*>\s*(?:<!DOCTYPE [^>]*>\s*)?<svg [^>]*>\s*<metadata>(?:(?!</metadata>).)*"
        r"<dc:creator>\s*<cc:Agent>\s*<dc:title>swimid</dc:title>",
        r".PNG(?:(?!IDAT).)*\x0ftEXtSoftware\x00swimid",
        r"GIF8.{,4000}?!.\x0emade by swimid\x00",
    )),
    re.DOTALL,
)  # fmt: skip
#: Pattern of the last line of a Markdown report, which marks it as written by swimid.
_MARKDOWN = re.compile(r"\nMade by swimid \S+ on \d{4}-\d\d-\d\d [\d:]+ UTC\. [^\n]*\n?\Z")
#: Patterns of two parts of a YAML file that swimid wrote: the first line, and the block ``provenance``, which
#: may follow anywhere.
_YAML = re.compile(rf"format: *['\"]?{_FORMAT}['\"\s]")
_ORIGIN = re.compile(r"^provenance:\n(?: .*\n)*?  version: ", re.MULTILINE)


def is_own(path: Path) -> bool:
    """Return whether swimid may replace a file, because swimid wrote it or because it has no content.

    A file has no content if it is empty, missing or a device.

    Raises
    ------
    InputError
        When the file cannot be read.
    """
    if not path.is_file():
        return True
    start = _head(path)
    with file_errors(path), path.open("rb") as stream:
        stream.seek(max(path.stat().st_size - NEAR, 0))
        tail = stream.read()
    if not tail or tail.endswith(VIDEO_BOX):
        return True
    if _YAML.match(start):
        return _ORIGIN.search(path.read_text(encoding="utf-8", errors="replace")) is not None
    end = tail.decode("utf-8", "replace").replace("\r\n", "\n")
    return _BEGINNING.match(start) is not None or _MARKDOWN.search(end) is not None


def mark_png(data: bytes) -> bytes:
    """Return the content of a PNG file with a metadata field that marks it as written by swimid.

    ``data`` is the content of the PNG file without metadata.
    """
    content = b"tEXtSoftware\0" + SOFTWARE.encode()
    chunk = (len(content) - 4).to_bytes(4, "big") + content + zlib.crc32(content).to_bytes(4, "big")
    after_header = 8 + 25  # The PNG signature has 8 bytes, and the header chunk IHDR has 25.
    return data[:after_header] + chunk + data[after_header:]
