"""What the engines and their traced form share: the choice by sign, and when a run has broken down."""

from __future__ import annotations

import numba

#: A state farther out than this has broken down.
BROKEN = 1e6


@numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")
def positive(asked, then, otherwise):  # type: ignore[no-untyped-def]
    """``then`` where ``asked`` is above 0, else ``otherwise`` (also where it is NaN); both have a value.

    >>> positive(1.0, 2.0, 3.0)
    2.0
    """
    return then if asked > 0.0 else otherwise
