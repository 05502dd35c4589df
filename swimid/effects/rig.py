"""Effects of the test rig: pulley, string and how the run was started."""

from __future__ import annotations

import math

import numba
import numpy as np

from swimid.effects import common
from swimid.effects.base import SIZES, Array, Effect, Effects, Hooks, Model, Parameters, Trial, Trials
from swimid.effects.common import parameter


class InitialSpeed(common.RigCoefficient):
    """The same speed at release in every trial."""

    name = "initial-speed"
    meaning = "speed at release"
    coefficient = "v0"
    own = ("initial_speed",)
    scatters = True

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """The speed, m/s or rad/s."""
        assert model.rig is not None
        name = "speed_rad_s" if common.rotates(model) else "speed_m_s"
        return (parameter(name, model.rig.speed.unit, 0.1 * model.scales(trials).speed, self.meaning),)


class PulleyFriction(common.RigCoefficient):
    """``F - f_c sgn(v)`` of a rig, on top of the model's own (boxfish, Eq 7).

    On a falling-weight rig it is the pulley's, and acts in the trials that have one; where none has, it is
    that of the slide the body moves on.
    """

    name = "pulley-friction"
    meaning = "dry friction of the pulley, bearing or slide"
    sources = ("boxfish paper, Eq 7 and section 4.1",)
    coefficient = "dry"
    own = ("pulley_friction", "dry_friction")

    def __init__(self, *, everywhere: bool = False) -> None:
        self.pulley = not everywhere

    def variants(self, model: Model, trials: Trials) -> Effects:
        """Rigs whose model does not estimate it."""
        form = PulleyFriction(everywhere=not common.with_pulley(trials))
        return common.RigCoefficient.variants(form, model, trials)

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """Friction beyond the model's, N (N m for an angle)."""
        name, unit = ("friction_N_m", "N m") if common.rotates(model) else ("friction_N", "N")
        words = "dry friction beyond the model's"
        size = model.scales(trials).brake
        return (parameter(name, unit, size, words, lower=-model.start(*self.own)),)


class PulleyInertia(common.RigCoefficient):
    """The pulley's moment of inertia over its radius squared, added to M of the boxfish paper's Eq 8.

    In one body of water it cannot be told from added mass; trials with and without a pulley tell.
    """

    name = "pulley-inertia"
    meaning = "inertia of the pulley that was not counted"
    sources = ("boxfish paper, Eq 8",)
    coefficient = "inertia"
    pulley = True

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """Equivalent mass, kg."""
        size = 0.05 * model.scales(trials).inertia
        words = "inertia of the pulley over its radius squared"
        return (parameter("inertia_kg", "kg", size, words, lower=0.0),)


class PulleyViscous(common.RigCoefficient):
    """Friction that grows with the pulley's speed, ``-b v``: a lubricated bearing."""

    name = "pulley-viscous"
    meaning = "friction of the pulley that grows with its speed"
    sources = ("boxfish paper, section 3.3",)
    coefficient = "linear"
    own = ("linear_drag", "linear_damping")
    pulley = True

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """Force per speed, N s/m."""
        scales, least = model.scales(trials), -model.start(*self.own)
        size = 0.1 * scales.force / scales.speed
        return (parameter("viscous_N_s_m", "N s/m", size, "friction of the pulley per speed", lower=least),)


class StartOffset(common.RigCoefficient):
    """The same displacement at release in every trial."""

    name = "start-offset"
    meaning = "displacement at release"
    coefficient = "x0"
    own = ("start_offset",)
    scatters = True

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """The displacement, m or rad."""
        assert model.rig is not None
        unit = model.rig.displacement.unit
        return (parameter(f"offset_{unit}", unit, 0.01 * model.scales(trials).span, self.meaning),)


#: Gravity that turns a pulling force into the mass of the weight, m/s2.
GRAVITY = 9.81


@numba.njit(cache=True, nogil=True)
def oscillation(time, pull, omega, damping, start):  # type: ignore[no-untyped-def]
    """Answer of ``s'' + 2 zeta omega s' + omega^2 s = pull(t)`` from ``start``, at rest there.

    Parameters
    ----------
    time : ndarray, shape (n,), s
        Increasing.
    pull : ndarray, shape (n,)
        Linear between the times.
    omega, damping : float
        Natural frequency, rad/s, and damping ratio, below 1.
    start : float

    Returns
    -------
    ndarray, shape (n,)
        Exact for a pull that is linear between the samples.
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
    """The weight swings on the string while the body is pulled.

    With the body's acceleration ``a``, the stretch against that under the weight at rest obeys
    ``s'' + 2 zeta omega s' + omega^2 s = -a``, ``omega^2 = 1 / (compliance m_w)``; in the long run
    ``s = -compliance m_w a``. A string that did not carry the whole weight before the release starts
    at ``s_0 = -unloaded compliance m_w g``. The pulley shows ``x + s - s_0``. What the swinging does to
    the body is smaller by the weight over the body, and left out.
    """

    name = "string-stretch"
    meaning = "stretch of the string between the body and the counted pulley"
    sources = ("boxfish paper, section 3.3",)
    needs = frozenset({"coefficients"})

    def variants(self, model: Model, trials: Trials) -> Effects:
        """Falling weights on a pulley."""
        return [self] if common.pulled(model) and common.with_pulley(trials) else []

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """Compliance, m/N, share of the weight taken up after the release, damping ratio."""
        scales = model.scales(trials)
        scale = 0.01 * scales.span / scales.force
        words = "share of the weight that the string did not carry at release"
        string, ratio = "compliance of the string", "damping ratio of the weight on it"
        return (
            parameter("compliance_m_N", "m/N", scale, string, lower=0.0, upper=100 * scale),
            parameter("unloaded", "1", 0.5, words, lower=0.0, upper=1.0, start=1.0),
            parameter("damping", "1", 0.2, ratio, lower=0.02, upper=0.95, start=0.2),
        )

    def tries(self, parameters: Parameters) -> list[Array]:
        """Sizes of the compliance, of a string that was slack and one that was taut."""
        compliance, _, damping = parameters
        return [
            np.array([size * compliance.scale, unloaded, damping.start])
            for unloaded in (1.0, 0.0)
            for size in SIZES
        ]

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Adds the stretch to the displacement the pulley shows."""
        compliance, unloaded, damping = (float(v) for v in values)
        weight = trial.rig.pull / GRAVITY
        if compliance <= 0 or weight <= 0 or not trial.rig.pulley:
            return Hooks()
        assert model.rig is not None
        omega = 1.0 / math.sqrt(compliance * weight)
        start = -unloaded * compliance * weight * GRAVITY
        release = trial.rig.begin_s
        coordinate, rate = model.rig.displacement.name, model.rig.speed.name

        def shown(channels: dict[str, Array], time_s: Array) -> dict[str, Array]:
            after = time_s > release
            time = np.concatenate(([release], time_s[after]))
            speed = np.concatenate(([0.0], channels[rate][after]))
            stretch = np.zeros(len(time_s))
            if len(time) > 2:
                pull = -np.gradient(speed, time)
                stretch[after] = oscillation(time, pull, omega, damping, start)[1:] - start
            return {**channels, coordinate: channels[coordinate] + stretch}

        return Hooks(output=(shown,))
