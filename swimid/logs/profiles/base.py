"""The interface of profiles."""

from __future__ import annotations

import codecs
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from swimid.errors import InputError
from swimid.logs.choices import Choices
from swimid.logs.foreign.base import Table, first_bytes, reading


@dataclass(frozen=True)
class Peek:
    """The beginning of a file, for fingerprints."""

    path: Path
    head: bytes

    @classmethod
    def of(cls, path: Path) -> Peek:
        """Read the beginning of a file.

        Raises
        ------
        InputError
            It cannot be read.
        """
        return cls(path, first_bytes(path, 1 << 14))

    @cached_property
    def lines(self) -> list[str]:
        """The first lines of a text file; empty for any other."""
        try:
            text = codecs.getincrementaldecoder("utf-8-sig")().decode(self.head)
        except UnicodeDecodeError:
            return []
        return [] if "\x00" in text else [line.rstrip("\r") for line in text.split("\n")]

    @cached_property
    def header(self) -> list[str]:
        """The cells of the first line, separated by commas, without blanks around them."""
        return [cell.strip().strip('"') for cell in (self.lines or [""])[0].split(",")]

    def holds(self, *names: str) -> bool:
        """Return whether the file is HDF5 and has data sets or groups of these names."""
        if not self.head.startswith(b"\x89HDF"):
            return False
        import h5py

        try:
            with h5py.File(self.path, "r") as file:
                return all(name in file for name in names)
        except OSError:
            return False


@dataclass(frozen=True)
class Profile:
    """One known format.

    Attributes
    ----------
    name : str
        For ``--as``.
    title : str
        In words.
    recognises : callable
        ``recognises(peek) -> bool``: whether a file has the fingerprint of the format.
    read : callable
        ``read(path, choices) -> Table``: columns named as in the log format, in SI. Times are in ``t_s``; a
        format without times has ``frame``, and the rate in ``scalars["rate_hz"]`` if the file states it.
    extra : str
        The optional dependency to install.
    """

    name: str
    title: str
    recognises: Callable[[Peek], bool]
    read: Callable[[Path, Choices], Table]
    extra: str = ""

    def table(self, path: Path, choices: Choices) -> Table:
        """Read a file.

        Raises
        ------
        InputError
            It is no file of this format, or holds several tracks and none was selected.
        """
        Peek.of(path)
        try:
            with reading(path, self.title, self.extra):
                return self.read(path, choices)
        except InputError as error:
            if error.hint is None:
                error.hint = f"the file is read as a {self.title}; --as names another format"
            raise


def safe(name: str) -> str:
    """Return a name as letters, digits and underscores, beginning with a letter.

    >>> safe("tail tip"), safe("/hip/value"), safe("2nd")
    ('tail_tip', 'hip_value', 'p2nd')
    """
    words = "".join(c if c.isascii() and c.isalnum() else "_" for c in name).strip("_")
    while "__" in words:
        words = words.replace("__", "_")
    return words if words[:1].isalpha() else f"p{words}"
