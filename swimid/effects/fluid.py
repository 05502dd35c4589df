"""Effects of the water on the body and its fins."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from swimid.effects import common
from swimid.effects.base import Array, Effect, Effects, Hooks, Model, Parameters, Trial, Trials
from swimid.effects.common import parameter
from swimid.fitting.hooks import Force, traceable
from swimid.logs.log import FREQUENCY_RTOL

#: The least of the inertia that may be left, as a share of the rigid body's.
LEAST = 0.5


class AddedMass(Effect):
    """Added mass beyond the model's: a rig's, or a swimmer's along and across its links.

    A swimmer's is shared out among the links as their masses are, at their centres of mass; across, more or
    less of it may follow the last link.
    """

    name = "added-mass"
    meaning = "added mass beyond the model's"
    sources = ("boxfish paper, Eq 8", "tendon fish paper, Eq 6", "dolphin paper, Eq 7")
    needs = frozenset({"coefficients", "tables"})
    smooth = True

    def variants(self, model: Model, trials: Trials) -> Effects:
        """Rigs and free swimmers."""
        return [self] if model.rig is not None or common.free_body(model) else []

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """Added mass along and across all links, kg; or that of the rig's coordinate."""
        body = model.body
        if body is not None:
            masses = body.masses_kg
            own, across = sum(masses), body.words[4]
            return tuple(
                parameter(name, "kg", 0.05 * own, f"{words} added mass", lower=-least)
                for name, least, words in (
                    ("surge_kg", LEAST * own, "surge"),
                    ("sway_kg", LEAST * own, across),
                    ("tail_kg", 0.5 * LEAST * masses[-1], f"{across} of the last link's"),
                )
            )
        name, unit, words = "added_kg", "kg", "added mass"
        if common.rotates(model):
            name, unit, words = "added_kg_m2", "kg m^2", "added inertia"
        size = model.scales(trials).inertia
        own = size - model.start("added_mass", "added_inertia")
        return (parameter(name, unit, 0.05 * size, words, lower=-LEAST * own),)

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Adds to the inertia."""
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
        return common.more("inertia", values[0])


#: Less than any speed that can be told from none, m/s or rad/s: what has none has no drag.
TINY = 1e-30


@traceable(on="hull", constants=3)
def changed_drag(t, pose, velocity, constants, wrench):  # type: ignore[no-untyped-def]
    """What ``C = C_0 (|u| / u_ref)^-n`` adds to ``-k u |u|``; constants k, n and u_ref."""
    u = velocity[0]
    speed = max(abs(u), TINY)
    wrench[0] -= constants[0] * u * abs(u) * ((speed / constants[2]) ** -constants[1] - 1.0)


class DragReynolds(Effect):
    """``C = C_0 (|u| / u_ref)^-n``: 0.5 is a laminar boundary layer, 0.2 a turbulent one.

    It acts on the axial drag, a swimmer's taken together at its heaviest link; or, by the mean speed of each
    trial, on all drag coefficients of a swimmer's links.

    Parameters
    ----------
    reference_m_s : float
        Speed u_ref at which the model's own coefficient holds (rad/s for an angle).
    whole : bool
        Whether all drag coefficients change, from trial to trial.
    """

    name = "drag-reynolds"
    meaning = "drag coefficient that falls with speed"
    sources = ("Schlichting and Gersten 2017, Boundary-Layer Theory, chapters 6 and 18",)
    needs = frozenset({"force"})
    smooth = True

    def __init__(self, reference_m_s: float = 0.3, *, whole: bool = False) -> None:
        self.reference_m_s = reference_m_s
        self.whole = whole

    def variants(self, model: Model, trials: Trials) -> Effects:
        """Rigs and free swimmers with quadratic drag, about the typical speed of the trials."""
        body = model.body
        if body is not None:
            fits = body.free and body.axial_drag(body.tables()) > 0
        else:
            fits = "force" in model.offers
        typical = model.scales(trials).speed
        forms: list[Effect] = [DragReynolds(typical)] if fits else []
        speeds = [model.scales([trial]).speed for trial in trials] if body is not None else []
        # trials of one speed, as near as those of one frequency, do not tell how drag changes with it
        if fits and speeds and max(speeds) > (1.0 + FREQUENCY_RTOL) * min(speeds):
            forms.append(DragReynolds(typical, whole=True))
        return forms

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """The exponent n."""
        name = "trial_exponent" if self.whole else "exponent"
        words = "the drag coefficient falls as speed^-n"
        return (parameter(name, "1", 0.2, words, lower=-1.5, upper=1.5),)

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Adds the difference to the model's own quadratic drag, or changes its coefficients."""
        body = model.body
        if self.whole:
            whole = common.links(model)
            factor = (model.scales([trial]).speed / self.reference_m_s) ** -float(values[0])
            return Hooks(tables=(lambda tables: whole.drag_times(tables, factor),))
        constants = np.array([0.0, values[0], self.reference_m_s])
        if body is not None:

            def read(tables: dict[str, Any]) -> None:
                constants[0] = body.axial_drag(tables)

            return Hooks(tables=(read,), force=(common.at_hull(body, changed_drag, constants),))

        def take(c: dict[str, float]) -> None:
            constants[0] = c["quadratic"]

        return Hooks(coefficients=(take,), force=(Force(changed_drag, constants),))


class LiftDamping(Effect):
    """``-k V w`` across each link, V its speed through the water and w that across.

    A normal force ``rho / 2 S C_N V^2`` with ``C_N = C_Na sin(a)``, linear in the angle of attack a where
    that is small; it takes energy as a damping does. k is shared among the points at which the model's drag
    acts across its links, in proportion to that drag, since both go with the area seen from the side.
    """

    name = "lift-damping"
    meaning = "lift of the links in proportion to speed and angle of attack"
    sources = (
        "Hoerner and Borst 1985, Fluid-Dynamic Lift (streamline bodies)",
        "Prestero 2001, MIT (simulation of the REMUS vehicle: body lift)",
    )
    needs = frozenset({"tables"})
    smooth = True

    def variants(self, model: Model, trials: Trials) -> Effects:
        """Free swimmers whose model has drag across a link."""
        body = common.free_body(model)
        return [self] if body is not None and len(body.normal_drag(body.tables())[0]) else []

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """k of all links, ``rho / 2 S C_Na``, N s2/m2.

        A tenth of what the model's drag across all links has for a gain: a body of low aspect ratio has a
        slope of about 1 per rad, as large as a drag coefficient across it, of which one sees a tenth.
        """
        body = common.links(model)
        size = 0.1 * float(body.normal_drag(body.tables())[1][:, 2].sum())
        words = "force across the links per speed and speed across"
        return (parameter("lift_N_s2_m2", "N s^2/m^2", size, words, lower=0.0, upper=100.0 * size),)

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Adds lifting points."""
        body = common.links(model)
        links, points = body.normal_drag(body.tables())
        points[:, 2] *= float(values[0]) / points[:, 2].sum()
        return Hooks(tables=(lambda tables: body.lift(tables, links, points),))


OWN = ("linear_drag", "linear_damping")
#: Name and unit of a force per speed, by the unit of the force.
UNITS = {
    "N": ("linear_N_s_m", "N s/m"),
    "N m": ("linear_N_m_s_rad", "N m s/rad"),
    "m/s^2": ("linear_1_s", "1/s"),
}


class LinearDrag(Effect):
    """``-c v`` on the body, along and across; a swimmer's acts at the centre of mass of its heaviest link."""

    name = "linear-drag"
    meaning = "drag in proportion to the speed"
    sources = ("Fossen 2011, Handbook of Marine Craft Hydrodynamics, section 6.4",)
    needs = frozenset({"coefficients", "tables"})
    smooth = True

    def variants(self, model: Model, trials: Trials) -> Effects:
        """Models that do not estimate it and whose body moves."""
        if model.estimates(*OWN):
            return []
        if model.body is not None and not model.body.free:
            return []
        return super().variants(model, trials)

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """Force per speed, N s/m; moment per rate for an angle, 1/s where the model is per mass."""
        name, unit = UNITS[model.force_unit]
        scales, least = model.scales(trials), -model.start(*OWN)
        return (parameter(name, unit, scales.brake / scales.speed, "drag per speed", lower=least),)

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Adds to the linear drag."""
        body = model.body
        if body is not None:
            at = body.centre(body.hull)
            return Hooks(tables=(lambda tables: body.drag_more(tables, body.hull, at, values[0]),))
        return common.more("linear", values[0])


class QuadraticDrag(common.RigCoefficient):
    """``-c v |v|`` of separated flow: form drag of a body pulled along, vortex damping of one that swings."""

    name = "quadratic-drag"
    meaning = "drag in proportion to the square of the speed"
    sources = (
        "boxfish paper, Eq 7",
        "Fossen 2011, Handbook of Marine Craft Hydrodynamics, section 6.4",
    )
    coefficient = "quadratic"
    own = ("quadratic_drag", "quadratic_damping", "drag_coefficient")

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """Force per squared speed, N s2/m2; moment per squared rate for an angle."""
        name, unit = "quadratic_N_s2_m2", "N s^2/m^2"
        if common.rotates(model):
            name, unit = "quadratic_N_m_s2_rad2", "N m s^2/rad^2"
        scales = model.scales(trials)
        size = scales.brake / scales.speed**2
        return (parameter(name, unit, size, "drag per squared speed", lower=-scales.quadratic),)


#: Most added mass per length, in those of the plate that gives the scale.
MOST = 10.0


class WakeLift(Effect):
    """``-m u w n + m w^2 t / 2`` at the rear end of the last link.

    u and w are the edge's velocities along and across its link, m the added mass per length there
    (:mod:`swimid.swimmer.planar.assembly.trailing_edge`).
    """

    name = "wake-lift"
    meaning = "reactive force of the fin: momentum shed into the wake"
    sources = ("Lighthill 1971, Proc. R. Soc. Lond. B 179:125",)
    needs = frozenset({"tables"})
    smooth = True

    def variants(self, model: Model, trials: Trials) -> Effects:
        """Swimmers of several links."""
        return [self] if model.body is not None and model.body.last > 0 else []

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """Added mass per length at the edge, kg/m, against a plate as high as the last link is long."""
        body = common.links(model)
        plate = 0.25 * math.pi * body.density_kg_m3 * body.lengths_m[-1] ** 2
        words = "added mass per length at the trailing edge"
        most = MOST * plate
        return (parameter("added_mass_kg_m", "kg/m", 0.1 * plate, words, lower=0.0, upper=most),)

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Adds a trailing edge."""
        body = common.links(model)
        return Hooks(tables=(lambda tables: body.shed(tables, float(values[0])),))
