"""A spring other than the model's."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from swimid.effects import common
from swimid.effects.base import Effect
from swimid.models.base import Array, Model, Parameter, Trial
from swimid.models.hooks import Hooks
from swimid.models.multilink.engine import PASSIVE
from swimid.models.multilink.model import MultilinkModel
from swimid.models.rig import RigModel

#: What of a passive joint's law is its spring.
SPRING = [PASSIVE.index(name) for name in ("stiffness", "cubic", "spring")]


class JointStiffness(Effect):
    """The springs of all passive joints, or a free decay's restoring force, times ``1 + change``."""

    name = "joint-stiffness"
    stage = "structure"
    meaning = "stiffness of the passive joints against the model's"
    sources = ("tendon fish paper, Eqs 3 and 4", "dolphin paper, Eq 5 and section 4.2.1")
    needs = frozenset({"tables", "coefficients"})

    def variants(self, model: Model, trials: Sequence[Trial]) -> Sequence[Effect]:
        """Swimmers with a spring, and decays whose stiffness is not estimated."""
        if isinstance(model, MultilinkModel):
            return [self] if common.tables(model)["passive"][:, SPRING].any() else []
        held = isinstance(model, RigModel) and model.name == "free-decay"
        return [self] if held and not common.estimated(model, "stiffness") else []

    def parameters(self, model: Model, trials: Sequence[Trial]) -> tuple[Parameter, ...]:
        """The relative change."""
        return (Parameter("change", "1", -0.9, 4.0, 0.0, 0.2, meaning="relative change of stiffness"),)

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Multiplies the stiffness."""

        def springs(tables: dict[str, Any]) -> None:
            passive = tables["passive"].copy()
            passive[:, SPRING] *= 1.0 + values[0]
            tables["passive"] = passive

        def restoring(c: dict[str, float]) -> None:
            c["stiffness"] *= 1.0 + values[0]

        if isinstance(model, MultilinkModel):
            return Hooks(tables=(springs,))
        return Hooks(coefficients=(restoring,))
