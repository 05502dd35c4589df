"""A camera turned against the axes of the heading."""

import math

from swimid.effects import common
from swimid.effects.base import Array, Effect, Effects, Hooks, Model, Parameters, Trial, Trials


class CameraRotation(Effect):
    """Positions turned about where the trial starts, the heading as it is."""

    name = "camera-rotation"
    meaning = "The axes of the measured positions are turned against those of the measured heading."
    sources = ("sea lion, section II (a camera on a wall of the tank)",)
    needs = frozenset({"output"})
    smooth = True

    def variants(self, model: Model, trials: Trials) -> Effects:
        """The effect itself where both positions are measured and the model does not estimate it."""
        if model.body is None or model.estimates("camera_rotation"):
            return []
        both = len(common.measured(model.body.pose[:2], trials)) == 2
        return super().variants(model, trials) if both else []

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """The angle, rad."""
        words = "axes of the positions against those of the heading"
        return (common.parameter("angle_rad", "rad", 0.03, words, lower=-math.pi, upper=math.pi),)

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Turned positions."""
        angle = float(values[0])
        first, second, _ = common.links(model).pose
        origin = model.origin(trial)

        def seen(channels: dict[str, Array], time_s: Array) -> dict[str, Array]:
            a, b = channels[first] - origin[first], channels[second] - origin[second]
            # minus the unturned, so that no angle changes nothing at all
            c, s = math.cos(angle) - 1.0, math.sin(angle)
            return {
                **channels,
                first: channels[first] + c * a - s * b,
                second: channels[second] + s * a + c * b,
            }

        return Hooks(output=(seen,))
