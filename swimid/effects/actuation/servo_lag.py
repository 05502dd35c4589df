"""A servo that follows its command with a first-order lag."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numba
import numpy as np

from swimid.effects.actuation import _commands
from swimid.fitting.hooks import Hooks, Stroke
from swimid.fitting.model import Array, Model, Parameter, Trial


class ServoLag(_commands.Actuation):
    """``tau a' = command - a``; a steady beat of frequency f keeps ``1 / sqrt(1 + (2 pi f tau)^2)``."""

    name = "servo-lag"
    meaning = "The servos follow their command late and with a smaller amplitude, the more so the faster."
    sources = (
        "robotic dolphin, section 4.2.1 (the water slows the actual beat)",
        "sea lion, section II (motion profiles taken as the motion of the joints)",
    )
    needs = frozenset({"command", "stroke"})
    smooth = True

    def parameters(self, model: Model, trials: Sequence[Trial]) -> tuple[Parameter, ...]:
        """The time constant, s."""
        beat = _commands.period(model, trials)
        return (
            Parameter(
                "time_constant_s", "s", 0.0, beat, 0.0, 0.04 * beat, meaning="time constant of the servos"
            ),
        )

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Lag of the command; less amplitude of a steady beat."""
        tau = float(values[0])

        def beaten(stroke: Stroke) -> Stroke:
            gain = 1.0 / np.sqrt(1.0 + (2.0 * math.pi * stroke.frequency_hz * tau) ** 2)
            return replace(stroke, amplitude_rad=stroke.amplitude_rad * gain)

        return _commands.hooks(model, trial, lambda time, angle: lagged(time, angle, tau)) + Hooks(
            stroke=(beaten,)
        )


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
    found = signal.copy()
    if tau <= 0.0:
        return found
    for i in range(1, len(signal)):
        ratio = (time[i] - time[i - 1]) / tau
        kept = math.exp(-ratio)
        mean = -math.expm1(-ratio) / ratio
        found[i] = kept * found[i - 1] + (mean - kept) * signal[i - 1] + (1.0 - mean) * signal[i]
    return found
