"""Viscous friction in the passive joints that the model does not have."""

import math
from typing import Any

import numpy as np

from swimid.effects import common
from swimid.effects.base import Array, Effect, Effects, Hooks, Model, Parameters, Trial, Trials


class JointDamping(Effect):
    """``-d phi'`` at every passive joint, on top of the model's."""

    name = "joint-damping"
    meaning = "viscous friction of the passive joints beyond the model's"
    sources = ("tendon fish paper, Eq 5", "dolphin paper, Eq 5")
    needs = frozenset({"tables"})
    smooth = True

    def variants(self, model: Model, trials: Trials) -> Effects:
        """Swimmers with a passive joint."""
        return [self] if model.body is not None and model.body.passive else []

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """Torque per rate, N m s/rad; its scale is a damping ratio of 0.05."""
        body = common.links(model)
        tables, joints = body.tables(), range(len(body.passive))
        sizes = [
            math.sqrt(max(body.stiffness(tables, k), 1e-6) * body.joint_inertia(tables, k)) for k in joints
        ]
        size, least = 0.1 * float(np.median(sizes)), -min(body.damping(tables, k) for k in joints)
        words = "damping of each passive joint beyond the model's"
        return (common.parameter("damping_N_m_s_rad", "N m s/rad", size, words, lower=least),)

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Adds to the damping."""
        body = common.links(model)

        def damp(tables: dict[str, Any]) -> None:
            for k in range(len(body.passive)):
                body.stiffen(tables, k, damping=values[0])

        return Hooks(tables=(damp,))
