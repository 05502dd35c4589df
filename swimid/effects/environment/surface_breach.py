"""A robot that comes out of the water and loses its buoyancy."""

import math

import numpy as np

from swimid.effects import common
from swimid.effects.base import SIZES, Array, Effect, Effects, Hooks, Model, Parameters, Trial, Trials
from swimid.fitting.hooks import traceable

#: Height over which the force sets in, m.
ROUND = 0.002


@traceable(on="hull", constants=5)
def sink(t, pose, velocity, constants, wrench):  # type: ignore[no-untyped-def]
    """Weight of what has left the water; constants force per height, level, place of the point, lever."""
    s, c = math.sin(pose[2]), math.cos(pose[2])
    middle = pose[1] + constants[2] * s + constants[3] * c - constants[1]
    for side in (-1.0, 1.0):
        above = middle + side * constants[4] * s
        down = -0.25 * constants[0] * (above + math.sqrt(above * above + ROUND * ROUND))
        wrench[0] += down * s
        wrench[1] += down * c
        wrench[2] += side * constants[4] * down * c


class SurfaceBreach(Effect):
    """Above a level the hull is pulled down by the weight of the water it no longer displaces.

    Half of it acts a quarter of the hull's length ahead of its centre of mass, half as far behind.
    """

    name = "surface-breach"
    meaning = "buoyancy lost above the surface"
    sources = ("dolphin paper, section 4.1",)
    needs = frozenset({"force"})

    def __init__(self, levels_m: tuple[float, ...] = (0.0,)) -> None:
        """Take the levels at which it is tried."""
        self.levels_m = levels_m

    def variants(self, model: Model, trials: Trials) -> Effects:
        """Free swimmers in the vertical plane whose height is measured."""
        heights = [t.measured["z_m"] for t in trials if "z_m" in t.measured]
        body = common.free_body(model)
        if body is None or not body.vertical or not heights:
            return []
        values = np.concatenate(heights)
        return [SurfaceBreach(tuple(float(q) for q in np.nanquantile(values, (0.85, 0.5, 0.97))))]

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """Force per height, N/m, and level of the reference point, m."""
        size = 0.2 * model.scales([_heights(t) for t in trials]).span
        slope = 0.1 * model.scales(trials).force / size
        words = "height of the reference point above which buoyancy is lost"
        return (
            common.parameter("force_N_m", "N/m", slope, "buoyancy lost per height", lower=0.0),
            common.parameter("level_m", "m", size, words, start=self.levels_m[0]),
        )

    def tries(self, parameters: Parameters) -> list[Array]:
        """Sizes of the force at each level."""
        return [np.array([s * parameters[0].scale, level]) for level in self.levels_m for s in SIZES[1:]]

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """A force and its moment on the heaviest link."""
        body = common.links(model)
        hull = body.hull
        x, y = body.centre(hull)
        a, b = body.reference_m if hull == 0 else (x, y)
        quarter = 0.25 * body.lengths_m[hull]
        constants = np.array([*values, x - a, y - b, quarter])
        return Hooks(force=(common.at_hull(body, sink, constants),))


def _heights(trial: Trial) -> Trial:
    """The trial with its height alone."""
    measured = {name: value for name, value in trial.measured.items() if name == "z_m"}
    return Trial(trial.id, trial.role, trial.time_s, measured)
