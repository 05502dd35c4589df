"""Stroke of a swimmer from all channels of a log."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from swimid.kinematics.frequency import (
    MIN_CYCLES,
    MIN_SHARE,
    Beat,
    demodulate,
    find_beats,
    find_slow_motion,
    multiple,
    waves,
)
from swimid.logs.log import FREQUENCY_RTOL, unwrap_angle
from swimid.logs.sampling import longest_even, quantum

Array = NDArray[np.float64]


#: Pattern of the channels that oscillate once per stroke, because their signs in the two half strokes are
#: opposite.
SIDEWAYS = re.compile(
    r"(joint|cmd|fin|tail)\w*(?<!_likelihood)(?<!_area_px)|yaw_rad|yaw_rate_rad_s|roll_rad|pitch_rad|"
    r"pitch_rate_rad_s|v_m_s|w_m_s|w[xyz]_rad_s|ay_m_s2|sway"
)
#: Pattern of the channels that may oscillate twice per stroke, because the robot is pushed forward in both
#: half strokes.
PUSHED = re.compile(r"u_m_s|a[xz]_m_s2|force_N")
#: Pattern of the channels that show the drive: commands, and angles of joints, fins and tail. If one of them
#: is logged, its frequency is taken for the stroke frequency.
DRIVEN = re.compile(r"cmd\w*|(joint|fin|tail)\w*_rad(_s)?")
#: Names of the channels returned by :func:`swing` that may oscillate twice per stroke.
ALONG = ("surge", "long_axis", "short_axis")
#: Pattern of the channels that show a sideways motion of the body.
MOVED = re.compile(r"sway|v_m_s|w_m_s|ay_m_s2|(joint|fin|tail)\w*_(m|px)")
#: Patterns of the channels that show one kind of motion (heading, sway, ...), one pattern for each kind.
#: Several channels of the same kind of motion count once.
_TURNED = (r"yaw_\w+|wz_rad_s", r"roll_rad|wx_rad_s", r"pitch_\w+|wy_rad_s")
_AHEAD = rf"{PUSHED.pattern}|surge|\w+_axis"
MOTIONS = tuple(map(re.compile, (DRIVEN.pattern, MOVED.pattern, *_TURNED, _AHEAD)))
#: Pattern of the columns that are not searched for a stroke: positions (see :func:`swing`), standard
#: deviations, likelihoods and states.
NO_MOTION = re.compile(
    r"[xyz](_raw)?_(m|px)|sd_.*|.*_sd(_.*)?|.*likelihood|.*confidence|.*area_px|interpolated|status|frame"
)
#: Maximum ratio of the smaller to the larger of the two counter-rotating components of a periodic path that
#: counts as a lap. For an ellipse with half axes a and b the ratio is (a - b) / (a + b). Below the maximum
#: the circular component of the path has more power than the linear component.
MAX_LAP_RATIO = np.sqrt(2.0) - 1.0
#: Maximum order of a harmonic that laps of the path cause (MAX_LAP_HARMONIC): a rectangular pool has four
#: corners. Maximum order of a harmonic that rotation causes in a compass heading (MAX_COMPASS_HARMONIC): the
#: deviation of a compass has one or two periods per rotation (semicircular and quadrantal deviation).
MAX_LAP_HARMONIC, MAX_COMPASS_HARMONIC = 4, 2
#: Maximum frequency of a stroke, Hz. Faster motion is taken for vibration. Bainbridge (J. Exp. Biol. 35,
#: 1958) found 25 Hz for dace of 5 cm and 20 Hz for dace of 8 cm.
MAX_STROKE_HZ = 20.0
#: Maximum sample rate in the search for a beat, Hz. Channels with a higher rate are averaged over blocks of
#: samples.
MAX_RATE_HZ = 60.0
#: Minimum fraction of a channel's samples in its longest gap-free segment (MIN_STRETCH_SHARE). If the segment
#: has this fraction, only the segment is searched for a beat. If it has less, all samples are searched,
#: unless there are more than MAX_SAMPLES.
MIN_STRETCH_SHARE, MAX_SAMPLES = 0.8, 20_000


@dataclass(frozen=True)
class StrokeEstimate:
    """Stroke of a log or a track, and the channels in which it was found; or the reason why none is found.

    Attributes
    ----------
    beat : Beat or None
        Beat of the channel whose frequency has the smallest standard error; None if no stroke is found.
    channel : str
        Name of the channel of ``beat``.
    channels : dict of str to Beat
        Strongest beat of each channel that has a beat.
    rivals : dict of str to Beat
        Largest beat of each channel whose frequency is no multiple of the stroke frequency. Such a beat
        contradicts the stroke.
    unknown : str
        Reason why no stroke is found; empty if one is found.
    slow_hz : float or None
        Without a stroke: frequency of a periodic motion of too few cycles, Hz, if there is one.
    """

    beat: Beat | None = None
    channel: str = ""
    channels: dict[str, Beat] = field(default_factory=dict)
    rivals: dict[str, Beat] = field(default_factory=dict)
    unknown: str = ""
    slow_hz: float | None = None

    @property
    def frequency_hz(self) -> float | None:
        """Frequency of the stroke, Hz; None if no stroke is found."""
        return None if self.beat is None else self.beat.frequency_hz

    @property
    def maybe_double(self) -> bool:
        """Whether only channels that may oscillate twice per stroke show a beat.

        The frequency may then be twice that of the stroke.
        """
        return self.channel in ALONG or PUSHED.fullmatch(self.channel) is not None

    @property
    def doubt(self) -> str:
        """Reason to doubt this stroke, as text for a message; empty if there is no reason."""
        if self.beat is None:
            return ""
        said, hz = [], f"{self.beat.frequency_hz:.4g} Hz"
        if self.rivals:
            others = " and ".join(f"{n} at {b.frequency_hz:.4g} Hz" for n, b in self.rivals.items())
            said.append(
                f"{self.channel} beats at {hz}, {others}, which is no multiple: either is a vibration or "
                "sway, not the stroke"
            )
        if self.beat.frequency_hz > MAX_STROKE_HZ:
            said.append(f"{hz} is faster than robots and all but very small fish beat")
        return "; ".join(said)


def swing(columns: Mapping[str, Array], share: float = 1.0 / MIN_CYCLES) -> dict[str, Array]:
    """Return the oscillation of a track about its averaged path, in the unit of the track.

    Parameters
    ----------
    columns : mapping of str to ndarray, each shape (n,)
        Columns with two of ``x_m``, ``y_m``, ``z_m`` (or the same in ``_px``). A single coordinate is
        returned as ``surge``.
    share : float
        Fraction of the samples over which the path is averaged. By default this is one cycle of the slowest
        stroke that is searched for.

    Returns
    -------
    dict of str to ndarray
        Components of the oscillation: ``sway`` across the averaged path and ``surge`` along this path. For a
        body that stays in place, ``long_axis`` and ``short_axis``. Empty without a track.
    """
    axes = _coordinates(columns)
    if not axes:
        return {}
    place = np.column_stack(axes)
    there = np.isfinite(place).all(axis=1)
    if there.sum() < 16 or not np.ptp(place[there], axis=0).any():
        return {}
    if place.shape[1] == 1:
        return {"surge": place[:, 0]}
    width = max(int(there.sum() * share) | 1, 5)
    path, tangent = _average_path(place[there], width)
    about = place[there] - path
    ways = ("surge", "sway")
    if np.median(np.linalg.norm(tangent, axis=1)) * width < 2.0 * float(np.sqrt(np.mean(about**2))):
        ways = ("long_axis", "short_axis")
        tangent = np.broadcast_to(np.linalg.svd(about, full_matrices=False)[2][0], about.shape)
    tangent = tangent / np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-300)
    normal = np.column_stack((-tangent[:, 1], tangent[:, 0]))
    found = {way: np.full(len(place), np.nan) for way in ways}
    for way, axis in zip(ways, (tangent, normal), strict=True):
        found[way][there] = np.sum(about * axis, axis=1)
    return found


def _average_path(place: Array, width: int) -> tuple[Array, Array]:
    """Return values and slopes of straight lines fitted to ``width`` samples around each sample of a path.

    The slopes are per sample. Within half a window of either end of the path, the line of the first or last
    complete window is used.
    """
    half, rows = width // 2, np.arange(len(place))
    middle = np.clip(rows, half, len(place) - 1 - half)
    offsets = np.arange(-half, half + 1)
    centred = place - place.mean(axis=0)
    sums = np.pad(np.cumsum([centred, rows[:, None] * centred], axis=1), ((0, 0), (1, 0), (0, 0)))
    total, moment = sums[:, middle + half + 1] - sums[:, middle - half]
    slopes = (moment - middle[:, None] * total) / (offsets @ offsets)
    return place.mean(axis=0) + total / width + slopes * (rows - middle)[:, None], slopes


def coordinate_columns(columns: Mapping[str, Array]) -> list[str]:
    """Return the names of the position columns of a log: those in metres, or if there are none, in pixels."""
    metres, pixels = ([n for n in (f"x_{u}", f"y_{u}", f"z_{u}") if n in columns] for u in ("m", "px"))
    return metres or pixels


def _coordinates(columns: Mapping[str, Array]) -> list[Array]:
    """Return the samples of a log's first two position columns, or of the only one; empty without any."""
    return [columns[name] for name in coordinate_columns(columns)[:2]]


def find_stroke(
    time_s: Array,
    columns: Mapping[str, Array],
    *,
    range_hz: tuple[float, float] | None = None,
    stated_hz: float | None = None,
    time_sd_s: float = 0.0,
) -> StrokeEstimate:
    """Find the stroke of a swimmer (its beat frequency) in the channels of a log or a track.

    Parameters
    ----------
    time_s : ndarray, shape (n,)
        Sample times, s.
    columns : mapping of str to ndarray, each shape (n,)
        Channels with names of the log format; NaN where missing.
    range_hz : (float, float), optional
        Lowest and highest frequency of the search, Hz.
    stated_hz : float, optional
        Stated frequency of the drive, Hz. If the search over all frequencies finds nothing, a search near
            this frequency follows, which accepts weaker beats.
    time_sd_s : float
        Standard deviation of the errors of the first and the last time, s. The standard error of the
        frequency includes it.

    Notes
    -----
    If the drive is logged, the stroke frequency is the frequency of the drive. Otherwise it is the frequency
    found in most kinds of motion (heading, sway, ...). A motion at twice the frequency also counts, because
    surge and drag follow both half strokes. If two frequencies are found in equally many kinds of motion, the
    frequency with a sideways motion of the body is chosen: an oscillating heading moves every point except
    the pivot, but the vibration of a sensor does not move the body.

    The returned frequency is the estimate from the channel with the smallest standard error. Estimates are
    not averaged, because the channels are not independent. Beats that contradict the stroke are stored in
    :attr:`StrokeEstimate.rivals`, unless the frequency equals the stated one.
    """
    seen = _find_motions(time_s, columns, range_hz)
    if not seen and stated_hz is not None and range_hz is None:
        range_hz = ((1 - FREQUENCY_RTOL) * stated_hz, (1 + FREQUENCY_RTOL) * stated_hz)
        seen = _find_motions(time_s, columns, range_hz)
    slow = _find_slowest(time_s, columns)
    if not seen:
        return _explain_missing(time_s, columns, slow)
    pushed = {n: b for n, b in seen.items() if PUSHED.fullmatch(n) or n in ALONG}
    beats = {n: b for n, b in seen.items() if SIDEWAYS.fullmatch(n)} or seen
    chosen = _choose_stroke(beats, beats | pushed)
    if not range_hz and slow and slow[1].may_cause(chosen.frequency_hz):
        return _explain_missing(time_s, columns, slow)
    at_it = [(beat, name) for name in beats for beat in beats[name] if multiple(beat, chosen) == 1]
    beat, channel = min(at_it, key=lambda pair: pair[0].stderr_hz)
    late_hz = beat.frequency_hz * np.sqrt(2.0) * time_sd_s / float(np.ptp(time_s))
    beat = replace(beat, stderr_hz=float(np.hypot(beat.stderr_hz, late_hz)))
    strongest = {name: found[0] for name, found in beats.items()}
    return StrokeEstimate(beat, channel, strongest, _find_rivals(chosen, beats | pushed, stated_hz))


def _find_motions(
    time_s: Array, columns: Mapping[str, Array], within: tuple[float, float] | None
) -> dict[str, list[Beat]]:
    """Return the beats of all channels that may oscillate with the stroke, by channel.

    Beats caused by laps of the path, by rotations of the heading, or by rounding are left out.
    """
    channels = {n: unwrap_angle(n, v) for n, v in columns.items() if not NO_MOTION.fullmatch(n)}
    seen = _beats(time_s, channels | swing(columns), within)
    seen = _remove_laps(time_s, columns, within, seen)
    found = {}
    for name, beats in seen.items():
        if name.endswith("_rad"):
            known = channels[name][np.isfinite(channels[name])]
            turns, near_hz = abs(float(known[-1] - known[0])) / (2 * np.pi), 1.0 / float(np.ptp(time_s))
            if turns >= 1.0:
                turning = Beat(turns * near_hz, 0.0, 0.0, 0.0, turns)
                beats = _remove_multiples(beats, turning, MAX_COMPASS_HARMONIC, near_hz)
        # Leave out beats that are not larger than the rounding error, because they cannot be distinguished
        # from it. A rounding error is at most half of the rounding step, and it is periodic in a steady
        # motion.
        measured = [columns[name]] if name in columns else _coordinates(columns)
        rounding = sum(map(quantum, measured))
        if large := [b for b in beats if b.amplitude > rounding / 2 * np.sqrt(2.0 * b.share)]:
            found[name] = large
    return found


def _remove_laps(
    time_s: Array,
    columns: Mapping[str, Array],
    within: tuple[float, float] | None,
    seen: dict[str, list[Beat]],
) -> dict[str, list[Beat]]:
    """Return the beats of all channels without those caused by laps of the path."""
    swings = [beat for name in (*ALONG, "sway") for beat in seen.get(name, [])]
    lap = next((beat for beat in swings if _is_lap(time_s, columns, beat.frequency_hz)), None)
    if lap is None:
        return seen
    rest = {name: beats for name, beats in seen.items() if name not in (*ALONG, "sway")}
    seen = _beats(time_s, swing(columns, 0.25 / lap.cycles), within) | rest
    return {name: _remove_multiples(beats, lap, MAX_LAP_HARMONIC) for name, beats in seen.items()}


def _remove_multiples(beats: list[Beat], of: Beat, highest: int, resolution_hz: float = 0.0) -> list[Beat]:
    """Return the beats whose frequencies are no multiples of that of ``of``, up to the order ``highest``."""
    return [beat for beat in beats if not 1 <= multiple(beat, of, resolution_hz) <= highest]


def _is_lap(time_s: Array, columns: Mapping[str, Array], frequency_hz: float) -> bool:
    """Return whether the path of a track makes one lap per period of a given frequency."""
    axes = _coordinates(columns)
    if len(axes) < 2:
        return False
    there = np.isfinite(axes).all(axis=0)
    x, y = (_phasors(time_s[there], values[there], frequency_hz) for values in axes)
    if len(x) != len(y):
        return False
    less, more = sorted(float(np.mean(np.abs(x + turn * y) ** 2)) for turn in (1j, -1j))
    return less < MAX_LAP_RATIO**2 * more


def _phasors(t: Array, x: Array, frequency_hz: float) -> NDArray[np.complex128]:
    """Return the complex amplitude of a sine in each window of a channel, or one in a short record."""
    windows = demodulate(t, x, frequency_hz)
    if windows is not None:
        return windows[1]
    design = np.column_stack((np.vander(t - t.mean(), 3), waves(t, frequency_hz)))
    weights = np.linalg.lstsq(design, x, rcond=None)[0]
    return np.array([weights[3] - 1j * weights[4]])


def _find_slowest(time_s: Array, columns: Mapping[str, Array]) -> tuple[str, Beat] | None:
    """Find an oscillation with too few cycles for a frequency estimate; return its channel and its beat.

    If the drive is logged, only the channels of the drive are searched. Otherwise the track and all channels
    that oscillate sideways are searched. Of several slow oscillations, the one with the highest frequency is
    returned.
    """
    driven = [n for n in columns if DRIVEN.fullmatch(n)]
    names = driven or [n for n in columns if SIDEWAYS.fullmatch(n)]
    signals = {name: unwrap_angle(name, columns[name]) for name in names}
    axes = _coordinates(columns)
    if axes and not driven:
        place = np.column_stack(axes)
        there = np.isfinite(place).all(axis=1)
        if there.sum() > 2:
            line = np.polynomial.polynomial.polyfit(time_s[there], place[there], 1)
            about = place - np.polynomial.polynomial.polyval(time_s, line).T
            axis = np.linalg.svd(about[there], full_matrices=False)[2][0]
            signals["the track"] = about @ axis
    found = {name: find_slow_motion(time_s, values) for name, values in signals.items()}
    slow = {name: motion for name, motion in found.items() if motion is not None}
    return max(slow.items(), key=lambda item: item[1].frequency_hz, default=None)


def _choose_stroke(candidates: Mapping[str, list[Beat]], seen: Mapping[str, list[Beat]]) -> Beat:
    """Return the candidate beat that is taken for the stroke, by the rules given in :func:`find_stroke`."""

    def worth(beat: Beat) -> tuple[bool, bool, int, bool, float, float]:
        # Compute from the amplitudes the fraction of each channel's variance at once or twice the frequency
        # of the beat.
        at_it = {}
        for name, beats in seen.items():
            whole = sum(b.amplitude**2 for b in beats) / beats[0].share
            largest = max((b.amplitude for b in beats if multiple(b, beat) in (1, 2)), default=0.0)
            at_it[name] = largest**2 / whole
        names = [name for name, share in at_it.items() if share > 0]
        motions = sum(any(motion.fullmatch(name) for name in names) for motion in MOTIONS)
        return (
            beat.frequency_hz <= MAX_STROKE_HZ,
            any(DRIVEN.fullmatch(name) for name in names),
            motions,
            any(MOVED.fullmatch(name) for name in names),
            round(sum(at_it.values()), 3),
            -beat.frequency_hz,
        )

    return max((beat for beats in candidates.values() for beat in beats), key=worth)


def _find_rivals(chosen: Beat, seen: Mapping[str, list[Beat]], stated_hz: float | None) -> dict[str, Beat]:
    """Return the largest beat of each channel whose frequency contradicts that of the stroke.

    Beats at a multiple of the stroke frequency do not contradict it, nor do faster beats with little power
    relative to the stroke. Nothing contradicts a stroke at the stated frequency.
    """
    if stated_hz is not None and abs(chosen.frequency_hz - stated_hz) <= FREQUENCY_RTOL * stated_hz:
        return {}
    found = {}
    for name, beats in seen.items():
        stroke = max((b.amplitude for b in beats if multiple(b, chosen)), default=0.0)
        others = [b for b in beats if not multiple(b, chosen)]
        ripple, slow = MIN_SHARE * stroke**2, chosen.frequency_hz
        against = [b for b in others if b.amplitude**2 >= ripple or b.frequency_hz < slow]
        if against:
            found[name] = max(against, key=lambda beat: beat.amplitude)
    return found


def _explain_missing(
    time_s: Array, columns: Mapping[str, Array], slow: tuple[str, Beat] | None
) -> StrokeEstimate:
    """Return the reason why a log has no stroke, and the frequency of its slow motion ``slow``."""
    duration = float(np.ptp(time_s)) if len(time_s) else 0.0
    slow_hz, laps, axes = None, [], _coordinates(columns)
    if slow is not None:
        slow_hz = slow[1].frequency_hz
        laps = [slow_hz]
    elif len(axes) > 1:
        laps = [beat.frequency_hz for v in axes for beat in find_beats(*_prepare_samples(time_s, v))]
    lap_hz = next((hz for hz in laps if _is_lap(time_s, columns, hz)), None)
    if lap_hz is not None:
        text = f"the path goes in circles of {1.0 / lap_hz:.3g} s; no other motion is periodic"
    elif slow is not None:
        text = (
            f"the strongest motion of {slow[0]}, at about {slow_hz:.2g} Hz, has only {slow[1].cycles:.1f} "
            f"cycles in {duration:.3g} s; a stroke needs {MIN_CYCLES:g}"
        )
    else:
        lowest = f"in {duration:.3g} s: from {MIN_CYCLES / max(duration, 1e-300):.3g} Hz on"
        text = f"no motion in it is periodic over {MIN_CYCLES:g} cycles or more ({lowest})"
    return StrokeEstimate(unknown=text, slow_hz=slow_hz)


def _beats(
    time_s: Array, columns: Mapping[str, Array], within: tuple[float, float] | None
) -> dict[str, list[Beat]]:
    """Return the beats of each channel by its name, without the channels that have no beat."""
    low, high = within or (None, None)
    found = {}
    for name, values in columns.items():
        beats = find_beats(*_prepare_samples(time_s, values), lowest_hz=low, highest_hz=high)
        if beats:
            found[name] = beats
    return found


def _prepare_samples(time_s: Array, values: Array) -> tuple[Array, Array]:
    """Return the samples of a channel for the search for a beat, reduced to :data:`MAX_RATE_HZ` or less.

    The result holds times and samples. The samples are those of the longest segment without gaps, at even
    time steps. If that segment is too short, all samples are returned.
    """
    time, even = longest_even(time_s, values, MAX_RATE_HZ)
    there = np.isfinite(values)
    if (
        len(time) < MIN_STRETCH_SHARE * there.sum() <= MAX_SAMPLES
        and np.median(np.diff(time_s[there])) * MAX_RATE_HZ >= 1.0
    ):
        time, even = time_s[there], values[there]
    return time, even
