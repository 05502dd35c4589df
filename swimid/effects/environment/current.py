"""A steady current."""

import numpy as np

from swimid.effects.base import Array, Effect, Effects, Hooks, Model, Parameters, Trial, Trials
from swimid.effects.common import parameter

#: Largest current, in typical speeds of the robot.
MOST = 3.0


class Current(Effect):
    """Water that moves evenly and steadily in the world; along the track where the model has one axis."""

    name = "current"
    meaning = "steady current of the water"
    sources = ("Fossen 2011, Handbook of Marine Craft Hydrodynamics, section 8.3",)
    needs = frozenset({"flow"})
    smooth = True

    def variants(self, model: Model, trials: Trials) -> Effects:
        """Models of a body that moves from place to place."""
        return super().variants(model, trials) if model.axes else []

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """Its components in the world, m/s."""
        size = model.scales(trials).speed
        most, words = MOST * size, "velocity of the water along"
        return tuple(
            parameter(f"c{axis}_m_s", "m/s", 0.1 * size, f"{words} {axis}", lower=-most, upper=most)
            for axis in model.axes
        )

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Water that moves."""
        velocity = np.zeros(2)
        velocity[: len(values)] = values

        def flow(time_s: Array) -> tuple[Array, Array]:
            return np.outer(time_s, velocity), np.tile(velocity, (len(time_s), 1))

        return Hooks(flow=(flow,))
