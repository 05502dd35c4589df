"""Joint torques, powers and energy balance of a simulation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from swimid.fitting.model import Array
from swimid.swimmer.planar.engine import PASSIVE


@dataclass(frozen=True)
class Energetics:
    """Torques, powers and energies of a simulation, at its integration steps.

    Attributes
    ----------
    time_s : ndarray, shape (m,)
        Times with an even step.
    torque_N_m, rate_rad_s : ndarray, shape (m, driven joints)
        Torque of each driven joint on its child link, and rate of the joint.
    passive_torque_N_m, passive_rate_rad_s : ndarray, shape (m, passive joints)
        Torque of spring, wire and damper of each passive joint, and rate of the joint.
    kinetic_J : ndarray, shape (m,)
        Kinetic energy of the robot and of the added mass of the water.
    stored_J : ndarray, shape (m,)
        Energy stored in the springs of passive joints.
    water_W : ndarray, shape (m,)
        Power given to the water by drag, foils and trailing edges.
    weight_W : ndarray, shape (m,)
        Power that the robot gives to constant forces: weight and buoyancy.
    dissipated_W : ndarray, shape (m,)
        Power dissipated in the dampers of passive joints.
    """

    time_s: Array
    torque_N_m: Array
    rate_rad_s: Array
    passive_torque_N_m: Array
    passive_rate_rad_s: Array
    kinetic_J: Array
    stored_J: Array
    water_W: Array
    weight_W: Array
    dissipated_W: Array

    @property
    def power_W(self) -> Array:
        """Mechanical power of each driven joint, shape (m, driven joints)."""
        return self.torque_N_m * self.rate_rad_s

    def mean(self, power_W: Array) -> float:
        """Return the mean of a power over the simulated time by the trapezoidal rule, W."""
        return float(np.trapezoid(power_W, self.time_s) / (self.time_s[-1] - self.time_s[0]))

    def mean_power_W(self) -> float:
        """Return the mean mechanical power of all driven joints together, W. Negative power is subtracted."""
        return self.mean(self.power_W.sum(axis=1))

    def mean_positive_power_W(self) -> float:
        """Return the mean mechanical power of all driven joints without energy recovery, W.

        Negative power of a joint counts as zero.
        """
        return self.mean(np.maximum(self.power_W, 0.0).sum(axis=1))

    def balance_J(self) -> tuple[float, float]:
        """Return the work of the driven joints, and the energy into which it was converted, J.

        The second value is the work on water, weight and dampers plus the change of the stored and kinetic
        energy. The difference between the two values is the error of the integration.
        """
        duration = self.time_s[-1] - self.time_s[0]
        gone = duration * self.mean(self.water_W + self.weight_W + self.dissipated_W)
        kept = self.kinetic_J + self.stored_J
        return duration * self.mean_power_W(), gone + float(kept[-1] - kept[0])


def elastic(passive: Array, angle: Array, rate: Array) -> tuple[Array, Array]:
    """Return power dissipated in the dampers (W) and energy in the springs (J) of passive joints, shape (m,).

    Parameters
    ----------
    passive : ndarray, shape (joints, 11)
        The columns are those of :data:`swimid.swimmer.planar.engine.PASSIVE`.
    angle, rate : ndarray, shape (m, joints), rad and rad/s

    Notes
    -----
    The energy of a wire with a spring is ``K_t d_p d_t + K_t d_t^2 / 2`` (tendon fish, Eq 4), with the
    elongation ``d_t`` from Eq 3.
    """
    law = dict(zip(PASSIVE, passive.T, strict=True))
    speed = np.abs(rate)
    lost = (law["damping"] + law["quadratic_damping"] * speed) * rate**2
    smooth = np.sqrt(rate**2 + law["friction_below"] ** 2)
    lost += law["friction"] * rate**2 / np.where(smooth > 0, smooth, 1.0)
    off = angle - law["rest"]
    arm, crank = law["arm"], law["crank"]
    stretch = np.sqrt(arm**2 + crank**2 - 2.0 * arm * crank * np.cos(angle)) - arm + crank
    stored = 0.5 * law["stiffness"] * off**2 + 0.25 * law["cubic"] * off**4
    stored += law["spring"] * (law["pretension"] * stretch + 0.5 * stretch**2)
    return lost.sum(axis=1), stored.sum(axis=1)
