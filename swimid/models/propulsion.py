"""Propulsion by a rigid caudal fin: the boxfish paper's recoil law, and a beat-averaged surge model."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from swimid.models.base import Array, Channel, Model, Parameter, Trial

SPEED = "mean_speed_m_s"


def plate_inertia(*, height_m: float, length_m: float, axle_gap_m: float, density_kg_m3: float) -> float:
    """Hydrodynamic moment of inertia of a rectangular plate, kg m2 (Eq 6).

    >>> round(1e7 * plate_inertia(height_m=0.0875, length_m=0.0437, axle_gap_m=0.007, density_kg_m3=997), 1)
    1272.8
    """
    return 9 / 128 * density_kg_m3 * math.pi * ((length_m + axle_gap_m) ** 4 - axle_gap_m**4) * height_m


def velocity_ratio(b1: Array | float, start_m: Array | float, end_m: Array | float) -> Array:
    """Average over terminal speed of a run from rest, between two displacements (Eq 25).

    Parameters
    ----------
    b1 : float, 1/m
        ``rho C_d A / (2 (m_f + m_a))`` of Eq 23.
    start_m, end_m : float, m
        Displacements since rest between which the average is taken.

    >>> round(float(velocity_ratio(1.304, 0.0, 1.15)), 3)
    0.688
    """

    def phase(x: Array | float) -> Array:
        # arccosh(exp(y)) = y + log(1 + sqrt(1 - exp(-2y))), without overflow
        y = np.asarray(b1 * np.asarray(x, dtype=float))
        return np.asarray(y + np.log1p(np.sqrt(-np.expm1(-2 * y))))

    return np.asarray(b1 * (np.asarray(end_m) - np.asarray(start_m)) / (phase(end_m) - phase(start_m)))


def strouhal(frequency_hz: Array, amplitude_rad: Array, lever_m: Array, terminal_speed_m_s: Array) -> Array:
    """Strouhal number ``f A_w / v`` with the wake width ``A_w = 2 lever sin(amplitude)`` (Eq 28).

    The paper's nomenclature takes the fin's length as lever; the values it prints fit the
    distance from the axle to the trailing edge (length plus gap) better.
    """
    return frequency_hz * 2 * lever_m * np.sin(amplitude_rad) / terminal_speed_m_s


class RecoilModel(Model):
    """Average speed of cruising runs under the energy recoil law (Eqs 5, 25-27).

    ``v = R_v (8 eta pi^2 I f^p (theta - theta_off)^q / (rho C_d A / 2))^(1/3)``, p = 3 and q = 2
    in the law; both can be freed to test it.

    A trial is one fin; its inputs are ``frequency_hz``, ``amplitude_rad`` and ``distance_m`` per
    run, its settings ``fin`` and, where known, ``inertia_kg_m2``. A fin of unknown inertia has
    the parameter ``inertia_<fin>`` instead.
    """

    name = "propulsion"
    channels = (Channel(SPEED, "m/s", "average speed"),)
    abscissa = "run of the fin"

    def __init__(
        self, *, drag_area_kg_m: float, moving_mass_kg: float, fins: Mapping[str, float | None]
    ) -> None:
        """Take ``rho C_d A / 2`` (kg/m), ``m_f + m_a`` (kg), and the fins' inertias (kg m2)."""
        self.drag_area_kg_m = drag_area_kg_m
        self.b1 = drag_area_kg_m / moving_mass_kg
        known = [i for i in fins.values() if i is not None]
        typical = float(np.median(known)) if known else 1e-4
        self.parameters = (
            Parameter(
                "recoil_efficiency",
                "1",
                0.0,
                1.0,
                0.3,
                0.1,
                free=bool(known),
                meaning="efficiency of the recoil process",
                source="Eq 3",
            ),
            Parameter(
                "amplitude_offset_deg",
                "deg",
                -10.0,
                30.0,
                2.0,
                2.0,
                meaning="flapping amplitude offset",
                source="Eq 27",
            ),
            Parameter("frequency_exponent", "1", 0.0, 6.0, 3.0, 1.0, free=False, meaning="of power, law: 3"),
            Parameter("amplitude_exponent", "1", 0.0, 6.0, 2.0, 1.0, free=False, meaning="of power, law: 2"),
            *(
                Parameter(
                    f"inertia_{fin}",
                    "kg m^2",
                    0.0,
                    math.inf,
                    typical,
                    typical,
                    meaning=f"hydrodynamic inertia of {fin} at the common efficiency",
                )
                for fin, inertia in fins.items()
                if inertia is None
            ),
        )

    def simulate(self, values: Array, trial: Trial) -> dict[str, Array]:
        """Average speed of each run (see :meth:`Model.simulate`)."""
        efficiency, offset, p, q = values[:4]
        inertia = trial.settings.get("inertia_kg_m2")
        if inertia is None:
            inertia = values[self.index(f"inertia_{trial.settings['fin']}")]
        effective = np.maximum(trial.inputs["amplitude_rad"] - np.deg2rad(offset), 0.0)
        # the exponents are about the middle of what was driven, so that freeing one leaves eta
        f_mid, a_mid = trial.settings["middle"]
        power = (
            8
            * efficiency
            * np.pi**2
            * inertia
            * f_mid**3
            * (trial.inputs["frequency_hz"] / f_mid) ** p
            * a_mid**2
            * (effective / a_mid) ** q
        )
        terminal = np.cbrt(power / self.drag_area_kg_m)
        return {SPEED: velocity_ratio(self.b1, 0.0, trial.inputs["distance_m"]) * terminal}


class SurgeModel(Model):
    """Beat-averaged surge of straight swimming: thrust by a power of amplitude, quadratic drag.

    ``du/dt = a (A / A_ref)^n (f / f_ref)^m - c u |u|`` from an initial speed of each trial, with
    n = 2 unless it is freed; m is estimated where several frequencies were driven. A trial's
    settings are ``amplitude_rad``, ``frequency_hz`` and ``start_s``.
    """

    name = "surge-propulsion"
    channels = (Channel("u_m_s", "m/s", "beat-averaged surge"),)

    def __init__(
        self, *, amplitudes_rad: Sequence[float], frequencies_hz: Sequence[float], speed_m_s: float
    ) -> None:
        """Take what was driven, and a typical speed for scales."""
        self.reference_amplitude_rad = float(np.exp(np.mean(np.log(amplitudes_rad))))
        self.reference_frequency_hz = float(np.exp(np.mean(np.log(frequencies_hz))))
        many = len(np.unique(np.round(frequencies_hz, 6))) > 1
        inf = math.inf
        self.parameters = (
            Parameter(
                "thrust_acceleration",
                "m/s^2",
                0.0,
                inf,
                speed_m_s**2,
                speed_m_s**2,
                meaning="thrust over mass at the reference amplitude and frequency",
            ),
            Parameter("surge_drag", "1/m", 0.0, inf, 1.0, 1.0, meaning="quadratic drag over mass"),
            Parameter("amplitude_exponent", "1", 0.0, 6.0, 2.0, 1.0, free=False, meaning="of thrust"),
            Parameter("frequency_exponent", "1", 0.0, 6.0, 2.0, 1.0, free=many, meaning="of thrust"),
            Parameter(
                "initial_speed",
                "m/s",
                -inf,
                inf,
                0.0,
                0.2 * speed_m_s,
                True,
                True,
                "speed at the first sample",
            ),
        )

    def simulate(self, values: Array, trial: Trial) -> dict[str, Array]:
        """Surge at the trial's samples, in closed form (see :meth:`Model.simulate`)."""
        thrust, drag, n, m, u0 = values
        a = (
            thrust
            * (trial.settings["amplitude_rad"] / self.reference_amplitude_rad) ** n
            * (trial.settings["frequency_hz"] / self.reference_frequency_hz) ** m
        )
        t = trial.time_s - trial.settings["start_s"]
        if a <= 0 or drag <= 0:
            return {"u_m_s": u0 + max(a, 0.0) * t}
        terminal, rate = math.sqrt(a / drag), math.sqrt(a * drag)
        growth = np.tanh(rate * t)
        return {"u_m_s": terminal * (u0 + terminal * growth) / (terminal + u0 * growth)}
