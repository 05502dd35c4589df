"""Drag in proportion to the square of the speed, on a rig whose model does not estimate it."""

from swimid.effects.base import Model, Parameters, Trials
from swimid.effects.common import RigCoefficient, parameter, rotates


class QuadraticDrag(RigCoefficient):
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
        if rotates(model):
            name, unit = "quadratic_N_m_s2_rad2", "N m s^2/rad^2"
        scales = model.scales(trials)
        size = scales.brake / scales.speed**2
        return (parameter(name, unit, size, "drag per squared speed", lower=-scales.quadratic),)
