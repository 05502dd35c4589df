"""What an inertial unit tells without any help: the motion within a stroke."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import signal

from swimid.inertial.record import Array
from swimid.signals.beat import Beat, find_beat

#: Slower than this is left out where no stroke is found, Hz; with one: this share of its frequency.
LOWEST_HZ, SHARE = 0.3, 0.5
#: Stroke frequencies looked for, Hz, and the rate the channels are looked at, Hz.
SLOWEST_STROKE_HZ, FASTEST_STROKE_HZ, LOOK_HZ = 0.2, 15.0, 50.0
#: Harmonics reported.
HARMONICS = 4


@dataclass(frozen=True)
class Stroke:
    """The stroke seen in one channel.

    Attributes
    ----------
    channel : str
    beat : Beat
    harmonics : list of (float, float)
        Frequency, Hz, and amplitude in the channel's unit, of the fundamental and its multiples.
    """

    channel: str
    beat: Beat
    harmonics: list[tuple[float, float]]


def high_passed(time_s: Array, values: Array, cutoff_hz: float) -> Array:
    """A channel less everything slower than ``cutoff_hz``: fourth-order Butterworth, no phase shift."""
    step = float(np.median(np.diff(time_s)))
    even = np.arange(time_s[0], time_s[-1] + 0.5 * step, step)
    if len(even) < 32 or cutoff_hz >= 0.45 / step:
        return np.full_like(values, np.nan)
    sos = signal.butter(2, cutoff_hz, "high", fs=1 / step, output="sos")
    passed = signal.sosfiltfilt(sos, np.interp(even, time_s, values), padlen=min(len(even) - 1, int(3 / (cutoff_hz * step))))
    return np.interp(time_s, even, passed)


def high_passed_sd(acceleration_noise: float, cutoff_hz: float, scale_sd: float, values: Array) -> float:
    """Deviation of a high-passed velocity, m/s.

    Notes
    -----
    White acceleration noise of density N leaves ``N / (2 pi sqrt(f_c))`` after integration and a sharp
    high pass at f_c (integral of ``N^2 / (2 pi f)^2`` from f_c up); an error of scale adds in proportion.
    """
    white = acceleration_noise / (2 * np.pi * np.sqrt(cutoff_hz))
    return float(np.hypot(white, scale_sd * np.nanstd(values)))


def find_stroke(time_s: Array, channels: dict[str, Array]) -> list[Stroke]:
    """The stroke in every channel that has one, the channel it explains most of first.

    Channels are averaged to 50 Hz first; multiples are fitted as sines together.
    """
    found = []
    step = max(float(np.median(np.diff(time_s))), 1 / LOOK_HZ)
    edges = np.arange(time_s[0], time_s[-1] + step, step)
    if len(edges) < 32:
        return []
    index = np.clip(np.searchsorted(edges, time_s, side="right") - 1, 0, len(edges) - 2)
    count = np.bincount(index, minlength=len(edges) - 1)
    t = 0.5 * (edges[1:] + edges[:-1])
    for name, values in channels.items():
        mean = np.bincount(index, values, minlength=len(t)) / np.maximum(count, 1)
        mean = np.interp(t, t[count > 0], mean[count > 0])
        low = max(SLOWEST_STROKE_HZ, 3 / (time_s[-1] - time_s[0]))
        beat = find_beat(t, mean, lowest_hz=low, highest_hz=min(FASTEST_STROKE_HZ, 0.4 / step))
        if beat is not None:
            found.append(Stroke(name, beat, harmonics(t, mean, beat.frequency_hz)))
    return sorted(found, key=lambda s: -s.beat.share)


def harmonics(time_s: Array, values: Array, frequency_hz: float) -> list[tuple[float, float]]:
    """Frequency and amplitude of the fundamental and its multiples below half the sample rate.

    >>> t = np.arange(0.0, 10.0, 0.01)
    >>> wave = np.sin(2 * np.pi * t) + 0.25 * np.cos(4 * np.pi * t)
    >>> [(f, round(a, 3)) for f, a in harmonics(t, wave, 1.0)[:2]]
    [(1.0, 1.0), (2.0, 0.25)]
    """
    top = 0.45 / float(np.median(np.diff(time_s)))
    orders = [k for k in range(1, HARMONICS + 1) if k * frequency_hz < top]
    phases = 2 * np.pi * frequency_hz * np.outer(time_s - time_s[0], orders)
    design = np.hstack([np.cos(phases), np.sin(phases), np.vander((time_s - time_s.mean()) / np.ptp(time_s), 4)])
    weights = np.linalg.lstsq(design, values, rcond=None)[0]
    size = np.hypot(weights[: len(orders)], weights[len(orders) : 2 * len(orders)])
    return [(k * frequency_hz, float(a)) for k, a in zip(orders, size, strict=True)]
