"""A parameter whose value is no longer the one in the parameter file: a hypothesis like an effect."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import ClassVar

from swimid.effects.base import Effect
from swimid.fitting.hooks import NONE, Hooks
from swimid.fitting.model import Array, Model, Parameter, Trial

#: First part of the names of these hypotheses; the rest is the name of the parameter.
PREFIX = "parameter:"
#: Typical size of a change, as a share of the parameter's value.
TYPICAL_CHANGE = 0.1


class ParameterChange(Effect):
    """A change of one parameter of the model since the fit that its parameter file comes from.

    The change is a parameter of its own that is added to the model's. The model's parameter itself keeps the
    prior that the standard error of the file gives it. Every other parameter stays as given.

    Parameters
    ----------
    parameter : Parameter
        Parameter of the model; its start is the value in the file.
    """

    name: ClassVar[str]
    stage: ClassVar[None] = None  # type: ignore[assignment]
    meaning: ClassVar[str]
    needs: ClassVar[frozenset[str]] = frozenset()
    smooth: ClassVar[bool] = True

    def __init__(self, parameter: Parameter) -> None:
        vars(self).update(
            name=PREFIX + parameter.name,
            meaning=f"value of {parameter.name} other than the one in the parameter file",
            adds_to=parameter.name,
        )
        size = TYPICAL_CHANGE * abs(parameter.start) or parameter.scale
        self._change = replace(
            parameter,
            name="change",
            lower=parameter.lower - parameter.start,
            upper=parameter.upper - parameter.start,
            start=0.0,
            scale=size,
            free=True,
            known=None,
        )

    def parameters(self, model: Model, trials: Sequence[Trial]) -> tuple[Parameter, ...]:
        """Return the change, in the unit of the parameter."""
        return (self._change,)

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Return no hooks: the change is added to the parameter before the simulation."""
        return NONE

    def variants(self, model: Model, trials: Sequence[Trial]) -> Sequence[Effect]:
        """Return its only form."""
        return [self]

    def content(self) -> bytes:
        """Return its name, which identifies it within one diagnosis."""
        return self.name.encode()
