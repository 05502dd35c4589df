"""A length scale that is off."""

from swimid.effects.base import Array, Hooks, Model, Parameters, Trial, Trials
from swimid.effects.common import parameter
from swimid.effects.sensing import _channels


class CameraScale(_channels.Sensing):
    """Displacements and speeds times ``1 + scale_error``, about where the trial starts.

    On a rig it is the circumference of the encoder's pulley, on a cruising run the length of the
    course or the rate of the clock.
    """

    name = "camera-scale"
    meaning = "The measured lengths are too long or too short by a constant share."
    sources = (
        "boxfish, section 4.2 (error of the course's length)",
        "tendon fish, section V (global camera)",
        "robotic dolphin, section 4 (global camera)",
    )
    channels = _channels.LENGTHS
    smooth = True

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """The relative error of the scale."""
        return (parameter("scale_error", "1", 0.03, "relative error of the lengths", lower=-0.5, upper=1.0),)

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Scaled positions and speeds."""
        error, origin = float(values[0]), model.origin(trial)
        return self.shown(lambda name, length: length + error * (length - origin.get(name, 0.0)))
