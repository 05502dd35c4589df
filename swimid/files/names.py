"""File names made from the ids of trials."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Sequence

from swimid.errors import UsageError

#: Names that Windows reserves for devices.
DEVICES = {"CON", "PRN", "AUX", "NUL", *(f"{port}{k}" for port in ("COM", "LPT") for k in range(1, 10))}


def file_names(ids: Sequence[str], endings: Sequence[str]) -> list[str]:
    """Return one file name for each id; no two of them are the same file on any system.

    Characters other than letters, digits, ``_``, ``-`` and ``.`` become ``_``.

    Parameters
    ----------
    ids : sequence of str
        Distinct ids.
    endings : sequence of str
        Endings with their dot. The names get the first one; an id may end in any of them.

    Raises
    ------
    UsageError
        When two ids have the same name; capitals do not count, because many file systems ignore them.

    Examples
    --------
    >>> file_names(["run 1.csv", "day2/run 1"], [".csv", ".parquet"])
    ['run_1.csv', 'day2_run_1.csv']
    """
    names: dict[str, tuple[str, str]] = {}
    for one in ids:
        bare = next((one.removesuffix(e) for e in endings if one.endswith(e)), one)
        stem = re.sub(r"[^\w.-]", "_", unicodedata.normalize("NFC", bare))
        stem += "_" if stem.partition(".")[0].upper() in DEVICES else ""
        other, name = names.setdefault(stem.casefold(), (one, stem + endings[0]))
        if other != one:
            raise UsageError(
                f"'{other}' and '{one}' would both be written to the file {name}",
                hint="give them ids that differ in letters, digits, '_', '-' or '.'; capitals do not count",
            )
    return [name for _, name in names.values()]
