"""Check that data fit in the memory of the computer, before memory is taken."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

from swimid.errors import InputError

#: Physical memory that is assumed if the operating system does not state it, bytes.
USUAL_BYTES = 8 << 30


def physical_bytes() -> int:
    """Return the size of the physical memory, bytes."""
    with suppress(AttributeError, ValueError, OSError):  # Windows has no sysconf.
        return int(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
    return USUAL_BYTES


def check_rows(path: Path, rows: int, columns: int, copies: float, hint: str) -> None:
    """Raise an error if the rows of a file do not fit in memory.

    Parameters
    ----------
    rows, columns : int
        Number of rows and columns that are read, each cell as a number of 8 bytes.
    copies : float
        Number of copies of the cells that are in memory at once.
    hint : str
        Action for the user that needs less memory.

    Raises
    ------
    InputError
    """
    needed, most = 8.0 * rows * columns * copies, physical_bytes()
    if needed > most:
        text = (
            f"{rows} rows of {columns} columns do not fit in memory: they take {needed / 1e9:.3g} GB, and "
            f"the computer has {most / 1e9:.3g} GB"
        )
        raise InputError(text, file=path, hint=hint)
