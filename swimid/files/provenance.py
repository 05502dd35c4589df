"""Provenance of a result (command, inputs, versions), and the marks of files that swimid wrote.

By its mark swimid recognises a file that it wrote and may replace. Every file format has its mark at one
fixed position. Only that position is read, because a file of another program may contain the word "swimid"
anywhere. ``docs/formats.md`` lists the marks.
"""

from __future__ import annotations

import os
import re
import shlex
import sys
import zlib
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import swimid
from swimid import reading
from swimid.errors import InputError, UsageError, file_errors
from swimid.files import tabular
from swimid.notices import warn


def sha256(path: str | Path) -> str:
    """Return the SHA-256 of the content of a file, or of the files in a folder, in hexadecimal digits."""
    with file_errors(path, noted=False):
        return reading.digest_of(reading.files_of(Path(path)))


@dataclass(frozen=True)
class InputInMemory:
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


class Inputs(dict[str, str]):
    """SHA-256 of the inputs of a result by the names that the result states (:func:`swimid.reading.name_of`).

    The attribute ``paths`` has the absolute path of each file. It is not written to result files.
    """

    def __init__(self) -> None:
        self.paths: dict[str, str] = {}

    def add(self, name: str, digest: str, path: str = "") -> str:
        """Add an input, and return its name. A number is added if another input already has the name."""
        count, key = 1, name
        while self.get(key, digest) != digest:
            count += 1
            key = f"{name} ({count})"
        self[key] = digest
        self.paths[key] = path
        return key


def paths_of(block: Mapping[str, Any]) -> list[str]:
    """Return the paths of the inputs of a result relative to the working folder, from its provenance."""
    paths = getattr(block.get("inputs"), "paths", {})
    return [os.path.relpath(paths[name]) if paths.get(name) else name for name in block.get("inputs") or {}]


def rename(block: dict[str, Any], output: Path) -> None:
    """Rename the inputs in the provenance of a result, in place, relative to the result file ``output``.

    The provenance of a result that was read from a file stays as it is.
    """
    before, after, names = block.get("inputs"), Inputs(), {}
    if not isinstance(before, Inputs):
        return
    with reading.record(output):
        for name, digest in before.items():
            path = before.paths[name]
            names[name] = after.add(reading.name_of(path) if path else name, digest, path)
        changed = {"inputs": after, "command": command_line()}
    changed["simulated"] = [names[name] for name in block.get("simulated", ())]
    block |= {key: changed[key] for key in block.keys() & changed.keys()}


def digests_of(inputs: Iterable[Input]) -> Inputs:
    """Return the SHA-256 that each input of a computation had when it was opened, by the name of the input.

    Raises
    ------
    InputError
        If a large file has changed while it was read.

    Warns
    -----
    SWM176
        If another file has changed since it was read.
    """
    digests, known = Inputs(), reading.list_files()
    for given in inputs:
        if not isinstance(given, str | Path):
            digests.add(given.name, given.digest())
            continue
        path = os.path.abspath(given)
        opened = known.get(path)
        if opened is None:
            digests.add(reading.name_of(given), sha256(given), path)
            continue
        digest, changed = opened.digest()
        if not digest:
            hint = "run the command again when nothing writes the file"
            raise InputError("has changed while it was read", file=os.path.relpath(path), hint=hint)
        if changed:
            text = "has changed since it was read; the result is computed from its former content"
            warn("SWM176", f"{os.path.relpath(path)} {text}")
        digests.add(reading.name_of(given), digest, path)
    return digests


def collect(inputs: Iterable[Input], *, settings: dict[str, Any] | None = None) -> dict[str, Any]:
    """Return the block ``provenance`` of a result file: command, version, inputs, packages and settings.

    Parameters
    ----------
    inputs : iterable of paths and objects
        Inputs in memory, and the files that are listed first. All other files that were read are added.
    settings : dict, optional
        Options of the command, including defaults.
    """
    given = list(inputs)
    listed = {os.path.abspath(one) for one in given if isinstance(one, str | Path)}
    given += [path for path in reading.paths() if path not in listed]
    block: dict[str, Any] = {
        "command": command_line(),
        "version": swimid.__version__,
        "created": now().isoformat(timespec="seconds"),
        "inputs": digests_of(given),
        "packages": _versions(),
    }
    if simulated := [reading.name_of(path_of(one)) for one in given if says_simulated(one)]:
        block["simulated"] = simulated
    if settings:
        block["settings"] = _publish(settings)
    return block


def now() -> datetime:
    """Return the present time (UTC), or the time that the variable ``SOURCE_DATE_EPOCH`` states.

    This variable holds seconds since 1970 (reproducible-builds.org). It makes two runs write the same bytes.

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
        head = _head(Path(given)) if Path(given).is_file() else ""
    else:
        head = "".join(f"#{key}: {value}\n" for key, value in getattr(given, "metadata", {}).items())
    return _SIMULATED.match(head) is not None


def _head(path: Path) -> str:
    """Return the first bytes of a file (:data:`MARK_RANGE_BYTES`) as text.

    For a Parquet file that swimid wrote, the text is ``PAR1`` and the metadata of the file as comment lines.
    For an HDF5 file with the attribute ``made_by``, it is this attribute as a comment line.
    """
    with file_errors(path, noted=False), path.open("rb") as stream:
        head = stream.read(MARK_RANGE_BYTES)
    if head.startswith(b"PAR1"):
        pyarrow, head = tabular.pyarrow(), b"PAR1"
        with suppress(pyarrow.ArrowInvalid):
            stored = (pyarrow.parquet.read_schema(path).metadata or {}).get(b"swimid", b"")
            head = b"".join(b"#%b\n" % line for line in stored.splitlines())
    if head.startswith(b"\x89HDF"):
        # Treat a damaged file, or any file if h5py is missing, as a file of another program.
        with suppress(OSError, RuntimeError, KeyError, ImportError):
            import h5py

            with h5py.File(path, "r") as file:
                head = f"# made_by: {file.attrs.get('made_by')}\n".encode()
    return head.decode("utf-8-sig", "replace").replace("\r\n", "\n")


def command_line() -> str:
    """Return the command line of this process, with paths in the form that results state.

    The option for the number of threads is left out, because it changes no result.
    """
    program = Path(sys.argv[0]).name.replace("__main__.py", "swimid")
    words = _IDLE.sub("", "\0".join([program, *sys.argv[1:], ""])).split("\0")[:-1]
    return shlex.join(map(reading.publish_word, words))


#: Pattern of options that change no result, in a command line whose words end with a null character.
_IDLE = re.compile(r"(?<=\0)--jobs[=\0][^\0]*\0")


def _publish(value: Any) -> Any:
    """Return the settings of a command with paths in the form that results state."""
    if isinstance(value, Mapping):
        return {name: _publish(one) for name, one in value.items()}
    if isinstance(value, list | tuple):
        return [_publish(one) for one in value]
    if isinstance(value, str):
        return reading.publish_word(value)
    return value


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
MADE_BY_TEXT = "made by swimid"
#: Bytes at the end of a video file that mark it as written by swimid. They form a ``free`` box, which players
#: skip (ISO/IEC 14496-12, section 8.1.2).
VIDEO_BOX = (8 + len(MADE_BY_TEXT)).to_bytes(4, "big") + b"free" + MADE_BY_TEXT.encode()
#: Number of bytes at the start, and at the end, of a file in which swimid looks for its mark.
MARK_RANGE_BYTES = 65536

_SIMULATED = re.compile(r"(?:#[^\n]*\n|\n)*?#[^\n]*\b(?:simulated?|synthetic)\b")
#: Pattern of the names of file formats that only swimid writes. Users also write files in the excluded
#: formats.
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
        If the file cannot be read.
    """
    if not path.is_file():
        return True
    start = _head(path)
    with file_errors(path, noted=False), path.open("rb") as stream:
        stream.seek(max(path.stat().st_size - MARK_RANGE_BYTES, 0))
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
