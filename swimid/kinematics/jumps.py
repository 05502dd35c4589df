"""Repeated samples, jumps and gaps of a track. Gaps are never filled."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from swimid.logs.log import runs
from swimid.logs.sampling import FALSE_ALARM_REPEATS, PAUSE, Held, find_held, pauses, quantum

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]


#: Number of steps in two running medians over a track: that of the expected velocity (WINDOW), and that of
#: the usual deviation from this velocity (WIDE).
WINDOW, WIDE = 11, 41
#: Minimum deviation of an outlying step of a track (displacement between two samples) from its expected
#: value, in median deviations. For Gaussian noise in a plane, six median deviations are seven standard
#: deviations.
OUTLYING = 6.0
#: Minimum speed of an outlying step of a track, divided by the speed of the fastest part of the track
#: (FASTER). ALIKE is the number of steps in the running median that gives the latter speed. A robot can be
#: fast for several steps, but a tracking error with return has only two fast steps.
FASTER, ALIKE = 2.0, 5
#: Minimum number of samples (FEW), and minimum fraction of the samples of a track (FEW_SHARE), in a segment
#: that continues the track at another place after a jump. A shorter segment is taken for a tracking error,
#: after which the track returns.
FEW, FEW_SHARE = 12, 0.05
#: Maximum number of successive samples in a spike of a quantity other than a pose. If spikes are so frequent
#: that they are adjacent by chance, the maximum is the length of runs whose expected number is MIN_RUNS.
SPIKE, MIN_RUNS = 2, 0.1


@dataclass(frozen=True)
class Cleaning:
    """Repeated samples, jumps and gaps that were found in a track.

    Attributes
    ----------
    good : ndarray of bool, shape (n,)
        Whether each sample is a measured position of the robot.
    repeated : ndarray of bool, shape (n,)
        Whether each sample repeats all columns of the pose, except for jitter, because the camera had no new
        picture.
    jumped : ndarray of bool, shape (n,)
        Whether each sample lies away from the track, which continues before and after the sample.
    jumps : int
        Number of jumps: those with return, and those after which the track continues at another place.
    offset_rows : list of int
        Row numbers at which the track continues at another place.
    gaps : list of (float, float)
        Start and end of the gaps between good samples, s.
    held : Held
        Repeated samples, with the measurement times of the pictures.
    """

    good: Flags
    repeated: Flags
    jumped: Flags
    jumps: int
    offset_rows: list[int]
    gaps: list[tuple[float, float]]
    held: Held

    @property
    def counts(self) -> dict[str, int]:
        """Number of repeated samples, number of jumps, and number of samples in jumps of a track, by name."""
        lost = int(self.jumped.sum())
        return {"repeats": int(self.repeated.sum()), "jumps": self.jumps, "samples_jumped": lost}


def clean_track(time_s: Array, positions: list[Array], others: list[Array] | None = None) -> Cleaning:
    """Find the repeated samples, jumps and gaps of a track.

    Parameters
    ----------
    time_s : ndarray, shape (n,)
        Strictly increasing, s.
    positions : list of ndarray, each shape (n,)
        Coordinates, m; NaN where missing.
    others : list of ndarray, optional
        Other columns from the same camera picture (angles). In a repeated sample they repeat as well.

    Notes
    -----
    A step is outlying if it meets two conditions. First, it differs from the running median velocity by more
    than :data:`OUTLYING` times the larger of the local and the global median deviation (Hampel's identifier,
    applied to the steps with their durations). Second, it is more than :data:`FASTER` times as fast as the
    fastest part of the track (the 99th percentile of the running median over :data:`ALIKE` steps), and as the
    steps around it (their running median). Outlying steps cut the track into pieces. The accepted track is
    the sequence of pieces with the largest number of samples minus a cost for each piece that does not
    continue the previous piece.

    References
    ----------
    Pearson, R. K., Neuvo, Y., Astola, J., Gabbouj, M. (2016). Generalized Hampel filters. EURASIP
    Journal on Advances in Signal Processing 2016:87. doi:10.1186/s13634-016-0383-6
    """
    place = np.column_stack(positions)
    known: Flags = np.asarray(np.isfinite(place).all(axis=1))
    held = find_held(time_s, [*positions, *(others or [])])
    repeated = held.repeated & known
    rows = np.flatnonzero(known & ~repeated)
    jumped = np.zeros(len(time_s), dtype=bool)
    offsets: list[int] = []
    jumps = 0
    if len(rows) > WINDOW:
        stays, elsewhere = find_jumps(time_s[rows], place[rows])
        jumped[rows[~stays]] = True
        offsets = [int(rows[k]) for k in elsewhere]
        jumps = len(runs(~stays)) + len(offsets)
    good = known & ~repeated & ~jumped
    times = time_s[good]
    gaps = [(float(times[k]), float(times[k + 1])) for k in pauses(times)]
    return Cleaning(good, repeated, jumped, jumps, offsets, gaps, held)


def find_jumps(
    time: Array, place: Array, until: Array | None = None, *, brief: bool = False, least_rate: float = 0.0
) -> tuple[Flags, list[int]]:
    """Find the jumps of a channel by the rules given in :func:`clean`.

    Parameters
    ----------
    time : ndarray, shape (n,)
        Strictly increasing, s.
    place : ndarray, shape (n, d)
            Samples of d coordinates without NaN: positions, or any quantity whose differences have a meaning.
    until : ndarray, shape (n,), optional
        Time until which each sample was repeated, s. By default no sample is repeated.
    brief : bool
        Whether only excursions of about :data:`SPIKE` samples count, after which the channel continues as
        before. Any other quantity than a pose may change in one step.
    least_rate : float
        Minimum rate of an outlying step, in units of ``place`` per s.

    Returns
    -------
    stays : ndarray of bool, shape (n,)
        Whether each sample lies on the track.
    elsewhere : list of int
        Indices of the samples at which the track continues at another place.
    """
    if until is None:
        until = time
    outlying, strength, fastest, scale = _find_outlying_steps(time, place, until, brief, least_rate)
    if not outlying.any():
        return np.ones(len(time), dtype=bool), []
    starts = np.concatenate(([0], np.flatnonzero(outlying) + 1))
    ends = np.concatenate((starts[1:], [len(time)]))

    def goes_on(one: int, other: int) -> bool:
        a, b = ends[one] - 1, starts[other]
        away = float(np.linalg.norm(place[b] - place[a]))
        return away <= FASTER * fastest * (time[b] - until[a]) + OUTLYING * scale

    cost = max(FEW, FEW_SHARE * len(time))
    if brief:
        cost = SPIKE
    chain = _chain(ends - starts, goes_on, cost)
    stays = np.zeros(len(time), dtype=bool)
    for piece in chain:
        stays[starts[piece] : ends[piece]] = True
    elsewhere = [int(starts[b]) for a, b in pairwise(chain) if not goes_on(a, b)]
    if not brief:
        return stays, elsewhere
    back = [(ends[a], starts[b]) for a, b in pairwise(chain) if goes_on(a, b) and b > a + 1]
    stays[:] = True
    usual = max(float(np.percentile(strength[~outlying], 99)), OUTLYING)
    for first, end in _spikes(np.array(back, dtype=int).reshape(-1, 2), strength, usual):
        stays[first:end] = False
    return stays, []


def _find_outlying_steps(
    time: Array, place: Array, until: Array, brief: bool, least_rate: float
) -> tuple[Flags, Array, float, float]:
    """Return whether each step of a channel is outlying, and three sizes of steps.

    The sizes are the deviation of each step relative to its neighbours, the usual maximum of the rate of the
    channel, and the usual deviation of a step.
    """
    from scipy import ndimage

    steps_s, steps = time[1:] - until[:-1], np.diff(place, axis=0)
    usual_s = float(np.median(steps_s))
    velocity = steps / steps_s[:, None]
    # Reflect the steps at the ends of the record, because copies of the last step would hide a jump there.
    expected = ndimage.median_filter(velocity, size=(WINDOW, 1), mode="reflect")
    off = np.linalg.norm(steps - expected * steps_s[:, None], axis=1)
    length = np.linalg.norm(steps, axis=1)
    units = [unit for column in place.T if (unit := quantum(column)) <= np.ptp(column)]
    least = max(*units, 0.05 * float(np.median(length)), 0.0)
    scale = max(float(np.median(off)), least)
    local = np.maximum(ndimage.median_filter(off, size=min(WIDE, len(off)), mode="reflect"), scale)
    alike = np.linalg.norm(expected, axis=1)
    if not brief:
        alike = np.linalg.norm(ndimage.median_filter(velocity, size=(ALIKE, 1), mode="reflect"), axis=1)
    fastest = max(float(np.percentile(alike, 99)), least_rate / FASTER)
    longer = np.maximum(steps_s / usual_s, 1.0)
    limit = OUTLYING * local * np.minimum(longer, PAUSE)
    outlying = (off > limit) & (length > FASTER * np.maximum(alike, fastest) * steps_s + OUTLYING * scale)
    return outlying, off / local, fastest, scale


def _spikes(back: NDArray[np.int64], strength: Array, usual: float) -> NDArray[np.int64]:
    """Return those excursions of a channel that are spikes: short, and larger than noise explains.

    ``back`` holds the first index and the last index + 1 of each excursion. ``strength`` is the relative size
    of each step of the channel, shape (n - 1,), and ``usual`` that of a large step that is not outlying.

    Notes
    -----
    If the tail of the noise is that of a Pareto distribution with the index 2, the logarithms of the ratios
    of ``k`` values above a threshold to this threshold have a sum with a Gamma distribution of the shape
    ``k`` and the scale 1/2 (Hill 1975, Ann. Statist. 3, 1163). Noise with a heavier tail has no finite
    variance. The excursions are spikes if the probability of their sum is below :data:`FALSE_ALARM_REPEATS`.
    """
    from scipy.special import gammaincc

    lengths, n = np.diff(back)[:, 0], len(strength) + 1
    most, share = float(SPIKE), lengths[lengths <= SPIKE].sum() / n
    if share > 0.0:
        # Adjacent spikes look like one longer excursion. Accept excursions of a length that adjacent spikes
        # reach by chance: the expected number of runs of L samples is n times the L-th power of the share of
        # spikes.
        most = max(most, np.ceil(np.log(MIN_RUNS / n) / np.log(share)))
    excess = np.log(np.minimum(strength[back[:, 0] - 1], strength[back[:, 1] - 1]) / usual)
    # Leave out excursions beside longer excursions: together they are one motion, such as an impact.
    long = np.zeros(n, dtype=bool)
    for first, end in back[lengths > most]:
        long[max(first - WINDOW, 0) : end + WINDOW] = True
    short = (lengths <= most) & (excess > 0.0) & ~long[back[:, 0]]
    if not short.any() or gammaincc(short.sum(), 2.0 * excess[short].sum()) >= FALSE_ALARM_REPEATS:
        return back[:0]
    return back[short]


def _chain(sizes: NDArray[np.int64], goes_on: Callable[[int, int], bool], cost: float) -> list[int]:
    """Return the sequence of track pieces with the most samples, minus ``cost`` for each interruption.

    ``sizes`` holds the number of samples of each piece. ``goes_on(one, other)`` says whether a piece
    continues another one without an interruption.
    """
    best = np.zeros(len(sizes))
    link = np.full(len(sizes), -1)
    for k, size in enumerate(sizes):
        best[k] = size
        for j in range(max(0, k - 100), k):
            gained = best[j] + size
            if gained > best[k] and not goes_on(j, k):
                gained -= cost
            if gained > best[k]:
                best[k], link[k] = gained, j
    chain = [int(np.argmax(best))]
    while link[chain[-1]] >= 0:
        chain.append(int(link[chain[-1]]))
    return chain[::-1]
