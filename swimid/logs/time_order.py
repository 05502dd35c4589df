"""Sample times made strictly increasing: what repeats, comes late or is missing."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from swimid.logs.log import TIME, longest_run

Array = NDArray[np.float64]
#: Of more samples than this share that come late, or of more in a row, the clock was reset.
LATE_SHARE, LATE_RUN = 0.01, 20
#: What is done to rows that are not in order.
ODD_ROWS = {
    "untimed": "without a time left out",
    "repeated": "repeated left out",
    "clashing": "with the time of the row before but other values left out",
    "late": "that came late put in their place",
}


@dataclass(frozen=True)
class Order:
    """What was done to the rows of a record.

    Attributes
    ----------
    index : ndarray of int, shape (m,)
        The rows that stay, in the order of their times.
    untimed : int
        Rows without a time, left out.
    repeated : int
        Rows that say the same as another row at the same time, left out.
    clashing : int
        Rows that say something else at a time that is taken already, left out.
    late : int
        Rows that came after later ones and were put in their place.
    reset_row : int or None
        Row at which the clock starts again: nothing puts such a record in order.
    """

    index: NDArray[np.int64]
    untimed: int = 0
    repeated: int = 0
    clashing: int = 0
    late: int = 0
    reset_row: int | None = None

    @property
    def counts(self) -> dict[str, int]:
        """How many rows were out of order, by what was wrong with them."""
        return {name: getattr(self, name) for name in ODD_ROWS}

    @property
    def changed(self) -> bool:
        """Whether the record was not in order."""
        return any(self.counts.values())

    @property
    def summary(self) -> str:
        """What was done to how many rows, in words."""
        return "; ".join(f"{count} {ODD_ROWS[name]}" for name, count in self.counts.items() if count)


def in_order(time_s: Array, columns: Mapping[str, Array]) -> Order:
    """Rows of a record with strictly increasing times.

    Parameters
    ----------
    time_s : ndarray, shape (n,)
        May be NaN, repeat, or go back.
    columns : mapping of str to ndarray, each shape (n,)
        The other columns, to tell a repeated row from a clashing one.

    Notes
    -----
    Single rows that come late (packets on a network) are put where their time says. A clock that
    goes back and counts on from there was reset; which of its times are right cannot be told.
    """
    import pandas as pd

    index = np.flatnonzero(np.isfinite(time_s))
    times, untimed = time_s[index], len(time_s) - len(index)
    if np.all(np.diff(times) > 0):
        return Order(index, untimed)
    behind = times < np.maximum.accumulate(times)
    late = int(behind.sum())
    if late > max(1, LATE_SHARE * len(times)) or longest_run(behind) > LATE_RUN:
        return Order(index, untimed, late=late, reset_row=int(index[np.argmax(behind)]))
    rows = pd.DataFrame({**columns, TIME: time_s}).iloc[index].sort_values(TIME, kind="stable")
    again, repeated = rows.duplicated(TIME), int(rows.duplicated().sum())
    return Order(rows.index[~again].to_numpy(), untimed, repeated, int(again.sum()) - repeated, late)
