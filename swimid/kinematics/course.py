"""Course of a swimmer against its heading."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


#: Minimum number of pairs of successive time windows in which the course is compared with the heading.
MIN_COURSE_WINDOWS = 8
#: Minimum fraction of a window from its first to its last sample. The mean of such a window has at most a
#: tenth of the amplitude of a sway with the period of the window.
MIN_KNOWN_SPAN = 0.9
#: Natural logarithm of the smallest Bayes factor that counts as "very strong" evidence (Kass and Raftery
#: 1995, JASA 90).
VERY_STRONG = math.log(150.0)
#: Maximum angle between direction of travel and heading, rad: the drift angle of a hull in its tightest turn
#: (Fossen 2011, *Handbook of Marine Craft Hydrodynamics*, 7.1: 10 to 20 degrees for ships). A larger angle is
#: taken for an error of the columns.
LARGEST_SLIP = math.radians(30.0)
#: Minimum mean angle between heading and course, rad, that is reported. It is half of the angle that swapped
#: axes cause.
MIN_ANGLE = math.radians(45.0)


@dataclass(frozen=True)
class Course:
    """Difference between the direction of travel (course) and the heading, over windows of tracks.

    Attributes
    ----------
    slip_rad : float
        Mean of course minus heading, rad, -pi to pi.
    spread_rad : float
        Circular standard deviation of course minus heading, rad.
    mirrored : bool
        Whether the course follows the negative of the heading, as in a mirrored image.
    opposed : bool
            Whether the course seems to follow the negative of the heading, but the difference is small: less
            than a hull may slip in a turn, and more than the heading swings in a window.
    """

    slip_rad: float
    spread_rad: float
    mirrored: bool
    opposed: bool

    def find_turn(self, name: str) -> str:
        """Return a message if the heading, column ``name``, stands at a constant angle to the course."""
        if self.spread_rad >= LARGEST_SLIP or abs(self.slip_rad) <= MIN_ANGLE:
            return ""
        angle = abs(math.degrees(self.slip_rad))
        text = f"stands at {angle:.0f} degrees to the course of the track on average"
        hint = f"unless the robot swims that way by intent, write offset: {self.slip_rad:.4f} for {name}"
        return f"{text}: {hint}; a compass heading needs factor: -1 and offset: 1.5708"


def compare_course(tracks: Iterable[tuple[Array, Array, Array, Array]], window_s: float) -> Course | None:
    """Compare the direction of travel (course) with the heading, in tracks seen by one camera.

    Parameters
    ----------
    tracks : iterable of (t, x, y, heading)
        Each shape (n,), in s, m, m and rad; NaN where missing.
    window_s : float
        Length of a window, s: at least one stroke, so that the oscillation of the body averages out.

    Returns
    -------
    Course or None
        None if fewer than :data:`MIN_COURSE_WINDOWS` pairs of successive windows have more advance than sway.
    """
    pairs = [pair for track in tracks for pair in _windows(*track, window_s)]
    if len(pairs) < MIN_COURSE_WINDOWS:
        return None
    course, heading = np.array(pairs).T
    swing = math.sqrt(-2.0 * math.log(min(float(np.mean(np.abs(heading))), 1.0)))
    heading = heading / np.abs(heading)
    along, against = np.mean(course * heading.conj()), np.mean(course * heading)
    spread = math.sqrt(-2.0 * math.log(min(max(abs(along), 1e-12), 1.0)))
    evidence = _likelihood(abs(against), len(pairs)) - _likelihood(abs(along), len(pairs))
    mirrored = evidence > VERY_STRONG and spread > LARGEST_SLIP
    opposed = evidence > VERY_STRONG and swing < spread <= LARGEST_SLIP
    return Course(float(np.angle(along)), spread, bool(mirrored), bool(opposed))


def is_in_degrees(tracks: Iterable[tuple[Array, Array, Array, Array]], window_s: float) -> bool:
    """Return whether the headings of tracks are in degrees: only then do they agree with the course.

    If all tracks have the same course, the unit of the headings cannot be determined, and the result is
    False.

    Parameters
    ----------
    tracks, window_s
        The arguments of :func:`compare_course`.
    """
    tracks = list(tracks)
    turned = [(t, x, y, np.radians(heading)) for t, x, y, heading in tracks]
    plain, found = compare_course(tracks, window_s), compare_course(turned, window_s)
    # The function compares the course with the heading. With a heading of zero it returns the circular
    # standard deviation of the course.
    still = compare_course([(t, x, y, np.zeros_like(heading)) for t, x, y, heading in tracks], window_s)
    if found is None or still is None or (plain is not None and plain.spread_rad < LARGEST_SLIP):
        return False
    follows = found.spread_rad < LARGEST_SLIP and abs(found.slip_rad) < LARGEST_SLIP
    return follows and still.spread_rad > LARGEST_SLIP


def _windows(
    time: Array, x: Array, y: Array, heading: Array, window_s: float
) -> list[tuple[complex, complex]]:
    """Return course and mean heading as complex numbers, for each two successive windows.

    The course is the direction from the mean place of a window to that of the next one. A mean over whole
    strokes is free of the sway, which a line fitted to a single stroke is not. Windows with gaps at their
    strokes is free of the sway, which a line fitted to a single stroke is not. Windows with gaps at their
    ends are left out, and courses with less advance than sway. The complex course has the absolute value 1.
    The complex heading is the mean of the unit vectors of a window.
    """
    there = np.isfinite(x) & np.isfinite(y) & np.isfinite(heading)
    if there.sum() < 3:
        return []
    time, path, facing = time[there], (x + 1j * y)[there], np.exp(1j * heading[there])
    window_s, step = min(window_s, np.ptp(time) / 2), float(np.median(np.abs(np.diff(time))))
    numbers = ((time - time[0]) // window_s).astype(int)
    order = np.argsort(numbers, kind="stable")
    means: dict[int, tuple[complex, complex, float]] = {}
    for window in np.split(order, np.flatnonzero(np.diff(numbers[order])) + 1):
        if np.ptp(time[window]) + step > MIN_KNOWN_SPAN * window_s:
            place, ahead = complex(np.mean(path[window])), complex(np.mean(facing[window]))
            means[int(numbers[window[0]])] = place, ahead, float(np.std(path[window]))
    pairs = []
    for number in sorted(means.keys() & {n - 1 for n in means}):
        (place, ahead, sway), (later, turned, sway_later) = means[number], means[number + 1]
        advance, mean_ahead = later - place, (ahead + turned) / 2
        if abs(advance) > max(sway, sway_later) and abs(mean_ahead) > 0.5:
            pairs.append((advance / abs(advance), mean_ahead))
    return pairs


def _likelihood(length: float, count: int) -> float:
    """Return the maximum log-likelihood of ``count`` angles under a von Mises distribution.

    ``length`` is the mean resultant length of the angles.
    """
    from scipy.optimize import brentq
    from scipy.special import i0e, i1e

    length = min(length, 1.0 - 1e-6)
    kappa = brentq(lambda kappa: i1e(kappa) / i0e(kappa) - length, 0.0, 1e6)
    return count * (kappa * length - kappa - math.log(i0e(kappa)))
