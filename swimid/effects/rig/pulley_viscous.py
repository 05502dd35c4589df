"""Viscous friction of the pulley."""

from __future__ import annotations

import math
from collections.abc import Sequence

from swimid.effects.base import Effect
from swimid.fitting.hooks import Hooks
from swimid.fitting.model import Array, Model, Parameter, Trial

OWN = ("linear_drag", "linear_damping")


class PulleyViscous(Effect):
    """Friction that grows with the pulley's speed, ``-b v``: a lubricated bearing."""

    name = "pulley-viscous"
    stage = "rig"
    meaning = "friction of the pulley that grows with its speed"
    sources = ("boxfish paper, section 3.3",)
    needs = frozenset({"coefficients"})
    smooth = True

    def variants(self, model: Model, trials: Sequence[Trial]) -> Sequence[Effect]:
        """Rigs with a pulley whose model estimates no linear drag."""
        if model.rig is None or model.estimates(*OWN):
            return []
        return [self] if any(t.rig.pulley for t in trials) else []

    def parameters(self, model: Model, trials: Sequence[Trial]) -> tuple[Parameter, ...]:
        """Force per speed, N s/m."""
        scales = model.scales(trials)
        return (
            Parameter(
                "viscous_N_s_m",
                "N s/m",
                -model.start(*OWN),
                math.inf,
                0.0,
                0.1 * scales.force / scales.speed,
                meaning="friction of the pulley per speed",
            ),
        )

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Adds to the linear drag of trials with a pulley."""
        if not trial.rig.pulley:
            return Hooks()

        def change(c: dict[str, float]) -> None:
            c["linear"] += values[0]

        return Hooks(coefficients=(change,))
