"""Stretches in which the sensor is still, and what they tell of its noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import uniform_filter1d

from swimid.errors import InputError
from swimid.inertial.record import Array, Record
from swimid.logs.log import runs

#: Length over which motion is judged, s, and the shortest rest, s.
WINDOW_S, SHORTEST_S = 0.5, 1.0
#: The share of a record with the least deviations, which serves as its noise.
NOISE_SHARE = 0.05
#: A window is still when its deviations are at most this many times those.
NOISE_RATIO = 2.0
#: Least motion that is motion, however small the sensor's noise: m/s^2 and rad/s.
LEAST_ACCELERATION, LEAST_RATE = 0.03, 0.01
#: No sensor at rest deviates by more: m/s^2 and rad/s.
MOST_ACCELERATION, MOST_RATE = 0.25, 0.05
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

    A window is still when the deviation of accelerations and rates, and the mean rate against that of such
    windows, are within those of the least moving 5 % of the record, and these are no motion.

    Notes
    -----
    The detector of Skog et al. (2010, doi:10.1109/TBME.2010.2060723, SHOE) with its threshold taken
    from the record. A body that glides without turning looks still to any inertial sensor.
    """
    size = max(round(WINDOW_S / record.step_s), 4)
    if len(record) < 3 * size:
        return []
    deviation_a, deviation_w = _deviation(record.acceleration, size), _deviation(record.rate, size)
    floor_a, floor_w = (max(float(np.quantile(d, NOISE_SHARE)), 1e-9) for d in (deviation_a, deviation_w))
    if floor_a > MOST_ACCELERATION or floor_w > MOST_RATE:
        return []
    limit_a, limit_w = max(NOISE_RATIO * floor_a, LEAST_ACCELERATION), max(NOISE_RATIO * floor_w, LEAST_RATE)
    steady = (deviation_a <= limit_a) & (deviation_w <= limit_w)
    if not steady.any():
        return []
    mean_w = _moving_mean(record.rate, size)
    off = np.linalg.norm(mean_w - np.median(mean_w[steady], axis=0), axis=1)
    rests = []
    for first, last in runs(steady & (off <= limit_w)).tolist():
        # a window reaches beyond its middle: its outer halves may already move
        begin = first if first == 0 else first + size // 2
        end = last if last == len(record) else last - size // 2
        if end - begin >= 4 and record.time_s[end - 1] - record.time_s[begin] >= SHORTEST_S:
            rests.append(_rest(record, begin, end))
    return rests


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
    rests = []
    for start, end in windows:
        first, last = (int(row) for row in np.searchsorted(record.time_s, [start, end]))
        if last - first < 4:
            continue
        turning = float(np.mean(np.linalg.norm(record.rate[first:last], axis=1)))
        if turning > LARGEST_RATE:
            raise InputError(
                f"turns at {turning:.1f} rad/s from {start:g} to {end:g} s, which is named as a rest",
                file=record.name,
                hint="name a stretch in which the robot rests, or leave --still out",
            )
        rests.append(_rest(record, first, last))
    return rests


def _rest(record: Record, first: int, last: int) -> Rest:
    edge = 0.02 * len(record)
    return Rest(first, last, "start" if first <= edge else "end" if last >= len(record) - edge else "between")


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
    """White noise densities from still stretches, all axes together."""
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
    return np.asarray(uniform_filter1d(values, size, axis=0, mode="nearest"))


def _deviation(values: Array, size: int) -> Array:
    """Deviation within a window about each sample, all axes together, shape (n,)."""
    centred = values - values.mean(axis=0)
    spread = _moving_mean(centred**2, size) - _moving_mean(centred, size) ** 2
    return np.sqrt(np.maximum(spread.sum(axis=1), 0.0))
