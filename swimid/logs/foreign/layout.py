"""Layout of a text file of columns: delimiter, header, decimal mark, lines to skip."""

from __future__ import annotations

import codecs
import csv
import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from swimid.errors import InputError
from swimid.files.delimited import MISSING, number
from swimid.logs import units
from swimid.logs.foreign.base import Options

#: Bytes looked at to find the layout, and lines to find the delimiter and the decimal mark.
SAMPLE, LINES = 1 << 18, 200
_COMMA = re.compile(r"[-+]?\d*,\d+([eE][-+]?\d+)?")
#: A number with a unit, as in ``0.05 kg``.
QUANTITY = r"([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?) ?([^\d\s.,+:/-][^\d\s.,:]*[\d]?)"
#: A cell of a sample that is no plain number: a date, a time of day, or a number with a unit.
_SAMPLE = re.compile(rf"\d{{1,4}}[-/.]\d\d?[-/.]\d{{1,4}}([T ].*)?|\d\d?:\d\d(:\d\d)?.*|{QUANTITY}")


@dataclass(frozen=True)
class Layout:
    """The layout of one file.

    Attributes
    ----------
    names : list of str
        Column names; ``"1"``, ``"2"``, ... if the file has no header.
    numbers : list of bool
        Whether at least half of the cells of a column are numbers.
    delimiter : str
        One character; a space if any run of blanks separates the cells.
    first_line : int
        Line of the first sample, from 1.
    comments : list of str
        Comment lines above the samples, without their mark.
    units : list of str
        Line of units under the header; empty without one.
    """

    names: list[str]
    numbers: list[bool]
    delimiter: str
    decimal: str
    encoding: str
    comment: str
    missing: tuple[str, ...]
    first_line: int
    blanks: bool
    comments: list[str]
    units: list[str]
    notes: list[str]


def find(path: Path, options: Options) -> Layout:
    """Return the layout of a file: stated by the options, else found in its first lines.

    Raises
    ------
    InputError
        The file is no text, is empty, or no line looks like samples.
    """
    encoding, text, notes = _text(path, options)
    skip = options.skip_rows or 0
    lines = [(at, line) for at, line in enumerate(text.splitlines(), start=1) if at > skip and line.strip()]
    mark = options.comment
    comments = [line.lstrip()[len(mark) :] for _, line in lines if line.lstrip().startswith(mark)]
    kept = [(at, line) for at, line in lines if not line.lstrip().startswith(mark)]
    if not kept:
        raise InputError("holds no samples", file=path)
    delimiter, blanks = _delimiter([line for _, line in kept[:LINES]], options)
    table = [(at, cells_of(line, delimiter, blanks)) for at, line in kept]
    decimal = options.decimal or _decimal([cells for _, cells in table[:LINES]], delimiter)
    if delimiter == "," and decimal == ",":
        raise InputError("a comma cannot both separate cells and mark decimals", file=path)
    width = Counter(len(cells) for _, cells in table).most_common(1)[0][0]
    head, first = _split(table, width, decimal, options, path)
    names, written, headed = _names(_joined(head), width)
    if options.skip_rows is None and first > max(len(head), 1) and headed:
        notes.append(f"{table[first][0] - 1} lines above the samples are not read as samples")
    missing = tuple(str(mark) for mark in options.missing)
    samples = [cells for _, cells in table[first:] if len(cells) == width]
    return Layout(
        names=names,
        numbers=[_numeric([cells[k].strip() for cells in samples], decimal, missing) for k in range(width)],
        delimiter=delimiter,
        decimal=decimal,
        encoding=encoding,
        comment=mark,
        missing=missing,
        first_line=table[first][0],
        blanks=blanks,
        comments=comments,
        units=written,
        notes=notes,
    )


def _text(path: Path, options: Options) -> tuple[str, str, list[str]]:
    """Return the encoding, the decoded first lines (whole lines only), and notes for the user."""
    with path.open("rb") as stream:
        raw = stream.read(SAMPLE)
        whole = not stream.read(1)
    if not raw:
        raise InputError("is empty", file=path)
    encoding = options.encoding
    if encoding is None:
        marks = {codecs.BOM_UTF8: "utf-8-sig", codecs.BOM_UTF16_LE: "utf-16", codecs.BOM_UTF16_BE: "utf-16"}
        encoding = next((name for mark, name in marks.items() if raw.startswith(mark)), "utf-8")
    if "16" not in encoding and "32" not in encoding and b"\x00" in raw:
        hint = "name its format under 'reader:' of the mapping: {kind: ...}"
        raise InputError("is no text file", file=path, hint=hint)
    if b"\n" not in raw and raw.count(b"\r") > 1:
        hint = "save it with line feeds at the ends of lines"
        raise InputError("its lines end with a carriage return alone", file=path, hint=hint)
    notes: list[str] = []
    try:
        text = codecs.getincrementaldecoder(encoding)().decode(raw, final=whole)
    except LookupError as error:
        raise InputError(f"there is no encoding '{encoding}'", file=path) from error
    except UnicodeDecodeError as error:
        if options.encoding is not None:
            line = raw[: error.start].count(b"\n") + 1
            raise InputError(f"is not {encoding} text", file=path, line=line) from error
        encoding, text = "cp1252", raw.decode("cp1252", "replace")
        notes.append("is not UTF-8; read as Western European text (cp1252)")
    return encoding, text if whole else "".join(text.splitlines(keepends=True)[:-1]), notes


def cells_of(line: str, delimiter: str, blanks: bool) -> list[str]:
    """Return the cells of one line."""
    if blanks:
        return line.split()
    if '"' not in line:
        return line.split(delimiter)
    try:
        return next(csv.reader([line], delimiter=delimiter))
    except (csv.Error, StopIteration):
        return line.split(delimiter)


def _delimiter(lines: list[str], options: Options) -> tuple[str, bool]:
    """Return the delimiter, and whether any run of blanks separates the cells."""
    wanted = options.delimiter
    if wanted is not None:
        if wanted.lower() in ("whitespace", "space", "spaces", " "):
            return " ", True
        wanted = {"tab": "\t", "\\t": "\t", "comma": ",", "semicolon": ";"}.get(wanted.lower(), wanted)
        if len(wanted) != 1 or ord(wanted) > 127 or wanted in '"\r\n':
            raise InputError(f"'{wanted}' cannot separate cells", column="reader.delimiter")
        return wanted, False
    best, score = "", 0.0
    for candidate in (",", ";", "\t", "|", " "):
        counts = Counter(len(cells_of(line, candidate, candidate == " ")) for line in lines)
        width, times = counts.most_common(1)[0]
        # More lines of one width win; among equals the more cells, and a real delimiter over blanks.
        points = (times / len(lines)) * (1 + min(width, 50) / 1000) if width > 1 else 0.0
        if points > score + (0.2 if candidate == " " and best else 0.0):
            best, score = candidate, points
    return best or ",", best == " "


def _decimal(table: list[list[str]], delimiter: str) -> str:
    cells = [cell.strip() for row in table for cell in row]
    commas = sum(bool(_COMMA.fullmatch(cell)) for cell in cells)
    dots = sum(number(cell) is not None and "." in cell for cell in cells)
    return "," if commas > dots and delimiter != "," else "."


def _value(cell: str, decimal: str) -> float | None:
    """Return the number in a cell; None if it is none."""
    if decimal == ",":
        cell = cell.replace(",", ".") if "." not in cell else "?"
    return number(cell.strip())


def _split(
    table: list[tuple[int, list[str]]], width: int, decimal: str, options: Options, path: Path
) -> tuple[list[list[str]], int]:
    """Return the lines of names (and units) above the samples, and the index of the first sample."""

    def looks_sampled(cells: list[str]) -> bool:
        return any(_value(c, decimal) is not None or _SAMPLE.fullmatch(c.strip()) for c in cells)

    if options.header is False:
        return [], 0
    first = next(
        (k for k, (_, cells) in enumerate(table) if len(cells) == width and looks_sampled(cells)), None
    )
    if options.header is True and not first:
        # here the names look like samples, or the samples look like names
        first = 2 if len(table) > 2 and _are_units(table[1][1]) else 1
        if len(table) <= first:
            raise InputError("holds no samples under its header", file=path, line=table[0][0])
        return [cells for _, cells in table[:first]], first
    if first is None:
        hint = "give delimiter or skip_rows under 'reader:'"
        raise InputError("no line holds numbers", file=path, line=table[0][0], hint=hint)
    head: list[list[str]] = []
    trailing = all(not cells[-1].strip() for _, cells in table[first:] if len(cells) == width)
    for _, above in reversed(table[:first]):
        # a delimiter at the end of every line of samples, and none under the names
        cells = [*above, ""] if trailing and len(above) == width - 1 else above
        levels = [[cell.strip() for cell in row if cell.strip()] for row in head if not _are_units(row)]
        # a line of names that stand more than once needs the line above to tell them apart
        if len(cells) != width or (levels and len(set(levels[0])) == len(levels[0])):
            break
        head.insert(0, cells)
    return head, first


def _joined(head: list[list[str]]) -> list[list[str]]:
    """Return several lines of names as one: ``nose`` above ``x`` becomes ``nose_x``.

    Tables of pandas have one line for each level of the column names. A line that is equal in all columns is
    left out.
    """
    levels = [row for row in head if not _are_units(row)]
    if len(levels) < 2:
        return head
    telling = [row for row in levels if len({cell.strip() for cell in row[1:]}) > 1]
    names = ["_".join(filter(None, (row[k].strip() for row in telling))) for k in range(len(head[0]))]
    first = [row[0].strip() for row in levels]
    # the cells of the first column name the lines; the column itself counts the frames
    names[0] = "frame" if "bodyparts" in first else first[-1] or "frame"
    return [names, *(row for row in head if _are_units(row))]


def _are_units(cells: list[str]) -> bool:
    texts = [text for text in map(_unit, cells) if text]
    return sum(units.canonical(text) in units.KNOWN or text in ("-", "1") for text in texts) > len(texts) / 2


def _unit(cell: str) -> str:
    return cell.strip().strip("[]()")


def _names(head: list[list[str]], width: int) -> tuple[list[str], list[str], bool]:
    """Return names and units of the columns, and whether the file names them."""
    numbered = [str(k + 1) for k in range(width)]
    if not head:
        return numbered, [], False
    if len(head) == 1 and _are_units(head[0]) and len(set(head[0])) < width:
        return numbered, [_unit(cell) for cell in head[0]], False
    names: list[str] = []
    for at, cell in enumerate(head[0], start=1):
        name = cell.strip().strip('"') or f"column {at}"
        again = 2
        while name in names:
            name = f"{cell.strip()} ({again})"
            again += 1
        names.append(name)
    return names, [_unit(cell) for cell in head[1]] if len(head) > 1 else [], True


def _numeric(cells: list[str], decimal: str, missing: tuple[str, ...]) -> bool:
    known = [cell for cell in cells if cell not in MISSING and cell not in missing]
    return sum(_value(cell, decimal) is not None for cell in known) >= len(known) / 2


def rows(path: Path, found: Layout) -> Iterator[tuple[int, list[str]]]:
    """Yield line number and cells of every sample; slow."""
    with path.open("r", encoding=found.encoding, errors="replace", newline="\n") as stream:
        for at, line in enumerate(stream, start=1):
            text = line.rstrip("\r\n")
            if at >= found.first_line and text.strip() and not text.lstrip().startswith(found.comment):
                yield at, cells_of(text, found.delimiter, found.blanks)
