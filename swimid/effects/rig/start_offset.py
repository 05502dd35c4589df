"""A run that did not start where the log says."""

from __future__ import annotations

from collections.abc import Sequence

from swimid.effects.common import RigCoefficient, parameter
from swimid.fitting.model import Model, Parameter, Trial


class StartOffset(RigCoefficient):
    """The same displacement at release in every trial."""

    name = "start-offset"
    meaning = "displacement at release"
    coefficient = "x0"
    own = ("start_offset",)
    scatters = True

    def parameters(self, model: Model, trials: Sequence[Trial]) -> tuple[Parameter, ...]:
        """The displacement, m or rad."""
        assert model.rig is not None
        unit = model.rig.displacement.unit
        return (parameter(f"offset_{unit}", unit, 0.01 * model.scales(trials).span, self.meaning),)
