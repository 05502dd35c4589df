"""A gyroscope that is not square to the axis it measures about."""

from __future__ import annotations

import math
from collections.abc import Sequence

from swimid.effects.base import Effect
from swimid.effects.sensing import _channels
from swimid.fitting.hooks import Hooks
from swimid.fitting.model import Array, Model, Parameter, Trial


class ImuTilt(Effect):
    """The turn rate in the plane of motion times the cosine of the tilt."""

    name = "imu-tilt"
    stage = "sensing"
    meaning = "The inertial sensor is tilted: its axis sees only part of the turn rate."
    sources = ("long-fin vehicle, section 5 (inertial unit fixed in the hull)",)
    needs = frozenset({"output"})

    def variants(self, model: Model, trials: Sequence[Trial]) -> Sequence[Effect]:
        """The effect itself where a turn rate is measured."""
        return super().variants(model, trials) if _channels.measured(_channels.TURN_RATES, trials) else []

    def parameters(self, model: Model, trials: Sequence[Trial]) -> tuple[Parameter, ...]:
        """The tilt, rad."""
        return (Parameter("tilt_rad", "rad", 0.0, 1.4, 0.0, 0.2, meaning="tilt of the gyroscope's axis"),)

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Smaller turn rates."""
        part = math.cos(float(values[0]))

        def seen(channels: dict[str, Array], time_s: Array) -> dict[str, Array]:
            return {n: part * v if n in _channels.TURN_RATES else v for n, v in channels.items()}

        return Hooks(output=(seen,))
