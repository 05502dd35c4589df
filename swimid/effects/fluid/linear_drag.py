"""Drag in proportion to the speed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from swimid.effects.base import Effect
from swimid.fitting.hooks import Hooks
from swimid.fitting.model import Array, Model, Parameter, Trial

OWN = ("linear_drag", "linear_damping")
#: Name and unit of a force per speed, by the unit of the force.
UNITS = {
    "N": ("linear_N_s_m", "N s/m"),
    "N m": ("linear_N_m_s_rad", "N m s/rad"),
    "m/s^2": ("linear_1_s", "1/s"),
}


class LinearDrag(Effect):
    """``-c v`` on the body, along and across; a swimmer's acts at the centre of mass of its heaviest link."""

    name = "linear-drag"
    stage = "fluid"
    meaning = "drag in proportion to the speed"
    sources = ("Fossen 2011, Handbook of Marine Craft Hydrodynamics, section 6.4",)
    needs = frozenset({"coefficients", "tables"})
    smooth = True

    def variants(self, model: Model, trials: Sequence[Trial]) -> Sequence[Effect]:
        """Models that do not estimate it and whose body moves."""
        if model.estimates(*OWN):
            return []
        if model.body is not None and not model.body.free:
            return []
        return super().variants(model, trials)

    def parameters(self, model: Model, trials: Sequence[Trial]) -> tuple[Parameter, ...]:
        """Force per speed, N s/m; moment per rate for an angle, 1/s where the model is per mass."""
        name, unit = UNITS[model.force_unit]
        scales = model.scales(trials)
        return (
            Parameter(
                name,
                unit,
                -model.start(*OWN),
                math.inf,
                0.0,
                scales.brake / scales.speed,
                meaning="drag per speed",
            ),
        )

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Adds to the linear drag."""
        body = model.body
        if body is not None:
            hull = body.hull
            at = body.centre(hull)

            def add(tables: dict[str, Any]) -> None:
                body.drag_more(tables, hull, at, values[0])

            return Hooks(tables=(add,))

        def change(c: dict[str, float]) -> None:
            c["linear"] += values[0]

        return Hooks(coefficients=(change,))
