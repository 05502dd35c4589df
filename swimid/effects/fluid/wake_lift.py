"""Reactive force of a fin: momentum shed at its trailing edge."""

import math

from swimid.effects import common
from swimid.effects.base import Array, Effect, Effects, Hooks, Model, Parameters, Trial, Trials

#: Most added mass per length, in those of the plate that gives the scale.
MOST = 10.0


class WakeLift(Effect):
    """``-m u w n + m w^2 t / 2`` at the rear end of the last link.

    u and w are the edge's velocities along and across its link, m the added mass per length there
    (:mod:`swimid.swimmer.planar.assembly.trailing_edge`).
    """

    name = "wake-lift"
    meaning = "reactive force of the fin: momentum shed into the wake"
    sources = ("Lighthill 1971, Proc. R. Soc. Lond. B 179:125",)
    needs = frozenset({"tables"})
    smooth = True

    def variants(self, model: Model, trials: Trials) -> Effects:
        """Swimmers of several links."""
        return [self] if model.body is not None and model.body.last > 0 else []

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """Added mass per length at the edge, kg/m, against a plate as high as the last link is long."""
        body = common.links(model)
        plate = 0.25 * math.pi * body.density_kg_m3 * body.lengths_m[-1] ** 2
        words = "added mass per length at the trailing edge"
        most = MOST * plate
        return (common.parameter("added_mass_kg_m", "kg/m", 0.1 * plate, words, lower=0.0, upper=most),)

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Adds a trailing edge."""
        body = common.links(model)
        return Hooks(tables=(lambda tables: body.shed(tables, float(values[0])),))
