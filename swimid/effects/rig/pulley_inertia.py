"""Inertia that moves with the pulling weight and was not counted."""

from __future__ import annotations

import math
from collections.abc import Sequence

from swimid.effects.base import Effect
from swimid.fitting.hooks import Hooks
from swimid.fitting.model import Array, Model, Parameter, Trial


class PulleyInertia(Effect):
    """The pulley's moment of inertia over its radius squared, added to M of the boxfish paper's Eq 8.

    In one body of water it cannot be told from added mass; trials with and without a pulley tell.
    """

    name = "pulley-inertia"
    stage = "rig"
    meaning = "inertia of the pulley that was not counted"
    sources = ("boxfish paper, Eq 8",)
    needs = frozenset({"coefficients"})
    smooth = True

    def variants(self, model: Model, trials: Sequence[Trial]) -> Sequence[Effect]:
        """Rigs with a pulley."""
        pulley = any(t.rig.pulley for t in trials)
        return [self] if model.rig is not None and pulley else []

    def parameters(self, model: Model, trials: Sequence[Trial]) -> tuple[Parameter, ...]:
        """Equivalent mass, kg."""
        return (
            Parameter(
                "inertia_kg",
                "kg",
                0.0,
                math.inf,
                0.0,
                0.05 * model.scales(trials).inertia,
                meaning="inertia of the pulley over its radius squared",
            ),
        )

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Adds to the inertia of trials with a pulley."""
        if not trial.rig.pulley:
            return Hooks()

        def change(c: dict[str, float]) -> None:
            c["inertia"] += values[0]

        return Hooks(coefficients=(change,))
