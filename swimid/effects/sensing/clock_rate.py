"""A log whose clock runs fast or slow."""

import math

from swimid.effects import common
from swimid.effects.base import Array, Effect, Effects, Hooks, Model, Parameters, Trial, Trials

#: Largest error that is looked for, either way: RC oscillators that nobody calibrated are 10 % off.
LARGEST = 0.1


class ClockRate(Effect):
    """A stamp ``t`` of the log shows what happened at ``t_0 + (t - t_0) / (1 + rate)``.

    The clocks of log and drive agree at ``t_0``, where the drive or the run begins (the first sample of a
    recorded command or input); how far they are apart there is ``time-offset``. Where a log holds turn rates
    beside poses, the camera's clock alone may run at another rate than the robot's.

    Parameters
    ----------
    camera : bool
        Whether only poses are stamped by that clock.
    """

    name = "clock-rate"
    meaning = "The clock of the measurement runs fast, or slow, against that of the drive."
    sources = (
        "Atmel, ATmega328P data sheet (internal oscillator within 10 % as it leaves the factory)",
        "SMPTE 170M (29.97 frames per second, often called 30)",
    )
    needs = frozenset({"clock"})
    smooth = True

    def __init__(self, *, camera: bool = False) -> None:
        self.camera = camera

    def variants(self, model: Model, trials: Trials) -> Effects:
        """Where there is a clock; the camera's alone beside it."""
        alone = [ClockRate(camera=True)] if common.clocks_apart(model, trials) else []
        return [*super().variants(model, trials), *alone]

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """The share by which the log runs fast; 0.2 % are 20 ms after 10 s, an offset one begins to see."""
        name = "camera_rate" if self.camera else "rate"
        words = "share by which the clock of the log is fast"
        return (common.parameter(name, "1", 0.002, words, lower=-LARGEST, upper=LARGEST),)

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """A clock that drifts from where the run begins."""
        rate = float(values[0])
        onset = model.onset(trial)
        begin = onset if math.isfinite(onset) else float(trial.time_s[0])
        drift = rate / (1.0 + rate)
        if self.camera and rate != 0.0:
            return common.poses_at(trial, lambda time_s: time_s - drift * (time_s - begin))
        return Hooks() if self.camera else Hooks(clock_s=-drift * begin, clock_drift=drift)
