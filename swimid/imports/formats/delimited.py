"""Reader of text files with columns that are separated by commas, semicolons, tabs or blanks."""

from __future__ import annotations

import codecs
import csv
import re
from collections import Counter
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain, compress, pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from swimid.errors import InputError
from swimid.files.tabular import MISSING, count_cells, parse, parse_number
from swimid.imports.formats.serial import find_label, split_stamps, to_table
from swimid.imports.table import GROUPED, ForeignTable, Format, Peek, ReaderOptions, numbers_in
from swimid.logs.log import TIME
from swimid.logs.units import KNOWN, canonical

if TYPE_CHECKING:
    import pandas as pd

#: SAMPLE is the number of bytes at the beginning of a file from which its layout is determined. LINES is the
#: number of lines from which delimiter and decimal mark are determined.
SAMPLE, LINES = 1 << 18, 200
#: Maximum fraction of the rows of a file with a wrong number of cells. Up to this fraction, such rows are
#: left out. Above it the file is refused.
MAX_RAGGED = 0.01
#: Weight of each delimiter when the delimiter of a file is chosen. Commas and blanks have lower weights,
#: because commas can also be decimal marks, and blanks can occur within cells.
DELIMITERS = {",": 0.9, ";": 1.0, "\t": 1.0, "|": 1.0, " ": 0.7}
#: Pattern of the bytes of plain text, and minimum fraction of such bytes in a text that is not UTF-8. In
#: compressed data the fraction is 38 %. In a table with another character encoding it is larger, because all
#: cells except a few names are numbers.
_PLAIN, MIN_PLAIN = re.compile(rb"[\t\n\r -~]"), 0.7
_MARKS: dict[str | None, str] = {"tab": "\t", "whitespace": " "}
_ENCODINGS = {codecs.BOM_UTF16_LE: "utf-16", codecs.BOM_UTF16_BE: "utf-16"}
#: Translation table for the cells of a file, by decimal mark of the file. It converts the decimal mark to a
#: point.
_POINTS: dict[str, dict[int, int]] = {".": {}, ",": str.maketrans(",.", ".,")}
_COMMA = re.compile(r"[-+]?\d*,\d+([eE][-+]?\d+)?")
#: Pattern of a cell with a date or a time of day. Like a number, such a cell shows that a line holds samples.
_SAMPLE = re.compile(r"\d{1,4}[-/.]\d\d?[-/.]\d{1,4}([T ].*)?|\d\d?:\d\d(:\d\d)?.*")
_EMPTY_LINES = re.compile(rb"\n([ \t,;|]*\n)+(?=[ \t,;|]*[^\d\s+.,;|-])")
_UNNAMED = re.compile(r"(column )?\d+")
#: Number of bytes after an empty line in which the column names of a second table are searched for.
MAX_HEADER = 1 << 12
_BLANKS, _EDGES = re.compile(rb"[ \t]+"), re.compile(rb"(?m)^ | $")


@dataclass(frozen=True)
class Layout:
    """Layout of a delimited text file: column names, delimiter, decimal mark and first sample.

    Attributes
    ----------
    names : list of str
        Column names; ``"1"``, ``"2"``, ... if the file has no header.
    units : list of str
        Cells of the line of units under the header; empty if there is no such line.
    numbers : list of str
        Names of the columns whose cells are numbers in the first rows, and which are read as numbers.
    delimiter : str
        Delimiter, one character. A space means that any number of blanks separates the cells.
    decimal : str
        Decimal mark.
    first_line : int
        Line number of the first sample, from 1.
    """

    names: list[str]
    units: list[str]
    numbers: list[str]
    delimiter: str
    decimal: str
    first_line: int


def _open(path: Path, options: ReaderOptions, select: str | None) -> ForeignTable:
    text, notes = _read_utf8(path, options)
    label = find_label(text[:SAMPLE])
    if label is None:
        return read_text(split_stamps(text), notes, options, path)
    text, labels = to_table(text, label, notes)
    layout = {"header": False, "delimiter": ",", "decimal": "."}
    table = read_text(text, notes, options.model_copy(update=layout), path)
    columns = {labels[int(number) - 1]: values for number, values in table.columns.items()}
    return replace(table, columns=columns, names=labels)


def read_text(text: bytes, notes: list[str], options: ReaderOptions, path: Path) -> ForeignTable:
    """Return a table of the columns in a text.

    ``text`` is UTF-8 with line feeds, ``notes`` is a list to which remarks are appended, and ``path`` is the
    file for messages.

    Raises
    ------
    InputError
        The text holds no samples, or too many lines have another number of cells than the others.
    """
    comment = re.compile(rb"(?m)^[ \t]*" + re.escape(options.comment.encode()) + rb"(.*)")
    comments = [line.decode(errors="replace") for line in comment.findall(text[:SAMPLE])]
    lines = comment.sub(b"", text[:SAMPLE]).decode(errors="replace").split("\n")
    if len(text) > SAMPLE:
        lines.pop()
    found = _find_layout(lines, options, path, notes)
    text = text.split(b"\n", found.first_line - 1)[-1]
    if options.comment.encode() in text:
        text = comment.sub(b"", text)
    text = _cut_below(text, found, notes)
    if found.delimiter == " ":
        text = _EDGES.sub(b"", _BLANKS.sub(b" ", text))
    stated = dict(zip(found.names, found.units, strict=False))
    parsed, rows, asked = _parse_lines(text, found, options, path, notes)
    blank = [name for name in found.names if _UNNAMED.fullmatch(name) and not parsed[name].notna().any()]
    kept = [name for name in found.names if name not in blank] or found.names
    columns = {name: _convert(parsed[name], found.decimal, options) for name in kept}
    return ForeignTable(
        columns, stated, notes=notes, comments=comments, lines=rows, names=found.names, asked=asked
    )


def _parse_lines(
    text: bytes, found: Layout, options: ReaderOptions, path: Path, notes: list[str]
) -> tuple[pd.DataFrame, NDArray[np.int64], dict[str, str]]:
    """Return the samples in a text, their line numbers, and the reader options needed to read them.

    Lines with a wrong number of cells are left out, with a remark that is appended to ``notes``.
    """
    parsed, asked, width = None, {}, len(found.names)
    if b'"' not in text:
        parsed = _parse(text, found, options)
        if _is_regular(text, parsed, found.delimiter):
            return parsed, np.arange(len(parsed), dtype=np.int64) + found.first_line, {}
    numbered = enumerate(text.split(b"\n"), start=found.first_line)
    blanks = b" \t".replace(found.delimiter.encode(), b"")
    filled = [(at, line) for at, line in numbered if line.strip(blanks)]
    cells = np.array([count_cells(line.decode(), found.delimiter) for _, line in filled])
    broken = [(at, int(count)) for (at, _), count in zip(filled, cells, strict=True) if count != width]
    filled = list(compress(filled, cells == width))
    if broken:
        asked = _note_ragged(broken, width, len(filled), path, options, notes)
    if broken or parsed is None:
        parsed = _parse(b"\n".join(line for _, line in filled), found, options)
    return parsed, np.array([at for at, _ in filled], dtype=np.int64), asked


def _cut_below(text: bytes, found: Layout, notes: list[str]) -> bytes:
    """Return the samples in a text without a second table below them; append a remark to ``notes``.

    The second table begins, under an empty line and perhaps a title, with a line of other column names.
    """
    for hit in _EMPTY_LINES.finditer(text):
        lines = text[hit.end() : hit.end() + MAX_HEADER].decode(errors="replace").split("\n")[:3]
        rows = [_cells(line, found.delimiter) for line in lines]
        for names, cells in pairwise(rows):
            numbered = any(_value(cell, found.decimal) is not None for cell in cells)
            if _is_header(names) and numbered and not {*filter(None, names)} <= {*found.names}:
                at = found.first_line + text[: hit.end()].count(b"\n")
                notes.append(f"another table begins in line {at}; it and all lines below are not read")
                return text[: hit.start()]
    return text


def _read_utf8(path: Path, options: ReaderOptions) -> tuple[bytes, list[str]]:
    """Return the content of a file as UTF-8 with line feeds, and notes for the user."""
    raw, notes = path.read_bytes(), []
    encoding = options.encoding or _ENCODINGS.get(raw[:2], "utf-8-sig")
    try:
        text = raw.decode(encoding)
    except UnicodeDecodeError as error:
        if options.encoding is not None:
            line = raw[: error.start].count(b"\n") + 1
            hint = "correct 'encoding' under 'reader:' of a mapping"
            raise InputError(f"is not {encoding} text", file=path, line=line, hint=hint) from error
        text = raw.decode("cp1252", "replace")
        notes.append("is not UTF-8; read as Western European text (cp1252)")
    is_plain = len(_PLAIN.findall(raw[:SAMPLE])) > MIN_PLAIN * len(raw[:SAMPLE])
    if "\x00" in text[:SAMPLE] or (notes and not is_plain):
        hint = "name its format (--as NAME, or as: NAME in a mapping), or its encoding under 'reader:'"
        raise InputError("is no text file", file=path, hint=hint)
    return text.encode().replace(b"\r\n", b"\n").replace(b"\r", b"\n"), notes


def _find_layout(lines: list[str], options: ReaderOptions, path: Path, notes: list[str]) -> Layout:
    """Return the layout of a file, from the options or from its first lines; append remarks to ``notes``."""
    numbered = list(enumerate(lines, start=1))[options.skip_rows :]
    kept = {at: line for at, line in numbered if line.strip()}
    at, texts = list(kept), list(kept.values())
    if not kept:
        raise InputError("holds no samples", file=path)
    stated_mark = _MARKS.get(options.delimiter, options.delimiter)
    delimiter = stated_mark or _likely_delimiter(texts[:LINES])
    table = [_cells(line, delimiter) for line in texts]
    decimal = options.decimal or _decimal(table[:LINES], delimiter)
    if delimiter == decimal:
        hint = "give another delimiter or decimal under 'reader:' of a mapping"
        raise InputError("a comma cannot both separate cells and mark decimals", file=path, hint=hint)
    width = Counter(map(len, table)).most_common(1)[0][0]
    first = _first_sample(table, width, decimal, options)
    if first is None:
        hint = "give delimiter, header or skip_rows under 'reader:' of a mapping, or mend lost line ends"
        raise InputError("no line holds numbers", file=path, line=at[0], hint=hint)
    above, samples = table[:first], [cells for cells in table[first:] if len(cells) == width]
    units = _take_units(above)
    _fit_width(above, samples, width)
    names = _read_names(above, width, at[: first + 1], options, notes)
    missing = {*MISSING, *map(str, options.missing)}
    numbers = [_are_numbers({*cells} - missing, decimal) for cells in zip(*samples, strict=True)]
    return Layout(names, units, list(compress(names, numbers)), delimiter, decimal, at[first])


def _take_units(above: list[list[str]]) -> list[str]:
    """Remove the line of units, if there is one, from the lines above the samples; return its cells."""
    cells = [cell.strip("[]()") for cell in chain(*above[-1:])]
    texts = list(filter(None, cells))
    are_units = sum(canonical(text) in KNOWN or text in ("-", "1") for text in texts) > len(texts) / 2
    if not are_units or (len(above) == 1 and _differ(above[-1])):
        return []
    above.pop()
    return cells


def _fit_width(above: list[list[str]], samples: list[list[str]], width: int) -> None:
    """Add or remove empty cells at the end of the line of names, in place, so that each column has one."""
    if above and not any(above[-1][width:]):
        del above[-1][width:]
    if above and len(above[-1]) == width - 1 and not any(cells[-1] for cells in samples):
        # Each line of samples ends with a delimiter, but the line of names does not.
        above[-1].append("")


def _read_names(
    above: list[list[str]], width: int, lines: list[int], options: ReaderOptions, notes: list[str]
) -> list[str]:
    """Return the column names from the lines above the samples; append remarks to ``notes``.

    ``lines`` has the line numbers of the lines above the samples and of the first sample.
    """
    if above and len(above[-1]) != width and _is_header(above[-1]):
        text = f"line {lines[len(above) - 1]} has {len(above[-1])} names, but lines below have {width}"
        notes.append(f"{text}: no name is used, and the columns have numbers")
    levels: list[list[str]] = []
    # Read several header lines: if the names in one line are not unique, prefix each name with the name in
    # the line above.
    while above and len(above[-1]) == width and not (levels and _differ(levels[0])):
        levels.insert(0, above.pop())
    if levels and above and options.skip_rows is None:
        notes.append(f"{lines[-1] - 1} lines above the samples are not read as samples")
    return _names(levels, width)


def _likely_delimiter(lines: list[str]) -> str:
    scores = {}
    for mark, weight in DELIMITERS.items():
        table = [_cells(line, mark) for line in lines]
        width, times = Counter(map(len, table)).most_common(1)[0]
        flat = [cell for row in table for cell in row]
        numbered = np.mean([bool(_COMMA.fullmatch(cell)) or parse_number(cell) is not None for cell in flat])
        # Score the delimiter mainly by two values: the number of lines that have the same number of cells,
        # and the fraction of cells that hold numbers. A larger number of cells per line adds a little.
        scores[mark] = weight * (0.1 + numbered) * times * (1 + min(width, 50) / 1000) * (width > 1)
    return max(scores, key=lambda mark: scores[mark])


def _cells(line: str, delimiter: str) -> list[str]:
    """Return the cells of one line of a file, without surrounding blanks."""
    if delimiter == " ":
        line = " ".join(line.split())
    return [cell.strip() for cell in next(csv.reader([line], delimiter=delimiter))]


def _decimal(table: list[list[str]], delimiter: str) -> str:
    """Return the decimal mark of a file. A comma that may separate groups of digits does not count."""
    cells = [cell for row in table for cell in row]
    commas = [cell for cell in cells if _COMMA.fullmatch(cell)]
    dots = sum(parse_number(cell) is not None and "." in cell for cell in cells)
    is_grouped = all(re.fullmatch(GROUPED, cell) for cell in commas)
    return "," if len(commas) > dots and delimiter != "," and not is_grouped else "."


def _value(cell: str, decimal: str) -> float | None:
    """Return the number in a cell; None if the cell holds no number."""
    return parse_number(cell.translate(_POINTS[decimal]))


def _first_sample(table: list[list[str]], width: int, decimal: str, options: ReaderOptions) -> int | None:
    """Return the index of the first line of a file that holds samples; None if there is none.

    A line of text and numbers, such as a setting, holds no sample if the names of the columns and most of the
    samples follow it.
    """
    if options.header is False:
        return 0
    filled = [list(filter(None, cells)) for cells in table]
    counts = np.array([sum(_is_sample(cell, decimal) for cell in cells) for cells in filled])
    sampled = (counts > 0) & (np.array(list(map(len, table))) == width)
    sampled[0] &= not options.header
    candidates = (np.flatnonzero(counts[1:LINES] == 0) + 1).tolist()
    headers = [k for k in candidates if _is_header(table[k]) and table[k] not in table[:k]]
    for at in np.flatnonzero(sampled).tolist():
        later = [k for k in headers if k > at and len(filled[k]) >= len(filled[at])]
        has_text = counts[at] < len({*filled[at]} - {*MISSING})
        is_setting = has_text and any(sampled[at:k].sum() < sampled[k:].sum() for k in later)
        if not is_setting:
            return at
    return None


def _are_numbers(cells: set[str], decimal: str) -> bool:
    return all(_value(cell, decimal) is not None for cell in cells)


def _is_sample(cell: str, decimal: str) -> bool:
    """Return whether a cell holds a number, a date or a time of day."""
    return _value(cell, decimal) is not None or _SAMPLE.fullmatch(cell) is not None


def _is_header(cells: list[str]) -> bool:
    """Return whether the cells of a line may be names of columns: two or more, all different, no numbers."""
    filled = [cell for cell in cells if cell]
    return len(filled) > 1 and _differ(cells) and not any(_is_sample(cell, ".") for cell in filled)


def _differ(cells: list[str]) -> bool:
    filled = [cell for cell in cells if cell]
    return len(set(filled)) == len(filled)


def _names(levels: list[list[str]], width: int) -> list[str]:
    """Return a unique name for each column: ``x``, ``x (2)``, ``column 3``; numbers if there is no header.

    A table may have several header lines, one for each level of the names: ``nose`` above ``x`` becomes
    ``nose_x``. Empty cells to the right of a name repeat this name. A header line that has the same cell in
    all columns is left out.
    """
    if not levels:
        return [str(k + 1) for k in range(width)]
    telling = [row for row in map(_fill, levels[:-1]) if len(set(row[1:])) > 1]
    joined = ["_".join(filter(None, cells)) for cells in zip(*telling, levels[-1], strict=True)]
    if len(levels) > 1:
        # In a table with several header lines, the header cells of the first column name the levels. In a
        # table of DeepLabCut this column counts the frames.
        joined[0] = levels[-1][0].replace("coords", "") or "frame"
    names: list[str] = []
    counts: Counter[str] = Counter()
    for at, name in enumerate(joined, start=1):
        counts[name] += 1
        again = counts[name]
        if not name:
            name = f"column {at}"
        elif again > 1:
            name += f" ({again})"
        names.append(name)
    return names


def _fill(cells: list[str]) -> list[str]:
    """Return the cells of a header line, with each empty cell replaced by the cell before it."""
    filled = [""]
    for cell in cells:
        filled.append(cell or filled[-1])
    return filled[1:]


def _parse(text: bytes, found: Layout, options: ReaderOptions) -> pd.DataFrame:
    """Parse the samples in the text of a file; return a table with cells of numbers or of text."""
    read = partial(
        parse,
        text,
        found.names,
        delimiter=found.delimiter,
        decimal=found.decimal,
        missing=[*MISSING, *map(str, options.missing)],
    )
    try:
        return read(dict.fromkeys(found.names, str) | dict.fromkeys(found.numbers, float))
    except ValueError:
        # At least one cell is not a number. Keep all columns as text, so that a mapping can report the cell.
        return read(str)


def _is_regular(text: bytes, parsed: pd.DataFrame, delimiter: str) -> bool:
    """Return whether a text has one line per parsed row, and the same number of cells in each line.

    A line with too few cells is parsed with a missing last cell.
    """
    lines = text.count(b"\n") + (not text.endswith(b"\n"))
    marks = text.count(delimiter.encode())
    whole = lines == len(parsed) and marks == len(parsed) * (parsed.shape[1] - 1)
    return whole and not parsed.iloc[:, -1].hasnans


def _convert(cells: pd.Series, decimal: str, options: ReaderOptions) -> NDArray[Any]:
    """Return a column as numbers if all its cells are numbers, otherwise as text.

    In the text of a column in which numbers prevail, the decimal mark is a point.
    """
    if cells.dtype.kind == "f":
        return cells.to_numpy()
    plain = cells.str.strip().str.translate(_POINTS[decimal])
    grouped = plain.str.fullmatch(GROUPED).fillna(False).astype(bool)
    if grouped.any() and (options.decimal or plain.str.contains(".", regex=False).any()):
        # Numbers with a decimal point show that the comma separates groups of digits.
        plain = plain.mask(grouped, plain.str.replace(",", ""))
    numbers, odd = numbers_in(plain)
    if not odd.any():
        return numbers
    if odd.sum() < np.isfinite(numbers).sum():
        cells = plain.mask(odd, cells)
    return cells.to_numpy(dtype=object, na_value=None)


def _note_ragged(
    broken: list[tuple[int, int]], width: int, rows: int, path: Path, options: ReaderOptions, notes: list[str]
) -> dict[str, str]:
    """Append a remark on lines with a wrong number of cells; return the reader option that omits them.

    Raises
    ------
    InputError
        There are too many such lines, and the option ``bad_lines`` does not leave them out.
    """
    line, cells = broken[0]
    is_many = len(broken) > max(1, MAX_RAGGED * rows)
    if len(broken) > rows or (is_many and options.bad_lines is None):
        held = f"has {cells or 'unreadable'} cells"
        text = f"{held} where {width} columns are expected ({len(broken)} of {rows + len(broken)} such lines)"
        hint = "give delimiter, header or skip_rows, or leave these lines out by 'bad_lines: skip', under "
        raise InputError(text, file=path, line=line, hint=hint + "'reader:' of the mapping")
    share = f"{len(broken)} of {rows + len(broken)} lines"
    notes.append(f"{share} have a wrong number of cells and are left out (first: line {line})")
    return {"bad_lines": f"skip, because {notes[-1]}"} if is_many else {}


def _has_time(peek: Peek) -> bool:
    """Return whether ``t_s`` is a column name in the first line that is not a comment."""
    header = next((line for line in peek.lines if line.strip() and not line.startswith("#")), "")
    return TIME in [cell.strip().strip('"') for cell in header.split(",")]


ENDINGS = (".csv", ".txt", ".tsv", ".dat", ".asc", ".log")
DELIMITED = Format("delimited", "delimited text file", _open, endings=ENDINGS)
#: Format of logs that swimid writes. Their columns keep their names on import.
SWIMID = Format("swimid", "log of swimid", _open, _has_time)
