"""How a text file of columns is laid out: delimiter, header, decimal mark, what to skip."""

from __future__ import annotations

import codecs
import csv
import re
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Literal

from swimid.errors import InputError
from swimid.files.delimited import MISSING, number
from swimid.logs.foreign.base import Options

#: Bytes looked at to find the layout.
SAMPLE = 1 << 18
_CANDIDATES = (",", ";", "\t", "|")
_COMMA = re.compile(r"[-+]?\d*,\d+([eE][-+]?\d+)?")
_DATE = re.compile(r"\d{4}-\d\d-\d\d([T ]\d\d:\d\d(:\d\d)?.*)?")
_BLANK = re.compile(rb"[ \t]+")
_EDGES = re.compile(rb"(?m)^ | (?=\r?$)")


@dataclass(frozen=True)
class Layout:
    """What :func:`find` found.

    Attributes
    ----------
    names : list of str
        Of the columns; ``"1"``, ``"2"``, ... where the file has no header.
    kinds : list of {"number", "time", "text"}
        Of the cells of each.
    delimiter : str
        One character; a space where any run of blanks separates.
    first_line : int
        Line of the first sample, from 1.
    comments : list of str
        Comment lines above the samples, without their mark.
    units : list of str
        Of the line of units under the header; empty without one.
    """

    names: list[str]
    kinds: list[Literal["number", "time", "text"]]
    delimiter: str
    decimal: str
    encoding: str
    comment: str
    first_line: int
    headed: bool
    blanks: bool
    comments: list[str] = field(default_factory=list)
    units: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    missing: tuple[str, ...] = ()


def find(path: Path, options: Options) -> Layout:
    """The layout of a file: what the options say, else what its first lines show.

    Raises
    ------
    InputError
        When it is no text, is empty, or no line looks like samples.
    """
    notes: list[str] = []
    encoding, text, whole = _text(path, options, notes)
    lines = text.splitlines() if whole else text.splitlines()[:-1]
    skip = options.skip_rows or 0
    kept: list[tuple[int, str]] = []
    comments: list[str] = []
    for at, line in enumerate(lines, start=1):
        if at <= skip or not line.strip():
            continue
        if line.lstrip().startswith(options.comment):
            comments.append(line.lstrip()[len(options.comment) :])
        else:
            kept.append((at, line))
    if not kept:
        raise InputError("holds no samples", file=path)
    delimiter, blanks = _delimiter([line for _, line in kept], options)
    table = [(at, cells_of(line, delimiter, blanks)) for at, line in kept]
    decimal = options.decimal or _decimal([cells for _, cells in table], delimiter)
    width = Counter(len(cells) for _, cells in table).most_common(1)[0][0]
    rows_above, first = _split(table, width, decimal, options, path)
    lines_of_names = max(len(rows_above), 1)
    names, units, headed = _names(_joined(rows_above), width)
    missing = tuple(str(mark) for mark in options.missing)
    samples = [cells for _, cells in table[first:] if len(cells) == width]
    kinds = [_kind([cells[k] for cells in samples], decimal, missing) for k in range(width)]
    if delimiter == "," and decimal == ",":
        raise InputError("a comma cannot both separate cells and mark decimals", file=path)
    if options.skip_rows is None and first > lines_of_names and headed:
        notes.append(f"{table[first][0] - 1} lines above the samples are not read as samples")
    return Layout(
        names,
        kinds,
        delimiter,
        decimal,
        encoding,
        options.comment,
        table[first][0],
        headed,
        blanks,
        comments,
        units,
        notes,
        missing,
    )


def _text(path: Path, options: Options, notes: list[str]) -> tuple[str, str, bool]:
    """Encoding and decoded beginning of a file, and whether that is all of it."""
    try:
        with path.open("rb") as stream:
            raw = stream.read(SAMPLE)
            whole = not stream.read(1)
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror or error}", file=path) from error
    if not raw:
        raise InputError("is empty", file=path)
    encoding = options.encoding
    if encoding is None:
        marks = {codecs.BOM_UTF8: "utf-8-sig", codecs.BOM_UTF16_LE: "utf-16", codecs.BOM_UTF16_BE: "utf-16"}
        encoding = next((name for mark, name in marks.items() if raw.startswith(mark)), "utf-8")
    if "16" not in encoding and "32" not in encoding and b"\x00" in raw:
        raise InputError(
            "is no text file", file=path, hint="name its format under 'reader:' of the mapping: {kind: ...}"
        )
    if b"\n" not in raw and raw.count(b"\r") > 1:
        raise InputError(
            "its lines end with a carriage return alone",
            file=path,
            hint="save it with line feeds at the ends of lines",
        )
    try:
        decoder = codecs.getincrementaldecoder(encoding)()
        return encoding, decoder.decode(raw, final=whole), whole
    except LookupError as error:
        raise InputError(f"there is no encoding '{encoding}'", file=path) from error
    except UnicodeDecodeError as error:
        if options.encoding is not None:
            line = raw[: error.start].count(b"\n") + 1
            raise InputError(f"is not {encoding} text", file=path, line=line) from error
    notes.append("is not UTF-8; read as Western European text (cp1252)")
    return "cp1252", raw.decode("cp1252", "replace"), whole


def cells_of(line: str, delimiter: str, blanks: bool) -> list[str]:
    """The cells of one line."""
    if blanks:
        return line.split()
    if '"' not in line:
        return line.split(delimiter)
    try:
        return next(csv.reader([line], delimiter=delimiter))
    except (csv.Error, StopIteration):
        return line.split(delimiter)


def _delimiter(lines: list[str], options: Options) -> tuple[str, bool]:
    """What separates the cells, and whether a run of blanks counts once."""
    wanted = options.delimiter
    if wanted is not None:
        if wanted.lower() in ("whitespace", "space", "spaces", " "):
            return " ", True
        wanted = {"tab": "\t", "\\t": "\t", "comma": ",", "semicolon": ";"}.get(wanted.lower(), wanted)
        if len(wanted) != 1 or ord(wanted) > 127 or wanted in '"\r\n':
            raise InputError(f"'{wanted}' cannot separate cells", column="reader.delimiter")
        return wanted, False
    lines = lines[:200]
    best, score = "", 0.0
    for candidate in (*_CANDIDATES, " "):
        counts = Counter(len(cells_of(line, candidate, candidate == " ")) for line in lines)
        width, times = counts.most_common(1)[0]
        # More lines of one width win; among equals the more cells, and a real delimiter over blanks.
        points = (times / len(lines)) * (1 + min(width, 50) / 1000) if width > 1 else 0.0
        if points > score + (0.2 if candidate == " " and best else 0.0):
            best, score = candidate, points
    return (best or ",", False) if best != " " else (" ", True)


def _decimal(table: list[list[str]], delimiter: str) -> str:
    if delimiter == ",":
        return "."
    cells = [cell.strip() for row in table[:200] for cell in row]
    commas = sum(bool(_COMMA.fullmatch(cell)) for cell in cells)
    dots = sum(number(cell) is not None and "." in cell for cell in cells)
    return "," if commas > dots else "."


def value(cell: str, decimal: str) -> float | None:
    """The number in a cell, or None where it is none."""
    text = cell.strip()
    if decimal == ",":
        text = text.replace(",", ".") if "." not in text else "?"
    return number(text)


def _split(
    table: list[tuple[int, list[str]]], width: int, decimal: str, options: Options, path: Path
) -> tuple[list[list[str]], int]:
    """The lines of names (and units) that stand above the samples, and where those begin."""

    def looks_sampled(cells: list[str]) -> bool:
        return any(value(c, decimal) is not None or _DATE.fullmatch(c.strip()) for c in cells)

    if options.header is False:
        return [], 0
    found = next(
        (k for k, (_, cells) in enumerate(table) if len(cells) == width and looks_sampled(cells)), None
    )
    if options.header is True and found in (None, 0):
        # the names themselves look like samples, or the samples like names
        first = 2 if len(table) > 2 and _are_units(table[1][1]) else 1
        if len(table) <= first:
            raise InputError("holds no samples under its header", file=path, line=table[0][0])
        return [cells for _, cells in table[:first]], first
    if found is None:
        raise InputError(
            "no line holds numbers",
            file=path,
            line=table[0][0],
            hint="give delimiter or skip_rows under 'reader:'",
        )
    head: list[list[str]] = []
    trailing = all(not cells[-1].strip() for _, cells in table[found:] if len(cells) == width)
    for _, above in reversed(table[:found]):
        # a delimiter at the end of every line of samples, and none under the names
        cells = [*above, ""] if trailing and len(above) == width - 1 else above
        if len(cells) != width:
            break
        named = [row for row in head if not _are_units(row)]
        if named and not _repeats(named[0]):
            break
        head.insert(0, cells)
    return head, found


def _repeats(cells: list[str]) -> bool:
    """Whether names stand more than once, so that the line above must tell them apart."""
    named = [cell.strip() for cell in cells if cell.strip()]
    return len(set(named)) < len(named)


def _joined(head: list[list[str]]) -> list[list[str]]:
    """Several lines of names as one: point and coordinate as ``nose_x``.

    The tables of DeepLabCut and of pandas name a column by a line each for scorer, body part and coordinate;
    a line that says the same of all columns tells nothing.
    """
    levels = [row for row in head if not _are_units(row)]
    if len(levels) < 2:
        return head
    units = [row for row in head if _are_units(row)]
    telling = [row for row in levels if len({cell.strip() for cell in row[1:]}) > 1]
    names = ["_".join(filter(None, (row[k].strip() for row in telling))) for k in range(len(head[0]))]
    first = [row[0].strip() for row in levels]
    # the first column counts the pictures, and its cells name the lines
    names[0] = "frame" if "bodyparts" in first else first[-1] or "frame"
    return [names, *units]


def _are_units(cells: list[str]) -> bool:
    from swimid.logs.units import UNITS, canonical

    known = {name for units in UNITS.values() for name in units}
    texts = [cell.strip().strip("[]()") for cell in cells if cell.strip()]
    return (
        bool(texts) and sum(canonical(text) in known or text in ("-", "1") for text in texts) > len(texts) / 2
    )


def _names(head: list[list[str]], width: int) -> tuple[list[str], list[str], bool]:
    if not head:
        return [str(k + 1) for k in range(width)], [], False
    units = [cell.strip().strip("[]()") for cell in head[1]] if len(head) > 1 else []
    if len(head) == 1 and _are_units(head[0]) and len(set(head[0])) < width:
        return [str(k + 1) for k in range(width)], [c.strip().strip("[]()") for c in head[0]], False
    names: list[str] = []
    for at, cell in enumerate(head[0], start=1):
        name = cell.strip().strip('"') or f"column {at}"
        again = 2
        while name in names:
            name = f"{cell.strip()} ({again})"
            again += 1
        names.append(name)
    return names, units, True


def _kind(cells: list[str], decimal: str, missing: tuple[str, ...]) -> Literal["number", "time", "text"]:
    known = [cell.strip() for cell in cells if cell.strip() not in MISSING and cell.strip() not in missing]
    if not known:
        return "number"
    if sum(value(cell, decimal) is not None for cell in known) >= len(known) / 2:
        return "number"
    return "time" if sum(bool(_DATE.fullmatch(cell)) for cell in known) >= len(known) / 2 else "text"


def readable(cell: str, found: Layout) -> bool:
    """Whether a cell of a column of numbers is a number or marks a missing one."""
    text = cell.strip()
    return text in MISSING or text in found.missing or value(text, found.decimal) is not None


def rows(path: Path, found: Layout) -> Iterator[tuple[int, list[str]]]:
    """Line number and cells of every sample, slowly."""
    with path.open("r", encoding=found.encoding, errors="replace", newline="\n") as stream:
        for at, line in enumerate(stream, start=1):
            text = line.rstrip("\r\n")
            if at < found.first_line or not text.strip() or text.lstrip().startswith(found.comment):
                continue
            yield at, cells_of(text, found.delimiter, found.blanks)


def line_of(path: Path, found: Layout, wanted: Callable[[str], bool]) -> int | None:
    """First line of samples that is as wanted."""
    return next((at for at, cells in rows(path, found) if wanted(found.delimiter.join(cells))), None)


def blocks(path: Path, found: Layout, size: int) -> Iterator[tuple[bytes, int, int]]:
    """The samples as pieces of UTF-8 text made of whole lines, comments taken out.

    Yields
    ------
    text : bytes
    lines : int
        Lines of the file it was made from.
    taken : int
        Bytes of the file it was made from.
    """
    with path.open("rb") as raw:
        stream: IO[bytes] = raw
        if found.encoding not in ("utf-8", "ascii"):
            stream = codecs.EncodedFile(raw, "utf-8", found.encoding, errors="replace")  # type: ignore[assignment]
        for _ in range(found.first_line - 1):
            stream.readline()
        taken = 0
        while text := stream.read(size):
            if not text.endswith(b"\n"):
                text += stream.readline()
            lines = text.count(b"\n") + (not text.endswith(b"\n"))
            here = raw.tell()
            yield _cleaned(text, found), lines, here - taken
            taken = here


def _cleaned(text: bytes, found: Layout) -> bytes:
    """Without comment lines; runs of blanks made one where they separate."""
    mark = found.comment.encode()
    if mark in text:
        text = b"\n".join(line for line in text.split(b"\n") if not line.lstrip().startswith(mark))
    return _EDGES.sub(b"", _BLANK.sub(b" ", text)) if found.blanks else text
