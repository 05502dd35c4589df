"""Tracks of a polled camera: repeated samples, jumps and gaps found, none of them filled."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from swimid.logs.held import Held, find_held
from swimid.logs.log import runs
from swimid.logs.sampling import PAUSE, pauses, quantum

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

#: Steps whose median is the expected velocity, and whose scatter is the local scale.
WINDOW, WIDE = 11, 41
#: A step this many times the median deviation off the expected one is not of the same motion: for
#: Gaussian noise in a plane seven standard deviations.
OUTLYING = 6.0
#: ... unless somewhere most of so many steps on end are half as fast, and alike: a burst of the
#: robot's own, which a jump out and back is not.
FASTER, ALIKE = 2.0, 5
#: A place of which fewer samples tell than this (or than the share of all) is a jump there and back,
#: not a track that goes on elsewhere.
FEW, FEW_SHARE = 12, 0.05


@dataclass(frozen=True)
class Cleaning:
    """What was found in a track.

    Attributes
    ----------
    good : ndarray of bool, shape (n,)
        Samples that tell where the robot was.
    repeated : ndarray of bool, shape (n,)
        The same in every pose column as the sample before, but for jitter: the camera had no new picture.
    jumped : ndarray of bool, shape (n,)
        Away from the track that goes on before and after.
    jumps : int
        How often the track was away, and how often it went on elsewhere.
    offset_rows : list of int
        Rows where it goes on elsewhere for good.
    gaps : list of (float, float)
        Start and end of the stretches without a good sample, s.
    held : Held or None
        Repeats with the times of the pictures; None where nobody looked for them.
    """

    good: Flags
    repeated: Flags
    jumped: Flags
    jumps: int
    offset_rows: list[int]
    gaps: list[tuple[float, float]]
    held: Held | None = None

    @property
    def counts(self) -> dict[str, int]:
        """Numbers of repeats, jumps and samples that jumped."""
        repeats, lost = int(self.repeated.sum()), int(self.jumped.sum())
        return {"repeats": repeats, "jumps": self.jumps, "samples_jumped": lost}

    @property
    def longest_gap_s(self) -> float:
        """The longest gap, s; 0 without one."""
        return max((end - start for start, end in self.gaps), default=0.0)


def clean(time_s: Array, positions: list[Array], others: list[Array] | None = None) -> Cleaning:
    """Find the repeats, jumps and gaps of a track.

    Parameters
    ----------
    time_s : ndarray, shape (n,)
        Strictly increasing, s.
    positions : list of ndarray, each shape (n,)
        Its coordinates, m; NaN where missing.
    others : list of ndarray, optional
        Further columns of the same picture (angles): a repeat repeats them too.

    Notes
    -----
    A step is outlying when it differs from the running median velocity (Hampel's identifier on the
    steps, each by its own duration) by more than :data:`OUTLYING` times the larger of the local and
    the global median deviation, and is more than :data:`FASTER` times as fast as the track is in its
    fastest moments (the 99th percentile of the running median of :data:`ALIKE` steps). Outlying steps
    cut the track into pieces; the chain of pieces that keeps most samples, and pays for every piece
    that does not continue the one before, is the track.

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
        stays, elsewhere = _jumps(time_s[rows], place[rows])
        jumped[rows[~stays]] = True
        offsets = [int(rows[k]) for k in elsewhere]
        jumps = len(runs(~stays)) + len(offsets)
    good = known & ~repeated & ~jumped
    return Cleaning(good, repeated, jumped, jumps, offsets, gaps(time_s, good), held)


def gaps(time_s: Array, good: Flags) -> list[tuple[float, float]]:
    """Pauses between good samples (:func:`swimid.logs.sampling.pauses`), s."""
    times = time_s[good]
    return [(float(times[k]), float(times[k + 1])) for k in pauses(times)]


def _jumps(time: Array, place: Array) -> tuple[Flags, list[int]]:
    """Samples that stay, and samples at which the track goes on elsewhere."""
    from scipy import ndimage

    steps_s, steps = np.diff(time), np.diff(place, axis=0)
    usual_s = float(np.median(steps_s))
    velocity = steps / steps_s[:, None]
    expected = ndimage.median_filter(velocity, size=(WINDOW, 1), mode="nearest")
    off = np.linalg.norm(steps - expected * steps_s[:, None], axis=1)
    length = np.linalg.norm(steps, axis=1)
    least = max(max(quantum(column) for column in place.T), 0.05 * float(np.median(length)))
    scale = max(float(np.median(off)), least)
    local = np.maximum(ndimage.median_filter(off, size=min(WIDE, len(off)), mode="nearest"), scale)
    alike = ndimage.median_filter(velocity, size=(ALIKE, 1), mode="nearest")
    fastest = float(np.percentile(np.linalg.norm(alike, axis=1), 99))
    longer = np.maximum(steps_s / usual_s, 1.0)
    limit = OUTLYING * local * np.minimum(longer, PAUSE)
    outlying = (off > limit) & (length > FASTER * fastest * steps_s + OUTLYING * scale)
    if not outlying.any():
        return np.ones(len(time), dtype=bool), []
    starts = np.concatenate(([0], np.flatnonzero(outlying) + 1))
    ends = np.concatenate((starts[1:], [len(time)]))

    def goes_on(one: int, other: int) -> bool:
        a, b = ends[one] - 1, starts[other]
        away = float(np.linalg.norm(place[b] - place[a]))
        return away <= FASTER * fastest * (time[b] - time[a]) + OUTLYING * scale

    chain = _chain(ends - starts, goes_on, max(FEW, FEW_SHARE * len(time)))
    stays = np.zeros(len(time), dtype=bool)
    for piece in chain:
        stays[starts[piece] : ends[piece]] = True
    elsewhere = [int(starts[b]) for a, b in pairwise(chain) if not goes_on(a, b)]
    return stays, elsewhere


def _chain(sizes: NDArray[np.int64], goes_on: Callable[[int, int], bool], cost: float) -> list[int]:
    """The pieces that keep most samples, each break of the track paid for."""
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
