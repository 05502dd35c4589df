"""A body that already moved when it was released."""

from swimid.effects.base import Model, Parameters, Trials
from swimid.effects.common import RigCoefficient, parameter, rotates


class InitialSpeed(RigCoefficient):
    """The same speed at release in every trial."""

    name = "initial-speed"
    meaning = "speed at release"
    coefficient = "v0"
    own = ("initial_speed",)
    scatters = True

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """The speed, m/s or rad/s."""
        assert model.rig is not None
        name = "speed_rad_s" if rotates(model) else "speed_m_s"
        return (parameter(name, model.rig.speed.unit, 0.1 * model.scales(trials).speed, self.meaning),)
