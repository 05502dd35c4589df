"""Checks of a log: columns that contradict each other, and channels whose values no working sensor gives.

One cause of a contradiction is the y axis of an image, which points down. If only the track or only the
heading is converted to a y axis that points up, the track turns opposite to the heading. Each column still
looks plausible, but a model fitted to them is wrong.
"""

from __future__ import annotations

import hashlib
import math
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from swimid.imports.averaging import ChannelStatistics
from swimid.kinematics.attitude import AXES, from_angles, with_angles
from swimid.kinematics.course import compare_course
from swimid.kinematics.jumps import WINDOW, find_jumps
from swimid.kinematics.stroke import NO_MOTION, coordinate_columns
from swimid.logs.log import TIME, runs, unwrap_angle
from swimid.logs.sampling import LONG_ENOUGH, SET, find_held, has_levels
from swimid.logs.units import quantity_of

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
#: Minimum ratio of a gain (regression coefficient between two columns of a log) to its standard error. Gains
#: with a smaller ratio are not judged. Unrelated columns reach this ratio in one of 16,000 pairs.
MIN_STDERRS = 4.0
#: Minimum number of non-overlapping increments of a column in the regression on another column. With fewer
#: increments the standard error of the gain is not useful.
MIN_WINDOWS = 8
#: Number of windows of a log without a stroke in which the course is compared with the heading.
N_WINDOWS = 12
#: Minimum speed of a track, m/s, for which the mean angle between track and heading is judged. Slower robots
#: hover and drift with the water.
MIN_SPEED_M_S = 0.01
#: Columns of a track in a plane and of its heading.
PLANES = (("x_m", "y_m", "yaw_rad"), ("x_px", "y_px", "yaw_rad"), ("x_m", "z_m", "pitch_rad"))
#: Gain of a column that is in degrees instead of radians, and gain of a column that is in radians instead of
#: degrees.
_DEGREES = (np.pi / 180, 180 / np.pi)


@dataclass(frozen=True)
class ColumnComparison:
    """Comparison of a column with another column that shows the same motion.

    Attributes
    ----------
    column, against : str
        Name of the column, and name of the quantity that the column is compared with.
    gain, stderr : float
        Ratio of increments of the other quantity to increments of the integrated column, by regression, and
        the standard error of this gain. The gain is 1 if column and quantity agree.
    text : str
        Mistake that explains the gain, as text for a message; empty if the column agrees with the quantity.
    doubtful : bool
        Whether the difference may be intended, for example if the robot swims sideways.
    """

    column: str
    against: str
    gain: float
    stderr: float
    text: str
    doubtful: bool = False


def compare_columns(columns: Mapping[str, Array], period_s: float | None = None) -> list[ColumnComparison]:
    """Compare rates in a log with derivatives of its pose, and the direction of travel with the heading.

    Each comparison is made if the log has the columns for it: u, v with the velocity of the track in the body
    frame, every ``<name>_m_s`` and ``<name>_rad_s`` with ``<name>_m`` and ``<name>_rad``, the yaw rate with
    the heading, and turn rates with the attitude quaternion.

    Parameters
    ----------
    columns : mapping of str to ndarray, each shape (n,)
        Columns of a log in SI, ``t_s`` among them.
    period_s : float, optional
        Period of the stroke, s, over which direction of travel and heading are averaged. The default is a
        twelfth of the duration.
    """
    time, found = columns[TIME], _compare_rates(columns)
    turned = with_angles(dict(columns))
    for x_name, y_name, angle in PLANES:
        if {x_name, y_name, angle} <= set(turned) and not (y_name == "z_m" and "y_m" in turned):
            path = turned[x_name], turned[y_name], turned[angle]
            found += _of_course(time, *path, period_s, angle)
    for pose in ("m", "px"):
        track = [f"x_{pose}", f"y_{pose}", "yaw_rad"]
        names = [name for name in (f"u_{pose}_s", f"v_{pose}_s") if name in columns]
        if set(track) <= set(columns) and names:
            x, y, yaw = (columns[name] for name in track)
            along, across = (np.cos(yaw), np.sin(yaw)), (-np.sin(yaw), np.cos(yaw))
            ways = {f"u_{pose}_s": along, f"v_{pose}_s": across}
            rates = [[columns[name] * part for part in ways[name]] for name in names]
            found += _judge(time, [x, y], rates, names, "the track and its heading", angle=False)
    turns = ("wx_rad_s", "wy_rad_s", "wz_rad_s")
    if {*AXES, *turns} <= set(columns):
        found += _of_quaternion(time, np.column_stack([columns[axis] for axis in AXES]), columns, turns)
    return found


def _compare_rates(columns: Mapping[str, Array]) -> list[ColumnComparison]:
    """Compare each rate of one coordinate with the derivative of the column of this coordinate."""
    found: list[ColumnComparison] = []
    for name, values in columns.items():
        hit = re.fullmatch(r"(.+)_(m|rad|px)_s", name)
        if hit is None or hit[1] in ("u", "v", "w"):
            continue
        stem, pose = hit.groups()
        coordinate = stem.removesuffix("_rate")
        if len(stem) == 2:
            coordinate = coordinate.removeprefix("v")
        against = f"{coordinate}_{pose}"
        if name == "wz_rad_s" and not {"roll_rad", "pitch_rad", *AXES} & set(columns):
            against = "yaw_rad"
        if against in columns:
            motion = unwrap_angle(against, columns[against])
            found += _judge(columns[TIME], [motion], [[values]], [name], against, angle=pose == "rad")
    return found


def _of_course(
    time: Array, x: Array, y: Array, yaw: Array, period_s: float | None, name: str
) -> list[ColumnComparison]:
    """Compare the direction of travel of a track with the heading, averaged over windows of a stroke or more.

    The mean angle between the two is computed from windows of several strokes, because the sway changes the
    course within one stroke.
    """
    long_s = float(np.ptp(time)) / N_WINDOWS
    seen = compare_course([(time, x, y, yaw)], period_s or long_s)
    if seen is None:
        return []
    if not seen.mirrored and period_s:
        seen = compare_course([(time, x, y, yaw)], period_s * math.ceil(long_s / period_s)) or seen
    text, against = "", "the course of the track"
    extent = np.hypot(np.nanmax(x) - np.nanmin(x), np.nanmax(y) - np.nanmin(y))
    is_mirrored = seen.mirrored or seen.opposed
    if is_mirrored:
        text = f"turns opposite to {against}: either is mirrored: give factor: -1 for {name} or y)"
    elif extent > MIN_SPEED_M_S * np.ptp(time):
        text = seen.find_turn(name)
    doubtful = bool(text) and not seen.mirrored
    return [ColumnComparison(name, against, 1.0 - 2.0 * is_mirrored, math.nan, text, doubtful)]


def _of_quaternion(
    time: Array, q: Array, columns: Mapping[str, Array], turns: Sequence[str]
) -> list[ColumnComparison]:
    """Compare turn rates about body axes with the rotations between successive attitude quaternions."""
    from scipy.spatial.transform import Rotation

    there = np.isfinite(q).all(axis=1) & (np.abs(np.linalg.norm(q, axis=1) - 1.0) < 0.05)
    if there.sum() < MIN_WINDOWS:
        return []
    attitudes = Rotation.from_quat(q[there], scalar_first=True)
    steps = (attitudes[:-1].inv() * attitudes[1:]).as_rotvec()
    angles = np.vstack((np.zeros(3), np.cumsum(steps, axis=0)))
    found: list[ColumnComparison] = []
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
        return [ColumnComparison(names, "the quaternion", mirrored[0].gain, mirrored[0].stderr, text)]
    return found


def _judge(
    time: Array,
    pose: Sequence[Array],
    rates: Sequence[Sequence[Array]],
    names: Sequence[str],
    against: str,
    *,
    angle: bool,
) -> list[ColumnComparison]:
    """Regress a pose on integrated rates, and name the mistake that explains a coefficient other than 1.

    Increments of the pose are regressed on increments of the integrated rates.

    ``rates[k]`` holds the contribution of the rate ``names[k]`` to each coordinate of the pose. All
    increments span the same number of samples. It is chosen so that the rates explain the largest fraction of
    the pose increments. Gains that do not differ significantly from 0 are left out.
    """
    from scipy.integrate import cumulative_trapezoid

    there = np.isfinite([time, *pose, *np.concatenate(rates)]).all(axis=0)
    if there.sum() < 2 * MIN_WINDOWS:
        return []
    moved = np.array(pose)[:, there]
    integrals = cumulative_trapezoid(np.array(rates)[..., there], time[there], initial=0.0)
    best: tuple[float, Array, Array] | None = None
    for lag in 2 ** np.arange(int(np.log2(there.sum() / MIN_WINDOWS)) + 1):
        y = (moved[:, lag:] - moved[:, :-lag]).ravel()
        x = np.column_stack((integrals[..., lag:] - integrals[..., :-lag]).reshape(len(names), -1))
        scale = np.linalg.norm(x, axis=0)
        if not (scale > 0).all() or not np.any(y):
            continue
        x /= scale
        gain, *_ = np.linalg.lstsq(x, y, rcond=None)
        squares = float(np.sum((y - x @ gain) ** 2))
        # Overlapping increments are not independent: only one increment in ``lag`` adds a degree of freedom.
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
            text = _explain_factor(float(gain), angle=angle)
            found.append(ColumnComparison(name, against, float(gain), float(stderr), text))
    return found


def _explain_factor(gain: float, *, angle: bool) -> str:
    """Return the mistake (sign, unit, scale) that explains a factor between columns; empty for factor 1."""
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


# ---------------------------------------------------------------- jumps of single channels

#: Names of the angles of the attitude.
ANGLES = ("roll_rad", "pitch_rad", "yaw_rad")
#: Maximum rate of a joint, rad/s: the fastest hobby servos turn 60 degrees in 0.05 s.
MAX_JOINT_RATE = math.radians(60.0) / 0.05
#: Maximum fraction of the samples of a channel that lie in jumps. A joint with more jumps is probably
#: commanded in steps. Any other column with more jumps is probably not a track or an attitude.
MAX_JUMPED = 0.2


@dataclass(frozen=True)
class Jumped:
    """Samples of a channel that lie away from the others: jumps with return, or spikes.

    Attributes
    ----------
    columns : tuple of str
        Columns of the channel. An attitude has several.
    out : ndarray of bool, shape (n,)
        Whether each sample lies away from the channel.
    elsewhere : list of int
        Row numbers at which the channel continues at another value.
    """

    columns: tuple[str, ...]
    out: Flags
    elsewhere: list[int]


def find_jumped(columns: Mapping[str, Array]) -> list[Jumped]:
    """Find jumps of attitudes, angles and tracks with one coordinate, and spikes of all other channels.

    Angles and attitudes are compared as directions, so that neither a full turn nor the sign of a quaternion
    is a jump. A jump is defined as in :func:`swimid.kinematics.jumps.find_jumps`. Tracks of several
    coordinates are not searched here, but by :func:`swimid.kinematics.jumps.clean_track`.

    Parameters
    ----------
    columns : mapping of str to ndarray, each shape (n,)
        Columns of a log, ``t_s`` among them; NaN where missing.
    """
    found = []
    for names, place, rules in _channels(columns):
        known = np.flatnonzero(np.isfinite(place).all(axis=1))
        # Compare only samples that differ from the one before, because a log may repeat measurements.
        kept = known
        if not rules.get("brief"):
            kept = known[~find_held(columns[TIME], list(place.T)).repeated[known]]
        fresh = np.append(True, np.any(np.diff(place[kept], axis=0) != 0, axis=1))[: len(kept)]
        rows = kept[fresh]
        if len(rows) <= WINDOW:
            continue
        until = columns[TIME][np.append(kept[np.flatnonzero(fresh)[1:] - 1], kept[-1])]
        stays, elsewhere = find_jumps(columns[TIME][rows], place[rows], until, **rules)
        out = np.zeros(len(place), dtype=bool)
        out[known] = ~stays[np.maximum(np.searchsorted(rows, known, side="right") - 1, 0)]
        if rules.get("brief"):
            # A value that is held for longer than usual is no spike.
            ends, usual = runs(out), 2 * np.median(np.diff(rows))
            held = np.diff(ends)[:, 0] > usual * np.diff(np.searchsorted(rows, ends))[:, 0]
            for first, end in ends[held]:
                out[first:end] = False
        if rules.get("least_rate"):
            elsewhere = []
            out &= out.mean() <= MAX_JUMPED
        if out.any() or elsewhere:
            found.append(Jumped(names, out, [int(rows[k]) for k in elsewhere]))
    return found


def _channels(columns: Mapping[str, Array]) -> Iterator[tuple[tuple[str, ...], Array, dict[str, Any]]]:
    """Yield the columns of each channel, its samples, shape (n, d), and the arguments of ``find_jumps``."""
    from scipy.spatial.transform import Rotation

    names = [
        name for name in columns if name != TIME and not NO_MOTION.fullmatch(name) and "_raw_" not in name
    ]
    for group in (AXES, ANGLES):
        if set(group) <= set(names):
            values = np.column_stack([columns[name] for name in group])
            there = np.isfinite(values).all(axis=1) & (np.linalg.norm(values, axis=1) > 0)
            place = np.full((len(values), 9), np.nan)
            turned = from_angles(*values[there].T) if group == ANGLES else Rotation.from_quat(values[there])
            place[there] = turned.as_matrix().reshape(-1, 9) / np.sqrt(2.0)
            yield group, place, {}
            names = [name for name in names if name not in group]
    track = coordinate_columns(columns)
    if len(track) == 1:
        yield (track[0],), columns[track[0]][:, None], {}
    for name in names:
        if name not in ANGLES and has_levels(columns[name]):
            continue
        place = columns[name][:, None]
        rules: dict[str, Any] = {"brief": True}
        if name.endswith("_rad") and not SET.fullmatch(name):
            place = np.column_stack((np.cos(place), np.sin(place)))
            rules = {} if name in ANGLES else {"least_rate": MAX_JOINT_RATE}
        yield (name,), place, rules


def find_code(values: Sequence[float] | Array) -> float | None:
    """Return the value that at least half of the outlying samples of a channel hold exactly, or None.

    The value is probably the code of missing samples. A single outlying sample counts as a code only if it is
    0.

    >>> find_code([0.0, 0.0, 0.3]), find_code([0.1, 0.2, 0.3])
    (0.0, None)
    """
    value, count = Counter(np.asarray(values).tolist()).most_common(1)[0]
    return value if 2 * count >= len(values) and (count > 1 or value == 0.0) else None


# ---------------------------------------------------------------- channels that are no measurement

#: Relative tolerance for an increment of 1 between successive samples of a column that counts the rows.
COUNT_RTOL = 1e-6
#: Two names of the yaw rate. Columns with these names may be equal.
SYNONYMS = {"wz_rad_s", "yaw_rate_rad_s"}


def find_unmeasured(columns: Mapping[str, Array], scales: Mapping[str, float]) -> dict[str, str]:
    """Return the channels whose values no working sensor gives, each with a description of the fault.

    Such a channel is constant, counts the rows, equals another column, is saturated at a value, or holds a
    value far from all others. Channels with fewer than :data:`LONG_ENOUGH` values are not checked. Commands,
    standard deviations, likelihoods and confidences are checked for values far from all others only.

    Parameters
    ----------
    columns : mapping of str to ndarray, each shape (n,)
        Columns of a log, ``t_s`` among them; NaN where missing.
    scales : mapping of str to float
        Factor from the values in the file to the values of each column.

    Examples
    --------
    >>> t = np.arange(50) / 10
    >>> find_unmeasured({"t_s": t, "depth_m": 0 * t + 1.2}, {})
    {'depth_m': 'holds one value in every sample (1.2)'}
    """
    found: dict[str, str] = {}
    earlier: dict[bytes, list[str]] = {}
    for name, values in columns.items():
        known = values[np.isfinite(values)]
        if len(known) < LONG_ENOUGH or quantity_of(name) is None:
            continue
        channel = ChannelStatistics()
        channel.take(known)
        if SET.fullmatch(name):
            if text := channel.far():
                found[name] = text
            continue
        content = np.where(np.isnan(values), np.nan, values + 0.0).tobytes()  # one pattern for NaN and for 0
        equal = earlier.setdefault(hashlib.sha256(content).digest(), [])
        copied = [other for other in equal if {name, other} != SYNONYMS]
        steps = np.diff(known) / scales.get(name, 1.0)
        if name == TIME:
            text = ""
        elif not steps.any():
            text = f"holds one value in every sample ({known[0]:.6g})"
        elif copied:
            text = f"equals {copied[0]} in every sample"
        elif np.allclose(steps, 1.0, rtol=COUNT_RTOL):
            text = "counts the rows"
        else:
            text = channel.far() or channel.cut()
        if text:
            found[name] = text
        if "_raw_" not in name:
            equal.append(name)
    return found
