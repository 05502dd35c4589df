"""Drag in proportion to the square of the speed, on a rig whose model does not estimate it."""

from __future__ import annotations

import math
from collections.abc import Sequence

from swimid.effects import common
from swimid.effects.base import Effect
from swimid.fitting.hooks import Hooks
from swimid.fitting.model import Array, Model, Parameter, Trial

OWN = ("quadratic_drag", "quadratic_damping", "drag_coefficient")


class QuadraticDrag(Effect):
    """``-c v |v|`` of separated flow: form drag of a body pulled along, vortex damping of one that swings."""

    name = "quadratic-drag"
    stage = "fluid"
    meaning = "drag in proportion to the square of the speed"
    sources = (
        "boxfish paper, Eq 7",
        "Fossen 2011, Handbook of Marine Craft Hydrodynamics, section 6.4",
    )
    needs = frozenset({"coefficients"})
    smooth = True

    def variants(self, model: Model, trials: Sequence[Trial]) -> Sequence[Effect]:
        """Rigs whose model does not estimate it."""
        return [self] if model.rig is not None and not model.estimates(*OWN) else []

    def parameters(self, model: Model, trials: Sequence[Trial]) -> tuple[Parameter, ...]:
        """Force per squared speed, N s2/m2; moment per squared rate for an angle."""
        rotation, scales = common.rotates(model), model.scales(trials)
        return (
            Parameter(
                "quadratic_N_m_s2_rad2" if rotation else "quadratic_N_s2_m2",
                "N m s^2/rad^2" if rotation else "N s^2/m^2",
                -scales.quadratic,
                math.inf,
                0.0,
                scales.brake / scales.speed**2,
                meaning="drag per squared speed",
            ),
        )

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Adds to the quadratic drag."""

        def change(c: dict[str, float]) -> None:
            c["quadratic"] += values[0]

        return Hooks(coefficients=(change,))
