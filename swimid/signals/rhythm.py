"""The stroke of a swimmer from all channels of a log: its frequency and its harmonics."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from swimid.signals.beat import Beat, find_beat
from swimid.signals.sampling import longest_even

Array = NDArray[np.float64]
#: Channels that swing once a stroke, to one side and to the other.
SIDEWAYS = re.compile(
    r"(joint|cmd|fin|tail)\w*|yaw_rad|yaw_rate_rad_s|roll_rad|pitch_rad|pitch_rate_rad_s|v_m_s|w_m_s|w[xyz]_rad_s|ay_m_s2|sway"
)
#: Channels that may swing twice a stroke: both half strokes push.
PUSHED = re.compile(r"u_m_s|a[xz]_m_s2|force_N")
#: Channels that agree within this share beat together.
TOGETHER = 0.03
#: Rate above which a channel is averaged before its beat is sought, Hz.
FASTEST_HZ = 60.0
#: Highest harmonic reported, and how many standard errors its amplitude must exceed.
HARMONICS, CLEAR = 5, 3.0


@dataclass(frozen=True)
class Harmonic:
    """One harmonic of the stroke in the channel it was found in.

    Attributes
    ----------
    order : int
        1 is the stroke itself.
    amplitude, stderr : float
        In the channel's unit.
    """

    order: int
    amplitude: float
    stderr: float


@dataclass(frozen=True)
class Rhythm:
    """The stroke of one log.

    Attributes
    ----------
    beat : Beat
        The stroke in the channel that tells it best.
    channel : str
    harmonics : list of Harmonic
        Of that channel, those that stand clear of the noise.
    channels : dict of str to Beat
        What each channel that beats at all beats at.
    maybe_double : bool
        Only channels that may swing twice a stroke were there.
    """

    beat: Beat
    channel: str
    harmonics: list[Harmonic]
    channels: dict[str, Beat]
    maybe_double: bool

    @property
    def interval_hz(self) -> tuple[float, float]:
        """95 % interval of the stroke frequency, Hz."""
        half = 1.96 * self.beat.stderr_hz
        return self.beat.frequency_hz - half, self.beat.frequency_hz + half


def sway(columns: Mapping[str, Array]) -> Array | None:
    """Distance of a track from the line it keeps to, m; None without two coordinates."""
    names = [name for name in ("x_m", "y_m", "z_m") if name in columns]
    if len(names) < 2:
        return None
    place = np.column_stack([columns[name] for name in names[:2]])
    there = np.isfinite(place).all(axis=1)
    if there.sum() < 3 or not np.ptp(place[there], axis=0).any():
        return None
    centred = place - place[there].mean(axis=0)
    across = np.linalg.svd(centred[there], full_matrices=False)[2][-1]
    return centred @ across


def find(time_s: Array, columns: Mapping[str, Array]) -> Rhythm | None:
    """The stroke a log shows, or None where it shows none.

    Parameters
    ----------
    time_s : ndarray, shape (n,)
    columns : mapping of str to ndarray, each shape (n,)
        NaN where missing. Names of the log format tell which swing once a stroke.

    Notes
    -----
    The frequency is that which most channels beat at, those at twice of it counted in: surge and
    drag follow both half strokes. Of the channels at it the one with the smallest standard error
    gives the value; they are not independent, so nothing is averaged.
    """
    offered = {name: values for name, values in columns.items() if SIDEWAYS.fullmatch(name)}
    across = sway(columns)
    if across is not None:
        offered["sway"] = across
    beats = _beats(time_s, offered)
    double = not beats
    if double:
        beats = _beats(time_s, {name: v for name, v in columns.items() if PUSHED.fullmatch(name)})
    if not beats:
        return None

    def support(frequency: float) -> float:
        return sum(
            beat.share
            for beat in beats.values()
            if any(abs(beat.frequency_hz / (k * frequency) - 1) < TOGETHER for k in (1, 2))
        )

    chosen = max(beats.values(), key=lambda beat: (round(support(beat.frequency_hz), 3), -beat.frequency_hz))
    at_it = {
        name: beat
        for name, beat in beats.items()
        if abs(beat.frequency_hz / chosen.frequency_hz - 1) < TOGETHER
    }
    channel = min(at_it, key=lambda name: at_it[name].stderr_hz)
    values = offered.get(channel, columns.get(channel))
    assert values is not None
    harmonics = _harmonics(*_as_logged(time_s, values), at_it[channel].frequency_hz)
    return Rhythm(at_it[channel], channel, harmonics, beats, double)


def _beats(time_s: Array, columns: Mapping[str, Array]) -> dict[str, Beat]:
    found = {}
    for name, values in columns.items():
        time, prepared = _prepared(time_s, values)
        beat = find_beat(time, prepared) if len(time) else None
        if beat is not None:
            found[name] = beat
    return found


def _prepared(time_s: Array, values: Array) -> tuple[Array, Array]:
    """The longest stretch of a channel, evenly sampled and not faster than a stroke needs."""
    time, even = longest_even(time_s, values, FASTEST_HZ)
    known = np.isfinite(even)
    if known.sum() < 16 or np.ptp(even[known]) == 0:
        return np.empty(0), np.empty(0)
    return time, even


def _as_logged(time_s: Array, values: Array) -> tuple[Array, Array]:
    """The samples of that stretch as they are: straight lines across missing ones make harmonics."""
    time, even = _prepared(time_s, values)
    first, last = np.searchsorted(time_s, (time[0], time[-1]))
    there = np.flatnonzero(np.isfinite(values[first : last + 1])) + first
    return (time, even) if len(there) > 2 * len(time) else (time_s[there], values[there])


def _harmonics(time: Array, values: Array, frequency: float) -> list[Harmonic]:
    """Amplitudes of a sine series fitted with a cubic trend."""
    known = np.isfinite(values)
    t, x = time[known] - time[known].mean(), values[known]
    nyquist = 0.5 / float(np.median(np.diff(time)))
    orders = [k for k in range(1, HARMONICS + 1) if k * frequency < 0.9 * nyquist]
    span = max(float(np.ptp(t)), 1e-300)
    design = [(t / span) ** k for k in range(4)]
    for k in orders:
        design += [np.cos(2 * np.pi * k * frequency * t), np.sin(2 * np.pi * k * frequency * t)]
    matrix = np.column_stack(design)
    weights = np.linalg.lstsq(matrix, x, rcond=None)[0]
    left = x - matrix @ weights
    stderr = float(np.sqrt(2 * left @ left / max(len(x) - len(weights), 1) / len(x)))
    found = []
    for index, k in enumerate(orders):
        amplitude = float(np.hypot(*weights[4 + 2 * index : 6 + 2 * index]))
        if k == 1 or amplitude > CLEAR * stderr:
            found.append(Harmonic(k, amplitude, stderr))
    return found
