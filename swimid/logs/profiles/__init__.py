"""Profiles of known formats: every profile in a module here is found by itself.

A profile recognises its files by a fingerprint. It returns a table whose columns are named as in the log
format, in SI: it knows the units, axes and conventions of its format, or reads them in the file.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

from swimid.errors import InputError, suggestion
from swimid.logs.foreign.base import discovered
from swimid.logs.profiles.base import Peek, Profile

__all__ = ["Profile", "find", "known"]


@cache
def known() -> dict[str, Profile]:
    """Return every profile by its name."""
    return discovered(__name__, Profile)


def find(path: Path, name: str | None = None) -> Profile | None:
    """Return the profile of this name, or without a name the one that recognises the file; None if none does.

    Raises
    ------
    InputError
        There is no profile of the name, or the file cannot be read.
    """
    if name:
        if name not in known():
            hint = suggestion(name, list(known()))
            raise InputError(f"there is no profile '{name}'", file=path, hint=hint)
        return known()[name]
    peek = Peek.of(path)
    return next((profile for profile in known().values() if profile.recognises(peek)), None)
