"""A gyroscope that is not square to the axis it measures about."""

import math

from swimid.effects import common
from swimid.effects.base import Array, Hooks, Model, Parameters, Trial, Trials


class ImuTilt(common.Sensing):
    """The turn rate in the plane of motion times the cosine of the tilt."""

    name = "imu-tilt"
    meaning = "The inertial sensor is tilted: its axis sees only part of the turn rate."
    sources = ("long-fin vehicle, section 5 (inertial unit fixed in the hull)",)
    channels = common.TURN_RATES

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """The tilt, rad."""
        return (
            common.parameter("tilt_rad", "rad", 0.2, "tilt of the gyroscope's axis", lower=0.0, upper=1.4),
        )

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Smaller turn rates."""
        return self.shown(lambda name, rate: math.cos(float(values[0])) * rate)
