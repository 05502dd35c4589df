"""Lines of a serial monitor, such as ``t:123 fx:0.12 fy:-0.3`` or ``fx=0.12, fy=-0.3``, as a table.

Arduino sketches print labels with each value, so that the serial plotter can name the curves. The reader of
delimited text reads such a file as a table with one column for each label. A time of day that the serial
monitor puts before a line (``12:30:01.123 -> ``) becomes the column ``clock``.
"""

from __future__ import annotations

import re
from itertools import chain

_NUMBER = rb"(?:[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?|nan|[-+]?inf)"
_PAIR = re.compile(rb"([A-Za-z][\w./\[\]()-]*?)[ ]*[:=][ ]*(" + _NUMBER + rb")", re.I)
_CLOCK, _PAIRS = rb"(?:(?P<clock>[\d:.]+) -> ?)?", rb"(?P<pairs>%b(?:[ ,;\t]+%b)*)" % ((_PAIR.pattern,) * 2)
_LINE = re.compile(rb"\s*" + _CLOCK + _PAIRS + rb"[ ,;\t]*", re.I)
#: Minimum number of lines by which a file of labelled values is recognised. All these lines have the same
#: first label. The first line may be cut off, because a recording begins anywhere.
MIN_LINES = 3


def is_serial(text: bytes) -> bool:
    """Return whether the lines at the beginning of a file hold labelled values only."""
    lines = [line for line in text.split(b"\n")[:50] if line.strip()]
    hits = [_LINE.fullmatch(line) for line in lines[1:-1]]
    labels = {hit[3] for hit in hits if hit}
    return len(hits) >= MIN_LINES and all(hits) and len(labels) == 1


def to_table(text: bytes) -> tuple[bytes, list[str]]:
    """Convert lines of labelled values to comma-separated values, and return them with the labels.

    A label that a line lacks is an empty cell. Other lines stay as they are.
    """
    lines = text.split(b"\n")
    hits = [_LINE.fullmatch(line) for line in lines]
    found = [hit and dict(_PAIR.findall(hit["pairs"])) | {b"clock": hit["clock"] or b""} for hit in hits]
    rows = [row for row in found if row]
    names = list(dict.fromkeys(name for name in chain.from_iterable(rows) if name != b"clock"))
    if any(row[b"clock"] for row in rows):
        names.insert(0, b"clock")
    for at, row in enumerate(found):
        if row:
            lines[at] = b",".join(row.get(name, b"") for name in names)
    return b"\n".join(lines), [name.decode() for name in names]
