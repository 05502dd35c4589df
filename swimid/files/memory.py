"""Check that data fit in the memory of the computer, before memory is allocated."""

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


def check_fits(path: Path, what: str, needed: float, hint: str) -> None:
    """Raise an error if the content of a file does not fit in memory.

    Parameters
    ----------
    what : str
        Name of the content in the message, such as "100 rows of 5 columns".
    needed : float
        Memory that the content needs, bytes.
    hint : str
        Suggestion to the user that reduces the needed memory.

    Raises
    ------
    InputError
    """
    most = physical_bytes()
    if needed > most:
        text = f"{what} do not fit in memory: they need {needed / 1e9:.3g} GB of {most / 1e9:.3g} GB"
        raise InputError(text, file=path, hint=hint)
