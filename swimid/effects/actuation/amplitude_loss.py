"""Joints that turn less far than they are told."""

from swimid.effects import common
from swimid.effects.base import Array, Model, Parameters, Trials
from swimid.fitting.hooks import Stroke


class AmplitudeLoss(common.Actuation):
    """A gain below one: ``(1 - loss)`` times the command."""

    name = "amplitude-loss"
    meaning = "The joints turn by less than their command, by the same share always."
    sources = ("boxfish, section 5.3 (the body's oscillation reduces the effective amplitude)",)
    smooth = True
    scatters = True

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """The share that is lost."""
        return (common.parameter("loss", "1", 0.05, "share of the amplitude lost", lower=-0.5, upper=0.95),)

    def followed(self, value: float, time_s: Array, angle: Array) -> Array:
        """Less of the command."""
        return (1.0 - value) * angle

    def amplitude(self, value: float, stroke: Stroke) -> Array:
        """Less of the amplitude."""
        return stroke.amplitude_rad * (1.0 - value)
