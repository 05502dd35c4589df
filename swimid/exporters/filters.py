"""Filters of joint commands, for effects of the actuators that a simulator cannot express.

A filter converts the commands of one joint, one after the other, into joint angles. ``swimid export`` copies
the source of the filters that an export needs into a Python file that does not import swimid. Therefore this
module imports only from the standard library. Its laws are those of :mod:`swimid.effects.actuation` and
:mod:`swimid.effects.structure`.
"""

from __future__ import annotations

import math
from bisect import bisect_right


class Filter:
    """Base class of the filters that convert the command of one joint into the joint angle.

    This class returns the command unchanged.

    Attributes
    ----------
    time_s, command, angle : float
        Time (s), command (rad) and resulting angle (rad) of the last call. Before the first call the time is
        NaN.
    """

    time_s = math.nan
    command = angle = 0.0

    def __call__(self, time_s: float, command: float) -> float:
        """Return the joint angle, rad, for a command, rad. The times of successive calls must increase."""
        if math.isnan(self.time_s):
            self.angle = self._begin(time_s, command)
        elif time_s > self.time_s:
            self.angle = self._step(time_s, command)
        self.time_s, self.command = time_s, command
        return self.angle

    def _begin(self, time_s: float, command: float) -> float:
        """Return the joint angle, rad, at the first command."""
        return command

    def _step(self, time_s: float, command: float) -> float:
        """Return the joint angle, rad, at a command after the first."""
        return self._begin(time_s, command)

    def _hold(self, command: float, half: float) -> float:
        """Return the angle of a joint that rests while its command is within ``half`` of the angle, rad."""
        return min(max(self.angle, command - half), command + half)


class AmplitudeLossFilter(Filter):
    """Filter of a joint that moves by less than its command: its angle is ``(1 - loss) command``."""

    def __init__(self, loss: float) -> None:
        self.loss = loss

    def _begin(self, time_s: float, command: float) -> float:
        return (1.0 - self.loss) * command


class AmplitudeOffsetFilter(Filter):
    """Filter of a joint with the angle ``command + offset``. The offset rises from zero within 0.5 s."""

    def __init__(self, offset_rad: float) -> None:
        self.offset, self.first = offset_rad, math.nan

    def _begin(self, time_s: float, command: float) -> float:
        if math.isnan(self.first):
            self.first = time_s
        s = min((time_s - self.first) / 0.5, 1.0)
        return command + self.offset * s**3 * (10.0 + s * (6.0 * s - 15.0))


class JointLockedFilter(Filter):
    """Filter of a joint that is locked in part: its angle is ``first + (1 - lock) (command - first)``.

    ``first`` is the first command.
    """

    def __init__(self, lock: float) -> None:
        self.lock, self.first = lock, math.nan

    def _begin(self, time_s: float, command: float) -> float:
        if math.isnan(self.first):
            self.first = command
        return self.first + (1.0 - self.lock) * (command - self.first)


class RateLimitFilter(Filter):
    """Filter of a joint that follows its command with a limited rate."""

    def __init__(self, rate_limit_rad_s: float) -> None:
        self.limit = rate_limit_rad_s

    def _step(self, time_s: float, command: float) -> float:
        most = self.limit * (time_s - self.time_s)
        return self.angle + min(max(command - self.angle, -most), most)


class ServoBacklashFilter(Filter):
    """Filter of a joint with play between servo and joint. ``backlash_rad`` is the whole width of the play.

    After a reversal of the command, the joint rests until the servo has crossed the play.
    """

    def __init__(self, backlash_rad: float) -> None:
        self.half = 0.5 * backlash_rad

    def _step(self, time_s: float, command: float) -> float:
        return self._hold(command, self.half)


class ServoDelayFilter(Filter):
    """Filter of a joint that follows its command with a constant delay, by linear interpolation."""

    def __init__(self, delay_s: float) -> None:
        self.delay = delay_s
        self.times: list[float] = []
        self.commands: list[float] = []

    def _begin(self, time_s: float, command: float) -> float:
        self.times.append(time_s)
        self.commands.append(command)
        then = time_s - self.delay
        k = bisect_right(self.times, then)
        if k == 0:
            return self.commands[0]
        if k == len(self.times):
            return command
        del self.times[: k - 1], self.commands[: k - 1]
        share = (then - self.times[0]) / (self.times[1] - self.times[0])
        return self.commands[0] + share * (self.commands[1] - self.commands[0])


class ServoLagFilter(Filter):
    """Filter of a joint whose angle ``a`` follows its command by ``time_constant a' = command - a``.

    The solution is exact if the command changes linearly between two calls.
    """

    def __init__(self, time_constant_s: float) -> None:
        self.time_constant = time_constant_s

    def _step(self, time_s: float, command: float) -> float:
        ratio = (time_s - self.time_s) / self.time_constant
        kept, mean = math.exp(-ratio), -math.expm1(-ratio) / ratio
        return kept * self.angle + (mean - kept) * self.command + (1.0 - mean) * command


class SlipFilter(Filter):
    """Filter of a joint whose motion is reduced from the time of onset on: ``(1 - loss step) command``.

    ``step`` rises from 0 to 1 within 0.25 s about the time of onset.
    """

    def __init__(self, loss: float, begin_s: float) -> None:
        self.loss, self.onset, self.first = loss, begin_s, math.nan

    def _begin(self, time_s: float, command: float) -> float:
        if math.isnan(self.first):
            self.first = time_s
        s = min(max((time_s - self.first - self.onset) / 0.25 + 0.5, 0.0), 1.0)
        return command * (1.0 - self.loss * s**3 * (10.0 + s * (6.0 * s - 15.0)))


class StribeckFilter(Filter):
    """Filter of a joint with stiction that decreases with the rate w of its command.

    The joint rests while its command is within ``stick exp(-(w / stribeck)^2)`` of its angle.
    """

    def __init__(self, stick_rad: float, stribeck_rad_s: float) -> None:
        self.stick, self.slow = stick_rad, stribeck_rad_s

    def _step(self, time_s: float, command: float) -> float:
        rate = (command - self.command) / (time_s - self.time_s)
        return self._hold(command, self.stick * math.exp(-((rate / self.slow) ** 2)))


class LoadFrictionFilter(Filter):
    """Filter of a joint with friction in proportion to the load of the joint.

    The joint rests while its command q is within ``held |I q'' + D q' |q'||`` of its angle.
    ``inertia_kg_m2`` and ``drag_N_m_s2`` are I and D, the inertia and quadratic drag of the links that the
    joint moves.
    """

    rate = 0.0

    def __init__(self, held_rad_N_m: float, inertia_kg_m2: float, drag_N_m_s2: float) -> None:
        self.share, self.inertia, self.drag = held_rad_N_m, inertia_kg_m2, drag_N_m_s2

    def _step(self, time_s: float, command: float) -> float:
        step_s = time_s - self.time_s
        rate = (command - self.command) / step_s
        torque = self.inertia * (rate - self.rate) / step_s + self.drag * rate * abs(rate)
        self.rate = rate
        return self._hold(command, self.share * abs(torque))
