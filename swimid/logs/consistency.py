"""Comparison of columns of one log: rates with poses, and the direction of travel with the heading.

The y axis of an image points down. If only one of track and heading is converted to a y axis that points up,
they are mirrored to each other. Each column still looks plausible, but a model fitted to them is wrong.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from swimid.logs.kinematics import AXES
from swimid.logs.log import TIME

Array = NDArray[np.float64]
#: Minimum ratio of a gain (regression coefficient between two columns) to its standard error. A gain with a
#: smaller ratio is not judged. Unrelated columns exceed the minimum in one of 16,000 pairs.
MIN_STDERRS = 4.0
#: Minimum number of increments that do not overlap. With fewer the standard error of a gain is not useful.
MIN_WINDOWS = 8
#: Factors by which a column is wrong if degrees and radians are confused.
_DEGREES = (np.pi / 180, 180 / np.pi)


@dataclass(frozen=True)
class Comparison:
    """Comparison of a column with another column that shows the same motion.

    Attributes
    ----------
    column, against : str
        Name of the column, and name of the quantity that the column is compared with.
    gain, stderr : float
        Increments of the other quantity divided by increments of the integrated column, by regression, and
        the standard error of this gain. The gain is 1 if both agree.
    text : str
        Mistake that explains the gain, in words; empty if both agree.
    """

    column: str
    against: str
    gain: float
    stderr: float
    text: str


def compare_columns(columns: Mapping[str, Array], period_s: float | None = None) -> list[Comparison]:
    """Compare rates with the change of their pose, and the direction of travel with the heading.

    The result holds those of the following comparisons for which the log has the columns: u, v with the
    velocity of the track in the body frame, every ``<name>_m_s`` and ``<name>_rad_s`` with ``<name>_m`` and
    ``<name>_rad``, the yaw rate with the heading, and turn rates with the attitude quaternion.

    Parameters
    ----------
    columns : mapping of str to ndarray, each shape (n,)
        Columns of a log in SI, ``t_s`` among them.
    period_s : float, optional
        Period of the stroke, s. Without this period, direction of travel and heading are not compared.
    """
    time = columns[TIME]
    found: list[Comparison] = []
    for name, values in columns.items():
        hit = re.fullmatch(r"(.+)_(m|rad|px)_s", name)
        if hit is None or hit[1] in ("u", "v", "w"):
            continue
        stem, pose = hit.groups()
        of = stem.removesuffix("_rate")
        if len(stem) == 2:
            of = of.removeprefix("v")
        against = f"{of}_{pose}"
        if name == "wz_rad_s" and not {"roll_rad", "pitch_rad", *AXES} & set(columns):
            against = "yaw_rad"
        if against in columns:
            motion = columns[against]
            if pose == "rad":
                motion = np.unwrap(motion)
            found += _judge(time, [motion], [[values]], [name], against, angle=pose == "rad")
    for pose in ("m", "px"):
        track = [f"x_{pose}", f"y_{pose}", "yaw_rad"]
        names = [name for name in (f"u_{pose}_s", f"v_{pose}_s") if name in columns]
        if set(track) <= set(columns):
            x, y, yaw = (columns[name] for name in track)
            if period_s is not None:
                found += _of_course(time, x, y, yaw, period_s)
        if set(track) <= set(columns) and names:
            along, across = (np.cos(yaw), np.sin(yaw)), (-np.sin(yaw), np.cos(yaw))
            ways = {f"u_{pose}_s": along, f"v_{pose}_s": across}
            rates = [[columns[name] * part for part in ways[name]] for name in names]
            found += _judge(time, [x, y], rates, names, "the track and its heading", angle=False)
    turns = ("wx_rad_s", "wy_rad_s", "wz_rad_s")
    if {*AXES, *turns} <= set(columns):
        found += _of_quaternion(time, np.column_stack([columns[axis] for axis in AXES]), columns, turns)
    return found


def _of_course(time: Array, x: Array, y: Array, yaw: Array, period_s: float) -> list[Comparison]:
    """Compare the direction of travel with the heading, averaged over windows of one stroke."""
    seen = compare_course([(time, x, y, yaw)], period_s)
    if seen is None:
        return []
    gain, text = 1.0, ""
    if seen.mirrored:
        gain = -1.0
        text = "turns opposite to the course of the track: one of both is mirrored (factor: -1 for yaw or y)"
    return [Comparison("yaw_rad", "the course of the track", gain, math.nan, text)]


def _of_quaternion(
    time: Array, q: Array, columns: Mapping[str, Array], turns: Sequence[str]
) -> list[Comparison]:
    """Compare turn rates with the rotation between consecutive attitudes, in the body frame."""
    from scipy.spatial.transform import Rotation

    there = np.isfinite(q).all(axis=1) & (np.abs(np.linalg.norm(q, axis=1) - 1.0) < 0.05)
    if there.sum() < MIN_WINDOWS:
        return []
    attitudes = Rotation.from_quat(q[there], scalar_first=True)
    steps = (attitudes[:-1].inv() * attitudes[1:]).as_rotvec()
    angles = np.vstack((np.zeros(3), np.cumsum(steps, axis=0)))
    found: list[Comparison] = []
    for k, name in enumerate(turns):
        rate = columns[name][there]
        found += _judge(time[there], [angles[:, k]], [[rate]], [name], "the quaternion", angle=True)
    wrong = [one for one in found if one.text]
    mirrored = [one for one in wrong if one.gain < 0]
    if mirrored and len(mirrored) == len(wrong):
        names = ", ".join(one.column for one in mirrored)
        text = (
            "turns opposite to the quaternion, which is that from world to body, or the sign is wrong: "
            "quaternion: {direction: world-to-body} in the mapping conjugates it"
        )
        return [Comparison(names, "the quaternion", mirrored[0].gain, mirrored[0].stderr, text)]
    return found


def _judge(
    time: Array,
    pose: Sequence[Array],
    rates: Sequence[Sequence[Array]],
    names: Sequence[str],
    against: str,
    *,
    angle: bool,
) -> list[Comparison]:
    """Regress increments of the pose on those of the integrated rates, and name gains that differ from 1.

    ``rates[k]`` holds the contribution of the rate ``names[k]`` to each coordinate of the pose. The
    increments span the number of samples at which the rates explain the largest fraction of the sum of
    squares of the pose increments. Gains that do not differ significantly from 0 are left out.
    """
    there = np.isfinite([time, *pose, *(part for parts in rates for part in parts)]).all(axis=0)
    if there.sum() < 2 * MIN_WINDOWS:
        return []
    clock, steps = time[there], np.diff(time[there])
    moved = [values[there] for values in pose]
    integrals = [
        [np.concatenate(([0.0], np.cumsum(steps * (v[1:] + v[:-1]) / 2))) for v in (p[there] for p in parts)]
        for parts in rates
    ]
    best: tuple[float, Array, Array] | None = None
    for lag in 2 ** np.arange(int(np.log2(len(clock) / MIN_WINDOWS)) + 1):
        y = np.concatenate([values[lag:] - values[:-lag] for values in moved])
        x = np.column_stack(
            [np.concatenate([part[lag:] - part[:-lag] for part in parts]) for parts in integrals]
        )
        scale = np.linalg.norm(x, axis=0)
        if not (scale > 0).all() or not np.any(y):
            continue
        x /= scale
        gain, *_ = np.linalg.lstsq(x, y, rcond=None)
        squares = float(np.sum((y - x @ gain) ** 2))
        # overlapping increments are not independent: the degrees of freedom count one in ``lag``
        freedom = max(len(y) / lag - x.shape[1], 1.0)
        stderr = np.sqrt(squares / freedom * np.diag(np.linalg.pinv(x.T @ x)))
        explained = 1.0 - squares / float(y @ y)
        if best is None or explained > best[0]:
            best = explained, gain / scale, stderr / scale
    if best is None:
        return []
    found = []
    for name, gain, stderr in zip(names, best[1], best[2], strict=True):
        if abs(gain) > MIN_STDERRS * stderr:
            text = _named(float(gain), angle=angle)
            found.append(Comparison(name, against, float(gain), float(stderr), text))
    return found


def _named(gain: float, *, angle: bool) -> str:
    """Return in words the mistake whose factor is nearest to a column's gain; empty for a gain near 1."""
    factors = [10.0**k for k in range(-3, 4)]
    if angle:
        factors += _DEGREES
    nearest = min(factors, key=lambda factor: abs(np.log(abs(gain) / factor)))
    words = []
    if gain < 0:
        words.append("has the opposite sign")
    if nearest == _DEGREES[0]:
        words.append("is in degrees where radians are named")
    elif nearest == _DEGREES[1]:
        words.append("is in radians beside degrees")
    elif nearest != 1.0:
        words.append(f"is {1 / nearest:g} times too large")
    return " and ".join(words)


# ---------------------------------------------------------------- course and heading

#: Natural logarithm of the smallest Bayes factor that counts as "very strong" evidence (Kass and Raftery
#: 1995, JASA 90).
VERY_STRONG = math.log(150.0)
#: Maximum drift angle of a hull in its tightest turn, rad (Fossen 2011, *Handbook of Marine Craft
#: Hydrodynamics*, 7.1: 10 to 20 degrees for ships). A larger angle between direction of travel and heading is
#: taken for an error of the columns.
LARGEST_SLIP = math.radians(30.0)


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
        Whether the course follows minus the heading, and not the heading.
    """

    slip_rad: float
    spread_rad: float
    mirrored: bool


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
        None if fewer than :data:`MIN_WINDOWS` windows have more advance than sway.
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


def is_in_degrees(tracks: Iterable[tuple[Array, Array, Array, Array]], window_s: float) -> bool:
    """Return whether the course follows the heading only if the headings are interpreted as degrees.

    Tracks that all have the same course do not show this; the result is then False.

    Parameters
    ----------
    tracks, window_s
        The arguments of :func:`compare_course`.
    """
    tracks = list(tracks)
    turned = [(t, x, y, np.radians(heading)) for t, x, y, heading in tracks]
    plain, found = compare_course(tracks, window_s), compare_course(turned, window_s)
    # circular standard deviation of the course itself
    still = compare_course([(t, x, y, np.zeros_like(heading)) for t, x, y, heading in tracks], window_s)
    if found is None or still is None or (plain is not None and plain.spread_rad < LARGEST_SLIP):
        return False
    follows = found.spread_rad < LARGEST_SLIP and abs(found.slip_rad) < LARGEST_SLIP
    return follows and still.spread_rad > LARGEST_SLIP


def _windows(
    time: Array, x: Array, y: Array, heading: Array, window_s: float
) -> list[tuple[complex, complex]]:
    """Return unit vectors of course and mean heading, for each window with more advance than sway."""
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
    """Return the maximum log-likelihood of ``count`` angles under a von Mises distribution.

    ``length`` is the mean resultant length of the angles.
    """
    from scipy.special import i0e

    length = min(length, 1.0 - 1e-6)
    # maximum-likelihood estimate of the concentration: Fisher 1993, *Statistical Analysis of Circular Data*,
    # 4.5.5
    if length < 0.53:
        kappa = 2 * length + length**3 + 5 * length**5 / 6
    elif length < 0.85:
        kappa = -0.4 + 1.39 * length + 0.43 / (1 - length)
    else:
        kappa = 1 / (length**3 - 4 * length**2 + 3 * length)
    return count * (kappa * length - kappa - math.log(i0e(kappa)))
