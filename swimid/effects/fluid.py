"""Effects of the water on the body and its fins."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from swimid.effects import base
from swimid.effects.base import Effect, Effects, Parameters, Trials, parameter
from swimid.errors import UsageError
from swimid.fitting.model import Array, Hooks, Model, Trial, traceable, typical
from swimid.logs.log import FREQUENCY_RTOL

#: Minimum inertia that must remain if the added mass is negative, as a fraction of the rigid body's inertia.
MIN_INERTIA_SHARE = 0.5


class AddedMassFactor(Effect):
    """Added mass in addition to that of the model, for the body on a rig or for the links of a swimmer.

    On a swimmer, the added mass differs along and across the links. It acts at the centres of mass of the
    links, in proportion to their masses. A further added mass may act across the last link.
    """

    name = "added-mass"
    meaning = "added mass beyond the model's"
    sources = ("boxfish paper, Eq 8", "tendon fish paper, Eq 6", "dolphin paper, Eq 7")
    smooth = True

    def applies(self, model: Model, trials: Trials) -> bool:
        """Return whether the effect applies: the model must be a rig or a free swimmer."""
        return model.rig is not None or base.free_body(model) is not None

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """Return the added mass as parameters, kg.

        A swimmer has one value along the links, one across the links, and one across the last link. A rig has
        one value, which for a rotation is an added moment of inertia, kg m2.
        """
        body = model.body
        if body is not None:
            masses = body.masses_kg
            own, across = sum(masses), body.words[4]
            size, tail = 0.05 * own, f"{across} of the last link's added mass"
            return (
                parameter("surge_kg", "kg", size, "surge added mass", lower=-MIN_INERTIA_SHARE * own),
                parameter("sway_kg", "kg", size, f"{across} added mass", lower=-MIN_INERTIA_SHARE * own),
                parameter("tail_kg", "kg", size, tail, lower=-0.5 * MIN_INERTIA_SHARE * masses[-1]),
            )
        linear, angular = ("added_kg", "kg", "added mass"), ("added_kg_m2", "kg m^2", "added inertia")
        name, unit, words = base.pick_by_motion(model, linear, angular)
        size = model.scales(trials).inertia
        own = size - model.start("added_mass", "added_inertia")
        return (parameter(name, unit, 0.05 * size, words, lower=-MIN_INERTIA_SHARE * own),)

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Return hooks that add the added mass to the inertia of the model."""
        body = model.body
        if body is not None:
            masses = body.masses_kg
            points = [body.centre(link) for link in range(len(masses))]

            def carry(tables: dict[str, Any]) -> None:
                for link, (mass, at) in enumerate(zip(masses, points, strict=True)):
                    share = mass / sum(masses)
                    body.weigh(tables, link, at, share * values[0], share * values[1])
                body.weigh(tables, len(masses) - 1, points[-1], 0.0, values[2])

            return Hooks(tables=(carry,))
        return base.add_to_coefficient(values[0], "inertia")


#: Speed, m/s or rad/s, below which the drag is zero. It avoids a division by zero.
MIN_SPEED = 1e-30


@traceable(on="hull", constants=3)
def add_drag_change(t, pose, velocity, constants, wrench):  # type: ignore[no-untyped-def]
    """Add to the wrench the change of the drag ``-k u |u|`` by ``C = C_0 (|u| / u_ref)^-n``.

    The constants are k, n and u_ref.
    """
    u = velocity[0]
    speed = max(abs(u), MIN_SPEED)
    wrench[0] -= constants[0] * u * abs(u) * ((speed / constants[2]) ** -constants[1] - 1.0)


class DragReynolds(Effect):
    """Dependence of the drag coefficient on speed (Reynolds number), ``C = C_0 (|u| / u_ref)^-n``.

    n is 0.5 for a laminar boundary layer and 0.2 for a turbulent one. In the first form, the effect changes
    the axial drag. The axial drag of all links of a swimmer then acts at the heaviest link. In the second
    form, the effect changes all drag coefficients of a swimmer's links, by the mean speed of each trial.

    Parameters
    ----------
    reference_m_s : float
        Speed u_ref at which the model's coefficient holds (rad/s for an angle).
    whole : bool
        Whether all drag coefficients change, with one factor for each trial.
    """

    name = "drag-reynolds"
    meaning = "drag coefficient that falls with speed"
    sources = ("Schlichting and Gersten 2017, Boundary-Layer Theory, chapters 6 and 18",)
    smooth = True

    def __init__(self, reference_m_s: float = 0.3, *, whole: bool = False) -> None:
        self.reference_m_s = reference_m_s
        self.whole = whole

    def variants(self, model: Model, trials: Trials) -> Effects:
        """Return the forms of the effect for rigs, or those for free swimmers with quadratic drag."""
        body, typical = model.body, model.scales(trials).speed
        forms = [DragReynolds(typical)]
        if body is None:
            return forms * ("force" in model.offers and model.swimmer is None)
        if not body.free or body.axial_drag(body.tables()) <= 0:
            return []
        speeds = [model.scales([trial]).speed for trial in trials]
        # Trials of a single speed do not show how the drag changes with speed.
        if speeds and max(speeds) > (1.0 + FREQUENCY_RTOL) * min(speeds):
            forms.append(DragReynolds(typical, whole=True))
        return forms

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """Return the exponent n of the drag coefficient ``C = C_0 (|u| / u_ref)^-n`` as a parameter."""
        name, words = f"{self.whole * 'trial_'}exponent", "the drag coefficient falls as speed^-n"
        return (parameter(name, "1", 0.2, words, -1.5, 1.5),)

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Return hooks that change the model's axial quadratic drag, or all its drag coefficients."""
        body = model.body
        if self.whole and not trial.measured:
            raise UsageError(
                f"the effect '{self.name}' with a factor for each trial needs the measured speed of trials",
                hint="the commands compare and diagnose measure these speeds",
            )
        if self.whole:
            factor = (model.scales([trial]).speed / self.reference_m_s) ** -float(values[0])
            return Hooks(tables=(lambda tables: body.drag_times(tables, factor),))
        constants = np.array([0.0, values[0], self.reference_m_s])
        if body is not None:

            def read(tables: dict[str, Any]) -> None:
                constants[0] = body.axial_drag(tables)

            return Hooks(tables=(read,), force=(base.force_at_hull(body, add_drag_change, constants),))

        return base.force_on_rig(add_drag_change, constants, quadratic=0)


class LiftDamping(Effect):
    """Lift ``-k V w`` of each link, which damps the motion across the link.

    V is the speed of the link through the water, and w is its component across the link.
    The normal force is ``rho / 2 S C_N V^2`` with ``C_N = C_Na sin(a)`` for a small angle of attack a. This
    force dissipates energy like a damping. k is distributed over the points at which the model's drag across
    the links acts, in proportion to that drag. Both the lift and this drag are proportional to the side area.
    """

    name = "lift-damping"
    meaning = "lift of the links in proportion to speed and angle of attack"
    sources = (
        "Hoerner and Borst 1985, Fluid-Dynamic Lift (streamline bodies)",
        "Prestero 2001, MIT (simulation of the REMUS vehicle: body lift)",
    )
    smooth = True

    def applies(self, model: Model, trials: Trials) -> bool:
        """Return whether the effect applies: the model must be a free swimmer with drag across a link."""
        body = base.free_body(model)
        return body is not None and len(body.normal_drag(body.tables())[0]) > 0

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """Return as a parameter the lift coefficient k summed over all links, ``rho / 2 S C_Na``, N s2/m2.

        The scale is a tenth of the model's drag across all links. The lift slope of a body of low aspect
        ratio is about 1 per rad, as large as a drag coefficient across the body. A tenth of this lift is
        visible.
        """
        body = model.body
        size = 0.1 * float(body.normal_drag(body.tables())[1][:, 2].sum())
        words = "force across the links per speed and speed across"
        return (parameter("lift_N_s2_m2", "N s^2/m^2", size, words, 0.0, 100.0 * size),)

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Return hooks that add lift at the points of the model's drag across the links."""
        body = model.body
        links, points = body.normal_drag(body.tables())
        points[:, 2] *= float(values[0]) / points[:, 2].sum()
        return Hooks(tables=(lambda tables: body.lift(tables, links, points),))


#: Name and unit of the linear drag coefficient, for each unit that a model's force may have.
UNITS = {
    "N": ("linear_N_s_m", "N s/m"),
    "N m": ("linear_N_m_s_rad", "N m s/rad"),
    "m/s^2": ("linear_1_s", "1/s"),
}


class LinearDrag(Effect):
    """Linear drag ``-c v`` of the body, with the same coefficient along and across the body.

    On a swimmer the drag acts at the centre of mass of the heaviest link.
    """

    name = "linear-drag"
    meaning = "drag in proportion to the speed"
    sources = ("Fossen 2011, Handbook of Marine Craft Hydrodynamics, section 6.4",)
    needs = frozenset({"coefficients", "tables"})
    own = ("linear_drag", "linear_damping")
    smooth = True

    def applies(self, model: Model, trials: Trials) -> bool:
        """Return whether the effect applies: the base of the body must move."""
        return super().applies(model, trials) and not base.is_held(model)

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """Return the linear drag coefficient as a parameter.

        Its unit is N s/m, N m s/rad for a rotation, or 1/s for a model with forces per mass.
        """
        name, unit = UNITS[model.force_unit]
        scales, least = model.scales(trials), -model.start(*self.own)
        return (parameter(name, unit, scales.brake / scales.speed, "drag per speed", lower=least),)

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Return hooks that add to the linear drag of the model."""
        body = model.body
        if body is not None:
            at = body.centre(body.hull)
            return Hooks(tables=(lambda tables: body.drag_more(tables, body.hull, at, values[0]),))
        return base.add_to_coefficient(values[0], "linear")


class QuadraticDrag(base.RigCoefficient):
    """Quadratic drag ``-c v |v|`` of separated flow, for the body on a rig.

    It is the form drag of a towed body, or the vortex damping of a body that swings.
    """

    name = "quadratic-drag"
    meaning = "drag in proportion to the square of the speed"
    sources = (
        "boxfish paper, Eq 7",
        "Fossen 2011, Handbook of Marine Craft Hydrodynamics, section 6.4",
    )
    coefficient = "quadratic"
    own = ("quadratic_drag", "quadratic_damping", "drag_coefficient")

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """Return the quadratic drag coefficient as a parameter, N s2/m2, or N m s2/rad2 for a rotation."""
        linear, angular = ("quadratic_N_s2_m2", "N s^2/m^2"), ("quadratic_N_m_s2_rad2", "N m s^2/rad^2")
        name, unit = base.pick_by_motion(model, linear, angular)
        scales = model.scales(trials)
        size = scales.brake / scales.speed**2
        return (parameter(name, unit, size, "drag per squared speed", lower=-scales.quadratic),)


class ThrustLoss(Effect):
    """Thrust that falls with the speed of advance, ``T = T_0 - c sqrt(|T_0|) u``.

    T_0 is the thrust at rest, and u the velocity of the thruster through the water along its force. The law
    follows from a thrust coefficient that is linear in the advance ratio, ``K_T = k_0 - k_1 J``. The rate n
    of the propeller is eliminated by ``T_0 = rho D^4 k_0 n |n|``, which gives ``c = k_1 D sqrt(rho / k_0)``.
    It holds for both signs of T_0 and of u.
    """

    name = "thrust-loss"
    meaning = "thrust that falls with the speed of advance"
    sources = (
        "Fossen 2011, Handbook of Marine Craft Hydrodynamics, section 9.1",
        "Bachmayer, Whitcomb and Grosenbaugh 2000, IEEE J. Oceanic Eng. 25:146",
    )
    smooth = True

    def applies(self, model: Model, trials: Trials) -> bool:
        """Return whether the effect applies: the model must be a free swimmer with thrusters."""
        swimmer = model.swimmer
        if swimmer is None or not swimmer.free_base:
            return False
        return len(swimmer.thrusters(swimmer.tree.tables(swimmer.start_coefficients))[0]) > 0

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """Return as parameter the loss c of thrust per speed and per square root of the thrust, (kg/m)^0.5.

        Its scale reduces the typical thrust at the typical speed by a twentieth, as the scale of
        ``amplitude-loss`` does. Its upper bound reduces this thrust to zero.
        """
        swimmer = model.swimmer
        _, inputs, forces = swimmer.thrusters(swimmer.tree.tables(swimmer.start_coefficients))
        sizes = [np.abs(swimmer.compute_inputs(trial)[:, inputs]) * forces for trial in trials]
        typical_N = typical([float(np.median(size[size > 0.0])) for size in sizes if size.any()], 1.0)
        whole = math.sqrt(typical_N) / model.scales(trials).speed
        words = "loss of thrust per speed of advance and per square root of the thrust"
        return (parameter("loss_kg05_m05", "kg^0.5/m^0.5", 0.05 * whole, words, 0.0, whole),)

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Return hooks that let the thrust fall with the speed of advance."""
        loss = float(values[0])
        return Hooks(tables=(lambda tables: model.swimmer.lose_thrust(tables, loss),))


#: Maximum added mass per length at the trailing edge, divided by that of a square plate of the link's length.
MAX_PLATE_FACTOR = 10.0


class WakeLift(Effect):
    """Reactive force ``-m u w n + m w^2 t / 2`` of the wake at the rear end of the last link.

    u and w are the velocities of the trailing edge along and across its link. m is the added mass per length
    at the trailing edge. t and n are the unit vectors along and across the link
    (:mod:`swimid.swimmer.planar.model`).
    """

    name = "wake-lift"
    meaning = "reactive force of the fin: momentum shed into the wake"
    sources = ("Lighthill 1971, Proc. R. Soc. Lond. B 179:125",)
    smooth = True

    def applies(self, model: Model, trials: Trials) -> bool:
        """Return whether the effect applies: the model must be a swimmer of several links."""
        return model.body is not None and model.body.last > 0

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """Return as a parameter the added mass per length at the trailing edge, kg/m.

        Its scale is a tenth of that of a square plate of the link's length.
        """
        body = model.body
        plate = 0.25 * math.pi * body.density_kg_m3 * body.lengths_m[-1] ** 2
        words = "added mass per length at the trailing edge"
        most = MAX_PLATE_FACTOR * plate
        return (parameter("added_mass_kg_m", "kg/m", 0.1 * plate, words, 0.0, most),)

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Return hooks that add the reactive force at the trailing edge of the last link."""
        body = model.body
        return Hooks(tables=(lambda tables: body.shed(tables, float(values[0])),))
