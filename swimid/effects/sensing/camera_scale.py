"""A length scale that is off."""

from __future__ import annotations

from collections.abc import Sequence

from swimid.effects.base import Effect
from swimid.effects.sensing import _channels
from swimid.fitting.hooks import Hooks
from swimid.fitting.model import Array, Model, Parameter, Trial


class CameraScale(Effect):
    """Displacements and speeds times ``1 + scale_error``, about where the trial starts.

    On a rig it is the circumference of the encoder's pulley, on a cruising run the length of the
    course or the rate of the clock.
    """

    name = "camera-scale"
    stage = "sensing"
    meaning = "The measured lengths are too long or too short by a constant share."
    sources = (
        "boxfish, section 4.2 (error of the course's length)",
        "tendon fish, section V (global camera)",
        "robotic dolphin, section 4 (global camera)",
    )
    needs = frozenset({"output"})
    smooth = True

    def variants(self, model: Model, trials: Sequence[Trial]) -> Sequence[Effect]:
        """The effect itself where a length or a speed is measured."""
        lengths = _channels.measured((*_channels.POSITIONS, *_channels.SPEEDS), trials)
        return super().variants(model, trials) if lengths else []

    def parameters(self, model: Model, trials: Sequence[Trial]) -> tuple[Parameter, ...]:
        """The relative error of the scale."""
        return (Parameter("scale_error", "1", -0.5, 1.0, 0.0, 0.03, meaning="relative error of the lengths"),)

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Scaled positions and speeds."""
        error = float(values[0])
        origin = model.origin(trial)

        def seen(channels: dict[str, Array], time_s: Array) -> dict[str, Array]:
            found = dict(channels)
            for name in (*_channels.POSITIONS, *_channels.SPEEDS):
                if name in found:
                    found[name] = found[name] + error * (found[name] - origin.get(name, 0.0))
            return found

        return Hooks(output=(seen,))
