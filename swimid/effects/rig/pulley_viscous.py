"""Viscous friction of the pulley."""

from swimid.effects.base import Model, Parameters, Trials
from swimid.effects.common import RigCoefficient, parameter


class PulleyViscous(RigCoefficient):
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
