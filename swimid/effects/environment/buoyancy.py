"""A robot that is not neutrally buoyant, and not level at rest."""

import math

import numpy as np

from swimid.effects import common
from swimid.effects.base import Array, Effect, Effects, Hooks, Model, Parameters, Trial, Trials
from swimid.fitting.hooks import traceable


@traceable(on="hull", constants=2)
def rise(t, pose, velocity, constants, wrench):  # type: ignore[no-untyped-def]
    """A force upwards and a righting moment; constants force and moment per sine of pitch."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    wrench[0] += constants[0] * s
    wrench[1] += constants[0] * c
    wrench[2] -= constants[1] * s


class Buoyancy(Effect):
    """Buoyancy beyond weight, and its righting moment ``-m sin(pitch)``, on the heaviest link."""

    name = "buoyancy"
    meaning = "buoyancy beyond weight, and its righting moment"
    sources = ("dolphin paper, section 4.1", "sea lion paper, discussion")
    needs = frozenset({"force", "coefficients"})
    smooth = True

    def variants(self, model: Model, trials: Trials) -> Effects:
        """Free swimmers in the vertical plane; rigs along z whose rest position is known."""
        if model.rig is not None:
            known = not model.estimates("rest_position")
            return [self] if model.axes == ("z",) and known else []
        body = common.free_body(model)
        return [self] if body is not None and body.vertical else []

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """Force upwards, N, and righting moment, N m."""
        size = 0.03 * model.scales(trials).force
        force = common.parameter("force_N", "N", size, "buoyancy beyond weight")
        body = model.body
        if body is None:
            return (force,)
        moment = size * body.lengths_m[body.hull]
        return force, common.parameter("righting_N_m", "N m", moment, "righting moment per sine of pitch")

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """A constant force, and a moment."""
        body = model.body
        if body is not None:
            return Hooks(force=(common.at_hull(body, rise, np.array(values, dtype=float)),))
        return common.more("force", values[0])
