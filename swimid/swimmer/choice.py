"""A choice by sign that the compiler and the tracer of the engines both understand."""

from __future__ import annotations

import numba


@numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")
def positive(asked, then, otherwise):  # type: ignore[no-untyped-def]
    """``then`` where ``asked`` is above 0, else ``otherwise`` (also where it is NaN); both have a value.

    >>> positive(1.0, 2.0, 3.0)
    2.0
    """
    return then if asked > 0.0 else otherwise
