"""Water that moves with the body beyond the model's."""

from typing import Any

from swimid.effects import common
from swimid.effects.base import Array, Effect, Effects, Hooks, Model, Parameters, Trial, Trials

#: The least of the inertia that may be left, as a share of the rigid body's.
LEAST = 0.5


class AddedMass(Effect):
    """Added mass beyond the model's: a rig's, or a swimmer's along and across its links.

    A swimmer's is shared out among the links as their masses are, at their centres of mass; across, more or
    less of it may follow the last link.
    """

    name = "added-mass"
    meaning = "added mass beyond the model's"
    sources = ("boxfish paper, Eq 8", "tendon fish paper, Eq 6", "dolphin paper, Eq 7")
    needs = frozenset({"coefficients", "tables"})
    smooth = True

    def variants(self, model: Model, trials: Trials) -> Effects:
        """Rigs and free swimmers."""
        return [self] if model.rig is not None or common.free_body(model) else []

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """Added mass along and across all links, kg; or that of the rig's coordinate."""
        body = model.body
        if body is not None:
            masses = body.masses_kg
            own, across = sum(masses), body.words[4]
            return tuple(
                common.parameter(name, "kg", 0.05 * own, f"{words} added mass", lower=-least)
                for name, least, words in (
                    ("surge_kg", LEAST * own, "surge"),
                    ("sway_kg", LEAST * own, across),
                    ("tail_kg", 0.5 * LEAST * masses[-1], f"{across} of the last link's"),
                )
            )
        name, unit, words = "added_kg", "kg", "added mass"
        if common.rotates(model):
            name, unit, words = "added_kg_m2", "kg m^2", "added inertia"
        size = model.scales(trials).inertia
        own = size - model.start("added_mass", "added_inertia")
        return (common.parameter(name, unit, 0.05 * size, words, lower=-LEAST * own),)

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Adds to the inertia."""
        body = model.body
        if body is not None:
            masses = body.masses_kg
            points = [body.centre(link) for link in range(len(masses))]

            def carry(tables: dict[str, Any]) -> None:
                for link, (mass, at) in enumerate(zip(masses, points, strict=True)):
                    share = mass / sum(masses)
                    body.weigh(tables, link, at, share * values[0], share * values[1])
                body.weigh(tables, len(masses) - 1, points[-1], 0.0, values[2])

            return Hooks(tables=(carry,))
        return common.more("inertia", values[0])
