"""Time stamps that repeat, go back, or are missing."""

from __future__ import annotations

from swimid.errors import InputError
from swimid.inertial.faults.base import Finding
from swimid.inertial.record import CHANNELS, Record
from swimid.logs.time_order import in_order

NAME = "repeated stamps"
#: More rows without a usable time than this share: the clock cannot be trusted.
MOST = 0.5


def check(record: Record) -> tuple[Record, list[Finding]]:
    """Keep the first of each repeated stamp, put late rows in place; refuse a clock that was reset."""
    order = in_order(record.time_s, dict(zip(CHANNELS, record.channels.T, strict=True)))
    if order.reset_row is not None:
        row = order.reset_row
        raise InputError(
            f"time goes back at t = {record.time_s[row]:g} s (sample {row + 1}) and counts on from there",
            file=record.name,
            column="t_s",
            hint="was the clock reset or wrapped? cut the log there, one file for each piece",
        )
    gone = order.untimed + order.repeated + order.clashing
    if gone > MOST * len(record):
        raise InputError(
            f"{gone} of {len(record)} samples have no time of their own",
            file=record.name,
            column="t_s",
            hint="the stamps are too coarse: give the time with more decimals, or by 'rate_hz' in a mapping",
        )
    if not order.changed:
        return record, []
    parts = [
        (order.untimed, "without a time left out"),
        (order.repeated, "repeated under one stamp left out"),
        (order.clashing, "at a time already taken left out"),
        (order.late, "out of order put in place"),
    ]
    text = "; ".join(f"{count} samples {what}" for count, what in parts if count)
    return record.take(order.index), [Finding(NAME, "handled", text, gone + order.late)]
