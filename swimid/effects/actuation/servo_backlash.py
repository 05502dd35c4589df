"""Play between servo and joint."""

import numpy as np

from swimid.effects import common
from swimid.effects.base import Array, Model, Parameters, Trials
from swimid.fitting.hooks import Stroke


class ServoBacklash(common.Actuation):
    """The play operator: the joint rests until the servo has crossed the play, then is carried along.

    A steady beat of the average models loses half the play.
    """

    name = "servo-backlash"
    meaning = "The joints do not follow their servos across the play of gears, linkages or tendons."
    sources = ("boxfish, section 5.3 (about 2 deg of the amplitude offset)",)

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """The whole width of the play, of each joint, in the unit of its command."""
        size = common.amplitude(model, trials)
        words = "whole width of the play"
        return (common.parameter("backlash_rad", "rad", 0.1 * size, words, lower=0.0, upper=1.9 * size),)

    def followed(self, value: float, time_s: Array, angle: Array) -> Array:
        """Play in the command."""
        return play(angle, value)

    def amplitude(self, value: float, stroke: Stroke) -> Array:
        """Half the play less."""
        return np.maximum(stroke.amplitude_rad - 0.5 * value, 0.0)


def play(signal: Array, width: float) -> Array:
    """Output of a play of the given whole width that starts in its middle.

    Parameters
    ----------
    signal : ndarray, shape (n,)
    width : float

    Returns
    -------
    ndarray, shape (n,)
    """
    return common.held_back(signal, np.full(len(signal), 0.5 * width))
