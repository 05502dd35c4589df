"""Inputs of trials: beats and strokes of joints, and known quantities of each kind of experiment.

Every trial has an input of each kind. The defaults of its fields mean that nothing is known.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from swimid.robots.spatial import Stroke

Array = NDArray[np.float64]
#: Angle, rate and acceleration at given times.
Motion = tuple[Array, Array, Array]


def eased(time_s: Array, ramp_s: float) -> Array:
    """Return the quintic ease-in from 0 to 1 over ``ramp_s`` > 0."""
    found = np.array(np.clip(time_s / ramp_s, 0.0, 1.0))
    rising = (found > 0.0) & (found < 1.0)
    s = found[rising]
    found[rising] = s**3 * (10.0 + s * (6.0 * s - 15.0))
    return found


def smoothstep(time_s: Array, ramp_s: float) -> Motion:
    """Return the ease-in of :func:`eased` with its first two derivatives; a step if ``ramp_s`` is zero."""
    if ramp_s <= 0:
        on = (time_s >= 0).astype(float)
        return on, np.zeros_like(on), np.zeros_like(on)
    s = np.clip(time_s / ramp_s, 0.0, 1.0)
    return (
        eased(time_s, ramp_s),
        30.0 * s**2 * (1.0 - s) ** 2 / ramp_s,
        60.0 * s * (1.0 - s) * (1.0 - 2.0 * s) / ramp_s**2,
    )


def straight(time_s: Array) -> Motion:
    """Return the motion of a joint that stays straight."""
    zero = np.zeros_like(time_s)
    return zero, zero, zero


def _ramped(drive: Beat | Cycle, time_s: Array, motion: Motion) -> Motion:
    """Return a motion that is eased in from time zero on; unchanged if it is steady."""
    if drive.steady:
        return motion
    value, rate, bend = motion
    ease, slope, curve = smoothstep(time_s, drive.ramp_s)
    return value * ease, rate * ease + value * slope, bend * ease + 2.0 * rate * slope + value * curve


@dataclass(frozen=True)
class Beat:
    """A commanded tail beat, in SI units."""

    #: ``sine``, ``hopf`` or ``a-cpg``.
    waveform: str
    frequency_hz: float
    amplitude_rad: float
    bias_rad: float = 0.0
    #: h_a of Eq 10: the half-beat with a rising angle lasts (1 - h) / 2 of a period.
    asymmetry: float = 0.0
    #: Time over which a quintic smoothstep eases in the whole command.
    ramp_s: float = 1.0
    #: Phase at time zero.
    phase_rad: float = 0.0
    #: Phase lag of each driven joint behind the one before it, beyond that of the robot file.
    lag_rad: float = 0.0
    #: The beat has no begin and no ramp.
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
            The drive starts at zero, with phase zero; before that the joint is straight.
        gain, bias_gain : float
            The joint's share of amplitude and bias.
        phase_rad : float
            Phase ahead of the drive.
        cell_s : ndarray, shape (n,), optional
            If the acceleration jumps (a-cpg), return its mean over such an interval around each time
            (:func:`cells`).
        """
        phase = self.phase_rad + phase_rad
        value, rate, bend = self._wave(time_s, phase)
        if cell_s is not None and self.waveform == "a-cpg":
            ends = [self._wave(time_s + side * cell_s, phase)[1] for side in (-0.5, 0.5)]
            bend = (ends[1] - ends[0]) / cell_s
        a, b = gain * self.amplitude_rad, bias_gain * self.bias_rad
        return _ramped(self, time_s, (a * value + b, a * rate, a * bend))

    def _wave(self, time_s: Array, phase_rad: float) -> Motion:
        omega = 2.0 * math.pi * self.frequency_hz
        if self.waveform == "a-cpg":
            return hopf(time_s, self.frequency_hz, self.asymmetry, phase_rad)
        if self.waveform == "hopf":
            return hopf(time_s, self.frequency_hz, 0.0, phase_rad)
        angle = omega * time_s + phase_rad
        return np.sin(angle), omega * np.cos(angle), -(omega**2) * np.sin(angle)


def cells(time_s: Array) -> Array:
    """Return the intervals around the times of a half-step grid that Runge-Kutta's weights assign to them.

    They are a third of a step at the ends of a step and two thirds in its middle. An acceleration that is
    averaged over them adds up to the right rate, wherever it jumps.
    """
    half = float(time_s[1] - time_s[0])
    return np.where(np.arange(len(time_s)) % 2 == 0, 2.0 / 3.0 * half, 4.0 / 3.0 * half)


def hopf(time_s: Array, frequency_hz: float, asymmetry: float, phase_rad: float = 0.0) -> Motion:
    """Return the output alpha of the (asymmetric) Hopf oscillator on its limit cycle of radius one.

    Parameters
    ----------
    asymmetry : float
        h_a, between -1 and 1.
    phase_rad : float
        Phase of the beat at time zero; with asymmetry it stands for the share of the period.

    Notes
    -----
    Eq 10 of the tendon fish paper, with two corrections. The bias belongs to the output: as printed it drops
    out of alpha. The radius is one with the amplitude as a gain: as printed it would be the square root of A,
    reached at a rate that depends on the unit of A. On the limit cycle ``alpha = sin(psi)`` and ``psi' =
    omega / (1 - h sgn(alpha'))``. The period is unchanged, the angle rises in (1 - h) / 2 of it and falls in
    (1 + h) / 2, and the acceleration jumps at the turns.

    >>> value, rate, _ = hopf(np.array([0.0, 0.25]), 1.0, 0.0)
    >>> [round(float(v), 12) for v in value]
    [0.0, 1.0]
    """
    omega = 2.0 * math.pi * frequency_hz
    rising = 0.5 * (1.0 - asymmetry)  # share of the period with alpha rising
    # share of the period since the last lowest point; the drive starts in the middle of the rise
    share = np.mod(frequency_hz * time_s + phase_rad / (2.0 * math.pi) + 0.5 * rising, 1.0)
    up = share < rising
    psi = np.where(
        up,
        -0.5 * math.pi + math.pi * share / rising,
        0.5 * math.pi + math.pi * (share - rising) / (1.0 - rising),
    )
    speed = np.where(up, omega / (1.0 - asymmetry), omega / (1.0 + asymmetry))
    return np.sin(psi), speed * np.cos(psi), -(speed**2) * np.sin(psi)


@dataclass(frozen=True)
class Cycle:
    """A stroke as commanded in a trial."""

    name: str
    #: Stroke of the robot file.
    law: Stroke
    #: Cycles per second.
    frequency_hz: float
    #: Factor on the angles, about those at the start of the cycle.
    scale: float = 1.0
    #: Time over which the motion is eased in.
    ramp_s: float = 0.0
    #: Number of cycles, after which the hinges stay where the cycle begins; infinite for no end.
    cycles: float = math.inf
    #: Phase at time zero.
    phase_rad: float = 0.0
    #: The stroke has no begin, no ramp and no end.
    steady: bool = False

    def motion(self, hinge: str, time_s: Array, *, phase_rad: float = 0.0) -> Motion:
        """Return angle, rate and acceleration of a hinge; hinges that the stroke does not name stay straight.

        The stroke begins at time zero. Before, the hinge holds its first angle.
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
        angle, rate, bend = _ramped(self, time_s, (value, rate, bend))
        return first + angle, rate, bend


# ---------------------------------------------------------------- inputs of trials


@dataclass(frozen=True)
class RigInput:
    """Known quantities of a body on a test rig."""

    #: Known part, kg or kg m2, with pulling mass and pulley; NaN if unknown.
    inertia: float = math.nan
    #: Constant known force, N.
    force: float | None = None
    #: The friction of a pulley acts.
    pulley: bool = False
    #: ``rho A / 2``, kg/m; 0 if the quadratic coefficient itself is estimated.
    area_factor: float = 0.0
    #: Time of release; None means zero.
    release_s: float | None = None
    #: Displacement at release, m or rad.
    x0: float = 0.0

    @property
    def pull(self) -> float:
        """Constant force, N; 0 if there is none."""
        return self.force or 0.0

    @property
    def begin_s(self) -> float:
        """Time of release, s."""
        return self.release_s or 0.0


@dataclass(frozen=True)
class SwimInput:
    """Drive and start of a robot with links."""

    beat: Beat | None = None
    stroke: Cycle | None = None
    #: Motion of each driven joint at given times, s, instead of a drive.
    joints: Sequence[Callable[[Array], Motion]] | None = None
    #: The motions of the joints are commands, and not measured.
    commanded: bool = False
    #: Pose of the reference point at the first sample, to which the start offsets are added.
    pose: tuple[float, ...] | None = None
    #: Coefficients that were set otherwise in this trial.
    coefficients: Mapping[str, float] | None = None

    @property
    def drive(self) -> Beat | Cycle | None:
        """Beat or stroke; None if measured joints, or nothing, move the robot."""
        return self.beat or self.stroke

    @property
    def steady(self) -> bool:
        """Whether the run begins on the limit cycle of its drive."""
        return self.drive is not None and self.drive.steady

    def begun(self) -> SwimInput:
        """Return the same run in steady swimming: it begins on the limit cycle of its drive."""
        if self.stroke is not None:
            return replace(self, stroke=replace(self.stroke, steady=True, ramp_s=0.0, cycles=math.inf))
        if self.beat is None:
            return self
        return replace(self, beat=replace(self.beat, steady=True, ramp_s=0.0))

    @property
    def measured(self) -> bool:
        """Whether measured joints move the robot: they are the output of the actuators."""
        return self.joints is not None and not self.commanded

    def posed(self, count: int = 3) -> tuple[float, ...]:
        """Return the start pose; the origin if unknown."""
        return self.pose or (0.0,) * count


@dataclass(frozen=True)
class CruiseInput:
    """Known quantities of timed runs with one fin."""

    fin: str = ""
    #: Hydrodynamic inertia of the fin, if known.
    inertia_kg_m2: float | None = None
    #: Frequency (Hz) and amplitude (rad) to which the exponents of the law refer.
    middle: tuple[float, float] = (1.0, 1.0)
    #: Rows of the table.
    rows: NDArray[np.intp] | None = None


@dataclass(frozen=True)
class SurgeInput:
    """A steady beat of a run of which only the mean over each beat is used."""

    #: NaN if there is no such beat.
    frequency_hz: float = math.nan
    amplitude_rad: float = math.nan
    #: Time of the first sample.
    start_s: float = 0.0
