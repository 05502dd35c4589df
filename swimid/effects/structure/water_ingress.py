"""Water that has come into the hull and moves with it."""

from swimid.effects import common
from swimid.effects.base import Array, Effect, Effects, Hooks, Model, Parameters, Trial, Trials

#: Unit of the forces of a model that has no inertia of its own.
PER_MASS = "m/s^2"


class WaterIngress(Effect):
    """Mass added to the heaviest link at its centre of mass; its weight is taken as trimmed out."""

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
        """Mass, kg; moment of inertia, kg m2, for an angle."""
        name, unit, what = "mass_kg", "kg", "mass"
        if common.rotates(model):
            name, unit, what = "inertia_kg_m2", "kg m^2", "inertia"
        size = 0.05 * model.scales(trials).inertia
        return (common.parameter(name, unit, size, f"{what} of the water inside", lower=0.0),)

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Adds to the inertia."""
        body = model.body
        if body is not None:
            at, mass = body.centre(body.hull), values[0]
            return Hooks(tables=(lambda tables: body.weigh(tables, body.hull, at, mass, mass),))

        def change(c: dict[str, float]) -> None:
            c["mass" if "mass" in c else "inertia"] += values[0]

        return Hooks(coefficients=(change,))
