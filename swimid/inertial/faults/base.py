"""What faults of recording share: what is said of one, and how samples are bridged."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from swimid.inertial.record import Array, Flags, Record

#: Turns of gravity are seen between means over this long, s, so many of them apart: about a second, long
#: enough that accelerations weigh less than turns.
BLOCK_S, BLOCKS = 0.3, 3


@dataclass(frozen=True)
class Finding:
    """What was found of one fault."""

    #: Name of the fault, as in ``docs/imu.md``.
    fault: str
    #: "handled": repaired, or a doubt; "noted": left as it is, said; "refuted": a column is wrong.
    verdict: Literal["handled", "noted", "refuted"]
    #: What was found and what was done, one sentence.
    text: str
    #: Samples concerned; 0 where it is not a matter of samples.
    count: int = 0


def bridged(record: Record, bad: Flags) -> Record:
    """The record with samples, shape (n, 6), interpolated from their neighbours, and marked as filled."""
    values = record.channels
    for column, hole in zip(values.T, bad.T, strict=True):
        if hole.any() and not hole.all():
            column[hole] = np.interp(record.time_s[hole], record.time_s[~hole], column[~hole])
    acceleration, rate = (half.any(axis=1) for half in np.hsplit(bad, 2))
    return replace(
        record.with_channels(values),
        filled_acceleration=record.filled_acceleration | acceleration,
        filled_rate=record.filled_rate | rate,
    )


def up_turning(record: Record) -> tuple[Array, Array, Array]:
    """How the direction of gravity turns in the sensor, as accelerometer and gyroscope see it.

    Returns
    -------
    seen : ndarray, shape (m, 3)
        Change of the unit vector of specific force over each window, slowly varying parts only.
    up, turned : ndarray, shape (m, 3)
        That vector, and the integral of the turn rate over each window: the change should be
        ``-turned x up``.
    """
    size = max(round(BLOCK_S / record.step_s), 1)
    m = len(record) // size
    if m < 8:
        return (np.zeros((0, 3)),) * 3
    block = record.acceleration[: m * size].reshape(m, size, 3).mean(axis=1)
    up = block / np.maximum(np.linalg.norm(block, axis=1, keepdims=True), 1e-9)
    turn = np.concatenate([[np.zeros(3)], np.cumsum(record.rate[: m * size], axis=0)]) * record.step_s
    centres = turn[size // 2 : m * size : size][:m]
    before, after = slice(-BLOCKS), slice(BLOCKS, None)
    return up[after] - up[before], 0.5 * (up[after] + up[before]), centres[after] - centres[before]
