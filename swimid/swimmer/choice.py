"""What the engines and their traced form share: choice by sign, headings, and when a run has broken down."""

from __future__ import annotations

import math

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


@numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")
def facing(frame, base, turn):  # type: ignore[no-untyped-def]
    """Heading of a link in the world, rad, without jumps.

    Parameters
    ----------
    frame : (heading in rad, its cosine, its sine)
        Of the run's axes in the world.
    base : (heading in rad, its cosine, its sine)
        Of the base in the run's axes.
    turn : (cosine, sine)
        Of the link in the run's axes.
    """
    across = turn[1] * base[1] - turn[0] * base[2]
    return frame[0] + base[0] + math.atan2(across, turn[0] * base[1] + turn[1] * base[2])
