"""The interface of a fault of recording: looked for, named, and repaired or refused."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, Protocol

import numpy as np

from swimid.inertial.record import Array, Flags, Record


@dataclass(frozen=True)
class Finding:
    """What was found of one fault.

    Attributes
    ----------
    fault : str
        Name of the fault, as in ``docs/imu.md``.
    verdict : str
        "handled": repaired; "noted": left as it is, said.
    text : str
        What was found and what was done, one sentence.
    count : int
        Samples concerned; 0 where it is not a matter of samples.
    """

    fault: str
    verdict: Literal["handled", "noted"]
    text: str
    count: int = 0


class Fault(Protocol):
    """One kind of fault. A module of this folder defines ``NAME`` and ``check``."""

    NAME: str

    def check(self, record: Record) -> tuple[Record, list[Finding]]:
        """The record, repaired where it can be, and what was found.

        Raises
        ------
        InputError
            The fault is there and cannot be repaired.
        """
        ...


def bridged(record: Record, bad_acceleration: Flags, bad_rate: Flags) -> Record:
    """The record with samples interpolated from their neighbours, and marked as filled.

    Parameters
    ----------
    bad_acceleration, bad_rate : ndarray of bool, shape (n, 3)
    """
    return replace(
        record,
        acceleration=_interpolated(record.time_s, record.acceleration, bad_acceleration),
        rate=_interpolated(record.time_s, record.rate, bad_rate),
        filled_acceleration=record.filled_acceleration | bad_acceleration.any(axis=1),
        filled_rate=record.filled_rate | bad_rate.any(axis=1),
    )


def _interpolated(time_s: Array, values: Array, bad: Flags) -> Array:
    if not bad.any():
        return values
    out = values.copy()
    for axis in range(values.shape[1]):
        hole = bad[:, axis]
        if hole.any() and not hole.all():
            out[hole, axis] = np.interp(time_s[hole], time_s[~hole], values[~hole, axis])
    return out


def up_turning(record: Record, half_s: float = 0.15) -> tuple[Array, Array, Array]:
    """How the direction of gravity turns in the sensor, as accelerometer and gyroscope see it.

    Returns
    -------
    seen : ndarray, shape (m, 3)
        Change of the unit vector of specific force over each window, slowly varying parts only.
    up, turned : ndarray, shape (m, 3)
        That vector, and the integral of the turn rate over each window: the change should be
        ``-turned x up``.
    """
    size = max(round(2 * half_s / record.step_s), 1)
    m = len(record) // size
    if m < 8:
        return np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 3))
    block = record.acceleration[: m * size].reshape(m, size, 3).mean(axis=1)
    norm = np.linalg.norm(block, axis=1, keepdims=True)
    up = block / np.maximum(norm, 1e-9)
    turn = np.concatenate([[np.zeros(3)], np.cumsum(record.rate[: m * size], axis=0)]) * record.step_s
    centres = turn[size // 2 : m * size : size][:m]
    # over about a second: long enough that accelerations weigh less than turns
    lag = max(round(0.9 / (2 * half_s)), 1)
    return up[lag:] - up[:-lag], 0.5 * (up[lag:] + up[:-lag]), centres[lag:] - centres[:-lag]
