"""Water that has come into the hull and moves with it."""

import numpy as np

from swimid.effects import common
from swimid.effects.base import Array, Effect, Effects, Hooks, Model, Parameters, Trial, Trials

#: Unit of the forces of a model that has no inertia of its own.
PER_MASS = "m/s^2"


class WaterIngress(Effect):
    """Mass added to the heaviest link where the water collects; its weight is taken as trimmed out.

    On rigs and in averages over a beat only how much it is matters.
    """

    name = "water-ingress"
    meaning = "water inside the hull that moves with it"
    sources = ("sea lion paper, discussion",)
    needs = frozenset({"tables", "coefficients"})
    smooth = True

    def variants(self, model: Model, trials: Trials) -> Effects:
        """Models with an inertia: not those per mass, nor of a base that is held."""
        held = model.body is not None and not model.body.free
        if held or model.force_unit == PER_MASS:
            return []
        return super().variants(model, trials)

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """Mass (kg; for an angle kg m2) and, of a swimmer, place (m ahead of the link's centre of mass)."""
        name, unit, what = "mass_kg", "kg", "mass"
        if common.rotates(model):
            name, unit, what = "inertia_kg_m2", "kg m^2", "inertia"
        size = 0.05 * model.scales(trials).inertia
        much = common.parameter(name, unit, size, f"{what} of the water inside", lower=0.0)
        body = model.body
        if body is None:
            return (much,)
        length, (x, _) = body.lengths_m[body.hull], body.centre(body.hull)
        words = "where it collects, ahead of the hull's centre of mass"
        place = common.parameter("along_m", "m", 0.2 * length, words, lower=-length - x, upper=-x)
        return much, place

    def tries(self, parameters: Parameters) -> list[Array]:
        """Of a swimmer at the centre of mass, and half way to either end."""
        if len(parameters) == 1:
            return super().tries(parameters)
        much, place = parameters
        return [np.array([much.scale, share]) for share in (0.0, 0.5 * place.lower, 0.5 * place.upper)]

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Adds to the inertia."""
        body = model.body
        if body is not None:
            mass, (x, y) = values[0], body.centre(body.hull)
            at = x + float(values[1]), y
            return Hooks(tables=(lambda tables: body.weigh(tables, body.hull, at, mass, mass),))

        def change(c: dict[str, float]) -> None:
            c["mass" if "mass" in c else "inertia"] += values[0]

        return Hooks(coefficients=(change,))
