"""Effects of the test rig: pulley, string and release."""

from __future__ import annotations

import itertools
import math

import numpy as np

from swimid.effects import base
from swimid.effects.base import SIZES, Effect, Effects, Parameters, Trials, parameter
from swimid.files.kernels import numba
from swimid.fitting.model import Array, Hooks, Model, Trial


class InitialSpeed(base.RigCoefficient):
    """Initial speed of the body on a rig at its release, equal in all trials."""

    name = "initial-speed"
    meaning = "speed at release"
    coefficient = "v0"
    own = ("initial_speed",)
    scatters = True

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """Return the speed at release as a parameter, m/s or rad/s."""
        name, unit = base.pick_by_motion(model, ("speed_m_s", "m/s"), ("speed_rad_s", "rad/s"))
        return (parameter(name, unit, 0.1 * model.scales(trials).speed, self.meaning),)


class PulleyFriction(base.RigCoefficient):
    """Dry friction of a rig in addition to that of the model, ``f_c sgn(v)`` in boxfish, Eq 7.

    On a falling-weight rig it is the friction of the pulley, in the trials with a pulley. If no trial has a
    pulley, it is the friction of the slide on which the body moves.
    """

    name = "pulley-friction"
    meaning = "dry friction of the pulley, bearing or slide"
    sources = ("boxfish paper, Eq 7 and section 4.1",)
    coefficient = "dry"
    own = ("pulley_friction", "dry_friction")

    def __init__(self, *, everywhere: bool = False) -> None:
        self.pulley = not everywhere

    def variants(self, model: Model, trials: Trials) -> Effects:
        """Return the form for the friction of the pulley, or that for the slide if no trial has a pulley.

        The result is empty if the model estimates the friction.
        """
        form = PulleyFriction(everywhere=not base.has_pulley(trials))
        return base.RigCoefficient.variants(form, model, trials)

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """Return as a parameter the dry friction in addition to that of the model, N, or N m for an angle."""
        name, unit = base.pick_by_motion(model, ("friction_N", "N"), ("friction_N_m", "N m"))
        words = "dry friction beyond the model's"
        size = model.scales(trials).brake
        return (parameter(name, unit, size, words, lower=-model.start(*self.own)),)


class PulleyInertia(base.RigCoefficient):
    """Inertia of the pulley, divided by its squared radius: an addition to M in Eq 8 of the boxfish paper.

    Trials of one body in water do not distinguish it from added mass. Trials with and without a pulley do.
    """

    name = "pulley-inertia"
    meaning = "inertia of the pulley that the model leaves out"
    sources = ("boxfish paper, Eq 8",)
    coefficient = "inertia"
    pulley = True

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """Return the equivalent mass of the pulley as a parameter, kg."""
        size = 0.05 * model.scales(trials).inertia
        words = "inertia of the pulley over its radius squared"
        return (parameter("inertia_kg", "kg", size, words, lower=0.0),)


class PulleyViscous(base.RigCoefficient):
    """Friction ``-b v`` proportional to the speed of the pulley, as in a lubricated bearing."""

    name = "pulley-viscous"
    meaning = "friction of the pulley that grows with its speed"
    sources = ("boxfish paper, section 3.3",)
    coefficient = "linear"
    own = ("linear_drag", "linear_damping")
    pulley = True

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """Return the viscous friction of the pulley per speed as a parameter, N s/m."""
        scales, least = model.scales(trials), -model.start(*self.own)
        size = 0.1 * scales.force / scales.speed
        return (parameter("viscous_N_s_m", "N s/m", size, "friction of the pulley per speed", lower=least),)


class StartOffset(base.RigCoefficient):
    """Displacement of the body on a rig at its release, equal in all trials."""

    name = "start-offset"
    meaning = "displacement at release"
    coefficient = "x0"
    own = ("start_offset",)
    scatters = True

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """Return the displacement at release as a parameter, m or rad."""
        unit = base.pick_by_motion(model, "m", "rad")
        return (parameter(f"offset_{unit}", unit, 0.01 * model.scales(trials).span, self.meaning),)


#: Gravitational acceleration by which a trial's pulling force is converted to the mass of the weight, m/s2.
GRAVITY = 9.81


@numba.njit(cache=True, nogil=True)
def solve_oscillation(time, pull, omega, damping, start):  # type: ignore[no-untyped-def]
    """Solve the damped oscillation ``s'' + 2 zeta omega s' + omega^2 s = pull(t)`` from rest at ``start``.

    Parameters
    ----------
    time : ndarray, shape (n,), s
        Increasing times.
    pull : ndarray, shape (n,)
        Right-hand side, linear between the times.
    omega, damping : float
        Natural frequency, rad/s, and damping ratio zeta, below 1.
    start : float
        Initial value of s.

    Returns
    -------
    ndarray, shape (n,)
        Exact solution at the times.
    """
    stretch = np.empty(len(time))
    s, w = start, 0.0
    stretch[0] = start
    ring = omega * math.sqrt(1.0 - damping * damping)
    for i in range(1, len(time)):
        h = time[i] - time[i - 1]
        if h > 0.0:
            slope = (pull[i] - pull[i - 1]) / (h * omega * omega)
            rest = pull[i - 1] / (omega * omega) - 2.0 * damping * slope / omega
            a = s - rest
            b = (w - slope + damping * omega * a) / ring
            decay = math.exp(-damping * omega * h)
            c, d = math.cos(ring * h), math.sin(ring * h)
            s = decay * (a * c + b * d) + rest + slope * h
            w = decay * ((b * ring - damping * omega * a) * c - (a * ring + damping * omega * b) * d) + slope
        stretch[i] = s
    return stretch


class StringStretch(Effect):
    """Oscillation of the weight on the string while it pulls the body.

    ``a`` is the acceleration of the body and ``m_w`` the mass of the weight. The stretch ``s`` is counted
    from the stretch under the resting weight. It obeys ``s'' + 2 zeta omega s' + omega^2 s = -a`` with
    ``omega^2 = 1 / (compliance m_w)``. After a long time, ``s = -compliance m_w a``. A string that did not
    carry the whole weight before the release starts at ``s_0 = -unloaded compliance m_w g``. The pulley
    measures ``x + s - s_0``. The force of the oscillation on the body is smaller by the ratio of the weight
    to the body, and is neglected.
    """

    name = "string-stretch"
    meaning = "stretch of the string between the body and the pulley"
    sources = ("boxfish paper, section 3.3",)

    def applies(self, model: Model, trials: Trials) -> bool:
        """Return whether the effect applies: a weight must pull the body over a pulley in some trial."""
        return base.is_pulled(model) and base.has_pulley(trials)

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """Return the parameters of the string.

        They are its compliance, m/N, the fraction of the weight that it did not carry before the release, and
        the damping ratio of the weight on it.
        """
        scales = model.scales(trials)
        scale = 0.01 * scales.span / scales.force
        words = "share of the weight that the string did not carry at release"
        string, ratio = "compliance of the string", "damping ratio of the weight on it"
        return (
            parameter("compliance_m_N", "m/N", scale, string, 0.0, 100 * scale),
            parameter("unloaded", "1", 0.5, words, 0.0, 1.0, start=1.0),
            parameter("damping", "1", 0.2, ratio, 0.02, 0.95, start=0.2),
        )

    def tries(self, parameters: Parameters) -> list[Array]:
        """Return the parameter vectors that are simulated before a fit.

        They have several compliances, each for a string that is slack and for one that is taut at release.
        """
        compliance, _, damping = parameters
        sizes = itertools.product((1.0, 0.0), SIZES)
        return [np.array([size * compliance.scale, unloaded, damping.start]) for unloaded, size in sizes]

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Return hooks that add the stretch to the displacement that the pulley measures."""
        compliance, unloaded, damping = (float(v) for v in values)
        weight = trial.rig.pull / GRAVITY
        if compliance <= 0 or weight <= 0 or not trial.rig.pulley:
            return Hooks()
        assert model.rig is not None
        omega = 1.0 / math.sqrt(compliance * weight)
        start = -unloaded * compliance * weight * GRAVITY
        release = trial.rig.begin_s
        coordinate, rate = model.rig.displacement.name, model.rig.speed.name

        def add_stretch(channels: dict[str, Array], time_s: Array) -> dict[str, Array]:
            after = time_s > release
            time = np.concatenate(([release], time_s[after]))
            speed = np.concatenate(([0.0], channels[rate][after]))
            stretch = np.zeros(len(time_s))
            if len(time) > 2:
                pull = -np.gradient(speed, time)
                stretch[after] = solve_oscillation(time, pull, omega, damping, start)[1:] - start
            return {**channels, coordinate: channels[coordinate] + stretch}

        return Hooks(output=(add_stretch,))
