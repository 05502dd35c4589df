"""Models of propulsion by a caudal fin: the energy recoil law, and a model of beat-averaged surge.

Equation numbers are those of W. L. Chan et al., "Experimental Parameter Identification and Performance
Analysis of a Fish Robot with Ostraciiform Swimming Mode using Rigid Caudal Fins".
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from swimid.files.kernels import numba
from swimid.fitting.model import (
    MEAN_SPEED,
    Array,
    Channel,
    Hooks,
    Model,
    Parameter,
    Scales,
    Stroke,
    Trial,
)

SPEED = MEAN_SPEED
#: Maximum integration step of the surge model, s, if its equation of motion has no closed-form solution.
CRUISE_STEP_S = 0.05
#: Maximum number of iterations of Newton's method for speeds and distances of cruise runs. The method
#: converges in fewer iterations, because the functions are convex and the search starts above the root.
MAX_ITERATIONS = 60


def plate_inertia(height_m: float, length_m: float, axle_gap_m: float, density_kg_m3: float) -> float:
    """Return the hydrodynamic moment of inertia of a rectangular fin, kg m2 (Chan et al., boxfish, Eq 6).

    >>> round(1e7 * plate_inertia(height_m=0.0875, length_m=0.0437, axle_gap_m=0.007, density_kg_m3=997), 1)
    1272.8
    """
    return 9 / 128 * density_kg_m3 * math.pi * ((length_m + axle_gap_m) ** 4 - axle_gap_m**4) * height_m


def velocity_ratio(b1: Array | float, distance_m: Array | float) -> Array:
    """Return the average speed of a run from rest divided by the terminal speed (Chan et al., Eq 25).

    Parameters
    ----------
    b1 : float, 1/m
        Coefficient ``rho C_d A / (2 (m_f + m_a))`` of Eq 23, with the mass m_f and the added mass m_a.
    distance_m : float, m
        Displacement from the point of rest, over which the speed is averaged.

    >>> round(float(velocity_ratio(1.304, 1.15)), 3)
    0.688
    """
    y = np.asarray(b1 * np.asarray(distance_m, dtype=float))
    # Compute arccosh(exp(y)) as y + log(1 + sqrt(1 - exp(-2y))), which does not overflow for large y.
    return np.asarray(y / (y + np.log1p(np.sqrt(-np.expm1(-2 * y)))))


def compute_cruise_speed(power: Array, c: Mapping[str, float]) -> Array:
    """Return the steady speed at which drag consumes a given propulsive power, m/s.

    The speed is the largest root of ``v (dry + linear v + quadratic v^2) = power``. It is zero if the power
    is not positive. For quadratic drag alone it is ``(power / quadratic)^(1/3)`` (Chan et al., Eq 26).

    Parameters
    ----------
    power : ndarray, W
    c : mapping of str to float
        Drag coefficients ``quadratic``, ``linear`` and ``dry``: kg/m, kg/s and N.
    """
    quadratic, linear, dry = c["quadratic"], c["linear"], c["dry"]

    def newton(v: Array) -> Array:
        slope = dry + v * (2 * linear + 3 * v * quadratic)
        return (v * (dry + v * (linear + v * quadratic)) - power) / np.where(slope > 0, slope, np.inf)

    start = np.cbrt(power / quadratic) + np.abs(linear) / quadratic + np.sqrt(np.abs(dry) / quadratic)
    return np.where(power > 0, _root(newton, start), 0.0)


def _root(step: Callable[[Array], Array], start: Array) -> Array:
    """Return a root of a function by Newton's method.

    ``step`` is the function divided by its derivative, and ``start`` the initial value.
    """
    for _ in range(MAX_ITERATIONS):
        change = step(start)
        start = start - change
        if not np.any(np.abs(change) > 1e-14 * np.abs(start) + 1e-300):
            break
    return start


def compute_mean_speed(terminal_m_s: Array, distance_m: Array, c: Mapping[str, float]) -> Array:
    """Return the average speed of a robot that swims a distance from rest with constant thrust, m/s.

    Over an infinite distance the robot would reach the given terminal speed. Dry friction is not an argument,
    because it only reduces the thrust.

    Parameters
    ----------
    terminal_m_s, distance_m : ndarray
        Terminal speed and distance of each run.
    c : mapping of str to float
        ``mass`` in kg; drag coefficients ``quadratic`` and ``linear`` in kg/m and kg/s.

    Notes
    -----
    With the terminal speed v1, the equation of motion is ``mass v' = quadratic (v1 - v) (v + v2)``, where v2
    is ``v1 + linear / quadratic``.
    Define ``y = -log(1 - v / v1)``, ``rho = v2 / v1`` and ``scale = mass / (quadratic (1 + rho))``. Then the
    distance is ``scale (y - rho log(1 + (1 - exp(-y)) / rho))``, and the time is ``scale (y + log(1 + (1 -
    exp(-y)) / rho)) / v1``. Without linear drag the result is Eq 25.
    """
    v1, quadratic = np.asarray(terminal_m_s, dtype=float), c["quadratic"]
    moving = v1 > 0
    rho = 1.0 + c["linear"] / (quadratic * np.where(moving, v1, 1.0))
    scale = c["mass"] / (quadratic * (1.0 + rho))

    def newton(y: Array) -> Array:
        gone = -np.expm1(-y)
        excess = y - rho * np.log1p(gone / rho) - distance_m / scale
        return excess * (rho + gone) / (gone * (1.0 + rho))

    with np.errstate(invalid="ignore"):
        y = _root(newton, distance_m / scale + rho * np.log1p(1.0 / rho))
        time = scale * (y + np.log1p(-np.expm1(-y) / rho)) / np.where(moving, v1, 1.0)
        return np.where(moving, distance_m / time, 0.0)


def strouhal(frequency_hz: float, amplitude_rad: float, lever_m: float, terminal_speed_m_s: float) -> float:
    """Return the Strouhal number of a flapping fin from its wake width (Chan et al., boxfish, Eq 28).

    The number is ``f A_w / v`` with the wake width ``A_w = 2 lever sin(amplitude)``. In the nomenclature of
    the paper the lever is the length of the fin. The values that the paper prints agree better with the
    distance from the axle to the trailing edge, which is the length of the fin plus the gap to the axle.
    """
    return float(frequency_hz * 2 * lever_m * np.sin(amplitude_rad) / terminal_speed_m_s)


class RecoilScales(Scales):
    """Typical sizes of speed, force and inertia in cruise runs, which scale the parameters of effects."""

    model: RecoilModel

    @property
    def inertia(self) -> float:
        """Moving mass in cruise runs: sum of the mass of the robot and its added mass, kg."""
        return self.model.drag_area_kg_m / self.model.b1

    @property
    def force(self) -> float:
        """Typical force in cruise runs: the drag at the typical speed, N."""
        return self.model.drag_area_kg_m * self.speed**2


class SurgeScales(Scales):
    """Typical sizes of speed and force in straight swimming. Forces are divided by the mass of the robot."""

    @property
    def force(self) -> float:
        """Typical force per mass in straight swimming: the drag per mass at the typical speed, m/s2."""
        return max(self.model.start("surge_drag"), 0.1) * self.speed**2


class RecoilModel(Model):
    """Model of the average speed of cruise runs by the energy recoil law (Chan et al., Eqs 5, 25-27).

    The recoil law is ``v = R_v (8 eta pi^2 I f^p (theta - theta_off)^q / (rho C_d A / 2))^(1/3)`` for the
    average speed v. R_v is the velocity ratio, eta the efficiency, I the inertia of the fin, f the beat
    frequency, theta the amplitude, theta_off its offset, and ``rho C_d A / 2`` the drag factor. The exponents
    p = 3 and q = 2 can be freed to test the law.

    A trial has all runs of one fin. Its inputs are ``frequency_hz``, ``amplitude_rad`` and ``distance_m`` of
    each run. :attr:`Trial.cruise` has the known quantities of the fin. For a fin of unknown inertia the model
    has the parameter ``inertia_<fin>``.
    """

    name = "propulsion"
    channels = (Channel(SPEED, "m/s", "average speed"),)
    offers = frozenset({"stroke", "coefficients", "flow", "output"})
    timed_runs = True

    def __init__(
        self, *, drag_area_kg_m: float, moving_mass_kg: float, fins: Mapping[str, float | None]
    ) -> None:
        """Create the model from drag factor, moving mass (kg) and inertias of the fins (kg m2).

        The drag factor ``rho C_d A / 2`` is in kg/m. The moving mass is the mass of the robot plus its added
        mass. An inertia is None if it is unknown.
        """
        self.drag_area_kg_m = drag_area_kg_m
        self.moving_mass_kg = moving_mass_kg
        self.fins = fins
        self.b1 = drag_area_kg_m / moving_mass_kg
        known = [i for i in fins.values() if i is not None]
        typical = float(np.median(known or [1e-4]))
        unknown = [fin for fin, inertia in fins.items() if inertia is None]
        efficiency, offset = "efficiency of the recoil process", "flapping amplitude offset"
        own = "hydrodynamic inertia of {} at the common efficiency"
        self.parameters = (
            Parameter("recoil_efficiency", "1", 0.0, 1.0, 0.3, 0.1, bool(known), False, efficiency, "Eq 3"),
            Parameter("amplitude_offset_deg", "deg", -10.0, 30.0, 2.0, 2.0, True, False, offset, "Eq 27"),
            Parameter("frequency_exponent", "1", 0.0, 6.0, 3.0, 1.0, free=False, meaning="of power, law: 3"),
            Parameter("amplitude_exponent", "1", 0.0, 6.0, 2.0, 1.0, free=False, meaning="of power, law: 2"),
            *(
                Parameter(f"inertia_{f}", "kg m^2", 0.0, math.inf, typical, typical, meaning=own.format(f))
                for f in unknown
            ),
        )

    def resistance(self) -> dict[str, float]:
        """Return the coefficients of drag and friction, and the moving mass, without effects."""
        return {"quadratic": self.drag_area_kg_m, "linear": 0.0, "dry": 0.0, "mass": self.moving_mass_kg}

    def scales(self, trials: Sequence[Trial]) -> RecoilScales:
        """Return the typical sizes of speed, force and inertia in cruise trials."""
        return RecoilScales(self, trials)

    def simulate_hooked(self, values: Array, trial: Trial, hooks: Hooks) -> dict[str, Array]:
        """Return the average speed of each cruise run, simulated with effects (see
        :meth:`Model.simulate_hooked`).

        ``coefficients`` hooks change ``quadratic`` (kg/m), ``linear`` (kg/s), ``dry`` (N) and ``mass`` (kg).
        The factor on the thrust of a steady beat multiplies the power. A water flow along x displaces the
        robot during the run.
        """
        inputs, known, distance = trial.inputs, trial.cruise, trial.inputs["distance_m"]
        inertia = known.inertia_kg_m2
        if inertia is None:
            inertia = float(values[self.index(f"inertia_{known.fin}")])
        steady = Stroke(inputs["frequency_hz"], inputs["amplitude_rad"], np.ones(len(trial.time_s)), inertia)
        stroke = hooks.change_stroke(steady)
        efficiency, offset, p, q = values[:4]
        # Divide frequency and amplitude by reference values, so that the estimates of exponents and
        # efficiency are nearly independent.
        f_mid, a_mid = known.middle
        f, a = stroke.frequency_hz / f_mid, np.maximum(stroke.amplitude_rad - np.deg2rad(offset), 0.0) / a_mid
        # Compute the propulsive power of each run, W (Chan et al., Eqs 5, 27).
        factor = 8 * efficiency * np.pi**2 * stroke.inertia_kg_m2
        power = stroke.thrust * (factor * f_mid**3 * f**p * a_mid**2 * a**q)
        c = hooks.change_values(self.resistance(), "coefficients")
        if c["quadratic"] <= 0 or c["mass"] <= 0:
            return self.make_broken(trial)
        if c["linear"] == c["dry"] == 0:
            speed = velocity_ratio(c["quadratic"] / c["mass"], distance) * np.cbrt(power / c["quadratic"])
        else:
            speed = compute_mean_speed(compute_cruise_speed(power, c), distance, c)
        if hooks.flow:
            time = distance / np.maximum(speed, 1e-9)
            carried = sum(flow(time)[0][:, 0] - flow(np.zeros(1))[0][0, 0] for flow in hooks.flow)
            speed = speed + carried / time
        return hooks.sense({SPEED: speed}, trial.time_s)


class SurgeModel(Model):
    """Model of the beat-averaged surge in straight swimming, with a power law of thrust and quadratic drag.

    The equation of motion is ``du/dt = a (A / A_ref)^n (f / f_ref)^m - c u |u|`` for the surge u, with the
    beat amplitude A and frequency f, and an initial speed for each trial. The exponent n is 2 unless it is
    freed. The exponent m is estimated if the trials have several frequencies. :attr:`Trial.surge` has the
    known quantities of a trial.
    """

    name = "surge-propulsion"
    channels = (Channel("u_m_s", "m/s", "beat-averaged surge"),)
    offers = frozenset({"stroke", "coefficients", "flow", "output"})
    force_unit = "m/s^2"

    def __init__(
        self, *, amplitudes_rad: Sequence[float], frequencies_hz: Sequence[float], speed_m_s: float
    ) -> None:
        """Create the model from the beat amplitudes and frequencies of all trials and a typical speed."""
        self.reference_amplitude_rad = float(np.exp(np.mean(np.log(amplitudes_rad))))
        self.reference_frequency_hz = float(np.exp(np.mean(np.log(frequencies_hz))))
        many = len(np.unique(np.round(frequencies_hz, 6))) > 1
        inf, size = math.inf, speed_m_s**2
        thrust = "thrust over mass at the reference amplitude and frequency"
        start = "speed at the first sample"
        self.parameters = (
            Parameter("thrust_acceleration", "m/s^2", 0.0, inf, size, size, meaning=thrust),
            Parameter("surge_drag", "1/m", 0.0, inf, 1.0, 1.0, meaning="quadratic drag over mass"),
            Parameter("amplitude_exponent", "1", 0.0, 6.0, 2.0, 1.0, free=False, meaning="of thrust"),
            Parameter("frequency_exponent", "1", 0.0, 6.0, 2.0, 1.0, free=many, meaning="of thrust"),
            Parameter("initial_speed", "m/s", -inf, inf, 0.0, 0.2 * speed_m_s, True, True, start),
        )

    def scales(self, trials: Sequence[Trial]) -> SurgeScales:
        """Return the typical sizes of speed and force per mass in straight swimming trials."""
        return SurgeScales(self, trials)

    def simulate_hooked(self, values: Array, trial: Trial, hooks: Hooks) -> dict[str, Array]:
        """Return the surge at the samples of a trial, simulated with effects (see
        :meth:`Model.simulate_hooked`).

        ``coefficients`` hooks change ``quadratic`` (1/m), ``linear`` (1/s), ``dry`` (m/s^2) and ``mass`` (1).
        All values are per unit of mass. Drag depends on the speed relative to a water flow along x.
        """
        (thrust, drag, n, m, u0), surge = values.tolist(), trial.surge
        steady = Stroke(np.array([surge.frequency_hz]), np.array([surge.amplitude_rad]), np.ones(1))
        stroke = hooks.change_stroke(steady)
        amplitude = float(stroke.amplitude_rad[0]) / self.reference_amplitude_rad
        a = thrust * amplitude**n * (float(stroke.frequency_hz[0]) / self.reference_frequency_hz) ** m
        c = hooks.change_values({"quadratic": drag, "linear": 0.0, "dry": 0.0, "mass": 1.0}, "coefficients")
        if c["mass"] <= 0:
            return self.make_broken(trial)
        force = float(stroke.thrust[0]) * a
        a, quadratic, linear, dry = (v / c["mass"] for v in (force, c["quadratic"], c["linear"], c["dry"]))
        t = trial.time_s - surge.start_s
        if linear == dry == 0 and not hooks.flow:
            speed = _solve_closed_form(t, a, quadratic, u0)
        else:
            half = _half_steps(t)
            water = np.zeros(len(half))
            for flow in hooks.flow:
                water = water + flow(surge.start_s + half)[1][:, 0]
            run = _integrate_speed(half, water, a, quadratic, linear, dry, u0)
            speed = np.interp(t, half[::2], run)
        return hooks.sense({"u_m_s": speed}, trial.time_s)


def _solve_closed_form(t: Array, a: float, drag: float, u0: float) -> Array:
    """Return the surge over time with constant thrust and quadratic drag, m/s.

    ``a`` is the thrust per mass (m/s2), ``drag`` the drag per mass (1/m), and ``u0`` the surge at time zero.
    """
    if a <= 0 or drag <= 0:
        return u0 + max(a, 0.0) * t
    terminal, rate = math.sqrt(a / drag), math.sqrt(a * drag)
    growth = np.tanh(rate * t)
    return np.asarray(terminal * (u0 + terminal * growth) / (terminal + u0 * growth))


def _half_steps(t: Array) -> Array:
    """Return the times at which half integration steps of the surge begin and end, s.

    The steps extend from time zero to the last sample time. A step ends at every sample time after zero.
    """
    knots = np.unique(np.append(t[t > 0], 0.0))
    parts = [np.zeros(1)]
    for begin, end in itertools.pairwise(knots):
        steps = math.ceil((end - begin) / CRUISE_STEP_S)
        parts.append(np.linspace(begin, end, 2 * steps + 1)[1:])
    return np.concatenate(parts)


@numba.njit(cache=True, nogil=True)
def _integrate_speed(half, water, thrust, quadratic, linear, dry, u0):  # type: ignore[no-untyped-def]
    """Integrate the equation of motion of the surge by the fourth-order Runge-Kutta method.

    ``half`` has the times of half steps, and ``water`` the speed of the water at these times. The result is
    the surge at every second time, where the steps end. All coefficients are per unit of mass.
    """
    count = (len(half) + 1) // 2
    surge = np.empty(count)
    surge[0] = u0
    for i in range(count - 1):
        u, at, rate, rise = surge[i], 2 * i, 0.0, 0.0
        step = half[at + 2] - half[at]
        for stage in range(4):
            part = 0.5 * ((stage + 1) // 2)
            v = u + part * step * rate - water[at + (stage + 1) // 2]
            rate = thrust - quadratic * v * abs(v) - linear * v - dry * np.sign(v)
            rise += rate / 6.0 if stage % 3 == 0 else rate / 3.0
        surge[i + 1] = u + step * rise
    return surge
