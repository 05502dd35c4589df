"""Joints that turn less far than they are told."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from swimid.effects.actuation import _commands
from swimid.fitting.hooks import Hooks, Stroke
from swimid.fitting.model import Array, Model, Parameter, Trial


class AmplitudeLoss(_commands.Actuation):
    """A gain below one: ``(1 - loss)`` times the command."""

    name = "amplitude-loss"
    meaning = "The joints turn by less than their command, by the same share always."
    sources = ("boxfish, section 5.3 (the body's oscillation reduces the effective amplitude)",)
    needs = frozenset({"command", "stroke"})
    smooth = True
    scatters = True

    def parameters(self, model: Model, trials: Sequence[Trial]) -> tuple[Parameter, ...]:
        """The share that is lost."""
        return (Parameter("loss", "1", -0.5, 0.95, 0.0, 0.05, meaning="share of the amplitude lost"),)

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Less of the command, and of a steady beat's amplitude."""
        gain = 1.0 - float(values[0])

        def beaten(stroke: Stroke) -> Stroke:
            return replace(stroke, amplitude_rad=stroke.amplitude_rad * gain)

        return _commands.hooks(model, trial, lambda time, angle: gain * angle) + Hooks(stroke=(beaten,))
