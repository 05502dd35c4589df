"""Inertia that moves with the pulling weight and was not counted."""

from swimid.effects.base import Model, Parameters, Trials
from swimid.effects.common import RigCoefficient, parameter


class PulleyInertia(RigCoefficient):
    """The pulley's moment of inertia over its radius squared, added to M of the boxfish paper's Eq 8.

    In one body of water it cannot be told from added mass; trials with and without a pulley tell.
    """

    name = "pulley-inertia"
    meaning = "inertia of the pulley that was not counted"
    sources = ("boxfish paper, Eq 8",)
    coefficient = "inertia"
    pulley = True

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """Equivalent mass, kg."""
        size = 0.05 * model.scales(trials).inertia
        words = "inertia of the pulley over its radius squared"
        return (parameter("inertia_kg", "kg", size, words, lower=0.0),)
