"""Stroke of a swimmer, estimated from all channels of a log."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from swimid.logs.beat import (
    MIN_CYCLES,
    MIN_SHARE,
    Beat,
    demodulate,
    find_beats,
    find_slow_motion,
    multiple,
    waves,
)
from swimid.logs.log import FREQUENCY_RTOL
from swimid.logs.sampling import longest_even, quantum

Array = NDArray[np.float64]
#: Channels that oscillate once per stroke, because they have opposite signs in the two half strokes.
SIDEWAYS = re.compile(
    r"(joint|cmd|fin|tail)\w*(?<!_likelihood)(?<!_area_px)|yaw_rad|yaw_rate_rad_s|roll_rad|pitch_rad|"
    r"pitch_rate_rad_s|v_m_s|w_m_s|w[xyz]_rad_s|ay_m_s2|sway"
)
#: Channels that may oscillate twice per stroke, because both half strokes push.
PUSHED = re.compile(r"u_m_s|a[xz]_m_s2|force_N")
#: Channels of the drive. If one of them is logged, its frequency is taken for the stroke frequency.
DRIVEN = re.compile(r"cmd\w*|(joint|fin|tail)\w*_rad(_s)?")
#: Channels returned by :func:`swing` that may oscillate twice per stroke.
ALONG = ("surge", "long_axis", "short_axis")
#: Channels of the motion of the body to the side.
MOVED = re.compile(r"sway|v_m_s|w_m_s|ay_m_s2|(joint|fin|tail)\w*_(m|px)")
#: Channels of each kind of motion. Several channels of one kind of motion count once.
MOTIONS = tuple(
    re.compile(part)
    for part in (
        DRIVEN.pattern,
        MOVED.pattern,
        r"yaw_\w+|wz_rad_s",
        r"roll_rad|wx_rad_s",
        r"pitch_\w+|wy_rad_s",
        rf"{PUSHED.pattern}|surge|\w+_axis",
    )
)
#: Columns that are not searched for a stroke: positions (see :func:`swing`), standard deviations, likelihoods
#: and states.
NO_MOTION = re.compile(
    r"[xyz](_raw)?_(m|px)|sd_.*|.*_sd(_.*)?|.*likelihood|.*confidence|.*area_px|interpolated|status|frame"
)
#: Maximum ratio of the smaller to the larger of the two counter-rotating components of a path that counts as
#: a lap. For an ellipse with half axes a and b the ratio is (a - b) / (a + b). Below this maximum the
#: circular part of the ellipse has more power than the linear part.
MAX_LAP_RATIO = np.sqrt(2.0) - 1.0
#: Maximum harmonic order of a lap: a rectangular pool has four corners. Maximum harmonic order of a compass
#: heading under rotation: the compass deviation has one or two periods per rotation (semicircular and
#: quadrantal deviation).
MAX_LAP_HARMONIC, MAX_COMPASS_HARMONIC = 4, 2
#: Maximum frequency of a stroke, Hz. Faster motion is taken for vibration. Bainbridge (J. Exp. Biol. 35,
#: 1958) found 25 Hz for dace of 5 cm and 20 Hz for dace of 8 cm.
MAX_STROKE_HZ = 20.0
#: Maximum sample rate in the search for a beat, Hz. Channels with a higher rate are averaged over blocks of
#: samples.
MAX_RATE_HZ = 60.0
#: Minimum fraction of a channel's samples in its longest gap-free part, for a search in this part only. With
#: a smaller fraction all samples are used with their gaps, if there are at most ``MAX_SAMPLES``.
MIN_STRETCH_SHARE, MAX_SAMPLES = 0.8, 20_000


@dataclass(frozen=True)
class Rhythm:
    """Stroke of one log.

    Attributes
    ----------
    beat : Beat
        Periodic motion of the channel whose frequency has the smallest standard error.
    channel : str
        Name of that channel.
    channels : dict of str to Beat
        Strongest beat of each channel that has a beat.
    maybe_double : bool
        Whether the stroke is seen only in channels that may oscillate twice per stroke, so that the frequency
        may be twice that of the stroke.
    rivals : dict of str to Beat
        Largest beat of each channel whose frequency is no multiple of the stroke frequency. Such a beat
        contradicts the stroke.
    """

    beat: Beat
    channel: str
    channels: dict[str, Beat]
    maybe_double: bool
    rivals: dict[str, Beat] = field(default_factory=dict)

    @property
    def doubt(self) -> str:
        """Reason to doubt this stroke, in words; empty if there is no reason."""
        said = []
        if self.rivals:
            others = " and ".join(f"{n} at {b.frequency_hz:.4g} Hz" for n, b in self.rivals.items())
            said.append(
                f"{self.channel} beats at {self.beat.frequency_hz:.4g} Hz, {others}, which is no multiple of "
                "it: one of them is not the stroke but another vibration or sway"
            )
        if self.beat.frequency_hz > MAX_STROKE_HZ:
            said.append(
                f"{self.beat.frequency_hz:.4g} Hz is faster than robots and all but very small fish beat"
            )
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
    place = _place(columns)
    if place is None:
        return {}
    there = np.isfinite(place).all(axis=1)
    if there.sum() < 16 or not np.ptp(place[there], axis=0).any():
        return {}
    if place.shape[1] == 1:
        return {"surge": place[:, 0]}
    width = max(int(there.sum() * share) | 1, 5)
    path, tangent = _averaged_path(place[there], width)
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


def _averaged_path(place: Array, width: int) -> tuple[Array, Array]:
    """Return the values and the slopes per sample of lines fitted to ``width`` samples around each sample.

    Within half a window of the ends the values are those of the first and the last complete window's line.
    """
    half = width // 2
    offsets = np.arange(-half, half + 1)
    middles = np.column_stack([np.convolve(x, np.full(width, 1 / width), "valid") for x in place.T])
    slopes = np.column_stack([np.correlate(x, offsets / (offsets @ offsets), "valid") for x in place.T])
    samples = np.arange(len(place))
    line = np.clip(samples - half, 0, len(middles) - 1)
    beyond = samples - half - line
    return middles[line] + slopes[line] * beyond[:, None], slopes[line]


def _place(columns: Mapping[str, Array]) -> Array | None:
    """Return the first two coordinates of a track, shape (n, 2), or a single coordinate, shape (n, 1)."""
    units = [[n for n in (f"x_{u}", f"y_{u}", f"z_{u}") if n in columns] for u in ("m", "px")]
    names = next((found for found in units if found), [])[:2]
    if not names:
        return None
    return np.column_stack([columns[name] for name in names])


def find(
    time_s: Array,
    columns: Mapping[str, Array],
    *,
    range_hz: tuple[float, float] | None = None,
    stated_hz: float | None = None,
) -> Rhythm | None:
    """Find the stroke in the channels of a log; None if no stroke is found.

    Parameters
    ----------
    time_s : ndarray, shape (n,)
    columns : mapping of str to ndarray, each shape (n,)
        Channels with names of the log format; NaN where missing.
    range_hz : (float, float), optional
        Range of the search.
    stated_hz : float, optional
        Stated frequency of the drive, Hz. If the search over all frequencies finds nothing, a search near
        this frequency follows, which needs less evidence.

    Notes
    -----
    If the drive is logged, the stroke frequency is the frequency of the drive. Otherwise it is the frequency
    found in most kinds of motion (heading, sway, ...). A motion at twice the frequency also counts, because
    surge and drag follow both half strokes. If two frequencies are found in equally many kinds of motion, the
    one that moves the body to the side is chosen: an oscillating heading moves every point except the pivot,
    but the vibration of a sensor does not move the body.

    The returned frequency is the estimate from the channel with the smallest standard error. Estimates are
    not averaged, because the channels are not independent. Beats that contradict the stroke are stored in
    :attr:`Rhythm.rivals`, unless the frequency equals the stated one.
    """
    ranges = [range_hz]
    if stated_hz is not None and range_hz is None:
        ranges.append(((1 - FREQUENCY_RTOL) * stated_hz, (1 + FREQUENCY_RTOL) * stated_hz))
    for within in ranges:
        seen = _motions(time_s, columns, within)
        pushed = {n: b for n, b in seen.items() if PUSHED.fullmatch(n) or n in ALONG}
        beats = {n: b for n, b in seen.items() if SIDEWAYS.fullmatch(n)} or seen
        if not beats:
            continue
        chosen = _chosen(beats, beats | pushed)
        if not within:
            slow = find_slowest(time_s, columns)
            if slow is not None and slow[1].may_cause(chosen.frequency_hz):
                return None
        is_stated = (
            stated_hz is not None and abs(chosen.frequency_hz - stated_hz) <= FREQUENCY_RTOL * stated_hz
        )
        # among the channels that beat with the stroke frequency, take the one with the smallest standard
        # error
        at_it = {name: [b for b in found if multiple(b, chosen) == 1] for name, found in beats.items()}
        best = {name: min(found, key=lambda b: b.stderr_hz) for name, found in at_it.items() if found}
        channel = min(best, key=lambda name: best[name].stderr_hz)
        rivals = {}
        if not is_stated:
            rivals = _rivals(chosen, beats | pushed)
        return Rhythm(
            best[channel],
            channel,
            {name: found[0] for name, found in beats.items()},
            maybe_double=channel in pushed,
            rivals=rivals,
        )
    return None


def _motions(
    time_s: Array, columns: Mapping[str, Array], within: tuple[float, float] | None
) -> dict[str, list[Beat]]:
    """Return the beats found in the channels of a log that may move with the stroke.

    Beats caused by laps of the path, by rotations of the heading, or by rounding are left out.
    """
    channels = {n: _unwrap(n, v) for n, v in columns.items() if not NO_MOTION.fullmatch(n)}
    channels |= swing(columns)
    seen = _beats(time_s, channels, within)
    swings = [b for n in (*ALONG, "sway") for b in seen.get(n, [])]
    lap = next((b for b in swings if _is_lap(time_s, columns, b.frequency_hz)), None)
    if lap is not None:
        track = swing(columns, 0.25 / lap.cycles)
        rest = {n: b for n, b in seen.items() if n not in (*ALONG, "sway")}
        channels = {n: v for n, v in channels.items() if n not in (*ALONG, "sway")} | track
        seen = _beats(time_s, track, within) | rest
        seen = {
            n: [b for b in beats if not 1 <= multiple(b, lap) <= MAX_LAP_HARMONIC]
            for n, beats in seen.items()
        }
    for name in seen:
        turns = _turns(channels[name]) if name.endswith("_rad") else 0.0
        if turns >= 1.0:
            turning = Beat(turns / float(np.ptp(time_s)), 0.0, 0.0, 0.0, turns)
            resolution = 1.0 / float(np.ptp(time_s))
            seen[name] = [
                b for b in seen[name] if not 1 <= multiple(b, turning, resolution) <= MAX_COMPASS_HARMONIC
            ]
        last_place = _last_place(columns, name)
        seen[name] = [beat for beat in seen[name] if not _is_rounding(beat, last_place)]
    return {name: beats for name, beats in seen.items() if beats}


def _last_place(columns: Mapping[str, Array], name: str) -> float:
    """Return the quantisation step of a channel; of one computed from positions, the sum of their steps."""
    if name in columns:
        return quantum(columns[name])
    place = _place(columns)
    if place is None:
        return 0.0
    return sum(quantum(values) for values in place.T)


def _is_rounding(beat: Beat, last_place: float) -> bool:
    """Return whether rounding may cause a beat.

    A rounding error is at most half of the rounding step. In a steady motion this error is periodic. A beat
    whose amplitude is not larger cannot be distinguished from the rounding error.
    """
    return beat.amplitude <= last_place / 2 * np.sqrt(2.0 * beat.share)


def _is_lap(time_s: Array, columns: Mapping[str, Array], frequency_hz: float) -> bool:
    """Return whether the path makes one lap per period of a frequency."""
    place = _place(columns)
    if place is None or place.shape[1] < 2:
        return False
    there = np.isfinite(place).all(axis=1)
    x, y = (_phasors(time_s[there], values[there], frequency_hz) for values in place.T)
    if len(x) != len(y):
        return False
    less, more = sorted(float(np.mean(np.abs(x + turn * y) ** 2)) for turn in (1j, -1j))
    return less < MAX_LAP_RATIO**2 * more


def _phasors(t: Array, x: Array, frequency_hz: float) -> NDArray[np.complex128]:
    """Return the complex amplitudes of a frequency in windows; in a short record, a single amplitude."""
    windows = demodulate(t, x, frequency_hz)
    if windows is not None:
        return windows[1]
    design = np.column_stack((np.vander(t - t.mean(), 3), waves(t, frequency_hz)))
    weights = np.linalg.lstsq(design, x, rcond=None)[0]
    return np.array([weights[3] - 1j * weights[4]])


def _turns(angle: Array) -> float:
    """Return the number of full rotations from the first to the last sample of an unwrapped angle."""
    known = angle[np.isfinite(angle)]
    return abs(float(known[-1] - known[0])) / (2 * np.pi) if len(known) else 0.0


def find_slowest(time_s: Array, columns: Mapping[str, Array]) -> tuple[str, Beat] | None:
    """Return the channel whose strongest oscillation has too few cycles for a frequency, and this beat.

    If the drive is logged, only its channels are searched. Otherwise all channels that oscillate to the side
    are searched, and the track. If several channels qualify, the one with the highest frequency is returned.
    """
    driven = [n for n in columns if DRIVEN.fullmatch(n)]
    names = driven or [n for n in columns if SIDEWAYS.fullmatch(n)]
    signals = {name: _unwrap(name, columns[name]) for name in names}
    place = None if driven else _place(columns)
    if place is not None:
        there = np.isfinite(place).all(axis=1)
        if there.sum() > 2:
            line = np.polynomial.polynomial.polyfit(time_s[there], place[there], 1)
            about = place - np.polynomial.polynomial.polyval(time_s, line).T
            axis = np.linalg.svd(about[there], full_matrices=False)[2][0]
            signals["the track"] = about @ axis
    found = {name: find_slow_motion(time_s, values) for name, values in signals.items()}
    slow = {name: motion for name, motion in found.items() if motion is not None}
    return max(slow.items(), key=lambda item: item[1].frequency_hz, default=None)


def _chosen(candidates: Mapping[str, list[Beat]], seen: Mapping[str, list[Beat]]) -> Beat:
    """Return the candidate that is taken for the stroke, by the rules given in :func:`find`."""

    def worth(beat: Beat) -> tuple[bool, bool, int, bool, float, float]:
        at_it = {
            name: max((_part(b, beats) for b in beats if multiple(b, beat) in (1, 2)), default=0.0)
            for name, beats in seen.items()
        }
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


def _part(beat: Beat, beats: list[Beat]) -> float:
    """Return the fraction of a channel's variance that one of its beats explains, from the amplitudes."""
    return beats[0].share * beat.amplitude**2 / sum(b.amplitude**2 for b in beats)


def _rivals(chosen: Beat, seen: Mapping[str, list[Beat]]) -> dict[str, Beat]:
    """Return the largest beat of each channel that contradicts the stroke.

    Multiples of the stroke frequency, and faster beats with little power relative to the stroke, do not
    count.
    """
    found = {}
    for name, beats in seen.items():
        stroke = max((b.amplitude for b in beats if multiple(b, chosen)), default=0.0)
        others = [b for b in beats if not multiple(b, chosen)]
        ripple, slow = MIN_SHARE * stroke**2, chosen.frequency_hz
        against = [b for b in others if b.amplitude**2 >= ripple or b.frequency_hz < slow]
        if against:
            found[name] = max(against, key=lambda beat: beat.amplitude)
    return found


def add_time_error(stroke: Rhythm, time_sd_s: float, time_s: Array) -> Rhythm:
    """Return the stroke with a standard error that includes errors of the first and last time stamps."""
    error = stroke.beat.frequency_hz * np.sqrt(2.0) * time_sd_s / float(np.ptp(time_s))
    beat = replace(stroke.beat, stderr_hz=float(np.hypot(stroke.beat.stderr_hz, error)))
    return replace(stroke, beat=beat)


def explain_missing(time_s: Array, columns: Mapping[str, Array]) -> tuple[str, float | None]:
    """Return the reason why :func:`find` finds no stroke, and the frequency of a slow motion, Hz, or None."""
    duration = float(np.ptp(time_s)) if len(time_s) else 0.0
    slow = find_slowest(time_s, columns)
    slow_hz, laps, place = None, [], _place(columns)
    if slow is not None:
        slow_hz = slow[1].frequency_hz
        laps = [slow_hz]
    elif place is not None and place.shape[1] > 1:
        laps = [beat.frequency_hz for v in place.T for beat in find_beats(*_prepared(time_s, v))]
    for frequency_hz in laps:
        if _is_lap(time_s, columns, frequency_hz):
            text = f"the path goes in circles of {1.0 / frequency_hz:.3g} s; nothing else keeps a beat"
            return text, slow_hz
    if slow is not None:
        name, motion = slow
        text = f"the strongest motion of {name}, at about {motion.frequency_hz:.2g} Hz, has only "
        cycles = f"{motion.cycles:.1f} cycles in {duration:.3g} s; a stroke needs {MIN_CYCLES:g}"
        return text + cycles, slow_hz
    lowest = f"in {duration:.3g} s: from {MIN_CYCLES / max(duration, 1e-300):.3g} Hz on"
    return f"nothing in it keeps a beat over {MIN_CYCLES:g} cycles or more ({lowest})", None


def _beats(
    time_s: Array, columns: Mapping[str, Array], within: tuple[float, float] | None
) -> dict[str, list[Beat]]:
    """Return the beats of each channel that has a beat."""
    low, high = within or (None, None)
    found = {}
    for name, values in columns.items():
        beats = find_beats(*_prepared(time_s, values), lowest_hz=low, highest_hz=high)
        if beats:
            found[name] = beats
    return found


def _unwrap(name: str, values: Array) -> Array:
    """Return a channel. Angles are unwrapped, so that they have no jumps by full rotations."""
    if name.endswith("_rad"):
        known = np.isfinite(values)
        values = values.copy()
        values[known] = np.unwrap(values[known])
    return values


def _prepared(time_s: Array, values: Array) -> tuple[Array, Array]:
    """Return times and samples of a channel at a rate of at most :data:`MAX_RATE_HZ`.

    The samples are those of the longest part without gaps, at even time steps. If that part is too short, all
    samples are returned.
    """
    time, even = longest_even(time_s, values, MAX_RATE_HZ)
    there = np.isfinite(values)
    if (
        len(time) < MIN_STRETCH_SHARE * there.sum() <= MAX_SAMPLES
        and np.median(np.diff(time_s[there])) * MAX_RATE_HZ >= 1.0
    ):
        time, even = time_s[there], values[there]
    known = np.isfinite(even)
    if known.sum() < 16 or np.ptp(even[known]) == 0:
        return np.empty(0), np.empty(0)
    return time, even
