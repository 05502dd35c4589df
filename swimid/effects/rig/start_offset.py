"""A run that did not start where the log says."""

from swimid.effects.base import Model, Parameters, Trials
from swimid.effects.common import RigCoefficient, parameter


class StartOffset(RigCoefficient):
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
