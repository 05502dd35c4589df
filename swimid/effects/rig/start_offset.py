"""A run that did not start where the log says."""

from __future__ import annotations

import math
from collections.abc import Sequence

from swimid.effects import common
from swimid.effects.base import Effect
from swimid.fitting.hooks import Hooks
from swimid.fitting.model import Array, Model, Parameter, Trial
from swimid.rig.model import COORDINATES, RigModel


class StartOffset(Effect):
    """The same displacement at release in every trial."""

    name = "start-offset"
    stage = "rig"
    meaning = "displacement at release"
    needs = frozenset({"coefficients"})
    smooth = True
    scatters = True

    def variants(self, model: Model, trials: Sequence[Trial]) -> Sequence[Effect]:
        """Rigs whose model does not estimate it."""
        return [self] if isinstance(model, RigModel) and not common.estimated(model, "start_offset") else []

    def parameters(self, model: Model, trials: Sequence[Trial]) -> tuple[Parameter, ...]:
        """The displacement, m or rad."""
        assert isinstance(model, RigModel)
        unit = COORDINATES[model.coordinate][0]
        size = 0.01 * common.span(model, trials)
        return (
            Parameter(
                f"offset_{unit}",
                unit,
                -math.inf,
                math.inf,
                0.0,
                size,
                meaning="displacement at release",
            ),
        )

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Moves the start."""

        def change(c: dict[str, float]) -> None:
            c["x0"] += values[0]

        return Hooks(coefficients=(change,))
