"""A servo that follows its command with a first-order lag."""

import math

import numba
import numpy as np

from swimid.effects import common
from swimid.effects.base import Array, Model, Parameters, Trials
from swimid.fitting.hooks import Stroke


class ServoLag(common.Actuation):
    """``tau a' = command - a``; a steady beat of frequency f keeps ``1 / sqrt(1 + (2 pi f tau)^2)``."""

    name = "servo-lag"
    meaning = "The servos follow their command late and with a smaller amplitude, the more so the faster."
    sources = (
        "robotic dolphin, section 4.2.1 (the water slows the actual beat)",
        "sea lion, section II (motion profiles taken as the motion of the joints)",
    )
    smooth = True

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """The time constant, s."""
        beat = common.period(model, trials)
        words = "time constant of the servos"
        return (common.parameter("time_constant_s", "s", 0.04 * beat, words, lower=0.0, upper=beat),)

    def followed(self, value: float, time_s: Array, angle: Array) -> Array:
        """The command with a lag."""
        return np.asarray(lagged(time_s, angle, value))

    def amplitude(self, value: float, stroke: Stroke) -> Array:
        """The gain of the lag at the beat's frequency."""
        gain = 1.0 / np.sqrt(1.0 + (2.0 * math.pi * stroke.frequency_hz * value) ** 2)
        return np.asarray(stroke.amplitude_rad * gain)


@numba.njit(cache=True, nogil=True)
def lagged(time, signal, tau):  # type: ignore[no-untyped-def]
    """First-order lag of a signal, exact where the signal is straight between its samples.

    Parameters
    ----------
    time : ndarray, shape (n,), s
        Increasing.
    signal : ndarray, shape (n,)
        The lag starts at rest at its first value.
    tau : float, s
        Zero leaves the signal as it is.

    Returns
    -------
    ndarray, shape (n,)
    """
    output = signal.copy()
    if tau <= 0.0:
        return output
    for i in range(1, len(signal)):
        ratio = (time[i] - time[i - 1]) / tau
        kept = math.exp(-ratio)
        mean = -math.expm1(-ratio) / ratio
        output[i] = kept * output[i - 1] + (mean - kept) * signal[i - 1] + (1.0 - mean) * signal[i]
    return output
