"""A servo that cannot turn faster than its limit."""

import functools
import math

import numba
import numpy as np
from scipy.optimize import brentq

from swimid.effects import common
from swimid.effects.base import Array, Model, Parameter, Parameters, Trials
from swimid.fitting.hooks import Stroke

#: Ratio of limit to largest commanded rate below which a limited sine is a triangle,
#: ``1 / sqrt(1 + pi^2 / 4)``.
TRIANGLE = 1.0 / math.hypot(1.0, 0.5 * math.pi)


class RateLimit(common.Actuation):
    """The joint follows its command no faster than a limit; the fastest command is where it begins to act.

    A steady beat of the average models keeps the fundamental of the limited sine (its describing
    function: :func:`describing`).
    """

    name = "rate-limit"
    meaning = "The servos cannot turn as fast as the command asks."
    sources = ("tendon fish, section IV.A (the speed of the servomotor is limited)",)

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """The limit, rad/s; it vanishes at the trials' largest commanded rate."""
        largest = common.fastest(model, trials)
        bounds, words = (0.02 * largest, largest), "largest rate of the servos"
        return (Parameter("rate_limit_rad_s", "rad/s", *bounds, largest, 0.2 * largest, meaning=words),)

    def followed(self, value: float, time_s: Array, angle: Array) -> Array:
        """The limited command."""
        return np.asarray(limited(time_s, angle, value))

    def amplitude(self, value: float, stroke: Stroke) -> Array:
        """The fundamental of the limited sine."""
        rate = 2.0 * math.pi * np.asarray(stroke.frequency_hz) * stroke.amplitude_rad
        return stroke.amplitude_rad * describing(value / np.maximum(rate, 1e-12))


@numba.njit(cache=True, nogil=True)
def limited(time, signal, limit):  # type: ignore[no-untyped-def]
    """A signal followed no faster than a limit.

    Parameters
    ----------
    time : ndarray, shape (n,), s
        Increasing.
    signal : ndarray, shape (n,)
    limit : float
        Of its rate, per second.

    Returns
    -------
    ndarray, shape (n,)
    """
    output = signal.copy()
    for i in range(1, len(signal)):
        ahead = signal[i] - output[i - 1]
        most = limit * (time[i] - time[i - 1])
        if abs(ahead) > most:
            output[i] = output[i - 1] + math.copysign(most, ahead)
    return output


def describing(ratio: Array | float) -> Array:
    """Size of the fundamental of a rate-limited sine, over that of the sine.

    Parameters
    ----------
    ratio : ndarray or float
        Limit over the sine's largest rate; from one on nothing is lost.

    >>> [round(float(v), 6) for v in describing(np.array([0.0, 0.5, 1.0, 2.0]))]
    [0.0, 0.63662, 1.0, 1.0]
    """
    nodes, gains = _middle()
    ratio = np.asarray(ratio, dtype=float)
    return np.where(ratio < TRIANGLE, 4.0 / math.pi * ratio, np.interp(ratio, nodes, gains))


@functools.cache
def _middle() -> tuple[Array, Array]:
    """The gain between triangle and sine, on nodes of the ratio.

    Notes
    -----
    Half a period from where ``-cos(theta)`` reaches the limit (``sin(theta) = ratio``): a straight
    line until it meets the sine again, then the sine.
    """
    ratios = 1.0 - (1.0 - TRIANGLE) * np.linspace(1.0, 0.0, 200)
    gains = np.ones_like(ratios)
    gains[0] = 4.0 / math.pi * TRIANGLE
    for k, ratio in enumerate(ratios[1:-1], start=1):
        leave = math.asin(ratio)

        def ahead(theta: float, ratio: float = ratio, leave: float = leave) -> float:
            return math.cos(leave) - math.cos(theta) - ratio * (theta - leave)

        meet = brentq(ahead, max(math.pi - leave, leave + 1e-9), math.pi + leave)
        theta = np.linspace(leave, leave + math.pi, 4001)
        line = -math.cos(leave) + ratio * (theta - leave)
        angle = np.where(theta < meet, line, -np.cos(theta))
        parts = np.trapezoid(angle * np.exp(1j * theta), theta)
        gains[k] = 2.0 / math.pi * abs(parts)
    return ratios, gains
