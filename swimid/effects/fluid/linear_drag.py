"""Drag in proportion to the speed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from swimid.effects import common
from swimid.effects.base import Effect
from swimid.fitting.hooks import Hooks
from swimid.fitting.model import Array, Model, Parameter, Trial
from swimid.propulsion.model import SurgeModel
from swimid.swimmer.planar.model import MultilinkModel

OWN = ("linear_drag", "linear_damping")


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
        if common.estimated(model, *OWN):
            return []
        if isinstance(model, MultilinkModel) and not model.assembly.free_base:
            return []
        return super().variants(model, trials)

    def parameters(self, model: Model, trials: Sequence[Trial]) -> tuple[Parameter, ...]:
        """Force per speed, N s/m; moment per rate for an angle, 1/s where the model is per mass."""
        name, unit = "linear_N_s_m", "N s/m"
        if common.rotates(model):
            name, unit = "linear_N_m_s_rad", "N m s/rad"
        if isinstance(model, SurgeModel):
            name, unit = "linear_1_s", "1/s"
        return (
            Parameter(
                name,
                unit,
                -common.start(model, *OWN),
                math.inf,
                0.0,
                common.brake(model, trials) / common.speed(model, trials),
                meaning="drag per speed",
            ),
        )

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Adds to the linear drag."""
        if isinstance(model, MultilinkModel):
            hull = common.hull(model)
            x, y = common.centre(model, hull)
            row = [x, y, 0.0, 0.0, values[0], values[0], 0.0, 0.0]

            def add(tables: dict[str, Any]) -> None:
                tables["drag_link"] = np.append(tables["drag_link"], hull)
                tables["drag"] = np.vstack([tables["drag"], row])

            return Hooks(tables=(add,))

        def change(c: dict[str, float]) -> None:
            c["linear"] += values[0]

        return Hooks(coefficients=(change,))
