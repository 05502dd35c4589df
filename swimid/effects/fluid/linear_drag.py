"""Drag in proportion to the speed."""

from swimid.effects import common
from swimid.effects.base import Array, Effect, Effects, Hooks, Model, Parameters, Trial, Trials

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
        return (common.parameter(name, unit, scales.brake / scales.speed, "drag per speed", lower=least),)

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Adds to the linear drag."""
        body = model.body
        if body is not None:
            at = body.centre(body.hull)
            return Hooks(tables=(lambda tables: body.drag_more(tables, body.hull, at, values[0]),))
        return common.more("linear", values[0])
