"""The beat frequency of a swimming log, with its uncertainty."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import optimize, signal

Array = NDArray[np.float64]


#: Steps that differ by less than this share of their mean are even.
EVEN = 1e-3


@dataclass(frozen=True)
class Beat:
    """A periodic component.

    Attributes
    ----------
    frequency_hz, stderr_hz : float
    amplitude : float
        Of the fundamental, in the channel's unit.
    share : float
        Part of the detrended variance that the fundamental explains.
    """

    frequency_hz: float
    stderr_hz: float
    amplitude: float
    share: float


#: A beat frequency this far from the stated one, as a share of it, contradicts it.
TOLERANCE = 0.05


def contradiction(found: Beat, stated_hz: float) -> str | None:
    """In words, how a beat contradicts a stated frequency; None where it does not.

    >>> contradiction(Beat(2.0, 0.01, 1.0, 0.9), 1.0)
    'beats at 2.000 ± 0.010 Hz, 2.00 times as fast'
    """
    if abs(found.frequency_hz - stated_hz) <= max(TOLERANCE * stated_hz, 3 * found.stderr_hz):
        return None
    ratio = found.frequency_hz / stated_hz
    whole = f", {ratio:.2f} times as fast" if abs(ratio - round(ratio)) < 0.05 and ratio > 1.5 else ""
    return f"beats at {found.frequency_hz:.3f} ± {found.stderr_hz:.3f} Hz{whole}"


def find_beat(
    time_s: Array, values: Array, *, lowest_hz: float | None = None, highest_hz: float | None = None
) -> Beat | None:
    """The strongest periodic component of a channel, or None where there is none.

    Parameters
    ----------
    time_s, values : ndarray, shape (n,)
        Uneven steps and NaN are allowed.
    lowest_hz, highest_hz : float, optional
        Range searched; default two periods in the record to half the sample rate.

    Returns
    -------
    Beat or None
        None when the record is too short or no line explains 20 % of the variance.

    Notes
    -----
    The peak of the Lomb-Scargle spectrum of the record less a cubic, refined by fitting a sine.
    Standard error from the sine's fit (Cramer-Rao bound at the residual variance), doubled for a
    drifting rhythm.
    """
    there = np.isfinite(values) & np.isfinite(time_s)
    t, x = time_s[there], values[there]
    if len(t) < 16:
        return None
    duration, step = t[-1] - t[0], float(np.median(np.diff(t)))
    low = lowest_hz or 2.0 / duration
    # no more frequencies than an even record of as many samples has, however uneven this one is
    high = min(highest_hz or 0.45 / step, low + 2 * len(t) / duration)
    if high <= low:
        return None
    centred = t - t.mean()
    x = x - np.polyval(np.polyfit(centred, x, 3), centred)
    if np.std(x) == 0:
        return None
    grid = np.arange(low, high, 0.1 / duration)
    if len(grid) < 4:
        return None
    tapered = x * signal.windows.tukey(len(x), 0.2)
    power = _power(t, tapered - tapered.mean(), grid)
    guess = float(grid[np.argmax(power)])

    def left(frequency: float) -> float:
        return float(np.sum((x - _sine(t, x, frequency)[0]) ** 2))

    width = 0.3 / duration
    found = optimize.minimize_scalar(
        left,
        bounds=(max(guess - width, 0.5 * low), guess + width),
        method="bounded",
        options={"xatol": 1e-6 * guess},
    )
    frequency = float(found.x)
    model, amplitude = _sine(t, x, frequency)
    residual = float(np.var(x - model))
    share = 1.0 - residual / float(np.var(x))
    if share < 0.2:
        return None
    stderr = 2.0 * np.sqrt(6.0 * residual / (len(t) * amplitude**2)) / (np.pi * duration)
    return Beat(frequency, float(stderr), amplitude, share)


def _power(t: Array, x: Array, grid: Array) -> Array:
    """Periodogram of a record at given frequencies, by FFT where its steps are even."""
    steps = np.diff(t)
    step = float(np.mean(steps))
    if np.ptp(steps) > EVEN * step:
        return np.asarray(signal.lombscargle(t, x, 2 * np.pi * grid))
    count = 1 << int(np.ceil(np.log2(20 * len(x))))
    return np.interp(grid, np.fft.rfftfreq(count, step), np.abs(np.fft.rfft(x, count)) ** 2)


def _sine(t: Array, x: Array, frequency: float) -> tuple[Array, float]:
    phase = 2 * np.pi * frequency * t
    design = np.column_stack((np.cos(phase), np.sin(phase), np.ones_like(t)))
    weights = np.linalg.lstsq(design, x, rcond=None)[0]
    return design @ weights, float(np.hypot(weights[0], weights[1]))
