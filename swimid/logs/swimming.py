"""What a track comes to: its speeds, accelerations and stroke, over a window or its steady part."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from swimid.logs import rhythm, tracks
from swimid.logs.beat import Beat, waves
from swimid.logs.log import runs
from swimid.logs.tracks import Cleaning, Estimate, gaps, mean_of_blocks

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

#: Blocks a track without a stroke is cut into, and the most of any track: of more strokes several make one.
PLAIN, MAX_BLOCKS = 20, 200
#: Measured samples a window needs.
SHORTEST = 12
#: Blocks a steady part has at least, as many as tell a trend from their scatter.
MIN_BLOCKS = 5
#: A block slower than this share of the cruise (the 90th percentile) belongs to start, coasting or rest.
CRUISE = 0.5
#: A steady part changes its speed by no more than this share from its start to its end, or by chance;
LEVEL = 0.02
#: and the interval of the change reaches no farther than this share to either side: wider, it tells nothing.
TOLD = 0.2
#: Of the blocks under way at most these shares are cut off as start, and of the rest as end.
START, STOP = 1 / 2, 1 / 3
#: Strokes that tell one amplitude.
STROKES = 2.0
#: An amplitude stands clear where it is so many times its standard error, and the track's own error.
AMPLITUDE_Z = 3.0
#: A point that is never slower than this share of its mean speed has a course at all times.
SLOWEST = 0.2
#: A point whose course turns by more than this between blocks (rad) is no swimmer under way.
LARGEST_TURN = 1.0


@dataclass(frozen=True)
class Track:
    """A track as it was measured and as it was smoothed. One unit of length throughout.

    Attributes
    ----------
    time_s : ndarray, shape (n,)
    measured : ndarray of bool, shape (n,)
    raw, smooth, velocity : ndarray, shape (2, n)
        Measured and smoothed position, and velocity; NaN where there is none.
    raw_angle, angle : ndarray, shape (n,), or None
        Heading, measured and smoothed, unwrapped, rad.
    error, angle_error : float
        Standard deviation of what does not average out of a position, and of a heading, rad.
    """

    time_s: Array
    measured: Flags
    raw: Array
    smooth: Array
    velocity: Array
    raw_angle: Array | None
    angle: Array | None
    error: float = 0.0
    angle_error: float = 0.0


@dataclass(frozen=True)
class Swimming:
    """Figures of one window of a track, in the track's unit of length, s and rad.

    Attributes
    ----------
    begin_s, end_s : float
        The window.
    window : str
        Whether it was ``given``, is the ``steady part``, or the ``whole track`` because nothing of it is
        steady.
    path_speed : Estimate or None
        Mean of the speed along the path, sway included; None where no stretch is long enough.
    advance : Estimate or None
        Mean speed of the path averaged over strokes: the steady speed, where the window is steady. Without a
        stroke it is the displacement over time. On a path that turns round, it is the mean speed of blocks.
    change : Estimate or None
        How much the advance speed changes from the start to the end of the window.
    acceleration : Estimate or None
        Mean rate of the advance speed.
    acceleration_xy : tuple of Estimate, or None
        Mean rates of the velocity's coordinates.
    stroke : Beat or None
    frequency_hz : Estimate or None
    amplitudes : dict of str to Estimate
        Of the stroke's fundamental, half of peak to peak: ``sway``, across the mean heading (the path,
        where none is known; length), and ``turn``, of the heading (rad); those that stand clear of the noise.
    doubt : str
        What speaks against the stroke, in words; empty where nothing does.
    unknown : str
        Reason why there is no stroke, in words; empty where there is one.
    """

    begin_s: float
    end_s: float
    window: Literal["given", "steady part", "whole track"]
    path_speed: Estimate | None
    advance: Estimate | None
    change: Estimate | None
    acceleration: Estimate | None
    acceleration_xy: tuple[Estimate, Estimate] | None
    stroke: Beat | None
    frequency_hz: Estimate | None
    amplitudes: dict[str, Estimate]
    doubt: str = ""
    unknown: str = ""

    @property
    def steady(self) -> bool:
        """Whether the advance speed does not change over the window, but by chance or next to nothing."""
        return (
            self.advance is not None and self.change is not None and _level(self.change, self.advance.value)
        )


@dataclass(frozen=True)
class _Blocks:
    """Stretches of one stroke (or several): middle and duration (s), velocity (2, n), arc speed."""

    middle: Array
    duration: Array
    velocity: Array
    speed: Array


def figures(track: Track, window_s: tuple[float | None, float | None] = (None, None)) -> Swimming:
    """Speeds, accelerations and stroke of a track.

    Parameters
    ----------
    track : Track
    window_s : (float or None, float or None)
        From and to, s; with both None the steady part is taken.

    Notes
    -----
    The path is averaged over one stroke, so that the stroke's own swing is gone, and cut into blocks of one
    stroke, each taken as an arc of a circle. The steady part is in the longest run of blocks that are not
    slower than half of the cruise. Its start and its end are cut off by the marginal standard error rule
    [1]_: as few blocks as leave the mean of the rest as sure as can be, within one standard error. What is
    left must hold :data:`MIN_BLOCKS` blocks, and its speed must not change but by chance or by :data:`LEVEL`.

    References
    ----------
    .. [1] White, K. P. (1997). An effective truncation heuristic for bias reduction in simulation output.
       Simulation 69(6), 323-334. doi:10.1177/003754979706900601
    """
    known = np.flatnonzero(np.isfinite(track.smooth).all(axis=0))
    begin, end = float(track.time_s[known[0]]), float(track.time_s[known[-1]])
    kind: Literal["given", "steady part", "whole track"] = "given"
    if window_s == (None, None):
        steady = _steady(_blocks(track, begin, end, _period(_stroke(track, begin, end).beat)))
        kind = "whole track" if steady is None else "steady part"
        begin, end = steady or (begin, end)
    else:
        begin = begin if window_s[0] is None else max(window_s[0], begin)
        end = end if window_s[1] is None else min(window_s[1], end)
    found = _stroke(track, begin, end)
    stroke = found.beat
    blocks = _blocks(track, begin, end, _period(stroke))
    # blocks that cut a slow stroke swing with it; those of a lap follow it
    laps = _turns_round(blocks)
    told = len(blocks.middle) >= 3 and (found.slow is None or laps)
    advance = _positive(mean_of_blocks(blocks.speed, blocks.duration)) if told else None
    if stroke is None and not laps:
        advance = _net_speed(track, begin, end, found.slow)
    vx, vy = blocks.velocity
    return Swimming(
        begin_s=begin,
        end_s=end,
        window=kind,
        path_speed=_path_speed(track, begin, end),
        advance=advance,
        change=_change(blocks.middle, blocks.speed) if told else None,
        acceleration=_slope(blocks.middle, blocks.speed) if told else None,
        acceleration_xy=(_slope(blocks.middle, vx), _slope(blocks.middle, vy)) if told else None,
        stroke=stroke,
        frequency_hz=None if stroke is None else Estimate(stroke.frequency_hz, *stroke.interval_hz),
        amplitudes={} if stroke is None else _amplitudes(track, begin, end, stroke.frequency_hz),
        doubt=found.doubt,
        unknown=found.unknown,
    )


def _level(change: Estimate, speed: float) -> bool:
    told = max(-change.low, change.high) <= TOLD * abs(speed)
    return told and (abs(change.value) <= LEVEL * abs(speed) or change.low <= 0 <= change.high)


def _period(stroke: Beat | None) -> float | None:
    return None if stroke is None else 1.0 / stroke.frequency_hz


@dataclass(frozen=True)
class _Stroke:
    """Stroke of a window and its doubt; or the reason why there is none, and a slow frequency (Hz)."""

    beat: Beat | None = None
    doubt: str = ""
    unknown: str = ""
    slow: float | None = None


def _stroke(track: Track, begin: float, end: float) -> _Stroke:
    """Return the stroke of a window; a track without a heading shows it by its course."""
    rows = np.flatnonzero((track.time_s >= begin) & (track.time_s <= end))
    if len(rows) < 3:
        return _Stroke(unknown="too few samples")
    unknown = ~track.measured[rows]
    vx, vy = track.velocity[:, rows]
    # Channel names are those of the log; which unit of length they carry is nothing to a rhythm.
    columns = {"x_m": track.raw[0, rows], "y_m": track.raw[1, rows]}
    if track.angle is not None and track.raw_angle is not None:
        angle = track.angle[rows]
        columns["yaw_rad"] = track.raw_angle[rows]
        columns["v_m_s"] = vy * np.cos(angle) - vx * np.sin(angle)
    elif _under_way(track.velocity[:, rows]):
        columns["yaw_rad"] = np.unwrap(np.arctan2(vy, vx))
    elif _stays(track.raw[:, rows]):
        columns = {"sway": _farthest(track.raw[:, rows]) @ track.raw[:, rows]}
    columns = {name: np.where(unknown, np.nan, values) for name, values in columns.items()}
    found = rhythm.find(track.time_s[rows], columns)
    if found is None:
        why, frequency_hz = rhythm.unknown(track.time_s[rows], columns)
        why = why if track.angle is not None else why.replace("yaw_rad", "the course")
        return _Stroke(unknown=why, slow=frequency_hz)
    if found.maybe_double:
        return _Stroke(unknown="only motions that may swing twice a stroke keep a beat")

    # Whatever bends swings a little about a cubic: a stroke stands clear of the noise of what was measured.
    def clear(beat: Beat) -> bool:
        return bool(_amplitudes(track, begin, end, beat.frequency_hz))

    if clear(found.beat):
        rivals = {name: beat for name, beat in found.rivals.items() if clear(beat)}
        return _Stroke(found.beat, replace(found, rivals=rivals).doubt)
    others = sorted(found.channels.values(), key=lambda beat: -beat.share)
    other = next((beat for beat in others if clear(beat)), None)
    return _Stroke(other, unknown="" if other else "no beat stands clear of the noise of the track")


def _turns_round(blocks: _Blocks) -> bool:
    """Return whether the course of a path makes at least one full turn."""
    course = np.unwrap(np.arctan2(blocks.velocity[1], blocks.velocity[0]))
    return len(course) > 1 and bool(abs(course[-1] - course[0]) >= 2.0 * np.pi)


def _net_speed(track: Track, begin: float, end: float, frequency_hz: float | None) -> Estimate | None:
    """Return the displacement over time of what was measured in a window."""
    rows = (track.time_s >= begin) & (track.time_s <= end) & track.measured
    rows &= np.isfinite(track.raw).all(axis=0)
    found = tracks.net_speed(track.time_s[rows], track.raw[:, rows].T, frequency_hz)
    return None if found is None else _positive(found)


def _under_way(velocity: Array) -> bool:
    """Whether a point never stops, so that it has a course at all times."""
    speed = np.hypot(*velocity)
    return bool(np.isfinite(speed).all() and speed.min() > SLOWEST * float(speed.mean()))


def _stays(place: Array) -> bool:
    """Whether a point swings about one place.

    The means of the first and the second half are nearer than half of what they are at constant speed.
    """
    known = place[:, np.isfinite(place).all(axis=0)]
    along = _farthest(place) @ known
    half = len(along) // 2
    return bool(abs(along[half:].mean() - along[:half].mean()) < 0.25 * np.ptp(along))


def _farthest(place: Array) -> Array:
    """Unit vector along which positions, shape (2, n), spread most."""
    known = place[:, np.isfinite(place).all(axis=0)]
    return np.asarray(np.linalg.eigh(np.cov(known))[1][:, -1])


def _blocks(track: Track, begin: float, end: float, period: float | None) -> _Blocks:
    """Stretches of whole strokes (of equal duration without a stroke) inside unbroken track."""
    time = track.time_s
    if period is None or period > (end - begin) / 3:
        period = (end - begin) / PLAIN
    # Of what was measured: smoothed samples share their errors, and would seem surer than they are.
    filled = np.where(track.measured & np.isfinite(track.raw), track.raw, track.smooth)
    path = np.array([_averaged(time, row, period) for row in filled])
    known = np.isfinite(path[0])
    if not known.any():
        return _Blocks(*(np.zeros(0),) * 2, np.zeros((2, 0)), np.zeros(0))
    begin, end = max(begin, float(time[known][0])), min(end, float(time[known][-1]))
    length = period * max(math.ceil((end - begin) / period / MAX_BLOCKS), 1)
    edges = end - length * np.arange(int((end - begin) / length + 1e-6), -1, -1)
    place = np.array([np.interp(edges, time[known], row[known]) for row in path])
    step = float(np.median(np.diff(time)))
    holes = np.concatenate(([0], np.cumsum(~known)))
    first, last = np.searchsorted(time, edges[:-1] - step / 2), np.searchsorted(time, edges[1:] + step / 2)
    whole = holes[np.minimum(last, len(time))] == holes[first]
    velocity = np.diff(place, axis=1) / length
    speed = np.hypot(*velocity)
    if len(speed) > 1:
        turn = np.abs(np.gradient(np.unwrap(np.arctan2(velocity[1], velocity[0]))))
        # A chord is shorter than its arc, and an average over an arc lies inside of it by the same factor.
        speed = speed / np.where(turn < LARGEST_TURN, np.sinc(turn / (2 * np.pi)), 1.0) ** 2
    middle = 0.5 * (edges[:-1] + edges[1:])
    return _Blocks(middle[whole], np.full(int(whole.sum()), length), velocity[:, whole], speed[whole])


def _steady(blocks: _Blocks) -> tuple[float, float] | None:
    """Start and end of the steady part, s; None where there is none."""
    if len(blocks.speed) < MIN_BLOCKS:
        return None
    under_way = blocks.speed >= CRUISE * float(np.percentile(blocks.speed, 90))
    first, end = max(runs(under_way).tolist(), key=lambda run: run[1] - run[0])
    first += _transient(blocks.speed[first:end], START)
    end -= _transient(blocks.speed[first:end][::-1], STOP)
    middle, speed = blocks.middle[first:end], blocks.speed[first:end]
    if len(speed) < MIN_BLOCKS or not _level(_change(middle, speed), float(speed.mean())):
        return None
    half = 0.5 * float(blocks.duration[first])
    return float(middle[0]) - half, float(middle[-1]) + half


def _transient(speed: Array, most: float) -> int:
    """How many blocks to cut off in front: the fewest with a squared standard error as good as the least."""
    counts = np.array([len(speed) - k for k in range(int(most * len(speed)) + 1) if len(speed) - k >= 3])
    if not len(counts):
        return 0
    scores = np.array([float(np.var(speed[len(speed) - n :], ddof=1)) / n for n in counts])
    best = int(np.argmin(scores))
    # A variance of n samples has the relative standard error sqrt(2 / (n - 1)).
    return int(np.argmax(scores <= scores[best] * (1 + math.sqrt(2 / (counts[best] - 1)))))


def _change(middle: Array, speed: Array) -> Estimate:
    """How much the speed changes from the first to the last block."""
    span, slope = float(middle[-1] - middle[0]), _slope(middle, speed)
    return Estimate(span * slope.value, span * slope.low, span * slope.high)


def _slope(time: Array, values: Array) -> Estimate:
    """Slope of a line with its 95 % interval, widened where neighbours are not independent."""
    design = np.column_stack([np.ones(len(time)), time - time.mean()])
    weights = np.linalg.lstsq(design, values, rcond=None)[0]
    left = values - design @ weights
    freedom = max(len(time) - 2, 1)
    stderr = math.sqrt(float(left @ left) / freedom / float(design[:, 1] @ design[:, 1]))
    together = float(left[1:] @ left[:-1] / max(float(left @ left), 1e-300))
    together = min(max(together, 0.0), 0.8)
    from scipy import special

    half = float(special.stdtrit(freedom, 0.975)) * stderr * math.sqrt((1 + together) / (1 - together))
    return Estimate(float(weights[1]), float(weights[1]) - half, float(weights[1]) + half)


def _path_speed(track: Track, begin: float, end: float) -> Estimate | None:
    rows = (track.time_s >= begin) & (track.time_s <= end)
    time, good = track.time_s[rows], track.measured[rows]
    cleaning = Cleaning(good, ~good & False, ~good & False, 0, [], gaps(time, good))
    found = tracks.speed(time, list(track.raw[:, rows]), cleaning)
    return None if found is None else _positive(found.path)


def _positive(speed: Estimate) -> Estimate:
    """A speed is not negative, nor does its interval go there."""
    return Estimate(speed.value, max(speed.low, 0.0), speed.high)


def _amplitudes(track: Track, begin: float, end: float, frequency: float) -> dict[str, Estimate]:
    """Amplitudes at the stroke across the mean heading and of the heading, over stretches of two strokes.

    Without a heading across the mean path, or along the swing of a point that stays in place.
    """
    time, smooth = track.time_s, track.smooth
    rows = (time >= begin) & (time <= end)
    mean = np.array([_averaged(time, row, 1 / frequency) for row in smooth])
    off = track.raw - mean
    heading = None if track.angle is None else _averaged(time, track.angle, 1 / frequency)
    if heading is not None:
        across = np.array([-np.sin(heading), np.cos(heading)])
    elif not _under_way(track.velocity[:, rows]) and _stays(track.raw[:, rows]):
        across = _farthest(track.raw[:, rows])[:, None]
    else:
        way = np.gradient(mean, time, axis=1)
        across = np.array([-way[1], way[0]]) / np.maximum(np.hypot(*way), 1e-300)
    channels = {"sway": np.sum(off * across, axis=0)}
    if track.raw_angle is not None and heading is not None:
        channels["turn"] = track.raw_angle - heading
    found = {}
    for name, values in channels.items():
        amplitude = _amplitude(time, np.where(track.measured, values, np.nan), begin, end, frequency)
        least = AMPLITUDE_Z * (track.error if name == "sway" else track.angle_error)
        if amplitude is not None and amplitude.value >= least:
            found[name] = amplitude
    return found


def _averaged(time: Array, values: Array, period: float) -> Array:
    """Running mean over one period; NaN where the period is not known all through."""
    known = np.isfinite(values)
    safe = np.where(known, values, 0.0)
    area = np.concatenate(([0.0], np.cumsum(0.5 * np.diff(time) * (safe[1:] + safe[:-1]))))
    holes = np.concatenate(([0], np.cumsum(~known)))
    low, high = time - period / 2, time + period / 2
    mean = (np.interp(high, time, area) - np.interp(low, time, area)) / period
    inside = (low >= time[0]) & (high <= time[-1])
    whole = holes[np.searchsorted(time, high, "right")] == holes[np.searchsorted(time, low)]
    return np.where(inside & whole, mean, np.nan)


def _amplitude(time: Array, values: Array, begin: float, end: float, frequency: float) -> Estimate | None:
    """Mean amplitude of a sine fitted to stretches of :data:`STROKES` strokes; None where it is noise."""
    inside = (time >= begin) & (time <= end) & np.isfinite(values)
    if not inside.any():
        return None
    begin, end = float(time[inside][0]), float(time[inside][-1])
    strokes = min(STROKES, (end - begin) * frequency)
    if strokes < 1:
        return None
    length = strokes / frequency
    count = int((end - begin) / length * (1 + 1e-6))
    sizes, errors = [], []
    for start in begin + length * np.arange(count):
        rows = inside & (time >= start) & (time < start + length)
        if rows.sum() < 8:
            continue
        t = time[rows] - start
        design = np.column_stack((waves(t, frequency), np.ones(len(t)), t - t.mean()))
        weights, *_ = np.linalg.lstsq(design, values[rows], rcond=None)
        left = values[rows] - design @ weights
        sizes.append(float(np.hypot(weights[0], weights[1])))
        errors.append(math.sqrt(2 * float(left @ left) / max(len(t) - 4, 1) / len(t)))
    if not sizes:
        return None
    mean, error = float(np.mean(sizes)), math.sqrt(float(np.mean(np.square(errors))))
    if mean < AMPLITUDE_Z * error:
        return None
    if len(sizes) < 3:
        half = 1.96 * error / math.sqrt(len(sizes))
        return Estimate(mean, mean - half, mean + half)
    return mean_of_blocks(np.array(sizes), np.ones(len(sizes)))
