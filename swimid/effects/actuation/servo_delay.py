"""A servo that does the right thing too late."""

import numpy as np
from scipy.interpolate import Akima1DInterpolator

from swimid.effects import common
from swimid.effects.base import Array, Model, Parameters, Trials


class ServoDelay(common.Actuation):
    """A pure delay of the command; it changes nothing in a steady beat's average."""

    name = "servo-delay"
    meaning = "The joints move a constant time after their command."
    sources = ("sea lion, section II (motion profiles taken as the motion of the joints)",)
    needs = frozenset({"command"})
    smooth = True

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """The delay, s."""
        beat = common.period(model, trials)
        words = "delay of the joints' commands"
        return (common.parameter("delay_s", "s", 0.04 * beat, words, lower=0.0, upper=beat),)

    def followed(self, value: float, time_s: Array, angle: Array) -> Array:
        """The command as it was a delay ago."""
        return delayed(time_s, angle, value)


def delayed(time_s: Array, signal: Array, delay_s: float) -> Array:
    """A signal a constant time later; before its first sample it rests there.

    Parameters
    ----------
    time_s, signal : ndarray, shape (n,)
        Without missing samples; Akima's curve lies between them.
    delay_s : float
    """
    if delay_s == 0.0 or len(time_s) < 3:
        return signal
    curve = Akima1DInterpolator(time_s, signal, method="makima")
    return np.asarray(curve(np.clip(time_s - delay_s, time_s[0], time_s[-1])))
