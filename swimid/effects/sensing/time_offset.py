"""A log whose clock is late."""

import numpy as np

from swimid.effects import common
from swimid.effects.base import Array, Effect, Effects, Hooks, Model, Parameters, Trial, Trials
from swimid.fitting.model import MEAN_SPEED

#: Largest offset that is looked for, s.
LARGEST_S = 2.0


class TimeOffset(Effect):
    """The log shows what happened a constant time earlier; a timed run takes that much longer.

    Where a log holds turn rates beside poses, the camera's clock alone may be late against that of the robot.

    Parameters
    ----------
    camera : bool
        Whether only poses are late.
    """

    name = "time-offset"
    meaning = "The clock of the measurement is late, or early, against that of the drive."
    sources = (
        "boxfish, section 3.4 (time read from a video to 0.1 s)",
        "sea lion, section II (time zero is the frame of release)",
    )
    needs = frozenset({"clock"})
    smooth = True
    scatters = True

    def __init__(self, *, camera: bool = False) -> None:
        self.camera = camera

    def variants(self, model: Model, trials: Trials) -> Effects:
        """Where there is a clock the model does not estimate; the camera's alone beside it."""
        if model.timed_runs:
            return [self]
        if model.estimates("clock_offset"):
            return []
        alone = [TimeOffset(camera=True)] if common.clocks_apart(model, trials) else []
        return [*super().variants(model, trials), *alone]

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """The time by which the log is late, s."""
        name, typical = "camera_offset_s" if self.camera else "offset_s", 0.1 if model.timed_runs else 0.03
        words = "time by which the log is late"
        return (common.parameter(name, "s", typical, words, lower=-LARGEST_S, upper=LARGEST_S),)

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """A late clock; longer times of cruising runs."""
        offset = float(values[0])
        if self.camera:
            return common.poses_at(trial, lambda time_s: time_s - offset) if offset != 0.0 else Hooks()
        if not model.timed_runs:
            return Hooks(clock_s=offset)
        distance = trial.inputs["distance_m"]

        def seen(channels: dict[str, Array], time_s: Array) -> dict[str, Array]:
            speed = channels[MEAN_SPEED]
            with np.errstate(divide="ignore"):
                # no watch reads less than a tenth of the run
                longer = np.maximum(1.0 + offset * speed / distance, 0.1)
            return {**channels, MEAN_SPEED: speed / longer}

        return Hooks(output=(seen,))
