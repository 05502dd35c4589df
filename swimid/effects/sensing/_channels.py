"""Which channels which sensor shows, and effects on channels of one kind."""

from abc import ABC
from collections.abc import Callable, Sequence
from typing import ClassVar

import numpy as np
from scipy.interpolate import CubicSpline

from swimid.effects.base import Array, Effect, Effects, Hooks, Model, Trial, Trials
from swimid.fitting.model import MEAN_SPEED, POSITIONS

SPEEDS = ("u_m_s", "v_m_s", "w_m_s", MEAN_SPEED)
#: What a camera, or an encoder on a rig, measures as a length.
LENGTHS = (*POSITIONS, *SPEEDS)
#: What a camera tells of a swimmer's pose.
POSES = (*POSITIONS, "yaw_rad", "pitch_rad")
#: What a gyroscope in the body measures.
TURN_RATES = ("roll_rate_rad_s", "pitch_rate_rad_s", "yaw_rate_rad_s")


def measured(names: Sequence[str], trials: Trials) -> list[str]:
    """Those of the channels that some trial has samples of."""
    return [n for n in names if any(n in t.measured and np.isfinite(t.measured[n]).any() for t in trials)]


def clocks_apart(model: Model, trials: Trials) -> bool:
    """Whether a camera's poses stand beside the robot's own turn rates, each with a clock of its own."""
    measured = {c for t in trials for c in t.measured}
    rates = any(c.endswith("_rate_rad_s") for c in measured)
    return "output" in model.offers and rates and bool(measured & set(POSES))


def poses_at(trial: Trial, happened: Callable[[Array], Array]) -> Hooks:
    """Poses of a camera whose clock is not the robot's: at each time those of when it ``happened``."""

    def seen(channels: dict[str, Array], time_s: Array) -> dict[str, Array]:
        # a cubic carries on for two samples beyond the run, not for more
        end = time_s[-1] + 2.0 * np.median(np.diff(time_s))
        then = np.clip(happened(time_s), time_s[0], end)
        poses = [c for c in POSES if c in channels]
        values = np.column_stack([channels[c] for c in poses])
        # a simulation that broke down is missing altogether
        sound = np.isfinite(values).all(axis=0)
        shifted = np.full(values.shape, np.nan)
        shifted[:, sound] = CubicSpline(time_s, values[:, sound])(then)
        return {**channels, **dict(zip(poses, shifted.T, strict=True))}

    return Hooks(output=(seen,) if len(trial.time_s) > 3 else ())


class Sensing(Effect, ABC):
    """An effect on each of some channels by itself; it applies where one of them is measured."""

    needs = frozenset({"output"})
    channels: ClassVar[tuple[str, ...]]

    def variants(self, model: Model, trials: Trials) -> Effects:
        """The effect itself where such a channel is measured."""
        return super().variants(model, trials) if measured(self.channels, trials) else []

    def shown(self, change: Callable[[str, Array], Array]) -> Hooks:
        """The hooks of ``change(name, simulated)``, the same for every channel."""

        def seen(channels: dict[str, Array], time_s: Array) -> dict[str, Array]:
            return {n: change(n, v) if n in self.channels else v for n, v in channels.items()}

        return Hooks(output=(seen,))
