"""Effects of actuators: differences between the command and the motion of the joints."""

from __future__ import annotations

import functools
import math
from dataclasses import replace

import numpy as np
from scipy.interpolate import Akima1DInterpolator
from scipy.optimize import brentq

from swimid.effects import base
from swimid.effects.base import Parameters, Trials, parameter
from swimid.files.kernels import numba
from swimid.fitting.drives import ease_in
from swimid.fitting.model import Array, Hooks, Model, Parameter, Stroke, Trial, typical
from swimid.swimmer.drive import apply_lag


class AmplitudeLoss(base.Actuation):
    """Constant relative loss of amplitude: each joint moves by ``(1 - loss)`` times its command."""

    name = "amplitude-loss"
    meaning = "The joints turn by a constant fraction less than their command."
    sources = ("boxfish, section 5.3 (the body's oscillation reduces the effective amplitude)",)
    smooth = True
    scatters = True

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """Return as a parameter the fraction of the joint amplitude that is lost."""
        return (parameter("loss", "1", 0.05, "share of the amplitude lost", -0.5, 0.95),)

    def follow(self, value: float, time_s: Array, angle: Array) -> Array:
        """Return the joint angle: the command multiplied by ``1 - loss``."""
        return (1.0 - value) * angle

    def amplitude(self, value: float, stroke: Stroke) -> Array:
        """Return the joint amplitude of a steady beat multiplied by ``1 - loss``."""
        return stroke.amplitude_rad * (1.0 - value)


#: Time over which a trim of the joints sets in, s. A sudden change of the joint angles would throw the body.
EASE_S = 0.5


class AmplitudeOffset(base.Actuation):
    """Constant angle that is added to each driven joint, or by which the amplitude of a steady beat shrinks.

    The lost amplitude is ``theta_off`` of the recoil law in the boxfish paper. The effect applies to models
    that do not estimate the offset.
    """

    name = "amplitude-offset"
    meaning = "The stroke is off by a constant angle: a trim of the joints, or amplitude lost in each stroke."
    of_angles = True
    sources = ("boxfish, section 4.3 and Eq 27",)
    smooth = True
    scatters = True
    own = ("amplitude_offset_deg",)

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """Return as a parameter the angle that is added to each driven joint, in the unit of the command."""
        size = base.typical_amplitude(model, trials)
        most, words = 0.9 * size, "constant angle off"
        return (parameter("offset_rad", "rad", 0.05 * size, words, -most, most),)

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Return hooks that add the trim to the command, and reduce the amplitude of a steady beat."""
        offset = float(values[0])
        laws = [] if model.body is None else [actuator.law for actuator in model.body.actuators]
        still = [k for k, law in enumerate(laws) if law.gain == 0]
        begin = model.onset(trial)
        trimmed = base.for_every_joint(lambda time, angle: angle + offset * ease_in(time - begin, EASE_S))

        def command(time_s: Array, angle: Array, joint: int) -> Array:
            if joint in still:
                return angle
            return trimmed(time_s, angle, joint)

        def change_beat(stroke: Stroke) -> Stroke:
            return replace(stroke, amplitude_rad=np.maximum(stroke.amplitude_rad - offset, 0.0))

        return replace(base.on_command(model, trial, command, of_angles=True), stroke=(change_beat,))


#: Ratio of a rate limit to the largest rate of a sine below which the rate-limited sine is a triangle wave:
#: ``1 / sqrt(1 + pi^2 / 4)``.
TRIANGLE = 1.0 / math.hypot(1.0, 0.5 * math.pi)


class RateLimit(base.Actuation):
    """Limit of the rate with which a joint follows its command.

    The effect has no influence if the limit is the largest commanded rate. In models of the average over a
    beat, the steady beat has the amplitude of the fundamental of the limited sine
    (:func:`compute_fundamental_gain`).
    """

    name = "rate-limit"
    meaning = "The servos cannot turn as fast as the command asks."
    of_angles = True
    sources = ("tendon fish, section IV.A (the speed of the servomotor is limited)",)

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """Return the rate limit as a parameter, rad/s.

        Its start value is the largest commanded rate of the trials. A limit of this value has no influence.
        """
        largest = base.largest_rate(model, trials)
        bounds, words = (0.02 * largest, largest), "largest rate of the servos"
        return (Parameter("rate_limit_rad_s", "rad/s", *bounds, largest, 0.2 * largest, meaning=words),)

    def follow(self, value: float, time_s: Array, angle: Array) -> Array:
        """Return the motion of a joint that follows its command with a limited rate."""
        return np.asarray(limit_rate(time_s, angle, value))

    def amplitude(self, value: float, stroke: Stroke) -> Array:
        """Return the amplitude of a steady beat: that of the fundamental of the rate-limited sine."""
        rate = 2.0 * math.pi * np.asarray(stroke.frequency_hz) * stroke.amplitude_rad
        return stroke.amplitude_rad * compute_fundamental_gain(value / np.maximum(rate, 1e-12))


@numba.njit(cache=True, nogil=True)
def limit_rate(time, signal, limit):  # type: ignore[no-untyped-def]
    """Return a signal that follows the given signal with a limited rate of change.

    Parameters
    ----------
    time : ndarray, shape (n,), s
        Increasing times.
    signal : ndarray, shape (n,)
    limit : float
        Maximum rate, in the unit of the signal per second.

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


def compute_fundamental_gain(ratio: Array | float) -> Array:
    """Return the amplitude of the fundamental of a rate-limited sine, divided by the amplitude of the sine.

    Parameters
    ----------
    ratio : ndarray or float
        Rate limit divided by the largest rate of the sine. From a ratio of one, the sine is unchanged.

    >>> [round(float(v), 6) for v in compute_fundamental_gain(np.array([0.0, 0.5, 1.0, 2.0]))]
    [0.0, 0.63662, 1.0, 1.0]
    """
    nodes, gains = _middle()
    ratio = np.asarray(ratio, dtype=float)
    return np.where(ratio < TRIANGLE, 4.0 / math.pi * ratio, np.interp(ratio, nodes, gains))


@functools.cache
def _middle() -> tuple[Array, Array]:
    """Return ratios of the rate limit to the largest rate of a sine, and the gain (see
    :func:`compute_fundamental_gain`) at each ratio.

    The ratios lie between `TRIANGLE` and one.

    Notes
    -----
    Half a period begins where ``-cos(theta)`` reaches the rate limit (``sin(theta) = ratio``). The output is
    a straight line until it meets the sine again, and then the sine.
    """
    ratios = 1.0 - (1.0 - TRIANGLE) * np.linspace(1.0, 0.0, 200)
    gains = np.ones_like(ratios)
    gains[0] = 4.0 / math.pi * TRIANGLE
    for k, ratio in enumerate(ratios[1:-1], start=1):
        leave = math.asin(ratio)

        def line_gap(theta: float, ratio: float = ratio, leave: float = leave) -> float:
            return math.cos(leave) - math.cos(theta) - ratio * (theta - leave)

        meet = brentq(line_gap, max(math.pi - leave, leave + 1e-9), math.pi + leave)
        theta = np.linspace(leave, leave + math.pi, 4001)
        line = -math.cos(leave) + ratio * (theta - leave)
        angle = np.where(theta < meet, line, -np.cos(theta))
        parts = np.trapezoid(angle * np.exp(1j * theta), theta)
        gains[k] = 2.0 / math.pi * abs(parts)
    return ratios, gains


class ServoBacklash(base.Actuation):
    """Backlash between servo and joint: the joint rests until the servo has crossed the play.

    The joint then moves with the servo. In models of the average over a beat, a steady beat loses half the
    play in amplitude.
    """

    name = "servo-backlash"
    meaning = "The joints do not follow their servos across the play of gears, linkages or tendons."
    of_angles = True
    sources = ("boxfish, section 5.3 (about 2 deg of the amplitude offset)",)

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """Return as a parameter the whole width of the play of each joint, in the unit of the command."""
        size = base.typical_amplitude(model, trials)
        return (parameter("backlash_rad", "rad", 0.1 * size, "whole width of the play", 0.0, 1.9 * size),)

    def follow(self, value: float, time_s: Array, angle: Array) -> Array:
        """Return the motion of a joint that follows its servo with play."""
        return np.asarray(base.hold_back(angle, np.full(len(angle), 0.5 * value)))

    def amplitude(self, value: float, stroke: Stroke) -> Array:
        """Return the joint amplitude of a steady beat: the commanded amplitude minus half the play."""
        return np.maximum(stroke.amplitude_rad - 0.5 * value, 0.0)


class ServoDelay(base.Actuation):
    """Constant delay of the joints behind their command.

    It does not change the average over a steady beat.
    """

    name = "servo-delay"
    meaning = "The joints move a constant time after their command."
    sources = ("sea lion, section II (motion profiles taken as the motion of the joints)",)
    needs = frozenset({"command"})
    smooth = True

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """Return the delay of the servos as a parameter, s."""
        beat = base.typical_period(model, trials)
        return (parameter("delay_s", "s", 0.04 * beat, "delay of the joints' commands", 0.0, beat),)

    def follow(self, value: float, time_s: Array, angle: Array) -> Array:
        """Return the motion of a joint: its command, delayed by a constant time."""
        return apply_delay(time_s, angle, value)


def apply_delay(time_s: Array, signal: Array, delay_s: float) -> Array:
    """Return a signal that is delayed by a constant time.

    Until the delay has passed, the result has the first value of the signal.

    Parameters
    ----------
    time_s, signal : ndarray, shape (n,)
        Samples without missing values. A modified Akima spline interpolates between them.
    delay_s : float
    """
    if delay_s == 0.0 or len(time_s) < 3:
        return signal
    curve = Akima1DInterpolator(time_s, signal, method="makima")
    return np.asarray(curve(np.clip(time_s - delay_s, time_s[0], time_s[-1])))


class ServoLag(base.Actuation):
    """First-order lag ``tau a' = command - a`` of the servos, with the joint angle a.

    A steady beat of frequency f has ``1 / sqrt(1 + (2 pi f tau)^2)`` of the commanded amplitude.
    """

    name = "servo-lag"
    meaning = "The servos lag behind their command and reduce its amplitude, more at higher frequencies."
    sources = (
        "robotic dolphin, section 4.2.1 (the water slows the actual beat)",
        "sea lion, section II (motion profiles taken as the motion of the joints)",
    )
    smooth = True

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """Return the time constant of the servos as a parameter, s."""
        beat = base.typical_period(model, trials)
        return (parameter("time_constant_s", "s", 0.04 * beat, "time constant of the servos", 0.0, beat),)

    def follow(self, value: float, time_s: Array, angle: Array) -> Array:
        """Return the angle of a joint that follows its command with a first-order lag."""
        return np.asarray(apply_lag(time_s, angle, value))

    def amplitude(self, value: float, stroke: Stroke) -> Array:
        """Return the joint amplitude of a steady beat after the first-order lag of the servo."""
        gain = 1.0 / np.sqrt(1.0 + (2.0 * math.pi * stroke.frequency_hz * value) ** 2)
        return np.asarray(stroke.amplitude_rad * gain)


#: Duration over which the loss of amplitude by a slip sets in: fraction of a beat (RAMP), or number of
#: samples (SAMPLES), whichever is longer. RAMP is the accuracy with which a beat shows the time of a change.
#: SAMPLES keeps the simulation differentiable with respect to the time of onset.
RAMP, SAMPLES = 0.25, 4.0
#: Times of onset of a slip that are simulated before a fit, as fractions of the trial's duration. A fit
#: converges to the onset from as far as a quarter of the trial away.
MOMENTS = (0.125, 0.375, 0.625, 0.875)


class Slip(base.Actuation):
    """Slip of a tendon or servo horn: a loss of amplitude that sets in during the trial.

    The joint moves by ``1 - loss s(t)`` times the command, where ``s`` is a quintic step from 0 to 1 about
    the time of onset. The onset is counted from the first sample and is the same in every trial. An average
    over beats does not show when amplitude was lost. Models of steady beats therefore have ``amplitude-loss``
    only.
    """

    name = "slip"
    meaning = "From a certain time of a trial, the joints turn by less than their command."
    sources = (
        "Zhong, Li and Du 2017, IEEE/ASME Trans. Mechatronics 22:1633 (a fish driven by wires)",
        "Firbank 1970, Int. J. Mech. Sci. 12:1053 (belts that creep and slip)",
    )
    needs = frozenset({"command"})

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """Return the parameters: lost fraction of the command, and time of onset, s after the first sample.

        At the time of onset, half of the fraction is lost.
        The scale of the loss is 0.1, twice the smallest visible loss over a whole trial (``amplitude-loss``),
        because the loss lasts for a part of each trial only.
        """
        lasting = model.scales(trials).duration
        longest = max((float(t.time_s[-1] - t.time_s[0]) for t in trials), default=0.0) or lasting
        when = "time after the first sample at which half of the loss is reached"
        return (
            parameter("loss", "1", 0.1, "share of the command lost", 0.0, 0.95),
            parameter("begin_s", "s", 0.1 * lasting, when, 0.0, longest, start=0.5 * lasting),
        )

    def tries(self, parameters: Parameters) -> list[Array]:
        """Return the parameter vectors to simulate before a fit: one loss of amplitude, several onset times.

        One size of the loss is enough, because the simulated trials change nearly in proportion to it.
        """
        loss, begin = parameters
        return [np.array([2.0 * loss.scale, 2.0 * share * begin.start]) for share in MOMENTS]

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Return hooks that reduce the joint commands after the time at which the loss begins."""
        loss, begin = (float(v) for v in values)
        ramp = RAMP * base.typical_period(model, [trial])
        ramp = max(ramp, SAMPLES * typical(np.diff(trial.time_s).tolist(), 0.0))
        first = float(trial.time_s[0]) + begin - 0.5 * ramp

        def command(time_s: Array, angle: Array) -> Array:
            return angle * (1.0 - loss * ease_in(time_s - first, ramp))

        return base.on_command(model, trial, base.for_every_joint(command))
