"""Lines of a serial monitor, such as ``t:123 fx:0.12 fy:-0.3`` or ``fx=0.12, fy=-0.3``, as a table.

Arduino sketches print labels with each value, so that the serial plotter can name the curves. The reader of
delimited text reads such a file as a table with one column for each label. A time of day that the serial
monitor puts before a line (``12:30:01.123 -> ``, ``[12:30:01.123] ``) becomes the column ``clock``.
"""

from __future__ import annotations

import re
from collections import Counter
from itertools import chain

_NUMBER = rb"(?:[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?|nan|[-+]?inf)"
_PAIR = re.compile(rb"([A-Za-z][\w./\[\]()-]*?)[ ]*[:=][ ]*(" + _NUMBER + rb")", re.I)
_SERIAL_CLOCK = rb"(?:\[?(?P<clock>[\d:.]+)(?:\]| ->) ?)?"
_PAIRS = rb"(?P<pairs>%b(?:[ ,;\t]+%b)*)" % ((_PAIR.pattern,) * 2)
_LINE = re.compile(rb"\s*" + _SERIAL_CLOCK + _PAIRS + rb"[ ,;\t]*", re.I)
#: Time of day that the serial monitor of Arduino puts before a line of any content.
_STAMP = re.compile(rb"(?m)^\[?(\d\d?:\d\d:\d\d[\d.]*)\]? -> ?")
#: Criteria for a file of labelled values: it has at least MIN_LINES lines with the same first label. After
#: the first such line, their fraction is at least MIN_SHARE. Other lines are messages, for example of a
#: microcontroller that starts.
MIN_LINES, MIN_SHARE = 3, 0.5


def find_label(text: bytes) -> bytes | None:
    """Return the first label of the lines of labelled values in a file; None for a file of other lines."""
    lines = [line for line in text.split(b"\n") if line.strip()][1:-1]
    labels = [hit and hit[3] for hit in map(_LINE.fullmatch, lines)]
    label, count = next(iter(Counter(filter(None, labels)).most_common(1)), (b"", 0))
    least = max(MIN_LINES, MIN_SHARE * (len(labels) - labels.index(label))) if count else MIN_LINES
    return label if count >= least else None


def split_stamps(text: bytes) -> bytes:
    """Make the time of day, which a serial monitor writes before each line, the first cell of the line.

    Before a line that begins with a letter, such as the names of the columns, the cell is ``clock``.
    """
    if len(_STAMP.findall(text)) < MIN_LINES:
        return text
    rest = _STAMP.sub(b"", text)
    mark = next((mark for mark in (b";", b"\t", b",") if mark in rest), b" ")
    text = _STAMP.sub(rb"\1" + mark, text)
    return re.sub(rb"(?m)^[\d:.]+" + mark + rb"(?=[A-Za-z])", b"clock" + mark, text)


def to_table(text: bytes, label: bytes, notes: list[str]) -> tuple[bytes, list[str]]:
    """Convert the lines of labelled values that begin with ``label`` to comma-separated values.

    A label that a line lacks is an empty cell. Other lines become empty, and a remark on them is appended to
    ``notes``. The second result has the labels.
    """
    lines = text.split(b"\n")
    matches = enumerate(map(_LINE.fullmatch, lines))
    hits = {at: hit for at, hit in matches if hit and hit[3] == label}
    rows = {at: dict(_PAIR.findall(hit["pairs"])) for at, hit in hits.items()}
    if any(hit["clock"] for hit in hits.values()):
        rows = {at: {b"clock": hits[at]["clock"] or b"", **row} for at, row in rows.items()}
    names = list(dict.fromkeys(chain.from_iterable(rows.values())))
    others = sorted({at for at, line in enumerate(lines) if line.strip()} - rows.keys())
    if others:
        share = f"{len(others)} of {len(rows) + len(others)} lines"
        notes.append(f"{share} hold no labelled values and are left out (first: line {others[0] + 1})")
    table = [b""] * len(lines)
    for at, row in rows.items():
        table[at] = b",".join(row.get(name, b"") for name in names)
    return b"\n".join(table), [name.decode() for name in names]
