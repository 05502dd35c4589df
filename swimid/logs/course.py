"""Whether the course of a track agrees with the heading logged beside it.

A camera's y axis points down, so a track written without turning it is mirrored while a heading from the
image is not, or the other way round. Every sample is plausible then, and every fit wrong.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import i0e

Array = NDArray[np.float64]

#: Fewest windows from which anything is said.
MIN_WINDOWS = 8
#: Log of the Bayes factor from which evidence is "very strong" (Kass and Raftery 1995, JASA 90).
VERY_STRONG = math.log(150.0)
#: Drift angles of hulls in the tightest turns stay below this, rad: a course that differs from the heading by
#: more is no slip (ships 10 to 20 degrees to either side, Fossen 2011, *Handbook of Marine Craft
#: Hydrodynamics*, 7.1).
LARGEST_SLIP = math.radians(30.0)


@dataclass(frozen=True)
class Course:
    """Course against heading over the windows of some tracks.

    Attributes
    ----------
    slip_rad : float
        Mean of course minus heading, -pi to pi.
    spread_rad : float
        Circular standard deviation of it.
    mirrored : bool
        Whether the courses follow the headings turned the other way round, and not the headings.
    """

    slip_rad: float
    spread_rad: float
    mirrored: bool


def of_tracks(tracks: Iterable[tuple[Array, Array, Array, Array]], window_s: float) -> Course | None:
    """Compare course and heading of tracks seen by one camera.

    Parameters
    ----------
    tracks : iterable of (t, x, y, heading)
        Each shape (n,), in s, m, m and rad; NaN where nothing was measured.
    window_s : float
        At least one stroke, so that recoil averages out.

    Returns
    -------
    Course or None
        None where too few windows advance farther than they sway.
    """
    pairs = [pair for track in tracks for pair in _windows(*track, window_s)]
    if len(pairs) < MIN_WINDOWS:
        return None
    course, heading = np.array(pairs).T
    along, against = np.mean(course * heading.conj()), np.mean(course * heading)
    spread = math.sqrt(-2.0 * math.log(min(max(abs(along), 1e-12), 1.0)))
    evidence = _likelihood(abs(against), len(pairs)) - _likelihood(abs(along), len(pairs))
    mirrored = bool(evidence > VERY_STRONG and spread > LARGEST_SLIP)
    return Course(float(np.angle(along)), spread, mirrored)


def in_degrees(tracks: Iterable[tuple[Array, Array, Array, Array]], window_s: float) -> bool:
    """Whether the courses, which differ, follow the headings taken for degrees, and not as they are.

    Parameters
    ----------
    tracks, window_s
        As of :func:`of_tracks`.
    """
    tracks = list(tracks)
    turned = [(t, x, y, np.radians(heading)) for t, x, y, heading in tracks]
    plain, found = of_tracks(tracks, window_s), of_tracks(turned, window_s)
    # against no heading at all: the spread of the courses themselves
    still = of_tracks([(t, x, y, np.zeros_like(heading)) for t, x, y, heading in tracks], window_s)
    if found is None or still is None or (plain is not None and plain.spread_rad < LARGEST_SLIP):
        return False
    follows = found.spread_rad < LARGEST_SLIP and abs(found.slip_rad) < LARGEST_SLIP
    return follows and still.spread_rad > LARGEST_SLIP


def _windows(
    time: Array, x: Array, y: Array, heading: Array, window_s: float
) -> list[tuple[complex, complex]]:
    """Unit vectors of course and mean heading of each window that advances farther than it sways."""
    there = np.isfinite(x) & np.isfinite(y) & np.isfinite(heading)
    if there.sum() < 3:
        return []
    time, path, heading = time[there], (x + 1j * y)[there], heading[there]
    numbers = (time - time[0]) // window_s
    pairs = []
    for window in (numbers == number for number in np.unique(numbers)):
        t, place, span = time[window], path[window], np.ptp(time[window])
        if len(t) < 3 or span < 0.5 * window_s:
            continue
        slope, level = np.polyfit(t, place, 1)
        sway = np.sqrt(np.mean(np.abs(place - slope * t - level) ** 2))
        mean = np.mean(np.exp(1j * heading[window]))
        if abs(slope) * span > 2.0 * sway and abs(mean) > 0.5:
            pairs.append((complex(slope / abs(slope)), complex(mean / abs(mean))))
    return pairs


def _likelihood(length: float, count: int) -> float:
    """Largest log-likelihood of angles with a mean resultant length under von Mises' distribution."""
    length = min(length, 1.0 - 1e-6)
    # Fisher 1993, *Statistical Analysis of Circular Data*, 4.5.5: maximum-likelihood concentration
    if length < 0.53:
        kappa = 2 * length + length**3 + 5 * length**5 / 6
    elif length < 0.85:
        kappa = -0.4 + 1.39 * length + 0.43 / (1 - length)
    else:
        kappa = 1 / (length**3 - 4 * length**2 + 3 * length)
    return count * (kappa * length - kappa - math.log(i0e(kappa)))
