"""A gyroscope that is not square to the axis it measures about."""

from __future__ import annotations

import math
from collections.abc import Sequence

from swimid.effects.common import parameter
from swimid.effects.sensing import _channels
from swimid.fitting.hooks import Hooks
from swimid.fitting.model import Array, Model, Parameter, Trial


class ImuTilt(_channels.Sensing):
    """The turn rate in the plane of motion times the cosine of the tilt."""

    name = "imu-tilt"
    meaning = "The inertial sensor is tilted: its axis sees only part of the turn rate."
    sources = ("long-fin vehicle, section 5 (inertial unit fixed in the hull)",)
    channels = _channels.TURN_RATES

    def parameters(self, model: Model, trials: Sequence[Trial]) -> tuple[Parameter, ...]:
        """The tilt, rad."""
        return (parameter("tilt_rad", "rad", 0.2, "tilt of the gyroscope's axis", lower=0.0, upper=1.4),)

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Smaller turn rates."""
        return self.shown(lambda name, rate: math.cos(float(values[0])) * rate)
