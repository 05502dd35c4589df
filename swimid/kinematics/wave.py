"""Body wave of a swimmer: amplitude and phase along the body at the stroke frequency, length and speed.

Also the mean and the amplitude of a joint angle that swings.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from swimid.kinematics.frequency import find_beat, find_slow_motion, waves
from swimid.kinematics.speed import TrackEstimate

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Windows in which a sine is fitted to the lateral motion: length in cycles (CYCLES), minimum number of
#: windows (MIN_WINDOWS), and minimum number of frames in a window (MIN_FRAMES).
CYCLES, MIN_WINDOWS, MIN_FRAMES = 2, 3, 12
#: Minimum number of cycles of a swing (MIN_SWING_CYCLES), and minimum fraction of the variance of an angle
#: that its sine explains (MIN_SINE_SHARE).
MIN_SWING_CYCLES, MIN_SINE_SHARE = 2.0, 0.5


@dataclass(frozen=True)
class Wave:
    """Travelling wave along a body, with 95 % intervals.

    Attributes
    ----------
    behind : ndarray, shape (k,)
            Distance of each of the k stations behind the front end along the straight body, in the unit of
            the positions.
    amplitude, phase : list of TrackEstimate, one for each station
        Amplitude of the lateral motion, and phase lag behind the reference station, rad.
    length, speed : TrackEstimate or None
        Wavelength, and speed of the wave along the body in units per s; None if the phase does not increase
        towards the rear significantly.
    windows : int
        Number of windows of two cycles.
    frequency_hz : float
    reference : int
        Index of the station whose phase lag is zero.
    """

    behind: Array
    amplitude: list[TrackEstimate]
    phase: list[TrackEstimate]
    length: TrackEstimate | None
    speed: TrackEstimate | None
    windows: int
    frequency_hz: float
    reference: int


def spine(parent: Sequence[int], moving: Sequence[bool]) -> list[int]:
    """Return the links from the base to the link with the most moving joints between it and the base.

    Of several such links, the last one is chosen.

    Parameters
    ----------
    parent : sequence of int
        Index of the parent of each link. Parents precede their children; the base is link 0.
    moving : sequence of bool
        Whether a joint moves each link against its parent.

    >>> spine([-1, 0, 1, 0], [False, True, True, True])
    [0, 1, 2]
    """
    depth = [0]
    for up, moves in zip(parent[1:], moving[1:], strict=True):
        depth.append(depth[up] + int(moves))
    way = [max(range(len(depth)), key=lambda link: (depth[link], link))]
    while way[0]:
        way.insert(0, int(parent[way[0]]))
    return way


def stations_of(way: Sequence[int], fronts: Complex, rears: Complex) -> Complex:
    """Return the front ends of the k - 1 links of a spine, and the rear end of the last one, shape (n, k).

    Parameters
    ----------
    way : sequence of int
        Links from the base to the rear, as :func:`spine` returns them.
    fronts, rears : ndarray of complex, shape (n, links)
        Front end and rear end of each link, x + iy.
    """
    return np.column_stack([fronts[:, list(way)], rears[:, way[-1]]])


def distances(straight: Complex) -> Array:
    """Return the distance of each station of a straight body behind its front end, shape (k,)."""
    return np.concatenate([[0.0], np.cumsum(np.abs(np.diff(straight)))])


def measure_wave(
    time_s: Array,
    stations: Complex,
    behind: Array,
    heading: Array,
    frequency_hz: float,
    like: Wave | None = None,
) -> Wave | None:
    """Measure the wave along a body; return None without three windows of two cycles, or without motion.

    Parameters
    ----------
    time_s : ndarray, shape (n,)
    stations : ndarray of complex, shape (n, k)
            Positions x + iy of k stations on the midline; NaN where unknown.
    behind : ndarray, shape (k,)
        Distance of each station behind the front end along the straight body.
    heading : ndarray, shape (n,)
        Heading of the first link, rad; NaN where unknown.
    frequency_hz : float
        Stroke frequency.
    like : Wave, optional
            Wave with the same stations to compare with. Its reference station is used. The returned phases
            differ by whole periods so that they are nearest to its phases. By default, the reference is the
            station that moves most, whose phase is the most accurate.

    Notes
    -----
    The lateral motion is the component across the mean heading of the window. A sine and a parabola in time,
    which describes the path, are fitted to it together. The wavenumber is the slope of the phase over the
    distance along the body, weighted by the squared amplitudes. The intervals are Student's, from the
    variation between windows.
    """
    motion = _fit_lateral_motion(time_s, stations, heading, frequency_hz)
    if len(motion) < MIN_WINDOWS:
        return None
    most = int(np.argmax(np.abs(motion).mean(axis=0)))
    if like is not None:
        most = like.reference
    if not np.abs(motion[:, most]).all():
        return None
    motion *= (np.conj(motion[:, most]) / np.abs(motion[:, most]))[:, None]
    mean = motion.mean(axis=0)
    usual = np.unwrap(np.angle(mean))
    if like is not None:
        nearest = usual[most] - np.array([lag.value for lag in like.phase])
        usual += 2 * np.pi * np.round((nearest - usual) / (2 * np.pi))
    phases = usual + np.angle(motion * np.conj(mean))
    lags = phases[:, most : most + 1] - phases
    weight = np.abs(mean) ** 2
    centre = weight @ behind / weight.sum()
    off = weight * (behind - centre)
    number = _student(lags @ off / (off @ (behind - centre)))
    length = speed = None
    if number.low > 0:
        ends = (number.value, number.high, number.low)
        length = TrackEstimate(*(2 * np.pi / end for end in ends))
        speed = TrackEstimate(*(2 * np.pi * frequency_hz / end for end in ends))
    amplitude = [_student(column) for column in (motion * np.exp(-1j * np.angle(mean))).real.T]
    lag = [_student(column) for column in lags.T]
    return Wave(behind, amplitude, lag, length, speed, len(motion), frequency_hz, most)


def _fit_lateral_motion(time_s: Array, stations: Complex, heading: Array, frequency_hz: float) -> Complex:
    """Return the complex amplitude of the lateral motion of k stations in m windows, shape (m, k)."""
    width = CYCLES / frequency_hz
    known = np.isfinite(stations).all(axis=1) & np.isfinite(heading)
    found = []
    for start in time_s[0] + width * np.arange(int((time_s[-1] - time_s[0]) / width * (1 + 1e-9))):
        rows = known & (time_s >= start) & (time_s < start + width)
        if rows.sum() < MIN_FRAMES or np.ptp(time_s[rows]) < 0.8 * width:
            continue
        t, ahead = time_s[rows], np.mean(np.exp(1j * heading[rows]))
        lateral = (stations[rows] * np.conj(ahead) / abs(ahead)).imag
        design = np.column_stack([waves(t - time_s[0], frequency_hz), np.vander((t - start) / width, 3)])
        weights = np.linalg.lstsq(design, lateral, rcond=None)[0]
        found.append(weights[0] - 1j * weights[1])
    return np.array(found)


@dataclass(frozen=True)
class Swing:
    """Periodic motion of a joint angle.

    Attributes
    ----------
    frequency_hz : float
    mean : float, rad
    amplitude : TrackEstimate
        Amplitude of the sine, rad, with its 95 % interval.
    stderr : float, rad
        Standard error of the amplitude; NaN without two complete cycles.
    """

    frequency_hz: float
    mean: float
    amplitude: TrackEstimate
    stderr: float

    @property
    def data(self) -> dict[str, Any]:
        """Findings as plain data; the interval is null without two complete cycles."""
        size = self.amplitude
        return {
            "frequency_hz": self.frequency_hz,
            "mean_rad": self.mean,
            "amplitude_rad": size.value,
            "amplitude_ci95": None if np.isnan(size.low) else [size.low, size.high],
        }


def measure_swing(time_s: Array, angle: Array, frequency_hz: float | None = None) -> Swing | None:
    """Measure mean and amplitude of an angle that swings.

    Return None if the samples have fewer than two cycles, or if a sine explains less than half the variance.

    Parameters
    ----------
    time_s, angle : ndarray, shape (n,)
        Times, and angles in rad; NaN where unknown.
    frequency_hz : float, optional
        Frequency of the motion. By default it is that of :func:`swimid.kinematics.frequency.find_beat`, or in
        a record of fewer cycles that of :func:`swimid.kinematics.frequency.find_slow_motion`.

    Notes
    -----
    A constant, a sine and its double frequency are fitted to all samples, so that a part of a cycle does not
    shift the mean. The interval of the amplitude is Student's, from the amplitudes of single cycles.
    """
    known = np.isfinite(angle)
    t, x = time_s[known], angle[known]
    if len(t) < MIN_FRAMES or not np.ptp(x):
        return None
    length = float(np.ptp(t))
    if frequency_hz is None:
        beat = find_beat(t, x) or find_slow_motion(t, x)
        if beat is None:
            return None
        frequency_hz = beat.frequency_hz
    weights, error = _sine(t, x, frequency_hz)
    if length * frequency_hz < MIN_SWING_CYCLES or error > (1.0 - MIN_SINE_SHARE) * float(np.var(x)):
        return None
    cycle = np.floor((t - t[0]) * frequency_hz)
    sizes = []
    for number in range(int(length * frequency_hz)):
        rows = cycle == number
        if rows.sum() >= MIN_FRAMES and np.ptp(t[rows]) > 0.8 / frequency_hz:
            own = _sine(t[rows], x[rows], frequency_hz)[0]
            # Take the component of this cycle's sine along the sine of all samples.
            sizes.append(float(own[1:3] @ weights[1:3] / np.hypot(*weights[1:3])))
    size = float(np.hypot(*weights[1:3]))
    stderr = math.nan
    if len(sizes) > 1:
        stderr = float(np.std(sizes, ddof=1) / np.sqrt(len(sizes)))
    amplitude = TrackEstimate.from_stderr(size, stderr, len(sizes) - 1)
    return Swing(frequency_hz, float(weights[0]), amplitude, stderr)


def _sine(t: Array, x: Array, frequency_hz: float) -> tuple[NDArray[np.floating[Any]], float]:
    """Return mean, cosine and sine of both frequencies of a fit, and the mean squared residual."""
    design = np.column_stack((np.ones(len(t)), waves(t, frequency_hz, (1, 2))))
    weights = np.linalg.lstsq(design, x, rcond=None)[0]
    return weights, float(np.mean((x - design @ weights) ** 2))


def _student(values: Array) -> TrackEstimate:
    """Return the mean of values from successive windows with its 95 % interval."""
    stderr = float(values.std(ddof=1)) / np.sqrt(len(values))
    return TrackEstimate.from_stderr(float(values.mean()), stderr, len(values) - 1)
