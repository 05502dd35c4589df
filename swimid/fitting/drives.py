"""Motions of driven joints: tail beats and strokes."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from swimid.robots.spatial import HingeStroke

Array = NDArray[np.float64]
#: Type of a joint motion: angle (rad), rate (rad/s) and acceleration (rad/s2) at given times.
Motion = tuple[Array, Array, Array]


def ease_in(time_s: Array, ramp_s: float) -> Array:
    """Return a quintic smoothstep, which rises from 0 at time zero to 1 at ``ramp_s`` > 0."""
    found = np.array(np.clip(time_s / ramp_s, 0.0, 1.0))
    rising = (found > 0.0) & (found < 1.0)
    s = found[rising]
    found[rising] = s**3 * (10.0 + s * (6.0 * s - 15.0))
    return found


def smoothstep(time_s: Array, ramp_s: float) -> Motion:
    """Return the smoothstep :func:`ease_in` and its first two time derivatives; a step for ``ramp_s`` 0."""
    if ramp_s <= 0:
        on = (time_s >= 0).astype(float)
        return on, np.zeros_like(on), np.zeros_like(on)
    s = np.clip(time_s / ramp_s, 0.0, 1.0)
    return (
        ease_in(time_s, ramp_s),
        30.0 * s**2 * (1.0 - s) ** 2 / ramp_s,
        60.0 * s * (1.0 - s) * (1.0 - 2.0 * s) / ramp_s**2,
    )


def straight(time_s: Array) -> Motion:
    """Return the motion of a joint that stays straight: zero angle, rate and acceleration."""
    zero = np.zeros_like(time_s)
    return zero, zero, zero


def _apply_ramp(drive: TailBeat | Cycle, time_s: Array, motion: Motion) -> Motion:
    """Return a joint motion multiplied by the ramp of the drive, a smoothstep that begins at time zero.

    The motion is unchanged if the drive is steady.
    """
    if drive.steady:
        return motion
    value, rate, bend = motion
    ease, slope, curve = smoothstep(time_s, drive.ramp_s)
    return value * ease, rate * ease + value * slope, bend * ease + 2.0 * rate * slope + value * curve


@dataclass(frozen=True)
class TailBeat:
    """Commanded tail beat of a trial, in SI units."""

    #: Waveform: ``sine``, ``hopf`` or ``a-cpg``.
    waveform: str
    frequency_hz: float
    amplitude_rad: float
    bias_rad: float = 0.0
    #: Asymmetry h_a of the oscillator (:func:`hopf`). The angle rises during the fraction (1 - h_a) / 2 of a
    #: period.
    asymmetry: float = 0.0
    #: Duration of the quintic smoothstep with which the command begins, s.
    ramp_s: float = 1.0
    #: Phase of the beat at time zero, rad.
    phase_rad: float = 0.0
    #: Phase lag of each driven joint behind the joint before it, in addition to the lag in the robot file.
    lag_rad: float = 0.0
    #: Whether the beat is steady, without a beginning and without a ramp.
    steady: bool = False

    def motion(
        self,
        time_s: Array,
        *,
        gain: float = 1.0,
        bias_gain: float = 1.0,
        phase_rad: float = 0.0,
        cell_s: Array | None = None,
    ) -> Motion:
        """Return angle, rate and acceleration of a joint, rad, rad/s and rad/s2, shape (n,) each.

        Parameters
        ----------
        time_s : ndarray, shape (n,)
            Times. The beat starts at time zero with ``phase_rad``. Before time zero the joint is straight.
        gain, bias_gain : float
            Factors applied to the amplitude and to the bias of the beat for this joint.
        phase_rad : float
            Phase by which the joint leads the beat.
        cell_s : ndarray, shape (n,), optional
            Duration of the interval around each time (:func:`cells`) over which the acceleration is averaged.
            The average is used for waveforms whose acceleration jumps (a-cpg).
        """
        phase = self.phase_rad + phase_rad
        value, rate, bend = self._wave(time_s, phase)
        if cell_s is not None and self.waveform == "a-cpg":
            ends = [self._wave(time_s + side * cell_s, phase)[1] for side in (-0.5, 0.5)]
            bend = (ends[1] - ends[0]) / cell_s
        a, b = gain * self.amplitude_rad, bias_gain * self.bias_rad
        return _apply_ramp(self, time_s, (a * value + b, a * rate, a * bend))

    def _wave(self, time_s: Array, phase_rad: float) -> Motion:
        if self.waveform != "sine":
            asymmetry = self.asymmetry * (self.waveform == "a-cpg")
            return hopf(time_s, self.frequency_hz, asymmetry, phase_rad)
        omega = 2.0 * math.pi * self.frequency_hz
        angle = omega * time_s + phase_rad
        return np.sin(angle), omega * np.cos(angle), -(omega**2) * np.sin(angle)


def cells(time_s: Array) -> Array:
    """Return for each time of a half-step grid the duration over which an acceleration is averaged.

    The durations follow from the weights of the Runge-Kutta method. They are a third of a step at the ends of
    a step, and two thirds of a step in the middle. With accelerations averaged over them, the integrated rate
    is correct even if the acceleration jumps.
    """
    half = float(time_s[1] - time_s[0])
    return np.where(np.arange(len(time_s)) % 2 == 0, 2.0 / 3.0 * half, 4.0 / 3.0 * half)


def hopf(time_s: Array, frequency_hz: float, asymmetry: float, phase_rad: float = 0.0) -> Motion:
    """Return the output alpha of the (asymmetric) Hopf oscillator on its limit cycle of radius 1.

    Parameters
    ----------
    asymmetry : float
        Asymmetry h_a, between -1 and 1.
    phase_rad : float
        Phase of the beat at time zero. With asymmetry, 2 pi times the elapsed fraction of the period.

    Notes
    -----
    The function is Eq 10 of "Locomotion Optimization of a Tendon-Driven Robotic Fish with Variable Passive
    Tail Fin", with two corrections. In the printed equation the bias has no effect on alpha; here it is added
    to the output. In the printed equation the radius is the square root of the amplitude A, and the rate of
    approach depends on the unit of A; here the radius is 1, and A multiplies the output.

    On the limit cycle ``alpha = sin(psi)`` and ``psi' = omega / (1 - h sgn(alpha'))``. The asymmetry does not
    change the period. The angle rises during (1 - h) / 2 of the period and falls during (1 + h) / 2 of it.
    The acceleration jumps where the angle is largest and smallest.

    >>> value, rate, _ = hopf(np.array([0.0, 0.25]), 1.0, 0.0)
    >>> [round(float(v), 12) for v in value]
    [0.0, 1.0]
    """
    omega = 2.0 * math.pi * frequency_hz
    rising = 0.5 * (1.0 - asymmetry)  # fraction of the period in which alpha rises
    # Compute the fraction of the period that has elapsed since the last minimum. The drive starts in the
    # middle of the rise.
    share = np.mod(frequency_hz * time_s + phase_rad / (2.0 * math.pi) + 0.5 * rising, 1.0)
    up = share < rising
    falls = 0.5 * math.pi + math.pi * (share - rising) / (1.0 - rising)
    psi = np.where(up, -0.5 * math.pi + math.pi * share / rising, falls)
    speed = np.where(up, omega / (1.0 - asymmetry), omega / (1.0 + asymmetry))
    return np.sin(psi), speed * np.cos(psi), -(speed**2) * np.sin(psi)


@dataclass(frozen=True)
class Cycle:
    """Commanded stroke of a trial, a cyclic motion of several hinges that the robot file defines."""

    name: str
    #: Stroke in the robot file: angles of the hinges over one cycle.
    law: HingeStroke
    #: Frequency of the stroke: cycles per second.
    frequency_hz: float
    #: Factor applied to the deviation of the angles from their values at the start of the cycle.
    scale: float = 1.0
    #: Duration of the smoothstep with which the motion begins, s.
    ramp_s: float = 0.0
    #: Number of cycles. After the last cycle the hinges stay at the angles of the start of the cycle.
    #: Infinite for a stroke that does not end.
    cycles: float = math.inf
    #: Phase of the cycle at time zero.
    phase_rad: float = 0.0
    #: Whether the stroke is steady, without a beginning, a ramp or an end.
    steady: bool = False

    def motion(self, hinge: str, time_s: Array, *, phase_rad: float = 0.0) -> Motion:
        """Return angle, rate and acceleration of a hinge during the stroke, rad, rad/s and rad/s2.

        The stroke begins at time zero. Before that the hinge has its angle at the start of the cycle. A hinge
        that the stroke does not name stays straight.
        """
        from scipy import interpolate

        if hinge not in self.law.angles_deg:
            return straight(time_s)
        knots = np.array(self.law.knots_s) / self.law.period_s
        angles = np.radians(self.law.angles_deg[hinge])
        spline = interpolate.CubicSpline(knots, angles, bc_type="periodic")
        begun = self.frequency_hz * time_s
        first_cycle, last_cycle = 0.0, self.cycles
        if self.steady:
            first_cycle, last_cycle = -math.inf, math.inf
        share = np.clip(begun, first_cycle, last_cycle) + (self.phase_rad + phase_rad) / (2.0 * math.pi)
        at = np.mod(share, 1.0)
        f = self.frequency_hz * ((begun >= first_cycle) & (begun <= last_cycle))
        first = float(angles[0])
        value = self.scale * (spline(at) - first)
        rate, bend = self.scale * f * spline(at, 1), self.scale * f**2 * spline(at, 2)
        angle, rate, bend = _apply_ramp(self, time_s, (value, rate, bend))
        return first + angle, rate, bend
