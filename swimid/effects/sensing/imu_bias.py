"""Gyroscope bias: a turn rate that is read at rest."""

from swimid.effects import common
from swimid.effects.base import Array, Hooks, Model, Parameters, Trial, Trials


class ImuBias(common.Sensing):
    """A constant added to the turn rate."""

    name = "imu-bias"
    meaning = "The gyroscope shows a constant turn rate at rest."
    sources = ("long-fin vehicle, section 5.2 (drift and calibration errors; the mean is filtered out)",)
    channels = common.TURN_RATES
    smooth = True

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """The bias, rad/s."""
        return (
            common.parameter("bias_rad_s", "rad/s", 0.02, "turn rate shown at rest", lower=-1.0, upper=1.0),
        )

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Turn rates with the bias."""
        return self.shown(lambda name, rate: rate + float(values[0]))
