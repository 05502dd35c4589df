"""Averages of successive rows of a long recording, and statistics of all its rows.

A recording of a high rate is read in batches. :class:`Averager` returns the mean of every N rows, which is a
log of manageable size, and computes the statistics of all rows in the same pass. The mean over N rows also
suppresses frequencies above the new rate, which would otherwise appear as lower frequencies.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from swimid.kinematics.attitude import AXES
from swimid.logs.log import TIME, runs
from swimid.logs.sampling import LONG_ENOUGH, NEAR_ROUNDED, PAUSE, SET, has_levels, rounding_ratio, usual_step
from swimid.logs.units import quantity_of

Array = NDArray[np.float64]
Rows = NDArray[np.int64]
#: Minimum distance of an outlying value of a channel (a code for missing samples, or an error) from all other
#: values, divided by the range of the other values.
FAR = 10.0
#: Criteria for a saturated channel. CUT_SAMPLES is the minimum number of consecutive samples at its largest
#: or smallest value. CUT_TIMES is the minimum number of such sequences.
CUT_SAMPLES, CUT_TIMES = 3, 3


@dataclass
class Extreme:
    """Largest value of a channel that is read in batches, or of the channel with its sign changed.

    Attributes
    ----------
    value, following : float
        Largest and second largest distinct value; -inf if there is none.
    count : int
        Number of samples at the largest value.
    cuts : int
        Number of sequences of at least :data:`CUT_SAMPLES` successive samples at the largest value.
    """

    value: float = -np.inf
    following: float = -np.inf
    count: int = 0
    cuts: int = 0

    def take(self, known: Array) -> None:
        """Add the samples of a batch, shape (n,), without NaN."""
        top = float(known.max())
        self.following = max(self.following, float(np.max(known, where=known < top, initial=-np.inf)))
        if top > self.value:
            self.following = max(self.following, self.value)
            self.value, self.count, self.cuts = top, 0, 0
        elif top < self.value:
            self.following = max(self.following, top)
        if top == self.value:
            lengths = np.diff(runs(known == top)).ravel()
            self.count += int(lengths.sum())
            self.cuts += int(np.count_nonzero(lengths >= CUT_SAMPLES))


@dataclass
class ChannelStatistics:
    """Statistics of all rows of one channel that is read in batches.

    Attributes
    ----------
    samples, missing : int
        Number of rows with a value, and without one.
    mean : float
        Mean value.
    squares : float
        Sum of the squared deviations from the mean.
    longest_hold : int
        Maximum number of successive samples with the same value.
    """

    samples: int = 0
    missing: int = 0
    mean: float = 0.0
    squares: float = 0.0
    longest_hold: int = 0
    largest: Extreme = field(default_factory=Extreme)
    smallest: Extreme = field(default_factory=Extreme)
    _continuous: bool | None = None
    _held: tuple[float, int] = (np.nan, 0)

    @property
    def sd(self) -> float:
        """Standard deviation of the samples."""
        return float(np.sqrt(self.squares / max(self.samples, 1)))

    @property
    def low(self) -> float:
        """Smallest value."""
        return -self.smallest.value

    @property
    def high(self) -> float:
        """Largest value."""
        return self.largest.value

    @property
    def data(self) -> dict[str, float]:
        """Statistics as plain data, by name."""
        names = ("samples", "missing", "mean", "sd", "low", "high", "longest_hold")
        return {name: getattr(self, name) for name in names}

    def take(self, values: Array) -> None:
        """Add the samples of a batch, shape (n,), NaN where missing."""
        known = values[np.isfinite(values)]
        self.missing += len(values) - len(known)
        if not len(known):
            return
        # Combine mean and squares of two sets of samples: Chan, T. F., Golub, G. H., LeVeque, R. J. (1983).
        # Algorithms for computing the sample variance. The American Statistician 37(3), 242-247.
        total, mean = self.samples + len(known), float(known.mean())
        off = mean - self.mean
        self.squares += float(np.sum((known - mean) ** 2)) + off**2 * self.samples * len(known) / total
        self.mean += off * len(known) / total
        self.samples = total
        self.largest.take(known)
        self.smallest.take(-known)
        changes = np.flatnonzero(np.diff(known)) + 1
        lengths = np.diff(np.concatenate(([0], changes, [len(known)])))
        if known[0] == self._held[0]:
            lengths[0] += self._held[1]
        self._held = (float(known[-1]), int(lengths[-1]))
        self.longest_hold = max(self.longest_hold, int(lengths.max()))
        if self._continuous is None and len(known) >= LONG_ENOUGH:
            self._continuous = not has_levels(known) and rounding_ratio(known) <= NEAR_ROUNDED

    def far(self) -> str:
        """Return a message on an extreme value far from all others; an empty text if there is none."""
        for end, other, value in self._ends:
            if end.value - end.following > FAR * (end.following + other.value) > 0:
                return f"holds {value:.6g} in {end.count} samples, far from all others: missing samples?"
        return ""

    def cut(self) -> str:
        """Return a message on the value at which the channel is saturated; empty if it is not saturated."""
        values = [value for end, _, value in self._ends if self._continuous and end.cuts >= CUT_TIMES]
        return f"is cut off at {values[0]:.6g}" if values else ""

    @property
    def _ends(self) -> list[tuple[Extreme, Extreme, float]]:
        """Minimum and maximum of the channel, each with the opposite extreme and its own value."""
        return [(self.smallest, self.largest, self.low), (self.largest, self.smallest, self.high)]


@dataclass
class RowStatistics:
    """Statistics of all rows of a recording whose rows were averaged.

    Attributes
    ----------
    every : int
        Number of rows in one average. An average ends early at a pause and at the end of the recording.
    rows, untimed : int
        Number of all rows, and of rows without a time, which are left out.
    backwards, repeated : int
        Number of rows whose time is before that of the preceding row, and of rows with the time of the
        preceding row.
    pauses : int
        Number of steps longer than ``PAUSE`` median steps.
    shortest_s, longest_s : float
        Shortest and longest time step, s.
    channels : dict of str to Channel
        Statistics of each channel.
    """

    every: int
    rows: int = 0
    untimed: int = 0
    backwards: int = 0
    repeated: int = 0
    pauses: int = 0
    shortest_s: float = np.inf
    longest_s: float = -np.inf
    channels: dict[str, ChannelStatistics] = field(default_factory=dict)

    def faults(self) -> dict[str, str]:
        """Return the measured channels with values that no working sensor gives, with a message for each."""
        names = [n for n in self.channels if not SET.fullmatch(n) and quantity_of(n) is not None]
        found = {name: self.channels[name].far() or self.channels[name].cut() for name in names}
        return {name: text for name, text in found.items() if text}


class Averager:
    """Averages of every N successive rows of a recording that is read in batches.

    Angles (``..._rad``) are averaged across ±180 degrees: within one average they turn by less than half a
    turn. Quaternions are averaged with equal signs, and normalised. A mean is the mean of the known samples,
    and NaN if no sample is known. The result does not depend on the size of the batches.

    Parameters
    ----------
    every : int
        Number of rows in one average.

    Attributes
    ----------
    statistics : RowStatistics
        Statistics of the rows that were taken so far.
    """

    def __init__(self, every: int) -> None:
        self.statistics = RowStatistics(every)
        self._step_s: float | None = None
        self._last_s = np.nan
        self._rest: dict[str, Array] = {}
        self._rest_rows: Rows = np.empty(0, dtype=np.int64)

    def take(
        self, columns: Mapping[str, Array], rows: Rows, *, last: bool = False
    ) -> tuple[dict[str, Array], Rows]:
        """Add a batch of rows; return the averages that are complete, and the number of their first rows.

        Parameters
        ----------
        columns : mapping of str to ndarray, each shape (n,)
            Columns of the batch, ``t_s`` among them, NaN where missing.
        rows : ndarray of int, shape (n,)
            Numbers of the rows in the file.
        last : bool
            Whether no further batch follows, so that the last average is complete.
        """
        timed = np.isfinite(columns[TIME])
        self._count(columns, timed)
        kept = {name: values[timed] for name, values in columns.items()}
        if self._rest:
            kept = {name: np.concatenate((self._rest[name], values)) for name, values in kept.items()}
        rows = np.concatenate((self._rest_rows, rows[timed]))
        starts = self._starts(kept[TIME])
        size = len(rows)
        if len(starts) and not last and size - starts[-1] < self.statistics.every:
            size, starts = int(starts[-1]), starts[:-1]
        self._rest = {name: values[size:] for name, values in kept.items()}
        self._rest_rows = rows[size:]
        whole = {name: values[:size] for name, values in kept.items()}
        return _means(whole, starts), rows[starts]

    def _count(self, columns: Mapping[str, Array], timed: NDArray[np.bool_]) -> None:
        """Add the rows of a batch to the statistics."""
        time_s = columns[TIME][timed]
        if self._step_s is None and len(time_s) > 1:
            self._step_s = usual_step(time_s)
        statistics = self.statistics
        statistics.rows += len(timed)
        statistics.untimed += len(timed) - len(time_s)
        steps = np.diff(np.concatenate(([self._last_s], time_s)))
        steps = steps[np.isfinite(steps)]
        if len(steps):
            statistics.backwards += int(np.count_nonzero(steps < 0))
            statistics.repeated += int(np.count_nonzero(steps == 0))
            statistics.pauses += int(np.count_nonzero(steps > PAUSE * (self._step_s or np.inf)))
            statistics.shortest_s = min(statistics.shortest_s, float(steps.min()))
            statistics.longest_s = max(statistics.longest_s, float(steps.max()))
        if len(time_s):
            self._last_s = float(time_s[-1])
        for name, values in columns.items():
            if name != TIME:
                statistics.channels.setdefault(name, ChannelStatistics()).take(values)

    def _starts(self, time_s: Array) -> NDArray[np.intp]:
        """Return the index of the first row of each average. A pause in the time stamps ends an average."""
        row = np.arange(len(time_s))
        begins = np.zeros(len(time_s), dtype=bool)
        begins[:1] = True
        begins[1:] = np.abs(np.diff(time_s)) > PAUSE * (self._step_s or np.inf)
        piece = np.maximum.accumulate(np.where(begins, row, 0))
        return np.flatnonzero((row - piece) % self.statistics.every == 0)


def _means(columns: Mapping[str, Array], starts: NDArray[np.intp]) -> dict[str, Array]:
    """Return the mean of each block of rows, in each column. A block ends where the next one starts."""
    if not len(starts):
        return {name: values[:0] for name, values in columns.items()}
    lengths = np.diff(np.append(starts, len(columns[TIME])))
    columns = dict(columns)
    has_attitude = set(AXES) <= set(columns)
    if has_attitude:
        q = np.array([columns[axis] for axis in AXES])
        opposite = np.sum(q * np.repeat(q[:, starts], lengths, axis=1), axis=0) < 0
        columns |= dict(zip(AXES, np.where(opposite, -q, q), strict=True))
    means = {name: _mean(name, values, starts, lengths) for name, values in columns.items()}
    if has_attitude:
        norm = np.linalg.norm([means[axis] for axis in AXES], axis=0)
        means |= {axis: means[axis] / np.where(norm > 0, norm, np.nan) for axis in AXES}
    return means


def _mean(name: str, values: Array, starts: NDArray[np.intp], lengths: NDArray[np.intp]) -> Array:
    """Return the mean of the known samples of a column in each block of rows; NaN without a known sample."""
    # Average the deviations from the smallest sample of the block, so that large time stamps lose no digits.
    least = np.fmin.reduceat(values, starts)
    off = values - np.repeat(least, lengths)
    if name.endswith("_rad"):
        off -= 2 * np.pi * np.round(off / (2 * np.pi))
    known = np.isfinite(off)
    count = np.add.reduceat(known.astype(np.intp), starts)
    total = np.add.reduceat(np.where(known, off, 0.0), starts)
    return np.asarray(least + total / np.maximum(count, 1))
