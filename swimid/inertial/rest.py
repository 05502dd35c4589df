"""Stretches in which the sensor is still, and what they tell of its noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from swimid.errors import InputError
from swimid.inertial.record import Array, Flags, Record
from swimid.logs.log import runs

#: Length over which motion is judged, s, and the shortest rest, s.
WINDOW_S, SHORTEST_S = 0.5, 1.0
#: The quietest share of a record that serves as its noise.
QUIET_SHARE = 0.05
#: A window is still when it is no louder than this many times the quietest ones.
LOUDER = 2.0
#: Least motion that is motion, however silent the sensor: m/s^2 and rad/s.
LEAST_ACCELERATION, LEAST_RATE = 0.03, 0.01
#: No sensor at rest is as loud as this: m/s^2 and rad/s.
LOUDEST_ACCELERATION, LOUDEST_RATE = 0.25, 0.05
#: No gyroscope at rest shows more than this on average: 20 deg/s on each axis (InvenSense MPU-6050), rad/s.
LARGEST_RATE = 20 * np.sqrt(3) * np.pi / 180


@dataclass(frozen=True)
class Rest:
    """One still stretch, rows ``first`` to ``last`` (not included); ``at`` is "start", "end" or "between"."""

    first: int
    last: int
    at: str

    @property
    def rows(self) -> slice:
        """Its rows."""
        return slice(self.first, self.last)


def find(record: Record) -> list[Rest]:
    """Still stretches of a record.

    A window is still when the deviation of accelerations and rates, and the mean rate against its own
    quietest windows, are those of the quietest 5 % of the record, and these are quiet at all.

    Notes
    -----
    The detector of Skog et al. (2010, doi:10.1109/TBME.2010.2060723, SHOE) with its threshold taken
    from the record. A body that glides without turning looks still to any inertial sensor.
    """
    size = max(round(WINDOW_S / record.step_s), 4)
    if len(record) < 3 * size:
        return []
    loud_a, loud_w = _loudness(record.acceleration, size), _loudness(record.rate, size)
    mean_w = _moving_mean(record.rate, size)
    floor_a = max(float(np.quantile(loud_a, QUIET_SHARE)), 1e-9)
    floor_w = max(float(np.quantile(loud_w, QUIET_SHARE)), 1e-9)
    if floor_a > LOUDEST_ACCELERATION or floor_w > LOUDEST_RATE:
        return []
    quiet = (loud_a <= max(LOUDER * floor_a, LEAST_ACCELERATION)) & (
        loud_w <= max(LOUDER * floor_w, LEAST_RATE)
    )
    if not quiet.any():
        return []
    usual = np.median(mean_w[quiet], axis=0)
    still = quiet & (np.linalg.norm(mean_w - usual, axis=1) <= max(LOUDER * floor_w, LEAST_RATE))
    return _stretches(still, record, size)


def mean_accelerations(record: Record, rests: list[Rest]) -> Array:
    """Of every still stretch, shape (stretches, 3); of everything where there are none."""
    parts = [record.acceleration[r.rows] for r in rests] or [record.acceleration]
    return np.array([part.mean(axis=0) for part in parts])


def declared(record: Record, windows: Sequence[tuple[float, float]]) -> list[Rest]:
    """The stretches a user named by their times, s.

    Raises
    ------
    InputError
        The sensor turns in one of them as no gyroscope at rest shows it.
    """
    found = []
    for start, end in windows:
        first, last = np.searchsorted(record.time_s, [start, end])
        if last - first >= 4:
            turning = float(np.mean(np.linalg.norm(record.rate[first:last], axis=1)))
            if turning > LARGEST_RATE:
                raise InputError(
                    f"turns at {turning:.1f} rad/s from {start:g} to {end:g} s, which is named as a rest",
                    file=record.name,
                    hint="name a stretch in which the robot rests, or leave --still out",
                )
            found.append(Rest(int(first), int(last), _place(int(first), int(last), len(record))))
    return found


@dataclass(frozen=True)
class Noise:
    """White noise of the sensor."""

    #: Density, m/s^2/sqrt(Hz).
    acceleration: float
    #: Density, rad/s/sqrt(Hz).
    rate: float
    #: "still periods", "given" or "data sheet".
    source: str


def noise(record: Record, rests: list[Rest]) -> Noise | None:
    """White noise densities from still stretches, the quietest axes counting as much as the loudest."""
    if not rests:
        return None
    parts_a = np.vstack([np.diff(record.acceleration[r.rows], axis=0) for r in rests])
    parts_w = np.vstack([np.diff(record.rate[r.rows], axis=0) for r in rests])
    scale = np.sqrt(record.step_s / 2)
    return Noise(
        scale * float(np.sqrt(np.mean(parts_a**2))),
        scale * float(np.sqrt(np.mean(parts_w**2))),
        "still periods",
    )


def _moving_mean(values: Array, size: int) -> Array:
    from scipy.ndimage import uniform_filter1d

    return np.asarray(uniform_filter1d(values, size, axis=0, mode="nearest"))


def _loudness(values: Array, size: int) -> Array:
    """Deviation within a window about each sample, all axes together, shape (n,)."""
    centred = values - values.mean(axis=0)
    spread = _moving_mean(centred**2, size) - _moving_mean(centred, size) ** 2
    return np.sqrt(np.maximum(spread.sum(axis=1), 0.0))


def _stretches(still: Flags, record: Record, size: int) -> list[Rest]:
    found = []
    for first, last in runs(still).tolist():
        # a window reaches beyond its middle: its outer halves may already move
        inner_first = first if first == 0 else first + size // 2
        inner_last = last if last == len(still) else last - size // 2
        if inner_last - inner_first < 4:
            continue
        if record.time_s[inner_last - 1] - record.time_s[inner_first] >= SHORTEST_S:
            found.append(Rest(inner_first, inner_last, _place(inner_first, inner_last, len(still))))
    return found


def _place(first: int, last: int, n: int) -> str:
    edge = 0.02 * n
    return "start" if first <= edge else "end" if last >= n - edge else "between"
