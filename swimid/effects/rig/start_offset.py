"""A run that did not start where the log says."""

from __future__ import annotations

import math
from collections.abc import Sequence

from swimid.effects.base import Effect
from swimid.fitting.hooks import Hooks
from swimid.fitting.model import Array, Model, Parameter, Trial


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
        return [self] if model.rig is not None and not model.estimates("start_offset") else []

    def parameters(self, model: Model, trials: Sequence[Trial]) -> tuple[Parameter, ...]:
        """The displacement, m or rad."""
        assert model.rig is not None
        unit = model.rig.displacement.unit
        size = 0.01 * model.scales(trials).span
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
