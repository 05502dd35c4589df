"""An effect of your own: the motor weakens as its battery runs down."""

from collections.abc import Sequence

import numpy as np

from swimid.effects.base import Effect
from swimid.fitting.model import Array, Hooks, Model, Parameter, Trial


class DriveDroop(Effect):
    """Decay of the commanded angles as ``exp(-rate t)`` from the start of each trial on."""

    name = "drive-droop"
    stage = "actuation"
    meaning = "The amplitude of the command decays exponentially during a trial."
    sources = ("own measurements",)
    needs = frozenset({"command"})

    def parameters(self, model: Model, trials: Sequence[Trial]) -> tuple[Parameter, ...]:
        """Return one rate. At ``start`` the effect vanishes; ``scale`` is its typical size."""
        return (
            Parameter("rate_1_s", "1/s", lower=0.0, upper=0.5, start=0.0, scale=0.01, meaning="decay rate"),
        )

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Return the function that changes the command of each joint."""
        (rate,) = values

        def drooping(time_s: Array, angle_rad: Array, joint: int) -> Array:
            return angle_rad * np.exp(-rate * (time_s - time_s[0]))

        return Hooks(command=(drooping,))
