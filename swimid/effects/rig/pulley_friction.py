"""Dry friction of a pulley, bearing or slide that the model does not have, or has too little of."""

from __future__ import annotations

import math
from collections.abc import Sequence

from swimid.effects import common
from swimid.effects.base import Effect
from swimid.fitting.hooks import Hooks
from swimid.fitting.model import Array, Model, Parameter, Trial

OWN = ("pulley_friction", "dry_friction")


class PulleyFriction(Effect):
    """``F - f_c sgn(v)`` of a rig, on top of the model's own (boxfish, Eq 7).

    On a falling-weight rig it is the pulley's, and acts in the trials that have one; where none has, it is
    that of the slide the body moves on.
    """

    name = "pulley-friction"
    stage = "rig"
    meaning = "dry friction of the pulley, bearing or slide"
    sources = ("boxfish paper, Eq 7 and section 4.1",)
    needs = frozenset({"coefficients"})
    smooth = True

    def __init__(self, *, everywhere: bool = False) -> None:
        self.everywhere = everywhere

    def variants(self, model: Model, trials: Sequence[Trial]) -> Sequence[Effect]:
        """Rigs whose model does not estimate it."""
        if model.rig is None or model.estimates(*OWN):
            return []
        return [PulleyFriction(everywhere=not _pulley(trials))]

    def parameters(self, model: Model, trials: Sequence[Trial]) -> tuple[Parameter, ...]:
        """Friction beyond the model's, N (N m for an angle)."""
        rotation = common.rotates(model)
        return (
            Parameter(
                "friction_N_m" if rotation else "friction_N",
                "N m" if rotation else "N",
                -model.start(*OWN),
                math.inf,
                0.0,
                model.scales(trials).brake,
                meaning="dry friction beyond the model's",
            ),
        )

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Adds to the dry friction."""
        if not (self.everywhere or trial.rig.pulley):
            return Hooks()

        def change(c: dict[str, float]) -> None:
            c["dry"] += values[0]

        return Hooks(coefficients=(change,))


def _pulley(trials: Sequence[Trial]) -> bool:
    return any(t.rig.pulley for t in trials)
