"""A spring other than the model's."""

from typing import Any

import numpy as np

from swimid.effects.base import Array, Effect, Effects, Hooks, Model, Parameters, Trial, Trials
from swimid.effects.common import parameter


class JointStiffness(Effect):
    """Springs of the passive joints other than the model's, or a free decay's restoring force.

    With K the model's stiffness at small angles the torque gains ``-K (change + hardening phi^2) phi``.
    """

    name = "joint-stiffness"
    meaning = "stiffness of the passive joints against the model's"
    sources = ("tendon fish paper, Eqs 3 and 4", "dolphin paper, Eq 5 and section 4.2.1")
    needs = frozenset({"tables", "coefficients"})

    def variants(self, model: Model, trials: Trials) -> Effects:
        """Swimmers with a spring, and decays whose stiffness is not estimated."""
        body = model.body
        if body is not None:
            tables = body.tables()
            return [self] if any(body.stiffness(tables, k) > 0 for k in range(len(body.passive))) else []
        held = model.rig is not None and model.rig.swings
        return [self] if held and not model.estimates("stiffness") else []

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """The relative change, and for a swimmer's joints the hardening."""
        change = parameter("change", "1", 0.2, "relative change of stiffness", lower=-0.95, upper=6.0)
        if model.body is None:
            return (change,)
        words = "relative growth with squared angle"
        return change, parameter("hardening_rad_2", "rad^-2", 2.0, words, lower=-10.0, upper=60.0)

    def tries(self, parameters: Parameters) -> list[Array]:
        """Softer, stiffer, several times as stiff, and hardening."""
        changes = [np.array([c, 0.0][: len(parameters)]) for c in (-0.5, 0.3, 0.8, 1.6, 3.0)]
        return changes + [np.array([0.0, h]) for h in (2.0, 8.0) if len(parameters) > 1]

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Adds to the springs."""
        body = model.body
        if body is not None:

            def springs(tables: dict[str, Any]) -> None:
                for k in range(len(body.passive)):
                    own = body.stiffness(tables, k)
                    body.stiffen(tables, k, stiffness=own * values[0], cubic=own * values[1])

            return Hooks(tables=(springs,))

        def restoring(c: dict[str, float]) -> None:
            c["stiffness"] *= 1.0 + values[0]

        return Hooks(coefficients=(restoring,))
