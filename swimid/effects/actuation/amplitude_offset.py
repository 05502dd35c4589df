"""A stroke that is off by a constant angle."""

from dataclasses import replace

import numpy as np

from swimid.effects import common
from swimid.effects.base import Array, Effects, Hooks, Model, Parameters, Trial, Trials
from swimid.fitting.drives import eased
from swimid.fitting.hooks import Stroke

#: A trim comes on over this time, s: a joint that jumped at the start would throw the body.
EASE_S = 0.5


class AmplitudeOffset(common.Actuation):
    """A trim added to the angle of each driven joint; for a steady beat, the amplitude less a constant.

    The latter is ``theta_off`` of the recoil law, and applies where that is not estimated.
    """

    name = "amplitude-offset"
    meaning = "The stroke is off by a constant angle: a trim of the joints, or amplitude lost in each stroke."
    sources = ("boxfish, section 4.3 and Eq 27",)
    smooth = True
    scatters = True

    def variants(self, model: Model, trials: Trials) -> Effects:
        """Nothing where the model estimates its own offset."""
        return [] if model.estimates("amplitude_offset_deg") else super().variants(model, trials)

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """The angle, of each driven joint, in the unit of its command."""
        size = common.amplitude(model, trials)
        most, words = 0.9 * size, "constant angle off"
        return (common.parameter("offset_rad", "rad", 0.05 * size, words, lower=-most, upper=most),)

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """The command with the trim; less amplitude of a steady beat."""
        offset = float(values[0])
        driven = model.body.driven if model.body is not None else []
        moved = [axis.driven is not None and axis.driven.gain != 0 for axis in driven]
        begin = model.onset(trial)

        trimmed = common.every_joint(lambda time, angle: angle + offset * eased(time - begin, EASE_S))

        def command(time_s: Array, angle: Array, joint: int) -> Array:
            return angle if moved and not moved[joint] else trimmed(time_s, angle, joint)

        def beaten(stroke: Stroke) -> Stroke:
            return replace(stroke, amplitude_rad=np.maximum(stroke.amplitude_rad - offset, 0.0))

        return Hooks(command=(command,) if model.commanded(trial) else (), stroke=(beaten,))
