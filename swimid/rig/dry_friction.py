"""When a body that dry friction holds gets loose."""

from __future__ import annotations

import numba

#: Stops and breakaways within one integration step, at most.
MOST_EVENTS = 8


@numba.njit(cache=True, nogil=True)
def breakaway(push, slope, dry, left):  # type: ignore[no-untyped-def]
    """When a body at rest gets loose of its dry friction, and to which side.

    Parameters
    ----------
    push : float
        Net force on it now, friction apart.
    slope : float
        Rate at which that changes.
    dry : float
        Largest force that friction withstands.
    left : float, s
        How far to look.

    Returns
    -------
    after : float, s
        ``left`` where it stays.
    side : float
        1 or -1; 0 where it stays.

    >>> breakaway(0.5, 2.0, 1.0, 1.0)
    (0.25, 1.0)
    """
    if abs(push) > dry:
        return 0.0, (1.0 if push > 0 else -1.0)
    if slope == 0.0:
        return left, 0.0
    side = 1.0 if slope > 0 else -1.0
    after = (side * dry - push) / slope
    return (after, side) if after < left else (left, 0.0)
