"""An effect of one's own: the drive weakens as its battery runs down."""

from collections.abc import Sequence

import numpy as np

from swimid.effects.base import Effect
from swimid.fitting.model import Array, Hooks, Model, Parameter, Trial


class DriveDroop(Effect):
    """The joints' angles shrink as ``exp(-rate t)`` from the start of each trial on."""

    name = "drive-droop"
    stage = "actuation"
    meaning = "The amplitude of the drive decays exponentially during a trial."
    sources = ("own measurements",)
    needs = frozenset({"command"})

    def parameters(self, model: Model, trials: Sequence[Trial]) -> tuple[Parameter, ...]:
        """One rate. At ``start`` the effect vanishes; ``scale`` is a size that one begins to see."""
        return (
            Parameter("rate_1_s", "1/s", lower=0.0, upper=0.5, start=0.0, scale=0.01, meaning="decay rate"),
        )

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """What the actuators do in place of what they are told, joint by joint."""
        (rate,) = values

        def drooping(time_s: Array, angle_rad: Array, joint: int) -> Array:
            return angle_rad * np.exp(-rate * (time_s - time_s[0]))

        return Hooks(command=(drooping,))
