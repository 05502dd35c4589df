"""Dry friction of a pulley, bearing or slide that the model does not have, or has too little of."""

from swimid.effects import common
from swimid.effects.base import Effects, Model, Parameters, Trials


class PulleyFriction(common.RigCoefficient):
    """``F - f_c sgn(v)`` of a rig, on top of the model's own (boxfish, Eq 7).

    On a falling-weight rig it is the pulley's, and acts in the trials that have one; where none has, it is
    that of the slide the body moves on.
    """

    name = "pulley-friction"
    meaning = "dry friction of the pulley, bearing or slide"
    sources = ("boxfish paper, Eq 7 and section 4.1",)
    coefficient = "dry"
    own = ("pulley_friction", "dry_friction")

    def __init__(self, *, everywhere: bool = False) -> None:
        self.pulley = not everywhere

    def variants(self, model: Model, trials: Trials) -> Effects:
        """Rigs whose model does not estimate it."""
        form = PulleyFriction(everywhere=not common.with_pulley(trials))
        return common.RigCoefficient.variants(form, model, trials)

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """Friction beyond the model's, N (N m for an angle)."""
        name, unit = ("friction_N_m", "N m") if common.rotates(model) else ("friction_N", "N")
        words = "dry friction beyond the model's"
        size = model.scales(trials).brake
        return (common.parameter(name, unit, size, words, lower=-model.start(*self.own)),)
