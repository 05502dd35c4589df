"""A body that already moved when it was released."""

from __future__ import annotations

import math
from collections.abc import Sequence

from swimid.effects import common
from swimid.effects.base import Effect
from swimid.fitting.hooks import Hooks
from swimid.fitting.model import Array, Model, Parameter, Trial


class InitialSpeed(Effect):
    """The same speed at release in every trial."""

    name = "initial-speed"
    stage = "rig"
    meaning = "speed at release"
    needs = frozenset({"coefficients"})
    smooth = True
    scatters = True

    def variants(self, model: Model, trials: Sequence[Trial]) -> Sequence[Effect]:
        """Rigs whose model does not estimate it."""
        return [self] if model.rig is not None and not model.estimates("initial_speed") else []

    def parameters(self, model: Model, trials: Sequence[Trial]) -> tuple[Parameter, ...]:
        """The speed, m/s or rad/s."""
        assert model.rig is not None
        unit = model.rig.speed.unit
        return (
            Parameter(
                "speed_rad_s" if common.rotates(model) else "speed_m_s",
                unit,
                -math.inf,
                math.inf,
                0.0,
                0.1 * model.scales(trials).speed,
                meaning="speed at release",
            ),
        )

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Adds to the initial speed."""

        def change(c: dict[str, float]) -> None:
            c["v0"] += values[0]

        return Hooks(coefficients=(change,))
