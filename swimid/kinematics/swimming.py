"""Speed and stroke of a swimmer from its track, in the steady part of a log."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from swimid.kinematics.cycles import block_speeds
from swimid.kinematics.frequency import Beat, waves
from swimid.kinematics.speed import TrackEstimate, error_factor, mean_of_blocks, measure_speed
from swimid.kinematics.stroke import StrokeEstimate, find_stroke
from swimid.logs.log import runs

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]


#: Number of blocks into which a track without a stroke is divided (N_BLOCKS), and maximum number of blocks of
#: any track (MAX_BLOCKS). In a track with more strokes than MAX_BLOCKS, each block has several strokes.
N_BLOCKS, MAX_BLOCKS = 20, 200
#: Minimum number of measured samples in the window of a track from which speeds are computed.
MIN_WINDOW_SAMPLES = 12
#: Minimum number of blocks in a period of steady swimming. With fewer blocks a trend of the speed cannot be
#: distinguished from random variation.
MIN_BLOCKS = 5
#: Minimum speed of a block of a track that belongs to the cruise, divided by the 90th percentile of the block
#: speeds. Slower blocks are start, coasting or rest.
MIN_CRUISE = 0.5
#: Maximum change of the speed over a period of steady swimming, divided by the mean speed. A larger change is
#: accepted if it does not differ significantly from zero.
MAX_CHANGE = 0.02
#: Maximum magnitude of the limits of the 95 % interval of the speed change over a period of steady swimming,
#: divided by the mean speed.
MAX_CHANGE_REACH = 0.2
#: Maximum fraction of the cruise blocks of a track that are left out as the start of the motion (MAX_START),
#: and maximum fraction of the remaining blocks that are left out as its end (MAX_END).
MAX_START, MAX_END = 1 / 2, 1 / 3
#: Number of strokes in each segment of a track to which a sine is fitted, for the amplitude of the stroke.
N_STROKES = 2.0
#: Minimum ratio of a significant stroke amplitude to its standard error. The same minimum applies to its
#: ratio to the systematic error of the track.
AMPLITUDE_Z = 3.0
#: Minimum ratio of the lowest speed of a tracked point to its mean speed. Below this ratio the point nearly
#: stops, and its course is not defined at all times.
MIN_SPEED_SHARE = 0.2


@dataclass(frozen=True)
class SwimTrack:
    """Measured and smoothed positions and headings of a robot, with all lengths in the same unit.

    Attributes
    ----------
    time_s : ndarray, shape (n,)
        Sample times, s.
    measured : ndarray of bool, shape (n,)
        Whether each sample is measured, not interpolated.
    raw, smooth, velocity : ndarray, shape (2, n)
        Measured position, smoothed position, and velocity; NaN where missing.
    raw_angle, angle : ndarray, shape (n,), or None
        Measured heading and smoothed heading, unwrapped, rad.
    error, angle_error : float
        Standard deviation of the systematic errors of position and of heading (rad), which do not average
        out.
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
    """Speeds, accelerations and stroke in one window of a track, in the track's unit of length, s and rad.

    Attributes
    ----------
    begin_s, end_s : float
        Start and end of the window, s.
    window : str
        Choice of the window: ``given`` by the user, ``steady part`` of the track, or ``whole track`` if no
        part is steady.
    path_speed : TrackEstimate or None
        Mean of the speed along the path, including sway; None if no segment is long enough.
    advance : TrackEstimate or None
        Mean speed along the path averaged over strokes. In a steady window this is the steady speed. Without
        a stroke it is the displacement divided by the duration, or, if the course makes a full rotation, the
        mean speed of the blocks.
    change : TrackEstimate or None
        Change of the advance speed from the start to the end of the window.
    acceleration : TrackEstimate or None
        Mean rate of change of the advance speed.
    acceleration_xy : tuple of TrackEstimate, or None
        Mean rates of change of the coordinates of the velocity.
    stroke : StrokeEstimate
        Stroke in the window, or the reason why none is found.
    amplitudes : dict of str to TrackEstimate
        Significant amplitudes at the stroke frequency: ``sway`` across the mean heading (across the path if
        there is no heading), and ``turn``, the amplitude of the heading (rad).
    """

    begin_s: float
    end_s: float
    window: Literal["given", "steady part", "whole track"]
    path_speed: TrackEstimate | None
    advance: TrackEstimate | None
    change: TrackEstimate | None
    acceleration: TrackEstimate | None
    acceleration_xy: tuple[TrackEstimate, TrackEstimate] | None
    stroke: StrokeEstimate
    amplitudes: dict[str, TrackEstimate]

    @property
    def frequency_hz(self) -> TrackEstimate | None:
        """Frequency of the stroke, Hz, with its 95 % interval; None if no stroke is found."""
        if self.stroke.beat is None:
            return None
        return TrackEstimate(self.stroke.beat.frequency_hz, *self.stroke.beat.interval_hz)

    @property
    def steady(self) -> bool:
        """Whether the change of the swimming speed over the window is small or not significant."""
        if self.advance is None or self.change is None:
            return False
        return _is_level(self.change, self.advance.value)


@dataclass(frozen=True)
class _Blocks:
    """Speeds in successive blocks of a track, each of one or several strokes.

    The fields are the middle of each of the n blocks (s), its velocity, shape (2, n), its speed along the
    arc, and the duration of a block (s).
    """

    middle: Array
    velocity: Array
    speed: Array
    duration_s: float

    @property
    def turn_round(self) -> bool:
        """Whether the course of the track makes at least one full rotation."""
        course = np.unwrap(np.arctan2(self.velocity[1], self.velocity[0]))
        return len(course) > 1 and bool(abs(course[-1] - course[0]) >= 2.0 * np.pi)


def measure_swimming(
    track: SwimTrack, window_s: tuple[float | None, float | None] = (None, None)
) -> Swimming:
    """Measure the speeds, the accelerations and the stroke of a track.

    Parameters
    ----------
    window_s : (float or None, float or None)
        Start and end of the window, s. If both are None, the steady part is used.

    Notes
    -----
    The path is averaged over one stroke, which removes the oscillation of the body. It is then cut into
    blocks of one stroke, each of which is taken for an arc of a circle (:func:`block_speeds`). The steady
    part lies in the longest sequence of blocks that are not slower than :data:`MIN_CRUISE` of the cruise
    speed. The start and the end of this sequence are cut off by the marginal standard error rule [1]_. The
    rule cuts off as many blocks as minimise the standard error of the mean of the remaining blocks. If
    several numbers are equally good within the uncertainty of that error, the smallest number is cut off. The
    steady part must have :data:`MIN_BLOCKS` blocks. The change of its speed must not be significant, or must
    be at most :data:`MAX_CHANGE`.

    References
    ----------
    .. [1] White, K. P. (1997). An effective truncation heuristic for bias reduction in simulation output.
       Simulation 69(6), 323-334. doi:10.1177/003754979706900601
    """
    begin, end, window = _choose_window(track, window_s)
    stroke = _find_stroke(track, begin, end)
    blocks = _blocks(track, begin, end, stroke.frequency_hz)
    inside = (track.time_s >= begin) & (track.time_s <= end)
    place = np.where(track.measured, track.raw, np.nan)[:, inside].T
    mean = measure_speed(track.time_s[inside], place, stroke.slow_hz)
    path = line = advance = change = acceleration = across = None
    amplitudes = {}
    if mean is not None:
        path, line = mean.path, mean.line
    # Do not compute speeds if a periodic motion is slower than the blocks, because the block speeds oscillate
    # with it. Laps of the path are no such motion.
    if len(blocks.middle) >= 3 and (stroke.slow_hz is None or blocks.turn_round):
        durations = np.full(len(blocks.speed), blocks.duration_s)
        advance = mean_of_blocks(blocks.speed, durations).cut_at_zero()
        change = _change(blocks.middle, blocks.speed)
        acceleration = _slope(blocks.middle, blocks.speed)
        across = (_slope(blocks.middle, blocks.velocity[0]), _slope(blocks.middle, blocks.velocity[1]))
    if stroke.beat is not None:
        amplitudes = _amplitudes(track, begin, end, stroke.beat.frequency_hz)
    elif not blocks.turn_round:
        advance = line
    speeds = path, advance, change, acceleration, across
    return Swimming(begin, end, window, *speeds, stroke, amplitudes)


def _choose_window(
    track: SwimTrack, window_s: tuple[float | None, float | None]
) -> tuple[float, float, Literal["given", "steady part", "whole track"]]:
    """Return start and end, s, of the window in which a track is measured, and the kind of the window."""
    known = track.time_s[np.isfinite(track.smooth).all(axis=0)]
    begin, end = float(known[0]), float(known[-1])
    low, high = window_s
    if low is None and high is None:
        steady = _steady_part(_blocks(track, begin, end, _find_stroke(track, begin, end).frequency_hz))
        if steady is None:
            return begin, end, "whole track"
        return *steady, "steady part"
    if low is not None:
        begin = max(low, begin)
    if high is not None:
        end = min(high, end)
    return begin, end, "given"


def _is_level(change: TrackEstimate, speed: float) -> bool:
    """Return whether a change of the swimming speed is so small that the speed counts as constant.

    The 95 % interval of the change must be small relative to the speed. In addition the change itself must be
    small or not significant.
    """
    if max(-change.low, change.high) > MAX_CHANGE_REACH * abs(speed):
        return False
    return abs(change.value) <= MAX_CHANGE * abs(speed) or change.low <= 0 <= change.high


def _find_stroke(track: SwimTrack, begin: float, end: float) -> StrokeEstimate:
    """Find the stroke in a window of a track.

    In a track without a heading, the direction of travel is searched for the stroke instead.
    """
    rows = np.flatnonzero((track.time_s >= begin) & (track.time_s <= end))
    if len(rows) < 3:
        return StrokeEstimate(unknown="too few samples")
    raw, (vx, vy) = track.raw[:, rows], track.velocity[:, rows]
    # Use the column names of the log format, even if the unit of length is not the metre.
    columns = {"x_m": raw[0], "y_m": raw[1]}
    if track.angle is not None and track.raw_angle is not None:
        angle = track.angle[rows]
        columns["yaw_rad"] = track.raw_angle[rows]
        columns["v_m_s"] = vy * np.cos(angle) - vx * np.sin(angle)
    elif _is_under_way(track.velocity[:, rows]):
        columns["yaw_rad"] = np.unwrap(np.arctan2(vy, vx))
    elif _stays(raw):
        columns = {"sway": _long_axis(raw) @ raw}
    columns = {name: np.where(track.measured[rows], values, np.nan) for name, values in columns.items()}
    found = find_stroke(track.time_s[rows], columns)
    if found.beat is None:
        if track.angle is None:
            found = replace(found, unknown=found.unknown.replace("yaw_rad", "the course"))
        return found
    if found.maybe_double:
        return StrokeEstimate(unknown="only motions that may swing twice a stroke keep a beat")

    # Accept a stroke only if its amplitude is significant in the track. Any bend of a path deviates from a
    # cubic polynomial and may look like a beat.
    def is_significant(beat: Beat) -> bool:
        return bool(_amplitudes(track, begin, end, beat.frequency_hz))

    if is_significant(found.beat):
        return replace(found, rivals={n: beat for n, beat in found.rivals.items() if is_significant(beat)})
    for name, beat in sorted(found.channels.items(), key=lambda item: -item[1].share):
        if is_significant(beat):
            return replace(found, beat=beat, channel=name, rivals={})
    return StrokeEstimate(unknown="no beat stands clear of the noise of the track")


def _is_under_way(velocity: Array) -> bool:
    """Return whether a point of the robot never stops, so that its course is defined at all times."""
    speed = np.hypot(*velocity)
    return bool(np.isfinite(speed).all() and speed.min() > MIN_SPEED_SHARE * float(speed.mean()))


def _stays(place: Array) -> bool:
    """Return whether a point of the robot oscillates about one place.

    The criterion is the distance between the mean positions of the first and the second half of the track. It
    must be smaller than half of the distance for a motion at constant speed.
    """
    along = _long_axis(place) @ place[:, np.isfinite(place).all(axis=0)]
    half = len(along) // 2
    return bool(abs(along[half:].mean() - along[:half].mean()) < 0.25 * np.ptp(along))


def _long_axis(place: Array) -> Array:
    """Return the unit vector along which positions, shape (2, n), have the largest variance."""
    known = place[:, np.isfinite(place).all(axis=0)]
    return np.asarray(np.linalg.eigh(np.cov(known))[1][:, -1])


def _amplitudes(track: SwimTrack, begin: float, end: float, frequency: float) -> dict[str, TrackEstimate]:
    """Return the amplitudes of sway and heading at a frequency, if they are significant.

    The sway is the motion across the mean heading. Without a heading it is the motion across the mean path,
    or, for a point that stays in place, along the direction of its largest motion.
    """
    time = track.time_s
    rows = (time >= begin) & (time <= end)
    mean = np.array([_mean_over_period(time, row, 1 / frequency) for row in track.smooth])
    channels, errors = {}, {"sway": track.error, "turn": track.angle_error}
    if track.angle is not None:
        heading = _mean_over_period(time, track.angle, 1 / frequency)
        across = np.array([-np.sin(heading), np.cos(heading)])
        if track.raw_angle is not None:
            channels["turn"] = track.raw_angle - heading
    elif not _is_under_way(track.velocity[:, rows]) and _stays(track.raw[:, rows]):
        across = _long_axis(track.raw[:, rows])[:, None]
    else:
        way = np.gradient(mean, time, axis=1)
        across = np.array([-way[1], way[0]]) / np.maximum(np.hypot(*way), 1e-300)
    channels = {"sway": np.sum((track.raw - mean) * across, axis=0), **channels}
    found = {}
    for name, values in channels.items():
        inside = rows & track.measured & np.isfinite(values)
        amplitude = _amplitude(time[inside], values[inside], frequency)
        if amplitude is not None and amplitude.value >= AMPLITUDE_Z * errors[name]:
            found[name] = amplitude
    return found


def _amplitude(time: Array, values: Array, frequency: float) -> TrackEstimate | None:
    """Return the mean amplitude of sines fitted to successive strokes; None if it is not significant."""
    if not len(time):
        return None
    strokes = min(N_STROKES, float(time[-1] - time[0]) * frequency)
    if strokes < 1:
        return None
    length = strokes / frequency
    sizes, variances = [], []
    for start in time[0] + length * np.arange(int((time[-1] - time[0]) / length * (1 + 1e-6))):
        rows = (time >= start) & (time < start + length)
        if rows.sum() < 8:
            continue
        t = time[rows] - start
        design = np.column_stack((waves(t, frequency), np.ones(len(t)), t - t.mean()))
        weights = np.linalg.lstsq(design, values[rows], rcond=None)[0]
        residual = values[rows] - design @ weights
        sizes.append(float(np.hypot(weights[0], weights[1])))
        variances.append(2 * float(residual @ residual) / max(len(t) - 4, 1) / len(t))
    if not sizes:
        return None
    mean, error = float(np.mean(sizes)), math.sqrt(float(np.mean(variances)))
    if mean < AMPLITUDE_Z * error:
        return None
    if len(sizes) < 3:
        half = 1.96 * error / math.sqrt(len(sizes))
        return TrackEstimate(mean, mean - half, mean + half)
    return mean_of_blocks(np.array(sizes), np.ones(len(sizes)))


def _mean_over_period(time: Array, values: Array, period: float) -> Array:
    """Return the running mean of a channel over one period; NaN where the period has missing samples."""
    known = np.isfinite(values)
    safe = np.where(known, values, 0.0)
    area = np.concatenate(([0.0], np.cumsum(0.5 * np.diff(time) * (safe[1:] + safe[:-1]))))
    holes = np.concatenate(([0], np.cumsum(~known)))
    low, high = time - period / 2, time + period / 2
    mean = (np.interp(high, time, area) - np.interp(low, time, area)) / period
    inside = (low >= time[0]) & (high <= time[-1])
    whole = holes[np.searchsorted(time, high, "right")] == holes[np.searchsorted(time, low)]
    return np.where(inside & whole, mean, np.nan)


def _blocks(track: SwimTrack, begin: float, end: float, frequency_hz: float | None) -> _Blocks:
    """Return the speeds of a track in successive blocks of whole strokes, without blocks that have gaps.

    Without a stroke the blocks have equal durations.
    """
    time = track.time_s
    period = (end - begin) / N_BLOCKS
    if frequency_hz is not None and 1.0 / frequency_hz <= (end - begin) / 3:
        period = 1.0 / frequency_hz
    # Use measured samples where there are any, because the errors of smoothed samples are correlated.
    filled = np.where(track.measured & np.isfinite(track.raw), track.raw, track.smooth)
    path = np.array([_mean_over_period(time, row, period) for row in filled])
    known = np.isfinite(path[0])
    if not known.any():
        return _Blocks(np.zeros(0), np.zeros((2, 0)), np.zeros(0), period)
    begin, end = max(begin, float(time[known][0])), min(end, float(time[known][-1]))
    length = period * max(math.ceil((end - begin) / period / MAX_BLOCKS), 1)
    edges = end - length * np.arange(int((end - begin) / length + 1e-6), -1, -1)
    place = np.array([np.interp(edges, time[known], row[known]) for row in path])
    step = float(np.median(np.diff(time)))
    holes = np.concatenate(([0], np.cumsum(~known)))
    first, last = np.searchsorted(time, edges[:-1] - step / 2), np.searchsorted(time, edges[1:] + step / 2)
    whole = holes[np.minimum(last, len(time))] == holes[first]
    velocity = np.diff(place, axis=1) / length
    speed = block_speeds(place, length)
    middle = 0.5 * (edges[:-1] + edges[1:])
    return _Blocks(middle[whole], velocity[:, whole], speed[whole], length)


def _steady_part(blocks: _Blocks) -> tuple[float, float] | None:
    """Return start and end of the period of steady swimming, s; None if no period is steady."""
    if len(blocks.speed) < MIN_BLOCKS:
        return None
    under_way = blocks.speed >= MIN_CRUISE * float(np.percentile(blocks.speed, 90))
    first, end = max(runs(under_way).tolist(), key=lambda run: run[1] - run[0])
    first += _transient(blocks.speed[first:end], MAX_START)
    end -= _transient(blocks.speed[first:end][::-1], MAX_END)
    middle, speed = blocks.middle[first:end], blocks.speed[first:end]
    if len(speed) < MIN_BLOCKS or not _is_level(_change(middle, speed), float(speed.mean())):
        return None
    half = 0.5 * blocks.duration_s
    return float(middle[0]) - half, float(middle[-1]) + half


def _transient(speed: Array, most: float) -> int:
    """Return the number of blocks at the beginning of a track that belong to the start of the motion.

    At most the fraction ``most`` of all blocks is cut off. The result is the smallest number for which the
    squared standard error of the mean speed of the remaining blocks is within one standard error of its
    minimum.
    """
    counts = len(speed) - np.arange(int(most * len(speed)) + 1)
    counts = counts[counts >= 3]
    if not len(counts):
        return 0
    scores = np.array([float(np.var(speed[len(speed) - n :], ddof=1)) / n for n in counts])
    best = int(np.argmin(scores))
    # Allow for the relative standard error of a variance that is estimated from n samples, sqrt(2 / (n - 1)).
    return int(np.argmax(scores <= scores[best] * (1 + math.sqrt(2 / (counts[best] - 1)))))


def _change(middle: Array, speed: Array) -> TrackEstimate:
    """Return the change of speed from the first to the last block of a track, according to a fitted line."""
    span, slope = float(middle[-1] - middle[0]), _slope(middle, speed)
    return TrackEstimate(span * slope.value, span * slope.low, span * slope.high)


def _slope(time: Array, values: Array) -> TrackEstimate:
    """Return the slope of a line fitted to values over time, with its 95 % interval.

    The interval is widened for correlated residuals.
    """
    design = np.column_stack([np.ones(len(time)), time - time.mean()])
    weights = np.linalg.lstsq(design, values, rcond=None)[0]
    residual = values - design @ weights
    freedom = max(len(time) - 2, 1)
    squares = float(residual @ residual)
    stderr = math.sqrt(squares / freedom / float(design[:, 1] @ design[:, 1]))
    return TrackEstimate.from_stderr(float(weights[1]), stderr * error_factor(residual), freedom)
