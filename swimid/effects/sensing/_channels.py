"""Which channels which sensor shows, and effects on channels of one kind."""

from abc import ABC
from collections.abc import Callable, Sequence
from typing import ClassVar

import numpy as np

from swimid.effects.base import Array, Effect, Effects, Hooks, Model, Trials
from swimid.fitting.scales import MEAN_SPEED, POSITIONS

SPEEDS = ("u_m_s", "v_m_s", "w_m_s", MEAN_SPEED)
#: What a camera, or an encoder on a rig, measures as a length.
LENGTHS = (*POSITIONS, *SPEEDS)
#: What a gyroscope in the body measures.
TURN_RATES = ("roll_rate_rad_s", "pitch_rate_rad_s", "yaw_rate_rad_s")


def measured(names: Sequence[str], trials: Trials) -> list[str]:
    """Those of the channels that some trial has samples of."""
    return [n for n in names if any(n in t.measured and np.isfinite(t.measured[n]).any() for t in trials)]


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
