"""Gyroscope bias: a turn rate that is read at rest."""

from __future__ import annotations

from collections.abc import Sequence

from swimid.effects.base import Effect
from swimid.effects.sensing import _channels
from swimid.fitting.hooks import Hooks
from swimid.fitting.model import Array, Model, Parameter, Trial


class ImuBias(Effect):
    """A constant added to the turn rate."""

    name = "imu-bias"
    stage = "sensing"
    meaning = "The gyroscope shows a constant turn rate at rest."
    sources = ("long-fin vehicle, section 5.2 (drift and calibration errors; the mean is filtered out)",)
    needs = frozenset({"output"})
    smooth = True

    def variants(self, model: Model, trials: Sequence[Trial]) -> Sequence[Effect]:
        """The effect itself where a turn rate is measured."""
        return super().variants(model, trials) if _channels.measured(_channels.TURN_RATES, trials) else []

    def parameters(self, model: Model, trials: Sequence[Trial]) -> tuple[Parameter, ...]:
        """The bias, rad/s."""
        return (Parameter("bias_rad_s", "rad/s", -1.0, 1.0, 0.0, 0.02, meaning="turn rate shown at rest"),)

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Turn rates with the bias."""
        bias = float(values[0])

        def seen(channels: dict[str, Array], time_s: Array) -> dict[str, Array]:
            return {n: v + bias if n in _channels.TURN_RATES else v for n, v in channels.items()}

        return Hooks(output=(seen,))
