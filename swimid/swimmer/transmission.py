"""Transmissions: the motions of joints that follow an actuator by a ratio or by a table of angles."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import PchipInterpolator

from swimid.fitting.drives import Array, Motion
from swimid.robots.planar import Driven
from swimid.swimmer.tree import Polynomial


class Transmission:
    """Angle of a joint as a function of the angle of its actuator.

    Between the rows of a table the function is a monotone cubic (PCHIP, Fritsch and Butland 1984). Beyond the
    table it is the tangent at the last row, so that the rate of the joint does not jump.

    Parameters
    ----------
    law : Driven
        Law of the joint. Without an actuator of several joints, the joint has the angle of its own actuator.

    Attributes
    ----------
    ratio : Polynomial
        Joint angle divided by actuator angle. It may depend on the coefficients of the robot.
    range_rad : (float, float)
        First and last actuator angle of the table, rad. They are infinite without a table.
    """

    def __init__(self, law: Driven) -> None:
        self.ratio = Polynomial.of(law.ratio)
        self.range_rad = -np.inf, np.inf
        self._curves: list[PchipInterpolator] = []
        if law.table_deg is not None:
            actuator, joint = np.radians(law.table_deg).T
            self.range_rad = float(actuator[0]), float(actuator[-1])
            curve = PchipInterpolator(actuator, joint)
            self._curves = [curve, curve.derivative(), curve.derivative(2)]

    def motion(self, actuator: Motion, ratio: float) -> Motion:
        """Return angle, rate and acceleration of the joint (rad, rad/s, rad/s2), shape (n,) each.

        Parameters
        ----------
        actuator : (angle, rate, acceleration)
            Motion of the actuator in the same units and with the same shapes.
        ratio : float
            Value of :attr:`ratio`. It has no effect on a table.
        """
        angle, rate, acceleration = actuator
        if not self._curves:
            if ratio == 1.0:
                return actuator
            return ratio * angle, ratio * rate, ratio * acceleration
        inside = np.clip(angle, *self.range_rad)
        value, slope, bend = (np.asarray(curve(inside)) for curve in self._curves)
        bend = np.where(inside == angle, bend, 0.0)
        return value + slope * (angle - inside), slope * rate, slope * acceleration + bend * rate**2

    def slope(self, ratio: float) -> float:
        """Return the rate of the joint divided by that of the actuator at the actuator angle zero."""
        at_zero: Array = np.zeros(1)
        return float(self.motion((at_zero, at_zero + 1.0, at_zero), ratio)[1][0])
