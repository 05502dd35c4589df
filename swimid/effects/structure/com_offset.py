"""A centre of mass that is not where the model has it."""

from swimid.effects import common
from swimid.effects.base import Array, Effect, Effects, Hooks, Model, Parameters, Trial, Trials


class ComOffset(Effect):
    """The heaviest link's mass moved along and across it, its inertia about the centre kept.

    Where the model has weights, the weight moves with it.
    """

    name = "com-offset"
    meaning = "centre of mass of the hull off the model's"
    sources = ("sea lion paper, section on identification", "tendon fish paper, Table II")
    needs = frozenset({"tables"})
    smooth = True

    def variants(self, model: Model, trials: Trials) -> Effects:
        """Free swimmers."""
        return [self] if common.free_body(model) else []

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """Offsets forwards and to port (up in the vertical plane), m."""
        body = common.links(model)
        length = body.lengths_m[body.hull]
        size, most = 0.01 * length, 0.2 * length
        return tuple(
            common.parameter(name, "m", size, f"centre of mass {way} of the model's", lower=-most, upper=most)
            for name, way in (("along_m", "ahead"), ("across_m", "above" if body.vertical else "to port"))
        )

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Moves the mass, and its weight."""
        body = common.links(model)
        by = float(values[0]), float(values[1])
        return Hooks(tables=(lambda tables: body.shift(tables, body.hull, by),))
