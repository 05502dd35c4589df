"""Strokes: cycles of several hinges, as a robot file gives them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from swimid.fitting.model import Array
from swimid.robots.spatial import Stroke
from swimid.swimmer.planar.drive import Motion, smoothstep


@dataclass(frozen=True)
class Cycle:
    """A stroke as it is commanded in a trial.

    Attributes
    ----------
    name : str
    law : Stroke
        Of the robot file.
    frequency_hz : float
        Cycles a second.
    scale : float
        What the angles are multiplied with, about those at the start of the cycle.
    ramp_s : float
        The motion is eased in over this time.
    cycles : float
        After so many the hinges stay where the cycle begins; infinite: they go on.
    phase_rad : float
        Phase at time zero.
    """

    name: str
    law: Stroke
    frequency_hz: float
    scale: float = 1.0
    ramp_s: float = 0.0
    cycles: float = math.inf
    phase_rad: float = 0.0

    def motion(self, hinge: str, time_s: Array, *, phase_rad: float = 0.0) -> Motion:
        """Angle, rate and acceleration of a hinge; those the stroke does not name stay straight.

        Parameters
        ----------
        time_s : ndarray, shape (n,)
            Zero is where the stroke begins; before, the hinge holds its first angle.

        Returns
        -------
        tuple of ndarray, each shape (n,)
            rad, rad/s, rad/s2.
        """
        zero = np.zeros_like(time_s)
        if hinge not in self.law.angles_deg:
            return zero, zero, zero
        knots = np.array(self.law.knots_s) / self.law.period_s
        angles = np.radians(self.law.angles_deg[hinge])
        spline = CubicSpline(knots, angles, bc_type="periodic")
        begun = self.frequency_hz * time_s
        share = np.clip(begun, 0.0, self.cycles) + (self.phase_rad + phase_rad) / (2.0 * math.pi)
        at = np.mod(share, 1.0)
        f = self.frequency_hz * ((begun >= 0.0) & (begun <= self.cycles))
        first = float(angles[0])
        value = self.scale * (spline(at) - first)
        rate, bend = self.scale * f * spline(at, 1), self.scale * f**2 * spline(at, 2)
        ease, slope, curve = smoothstep(time_s, self.ramp_s)
        return (
            first + value * ease,
            rate * ease + value * slope,
            bend * ease + 2.0 * rate * slope + value * curve,
        )
