"""Water that has come into the hull and moves with it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from swimid.effects import common
from swimid.effects.base import Effect
from swimid.fitting.hooks import Hooks
from swimid.fitting.model import Array, Model, Parameter, Trial

#: Unit of the forces of a model that has no inertia of its own.
PER_MASS = "m/s^2"


class WaterIngress(Effect):
    """Mass added to the heaviest link at its centre of mass; its weight is taken as trimmed out."""

    name = "water-ingress"
    stage = "structure"
    meaning = "water inside the hull that moves with it"
    sources = ("sea lion paper, discussion",)
    needs = frozenset({"tables", "coefficients"})
    smooth = True

    def variants(self, model: Model, trials: Sequence[Trial]) -> Sequence[Effect]:
        """Models with an inertia: not those per mass, nor of a base that is held."""
        held = model.body is not None and not model.body.free
        if held or model.force_unit == PER_MASS:
            return []
        return super().variants(model, trials)

    def parameters(self, model: Model, trials: Sequence[Trial]) -> tuple[Parameter, ...]:
        """Mass, kg; moment of inertia, kg m2, for an angle."""
        rotation = common.rotates(model)
        return (
            Parameter(
                "inertia_kg_m2" if rotation else "mass_kg",
                "kg m^2" if rotation else "kg",
                0.0,
                math.inf,
                0.0,
                0.05 * model.scales(trials).inertia,
                meaning="inertia of the water inside" if rotation else "mass of the water inside",
            ),
        )

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Adds to the inertia."""
        body = model.body
        if body is not None:
            hull = body.hull
            at = body.centre(hull)

            def carry(tables: dict[str, Any]) -> None:
                body.weigh(tables, hull, at, values[0], values[0])

            return Hooks(tables=(carry,))

        def change(c: dict[str, float]) -> None:
            c["mass" if "mass" in c else "inertia"] += values[0]

        return Hooks(coefficients=(change,))
